"""What an instrument with a finite source and a finite receiver sees of a model.

Both are circular cones: `theta_i, phi_i` and `theta_r, phi_r` are their axes. The BRDF that it measures is

    (1/w_r) int_r int_s f cos(theta_s) dw_s dw_r / int_s cos(theta_s) dw_s

for the lobe, and for the specular spike (He1991 eqs. 6, 70) the flux that the source's mirror image sends through the
receiver's cone. A cone that crosses the horizon is cut there, and averages run over what is left; a solid angle of zero
is a direction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import numpy.typing as npt

from gonio import _caps
from gonio.errors import ArgumentError
from gonio.geometry import half_angle_of_cone
from gonio.models import Geometry, Model, engine, geometry
from gonio.models._compile import loop
from gonio.models.base import choice, number

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Array = npt.NDArray[np.float64]
Spike = Literal["nominal", "exact"]

TOLERANCE = 1e-7
"""Relative difference of two successive cubatures at which a lobe's average is taken."""
NARROW = 1e-4
"""Relative difference of the two finest cubatures above which a lobe counts as narrower than the cones."""
NOTHING = 1e-60
"""1/sr: where a lobe's largest value in the cones is below it, the second-order expansion is taken."""
PAIRS = 1 << 17  # pairs of directions evaluated at a time: bounds the memory
CUT_ORDERS = (6, 10, 16)


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
        Any `gonio.models.Model`; one without ``specular_reflectivity`` has no spike.
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
        An angle, a solid angle or `spike` is outside its domain; it names the argument.

    Notes
    -----
    The lobe is averaged to `TOLERANCE` (see `apparent_lobe`); the spike to 1e-8 of itself.
    """
    where = geometry(theta_i, phi_i, theta_r, phi_r)
    cones = _half_angles(source_solid_angle_sr, receiver_solid_angle_sr)
    kind = choice("spike", spike, ("nominal", "exact"))
    total = _lobe(model, where, wavelength_nm, *cones)
    if hasattr(model, "specular_reflectivity"):
        total = total + _spike(model, where, wavelength_nm, *cones, kind == "exact")
    return total.reshape(where.shape)[()]


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
    cone the average is good to about 1e-5, and the spike's overlap to 1e-3.
    """
    where = geometry(theta_i, phi_i, theta_r, phi_r)
    cones = _half_angles(source_solid_angle_sr, receiver_solid_angle_sr)
    return _lobe(model, where, wavelength_nm, *cones, tolerance).reshape(where.shape)[()]


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
    where = geometry(theta_i, phi_i, theta_r, phi_r)
    cones = _half_angles(source_solid_angle_sr, receiver_solid_angle_sr)
    kind = choice("spike", spike, ("nominal", "exact"))
    if not hasattr(model, "specular_reflectivity"):
        return np.zeros(where.shape)[()]
    return _spike(model, where, wavelength_nm, *cones, kind == "exact").reshape(where.shape)[()]


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


# --- the lobe -----------------------------------------------------------------------------------------------------


def _lobe(
    model: Model, where: Geometry, wavelength_nm: float, source: float, receiver: float, tolerance: float = TOLERANCE
) -> Array:
    """Averages over both caps, flat."""
    omega_i, omega_r = where.omega_i.reshape(-1, 3), where.omega_r.reshape(-1, 3)
    if source == 0.0 and receiver == 0.0:
        return np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)).reshape(-1)
    out = np.empty(len(omega_i))
    cut = (omega_i[:, 2] < math.sin(source)) | (omega_r[:, 2] < math.sin(receiver))
    for index in np.flatnonzero(cut):
        out[index] = _cut_lobe(model, omega_i[index], omega_r[index], wavelength_nm, source, receiver, tolerance)
    left = np.flatnonzero(~cut)
    if not left.size:
        return out
    peak = _largest(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver)
    now, error = _second_order(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver)
    out[left] = now
    rough = ~((error <= tolerance) & (peak <= 3.0 * now)) & (peak > NOTHING)
    left, peak = left[rough], peak[rough]
    before = np.full(left.size, np.inf)
    for level in range(_caps.LEVELS):
        if not left.size:
            return out
        now = _product_rule(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver, level)
        out[left] = now
        # a lobe that so many rings resolve has an average not that far below its peak
        seen = peak <= 3.0 * _caps.RINGS[level] ** 2 * now
        allowed = max(tolerance, NARROW) if level == _caps.LEVELS - 1 else tolerance
        rough = ~((np.abs(now - before) <= allowed * np.abs(now)) & seen)
        left, before, peak = left[rough], now[rough], peak[rough]
    for index in left:
        out[index] = _narrow_lobe(model, omega_i[index], omega_r[index], wavelength_nm, source, receiver)
    return out


