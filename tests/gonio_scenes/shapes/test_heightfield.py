"""Height fields: where the picture's values lie, smooth normals, and pictures that are none.

Rays are held against Moeller and Trumbore's test of all triangles, in float64.
"""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gonio_scenes.shapes import Shape

from gonio.errors import ConfigError, DataError
from gonio.typing import Floats
from tests.gonio_scenes.shapes.solids import check_frame, meet, shape, toward


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


def corners_of(built: Shape) -> Floats:
    return np.asarray(built.vertices[built.faces])  # type: ignore[attr-defined]


def field(folder: Path, values: npt.NDArray[Any], **keys: Any) -> Shape:
    name = "heights.npy" if values.dtype == np.float64 else "heights.png"
    if name.endswith("npy"):
        np.save(folder / name, values)
    else:
        (folder / name).write_bytes(png(values))
    return shape("heightfield", folder, file=name, **{"size_mm": [40, 20], "height_mm": 5.0, **keys})


def png(values: npt.NDArray[Any]) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", values)[1])


def above(built: Shape, x: Floats, y: Floats) -> tuple[Floats, Any]:
    """Heights over points of the plane z = 0, from above, and the surface."""
    origin = np.stack([x, y, np.full_like(x, 100.0)], axis=-1)
    down = np.tile([0.0, 0.0, -1.0], (len(x), 1))
    distance, part = built.intersect(origin, down, 0.0)
    return 100.0 - distance, built.surface(origin, down, distance, part)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float64])
def test_values_lie_at_their_places_with_row_0_at_the_top(tmp_path: Path, kind: Any) -> None:
    rng = np.random.default_rng(41)
    white = 1.0 if kind is np.float64 else float(np.iinfo(kind).max)
    values = (rng.random((4, 6)) * white).astype(kind)
    built = field(tmp_path, values)
    rows, columns = np.mgrid[:4, :6]
    u, v = columns.ravel() / 5, 1.0 - rows.ravel() / 3
    # inside the rim by more than float32 rounds it; slopes are at most 5 mm in 6.7 mm
    x, y = 40 * (u - 0.5) * (1 - 1e-6), 20 * (v - 0.5) * (1 - 1e-6)
    height, surface = above(built, x, y)
    np.testing.assert_allclose(height, 5.0 * values.ravel() / white, atol=5e-5)
    np.testing.assert_allclose(surface.uv, np.stack([u, v], axis=-1), atol=1e-6)
    inner = (abs(x) < 19.0) & (abs(y) < 9.0)
    exact, _ = above(built, 40 * (u[inner] - 0.5), 20 * (v[inner] - 0.5))
    np.testing.assert_allclose(exact, 5.0 * values.ravel()[inner] / white, atol=1e-9)
    check_frame(surface)


def test_a_slope_is_met_exactly_and_faces_up(tmp_path: Path) -> None:
    """Heights 5 u + 10 v on 40 x 20 mm: a plane of the slopes 1/8 and 1/2, with tangent along growing u."""
    v, u = np.meshgrid(np.linspace(1, 0, 9), np.linspace(0, 1, 12), indexing="ij")
    for normals in ("facet", "smooth"):
        built = field(tmp_path, u + 2 * v, normals=normals)
        x, y = np.random.default_rng(42).uniform(-0.999, 0.999, (2, 500)) * [[20], [10]]
        height, surface = above(built, x, y)
        np.testing.assert_allclose(height, 5 * (x / 40 + 0.5) + 10 * (y / 20 + 0.5), atol=1e-12)
        normal = np.array([-0.125, -0.5, 1.0]) / np.sqrt(1 + 0.125**2 + 0.25)
        np.testing.assert_allclose(surface.normal, np.tile(normal, (500, 1)), atol=1e-12)
        np.testing.assert_allclose(surface.shading, np.tile(normal, (500, 1)), atol=1e-12)
        along_u = np.array([1.0, 0.0, 0.125]) / np.hypot(1.0, 0.125)
        np.testing.assert_allclose(surface.tangent, np.tile(along_u, (500, 1)), atol=1e-12)


def test_smooth_normals_are_those_of_the_function_that_was_sampled(tmp_path: Path) -> None:
    """z = 2 sin(k x) on a grid of 0.2 mm: central differences are off by k^3 h^2 / 3 and interpolation by k^3 h^2 / 4
    of 2, together 4e-3 at most; facets by k^2 h."""
    k = 2 * np.pi / 20
    built = field(tmp_path, np.tile(2 * np.sin(k * np.linspace(-20, 20, 201)) / 5 + 0.5, (101, 1)), normals="smooth")
    at_x, at_y = np.random.default_rng(43).uniform(-0.98, 0.98, (2, 2000)) * [[20], [10]]
    _, surface = above(built, at_x, at_y)
    slope = 2 * k * np.cos(k * at_x)
    exact = np.stack([-slope, 0 * slope, np.ones_like(slope)], axis=-1) / np.hypot(1, slope)[:, np.newaxis]
    smooth, facet = (np.linalg.norm(n - exact, axis=1).max() for n in (surface.shading, surface.normal))
    assert smooth < 4e-3
    assert facet > 5 * smooth


