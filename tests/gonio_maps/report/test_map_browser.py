"""The page of a map in a real browser: the values of a pixel are the file's, its curve is the model's."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from gonio_maps.report import map_page
from gonio_maps.report.map_view import packed, unpacked

from gonio.geometry import direction
from gonio.models import build
from tests.browser import CHROMIUM, Page
from tests.gonio_analysis.report.test_report_browser import plain
from tests.gonio_maps.map_files import axes, fits, values

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not rendered")
ROWS, COLS, PIXEL_MM = 12, 20, 2.0
MODELS = {
    "cook-torrance": {"s": 0.4, "m": 0.2, "diffuse_albedo": 0.3, "ior": 1.6, "k": 2.5},
    "ggx": {"alpha": 0.3, "diffuse_albedo": 0.2, "ior": 1.5, "k": 0.0},
    "blinn": {"k_s": 0.5, "k_d": 0.3, "c": 0.25, "ior": 0.4, "k": 3.0},
    "oren-nayar": {"albedo": 0.7, "sigma_deg": 25.0},
}


def python(name: str, p: dict[str, float], theta_i: float, signed: float) -> float:
    """A model's value in the plane of incidence, the mirror side positive [1/sr]."""
    given = {k: v for k, v in p.items() if k != "k"}
    if "ior" in p:
        given["ior"] = complex(p["ior"], p["k"])  # type: ignore[assignment]
    if name == "cook-torrance":
        given |= {"slopes": given.pop("m"), "d": 1.0 - given["s"]}
    if name == "blinn":
        given["distribution"] = "trowbridge-reitz"  # type: ignore[assignment]
    azimuth = np.pi if signed > 0 else 0.0
    return float(build(name, given).brdf(theta_i, 0.0, abs(signed), azimuth))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map of Lambert's law whose albedo goes from left to right, with its values, and a row that has too few."""
    folder = tmp_path_factory.mktemp("map")
    theta_r = np.arange(-80.0, 81.0, 10.0)
    theta_i = np.repeat([20.0, 50.0], theta_r.size)
    theta_r = np.tile(theta_r, 2)
    nominal = np.array([theta_i, 0 * theta_i, np.abs(theta_r), np.where(theta_r >= 0, 180.0, 0.0)])
    at = np.radians(nominal)
    albedo = np.broadcast_to(0.2 + 0.03 * np.arange(COLS), (ROWS, COLS))
    brdf = np.repeat(albedo[..., None] / np.pi, theta_r.size, axis=2)
    values(folder / "map.h5", brdf, 0.02 * brdf, 500 * direction(*at[:2]), 500 * direction(*at[2:]), nominal,
           pixel_mm=PIXEL_MM)  # fmt: skip
    flag = np.where(np.arange(ROWS)[:, None] == 0, 1, 0)
    known = np.where(flag == 0, albedo, np.nan)
    whole = {"albedo": known, "sigma_deg": np.where(flag == 0, 5.0, np.nan) + 0 * albedo}
    u = {"albedo": 0.01 * known, "sigma_deg": np.where(flag == 0, np.nan, np.nan) + 0 * albedo}
    attrs = {"parameters": {"albedo": "1", "sigma_deg": "deg"}, "map": "map.h5"}
    fits(folder / "fits.h5", whole, u, model="oren-nayar", flag=flag | 2, pixel_mm=PIXEL_MM, attrs=attrs)
    return map_page.make(folder / "fits.h5", folder / "out")


def said(tab: Page) -> dict[str, str]:
    """Names and values beside the map."""
    found: list[list[str]] = tab.run(
        "[...document.querySelectorAll('.pixels .at dt')].map(e => [e.textContent, e.nextSibling.textContent])"
    )
    return {name: plain(value) for name, value in found}


@needs_browser
@pytest.mark.slow
def test_a_pixel_under_the_cursor_says_what_the_file_says(page: Path, tab: Page) -> None:
    tab.open(page, 1280)
    tab.run("document.querySelector('.pixels').scrollIntoView()")
    left, top, wide, high = tab.run(
        "(b => [b.left, b.top, b.width, b.height])(document.querySelector('.pixels canvas').getBoundingClientRect())"
    )
    x, y = axes(ROWS, COLS, PIXEL_MM)
    for row, col in ((1, 0), (5, 7), (11, 19)):  # row 0 of the file is at the foot of the picture
        tab.move(left + (col + 0.5) / COLS * wide, top + (ROWS - row - 0.5) / ROWS * high)
        told = said(tab)
        place = re.fullmatch(r"x = (\S+) mm, y = (\S+) mm", told["place"])
        assert place
        assert [float(place[1]), float(place[2])] == pytest.approx([x[col], y[row]])
        value, u = told["albedo"].split(" ± ")
        # half a unit of the last printed digit, the second one of the uncertainty
        assert float(value) == pytest.approx(0.2 + 0.03 * col, abs=0.05 * float(u) + 1e-12)
        assert float(u) == pytest.approx(0.01 * (0.2 + 0.03 * col), rel=0.05)
        assert told["sigma [°]"] == "5.000, at its bound"
        assert told["flag"] == "at bound"
    tab.move(left + 0.5 * wide, top + (ROWS - 0.5) / ROWS * high)
    assert said(tab)["albedo"] == "not determined"
    assert said(tab)["flag"] == "too few"
    assert "The model is not determined here." in tab.run("document.querySelector('.pixels .at .note').textContent")
    assert tab.complaints == []


