"""What the light of a simulated bench truly is: warm-up, profile, polarisation, bands, and the reference's error."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gonio_sim import polarised
from gonio_sim.rig import SimulatedRig
from gonio_sim.world import World

from gonio import geometry, models
from gonio.config import to_toml
from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig import Pose, Step, imaging, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from tests.gonio_sim.conftest import MATTE, describe

SMALL = {"width": 64, "height": 48, "pixel_um": 50.0}
RED = SampleDescription(
    name="rough", model="he-torrance", parameters={"sigma0_um": 0.2, "tau_um": 2.0, "ior": [1.5, 0.0]}
)


def test_a_lamp_warms_up_exponentially_and_then_drifts() -> None:
    lamp = {"warm_up_loss": 0.2, "warm_up_time_constant_s": 300.0, "drift_per_hour": 0.036, "noise": 0.0}
    world = World(describe("sim", lamp=lamp), MATTE, 0)
    for index in (0, 20, 90):
        world.begin(index)
        now = world.now_s()
        assert world.lamp_level() == pytest.approx(1.0 - 0.2 * math.exp(-now / 300.0) + 1e-5 * now, rel=1e-12)


def test_a_gaussian_beam_falls_off_over_the_sample_and_turns_with_the_arm() -> None:
    """Written out from vectors: the angle that a spot makes with the beam's axis at the lamp, and the width there."""
    width = 15.0
    beam = {"xx_per_mm2": -0.5 / width**2, "yy_per_mm2": -0.5 / width**2, "x_per_mm": 0.004}
    plain, formed = describe("sim-ideal", camera=SMALL), describe("sim-ideal", camera=SMALL, lamp={"beam": beam})
    view = kinematics.view(plain, Pose(light=math.radians(50), camera=math.radians(-20), spin=math.radians(30)))
    even, profile = (imaging.pixel_map(d, view).weight for d in (plain, formed))
    seen = imaging.pixel_map(plain, view)
    axis = view.source_mm / np.linalg.norm(view.source_mm)
    rays = np.stack([seen.x_mm, seen.y_mm, np.zeros_like(seen.x_mm)], axis=-1) - view.source_mm
    on_plane = view.source_mm + rays * (-1000.0 / (rays @ axis))[..., None]  # where they are 1000 mm along the axis
    # the light arm turns about the lab's y; toward larger angles is y x axis
    lab_y = np.array([math.sin(math.radians(30)), math.cos(math.radians(30)), 0.0])
    x, y = on_plane @ np.cross(lab_y, axis), on_plane @ lab_y
    # the same arithmetic in another order: 1e-12
    np.testing.assert_allclose(profile / even, np.exp(0.004 * x - 0.5 * (x**2 + y**2) / width**2), rtol=1e-12)


def test_a_truth_of_bands_shifts_what_is_seen_and_not_what_is_written(
    rig: Callable[..., SimulatedRig], tmp_path: Path
) -> None:
    bands = {"tunable": {"start_nm": 403.0, "stop_nm": 703.0, "step_nm": 10.0, "fwhm_nm": 12.0}}
    (tmp_path / "truth.toml").write_text(to_toml({"bands": bands}))
    description = describe("sim-ideal", camera=SMALL).model_copy(update={"truth": str(tmp_path / "truth.toml")})
    world = World(description, MATTE, 0)
    asked = description.bands.containing(550.0)
    true = world.true_band(asked)
    assert (asked.centre_nm, true.centre_nm, true.fwhm_nm) == (550.0, 553.0, 12.0)
    (tmp_path / "few.toml").write_text(to_toml({"bands": {"tunable": {**bands["tunable"], "stop_nm": 500.0}}}))
    with pytest.raises(ConfigError, match="needs as many"):
        World(description.model_copy(update={"truth": str(tmp_path / "few.toml")}), MATTE, 0)


