"""Bad input: one message that names the key or the file, and what to do."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_scenes.shapes import AnyShape

from gonio.config import Strict, parse
from gonio.errors import ConfigError, DataError
from tests.gonio_scenes.shapes.solids import shape


class Scene(Strict):
    shape: list[AnyShape]


def refusal(**keys: Any) -> str:
    with pytest.raises(ConfigError) as told:
        parse(Scene, {"shape": [{"material": "white", **keys}]}, "scene.toml")
    return str(told.value)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"kind": "sphere"}, "radius_mm is missing"),
        ({"kind": "sphere", "radius_mm": -1}, "radius_mm = -1: must be greater than 0"),
        ({"kind": "sphere", "radius_mm": float("nan")}, "radius_mm = nan"),
        ({"kind": "sphere", "radius_mm": 1e12}, "less than or equal to 1000000000"),
        ({"kind": "sphere", "radius_mm": 1, "axis": [0, 0, 0]}, "is no direction"),
        ({"kind": "sphere", "radius_mm": 1, "center_mm": [0, 0]}, "center_mm"),
        ({"kind": "sphere", "radius_mm": 1, "radius": 1}, "unknown key shape[1].radius; did you mean"),
        ({"kind": "disc", "radius_mm": 1, "normal": [0, 0, 0]}, "is no direction"),
        ({"kind": "disc", "radius_mm": 1, "normal": [0, 0, 2], "x_axis": [0, 0, -1]}, "parallel to normal"),
        ({"kind": "box", "size_mm": [1, 2, 3], "axis": [1, 1, 0], "x_axis": [2, 2, 0]}, "parallel to axis"),
        ({"kind": "box", "size_mm": [1, 0, 3]}, "size_mm[2] = 0"),
        ({"kind": "cylinder", "radius_mm": 1}, "height_mm is missing"),
        ({"kind": "plane", "tile_mm": [1, -1]}, "tile_mm[2] = -1"),
        ({"kind": "revolution", "profile_mm": [[1, 2]]}, "must hold at least 2, and holds 1"),
        ({"kind": "revolution", "profile_mm": [[1, 2], [-0.5, 3]]}, "profile_mm[2] has r = -0.5"),
        ({"kind": "revolution", "profile_mm": [[1, 2], [1, 2]]}, "[1] and [2] are one point"),
        ({"kind": "revolution", "profile_mm": [[0, 2], [0, 3]]}, "lies on the axis"),
        (
            {"kind": "revolution", "profile_mm": [[0, 0], [10, 0], [10, 10], [5, 5], [12, 5], [0, 20]]},
            "profile_mm crosses itself between [2], [3] and [4], [5]",
        ),
        ({"kind": "mesh"}, "file is missing"),
        ({"kind": "mesh", "file": "a.obj", "normals": "flat"}, "normals = 'flat'"),
        ({"kind": "mesh", "file": "a.obj", "scale": 0}, "scale = 0"),
        ({"kind": "spere", "radius_mm": 1}, "kind"),
    ],
)
def test_a_wrong_key_is_named(keys: dict[str, Any], says: str) -> None:
    text = refusal(**keys)
    assert says in text
    assert text.startswith("scene.toml: ")
    assert "\n" not in text


def test_a_smooth_profile_that_crosses_the_axis_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"profile_mm: the smooth curve crosses the axis near point \d"):
        shape("revolution", profile_mm=[[30, 0], [0.1, 10], [0.1, 30], [30, 40]], smooth=True)


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
PLY = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("name", "content", "keys", "says"),
    [
        ("cup.obj", SQUARE + "f 1 2 3 4\n", {}, "is open: 4 edges belong to one triangle only.*open = true"),
        ("cup.obj", TETRAHEDRON + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 3 4\n", {}, "wound in different directions"),
        ("cup.obj", SQUARE + "f 1 2 3\nf 1 4 3\nf 1 2 3\n", {"open": True, "normals": "smooth"}, "wound.*facet"),
        ("cup.obj", "", {}, "holds no triangles"),
        ("cup.obj", "hello\n", {}, "holds no triangles"),
        ("cup.obj", SQUARE, {}, "holds no triangles"),
        ("cup.obj", SQUARE + "f 1 2 9\n", {}, "cannot be read as OBJ"),
        ("cup.obj", SQUARE + "f 1 2 x\n", {}, "cannot be read as OBJ|holds no triangles"),
        (
            "cup.obj",
            "v 0 0 0\nv nan 0 0\nv 1 1 0\nf 1 2 3\n",
            {},
            "1 of its triangles have vertices that are no finite",
        ),
        ("cup.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", {"open": True}, "all of its triangles are points or lines"),
        ("cup.obj", "v 0 0 0\nf 1 1 1\n", {"open": True}, "all of its triangles are points or lines"),
        (
            "cup.obj",
            SQUARE + "f 1 2 3 4\n",
            {"open": True, "normals": "file"},
            'has no normals: say normals = "smooth"',
        ),
        ("cup.obj", SQUARE + "f 1 2 3 4\n", {"open": True, "scale": 1e9, "center_mm": [9, 0, 0]}, "beyond 1e.09 mm"),
        ("cup.ply", "hello", {}, "cannot be read as PLY: Not a ply"),
        ("cup.ply", PLY.format(400000000000) + "end_header\n0", {}, "cannot be read as PLY"),
        ("cup.stl", "", {}, "cannot be read as STL|holds no triangles"),
        ("cup.stl", b"\0" * 80 + b"\xff\xff\xff\xff" + b"\0" * 100, {}, "cannot be read as STL"),
        ("cup.gltf", "", {}, "give an OBJ, PLY or STL file"),
    ],
)
def test_a_mesh_that_is_none_is_refused(
    tmp_path: Path, name: str, content: str | bytes, keys: dict[str, Any], says: str
) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises((ConfigError, DataError), match=says) as told:
        shape("mesh", tmp_path, file=name, **keys)
    assert f'file = "{name}" ({tmp_path / name})' in str(told.value)
    assert "\n" not in str(told.value)


def test_an_stl_file_has_no_normals_to_shade_with(tmp_path: Path) -> None:
    text = (
        "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\nendsolid"
    )
    (tmp_path / "sheet.stl").write_text(text)
    with pytest.raises(DataError, match="an STL file holds those of facets only"):
        shape("mesh", tmp_path, file="sheet.stl", open=True, normals="file")


def test_a_missing_mesh_and_a_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'file = "no\.obj".*there is no such file'):
        shape("mesh", tmp_path, file="no.obj")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(ConfigError, match=r"folder\.obj.*cannot be read"):
        shape("mesh", tmp_path, file="folder.obj")


def test_an_absurdly_large_mesh_is_not_read(tmp_path: Path) -> None:
    with open(tmp_path / "large.stl", "wb") as file:
        file.truncate(10**12)  # no room on the disk is taken
    with pytest.raises(DataError, match="has 1000000 MB, and at most 250 MB are read"):
        shape("mesh", tmp_path, file="large.stl")


def test_without_embree_the_message_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("embreex", "embreex.mesh_construction", "embreex.rtcore_scene"):
        monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / "sheet.obj").write_text(SQUARE + "f 1 2 3 4\n")
    with pytest.raises(ConfigError, match="pip install embreex"):
        shape("mesh", tmp_path, file="sheet.obj", open=True)


def test_shapes_that_are_no_meshes_need_no_embree_and_no_mesh_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("embreex", "trimesh"):
        monkeypatch.setitem(sys.modules, module, None)
    distance, _ = shape("sphere", radius_mm=1).intersect(np.array([[0.0, 0, 3]]), np.array([[0.0, 0, -1]]), 0.0)
    assert distance[0] == 2.0
