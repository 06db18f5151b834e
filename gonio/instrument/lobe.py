"""The average of a model's lobe over the cones of source and receiver; see `gonio.instrument.apparent`.

How a geometry is averaged, its *rule*, is found once for one model (`choose`) and can then be applied to others
(`by_rules`): what a fit does with hundreds of nearly equal ones, and what makes its derivatives smooth.
"""

import math

import numpy as np
import numpy.typing as npt

from gonio import geometry
from gonio.instrument import spherical_caps
from gonio.models import Model
from gonio.typing import Floats

Rules = npt.NDArray[np.int8]
"""One number a geometry: 0 to `_caps.LEVELS` - 1 the product rule of that level, or one of those below."""

EXPANSION, NARROW_LOBE, CUT = -1, -2, -3

TOLERANCE = 1e-7
"""Relative difference of two successive cubatures at which a lobe's average is taken."""
LOBE_TOLERANCE = 1e-5
"""The same where values are measured, rendered or fitted: a hundredth of the uncertainty of the best values."""
NARROW = 1e-4
"""Relative difference of the two finest cubatures above which a lobe counts as narrower than the cones."""
NOTHING = 1e-60
"""1/sr: where a lobe's largest value in the cones is below it, the second-order expansion is taken."""
PAIRS = 1 << 17  # pairs of directions evaluated at a time: bounds the memory
EXPANDED = 1 << 13  # geometries expanded at a time: their rings stay in the cache
CUT_ORDERS = (6, 10, 16)


def choose(
    model: Model,
    omega_i: Floats,
    omega_r: Floats,
    wavelength_nm: float,
    source: float,
    receiver: float,
    tolerance: float,
) -> tuple[Floats, Rules]:
    """Averages over both caps, (n,), and the rules that hold `tolerance` there."""
    out, rules = np.empty(len(omega_i)), np.full(len(omega_i), EXPANSION, np.int8)
    if source == 0.0 and receiver == 0.0:
        return np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)).reshape(-1), rules
    cut = (omega_i[:, 2] < math.sin(source)) | (omega_r[:, 2] < math.sin(receiver))
    rules[cut] = CUT
    for index in np.flatnonzero(cut):
        out[index] = _cut_lobe(model, omega_i[index], omega_r[index], wavelength_nm, source, receiver, tolerance)
    left = np.flatnonzero(~cut)
    if not left.size:
        return out, rules
    peak = _largest(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver)
    now, error = _second_order(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver)
    out[left] = now
    rough = ~((error <= tolerance) & (peak <= 3.0 * now)) & (peak > NOTHING)
    left, peak = left[rough], peak[rough]
    before = np.full(left.size, np.inf)
    for level in range(spherical_caps.LEVELS):
        if not left.size:
            return out, rules
        now = _product_rule(model, omega_i[left], omega_r[left], wavelength_nm, source, receiver, level)
        out[left], rules[left] = now, level
        # a lobe that so many rings resolve has an average not that far below its peak
        seen = peak <= 3.0 * spherical_caps.RINGS[level] ** 2 * now
        apart = np.abs(now - before)
        rules[left[apart <= tolerance * np.abs(now)]] = level - 1  # the one before holds it, at a fifth of the cost
        allowed = max(tolerance, NARROW) if level == spherical_caps.LEVELS - 1 else tolerance
        rough = ~((apart <= allowed * np.abs(now)) & seen)
        left, before, peak = left[rough], now[rough], peak[rough]
    rules[left] = NARROW_LOBE
    for index in left:
        out[index] = _narrow_lobe(model, omega_i[index], omega_r[index], wavelength_nm, source, receiver)
    return out, rules


def by_rules(
    model: Model,
    omega_i: Floats,
    omega_r: Floats,
    wavelength_nm: float,
    source: float,
    receiver: float,
    tolerance: float,
    rules: Rules,
) -> Floats:
    """Averages over both caps, (n,), by rules that were found before."""
    if source == 0.0 and receiver == 0.0:
        return np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)).reshape(-1)
    out = np.empty(len(omega_i))
    for rule in np.unique(rules):
        here = np.flatnonzero(rules == rule)
        l, v = omega_i[here], omega_r[here]  # noqa: E741
        if rule == EXPANSION:
            out[here] = _second_order(model, l, v, wavelength_nm, source, receiver)[0]
        elif rule >= 0:
            out[here] = _product_rule(model, l, v, wavelength_nm, source, receiver, int(rule))
        else:
            for index, (one, other) in zip(here, zip(l, v, strict=True), strict=True):
                out[index] = (
                    _cut_lobe(model, one, other, wavelength_nm, source, receiver, tolerance)
                    if rule == CUT
                    else _narrow_lobe(model, one, other, wavelength_nm, source, receiver)
                )
    return out


def _largest(
    model: Model, omega_i: Floats, omega_r: Floats, wavelength_nm: float, source: float, receiver: float
) -> Floats:
    """The BRDF between the directions of the caps that come nearest to mirroring each other: a lobe's peak."""
    mirror = geometry.mirrored(omega_i)
    chord, apart = mirror - omega_r, geometry.angle_between(mirror, omega_r)
    toward = chord - np.einsum("nk,nk->n", chord, omega_r)[:, None] * omega_r
    size = np.linalg.norm(toward, axis=1)[:, None]
    toward = np.where(size > 1e-12, toward / np.maximum(size, 1e-300), 0.0)
    share = apart * receiver / (source + receiver)

    def at(angle: Floats) -> Floats:
        turned: Floats = np.where(
            size > 1e-12, np.cos(angle)[:, None] * omega_r + np.sin(angle)[:, None] * toward, omega_r
        )
        return turned

    seen, lit = at(np.minimum(receiver, share)), at(np.maximum(apart - source, share)) * (-1.0, -1.0, 1.0)
    return np.asarray(model.brdf_vectors(lit, seen, wavelength_nm=wavelength_nm), dtype=np.float64).reshape(-1)


