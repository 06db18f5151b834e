"""Spherical caps: their cubature, what the horizon leaves of them, and the overlap of two, compiled.

Directions are unit vectors, a cap is its axis and its half-angle. The disc rules live on the equal-area map of a cap
(radius^2 proportional to 1 - cos rho), on which a uniform solid angle is a uniform area.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import functools
import math

import numpy as np

from gonio.models._compile import device, loop, template
from gonio.models._hemisphere import gauss
from gonio.models._math import cubic, sincos
from gonio.typing import Floats

RINGS = (1, 2, 3, 5, 8, 12)
LEVELS = len(RINGS)


@functools.cache
def disc_rule(level: int) -> tuple[Floats, Floats, Floats]:
    """(radius^2, azimuth, weight) of a rule on the unit disc, weights summing to 1.

    Level 0 is the centre and a hexagon; the others are Gauss in radius^2 times equally spaced azimuths. They are exact
    to degree 5, 7, 11, 19, 31, 47.
    """
    if level == 0:
        ring = np.arange(6) * (math.pi / 3.0)
        return (
            np.concatenate([[0.0], np.full(6, 2.0 / 3.0)]),
            np.concatenate([[0.0], ring]),
            np.concatenate([[0.25], np.full(6, 0.125)]),
        )
    rings = RINGS[level]
    spokes = 4 * rings
    x, w = gauss(rings)
    azimuth = (np.arange(spokes) + 0.5) * (2.0 * math.pi / spokes)
    square, psi = np.meshgrid(0.5 * (1.0 + x), azimuth, indexing="ij")
    return square.ravel(), psi.ravel(), np.repeat(0.5 * w / spokes, spokes)


def frame(omega: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that complete each axis (..., 3) to a frame; the first points away from the normal."""
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    s = np.hypot(x, y)
    flat = s > 0.0
    cos_phi = np.where(flat, x / np.where(flat, s, 1.0), 1.0)
    sin_phi = np.where(flat, y / np.where(flat, s, 1.0), 0.0)
    return (
        np.stack([z * cos_phi, z * sin_phi, -s], axis=-1),
        np.stack([-sin_phi, cos_phi, np.zeros_like(s)], axis=-1),
    )


def nodes(omega: Floats, half_angle: float, square: Floats, psi: Floats) -> Floats:
    """Directions (..., n, 3) at the places of a disc rule in caps about axes (..., 3)."""
    away, across = frame(omega)
    drop = square * (2.0 * math.sin(half_angle / 2.0) ** 2)  # 1 - cos rho
    sine = np.sqrt(drop * (2.0 - drop))
    out: Floats = (
        omega[..., None, :] * (1.0 - drop)[:, None]
        + away[..., None, :] * (sine * np.cos(psi))[:, None]
        + across[..., None, :] * (sine * np.sin(psi))[:, None]
    )
    return out


def cut_nodes(omega: Floats, half_angle: float, order: int) -> tuple[Floats, Floats]:
    """Directions (n, 3) above the horizon in the cap about one axis, and their solid angles [sr].

    In polar coordinates about the axis, with the sector that the horizon cuts and the one that it leaves each under
    a Gauss rule of their own.
    """
    z, s = float(omega[2]), math.hypot(float(omega[0]), float(omega[1]))
    down = z * math.cos(half_angle) / (s * math.sin(half_angle))
    meets = math.pi - math.acos(min(1.0, down))  # the azimuth, from the upward side, where the cap meets the horizon
    x, w = gauss(order)
    parts = []
    for low, high in ((0.0, meets), (meets, math.pi)):
        psi = 0.5 * (low + high) + 0.5 * (high - low) * x
        reach = np.full_like(psi, half_angle) if low == 0.0 else np.arctan2(z, -s * np.cos(psi))
        most = 2.0 * np.sin(np.minimum(reach, half_angle) / 2.0) ** 2
        drop = np.multiply.outer(most, 0.5 * (1.0 + x))
        weight = np.multiply.outer(0.5 * (high - low) * w * most, 0.5 * w)
        for sign in (1.0, -1.0):
            parts.append((drop.ravel(), np.repeat(sign * psi, order), weight.ravel()))
    drop, psi, weight = (np.concatenate(part) for part in zip(*parts, strict=True))
    away, across = frame(omega)
    sine = np.sqrt(drop * (2.0 - drop))
    directions: Floats = (
        np.multiply.outer(1.0 - drop, omega)
        - np.multiply.outer(sine * np.cos(psi), away)
        + np.multiply.outer(sine * np.sin(psi), across)
    )
    directions[:, 2] = np.maximum(directions[:, 2], 0.0)
    return directions, weight


