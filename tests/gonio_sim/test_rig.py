"""The rig as a whole: lamp and arms at entry and exit, steps that repeat, clock, lamp level, swaps, rig files."""

import io
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM, SIM_IDEAL, SIM_METROLOGY, SimulatedRig
from gonio_sim.world import LAST_S, World, slot_s
from scipy import stats

from gonio import plugins
from gonio.errors import ConfigError, DeviceError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig import Pose, RigPlugin
from gonio.lab.rig.light_and_camera import Band
from gonio.samples.description import SampleDescription
from tests.gonio_sim.conftest import MATTE, describe, step

Build = Callable[..., SimulatedRig]
AT_45 = Pose(light=0.0, camera=math.radians(45))


def mean_signal(sim: SimulatedRig, exposure_s: float = 0.1) -> float:
    """Mean of a frame above the black level [DN]."""
    frame = sim.camera.capture(exposure_s)
    return float(frame.mosaic.mean()) - frame.black_level_dn


def lit(sim: SimulatedRig) -> None:
    sim.present("reference")
    sim.light.select(sim.description.bands.containing(550))
    sim.light.on()
    sim.arms.move(AT_45)


def test_shipped_rigs_are_found_by_name_and_their_files_open() -> None:
    for name, plugin in (("sim", SIM), ("sim-ideal", SIM_IDEAL), ("sim-metrology", SIM_METROLOGY)):
        loaded: RigPlugin = plugins.load("gonio.rigs", name)
        assert loaded is plugin
        assert describe(name).rig == name


def test_values_of_sim_that_the_contract_states() -> None:
    d = describe("sim")
    assert (d.lamp.half_angle_deg, d.camera.lens_half_angle_deg) == (0.5, 0.5)
    assert (d.lamp.drift_per_hour, d.reference.u_rel, d.reference.error) == (0.005, 0.002, "drawn")
    for axis in (d.arms.light, d.arms.camera, d.holder):
        assert (axis.backlash_deg, axis.encoder_step_deg) == (0.1, 0.088)
    bands = d.bands.all()
    assert [b.centre_nm for b in bands] == list(range(400, 701, 10))
    assert {b.fwhm_nm for b in bands} == {10.0}


def test_sim_ideal_has_the_geometry_of_sim_and_nothing_else() -> None:
    real, ideal = describe("sim"), describe("sim-ideal")
    assert ideal.geometry == real.geometry
    assert ideal.bands == real.bands
    assert ideal.lamp.half_angle_deg == real.lamp.half_angle_deg
    for key in ("width", "height", "pixel_um", "focal_length_mm", "lens_half_angle_deg", "cos4", "vignetting"):
        assert getattr(ideal.camera, key) == getattr(real.camera, key)
    camera = ideal.camera
    assert not any((camera.photon_noise, camera.read_noise_e, camera.dark_current_e_per_s, camera.prnu, camera.dsnu_e))
    assert not any((ideal.lamp.noise, ideal.lamp.drift_per_hour, ideal.reference.u_rel, camera.quantised))
    for axis in (ideal.arms.light, ideal.arms.camera, ideal.holder):
        assert not any((axis.encoder_step_deg, axis.backlash_deg, axis.zero_offset_deg, axis.zero_u_deg))


def test_lamp_is_dark_after_construction_and_entry(rig: Build) -> None:
    sim = rig(describe("sim-ideal"))
    assert not sim.world.lamp_on
    with sim:
        assert mean_signal(sim) == 0.0


@pytest.mark.parametrize("error", [None, RuntimeError, KeyboardInterrupt])
def test_lamp_is_dark_and_arms_are_parked_after_every_exit(rig: Build, error: type[BaseException] | None) -> None:
    sim = rig(describe("sim-ideal"))

    def use() -> None:
        with sim:
            lit(sim)
            assert mean_signal(sim) > 0
            if error is not None:
                raise error

    if error is None:
        use()
    else:
        with pytest.raises(error):
            use()
    assert not sim.world.lamp_on
    # at rest: the light on its lower end, the camera on its upper end
    assert sim.world.pose == Pose(light=math.radians(-89), camera=math.radians(89))
    with pytest.raises(DeviceError, match="is not open"):
        sim.camera.capture(0.1)


