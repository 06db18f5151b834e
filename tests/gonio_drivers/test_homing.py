"""Axes that turn further than their servos count: homing by stall, switch and index, and how the turn is lost."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from gonio_drivers import home_mark, homing
from gonio_drivers.arms import ServoArms
from gonio_drivers.joints import Joint
from gonio_drivers.service import ServoService
from gonio_drivers.settings import Homing, Servos
from gonio_sim.wire import motion
from gonio_sim.wire.peer import scaled_clock
from gonio_sim.wire.servo import Servo

from gonio.config import to_toml
from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Homed, Pose
from gonio.lab.rig.description import ArmAxis, RigDescription
from tests.gonio_drivers.conftest import BAUD, Line, by_hand
from tests.gonio_drivers.servo_arms import TOLERANCE_DEG, describe, servos
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus

GEAR = 4.0
PER_DEG = GEAR * 4096 / 360
STANDS_DEG = 60.0
"""Of the light arm, when the power comes: one turn above what its servo shows."""
SHOWN_ZERO = 2048 - 4096
AXIS = ArmAxis(limits_deg=(-80.0, 80.0), hard_stops_deg=(-85.0, 85.0), speed_deg_per_s=60.0)
STALL = {"how": "stall", "current": 300, "speed_deg_per_s": 60.0, "repeats": 2}
SWITCH = {"how": "switch", "external_port": 1, "at_deg": 55.0, "speed_deg_per_s": 10.0, "repeats": 2, "spread_deg": 4.0}
"""On a clock four times as fast a look that is 100 ms late, on a busy machine, comes 4 deg later."""


@pytest.fixture
def line(hours: VirtualClock) -> Line:
    places = {1: SHOWN_ZERO + STANDS_DEG * PER_DEG, 2: 2000.0, 3: 2100.0}
    there: dict[int, Servo] = {}

    def built() -> Iterable[Servo]:
        clock = scaled_clock(1.0)
        there.update({k: Servo(k, clock, model="xm540-w270", baud=BAUD, position=at) for k, at in places.items()})
        for servo in there.values():
            servo.write(9, b"\x00")
        return there.values()

    bus = servo_bus(built)
    put_stops(there[1], *(SHOWN_ZERO + stop * PER_DEG for stop in (-85.0, 85.0)))
    return Line(PORT, there, bus.faults, None, bus)


def put_stops(servo: Servo, low: float, high: float) -> None:
    """What the shaft cannot pass."""
    shaft, drive = servo._shaft, servo._drive

    def held() -> tuple[float, float]:
        position, velocity = shaft()
        return (position, velocity) if low <= position <= high else (min(max(position, low), high), 0.0)

    def driven() -> None:
        servo._path = servo._path if held()[0] == shaft()[0] else motion.rest(servo._clock(), held()[0])
        drive()

    def pushes() -> bool:
        return servo.torque and abs(servo._path.at(servo._clock())[0] - held()[0]) > 10

    servo._shaft, servo._drive, servo._pushes = held, driven, pushes  # type: ignore[method-assign]


def put_switch(servo: Servo, closed: Callable[[float], bool]) -> None:
    """On external port 1, by the angle of the axis [deg]."""
    refresh = servo._refresh

    def seen() -> None:
        refresh()
        servo.registers.put("External Port Data 1", int(closed((servo.travelled() - SHOWN_ZERO) / PER_DEG)))

    servo._refresh = seen  # type: ignore[method-assign]


def rig(line: Line, homing: dict[str, Any], **light: Any) -> RigDescription:
    devices = {"servos": servos(line.port).model_dump(mode="json", exclude_none=True)}
    devices["servos"]["axes"] = {
        "light": {"id": 1, "model": "xm540-w270", "gear_ratio": GEAR, "homing": homing} | light,
        "camera": {"id": 2, "model": "xm540-w270"},
        "tilt": {"id": 3, "model": "xm540-w270"},
    }
    return describe(light=AXIS).model_copy(update={"devices": devices})


def arms(description: RigDescription) -> ServoArms:
    return ServoArms(description, Servos.model_validate(description.devices["servos"]))


def homed(description: RigDescription) -> Homed:
    found = ServoService().home(description, ["light"], lambda said: None)["light"]
    assert isinstance(found, Homed), found
    return found


def refused(description: RigDescription) -> str:
    with pytest.raises(DeviceError) as caught:
        arms(description).__enter__()
    return str(caught.value)


def angle(line: Line) -> float:
    return (line.servos[1].travelled() - SHOWN_ZERO) / PER_DEG


def test_an_axis_that_counts_turns_is_homed_before_it_moves(line: Line) -> None:
    description = rig(line, STALL)
    before = line.servos[1].shaft()[0]
    assert "axis light is not homed" in refused(description)
    assert "gonio rig home light" in refused(description)
    assert line.servos[1].shaft()[0] == before
    found = homed(description)
    assert (found.at_deg, found.found) == (-85.0, 2)
    assert abs(found.off_deg) < 0.1
    assert found.spread_deg < 0.1
    assert line.servos[1].get("Goal Current") == line.servos[1].get("Current Limit")
    with arms(description) as opened:
        assert opened.joints["light"].turns == -1
        for goal in (-70.0, 75.0):
            read = opened.move(Pose(light=math.radians(goal)))
            assert math.degrees(read.light) == pytest.approx(goal, abs=TOLERANCE_DEG)
            assert angle(line) == pytest.approx(goal, abs=TOLERANCE_DEG)


def test_the_turn_is_lost_with_the_power_and_nobody_reads_a_wrong_angle(line: Line) -> None:
    description = rig(line, STALL)
    homed(description)
    with arms(description):
        pass
    line.servos[1].restart()
    line.servos[1]._back_at = None
    assert "axis light is not homed" in refused(description)
    health = arms(description).survey()
    assert health.of("light", "angle") is None
    assert "not homed" in health.silent["light"]
    assert health.of("camera", "angle") is not None
    partly = arms(description)
    partly.partial = True
    with partly:
        assert set(partly.joints) == {"camera", "tilt"}
        assert "not homed" in str(partly.absent["light"])


def test_a_mark_is_not_believed_for_another_zero_mode_or_restored_memory(line: Line) -> None:
    description, servo = rig(line, STALL), line.servos[1]
    homed(description)
    assert "not homed" in refused(rig(line, STALL, zero_count=2049))
    with arms(description):
        pass
    mode = servo.get("Operating Mode")
    servo.registers.put("Operating Mode", 3)
    assert "not homed" in refused(description)
    assert servo.get("Operating Mode") == 3  # nothing was changed but the mark
    servo.registers.put("Operating Mode", mode)
    assert "not homed" in refused(description)  # turns were lost, though the mode is back
    homed(description)
    servo.registers.put("Profile Velocity", 0)  # what a change of mode, and back, leaves
    assert "not homed" in refused(description)


@pytest.mark.parametrize(("how", "toward"), [("switch", -1), ("index", 1)])
def test_a_switch_is_found_from_its_side_and_a_mark_from_both(line: Line, how: str, toward: int) -> None:
    if how == "switch":
        put_switch(line.servos[1], lambda deg: deg * toward >= 55.0 * toward)
    else:
        put_switch(line.servos[1], lambda deg: 52.0 <= deg <= 58.0)
        # it stands beyond the mark
        line.servos[1]._path = motion.rest(line.servos[1]._clock(), SHOWN_ZERO + 48 * PER_DEG)
    assert abs(homed(rig(line, SWITCH | {"how": how, "toward": toward})).off_deg) < 4.0  # as `spread_deg` there
    with arms(rig(line, SWITCH | {"how": how, "toward": toward})) as opened:
        assert opened.joints["light"].turns == -1
        assert math.degrees(opened.read().light) == pytest.approx(angle(line), abs=TOLERANCE_DEG)


def test_a_switch_that_opens_where_others_close_is_found_too(line: Line) -> None:
    put_switch(line.servos[1], lambda deg: deg < 55.0)
    assert abs(homed(rig(line, SWITCH | {"toward": 1, "closed_reads": 0})).off_deg) < 4.0  # as `spread_deg` there


@pytest.mark.parametrize(
    ("homing", "said"),
    [
        (SWITCH | {"toward": 1, "speed_deg_per_s": 60.0}, "no switch was found in"),
        (STALL | {"at_deg": -55.0}, "the turn is not certain"),  # 30 deg off, with 90 deg to a turn of the servo
    ],
)
def test_what_is_not_found_or_could_be_another_turn_is_refused(line: Line, homing: dict[str, Any], said: str) -> None:
    put_switch(line.servos[1], lambda deg: False)
    description = rig(line, homing)
    assert said in str(ServoService().home(description, ["light"], lambda told: None)["light"])
    assert not line.servos[1].get("Bus Watchdog")
    assert "not homed" in refused(description)


def test_homing_by_the_command_line(line: Line, tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(to_toml(rig(line, STALL).model_dump(mode="json", exclude_none=True)))
    rig_file = tmp_path / "my.toml"
    by_hand(rig_file, "home", prints="light: homed at -85 deg, found 2 times within")
    assert by_hand(rig_file, "home").stdout == "every axis knows its turn\n"
    by_hand(rig_file, "home", "camera", code=2, says="axis camera needs no homing")


@pytest.mark.parametrize(
    ("homing", "said"),
    [
        ({"how": "stall"}, "needs `current`"),
        ({"how": "switch", "at_deg": 1.0}, "needs the switch"),
        ({"how": "index", "external_port": 1}, "needs `at_deg`"),
    ],
)
def test_homing_tables_are_whole(line: Line, homing: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        ServoService().home(rig(line, homing), ["light"], lambda told: None)


# ---- the search alone, count by count ----


@dataclass
class Axis:
    """An axis that goes 20 counts from one look to the next, toward its goal, and no further than to a stop."""

    stops: tuple[int, int] = (-(10**6), 10**6)
    closed: tuple[int, int] = (10**6, 10**6)
    """Where the switch is closed: from one count to below another one."""
    position: int = 5000
    goal: int = 5000
    turns: int = 0
    name: str = "spin"
    key: str = "devices.servos.axes.spin"
    counts_per_deg: float = 4096 / 360
    speed_deg_per_s: float = 5.0
    hard_stops_deg: tuple[float, float] | None = None
    limits_deg: tuple[float, float] = (-170.0, 170.0)
    count_limits: tuple[int, int] = (-100_000, 100_000)

    def write(self, name: str, value: int) -> None:
        assert name == "Goal Position"
        self.goal = value

    def look(self) -> int:
        there = self.position + max(-20, min(20, self.goal - self.position))
        self.position = max(self.stops[0], min(self.stops[1], there))
        return self.position

    def to_count(self, angle_deg: float) -> float:
        return 2048 + angle_deg * self.counts_per_deg

    def is_closed(self) -> bool:
        return self.closed[0] <= self.position < self.closed[1]


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The turns that are left in the servo as its mark; looks are 50 ms apart, and no watchdog runs out."""
    marks: list[int] = []

    class Looks:
        """0.05 s from one look to the next."""

        def __init__(self) -> None:
            self.count = 0

        def __call__(self) -> float:
            self.count += 1
            return 0.05 * self.count

    monkeypatch.setattr(homing.Search, "_look", lambda self: self.joint.look())
    monkeypatch.setattr(homing, "Patience", Looks)
    monkeypatch.setattr(homing, "watchdog", SimpleNamespace(
        arm=lambda joints: None, call_off=lambda joints: None, send_on=lambda joint, goal: False))  # fmt: skip
    monkeypatch.setattr(homing, "clock", SimpleNamespace(sleep=lambda seconds: None))
    monkeypatch.setattr(home_mark, "at_deg", lambda joint, of: of.at_deg)
    monkeypatch.setattr(home_mark, "leave", lambda joint, turns: marks.append(turns))
    return marks


