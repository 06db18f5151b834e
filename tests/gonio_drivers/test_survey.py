"""What a survey makes of the readings of a servo that nobody has opened, and of strains."""

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest
from gonio_drivers import arms as servo_arms
from gonio_drivers.arms import ServoArms
from gonio_drivers.joints import Joint, Report

from gonio.lab.rig import Reading
from tests.gonio_drivers.test_joints import joint

PER_DEG = 4096 / 360


def asked(
    places: Sequence[int | None],
    block: Mapping[int, int] | None = None,
    arm: dict[str, Any] | None = None,
    items: Mapping[str, int] | None = None,
) -> dict[str, Reading]:
    """The readings of a joint, by quantity: its places look after look, bytes of its report, and other items."""
    of = joint(arm)
    says = {
        "Max Voltage Limit": 140, "Min Voltage Limit": 100, "Hardware Error Status": 0, "Temperature Limit": 0,
        "Torque Enable": 1, "Homing Offset": 0, "Drive Mode": 0, "Operating Mode": 3,
    } | dict(items or {})  # fmt: skip
    report = bytearray(39)
    for address, value in ({146: 41, 144: 121, 126: 10} | dict(block or {})).items():
        report[address - 108] = value
    looks = iter(places)
    changes = {
        "get": says.__getitem__,
        "identify_model": lambda: None,
        "shaft_count": lambda: next(looks),
        "bus": SimpleNamespace(read=lambda identity, address, size: bytes(report)),
        "full_current": 100,
    }
    for name, change in changes.items():
        object.__setattr__(of, name, change)
    return {reading.quantity: reading for reading in servo_arms._asked(of)}


def test_a_servo_at_rest_says_where_it_stands_and_how_it_is() -> None:
    found = asked([2000, 2002, 2000, 2001, 2002])
    assert found["angle"].value == pytest.approx(1.0 / PER_DEG), "the mean of five looks"
    assert found["angle"].limit == (-60.0, 50.0)
    assert "angle_spread" not in found
    assert (found["temperature"].value, found["temperature"].limit) == (41, (-math.inf, 80))
    assert (found["voltage"].value, found["voltage"].limit) == (12.1, (10.0, 14.0))
    assert found["current"].value == pytest.approx(26.9), "in units of 2.69 mA"
    assert found["current"].limit == pytest.approx((-269.0, 269.0))
    assert [found[name].value for name in ("motion", "torque", "error")] == ["still", "holds", "none"]


@pytest.mark.parametrize(
    ("apart", "step_deg", "unsteady"),
    [
        (2, 0.0, False),
        (3, 0.0, True),  # two and a half counts
        (8, 0.3, False),  # 0.70 of 0.75 degrees: steps that the rig file has
        (9, 0.3, True),
    ],
)
def test_places_that_lie_too_far_apart_do_not_tell_where_it_stands(apart: int, step_deg: float, unsteady: bool) -> None:
    found = asked([2000, 2000 + apart, 2000, 2000, 2000], arm={"encoder_step_deg": step_deg})
    assert ("angle_spread" in found) is unsteady
    if unsteady:
        assert found["angle_spread"].value == pytest.approx(apart / PER_DEG)
        assert found["angle_spread"].limit == pytest.approx((0.0, max(2.5 * step_deg, 2.5 / PER_DEG)))
    moving = asked([2000, 2000 + apart, 2000, 2000, 2000], block={123: 0x02}, arm={"encoder_step_deg": step_deg})
    assert "angle_spread" not in moving, "it is on its way"
    assert moving["motion"].value == "moves"


def test_limits_of_the_servo_hold_where_it_has_them() -> None:
    found = asked([2000] * 5, items={"Temperature Limit": 72, "Max Voltage Limit": 0, "Torque Enable": 0})
    assert found["temperature"].limit == (-math.inf, 72)
    assert found["voltage"].limit is None
    assert found["torque"].value == "off"


def test_settings_that_falsify_an_angle_are_named() -> None:
    found = asked([2000] * 5, items={"Homing Offset": 7})
    assert found["settings"].value == "Homing Offset = 7 in the servo: taken out of the angle; a move resets it"
    found = asked([None] * 5, items={"Drive Mode": 1})
    assert "angle" not in found
    assert "the angle is not known" in str(found["settings"].value)


def test_a_strain_is_the_highest_current_and_the_lowest_voltage_since_it_was_asked() -> None:
    of = joint()
    of.full_current = 100
    at_rest = {"position": 2000, "moving": False, "under_way": False, "goal": 2000, "profile": b"", "temperature_c": 40}
    strains = (-90, 12.0), (10, 10.4)
    of.strained = [Report(**at_rest, current=current, voltage_v=volts) for current, volts in strains]  # type: ignore
    arms = cast(ServoArms, SimpleNamespace(joints={"camera": of}))
    found = {reading.quantity: reading.value for reading in ServoArms.strain(arms).readings}
    assert found == {"current_max": pytest.approx(90 * 2.69), "voltage_min": 10.4}
    assert ServoArms.strain(arms).readings == ()


@pytest.mark.parametrize(("full", "limit"), [(0, None), (100, 269.0)])
def test_a_current_without_a_limit_has_none(full: int, limit: float | None) -> None:
    of = joint()
    of.full_current = full
    found = servo_arms._current(of, -50)
    assert found.value == pytest.approx(-134.5)
    if limit is None:
        assert found.limit is None
    else:
        assert found.limit == pytest.approx((-limit, limit))
    without = SimpleNamespace(name="camera", table={})
    assert servo_arms._current(cast(Joint, without), 345) == Reading("camera", "load", 34.5, "%", (-100.0, 100.0))
