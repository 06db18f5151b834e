"""Photographs as measurements: values, uncertainties, flags, and what is refused."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from gonio_analysis.commands import fit
from gonio_scenes import picture
from gonio_scenes.commands import photograph
from gonio_scenes.commands import render as render_command
from gonio_scenes.photograph import reduce
from gonio_scenes.render import render
from gonio_scenes.scene import Scene, read

from gonio import instrument, models
from gonio.errors import GonioError
from gonio.geometry import Directions
from gonio.lab.rig.dng import encode_dng
from gonio.lab.rig.protocols import Frame
from gonio.typing import Floats
from tests.gonio_scenes.scenes import scene
from tools.studies import photograph_campaign

CAMERA: dict[str, Any] = {
    "position_mm": [0.0, 0.0, 800.0],
    "look_at_mm": [0.0, 0.0, 0.0],
    "vertical_field_deg": 6.5,
    "width": 120,
    "height": 112,
}
GLOSSY: dict[str, Any] = {
    "model": "he-torrance",
    "parameters": {"sigma0_um": 0.3, "tau_um": 1.6, "ior": [1.5, 0.0], "diffuse_albedo": 0.3},
}
"""Smooth in all directions: V-groove models have kinks."""
SUN = {"kind": "directional", "toward": [0.8, 0.3, 1.0], "irradiance": 2.0}
BULB = {"kind": "point", "position_mm": [700.0, 200.0, 600.0], "intensity": 1.5e6}
LAMP = {
    "kind": "disc", "center_mm": [500.0, 100.0, 500.0], "normal": [-5.0, -1.0, -5.0], "radius_mm": 12.0,
    "radiance": 2000.0, "samples": 32,
}  # fmt: skip
SENSOR: dict[str, Any] = {"responsivity_e_per_s": 5e4, "read_noise_e": 3.0, "prnu": 0.004, "dsnu_e": 2.0}
EXACT: dict[str, Any] = {"noise_rel": 0.0}
"""A picture without noise."""


def described(**changes: Any) -> Scene:
    """A glossy sphere under a directional light, with the table [photograph]."""
    base: dict[str, Any] = {"camera": CAMERA, "material": {"m": GLOSSY}, "light": [SUN], "photograph": EXACT}
    return scene(**base | changes)


def linear(folder: Path, of: Scene) -> Path:
    """The radiances of a scene as a file without noise."""
    path = folder / "radiance.npy"
    np.save(path, render(of).radiance[..., 0])
    return path


def raw(folder: Path, of: Scene) -> Path:
    """The simulated raw frame of a scene."""
    path = folder / "photograph.dng"
    path.write_bytes(encode_dng(picture.photograph(of, render(of))))
    return path


def good(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that may be used."""
    return table[table["flag"] == ""].reset_index(drop=True)


def truth(table: pd.DataFrame, material: dict[str, Any]) -> Floats:
    """The model at the rows' directions."""
    model = models.build(material["model"], material["parameters"])
    return np.asarray(model.brdf(*Directions.from_table(table).angles, wavelength_nm=550.0))


@pytest.mark.parametrize("light", [SUN, BULB])
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_without_noise_every_row_is_the_model_at_its_directions(
    light: dict[str, Any], size: int, tmp_path: Path
) -> None:
    of = described(light=[light], photograph=EXACT | {"bin": size})
    found = good(reduce(of, linear(tmp_path, of)))
    assert len(found) > 100
    error = found["brdf"].to_numpy() / truth(found, GLOSSY) - 1.0
    # a pixel is the model itself; a square's mean is brought to its middle but for fourth derivatives, which grow with
    # the fourth power of its side
    assert np.abs(error).max() < (1e-9 if size == 1 else 4e-4 * (size / 5) ** 4 + 4e-5)


