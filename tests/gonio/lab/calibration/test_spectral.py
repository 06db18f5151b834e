"""Bands from spectra and from lines."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio.errors import DataError
from gonio.lab.calibration import spectral
from gonio.lab.calibration.spectral import polarised
from gonio.lab.rig.light_and_camera import Band, Bands, Tunable


@pytest.mark.parametrize("noise", [0.001, 0.005, 0.01])
def test_where_wavelengths_lie_does_not_move_the_centroid(noise: float) -> None:
    """A cut at the baseline moved it by up to 3 u. Of 200 spectra the spread of a pull is 1 +- 0.05."""
    rng, x, pulls = np.random.default_rng(3), np.arange(528.0, 573.0), []
    for centre in rng.uniform(549.5, 550.5, 200):
        y = np.exp(-4.0 * math.log(2.0) * ((x - centre) / 10.0) ** 2) + noise * rng.standard_normal(x.size)
        one = spectral.spectrum("b", x, y, np.full(x.size, noise))
        pulls.append((one.centre_nm - centre) / one.u_centre_nm)
        # a peak between two wavelengths is not seen whole: 0.028 nm on average, which u has to hold
        assert abs(one.fwhm_nm - 10.0) < 4.0 * one.u_fwhm_nm
    assert abs(np.mean(pulls)) < 0.25  # three standard errors of the mean
    assert 0.8 < np.std(pulls) < 1.2  # four standard deviations; where noise reaches the baseline it is cautious


def test_a_faint_background_over_a_wide_scan_does_not_move_the_centroid() -> None:
    """Of 0.4 % over 150 nm on one side it would be 2 nm; noise that nobody gives is that between neighbours."""
    x = np.arange(520.0, 700.0, 0.5)
    y = np.exp(-4.0 * math.log(2.0) * ((x - 550.3) / 10.0) ** 2) + 0.004
    noisy = y + 0.005 * np.random.default_rng(1).standard_normal(x.size)
    for signal, u in ((y, np.full(x.size, 0.005)), (noisy, None)):
        one = spectral.spectrum("b", x, signal, u)
        assert one.centre_nm == pytest.approx(550.3, abs=0.05)
        assert one.fwhm_nm == pytest.approx(10.0, abs=0.2)
    # of 360 values a standard deviation is known to 4 %; the curve of the band adds a few per cent
    assert 0.92 < one.u_centre_nm / spectral.spectrum("b", x, noisy, np.full(x.size, 0.005)).u_centre_nm < 1.15


def test_a_band_that_is_cut_off_is_refused() -> None:
    x = np.arange(545.0, 580.0, 0.5)
    with pytest.raises(DataError, match=r'band "g": its spectrum from 545 to 579.5 nm does not hold the band whole'):
        spectral.spectrum("g", x, np.exp(-(((x - 548.0) / 6.0) ** 2)))


def test_lines_move_a_tunable_source_and_a_list_alike(tmp_path: Path) -> None:
    """True = read + 0.8 + 0.002 (read - 550); lines known to 0.05 nm."""
    rng = np.random.default_rng(3)
    read = np.array([435.0, 500.0, 546.0, 579.0, 650.0])
    line = read + 0.8 + 0.002 * (read - 550.0) + 0.05 * rng.standard_normal(5)
    pd.DataFrame({"line_nm": line, "read_nm": read, "u_nm": 0.05}).to_csv(tmp_path / "lines.csv", index=False)
    scale = spectral.wavelength_scale(tmp_path / "lines.csv")
    bands = Bands(
        list=(Band(name="green", centre_nm=550.0, fwhm_nm=10.0),),
        tunable=Tunable(start_nm=400.0, stop_nm=700.0, step_nm=10.0, fwhm_nm=10.0),
    )
    values, names, covariance = spectral.values(bands, [], scale)
    laid_over = bands.model_dump()
    laid_over["tunable"] |= values["tunable"]
    after = Bands.model_validate(laid_over | {"list": values["list"]})
    assert len(after.all()) == len(bands.all())
    assert names == ["bands.list[0].centre_nm", "bands.tunable.start_nm", "bands.tunable.step_nm"]
    for before, now in zip(bands.all(), after.all(), strict=True):
        expected = before.centre_nm + 0.8 + 0.002 * (before.centre_nm - 550.0)
        assert abs(now.centre_nm - expected) < 0.2  # four u at the ends
    # 0.05 nm over the root of five lines, or more where these scatter by more than that; within 3 (chi-square / 3)
    assert 0.99 * 0.05 / math.sqrt(5.0) < np.sqrt(np.diag(covariance))[0] < 3.0 * 0.05 / math.sqrt(5.0)
    assert covariance[1, 2] < 0.0  # what starts too low has steps that are too large


def test_spectra_of_bands_that_the_rig_does_not_list_are_refused(tmp_path: Path) -> None:
    x = np.arange(520.0, 580.0, 1.0)
    y = np.exp(-(((x - 550.0) / 6.0) ** 2))
    file = tmp_path / "spectra.csv"
    pd.DataFrame({"band": "green", "wavelength_nm": x, "signal": y}).to_csv(file, index=False)
    found = spectral.spectra(file)
    with pytest.raises(DataError, match='of band "green", and the rig file lists: red'):
        spectral.values(Bands(list=(Band(name="red", centre_nm=650.0, fwhm_nm=10.0),)), found, None)
    values, names, _ = spectral.values(Bands(list=(Band(name="green", centre_nm=548.0, fwhm_nm=12.0),)), found, None)
    assert values["list"][0]["centre_nm"] == pytest.approx(550.0, abs=0.01)
    assert names == ["bands.list[0].centre_nm", "bands.list[0].fwhm_nm"]


def test_two_lines_without_uncertainty_are_refused(tmp_path: Path) -> None:
    (tmp_path / "lines.csv").write_text("line_nm,read_nm\n546.1,545.0\n435.8,435.0\n")
    with pytest.raises(DataError, match="2 lines without u_nm tell no uncertainty"):
        spectral.wavelength_scale(tmp_path / "lines.csv")


def test_a_turned_polariser_tells_degree_and_azimuth(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    angle = np.arange(0.0, 180.0, 15.0)
    signal = 500.0 * (1.0 + 0.04 * np.cos(2.0 * np.radians(angle - 170.0)) + 0.001 * rng.standard_normal(12))
    file = tmp_path / "polariser.csv"
    pd.DataFrame({"polariser_deg": angle, "signal": signal, "u_signal": 0.5}).to_csv(file, index=False)
    found = polarised(file)
    u = np.sqrt(np.diag(found.covariance))
    assert abs(found.degree - 0.04) < 3.0 * u[0]
    assert abs(found.azimuth_deg - 170.0) < 3.0 * u[1]
    assert u[0] == pytest.approx(0.001 * math.sqrt(2.0 / 12.0), rel=0.8)  # with the scatter that these twelve have
    pd.DataFrame({"polariser_deg": angle / 20.0, "signal": signal}).to_csv(file, index=False)
    with pytest.raises(DataError, match="cover too little"):
        polarised(file)
