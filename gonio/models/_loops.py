"""The loops over a compiled kernel, each written once: `_compile.loop` puts a model's kernel in at the name `kernel`.

A kernel maps the components of two unit vectors and a tuple of constants to a BRDF. The loops run over vectors, over
angles, and over columns of numbers made of the directions before. They check arguments in the pass that evaluates
them, and return 1 where one is wrong, else 0. Every loop that turns arguments into vectors does it by `unit_vectors`
or by `vectors_of_angles` and its like; a kernel that needs several passes over a block (`_htsg_kernels`) brings loops
of its own.
"""

from typing import Final

from gonio.models._compile import device, template, with_others
from gonio.models._math import HALF_PI, sincos, sincos_polar

NORM_TOLERANCE: Final = 1e-6  # how far from 1 the length of a direction may be: what float32 vectors need, and no more
BLOCK: Final = 8192  # pairs handled at a time: one constant argument is repeated that often, and stays in the cache
PHI_LIMIT: Final = 1e6  # rad; beyond it an azimuth has fewer than ten digits left


# --- from arguments to vectors ------------------------------------------------------------------------------------


@device
def off_unit(x, y, z):  # type: ignore[no-untyped-def]
    """1 where a vector's length is beyond `NORM_TOLERANCE` from 1, and for NaN; else 0."""
    return 0 if abs(x * x + y * y + (z * z - 1.0)) <= 2.0 * NORM_TOLERANCE else 1


