"""Compiled loops over rays: where they meet each analytic shape, and what its surface is there.

A loop takes rays (origins, directions) and a shape's place (its centre, its axes in rows), and fills `hits`
(distances, primitives) or `out` (positions, normals, shading normals, tangents, uv). Each turns a ray into the
shape's own frame and counts the distance from where the ray comes nearest to the shape's origin, so that a far camera
costs no digits: only the sum at the end is large. A convex solid is the stretch that a ray spends inside all of its
bounds, so that no rounding opens a gap at an edge.
"""

import math
from typing import Any

import numpy as np

from gonio.compiled import njit

# No term may be moved between operations, and infinities must live: they are the bounds of rays along a side.
FAST = {"contract", "nsz"}
INF = math.inf
TWO_PI = 2.0 * math.pi
compiled = njit(error_model="numpy", nogil=True, fastmath=FAST)
UP, ALONG = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


@compiled
def _local(rays: Any, place: Any, i: int) -> Any:
    """The ray in the shape's frame, from its point nearest to the shape's origin; the distance up to that point."""
    (origin, direction), (center, axes) = rays, place
    ox, oy, oz = origin[i, 0] - center[0], origin[i, 1] - center[1], origin[i, 2] - center[2]
    dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
    before = -(ox * dx + oy * dy + oz * dz)
    ox, oy, oz = ox + before * dx, oy + before * dy, oz + before * dz
    return (
        axes[0, 0] * ox + axes[0, 1] * oy + axes[0, 2] * oz,
        axes[1, 0] * ox + axes[1, 1] * oy + axes[1, 2] * oz,
        axes[2, 0] * ox + axes[2, 1] * oy + axes[2, 2] * oz,
        axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz,
        axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz,
        axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz,
        before,
    )


@compiled
def _hit_point(rays: Any, place: Any, hits: Any, i: int) -> Any:
    """Where a ray has met the shape, in the shape's frame."""
    x, y, z, dx, dy, dz, before = _local(rays, place, i)
    t = hits[0][i] - before
    return x + t * dx, y + t * dy, z + t * dz


@compiled
def _out(axes: Any, x: float, y: float, z: float, out: Any, i: int) -> None:
    """A direction in the shape's frame as one of the scene."""
    out[i, 0] = axes[0, 0] * x + axes[1, 0] * y + axes[2, 0] * z
    out[i, 1] = axes[0, 1] * x + axes[1, 1] * y + axes[2, 1] * z
    out[i, 2] = axes[0, 2] * x + axes[1, 2] * y + axes[2, 2] * z


@compiled
def _put(place: Any, out: Any, i: int, point: Any, normal: Any, shading: Any, tangent: Any, uv: Any) -> None:
    """A point of the surface and its directions, in the shape's frame, as the scene's; and its place on a texture."""
    center, axes = place
    _out(axes, point[0], point[1], point[2], out[0], i)
    for k in range(3):
        out[0][i, k] += center[k]
    _out(axes, normal[0], normal[1], normal[2], out[1], i)
    _out(axes, shading[0], shading[1], shading[2], out[2], i)
    _out(axes, tangent[0], tangent[1], tangent[2], out[3], i)
    out[4][i, 0], out[4][i, 1] = uv


@compiled
def _clipped(u: float) -> float:
    return min(max(u, 0.0), 1.0)


@compiled
def _turn(x: float, y: float) -> float:
    """The azimuth of (x, y) in turns, in [0, 1)."""
    u = math.atan2(y, x) / TWO_PI
    if u < 0.0:
        u += 1.0
    return u if u < 1.0 else 0.0


@compiled
def _roots(a: float, b: float, c: float) -> Any:
    """Both roots, in order, of a t^2 + 2 b t + c; without cancellation. (inf, -inf) where there is none.

    A root that lies at infinity, as where a is 0, is infinite.
    """
    square = b * b - a * c
    if not square >= 0.0:
        return INF, -INF
    q = -(b + math.copysign(math.sqrt(square), b))
    if q == 0.0:  # b and a c are 0
        return (0.0, 0.0) if a != 0.0 else (INF, -INF)
    one, other = q / a, c / q
    return (one, other) if one < other else (other, one)


