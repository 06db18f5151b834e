"""Scenes as files for Mitsuba 3: what is in them, and what is said of what is not. Nothing here needs Mitsuba."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from gonio_scenes import mitsuba
from gonio_scenes.commands import render as command
from gonio_scenes.shapes.shape import Ints
from gonio_scenes.world import SceneShapes

from gonio.errors import ConfigError
from gonio.formats.rgl import RglMeasured
from gonio.models import Phong
from gonio.typing import Floats
from tests.command_line import some
from tests.gonio_scenes.scenes import SPHERE, scene

SMALL = {"nodes": 24, "incidences": 12}
GLOSS = {"model": "phong", "parameters": {"k_d": 0.3, "k_s": 0.4, "exponent": 8}}

TUBE: dict[str, Any] = {"kind": "cylinder", "axis": [0.2, 1.0, 0.1], "radius_mm": 20.0, "height_mm": 60.0}


def xml(made: mitsuba.Export, name: str = "scene.xml") -> ElementTree.Element:
    return ElementTree.fromstring(made.files[name])


def told(made: mitsuba.Export) -> str:
    return "\n".join(f"{said['what']}: {said['why']}" for said in made.left_out)


def numbers(element: ElementTree.Element | None) -> list[float]:
    assert element is not None
    return [float(word) for word in element.attrib["value"].split()]


def test_a_single_wavelength_fills_all_channels_and_needs_no_file_of_slices() -> None:
    made = mitsuba.export(scene())
    assert (list(made.files), made.scenes) == (["scene.xml"], {"scene.xml": (550.0,)})
    root = xml(made)
    assert numbers(root.find("bsdf/bsdf[@type='diffuse']/rgb")) == pytest.approx([0.7] * 3, rel=1e-15)
    assert numbers(root.find("emitter[@type='directional']/rgb")) == [3.0] * 3
    assert numbers(root.find("sensor/float[@name='fov']")) == pytest.approx([6.0], rel=1e-14)


def test_wavelengths_are_the_channels_of_several_files() -> None:
    albedo = {"wavelength_nm": [400.0, 700.0], "value": [0.1, 0.7]}
    made = mitsuba.export(
        scene(
            wavelength_nm=[400.0, 500.0, 600.0, 700.0],
            material={"m": {"model": "lambert", "parameters": {"albedo": albedo}}},
        )
    )
    assert made.scenes == {"scene-400-500-600nm.xml": (400.0, 500.0, 600.0), "scene-700nm.xml": (700.0,)}
    for name, expected in zip(made.scenes, ([0.1, 0.3, 0.5], [0.7] * 3), strict=True):
        assert numbers(xml(made, name).find("bsdf/bsdf[@type='diffuse']/rgb")) == pytest.approx(expected, rel=1e-14)


def test_slices_hold_the_light_where_mitsuba_looks_for_it() -> None:
    """Mitsuba's incident side is the viewer's: a model that is not reciprocal has both sides where they belong."""
    made = mitsuba.export(scene(material={"m": GLOSS}), **SMALL)
    assert xml(made).find("bsdf/bsdf[@type='measured']/string") is not None
    read = RglMeasured(made.files["m.bsdf"], Path("m.bsdf"))
    # at nodes of the grid: at theta = 89 degrees 3/11, with the normal as half vector
    theta = math.radians(89.0 * 3 / 11)
    viewer, light = np.array([theta]), np.array([theta])
    value, _ = read.brdf(viewer, np.zeros(1), light, np.full(1, math.pi))
    expected = Phong(k_d=0.3, k_s=0.4, exponent=8).brdf(theta, 0.0, theta, math.pi)
    np.testing.assert_allclose(value[0], expected, rtol=1e-6)  # float32
    # and where both sides differ
    value, _ = read.brdf(np.zeros(1), np.zeros(1), np.array([0.8]), np.zeros(1))
    right = Phong(k_d=0.3, k_s=0.4, exponent=8).brdf(0.8, 0.0, 0.0, 0.0)
    assert abs(Phong(k_d=0.3, k_s=0.4, exponent=8).brdf(0.0, 0.0, 0.8, 0.0) / right - 1.0) > 0.15
    np.testing.assert_allclose(value[0], right, rtol=0.02)  # straight between 24 half vectors


def test_a_smooth_metal_is_a_conductor() -> None:
    mirror = {"model": "he-torrance", "parameters": {"sigma0_um": 0.0, "tau_um": 2.0, "ior": [0.2, 3.5]}}
    made = mitsuba.export(scene(material={"m": mirror}))
    plugin = some(xml(made).find("bsdf/bsdf[@type='conductor']"))
    assert numbers(plugin.find("rgb[@name='eta']")) == [0.2] * 3
    assert numbers(plugin.find("rgb[@name='k']")) == [3.5] * 3
    assert "other shapes in its mirror" in told(made)


def test_what_is_left_out_is_said() -> None:
    rough = {"model": "he-torrance", "parameters": {"sigma0_um": 0.1, "tau_um": 2.0, "ior": "Al"}}
    checks = {"model": "lambert", "textures": {"albedo": {"pattern": "checker", "low": 0.2, "high": 0.6}}}
    made = mitsuba.export(
        scene(
            shape=[*SPHERE["shape"], {"kind": "plane", "material": "checks"}],
            material={"m": rough, "checks": checks},
            light=[SPHERE["light"][0] | {"polarisation": [0.0, 1.0, 0.0]}, {"kind": "ambient", "radiance": 1.0}],
        ),
        **SMALL,
    )
    said = told(made)
    for what in (
        "material.m: its specular spike",
        "material.m: its formula",
        "material.checks.textures",
        "polarisation",
        "ambient light without shadows",
        "shape[2] (plane): its endlessness",
        "middle of pixels",
    ):
        assert what in said
    assert numbers(xml(made).find("bsdf[@id='material-checks']/bsdf/rgb")) == pytest.approx([0.2] * 3, rel=1e-15)


def test_a_cylinder_is_written_as_triangles_with_its_error() -> None:
    """Mitsuba's own cylinder was seen to shadow itself."""
    made = mitsuba.export(scene(shape=[TUBE | {"material": "m"}]))
    assert xml(made).find("shape[@type='cylinder']") is None
    assert xml(made).find("shape[@type='ply']") is not None
    assert "up to 1e-05 of the radius inside it" in told(made)
    rows = vertices(made)
    axis = np.array(TUBE["axis"]) / np.linalg.norm(TUBE["axis"])
    along = rows[:, :3] @ axis
    radius = np.linalg.norm(rows[:, :3] - along[:, None] * axis, axis=1)
    np.testing.assert_allclose(np.abs(along), 30.0, rtol=1e-6)  # float32
    assert set(np.round(radius, 3)) == {0.0, 20.0}  # the sides, and the middle of the caps