@device
def unit_vectors(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Two vectors brought to unit length, and 1 where one is `off_unit`, else 0."""
    ea = ax * ax + ay * ay + (az * az - 1.0)
    eb = bx * bx + by * by + (bz * bz - 1.0)
    wrong = off_unit(ax, ay, az) | off_unit(bx, by, bz)
    fa = 1.0 - ea * (0.5 - 0.375 * ea)  # 1/sqrt(1 + e): the next term is below 3e-18
    fb = 1.0 - eb * (0.5 - 0.375 * eb)
    return ax * fa, ay * fa, az * fa, bx * fb, by * fb, bz * fb, wrong


@device
def off_range(theta_i, phi_i, theta_r, phi_r):  # type: ignore[no-untyped-def]
    """1 where a polar angle is outside [0, pi/2] or an azimuth beyond `PHI_LIMIT`, and for NaN; else 0."""
    polar = 0.0 <= theta_i <= HALF_PI and 0.0 <= theta_r <= HALF_PI
    return 0 if polar and abs(phi_i) <= PHI_LIMIT and abs(phi_r) <= PHI_LIMIT else 1


@device
def vectors_of_angles(theta_i, phi_i, theta_r, phi_r):  # type: ignore[no-untyped-def]
    """Two unit vectors in the frame of the source's azimuth, and what `off_range` says."""
    sin_i, cos_i = sincos_polar(theta_i)
    sin_r, cos_r = sincos_polar(theta_r)
    sin_d, cos_d = sincos(phi_r - phi_i)
    wrong = off_range(theta_i, phi_i, theta_r, phi_r)
    return sin_i, 0.0, cos_i, sin_r * cos_d, sin_r * sin_d, cos_r, wrong


@device
def vectors_of_absolute_angles(theta_i, phi_i, theta_r, phi_r):  # type: ignore[no-untyped-def]
    """Two unit vectors in the sample's frame, and what `off_range` says."""
    sin_i, cos_i = sincos_polar(theta_i)
    sin_r, cos_r = sincos_polar(theta_r)
    sin_p, cos_p = sincos(phi_i)
    sin_q, cos_q = sincos(phi_r)
    wrong = off_range(theta_i, phi_i, theta_r, phi_r)
    return sin_i * cos_p, sin_i * sin_p, cos_i, sin_r * cos_q, sin_r * sin_q, cos_r, wrong


@device
def part(flat, first, count, step):  # type: ignore[no-untyped-def]
    """The numbers of a block of pairs: of an argument with a number a pair (`step` 1), or of a constant one (0)."""
    return flat[first * step : first * step + count]


@device
def vector_part(flat, first, count, step):  # type: ignore[no-untyped-def]
    """The same of vectors, three numbers after three."""
    return flat[3 * first * step : 3 * (first * step + count)]


# --- the loops ----------------------------------------------------------------------------------------------------


@template("r1 i r1 i p w1 i i")
def over_vectors(omega_i, step_i, omega_r, step_r, constants, out, start, stop):  # type: ignore[no-untyped-def]
    wrong = 0
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        l, v = vector_part(omega_i, first, count, step_i), vector_part(omega_r, first, count, step_r)  # noqa: E741
        o = out[first : first + count]
        for j in range(count):
            # flat arrays: with two axes the row length would be unknown when compiling, and the loop stay scalar
            az, bz = l[3 * j + 2], v[3 * j + 2]
            lx, ly, lz, vx, vy, vz, off = unit_vectors(l[3 * j], l[3 * j + 1], az, v[3 * j], v[3 * j + 1], bz)
            wrong |= off
            value = kernel(lx, ly, lz, vx, vy, vz, constants)  # type: ignore[name-defined]  # noqa: F821
            o[j] = value if (az if az < bz else bz) >= 0.0 else 0.0
    return wrong


@template("r1 i r1 i r1 i r1 i p w1 i i")
def over_angles(theta_i, step_ti, phi_i, step_pi, theta_r, step_tr, phi_r, step_pr, constants, out, start, stop):  # type: ignore[no-untyped-def]
    wrong = 0
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        ti, pi_ = part(theta_i, first, count, step_ti), part(phi_i, first, count, step_pi)
        tr, pr = part(theta_r, first, count, step_tr), part(phi_r, first, count, step_pr)
        o = out[first : first + count]
        for j in range(count):
            lx, ly, lz, vx, vy, vz, off = vectors_of_angles(ti[j], pi_[j], tr[j], pr[j])
            wrong |= off
            o[j] = kernel(lx, ly, lz, vx, vy, vz, constants)  # type: ignore[name-defined]  # noqa: F821
    return wrong


over_absolute_angles = with_others(over_angles, "over_absolute_angles", {vectors_of_angles: vectors_of_absolute_angles})


@template("r1 i i")
def over_lengths(vectors, start, stop):  # type: ignore[no-untyped-def]
    wrong = 0
    v = vector_part(vectors, start, stop - start, 1)
    for j in range(stop - start):
        wrong |= kernel(v[3 * j], v[3 * j + 1], v[3 * j + 2])  # type: ignore[name-defined]  # noqa: F821
    return wrong


@template("r1 r1 w1")
def columns_2(omega_i, omega_r, out):  # type: ignore[no-untyped-def]
    """What the kernel needs of each pair of directions, column after column."""
    n = out.size // 2
    a, b = out[:n], out[n:]
    for j in range(n):
        k = 3 * j
        a[j], b[j] = kernel(omega_i[k], omega_i[k + 1], omega_i[k + 2], omega_r[k], omega_r[k + 1], omega_r[k + 2])  # type: ignore[name-defined]  # noqa: F821
    return 0


@template("r1 r1 w1")
def columns_3(omega_i, omega_r, out):  # type: ignore[no-untyped-def]
    n = out.size // 3
    a, b, c = out[:n], out[n : 2 * n], out[2 * n :]
    for j in range(n):
        k = 3 * j
        a[j], b[j], c[j] = kernel(  # type: ignore[name-defined]  # noqa: F821
            omega_i[k], omega_i[k + 1], omega_i[k + 2], omega_r[k], omega_r[k + 1], omega_r[k + 2]
        )
    return 0


@template("r1 r1 w1")
def columns_4(omega_i, omega_r, out):  # type: ignore[no-untyped-def]
    n = out.size // 4
    a, b, c, d = out[:n], out[n : 2 * n], out[2 * n : 3 * n], out[3 * n :]
    for j in range(n):
        k = 3 * j
        a[j], b[j], c[j], d[j] = kernel(  # type: ignore[name-defined]  # noqa: F821
            omega_i[k], omega_i[k + 1], omega_i[k + 2], omega_r[k], omega_r[k + 1], omega_r[k + 2]
        )
    return 0


@template("r1 i r1 i r1 i r1 i i w1")
def over_angle_columns(theta_i, step_ti, phi_i, step_pi, theta_r, step_tr, phi_r, step_pr, count, out):  # type: ignore[no-untyped-def]
    """The same of angles that are in range."""
    pairs = out.size // count
    for j in range(pairs):
        lx, ly, lz, vx, vy, vz, _ = vectors_of_angles(
            theta_i[j * step_ti], phi_i[j * step_pi], theta_r[j * step_tr], phi_r[j * step_pr]
        )
        numbers = kernel(lx, ly, lz, vx, vy, vz)  # type: ignore[name-defined]  # noqa: F821
        for k in range(count):
            out[k * pairs + j] = numbers[k]
    return 0


over_absolute_angle_columns = with_others(
    over_angle_columns, "over_absolute_angle_columns", {vectors_of_angles: vectors_of_absolute_angles}
)


@template("r1 p w1 i i", columns=True)
def at_2(columns, constants, out, start, stop):  # type: ignore[no-untyped-def]
    n = out.size
    a, b, o = columns[start:stop], columns[n + start : n + stop], out[start:stop]
    for j in range(stop - start):
        o[j] = kernel(a[j], b[j], constants)  # type: ignore[name-defined]  # noqa: F821
    return 0


@template("r1 p w1 i i", columns=True)
def at_3(columns, constants, out, start, stop):  # type: ignore[no-untyped-def]
    n = out.size
    a, b = columns[start:stop], columns[n + start : n + stop]
    c, o = columns[2 * n + start : 2 * n + stop], out[start:stop]
    for j in range(stop - start):
        o[j] = kernel(a[j], b[j], c[j], constants)  # type: ignore[name-defined]  # noqa: F821
    return 0


@template("r1 p w1 i i", columns=True)
def at_4(columns, constants, out, start, stop):  # type: ignore[no-untyped-def]
    n = out.size
    a, b, c = columns[start:stop], columns[n + start : n + stop], columns[2 * n + start : 2 * n + stop]
    d, o = columns[3 * n + start : 3 * n + stop], out[start:stop]
    for j in range(stop - start):
        o[j] = kernel(a[j], b[j], c[j], d[j], constants)  # type: ignore[name-defined]  # noqa: F821
    return 0


COLUMNS: Final = {2: columns_2, 3: columns_3, 4: columns_4}
AT: Final = {2: at_2, 3: at_3, 4: at_4}
"""By number of columns: the loops that make them, and those over a kernel that takes them."""
