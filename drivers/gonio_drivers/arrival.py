"""Has an axis landed? What the reports of a joint say while it is on its way to a goal."""

from __future__ import annotations

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
STALL_S = 0.5
"""An axis that has neither moved nor landed for this long is stuck."""
STARTING_S = 0.06
"""A servo has begun to follow a new goal by then."""
CORRECTIONS = 4
LARGEST_CORRECTION_DEG = 2.0


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
    under_way: float = 0.0
    """When its profile was last seen to go on; a slow one moves by less than an encoder's flicker between two looks."""
    seen: list[int] = field(default_factory=list)
    """Positions since it was last seen to move."""
    done: bool = False

    def look(self, report: Report, now: float) -> Verdict:
        """Take a report into account; "short" asks for a correction."""
        if not self.seen or abs(report.position - self.seen[0]) > STILL_COUNTS or report.moving:
            self.begin(now)
        if report.under_way:
            self.under_way = now
        self.seen.append(report.position)
        error = self.joint.distance_deg(self.goal, self.position)
        rested = now - max(self.since, self.under_way)
        set_out_s, running_s = self._visible()
        if not report.moving and not report.under_way and rested >= max(running_s, self.settle_s):
            if error <= self.within_deg:
                return "landed"
            small = error + self.joint.distance_deg(self.goal, self.sent) <= LARGEST_CORRECTION_DEG
            if small and self.corrections < CORRECTIONS and rested > set_out_s:  # it has had time to set out
                return "short"
        return "stuck" if now - self.since > STALL_S else "on its way"

    def begin(self, now: float) -> None:
        """Nothing has been seen yet of the way that begins now."""
        self.seen, self.since = [], now

    @property
    def position(self) -> float:
        """Where it stands: the mean of the last readings [counts]."""
        return statistics.fmean(self.seen[-AVERAGED:])

    def _visible(self) -> tuple[float, float]:
        """How long a motion takes to show beyond the encoder's flicker [s]: from rest, and at full speed."""
        per_deg, counts = abs(self.joint.counts_per_deg), STILL_COUNTS + 1
        running_s = counts / (self.joint.speed_deg_per_s * per_deg)
        rising_s = math.sqrt(2 * counts / (self.acceleration_deg_per_s2 * per_deg))
        return STARTING_S + rising_s + running_s, running_s
