"""Axes of Thorlabs stages: the unmodified pylablib over the twin, faults in the middle of moves, messages."""

import math
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_drivers import stages
from gonio_drivers.lab import LAB, LabRig
from gonio_drivers.stages import StageArms
from gonio_sim.wire import kinesis
from gonio_sim.wire.kinesis import COUNTS_PER_DEG
from gonio_sim.wire.twins import Twins

from gonio.errors import ConfigError, DeviceError, Disturbed
from gonio.lab.rig import Pose
from gonio.measurement import read
from tests.command_line import gonio as run
from tests.gonio_drivers.conftest import LONGEST_S, SAMPLE, SCALE, angle, by_hand, written
from tests.gonio_drivers.staged import AXES, PORT, STEP_DEG, on_stages

pytest.importorskip("pylablib", reason="pylablib is not installed (the extra thorlabs)")

TOLERANCE_DEG = 0.05
"""Of a landing, as the rig file has it by default."""


@pytest.fixture
def twins(tmp_path: Path) -> Iterator[Twins]:
    with Twins(on_stages(), SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE) as served:
        yield served


def rig_of(twins: Twins, **axes: dict[str, Any]) -> LabRig:
    """The rig on these twins, with keys of some axes changed."""
    description = twins.description
    devices = {name: dict(table) for name, table in description.devices.items()}
    for name, keys in axes.items():
        devices["stages"]["axes"][name] = devices["stages"]["axes"][name] | keys
    return LAB.open(description.model_copy(update={"devices": devices}), sample=None, seed=0, confirm=False)


def arms_of(twins: Twins, **axes: dict[str, Any]) -> StageArms:
    arms = rig_of(twins, **axes).arms
    assert isinstance(arms, StageArms)
    return arms


def pose(**degrees: float) -> Pose:
    return Pose(**{name: math.radians(value) for name, value in degrees.items()})


def test_opening_and_leaving_turn_nothing(twins: Twins) -> None:
    before = {name: stage.shaft() for name, stage in twins.stages.items()}
    with arms_of(twins) as arms:
        read = arms.read()
    assert {name: stage.shaft() for name, stage in twins.stages.items()} == before
    for name in AXES:
        assert math.degrees(getattr(read, name)) == pytest.approx(angle(twins, name), abs=STEP_DEG)


def test_the_profile_is_the_rig_file_s_and_backlash_is_not_the_controller_s(twins: Twins) -> None:
    with arms_of(twins):
        for stage in twins.stages.values():
            assert stage._speed / COUNTS_PER_DEG == pytest.approx(30.0, rel=0.01)  # units of the APT protocol
            assert stage._acceleration / COUNTS_PER_DEG == pytest.approx(20.0, rel=0.01)
            assert stage._backlash == 0


def seen_at_rest(twins: Twins) -> dict[str, list[float]]:
    """Where each axis stands whenever one sets out from now on [deg]."""
    seen: dict[str, list[float]] = {name: [] for name in AXES}

    def watch() -> None:
        for name in AXES:
            seen[name].append(angle(twins, name))

    for stage in twins.stages.values():
        stage.leaving = watch
    return seen


def test_every_axis_arrives_from_below_and_the_readback_is_returned(twins: Twins) -> None:
    with arms_of(twins) as arms:
        arms.move(pose(light=10, camera=20, tilt=5, spin=5))
        seen = seen_at_rest(twins)
        landed = arms.move(pose(light=-30, camera=-10, tilt=0, spin=-5))
    for name, goal in {"light": -30, "camera": -10, "tilt": 0, "spin": -5}.items():
        lowest = min(seen[name])
        assert lowest == pytest.approx(goal - 1.0, abs=TOLERANCE_DEG + 0.5)  # the approach ends within its half
        assert lowest < goal
        assert math.degrees(getattr(landed, name)) == pytest.approx(goal, abs=TOLERANCE_DEG)


def test_a_limit_is_not_crossed_on_the_way_to_it(twins: Twins, caplog: pytest.LogCaptureFixture) -> None:
    with arms_of(twins) as arms:
        seen = seen_at_rest(twins)
        arms.park()
        assert caplog.messages == []
        arms.jog({"light": math.radians(-95)})
    assert min(seen["light"]) >= -95 - STEP_DEG
    assert any(
        "axis light at -95 deg, 0.00 deg from its limit: its backlash of 0.1" in text for text in caplog.messages
    )


@pytest.mark.parametrize("homed", [True, False])
def test_a_stage_without_home_is_refused_unless_it_may_look_for_it(twins: Twins, homed: bool) -> None:
    stage = twins.stages["tilt"]
    stage.restart()
    if homed:
        with arms_of(twins, tilt={"home": "on-opening"}) as arms:
            assert math.degrees(arms.read().tilt) == pytest.approx(0.0, abs=TOLERANCE_DEG)
            assert stage.homed
        return
    with pytest.raises(
        DeviceError, match=r'axis tilt: .* has not found its home .* devices.stages.axes.tilt.home = "on-'
    ):
        arms_of(twins).__enter__()
    assert stage.shaft() == pytest.approx(1.0 * COUNTS_PER_DEG)


