"""A Gaussian process for the logarithm of a BRDF, or of its ratio to a model, in which lobes are smooth.

What varies is a sum of parts, each with a width that the values themselves tell:

- a lobe, a function of the half vector's angle alone, the same for all incidences (facets, He-Torrance),
- a lobe of each incidence's own, over the half vector,
- a smooth part over the detector's direction, with the logarithm of cos theta_r,
- a part over the angle between source and detector, for what returns light.

The half vector's angle is warped, w = asinh(theta_h/h): even steps of w are dense at the mirror direction. The
process is that of [Rasmussen2006]_, chapters 2 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.geometry import Directions
from gonio.typing import Floats

NAMES = ("h", "lobe", "l_lobe", "own", "l_own", "view", "l_view", "l_incidence", "retro", "apart", "facets", "noise")
"""Parameters of the kernel; all are fitted as logarithms."""
LIMB = 1.5
"""theta_r is stretched by 1 + LIMB tan(theta_r): shadowing sets in within the last degrees before grazing."""
CURVATURE_STEP = 1e-3
"""Of the parameters' logarithms."""
JITTER = 1e-10
SQRT5 = np.sqrt(5.0)


@dataclass(frozen=True)
class Prior:
    """What is taken of a process before any value is known."""

    centres: Floats
    """Logarithms of `NAMES`: widths [rad], lengths of w, amplitudes of the logarithm, factor of the noise."""
    spreads: Floats
    """Standard deviations of these logarithms."""
    level: float
    """Standard deviation of the mean."""
    cosine: float
    """Standard deviation of the power of cos theta_r: Lambert's is 0, Cook and Torrance's -1."""

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Where the parameters are sought: within three standard deviations."""
        return [(c - 3.0 * s, c + 3.0 * s) for c, s in zip(self.centres, self.spreads, strict=True)]


OF_CURVES = Prior(
    np.log(
        [np.radians(4.0), 0.5, 1.5, 0.4, 1.5, 0.5, np.radians(50.0), np.radians(30.0), 0.1, np.radians(6.0), 10.0, 1.0]
    ),
    np.array([1.0, 1.0, 0.7, 0.5, 0.7, 2.0, 0.6, 0.8, 2.0, 0.7, 2.0, 0.1]),
    level=5.0,
    cosine=1.0,
)
"""Of a BRDF's logarithm itself: each number within a factor of three or so."""


@dataclass(frozen=True)
class Coordinates:
    """Where values lie, as the kernel sees it."""

    theta_h: Floats
    toward: Floats
    """Unit vectors of the half vector's azimuth, (n, 2): x toward the mirror side of the plane of incidence."""
    view: Floats
    """theta_r along the two axes, (n, 2) [rad], stretched toward grazing."""
    incidence: Floats
    """theta_i along x and y of the sample, (n, 2) [rad]."""
    apart: Floats
    """Angle between source and detector [rad]."""
    log_cos: Floats
    lobe: Floats
    """(n,): how much of a change of the lobe's logarithm is seen in the value's; 1 where lobe and base are factors."""
    base: Floats
    """The same of the base."""

    def seen(self, lobe: Floats, base: Floats) -> Coordinates:
        """The same places with other shares of lobe and base."""
        return replace(self, lobe=lobe, base=base)

    def only(self, kept: npt.NDArray[np.bool_]) -> Coordinates:
        """Some of them."""
        return Coordinates(**{name: value[kept] for name, value in vars(self).items()})

    @classmethod
    def of(cls, d: Directions) -> Coordinates:
        """Those of directions, shape (n,)."""
        omega_i, omega_r = Directions(d.theta_i, np.zeros(d.shape), d.theta_r, d.phi_r - d.phi_i).vectors
        x, y, z = np.moveaxis(omega_i + omega_r, -1, 0)
        across = np.hypot(x, y)
        safe = np.where(across > 1e-12, across, 1.0)
        toward = np.stack([np.where(across > 1e-12, -x / safe, 1.0), np.where(across > 1e-12, y / safe, 0.0)], axis=-1)
        dphi = d.phi_r - d.phi_i
        theta_i, theta_r = np.broadcast_to(d.theta_i, d.shape), np.broadcast_to(d.theta_r, d.shape)
        log_cos = np.log(np.maximum(np.cos(theta_r), 1e-3))
        stretched = theta_r - LIMB * log_cos
        return cls(
            theta_h=np.arctan2(across, z),
            toward=toward,
            view=np.stack([-stretched * np.cos(dphi), stretched * np.sin(dphi)], axis=-1),
            incidence=np.stack([theta_i * np.cos(d.phi_i), theta_i * np.sin(d.phi_i)], axis=-1),
            apart=2.0 * d.half[1],
            log_cos=log_cos,
            lobe=np.ones(d.shape),
            base=np.ones(d.shape),
        )


