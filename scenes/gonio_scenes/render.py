"""A scene's picture: every pixel's radiance, from as many rays as it needs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError
from gonio.typing import Floats
from gonio_scenes.integrator import Integrator
from gonio_scenes.scene import Scene

BLOCK = 1 << 16
"""Rays that are followed together: enough to keep two cores busy, few enough to stay in the cache."""
BATCH = 4
"""Rays of a pixel between two looks at its error."""
FIRST_BATCHES = 2
MAX_RAYS = 4096
"""Of a pixel that is brought to a tolerance; one that stays above it is counted."""

Indices = npt.NDArray[np.int64]
Step = Callable[[int, int], None]
"""Told how much is done, of how much."""


@dataclass(frozen=True)
class Picture:
    """A rendered scene. Arrays are (height, width, ...), row 0 at the top."""

    radiance: Floats
    """(height, width, wavelengths)."""
    error: Floats | None
    """Standard error of the radiance, (height, width, wavelengths); None where one ray a pixel is all."""
    samples: npt.NDArray[np.int64]
    """Rays a pixel."""
    shape: npt.NDArray[np.int64]
    """What the ray through the pixel's centre meets: the number of the shape, from 0, or -1."""
    position: Floats
    normal: Floats
    seconds: float
    rays: dict[str, int]
    above_tolerance: int
    """Pixels that `MAX_RAYS` did not bring to the tolerance."""


def render(scene: Scene, *, step: Step | None = None) -> Picture:
    """Render a scene.

    Raises
    ------
    ConfigError
        The camera sees no shape.
    """
    began = time.perf_counter()
    camera, waves = scene.camera, scene.wavelength_nm.size
    integrator = Integrator(scene)
    count = camera.pixels
    radiance = np.zeros((count, waves))
    shape = np.full(count, -1, dtype=np.int64)
    position, normal = np.zeros((count, 3)), np.zeros((count, 3))
    noisy = camera.lens_radius > 0 or camera.samples > 1 or scene.tolerance > 0 or _soft(scene)
    told = step or (lambda done, of: None)
    one_ray = camera.samples == 1 and scene.tolerance == 0.0
    for first in range(0, count, BLOCK):
        pixel = np.arange(first, min(first + BLOCK, count))
        block = slice(first, first + pixel.size)
        origin, direction = camera.rays(pixel, 0, None)
        if one_ray and camera.lens_radius == 0:
            radiance[block], hits = integrator.radiance(origin, direction, _random(scene, 0, first) if noisy else None)
        else:
            hits = scene.world.hit(origin, direction)
        shape[block], position[block], normal[block] = hits.shape, hits.position, hits.normal
        told(min(first + BLOCK, count), count * (1 if one_ray else camera.samples))
    if not (shape >= 0).any():
        raise ConfigError(
            "camera: no ray through a pixel's centre meets a shape: look_at_mm, vertical_field_deg, or the shapes' "
            "places are not what they should be"
        )
    error: Floats | None = None
    samples = np.ones(count, dtype=np.int64)
    above = 0
    if not (one_ray and camera.lens_radius == 0):
        radiance, error, samples, above = _averaged(scene, integrator, told)
    size = (camera.height, camera.width)
    return Picture(
        radiance=radiance.reshape(*size, waves),
        error=None if error is None else error.reshape(*size, waves),
        samples=samples.reshape(size),
        shape=shape.reshape(size),
        position=position.reshape(*size, 3),
        normal=normal.reshape(*size, 3),
        seconds=time.perf_counter() - began,
        rays=dict(integrator.rays),
        above_tolerance=above,
    )


def _soft(scene: Scene) -> bool:
    """Whether a light is a sum over its points."""
    return any(light.samples > 1 for light in scene.lights)


def _random(scene: Scene, batch: int, first: int) -> np.random.Generator:
    """The random numbers of a block of pixels in a batch: a function of the scene's seed alone."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((scene.seed, batch, first))))


def _averaged(scene: Scene, integrator: Integrator, told: Step) -> tuple[Floats, Floats, Indices, int]:
    """Means over batches of rays, their standard errors, and how many rays each pixel took.

    Each batch starts its even sequence of points anew at random, so batches are independent: their scatter is the
    error. Where there is a tolerance, a pixel goes on until its error is below it; the neighbours of a pixel that is
    not done go on too, since a few rays can miss an edge.
    """
    camera, count = scene.camera, scene.camera.pixels
    size, batches = (BATCH, MAX_RAYS // BATCH) if scene.tolerance > 0 else _batches(camera.samples)
    total, squares = (np.zeros((count, scene.wavelength_nm.size)) for _ in range(2))
    done = np.zeros(count, dtype=np.int64)
    active = np.arange(count)
    for batch in range(batches):
        for first in range(0, active.size, BLOCK):
            pixel = active[first : first + BLOCK]
            random = _random(scene, batch + 1, int(pixel[0]))
            shift = random.random((pixel.size, 4))
            mean = np.zeros((pixel.size, scene.wavelength_nm.size))
            for sample in range(size):
                mean += integrator.radiance(*camera.rays(pixel, sample, shift), random)[0]
            mean /= size
            total[pixel] += mean
            squares[pixel] += mean * mean
            done[pixel] += 1
            if scene.tolerance == 0:
                told(batch * count + min(first + BLOCK, count), batches * count)
        if scene.tolerance > 0 and batch + 1 >= FIRST_BATCHES:
            active = _unfinished(scene, total, squares, done)
            told(count - active.size, count)
            if active.size == 0:
                break
    error = _standard_error(total, squares, done)
    above = int(_bad(scene, total / done[:, None], error).sum()) if scene.tolerance > 0 else 0
    return total / done[:, None], error, done * size, above


def _batches(samples: int) -> tuple[int, int]:
    """Rays a batch and batches for so many rays a pixel: two batches at least, if there are two rays."""
    batches = next((b for b in (8, 7, 6, 5, 4, 3, 2) if samples % b == 0 and samples // b > 0), 1)
    return samples // batches, batches


def _standard_error(total: Floats, squares: Floats, done: Indices) -> Floats:
    """Of the mean over batches; NaN after one batch."""
    n = done[:, None].astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.maximum(squares / n - (total / n) ** 2, 0.0) / (n - 1.0)
    return np.asarray(np.sqrt(variance))


def _unfinished(scene: Scene, total: Floats, squares: Floats, done: Indices) -> Indices:
    """The pixels that are not below the tolerance yet, and those next to them until they have been looked at twice."""
    bad = _bad(scene, total / done[:, None], _standard_error(total, squares, done))
    grid = bad.reshape(scene.camera.height, scene.camera.width)
    near = grid.copy()
    near[1:] |= grid[:-1]
    near[:-1] |= grid[1:]
    near[:, 1:] |= grid[:, :-1]
    near[:, :-1] |= grid[:, 1:]
    return np.flatnonzero((bad | (near.ravel() & (done < 2 * FIRST_BATCHES))) & (done * BATCH < MAX_RAYS))


def _bad(scene: Scene, mean: Floats, error: Floats) -> npt.NDArray[np.bool_]:
    """Which pixels are above the tolerance."""
    level = np.maximum(np.abs(mean), np.abs(mean).mean(axis=0))
    return np.asarray((error > scene.tolerance * level).any(axis=1))
