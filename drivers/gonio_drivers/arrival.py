"""Has an axis landed? What the reports of a joint say while it is on its way to a goal.

It is judged by readings, and never by the clock alone: on a busy computer there may be few of them in a second. An axis
is at rest where `AVERAGED` readings in a row are the same place. Where the encoder trembles by more than that, the mean
of its latest readings has to be that of its earlier ones; the mean of all is its place, and their scatter says how well
it is known.
"""

import math
import statistics
from dataclasses import dataclass, field
from typing import Literal

from gonio_drivers.joints import Joint, Report

Verdict = Literal["on its way", "landed", "short", "stuck"]

STILL_COUNTS = 3
"""Readings this close are the same place: encoders flicker by a count."""
SMALLEST_COUNTS = 1.5
"""A goal lies between two counts, the shaft stops somewhere in its count, and the encoder flickers."""
AVERAGED = 5
"""Readings at rest that an axis's place is the mean of, and that tell that it is at rest."""
STALL_S, STALL_LOOKS = 0.5, 2 * AVERAGED
"""An axis that has neither moved nor landed for this long, over so many readings, is stuck."""
STARTING_S = 0.06
"""A servo has begun to follow a new goal by then."""
CORRECTIONS = 4
LARGEST_CORRECTION_DEG = 2.0
SURE = 2.0
"""In standard uncertainties of the mean: a place is known where so many lie within the tolerance, or where it lies so
many beyond it."""


@dataclass(slots=True)
class Landing:
    """How far a joint has come on its way; it has landed where it stands still, within a distance of its goal."""

    joint: Joint
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

    def look(self, report: Report, now: float) -> Verdict:
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
