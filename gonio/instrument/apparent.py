"""What an instrument with a finite source and a finite receiver sees of a model.

Both are circular cones: `theta_i, phi_i` and `theta_r, phi_r` are their axes. The BRDF that it measures is

    (1/w_r) int_r int_s f cos(theta_s) dw_s dw_r / int_s cos(theta_s) dw_s

for the lobe, and for the specular spike (He1991 eqs. 6, 70) the flux that the source's mirror image sends through the
receiver's cone. A cone that crosses the horizon is cut there, and averages run over what is left; a solid angle of zero
is a direction.

`Cones` holds directions that many models are evaluated in; the functions do the same for one.
"""

import math
from functools import cached_property
from typing import Any, Literal

import numpy as np

from gonio.errors import ArgumentError
from gonio.geometry import half_angle_of_cone
from gonio.instrument import spherical_caps
from gonio.instrument.lobe import CUT_ORDERS, TOLERANCE, Lobe, Rules, cap_nodes
from gonio.models import Model, engine, geometry
from gonio.models._compile import loop
from gonio.models._hemisphere import gauss
from gonio.models.parameters import checked_wavelength, choice, number
from gonio.typing import ArrayLike, Floats, Ints, NDArray

STEPS = 2048
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
        x, w = gauss(side)
        constants = (self._source, self._receiver, low, per_step, float(self._exact))
        values = np.empty(self._whole.size)
        run = loop(spherical_caps.spike_over_vectors, spherical_caps.tabulated, len(constants))
        engine.in_parts(lambda i, j: run(axes_i, axes_r, table, x, w, constants, values, i, j), values.size, GRAIN)
        out[self._whole] = values
        return out

    @cached_property
    def _axes(self) -> tuple[Floats, Floats]:
        """Axes of the cones that the horizon leaves whole, three numbers after three."""
        whole = self._whole
        return self._omega_i[whole].reshape(-1), self._omega_r[whole].reshape(-1)

    @cached_property
    def _grid(self) -> tuple[Floats, Ints, Ints, Ints]:
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
        """A geometry in which the horizon cuts a cap: the overlap summed over the receiver's, to 4e-3 of the whole."""
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


def _dense(omega: Floats, half: float) -> tuple[Floats, Floats]:
    square, psi = np.meshgrid((np.arange(64) + 0.5) / 64.0, (np.arange(128) + 0.5) * (math.pi / 64.0), indexing="ij")
    weight = np.full(square.size, 4.0 * math.pi * math.sin(half / 2.0) ** 2 / square.size)
    return spherical_caps.nodes(omega, half, square.ravel(), psi.ravel()), weight


__all__ = ["Cones", "Rules", "apparent_brdf", "apparent_lobe", "apparent_spike"]

Spike = Literal["nominal", "exact"]


class Cones:
    """The cones of source and receiver about directions that are checked and prepared once, for many models.

    The methods take a `gonio.models.Model` and a wavelength [nm], and return a float64 array of the shape that the
    angles broadcast to; a wavelength that is no positive number, or at which the model's index is not known, raises
    `ArgumentError`.

    Parameters
    ----------
    theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike
        As `apparent_brdf` takes them, with its errors.
    tolerance
        Relative error of a lobe's average (see `apparent_lobe`).
    """

    def __init__(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        source_solid_angle_sr: float,
        receiver_solid_angle_sr: float,
        *,
        spike: Spike = "nominal",
        tolerance: float = TOLERANCE,
    ) -> None:
        self._where = geometry(theta_i, phi_i, theta_r, phi_r)
        self._omega_i, self._omega_r = self._where.omega_i.reshape(-1, 3), self._where.omega_r.reshape(-1, 3)
        self._half_angles = _half_angles(source_solid_angle_sr, receiver_solid_angle_sr)
        self._exact = choice("spike", spike, ("nominal", "exact")) == "exact"
        self._tolerance = tolerance
        self._last: tuple[tuple[Model, float], tuple[Floats, NDArray[np.int8]]] | None = None

    def centre(self, model: Model, *, wavelength_nm: float = 550.0) -> Any:
        """The lobe [1/sr] along the axes of the cones."""
        return model.at(self._where, wavelength_nm=wavelength_nm)

    def lobe(self, model: Model, *, wavelength_nm: float = 550.0, rules: Rules | None = None) -> Any:
        """The lobe's average over the cones [1/sr]; with the `rules` of a like model, not searched for again."""
        if rules is None:
            values = self._chosen(model, wavelength_nm)[0].copy()
        else:
            values = self._lobe(model, wavelength_nm).by_rules(self._omega_i, self._omega_r, rules)
        return values.reshape(self._where.shape)[()]

    def rules(self, model: Model, *, wavelength_nm: float = 550.0) -> Rules:
        """Rules of the average over the cones for this model, which `lobe` can take for similar ones."""
        return Rules(self._chosen(model, wavelength_nm)[1])

    def _chosen(self, model: Model, wavelength_nm: float) -> tuple[Floats, NDArray[np.int8]]:
        """Averages, and the numbers of rules; of the last model they are known, for a fit asks for both."""
        if self._last is None or self._last[0] != (model, wavelength_nm):
            chosen = self._lobe(model, wavelength_nm).choose(self._omega_i, self._omega_r)
            self._last = (model, wavelength_nm), chosen
        return self._last[1]

    def _lobe(self, model: Model, wavelength_nm: float) -> Lobe:
        return Lobe(model, checked_wavelength(wavelength_nm), *self._half_angles, self._tolerance)

    def spike(self, model: Model, *, wavelength_nm: float = 550.0) -> Any:
        """What the receiver gets of the specular spike [1/sr]; 0 for a model without one."""
        if not model.has_spike:
            return np.zeros(self._where.shape)[()]
        return self._overlaps.seen(model, checked_wavelength(wavelength_nm)).reshape(self._where.shape)[()]

    @cached_property
    def _overlaps(self) -> Overlaps:
        return Overlaps(self._omega_i, self._omega_r, *self._half_angles, self._exact)