@pytest.mark.parametrize("light", [SUN, LAMP])
def test_a_raw_frame_scatters_as_its_uncertainty_says(light: dict[str, Any], tmp_path: Path) -> None:
    of = described(
        light=[light], photograph={"sensor": SENSOR | {"cos4": True, "vignetting": 0.2}, "exposure_s": 0.15, "bin": 3}
    )
    found = good(reduce(of, raw(tmp_path, of)))
    pull = (found["brdf"] - truth(found, GLOSSY)) / found["u_random"]
    n = len(found)
    assert n > 300
    # four standard errors of a mean and of a standard deviation
    assert abs(pull.mean()) < 4.0 / math.sqrt(n)
    assert abs(pull.std() - 1.0) < 4.0 / math.sqrt(2 * n)
    assert found["u_brdf"].tolist() == found["u_random"].tolist()  # no cause is stated


CAUSES: list[tuple[str, float, str, dict[str, Any], dict[str, Any]]] = [
    ("irradiance_rel", 0.02, "s_irradiance", SUN, {"light": [SUN | {"irradiance": 2.04}]}),
    ("center_mm", 0.1, "s_center_x", SUN, {"center_mm": [0.1, 0.0, 0.0]}),
    ("center_mm", 0.1, "s_center_y", BULB, {"center_mm": [0.0, 0.1, 0.0]}),
    ("center_mm", 0.5, "s_center_z", BULB, {"center_mm": [0.0, 0.0, 0.5]}),
    ("radius_mm", 0.1, "s_radius", SUN, {"radius_mm": 40.1}),
    ("light_mm", 2.0, "s_light_x", BULB, {"light": [BULB | {"position_mm": [702.0, 200.0, 600.0]}]}),
    ("light_mm", 2.0, "s_light_y", LAMP, {"light": [LAMP | {"center_mm": [500.0, 102.0, 500.0]}]}),
    ("camera_mm", 0.5, "s_camera_x", SUN, {"position_mm": [0.5, 0.0, 800.0], "look_at_mm": [0.5, 0.0, 0.0]}),
    ("camera_mm", 0.5, "s_camera_z", SUN, {"position_mm": [0.0, 0.0, 800.5]}),
    ("pointing_deg", 0.01, "s_camera_pan", SUN, {"look_at_mm": [800.0 * math.tan(math.radians(0.01)), 0.0, 0.0]}),
    ("pointing_deg", 0.01, "s_camera_tilt", SUN, {"look_at_mm": [0.0, -800.0 * math.tan(math.radians(0.01)), 0.0]}),
    ("roll_deg", 0.3, "s_camera_roll", SUN, {"up": [math.sin(math.radians(0.3)), math.cos(math.radians(0.3)), 0.0]}),
    (
        "field_rel", 0.002, "s_field", SUN,
        {"vertical_field_deg": 2 * math.degrees(math.atan(1.002 * math.tan(math.radians(3.25))))},
    ),
]  # fmt: skip


def truly(light: dict[str, Any], other: dict[str, Any]) -> Scene:
    """The scene with something else than described."""
    sphere = {"kind": "sphere", "radius_mm": 40.0, "material": "m"}
    sphere |= {k: v for k, v in other.items() if k in ("center_mm", "radius_mm")}
    camera = CAMERA | {k: v for k, v in other.items() if k in CAMERA or k == "up"}
    return described(light=other.get("light", [light]), shape=[sphere], camera=camera)


@pytest.mark.parametrize(("key", "u", "column", "light", "other"), CAUSES, ids=[c[2] for c in CAUSES])
def test_a_column_is_what_its_cause_does_to_the_table(
    key: str, u: float, column: str, light: dict[str, Any], other: dict[str, Any], tmp_path: Path
) -> None:
    told = described(light=[light], photograph=EXACT | {"bin": 3, "uncertainty": {key: u}})
    table = reduce(told, linear(tmp_path, told))
    off = reduce(told, linear(tmp_path, truly(light, other)))
    here = ((table["flag"] == "") & (off["flag"] == "")).to_numpy()
    change = (off["brdf"] - table["brdf"]).to_numpy()[here]
    stated = table[column].to_numpy()[here]
    assert here.sum() > 300
    assert np.abs(stated).max() > 1e-4
    # what is left: the second order of one standard deviation, and directions that the picture does not show
    assert np.sqrt(np.mean((change - stated) ** 2)) < 0.06 * np.sqrt(np.mean(change**2))


