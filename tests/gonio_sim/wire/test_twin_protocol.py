"""The twin of the servo bus: published packets, the unmodified SDK, and what each model of servo has."""

import itertools
import json
import time
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
)
from gonio_sim.wire import motion, tables
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.servo import Servo
from hypothesis import given
from hypothesis import strategies as st

from tests.gonio_drivers.conftest import BAUD
from tests.gonio_sim.wire.conftest import Build, HandClock
from tests.places import measured

VECTORS = "dynamixel/dynamixel_p2_vectors.json"
MODEL = "xm430-w350"

# ---- packets ----


def test_published_packets_decode_and_encode_to_the_same_bytes() -> None:
    published = json.loads(measured(VECTORS).read_text())["packets"]
    assert len(published) > 10
    for vector in published:
        raw = bytes.fromhex(vector["hex"])
        (packet,) = p2.Reader().feed(raw)
        assert packet.crc_ok
        assert packet.encode() == raw
        assert p2.crc16(raw[:-2]) == int(vector["computed_crc"], 16)


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


def test_the_length_counts_what_follows_it_stuffed_bytes_too() -> None:
    packet = p2.Packet(1, p2.WRITE, b"\xe0\x00\xff\xff\xfd").encode()
    assert int.from_bytes(packet[5:7], "little") == len(packet) - 7 == 9


def test_bytes_that_follow_soon_are_one_packet() -> None:
    reader, packet = p2.Reader(), p2.Packet(1, p2.PING).encode()
    came = [(packet[:5], 1.0), (packet[5:], 1.0014), (packet[:5], 2.0), (packet[5:], 2.0016)]
    assert [len(list(reader.feed(part, at_s))) for part, at_s in came] == [0, 1, 0, 0]


# ---- motion ----


@given(
    st.floats(-2000, 2000), st.floats(-900, 900), st.floats(-2000, 2000), st.floats(1, 900), st.floats(10, 1e6)
)  # fmt: skip
def test_a_profile_ends_at_its_goal_and_keeps_its_limits(x: float, v: float, goal: float, top: float, a: float) -> None:
    path = motion.to_position(0.0, x, v, goal, top, a)
    assert path.at(path.end_s + 1.0) == (goal, 0.0)
    step = path.end_s / 200
    states = [path.at(step * k) for k in range(201)]
    # 1e-6 counts/s: rounding of the phases' closed forms
    assert max(abs(s[1]) for s in states) <= max(top, abs(v)) + 1e-6
    for (x0, v0), (x1, v1) in itertools.pairwise(states):
        assert abs(v1 - v0) <= a * step + 1e-6 * (1 + abs(v0))
        # continuity: no jump beyond what speed and acceleration allow in one step; 1e-6 of rounding at 2000 counts
        assert abs(x1 - x0) <= (max(abs(v0), abs(v1)) + a * step) * step + 1e-6 * (1 + abs(x0))


# ---- the line ----


def test_a_pattern_like_a_header_is_stuffed_in_both_directions(bench: Build) -> None:
    b = bench()
    b.write(224, b"\xff\xff\xfd")  # three indirect data bytes with their own places
    assert b.servos[1].read(224, 3) == b"\xff\xff\xfd"
    assert b.ph.readTxRx(b.port, 1, 224, 4)[0][:3] == [0xFF, 0xFF, 0xFD]
    assert b"\x55\x00\xff\xff\xfd\xfd\x00" in b.heard(p2.Packet(1, p2.READ, bytes([224, 0, 4, 0])))[0]


@pytest.mark.parametrize(("gap_s", "result"), [(0.001, 1), (0.002, 0)])  # a servo waits 1.5 ms
def test_a_gap_in_a_packet_makes_a_servo_wait_for_the_next_header(
    bench: Build, monkeypatch: pytest.MonkeyPatch, gap_s: float, result: int
) -> None:
    b = bench()
    packet = list(p2.Packet(1, p2.WRITE, bytes([65, 0, 1])).encode())
    times = iter((10.0, *[10.0 + gap_s] * 2, *[20.0] * 9))
    monkeypatch.setattr("gonio_sim.wire.bus.clock.monotonic", lambda: next(times))
    b.port.writePort(packet[:9])
    b.port.writePort(packet[9:])
    assert b.get("LED") == result
    assert b.put("LED", 1) == 0


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
    assert tables.table(MODEL).factory["Return Delay Time"] == 250
    assert b.put("Return Delay Time", 255) == p2.RANGE_ERROR


