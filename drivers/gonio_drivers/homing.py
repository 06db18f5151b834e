"""Finding the turn of an axis that counts turns: against a stop, at a switch, or over a mark.

Homing decides about whole turns of the servo and about nothing finer: within a turn the servo's own encoder is
absolute, and repeats far better than a stop or a switch does. So the place is looked for several times; its spread and
its distance from where the rig file has it are reported; and what is further off than a quarter of a servo's turn is
refused as ambiguous. While the angle is not known the soft limits cannot be kept; the axis goes slowly, and no further
than the range between its hard stops (or limits).
"""

import contextlib
import statistics
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import serial

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Homed, clock
from gonio_drivers import home_mark, joints, preparation, settings, watchdog
from gonio_drivers.patience import Patience

POLL_S = 0.01
STALLED_S, STALLED_LOOKS = 0.3, 10
"""Time, and looks, without a movement after which an axis that is told to go stands against something."""
STILL_COUNTS = 4
BACK_OFF_DEG = 3.0
ACCELERATION_DEG_S2 = 180.0
TURN_MARGIN = 0.25
"""Part of a servo's turn: what is found further from where it should be could as well be another turn."""
INPUT_MODE = 3
"""Mode of an external port: digital input, pulled up (ROBOTIS e-Manual, "External Port")."""
OVERSHOOT = 1.1


@dataclass(slots=True)
class Search:
    """One axis on its way to its place of homing."""

    joint: joints.Joint
    homing: settings.Homing
    closed: Callable[[], bool]
    allowed: Callable[[], None]
    """Raises where nothing may move."""
    _goal: int = 0

    def run(self) -> Homed:
        """Find the place as often as asked, and leave the mark in the servo.

        Raises
        ------
        DeviceError
            The place is not found, or found too far apart; the axis has been stopped, and is not homed.
        """
        joint, homing = self.joint, self.homing
        watchdog.arm([joint])
        try:
            places = [self._place() for _ in range(homing.repeats)]
            self._go(-homing.toward, lambda count, moved: abs(moved) >= BACK_OFF_DEG)  # off the stop or the switch
        finally:
            self._halt()
            watchdog.call_off([joint])
        spread = (max(places) - min(places)) / abs(joint.counts_per_deg)
        if spread > homing.spread_deg:
            found = ", ".join(f"{(p - places[0]) / joint.counts_per_deg:.2f}" for p in places)
            raise DeviceError(
                f"axis {joint.name}: its place of homing was found {spread:.2f} deg apart ({found} deg), more than "
                f"{joint.key}.homing.spread_deg = {homing.spread_deg:g}; is the stop or the switch loose?"
            )
        at = home_mark.at_deg(joint, homing)
        assert at is not None
        joint.turns = 0
        off = statistics.fmean(places) - joint.to_count(at)
        turns = round(off / joints.COUNTS)
        rest = off - turns * joints.COUNTS
        if abs(rest) > TURN_MARGIN * joints.COUNTS:
            raise DeviceError(
                f"axis {joint.name}: its place of homing lies {abs(rest) / abs(joint.counts_per_deg):.1f} deg off "
                f"{at:g} deg, more than a quarter of a turn of its servo: the turn is not certain; correct "
                f"{joint.key}.homing.at_deg, zero_count or zero_offset_deg"
            )
        home_mark.leave(joint, turns)
        return Homed(at_deg=at, spread_deg=spread, off_deg=rest / joint.counts_per_deg, found=len(places))

    def _place(self) -> float:
        """Where the place is, found once [counts]; begins clear of it."""
        homing = self.homing
        if homing.how == "stall":
            self._go(-homing.toward, lambda count, moved: abs(moved) >= BACK_OFF_DEG)
            return self._against(homing.toward)
        if self.closed():
            self._go(-homing.toward, lambda count, moved: not self.closed())
            self._go(-homing.toward, lambda count, moved: abs(moved) >= BACK_OFF_DEG)
        first = self._go(homing.toward, lambda count, moved: self.closed())
        if homing.how == "switch":
            return first
        self._go(homing.toward, lambda count, moved: not self.closed())
        self._go(homing.toward, lambda count, moved: abs(moved) >= BACK_OFF_DEG / 2)
        return (first + self._go(-homing.toward, lambda count, moved: self.closed())) / 2

    def _against(self, way: int) -> float:
        """Go until the axis stands against something; returns the place [counts]."""
        still = _Still()
        return self._go(way, lambda count, moved: still.against(count) and not self._sent_on(still))

    def _go(self, way: int, there: Callable[[int, float], bool]) -> float:
        """Go slowly until `there` of the count and of the way so far [deg] is true; stop; returns the place [counts].

        The place is in the middle between the last look before and the first look after.
        """
        joint = self.joint
        low, high = joint.hard_stops_deg or joint.limits_deg
        travel = OVERSHOOT * (high - low) + 2 * BACK_OFF_DEG
        last = start = self._look()
        if there(start, 0.0):
            return start
        goal = start + round(way * travel * joint.counts_per_deg)
        self._goal = max(joint.count_limits[0], min(joint.count_limits[1], goal))
        joint.write("Goal Position", self._goal)
        still, looked = _Still(), Patience()
        while looked() < 1.5 * travel / joint.speed_deg_per_s + 5.0:
            clock.sleep(POLL_S)
            self.allowed()
            here = self._look()
            if there(here, (here - start) / joint.counts_per_deg):
                self._halt()
                return (last + here) / 2
            if still.against(here) and not self._sent_on(still):  # at its goal, or against something
                break
            last = here
        self._halt()
        what = "stop" if self.homing.how == "stall" else "switch"
        moved = abs(self._look() - start) / abs(joint.counts_per_deg)
        raise DeviceError(
            f"axis {joint.name}: no {what} was found in {moved:.1f} deg of travel toward "
            f"{'positive' if way > 0 else 'negative'} angles; the axis is stopped and not homed"
            + ("; it does not move at all: is it jammed, or `current` too small?" if moved < BACK_OFF_DEG else "")
        )

    def _sent_on(self, still: "_Still") -> bool:
        """Whether the servo had stopped by its bus watchdog, because this program was held up; it goes on."""
        late = watchdog.send_on(self.joint, self._goal)
        if late:
            still.again()
        return late

    def _look(self) -> int:
        return joints.reports(self.joint.bus, [self.joint])[self.joint.name].position

    def _halt(self) -> None:
        """Stay here."""
        self.joint.write("Goal Position", self._look())