def test_a_step_repeats_whatever_went_before(rig: Build) -> None:
    """The frames of step 5 are the same in a run that starts there and in one that comes from elsewhere."""

    def frames(sim: SimulatedRig) -> list[Any]:
        sim.begin(step(5))
        lit(sim)
        return [sim.camera.capture(exposure) for exposure in (0.1, 0.1, 0.025)]

    with rig(describe("sim"), seed=4) as a, rig(describe("sim"), seed=4) as b, rig(describe("sim"), seed=5) as other:
        for n in range(3):
            a.begin(step(n))
            lit(a)
            a.camera.capture(0.2)
        first, second, third = frames(a), frames(b), frames(other)
    for x, y, z in zip(first, second, third, strict=True):
        np.testing.assert_array_equal(x.mosaic, y.mosaic)
        assert x.time_s == y.time_s
        assert np.any(x.mosaic != z.mosaic)
    assert np.any(first[0].mosaic != first[1].mosaic)


def test_clock_runs_on_through_steps(rig: Build) -> None:
    description = describe("sim", camera={"width": 64, "height": 48})
    times = []
    with rig(description) as sim:
        for n in range(105):
            sim.begin(step(n))
            times.append(sim.time_s())
            sim.arms.move(Pose(light=math.radians(40), camera=math.radians(-70 + n), spin=math.radians(170)))
            times += [sim.camera.capture(0.5).time_s for _ in range(3)]
            times.append(sim.time_s())
    assert np.all(np.diff(times) > 0)
    assert 20 * 60 < times[-1] < 60 * 60  # tens of minutes, so that drift matters


def test_clock_waits_where_a_step_is_too_long(rig: Build) -> None:
    description = describe("sim", camera={"width": 64, "height": 48})
    with rig(description) as sim:
        sim.begin(step(2))
        times = [sim.camera.capture(20.0).time_s for _ in range(4)]
        end = sim.time_s()
        sim.begin(step(3))
        assert times[0] < times[1] < times[2] < times[3] <= end == sim.time_s() == 3 * slot_s(description)


def test_lamp_drifts_with_time_and_flickers_from_frame_to_frame() -> None:
    description = describe("sim")
    world = World(description, None, 11)
    pulls = []
    for n in range(400):
        world.begin(n)
        for frame in range(3):
            world.frame = frame
            drift = 1 + 0.005 * world.now_s() / 3600
            pulls.append((world.lamp_level() / drift - 1) / 0.008)
    assert stats.kstest(pulls, "norm").pvalue > 1e-4
    assert abs(np.corrcoef(pulls[1:], pulls[:-1])[0, 1]) < 5 / math.sqrt(len(pulls))
    steady = World(describe("sim", lamp={"noise": 0.0}), None, 11)
    steady.begin(100)
    assert steady.lamp_level() == 1 + 0.005 * 100 * slot_s(description) / 3600


def test_error_of_the_reference_is_drawn_from_the_seed() -> None:
    description = describe("sim")
    pulls = [(World(description, None, seed).reference_scale - 1) / 0.002 for seed in range(400)]
    assert stats.kstest(pulls, "norm").pvalue > 1e-4
    assert World(describe("sim", reference={"error": "none"}), None, 1).reference_scale == 1.0


def test_reference_gives_the_rate_of_the_measurement_equation(rig: Build) -> None:
    """At the centre, at normal incidence: responsivity times albedo, in electrons a second."""
    with rig(describe("sim-ideal", camera={"cos4": False, "vignetting": 0.0})) as sim:
        lit(sim)
        frame = sim.camera.capture(0.2)
    centre = frame.mosaic[239:241, 319:321].astype(float) - 64
    # 1e-5: rounding to whole DN of 48000, and half a pixel (0.02 mm) off the axis
    assert centre.mean() * 0.165 == pytest.approx(0.2 * 40_000 * 0.99, rel=1e-5)


