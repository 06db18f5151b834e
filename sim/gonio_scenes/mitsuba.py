"""The same scene for Mitsuba 3: native shapes, lights and plug-ins, and a file of slices for every other material.

Three wavelengths go into one XML file, as the three channels of Mitsuba's RGB variants, which mix nothing: a channel is
a wavelength. A single wavelength fills all three alike, so that the variants for one wavelength (`*_mono`) read it too.
Mitsuba's spectral variants draw wavelengths at random and interpolate between them; nothing is left to compare then.

What the two renderers compute alike is direct light. `Export.left_out` names what a file cannot carry.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from gonio import __version__
from gonio.disk import require_own, write_own
from gonio.errors import ConfigError
from gonio.formats import rgl
from gonio.models import HeTorrance, Lambert
from gonio.models.parameters import index_at
from gonio.typing import Floats
from gonio_scenes.lights import AmbientTable, Directional, Disc, PointLight
from gonio_scenes.material import Material
from gonio_scenes.scene import Scene
from gonio_scenes.shapes import Shape
from gonio_scenes.shapes.shape import Analytic, Placement

CHANNELS = 3
GRID = 64
"""Rays across the picture, and down it, that say how far the scene reaches."""
LARGEST_MM = 1e5
"""Half the width of what stands for a plane without end, at most: Mitsuba's float32 places it to 6e-8 of that."""
TURN = 720
"""Facets around a cylinder or a surface of revolution; shaded with its own normals. They lie up to 1e-5 of the radius
inside it, 1 - cos(pi / TURN). Mitsuba's own cylinder was seen to shadow itself, and warns where it is tilted."""


@runtime_checkable
class _Triangular(Protocol):
    """A shape of triangles: vertices (n, 3), faces (m, 3), and normals at the corners where it is smooth."""

    vertices: Floats
    faces: npt.NDArray[Any]
    normals: Any


@dataclass(frozen=True)
class Export:
    """A scene as files for Mitsuba 3."""

    files: dict[str, bytes]
    scenes: dict[str, tuple[float, ...]]
    """The wavelengths [nm] of the channels of each XML file: three, or one that all channels hold."""
    materials: dict[str, str]
    """The plug-in of each material."""
    left_out: tuple[dict[str, str], ...]
    """What the files do not carry, or carry otherwise, and why."""


def export(scene: Scene, *, nodes: int = 128, incidences: int = 64) -> Export:
    """A scene as files for Mitsuba 3; nothing is written.

    Parameters
    ----------
    scene
        The scene.
    nodes, incidences
        Of the files of slices, see `gonio.formats.rgl.sliced`.

    Raises
    ------
    ConfigError
        A material depends on the azimuth of its surface, or a shape has no counterpart; the message names it.
    """
    return _Writer(scene, nodes, incidences).export()


def write(scene: Scene, out: Path, command: str = "") -> Export:
    """Write a scene for Mitsuba 3 into a folder: XML, the files that it names, and summary.json.

    Raises
    ------
    ConfigError
        As `export`; or the folder cannot be written, or holds files of the same name that somebody else made.
    """
    require_own(out, ["summary.json"])
    made = export(scene)
    summary = {
        "name": scene.name,
        "gonio": __version__,
        "command": command,
        "scenes": {name: list(waves) for name, waves in made.scenes.items()},
        "materials": made.materials,
        "left_out": list(made.left_out),
    }
    files = made.files | {"summary.json": (json.dumps(summary, indent=2) + "\n").encode()}
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_own(out, files)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}") from None
    return made


