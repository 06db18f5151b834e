"""The measurement table: exact round trips, atomic writes, and messages that name file, line and column."""

import contextlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio import measurement
from gonio.cli.tables import convert
from gonio.errors import ConfigError, DataError
from gonio.formats import native
from gonio.formats.reader import ANGLES, COLUMNS, table


def example(count: int = 4, **changes: Any) -> pd.DataFrame:
    frame = table(
        theta_i_deg=30.0,
        phi_i_deg=0.0,
        theta_r_deg=np.linspace(0, 80, count),
        phi_r_deg=180.0,
        wavelength_nm=550.0,
        brdf=np.linspace(-1e-4, 1 / 3, count),
        u_brdf=0.01,
        u_random=0.006,
        attrs={
            "source_solid_angle_sr": 0.1 + 0.2,
            "bands": [{"name": "550 nm", "centre_nm": 550.0}],
            "provenance": {"seed": 3},
        },
    )
    frame.insert(len(frame.columns) - 1, "s_reference", -0.008)
    return frame.assign(**changes)


def test_columns_are_those_of_the_contract(tmp_path: Path) -> None:
    measurement.write(example(), tmp_path / "t.csv")
    back = measurement.read(tmp_path / "t.csv")
    assert [name for name in back.columns if not name.startswith("s_")] == list(COLUMNS)
    assert list(back.columns)[-2:] == ["s_reference", "flag"]
    assert all(back[name].dtype == np.float64 for name in back.columns if name not in ("flag", "polarisation"))
    assert (back["flag"].tolist(), back["polarisation"].tolist()) == ([""] * 4, ["unpolarised"] * 4)


def test_numbers_are_written_whole_however_numpy_prints(tmp_path: Path) -> None:
    """colour-science, once imported, has numpy print twelve digits."""
    with np.printoptions(legacy="1.13"):
        measurement.write(example(brdf=0.0008207405356859867), tmp_path / "t.csv")
    assert (measurement.read(tmp_path / "t.csv")["brdf"] == 0.0008207405356859867).all()


def test_a_round_trip_is_exact_and_a_flag_excuses_a_missing_value(tmp_path: Path) -> None:
    frame = example(flag=["", "blocked", "", "saturated"])
    frame.loc[1, ["brdf", "u_brdf", "u_random", "s_reference"]] = np.nan
    assert measurement.write(frame, tmp_path / "t.csv") == []
    back = measurement.read(tmp_path / "t.csv")
    pd.testing.assert_frame_equal(back, frame, check_exact=True)
    assert {key: back.attrs[key] for key in frame.attrs} == frame.attrs


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=20))
@settings(max_examples=60, deadline=None)
def test_every_float_comes_back_to_the_last_bit(values: list[float]) -> None:
    frame = example(len(values), brdf=values)
    frame["theta_r_deg"] = 10.0
    back = measurement.parse(frame.to_csv(index=False).encode(), Path("t.csv"))
    assert back["brdf"].to_numpy().tobytes() == np.array(values).tobytes()


def test_attributes_without_their_file_are_said_to_be_unknown(tmp_path: Path) -> None:
    measurement.write(example(), tmp_path / "t.csv")
    (tmp_path / "t.meta.json").unlink()
    attrs = measurement.read(tmp_path / "t.csv").attrs
    assert attrs["source_solid_angle_sr"] is None
    assert "t.meta.json" in attrs["notes"][0]


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("theta_r_deg", 90.5, "[0, 90]"),
        ("theta_i_deg", -5.0, "[0, 90]"),
        ("theta_i_deg", np.nan, "[0, 90]"),
        ("phi_r_deg", 360.0, "[0, 360)"),
        ("phi_i_deg", -90.0, "[0, 360)"),
        ("wavelength_nm", 0.0, "positive"),
        ("wavelength_nm", np.inf, "positive"),
        ("polarisation", "sideways", '"unpolarised", a letter for the light'),
        ("brdf", np.inf, "finite"),
        ("u_brdf", -0.1, ">= 0"),
        ("u_random", np.inf, ">= 0"),
        ("s_reference", np.nan, "finite"),
    ],
)
def test_a_value_that_is_not_allowed_names_file_line_and_column(
    tmp_path: Path, column: str, value: Any, told: str
) -> None:
    frame = example()
    frame.loc[2, column] = value
    path = tmp_path / "wrong.csv"
    path.write_text(frame.to_csv(index=False))
    with pytest.raises(DataError) as caught:
        measurement.read(path)
    for part in (f"{path}, line 4", column, told):  # header and two rows come before it
        assert part in str(caught.value)
    with pytest.raises(DataError, match="row 3"):
        measurement.write(frame, tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()
    assert not (tmp_path / "out.meta.json").exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a,b,c\n1,2,3\n", "columns missing: 'theta_i_deg'"),
        ("\n", "empty"),
        ("", "empty"),
    ],
)
def test_wrong_columns_and_empty_files(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=told):
        measurement.read(path)


