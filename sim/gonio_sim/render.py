"""What the camera sees: expected electrons a second of every pixel, through a reflectance model.

For a pixel that looks at the spot x of the sample's plane (docs/architecture.md),

    rate = R pi V(pixel) cos(theta_i(x)) (d0 / d(x))^2 f(x)

with f the BRDF at the spot's own directions, averaged over the cones of lamp and lens. Its lobe is followed on a grid
of nodes (`nodes`), the specular spike is computed for every pixel that sees the mirror image of the lamp. Around the
sample lies the holder's plate, matt; the white reference lies beside the sample, or takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio import geometry
from gonio.description import Band, SampleDescription
from gonio.errors import ConfigError
from gonio.imaging import PixelMap, of_channel, pixel_map
from gonio.kinematics import View, directions, view
from gonio.rig import Pose, Target
from gonio_sim.world import World

if TYPE_CHECKING:
    from gonio.models.base import Model

Array = npt.NDArray[np.float64]
Floats = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

GRAZING = math.radians(89.99)
"""Nodes of a grid beyond this polar angle take the BRDF at it; pixels there see next to nothing."""
LOBE_TOLERANCE = 1e-5
"""Relative error of a lobe's average over the cones."""
DETAIL = 16.0
"""Nodes in the width of the cones, at the finest grid."""
KEPT = 2
"""Scenes kept: the sample's and the reference's."""
BRIGHTEST = 1e30
"""Electrons a second that stand for infinitely many."""
BAND_NODES = 5
"""Wavelengths that the integral over a band is made of."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A round surface in the sample's plane: where it lies [mm], and its BRDF [1/sr] filled in for a mask of pixels."""

    centre: tuple[float, float]
    radius: float
    fill: Callable[[PixelMap, View, Mask, Array], None]


