"""Elementary functions that a loop can vectorise: no branch, no call, about one unit in the last place.

numba's pip build has no vector mathematics library, so one call of `math.exp` keeps a whole loop scalar. These are
argument reductions in two or three exact parts (Cody and Waite) followed by polynomials, with exponents built from
integer bits. Coefficients: sine, cosine and logarithm from FreeBSD's msun; exponential and arc tangent are Chebyshev
interpolants computed to 60 digits. `tests/gonio/models/test_closed_hard.py` holds each against mpmath.
"""

import math

import numpy as np

from gonio.models._compile import device, instead_of

HALF_PI = math.pi / 2
GRAZING = 1e-150
"""The cosine that stands for that of an exactly grazing direction: the limit along equal polar angles."""
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding it leaves the nearest integer in the low bits
_ROUND_BITS = 4843621399236968448  # the same number's bits
_LOG2_E = 1.4426950408889634
_LN2_HIGH = 0.6931471803691238  # 32 bits, so that k * _LN2_HIGH is exact
_LN2_LOW = 1.9082149292705877e-10
_TWO_OVER_PI = 0.6366197723675814
_PI2_A = 1.5707963267341256  # pi/2 in three parts, 33 bits + 33 bits + the rest: exact products up to |x| = 1e6
_PI2_B = 6.077100506303966e-11
_PI2_C = 2.0222662487959506e-21
_HALF_PI_REST = 6.123233995736766e-17  # pi/2 less the double nearest to it
_ONE_BITS = 4607182418800017408
_SQRT_HALF_BITS = 4604544271217802189  # the bits of sqrt(1/2)
_PER_ROOT_BITS = 6910469410427058089  # less half the bits of x: those of about 1/sqrt(x) (Robertson 2012)
_MANTISSA = 4503599627370495
_TWO_52_BITS = 4841369599423283200  # the bits of 2**52
_TWO_52 = 4503599627370496.0


@device
def _exp2_parts(r, shifted):  # type: ignore[no-untyped-def]
    """2^(r + k) for |r| <= 1/2 and the integer k in the low bits of `shifted`, while it is a normal number."""
    r2 = r * r
    r4 = r2 * r2
    low = (1.0 + r * 0.6931471805599453) + r2 * (0.24022650695910158 + r * 0.055504108664821625)
    mid = (0.009618129107587256 + r * 0.001333355814640647) + r2 * (0.00015403530463724353 + r * 1.5252733841556773e-05)
    top = (1.3215432535912375e-06 + r * 1.0178057087733941e-07) + r2 * (
        7.074194297288521e-09 + r * 4.4558179083360645e-10
    )
    value = low + r4 * (mid + r4 * top)
    return np.int64(np.float64(value).view(np.int64) + (np.float64(shifted).view(np.int64) << 52)).view(np.float64)


@device
def exp2(x):  # type: ignore[no-untyped-def]
    """2^x for x < 1023; 0 below -1021."""
    shifted = x + _ROUND
    value = _exp2_parts(x - (shifted - _ROUND), shifted)
    return value if x > -1021.0 else 0.0


@device
def exp(x):  # type: ignore[no-untyped-def]
    """e^x; 0 below x = -708 (3e-308), infinite above 709.78."""
    shifted = x * _LOG2_E + _ROUND
    k = shifted - _ROUND
    value = _exp2_parts(((x - k * _LN2_HIGH) - k * _LN2_LOW) * _LOG2_E, shifted)
    value = value if x > -708.0 else 0.0
    return value if x < 709.782712893384 else math.inf


@device
def log(x):  # type: ignore[no-untyped-def]
    """ln x for normal positive x; -infinity at 0."""
    bits = np.float64(x).view(np.int64) + (_ONE_BITS - _SQRT_HALF_BITS)
    exponent = np.int64((bits >> 52) + _TWO_52_BITS).view(np.float64) - (_TWO_52 + 1023.0)
    f = np.int64((bits & _MANTISSA) + _SQRT_HALF_BITS).view(np.float64) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (0.3999999999940942 + w * (0.22222198432149784 + w * 0.15313837699209373))
    odd = z * (0.6666666666666735 + w * (0.2857142874366239 + w * (0.1818357216161805 + w * 0.14798198605116586)))
    half = 0.5 * f * f
    value = exponent * _LN2_HIGH - ((half - (s * (half + (odd + even)) + exponent * _LN2_LOW)) - f)
    return value if x > 0.0 else -math.inf


@device
def per_root(x):  # type: ignore[no-untyped-def]
    """1/sqrt(x) for normal positive x: no root, no division, which take most of a loop's time."""
    y = np.int64(_PER_ROOT_BITS - (np.float64(x).view(np.int64) >> 1)).view(np.float64)  # within 3.5 %
    e = 1.0 - x * (y * y)
    y += y * e * (0.5 + e * (0.375 + e * 0.3125))  # Taylor's of (1 - e)^(-1/2): within 8e-6
    e = 1.0 - x * (y * y)
    return y + y * e * (0.5 + e * (0.375 + e * 0.3125))


@device
def _sin_poly(r, z):  # type: ignore[no-untyped-def]
    """sin r for |r| <= pi/4, z = r^2."""
    low = -1.66666666666666324348e-01 + z * 8.33333333332248946124e-03
    mid = -1.98412698298579493134e-04 + z * 2.75573137070700676789e-06
    top = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    w = z * z
    return r + r * z * (low + w * (mid + w * top))


@device
def _cos_poly(z):  # type: ignore[no-untyped-def]
    """cos r for |r| <= pi/4, z = r^2."""
    low = 4.16666666666666019037e-02 + z * -1.38888888888741095749e-03
    mid = 2.48015872894767294178e-05 + z * -2.75573143513906633035e-07
    top = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11
    w = z * z
    half = 0.5 * z
    one = 1.0 - half
    return one + (((1.0 - one) - half) + w * (low + w * (mid + w * top)))


