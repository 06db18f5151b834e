"""Regions of angles: in which of them a model is farthest from the data, in one number."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio import shown
from gonio.checks.values import Rows
from gonio.geometry import AROUND_MIRROR, SAME_INCIDENCE, Directions
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult

RANGE = float(np.radians(15.0))
"""Widest range of angles of incidence in a region, where a source was moved in steps too small to tell apart."""
ALIKE = 1e-3
"""A misfit below it is not worth a word."""
ONE_WAY = 0.7
"""Part of a region's misfit: where the median of ln(model / measured) is nearer to 0 it is off either way."""
FEWEST, TELLING = 3, 1.0
"""Values that a region has at least, and what they weigh together; a value without noise weighs 1."""
FEATURE = 2.0
"""A single value is said as a factor beyond this one, and not in percent."""
TINY = 1e-300
"""A ratio below it is said as it; no measurement is that far from a model."""
PERCENT = 0.2
"""Logarithms below it are said as percents, as tau is; above it the two ways would differ: a factor is said."""
SINGLE = 1.5
"""A single value is named beside the region where it is farther off by this factor."""
ALL = "all angles"


@dataclass(frozen=True)
class WorstRegion:
    """Where a model is farthest from the data."""

    words: str
    values: int
    excess: float
    """Sum of squares of ln(model / measured) in the region."""
    share: float
    """Share of the sum over all values."""
    ratio: float
    """Median of model / measurement there, over values above 3 u: which way the model is off."""
    typical: float
    """How far off it is there: the root mean square of ln(model / measured) without the noise of the values."""
    misfit: float = 0.0
    """The same over all values, of a model with a misfit (`gonio_analysis.fitting.misfit`)."""
    single_ratio: float | None = None
    """Model / measurement of the one value of all that is farthest off."""
    single_words: str = ""
    """Its directions."""

    @property
    def off(self) -> str:
        """As in "8 % too high around the mirror direction at θi = 45°"; "" where it is not."""
        if self.typical < ALIKE:
            return ""
        factor = self.typical >= PERCENT
        many = math.exp(min(self.typical, 700.0)) if factor else 100 * self.typical
        amount = f"a factor of {_two_digits(many)}" if factor else f"{shown.number(many, 2)} %"
        way = f"too {'high' if self.ratio > 1 else 'low'}"
        if abs(math.log(max(self.ratio, TINY))) < ONE_WAY * self.typical:
            how = f"off by {amount} either way,"
        else:
            how = f"{way} by {amount}," if factor else f"{amount} {way}"
        at, _, zone = self.words.rpartition(", ")
        return f"{how} {f'{zone} at {at}' if at else f'over {self.words}'}"

    @property
    def single(self) -> str:
        """The value that is farthest off, where it is clearly farther than the region; "" where it is not."""
        if self.single_ratio is None or abs(math.log(self.single_ratio)) <= self.typical + math.log(SINGLE):
            return ""
        return f"in one direction it is {too_far(self.single_ratio)}: {self.single_words}"


def worst(missed: WorstRegion | None) -> str:
    """What follows on how far off a model is: the region where it is farther off than that, and a single value."""
    if missed is None or not missed.off:
        return ""
    where = f", worst {missed.off}" if missed.typical >= missed.misfit else ", and no region is farther off"
    return where + (f" ({missed.single})" if missed.single else "")


def too_far(ratio: float) -> str:
    """Which way and how far a model is off where it is `ratio` times the measurement: in percent, or by a factor."""
    way = f"too {'high' if ratio > 1 else 'low'}"
    if 1 / FEATURE < ratio < FEATURE:
        return f"{shown.number(100 * abs(ratio - 1), 2)} % {way}"
    return f"{way} by a factor of {_two_digits(max(ratio, 1 / max(ratio, TINY)))}"


def _two_digits(factor: float) -> str:
    """A factor, large ones rounded too: how far a model is off is not known to a millionth."""
    return shown.number(float(f"{factor:.2g}"), 2)


def incidences(theta_i: Floats) -> list[tuple[float, Rows]]:
    """The angles of incidence [rad], ascending, and the values measured at each; those in small steps are one."""
    order = np.argsort(theta_i)
    cuts = np.flatnonzero(np.diff(theta_i[order]) > SAME_INCIDENCE) + 1
    return [(float(theta_i[group].mean()), group) for group in np.split(order, cuts)]