@dataclass(slots=True)
class _Still:
    """For how long an axis has not moved."""

    place: int | None = None
    looks: int = 0
    looked: Patience = field(default_factory=Patience)

    def against(self, count: int) -> bool:
        """Whether one more look tells that it stands against something."""
        if self.place is None or abs(count - self.place) > STILL_COUNTS:
            self.again()
            self.place = count
        self.looks += 1
        return self.looked() >= STALLED_S and self.looks >= STALLED_LOOKS

    def again(self) -> None:
        """It may set out from here."""
        self.place, self.looks, self.looked = None, 0, Patience()


def home(joint: joints.Joint, say: Callable[[str], None], allowed: Callable[[], None]) -> Homed:
    """Home one axis, whose bus is open; it holds where it stands then, with its usual profile.

    `allowed` is called before it turns, and at every look while it does; it raises where nothing may move.

    Raises
    ------
    ConfigError
        The axis has no table `homing`.
    DeviceError
        It could not be homed; it has been stopped, and stays not homed.
    """
    homing = joint.servo.homing
    if homing is None:
        raise ConfigError(
            f"axis {joint.name} needs no homing: it has no table {joint.key}.homing, and its servo keeps to one turn"
        )
    allowed()
    joint.identify()
    preparation.prepare(joint, ACCELERATION_DEG_S2, homed=False)
    usual = joint.profile, joint.speed_deg_per_s
    with _switch(joint, homing) as closed:
        preparation.set_profile(joint, min(homing.speed_deg_per_s, joint.speed_deg_per_s), ACCELERATION_DEG_S2)
        joint.send_profile()
        if homing.current is not None and homing.how == "stall":
            joint.write("Goal Current", min(homing.current, joint.full_current))
        say(f"axis {joint.name}: looking for its {'stop' if homing.how == 'stall' else 'switch'}")
        try:
            return Search(joint, homing, closed, allowed).run()
        finally:
            joint.profile, joint.speed_deg_per_s = usual
            joint.send_profile()
            if homing.how == "stall":
                joint.write("Goal Current", joint.full_current)


@contextlib.contextmanager
def _switch(joint: joints.Joint, homing: settings.Homing) -> Iterator[Callable[[], bool]]:
    """What says whether the switch is closed."""
    if homing.external_port is not None:
        mode = f"External Port Mode {homing.external_port}"
        if joint.get(mode) != INPUT_MODE:
            joint.write("Torque Enable", 0)  # or its EEPROM is locked
            joint.write(mode, INPUT_MODE)
            joint.write("Torque Enable", 1)
        yield lambda: joint.get(f"External Port Data {homing.external_port}") == homing.closed_reads
    elif homing.line is not None:
        signal = homing.line.signal
        try:
            line = serial.serial_for_url(homing.line.port)
        except (OSError, serial.SerialException) as error:
            raise DeviceError(
                f"{joint.key}.homing.line.port = {homing.line.port!r}: cannot be opened: {error}"
            ) from None
        with line:
            yield lambda: int(getattr(line, signal)) == homing.closed_reads
    else:
        yield lambda: False


def lacking(names: Mapping[str, joints.Joint]) -> list[str]:
    """Those axes that have to be homed before they can move."""
    out = []
    for name, joint in names.items():
        try:
            home_mark.recall(joint)
        except DeviceError:
            out.append(name)
    return out
