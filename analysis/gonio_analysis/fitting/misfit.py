"""What a model that is not true leaves over: how large it is, how it goes on between directions, what it does.

On the scale of `gonio_analysis.fitting.objective` (z = asinh(f/2e), ln f for all but the smallest values) measured less
fitted is noise and misfit. tau, the standard deviation of the misfit, is what makes the residuals most probable:
restricted maximum likelihood [Patterson1971]_, which takes account of the fitted parameters. The misfit is smooth over
directions. A Gaussian process describes it, whose amplitudes are held near tau by a prior: free, it would take the
model's place. See docs/misfit.md.

Away from the values the misfit has a second part. At the distance d from a value its standard deviation, of a
logarithm, is 0.8 misfit^0.4 d^1.3, at most 2, where d = 1 is as

- toward the lobe's peak: asinh(theta_h / 6 degrees) falls by 0.6; 1.8 where it rises,
- toward grazing light: theta_d - ln cos(theta_d) grows by 0.6; 1.8 where it falls,
- toward the limb: theta - ln cos(theta), of the more grazing of light and detector, grows by 2; 6 where it falls,
- around: sin(theta_h) sin(theta_d) times the azimuth changes by 1.5 rad.

theta_h lies between normal and half vector, theta_d between half vector and light. Toward the limb facets hide each
other, which no half vector tells. Of all values the one counts that tells most, by its distance and its own
uncertainty: one that says nothing changes nothing. Neighbours are off alike. The model's parameters count there in
full: the values that told them are far away.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.checks.values import NORMAL_95, Rows
from gonio.geometry import Directions
from gonio.models.corrected import LEVEL, Correction, folded
from gonio.models.gaussian_process import OF_CURVES, Coordinates, Prior, Process, Training, objective
from gonio.typing import Bools, Floats
from gonio_analysis.fitting.forward import sees_spike
from gonio_analysis.fitting.objective import Objective, on_log_scale
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import Covariance

SMALLEST, LARGEST = 1e-12, 1e3
"""Limits between which tau is sought."""
UNEXPLAINED = 1e-4
"""Probability of a chi-square with the misfit below which that does not explain the residuals: of 210 rejected fits of
eight tables one had 6e-12, the others 0.19 or more."""
TURNS = 8
"""Times that parameters and tau are found in turn, at most."""
SETTLED = 1e-3
"""Change of ln tau that ends it: a hundredth of what tau is uncertain by, or less."""
MOST_LEARNED = 100
"""Values that the process learns its parameters from, evenly taken of more: twenty steps take 50 ms."""
MOST_NODES = 300
"""Values that the process rests on, evenly taken of more."""
STEPS = 20
ROUGH = 0.1
"""Part of tau that is taken to vary from value to value, to begin with: a factor of three to either side."""
APART, WIDE, AZIMUTH = np.radians([10.0, 30.0, 45.0])
"""Angles of incidence that count as others, and sizes of the finest blocks."""
MANY, FEWEST_BLOCKS = 6, 3
"""Blocks that a range of angles is cut into, and how many it takes to leave one out."""
LEAST_LEFT = 1e-3
"""Part of what is known of a parameter that is left without a block, at least."""
WEIGHTY = 0.15
"""Part of a parameter's variance by blocks above which a block is fitted again."""
ABSENT = 1e-9
"""Amplitude of a part of the process that is left out, of tau."""
IMPOSSIBLE = 1e30
"""-2 ln of a likelihood that is 0."""
FARTHEST = 100.0
"""Distance of an end of tau's interval, in ln tau, beyond which nothing is known of it."""