def _apart(a: Floats, b: Floats) -> Floats:
    """Distances between rows of two numbers."""
    x, y = np.subtract.outer(a[:, 0], b[:, 0]), np.subtract.outer(a[:, 1], b[:, 1])
    return np.asarray(np.sqrt(x * x + y * y))


def _matern(r: Floats) -> Floats:
    """Matern's function of 5/2."""
    return np.asarray((1.0 + SQRT5 * r + 5.0 / 3.0 * r * r) * np.exp(-SQRT5 * r))


def _slope(r: Floats) -> Floats:
    """-(1/r) times its derivative."""
    return np.asarray(5.0 / 3.0 * (1.0 + SQRT5 * r) * np.exp(-SQRT5 * r))


class Pairs:
    """Distances between two sets of places that no parameter of the kernel changes."""

    def __init__(self, a: Coordinates, b: Coordinates, prior: Prior = OF_CURVES) -> None:
        self.a, self.b = a, b
        self.view = _apart(a.view, b.view)
        self.incidence = _apart(a.incidence, b.incidence)
        self.lobe, self.base = np.outer(a.lobe, b.lobe), np.outer(a.base, b.base)
        self.level = prior.level**2 + prior.cosine**2 * np.outer(a.log_cos, b.log_cos)
        self.squares = np.outer(np.tan(a.theta_h) ** 2, np.tan(b.theta_h) ** 2)
        self.one_incidence = not bool(self.incidence.any())

    def kernel(self, p: Floats) -> Floats:
        """Prior covariance."""
        of_lobe, of_base = self.of_parts(p)
        return self.lobe * of_lobe + self.base * of_base

    def of_parts(self, p: Floats) -> tuple[Floats, Floats]:
        """Prior covariances of the logarithms of lobe and base, whatever their shares are."""
        h, lobe, l_lobe, own, l_own, view, l_view, l_inc, retro, d0, facets = np.exp(p[:11])
        a, b = self.a, self.b
        rho_a, rho_b = np.arcsinh(a.theta_h / h), np.arcsinh(b.theta_h / h)
        of_lobe = lobe**2 * _matern(np.abs(np.subtract.outer(rho_a, rho_b)) / l_lobe)
        own_part = (own * lobe) ** 2 * _matern(_apart(rho_a[:, None] * a.toward, rho_b[:, None] * b.toward) / l_own)
        smooth = view**2 * np.exp(-0.5 * (self.view / l_view) ** 2)
        if not self.one_incidence:
            inc = _matern(self.incidence / l_inc)
            own_part, smooth = own_part * inc, smooth * inc
        s_a, s_b = np.arcsinh(a.apart / d0), np.arcsinh(b.apart / d0)
        of_base = retro**2 * _matern(np.abs(np.subtract.outer(s_a, s_b)))
        smooth = smooth + self.level
        return of_lobe + own_part + facets**2 * self.squares + smooth, of_base + smooth

    def gradient(self, p: Floats) -> tuple[Floats, list[Floats]]:
        """Prior covariance, and its derivatives by the logarithms of the parameters but the last."""
        h, lobe, l_lobe, own, l_own, view, l_view, l_inc, retro, d0, facets = np.exp(p[:11])
        own = own * lobe
        a, b, both = self.a, self.b, self.lobe + self.base
        rho_a, rho_b = np.arcsinh(a.theta_h / h), np.arcsinh(b.theta_h / h)
        r1 = np.abs(np.subtract.outer(rho_a, rho_b)) / l_lobe
        w_a, w_b = rho_a[:, None] * a.toward, rho_b[:, None] * b.toward
        r2, r3 = _apart(w_a, w_b) / l_own, self.view / l_view
        s_a, s_b = np.arcsinh(a.apart / d0), np.arcsinh(b.apart / d0)
        r4 = np.abs(np.subtract.outer(s_a, s_b))
        ri = self.incidence / l_inc
        inc = 1.0 if self.one_incidence else _matern(ri)
        k1, k2, k3, k4 = (
            lobe**2 * _matern(r1) * self.lobe,
            own**2 * _matern(r2) * self.lobe,
            view**2 * np.exp(-0.5 * r3**2) * both,
            retro**2 * _matern(r4) * self.base,
        )
        k5 = facets**2 * self.squares * self.lobe
        total = self.level * both + k1 + (k2 + k3) * inc + k4 + k5
        # d asinh(x/h)/d ln h = -(x/h)/sqrt(1 + (x/h)^2) = -tanh(asinh(x/h))
        t_a, t_b = -np.tanh(rho_a), -np.tanh(rho_b)
        d1 = lobe**2 * _slope(r1) * self.lobe
        d2 = own**2 * _slope(r2) * inc * self.lobe
        by_h = -d1 * np.subtract.outer(rho_a, rho_b) * np.subtract.outer(t_a, t_b) / l_lobe**2
        away_a, away_b = t_a[:, None] * a.toward, t_b[:, None] * b.toward
        for k in (0, 1):
            turned = np.subtract.outer(w_a[:, k], w_b[:, k]) * np.subtract.outer(away_a[:, k], away_b[:, k])
            by_h = by_h - d2 * turned / l_own**2
        v_a, v_b = -np.tanh(s_a), -np.tanh(s_b)
        by_d0 = -(retro**2) * self.base * _slope(r4) * np.subtract.outer(s_a, s_b) * np.subtract.outer(v_a, v_b)
        by_inc = np.zeros_like(total) if self.one_incidence else (k2 + k3) * _slope(ri) * ri**2
        return total, [
            by_h, 2.0 * (k1 + k2 * inc), d1 * r1**2, 2.0 * k2 * inc, d2 * r2**2, 2.0 * k3 * inc, k3 * r3**2 * inc,
            by_inc, 2.0 * k4, by_d0, 2.0 * k5,
        ]  # fmt: skip


