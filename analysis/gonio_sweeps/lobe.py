"""Lobe and spike of a curve: a first guess of what is a lobe on a base, and a spike of the shape of the cones.

Lamp and lens are cones. What the lens sees of the lamp's mirror image is their overlap, whatever the sample is. So a
spike needs no resolution: a number for each angle of incidence, and how that changes with the angle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gonio.geometry import Directions
from gonio.lab.reduction.spikes import overlap
from gonio.models.gaussian_process import Coordinates
from gonio.typing import Floats

WIDTHS_DEG = (3.0, 8.0, 20.0)
"""Slopes of the facets, from which the search begins."""
FEWEST = 8
"""Values that are needed to tell a lobe's height, its width and the base from each other."""


def begun(at: Coordinates, f: Floats, u: Floats, used: npt.NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
    """Lobe and base [1/sr] of values, (n,) each: Gaussian slopes of one width over a constant, a height an incidence.

    The best of a few searches, by the squares of logarithms. None where there are too few values, or none above zero.
    """
    from scipy.optimize import least_squares

    good = used & (f > 3.0 * u)
    if good.sum() < FEWEST:
        return None
    _, which = np.unique(np.round(at.incidence, 3), axis=0, return_inverse=True)
    which = which.reshape(-1)
    count = int(which.max()) + 1
    square = np.tan(np.minimum(at.theta_h, 1.5)) ** 2
    log_f = np.log(f[good])

    def parts(x: Floats) -> tuple[Floats, Floats]:
        lobe = x[2:][which] - square * np.exp(-2.0 * x[1])
        return np.exp(np.maximum(lobe, x[0] - 30.0)), np.full(f.size, np.exp(x[0]))

    def away(x: Floats) -> Floats:
        lobe, base = parts(x)
        return np.log((lobe + base)[good]) - log_f

    best = None
    for width in WIDTHS_DEG:
        begin = np.concatenate([[np.percentile(log_f, 20.0), np.log(np.radians(width))], np.full(count, log_f.max())])
        found = least_squares(away, begin, loss="soft_l1", f_scale=0.1, max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return parts(best.x)


SAME = float(np.radians(1.0))
"""Angles of incidence that differ by less share a spike: encoders read steps."""
TILT = 0.2 / SAME
"""Standard deviation of the logarithm's slope over the angle [1/rad]: a reflectance that roughness lowers is steep."""
NODES = np.sqrt(3.0) * np.array([-1.0, 0.0, 1.0])
SHARES = np.array([1.0, 4.0, 1.0]) / 6.0
"""Gauss and Hermite's rule of three nodes."""
STANDS_OUT = 1.1
"""A value in the mirror direction above this many times any beyond the cones may be a spike."""


@dataclass(frozen=True)
class Spike:
    """Heights of spikes, for some angles of incidence."""

    cones: tuple[float, float]
    """Half angles of lamp and lens [rad]."""
    theta_i: Floats
    height: Floats
    """Height of the spike in the mirror direction [1/sr]."""

    def scaled(self, factor: Floats) -> Spike:
        """With other heights."""
        return replace(self, height=self.height * factor)

    def effects(self, d: Directions, read: float = 0.0) -> tuple[Floats, Floats]:
        """What a spike adds [1/sr], for each unknown (n, 2m), and its standard deviation (n,) by errors of the angles.

        The unknowns are the heights, in units of `height`, and for each the slope over the angle, in units of what is
        expected of it. `read` is the standard uncertainty of each angle [rad]; what is added is the mean over it.
        """
        own = np.abs(np.broadcast_to(d.theta_i, d.shape)[:, None] - self.theta_i) < SAME
        middle, square = np.zeros(d.shape), np.zeros(d.shape)
        chord, along = _offsets(d)
        for a, weight_a in zip(NODES, SHARES, strict=True):
            for b, weight_b in zip(NODES, SHARES, strict=True):
                # both angles move a point along the plane, one of them across it
                share = overlap(np.hypot(along + a * np.sqrt(2.0) * read, chord + b * read), *self.cones)
                middle += weight_a * weight_b * share
                square += weight_a * weight_b * share**2
        heights = np.where(own, self.height, 0.0)
        added = heights * middle[:, None]
        scatter = heights.sum(axis=1) * np.sqrt(np.maximum(square - middle**2, 0.0))
        return np.concatenate([added, added * (0.5 * TILT * along)[:, None]], axis=1), scatter

    @property
    def base(self) -> Floats:
        """The unknowns where nothing is wrong."""
        return np.repeat([1.0, 0.0], self.theta_i.size)


def _offsets(d: Directions) -> tuple[Floats, Floats]:
    """Angles from the mirror direction [rad]: across the plane of incidence, and in it."""
    omega = d.from_mirror
    x = -(omega[..., 0] * np.cos(d.phi_i) + omega[..., 1] * np.sin(d.phi_i))
    y = omega[..., 1] * np.cos(d.phi_i) - omega[..., 0] * np.sin(d.phi_i)
    return y, np.copysign(np.hypot(x, omega[..., 2]), x)


def within(d: Directions, cones: tuple[float, float]) -> npt.NDArray[np.bool_]:
    """Whether a direction sees anything of a spike."""
    return np.asarray(d.mirror_offset < sum(cones))


def suspected(d: Directions, f: Floats, cones: tuple[float, float]) -> Spike | None:
    """A spike wherever values near the mirror direction stand out of those beyond, and two of them can tell."""
    inside, theta_i = within(d, cones), np.broadcast_to(d.theta_i, d.shape)
    found: list[tuple[float, float]] = []
    left = np.flatnonzero(inside)
    while left.size:
        group = np.abs(theta_i - theta_i[left[0]]) < SAME
        left = left[~group[left]]
        near, beyond = np.flatnonzero(group & inside), np.flatnonzero(group & ~inside)
        if near.size < 2 or not beyond.size:
            continue
        top = float(f[near].max()) - float(f[beyond].max())
        if f[near].max() > STANDS_OUT * f[beyond].max() and top > 0:
            found.append((float(theta_i[near].mean()), top))
    return Spike(cones, np.array([t for t, _ in found]), np.array([h for _, h in found])) if found else None
