"""Which pictures there are: the papers' figures, the scene files that make them, and what the texts call them."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

TITLE = "The papers' pictures, rendered again"


@dataclass(frozen=True)
class Shown:
    """A figure of a paper, and the scenes that make it."""

    name: str
    title: str
    pictures: tuple[tuple[str, str], ...]
    """Scene files without their ending, and the label below each."""
    remark: str = ""
    """What was chosen here, and is not the paper's."""


_SIGMA_UM = ("0.18", "0.28", "0.38", "0.48", "0.58", "2.50")
_BLINN_7A = tuple(
    (f"blinn-7a-{model}-{lit}", f"{words}, {lit} lit")
    for lit in ("edge", "front")
    for model, words in (("phong", "Phong"), ("facets", "facets"))
)

SHOWN = (
    Shown(
        "htsg-12",
        "HTSG Fig. 12: aluminium cylinders of growing roughness",
        tuple(
            (f"htsg-12{letter}", f"({letter}) σ0 {s} µm, τ {t} µm")
            for letter, s, t in zip("abcdef", _SIGMA_UM, [3] * 5 + [16], strict=True)
        ),
        "Chosen here: sizes, lamps, camera, the spectra of bricks and floor. Images are held against those in a "
        "perfect mirror under the same lights, not in Fig. 13 (b), which has no ambient light.",
    ),
    Shown(
        "htsg-13",
        "HTSG Fig. 13: directional diffuse, ideal specular, uniform diffuse",
        (("htsg-12f", "(a) σ0 2.5 µm"), ("htsg-13b", "(b) σ0 0"), ("htsg-13c", "(c) diffuse")),
        "(b) has no ambient light; for the verdicts (a) and (c) have none either. Chosen here: as in Fig. 12, and "
        "the albedo 0.9 of (c).",
    ),
    Shown(
        "htsg-14",
        "HTSG Fig. 14: four materials",
        (("htsg-14", "cylinder of aluminium, cube and table of plastic, sphere of copper"),),
        "Chosen here: sizes, lamps, camera, wall, the plastic's index 1.5, and a(λ) away from 550 nm.",
    ),
    Shown(
        "cook-torrance-6",
        "Cook-Torrance Fig. 6: plastic and copper",
        (("cook-torrance-6a", "(a) plastic"), ("cook-torrance-6b", "(b) copper")),
        "Chosen here: the vase's profile, where lights and camera are, and the ambient light's unit (see the notes).",
    ),
    Shown(
        "cook-torrance-7",
        "Cook-Torrance Fig. 7: vases of twelve materials",
        (
            (
                "cook-torrance-7",
                "copper, gold, brass, silver; iron, nickel, carbon, rubber; obsidian, lunar dust, olive drab, rust",
            ),
        ),
        "Chosen here: which metals, and the spectra of the six nonmetals, which are plausible and not the paper's.",
    ),
    Shown(
        "cook-torrance-8",
        "Cook-Torrance Fig. 8: a watch",
        (("cook-torrance-8", "gold, steel, diodes"),),
        "Chosen here: the watch's shape and the slopes. The diodes are matte: a surface does not shine here.",
    ),
    Shown(
        "blinn-7a",
        "Blinn Fig. 7a: aluminium",
        _BLINN_7A,
        "“Facets” is Torrance and Sparrow's model. Chosen here: the object, light and camera, and Phong's weight and "
        "exponent, which the text does not give.",
    ),
    Shown(
        "blinn-7b",
        "Blinn Fig. 7b: magnesium oxide",
        tuple((name.replace("7a", "7b"), label) for name, label in _BLINN_7A),
        "Chosen here: as in Fig. 7a.",
    ),
    Shown(
        "blinn-8",
        "Blinn Fig. 8: shininess from a texture",
        (("blinn-8a", "checker"), ("blinn-8b", "dots")),
        "Chosen here: the textures, c_min 0.4, and everything else.",
    ),
    Shown(
        "oren-nayar-12",
        "Oren-Nayar Figs. 1 and 12: a clay vase",
        (("oren-nayar-12b", "Lambert"), ("oren-nayar-12c", "proposed model")),
        "Chosen here: the vase's shape, σ 40°, ρ 0.7. The photograph, Figs. 1 (a) and 12 (a), is not at hand.",
    ),
    Shown(
        "oren-nayar-13",
        "Oren-Nayar Fig. 13: lit from 20° to the right",
        (("oren-nayar-13b-lambert", "(b) Lambert"), ("oren-nayar-13b-model", "(b) model")),
        "The plot takes its brightness from these pictures and from those of Fig. 12, at half of the vase's height.",
    ),
    Shown(
        "oren-nayar-14",
        "Oren-Nayar Fig. 14: spheres of growing roughness",
        tuple(
            (f"oren-nayar-14{letter}", f"({letter}) σ {s}°") for letter, s in zip("abcd", (0, 10, 20, 40), strict=True)
        ),
        "Chosen here: the three roughnesses, the equation and ρ 0.7, which the text does not hold.",
    ),
    Shown(
        "oren-nayar-15",
        "Oren-Nayar Fig. 15: three matte objects",
        (
            ("oren-nayar-15a-viewer", "(a) σ 0°, from the viewer"),
            ("oren-nayar-15b-viewer", "(b) σ 40°, from the viewer"),
            ("oren-nayar-15a-side", "σ 0°, from the right"),
            ("oren-nayar-15b-side", "σ 40°, from the right"),
        ),
        "Chosen here: shapes and places, σ 40°, ρ 0.7, ground and wall.",
    ),
)


def names(of: Iterable[Shown] | None = None) -> list[str]:
    """Every scene of some figures, or of all, once, in their order."""
    return list(dict.fromkeys(name for shown in (SHOWN if of is None else of) for name, _ in shown.pictures))


def scene_file(name: str) -> Path:
    """The scene file of a picture."""
    return Path(str(files("gonio_validation.papers.pictures").joinpath("scenes", f"{name}.toml")))
