"""The compiled sensor: from expected electrons to DN, with a counter-based random generator.

The random bits of a pixel are a hash of the frame's key and the pixel's number (splitmix64), so a frame is the same
whatever the order of its pixels and the number of threads. One hash gives two normal numbers (Box and Muller), which
reach 6.6 standard deviations. Charge is a Poisson number in both of two loops over a block of pixels. From
`FEW_ELECTRONS` expected electrons on a normal number is turned into it, by the expansion of the inverse distribution;
below, it is drawn from a table. Neither loop has a branch, and both work in single precision (1e-7 of the charge, far
below any noise), so that they vectorise.

References: splitmix64, Steele, Lea and Flood (2014); the expansion, Giles (2016); the table, Walker
(1977); the chain of effects, EMVA Standard 1288, release 4.0, section 2.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

from gonio.compiled import njit
from gonio.typing import NDArray

FEW_ELECTRONS = 25.0
"""Expected electrons below which a table is drawn from. From here on the expansion's distribution is the Poisson one
but for 2e-5 of the probability, and less at larger means."""
BLOCK = 512
"""Pixels that are worked on together: few, so that most blocks are bright or dim throughout."""
COUNTS = 64
"""Of electrons in the table: a number of a mean below `FEW_ELECTRONS` is larger once in 2e10 draws."""
PER_ELECTRON = 8
"""Means in the table for each expected electron; what a pixel's mean has beyond its row is drawn by `_rest`."""

_f4, _i4 = np.float32, np.int32
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_U27, _U30, _U31, _U32 = (np.uint64(n) for n in (27, 30, 31, 32))
_LOW_26, _LOW_31 = _i4(2**26 - 1), _i4(2**31 - 1)
_FEW = _f4(FEW_ELECTRONS)
_ROWS = _f4(PER_ELECTRON)
_LAST_ROW = _f4(FEW_ELECTRONS * PER_ELECTRON - 1)