@compiled
def _between(position: float, speed: float, half: float) -> Any:
    """The stretch within +-half along one axis; (inf, -inf) for none."""
    if speed == 0.0:
        return (-INF, INF) if abs(position) <= half else (INF, -INF)
    one, other = (-half - position) / speed, (half - position) / speed
    return (one, other) if one < other else (other, one)


@compiled
def patch_hit(rays: Any, place: Any, half: Any, tile: Any, nearest: float, hits: Any, start: int, stop: int) -> None:
    """A rectangle of the half-widths `half`, which may be infinite."""
    for i in range(start, stop):
        x, y, z, dx, dy, dz, before = _local(rays, place, i)
        t = -z / dz
        # not |...| <= half alone: a plane without an end is met at any finite t
        on = abs(x + t * dx) <= half[0] and abs(y + t * dy) <= half[1] and abs(t) < INF and before + t > nearest
        hits[0][i] = before + t if on else INF
        hits[1][i] = 0


@compiled
def patch_surface(rays: Any, place: Any, half: Any, tile: Any, hits: Any, out: Any, start: int, stop: int) -> None:
    """A rectangle, tiled from its middle; uv = (1/2, 1/2) there."""
    for i in range(start, stop):
        x, y, _ = _hit_point(rays, place, hits, i)
        u, v = x / tile[0] + 0.5, y / tile[1] + 0.5
        # a patch that is one tile ends at 1; where tiles repeat each begins at 0
        u = _clipped(u) if 2.0 * half[0] <= tile[0] else u - math.floor(u)
        v = _clipped(v) if 2.0 * half[1] <= tile[1] else v - math.floor(v)
        _put(place, out, i, (x, y, 0.0), UP, UP, ALONG, (u, v))


@compiled
def disc_hit(rays: Any, place: Any, radius: float, nearest: float, hits: Any, start: int, stop: int) -> None:
    """A disc."""
    for i in range(start, stop):
        x, y, z, dx, dy, dz, before = _local(rays, place, i)
        t = -z / dz
        x, y = x + t * dx, y + t * dy
        hits[0][i] = before + t if x * x + y * y <= radius * radius and before + t > nearest else INF
        hits[1][i] = 0


@compiled
def disc_surface(rays: Any, place: Any, radius: float, hits: Any, out: Any, start: int, stop: int) -> None:
    """A disc; uv spans the square around it."""
    for i in range(start, stop):
        x, y, _ = _hit_point(rays, place, hits, i)
        uv = _clipped(0.5 * x / radius + 0.5), _clipped(0.5 * y / radius + 0.5)
        _put(place, out, i, (x, y, 0.0), UP, UP, ALONG, uv)


