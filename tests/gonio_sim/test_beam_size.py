"""Beams larger and smaller than the region: both give the sample's BRDF; an edge in the region is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM_IDEAL

from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import load_plan
from gonio.acquisition.run import Run
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.reduction import brdf
from gonio.rig import beam_size
from gonio.rig.description import RigDescription
from gonio.rig.imaging import pixel_map
from gonio.rig.inverse_kinematics import reach
from gonio.rig.kinematics import view
from tests.gonio_sim.conftest import MATTE, describe

SMALL = {"width": 128, "height": 96}


def rig(beam_mm: float | None, roi_mm: float = 0.8, **more: Any) -> RigDescription:
    return describe(
        "sim-ideal", camera=SMALL, lamp={"beam_diameter_mm": beam_mm}, acquisition={"roi_radius_mm": roi_mm}, **more
    )


def measured(folder: Path, description: RigDescription, theta_i: str, theta_r: str) -> Run:
    text = f'name = "p"\nwavelength_nm = [550.0]\n[[sweep]]\ntheta_i_deg = {theta_i}\ntheta_r_deg = {theta_r}\n'
    (folder / "plan.toml").write_text(text)
    choice = RigChoice(SIM_IDEAL, description, "sim-ideal")
    plan = load_plan(folder / "plan.toml")
    return carry_out(plan, choice, folder / "run", sample=MATTE, seed=1, command="gonio measure")


@pytest.mark.parametrize(
    ("beam_mm", "known_mm", "kind"),
    [(None, None, "over"), (1.8, 1.8, "over"), (0.7, 0.7, "under"), (0.7, 0.735, "under")],
)
def test_both_fillings_give_the_truth(tmp_path: Path, beam_mm: float | None, known_mm: float | None, kind: str) -> None:
    """A Lambertian sample of albedo 0.5; also where the diameter of a narrow beam is known 5 % wrong: it cancels."""
    description = rig(known_mm)
    if beam_mm != known_mm:
        (tmp_path / "truth.toml").write_text(f"[lamp]\nbeam_diameter_mm = {beam_mm}\n")
        description = description.model_copy(update={"truth": str(tmp_path / "truth.toml")})
    table = brdf.reduce(measured(tmp_path, description, "[0.0, 40.0, 58.0]", "[-30.0, 20.0, 70.0]"))
    assert (table["flag"] == "").all()
    # 0.1 %: the pixels at the edge of a spot of 16 pixels across; without an edge whole DN are all that is left
    np.testing.assert_allclose(table["brdf"], 0.5 / np.pi, rtol=1e-3 if kind == "under" else 1e-4)
    assert table.attrs["provenance"]["filling"] == kind


def test_an_edge_that_cuts_through_the_region_is_flagged_in_the_plan(tmp_path: Path) -> None:
    """A beam of 1 mm reaches 0.5 / cos(theta_i) mm in a region of 0.8 mm: whole up to some 50 degrees."""
    run = measured(tmp_path, rig(1.0), "[0.0, 40.0, 48.0, 56.0, 70.0]", "[20.0]")
    assert run.plan["flag"].tolist() == ["", "", "", "partly_filled", "partly_filled"]
    assert "cuts through" in run.plan["reason"].iloc[3]
    table = brdf.reduce(run)
    assert table["brdf"].notna().tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("beam_mm", "more", "message"),
    [
        (1.0, {"theta_i_deg": 60.0, "theta_r_deg": 0.0}, "reference: the edge of the beam's spot, 1 mm"),
    ],
)
def test_a_reference_that_the_beam_does_not_fill_is_refused(
    tmp_path: Path, beam_mm: float, more: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        measured(tmp_path, rig(beam_mm, reference=more), "[0.0]", "[20.0]")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("beam_mm", "message"), [(0.7, "lies beside"), (20.0, "reaches 11.8"), (24.0, "")])
def test_a_beam_reaches_a_reference_beside_the_sample_or_not(beam_mm: float, message: str) -> None:
    description = rig(beam_mm, reference={"how": "beside", "offset_mm": [0.0, 11.0], "diameter_mm": 2.0})
    seen = view(description, reach(description, Directions.from_degrees(0.0, 0.0, 40.0, 180.0)))
    why = beam_size.cut(description, seen, "reference")
    assert message in why if message else not why


@pytest.mark.parametrize("beam_mm", [1.59, 1.6])
def test_a_beam_as_wide_as_the_region_is_refused(tmp_path: Path, beam_mm: float) -> None:
    with pytest.raises(ConfigError, match="partly_filled"):
        measured(tmp_path, rig(beam_mm), "[0.0]", "[20.0]")


@pytest.mark.parametrize("theta_i", [0.0, 50.0])
def test_the_light_on_a_spot_is_that_of_the_beam(theta_i: float) -> None:
    """Sum over the pixels of area times irradiance: the beam's solid angle times d0^2, at any angle of incidence."""
    description = rig(1.0)
    pose = reach(description, Directions.from_degrees(theta_i, 0.0, 33.0, 180.0))
    seen = pixel_map(description, view(description, pose))
    received = np.sum(seen.area_mm2 * seen.lit * seen.cos_theta_i * seen.distance_factor)
    # pi/4 of a square millimetre, but for 1e-7 of the cone's curvature; 1e-3: the pixels at the edge
    assert received == pytest.approx(np.pi / 4, rel=1e-3)
