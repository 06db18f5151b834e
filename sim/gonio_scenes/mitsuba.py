"""The same scene for Mitsuba 3: native shapes, lights and plug-ins, and a file of slices for every other material.

Three wavelengths go into one XML file, as the three channels of Mitsuba's RGB variants, which mix nothing: a channel is
a wavelength. A single wavelength fills all three alike, so that the variants for one wavelength (`*_mono`) read it too.
Mitsuba's spectral variants draw wavelengths at random and interpolate between them; nothing is left to compare then.

What the two renderers compute alike is direct light. `Export.left_out` names what a file cannot carry.

Plane, disc, sphere and box become `rectangle`, `disk`, `sphere` and `cube`; a plane without end is as wide as twice
what is seen and what stands on it. A cylinder is triangles, 720 around, up to 1e-5 of the radius inside it; a surface
of revolution likewise, with its own normals; a height field is its triangles. `lambert` is `diffuse`; `he-torrance`
with `sigma0_um = 0` and no diffuse part is `conductor`, of the same Fresnel reflectance; every other material is
`measured`, a file of slices. Lights are `directional`, `point`, `area` on a `disk` and `constant`; cameras
`perspective` and `thinlens`; the integrator is `direct`. More than three wavelengths make several files,
`scene-400-410-420nm.xml` and so on.

Not carried are the specular spike beside a lobe; other shapes in a smooth mirror (lights are seen in it); textures
(the parameters are those where a texture is 0); `ambient_reflectance`, and ambient light without shadows;
polarisation; one ray through the middle of a pixel; discs of light that other light passes through. Materials that
depend on the azimuth of their surface are refused.
"""

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast, runtime_checkable
from xml.etree import ElementTree

import numpy as np

from gonio import __version__
from gonio.disk import require_own, write_own
from gonio.errors import ConfigError, os_error_as
from gonio.formats import rgl
from gonio.models import HeTorrance, Lambert
from gonio.models.parameters import index_at
from gonio.typing import Array, Floats, Ints
from gonio_scenes.lights import Directional, DiscLight, PointLight, across
from gonio_scenes.material import SceneMaterial
from gonio_scenes.scene import Scene
from gonio_scenes.shapes import Shape
from gonio_scenes.shapes.analytic import Analytic
from gonio_scenes.shapes.shape import Placement

CHANNELS = 3
Channels = Ints
"""Numbers of the scene's wavelengths that the channels of a file hold."""
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
    faces: Array
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
    with os_error_as(ConfigError, f"{out}: cannot be written"):
        out.mkdir(parents=True, exist_ok=True)
        write_own(out, files)
    return made


