"""The twin of the servo bus against the protocol's published packets, and against the unmodified SDK."""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupBulkRead, GroupBulkWrite, GroupSyncRead, GroupSyncWrite
from gonio_sim.wire import motion
from gonio_sim.wire import protocol2 as p2
from hypothesis import given
from hypothesis import strategies as st

from tests.gonio_drivers.conftest import Line
from tests.places import measured

Sdk = tuple[Any, Any]
"""Port and packets of the SDK, which ships no types."""

VECTORS = "dynamixel/dynamixel_p2_vectors.json"

TORQUE, LED, LEVEL, HARDWARE, VELOCITY_P, WATCHDOG = 64, 65, 68, 70, 78, 98
ACCELERATION, SPEED, GOAL, MOVING, POSITION = 108, 112, 116, 122, 132


# ---- packets ----


@pytest.fixture(scope="module")
def published() -> list[dict[str, object]]:
    return json.loads(measured(VECTORS).read_text())["packets"]


def test_published_packets_decode_and_encode_to_the_same_bytes(published: list[dict[str, object]]) -> None:
    assert len(published) > 10
    for vector in published:
        decode_and_encode(vector)


def decode_and_encode(vector: dict[str, object]) -> None:
    raw = bytes.fromhex(str(vector["hex"]))
    (packet,) = p2.Reader().feed(raw)
    assert packet.crc_ok
    assert packet.encode() == raw
    assert p2.crc16(raw[:-2]) == int(str(vector["computed_crc"]), 16)


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x7E]), max_size=40), st.integers(0, 252), st.integers(0, 9))
def test_packets_survive_stuffing_noise_and_cutting(body: list[int], identity: int, cut: int) -> None:
    packet = p2.Packet(identity, p2.WRITE, bytes(body))
    raw = b"\x12\xff\xff" + packet.encode() + p2.Packet(1, p2.PING).encode()
    reader = p2.Reader()
    got = [p for k in range(0, len(raw), cut + 1) for p in reader.feed(raw[k : k + cut + 1])]
    assert got == [packet, p2.Packet(1, p2.PING)]


def test_a_packet_cut_short_does_not_swallow_the_next_one() -> None:
    reader = p2.Reader()
    whole = p2.Packet(3, p2.READ, bytes([132, 0, 4, 0])).encode()
    assert list(reader.feed(whole[:9])) == []
    assert [p.instruction for p in reader.feed(whole)] == [p2.READ]


# ---- motion ----


@given(
    st.floats(-2000, 2000), st.floats(-900, 900), st.floats(-2000, 2000), st.floats(1, 900), st.floats(10, 1e6)
)  # fmt: skip
def test_a_profile_ends_at_its_goal_and_keeps_its_limits(x: float, v: float, goal: float, top: float, a: float) -> None:
    path = motion.to_position(0.0, x, v, goal, top, a)
    assert path.at(path.end_s + 1.0) == (goal, 0.0)
    times = [path.end_s * k / 200 for k in range(201)]
    states = [path.at(t) for t in times]
    # 1e-6 counts/s: rounding of the phases' closed forms
    assert max(abs(s[1]) for s in states) <= max(top, abs(v)) + 1e-6
    step = path.end_s / 200
    for (x0, v0), (x1, v1) in itertools.pairwise(states):
        assert abs(v1 - v0) <= a * step + 1e-6 * (1 + abs(v0))
        # continuity: no jump beyond what speed and acceleration allow in one step; 1e-6 of rounding at 2000 counts
        assert abs(x1 - x0) <= (max(abs(v0), abs(v1)) + a * step) * step + 1e-6 * (1 + abs(x0))


# ---- the unmodified SDK ----


@dataclass
class HandClock:
    """A twin's clock that goes on when it is told to."""

    now_s: float

    def __call__(self) -> float:
        return self.now_s


def test_ping_and_broadcast_ping(sdk: Sdk) -> None:
    port, ph = sdk
    assert ph.ping(port, 2) == (1020, COMM_SUCCESS, 0)
    found, result = ph.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {k: [1020, 46] for k in (1, 2, 3)}


def test_absent_id_is_silent(sdk: Sdk) -> None:
    port, ph = sdk
    assert ph.ping(port, 9)[1] == COMM_RX_TIMEOUT


def test_another_line_speed_hears_nothing(sdk: Sdk) -> None:
    port, ph = sdk
    port.setBaudRate(57_600)
    assert ph.ping(port, 1)[1] == COMM_RX_TIMEOUT
    port.setBaudRate(1_000_000)
    assert ph.ping(port, 1)[1] == COMM_SUCCESS


