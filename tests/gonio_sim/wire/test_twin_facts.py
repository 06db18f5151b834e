"""What the manual says of the servos, asked of the twin by the unmodified SDK; docs/twin_facts.md lists the facts."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import (
    COMM_RX_CORRUPT,
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PacketHandler,
    PortHandler,
)
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire import tables
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.servo import Servo

from tests.gonio_drivers.conftest import BAUD, GAP_S, Counted, be_patient
from tests.places import ROOT

PAGE = ROOT / "docs/twin_facts.md"


class HandClock:
    """A twin's clock that goes on when it is told to."""

    scale = 1.0

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def at(self, wall_s: float) -> float:
        return self.now_s


@dataclass
class ManualRig:
    """Servos on a line, the SDK at its other end, and the hands of who stands beside it."""

    port: Any
    ph: Any
    peer: SerialPeer
    bus: ServoBus
    clock: HandClock
    servos: dict[int, Servo]

    def get(self, name: str, identity: int = 1) -> int:
        """Read an item by the SDK."""
        item = self.servos[identity].table.items[name]
        data, result, error = self.ph.readTxRx(self.port, identity, item.address, item.size)
        assert (result, error & 0x7F) == (COMM_SUCCESS, 0), (name, result, error)
        return int.from_bytes(bytes(data), "little", signed=item.signed)

    def put(self, name: str, value: int, identity: int = 1) -> int:
        """Write an item by the SDK; the error number of the status packet, with its alert bit."""
        item = self.servos[identity].table.items[name]
        return self.write(item.address, (value % (1 << 8 * item.size)).to_bytes(item.size, "little"), identity)

    def write(self, address: int, data: bytes, identity: int = 1) -> int:
        result, error = self.ph.writeTxRx(self.port, identity, address, len(data), list(data))
        assert result == COMM_SUCCESS
        return int(error)

    def set(self, **values: int) -> None:
        """Write items, named with underscores, that must be taken."""
        for name, value in values.items():
            assert self.put(name.replace("_", " "), value) == 0, name

    def tell(self, instruction: int, parameters: bytes = b"", identity: int = 1) -> tuple[int, int]:
        """Any instruction: result and error."""
        packet = [0, 0, 0, 0, identity, len(parameters) + 3, 0, instruction, *parameters, 0, 0]
        _, result, error = self.ph.txRxPacket(self.port, packet)
        return result, error

    def later(self, seconds: float) -> None:
        self.clock.now_s += seconds

    def reboot(self, identity: int = 1) -> None:
        result, _ = self.ph.reboot(self.port, identity)
        assert result == COMM_SUCCESS
        assert self.ph.ping(self.port, identity)[1] == COMM_RX_TIMEOUT  # it boots, behind its answer
        self.later(1.0)

    def status(self) -> int:
        return self.get("Moving Status")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., ManualRig]]:
    """Builds a bench of servos of one model, with ids from 1 on, or with those given."""
    with contextlib.ExitStack() as stack:

        def build(model: str = "xm430-w350", *ids: int) -> ManualRig:
            clock = HandClock()
            servos = [Servo(k, clock, model=model, baud=BAUD, position=2000.0) for k in ids or (1,)]  # type: ignore[arg-type]
            for servo in servos:
                servo.registers.put("Return Delay Time", 0)
            faults = Faults()
            bus = ServoBus(servos, faults)
            peer = stack.enter_context(SerialPeer(bus))
            be_patient(peer, faults, monkeypatch)
            port = PortHandler(peer.port)
            port.setBaudRate(BAUD)
            stack.callback(port.closePort)
            return ManualRig(port, PacketHandler(2.0), peer, bus, clock, {s.id: s for s in servos})

        yield build


Build = Callable[..., ManualRig]


# ---- the page ----


def named_tests() -> list[str]:
    """The test of each row of the page's tables."""
    return re.findall(r"(?m)^\| .+ \| .+ \| `(test_\w+)` \|$", PAGE.read_text())


def test_every_fact_of_the_page_has_its_test_and_every_test_its_fact() -> None:
    facts = named_tests()
    assert len(facts) >= 70
    here = {name for name in globals() if name.startswith("test_")} - {
        "test_every_fact_of_the_page_has_its_test_and_every_test_its_fact"
    }
    elsewhere = (ROOT / "tests/gonio_sim/wire/test_twin_protocol.py").read_text()
    named = set(facts)
    assert here <= named
    assert all(f"def {name}(" in elsewhere for name in named - here)


# ---- protocol ----


def test_a_pattern_like_a_header_is_stuffed_in_both_directions(bench: Build) -> None:
    b = bench()
    said: list[bytes] = []
    on_status = b.bus.faults.on_status
    b.bus.faults.on_status = lambda servo, status: said.append(status) or on_status(servo, status)  # type: ignore[func-returns-value,method-assign]
    b.write(224, b"\xff\xff\xfd", 1)  # three indirect data bytes with their own places
    b.ph.readTxRx(b.port, 1, 224, 4)
    assert b.servos[1].read(224, 3) == b"\xff\xff\xfd"
    assert b"\x55\x00\xff\xff\xfd\xfd\x00" in said[-1]


def test_the_length_counts_what_follows_it_stuffed_bytes_too() -> None:
    packet = p2.Packet(1, p2.WRITE, b"\xe0\x00\xff\xff\xfd").encode()
    assert int.from_bytes(packet[5:7], "little") == len(packet) - 7 == 9


def test_a_gap_in_a_packet_makes_a_servo_wait_for_the_next_header(bench: Build) -> None:
    b = bench()
    packet = list(p2.Packet(1, p2.WRITE, bytes([65, 0, 1])).encode())
    twin = b.peer.device
    assert isinstance(twin, Counted)
    b.port.writePort(packet[:9])
    while twin.bytes < 9:
        time.sleep(0.001)
    time.sleep(2 * GAP_S)  # twice what is allowed here; a servo waits 1.5 ms
    b.port.writePort(packet[9:])
    while twin.bytes < len(packet):
        time.sleep(0.001)
    assert b.get("LED") == 0
    assert b.put("LED", 1) == 0


