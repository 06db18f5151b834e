"""Meshes against their own facets by Moeller and Trumbore's test of all of them, in float64."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from gonio_scenes.shapes import Mesh, Shape

from gonio.errors import DataError
from gonio.typing import Floats
from tests.gonio_scenes.shapes.solids import check_frame, meet, shades_not_itself, shape, toward, units

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex", reason="Embree has no wheel here")

SIZES = [1e-3, 40.0, 1e5]


def brute(
    origin: Floats, direction: Floats, corners: Floats, nearest: float = 0.0
) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Moeller and Trumbore 1997: first hit of each ray with any of the triangles (m, 3, 3)."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    distance, primitive = np.full(len(origin), np.inf), np.zeros(len(origin), np.int64)
    for i, (o, d) in enumerate(zip(origin, direction, strict=True)):
        p = np.cross(d, other)
        det = np.einsum("ij,ij->i", one, p)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - corners[:, 0]
            u = np.einsum("ij,ij->i", s, p) / det
            q = np.cross(s, one)
            v = q @ d / det
            t = np.einsum("ij,ij->i", other, q) / det
            t[~((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > nearest))] = np.inf
        primitive[i] = np.argmin(t)
        distance[i] = t[primitive[i]]
    return distance, primitive


def write(folder: Path, mesh: object, name: str) -> str:
    mesh.export(folder / name)  # type: ignore[attr-defined]
    return name


def corners_of(built: Shape) -> Floats:
    return np.asarray(built.vertices[built.faces])  # type: ignore[attr-defined]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", ["obj", "ply", "stl"])
def test_rays_meet_a_mesh_where_they_meet_its_facets(tmp_path: Path, size: float, kind: str) -> None:
    bumpy = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    rng = np.random.default_rng(31)
    bumpy.vertices *= rng.uniform(0.6, 1.0, (len(bumpy.vertices), 1))
    center = np.array([3.0, -1.0, 2.0]) * size
    built = shape(
        "mesh", tmp_path, file=write(tmp_path, bumpy, f"bumpy.{kind}"), scale=size / 2, center_mm=center.tolist()
    )
    assert built.closed
    origin, direction = toward(rng, 400, center, size, 3.0 * size)
    hit, distance, part, surface = meet(built, origin, direction)
    slow, _ = brute(origin, direction, corners_of(built))
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(slow))
    hit = np.isfinite(slow)
    assert hit.mean() > 0.3
    np.testing.assert_allclose(distance[hit], slow[hit], rtol=0, atol=1e-6 * size)
    check_frame(surface)
    triangle = corners_of(built)[part[hit]]
    assert np.abs(np.einsum("ij,ij->i", surface.normal, surface.position - triangle[:, 0])).max() < 1e-13 * size
    # the normal is the facet's, and outward: the shape's centre is behind it as it is star-shaped
    assert np.all(np.einsum("ij,ij->i", surface.normal, surface.position - center) > 0.0)
    assert built.contains(center)
    assert not built.contains(center + np.array([0.0, 0.0, 1.01 * size]))


def test_a_far_camera_sees_a_mesh_as_a_near_one_does(tmp_path: Path) -> None:
    """In float32 a coordinate of 1e6 mm is rounded by 0.06 mm."""
    name = write(tmp_path, trimesh.creation.icosphere(subdivisions=3, radius=20.0), "sphere.ply")
    built = shape("mesh", tmp_path, file=name)
    origin, direction = toward(np.random.default_rng(32), 300, np.zeros(3), 40.0, 1e6)
    distance, _ = built.intersect(origin, direction, 0.0)
    slow, _ = brute(origin + (1e6 - 100.0) * direction, direction, corners_of(built))
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(slow))
    hit = np.isfinite(slow)
    np.testing.assert_allclose(distance[hit] - (1e6 - 100.0), slow[hit], rtol=0, atol=1e-6 * 40)


@pytest.mark.parametrize("far", [60.0, 1e6])
def test_no_ray_slips_through_an_edge_or_a_vertex(tmp_path: Path, far: float) -> None:
    """Rays at the middles of edges and at vertices of a closed mesh, head on: between triangles for rounding."""
    name = write(tmp_path, trimesh.creation.icosphere(subdivisions=4, radius=20.0), "sphere.ply")
    built = shape("mesh", tmp_path, file=name)
    corners = corners_of(built)
    goals = np.concatenate([corners.reshape(-1, 3), (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2])
    tilted = -goals / np.linalg.norm(goals, axis=1)[:, np.newaxis] + 0.5 * units(np.random.default_rng(33), len(goals))
    tilted /= np.linalg.norm(tilted, axis=1)[:, np.newaxis]
    distance, _ = built.intersect(goals - far * tilted, tilted, 0.0)
    np.testing.assert_allclose(distance, far, rtol=0, atol=1e-6 * 40)


@pytest.mark.parametrize("normals", ["facet", "smooth"])
def test_shadow_rays_do_not_meet_the_facet_that_they_start_on(tmp_path: Path, normals: str) -> None:
    """From a convex mesh rays outward meet nothing; rays inward meet the far side, at the distance of the facets."""
    name = write(tmp_path, trimesh.creation.icosphere(subdivisions=4, radius=20.0), "sphere.stl")
    built = shape("mesh", tmp_path, file=name, normals=normals)
    rng = np.random.default_rng(34)
    start, inward, met = shades_not_itself(built, rng, *toward(rng, 30000, np.zeros(3), 30.0, 1e4), 1e-5)
    slow, _ = brute(start[:100], inward[:100], corners_of(built), 1e-9 * built.size_mm)
    np.testing.assert_allclose(met[:100], slow, rtol=0, atol=1e-6 * 40)


def test_shadow_rays_in_a_fold_meet_the_other_side(tmp_path: Path) -> None:
    """Two squares that meet at a right angle: light along one side of the fold is blocked near it and far from it."""
    text = "v 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nv 0 0 10\nv 0 10 10\nf 1 2 3 4\nf 1 4 6 5\n"
    (tmp_path / "fold.obj").write_text(text)
    built = shape("mesh", tmp_path, file="fold.obj", open=True)
    x = np.geomspace(1e-6, 9.0, 60)  # down to 1e-7 of the size
    position = np.stack([x, np.full_like(x, 5.1), np.zeros_like(x)], axis=-1)
    for slope in (1.0, 0.1, 1e-3):
        toward_light = np.tile(np.array([-1.0, 0.0, slope]) / np.hypot(1.0, slope), (len(x), 1))
        distance, _ = built.intersect(position, toward_light, 1e-9 * built.size_mm)
        np.testing.assert_allclose(distance, x * np.hypot(1.0, slope), rtol=1e-9)


def test_a_finer_mesh_of_a_sphere_comes_nearer_to_it(tmp_path: Path) -> None:
    """Four times as many triangles: a quarter of the distance's error, half of the facets' normals'.

    Smooth normals lie in between: interpolation is of second order, but the mean around a vertex whose triangles
    differ is not."""
    errors = []
    for fineness in (3, 4, 5):
        mesh = trimesh.creation.icosphere(subdivisions=fineness, radius=20.0)
        built = shape("mesh", tmp_path, file=write(tmp_path, mesh, "sphere.ply"), normals="smooth")
        origin, direction = toward(np.random.default_rng(35), 4000, np.zeros(3), 30.0, 100.0)
        _, distance, _, surface = meet(built, origin, direction)
        exact, _ = shape("sphere", radius_mm=20.0).intersect(origin, direction, 0.0)
        out = surface.position / np.linalg.norm(surface.position, axis=1)[:, np.newaxis]
        errors.append(
            (
                np.abs(distance - exact).mean(),
                np.linalg.norm(surface.shading - out, axis=1).mean(),
                np.linalg.norm(surface.normal - out, axis=1).mean(),
            )
        )
    ratio = np.array(errors[:-1]) / np.array(errors[1:])
    np.testing.assert_allclose(ratio[:, 0], 4.0, rtol=0.1)
    assert np.all(ratio[:, 1] > 2.5)
    np.testing.assert_allclose(ratio[:, 2], 2.0, rtol=0.1)
    assert errors[-1][1] < 1e-3


def test_scale_rotation_and_place(tmp_path: Path) -> None:
    """A box of 1 x 2 x 3 units, 10 mm each, turned by 90 degrees about x: y becomes z, and z becomes -y."""
    built = shape(
        "mesh",
        tmp_path,
        file=write(tmp_path, trimesh.creation.box((1.0, 2.0, 3.0)), "box.stl"),
        scale=10.0,
        center_mm=[5, 6, 7],
        rotation_axis=[2, 0, 0],
        rotation_deg=90,
    )
    vertices: Floats = built.vertices  # type: ignore[attr-defined]
    np.testing.assert_allclose(vertices.min(axis=0), [0, -9, -3], atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), [10, 21, 17], atol=1e-12)
    assert len(vertices) == 8, "an STL file repeats its vertices"


def test_uv_of_the_file_place_a_texture(tmp_path: Path) -> None:
    """A square with vt, turned in its plane: u grows along the tangent; beyond 1 it repeats."""
    text = "v 0 0 0\nv 10 0 0\nv 10 10 0\nv 0 10 0\nvt 0 0\nvt 0 1\nvt -2 1\nvt -2 0\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "sheet.obj").write_text(text)
    built = shape("mesh", tmp_path, file="sheet.obj", open=True)
    assert built.has_uv
    x, y = np.random.default_rng(36).uniform(0.1, 9.9, (2, 100))
    origin, down = np.stack([x, y, np.full(100, 5.0)], axis=-1), np.tile([0.0, 0.0, -1.0], (100, 1))
    surface = meet(built, origin, down)[-1]
    np.testing.assert_allclose(surface.uv, np.stack([(-0.2 * y) % 1.0, x / 10], axis=-1), atol=1e-13)
    np.testing.assert_allclose(surface.tangent, np.tile([0.0, -1.0, 0.0], (100, 1)), atol=1e-15)


def test_a_mesh_without_uv_says_so(tmp_path: Path) -> None:
    assert not shape("mesh", tmp_path, file=write(tmp_path, trimesh.creation.box(), "box.stl")).has_uv


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_normals_of_the_file_shade(tmp_path: Path, kind: str) -> None:
    """A tetrahedron whose file says that its normals point away from its middle."""
    vertices = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    if kind == "obj":
        lines = [f"v {x} {y} {z}\nvn {5 * x} {5 * y} {5 * z}" for x, y, z in vertices]
        lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in faces]
    else:
        lines = ["ply", "format ascii 1.0", "element vertex 4"]
        lines += [f"property double {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
        lines += ["element face 4", "property list uchar int vertex_indices", "end_header"]
        lines += [" ".join(map(str, [*v, *(5 * v)])) for v in vertices]
        lines += ["3 " + " ".join(map(str, face)) for face in faces]
    (tmp_path / f"four.{kind}").write_text("\n".join(lines) + "\n")
    built = shape("mesh", tmp_path, file=f"four.{kind}", normals="file", rotation_axis=[0, 0, 1], rotation_deg=90)
    origin, direction = toward(np.random.default_rng(37), 500, np.zeros(3), 1.0, 10.0)
    surface = meet(built, origin, direction)[-1]
    # a linear function of the position at the corners is that function in between
    out = surface.position / np.linalg.norm(surface.position, axis=1)[:, np.newaxis]
    np.testing.assert_allclose(surface.shading, out, atol=1e-13)
    assert np.all(np.einsum("ij,ij->i", surface.normal, out) > 0.3)


def test_a_mesh_that_is_wound_inside_out_is_turned(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=5.0)
    mesh.invert()
    built = shape("mesh", tmp_path, file=write(tmp_path, mesh, "inverted.ply"))
    assert built.contains([0, 0, 0])
    origin, direction = toward(np.random.default_rng(38), 50, np.zeros(3), 5.0, 30.0)
    assert np.all(np.einsum("ij,ij->i", meet(built, origin, direction)[-1].normal, direction) < 0.0)


def test_triangles_without_area_are_left_out(tmp_path: Path) -> None:
    """A box with a needle and a point among its triangles is the box."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    lines = [f"v {x} {y} {z}" for x, y, z in box.vertices] + ["v 0 0 0", "v 0 0 0.5"]
    faces = [*box.faces.tolist(), [8, 8, 9], [8, 9, 8], [1, 1, 1]]
    (tmp_path / "box.obj").write_text("\n".join(lines + ["f " + " ".join(str(k + 1) for k in f) for f in faces]))
    built = shape("mesh", tmp_path, file="box.obj")
    assert len(built.faces) == 12  # type: ignore[attr-defined]
    distance, _ = built.intersect(np.array([[0.3, 0.2, 9.0]]), np.array([[0.0, 0.0, -1.0]]), 0.0)
    assert distance[0] == pytest.approx(8.0, abs=1e-14)


def test_a_file_cut_short_is_said_to_be_that(tmp_path: Path) -> None:
    (tmp_path / "cut.stl").write_bytes(b"\xff\xfe\x00solid x facet normal 0 0 1 outer loop vertex 0 0")
    with pytest.raises(DataError, match=r"cannot be read as STL: it is damaged, or cut short"):
        Mesh(kind="mesh", file="cut.stl", material="m").build(tmp_path)
