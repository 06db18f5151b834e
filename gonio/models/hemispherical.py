"""Reflectances for light from, or toward, the whole hemisphere: quadrature of a model's BRDF times a cosine.

Models of facets are integrated over the facets' normals H, where their distribution is a function of one angle and
every kink of the V-grooves is known in closed form (`over_facets`). Any other model goes through an adaptive rule over
the moving direction (`over_directions`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.errors import DataError
from gonio.models import engine
from gonio.models._compile import loop, template
from gonio.models._facets import above, by_angle, by_sxy2, by_tan2
from gonio.models._hemisphere import gauss
from gonio.models._math import HALF_PI, sincos
from gonio.models.engine import Constants, Kernel
from gonio.models.parameters import number
from gonio.typing import ArrayLike, Floats

if TYPE_CHECKING:
    from gonio.models.model import Model

TOLERANCE = 1e-8
"""Relative error of the integrals, by the difference between two rules of which the better one counts."""
NOTHING = 1e-22
"""Reflectances below this are right to `TOLERANCE` of it alone."""
WIDTHS = (1.0, 2.5, 6.4)
"""Where a distribution exp(-x^2) changes; beyond the last 1e-17 of it is left."""
ORDERS = ((4, 3), (6, 4), (8, 6), (12, 9), (18, 14), (27, 21), (40, 32), (60, 48), (90, 72))
"""Nodes in a panel of alpha and in one of beta, from rule to rule."""
COARSE_TOLERANCE, COARSE_RULES = 1e-6, 2
"""Only for a tolerance above this are the first rules tried, whose agreement says little more."""


def reflectance(
    model: Model,
    theta: ArrayLike,
    phi: ArrayLike,
    wavelength_nm: ArrayLike,
    *,
    viewer: bool,
    spike: bool,
    tolerance: float = TOLERANCE,
) -> Any:
    """rho_dh for a source, or (`viewer`) rho_hd for a viewer, at arguments that are checked here and broadcast."""
    tolerance = number("tolerance", tolerance, 1e-12, 0.1)
    names = ("theta_r", "phi_r") if viewer else ("theta_i", "phi_i")
    polar, azimuth = (engine.real_array(name, value) for name, value in zip(names, (theta, phi), strict=True))
    nothing = [np.zeros(1)] * 2
    engine.check_angles([*nothing, polar, azimuth] if viewer else [polar, azimuth, *nothing])
    waves = engine.real_array("wavelength_nm", wavelength_nm)
    shape = engine.common_shape((*names, "wavelength_nm"), [polar.shape, azimuth.shape, waves.shape])
    polar, azimuth, waves = (np.broadcast_to(array, shape).ravel() for array in (polar, azimuth, waves))
    out = np.empty(polar.size)
    for wave in np.unique(waves):
        here = waves == wave
        mirror = model.specular_reflectivity(polar[here], wavelength_nm=float(wave))  # which checks the wavelength too
        out[here] = model._hemispherical(polar[here], azimuth[here], float(wave), viewer, tolerance)
        if spike:
            out[here] += mirror
    return out.reshape(shape)[()]


# --- over facets ----------------------------------------------------------------------------------------------------


@template("r1 r1 r1 r1 r1 r1 r1 r1 r1 i p w1 i i", columns=True)
def _over_azimuths(fixed_x, fixed_z, sin_a, cos_a, own, low, high, node, weight, per_s2, constants, out, start, stop):  # type: ignore[no-untyped-def]
    """The integral over the azimuth beta of H, between two angles, of BRDF cos(moving) 4 (V.H), one a row.

    The kernel's columns follow from H without the cancellation of L + V: `own`, times |L + V|^2 where `per_s2`, then
    |L + V|^2, (L + V)_z and g.
    """
    for j in range(start, stop):
        vx, vz, sa, ca = fixed_x[j], fixed_z[j], sin_a[j], cos_a[j]
        first, width = low[j], high[j] - low[j]
        total = 0.0
        for k in range(node.size):
            _, cos_b = sincos(first + width * node[k])
            vh = ca * vz + sa * vx * cos_b
            lz = above(2.0 * vh * ca - vz)
            s2 = 4.0 * vh * vh
            sz = 2.0 * vh * ca
            g = max(lz, vz) * max(sz * min(lz, vz), 0.25 * s2)
            value = kernel(own[j] * (s2 if per_s2 != 0 else 1.0), s2, sz, g, constants)  # type: ignore[name-defined]  # noqa: F821
            total += weight[k] * value * lz * 4.0 * vh
        out[j] = width * total
    return 0


@template("r1 r1 r1 r1 r1 r1 r1 r1 r1 i p w1 i i", columns=True)
def _over_azimuths_by_light(  # type: ignore[no-untyped-def]
    fixed_x, fixed_z, sin_a, cos_a, own, low, high, node, weight, viewer, constants, out, start, stop
):
    """The same for a kernel of `own` and N.L."""
    for j in range(start, stop):
        vx, vz, sa, ca = fixed_x[j], fixed_z[j], sin_a[j], cos_a[j]
        first, width = low[j], high[j] - low[j]
        total = 0.0
        for k in range(node.size):
            _, cos_b = sincos(first + width * node[k])
            vh = ca * vz + sa * vx * cos_b
            moving = above(2.0 * vh * ca - vz)
            value = kernel(own[j], moving if viewer != 0 else vz, constants)  # type: ignore[name-defined]  # noqa: F821
            total += weight[k] * value * moving * 4.0 * vh
        out[j] = width * total
    return 0


def over_facets(
    kernel: Kernel,
    constants: Constants,
    theta: Floats,
    viewer: bool = False,
    *,
    scales: Sequence[float],
    reach: float = HALF_PI,
    index: tuple[float, float] | None = None,
    tolerance: float = TOLERANCE,
) -> Floats:
    """The integral of a facet model's lobe times the cosine of the moving direction, to a relative `tolerance`.

    H = (alpha, beta) about the normal, beta = 0 toward the fixed direction V; L = 2 (V.H) H - V and dw_L = 4 (V.H)
    dw_H. V.H is linear in cos(beta), so that at one alpha the horizon, the kinks of Blinn's G and total reflection lie
    at angles beta in closed form. Between the alphas where one of these begins or ends all is smooth, but for roots at
    the ends, which the map of a panel of alpha takes out.

    Parameters
    ----------
    kernel, constants
        The model's, without what is not its lobe.
    theta
        Polar angles of the fixed direction [rad], (n,).
    viewer
        Whether the fixed direction is the viewer's; it counts for a kernel that knows N.L from N.V (Phong's).
    scales
        Angles alpha [rad] where the distribution changes.
    reach
        The angle alpha beyond which nothing is left of it.
    index
        Re n~^2 - 1 and Im n~^2 / 2 of the facets; None where the reflectance is a smooth function of V.H.

    Raises
    ------
    DataError
        The finest rule does not agree with the one before.
    """
    out = np.zeros(theta.size)
    open_ = np.arange(theta.size)
    before = np.full(theta.size, np.nan)
    levels, rooted = _fresnel_levels(index) if index else ([], False)
    edges = _alpha_edges(theta, scales, reach, levels)
    for n_alpha, n_beta in ORDERS[0 if tolerance > COARSE_TOLERANCE else COARSE_RULES :]:
        rules = unit_rule(n_alpha, True), unit_rule(n_beta, rooted)
        value = _facet_rule(kernel, constants, theta[open_], edges[open_], viewer, levels, *rules)
        out[open_] = value
        with np.errstate(invalid="ignore"):
            held = np.abs(value - before[open_]) <= TOLERANCE * np.maximum(np.abs(value), NOTHING)
        held |= value == before[open_]  # inf
        before[open_] = value
        open_ = open_[~held]
        if open_.size == 0:
            return out
    worst = open_[0]
    raise DataError(
        f"the hemispherical reflectance at {math.degrees(theta[worst]):.6g} deg: rules of "
        f"{ORDERS[-2][0]} and {ORDERS[-1][0]} nodes a panel differ by more than {tolerance:g} of it"
    )


def _own_column(take: Callable[..., Any], alpha: Floats, sin_a: Floats, cos_a: Floats) -> Floats:
    """The first column of a kernel as a function of alpha: over |L + V|^2 where it is |(L + V)_xy|^2."""
    if take is by_tan2:
        return np.asarray((sin_a / cos_a) ** 2)
    if take is by_angle:
        return alpha * alpha
    if take is by_sxy2:
        return sin_a * sin_a
    gentle = np.log1p(-np.minimum(sin_a * sin_a, 0.5))
    return np.asarray(np.where(sin_a < 0.7, gentle, 2.0 * np.log(cos_a)))  # ln cos^2


def _fresnel_levels(index: tuple[float, float]) -> tuple[list[float], bool]:
    """Values of V.H where the reflectance changes fast, and whether it has a root there (total reflection)."""
    rise, loss = index
    if -1.0 < rise < 0.0:
        return [math.sqrt(-rise)], True
    large = math.sqrt(math.hypot(1.0 + rise, 2.0 * loss))  # |n~|; toward grazing it is a function of V.H |n~|
    return [0.3 / large * 8.0**k for k in range(max(0, math.ceil(math.log(large, 8.0))))] if large > 4.0 else [], False


def _alpha_edges(theta: Floats, scales: Sequence[float], reach: float, levels: Sequence[float]) -> Floats:
    """Ends of panels of alpha for each angle, sorted, (n, edges); panels may be empty."""
    rest = HALF_PI - theta
    top = np.minimum(0.5 * (HALF_PI + theta), reach)  # beyond it L is below the horizon for every beta
    where = [np.zeros(theta.size), top, theta, rest, 0.5 * rest, rest / 3.0, (HALF_PI + theta) / 3.0]
    where += [np.full(theta.size, scale) for scale in (math.pi / 4, math.pi / 3, *scales)]  # where kinks cross
    for level in levels:
        where += [np.abs(theta - math.acos(level)), theta + math.acos(level)]
        vz = np.cos(theta)
        crossing = [level / (2.0 * np.maximum(vz, 1e-300)), vz / level, vz / (2.0 * level)]  # a kink of G, the horizon
        crossing.append((vz + np.sqrt(vz * vz + 4.0 * level * level)) / (4.0 * level))
        where += [np.arccos(np.minimum(cosine, 1.0)) for cosine in crossing]
    steps = min(30, math.ceil(math.log(HALF_PI / max(float(rest.min(initial=HALF_PI)), 1e-17), 4.0)))
    where += [rest * 4.0**k for k in range(1, steps)]  # near grazing all is a function of alpha/(pi/2 - theta)
    return np.sort(np.clip(np.stack(where, axis=1), 0.0, top[:, None]), axis=1)


def _facet_rule(
    kernel: Kernel,
    constants: Constants,
    theta: Floats,
    edges: Floats,
    viewer: bool,
    levels: Sequence[float],
    alpha_rule: tuple[Floats, Floats],
    beta_rule: tuple[Floats, Floats],
) -> Floats:
    t, w_t = alpha_rule
    node, weight = beta_rule
    width = np.diff(edges, axis=1)
    owner, panel = np.nonzero(width > 1e-300)
    wide = width[owner, panel][:, None]
    alpha = (edges[owner, panel][:, None] + wide * t).ravel()
    w_alpha = (wide * w_t).ravel()
    owner = np.repeat(owner, t.size)
    sin_v, cos_v = np.sin(theta), np.cos(theta)
    cos_v[theta >= HALF_PI] = 0.0
    sin_a, cos_a = np.sin(alpha), np.cos(alpha)
    vx, vz = sin_v[owner], cos_v[owner]
    level, swing = cos_a * vz, sin_a * vx  # V.H = level + swing cos(beta)
    square = 4.0 * cos_a * cos_a
    kinks = [
        0.5 * vz / cos_a,  # N.L = 0
        2.0 * cos_a * vz,  # G's branch of V begins
        np.where(square > 1.0, 2.0 * cos_a * vz / np.where(square > 1.0, square - 1.0, 1.0), 2.0),  # G's branch of L
        vz / cos_a,  # N.L = N.V
    ]
    kinks += [np.full(alpha.size, level) for level in levels]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        cosines = (np.stack(kinks) - level) / swing
    angles = np.arccos(np.fmin(np.fmax(cosines, -1.0), 1.0))  # 0/0 counts as -1: no kink
    last = angles[0]  # the horizon: larger beta have L below it
    ends = np.sort(np.concatenate([np.zeros((1, alpha.size)), np.minimum(angles, last)]), axis=0)
    piece, row = np.nonzero(np.diff(ends, axis=0) > 1e-300)
    inner = np.empty(row.size)
    take = kernel.__dict__["columns"]
    own, choice = _own_column(take, alpha, sin_a, cos_a), int(take is by_sxy2)
    over = _over_azimuths
    if kernel.__dict__["count"] == 2:
        over, choice = _over_azimuths_by_light, int(viewer)
    run = loop(over, kernel, len(constants))
    columns = [array[row] for array in (vx, vz, sin_a, cos_a, own)] + [ends[piece, row], ends[piece + 1, row]]
    engine.in_parts(lambda i, j: run(*columns, node, weight, choice, constants, inner, i, j), row.size, 4096)
    # beta from 0 to pi: the other half is the same
    total = np.bincount(owner[row], 2.0 * inner * (w_alpha * sin_a)[row], minlength=theta.size)
    return total.astype(np.float64)  # of no rows it would be of integers


def unit_rule(order: int, rooted: bool = False) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights on [0, 1]; `rooted`: running quadratically into both ends, for roots there."""
    x, w = gauss(order)
    t, w = 0.5 * (1.0 + x), 0.5 * w
    return (t * t * (3.0 - 2.0 * t), w * 6.0 * t * (1.0 - t)) if rooted else (t, w)


