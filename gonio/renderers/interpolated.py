"""A measured table as a BRDF in every direction: what lies between its directions, and what stands in for the rest.

The sample is taken as isotropic, with a left side like its right. Each angle of incidence of the table has a slice, in
the half vector's coordinates: its polar angle theta_h and its azimuth phi_h from the side of the source.

- In the plane of incidence a monotone cubic (PCHIP) goes through the values, over the signed theta_h; through their
  logarithms where all are positive. Beyond the first and the last value these stand.
- Out of it, brdf cos(theta_r) is that of the two in-plane directions of the same theta_h, weighted by
  (1 +- cos phi_h)/2: a straight line in the cosine of theta_d between them. A Lambertian surface stays one, and so does
  a microfacet lobe D(theta_h) F(theta_d) with F linear in that cosine.
- Where one of the two in-plane directions was not measured (it lies at the horizon, or below), values follow the other.
  The difference of the two dies away over 10 degrees of theta_h.
- Where there are values out of plane, their departures from these rules are interpolated linearly.
- Between angles of incidence brdf cos(theta_i) cos(theta_r) is linear at the same half vector. Beyond the first and the
  last: the nearest slice.

At the directions of the table the values are the table's.
"""

import math
from typing import Any

import numpy as np

from gonio import geometry
from gonio.errors import DataError
from gonio.renderers.channels import Rows
from gonio.typing import Bools, Floats, Ints

FEWEST = 3
"""Values that make a slice of an angle of incidence."""
_FADE = float(np.radians(10.0))
_LOWEST_COSINE = 0.01
"""A direction at or below the horizon of a slice weighs in as if at this cosine: a hundredth of the normal's weight."""


class Interpolated:
    """A table as a function of two directions.

    Parameters
    ----------
    rows
        What was measured.

    Raises
    ------
    DataError
        The table has no angle of incidence with enough values: pairs of random directions.
    """

    def __init__(self, rows: Rows) -> None:
        self.name, self.channels = rows.name, rows.values.shape[1]
        theta_i = rows.angles[:, 0]
        order = np.argsort(theta_i)
        groups = np.split(order, np.flatnonzero(np.diff(theta_i[order]) > geometry.SAME_ANGLE) + 1)
        kept = [g for g in groups if g.size >= FEWEST and np.ptp(theta_i[g]) < geometry.SAME_INCIDENCE]
        if not kept:
            raise DataError(
                f"{rows.name}: no angle of incidence has {FEWEST} values or more (scattered directions), and nothing"
                " can be filled in between; fit a model, save it (gonio fit --save), and convert that"
            )
        self.left_out = len(theta_i) - sum(g.size for g in kept)
        """Rows of angles of incidence that have too few."""
        self.incidences: Floats = np.array([theta_i[g].mean() for g in kept])
        """Incidences of the slices [rad], ascending."""
        self.slices = [Slice(rows.angles[g], rows.values[g]) for g in kept]
        self.receivers: Floats = np.unique(np.round(rows.angles[:, 1], 4))
        """The polar angles of the receiver in the table [rad]."""

    def brdf(self, omega_i: Floats, omega_r: Floats) -> Floats:
        """Values (n, channels) [1/sr] at unit vectors (n, 3) toward the source and the detector, above the surface."""
        theta_h, phi_h, theta_i = _half(omega_i, omega_r)
        out = np.zeros((len(theta_i), self.channels))
        total = np.zeros((len(theta_i), 1))
        for k, (here, weight) in self._around(theta_i).items():
            t, p, nominal = theta_h[here], phi_h[here], self.incidences[k]
            cos_d = np.cos(nominal) * np.cos(t) + np.sin(nominal) * np.sin(t) * np.cos(p)
            cos_r = 2 * cos_d * np.cos(t) - np.cos(nominal)
            part = (weight * np.cos(nominal) * np.maximum(cos_r, _LOWEST_COSINE))[:, np.newaxis]
            out[here] += part * self.slices[k].values(t, p)
            total[here] += part
        return out / total

    def measured(self, omega_i: Floats, omega_r: Floats) -> Bools:
        """Whether directions lie among measured ones, or else are extrapolated.

        Among: between two measured angles of incidence, and there in the plane of incidence (within half a step of the
        table) between the first and the last value, or in the triangles between values out of plane.
        """
        theta_h, phi_h, theta_i = _half(omega_i, omega_r)
        slack = geometry.SAME_ANGLE
        out = (theta_i >= self.incidences[0] - slack) & (theta_i <= self.incidences[-1] + slack)
        for k, (here, weight) in self._around(theta_i).items():
            out[here] &= (weight < 1e-9) | self.slices[k].measured(theta_h[here], phi_h[here])
        return np.asarray(out)

    def _around(self, theta_i: Floats) -> dict[int, tuple[Ints, Floats]]:
        """The places and weights of each slice that one of the angles lies at, or beside."""
        nodes = self.incidences
        out: dict[int, tuple[Ints, Floats]] = {}
        for k in range(nodes.size):
            weight = np.interp(theta_i, nodes, np.eye(nodes.size)[k])
            here = np.flatnonzero(weight > 0)
            if here.size:
                out[k] = here, weight[here]
        return out

    def extrapolated(self) -> float:
        """The share of the hemisphere (projected solid angle) that was not measured: mean over the incidences."""
        sin2, phi = np.meshgrid((np.arange(60) + 0.5) / 60, np.pi * (np.arange(90) + 0.5) / 90)
        outgoing = geometry.direction(np.arcsin(np.sqrt(sin2.ravel())), phi.ravel())
        shares = [
            1.0 - self.measured(np.broadcast_to(geometry.direction(t, 0.0), outgoing.shape), outgoing).mean()
            for t in self.incidences
        ]
        return float(np.mean(shares))

    @property
    def in_plane(self) -> bool:
        """Whether the table has in-plane values alone."""
        return all(s.triangles is None for s in self.slices)

    def reflectance(self, theta: Floats, *, viewer: bool = False, nodes: tuple[int, int] = (400, 90)) -> Floats:
        """rho_dh (directions, channels): the light from each direction that the interpolated table reflects.

        With `viewer` it is rho_hd, for directions of the detector. The integral runs over half vectors, close together
        about the mirror direction: `nodes` polar angles and azimuths.
        """
        side = (np.arange(nodes[0]) + 0.5) / nodes[0]
        azimuth = np.pi * (np.arange(nodes[1]) + 0.5) / nodes[1]
        theta_h, phi_h = (a.ravel() for a in np.meshgrid(np.pi / 2 * side**2, azimuth, indexing="ij"))
        cell = np.repeat(np.pi * side / side.size, azimuth.size) * (2 * np.pi / azimuth.size) * np.sin(theta_h)
        half = geometry.direction(theta_h, phi_h)
        out = np.zeros((theta.size, self.channels))
        for row, angle in zip(out, theta.tolist(), strict=True):
            given = geometry.direction(angle, 0.0)
            cosine = half @ given
            other = 2 * cosine[:, np.newaxis] * half - given
            above = (other[:, 2] > 0) & (cosine > 0)
            pair = np.broadcast_to(given, other[above].shape), other[above]
            values = self.brdf(*(pair[::-1] if viewer else pair))
            row[:] = (values * (4 * cosine * other[:, 2] * cell)[above, np.newaxis]).sum(axis=0)
        return out

    def unresolved(self) -> Floats:
        """The incidences [rad] whose lobe falls below half beside its largest value: narrower than the table's step."""
        return self.incidences[[s.unresolved for s in self.slices]]


