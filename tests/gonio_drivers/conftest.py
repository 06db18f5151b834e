"""Twins at the other end of the cable, for the drivers and for the unmodified SDK."""

import json
import math
import select
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from dynamixel_sdk import PacketHandler, PortHandler
from gonio_drivers import folder_camera
from gonio_drivers.lab import LAB, LabRig
from gonio_drivers.sdk import ExclusivePort
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import Device, SerialPeer, SocketPeer, scaled_clock
from gonio_sim.wire.servo import Servo
from gonio_sim.wire.twins import Twins, rig_file

from gonio.config import parse
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from tests.command_line import gonio
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus, virtual_time

SCALE = 50.0
BAUD = 1_000_000
HANGS_S = 60.0
GAP_S = 0.5
"""In a packet: a busy kernel may bring one in two pieces, further apart than a servo waits."""
SAMPLE = SampleDescription(name="matt", model="lambert", parameters={"albedo": 0.5})
LONGEST_S = 300.0
"""A measurement takes 3 s, and the longest chain of timeouts and repetitions 10 s; the rest is for a busy machine."""


@dataclass
class Line:
    """A bus of servos with ids 1, 2, 3, and what belongs to it."""

    port: str
    servos: dict[int, Servo]
    faults: Faults
    peer: SerialPeer | None
    """None where the twins are in this process, and no port is between."""
    bus: ServoBus


def deaf_to(line: Line, part: bytes) -> None:
    """The servos hear nothing of a packet that holds these bytes."""
    receive = line.bus.receive
    line.bus.receive = lambda data, baud, send: None if part in data else receive(data, baud, send)  # type: ignore[method-assign]


class Counted(Device):
    """A twin, and how much it has dealt with of what was sent to it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self.bytes = 0
        self.answered = 0
        """Bytes that it sent: the kernel brings them to the other end when it has time."""
        self.dawdles = False
        """It answers late, because a fault is to make it so."""

    def receive(self, data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        def counted(answer: bytes) -> None:
            self.answered += len(answer)
            send(answer)

        try:
            self._device.receive(data, baud, counted)
        finally:
            self.bytes += len(data)
            self.dawdles = False

    def opened(self, send: Callable[[bytes], None]) -> None:
        self._device.opened(send)


def be_patient(peer: SerialPeer | SocketPeer, faults: Faults, monkeypatch: pytest.MonkeyPatch) -> None:
    """On this line silence is what servos leave unanswered, and never what a busy machine has not come to yet."""
    peer.device = twin = Counted(peer.device)
    on_status, is_over = faults.on_status, PortHandler.isPacketTimeout
    sent = heard_of = 0  # bytes to the twin, and those of its answers that were read or are none of the last packet's
    sent_s = 0.0  # by a clock that nobody sets: the SDK's own may jump while a machine is being put in order

    def told(servo: Servo, status: bytes) -> list[tuple[float, bytes]]:
        chunks = on_status(servo, status)
        twin.dawdles = any(delay_s for delay_s, _ in chunks)
        return chunks

    def counting(write: Callable[[PortHandler, list[int]], int]) -> Callable[[PortHandler, list[int]], int]:
        def written(port: PortHandler, packet: list[int]) -> int:
            nonlocal sent, sent_s, heard_of
            if port.port_name == peer.port:
                sent_s = time.monotonic()
                sent += len(packet)
                heard_of = twin.answered
            return write(port, packet)

        return written

    def hearing(read: Callable[[PortHandler, int], bytes]) -> Callable[[PortHandler, int], bytes]:
        def heard(port: PortHandler, length: int) -> bytes:
            nonlocal heard_of
            data = read(port, length)
            heard_of += len(data) if port.port_name == peer.port else 0
            return data

        return heard

    def is_silent(port: PortHandler) -> bool:
        over = is_over(port)
        if not over or port.port_name != peer.port:
            return over
        all_said = twin.bytes >= sent and heard_of >= twin.answered
        done = all_said or twin.dawdles or time.monotonic() - sent_s > HANGS_S
        return done and not select.select([port.ser.fileno()], [], [], 0)[0]

    monkeypatch.setattr(faults, "on_status", told)
    monkeypatch.setattr(PortHandler, "isPacketTimeout", is_silent)
    for kind in (PortHandler, ExclusivePort):
        monkeypatch.setattr(kind, "writePort", counting(kind.writePort))
        monkeypatch.setattr(kind, "readPort", hearing(kind.readPort))
    monkeypatch.setattr(p2, "LONGEST_GAP_S", GAP_S)


@pytest.fixture
def hours(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualClock]:
    """Drivers and twins are on a clock that nobody waits for."""
    with virtual_time(monkeypatch) as clock:
        yield clock


@pytest.fixture
def wired(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    clock = scaled_clock(SCALE)
    servos = {k: Servo(k, clock, model="xm430-w350", baud=BAUD, position=1000.0 + 500 * k) for k in (1, 2, 3)}
    for servo in servos.values():
        servo.write(9, b"\x00")
    faults = Faults()
    bus = ServoBus(servos.values(), faults)
    with SerialPeer(bus) as peer:
        be_patient(peer, faults, monkeypatch)
        yield Line(peer.port, servos, faults, peer, bus)


@pytest.fixture
def line(hours: VirtualClock) -> Line:
    """Three servos in this process, on a clock that nobody waits for; `wired` has them at a port."""
    there: dict[int, Servo] = {}

    def built() -> Iterable[Servo]:
        clock = scaled_clock(1.0)
        there.update({k: Servo(k, clock, baud=BAUD, position=1000.0 + 500 * k) for k in (1, 2, 3)})
        for servo in there.values():
            servo.write(9, b"\x00")
        return there.values()

    bus = servo_bus(built)
    return Line(PORT, there, bus.faults, None, bus)


@pytest.fixture
def unwatched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The servos' watchdogs never run out, however long this machine stands still."""
    monkeypatch.setattr(Servo, "_watch", lambda servo, wall_s: None)


