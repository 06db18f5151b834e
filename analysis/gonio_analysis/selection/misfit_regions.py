"""Regions of angles: where a model fails, and blocks of values for held-out errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gonio.geometry import AROUND_MIRROR, SAME_INCIDENCE
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.surrogate import Rows
from gonio_analysis.result_records import RegionSummary

FOLDS = 5


@dataclass(frozen=True)
class Region:
    """Where a model is farthest from the data, relative to their uncertainty."""

    words: str
    values: int
    excess: float
    """Sum of squared whitened residuals in the region, less their number."""
    share: float
    """Of the excess of all regions with any."""
    ratio: float | None
    """Median of model / measurement there, over values above 3 u."""

    def summary(self) -> RegionSummary:
        """Plain numbers."""
        return RegionSummary(self.words, self.values, self.excess, self.share, self.ratio)


def incidences(data: Observations) -> list[tuple[float, Rows]]:
    """The angles of incidence [rad], ascending, and the values measured at each."""
    theta_i = data.directions.theta_i
    order = np.argsort(theta_i)
    cuts = np.flatnonzero(np.diff(theta_i[order]) > SAME_INCIDENCE) + 1
    return [(float(theta_i[group].mean()), group) for group in np.split(order, cuts)]


def worst(result: FitResult) -> Region | None:
    """The region with the largest excess of chi-square over the number of its values; None where there is none."""
    data, square = result.data, result.whitened**2
    along, in_plane = data.directions.along, data.directions.in_plane
    found: list[tuple[float, str, Rows]] = []
    for theta_i, rows in incidences(data):
        flat = in_plane[rows]
        mirror = np.abs(along[rows] - theta_i) < AROUND_MIRROR
        zones = {
            "on the retro side": flat & ~mirror & (along[rows] < 0),
            "between normal and mirror": flat & ~mirror & (along[rows] >= 0) & (along[rows] < theta_i),
            "around the mirror direction": flat & mirror,
            "beyond the mirror direction": flat & ~mirror & (along[rows] >= theta_i),
            "out of plane": ~flat,
        }
        for words, zone in zones.items():
            here = rows[zone]
            if here.size:
                excess = float(square[here].sum()) - here.size
                found.append((excess, f"θi = {math.degrees(theta_i):.0f}°, {words}", here))
    total = sum(max(excess, 0.0) for excess, _, _ in found)
    if total <= 0:
        return None
    excess, words, here = max(found, key=lambda f: f[0])
    seen = here[data.brdf[here] > 3 * data.u[here]]
    ratio = float(np.median(result.predicted[seen] / data.brdf[seen])) if seen.size else None
    return Region(words, int(here.size), excess, max(excess, 0.0) / total, ratio)


def blocks(data: Observations) -> tuple[list[Rows], str]:
    """Blocks to leave out one after the other, and what they are; neighbours stay together, for they are alike.

    Angles of incidence where there are three or more, else ranges of the detector's angle.
    """
    groups = [rows for _, rows in incidences(data)]
    if len(groups) >= 3:
        if len(groups) > 2 * FOLDS:  # a dense set of incidences: neighbours go together
            groups = [np.concatenate(part) for part in _parts(groups, FOLDS)]
        return groups, "angle of incidence"
    order = np.argsort(data.directions.along)
    return [part for part in np.array_split(order, FOLDS) if part.size], "range of the detector's angle"


def _parts(groups: list[Rows], count: int) -> list[list[Rows]]:
    edges = np.linspace(0, len(groups), count + 1).round().astype(int)
    return [groups[a:b] for a, b in pairwise(edges) if b > a]