class _Writer:
    def __init__(self, scene: Scene, nodes: int, incidences: int) -> None:
        self.scene = scene
        self.nodes, self.incidences = nodes, incidences
        self.files: dict[str, bytes] = {}
        self.left_out: list[dict[str, str]] = []
        self.names = list(dict.fromkeys(table.material for table in scene.tables.shape))
        self.near, self.far, self.reach = _extent(scene)

    def export(self) -> Export:
        waves = self.scene.wavelength_nm.size
        groups = [list(range(k, min(k + CHANNELS, waves))) for k in range(0, waves, CHANNELS)]
        meshes = self._meshes()
        materials = self._materials()
        native = {name: self._native(material) for name, material in materials.items()}
        for name, material in materials.items():
            self._say_of_material(name, material, native[name])
        scenes = {}
        for group in groups:
            # the channels that are left over hold the last wavelength once more
            channels = (group + [group[-1]] * CHANNELS)[:CHANNELS]
            shown = tuple(float(self.scene.wavelength_nm[k]) for k in group)
            suffix = "" if len(groups) == 1 else "-" + "-".join(f"{wave:g}" for wave in shown) + "nm"
            root = ElementTree.Element("scene", version="3.0.0")
            self._frame(root)
            for name, material in materials.items():
                self._bsdf(root, name, material, native[name], channels, suffix)
            for k in range(len(self.scene.world.shapes)):
                self._shape(root, k, meshes)
            self._lights(root, channels)
            ElementTree.indent(root)
            scenes[f"scene{suffix}.xml"] = shown
            self.files[f"scene{suffix}.xml"] = ElementTree.tostring(root) + b"\n"
        self._say_of_scene()
        plugins = {name: found or "measured" for name, found in native.items()}
        return Export(self.files, scenes, plugins, tuple(self.left_out))

    def _say(self, what: str, why: str) -> None:
        self.left_out.append({"what": what, "why": why})

    # --- integrator and camera --------------------------------------------------------------------------------------

    def _frame(self, root: ElementTree.Element) -> None:
        scene, camera = self.scene, self.scene.camera
        integrator = _add(root, "integrator", "direct")
        _put(integrator, "boolean", "hide_emitters", "true" if self._hidden() else "false")
        sensor = _add(root, "sensor", "thinlens" if camera.lens_radius > 0 else "perspective")
        _put(sensor, "float", "fov", 2.0 * math.degrees(math.atan(camera.step * camera.height / 2.0)))
        _put(sensor, "string", "fov_axis", "y")
        _put(sensor, "float", "near_clip", self.near)
        _put(sensor, "float", "far_clip", self.far)
        if camera.lens_radius > 0:
            _put(sensor, "float", "aperture_radius", camera.lens_radius)
            _put(sensor, "float", "focus_distance", camera.focus)
        transform = ElementTree.SubElement(sensor, "transform", name="to_world")
        target = camera.position + camera.focus * camera.forward
        ElementTree.SubElement(
            transform, "lookat", origin=_text(camera.position), target=_text(target), up=_text(-camera.down)
        )
        film = _add(sensor, "film", "hdrfilm")
        _put(film, "integer", "width", camera.width)
        _put(film, "integer", "height", camera.height)
        _put(film, "string", "pixel_format", "rgb")
        _put(film, "string", "component_format", "float32")
        _add(film, "rfilter", "box")
        sampler = _add(sensor, "sampler", "independent")
        _put(sampler, "integer", "sample_count", scene.camera.samples)

    def _hidden(self) -> bool:
        """Whether Mitsuba's camera sees no light: its one switch holds for discs and for what lies around the scene."""
        discs = [light for light in self.scene.lights if isinstance(light, Disc)]
        return bool(discs) and not any(disc.visible for disc in discs) and self.scene.ambient is None

    # --- materials --------------------------------------------------------------------------------------------------

    def _materials(self) -> dict[str, Material]:
        shapes = self.scene.tables.shape
        return {table.material: material for table, material in zip(shapes, self.scene.material, strict=True)}

    def _native(self, material: Material) -> str | None:
        """The plug-in that has the same formula, if there is one."""
        if isinstance(material.model, Lambert):
            return "diffuse"
        model = material.model
        if isinstance(model, HeTorrance) and model.sigma0_um == 0.0 and model.diffuse_albedo == 0.0:
            return "conductor"
        return None

    def _bsdf(
        self,
        root: ElementTree.Element,
        name: str,
        material: Material,
        native: str | None,
        channels: Sequence[int],
        suffix: str,
    ) -> None:
        both = _add(root, "bsdf", "twosided", id=f"material-{name}")
        waves = self.scene.wavelength_nm
        if native == "diffuse":
            inner = _add(both, "bsdf", "diffuse")
            _put(inner, "rgb", "reflectance", _text(math.pi * self._values(material, channels, _UP, _UP)[0]))
        elif native == "conductor":
            inner = _add(both, "bsdf", "conductor")
            index = np.array([index_at(cast(HeTorrance, material.at(k)).ior, float(waves[k])) for k in channels])
            _put(inner, "rgb", "eta", _text(index.real))
            _put(inner, "rgb", "k", _text(index.imag))
        else:
            inner = _add(both, "bsdf", "measured")
            file = f"{name}{suffix}.bsdf"
            _put(inner, "string", "filename", file)
            self._require_isotropic(name, material, channels)
            # Mitsuba calls the viewer's side the incident one, and its cosine is the light's
            self.files[file] = rgl.sliced(
                lambda viewer, light: self._values(material, channels, light, viewer),
                name,
                nodes=self.nodes,
                incidences=self.incidences,
            )

    def _values(self, material: Material, channels: Sequence[int], omega_i: Floats, omega_r: Floats) -> Floats:
        """The BRDF without the spike where every texture is 0: (n, channels)."""
        f = material.untextured(omega_i, omega_r)
        return np.broadcast_to(f, (f.shape[0], self.scene.wavelength_nm.size))[:, list(channels)]

    def _require_isotropic(self, name: str, material: Material, channels: Sequence[int]) -> None:
        turns = np.deg2rad([0.0, 37.0, 101.0])
        omega_i, omega_r = (
            np.stack([np.sin(t) * np.cos(turns + p), np.sin(t) * np.sin(turns + p), np.full(3, np.cos(t))], axis=1)
            for t, p in ((0.9, 0.0), (0.7, 2.0))
        )
        f = self._values(material, channels, omega_i, omega_r)
        if not np.allclose(f, f[0], rtol=1e-6, atol=0):
            raise ConfigError(
                f"material.{name}: depends on the azimuth of its surface, and the file of slices that Mitsuba reads is "
                "written of isotropic materials only"
            )

    def _say_of_material(self, name: str, material: Material, native: str | None) -> None:
        where = f"material.{name}"
        if material.textured:
            self._say(f"{where}.textures", "the parameters are those where every texture is 0")
        if native == "conductor":
            self._say(f"{where}: other shapes in its mirror", "Mitsuba's direct integrator shows lights in it alone")
        elif material.has_spike:
            self._say(
                f"{where}: its specular spike", "a file of slices has no room for it; lobe and diffuse part are there"
            )
        if native is None:
            text = f"interpolated between {self.incidences} incidences and {self.nodes} x {self.nodes} half vectors"
            self._say(f"{where}: its formula", text + "; negative values are 0")

    def _say_of_scene(self) -> None:
        scene = self.scene
        discs = [light for light in scene.lights if isinstance(light, Disc)]
        if scene.polariser_deg is not None or any(light.polarisation is not None for light in scene.lights):
            self._say("polarisation", "the files are read by unpolarised variants")
        if scene.camera.samples == 1:
            self._say("rays through the middle of pixels", "Mitsuba's rays fall anywhere in a pixel: take several")
        if scene.ambient is not None:
            if scene.world.casts_shadows:
                self._say("ambient light without shadows", "Mitsuba's constant light is shadowed by shapes")
            if any(table.ambient_reflectance is not None for table in scene.tables.material.values()):
                self._say("ambient_reflectance", "Mitsuba integrates the BRDF")
        if discs and not self._hidden() and not all(disc.visible for disc in discs):
            self._say("discs of light that the camera does not see", "Mitsuba's camera sees all lights or none")
        if discs:
            self._say("discs of light that light passes through", "in Mitsuba they stand in the way of other lights")
        if scene.tolerance > 0:
            self._say("tolerance", "Mitsuba renders camera.samples rays a pixel")

    # --- shapes -----------------------------------------------------------------------------------------------------

    def _meshes(self) -> dict[int, tuple[str, bool]]:
        """The files of the shapes that are written as triangles, and whether they are smooth."""
        out = {}
        for k, (shape, table) in enumerate(zip(self.scene.world.shapes, self.scene.tables.shape, strict=True)):
            parts = _triangles(shape, table.kind)
            if parts is not None:
                out[k] = f"shape-{k + 1}.ply", parts[1] is not None
                self.files[out[k][0]] = _ply(*parts)
                if isinstance(shape, Analytic):
                    inside = 1.0 - math.cos(math.pi / TURN)
                    self._say(
                        f"shape[{k + 1}] ({table.kind}): its curve",
                        f"{TURN} flat facets around the axis, up to {inside:.1g} of the radius inside it",
                    )
        return out

    def _shape(self, root: ElementTree.Element, k: int, meshes: dict[int, tuple[str, bool]]) -> None:
        shape, table = self.scene.world.shapes[k], self.scene.tables.shape[k]
        material = table.material
        if k in meshes:
            made = _add(root, "shape", "ply")
            file, smooth = meshes[k]
            _put(made, "string", "filename", file)
            _put(made, "boolean", "face_normals", "false" if smooth else "true")
            _refer(made, material)
            return
        if not isinstance(shape, Analytic):
            raise ConfigError(f"shape[{k + 1}] ({table.kind}): has no counterpart in Mitsuba that the export knows")
        place, constants = shape.place, shape.constants
        if table.kind == "plane":
            half = np.array(constants[0])
            if not np.isfinite(half).all():
                half = np.full(2, self.reach[k])
                self._once(f"shape[{k + 1}] (plane): its endlessness", f"it is {2 * half[0]:.6g} mm wide and high")
            made = _add(root, "shape", "rectangle")
            _place(made, place, (half[0], half[1], 1.0))
            _refer(made, material)
        elif table.kind == "disc":
            self._disk(root, place.center, place.axes, constants[0], material)
        elif table.kind == "sphere":
            made = _add(root, "shape", "sphere")
            _point(made, "point", "center", place.center)
            _put(made, "float", "radius", constants[0])
            _refer(made, material)
        elif table.kind == "box":
            made = _add(root, "shape", "cube")
            _place(made, place, constants[0])
            _refer(made, material)
        else:
            raise ConfigError(f"shape[{k + 1}] ({table.kind}): has no counterpart in Mitsuba that the export knows")

    def _disk(self, root: ElementTree.Element, center: Floats, axes: Floats, radius: float, material: str) -> None:
        made = _add(root, "shape", "disk")
        _place(made, Placement(center, axes), (radius, radius, 1.0))
        _refer(made, material)

    def _once(self, what: str, why: str) -> None:
        if all(said["what"] != what for said in self.left_out):
            self._say(what, why)

    # --- lights -----------------------------------------------------------------------------------------------------

    def _lights(self, root: ElementTree.Element, channels: Sequence[int]) -> None:
        for light in self.scene.lights:
            power = _text(light.power[list(channels)])
            if isinstance(light, Directional):
                made = _add(root, "emitter", "directional")
                _point(made, "vector", "direction", -light.toward)
                _put(made, "rgb", "irradiance", power)
            elif isinstance(light, PointLight):
                made = _add(root, "emitter", "point")
                _point(made, "point", "position", light.position)
                _put(made, "rgb", "intensity", power)
            else:
                made = _add(root, "shape", "disk")
                _place(made, Placement(light.center, _axes_of(light.normal)), (light.radius, light.radius, 1.0))
                black = _add(made, "bsdf", "diffuse")
                _put(black, "rgb", "reflectance", "0 0 0")
                _put(_add(made, "emitter", "area"), "rgb", "radiance", power)
        if any(isinstance(table, AmbientTable) for table in self.scene.tables.light):
            assert self.scene.ambient is not None
            _put(_add(root, "emitter", "constant"), "rgb", "radiance", _text(self.scene.ambient[list(channels)]))