def test_bytes_that_follow_soon_are_one_packet() -> None:
    reader, packet = p2.Reader(), p2.Packet(1, p2.PING).encode()
    assert list(reader.feed(packet[:5], 1.0)) == []
    assert len(list(reader.feed(packet[5:], 1.0014))) == 1
    assert list(reader.feed(packet[:5], 2.0)) == []
    assert list(reader.feed(packet[5:], 2.0016)) == []


def test_a_status_packet_takes_the_time_of_its_bytes(bench: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench()
    slept: list[float] = []
    monkeypatch.setattr("gonio_sim.wire.bus.clock.sleep", slept.append)
    b.get("Present Position")
    assert slept[-1] == pytest.approx(15 * 10 / BAUD)  # 15 bytes of ten bits


def test_the_return_delay_is_two_microseconds_a_unit(bench: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench()
    b.set(Return_Delay_Time=10)
    slept: list[float] = []
    monkeypatch.setattr("gonio_sim.wire.bus.clock.sleep", slept.append)
    b.get("LED")
    assert slept[-1] == pytest.approx(20e-6 + 12 * 10 / BAUD)
    assert tables.table("xm430-w350").factory["Return Delay Time"] == 250
    assert b.put("Return Delay Time", 255) == p2.RANGE_ERROR


def test_a_broadcast_ping_is_answered_in_the_order_of_ids(bench: Build) -> None:
    b = bench("xm430-w350", 9, 4, 7)
    out: list[bytes] = []
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.PING).encode(), BAUD, out.append)
    assert [status[4] for status in out] == [4, 7, 9]


def test_two_servos_with_one_id_damage_each_others_answers(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    b.servos[2].turn(345.0)
    b.servos[2].registers.put("ID", 1)
    assert b.ph.readTxRx(b.port, 1, 132, 4)[1] == COMM_RX_CORRUPT
    assert b.ph.ping(b.port, 1) == (1020, COMM_SUCCESS, 0)  # their answers agree bit by bit


def test_servos_of_two_models_with_one_id_damage_a_broadcast_ping(bench: Build) -> None:
    b = bench("xm430-w350", 1)
    b.bus.servos.append(Servo(1, b.clock, model="xl430-w250", baud=BAUD))  # type: ignore[arg-type]
    b.bus.servos[1].registers.put("Return Delay Time", 0)
    assert b.ph.broadcastPing(b.port) == ({}, COMM_RX_CORRUPT)


def test_answers_with_different_delays_overlap_in_part(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    b.servos[2].registers.put("ID", 1)
    b.servos[2].registers.put("Return Delay Time", 25)  # five bytes later
    out: list[bytes] = []
    b.bus.receive(p2.Packet(1, p2.PING).encode(), BAUD, out.append)
    whole = p2.status(1, 0, bytes([0xFC, 0x03, 46]))
    assert len(out[0]) == 5 + len(whole)
    assert out[0][:5] == whole[:5]
    assert list(p2.Reader().feed(out[0])) != list(p2.Reader().feed(whole))


def test_reads_and_writes_to_everybody_are_not_answered(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    out: list[bytes] = []
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.READ, bytes([132, 0, 4, 0])).encode(), BAUD, out.append)
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.WRITE, bytes([65, 0, 1])).encode(), BAUD, out.append)
    assert out == []
    assert (b.get("LED", 1), b.get("LED", 2)) == (1, 1)


def test_a_read_outside_the_table_is_refused_without_parameters(bench: Build) -> None:
    b = bench()
    out: list[bytes] = []
    b.bus.receive(p2.Packet(1, p2.READ, bytes([0, 8, 4, 0])).encode(), BAUD, out.append)
    assert out == [p2.status(1, p2.ACCESS_ERROR)]


def test_level_0_answers_pings_only(bench: Build) -> None:
    b = bench()
    b.ph.write1ByteTxOnly(b.port, 1, 68, 0)
    assert b.ph.ping(b.port, 1)[1] == COMM_SUCCESS
    assert b.ph.readTxRx(b.port, 1, 65, 1)[1] == COMM_RX_TIMEOUT


def test_an_instruction_for_several_is_for_the_broadcast_id(bench: Build) -> None:
    b = bench()
    out: list[bytes] = []
    b.bus.receive(p2.Packet(1, p2.SYNC_READ, bytes([132, 0, 4, 0, 1])).encode(), BAUD, out.append)
    assert out == []


def test_a_sync_read_ends_at_the_id_that_is_missing(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2, 3)
    group = GroupSyncRead(b.port, b.ph, 132, 4)
    for k in (1, 8, 3):
        group.addParam(k)
    assert group.txRxPacket() == COMM_RX_TIMEOUT
    out: list[bytes] = []
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.SYNC_READ, bytes([132, 0, 4, 0, 1, 8, 3])).encode(), BAUD, out.append)
    assert [status[4] for status in out] == [1]


def test_sync_answers_come_in_the_order_of_the_request(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2, 3)
    out: list[bytes] = []
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.SYNC_READ, bytes([132, 0, 4, 0, 3, 1, 2])).encode(), BAUD, out.append)
    assert [status[4] for status in out] == [3, 1, 2]


def test_a_bulk_read_asks_a_servo_once(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    out: list[bytes] = []
    wanted = bytes([1, 144, 0, 2, 0, 1, 146, 0, 1, 0])
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.BULK_READ, wanted).encode(), BAUD, out.append)
    assert len(out) == 1
    group = GroupBulkRead(b.port, b.ph)
    assert group.addParam(1, 144, 2)
    assert not group.addParam(1, 146, 1)