@dataclass(frozen=True)
class Training:
    """What was measured, as the process sees it: on the scale of `Link`."""

    at: Coordinates
    z: Floats
    u: Floats
    """Standard uncertainties that are independent from value to value."""
    causes: Floats
    """(n, m): what one standard deviation of each common cause changes."""
    summed: bool = False
    """Whether lobe and base are summands; otherwise they are factors."""
    prior: Prior = OF_CURVES

    @cached_property
    def pairs(self) -> Pairs:
        """Among the values."""
        return self.pairs_with(self.at)

    def pairs_with(self, places: Coordinates) -> Pairs:
        """Between places and the values."""
        return Pairs(places, self.at, self.prior)

    def only(self, kept: npt.NDArray[np.bool_]) -> Training:
        """Some of them."""
        return replace(self, at=self.at.only(kept), z=self.z[kept], u=self.u[kept], causes=self.causes[kept])

    def beside(self, mean: float) -> Floats:
        """The values less what the mean of the process gives them."""
        return self.z - mean * (self.at.lobe + self.at.base if self.summed else 1.0)

    @property
    def common(self) -> Floats:
        """Covariance of the common causes."""
        return np.asarray(self.causes @ self.causes.T)


def objective(p: Floats, data: Training, mean: float) -> tuple[float, Floats]:
    """-ln of likelihood times prior of the parameters' logarithms, and its gradient."""
    from scipy.linalg import cho_factor, cho_solve

    k, by = data.pairs.gradient(p)
    noise = np.exp(2.0 * p[11]) * data.u**2
    n = data.z.size
    k = k + data.common
    k[np.diag_indices(n)] += noise + JITTER
    away = (p - data.prior.centres) / data.prior.spreads
    try:
        factor = cho_factor(k, lower=True)
    except np.linalg.LinAlgError:
        return 1e10, np.zeros_like(p)
    y = data.beside(mean)
    alpha = cho_solve(factor, y)
    inner = cho_solve(factor, np.eye(n)) - np.outer(alpha, alpha)
    value = 0.5 * y @ alpha + np.log(np.diag(factor[0])).sum() + 0.5 * away @ away
    slope = np.array([0.5 * (inner * d).sum() for d in by] + [(np.diag(inner) * noise).sum()])
    return float(value), slope + away / data.prior.spreads


