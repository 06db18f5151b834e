"""A Dynamixel servo of the X series: its rules, its shaft, its health.

Written from the e-Manual, from the device's side. Motion and health run on the twin's clock; the return delay and
the bus watchdog, which belong to the wire, run on wall time.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from gonio.lab.rig import clock as wall
from gonio_sim.wire import motion, tables
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.peer import Clock

NO_LOAD = 1.0e6
"""Acceleration where no profile limits it [counts/s^2]."""
STALL_TO_OVERLOAD_S = 2.0
BOOT_S = 0.5
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
WATCHDOG_UNIT_S = 0.020
CURRENT, VELOCITY, POSITION, EXTENDED, CURRENT_POSITION, PWM = 0, 1, 3, 4, 5, 16
POSITION_MODES = (POSITION, EXTENDED, CURRENT_POSITION)
GOALS = {
    CURRENT: "Goal Current", VELOCITY: "Goal Velocity", POSITION: "Goal Position", EXTENDED: "Goal Position",
    CURRENT_POSITION: "Goal Position", PWM: "Goal PWM",
}  # fmt: skip
"""The item that moves the shaft, by operating mode."""
REVERSE, FOLLOWER, TIME_BASED, TORQUE_BY_GOAL = 0x01, 0x02, 0x04, 0x08
"""Bits of the Drive Mode."""
TORQUE_AT_START, RAM_RESTORE = 0x01, 0x02
"""Bits of the Startup Configuration."""
STEP, RECTANGULAR, TRIANGULAR, TRAPEZOIDAL = 0x00, 0x10, 0x20, 0x30
FOLLOWING_ERROR, UNDER_WAY, IN_POSITION = 0x08, 0x02, 0x01
"""Bits of the Moving Status."""
VALID_OFFSET = 1024
"""Largest homing offset that counts in Position mode."""
IN_POSITION_COUNTS = 20
GAINS = (
    "Velocity I Gain", "Velocity P Gain", "Position D Gain", "Position I Gain", "Position P Gain",
    "Feedforward 2nd Gain", "Feedforward 1st Gain",
)  # fmt: skip
PROFILE = ("Profile Acceleration", "Profile Velocity")
LIMITED = (("Goal Velocity", "Velocity Limit"), ("Goal Current", "Current Limit"), ("Goal PWM", "PWM Limit"))

VOLTAGE, OVERHEATING, ENCODER, SHOCK, OVERLOAD = 0x01, 0x04, 0x08, 0x10, 0x20
"""Bits of the Hardware Error Status and of Shutdown."""
AMBIENT_C = 34
PULL_DOWN = 3
"""External Port Mode: a digital input, 0 where nothing is connected."""
VOLTAGES = ("Min Voltage Limit", "Max Voltage Limit")


@dataclass(frozen=True, slots=True)
class Mechanics:
    """What the shaft does that its owner would rather not have."""

    short_counts: float = 0.0
    """Friction: without I gain the shaft stops this far before its goal, and does not leave for less [counts]."""
    within: Callable[[], float] = lambda: 0.0
    """Where in a count it stops, -1/2 to 1/2."""
    noise_counts: float = 0.0
    """Amplitude of the readback's flicker at rest [counts]."""


