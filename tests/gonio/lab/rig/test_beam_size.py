"""Beams larger and smaller than the region: both give the sample's BRDF; an edge in the region is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.reduction import brdf
from gonio.lab.rig import regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.inverse_kinematics import reach
from gonio.lab.rig.kinematics import view
from tests.gonio_sim.conftest import describe, measured

SMALL = {"width": 128, "height": 96}


def rig(beam_mm: float | None, roi_mm: float = 0.8, **more: Any) -> RigDescription:
    return describe(
        "sim-ideal", camera=SMALL, lamp={"beam_diameter_mm": beam_mm}, acquisition={"roi_radius_mm": roi_mm}, **more
    )


@pytest.mark.parametrize(
    ("beam_mm", "known_mm", "kind"),
    [(None, None, "over"), (1.8, 1.8, "over"), (0.7, 0.7, "under"), (0.7, 0.735, "under")],
)
def test_both_fillings_give_the_truth(tmp_path: Path, beam_mm: float | None, known_mm: float | None, kind: str) -> None:
    """A Lambertian sample of albedo 0.5; also where the diameter of a narrow beam is known 5 % wrong: it cancels."""
    truth = None if beam_mm == known_mm else {"lamp": {"beam_diameter_mm": beam_mm}}
    table = brdf.reduce(measured(tmp_path, rig(known_mm), [0.0, 40.0, 58.0], [-30.0, 20.0, 70.0], truth=truth))
    assert (table["flag"] == "").all()
    # 0.1 %: the pixels at the edge of a spot of 16 pixels across; without an edge whole DN are all that is left
    np.testing.assert_allclose(table["brdf"], 0.5 / np.pi, rtol=1e-3 if kind == "under" else 1e-4)
    assert table.attrs["provenance"]["filling"] == kind


def test_an_edge_that_cuts_through_the_region_is_flagged_in_the_plan(tmp_path: Path) -> None:
    """A beam of 1 mm reaches 0.5 / cos(theta_i) mm in a region of 0.8 mm: whole up to some 50 degrees."""
    run = measured(tmp_path, rig(1.0), [0.0, 40.0, 48.0, 56.0, 70.0], [20.0])
    assert run.plan["flag"].tolist() == ["", "", "", "partly_filled", "partly_filled"]
    assert "cuts through" in run.plan["reason"].iloc[3]
    assert brdf.reduce(run)["brdf"].notna().tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(("beam_mm", "message"), [(0.7, "lies beside"), (20.0, "reaches 11.8"), (24.0, "")])
def test_a_beam_reaches_a_reference_beside_the_sample_or_not(beam_mm: float, message: str) -> None:
    description = rig(beam_mm, reference={"how": "beside", "offset_mm": [0.0, 11.0], "diameter_mm": 2.0})
    seen = view(description, reach(description, Directions.from_degrees(0.0, 0.0, 40.0, 180.0)))
    why = regions.cut(description, seen, "reference")
    assert message in why if message else not why


@pytest.mark.parametrize(
    ("beam_mm", "more", "message"),
    [
        (1.59, {}, "partly_filled"),
        (1.6, {}, "partly_filled"),
        (
            1.0,
            {"reference": {"theta_i_deg": 60.0, "theta_r_deg": 0.0}},
            "reference: the edge of the beam's spot, 1 mm",
        ),
    ],
)
def test_a_beam_as_wide_as_the_region_or_its_reference_is_refused(
    tmp_path: Path, beam_mm: float, more: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        measured(tmp_path, rig(beam_mm, **more), [0.0], [20.0])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("theta_i", [0.0, 50.0])
def test_the_light_on_a_spot_is_that_of_the_beam(theta_i: float) -> None:
    """Sum over the pixels of area times irradiance: the beam's solid angle times d0^2, at any angle of incidence."""
    description = rig(1.0)
    pose = reach(description, Directions.from_degrees(theta_i, 0.0, 33.0, 180.0))
    seen = pixel_map(description, view(description, pose))
    received = np.sum(seen.area_mm2 * seen.lit * seen.cos_theta_i * seen.distance_factor)
    # pi/4 of a square millimetre, but for 1e-7 of the cone's curvature; 1e-3: the pixels at the edge
    assert received == pytest.approx(np.pi / 4, rel=1e-3)
