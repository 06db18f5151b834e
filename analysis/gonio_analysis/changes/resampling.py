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

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.geometry import FARTHEST, SAME_ANGLE, SAME_DIRECTION, Directions, direction, groups
from gonio.progress import Pace, Say, silent
from gonio.typing import Floats, Ints
from gonio_analysis.changes.edges import WINDOW, Edges
from gonio_analysis.fitting.observations import SAME_BAND_NM, Observations, Unused

TURN = float(np.radians(0.25))
"""Turn of directions for the slope along the plane of incidence [rad]."""

AT_ONCE = 1 << 16
"""Directions that are turned together: their vectors take 200 bytes each."""

MOST_KEPT = 200_000
"""Directions of the interpolations that are kept for further wavelengths: they take some 300 bytes each, and 1200 in
the plane of incidence."""

CLEAR = 5.0
"""Values have a logarithm where they are above so many standard uncertainties of their noise."""

LOUD = 1.7
"""Sum of the weights' sizes above which a cubic tells more noise than shape; at an end of even steps it is 1.63."""

HIGHER, LOWER = 1.1, 0.5
"""Factors on the error by six logarithms and on that by parabolas, so that 68 % of the true errors lie below the larger
one, on drawn models at steps of 5 degrees."""

ON_EDGE = 1e-12
"""Share of a triangle's height: a point that is less far outside lies on its edge."""


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
            off = [float(np.linalg.norm(one - _incidence(a, group))) for one in incidences]
            if not off or min(off) > SAME_ANGLE:
                missing["at another incidence"] = missing.get("at another incidence", 0) + group.size
                continue
            partner, incident = pool[int(np.argmin(off))], a.directions[group]
            normal = float(incident.phi_i[0]) if incident.theta_i.max() < SAME_ANGLE else None
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
    blocks = range(0, max(len(directions), 1), AT_ONCE)  # one block also where there are no directions
    turned, above = zip(*(_turned(directions[k : k + AT_ONCE], by) for k in blocks), strict=True)
    return Directions(*np.concatenate([one.angles for one in turned], axis=1)), np.concatenate(above)


def _turned(directions: Directions, by: float) -> tuple[Directions, Any]:
    source, receiver = directions.vectors
    across = np.column_stack([-np.cos(directions.phi_i), -np.sin(directions.phi_i)])
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
        ends = []
        for by in (TURN, -TURN):
            directions, above = turned_in_plane(alone.directions, by)
            kept = np.flatnonzero(above)
            carried = carry(replace(alone, directions=directions).take(kept), alone, known=known)
            values = np.full(here.size, np.nan)
            values[kept[carried.rows]] = carried.value
            ends.append(values)
        ahead, behind = (ends[0] - alone.brdf) / TURN, (alone.brdf - ends[1]) / TURN
        both = np.where(np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, 0.5 * (ahead + behind)))
        out[here] = np.nan_to_num(both)
    return out


@dataclass(frozen=True)
class _Places:
    """Receiver directions of one incidence."""

    points: Floats
    """(n, 3): position from the mirror direction in the plane of the sample, and cos(theta_r)."""
    signed: Floats
    """Angle along the plane of incidence, from the mirror direction [rad]."""
    inside: npt.NDArray[np.bool_]
    """Whether it lies in the plane of incidence."""

    @property
    def key(self) -> bytes:
        """The same for the same places."""
        digest = hashlib.blake2b(digest_size=16)
        for part in (self.points, self.signed, self.inside):
            digest.update(np.ascontiguousarray(part).data)
        return digest.digest()


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


def _places(d: Directions, normal: float | None) -> _Places:
    """Where directions lie; at normal incidence azimuths count from `normal`, as that of the source means nothing."""
    if normal is not None:
        d = d.seen_from(normal)
    points = d.from_incidence
    points[:, 0] += np.sin(d.theta_i)
    return _Places(points, d.signed - d.theta_i, d.in_plane)


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

    def at(self, b: Observations, rows: Ints, here: Ints, normal: float | None) -> _Places:
        """Where those among `here` lie that have the incidence of B's `rows`."""
        goal = b.directions[rows].vectors[0].mean(axis=0)
        here = here[np.linalg.norm(self.source[here] - goal, axis=1) <= SAME_ANGLE]
        return _places(self.directions[here], normal)


def _incidence(data: Observations, rows: Ints) -> Floats:
    """Mean unit vector toward the source."""
    at = data.directions
    return np.asarray(direction(at.theta_i[rows], at.phi_i[rows]).mean(axis=0))