_UP = np.array([[0.0, 0.0, 1.0]])


def _extent(scene: Scene) -> tuple[float, float, dict[int, float]]:
    """Where the camera's rays may begin and end, and how far each plane without end has to reach, all in mm."""
    camera, world = scene.camera, scene.world
    rows, columns = (np.linspace(0, n - 1, min(n, GRID)).astype(np.int64) for n in (camera.height, camera.width))
    pixel = (rows[:, None] * camera.width + columns).ravel()
    hits = world.hit(*camera.rays(pixel, 0, None))
    depth = hits.distance[hits.shape >= 0]
    closest, farthest = (float(depth.min()), float(depth.max())) if depth.size else (camera.focus, camera.focus)
    near_by = [light for light in scene.lights if not isinstance(light, Directional)]
    places = [light.position if isinstance(light, PointLight) else light.center for light in near_by]
    solid = [s for s in world.shapes if isinstance(s, Analytic)]
    reach = {}
    for k, shape in enumerate(world.shapes):
        if isinstance(shape, Analytic):
            away = [float(np.linalg.norm(place - shape.place.center)) for place in places]
            away += [float(np.linalg.norm(s.place.center - shape.place.center)) + s.size_mm for s in solid]
            seen = np.linalg.norm(hits.position[hits.shape == k] - shape.place.center, axis=1)
            reach[k] = min(2.0 * max([*away, *seen]), LARGEST_MM)
    return 0.1 * closest, 10.0 * farthest, reach