def farthest(result: FitResult) -> WorstRegion | None:
    """The region in which a model is off by most, over values above 3 u; None where there are none.

    A value counts by what it tells of a misfit, as in `misfit.u_of_log_tau`. So a region's misfit is tau, of this
    region alone, on the scale of ln f. Regions of fewer than three values join their neighbours.
    """
    data = result.data
    seen = np.flatnonzero((data.brdf > (3 * data.u if data.covariance is not None else 0.0)) & (result.predicted > 0))
    logs = np.log(result.predicted[seen] / data.brdf[seen])
    total = float((logs**2).sum())
    if total <= 0:
        return None
    noise = np.zeros(seen.size) if data.covariance is None else data.covariance.random[seen] / data.brdf[seen]
    size = total / seen.size if result.misfit is None else result.misfit.tau**2
    part = size / (size + noise**2)
    weight, square = part**2, logs**2 - noise**2

    def typical(rows: Rows) -> float:
        return math.sqrt(max(float(weight[rows] @ square[rows] / weight[rows].sum()), 0.0))

    at = data.directions.settled_at_normal()
    words, here = max(_regions(at[seen], weight), key=lambda found: typical(found[1]))
    excess, single = float((logs[here] ** 2).sum()), int(np.argmax(part * np.abs(logs)))
    return WorstRegion(
        words,
        int(here.size),
        excess,
        excess / total,
        float(np.exp(np.median(logs[here]))),
        typical(here),
        0.0 if result.misfit is None else result.misfit.tau,
        float(np.exp(logs[single])),
        _place(at[int(seen[single])]),
    )


def _place(d: Directions) -> str:
    """One pair of directions in words."""
    theta_i, along, theta_r, dphi = (f"{round(math.degrees(float(a)), 1) + 0.0:g}°" for a in
                                     (d.theta_i, d.along, d.theta_r, d.dphi))  # fmt: skip
    if bool(d.in_plane):
        return f"θi = {theta_i}, signed θr = {along}".replace("-", "−")
    return f"θi = {theta_i}, θr = {theta_r}, φr − φi = {dphi}"


def _regions(directions: Directions, weight: Floats) -> list[tuple[str, Rows]]:
    """Every region in words, and its values."""
    along, in_plane, every = directions.along, directions.in_plane, directions.theta_i
    found = []
    for several, rows in _joined([([where], rows) for where, rows in _ranges(every)], weight):
        ends = f"{_degrees(float(every[rows].min()))} to {_degrees(float(every[rows].max()))}"
        where = f"θi = {several[0] if len(several) == 1 else ends}"
        flat, theta_i = in_plane[rows], every[rows]
        mirror = np.abs(along[rows] - theta_i) < AROUND_MIRROR
        zones = {
            "on the retro side": flat & ~mirror & (along[rows] < 0),
            "between normal and mirror": flat & ~mirror & (along[rows] >= 0) & (along[rows] < theta_i),
            "around the mirror direction": flat & mirror,
            "beyond the mirror direction": flat & ~mirror & (along[rows] >= theta_i),
        }
        inside = _joined([([words], rows[zone]) for words, zone in zones.items() if zone.any()], weight)
        parts = _joined(inside + [(["out of plane"], rows[~flat])] * bool((~flat).any()), weight)
        for words, here in parts:
            zone = " and ".join(words).replace(" the mirror direction and beyond", " and beyond")
            found.append((where if len(parts) == 1 and len(words) > 1 else f"{where}, {zone}", here))
    return [(ALL, found[0][1])] if len(found) == 1 and "," not in found[0][0] else found


Named = tuple[list[str], Rows]
"""Values of a region, or of several neighbours together, with the words of each."""


def _joined(parts: Sequence[Named], weight: Floats) -> list[Named]:
    """Neighbours together, until each group has values enough."""
    out: list[Named] = []
    words: list[str] = []
    rows = np.zeros(0, np.intp)
    for more, here in parts:
        words, rows = [*words, *more], np.concatenate([rows, here])
        if rows.size >= FEWEST and weight[rows].sum() >= TELLING:
            out.append((words, rows))
            words, rows = [], rows[:0]
    if words and out:
        before, there = out.pop()
        words, rows = [*before, *words], np.concatenate([there, rows])
    return [*out, (words, rows)] if words else out


def _ranges(theta_i: Floats) -> list[tuple[str, Rows]]:
    """Angles of incidence in words, and the values measured at each; where they stand close, ranges of them."""
    out = []
    for middle, rows in incidences(theta_i):
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
