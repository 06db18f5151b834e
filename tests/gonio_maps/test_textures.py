"""Textures of a map: read back they are the parameters, and what was filled in is listed."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from gonio_maps import textures

from gonio.errors import ConfigError, DataError
from gonio.typing import Floats
from tests.command_line import gonio, says
from tests.gonio_maps.map_files import fits

SHAPE = (30, 50)


def written(folder: Path, **more: object) -> tuple[dict[str, Floats], Path]:
    """The parameters of a map (NaN where they are not determined), and its file."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    values = {"s": 0.2 + 0.005 * x, "m": 0.1 + 0.02 * y, "ior": 1.5 + 0.1 * x}
    for value in values.values():
        value[:3, 5:9] = np.nan
    values["ior"][10] = np.nan
    u = {name: 0.01 * value for name, value in values.items()}
    path = fits(folder / "plate.h5", values, u, attrs={"parameters": list(values)}, pixel_mm=0.25, **more)  # type: ignore[arg-type]
    return values, path


def read(folder: Path, name: str) -> Floats:
    """A texture as its description says it is to be read, the lowest y first."""
    told = json.loads((folder / "textures.json").read_text(encoding="utf-8"))["textures"][name]
    codes = np.asarray(cv2.imread(str(folder / told["file"]), cv2.IMREAD_UNCHANGED))
    assert codes.dtype == np.uint16
    return np.asarray(told["low"] + (told["high"] - told["low"]) * codes[::-1] / 65535)


def test_textures_read_back_are_the_parameters(tmp_path: Path) -> None:
    values, path = written(tmp_path)
    gonio(tmp_path, "convert", path, "out", "--to", "textures", expect=0)
    for name, value in values.items():
        known = np.isfinite(value)
        # half of one of 65535 steps of the range, which is 1 for s and m, and 4.9 for the index
        assert np.abs(read(tmp_path / "out", name) - value)[known].max() < (0.51 if name != "ior" else 2.5) / 65535
    told = json.loads((tmp_path / "out" / "textures.json").read_text(encoding="utf-8"))
    assert told["model"] == "cook-torrance"
    assert told["mm_per_pixel"] == pytest.approx(0.25)
    assert (told["textures"]["s"]["low"], told["textures"]["s"]["high"]) == (0.0, 1.0)
    assert told["y_mm"][0] > told["y_mm"][1]
    assert "distribution = beckmann" in told["use"]["mitsuba"]
    assert "sqrt(alpha)" in told["use"]["gltf"]
    assert read(tmp_path / "out", "roughness") == pytest.approx(np.sqrt(read(tmp_path / "out", "m")), abs=2e-5)


def test_what_is_not_determined_has_the_nearest_value_and_is_listed(tmp_path: Path) -> None:
    values, path = written(tmp_path)
    said = gonio(tmp_path, "convert", path, "out", "--to", "textures", expect=0)
    says(said.stderr, "m: 12 of 1500 pixels are filled by the nearest ones")
    with open(tmp_path / "out" / "extrapolated.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for name, value in values.items():
        listed = np.zeros(SHAPE, bool)
        for row in rows:
            if row["parameter"] == name:
                listed[::-1][int(row["row"]), int(row["first_column"]) : int(row["last_column"]) + 1] = True
        assert np.array_equal(listed, np.isnan(value))
    index = read(tmp_path / "out", "ior")
    column = 1.5 + 0.1 * np.arange(SHAPE[1])
    assert index[10] == pytest.approx(column, abs=1e-4)  # the rows beside it have the same
    assert index[0, 5] == pytest.approx(column[4], abs=1e-4)
    assert index[0, 8] == pytest.approx(column[9], abs=1e-4)


def test_files_of_others_are_not_replaced_and_other_sources_are_refused(tmp_path: Path) -> None:
    _, path = written(tmp_path)
    textures.write(str(path), tmp_path / "out")
    textures.write(str(path), tmp_path / "out")  # its own are
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "m.png").write_bytes(b"mine")
    with pytest.raises(ConfigError, match=r"m\.png: was not written by this version"):
        textures.write(str(path), tmp_path / "mine")
    assert [p.name for p in (tmp_path / "mine").iterdir()] == ["m.png"]
    (tmp_path / "t.csv").write_text("theta_i_deg\n", encoding="utf-8")
    says(gonio(tmp_path, "convert", "t.csv", "o", "--to", "textures", expect=2).stderr, "is no map")
    nothing = {"m": np.full((2, 2), np.nan)}
    with pytest.raises(DataError, match="m is determined in no pixel"):
        textures.write(str(fits(tmp_path / "n.h5", nothing, nothing)), tmp_path / "o")
    assert not (tmp_path / "o").exists()