# single-precision constants: a double would widen the loop
_ZERO, _HALF, _ONE, _TWO = _f4(0.0), _f4(0.5), _f4(1.0), _f4(2.0)
_LOG = tuple(_f4(1.0 / n) for n in (3, 5, 7, 9))
_SIN = tuple(_f4(c) for c in (-1 / 6, 1 / 120, -1 / 5040))
_COS = tuple(_f4(c) for c in (-1 / 2, 1 / 24, -1 / 720, 1 / 40320))
_LN2, _HALF_PI = _f4(math.log(2.0)), _f4(math.pi / 2)
_PER_31, _PER_30, _PER_26 = _f4(2.0**-31), _f4(2.0**-30), _f4(2.0**-26)
_THIRD, _QUARTER, _FIFTH = _f4(1 / 3), _f4(1 / 4), _f4(1 / 5)
_SKEW = _f4(1 / 6), _f4(-1 / 36), _f4(-1 / 72), _f4(-8 / 405), _f4(7 / 810), _f4(1 / 270)
_EXP = tuple(_f4((-1) ** n / math.factorial(n)) for n in range(6))
_ROUND = _f4(1.5 * 2**23)  # adding it leaves the nearest integer in the low bits
_SQRT_HALF_BITS = _i4(np.float32(math.sqrt(0.5)).view(np.int32))
_ONE_BITS = _i4(np.float32(1.0).view(np.int32))
_MANTISSA = _i4(0x7FFFFF)

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def _alias_table() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Walker's tables of Poisson distributions: of a uniform column, how likely it stays, and where it goes if not.

    Each of shape (means, COUNTS); row n is for the mean n / PER_ELECTRON. Column `COUNTS` - 1 holds all counts from it
    on. Every column has the probability 1/COUNTS; too likely counts fill up the columns of the others.
    """
    means = np.arange(FEW_ELECTRONS * PER_ELECTRON) / PER_ELECTRON
    k = np.arange(COUNTS)
    log_factorial = np.array([math.lgamma(n + 1.0) for n in k])
    likely = np.exp(k * np.log(np.maximum(means, 1e-300))[:, None] - means[:, None] - log_factorial)
    likely[:, -1] += np.maximum(1.0 - likely.sum(axis=1), 0.0)
    stays, other = np.ones(likely.shape), np.tile(k, (means.size, 1))
    for row, fill in enumerate(likely * (COUNTS / likely.sum(axis=1))[:, None]):
        small, large = ([n for n in k if (fill[n] < 1.0) == less] for less in (True, False))
        while small and large:
            n, giver = small.pop(), large[-1]
            stays[row, n], other[row, n] = fill[n], giver
            fill[giver] -= 1.0 - fill[n]
            if fill[giver] < 1.0:
                small.append(large.pop())
    return stays.astype(np.float32), other.astype(np.int32)


_STAYS, _OTHER = (table.reshape(-1) for table in _alias_table())


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
def _normals(high: Any, low: Any) -> Any:
    """Two independent standard normal numbers from two times 32 random bits: 31 for the radius, 32 for the angle."""
    u = (_f4(_i4(high & _LOW_31)) + _HALF) * _PER_31
    radius = math.sqrt(max(-_TWO * _log(u), _ZERO))
    quarters = _f4(low) * _PER_30  # in [-2, 2)
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
def _poisson_of_normal(z: Any, mean: Any) -> Any:
    """The Poisson number of a mean from `FEW_ELECTRONS` on at the probability where a standard normal number is z.

    Giles' expansion of the inverse distribution about the normal one, with the terms up to 1/mean.
    """
    root = math.sqrt(mean)
    per_root = _ONE / root
    w = z * z
    second = z * (_SKEW[1] + w * _SKEW[2])
    third = _SKEW[3] + w * (_SKEW[4] + w * _SKEW[5])
    # floor: the truncation of a number that is not negative here (z > -6.6, the mean at least 25)
    return np.floor(mean + (root * z + (_THIRD + w * _SKEW[0] + per_root * (second + per_root * third))))


@_inline
def _rest(low: Any, mean: Any) -> Any:
    """A Poisson number of a mean below 1 / `PER_ELECTRON`, from 31 random bits: how many of its tails hold them.

    The tails are summed from their far ends, so that the smallest keep their digits; P(6) is below 5e-9.
    """
    u = (_f4(_i4(low & _LOW_31)) + _HALF) * _PER_31
    zero = _ONE + mean * (-_ONE + mean * (_EXP[2] + mean * (_EXP[3] + mean * (_EXP[4] + mean * _EXP[5]))))
    first = zero * mean
    second = first * mean * _HALF
    third = second * mean * _THIRD
    fourth = third * mean * _QUARTER
    fifth = fourth * mean * _FIFTH
    beyond_3 = fourth + fifth
    beyond_2 = third + beyond_3
    beyond_1 = second + beyond_2
    count = (_ONE if u < first + beyond_1 else _ZERO) + (_ONE if u < beyond_1 else _ZERO)
    count += (_ONE if u < beyond_2 else _ZERO) + (_ONE if u < beyond_3 else _ZERO)
    return count + (_ONE if u < fifth else _ZERO)


@_inline
def _poisson_of_table(high: Any, low: Any, mean: Any) -> Any:
    """A Poisson number of a mean in [0, `FEW_ELECTRONS`), from two times 32 random bits: of a row, and of the rest."""
    row = min(np.floor(mean * _ROWS), _LAST_ROW)
    column = _i4(_i4(high >> _i4(26)) & _i4(COUNTS - 1))
    place = _i4(_i4(_i4(row) * _i4(COUNTS)) + column)
    stays = _f4(_i4(high & _LOW_26)) * _PER_26 < _STAYS[place]
    count = _f4(column) if stays else _f4(_OTHER[place])
    return count + _rest(low, mean - row / _ROWS)


@_jit
def normals(key: Any, first: int, last: int, scale: float, centre: float, out: Any) -> None:
    """Fill out[first:last] with centre + scale times the standard normal number of each index."""
    for i in range(first, last):
        bits = _mix(key + np.uint64(i) * _GOLDEN)
        z, _ = _normals(_i4(bits >> _U32), _i4(bits))
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
    mean, normal, noise = np.empty(BLOCK, _f4), np.empty(BLOCK, _f4), np.empty(BLOCK, _f4)
    # 64 and 32 bits in loops of their own: a loop's vectors are as short as its longest numbers make them
    hashes, high, low = np.empty(BLOCK, np.uint64), np.empty(BLOCK, _i4), np.empty(BLOCK, _i4)
    for start in range(0, out.size, BLOCK):
        count = min(BLOCK, out.size - start)
        block_rate, block_gain, block_offset = rate[start:], gain[start:], offset[start:]
        block_out = out[start:]
        number = key + np.uint64(first + start) * _GOLDEN
        for i in range(count):
            hashes[i] = _mix(number + np.uint64(i) * _GOLDEN)
            high[i], low[i] = _i4(hashes[i] >> _U32), _i4(hashes[i])
        dim = _i4(0)
        for i in range(count):
            mean[i] = exposure * block_rate[i] * block_gain[i] + dark
            dim += _i4(mean[i] < _FEW)
            normal[i], z_read = _normals(high[i], low[i])
            noise[i] = block_offset[i] + read_noise * z_read
        if dim < count or not photon_noise:
            for i in range(count):
                electrons = _poisson_of_normal(normal[i], mean[i]) if photon_noise else mean[i]
                block_out[i] = _level(min(electrons, full_well) + noise[i], per_electron, black, white)
        if dim == 0 or not photon_noise:
            continue
        for i in range(count):
            more = _mix(hashes[i] + _GOLDEN)
            high[i], low[i] = _i4(more >> _U32), _i4(more)
        for i in range(count):
            electrons = _poisson_of_table(high[i], low[i], min(mean[i], _FEW))
            level = _level(min(electrons, full_well) + noise[i], per_electron, black, white)
            block_out[i] = level if mean[i] < _FEW else block_out[i]
