"""How a measured BRDF follows the angles: what a zero's error or an encoder's step does to each value of a run.

A value at the pose that was read is f(true directions) cos(true theta_i) / cos(read theta_i). How f changes is
taken from the run's own curves, which the instrument's cones have smoothed already. A curve is split into

- a lobe, smooth over the spacing of the points: its slope in theta_r is the curve's own; its change with theta_i at a
  fixed distance from the mirror direction comes from the curves of the neighbouring angles of incidence at that
  distance (zero without neighbours), because lobes move with the mirror direction; out of the plane of incidence it has
  the shape over the half vector's angle that the curves in the plane have, times what changes smoothly between points;
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

from gonio.geometry import AT_NORMAL, SAME_NOMINAL, Directions
from gonio.reduction.spikes import Scene, Share, find, lagrange, overlap
from gonio.typing import Floats

NARROWEST = math.radians(0.2)
"""Points closer than this do not tell a slope: encoder steps and noise would."""
FALL = 0.5
"""A curve has a peak at the mirror direction where its logarithm falls by more to the next point."""
PROBE = math.radians(0.5)
"""Step of differences along a curve."""
ALIKE = math.radians(10.0)
"""Curves whose angles of difference differ by this much are alike."""


def _from_above(d: Directions, azimuth: float) -> Floats:
    """(x, y, theta_i) [rad] of one pair of directions, which stay smooth where an angle passes through the normal.

    The detector is seen from above the sample: x along the goal's plane of incidence, whose azimuth is given, positive
    on the mirror side, and y across it; theta_i has the sign of its side.
    """
    theta_i, phi_i, theta_r, phi_r = d.floats
    along, across = theta_i * math.cos(phi_i - azimuth), theta_i * math.sin(phi_i - azimuth)
    # across a plane that the normal alone would define, theta_i does not change
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
        What each point sees of a spike (`gonio.reduction.spikes.blurred_overlap`).
    """

    def __init__(
        self,
        goals: Directions,
        read: Directions,
        brdf: Floats,
        u: Floats,
        half_angles: tuple[float, float],
        shares: Sequence[Share],
    ) -> None:
        self._half_angles = half_angles
        self._azimuth = goals.phi_i.tolist()
        self._places = np.array([_from_above(d, a) for d, a in zip(read, self._azimuth, strict=True)]).reshape(-1, 3)
        self._x, self._y, self._theta_i = np.ascontiguousarray(self._places.T)
        across = np.array([_from_above(goal, a)[1] for goal, a in zip(goals, self._azimuth, strict=True)])
        in_plane = abs(across) < SAME_NOMINAL
        incidence = np.round(goals.theta_i / SAME_NOMINAL)
        self._groups = [np.flatnonzero(incidence == value) for value in np.unique(incidence)]
        self._lines = [group[in_plane[group]] for group in self._groups]
        self._lines = [line[np.argsort(self._x[line])] for line in self._lines]
        middle = 0.5 * (read.theta_i + read.theta_r)
        scene = Scene(self._theta_i, self._x - self._theta_i, self._y, in_plane, middle, brdf, u, shares, half_angles)
        self.spikes = find(scene, self._groups)
        self.lobe, self.spike = self.spikes.lobe, self.spikes.amplitude
        small = max(3.0 * float(np.min(u, initial=np.inf)), 1e-9 * float(np.max(np.abs(brdf), initial=0.0)), 1e-300)
        self._log, self._size = np.arcsinh(self.lobe / (2 * small)), np.hypot(self.lobe, 2 * small)
        self.slope = np.zeros((len(brdf), 3))
        self._doubt = np.zeros(len(brdf))
        self.coarse = np.zeros(len(brdf), dtype=bool)
        """Points beside a peak that falls within one step: nothing tells how steep it is (docs/radiometry.md)."""
        logs = np.arcsinh(brdf / (2 * small))
        near = scene.most > 0.0
        for line, group in zip(self._lines, self._groups, strict=True):
            gap = self._fall(line, logs) if np.count_nonzero(near[line]) < 3 else 0.0
            apart = np.hypot(self._x[group] - self._theta_i[group], self._y[group])
            self.coarse[group] = ~near[group] & (apart < 1.6 * gap)
        for k, group in enumerate(self._groups):
            self._slopes_of(k, group, in_plane)

    def _fall(self, line: npt.NDArray[np.intp], logs: Floats) -> float:
        """The widest step [rad] of a curve beside the mirror direction over which its peak falls to its foot, or 0."""
        from_mirror, f = self._x[line] - self._theta_i[line], logs[line]
        widest = 0.0
        for side in (from_mirror, -from_mirror):
            order = np.argsort(side)
            order = order[side[order] > -0.6 * np.max(np.diff(np.sort(side)), initial=0.0)]
            steps, falls = np.diff(side[order]), -np.diff(f[order])
            for k in np.flatnonzero((side[order][:-1] < 0.6 * steps) & (falls > FALL) & (steps > 2 * NARROWEST)):
                if (
                    k + 1 >= falls.size or falls[k + 1] < falls[k]
                ):  # a lobe that the steps resolve falls faster farther out
                    widest = max(widest, float(steps[k]))
        return widest

    def _slopes_of(self, number: int, group: npt.NDArray[np.intp], in_plane: npt.NDArray[np.bool_]) -> None:
        """Derivatives of the lobe along x, y and theta_i for the points of one angle of incidence."""
        line = self._lines[number]
        for place, k in enumerate(line):
            self.slope[k, 0], self._doubt[k] = self._along_line(line, place)
        diagonal = np.array([self._along_mirror(number, int(k)) if in_plane[k] else 0.0 for k in group])
        self.slope[group, 2] = diagonal - self.slope[group, 0]
        for k in group[~in_plane[group]]:
            self.slope[k], self._doubt[k] = self._beyond(int(k), group)

    def _along_line(self, line: npt.NDArray[np.intp], place: int) -> tuple[float, float]:
        """Slope of the lobe along its curve, from the nearest points on each side that the cones tell apart.

        And its standard uncertainty: how much it differs from the slopes of the parabolas through two points on one
        side. Where the points resolve a lobe they agree; at its foot, or where it falls by a large factor from one
        point to the next, they do not.
        """
        x, f = self._x[line] - self._x[line[place]], self._log[line] - self._log[line[place]]
        apart = max(NARROWEST, 0.5 * sum(self._half_angles))
        found, parabolas = [], []
        for side in (np.flatnonzero(x <= -apart)[::-1], np.flatnonzero(x >= apart)):
            if side.size:
                a = side[0]
                found.append((f[a] / x[a], abs(x[a])))
                for b in side[abs(x[side] - x[a]) >= apart][:1]:
                    parabolas.append((f[a] * x[b] ** 2 - f[b] * x[a] ** 2) / (x[a] * x[b] * (x[b] - x[a])))
        slope, size = _weighted(found), float(self._size[line[place]])
        return slope * size, max((abs(p - slope) for p in parabolas), default=0.0) * size

    def _beyond(self, k: int, group: npt.NDArray[np.intp]) -> tuple[Floats, float]:
        """Slopes along x, y and theta_i of a point out of the plane of incidence, and their standard uncertainty.

        Where a lobe is narrower than the points are apart, they do not tell its flank. The curves in the plane do: what
        they say of its shape over the angle of the half vector is taken out, and only the rest is interpolated: by a
        parabola in x and in y, even in y, through the nearest points of the same incidence (both sides of the plane of
        incidence are alike). What is interpolated is uncertain by itself: where it is steep, points are too far apart.
        """
        here = np.array([self._x[k], self._y[k], self._theta_i[k]])
        distance = np.hypot(self._x[group] - here[0], np.abs(self._y[group]) - abs(here[1]))
        near = np.argsort(distance)
        near = near[distance[near] > SAME_NOMINAL][:7]
        weight, near = 1.0 / distance[near], group[near]
        probes = np.concatenate([here + PROBE * np.eye(3), here - PROBE * np.eye(3), [here]])
        places = np.stack([self._x[near], self._y[near], self._theta_i[near]], axis=1)
        x, y, theta_i = np.concatenate([probes, places]).T
        half, difference = Directions(theta_i, np.pi, np.hypot(x, y), np.arctan2(y, x)).half
        shape = self._profile(half, float(difference[6]))
        slopes: Floats = (shape[:3] - shape[3:6]) / (2 * PROBE)
        doubt = 0.0
        if near.size >= 2:
            dx, dy2 = self._x[near] - here[0], self._y[near] ** 2 - here[1] ** 2
            design = np.stack([dx, dy2, dx**2], axis=1)[:, : min(3, near.size)] * weight[:, None]
            length = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
            change = (self._log[near] - self._log[k] - (shape[7:] - shape[6])) * weight
            along, across = (np.linalg.lstsq(design / length, change, rcond=1e-3)[0] / length)[:2]
            slopes += np.array([along, 2.0 * here[1] * across, -along])
            doubt = math.hypot(along, 2.0 * here[1] * across)
        return slopes * float(self._size[k]), doubt * float(self._size[k])

    def _profile(self, half: Floats, difference: float) -> Floats:
        """Logarithm of the lobe in the plane of incidence, over angles of the half vector, near one of difference."""
        values, far = [], []
        for line in (line for line in self._lines if line.size >= 2):
            theta_i = float(np.mean(self._theta_i[line]))
            for side in (-half, half):
                x = theta_i + 2.0 * side
                inside = np.clip(x, self._x[line[0]], self._x[line[-1]])
                values.append(_cubic(inside, self._x[line], self._log[line]))
                far.append(np.hypot(theta_i + side - difference, x - inside) ** 2 / ALIKE**2)
        if not values:
            return np.zeros(half.size)
        weights = np.exp(-0.5 * (np.array(far) - np.min(far, axis=0)))
        return np.asarray((weights * np.array(values)).sum(axis=0) / weights.sum(axis=0))

    def _along_mirror(self, number: int, k: int) -> float:
        """Change of the lobe with theta_i at a fixed distance from the mirror direction, per radian.

        From the next curve on either side that reaches so far; at the ends of the angles of incidence from the parabola
        through the next two.
        """
        sides = []
        for others in (range(number - 1, -1, -1), range(number + 1, len(self._lines))):
            side: list[tuple[float, float]] = []  # (secant, its length)
            for line in (self._lines[other] for other in others if self._lines[other].size >= 2):
                move = float(np.mean(self._theta_i[line])) - self._theta_i[k]
                x = self._x[k] + move
                if self._x[line[0]] <= x <= self._x[line[-1]] and abs(move) > SAME_NOMINAL and len(side) < 2:
                    rise = float(_cubic(x, self._x[line], self._log[line])) - self._log[k]
                    side.append((rise / move, abs(move)))
            sides.append(side)
        below, above = sides
        if below and above:
            slope = _weighted([below[0], above[0]])
        elif len(below + above) == 2:
            (near, h), (far, w) = below + above
            slope = near + (near - far) * h / (w - h)
        else:
            slope = _weighted(below + above)
        return slope * float(self._size[k])

    def value(self, k: int, d: Directions) -> float:
        """f [1/sr] at directions near those of point k."""
        return self._values(k, [d])[0]

    def _values(self, k: int, near: list[Directions]) -> list[float]:
        steps = [_from_above(d, self._azimuth[k]) - self._places[k] for d in near]
        out = [float(self.lobe[k] + self.slope[k] @ step) for step in steps]
        if self.spike[k]:  # all in one call, which costs more than what it computes
            spikes = self.spike[k] * overlap(Directions.stack(near).mirror_offset, *self._half_angles)
            out = [lobe + spike for lobe, spike in zip(out, spikes.tolist(), strict=True)]
        return out

    def effects(self, k: int, read: Directions, plus: Directions, minus: Directions) -> tuple[float, float]:
        """Odd and even part [1/sr] of the change of point k when its true directions are `plus` or `minus`."""
        cosine = math.cos(read.theta_i)
        here, above, below = self._values(k, [read, plus, minus])
        up = above * math.cos(plus.theta_i) / cosine - here
        down = below * math.cos(minus.theta_i) / cosine - here
        return 0.5 * (up - down), 0.5 * (up + down)

    def doubt(self, k: int, plus: Directions) -> float:
        """Standard uncertainty [1/sr] of the odd part of `effects`, where steps are too coarse to tell a slope."""
        x, y, theta_i = (_from_above(plus, self._azimuth[k]) - self._places[k]).tolist()
        return float(self._doubt[k]) * math.hypot(x - theta_i, y)  # a lobe moves with the mirror direction


def _weighted(secants: list[tuple[float, float]]) -> float:
    """A slope from secants (slope, length) on either side: the nearer counts more, as in a second-order difference."""
    return float(np.average([s for s, _ in secants], weights=[1.0 / h for _, h in secants])) if secants else 0.0


def _cubic(x: npt.ArrayLike, at: Floats, values: Floats) -> Floats:
    """The cubic through the two points on each side of x; through all, where there are fewer than four.

    Points that are read closer together than a slope can be told from count once.
    """
    apart = np.concatenate([[True], np.diff(at) > 0.1 * NARROWEST])
    at, values, x = at[apart], values[apart], np.asarray(x, dtype=float)
    start = np.clip(np.searchsorted(at, x) - 2, 0, max(at.size - 4, 0))
    place = start[..., None] + np.arange(min(4, at.size))
    return lagrange(x, at[place], values[place])