def test_another_line_speed_hears_nothing(bench: Build) -> None:
    b = bench()
    results = []
    for speed in (57_600, BAUD):
        b.port.setBaudRate(speed)
        results.append(b.ph.ping(b.port, 1)[1])
    assert results == [COMM_RX_TIMEOUT, COMM_SUCCESS]


def test_two_servos_with_one_id_damage_each_others_answers(bench: Build) -> None:
    b = bench(MODEL, 1, 2)
    b.servos[2].turn(345.0)
    b.servos[2].registers.put("ID", 1)
    assert b.ph.readTxRx(b.port, 1, 132, 4)[1] == COMM_RX_CORRUPT
    assert b.ph.ping(b.port, 1) == (1020, COMM_SUCCESS, 0)  # their answers agree bit by bit


def test_servos_of_two_models_with_one_id_damage_a_broadcast_ping(bench: Build) -> None:
    b = bench(MODEL, 1)
    b.bus.servos.append(Servo(1, b.clock, model="xl430-w250", baud=BAUD))  # type: ignore[arg-type]
    b.bus.servos[1].registers.put("Return Delay Time", 0)
    assert b.ph.broadcastPing(b.port) == ({}, COMM_RX_CORRUPT)


def test_answers_with_different_delays_overlap_in_part(bench: Build) -> None:
    b = bench(MODEL, 1, 2)
    b.servos[2].registers.put("ID", 1)
    b.servos[2].registers.put("Return Delay Time", 25)  # five bytes later
    (said,) = b.heard(p2.Packet(1, p2.PING))
    whole = p2.status(1, 0, bytes([0xFC, 0x03, 46]))
    assert len(said) == 5 + len(whole)
    assert said[:5] == whole[:5]
    assert list(p2.Reader().feed(said)) != list(p2.Reader().feed(whole))


# ---- instructions, by the SDK ----


def test_ping_and_broadcast_ping(bench: Build) -> None:
    b = bench(MODEL, 1, 2, 3)
    assert b.ph.ping(b.port, 2) == (1020, COMM_SUCCESS, 0)
    assert b.ph.broadcastPing(b.port) == ({k: [1020, 46] for k in (1, 2, 3)}, COMM_SUCCESS)
    assert b.ph.ping(b.port, 9)[1] == COMM_RX_TIMEOUT


def group_read(group: Any, *parameters: tuple[int, ...]) -> Any:
    """A group of reads that has been told what it reads."""
    for parameter in parameters:
        assert group.addParam(*parameter)
    return group


