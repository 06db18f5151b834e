"""The papers' pictures: every scene file renders, and what the texts say of them, measured at low resolution."""

from __future__ import annotations

import json
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from gonio_scenes.picture import display
from gonio_validation.papers.pictures import catalogue, centre, htsg, sheet
from gonio_validation.papers.pictures import page as pictures
from gonio_validation.papers.pictures.catalogue import SHOWN, names, scene_file
from gonio_validation.papers.pictures.cook_torrance import ambient_as_printed

from tests.command_line import gonio

pytestmark = pytest.mark.slow

OPEN = None
"""It hangs on a value that the paper does not state, so there is no verdict."""
ROWS = 64
"""Of the pictures that are measured here, but for those whose objects are too small then."""


def judge(figure: str, expected: dict[str, bool | None], rows: int = ROWS) -> None:
    """Hold each claim of a figure against what is expected of it; claims are named by words of theirs."""
    found = {}
    for claim in pictures.claims(figure, rows):
        named = [words for words in expected if words in claim.text]
        assert len(named) == 1, f"{claim.text!r} is named by {named}"
        found[named[0]] = claim.holds
    assert found == expected


# --- scene files --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", names())
def test_every_scene_file_renders(name: str) -> None:
    def small(tables: dict[str, object]) -> None:
        camera = tables["camera"]
        assert isinstance(camera, dict)
        camera |= {"width": 16, "height": 16}

    taken = centre.centre(name, change=small)
    assert taken.radiance.shape[:2] == (16, 16)
    assert np.isfinite(taken.radiance).all()
    assert (taken.radiance >= 0.0).all()
    shown, _ = display(taken.scene, taken.radiance)
    assert shown.max() > 60  # not a black picture: a quarter of the screen's range
    assert scene_file(name).read_text(encoding="utf-8").startswith("# ")  # says what it is, and what is not the paper's


def test_no_scene_file_is_left_over() -> None:
    there = {path.stem for path in scene_file(names()[0]).parent.glob("*.toml")}
    assert there == set(names())


def test_cylinders_differ_in_their_material_alone() -> None:
    rest = []
    for name in [f"htsg-12{letter}" for letter in "abcdef"]:
        tables = tomllib.loads(scene_file(name).read_text(encoding="utf-8"))
        material = tables["material"].pop("aluminium")
        tables.pop("name")
        rest.append(tables)
        given = material["parameters"]
        expected = (
            (2.5, 16.0)
            if name.endswith("f")
            else ({"a": 0.18, "b": 0.28, "c": 0.38, "d": 0.48, "e": 0.58}[name[-1]], 3.0)
        )
        assert (given["sigma0_um"], given["tau_um"], given["ior"]) == (*expected, "Al")
        assert "diffuse_albedo" not in given  # a = 0
    assert all(tables == rest[0] for tables in rest)


# --- what the texts say -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "verdicts", "rows"),
    [
        (
            "htsg-12",
            {
                "sharp specular image": True,
                "is not blurred": True,
                "spreads out": True,
                "specular at grazing angles": True,
                "blue shift": False,  # the highlight is neutral in its middle and redder around it
                "red shift": OPEN,
            },
            ROWS,
        ),  # the highlight is neutral in its middle and redder around it
        (
            "htsg-13",
            {"Fresnel reflectivity": True, "Specular images are apparent": True, "striking differences": True},
            ROWS,
        ),
        ("htsg-14", {"faces of the cube": True, "table top": True, "glossy highlights": True}, ROWS),
        ("cook-torrance-6", {"white specular component": True, "has a copper color": True, "color shift": True}, ROWS),
        (
            "cook-torrance-7",
            {"color of the material": True, "Table I": True, "plastic appearance": True},
            160,
        ),  # a vase is a seventh of the picture high
        (
            "cook-torrance-8",
            {"made of gold": True, "rougher surface": True, "640 nanometer": OPEN},
            160,
        ),  # a bar of a digit is one millimetre wide
        ("blinn-7a", {"Both Models Essentially Same": True, "only for shallow angles": True}, ROWS),
        (
            "blinn-7b",
            {
                "Both Models Essentially Same": OPEN,
                "almost perpendicularly": True,
                "almost tangentially": True,
                "much higher there": OPEN,
            },
            ROWS,
        ),
        ("blinn-8", {"Surface shininess varying": OPEN}, ROWS),
        (
            "oren-nayar-12",
            {"nearly constant": True, "drops quickly to zero": False, "large brightness errors": True},
            ROWS,
        ),
        ("oren-nayar-13", {"asymmetric": True, "drop much faster": True, "brightness peak": True}, ROWS),
        ("oren-nayar-14", {"appears Lambertian": True, "appear flatter": True, "flat disc": OPEN}, ROWS),
        (
            "oren-nayar-15",
            {
                "strong brightness variations": True,
                "distinctly different": OPEN,
                "three faces of the cube [is] reduced": True,
                "flat and curved sections": True,
            },
            ROWS,
        ),
    ],
)
def test_what_the_texts_say_of_a_picture(name: str, verdicts: dict[str, bool | None], rows: int) -> None:
    judge(name, verdicts, rows=rows)


