"""A rig's axes, lamp and camera as Bluesky's devices."""

import contextlib
import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from gonio_bluesky import Devices, devices

from gonio.errors import ArgumentError, ConfigError, DeviceError
from gonio.lab.by_hand.manual_rig import ManualRig, open_rig
from gonio.lab.rig import Pose
from gonio.lab.rig.dng import read_raw
from tests.gonio.numpy_rig import SAMPLE, NumpyRig, describe

pytest.importorskip("bluesky", reason="bluesky is not installed (extra bluesky)")
from bluesky import RunEngine, protocols
from bluesky import plan_stubs as bps
from bluesky.plans import list_scan
from bluesky.utils import RunEngineInterrupted

IN_TIME_S = 60.0
"""What has not ended by then hangs: it takes milliseconds."""


@dataclass
class SlowRig(NumpyRig):
    """A rig whose arms are on their way until they are stopped, or let go on."""

    on_the_way: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    threads: set[str] = field(default_factory=set)

    def move(self, goal: Pose) -> Pose:
        self.threads.add(threading.current_thread().name)
        self.on_the_way.set()
        assert self.go_on.wait(IN_TIME_S)
        if "stop" in self.log:
            raise DeviceError("the arms were stopped")
        return super().move(goal)

    def stop(self) -> None:
        super().stop()
        self.go_on.set()


@pytest.fixture
def slow() -> Iterator[tuple[SlowRig, Devices]]:
    rig = SlowRig(describe())
    with devices(ManualRig(rig)) as found:
        yield rig, found
        rig.go_on.set()


def test_they_are_what_the_protocols_say() -> None:
    found = devices(ManualRig(NumpyRig(describe())))
    for axis in found.axis.values():
        for protocol in (
            protocols.Movable, protocols.Readable, protocols.Locatable, protocols.Stoppable, protocols.Checkable,
            protocols.HasHints, protocols.Pausable,
        ):  # fmt: skip
            assert isinstance(axis, protocol)
    assert isinstance(found.lamp, protocols.Movable)
    assert isinstance(found.lamp, protocols.Readable)
    assert isinstance(found.camera, protocols.Triggerable)
    assert isinstance(found.camera, protocols.Readable)
    assert len({device.name for device in found.all}) == len(found.all) == 6


def test_an_axis_moves_in_degrees_and_its_status_ends_when_it_has_landed(slow: tuple[SlowRig, Devices]) -> None:
    rig, found = slow
    status = found.axis["light"].set(30.0)
    assert isinstance(status, protocols.Status)
    assert rig.on_the_way.wait(IN_TIME_S)
    assert not status.done
    rig.go_on.set()
    assert status.exception(IN_TIME_S) is None
    assert status.success
    assert rig.pose.light == math.radians(30.0)
    assert found.axis["light"].locate() == {"setpoint": 30.0, "readback": math.degrees(math.radians(30.0))}
    assert found.axis["light"].describe()["light_axis"]["units"] == "deg"
    assert rig.threads == {"gonio-bluesky_0"}, "one thread owns the devices"


@pytest.mark.parametrize("success", [True, False])
def test_stop_works_in_the_middle_of_a_move(slow: tuple[SlowRig, Devices], success: bool) -> None:
    """A plan that stops an axis has not failed; a move that is cut off has."""
    rig, found = slow
    axis = found.axis["camera"]
    status = axis.set(40.0)
    assert rig.on_the_way.wait(IN_TIME_S)
    axis.stop(success=success)
    assert isinstance(status.exception(IN_TIME_S), type(None) if success else DeviceError)
    assert rig.pose.camera == 0.0


@pytest.mark.parametrize(("goal", "error"), [(500.0, ConfigError), (math.nan, ArgumentError)])
def test_a_goal_outside_the_limits_raises_before_anything_moves(
    slow: tuple[SlowRig, Devices], goal: float, error: type[Exception]
) -> None:
    rig, found = slow
    for ask in (found.axis["camera"].set, found.axis["camera"].check_value):
        with pytest.raises(error, match="camera"):
            ask(goal)
    assert not rig.on_the_way.is_set()