def _triangles(shape: Shape, kind: str) -> tuple[Floats, Floats | None, npt.NDArray[Any]] | None:
    """Vertices, normals there or None, and faces, of a shape that is written as triangles; None for another one."""
    if isinstance(shape, _Triangular):
        corners = shape.vertices[shape.faces].reshape(-1, 3)
        if shape.normals is None:
            return shape.vertices, None, shape.faces
        smooth = shape.normals.values[shape.normals.faces].reshape(-1, 3)
        return corners, smooth, np.arange(len(corners)).reshape(-1, 3)
    if isinstance(shape, Analytic) and kind == "revolution":
        points, _, slopes = shape.constants[:3]
        return _turned(shape.place, points, slopes)
    if isinstance(shape, Analytic) and kind == "cylinder":
        radius, half, caps = shape.constants
        points = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
        return _turned(shape.place, points if caps else points[1:3], np.empty((0, 2, 3)))
    return None


def _turned(place: Placement, points: Floats, slopes: Floats) -> tuple[Floats, Floats, npt.NDArray[Any]]:
    """A surface of revolution as triangles: each frustum with normals of its own at both ends."""
    if not len(slopes):  # straight pieces
        slopes = np.zeros((len(points) - 1, 2, 3))
        slopes[:, :, 2] = np.diff(points, axis=0)
    azimuth = 2.0 * math.pi * np.arange(TURN) / TURN
    around = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(TURN)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    vertices, normals, faces = [], [], []
    ring = np.arange(TURN)
    following = (ring + 1) % TURN
    for k, step in enumerate(np.diff(points, axis=0)):
        for s, (r, z) in zip((0.0, 1.0), points[k : k + 2], strict=True):
            # straight pieces have no slopes of their own
            dr, dz = (slopes[k, :, 0] * s + slopes[k, :, 1]) * s + slopes[k, :, 2] if len(slopes) else step
            vertices.append(r * around + z * up)
            normals.append((dz * around - dr * up) / math.hypot(dr, dz))
        low, high = 2 * k * TURN, (2 * k + 1) * TURN
        # not those that have no area, at the axis
        if points[k, 0] > 0.0:
            faces.append(np.stack([low + ring, low + following, high + ring], axis=1))
        if points[k + 1, 0] > 0.0:
            faces.append(np.stack([low + following, high + following, high + ring], axis=1))
    return (
        np.concatenate(vertices) @ place.axes + place.center,
        np.concatenate(normals) @ place.axes,
        np.concatenate(faces),
    )