def focused_nodes(
    axis: Floats, half_angle: float, focus: Floats, around_each: int, along_each: int, shrunk: int
) -> tuple[Floats, Floats]:
    """Nodes (k, n, 3) and solid angles (k, n) [sr] in one cap, crowded toward each of k directions in or out of it.

    In polar coordinates about the focus, on whose rays the cap is an interval; its Gauss panels shrink threefold
    toward the focus (or toward the edge nearest to it), `shrunk` times: 10 times down to 2e-5 of the interval, and a
    peak there of any width is integrated. The panels of either kind have `around_each` and `along_each` nodes.
    """
    along = focus @ axis
    toward = axis - along[:, None] * focus
    sine = np.linalg.norm(toward, axis=1)
    first, second = frame(focus)
    unit = np.where(sine[:, None] > 1e-12, toward / np.maximum(sine, 1e-300)[:, None], first)
    aside = np.where(sine[:, None] > 1e-12, np.cross(focus, unit), second)
    inside = along >= math.cos(half_angle)
    x, w = gauss(around_each)
    panels = np.linspace(-math.pi, math.pi, 5)
    around = (0.5 * (panels[:-1] + panels[1:])[:, None] + math.pi / 4 * x).ravel()
    # from outside, rays meet the cap within beta of its axis, and leave it like a square root at the ends
    beta = np.arcsin(np.minimum(1.0, math.sin(half_angle) / np.maximum(sine, 1e-300)))[:, None]
    turn = 0.5 * around
    psi = np.where(inside[:, None], around, beta * np.sin(turn))
    psi_weight = np.tile(math.pi / 4 * w, 4) * np.where(inside[:, None], 1.0, 0.5 * beta * np.cos(turn))
    ray = np.cos(psi)[..., None] * unit[:, None] + np.sin(psi)[..., None] * aside[:, None]
    across = np.cos(psi) * sine[:, None]  # ray . axis
    size = np.hypot(along[:, None], across)
    middle = np.arctan2(across, along[:, None])
    reach = np.arccos(np.minimum(1.0, math.cos(half_angle) / size))
    low = np.where(inside[:, None], 0.0, np.maximum(middle - reach, 0.0))
    length = np.maximum(middle + reach - low, 0.0)
    x, w = gauss(along_each)
    edges = np.concatenate([[0.0], 3.0 ** np.arange(-float(shrunk), 1.0)])
    step = 0.5 * np.diff(edges)[:, None]
    place, part = (edges[:-1, None] + step * (1.0 + x)).ravel(), (step * w).ravel()
    out, weight = (
        np.empty((len(focus), psi.shape[1] * place.size, 3)),
        np.empty((len(focus), psi.shape[1] * place.size)),
    )
    ends = (np.broadcast_to(low, psi.shape), length, psi_weight * length)
    rays = (np.repeat(focus, psi.shape[1], axis=0), ray, *ends, place, part, out, weight)
    loop(along_rays, sincos, 0)(*(array.reshape(-1) for array in rays), 0, psi.size)
    return out, weight


@template("r1 r1 r1 r1 r1 r1 r1 w1 w1 i i")
def along_rays(focus, ray, low, length, scale, place, part, out, weight, start, stop):
    """Nodes and solid angles at places (0 to 1) of arcs that leave directions along rays, ray after ray."""
    for j in range(start, stop):
        fx, fy, fz = focus[3 * j], focus[3 * j + 1], focus[3 * j + 2]
        rx, ry, rz = ray[3 * j], ray[3 * j + 1], ray[3 * j + 2]
        to, solid = out[3 * j * place.size :], weight[j * place.size :]
        for k in range(place.size):
            sine, cosine = kernel(low[j] + length[j] * place[k])  # type: ignore[name-defined]  # noqa: F821
            to[3 * k] = cosine * fx + sine * rx
            to[3 * k + 1] = cosine * fy + sine * ry
            to[3 * k + 2] = cosine * fz + sine * rz
            solid[k] = scale[j] * part[k] * sine


@device
def lens_area(d, a, b):
    """Solid angle [sr] that two caps of half-angles a and b share whose rims cross, their axes d apart; of arrays, too.

    Two sectors less the two triangles between axes and corners, by half-angle formulas: nothing cancels but in a thin
    lens.
    """
    h = 0.5 * (a + b + d)
    s0, sa, sb = np.sin(h), np.maximum(np.sin(h - a), 0.0), np.maximum(np.sin(h - b), 0.0)
    sd = np.maximum(np.sin(h - d), 0.0)
    at_a = 2.0 * np.arctan2(np.sqrt(sa * sd), np.sqrt(s0 * sb))
    at_b = 2.0 * np.arctan2(np.sqrt(sb * sd), np.sqrt(s0 * sa))
    corner = 2.0 * np.arctan2(np.sqrt(sa * sb), np.sqrt(s0 * sd))
    tangents = np.tan(0.5 * a) * np.tan(0.5 * b)
    excess = 2.0 * np.arctan2(tangents * np.sin(corner), 1.0 + tangents * np.cos(corner))
    return 4.0 * at_a * np.sin(0.5 * a) ** 2 + 4.0 * at_b * np.sin(0.5 * b) ** 2 - 2.0 * excess