def test_leaving_darkens_and_parks_whatever_happens() -> None:
    rig = NumpyRig(describe())
    with contextlib.suppress(RuntimeError), devices(ManualRig(rig)) as found:
        found.lamp.set("red 650").wait(IN_TIME_S)
        found.axis["light"].set(30.0).wait(IN_TIME_S)
        assert rig.lit
        raise RuntimeError("a plan that fails")
    assert (rig.lit, rig.inside, rig.pose) == (False, False, Pose())


def test_the_lamp_takes_bands_wavelengths_and_dark() -> None:
    rig = NumpyRig(describe())
    with devices(ManualRig(rig)) as found:
        assert found.lamp.read()["lamp"]["value"] == "dark"
        for goal, name in (("red 650", "red 650"), (551.0, "green, 550"), ("dark", "dark")):
            found.lamp.set(goal).wait(IN_TIME_S)
            assert found.lamp.read()["lamp"]["value"] == name
            assert rig.lit == (name != "dark")
        with pytest.raises(ConfigError, match='no band "blue": it has green, 550, red 650, and "dark"'):
            found.lamp.set("blue")


def test_the_camera_reads_numbers_of_its_frame_and_keeps_it(tmp_path: Path) -> None:
    with devices(ManualRig(NumpyRig(describe())), frames=tmp_path) as found:
        with pytest.raises(ConfigError, match="no frame yet"):
            found.camera.read()
        found.lamp.set(550).wait(IN_TIME_S)
        found.camera.exposure_s.set(0.02)
        for number in (1, 2):
            found.camera.trigger().wait(IN_TIME_S)
            values = {name: reading["value"] for name, reading in found.camera.read().items()}
            assert list(values) == list(found.camera.describe())
            kept = read_raw(values["camera_file"])
            assert Path(values["camera_file"]).name == f"{number:06d}.dng"
            assert kept.exposure_s == values["camera_exposure_s"] == 0.02
            assert float(np.mean(kept.mosaic)) == values["camera_mean_dn"]
            assert values["camera_patch_pixels"] > 10
    with pytest.raises(ConfigError, match="no such folder"):
        devices(ManualRig(NumpyRig(describe())), frames=tmp_path / "none")


@pytest.mark.parametrize("wrong", [-1.0, 1e9, float("nan"), 0.0])
def test_an_exposure_that_the_camera_cannot_do_raises_when_it_is_set(wrong: float) -> None:
    with devices(ManualRig(NumpyRig(describe()))) as found:
        with pytest.raises(ConfigError, match="exposure"):
            found.camera.exposure_s.set(wrong)
        assert found.camera.exposure_s.value is None


@dataclass
class OnTheWay:
    """The simulated arms, whose first move is on its way until it is stopped or let go on."""

    bench: ManualRig
    begun: threading.Event = field(default_factory=threading.Event)
    go_on: threading.Event = field(default_factory=threading.Event)
    moves: int = 0
    stops: int = 0

    def jog(self, goals: dict[str, float]) -> Pose:
        self.moves += 1
        self.begun.set()
        assert self.go_on.wait(IN_TIME_S)
        if self.stops:
            raise DeviceError("the arms were stopped")
        landed: Pose = type(self.bench.arms).jog(self.bench.arms, goals)  # type: ignore[attr-defined]
        return landed

    def stop(self) -> None:
        self.stops += 1
        self.go_on.set()


@pytest.fixture
def under_way(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[OnTheWay, Devices]]:
    bench = open_rig("sim", sample=SAMPLE)
    arms = OnTheWay(bench)
    with devices(bench) as found, monkeypatch.context() as patch:
        patch.setattr(bench.arms, "jog", arms.jog)
        patch.setattr(bench.arms, "stop", arms.stop)
        found.lamp.set(550).wait(IN_TIME_S)
        try:
            yield arms, found
        finally:
            arms.go_on.set()


