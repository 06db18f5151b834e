"""Settings in a servo that falsify its angle are named, over the twins."""

import math
from pathlib import Path

import pytest
from gonio_drivers.lab import LAB
from gonio_sim.wire.twins import Twins

from gonio.errors import DeviceError
from tests.gonio_drivers.conftest import (
    angle,
    bench,
    by_hand,
    read,
    written,
)  # fmt: skip
from tests.gonio_drivers.test_servo_ids import found

pytestmark = pytest.mark.slow


def put(twins: Twins, axis: str, **items: int) -> None:
    """Settings of a servo, whose torque is off, as another program left them."""
    for name, value in items.items():
        item = twins.servos[axis].table.items[name.replace("_", " ")]
        twins.servos[axis].write(item.address, (value % (1 << 8 * item.size)).to_bytes(item.size, "little"))


@pytest.mark.parametrize(
    ("items", "named", "known"),
    [
        ({"Homing_Offset": 300}, "Homing Offset = 300", True),
        ({"Homing_Offset": -1000}, "Homing Offset = -1000", True),
        ({"Homing_Offset": 2000}, "Homing Offset = 2000", True),  # beyond a quarter of a turn it counts as none
        ({"Operating_Mode": 4, "Homing_Offset": 2000}, "Operating Mode = 4", True),
        ({"Operating_Mode": 1}, "Operating Mode = 1", True),
        ({"Drive_Mode": 1}, "Drive Mode = 1", False),
        ({"Drive_Mode": 1, "Homing_Offset": 300}, "Homing Offset = 300", False),
    ],
)
def test_settings_in_a_servo_that_falsify_its_angle_are_named_and_the_true_angle_is_told(
    twins: Twins, tmp_path: Path, items: dict[str, int], named: str, known: bool
) -> None:
    rig, true = written(twins, tmp_path), angle(twins, "light")
    put(twins, "light", **items)
    said = read(rig)["devices"]["light"]
    assert named in said["settings"]["value"]
    assert ("angle" in said, "the angle is not known" in said["settings"]["value"]) == (known, not known)
    by_hand(rig, "read", prints="BAD: settings")
    servo = found(twins, 1, twins.servos["light"].baud)
    if known:  # and so is a rig file that is made from where its axes stand now
        assert said["angle"]["value"] == pytest.approx(true, abs=360 / 4096)  # the shaft stops somewhere in its count
        assert LAB.count_of(servo) == pytest.approx((twins.servos["light"].travelled() + 0.5) % 4096, abs=1.0)
    else:
        with pytest.raises(DeviceError, match="reverse mode"):
            LAB.count_of(servo)


def test_the_angle_that_is_read_is_where_a_move_finds_the_axis(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    put(twins, "light", Homing_Offset=300)
    said = read(rig)["devices"]["light"]["angle"]["value"]
    with bench(twins, "arms") as held:  # opening resets it
        assert math.degrees(held.arms.read().light) == pytest.approx(said, abs=360 / 4096)
    assert "settings" not in read(rig)["devices"]["light"]