@compiled
def sphere_hit(rays: Any, place: Any, radius: float, nearest: float, hits: Any, start: int, stop: int) -> None:
    """A sphere."""
    (origin, direction), (center, _) = rays, place
    for i in range(start, stop):
        x, y, z = origin[i, 0] - center[0], origin[i, 1] - center[1], origin[i, 2] - center[2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        before = -(x * dx + y * dy + z * dz)
        x, y, z = x + before * dx, y + before * dy, z + before * dz
        a = dx * dx + dy * dy + dz * dz
        # b is what rounding left of 0; the product keeps the digits of radius - |x| near the limb
        b = x * dx + y * dy + z * dz
        off = math.sqrt(x * x + y * y + z * z)
        one, other = _roots(a, b, (off - radius) * (off + radius))
        one, other = before + one, before + other
        hits[0][i] = one if one > nearest else other if other > nearest else INF
        hits[1][i] = 0


@compiled
def sphere_surface(rays: Any, place: Any, radius: float, hits: Any, out: Any, start: int, stop: int) -> None:
    """A sphere: u the azimuth, v from the lower pole to the upper one by the angle at the centre."""
    for i in range(start, stop):
        x, y, z = _hit_point(rays, place, hits, i)
        f = 1.0 / math.sqrt(x * x + y * y + z * z)
        x, y, z = x * f, y * f, z * f
        off = math.sqrt(x * x + y * y)
        tangent = (-y / off, x / off, 0.0) if off > 0.0 else (0.0, 1.0, 0.0)
        uv = _turn(x, y), _clipped(math.atan2(off, -z) / math.pi)
        _put(place, out, i, (radius * x, radius * y, radius * z), (x, y, z), (x, y, z), tangent, uv)


@compiled
def cylinder_hit(
    rays: Any, place: Any, radius: float, half: float, caps: bool, nearest: float, hits: Any, start: int, stop: int
) -> None:
    """A cylinder about z, up to +-half; primitive 0 is its side, 1 its upper and 2 its lower cap."""
    for i in range(start, stop):
        x, y, z, dx, dy, dz, before = _local(rays, place, i)
        a = dx * dx + dy * dy
        off = math.sqrt(x * x + y * y)
        c = (off - radius) * (off + radius)
        if a > 0.0:
            one, other = _roots(a, x * dx + y * dy, c)
        else:
            one, other = (-INF, INF) if c <= 0.0 else (INF, -INF)
        t = INF
        part = 0
        if caps:
            low, high = _between(z, dz, half)
            enter, leave = max(one, low), min(other, high)
            if enter <= leave:
                if before + enter > nearest:
                    t = enter
                    part = 0 if one >= low else 1 if dz < 0.0 else 2
                elif before + leave > nearest:
                    t = leave
                    part = 0 if other <= high else 1 if dz > 0.0 else 2
        elif before + one > nearest and abs(z + one * dz) <= half:
            t = one
        elif before + other > nearest and abs(z + other * dz) <= half:
            t = other
        hits[0][i] = before + t if abs(t) < INF else INF
        hits[1][i] = part


@compiled
def cylinder_surface(
    rays: Any, place: Any, radius: float, half: float, caps: bool, hits: Any, out: Any, start: int, stop: int
) -> None:
    """A cylinder: around its side u is the azimuth and v the height; on a cap uv spans the square around it."""
    for i in range(start, stop):
        x, y, z = _hit_point(rays, place, hits, i)
        if hits[1][i] == 0:
            f = 1.0 / math.sqrt(x * x + y * y)
            x, y = x * f, y * f
            z = min(max(z, -half), half)
            normal, uv = (x, y, 0.0), (_turn(x, y), 0.5 * z / half + 0.5)
            _put(place, out, i, (radius * x, radius * y, z), normal, normal, (-y, x, 0.0), uv)
        else:
            side = 1.0 if hits[1][i] == 1 else -1.0
            cap = (0.0, 0.0, side)
            uv = _clipped(0.5 * x / radius + 0.5), _clipped(0.5 * side * y / radius + 0.5)
            _put(place, out, i, (x, y, side * half), cap, cap, ALONG, uv)


@compiled
def box_hit(rays: Any, place: Any, half: Any, nearest: float, hits: Any, start: int, stop: int) -> None:
    """A box; primitives 0 to 5 are its sides at +x, -x, +y, -y, +z, -z."""
    for i in range(start, stop):
        x, y, z, dx, dy, dz, before = _local(rays, place, i)
        x_low, x_high = _between(x, dx, half[0])
        y_low, y_high = _between(y, dy, half[1])
        z_low, z_high = _between(z, dz, half[2])
        enter, leave = max(x_low, y_low, z_low), min(x_high, y_high, z_high)
        t = INF
        side = 0
        if enter <= leave:
            if before + enter > nearest:
                t = enter
                if enter == x_low:
                    side = 1 if dx > 0.0 else 0
                elif enter == y_low:
                    side = 3 if dy > 0.0 else 2
                else:
                    side = 5 if dz > 0.0 else 4
            elif before + leave > nearest:
                t = leave
                if leave == x_high:
                    side = 0 if dx > 0.0 else 1
                elif leave == y_high:
                    side = 2 if dy > 0.0 else 3
                else:
                    side = 4 if dz > 0.0 else 5
        hits[0][i] = before + t
        hits[1][i] = side


@compiled
def box_surface(rays: Any, place: Any, half: Any, hits: Any, out: Any, start: int, stop: int) -> None:
    """A box: each side has its own uv, and v runs along z on the four upright ones."""
    for i in range(start, stop):
        x, y, z = _hit_point(rays, place, hits, i)
        x, y, z = min(max(x, -half[0]), half[0]), min(max(y, -half[1]), half[1]), min(max(z, -half[2]), half[2])
        side = 1.0 if hits[1][i] % 2 == 0 else -1.0
        along = hits[1][i] // 2
        if along == 0:
            x = side * half[0]
            normal, tangent = (side, 0.0, 0.0), (0.0, side, 0.0)
            u, v = side * y / half[1], z / half[2]
        elif along == 1:
            y = side * half[1]
            normal, tangent = (0.0, side, 0.0), (-side, 0.0, 0.0)
            u, v = -side * x / half[0], z / half[2]
        else:
            z = side * half[2]
            normal, tangent = (0.0, 0.0, side), ALONG
            u, v = x / half[0], side * y / half[1]
        _put(place, out, i, (x, y, z), normal, normal, tangent, (0.5 * u + 0.5, 0.5 * v + 0.5))


# --- surfaces of revolution ---------------------------------------------------------------------------------------
#
# The frustum k lies between the points k and k + 1 of the profile (r, z). With (er, ez) the unit vector from one to
# the other, the cone through it is G = ez (rho - r0) - er (z - z0) = 0, rho the distance from the axis. Squared it is a
# quadratic in the distance; G itself knows which half of the double cone is meant, and polishes the root.

LEAF = 4
"""Frusta that are tried one by one; more are bounded by a hollow cylinder."""
FLAT = 1e-6
"""Slope below which the square of a cone loses too many digits: its rays are solved for from the plane nearby."""
POLISHED = 0.005
"""Part of the distance from a cone at which a ray has met it: roots nearer than this are left as they are."""


@compiled
def _frustum(
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
    point: Any,
    frustum: Any,
    tolerance: float,
    before: float,
    nearest: float,
) -> float:
    """The first distance that with `before` is beyond `nearest` at which a ray meets a frustum; inf for none."""
    (r0, z0), (er, ez, length) = (point[0], point[1]), (frustum[0], frustum[1], frustum[2])
    if abs(ez) < FLAT:
        if dz == 0.0:
            return INF
        one = other = (z0 - z) / dz
    else:
        m = ez * r0 + er * (z - z0)
        a = ez * ez * (dx * dx + dy * dy) - er * er * dz * dz
        b = ez * ez * (x * dx + y * dy) - m * er * dz
        off = ez * math.sqrt(x * x + y * y)
        c = (off - m) * (off + m)
        if a == 0.0 and b == 0.0:
            return INF  # along the surface, or along the axis of a cylinder
        one, other = _roots(a, b, c)
    best = INF
    for k in range(2):
        t = one if k == 0 else other
        if not abs(t) < INF:
            continue
        good = False
        for step in range(4):
            u, v, w = x + t * dx, y + t * dy, z + t * dz
            rho = math.sqrt(u * u + v * v)
            off = ez * (rho - r0) - er * (w - z0)
            good = abs(off) <= tolerance
            if abs(off) <= POLISHED * tolerance or step == 3:
                break
            t -= off / ((ez * (u * dx + v * dy) / rho if rho > 0.0 else 0.0) - er * dz)
        along = er * (rho - r0) + ez * (w - z0)
        if good and -tolerance <= along <= length + tolerance and before + t > nearest and t < best:
            best = t
    return best


@compiled
def _enters(
    z: float, dz: float, a: float, b: float, c: float, waist: float, bound: Any, above: float, best: float
) -> bool:
    """Whether a ray comes between `above` and `best` through the hollow cylinder of a node.

    (a t + 2 b) t + c is its distance from the axis, squared, and `waist` where that is least.
    """
    r_low, r_high, z_low, z_high = bound[0], bound[1], bound[2], bound[3]
    if dz == 0.0:
        if not z_low <= z <= z_high:
            return False
        low, high = _roots(a, b, c - r_high * r_high) if a > 0.0 else (INF, -INF)
    else:
        low, high = (z_low - z) / dz, (z_high - z) / dz
        if low > high:
            low, high = high, low
    if high <= above or low >= best or not low <= high:
        return False
    t = min(max(waist, low), high)
    if (a * t + 2.0 * b) * t + c > r_high * r_high:
        return False
    return bool(max((a * low + 2.0 * b) * low, (a * high + 2.0 * b) * high) + c >= r_low * r_low)


@compiled
def revolution_hit(
    rays: Any,
    place: Any,
    points: Any,
    frusta: Any,
    slopes: Any,
    nodes: Any,
    bounds: Any,
    tolerance: float,
    nearest: float,
    hits: Any,
    start: int,
    stop: int,
) -> None:
    """A surface of revolution; its primitives are its frusta.

    `points` (m + 1, 2) is the profile; `frusta` (m, 4) has er, ez, length and the arc length before each; `nodes` and
    `bounds` are the tree: first and last frustum and the first of two children (0 for none); r and z from and to.
    """
    waiting = np.empty(64, np.int64)
    for i in range(start, stop):
        x, y, z, dx, dy, dz, before = _local(rays, place, i)
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y
        waist = -b / a if a > 0.0 else 0.0
        above = nearest - before
        best = INF
        part = 0
        waiting[0] = 0
        count = 1
        while count > 0:
            count -= 1
            node = waiting[count]
            if not _enters(z, dz, a, b, c, waist, bounds[node], above, best):
                continue
            child = nodes[node, 2]
            if child > 0:
                waiting[count] = child
                waiting[count + 1] = child + 1
                count += 2
                continue
            for k in range(nodes[node, 0], nodes[node, 1]):
                t = _frustum(x, y, z, dx, dy, dz, points[k], frusta[k], tolerance, before, nearest)
                if t < best:
                    best = t
                    part = k
        hits[0][i] = before + best
        hits[1][i] = part


@compiled
def revolution_surface(
    rays: Any,
    place: Any,
    points: Any,
    frusta: Any,
    slopes: Any,
    nodes: Any,
    bounds: Any,
    tolerance: float,
    hits: Any,
    out: Any,
    start: int,
    stop: int,
) -> None:
    """A surface of revolution: u is the azimuth, v the share of the profile's length up to the hit.

    `slopes` (m, 2, 3) are the coefficients of dr and dz along each frustum as quadratics of the share of its length; of
    a surface that is not smooth there are none.
    """
    last = frusta.shape[0] - 1
    total = frusta[last, 3] + frusta[last, 2]
    for i in range(start, stop):
        x, y, z = _hit_point(rays, place, hits, i)
        k = hits[1][i]
        er, ez, length = frusta[k, 0], frusta[k, 1], frusta[k, 2]
        rho = math.sqrt(x * x + y * y)
        if rho > 0.0:
            x, y = x / rho, y / rho
        else:
            x, y = 1.0, 0.0
        along = min(max(er * (rho - points[k, 0]) + ez * (z - points[k, 1]), 0.0), length)
        rho, z = points[k, 0] + along * er, points[k, 1] + along * ez
        s = along / length
        dr, dh = er, ez
        if slopes.shape[0] > 0:
            dr = (slopes[k, 0, 0] * s + slopes[k, 0, 1]) * s + slopes[k, 0, 2]
            dh = (slopes[k, 1, 0] * s + slopes[k, 1, 1]) * s + slopes[k, 1, 2]
            f = 1.0 / math.sqrt(dr * dr + dh * dh)
            dr, dh = dr * f, dh * f
        uv = _turn(x, y), _clipped((frusta[k, 3] + along) / total)
        normal, shading = (ez * x, ez * y, -er), (dh * x, dh * y, -dr)
        _put(place, out, i, (rho * x, rho * y, z), normal, shading, (-y, x, 0.0), uv)
