"""Limits of a value by drawing the inputs of any measurement equation (GUM supplement 1, JCGM 101:2008).

Numbers are drawn evenly: points of Sobol's sequence, scrambled. A measurement equation is mostly a product whose
factors have no input in common, as a camera's signal and a geometry. Each draw of one factor is then as good with any
draw of the other, so that n draws of both stand for n^2 values. Several scramblings tell how well limits are known.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gonio.errors import ArgumentError
from gonio.typing import Floats

SCRAMBLINGS = 8
MOST_INPUTS = 21201
"""Of Sobol's sequence, as scipy has it."""
TINY = 2.0**-40
"""Numbers are at least this far from 0 and 1, so that a normal number is finite."""
HALVINGS = 50
"""Of the range in which a limit lies."""

Factor = tuple[Callable[[Floats], Floats], int]
"""Makes numbers (m,) of uniform ones in (0, 1), shape (m, inputs); and how many inputs it has."""


@dataclass(frozen=True)
class Drawn:
    """What draws say of a value: every number of `first` times every number of `rest`."""

    first: Floats
    """(scramblings, m)"""
    rest: Floats
    """(scramblings, m), above 0."""

    @cached_property
    def _sorted(self) -> Floats:
        return np.sort(self.first, axis=None)

    @property
    def mean(self) -> float:
        """Of the value."""
        return float(self.first.mean() * self.rest.mean())

    @property
    def u(self) -> float:
        """Its standard deviation."""
        return math.sqrt(max(float((self.first**2).mean() * (self.rest**2).mean()) - self.mean**2, 0.0))

    def probability(self, value: float) -> float:
        """That it is at most so large."""
        return float(np.searchsorted(self._sorted, value / self.rest, "right").mean() / self.first.size)

    def quantile(self, probability: float) -> float:
        """What it exceeds with a probability of 1 - `probability`."""
        ends = np.outer((self.first.min(), self.first.max()), (self.rest.min(), self.rest.max()))
        low, high = float(ends.min()), float(ends.max())
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.probability(middle) < probability else (low, middle)
        return high

    def u_quantile(self, probability: float) -> float:
        """Standard uncertainty of a quantile by too few draws."""
        each = [
            Drawn(*pair).quantile(probability) for pair in zip(self.first[:, None], self.rest[:, None], strict=True)
        ]
        return float(np.std(each, ddof=1)) / math.sqrt(len(each))


def drawn(factors: Sequence[Factor], *, draws: int = 2**16, seed: int = 0) -> Drawn:
    """Draw a value that is a product of factors which have no input in common.

    Parameters
    ----------
    factors
        One or more. An input of another distribution is the inverse of its cumulative one, as in
        ``scipy.special.ndtri(x[:, 0])`` for a normal number. Those that matter most come first, for the first columns
        are the most even. All factors but the first have to be positive.
    draws
        Of each factor, at least; rounded up to 8 times a power of two.
    seed
        The same one gives the same numbers.

    Raises
    ------
    ArgumentError
        A number is out of its range, or a factor returns another shape, NaN, or what is not positive.
    """
    from scipy.stats import qmc

    if draws < 100:
        raise ArgumentError(f"draws = {draws}: with fewer than 100 no limit is told")
    power = math.ceil(math.log2(draws / SCRAMBLINGS))
    found: list[Floats] = []
    for k, (equation, inputs) in enumerate(factors):
        if not 0 < inputs <= MOST_INPUTS:
            raise ArgumentError(f"factor {k}: inputs = {inputs}: must be from 1 to {MOST_INPUTS}")
        of_all = []
        for stream in np.random.SeedSequence((seed, k)).spawn(SCRAMBLINGS):
            points = qmc.Sobol(inputs, seed=np.random.default_rng(stream)).random_base2(power)
            values = np.asarray(equation(np.clip(points, TINY, 1.0 - TINY)), float)
            if values.shape != (len(points),) or np.isnan(values).any() or (k > 0 and (values <= 0.0).any()):
                what = "positive numbers" if k else "numbers"
                raise ArgumentError(f"factor {k}: must give {len(points)} {what} for inputs {points.shape}")
            of_all.append(values)
        found.append(np.array(of_all))
    if not found:
        raise ArgumentError("factors: name one at least")
    rest = np.prod(found[1:], axis=0) if len(found) > 1 else np.ones((SCRAMBLINGS, 1))
    return Drawn(found[0], rest)
