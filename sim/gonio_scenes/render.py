"""A scene's picture: every pixel's radiance, from as many rays as it needs."""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from gonio.errors import ConfigError
from gonio.typing import Bools, Floats, NDArray
from gonio_scenes.integrator import Integrator
from gonio_scenes.scene import Scene, tables
from gonio_scenes.world import Hits

BLOCK = 1 << 16
"""Rays with random numbers that are followed together; which numbers a ray has follows from it."""
FEWER = 1 << 13
"""The same of rays without: as fast, in a fifth of the memory."""
BATCH = 4
"""Rays of a pixel between two looks at its error."""
FIRST_BATCHES = 3
MOST_BATCHES = 8
"""Most batches of a pixel without a tolerance: their scatter tells the error to a quarter, and each fills it evenly."""
PRIOR = 16
"""Batches that the scatter around a pixel counts for. It asks a pixel beside an edge for some contrast/tolerance rays:
as many as an edge in its own corner needs not to be missed."""
MAX_RAYS = 4096
"""Most rays of a pixel that is brought to a tolerance; one that stays above it is counted."""

Indices = NDArray[np.int64]
Step = Callable[[int, int], None]
"""Told how much is done, of how much."""


@dataclass(frozen=True)
class Picture:
    """A rendered scene. Arrays are (height, width, ...), row 0 at the top."""

    scene: Scene
    radiance: Floats
    """(height, width, wavelengths)."""
    error: Floats | None
    """Standard error of the radiance, (height, width, wavelengths); None where one ray a pixel is all."""
    samples: NDArray[np.int64]
    """Rays a pixel."""
    seconds: float
    rays: dict[str, int]
    above_tolerance: int
    """Pixels that `MAX_RAYS` did not bring to the tolerance."""
    share_on_shapes: float
    """Share of the pixels whose centre sees a shape."""

    def centres(self) -> Iterator[Hits]:
        """What the rays through the pixels' centres meet, some rows of pixels after the other; traced anew."""
        for pixel in _blocks(self.scene, FEWER):
            yield self.scene.world.hit(*self.scene.camera.rays(pixel, 0, None))

    @cached_property
    def extrapolated(self) -> dict[str, float | None]:
        """By the name of a material that is a measured table: the share of its light that is extrapolated.

        Of the pixels whose centre sees the material, the light of lamps by rays through these centres, over all
        wavelengths; ambient light is not counted. None where no lamp lights it.
        """
        scene = replace(self.scene, ambient=None)
        names = np.array([shape.material for shape in scene.tables.shape])
        whole, measured = (dict.fromkeys(tables(scene), 0.0) for _ in range(2))
        if not whole:
            return {}
        known = replace(scene, material=tuple(material.measured_alone() for material in scene.material))
        for pixel in _blocks(scene, FEWER):
            rays = scene.camera.rays(pixel, 0, None)
            for light, of in ((whole, scene), (measured, known)):
                radiance, hits = Integrator(of).radiance(*rays, None)
                for name in light:
                    here = (hits.shape >= 0) & (names[hits.shape] == name)
                    light[name] += float(radiance[here].sum())
        return {name: 1.0 - measured[name] / light if light else None for name, light in whole.items()}

    @cached_property
    def shape(self) -> NDArray[np.int64]:
        """What the ray through the pixel's centre meets: the number of the shape, from 0, or -1."""
        return np.concatenate([hits.shape for hits in self.centres()]).reshape(self.radiance.shape[:2])

    @cached_property
    def position(self) -> Floats:
        """Where it meets that [mm]."""
        return np.concatenate([hits.position for hits in self.centres()]).reshape(*self.radiance.shape[:2], 3)

    @cached_property
    def normal(self) -> Floats:
        """Its normal there."""
        return np.concatenate([hits.normal for hits in self.centres()]).reshape(*self.radiance.shape[:2], 3)


