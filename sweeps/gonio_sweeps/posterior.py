"""What is known of curves after some points: the BRDF between them, with intervals that hold the common causes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import DataError
from gonio.geometry import Directions, direction
from gonio.typing import Floats
from gonio_sweeps.gaussian_process import Coordinates, Process, Values, learned

if TYPE_CHECKING:
    import pandas as pd

NEGLIGIBLE = 2e-6
"""Of the largest value: what is added to uncertainties, so that the faintest values do not bend the whole curve."""
FAINT = 10.0
"""Values below so many times the smallest uncertainty may be negative: the logarithm becomes the value itself."""
FEWEST = 3
SLOPE_STEP = float(np.radians(0.05))
"""Over which slopes are taken [rad]: an encoder's half step or so."""
K95 = 1.959964
MISFIT = 1.15
"""A root mean square of left-out residuals above it says that the process is smoother than the sample."""


@dataclass(frozen=True)
class Link:
    """z = asinh(f/2e): the logarithm of f/e for values far above e, and proportional to f below."""

    e: float

    def z(self, f: Floats) -> Floats:
        """On the scale of the process."""
        return np.arcsinh(f / (2.0 * self.e))

    def brdf(self, z: Floats) -> Floats:
        """Back [1/sr]."""
        return np.asarray(2.0 * self.e * np.sinh(z))

    def slope(self, f: Floats) -> Floats:
        """dz/df [sr]."""
        return np.asarray(1.0 / np.sqrt(f**2 + 4.0 * self.e**2))


@dataclass(frozen=True)
class AngleErrors:
    """Standard uncertainties of the angles [rad], in the plane of incidence and across it alike."""

    read: float
    """Of a reading, independent from point to point."""
    zero: float
    """Of the zeros of both arms, each common to all points."""


