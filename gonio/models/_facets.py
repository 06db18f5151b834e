"""What the models of mirror facets share: half-vector geometry, V-groove attenuation and Fresnel reflectance.

Every factor is a fraction whose parts are sums of positive terms, so nothing cancels and a model divides once.
L and V are unit vectors, s = L + V, H = s/|s|, and cos(theta_h) = V.H = |s|/2.
"""

from math import sqrt

from gonio.models._compile import device
from gonio.models._math import _LOG2_E, atan_over, exp2, log

# Sizes of constants for which all products of facet models stay within float32: rms slopes from 1e-5 to 12 among them.
SINGLE_RANGE = (1e-2, 1e10)
# Below this |L + V|^2 the directions are opposite to the last digit: forward grazing, where H is taken as the normal.
OPPOSITE = 1e-30


@device
def above(z):  # type: ignore[no-untyped-def]
    """The cosine of a direction, at least 1e-200: at exactly grazing this gives the limit along equal polar angles."""
    return max(z, 1e-200)


@device
def facet(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """(|s_xy|^2, s_z, |s|^2, g, N.L, N.V) of s = L + V; G/((N.L)(N.V)) is s_z/g, finite at grazing off the mirror."""
    sx = lx + vx
    sy = ly + vy
    lz = above(lz)
    vz = above(vz)
    sz = lz + vz
    sxy2 = sx * sx + sy * sy
    s2 = sxy2 + sz * sz
    apart = s2 >= OPPOSITE
    sxy2 = sxy2 if apart else 0.0
    sz = sz if apart else sqrt(OPPOSITE)
    # Cook1982 G = min(1, 2 N.H N.V/V.H, 2 N.H N.L/V.H), where 2 N.H/V.H = 4 s_z/|s|^2
    g = max(lz, vz) * max(sz * min(lz, vz), 0.25 * s2 if apart else 0.0)
    return sxy2, sz, s2 if apart else OPPOSITE, g, lz, vz


@device
def tan2_alpha(sxy2, sz):  # type: ignore[no-untyped-def]
    """tan^2 of the angle between H and the normal, at most 1e150."""
    tan2 = sxy2 / (sz * sz)
    return tan2 if tan2 < 1e150 else 1e150


@device
def alpha_squared(sxy2, sz, s2):  # type: ignore[no-untyped-def]
    """The square of the angle between H and the normal [rad^2], from its half-angle tangent."""
    length = sqrt(s2) + sz
    tan2_half = sxy2 / (length * length)
    ratio = atan_over(tan2_half)  # (alpha/2)/tan(alpha/2)
    return 4.0 * tan2_half * ratio * ratio


@device
def log_cos2(sxy2, sz, s2):  # type: ignore[no-untyped-def]
    """ln of cos^2 = 1 - sin^2 of the angle between H and the normal, accurate near 0; at least -1e300."""
    sin2 = sxy2 / s2
    near = sin2 < 0.5
    cos2 = 1.0 - sin2 if near else sz * sz / s2
    lost = ((1.0 - cos2) - sin2) / cos2 if near else 0.0  # what rounding took from 1 - sin^2
    value = log(cos2) + lost
    return value if cos2 > 0.0 else -1e300


@device
def cos_power(log_square, exponent):  # type: ignore[no-untyped-def]
    """cos^exponent from the logarithm of cos^2."""
    return exp2(0.5 * _LOG2_E * exponent * log_square)


# --- what the directions give a distribution, for all parameter sets: its variable, then |s|^2, s_z and g ---


@device
def by_tan2(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    sxy2, sz, s2, g, _, _ = facet(lx, ly, lz, vx, vy, vz)
    return tan2_alpha(sxy2, sz), s2, sz, g


@device
def by_angle(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    sxy2, sz, s2, g, _, _ = facet(lx, ly, lz, vx, vy, vz)
    return alpha_squared(sxy2, sz, s2), s2, sz, g


@device
def by_log_cos(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    sxy2, sz, s2, g, _, _ = facet(lx, ly, lz, vx, vy, vz)
    return log_cos2(sxy2, sz, s2), s2, sz, g


@device
def by_sxy2(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    sxy2, sz, s2, g, _, _ = facet(lx, ly, lz, vx, vy, vz)
    return sxy2, s2, sz, g


@device
def by_cosines(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """|s_xy|^2, |s|^2, N.L and N.V."""
    sxy2, _, s2, _, lz, vz = facet(lx, ly, lz, vx, vy, vz)
    return sxy2, s2, lz, vz


@device
def groove_over_viewer(lz, vz, sz, s2):  # type: ignore[no-untyped-def]
    """Numerator and denominator of Blinn's G/(N.E), by his branches: no division by a cosine that G takes out."""
    masked = vz < lz  # Ga = 1, Gb = 2 N.H N.E/(E.H) where masked, Gc = 2 N.H N.L/(E.H) where shadowed
    four_sz = 4.0 * sz  # 2 N.H/(E.H) = 4 s_z/|s|^2
    blocked = four_sz * (vz if masked else lz) < s2 and s2 > OPPOSITE
    up = (four_sz if masked else four_sz * lz) if blocked else 1.0
    down = (s2 if masked else s2 * vz) if blocked else (vz if vz > 1e-300 else 0.0)
    return up, down


@device
def fresnel(c2, contrast, real, imag):  # type: ignore[no-untyped-def]
    """Numerator and denominator of the unpolarised Fresnel reflectance at cos^2(theta) = c2, exact for complex index.

    With q = a + ib = sqrt(n~^2 - sin^2), Q = |q|^2: R_s = |n~^2 - 1|^2 / |c + q|^4 and R_p = R_s |c q - sin^2|^2 / |c
    q + sin^2|^2, whose mean is R_s X/(X + Y) with X = c^2 Q + sin^4 and Y = 2 c a sin^2. `contrast` is |n~^2 - 1|^2,
    `real` n^2 - k^2 - 1, `imag` n k.
    """
    re_q2 = real + c2
    abs_q2 = sqrt(re_q2 * re_q2 + 4.0 * imag * imag)  # Q
    twice_cm2 = c2 * (abs_q2 + abs(re_q2))  # 2 (c m)^2 with m = max(a, b)
    cm2 = 0.5 * twice_cm2 + 1e-100  # above 0, because it divides
    cm = sqrt(cm2)
    # 2 c a is 2 c m, or 2 c^2 n k/(c m) where b is the larger
    two_ca_cm = twice_cm2 if re_q2 >= 0.0 else 2.0 * imag * c2  # 2 c a times c m
    sin2 = 1.0 - c2
    x_cm = cm * (c2 * abs_q2 + sin2 * sin2)  # X times c m
    c_q2_cm = cm * (c2 + abs_q2) + two_ca_cm  # |c + q|^2 times c m
    return contrast * (cm2 * x_cm), (x_cm + two_ca_cm * sin2) * (c_q2_cm * c_q2_cm)


@device
def fresnel_real(c2, contrast, real, imag):  # type: ignore[no-untyped-def]
    """`fresnel` of a real index, with one root less."""
    re_q2 = real + c2
    abs_q2 = abs(re_q2)
    cm2 = c2 * abs_q2 + 1e-100
    cm = sqrt(cm2)
    sin2 = 1.0 - c2
    x_cm = cm * (c2 * abs_q2 + sin2 * sin2)
    two_ca_cm = 2.0 * (c2 * abs_q2) if re_q2 >= 0.0 else 0.0
    c_q2_cm = cm * (c2 + abs_q2) + two_ca_cm
    return contrast * (cm2 * x_cm), (x_cm + two_ca_cm * sin2) * (c_q2_cm * c_q2_cm)


@device
def index_constants(n, k):  # type: ignore[no-untyped-def]
    """What `fresnel` needs of an index n + ik: |n~^2 - 1|^2, n^2 - k^2 - 1 and n k."""
    contrast = ((n - 1.0) * (n - 1.0) + k * k) * ((n + 1.0) * (n + 1.0) + k * k)
    return contrast, (n - 1.0) * (n + 1.0) - k * k, n * k


def fresnel_constants(ior: complex) -> tuple[float, float, float]:
    """`index_constants` of a complex number."""
    contrast, real, imag = index_constants(ior.real, ior.imag)
    return contrast, real, imag
