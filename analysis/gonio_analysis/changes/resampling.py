"""The values of one measurement in the directions of another, without inventing data.

Two runs of one plan never land in quite the same directions, and files of different laboratories share few. A value is
carried over only by interpolation between measured neighbours: along the plane of incidence, or in a Delaunay
triangulation of the receiver's directions. Outside their convex hull, across a hole (a row that must not be used), or
where neighbours are more than `FARTHEST` apart there is none.

Lobes follow the mirror direction, so that positions are counted from it: r = sin(theta_r) (cos dphi, sin dphi) +
(sin(theta_i), 0). A difference of a few hundredths of a degree between two incidences then moves the lobe along.

Along the plane of incidence, between four neighbours that all stand clearly out of their noise, the logarithms follow
a cubic: lobes rise by large factors, and chords of them are off by many times the noise. Its error is stated as the
largest of three: the difference from the cubic of the values themselves, that from the polynomial through six
logarithms, and a quarter of the difference of the two parabolas through three of the four. The last alone, twice as
large, was three times the error in a lobe, and hid noise that was understated; where there are no six, it is taken.
All three are small beside an edge of the curve: where the values show one, what it makes of the cubic counts too
(`gonio_analysis.changes.edges`).

Elsewhere interpolation is linear. Its error between x_k with weights w_k is stated as the larger of two:

- sum_k w_k |g_k - g| |x_k - x| / 2, with g_k the gradient that the values around x_k have, and g that of the
  interpolant. It is exact for a parabola in one dimension.
- The difference from the interpolation of the logarithms. It is the larger one at the edge of a lobe that rises by a
  large factor from one neighbour to the next, where the gradients say too little.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gonio.geometry import AT_NORMAL, SAME_ANGLE, Directions, direction, groups
from gonio.progress import Pace, Say, silent
from gonio.typing import Floats, Ints
from gonio_analysis.changes.interpolation import Interpolations, Places
from gonio_analysis.fitting.observations import SAME_BAND_NM, Observations, Unused

TURN = float(np.radians(0.25))
"""Turn of directions for the slope along the plane of incidence [rad]."""

AT_ONCE = 1 << 16
"""Directions that are turned together: their vectors take 200 bytes each."""


@dataclass(frozen=True)
class Carried:
    """Values of B in some of the directions of A."""

    rows: Ints
    """Which of A's values have a counterpart."""
    value: Floats
    """[1/sr]."""
    random: Floats
    """Independent standard uncertainty [1/sr], 0 where none is stated."""
    together: Floats
    """The same as it counts in sums over neighbours, which share the values between which they lie [1/sr]."""
    common: Floats
    """(n, k) common causes of B [1/sr]."""
    error: Floats
    """Error of the interpolation [1/sr]; 0 in the same direction."""
    missing: dict[str, int]
    """Why values of A have no counterpart, and how many."""
    sources: int
    """How many values of B they are made of."""

    @property
    def interpolated(self) -> int:
        """How many values are not from the same direction."""
        return int(np.count_nonzero(self.error))

    @property
    def u(self) -> Floats:
        """(n,) combined standard uncertainty [1/sr]."""
        return np.asarray(np.sqrt(self.random**2 + (self.common**2).sum(axis=1) + self.error**2))

    @property
    def relative_error(self) -> Floats:
        """(n,) `error` over the values."""
        return self.error / np.maximum(np.abs(self.value), 1e-300)


SAME_WAVELENGTH_NM = 0.5
"""What two wavelengths differ by, at most, that count as one."""


def common_wavelengths(a: Observations, b: Observations) -> list[tuple[float, float]]:
    """Wavelengths [nm] of A with the nearest one of B, where they agree; (NaN, NaN) for two broad bands."""
    out, others = [], np.array(b.wavelengths)
    for wave in a.wavelengths:
        known = others[np.isnan(others) if np.isnan(wave) else np.abs(others - wave) <= SAME_WAVELENGTH_NM].tolist()
        if np.isnan(wave):
            out += [(wave, w) for w in known]
        elif known:
            out.append((wave, min(known, key=lambda w: abs(w - wave))))
    return out


