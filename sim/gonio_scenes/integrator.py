"""From rays to radiances: direct light, ambient light, and mirror rays (He et al. 1991, eq. 12)."""

from collections import Counter

import numpy as np

from gonio.typing import Bools, Floats, NDArray
from gonio_scenes.lights import DiscLight
from gonio_scenes.material import SceneMaterial
from gonio_scenes.scene import Scene
from gonio_scenes.world import Hits, local

FAINT = 1e-9
"""A mirror ray that carries less than this share of what it sees is not followed."""

Indices = NDArray[np.int64]


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
        self._discs = [light for light in scene.lights if isinstance(light, DiscLight)]
        to_see = scene.world.casts_shadows or bool(self._discs) or scene.ambient is not None
        self._mirrors = to_see and any(material.has_spike for material in scene.material)
        self._one_material = len(set(map(id, scene.material))) == 1
        self._any_seen = any(disc.visible for disc in self._discs)

    def radiance(
        self, origin: Floats, direction: Floats, random: np.random.Generator | None, only: Bools | None = None
    ) -> tuple[Floats, Hits]:
        """Radiances (n, wavelengths) that come back along rays, and what the rays met.

        `random` moves the points of discs of light; without it each light is seen from one direction, its centre's.
        Where `only` is false no lamp's light is computed, and the radiance counts for nothing.
        """
        scene = self.scene
        out = np.zeros((direction.shape[0], scene.wavelength_nm.size))
        self.rays["camera"] += direction.shape[0]
        first = hits = scene.world.hit(origin, direction)
        self._beyond(out, None, None, origin, direction, hits, mirrored=False)
        where: Indices | None = None  # of the ray in `out`, and None where they are all there
        weight: Floats | None = None
        for depth in range(scene.mirror_depth + 1):
            met = np.flatnonzero(hits.shape >= 0)
            if met.size == 0:
                break
            whole = met.size == hits.shape.size
            hits = hits if whole else hits.picked(met)
            direction = direction if whole else direction.take(met, axis=0)
            only = only if whole or only is None else only[met]
            where = (met if where is None else where[met]) if not whole else where
            weight = weight if weight is None or whole else weight[met]
            light = self._lit(hits, direction, random, only)
            _add(out, where, light if weight is None else weight * light)
            if not self._mirrors:
                break
            mirrored = self._mirror(hits, direction, weight)
            if mirrored is None:
                break
            kept, weight, toward = mirrored
            where = kept if where is None else where[kept]
            only = only if only is None else only[kept]
            if depth == scene.mirror_depth:
                if scene.ambient is not None:
                    _add(out, where, weight * scene.ambient)
                self.rays["cut"] += kept.size
                break
            origin, direction, leaving = hits.position[kept], toward, hits.picked(kept)
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
        self, hits: Hits, direction: Floats, random: np.random.Generator | None, only: Bools | None = None
    ) -> Floats:
        """Radiances (n, wavelengths) of hits toward where their rays came from, mirror rays left out."""
        scene = self.scene
        out = np.zeros((hits.shape.size, scene.wavelength_nm.size))
        view = local(direction, hits.facing, hits.tangent, -1.0)
        for light in scene.lights:
            shift = random.random((hits.shape.size, 2)) if random is not None and isinstance(light, DiscLight) else None
            count = light.samples if shift is not None else 1
            for sample in range(count):
                arriving = light.arrive(hits.position, sample, shift)
                towards = local(arriving.direction, hits.facing, hits.tangent)
                here = np.flatnonzero((towards[:, 2] > 0.0) & (view[:, 2] > 0.0) & (arriving.strength > 0.0))
                here = here if only is None else here[only[here]]
                here = here[_lights_facet(arriving.direction, hits, here)]
                if scene.world.casts_shadows and here.size:
                    self.rays["shadow"] += here.size
                    here = here[~scene.world.blocked(arriving.direction, arriving.distance, hits, here)]
                irradiance = towards[:, 2] * arriving.strength / count
                for material, at in self._by_material(hits, here):
                    omega_i, omega_r, uv = (a.take(at, axis=0) for a in (towards, view, hits.uv))
                    if light.polarisation is None:
                        f = material.brdf(omega_i, omega_r, uv)
                    else:
                        field = local(light.polarisation, hits.facing[at], hits.tangent[at])
                        f = material.polarised(omega_i, omega_r, uv, field)
                    _add(out, at, f * irradiance[at, None] * light.power)
        if scene.ambient is not None:
            for material, at in self._by_material(hits, np.arange(hits.shape.size)):
                _add(out, at, material.ambient(view[at], hits.uv[at]) * scene.ambient)
        return out

    def _mirror(self, hits: Hits, direction: Floats, weight: Floats | None) -> tuple[Indices, Floats, Floats] | None:
        """The mirror rays that carry something: which hits they leave, with what weight, in what direction."""
        cosine = -np.einsum("ij,ij->i", direction, hits.facing)
        carried = np.zeros((hits.shape.size, self.scene.wavelength_nm.size))
        for material, part in self._by_material(hits, np.arange(hits.shape.size)):
            if material.has_spike:
                carried[part] = material.specular(cosine[part], hits.uv[part])
        if weight is not None:
            carried *= weight
        kept = np.flatnonzero(carried.max(axis=1) > FAINT)
        if kept.size == 0:
            return None
        mirrored = direction[kept] + 2.0 * cosine[kept, None] * hits.facing[kept]
        return kept, carried[kept], mirrored / np.linalg.norm(mirrored, axis=1)[:, None]

    def _by_material(self, hits: Hits, here: Indices) -> list[tuple[SceneMaterial, Indices]]:
        """The hits `here`, those of each material together."""
        if self._one_material:
            return [(self.scene.material[0], here)] if here.size else []
        groups: dict[int, tuple[SceneMaterial, list[int]]] = {}
        for k, material in enumerate(self.scene.material):
            groups.setdefault(id(material), (material, []))[1].append(k)
        parts = [(material, here[np.isin(hits.shape[here], shapes)]) for material, shapes in groups.values()]
        return [(material, part) for material, part in parts if part.size]


def _lights_facet(direction: Floats, hits: Hits, here: Indices) -> Bools:
    """Whether light comes to the side of the surface that is seen; a smoothed normal alone would let light through."""
    toward, normal, facing = (a.take(here, axis=0) if a.ndim == 2 else a for a in (direction, hits.normal, hits.facing))
    # on a surface that is not smoothed this asks for n.l > 0 once more, which rounding must not tell the other way
    return np.asarray(
        (normal @ toward if toward.ndim == 1 else np.einsum("ij,ij->i", normal, toward))
        * np.einsum("ij,ij->i", normal, facing)
        > -1e-12
    )


def _nearest(
    discs: list[DiscLight], origin: Floats, direction: Floats, nearest: Floats
) -> list[tuple[DiscLight, Indices]]:
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