# --- over directions ------------------------------------------------------------------------------------------------

COARSE, FINE = 8, 12
"""Nodes a side of the two rules that tell the error of a box."""
MOST_BOXES = 20_000
LEAST_REST = 1e-6
"""Angle from grazing [rad] below which boxes shrink no further: 1e-12 of the hemisphere's cosines lie there."""


def over_directions(
    model: Model,
    theta: Floats,
    phi: Floats,
    wavelength_nm: float,
    viewer: bool,
    *,
    even: bool = False,
    tolerance: float = TOLERANCE,
) -> Floats:
    """The integral of any model's BRDF times the cosine of the moving direction, by halving boxes of its angles.

    Boxes of the moving direction's polar angle and azimuth begin at the fixed direction's own polar angle and at
    quarter turns from its azimuth, so that the mirror and the retro direction are corners. They shrink toward the
    horizon as far as the fixed direction is from it: quartering would cut the azimuth there in vain. Each goes through
    products of Gauss rules of two orders, and the boxes whose difference is too large are quartered. A lobe that
    stands elsewhere and is narrower than a twelfth of a box may be missed.

    Parameters
    ----------
    model
        The model; its `brdf_vectors` is called.
    theta, phi
        The fixed directions [rad], (n,).
    wavelength_nm
        Wavelength [nm].
    viewer
        Whether the fixed directions are viewers'.
    even
        Whether the BRDF is the same on both sides of the plane of incidence: half of the directions then do.
    tolerance
        Relative error of the integral.

    Raises
    ------
    DataError
        It takes more than 20 000 boxes a direction.
    """
    pairs = zip(theta, phi, strict=True)
    return np.array([_over_boxes(model, t, p, wavelength_nm, viewer, even, tolerance) for t, p in pairs])