def searched(axis: Axis, **table: Any) -> Homed:
    usual = {"how": "stall", "current": 100, "at_deg": -90.0}
    of = Homing.model_validate(usual | table)
    return homing.Search(cast(Joint, axis), of, axis.is_closed, lambda: None).run()


LOOSE_SWITCH = {"how": "switch", "current": None, "external_port": 1}


@pytest.mark.parametrize(("toward", "turns"), [(-1, 0), (1, 0), (-1, 2), (-1, -3)])
@pytest.mark.parametrize("beside", [0, 700, -1023, 1023])
def test_a_stop_is_found_to_a_count_and_its_turn_is_the_nearest(
    toward: int, turns: int, beside: int, left: list[int]
) -> None:
    """At -90 degrees the servo reads 2048 - 1024; up to a quarter of a turn off its turn is certain."""
    stop = 1024 + beside + 4096 * turns
    stops = (stop, 10**6) if toward < 0 else (-(10**6), stop)
    found = searched(Axis(stops=stops, position=stop - 400 * toward), toward=toward)
    assert left == [turns]
    assert (found.at_deg, found.spread_deg, found.found) == (-90.0, 0.0, 3)
    assert found.off_deg == pytest.approx(beside * 360 / 4096)


@pytest.mark.parametrize("beside", [1026, -1026, 2000])
def test_a_quarter_of_a_turn_off_the_turn_is_not_certain(beside: int, left: list[int]) -> None:
    with pytest.raises(DeviceError, match=f"lies {abs(beside) * 360 / 4096:.1f} deg off -90 deg"):
        searched(Axis(stops=(1024 + beside, 10**6), position=1424 + beside))
    assert left == []


