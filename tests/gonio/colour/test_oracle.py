"""XYZ, dominant wavelengths and screens against `colour-science`, which holds the CIE's data and rules by itself."""

import warnings
from typing import Any

import numpy as np
import pytest

from gonio import colour
from gonio.typing import Floats

OBSERVER = "CIE 1931 2 Degree Standard Observer"


@pytest.fixture(scope="module")
def oracle() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of what it would draw with
        printing = np.get_printoptions()
        try:  # it changes how numpy prints, for every test after this one
            return pytest.importorskip("colour", reason="colour-science is of the dev extra")
        finally:
            np.set_printoptions(**printing)


def spectra(nm: Floats) -> Floats:
    """Reflectances that are smooth, steep, and rough."""
    rng = np.random.default_rng(7)
    step = 1.0 / (1.0 + np.exp(-(nm - rng.uniform(420.0, 680.0, (8, 1))) / rng.uniform(2.0, 60.0, (8, 1))))
    return np.concatenate([step, 1.0 - step, rng.uniform(0.0, 1.0, (8, nm.size)), np.ones((1, nm.size))])


def summed(oracle: Any, name: str, values: Floats) -> Floats:
    """XYZ of spectra at `colour.wavelengths` under an illuminant, by the library."""
    shape = oracle.SpectralShape(360, 830, 5)
    observer = oracle.MSDS_CMFS[OBSERVER].copy().align(shape)
    # its tables end at 780 nm, and it goes on with the last value; there the observer has 3e-6 of its sum
    light = oracle.SDS_ILLUMINANTS[name].copy().align(shape)
    spectra = (oracle.SpectralDistribution(row, colour.wavelengths()) for row in values)
    return np.array([oracle.sd_to_XYZ(one, observer, light, method="Integration") / 100.0 for one in spectra])


@pytest.mark.parametrize("name", colour.ILLUMINANTS)
def test_xyz_of_reflectances(oracle: Any, name: str) -> None:
    nm = colour.wavelengths()
    values = spectra(nm)
    assert colour.xyz(values, nm, name) == pytest.approx(summed(oracle, name, values), abs=1e-6)


def test_xyz_at_few_wavelengths_is_the_sum_over_values_linear_between_them(oracle: Any) -> None:
    rng = np.random.default_rng(3)
    for nm in ([450.0, 550.0, 650.0], [640.0, 431.5, 580.0, 512.0, 405.0, 475.0, 611.3, 702.0]):
        values = rng.uniform(0.0, 1.0, len(nm))
        order = np.argsort(nm)
        fine = np.interp(colour.wavelengths(), np.array(nm)[order], values[order])
        assert colour.xyz(values, nm) == pytest.approx(summed(oracle, "D65", fine[None])[0], abs=1e-6)  # as above


@pytest.mark.parametrize("name", ["D65", "A", "E", "C"])
def test_dominant_wavelength_and_purity(oracle: Any, name: str) -> None:
    # the oracle gives the nearest wavelength of its table: of one in steps of 1/16 nm, within 0.03 nm
    fine = oracle.MSDS_CMFS[OBSERVER].copy().interpolate(oracle.SpectralShape(360, 830, 0.0625))
    white = (0.31006, 0.31616) if name == "C" else colour.chromaticity(colour.white(name))
    lights = fine.values[488:5440:144]  # 390.5 to 699.5 nm: at a corner of its polygon the oracle may find nothing
    rng = np.random.default_rng(11)
    lights = np.concatenate([lights, fine.values[640] + np.geomspace(0.05, 20.0, 16)[:, None] * fine.values[4480]])
    pure = lights[:, :2] / lights.sum(axis=1, keepdims=True)
    xy = white + rng.uniform(0.05, 0.95, (len(pure), 1)) * (pure - white)
    wave, purity = colour.dominant_wavelength(xy, white)
    wanted = np.array([oracle.dominant_wavelength(row, white, fine)[0] for row in xy])
    assert np.count_nonzero(wanted < 0.0) >= 8  # purples
    # beyond 680 nm the chromaticity changes by less than the table's last digit in a nm
    told = (np.abs(wanted) > 400.0) & (np.abs(wanted) < 680.0)
    assert np.count_nonzero(told) > 30
    assert wave[told] == pytest.approx(wanted[told], abs=0.1)  # what is asked of the colours
    ends = oracle.excitation_purity(xy, np.asarray(white))
    assert purity == pytest.approx(ends, abs=1e-6)  # both take the polygon in steps of 1 nm, but it one to 830 nm


def test_primaries_and_curves(oracle: Any) -> None:
    for ours, name in ((colour.SRGB, "sRGB"), (colour.NTSC_1953, "NTSC (1953)")):
        theirs = oracle.RGB_COLOURSPACES[name]
        derived = oracle.normalised_primary_matrix(theirs.primaries, theirs.whitepoint)
        assert ours.to_xyz == pytest.approx(derived, abs=1e-12)  # rounding
        assert ours.from_xyz @ ours.to_xyz == pytest.approx(np.eye(3), abs=1e-12)
    light = np.linspace(0.0, 1.0, 301)
    assert colour.SRGB.encode(light) == pytest.approx(oracle.RGB_COLOURSPACES["sRGB"].cctf_encoding(light), abs=1e-12)
    # at code 0.04045 the standard's two pieces are 2e-8 apart in light
    assert colour.SRGB.decode(colour.SRGB.encode(light)) == pytest.approx(light, abs=1e-7)
    assert colour.NTSC_1953.decode(colour.NTSC_1953.encode(light)) == pytest.approx(light, abs=1e-12)
    for screen in (colour.SRGB, colour.NTSC_1953):
        for curve in (screen.decode, screen.encode):
            assert curve([-0.1, 1.2]) == pytest.approx([0.0, 1.0], abs=2e-16)  # a rounding


def test_adaptation(oracle: Any) -> None:
    for name in ("A", "E", "D50"):
        wanted = oracle.adaptation.matrix_chromatic_adaptation_VonKries(
            colour.white(name), colour.white("D65"), transform="Bradford"
        )
        assert colour.adaptation(colour.white(name), colour.white("D65")) == pytest.approx(wanted, abs=1e-12)


def test_the_colour_of_copper_by_both(oracle: Any) -> None:
    """The whole way: n + ik, Fresnel, XYZ, linear RGB."""
    nm = colour.wavelengths()
    theta = np.radians([0.0, 45.0, 80.0, 89.0])
    wanted = summed(oracle, "D65", colour.reflectance(theta, nm, "Cu"))
    assert colour.reflected_xyz(theta, nm, "Cu") == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("name", colour.ILLUMINANTS)
def test_lab(oracle: Any, name: str) -> None:
    rng = np.random.default_rng(5)
    values = np.concatenate([rng.uniform(0.0, 1.1, (50, 3)), rng.uniform(0.0, 0.01, (50, 3)), [colour.white(name)]])
    wanted = oracle.XYZ_to_Lab(values, oracle.XYZ_to_xy(colour.white(name)))
    assert colour.lab(values, name) == pytest.approx(wanted, abs=1e-10)  # rounding of numbers of a few hundred
