"""Rays, and a slow way to say where they meet a solid that knows only which points are inside."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_scenes.shapes import AnyShape, Ints, Shape, Surface
from pydantic import TypeAdapter

from gonio.typing import Floats

Inside = Callable[[Floats], npt.NDArray[np.bool_]]


def shape(kind: str, folder: Path = Path(), **keys: Any) -> Shape:
    """The shape of a table, as a scene file has it."""
    table: Any = TypeAdapter(AnyShape).validate_python({"kind": kind, "material": "white", **keys})
    built: Shape = table.build(folder)
    return built


def toward(rng: np.random.Generator, count: int, center: Floats, size: float, far: float) -> tuple[Floats, Floats]:
    """Rays from about `far` away to points spread over a ball of the diameter `size` around a centre."""
    origin = center + far * units(rng, count)
    goal = center + 0.6 * size * units(rng, count) * rng.random((count, 1)) ** (1 / 3)
    direction = goal - origin
    return origin, direction / np.linalg.norm(direction, axis=1)[:, np.newaxis]


def meet(built: Shape, origin: Floats, direction: Floats) -> tuple[Any, Floats, Ints, Surface]:
    """Which rays meet a shape; how far each goes, and its primitive; and the surface of those that do."""
    distance, primitive = built.intersect(origin, direction, 0.0)
    hit = np.isfinite(distance)
    return hit, distance, primitive, built.surface(origin[hit], direction[hit], distance[hit], primitive[hit])


def shades_not_itself(
    built: Shape, rng: np.random.Generator, origin: Floats, direction: Floats, rounding: float = 1e-4
) -> tuple[Floats, Floats, Floats]:
    """Rays that start where others hit and go outward meet nothing, and those that go inward meet the other side.

    `rounding` is the least cosine between a ray and the surface. What the inward ones are: their starts, their
    directions, and how far each goes.
    """
    hit, _, _, surface = meet(built, origin, direction)
    away = units(rng, int(hit.sum()))
    slope = np.einsum("ij,ij->i", away, surface.normal)
    met, _ = built.intersect(surface.position, away, 1e-9 * built.size_mm)
    assert not np.isfinite(met[slope > rounding]).any()  # 1e-14 of rounding off the surface, over the slope
    inward = slope < -1e-4
    assert np.isfinite(met[inward]).all()
    return surface.position[inward], away[inward], met[inward]


def units(rng: np.random.Generator, count: int) -> Floats:
    """Directions, evenly over the sphere."""
    vectors = rng.standard_normal((count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, np.newaxis])


def along(vectors: Floats, axis: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Height along an axis and distance from it, by cross product."""
    unit = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    return vectors @ unit, np.linalg.norm(np.cross(vectors, unit), axis=-1)


def bisected(
    inside: Inside, origin: Floats, direction: Floats, start: float, stop: float, steps: int
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Where each ray first passes between inside and outside, from `start` to `stop`; and whether it does.

    A stretch shorter than (stop - start) / steps may be overlooked.
    """
    t = np.linspace(start, stop, steps + 1)
    within = np.stack([inside(origin + s * direction) for s in t], axis=1)
    changes = within[:, 1:] != within[:, :-1]
    found = changes.any(axis=1)
    k = changes.argmax(axis=1)
    low, high, first = t[k], t[k + 1], within[np.arange(len(k)), k]
    for _ in range(70):
        middle = 0.5 * (low + high)
        same = inside(origin + middle[:, np.newaxis] * direction) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return np.where(found, high, np.inf), found


def check_against_bisection(
    built: Shape, inside: Inside, center: Floats, seed: int, count: int = 1000, steps: int = 800
) -> None:
    """First hits from outside and from inside, against bisection; normals against the gradient of the inside."""
    rng = np.random.default_rng(seed)
    size = built.size_mm
    for far in (0.9 * size, 20.0 * size):
        origin, direction = toward(rng, count, center, size, far)
        hit, distance, _, surface = meet(built, origin, direction)
        span = (max(far - 1.5 * size, 0.0), far + 1.5 * size)
        slow, found = bisected(inside, origin, direction, *span, steps)
        assert found.sum() > count / 10, "the rays were meant to meet the shape"
        assert np.all(hit[found])
        # what bisection may overlook is a stretch inside that is shorter than its step
        off = np.zeros(count)
        np.subtract(slow, distance, out=off, where=hit & found)
        missed = hit & (~found | (np.abs(off) > 1e-10 * (far + size)))
        for k in np.flatnonzero(missed):
            at = float(distance[k])
            second, _ = built.intersect(origin[k : k + 1], direction[k : k + 1], at + 1e-12 * far)
            assert second[0] - at < 2.0 * (span[1] - span[0]) / steps
            assert at < slow[k]
        assert missed.mean() < 0.05
        good = hit & ~missed
        # 1e-10 of the numbers that are added: ten thousand roundings, and a tenth of what is promised
        np.testing.assert_allclose(distance[good], slow[good], rtol=0, atol=1e-10 * size)

        along_ray = origin[hit] + distance[hit, np.newaxis] * direction[hit]
        np.testing.assert_allclose(surface.position, along_ray, rtol=0, atol=1e-9 * size)
        check_frame(surface)
        # away from edges: a step along the normal is outside, against it inside
        step = 1e-6 * size
        out = ~inside(surface.position + step * surface.normal) & inside(surface.position - step * surface.normal)
        assert out.mean() > 0.999


def check_frame(surface: Surface) -> None:
    """Unit vectors, the tangent across the shading normal, uv in [0, 1]."""
    for vectors in (surface.normal, surface.shading, surface.tangent):
        # a few roundings
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.einsum("ij,ij->i", surface.shading, surface.tangent), 0.0, atol=1e-14)
    assert np.all((surface.uv >= 0.0) & (surface.uv <= 1.0))