def test_the_black_level_is_a_column_of_its_own(tmp_path: Path) -> None:
    given = {"sensor": SENSOR | {"photon_noise": False, "read_noise_e": 0.0, "bits": 16, "electrons_per_dn": 0.16}}
    quiet = {k: v for k, v in given["sensor"].items() if k not in ("prnu", "dsnu_e")} | {"black_level_dn": 500.0}
    ask = {"sensor": quiet, "exposure_s": 0.15, "bin": 3, "uncertainty": {"black_level_dn": 40.0}}
    of = described(photograph=ask)
    path = raw(tmp_path, of)
    table = good(reduce(of, path))
    told = described(photograph=ask | {"sensor": quiet | {"black_level_dn": 460.0}})
    np.testing.assert_allclose(good(reduce(told, path))["brdf"] - table["brdf"], table["s_black_level"], rtol=1e-6)


def test_rows_beside_an_edge_in_shadow_and_saturated_are_flagged(tmp_path: Path) -> None:
    ball = {"kind": "sphere", "radius_mm": 40.0, "material": "m", "name": "ball"}
    other = {"kind": "sphere", "radius_mm": 12.0, "center_mm": [60.0, 12.0, 60.0], "material": "m"}
    ask = {"sensor": SENSOR, "exposure_s": 2.5, "bin": 2, "shape": "ball"}
    of = described(shape=[ball, other], light=[LAMP], photograph=ask)
    shown = render(of)
    table = reduce(of, raw(tmp_path, of))
    assert {"limb", "blocked", "saturated", "grazing", "below_horizon"} <= set(table["flag"])
    found = good(table)
    # not one of the rows is in the lamp's penumbra: all of them are the model itself, within the noise
    assert ((found["brdf"] - truth(found, GLOSSY)) / found["u_random"]).abs().max() < 6.0
    assert found[["theta_i_deg", "theta_r_deg"]].to_numpy().max() <= 80.0
    assert any("other shapes" in note for note in table.attrs["notes"])
    assert (shown.shape == 0).sum() > 1000
    assert 0 < table.attrs["source_solid_angle_sr"] < 2e-3


def mosaic(values: npt.NDArray[np.uint16], pattern: str) -> bytes:
    """A raw file."""
    return encode_dng(Frame(values, 0.1, 64.0, 65535.0, pattern, time_s=0.0))


