"""How a measured BRDF follows the angles: what a zero's error or an encoder's step does to each value of a run.

A value at the pose that was read is f(true directions) cos(true theta_i) / cos(read theta_i); with an under-filled
region theta_r stands for theta_i. How f changes is
taken from the run's own curves, which the instrument's cones have smoothed already. A curve is split into

- a lobe, smooth over the spacing of the points. Its slope in theta_r is the curve's own. Lobes move with the mirror
  direction, so its change with theta_i is taken at a fixed distance from it, from the curves of the neighbouring angles
  of incidence (zero without neighbours). Out of the plane of incidence the lobe has the shape over the half vector's
  angle that the curves in the plane have, times what changes smoothly between points;
- a specular spike, which `gonio.reduction.spikes` finds: its shape is the overlap of the lamp's mirror image with the
  lens.

Lobes change by ratios: between points the logarithm of f (asinh, which goes through zero) is taken for smooth.
Effects are differences over finite steps of +-u, since a slope is undefined at the top and at the edge of a spike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from gonio.geometry import AT_NORMAL, SAME_NOMINAL, Directions
from gonio.reduction.narrow_lobes import steepest
from gonio.reduction.spike_overlap import Share, overlap
from gonio.reduction.spikes import Scene, find, lagrange
from gonio.typing import Floats

NARROWEST = math.radians(0.2)
"""Points closer than this do not tell a slope: encoder steps and noise would."""
PROBE = math.radians(0.5)
"""Step of differences along a curve."""
STEEP = math.radians(87.0)
"""Beyond this angle of reflection the facets of a lobe hide each other: it rises no more as 1 / cos(theta_r)."""
AT_ONCE = 256
"""Points out of plane whose shapes are computed together: a few megabytes with hundreds of curves."""
AMONG = 24
"""How many of the points nearest to one are ranked to find its seven nearest: some may be equally far away."""
ALIKE = math.radians(10.0)
"""Curves whose angles of difference differ by this much are alike."""


def from_above(d: Directions, azimuth: float) -> Floats:
    """(x, y, theta_i) [rad] of one pair of directions, which stay smooth where an angle passes through the normal.

    The detector is seen from above the sample. x runs along the goal's plane of incidence, whose azimuth is given, and
    is positive on the mirror side; y runs across it. theta_i has the sign of its side.
    """
    theta_i, phi_i, theta_r, phi_r = d.floats
    along, across = theta_i * math.cos(phi_i - azimuth), theta_i * math.sin(phi_i - azimuth)
    # near the normal the source has no plane of incidence of its own: what lies across the goal's changes nothing
    signed = math.copysign(theta_i, along) if theta_i >= AT_NORMAL else along
    turn = math.atan2(across, along) if signed >= AT_NORMAL else 0.0  # rotate with the plane of incidence
    phi = phi_r - azimuth - turn
    return np.array([-theta_r * math.cos(phi), theta_r * math.sin(phi), signed])


class Curves:
    """The measured values of one band as a function of directions, good for small steps around each point.

    Parameters
    ----------
    goals
        Nominal directions: points with the same nominal angle of incidence make a curve.
    read
        The directions that were read.
    brdf, u
        Values and their independent standard uncertainties [1/sr].
    half_angles
        Of the lamp and of the lens [rad].
    shares
        What each point sees of a spike (`gonio.reduction.spike_overlap.blurred_overlap`).
    under_filled
        The flux of the whole beam is known, and not its irradiance: the cosine of the estimate is that of theta_r.
    """

    def __init__(
        self,
        goals: Directions,
        read: Directions,
        brdf: Floats,
        u: Floats,
        half_angles: tuple[float, float],
        shares: Sequence[Share],
        under_filled: bool = False,
    ) -> None:
        self._half_angles, self._under_filled = half_angles, under_filled
        self._azimuth = goals.phi_i.tolist()
        self._places = np.array([from_above(d, a) for d, a in zip(read, self._azimuth, strict=True)]).reshape(-1, 3)
        self._x, self._y, self._theta_i = np.ascontiguousarray(self._places.T)
        across = np.array([from_above(goal, a)[1] for goal, a in zip(goals, self._azimuth, strict=True)])
        in_plane = abs(across) < SAME_NOMINAL
        incidence = np.round(goals.theta_i / SAME_NOMINAL)
        self._groups = [np.flatnonzero(incidence == value) for value in np.unique(incidence)]
        self._lines = [group[in_plane[group]] for group in self._groups]
        self._lines = [line[np.argsort(self._x[line])] for line in self._lines]
        self._from_mirror = self._x - self._theta_i
        middle = 0.5 * (read.theta_i + read.theta_r)
        scene = Scene(self._theta_i, self._from_mirror, self._y, in_plane, middle, brdf, u, shares, half_angles)
        self.spikes = find(scene, self._groups)
        self.lobe, self.spike = self.spikes.lobe, self.spikes.amplitude
        small = max(3.0 * float(np.min(u, initial=np.inf)), 1e-9 * float(np.max(np.abs(brdf), initial=0.0)), 1e-300)
        self._log, self._size = np.arcsinh(self.lobe / (2 * small)), np.hypot(self.lobe, 2 * small)
        self._middles = [float(np.mean(self._theta_i[line])) if line.size else math.nan for line in self._lines]
        self._curves = [_distinct(self._x[line], self._log[line]) for line in self._lines]
        self.slope = np.zeros((len(brdf), 3))
        self.bend = np.zeros((len(brdf), 2))
        """Size of the lobe's second derivatives along and across the plane of incidence [1/sr per rad^2]."""
        self._doubt = np.zeros(len(brdf))
        self._diagonal_doubt = np.zeros(len(brdf))
        near = scene.most > 0.0
        for k, group in enumerate(self._groups):
            self._slopes_of(k, group, in_plane)
        self._bound(brdf, u, near)

    def _alone(self, line: npt.NDArray[np.intp]) -> bool:
        """Whether a curve is one point, measured once or several times."""
        return bool(line.size and np.ptp(self._x[line]) < NARROWEST)

    def _column(self, k: int) -> npt.NDArray[np.intp]:
        """The points in the plane that see the detector where point k has it, by their distance from the mirror.

        A run over theta_i at one theta_r. Its lobe moves with the mirror direction: it is a curve as good as any.
        """
        points = np.concatenate(self._lines)
        points = points[abs(self._x[points] - self._x[k]) < NARROWEST]
        return np.asarray(points[np.argsort(self._from_mirror[points])], dtype=np.intp)

    def _slopes_of(self, number: int, group: npt.NDArray[np.intp], in_plane: npt.NDArray[np.bool_]) -> None:
        """Derivatives of the lobe along x, y and theta_i for the points of one angle of incidence."""
        line = self._lines[number]
        for place, k in enumerate(line):
            curve = line
            if self._alone(line):
                curve = self._column(int(k))
                place = int(np.flatnonzero(curve == k)[0])
            self.slope[k, 0], self._doubt[k], self.bend[k] = self._along_line(curve, place)
        ground = float(np.min(self.lobe[line], initial=np.inf))
        for k in group:
            diagonal, doubt = self._along_mirror(number, int(k)) if in_plane[k] else (0.0, 0.0)
            self.slope[k, 2] = diagonal - self.slope[k, 0]
            # a lobe of facets changes by about tan(theta_i) + tan(theta_r), and a matte ground does not
            usual = math.tan(abs(self._theta_i[k])) + math.tan(min(abs(self._x[k]), STEEP))
            self._diagonal_doubt[k] = min(doubt, usual * max(float(self.lobe[k]) - ground, 0.0))
        beyond = group[~in_plane[group]]
        if beyond.size:
            tree = cKDTree(np.stack([self._x[group], np.abs(self._y[group])], axis=1))
            for start in range(0, beyond.size, AT_ONCE):
                self._beyond(beyond[start : start + AT_ONCE], group, tree)

    def _bound(self, brdf: Floats, u: Floats, near: npt.NDArray[np.bool_]) -> None:
        """Hold the slopes' uncertainties against the steepest that lobes may be (`gonio.reduction.narrow_lobes`).

        Points that may see a spike (`near`) are left to what is known of that.
        """
        apart = max(NARROWEST, 0.5 * sum(self._half_angles))
        for line in self._lines:
            columns = [self._column(int(line[0]))] if self._alone(line) else [line]
            for curve in columns:
                curve = curve[np.argsort(self._from_mirror[curve], kind="stable")]
                theta_i, theta_r = self._theta_i[curve], np.abs(self._x[curve])
                # one or two points do not tell a spike from a narrow lobe
                values = (self.lobe if np.count_nonzero(near[curve] & self.spikes.told[curve]) >= 3 else brdf)[curve]
                bound, falls = steepest(
                    self._from_mirror[curve], values, u[curve], theta_i, theta_r, self._half_angles, apart
                )
                own = np.isin(curve, line) & ~near[curve]
                k, bound, falls = curve[own], bound[own], falls[own]
                more = np.sqrt(np.maximum(bound**2 - self.slope[k, 0] ** 2, 0.0))
                self._doubt[k] = np.maximum(more, np.where(falls, np.minimum(self._doubt[k], bound), self._doubt[k]))

    def _along_line(self, line: npt.NDArray[np.intp], place: int) -> tuple[float, float, Floats]:
        """Slope of the lobe along its curve, from the nearest points on each side that the cones tell apart.

        And its standard uncertainty: how much it differs from the slopes of the parabolas through two points on one
        side. Where the points resolve a lobe they agree; at its foot, or where it falls by a large factor from one
        point to the next, they do not. And the size of the second derivatives, across the plane of incidence that of a
        lobe which is round in half vectors.
        """
        x, f = self._from_mirror[line] - self._from_mirror[line[place]], self._log[line] - self._log[line[place]]
        apart = max(NARROWEST, 0.5 * sum(self._half_angles))
        found, parabolas, curvature, beside = [], [], 0.0, []
        for side in (np.flatnonzero(x <= -apart)[::-1], np.flatnonzero(x >= apart)):
            if side.size:
                a = side[0]
                found.append((f[a] / x[a], abs(x[a])))
                beside.append((x[a], f[a] / x[a]))
                for b in side[abs(x[side] - x[a]) >= apart][:1]:
                    parabolas.append((f[a] * x[b] ** 2 - f[b] * x[a] ** 2) / (x[a] * x[b] * (x[b] - x[a])))
                    curvature = 2.0 * float(f[b] / x[b] - f[a] / x[a]) / float(x[b] - x[a])
        if len(beside) == 2:
            curvature = 2.0 * float(beside[1][1] - beside[0][1]) / float(beside[1][0] - beside[0][0])
        k = line[place]
        slope, size = _weighted(found), float(self._size[k])
        along = abs(curvature * size + slope**2 * float(self.lobe[k]))
        # a lobe is round in half vectors, which the cosine of the angle of difference makes narrower across the plane
        cosine = math.cos(0.5 * float(self._x[k] + self._theta_i[k]))
        across = max(along, abs(slope) * size / max(abs(float(self._from_mirror[k])), apart)) / cosine**2
        doubt = max((abs(p - slope) for p in parabolas), default=0.0) * size
        return slope * size, doubt, np.array([along, across])

    def _beyond(self, points: npt.NDArray[np.intp], group: npt.NDArray[np.intp], tree: cKDTree) -> None:
        """Slopes along x, y and theta_i of points out of the plane of incidence, and their standard uncertainty.

        And the size of the second derivatives along x and y.

        Where a lobe is narrower than the points are apart, they do not tell its flank. The curves in the plane do: what
        they say of its shape over the angle of the half vector is taken out, and only the rest is interpolated.
        """
        at = np.stack([self._x[points], np.abs(self._y[points])], axis=1)
        among = np.sort(tree.query(at, k=[*range(1, min(AMONG, group.size) + 1)])[1], axis=1)
        near = [self._nearest(int(k), group[some], group) for k, some in zip(points, among, strict=True)]
        places = [self._probes(int(k), around) for k, (around, _) in zip(points, near, strict=True)]
        found = [Directions(i, np.pi, np.hypot(x, y), np.arctan2(y, x)).half for x, y, i in (p.T for p in places)]
        differences = [np.full(half.size, difference[6]) for half, difference in found]
        shapes = self._profile(np.concatenate([half for half, _ in found]), np.concatenate(differences))
        ends = np.cumsum([len(place) for place in places])
        for k, (around, weight), shape in zip(points, near, np.split(shapes, ends[:-1]), strict=True):
            self.slope[k], self._doubt[k], self.bend[k] = self._apart_from(shape, int(k), around, weight)

    def _nearest(
        self, k: int, some: npt.NDArray[np.intp], group: npt.NDArray[np.intp]
    ) -> tuple[npt.NDArray[np.intp], Floats]:
        """The seven points nearest to point k, and their weights; both sides of the plane of incidence are alike.

        They are looked for among `some`, the nearest ones, and in the whole group where those do not tell. Of points
        that are equally far away the first ones of the run are taken.
        """
        distance = np.hypot(self._x[some] - self._x[k], np.abs(self._y[some]) - abs(self._y[k]))
        near = np.argsort(distance, kind="stable")
        near = near[distance[near] > SAME_NOMINAL][:7]
        # others may be as far away as the farthest of some; 1e-9 is above the rounding of the tree's distances
        if some.size < group.size and (near.size < 7 or distance[near[6]] > (1 - 1e-9) * distance.max()):
            return self._nearest(k, group, group)
        return some[near], 1.0 / distance[near]

    def _probes(self, k: int, near: npt.NDArray[np.intp]) -> Floats:
        """Places (x, y, theta_i) a step to either side of point k, its own, and those of points near it."""
        here = np.array([self._x[k], self._y[k], self._theta_i[k]])
        places = np.stack([self._x[near], self._y[near], self._theta_i[near]], axis=1)
        return np.concatenate([here + PROBE * np.eye(3), here - PROBE * np.eye(3), [here], places])

    def _apart_from(
        self, shape: Floats, k: int, near: npt.NDArray[np.intp], weight: Floats
    ) -> tuple[Floats, float, Floats]:
        """Slopes of point k, their standard uncertainty, and curvatures: of a lobe's shape and of what departs from it.

        The values over the shape are interpolated by a parabola in x and in y, even in y, through the nearest points
        of the same incidence. The slope of that counts as uncertain by itself: where it is steep, points are too far
        apart.
        """
        slopes: Floats = (shape[:3] - shape[3:6]) / (2 * PROBE)
        bends = (shape[:2] + shape[3:5] - 2.0 * shape[6]) / PROBE**2
        doubt = 0.0
        if near.size >= 2:
            dx, dy2 = self._x[near] - self._x[k], self._y[near] ** 2 - self._y[k] ** 2
            design = np.stack([dx, dy2, dx**2], axis=1)[:, : min(3, near.size)] * weight[:, None]
            length = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
            change = (self._log[near] - self._log[k] - (shape[7:] - shape[6])) * weight
            along, across, *rest = np.linalg.lstsq(design / length, change, rcond=1e-3)[0] / length
            bends += 2.0 * np.array([rest[0] if rest else 0.0, across])
            slopes += np.array([along, 2.0 * self._y[k] * across, -along])
            doubt = math.hypot(along, 2.0 * self._y[k] * across)
        size = float(self._size[k])
        return slopes * size, doubt * size, abs(bends * size + slopes[:2] ** 2 * float(self.lobe[k]))

    def _profile(self, half: Floats, difference: Floats) -> Floats:
        """Logarithm of the in-plane lobe at angles of the half vector, from curves at about the angle of difference."""
        values, far = [], []
        for line, theta_i, curve in zip(self._lines, self._middles, self._curves, strict=True):
            if line.size < 2:
                continue
            for side in (-half, half):
                x = theta_i + 2.0 * side
                inside = np.clip(x, self._x[line[0]], self._x[line[-1]])
                values.append(_cubic(inside, *curve))
                far.append(np.hypot(theta_i + side - difference, x - inside) ** 2 / ALIKE**2)
        if not values:
            return np.zeros(half.size)
        weights = np.exp(-0.5 * (np.array(far) - np.min(far, axis=0)))
        return np.asarray((weights * np.array(values)).sum(axis=0) / weights.sum(axis=0))

    def _along_mirror(self, number: int, k: int) -> tuple[float, float]:
        """Change of the lobe with theta_i at a fixed distance from the mirror direction, per radian.

        From the next curve on either side that reaches so far; at the ends of the angles of incidence from the parabola
        through the next two. And its standard uncertainty: a quarter of what the two sides differ by, or all that two
        curves on one side do; without two curves nothing tells it.
        """
        sides = []
        for others in (range(number - 1, -1, -1), range(number + 1, len(self._lines))):
            side: list[tuple[float, float]] = []  # (secant, its length)
            for other in others:
                line, move = self._lines[other], self._middles[other] - self._theta_i[k]
                x = self._x[k] + move
                if line.size >= 2 and self._x[line[0]] <= x <= self._x[line[-1]] and abs(move) > SAME_NOMINAL:
                    rise = float(_cubic(x, *self._curves[other])) - self._log[k]
                    side.append((rise / move, abs(move)))
                if len(side) == 2:
                    break
            sides.append(side)
        below, above = sides
        if below and above:
            slope, doubt = _weighted([below[0], above[0]]), 0.25 * abs(below[0][0] - above[0][0])
        elif len(below + above) == 2:
            (near, h), (far, w) = below + above
            slope, doubt = near + (near - far) * h / (w - h), abs(near - far)
        else:
            slope, doubt = _weighted(below + above), math.inf
        return slope * float(self._size[k]), doubt * float(self._size[k])

    def value(self, k: int, d: Directions) -> float:
        """f [1/sr] at directions near those of point k."""
        return self._values(k, [d])[0]

    def _values(self, k: int, near: list[Directions]) -> list[float]:
        steps = [from_above(d, self._azimuth[k]) - self._places[k] for d in near]
        out = [float(self.lobe[k] + self.slope[k] @ step) for step in steps]
        if self.spike[k]:  # one call for all of them: calling costs more than computing
            spikes = self.spike[k] * overlap(Directions.stack(near).mirror_offset, *self._half_angles)
            out = [lobe + spike for lobe, spike in zip(out, spikes.tolist(), strict=True)]
        return out

    def effects(self, k: int, read: Directions, plus: Directions, minus: Directions) -> tuple[float, float]:
        """Odd and even part [1/sr] of the change of point k when its true directions are `plus` or `minus`."""
        cosine = self._cosine(read)
        here, above, below = self._values(k, [read, plus, minus])
        up = above * self._cosine(plus) / cosine - here
        down = below * self._cosine(minus) / cosine - here
        return 0.5 * (up - down), 0.5 * (up + down)

    def _cosine(self, d: Directions) -> float:
        return math.cos(d.theta_r if self._under_filled else d.theta_i)

    def over_region(self, k: int, read: Directions, omega_i: Floats, omega_r: Floats) -> float:
        """What the lobe's slope and curvature change the mean over a region of interest by, at most [1/sr].

        Unit vectors to source and detector from every pixel of the region, shape (n, 3), and the directions that were
        read. The slope counts because the region's centroid is not the sample's centre: near pixels are larger.
        """
        at_i, phi_i, *_ = read.floats
        along = np.array([math.cos(phi_i), math.sin(phi_i), 0.0])
        theta_i = np.arctan2(omega_i @ along, omega_i[:, 2]) - at_i
        x = -np.arctan2(omega_r @ along, omega_r[:, 2])
        centre = read.vectors[1]
        x -= -math.atan2(float(centre @ along), float(centre[2]))
        across = (omega_r + omega_i - centre) @ (-along[1], along[0], 0.0)
        first = abs(self.slope[k] @ (x.mean(), across.mean(), theta_i.mean()))
        return float(first + 0.5 * self.bend[k] @ (np.var(x - theta_i), np.var(across)))

    def facts(self) -> dict[str, Floats]:
        """What of each point is known [1/sr, and per rad]: lobe, spike, slopes, their uncertainties, curvatures."""
        return {
            "lobe": self.lobe,
            "spike": self.spike,
            "u_spike": self.spikes.u_amplitude * self.spikes.told,
            "slope_x": self.slope[:, 0],
            "slope_y": self.slope[:, 1],
            "slope_theta_i": self.slope[:, 2],
            "u_slope": self._doubt,
            "u_slope_theta_i": self._diagonal_doubt,
            "bend_x": self.bend[:, 0],
            "bend_y": self.bend[:, 1],
        }

    def doubt(self, k: int, plus: Directions) -> float:
        """Standard uncertainty [1/sr] of the odd part of `effects`, where steps are too coarse to tell a slope."""
        x, y, theta_i = (from_above(plus, self._azimuth[k]) - self._places[k]).tolist()
        # a lobe moves with the mirror direction
        return math.hypot(float(self._doubt[k]) * math.hypot(x - theta_i, y), float(self._diagonal_doubt[k]) * theta_i)


def _weighted(secants: list[tuple[float, float]]) -> float:
    """A slope from secants (slope, length) on either side: the nearer counts more, as in a second-order difference."""
    return float(np.average([s for s, _ in secants], weights=[1.0 / h for _, h in secants])) if secants else 0.0


def _distinct(at: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Points of a curve; those too close together to give a slope count once."""
    apart = np.concatenate([[True], np.diff(at) > 0.1 * NARROWEST])[: at.size]
    return at[apart], values[apart]


def _cubic(x: npt.ArrayLike, at: Floats, values: Floats) -> Floats:
    """The cubic through the two points on each side of x; through all, where there are fewer than four."""
    x = np.asarray(x, dtype=float)
    start = np.clip(np.searchsorted(at, x) - 2, 0, max(at.size - 4, 0))
    place = start[..., None] + np.arange(min(4, at.size))
    return lagrange(x, at[place], values[place])
