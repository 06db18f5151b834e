"""Tables under their makers' own column names and units."""

import io
import json
import math
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest

from gonio import measurement
from gonio.cli.tables import convert
from gonio.errors import ConfigError, DataError
from gonio.formats import own_pairs, workbook
from gonio.formats.sheets import Sheet
from tests import recipes
from tests.command_line import gonio, says, some

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
    frame = measurement.parse(mine(mark, point).encode(), Path("mine.csv"), columns=own_pairs.pairs(SPEC))
    assert_plain(frame)
    says(" ".join(frame.attrs["notes"]), "'R' [factor] is brdf", "columns left out: 'run'")


def test_the_file_beside_the_table_is_read_by_every_command(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text(mine())
    pairs = own_pairs.pairs(SPEC).items()
    (tmp_path / "mine.columns.toml").write_text("".join(f'{key} = "{own}"\n' for key, own in pairs))
    assert_plain(measurement.read(tmp_path / "mine.csv"))
    (frame,) = measurement.tables(tmp_path / "mine.csv").values()  # what the commands call
    assert_plain(frame)
    assert own_pairs.beside(tmp_path / "mine.xls") is None  # another file, of the same name


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
        ("brdf=R:share", "'share' is no unit of it; 1/sr or factor"),
    ],
)
def test_pairs_that_are_wrong(spec: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        measurement.parse(mine().encode(), Path("mine.csv"), columns=own_pairs.pairs(spec))


def test_what_is_wrong_with_the_files_is_told(tmp_path: Path) -> None:
    columns = own_pairs.pairs(SPEC)
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


def xlsx(*sheets: Sequence[Sequence[object]]) -> bytes:
    """A workbook with these rows."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in sheets:
        sheet = book.create_sheet()
        for row in rows:
            sheet.append(list(row))
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


ROWS: list[list[object]] = [
    ["run", "R", "ti", "pi", "tr", "pr", "wl", "U"],
    [1, 0.25 * math.pi, math.radians(10), 180, 20, 0, 0.55, 0.01 * math.pi],
    [1, 0.5 * math.pi, math.radians(10), 180, 70, 0, 0.55, 0.02 * math.pi],
]


def test_a_workbook_under_ones_own_names() -> None:
    frame = measurement.parse(xlsx([["a remark"]], ROWS), Path("mine.xlsx"), columns=own_pairs.pairs(SPEC))
    assert_plain(frame)
    assert "worksheet 2 of 2 is read" in frame.attrs["notes"]


def test_a_workbook_under_the_tables_names_needs_none() -> None:
    header = PLAIN.splitlines()[0].split(",")
    values = [[float(cell) for cell in line.split(",")] for line in PLAIN.splitlines()[1:]]
    assert_plain(measurement.parse(xlsx([header, *values]), Path("plain.xlsx")))
    with pytest.raises(DataError, match="rename 'theta_i' to 'theta_i_deg'"):
        measurement.parse(xlsx([["theta_i", *header[1:]], *values]), Path("plain.xlsx"))


def test_an_old_workbook_under_ones_own_names(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = [[v if isinstance(v, str) else float(str(v)) for v in row] for row in ROWS]
    cells = {(r, c): value for r, row in enumerate(numbers) for c, value in enumerate(row)}
    monkeypatch.setattr(workbook, "worksheets", lambda data, path: [Sheet(cells)])  # the reader has tests of its own
    assert_plain(measurement.parse(workbook.OLD, Path("mine.xls"), columns=own_pairs.pairs(SPEC)))


def test_damaged_workbooks(survives: Callable[..., None]) -> None:
    survives(xlsx([PLAIN.splitlines()[0].split(","), [10, 180, 20, 0, 550, 0.25, 0.01]]), "mine.xlsx")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a.txt", "a")
    with pytest.raises(DataError, match=r"mine\.xlsx: is a zip, but no Excel workbook"):
        measurement.parse(out.getvalue(), Path("mine.xlsx"))


def test_the_names_are_remembered_and_never_written_over(tmp_path: Path) -> None:
    table, file = tmp_path / "mine.csv", tmp_path / "mine.columns.toml"
    table.write_text(mine())
    columns = own_pairs.pairs(SPEC)
    said = some(own_pairs.remember(table, columns))
    assert "mine.columns.toml now names these columns" in said
    assert_plain(measurement.read(table))
    assert own_pairs.remember(table, columns) is None  # it says the same
    before = file.read_bytes()
    said = some(own_pairs.remember(table, {**columns, "brdf": "R"}))
    assert "says otherwise than --columns" in said
    assert file.read_bytes() == before
    (tmp_path / "mine.xlsx").write_bytes(xlsx(ROWS))
    says(some(own_pairs.remember(tmp_path / "mine.xlsx", columns)), "not remembered", "is about mine.csv")


def test_the_file_beside_a_workbook_is_its_own_where_no_csv_has_its_name(tmp_path: Path) -> None:
    (tmp_path / "mine.xlsx").write_bytes(xlsx(ROWS))
    assert own_pairs.remember(tmp_path / "mine.xlsx", own_pairs.pairs(SPEC)) is not None
    assert_plain(measurement.read(tmp_path / "mine.xlsx"))


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["csv", "xlsx"])
def test_fit_compare_and_appearance_take_them(tmp_path: Path, ending: str) -> None:
    rows: list[list[object]] = [["inc", "az", "det", "azd", "R"]]
    rows += [[30.0, 180.0, float(t), 0.0, 50.0] for t in range(0, 85, 5)]
    rows += [[30.0, 180.0, float(t), 180.0, 50.0] for t in range(5, 85, 5)]
    table = tmp_path / f"mine.{ending}"
    text = "\n".join(",".join(map(str, row)) for row in rows) + "\n"
    table.write_bytes(xlsx(rows) if ending == "xlsx" else text.encode())
    spec = "theta_i=inc,phi_i=az,theta_r=det,phi_r=azd,brdf=R:percent"
    done = gonio(tmp_path, "fit", table.name, "--model", "lambert", "--columns", spec, "--json", expect=0)
    assert json.loads(done.stdout)["parameters"]["albedo"]["value"] == pytest.approx(0.5, rel=1e-9)
    assert "mine.columns.toml now names these columns" in " ".join(done.stderr.split())
    (tmp_path / "mine.columns.toml").unlink()
    done = gonio(tmp_path, "compare", table.name, "--models", "lambert", "--columns", spec, "--out", "page", expect=0)
    done = gonio(tmp_path, "appearance", table.name, "--json", expect=0)  # remembered
    assert json.loads(done.stdout)["lab"][0]["theta_i_deg"] == 45.0
    done = gonio(tmp_path, "fit", table.name, "--model", "lambert", "--columns", "theta_i=inc", expect=1)
    assert "no column is named for phi_i_deg" in done.stderr


def test_a_cell_without_a_column_and_an_empty_workbook_are_told() -> None:
    with pytest.raises(DataError, match=r"mine\.xlsx, worksheet 1, row 3: a cell in a column without a name"):
        measurement.parse(xlsx([["title"], [1], [1, 2]]), Path("mine.xlsx"))
    with pytest.raises(DataError, match="the workbook holds no cells"):
        measurement.parse(xlsx([[]]), Path("mine.xlsx"))


# ---- units that nobody has named ----

ANGLES = "theta_i=ti,phi_i=pi,theta_r=tr,phi_r=pr"
SCALES = {"1/sr": 1.0, "factor": 1 / math.pi, "percent": 0.01 / math.pi}


def table(*more: str, rows: Sequence[str] = ("30,0,10,180,62,2", "30,0,20,180,58,3")) -> bytes:
    return "\n".join([",".join(["ti", "pi", "tr", "pr", *more]), *rows, ""]).encode()


@pytest.mark.parametrize("unit", list(SCALES))
@pytest.mark.parametrize("key", ["u_brdf", "u_random", "u_angles", "s_lamp"])
def test_an_uncertainty_has_the_unit_of_brdf(key: str, unit: str) -> None:
    """Kind: a column that belongs to another is read in a unit of its own; 2 % of a factor was 2 per steradian."""
    columns = own_pairs.pairs(f"{ANGLES},{key}=dR,brdf=R:{unit}")
    frame = measurement.parse(table("R", "dR"), Path("a.csv"), columns=columns)
    # two roundings, by 100 and by pi
    assert frame[key].tolist() == pytest.approx([2 * SCALES[unit], 3 * SCALES[unit]], rel=1e-15)
    told = " ".join(frame.attrs["notes"])
    assert f"'dR' [{unit}] is {key}" in told
    assert (f"write {key} = 'dR:1/sr'" in told) == (unit != "1/sr")


def test_a_unit_that_is_named_for_an_uncertainty_wins() -> None:
    of = "theta_i=ti,phi_i=pi,theta_r=tr,phi_r=pr,brdf=R:percent,u_random=dR:"
    expected = {"1/sr": [2.0, 3.0], "factor": [2 / math.pi, 3 / math.pi], "relative": [1.24 / math.pi, 1.74 / math.pi],
                "relative-percent": [0.0124 / math.pi, 0.0174 / math.pi]}  # fmt: skip
    for unit, values in expected.items():
        frame = measurement.parse(table("R", "dR"), Path("a.csv"), columns=own_pairs.pairs(of + unit))
        assert frame["u_random"].tolist() == pytest.approx(values, rel=2e-15)  # four roundings
    signed = measurement.parse(
        table("R", "dR", rows=["30,0,10,180,-62,2"]), Path("a.csv"),
        columns=own_pairs.pairs(f"{ANGLES},brdf=R:1/sr,u_random=dR:relative-percent"),
    )  # fmt: skip
    assert signed["u_random"].tolist() == pytest.approx([1.24], rel=1e-15)  # an uncertainty has no sign


def test_an_uncertainty_under_the_tables_name_follows_too() -> None:
    frame = measurement.parse(table("R", "u_brdf"), Path("a.csv"), columns=own_pairs.pairs(f"{ANGLES},brdf=R:factor"))
    assert frame["u_brdf"].tolist() == [2 / math.pi, 3 / math.pi]
    says(" ".join(frame.attrs["notes"]), "the unit of brdf is that of 'u_brdf' [factor] too")


def test_a_file_that_an_older_version_wrote_is_read_right_and_told(tmp_path: Path) -> None:
    """Kind: what was remembered wrongly goes on being wrong. A new file states each unit."""
    (tmp_path / "a.csv").write_bytes(table("R", "dR"))
    pairs = own_pairs.pairs(f"{ANGLES},brdf=R:percent,u_random=dR")
    old = "".join(f'{key} = "{own}"\n' for key, own in pairs.items())
    (tmp_path / "a.columns.toml").write_text(old)
    done = gonio(tmp_path, "convert", "a.csv", "-", "--to", "gonio", expect=0)
    assert repr(3 * 0.01 / math.pi)[:12] in done.stdout
    assert "write u_random = 'dR:1/sr'" in " ".join(done.stderr.split())
    (tmp_path / "a.columns.toml").unlink()
    some(own_pairs.remember(tmp_path / "a.csv", pairs))
    assert 'u_random = "dR:percent"' in (tmp_path / "a.columns.toml").read_text()
    assert own_pairs.remember(tmp_path / "a.csv", pairs) is None  # it says the same


@pytest.mark.parametrize(
    ("spec", "more", "told"),
    [
        (f"{ANGLES},brdf=R (%)", ("R (%)", "U"), "brdf=R (%):percent, or brdf=R (%):1/sr"),
        (f"{ANGLES},brdf=R:factor,u_brdf=U [1/sr]", ("R", "U [1/sr]"), "u_brdf=U [1/sr]:1/sr, or"),
        (f"{ANGLES},brdf=R:factor,u_brdf=U%", ("R", "U%"), "u_brdf=U%:percent, or u_brdf=U%:relative-percent, or"),
        (f"{ANGLES},brdf=R,wavelength=lambda_um", ("R", "lambda_um"), "wavelength=lambda_um:um, or"),
        (f"{ANGLES.replace('=ti', '=t [rad]')},brdf=R", ("R", "U"), "theta_i=t [rad]:rad, or"),
    ],
)
def test_a_name_that_says_another_unit_than_the_one_taken_is_refused(
    spec: str, more: tuple[str, str], told: str
) -> None:
    """Kind: a unit that stands in the file's own header, and is passed over."""
    with pytest.raises(ConfigError) as caught:
        measurement.parse(table(*more), Path("a.csv"), columns=own_pairs.pairs(spec))
    assert told in str(caught.value)


def test_a_wavelength_in_another_unit_is_refused() -> None:
    """Kind: 0.55 in a column of nanometres, and 550 in one of micrometres."""
    for text, unit in (("0.55", "nm"), ("10.6", "nm"), ("5.5e-7", "nm"), ("550", "um")):
        data = table("R", "wl", rows=[f"30,0,10,180,0.3,{text}"])
        with pytest.raises(DataError, match=r"line 2: wavelength_nm = .*; from 100 to 200000 nanometres"):
            measurement.parse(data, Path("a.csv"), columns=own_pairs.pairs(f"{ANGLES},brdf=R,wavelength=wl:{unit}"))
    with pytest.raises(DataError, match=r"wavelength_nm = 0\.55"):
        measurement.parse(PLAIN.replace(",550,", ",0.55,").encode(), Path("plain.csv"))


def test_rows_that_are_copies_are_told(tmp_path: Path) -> None:
    """Kind: one measurement that counts twice. Repeats with other values are no copies."""
    line = PLAIN.splitlines()[1]
    twice = measurement.parse((PLAIN + line + "\n").encode(), Path("plain.csv"))
    told = "rows that are the same as another in every column: 1 (the first are 1 and 3 of the table)"
    says(" ".join(twice.attrs["notes"]), told)
    repeat = measurement.parse((PLAIN + line.replace("0.25", "0.26") + "\n").encode(), Path("plain.csv"))
    assert not any("the same as another" in note for note in repeat.attrs["notes"])
    (tmp_path / "a.csv").write_text(PLAIN + line + "\n")
    done = gonio(tmp_path, "convert", "a.csv", "b.csv", expect=0)
    assert "Rows that are the same as another" in done.stderr


def test_a_refusal_of_columns_has_a_line_to_copy(tmp_path: Path) -> None:
    """Kind: a message that says what is wrong, and not how to go on."""
    header = "Incident Zenith,Source Azimuth,theta_r [rad],view_a,Reflectance factor,remark"
    (tmp_path / "a.csv").write_text(f"{header}\n30,0,0.5,180,0.9,x\n")
    with pytest.raises(DataError) as caught:
        measurement.read(tmp_path / "a.csv")
    _, _, rest = str(caught.value).partition('--columns "')
    line = rest.partition('"')[0]
    frame = measurement.read(tmp_path / "a.csv", columns=own_pairs.pairs(line))
    assert frame["brdf"].tolist() == [0.9 / math.pi]
    assert frame["theta_r_deg"].tolist() == pytest.approx([math.degrees(0.5)], rel=1e-15)
    with pytest.raises(
        DataError, match=r"in no format known here .* --columns \"theta_i=NAME,.*\.columns\.toml beside it"
    ):
        measurement.parse(b"u v w\n1 2 3\n", Path("a.txt"))


def test_a_name_keeps_its_letters_in_a_note() -> None:
    """Kind: an identifier that becomes a capitalised word."""
    frame = pd.DataFrame()
    frame.attrs["notes"] = ["theta_i_deg is here", "brdf is there", "a.csv is read", "one is not", "'x' is y"]
    told = ["theta_i_deg is here.", "brdf is there.", "a.csv is read.", "One is not.", "'x' is y."]
    assert measurement.of_reader(frame) == told


def test_tables_that_had_a_reader_of_their_own_are_read_as_the_page_says(tmp_path: Path) -> None:
    metals = measurement.tables(recipes.infrared_metals(tmp_path))
    assert len(metals) == 8
    assert {len(frame) for frame in metals.values()} == {890}
    grid = metals["sandblasted aluminium"].pivot(index="theta_i_deg", columns="theta_r_deg", values="brdf")
    angles = [angle for angle in grid.columns if angle in grid.index]
    square = grid.loc[angles, angles].to_numpy()
    assert (square / square.T).max() < 1.12  # Helmholtz: this sample is reciprocal within 12 %
    first = metals["aluminium (as received)"].iloc[0]  # 3.17056081e-3 W m^-2 sr^-1 at 15 and 89 degrees
    expected = 3.17056081e-3 / (3463.986 * math.cos(math.radians(89)) * math.pi * (5 / 315) ** 2)
    assert first["brdf"] == pytest.approx(expected, rel=1e-13)
    assert (first["theta_r_deg"], first["theta_i_deg"], first["phi_r_deg"] - first["phi_i_deg"]) == (15, 89, 180)
    frame = measurement.read(recipes.reflectance_factors(tmp_path))
    assert len(frame) == 329 * 35
    assert math.pi * frame["brdf"].iloc[0] == pytest.approx(0.7165, rel=1e-14)
    for theta_i, group in frame[frame["flag"] == ""].groupby("theta_i_deg"):
        peak = group.iloc[int(group["brdf"].argmax())]
        assert abs(peak["theta_r_deg"] - theta_i) <= 1  # the step of the table at its peaks
        assert peak["phi_r_deg"] == 180.0
