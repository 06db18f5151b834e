"""Tables of one's own in workbooks and Parquet files, with rows of units, signed angles, and the pairs beside them."""

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats import own_pairs
from gonio.formats.reader import ANGLES
from gonio.renderers import channels
from tests.command_line import says
from tests.gonio.formats.test_cells import xlsx
from tests.gonio.formats.test_own_layouts import layout, line_of, taken
from tests.places import measured

PAIRS = "theta_i=ti,phi_i=pi,theta_r=tr,phi_r=pr,brdf=R"
ROWS = ("30;0;20;180;0.5", "30;0;40;180;0.25")


def number(cell: str) -> float | str | None:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return cell or None


def read(data: bytes, name: str, pairs: str) -> pd.DataFrame:
    return measurement.parse(data, Path(name), columns=own_pairs.pairs(pairs))


@pytest.mark.parametrize("seed", [3, 4, 5, 12, 13, 14, 15, 16, 17, 26])
@pytest.mark.parametrize("corner", ["theta", ""])
def test_a_worksheet_is_read_as_the_text_of_its_cells(seed: int, corner: str) -> None:
    """Long, wide and matrix, below a preamble; the corner of a matrix may be empty."""
    made = layout(seed)
    mark = (";", "\t", ",", " ")[seed // 3 % 4]
    rows = [[number(cell) for cell in line.removeprefix("# ").split(mark)] for line in made.text.splitlines()[-40:]]
    first = next(k for k, row in enumerate(rows) if len(row) > 2 and len(row) == len(rows[-1]))
    if seed % 3 == 2:
        rows[first][0] = corner or None
    elif seed % 3 == 1:  # names of wavelengths stay texts
        rows[first] = [str(cell) for cell in made.text.splitlines()[-len(rows) + first].removeprefix("# ").split(mark)]
    frame = read(xlsx([["lamp", 3.0], [], *rows[first:]]), "a.xlsx", made.pairs)
    expected = made.truth[np.lexsort(made.truth[:, :5].T[::-1])]
    np.testing.assert_allclose(taken(frame), expected, rtol=2e-8, atol=1e-7)  # nine digits are written
    says(" ".join(frame.attrs["notes"]), "the table begins at row 3 of worksheet 1")


def with_units(units: str, how: str) -> tuple[bytes, str]:
    """ROWS under a row of units, as a text or a workbook."""
    lines = ["ti;pi;tr;pr;R", units, *ROWS]
    if how == "text":
        return "\n".join([*lines, ""]).encode(), "a.csv"
    return xlsx([[number(cell) for cell in line.split(";")] for line in lines]), "a.xlsx"


@pytest.mark.parametrize("how", ["text", "workbook"])
@pytest.mark.parametrize("units", ["deg;deg;deg;deg;1/sr", "[°];;[deg];;[sr^-1]", "# degrees;-;deg;-;sr-1"])
def test_a_row_of_units_is_no_row_of_values_and_is_told(units: str, how: str) -> None:
    frame = read(*with_units(units, how), PAIRS)
    assert frame["brdf"].tolist() == [0.5, 0.25]
    says(" ".join(frame.attrs["notes"]), "line 2 is a row of units, and agrees with what is taken", "'R' [1/sr]")


@pytest.mark.parametrize("how", ["text", "workbook"])
@pytest.mark.parametrize(
    ("units", "pairs", "told"),
    [
        ("rad;deg;deg;deg;1/sr", PAIRS, "has rad for 'ti', and deg is taken for theta_i; write theta_i=ti:rad, or"),
        ("deg;deg;deg;deg;%", PAIRS, "write brdf=R:percent, or correct that row, or delete it"),
        ("deg;deg;deg;deg;-", PAIRS, "has - for 'R', and 1/sr is taken for brdf; write brdf=R:1/sr, or brdf=R:factor"),
        ("deg;nm;deg;deg;1/sr", PAIRS, "has nm for 'pi', and deg is taken for phi_i; correct that row"),
        ("deg;deg;deg;deg;1/sr", f"{PAIRS}:percent", "has 1/sr for 'R', and percent is taken for brdf"),
    ],
)
def test_a_row_of_units_that_contradicts_is_refused(units: str, pairs: str, told: str, how: str) -> None:
    with pytest.raises(DataError) as caught:
        read(*with_units(units, how), pairs)
    says(str(caught.value), f"{(how == 'text' and 'a.csv') or 'a.xlsx'}, line 2: the row of units", told)


@pytest.mark.parametrize("how", ["text", "workbook"])
def test_what_a_row_of_units_says_stands_in_the_line_to_try(how: str) -> None:
    data, name = with_units("rad;deg;deg;deg;%", how)
    data = data if how == "workbook" else data.replace(b"30;", b"0.5;")
    if how == "workbook":
        data = xlsx([["ti", "pi", "tr", "pr", "R"], ["rad", "deg", "deg", "deg", "%"], [0.5, 0.0, 20.0, 180.0, 5.0]])
    with pytest.raises(DataError) as caught:
        measurement.parse(data, Path(name))
    pairs = line_of(str(caught.value))
    says(pairs, "theta_i=ti:rad", "brdf=R:percent")
    assert read(data, name, pairs)["theta_i_deg"].iloc[0] == pytest.approx(np.rad2deg(0.5), rel=1e-15)


# ---- signs ----


@pytest.mark.parametrize(
    ("rows", "pairs", "expected"),
    [
        # theta_i, phi_i, theta_r, phi_r of the file; a negative theta_i is light from phi_i + 180
        ("-0.001 0 40 0", PAIRS, [0.001, 180, 40, 0]),
        ("-30 350 40 10", PAIRS, [30, 170, 40, 10]),
        ("-30 0 40 0", "theta_i=ti,theta_r=tr:signed,brdf=R,phi_i=0", [30, 180, 40, 0]),  # positive: the mirror side
        ("-30 0 -40 0", "theta_i=ti,theta_r=tr:signed,brdf=R,phi_i=0", [30, 180, 40, 180]),
        ("-30 0 40 90", "theta_i=ti,theta_r=tr,dphi=pr,brdf=R,phi_i=0", [30, 180, 40, 270]),  # of the light as it is
    ],
)
def test_a_negative_theta_i_is_light_from_the_other_side(rows: str, pairs: str, expected: list[float]) -> None:
    data = f"ti pi tr pr R\n{rows} 0.5\n".encode()
    with pytest.raises(DataError, match=r"theta_i_deg = -.* --columns .*theta_i=ti:signed"):
        read(data, "a.txt", pairs)
    frame = read(data, "a.txt", pairs.replace("theta_i=ti", "theta_i=ti:signed"))
    assert frame[[*ANGLES]].iloc[0].tolist() == expected
    says(" ".join(frame.attrs["notes"]), "theta_i is signed: 1 of 1 rows have the source at phi_i + 180")


def test_with_both_signs_of_theta_i_sides_are_those_of_positive_ones() -> None:
    """One axis for both arms: at -30 and 30 the mirror direction is at +30 and -30."""
    data = b"ti tr R\n-30 30 0.5\n30 -30 0.25\n30 30 0.1\n"
    frame = read(data, "a.txt", "theta_i=ti:signed,theta_r=tr:signed-retro,brdf=R")
    dphi = np.mod(frame["phi_r_deg"] - frame["phi_i_deg"], 360.0)
    assert dphi.tolist() == [180.0, 180.0, 0.0]
    says(" ".join(frame.attrs["notes"]), "theta_i has both signs: the mirror side is that of positive theta_i")


def test_a_matrix_may_have_negative_incidences() -> None:
    data = b"theta;-30;0;30\n10;1;2;3\n20;4;5;6\n"
    with pytest.raises(DataError) as caught:
        read(data, "a.csv", "phi_i=0,dphi=180,brdf=matrix")
    frame = read(data, "a.csv", line_of(str(caught.value)))
    assert frame["theta_i_deg"].tolist() == [30, 0, 30] * 2
    assert frame["phi_i_deg"].tolist() == [180, 0, 0] * 2


def test_nist_s_ptfe_is_read_by_its_columns_as_by_its_reader() -> None:
    path = measured("brdf/nist_ptfe/PTFE.data.csv")
    data = b"".join(path.read_bytes().splitlines(keepends=True)[:500])
    pairs = "wavelength=lambda:um,theta_i=thetai:signed,phi_i=phi,theta_r=thetar,phi_r=phir,brdf=f_r11"
    names = [*ANGLES, "wavelength_nm", "brdf"]
    known = measurement.parse(data, path)[names]
    pd.testing.assert_frame_equal(read(data, "a.csv", pairs)[names], known, check_exact=True)
    with pytest.raises(DataError) as caught:
        read(data, "a.csv", pairs.replace(":signed", ""))
    pd.testing.assert_frame_equal(read(data, "a.csv", line_of(str(caught.value)))[names], known, check_exact=True)


# ---- the pairs beside a table ----


def own_parquet(units: bool) -> bytes:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pa.table({"ti": [0.5, 0.5], "pi": [0, 0], "tr": [20.1, 40.0], "pr": [180, 180], "R": [0.1, 0.2]})
    if units:
        rad = table.schema.field("ti").with_metadata({"units": "rad"})
        table = table.cast(table.schema.set(0, rad))
    out = io.BytesIO()
    pq.write_table(table, out)
    return out.getvalue()


def test_a_parquet_file_has_columns_too(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    path.write_bytes(own_parquet(units=True))
    with pytest.raises(DataError) as caught:
        measurement.read(path)
    says(line_of(str(caught.value)), "theta_i=ti:rad")
    with pytest.raises(DataError, match="has rad for 'ti', and deg is taken"):
        measurement.read(path, columns=own_pairs.pairs(PAIRS))
    pairs = own_pairs.pairs(PAIRS.replace("ti,", "ti:rad,"))
    first = measurement.read(path, columns=pairs)
    assert first["theta_r_deg"].tolist() == [20.1, 40.0]
    says(str(own_pairs.remember(path, pairs)), "a.columns.toml now names these columns")
    pd.testing.assert_frame_equal(measurement.read(path), first, check_exact=True)


@pytest.mark.parametrize("name", ["a.dat", "a.asc", "a.TXT", "a.tab"])
def test_pairs_beside_a_text_of_any_usual_ending_are_heeded(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("\n".join(["ti;pi;tr;pr;R", *ROWS, ""]))
    assert own_pairs.remember(tmp_path / name, own_pairs.pairs(PAIRS)) is not None
    assert measurement.read(tmp_path / name)["brdf"].tolist() == [0.5, 0.25]


def test_two_channels_of_a_colour_are_told(tmp_path: Path) -> None:
    plain = (
        "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf,sample\n30,0,20,180,0.5,paint red\n30,0,20,180,0.5,paint blue"
    )
    (tmp_path / "a.csv").write_text(plain)
    told = (
        'paint has the channels red and blue and no green, and a colour needs all three: add the sample "paint green"'
    )
    with pytest.raises(ConfigError, match=told):
        measurement.of_one(tmp_path / "a.csv")
    with pytest.raises(DataError, match=told):
        channels.rows(measurement.read(tmp_path / "a.csv"), "a")
    assert all("and no green" in table.attrs["notes"][-1] for table in measurement.tables(tmp_path / "a.csv").values())


def test_where_pairs_are_not_heeded_is_told(tmp_path: Path) -> None:
    table = "\n".join(["ti;pi;tr;pr;R", *ROWS, ""])
    plain = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf\n30,0,20,180,0.5\n"
    (tmp_path / "a.csv").write_text(table)
    says(str(own_pairs.remember(tmp_path / "a.csv", own_pairs.pairs(PAIRS))), "a.columns.toml now")
    (tmp_path / "a.dat").write_text(table)
    says(str(own_pairs.remember(tmp_path / "a.dat", own_pairs.pairs(PAIRS))), "a.columns.toml is about a.csv")
    (tmp_path / "a.xlsx").write_bytes(xlsx([plain.splitlines()[0].split(","), [30, 0, 20, 180, 1]]))
    notes = measurement.read(tmp_path / "a.xlsx").attrs["notes"]
    says(" ".join(notes), "a.columns.toml is about a.csv, and is not heeded for a.xlsx")
    (tmp_path / "b.columns.toml").write_text('brdf = "R"\n')
    (tmp_path / "b.measured").write_text(plain)
    says(" ".join(measurement.read(tmp_path / "b.measured").attrs["notes"]), "b.columns.toml is not heeded: it is for")
    (tmp_path / "c.columns.toml").write_text('theta_i = "ti"\n')
    frame = measurement.read(tmp_path / "a.csv")
    measurement.write(frame.assign(wavelength_nm=550.0), tmp_path / "c.txt", format="astm")
    notes = measurement.read(tmp_path / "c.txt", format="astm").attrs["notes"]
    says(" ".join(notes), "c.columns.toml is not heeded: c.txt is read as ASTM")
    with pytest.raises(ConfigError, match="columns are named in texts, workbooks and Parquet files"):
        measurement.read(tmp_path / "c.txt", format="astm", columns={"theta_i": "ti"})
