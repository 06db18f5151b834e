"""The BRDF so far, while a run is measured: each step is reduced once, when its frames are on the disk.

It is provisional. The level of the reference is known up to its last visit alone; uncertainties are those of frames,
reference and lamp. What the angles' errors, lobes narrower than the cones and the bandwidth do is left to `gonio
reduce`.
"""

import math
from array import array
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gonio.errors import GonioError
from gonio.geometry import Directions
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.reduction.growing import of_rates
from gonio.lab.reduction.step_rates import Reduced
from gonio.lab.rig.light_and_camera import Band
from gonio.typing import Floats, NDArray

COLUMNS = 8
SPARE = 0.5
"""Margin, as a share, around the pixels in use, in which the dark signal is kept for later poses."""


@dataclass(frozen=True, slots=True)
class ProvisionalValues:
    """What is known of a band; arrays run over the points in the order of their steps."""

    band: Band
    steps: list[int]
    points: NDArray[np.int_]
    directions: Directions
    brdf: Floats
    """1/sr."""
    u: Floats
    """Standard uncertainty [1/sr] of what is counted here."""
    visits: list[tuple[int, float, float]]
    """For each visit to the reference: its step, its level over that of the first, standard uncertainty of that."""


class _Band:
    """What is kept of a band's steps: of points, which are many, plain numbers."""

    def __init__(self) -> None:
        self.visits: dict[int, Reduced] = {}
        """By their steps."""
        self.rows: dict[int, int] = {}
        """Where the numbers of a point stand, by its step."""
        self.numbers = array("d")
        """For each point: its number in the plan, rate, variance, time and the four angles [rad]."""

    def add(self, step: int, found: Reduced) -> None:
        if found.point is None:
            self.visits[step] = found
            return
        at = found.directions
        angles = (float(a) for a in (at.theta_i, at.phi_i, at.theta_r, at.phi_r))
        self.rows[step] = len(self.numbers) // COLUMNS
        self.numbers.extend((found.point, found.rate, found.variance, found.time_s, *angles))

    def drop(self, step: int) -> None:
        self.visits.pop(step, None)
        self.rows.pop(step, None)


class Provisional:
    """The steps of a run, reduced as they come."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self._dark: list[StepRecord] = []
        self._around: list[StepRecord] = []
        """Steps that show how far over the sensor the others look."""
        self._frames: RunFrames | None = None
        self._bands = [_Band() for _ in run.bands]

    def add(self, step: StepRecord) -> None:
        """One more step; raises `GonioError` where its frames cannot be reduced."""
        if step.kind == "dark":
            self._dark.append(step)
            return
        if step.flag or not self._dark:
            return
        if self._frames is None or not self._frames.knows(step):
            self._around.append(step)
            self._frames = RunFrames(self.run, [*self._dark, *self._around], SPARE)
        for kept, one in zip(self._bands, [self._frames.reduce(step, band) for band in self.run.bands], strict=True):
            kept.drop(step.step)
            if isinstance(one, Reduced):
                kept.add(step.step, one)

    def drop(self, steps: Iterable[int]) -> None:
        """Steps count no more."""
        for number in steps:
            for kept in self._bands:
                kept.drop(number)

    def values(self) -> list[ProvisionalValues]:
        """What is known by now, a band each; none before the first visit to the reference."""
        if self._frames is None:
            return []
        out = []
        for band, kept in zip(self.run.bands, self._bands, strict=True):
            visited = sorted(kept.visits.items(), key=lambda pair: pair[1].time_s)
            visits = [visit for _, visit in sorted(visited)]
            if not visits:
                continue
            steps = sorted(kept.rows)
            numbers = np.array(kept.numbers).reshape(-1, COLUMNS)[[kept.rows[step] for step in steps]]
            point, rate, variance, time_s, *angles = numbers.reshape(-1, COLUMNS).T
            try:
                known = of_rates(self._frames.run, rate, time_s, Directions(*angles), visits, band)
            except GonioError:  # a visit without light, say: `gonio reduce` says it
                continue
            shared = sum((by**2 for by in known.common.values()), known.u_visits**2)
            out.append(
                ProvisionalValues(
                    band,
                    steps,
                    point.astype(int),
                    known.directions,
                    known.brdf,
                    np.sqrt(variance / known.level**2 + shared),
                    [(number, *_over(visit, visited[0][1])) for number, visit in visited],
                )
            )
        return out


def _over(visit: Reduced, first: Reduced) -> tuple[float, float]:
    """The level of a visit over that of the first one, and the standard uncertainty of that."""
    ratio = visit.rate / first.rate
    own = math.sqrt(visit.variance) / abs(visit.rate)
    u = 0.0 if visit is first else abs(ratio) * math.hypot(own, math.sqrt(first.variance) / abs(first.rate))
    return ratio, u