class Slice:
    """The values of one angle of incidence over the half vector.

    Parameters
    ----------
    angles
        (n, 3): theta_i, theta_r, |phi_r - phi_i| [rad].
    values
        (n, channels) [1/sr], not negative.
    """

    def __init__(self, angles: Floats, values: Floats) -> None:
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

        theta_i, theta_r, dphi = angles.T
        self.theta_i = float(theta_i.mean())
        self.logarithmic = bool((values > 0).all())
        theta_h, phi_h, _ = _half(geometry.direction(theta_i, 0.0 * dphi), geometry.direction(theta_r, dphi))
        flat = np.sin(theta_r) * np.sin(dphi) <= math.sin(geometry.IN_PLANE)
        signed = np.where(np.cos(phi_h) >= 0, theta_h, -theta_h)[flat]
        self.step = math.inf
        self.line: Any = None
        self.reach = (0.0, 0.0)
        self.unresolved = False
        if signed.size:
            place, mean = _averaged(signed, self._to(values[flat]))
            self.line, self.reach = _Line(place, mean), (float(-place[0]), float(place[-1]))
            self.step = 2 * float(np.median(np.diff(place))) if place.size > 1 else math.inf
            self.unresolved = _narrow(place, self._from(mean))
        else:
            self.constant = self._to(values).mean(axis=0)
        self.triangles: Any = None
        if not flat.all():
            point = np.column_stack([theta_h * np.cos(phi_h), theta_h * np.abs(np.sin(phi_h))])
            excess = self._to(values) - self._base(theta_h, phi_h)
            excess[flat] = 0.0
            both = np.concatenate([point, point * [1.0, -1.0]])
            _, first, group = np.unique(
                np.round(both / geometry.SAME_DIRECTION), axis=0, return_index=True, return_inverse=True
            )
            count = np.bincount(group.ravel())
            total = np.zeros((first.size, values.shape[1]))
            np.add.at(total, group.ravel(), np.concatenate([excess, excess]))
            mean = total / count[:, np.newaxis]
            self.beyond = NearestNDInterpolator(both[first], mean)
            if first.size >= 4 and np.linalg.matrix_rank(both[first] - both[first[0]], tol=1e-6) == 2:
                self.triangles = LinearNDInterpolator(both[first], mean)

    def _to(self, values: Floats) -> Floats:
        return np.log(values) if self.logarithmic else values

    def _from(self, stored: Floats) -> Floats:
        return np.exp(stored) if self.logarithmic else np.maximum(stored, 0.0)

    def values(self, theta_h: Floats, phi_h: Floats) -> Floats:
        """Values (n, channels) [1/sr] at half vectors [rad]."""
        base = self._base(theta_h, phi_h)
        if self.triangles is not None:
            x, y = theta_h * np.cos(phi_h), theta_h * np.abs(np.sin(phi_h))
            excess = self.triangles(x, y)
            outside = np.isnan(excess).any(axis=1)
            excess[outside] = self.beyond(x[outside], y[outside])
            base = base + excess
        return self._from(base)

    def _base(self, theta_h: Floats, phi_h: Floats) -> Floats:
        """The in-plane curve swung out of the plane, or one level where nothing was measured in plane."""
        if self.line is None:
            return np.broadcast_to(self.constant, (*theta_h.shape, self.constant.size)).copy()
        forth, back = self.reach  # how far away from the source, and toward it
        if forth <= 0 or back <= 0:  # one side alone was measured
            return np.asarray(self.line(theta_h if back > 0 else -theta_h))
        common = np.minimum(theta_h, min(forth, back))
        near, far = self.line(common), self.line(-common)
        toward, away = (1 + np.cos(phi_h)) / 2, (1 - np.cos(phi_h)) / 2
        toward = toward * np.maximum(np.cos(self.theta_i - 2 * common), _LOWEST_COSINE)
        away = away * np.maximum(np.cos(self.theta_i + 2 * common), _LOWEST_COSINE)
        share = (toward / (toward + away))[:, np.newaxis]
        swung = self._to(share * self._from(near) + (1 - share) * self._from(far))
        longer, there = (1.0, near) if back > forth else (-1.0, far)
        beyond = np.maximum(theta_h - common, 0.0)[:, np.newaxis]
        return np.asarray(self.line(longer * theta_h) + (swung - there) * np.exp(-beyond / _FADE))

    def measured(self, theta_h: Floats, phi_h: Floats) -> Bools:
        """Whether half vectors [rad] lie among those of the values."""
        x, y = theta_h * np.cos(phi_h), theta_h * np.abs(np.sin(phi_h))
        out = np.zeros(x.shape, dtype=bool)
        if self.line is not None:
            slack = geometry.SAME_ANGLE
            out |= (2 * y <= self.step / 2) & (x >= -self.reach[0] - slack) & (x <= self.reach[1] + slack)
        if self.triangles is not None:
            out |= np.isfinite(self.triangles(x, y)).all(axis=1)
        return out


