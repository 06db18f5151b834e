"""The covariance of a measurement table, and how residuals are whitened with it.

A table states its covariance in factors, C = diag(u_random^2) + S S^T, with one column of S a cause that is common to
the whole run (reference, lamp drift, the zero of an angle). Everything here costs O(n k^2) for n values and k causes:
no n x n matrix is ever made.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from gonio.errors import ArgumentError
from gonio.typing import Floats

AT_ONCE = 1 << 16
"""Values that are whitened together."""
ADDED = ("dark", "black")
"""Causes whose names begin so add to a value, whatever it is: offsets of a sensor. All others change it in proportion.
"""
CLEARLY = 0.25
"""Ratio of the variances of a column's logarithm over expected and over measured values: below it it follows those."""


@dataclass(frozen=True)
class Covariance:
    """C = diag(random^2) + common common^T.

    Parameters
    ----------
    random : (n,) array [1/sr]
        Standard uncertainties of the part that is independent from value to value; above 0.
    common : (n, k) array [1/sr]
        One signed column a cause: the change of the values for one standard deviation of that cause.
    causes : tuple of str
        The names of the k causes.
    """

    random: Floats
    common: Floats
    causes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.common.shape != (self.random.size, len(self.causes)):
            raise ArgumentError(
                f"common has shape {self.common.shape}: {(self.random.size, len(self.causes))} is needed"
            )
        if not (np.all(np.isfinite(self.random)) and np.all(self.random > 0) and np.all(np.isfinite(self.common))):
            raise ArgumentError("random and common have to be finite, and random above 0")

    @cached_property
    def total(self) -> Floats:
        """Combined standard uncertainty of each value [1/sr]."""
        return np.asarray(np.sqrt(self.random**2 + (self.common**2).sum(axis=1))) if self.causes else self.random

    @cached_property
    def _root(self) -> tuple[Floats, Floats]:
        # With T = diag(1/random) S = U diag(s) V^T:  (1 + T T^T)^(-1/2) = 1 - U diag(1 - 1/sqrt(1 + s^2)) U^T,
        # the square root of Woodbury's (1 + T T^T)^(-1) = 1 - U diag(s^2 / (1 + s^2)) U^T.
        left, values, _ = np.linalg.svd(self.common / self.random[:, None], full_matrices=False)
        root = np.hypot(1.0, values)
        return left, values**2 / (root * (root + 1.0))  # 1 - 1/root, without cancellation for small s

    def whiten(self, residual: Floats) -> Floats:
        """W r with W^T W = C^-1, of one residual (n,) or of the columns of (n, p), such as a Jacobian.

        The sum of squares of the result is r^T C^-1 r. W is the symmetric root behind the scaling by 1/random, so that
        entry i of the result still belongs to value i; without common causes it is r / random.
        """
        scaled = np.asarray((residual.T / self.random).T)
        if not self.causes:
            return scaled
        left, shrink = self._root
        return np.asarray(scaled - left @ ((left.T @ scaled).T * shrink).T)

    def whiten_in_blocks(self, columns: Sequence[Floats]) -> Iterator[Floats]:
        """`whiten` of several columns (n,), of some values after the other: (m, p) each."""
        across = np.array([self._root[0].T @ (one / self.random) for one in columns]).T if self.causes else None
        for begin in range(0, self.random.size, AT_ONCE):
            some = slice(begin, begin + AT_ONCE)
            white = np.stack([one[some] for one in columns], axis=1) / self.random[some, None]
            if across is not None:
                left, shrink = self._root
                white -= left[some] @ (shrink[:, None] * across)
            yield white

    def whiten_transposed(self, rows: Floats) -> Floats:
        """W^T r, of the columns of (n, p)."""
        scaled = rows
        if self.causes:
            left, shrink = self._root
            scaled = rows - left @ ((left.T @ rows).T * shrink).T
        return np.asarray((scaled.T / self.random).T)

    def apart(self, residual: Floats) -> Floats:
        """A residual less what the common causes are found to be in it, over `random`.

        A fit that has made r^T C^-1 r small has made these small, each value for itself: random C^-1 r.
        """
        return self.random * self.whiten_transposed(self.whiten(residual))

    @cached_property
    def log_determinant(self) -> float:
        """ln det C."""
        of_random = 2.0 * float(np.log(self.random).sum())
        if not self.causes:
            return of_random
        _, shrink = self._root
        return of_random - 2.0 * float(np.log1p(-shrink).sum())  # shrink = 1 - 1/sqrt(1 + s^2)

    def alone(self, residual: Floats) -> Floats:
        """Each residual less what all the others predict of it, in standard deviations of that difference.

        z_i = (C^-1 r)_i / sqrt((C^-1)_ii): standard normal, one by one, if the residuals have the covariance C. What
        a common cause does to many values does not stand out in it; what happens to one value alone does.
        """
        left, shrink = self._root
        kept = 1.0 - shrink  # 1 / sqrt(1 + s^2)
        lost = (1.0 - kept) * (1.0 + kept)
        scaled = residual / self.random
        solved = scaled - left @ (lost * (left.T @ scaled))
        return np.asarray(solved / np.sqrt(1.0 - (left**2) @ lost))

    def chi_square(self, residual: Floats) -> float:
        """r^T C^-1 r."""
        white = self.whiten(residual)
        return float(white @ white)

    def scaled(self, factor: Floats, expected: Floats) -> Covariance:
        """The covariance with the common part of value i times `factor[i]`, to that of the `expected` values [1/sr].

        The effect of most common causes is proportional to the true value. Columns that were computed from measured,
        noisy values pull a fit toward low values (Peelle's puzzle); once a model is fitted, `factor` = fitted /
        measured takes that pull away. What is `ADDED` holds no measured value, and would take up its noise; so would
        a column that is in proportion to the expected values as it is.
        """
        kept = [
            cause.startswith(ADDED) or _follows(c, factor, expected)
            for cause, c in zip(self.causes, self.common.T, strict=True)
        ]
        return Covariance(self.random, self.common * np.where(kept, 1.0, factor[:, None]), self.causes)

    def take(self, rows: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> Covariance:
        """The covariance of some of the values."""
        return Covariance(self.random[rows], self.common[rows], self.causes)


def _follows(column: Floats, factor: Floats, expected: Floats) -> bool:
    """Whether a cause's column goes with expected values, and clearly not with measured ones, expected / factor."""
    share = column / np.where(expected == 0.0, np.nan, expected)
    if not (np.all(share > 0.0) or np.all(share < 0.0)):
        return False
    as_it_is, by_factor = (float(np.var(np.log(np.abs(x)))) for x in (share, share * factor))
    return as_it_is < CLEARLY * by_factor


def independent(u: Floats) -> Covariance:
    """A covariance without common causes."""
    return Covariance(u, np.zeros((u.size, 0)))