@pytest.fixture
def sdk(wired: Line) -> Iterator[tuple[PortHandler, PacketHandler]]:
    port = PortHandler(wired.port)
    port.setBaudRate(BAUD)
    yield port, PacketHandler(2.0)
    port.closePort()


# ---- a whole laboratory ----


def small(**changes: dict[str, Any]) -> RigDescription:
    """The shipped rig with a small sensor and few frames: it measures the same patch in a tenth of the time."""
    tables = tomllib.loads(LAB.toml)
    tables["camera"] |= {"width": 64, "height": 48}
    tables["reference"] |= {"frames": 3}
    tables["acquisition"] |= {"dark_frames": 2}
    tables["devices"]["camera"]["timeout_s"] = LONGEST_S
    for name, table in changes.items():
        tables[name] |= table
    return parse(RigDescription, tables, "lab.toml")


@pytest.fixture
def real_time() -> None:
    """The twins of this test are at terminals, on the real clock: for other processes and threads."""


def patient_dialect(folder: Path) -> Path:
    """The lamp's language, for a lamp that may take a minute for its answers: its twin's process may be held up."""
    text = files("gonio_drivers").joinpath("dialects", "scpi.toml").read_text()
    path = folder / "patient.toml"
    path.write_text(f"{text}timeout_s = 60.0\n")
    return path


@pytest.fixture
def twins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Twins]:
    """Twins of the small rig; on a clock that nobody waits for, but for `real_time`."""
    virtual = "real_time" not in request.fixturenames
    if virtual:
        request.getfixturevalue("hours")
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)  # a busy disk is not what is tested
    monkeypatch.setattr(folder_camera, "RELEASE_S", LONGEST_S)
    with Twins(small(), SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE) as served:
        if not virtual:
            served.world.description.devices["light"]["dialect"] = str(patient_dialect(tmp_path))
            be_patient(served.peers["servos"], served.faults, monkeypatch)
        yield served


PATIENT = (
    "from gonio_drivers import folder_camera, motion, ports, sdk; "
    f"folder_camera.RELEASE_S = motion.GRACE_S = ports.CLOGGED_S = {LONGEST_S}; sdk.PATIENCE_MS = {1e3 * HANGS_S}; "
)
COMMAND = [sys.executable, "-c", PATIENT + "from gonio.cli import main; main()"]
"""The command as a process of its own, which waits for the twins in this one: as of `be_patient`."""


def written(twins: Twins, tmp_path: Path, **changes: Any) -> Path:
    """The twins' rig file, with some tables changed."""
    path = tmp_path / "my.toml"
    path.write_text(rig_file(twins.description.model_copy(update=changes)))
    return path


def by_hand(
    rig: Path,
    *words: str | Path,
    code: int | None = 0,
    says: str | Iterable[str] = (),
    prints: str | Iterable[str] = (),
) -> subprocess.CompletedProcess[str]:
    """`gonio rig ...` in the folder of a rig file: how it ends, what it says and what it prints, line ends aside."""
    done = gonio(rig.parent, "rig", *words, "--rig", rig)
    assert code in (None, done.returncode), done.stderr
    for texts, stream in ((says, done.stderr), (prints, done.stdout)):
        for text in [texts] if isinstance(texts, str) else texts:
            assert text in " ".join(stream.split()), stream
    return done


def read(rig: Path, code: int | None = 0) -> Any:
    """What `gonio rig read --json` prints."""
    return json.loads(by_hand(rig, "read", "--json", code=code).stdout)


def angle(twins: Twins, name: str) -> float:
    """Where a shaft stands, as an angle of its axis [deg]."""
    return math.degrees(twins.followers[name].encoder())


def opened(twins: Twins) -> LabRig:
    """The rig on these twins, to be entered."""
    return LAB.open(twins.description, sample=None, seed=0, confirm=False)


def bench(twins: Twins, *only: Any) -> ManualRig:
    """The same for work by hand."""
    return ManualRig(opened(twins), "", only)


@pytest.fixture
def arms(line: Line) -> Iterator[Any]:
    """`tests.gonio_drivers.servo_arms`, at the line."""
    from gonio_drivers.arms import ServoArms

    from tests.gonio_drivers.servo_arms import describe, servos

    with ServoArms(describe(), servos(line.port)) as opened:
        yield opened


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The twins answer a broadcast ping at once, where real ones take turns; and two line speeds are enough."""
    monkeypatch.setattr("gonio_drivers.service.EVERYBODY_S", 0.3)
    monkeypatch.setattr("gonio_drivers.dynamixel.BAUD_RATES", (57_600, 1_000_000))
