"""What the camera sees: expected electrons a second of every pixel, through a reflectance model.

For a pixel that looks at the spot x of the sample's plane (docs/mechanics.md),

    rate = R pi V(pixel) cos(theta_i(x)) (d0 / d(x))^2 f(x)

with f the BRDF at the spot's own directions, averaged over the cones of lamp and lens. Its lobe is followed on a grid
of nodes (`nodes`), the specular spike is computed for every pixel that sees the mirror image of the lamp. Around the
sample lies the holder's plate, matt; the white reference lies beside the sample, or takes its place. From behind, f
is the sample's BTDF; plate and reference let no light through.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gonio import geometry, instrument, models
from gonio.errors import ConfigError
from gonio.lab.rig import Pose, fiducials
from gonio.lab.rig.description import Fiducials, Holder
from gonio.lab.rig.imaging import PixelMap, of_channel, pixel_map
from gonio.lab.rig.kinematics import View, directions, view
from gonio.lab.rig.light_and_camera import Band
from gonio.samples.description import SampleDescription
from gonio.typing import Bools, DataFrame, Floats, NDArray
from gonio_sim import polarised
from gonio_sim.adaptive_grid import Function, electrons_per_s, sample_function
from gonio_sim.textures import Plate, Textures, Whole
from gonio_sim.world import InHolder, World

Floats32 = NDArray[np.float32]

GRAZING = math.radians(89.99)
"""Nodes of a grid beyond this polar angle take the BRDF at it; pixels there see next to nothing."""
DETAIL = 16.0
"""Nodes in the width of the cones, at the finest grid."""
KEPT = 2
"""Scenes kept: the sample's and the reference's."""
KEPT_BYTES = 2**27
"""Where two are larger, one is kept."""
STRIP = 2**19
"""Pixels that are rendered together: their arrays are many."""
BRIGHTEST = 1e30
"""Electrons a second that stand for infinitely many."""
FINER = 6
"""Spots across a pixel where it sees a printed marker."""
PROBED = 3
"""Spots across the sample at which levels of a texture are compared."""
BAND_NODES = 5
"""Wavelengths that the integral over a band is made of."""


Painter = Callable[[PixelMap, Bools, Floats], None]
"""Fills in the BRDF [1/sr] of the pixels that see a disc."""


@dataclass(frozen=True, slots=True)
class SampleDisc:
    """A round surface in the sample's plane: where it lies [mm], and its BRDF [1/sr], or what fills it in."""

    paint: Painter | float
    radius: float
    centre: tuple[float, float] = (0.0, 0.0)

    def show(self, seen: PixelMap, brdf: Floats) -> None:
        """Fill in the BRDF of the pixels that see it."""
        x, y = self.centre
        covered: Bools = (seen.x_mm - x) ** 2 + (seen.y_mm - y) ** 2 <= self.radius**2
        if callable(self.paint):
            self.paint(seen, covered, brdf)
        else:
            brdf[covered] = self.paint


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
        self._textures = _changing(world.sample) if world.sample is not None else None
        lamp, camera = world.truth.lamp, world.truth.camera
        self._cones = {
            "source_solid_angle_sr": float(geometry.solid_angle_of_cone(math.radians(lamp.half_angle_deg))),
            "receiver_solid_angle_sr": float(geometry.solid_angle_of_cone(math.radians(camera.lens_half_angle_deg))),
        }
        distances = world.truth.geometry
        # how fast the chord of `_apart` can change along the plane [1/mm], and how long it is where a spike ends
        self._turn = 1.0 / distances.light_distance_mm + 1.0 / distances.camera_distance_mm
        cones = math.radians(lamp.half_angle_deg + camera.lens_half_angle_deg)
        self._spike_reach = 2.0 * math.sin(0.5 * cones)
        # averaged over the cones, a lobe has no detail much finer than they are
        self._finest_mm = cones / self._turn / DETAIL
        self._ends = polarised.ends(world.truth)
        self._scenes: dict[tuple[Pose, Band, InHolder, tuple[object, ...]], Floats32] = {}

    def rate(self, band: Band) -> Floats32:
        """Expected electrons a second of every pixel with a fresh lamp, shape (height, width)."""
        key = (self._world.pose, band, self._world.target, tuple(self._world.polarisers.values()))
        if key not in self._scenes:
            camera = self._world.truth.camera
            kept = min(KEPT, max(1, KEPT_BYTES // (4 * camera.width * camera.height)))
            while len(self._scenes) >= kept:
                del self._scenes[next(iter(self._scenes))]
            world = self._world
            self._ends = polarised.ends(world.truth, world.polarisers, world.polariser_errors)
            self._scenes[key] = self._render(*key[:3])
        return self._scenes[key]

    def _render(self, pose: Pose, band: Band, target: InHolder) -> Floats32:
        description = self._world.optics
        if target == "empty":
            return self._straight_through(pose, band)
        if target == "reference" and description.reference.how == "beam":
            return self._straight_through(pose, band) * np.float32(description.reference.attenuation or 1.0)
        scene = view(description, pose)
        behind = scene.camera_mm[2] < 0.0
        if scene.camera_mm[2] == 0.0 or (behind and target not in ("sample", "empty")):
            return np.zeros((description.camera.height, description.camera.width), np.float32)
        height, width = description.camera.height, description.camera.width
        discs = list(self._through(band) if behind else self._discs(band, target, scene))
        rate = np.empty((height, width), np.float32)
        step = height if self._textures is not None else max(1, STRIP // width)  # levels of textures are of all pixels
        for top in range(0, height, step):
            bottom = min(top + step, height)
            above = min(top, 1)  # neighbours, where a pixel's slope counts
            seen = pixel_map(description, scene, slice(top - above, bottom + 1))
            brdf = np.full(seen.weight.shape, 0.0 if behind else description.holder.holder_albedo / math.pi)
            if description.holder.fiducials is not None and not behind:
                _paint_fiducials(description.holder, description.holder.fiducials, seen, brdf)
            for disc in discs:
                disc.show(seen, brdf)
            # A pixel that sees no plane has no weight. A model may be negative where its formula is bad (Oren-Nayar
            # near grazing), or infinite; light is not.
            own = slice(above, above + bottom - top)
            scale = math.pi * description.camera.responsivity_e_per_s * self._ends.passed
            electrons_per_s(scale, seen.weight[own], brdf[own], BRIGHTEST, rate[top:bottom])
        return self._through_lens(rate, band)

    def _through_lens(self, rate: Floats32, band: Band) -> Floats32:
        """The lens's blur, a band's own pixels, and what lens and sensor spread; each colour of a mosaic for itself."""
        from scipy.ndimage import gaussian_filter

        camera = self._world.truth.camera
        if camera.blur_px:
            rate = gaussian_filter(rate, camera.blur_px, mode="nearest", output=np.float32)
        if band.channel == "mono" and not camera.stray_light and not camera.stray_halo:
            return rate
        lit = of_channel(camera.pattern, band.channel, slice(0, camera.height), slice(0, camera.width))
        rate[~lit] = 0.0
        if not camera.stray_light and not camera.stray_halo:
            return rate
        share = np.count_nonzero(lit) / lit.size
        added = np.full(rate.shape, camera.stray_light * float(rate.mean(dtype=np.float64)) / share)
        if camera.stray_halo:
            halo = gaussian_filter(rate.astype(np.float64), camera.stray_halo_px, mode="constant")
            added += camera.stray_halo * halo / share
        return np.asarray(np.where(lit, np.minimum(rate + added, BRIGHTEST), 0.0), dtype=np.float32)

    def _discs(self, band: Band, target: InHolder, scene: View) -> Iterator[SampleDisc]:
        """The round surfaces in view."""
        description, reference = self._world.truth, self._world.truth.reference
        in_place, whole = reference.diameter_mm / 2, description.holder.sample_diameter_mm / 2
        if target == "trap":
            yield SampleDisc(0.0, whole)
        elif target == "edge":
            yield SampleDisc(self._edge(band), in_place)
        elif target == "reference" and reference.how != "beside":
            yield SampleDisc(self._reference(band), in_place)
        else:
            if reference.how == "beside":
                yield SampleDisc(self._reference(band), in_place, reference.offset_mm)
            if target == "mirror":
                yield SampleDisc(self._mirror(band, scene), whole)
            else:
                yield self._sample(band, scene)

    @property
    def _radius(self) -> float:
        """Radius of the sample [mm]."""
        sample, holder = self._world.sample, self._world.truth.holder
        return ((sample and sample.diameter_mm) or holder.sample_diameter_mm) / 2

    def _waves(self, band: Band) -> list[tuple[float, float]]:
        """Wavelengths [nm] at which the sample is looked at, and their shares."""
        sample = self._world.sample
        return _wavelengths(band) if sample is not None and sample.integrate_band else [(band.centre_nm, 1.0)]

    def _through(self, band: Band) -> Iterator[SampleDisc]:
        """What lets light through: the sample alone, point by point without the cones of lamp and lens."""
        model, textures, waves = self._model, self._textures, self._waves(band)
        if model is None:
            return

        def paint(seen: PixelMap, covered: Bools, brdf: Floats) -> None:
            def of(model: models.Model, lit: Bools | tuple[Whole, Whole]) -> Floats:
                at = geometry.Directions.from_vectors(seen.omega_i[lit], seen.omega_r[lit])
                return np.asarray(sum(share * model.btdf(*at.angles, wavelength_nm=wave) for wave, share in waves))

            lit = covered & (seen.omega_i[..., 2] > 0.0)  # a back that is lit is black
            if textures is None:
                brdf[lit] = of(model, lit)
                return
            rows, cols = np.nonzero(lit)
            some = np.linspace(0, max(len(rows) - 1, 0), min(PROBED**2, len(rows))).astype(int)
            for part in textures.parts(seen, lit, lambda one: of(one, (rows[some], cols[some]))[None]):
                brdf[part.rows, part.cols] += part.weight * of(part.model, (part.rows, part.cols))

        yield SampleDisc(paint, self._radius)

    def _straight_through(self, pose: Pose, band: Band) -> Floats32:
        """The holder is empty: pixels whose line of sight meets the lamp see it, blurred by the lens's pupil.

        The lens is focused on the sample's place. From a spot there the lamp and the pupil are caps, as with a mirror.
        """
        description = self._world.optics
        # from the frame of the holder at rest; how it stands there makes no difference
        still = view(description, Pose(light=pose.light, camera=pose.camera, azimuth=pose.azimuth))
        camera, eye, lamp = description.camera, still.camera_mm, still.source_mm
        distance = description.geometry.camera_distance_mm
        seen = pixel_map(description, still)
        sight = seen.sight_lines
        to_lamp = lamp - (eye + distance * sight)  # from where the line of sight crosses the plane in focus
        away = np.linalg.norm(to_lamp, axis=-1)
        sight = sight / np.linalg.norm(sight, axis=-1, keepdims=True)
        apart = np.linalg.norm(to_lamp / away[..., None] - sight, axis=-1)
        shared = _shared_disc(
            apart, *(math.radians(h) for h in (description.lamp.half_angle_deg, camera.lens_half_angle_deg))
        )
        shared = shared * (self._ends.passed * polarised.straight(self._ends, still))
        weight = seen.falloff * (description.geometry.light_distance_mm / away) ** 2
        rate: Floats32 = np.minimum(math.pi * camera.responsivity_e_per_s * weight * shared, BRIGHTEST).astype(
            np.float32
        )
        return self._through_lens(rate, band)

    def _reference(self, band: Band) -> float:
        """The white reference: its certificate times its true error; a table is read at the centre of the frame."""
        reference = self._world.truth.reference
        if reference.table is None:
            return self._world.reference_scale * ((reference.at(band.centre_nm)[0] or 0.0) / math.pi)
        from gonio.lab.reduction.reference_table import brdf_of_reference

        at_centre = directions(self._world.optics, self._world.pose)
        return self._world.reference_scale * brdf_of_reference(self._table, at_centre, band.centre_nm)

    @cached_property
    def _table(self) -> DataFrame:
        """The certificate, where it is a table."""
        from gonio.lab.reduction.reference_table import read

        assert self._world.truth.reference.table is not None
        return read(self._world.truth.reference.table)

    def _sample(self, band: Band, scene: View) -> SampleDisc:
        """The sample: its model's lobe on a grid of nodes, and its spike pixel by pixel."""
        model, radius, waves = self._model, self._radius, self._waves(band)
        if model is None:
            raise ConfigError(
                f'the simulated rig "{self._world.truth.name}" has no sample to look at: name one with --sample S.toml'
            )

        if self._textures is not None:
            return SampleDisc(self._textured(self._textures, waves, scene), radius)
        grid = sample_function(self._lobes(model, scene, waves), radius, self._finest_mm)

        def paint(seen: PixelMap, covered: Bools, brdf: Floats) -> None:
            grid.paint(seen.x_mm, seen.y_mm, (0.0, 0.0), radius, brdf)
            if model.has_spike:
                self._paint_spike(model, waves, seen, scene, covered, brdf)

        return SampleDisc(paint, radius)

    def _lobes(self, model: models.Model, scene: View, waves: list[tuple[float, float]]) -> Function:
        """A model's lobe [1/sr] over the sample, averaged over the cones of lamp and lens."""
        ends = self._ends

        def lobes(x: Floats, y: Floats) -> Floats:
            at = _directions_at(scene, x, y)
            out = np.zeros(x.shape)
            for wave, share in waves:

                def lobe(one: models.Model, wave: float = wave) -> Floats:
                    seen = instrument.apparent_lobe(
                        one, *at.angles, wavelength_nm=wave, tolerance=instrument.LOBE_TOLERANCE, **self._cones
                    )
                    return np.asarray(seen)

                out += share * (lobe(model) if ends.plain else polarised.of_lobe(ends, model, lobe, scene, at, wave))
            return out

        return lobes

    def _textured(self, textures: Textures | Plate, waves: list[tuple[float, float]], scene: View) -> Painter:
        """The sample with textures or regions: as one model, level by level of these."""
        radius = self._radius

        def paint(seen: PixelMap, covered: Bools, brdf: Floats) -> None:
            x, y = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(-radius, radius, PROBED)]))

            def probe(model: models.Model) -> Floats:
                values = [self._lobes(model, scene, waves)(x, y)]
                if model.has_spike:
                    theta = _directions_at(scene, x, y).theta_i
                    spikes = (share * model.specular_reflectivity(theta, wavelength_nm=nm) for nm, share in waves)
                    values.append(sum(spikes))
                return np.stack(values)

            brdf[covered] = 0.0
            for part in textures.parts(seen, covered, probe):
                at = part.rows, part.cols
                grid = sample_function(self._lobes(part.model, scene, waves), radius, self._finest_mm)
                brdf[at] += part.weight * grid.at(seen.x_mm[at], seen.y_mm[at])
                if part.model.has_spike:
                    own, spike = np.zeros(covered.shape, dtype=bool), np.zeros(covered.shape)
                    own[at] = True
                    self._paint_spike(part.model, waves, seen, scene, own, spike)
                    brdf[at] += part.weight * spike[at]

        return paint

    def _edge(self, band: Band) -> Painter:
        """The white reference behind a black screen that ends with a knife edge at x = 0, and covers x > 0."""
        white = self._reference(band)

        def paint(seen: PixelMap, covered: Bools, brdf: Floats) -> None:
            brdf[covered] = np.where(seen.x_mm[covered] > 0.0, 0.0, white)

        return paint

    def _mirror(self, band: Band, scene: View) -> Painter:
        """A front-surface mirror, perfectly smooth aluminium, which shows the lamp and nothing else."""
        mirror = models.build("he-torrance", {"sigma0_um": 0.0, "tau_um": 1.0, "ior": "Al"})

        def paint(seen: PixelMap, covered: Bools, brdf: Floats) -> None:
            brdf[covered] = 0.0
            self._paint_spike(mirror, [(band.centre_nm, 1.0)], seen, scene, covered, brdf)

        return paint

    def _paint_spike(
        self, model: models.Model, waves: list[tuple[float, float]], seen: PixelMap, scene: View, covered: Bools,
        brdf: Floats,
    ) -> None:  # fmt: skip
        """Add the mirror image of the lamp, pixel by pixel where it is seen."""
        reach, radius = self._spike_reach, max(self._radius, self._world.truth.holder.sample_diameter_mm / 2)
        if _apart(scene, np.zeros(1), np.zeros(1))[0] > reach + radius * self._turn:
            return  # no spot of the disc shows the lamp's mirror image to the lens
        rows, cols = np.nonzero(covered)
        near = _apart(scene, seen.x_mm[rows, cols], seen.y_mm[rows, cols]) <= reach
        rows, cols = rows[near], cols[near]
        at = _directions_at(scene, seen.x_mm[rows, cols], seen.y_mm[rows, cols])
        for wave, share in waves:
            spike = instrument.apparent_spike(model, *at.angles, wavelength_nm=wave, spike="exact", **self._cones)
            if not self._ends.plain:
                spike = spike * polarised.of_spike(self._ends, model, scene, at, wave)
            brdf[rows, cols] += share * spike