def _narrow_lobe(
    model: Model, omega_i: Floats, omega_r: Floats, wavelength_nm: float, source: float, receiver: float
) -> float:
    """One geometry whose lobe is far narrower than the wider cone: nodes there crowd about the mirror direction."""
    wide_source = source > receiver
    wide_axis, wide, axis, half = (
        (omega_i, source, omega_r, receiver) if wide_source else (omega_r, receiver, omega_i, source)
    )
    square, psi, weight = spherical_caps.disc_rule(4) if half > 0.0 else (np.zeros(1), np.zeros(1), np.ones(1))
    outer = spherical_caps.nodes(axis, half, square, psi)
    total = 0.0
    for first in range(0, len(outer), 32):
        part = slice(first, first + 32)
        inner, solid = spherical_caps.focused_nodes(wide_axis, wide, outer[part] * (-1.0, -1.0, 1.0))
        fixed = outer[part][:, None, :]
        pair = (inner, fixed) if wide_source else (fixed, inner)
        values = np.asarray(model.brdf_vectors(*pair, wavelength_nm=wavelength_nm))
        light = inner[..., 2] if wide_source else fixed[..., 2]
        total += float(weight[part] @ np.sum(values * light * solid, axis=1))
    if wide_source:
        return total / (math.pi * math.sin(source) ** 2 * float(omega_i[2]))
    return total / (4.0 * math.pi * math.sin(receiver / 2.0) ** 2 * float(weight @ outer[:, 2]))


def _second_order(
    model: Model, omega_i: Floats, omega_r: Floats, wavelength_nm: float, source: float, receiver: float
) -> tuple[Floats, Floats]:
    """f + the second-order terms of each cone alone, and the estimated size of what is left out, both from 13 values.

    With v the largest change of f over either ring and d the second-order terms, all relative to f, the next terms
    are of order v^4 and d^2.
    """
    total, error = np.empty(len(omega_i)), np.empty(len(omega_i))
    for first in range(0, len(omega_i), EXPANDED):
        part = slice(first, first + EXPANDED)
        total[part], error[part] = _expanded(model, omega_i[part], omega_r[part], wavelength_nm, source, receiver)
    return total, error


def _expanded(
    model: Model, omega_i: Floats, omega_r: Floats, wavelength_nm: float, source: float, receiver: float
) -> tuple[Floats, Floats]:
    square, psi, _ = spherical_caps.disc_rule(0)
    square, psi = square[1:], psi[1:]
    centre = np.asarray(model.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm)).reshape(-1)
    scale = np.where(centre > 0.0, centre, 1.0)
    change, change2, total = np.zeros_like(centre), np.zeros_like(centre), centre.copy()
    for axis, other, half, is_source in ((omega_i, omega_r, source, True), (omega_r, omega_i, receiver, False)):
        if half == 0.0:
            continue
        ring = spherical_caps.nodes(axis, half, square, psi)
        pair = (ring, other[:, None, :]) if is_source else (other[:, None, :], ring)
        values = np.asarray(model.brdf_vectors(*pair, wavelength_nm=wavelength_nm))
        if is_source:  # weighted by cos(theta_s): its mean over the ring is that of the axis times cos(rho)
            mean = np.sum(values * ring[..., 2], axis=1) / np.sum(ring[..., 2], axis=1)
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
    model: Model, omega_i: Floats, omega_r: Floats, wavelength_nm: float, source: float, receiver: float, level: int
) -> Floats:
    out = np.empty(len(omega_i))
    square, psi, weight = spherical_caps.disc_rule(level)
    one = np.zeros(1), np.zeros(1), np.ones(1)
    s_square, s_psi, s_weight = (square, psi, weight) if source > 0.0 else one
    r_square, r_psi, r_weight = (square, psi, weight) if receiver > 0.0 else one
    step = max(1, PAIRS // (len(s_weight) * len(r_weight)))
    for first in range(0, len(out), step):
        part = slice(first, first + step)
        from_source = spherical_caps.nodes(omega_i[part], source, s_square, s_psi)
        to_receiver = spherical_caps.nodes(omega_r[part], receiver, r_square, r_psi)
        values = np.asarray(
            model.brdf_vectors(from_source[:, :, None, :], to_receiver[:, None, :, :], wavelength_nm=wavelength_nm)
        )
        light = s_weight * from_source[..., 2]
        out[part] = np.einsum("gsr,gs,r->g", values, light, r_weight) / np.sum(light, axis=1)
    return out


def _cut_lobe(
    model: Model,
    omega_i: Floats,
    omega_r: Floats,
    wavelength_nm: float,
    source: float,
    receiver: float,
    tolerance: float,
) -> float:
    """One geometry in which the horizon cuts a cap."""
    before = math.inf
    now = 0.0
    for order in CUT_ORDERS:
        s, s_weight = cap_nodes(omega_i, source, order)
        r, r_weight = cap_nodes(omega_r, receiver, order)
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


def cap_nodes(omega: Floats, half: float, order: int) -> tuple[Floats, Floats]:
    """Nodes and solid angles [sr] of what lies above the horizon of the cap about one axis."""
    if half == 0.0:
        return omega[None, :], np.ones(1)
    if omega[2] < math.sin(half):
        return spherical_caps.cut_nodes(omega, half, order)
    square, psi, weight = spherical_caps.disc_rule(CUT_ORDERS.index(order) + 2)
    return spherical_caps.nodes(omega, half, square, psi), weight * (4.0 * math.pi * math.sin(half / 2.0) ** 2)