def test_htsg_12_images_are_held_against_a_mirror_under_the_same_lights() -> None:
    """On the top of (a) exp(-g) is 0.42 to 0.57 at 700 nm; a mirror without ambient light on the bricks gives 0.66."""
    seen = htsg._images(ROWS, htsg.CAMERAS_MM[0])
    assert 0.42 < seen.strengths[0] < 0.57


def test_cook_torrance_prints_too_much_ambient_light() -> None:
    # R_a I_ia against d R_d (N.L) I d omega: pi F_0 0.01 over 0.9 F_0 (2e-4 cos + 1e-4 cos) is more than 100
    assert ambient_as_printed(ROWS) > 50.0


# --- measures -----------------------------------------------------------------------------------------------------


def test_edges_tell_fainter_from_blurred() -> None:
    """On pictures whose strength and blur are known."""
    random = np.random.default_rng(1)
    picture = random.random((40, 50))
    everywhere = np.ones(picture.shape, dtype=bool)
    fade = np.linspace(0.1, 0.5, 40)[:, None]  # from row to row, as a reflectivity over the angle
    strength, alike = centre.edges(fade * picture + 3.0, everywhere, picture)
    assert 0.1 < strength < 0.5
    assert alike == pytest.approx(1.0, abs=1e-12)  # rounding
    _, alike = centre.edges(centre.blurred(picture, everywhere), everywhere, picture)
    # white noise blurred over n pixels: its steps correlate with the sharp ones by 1/sqrt(n) times a half and less
    assert alike < 0.5


# --- the page -----------------------------------------------------------------------------------------------------


def test_page_has_every_picture_and_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = tuple(s for s in SHOWN if s.name in ("blinn-8", "oren-nayar-14"))
    for module in (catalogue, pictures, sheet):
        monkeypatch.setattr(module, "SHOWN", shown)
    small = tmp_path / "scenes"
    small.mkdir()
    for name in catalogue.names():
        text = scene_file(name).read_text(encoding="utf-8")
        for key in ("width", "height"):
            start = text.index(f"\n{key} = ")
            text = text[:start] + f"\n{key} = 48" + text[text.index("\n", start + 1) :]
        (small / f"{name}.toml").write_text(text, encoding="utf-8")
    for module in (catalogue, pictures, centre):
        monkeypatch.setattr(module, "scene_file", lambda name: small / f"{name}.toml")
    monkeypatch.setattr(
        pictures, "_cross_sections", lambda: pictures._raster("plot", "a plot", np.zeros((8, 8, 3), np.uint8))
    )
    monkeypatch.setattr("gonio_validation.papers.pictures.cook_torrance.ambient_as_printed", lambda height: 1.0)
    told: list[tuple[int, int]] = []
    page = pictures.make(
        tmp_path / "page", command="gonio figures pictures", step=lambda done, of: told.append((done, of))
    )
    text = page.read_text(encoding="utf-8")
    summary = json.loads((page.parent / "summary.json").read_text(encoding="utf-8"))
    assert [f["figure"] for f in summary["figures"]] == ["blinn-8", "oren-nayar-14"]
    for figure in summary["figures"]:
        assert figure["claims"]
        for name in figure["pictures"]:
            assert (page.parent / "pictures" / f"{name}.png").is_file()
            assert (page.parent / "scenes" / f"{name}.toml").is_file()
            assert name in summary["seconds"]
    assert text.count("data:image/jpeg") == 6
    assert "full moon" in text
    assert (page.parent / "contact_sheet.png").stat().st_size > 10_000
    assert told[-1][0] == told[-1][1]
    assert all(a[0] <= b[0] for a, b in pairwise(told))
    page = pictures.make(tmp_path / "one", figure="blinn-8")
    summary = json.loads((page.parent / "summary.json").read_text(encoding="utf-8"))
    assert (summary["title"], [f["figure"] for f in summary["figures"]]) == (shown[0].title, ["blinn-8"])
    assert sorted(p.stem for p in (page.parent / "pictures").iterdir()) == sorted(n for n, _ in shown[0].pictures)


def test_every_rendered_figure_goes_by_its_own_name(tmp_path: Path) -> None:
    """Kind: what a list of names leaves out. A missing --out is said before anything is rendered."""
    listed = gonio(tmp_path, "figures", "list", expect=0).stdout
    for one in SHOWN:
        assert f"{one.name} " in listed
    for one in SHOWN[:2]:
        assert f"figures {one.name}: --out DIR is missing" in gonio(tmp_path, "figures", one.name, expect=2).stderr
