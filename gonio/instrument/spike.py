"""What a receiver's cone gets of a specular spike that a source's cone sends; see `gonio.instrument.apparent`."""

import functools
import math

import numpy as np

from gonio.instrument import spherical_caps
from gonio.instrument.lobe import CUT_ORDERS, cap_nodes
from gonio.models import Model, engine
from gonio.models._compile import loop
from gonio.typing import Floats, Ints

Places = Ints

STEPS = 8192
"""Steps of the table of rho_s from cos(theta) = 0 to 1."""
GRAIN = 4096  # geometries worth a thread of their own


class Overlaps:
    """Where the cones of directions (n, 3) see each other's mirror image, and where rho_s has to be known for it."""

    def __init__(self, omega_i: Floats, omega_r: Floats, source: float, receiver: float, exact: bool) -> None:
        self._omega_i, self._omega_r = omega_i, omega_r
        self._source, self._receiver, self._exact = source, receiver, exact
        chord = omega_i * (-1.0, -1.0, 1.0) - omega_r
        reach = (2.0 * math.sin(min(0.5 * (source + receiver), math.pi / 2.0))) ** 2
        near = np.einsum("nk,nk->n", chord, chord) <= reach
        self._near = near
        self._directions = source == 0.0 or receiver == 0.0
        cut = near & ((omega_i[:, 2] < math.sin(source)) | (omega_r[:, 2] < math.sin(receiver)))
        self._cut = np.flatnonzero(cut)
        self._whole = np.flatnonzero(near & ~cut)

    def seen(self, model: Model, wavelength_nm: float) -> Floats:
        """BRDF (n,) [1/sr] of a model's spike."""
        if self._directions:
            return self._of_direction(model, wavelength_nm)
        out = np.zeros(len(self._omega_i))
        for index in self._cut:
            out[index] = self._of_cut(model, int(index), wavelength_nm)
        if not self._whole.size:
            return out
        axes_i, axes_r = self._axes
        table, low, per_step, side = self._table(model, wavelength_nm)
        x, w = _gauss(side)
        constants = (self._source, self._receiver, low, per_step, float(self._exact))
        values = np.empty(self._whole.size)
        run = loop(spherical_caps.spike_over_vectors, spherical_caps.tabulated, len(constants))
        engine.in_parts(lambda i, j: run(axes_i, axes_r, table, x, w, constants, values, i, j), values.size, GRAIN)
        out[self._whole] = values
        return out

    @functools.cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Axes of the cones that the horizon leaves whole, three numbers after three."""
        whole = self._whole
        return self._omega_i[whole].reshape(-1), self._omega_r[whole].reshape(-1)

    @functools.cached_property
    def _grid(self) -> tuple[Floats, Places, Places, Places]:
        """Equal steps of cos(theta) over the caps; which of them the caps touch; where each cap begins and ends."""
        z_i, z_r = self._omega_i[self._whole, 2], self._omega_r[self._whole, 2]
        theta = np.arccos(np.minimum(z_r, 1.0))
        z_low = np.cos(np.minimum(theta + self._receiver, math.pi / 2.0))
        least, most = np.minimum(z_low, z_i), np.maximum(np.cos(np.maximum(theta - self._receiver, 0.0)), z_i)
        low, high = float(least.min()), float(most.max())
        count = max(16, math.ceil((high - low) * STEPS))
        grid = np.linspace(low, high, count + 1)
        per_step = count / (high - low)
        first = np.clip((least - low) * per_step - 3.0, 0, count).astype(np.intp)
        last = np.clip(np.ceil((most - low) * per_step) + 3.0, 0, count).astype(np.intp)
        depth = np.bincount(first, minlength=count + 2) - np.bincount(last + 1, minlength=count + 2)
        return grid, np.flatnonzero(np.cumsum(depth)[: count + 1] > 0), first, last

    def _table(self, model: Model, wavelength_nm: float) -> tuple[Floats, float, float, int]:
        """rho_s at the grid, where caps touch it; how many Gauss nodes a side its change over a cap asks for."""
        grid, touched, first, last = self._grid
        table = np.zeros(grid.size)
        table[touched] = _reflectivity(model, grid[touched], wavelength_nm)
        most = np.maximum(np.maximum(table[first], table[last]), 1e-30)
        change = float(np.max(np.abs(table[last] - table[first]) / most))
        per_step = (grid.size - 1) / float(grid[-1] - grid[0])
        return table, float(grid[0]), per_step, 2 if change < 0.02 else 4 if change < 0.4 else 8

    def _of_direction(self, model: Model, wavelength_nm: float) -> Floats:
        """The limits where one cone is a direction (and where both are: infinite in the mirror direction)."""
        omega_i, omega_r, source, receiver = self._omega_i, self._omega_r, self._source, self._receiver
        out = np.zeros(len(omega_i))
        for index in np.flatnonzero(self._near):
            seen = omega_r[index, 2] if self._exact and receiver == 0.0 else omega_i[index, 2]
            rho = float(_reflectivity(model, np.array([seen]), wavelength_nm)[0])
            w_r = float(np.sum(cap_nodes(omega_r[index], receiver, CUT_ORDERS[-1])[1])) if receiver > 0.0 else 1.0
            if source > 0.0:
                s, s_weight = cap_nodes(omega_i[index], source, CUT_ORDERS[-1])
                light = float(s_weight @ s[:, 2]) if self._exact else float(np.sum(s_weight)) * omega_i[index, 2]
            else:
                light = omega_i[index, 2]
            both = source == 0.0 and receiver == 0.0
            out[index] = 0.0 if rho == 0.0 else math.inf if both or light == 0.0 else rho / (light * w_r)
        return out

    def _of_cut(self, model: Model, index: int, wavelength_nm: float) -> float:
        """A geometry in which the horizon cuts a cap: the overlap by summing over the receiver's, to about 1e-3."""
        omega_i, omega_r, source, receiver = self._omega_i[index], self._omega_r[index], self._source, self._receiver
        s, s_weight = cap_nodes(omega_i, source, CUT_ORDERS[-1])
        r, r_weight = (
            spherical_caps.cut_nodes(omega_r, receiver, 48)
            if omega_r[2] < math.sin(receiver)
            else _dense(omega_r, receiver)
        )
        chord = r - omega_i * (-1.0, -1.0, 1.0)
        inside = np.einsum("nk,nk->n", chord, chord) <= (2.0 * math.sin(source / 2.0)) ** 2
        if self._exact:
            flux = float(r_weight[inside] @ _reflectivity(model, r[inside, 2], wavelength_nm)) if inside.any() else 0.0
            light = float(s_weight @ s[:, 2])
        else:
            flux = float(np.sum(r_weight[inside])) * float(_reflectivity(model, omega_i[2:3], wavelength_nm)[0])
            light = float(np.sum(s_weight)) * float(omega_i[2])
        return 0.0 if flux == 0.0 else math.inf if light == 0.0 else flux / (light * float(np.sum(r_weight)))


def _reflectivity(model: Model, cosine: Floats, wavelength_nm: float) -> Floats:
    theta = np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(model.specular_reflectivity(theta, wavelength_nm=wavelength_nm), dtype=np.float64)


@functools.cache
def _gauss(side: int) -> tuple[Floats, Floats]:
    x, w = np.polynomial.legendre.leggauss(side)
    return x, w


def _dense(omega: Floats, half: float) -> tuple[Floats, Floats]:
    square, psi = np.meshgrid((np.arange(64) + 0.5) / 64.0, (np.arange(128) + 0.5) * (math.pi / 64.0), indexing="ij")
    weight = np.full(square.size, 4.0 * math.pi * math.sin(half / 2.0) ** 2 / square.size)
    return spherical_caps.nodes(omega, half, square.ravel(), psi.ravel()), weight