@pytest.mark.parametrize("far", [90.0, 1e6])
@pytest.mark.parametrize("nodes", [(20, 30), (2, 2), (3, 60)])
def test_rays_from_all_sides_meet_its_triangles(tmp_path: Path, nodes: tuple[int, int], far: float) -> None:
    values = np.random.default_rng(44).random(nodes)
    built = field(tmp_path, values, height_mm=-8.0, normal=[1, 1, 0], x_axis=[0, 0, 1], center_mm=[1, 2, 3])
    assert not built.closed
    origin, direction = toward(np.random.default_rng(45), 300, np.array([1.0, 2.0, 3.0]), 40.0, far)
    distance, _ = built.intersect(origin, direction, 0.0)
    near = far - 90.0
    slow, _ = brute(origin + near * direction, direction, corners_of(built))
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(slow))
    hit = np.isfinite(slow)
    assert hit.sum() > 50
    # a far origin is rounded to 1e-10 of a millimetre; slopes of up to 60 magnify that at grazing
    np.testing.assert_allclose(distance[hit] - near, slow[hit], rtol=0, atol=1e-11 if near == 0 else 1e-6)


def test_no_ray_slips_through_an_edge_or_a_vertex(tmp_path: Path) -> None:
    """Rays at inner vertices and at the middles of inner edges: between triangles but for rounding."""
    built = field(tmp_path, np.random.default_rng(46).random((12, 15)), normal=[1, 2, 3], center_mm=[7, 8, 9])
    corners = corners_of(built)
    goals = np.concatenate([corners.reshape(-1, 3), (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2])
    up = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    origin = goals + 50.0 * up
    distance, _ = built.intersect(origin, np.tile(-up, (len(goals), 1)), 0.0)
    np.testing.assert_allclose(distance, 50.0, rtol=0, atol=1e-6)  # 1e-10 of a facet outside, on slopes of 10


def test_shadow_rays_do_not_meet_the_facet_that_they_start_on(tmp_path: Path) -> None:
    built = field(tmp_path, np.random.default_rng(47).random((9, 11)), height_mm=9.0)
    first = toward(np.random.default_rng(48), 3000, np.zeros(3), 20.0, 60.0)
    position = meet(built, *first)[-1].position
    light = np.tile(np.array([0.6, 0.0, 0.8]), (len(position), 1))
    nearest = 1e-9 * built.size_mm
    distance, _ = built.intersect(position, light, nearest)
    slow, _ = brute(position, light, corners_of(built), nearest)
    np.testing.assert_array_equal(np.isfinite(distance), np.isfinite(slow))
    assert 0.1 < np.isfinite(slow).mean() < 0.9


GREY = np.full((5, 5), 7, np.uint8)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("heights.png", b"", "is not a PNG file"),
        ("heights.png", png(np.arange(10000, dtype=np.uint8).reshape(100, 100))[:-40], "damaged or cut"),
        ("heights.png", png(np.stack([GREY] * 3, axis=-1)), "in colour"),
        ("heights.png", png(GREY[:1]), "1 x 5 values: at least 2 x 2"),
        ("heights.png", png(np.zeros((2000, 2000), np.uint8)), "2000 x 2000 values, and at most"),
        ("heights.jpg", b"x", "are read from a grey PNG"),
        ("heights.npy", b"x", "cannot be read as NPY"),
        ("heights.npy", np.zeros((3, 3, 3)), r"an array \(3, 3, 3\) of float64"),
        ("heights.npy", np.array([["a", "b"], ["c", "d"]]), "heights are numbers"),
        ("heights.npy", np.array([[1.0, np.nan], [0.0, 1.0]]), "not finite"),
        ("heights.npy", np.array([[1e300, 1.0], [0.0, 1.0]]), "beyond 1e.09 mm: lower height_mm"),
        ("heights.npy", np.array([[None, 1], [1, 1]], dtype=object), "heights are numbers"),
    ],
)
def test_what_is_no_height_field_is_refused(tmp_path: Path, name: str, content: Any, says: str) -> None:
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        np.save(tmp_path / name, content)
    with pytest.raises((ConfigError, DataError), match=says) as told:
        shape("heightfield", tmp_path, file=name, size_mm=[1, 1], height_mm=1)
    assert name in str(told.value)
    assert "\n" not in str(told.value)


def test_an_array_that_claims_to_be_huge_is_not_allocated(tmp_path: Path) -> None:
    np.save(tmp_path / "heights.npy", np.zeros((2, 2)))
    data = (tmp_path / "heights.npy").read_bytes().replace(b"(2, 2), }        ", b"(9000000, 90000)}")
    (tmp_path / "heights.npy").write_bytes(data)
    with pytest.raises(DataError, match="9000000 x 90000 values, and at most"):
        shape("heightfield", tmp_path, file="heights.npy", size_mm=[1, 1], height_mm=1)


def test_a_missing_picture_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'file = "no\.png".*there is no such file'):
        shape("heightfield", tmp_path, file="no.png", size_mm=[1, 1], height_mm=1)
