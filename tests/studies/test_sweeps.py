"""The bench of sweeps: a rig without frames that is like the one with them, plans, interpolation, and the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.report.drawing import Drawing

from gonio.errors import ConfigError, Incomplete
from gonio.geometry import Directions
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import Plan, assess, canonical
from gonio.lab.reduction import brdf
from gonio.samples.description import SampleDescription
from tools.studies import sweeps, sweeps_page, sweeps_rig
from tools.studies.sweeps_rig import FrameFreeRig

SIM = find_rig("sim").description


def test_without_frames_values_scatter_as_with_them(tmp_path: Path) -> None:
    rig = find_rig("sim")
    small = {
        "camera": SIM.camera.model_copy(update={"width": 64, "height": 48, "pixel_um": 40.0}),
        "reference": SIM.reference.model_copy(update={"every": 40}),
    }
    rig = type(rig)(rig.plugin, SIM.model_copy(update=small), rig.source)
    points = tuple(canonical(30.0, 0.0, float(r), 180.0) for r in (-60, -10, 20, 40, 70))
    plan = Plan("both", (500.0,), points, 0, "plan")
    model, keys = sweeps_rig.SAMPLES["matte"]
    sample = SampleDescription.model_validate({"name": "matte", "model": model, "parameters": keys})
    table = brdf.reduce(carry_out(plan, rig, tmp_path / "run", sample=sample, seed=3))

    band = rig.description.bands.containing(500.0)
    free = FrameFreeRig(rig.description, band, sweeps_rig.sample("matte"), (3,), 1)
    measured = free.measure([a.pose for a in assess(plan, rig.description) if a.pose is not None])
    # what a point's noise is: the reduction has the encoder's part and the slope's, beside that of the frames
    u_rel, stated = measured.values.u_noise / measured.values.brdf, table["u_random"] / table["brdf"]
    assert np.median(u_rel / stated) == pytest.approx(1.0, abs=0.15)
    # both are the same sample through the same cones: pulls of independent noise, scales and zeros apart
    for values, at, u in (
        (table["brdf"], Directions.from_table(table), table["u_brdf"]),
        (measured.values.brdf, measured.values.directions, np.hypot(table["u_brdf"], measured.values.u_noise)),
    ):
        pull = (np.asarray(values) - free.truth(at)) / np.asarray(u)
        assert np.abs(pull).max() < 4.0  # one in 16 000 of a normal distribution
    with_frames = table["s_reference"].to_numpy() / table["brdf"].to_numpy()
    scale = measured.values.common["s_reference"] / measured.values.brdf
    np.testing.assert_allclose(with_frames, scale, rtol=1e-6)  # the certificate's, in both


@pytest.mark.parametrize("name", ["uniform", "mirror-dense", "half-vector"])
@pytest.mark.parametrize("geometry", ["in plane", "hemisphere"])
def test_plans_have_their_size_and_the_dense_ones_are_dense(name: str, geometry: Any) -> None:
    size = sweeps_rig.SIZES[geometry][0]
    points = sweeps_rig.fixed(name, geometry, size, SIM)
    count = size * len(sweeps_rig.INCIDENCES[geometry])
    assert 0.8 * count < len(points) < 1.3 * count  # rings and azimuths are whole numbers; the cone leaves points out
    offset = np.degrees([float(a.point.directions.mirror_offset) for a in points])
    share = (offset < 12.5).mean()
    assert (share > 0.3) == (name != "uniform")


def test_the_usual_interpolation_goes_through_its_points() -> None:
    for geometry in ("in plane", "hemisphere"):
        free = FrameFreeRig(SIM, SIM.bands.containing(500.0), sweeps_rig.sample("satin"), (1,), 0)
        points = sweeps_rig.fixed("uniform", geometry, 20, SIM)
        values = free.measure([a.pose for a in points if a.pose is not None]).values
        again = sweeps_rig.interpolated(values, values.directions)
        np.testing.assert_allclose(again, values.brdf, rtol=1e-9)  # rounding of logarithms and triangles


def record(seed: int) -> dict[str, Any]:
    """A comparison as it might come out."""
    keys = ("plan", "way", "points", "seconds", "rms", "largest", "inside", "u_rel")
    rows = [
        ("uniform", "interpolated", 120, 600.0, 0.006, 0.02, None, None),
        ("uniform", "process", 120, 600.0, 0.004, 0.02, 0.95, 0.004),
        ("adaptive", "process", 20, 200.0, 0.03, 0.2, 0.9, 0.01),
        ("adaptive", "process", 60, 300.0, 0.005, 0.02, 0.96 - 0.1 * seed, 0.004),
        ("adaptive by points", "process", 54, 290.0, 0.0055, 0.02, 0.94, 0.004),
    ]
    results = [dict(zip(keys, row, strict=True)) for row in rows]
    return {"format": 1, "sample": "matte", "geometry": "in plane", "seed": seed, "seconds": 9.0, "results": results}


def test_the_page_has_what_the_records_say(tmp_path: Path) -> None:
    summary = sweeps.summary([record(0), record(1)], seeds=2, command="python -m tools.studies sweeps")
    (by_points,) = summary["by_points"]
    assert by_points.holds
    assert by_points.allowed == pytest.approx(0.006)
    together = next(h for h in summary["held"] if h.sample == "all")
    assert together.runs == 4
    assert together.inside == pytest.approx((0.96 + 0.94 + 0.86 + 0.94) / 4)
    assert not together.holds
    last = [v for v in summary["levels"] if v["plan"] == "adaptive"][-1]
    assert (last["points"], last["runs"]) == (60, 2)
    sweeps.write(summary, tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert "on 1 of 1 samples" in page
    assert json.loads((tmp_path / "results.json").read_text())["by_points"][0]["adaptive"] == by_points.adaptive
    assert (tmp_path / "points.csv").read_text().count("\n") == 6


@pytest.mark.parametrize("broken", ["drawn", "_panels", "_lead", "render", "_method"])
def test_what_fails_late_is_named_and_takes_nothing_along(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*given: object) -> None:
        raise ZeroDivisionError("late")

    monkeypatch.setattr(sweeps_page, broken, fails)
    with pytest.raises(Incomplete, match="ZeroDivisionError: late"):
        sweeps.write(sweeps.summary([record(0), record(1)], seeds=2), tmp_path)
    page = (tmp_path / "index.html").read_text()
    assert "What is missing" in page
    assert ("on 1 of 1 samples" in page) == (broken in ("drawn", "_panels"))
    results = json.loads((tmp_path / "results.json").read_text())
    assert results["failed"][0]["error"] == "ZeroDivisionError: late"
    assert results["by_points"]
    assert (tmp_path / "points.csv").read_text().count("\n") == 6
    monkeypatch.undo()
    sweeps.write(sweeps.summary([record(0), record(1)], seeds=2), tmp_path)  # replaces it
    assert "What is missing" not in (tmp_path / "index.html").read_text()


def test_a_figure_that_cannot_be_drawn_leaves_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Drawing, "rendered", lambda self: 1 / 0)
    with pytest.raises(Incomplete, match='figure "in-plane" could not be made'):
        sweeps.write(sweeps.summary([record(0), record(1)], seeds=2), tmp_path)
    assert "on 1 of 1 samples" in (tmp_path / "index.html").read_text()
    assert not (tmp_path / "in-plane.svg").exists()


def test_too_many_points_or_too_large_an_error_is_no() -> None:
    def by_points(points: float, error: float) -> bool:
        return sweeps_page.ByPoints("matte", 1, 120.0, points, 0.004, 0.003, error).holds

    assert by_points(54, 0.0049), "half a percent is enough, whatever the grid has"
    assert not by_points(55, 0.001)
    assert not by_points(54, 0.0051)


def test_a_folder_of_other_things_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("dear")
    with pytest.raises(ConfigError, match="holds something else than comparisons"):
        sweeps.make(tmp_path, quick=True)
    with pytest.raises(ConfigError, match="--seeds 0"):
        sweeps.make(tmp_path / "new", seeds=0)
    assert not (tmp_path / "new").exists()