def starts(seen: Floats | None, prior: Prior) -> list[Floats]:
    """Where the search for the parameters begins: wide and narrow lobes, and where it ended before."""
    out = []
    for h in (1.0, 4.0, 15.0):
        p = prior.centres.copy()
        p[0] = np.log(np.radians(h))
        out.append(p)
    return out if seen is None else [seen, out[1]]


ENOUGH = 200
"""Values that tell where the most probable parameters are, nearly: a search's time grows with their cube."""
POLISH = 8
"""Steps with all values."""


def learned(data: Training, before: Floats | None = None, *, on: bool = False) -> Floats:
    """The most probable parameters of the kernel (logarithms), from several starts; `on` from those before alone.

    Of more than `ENOUGH` values so many are searched, evenly in their order; all of them in a few last steps.
    """
    from scipy.optimize import minimize

    mean, bounds = float(np.median(data.z)), data.prior.bounds

    def search(values: Training, start: Floats, steps: int) -> Any:
        options = {"maxiter": steps}
        return minimize(objective, start, (values, mean), jac=True, method="L-BFGS-B", bounds=bounds, options=options)

    begin = [before] if on and before is not None else starts(before, data.prior)
    few = data
    if (count := data.z.size) > ENOUGH:
        kept = np.zeros(count, dtype=bool)
        kept[np.linspace(0, count - 1, ENOUGH).astype(int)] = True
        few = data.only(kept)
    best: Any = None
    for start in begin:
        found = search(few, start, 60)
        if best is None or found.fun < best.fun - 1e-6:
            best = found
    return np.asarray(best.x if few is data else search(data, best.x, POLISH).x)


def nearby(p: Floats, data: Training, mean: float) -> list[tuple[Floats, Floats]]:
    """Parameters a standard deviation away from the most probable ones, to both sides along each principal axis.

    Their distribution is taken for the normal one with its curvature there (Laplace's approximation).
    """
    step = CURVATURE_STEP * np.eye(p.size)
    rows = [(objective(p + h, data, mean)[1] - objective(p - h, data, mean)[1]) / (2.0 * CURVATURE_STEP) for h in step]
    curvature = np.array(rows)
    values, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    off = axes / np.sqrt(np.maximum(values, 1.0 / data.prior.spreads.max() ** 2))
    return [(p + a, p - a) for a in off.T]


def total(lobe: Floats, base: Floats) -> Floats:
    """z = asinh((e^lobe + e^base)/2), of the logarithms of both summands."""
    return np.asarray(np.arcsinh(0.5 * (np.exp(lobe) + np.exp(base))))


def shares(lobe: Floats, base: Floats) -> tuple[Floats, Floats]:
    """What a change of each summand's logarithm changes of z = asinh((e^lobe + e^base)/2)."""
    a, b = np.exp(lobe), np.exp(base)
    size = np.sqrt((a + b) ** 2 + 4.0)
    return a / size, b / size


