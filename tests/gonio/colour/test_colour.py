"""Weights, screens and the colour of a reflection, from first principles."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio import colour
from gonio.errors import ArgumentError

ROUNDING = 1e-12


# --- weights ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", colour.ILLUMINANTS)
@given(nm=st.lists(st.integers(360, 830), min_size=2, max_size=12, unique=True))
@settings(max_examples=25, deadline=None)
def test_a_perfect_white_has_the_whites_xyz_at_any_wavelengths(name: str, nm: list[int]) -> None:
    assert colour.weights(nm, name).sum(axis=0) == pytest.approx(colour.white(name), abs=ROUNDING)
    assert colour.white(name)[1] == pytest.approx(1.0, abs=ROUNDING)


def test_pixels_of_a_picture_go_at_once() -> None:
    nm = np.linspace(400.0, 700.0, 8)
    picture = np.random.default_rng(1).uniform(0.0, 1.0, (3, 4, 8))
    assert colour.xyz(picture, nm).shape == (3, 4, 3)
    assert colour.xyz(picture, nm)[2, 1] == pytest.approx(colour.xyz(picture[2, 1], nm), abs=ROUNDING)


def test_light_that_holds_its_own_spectrum() -> None:
    nm = colour.wavelengths()
    reflectance = np.linspace(0.2, 0.8, nm.size)
    lit = colour.illuminant("A") * reflectance @ colour.light_weights(nm)
    white = colour.illuminant("A") @ colour.light_weights(nm)
    assert lit / white[1] == pytest.approx(colour.xyz(reflectance, nm, "A"), abs=ROUNDING)
    assert colour.light_weights(nm).sum(axis=0)[1] == pytest.approx(1.0, abs=ROUNDING)


@pytest.mark.parametrize(
    ("nm", "says"),
    [
        ([550.0], "grey"),
        ([1000.0, 1500.0, 550.0], "two wavelengths"),
        ([500.0, 500.0], "twice"),
        ([500.0, math.nan], "positive"),
        ([[500.0, 600.0]], "list"),
    ],
)
def test_wavelengths_that_give_no_colour(nm: list[float], says: str) -> None:
    with pytest.raises(ArgumentError, match=says):
        colour.weights(nm)


def test_an_unknown_illuminant_and_a_wrong_length() -> None:
    with pytest.raises(ArgumentError, match="D65"):
        colour.weights([500.0, 600.0], "D66")
    with pytest.raises(ArgumentError, match="2 wavelengths"):
        colour.xyz([1.0, 2.0, 3.0], [500.0, 600.0])


# --- dominant wavelength ------------------------------------------------------------------------------------------


def test_pure_light_has_its_own_wavelength_and_purity_1() -> None:
    nm, values = colour.spectrum_locus()
    told = (nm >= 400.0) & (nm <= 690.0)
    wave, purity = colour.dominant_wavelength(colour.chromaticity(values[told]))
    assert wave == pytest.approx(nm[told], abs=1e-6)  # the polygon's corners
    assert purity == pytest.approx(1.0, abs=1e-9)


def test_white_and_black_have_no_wavelength() -> None:
    wave, purity = colour.dominant_wavelength(colour.chromaticity([colour.white(), np.zeros(3)]))
    assert np.isnan(wave).all()
    assert purity[0] == 0.0
    assert np.isnan(purity[1])


def test_a_white_outside_all_colours_is_refused() -> None:
    with pytest.raises(ArgumentError, match="inside"):
        colour.dominant_wavelength([0.3, 0.3], (0.8, 0.1))


# --- screens ------------------------------------------------------------------------------------------------------


def some_colours(count: int) -> np.ndarray:
    """XYZ of reflected light, half of it as saturated as narrow bands are."""
    rng = np.random.default_rng(5)
    nm = colour.wavelengths()
    centre, width = rng.uniform(420.0, 660.0, (count, 1)), rng.uniform(4.0, 160.0, (count, 1))
    return colour.xyz(np.exp(-(((nm - centre) / width) ** 2)), nm) * rng.uniform(0.01, 1.0, (count, 1))


@pytest.mark.parametrize("monitor", [colour.MONITOR_1982, colour.NTSC_1953, colour.SRGB])
def test_1982_keeps_the_hue_and_loses_purity_only_outside_the_gamut(monitor: colour.Primaries) -> None:
    xyz = some_colours(200)
    shown = monitor.xyz(monitor.decode(colour.display_1982(xyz, monitor)))
    inside = (monitor.rgb(xyz) >= 0.0).all(axis=1)
    assert 20 < np.count_nonzero(inside) < 180  # both kinds are there
    scale = shown[:, 1] / xyz[:, 1]
    assert scale == pytest.approx(scale[0], rel=1e-9)  # one factor for all: luminances stay in proportion
    assert shown[inside] == pytest.approx(scale[0] * xyz[inside], rel=1e-9)
    before, pure = colour.dominant_wavelength(colour.chromaticity(xyz[~inside]), monitor.white)
    after, less = colour.dominant_wavelength(colour.chromaticity(shown[~inside]), monitor.white)
    assert after == pytest.approx(before, abs=1e-6)  # rounding, where purity is some 0.3
    assert bool(np.all(less < pure))
    # no more than needed: one channel is just dark
    assert monitor.decode(colour.display_1982(xyz, monitor))[~inside].min(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_1982_shows_the_brightest_as_bright_as_its_chromaticity_can_be() -> None:
    linear = np.array([[0.2, 0.1, 0.1], [0.9, 0.6, 0.5], [0.3, 0.3, 0.3]]) * 40.0
    shown = colour.MONITOR_1982.decode(colour.display_1982(colour.MONITOR_1982.xyz(linear)))
    assert shown == pytest.approx(linear / 36.0, abs=ROUNDING)
    assert colour.display_1982(np.zeros((2, 2, 3))).max() == 0.0


@pytest.mark.parametrize("light", colour.ILLUMINANTS)
def test_a_grey_under_any_illuminant_is_shown_grey(light: str) -> None:
    code = colour.display_srgb(0.5 * colour.white(light), illuminant=light)
    assert colour.SRGB.decode(code) == pytest.approx([0.5] * 3, abs=1e-7)  # the standard's two pieces


def test_today_keeps_luminance_and_hue_of_what_fits_in_luminance() -> None:
    xyz = some_colours(300) * 2.0
    shown = colour.SRGB.xyz(colour.SRGB.decode(colour.display_srgb(xyz, illuminant=None)))
    fits = xyz[:, 1] < 0.98
    assert np.count_nonzero(fits) > 100
    assert shown[fits, 1] == pytest.approx(xyz[fits, 1], abs=1e-7)  # the standard's two pieces
    over = xyz[:, 1] > 1.0
    assert np.count_nonzero(over) > 5
    assert shown[over] == pytest.approx(np.tile(colour.SRGB.to_xyz.sum(axis=1), (int(over.sum()), 1)), abs=ROUNDING)


def test_clipping_shifts_the_hue_of_a_bright_copper_and_desaturating_does_not() -> None:
    copper = colour.reflected_xyz(0.0, colour.wavelengths(), "Cu") * 1.3
    own, _ = colour.dominant_wavelength(colour.chromaticity(copper), colour.SRGB.white)
    hue = {}
    for gamut in ("desaturate", "clip"):
        seen = colour.SRGB.xyz(colour.SRGB.decode(colour.display_srgb(copper, illuminant=None, gamut=gamut)))
        hue[gamut], _ = colour.dominant_wavelength(colour.chromaticity(seen), colour.SRGB.white)
    assert hue["desaturate"] == pytest.approx(float(own), abs=1e-3)  # as above
    assert own - hue["clip"] > 2.0  # nm, toward yellow


def test_exposure_and_what_is_brighter_than_white() -> None:
    picture = np.ones((10, 10, 3)) * colour.white()
    picture[0, 0] *= 50.0
    picture[5:] = 0.0
    assert colour.exposure(picture, 0.95) == pytest.approx(1.0, rel=ROUNDING)  # one of 50 lit pixels is a highlight
    shown = colour.display_srgb(picture, exposure=0.5)
    assert shown[0, 0] == pytest.approx([1.0] * 3, abs=ROUNDING)
    assert colour.SRGB.decode(shown[1, 1]) == pytest.approx([0.5] * 3, abs=1e-7)
    assert colour.exposure(np.zeros((2, 2, 3))) == 1.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: colour.display_srgb(np.zeros((2, 2, 3)), exposure=0.0),
        lambda: colour.display_srgb(np.zeros((2, 2, 3)), gamut="hue"),
        lambda: colour.display_srgb(np.zeros((2, 2))),
        lambda: colour.display_1982(np.full((1, 3), np.nan)),
        lambda: colour.exposure(np.zeros((2, 2, 3)), share=0.0),
    ],
)
def test_bad_arguments_of_screens(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ArgumentError):
        call()


# --- the colour of a reflection -----------------------------------------------------------------------------------


def test_a_measured_normal_reflectance_stands_for_an_index() -> None:
    nm = np.linspace(400.0, 700.0, 7)
    f0 = np.linspace(0.04, 0.95, 7)
    assert colour.reflectance(0.0, nm, colour.index_from_f0(f0)) == pytest.approx(f0, abs=ROUNDING)


def test_the_short_procedure_is_exact_at_both_ends() -> None:
    nm = np.linspace(400.0, 700.0, 31)
    ends = np.radians([0.0, 90.0])
    short, full = colour.shifted_xyz(ends, nm, "Cu"), colour.reflected_xyz(ends, nm, "Cu")
    assert short == pytest.approx(full, abs=1e-9)  # cos of 90 degrees is 6e-17


def test_slope_of_lab_is_its_difference_quotient() -> None:
    values = np.array([[0.4, 0.3, 0.2], [0.004, 0.003, 0.002], [-0.001, 0.0, 0.5]])
    step = 1e-6
    for axis in range(3):
        ahead, behind = (colour.lab(values + sign * step * np.eye(3)[axis]) for sign in (1, -1))
        # a central difference errs by its step squared and by rounding over the step
        assert colour.lab_slope(values)[..., axis] == pytest.approx((ahead - behind) / (2 * step), abs=1e-4, rel=1e-7)


def test_lab_refuses_what_is_no_xyz() -> None:
    with pytest.raises(ArgumentError, match="its last axis must hold X, Y and Z"):
        colour.lab([0.1, 0.2])
