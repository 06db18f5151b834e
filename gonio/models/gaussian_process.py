"""A Gaussian process for the logarithm of a BRDF, or of its ratio to a model, in which lobes are smooth.

What varies is a sum of parts, each with a width that the values themselves tell:

- a lobe, a function of the half vector's angle alone, the same for all incidences (facets, He-Torrance),
- a lobe of each incidence's own, over the half vector,
- a smooth part over the detector's direction, with the logarithm of cos theta_r,
- a part over the angle between source and detector, for what returns light.

The half vector's angle is warped, w = asinh(theta_h/h): even steps of w are dense at the mirror direction. The
process is that of [Rasmussen2006]_, chapters 2 and 5.

The scale is z = asinh(f/2e), with e five times the smallest uncertainty. Far above e it is the logarithm of f/e; below
it is proportional to f, so values under the noise keep their sign. The smooth part is stretched toward grazing by 1 +
1.5 tan(theta_r). Terms in tan(theta_h)^2 and in ln cos(theta_r) stand for Gaussian slopes and limbs. The covariance is
Matern's of 5/2; the smooth part's is Gaussian. Twelve parameters maximise likelihood times a wide prior.

Lobe and base are factors, or they are summands: f = e(exp(lobe) + exp(base)). The parts over the half vector belong to
the lobe, the returning part to the base, the smooth part to both. The sum stays where it makes the values more
probable. A specular spike is tried where values in the mirror direction stand out: the shape of the cones' overlap, a
height for each angle of incidence, and a slope. Lobe and base are tried with it as factors and as summands; the most
probable form is taken. Of more than 200 values the forms are compared again when a quarter more are there.

Each value is also predicted from all others: where these residuals scatter by more than 1.15 standard deviations,
intervals are widened by the scatter. What the values leave open of the kernel's parameters is added (Laplace's
approximation). No BRDF is below zero: where the process is, its uncertainty is that at least.
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
"""Step of the parameters' logarithms."""
JITTER = 1e-10


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


@dataclass(frozen=True)
class Scaled:
    """Parameters of the kernel as its loops take them."""

    lengths: tuple[float, ...]
    sizes: tuple[float, ...]
    h: float
    d0: float

    @classmethod
    def of(cls, p: Floats) -> Scaled:
        """From the parameters' logarithms."""
        h, lobe, l_lobe, own, l_own, view, l_view, l_incidence, retro, d0, facets = (float(x) for x in np.exp(p[:11]))
        sizes = (lobe**2, (own * lobe) ** 2, view**2, retro**2, facets**2)
        return cls((l_lobe, l_own, l_view, l_incidence), sizes, h, d0)

    def columns(self, at: Coordinates, prior: Prior) -> Floats:
        """What the kernel is a function of, (11, n)."""
        rho, turned = np.arcsinh(at.theta_h / self.h), np.arcsinh(at.apart / self.d0)
        fixed = [np.tan(at.theta_h) ** 2, np.full(rho.shape, prior.level), prior.cosine * at.log_cos]
        return np.array([rho, *(rho * at.toward.T), turned, *at.view.T, *at.incidence.T, *fixed])


@dataclass(frozen=True)
class PlacePairs:
    """Pairs of places."""

    a: Coordinates
    b: Coordinates
    prior: Prior = OF_CURVES

    def kernel(self, p: Floats) -> Floats:
        """Prior covariance."""
        return self.seen(*self.of_parts(p))

    def seen(self, of_lobe: Floats, of_base: Floats) -> Floats:
        """Covariance of the values, from those of lobe and base, by what is seen of both."""
        return np.outer(self.a.lobe, self.b.lobe) * of_lobe + np.outer(self.a.base, self.b.base) * of_base

    def of_parts(self, p: Floats) -> tuple[Floats, Floats]:
        """Prior covariances of the logarithms of lobe and base, whatever their shares are."""
        from gonio.models._gaussian_process_loops import covariances

        q = Scaled.of(p)
        a, b = (q.columns(at, self.prior) for at in (self.a, self.b))
        of_lobe, of_base = np.empty((2, a.shape[1], b.shape[1]))
        covariances(a, b, q.lengths, q.sizes, of_lobe, of_base)
        return of_lobe, of_base

    def slopes(self, p: Floats, weights: Floats) -> Floats:
        """Sums of `weights` (n, n) times the derivatives by the logarithms of the parameters but the last, (11,).

        Of places with themselves; of the weights the upper triangle counts.
        """
        from gonio.models._gaussian_process_loops import slopes

        q = Scaled.of(p)
        a = q.columns(self.a, self.prior)
        # d asinh(x/h)/d ln h = -(x/h)/sqrt(1 + (x/h)^2) = -tanh(asinh(x/h))
        bent = -np.tanh(a[[0, 0, 0, 3]])
        bent[1:3] *= self.a.toward.T
        shares = np.array([self.a.lobe, self.a.base])
        return np.array(slopes(a, shares, bent, weights, q.lengths, q.sizes))


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
    def pairs(self) -> PlacePairs:
        """Among the values."""
        return self.pairs_with(self.at)

    def pairs_with(self, places: Coordinates) -> PlacePairs:
        """Between places and the values."""
        return PlacePairs(places, self.at, self.prior)

    def only(self, kept: npt.NDArray[np.bool_]) -> Training:
        """Some of them."""
        return replace(self, at=self.at.only(kept), z=self.z[kept], u=self.u[kept], causes=self.causes[kept])

    def beside(self, mean: float) -> Floats:
        """The values less what the mean of the process gives them."""
        return self.z - mean * (self.at.lobe + self.at.base if self.summed else 1.0)

    @cached_property
    def common(self) -> Floats:
        """Covariance of the common causes."""
        return np.asarray(self.causes @ self.causes.T)