def test_cells_that_are_wrong_are_located(tmp_path: Path) -> None:
    lines = example().to_csv(index=False).splitlines()
    path = tmp_path / "x.csv"
    damages: tuple[tuple[Callable[[str], str], str], ...] = (
        (lambda line: line.replace("550.0", "green"), 'line 3: wavelength_nm is "green", not a number'),
        (lambda line: line + ",1", "line 3: 12 cells, and the header names 11 columns"),
        (lambda line: line.rsplit(",", 4)[0], "line 3: 7 cells"),
        (lambda line: line.replace("550.0", "1e999"), "line 3: wavelength_nm"),
    )
    for damage, told in damages:
        path.write_text("\n".join([*lines[:2], damage(lines[2]), *lines[3:]]) + "\n")
        with pytest.raises(DataError, match=re.escape(told)):
            measurement.read(path)


def test_columns_that_nobody_knows_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="columns not known: 'temperature'"):
        measurement.write(example(temperature=20.0), tmp_path / "t.csv")


def test_binary_junk_is_one_clear_error(tmp_path: Path) -> None:
    for name in ("x.csv", "x.astm", "x.dat"):
        path = tmp_path / name
        path.write_bytes(np.random.default_rng(1).bytes(3000))
        with pytest.raises(DataError, match=name):
            measurement.read(path)