def test_groups(bench: Build) -> None:
    b = bench(MODEL, 1, 2, 3)
    goals = {k: [100 * k % 256, 100 * k // 256, 0, 0] for k in (1, 2, 3)}
    write = group_read(GroupSyncWrite(b.port, b.ph, 116, 4), *goals.items())  # type: ignore[arg-type]
    assert write.txPacket() == COMM_SUCCESS
    read = group_read(GroupSyncRead(b.port, b.ph, 116, 4), (1,), (2,), (3,))
    same, mixed = [(k, 116, 4) for k in (1, 2, 3)], [(1, 144, 2), (2, 146, 1), (3, 116, 4)]
    bulk = group_read(GroupBulkRead(b.port, b.ph), *mixed)
    for group, ask, wanted, values in (
        (read, read.txRxPacket, same, [100, 200, 300]), (read, read.fastSyncRead, same, [100, 200, 300]),
        (bulk, bulk.txRxPacket, mixed, [120, 34, 300]), (bulk, bulk.fastBulkRead, mixed, [120, 34, 300]),
    ):  # fmt: skip
        assert ask() == COMM_SUCCESS
        assert [group.getData(*one) for one in wanted] == values
    change = GroupBulkWrite(b.port, b.ph)
    assert change.addParam(1, 65, 1, [1])
    assert change.addParam(3, 116, 4, [7, 0, 0, 0])
    assert change.txPacket() == COMM_SUCCESS
    assert (b.get("LED"), b.get("Goal Position", 3)) == (1, 7)


def test_a_sync_read_ends_at_the_id_that_is_missing(bench: Build) -> None:
    b = bench(MODEL, 1, 2, 3)
    group = group_read(GroupSyncRead(b.port, b.ph, 132, 4), (1,), (8,), (3,))
    assert group.txRxPacket() == COMM_RX_TIMEOUT
    assert group.fastSyncRead() != COMM_SUCCESS
    said = b.heard(p2.Packet(p2.BROADCAST, p2.SYNC_READ, bytes([132, 0, 4, 0, 1, 8, 3])))
    assert [status[4] for status in said] == [1]


def test_a_bulk_read_asks_a_servo_once(bench: Build) -> None:
    b = bench(MODEL, 1, 2)
    assert len(b.heard(p2.Packet(p2.BROADCAST, p2.BULK_READ, bytes([1, 144, 0, 2, 0, 1, 146, 0, 1, 0])))) == 1
    assert not group_read(GroupBulkRead(b.port, b.ph), (1, 144, 2)).addParam(1, 146, 1)


def test_a_bulk_write_writes_a_servo_once(bench: Build) -> None:
    b = bench()
    assert b.heard(p2.Packet(p2.BROADCAST, p2.BULK_WRITE, bytes([1, 65, 0, 1, 0, 1, 1, 65, 0, 1, 0, 0]))) == []
    assert b.get("LED") == 1


def test_a_fast_sync_read_is_one_packet_without_stuffing(bench: Build) -> None:
    b = bench(MODEL, 3, 7, 4)
    for k in (3, 7, 4):
        b.servos[k].registers.put("Goal Position", 0xFDFFFF)
    (raw,) = b.heard(p2.Packet(p2.BROADCAST, p2.FAST_SYNC_READ, bytes([116, 0, 4, 0, 3, 7, 4])))
    assert int.from_bytes(raw[5:7], "little") == 0x19
    assert len(raw) == 7 + 0x19
    assert [raw[9:14], raw[17:22], raw[25:30]] == [bytes([k]) + b"\xff\xff\xfd\x00" for k in (3, 7, 4)]


@pytest.mark.parametrize(("option", "identity", "baud"), [(0xFF, 1, 57_600), (0x01, 5, 57_600), (0x02, 5, BAUD)])
def test_factory_reset_keeps_id_and_baud_rate_as_it_is_told(
    bench: Build, option: int, identity: int, baud: int
) -> None:
    b = bench(MODEL, 5)
    assert (b.put("Temperature Limit", 70, 5), b.put("Goal Velocity", 3, 5)) == (0, 0)
    assert b.ph.factoryReset(b.port, 5, option) == (COMM_SUCCESS, 0)
    b.later(1.0)
    b.port.setBaudRate(baud)
    b.servos[identity] = b.servos[5]
    assert (b.get("Temperature Limit", identity), b.get("Goal Velocity", identity)) == (80, 200)


# ---- control table ----


@pytest.mark.parametrize("name", ["ID", "Drive Mode", "Operating Mode", "Homing Offset", "Startup Configuration"])
def test_torque_locks_every_item_of_the_eeprom(bench: Build, name: str) -> None:
    b = bench()
    for torque, error in ((1, p2.ACCESS_ERROR), (0, 0)):
        b.set(Torque_Enable=torque)
        assert b.put(name, b.get(name)) == error


def test_items_that_are_only_read_refuse_a_write(bench: Build) -> None:
    b = bench()
    for name in ("Model Number", "Present Position", "Moving", "Backup Ready", "Realtime Tick"):
        assert b.put(name, 0) == p2.ACCESS_ERROR, name


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
    assert (b.ph.ping(b.port, 1)[0], b.get("Model Number"), b.get("Current Limit")) == (number, number, limit)
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
    assert [b.put("Min Voltage Limit", value) for value in (lowest - 1, lowest)] == [p2.RANGE_ERROR, 0]


GAINS = ("Velocity I Gain", "Velocity P Gain", "Position D Gain", "Position I Gain", "Position P Gain")


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
    assert tuple(b.get(name) for name in GAINS) == gains


@pytest.mark.parametrize(
    ("model", "temperature", "shutdown"),
    [("xm430-w350", 80, 0x34), ("xl430-w250", 72, 0x34), ("xl330-m288", 70, 0x35), ("xc330-m288", 70, 0x34)],
)
def test_every_model_has_its_temperature_limit_and_shutdown(
    bench: Build, model: str, temperature: int, shutdown: int
) -> None:
    b = bench(model)
    assert (b.get("Temperature Limit"), b.get("Shutdown")) == (temperature, shutdown)


# ---- profiles, watchdog, health ----


@pytest.mark.parametrize(
    ("velocity", "acceleration", "goal", "kind"),
    [(0, 0, 3000, 0x00), (0, 9, 3000, 0x00), (30, 0, 3000, 0x10), (200, 2, 2050, 0x20), (30, 20, 3000, 0x30)],
)
def test_the_moving_status_names_the_profile(
    bench: Build, velocity: int, acceleration: int, goal: int, kind: int
) -> None:
    b = bench()
    b.set(Profile_Velocity=velocity, Profile_Acceleration=acceleration, Torque_Enable=1, Goal_Position=goal)
    assert b.get("Moving Status") & 0x30 == kind


def test_the_watchdog_stops_and_zeroes_the_profile(bench: Build) -> None:
    b = bench()
    b.set(Profile_Velocity=20, Profile_Acceleration=10, Torque_Enable=1, Bus_Watchdog=100, Goal_Position=4000)
    b.later(1.0)
    b.expire()
    stopped = b.get("Present Position")
    b.later(1.0)
    assert b.get("Present Position") == stopped < 4000
    assert [b.get(n) for n in ("Bus Watchdog", "Profile Velocity", "Profile Acceleration")] == [-1, 0, 0]


def test_any_packet_on_the_bus_keeps_the_watchdog_quiet(bench: Build) -> None:
    b = bench(MODEL, 1, 2)
    b.set(Torque_Enable=1, Bus_Watchdog=100)
    b.servos[1]._heard_s = before = time.monotonic() - 1.0
    assert b.get("LED", 2) == 0
    assert b.servos[1]._heard_s > before
    assert b.get("Bus Watchdog") == 100


def test_the_bus_watchdog_counts_wall_time_whatever_the_time_scale() -> None:
    clock = HandClock()
    clock.at = lambda wall_s: 50.0 * wall_s  # type: ignore[method-assign]
    servo = Servo(1, clock, baud=BAUD)  # type: ignore[arg-type]
    for address, data in ((11, b"\x01"), (64, b"\x01"), (104, bytes([10, 0, 0, 0])), (98, b"\x02")):
        servo.write(address, data)  # velocity mode: it turns until somebody stops it
    heard = time.monotonic()
    servo.heard(heard)
    servo._watch(heard + 0.039)
    assert servo.get("Bus Watchdog") == 2
    servo._watch(heard + 10.0)
    assert servo.get("Bus Watchdog") == -1
    assert servo._path.phases[0].start == 50.0 * (heard + 0.040)  # two units of 20 ms
    assert servo.shaft()[1] == 0.0


@pytest.mark.parametrize(
    ("attribute", "value", "bit", "off"),
    [
        ("temperature_c", 81, 0x04, 1), ("supply_dv", 94, 0x01, 0), ("supply_dv", 161, 0x01, 0),
        ("damage", 0x10, 0x10, 1), ("damage", 8, 8, 0),
    ],
)  # fmt: skip
def test_hardware_errors_raise_the_alert_and_shutdown_takes_the_torque(
    bench: Build, attribute: str, value: int, bit: int, off: int
) -> None:
    b = bench()
    b.set(Torque_Enable=1)
    setattr(b.servos[1], attribute, value)
    assert b.ph.read1ByteTxRx(b.port, 1, 70) == (bit, COMM_SUCCESS, 0x80)
    assert b.get("Torque Enable") == 1 - off