def objective(p: Floats, data: Training, mean: float) -> tuple[float, Floats]:
    """-ln of likelihood times prior of the parameters' logarithms, and its gradient."""
    from scipy.linalg import cho_factor, cho_solve, lapack

    k = data.pairs.kernel(p) + data.common
    noise = np.exp(2.0 * p[11]) * data.u**2
    on_diagonal = np.diag_indices(data.z.size)
    k[on_diagonal] += noise + JITTER
    away = (p - data.prior.centres) / data.prior.spreads
    try:
        factor = cho_factor(k.T, lower=True, overwrite_a=True)
    except np.linalg.LinAlgError:
        return 1e10, np.zeros_like(p)
    y = data.beside(mean)
    alpha = cho_solve(factor, y)
    value = 0.5 * y @ alpha + np.log(np.diag(factor[0])).sum() + 0.5 * away @ away
    # the inverse less alpha alpha': derivatives are symmetric, so that one triangle is enough
    weights = lapack.dpotri(factor[0], lower=1, overwrite_c=1)[0].T
    weights -= np.outer(alpha, alpha)
    weights[on_diagonal] *= 0.5
    slope = np.append(data.pairs.slopes(p, weights), 2.0 * weights[on_diagonal] @ noise)
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
POLISH = 4
"""Steps with all values, at most: a batch adds few values to many, and the next one goes on from there."""


def learned(data: Training, before: Floats | None = None, *, on: bool = False) -> Floats:
    """The most probable parameters of the kernel (logarithms), from several starts; `on` from those before alone.

    Of more than `ENOUGH` values so many are searched, evenly in their order, where there are no parameters before; all
    of them in a few last steps.
    """
    from scipy.optimize import minimize

    mean, bounds, many = float(np.median(data.z)), data.prior.bounds, data.z.size > ENOUGH

    def search(values: Training, start: Floats, steps: int) -> Any:
        options = {"maxiter": steps}
        return minimize(objective, start, (values, mean), jac=True, method="L-BFGS-B", bounds=bounds, options=options)

    best = before
    if best is None or not (many or on):
        kept = np.linspace(0, data.z.size - 1, min(data.z.size, ENOUGH)).astype(int)
        few = data.only(kept) if many else data
        found = [search(few, start, 60) for start in starts(before, data.prior)]
        best = min(found, key=lambda one: round(float(one.fun), 6)).x
    return np.asarray(search(data, best, POLISH if many else 60).x if many or on else best)


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
    with np.errstate(over="ignore"):  # a summand that a step took far off comes back by the next ones
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
    begun: tuple[Floats, Floats] | None = field(default=None, repr=False)
    """`parts`, where they are known: shares of lobe and base do not change them."""

    @cached_property
    def parts(self) -> tuple[Floats, Floats]:
        """Prior covariances of lobe and base among the values."""
        return self.data.pairs.of_parts(self.p) if self.begun is None else self.begun

    @cached_property
    def _factor(self) -> tuple[Any, Floats]:
        from scipy.linalg import cho_factor, cho_solve

        k = self.data.pairs.seen(*self.parts) + self.data.common
        k[np.diag_indices(self.data.z.size)] += np.exp(2.0 * self.p[11]) * self.data.u**2 + JITTER
        factor = cho_factor(k, lower=True)
        return factor, cho_solve(factor, self.data.beside(self.mean))

    def summands_at(self, places: Coordinates | None = None) -> tuple[Floats, Floats]:
        """The logarithms of lobe and base where these are summands; without places those of the values."""
        of_lobe, of_base = self.parts if places is None else self.data.pairs_with(places).of_parts(self.p)
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
        prior = PlacePairs(places, places, self.data.prior).kernel(self.p)
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