def test_a_bulk_write_writes_a_servo_once(bench: Build) -> None:
    b = bench()
    two = bytes([1, 65, 0, 1, 0, 1, 1, 65, 0, 1, 0, 0])
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.BULK_WRITE, two).encode(), BAUD, lambda data: None)
    assert b.get("LED") == 1
    group = GroupBulkWrite(b.port, b.ph)
    assert group.addParam(1, 65, 1, [0])
    assert group.txPacket() == COMM_SUCCESS
    assert b.get("LED") == 0


def test_a_fast_sync_read_is_one_packet_without_stuffing(bench: Build) -> None:
    b = bench("xm430-w350", 3, 7, 4)
    for k in (3, 7, 4):
        b.servos[k].registers.put("Goal Position", 0xFDFFFF)
    out: list[bytes] = []
    b.bus.receive(p2.Packet(p2.BROADCAST, p2.FAST_SYNC_READ, bytes([116, 0, 4, 0, 3, 7, 4])).encode(), BAUD, out.append)
    (raw,) = out
    assert int.from_bytes(raw[5:7], "little") == 0x19
    assert len(raw) == 7 + 0x19
    assert [raw[9:14], raw[17:22], raw[25:30]] == [bytes([k]) + b"\xff\xff\xfd\x00" for k in (3, 7, 4)]
    group = GroupSyncRead(b.port, b.ph, 132, 4)
    for k in (3, 7, 4):
        group.addParam(k)
    assert group.fastSyncRead() == COMM_SUCCESS
    assert [group.getData(k, 132, 4) for k in (3, 7, 4)] == [2000] * 3