def _over_boxes(
    model: Model, theta: float, phi: float, wavelength_nm: float, viewer: bool, even: bool, tolerance: float
) -> float:
    fixed = np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])
    if theta >= HALF_PI:
        fixed[2] = 0.0

    def integrand(polar: Floats, azimuth: Floats) -> Floats:
        sine, cosine = np.sin(polar), np.cos(polar)
        parts = sine * np.cos(phi + azimuth), sine * np.sin(phi + azimuth), cosine
        moving = np.stack(np.broadcast_arrays(*parts), axis=-1)
        pair = (moving, fixed) if viewer else (fixed, moving)
        sides = 2.0 if even else 1.0
        return np.asarray(sides * model.brdf_vectors(*pair, wavelength_nm=wavelength_nm) * sine * cosine)

    rest = max(HALF_PI - theta, LEAST_REST)
    toward = HALF_PI - rest * 4.0 ** np.arange(1.0, math.log(HALF_PI / rest, 4.0))
    turns = HALF_PI * np.arange(3.0 if even else 5.0)
    return adaptive(
        integrand,
        boxes(np.unique([0.0, *toward, theta, HALF_PI]), turns),
        tolerance,
        f"{model.name}: {math.degrees(theta):.6g} deg",
    )


def boxes(first: Sequence[float] | Floats, second: Sequence[float] | Floats) -> Floats:
    """Boxes (n, 4) between edges of two variables: low and high of the one, low and high of the other."""
    return np.array([(a, b, c, d) for a, b in pairwise(first) for c, d in pairwise(second)])


