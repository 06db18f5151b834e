"""Runs with planned brackets on the simulated rig: uncertainty, resuming, hits of cosmic radiation."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import DeviceError, Interrupted
from gonio.geometry import ANGLES_DEG as COLUMNS
from gonio.instrument import apparent_brdf
from gonio.lab.reduction import brdf
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.models import HeTorrance
from gonio.samples.description import SampleDescription
from tests.gonio.numpy_rig import StopAfter
from tests.gonio_sim.conftest import describe, measured

ANGLES = [20.0], [-50.0, 0.0, 40.0]
STILL = {"encoder_step_deg": 0.0, "backlash_deg": 0.0, "zero_offset_deg": 0.0, "zero_u_deg": 0.0}


def rig(camera: dict[str, Any] | None = None, **acquisition: Any) -> RigDescription:
    """The shipped rig with a small sensor and a steady lamp, and arms that stand where they are read."""
    return describe(
        camera={"width": 96, "height": 64, "prnu": 0.0} | (camera or {}),
        lamp={"noise": 0.0, "drift_per_hour": 0.0},
        reference={"u_rel": 0.0},
        acquisition=acquisition,
        arms__light=STILL,
        arms__camera=STILL,
        holder=STILL,
    )


@pytest.mark.parametrize("target", [0.01, 0.001])
def test_points_have_the_uncertainty_that_was_asked_for(tmp_path: Path, target: float) -> None:
    table = brdf.reduce(measured(tmp_path, rig(u_rel_target=target), *ANGLES))
    # what the visits and the darks have is not the points'
    assert (table["u_random"] / table["brdf"] < 1.1 * target).all()
    assert np.allclose(table["brdf"], 0.5 / np.pi, rtol=0, atol=5.0 * table["u_brdf"].max())
    merged = table.attrs["provenance"]["merge"][0]
    assert (merged["noise"], merged["cosmic_hits"]) == ("known", 0)


def test_a_polished_metal_over_seven_decades(tmp_path: Path) -> None:
    """From its spike to its far flank: every value within its uncertainty, and these below 1 %."""
    parameters: dict[str, Any] = {"sigma0_um": 0.02, "tau_um": 2.0, "ior": "Al", "diffuse_albedo": 0.0002}
    sample = SampleDescription(name="polished", model="he-torrance", parameters=parameters)
    theta_r = [0.0, 28.0, 29.5, 30.0, 30.5, 32.0, 45.0]
    table = brdf.reduce(measured(tmp_path, rig(u_rel_target=0.002, dark_frames=16), [30.0], theta_r, sample=sample))
    angles = np.radians(table[list(COLUMNS)].to_numpy()).T
    cones = {name: table.attrs[name] for name in ("source_solid_angle_sr", "receiver_solid_angle_sr")}
    true = apparent_brdf(HeTorrance(**parameters), *angles, wavelength_nm=550.0, spike="exact", **cones)
    assert true.max() / true.min() > 1e7
    assert (table["u_brdf"] / true).max() < 0.01
    assert np.abs((table["brdf"] - true) / table["u_brdf"]).max() < 4.0
    # the logarithms' slope: a standard uncertainty of 0.3 % over 17 logarithmic units of range
    assert np.polyfit(np.log(true), np.log(table["brdf"]), 1)[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.usefixtures("one_id")
def test_a_planned_run_resumes_to_the_same(tmp_path: Path) -> None:
    description = rig(u_rel_target=0.002)
    whole = measured(tmp_path, description, *ANGLES, name="whole")
    with pytest.raises(Interrupted):
        measured(tmp_path, description, *ANGLES, name="parts", progress=StopAfter(3))
    assert list(measured(tmp_path, description, *ANGLES, name="parts", resume=True).steps()) == list(whole.steps())


@pytest.mark.parametrize("merge", ["pixels", "frames"])
def test_hits_of_cosmic_radiation_are_counted_and_do_no_harm(tmp_path: Path, merge: str) -> None:
    """A few hits a second; the long dark frames have most of them. Whole frames suffer."""
    quiet, hit = (
        brdf.reduce(measured(tmp_path, rig({"cosmic_per_s": rate}, merge=merge, frames=3), *ANGLES, name=f"run-{rate}"))
        for rate in (0.0, 25.0)
    )
    change = (hit["brdf"] - quiet["brdf"]).abs() / quiet["u_random"]
    if merge == "frames":
        assert change.max() > 2.0
        assert "merge" not in hit.attrs["provenance"]
        return
    account = hit.attrs["provenance"]["merge"][0]
    assert account["cosmic_hits"] > 0
    assert account["cosmic_hits_in_darks"] > 100
    assert sum(account["cosmic_hits_of_points"].values()) <= account["cosmic_hits"]
    assert quiet.attrs["provenance"]["merge"][0]["cosmic_hits"] == 0
    # the same noise but for the pixels left out
    assert change.max() < 1.0


def test_a_camera_that_does_not_obey_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from gonio_sim.camera import SimulatedCamera

    capture = SimulatedCamera.capture

    def auto(camera: SimulatedCamera, exposure_s: float) -> Frame:
        frame = capture(camera, exposure_s)
        return Frame(frame.mosaic, 2.0 * exposure_s, 64.0, 4095.0, time_s=frame.time_s)

    monkeypatch.setattr(SimulatedCamera, "capture", auto)
    with pytest.raises(DeviceError, match=r"were asked. Set the camera to manual exposure"):
        measured(tmp_path, rig(), *ANGLES)