def test_swap_asks_the_user_once_each_time(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    sim = SIM.open(describe("sim"), sample=MATTE, seed=1, confirm=True)
    monkeypatch.setattr("sys.stdin", io.StringIO("\n\n"))
    with sim:
        sim.present("sample")
        assert capsys.readouterr().err == ""  # it lies there already
        sim.present("reference")
        sim.present("reference")
        assert capsys.readouterr().err.count("white reference into the holder") == 1
        sim.present("sample")
        assert "sample back into the holder" in capsys.readouterr().err
        with pytest.raises(DeviceError, match="there is no terminal to confirm it; --yes asks for none"):
            sim.present("reference")
        assert sim.world.target == "sample"


@pytest.mark.parametrize(("how", "confirm"), [("axis", True), ("beside", True), ("swap", False)])
def test_other_ways_to_the_reference_ask_nobody(monkeypatch: pytest.MonkeyPatch, how: str, confirm: bool) -> None:
    sim = SIM.open(describe("sim", reference={"how": how}), sample=MATTE, seed=1, confirm=confirm)
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    with sim:
        sim.present("reference")
        assert sim.world.target == "reference"


def test_wrong_requests_of_the_devices_say_what_is_allowed(rig: Build) -> None:
    with rig(describe("sim")) as sim:
        with pytest.raises(ConfigError, match=r"exposure of 100 s is outside camera.exposure_limits_s, 1e-05 to 60 s"):
            sim.camera.capture(100.0)
        with pytest.raises(ConfigError, match=r'has no band "ultraviolet" \(300 nm\)'):
            sim.light.select(Band(name="ultraviolet", centre_nm=300, fwhm_nm=10))
        sim.light.on()
        with pytest.raises(DeviceError, match="no band was selected"):
            sim.camera.capture(0.1)


@pytest.mark.parametrize(
    ("sample", "message"),
    [
        (SampleDescription(name="grey", model="lambrt"), r'sample "grey".*did you mean "lambert"'),
        (SampleDescription(name="grey", model="lambert", parameters={"albdo": 1}), r'sample "grey".*"albdo".*"albedo"'),
        (SampleDescription(name="grey", model="lambert", parameters={"albedo": -1}), r'sample "grey".*albedo = -1'),
    ],
)
def test_wrong_samples_are_refused_before_anything_moves(sample: SampleDescription, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        SIM.open(describe("sim"), sample=sample, seed=1, confirm=False)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError, match="seed = -1"):
        SIM.open(describe("sim"), sample=MATTE, seed=-1, confirm=False)


def test_without_a_sample_only_the_reference_can_be_looked_at(rig: Build) -> None:
    with rig(describe("sim"), None) as sim:
        lit(sim)
        assert mean_signal(sim) > 0
        sim.present("sample")
        with pytest.raises(ConfigError, match=r"no sample to look at: name one with --sample"):
            sim.camera.capture(0.1)


# ---- the clock of the simulated rig: frames have growing times, and no step reaches into the next one ----


@pytest.fixture
def world() -> World:
    return World(find_rig("sim").description, None, 1)


def test_stamps_join_the_clock_and_grow_through_the_last_millisecond(world: World) -> None:
    world.begin(3)
    slot = world._slot_s
    end = world.description.lamp.warm_up_s + 4 * slot
    world.spend(slot - LAST_S)
    before = world.frame_time_s()
    assert before == pytest.approx(end - LAST_S, abs=1e-9)  # a rounding of seconds
    world.spend(1e-6)
    # it goes on where the clock was: the first microsecond moves it by less than that
    assert before < world.frame_time_s() < before + 1e-6 + 1e-9
    stamps = []
    for _ in range(50):
        world.spend(slot)
        stamps.append(world.frame_time_s())
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert stamps[-1] < end
    assert world.now_s() == pytest.approx(end, abs=1e-9)
