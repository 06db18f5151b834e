"""What the manual says of the servos, asked of the twin by the unmodified SDK; readme.md here lists the facts."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from dynamixel_sdk import COMM_SUCCESS
from gonio_sim.wire import protocol2 as p2

from tests.gonio_sim.wire.conftest import Build, ManualRig
from tests.places import ROOT

PAGE = ROOT / "tests/gonio_sim/wire/readme.md"

Step = dict[str, int] | float | Callable[[ManualRig], object]
"""Items that are set, time that passes [s], or something that is done or asked."""


def reads(identity: int = 1, **expected: int | range) -> Step:
    """Items of a servo, named with underscores, have these values, or values in these ranges."""

    def check(b: ManualRig) -> None:
        found = {name: b.get(name.replace("_", " "), identity) for name in expected}
        wrong = {n: v for n, v in found.items() if not (v in e if isinstance(e := expected[n], range) else v == e)}
        assert not wrong

    return check


def puts(name: str, errors: dict[int, int], identity: int = 1) -> Step:
    """Values that are written to an item, one after the other, and the errors that they are answered with."""

    def check(b: ManualRig) -> None:
        assert {value: b.put(name, value, identity) for value in errors} == errors

    return check


def writes(address: int, data: bytes, error: int = 0) -> Step:
    """Bytes that are written at an address, and the error that they are answered with."""

    def check(b: ManualRig) -> None:
        assert b.write(address, data) == error

    return check


def hears(packet: p2.Packet | bytes, *answers: bytes) -> Step:
    """A packet, and all status packets that it is answered with."""

    def check(b: ManualRig) -> None:
        assert b.heard(packet) == list(answers)

    return check


def tells(instruction: int, parameters: bytes, error: int = 0) -> Step:
    """An instruction for servo 1 by the SDK, and the error that it is answered with."""

    def check(b: ManualRig) -> None:
        assert b.tell(instruction, parameters) == (COMM_SUCCESS, error)

    return check


def status(mask: int, bits: int) -> Step:
    """Some bits of the Moving Status."""

    def check(b: ManualRig) -> None:
        assert b.get("Moving Status") & mask == bits

    return check


def turn(counts: float, identity: int = 1) -> Step:
    """Somebody turns the shaft."""
    return lambda b: b.servos[identity].turn(counts)


def shaft(counts: float) -> Step:
    """The shaft has turned to a place [counts]."""

    def check(b: ManualRig) -> None:
        assert b.servos[1].travelled() == counts

    return check


def has(**attributes: int) -> Step:
    """Attributes of servo 1 that the simulated rig changes: its temperature, supply, damage."""

    def change(b: ManualRig) -> None:
        for name, value in attributes.items():
            setattr(b.servos[1], name, value)

    return change


def block(b: ManualRig) -> None:
    """Something holds the shaft."""
    b.servos[1].block()


def word(*values: int) -> bytes:
    """Four bytes each."""
    return b"".join(value.to_bytes(4, "little") for value in values)


def two(*values: int) -> bytes:
    """Two bytes each."""
    return b"".join(value.to_bytes(2, "little") for value in values)


def packet(instruction: int, parameters: bytes = b"", identity: int = 1) -> p2.Packet:
    return p2.Packet(identity, instruction, parameters)


def others(*steps: Step, model: str = "xm430-w350", ids: tuple[int, ...] = (1,)) -> tuple[str, tuple[int, ...], Any]:
    """A fact of another model, or of several servos."""
    return model, ids, steps


PING, LED_ON = bytes([0xFC, 0x03, 46]), two(65) + b"\x01"
POSITION = two(132, 4)
FACTS: dict[str, tuple[Any, ...]] = {
    # ---- instructions ----
    "a_broadcast_ping_is_answered_in_the_order_of_ids": others(
        hears(packet(p2.PING, b"", p2.BROADCAST), *(p2.status(k, 0, PING) for k in (4, 7, 9))), ids=(9, 4, 7)
    ),
    "a_wrong_crc_is_answered_with_the_crc_error": (
        hears(packet(p2.PING).encode()[:-1] + b"\x00", p2.status(1, p2.CRC_ERROR)),
    ),
    "reads_and_writes_to_everybody_are_not_answered": others(
        hears(packet(p2.READ, POSITION, p2.BROADCAST)),
        hears(packet(p2.WRITE, LED_ON, p2.BROADCAST)),
        reads(1, LED=1), reads(2, LED=1), ids=(1, 2),
    ),
    "a_read_outside_the_table_is_refused_without_parameters": (
        hears(packet(p2.READ, two(2048, 4)), p2.status(1, p2.ACCESS_ERROR)),
    ),
    "refusals": (
        writes(65, b"\x02", p2.RANGE_ERROR), writes(132, word(5), p2.ACCESS_ERROR),
        writes(700, b"\x00", p2.ACCESS_ERROR),
        writes(116, two(100), p2.LENGTH_ERROR), writes(116, word(4096), p2.LIMIT_ERROR),
        writes(104, word(201), p2.LIMIT_ERROR), writes(102, two(1194), p2.LIMIT_ERROR),
        writes(11, b"\x02", p2.RANGE_ERROR), writes(78, two(300)),
    ),
    "status_return_level": (
        hears(packet(p2.WRITE, two(68) + b"\x01")), hears(packet(p2.WRITE, LED_ON)), reads(LED=1),
        hears(packet(p2.PING), p2.status(1, 0, PING)),
    ),
    "level_0_answers_pings_only": (
        hears(packet(p2.WRITE, two(68) + b"\x00")), hears(packet(p2.PING), p2.status(1, 0, PING)),
        hears(packet(p2.READ, two(65, 1))),
    ),
    "unknown_instruction": (tells(0x42, b"", p2.INSTRUCTION_ERROR),),
    "an_action_without_reg_write_is_an_instruction_error": (
        hears(packet(p2.ACTION), p2.status(1, p2.INSTRUCTION_ERROR)),
    ),
    "reg_write_is_checked_when_it_comes_and_done_at_the_action": (
        tells(p2.REG_WRITE, two(65) + b"\x02", p2.RANGE_ERROR), reads(Registered_Instruction=0),
        tells(p2.REG_WRITE, LED_ON), reads(Registered_Instruction=1, LED=0),
        hears(packet(p2.ACTION, b"", p2.BROADCAST)), reads(Registered_Instruction=0, LED=1),
    ),
    "an_action_for_one_servo_is_answered": (
        hears(packet(p2.REG_WRITE, LED_ON), p2.status(1, 0)), hears(packet(p2.ACTION), p2.status(1, 0)), reads(LED=1),
    ),
    "a_factory_reset_reboots": (tells(p2.FACTORY_RESET, b"\x02"), ManualRig.boots),
    "a_broadcast_factory_reset_of_everything_is_not_carried_out": (
        {"Temperature_Limit": 70}, hears(packet(p2.FACTORY_RESET, b"\xff", p2.BROADCAST)), reads(Temperature_Limit=70),
    ),
    "clear_brings_the_count_within_a_turn": (
        {"Operating_Mode": 4, "Torque_Enable": 1, "Goal_Position": 9000}, 60.0, reads(Present_Position=9000),
        tells(p2.CLEAR, b"\x01DXL\x22"), reads(Present_Position=9000 - 2 * 4096),
        1.0, reads(Present_Position=9000 - 2 * 4096),
    ),
    "clear_is_refused_while_it_moves": (
        {"Torque_Enable": 1, "Profile_Velocity": 10, "Goal_Position": 3000}, 0.5,
        tells(p2.CLEAR, b"\x01DXL\x22", p2.RESULT_FAIL),
    ),
    "the_table_is_backed_up_and_restored": (
        {"Velocity_Limit": 150, "Homing_Offset": 30}, reads(Backup_Ready=0),
        tells(p2.BACKUP, b"\x01CTRL"), reads(Backup_Ready=1), {"Velocity_Limit": 100, "Homing_Offset": 0},
        tells(p2.BACKUP, b"\x02CTRL"), ManualRig.boots, reads(Velocity_Limit=150, Homing_Offset=30, Backup_Ready=1),
    ),
    "a_backup_needs_the_torque_off": (
        {"Torque_Enable": 1}, tells(p2.BACKUP, b"\x01CTRL", p2.RESULT_FAIL),
        tells(p2.BACKUP, b"\x02CTRL", p2.RESULT_FAIL), reads(Backup_Ready=0),
    ),
    "the_published_backup_packet_is_taken": (
        hears(bytes.fromhex("FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5"),
              bytes.fromhex("FF FF FD 00 01 04 00 55 00 A1 0C")),
    ),
    "a_backup_holds_gains_profile_and_indirect_addresses_for_the_start": (
        {"Startup_Configuration": 2, "Position_P_Gain": 500, "Profile_Velocity": 33, "Indirect_Address_1": 65},
        {"Goal_PWM": 100}, tells(p2.BACKUP, b"\x01CTRL"), ManualRig.reboot,
        reads(Position_P_Gain=500, Profile_Velocity=33, Indirect_Address_1=65, Goal_PWM=885),  # which is not among them
    ),
    "an_instruction_for_several_is_for_the_broadcast_id": (hears(packet(p2.SYNC_READ, POSITION + b"\x01")),),
    "sync_answers_come_in_the_order_of_the_request": others(
        hears(packet(p2.SYNC_READ, POSITION + bytes([3, 1, 2]), p2.BROADCAST),
              *(p2.status(k, 0, word(2000)) for k in (3, 1, 2))), ids=(1, 2, 3),
    ),
    "the_published_fast_sync_read_is_answered_byte_for_byte": others(
        turn(166 - 2000.0, 3), turn(2079 - 2000.0, 7), turn(1023 - 2000.0, 4),
        hears(bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"), bytes.fromhex(
            "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
        )), model="xc330-t288", ids=(3, 7, 4),
    ),
    # ---- control table ----
    "eeprom_survives_a_reboot_and_ram_does_not": (
        {"Velocity_Limit": 77, "Profile_Velocity": 5, "LED": 1, "Torque_Enable": 1}, ManualRig.reboot,
        reads(Velocity_Limit=77, Profile_Velocity=0, LED=0, Torque_Enable=0),
    ),
    "a_write_that_begins_inside_an_item_is_refused": (writes(117, b"\x01\x02\x03", p2.ACCESS_ERROR),),
    "a_write_shorter_than_the_item_is_a_length_error": (writes(116, b"\x01\x02", p2.LENGTH_ERROR),),
    "a_write_of_several_items_is_all_or_nothing": (
        writes(108, word(5, 40_000), p2.RANGE_ERROR), reads(Profile_Acceleration=0),
    ),
    "models_without_current_have_no_current_modes": others(
        puts("Operating Mode", {0: 4, 1: 0, 3: 0, 4: 0, 5: 4, 16: 0}),
        hears(packet(p2.READ, two(102, 2)), p2.status(1, p2.ACCESS_ERROR)), model="xl430-w250",  # no Goal Current
    ),
    "models_with_current_have_all_modes": (puts("Operating Mode", {0: 0, 1: 0, 2: 4, 3: 0, 4: 0, 5: 0, 16: 0}),),
    "small_servos_have_baud_rates_to_4_mbps": others(puts("Baud Rate", {7: p2.RANGE_ERROR}), model="xl330-m288"),
    "indirect_addresses": (
        {"Indirect_Address_1": 146, "Indirect_Address_2": 65}, reads(Indirect_Data_1=34), writes(225, b"\x01"),
        reads(LED=1),
    ),
    "indirect_data_may_mean_items_that_are_not_adjacent": (  # LED, Goal Position, Profile Velocity
        {f"Indirect_Address_{k + 1}": at for k, at in enumerate((65, *range(116, 120), *range(112, 116)))},
        writes(224, b"\x01" + word(1024, 50)), reads(LED=1, Goal_Position=1024, Profile_Velocity=50),
        hears(packet(p2.READ, two(224, 9)), p2.status(1, 0, b"\x01" + word(1024, 50))),
    ),
    "indirect_data_has_range_and_access_of_what_it_means": (
        {"Indirect_Address_1": 65, "Indirect_Address_2": 122}, writes(224, b"\x02", p2.RANGE_ERROR),
        writes(225, b"\x01", p2.ACCESS_ERROR),
    ),
    "indirect_data_needs_all_bytes_of_an_item": (
        {"Indirect_Address_1": 116, "Indirect_Address_2": 117}, writes(224, b"\x01\x02", p2.LENGTH_ERROR),
    ),
    "indirect_addresses_lead_to_the_ram_only": (
        puts("Indirect Address 1", {63: 4, 64: 0, 661: 0, 662: 4}),
        reads(Indirect_Address_2=225, Indirect_Address_29=634),
    ),
    "small_servos_have_twenty_indirect_bytes_at_208": others(
        reads(Indirect_Address_1=208, Indirect_Address_20=227), puts("Indirect Address 1", {228: 4, 65: 0}),
        writes(208, b"\x01"), reads(LED=1), model="xl330-m288",
    ),
    "a_shadow_id_is_obeyed_and_not_answered": (
        {"Secondary(Shadow)_ID": 50}, hears(packet(p2.WRITE, LED_ON, 50)), reads(LED=1),
    ),
    "a_secondary_id_reaches_a_group_and_nobody_answers": others(
        *(puts("Secondary(Shadow) ID", {5: 0}, k) for k in (1, 2, 5)),
        puts("LED", {1: 0}, 5),  # the one whose own id it is answers
        reads(1, LED=1), reads(2, LED=1), reads(5, LED=1), ids=(1, 2, 5),
    ),
    "a_secondary_id_does_not_reach_the_eeprom": (
        {"Secondary(Shadow)_ID": 50}, hears(packet(p2.WRITE, two(31) + b"\x3c", 50)), reads(Temperature_Limit=80),
    ),
    "the_tick_starts_at_zero_and_wraps_at_32767": (
        reads(Realtime_Tick=0), 32.760, reads(Realtime_Tick=range(32_759, 32_761)), 0.010,
        reads(Realtime_Tick=range(3)), 5.0, ManualRig.reboot, reads(Realtime_Tick=1000),
    ),
    "volts_are_tenths_and_temperatures_degrees": (
        has(supply_dv=119, temperature_c=36), reads(Present_Input_Voltage=119, Present_Temperature=36),
    ),
    # ---- position ----
    "position_mode_keeps_the_position_limits": (
        {"Min_Position_Limit": 1000, "Max_Position_Limit": 3000},
        puts("Goal Position", {999: 6, 1000: 0, 3000: 0, 3001: 6}),
    ),
    "extended_mode_has_no_position_limits_but_256_turns": (
        {"Max_Position_Limit": 3000, "Operating_Mode": 4},
        puts("Goal Position", {3001: 0, 1_048_575: 0, 1_048_576: 4, -1_048_575: 0, -1_048_576: 4}),
    ),
    "a_homing_offset_is_added_to_the_present_position": (
        {"Homing_Offset": -100}, reads(Present_Position=1900), {"Torque_Enable": 1, "Goal_Position": 2400}, 10.0,
        reads(Present_Position=2400), shaft(2500.0),
    ),
    "position_mode_ignores_a_homing_offset_beyond_1024": (
        {"Homing_Offset": 1024}, reads(Present_Position=3024), {"Homing_Offset": 1025}, reads(Present_Position=2000),
        {"Homing_Offset": -1024}, reads(Present_Position=976), {"Homing_Offset": -1025}, reads(Present_Position=2000),
        {"Homing_Offset": 5000, "Operating_Mode": 4}, reads(Present_Position=7000),
    ),
    "reverse_mode_leaves_the_sign_of_the_homing_offset": (
        {"Drive_Mode": 1}, reads(Present_Position=2095), {"Homing_Offset": 100}, reads(Present_Position=2195),
    ),
    "without_torque_the_count_goes_beyond_a_turn": (
        turn(3000.0), reads(Present_Position=5000), turn(-6000.0), reads(Present_Position=-1000),
    ),
    "the_count_comes_back_within_a_turn": (
        turn(3000.0), {"Goal_Position": 904, "Torque_Enable": 1}, reads(Present_Position=904), {"Torque_Enable": 0},
        turn(4096.0), {"Operating_Mode": 1}, reads(Present_Position=5000), {"Operating_Mode": 3},
        reads(Present_Position=904), turn(4096.0), reads(Present_Position=5000), ManualRig.reboot,
        reads(Present_Position=904),
    ),
    "extended_mode_keeps_its_turns_at_torque_on": (
        {"Operating_Mode": 4}, turn(3000.0), {"Goal_Position": 5000, "Torque_Enable": 1}, reads(Present_Position=5000),
    ),
    "extended_mode_forgets_turns_with_the_power": (
        {"Operating_Mode": 4, "Torque_Enable": 1, "Goal_Position": 10_000}, 60.0, reads(Present_Position=10_000),
        ManualRig.reboot, reads(Present_Position=10_000 - 2 * 4096), shaft(10_000),
    ),
    "a_count_within_a_turn_has_the_homing_offset_still": (
        {"Homing_Offset": 500}, turn(3000.0), ManualRig.reboot, reads(Present_Position=5000 - 4096 + 500),
    ),
    # ---- modes ----
    "another_operating_mode_resets_profile_gains_and_goals": (
        {"Profile_Velocity": 9, "Profile_Acceleration": 8, "Position_P_Gain": 1, "Velocity_I_Gain": 2},
        {"Feedforward_1st_Gain": 3, "PWM_Limit": 800, "Goal_PWM": 10, "Goal_Current": 11, "Operating_Mode": 5},
        reads(Profile_Velocity=0, Profile_Acceleration=0, Position_P_Gain=800, Velocity_I_Gain=1920),
        reads(Feedforward_1st_Gain=0, Goal_PWM=800, Goal_Current=1193),
    ),
    "the_same_operating_mode_again_resets_nothing": (
        {"Profile_Velocity": 9, "Operating_Mode": 3}, reads(Profile_Velocity=9),
    ),
    "velocity_mode_turns_at_its_goal": (
        {"Operating_Mode": 1, "Torque_Enable": 1, "Goal_Velocity": -50}, 1.0, reads(Present_Velocity=-50), 10.0,
        reads(Present_Position=range(-50_000, -4096)), puts("Goal Velocity", {200: 0, 201: 6, -200: 0, -201: 6}),
    ),
    "velocity_mode_takes_the_acceleration_and_no_profile_velocity": (
        {"Operating_Mode": 1, "Profile_Acceleration": 64, "Profile_Velocity": 1, "Torque_Enable": 1},
        {"Goal_Velocity": 100}, 0.050,  # t1 = 64 Goal Velocity / Profile Acceleration [ms]: half of 100 ms
        reads(Present_Velocity=range(49, 52)), 0.051, reads(Present_Velocity=100),
    ),
    "the_velocity_limit_bounds_the_goal_velocity": (
        {"Velocity_Limit": 60, "Operating_Mode": 1}, puts("Goal Velocity", {60: 0, 61: 6}),
    ),
    "the_current_limit_bounds_the_goal_current": (
        {"Current_Limit": 500, "Operating_Mode": 0}, puts("Goal Current", {500: 0, 501: 6, -500: 0, -501: 6}),
    ),
    "the_pwm_limit_bounds_the_goal_pwm": (
        {"PWM_Limit": 400, "Operating_Mode": 16}, puts("Goal PWM", {400: 0, 401: 6, -400: 0, -401: 6}),
    ),
    "pwm_mode_sets_the_output_itself": (
        {"Operating_Mode": 16, "Goal_PWM": -400, "Torque_Enable": 1}, 1.0, reads(Present_PWM=-400),
        reads(Present_Velocity=range(-999, 0)),
    ),
    "current_mode_sets_the_current_itself": (
        {"Operating_Mode": 0, "Goal_Current": 100, "Torque_Enable": 1}, 1.0, reads(Present_Current=100),
        reads(Present_Velocity=range(1, 999)),
    ),
    "current_based_position_mode_goes_over_several_turns": (
        {"Operating_Mode": 5, "Torque_Enable": 1, "Goal_Position": 9000}, 60.0, reads(Present_Position=9000),
    ),
    # ---- drive mode and start ----
    "a_goal_turns_the_torque_on_where_drive_mode_says_so": (
        {"Goal_Position": 2100}, reads(Torque_Enable=0, Moving=0),
        {"Drive_Mode": 8, "Profile_Velocity": 10, "Goal_Position": 2200}, 0.1, reads(Torque_Enable=1, Moving=1), 10.0,
        reads(Present_Position=2200),
    ),
    "unused_bits_of_the_drive_mode_are_refused": (puts("Drive Mode", {0x0D: 0, 0x02: 4, 0x10: 4}),),
    "unused_bits_of_the_drive_mode_of_two_servos_are_refused": others(
        puts("Drive Mode", {0x0F: 0, 0x10: 4}), model="xm540-w270"
    ),
    "a_follower_ignores_its_goals": others(
        {"Drive_Mode": 2, "Torque_Enable": 1, "Goal_Position": 3000}, 10.0, reads(Present_Position=2000),
        model="xm540-w270",
    ),
    "reverse_mode_inverts_position_and_velocity": (
        {"Drive_Mode": 1, "Profile_Velocity": 20, "Torque_Enable": 1, "Goal_Position": 2595}, 0.5,
        reads(Present_Velocity=20, Present_Position=range(2096, 2595)), 20.0, shaft(1500),
    ),
    "reverse_mode_turns_the_other_way": (
        {"Drive_Mode": 1}, reads(Present_Position=2095), {"Torque_Enable": 1, "Goal_Position": 2195}, 10.0,
        shaft(1900.0), reads(Present_Position=2195),
    ),
    "torque_can_be_on_from_the_start": (
        {"Startup_Configuration": 1}, ManualRig.reboot,
        reads(Torque_Enable=1, Present_Position=2000, Goal_Position=2000),
    ),
    # ---- profiles ----
    "torque_moves_the_shaft_by_its_profile": (
        {"Profile_Acceleration": 10, "Profile_Velocity": 15, "Goal_Position": 2500}, 1.0,
        reads(Present_Position=2000, Moving=0), {"Torque_Enable": 1}, 2.0, reads(Moving=1, Present_Velocity=15), 10.0,
        reads(Moving=0, Present_Position=2500),
    ),
    "a_velocity_profile_reaches_its_speed": (
        {"Profile_Velocity": 30, "Torque_Enable": 1, "Goal_Position": 4000}, 1.0,
        # 30 * 0.229 rpm for a second, to a count
        reads(Present_Velocity=30, Velocity_Trajectory=30, Present_Position=range(2468, 2471)),
    ),
    "profile_velocity_0_is_as_fast_as_the_motor_goes": (  # no profile, so no acceleration of one
        {"Profile_Acceleration": 1, "Torque_Enable": 1, "Goal_Position": 4000}, 0.1, reads(Present_Velocity=200),
        status(0x30, 0x00),
    ),
    "the_moving_status_tells_under_way_and_arrived": (
        {"Profile_Velocity": 30, "Profile_Acceleration": 20, "Torque_Enable": 1, "Goal_Position": 3000}, 0.5,
        status(0x03, 0x02), 20.0, status(0x03, 0x01),
    ),
    "in_position_is_for_position_modes_only": (
        {"Operating_Mode": 1, "Torque_Enable": 1, "Goal_Velocity": 10}, 1.0, status(0x0B, 0),
    ),
    "a_blocked_shaft_does_not_follow": (
        {"Profile_Velocity": 30, "Torque_Enable": 1}, block, {"Goal_Position": 3000}, 1.0, status(0x09, 0x08),
    ),
    "moving_is_set_while_a_profile_goes_on_however_slow": (
        {"Profile_Velocity": 3, "Torque_Enable": 1, "Goal_Position": 2500}, 0.5,
        reads(Present_Velocity=3, Moving_Threshold=10, Moving=1),
    ),
    "moving_is_set_above_the_threshold": (
        {"Operating_Mode": 1, "Moving_Threshold": 40, "Torque_Enable": 1, "Goal_Velocity": 40}, 1.0, reads(Moving=0),
        {"Goal_Velocity": 41}, 1.0, reads(Moving=1),
    ),
    "a_time_based_profile_is_over_in_its_time": (
        {"Drive_Mode": 4, "Profile_Velocity": 2000, "Profile_Acceleration": 500, "Torque_Enable": 1},
        {"Goal_Position": 3000}, 1.99, status(0x02, 0x02), 0.02, status(0x03, 0x01), reads(Present_Position=3000),
    ),
    "the_time_of_acceleration_is_at_most_half": (
        {"Drive_Mode": 4, "Profile_Velocity": 2000, "Profile_Acceleration": 1800, "Torque_Enable": 1},
        # it speeds up for one second and slows down for the other
        {"Goal_Position": 3000}, 1.0, reads(Present_Position=range(2499, 2502)), 1.01, reads(Present_Position=3000),
    ),
    "time_based_profiles_end_at_32737_ms": ({"Drive_Mode": 4}, puts("Profile Velocity", {32_737: 0, 32_738: 4})),
    "the_trajectories_end_at_the_goal": (
        {"Profile_Velocity": 30, "Profile_Acceleration": 20, "Torque_Enable": 1, "Goal_Position": 3000}, 1.0,
        reads(Position_Trajectory=range(2001, 3000), Velocity_Trajectory=30), 20.0,
        reads(Position_Trajectory=3000, Velocity_Trajectory=0), {"Torque_Enable": 0},
        {"Operating_Mode": 1, "Torque_Enable": 1, "Goal_Velocity": 25}, 1.0, reads(Velocity_Trajectory=25),
    ),
    "profile_and_goal_of_one_write_count_together": (
        {"Torque_Enable": 1}, writes(108, word(20, 10, 3000)), 1.0, reads(Present_Velocity=10),
    ),
    # ---- bus watchdog ----
    "the_watchdog_bars_every_goal_until_it_is_cleared": (
        {"Operating_Mode": 1, "Torque_Enable": 1, "Bus_Watchdog": 100}, ManualRig.expire,
        *(puts(f"Goal {name}", {150: p2.RANGE_ERROR}) for name in ("PWM", "Current", "Velocity", "Position")),
        {"Bus_Watchdog": 50}, reads(Bus_Watchdog=-1),  # only 0 clears it
        {"Bus_Watchdog": 0, "Goal_Velocity": 150}, 1.0, reads(Present_Velocity=150),
    ),
    "the_watchdog_watches_with_torque_only": ({"Bus_Watchdog": 100}, ManualRig.expire, reads(Bus_Watchdog=100)),
    # ---- health ----
    "shutdown_chooses_what_takes_the_torque": (
        {"Shutdown": 0x05, "Torque_Enable": 1}, has(supply_dv=90), reads(LED=0), reads(Torque_Enable=0),
    ),
    "only_a_reboot_gives_the_torque_back": (
        {"Torque_Enable": 1}, has(temperature_c=90), reads(LED=0), has(temperature_c=40),
        puts("Torque Enable", {1: 0x80 | p2.RESULT_FAIL}), ManualRig.reboot, {"Torque_Enable": 1},
    ),
    "a_load_that_lasts_is_an_overload": (
        {"Torque_Enable": 1, "Profile_Velocity": 30}, block, {"Goal_Position": 3000},
        *(0.2, reads(Moving_Threshold=10)) * 40, reads(Hardware_Error_Status=0x20, Torque_Enable=0),
    ),
}  # fmt: skip
"""Each by the name that its row has in readme.md."""


@pytest.mark.parametrize("name", FACTS)
def test_fact(bench: Build, name: str) -> None:
    fact = FACTS[name]
    model, ids, steps = fact if isinstance(fact[0], str) else ("xm430-w350", (1,), fact)
    b = bench(model, *ids)
    for step in steps:
        if isinstance(step, dict):
            b.set(**step)
        elif isinstance(step, float):
            b.later(step)
        else:
            step(b)


def test_every_fact_of_the_page_has_its_test_and_every_test_its_fact() -> None:
    named = re.findall(r"(?m)^\| `test_(\w+)` \| .*\| .+ \|$", PAGE.read_text())
    assert len(named) >= 70
    assert set(FACTS) <= set(named)
    elsewhere = (ROOT / "tests/gonio_sim/wire/test_twin_protocol.py").read_text()
    assert all(f"def test_{name}(" in elsewhere for name in set(named) - set(FACTS))