def carry(a: Observations, b: Observations, say: Say = silent, known: Interpolations | None = None) -> Carried:
    """B's values in the directions of A, at their common wavelengths.

    Parameters
    ----------
    a, b
        The usable values of two tables. Rows of B that must not be used are holes.
    say
        Called with a line now and then, where it takes long.
    known
        Interpolations of earlier calls, which those of the same directions take.
    """
    known = Interpolations() if known is None else known
    n = len(a)
    k = len(b.covariance.causes) if b.covariance is not None else 0
    value, random, together, error = np.full(n, np.nan), np.zeros(n), np.zeros(n), np.zeros(n)
    common, used = np.zeros((n, k)), np.zeros(len(b), dtype=bool)
    missing = {"at another wavelength": n}
    unused = _Holes.of(b.unused)
    common_waves = common_wavelengths(a, b)
    pace = Pace("comparing: wavelengths", len(common_waves), say)
    rows_a, rows_b, rows_unused = (RowsAt(x.wavelength_nm) for x in (a, b, unused))
    for k_wave, (wave_a, wave_b) in enumerate(common_waves):
        pace.step(k_wave)
        here_a, here_b = rows_a.at(wave_a), rows_b.at(wave_b)
        missing["at another wavelength"] -= here_a.size
        pool = groups(b.directions.theta_i, b.directions.phi_i, here_b)
        gone = rows_unused.at(wave_b)
        incidences = [_incidence(b, rows) for rows in pool]
        for group in groups(a.directions.theta_i, a.directions.phi_i, here_a):
            own = _incidence(a, group)
            off = [float(np.linalg.norm(one - own)) for one in incidences]
            if not off or min(off) > SAME_ANGLE:
                missing["at another incidence"] = missing.get("at another incidence", 0) + group.size
                continue
            partner, incident = pool[int(np.argmin(off))], a.directions[group]
            normal = float(incident.settled_at_normal().phi_i[0]) if incident.theta_i.max() < AT_NORMAL else None
            holes = unused.at(b, partner, gone, normal)
            between = known.between(_places(incident, normal), _places(b.directions[partner], normal), holes)
            noise = b.covariance.random[partner] if b.covariance is not None else None
            nodes, weights, curvature = between.of(b.brdf[partner], noise)
            found = nodes[:, 0] >= 0
            if not found.all():
                reason = "outside the other's directions, or in a hole of them"
                missing[reason] = missing.get(reason, 0) + int((~found).sum())
            rows, near, w = group[found], partner[nodes[found]], weights[found]
            used[near[w > 0.0]] = True
            value[rows], error[rows] = (w * b.brdf[near]).sum(axis=1), curvature[found]
            if b.covariance is not None:
                random[rows], together[rows] = _carried_noise(w, near, b.covariance.random)
                common[rows] = (w[:, :, None] * b.covariance.common[near]).sum(axis=1)
    missing = {reason: count for reason, count in missing.items() if count}
    del rows_a, rows_b
    rows = np.flatnonzero(np.isfinite(value))
    if rows.size < n:  # one after the other: all at once would be much in memory
        value = value[rows]
        random = random[rows]
        together = together[rows]
        common = common[rows]
        error = error[rows]
    return Carried(rows, value, random, together, common, error, missing, int(np.count_nonzero(used)))


def _carried_noise(weights: Floats, near: Ints, random: Floats) -> tuple[Floats, Floats]:
    """`Carried.random` and `Carried.together` of values with (n, m) weights: with C their covariance the roots of its
    diagonal, and of its sums over rows."""
    part = weights * random[near] ** 2
    own = (weights * part).sum(axis=1)
    nodes, place = np.unique(near, return_inverse=True)
    whole = np.bincount(place.ravel(), weights.ravel(), nodes.size)[place.reshape(near.shape)]
    return np.sqrt(own), np.sqrt(np.maximum((whole * part).sum(axis=1), own))


def turned_in_plane(directions: Directions, by: float) -> tuple[Directions, Any]:
    """Receivers turned in the plane of incidence, toward the mirror direction, by an angle [rad]; which are above the
    surface."""
    planes = np.broadcast_to(directions.settled_at_normal().phi_i, directions.shape)
    # one block also where there are no directions
    parts = (slice(k, k + AT_ONCE) for k in range(0, max(len(directions), 1), AT_ONCE))
    turned, above = zip(*(_turned(directions[part], planes[part], by) for part in parts), strict=True)
    return Directions(*np.concatenate([one.angles for one in turned], axis=1)), np.concatenate(above)


