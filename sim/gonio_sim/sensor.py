"""The compiled sensor: from expected electrons to DN, with a counter-based random generator.

Every pixel of every frame has a stream of its own: splitmix64, started at a hash of the frame's key and the pixel's
number. So a frame is the same whatever the order of its pixels and the number of threads. Charge is an exact Poisson
number below `EXACT_BELOW` expected electrons, and a Gaussian of the same mean and variance above it.

References: splitmix64, Steele, Lea and Flood, OOPSLA 2014; normal numbers by the ziggurat of Marsaglia and Tsang,
J. Stat. Soft. 5(8), 2000, in Doornik's 64-bit form; Poisson numbers by inversion, and by PTRS of Hormann, Insurance:
Mathematics and Economics 12, 1993; the chain of effects, EMVA Standard 1288, release 4.0, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import njit

EXACT_BELOW = 100.0
"""Expected electrons from which on the Gaussian stands for the Poisson distribution (its skewness there is 0.1)."""

_INVERSION_BELOW = 12.0
_TAIL = 3.6541528853610088  # where the ziggurat's 256 layers of equal area end
_LAYERS = 256
_BITS = 52

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_U1, _U8, _U9, _U11, _U12, _U27, _U30, _U31 = (np.uint64(n) for n in (1, 8, 9, 11, 12, 27, 30, 31))
_LAYER_MASK = np.uint64(_LAYERS - 1)
_UNIT = 2.0**-53

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _jit(function: Kernel) -> Kernel:
    return cast(Kernel, njit(cache=True, nogil=True, error_model="numpy")(function))


def _inline(function: Kernel) -> Kernel:
    return cast(Kernel, njit(nogil=True, error_model="numpy", inline="always")(function))


def _ziggurat() -> tuple[npt.NDArray[np.uint64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Largest accepted integer, width of a unit, and density at the edge, of each layer."""
    scale = 2.0**_BITS
    area = _TAIL * math.exp(-0.5 * _TAIL**2) + math.sqrt(math.pi / 2.0) * math.erfc(_TAIL / math.sqrt(2.0))
    accept, width, density = np.empty(_LAYERS, np.uint64), np.empty(_LAYERS), np.empty(_LAYERS)
    base = area / math.exp(-0.5 * _TAIL**2)
    accept[0], accept[1] = int(_TAIL / base * scale), 0
    width[0], width[-1] = base / scale, _TAIL / scale
    density[0], density[-1] = 1.0, math.exp(-0.5 * _TAIL**2)
    edge = _TAIL
    for layer in range(_LAYERS - 2, 0, -1):
        inner = math.sqrt(-2.0 * math.log(area / edge + math.exp(-0.5 * edge**2)))
        accept[layer + 1] = int(inner / edge * scale)
        width[layer], density[layer] = inner / scale, math.exp(-0.5 * inner**2)
        edge = inner
    return accept, width, density


_ACCEPT, _WIDTH, _DENSITY = _ziggurat()
_LOG_FACTORIAL = np.array([math.lgamma(k + 1.0) for k in range(512)])


@_inline
def _mix(state: Any) -> Any:
    z = (state ^ (state >> _U30)) * _MIX_1
    z = (z ^ (z >> _U27)) * _MIX_2
    return z ^ (z >> _U31)


@_inline
def _uniform(state: Any) -> Any:
    """A number in (0, 1), and the next state."""
    state += _GOLDEN
    return (np.float64(_mix(state) >> _U11) + 0.5) * _UNIT, state


@_jit
def _normal_slow(state: Any, layer: Any, x: Any, negative: Any) -> Any:
    """The ziggurat's rejections and its tail, from a first draw that missed the layers' cores."""
    while True:
        if layer == 0:
            while True:  # the tail beyond `_TAIL`, after Marsaglia
                u, state = _uniform(state)
                v, state = _uniform(state)
                tail = -math.log(u) / _TAIL
                if -2.0 * math.log(v) > tail * tail:
                    x = _TAIL + tail
                    return (-x if negative else x), state
        u, state = _uniform(state)
        if _DENSITY[layer] + (_DENSITY[layer - 1] - _DENSITY[layer]) * u < math.exp(-0.5 * x * x):
            return (-x if negative else x), state
        state += _GOLDEN
        bits = _mix(state)
        layer = np.int64(bits & _LAYER_MASK)
        negative = ((bits >> _U8) & _U1) != 0
        fraction = bits >> _U12
        x = np.float64(fraction) * _WIDTH[layer]
        if fraction < _ACCEPT[layer]:
            return (-x if negative else x), state


