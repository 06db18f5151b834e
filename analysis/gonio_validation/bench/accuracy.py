"""Errors of the ways against the reference samples."""

import warnings
from dataclasses import dataclass

import numpy as np

from gonio.shown import finite
from gonio.typing import Floats
from gonio_validation.bench.quantity import SETS, BenchQuantity, BenchSample, ErrorSummary, Set, Way

NOTHING = 1e-290
"""References below this count as 0."""


@dataclass(frozen=True)
class Errors:
    """What a way made of some samples; NaN and infinite results count as infinite errors."""

    scaled: Floats
    """Relative error over 1 + conditioning."""
    plain: Floats
    """Relative error."""
    values: Floats
    warned: bool


def errors(way: Way, samples: list[BenchSample]) -> Errors:
    """Evaluate a way on reference samples."""
    got, value, condition = [], [], []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for s in samples:
            arrays = way.convert(*s.arrays) if way.convert else s.arrays
            got.append(np.asarray(way.prepare(s.parameters)(*arrays), dtype=float))
            value.append(s.value)
            condition.append(s.condition)
    result, truth = np.concatenate(got), np.concatenate(value)
    with np.errstate(all="ignore"):
        plain = np.abs(result - truth) / np.abs(truth)
        tiny = np.abs(truth) < NOTHING
        plain[tiny] = np.where(np.abs(result[tiny]) < 1e10 * NOTHING, 0.0, 1.0)
    plain[~np.isfinite(result)] = np.inf
    return Errors(plain / (1.0 + np.concatenate(condition)), plain, result, bool(caught))


def summarise(e: Errors) -> ErrorSummary:
    """Largest, 99th percentile and median relative error, and the largest over 1 + conditioning; None: not finite."""
    return ErrorSummary(
        points=int(e.plain.size),
        max=finite(float(e.plain.max())),
        p99=finite(float(np.percentile(e.plain, 99, method="higher"))),
        median=finite(float(np.percentile(e.plain, 50, method="lower"))),
        max_scaled=finite(float(e.scaled.max())),
        not_finite=int(np.sum(~np.isfinite(e.values))),
        warning=e.warned,
    )


def by_set(quantity: BenchQuantity, way: Way) -> dict[Set, ErrorSummary]:
    """Errors of a way on each set of the quantity's samples; none where its results are not comparable."""
    found: dict[Set, ErrorSummary] = {}
    for kind in SETS:
        here = [s for s in quantity.samples if s.kind == kind]
        if here and way.accurate:
            found[kind] = summarise(errors(way, here))
    return found
