"""The servo bus over the real SDK against the twin: every pitfall of the SDK."""

import contextlib
import os
import pty
import random
import select
import threading
from collections.abc import Callable, Iterator

import pytest
import serial
from gonio_drivers import control_table, dynamixel, ports, sdk
from gonio_drivers.dynamixel import Bus
from gonio_sim.wire import protocol2 as p2

from gonio.errors import DeviceError
from tests.gonio_drivers.conftest import BAUD, Line, deaf_to


@pytest.fixture
def line(wired: Line) -> Line:
    """At a terminal: the bytes of a bus are what is tested."""
    return wired


def test_a_late_reply_is_not_the_answer_to_the_next_request(line: Line) -> None:
    with Bus(line.port, BAUD) as bus:
        line.faults.arm("late-reply", servo=1)
        position = int.from_bytes(bus.read(1, 132, 4), "little")
        acceleration = int.from_bytes(bus.read(1, 108, 4), "little")
    assert (position, acceleration) == (1500, 0)


def test_noise_is_passed_over_and_told(line: Line, caplog: pytest.LogCaptureFixture) -> None:
    with Bus(line.port, BAUD) as bus:
        for _ in range(5):
            line.faults.arm("noise")
            assert bus.read(2, 132, 4) == (2000).to_bytes(4, "little")
        assert line.peer is not None
        line.peer.send(b"\x55\xaa")  # between packets
        while bus._port.ser.in_waiting < 2:
            pass
        assert len(bus.read_all([1, 2, 3], 132, 4)) == 3
        assert bus.noisy == 6
    # the first, the second and the fourth time
    assert [record.args[1] for record in caplog.records if isinstance(record.args, tuple)] == [7] * 3


