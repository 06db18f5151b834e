"""The BRDF so far, while a run is measured: each step is reduced once, when its frames are on the disk.

It is provisional. The level of the reference is known up to its last visit alone; uncertainties are those of frames,
reference and lamp. What the angles' errors, lobes narrower than the cones and the bandwidth do is left to `gonio
reduce`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gonio.acquisition.records import StepRecord
from gonio.acquisition.run import Run
from gonio.errors import GonioError
from gonio.geometry import Directions
from gonio.reduction.count_rates import Reduced, RunFrames
from gonio.reduction.growing import so_far
from gonio.rig.description import Band
from gonio.typing import Floats

SPARE = 0.5
"""Around what the steps look at, the dark signal is kept for so much more: later poses look beside it."""


@dataclass(frozen=True, slots=True)
class Values:
    """What is known of a band; arrays run over the points in the order of their steps."""

    band: Band
    steps: list[int]
    points: list[int]
    directions: Directions
    brdf: Floats
    """1/sr."""
    u: Floats
    """Standard uncertainty [1/sr] of what is counted here."""
    visits: list[tuple[int, float, float]]
    """Of each visit to the reference: its step, its level over that of the first, standard uncertainty of that."""


class Provisional:
    """The steps of a run, reduced as they come."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._dark: list[StepRecord] = []
        self._around: list[StepRecord] = []
        """Steps that show how far over the sensor the others look."""
        self._frames: RunFrames | None = None
        self._rates: dict[int, list[Reduced | None]] = {}
        self._flags: dict[int, dict[str, str]] = {}

    def __len__(self) -> int:
        return len(self._rates)

    def add(self, step: StepRecord) -> None:
        """One more step; raises `GonioError` where its frames cannot be reduced."""
        if step.kind == "dark":
            self._dark.append(step)
            return
        if step.flag or not self._dark:
            return
        if self._frames is None or not self._frames.knows(step):
            self._around.append(step)
            self._frames = RunFrames(self._run, [*self._dark, *self._around], SPARE)
        found = [self._frames.reduce(step, band) for band in self._run.bands]
        self._rates[step.step] = [one if isinstance(one, Reduced) else None for one in found]

    def drop(self, steps: Iterable[int]) -> None:
        """Steps count no more."""
        for number in steps:
            self._rates.pop(number, None)

    def values(self) -> list[Values]:
        """What is known by now, a band each; none before the first visit to the reference."""
        if self._frames is None:
            return []
        out = []
        for k, band in enumerate(self._run.bands):
            taken = [(number, rates[k]) for number, rates in sorted(self._rates.items())]
            points = [(number, r) for number, r in taken if r is not None and r.point is not None]
            visited = [(number, r) for number, r in taken if r is not None and r.point is None]
            visits = [r for _, r in visited]
            if not visits:
                continue
            try:
                known = so_far(self._frames.run, [r for _, r in points], visits, band)
            except GonioError:  # a visit without light, say: `gonio reduce` says it
                continue
            noise = np.array([r.variance for _, r in points]) / known.level**2
            shared = sum((by**2 for by in known.common.values()), known.u_visits**2)
            first = min(visits, key=lambda visit: visit.time_s)
            out.append(
                Values(
                    band,
                    [number for number, _ in points],
                    [int(r.point) for _, r in points if r.point is not None],
                    known.directions,
                    known.brdf,
                    np.sqrt(noise + shared),
                    [(number, *_over(r, first)) for number, r in sorted(visited, key=lambda pair: pair[1].time_s)],
                )
            )
        return out


def _over(visit: Reduced, first: Reduced) -> tuple[float, float]:
    """The level of a visit over that of the first one, and the standard uncertainty of that."""
    ratio = visit.rate / first.rate
    own = math.sqrt(visit.variance) / abs(visit.rate)
    u = 0.0 if visit is first else abs(ratio) * math.hypot(own, math.sqrt(first.variance) / abs(first.rate))
    return ratio, u
