"""Compiled loops of the renderer: rays of a camera, surfaces turned toward them, directions in a surface's frame.

Each reads and writes every number once. Rays are shared by threads as the shapes' own loops share them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.models.engine import in_parts
from gonio.typing import Floats
from gonio_scenes.shapes.shape import SPLIT, Ints, Surface

FAST = {"contract", "nsz"}


@njit(error_model="numpy", nogil=True, fastmath=FAST)
def _toward_plane(x: Any, y: Any, right: Any, down: Any, forward: Any, out: Any, start: int, stop: int) -> None:
    for i in range(start, stop):
        a = forward[0] + x[i] * right[0] + y[i] * down[0]
        b = forward[1] + x[i] * right[1] + y[i] * down[1]
        c = forward[2] + x[i] * right[2] + y[i] * down[2]
        f = 1.0 / math.sqrt(a * a + b * b + c * c)
        out[i, 0], out[i, 1], out[i, 2] = a * f, b * f, c * f


def toward_plane(x: Floats, y: Floats, right: Floats, down: Floats, forward: Floats) -> Floats:
    """Unit directions (n, 3) from a hole to points (x, y) of the picture at distance 1 before it."""
    out = np.empty((x.size, 3))
    in_parts(lambda start, stop: _toward_plane(x, y, right, down, forward, out, start, stop), x.size, SPLIT)
    return out


@njit(error_model="numpy", nogil=True, fastmath=FAST)
def _settle(
    here: Any,
    direction: Any,
    met_position: Any,
    met_normal: Any,
    met_shading: Any,
    met_tangent: Any,
    met_uv: Any,
    position: Any,
    normal: Any,
    facing: Any,
    tangent: Any,
    uv: Any,
    start: int,
    stop: int,
) -> None:
    for j in range(start, stop):
        i = here[j]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        x, y, z = met_normal[j, 0], met_normal[j, 1], met_normal[j, 2]
        position[i, 0], position[i, 1], position[i, 2] = met_position[j, 0], met_position[j, 1], met_position[j, 2]
        normal[i, 0], normal[i, 1], normal[i, 2] = x, y, z
        uv[i, 0], uv[i, 1] = met_uv[j, 0], met_uv[j, 1]
        behind = x * dx + y * dy + z * dz > 0.0
        sx, sy, sz = met_shading[j, 0], met_shading[j, 1], met_shading[j, 2]
        # where a smoothed normal looks away from the viewer, the facet's own is taken
        if (sx * dx + sy * dy + sz * dz > 0.0) == behind:
            x, y, z = sx, sy, sz
        if behind:
            x, y, z = -x, -y, -z
        facing[i, 0], facing[i, 1], facing[i, 2] = x, y, z
        a, b, c = met_tangent[j, 0], met_tangent[j, 1], met_tangent[j, 2]
        along = a * x + b * y + c * z
        a, b, c = a - along * x, b - along * y, c - along * z
        f = 1.0 / math.sqrt(a * a + b * b + c * c)
        tangent[i, 0], tangent[i, 1], tangent[i, 2] = a * f, b * f, c * f


def settle(
    here: Ints,
    direction: Floats,
    met: Surface,
    position: Floats,
    normal: Floats,
    facing: Floats,
    tangent: Floats,
    uv: Floats,
) -> None:
    """Write the surfaces that the rays `here` met into arrays of all rays, turned toward where the rays came from."""
    in_parts(
        lambda start, stop: _settle(
            here,
            direction,
            met.position,
            met.normal,
            met.shading,
            met.tangent,
            met.uv,
            position,
            normal,
            facing,
            tangent,
            uv,
            start,
            stop,
        ),
        here.size,
        SPLIT,
    )


@njit(error_model="numpy", nogil=True, fastmath=FAST)
def _local(direction: Any, step: int, sign: float, facing: Any, tangent: Any, out: Any, start: int, stop: int) -> None:
    for i in range(start, stop):
        dx, dy, dz = sign * direction[i * step, 0], sign * direction[i * step, 1], sign * direction[i * step, 2]
        x, y, z = facing[i, 0], facing[i, 1], facing[i, 2]
        a, b, c = tangent[i, 0], tangent[i, 1], tangent[i, 2]
        out[i, 0] = dx * a + dy * b + dz * c
        out[i, 1] = dx * (y * c - z * b) + dy * (z * a - x * c) + dz * (x * b - y * a)
        out[i, 2] = dx * x + dy * y + dz * z


def local(direction: Floats, facing: Floats, tangent: Floats, sign: float = 1.0) -> Floats:
    """Directions (n, 3), or one (3,), times `sign`, in the surface's frame: x its tangent, z its normal `facing`."""
    step = 0 if direction.ndim == 1 else 1
    rows = np.ascontiguousarray(direction).reshape(-1, 3)
    out = np.empty(facing.shape)
    in_parts(lambda start, stop: _local(rows, step, sign, facing, tangent, out, start, stop), len(out), SPLIT)
    return out
