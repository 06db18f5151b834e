"""The values of one measurement in the directions of another, without inventing data.

Two runs of one plan never land in quite the same directions, and files of different laboratories share few. A value is
carried over only by interpolation between measured neighbours: along the plane of incidence, or in a Delaunay
triangulation of the receiver's directions. Outside their convex hull, across a hole (a row that must not be used), or
where neighbours are more than `FARTHEST` apart there is none.

Lobes follow the mirror direction, so that positions are counted from it: r = sin(theta_r) (cos dphi, sin dphi) +
(sin(theta_i), 0). A difference of a few hundredths of a degree between two incidences then moves the lobe along.

The error of an interpolation between x_k with weights w_k is stated as the larger of two:

- sum_k w_k |g_k - g| |x_k - x| / 2, with g_k the gradient that the values around x_k have, and g that of the
  interpolant. It is exact for a parabola in one dimension.
- The difference from the interpolation of the logarithms. It is the larger one at the edge of a lobe that rises by a
  large factor from one neighbour to the next, where the gradients say too little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from gonio.geometry import SAME_ANGLE, SAME_DIRECTION, Directions
from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Rows, groups
from gonio_analysis.fitting.observations import SAME_BAND_NM, Observations

if TYPE_CHECKING:
    import pandas as pd

FARTHEST = float(np.radians(15.0))
"""Nothing is interpolated between directions farther apart than this [rad]."""


@dataclass(frozen=True)
class Carried:
    """Values of B in some of the directions of A."""

    rows: Rows
    """Which of A's values have a counterpart."""
    value: Floats
    """[1/sr]."""
    random: Floats
    """Independent standard uncertainty [1/sr], 0 where none is stated."""
    common: Floats
    """(n, k) common causes of B [1/sr]."""
    error: Floats
    """Of the interpolation [1/sr]; 0 in the same direction."""
    missing: dict[str, int]
    """Why values of A have no counterpart, and how many."""

    @property
    def interpolated(self) -> int:
        """How many values are not from the same direction."""
        return int(np.count_nonzero(self.error))


def common_wavelengths(a: Observations, b: Observations, within_nm: float = 0.5) -> list[tuple[float, float]]:
    """Wavelengths [nm] of A with the nearest one of B, where they agree; (NaN, NaN) for two broad bands."""
    out = []
    for wave in a.wavelengths:
        if np.isnan(wave):
            out += [(wave, w) for w in b.wavelengths if np.isnan(w)]
            continue
        known = [w for w in b.wavelengths if abs(w - wave) <= within_nm]
        if known:
            out.append((wave, min(known, key=lambda w: abs(w - wave))))
    return out


def carry(a: Observations, b: Observations, b_table: pd.DataFrame) -> Carried:
    """B's values in the directions of A, at their common wavelengths.

    Parameters
    ----------
    a, b
        The usable values of two tables.
    b_table
        The whole table of B: its rows that are not in `b` are holes.
    """
    n = len(a)
    k = len(b.covariance.causes) if b.covariance is not None else 0
    value, random, error = np.full(n, np.nan), np.zeros(n), np.zeros(n)
    common = np.zeros((n, k))
    missing = {"at another wavelength": n}
    unused = _Unused.of(b, b_table)
    for wave_a, wave_b in common_wavelengths(a, b):
        here_a, here_b = _at(a.wavelength_nm, wave_a), _at(b.wavelength_nm, wave_b)
        missing["at another wavelength"] -= here_a.size
        pool = groups(b.directions.theta_i, b.directions.phi_i, here_b)
        gone = unused.at(wave_b)
        for group in groups(a.directions.theta_i, a.directions.phi_i, here_a):
            partner = _partner(a, group, b, pool)
            if partner is None:
                missing["at another incidence"] = missing.get("at another incidence", 0) + group.size
                continue
            incident = a.directions[group]
            normal = float(incident.phi_i[0]) if incident.theta_i.max() < SAME_ANGLE else None
            holes = gone.holes(b, partner, normal)
            nodes, weights, bend = interpolation(
                _places(incident, normal), _places(b.directions[partner], normal), holes, b.brdf[partner]
            )
            found = nodes[:, 0] >= 0
            if not found.all():
                reason = "outside the other's directions, or in a hole of them"
                missing[reason] = missing.get(reason, 0) + int((~found).sum())
            rows, near, w = group[found], partner[nodes[found]], weights[found]
            value[rows], error[rows] = (w * b.brdf[near]).sum(axis=1), bend[found]
            if b.covariance is not None:
                random[rows] = np.sqrt((w**2 * b.covariance.random[near] ** 2).sum(axis=1))
                common[rows] = (w[:, :, None] * b.covariance.common[near]).sum(axis=1)
    rows = np.flatnonzero(np.isfinite(value))
    return Carried(rows, value[rows], random[rows], common[rows], error[rows], {r: c for r, c in missing.items() if c})