def test_the_published_fast_sync_read_is_answered_byte_for_byte(bench: Build) -> None:
    b = bench("xc330-t288", 3, 7, 4)
    for k, count in ((3, 166), (7, 2079), (4, 1023)):
        b.servos[k].turn(count - 2000.0)
    out: list[bytes] = []
    b.bus.receive(bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"), BAUD, out.append)
    parts = "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08", "00 07 1F 08 00 00 16 CA", "00 04 FF 03 00 00 D1 9E"
    assert out == [bytes.fromhex(" ".join(parts))]


def test_a_fast_bulk_read_mixes_addresses(bench: Build) -> None:
    b = bench("xm430-w350", 3, 7, 4)
    group = GroupBulkRead(b.port, b.ph)
    group.addParam(3, 132, 4)
    group.addParam(7, 124, 2)
    group.addParam(4, 146, 1)
    assert group.fastBulkRead() == COMM_SUCCESS
    assert (group.getData(3, 132, 4), group.getData(7, 124, 2), group.getData(4, 146, 1)) == (2000, 0, 34)


def test_a_fast_read_with_an_absent_id_is_cut_short(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    group = GroupSyncRead(b.port, b.ph, 132, 4)
    for k in (1, 8, 2):
        group.addParam(k)
    assert group.fastSyncRead() != COMM_SUCCESS


def test_sync_write_is_for_each_servo_its_own(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    group = GroupSyncWrite(b.port, b.ph, 116, 4)
    group.addParam(1, [150, 0, 0, 0])
    group.addParam(2, [170, 0, 0, 0])
    assert group.txPacket() == COMM_SUCCESS
    assert (b.get("Goal Position", 1), b.get("Goal Position", 2)) == (150, 170)


def test_reg_write_is_checked_when_it_comes_and_done_at_the_action(bench: Build) -> None:
    b = bench()
    assert b.ph.regWriteTxRx(b.port, 1, 65, 1, [2]) == (COMM_SUCCESS, p2.RANGE_ERROR)
    assert b.get("Registered Instruction") == 0
    assert b.ph.regWriteTxRx(b.port, 1, 65, 1, [1]) == (COMM_SUCCESS, 0)
    assert (b.get("Registered Instruction"), b.get("LED")) == (1, 0)
    b.ph.action(b.port, p2.BROADCAST)
    assert (b.get("Registered Instruction"), b.get("LED")) == (0, 1)


def test_an_action_without_reg_write_is_an_instruction_error(bench: Build) -> None:
    assert bench().tell(0x42) == (COMM_SUCCESS, p2.INSTRUCTION_ERROR)
    b = bench()
    out: list[bytes] = []
    b.bus.receive(p2.Packet(1, p2.ACTION).encode(), BAUD, out.append)
    assert out == [p2.status(1, p2.INSTRUCTION_ERROR)]


@pytest.mark.parametrize(("option", "identity", "baud"), [(0xFF, 1, 57_600), (0x01, 5, 57_600), (0x02, 5, BAUD)])
def test_factory_reset_keeps_id_and_baud_rate_as_it_is_told(
    bench: Build, option: int, identity: int, baud: int
) -> None:
    b = bench("xm430-w350", 5)
    assert b.put("Temperature Limit", 70, 5) == 0
    assert b.put("Goal Velocity", 3, 5) == 0
    assert b.ph.factoryReset(b.port, 5, option) == (COMM_SUCCESS, 0)
    b.later(1.0)
    b.port.setBaudRate(baud)
    b.servos[identity] = b.servos[5]
    assert b.get("Temperature Limit", identity) == 80
    assert b.get("Goal Velocity", identity) == 200


def test_a_factory_reset_reboots(bench: Build) -> None:
    b = bench()
    b.ph.factoryReset(b.port, 1, 0x02)
    assert b.ph.ping(b.port, 1)[1] == COMM_RX_TIMEOUT
    b.later(1.0)
    assert b.ph.ping(b.port, 1)[1] == COMM_SUCCESS


def test_clear_brings_the_count_within_a_turn(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=4, Torque_Enable=1, Goal_Position=9000)
    b.later(60.0)
    assert b.get("Present Position") == 9000
    assert b.ph.clearMultiTurn(b.port, 1) == (COMM_SUCCESS, 0)
    assert b.get("Present Position") == 9000 - 2 * 4096
    b.later(1.0)
    assert b.get("Present Position") == 9000 - 2 * 4096


def test_clear_is_refused_while_it_moves(bench: Build) -> None:
    b = bench()
    b.set(Torque_Enable=1, Profile_Velocity=10, Goal_Position=3000)
    b.later(0.5)
    assert b.ph.clearMultiTurn(b.port, 1) == (COMM_SUCCESS, p2.RESULT_FAIL)


def test_the_table_is_backed_up_and_restored(bench: Build) -> None:
    b = bench()
    b.set(Velocity_Limit=150, Homing_Offset=30)
    assert b.get("Backup Ready") == 0
    assert b.tell(p2.BACKUP, b"\x01CTRL") == (COMM_SUCCESS, 0)
    assert b.get("Backup Ready") == 1
    b.set(Velocity_Limit=100, Homing_Offset=0)
    assert b.tell(p2.BACKUP, b"\x02CTRL") == (COMM_SUCCESS, 0)
    assert b.ph.ping(b.port, 1)[1] == COMM_RX_TIMEOUT  # it reboots by itself
    b.later(1.0)
    assert (b.get("Velocity Limit"), b.get("Homing Offset"), b.get("Backup Ready")) == (150, 30, 1)


def test_a_backup_needs_the_torque_off(bench: Build) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    for option in (b"\x01CTRL", b"\x02CTRL"):
        assert b.tell(p2.BACKUP, option) == (COMM_SUCCESS, p2.RESULT_FAIL)
    assert b.get("Backup Ready") == 0


def test_the_published_backup_packet_is_taken(bench: Build) -> None:
    b = bench()
    out: list[bytes] = []
    b.bus.receive(bytes.fromhex("FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5"), BAUD, out.append)
    assert out == [bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")]


def test_a_backup_holds_gains_profile_and_indirect_addresses_for_the_start(bench: Build) -> None:
    b = bench()
    b.set(Startup_Configuration=2, Position_P_Gain=500, Profile_Velocity=33, Indirect_Address_1=65, Goal_PWM=100)
    assert b.tell(p2.BACKUP, b"\x01CTRL") == (COMM_SUCCESS, 0)
    b.reboot()
    kept = [b.get(name) for name in ("Position P Gain", "Profile Velocity", "Indirect Address 1")]
    assert kept == [500, 33, 65]
    assert b.get("Goal PWM") == 885  # it is not among them


# ---- control table ----


def test_eeprom_survives_a_reboot_and_ram_does_not(bench: Build) -> None:
    b = bench()
    b.set(Velocity_Limit=77, Profile_Velocity=5, LED=1, Torque_Enable=1)
    b.reboot()
    assert [b.get(n) for n in ("Velocity Limit", "Profile Velocity", "LED", "Torque Enable")] == [77, 0, 0, 0]


@pytest.mark.parametrize("name", ["ID", "Drive Mode", "Operating Mode", "Homing Offset", "Startup Configuration"])
def test_torque_locks_every_item_of_the_eeprom(bench: Build, name: str) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    assert b.put(name, b.get(name)) == p2.ACCESS_ERROR
    b.set(Torque_Enable=0)
    assert b.put(name, b.get(name)) == 0


@pytest.mark.parametrize("name", ["Model Number", "Present Position", "Moving", "Backup Ready", "Realtime Tick"])
def test_items_that_are_only_read_refuse_a_write(bench: Build, name: str) -> None:
    assert bench().put(name, 0) == p2.ACCESS_ERROR


def test_a_write_that_begins_inside_an_item_is_refused(bench: Build) -> None:
    assert bench().write(117, b"\x01\x02\x03") == p2.ACCESS_ERROR


def test_a_write_shorter_than_the_item_is_a_length_error(bench: Build) -> None:
    assert bench().write(116, b"\x01\x02") == p2.LENGTH_ERROR


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("ID", 252), ("Baud Rate", 7), ("Return Delay Time", 254), ("Moving Threshold", 1023),
        ("Temperature Limit", 100), ("Homing Offset", 1_044_479), ("PWM Limit", 885), ("Current Limit", 1193),
        ("Velocity Limit", 1023), ("Max Position Limit", 4095), ("Startup Configuration", 3),
        ("Status Return Level", 2), ("LED", 1), ("Position P Gain", 16383), ("Bus Watchdog", 127),
        ("Profile Velocity", 32767),
    ],
)  # fmt: skip
def test_values_beyond_the_range_are_refused(bench: Build, name: str, most: int) -> None:
    b = bench()
    assert b.put(name, most + 1) == p2.RANGE_ERROR
    if name not in ("ID", "Baud Rate"):  # it would be gone
        assert b.put(name, most) == 0


@pytest.mark.parametrize(
    ("model", "limit"),
    [
        ("xl430-w250", 265), ("xc430-w150", 460), ("xc430-w240", 306), ("xm430-w210", 330), ("xm430-w350", 200),
        ("xm540-w150", 230), ("xm540-w270", 128), ("xl330-m077", 1620), ("xl330-m288", 445), ("xc330-m181", 545),
        ("xc330-m288", 350), ("xc330-t181", 510), ("xc330-t288", 320), ("xh430-w350", 130), ("xh430-v350", 135),
        ("xd430-t210", 210), ("xd430-t350", 130), ("xh540-w150", 300), ("xh540-w270", 167), ("xd540-t270", 167),
        ("xw430-t333", 139), ("xw540-t140", 304), ("xw540-t260", 167),
    ],
)  # fmt: skip
def test_every_model_has_its_velocity_limit(bench: Build, model: str, limit: int) -> None:
    b = bench(model)
    assert b.get("Velocity Limit") == limit
    assert b.put("Velocity Limit", 2047) == (0 if "330" in model else p2.RANGE_ERROR)


@pytest.mark.parametrize(
    ("model", "number", "limit"),
    [
        ("xm430-w350", 1020, 1193), ("xm540-w270", 1120, 2047), ("xl330-m288", 1200, 1750), ("xc330-t181", 1210, 910),
        ("xc330-m288", 1240, 2352), ("xd430-t350", 1001, 648), ("xh430-v350", 1040, 689), ("xw540-t260", 1170, 2047),
    ],
)  # fmt: skip
def test_every_model_has_its_number_and_current_limit(bench: Build, model: str, number: int, limit: int) -> None:
    b = bench(model)
    assert b.ph.ping(b.port, 1)[0] == number == b.get("Model Number")
    assert b.get("Current Limit") == limit
    assert b.put("Current Limit", limit + 1) == p2.RANGE_ERROR


@pytest.mark.parametrize(
    ("model", "lowest", "low", "high"),
    [
        ("xl430-w250", 60, 60, 140), ("xm430-w350", 95, 95, 160), ("xl330-m288", 31, 35, 70),
        ("xc330-t181", 55, 55, 140), ("xc430-w150", 60, 60, 160), ("xh430-v350", 110, 110, 300),
    ],
)  # fmt: skip
def test_every_model_has_its_voltage_limits(bench: Build, model: str, lowest: int, low: int, high: int) -> None:
    b = bench(model)
    assert (b.get("Min Voltage Limit"), b.get("Max Voltage Limit")) == (low, high)
    assert b.put("Max Voltage Limit", high + 1) == p2.RANGE_ERROR
    assert b.put("Min Voltage Limit", lowest - 1) == p2.RANGE_ERROR
    assert b.put("Min Voltage Limit", lowest) == 0


@pytest.mark.parametrize(
    ("model", "gains"),
    [
        ("xm430-w350", (1920, 100, 0, 0, 800)), ("xl430-w250", (1000, 100, 4000, 0, 640)),
        ("xl330-m288", (1600, 180, 0, 0, 400)), ("xl330-m077", (400, 40, 0, 400, 400)),
        ("xc330-m181", (1400, 100, 500, 0, 1200)), ("xc330-t288", (1200, 40, 0, 0, 900)),
        ("xc430-w240", (1920, 100, 0, 0, 700)), ("xd430-t350", (1920, 100, 0, 0, 900)),
    ],
)  # fmt: skip
def test_every_model_has_its_gains(bench: Build, model: str, gains: tuple[int, ...]) -> None:
    b = bench(model)
    names = ("Velocity I Gain", "Velocity P Gain", "Position D Gain", "Position I Gain", "Position P Gain")
    assert tuple(b.get(name) for name in names) == gains


@pytest.mark.parametrize(("model", "limit"), [("xm430-w350", 80), ("xl430-w250", 72), ("xl330-m288", 70)])
def test_every_model_has_its_temperature_limit(bench: Build, model: str, limit: int) -> None:
    assert bench(model).get("Temperature Limit") == limit


def test_models_without_current_have_no_current_modes(bench: Build) -> None:
    b = bench("xl430-w250")
    assert [b.put("Operating Mode", mode) for mode in (0, 1, 3, 4, 5, 16)] == [4, 0, 0, 0, 4, 0]
    assert "Goal Current" not in b.servos[1].table.items
    b = bench("xm430-w350")
    assert [b.put("Operating Mode", mode) for mode in (0, 1, 2, 3, 4, 5, 16)] == [0, 0, 4, 0, 0, 0, 0]


def test_indirect_data_may_mean_items_that_are_not_adjacent(bench: Build) -> None:
    b = bench()
    places = [65, *range(116, 120), *range(112, 116)]  # LED, Goal Position, Profile Velocity
    for k, place in enumerate(places):
        assert b.put(f"Indirect Address {k + 1}", place) == 0
    assert b.write(224, b"\x01" + (1024).to_bytes(4, "little") + (50).to_bytes(4, "little")) == 0
    assert [b.get(name) for name in ("LED", "Goal Position", "Profile Velocity")] == [1, 1024, 50]
    data, _, _ = b.ph.readTxRx(b.port, 1, 224, 9)
    assert bytes(data) == b"\x01\x00\x04\x00\x00\x32\x00\x00\x00"


def test_indirect_data_has_range_and_access_of_what_it_means(bench: Build) -> None:
    b = bench()
    b.set(Indirect_Address_1=65, Indirect_Address_2=122)
    assert b.write(224, b"\x02") == p2.RANGE_ERROR
    assert b.write(225, b"\x01") == p2.ACCESS_ERROR


def test_indirect_data_needs_all_bytes_of_an_item(bench: Build) -> None:
    b = bench()
    b.set(Indirect_Address_1=116, Indirect_Address_2=117)
    assert b.write(224, b"\x01\x02") == p2.LENGTH_ERROR


def test_indirect_addresses_lead_to_the_ram_only(bench: Build) -> None:
    b = bench()
    assert [b.put("Indirect Address 1", place) for place in (63, 64, 661, 662)] == [4, 0, 0, 4]
    assert b.get("Indirect Address 2") == 225
    assert b.get("Indirect Address 29") == 634


def test_small_servos_have_twenty_indirect_bytes_at_208(bench: Build) -> None:
    b = bench("xl330-m288")
    assert b.get("Indirect Address 1") == 208
    assert b.get("Indirect Address 20") == 227
    assert [b.put("Indirect Address 1", place) for place in (228, 65)] == [4, 0]
    assert b.write(208, b"\x01") == 0
    assert b.get("LED") == 1


def test_a_secondary_id_reaches_a_group_and_nobody_answers(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2, 5)
    for k in (1, 2, 5):
        assert b.put("Secondary(Shadow) ID", 5, k) == 0
    assert b.put("LED", 1, 5) == 0  # the one whose own id it is answers
    assert [b.get("LED", k) for k in (1, 2, 5)] == [1, 1, 1]


def test_a_secondary_id_does_not_reach_the_eeprom(bench: Build) -> None:
    b = bench()
    b.set(**{"Secondary(Shadow)_ID": 50})
    b.ph.write1ByteTxOnly(b.port, 50, 31, 60)
    assert b.get("Temperature Limit") == 80


def test_small_servos_have_baud_rates_to_4_mbps(bench: Build) -> None:
    assert bench("xl330-m288").put("Baud Rate", 7) == p2.RANGE_ERROR


def test_the_tick_starts_at_zero_and_wraps_at_32767(bench: Build) -> None:
    b = bench()
    assert b.get("Realtime Tick") == 0
    b.later(32.760)
    assert 32_759 <= b.get("Realtime Tick") <= 32_760
    b.later(0.010)
    assert b.get("Realtime Tick") <= 2
    b.later(5.0)
    b.reboot()
    assert b.get("Realtime Tick") == 1000


# ---- position ----


def test_position_mode_keeps_the_position_limits(bench: Build) -> None:
    b = bench()
    b.set(Min_Position_Limit=1000, Max_Position_Limit=3000)
    assert [b.put("Goal Position", goal) for goal in (999, 1000, 3000, 3001)] == [6, 0, 0, 6]


def test_extended_mode_has_no_position_limits_but_256_turns(bench: Build) -> None:
    b = bench()
    b.set(Max_Position_Limit=3000, Operating_Mode=4)
    goals = (3001, 1_048_575, 1_048_576, -1_048_575, -1_048_576)
    assert [b.put("Goal Position", goal) for goal in goals] == [0, 0, 4, 0, 4]


def test_a_homing_offset_is_added_to_the_present_position(bench: Build) -> None:
    b = bench()
    b.set(Homing_Offset=-100)
    assert b.get("Present Position") == 1900
    b.set(Torque_Enable=1, Goal_Position=2400)
    b.later(10.0)
    assert (b.get("Present Position"), b.servos[1].shaft()[0]) == (2400, 2500.0)


def test_position_mode_ignores_a_homing_offset_beyond_1024(bench: Build) -> None:
    b = bench()
    seen = []
    for offset in (1024, 1025, -1024, -1025):
        b.set(Homing_Offset=offset)
        seen.append(b.get("Present Position"))
    assert seen == [3024, 2000, 976, 2000]
    b.set(Homing_Offset=5000, Operating_Mode=4)
    assert b.get("Present Position") == 7000


def test_reverse_mode_leaves_the_sign_of_the_homing_offset(bench: Build) -> None:
    b = bench()
    b.set(Drive_Mode=1)
    before = b.get("Present Position")
    b.set(Homing_Offset=100)
    assert b.get("Present Position") == before + 100


def test_without_torque_the_count_goes_beyond_a_turn(bench: Build) -> None:
    b = bench()
    b.servos[1].turn(3000.0)
    assert b.get("Present Position") == 5000
    b.servos[1].turn(-6000.0)
    assert b.get("Present Position") == -1000


@pytest.mark.parametrize("how", ["torque", "reboot", "mode"])
def test_the_count_comes_back_within_a_turn(bench: Build, how: str) -> None:
    b = bench()
    b.servos[1].turn(3000.0)
    if how == "torque":
        b.set(Goal_Position=904, Torque_Enable=1)
    elif how == "reboot":
        b.reboot()
    else:
        b.set(Operating_Mode=1)
        assert b.get("Present Position") == 5000
        b.set(Operating_Mode=3)
    assert b.get("Present Position") == 5000 - 4096


def test_extended_mode_keeps_its_turns_at_torque_on(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=4)
    b.servos[1].turn(3000.0)
    b.set(Goal_Position=5000, Torque_Enable=1)
    assert b.get("Present Position") == 5000


def test_extended_mode_forgets_turns_with_the_power(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=4, Torque_Enable=1, Goal_Position=10_000)
    b.later(60.0)
    assert b.get("Present Position") == 10_000
    b.reboot()
    assert b.get("Present Position") == 10_000 - 2 * 4096
    assert b.servos[1].travelled() == 10_000  # the shaft has not turned


def test_a_count_within_a_turn_has_the_homing_offset_still(bench: Build) -> None:
    b = bench()
    b.set(Homing_Offset=500)
    b.servos[1].turn(3000.0)
    b.reboot()
    assert b.get("Present Position") == 5000 - 4096 + 500


# ---- modes ----


def test_another_operating_mode_resets_profile_gains_and_goals(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=9, Profile_Acceleration=8, Position_P_Gain=1, Velocity_I_Gain=2, Feedforward_1st_Gain=3)
    b.set(PWM_Limit=800, Goal_PWM=10, Goal_Current=11, Operating_Mode=5)
    names = ("Profile Velocity", "Profile Acceleration", "Position P Gain", "Velocity I Gain", "Feedforward 1st Gain")
    assert [b.get(name) for name in names] == [0, 0, 800, 1920, 0]
    assert (b.get("Goal PWM"), b.get("Goal Current")) == (800, 1193)


def test_the_same_operating_mode_again_resets_nothing(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=9, Operating_Mode=3)
    assert b.get("Profile Velocity") == 9


def test_velocity_mode_turns_at_its_goal(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=1, Torque_Enable=1, Goal_Velocity=-50)
    b.later(1.0)
    assert b.get("Present Velocity") == -50
    b.later(10.0)
    assert b.get("Present Position") < -4096
    assert [b.put("Goal Velocity", v) for v in (200, 201, -200, -201)] == [0, 6, 0, 6]


def test_velocity_mode_takes_the_acceleration_and_no_profile_velocity(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=1, Profile_Acceleration=64, Profile_Velocity=1, Torque_Enable=1, Goal_Velocity=100)
    b.later(0.050)  # t1 = 64 Goal Velocity / Profile Acceleration [ms]: half of 100 ms
    assert abs(b.get("Present Velocity") - 50) <= 1
    b.later(0.051)
    assert b.get("Present Velocity") == 100


def test_the_velocity_limit_bounds_the_goal_velocity(bench: Build) -> None:
    b = bench()
    b.set(Velocity_Limit=60, Operating_Mode=1)
    assert [b.put("Goal Velocity", v) for v in (60, 61)] == [0, 6]


def test_the_current_limit_bounds_the_goal_current(bench: Build) -> None:
    b = bench()
    b.set(Current_Limit=500, Operating_Mode=0)
    assert [b.put("Goal Current", v) for v in (500, 501, -500, -501)] == [0, 6, 0, 6]


def test_the_pwm_limit_bounds_the_goal_pwm(bench: Build) -> None:
    b = bench()
    b.set(PWM_Limit=400, Operating_Mode=16)
    assert [b.put("Goal PWM", v) for v in (400, 401, -400, -401)] == [0, 6, 0, 6]


def test_pwm_mode_sets_the_output_itself(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=16, Goal_PWM=-400, Torque_Enable=1)
    b.later(1.0)
    assert b.get("Present PWM") == -400
    assert b.get("Present Velocity") < 0


def test_current_mode_sets_the_current_itself(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=0, Goal_Current=100, Torque_Enable=1)
    b.later(1.0)
    assert b.get("Present Current") == 100
    assert b.get("Present Velocity") > 0


def test_current_based_position_mode_goes_over_several_turns(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=5, Torque_Enable=1, Goal_Position=9000)
    b.later(60.0)
    assert b.get("Present Position") == 9000


# ---- drive mode and start ----


def test_a_goal_turns_the_torque_on_where_drive_mode_says_so(bench: Build) -> None:
    b = bench()
    b.set(Goal_Position=2100)
    assert (b.get("Torque Enable"), b.get("Moving")) == (0, 0)
    b.set(Drive_Mode=8, Profile_Velocity=10, Goal_Position=2200)
    b.later(0.1)
    assert (b.get("Torque Enable"), b.get("Moving")) == (1, 1)
    b.later(10.0)
    assert b.get("Present Position") == 2200


def test_unused_bits_of_the_drive_mode_are_refused(bench: Build) -> None:
    assert [bench().put("Drive Mode", bits) for bits in (0x0D, 0x02, 0x10)] == [0, 4, 4]
    assert [bench("xm540-w270").put("Drive Mode", bits) for bits in (0x0F, 0x10)] == [0, 4]


def test_a_follower_ignores_its_goals(bench: Build) -> None:
    b = bench("xm540-w270")
    b.set(Drive_Mode=2, Torque_Enable=1, Goal_Position=3000)
    b.later(10.0)
    assert b.get("Present Position") == 2000


def test_reverse_mode_inverts_position_and_velocity(bench: Build) -> None:
    b = bench()
    b.set(Drive_Mode=1, Profile_Velocity=20, Torque_Enable=1)
    b.set(Goal_Position=b.get("Present Position") + 500)
    b.later(0.5)
    assert b.get("Present Velocity") == 20
    assert b.servos[1].shaft()[1] < 0


def test_torque_can_be_on_from_the_start(bench: Build) -> None:
    b = bench()
    b.set(Startup_Configuration=1)
    b.reboot()
    assert (b.get("Torque Enable"), b.get("Present Position"), b.get("Goal Position")) == (1, 2000, 2000)


# ---- profiles ----


def test_a_velocity_profile_reaches_its_speed(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=30, Torque_Enable=1, Goal_Position=4000)
    b.later(1.0)
    assert (b.get("Present Velocity"), b.get("Velocity Trajectory")) == (30, 30)
    assert abs(b.get("Present Position") - 2000 - round(30 * 0.229 / 60 * 4096)) <= 1


def test_profile_velocity_0_is_as_fast_as_the_motor_goes(bench: Build) -> None:
    b = bench()
    b.set(Profile_Acceleration=1, Torque_Enable=1, Goal_Position=4000)
    b.later(0.1)
    assert b.get("Present Velocity") == 200  # 46 rpm without load; no profile, so no acceleration of one
    assert b.status() & 0x30 == 0x00


@pytest.mark.parametrize(
    ("velocity", "acceleration", "goal", "kind"),
    [(0, 0, 3000, 0x00), (0, 9, 3000, 0x00), (30, 0, 3000, 0x10), (200, 2, 2050, 0x20), (30, 20, 3000, 0x30)],
)
def test_the_moving_status_names_the_profile(
    bench: Build, velocity: int, acceleration: int, goal: int, kind: int
) -> None:
    b = bench()
    b.set(Profile_Velocity=velocity, Profile_Acceleration=acceleration, Torque_Enable=1, Goal_Position=goal)
    assert b.status() & 0x30 == kind


def test_the_moving_status_tells_under_way_and_arrived(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=30, Profile_Acceleration=20, Torque_Enable=1, Goal_Position=3000)
    b.later(0.5)
    assert b.status() & 0x03 == 0x02
    b.later(20.0)
    assert b.status() & 0x03 == 0x01


def test_in_position_is_for_position_modes_only(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=1, Torque_Enable=1, Goal_Velocity=10)
    b.later(1.0)
    assert b.status() & 0x0B == 0


def test_a_blocked_shaft_does_not_follow(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=30, Torque_Enable=1)
    b.servos[1].block()
    b.set(Goal_Position=3000)
    b.later(1.0)
    assert b.status() & 0x09 == 0x08


def test_moving_is_set_while_a_profile_goes_on_however_slow(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=3, Torque_Enable=1, Goal_Position=2500)
    b.later(0.5)
    assert b.get("Present Velocity") == 3 < b.get("Moving Threshold")
    assert b.get("Moving") == 1


def test_moving_is_set_above_the_threshold(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=1, Moving_Threshold=40, Torque_Enable=1, Goal_Velocity=40)
    b.later(1.0)
    assert b.get("Moving") == 0
    b.set(Goal_Velocity=41)
    b.later(1.0)
    assert b.get("Moving") == 1


def test_a_time_based_profile_is_over_in_its_time(bench: Build) -> None:
    b = bench()
    b.set(Drive_Mode=4, Profile_Velocity=2000, Profile_Acceleration=500, Torque_Enable=1, Goal_Position=3000)
    b.later(1.99)
    assert b.status() & 0x02
    b.later(0.02)
    assert (b.status() & 0x03, b.get("Present Position")) == (0x01, 3000)


def test_the_time_of_acceleration_is_at_most_half(bench: Build) -> None:
    b = bench()
    b.set(Drive_Mode=4, Profile_Velocity=2000, Profile_Acceleration=1800, Torque_Enable=1, Goal_Position=3000)
    b.later(1.0)
    assert abs(b.get("Present Position") - 2500) <= 1  # it speeds up for one second and slows down for the other
    b.later(1.01)
    assert b.get("Present Position") == 3000


def test_time_based_profiles_end_at_32737_ms(bench: Build) -> None:
    b = bench()
    b.set(Drive_Mode=4)
    assert [b.put("Profile Velocity", ms) for ms in (32_737, 32_738)] == [0, 4]


def test_the_trajectories_end_at_the_goal(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=30, Profile_Acceleration=20, Torque_Enable=1, Goal_Position=3000)
    b.later(1.0)
    assert 2000 < b.get("Position Trajectory") < 3000
    assert b.get("Velocity Trajectory") == 30
    b.later(20.0)
    assert (b.get("Position Trajectory"), b.get("Velocity Trajectory")) == (3000, 0)
    b.set(Torque_Enable=0)
    b.set(Operating_Mode=1, Torque_Enable=1, Goal_Velocity=25)
    b.later(1.0)
    assert b.get("Velocity Trajectory") == 25


def test_profile_and_goal_of_one_write_count_together(bench: Build) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    assert b.write(108, b"".join(v.to_bytes(4, "little") for v in (20, 10, 3000))) == 0
    b.later(1.0)
    assert b.get("Present Velocity") == 10


# ---- bus watchdog ----


def expire(b: ManualRig) -> None:
    b.servos[1]._heard_s -= 10.0  # as if nothing had been said for ten seconds
    b.servos[1].shaft()


def test_the_watchdog_stops_and_zeroes_the_profile(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=20, Profile_Acceleration=10, Torque_Enable=1, Bus_Watchdog=100, Goal_Position=4000)
    b.later(1.0)
    expire(b)
    stopped = b.get("Present Position")
    b.later(1.0)
    assert b.get("Present Position") == stopped < 4000
    assert [b.get(n) for n in ("Bus Watchdog", "Profile Velocity", "Profile Acceleration")] == [-1, 0, 0]


def test_the_watchdog_bars_every_goal_until_it_is_cleared(bench: Build) -> None:
    b = bench()
    b.set(Operating_Mode=1, Torque_Enable=1, Bus_Watchdog=100)
    expire(b)
    goals = ("Goal PWM", "Goal Current", "Goal Velocity", "Goal Position")
    assert [b.put(name, 150) for name in goals] == [p2.RANGE_ERROR] * 4
    b.set(Bus_Watchdog=50)
    assert b.get("Bus Watchdog") == -1  # only 0 clears it
    b.set(Bus_Watchdog=0, Goal_Velocity=150)
    b.later(1.0)
    assert b.get("Present Velocity") == 150


def test_the_watchdog_watches_with_torque_only(bench: Build) -> None:
    b = bench()
    b.set(Bus_Watchdog=100)
    expire(b)
    assert b.get("Bus Watchdog") == 100


def test_any_packet_on_the_bus_keeps_the_watchdog_quiet(bench: Build) -> None:
    b = bench("xm430-w350", 1, 2)
    b.set(Torque_Enable=1, Bus_Watchdog=100)
    b.servos[1]._heard_s = before = time.monotonic() - 1.0
    assert b.get("LED", 2) == 0
    assert b.servos[1]._heard_s > before
    assert b.get("Bus Watchdog") == 100


# ---- health ----


@pytest.mark.parametrize(
    ("what", "bit", "off"),
    [("hot", 0x04, 1), ("low", 0x01, 0), ("high", 0x01, 0), ("shock", 0x10, 1), ("encoder", 8, 0)],
)
def test_hardware_errors_raise_the_alert_and_shutdown_takes_the_torque(
    bench: Build, what: str, bit: int, off: int
) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    servo = b.servos[1]
    if what == "hot":
        servo.temperature_c = 81
    elif what in ("low", "high"):
        servo.supply_dv = {"low": 94, "high": 161}[what]
    else:
        servo.damage = bit
    value, result, error = b.ph.read1ByteTxRx(b.port, 1, 70)
    assert (value, result, error) == (bit, COMM_SUCCESS, 0x80)
    assert b.get("Torque Enable") == 1 - off


def test_shutdown_chooses_what_takes_the_torque(bench: Build) -> None:
    b = bench()
    b.set(Shutdown=0x05, Torque_Enable=1)
    b.servos[1].supply_dv = 90
    b.get("LED")
    assert b.get("Torque Enable") == 0


def test_only_a_reboot_gives_the_torque_back(bench: Build) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    b.servos[1].temperature_c = 90
    b.get("LED")
    b.servos[1].temperature_c = 40
    assert b.put("Torque Enable", 1) & 0x7F == p2.RESULT_FAIL
    b.reboot()
    b.set(Torque_Enable=1)


def test_a_load_that_lasts_is_an_overload(bench: Build) -> None:
    b = bench()
    b.set(Torque_Enable=1, Profile_Velocity=30)
    b.servos[1].block()
    b.set(Goal_Position=3000)
    for _ in range(40):
        b.later(0.2)
        b.servos[1].read(70, 1)
    assert b.get("Hardware Error Status") == 0x20
    assert b.get("Torque Enable") == 0


def test_shutdown_of_the_factory_by_model(bench: Build) -> None:
    assert [bench(m).get("Shutdown") for m in ("xm430-w350", "xl330-m288", "xc330-m288")] == [0x34, 0x35, 0x34]


def test_volts_are_tenths_and_temperatures_degrees(bench: Build) -> None:
    b = bench()
    b.servos[1].supply_dv, b.servos[1].temperature_c = 119, 36
    assert (b.get("Present Input Voltage"), b.get("Present Temperature")) == (119, 36)