class _Line:
    """A monotone cubic through values (n, channels) at ascending places; one value is a constant."""

    def __init__(self, place: Floats, values: Floats) -> None:
        from scipy.interpolate import PchipInterpolator

        self.values = values
        self.cubic = None if place.size == 1 else PchipInterpolator(place, values, axis=0)
        self.ends = float(place[0]), float(place[-1])

    def __call__(self, x: Floats) -> Floats:
        if self.cubic is None:
            return np.broadcast_to(self.values[0], (x.size, self.values.shape[1]))
        return np.asarray(self.cubic(np.clip(x, *self.ends)))


def _half(omega_i: Floats, omega_r: Floats) -> tuple[Floats, Floats, Floats]:
    """theta_h, phi_h from the side of the source in [0, pi], and theta_i [rad], of unit vectors (n, 3)."""
    half = omega_i + omega_r
    theta_h = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    sine = np.hypot(omega_i[:, 0], omega_i[:, 1])
    upright = sine < 1e-12  # incidence along the normal: the x axis stands for its side
    x, y = np.where(upright, 1.0, omega_i[:, 0]), np.where(upright, 0.0, omega_i[:, 1])
    phi_h = np.abs(np.arctan2(x * half[:, 1] - y * half[:, 0], x * half[:, 0] + y * half[:, 1]))
    return theta_h, phi_h, np.arctan2(sine, omega_i[:, 2])


def _averaged(place: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Ascending places and the mean of the values at each; those within `geometry.SAME_DIRECTION` are one."""
    order = np.argsort(place, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(place[order]) > geometry.SAME_DIRECTION) + 1)
    return np.array([place[g].mean() for g in groups]), np.array([values[g].mean(axis=0) for g in groups])


def _narrow(place: Floats, values: Floats) -> bool:
    """Whether the values beside the largest one, around the mirror direction, lie below half of it."""
    level = values.mean(axis=1)
    k = int(np.argmax(level))
    beside = level[max(k - 1, 0) : k + 2]
    return bool(
        2 * abs(place[k]) < geometry.AROUND_MIRROR and beside.size == 3 and np.delete(beside, 1).max() < level[k] / 2
    )