def render(scene: Scene, *, step: Step | None = None) -> Picture:
    """Render a scene.

    Raises
    ------
    ConfigError
        The camera sees no shape, or a radiance is no finite number.
    """
    began = time.perf_counter()
    camera, waves = scene.camera, scene.wavelength_nm.size
    integrator = Integrator(scene)
    count, seen = camera.pixels, 0
    told = step or (lambda done, of: None)
    one_ray, through_centres, noisy = _kind(scene)
    radiance = np.zeros((count if through_centres else 0, waves))
    for pixel in _blocks(scene, BLOCK if through_centres and noisy else FEWER):
        origin, direction = camera.rays(pixel, 0, None)
        if through_centres:
            random = _random(scene, 0, int(pixel[0])) if noisy else None
            radiance[pixel[0] : pixel[-1] + 1], hits = integrator.radiance(origin, direction, random)
        else:
            hits = scene.world.hit(origin, direction)
        seen += int((hits.shape >= 0).sum())
        told(int(pixel[-1]) + 1, count * (1 if one_ray else camera.samples))
    if not seen:
        raise ConfigError(
            f"{scene.source}: camera: no ray through a pixel's centre meets a shape: look_at_mm, vertical_field_deg, "
            "or the shapes' places are not what they should be"
        )
    error: Floats | None = None
    samples: Indices = np.broadcast_to(np.int64(1), count)
    above = 0
    with np.errstate(over="ignore"):  # what is no finite number is refused
        if not through_centres:
            radiance, error, samples, above = _averaged(scene, integrator, told)
        finite = bool(np.isfinite(radiance.sum()))
    if not finite:
        raise ConfigError(
            f"{scene.source}: light: radiances of the picture are no finite numbers, or their sum is none: a light is "
            "too strong, or lies on a surface"
        )
    size = (camera.height, camera.width)
    return Picture(
        scene=scene,
        radiance=radiance.reshape(*size, waves),
        error=None if error is None else error.reshape(*size, waves),
        samples=samples.reshape(size),
        seconds=time.perf_counter() - began,
        rays=dict(integrator.rays),
        above_tolerance=above,
        share_on_shapes=seen / count,
    )


def radiance_of(scene: Scene, only: Bools) -> tuple[Floats, Floats | None]:
    """Radiances (pixels, wavelengths), and standard errors as `Picture.error`, where `only` (pixels,) is true.

    By the rays that `render` takes of a scene without a tolerance; elsewhere they count for nothing.
    """
    integrator = Integrator(scene)
    _, through_centres, noisy = _kind(scene)
    if not through_centres:
        return _even(scene, integrator, lambda done, of: None, only)[:2]
    out = np.zeros((only.size, scene.wavelength_nm.size))
    for pixel in _blocks(scene, BLOCK if noisy else FEWER):
        wanted = only[pixel]
        if not wanted.any():
            continue
        if noisy:
            rays = scene.camera.rays(pixel, 0, None)
            out[pixel], _ = integrator.radiance(*rays, _random(scene, 0, int(pixel[0])), wanted)
        else:
            pixel = pixel[wanted]
            out[pixel], _ = integrator.radiance(*scene.camera.rays(pixel, 0, None), None)
    return out, None


def _kind(scene: Scene) -> tuple[bool, bool, bool]:
    """Whether a pixel takes one ray, whether that goes through its centre, and whether there are random numbers."""
    camera = scene.camera
    one_ray = camera.samples == 1 and scene.tolerance == 0.0
    noisy = not one_ray or camera.lens_radius > 0 or any(light.samples > 1 for light in scene.lights)
    return one_ray, one_ray and camera.lens_radius == 0, noisy


def _blocks(scene: Scene, size: int = BLOCK) -> Iterator[Indices]:
    """All pixels, by their numbers, block by block."""
    count = scene.camera.pixels
    return (np.arange(first, min(first + size, count)) for first in range(0, count, size))


