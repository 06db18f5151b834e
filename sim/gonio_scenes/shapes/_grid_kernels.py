"""Compiled loops over rays and the triangles of a height field: which one a ray meets, and the surface there.

A ray is followed from cell to cell of the grid, in the field's own frame; a triangle is met in the scene's.
"""

import math
from typing import Any

from gonio_scenes.shapes._kernels import INF, _between, _local, compiled

EDGE = 1e-10
"""How far outside a triangle, in barycentric coordinates, a ray still meets it, so that no rounding opens an edge."""
MARGIN = 1e-9
"""Part of the field's size by which its box is larger than its heights, for the roundings of the way to it."""


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
def _within(ray: Any, half: Any, middle: float, nearest: float) -> Any:
    """The stretch of a ray, from its point nearest to the field's origin, in the box around all heights."""
    x, y, z, dx, dy, dz, before = ray
    x0, x1 = _between(x, dx, half[0])
    y0, y1 = _between(y, dy, half[1])
    z0, z1 = _between(z - middle, dz, half[2])
    return max(x0, y0, z0, nearest - before), min(x1, y1, z1)


@compiled
def _axis(place: float, speed: float, length: float, count: int) -> Any:
    """Along rows or columns: the cell that a ray begins in, which way it goes, how long to the next and through one."""
    cell = min(max(math.floor(place), 0), count - 2)
    if abs(speed) * length < MARGIN:  # along the cells, but for rounding: at a rim it would lead out of them
        return cell, 0, INF, INF
    step = 1 if speed > 0.0 else -1
    return cell, step, (cell + (1 if step > 0 else 0) - place) / speed, 1.0 / abs(speed)


@compiled
def _in_cell(rays: Any, i: int, nearest: float, vertices: Any, faces: Any, first: int) -> Any:
    """The nearer of the two triangles of a cell that a ray meets: its distance, inf for none, and its number."""
    best, part = INF, 0
    for k in range(first, first + 2):
        t, inside, _, _ = _meet(rays[0], rays[1], i, vertices, faces, k)
        if inside >= -EDGE and nearest < t < best:
            best, part = t, k
    return best, part


@compiled
def meet(
    rays: Any,
    place: Any,
    size: Any,
    heights: Any,
    half: Any,
    middle: float,
    nearest: float,
    vertices: Any,
    faces: Any,
    hits: Any,
    start: int,
    stop: int,
) -> None:
    """Where rays first meet the field; cells whose heights a ray passes above or below are not looked at."""
    rows, columns = heights.shape
    for i in range(start, stop):
        hits[0][i] = INF
        hits[1][i] = 0
        ray = _local(rays, place, i)
        x, y, z, dx, dy, dz, _ = ray
        t, end = _within(ray, half, middle, nearest)
        if not t <= end:
            continue
        across, down = (columns - 1) / size[0], -(rows - 1) / size[1]
        at = (x + t * dx) * across + 0.5 * (columns - 1), (y + t * dy) * down + 0.5 * (rows - 1)
        column, right, next_column, wide = _axis(at[0], dx * across, end - t, columns)
        row, below, next_row, high = _axis(at[1], dy * down, end - t, rows)
        next_column, next_row = next_column + t, next_row + t
        while 0 <= column < columns - 1 and 0 <= row < rows - 1:
            leaves = min(next_column, next_row, end)
            a, b = z + t * dz, z + leaves * dz
            p, q = heights[row, column], heights[row, column + 1]
            r, s = heights[row + 1, column], heights[row + 1, column + 1]
            slack = MARGIN * half[0]
            if max(a, b) >= min(p, q, r, s) - slack and min(a, b) <= max(p, q, r, s) + slack:
                first = 2 * (row * (columns - 1) + column)
                hits[0][i], hits[1][i] = _in_cell(rays, i, nearest, vertices, faces, first)
                if hits[0][i] < INF:
                    break
            if leaves >= end:
                break
            t = leaves
            if next_column <= next_row:
                column, next_column = column + right, next_column + wide
            else:
                row, next_row = row + below, next_row + high


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
    rays: Any,
    primitive: Any,
    vertices: Any,
    faces: Any,
    normals: Any,
    coordinates: Any,
    out: Any,
    start: int,
    stop: int,
) -> None:
    """The surface at hits: positions lie on the triangle; `normals` may have no rows."""
    position, normal, shading, tangent, uv = out
    smooth = normals.shape[0] > 0
    for i in range(start, stop):
        k = primitive[i]
        _, _, b1, b2 = _meet(rays[0], rays[1], i, vertices, faces, k)
        b0, b1, b2 = _inside(b1, b2)
        ax, ay, az, ux, uy, uz, vx, vy, vz = _sides(vertices, faces, k)
        position[i, 0] = ax + b1 * ux + b2 * vx
        position[i, 1] = ay + b1 * uy + b2 * vy
        position[i, 2] = az + b1 * uz + b2 * vz
        nx, ny, nz = _normalised(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        p, q, r = faces[k, 0], faces[k, 1], faces[k, 2]
        if smooth:
            nx, ny, nz = _normalised(
                b0 * normals[p, 0] + b1 * normals[q, 0] + b2 * normals[r, 0],
                b0 * normals[p, 1] + b1 * normals[q, 1] + b2 * normals[r, 1],
                b0 * normals[p, 2] + b1 * normals[q, 2] + b2 * normals[r, 2],
            )
        shading[i, 0], shading[i, 1], shading[i, 2] = nx, ny, nz
        uv[i, 0] = b0 * coordinates[p, 0] + b1 * coordinates[q, 0] + b2 * coordinates[r, 0]
        uv[i, 1] = b0 * coordinates[p, 1] + b1 * coordinates[q, 1] + b2 * coordinates[r, 1]
        v1, v2 = coordinates[q, 1] - coordinates[p, 1], coordinates[r, 1] - coordinates[p, 1]
        # d position / d u: the triangles lie in the order of u and v
        tx, ty, tz = v2 * ux - v1 * vx, v2 * uy - v1 * vy, v2 * uz - v1 * vz
        tangent[i, 0], tangent[i, 1], tangent[i, 2] = _across(tx, ty, tz, nx, ny, nz)