def apparent_brdf(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    spike: Spike = "nominal",
) -> Any:
    """BRDF [1/sr] that an instrument with circular source and receiver cones measures: lobe and specular spike.

    Parameters
    ----------
    model
        Any `gonio.models.Model`.
    theta_i, phi_i, theta_r, phi_r
        The cones' axes [rad], as in `Model.brdf`; they broadcast.
    wavelength_nm
        Wavelength [nm].
    source_solid_angle_sr, receiver_solid_angle_sr
        The cones' solid angles [sr], in [0, 2 pi).
    spike
        "nominal": rho_s(theta_i) |cap_s' and cap_r| / (cos(theta_i) w_s w_r), HTSG's eq. 6; "exact": rho_s carried
        through the integral, with the lobe's denominator, as an instrument measures it.

    Returns
    -------
    float64 array of the shape that the angles broadcast to.

    Raises
    ------
    ArgumentError
        `model` is none, or an angle, a solid angle or `spike` is outside its domain; it names the argument.

    Notes
    -----
    The lobe is averaged to 1e-7 (see `apparent_lobe`); the spike to 1e-8 of itself.

    Examples
    --------
    >>> import gonio
    >>> from math import pi
    >>> mirror = gonio.HeTorrance(sigma0_um=0.05, tau_um=2.0, ior="Al")
    >>> seen = gonio.apparent_brdf(mirror, 0.5, 0.0, 0.5, pi, source_solid_angle_sr=1e-3, receiver_solid_angle_sr=1e-3)
    >>> print(f"{seen:.4g} with its spike, {mirror.brdf(0.5, 0.0, 0.5, pi):.4g} without")
    399.4 with its spike, 18.45 without
    """
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike=spike)
    lobe = cones.lobe(_checked(model), wavelength_nm=wavelength_nm)
    return lobe + cones.spike(model, wavelength_nm=wavelength_nm) if model.has_spike else lobe


def apparent_lobe(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    tolerance: float = TOLERANCE,
) -> Any:
    """The part of `apparent_brdf` that is not the spike; arguments and errors as there.

    Notes
    -----
    A second-order expansion where its own error estimate holds `tolerance`, else products of two disc rules of growing
    degree (5, 7, 11, 19, 31, 47) until two agree to `tolerance`, geometry by geometry. The kinks of V-groove models
    leave some 1e-6. A lobe that the finest rules cannot resolve (narrower than about a tenth of the cones' radius) is
    integrated in polar coordinates about the mirror direction, over the wider cone: to 1e-6 where the other cone is a
    direction or narrower than the lobe, to about 2e-3 where the lobe is narrower than both. Where the horizon cuts a
    cone the average is good to about 1e-5, and the spike's overlap to 4e-3 of the whole.
    """
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, tolerance=tolerance)
    return cones.lobe(_checked(model), wavelength_nm=wavelength_nm)


def apparent_spike(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    spike: Spike = "nominal",
) -> Any:
    """The spike's part of `apparent_brdf`; arguments and errors as there. 0 for a model without a spike."""
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike=spike)
    return cones.spike(_checked(model), wavelength_nm=wavelength_nm)


def _checked(model: Model) -> Model:
    if not isinstance(model, Model):
        raise ArgumentError(f"model must be one of gonio.models, not {type(model).__name__}")
    return model


def _half_angles(source_solid_angle_sr: float, receiver_solid_angle_sr: float) -> tuple[float, float]:
    out = []
    for name, value in (
        ("source_solid_angle_sr", source_solid_angle_sr),
        ("receiver_solid_angle_sr", receiver_solid_angle_sr),
    ):
        checked = number(name, value, 0.0, unit="sr")
        if checked >= 2.0 * math.pi:
            raise ArgumentError(f"{name} = {checked:g} sr: a cone must be narrower than the hemisphere, 2 pi sr")
        out.append(float(half_angle_of_cone(checked)))
    return out[0], out[1]
