"""The report on a map: its numbers are those of the file, and what is not determined is said."""

import csv
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from gonio_analysis.plots.pixels import round_length
from gonio_maps.files import FitFile, Variable
from gonio_maps.report import map_layers, map_page
from gonio_maps.report.map_layers import PICTURE, MapPixels, block_medians

from gonio.errors import DataError
from gonio.geometry import direction
from tests.command_line import gonio, says
from tests.gonio_maps.map_files import axes, fits, values

ROWS, COLS = 40, 70


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A gradient of m, where 5 rows have too few values, 30 pixels are undetermined, and 56 reject the model."""
    y, x = np.mgrid[:ROWS, :COLS]
    flag = np.where(y < 5, 1, np.where((y >= 35) & (x >= 64), 4, np.where((y >= 20) & (y < 22) & (x < 28), 8, 0)))
    truth = {"s": 0.3 + 0.0 * x, "m": 0.1 + 0.01 * x, "ior": 1.5 + 0.0 * y}
    truth = {name: np.where(flag & 5, np.nan, value) for name, value in truth.items()}
    u = {name: 0.02 * value for name, value in truth.items()}
    tau = np.where(flag == 8, 0.05, 0.0)
    path = tmp_path_factory.mktemp("map") / "plate.h5"
    return fits(path, truth, u, flag=flag, tau=tau, attrs={"parameters": list(truth), "fixed": {"k": 0.0}})


@pytest.fixture(scope="module")
def report(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    map_page.make(file, out)
    return out


@pytest.mark.slow
def test_the_numbers_of_the_page_are_those_of_the_file(report: Path) -> None:
    told = json.loads((report / "summary.json").read_text(encoding="utf-8"))
    assert told["model"] == "cook-torrance"
    assert told["fixed"] == {"k": 0.0}
    assert (told["rows"], told["columns"]) == (ROWS, COLS)
    assert told["pixel_mm"] == pytest.approx(0.1)
    assert told["flags"] == {"too_few": 350, "at_bound": 0, "undetermined": 30, "rejected": 56}
    m = told["parameters"]["m"]
    assert m["determined"] == ROWS * COLS - 380
    column = 0.1 + 0.01 * np.arange(COLS)
    known = np.concatenate([np.repeat(column[:64], 35), np.repeat(column[64:], 30)])
    assert m["median"] == pytest.approx(np.median(known))
    assert m["quantile_0.995"] == pytest.approx(np.quantile(known, 0.995))
    assert m["typical_u"] == pytest.approx(0.02 * m["median"])
    assert f"determined in {ROWS * COLS - 380} of {ROWS * COLS} pixels of 0.1 mm" in told["conclusion"]
    assert "2.3 % of those with values reject it, where 1.0 % do by chance" in told["conclusion"]  # 56 of 2450


@pytest.mark.slow
def test_every_parameter_has_maps_with_stated_colours(report: Path) -> None:
    told = json.loads((report / "summary.json").read_text(encoding="utf-8"))
    captions = {one["name"]: one["caption"] for one in told["figures"]}
    names = ["map-s", "map-u-s", "map-m", "map-u-m", "map-ior", "map-u-ior", "map-misfit", "map-flags", "histograms"]
    assert list(captions) == names
    assert captions["map-m"].startswith("m: colours from 0.100 to 0.790, quantiles 0.005 and 0.995")
    assert "Grey: not determined, 380 of 2800 pixels" in captions["map-m"]
    page = (report / "index.html").read_text(encoding="utf-8")
    assert page.count("<figure") == len(names)
    with open(report / "tables" / "histograms.csv", encoding="utf-8") as stream:
        counts = [int(row["pixels"]) for row in csv.DictReader(stream) if row["parameter"] == "m"]
    assert sum(counts) == ROWS * COLS - 380  # the first and the last column have more than half a percent each


def test_what_is_not_determined_is_nan_and_a_bound_has_no_uncertainty(tmp_path: Path) -> None:
    m = np.array([[0.2, 0.2, np.nan], [np.nan, np.nan, 0.2]])
    u = np.array([[0.01, np.nan, np.nan], [np.nan, 0.01, 0.01]])
    with FitFile(fits(tmp_path / "f.h5", {"m": m}, {"m": u}, flag=[[0, 2, 4], [1, 4, 8]])) as found:
        value, uncertainty = found.parameter("m")
    assert np.isfinite(value).tolist() == [[True, True, False], [False, False, True]]
    assert np.isfinite(uncertainty).tolist() == [[True, False, False], [False, False, True]]


def test_a_picture_has_medians_of_blocks_of_what_is_determined() -> None:
    x, y = axes(2, 2 * PICTURE)
    value = np.full((2, 2 * PICTURE), np.nan)
    value[:, :4] = [[1.0, 2.0, 5.0, np.nan], [3.0, 10.0, 7.0, np.nan]]
    picture = block_medians(MapPixels(x, y), value)
    assert picture.shape == (1, PICTURE)
    assert picture[0, :2].tolist() == [2.5, 6.0]
    assert np.isnan(picture[0, 2:]).all()


def test_pictures_have_ascending_axes() -> None:
    x, y = axes(2, 3)
    value = np.arange(6.0).reshape(2, 3)
    assert block_medians(MapPixels(x[::-1], y[::-1]), value).tolist() == value[::-1, ::-1].tolist()


def test_nothing_determined_is_a_spread_without_numbers() -> None:
    spread = map_layers.spread(np.full((3, 3), np.nan))
    assert spread.determined == 0
    assert np.isnan(spread.median)


@pytest.mark.parametrize(("most", "length"), [(1.0, 1.0), (0.99, 0.5), (0.21, 0.2), (7.0, 5.0), (30.0, 20.0)])
def test_rulers_have_round_lengths(most: float, length: float) -> None:
    assert round_length(most) == pytest.approx(length)


def test_options_of_fits_and_a_missing_folder_are_refused(file: Path, tmp_path: Path) -> None:
    said = gonio(tmp_path, "report", file, expect=2)
    says(said.stderr, "needs a folder: --out DIR")
    said = gonio(tmp_path, "report", file, "--out", "o", "--metric", "log", expect=2)
    says(said.stderr, "--metric")
    assert not (tmp_path / "o").exists()


def test_a_map_of_values_is_no_map_of_fits(tmp_path: Path) -> None:
    one, at = np.ones((2, 2, 3)), np.tile([0.0, 0.0, 1000.0], (3, 1))
    path = values(tmp_path / "v.h5", one, 0.01 * one, at, at, np.zeros((4, 3)))
    with pytest.raises(DataError, match="is a map of values, not of fits: gonio fit"):
        FitFile(path)


@pytest.mark.slow
def test_materials_have_a_map_and_a_table(tmp_path: Path) -> None:
    shape = (6, 10)
    member = np.zeros(shape, np.int16)
    member[:, 7:] = 1
    member[0, 0] = -1
    each = ("material",)
    given = {
        "membership": Variable(("y", "x"), member, "i2"),
        "material_pixels": Variable(each, np.array([41, 18]), "i8"),
        "material_chi_square": Variable(each, np.array([1.02, 0.97])),
        "material_m": Variable(each, np.array([0.2, 0.4])),
        "u_material_m": Variable(each, np.array([0.001, 0.002])),
    }
    m = np.where(member == 1, 0.4, 0.2)
    path = fits(tmp_path / "f.h5", {"m": m}, {"m": 0.05 * m}, given=given, material=2)
    map_page.make(path, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    first, second = told["materials"]
    assert first == {"share": pytest.approx(41 / 60), "pixels": 41, "chi_square": 1.02, "m": 0.2, "u_m": 0.001}
    assert second["share"] == pytest.approx(0.3)
    assert "map-materials" in [f["name"] for f in told["figures"]]
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "0.4000 ± 0.0020" in page.replace("\u00a0", " ")
    assert "materials.csv" in told["tables"]


@pytest.mark.slow
def test_the_page_of_a_map_of_values(tmp_path: Path) -> None:
    theta_r = np.arange(-60.0, 61.0, 10.0)
    n = theta_r.size
    nominal = np.array([np.full(n, 30.0), np.zeros(n), np.abs(theta_r), np.where(theta_r >= 0, 180.0, 0.0)])
    at = np.radians(nominal)
    brdf = np.full((5, 8, n), 0.25)
    brdf[..., theta_r == 30.0] = 0.75
    flag = np.zeros(brdf.shape, np.uint8)
    flag[0, 0] = 1  # outside
    flag[2, 3, :4] = 2  # saturated
    path = values(
        tmp_path / "v.h5", brdf, 0.02 * brdf, 500 * direction(*at[:2]), 500 * direction(*at[2:]), nominal, flag=flag
    )
    gonio(tmp_path, "report", path, "--out", "o", expect=0)
    told = json.loads((tmp_path / "o" / "summary.json").read_text(encoding="utf-8"))
    assert told["flags"] == {"outside": n, "saturated": 4, "hot": 0, "shadowed": 0, "blurred": 0}
    assert told["usable"] == pytest.approx(1 - (n + 4) / (40 * n))
    mirror = told["parameters"]["BRDF at θi = 30°, θr = 30°"]
    assert (mirror["determined"], mirror["median"]) == (39, pytest.approx(0.75))
    assert mirror["typical_u"] == pytest.approx(0.015, rel=1e-6)  # float32 in the file
    assert "a standard uncertainty of its own of 2.0 %" in told["conclusion"]
    assert "shifts up to 0.010 mm along x or y, u up to 0.010 mm" in page_of(tmp_path / "o")
    said = gonio(tmp_path, "report", path, "--out", "p", "--map", path, expect=2)
    says(said.stderr, "is a map of values itself")
    u_shift = np.tile([0.002, np.nan], (n, 1))  # an edge along y: nothing tells the shift along it
    with h5py.File(path, "r+") as held:
        held["u_shift_mm"][...], held["shift_mm"][:, 1] = u_shift, 0.5
    assert gonio(tmp_path, "report", path, "--out", "e", expect=0).stderr.count("Warning") == 0
    assert "shifts up to 0.010 mm along x or y, u up to 0.0020 mm" in page_of(tmp_path / "e")


def page_of(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8").replace("\u00a0", " ")
