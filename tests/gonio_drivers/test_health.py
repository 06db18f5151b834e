"""The health of a laboratory rig over its twins: journalled, waited for; an interlock that stops it at once."""

import contextlib
import math
import os
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from gonio_drivers import motion as drivers_motion
from gonio_drivers.interlock import SerialLine, ServoPort, Tripped
from gonio_drivers.lab import LAB
from gonio_sim.wire import faults, motion, tether
from gonio_sim.wire.twins import Twins

from gonio.errors import ConfigError, DeviceError, EmergencyStop
from gonio.lab.acquisition import waits
from gonio.lab.acquisition.progress import Live, Pause, Silent
from gonio.lab.acquisition.run import Run
from gonio.lab.by_hand.assistant import Assistant
from gonio.lab.rig import Pose, clock
from gonio.lab.rig.description import RigDescription
from tests.gonio_drivers.conftest import SAMPLE, SCALE, angle, be_patient, bench, by_hand, opened, read, small, written
from tests.gonio_drivers.test_lab import assert_true, measure
from tests.gonio_drivers.test_ways_out import when_it_sets_out

pytestmark = pytest.mark.slow

PASSES_S = 50.0
"""On the twin's clock: longer than a step."""
INPUT = 2
CONTACT = {"axis": "light", "input": INPUT}


def described(rules: dict[str, Any] | None = None, contact: dict[str, Any] | None = None) -> RigDescription:
    """The small rig, with rules and an interlock."""
    description = small()
    devices = {name: dict(table) for name, table in description.devices.items()}
    if contact is not None:
        axes = {name: dict(axis) for name, axis in devices["servos"]["axes"].items()}
        axes["light"]["model"] = "xm540-w270"  # the 430 series has no external ports
        axes["light"].pop("current_limit", None)
        devices["servos"]["axes"], devices["interlock"] = axes, contact
    tables = description.model_dump() | {"devices": devices, "suspend": rules or {}}
    return RigDescription.model_validate(tables)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tether, "FILE_LATE_S", 0.5)
    monkeypatch.setattr(waits, "RECHECK_S", 0.02)
    monkeypatch.setattr(faults, "LASTS_S", PASSES_S)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


Serve = Callable[[RigDescription], Twins]


@pytest.fixture
def serve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Serve]:
    """On a clock that nobody waits for, but for an interlock, whose watch is a thread."""
    served = []

    def go(description: RigDescription) -> Twins:
        virtual = "interlock" not in description.devices
        if virtual:
            request.getfixturevalue("hours")
        twins = Twins(description, SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE)
        served.append(twins)
        twins.__enter__()
        if not virtual:
            be_patient(twins.peers["servos"], twins.faults, monkeypatch)
        return twins

    yield go
    for twins in served:
        twins.__exit__(None, None, None)


def said(run: Run, kind: str) -> list[str]:
    return [event["message"] for event in run.events() if event["event"] == kind]


# ---- the journal ----


def test_every_step_holds_temperature_current_and_voltage_of_every_servo(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described())
    run = measure(twins, tmp_path)
    assert_true(run, points=4)
    assert twins.quiet
    assert not any(servo.torque for servo in twins.servos.values())
    for step in run.steps():
        seen = {(r.device, r.quantity): (r.value, r.unit) for r in step.health}
        for axis in run.description.axes():
            assert seen[axis, "temperature"] == (34.0, "C")
            assert seen[axis, "voltage"] == (12.0, "V")
            assert seen[axis, "current"][1] == "mA"
        assert seen["lamp", "state"][0] == ("dark" if step.kind == "dark" else "lit")
        assert isinstance(seen["lamp", "monitor"][0], float)


# ---- waiting ----


@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ("hot", {"quantity": "temperature", "above": 60.0, "hysteresis": 2.0, "dark": True}),
        ("room-light", {"quantity": "room_light", "above": 100.0}),
    ],
)
def test_a_fault_that_passes_pauses_the_run_and_nothing_is_wrong_in_the_table(
    serve: Serve, tmp_path: Path, fault: str, rule: dict[str, Any]
) -> None:
    twins = serve(described({"watched": rule}))
    twins.inject(fault, skip=12 if fault == "room-light" else 150)
    run = measure(twins, tmp_path)
    assert twins.faults.fired == [fault]
    kinds = [event["event"] for event in run.events()]
    assert kinds.count("suspended") == kinds.count("continued") == 1
    assert_true(run, points=4)
    assert twins.quiet


