"""How a measured BRDF follows the angles: what a zero's error or an encoder's step does to each value of a run.

A value at the pose that was read is f(true directions) cos(true theta_i) / cos(read theta_i); with an underfilled
region theta_r stands for theta_i. How f changes is taken from the run's own values, which the instrument's cones have
smoothed already. They are split into

- a lobe, whose slopes and their uncertainties all points of a band tell together (`gonio.lab.reduction.lobe_surface`),
  and which may be steeper where a curve's steps do not resolve it (`gonio.lab.reduction.narrow_lobes`);
- a specular spike, which `gonio.lab.reduction.spikes` finds: its shape is the overlap of the lamp's mirror image with
  the lens.

Lobes change by ratios: the logarithm of f (asinh, which goes through zero) is taken for smooth. Effects are differences
over finite steps of +-u, since a slope is undefined at the top and at the edge of a spike.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.geometry import AT_NORMAL, SAME_NOMINAL, Directions
from gonio.lab.reduction.lobe_surface import Surface
from gonio.lab.reduction.narrow_lobes import steepest
from gonio.lab.reduction.spikes import OverlapFraction, SpikeScene, find, overlap
from gonio.typing import Bools, Floats, Ints

NARROWEST = math.radians(0.2)
"""Points closer than this do not tell a slope: encoder steps and noise would."""
UNDER_SPIKE = 0.03
"""Relative standard uncertainty of a lobe under a spike, at least."""
UNRESOLVED = 1.0
"""Steps over which ln f may change by more do not resolve a lobe."""
WITH_MIRROR = np.array([1.0, 0.0, 1.0, 0.0])
"""A step of the source that the detector follows: the mirror direction goes with it."""
ACROSS_MIRROR = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
"""Of steps, the square of how far the detector moves from the mirror direction: a lobe moves with it."""


def from_above(d: Directions, azimuth: float) -> Floats:
    """(x, y, theta_i, turn) [rad] of one pair of directions; smooth where an angle passes through the normal.

    The detector is seen from above the sample. x runs along the goal's plane of incidence, whose azimuth is given, and
    is positive on the mirror side; y runs across it. theta_i has the sign of its side. The turn is the azimuth of
    incidence on the sample.
    """
    theta_i, phi_i, theta_r, phi_r = d.floats
    along, across = theta_i * math.cos(phi_i - azimuth), theta_i * math.sin(phi_i - azimuth)
    # near the normal the source has no plane of incidence of its own: what lies across the goal's changes nothing
    signed = math.copysign(theta_i, along) if theta_i >= AT_NORMAL else along
    turn = math.atan2(across, along) if signed >= AT_NORMAL else 0.0  # rotate with the plane of incidence
    phi = phi_r - azimuth - turn
    return np.array([-theta_r * math.cos(phi), theta_r * math.sin(phi), signed, azimuth + turn])


@dataclass(frozen=True, slots=True)
class PointLobes:
    """What is known of the lobe and of the spike at each point [1/sr], and of their slopes [1/sr per rad]."""

    lobe: Floats
    spike: Floats
    u_spike: Floats
    slope: Floats
    """Along x, y, theta_i and the turn (`from_above`), shape (points, 4)."""
    u_slopes: Floats
    """Covariance of these, shape (points, 4, 4)."""
    curvature: Floats
    """Along x and y, shape (points, 2)."""

    @property
    def u_slope(self) -> Floats:
        """Standard uncertainty of the slopes of the detector, the larger of both."""
        return np.asarray(np.sqrt(np.maximum(self.u_slopes[:, 0, 0], self.u_slopes[:, 1, 1])))

    @property
    def u_slope_theta_i(self) -> Floats:
        """That of the slope of the source, which the detector follows."""
        return np.asarray(np.sqrt(np.einsum("i,nij,j->n", WITH_MIRROR, self.u_slopes, WITH_MIRROR)))


class BandCurves:
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
        What each point sees of a spike (`gonio.lab.reduction.spikes.blurred_overlap`).
    underfilled
        The flux of the whole beam is known, and not its irradiance: the cosine of the estimate is that of theta_r.
    """

    def __init__(
        self,
        goals: Directions,
        read: Directions,
        brdf: Floats,
        u: Floats,
        half_angles: tuple[float, float],
        shares: Sequence[OverlapFraction],
        underfilled: bool = False,
    ) -> None:
        self._half_angles, self._underfilled = half_angles, underfilled
        self._azimuth = goals.phi_i.tolist()
        self._places = np.array([from_above(d, a) for d, a in zip(read, self._azimuth, strict=True)]).reshape(-1, 4)
        x, y, theta_i, _ = self._places.T
        across = np.array([from_above(goal, a)[1] for goal, a in zip(goals, self._azimuth, strict=True)])
        in_plane = abs(across) < SAME_NOMINAL
        incidence = np.round(goals.theta_i / SAME_NOMINAL)
        groups = [np.flatnonzero(incidence == value) for value in np.unique(incidence)]
        middle = 0.5 * (read.theta_i + read.theta_r)
        seen = np.array([(s.mean, s.with_rare, s.at_read, s.most) for s in shares], dtype=float).reshape(-1, 4)
        mean, variance, at_read, most = seen.T
        scene = SpikeScene(
            theta_i, x - theta_i, y, in_plane, middle, brdf, u, mean, variance, at_read, most, half_angles
        )
        self.spikes = find(scene, groups)
        self.lobe, self.spike = self.spikes.lobe, self.spikes.amplitude
        small = max(3.0 * float(np.min(u, initial=np.inf)), 1e-9 * float(np.max(np.abs(brdf), initial=0.0)), 1e-300)
        log, size = np.arcsinh(self.lobe / (2 * small)), np.hypot(self.lobe, 2 * small)
        near = scene.most > 0.0
        count = len(brdf)
        self.slope, self._slope_uncertainty, self.curvature = (
            np.zeros((count, 4)),
            np.zeros((count, 4, 4)),
            np.zeros((count, 2)),
        )
        self.directed = False
        """Whether the sample has a direction: its values change as it spins."""
        if count:
            u_lobe = np.sqrt(u**2 + self.spikes.variance + near * (UNDER_SPIKE * self.lobe) ** 2)
            tells = self.spikes.told | ~near
            tells = tells if tells.any() else np.ones_like(tells)
            surface = Surface(self._places[tells], log[tells], (u_lobe / size)[tells])
            self.directed = surface.directed
            slope, covariance, curvature = surface.slopes(self._places)
            self.slope, self._slope_uncertainty = slope * size[:, None], covariance * size[:, None, None] ** 2
            self.curvature = abs(curvature * size[:, None] + slope[:, :2] ** 2 * self.lobe[:, None])
        plane = np.round(goals.phi_i / SAME_NOMINAL) if self.directed else np.zeros(count)
        lines = [group[in_plane[group] & (plane[group] == one)] for group in groups for one in np.unique(plane[group])]
        self._bound(brdf, u, size, near, lines)

    def _bound(
        self,
        brdf: Floats,
        u: Floats,
        size: Floats,
        near: Bools,
        lines: list[Ints],
    ) -> None:
        """Hold the slopes' uncertainties against the steepest that lobes may be (`gonio.lab.reduction.narrow_lobes`).

        Points that may see a spike (`near`) are left to what is known of that.
        """
        apart = max(NARROWEST, 0.5 * sum(self._half_angles))
        x, _, theta_i, _ = self._places.T
        for line in lines:
            curve = line[np.argsort((x - theta_i)[line], kind="stable")]
            # one or two points do not tell a spike from a narrow lobe
            values = (self.lobe if np.count_nonzero(near[curve] & self.spikes.told[curve]) >= 3 else brdf)[curve]
            bound = steepest(
                (x - theta_i)[curve], values, u[curve], theta_i[curve], abs(x[curve]), self._half_angles, apart
            )
            gaps = np.diff((x - theta_i)[curve])
            step = np.maximum(np.append(gaps, 0.0), np.append(0.0, gaps))
            # elsewhere the points tell the slope themselves
            coarse = ~near[curve] & (bound * step > UNRESOLVED * size[curve]) & (step > 0.0)
            curve, bound = curve[coarse], bound[coarse]
            more = bound**2 - self.slope[curve, 0] ** 2 - self._slope_uncertainty[curve, 0, 0]
            self._slope_uncertainty[curve] += np.maximum(more, 0.0)[:, None, None] * ACROSS_MIRROR

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
        return math.cos(d.theta_r if self._underfilled else d.theta_i)

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
        first = abs(self.slope[k, :3] @ (x.mean(), across.mean(), theta_i.mean()))
        return float(first + 0.5 * self.curvature[k] @ (np.var(x - theta_i), np.var(across)))

    def facts(self) -> PointLobes:
        """What of each point is known."""
        u_spike = self.spikes.u_amplitude * self.spikes.told
        return PointLobes(self.lobe, self.spike, u_spike, self.slope, self._slope_uncertainty, self.curvature)

    def slope_uncertainty(self, k: int, plus: Directions) -> float:
        """Standard uncertainty [1/sr] of the odd part of `effects`, from the uncertainty of the slopes."""
        step = from_above(plus, self._azimuth[k]) - self._places[k]
        return math.sqrt(max(float(step @ self._slope_uncertainty[k] @ step), 0.0))
