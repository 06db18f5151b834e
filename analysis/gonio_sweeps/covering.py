"""Points that tell a curve whatever it is: where no model is to be trusted.

First gaps are divided evenly, finer about the mirror direction. Then single points are taken, by what they lower the
mean square error of the curves by for their time. A gap may be divided: how far a curve departs from what neighbours
say is told by leaving each point out. Or a point is visited again, where curves are resolved and noise is what is left.
"""

from __future__ import annotations

import itertools
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.acquisition.plan import Point
from gonio.typing import Floats
from gonio_sweeps.candidates import curves, fill, signed_deg

STEPS_DEG = tuple(60.0 / 1.05**k for k in range(120))
"""Steps that a covering may have."""
NEAR_MIRROR_DEG = 15.0
"""Closer to the mirror direction the steps are half as large: lobes lie there."""
EVENLY = 0.7
"""Part of the time that is left when a covering begins which gaps divided evenly may take; the rest is for the curves'
errors."""
SAME_PLACE = 0.03
"""Candidates so close to what was measured (`gonio_sweeps.candidates.places`) are measured: an encoder's step or so."""
ENOUGH = 1e-3
"""Relative errors below this are not made smaller: the reference is not known as well."""
OF_NOISE = 0.7
"""Mean variance of a curve through noisy points, in units of the points' own: between them some of it averages out."""


@dataclass(frozen=True)
class Curves:
    """What was measured at candidates."""

    points: Sequence[Point]
    visits: npt.NDArray[np.intp]
    """Of each candidate."""
    logarithm: Floats
    """Mean logarithm of the values; 0 without a visit."""
    u: Floats
    """Relative standard uncertainty of one visit by noise: as it was, or as it is expected."""

    @classmethod
    def of(
        cls, points: Sequence[Point], at: Floats, among: Floats, brdf: Floats, u: Floats, expected: Floats
    ) -> Curves:
        """From values (m,) at places `among` (m, 3), candidates being at places `at` (n, 3).

        `u` [1/sr] is the noise of the values, `expected` the relative noise of a visit to each candidate (n,).
        """
        visits, total, squares = np.zeros(len(at), dtype=np.intp), np.zeros(len(at)), np.zeros(len(at))
        if len(among):
            from scipy.spatial import cKDTree

            distance, which = cKDTree(at).query(among)
            here = which[distance < SAME_PLACE]
            level = np.maximum(brdf, np.maximum(u, 1e-12))[distance < SAME_PLACE]
            np.add.at(visits, here, 1)
            np.add.at(total, here, np.log(level))
            np.add.at(squares, here, (u[distance < SAME_PLACE] / level) ** 2)
        times = np.maximum(visits, 1)
        own = np.where(visits > 0, np.sqrt(squares / times), np.minimum(expected, 1.0))
        return cls(points, visits, total / times, np.maximum(own, 1e-6))

    def departures(self, line: list[int]) -> Floats:
        """Squares of the relative departure of the points of a curve from what the others there say, less noise."""
        from scipy.interpolate import PchipInterpolator

        x, y = np.array([signed_deg(self.points[k]) for k in line]), self.logarithm[line]
        variance = self.u[line] ** 2 / self.visits[line]
        out = np.zeros(len(line))
        for n in range(1, len(line) - 1) if len(line) > 3 else ():
            near = [m for m in range(max(n - 3, 0), min(n + 4, len(line))) if m != n]
            predicted = float(PchipInterpolator(x[near], y[near])(x[n]))
            share = (x[n] - x[n - 1]) / (x[n + 1] - x[n - 1])
            noise = variance[n] + (1.0 - share) ** 2 * variance[n - 1] + share**2 * variance[n + 1]
            out[n] = max((y[n] - predicted) ** 2 - noise, 0.0)
        if len(line) > 3:
            out[0], out[-1] = out[1], out[-2]
        return out


def evenly(known: Curves, open_to: Sequence[int], fits: Callable[[list[int]], bool]) -> tuple[list[int], bool]:
    """The candidates of the smallest even step that fits, and whether a smaller step would take more of them."""
    some = [known.points[k] for k in open_to]
    seen = {n for n, k in enumerate(open_to) if known.visits[k]}

    def with_steps(number: int) -> list[int]:
        return [open_to[n] for n in fill(some, seen, STEPS_DEG[number], NEAR_MIRROR_DEG)]

    fine = bisect_left(range(len(STEPS_DEG)), True, key=lambda n: not fits(with_steps(n)))
    batch = with_steps(fine - 1) if fine else []
    finer = with_steps(fine) if fine < len(STEPS_DEG) else []
    if not batch and finer:  # not all of them: some, evenly
        for count in range(len(finer), 0, -1):
            part = [finer[k] for k in np.linspace(0, len(finer) - 1, count).round().astype(int)]
            if fits(part):
                return part, True
    return batch, bool(finer)


