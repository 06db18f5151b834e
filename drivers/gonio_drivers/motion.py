"""How axes come to their goals: from one side, all at once, corrected and watched until every one has landed.

Whether an axis has landed is judged by readings, and never by the clock alone: on a busy computer there may be few of
them in a second. An axis is at rest where `AVERAGED` readings in a row are the same place. Where the encoder trembles
by more than that, the mean of its latest readings has to be that of its earlier ones; the mean of all is its place, and
their scatter says how well it is known.
"""

import math
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from gonio.errors import DeviceError
from gonio.lab.rig import clock
from gonio_drivers import joints, log, settings, watchdog
from gonio_drivers.dynamixel import Bus
from gonio_drivers.patience import Patience

Verdict = Literal["on its way", "landed", "short", "stuck"]

STILL_COUNTS = 3
"""Readings this close are the same place: encoders flicker by a count."""
SMALLEST_COUNTS = 1.5
"""A goal lies between two counts, the shaft stops somewhere in its count, and the encoder flickers."""
AVERAGED = 5
"""Readings at rest that an axis's place is the mean of, and that tell that it is at rest."""
STALL_S, STALL_LOOKS = 0.5, 2 * AVERAGED
"""Time, and readings, after which an axis that has neither moved nor landed is stuck."""
STARTING_S = 0.06
"""A servo has begun to follow a new goal by then."""
CORRECTIONS = 4
LARGEST_CORRECTION_DEG = 2.0
SURE = 2.0
"""Standard uncertainties of the mean: a place counts as known where as many fit into the tolerance, or where it lies as
many beyond it."""
POLL_S = 0.020
GRACE_S = 3.0
"""A move may take twice its time, and this: of the time in which this program looks."""
RELEASES = 3
"""A servo that has stopped by itself more often than this, and came no closer to its goal meanwhile, never arrives."""
FRICTION_COUNTS = 12
"""Friction stops a servo this far before its goal. A correction may name a goal so far beyond a limit, that is not
reached: it makes up for what was seen to be missing at rest."""


@dataclass(slots=True)
class Landing:
    """How far a joint has come on its way; it has landed where it stands still, within a distance of its goal."""

    joint: joints.Joint
    goal: float
    """Where it shall stand [counts]."""
    sent: int
    """What the servo was told, with the corrections so far."""
    within_deg: float
    settle_s: float
    """For how long it must have stood still."""
    acceleration_deg_per_s2: float
    since: float
    """When it was last seen to move."""
    corrections: int = 0
    resent: int = 0
    released: int = 0
    """How often its servo has stopped by itself since it last came closer to its goal."""
    closest: float = math.inf
    """How close to its goal it has been where its servo stopped by itself [counts]."""
    under_way: float = 0.0
    """When its profile was last seen to go on; a slow one moves by less than an encoder's flicker between two looks."""
    seen: list[int] = field(default_factory=list)
    """Positions since it was last seen at another place."""
    calm: list[tuple[float, int]] = field(default_factory=list)
    """When it was seen where, since it was last seen to move; an encoder that trembles is no motion."""
    done: bool = False

    def look(self, report: joints.Report, now: float) -> Verdict:
        """Take a report into account; "short" asks for a correction."""
        if report.moving:
            self.begin(now)
        elif not self.seen or abs(report.position - self.seen[0]) > STILL_COUNTS:
            self.seen, self.since = [], now
        if report.under_way:
            self.under_way, self.calm = now, []
        self.seen.append(report.position)
        self.calm.append((now, report.position))
        set_out_s, running_s = self._visible()
        wait_s = max(running_s, self.settle_s)
        rested = now - max(self.since, self.under_way)
        steady = len(self.seen) >= AVERAGED and rested >= wait_s
        if not steady:
            rested = now - max(self.calm[0][0], self.under_way)
        if report.moving or report.under_way or not (steady or self._calm(wait_s)):
            return self._stuck(now - self.since, len(self.seen))
        error, u_deg = self.joint.distance_deg(self.goal, self.position), 0.0
        if not steady:
            counts = [count for _, count in self.calm]
            u_deg = statistics.pstdev(counts) / math.sqrt(len(counts)) / abs(self.joint.counts_per_deg)
        if error <= self.within_deg:
            return "landed"
        if u_deg > self.within_deg / SURE and error <= self.within_deg + SURE * u_deg:  # more readings will tell
            return "on its way"
        small = error + self.joint.distance_deg(self.goal, self.sent) <= LARGEST_CORRECTION_DEG
        if small and self.corrections < CORRECTIONS:
            return "short" if rested > set_out_s else "on its way"  # it has had time to set out
        return self._stuck(rested, len(self.seen if steady else self.calm))

    def begin(self, now: float) -> None:
        """Nothing has been seen yet of the way that begins now."""
        self.seen, self.calm, self.since = [], [], now

    def stopped_at(self, count: float, now: float) -> bool:
        """Its servo has stopped by itself, here; whether it had arrived, and nothing is lost by it.

        Otherwise a way begins here. One that has come closer since the last time gets there, if in pieces.
        """
        if self.joint.distance_deg(self.sent, count) <= LARGEST_CORRECTION_DEG:
            return True
        left = abs(count - self.goal)
        self.released = 1 if left < self.closest - STILL_COUNTS else self.released + 1
        self.closest = min(self.closest, left)
        self.begin(now)
        return False

    @property
    def position(self) -> float:
        """Where it stands [counts]: the mean of the last readings; where they tremble, of all since it moved."""
        last = self.seen[-AVERAGED:]
        if len(last) < AVERAGED and len(self.calm) > len(last):
            last = [count for _, count in self.calm]
        return statistics.fmean(last)

    def _calm(self, wait_s: float) -> bool:
        """Whether readings of an encoder that trembles have the same mean now as some time ago.

        The time is that in which the slowest motion shows. Where the means differ, the oldest reading is forgotten.
        """
        early = self.calm[:AVERAGED]
        late = self.calm[-AVERAGED:]
        if late[0][0] - early[-1][0] < wait_s:  # never of fewer than ten, whose halves would overlap
            return False
        if abs(statistics.fmean(c for _, c in late) - statistics.fmean(c for _, c in early)) <= STILL_COUNTS:
            return True
        del self.calm[0]
        return False

    @staticmethod
    def _stuck(rested: float, looks: int) -> Verdict:
        return "stuck" if rested > STALL_S and looks > STALL_LOOKS else "on its way"

    def _visible(self) -> tuple[float, float]:
        """How long a motion takes to show beyond the encoder's flicker [s]: from rest, and at full speed."""
        per_deg, counts = abs(self.joint.counts_per_deg), STILL_COUNTS + 1
        running_s = counts / (self.joint.speed_deg_per_s * per_deg)
        rising_s = math.sqrt(2 * counts / (self.acceleration_deg_per_s2 * per_deg))
        return STARTING_S + rising_s + running_s, running_s


