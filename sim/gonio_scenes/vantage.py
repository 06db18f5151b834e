"""What a place of a picture sees: directions in the surface's frame and irradiance, as described or displaced."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import angle_between
from gonio.typing import Bools, Floats
from gonio_scenes.camera import SceneCamera
from gonio_scenes.lights import Directional, DiscLight, Light, PointLight
from gonio_scenes.scene import UncertaintyTable
from gonio_scenes.shapes import AnyShape, Shape
from gonio_scenes.world import Hits, SceneShapes

DISC_POINTS = 64
"""Points of a disc that its irradiance is the mean of: 1e-4 of it, for a disc of 10 degrees."""
RIM_POINTS = 16
"""Points of a disc's edge that have to be above the horizon and in sight."""


@dataclass(frozen=True)
class Seen:
    """What rays meet of one shape, under one light. Arrays are of the rays' length, NaN where the shape is missed."""

    met: Bools
    omega_i: Floats
    """Unit vectors (n, 3) toward the light's centre, in the surface's frame."""
    omega_r: Floats
    received: Floats
    """Irradiance on the surface."""
    normal: Floats
    """(n, 3): the surface's normal in the frame of h = (omega_i + omega_r)/|..|, d = (omega_i - omega_r)/|..|, h x d.
    Where it and `difference` agree, an isotropic BRDF is the same."""
    difference: Floats
    """Half of the angle between light and viewer [rad]."""