def adaptive(integrand: Callable[[Floats, Floats], Floats], boxes: Floats, tolerance: float, name: str) -> float:
    """The integral over boxes, of which those are quartered where rules of two orders differ too much.

    Parameters
    ----------
    integrand
        Values (n, k, k) at the two variables, (n, k, 1) and (n, 1, k), in n boxes; none of them lies on an edge.
    boxes
        Where to begin (`boxes`); they cover what is integrated over.
    tolerance
        Relative error of the sum.
    name
        The model and the angle, for the message.

    Raises
    ------
    DataError
        It takes more than 20 000 boxes.
    """

    def size(some: Floats) -> Floats:
        return np.asarray((some[:, 1] - some[:, 0]) * (some[:, 3] - some[:, 2]))

    def rule(some: Floats, order: int) -> Floats:
        node, weight = unit_rule(order)
        a, b, c, d = some.T[:, :, None]
        value = integrand((a + (b - a) * node)[:, :, None], (c + (d - c) * node)[:, None, :])
        return np.asarray(size(some) * np.einsum("bij,i,j->b", value, weight, weight))

    whole = float(size(boxes).sum())
    done, used = 0.0, 0
    while len(boxes):
        used += len(boxes)
        value = rule(boxes, FINE)
        off = np.abs(value - rule(boxes, COARSE))
        total = done + float(value.sum())
        if not math.isfinite(total):
            return total
        allowed = tolerance * abs(total)
        if off.sum() <= allowed:
            return total
        # half of what is allowed, by area, is for boxes that are done
        split = off > 0.5 * allowed * size(boxes) / whole
        done += float(value[~split].sum())
        boxes = _quartered(boxes[split])
        if used + len(boxes) > MOST_BOXES:
            raise DataError(
                f"{name}: the hemispherical reflectance is known to {off.sum() / abs(total):.1g} of it after {used} "
                f"boxes of directions, not to {tolerance:g}"
            )
    return done


def _quartered(boxes: Floats) -> Floats:
    a, b, c, d = boxes.T
    m, n = 0.5 * (a + b), 0.5 * (c + d)
    return np.concatenate(
        [np.stack(quarter, axis=1) for quarter in ((a, m, c, n), (a, m, n, d), (m, b, c, n), (m, b, n, d))]
    )