def test_a_supply_that_sags_on_the_way_alone_is_seen(serve: Serve, tmp_path: Path) -> None:
    """Every poll reads the voltage: the lowest of them counts, not that at rest. Here a single one is low."""
    twins = serve(described({"sag": {"quantity": "voltage", "below": 11.0}}))
    camera, low = twins.servos["camera"], [100]

    def supply_dv() -> int:
        return low.pop() if low and camera.moves() and twins.lamp.shine.lit else 120

    camera._supply_dv = supply_dv  # type: ignore[method-assign]
    run = measure(twins, tmp_path)
    assert not low
    assert "camera voltage_min is 10 V, and below 11 pauses the run" in said(run, "suspended")[0]
    assert_true(run, points=4)


def test_a_lamp_out_of_lock_pauses_the_run(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described({"lock": {"quantity": "lock", "unless": "locked"}}))
    shipped = (files("gonio_drivers") / "dialects" / "scpi.toml").read_text()
    dialect = tmp_path / "locked.toml"
    dialect.write_text(shipped + 'lock = "SOUR:LOCK?"\n')
    rig = twins.description
    rig = rig.model_copy(update={"devices": rig.devices | {"light": rig.devices["light"] | {"dialect": str(dialect)}}})
    twins.inject("unlock", skip=4)
    run = measure(twins, tmp_path, description=rig)
    assert [text.partition(",")[0] for text in said(run, "suspended")] == ["suspend.lock: lamp lock is lost"]
    assert_true(run, points=4)
    assert {(r.value) for s in run.steps() for r in s.health if r.quantity == "lock"} == {"locked"}


# ---- interlock ----


def test_an_open_contact_at_a_servo_stops_everything_until_a_person_says_so(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(faults, "LASTS_S", math.inf)  # until it is seen, however late this machine comes to look
    twins = serve(described(contact=CONTACT))
    twins.inject("estop", axis="light", skip=400)
    with pytest.raises(Tripped, match=r"emergency stop: the contact at external port 2 of axis light .* is open"):
        measure(twins, tmp_path)
    assert twins.quiet
    assert not twins.lamp.shine.lit
    assert "emergency stop" in said(Run.open(tmp_path / "run"), "device_error")[0]
    twins.servos["light"].suffer("estop", 0.0)  # the contact is closed again, and that is not enough
    with pytest.raises(Tripped, match="not acknowledged yet: the contact at external port 2"):
        measure(twins, tmp_path, resume=True)
    by_hand(written(twins, tmp_path), "acknowledge")
    assert_true(measure(twins, tmp_path, resume=True), points=4)


@pytest.mark.parametrize(
    "words",
    [
        ["lamp", "on", "--for", "100000"],
        ["scan", "camera", "--from", "-40", "--to", "40", "--step", "0.5"],
        ["snap", "a.dng", "--lamp", "--exposure", "1"],
        ["move", "light=80"],
        ["park"],
        ["align", "--yes", "--out", "aligned.toml"],
        ["check"],
    ],
)
def test_a_contact_that_opens_ends_every_command_and_is_told(serve: Serve, tmp_path: Path, words: list[str]) -> None:
    """It opens when the lamp is lit, or an axis on its way; `check` lights the lamp for its last frame."""
    twins = serve(described(contact=CONTACT))
    rig = written(twins, tmp_path)
    servo = twins.servos["light"]

    moves = words[0] in ("move", "park")
    owner, name = (servo, "_drive") if moves else (twins.lamp, "_changed")
    call = getattr(owner, name)

    def opens(*given: object) -> None:
        """In the twin's own thread, at the call that lights the lamp or starts the axis."""
        call(*given)
        if servo.moves() if moves else twins.lamp.shine.lit:
            servo.contacts.clear()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, opens)
        done = by_hand(rig, *words, code=3)
    assert "emergency stop" in " ".join(f"{done.stderr} {done.stdout}".split()), done.stderr
    assert not twins.lamp.shine.lit
    # and who comes to look afterwards is told, too: the contact, and then what nobody has acknowledged
    by_hand(rig, "read", code=None, prints=["BAD: error", "emergency stop"])
    servo.contacts.add(INPUT)
    assert "not acknowledged" in read(rig, code=None)["devices"]["interlock"]["error"]["value"]
    by_hand(rig, "acknowledge")
    assert read(rig, code=None)["devices"]["interlock"]["error"]["value"] == "none"


def test_a_contact_that_opens_ends_live_alignment_and_a_paused_run(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described(contact=CONTACT))
    held = bench(twins, "arms", "light", "camera")
    assistant = Assistant(held, tell=lambda what, _: None, say=lambda text: None)
    with pytest.raises(EmergencyStop), held:  # noqa: PT012
        held.hold()
        with assistant.timer:
            assistant.obey("lamp on")
            twins.servos["light"].contacts.clear()
            assistant.run()
    assert not twins.lamp.shine.lit
    twins.servos["light"].contacts.add(INPUT)
    by_hand(written(twins, tmp_path), "acknowledge")

    class Pauses(Silent):
        """Somebody who pauses the run for good, and opens the contact then."""

        def waited(self, seconds: float) -> None:
            raise AssertionError("it went on")

        def say(self, text: str) -> None:
            if "paused" in text:
                twins.servos["light"].contacts.clear()

    pause = Pause()
    pause.ask("somebody")
    with pytest.raises(EmergencyStop, match="the contact"):
        measure(twins, tmp_path, Pauses(), pause=pause)