class Renderer:
    """Renders the world's present scene, and remembers the last ones.

    Raises
    ------
    ConfigError
        The sample's model or its parameters are wrong.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._model = _build(world.sample) if world.sample is not None else None
        lamp, camera = world.description.lamp, world.description.camera
        self._cones = {
            "source_solid_angle_sr": float(geometry.solid_angle_of_cone(math.radians(lamp.half_angle_deg))),
            "receiver_solid_angle_sr": float(geometry.solid_angle_of_cone(math.radians(camera.lens_half_angle_deg))),
        }
        # averaged over the cones, a lobe has no finer detail than they; a spot's mirror direction turns twice with the spot
        distance = min(world.description.geometry.light_distance_mm, world.description.geometry.camera_distance_mm)
        cones = math.radians(lamp.half_angle_deg + camera.lens_half_angle_deg)
        self._finest_mm = 0.5 * cones * distance / DETAIL
        self._scenes: dict[tuple[Pose, Band, Target], Floats] = {}

    def rate(self, band: Band) -> Floats:
        """Expected electrons a second of every pixel with a fresh lamp, shape (height, width)."""
        key = (self._world.pose, band, self._world.target)
        if key not in self._scenes:
            while len(self._scenes) >= KEPT:
                del self._scenes[next(iter(self._scenes))]
            self._scenes[key] = self._render(*key)
        return self._scenes[key]

    def _render(self, pose: Pose, band: Band, target: Target) -> Floats:
        description = self._world.description
        scene = view(description, pose)
        if scene.camera_mm[2] <= 0.0:
            return np.zeros((description.camera.height, description.camera.width), np.float32)
        seen = pixel_map(description, scene)
        brdf = np.where(seen.sees_plane, description.holder.holder_albedo / math.pi, 0.0)
        for disc in self._discs(band, target):
            x, y = disc.centre
            inside = (seen.x_mm - x) ** 2 + (seen.y_mm - y) ** 2 <= disc.radius**2
            disc.fill(seen, scene, inside, brdf)
        rate = (math.pi * description.camera.responsivity_e_per_s) * seen.weight * brdf
        rate[~of_channel(description.camera.pattern, band.channel, seen.rows, seen.cols)] = 0.0
        # a model may be negative where its formula is bad (Oren-Nayar near grazing), or infinite; light is not
        return np.clip(rate, 0.0, BRIGHTEST).astype(np.float32)

    def _discs(self, band: Band, target: Target) -> Iterator[Disc]:
        """The round surfaces in view."""
        description, sample = self._world.description, self._world.sample
        reference = description.reference
        if reference.how == "beside":
            yield Disc(reference.offset_mm, reference.diameter_mm / 2, self._reference(band))
        elif target == "reference":
            yield Disc((0.0, 0.0), reference.diameter_mm / 2, self._reference(band))
            return
        if sample is None:
            raise ConfigError(
                f'the simulated rig "{description.name}" has no sample to look at: name one with --sample S.toml'
            )
        diameter = sample.diameter_mm or description.holder.sample_diameter_mm
        yield Disc((0.0, 0.0), diameter / 2, self._sample(band))

    def _reference(self, band: Band) -> Callable[[PixelMap, View, Mask, Array], None]:
        """The white reference: its certificate times its true error; a table is read at the centre of the frame."""
        description, scale = self._world.description, self._world.reference_scale
        reference, pose = description.reference, self._world.pose

        def fill(seen: PixelMap, scene: View, inside: Mask, brdf: Array) -> None:
            if reference.table is not None:
                from gonio.level import brdf_of_table
                from gonio.measurement import read

                certified = brdf_of_table(read(reference.table), directions(description, pose), band.centre_nm)
            else:
                certified = (reference.albedo or 0.0) / math.pi
            brdf[inside] = scale * certified

        return fill

    def _sample(self, band: Band) -> Callable[[PixelMap, View, Mask, Array], None]:
        """The sample: its model's lobe on a grid of nodes, and its spike pixel by pixel."""
        from gonio import instrument
        from gonio_sim.nodes import sample_function

        model, sample = self._model, self._world.sample
        assert model is not None
        assert sample is not None
        waves = _wavelengths(band) if sample.integrate_band else [(band.centre_nm, 1.0)]
        radius = (sample.diameter_mm or self._world.description.holder.sample_diameter_mm) / 2

        def fill(seen: PixelMap, scene: View, inside: Mask, brdf: Array) -> None:
            def lobes(x: Array, y: Array) -> Array:
                angles = _angles_at(scene, x, y)
                out = np.zeros(x.shape)
                for wave, share in waves:
                    lobe = instrument.apparent_lobe(
                        model, *angles, wavelength_nm=wave, tolerance=LOBE_TOLERANCE, **self._cones
                    )
                    out += share * lobe
                return out

            grid = sample_function(lobes, -radius, -radius, 2 * radius, self._finest_mm)
            grid.fill(seen.x_mm, seen.y_mm, inside, brdf)
            if not hasattr(model, "specular_reflectivity"):
                return
            mirrored = inside & self._sees_lamp(seen)
            angles = _angles_at(scene, seen.x_mm[mirrored], seen.y_mm[mirrored])
            for wave, share in waves:
                spike = instrument.apparent_spike(model, *angles, wavelength_nm=wave, spike="exact", **self._cones)
                brdf[mirrored] += share * spike

        return fill

    def _sees_lamp(self, seen: PixelMap) -> Mask:
        """Pixels whose lens pupil meets the mirror image of the lamp's disc."""
        description = self._world.description
        reach = math.radians(description.lamp.half_angle_deg + description.camera.lens_half_angle_deg)
        # chord between the direction to the camera and the mirrored direction to the source
        apart = seen.omega_r - seen.omega_i * (-1.0, -1.0, 1.0)
        out: Mask = np.einsum("...k,...k->...", apart, apart) <= (2.0 * math.sin(reach / 2.0)) ** 2
        return out


def _angles_at(scene: View, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """theta_i, phi_i, theta_r, phi_r [rad] at spots of the sample's plane."""
    spots = np.stack([x, y, np.zeros_like(x)], axis=-1)
    theta_i, phi_i = geometry.angles(scene.source_mm - spots)
    theta_r, phi_r = geometry.angles(scene.camera_mm - spots)
    return np.minimum(theta_i, GRAZING), phi_i, np.minimum(theta_r, GRAZING), phi_r


def _wavelengths(band: Band) -> list[tuple[float, float]]:
    """Wavelengths [nm] and shares of the integral over a band of Gaussian shape: Gauss-Hermite quadrature."""
    at, weights = np.polynomial.hermite.hermgauss(BAND_NODES)
    sigma = band.fwhm_nm / (2.0 * math.sqrt(2.0 * math.log(2.0)))
    shares = weights / math.sqrt(math.pi)
    return [(band.centre_nm + math.sqrt(2.0) * sigma * float(t), float(w)) for t, w in zip(at, shares, strict=True)]


def _build(sample: SampleDescription) -> Model:
    from gonio import models

    try:
        return models.build(sample.model, dict(sample.parameters))
    except ConfigError as error:
        raise ConfigError(f'sample "{sample.name}", [parameters]: {error}') from error
