"""ASTM E1392, NIST's Mueller CSV, and our own table as a format."""

import gzip
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio import measurement
from gonio.errors import DataError
from gonio.formats.reader import fold, plain_degrees, wrap_deg

ASTM = """LAB_NAME A laboratory
LAB_COMMENTS first line,
second line
SAMPLE_NAME Tile "7"; grey
NUM_POINTS 4
VARS theta_i,phi_i,theta_s,phi_s,500nm,650.5nm

0.174533,0.000000,0.427512,3.141593,0.100000,0.250000
0.174533,0.000000,0.427512,0.000000,0.000000,-0.000200
0.785398,0.000000,0.000000,-0.392699,0.300000,0.000001
1.570796,0.000000,1.570796,1.570796,0.300000,0.000000
"""

NIST = """lambda,thetai,phi,thetar,phir,f_r11,f_r12/f_r11
0.633,-45,0,0.001,0,3.16E-01,0.01
0.633,-45,0,30,-90,3.10E-01,0.01
0.351,-0.001,0,45,180,2.62E-01,0.01
"""


def test_astm_angles_values_and_clamped_zeros() -> None:
    frame = measurement.parse(ASTM.encode(), Path("tile.astm"))
    assert frame["wavelength_nm"].tolist() == [500.0, 650.5] * 4
    # six decimals of radians stand for these degrees; phi_s = pi is the mirror side
    assert frame["theta_i_deg"].tolist()[::2] == [10.0, 10.0, 45.0, 90.0]
    assert frame["phi_r_deg"].tolist()[::2] == [180.0, 0.0, 337.5, 90.0]
    assert frame["brdf"].tolist() == [0.1, 0.25, 0.0, -0.0002, 0.3, 0.000001, 0.3, 0.0]
    # only an exact zero is missing: a small value and a negative one are data
    assert frame["flag"].tolist() == ["", "", "clamped", "", "", "", "", "clamped"]
    assert frame["u_brdf"].isna().all()
    assert frame.attrs["provenance"]["LAB_COMMENTS"] == "first line, second line"
    assert frame.attrs["sample"] == 'Tile "7"; grey'
    assert any("uncertaint" in note for note in frame.attrs["notes"])


def test_astm_round_trip_to_the_formats_digits(tmp_path: Path, small: pd.DataFrame) -> None:
    lost = measurement.write(small, tmp_path / "a.astm")
    back = measurement.read(tmp_path / "a.astm")
    assert lost == []
    pd.testing.assert_frame_equal(back, small, check_exact=True)
    first = (tmp_path / "a.astm").read_text()
    measurement.write(back, tmp_path / "b.astm")
    assert (tmp_path / "b.astm").read_text() == first


def test_astm_says_what_it_has_no_room_for(tmp_path: Path, small: pd.DataFrame) -> None:
    small["u_brdf"] = 0.01
    (lost,) = measurement.write(small, tmp_path / "a.astm")
    assert "u_brdf" in lost
    small["polarisation"] = "ss"
    with pytest.raises(DataError, match="unpolarised"):
        measurement.write(small, tmp_path / "b.astm")
    assert not (tmp_path / "b.astm").exists()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.785398,", "45.0,", "line 10: theta_i = 45; a polar angle in radians"),
        ("-0.392699", "-22.5", "line 10: phi_s = -22.5; an azimuth in radians"),
        ("-0.000200", "-0.0002x", 'line 9: 650.5nm is "-0.0002x"'),
        (",-0.000200", "", "line 9: 5 values, and VARS names 6"),
        ("NUM_POINTS 4", "NUM_POINTS 9", "line 11: the file ends after 4 points, and NUM_POINTS is 9"),
        ("500nm", "blue", 'line 6: VARS names "blue"'),
        (
            "theta_i,phi_i,theta_s,phi_s,500nm,650.5nm",
            "theta_i,phi_i,x,y,1nm",
            "line 6: VARS names theta_i, phi_i, x, y",
        ),
    ],
)
def test_astm_damage_is_located(old: str, new: str, told: str) -> None:
    with pytest.raises(DataError, match=re.escape(f"tile.astm, {told}")):
        measurement.parse(ASTM.replace(old, new, 1).encode(), Path("tile.astm"))


def test_nist_puts_the_source_where_its_negative_angle_says() -> None:
    frame = measurement.parse(NIST.encode(), Path("ptfe.csv"))
    assert (frame["theta_i_deg"].tolist(), frame["phi_i_deg"].tolist()) == ([45.0, 45.0, 0.001], [180.0] * 3)
    assert frame["phi_r_deg"].tolist() == [0.0, 270.0, 180.0]
    assert frame["wavelength_nm"].tolist() == [633.0, 633.0, 351.0]
    assert frame["brdf"].tolist() == [0.316, 0.310, 0.262]
    assert any("Mueller" in note for note in frame.attrs["notes"])