def test_a_surface_of_revolution_becomes_triangles_on_it() -> None:
    shape = {"kind": "revolution", "profile_mm": [[0.0, 0.0], [30.0, 0.0], [20.0, 40.0]], "material": "m"}
    made = mitsuba.export(scene(shape=[shape], camera=SPHERE["camera"] | {"position_mm": [0.0, -1000.0, 20.0]}))
    rows = vertices(made)
    radius, z = np.hypot(rows[:, 0], rows[:, 1]), rows[:, 2]
    cone = z > 0.1
    np.testing.assert_allclose(radius[cone], 30.0 - z[cone] / 4.0, rtol=1e-6)  # float32
    outward = np.einsum("ij,ij->i", rows[cone, :2], rows[cone, 3:5]) / radius[cone]
    np.testing.assert_allclose(outward, 4.0 / math.sqrt(17.0), rtol=1e-6)
    np.testing.assert_allclose(rows[z == 0.0][:10, 5], -1.0, rtol=1e-6)


@dataclass(frozen=True)
class Triangles:
    """A shape that is a triangle, which no ray of the camera meets."""

    normals: Any
    vertices: Floats = field(default_factory=lambda: 10.0 * np.eye(3))
    faces: Ints = field(default_factory=lambda: np.array([[0, 1, 2]]))
    convex: bool = True
    closed: bool = False
    size_mm: float = 20.0

    def intersect(self, origin: Floats, direction: Floats, nearest: float) -> tuple[Floats, Ints]:
        return np.full(len(origin), np.inf), np.zeros(len(origin), np.int64)

    def surface(self, origin: Floats, direction: Floats, distance: Floats, primitive: Ints) -> Any:
        raise NotImplementedError

    def contains(self, point: Any) -> bool:
        return False


@pytest.mark.parametrize("smooth", [False, True])
def test_triangles_are_written_with_the_normals_that_they_have(smooth: bool) -> None:
    """Mitsuba makes normals up where a file has none, unless it is told not to."""
    up = np.tile([0.0, 0.0, 1.0], (3, 1))
    made = mitsuba.export(replace(scene(), world=SceneShapes([Triangles(up if smooth else None)], np.zeros(3))))
    flat = some(xml(made).find("shape[@type='ply']/boolean[@name='face_normals']"))
    assert flat.attrib["value"] == ("false" if smooth else "true")
    body = made.files["shape-1.ply"].partition(b"end_header\n")[2]
    rows = np.frombuffer(body, "<f4", 18 if smooth else 9).reshape(3, -1)
    np.testing.assert_array_equal(rows[:, :3], 10.0 * np.eye(3))
    np.testing.assert_array_equal(rows[:, 3:], [[0.0, 0.0, 1.0]] * 3 if smooth else np.empty((3, 0)))
    assert body[rows.nbytes :] == b"\x03" + np.arange(3, dtype="<i4").tobytes()


def test_what_cannot_be_written_is_refused() -> None:
    grooved = {"form": "single-slope", "slope_deg": 30, "groove_azimuth_deg": 0}
    with pytest.raises(ConfigError, match=r"material\.m: depends on the azimuth"):
        mitsuba.export(scene(material={"m": {"model": "oren-nayar", "parameters": grooved}}), **SMALL)