class Interpolation:
    """Where goals lie among known directions: three neighbours each, and what tells the error from their values.

    All of it is of the directions alone, and most of it is slow: values at many wavelengths share it.
    """

    def __init__(self, goal: _Places, known: _Places, holes: _Places) -> None:
        from scipy.spatial import KDTree

        n = goal.signed.size
        self.nodes: Ints = np.full((n, 3), -1)
        """(n, 3) neighbours; -1 where a goal has none."""
        self.weights: Floats = np.zeros((n, 3))
        self._parts: list[_Along | _Across] = []
        distance, nearest = KDTree(known.points).query(goal.points)
        same = distance <= SAME_DIRECTION
        self.nodes[same] = nearest[same, None]
        self.weights[same, 0] = 1.0
        line = np.flatnonzero(known.inside)
        along = np.flatnonzero(~same & goal.inside)
        if line.size > 1 and along.size:
            self._take(_along(goal, known, holes, along, line))
        if (~known.inside).any():
            rest = np.flatnonzero(self.nodes[:, 0] < 0)
            if rest.size:
                self._take(_across(goal, known, holes, rest))

    def _take(self, part: _Along | _Across | None) -> None:
        if part is not None:
            self.nodes[part.rows], self.weights[part.rows] = part.nodes, part.weights
            self._parts.append(part)

    def of(self, values: Floats, noise: Floats | None) -> tuple[Ints, Floats, Floats]:
        """Of values in the known directions: nodes and weights (n, m), and the error; 0 in the same direction.

        `noise` is the values' independent standard uncertainty; None where none is stated.
        """
        nodes, weights, error = self.nodes, self.weights, np.zeros(len(self.nodes))
        for part in self._parts:
            error[part.rows] = np.maximum(part.parabola(values), _off_logarithms(values[part.nodes], part.weights))
            if isinstance(part, _Along) and part.rows.size and part.cubic.size:
                found, fine, off = part.finer(values, noise)
                if nodes is self.nodes:
                    nodes = np.concatenate([nodes, nodes[:, :1]], axis=1)
                    weights = np.concatenate([weights, np.zeros((len(weights), 1))], axis=1)
                rows = part.rows[found]
                nodes[rows], weights[rows], error[rows] = part.around[found], fine, off
        return nodes, weights, error


class Interpolations:
    """Interpolations that wavelengths with the same directions share: those that were used last."""

    def __init__(self) -> None:
        self._kept: dict[tuple[bytes, ...], Interpolation] = {}

    def between(self, goal: _Places, known: _Places, holes: _Places) -> Interpolation:
        """The interpolation of these directions."""
        key = tuple(p.key for p in (goal, known, holes))
        found = self._kept.pop(key, None) or Interpolation(goal, known, holes)
        self._kept[key] = found
        while len(self._kept) > 1 and sum(len(one.nodes) for one in self._kept.values()) > MOST_KEPT:
            del self._kept[next(iter(self._kept))]
        return found


@dataclass(frozen=True)
class _Along:
    """Goals along the plane of incidence, between two neighbours."""

    rows: Ints
    nodes: Ints
    weights: Floats
    line: Ints
    """All known directions of the plane, in their order."""
    x: Floats
    """Their angles [rad]."""
    left: Ints
    """Place of the left neighbour among them."""
    around: Ints
    """(n, 4) the neighbours of cubics; empty where there are fewer."""
    cubic: Floats
    """(n, 4) their weights; 0 where a cubic would reach across a hole or tell noise."""
    apart: Floats
    """(n, 4) half the difference of the parabolas through the first three and the last three."""
    six: Ints
    """(n, 6) the neighbours of polynomials through six; empty where there are fewer."""
    beyond: Floats
    """(n, 6) the difference of those and the cubics; 0 where one would reach across a hole or a gap."""
    edges: Edges | None
    """What edges do to the cubics; None where there are too few directions to see one."""

    def finer(self, values: Floats, noise: Floats | None) -> tuple[Ints, Floats, Floats]:
        """Which goals cubics of logarithms reach, their weights (m, 4), and the error."""
        f = values[self.around]
        clear = f > (0.0 if noise is None else CLEAR * noise[self.around])
        found = np.flatnonzero(clear.all(axis=1) & self.cubic.any(axis=1))
        f, w = f[found], self.cubic[found]
        logs = np.log(f)
        value = np.exp((w * logs).sum(axis=1))
        apart = (self.apart[found] * logs).sum(axis=1)
        if self.six.size:
            f_six = values[self.six[found]]
            clear = f_six > (0.0 if noise is None else CLEAR * noise[self.six[found]])
            far = np.asarray(clear.all(axis=1) & self.beyond[found].any(axis=1))
            logs_six = np.log(np.where(far[:, None], f_six, 1.0))
            beyond = (self.beyond[found] * logs_six).sum(axis=1)
            apart = np.where(far, np.maximum(HIGHER * np.abs(beyond), LOWER * np.abs(apart)), apart)
        if self.edges is not None:
            on_line = None if noise is None else noise[self.line]
            apart = np.maximum(np.abs(apart), self.edges.error(found, values[self.line], on_line))
        return found, w * value[:, None] / f, np.maximum(np.abs(value - (w * f).sum(axis=1)), value * np.abs(apart))

    def parabola(self, values: Floats) -> Floats:
        """The error that gradients tell."""
        f, k = values[self.line], self.left
        slope = np.gradient(f, self.x)
        gap = self.x[k + 1] - self.x[k]
        chord = (f[k + 1] - f[k]) / gap
        w = self.weights[:, 1]
        return np.asarray(0.5 * gap * w * (1 - w) * (np.abs(slope[k] - chord) + np.abs(slope[k + 1] - chord)))