class _Writer:
    def __init__(self, scene: Scene, nodes: int, incidences: int) -> None:
        self.scene = scene
        self.nodes, self.incidences = nodes, incidences
        self.files: dict[str, bytes] = {}
        self.left_out: dict[str, str] = {}
        self.near, self.far, self.reach = _extent(scene)
        self.discs = [light for light in scene.lights if isinstance(light, DiscLight)]
        # Mitsuba's one switch holds for discs and for what lies around the scene
        self.hidden = bool(self.discs) and not any(disc.visible for disc in self.discs) and scene.ambient is None

    def export(self) -> Export:
        scene, waves = self.scene, self.scene.wavelength_nm
        shapes = [self._shape(k) for k in range(len(scene.world.shapes))]
        named = zip(scene.tables.shape, scene.material, strict=True)
        materials = {table.material: material for table, material in named}
        plugins = {name: _plugin(material) for name, material in materials.items()}
        for name, material in materials.items():
            self._say_of_material(f"material.{name}", material, plugins[name])
        scenes = {}
        for first in range(0, waves.size, CHANNELS):
            shown = tuple(map(float, waves[first : first + CHANNELS]))
            # the remaining channels repeat the last wavelength
            channels = np.minimum(np.arange(first, first + CHANNELS), waves.size - 1)
            if scene.tables.of_channels:  # red first
                shown, channels = shown[::-1], channels[::-1]
            suffix = "" if waves.size <= CHANNELS else "-" + "-".join(f"{wave:g}" for wave in shown) + "nm"
            of = channels, suffix
            bsdfs = [
                _node("bsdf", "twosided", self._bsdf(name, material, plugins[name], *of), id=self._id(name))
                for name, material in materials.items()
            ]
            root = _node("scene", "", *self._frame(), *bsdfs, *shapes, *self._lights(channels), version="3.0.0")
            ElementTree.indent(root)
            scenes[f"scene{suffix}.xml"] = shown
            self.files[f"scene{suffix}.xml"] = ElementTree.tostring(root) + b"\n"
        self._say_of_scene()
        left_out = tuple({"what": what, "why": why} for what, why in self.left_out.items())
        return Export(self.files, scenes, plugins, left_out)

    def _frame(self) -> tuple[ElementTree.Element, ...]:
        """Integrator and camera."""
        camera = self.scene.camera
        target = camera.position + camera.focus * camera.forward
        look = {"origin": _text(camera.position), "target": _text(target), "up": _text(-camera.down)}
        lens = camera.lens_radius > 0
        aperture = [("aperture_radius", camera.lens_radius), ("focus_distance", camera.focus)] if lens else []
        return _node("integrator", "direct", _value("boolean", "hide_emitters", str(self.hidden).lower())), _node(
            "sensor",
            "thinlens" if lens else "perspective",
            _value("float", "fov", 2.0 * math.degrees(math.atan(camera.step * camera.height / 2.0))),
            _value("string", "fov_axis", "y"),
            _value("float", "near_clip", self.near),
            _value("float", "far_clip", self.far),
            *(_value("float", name, value) for name, value in aperture),
            _node("transform", "", _node("lookat", "", **look), name="to_world"),
            _node(
                "film",
                "hdrfilm",
                _value("integer", "width", camera.width),
                _value("integer", "height", camera.height),
                _value("string", "pixel_format", "rgb"),
                _value("string", "component_format", "float32"),
                _node("rfilter", "box"),
            ),
            _node("sampler", "independent", _value("integer", "sample_count", camera.samples)),
        )

    # --- materials --------------------------------------------------------------------------------------------------

    def _bsdf(
        self, name: str, material: SceneMaterial, plugin: str, channels: Channels, suffix: str
    ) -> ElementTree.Element:
        if plugin == "diffuse":
            albedo = math.pi * self._values(material, channels, _UP, _UP)[0]
            return _node("bsdf", plugin, _value("rgb", "reflectance", _text(albedo)))
        if plugin == "conductor":
            waves = self.scene.wavelength_nm
            index = np.array([index_at(cast(HeTorrance, material.at(k)).ior, float(waves[k])) for k in channels])
            parts = (("eta", index.real), ("k", index.imag))
            return _node("bsdf", plugin, *(_value("rgb", part, _text(values)) for part, values in parts))
        self._require_isotropic(name, material, channels)
        # Mitsuba calls the viewer's side the incident one, and its cosine is the light's
        file = f"{self._plain(name)}{suffix}.bsdf"
        self.files[file] = rgl.sliced(
            lambda viewer, light: self._values(material, channels, light, viewer),
            name,
            nodes=self.nodes,
            incidences=self.incidences,
        )
        return _node("bsdf", plugin, _value("string", "filename", file))

    def _values(self, material: SceneMaterial, channels: Channels, omega_i: Floats, omega_r: Floats) -> Floats:
        """The BRDF without the spike where every texture is 0: (n, channels)."""
        f = material.untextured(omega_i, omega_r)
        return np.broadcast_to(f, (f.shape[0], self.scene.wavelength_nm.size))[:, channels]

    def _id(self, name: str) -> str:
        return f"material-{self._plain(name)}"

    def _plain(self, name: str) -> str:
        """A material's name as files and XML have it: its number, which is no other's name, where it is not plain."""
        if re.fullmatch(r"(?!\d+$)[\w-]{1,60}", name, re.ASCII):
            return name
        return str(list(dict.fromkeys(table.material for table in self.scene.tables.shape)).index(name) + 1)

    def _require_isotropic(self, name: str, material: SceneMaterial, channels: Channels) -> None:
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

    # --- what is left out -------------------------------------------------------------------------------------------

    def _say(self, *rules: tuple[object, str, str]) -> None:
        """Note what the files do not carry, and why: of each rule that applies."""
        self.left_out |= {what: why for applies, what, why in rules if applies and what not in self.left_out}

    def _say_of_material(self, where: str, material: SceneMaterial, plugin: str) -> None:
        text = f"interpolated between {self.incidences} incidences and {self.nodes} x {self.nodes} half vectors"
        metal = plugin == "conductor"
        told = ["; ".join(material.tabulated.remarks)] if material.tabulated is not None else []
        self._say(
            (material.textured, f"{where}.textures", "the parameters are those where every texture is 0"),
            (metal, f"{where}: other shapes in its mirror", "Mitsuba's direct integrator shows lights in it alone"),
            (
                material.has_spike and not metal,
                f"{where}: its specular spike",
                "a file of slices has no room for it; lobe and diffuse part are there",
            ),
            (plugin == "measured", f"{where}: its formula", f"{text}; negative values are 0"),
            *((True, f"{where}: what was not measured", remark) for remark in told),
        )

    def _say_of_scene(self) -> None:
        scene, discs, ambient = self.scene, self.discs, self.scene.ambient is not None
        polarised = any(light.polarisation is not None for light in scene.lights)
        given = any(table.ambient_reflectance is not None for table in scene.tables.material.values())
        some_unseen = discs and not self.hidden and not all(disc.visible for disc in discs)
        one_ray = scene.camera.samples == 1
        self._say(
            (polarised, "polarisation", "the files are read by unpolarised variants"),
            (one_ray, "rays through the middle of pixels", "Mitsuba's rays fall anywhere in a pixel: take several"),
            (
                ambient and scene.world.casts_shadows,
                "ambient light without shadows",
                "Mitsuba's constant light is shadowed by shapes",
            ),
            (ambient and given, "ambient_reflectance", "Mitsuba integrates the BRDF"),
            (some_unseen, "discs of light that the camera does not see", "Mitsuba's camera sees all lights or none"),
            (discs, "discs of light that light passes through", "in Mitsuba they stand in the way of other lights"),
            (scene.tolerance > 0, "tolerance", "Mitsuba renders camera.samples rays a pixel"),
        )

    # --- shapes and lights ------------------------------------------------------------------------------------------

    def _shape(self, k: int) -> ElementTree.Element:
        shape, table = self.scene.world.shapes[k], self.scene.tables.shape[k]
        where, material = f"shape[{k + 1}] ({table.kind})", _node("ref", "", id=self._id(table.material))
        parts = _triangles(shape, table.kind)
        if parts is not None:
            file, inside = f"shape-{k + 1}.ply", 1.0 - math.cos(math.pi / TURN)
            self.files[file] = _ply(*parts)
            why = f"{TURN} flat facets around the axis, up to {inside:.1g} of the radius inside it"
            self._say((isinstance(shape, Analytic), f"{where}: its curve", why))
            flat = _value("boolean", "face_normals", str(parts[1] is None).lower())
            return _node("shape", "ply", _value("string", "filename", file), flat, material)
        if not isinstance(shape, Analytic) or table.kind not in ("plane", "disc", "sphere", "box"):
            raise ConfigError(f"{where}: has no counterpart in Mitsuba that the export knows")
        place, size = shape.place, shape.constants[0]
        if table.kind == "plane":
            endless = not np.isfinite(size).all()
            size = np.full(2, self.reach[k]) if endless else size
            self._say((endless, f"{where}: its endlessness", f"it is {2 * size[0]:.6g} mm wide and high"))
            return _node("shape", "rectangle", _placed(place, (*size, 1.0)), material)
        if table.kind == "sphere":
            return _node("shape", "sphere", _point("point", "center", place.center), _value("float", "radius", size),
                         material)  # fmt: skip
        if table.kind == "disc":
            return _node("shape", "disk", _placed(place, (size, size, 1.0)), material)
        return _node("shape", "cube", _placed(place, size), material)

    def _lights(self, channels: Channels) -> Iterator[ElementTree.Element]:
        for light in self.scene.lights:
            power = _text(light.power[channels])
            if isinstance(light, Directional):
                toward = _point("vector", "direction", -light.toward)
                yield _node("emitter", "directional", toward, _value("rgb", "irradiance", power))
            elif isinstance(light, PointLight):
                place = _point("point", "position", light.position)
                yield _node("emitter", "point", place, _value("rgb", "intensity", power))
            else:
                axes = np.array([*across(light.normal), light.normal])
                yield _node(
                    "shape",
                    "disk",
                    _placed(Placement(light.center, axes), (light.radius, light.radius, 1.0)),
                    _node("bsdf", "diffuse", _value("rgb", "reflectance", "0 0 0")),
                    _node("emitter", "area", _value("rgb", "radiance", power)),
                )
        if self.scene.ambient is not None:
            yield _node("emitter", "constant", _value("rgb", "radiance", _text(self.scene.ambient[channels])))