def by_errors(known: Curves, open_to: Sequence[int], cost: Floats, fits: Callable[[list[int]], bool]) -> list[int]:
    """Candidates, some of them more than once, that lower the mean square relative error of the curves most for their
    time; as many as fit.

    Parameters
    ----------
    known
        What was measured.
    open_to
        Candidates that may be taken.
    cost
        Of each candidate [s].
    fits
        Whether a batch fits into the time.
    """
    allowed = set(open_to)
    lines = [_Line.of(known, line, allowed) for line in curves(known.points)]
    lines = [line for line in lines if len(line.there) > 1]
    best = [line.best(cost) for line in lines]
    batch: list[int] = []
    while best:
        n = max(range(len(best)), key=lambda m: best[m][0])
        score, chosen = best[n]
        if score <= 0.0:
            break
        batch.append(chosen)
        if len(batch) % 8 == 0 and not fits(batch):
            break
        lines[n].take(chosen)
        best[n] = lines[n].best(cost)
    while batch and not fits(batch):
        batch.pop()
    return batch


@dataclass
class _Line:
    """One curve while points are taken."""

    line: list[int]
    """Candidates, by the angle of reflection."""
    x: Floats
    allowed: npt.NDArray[np.bool_]
    visits: Floats
    variance: Floats
    """Of one visit to each."""
    there: list[int]
    """Those that were visited or are taken, as numbers in `line`."""
    squares: Floats
    """Square of the relative error in the middle of the gap after each of them, over the fourth power of the gap."""

    @classmethod
    def of(cls, known: Curves, line: list[int], allowed: set[int]) -> _Line:
        x = np.array([signed_deg(known.points[k]) for k in line])
        there = [n for n, k in enumerate(line) if known.visits[k]]
        out = np.zeros(len(line))
        if len(there) > 1:
            found, at = known.departures([line[n] for n in there]), x[there]
            across = np.concatenate([at[2:3] - at[:1], at[2:] - at[:-2], at[-1:] - at[-3:-2]])
            curvature = found / np.maximum(across, 1e-9) ** 4 if len(there) > 3 else np.full(len(there), 0.0)
            ends = np.maximum(curvature[:-1], curvature[1:])
            for n, (a, b) in enumerate(itertools.pairwise(there)):
                out[a:b] = ends[n]
        free = np.array([k in allowed for k in line])
        return cls(line, x, free, known.visits[line].astype(float), known.u[line] ** 2, there, out)

    def best(self, cost: Floats) -> tuple[float, int]:
        """What a second brings at most, and where."""
        at = np.array(self.there)
        x, gap = self.x[at], np.diff(self.x[at])
        width = 0.5 * (np.concatenate([[0.0], gap]) + np.concatenate([gap, [0.0]]))
        times, variance = self.visits[at], self.variance[at]
        of_noise = np.where(variance / times > ENOUGH**2, OF_NOISE * variance / (times * (times + 1.0)) * width, 0.0)
        of_noise = np.where(self.allowed[at], of_noise, 0.0) / cost[[self.line[n] for n in at]]
        best = max(zip(of_noise.tolist(), at.tolist(), strict=True))
        error = np.minimum(self.squares[at[:-1]] * gap**4, 1.0)
        for n in np.flatnonzero((error > ENOUGH**2) & (np.diff(at) > 1)):
            inside = np.arange(at[n] + 1, at[n + 1])
            inside = inside[self.allowed[inside]]
            if inside.size:
                middle = int(inside[np.argmin(np.abs(self.x[inside] - 0.5 * (x[n] + x[n + 1])))])
                best = max(best, (float(error[n] * gap[n] / cost[self.line[middle]]), middle))
        return best[0], self.line[best[1]]

    def take(self, candidate: int) -> None:
        """One more visit."""
        n = self.line.index(candidate)
        if self.visits[n] == 0.0:
            self.there = sorted([*self.there, n])
        self.visits[n] += 1.0