def test_an_interlock_that_cannot_be_read_is_told(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described(contact={"port": str(tmp_path / "no-port")}))
    assert "which counts as open" in read(written(twins, tmp_path), code=3)["silent"]["interlock"]


def test_while_the_contact_is_open_nothing_moves_and_no_lamp_lights_up(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described(contact=CONTACT))
    twins.servos["light"].contacts.clear()
    before = {name: servo.shaft()[0] for name, servo in twins.servos.items()}
    with pytest.raises(Tripped):
        opened(twins).__enter__()
    light = opened(twins)
    light.only("light")
    with light, pytest.raises(Tripped):  # to darken is always allowed
        light.light.on()
    assert {name: servo.shaft()[0] for name, servo in twins.servos.items()} == before
    by_hand(written(twins, tmp_path), "acknowledge", code=3)


def test_a_stop_in_mid_move_comes_at_once(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first look at the open contact darkens the lamp, and the next poll of the arms stops them.

    tools/studies/findings.md has how long that takes; here a busy machine may take as long as it likes.
    """
    twins = serve(described(contact=CONTACT))
    light = twins.servos["light"]
    rig = opened(twins)
    saw_open: list[bool] = []
    late: list[float] = []
    closed = ServoPort.closed

    def seen(contact: ServoPort) -> bool:
        saw_open.append(not closed(contact))
        return not saw_open[-1]

    def sleep(seconds: float) -> None:
        """A poll of the arms is over; late where the stop was known before it began."""
        if any(saw_open):
            late.append(seconds)
        clock.sleep(seconds)

    monkeypatch.setattr(ServoPort, "closed", seen)
    monkeypatch.setattr(drivers_motion, "clock", SimpleNamespace(sleep=sleep))
    with contextlib.suppress(Tripped), rig:
        rig.light.on()
        when_it_sets_out(light, light.contacts.clear)
        with pytest.raises(Tripped):
            rig.arms.move(Pose(light=0.0, camera=0.2))
        assert not any(servo.moves() for servo in twins.servos.values())
        assert angle(twins, "light") < -5.0, "it has arrived"
        rig.interlock.require()  # type: ignore[union-attr]
    assert saw_open.index(True) == len(saw_open) - 1, "it looked on"
    assert len(late) <= 1, "the one whose look at the contact was just before"
    assert twins.quiet


def test_a_servo_without_external_ports_is_refused(serve: Serve) -> None:
    description = described()
    devices = description.devices | {"interlock": {"axis": "camera"}}
    with pytest.raises(ConfigError, match="has no external port"):
        LAB.open(description.model_copy(update={"devices": devices}), sample=None, seed=0, confirm=False)


# ---- a serial line ----


def test_modem_lines_of_a_serial_port_are_read() -> None:
    """pyserial's loop joins RTS to CTS and DTR to DSR, as a closed contact does."""
    for name, drives in (("CTS", "rts"), ("DSR", "dtr")):
        line = SerialLine("loop://", name)
        with line:
            assert line.closed()
            setattr(line._port, drives, False)
            assert not line.closed()
        with pytest.raises(DeviceError, match="not open"):
            line.closed()


def test_a_port_without_modem_lines_is_refused() -> None:
    master, slave = os.openpty()
    try:
        with pytest.raises(DeviceError, match=r'devices.interlock.port = ".*": .*modem lines'):
            SerialLine(os.ttyname(slave), "CTS").__enter__()
    finally:
        os.close(master)
        os.close(slave)


# ---- after the supply was cut ----


class CutsSupply(Silent):
    """Somebody who switches the servos' supply off after some steps."""

    def __init__(self, twins: Twins, steps: int) -> None:
        self.twins, self.left = twins, steps

    def step(self, live: Live) -> None:
        self.left -= 1
        if self.left == 0:
            for servo in self.twins.servos.values():
                servo.lose_power()


def test_after_a_cut_supply_the_arms_have_fallen_and_the_run_goes_on(serve: Serve, tmp_path: Path) -> None:
    twins = serve(described())
    with pytest.raises(DeviceError):
        measure(twins, tmp_path, CutsSupply(twins, 3))
    assert not twins.lamp.shine.lit
    for servo in twins.servos.values():
        servo.powered = True
        servo._path = motion.rest(servo._clock(), servo.shaft()[0] - 250)  # counts: 22 deg, with no torque to hold it
        servo.restart()
    assert_true(measure(twins, tmp_path, resume=True), points=4)
    assert twins.quiet