@pytest.mark.parametrize(
    ("address", "size", "value", "error"),
    [
        (LED, 1, 2, p2.RANGE_ERROR),
        (POSITION, 4, 5, p2.ACCESS_ERROR),  # read only
        (700, 1, 0, p2.ACCESS_ERROR),  # not defined
        (GOAL, 2, 100, p2.LENGTH_ERROR),  # two bytes of a four-byte item
        (GOAL, 4, 4096, p2.LIMIT_ERROR),
        (104, 4, 201, p2.LIMIT_ERROR),  # goal velocity beyond the velocity limit
        (102, 2, 1194, p2.LIMIT_ERROR),
        (11, 1, 2, p2.RANGE_ERROR),
        (VELOCITY_P, 2, 300, 0),
    ],
)  # fmt: skip
def test_refusals(sdk: Sdk, address: int, size: int, value: int, error: int) -> None:
    port, ph = sdk
    result, got = ph.writeTxRx(port, 1, address, size, list(value.to_bytes(size, "little")))
    assert (result, got) == (COMM_SUCCESS, error)


def test_eeprom_is_locked_while_torque_is_on(sdk: Sdk) -> None:
    port, ph = sdk
    assert ph.write1ByteTxRx(port, 1, TORQUE, 1) == (COMM_SUCCESS, 0)
    assert ph.write4ByteTxRx(port, 1, 48, 3000) == (COMM_SUCCESS, p2.ACCESS_ERROR)
    assert ph.write1ByteTxRx(port, 1, TORQUE, 0) == (COMM_SUCCESS, 0)
    assert ph.write4ByteTxRx(port, 1, 48, 3000) == (COMM_SUCCESS, 0)
    assert ph.read4ByteTxRx(port, 1, 48) == (3000, COMM_SUCCESS, 0)
    assert ph.write4ByteTxRx(port, 1, GOAL, 3001) == (COMM_SUCCESS, p2.LIMIT_ERROR)


def test_a_write_of_several_items_is_all_or_nothing(sdk: Sdk) -> None:
    port, ph = sdk
    data = list((5).to_bytes(4, "little") + (40_000).to_bytes(4, "little"))
    assert ph.writeTxRx(port, 1, ACCELERATION, 8, data) == (COMM_SUCCESS, p2.RANGE_ERROR)
    assert ph.read4ByteTxRx(port, 1, ACCELERATION)[0] == 0


def test_reg_write_waits_for_action(sdk: Sdk) -> None:
    port, ph = sdk
    assert ph.regWriteTxRx(port, 1, LED, 1, [1]) == (COMM_SUCCESS, 0)
    assert ph.read1ByteTxRx(port, 1, 69)[0] == 1
    assert ph.read1ByteTxRx(port, 1, LED)[0] == 0
    ph.action(port, p2.BROADCAST)
    assert ph.read1ByteTxRx(port, 1, LED) == (1, COMM_SUCCESS, 0)
    assert ph.read1ByteTxRx(port, 1, 69)[0] == 0


def test_an_action_for_one_servo_is_answered(line: Line) -> None:
    out: list[bytes] = []
    for packet in (p2.Packet(1, p2.REG_WRITE, bytes([LED, 0, 1])), p2.Packet(1, p2.ACTION)):
        line.bus.receive(packet.encode(), 1_000_000, out.append)
    assert out == [p2.status(1, 0)] * 2


def test_status_return_level(sdk: Sdk) -> None:
    port, ph = sdk
    assert ph.write1ByteTxRx(port, 1, LEVEL, 1)[0] == COMM_RX_TIMEOUT
    assert ph.write1ByteTxRx(port, 1, LED, 1)[0] == COMM_RX_TIMEOUT
    assert ph.read1ByteTxRx(port, 1, LED) == (1, COMM_SUCCESS, 0)
    ph.write1ByteTxOnly(port, 1, LEVEL, 0)
    with pytest.raises(IndexError):  # the SDK takes a missing reply apart
        ph.read1ByteTxRx(port, 1, LED)[1] and [][0]
    assert ph.ping(port, 1)[1] == COMM_SUCCESS


def test_torque_moves_the_shaft_by_its_profile(sdk: Sdk, line: Line) -> None:
    port, ph = sdk
    ph.write4ByteTxRx(port, 1, ACCELERATION, 10)
    ph.write4ByteTxRx(port, 1, SPEED, 15)
    ph.write4ByteTxRx(port, 1, GOAL, 2500)
    clock = HandClock(line.servos[1]._clock())
    line.servos[1]._clock = clock  # type: ignore[assignment]
    assert line.servos[1].shaft() == (1500.0, 0.0)  # no torque, no motion
    ph.write1ByteTxRx(port, 1, TORQUE, 1)
    speeds, moved = [], []
    while ph.read4ByteTxRx(port, 1, POSITION)[0] != 2500:
        clock.now_s += 0.1
        moved.append(ph.read1ByteTxRx(port, 1, MOVING)[0])
        speeds.append(ph.read4ByteTxRx(port, 1, 128)[0])
    assert max(moved) == 1
    assert 10 < max(speeds) <= 15
    assert ph.read1ByteTxRx(port, 1, MOVING)[0] == 0