def estimated_tau(z: Floats, jacobian: Floats, stated: Covariance | None, bright: Bools | None = None) -> float:
    """The misfit that makes residuals most probable, with the parameters fitted (REML).

    Values below e count as differences: where they are many and well known they can make it so small that it leaves the
    others unexplained (`UNEXPLAINED`). Then these tell it.

    Parameters
    ----------
    z : (n,) array
        Residuals on the scale of logarithms.
    jacobian : (n, p) array
        Their derivatives by the parameters that are not at a bound.
    stated
        Covariance of the values on the same scale; None where nothing is stated.
    bright
        Which values lie above e, shape (n,).
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import chdtrc

    n, p = jacobian.shape
    if stated is None:
        return max(math.sqrt(float(z @ z) / max(n - p, 1)), SMALLEST)
    unlikely = _unlikely(z, jacobian, stated)
    found = minimize_scalar(unlikely, bounds=(math.log(SMALLEST), math.log(LARGEST)), method="bounded")
    tau = math.exp(float(found.x))
    if bright is None or np.count_nonzero(bright) <= p or n <= p:
        return tau
    white = replace(stated, random=np.hypot(stated.random, tau)).whiten(z)
    if chdtrc(n - p, float(white @ white)) >= UNEXPLAINED:
        return tau
    return max(tau, estimated_tau(z[bright], jacobian[bright], stated.take(bright)))


def _unlikely(z: Floats, jacobian: Floats, stated: Covariance) -> Callable[[float], float]:
    """-2 ln of the restricted likelihood, of ln tau."""
    basis = np.linalg.qr(jacobian[:, np.linalg.norm(jacobian, axis=0) > 0])[0]

    def unlikely(log_tau: float) -> float:
        whole = replace(stated, random=np.hypot(stated.random, math.exp(log_tau)))
        white, columns = whole.whiten(z), whole.whiten(basis)
        value = float(white @ white) + whole.log_determinant + float(np.linalg.slogdet(columns.T @ columns)[1])
        return value if math.isfinite(value) else IMPOSSIBLE

    return unlikely


def groupings(directions: Directions) -> list[Rows]:
    """Ways to cut directions into blocks: a number for each direction, equal within a block.

    Angles of incidence, ranges of the detector's angle along the plane of incidence, and blocks of 30 degrees of it at
    each incidence, 45 degrees of azimuth wide. Neighbours, whose misfits are alike, stay together.
    """
    along, across = directions.along, np.abs(directions.dphi)
    incidence = np.round(directions.theta_i / APART).astype(np.intp)
    if np.unique(incidence).size > MANY:
        incidence = _ranges(directions.theta_i)
    wide = np.floor((along + math.pi / 2) / WIDE).astype(np.intp)
    fine = (incidence * 100 + wide) * 10 + np.floor((across % math.pi) / AZIMUTH).astype(np.intp)
    found = [np.unique(number, return_inverse=True)[1] for number in (incidence, _ranges(along), fine)]
    return [number for number in found if number.max() >= FEWEST_BLOCKS - 1] or [np.arange(along.size)]


def _ranges(angle: Floats) -> Rows:
    return np.asarray(np.digitize(angle, np.quantile(angle, np.linspace(0.0, 1.0, MANY + 1)[1:-1])), np.intp)


def block_spread(
    jacobian: Floats,
    residual: Floats,
    directions: Directions,
    again: Callable[[npt.NDArray[np.bool_], Floats], Floats] | None = None,
) -> Floats:
    """Covariance of fitted parameters by leaving out blocks of directions, one after the other.

    The jackknife of Kuensch [Kuensch1989]_, of each of `groupings`, and their mean. Left-out solutions are one linear
    step away. The few blocks that make the most of a variance are fitted again: there the way is bent.

    Parameters
    ----------
    jacobian : (m, p) array
        Derivatives of weighted residuals, by the parameters that are not at a bound; rows of priors follow those of
        the values.
    residual : (m,) array
        Weighted residuals.
    directions
        Of the values, shape (n,).
    again
        Rows that are kept (n,) and a start (p,), a step from the solution -> the step to the solution without them.
    """
    n, p = directions.theta_i.size, jacobian.shape[1]
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    basis, triangle = np.linalg.qr(jacobian / size)
    back = np.linalg.pinv(triangle, rcond=1e-10) / size[:, None]
    out = np.zeros((p, p))
    found = groupings(directions)
    for number in found:
        count = int(number.max()) + 1
        inner, slope = np.zeros((count, p, p)), np.zeros((count, p))
        np.add.at(inner, number, basis[:n, :, None] * basis[:n, None, :])
        np.add.at(slope, number, basis[:n] * residual[:n, None])
        values, vectors = np.linalg.eigh(np.eye(p) - inner)
        left = np.einsum("bij,bi->bj", vectors, basis.T @ residual - slope) / np.maximum(values, LEAST_LEFT)
        steps = -np.einsum("bij,bj->bi", vectors, left) @ back.T
        if again is not None:
            away = (steps - steps.mean(axis=0)) ** 2
            share = (away / np.maximum(away.sum(axis=0), 1e-300)).max(axis=1, initial=0.0)
            for k in np.flatnonzero(share > WEIGHTY):
                steps[k] = again(number != k, steps[k])
        away = steps - steps.mean(axis=0)
        out += (count - 1) / count * (away.T @ away) / len(found)
    return out


def u_of_log_tau(z: Floats, noise: Floats, tau: float, directions: Directions, freedom: int) -> float:
    """Standard uncertainty of ln tau, by leaving out blocks of directions.

    A value counts by what it tells of tau^2: the square of tau^2 / (tau^2 + its noise^2). One that is known poorly
    does not, for its square is noise.

    Parameters
    ----------
    z, noise : (n,) arrays
        Residuals on the scale of logarithms, and their standard uncertainties.
    tau, directions
        What was found, and where, shape (n,).
    freedom
        Values less fitted parameters, 1 or more.
    """
    weight = (tau**2 / (tau**2 + noise**2)) ** 2
    # few blocks may agree by chance: nothing is better known than with as many independent residuals
    least = math.sqrt(0.5 / max(float(weight.sum()) * freedom / z.size, 1.0))
    variances, part = [], weight * (z**2 - noise**2)
    for number in groupings(directions):
        total, count = np.bincount(number, part), np.bincount(number, weight)
        rest = count.sum() - count
        told = rest > LEAST_LEFT * count.sum()  # without a block that tells all, nothing is left to tell
        if np.count_nonzero(told) > 1:
            left = ((total.sum() - total) / np.where(told, rest, 1.0))[told]
            variances.append((left.size - 1) / left.size * float(((left - left.mean()) ** 2).sum()))
    by_blocks = math.sqrt(float(np.mean(variances))) if variances else math.inf
    return max(0.5 * by_blocks / tau**2, least)


@dataclass(frozen=True)
class Misfit:
    """The misfit of a fitted model."""

    tau: float
    """Relative standard deviation."""
    u_log: float
    """Standard uncertainty of ln tau, by leaving out blocks of directions."""
    small: float
    """e [1/sr] of the scale."""
    residuals: Training
    """Residuals on the scale of logarithms, with the stated uncertainties."""
    directions: Directions
    """Directions of the residuals, `folded` where the model is isotropic."""
    spike: float
    """Relative standard uncertainty of the model's specular spike."""

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of tau."""
        far = math.exp(min(NORMAL_95 * self.u_log, FARTHEST))
        return self.tau / far, self.tau * far

    @cached_property
    def correction(self) -> Correction:
        """What the residuals say of it, direction by direction; learned when it is first asked for."""
        from scipy.optimize import minimize

        whole = self.residuals
        prior, n = whole.prior, whole.z.size
        found = minimize(
            objective,
            prior.centres,
            (whole.only(_evenly(n, MOST_LEARNED)), 0.0),
            jac=True,
            method="L-BFGS-B",
            bounds=prior.bounds,
            options={"maxiter": STEPS},
        )
        kept = _evenly(n, MOST_NODES)
        process = Process(whole.only(kept), np.asarray(found.x), 0.0)
        wider = max(1.0, math.sqrt(float(np.mean(process.left_out**2))))
        return Correction(process, self.directions[kept], self.small, wider, self.spike)

    @property
    def left_out(self) -> float:
        """Median relative departure of a value from what all others say of it, noise included."""
        return float(np.median(np.abs(self.correction.process.left_out_departures)))


def misfit(model: Any, data: Observations, goal: Objective, predicted: Floats, freedom: int) -> Misfit:
    """The misfit of a model, from the residuals of a fit.

    Parameters
    ----------
    model, data
        What was fitted, and to what.
    goal
        What was made small, with its tau.
    predicted : (n,) array [1/sr]
        The fitted model.
    freedom
        Values less fitted parameters, 1 or more.
    """
    z = goal.scaled(data.brdf) - goal.scaled(predicted)
    stated = on_log_scale(data, goal.small, predicted)
    where = folded(data.directions, model)
    noise = np.zeros(len(data)) if stated is None else stated.random
    u = np.hypot(noise, ROUGH * goal.tau)
    common = np.zeros((len(data), 1)) if stated is None or not stated.causes else stated.common
    u_log = u_of_log_tau(z, noise, goal.tau, data.directions, freedom)
    spike = goal.tau if sees_spike(model, data) else 1.0  # a spike that no value has light of is a guess
    residuals = Training(Coordinates.of(where), z, u, common, prior=_prior(goal.tau))
    return Misfit(goal.tau, u_log, goal.small, residuals, where, spike)


def _prior(tau: float) -> Prior:
    """The process of curves, with amplitudes near tau."""
    centres, spreads = OF_CURVES.centres.copy(), OF_CURVES.spreads.copy()
    # lobe, own, view, retro, facets; then what differs from value to value. The part with the square of the facets'
    # slope has no end toward grazing directions, where nothing may be measured: there a misfit would outgrow the model
    for k, share in ((1, 1.0), (5, 1.0), (8, 0.3), (10, ABSENT)):
        centres[k], spreads[k] = math.log(share * tau), min(spreads[k], 1.0)
    centres[3] = math.log(0.7)
    spreads[-1] = 1.0
    return Prior(centres, spreads, level=LEVEL * tau, cosine=0.5 * tau)


def _evenly(n: int, most: int) -> npt.NDArray[np.bool_]:
    """Which of n values are kept: a mask."""
    return np.ones(n, dtype=bool) if n <= most else np.random.default_rng(0).permutation(n).argsort() < most