class Servo:
    """One servo.

    Parameters
    ----------
    identity, model, baud
        What its owner has set: ID, model name as "xm430-w350", line speed.
    clock
        The twin's clock [s].
    position
        Where the shaft stands when the power comes [counts].
    """

    def __init__(
        self,
        identity: int,
        clock: Clock,
        *,
        model: str = "xm430-w350",
        baud: int = 57_600,
        position: float = 2048.0,
        mechanics: Mechanics | None = None,
    ) -> None:
        self.table = tables.table(model)
        self.mechanics = mechanics or Mechanics()
        self._clock = clock
        self.registers = tables.Registers(self.table)
        self.registers.put("ID", identity)
        self.registers.put("Baud Rate", {rate: code for code, rate in tables.BAUD_CODES.items()}[baud])
        self._path = motion.rest(clock(), position)
        self._blocked_at: float | None = None
        self._stalled_since: float | None = None
        self._registered: tuple[int, bytes] | None = None
        self._back_at: float | None = None
        self._heard_s = wall.monotonic()
        self._looks = 0
        self._backup: dict[str, int] = {}
        self.leaving: Callable[[], None] = lambda: None
        """Called before the shaft sets out for a new goal: what hangs on it has followed until now."""
        self.powered = True
        self.temperature_c = AMBIENT_C
        self.contacts: set[int] = set()
        """External ports at which a contact is closed."""
        self._suffers: dict[str, float] = {}
        """Until when it suffers from what [s]."""
        self.supply_dv = self.table.supply_dv
        self.damage = 0
        """Bits of the hardware error that nothing else here causes: the encoder's 0x08, an electrical shock's 0x10."""
        self._power_up()

    # ---- what the simulated rig sees and does ----

    @property
    def id(self) -> int:
        return self.get("ID")

    @property
    def baud(self) -> int:
        return tables.BAUD_CODES[self.get("Baud Rate")]

    @property
    def torque(self) -> bool:
        return bool(self.get("Torque Enable"))

    @property
    def answers(self) -> bool:
        """Powered, and not booting."""
        return self.powered and (self._back_at is None or self._clock() >= self._back_at)

    def shaft(self) -> tuple[float, float]:
        """Position [counts], without the turns that the servo has forgotten, and velocity [counts/s], now."""
        position, velocity = self._shaft()
        return position - self._forgotten, velocity

    def travelled(self) -> float:
        """Position of the shaft with every turn [counts]: what hangs on it does not turn where the servo forgets."""
        return self._shaft()[0]

    def _shaft(self) -> tuple[float, float]:
        self._watch(wall.monotonic())
        if self._blocked_at is not None:
            return self._blocked_at, 0.0
        return self._path.at(self._clock())

    def moves(self) -> bool:
        """Whether the shaft turns now, or would turn if nothing blocked it."""
        self._watch(wall.monotonic())
        return self._clock() < self._path.end_s or abs(self._path.at(self._clock())[1]) > 0

    def turn(self, counts: float) -> None:
        """Somebody turns the shaft, which has no torque."""
        self._path = motion.rest(self._clock(), self._shaft()[0] + counts)
        self._aim = self._path.at(self._clock())[0]

    def block(self) -> None:
        """Something holds the shaft from now on."""
        self._blocked_at = self._shaft()[0]

    def unblock(self) -> None:
        """Let it go; it follows its goal again if it has torque."""
        if self._blocked_at is not None:
            self._path = motion.rest(self._clock(), self._blocked_at)
            self._blocked_at = self._stalled_since = None
            if self.torque:
                self._drive()

    def suffer(self, fault: str, seconds: float) -> None:
        """Be hot, have a sagging supply, or an open contact, for a while."""
        self._suffers[fault] = self._clock() + seconds

    def _suffering(self, fault: str) -> bool:
        return self._clock() < self._suffers.get(fault, -math.inf)

    def _supply_dv(self) -> int:
        """What the table says of the supply [0.1 V]."""
        return self.get("Min Voltage Limit") + 5 if self._suffering("sag") else self.supply_dv

    def lose_power(self) -> None:
        """Drop out of the bus."""
        self._release()
        self.powered = False

    def restart(self) -> None:
        """Boot: RAM falls back to its defaults, whole turns are forgotten, and nothing answers for half a second."""
        self._release()
        self.powered = True
        self._power_up()
        self._back_at = self._clock() + BOOT_S

    def get(self, name: str) -> int:
        """The value of an item, as its owner means it (signed where it is)."""
        return self.registers.get(name)

    # ---- instructions ----

    @property
    def error(self) -> int:
        """The error byte of a good status packet: the alert bit while a hardware error stands."""
        self._look()
        return p2.ALERT if self.get("Hardware Error Status") else 0

    def read(self, address: int, length: int) -> bytes:
        """Bytes of the control table."""
        self._refresh()
        return self.registers.read(address, length)

    def write(self, address: int, data: bytes, *, as_group: bool = False) -> None:
        """Change the control table, all of it or (with `Refused`) nothing; as one of a group, by the secondary id."""
        pairs = self._checked(address, data)
        if as_group and any(item.address < tables.EEPROM_END for item, _ in pairs):
            raise tables.Refused(p2.ACCESS_ERROR)
        for item, value in pairs:
            self._set(item.name, value)

    def register(self, address: int, data: bytes) -> None:
        """Keep a write for `action`."""
        self._checked(address, data)
        self._registered = (address, data)
        self._put(Registered_Instruction=1)

    def action(self) -> None:
        """Carry out what was registered."""
        if self._registered is None:
            raise tables.Refused(p2.INSTRUCTION_ERROR)
        (address, data), self._registered = self._registered, None
        self._put(Registered_Instruction=0)
        self.write(address, data)

    def reset(self, option: int) -> None:
        """Factory values: 0xFF all, 0x01 all except ID, 0x02 all except ID and baud rate."""
        keep = {0xFF: (), 0x01: ("ID",), 0x02: ("ID", "Baud Rate")}
        if option not in keep:
            raise tables.Refused(p2.RANGE_ERROR)
        self._require_free()
        kept = {name: self.get(name) for name in keep[option]}
        for name, item in self.table.items.items():
            if item.writable:
                self.registers.put(name, kept.get(name, self.table.factory.get(name, 0)))
        self.restart()

    def clear_turns(self) -> None:
        """Forget whole turns; only at rest."""
        if self._shaft()[1] != 0:
            raise tables.Refused(p2.RESULT_FAIL)
        self._forget_turns()
        self._goal_here()

    def back_up(self) -> None:
        """Keep the EEPROM, the gains, the profile and the indirect addresses."""
        self._require_free()
        self._backup = {name: self.get(name) for name, item in self.table.items.items() if _kept(item)}
        self.registers.put("Backup Ready", 1)

    def restore(self) -> None:
        """Take the EEPROM from the backup; a reboot is due after it."""
        self._require_free()
        if not self._backup:
            raise tables.Refused(p2.RESULT_FAIL)
        self._put_back(ram=False)

    def _require_free(self) -> None:
        if self.torque:
            raise tables.Refused(p2.RESULT_FAIL)

    def heard(self, wall_s: float) -> None:
        """Called for every instruction packet on the bus, for whomever it is: silence is counted from there."""
        self._watch(wall_s)
        self._heard_s = wall_s

    def _watch(self, wall_s: float) -> None:
        """The bus watchdog: after a silence, in wall time, the shaft has stopped at once, and its goal is there."""
        timeout_s = self.get("Bus Watchdog") * WATCHDOG_UNIT_S
        if timeout_s > 0 and self.torque and wall_s - self._heard_s > timeout_s:
            now = self._clock.at(self._heard_s + timeout_s)
            self._aim = self._path.at(now)[0] if self._blocked_at is None else self._blocked_at
            self._path = motion.rest(now, self._aim)
            self._profile_type = STEP
            self._put(Bus_Watchdog=-1, Profile_Velocity=0, Profile_Acceleration=0)
            self._goal_here()

    # ---- memory ----

    def _put(self, **values: int) -> None:
        """Items of the table, named with underscores."""
        for name, value in values.items():
            self.registers.put(name.replace("_", " "), value)

    def _goals_at_limits(self) -> None:
        """Goals of velocity, current and PWM are as large as they may be; in Velocity mode the shaft stands."""
        for goal, limit in LIMITED:
            if goal in self.table.items and limit in self.table.items:
                self.registers.put(goal, self.get(limit))
        if self.get("Operating Mode") == VELOCITY:
            self._put(Goal_Velocity=0)

    def _power_up(self) -> None:
        for name, item in self.table.items.items():
            if item.address >= tables.EEPROM_END and item.writable:
                self.registers.put(name, self.table.factory.get(name, 0))
        self._goals_at_limits()
        startup = self.get("Startup Configuration")
        if startup & RAM_RESTORE:
            self._put_back(ram=True)
        self._put(Hardware_Error_Status=0, Registered_Instruction=0)
        self._registered = self._stalled_since = None
        self._booted_s = self._clock()
        self._stand()
        self._forget_turns()
        self._goal_here()
        if startup & TORQUE_AT_START:
            self._put(Torque_Enable=1)

    def _stand(self) -> None:
        """At rest, without a profile."""
        self._profile_type = STEP
        self._aim = self._shaft()[0]
        self._path = motion.rest(self._clock(), self._aim)

    def _put_back(self, *, ram: bool) -> None:
        for name, value in self._backup.items():
            if (self.table.items[name].address >= tables.EEPROM_END) is ram:
                self.registers.put(name, value)

    @property
    def _offset(self) -> int:
        offset = self.get("Homing Offset")
        invalid = self.get("Operating Mode") == POSITION and abs(offset) > VALID_OFFSET
        return 0 if invalid else offset

    def _shown(self, count: float) -> float:
        """Between the servo's count and the table's, either way: reverse mode (drive mode, bit 0) counts downward."""
        return tables.COUNTS - 1 - count if self.get("Drive Mode") & REVERSE else count

    def _turned(self, velocity: float) -> float:
        return -velocity if self.get("Drive Mode") & REVERSE else velocity

    def _said(self, position: float) -> int:
        """What the table says of a position of the shaft."""
        return round(self._shown(position - self._forgotten)) + self._offset

    def _forget_turns(self) -> None:
        """The count is within one turn from now on, wherever the shaft is."""
        turns = math.floor((self._shaft()[0] + 0.5) / tables.COUNTS)
        self._forgotten = float(turns * tables.COUNTS)

    def _goal_here(self) -> None:
        self.registers.put("Goal Position", self._said(self._shaft()[0]))

    def _checked(self, address: int, data: bytes) -> list[tuple[tables.TableItem, int]]:
        pairs = self.registers.items(address, data)
        for item, value in pairs:
            self._check(item, value)
        return pairs

    def _check(self, item: tables.TableItem, value: int) -> None:
        """Raise `Refused` where a value may not be written now."""
        name, mode = item.name, self.get("Operating Mode")
        low, high = self.table.ranges.get(name, (-(1 << 31), 1 << 32))
        if name in PROFILE and self.get("Drive Mode") & TIME_BASED:
            high = tables.LONGEST_MS
        limit = dict(LIMITED).get(name)
        bounded = name == "Goal Position" and mode == POSITION
        for refused, error in (
            (item.address < tables.EEPROM_END and self.torque, p2.ACCESS_ERROR),
            (name == "Operating Mode" and value not in self.table.modes, p2.RANGE_ERROR),
            (name == "Drive Mode" and value & ~self.table.drive_bits, p2.RANGE_ERROR),
            (not low <= value <= high, p2.RANGE_ERROR),
            (bounded and not self.get("Min Position Limit") <= value <= self.get("Max Position Limit"), p2.LIMIT_ERROR),
            (limit is not None and abs(value) > self.get(limit), p2.LIMIT_ERROR),
            # goals are read-only until the watchdog is cleared
            (name in GOALS.values() and self.get("Bus Watchdog") == -1, p2.RANGE_ERROR),
            (name == "Torque Enable" and value == 1 and self._shut_down(), p2.RESULT_FAIL),
        ):
            if refused:
                raise tables.Refused(error)

    def _set(self, name: str, value: int) -> None:
        before = self.get(name)
        if name == "Bus Watchdog" and value != 0 and before == -1:
            return  # only 0 clears its error
        self.registers.put(name, value)
        if name == "Torque Enable" and value != before:
            if value:
                self._hold()
                self._drive()
            else:
                self._release()
        elif name == GOALS[self.get("Operating Mode")]:
            if not self.torque and self.get("Drive Mode") & TORQUE_BY_GOAL and not self._shut_down():
                self._hold()
            if self.torque:
                self._drive()
        elif name == "Operating Mode" and value != before:
            self._change_mode(value)
        elif name == "Drive Mode":
            self._goal_here()

    def _hold(self) -> None:
        """Torque on; in Position mode the count comes back within one turn."""
        self.registers.put("Torque Enable", 1)
        if self.get("Operating Mode") == POSITION:
            self._forget_turns()

    def _change_mode(self, mode: int) -> None:
        """Another mode takes its own gains; profile and goals are those of the start."""
        for name in GAINS + PROFILE:
            self.registers.put(name, self.table.factory.get(name, 0))
        self._goals_at_limits()
        self._profile_type = STEP
        if mode in (POSITION, EXTENDED):
            self._forget_turns()
        self._goal_here()

    # ---- shaft ----

    def _top(self) -> float:
        """How fast the motor turns at all [counts/s]: its speed without load, in proportion to the PWM it may have."""
        return self.table.factory["Velocity Limit"] * tables.RPM * abs(self.get("Goal PWM")) / tables.FULL_PWM

    def _limits(self, way: float = 0.0) -> tuple[float, float]:
        """Speed and acceleration of the profile; a time-based one (drive mode, bit 2) depends on the way."""
        time_based, mode = self.get("Drive Mode") & TIME_BASED, self.get("Operating Mode")
        fastest = self._top()
        if mode in POSITION_MODES and self.get("Profile Velocity") == 0:  # no profile
            return fastest, NO_LOAD
        whole, rise = self.get("Profile Velocity") / 1000, self.get("Profile Acceleration") / 1000
        if time_based and mode == VELOCITY:
            return fastest, abs(self.get("Goal Velocity")) * tables.RPM / rise if rise > 0 else NO_LOAD
        if time_based and way != 0:
            rise = min(rise, whole / 2)
            speed = abs(way) / (whole - rise)
            return speed, speed / rise if rise > 0 else NO_LOAD
        acceleration = self.get("Profile Acceleration") * tables.RPM2 or NO_LOAD
        return min(self.get("Profile Velocity") * tables.RPM, fastest), acceleration

    def _drive(self) -> None:
        """Make for what the goal registers say."""
        if self.get("Drive Mode") & FOLLOWER:  # another servo's cable drives the motor, which is not there
            return
        self.leaving()
        now = self._clock()
        position, velocity = self._path.at(now)
        mode = self.get("Operating Mode")
        if mode in POSITION_MODES:
            self._go_to(self._forgotten + self._shown(float(self.get("Goal Position") - self._offset)))
            return
        if mode == VELOCITY:
            wanted, acceleration = self.get("Goal Velocity") * tables.RPM, max(1.0, self._limits()[1])
            self._profile_type = TRAPEZOIDAL if self.get("Profile Acceleration") else STEP
        elif mode == PWM:
            wanted, acceleration = math.copysign(self._top(), self.get("Goal PWM")), NO_LOAD
        else:  # a current that nothing works against
            current = self.get("Goal Current")
            wanted = math.copysign(self._top(), current) if current else 0.0
            acceleration = NO_LOAD * abs(current) / self.table.factory["Current Limit"] or NO_LOAD
        self._path = motion.to_speed(now, position, velocity, self._turned(wanted), acceleration)

    def _go_to(self, goal: float) -> None:
        now = self._clock()
        position, velocity = self._path.at(now)
        speed, acceleration = self._limits(goal - position)
        self._aim = goal
        short = self.mechanics.short_counts if self.get("Position I Gain") == 0 else 0.0
        if speed <= 0 or (abs(goal - position) <= short and velocity == 0):
            self._path = motion.rest(now, position)
        else:
            there = goal - math.copysign(short, goal - position) + self.mechanics.within()
            self._path = motion.to_position(now, position, velocity, there, speed, acceleration)
        self._profile_type = self._shape(speed)

    def _shape(self, speed: float) -> int:
        """Type of the profile to a goal, as the Moving Status names it."""
        if self.get("Profile Velocity") == 0:
            return STEP
        if self.get("Profile Acceleration") == 0:
            return RECTANGULAR
        peak = max(abs(phase.velocity) for phase in self._path.phases)
        return TRAPEZOIDAL if peak > 0.999 * speed else TRIANGULAR  # rounding of the ways of single phases

    def _release(self) -> None:
        self._path = motion.rest(self._clock(), self._shaft()[0])
        self._put(Torque_Enable=0)

    # ---- health ----

    def _shut_down(self) -> bool:
        return bool(self.get("Hardware Error Status") & self.get("Shutdown"))

    def _look(self) -> None:
        """Bring the hardware-error byte up to date."""
        now = self._clock()
        error = self.get("Hardware Error Status") | self.damage
        if self.temperature_c > self.get("Temperature Limit"):
            error |= OVERHEATING
        lowest, highest = (self.get(name) for name in VOLTAGES)
        if not lowest <= self.supply_dv <= highest:
            error |= VOLTAGE
        if self._pushes():
            self._stalled_since = now if self._stalled_since is None else self._stalled_since
            if now - self._stalled_since > STALL_TO_OVERLOAD_S:
                error |= OVERLOAD
        else:
            self._stalled_since = None
        self.registers.put("Hardware Error Status", error)
        if self.torque and self._shut_down():
            self._release()

    def _pushes(self) -> bool:
        """Against what blocks it."""
        if self._blocked_at is None or not self.torque:
            return False
        return abs(self._path.at(self._clock())[0] - self._blocked_at) > max(10.0, self.mechanics.short_counts)

    def _refresh(self) -> None:
        """Write what is measured into the table."""
        self._look()
        now = self._clock()
        position, velocity = self._shaft()
        planned, planned_velocity = self._path.at(now)
        self._looks += 1  # by the golden angle: readings in a row never happen to agree
        flicker = self.mechanics.noise_counts * math.sin(GOLDEN_ANGLE * self._looks) if velocity == 0 else 0.0
        units = round(self._turned(velocity) / tables.RPM)
        in_position_mode, ended = self.get("Operating Mode") in POSITION_MODES, now >= self._path.end_s
        profiled = in_position_mode and not ended and self._profile_type != STEP
        state = self._profile_type | (UNDER_WAY if profiled else 0)
        if in_position_mode:
            state |= FOLLOWING_ERROR if self._pushes() else 0
            state |= IN_POSITION if ended and abs(position - self._aim) < IN_POSITION_COUNTS else 0
        arrived = in_position_mode and ended and self.torque
        hot = self._suffering("hot")
        effort = self._effort(position, units)
        self._put(
            Present_Position=self._said(position + flicker),
            Present_Velocity=units,
            Moving=int(abs(units) > self.get("Moving Threshold") or profiled),
            Moving_Status=state,
            Velocity_Trajectory=round(self._turned(planned_velocity) / tables.RPM),
            Position_Trajectory=self._said(self._aim if arrived else planned),
            Present_Input_Voltage=self._supply_dv(),
            Present_Temperature=self.get("Temperature Limit") - 10 if hot else self.temperature_c,
            Realtime_Tick=int((now - self._booted_s) * 1000) % 32768,
            Present_PWM=self.get("Goal PWM") if self._drives(PWM) else round(effort / 2),
        )
        self.registers.put("Present Current" if "Present Current" in self.table.items else "Present Load", effort)
        for port in range(1, 4):
            if f"External Port Data {port}" in self.table.items and self.get(f"External Port Mode {port}") == PULL_DOWN:
                closed = port in self.contacts and not self._suffering("estop")
                self.registers.put(f"External Port Data {port}", int(closed))

    def _drives(self, mode: int) -> bool:
        """Whether the motor has torque, in a mode."""
        return self.torque and self.get("Operating Mode") == mode

    def _effort(self, position: float, units: int) -> int:
        """Current or load, at a position and a velocity in units of the table."""
        if self._drives(CURRENT):
            return self.get("Goal Current")
        error = self._turned(self._aim - position)
        if self._pushes():
            full = self.get("Goal Current") if "Goal Current" in self.table.items else 1000
            return int(math.copysign(full, error))
        return round(20 * math.tanh(error / 20)) + units // 8 if self.torque else 0


def _kept(item: tables.TableItem) -> bool:
    """Whether a backup holds it."""
    if item.address < tables.EEPROM_END:
        return item.writable
    return item.name in GAINS + PROFILE or item.name.startswith("Indirect Address")