def test_an_exception_in_a_transaction_leaves_the_port_free(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    with Bus(line.port, BAUD) as bus:
        real = bus._port.readPort

        def interrupted(length: int) -> bytes:
            monkeypatch.setattr(bus._port, "readPort", real)
            raise KeyboardInterrupt

        monkeypatch.setattr(bus._port, "readPort", interrupted)
        with pytest.raises(KeyboardInterrupt):
            bus.ping(1)
        assert bus.ping(1) == (1020, 46)


def test_an_error_without_data_is_a_refusal(line: Line) -> None:
    with Bus(line.port, BAUD) as bus, pytest.raises(dynamixel.Refusal, match=r"address") as refusal:
        bus.read(1, 900, 4)
    assert refusal.value.error == p2.ACCESS_ERROR


def test_alert_bits_survive_a_group_read(line: Line) -> None:
    line.servos[2].temperature_c = 99
    with Bus(line.port, BAUD) as bus:
        bus.read_all([1, 2, 3], 132, 4)
        assert bus.alerts == {2}


def test_one_silent_servo_fails_the_group_and_never_reads_as_zero(line: Line) -> None:
    line.servos[2].lose_power()
    with Bus(line.port, BAUD) as bus:
        assert {k: int.from_bytes(v, "little") for k, v in bus.read_all([1, 3], 132, 4).items()} == {1: 1500, 3: 2500}
        with pytest.raises(dynamixel.BusError, match=r"servo id 2"):
            bus.read_all([1, 2, 3], 132, 4)


def test_servos_that_know_no_sync_read_are_asked_one_by_one(line: Line, caplog: pytest.LogCaptureFixture) -> None:
    deaf_to(line, bytes([p2.SYNC_READ, 132, 0]))
    with Bus(line.port, BAUD) as bus:
        for _ in range(5):
            blocks = bus.read_all([1, 2, 3], 132, 4)
            assert {k: int.from_bytes(v, "little") for k, v in blocks.items()} == {1: 1500, 2: 2000, 3: 2500}
        assert bus.unheard == 3  # it was tried three times, and no more
    assert "nobody answers a sync read" in caplog.text


def test_an_answer_out_of_turn_is_older_than_the_question() -> None:
    """A repeated packet of the last servo comes first: its old position is none for now."""

    def reply(packet: p2.Packet) -> bytes:
        if packet.instruction == p2.PING:
            return p2.status(packet.id, 0, b"\xfc\x03\x2e")
        if packet.instruction == p2.READ:
            return p2.status(packet.id, 0, bytes([packet.id]))
        return p2.status(3, 0, b"\xee") + b"".join(p2.status(k, 0, bytes([k])) for k in (1, 2, 3))

    with answering(reply) as bus:
        for _ in range(dynamixel.ENOUGH + 1):
            assert bus.read_all([1, 2, 3], 132, 1) == {1: b"\x01", 2: b"\x02", 3: b"\x03"}
        assert bus.unheard < dynamixel.ENOUGH


def test_a_line_that_is_never_silent_is_no_servo_bus(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamixel, "BABBLE_S", 0.02)
    with Bus(line.port, BAUD) as bus:
        monkeypatch.setattr(bus._port, "readPort", lambda length: b"\x2a" * length)
        with pytest.raises(DeviceError, match=r"something else talks on this line without a pause"):
            bus.discover()


def test_values_are_signed(line: Line) -> None:
    line.servos[1].write(11, b"\x04")  # extended position mode
    line.servos[1].write(116, (-300).to_bytes(4, "little", signed=True))
    table = control_table.of_model("xm430-w350")
    with Bus(line.port, BAUD) as bus:
        item = table["Goal Position"]
        assert item.decode(bus.read(1, item.address, item.size), item.address) == -300
    assert item.encode(-300) == (-300).to_bytes(4, "little", signed=True)


@contextlib.contextmanager
def answering(reply: Callable[[p2.Packet], bytes]) -> Iterator[Bus]:
    """A bus with a device that answers every packet with bytes of its own making."""
    master, slave = pty.openpty()
    wake, wakener = os.pipe()

    def serve() -> None:
        reader = p2.Reader()
        while wake not in select.select([master, wake], [], [])[0]:
            for packet in reader.feed(os.read(master, 1024)):
                os.write(master, reply(packet))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with Bus(os.ttyname(slave), BAUD) as bus:
            yield bus
    finally:
        os.write(wakener, b"x")
        thread.join()
        for descriptor in (master, slave, wake, wakener):
            os.close(descriptor)


def test_a_reply_of_another_length_is_no_answer() -> None:
    replies = answering(lambda packet: p2.status(packet.id, 0, b"\x01\x02"))
    with replies as bus, pytest.raises(dynamixel.BusError, match=r"2 bytes to a request for 4"):
        bus.read(1, 132, 4)


def test_payloads_that_need_stuffing_arrive_whole_either_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """As velocity -1 before a position of 0x..FD; after one such place the SDK itself drops a byte of FF FD FD."""
    monkeypatch.setattr(sdk, "PATIENCE_MS", 60_000)  # every request is answered, on a busy machine too
    rng = random.Random(5)
    payloads = [bytes([0xFF, 0xFF, 0xFD, 0x01, 0xFF, 0xFD, 0xFD, 0x05])]
    payloads += [bytes(rng.choices((0xFF, 0xFD, 0x00), (5, 4, 1), k=12)) for _ in range(150)]
    heard: list[bytes] = []

    def reply(packet: p2.Packet) -> bytes:
        heard.append(packet.parameters)
        return p2.status(1, 0, data if packet.instruction in (p2.READ, p2.SYNC_READ) else b"")

    with answering(reply) as bus:
        for data in payloads:
            assert bus.read(1, 108, len(data)) == data
            assert bus.read_all([1], 108, len(data)) == {1: data}
            bus.write(1, 108, data)
            assert heard[-1] == bytes([108, 0]) + data
        assert (bus.recovered, bus.noisy) == (0, 0)


def test_a_port_that_goes_away() -> None:
    master, slave = pty.openpty()
    with Bus(os.ttyname(slave), BAUD) as bus:
        os.close(slave)
        os.close(master)
        with pytest.raises(DeviceError, match=r"went away"):
            bus.ping(1)


def test_a_server_that_hangs_up_is_named() -> None:
    error = ports.lost("socket://host:1", serial.SerialException("socket disconnected"), "devices.light.port")
    assert "the server has closed the connection (socket disconnected)" in str(error)


def test_a_line_that_takes_no_more_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ports, "CLOGGED_S", 0.05)
    master, slave = pty.openpty()
    with ports.opened(os.ttyname(slave), BAUD, 0.1, "port") as line, pytest.raises(serial.SerialTimeoutException):
        line.write(bytes(1_000_000))
    for descriptor in (slave, master):
        os.close(descriptor)


@pytest.mark.parametrize("clogged", [False, True])
def test_a_program_that_stood_still_after_it_wrote_has_not_lost_its_port(
    clogged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pyserial counts the standstill, and says that the write took too long; of a line that takes no more it is so."""
    master, slave = pty.openpty()
    port = sdk.ExclusivePort(os.ttyname(slave), "port")
    port.setupPort(BAUD)
    write = port.ser.write

    def late(data: bytes) -> int:
        if not clogged:
            write(data)
        raise serial.SerialTimeoutException("Write timeout")

    monkeypatch.setattr(port.ser, "write", late)
    if clogged:
        # a full pipe stands in: a system may move what a terminal holds at any time later, and make room there
        reader, full = os.pipe()
        os.set_blocking(full, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(full, bytes(4096))
        with monkeypatch.context() as swapped:
            swapped.setattr(port.ser, "fd", full)
            with pytest.raises(serial.SerialTimeoutException):
                port.writePort([1, 2, 3])
        os.close(reader)
        os.close(full)
    else:
        assert port.writePort([1, 2, 3]) == 3
        assert os.read(master, 8) == b"\x01\x02\x03"
    port.closePort()
    for descriptor in (slave, master):
        os.close(descriptor)