@device
def sincos(x):  # type: ignore[no-untyped-def]
    """(sin x, cos x) for |x| <= 1e6."""
    shifted = x * _TWO_OVER_PI + _ROUND
    k = shifted - _ROUND
    quadrant = np.float64(shifted).view(np.int64)
    r = ((x - k * _PI2_A) - k * _PI2_B) - k * _PI2_C
    z = r * r
    s = _sin_poly(r, z)
    c = _cos_poly(z)
    odd = (quadrant & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if (quadrant & 2) != 0 else sine
    cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return sine, cosine


@device
def sincos_polar(theta):  # type: ignore[no-untyped-def]
    """(sin, cos) of a polar angle in [0, pi/2]; the double nearest pi/2 is taken as exactly grazing, cos = 0."""
    steep = theta > 0.25 * math.pi
    r = (HALF_PI - theta) + _HALF_PI_REST if steep else theta
    z = r * r
    s = _sin_poly(r, z)
    c = _cos_poly(z)
    cosine = s if theta < HALF_PI else 0.0
    return c if steep else s, cosine if steep else c


@device
def atan_over(z):  # type: ignore[no-untyped-def]
    """arctan(r) / r as a function of z = r^2 in [0, 1]."""
    y = 2.0 * z - 1.0
    y2 = y * y
    y4 = y2 * y2
    y8 = y4 * y4
    p0 = (0.8704197513671031 - y * 0.10187654235021827) + y2 * (0.020851851207108144 - y * 0.005030863660244241)
    p1 = (0.0013155859496274019 - y * 0.00036098208718017745) + y2 * (
        0.00010227656116493796 - y * 2.965003947163037e-05
    )
    p2 = (8.744938258275806e-06 - y * 2.614079513157223e-06) + y2 * (7.898664992314531e-07 - y * 2.4077722324530413e-07)
    p3 = (7.393952233672895e-08 - y * 2.285234288746683e-08) + y2 * (7.099509212434809e-09 - y * 2.208281491755967e-09)
    p4 = (6.919944020431581e-10 - y * 2.2610231886790481e-10) + y2 * (
        7.137783789145907e-11 - y * 1.6649704524279563e-11
    )
    p5 = (5.2660952321692814e-12 - y * 4.048723308331434e-12) + y2 * 1.293081691790813e-12
    return (p0 + y4 * p1) + y8 * ((p2 + y4 * p3) + y8 * (p4 + y4 * p5))


@device
def atan_over_near(z):  # type: ignore[no-untyped-def]
    """arctan(r) / r as a function of z = r^2 for r up to tan(pi/8)."""
    z2 = z * z
    z4 = z2 * z2
    low = (1.0 - z * 0.3333333333332844) + z2 * (0.1999999999885511 - z * 0.14285714180976467)
    mid = (0.11111106180455946 - z * 0.09090773074808413) + z2 * (0.07689953496306849 - z * 0.06640233930429329)
    top = (0.056883492268085936 - z * 0.04348052215715258) + z2 * 0.0211353731576785
    return low + z4 * (mid + z4 * top)


@device
def cubic(t, a, b, c, d):  # type: ignore[no-untyped-def]
    """Lagrange's cubic through the values a, b, c and d at 0, 1, 2 and 3."""
    # each value is multiplied before the division: weights made first move the last digits of fitted spikes
    t1, t2, t3 = t - 1.0, t - 2.0, t - 3.0
    return -t1 * t2 * t3 * a / 6.0 + t * t2 * t3 * b / 2.0 - t * t1 * t3 * c / 2.0 + t * t1 * t2 * d / 6.0


# --- where a kernel's arithmetic is float32 ---

_ROUND_SINGLE = 12582912.0  # 1.5 * 2**23: adding it leaves the nearest integer in the low bits
_ONE_BITS_SINGLE = 1065353216
_SQRT_HALF_BITS_SINGLE = 1060439283  # the bits of sqrt(1/2)
_MANTISSA_SINGLE = 8388607


@instead_of(exp2)
def exp2_single(x):  # type: ignore[no-untyped-def]
    """2^x for x < 127; 0 below -125."""
    shifted = x + _ROUND_SINGLE
    r = x - (shifted - _ROUND_SINGLE)
    r2 = r * r
    low = (1.0 + r * 0.6931471805599453) + r2 * (0.24022650695910072 + r * 0.05550410866482158)
    top = (0.009618129107628477 + r * 0.0013333558146428443) + r2 * (0.0001540353039338161 + r * 1.525273380405984e-05)
    value = low + (r2 * r2) * top  # Taylor's, within 3e-9
    bits = np.int32(np.float32(value).view(np.int32) + np.int32(np.float32(shifted).view(np.int32) << 23))
    return bits.view(np.float32) if x > -125.0 else 0.0


@instead_of(log)
def log_single(x):  # type: ignore[no-untyped-def]
    """ln x for normal positive x; a bound below every logarithm at 0. Coefficients: FreeBSD's msun."""
    bits = np.int32(np.float32(x).view(np.int32) + np.int32(_ONE_BITS_SINGLE - _SQRT_HALF_BITS_SINGLE))
    exponent = np.float32(np.int32((bits >> 23) - 127))
    f = np.int32((bits & _MANTISSA_SINGLE) + _SQRT_HALF_BITS_SINGLE).view(np.float32) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = z * (0.66666662693 + w * 0.28498786688)
    even = w * (0.40000972152 + w * 0.24279078841)
    half = 0.5 * f * f
    value = exponent * 0.6931471805599453 - ((half - s * (half + (odd + even))) - f)
    return value if x > 0.0 else -1e300
