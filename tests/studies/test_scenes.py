"""The study `scenes`: its report, and that Mitsuba 3 renders the same scenes alike where it is installed."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_scenes import mitsuba
from gonio_scenes.render import render
from gonio_validation.bench import timing
from typer.testing import CliRunner

from gonio import measurement, models
from gonio.config import to_toml
from gonio.formats.reader import table
from gonio.typing import Floats
from tests.gonio_scenes.scenes import scene
from tools.studies import mitsuba_pictures, scenes

installed = pytest.mark.skipif(
    mitsuba_pictures.find()[1] == [], reason="Mitsuba 3 is not installed (pip install gonio[peers])"
)


def test_scores_are_in_standard_errors_of_a_tile() -> None:
    ours, theirs = np.full((8, 16), 2.0), np.full((8, 16), 2.0)
    theirs[:, 8:] += 0.1
    error = np.full((8, 16), 0.4)  # 0.05 of a tile's mean
    found = mitsuba_pictures.scores(ours, 0.6 * error, theirs, 0.8 * error)
    np.testing.assert_allclose(found, [[0.0, -2.0]], rtol=1e-6, atol=1e-12)  # float32's rounding is added
    # without any noise float32's rounding is what they may differ by
    exact = mitsuba_pictures.scores(ours, 0.0 * error, ours * (1.0 + 1e-6), 0.0 * error)
    assert np.abs(exact).max() < 1.0


def test_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tools.studies.__main__ import app

    small = scenes.Effort(16, 64, (1, 8), (0.05,), 1, 16, 8, 2)
    monkeypatch.setattr(scenes, "QUICK", small)
    monkeypatch.setattr(scenes, "METALS", dict(list(scenes.METALS.items())[:1]))
    monkeypatch.setattr(scenes, "SHIFTED", ("Cu",))
    monkeypatch.setattr(scenes, "SHARED", ("Lambert",))
    monkeypatch.setattr(mitsuba_pictures, "find", lambda: ("not installed", []))
    out = tmp_path / "bench"
    result = CliRunner().invoke(app, ["scenes", "--quick", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(out / "index.html")
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    page = (out / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!#)', page)  # nothing is loaded
    assert summary["mitsuba"] == "not installed"
    for row in summary["samples"]:
        assert row["seconds"] > 0
        assert (row["stated"] is None) == (row["rays"] == 1)
    errors = [row["xyz"] for row in summary["bins"]]
    assert errors == sorted(errors, reverse=True)  # each number of wavelengths is better than the one before
    exact = {row["way"]: row["worst"] for row in summary["ways"]}
    assert exact["exact"] == 0.0 < exact["functional"] < exact["qualitative"]
    with open(out / "tables" / "tolerances.csv", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["tolerance"]) for row in rows] == [row["tolerance"] for row in summary["tolerances"]]


def test_progress_counts_every_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mitsuba_pictures, "find", lambda: ("", []))
    monkeypatch.setattr(scenes, "METALS", {})
    monkeypatch.setattr(scenes, "WAYS", {})
    monkeypatch.setattr(scenes, "SHIFTED", ())
    monkeypatch.setattr(timing, "machine", lambda: None)
    seen: list[tuple[int, int]] = []
    effort = scenes.Effort(8, 4, (1,), (0.5,), 1, 8, 4, 2)
    scenes.collect(effort, quick=True, command="", step=lambda done, total: seen.append((done, total)))
    assert seen == [(k + 1, len(seen)) for k in range(len(seen))]


# --- Mitsuba ------------------------------------------------------------------------------------------------------

CAMERA = scenes.CAMERA | {"width": 48, "height": 48, "samples": 64}
MATT = {"m": {"model": "lambert", "parameters": {"albedo": 0.7}}, "floor": scenes.FLOOR}
FLOOR = {"kind": "plane", "material": "floor"}
BALL = {"kind": "sphere", "center_mm": [0.0, 0.0, 40.0], "radius_mm": 40.0, "material": "m"}
POINT = {"kind": "point", "position_mm": [-250.0, -200.0, 300.0], "intensity": 2e5}
CASES: dict[str, dict[str, Any]] = {
    "sphere, parallel light": {"shape": [FLOOR, BALL], "light": [scenes.SUN]},
    "sphere, three lights": {"shape": [FLOOR, BALL], "light": [scenes.SUN, scenes.LAMP, POINT]},
    "cylinder, disc of light": {
        "shape": [
            FLOOR,
            {"kind": "cylinder", "axis": [1.0, 1.0, 0.0], "center_mm": [0.0, 0.0, 30.0], "radius_mm": 30.0,
             "height_mm": 90.0, "material": "m"},
        ],
        "light": [scenes.LAMP],
    },
    "box, disc and point": {
        "shape": [
            FLOOR,
            {"kind": "box", "x_axis": [1.0, 0.4, 0.0], "center_mm": [0.0, 0.0, 30.0], "size_mm": [80.0, 50.0, 60.0],
             "material": "m"},
        ],
        "light": [scenes.LAMP, POINT],
    },
    "vase": {
        "shape": [
            FLOOR,
            {"kind": "revolution", "profile_mm": [[0, 0], [25, 10], [40, 30], [20, 50], [35, 80]], "smooth": True,
             "material": "m"},
        ],
        "light": [scenes.LAMP, scenes.SUN],
    },
    "disc behind a lens": {
        "shape": [
            FLOOR,
            {"kind": "disc", "center_mm": [0.0, 0.0, 30.0], "normal": [0.3, -0.5, 1.0], "radius_mm": 60.0,
             "material": "m"},
        ],
        "light": [scenes.SUN],
        "camera": CAMERA | {"lens_radius_mm": 20.0, "focus_mm": 700.0},
    },
    "a lamp in a mirror": {
        "shape": [BALL],
        "material": {"m": {"model": "he-torrance", "parameters": {"sigma0_um": 0.0, "tau_um": 2.0, "ior": "Al"}}},
        "light": [scenes.LAMP],
    },
    "copper at three wavelengths": {
        "shape": [FLOOR, BALL],
        "material": {
            "m": scenes.METALS["Cook-Torrance, copper"],
            "floor": {"model": "lambert",
                      "parameters": {"albedo": {"wavelength_nm": [400, 700], "value": [0.1, 0.7]}}},
        },
        "light": [scenes.SUN | {"spectrum": "D65"}],
        "wavelength_nm": [450.0, 550.0, 650.0],
    },
    "a white sphere in ambient light": {
        "shape": [BALL],
        "material": {"m": {"model": "lambert", "parameters": {"albedo": 0.7}, "ambient_reflectance": 0.7}},
        "light": [{"kind": "ambient", "radiance": 1.0}],
    },
}  # fmt: skip


def apart(ours_scene: Any, made: mitsuba.Export, folder: Path) -> Floats:
    """Scores of the tiles at every wavelength of the first file."""
    for name, data in made.files.items():
        (folder / name).write_bytes(data)
    (variant,) = [v for v in mitsuba_pictures.find()[1] if v.name == mitsuba_pictures.SCALAR]
    theirs = mitsuba_pictures.rendered(folder / next(iter(made.scenes)), samples=32, runs=8, variant=variant)
    ours = render(ours_scene)
    assert ours.error is not None
    assert theirs.radiance.mean() > 0.0
    pictures = (ours.radiance, ours.error, theirs.radiance, theirs.error)
    waves = range(ours.radiance.shape[-1])
    return np.stack([mitsuba_pictures.scores(*(picture[..., k] for picture in pictures)) for k in waves])


@installed
@pytest.mark.parametrize("case", CASES)
def test_mitsuba_agrees_within_three_standard_errors(case: str, tmp_path: Path) -> None:
    made = scene(**{"camera": CAMERA, "material": MATT, **CASES[case]})
    score = apart(made, mitsuba.export(made), tmp_path)
    # 36 tiles: one in ten such pictures has one beyond three by chance, and these seeds have none
    assert np.abs(score).max() < 3.0


PAINT = {"albedo": {"red": 0.7, "green": 0.4, "blue": 0.1}, "sigma_deg": 25.0}


def table_of(model: str, **parameters: Any) -> pd.DataFrame:
    """A model measured in and out of the plane of incidence."""
    theta_i, theta_r, phi_r = (
        a.ravel() for a in np.meshgrid(np.arange(0, 81, 10), np.arange(0, 81, 5), np.arange(0, 181, 30), indexing="ij")
    )
    brdf = models.build(model, parameters).brdf(*np.deg2rad([theta_i, 0 * theta_i, theta_r, phi_r]))
    return table(theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, wavelength_nm=550.0,
                 brdf=brdf, attrs={"sample": "m"})  # fmt: skip


@installed
@pytest.mark.parametrize("kind", ["table", "colours"])
def test_mitsuba_agrees_on_materials_from_files(kind: str, tmp_path: Path) -> None:
    """A measured table, and a sample in three channels."""
    waves = [465.0, 550.0, 610.0] if kind == "colours" else [550.0]
    name = "m.csv" if kind == "table" else "m.toml"
    if kind == "table":
        measurement.write(table_of("cook-torrance", m=0.3, ior=1.5, diffuse_albedo=0.4), tmp_path / name)
    else:
        (tmp_path / name).write_text(to_toml({"name": "m", "model": "oren-nayar", "parameters": PAINT}))
    material = {"m": {"file": name}, "floor": scenes.FLOOR}
    what = {"material": material, "shape": [FLOOR, BALL], "light": [scenes.SUN], "wavelength_nm": waves}
    made = scene(tmp_path, camera=CAMERA, **what)
    assert np.abs(apart(made, mitsuba.export(made), tmp_path)).max() < 3.0


@pytest.mark.parametrize(
    ("material", "largest", "rms"), [("Cu", 0.43, 0.072), ("Au", 0.59, 0.092), ("Al", 0.080, 0.023)]
)
def test_errors_that_the_docs_state(material: str, largest: float, rms: float) -> None:
    """docs/colour.md has these, to two digits."""
    assert scenes.shift_error(np.arange(380.0, 781.0, 5.0), material) == pytest.approx((rms, largest), rel=0.02)


def test_the_short_procedure_is_exact_for_a_grey_dielectric() -> None:
    assert max(scenes.shift_error(np.linspace(400.0, 700.0, 31), 1.5)) < 1e-12  # rounding