@dataclass(frozen=True)
class _Across:
    """Goals over the hemisphere, in the triangles around them."""

    rows: Ints
    nodes: Ints
    weights: Floats
    turn: Floats
    """(n, 2, 2): of a triangle's plane."""
    step: Floats
    """(n, 3) distances to the neighbours."""
    own: Ints
    near: Ints
    """The edges of the triangulation, from node to node."""
    fit: Floats
    """(edges, 2): least-squares gradient at `own` for a rise of 1 along the edge."""

    def parabola(self, values: Floats) -> Floats:
        """The error that gradients tell."""
        rise = (values[self.near] - values[self.own])[:, None] * self.fit
        slope = np.stack([np.bincount(self.own, r, values.size) for r in rise.T], axis=1)
        # the interpolant's gradient: value = sum_k w_k f_k with w_0, w_1 linear in the position
        f = values[self.nodes]
        chord = np.einsum("nij,ni->nj", self.turn, f[:, :2] - f[:, 2:])
        curvature = np.linalg.norm(slope[self.nodes] - chord[:, None], axis=2)
        return np.asarray(0.5 * (self.weights * curvature * self.step).sum(axis=1))


def _along(goal: _Places, known: _Places, holes: _Places, rows: Ints, line: Ints) -> _Along | None:
    x, first = np.unique(known.signed[line], return_index=True)
    line = line[first]
    if x.size < 2:
        return None
    t = goal.signed[rows]
    k = np.clip(np.searchsorted(x, t, side="right") - 1, 0, x.size - 2)
    gap = x[k + 1] - x[k]
    blocked = np.sort(holes.signed[holes.inside])
    free = np.searchsorted(blocked, x[k]) == np.searchsorted(blocked, x[k + 1])
    good = (t >= x[0]) & (t <= x[-1]) & (gap <= FARTHEST) & free
    rows, k, t, gap = rows[good], k[good], t[good], gap[good]
    w = (t - x[k]) / gap
    nodes = np.stack([line[k], line[k + 1], line[k]], axis=1)
    weights = np.stack([1 - w, w, np.zeros(w.size)], axis=1)
    cubics = _cubics(line, x, k, t, blocked)
    edges = Edges.around(x, blocked, k, t, cubics[1], FARTHEST) if x.size >= WINDOW else None
    return _Along(rows, nodes, weights, line, x, k, *cubics, edges)


def _cubics(
    line: Ints, x: Floats, left: Ints, goal: Floats, blocked: Floats
) -> tuple[Ints, Floats, Floats, Ints, Floats]:
    """`_Along.around` to `beyond` of goals right of the nodes `left`."""
    none = np.zeros((goal.size, 0))
    if x.size < 4:
        return none.astype(line.dtype), none, none, none.astype(line.dtype), none

    def whole(at: Floats) -> npt.NDArray[np.bool_]:
        free = np.searchsorted(blocked, at[:, 0]) == np.searchsorted(blocked, at[:, -1])
        return np.asarray(free & (np.diff(at, axis=1).max(axis=1) <= FARTHEST))

    first = np.clip(left - 1, 0, x.size - 4)
    around = first[:, None] + np.arange(4)
    at = x[around]
    cubic, apart = _lagrange(at, goal), np.zeros(at.shape)
    apart[:, :3] += 0.5 * _lagrange(at[:, :3], goal)
    apart[:, 1:] -= 0.5 * _lagrange(at[:, 1:], goal)
    good = whole(at) & (np.abs(cubic).sum(axis=1) <= LOUD)
    if x.size < 6:
        return line[around], np.where(good[:, None], cubic, 0.0), apart, none.astype(line.dtype), none
    six = np.clip(left - 2, 0, x.size - 6)[:, None] + np.arange(6)
    beyond = _lagrange(x[six], goal)
    np.subtract.at(beyond, (np.arange(goal.size)[:, None], around - six[:, :1]), cubic)
    return (
        line[around], np.where(good[:, None], cubic, 0.0), apart,
        line[six], np.where(whole(x[six])[:, None], beyond, 0.0),
    )  # fmt: skip