class Motion:
    """Drives the axes of one bus.

    Parameters
    ----------
    bus, there
        The servos, by the names of their axes.
    servos
        Tolerance, settle time, acceleration.
    allowed
        Called at every look while axes move; raises where nothing may move any more.

    Raises
    ------
    DeviceError
        An axis does not land, is stuck, or its servo does not answer; it has to be stopped then.
    """

    def __init__(
        self, bus: Bus, there: Mapping[str, joints.Joint], servos: settings.Servos, allowed: Callable[[], None]
    ) -> None:
        self._bus, self._joints, self._servos, self._allowed = bus, there, servos, allowed

    def approach(self, goals: Mapping[str, float]) -> None:
        """To a point before each goal, where that is needed, and from there to the goals; never beyond a limit."""
        finals = {name: self._joints[name].to_count(angle) for name, angle in goals.items()}
        reports = joints.reports(self._bus, self._joints.values())
        for name, report in reports.items():
            self._joints[name].keep_profile(report.profile)
        starts: dict[str, float] = {}
        ups: dict[str, float] = {}
        for name, final in finals.items():
            joint = self._joints[name]
            position = reports[name].position
            if joint.landed_at == final and joint.distance_deg(final, position) <= self._tolerance(joint):
                continue
            ups[name] = final
            start = joint.approach_start(final)
            beyond = joint.to_deg(position) - joint.to_deg(start)  # above it, of an axis that comes from below
            if math.copysign(beyond, beyond * joint.approach_deg) > self._tolerance(joint) and joint.approach_deg:
                starts[name] = start
        for name in ups:
            self._joints[name].landed_at = self._joints[name].stood_at = None
        moving = [self._joints[name] for name in ups]
        watchdog.arm(moving)
        if starts:
            self._land(starts, exact=False)
        if ups:
            self._land(ups, exact=True)
        if run_out := watchdog.call_off(moving):  # at the very end: an axis that is released may give way a little
            for joint in run_out:
                joint.send_profile()
            self._land(ups, exact=True)
        for name, final in ups.items():
            self._joints[name].landed_at = final

    def _tolerance(self, joint: joints.Joint) -> float:
        """How far from its goal a joint may land [deg]: what the rig file says, but never less than counts allow."""
        return max(self._servos.tolerance_deg, SMALLEST_COUNTS / abs(joint.counts_per_deg))

    def _land(self, goals: Mapping[str, float], *, exact: bool) -> None:
        """Drive to counts, all axes at once, until every one has landed (`exact`) or come to rest close by."""
        looked = Patience()
        before = joints.reports(self._bus, self._joints.values())
        landings = {name: self._landing(name, goal, exact=exact) for name, goal in goals.items()}
        self.send({name: landing.sent for name, landing in landings.items()})
        allowed = max(self.duration_s(name, before[name].position, goal) for name, goal in goals.items())
        while not all(landing.done for landing in landings.values()):
            clock.sleep(POLL_S)
            self._allowed()
            reports = joints.reports(self._bus, self._joints.values())
            now = looked()
            for name, landing in landings.items():
                if not landing.done:
                    self._watch(self._joints[name], landing, reports[name], now, exact=exact)
            if now > 2 * allowed + GRACE_S:
                late = ", ".join(self._state(n, x, reports[n]) for n, x in landings.items() if not x.done)
                raise DeviceError(f"no landing within {now:.1f} s: {late}; all axes are stopped")
        joints.require_torque(self._bus, self._joints.values())  # those that were not named are said to hold too

    def _landing(self, name: str, goal: float, *, exact: bool) -> Landing:
        joint, servos = self._joints[name], self._servos
        within_deg = self._tolerance(joint) if exact else max(self._tolerance(joint), abs(joint.approach_deg) / 2)
        return Landing(
            joint, goal, joint.inside(goal), within_deg, servos.settle_s, servos.acceleration_deg_per_s2, since=0.0
        )

    def _watch(self, joint: joints.Joint, landing: Landing, report: joints.Report, now: float, *, exact: bool) -> None:
        """One look at an axis on its way: has it landed, does it need a correction, is it stuck?"""
        changed = report.profile != joint.profile or report.goal != landing.sent
        if changed and self._send_on(joint, landing):
            if not landing.stopped_at(report.position, now):
                self._require_progress(joint, landing)
                return
            changed = False  # it had arrived: this is a reading as good as any
        else:
            joint.keep_profile(report.profile)
        if changed:
            self._send_again(joint, landing, now)
            return
        verdict = landing.look(report, now)
        if verdict == "landed":
            landing.done = True
        elif verdict == "short":
            self._correct(joint, landing, now, exact=exact)
        elif verdict == "stuck" and self._send_on(joint, landing):
            landing.begin(now)
        elif verdict == "stuck":
            joints.require_torque(self._bus, [joint])
            raise DeviceError(f"{self._state(joint.name, landing, report)}: it is stuck; all axes are stopped")

    @staticmethod
    def _send_on(joint: joints.Joint, landing: Landing) -> bool:
        """Whether the servo had stopped by its bus watchdog, because this program was held up; it is sent on."""
        late = watchdog.send_on(joint, landing.sent)
        if late:
            log.warning(
                "axis %s: nothing came over the bus for %g s, and the servo stopped; sent on",
                joint.name, watchdog.PERIOD_S,
            )  # fmt: skip
        return late

    @staticmethod
    def _require_progress(joint: joints.Joint, landing: Landing) -> None:
        if landing.released > RELEASES:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has stopped {landing.released} times on one way and came no "
                f"closer to its goal, because nothing came over the bus for {watchdog.PERIOD_S:g} s (is this computer "
                "overloaded?); all axes are stopped"
            )

    def _correct(self, joint: joints.Joint, landing: Landing, now: float, *, exact: bool) -> None:
        """A new goal that makes up for what is missing; by the approach again where the axis went too far."""
        landing.corrections += 1
        miss = round(landing.goal - landing.position)
        too_far = miss * joint.counts_per_deg * joint.approach_deg < 0
        wanted, within = landing.sent + miss, joint.inside(landing.sent + miss)
        beyond = max(-FRICTION_COUNTS, min(FRICTION_COUNTS, wanted - within)) if exact else 0
        sent = max(joint.count_limits[0], min(joint.count_limits[1], within + beyond))
        if sent == landing.sent:  # only a goal beyond the limit would bring it closer
            log.info("axis %s: %d counts from its goal, at its limit", joint.name, miss)
            landing.done = not exact or abs(landing.goal - landing.position) <= FRICTION_COUNTS
            return
        landing.sent = sent
        log.info("axis %s: %d counts from its goal, correction %d", joint.name, miss, landing.corrections)
        if exact and too_far:
            self._land({joint.name: joint.approach_start(sent)}, exact=False)
        self.send({joint.name: sent})
        landing.begin(now)

    def send(self, counts: Mapping[str, int]) -> None:
        """Give goals to several servos at the same moment; reports show whether they arrived."""
        goal = self._joints[next(iter(counts))].table["Goal Position"]
        self._bus.write_all(goal.address, {self._joints[n].id: goal.encode(count) for n, count in counts.items()})

    def _send_again(self, joint: joints.Joint, landing: Landing, now: float) -> None:
        """A goal did not arrive (a sync write is not answered); this time with an answer."""
        landing.resent += 1
        if landing.resent > 3:
            raise DeviceError(f"axis {joint.name}: servo id {joint.id} does not keep its goal; all axes are stopped")
        log.warning("axis %s: the goal did not arrive; sent again", joint.name)
        joint.write("Goal Position", landing.sent)
        landing.begin(now)

    def duration_s(self, name: str, position: float, goal: float) -> float:
        """How long a way should take at the axis's speed and acceleration [s]."""
        joint = self._joints[name]
        way = joint.distance_deg(goal, position)
        return way / joint.speed_deg_per_s + 2 * joint.speed_deg_per_s / self._servos.acceleration_deg_per_s2

    def _state(self, name: str, landing: Landing, report: joints.Report) -> str:
        joint = self._joints[name]
        return (
            f"axis {name} (servo id {joint.id}) stands at {joint.to_deg(report.position):.2f} deg instead of "
            f"{joint.to_deg(landing.goal):.2f} deg, current {report.current} of {joint.full_current}"
            f"{', and says that it moves' if report.moving or report.under_way else ''}"
        )