def test_groups(sdk: Sdk, line: Line) -> None:
    port, ph = sdk
    write = GroupSyncWrite(port, ph, GOAL, 4)
    for k in (1, 2, 3):
        assert write.addParam(k, list((100 * k).to_bytes(4, "little")))
    assert write.txPacket() == COMM_SUCCESS
    read = GroupSyncRead(port, ph, GOAL, 4)
    for k in (1, 2, 3):
        read.addParam(k)
    assert read.txRxPacket() == COMM_SUCCESS
    assert [read.getData(k, GOAL, 4) for k in (1, 2, 3)] == [100, 200, 300]
    assert read.fastSyncRead() == COMM_SUCCESS
    assert [read.getData(k, GOAL, 4) for k in (1, 2, 3)] == [100, 200, 300]
    bulk = GroupBulkRead(port, ph)
    bulk.addParam(1, 144, 2)
    bulk.addParam(2, 146, 1)
    assert bulk.txRxPacket() == COMM_SUCCESS
    assert (bulk.getData(1, 144, 2), bulk.getData(2, 146, 1)) == (120, 34)
    assert bulk.fastBulkRead() == COMM_SUCCESS
    assert (bulk.getData(1, 144, 2), bulk.getData(2, 146, 1)) == (120, 34)
    change = GroupBulkWrite(port, ph)
    change.addParam(1, LED, 1, [1])
    change.addParam(3, GOAL, 4, [7, 0, 0, 0])
    assert change.txPacket() == COMM_SUCCESS
    assert ph.read1ByteTxRx(port, 1, LED)[0] == 1
    assert ph.read4ByteTxRx(port, 3, GOAL)[0] == 7


def test_the_last_crc_of_a_fast_sync_read_covers_the_packet_and_each_part_the_bytes_so_far(line: Line) -> None:
    request = p2.Packet(p2.BROADCAST, p2.FAST_SYNC_READ, bytes([146, 0, 1, 0, 1, 2, 3])).encode()
    out: list[bytes] = []
    line.bus.receive(request, 1_000_000, out.append)
    (raw,) = out
    assert int.from_bytes(raw[5:7], "little") == 1 + 3 * 5
    for end in (13, 18, 23):
        assert p2.crc16(raw[: end - 2]) == int.from_bytes(raw[end - 2 : end], "little")


def test_reboot_clears_ram_and_keeps_eeprom(sdk: Sdk, line: Line) -> None:
    port, ph = sdk
    ph.write1ByteTxRx(port, 1, 31, 70)
    ph.write4ByteTxRx(port, 1, SPEED, 50)
    ph.write1ByteTxRx(port, 1, TORQUE, 1)
    assert ph.reboot(port, 1) == (COMM_SUCCESS, 0)
    while ph.ping(port, 1)[1] != COMM_SUCCESS:
        pass
    assert ph.read4ByteTxRx(port, 1, SPEED)[0] == 0
    assert ph.read1ByteTxRx(port, 1, TORQUE)[0] == 0
    assert ph.read1ByteTxRx(port, 1, 31)[0] == 70


def test_a_broadcast_factory_reset_of_everything_is_not_carried_out(sdk: Sdk) -> None:
    port, ph = sdk
    ph.write1ByteTxRx(port, 2, 31, 70)
    ph.factoryReset(port, p2.BROADCAST, 0xFF)
    assert ph.read1ByteTxRx(port, 2, 31) == (70, COMM_SUCCESS, 0)
    assert ph.factoryReset(port, 2, 0x02) == (COMM_SUCCESS, 0)
    while ph.ping(port, 2)[1] != COMM_SUCCESS:
        pass
    assert ph.read1ByteTxRx(port, 2, 31)[0] == 80


def test_a_wrong_crc_is_answered_with_the_crc_error(line: Line) -> None:
    request = bytearray(p2.Packet(1, p2.PING).encode())
    request[-1] ^= 1
    out: list[bytes] = []
    line.bus.receive(bytes(request), 1_000_000, out.append)
    (status,) = p2.Reader().feed(out[0])
    assert status.parameters[0] == p2.CRC_ERROR


def test_unknown_instruction(line: Line) -> None:
    out: list[bytes] = []
    line.bus.receive(p2.Packet(1, 0x42).encode(), 1_000_000, out.append)
    (status,) = p2.Reader().feed(out[0])
    assert status.parameters[0] == p2.INSTRUCTION_ERROR
    line.bus.receive(p2.Packet(1, p2.ACTION).encode(), 1_000_000, out.append)
    (status,) = p2.Reader().feed(out[1])
    assert status.parameters[0] == p2.INSTRUCTION_ERROR