@pytest.mark.parametrize(("text", "name"), [(ASTM, "tile.astm"), (NIST, "ptfe.csv")])
def test_damaged_files_are_named_errors_or_tables(text: str, name: str, survives: Callable[..., None]) -> None:
    survives(text.encode(), name)


def test_damaged_tables_of_our_own(small: pd.DataFrame, survives: Callable[..., None]) -> None:
    survives(small.to_csv(index=False).encode(), "table.csv")


def test_cornell(shared: Callable[[str], Path]) -> None:
    for name, zeros in (("cayman", 11840), ("krylon_blue", 1218)):
        frame = measurement.read(shared(f"cornell_astm/{name}.astm"))
        assert len(frame) == 1439 * 31
        assert (frame["flag"] == "clamped").sum() == zeros  # counted with grep
        assert sorted(frame["theta_i_deg"].unique()) == [10, 20, 30, 40, 50, 60, 70, 80]
        lobe = frame[frame["flag"] == ""].sort_values("brdf").iloc[-1]
        assert lobe["phi_r_deg"] == 180.0  # the gloss is on the mirror side


def test_nist_ptfe(shared: Callable[[str], Path]) -> None:
    frame = measurement.read(shared("nist_ptfe/PTFE.data.csv"))
    assert len(frame) == 7296
    red = frame[(frame["wavelength_nm"] == 633) & (frame["theta_r_deg"].sub(45).abs() < 1) & (frame["theta_i_deg"] < 1)]
    assert math.pi * red["brdf"].mean() == pytest.approx(
        0.993, abs=0.01
    )  # README of the data; 16 azimuths spread by 1 %


@pytest.mark.parametrize(
    ("text", "name", "old", "good", "bad", "told"),
    [
        (NIST, "ptfe.csv", "-45,0,30,", ("-90,0,30,",), ("-90.01,0,30,", "90.01,0,30,"), "thetai"),
        (NIST, "ptfe.csv", "-45,0,30,", ("-45,0,90,", "-45,0,-90,"), ("-45,0,90.01,",), "thetar"),
        (NIST, "ptfe.csv", "0.351,", ("199.9,", "0.1,"), ("1000,", "0,", "-0.3,"), "lambda"),
        (ASTM, "tile.astm", "0.785398,0", ("1.570796,0",), ("1.58,0",), "theta_i"),
    ],
)
def test_angles_and_wavelengths_have_their_limits(
    text: str, name: str, old: str, good: tuple[str, ...], bad: tuple[str, ...], told: str
) -> None:
    assert old in text
    for new in good:
        measurement.parse(text.replace(old, new, 1).encode(), Path(name))
    for new in bad:
        with pytest.raises(DataError, match=rf"line \d+: {told} = "):
            measurement.parse(text.replace(old, new, 1).encode(), Path(name))


def semicolons(text: str) -> str:
    """As a spreadsheet of a country with decimal commas saves it."""
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(("text", "name"), [(ASTM, "tile.astm"), (NIST, "ptfe.csv")])
def test_line_ends_and_marks_of_other_systems(text: str, name: str) -> None:
    plain = measurement.parse(text.encode(), Path(name))
    others = [text.replace("\n", "\r\n"), text.replace("\n", "\r"), "\ufeff" + text]
    if name.endswith(".csv"):
        others += [text.replace(",", "\t"), semicolons(text)]
    for other in others:
        pd.testing.assert_frame_equal(measurement.parse(other.encode(), Path(name)), plain, check_exact=True)
    with pytest.raises(DataError, match="byte 0: is text in UTF-16"):
        measurement.parse(text.encode("utf-16"), Path(name))
    with pytest.raises(DataError, match="gzip"):
        measurement.parse(gzip.compress(text.encode()), Path(name + ".gz"))


@pytest.mark.parametrize(
    ("text", "old", "new"),
    [
        (ASTM, "500nm,650.5nm", "0.5um , 650.5 nm"),
        (ASTM, "theta_s,phi_s", "theta_r,phi_r"),
        (ASTM, "0.174533,0.000000,0.427512", "1.74533e-01,0.000000,4.27512E-1"),
        (ASTM, "NUM_POINTS 4\n", ""),
        (NIST, "3.16E-01", "0.316"),
        (NIST, "phi,thetar,phir,f_r11,f_r12/f_r11", "phii,thetar,phir,fr11,m12"),  # as the README of the data has them
    ],
)
def test_spellings_of_other_instruments(text: str, old: str, new: str) -> None:
    assert old in text
    plain, other = (measurement.parse(t.encode(), Path("tile")) for t in (text, text.replace(old, new)))
    pd.testing.assert_frame_equal(other, plain, check_exact=True)


