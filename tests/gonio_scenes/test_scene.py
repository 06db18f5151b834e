"""Scene files: what is wrong with one is said in one message that names file, key and remedy."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_scenes.scene import read

from gonio.errors import ConfigError, DataError, GonioError
from tests.gonio_scenes.scenes import SPHERE, scene

DIRECTIONAL = SPHERE["light"][0]
BALL = SPHERE["shape"][0]
FROM_600 = {"wavelength_nm": [600, 700], "value": [0.1, 0.2]}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shape": [BALL | {"radius": 3}]}, r"scene\.toml: unknown key shape\[1\].*radius.*radius_mm"),
        ({"shape": [BALL | {"kind": "torus"}]}, r"shape\[1\].*torus"),
        ({"shape": [BALL | {"radius_mm": -1.0}]}, r"radius_mm = -1"),
        ({"shape": [BALL | {"material": "n"}]}, r'shape\[1\]\.material = "n": no \[material\] table of that name'),
        ({"shape": []}, r"a scene needs one \[\[shape\]\] at least"),
        ({"light": []}, r"a scene needs one \[\[light\]\] at least"),
        ({"light": [DIRECTIONAL | {"toward": [0, 0, 0]}]}, "toward = .* is no direction"),
        ({"light": [DIRECTIONAL | {"irradiance": -1.0}]}, "irradiance"),
        ({"light": [DIRECTIONAL | {"polarisation": [0, 0, 0]}]}, r"light\[1\]\.polarisation.*is no direction"),
        (
            {"light": [DIRECTIONAL | {"polarisation": [2.0, 1.0, 4.0]}]},
            r"light\[1\].*polarisation = .* is parallel to toward: give one that is not",
        ),
        ({"light": [DIRECTIONAL | {"toward": [1e200, 0, 0]}]}, r"light\[1\]\.toward\[1\] = 1e\+200"),
        ({"camera": SPHERE["camera"] | {"position_mm": [0, 0, 1e200]}}, r"camera\.position_mm\[3\] = 1e\+200"),
        ({"camera": SPHERE["camera"] | {"lens_radius_mm": 1e300}}, r"camera\.lens_radius_mm = 1e\+300"),
        ({"light": [DIRECTIONAL | {"spectrum": "D66"}]}, r"light\[1\].*D65"),
        ({"light": [{"kind": "rig", "irradiance": 1.0}]}, r'kind = "rig" is the lamp of camera\.rig, which is missing'),
        (
            {"light": [{"kind": "ambient", "radiance": 1.0}, {"kind": "ambient", "radiance": 2.0}]},
            "one ambient light is all",
        ),
        (
            {"light": [{"kind": "point", "position_mm": [0, 0, 10], "intensity": 1.0}]},
            r"light\[1\] \(point\) lies inside shape\[1\] \(sphere\).*move it outside",
        ),
        ({"camera": SPHERE["camera"] | {"up": [0, 0, 1]}}, "up points along the line of sight: choose another up"),
        ({"camera": SPHERE["camera"] | {"look_at_mm": [0, 0, 1000]}}, "are the same point"),
        ({"camera": {k: v for k, v in SPHERE["camera"].items() if k != "width"}}, "the key width is missing"),
        ({"camera": SPHERE["camera"] | {"rig": "sim"}}, "exclude each other"),
        ({"camera": {"rig": "simm", "pose": {"light_deg": 10}}}, r'no rig named "simm"; did you mean "sim"'),
        ({"wavelength_nm": []}, "wavelength_nm"),
        ({"wavelength_nm": [550, 500]}, "wavelength_nm must grow"),
        ({"wavelength_nm": {"start": 400, "stop": 700, "step": 1e-3}}, "take a larger step"),
        ({"material": {"m": {"model": "lambertian"}}}, r"material\.m.*lambertian.*lambert"),
        ({"material": {"m": {"model": "lambert", "parameters": {"albedo": 1.5}}}}, r"material\.m.*albedo = 1\.5"),
        (
            {"material": {"m": {"model": "lambert", "parameters": {"albedo": FROM_600}}}},
            r"a spectrum from 600 to 700 nm has no value at 550 nm: extend the table",
        ),
        (
            {"wavelength_nm": [5e7], "material": {"m": {"model": "he-torrance", "parameters": {"ior": "Al"}}}},
            r"material\.m: wavelength_nm = 5e\+07: Al .* is known from",
        ),
        (
            {"material": {"m": {"model": "lambert", "textures": {"albedo": {"file": "no.png"}}}}},
            r"material\.m\.textures\.albedo\.file = .*no\.png.*: there is no such file",
        ),
        (
            {"material": {"m": {"model": "lambert", "textures": {"albedo": {"file": "a.png", "pattern": "dots"}}}}},
            "either file or pattern",
        ),
        (
            {"light": [SPHERE["light"][0] | {"polarisation": [0.0, 1.0, 0.0]}], "material": {"m": {"model": "phong"}}},
            r'material\.m: the model "phong" has no polarised form',
        ),
    ],
)  # fmt: skip
def test_a_wrong_scene_is_refused_with_the_remedy(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(GonioError, match=said) as caught:
        scene(**changes)
    assert str(caught.value).startswith("scene.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no picture that can be read"),
        (b"\x89PNG\r\n\x1a\nrubbish", "no picture that can be read"),
        (np.zeros((2, 2, 3)), r"shape \(2, 2, 3\)"),
        (np.full((2, 2), 2.0), r"outside \[0, 1\]"),
        (np.array([["a"]]), "real numbers"),
        (np.zeros((0, 4)), r"outside \[0, 1\]"),
    ],
)
def test_a_texture_that_is_none_is_refused(tmp_path: Path, content: Any, said: str) -> None:
    (tmp_path / "t.png").write_bytes(content if isinstance(content, bytes) else b"")
    np.save(tmp_path / "t.npy", content)
    name = "t.png" if isinstance(content, bytes) else "t.npy"
    with pytest.raises(DataError, match=said):
        scene(tmp_path, material={"m": {"model": "lambert", "textures": {"albedo": {"file": name}}}})


def test_a_texture_stands_upright_and_is_read_where_it_is_hit(tmp_path: Path) -> None:
    import cv2

    image = np.array([[0, 255], [51, 102]], dtype=np.uint8)  # the upper row first
    cv2.imwrite(str(tmp_path / "t.png"), image)
    textures = {"albedo": {"file": "t.png", "low": 0.2, "high": 0.7}}
    material = scene(tmp_path, material={"m": {"model": "lambert", "textures": textures}}).material[0]
    uv = np.array([[0.1, 0.9], [0.9, 0.9], [0.1, 0.1], [0.9, 0.1]])
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    expected = (0.2 + 0.5 * image.ravel() / 255.0) / np.pi
    np.testing.assert_allclose(material.brdf(up, up, uv)[:, 0], expected, rtol=1e-14)


def test_the_light_of_a_room_may_be_in_the_room_with_the_camera() -> None:
    room = {"kind": "box", "size_mm": [4000.0, 4000.0, 4000.0], "material": "m"}
    lamp = {"kind": "point", "position_mm": [500.0, 500.0, 500.0], "intensity": 1e6}
    assert scene(shape=[BALL, room], light=[lamp]).world.casts_shadows


def test_a_scene_is_read_from_a_file_and_a_missing_one_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: there is no such file"):
        read(tmp_path / "none.toml")
    (tmp_path / "s.toml").write_text("name = 'x'\n[camera]\nwidht = 3\n")
    with pytest.raises(ConfigError, match=r"s\.toml: .*camera.*widht; did you mean \"width\"|wavelength_nm is missing"):
        read(tmp_path / "s.toml")