@dataclass(frozen=True)
class _Places:
    """Receiver directions of one incidence."""

    points: Floats
    """(n, 3): position from the mirror direction in the plane of the sample, and cos(theta_r)."""
    signed: Floats
    """Angle along the plane of incidence, from the mirror direction [rad]."""
    inside: npt.NDArray[np.bool_]
    """Whether it lies in the plane of incidence."""


def _at(waves: Floats, wave: float) -> Rows:
    return np.flatnonzero(np.isnan(waves) if np.isnan(wave) else np.abs(waves - wave) <= SAME_BAND_NM)


def _places(d: Directions, normal: float | None) -> _Places:
    """Where directions lie; at normal incidence azimuths count from `normal`, as that of the source means nothing."""
    if normal is not None:
        d = d.seen_from(normal)
    points = d.from_incidence
    points[:, 0] += np.sin(d.theta_i)
    return _Places(points, d.signed - d.theta_i, d.in_plane)


@dataclass(frozen=True)
class _Unused:
    """The rows of a table that must not be used."""

    wavelength_nm: Floats
    directions: Directions
    source: Floats
    """(n, 3) unit vectors toward the source."""

    @classmethod
    def of(cls, b: Observations, table: pd.DataFrame) -> _Unused:
        """Those of B's table that are not in `b`; an angle that is not finite is nowhere, and leaves no hole."""
        unused = np.ones(len(table), dtype=bool)
        unused[b.rows] = False
        found = Directions.from_table(table)[unused]
        known = np.isfinite(found.angles).all(axis=0)
        waves = table["wavelength_nm"].to_numpy(np.float64)[unused][known]
        return cls(waves, found[known], found[known].vectors[0])

    def at(self, wave: float) -> _Unused:
        """Those at a wavelength [nm]."""
        here = _at(self.wavelength_nm, wave)
        return _Unused(self.wavelength_nm[here], self.directions[here], self.source[here])

    def holes(self, b: Observations, rows: Rows, normal: float | None) -> _Places:
        """Where those at the incidence of B's `rows` lie."""
        goal = b.directions[rows].vectors[0].mean(axis=0)
        here = np.linalg.norm(self.source - goal, axis=1) <= SAME_ANGLE
        return _places(self.directions[here], normal)


def _partner(a: Observations, group: Rows, b: Observations, pool: list[Rows]) -> Rows | None:
    """The rows of B with the incidence of a group of A."""

    def incidence(data: Observations, rows: Rows) -> Floats:
        return np.asarray(data.directions[rows].vectors[0].mean(axis=0))

    goal = incidence(a, group)
    off = [float(np.linalg.norm(incidence(b, rows) - goal)) for rows in pool]
    if not off or min(off) > SAME_ANGLE:
        return None
    return pool[int(np.argmin(off))]


def interpolation(goal: _Places, known: _Places, holes: _Places, values: Floats) -> tuple[Rows, Floats, Floats]:
    """Three neighbours for each goal (-1 where it has none), their weights, and the error of the interpolation."""
    from scipy.spatial import KDTree

    n = goal.signed.size
    nodes, weights, error = np.full((n, 3), -1), np.zeros((n, 3)), np.zeros(n)
    distance, nearest = KDTree(known.points).query(goal.points)
    same = distance <= SAME_DIRECTION
    nodes[same] = nearest[same, None]
    weights[same, 0] = 1.0
    line = np.flatnonzero(known.inside)
    along = np.flatnonzero(~same & goal.inside)
    if line.size > 1 and along.size:
        _along(goal, known, holes, values, along, line, (nodes, weights, error))
    if (~known.inside).any():
        rest = np.flatnonzero(nodes[:, 0] < 0)
        if rest.size:
            _across(goal, known, holes, values, rest, (nodes, weights, error))
    return nodes, weights, error


