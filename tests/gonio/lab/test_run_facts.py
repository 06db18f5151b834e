"""What a page says of a run's white reference is what went into its budget."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.report import budget
from gonio_analysis.report.drawing import Figure

from gonio import measurement
from gonio.formats.reader import table
from gonio.lab import run_facts as record
from gonio.lab.reduction import brdf
from gonio.lab.reduction.table import said_once
from gonio.lab.rig.description import Reference
from gonio.lab.run_facts import run_budget, run_facts
from tests.gonio.numpy_rig import describe, measured, plan_in
from tests.gonio_analysis.synthetic import known

CERTIFIED = (0.002, 0.006)
"""Relative uncertainties at the first and at the last angle of the certificate."""


def reduced(here: Path, **reference: object) -> Path:
    description = describe()
    changed = {**description.reference.model_dump(), **reference}
    description = description.model_copy(update={"reference": Reference(**changed)})
    run = measured(plan_in(here), here / "run", description=description)
    run.write_table(brdf.reduce(run))
    return here / "run"


def certificate(path: Path, *, states: bool = True) -> str:
    """The BRDF of a white at normal incidence, every 15 degrees; uncertainties grow along a straight line."""
    theta_r = np.arange(0.0, 90.0, 15.0)
    value = np.full(theta_r.size, 0.31)
    frame = table(
        theta_i_deg=0.0, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=180.0, wavelength_nm=np.nan, brdf=value,
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )  # fmt: skip
    if states:
        frame["u_brdf"] = value * np.linspace(*CERTIFIED, theta_r.size)
    measurement.write(frame, path)
    return str(path)


def test_a_table_of_the_reference_says_how_well_it_is_known(tmp_path: Path) -> None:
    run = reduced(tmp_path, table=certificate(tmp_path / "white.csv"), albedo=None)
    facts = known(run_facts(run))
    frame = measurement.read(run / "brdf.csv")
    used = (frame["s_reference"] / frame["brdf"]).abs().dropna().unique()
    expected = np.interp(describe().reference.theta_r_deg, [0.0, 75.0], CERTIFIED)
    # the certificate is a straight line between whole steps of its table; readings scatter by hundredths of a degree
    np.testing.assert_allclose(used, expected, rtol=0.01)
    assert f"standard uncertainty {100 * expected:.2f} %" in facts.reference
    assert "its table states 0.20 % to 0.60 %" in facts.reference


def test_a_table_without_uncertainties_is_said_to_have_none(tmp_path: Path) -> None:
    run = reduced(tmp_path, table=certificate(tmp_path / "white.csv", states=False), albedo=None, u_rel=0.004)
    facts = known(run_facts(run))
    assert "standard uncertainty 0.40 %" in facts.reference  # the rig file's own
    assert "its table states no uncertainty" in facts.reference
    (run / "reference.csv").unlink()
    facts = known(run_facts(run))
    assert "standard uncertainty 0.40 %" in facts.reference  # it stands in the run itself
    assert "its table is no longer where it was" in facts.reference


def test_a_rig_file_s_uncertainty_is_said_before_and_after_the_reduction(tmp_path: Path) -> None:
    run = reduced(tmp_path, u_rel=0.0035)
    facts = known(run_facts(run))
    assert facts.reference.endswith("standard uncertainty 0.35 %")
    (run / "brdf.meta.json").unlink()
    facts = known(run_facts(run))
    assert facts.reference.endswith("standard uncertainty 0.35 %")


@pytest.mark.parametrize(
    ("notes", "said"),
    [
        ([("400 nm", ["a", "b 1.5"]), ("500 nm", ["a"])], ["400 nm, 500 nm: a", "400 nm: b 1.5"]),
        (
            [(f"{nm} nm", [f"frames scatter {nm / 300:.1f} times"]) for nm in (400, 500, 600)],
            ["400 nm: frames scatter 1.3 times; the like, with numbers of its own, holds at 500 nm, 600 nm"],
        ),
        (
            [
                ("400 nm", ["at (theta_i, theta_r, dphi) = (15, 75, 0), (15, 67.5, 180), (1, 2, 3) deg and 2 more: u"]),
                ("410 nm", ["at (theta_i, theta_r, dphi) = (15, 75, 0) deg: u"]),
            ],
            [
                "400 nm: at (theta_i, theta_r, dphi) = (15, 75, 0), (15, 67.5, 180), (1, 2, 3) deg and 2 more: u; the "
                "like, with numbers of its own, holds at 410 nm"
            ],
        ),
    ],
)
def test_what_all_bands_say_is_said_once(notes: list[tuple[str, list[str]]], said: list[str]) -> None:
    assert said_once(notes) == said


def test_many_bands_are_counted() -> None:
    (note,) = said_once([(f"{nm} nm", ["a"]) for nm in range(400, 710, 10)])
    assert note == "400 nm, 410 nm, 420 nm, 430 nm, 440 nm, 450 nm, 460 nm, 470 nm, 480 nm, 490 nm and 21 more bands: a"


# ---- health: hours since the start, and what is lowest and highest however much is left out ----


def test_thinning_keeps_what_is_lowest_and_highest_anywhere() -> None:
    values = np.random.default_rng(5).normal(size=5000)
    values[1234], values[4321] = 9.0, -9.0
    hours = np.arange(5000.0) / 100.0
    order = np.random.default_rng(6).permutation(5000)  # steps may come in any order
    times = 1.9e9 + 3600.0 * hours[order]
    h = record._summary("a", "b", "", 1.9e9, times.tolist(), values[order].tolist())
    assert (h.steps, h.lowest, h.highest) == (5000, -9.0, 9.0)
    assert h.median == pytest.approx(np.median(values))
    # microseconds are left of times since 1970
    assert (h.lowest_h, h.highest_h) == pytest.approx((43.21, 12.34), abs=1e-9)
    assert {9.0, -9.0} <= set(h.value)
    assert h.time_h[-1] == pytest.approx(49.99)
    assert h.time_h == sorted(h.time_h)


# ---- the budget: shares that add up, curves in the plane, and no budget of another table ----


def write_budget(folder: Path, **more: object) -> pd.DataFrame:
    """Two incidences, three parts of 3, 4 and 12 thousandths of each value: 13 together."""
    rows = [(30.0, 0.0, r, p) for r, p in ((40.0, 0.0), (20.0, 180.0), (60.0, 180.0))]
    rows += [(60.0, 0.0, 10.0, 180.0), (60.0, 0.0, 50.0, 180.0), (60.0, 0.0, 30.0, 90.0)]
    table = pd.DataFrame(rows, columns=["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"])
    table = table.assign(wavelength_nm=500.0, brdf=0.5)
    table = table.assign(u_brdf=0.013 * table["brdf"])
    table = table.assign(noise=0.003 * 0.5, prnu=0.004 * 0.5, s_reference=-0.012 * 0.5)
    table = table.assign(nu_eff=np.inf, coarse=[True, *[False] * 5], cone_difference=1e-4, flag="")
    table.to_csv(folder / "budget.csv", index=False)
    table[["brdf", "u_brdf"]].to_csv(folder / "brdf.csv", index=False)
    provenance = {"not_in_budget": [{"cause": "stray_light", "why": "was not measured"}], **more}
    (folder / "brdf.meta.json").write_text(json.dumps({"provenance": provenance}))
    return table


def test_shares_add_up_and_the_certificate_is_stated_apart(tmp_path: Path) -> None:
    write_budget(tmp_path, monte_carlo={"verdict": "all is well"})
    [found] = run_budget(tmp_path)
    assert [p.cause for p in found.parts] == ["reference", "prnu", "noise"]
    assert [p.common for p in found.parts] == [True, False, False]
    # squares of 12, 4 and 3 over that of 13, to rounding
    assert [p.share for p in found.parts] == pytest.approx([144 / 169, 16 / 169, 9 / 169], rel=1e-12)
    assert found.median == pytest.approx(0.013, rel=1e-12)
    assert found.median_apart == pytest.approx(0.005, rel=1e-9)  # a difference of squares
    assert (found.coarse, found.nu_eff, found.monte_carlo) == (1, None, "all is well")
    assert found.left_out == {"stray_light": "was not measured"}


def test_curves_lie_in_the_plane_and_are_signed(tmp_path: Path) -> None:
    write_budget(tmp_path)
    [found] = run_budget(tmp_path)
    assert [c.theta_i_deg for c in found.curves] == [30.0, 60.0]
    assert [c.theta_r_deg for c in found.curves] == [[-40.0, 20.0, 60.0], [10.0, 50.0]]
    assert all(len(share) == len(c.theta_r_deg) for c in found.curves for share in c.shares)


def test_a_budget_of_another_table_is_not_shown(tmp_path: Path) -> None:
    write_budget(tmp_path).assign(u_brdf=0.02)[["brdf", "u_brdf"]].to_csv(tmp_path / "brdf.csv", index=False)
    assert (run_budget(tmp_path), run_budget(tmp_path / "absent")) == ([], [])


def test_the_section_says_every_part_and_what_is_missing(tmp_path: Path) -> None:
    write_budget(tmp_path)
    [found] = run_budget(tmp_path)
    [drawing] = budget.draw(found, "sample")
    figure: Figure = drawing.rendered()
    assert "<svg" in figure.svg
    words = repr(budget.section(found, [figure])).replace("\\xa0", " ")
    for part in (
        "certificate of the white reference",
        "1.3 %",
        "2.6 %",
        "Apart from the certificate",
        "was not measured",
        "1 values",
    ):
        assert part in words, part
    assert budget.of(None, 500.0) is None
    assert budget.draw(None, "sample") == []
