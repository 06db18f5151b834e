"""What Blinn says of Figs. 7 and 8, measured in the pictures."""

import numpy as np
from gonio_analysis.report.text import number

from gonio.models import Blinn, Phong
from gonio.typing import Floats, TomlTable
from gonio_validation.papers.figure import Claim, agreed
from gonio_validation.papers.pictures.centre import Centre, Change, centre

SAME = 0.1
"""Mean difference, over the mean brightness, below which two pictures are essentially the same."""


def _models(letter: str, lit: str, height: int | None, change: Change | None = None) -> tuple[Centre, Centre]:
    """Phong's picture and Torrance and Sparrow's."""
    return (
        centre(f"blinn-7{letter}-phong-{lit}", height=height, change=change),
        centre(f"blinn-7{letter}-facets-{lit}", height=height),
    )


def _base(c: Centre) -> Floats:
    """The diffuse part of the brightness, and what ambient light adds, at the lit pixels."""
    model = c.scene.material[0].model
    assert isinstance(model, (Blinn, Phong))
    light = c.scene.lights[0]
    cosine = np.maximum(c.facing @ light.toward, 0.0)  # type: ignore[union-attr]
    return np.asarray(model.k_d / np.pi * cosine * float(light.power[0]))


def _direct(c: Centre) -> Floats:
    """The brightness without ambient light."""
    assert c.scene.ambient is not None
    given = c.scene.tables.material["goblet"].ambient_reflectance
    assert isinstance(given, float)
    return np.where(c.on("goblet"), c.grey() - float(c.scene.ambient[0]) * given, 0.0)


def _highlight(c: Centre) -> float:
    """The strongest highlight, over what the diffuse part has at normal incidence."""
    direct = _direct(c)
    model = c.scene.material[0].model
    assert isinstance(model, (Blinn, Phong))
    lit = direct > 0.0
    return float((direct - _base(c))[lit].max() / (model.k_d / np.pi))


def _difference(phong: Centre, facets: Centre) -> float:
    """Mean difference of two pictures over the mean brightness, where the object is lit."""
    a, b = _direct(phong), _direct(facets)
    lit = (a > 0.0) | (b > 0.0)
    return float(np.abs(a - b)[lit].mean() / (0.5 * (a + b))[lit].mean())


def _as_printed(letter: str) -> Change:
    weight = {"a": 0.4, "b": 0.667}[letter]

    def change(tables: TomlTable) -> None:
        tables["material"]["goblet"]["parameters"]["k_s"] = weight

    return change


def _front(letter: str, height: int | None) -> Claim:
    """Whether the two models are alike, lit from the front."""
    found = {
        "p_s F(0)": _difference(*_models(letter, "front", height)),
        "p_s": _difference(*_models(letter, "front", height, _as_printed(letter))),
    }
    return Claim(
        "Front lit: “Both Models Essentially Same”.",
        agreed(v < SAME for v in found.values()),
        "mean difference over the mean brightness: "
        + ", ".join(f"{100 * v:.1f} % (Phong's weight {words})" for words, v in found.items()),
        f"less than {100 * SAME:.0f} %; hangs on the weight of Phong's highlight, which the text does not give",
    )


def figure_7a(height: int | None = None) -> list[Claim]:
    """Aluminium."""
    weights = {"p_s F(0)": None, "p_s": _as_printed("a")}
    both = {
        words: [_difference(*_models("a", lit, height, change)) for lit in ("edge", "front")]
        for words, change in weights.items()
    }
    return [
        _front("a", height),
        Claim(
            "“The new function will be materially different only for shallow angles of incident light.”",
            agreed(edge > 2.0 * front for edge, front in both.values()),
            "mean difference from Phong's picture: "
            + "; ".join(
                f"{100 * edge:.0f} % edge lit, {100 * front:.1f} % front lit (Phong's weight {words})"
                for words, (edge, front) in both.items()
            ),
            "more than twice as different where the object is edge lit; hangs on the weight of Phong's highlight",
        ),
    ]


