"""Tables under their makers' own column names and units."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.cli.tables import convert
from gonio.errors import ConfigError, DataError
from gonio.formats import own_columns

PLAIN = """theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,brdf,u_brdf
10,180,20,0,550,0.25,0.01
10,180,70,0,550,0.5,0.02
"""
SPEC = "theta_i=ti:rad,phi_i=pi,theta_r=tr:deg,phi_r=pr:rad,wavelength=wl:um,brdf=R:factor,u_brdf=U:factor"


def mine(mark: str = ",", point: str = ".") -> str:
    """PLAIN as somebody else wrote it."""
    rows = [["run", "R", "ti", "pi", "tr", "pr", "wl", "U"]]
    for theta_r, brdf, u in ((20, 0.25, 0.01), (70, 0.5, 0.02)):
        cells = ["1", brdf * math.pi, math.radians(10), 180, theta_r, 0, 0.55, u * math.pi]
        rows.append([str(cell).replace(".", point) for cell in cells])
    return "\n".join(mark.join(row) for row in rows) + "\n"


def assert_plain(frame: pd.DataFrame) -> None:
    """Angles and wavelengths to the bit; values to the two roundings by pi."""
    plain = measurement.parse(PLAIN.encode(), Path("plain.csv"))
    exact = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "flag"]
    pd.testing.assert_frame_equal(frame[exact], plain[exact], check_exact=True)
    for name in ("brdf", "u_brdf"):
        np.testing.assert_allclose(frame[name], plain[name], rtol=4e-16)


@pytest.mark.parametrize(("mark", "point"), [(",", "."), (";", ","), ("\t", ".")])
def test_names_and_units_of_ones_own(mark: str, point: str) -> None:
    columns = own_columns.pairs(SPEC)
    frame = measurement.parse(mine(mark, point).encode(), Path("mine.csv"), columns=columns)
    assert_plain(frame)
    assert "brdf is the file's column 'R' [factor]" in frame.attrs["notes"]
    assert "columns left out: 'run'" in frame.attrs["notes"]


def test_the_file_beside_the_table_is_read_by_every_command(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text(mine())
    pairs = own_columns.pairs(SPEC).items()
    (tmp_path / "mine.columns.toml").write_text("".join(f'{key} = "{own}"\n' for key, own in pairs))
    assert_plain(measurement.read(tmp_path / "mine.csv"))
    (frame,) = measurement.tables(tmp_path / "mine.csv").values()  # what the commands call
    assert_plain(frame)
    assert own_columns.beside(tmp_path / "mine.xls") is None  # another file, of the same name


def test_convert_takes_them_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text(mine())
    out = tmp_path / "out.csv"
    convert(str(tmp_path / "mine.csv"), out, columns=SPEC)
    assert_plain(measurement.read(out))
    with pytest.raises(ConfigError, match="is a model"):
        convert("sample.toml", out, columns=SPEC)


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("theta_i", "'theta_i' is no pair"),
        ("theta_i=ti,theta_i=tr", "'theta_i' is named twice"),
        ("theta=ti", "'theta' is no column"),
        ("theta_i=ti,theta_i_deg=tr", "'theta_i_deg' is no column, or named twice"),
        ("theta_i=ti,theta_r=ti", "the column 'ti' is named twice"),
        ("theta_i=ti:grad", "'grad' is no unit of it; deg or rad"),
        ("brdf=R:percent", "'percent' is no unit of it; 1/sr or factor"),
    ],
)
def test_pairs_that_are_wrong(spec: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        measurement.parse(mine().encode(), Path("mine.csv"), columns=own_columns.pairs(spec))


def test_what_is_wrong_with_the_files_is_told(tmp_path: Path) -> None:
    columns = own_columns.pairs(SPEC)
    with pytest.raises(DataError, match=r"mine\.csv, line 1: columns missing, or there twice: ti"):
        measurement.parse(mine().replace("ti", "t").encode(), Path("mine.csv"), columns=columns)
    with pytest.raises(DataError, match=r'mine\.csv, line 3: tr is "x", not a number'):
        measurement.parse(mine().replace(",70,", ",x,").encode(), Path("mine.csv"), columns=columns)
    with pytest.raises(ConfigError, match="merl files are none"):
        measurement.parse(mine().encode(), Path("mine.csv"), format="merl", columns=columns)
    with pytest.raises(DataError, match=r"line 1: no column is named for phi_i_deg, .* in columns; the file has"):
        measurement.parse(mine().encode(), Path("mine.csv"), columns={"theta_i": "ti:rad"})
    (tmp_path / "mine.csv").write_text(mine())
    for text, told in (("theta_i = 3", "theta_i = 3; the name of a column"), ("theta_i", "is not valid TOML")):
        (tmp_path / "mine.columns.toml").write_text(text)
        with pytest.raises(ConfigError, match=rf"mine\.columns\.toml: {told}"):
            measurement.read(tmp_path / "mine.csv")