@pytest.mark.parametrize("text", [ASTM, NIST])
def test_columns_are_found_by_name(text: str) -> None:
    """The last column first: the order of columns means nothing."""
    plain = measurement.parse(text.encode(), Path("tile"))
    lines = []
    for line in text.splitlines():
        head, space, cells = line.rpartition("VARS ")
        first, _, last = cells.rpartition(",")
        lines.append(f"{head}{space}{last},{first}" if first and "line" not in line else line)
    other = measurement.parse("\n".join(lines).encode(), Path("tile"))
    keys = ["theta_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm"]
    ordered, turned = (f.sort_values(keys, ignore_index=True) for f in (plain, other))
    pd.testing.assert_frame_equal(turned, ordered, check_exact=True)


@pytest.mark.parametrize(("text", "cell"), [(ASTM, "0.250000"), (NIST, "3.10E-01")])
@pytest.mark.parametrize("hole", ["", "nan", " NaN"])
def test_an_empty_cell_is_a_hole_and_not_the_end(text: str, cell: str, hole: str) -> None:
    frame = measurement.parse(text.replace(cell, hole).encode(), Path("tile"))
    (row,) = np.flatnonzero(frame["brdf"].isna())
    assert frame["flag"][row] == "not_measured"
    assert any("1 of" in note for note in frame.attrs["notes"])
    with pytest.raises(DataError, match="not a number"):  # a hole among the angles is no direction
        measurement.parse(
            text.replace("10,-30,", f"{hole},-30,")
            .replace("-45,0,0.001", f"{hole},0,0.001")
            .replace("15,60", f"{hole},60")
            .replace("0.174533,0.000000,0.4", f"{hole},0.000000,0.4")
            .encode(),
            Path("tile"),
        )


def test_an_astm_file_of_one_unnamed_band() -> None:
    text = "VARS theta_i,phi_i,theta_s,phi_s,BRDF\n0.5 0.0 0.5 3.141593 0.25\n0.5 0.0 0.2 3.141593 -1e-4\n"
    frame = measurement.parse(text.encode(), Path("tile.astm"))
    assert frame["brdf"].tolist() == [0.25, -1e-4]
    assert frame["wavelength_nm"].isna().all()
    assert any("no wavelength" in note for note in frame.attrs["notes"])


# ---- angles as a table has them ----


@given(st.floats(-90, 90), st.floats(-720, 720))
@settings(deadline=None)
def test_a_signed_angle_keeps_its_direction(theta: float, phi: float) -> None:
    folded, azimuth = fold(theta, phi)
    assert 0 <= folded <= 90
    assert 0 <= azimuth < 360

    def vector(t: float, p: float) -> np.ndarray:
        t, p = np.deg2rad(t), np.deg2rad(p)
        return np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])

    # azimuths are rounded to 1e-10 degrees; the reduction of 720 degrees loses 1e-13
    np.testing.assert_allclose(vector(float(folded), float(azimuth)), vector(theta, phi), atol=3e-12)


@given(st.floats(0, 90).map(lambda x: round(x, 3)))
@settings(deadline=None)
def test_radians_with_six_decimals_stand_for_plain_degrees(degrees: float) -> None:
    text = f"{np.deg2rad(degrees):.6f}"
    short = float(plain_degrees(float(text), 6))
    assert f"{np.deg2rad(short):.6f}" == text
    assert abs(short - degrees) <= 5.8e-5  # twice the half of the sixth decimal, in degrees


def test_angles_of_a_file_as_they_are_meant() -> None:
    assert wrap_deg([0.0, 359.9, 360.0, -22.5, -1e-12, 725.0]).tolist() == [0.0, 359.9, 0.0, 337.5, 0.0, 5.0]
    theta, phi = fold([-30.0, 30.0, 90.004, 90.006], [200.0, 200.0, 0.0, 0.0], slack_deg=0.005)
    assert (theta.tolist(), phi.tolist()) == ([30.0, 30.0, 90.0, 90.006], [20.0, 200.0, 0.0, 0.0])
    # half of the sixth decimal is 2.9e-5 degrees: 10.0006 would be 3.4e-5 off
    assert plain_degrees([0.174533, 0.785398, 0.174544], 6).tolist() == [10.0, 45.0, 10.00063]