def test_a_stage_that_does_not_turn_stops_all_axes(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages, "IDLE_S", 0.05)
    with arms_of(twins) as arms:
        twins.stages["camera"].stalled = True
        with pytest.raises(DeviceError, match=r"axis camera stands at 40.00 deg, \+\d\d.\d\d deg from its goal"):
            arms.move(pose(light=0, camera=10))
        assert not any(stage.moves() for stage in twins.stages.values())
        with pytest.raises(DeviceError, match="open the rig again"):
            arms.move(pose())


def test_a_command_that_was_lost_is_given_again(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stages, "IDLE_S", 0.05)
    stage = twins.stages["light"]
    turn = stage._turn
    lost: list[float] = []

    def once(goal: float, ending: int) -> None:
        if lost:
            turn(goal, ending)
        else:
            lost.append(goal)

    monkeypatch.setattr(stage, "_turn", once)
    with arms_of(twins) as arms:
        assert math.degrees(arms.move(pose(light=-20, camera=45)).light) == pytest.approx(-20, abs=TOLERANCE_DEG)
    assert lost


def test_a_stage_that_was_switched_off_in_mid_move_is_not_believed(
    twins: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its counter begins at 0 where it stands: the angle that it reads is not where it is."""
    stage = twins.stages["light"]
    turn = stage._turn

    def cut_off(goal: float, ending: int) -> None:
        turn(goal, ending)
        stage.push(10 * COUNTS_PER_DEG)  # so far it has come
        stage.restart()

    with arms_of(twins) as arms:
        monkeypatch.setattr(stage, "_turn", cut_off)
        with pytest.raises(DeviceError, match=r"axis light: .* has not found its home"):
            arms.move(pose(light=60, camera=45))
        assert not any(twin.moves() for twin in twins.stages.values())


@pytest.mark.parametrize("bit", [1 << 14, 1 << 17])
def test_a_fault_of_the_controller_stops_all_axes(twins: Twins, bit: int) -> None:
    stage = twins.stages["spin"]
    with arms_of(twins) as arms:
        stage.leaving = lambda: setattr(stage, "faults", bit)
        with pytest.raises(
            DeviceError, match=r"axis spin: Thorlabs K10CR1 55000004 on .* reports: (its motor does|too hot)"
        ):
            arms.move(pose(light=-20, camera=45, spin=90))
        end = time.monotonic() + LONGEST_S  # the twins' threads take the stop when the computer lets them
        while any(twin.moves() for twin in twins.stages.values()) and time.monotonic() < end:
            time.sleep(0.01)
        assert not any(twin.moves() for twin in twins.stages.values())


def test_damaged_answers_are_asked_for_again(twins: Twins) -> None:
    with arms_of(twins) as arms:
        for name in ("light", "camera"):
            twins.stages[name].damaged = 1
        landed = arms.move(pose(light=-20, camera=45))
    assert math.degrees(landed.light) == pytest.approx(-20, abs=TOLERANCE_DEG)
    assert math.degrees(landed.camera) == pytest.approx(45, abs=TOLERANCE_DEG)


def test_answers_that_came_too_late_are_none_to_the_next_question(twins: Twins) -> None:
    """Status and position as they were wait in the line when the stage has turned on."""
    stage, peer = twins.stages["light"], twins.peers["stage-light"]
    with arms_of(twins) as arms:
        stage._obey(kinesis.REQ_STATUSBITS, b"", peer.send)
        stage._obey(kinesis.REQ_POSCOUNTER, b"", peer.send)
        stage.push(5 * COUNTS_PER_DEG)
        assert math.degrees(arms.read().light) == pytest.approx(-35, abs=2 * STEP_DEG)  # it hung at -40


def test_an_axis_that_was_pushed_disturbs_the_frame(twins: Twins) -> None:
    with arms_of(twins) as arms:
        arms.move(pose(light=-20, camera=45))
        arms.still()
        twins.stages["light"].push(0.5 * COUNTS_PER_DEG)
        with pytest.raises(Disturbed, match=r"axis light has moved by itself, from -20.000 to -19.500 deg"):
            arms.still()
        arms.move(pose(light=-20, camera=45))
        arms.still()
        twins.stages["camera"].push(3 * COUNTS_PER_DEG)
        with pytest.raises(DeviceError, match=r"axis camera has moved by itself, .*; all axes are stopped"):
            arms.still()


def test_an_interrupted_move_stops_every_axis(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    with arms_of(twins) as arms:
        monkeypatch.setattr(time, "sleep", lambda seconds: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            arms.move(pose(light=60, camera=-45))
        monkeypatch.undo()
        where = {name: stage.shaft() for name, stage in twins.stages.items()}
        assert not any(stage.moves() for stage in twins.stages.values())
        assert {name: stage.shaft() for name, stage in twins.stages.items()} == where
        arms.move(pose())  # it was nobody's fault


def test_another_controller_at_the_port_is_named(twins: Twins) -> None:
    with pytest.raises(DeviceError, match=r"axes.light.serial = 55000009, but the controller on .* is 55000001"):
        arms_of(twins, light={"serial": 55000009}).__enter__()


@pytest.mark.parametrize(
    ("keys", "error", "message"),
    [
        (
            {"port": "/dev/no-such"},
            DeviceError,
            r'devices.stages.axes.light.port = "/dev/no-such": there is no such port',
        ),
        ({"sereal": 1}, ConfigError, 'unknown key sereal; did you mean "serial"'),
        ({"home": "always"}, ConfigError, "home = 'always'"),
        ({"stage": "K10CR1", "counts_per_deg": 3.0}, ConfigError, "give stage or counts_per_deg, and not both"),
        ({"stage": "Z825"}, DeviceError, 'how many steps the stage "Z825" has for a degree; give counts_per_deg'),
    ],
)
def test_wrong_keys_are_named(twins: Twins, keys: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        arms_of(twins, light=keys).__enter__()


def test_a_rig_has_servos_or_stages() -> None:
    both = on_stages()
    devices = both.devices | {"servos": tomllib.loads(LAB.toml)["devices"]["servos"]}
    for wrong in (devices, {k: v for k, v in both.devices.items() if k != "stages"}):
        with pytest.raises(ConfigError, match=r"give one of the tables devices.servos and devices.stages"):
            LAB.open(both.model_copy(update={"devices": wrong}), sample=None, seed=0, confirm=False)
    with pytest.raises(ConfigError, match=r'reference.how = "axis" needs a changer'):
        LAB.open(on_stages(reference={"how": "axis"}), sample=None, seed=0, confirm=False)
    twice = both.devices | {"stages": {"driver": "thorlabs", "axes": {name: {"port": PORT} for name in AXES}}}
    with pytest.raises(ConfigError, match=r"stages.axes.light.port and stages.axes.camera.port are the same port"):
        LAB.open(both.model_copy(update={"devices": twice}), sample=None, seed=0, confirm=False)


@pytest.mark.slow
def test_a_run_on_stages_measures(twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The twins put the white and the sample there: values are the sample's."""
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)  # a busy disk is not what is tested
    (tmp_path / "plan.toml").write_text(
        'name = "small"\nwavelength_nm = [500]\n[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [-50, 10]\n'
    )
    rig = written(twins, tmp_path)
    done = run(tmp_path, "measure", "plan.toml", "--rig", rig, "--out", "run", "--yes")
    assert done.returncode == 0, done.stderr
    assert run(tmp_path, "reduce", "run").returncode == 0
    table = read(tmp_path / "run" / "brdf.csv")
    assert list(table["flag"]) == ["", ""]
    # three standard uncertainties, and what zeros of 0.02 deg make of a matt surface
    assert np.all(abs(table["brdf"] - SAMPLE.parameters["albedo"] / math.pi) < 3 * table["u_brdf"] + 1e-3)
    assert angle(twins, "light") == pytest.approx(-88, abs=TOLERANCE_DEG)  # parked


