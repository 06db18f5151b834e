"""The budget of a run as the report has it: shares that add up, curves in the plane, and no budget of another table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.report import budget
from gonio_analysis.report.drawings import Figure
from gonio_analysis.selection.run_record import run_budget


def write(folder: Path, **more: object) -> pd.DataFrame:
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
    write(tmp_path, monte_carlo={"verdict": "all is well"})
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
    write(tmp_path)
    [found] = run_budget(tmp_path)
    assert [c.theta_i_deg for c in found.curves] == [30.0, 60.0]
    assert [c.theta_r_deg for c in found.curves] == [[-40.0, 20.0, 60.0], [10.0, 50.0]]
    assert all(len(share) == len(c.theta_r_deg) for c in found.curves for share in c.shares)


def test_a_budget_of_another_table_is_not_shown(tmp_path: Path) -> None:
    table = write(tmp_path)
    table.assign(u_brdf=0.02)[["brdf", "u_brdf"]].to_csv(tmp_path / "brdf.csv", index=False)
    assert run_budget(tmp_path) == []
    assert run_budget(tmp_path / "absent") == []


def test_the_section_says_every_part_and_what_is_missing(tmp_path: Path) -> None:
    write(tmp_path)
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
