"""From rays to radiances: direct light, ambient light, and mirror rays (He et al. 1991, eq. 12)."""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_scenes.lights import Disc
from gonio_scenes.material import Material
from gonio_scenes.scene import Scene
from gonio_scenes.world import Hits

FAINT = 1e-9
"""A mirror ray that carries less than this share of what it sees is not followed."""

Indices = npt.NDArray[np.int64]


class Integrator:
    """The radiances of a scene along rays; it counts the rays that it needs.

    Parameters
    ----------
    scene
        The scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.rays: Counter[str] = Counter()
        """How many rays were followed: from the camera, as mirror rays, toward lights."""
        self._discs = [light for light in scene.lights if isinstance(light, Disc)]
        to_see = scene.world.casts_shadows or bool(self._discs) or scene.ambient is not None
        self._mirrors = to_see and any(material.has_spike for material in scene.material)
        self._axis = _polariser(scene)
        """Of the polariser before the camera, in the scene."""
        self._any_seen = any(disc.visible for disc in self._discs)

    def radiance(self, origin: Floats, direction: Floats, random: np.random.Generator | None) -> tuple[Floats, Hits]:
        """Radiances (n, wavelengths) that come back along rays, and what the rays met.

        `random` moves the points of discs of light; without it each light is seen from one direction, its centre's.
        """
        scene = self.scene
        out = np.zeros((direction.shape[0], scene.wavelength_nm.size))
        self.rays["camera"] += direction.shape[0]
        first = hits = scene.world.hit(origin, direction)
        past = None if self._axis is None else np.full((direction.shape[0], 1), 0.5)  # unpolarised light
        self._beyond(out, None, past, origin, direction, hits, mirrored=False)
        where: Indices | None = None  # of the ray in `out`, and None where they are all there
        weight: Floats | None = None
        for depth in range(scene.mirror_depth + 1):
            met = np.flatnonzero(hits.shape >= 0)
            if met.size == 0:
                break
            whole = met.size == hits.shape.size
            hits = hits if whole else hits.at(met)
            direction = direction if whole else direction[met]
            where = (met if where is None else where[met]) if not whole else where
            weight = weight if weight is None or whole else weight[met]
            axis = self._axis if depth == 0 else None
            light = self._lit(hits, direction, random, axis)
            _add(out, where, light if weight is None else weight * light)
            if not self._mirrors:
                break
            mirrored = self._mirror(hits, direction, weight, axis)
            if mirrored is None:
                break
            kept, weight, toward = mirrored
            where = kept if where is None else where[kept]
            if depth == scene.mirror_depth:
                if scene.ambient is not None:
                    _add(out, where, weight * scene.ambient)
                self.rays["cut"] += kept.size
                break
            origin, direction, leaving = hits.position[kept], toward, hits.at(kept)
            self.rays["mirror"] += kept.size
            hits = scene.world.hit(origin, direction, leaving)
            self._beyond(out, where, weight, origin, direction, hits, mirrored=True)
        return out, first

    # --- what rays see where no shape is ----------------------------------------------------------------------------

    def _beyond(
        self,
        out: Floats,
        where: Indices | None,
        weight: Floats | None,
        origin: Floats,
        direction: Floats,
        hits: Hits,
        mirrored: bool,
    ) -> None:
        """Add the ambient light that rays see past all shapes, and the discs of light before what they meet."""
        ambient = self.scene.ambient
        free = hits.shape < 0
        if mirrored or self._any_seen:
            seen = [disc for disc in self._discs if mirrored or disc.visible]
            for disc, here in _nearest(seen, origin, direction, np.where(free, np.inf, hits.distance)):
                free[here] = False
                light = disc.power * (np.ones((here.size, 1)) if weight is None else weight[here])
                _add(out, here if where is None else where[here], light)
        if ambient is not None and free.any():
            here = np.flatnonzero(free)
            _add(out, here if where is None else where[here], ambient * (1.0 if weight is None else weight[here]))

    # --- what surfaces send back ------------------------------------------------------------------------------------

    def _lit(
        self, hits: Hits, direction: Floats, random: np.random.Generator | None, axis: Floats | None
    ) -> Floats:
        """Radiances (n, wavelengths) of hits toward where their rays came from, mirror rays left out."""
        scene = self.scene
        out = np.zeros((hits.shape.size, scene.wavelength_nm.size))
        side = np.cross(hits.facing, hits.tangent)
        view = _local(-direction, hits, side)
        for light in scene.lights:
            shift = random.random((hits.shape.size, 2)) if random is not None and light.samples > 1 else None
            count = light.samples if shift is not None else 1
            for sample in range(count):
                arriving = light.arrive(hits.position, sample, shift)
                cosine = np.einsum("ij,ij->i", arriving.direction, hits.facing)
                # the facet itself must be lit too: a smoothed normal alone would let light through
                lit = (cosine > 0.0) & (view[:, 2] > 0.0) & (np.asarray(arriving.strength) > 0.0)
                if not lit.any():
                    continue
                here = np.flatnonzero(lit)
                if scene.world.casts_shadows:
                    far = arriving.distance[here] if isinstance(arriving.distance, np.ndarray) else arriving.distance
                    self.rays["shadow"] += here.size
                    free = ~scene.world.blocked(arriving.direction[here], far, hits.at(here))
                    here = here[free]
                    if here.size == 0:
                        continue
                strength = arriving.strength[here] if isinstance(arriving.strength, np.ndarray) else arriving.strength
                irradiance = cosine[here] * strength / count
                towards = _local(arriving.direction[here], hits.at(here), side[here])
                for material, part in self._by_material(hits, here):
                    at = here[part]
                    if light.polarisation is None and axis is None:
                        f = material.brdf(towards[part], view[at], hits.uv[at])
                    else:
                        of_light, of_camera = (
                            None if a is None else _local(np.broadcast_to(a, (at.size, 3)), hits.at(at), side[at])
                            for a in (light.polarisation, axis)
                        )
                        f = material.polarised(towards[part], view[at], hits.uv[at], of_light, of_camera)
                    _add(out, here[part], f * irradiance[part, None] * light.power)
        if scene.ambient is not None:
            everywhere = np.arange(hits.shape.size)
            for material, part in self._by_material(hits, everywhere):
                share = 1.0 if axis is None else 0.5  # of light that is taken as unpolarised
                out[part] += share * material.ambient(view[part, 2], hits.uv[part]) * scene.ambient
        return out

    def _mirror(
        self, hits: Hits, direction: Floats, weight: Floats | None, axis: Floats | None
    ) -> tuple[Indices, Floats, Floats] | None:
        """The mirror rays that carry something: which hits they leave, with what weight, in what direction."""
        cosine = -np.einsum("ij,ij->i", direction, hits.facing)
        carried = np.zeros((hits.shape.size, self.scene.wavelength_nm.size))
        for material, part in self._by_material(hits, np.arange(hits.shape.size)):
            if not material.has_spike:
                continue
            if axis is None:
                carried[part] = material.specular(cosine[part], hits.uv[part])
            else:
                at = hits.at(part)
                side = np.cross(at.facing, at.tangent)
                view, passing = (_local(v, at, side) for v in (-direction[part], np.broadcast_to(axis, (part.size, 3))))
                carried[part] = material.polarised_specular(view, at.uv, passing)
        if weight is not None:
            carried *= weight
        kept = np.flatnonzero(carried.max(axis=1) > FAINT)
        if kept.size == 0:
            return None
        mirrored = direction[kept] + 2.0 * cosine[kept, None] * hits.facing[kept]
        return kept, carried[kept], mirrored / np.linalg.norm(mirrored, axis=1)[:, None]

    def _by_material(self, hits: Hits, here: Indices) -> list[tuple[Material, Indices]]:
        """The hits `here` by material: positions in `here`."""
        scene = self.scene
        if len(set(map(id, scene.material))) == 1:
            return [(scene.material[0], np.arange(here.size))]
        groups: dict[int, tuple[Material, list[int]]] = {}
        for k, material in enumerate(scene.material):
            groups.setdefault(id(material), (material, []))[1].append(k)
        out: list[tuple[Material, Indices]] = []
        for material, shapes in groups.values():
            part = np.flatnonzero(np.isin(hits.shape[here], shapes))
            if part.size:
                out.append((material, part))
        return out


def _polariser(scene: Scene) -> Floats | None:
    """The axis of the polariser before the camera, a unit vector of the scene."""
    if scene.polariser_deg is None:
        return None
    angle = np.deg2rad(scene.polariser_deg)
    return np.asarray(np.cos(angle) * scene.camera.right - np.sin(angle) * scene.camera.down)


def _nearest(discs: list[Disc], origin: Floats, direction: Floats, nearest: Floats) -> list[tuple[Disc, Indices]]:
    """The rays that see each disc before anything else."""
    which = np.full(nearest.shape, -1)
    for k, disc in enumerate(discs):
        distance = disc.seen(origin, direction)
        which[distance < nearest] = k
        nearest = np.minimum(nearest, distance)
    return [(disc, np.flatnonzero(which == k)) for k, disc in enumerate(discs)]


def _add(out: Floats, where: Indices | None, values: Floats) -> None:
    """Add to the rows `where`, which are all different; None for all rows."""
    if where is None:
        out += values
    else:
        out[where] += values


def _local(direction: Floats, hits: Hits, side: Floats) -> Floats:
    """Unit vectors in the frame of the surface: x its tangent, z its normal."""
    out = np.stack([np.einsum("ij,ij->i", direction, axis) for axis in (hits.tangent, side, hits.facing)], axis=1)
    # a vector within rounding of the surface stays of unit length
    return np.asarray(out)
