"""Materials that pixels share: how many, which pixel is of which, and what they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.fitting.problem import FitRequest
from gonio_maps.files import MapFile
from gonio_maps.fits import fits
from gonio_maps.fits.materials import _k_means

from gonio.errors import ConfigError, DataError
from tests.command_line import gonio
from tests.gonio_maps.fits.made import write

PAINTS: tuple[dict[str, Any], ...] = (
    {"s": 0.4, "d": 0.6, "m": 0.3, "diffuse_albedo": 0.5, "ior": 1.5},
    {"s": 0.4, "d": 0.6, "m": 0.24, "diffuse_albedo": 0.5, "ior": 1.5},
    {"s": 0.5, "d": 0.5, "m": 0.3, "diffuse_albedo": 0.2, "ior": 1.6},
)
NAMES = ("s", "m", "diffuse_albedo", "ior")


def made(folder: Path, materials: str, *, common: float = 0.0, kinds: int = 3, **options: Any) -> list[str]:
    """Stripes of paints, twice as broad for the first, fitted as materials; what was said."""
    stripes = (0, 0, 1, 2)[: kinds + 1]

    def of(x: float, y: float) -> dict[str, Any]:
        return PAINTS[stripes[int((x + 0.8) / 0.4) % len(stripes)]]

    said: list[str] = []
    write(folder / "map.h5", of, rows=24, cols=16, noise=0.03, common=common)
    asked = FitRequest("cook-torrance", **options)
    fits.make(
        folder / "map.h5", folder / "fits.h5", asked, materials=materials, count=lambda a, b: None, say=said.append
    )
    return said


@pytest.mark.slow
@pytest.mark.parametrize(("materials", "common"), [("3", 0.0), ("auto", 0.005)])
def test_three_paints_are_told_apart_and_known(tmp_path: Path, materials: str, common: float) -> None:
    said = made(tmp_path, materials, common=common)
    assert (materials == "3") or said[-1].endswith("; 3 are taken")
    with MapFile(tmp_path / "fits.h5") as found:
        member = found.array("membership")
        # m of the first two differs by 20 %, and a pixel knows it to 1 %: none goes to the wrong one
        columns = np.array([0] * 8 + [1] * 4 + [2] * 4)
        sizes = [int((member == k).sum()) for k in range(3)]
        assert sizes == found.array("material_pixels").tolist()
        assert sizes == [192, 96, 96]
        order = [int(member[0, c]) for c in (0, 8, 12)]
        assert (member == np.array(order)[columns]).all()
        for paint, kind in zip(PAINTS, order, strict=True):
            for name in NAMES:
                value, u = found.array(f"material_{name}")[kind], found.array(f"u_material_{name}")[kind]
                # twelve numbers within four standard errors: by chance once in 1300 cases
                assert abs(value - paint[name]) < 4 * u, name
                assert u < 0.5 * np.nanmedian(found.array(f"u_{name}")[member == kind]) or common
        # chi-square of 9600 values or more is uncertain by 1.5 %, and all was drawn at random
        assert found.array("material_chi_square") == pytest.approx(np.ones(3), abs=0.06)
        assert found.array("membership_chi_square").mean() == pytest.approx(1.0, abs=0.03)


def test_pixels_are_brought_together_by_what_is_known_of_them() -> None:
    """A matt material leaves its facets' slope unknown: what is known sets its pixels apart from a glossy one's."""
    rng = np.random.default_rng(5)
    glossy, matt = (np.tile(one, (40, 1)) + 0.01 * rng.standard_normal((40, 2)) for one in ([0.2, 0.1], [0.9, 0.7]))
    matt[:, 0] = np.nan
    u = np.full((80, 2), 0.01)
    u[40:, 0] = np.nan
    member = _k_means(np.concatenate([glossy, matt]), u, 2)
    assert len(set(member[:40].tolist())) == len(set(member[40:].tolist())) == 1
    assert member[0] != member[-1]


@pytest.mark.slow
def test_a_matt_and_a_glossy_material_are_told_apart(tmp_path: Path) -> None:
    """A matt one's pixels lie at the bound s = 0, and tell no slope: none of them has all its parameters known."""
    matt = {"s": 0.0, "d": 1.0, "m": 0.3, "diffuse_albedo": 0.7, "ior": 1.5}
    write(tmp_path / "map.h5", lambda x, y: matt if x > 0 else PAINTS[2], rows=12, cols=16, noise=0.03, common=0.0)
    said: list[str] = []
    fits.make(
        tmp_path / "map.h5", tmp_path / "fits.h5", FitRequest("cook-torrance"), materials="auto",
        count=lambda a, b: None, say=said.append,
    )  # fmt: skip
    assert said[-1].endswith("; 2 are taken")
    with MapFile(tmp_path / "fits.h5") as found:
        member = found.array("membership")
        assert len(np.unique(member[:, :8])) == len(np.unique(member[:, 8:])) == 1
        assert member[0, 0] != member[0, -1]
        kind = int(member[0, -1])
        pi_f = found.array("material_diffuse_albedo")[kind]
        assert abs(pi_f - 0.7) < 4 * found.array("u_material_diffuse_albedo")[kind]


