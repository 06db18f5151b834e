"""What models show of polarised light: an incident state, an analyser, and each model's Mueller matrix.

A value that was measured with an incident Stokes vector b (b_0 = 1) and an analyser's row a is a M b, with M the
Mueller matrix of the sample [1/sr] on the bases of docs/conventions.md. Facets reflect as mirrors (He1991 eqs. 59-65):
M is their unpolarised BRDF times J (x) J* over its first element. What a model has beside its facets depolarises: of
that M has the first element alone. So does a model without facets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.geometry import Directions
from gonio.polarisation import ray_axes
from gonio.typing import Floats, NDArray

if TYPE_CHECKING:
    from gonio.models.model import Model


@dataclass(frozen=True)
class Facets:
    """What of a model reflects as mirror facets do, at one wavelength."""

    index: complex
    """n + ik of the facets."""
    beside: float = 0.0
    """What the model has beside them, where it is the same in every direction [1/sr]."""
    alone: Model | None = None
    """The model of the facets alone, where the rest is not the same in every direction."""


class Light:
    """The light and the analyser of measured values.

    Parameters
    ----------
    at
        Directions (n,).
    incident, analysed : (n, 4) arrays
        Stokes vectors and analysers' rows, on the bases of docs/conventions.md.
    first : (n,) array, optional
        Measured first elements of Mueller matrices [1/sr] that values are ratios times; NaN for other values.
    """

    def __init__(self, at: Directions, incident: Floats, analysed: Floats, first: Floats | None = None) -> None:
        self.at, self.incident, self.analysed, self.first = at, incident, analysed, first

    def take(self, rows: Any) -> Light:
        """That of some of the values."""
        return Light(
            self.at[rows], self.incident[rows], self.analysed[rows], None if self.first is None else self.first[rows]
        )

    def seen(self, model: Model, evaluate: Callable[[Model], Floats], wavelength_nm: float) -> Floats:
        """What is seen of a model [1/sr], as `Model.in_light`; ratios are times the measured first element."""
        values = model.in_light(self, evaluate, wavelength_nm)
        if self.first is None:
            return values
        ratio = np.isfinite(self.first)
        whole = np.where(ratio, evaluate(model), 1.0)
        return np.where(ratio & (whole != 0.0), values / np.where(whole == 0.0, 1.0, whole) * self.first, values)

    @cached_property
    def depolarised(self) -> Floats:
        """(n,) What is seen of light that a sample depolarises, over its unpolarised BRDF."""
        return np.asarray(self.incident[:, 0] * self.analysed[:, 0])

    @cached_property
    def _bases(self) -> tuple[NDArray[np.float64], NDArray[np.float64], Floats]:
        """e_r.e_i and (e_r.k_i)(e_i.k_r), (n, 2, 2) with rows s, p of the reflected field; cosine at the facet (n,)."""
        axes = []
        for theta, phi, incident in ((self.at.theta_i, self.at.phi_i, True), (self.at.theta_r, self.at.phi_r, False)):
            theta, phi = np.broadcast_to(theta, self.at.shape), np.broadcast_to(phi, self.at.shape)
            k, s, p = ray_axes(theta, phi, incident=incident)
            axes.append((k, np.stack([s, p], axis=-2)))
        (k_i, e_i), (k_r, e_r) = axes
        along = np.einsum("nrk,nik->nri", e_r, e_i)
        across = np.einsum("nrk,nk->nr", e_r, k_i)[:, :, None] * np.einsum("nik,nk->ni", e_i, k_r)[:, None, :]
        return along, across, np.asarray(0.5 * np.linalg.norm(k_r - k_i, axis=-1))

    @cached_property
    def _weights(self) -> tuple[tuple[Floats, NDArray[np.complex128], Floats], ...]:
        """Of J = D e + m k the sums tr(A e C e'), tr(A k C e') and tr(A k C k'); the same of unpolarised light."""
        e, k, _ = self._bases
        out = []
        for c, a in ((_coherency(self.incident), _analyser(self.analysed)), (0.5 * np.eye(2), np.eye(2))):
            of_e, of_k = a @ e @ c, a @ k @ c
            sums = ((of_e, e), (of_k, e), (of_k, k))
            ee, ke, kk = (np.einsum("nij,nij->n", left, right) for left, right in sums)
            out.append((ee.real, ke.astype(np.complex128), kk.real))
        return tuple(out)

    def of_facets(self, index: complex) -> Floats:
        """(n,) What is seen of mirror facets, over their unpolarised BRDF.

        J is -F_s {e_r.e_i + (n^2 - 1)/(2c (n^2 c + q)) (e_r.k_i)(e_i.k_r)}, see `gonio.models.HeTorrance.jones`; F_s
        and the denominator are left out, so that nothing is divided at retro, at normal incidence or at grazing.
        """
        c = np.minimum(self._bases[2], 1.0)
        square, contrast = index * index, (index - 1.0) * (index + 1.0)
        d = 2.0 * c * (square * c + np.sqrt(contrast + c * c + 0j))
        seen, all_of_it = (
            np.abs(d) ** 2 * ee + 2.0 * (np.conj(d) * contrast * ke).real + abs(contrast) ** 2 * kk
            for ee, ke, kk in self._weights
        )
        return np.asarray(np.where(all_of_it > 0.0, seen / np.where(all_of_it > 0.0, all_of_it, 1.0), self.depolarised))

    def of_jones(self, jones: NDArray[np.complex128]) -> Floats:
        """(n,) The same of Jones matrices (n, 2, 2), up to a factor each."""
        left = _analyser(self.analysed) @ jones @ _coherency(self.incident)
        seen = np.einsum("nij,nij->n", left, np.conj(jones)).real
        all_of_it = 0.5 * np.sum(np.abs(jones) ** 2, axis=(-2, -1))
        return np.asarray(np.where(all_of_it > 0.0, seen / np.where(all_of_it > 0.0, all_of_it, 1.0), self.depolarised))


def mueller(
    model: Model, at: Directions, *, wavelength_nm: float = 550.0, evaluate: Callable[[Model], Floats] | None = None
) -> Floats:
    """Mueller matrices (n, 4, 4) [1/sr] of any model's lobe at directions (n,).

    Rows are the reflected Stokes parameters I, Q, U, V, columns the incident ones (docs/conventions.md). `evaluate` is
    that of `Model.in_light`; the lobe along the directions, unless it is given.
    """

    def alone(one: Model) -> Floats:
        return np.asarray(one.brdf(*at.angles, wavelength_nm=wavelength_nm))

    out = np.empty((len(at), 4, 4))
    for row, column in np.ndindex(4, 4):
        b, a = (np.broadcast_to(np.eye(4)[k], (len(at), 4)) for k in (column, row))
        out[:, row, column] = model.in_light(Light(at, b, a), evaluate or alone, wavelength_nm)
    return out


def _coherency(stokes: Floats) -> NDArray[np.complex128]:
    """<E E'> (..., 2, 2) of Stokes vectors (..., 4), U - iV = 2 E_s E_p*."""
    i, q, u, v = np.moveaxis(stokes, -1, 0)
    return np.asarray(0.5 * np.moveaxis(np.array([[i + q, u - 1j * v], [u + 1j * v, i - q]]), (0, 1), (-2, -1)))


def _analyser(row: Floats) -> NDArray[np.complex128]:
    """A (..., 2, 2) with tr(A <E E'>) = row . Stokes vector."""
    return 2.0 * _coherency(row)