def _paint_fiducials(holder: Holder, marks: Fiducials, seen: PixelMap, brdf: Floats) -> None:
    """The markers around the aperture: each pixel takes the mean over its own area on the plate, `FINER` squared spots.

    Without that their edges would lie on whole pixels, and corners a third of a pixel off.
    """
    x, y = seen.x_mm, seen.y_mm
    radius = np.hypot(x, y)
    reach = (0.5 + fiducials.RIM) * math.sqrt(2.0) * marks.marker_mm
    rows, cols = np.nonzero(np.abs(radius - marks.ring_mm) <= 1.2 * reach)
    if not len(rows):
        return
    part = (np.arange(FINER) + 0.5) / FINER - 0.5
    slopes = [np.nan_to_num(np.gradient(each, axis=axis)[rows, cols]) for each in (x, y) for axis in (1, 0)]
    white, bare = np.zeros(len(rows)), np.zeros(len(rows))
    x, y = x[rows, cols], y[rows, cols]
    for across in part:
        for down in part:
            here = fiducials.white(
                marks,
                x + across * slopes[0] + down * slopes[1],
                y + across * slopes[2] + down * slopes[3],
            )
            white += here == 1
            bare += here == -1
    printed = bare < FINER**2
    share = white[printed] / FINER**2
    value = (share * marks.albedo + (1.0 - share) * holder.holder_albedo) / math.pi
    brdf[rows[printed], cols[printed]] = value