@pytest.mark.parametrize("toward", [-1, 1])
def test_a_switch_lies_between_two_looks(toward: int, left: list[int]) -> None:
    axis = Axis(closed=(800, 1000) if toward < 0 else (1000, 1200), position=1000 - 405 * toward)
    found = searched(axis, **LOOSE_SWITCH, toward=toward, repeats=4)
    assert found.off_deg == pytest.approx(-24 * 360 / 4096, abs=10.5 * 360 / 4096)  # half a step
    assert found.found == 4
    assert axis.position == pytest.approx(1000 - toward * 34, abs=41), "3 degrees clear of the switch"


def test_a_mark_lies_between_its_edges(left: list[int]) -> None:
    """Both are met from outside, half a step late or early alike."""
    for toward in (-1, 1):
        found = searched(Axis(closed=(900, 1100), position=1000 - 405 * toward), **LOOSE_SWITCH | {"how": "index"},
                         toward=toward)  # fmt: skip
        assert found.off_deg == pytest.approx(-24 * 360 / 4096, abs=10.5 * 360 / 4096)


def test_a_search_that_begins_on_the_switch_leaves_it_first(left: list[int]) -> None:
    found = searched(Axis(closed=(700, 1000), position=900), **LOOSE_SWITCH)
    assert found.off_deg == pytest.approx(-24 * 360 / 4096, abs=10.5 * 360 / 4096)