def _plugin(material: SceneMaterial) -> str:
    """The plug-in that has the same formula; "measured", which reads slices, where there is none."""
    model = material.model
    if isinstance(model, HeTorrance) and model.sigma0_um == 0.0 and model.diffuse_albedo == 0.0:
        return "conductor"
    return "diffuse" if isinstance(model, Lambert) else "measured"


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


def _triangles(shape: Shape, kind: str) -> tuple[Floats, Floats | None, Array] | None:
    """Vertices, normals there or None, and faces, of a shape that is written as triangles; None for another one."""
    if isinstance(shape, _Triangular):
        corners = shape.vertices[shape.faces].reshape(-1, 3)
        if shape.normals is None:
            return shape.vertices, None, shape.faces
        smooth = shape.normals[shape.faces].reshape(-1, 3)
        return corners, smooth, np.arange(len(corners)).reshape(-1, 3)
    if isinstance(shape, Analytic) and kind == "revolution":
        points, _, slopes = shape.constants[:3]
        return _turned(shape.place, points, slopes)
    if isinstance(shape, Analytic) and kind == "cylinder":
        radius, half, caps = shape.constants
        points = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
        return _turned(shape.place, points if caps else points[1:3], np.empty((0, 2, 3)))
    return None


def _turned(place: Placement, points: Floats, slopes: Floats) -> tuple[Floats, Floats, Array]:
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
    for k in range(len(slopes)):
        for s, (r, z) in zip((0.0, 1.0), points[k : k + 2], strict=True):
            dr, dz = (slopes[k, :, 0] * s + slopes[k, :, 1]) * s + slopes[k, :, 2]
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


