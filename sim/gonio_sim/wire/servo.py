"""A Dynamixel servo of the X series: its rules, its shaft, its health.

Written from the e-Manual, from the device's side. Motion and health run on the twin's clock; the return delay and
the bus watchdog, which belong to the wire, run on wall time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from gonio_sim.wire import motion, tables
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.peer import Clock
from gonio_sim.wire.registers import Refused, Registers

NO_LOAD = 1.0e6
"""Acceleration where no profile limits it [counts/s^2]."""
STALL_TO_OVERLOAD_S = 2.0
BOOT_S = 0.5
WATCHDOG_UNIT_S = 0.020
POSITION_MODES = (3, 4, 5)
LIMITED = (("Goal Velocity", "Velocity Limit"), ("Goal Current", "Current Limit"), ("Goal PWM", "PWM Limit"))

VOLTAGE, OVERHEATING, OVERLOAD = 0x01, 0x04, 0x20
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
        self.registers = Registers(self.table)
        self.registers.put("ID", identity)
        self.registers.put("Baud Rate", {rate: code for code, rate in tables.BAUD_CODES.items()}[baud])
        self._path = motion.rest(clock(), position)
        self._aim = position
        self._registered: tuple[int, bytes] | None = None
        self._blocked_at: float | None = None
        self._stalled_since: float | None = None
        self._back_at: float | None = None
        self._heard_s = time.monotonic()
        self.leaving: Callable[[], None] = lambda: None
        """Called before the shaft sets out for a new goal: what hangs on it has followed until now."""
        self.powered = True
        self.temperature_c = AMBIENT_C
        self.contacts: set[int] = set()
        """External ports at which a contact is closed."""
        self._suffers: dict[str, float] = {}
        """Until when it suffers from what [s]."""
        self.supply_dv = self.table.supply_dv
        self._power_up()

    # ---- what the bench sees and does ----

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
        """Position [counts] and velocity [counts/s] of the shaft, now."""
        self._watch(time.monotonic())
        if self._blocked_at is not None:
            return self._blocked_at, 0.0
        return self._path.at(self._clock())

    def moves(self) -> bool:
        """Whether the shaft turns now, or would turn if nothing blocked it."""
        self._watch(time.monotonic())
        return self._clock() < self._path.end_s or abs(self._path.at(self._clock())[1]) > 0

    def block(self) -> None:
        """Something holds the shaft from now on."""
        self._blocked_at = self.shaft()[0]

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

    def _heat_c(self) -> int:
        return self.get("Temperature Limit") - 10 if self._suffering("hot") else self.temperature_c

    def _supply_dv(self) -> int:
        return self.get("Min Voltage Limit") + 5 if self._suffering("sag") else self.supply_dv

    def lose_power(self) -> None:
        """Drop out of the bus."""
        self._release()
        self.powered = False

    def restart(self) -> None:
        """Boot: RAM falls back to its defaults, torque is off, and nothing answers for half a second."""
        self._release()
        self._power_up()
        self._back_at = self._clock() + BOOT_S

    def get(self, name: str) -> int:
        """The value of an item, as its owner means it (signed where it is)."""
        return self.registers.get(name)

    # ---- instructions ----

    def ping(self) -> bytes:
        """Model number and firmware version, as a ping returns them."""
        return self.registers.identity()

    @property
    def error(self) -> int:
        """The error byte of a good status packet: the alert bit while a hardware error stands."""
        self._look()
        return p2.ALERT if self.get("Hardware Error Status") else 0

    def read(self, address: int, length: int) -> bytes:
        """Bytes of the control table."""
        self._refresh()
        return self.registers.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Change the control table, all of it or (with `Refused`) nothing."""
        pairs = self.registers.items(self.registers.follow(address, data), data)
        for item, value in pairs:
            self._check(item, value)
        for item, value in pairs:
            self._set(item.name, value)

    def register(self, address: int, data: bytes) -> None:
        """Keep a write for `action`."""
        for item, value in self.registers.items(address, data):
            self._check(item, value)
        self._registered = (address, data)
        self.registers.put("Registered Instruction", 1)

    def action(self) -> None:
        """Carry out what was registered."""
        if self._registered is None:
            raise Refused(p2.INSTRUCTION_ERROR)
        address, data = self._registered
        self._registered = None
        self.registers.put("Registered Instruction", 0)
        self.write(address, data)

    def reset(self, option: int) -> None:
        """Factory values: 0xFF all, 0x01 all except ID, 0x02 all except ID and baud rate."""
        if option not in (0xFF, 0x01, 0x02):
            raise Refused(p2.RANGE_ERROR)
        if self.torque:
            raise Refused(p2.RESULT_FAIL)
        keep = {0xFF: (), 0x01: ("ID",), 0x02: ("ID", "Baud Rate")}[option]
        kept = {name: self.get(name) for name in keep}
        for name, item in self.table.items.items():
            if item.writable:
                self.registers.put(name, kept.get(name, self.table.factory.get(name, 0)))
        self.restart()

    def clear_turns(self) -> None:
        """Forget whole turns; only at rest."""
        position, velocity = self.shaft()
        if velocity != 0:
            raise Refused(p2.RESULT_FAIL)
        self._path = motion.rest(self._clock(), position % tables.COUNTS)
        self._aim = position % tables.COUNTS

    def heard(self, wall_s: float) -> None:
        """Called for every instruction packet on the bus, for whomever it is: silence is counted from there."""
        self._watch(wall_s)
        self._heard_s = wall_s

    def _watch(self, wall_s: float) -> None:
        """The bus watchdog: after a silence, in wall time, the shaft has stopped at once, and its goal is there."""
        timeout_s = self.get("Bus Watchdog") * WATCHDOG_UNIT_S
        if timeout_s > 0 and self.torque and wall_s - self._heard_s > timeout_s:
            self.registers.put("Bus Watchdog", -1)
            now = self._clock.at(self._heard_s + timeout_s)
            position = self._path.at(now)[0] if self._blocked_at is None else self._blocked_at
            self._path = motion.rest(now, position)
            self._aim = position
            self.registers.put("Goal Position", round(self._shown(position)) + self._offset)

    # ---- memory ----

    def _power_up(self) -> None:
        for name, item in self.table.items.items():
            if item.address >= tables.EEPROM_END and item.writable:
                self.registers.put(name, self.table.factory.get(name, 0))
        for goal, limit in LIMITED:
            if goal in self.table.items and limit in self.table.items:
                self.registers.put(goal, self.get(limit))
        self.registers.put("Hardware Error Status", 0)
        self.registers.put("Registered Instruction", 0)
        self._registered = None
        self._stalled_since = None
        position = self.shaft()[0] % tables.COUNTS  # whole turns are forgotten
        self._path = motion.rest(self._clock(), position)
        self._aim = position
        self.registers.put("Goal Position", round(self._shown(position)) + self._offset)

    @property
    def _offset(self) -> int:
        offset = self.get("Homing Offset")
        return max(-1024, min(1024, offset)) if self.get("Operating Mode") == 3 else offset

    def _shown(self, count: float) -> float:
        """Between the shaft's count and the table's, either way: reverse mode (drive mode, bit 0) counts downward."""
        return tables.COUNTS - 1 - count if self.get("Drive Mode") & 1 else count

    def _turned(self, velocity: float) -> float:
        return -velocity if self.get("Drive Mode") & 1 else velocity

    def _check(self, item: tables.Item, value: int) -> None:
        name = item.name
        if item.address < tables.EEPROM_END and self.torque:
            raise Refused(p2.ACCESS_ERROR)
        low, high = tables.RANGES.get(name, (-(1 << 31), 1 << 32))
        if name == "Current Limit":
            high = self.table.factory.get(name, high)
        if name in VOLTAGES:
            low, high = (self.table.factory[limit] for limit in VOLTAGES)
        if name == "Operating Mode" and value not in tables.MODES:
            raise Refused(p2.RANGE_ERROR)
        if not low <= value <= high:
            raise Refused(p2.RANGE_ERROR)
        limits = self.get("Min Position Limit"), self.get("Max Position Limit")
        if name == "Goal Position" and self.get("Operating Mode") == 3 and not limits[0] <= value <= limits[1]:
            raise Refused(p2.LIMIT_ERROR)
        for goal, limit in LIMITED:
            if name == goal and abs(value) > self.get(limit):
                raise Refused(p2.LIMIT_ERROR)
        if name in ("Goal Position", "Goal Velocity", "Goal Current", "Goal PWM") and self.get("Bus Watchdog") == -1:
            raise Refused(p2.RANGE_ERROR)  # read-only until the watchdog is cleared
        if name == "Torque Enable" and value == 1 and self._shut_down():
            raise Refused(p2.RESULT_FAIL)

    def _set(self, name: str, value: int) -> None:
        before = self.torque
        if name == "Bus Watchdog" and value != 0 and self.get(name) == -1:
            return  # only 0 clears its error
        self.registers.put(name, value)
        if name == "Torque Enable" and bool(value) != before:
            if value:
                self._drive()
            else:
                self._release()
        elif name in ("Goal Position", "Goal Velocity") and self.torque:
            self._drive()
        elif name in ("Operating Mode", "Drive Mode"):
            self.registers.put("Goal Position", round(self._shown(self.shaft()[0])) + self._offset)

    # ---- shaft ----

    def _limits(self, way: float = 0.0) -> tuple[float, float]:
        """Speed and acceleration of the profile; a time-based one (drive mode, bit 2) depends on the way."""
        whole, rise = self.get("Profile Velocity") / 1000, self.get("Profile Acceleration") / 1000
        if self.get("Drive Mode") & 4 and whole > 0 and way != 0:
            rise = min(rise, whole / 2)
            speed = abs(way) / (whole - rise)
            return speed, speed / rise if rise > 0 else NO_LOAD
        fastest = self.get("Velocity Limit") * tables.RPM
        speed = self.get("Profile Velocity") * tables.RPM or fastest
        acceleration = self.get("Profile Acceleration") * tables.RPM2 or NO_LOAD
        return min(speed, fastest), acceleration

    def _drive(self) -> None:
        """Make for what the goal registers say."""
        self.leaving()
        now = self._clock()
        position, velocity = self._path.at(now)
        mode = self.get("Operating Mode")
        goal = self._shown(float(self.get("Goal Position") - self._offset))
        speed, acceleration = self._limits(goal - position)
        if mode in POSITION_MODES:
            self._aim = goal
            short = self.mechanics.short_counts if self.get("Position I Gain") == 0 else 0.0
            if abs(goal - position) <= short and velocity == 0:
                self._path = motion.rest(now, position)
            else:
                there = goal - math.copysign(short, goal - position) + self.mechanics.within()
                self._path = motion.to_position(now, position, velocity, there, speed, acceleration)
        elif mode == 1:
            wanted = self._turned(self.get("Goal Velocity") * tables.RPM)
            self._path = motion.to_speed(now, position, velocity, wanted, acceleration)

    def _halt(self) -> None:
        position, _ = self.shaft()
        self._path = motion.rest(self._clock(), position)

    def _release(self) -> None:
        self._halt()
        self.registers.put("Torque Enable", 0)

    # ---- health ----

    def _shut_down(self) -> bool:
        return bool(self.get("Hardware Error Status") & self.get("Shutdown"))

    def _look(self) -> None:
        """Bring the hardware-error byte up to date."""
        now = self._clock()
        error = self.get("Hardware Error Status")
        if self.temperature_c > self.get("Temperature Limit"):
            error |= OVERHEATING
        if not self.get("Min Voltage Limit") <= self.supply_dv <= self.get("Max Voltage Limit"):
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
        position, velocity = self.shaft()
        planned, planned_velocity = self._path.at(now)
        flicker = self.mechanics.noise_counts * math.sin(1e3 * now) if velocity == 0 else 0.0
        units = round(self._turned(velocity) / tables.RPM)
        self.registers.put("Present Position", round(self._shown(position + flicker)) + self._offset)
        self.registers.put("Present Velocity", units)
        self.registers.put("Moving", int(abs(units) > self.get("Moving Threshold")))
        underway = now < self._path.end_s
        arrived = not underway and abs(position - self._aim) < 20
        self.registers.put("Moving Status", int(arrived) | int(underway) << 1 | 0x30)
        self.registers.put("Velocity Trajectory", round(self._turned(planned_velocity) / tables.RPM))
        self.registers.put("Position Trajectory", round(self._shown(planned)) + self._offset)
        self.registers.put("Present Input Voltage", self._supply_dv())
        self.registers.put("Present Temperature", self._heat_c())
        for port in range(1, 4):
            if f"External Port Data {port}" in self.table.items and self.get(f"External Port Mode {port}") == PULL_DOWN:
                closed = port in self.contacts and not self._suffering("estop")
                self.registers.put(f"External Port Data {port}", int(closed))
        self.registers.put("Realtime Tick", int(now * 1000) % 32768)
        load = "Present Current" if "Present Current" in self.table.items else "Present Load"
        effort = 0
        if self.torque:
            full = self.get("Goal Current") if "Goal Current" in self.table.items else 1000
            error = self._turned(self._aim - position)
            light = round(20 * math.tanh(error / 20)) + units // 8
            effort = int(math.copysign(full, error)) if self._pushes() else light
        self.registers.put(load, effort)
        self.registers.put("Present PWM", round(effort / 2))
