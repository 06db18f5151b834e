"""Names are data: every file that is written gives them back as they were, or is refused in words and not written.

The kind: a text that means something to a format (a formula, an error, a quote, an element, the end of a line), or
that it cannot hold.
"""

import random
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
import pytest

from gonio import formats, measurement
from gonio.errors import DataError, GonioError
from gonio.formats import datacite
from gonio.formats.reader import table
from gonio.typing import DataFrame
from tests.command_line import gonio, says
from tests.names import CONTROLS, PUNCTUATION, SCRIPTS, drawn_names

MEANT = [
    "=1+1", "=Al/PTFE", "+a", "-a", "@a", "'a", "#N/A", "#DIV/0!", "TRUE", "1e5", "0", "nan", "NA", "null", "a\"b'c",
    "\"a\"", "<b>&amp;]]>", "--><!--", "a,b;c", "{a}%s", "_a", "\ufeffa", "x" * 300, "..", "/", "a/b", "1,5",
    PUNCTUATION,
]  # fmt: skip
NAMES = [*MEANT, *SCRIPTS.values(), *drawn_names(random.Random(1), 20)]


def one(name: str, level: float = 0.3) -> DataFrame:
    """A table of one sample."""
    angles = np.array([10.0, 20.0, 40.0, 60.0])
    return table(
        theta_i_deg=30.0, phi_i_deg=0.0, theta_r_deg=angles, phi_r_deg=180.0, wavelength_nm=550.0,
        brdf=level + angles / 1000, u_brdf=0.01, attrs={"sample": name},
    )  # fmt: skip


def several(*names: str) -> DataFrame:
    """Their tables in one, told apart by the column `sample`."""
    frames = []
    for k, name in enumerate(names):
        frames.append(one("", 0.3 + 0.1 * k))
        frames[-1].insert(6, "sample", name)
    frame = pd.concat(frames, ignore_index=True)
    frame.attrs = frames[0].attrs | {"sample": None, "samples": list(names)}
    return frame


