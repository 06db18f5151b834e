"""Whether two measurements differ: tests of all points together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.fitting.value_covariance import Covariance

if TYPE_CHECKING:
    pass

LEVEL = 0.01
"""Probability that the verdict is "changed" where nothing changed."""
FALSE_DISCOVERIES = 0.05
"""Share of the marked values that are marked by chance."""
BEYOND = 2.0


@dataclass(frozen=True)
class Verdict:
    """What the differences say about whether the two are the same."""

    chi_square: float
    p_value: float
    """Probability of a larger chi-square by chance."""
    z: Floats
    """(n,) each difference against what the others predict, in standard deviations."""
    beyond: int
    """How many of them are beyond `BEYOND`."""
    expected: float
    """How many that would be by chance."""
    largest: float
    p_largest: float
    """Probability that the largest of n is that large by chance."""
    marked: npt.NDArray[np.bool_]
    """The values that changed, among which `FALSE_DISCOVERIES` are expected to be marked by chance."""
    scale: float
    """Common factor of B over A, less 1."""
    u_scale: float
    p_scale: float
    """Probability of a factor that far from 1 by chance."""

    @property
    def tests(self) -> dict[str, float]:
        """What the verdict rests on, each with its probability by chance."""
        return {
            "chi-square of all values": self.p_value,
            "the largest single value": self.p_largest,
            "the common factor": self.p_scale,
        }

    @property
    def found_by(self) -> list[str]:
        """Those of `tests` that say that something changed, at `LEVEL` for all together."""
        return [name for name, p in self.tests.items() if len(self.tests) * p < LEVEL]

    @property
    def changed(self) -> bool:
        """Whether any test says so."""
        return bool(self.found_by)


def judge(value_a: Floats, value_b: Floats, covariance: Covariance) -> Verdict:
    """Whether B - A is more than its covariance allows.

    Parameters
    ----------
    value_a, value_b : (n,) arrays [1/sr]
    covariance
        Of the difference.
    """
    from scipy.special import chdtrc, ndtr
    from scipy.stats import false_discovery_control

    difference = value_b - value_a
    n = difference.size
    total = covariance.chi_square(difference)
    z = covariance.alone(difference)
    p = 2 * ndtr(-np.abs(z))
    mean = covariance.whiten(0.5 * (value_a + value_b))
    strength = float(mean @ mean)
    scale, u_scale = float(mean @ covariance.whiten(difference)) / strength, float(strength**-0.5)
    found = Verdict(
        chi_square=total,
        p_value=float(chdtrc(n, total)),
        z=z,
        beyond=int(np.count_nonzero(np.abs(z) > BEYOND)),
        expected=float(n * 2 * ndtr(-BEYOND)),
        largest=float(np.abs(z).max()),
        p_largest=float(-np.expm1(n * np.log1p(-min(float(p.min()), 1 - 1e-16)))),
        marked=false_discovery_control(p) <= FALSE_DISCOVERIES,  # Benjamini and Hochberg (1995)
        scale=scale,
        u_scale=u_scale,
        p_scale=float(2 * ndtr(-abs(scale) / u_scale)),
    )
    # one verdict: where nothing says that anything changed, no single value has
    return found if found.changed else replace(found, marked=np.zeros(n, dtype=bool))
