"""Columns that are nearly right: the message says what to rename, and a table renamed so is read."""

import re
from pathlib import Path

import pytest

from gonio import measurement
from gonio.errors import DataError

NAMES = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "brdf", "u_brdf")


def write(path: Path, *header: str) -> Path:
    rows = ["10,180,20,0,550,0.3,0.01", "10,180,30,0,550,0.2,0.01"]
    path.write_text("\n".join([",".join(header), *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("column", "mine"),
    [
        ("theta_i_deg", "theta_i"),
        ("theta_i_deg", "Theta_I_deg"),
        ("theta_i_deg", "thetai"),
        ("theta_i_deg", "theta_in (deg)"),
        ("theta_i_deg", " theta_i_deg"),
        ("theta_r_deg", "theta_o"),
        ("theta_r_deg", "theta_s_deg"),
        ("phi_i_deg", "phi i"),
        ("phi_r_deg", "φ_r [°]"),
        ("phi_r_deg", "azimuth_out"),
        ("wavelength_nm", "lambda_nm"),
        ("wavelength_nm", "Wavelength"),
        ("wavelength_nm", "wavelenght_nm"),
        ("brdf", "BRDF"),
        ("brdf", "BRDF [1/sr]"),
        ("brdf", "brdf (sr-1)"),
        ("brdf", "f_r"),
        ("u_brdf", "U_BRDF"),
        ("u_brdf", "uncertainty"),
        ("theta_i_deg", "tetha_i_deg"),
        ("theta_i_deg", "theta_ideg"),
        ("theta_i_deg", "theta_source"),
        ("theta_r_deg", "ThetaR"),
        ("theta_r_deg", "theta detector [°]"),
        ("phi_r_deg", "phi_det (degrees)"),
        ("wavelength_nm", "wavelengthnm"),
        ("wavelength_nm", "wave_length"),
        ("brdf", "brdf_sr-1"),
        ("u_brdf", "sigma_brdf"),
    ],
)
def test_the_column_to_rename_is_named(tmp_path: Path, column: str, mine: str) -> None:
    path = write(tmp_path / "mine.csv", *(mine if name == column else name for name in NAMES))
    with pytest.raises(DataError) as told:
        measurement.read(path)
    assert str(told.value).count("rename ") == 1
    assert "mine.csv, line 1: columns " in str(told.value)
    assert f"rename {mine!r} to {column!r}" in str(told.value)


def test_every_column_is_named_at_once_and_the_renamed_table_is_read(tmp_path: Path) -> None:
    mine = ("thetai", "phii", "thetar", "phir", "lambda", "BRDF", "unc")
    with pytest.raises(DataError) as told:
        measurement.read(write(tmp_path / "mine.csv", *mine))
    for own, name in zip(mine, NAMES, strict=True):
        assert f"rename {own!r} to {name!r}" in str(told.value)
    assert measurement.read(write(tmp_path / "renamed.csv", *NAMES))["brdf"].tolist() == [0.3, 0.2]


@pytest.mark.parametrize(
    ("column", "mine", "remedy"),
    [
        ("theta_i_deg", "theta_i_rad", "multiply its radians by 180/pi and name it 'theta_i_deg' (now 'theta_i_rad')"),
        ("wavelength_nm", "lambda [µm]", "multiply its micrometres by 1000 and name it 'wavelength_nm'"),
        ("brdf", "Reflectance factor", "divide 'Reflectance factor' by pi and name it 'brdf'"),
        ("theta_r_deg", "theta_r(radians)", "multiply its radians by 180/pi and name it 'theta_r_deg'"),
        ("phi_i_deg", "phiirad", "multiply its radians by 180/pi and name it 'phi_i_deg'"),
        ("wavelength_nm", "wavelength_micron", "multiply its micrometres by 1000 and name it 'wavelength_nm'"),
        ("brdf", "reflectance factor (%)", "by 100 pi, if it is a reflectance factor in percent"),
        ("brdf", "brdf_percent", "by 100 pi, if it is a reflectance factor in percent"),
        ("u_brdf", "U_brdf", "an expanded uncertainty U is divided by its k first"),
    ],
)
def test_another_unit_is_not_only_renamed(tmp_path: Path, column: str, mine: str, remedy: str) -> None:
    path = write(tmp_path / "mine.csv", *(mine if name == column else name for name in NAMES))
    with pytest.raises(DataError, match=re.escape(remedy)):
        measurement.read(path)


@pytest.mark.parametrize(
    ("column", "mine"),
    [
        ("theta_i_deg", "theta_h"),  # the half angle
        ("theta_r_deg", "theta_d_deg"),  # the difference angle
        ("phi_r_deg", "dphi"),
        ("brdf", "brdf_nm"),
        ("theta_i_deg", "theta_i_nm"),
        ("brdf", "f_cos"),
        ("brdf", "reflectance [%]"),  # of a hemisphere, perhaps
        ("theta_i_deg", "theta_i_grad"),
    ],
)
def test_what_may_be_another_quantity_gets_no_hint(tmp_path: Path, column: str, mine: str) -> None:
    path = write(tmp_path / "mine.csv", *(mine if name == column else name for name in NAMES))
    with pytest.raises(DataError, match=f"columns missing: '{column}'; a measurement table has"):
        measurement.read(path)


def test_no_hint_where_two_columns_could_be_meant_or_the_right_one_is_there(tmp_path: Path) -> None:
    twice = ("theta_i_deg", "phi_i_deg", "theta_o", "phi_r_deg", "theta_s", "brdf", "u_brdf")
    with pytest.raises(DataError, match="columns missing: 'theta_r_deg'; a measurement table has"):
        measurement.read(write(tmp_path / "twice.csv", *twice))
    there = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "theta_i", "brdf", "u_brdf")
    with pytest.raises(DataError, match="columns not known: 'theta_i'; a measurement table has"):
        measurement.read(write(tmp_path / "there.csv", *there))
