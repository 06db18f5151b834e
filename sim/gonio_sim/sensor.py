"""The compiled sensor: from expected electrons to DN, with a counter-based random generator.

The random bits of a pixel are a hash of the frame's key and the pixel's number (splitmix64), so a frame is the same
whatever the order of its pixels and the number of threads. One hash gives two normal numbers (Box and Muller), which
reach 6.6 standard deviations. The loop over them has no branch and works in single precision (1e-7 of the charge, far
below any noise), so that it vectorises. Charge is a Gaussian number of the right mean and variance from `EXACT_BELOW`
expected electrons on, and an exact Poisson number below, in a second loop over the dim pixels.

References: splitmix64, Steele, Lea and Flood, OOPSLA 2014; inversion with a guide table, Chen and Asau, AIIE
Transactions 6, 1974; the chain of effects, EMVA Standard 1288, release 4.0, section 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from gonio.compiled import njit

EXACT_BELOW = 100.0
"""Expected electrons from which on the Gaussian stands for the Poisson distribution (its skewness there is 0.1)."""
BLOCK = 4096
"""Pixels that are worked on together."""

_f4, _i4 = np.float32, np.int32
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_U27, _U30, _U31, _U32, _U33, _U56 = (np.uint64(n) for n in (27, 30, 31, 32, 33, 56))
_LOW_32 = np.uint64(2**32 - 1)
_PER_32 = 2.0**-32
_EXACT = _f4(EXACT_BELOW)

# single-precision constants: a double would widen the loop
_ZERO, _HALF, _ONE, _TWO = _f4(0.0), _f4(0.5), _f4(1.0), _f4(2.0)
_LOG = tuple(_f4(1.0 / n) for n in (3, 5, 7, 9))
_SIN = tuple(_f4(c) for c in (-1 / 6, 1 / 120, -1 / 5040))
_COS = tuple(_f4(c) for c in (-1 / 2, 1 / 24, -1 / 720, 1 / 40320))
_LN2, _HALF_PI = _f4(math.log(2.0)), _f4(math.pi / 2)
_PER_31, _PER_30 = _f4(2.0**-31), _f4(2.0**-30)
_ROUND = _f4(1.5 * 2**23)  # adding it leaves the nearest integer in the low bits
_SQRT_HALF_BITS = _i4(np.float32(math.sqrt(0.5)).view(np.int32))
_ONE_BITS = _i4(np.float32(1.0).view(np.int32))
_MANTISSA = _i4(0x7FFFFF)

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _poisson_tables() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    """Cumulated Poisson distributions of whole means, and where to start looking for each 1/256 of probability."""
    k = np.arange(192)  # the last one is beyond 1 - 2^-33 for every mean below 100
    log_factorial = np.array([math.lgamma(n + 1.0) for n in k])
    means = np.arange(EXACT_BELOW)[:, None]
    cumulated = np.cumsum(np.exp(k * np.log(np.maximum(means, 1e-300)) - means - log_factorial), axis=1)
    cumulated[:, -1] = 1.0
    guide = np.array([np.searchsorted(row, np.arange(256) / 256.0) for row in cumulated])
    return cumulated, guide.astype(np.uint8)


_CUMULATED, _GUIDE = _poisson_tables()


def _jit(function: Kernel) -> Kernel:
    return cast(Kernel, njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})(function))


def _inline(function: Kernel) -> Kernel:
    return cast(
        Kernel, numba.njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"}, forceinline=True)(function)
    )


@_inline
def _mix(state: Any) -> Any:
    z = (state ^ (state >> _U30)) * _MIX_1
    z = (z ^ (z >> _U27)) * _MIX_2
    return z ^ (z >> _U31)


@_inline
def _log(x: Any) -> Any:
    """ln x of a single-precision number in (0, 1]."""
    bits = _i4(_f4(x).view(_i4) + _i4(_ONE_BITS - _SQRT_HALF_BITS))
    exponent = _f4(_i4(bits >> _i4(23)) - _i4(127))
    f = _i4((bits & _MANTISSA) + _SQRT_HALF_BITS).view(_f4) - _ONE
    s = f / (_TWO + f)
    z = s * s
    series = _ONE + z * (_LOG[0] + z * (_LOG[1] + z * (_LOG[2] + z * _LOG[3])))
    return _TWO * s * series + exponent * _LN2


@_inline
def _normals(bits: Any) -> Any:
    """Two independent standard normal numbers from 64 random bits: 31 for the radius, 32 for the angle."""
    u = (_f4(_i4(bits >> _U33)) + _HALF) * _PER_31
    radius = math.sqrt(max(-_TWO * _log(u), _ZERO))
    quarters = _f4(_i4(bits)) * _PER_30  # in [-2, 2)
    shifted = quarters + _ROUND
    quadrant = _f4(shifted).view(_i4)
    t = (quarters - (shifted - _ROUND)) * _HALF_PI
    w = t * t
    s = t * (_ONE + w * (_SIN[0] + w * (_SIN[1] + w * _SIN[2])))
    c = _ONE + w * (_COS[0] + w * (_COS[1] + w * (_COS[2] + w * _COS[3])))
    odd = (quadrant & _i4(1)) != _i4(0)
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if (quadrant & _i4(2)) != _i4(0) else sine
    cosine = -cosine if (_i4(quadrant + _i4(1)) & _i4(2)) != _i4(0) else cosine
    return radius * cosine, radius * sine


@_inline
def _poisson(bits: Any, mean: Any) -> Any:
    """An exact Poisson number of a mean in [0, `EXACT_BELOW`), from 64 random bits.

    The sum of two independent ones: of the mean's whole part, by inversion in a table of its distribution from a guide
    close below; and of the rest, by inversion term by term.
    """
    whole = np.int64(mean)
    u = (np.float64(bits >> _U32) + 0.5) * _PER_32
    k = np.int64(_GUIDE[whole, np.int64(bits >> _U56)])
    while u > _CUMULATED[whole, k]:
        k += 1
    rest = mean - whole
    v = (np.float64(bits & _LOW_32) + 0.5) * _PER_32
    term = math.exp(-rest)
    extra = 0
    while v > term and extra < 16:  # 1 - 2^-33 is reached before
        v -= term
        extra += 1
        term *= rest / extra
    return k + extra


@_jit
def normals(key: Any, first: int, last: int, scale: float, centre: float, out: Any) -> None:
    """Fill out[first:last] with centre + scale times the standard normal number of each index."""
    for i in range(first, last):
        z, _ = _normals(_mix(key + np.uint64(i) * _GOLDEN))
        out[i] = centre + scale * z


@_inline
def _level(charge: Any, per_electron: Any, black: Any, white: Any) -> Any:
    return np.uint16(_i4(min(max(charge * per_electron + black + _HALF, _ZERO), white)))


@_jit
def expose(
    rate: Any,
    gain: Any,
    offset: Any,
    out: Any,
    first: int,
    last: int,
    key: Any,
    exposure: Any,
    dark: Any,
    photon_noise: bool,
    read_noise: Any,
    full_well: Any,
    per_electron: Any,
    black: Any,
    white: Any,
) -> None:
    """Fill out[first:last] with the DN of one frame. Every real number is of single precision.

    Parameters
    ----------
    rate
        Expected electrons of each pixel in a unit of `exposure`.
    gain, offset
        Each pixel's relative responsivity, and its dark offset [e-].
    key
        64 bits that start the frame's random numbers.
    exposure
        Exposure time times the lamp's level [s].
    dark
        Expected electrons of the dark current.
    """
    # slices, and indices from zero, are what lets the compiler vectorise
    rate, gain, offset, out = rate[first:last], gain[first:last], offset[first:last], out[first:last]
    if not photon_noise and read_noise == _ZERO:
        for i in range(out.size):
            mean = exposure * rate[i] * gain[i] + dark
            out[i] = _level(min(mean, full_well) + offset[i], per_electron, black, white)
        return
    shot = _ONE if photon_noise else _ZERO
    beyond_charge = np.empty(BLOCK, _f4)
    for start in range(0, out.size, BLOCK):
        count = min(BLOCK, out.size - start)
        block_rate, block_gain, block_offset = rate[start:], gain[start:], offset[start:]
        block_out = out[start:]
        number = key + np.uint64(first + start) * _GOLDEN
        dim = _i4(0)
        for i in range(count):
            mean = exposure * block_rate[i] * block_gain[i] + dark
            z, z_read = _normals(_mix(number + np.uint64(i) * _GOLDEN))
            beyond_charge[i] = block_offset[i] + read_noise * z_read
            dim += _i4(mean < _EXACT)
            charge = min(mean + shot * math.sqrt(mean) * z, full_well) + beyond_charge[i]
            block_out[i] = _level(charge, per_electron, black, white)
        if dim == 0 or not photon_noise:
            continue
        for i in range(count):
            mean = exposure * block_rate[i] * block_gain[i] + dark
            if mean < _EXACT:
                bits = _mix(_mix(number + np.uint64(i) * _GOLDEN) + _GOLDEN)
                charge = min(_f4(_poisson(bits, np.float64(mean))), full_well) + beyond_charge[i]
                block_out[i] = _level(charge, per_electron, black, white)
