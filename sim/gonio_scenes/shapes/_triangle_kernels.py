"""Compiled loops over rays and triangles: float32 answers of Embree made float64, and the surface at a hit.

Embree names a triangle. Here the ray is met with it again, in float64; with its neighbours, where it was passed at an
edge; and with all triangles, where float32 was too coarse to tell (a few rays in a million, at silhouettes).
"""

import math
from typing import Any

from gonio_scenes.shapes._kernels import INF, compiled

EDGE = 1e-10
"""How far outside a triangle, in barycentric coordinates, a ray still meets it, so that no rounding opens an edge."""
STEP = 1e-6
"""Part of the mesh's size by which the next search begins beyond a hit that does not count: eight float32 roundings."""

DONE, AGAIN, UNCLEAR = 0, 1, 2


@compiled
def begin(
    origin: Any,
    direction: Any,
    nearest: float,
    center: Any,
    radius: float,
    since: Any,
    start: int,
    stop: int,
) -> None:
    """Where each ray's search begins: at `nearest`, or where it enters the sphere around the mesh; inf if it misses."""
    for i in range(start, stop):
        x, y, z = origin[i, 0] - center[0], origin[i, 1] - center[1], origin[i, 2] - center[2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        before = -(x * dx + y * dy + z * dz)
        x, y, z = x + before * dx, y + before * dy, z + before * dz
        inside = x * x + y * y + z * z <= radius * radius and before + radius > nearest
        since[i] = max(nearest, before - radius) if inside else INF


@compiled
def single(
    origin: Any,
    direction: Any,
    rays: Any,
    since: Any,
    center: Any,
    radius: float,
    origin_32: Any,
    direction_32: Any,
    start: int,
    stop: int,
) -> None:
    """The rays that are searched along, as Embree takes them: float32, from where the search begins, radius 1."""
    for j in range(start, stop):
        i = rays[j]
        for k in range(3):
            origin_32[j, k] = ((origin[i, k] - center[k]) + since[i] * direction[i, k]) / radius
            direction_32[j, k] = direction[i, k]


@compiled
def _sides(vertices: Any, faces: Any, k: int) -> Any:
    """A corner of a triangle, and the two sides from it to the others."""
    a, b, c = faces[k, 0], faces[k, 1], faces[k, 2]
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    return ax, ay, az, ux, uy, uz, vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az


@compiled
def _meet(origin: Any, direction: Any, i: int, vertices: Any, faces: Any, k: int) -> Any:
    """Distance to the plane of a triangle (inf along it), and how far the ray is inside: the least coordinate."""
    ax, ay, az, ux, uy, uz, vx, vy, vz = _sides(vertices, faces, k)
    dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    slope = nx * dx + ny * dy + nz * dz
    if slope == 0.0:
        return INF, -INF, 0.0, 0.0
    x, y, z = origin[i, 0] - ax, origin[i, 1] - ay, origin[i, 2] - az
    # to the ray's point nearest to the corner: a far origin costs no digits
    before = -(x * dx + y * dy + z * dz)
    x, y, z = x + before * dx, y + before * dy, z + before * dz
    t = -(nx * x + ny * y + nz * z) / slope
    # d x p: its products with the sides are the coordinates times the slope
    cx, cy, cz = dy * z - dz * y, dz * x - dx * z, dx * y - dy * x
    b1 = (cx * vx + cy * vy + cz * vz) / slope
    b2 = -(cx * ux + cy * uy + cz * uz) / slope
    return before + t, min(b1, b2, 1.0 - b1 - b2), b1, b2


@compiled
def _breadth(vertices: Any, faces: Any, k: int) -> float:
    """The least height of a triangle."""
    _, _, _, ux, uy, uz, vx, vy, vz = _sides(vertices, faces, k)
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    wx, wy, wz = ux - vx, uy - vy, uz - vz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    return math.sqrt((nx * nx + ny * ny + nz * nz) / longest)


@compiled
def _neighbours(
    origin: Any,
    direction: Any,
    i: int,
    nearest: float,
    vertices: Any,
    faces: Any,
    fan_start: Any,
    fan: Any,
    k: int,
) -> Any:
    """Where a ray meets a triangle around the corners of another: distance, which, and whether one before `nearest`."""
    best, part, behind = INF, 0, False
    for corner in range(3):
        v = faces[k, corner]
        for at in range(fan_start[v], fan_start[v + 1]):
            t, inside, _, _ = _meet(origin, direction, i, vertices, faces, fan[at])
            if inside >= -EDGE:
                if t <= nearest:
                    behind = True
                elif t < best:
                    best, part = t, fan[at]
    return best, part, behind


@compiled
def refine(
    origin: Any,
    direction: Any,
    nearest: float,
    rays: Any,
    found: Any,
    depth_32: Any,
    since: Any,
    vertices: Any,
    faces: Any,
    fan_start: Any,
    fan: Any,
    radius: float,
    distance: Any,
    primitive: Any,
    state: Any,
    start: int,
    stop: int,
) -> None:
    """What Embree found, in float64; where a hit does not count, `since` is moved beyond it.

    The triangles around the vertex v are fan[fan_start[v] : fan_start[v + 1]].
    """
    for j in range(start, stop):
        i = rays[j]
        k = found[j]
        distance[i] = INF
        primitive[i] = 0
        if k < 0:
            state[i] = DONE
            continue
        t, inside, _, _ = _meet(origin, direction, i, vertices, faces, k)
        if inside >= -EDGE and t > nearest:
            distance[i] = t
            primitive[i] = k
            state[i] = DONE
            continue
        behind = inside >= -EDGE
        passed = (depth_32[j] + STEP) * radius
        if behind and passed < 8.0 * STEP * radius and inside * _breadth(vertices, faces, k) > 2.0 * passed:
            since[i] += passed  # a ray that leaves the triangle it starts on, away from the neighbours
            state[i] = AGAIN
            continue
        best, part, met = _neighbours(origin, direction, i, nearest, vertices, faces, fan_start, fan, k)
        behind = behind or met
        if best < INF:
            distance[i] = best
            primitive[i] = part
            state[i] = DONE
        elif behind:
            since[i] += passed
            state[i] = AGAIN
        else:
            state[i] = UNCLEAR


@compiled
def all_of_them(
    origin: Any,
    direction: Any,
    nearest: float,
    rays: Any,
    vertices: Any,
    faces: Any,
    distance: Any,
    primitive: Any,
    start: int,
    stop: int,
) -> None:
    """Rays met with every triangle."""
    for j in range(start, stop):
        i = rays[j]
        best = INF
        part = 0
        for k in range(faces.shape[0]):
            t, inside, _, _ = _meet(origin, direction, i, vertices, faces, k)
            if inside >= -EDGE and nearest < t < best:
                best = t
                part = k
        distance[i] = best
        primitive[i] = part


@compiled
def _normalised(x: float, y: float, z: float) -> Any:
    f = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * f, y * f, z * f


@compiled
def _inside(b1: float, b2: float) -> Any:
    """The three barycentric coordinates of the nearest place on a triangle."""
    b1, b2 = min(max(b1, 0.0), 1.0), min(max(b2, 0.0), 1.0)
    over = max(b1 + b2, 1.0)
    b1, b2 = b1 / over, b2 / over
    return 1.0 - b1 - b2, b1, b2


@compiled
def _across(tx: float, ty: float, tz: float, nx: float, ny: float, nz: float) -> Any:
    """The part of t across the unit vector n, as a unit vector; any where there is none."""
    along = tx * nx + ty * ny + tz * nz
    wx, wy, wz = tx - along * nx, ty - along * ny, tz - along * nz
    if not wx * wx + wy * wy + wz * wz > 1e-12 * (tx * tx + ty * ty + tz * tz):
        wx, wy, wz = (0.0, nz, -ny) if abs(nx) < 0.5 else (nz, 0.0, -nx)
    return _normalised(wx, wy, wz)


@compiled
def describe(
    origin: Any,
    direction: Any,
    primitive: Any,
    vertices: Any,
    faces: Any,
    normals: Any,
    normal_faces: Any,
    coordinates: Any,
    coordinate_faces: Any,
    position: Any,
    normal: Any,
    shading: Any,
    tangent: Any,
    uv: Any,
    start: int,
    stop: int,
) -> None:
    """The surface at hits: positions lie on the triangle; `normals` and `coordinates` may have no rows."""
    smooth = normals.shape[0] > 0
    mapped = coordinates.shape[0] > 0
    for i in range(start, stop):
        k = primitive[i]
        _, _, b1, b2 = _meet(origin, direction, i, vertices, faces, k)
        b0, b1, b2 = _inside(b1, b2)
        ax, ay, az, ux, uy, uz, vx, vy, vz = _sides(vertices, faces, k)
        position[i, 0] = ax + b1 * ux + b2 * vx
        position[i, 1] = ay + b1 * uy + b2 * vy
        position[i, 2] = az + b1 * uz + b2 * vz
        nx, ny, nz = _normalised(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        if smooth:
            p, q, r = normal_faces[k, 0], normal_faces[k, 1], normal_faces[k, 2]
            nx, ny, nz = _normalised(
                b0 * normals[p, 0] + b1 * normals[q, 0] + b2 * normals[r, 0],
                b0 * normals[p, 1] + b1 * normals[q, 1] + b2 * normals[r, 1],
                b0 * normals[p, 2] + b1 * normals[q, 2] + b2 * normals[r, 2],
            )
            if not nx * nx + ny * ny + nz * nz < 2.0:  # normals that cancel each other
                nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        shading[i, 0], shading[i, 1], shading[i, 2] = nx, ny, nz
        tx, ty, tz = ux, uy, uz
        if mapped:
            p, q, r = coordinate_faces[k, 0], coordinate_faces[k, 1], coordinate_faces[k, 2]
            u = b0 * coordinates[p, 0] + b1 * coordinates[q, 0] + b2 * coordinates[r, 0]
            v = b0 * coordinates[p, 1] + b1 * coordinates[q, 1] + b2 * coordinates[r, 1]
            uv[i, 0] = u if 0.0 <= u <= 1.0 else u - math.floor(u)
            uv[i, 1] = v if 0.0 <= v <= 1.0 else v - math.floor(v)
            u1, v1 = coordinates[q, 0] - coordinates[p, 0], coordinates[q, 1] - coordinates[p, 1]
            u2, v2 = coordinates[r, 0] - coordinates[p, 0], coordinates[r, 1] - coordinates[p, 1]
            area = u1 * v2 - u2 * v1
            if area != 0.0:  # d position / d u
                s = 1.0 if area > 0.0 else -1.0
                tx, ty, tz = s * (v2 * ux - v1 * vx), s * (v2 * uy - v1 * vy), s * (v2 * uz - v1 * vz)
        else:
            uv[i, 0] = 0.0
            uv[i, 1] = 0.0
        tangent[i, 0], tangent[i, 1], tangent[i, 2] = _across(tx, ty, tz, nx, ny, nz)
