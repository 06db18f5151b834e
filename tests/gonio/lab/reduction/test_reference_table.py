"""The BRDF of a white reference from its table: linear between rows, an error beyond them."""

import math
from pathlib import Path
from typing import Any, cast

import pandas as pd
import pytest

from gonio.errors import ConfigError, DataError
from gonio.formats.workbook import OLD
from gonio.geometry import Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_settings import named_files
from gonio.lab.reduction import reference_table
from gonio.lab.reduction.brdf import reduce_in_parts
from gonio.lab.reduction.reference_table import brdf_of_reference, u_of_reference
from tests.gonio.lab.reduction.made_run import Maker, describe, in_plane


def table(waves: tuple[float, ...] = (500.0, 600.0)) -> pd.DataFrame:
    """In plane at 0 and 30 degrees, linear in every variable, so that linear interpolation is exact."""
    rows = []
    for w in waves:
        rows += [(0.0, 20.0, r, 200.0, w, linear(0.0, r, w)) for r in range(0, 81, 10)]
        rows += [(30.0, 20.0, abs(r), 200.0 if r >= 0 else 20.0, w, linear(30.0, r, w)) for r in range(-80, 81, 10)]
    names = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "brdf"]
    out = pd.DataFrame(rows, columns=names).assign(polarisation="unpolarised", flag="")
    out.attrs["source_file"] = "spectralon.csv"
    return out


# values are linear in all three, so that what is read from the table is right to rounding: 1e-12
def linear(theta_i: float, theta_r: float, wave: float) -> float:
    return 0.3 - 1e-3 * theta_i - 2e-4 * theta_r + 1e-4 * (0.0 if math.isnan(wave) else wave)


def visit(theta_i: float, theta_r: float) -> Directions:
    return Directions(math.radians(theta_i), 1.0, math.radians(abs(theta_r)), 1.0 + (math.pi if theta_r >= 0 else 0.0))


@pytest.mark.parametrize(
    ("theta_i", "theta_r", "wave"),
    [(0.0, 45.0, 500.0), (30.0, 44.0, 550.0), (30.0, -12.0, 600.0), (30.0, 0.0, 580.0), (12.0, 35.0, 500.0)],
)
def test_a_table_is_interpolated_along_curves_and_between_them(theta_i: float, theta_r: float, wave: float) -> None:
    value = brdf_of_reference(table(), visit(theta_i, theta_r), wave)
    assert value == pytest.approx(linear(theta_i, theta_r, wave), rel=1e-12)


def test_a_read_angle_near_a_curve_lies_on_it() -> None:
    assert brdf_of_reference(table(), visit(30.2, 20.0), 500.0) == pytest.approx(linear(30.0, 20.0, 500.0), rel=1e-12)
    assert brdf_of_reference(table(), visit(0.03, -45.0), 500.0) == pytest.approx(linear(0.0, 45.0, 500.0), rel=1e-12)


def test_a_broad_band_serves_every_wavelength() -> None:
    broad = table(waves=(math.nan,))
    assert brdf_of_reference(broad, visit(0.0, 45.0), 550.0) == pytest.approx(linear(0, 45, math.nan), rel=1e-12)


@pytest.mark.parametrize(
    ("theta_i", "theta_r", "wave", "message"),
    [
        (60.0, 10.0, 500.0, "theta_i = 60 deg lies outside"),
        (0.0, 85.0, 500.0, "theta_r = 85 deg at theta_i = 0 deg lies outside"),
        (0.0, 45.0, 450.0, "wavelength_nm = 450 lies outside"),
    ],
)
def test_outside_of_a_table_is_an_error(theta_i: float, theta_r: float, wave: float, message: str) -> None:
    with pytest.raises(DataError, match=f"spectralon.csv.*{message}"):
        brdf_of_reference(table(), visit(theta_i, theta_r), wave)


ACROSS = Directions(math.radians(30), 0.0, math.radians(40), math.radians(90))


@pytest.mark.parametrize(
    ("changes", "at", "told"),
    [
        ({}, ACROSS, "in the plane of incidence"),
        ({"polarisation": "ss"}, visit(0.0, 45.0), "must be unpolarised"),
        (
            {"theta_i_deg": 30.0, "theta_r_deg": 40.0, "phi_r_deg": 110.0},
            visit(30.0, 45.0),
            r"spectralon.csv: the measurement of the reference at .* lies outside of this table",
        ),
    ],
)
def test_a_visit_or_a_table_out_of_the_plane_and_a_polarised_table_are_errors(
    changes: dict[str, Any], at: Directions, told: str
) -> None:
    with pytest.raises(DataError, match=told):
        brdf_of_reference(table().assign(**changes), at, 500.0)


def test_flagged_rows_of_a_table_do_not_count() -> None:
    spoiled = table()
    bad = (spoiled["theta_r_deg"] == 40) & (spoiled["theta_i_deg"] == 0)
    spoiled.loc[bad, "brdf"], spoiled.loc[bad, "flag"] = 9.0, "saturated"
    assert brdf_of_reference(spoiled, visit(0.0, 45.0), 500.0) == pytest.approx(linear(0.0, 45.0, 500.0), rel=1e-12)


