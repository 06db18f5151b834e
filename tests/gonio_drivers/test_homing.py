"""Axes that turn further than their servos count: homing by stall, switch and index, and how the turn is lost."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from gonio_drivers import home_mark, survey
from gonio_drivers.arms import ServoArms
from gonio_drivers.service import ServoService
from gonio_drivers.settings import Servos
from gonio_sim.wire import motion
from gonio_sim.wire.peer import scaled_clock
from gonio_sim.wire.servo import Servo

from gonio.config import to_toml
from gonio.errors import ConfigError, DeviceError
from gonio.rig import Homed, Pose
from gonio.rig.description import ArmAxis, RigDescription
from tests.gonio_drivers.conftest import BAUD, Line, by_hand
from tests.gonio_drivers.test_arms import TOLERANCE_DEG, describe, servos
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus

SCALE = 4.0
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
    health = survey.of_arms(arms(description))
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


def test_a_servo_that_restores_its_memory_is_never_taken_for_homed(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    description = rig(line, STALL)
    homed(description)
    monkeypatch.setattr(home_mark, "_restores", lambda joint: True)
    assert "not homed" in refused(description)


@pytest.mark.parametrize("how", ["switch", "index"])
@pytest.mark.parametrize("toward", [1, -1])
def test_a_switch_is_found_from_its_side_and_a_mark_from_both(line: Line, how: str, toward: int) -> None:
    if how == "switch":
        put_switch(line.servos[1], lambda deg: deg * toward >= 55.0 * toward)
    else:
        put_switch(line.servos[1], lambda deg: 52.0 <= deg <= 58.0)
    if how == "index" and toward == 1:  # it stands beyond the mark
        line.servos[1]._path = motion.rest(line.servos[1]._clock(), SHOWN_ZERO + 48 * PER_DEG)
    found = homed(rig(line, SWITCH | {"how": how, "toward": toward}))
    assert abs(found.off_deg) < 4.0  # as `spread_deg` there
    with arms(rig(line, SWITCH | {"how": how, "toward": toward})) as opened:
        assert opened.joints["light"].turns == -1
        assert math.degrees(opened.read().light) == pytest.approx(angle(line), abs=TOLERANCE_DEG)


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
    description = rig(line, STALL)
    table = description.model_dump(mode="json", exclude_none=True)
    (tmp_path / "my.toml").write_text(to_toml(table))
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
