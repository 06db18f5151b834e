"""Very many fits at several wavelengths whose surface has one geometry (`gonio_analysis.fitting.spectrum`, for maps).

Each wavelength is fitted alone (`gonio_maps.models.batch`); that gives starts. Then Gauss-Newton steps with Levenberg's
damping move the shared parameters and each wavelength's own ones together. Compiled code gives sums of products a pixel
and a wavelength; from these the own parameters are eliminated, so that nothing grows with the square of wavelengths.
Causes that values share are parameters with a standard deviation of 1. docs/maps.md says how a model that is rejected
gets its misfits and errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from gonio_analysis.fitting.problem import acceptable

from gonio.models import engine
from gonio.typing import Floats
from gonio_maps.models import batch
from gonio_maps.models.batch import WORTH, Fits, Posed

AT_ONCE = 2_000_000
"""Numbers of sums of products that are held at once."""
LEAST_PIVOT = 1e-14
"""Least pivot, as a part of a diagonal element, as in `_batch_algebra.solve`."""


@dataclass(frozen=True)
class Band:
    """Values at one wavelength: what `batch.fit` takes."""

    source_mm: Floats
    camera_mm: Floats
    values: Floats
    u: Floats
    common: Floats
    """A row a cause, the same causes at every wavelength."""
    fixed: dict[str, float]
    blocks: npt.NDArray[np.int64]
    wavelength_nm: float


def fit(name: str, x_mm: Floats, y_mm: Floats, bands: Sequence[Band], shared: Sequence[str]) -> list[Fits]:
    """Fit a model to every pixel, with the parameters `shared` equal at all wavelengths.

    In a pixel, a wavelength with no more values than parameters is left out.

    Returns
    -------
    list of Fits
        One a wavelength. Chi-square and the number of values are those of all of them together, tau is that of each.

    Raises
    ------
    ConfigError
        The model or a parameter is unknown.
    """
    alone, posed = [], []
    for band in bands:
        given = (name, x_mm, y_mm, band.source_mm, band.camera_mm, band.values, band.u)
        how = {"common": band.common, "fixed": band.fixed, "blocks": band.blocks, "wavelength_nm": band.wavelength_nm}
        alone.append(batch.fit(*given, **how))  # type: ignore[arg-type]
        posed.append(batch.pose(*given, **how))  # type: ignore[arg-type]
    if len(bands) == 1:
        return alone
    together = _Together(posed, shared, alone)
    size = len(bands) * together.size**2
    for some in np.array_split(np.arange(len(x_mm)), max(1, len(x_mm) * size // AT_ONCE)):
        together.fit(some)
    return together.fits()


class _Together:
    """Pixels at several wavelengths; parameters (pixels, wavelengths, k), in the order of `free`."""

    def __init__(self, posed: Sequence[Posed], shared: Sequence[str], alone: Sequence[Fits]) -> None:
        first = posed[0]
        self._posed, self._alone = posed, alone
        self._k, self._causes = len(first.free), len(first.common)
        self._geometry = np.array([k for k, name in enumerate(first.free) if name in shared], np.intp)
        self._own = np.setdiff1d(np.arange(self._k), self._geometry)
        self._lower = np.array([p.lower[p.which] for p in posed])
        self._upper = np.array([p.upper[p.which] for p in posed])
        self._there = np.stack([np.isfinite(one.chi_square) for one in alone], axis=1)
        self._x = np.stack([one.values[:, p.which] for one, p in zip(alone, posed, strict=True)], axis=1)
        self._x = np.where(np.isfinite(self._x), self._x, self._lower)
        self._tau = np.zeros(self._there.shape)
        self._spread = np.full((*self._x.shape, self._k), np.nan)
        self._chi = np.full(len(self._x), np.nan)

    @property
    def size(self) -> int:
        """Rows of the sums of products: parameters, causes, residuals."""
        return self._k + self._causes + 1

    def fit(self, which: npt.NDArray[np.intp]) -> None:
        """Fit some pixels."""
        from gonio_maps.models import _batch_gram as gram

        which = which[self._there[which].any(axis=1)]
        used = np.where(self._there, np.stack([one.used for one in self._alone], axis=1), 0)[which].sum(axis=1)
        freedom = used - self._geometry.size - self._own.size * self._there[which].sum(axis=1)
        critical = acceptable(freedom)
        mean, surest = self._starts(which)
        separate = self._x[which]
        self._begin(which, separate, mean)
        self._chi[which], self._spread[which] = self._minimised(which, gram.GRAM)
        far = which[self._chi[which] > critical]
        before = self._x[far], self._chi[far], self._spread[far]
        self._begin(far, separate[np.isin(which, far)], surest[np.isin(which, far)])
        self._chi[far], self._spread[far] = self._minimised(far, gram.GRAM)
        worse = self._chi[far] > before[1]
        for now, then in zip((self._x, self._chi, self._spread), before, strict=True):
            now[far[worse]] = then[worse]
        self._rejected(which[self._chi[which] > critical])

    def _starts(self, which: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
        """The shared parameters: means of the wavelengths by their weight, and those of the surest wavelength."""
        variance = np.stack([one.covariance for one in self._alone], axis=1)[which][..., self._geometry, self._geometry]
        known = self._there[which][..., None] & (variance > 0.0) & np.isfinite(variance)
        weight = np.where(known, 1.0 / np.where(known, variance, 1.0), 0.0)
        weight = np.where(known.any(axis=1, keepdims=True), weight, self._there[which][..., None])
        values = self._x[which][..., self._geometry]
        surest = weight[..., 0].argmax(axis=1)
        return (weight * values).sum(axis=1) / weight.sum(axis=1), values[np.arange(len(which)), surest]

    def _begin(self, which: npt.NDArray[np.intp], separate: Floats, geometry: Floats) -> None:
        """Put pixels at fits of single wavelengths, with a geometry that they share."""
        start = separate.copy()
        start[..., self._geometry] = geometry[:, None]
        self._x[which] = start

    def _rejected(self, which: npt.NDArray[np.intp]) -> None:
        """Logarithms, then with the misfit of each wavelength (docs/misfit.md); errors of one wavelength alone."""
        from gonio_maps.models import _batch_gram as gram

        if not which.size:
            return
        self._tau[which] = np.inf
        self._minimised(which, gram.GRAM_OF_LOGARITHMS, causes=False)
        self._tau[which] = self._examined(gram.TAU, which)[..., 0, 0]
        self._minimised(which, gram.GRAM_OF_LOGARITHMS)
        spread = self._examined(gram.ERRORS, which)[..., : self._k, : self._k]
        there = self._there[which][..., None]
        u = np.where(there, np.sqrt(np.einsum("plaa->pla", spread)), np.nan)
        scale, shared = np.ones_like(u), u[..., self._geometry]
        scale[..., self._geometry] = np.nanmedian(shared, axis=1, keepdims=True) / np.where(
            shared > 0.0, shared, np.inf
        )
        scale[..., self._geometry] = np.where(shared > 0.0, scale[..., self._geometry], 1.0)
        self._spread[which] = spread * scale[..., :, None] * scale[..., None, :]

    def _examined(self, job: int, which: npt.NDArray[np.intp], causes: bool = True) -> Floats:
        """What `_batch_gram` works out, by pixel and wavelength."""
        from gonio_maps.models import _batch_gram as gram

        run, out = gram.engine(), []
        for number, p in enumerate(self._posed):
            theta = np.tile(p.lower, (len(self._x), 1))
            theta[:, p.which] = self._x[:, number]
            tau = np.ascontiguousarray(self._tau[:, number])
            common = p.common if causes else p.common[:0]
            one = np.empty((len(which), self._k + len(common) + 1, self._k + len(common) + 1))
            take, shade, derive, *_, count = p.compiled
            given = (job, take, shade, derive, count, *p.given, common, p.which, p.lower, p.upper, p.blocks, theta, tau)
            engine.in_parts(lambda start, stop: run(*given, which, one, start, stop), len(which), WORTH)  # noqa: B023
            out.append(one)
        return np.stack(out, axis=1)

    def _minimised(self, which: npt.NDArray[np.intp], job: int, *, causes: bool = True) -> tuple[Floats, Floats]:
        """Levenberg and Marquardt's least squares from `_x` on; chi-square, and the covariance of each wavelength's."""
        from gonio_maps.models._batch_steps import FIRST_DAMPING, MOST_STEPS, MOST_TRIALS, SETTLED

        sums = self._examined(job, which, causes)
        chi, damping, failed = self._chi_square(sums), np.full(len(which), FIRST_DAMPING), np.zeros(len(which), int)
        todo = np.arange(len(which))
        for _ in range(MOST_STEPS):
            if not todo.size:
                break
            at = which[todo]
            moves = self._moves(sums[todo], at)
            step, gain = self._step(sums[todo], moves, damping[todo])
            before = self._x[at]
            self._x[at] = _toward(before, step, self._lower, self._upper)
            found = self._examined(job, at, causes)
            new = self._chi_square(found)
            better = new <= chi[todo]
            self._x[at[~better]] = before[~better]
            sums[todo[better]], chi[todo[better]] = found[better], new[better]
            damping[todo] = np.where(
                better, np.maximum(0.1 * damping[todo], 1e-12), np.maximum(10 * damping[todo], 1e-6)
            )
            failed[todo] = np.where(better, 0, failed[todo] + 1)
            todo = todo[(gain >= SETTLED) & (failed[todo] < MOST_TRIALS)]
        return chi, self._covariance(sums, self._moves(sums, which))

    def _chi_square(self, sums: Floats) -> Floats:
        """Chi-square of all wavelengths, the causes being what they are found to be."""
        whole = sums.sum(axis=1)
        return np.asarray(whole[:, -1, -1] - np.einsum("pc,pc->p", whole[:, self._k : -1, -1], self._found(whole)))

    def _found(self, whole: Floats) -> Floats:
        """The causes, at parameters that do not move."""
        k = self._k
        return np.asarray(
            np.linalg.solve(whole[:, k:-1, k:-1] + np.eye(whole.shape[-1] - k - 1), whole[:, k:-1, -1:])[..., 0]
        )

    def _moves(self, sums: Floats, which: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
        """Which parameters have an effect, and are not held by a bound."""
        k, whole = self._k, sums.sum(axis=1)
        right = sums[..., :k, -1] - (sums[..., :k, k:-1] @ self._found(whole)[:, None, :, None])[..., 0]
        effect = np.einsum("plaa->pla", sums)[..., :k] > 0.0
        right[..., self._geometry] = right[..., self._geometry].sum(axis=1, keepdims=True)
        effect[..., self._geometry] = effect[..., self._geometry].any(axis=1, keepdims=True)
        x = self._x[which]
        return np.asarray(effect & ~((x <= self._lower) & (right < 0.0)) & ~((x >= self._upper) & (right > 0.0)))

    def _reduced(
        self, sums: Floats, moves: npt.NDArray[np.bool_], damping: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Own parameters eliminated: the normal matrix of the others and its right side; the own ones' solution by them
        (a column each, and one of constants); and the own ones' inverse."""
        own, rest = self._own, np.append(self._geometry, np.arange(self._k, sums.shape[-1]))
        mask = np.concatenate([moves, np.ones((*moves.shape[:2], sums.shape[-1] - self._k), bool)], axis=-1)
        held = sums * mask[..., :, None] * mask[..., None, :]
        inner = _sturdy(held[..., own[:, None], own], damping[:, None])
        inverse = np.asarray(np.linalg.inv(inner), np.float64)
        by_rest = inverse @ held[..., own[:, None], rest]
        outer = held[..., rest[:, None], rest] - held[..., rest[:, None], own] @ by_rest
        shared = self._geometry.size
        whole = outer.sum(axis=1)[:, :-1]
        diagonal = np.einsum("paa->pa", held[..., self._geometry[:, None], self._geometry].sum(axis=1))
        count = np.arange(shared)
        whole[:, count, count] += (damping[:, None] + LEAST_PIVOT) * diagonal + (diagonal == 0.0)
        count = np.arange(shared, whole.shape[1])
        whole[:, count, count] += 1.0
        return whole[..., :-1], whole[..., -1], by_rest, inverse

    def _step(self, sums: Floats, moves: npt.NDArray[np.bool_], damping: Floats) -> tuple[Floats, Floats]:
        """A step of all parameters, and by how much it would lower chi-square."""
        matrix, right, by_rest, _ = self._reduced(sums, moves, damping)
        others = np.linalg.solve(matrix, right[..., None])[..., 0]
        step = np.zeros((*sums.shape[:2], self._k))
        step[..., self._geometry] = others[:, None, : self._geometry.size]
        step[..., self._own] = by_rest[..., -1] - (by_rest[..., :-1] @ others[:, None, :, None])[..., 0]
        step *= moves
        whole = sums.sum(axis=1)
        gain = np.einsum("pla,pla->p", step, sums[..., : self._k, -1])
        causes, alone = others[:, self._geometry.size :], self._found(whole)
        return step, gain + np.einsum("pc,pc->p", causes - alone, whole[:, self._k : -1, -1])

    def _covariance(self, sums: Floats, moves: npt.NDArray[np.bool_]) -> Floats:
        """Covariance of each wavelength's parameters."""
        matrix, _, by_rest, inverse = self._reduced(sums, moves, np.zeros(len(sums)))
        others, shared, own = np.linalg.inv(matrix)[:, None], self._geometry, self._own
        reach = by_rest[..., :-1] @ others
        out = np.zeros((*sums.shape[:2], self._k, self._k))
        out[..., shared[:, None], shared] = others[..., : shared.size, : shared.size]
        out[..., own[:, None], shared] = -reach[..., : shared.size]
        out[..., shared[:, None], own] = np.swapaxes(-reach[..., : shared.size], -1, -2)
        out[..., own[:, None], own] = inverse + reach @ np.swapaxes(by_rest[..., :-1], -1, -2)
        return np.asarray(out * moves[..., :, None] * moves[..., None, :])

    def fits(self) -> list[Fits]:
        """What was found."""
        out, used = [], np.where(self._there, np.stack([one.used for one in self._alone], axis=1), 0).sum(axis=1)
        for number, (alone, p) in enumerate(zip(self._alone, self._posed, strict=True)):
            values, spread = np.tile(p.lower[: len(p.model.names)], (len(self._x), 1)), self._spread[:, number].copy()
            x, absent = self._x[:, number].copy(), ~self._there[:, number]
            for own in self._own:
                x[absent, own] = np.nan
                spread[absent, own] = spread[absent, :, own] = np.nan
            values[:, p.which] = x
            values[np.isnan(self._chi)] = np.nan
            tau = np.where(np.isfinite(self._chi), self._tau[:, number], 0.0)
            out.append(Fits(alone.names, alone.free, values, spread, self._chi, tau, used))
        return out


def _sturdy(matrix: Floats, damping: Floats) -> Floats:
    """A normal matrix with damping, whose pivots do not vanish."""
    count = np.arange(matrix.shape[-1])
    diagonal = matrix[..., count, count]
    out = matrix.copy()
    out[..., count, count] += (damping[..., None] + LEAST_PIVOT) * diagonal + (diagonal == 0.0)
    return out


def _toward(value: Floats, step: Floats, low: Floats, high: Floats) -> Floats:
    """`_batch_steps.toward`, for arrays."""
    from gonio_maps.models._batch_steps import NEAR_BOUND

    bound = np.where(step < 0.0, low, high)
    near = np.abs(bound - value) < NEAR_BOUND * (high - low)
    beyond = np.where(near, bound, value + 0.9 * (bound - value))
    return np.asarray(np.where((value + step - bound) * step < 0.0, value + step, beyond))