def test_a_missing_file_and_a_folder_are_configuration_errors(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        measurement.read(tmp_path / "nope.csv")
    with pytest.raises(ConfigError, match="not a run"):
        measurement.read(tmp_path)
    (tmp_path / "run.toml").write_text("")
    with pytest.raises(ConfigError, match="gonio reduce"):
        measurement.read(tmp_path)
    measurement.write(example(), tmp_path / "brdf.csv")
    assert len(measurement.read(tmp_path)) == 4


def test_an_unknown_format_names_the_nearest(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("x")
    with pytest.raises(ConfigError, match='did you mean "astm"'):
        measurement.read(tmp_path / "t.csv", format="astn")
    with pytest.raises(ConfigError, match="no format is written"):
        measurement.write(example(), tmp_path / "t.xyz")


def test_a_write_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"cannot be written: there is no folder .*absent"):
        measurement.write(example(), tmp_path / "absent" / "t.csv")
    bad = example()
    bad.attrs["provenance"] = {"x": float("nan")}
    with pytest.raises(DataError, match="attribute"):
        measurement.write(bad, tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_meta_file_is_named(tmp_path: Path) -> None:
    measurement.write(example(), tmp_path / "t.csv")
    for text in ('{"a": ', "[1]", '{"source_solid_angle_sr": "wide"}', '{"receiver_solid_angle_sr": -1}'):
        (tmp_path / "t.meta.json").write_text(text)
        with pytest.raises(DataError, match=r"t\.meta\.json"):
            measurement.read(tmp_path / "t.csv")


def test_what_a_format_has_no_room_for_is_said(tmp_path: Path) -> None:
    frame = example()
    assert measurement.write(frame, tmp_path / "t.csv") == []
    assert measurement.write(frame.assign(brdf=frame["brdf"].abs()), tmp_path / "t.brdf") == []
    lost = measurement.write(frame, tmp_path / "t.astm")
    assert [sentence.split("no room for ")[1].split(":")[0] for sentence in lost] == ["uncertainties", "solid angles"]
    frame["flag"] = "saturated"
    assert measurement.write(frame, tmp_path / "t.astm")[-1].endswith(
        f"{len(frame)} rows flagged saturated will read as clamped"
    )


def test_all_states_of_polarisation_together_are_unpolarised_light() -> None:
    frame = example(8)
    frame["theta_r_deg"] = [10.0, 10.0, 20.0, 30.0, 30.0, 30.0, 30.0, 40.0]
    frame["polarisation"] = ["s", "p", "s", "sp", "ss", "pp", "ps", "unpolarised"]
    frame["brdf"] = [0.2, 0.1, 9.0, 0.04, 0.2, 0.3, 0.06, 0.5]
    frame.loc[1, "s_reference"] = 0.004
    out = measurement.unpolarised(frame)
    assert out["polarisation"].tolist() == ["unpolarised", "s", "unpolarised", "unpolarised"]
    assert out["theta_r_deg"].tolist() == [10.0, 20.0, 30.0, 40.0]
    np.testing.assert_allclose(out["brdf"], [0.15, 9.0, 0.3, 0.5], rtol=1e-14)
    # of incident s and p half each; of all four states half the sum
    np.testing.assert_allclose(out["u_random"], [0.006 / np.sqrt(2), 0.006, 0.006, 0.006], rtol=1e-14)
    np.testing.assert_allclose(out["s_reference"], [-0.002, -0.008, -0.016, -0.008], rtol=1e-14)
    np.testing.assert_allclose(out["u_brdf"] ** 2, out["u_random"] ** 2 + out["s_reference"] ** 2, rtol=1e-14)
    assert "2 values were measured in every state of polarisation" in out.attrs["notes"][-1]
    flagged = frame.assign(flag=["", "saturated", *[""] * 6])
    assert measurement.unpolarised(flagged)["flag"].tolist() == ["saturated", "", "", ""]


def test_polarised_values_that_are_not_all_there_stay_as_they_are() -> None:
    for states in (["s", "s", "sp", "pp"], ["unpolarised"] * 4):
        frame = example(4, polarisation=states, theta_r_deg=10.0)
        assert measurement.unpolarised(frame) is frame
    beside = example(3, polarisation=["s", "p", "unpolarised"], theta_r_deg=10.0)  # somebody has combined them already
    assert measurement.unpolarised(beside) is beside


def test_samples_of_a_file_by_name(tmp_path: Path) -> None:
    path = tmp_path / "metals.csv"
    every = example(3).drop(columns="s_reference").assign(sample=["zinc", "brass", "zinc"])
    every.attrs["samples"] = ["zinc", "brass"]
    measurement.write(every, path)
    assert {name: len(frame) for name, frame in measurement.tables(path).items()} == {"zinc": 2, "brass": 1}
    ((name, brass),) = measurement.tables(f"{path}:brass").items()
    assert name == "brass"
    assert (list(brass.columns), brass.attrs["sample"]) == (list(COLUMNS), "brass")
    with pytest.raises(DataError, match=r'metals.csv:zinc", ".*metals.csv:brass"'):
        measurement.tables(f"{path}:tin")
    with pytest.raises(ConfigError, match="no such file"):
        measurement.tables(tmp_path / "none.csv:tin")
    measurement.write(measurement.read(path), tmp_path / "native.csv")
    assert list(measurement.tables(tmp_path / "native.csv")) == ["zinc", "brass"]


def test_a_table_that_is_read_in_pieces_is_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """The quick reader's pieces are set here; those of the one that says what is wrong are 20 000 lines."""
    frame = example(45_000).assign(flag=[("", "hot", "blocked")[k % 3 if k > 30_000 else 0] for k in range(45_000)])
    monkeypatch.setattr(native, "CHUNK", 10_000)  # the last begins with another word than those before
    back = measurement.parse(frame.to_csv(index=False).encode(), Path("big.csv"))
    pd.testing.assert_frame_equal(back, frame, check_exact=True)
    frame.loc[44_321, "theta_r_deg"] = 91.0
    with pytest.raises(DataError, match=r"big\.csv, line 44323: theta_r_deg = 91"):
        measurement.parse(frame.to_csv(index=False).encode(), Path("big.csv"))
    lines = frame.to_csv(index=False).splitlines()
    lines[44_322] += ",1"
    with pytest.raises(DataError, match=r"big\.csv, line 44323: 12 cells"):
        measurement.parse("\n".join(lines).encode(), Path("big.csv"))


def test_sizes_are_bounded_before_anything_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    from gonio.formats import text

    monkeypatch.setattr(text, "MAX_LINES", 100)
    with pytest.raises(DataError, match=r"x\.csv: has more than 100 lines"):
        measurement.parse(b"theta_i_deg,u_brdf\n" + b"\n" * 300, Path("x.csv"))
    with pytest.raises(DataError, match="larger than 16 MiB, the largest Klems XML"):
        measurement.parse(b"<WindowElement>" + b" " * 2**24, Path("x.xml"))


def test_a_table_made_by_hand_needs_only_angles_and_values() -> None:
    text = "brdf,theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,s_lamp\n0.25,30,0,45,180,1e-3\n0.5,30,0,0,180,2e-3\n"
    frame = measurement.parse(text.encode(), Path("mine.csv"))
    assert [name for name in frame.columns if name != "s_lamp"] == list(COLUMNS)
    assert frame["brdf"].tolist() == [0.25, 0.5]
    assert frame["wavelength_nm"].isna().all()
    assert frame["u_brdf"].isna().all()
    assert (set(frame["polarisation"]), set(frame["flag"])) == ({"unpolarised"}, {""})
    assert any("no columns wavelength_nm, polarisation, u_brdf, u_random, flag" in n for n in frame.attrs["notes"])


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("point", [".", ","])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_a_spreadsheet_s_own_separators_are_taken(mark: str, point: str, ending: str) -> None:
    plain = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf,flag\n30,0,45.5,180,1.25e-1,\n30,0,0,180,0.5,blocked\n"
    other = plain.replace(",", mark).replace(".", point).replace("\n", ending)
    frame = measurement.parse(other.encode(), Path("mine.csv"))
    pd.testing.assert_frame_equal(frame, measurement.parse(plain.encode(), Path("mine.csv")), check_exact=True)
    with pytest.raises(DataError, match=r"line 2, theta_i_deg is \"3\.0,0\", .*: decimal commas and points in one"):
        measurement.parse(other.replace(f"{ending}30", f"{ending}3.0,0", 1).encode(), Path("mine.csv"))


def test_one_sample_of_a_file_on_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = example(4)
    frame.insert(6, "sample", ["tile", "tile: wet", "tile", "tile: wet"])
    measurement.write(frame, tmp_path / "two.csv")
    monkeypatch.chdir(tmp_path)
    assert measurement.split("two.csv:tile: wet") == ("two.csv", "tile: wet")
    assert measurement.split("two.csv:tile") == ("two.csv", "tile")
    assert measurement.split("two.csv") == ("two.csv", None)
    convert("two.csv:tile", Path("tile.astm"))
    assert measurement.read("tile.astm")["brdf"].tolist() == frame["brdf"].tolist()[::2]
    with pytest.raises(DataError, match='no sample "dry"'):
        convert("two.csv:dry", Path("dry.astm"))


FORMULAS = ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "＝1", "'=1", "''-1", "'quoted'", "-", "a=b", "it's"]


@pytest.mark.parametrize("several", [False, True])
def test_a_text_that_a_spreadsheet_would_run_is_guarded_and_comes_back(tmp_path: Path, several: bool) -> None:
    frame = example(len(FORMULAS), flag=FORMULAS)
    if several:
        frame.insert(6, "sample", FORMULAS[::-1])
        frame.attrs["samples"] = FORMULAS[::-1]
    measurement.write(frame, tmp_path / "t.csv")
    plain = pd.read_csv(tmp_path / "t.csv", keep_default_na=False, dtype={"flag": str})
    assert not plain["flag"].str.match(r"[=+\-@\t\r]").any()
    assert pd.api.types.is_numeric_dtype(plain["brdf"])
    assert plain["brdf"].min() < 0
    back = measurement.read(tmp_path / "t.csv")
    assert back["flag"].tolist() == FORMULAS
    pd.testing.assert_frame_equal(back[["brdf", "s_reference"]], frame[["brdf", "s_reference"]], check_exact=True)
    if several:
        assert back["sample"].tolist() == FORMULAS[::-1]
        assert back.attrs["samples"] == FORMULAS[::-1]


@pytest.mark.parametrize("hole", ["", "nan", "NaN", "NAN"])
@pytest.mark.parametrize("columns", ["", ",flag", ",u_brdf,flag"])
def test_a_hole_in_a_table_made_by_hand_is_flagged(hole: str, columns: str) -> None:
    rest = columns.replace(",flag", ",").replace("u_brdf", "0.01")
    text = (
        f"theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf{columns}\n30,0,10,180,0.1{rest}\n30,0,20,180,{hole}{rest}\n"
    )
    frame = measurement.parse(text.encode(), Path("mine.csv"))
    assert frame["flag"].tolist() == ["", "not_measured"]
    assert np.isnan(frame["brdf"][1])
    assert '1 of 2 values are empty: flagged "not_measured"' in frame.attrs["notes"]


@pytest.mark.parametrize("names", ["s_c{}", "x{}", "s_same"])
def test_the_work_grows_with_the_number_of_columns_and_not_with_its_square(tmp_path: Path, names: str) -> None:
    """By the number of calls, which no load of the machine changes: four times the columns are four times the calls."""

    def calls(count: int) -> int:
        seen = 0

        def see(frame: object, event: str, argument: object) -> None:
            nonlocal seen
            seen += event in ("call", "c_call")

        head = ",".join([*ANGLES, "brdf", *(names.format(k) for k in range(count))])
        row = ",".join(["30", "0", "10", "180", "0.1", *["0.001"] * count])
        data = f"{head}\n{row}\n".encode()
        sys.setprofile(see)
        try:
            with contextlib.suppress(DataError):
                measurement.parse(data, Path("wide.csv"))
        finally:
            sys.setprofile(None)
        return seen

    calls(1500)  # imports
    assert calls(6000) < 5 * calls(1500) + 5000


def test_a_table_in_memory_with_a_hole_and_no_flag_is_not_written(tmp_path: Path) -> None:
    frame = example()
    frame.loc[2, "brdf"] = np.nan
    with pytest.raises(DataError, match="row 3: brdf = nan; a row without a flag needs a finite value"):
        measurement.write(frame, tmp_path / "t.csv")
    assert list(tmp_path.iterdir()) == []