@dataclass(frozen=True)
class Process:
    """The process given values and parameters."""

    data: Training
    p: Floats
    mean: float = field(default=0.0)

    @cached_property
    def _factor(self) -> tuple[Any, Floats]:
        from scipy.linalg import cho_factor, cho_solve

        k = self.data.pairs.kernel(self.p)
        k = k + self.data.common
        k[np.diag_indices(self.data.z.size)] += np.exp(2.0 * self.p[11]) * self.data.u**2 + JITTER
        factor = cho_factor(k, lower=True)
        return factor, cho_solve(factor, self.data.beside(self.mean))

    def summands_at(self, places: Coordinates) -> tuple[Floats, Floats]:
        """The logarithms of lobe and base where these are summands."""
        of_lobe, of_base = self.data.pairs_with(places).of_parts(self.p)
        alpha = self._factor[1]
        return (
            np.asarray(self.mean + of_lobe @ (self.data.at.lobe * alpha)),
            np.asarray(self.mean + of_base @ (self.data.at.base * alpha)),
        )

    def mean_at(self, places: Coordinates) -> Floats:
        """The mean at places."""
        if not self.data.summed:
            return np.asarray(self.mean + self.data.pairs_with(places).kernel(self.p) @ self._factor[1])
        return total(*self.summands_at(places))

    def seen(self, places: Coordinates) -> Coordinates:
        """With the shares of lobe and base that the means there give them."""
        return places.seen(*shares(*self.summands_at(places))) if self.data.summed else places

    @property
    def causes(self) -> Floats:
        """The mean of each common cause, in its standard deviations."""
        return np.asarray(self.data.causes.T @ self._factor[1])

    def covariance_at(self, places: Coordinates, effects: Floats | None = None) -> Floats:
        """Covariance at places; with `effects` (n, k) that of the process and what the first k causes add to it."""
        from scipy.linalg import solve_triangular

        places = self.seen(places)
        cross = self.data.pairs_with(places).kernel(self.p)
        prior = Pairs(places, places, self.data.prior).kernel(self.p)
        if effects is not None:
            cross = cross + effects @ self.data.causes[:, : effects.shape[1]].T
            prior = prior + effects @ effects.T
        half = solve_triangular(self._factor[0][0], cross.T, lower=True)
        return np.asarray(prior - half.T @ half)

    def changes_at(self, seen: Coordinates) -> Floats:
        """What the values change of the mean, where the shares of lobe and base are given."""
        return np.asarray(self.data.pairs_with(seen).kernel(self.p) @ self._factor[1])

    def prior_variance_at(self, places: Coordinates) -> Floats:
        """What the variance would be without values."""
        _, lobe, _, own, _, view, _, _, retro, _, facets = np.exp(self.p[:11])
        fixed = self.data.prior.level**2 + (self.data.prior.cosine * places.log_cos) ** 2
        of_lobe = fixed + view**2 + lobe**2 + (own * lobe) ** 2 + (facets * np.tan(places.theta_h) ** 2) ** 2
        return np.asarray(places.lobe**2 * of_lobe + places.base**2 * (fixed + view**2 + retro**2))

    def variance_at(self, places: Coordinates, effects: Floats | None = None) -> Floats:
        """The diagonal of `covariance_at`, where the shares of lobe and base are given: those of `seen`."""
        from scipy.linalg import solve_triangular

        prior = self.prior_variance_at(places)
        cross = self.data.pairs_with(places).kernel(self.p)
        if effects is not None:
            cross = cross + effects @ self.data.causes[:, : effects.shape[1]].T
            prior = prior + (effects**2).sum(axis=1)
        return np.asarray(prior - (solve_triangular(self._factor[0][0], cross.T, lower=True) ** 2).sum(axis=0))

    @cached_property
    def _left_out(self) -> tuple[Floats, Floats]:
        """Each value's departure from what all others predict of it, and the variance of that."""
        from scipy.linalg import cho_solve

        factor, alpha = self._factor
        variance = 1.0 / np.diag(cho_solve(factor, np.eye(alpha.size)))
        return alpha * variance, variance

    @property
    def left_out(self) -> Floats:
        """Each value's departure from what all others predict of it, in standard deviations of that."""
        departure, variance = self._left_out
        return np.asarray(departure / np.sqrt(variance))

    @property
    def left_out_departures(self) -> Floats:
        """Each value's departure from what all others predict of it."""
        return self._left_out[0]