def _largest(
    model: Model, omega_i: Array, omega_r: Array, wavelength_nm: float, source: float, receiver: float
) -> Array:
    """The BRDF between the directions of the caps that come nearest to mirroring each other: a lobe's peak."""
    mirrored = omega_i * (-1.0, -1.0, 1.0)
    chord = mirrored - omega_r
    apart = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(chord, axis=1)))
    toward = chord - np.einsum("nk,nk->n", chord, omega_r)[:, None] * omega_r
    size = np.linalg.norm(toward, axis=1)[:, None]
    toward = np.where(size > 1e-12, toward / np.maximum(size, 1e-300), 0.0)
    share = apart * receiver / (source + receiver)

    def at(angle: Array) -> Array:
        turned: Array = np.where(
            size > 1e-12, np.cos(angle)[:, None] * omega_r + np.sin(angle)[:, None] * toward, omega_r
        )
        return turned

    seen, lit = at(np.minimum(receiver, share)), at(np.maximum(apart - source, share)) * (-1.0, -1.0, 1.0)
    return np.asarray(model.brdf_vectors(lit, seen, wavelength_nm=wavelength_nm), dtype=np.float64).reshape(-1)


def _narrow_lobe(
    model: Model, omega_i: Array, omega_r: Array, wavelength_nm: float, source: float, receiver: float
) -> float:
    """One geometry whose lobe is far narrower than the wider cone: nodes there crowd about the mirror direction."""
    wide_source = source > receiver
    wide_axis, wide, axis, half = (
        (omega_i, source, omega_r, receiver) if wide_source else (omega_r, receiver, omega_i, source)
    )
    square, psi, weight = _caps.disc_rule(4) if half > 0.0 else (np.zeros(1), np.zeros(1), np.ones(1))
    outer = _caps.nodes(axis, half, square, psi)
    total = 0.0
    for first in range(0, len(outer), 32):
        part = slice(first, first + 32)
        inner, solid = _caps.focused_nodes(wide_axis, wide, outer[part] * (-1.0, -1.0, 1.0))
        fixed = outer[part][:, None, :]
        pair = (inner, fixed) if wide_source else (fixed, inner)
        values = np.asarray(model.brdf_vectors(*pair, wavelength_nm=wavelength_nm))
        light = inner[..., 2] if wide_source else fixed[..., 2]
        total += float(weight[part] @ np.sum(values * light * solid, axis=1))
    if wide_source:
        return total / (math.pi * math.sin(source) ** 2 * float(omega_i[2]))
    return total / (4.0 * math.pi * math.sin(receiver / 2.0) ** 2 * float(weight @ outer[:, 2]))


def _second_order(
    model: Model, omega_i: Array, omega_r: Array, wavelength_nm: float, source: float, receiver: float
) -> tuple[Array, Array]:
    """f + the second-order terms of each cone alone, and the estimated size of what is left out, both from 13 values.

    With v the largest change of f over either ring and d the second-order terms, all relative to f, the next terms
    are of order v^4 and d^2.
    """
    square, psi, _ = _caps.disc_rule(0)
    square, psi = square[1:], psi[1:]
    centre = np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)).reshape(-1)
    scale = np.where(centre > 0.0, centre, 1.0)
    change, change2, total = np.zeros_like(centre), np.zeros_like(centre), centre.copy()
    for axis, other, half, is_source in ((omega_i, omega_r, source, True), (omega_r, omega_i, receiver, False)):
        if half == 0.0:
            continue
        ring = _caps.nodes(axis, half, square, psi)
        pair = (ring, other[:, None, :]) if is_source else (other[:, None, :], ring)
        values = np.asarray(model.brdf_vectors(*pair, wavelength_nm=wavelength_nm))
        if is_source:  # weighted by cos(theta_s): its mean over the ring is that of the axis times cos(rho)
            mean_cos = np.sum(ring[..., 2], axis=1)
            mean = np.sum(values * ring[..., 2], axis=1) / mean_cos
        else:
            mean = np.mean(values, axis=1)
        term = 0.75 * (mean - centre)
        total += term
        change += np.max(np.abs(values - centre[:, None]), axis=1) / scale
        change2 += np.abs(term) / scale
    with np.errstate(over="ignore"):
        error = np.where(centre > 0.0, change**4 + 4.0 * change2**2, np.inf)
    return total, error