@pytest.mark.parametrize(("spread_deg", "sound"), [(1.8, True), (1.7, False)])
def test_places_that_lie_apart_are_refused(spread_deg: float, sound: bool, left: list[int], monkeypatch: Any) -> None:
    """A stop that gives by 10 counts whenever it is met: 20 counts, 1.76 degrees of the axis, between three of them."""
    places = iter([1024.0, 1034.0, 1044.0])
    monkeypatch.setattr(homing.Search, "_place", lambda self: next(places))
    if sound:
        assert searched(Axis(), spread_deg=spread_deg).spread_deg == pytest.approx(20 * 360 / 4096)
        return
    with pytest.raises(DeviceError, match=r"found 1\.76 deg apart \(0\.00, 0\.88, 1\.76 deg\)"):
        searched(Axis(), spread_deg=spread_deg)


def test_nothing_is_looked_for_beyond_the_travel(left: list[int]) -> None:
    """A tenth more than the range, and twice what it backs off by: 1.1 x 100 + 6 degrees."""
    axis = Axis(hard_stops_deg=(-60.0, 40.0), closed=(-(10**6), -(10**6)))
    with pytest.raises(DeviceError, match=r"no switch was found in 116\.0 deg of travel toward negative"):
        searched(axis, **LOOSE_SWITCH)
    axis = Axis(limits_deg=(-10.0, 10.0), count_limits=(0, 5100))
    with pytest.raises(DeviceError, match=r"no switch was found in 8\.8 deg of travel toward positive"):
        searched(axis, **LOOSE_SWITCH, toward=1)  # 100 counts, to where the servo counts no further


def test_an_axis_that_does_not_move_is_called_jammed(left: list[int]) -> None:
    with pytest.raises(DeviceError, match="does not move at all"):
        searched(Axis(stops=(5000, 5000)), **LOOSE_SWITCH)
    with pytest.raises(DeviceError, match=r"no switch was found in 5\.3 deg of travel toward negative angles") as told:
        searched(Axis(stops=(4940, 10**6)), **LOOSE_SWITCH)
    assert "does not move" not in str(told.value)