def test_the_table_s_uncertainty_is_interpolated_with_it() -> None:
    known = table().assign(u_brdf=lambda rows: 0.002 + 1e-5 * rows["theta_r_deg"])
    assert u_of_reference(known, visit(0.0, 40.0), 500.0) == pytest.approx(0.0024, rel=1e-9)
    # the values lie on straight lines: nothing comes from between them
    assert u_of_reference(known, visit(0.0, 45.0), 500.0) == pytest.approx(0.00245, rel=1e-9)
    # but two wavelengths do not tell that they do: a quarter of their difference, halfway
    assert u_of_reference(known, visit(0.0, 45.0), 550.0) == pytest.approx(math.hypot(0.00245, 0.0025), rel=1e-9)


def test_parts_of_an_uncertainty_count_together_where_the_whole_is_not_stated() -> None:
    parts = table().assign(u_random=0.003, s_scale=-0.004)
    assert u_of_reference(parts, visit(0.0, 40.0), 500.0) == pytest.approx(0.005, rel=1e-12)
    assert u_of_reference(table(), visit(0.0, 40.0), 500.0) == 0.0


def test_between_rows_of_a_bent_curve_the_interpolation_is_uncertain() -> None:
    """A cosine: the line between values 10 degrees apart is wrong by up to f h^2/8 = 0.4 %, and u is of that size."""
    bent = table(waves=(500.0,))
    bent["brdf"] = [0.3 * math.cos(math.radians(r)) for r in bent["theta_r_deg"]]
    for angle in (3.0, 25.0, 47.0, 75.0):
        true = 0.3 * math.cos(math.radians(angle))
        error = abs(brdf_of_reference(bent, visit(0.0, angle), 500.0) - true)
        assert 0.5 * error < u_of_reference(bent, visit(0.0, angle), 500.0) < 2.0 * error
    assert u_of_reference(bent, visit(0.0, 40.0), 500.0) == pytest.approx(0.0, abs=1e-15)


def test_a_table_of_which_a_part_is_uncertain_is_refused_where_it_is_not() -> None:
    known = table().assign(u_brdf=0.002)
    known.loc[known["theta_r_deg"] > 50.0, "u_brdf"] = math.nan
    assert u_of_reference(known, visit(0.0, 30.0), 500.0) == pytest.approx(0.002)
    with pytest.raises(
        DataError, match="some values have an uncertainty, and those around the measurement of the reference"
    ):
        u_of_reference(known, visit(0.0, 70.0), 500.0)


HEADER = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,brdf"


def test_what_a_reader_assumes_of_a_reference_is_said_of_the_run(tmp_path: Path) -> None:
    """Kind: a table that a command reads beside the one that it is about."""
    white = tmp_path / "white.csv"
    rows = "".join(f"{i},0,{r},{phi},0.31\n" for i in (0, 30, 60) for r in (0, 30, 60, 80) for phi in (0, 180))
    white.write_text(f"{HEADER}\n{rows}", encoding="utf-8")
    run = Maker(tmp_path, describe(), lambda d: 0.2).make([in_plane(30.0, 20.0)], (0.5,))
    run.description = describe(reference={"albedo": None, "table": str(white)})
    notes = reduce_in_parts(cast(Run, run)).table.attrs["notes"]
    assert any(note.startswith("reference table white.csv: There is no white.meta.json") for note in notes)


def test_several_samples_are_no_reference(tmp_path: Path) -> None:
    path = tmp_path / "white.csv"
    path.write_text(f"{HEADER},sample\n0,0,10,0,0.3,a\n0,0,10,0,0.2,b\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"white\.csv: reference\.table holds 2 samples.*gonio convert.*a; b"):
        reference_table.read(str(path))


def test_a_reference_that_is_read_with_a_file_beside_it_is_not_copied_without(tmp_path: Path) -> None:
    """Kind: a copy that would read otherwise than its original; here percent as 1/sr."""
    path = tmp_path / "white.csv"
    path.write_text(f"{HEADER}\n0,0,10,0,99\n", encoding="utf-8")
    rig = describe(reference={"albedo": None, "table": str(path)})
    assert named_files(rig)[0]["reference.csv"] == path.read_bytes()
    (tmp_path / "white.columns.toml").write_text('brdf = "brdf:percent"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"white\.csv: reference\.table is read with white\.columns\.toml beside it"):
        named_files(rig)
    path.write_bytes(OLD)  # an instrument's workbook, whose blank is looked for beside it
    with pytest.raises(ConfigError, match="gonio convert"):
        named_files(rig)


def test_a_direction_that_is_there_twice_counts_as_its_mean() -> None:
    """Kind: repeats where a formula wants places that differ; the parabola divided by their distance."""
    once = table()
    twice = pd.concat([once, once.assign(brdf=once["brdf"] + 0.02)], ignore_index=True)
    twice.attrs = once.attrs
    wanted = linear(0.0, 42.0, 500.0) + 0.01
    assert brdf_of_reference(twice, visit(0.0, 42.0), 500.0) == pytest.approx(wanted, rel=1e-12)
    assert u_of_reference(twice, visit(0.0, 42.0), 500.0) == pytest.approx(0.0, abs=1e-12)
