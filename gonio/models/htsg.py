"""The parts of He, Torrance, Sillion and Greenberg (1991) as functions: series, shadowing, effective roughness.

`HeTorrance` evaluates the same formulas in blocks (`gonio.models._htsg_kernels`, `_htsg_series`).
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import math
from typing import Any

import numpy as np

from gonio.errors import ArgumentError
from gonio.models import engine
from gonio.models._compile import device, loop, template
from gonio.models._htsg_kernels import shadowing as pair_shadowing
from gonio.models._htsg_series import expand, expm1, lambert_w
from gonio.models._math import HALF_PI, log, sincos_polar
from gonio.models.parameters import choice
from gonio.typing import ArrayLike

__all__ = ["effective_roughness", "log_series", "shadowing"]


def log_series(g: ArrayLike, c: ArrayLike) -> Any:
    """ln S(g, c), S = sum over m >= 1 of exp(-g) g^m / (m! m) exp(-c/m): the sum of He1991 eq. 78.

    Parameters
    ----------
    g
        Apparent roughness squared, g = (2 pi sigma/lambda)^2 (cos theta_i + cos theta_r)^2, at least 0.
    c
        v_xy^2 tau^2 / 4, at least 0.

    Returns
    -------
    float64 array of the shape that the arguments broadcast to; -inf at g = 0. Its error is below
    3e-14 (1 + |dlnS/dlng| + |dlnS/dlnc|) for g up to 1e8 and c up to 1e10; S may be far below the smallest double.

    Raises
    ------
    ArgumentError
        An argument is negative, infinite or NaN; it names the argument.
    """
    return _over_pairs(_log_series, {"g": g, "c": c}, ())


def shadowing(theta: ArrayLike, sigma0: ArrayLike, tau: ArrayLike, form: str = "smith") -> Any:
    """S_1(theta), the shadowing of one direction (He1991 eqs. 24, 25); S = S_1(theta_i) S_1(theta_r).

    Parameters
    ----------
    theta
        Polar angle [rad], in [0, pi/2].
    sigma0, tau
        Rms roughness (at least 0) and correlation length (above 0), in the same unit.
    form
        "smith": with the factor exp(-h^2) in eq. 25, as Smith (1967) has it and Monte-Carlo confirms; "paper": as
        printed.

    Returns
    -------
    float64 array of the shape that the arguments broadcast to, in [0, 1]; 0 at exactly grazing for a rough surface.

    Raises
    ------
    ArgumentError
        An argument is outside its range; it names the argument.
    """
    printed = float(choice("form", form, ("smith", "paper")) == "paper")
    angle, rough, length = (
        engine.real_array(name, value) for name, value in (("theta", theta), ("sigma0", sigma0), ("tau", tau))
    )
    for name, array, good, allowed in (
        ("theta", angle, (angle >= 0.0) & (angle <= HALF_PI), "in [0, pi/2] rad"),
        ("sigma0", rough, (rough >= 0.0) & np.isfinite(rough), "finite and at least 0"),
        ("tau", length, (length > 0.0) & np.isfinite(length), "finite and above 0"),
    ):
        _require(name, array, good, allowed)
    with np.errstate(divide="ignore", over="ignore"):
        slope = np.minimum(length / (2.0 * rough), 1e100)
    return _over_pairs(_shadowing, {"theta": angle, "slope": slope}, (printed,))


def effective_roughness(K: ArrayLike) -> Any:
    """sigma / sigma0 = 1/sqrt(1 + W0(K^2/8 pi)): He1991 eqs. 80-83 in closed form.

    Parameters
    ----------
    K
        K_i + K_r, K = tan(theta) erfc(tau cot(theta) / 2 sigma0), at least 0 (infinity allowed).

    Returns
    -------
    float64 array of the argument's shape, in [0, 1], to a few units in the last place from 0 to the largest double.

    Raises
    ------
    ArgumentError
        K is negative or NaN.
    """
    array = engine.real_array("K", K)
    _require("K", array, array >= 0.0, "at least 0")
    return _over_pairs(_effective_roughness, {"K": np.minimum(array, 1.7e308), "zero": 0.0}, ()) * (array < np.inf)


def _require(name: str, array: Any, good: Any, allowed: str) -> None:
    if not np.all(good):
        worst = array.reshape(-1)[np.flatnonzero(~np.asarray(good).reshape(-1))[0]]
        raise ArgumentError(f"{name} = {worst:.17g}: must be {allowed}")


def _over_pairs(kernel: Any, arguments: dict[str, ArrayLike], constants: tuple[float, ...]) -> Any:
    arrays = []
    for name, value in arguments.items():
        array = engine.real_array(name, value)
        _require(name, array, (array >= 0.0) & np.isfinite(array), "finite and at least 0")
        arrays.append(array)
    out = np.empty(engine.common_shape(tuple(arguments), [array.shape for array in arrays]))
    a, b = (np.ascontiguousarray(np.broadcast_to(array, out.shape)).reshape(-1) for array in arrays)
    flat = out.reshape(-1)
    run = loop(over_pairs, kernel, len(constants) + 1)
    engine.in_parts(lambda i, j: run(a, b, (*constants, 0.0), flat, i, j), a.size, 4096)
    return out[()]


@template("r1 r1 p w1 i i")
def over_pairs(first, second, constants, out, start, stop):
    for j in range(start, stop):
        out[j] = kernel(first[j], second[j], constants)  # type: ignore[name-defined]  # noqa: F821
    return 0


@device
def _shadowing(theta, slope, p):
    printed, _ = p
    sine, cosine = sincos_polar(theta)
    lit, whole, _, _, _ = pair_shadowing(cosine, sine, cosine, sine, slope, printed)
    return min(cosine * lit / whole, 1.0)  # He1991 eq. 24


@device
def _effective_roughness(k, zero, p):
    if k < 1e139:
        return math.sqrt(lambert_w(k * k * (0.125 / math.pi))[1])
    return 1.0 / math.sqrt(1.0 + _lambert_w_of_exp(2.0 * math.log(k) + math.log(0.125 / math.pi)))


@device
def _lambert_w_of_exp(y):
    """W0(e^y) for large y: w + ln w = y, by Newton from y - ln y."""
    w = y - math.log(y)
    for _ in range(4):
        w -= (w + math.log(w) - y) * w / (1.0 + w)
    return w


@device
def _log_series(g, c, constants):
    if g == 0.0:
        return -math.inf
    # the largest term is at m0 = g e^(w/2), w = W0(2c/g^2), by logarithms where that is large; p = 1/(1 + w)
    if 2.0 * c < 1e280 * g * g:
        w, p, rise = lambert_w(2.0 * c / (g * g))
    else:
        w = _lambert_w_of_exp(math.log(2.0 * max(c, 1e-300)) - 2.0 * math.log(g))
        p, rise = 1.0 / (1.0 + w), expm1(0.5 * w)
    m0 = math.exp(0.5 * w + math.log(g))
    if m0 > 40.0 and m0 * p > 1.9:
        per_m0, width, bracket, work = np.empty(1), np.empty(1), np.empty(1), np.empty((3, 1))
        per_m0[0], width[0] = 1.0 / m0, p
        band = 3 if m0 < 120.0 else 4 if m0 < 1536.0 else 5
        expand(0, band, 1, per_m0, width, bracket, work)
        return g * (rise * (1.0 - w) - w) + math.log(math.sqrt(p) / m0 * bracket[0])
    top = max(1.0, math.floor(m0 + 0.5))
    log_top = top * math.log(g) - g - math.lgamma(top + 1.0) - math.log(top) - c / top
    return log_top + log(sum_around(g, c, top))


@device
def sum_around(g, c, top):
    """The series over its term at m = top, the largest, by ratios of terms to both sides until they no longer count."""
    total, term, m = 1.0, 1.0, top
    while term > 1e-18 * total:
        term *= g * m / ((m + 1.0) * (m + 1.0)) * math.exp(c / (m * (m + 1.0)))
        m += 1.0
        total += term
    term, m = 1.0, top
    while m > 1.0 and term > 1e-18 * total:
        term *= m * m / (g * (m - 1.0)) * math.exp(-c / (m * (m - 1.0)))
        m -= 1.0
        total += term
    return total