def _random(scene: Scene, batch: int, first: int) -> np.random.Generator:
    """The random numbers of a block of pixels in a batch: a function of the scene's seed alone."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((scene.seed, batch, first))))


def _averaged(scene: Scene, integrator: Integrator, told: Step) -> tuple[Floats, Floats, Indices, int]:
    """Means over batches of rays, their standard errors, and how many rays each pixel took.

    Each batch starts its even sequence of points anew at random, so batches are independent: their scatter is the
    error. Where there is a tolerance, each pixel takes as many more batches as its error asks for, but by half as many
    as it had at most before it is looked at again.
    """
    camera, count = scene.camera, scene.camera.pixels
    if scene.tolerance == 0:
        return _even(scene, integrator, told)
    size, batches = BATCH, FIRST_BATCHES
    sums = _Sums.of(count, scene.wavelength_nm.size)
    for batch in range(batches):
        for pixel in _blocks(scene):
            sums.add(scene, integrator, pixel, size, _random(scene, batch + 1, int(pixel[0])))
    for turn in itertools.count(batches + 1):
        error = sums.error(camera.height, camera.width)
        wanted = sums.batches * _excess(scene, sums.mean, error)
        active = np.flatnonzero((wanted > sums.batches) & (sums.rays < MAX_RAYS))
        told(count - active.size, count)
        if active.size == 0:
            break
        now = sums.batches[active]
        most = np.minimum(now + (now + 1) // 2, MAX_RAYS // size)
        rows = np.repeat(active, np.ceil(np.minimum(wanted[active], most)).astype(np.int64) - now)
        for first in range(0, rows.size, BLOCK):
            sums.add(scene, integrator, rows[first : first + BLOCK], size, _random(scene, turn, first))
    above = int((_excess(scene, sums.mean, error) > 1.0).sum())
    return sums.mean, error, sums.rays, above


def _even(
    scene: Scene, integrator: Integrator, told: Step, only: Bools | None = None
) -> tuple[Floats, Floats, Indices, int]:
    """`_averaged`, with as many rays in every pixel: block by block."""
    sizes, count = _batches(scene.camera.samples), scene.camera.pixels
    mean, error = (np.zeros((count, scene.wavelength_nm.size)) for _ in range(2))
    for pixel in _blocks(scene):
        wanted = None if only is None else only[pixel]
        if wanted is not None and not wanted.any():
            continue
        sums = _Sums.of(pixel.size, scene.wavelength_nm.size)
        for batch, size in enumerate(sizes, 1):
            sums.add(scene, integrator, pixel, size, _random(scene, batch, int(pixel[0])), int(pixel[0]), wanted)
        block = slice(int(pixel[0]), int(pixel[-1]) + 1)
        mean[block], error[block] = sums.mean, sums.error()
        told(block.stop, count)
    return mean, error, np.broadcast_to(np.int64(scene.camera.samples), count), 0


@dataclass(frozen=True)
class _Sums:
    """What batches of rays gave so far, pixel by pixel."""

    total: Floats
    """Sum of the rays, (pixels, wavelengths)."""
    squares: Floats
    """Sum of squares of the batches' means, each as often as it has rays."""
    batches: Indices
    rays: Indices

    @classmethod
    def of(cls, pixels: int, waves: int) -> Self:
        """The sums of no rays."""
        return cls(np.zeros((pixels, waves)), np.zeros((pixels, waves)), *np.zeros((2, pixels), np.int64))

    @property
    def mean(self) -> Floats:
        return np.asarray(self.total / self.rays[:, None])

    def add(
        self, scene: Scene, integrator: Integrator, pixel: Indices, size: int, random: np.random.Generator,
        first: int = 0, only: Bools | None = None,
    ) -> None:  # fmt: skip
        """Follow a batch of rays for each entry of `pixel`, which grows and may name a pixel several times.

        These sums begin with the pixel `first`; `only` is the integrator's.
        """
        shift = random.random((pixel.size, 4))
        mean = np.zeros((pixel.size, scene.wavelength_nm.size))
        for sample in range(size):
            mean += integrator.radiance(*scene.camera.rays(pixel, sample, shift), random, only)[0]
        mean /= size
        starts = np.flatnonzero(np.diff(pixel, prepend=-1))
        at = pixel[starts] - first
        again = np.diff(starts, append=pixel.size)
        self.total[at] += size * np.add.reduceat(mean, starts)
        self.squares[at] += size * np.add.reduceat(mean * mean, starts)
        self.batches[at] += again
        self.rays[at] += size * again

    def error(self, height: int = 0, width: int = 0) -> Floats:
        """Standard errors of the means from the scatter of batches, (pixels, wavelengths); NaN after one batch.

        With the picture's size, the mean scatter of a pixel and its eight neighbours counts as `PRIOR` more batches
        would. A few batches scatter too little by chance, and miss an edge in a corner of their pixel.
        """
        n, rays = self.batches[:, None].astype(np.float64), self.rays[:, None].astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            # of one ray: a batch's mean has it over the rays of the batch
            variance = np.maximum(self.squares - self.total**2 / rays, 0.0) / (n - 1.0)
        if height:
            from scipy.ndimage import uniform_filter  # it takes 15 MB

            grid = variance.reshape(height, width, -1)
            around = uniform_filter(grid, size=(3, 3, 1), mode="nearest").reshape(variance.shape)
            variance = ((n - 1.0) * variance + PRIOR * np.maximum(around, 0.0)) / (n - 1.0 + PRIOR)
        return np.asarray(np.sqrt(variance / rays))


def _batches(samples: int) -> list[int]:
    """Rays of each batch for `samples` rays a pixel: as many batches as `MOST_BATCHES` allows, as even as can be."""
    batches = min(samples, MOST_BATCHES)
    return [samples // batches + (k < samples % batches) for k in range(batches)]


def _excess(scene: Scene, mean: Floats, error: Floats) -> Floats:
    """How many times as many batches each pixel needs, (pixels,): 1 or less where it is not above the tolerance."""
    level = np.maximum(np.abs(mean), np.abs(mean).mean(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(error > 0.0, error / (scene.tolerance * level), 0.0)
    return np.asarray((ratio**2).max(axis=1))
