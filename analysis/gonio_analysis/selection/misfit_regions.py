"""Regions of angles: where a model fails, and blocks of values for held-out errors."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gonio import shown
from gonio.checks.values import Rows
from gonio.geometry import AROUND_MIRROR, SAME_INCIDENCE, Directions
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import Observations

FOLDS = 5
RANGE = float(np.radians(15.0))
"""Widest range of angles of incidence in a region, where a source was moved in steps too small to tell apart."""
ALIKE = 1e-3
"""A median of model / measured that is nearer to 1 is not worth a word."""
ONE_WAY = 0.7
"""Of the root mean square of ln(model / measured) in a region: a median nearer to 0 does not say how far off it is."""
FEWEST = 3
"""Values of a region that `farthest` may name."""


@dataclass(frozen=True)
class Region:
    """Where a model is farthest from the data."""

    words: str
    values: int
    excess: float
    """Sum of squares of ln(model / measured) in the region."""
    share: float
    """Of that of all values."""
    ratio: float | None
    """Median of model / measurement there, over values above 3 u."""
    single_ratio: float | None = None
    """Model / measurement of the one value of all that is farthest off."""
    single_words: str = ""
    """Its directions."""

    @property
    def off(self) -> str:
        """As in "8 % too high around the mirror direction at θi = 45°"; "" where it is not, or nothing is known."""
        typical = math.sqrt(self.excess / self.values)
        if self.ratio is None or typical < ALIKE:
            return ""
        way = f"too {'high' if self.ratio > 1 else 'low'}"
        if abs(math.log(max(self.ratio, 1e-300))) >= ONE_WAY * typical:
            factor = max(self.ratio, 1.0 / max(self.ratio, 1e-300))
            how = f"{shown.number(100 * abs(self.ratio - 1), 2)} % {way}"
            how = how if factor < 2 else f"{way} by a factor of {shown.number(factor, 2)},"
        else:  # the mean square says how far off it is, and nothing which way
            factor = math.exp(typical)
            how = f"{shown.number(100 * (factor - 1), 2)} %" if factor < 2 else f"a factor of {shown.number(factor, 2)}"
            how = f"off by {how} either way,"
        at, _, zone = self.words.rpartition(", ")
        return f"{how} {f'{zone} at {at}' if at else f'over {self.words}'}"


def incidences(data: Observations) -> list[tuple[float, Rows]]:
    """The angles of incidence [rad], ascending, and the values measured at each; those in small steps are one."""
    theta_i = data.directions.theta_i
    order = np.argsort(theta_i)
    cuts = np.flatnonzero(np.diff(theta_i[order]) > SAME_INCIDENCE) + 1
    return [(float(theta_i[group].mean()), group) for group in np.split(order, cuts)]


def farthest(result: FitResult) -> Region | None:
    """The region of three values or more in which ln(model / measured) has the largest root mean square.

    That says nothing of single values: the one that is farthest off, in any region, stands beside it.
    Where no region has so many values they are taken together.
    """
    data = result.data
    seen = (data.brdf > (3 * data.u if data.covariance is not None else 0.0)) & (result.predicted > 0)
    logs = np.zeros(len(data))
    logs[seen] = np.log(result.predicted[seen] / data.brdf[seen])
    found = [(words, here[seen[here]]) for words, here in _regions(data)]
    found = [(words, here) for words, here in found if here.size >= FEWEST] or [("all angles", np.flatnonzero(seen))]
    total = float((logs**2).sum())
    words, here = max(found, key=lambda f: float(np.mean(logs[f[1]] ** 2)) if f[1].size else -1.0)
    if not here.size or total <= 0:
        return None
    excess = float((logs[here] ** 2).sum())
    single = int(np.argmax(np.abs(logs)))
    return Region(words, int(here.size), excess, excess / total, float(np.exp(np.median(logs[here]))),
                  float(np.exp(logs[single])), _place(data.directions[single]))  # fmt: skip


def _place(d: Directions) -> str:
    """One pair of directions in words."""
    theta_i, along, theta_r, dphi = (f"{round(math.degrees(float(a)), 1) + 0.0:g}°" for a in
                                     (d.theta_i, d.along, d.theta_r, d.dphi))  # fmt: skip
    if bool(d.in_plane):
        return f"θi = {theta_i}, signed θr = {along}".replace("-", "−")
    return f"θi = {theta_i}, θr = {theta_r}, φr − φi = {dphi}"


def _regions(data: Observations) -> list[tuple[str, Rows]]:
    """Every region that holds a value, in words, and the values."""
    along, in_plane, every = data.directions.along, data.directions.in_plane, data.directions.theta_i
    found = []
    for where, rows in _ranges(data):
        flat, theta_i = in_plane[rows], every[rows]
        mirror = np.abs(along[rows] - theta_i) < AROUND_MIRROR
        zones = {
            "on the retro side": flat & ~mirror & (along[rows] < 0),
            "between normal and mirror": flat & ~mirror & (along[rows] >= 0) & (along[rows] < theta_i),
            "around the mirror direction": flat & mirror,
            "beyond the mirror direction": flat & ~mirror & (along[rows] >= theta_i),
            "out of plane": ~flat,
        }
        found += [(f"θi = {where}, {words}", rows[zone]) for words, zone in zones.items() if zone.any()]
    return found


def _ranges(data: Observations) -> list[tuple[str, Rows]]:
    """Angles of incidence in words, and the values measured at each; where they stand close, ranges of them."""
    theta_i, out = data.directions.theta_i, []
    for middle, rows in incidences(data):
        low, high = float(theta_i[rows].min()), float(theta_i[rows].max())
        if high - low <= SAME_INCIDENCE:
            out.append((_degrees(middle), rows))
            continue
        edges = np.linspace(low, high, math.ceil((high - low) / RANGE) + 1)
        for part in (rows[here] for here in _between(theta_i[rows], edges)):
            ends = (float(theta_i[part].min()), float(theta_i[part].max()))
            out.append((" to ".join(map(_degrees, ends)), part))
    return out


def _degrees(angle: float) -> str:
    return f"{round(math.degrees(angle), 1):g}°"


def _between(values: Floats, edges: Floats) -> list[Rows]:
    number = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
    found = (np.flatnonzero(number == k) for k in range(edges.size - 1))
    return [rows for rows in found if rows.size]


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