def _along(
    goal: _Places,
    known: _Places,
    holes: _Places,
    values: Floats,
    rows: Rows,
    line: Rows,
    out: tuple[Rows, Floats, Floats],
) -> None:
    """Along the plane of incidence, between the two neighbours."""
    x, first = np.unique(known.signed[line], return_index=True)
    line = line[first]
    if x.size < 2:
        return
    f = values[line]
    slope = np.gradient(f, x)
    t = goal.signed[rows]
    k = np.clip(np.searchsorted(x, t, side="right") - 1, 0, x.size - 2)
    gap = x[k + 1] - x[k]
    blocked = np.sort(holes.signed[holes.inside])
    free = np.searchsorted(blocked, x[k]) == np.searchsorted(blocked, x[k + 1])
    good = (t >= x[0]) & (t <= x[-1]) & (gap <= FARTHEST) & free
    rows, k, t, gap = rows[good], k[good], t[good], gap[good]
    w = (t - x[k]) / gap
    chord = (f[k + 1] - f[k]) / gap
    nodes, weights, error = out
    nodes[rows] = np.stack([line[k], line[k + 1], line[k]], axis=1)
    weights[rows, 0], weights[rows, 1] = 1 - w, w
    parabola = 0.5 * gap * w * (1 - w) * (np.abs(slope[k] - chord) + np.abs(slope[k + 1] - chord))
    error[rows] = np.maximum(parabola, _off_logarithms(values[nodes[rows]], weights[rows]))


def _off_logarithms(values: Floats, weights: Floats) -> Floats:
    """Difference (n,) of interpolating (n, 3) values or their logarithms; 0 where one is not positive."""
    positive = np.asarray((values > 0).all(axis=1))
    logs = np.log(np.where(positive[:, None], values, 1.0))
    return np.where(positive, (weights * values).sum(axis=1) - np.exp((weights * logs).sum(axis=1)), 0.0)


def _across(
    goal: _Places, known: _Places, holes: _Places, values: Floats, rows: Rows, out: tuple[Rows, Floats, Floats]
) -> None:
    """Over the hemisphere, in the triangle around a goal."""
    from scipy.spatial import Delaunay, QhullError

    flat = known.points[:, :2]
    try:
        mesh = Delaunay(flat)
    except QhullError:  # all on one line, or too few
        return
    corner = mesh.simplices
    edges = np.linalg.norm(known.points[corner] - known.points[np.roll(corner, 1, axis=1)], axis=2).max(axis=1)
    closed = edges > FARTHEST
    inside = mesh.find_simplex(holes.points[:, :2]) if holes.signed.size else np.empty(0, dtype=np.intp)
    closed[inside[inside >= 0]] = True
    found = mesh.find_simplex(goal.points[rows, :2])
    good = (found >= 0) & ~closed[found]
    rows, found = rows[good], found[good]
    turn = mesh.transform[found]
    part = np.einsum("nij,nj->ni", turn[:, :2], goal.points[rows, :2] - turn[:, 2])
    w = np.column_stack([part, 1 - part.sum(axis=1)])
    near = corner[found]
    own = _gradients(mesh, flat, values)
    # the interpolant's gradient: value = sum_k w_k f_k with w_0, w_1 linear in the position
    f = values[near]
    chord = np.einsum("nij,ni->nj", turn[:, :2], f[:, :2] - f[:, 2:])
    step = np.linalg.norm(flat[near] - goal.points[rows, None, :2], axis=2)
    nodes, weights, error = out
    nodes[rows], weights[rows] = near, w
    parabola = 0.5 * (w * np.linalg.norm(own[near] - chord[:, None], axis=2) * step).sum(axis=1)
    error[rows] = np.maximum(parabola, _off_logarithms(f, w))


def _gradients(mesh: Any, flat: Floats, values: Floats) -> Floats:
    """Gradient (n, 2) at every node, by least squares over its neighbours in the triangulation."""
    start, near = mesh.vertex_neighbor_vertices
    own = np.repeat(np.arange(len(flat)), np.diff(start))
    step, rise = flat[near] - flat[own], values[near] - values[own]
    square, side = np.zeros((len(flat), 2, 2)), np.zeros((len(flat), 2))
    np.add.at(square, own, step[:, :, None] * step[:, None, :])
    np.add.at(side, own, step * rise[:, None])
    return np.asarray(np.einsum("nij,nj->ni", np.linalg.pinv(square), side))