def _lagrange(at: Floats, goal: Floats) -> Floats:
    """Weights (n, m) of values at m places each, for the polynomial through them at the goals (n,)."""
    out = np.ones(at.shape)
    for j in range(at.shape[1]):
        for k in range(at.shape[1]):
            if k != j:
                out[:, j] *= (goal - at[:, k]) / (at[:, j] - at[:, k])
    return out


def _off_logarithms(values: Floats, weights: Floats) -> Floats:
    """Difference (n,) of interpolating (n, 3) values or their logarithms; 0 where one is not positive."""
    positive = np.asarray((values > 0).all(axis=1))
    logs = np.log(np.where(positive[:, None], values, 1.0))
    return np.where(positive, (weights * values).sum(axis=1) - np.exp((weights * logs).sum(axis=1)), 0.0)


def _across(goal: _Places, known: _Places, holes: _Places, rows: Ints) -> _Across | None:
    from scipy.spatial import Delaunay, QhullError

    flat = known.points[:, :2]
    try:
        mesh = Delaunay(flat)
    except QhullError:  # all on one line, or too few
        return None
    corner = mesh.simplices
    edges = np.linalg.norm(known.points[corner] - known.points[np.roll(corner, 1, axis=1)], axis=2).max(axis=1)
    closed = edges > FARTHEST
    turn = _turns(flat[corner])
    inside, _ = _located(mesh, turn, holes.points[:, :2])
    closed[inside[inside >= 0]] = True
    found, weights = _located(mesh, turn, goal.points[rows, :2])
    good = (found >= 0) & ~closed[found]
    rows, found, weights = rows[good], found[good], weights[good]
    nodes = corner[found]
    step = np.linalg.norm(flat[nodes] - goal.points[rows, None, :2], axis=2)
    return _Across(rows, nodes, weights, turn[found], step, *_gradients(mesh, flat))


def _turns(corners: Floats) -> Floats:
    """(n, 2, 2): from a position less the third corner to the weights of the first two; NaN in a flat triangle.

    `Delaunay.transform` has them too, by one LAPACK call a triangle: a hundred times slower where BLAS has threads.
    """
    (a, b), (c, d) = np.moveaxis(corners[:, :2] - corners[:, 2:], 0, -1)
    area = a * d - b * c
    size = np.maximum(np.hypot(a, b), np.hypot(c, d)) ** 2
    area = np.where(np.abs(area) > 1e-12 * size, area, np.nan)
    return np.asarray(np.moveaxis(np.array([[d, -c], [-b, a]]) / area, -1, 0))


def _located(mesh: Any, turn: Floats, points: Floats) -> tuple[Ints, Floats]:
    """The triangle around each point (-1: outside all), and the weights of its corners.

    By walking across the edge that a point lies farthest beyond, from a triangle at the nearest node. In a Delaunay
    triangulation that ends; points that come to a flat triangle are compared with all.
    """
    from scipy.spatial import KDTree

    flat, corner = mesh.points, mesh.simplices

    def weights(points: Floats, triangle: Ints) -> Floats:
        part = np.einsum("...ij,...j->...i", turn[triangle], points - flat[corner[triangle, 2]])
        return np.concatenate([part, 1 - part.sum(axis=-1, keepdims=True)], axis=-1)

    found = mesh.vertex_to_simplex[KDTree(flat).query(points)[1]].astype(np.intp)
    moving, stuck = np.flatnonzero(found >= 0), np.flatnonzero(found < 0)
    for _ in range(len(corner)):
        if not moving.size:
            break
        part = weights(points[moving], found[moving])
        flat_one = np.isnan(part[:, 0])
        stuck = np.concatenate([stuck, moving[flat_one]])
        out = ~flat_one & (part.min(axis=1) < -ON_EDGE)
        moving, part = moving[out], part[out]
        found[moving] = mesh.neighbors[found[moving], part.argmin(axis=1)]
        moving = moving[found[moving] >= 0]
    every = np.arange(len(corner))
    for k in np.concatenate([stuck, moving]):
        least = np.nan_to_num(weights(points[k], every).min(axis=1), nan=-np.inf)
        found[k] = int(least.argmax()) if least.max() >= -ON_EDGE else -1
    return found, weights(points, found)


def _gradients(mesh: Any, flat: Floats) -> tuple[Ints, Ints, Floats]:
    """The edges of a triangulation, and the gradient at their first node, by least squares, for a rise of 1 on each."""
    start, near = mesh.vertex_neighbor_vertices
    own = np.repeat(np.arange(len(flat)), np.diff(start))
    step = flat[near] - flat[own]
    square = np.zeros((len(flat), 2, 2))
    np.add.at(square, own, step[:, :, None] * step[:, None, :])
    return own, near, np.asarray(np.einsum("nij,nj->ni", np.linalg.pinv(square)[own], step))