def test_a_truth_scales_the_reference_and_a_rig_file_may_not(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text("[reference]\nscale = 1.004\n")
    description = describe("sim").model_copy(update={"truth": str(tmp_path / "truth.toml")})
    assert World(description, MATTE, 5).reference_scale == 1.004
    values = describe("sim", reference={"scale": 1.004}).model_dump(mode="python", exclude_none=True)
    values.pop("calibration")
    (tmp_path / "rig.toml").write_text(to_toml(values))
    with pytest.raises(ConfigError, match=r"reference.scale = 1.004 says what is true"):
        find_rig(str(tmp_path / "rig.toml"))


def test_a_monitor_reads_what_the_lamp_gave_the_last_frame(rig: Callable[..., SimulatedRig]) -> None:
    description = describe("sim", camera=SMALL, lamp={"monitor": True, "noise": 0.05})
    with rig(description, MATTE) as bench:
        bench.begin(Step(3, "point", 0, Pose(camera=math.radians(45))))
        bench.light.select(description.bands.containing(550.0))
        bench.light.on()
        read = []
        for _ in range(4):
            level = bench.world.lamp_level()
            bench.camera.capture(1e-3)
            assert bench.light.monitor() == level
            read.append(level)
    assert np.std(read) > 0.01
    with rig(describe("sim", camera=SMALL), MATTE) as bench:
        assert bench.light.monitor() is None


def with_polarisation(lamp: tuple[float, float], camera: tuple[float, float]) -> RigDescription:
    return describe(
        "sim-ideal",
        lamp={"polarisation": {"degree": lamp[0], "azimuth_deg": lamp[1]}},
        camera=SMALL | {"polarisation": {"degree": camera[0], "azimuth_deg": camera[1]}},
    )


GLASS = models.build("he-torrance", dict(RED.parameters))


def factor(lamp: tuple[float, float], camera: tuple[float, float], pose: Pose, *, spike: bool = False) -> float:
    """That on rough glass's lobe, or on its spike."""
    description = with_polarisation(lamp, camera)
    view = kinematics.view(description, pose)
    at = geometry.Directions.from_vectors(view.source_mm[None], view.camera_mm[None])
    ends = polarised.ends(description)
    if spike:
        return float(polarised.of_spike(ends, GLASS, view, at, 550.0)[0])
    return float(polarised.of_lobe(ends, GLASS, lambda _: np.ones(1), view, at, 550.0)[0])


@pytest.mark.parametrize(("azimuth", "expected"), [(0.0, 1.8), (90.0, 0.2), (45.0, 1.0)])
def test_polarised_light_at_the_brewster_angle_of_glass(azimuth: float, expected: float) -> None:
    """A smooth face reflects nothing of light along the arms' plane, and twice the mean of light across it.

    That holds for facets too, however the holder stands: the plane of lamp, facet's normal and camera is the arms'.
    """
    brewster, light, none = math.atan(1.5), (0.8, azimuth), (0.0, 0.0)
    upright = Pose(light=brewster, camera=-brewster)
    tilted = Pose(light=brewster, camera=-brewster, tilt=math.radians(35.0))
    found = [factor(light, none, upright), factor(none, light, upright), factor(light, none, tilted)]
    found.append(factor(light, none, upright, spike=True))
    # amplitudes of 1e-16 at the Brewster angle: rounding
    assert found == pytest.approx([expected] * 4, abs=1e-9)


def test_crossed_polarisers_at_normal_incidence_and_straight_through() -> None:
    at_normal = Pose(light=math.radians(0.01), camera=math.radians(-0.01))
    # seen from the sample both azimuths are counted alike: a mirror image turns the other way
    found = [factor((1.0, 20.0), (1.0, azimuth), at_normal) for azimuth in (20.0, 110.0, 65.0)]
    assert found == pytest.approx([2.0, 0.0, 1.0], abs=1e-6)  # 0.01 degrees off the normal: 1e-6
    opposite = Pose(light=math.radians(90), camera=math.radians(-90))
    description = with_polarisation((1.0, 20.0), (1.0, -20.0))
    assert polarised.straight(polarised.ends(description), kinematics.view(description, opposite)) == pytest.approx(
        2.0, abs=1e-12
    )


def test_a_matt_sample_does_not_notice_polarisation(rig: Callable[..., SimulatedRig]) -> None:
    pose = Pose(light=math.radians(50), camera=math.radians(-30))
    frames = []
    for description in (describe("sim-ideal", camera=SMALL), with_polarisation((0.9, 10.0), (0.5, 70.0))):
        with rig(description, MATTE) as bench:
            bench.begin(Step(1, "point", 0, pose))
            bench.arms.move(pose)
            bench.light.select(description.bands.containing(550.0))
            bench.light.on()
            frames.append(bench.camera.capture(0.01).mosaic)
    np.testing.assert_array_equal(frames[0], frames[1])