def vertices(made: mitsuba.Export) -> Floats:
    """Places and normals in the first file of triangles, (n, 6)."""
    head, _, body = made.files["shape-1.ply"].partition(b"end_header\n")
    count = int(head.split(b"element vertex ")[1].split()[0])
    return np.frombuffer(body, "<f4", 6 * count).reshape(count, 6)


def test_the_command_writes_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "s.toml", tmp_path / "out"
    file.write_text(
        'name = "s"\nwavelength_nm = [550]\n[camera]\nposition_mm = [0, 0, 900]\nvertical_field_deg = 6\nwidth = 8\n'
        'height = 8\n[[shape]]\nkind = "sphere"\nradius_mm = 40\nmaterial = "m"\n[material.m]\nmodel = "lambert"\n'
        '[[light]]\nkind = "directional"\ntoward = [1, 0, 1]\nirradiance = 1.0\n'
    )
    command(file, out, to="mitsuba")
    assert capsys.readouterr().out.strip() == str(out / "scene.xml")
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["scenes"], summary["materials"]) == ({"scene.xml": [550.0]}, {"m": "diffuse"})
    with pytest.raises(ConfigError, match="no such renderer"):
        command(file, tmp_path / "more", to="povray")
    assert not (tmp_path / "more").exists()


BULB = {"kind": "point", "position_mm": [-30.0, 200.0, 500.0], "intensity": 3e5}
CURVED: dict[str, tuple[list[dict[str, Any]], dict[str, Any]]] = {
    "cylinder": ([TUBE], BULB),
    "cylinder far from the origin": ([TUBE | {"center_mm": [3.0, 2.0, -400.0], "radius_mm": 33.0}], BULB),
    "tube, from inside": ([TUBE | {"axis": [0.1, 0.0, 1.0], "caps": False, "radius_mm": 60, "height_mm": 200}], BULB),
    "disc": ([{"kind": "disc", "radius_mm": 30.0, "normal": [0.5, 0.2, 1.0]}], BULB),
    "sphere": ([{"kind": "sphere", "radius_mm": 30.0}], BULB),
    "sphere, from inside": (
        [{"kind": "sphere", "radius_mm": 900.0}],
        {"kind": "point", "position_mm": [100.0, 50.0, -200.0], "intensity": 3e5},
    ),
    "revolution": ([{"kind": "revolution", "axis": [0, 1, 0], "profile_mm": [[20, -30], [30, 0], [12, 28]]}], BULB),
    "box": ([{"kind": "box", "size_mm": [30.0, 40.0, 20.0], "x_axis": [1.0, 0.0, 0.7]}], BULB),
}


@pytest.mark.parametrize("name", CURVED)
def test_mitsuba_renders_every_shape_as_we_do(name: str, tmp_path: Path) -> None:
    """Where all of our rays of a pixel and of its neighbours are lit, no ray of Mitsuba's is in a shadow."""
    mi = pytest.importorskip("mitsuba")
    if "scalar_rgb" not in mi.variants():
        pytest.skip("this Mitsuba has no scalar variant")
    from gonio_scenes.render import render
    from scipy.ndimage import minimum_filter

    shapes, light = CURVED[name]
    of = scene(
        shape=[shape | {"material": "m"} for shape in shapes],
        material={"m": {"model": "lambert", "parameters": {"albedo": 0.7}}},
        camera=SPHERE["camera"] | {"width": 48, "height": 48, "samples": 16, "position_mm": [10.0, 20.0, 800.0]},
        light=[light],
    )
    made = mitsuba.write(of, tmp_path)
    assert xml(made).find("shape[@type='cylinder']") is None  # Mitsuba's own was seen to shadow itself
    mi.set_variant("scalar_rgb")
    theirs = np.array(mi.render(mi.load_file(str(tmp_path / "scene.xml")), spp=16, seed=1))[..., 0]
    ours = render(of).radiance[..., 0]
    # beside edges, where rays at other places of a pixel see something else, the two may differ
    inside = minimum_filter(ours, 3) > 0.05 * ours.max()
    assert inside.sum() > 50
    ratio = theirs[inside] / ours[inside]
    # 16 rays at random over the shading of a pixel: 1 % of it at the brightest, and more toward the terminator
    assert np.median(np.abs(ratio - 1.0)) < 0.01
    assert np.quantile(ratio, 0.01) > 0.8
    assert ratio.mean() == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("name", ["../../m", "塗料", "a.b", "1", "<\x0b&>", "m" * 300, "a\0"])
def test_a_material_of_any_name_has_a_file_and_an_id_of_its_own(name: str) -> None:
    """Names are data: none leads out of the folder, ends the XML, or is that of another material."""
    shapes = [SPHERE["shape"][0] | {"material": one} for one in (name, "m")]
    made = mitsuba.export(scene(shape=shapes, material={name: GLOSS, "m": GLOSS}), **SMALL)
    slices = [file for file in made.files if file.endswith(".bsdf")]
    assert slices == ["1.bsdf", "m.bsdf"]
    assert {one.attrib["id"] for one in xml(made).findall("bsdf")} == {"material-1", "material-m"}
