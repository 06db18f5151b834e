"""Counts and angles of one joint, its limits, and what of its health is refused; no bus."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
from gonio_drivers import control_table, preparation
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint, Report, span
from gonio_drivers.preparation import (
    ACCELERATION_UNIT_DEG_S2,
    VELOCITY_UNIT_DEG_S,
    changer_joint,
    check_acceleration,
    joint_of,
    set_profile,
)
from gonio_drivers.settings import Changer, ServoAxis

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig.description import ArmAxis, Arms
from tests.gonio.numpy_rig import describe

BUS = cast(Bus, SimpleNamespace(port="none", baud=1_000_000, alerts=set()))
PER_TURN = 4096


def joint(arm: dict[str, Any] | None = None, **servo: Any) -> Joint:
    """The camera arm of a rig, on a servo of 4096 counts a turn."""
    axis = ArmAxis.model_validate({"limits_deg": (-60.0, 50.0), "approach_deg": 2.0} | (arm or {}))
    made = ServoAxis.model_validate({"id": 3, "model": "xm430-w350", "zero_count": 2000} | servo)
    return joint_of(BUS, describe(arms=Arms(camera=axis)), "camera", made)


@pytest.mark.parametrize(("direction", "gear"), [(1, 1.0), (-1, 1.0), (1, 2.0), (-1, 2.0)])
def test_counts_and_angles_follow_gear_direction_and_zero(direction: int, gear: float) -> None:
    """An axis that reads 0.5 degrees at its true zero, which is known."""
    of = joint({"limits_deg": (-60.0, 50.0), "zero_offset_deg": 0.5}, direction=direction, gear_ratio=gear)
    per_deg = direction * gear * PER_TURN / 360
    assert of.counts_per_deg == pytest.approx(per_deg)
    assert (of.to_count(0.0), of.to_count(30.0)) == pytest.approx((2000 + 0.5 * per_deg, 2000 + 30.5 * per_deg))
    assert of.to_deg(2000.0) == pytest.approx(-0.5)
    assert of.to_deg(of.to_count(17.3)) == pytest.approx(17.3)
    assert of.distance_deg(1500, 1500 + 100) == pytest.approx(100 / abs(per_deg))
    assert of.distance_deg(1500 + 100, 1500) == pytest.approx(100 / abs(per_deg))


def test_a_zero_that_nobody_knows_is_not_taken_out() -> None:
    assert joint({"zero_offset_deg": 0.5, "zero_offset_known": False}).to_deg(2000.0) == 0.0


def test_turns_that_homing_has_found_move_the_zero() -> None:
    of = joint()
    of.turns = -2
    assert of.to_deg(2000 - 2 * PER_TURN) == 0.0


@pytest.mark.parametrize("direction", [1, -1])
def test_counts_stay_inside_the_limits(direction: int) -> None:
    of = joint(direction=direction)
    low, high = sorted((2000 - direction * 60 * PER_TURN / 360, 2000 + direction * 50 * PER_TURN / 360))
    assert of.inside(2000.4) == 2000
    assert low <= of.inside(-(10**6)) < low + 1
    assert high - 1 < of.inside(10**6) <= high
    of.count_limits = (1900, 2100)
    assert (of.inside(-(10**6)), of.inside(10**6)) == (1900, 2100)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_last_part_of_a_way_begins_below_the_goal(direction: int) -> None:
    of = joint(direction=direction)
    assert of.to_deg(of.approach_start(of.to_count(20.0))) == pytest.approx(18.0, abs=0.05)  # half a count
    assert of.run_up_deg(20.0) == pytest.approx(2.0, abs=0.05)
    assert of.run_up_deg(-59.0) == pytest.approx(1.0, abs=0.1), "a limit is in the way"
    assert joint({"approach_deg": -2.0}).run_up_deg(49.5) == pytest.approx(0.5, abs=0.1)


def test_a_range_beyond_a_turn_of_the_servo_is_refused() -> None:
    joint({"limits_deg": (-175.0, 180.0)})  # counts 8.9 to 4048
    for limits in ((-176.0, 10.0), (-10.0, 185.0)):  # count -2.5, and 4104.9
        with pytest.raises(ConfigError, match=r"narrow the limits"):
            joint({"limits_deg": limits})


# ---- health ----


@pytest.mark.parametrize(
    ("temperature_c", "voltage_v", "said"),
    [
        (77, 12.0, ""),
        (78, 12.0, "is at 78 C, and its limit is 80 C"),
        (40, 9.9, r"has 9.9 V, needs 10.0 to 14.0 V"),
        (40, 10.0, ""),
        (40, 14.0, ""),
        (40, 14.1, r"has 14.1 V"),
        (40, 0.0, ""),  # no supply: it says nothing at all
    ],
)
def test_a_servo_too_hot_or_of_a_wrong_voltage_is_refused(temperature_c: int, voltage_v: float, said: str) -> None:
    of = joint()
    of.voltage_limits_v = (10.0, 14.0)
    rest = {"position": 2000, "moving": False, "under_way": False, "goal": 2000, "profile": b"", "current": 0}
    report = Report(**rest, temperature_c=temperature_c, voltage_v=voltage_v)  # type: ignore[arg-type]
    if not said:
        of.check_health(report)
        return
    with pytest.raises(DeviceError, match=said):
        of.check_health(report)


# ---- profiles ----


def test_units_of_the_profile_are_those_of_the_manual() -> None:
    """0.229 turns a minute, and 214.577 turns a minute squared (ROBOTIS e-Manual, "Profile Velocity(112)")."""
    assert pytest.approx(0.229 * 360 / 60) == VELOCITY_UNIT_DEG_S
    assert pytest.approx(214.577 * 360 / 60**2) == ACCELERATION_UNIT_DEG_S2


@pytest.mark.parametrize("gear", [1.0, 3.0])
def test_a_profile_is_rounded_down_to_whole_units(gear: float) -> None:
    of = joint({"limits_deg": (-20.0, 20.0)}, gear_ratio=gear)
    set_profile(of, 10.9 * VELOCITY_UNIT_DEG_S / gear, 7.9 * ACCELERATION_UNIT_DEG_S2 / gear)
    assert of.profile == (7).to_bytes(4, "little") + (10).to_bytes(4, "little")
    assert of.speed_deg_per_s == pytest.approx(10 * VELOCITY_UNIT_DEG_S / gear)
    set_profile(of, 1e6, 1.0, largest=200)
    assert of.profile == (1).to_bytes(4, "little") + (200).to_bytes(4, "little")
    assert of.speed_deg_per_s == pytest.approx(200 * VELOCITY_UNIT_DEG_S / gear)
    set_profile(of, 1e-3, 1e-3)
    assert of.profile == (1).to_bytes(4, "little") * 2


@pytest.mark.parametrize("gear", [1.0, 2.0])
def test_what_a_profile_cannot_say_is_refused(gear: float) -> None:
    slowest, unit = VELOCITY_UNIT_DEG_S / gear, ACCELERATION_UNIT_DEG_S2 / gear
    limits = {"limits_deg": (-20.0, 20.0)}
    joint({"speed_deg_per_s": slowest} | limits, gear_ratio=gear)
    with pytest.raises(ConfigError, match="Profile Velocity 1"):
        joint({"speed_deg_per_s": 0.999 * slowest} | limits, gear_ratio=gear)
    of = joint(limits, gear_ratio=gear)
    for acceleration in (unit, 32_767 * unit * (1 - 1e-12)):
        check_acceleration(of, acceleration)
    for acceleration in (0.999 * unit, 1.001 * 32_767 * unit):
        with pytest.raises(ConfigError, match="acceleration_deg_per_s2"):
            check_acceleration(of, acceleration)


@pytest.mark.parametrize(("approach", "limits"), [(2.0, (8.0, 50.0)), (-2.0, (10.0, 52.0)), (0.0, (10.0, 50.0))])
def test_a_changer_turns_between_its_places_and_the_way_to_them(approach: float, limits: tuple[float, float]) -> None:
    changer = Changer.model_validate(
        {"id": 9, "model": "xl330-m288", "sample_deg": 50.0, "reference_deg": 10.0, "speed_deg_per_s": 20.0}
    )
    assert changer_joint(BUS, changer, approach).limits_deg == limits


# ---- where a servo stands ----


@pytest.mark.parametrize(
    ("items", "count"),
    [
        ({}, 5000 - PER_TURN),  # without torque it counts turns on
        ({"Torque Enable": 1}, 5000),
        ({"Operating Mode": 4}, 5000),
    ],
)
def test_a_servo_without_torque_comes_back_within_a_turn(items: dict[str, int], count: int) -> None:
    says = {"Present Position": 5000, "Operating Mode": 3, "Torque Enable": 0} | items
    assert preparation._position_at_torque_on(cast(Joint, SimpleNamespace(get=says.__getitem__))) == count


@pytest.mark.parametrize(
    ("items", "holds"),
    [
        ({}, True),
        ({"Torque Enable": 0}, False),
        ({"Moving": 1}, False),
        ({"Moving Status": 0x02}, False),
        ({"Moving Status": 0x01}, True),  # in position
        ({"Goal Position": 2022}, True),  # 1.93 degrees
        ({"Goal Position": 2023}, False),
        ({"Goal Position": 1977}, False),
    ],
)
def test_a_servo_holds_that_stands_near_its_goal(items: dict[str, int], holds: bool) -> None:
    says = {"Torque Enable": 1, "Moving": 0, "Moving Status": 0, "Goal Position": 2000} | items
    seen = SimpleNamespace(get=says.__getitem__, distance_deg=joint().distance_deg)
    assert preparation._holds(cast(Joint, seen), 2000) is holds


@pytest.mark.parametrize(
    ("mode", "offset", "drive", "count"),
    [(3, 100, 0, 900), (3, 1024, 0, -24), (3, 1025, 0, 1000), (3, -1025, 0, 1000), (4, 1025, 0, -25), (3, 0, 1, None)],
)
def test_a_servos_own_offset_is_taken_out(mode: int, offset: int, drive: int, count: int | None) -> None:
    """In Position mode one beyond a quarter of a turn counts as none (ROBOTIS e-Manual, "Homing Offset(20)")."""
    of = joint()
    says = {"Operating Mode": mode, "Homing Offset": offset, "Present Position": 1000, "Drive Mode": drive}
    object.__setattr__(of, "get", says.__getitem__)
    assert of.undisplaced_count() == count


def test_a_report_lies_in_one_block() -> None:
    """From Profile Acceleration (108) to Present Temperature (146), of 1 byte; positions are signed."""
    assert span(control_table.of_model("xm430-w350")) == (108, 39)
    block = bytearray(39)
    block[132 - 108 : 136 - 108] = (-5).to_bytes(4, "little", signed=True)
    block[146 - 108] = 41
    found = joint().reported(bytes(block))
    assert (found.position, found.temperature_c) == (-5, 41)