@needs_browser
@pytest.mark.slow
def test_measured_values_stand_in_the_pixels_own_directions(page: Path, tab: Page) -> None:
    tab.open(page, 1280)
    tab.run("document.querySelector('.pixels .map .stage').focus()")
    for _ in range(20):
        tab.press("ArrowRight")
    x, _ = axes(ROWS, COLS, PIXEL_MM)
    told = re.fullmatch(r"x = (\S+) mm, y = (\S+) mm", said(tab)["place"])
    assert told
    assert float(told[1]) == pytest.approx(x[-1])
    curves = tab.run("document.querySelector('.pixels .viewer').viewer.data.waves[0].curves")
    assert [c["label"] for c in curves] == ["θi = 20°", "θi = 50°"]
    spot = np.array([x[-1], float(told[2]), 0.0])
    theta_r = np.radians(np.arange(-80.0, 81.0, 10.0))
    source = 500 * direction(np.radians(20.0), 0.0) - spot
    measured = curves[0]["series"][0]
    assert measured["name"] == "measured"
    # phi_i = 0: the source stands at x > 0, and the mirror side at x < 0
    camera = 500 * np.column_stack([-np.sin(theta_r), 0 * theta_r, np.cos(theta_r)]) - spot
    expected = np.degrees(np.arctan2(-camera[:, 0], camera[:, 2]))
    # seven digits of the places on the page
    assert measured["angle"] == pytest.approx(np.sort(expected), abs=1e-4)
    assert curves[0]["mirror"] == pytest.approx(np.degrees(np.arctan2(source[0], source[2])), abs=1e-4)
    truth = (0.2 + 0.03 * (COLS - 1)) / np.pi
    assert measured["brdf"] == pytest.approx(np.full(17, truth), rel=1e-4)  # 16 bits over a factor of four
    assert measured["u"] == pytest.approx(np.full(17, 0.02 * truth), rel=0.025)  # half a step of 255 over 1e5


@needs_browser
@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_curves_are_those_of_the_models(page: Path, tab: Page, name: str) -> None:
    tab.open(page, 1280)
    for theta_i in (0.0, 0.3, 1.1):
        for signed in (-1.4, -0.6, -0.2, 0.1, 0.3, 0.9, 1.3):
            found = tab.run(f"window.gonio.models['{name}']({json.dumps(MODELS[name])}, {theta_i}, {signed})")
            # both in float64; the cosine of a half-vector near grazing loses two or three digits
            assert found == pytest.approx(python(name, MODELS[name], theta_i, signed), rel=1e-11)


@needs_browser
@pytest.mark.slow
def test_curves_of_a_model_that_the_page_does_not_evaluate_are_those_of_their_pixel(tab: Page, tmp_path: Path) -> None:
    sigma0 = 0.1 + 0.01 * np.arange(60.0) + np.zeros((60, 1))
    whole = {"sigma0_um": sigma0, "tau_um": 2.0 + 0 * sigma0, "diffuse_albedo": 0.3 + 0 * sigma0}
    attrs = {"parameters": {"sigma0_um": "um", "tau_um": "um", "diffuse_albedo": "1"}, "map": "map.h5",
             "fixed": {"ior": 1.5, "k": 0.0}, "wavelength_nm": 650.0}  # fmt: skip
    fits(tmp_path / "fits.h5", whole, {n: 0.01 * v for n, v in whole.items()}, model="he-torrance", attrs=attrs)
    tab.open(map_page.make(tmp_path / "fits.h5", tmp_path / "out"), 1280)
    curve = tab.run("document.querySelector('.pixels .viewer').viewer.data.waves[0].curves")[1]
    assert curve["label"] == "θi = 45°"
    (drawn,) = curve["series"]
    # every second pixel has curves: row and column 30 show those of 30, the first one being 0
    model = build("he-torrance", {"sigma0_um": float(sigma0[30, 30]), "tau_um": 2.0, "diffuse_albedo": 0.3, "ior": 1.5})
    signed = np.radians(drawn["angle"])
    azimuth = np.where(signed > 0, np.pi, 0.0)
    expected = model.brdf(np.radians(45.0), 0.0, np.abs(signed), azimuth, wavelength_nm=650.0)
    # 16 bits of logarithms: half of 1/65534 of the range of all pixels' values, less than a factor of e^8
    assert drawn["brdf"] == pytest.approx(expected, rel=8.0 / 65534 / 2 * 1.1)
    tab.run("document.querySelector('.pixels .map .stage').focus()")
    tab.press("ArrowRight")
    assert "nearest pixel with curves here" in tab.run("document.querySelector('.pixels .at .note').textContent")
    assert tab.complaints == []


def test_sixteen_bits_cost_little_of_the_uncertainty() -> None:
    value = np.exp(np.random.default_rng(7).normal(0.0, 2.0, 5000))
    u = 1e-3 * value
    value[::50] = np.nan
    view = packed(value, u)
    import base64

    codes = np.frombuffer(base64.b64decode(view["data"]), "<u2").astype(np.int64)
    back = unpacked(codes, view["scale"], view["low"], view["high"])
    assert view["scale"] == "log"
    assert np.array_equal(np.isnan(back), np.isnan(value))
    known = np.isfinite(value)
    # about 15 of the logarithm in 65534 steps, half a step off: 1.2e-4
    assert np.abs(back[known] / value[known] - 1).max() < 1.3e-4