def test_servos_are_not_looked_for_on_a_rig_of_stages(twins: Twins, tmp_path: Path) -> None:
    by_hand(written(twins, tmp_path), "ids", code=2, says="has stages (devices.stages) and no servos")


# ---- by hand, through the command line ----


@pytest.mark.slow
def test_read_move_and_park_by_hand_with_one_stage_mute(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pylablib.devices.Thorlabs.kinesis import KinesisDevice

    monkeypatch.setattr(KinesisDevice.__init__, "__defaults__", (0.3, 1, False))  # pylablib waits for 3 s
    rig = written(twins, tmp_path)
    twins.stages["tilt"].mute = True
    done = by_hand(rig, "read", "--json", code=None, prints='"spin"')
    assert "tilt" in done.stdout + done.stderr
    by_hand(rig, "move", "light=-10")
    assert angle(twins, "light") == pytest.approx(-10, abs=TOLERANCE_DEG)
    by_hand(rig, "park", code=3, says="not parked, and where it stands is not known: tilt")
    assert angle(twins, "light") == pytest.approx(-88, abs=TOLERANCE_DEG)
    assert angle(twins, "camera") == pytest.approx(88, abs=TOLERANCE_DEG)


def test_stop_never_raises_and_says_what_did_not_answer(
    twins: Twins, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(**_: Any) -> None:
        raise OSError(5, "Input/output error")

    with arms_of(twins) as arms:
        monkeypatch.setattr(arms.joints["light"].stage._motor, "stop", gone)  # type: ignore[attr-defined]
        arms.stop()
        assert arms.stopped
    assert any(
        text.startswith("stopping light: devices.stages.axes.light.port") and "went away" in text
        for text in caplog.messages
    )
