"""Which mark separates cells, and which one decimals: one of each in a file, and said where it is not plain."""

from pathlib import Path

import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats import own_pairs
from gonio.formats.text import separator
from gonio.lab.acquisition.plan import read_points
from gonio.lab.calibration.tables import read_numbers

HEADER = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "brdf"]
OWN = own_pairs.pairs("theta_i=theta_i_deg,phi_i=phi_i_deg,theta_r=theta_r_deg,phi_r=phi_r_deg,brdf=brdf:1/sr")


def cut(mark: str, values: list[str], header: list[str] = HEADER) -> bytes:
    """A table with these values as its last column, under `mark`."""
    rows = [["20", "0", str(k % 80), "180", "633", value] for k, value in enumerate(values)]
    return "".join(mark.join(row) + "\n" for row in [header, *rows]).encode()


@pytest.mark.parametrize("columns", [None, OWN])
@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize(
    ("values", "lines"),
    [
        (["0.625", "871.5", "2,043", "865.2"], (4, 2)),  # a thousand in a file with points
        (["0,625", "871,5", "2.043", "865,2"], (2, 4)),  # and in one with commas
        (["0.625", "2,043.5"], (3, 2)),
        (["0,625", "2.043,5"], (2, 3)),
    ],
)
def test_two_decimal_marks_are_refused_with_both_lines(
    columns: dict[str, str] | None, mark: str, values: list[str], lines: tuple[int, int]
) -> None:
    """Kind: a mark between thousands that is taken for a decimal one: 2043 was read as 2.043 at the peak."""
    with pytest.raises(DataError) as caught:
        measurement.parse(cut(mark, values), Path("a.csv"), columns=columns)
    comma, point = lines
    assert f"a.csv, line {comma}, brdf is " in str(caught.value)
    assert f"and a.csv, line {point}, brdf is " in str(caught.value)
    assert "decimal commas and points in one file" in str(caught.value)


def test_two_marks_in_two_columns_are_refused_too() -> None:
    header = [*HEADER[:5], "brdf", "u_brdf"]
    with pytest.raises(DataError, match="decimal commas and points in one file"):
        measurement.parse(cut(";", ["0,25;0.01"], header), Path("a.csv"))


@pytest.mark.parametrize("columns", [None, OWN])
@pytest.mark.parametrize("mark", [";", "\t"])
def test_a_thousand_that_nothing_tells_from_a_decimal_is_refused(columns: dict[str, str] | None, mark: str) -> None:
    """Kind: as above, where no other number has a mark: 2,043 beside 871 is 2.043 or 2043."""
    for value in ("2,043", "2.043"):
        with pytest.raises(DataError, match=r"line 3, brdf is .* beside \"871\".* write \"2043\", or \"2.0430\""):
            measurement.parse(cut(mark, ["871", value, "865"]), Path("a.csv"), columns=columns)
    for settled in ("0,5", "1,25"):  # that is a decimal comma, so the other is, too
        frame = measurement.parse(cut(mark, ["871", "2,043", settled]), Path("a.csv"), columns=columns)
        assert frame["brdf"].tolist()[1] == 2.043


@pytest.mark.parametrize("columns", [None, OWN])
@pytest.mark.parametrize(
    "value", ["1 234,5", "1'234.5", "1\u00a0234,5", "1\u202f234,5", "1.234.567", "1e-3,5", "1,2,3"]
)
def test_other_marks_between_thousands_are_no_numbers(columns: dict[str, str] | None, value: str) -> None:
    """Kind: spaces, apostrophes, repeated marks, a comma in an exponent."""
    with pytest.raises(DataError, match=r"a\.csv, line 2: brdf is "):
        measurement.parse(cut(";", [value]), Path("a.csv"), columns=columns)


def test_decimal_commas_are_read_and_told() -> None:
    """Kind: what a reader takes is said. In exponents, too; text is no number."""
    header = [*HEADER[:5], "sample", "brdf"]
    frame = measurement.parse(cut("\t", ["tile 1.5, old\t3,5e-2", "b.2\t-0,25"], header), Path("a.csv"))
    assert frame["brdf"].tolist() == [0.035, -0.25]
    assert "numbers have decimal commas, as 3,5e-2" in frame.attrs["notes"]


def test_the_mark_holds_over_the_pieces_of_a_large_file() -> None:
    """Kind: a check that looks at one piece only. 20 000 rows are read at once."""
    values = ["0.5"] * 40_000
    values[31_007] = "2,043"
    with pytest.raises(DataError, match=r"line 31009, brdf is \"2,043\", and a\.csv, line 2, brdf is \"0\.5\""):
        measurement.parse(cut(";", values), Path("a.csv"))


@pytest.mark.parametrize(
    ("text", "mark"),
    [
        ("ti;pi;R (632,8 nm)\n1;2;0,5\n", ";"),
        ("ti\tpi\tR (632,8 nm; s)\n1\t2\t0,5\n", "\t"),
        ("ti,pi,R (s; p)\n1,2,0.5\n", ","),
        ('"a;b;c",d\n1,2\n', ","),
        ("R (1,5);x\n0,1;2\n", ";"),
        ("brdf\n1\n", ","),
        ("a,b\n1,2\n", ","),
    ],
)
def test_the_separator_is_the_mark_of_header_and_rows(text: str, mark: str) -> None:
    """Kind: a mark in a column's name that separates nothing."""
    assert separator(text) == mark


def test_decimal_commas_between_commas_shift_no_columns(tmp_path: Path) -> None:
    """Kind: a row of more cells than the header names: 22,5 was 22, and its 5 the next column."""
    points = tmp_path / "points.csv"
    points.write_text("theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg\n30,0,22,5,180\n")
    with pytest.raises(ConfigError, match=r"line 2: 5 cells, and the header names 4"):
        read_points(points)
    scan = tmp_path / "scan.csv"
    scan.write_text("wavelength_nm,signal\n550,1,5\n560,1,6\n")
    with pytest.raises(DataError, match="row 1 has more cells than the header"):
        read_numbers(scan, ("wavelength_nm", "signal"))