def _turned(directions: Directions, plane: Floats, by: float) -> tuple[Directions, Any]:
    source, receiver = directions.vectors
    across = np.column_stack([-np.cos(plane), -np.sin(plane)])
    along = np.sum(receiver[:, :2] * across, axis=1)
    high = receiver[:, 2]
    moved = receiver.copy()
    moved[:, :2] += ((np.cos(by) - 1.0) * along + np.sin(by) * high)[:, None] * across
    moved[:, 2] = np.cos(by) * high - np.sin(by) * along
    above = moved[:, 2] > 0.0
    moved[~above] = receiver[~above]
    return Directions.from_vectors(source, moved), above


def slope_in_plane(shape: Observations) -> Floats:
    """Change of the shape's values with the receiver's angle in the plane of incidence [1/(sr rad)]."""
    out, rows, known = np.zeros(len(shape)), RowsAt(shape.wavelength_nm), Interpolations()
    for wave in shape.wavelengths:
        here = rows.at(wave)
        alone = replace(shape, covariance=None, u_angles=np.zeros(0), unused=Unused()).take(here)
        turned, above = zip(*(turned_in_plane(alone.directions, by) for by in (TURN, -TURN)), strict=True)
        kept = np.flatnonzero(np.concatenate(above))
        both_ways = Directions(*np.concatenate([one.angles for one in turned], axis=1)[:, kept])
        carried = carry(replace(alone.take(kept % here.size), directions=both_ways), alone, known=known)
        values = np.full(2 * here.size, np.nan)
        values[kept[carried.rows]] = carried.value
        ends = values.reshape(2, here.size)
        ahead, behind = (ends[0] - alone.brdf) / TURN, (alone.brdf - ends[1]) / TURN
        both = np.where(np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, 0.5 * (ahead + behind)))
        out[here] = np.nan_to_num(both)
    return out


class RowsAt:
    """Which rows have a wavelength."""

    def __init__(self, waves: Floats) -> None:
        self._waves, self._order = waves, np.argsort(waves, kind="stable")

    def at(self, wave: float) -> Ints:
        """Rows of a wavelength [nm], ascending; of NaN, those without one."""
        low, high = (np.inf, np.nan) if np.isnan(wave) else (wave - SAME_BAND_NM, wave + SAME_BAND_NM)
        first = np.searchsorted(self._waves, low, side="right" if np.isnan(wave) else "left", sorter=self._order)
        end = np.searchsorted(self._waves, high, side="right", sorter=self._order)
        return np.asarray(np.sort(self._order[first:end]))


def _places(d: Directions, normal: float | None) -> Places:
    """Where directions lie; at normal incidence azimuths count from `normal`, a plane of the detectors."""
    if normal is not None:
        d = d.seen_from(normal)
    points = d.from_incidence
    points[:, 0] += np.sin(d.theta_i)
    return Places(points, d.signed - d.theta_i, d.in_plane)


@dataclass(frozen=True)
class _Holes:
    """Where rows of a table lie that must not be used."""

    wavelength_nm: Floats
    directions: Directions
    source: Floats
    """(n, 3) unit vectors toward the source."""

    @classmethod
    def of(cls, rows: Unused) -> _Holes:
        return cls(rows.wavelength_nm, rows.directions, rows.directions.vectors[0])

    def at(self, b: Observations, rows: Ints, here: Ints, normal: float | None) -> Places:
        """Where those among `here` lie that have the incidence of B's `rows`."""
        goal = b.directions[rows].vectors[0].mean(axis=0)
        here = here[np.linalg.norm(self.source[here] - goal, axis=1) <= SAME_ANGLE]
        return _places(self.directions[here], normal)


def _incidence(data: Observations, rows: Ints) -> Floats:
    """Mean unit vector toward the source."""
    at = data.directions
    return np.asarray(direction(at.theta_i[rows], at.phi_i[rows]).mean(axis=0))