@dataclass(frozen=True)
class Vantage:
    """A camera, a shape and a light, each where it is taken to be."""

    camera: SceneCamera
    light: Light
    shape: Shape
    shift: Floats
    """Shift of the shape beside its described place [mm]."""

    def at(self, column: Floats, row: Floats) -> Seen:
        """What places of the picture see; 0 is the picture's left and upper edge."""
        origin, direction = self.camera.through(column, row)
        hits = SceneShapes([self.shape], self.camera.position).hit(origin - self.shift, direction)
        return self.of(hits, direction)

    def of(self, hits: Hits, direction: Floats) -> Seen:
        """The same of hits that are known, of rays in these directions."""
        met = hits.shape >= 0
        position = hits.position + self.shift
        side = np.cross(hits.facing, hits.tangent)
        axes = np.stack([hits.tangent, side, hits.facing], axis=1)
        light = np.broadcast_to(self.light.arrive(position, 0, None).direction, position.shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            half, across = light - direction, light + direction
            h, d = (v / np.linalg.norm(v, axis=1)[:, None] for v in (half, across))
            frame = np.stack([h, d, np.cross(h, d)], axis=1)
            out = Seen(
                met=met,
                omega_i=np.einsum("ijk,ik->ij", axes, light),
                omega_r=np.einsum("ijk,ik->ij", axes, -direction),
                received=self.received(position, hits.facing),
                normal=np.einsum("ijk,ik->ij", frame, hits.facing),
                difference=0.5 * angle_between(light, -direction),
            )
        for array in (out.omega_i, out.omega_r, out.received, out.normal, out.difference):
            array[~met] = np.nan
        return out

    def received(self, position: Floats, normal: Floats) -> Floats:
        """Irradiance on the surface, shadows left aside."""
        soft = isinstance(self.light, DiscLight)
        still = np.zeros((len(position), 2)) if soft else None
        out = np.zeros(len(position))
        count = DISC_POINTS if soft else 1
        for sample in range(count):
            arriving = self.light.arrive(position, sample, still)
            cosine = np.einsum("ij,ij->i", np.broadcast_to(arriving.direction, normal.shape), normal)
            out += np.maximum(cosine, 0.0) * arriving.strength
        return np.asarray(out * float(self.light.power[0]) / count)

    def edges(self, position: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Unit vectors (n, 3) toward the light's centre and the points of its edge, and their distances (n,)."""
        away = self.light.arrive(position, 0, None)
        yield np.broadcast_to(away.direction, position.shape), np.broadcast_to(away.distance, len(position))
        if not isinstance(self.light, DiscLight):
            return
        first, second = _across(self.light.normal)
        for angle in np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False):
            point = self.light.center + self.light.radius * (math.cos(angle) * first + math.sin(angle) * second)
            to = point - position
            distance = np.linalg.norm(to, axis=1)
            yield to / distance[:, None], distance

    def half_angles(self, position: Floats) -> tuple[Floats, float]:
        """Half-angles [rad] that the light (at each position) and the lens (at their middle) are seen under."""
        light = np.zeros(len(position))
        if isinstance(self.light, DiscLight):
            light = np.arctan(self.light.radius / np.linalg.norm(self.light.center - position, axis=1))
        middle = position.mean(axis=0)
        return light, math.atan(self.camera.lens_radius / float(np.linalg.norm(self.camera.position - middle)))


def displaced(
    vantage: Vantage, table: AnyShape, folder: Path, given: UncertaintyTable
) -> dict[str, tuple[Vantage, Vantage]]:
    """Cause -> the vantage with it one standard deviation above what is described, and below.

    Raises
    ------
    ConfigError
        An uncertainty belongs to what the scene has not.
    """
    out: dict[str, tuple[Vantage, Vantage]] = {}
    camera, light = vantage.camera, vantage.light
    if isinstance(light, Directional):
        _refuse(given.light_mm, "light_mm", "the light is directional: give light_deg")
        if given.light_deg:
            for k, axis in enumerate(_across(light.toward)):
                turned = [light.toward + math.radians(sign * given.light_deg) * axis for sign in (1, -1)]
                both = (replace(light, toward=v / np.linalg.norm(v)) for v in turned)
                out[f"light_{k + 1}"] = _pair(replace(vantage, light=moved) for moved in both)
    else:
        _refuse(given.light_deg, "light_deg", "the light has a place: give light_mm")
        place = "position" if isinstance(light, PointLight) else "center"
        for name, step in _along("light", given.light_mm):
            places = (getattr(light, place) + sign * step for sign in (1, -1))
            out[name] = _pair(replace(vantage, light=replace(light, **{place: at})) for at in places)
    for name, step in _along("center", given.center_mm):
        out[name] = _pair(replace(vantage, shift=vantage.shift + sign * step) for sign in (1, -1))
    if given.radius_mm:
        radius = getattr(table, "radius_mm", None)
        if radius is None:
            _refuse(given.radius_mm, "radius_mm", f'a shape of the kind "{table.kind}" has no radius: leave it out')
        assert radius is not None
        if given.radius_mm >= radius:
            raise ConfigError(f"photograph.uncertainty.radius_mm = {given.radius_mm:g}: the radius is {radius:g} mm")
        sizes = (table.model_copy(update={"radius_mm": radius + sign * given.radius_mm}) for sign in (1, -1))
        out["radius"] = _pair(replace(vantage, shape=size.build(folder)) for size in sizes)
    for name, step in _along("camera", given.camera_mm):
        out[name] = _pair(
            replace(vantage, camera=replace(camera, position=camera.position + sign * step)) for sign in (1, -1)
        )
    turns = (("pan", given.pointing_deg, "forward", "right"), ("tilt", given.pointing_deg, "forward", "down"))
    for name, degrees, one, other in (*turns, ("roll", given.roll_deg, "right", "down")):
        if degrees:
            out[f"camera_{name}"] = _pair(
                replace(vantage, camera=_turned(camera, one, other, math.radians(sign * degrees))) for sign in (1, -1)
            )
    if given.field_rel:
        steps = (camera.step * (1.0 + sign * given.field_rel) for sign in (1, -1))
        out["field"] = _pair(replace(vantage, camera=replace(camera, step=step)) for step in steps)
    return out


def _refuse(value: float, key: str, why: str) -> None:
    if value:
        raise ConfigError(f"photograph.uncertainty.{key} = {value:g}: {why}")


def _along(name: str, size: float) -> Iterator[tuple[str, Floats]]:
    if size:
        for axis, letter in zip(np.eye(3), "xyz", strict=True):
            yield f"{name}_{letter}", size * axis


def _pair(both: Iterator[Vantage]) -> tuple[Vantage, Vantage]:
    plus, minus = both
    return plus, minus


def _turned(camera: SceneCamera, one: str, other: str, angle: float) -> SceneCamera:
    """The camera turned by an angle, from one of its axes toward another."""
    a, b = getattr(camera, one), getattr(camera, other)
    c, s = math.cos(angle), math.sin(angle)
    return replace(camera, **{one: c * a + s * b, other: c * b - s * a})


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors across an axis and each other; the first is level (across y) where there is one."""
    first = np.cross((0.0, 1.0, 0.0), axis)
    if np.linalg.norm(first) < 1e-6:
        first = np.array([1.0, 0.0, 0.0])
    first = first - (first @ axis) * axis / (axis @ axis)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return first, second / np.linalg.norm(second)