def _ply(vertices: Floats, normals: Floats | None, faces: Array) -> bytes:
    names = ["x", "y", "z"] + (["nx", "ny", "nz"] if normals is not None else [])
    columns = vertices if normals is None else np.hstack([vertices, normals])
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {name}" for name in names]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header\n"]
    body = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    body["count"], body["corners"] = 3, faces
    return "\n".join(head).encode() + columns.astype("<f4").tobytes() + body.tobytes()


# --- XML ----------------------------------------------------------------------------------------------------------


def _node(tag: str, kind: str, *children: ElementTree.Element, **attributes: str) -> ElementTree.Element:
    made = ElementTree.Element(tag, {"type": kind, **attributes} if kind else attributes)
    made.extend(children)
    return made


def _value(tag: str, name: str, value: object) -> ElementTree.Element:
    return _node(tag, "", name=name, value=repr(float(value)) if isinstance(value, float) else str(value))


def _text(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def _point(tag: str, name: str, values: Floats) -> ElementTree.Element:
    return _node(tag, "", name=name, **{axis: repr(float(value)) for axis, value in zip("xyz", values, strict=True)})


def _placed(place: Placement, scale: Sequence[float] | Floats) -> ElementTree.Element:
    """Where a unit shape stands: its x, y, z along the rows of `axes`, scaled."""
    matrix = np.eye(4)
    matrix[:3, :3] = place.axes.T * np.asarray(scale, dtype=np.float64)
    matrix[:3, 3] = place.center
    return _node("transform", "", _node("matrix", "", value=_text(matrix.ravel())), name="to_world")