def _ply(vertices: Floats, normals: Floats | None, faces: npt.NDArray[Any]) -> bytes:
    names = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    columns = vertices if normals is None else np.hstack([vertices, normals])
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    body = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    body["count"], body["corners"] = 3, faces
    return "\n".join(head).encode() + columns.astype("<f4").tobytes() + body.tobytes()


def _axes_of(normal: Floats) -> Floats:
    """A right-handed frame with z along a unit vector."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(helper, normal)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(normal, x), normal])


# --- XML ----------------------------------------------------------------------------------------------------------


def _add(parent: ElementTree.Element, tag: str, kind: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {"type": kind, **attributes})


def _put(parent: ElementTree.Element, tag: str, name: str, value: object) -> None:
    ElementTree.SubElement(parent, tag, name=name, value=repr(float(value)) if isinstance(value, float) else str(value))


def _refer(parent: ElementTree.Element, material: str) -> None:
    ElementTree.SubElement(parent, "ref", id=f"material-{material}")


def _text(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def _point(parent: ElementTree.Element, tag: str, name: str, values: Floats) -> None:
    at = {axis: repr(float(value)) for axis, value in zip("xyz", values, strict=True)}
    ElementTree.SubElement(parent, tag, {"name": name, **at})


def _place(parent: ElementTree.Element, place: Placement, scale: Sequence[float] | Floats) -> None:
    """Put a unit shape where it stands: its x, y, z along the rows of `axes`, scaled."""
    matrix = np.eye(4)
    matrix[:3, :3] = place.axes.T * np.asarray(scale, dtype=np.float64)
    matrix[:3, 3] = place.center
    transform = ElementTree.SubElement(parent, "transform", name="to_world")
    ElementTree.SubElement(transform, "matrix", value=_text(matrix.ravel()))