def _product_rule(
    model: Model, omega_i: Array, omega_r: Array, wavelength_nm: float, source: float, receiver: float, level: int
) -> Array:
    out = np.empty(len(omega_i))
    square, psi, weight = _caps.disc_rule(level)
    one = np.zeros(1), np.zeros(1), np.ones(1)
    s_square, s_psi, s_weight = (square, psi, weight) if source > 0.0 else one
    r_square, r_psi, r_weight = (square, psi, weight) if receiver > 0.0 else one
    step = max(1, PAIRS // (len(s_weight) * len(r_weight)))
    for first in range(0, len(out), step):
        part = slice(first, first + step)
        from_source = _caps.nodes(omega_i[part], source, s_square, s_psi)
        to_receiver = _caps.nodes(omega_r[part], receiver, r_square, r_psi)
        values = np.asarray(
            model.brdf_vectors(from_source[:, :, None, :], to_receiver[:, None, :, :], wavelength_nm=wavelength_nm)
        )
        light = s_weight * from_source[..., 2]
        out[part] = np.einsum("gsr,gs,r->g", values, light, r_weight) / np.sum(light, axis=1)
    return out


def _cut_lobe(
    model: Model,
    omega_i: Array,
    omega_r: Array,
    wavelength_nm: float,
    source: float,
    receiver: float,
    tolerance: float,
) -> float:
    """One geometry in which the horizon cuts a cap."""
    before = math.inf
    now = 0.0
    for order in CUT_ORDERS:
        s, s_weight = _cap_nodes(omega_i, source, order)
        r, r_weight = _cap_nodes(omega_r, receiver, order)
        light = s_weight * s[:, 2]
        total = 0.0
        step = max(1, PAIRS // len(s))
        for first in range(0, len(r), step):
            part = slice(first, first + step)
            values = np.asarray(model.brdf_vectors(s[:, None, :], r[None, part, :], wavelength_nm=wavelength_nm))
            total += float(light @ values @ r_weight[part])
        now = total / (float(np.sum(light)) * float(np.sum(r_weight))) if np.sum(light) > 0.0 else 0.0
        if abs(now - before) <= 10.0 * tolerance * abs(now):
            break
        before = now
    return now


def _cap_nodes(omega: Array, half: float, order: int) -> tuple[Array, Array]:
    """Nodes and solid angles [sr] of what lies above the horizon of the cap about one axis."""
    if half == 0.0:
        return omega[None, :], np.ones(1)
    if omega[2] < math.sin(half):
        return _caps.cut_nodes(omega, half, order)
    square, psi, weight = _caps.disc_rule(CUT_ORDERS.index(order) + 2)
    return _caps.nodes(omega, half, square, psi), weight * (4.0 * math.pi * math.sin(half / 2.0) ** 2)


# --- the spike ----------------------------------------------------------------------------------------------------


def _spike(model: Model, where: Geometry, wavelength_nm: float, source: float, receiver: float, exact: bool) -> Array:
    omega_i, omega_r = where.omega_i.reshape(-1, 3), where.omega_r.reshape(-1, 3)
    out = np.zeros(len(omega_i))
    mirrored = omega_i * (-1.0, -1.0, 1.0)
    chord = mirrored - omega_r
    near = np.einsum("nk,nk->n", chord, chord) <= (2.0 * math.sin(min(0.5 * (source + receiver), math.pi / 2.0))) ** 2
    if source == 0.0 or receiver == 0.0:
        return _spike_of_direction(model, omega_i, omega_r, near, wavelength_nm, source, receiver, exact)
    cut = near & ((omega_i[:, 2] < math.sin(source)) | (omega_r[:, 2] < math.sin(receiver)))
    for index in np.flatnonzero(cut):
        out[index] = _cut_spike(model, omega_i[index], omega_r[index], wavelength_nm, source, receiver, exact)
    whole = np.flatnonzero(near & ~cut)
    if not whole.size:
        return out
    l, v = np.ascontiguousarray(omega_i[whole]), np.ascontiguousarray(omega_r[whole])  # noqa: E741
    table, low, per_step, side = _reflectivity_table(model, v[:, 2], l[:, 2], wavelength_nm, source, receiver)
    x, w = np.polynomial.legendre.leggauss(side)
    constants = (source, receiver, low, per_step, float(exact))
    values = np.empty(whole.size)
    run = loop(_caps.spike_over_vectors, _caps.tabulated, len(constants))
    engine.in_parts(
        lambda i, j: run(l.reshape(-1), v.reshape(-1), table, x, w, constants, values, i, j), whole.size, 4096
    )
    out[whole] = values
    return out


def _reflectivity(model: Model, cosine: Array, wavelength_nm: float) -> Array:
    theta = np.arccos(np.clip(cosine, 0.0, 1.0))
    return np.asarray(cast(Any, model).specular_reflectivity(theta, wavelength_nm=wavelength_nm), dtype=np.float64)


def _reflectivity_table(
    model: Model, z_r: Array, z_i: Array, wavelength_nm: float, source: float, receiver: float
) -> tuple[Array, float, float, int]:
    """rho_s at equal steps of cos(theta) over the caps; how many Gauss nodes a side its change over a cap asks for."""
    angle_low = math.acos(min(1.0, max(z_r.max(), z_i.max()))) - receiver
    angle_high = math.acos(max(0.0, min(z_r.min(), z_i.min()))) + receiver
    low = max(0.0, math.cos(min(math.pi / 2.0, angle_high)))
    high = 1.0 if angle_low <= 0.0 else math.cos(angle_low)
    count = max(16, math.ceil((high - low) * 8192))
    grid = np.linspace(low, high, count + 1)
    table = _reflectivity(model, grid, wavelength_nm)
    step = (high - low) / count
    width = min(count, max(1, math.ceil(2.0 * math.sin(min(source, receiver)) / step)))
    first, last = table[:-width], table[width:]
    most = np.maximum(np.maximum(first, last), 1e-30)
    change = float(np.max(np.abs(last - first) / most))
    return table, low, 1.0 / step, 2 if change < 0.02 else 4 if change < 0.4 else 8


def _spike_of_direction(
    model: Model,
    omega_i: Array,
    omega_r: Array,
    near: npt.NDArray[np.bool_],
    wavelength_nm: float,
    source: float,
    receiver: float,
    exact: bool,
) -> Array:
    """The limits where one cone is a direction (and where both are: infinite in the mirror direction)."""
    out = np.zeros(len(omega_i))
    for index in np.flatnonzero(near):
        seen = omega_r[index, 2] if exact and receiver == 0.0 else omega_i[index, 2]
        rho = float(_reflectivity(model, np.array([seen]), wavelength_nm)[0])
        w_r = float(np.sum(_cap_nodes(omega_r[index], receiver, CUT_ORDERS[-1])[1])) if receiver > 0.0 else 1.0
        if source > 0.0:
            s, s_weight = _cap_nodes(omega_i[index], source, CUT_ORDERS[-1])
            light = float(s_weight @ s[:, 2]) if exact else float(np.sum(s_weight)) * omega_i[index, 2]
        else:
            light = omega_i[index, 2]
        both = source == 0.0 and receiver == 0.0
        out[index] = 0.0 if rho == 0.0 else math.inf if both or light == 0.0 else rho / (light * w_r)
    return out


def _cut_spike(
    model: Model, omega_i: Array, omega_r: Array, wavelength_nm: float, source: float, receiver: float, exact: bool
) -> float:
    """One geometry in which the horizon cuts a cap: the overlap by summing over the receiver's, to about 1e-3."""
    s, s_weight = _cap_nodes(omega_i, source, CUT_ORDERS[-1])
    r, r_weight = (
        _caps.cut_nodes(omega_r, receiver, 48) if omega_r[2] < math.sin(receiver) else _dense(omega_r, receiver)
    )
    chord = r - omega_i * (-1.0, -1.0, 1.0)
    inside = np.einsum("nk,nk->n", chord, chord) <= (2.0 * math.sin(source / 2.0)) ** 2
    if exact:
        flux = float(r_weight[inside] @ _reflectivity(model, r[inside, 2], wavelength_nm)) if inside.any() else 0.0
        light = float(s_weight @ s[:, 2])
    else:
        flux = float(np.sum(r_weight[inside])) * float(_reflectivity(model, omega_i[2:3], wavelength_nm)[0])
        light = float(np.sum(s_weight)) * float(omega_i[2])
    return 0.0 if flux == 0.0 else math.inf if light == 0.0 else flux / (light * float(np.sum(r_weight)))


def _dense(omega: Array, half: float) -> tuple[Array, Array]:
    square, psi = np.meshgrid((np.arange(64) + 0.5) / 64.0, (np.arange(128) + 0.5) * (math.pi / 64.0), indexing="ij")
    weight = np.full(square.size, 4.0 * math.pi * math.sin(half / 2.0) ** 2 / square.size)
    return _caps.nodes(omega, half, square.ravel(), psi.ravel()), weight
