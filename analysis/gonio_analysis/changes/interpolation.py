"""Interpolation between measured directions: neighbours, their weights, and the error that their values tell.

What is done, and why, stands in `gonio_analysis.changes.resampling`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.geometry import FARTHEST, SAME_DIRECTION
from gonio.typing import Floats, Ints
from gonio_analysis.changes.edges import WINDOW, Edges

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
class Places:
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


class Interpolation:
    """Where goals lie among known directions: three neighbours each, and what tells the error from their values.

    All of it is of the directions alone, and most of it is slow: values at many wavelengths share it.
    """

    def __init__(self, goal: Places, known: Places, holes: Places) -> None:
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

    def between(self, goal: Places, known: Places, holes: Places) -> Interpolation:
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


def _along(goal: Places, known: Places, holes: Places, rows: Ints, line: Ints) -> _Along | None:
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


@dataclass(frozen=True)
class _Mesh:
    """A triangulation of places in the plane."""

    points: Floats
    corners: npt.NDArray[np.int32]
    """(m, 3) nodes of each triangle."""
    beside: npt.NDArray[np.int32]
    """(m, 3) the triangle across from each corner; -1 where there is none."""
    first: npt.NDArray[np.int32]
    """(n,) a triangle at each node; -1 where it has none."""
    start: npt.NDArray[np.int32]
    near: npt.NDArray[np.int32]
    """Neighbours of node k: `near[start[k] : start[k + 1]]`."""


_meshes: dict[bytes, _Mesh] = {}
"""Those that were used last, of `MOST_KEPT` places: carrying back and slopes ask for them again."""


def _mesh(points: Floats) -> _Mesh:
    """The Delaunay triangulation of places (n, 2); raises `scipy.spatial.QhullError` where there is none."""
    from scipy.spatial import Delaunay

    key = hashlib.blake2b(np.ascontiguousarray(points).data, digest_size=16).digest()
    found = _meshes.pop(key, None)
    if found is None:
        made = Delaunay(points)
        found = _Mesh(points, made.simplices, made.neighbors, made.vertex_to_simplex, *made.vertex_neighbor_vertices)
    _meshes[key] = found
    while len(_meshes) > 1 and sum(len(one.points) for one in _meshes.values()) > MOST_KEPT:
        del _meshes[next(iter(_meshes))]
    return found


def _across(goal: Places, known: Places, holes: Places, rows: Ints) -> _Across | None:
    from scipy.spatial import QhullError

    flat = known.points[:, :2]
    try:
        mesh = _mesh(flat)
    except QhullError:  # all on one line, or too few
        return None
    corner = mesh.corners
    edges = np.linalg.norm(known.points[corner] - known.points[np.roll(corner, 1, axis=1)], axis=2).max(axis=1)
    closed = edges > FARTHEST
    turn = _turns(flat[corner])
    found, weights = _located(mesh, turn, np.concatenate([goal.points[rows, :2], holes.points[:, :2]]))
    inside, found, weights = found[rows.size :], found[: rows.size], weights[: rows.size]
    closed[inside[inside >= 0]] = True
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


def _located(mesh: _Mesh, turn: Floats, points: Floats) -> tuple[Ints, Floats]:
    """The triangle around each point (-1: outside all), and the weights of its corners.

    By walking across the edge that a point lies farthest beyond, from a triangle at the nearest node. In a Delaunay
    triangulation that ends; points that come to a flat triangle are compared with all.
    """
    from scipy.spatial import KDTree

    flat, corner = mesh.points, mesh.corners

    def weights(points: Floats, triangle: Ints) -> Floats:
        part = np.einsum("...ij,...j->...i", turn[triangle], points - flat[corner[triangle, 2]])
        return np.concatenate([part, 1 - part.sum(axis=-1, keepdims=True)], axis=-1)

    found = mesh.first[KDTree(flat).query(points)[1]].astype(np.intp)
    moving, stuck = np.flatnonzero(found >= 0), np.flatnonzero(found < 0)
    for _ in range(len(corner)):
        if not moving.size:
            break
        part = weights(points[moving], found[moving])
        flat_one = np.isnan(part[:, 0])
        stuck = np.concatenate([stuck, moving[flat_one]])
        out = ~flat_one & (part.min(axis=1) < -ON_EDGE)
        moving, part = moving[out], part[out]
        found[moving] = mesh.beside[found[moving], part.argmin(axis=1)]
        moving = moving[found[moving] >= 0]
    every = np.arange(len(corner))
    for k in np.concatenate([stuck, moving]):
        least = np.nan_to_num(weights(points[k], every).min(axis=1), nan=-np.inf)
        found[k] = int(least.argmax()) if least.max() >= -ON_EDGE else -1
    return found, weights(points, found)


def _gradients(mesh: _Mesh, flat: Floats) -> tuple[Ints, Ints, Floats]:
    """The edges of a triangulation, and the gradient at their first node, by least squares, for a rise of 1 on each."""
    own, n = np.repeat(np.arange(len(flat)), np.diff(mesh.start)), len(flat)
    x, y = (flat[mesh.near] - flat[own]).T
    xx, xy, yy = (np.bincount(own, part, n) for part in (x * x, x * y, y * y))
    size, area = xx + yy, xx * yy - xy * xy
    flat_one = ~(area > 1e-10 * size * size)  # neighbours on a line: the inverse of what there is
    inverse = np.array([yy, -xy, xx]) / np.where(flat_one, 1.0, area)
    for k in np.flatnonzero(flat_one):
        inverse[:, k] = np.linalg.pinv(np.array([[xx[k], xy[k]], [xy[k], yy[k]]])).ravel()[[0, 1, 3]]
    a, b, c = inverse[:, own]
    return own, mesh.near.astype(np.intp), np.stack([a * x + b * y, b * x + c * y], axis=1)