@pytest.mark.slow
def test_what_all_pixels_of_a_point_share_does_not_average_out(tmp_path: Path) -> None:
    u: list[list[float]] = []
    pulls: list[list[float]] = []
    expected: list[float] = []
    for seed in range(12):
        folder = tmp_path / str(seed)
        folder.mkdir()
        write(folder / "map.h5", lambda x, y: PAINTS[0], rows=8, cols=16, noise=0.01, point=0.01, seed=seed)
        fits.make(
            folder / "map.h5", folder / "fits.h5", FitRequest("cook-torrance"), materials="1",
            count=lambda a, b: None, say=lambda text: None,
        )  # fmt: skip
        with MapFile(folder / "fits.h5") as found:
            u.append([found.array(f"u_material_{name}")[0] for name in NAMES])
            pulls.append(
                [(found.array(f"material_{name}")[0] - PAINTS[0][name]) / u[-1][k] for k, name in enumerate(NAMES)]
            )
            # a pixel knows m with both parts, each of 1 %: 1/sqrt(2) of that is left, and 1/sqrt(40) of the other;
            # one fit in a hundred is rejected by chance and has a misfit besides
            alone = float(np.median(found.array("u_m")))
            expected.append(u[-1][1] / (alone * np.sqrt((1 + 1 / 40) / 2)))
    assert np.median(expected) == pytest.approx(1.0, rel=0.03)
    # of 48 pulls (some 30 that are independent) the mean square is uncertain by a quarter; without the causes: above 20
    assert 0.4 < np.mean(np.square(pulls)) < 1.8


@pytest.mark.slow
def test_one_paint_is_one_material(tmp_path: Path) -> None:
    assert made(tmp_path, "auto", kinds=0)[-1].endswith("; 1 are taken")
    with MapFile(tmp_path / "fits.h5") as found:
        assert (found.array("membership") == 0).all()


@pytest.mark.slow
def test_the_command_prints_materials_and_is_the_same_to_the_byte(tmp_path: Path) -> None:
    made(tmp_path, "3", ior=1.5 + 0j)
    whole = (tmp_path / "fits.h5").read_bytes()
    shown = gonio(
        tmp_path, "fit", "map.h5", "--model", "cook-torrance", "--ior", "1.5", "--materials", "3", "--out", "fits.h5",
        expect=0,
    ).stdout  # fmt: skip
    assert "materials" in shown
    assert " 192 " in shown
    assert (tmp_path / "fits.h5").read_bytes() == whole


def test_numbers_of_materials_that_are_none(tmp_path: Path) -> None:
    write(tmp_path / "map.h5", lambda x, y: PAINTS[0], rows=1, cols=1)
    for text in ("0", "many", "-1", "1.5"):
        with pytest.raises(ConfigError, match="a number from 1 to 50, or auto"):
            fits.make(
                tmp_path / "map.h5", tmp_path / "fits.h5", FitRequest("cook-torrance"), materials=text,
                count=lambda a, b: None, say=print,
            )  # fmt: skip
    assert not (tmp_path / "fits.h5.parts").exists()


def test_a_map_without_materials_is_fitted_all_the_same(tmp_path: Path) -> None:
    path, out, said = tmp_path / "map.h5", tmp_path / "fits.h5", list[str]()
    write(path, lambda x, y: PAINTS[0], rows=1, cols=1)

    def fit(materials: str | None) -> None:
        asked = FitRequest("cook-torrance")
        fits.make(path, out, asked, materials=materials, count=lambda a, b: None, say=said.append)

    with pytest.raises(DataError, match="too few for materials"):
        fit("3")
    fit(None)
    assert said[-1] == "1 of 1 tiles were done before"
    with MapFile(out) as found:
        assert "materials" not in found.attrs


@pytest.mark.slow
def test_paints_that_differ_at_another_wavelength_alone_are_told_apart(tmp_path: Path) -> None:
    def of(x: float, y: float) -> dict[str, Any]:
        return PAINTS[0] | {"ior": lambda wave: np.where(np.asarray(wave) < 500.0, 1.5 if x < -0.4 else 1.56, 1.5)}

    path, out, said = tmp_path / "map.h5", tmp_path / "fits.h5", list[str]()
    write(path, of, rows=16, cols=16, noise=0.03, waves=(450.0, 550.0), common=0.005)
    asked = FitRequest("cook-torrance")
    fits.make(path, out, asked, materials="auto", count=lambda a, b: None, say=said.append)
    with MapFile(out) as found:
        # n at 450 nm is known to 0.01 in a pixel's own fit
        assert found.array("material_pixels").tolist() == [192, 64]
        assert (found.array("membership") == np.array([1] * 4 + [0] * 12)).all()
        # of 3200 values or more: uncertain by 2.5 % at most
        assert found.array("material_chi_square") == pytest.approx(np.ones(2), abs=0.08)
        for kind, blue in enumerate((1.56, 1.5)):
            for name, value in (("ior", 1.5), ("ior@450", blue), ("m", 0.3), ("s@450", 0.4)):
                # eight numbers within four standard errors
                error = found.array(f"material_{name}")[kind] - value
                assert abs(error) < 4 * found.array(f"u_material_{name}")[kind], name
    gonio(tmp_path, "report", "fits.h5", "--out", "page", expect=0)