@dataclass(frozen=True)
class Posterior:
    """The BRDF in all directions, given the points of one band."""

    directions: Directions
    brdf: Floats
    u_random: Floats
    """Independent from point to point [1/sr]."""
    causes: Floats
    """(n, m) [1/sr]: the change of every value for one standard deviation of each common cause."""
    angles: AngleErrors | None = None
    """What `u_random` and `causes` do not hold yet: the slopes of the process tell what it does to each value."""
    before: Floats | None = None
    """Parameters of the kernel that were learned from fewer points."""

    @classmethod
    def of(cls, table: pd.DataFrame) -> Posterior:
        """From the rows of a measurement table that are to be used, all of one band.

        Raises
        ------
        DataError
            There are fewer than three such rows, or the table states no uncertainties.
        """
        used = table[(table["flag"] == "") & np.isfinite(table["brdf"])]
        if len(used) < FEWEST:
            raise DataError(f"{len(used)} usable points; a curve needs at least {FEWEST}")
        u = used["u_random"].to_numpy(np.float64) if "u_random" in used else np.full(len(used), np.nan)
        if not (np.isfinite(u) & (u > 0)).all():
            raise DataError(
                "the table states no uncertainty (u_random) for some of its points; intervals follow from it"
            )
        causes = [c for c in used.columns if c.startswith("s_")]
        common = np.nan_to_num(used[causes].to_numpy(np.float64))
        return cls(Directions.from_table(used), used["brdf"].to_numpy(np.float64), u, common)

    @cached_property
    def link(self) -> Link:
        """Of the scale that the process works on."""
        return Link(0.5 * FAINT * float(self._u.min()))

    @cached_property
    def _u(self) -> Floats:
        return np.hypot(self.u_random, NEGLIGIBLE * float(np.abs(self.brdf).max()))

    @cached_property
    def parameters(self) -> Floats:
        """Of the kernel, learned from these points."""
        return self._learned[1]

    @property
    def _values(self) -> Values:
        return self._learned[0]

    @cached_property
    def _learned(self) -> tuple[Values, Floats]:
        """The values on the scale of the process, and its parameters; twice where slopes have to be known first."""
        slope = self.link.slope(self.brdf)
        at, z, u, causes = Coordinates.of(self.directions), self.link.z(self.brdf), self._u * slope, self.causes
        values = Values(at, z, u, causes * slope[:, None])
        if self.angles is None:
            return values, learned(values, self.before)
        p = learned(values) if self.before is None else self.before
        by_detector, by_source, across = self._slopes(Process(values, p, float(np.median(z))), self.directions)
        u = np.sqrt(u**2 + self.angles.read**2 * (by_detector**2 + by_source**2 + across**2))
        zeros = self.angles.zero * np.stack([by_detector, by_source, across], axis=-1)
        values = Values(at, z, u, np.concatenate([values.causes, zeros], axis=-1))
        return values, learned(values, p)

    def _slopes(self, process: Process, d: Directions) -> tuple[Floats, Floats, Floats]:
        """Derivatives by theta_r, by theta_i, and by an angle across the plane of theta_r [1/rad]."""
        (omega_i, omega_r), h = d.vectors, SLOPE_STEP
        down_r, down_i = direction(d.theta_r + np.pi / 2, d.phi_r), direction(d.theta_i + np.pi / 2, d.phi_i)
        aside = direction(np.full(d.shape, np.pi / 2), d.phi_r + np.pi / 2)

        def by(source: Floats, detector: Floats) -> Floats:
            ends = [Directions.from_vectors(omega_i + k * h * source, omega_r + k * h * detector) for k in (1.0, -1.0)]
            plus, minus = (process.mean_at(Coordinates.of(end)) for end in ends)
            return (plus - minus) / (2.0 * h)

        none = np.zeros_like(omega_r)
        return by(none, down_r), by(down_i, none), by(none, aside)

    @cached_property
    def _process(self) -> Process:
        return Process(self._values, self.parameters, float(np.median(self._values.z)))

    @cached_property
    def _without_causes(self) -> Process:
        v = self._values
        return Process(Values(v.at, v.z, v.u, np.zeros((v.z.size, 1))), self.parameters, float(np.median(v.z)))

    @cached_property
    def left_out(self) -> Floats:
        """Of each point: its departure from what the others predict, in standard deviations."""
        return self._without_causes.left_out

    @property
    def misfit(self) -> float:
        """By how much intervals are widened: 1, or the scatter of left-out points where it is larger than it may be."""
        scatter = float(np.sqrt(np.mean(np.clip(self.left_out, -4.0, 4.0) ** 2)))
        return scatter if scatter > MISFIT else 1.0

    def expected(self, directions: Directions, noise: Floats) -> tuple[Floats, Floats, Floats]:
        """BRDF [1/sr]; covariance of what more points can tell; variance of one point, in each direction.

        Both are on the scale of the process, and leave out the common causes. `noise` is the relative standard
        uncertainty of points, that of their angles apart.
        """
        process = self._without_causes
        mean, covariance = process.at(Coordinates.of(directions))
        f = self.link.brdf(mean)
        u = np.hypot(noise * np.abs(f), NEGLIGIBLE * float(np.abs(self.brdf).max())) * self.link.slope(f)
        variance = np.minimum(u, 10.0) ** 2
        if self.angles is not None:
            variance = variance + self.angles.read**2 * sum(s**2 for s in self._slopes(process, directions))
        return f, covariance * self.misfit**2, variance

    def at(self, directions: Directions) -> tuple[Floats, Floats, Floats, Floats]:
        """BRDF, standard uncertainty, and the interval of 95 % [1/sr], common causes included."""
        mean, covariance = self._process.at(Coordinates.of(directions))
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0)) * self.misfit
        f = self.link.brdf(mean)
        low, high = self.link.brdf(mean - K95 * sd), self.link.brdf(mean + K95 * sd)
        return f, sd / self.link.slope(f), low, high


def bands(table: pd.DataFrame) -> list[pd.DataFrame]:
    """The rows of each wavelength and polarisation."""
    keys = [k for k in ("wavelength_nm", "polarisation") if k in table]
    return [part for _, part in table.groupby(keys, dropna=False, sort=True)] if keys else [table]