@_inline
def _normal(state: Any) -> Any:
    """A standard normal number, and the next state."""
    state += _GOLDEN
    bits = _mix(state)
    layer = np.int64(bits & _LAYER_MASK)
    negative = ((bits >> _U8) & _U1) != 0
    fraction = bits >> _U12
    x = np.float64(fraction) * _WIDTH[layer]
    if fraction < _ACCEPT[layer]:
        return (-x if negative else x), state
    return _normal_slow(state, layer, x, negative)


@_jit
def _poisson(state: Any, mean: Any) -> Any:
    """A Poisson number of a mean from 0 to `EXACT_BELOW`, and the next state."""
    if mean < _INVERSION_BELOW:
        u, state = _uniform(state)
        term = math.exp(-mean)
        k = 0
        while u > term and k < 200:  # 200: beyond any u below 1 - 2^-53
            u -= term
            k += 1
            term *= mean / k
        return np.float64(k), state
    b = 0.931 + 2.53 * math.sqrt(mean)
    a = -0.059 + 0.02483 * b
    bound = 0.9277 - 3.6224 / (b - 2.0)
    while True:
        u, state = _uniform(state)
        v, state = _uniform(state)
        u -= 0.5
        left = 0.5 - abs(u)
        k = math.floor((2.0 * a / left + b) * u + mean + 0.43)
        if left >= 0.07 and v <= bound:
            return np.float64(k), state
        if k < 0 or (left < 0.013 and v > left):
            continue
        factorial = _LOG_FACTORIAL[k] if k < 512 else math.lgamma(k + 1.0)
        ratio = v * (1.1239 + 1.1328 / (b - 3.4)) / (a / (left * left) + b)
        if math.log(ratio) <= k * math.log(mean) - mean - factorial:
            return np.float64(k), state


@_jit
def normals(key: Any, first: int, last: int, scale: float, centre: float, out: Any) -> None:
    """Fill out[first:last] with centre + scale times the standard normal number of each index."""
    for i in range(first, last):
        z, _ = _normal(_mix(key + np.uint64(i) * _GOLDEN))
        out[i] = centre + scale * z


@_jit
def expose(
    rate: Any,
    exposure: float,
    gain: Any,
    offset: Any,
    dark: float,
    photon_noise: bool,
    read_noise: float,
    full_well: float,
    per_dn: float,
    black: float,
    white: float,
    key: Any,
    first: int,
    last: int,
    out: Any,
) -> None:
    """Fill out[first:last] with the DN of one frame.

    Parameters
    ----------
    rate
        Expected electrons of each pixel in a unit of `exposure`; of size 1 where all are alike (a dark frame).
    exposure
        Exposure time times the lamp's level [s].
    gain, offset
        Each pixel's relative responsivity, and its dark offset [e-]; of size 1 where all are alike.
    dark
        Expected electrons of the dark current.
    """
    for i in range(first, last):
        mean = exposure * rate[i if rate.size > 1 else 0] * gain[i if gain.size > 1 else 0] + dark
        state = _mix(key + np.uint64(i) * _GOLDEN)
        charge = mean
        if photon_noise:
            if mean >= EXACT_BELOW:
                z, state = _normal(state)
                charge = mean + math.sqrt(mean) * z
            else:
                charge, state = _poisson(state, mean)
        charge = min(charge, full_well) + offset[i if offset.size > 1 else 0]
        if read_noise > 0.0:
            z, state = _normal(state)
            charge += read_noise * z
        level = math.floor(charge / per_dn + black + 0.5)
        out[i] = np.uint16(min(max(level, 0.0), white))