@device
def overlap_area(d, a, b):
    """Solid angle [sr] that two caps of half-angles a and b share, their axes d apart."""
    if d >= a + b:
        return 0.0
    if d <= abs(a - b):
        return 4.0 * math.pi * math.sin(0.5 * min(a, b)) ** 2
    return lens_area(d, a, b)


@device
def tabulated(z, table, low, per_step):
    """A function of cos theta from equally spaced values, by cubics through four of them."""
    t = (z - low) * per_step
    k = min(max(int(t) - 1, 0), table.size - 4)
    return cubic(t - k, table[k], table[k + 1], table[k + 2], table[k + 3])


@device
def overlap_mean(d, a, b, vz, e1z, e2z, table, low, per_step, x, w):
    """Mean of a tabulated function of cos theta over the overlap of the cap b about v and the cap a, d away along e1.

    In the stereographic projection from -v both caps are discs, cut in two at the line through their corners; each
    part is a segment of one disc, under Gauss rules in the angle at its centre and across.
    """
    right = math.tan(0.5 * b)
    x_low, x_high = math.tan(0.5 * (d - a)), math.tan(0.5 * (d + a))
    centre, radius = 0.5 * (x_low + x_high), 0.5 * (x_high - x_low)
    if d + a <= b:
        angle_a, angle_b = math.pi, 0.0
    elif d + b <= a:
        angle_a, angle_b = 0.0, math.pi
    else:
        line = (centre * centre + right * right - radius * radius) / (2.0 * centre)
        angle_a = math.acos(min(max((centre - line) / radius, -1.0), 1.0))
        angle_b = math.acos(min(max(line / right, -1.0), 1.0))
    total, norm = 0.0, 0.0
    for side in range(2):
        angle = angle_a if side == 0 else angle_b
        size = radius if side == 0 else right
        if angle > 0.0:
            for i in range(x.size):
                t = 0.5 * angle * (1.0 + x[i])
                px = centre - size * math.cos(t) if side == 0 else size * math.cos(t)
                half = size * math.sin(t)
                for j in range(x.size):
                    py = half * x[j]
                    square = px * px + py * py
                    scale = 1.0 / (1.0 + square)
                    z = ((1.0 - square) * vz + 2.0 * (px * e1z + py * e2z)) * scale
                    weight = angle * w[i] * w[j] * half * half * scale * scale
                    total += weight * tabulated(z, table, low, per_step)
                    norm += weight
    return total / norm


@template("r1 r1 r1 r1 r1 p w1 i i")
def spike_over_vectors(omega_i, omega_r, table, x, w, constants, out, start, stop):
    """Spike of caps that stay above the horizon: constants are a, b, the table's low end, 1/step, and 1 for "exact"."""
    a, b, low, per_step, exact = constants
    reach = (2.0 * math.sin(min(0.5 * (a + b), 0.5 * math.pi))) ** 2
    omega_s = 4.0 * math.pi * math.sin(0.5 * a) ** 2 if exact == 0.0 else math.pi * math.sin(a) ** 2
    per_cos = 1.0 / (omega_s * 4.0 * math.pi * math.sin(0.5 * b) ** 2)
    for j in range(start, stop):
        lz = omega_i[3 * j + 2]
        vx, vy, vz = omega_r[3 * j], omega_r[3 * j + 1], omega_r[3 * j + 2]
        cx, cy, cz = -omega_i[3 * j] - vx, -omega_i[3 * j + 1] - vy, lz - vz
        chord = cx * cx + cy * cy + cz * cz
        if chord >= reach:
            out[j] = 0.0
            continue
        d = 2.0 * math.asin(0.5 * math.sqrt(chord))
        if exact == 0.0:
            mean = kernel(lz, table, low, per_step)  # type: ignore[name-defined]  # noqa: F821
        else:
            along = cx * vx + cy * vy + cz * vz
            tx, ty, tz = cx - along * vx, cy - along * vy, cz - along * vz
            length = math.sqrt(tx * tx + ty * ty + tz * tz)
            if length < 1e-12:  # concentric: any direction will do
                length = math.sqrt(vx * vx + vy * vy)
                tx, ty, tz = (-vy, vx, 0.0) if length > 0.0 else (1.0, 0.0, 0.0)
                length = length if length > 0.0 else 1.0
            mean = overlap_mean(d, a, b, vz, tz / length, (vx * ty - vy * tx) / length, table, low, per_step, x, w)
        out[j] = mean * overlap_area(d, a, b) * per_cos / lz