@pytest.mark.parametrize("channel", ["R", "G", "B"])
def test_a_colour_mosaic_is_measured_by_one_channel(channel: str, tmp_path: Path) -> None:
    sensor = {"responsivity_e_per_s": 3e5, "bits": 16, "electrons_per_dn": 1.0, "full_well_e": 6e4}
    of = described(photograph={"sensor": sensor, "channel": channel, "bin": 4})
    radiance = render(of).radiance[..., 0] * 3e5 * 0.1 + 64.0
    own = np.tile(np.array(list("RGGB")).reshape(2, 2), (CAMERA["height"] // 2, CAMERA["width"] // 2)) == channel
    path = tmp_path / "colour.dng"
    path.write_bytes(mosaic(np.where(own, np.rint(radiance), 999).astype(np.uint16), "RGGB"))
    found = good(reduce(of, path))
    assert len(found) > 100
    # rounding to whole electrons of some thousands, over 4 to 8 pixels
    np.testing.assert_allclose(found["brdf"], truth(found, GLOSSY), rtol=2e-3)


def test_files_of_linear_radiances_give_the_same_table(tmp_path: Path) -> None:
    of = described(photograph={"noise_rel": 0.01})
    shown = render(of)
    picture.write(of, shown, tmp_path / "out")
    expected = reduce(of, tmp_path / "out" / "radiance.npz")
    np.save(tmp_path / "a.npy", shown.radiance[..., 0])
    cv2.imwrite(str(tmp_path / "a.tif"), shown.radiance[..., 0].astype(np.float32))
    for name in ("a.npy", "a.tif"):
        np.testing.assert_allclose(reduce(of, tmp_path / name)["brdf"], expected["brdf"], rtol=1e-6)
    u = good(expected)["u_random"] / good(expected)["brdf"]
    # 1 % over a square of n x n pixels, and what bringing it to the middle adds
    n = expected.attrs["provenance"]["pixels_a_square"]
    assert u.median() == pytest.approx(0.01 / n * (1.0 + (n**2 - 1.0) / (6.0 * n**2)), rel=0.05)


def test_an_exr_gives_the_same_table(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    of = described()
    picture.write(of, render(of), tmp_path / "out", exr=True)
    exact = reduce(of, tmp_path / "out" / "radiance.npz")
    found = reduce(of, tmp_path / "out" / "picture.exr")
    np.testing.assert_allclose(found["brdf"], exact["brdf"], rtol=1e-6)


def test_a_cylinder_is_measured_too(tmp_path: Path) -> None:
    tube = {"kind": "cylinder", "axis": [0.0, 1.0, 0.0], "radius_mm": 30.0, "height_mm": 60.0, "material": "m"}
    of = described(shape=[tube], photograph=EXACT | {"bin": 2, "uncertainty": {"radius_mm": 0.1, "light_deg": 0.1}})
    found = good(reduce(of, linear(tmp_path, of)))
    assert len(found) > 100
    np.testing.assert_allclose(found["brdf"], truth(found, GLOSSY), rtol=1e-3)
    off = good(reduce(of, linear(tmp_path, described(shape=[tube | {"radius_mm": 30.1}]))))
    both = found.merge(off, on=["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"], suffixes=("", "_off"))
    change = both["brdf_off"] - both["brdf"]
    assert np.sqrt(np.mean((change - both["s_radius"]) ** 2)) < 0.06 * np.sqrt(np.mean(change**2))


def test_a_rigs_camera_and_lamp_are_seen_through_their_cones(tmp_path: Path) -> None:
    ball = {"kind": "sphere", "radius_mm": 8.0, "material": "m"}
    camera = {"rig": "sim", "pose": {"light_deg": 30, "camera_deg": 20}, "samples": 16, "width": 96, "height": 72}
    lamp = {"kind": "rig", "irradiance": 2.0, "samples": 4}
    of = described(shape=[ball], camera=camera, light=[lamp], photograph={"noise_rel": 0.01, "bin": 3})
    table = reduce(of, linear(tmp_path, of))
    # lamp and lens of 0.5 degrees at 1 m, and up to 8 mm nearer
    for which in ("source", "receiver"):
        assert table.attrs[f"{which}_solid_angle_sr"] == pytest.approx(math.pi * math.radians(0.5) ** 2, rel=0.02)
    found = good(table)
    assert "mirror" in set(table["flag"])
    expected = instrument.apparent_brdf(
        models.build(GLOSSY["model"], GLOSSY["parameters"]),
        *Directions.from_table(found).angles,
        wavelength_nm=550.0,
        source_solid_angle_sr=table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=table.attrs["receiver_solid_angle_sr"],
    )
    # the noise of 16 rays a pixel, and the lens's blur
    assert np.sqrt(np.mean((found["brdf"] / expected - 1.0) ** 2)) < 4e-3


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"light": [SUN, BULB]}, "one is needed"),
    ({"light": [SUN, {"kind": "ambient", "radiance": 0.1}]}, "lamp off"),
    ({"light": [SUN | {"irradiance": 0.0}]}, "is dark"),
    ({"photograph": None}, r"\[photograph\] is missing"),
    ({"photograph": {}}, "photograph.noise_rel"),
    ({"photograph": EXACT | {"shape": "vase"}}, 'photograph.shape = "vase"'),
    ({"photograph": EXACT | {"uncertainty": {"light_mm": 1.0}}}, "give light_deg"),
    ({"light": [BULB], "photograph": EXACT | {"uncertainty": {"light_deg": 1.0}}}, "give light_mm"),
    ({"photograph": EXACT | {"uncertainty": {"radius_mm": 50.0}}}, "the radius is 40 mm"),
    ({"photograph": EXACT | {"theta_max_deg": 1.0}}, "not one of"),
    ({"camera": CAMERA | {"width": 121}}, "camera.width"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_what_cannot_be_known_is_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((CAMERA["height"], CAMERA["width"])))
    with pytest.raises(GonioError, match=message):
        reduce(described(**changes), tmp_path / "a.npy")


def bumpy(folder: Path, nodes: int, normals: str, seed: int) -> dict[str, Any]:
    """A height field of waves in all directions, up to 25 degrees steep."""
    rng = np.random.default_rng(seed)
    x = np.linspace(-1.0, 1.0, nodes)
    waves, phases = 2.5 * rng.normal(size=(8, 2)), rng.uniform(0.0, 2.0 * math.pi, 8)
    heights = np.cos(np.stack(np.meshgrid(x, x), axis=-1) @ waves.T + phases).sum(axis=-1)
    steep = float(np.hypot(*np.gradient(heights, x, x)).max())
    np.save(folder / "h.npy", heights * math.tan(math.radians(25.0)) / steep)
    return {
        "kind": "heightfield", "file": "h.npy", "size_mm": [70.0, 70.0], "height_mm": 35.0, "normals": normals,
        "material": "m",
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("nodes", [7, 24])
def test_squares_do_not_mix_facets(nodes: int, samples: int, seed: int, tmp_path: Path) -> None:
    shape = bumpy(tmp_path, nodes, "facet", seed)
    of = scene(
        tmp_path, camera=CAMERA | {"samples": samples}, material={"m": GLOSSY}, light=[SUN], shape=[shape],
        photograph=EXACT | {"bin": 3},
    )  # fmt: skip
    found = good(reduce(of, linear(tmp_path, of)))
    assert len(found) > 50
    error = found["brdf"].to_numpy() / truth(found, GLOSSY) - 1.0
    # one facet has one normal; what is left is the perspective over three pixels, 0.17 degrees
    assert np.abs(error).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("normals", ["facet", "smooth"])
def test_causes_of_a_height_field_are_in_its_columns(normals: str, tmp_path: Path) -> None:
    """The scatter that is left beside the columns of light and place, with both displaced."""
    shape = bumpy(tmp_path, 16, normals, 3)
    ask = {"noise_rel": 0.02, "bin": 2, "uncertainty": {"light_deg": 0.2, "center_mm": 0.05}}
    given = {"camera": CAMERA, "material": {"m": GLOSSY}, "photograph": ask}
    told = scene(tmp_path, light=[SUN], shape=[shape], **given)
    sun = SUN | {"toward": [0.8 + 0.004, 0.3 - 0.003, 1.0]}  # 0.2 degrees and less along each axis
    truly = scene(tmp_path, light=[sun], shape=[shape | {"center_mm": [0.06, -0.04, 0.03]}], **given)
    picture_of = render(truly).radiance[..., 0]
    rng = np.random.default_rng(5)
    np.save(tmp_path / "a.npy", picture_of * rng.normal(1.0, 0.02, picture_of.shape))
    found = good(reduce(told, tmp_path / "a.npy"))
    expected = truth(found, GLOSSY)
    columns = [name for name in map(str, found.columns) if name.startswith("s_")]
    # columns are in proportion to the value, whose noise is no part of a cause
    causes = found[columns].to_numpy() * (expected / found["brdf"].to_numpy())[:, None]
    covariance = np.diag(found["u_random"].to_numpy() ** 2) + causes @ causes.T
    residual = found["brdf"].to_numpy() - expected
    n = len(found)
    assert n > 200
    # five standard deviations of chi-square; kinks of smoothed normals have uncertainties that are wide
    ratio = float(residual @ np.linalg.solve(covariance, residual)) / n
    assert (0.6 if normals == "smooth" else 0.8) < ratio < 1.0 + 5.0 * math.sqrt(2.0 / n)


SCENE = """\
name = "a glossy sphere"
wavelength_nm = [550]
[camera]
position_mm = [0, 0, 800]
vertical_field_deg = 6.5
width = 96
height = 96
[[shape]]
kind = "sphere"
radius_mm = 40
material = "m"
[material.m]
model = "oren-nayar"
parameters = { albedo = 0.6, sigma_deg = 20 }
[[light]]
kind = "directional"
toward = [0.8, 0.3, 1.0]
irradiance = 2.0
"""
PHOTOGRAPH = """\
[photograph]
exposure_s = 0.1
seed = 7
[photograph.sensor]
responsivity_e_per_s = 2.5e5
read_noise_e = 2.5
[photograph.uncertainty]
irradiance_rel = 0.01
center_mm = 0.05
"""


def test_the_commands_take_a_photograph_measure_it_and_fit_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out, table = tmp_path / "scene.toml", tmp_path / "out", tmp_path / "photo.csv"
    path.write_text(SCENE, encoding="utf-8")
    render_command(path, out)
    assert not (out / "photograph.dng").exists()
    left_out = [entry["what"] for entry in json.loads((out / "summary.json").read_text())["left_out"]]
    assert "a sensor's frame" in left_out
    path.write_text(SCENE + PHOTOGRAPH, encoding="utf-8")
    render_command(path, out)
    told = json.loads((out / "summary.json").read_text())["photograph"]
    assert (told["exposure_s"], told["saturated_share"]) == (0.1, 0.0)
    photograph(path, out / "photograph.dng", table)
    assert "values" in capsys.readouterr().out
    fit("oren-nayar", str(table), as_json=True)
    found = json.loads(capsys.readouterr().out)
    for name, value in (("albedo", 0.6), ("sigma_deg", 20.0)):
        estimate = found["parameters"][name]
        assert abs(estimate["value"] - value) < 4.0 * estimate["u"]
    assert found["parameters"]["albedo"]["u"] == pytest.approx(0.006, rel=0.1)  # the scale's 1 %


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (PHOTOGRAPH.replace("responsivity_e_per_s = 2.5e5", ""), "responsivity_e_per_s is missing"),
        (PHOTOGRAPH.replace("center_mm", "centre_mm"), 'did you mean "center_mm"'),
        (PHOTOGRAPH[: PHOTOGRAPH.index("[photograph.sensor]")], r"needs the table \[photograph.sensor\]"),
        (PHOTOGRAPH.replace("read_noise_e", "black_level_dn = 5000\nread_noise_e"), "must lie below the highest value"),
    ],
)
def test_a_wrong_table_is_told_by_its_key(changed: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE + changed, encoding="utf-8")
    with pytest.raises(GonioError, match=message) as raised:
        read(tmp_path / "scene.toml")
    assert str(tmp_path / "scene.toml") in str(raised.value)


def test_a_photograph_has_one_wavelength_and_room_for_a_raw_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    for old, new, words in (("[550]", "[550, 600]", "one wavelength"), ("width = 96", "width = 24", "32 x 32")):
        path.write_text(SCENE.replace(old, new) + PHOTOGRAPH, encoding="utf-8")
        with pytest.raises(GonioError, match=words):
            render_command(path, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_blind_spheres_joined_with_sweeps_cover_the_truth(tmp_path: Path) -> None:
    pulls = []
    for number in range(3):
        results, true, _ = photograph_campaign.case(tmp_path, 11, number)
        pulls += list(photograph_campaign.pulls(results["both"], true).values())
    assert len(pulls) == 9
    # nine pulls, some of them tied: beyond 4 once in a thousand times, with a right covariance
    assert np.abs(pulls).max() < 4.0
