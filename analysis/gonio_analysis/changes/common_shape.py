"""A scale, a zero and a scatter of each of several laboratories, about one shape that they make together.

Weighted least squares of each laboratory's values by the shape and by its slope over the angle of the receiver; with
weights that go with the shape, and with its scatter where that is larger than it states. docs/laboratories.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from gonio.checks.values import Rows
from gonio.typing import Floats
from gonio_analysis.changes.resampling import slope_in_plane
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import Covariance

ROUNDS = 100
"""Of scales, weights and scatters."""
SETTLED = 1e-10
"""Scales that change by less in a round have settled."""
FACTOR = 3.0
"""A stated uncertainty is carried over to a value at most so many times as large, or as small."""
UNDETERMINED = float(np.radians(1.0))
"""A zero that is known no better than this [rad] says nothing."""


@dataclass(frozen=True)
class LaboratoryValues:
    """One laboratory's values in the common directions."""

    value: Floats
    covariance: Covariance
    interpolated: int

    def take(self, rows: Rows) -> LaboratoryValues:
        """Some of them."""
        return LaboratoryValues(self.value[rows], self.covariance.take(rows), self.interpolated)


@dataclass(frozen=True)
class CommonShape:
    """Scales, zeros and scatters about one shape."""

    shape: Floats
    scales: Floats
    v_scales: Floats
    zeros: Floats
    """[rad], NaN where the shape does not show it."""
    v_zeros: Floats
    scatter: Floats
    p_scatter: Floats


def common_shape(at: Observations, found: Sequence[LaboratoryValues], keys: Sequence[Sequence[Any]]) -> CommonShape:
    """Scales, zeros and scatters of all laboratories about a shape that they make together."""
    y = np.array([one.value for one in found])
    scales = np.array([_ratio(row, np.median(y, axis=0)) for row in y])
    shape, scatter = np.mean(y / scales[:, None], axis=0), np.ones(len(y))
    slope = np.zeros(shape.size)
    for again in range(2):
        for _ in range(ROUNDS):
            before = scales
            covariances = [_at_the_shape(one, s * shape) for one, s in zip(found, scales, strict=True)]
            weights = np.array([s / (f * c.random) for s, f, c in zip(scales, scatter, covariances, strict=True)]) ** 2
            shape = np.sum(weights * y / scales[:, None], axis=0) / weights.sum(axis=0)
            fits = [
                _fitted(values, replace(c, random=c.random * max(f, 1.0)), shape, slope)
                for values, c, f in zip(y, covariances, scatter, strict=True)
            ]
            scales = np.array([fit.scale for fit in fits])
            off = [v - fit.scale * shape + fit.tilt * slope for v, fit in zip(y, fits, strict=True)]
            scatter, p_scatter = _scatters(off, covariances, weights / weights.sum(axis=0), bool(slope.any()))
            if np.all(np.abs(scales / before - 1.0) < SETTLED):
                break
        if again == 0:
            slope = slope_in_plane(replace(at, brdf=shape))
    tilts = np.array([fit.tilt / fit.scale if np.isfinite(fit.variance[1]) else np.nan for fit in fits])
    v_scales, v_tilts = (
        joint([fit.of_causes[p] for fit in fits], [fit.variance[p] for fit in fits], keys) for p in (0, 1)
    )
    return CommonShape(shape, scales, v_scales, tilts, v_tilts / np.outer(scales, scales), scatter, p_scatter)


def joint(effects: Sequence[Floats], variances: Sequence[float], keys: Sequence[Sequence[Any]]) -> Floats:
    """(K, K) covariance of one number of each laboratory: its variance, and what shared causes do to two of them."""
    known = list(dict.fromkeys(key for of_one in keys for key in of_one))
    by_cause = np.zeros((len(keys), len(known)))
    for k, (of_one, effect) in enumerate(zip(keys, effects, strict=True)):
        by_cause[k, [known.index(key) for key in of_one]] = effect
    out = by_cause @ by_cause.T
    np.fill_diagonal(out, variances)
    return np.asarray(out)


def _ratio(values: Floats, shape: Floats) -> float:
    """A first guess of a scale; above 0."""
    used = (values > 0.0) & (shape > 0.0)
    return float(np.median(values[used] / shape[used])) if used.any() else 1.0


def _at_the_shape(one: LaboratoryValues, expected: Floats) -> Covariance:
    """The covariance that a laboratory would state of the expected values.

    What it states of measured ones goes with their noise, and would give low values more weight. How uncertainties go
    with values the table shows.
    """
    c, y = one.covariance, one.value
    used = (y > 0.0) & (expected > 0.0)
    factor = np.where(used, np.clip(expected / np.where(used, y, 1.0), 1.0 / FACTOR, FACTOR), 1.0)
    power = 0.0
    if np.count_nonzero(used) > 2:
        x, r = np.log(expected[used]), np.log(c.random[used])
        spread = float(np.var(x))
        power = float(np.clip(np.mean((x - x.mean()) * (r - r.mean())) / spread, 0.0, 1.0)) if spread > 1e-4 else 1.0
    return Covariance(c.random * factor**power, c.scaled(factor).common, c.causes)


@dataclass(frozen=True)
class _Fit:
    """A laboratory's values by a shape and its slope."""

    scale: float
    tilt: float
    """The scale times the zero [rad]."""
    variance: Floats
    """Of both; infinite of a tilt that is undetermined."""
    of_causes: Floats
    """(2, causes) what one standard deviation of each cause does to both."""


def _fitted(values: Floats, covariance: Covariance, shape: Floats, slope: Floats) -> _Fit:
    columns = np.column_stack([shape, -slope])
    causes = covariance.whiten(covariance.common) if covariance.causes else np.zeros((values.size, 0))
    target = covariance.whiten(values)
    for used in (2, 1):
        if used == 2 and (values.size < 4 or not slope.any()):
            continue
        white = covariance.whiten(columns[:, :used])
        if used == 2 and np.linalg.cond(white / np.linalg.norm(white, axis=0)) > 1e6:
            continue
        solver = np.linalg.pinv(white)
        variance = np.sum(solver**2, axis=1)
        if used == 2 and np.sqrt(variance[1]) > UNDETERMINED * abs(float((solver @ target)[0])):
            continue
        found = np.zeros(2)
        found[:used] = solver @ target
        of_causes, of_both = np.zeros((2, causes.shape[1])), np.full(2, np.inf)
        of_causes[:used], of_both[:used] = solver @ causes, variance
        return _Fit(float(found[0]), float(found[1]), of_both, of_causes)
    raise AssertionError  # one column alone always goes


def _scatters(
    off: Sequence[Floats], covariances: Sequence[Covariance], shares: Floats, with_slope: bool
) -> tuple[Floats, Floats]:
    """How many times as much each laboratory scatters as it states, and the probability of as much by chance."""
    k, n = shares.shape
    scatter, p = np.ones(k), np.ones(k)
    if k < 3:
        return scatter, p
    for i, (residual, c) in enumerate(zip(off, covariances, strict=True)):
        free = np.maximum(1.0 - shares[i], 1e-6)
        freedom = float(free.sum()) - (2.0 if with_slope else 1.0) * float(free.mean())
        if freedom < 1.0:
            continue
        squares = Covariance(c.random * np.sqrt(free), c.common, c.causes).chi_square(residual)
        of_all = squares / max(n - (2.0 if with_slope else 1.0), 1.0)
        scatter[i], p[i] = np.sqrt(of_all), float(chdtrc(freedom, freedom * of_all))
    return scatter, p
