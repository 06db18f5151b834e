"""Pictures that cannot be measured: damaged, constant, black, cut off."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_scenes.photograph import reduce
from gonio_scenes.render import render

from gonio.errors import GonioError
from gonio.lab.rig.dng import encode_dng, read_raw
from gonio.lab.rig.protocols import Frame
from gonio.typing import Floats
from tests.gonio_scenes.test_photograph import CAMERA, SENSOR, described, good, mosaic, raw

SHAPE = (CAMERA["height"], CAMERA["width"])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", b"", "is no NPY array of numbers, or is damaged"),
        ("a.npy", b"no array", "is no NPY array of numbers, or is damaged"),
        ("a.npz", b"no archive", "is no radiance.npz of gonio render, or is damaged"),
        ("a.npz", b"PK", "no radiance.npz"),
        ("a.tif", b"II*", "cannot be read as TIFF"),
        ("a.dng", b"nothing", r"\[photograph.sensor\]"),
        ("a.npy", np.ones(SHAPE, np.uint8), "not linear"),
        ("a.npy", np.ones((*SHAPE, 3)), r"photograph\.channel"),
    ],
)
def test_damaged_and_unfit_pictures_are_refused(name: str, content: Any, message: str, tmp_path: Path) -> None:
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        np.save(tmp_path / name, content)
    with pytest.raises(GonioError, match=message):
        reduce(described(), tmp_path / name)


def test_a_colour_mosaic_without_a_channel_and_a_saturated_picture_are_refused(tmp_path: Path) -> None:
    (tmp_path / "c.dng").write_bytes(mosaic(np.full(SHAPE, 99, np.uint16), "RGGB"))
    with pytest.raises(GonioError, match="colour mosaic"):
        reduce(described(photograph={"sensor": SENSOR}), tmp_path / "c.dng")
    of = described(photograph={"sensor": SENSOR, "exposure_s": 50.0})
    with pytest.raises(GonioError, match="saturated"):
        reduce(of, raw(tmp_path, of))


@pytest.mark.parametrize("name", ["no.npy", "no.dng", "no.exr", "no.npz"])
def test_a_missing_picture_is_a_wrong_argument_as_in_every_command(name: str, tmp_path: Path) -> None:
    with pytest.raises(GonioError, match="there is no such file") as raised:
        reduce(described(photograph={"sensor": SENSOR}), tmp_path / name)
    assert raised.value.exit_code == 2


# --- pictures that hold no light, or are cut off -------------------------------------------------------------------

DIM: dict[str, Any] = {"sensor": SENSOR | {"black_level_dn": 64.0}, "bin": 2}


def dng(values: Floats, folder: Path) -> Path:
    """A raw frame of 12 bits."""
    path = folder / "a.dng"
    path.write_bytes(encode_dng(Frame(np.rint(values).astype(np.uint16), 0.1, 64.0, 4095.0, "mono", time_s=0.0)))
    return path


@pytest.mark.parametrize("value", [0.0, 0.3, -0.2])
def test_a_constant_picture_of_radiances_has_no_values(value: float, tmp_path: Path) -> None:
    for kind in (np.float32, np.float64):
        np.save(tmp_path / "a.npy", np.full(SHAPE, value, kind))
        for noise in ({"noise_rel": 0.01}, {"noise": 0.001}, {"noise_rel": 0.0}):
            with pytest.raises(GonioError, match=r"not one of|holds no light"):
                reduce(described(photograph=noise), tmp_path / "a.npy")


@pytest.mark.parametrize("level", [0, 63, 64, 65, 300, 4095])
@pytest.mark.parametrize("read_noise_e", [0.0, 3.0])
def test_a_constant_raw_frame_has_no_values(level: int, read_noise_e: float, tmp_path: Path) -> None:
    of = described(photograph=DIM | {"sensor": DIM["sensor"] | {"read_noise_e": read_noise_e}})
    with pytest.raises(GonioError, match=r"not one of|holds no light"):
        reduce(of, dng(np.full(SHAPE, float(level)), tmp_path))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("black", [63.3, 64.0, 64.6, 65.5])
def test_a_frame_with_the_lens_covered_has_no_values(seed: int, black: float, tmp_path: Path) -> None:
    """Noise alone, about a black level that is not quite the stated one."""
    noise = np.random.default_rng(seed).normal(black, 1.2, SHAPE)
    for values in (noise, np.maximum(noise, 64.0)):  # the second of a camera that cuts off below its black level
        with pytest.raises(GonioError, match=r"lens open|not one of"):
            reduce(described(photograph=DIM), dng(values, tmp_path))


def test_a_black_sample_is_no_black_picture(tmp_path: Path) -> None:
    black = {"model": "lambert", "parameters": {"albedo": 0.01}}
    of = described(material={"m": black}, photograph=DIM | {"exposure_s": 0.15})
    found = good(reduce(of, raw(tmp_path, of)))
    mean = np.average(found["brdf"], weights=found["u_random"] ** -2.0)
    assert abs(mean - 0.01 / math.pi) < 4.0 * float((found["u_random"] ** -2.0).sum() ** -0.5)  # four standard errors
    assert found["u_brdf"].min() > 0.0


def test_a_frame_that_is_cut_off_below_its_stated_range_is_flagged(tmp_path: Path) -> None:
    of = described(photograph=DIM | {"exposure_s": 0.15})
    path = raw(tmp_path, of)
    values = read_raw(path, path.read_bytes()).mosaic.astype(float)
    table = reduce(of, dng(np.minimum(values, float(np.quantile(values, 0.97))), tmp_path))
    found = good(table)
    assert (table["flag"] == "saturated").sum() > 20
    assert len(found) > 300


def test_no_uncertainty_is_zero_where_a_file_rounds(tmp_path: Path) -> None:
    """Half-precision and single-precision files hold a value to 2^-11 and 2^-24 of it."""
    of = described(photograph={"noise_rel": 0.0, "bin": 1}, material={"m": {"model": "lambert", "parameters": {}}})
    shown = render(of).radiance[..., 0]
    for kind in (np.float16, np.float32):
        np.save(tmp_path / "a.npy", shown.astype(kind))
        found = good(reduce(of, tmp_path / "a.npy"))
        # a uniform error of a step, which is between eps/2 and eps of the value, over sqrt 12
        assert (found["u_random"] / found["brdf"]).min() >= 0.9 * float(np.finfo(kind).eps) / math.sqrt(12.0)
        assert ((found["brdf"] - found["brdf"].median()) / found["u_random"]).std() < 1.5


# --- facets ---------------------------------------------------------------------------------------------------------