def interrupted(engine: RunEngine, how: str, begun: threading.Event) -> threading.Thread:
    """Somebody at another terminal, who waits until an axis is on its way."""

    def press() -> None:
        assert begun.wait(IN_TIME_S)
        getattr(engine, how)()

    thread = threading.Thread(target=press)
    thread.start()
    return thread


@pytest.mark.parametrize("how", ["abort", "stop", "halt"])
def test_an_engine_that_is_ended_during_a_move_leaves_arms_standing_and_the_lamp_dark(
    under_way: tuple[OnTheWay, Devices], how: str
) -> None:
    arms, found = under_way
    before = found.axis["light"].locate()["readback"], found.axis["camera"].locate()["readback"]
    engine = RunEngine({}, context_managers=[])
    presser = interrupted(engine, how, arms.begun)
    with pytest.raises(RunEngineInterrupted):
        engine(bps.mv(found.axis["light"], 30, found.axis["camera"], 20))
    presser.join(IN_TIME_S)
    assert engine.state == "idle"
    assert (found.axis["light"].locate()["readback"], found.axis["camera"].locate()["readback"]) == before
    assert arms.moves == 1, "the axis that waited for its turn does not leave any more"
    assert not arms.bench.world.lamp_on
    assert found.lamp.read()["lamp"]["value"] == "dark"


def test_a_pause_during_a_move_darkens_and_going_on_lights_again(under_way: tuple[OnTheWay, Devices]) -> None:
    arms, found = under_way
    engine = RunEngine({}, context_managers=[])
    presser = interrupted(engine, "request_pause", arms.begun)

    def plan() -> Iterator[object]:
        yield from bps.checkpoint()
        yield from bps.mv(found.axis["light"], 30)

    with pytest.raises(RunEngineInterrupted):
        engine(plan())
    presser.join(IN_TIME_S)
    assert engine.state == "paused"
    assert found.lamp.read()["lamp"]["value"] == "dark"
    arms.stops = 0
    engine.resume()
    assert found.lamp.read()["lamp"]["value"] != "dark"
    assert found.axis["light"].locate()["readback"] == pytest.approx(30, abs=0.088)  # a step of the encoder


def test_the_end_of_a_plan_leaves_the_lamp_as_it_is() -> None:
    with devices(open_rig("sim", sample=SAMPLE)) as found:
        engine = RunEngine({}, context_managers=[])
        engine(bps.mv(found.lamp, 550))
        engine(bps.mv(found.axis["light"], 30))
        assert found.lamp.read()["lamp"]["value"] != "dark"


def test_a_stop_between_two_legs_of_a_way_ends_it() -> None:
    rig = NumpyRig(describe())
    with ManualRig(rig) as held:
        held._legs = lambda goals: [{"light": 0.1}, {"light": 0.2}]  # type: ignore[method-assign]
        drive = held._drive

        def stopped_after(goals: dict[str, float]) -> dict[str, float]:
            landed = drive(goals)
            held.stop()
            return landed

        held._drive = stopped_after  # type: ignore[method-assign]
        with pytest.raises(DeviceError, match="stopped on their way"):
            held.move(light=0.2)
        assert rig.pose.light == 0.1


def test_a_list_scan_over_an_axis_of_sim() -> None:
    seen = []
    goals = [10.0, 20.0, 35.0]
    with devices(open_rig("sim", sample=SAMPLE)) as found:
        found.lamp.set(550).wait(IN_TIME_S)
        found.camera.exposure_s.set(0.02)
        engine = RunEngine({}, context_managers=[])
        engine(list_scan([found.camera], found.axis["camera"], goals), lambda kind, doc: seen.append((kind, doc)))
    rows = [doc["data"] for kind, doc in seen if kind == "event"]
    assert [row["camera_axis_setpoint"] for row in rows] == goals
    # a step of the encoder (0.088 deg) is the most that an axis stands off its goal
    assert [row["camera_axis"] for row in rows] == pytest.approx(goals, abs=0.088)
    assert all(row["camera_patch_mean_dn"] > row["camera_median_dn"] * 0.5 > 0 for row in rows)