@pytest.mark.parametrize("ending", [".csv", ".xlsx", ".h5", ".parquet"])
def test_many_samples_come_back_by_their_names(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    measurement.write(several(*NAMES), path)
    assert measurement.read(path).attrs["samples"] == NAMES


@pytest.mark.parametrize("ending", [".csv", ".xlsx", ".h5", ".parquet", ".astm", ".alta"])
def test_one_sample_comes_back_by_its_name(tmp_path: Path, ending: str) -> None:
    for name in [*MEANT, *NAMES[len(MEANT) :: 8]]:
        measurement.write(one(name), tmp_path / f"a{ending}")
        assert measurement.read(tmp_path / f"a{ending}").attrs["sample"] == name


@pytest.mark.parametrize("ending", [".csv", ".xlsx", ".h5", ".parquet", ".astm", ".alta"])
@pytest.mark.parametrize("sign", [*CONTROLS, "\r", "\x85", "\u2028"])
def test_what_a_format_cannot_hold_is_refused_in_words_and_nothing_is_written(
    tmp_path: Path, ending: str, sign: str
) -> None:
    name, path = f"Al{sign}6061", tmp_path / f"a{ending}"
    frame = one(name) if ending in (".astm", ".alta") else several(name, "b")
    try:
        measurement.write(frame, path)
    except DataError as error:
        says(str(error), str(path), repr(sign)[1:-1], "rename it")
        assert not list(tmp_path.iterdir())
    else:
        read = measurement.read(path).attrs
        found = read["sample"] if ending in (".astm", ".alta") else read["samples"][0]
        assert found == name or (sign == "\r" and found == "Al 6061")  # a line has no line within it


def test_texts_of_a_workbook_are_text_and_no_spreadsheet_runs_them(tmp_path: Path) -> None:
    frame = several(*NAMES).assign(**{"s_=1+1": 0.001})
    frame["u_random"] = 0.001
    measurement.write(frame, tmp_path / "a.xlsx")
    sheet = openpyxl.load_workbook(tmp_path / "a.xlsx")["table"]
    cells = [cell for row in sheet.iter_rows() for cell in row if isinstance(cell.value, str)]
    assert {cell.value for cell in cells} >= set(NAMES)
    assert {cell.data_type for cell in cells} == {"s"}
    assert {cell.value[0] for cell in cells if cell.quotePrefix} == set("=+-@") & {name[0] for name in NAMES}


@pytest.mark.slow
def test_every_format_of_tables_takes_any_name_or_says_why_not(tmp_path: Path) -> None:
    for kind in formats.all_formats().values():  # but GTC archives, which hold no names
        for name in [*NAMES[::30], *(f"a{sign}b" for sign in CONTROLS)] if kind.write and kind.name != "gtc" else ():
            try:
                measurement.write(one(name), tmp_path / "a", format=kind.name)
            except GonioError as error:
                says(str(error), str(tmp_path))


def test_half_a_character_is_its_code_from_the_reader_on(tmp_path: Path) -> None:
    measurement.write(several("a", "b"), tmp_path / "a.parquet")
    measurement.write(one("plain"), tmp_path / "a.csv")
    meta = tmp_path / "a.meta.json"
    meta.write_text(meta.read_text(encoding="utf-8").replace("plain", "pl\\ud800ain"), encoding="utf-8")
    assert measurement.read(tmp_path / "a.csv").attrs["sample"] == "pl\\ud800ain"


def test_a_terminal_shows_names_and_obeys_none(tmp_path: Path) -> None:
    """Colours, emoji by name, and escapes that clear a screen or change its title."""
    names = ["[red]x[/red]", ":red_circle:", "a\x9b2Jb"]
    measurement.write(several(*names), tmp_path / "a.csv")
    done = gonio(tmp_path, "convert", "a.csv", "a.astm", expect=1)
    says(done.stderr, "[red]x[/red]", ":red_circle:", "a\\x9b2Jb")
    fitted = gonio(tmp_path, "fit", "a.csv:[red]x[/red]", "--model", "lambert", expect=0)
    says(fitted.stdout, "[red]x[/red]")
    fitted = gonio(tmp_path, "fit", "a.csv:a\x9b2Jb", "--model", "lambert", expect=0)
    assert "\x9b" not in fitted.stdout + fitted.stderr


@pytest.mark.slow
def test_what_only_one_side_of_a_conversion_holds_takes_any_name(tmp_path: Path) -> None:
    """Files of pab that are read, records of DataCite, causes in archives of GTC, and fits of many tables."""
    gtc = pytest.importorskip("GTC")
    arabic, han, emoji, yi = (SCRIPTS[script] for script in ("Arabic", "Han", "Emoji", "Yi"))
    names = [arabic + PUNCTUATION, PUNCTUATION + han, f'{emoji}"', f"'{yi}"]
    folder = tmp_path / "tables"
    folder.mkdir()
    who = {"organisation": "A", "creators": [{"name": "B, C"}], "publication_year": 2024}
    for k, name in enumerate(names):
        frame = one(name)
        measurement.write(frame, folder / f"{k}.csv")
        frame.attrs["provenance"] = {"laboratory": who}
        (title,) = datacite.record(frame, tmp_path)["titles"]
        assert title == {"title": f"BRDF of {name}"}
        path = tmp_path / "a.txt"
        head = f'#sample_name "{name}"\n#format: theta phi BRDF\n#intheta 30\n#inphi 0\n'
        path.write_text(head + "10 180 0.3\n20 180 0.3\n", encoding="utf-8")
        assert measurement.read(path).attrs["sample"] == name
        caused = frame.assign(**{f"s_{name}": 0.001, "u_random": 0.001})
        measurement.write(caused, tmp_path / "a.gtc", format="gtc")
        archive = gtc.persistence.loads_json((tmp_path / "a.gtc").read_text(encoding="utf-8"))
        assert f"s_{name}" in {cause.label for cause in gtc.reporting.budget(archive.extract("brdf_0"))}
    gonio(tmp_path, "fit", "--each", "tables", "--model", "lambert", "--out", "fits.csv", expect=0)
    assert pd.read_csv(tmp_path / "fits.csv")["sample"].tolist() == names