def _shared_disc(apart: Floats, lamp: float, pupil: float) -> Floats:
    """Solid angle that two small caps [rad] share over the product of both [1/sr]; two directions see nothing."""
    large = max(lamp, pupil)
    if large == 0.0:
        return np.zeros(apart.shape)
    return geometry.overlap_of_discs(apart, lamp, pupil) / (math.pi * large**2)


def _apart(scene: View, x: Floats, y: Floats) -> Floats:
    """Chord between the direction to the camera and the mirrored direction to the source, at spots of the plane."""
    (sx, sy, sz), (cx, cy, cz) = scene.source_mm, scene.camera_mm
    to_source = np.sqrt((sx - x) ** 2 + (sy - y) ** 2 + sz**2)
    to_camera = np.sqrt((cx - x) ** 2 + (cy - y) ** 2 + cz**2)
    across = ((cx - x) / to_camera + (sx - x) / to_source) ** 2 + ((cy - y) / to_camera + (sy - y) / to_source) ** 2
    chord: Floats = np.sqrt(across + (cz / to_camera - sz / to_source) ** 2)
    return chord


def _directions_at(scene: View, x: Floats, y: Floats) -> geometry.Directions:
    """Where source and camera are, seen from spots of the sample's plane; at most `GRAZING`."""
    spots = np.stack([x, y, np.zeros_like(x)], axis=-1)
    d = geometry.Directions.from_vectors(scene.source_mm - spots, scene.camera_mm - spots)
    return geometry.Directions(np.minimum(d.theta_i, GRAZING), d.phi_i, np.minimum(d.theta_r, GRAZING), d.phi_r)


def _wavelengths(band: Band) -> list[tuple[float, float]]:
    """Wavelengths [nm] and shares of the integral over a band of Gaussian shape: Gauss-Hermite quadrature."""
    at, weights = np.polynomial.hermite.hermgauss(BAND_NODES)
    sigma = band.fwhm_nm / (2.0 * math.sqrt(2.0 * math.log(2.0)))
    shares = weights / math.sqrt(math.pi)
    return [(band.centre_nm + math.sqrt(2.0) * sigma * float(t), float(w)) for t, w in zip(at, shares, strict=True)]


def _changing(sample: SampleDescription) -> Textures | Plate | None:
    """What changes over the sample; None where nothing does."""
    return Plate(sample) if sample.region else Textures(sample) if sample.texture else None


def _build(sample: SampleDescription) -> models.Model:
    try:
        return models.build(sample.model, dict(sample.parameters))
    except ConfigError as error:
        raise ConfigError(f'sample "{sample.name}", [parameters]: {error}') from error