def figure_7b(height: int | None = None) -> list[Claim]:
    """Magnesium oxide."""
    phong, ceramic = _models("b", "edge", height)
    _, metal = _models("a", "edge", height)
    shallow = {angle: (_grazing("b", height, angle), _grazing("a", height, angle)) for angle in ALMOST_TANGENTIAL}
    normal = _highlight(_models("b", "front", height)[1])
    metal_normal = _highlight(_models("a", "front", height)[1])
    edge = {"ceramic": _highlight(ceramic), "aluminium": _highlight(metal)}
    printed, _ = _models("b", "edge", height, _as_printed("b"))
    bright = [float(_direct(ceramic).max() / _direct(other).max()) for other in (phong, printed)]
    return [
        _front("b", height),
        Claim(
            "“The ceramic looks quite diffuse for light hitting it almost perpendicularly.”",
            normal < 0.25 < metal_normal,
            f"front lit, the highlight has {number(normal, 2)} of the diffuse brightness "
            f"(aluminium {number(metal_normal, 2)})",
            "less than a quarter, which aluminium's exceeds",
        ),
        Claim(
            "“… and very specular (even more so than the aluminum) for light hitting it almost tangentially.”",
            agreed(a > b for a, b in shallow.values()),
            "strongest highlight over the diffuse brightness at normal incidence, ceramic and aluminium, by the "
            "light's angle to the line of sight: "
            + "; ".join(f"{angle:g}° {number(a)}, {number(b)}" for angle, (a, b) in shallow.items())
            + f"; in the pictures above, with the light less far behind: {number(edge['ceramic'])} and "
            f"{number(edge['aluminium'])}",
            "the ceramic's is the stronger, beside its diffuse part, wherever facets mirror light within 10° of "
            "tangential; how far that goes was chosen here",
        ),
        Claim(
            "Edge lit, “the specular reflection will be much higher there” than Phong's.",
            agreed(b > 1.5 for b in bright),
            f"the brightest spot has {number(bright[0])} times the radiance of Phong's (his weight p_s F(0)), "
            f"{number(bright[1])} times (p_s)",
            "more than 1.5 times; hangs on the weight of Phong's highlight, which the text does not give",
        ),
    ]


ALMOST_TANGENTIAL = (160.0, 165.0, 170.0, 175.0)
"""Angles of the light to the line of sight [deg]: facets mirror it at half of them."""


def _grazing(letter: str, height: int | None, angle_deg: float) -> float:
    """The strongest highlight where the light comes from behind, at this angle to the line of sight."""

    def behind(tables: TomlTable) -> None:
        camera = tables["camera"]
        view = np.subtract(camera["position_mm"], camera["look_at_mm"])
        view = view / np.linalg.norm(view)
        angle = np.radians(angle_deg)
        tables["light"][0]["toward"] = (np.cos(angle) * view + np.sin(angle) * np.array([1.0, 0.0, 0.0])).tolist()

    return _highlight(centre(f"blinn-7{letter}-facets-edge", height=height, change=behind))


def figure_8(height: int | None = None) -> list[Claim]:
    """Textured shininess."""
    found = {}
    for name, words in (("blinn-8a", "checker"), ("blinn-8b", "dots")):
        given = centre(name, height=height)
        shiny, dull = (centre(name, height=height, change=_everywhere(c)) for c in (0.4, 1.0))
        where = given.on("sphere")
        a, b, seen = (c.grey()[where] for c in (shiny, dull, given))
        # each pixel of the picture is one of the two; a wholly dull surface keeps the normalisation by c_min
        near = a > b
        found[words] = (
            float(np.mean(seen[near] > 0.5 * (a + b)[near])),
            float(seen[near].max() / seen[near].min()),
            float(near.mean()),
        )
    return [
        Claim(
            "“Surface shininess varying as a function of two different texture patterns.”",
            None,
            "; ".join(
                f"{words}: the shiny parts are the brighter ones over {100 * lit:.0f} % of the sphere, where they "
                f"cover {100 * share:.0f} %; outside the dull parts are brighter"
                for words, (share, _, lit) in found.items()
            ),
            "a dull surface spreads its highlight, so that the order turns round outside of it; textures, c_min and "
            "light were chosen here, so that it is seen",
        )
    ]


def _everywhere(c: float) -> Change:
    """The whole surface of one shininess, normalised as the texture's smallest value is."""

    def change(tables: TomlTable) -> None:
        texture = tables["material"]["sphere"]["textures"]["c"]
        ends = {texture.get("low", 0.0), texture.get("high", 1.0)}
        parameters = tables["material"]["sphere"]["parameters"]
        del tables["material"]["sphere"]["textures"]
        parameters["c"] = c
        parameters["k_s"] *= (min(ends) / c) ** 2

    return change