def test_a_hot_servo_raises_the_alert_bit_drops_its_torque_and_needs_a_reboot(sdk: Sdk, line: Line) -> None:
    port, ph = sdk
    ph.write1ByteTxRx(port, 1, TORQUE, 1)
    line.faults.arm("overheat", servo=1)
    ph.ping(port, 1)
    assert ph.read1ByteTxRx(port, 1, HARDWARE) == (4, COMM_SUCCESS, 0x80)
    assert ph.read1ByteTxRx(port, 1, TORQUE)[0] == 0
    assert ph.write1ByteTxRx(port, 1, TORQUE, 1) == (COMM_SUCCESS, 0x80 | p2.RESULT_FAIL)


def test_the_bus_watchdog_stops_and_bars_goals(sdk: Sdk, line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    port, ph = sdk
    ph.write1ByteTxRx(port, 1, WATCHDOG, 1)
    ph.write1ByteTxRx(port, 1, TORQUE, 1)
    while line.servos[1].get("Bus Watchdog") != -1:
        line.servos[1].shaft()
    assert ph.read1ByteTxRx(port, 1, WATCHDOG)[0] == 255
    assert ph.write4ByteTxRx(port, 1, GOAL, 100) == (COMM_SUCCESS, p2.RANGE_ERROR)
    assert ph.write1ByteTxRx(port, 1, WATCHDOG, 1) == (COMM_SUCCESS, 0)
    assert ph.read1ByteTxRx(port, 1, WATCHDOG)[0] == 255  # only 0 clears it
    assert ph.write1ByteTxRx(port, 1, WATCHDOG, 0) == (COMM_SUCCESS, 0)
    assert ph.write4ByteTxRx(port, 1, GOAL, 100) == (COMM_SUCCESS, 0)


def test_the_bus_watchdog_counts_wall_time_whatever_the_time_scale(line: Line) -> None:
    servo = line.servos[1]
    servo.write(11, b"\x01")  # velocity mode: it turns until somebody stops it
    servo.write(TORQUE, b"\x01")
    servo.write(104, (10).to_bytes(4, "little"))
    servo.heard(heard := time.monotonic())
    servo.write(WATCHDOG, b"\x02")  # counts from what was heard last, however late this comes
    while servo.get("Bus Watchdog") != -1:
        servo.shaft()
    end = servo._clock.at(heard + 0.040)  # two units of 20 ms
    assert servo.shaft() == (servo.shaft()[0], 0.0)
    assert servo._path.phases[0].start == end


def test_a_shadow_id_is_obeyed_and_not_answered(sdk: Sdk) -> None:
    port, ph = sdk
    ph.write1ByteTxRx(port, 1, 12, 50)
    assert ph.write1ByteTxRx(port, 50, LED, 1)[0] == COMM_RX_TIMEOUT
    assert ph.read1ByteTxRx(port, 1, LED) == (1, COMM_SUCCESS, 0)


def test_a_time_based_profile_takes_its_time(line: Line) -> None:
    servo = line.servos[1]
    servo.write(10, b"\x04")
    servo.write(ACCELERATION, (500).to_bytes(4, "little") + (2000).to_bytes(4, "little"))  # ms
    servo.write(TORQUE, b"\x01")
    servo.write(GOAL, (2500).to_bytes(4, "little"))
    path = servo._path
    assert path.end_s - path.phases[0].start == pytest.approx(2.0, abs=1e-9)  # of a clock near 1e6 s: 1e-10


def test_reverse_mode_turns_the_other_way(line: Line) -> None:
    servo = line.servos[1]
    servo.write(10, b"\x01")
    before = int.from_bytes(servo.read(POSITION, 4), "little")
    assert before == 4095 - 1500
    servo.write(TORQUE, b"\x01")
    servo.write(GOAL, (before + 100).to_bytes(4, "little"))
    while servo.moves():
        pass
    assert servo.shaft()[0] == 1400
    assert int.from_bytes(servo.read(POSITION, 4), "little") == before + 100


def test_indirect_addresses(sdk: Sdk) -> None:
    port, ph = sdk
    ph.write2ByteTxRx(port, 1, 168, 146)
    assert ph.read1ByteTxRx(port, 1, 224) == (34, COMM_SUCCESS, 0)
    ph.write2ByteTxRx(port, 1, 170, LED)
    assert ph.write1ByteTxRx(port, 1, 225, 1) == (COMM_SUCCESS, 0)
    assert ph.read1ByteTxRx(port, 1, LED)[0] == 1
