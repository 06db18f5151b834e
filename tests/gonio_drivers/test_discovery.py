"""What hangs at unknown ports, over the twins: nothing lights, and a servo that was wiggled stands where it stood."""

from pathlib import Path

import pytest
from gonio_drivers import service
from gonio_drivers.lab import LAB
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.lamps import LAMPS, Shine
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.twins import Twins

from gonio.rig import FoundServo
from tests.gonio_drivers.conftest import small
from tests.gonio_drivers.virtual import VirtualClock


@pytest.mark.slow
@pytest.mark.parametrize("dialect", ["scpi", "mightex", "arduino"])
def test_a_lamps_dialect_is_found_and_nothing_lights(dialect: str, tmp_path: Path, hours: VirtualClock) -> None:
    lit: list[bool] = []

    def shine(state: Shine) -> None:
        lit.append(state.lit)

    lamp = LAMPS[dialect](small().bands.all(), shine, Faults())
    with SerialPeer(lamp, tmp_path / "lamp", tells_opening=lamp.resets_on_open):
        found = service.lamp_on(str(tmp_path / "lamp"))
    assert found is not None
    assert found[0] == dialect
    assert not any(lit)


def test_a_release_box_is_known_without_an_exposure(twins: Twins, tmp_path: Path) -> None:
    assert service.is_release(twins.peers["release"].port)
    assert not service.is_release(twins.peers["lamp"].port)
    assert not list((tmp_path / "twin" / "frames").iterdir())


def test_a_wiggle_comes_back_and_leaves_the_torque_as_it_was(twins: Twins) -> None:
    servo = twins.servos["camera"]
    before, moved = servo.shaft()[0], []
    servo.leaving = lambda: moved.append(servo.shaft()[0])
    service.wiggle(FoundServo(twins.peers["servos"].port, servo.baud, servo.id, "xm430-w350", 46))
    assert abs(servo.shaft()[0] - before) < service.WIGGLE_COUNTS / 3 + 1
    assert max(moved) - before > service.WIGGLE_COUNTS / 2
    assert not servo.torque


def test_the_twins_hold_what_the_rig_asks_for(twins: Twins) -> None:
    rig = LAB.open(twins.description, sample=None, seed=0, confirm=False)
    held = []
    for what in ("mirror", "empty", "sample"):
        assert rig.put(what)
        held.append(twins._target())
    assert held == ["mirror", "empty", "sample"]


def test_without_a_file_for_it_only_a_person_can_put_something(twins: Twins) -> None:
    devices = {name: table for name, table in twins.description.devices.items() if name != "holder"}
    rig = LAB.open(twins.description.model_copy(update={"devices": devices}), sample=None, seed=0, confirm=False)
    assert not rig.put("mirror")
