"""How axes come to their goals: from one side, all at once, corrected and watched until every one has landed.

What "landed" means of a single axis is `gonio_drivers.arrival`'s.
"""

import logging
import math
from collections.abc import Callable, Mapping

from gonio.errors import DeviceError
from gonio.rig import clock
from gonio_drivers import joints, settings, watchdog
from gonio_drivers.arrival import SMALLEST_COUNTS, Landing
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint, Report
from gonio_drivers.patience import Patience

log = logging.getLogger("gonio.devices")

POLL_S = 0.020
GRACE_S = 3.0
"""A move may take twice its time, and this: of the time in which this program looks."""
RELEASES = 3
"""A servo that has stopped by itself more often than this, and came no closer to its goal meanwhile, never arrives."""
FRICTION_COUNTS = 12
"""Friction stops a servo this far before its goal. A correction may name a goal so far beyond a limit, that is not
reached: it makes up for what was seen to be missing at rest."""


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
        self, bus: Bus, there: Mapping[str, Joint], servos: settings.Servos, allowed: Callable[[], None]
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

    def _tolerance(self, joint: Joint) -> float:
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

    def _watch(self, joint: Joint, landing: Landing, report: Report, now: float, *, exact: bool) -> None:
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
    def _send_on(joint: Joint, landing: Landing) -> bool:
        """Whether the servo had stopped by its bus watchdog, because this program was held up; it is sent on."""
        late = watchdog.send_on(joint, landing.sent)
        if late:
            log.warning(
                "axis %s: nothing came over the bus for %g s, and the servo stopped; sent on",
                joint.name, watchdog.PERIOD_S,
            )  # fmt: skip
        return late

    @staticmethod
    def _require_progress(joint: Joint, landing: Landing) -> None:
        if landing.released > RELEASES:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has stopped {landing.released} times on one way and came no "
                f"closer to its goal, because nothing came over the bus for {watchdog.PERIOD_S:g} s (is this computer "
                "overloaded?); all axes are stopped"
            )

    def _correct(self, joint: Joint, landing: Landing, now: float, *, exact: bool) -> None:
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
        by_address: dict[int, dict[int, bytes]] = {}
        for name, count in counts.items():
            joint = self._joints[name]
            goal = joint.table["Goal Position"]
            by_address.setdefault(goal.address, {})[joint.id] = goal.encode(count)
        for address, data in by_address.items():
            self._bus.write_all(address, data)

    def _send_again(self, joint: Joint, landing: Landing, now: float) -> None:
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

    def _state(self, name: str, landing: Landing, report: Report) -> str:
        joint = self._joints[name]
        return (
            f"axis {name} (servo id {joint.id}) stands at {joint.to_deg(report.position):.2f} deg instead of "
            f"{joint.to_deg(landing.goal):.2f} deg, current {report.current} of {joint.full_current}"
            f"{', and says that it moves' if report.moving or report.under_way else ''}"
        )
