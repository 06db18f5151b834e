"""Remount scatter: scale, zero and the rest are found where they were put in; measured mounts; the budget."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.changes.remounts import draw, remounts, with_remount

from gonio import measurement
from gonio.errors import DataError
from tests.command_line import gonio
from tests.places import measured

COLUMNS = (
    "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "polarisation", "brdf", "u_brdf",
    "u_random", "flag",
)  # fmt: skip
FILES = "brdf/loft_rt300s/raw"


def mount(scale: float = 1.0, zero_deg: float = 0.0, noise: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """A lobe about the mirror direction, as a mount sees it whose receiver reads `zero_deg` too large."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in (10.0, 30.0, 50.0):
        for r in np.arange(-20.0, 70.0, 2.5):
            f = 0.05 + 0.4 * math.exp(-(((r - zero_deg - i) / 18.0) ** 2))
            f *= scale * (1.0 + noise * rng.standard_normal())
            rows.append((i, 0.0, abs(r), 180.0 if r >= 0 else 0.0, 550.0, "unpolarised", f, np.nan, np.nan, ""))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def test_what_was_put_in_is_found() -> None:
    mounts = {"a": mount(1.03, 0.4, 0.01, 1), "b": mount(0.98, -0.3, 0.01, 2), "c": mount(0.99, -0.1, 0.01, 3)}
    found = remounts(mounts)
    # standard deviations of what was put in; what is left scatters by 1 %, so the scales are known to 0.2 %
    assert found.scale == pytest.approx(np.std([1.03, 0.98, 0.99], ddof=1), abs=0.003)
    assert math.degrees(found.zero) == pytest.approx(np.std([0.4, -0.3, -0.1], ddof=1), abs=0.1)
    assert found.independent == pytest.approx(0.01, rel=0.25)
    assert abs(found.neighbours) < 0.3
    assert "2 degrees of freedom" in " ".join(found.lines())


def test_no_zero_is_said_where_none_is_seen() -> None:
    found = remounts({"a": mount(1.0, 0.0, 0.02, 1), "b": mount(1.0, 0.0, 0.02, 2)})
    assert found.zero == 0.0
    assert found.scale < 0.01


def test_the_scatter_is_a_cause_of_a_table() -> None:
    found = remounts({"a": mount(1.05, 0.5, 0.01, 1), "b": mount(0.95, -0.5, 0.01, 2)})
    table = with_remount(mount(noise=0.01), found)
    random, common, causes = measurement.uncertainty(table)
    assert causes == ["remount_scale", "remount_zero"]
    assert common[:, 0] == pytest.approx(found.scale * table["brdf"].to_numpy())
    # the slope at the flank of the lobe at 30 degrees, by its formula; interpolated between steps of 2.5 degrees
    flank = table[(table["theta_i_deg"] == 30.0) & (table["theta_r_deg"] == 45.0) & (table["phi_r_deg"] == 180.0)].index
    slope = -0.4 * math.exp(-((15.0 / 18.0) ** 2)) * 2.0 * 15.0 / 18.0**2 * 180.0 / math.pi
    assert common[flank[0], 1] == pytest.approx(found.zero * slope, rel=0.15)
    assert random == pytest.approx(found.independent * table["brdf"].to_numpy())
    assert table["u_brdf"].to_numpy() == pytest.approx(np.sqrt(random**2 + (common**2).sum(axis=1)))
    assert "a new mount is in the budget" in table.attrs["notes"][-1]


def test_too_little_in_common_is_said() -> None:
    with pytest.raises(DataError, match="bright directions in common"):
        remounts({"a": mount(), "b": mount().assign(theta_i_deg=70.0)})


def test_the_command_writes_a_table_that_fits_read(tmp_path: Path) -> None:
    for name, one in (("a", mount(1.02, 0.2, 0.01, 1)), ("b", mount(0.98, -0.2, 0.01, 2))):
        measurement.write(one, tmp_path / f"{name}.csv")
    done = gonio(
        tmp_path,
        "remounts",
        "a.csv",
        "b.csv",
        "--json",
        "--picture",
        "p.png",
        "--add-to",
        "a.csv",
        "--out",
        "c.csv",
        expect=0,
    )
    assert json.loads(done.stdout)["degrees_of_freedom"] == 1
    assert (tmp_path / "p.png").stat().st_size > 5000
    assert measurement.uncertainty(measurement.read(tmp_path / "c.csv"))[2] == ["remount_scale", "remount_zero"]
    lines = gonio(tmp_path, "remounts", "a.csv", "b.csv", "--wavelength-nm", "700", expect=0).stdout
    assert "common directions at 550 nm, the brightest 60 %" in lines  # the one that there is
    assert "not supported" in gonio(tmp_path, "remounts", "a.csv", "b.csv", "--picture", "p.txt", expect=2).stderr
    assert not (tmp_path / "p.txt").exists()
    assert "two tables are needed" in gonio(tmp_path, "remounts", "a.csv", expect=2).stderr


def test_measured_mounts_differ_as_they_were_found_to() -> None:
    """About 10 % on invar, mounted twice, and 3.5 to 5 % on steel, turned: medians of others' evaluations."""
    found = {}
    for name in ("invar", "steel"):
        files = sorted(measured(FILES).glob(f"NiTE_on_{name}_v1o0[AB]_*.xls"))
        found[name] = remounts({path.stem: measurement.read(path) for path in files})
    assert 0.08 < found["invar"].typical < 0.12
    assert 0.03 < found["steel"].typical < 0.06
    assert found["invar"].neighbours > 0.5, "what a mount changes is smooth over the directions"


def flat(value: float = 0.159) -> pd.DataFrame:
    """A diffuse sample, whose numbers are alike in every direction: nothing is left of them."""
    return mount().assign(brdf=value)


@pytest.mark.parametrize("other", [0.159, 0.161])
def test_mounts_of_which_nothing_is_left_have_no_neighbours_in_common(tmp_path: Path, other: float) -> None:
    found = remounts({"a": flat(), "b": flat(other)})
    said = " ".join(found.lines())
    assert "do not tell it" in said
    assert "nothing is left" in said
    assert not {"inf", "nan"} & set(said.replace(";", " ").split())
    draw(found)  # axes of no height would warn
    for name, one in (("a", flat()), ("b", flat(other))):
        one.attrs["notes"] = ["values were percent"]
        measurement.write(one, tmp_path / f"{name}.csv")
    done = gonio(tmp_path, "remounts", "a.csv", "b.csv", "--json", "--picture", "p.png", expect=0)
    known = json.loads(done.stdout, parse_constant=pytest.fail)  # NaN and Infinity are no JSON
    assert known["neighbours"] is None
    assert known["u_zero_deg"] is None
    assert done.stderr.count("all 2 tables: Values were percent.") == 1
