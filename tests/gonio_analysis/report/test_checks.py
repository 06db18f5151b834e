"""The checks of a run in its table, on its page and in summary.json."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.report import checks, sample
from gonio_analysis.report.blocks import Group, Paragraph, Table, plain
from gonio_analysis.report.comparison import summarise
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.compare import examine

from gonio import measurement
from gonio.lab.acquisition.measure import RigChoice, carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.samples.files import load_sample
from tests.command_line import gonio, says, some
from tests.gonio_analysis.synthetic import facts_of

PLAN = """name = "p"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 60]
theta_r_deg = [20, 60, 80]
dphi_deg = [0, 45, 90, 135, 180, 225, 270, 315]
"""
NAMES = {
    "reciprocity", "left and right", "energy", "reference drift", "repeatability", "saturation", "lost points",
    "dark level",
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A matte sample on the simulated rig, with a small sensor."""
    folder = tmp_path_factory.mktemp("checked")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "sample.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbedo = 0.6\n')
    rig = find_rig("sim")
    camera = rig.description.camera.model_copy(update={"width": 96, "height": 72, "pixel_um": 33.0})
    description = rig.description.model_copy(update={"camera": camera})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
        sample = load_sample(folder / "sample.toml")
        carry_out(
            load_plan(folder / "plan.toml"), RigChoice(rig.plugin, description, "sim"), folder / "run", sample=sample
        )
    return folder / "run"


@pytest.fixture(scope="module")
def reduced(run: Path) -> tuple[pd.DataFrame, str]:
    """The table, and what the command printed."""
    done = gonio(run.parent, "reduce", run, expect=0)
    return measurement.read(run / "brdf.csv"), done.stdout


def shown(table: pd.DataFrame) -> DatasetSummary:
    return facts_of(examine(table, ["lambert"], name="x"))


def test_a_sound_run_is_told_so_in_two_lines(reduced: tuple[pd.DataFrame, str]) -> None:
    table, printed = reduced
    kept = {one["name"]: one for one in table.attrs["provenance"]["checks"]}
    assert set(kept) == NAMES
    assert {one["verdict"] for one in kept.values()} <= {"ok", "look"}
    assert kept["reciprocity"]["value"] < 2.0  # chi-square a pair: of 8 pairs 2 is rarer than 5 %
    says(printed, "checks: ", "repeatability")
    assert "check bad" not in printed


@pytest.mark.slow
def test_a_fault_stands_on_the_page_and_in_the_summary(reduced: tuple[pd.DataFrame, str]) -> None:
    """One side is brighter: the page and the summary say so, with the place of the difference."""
    table = reduced[0].copy()
    table.attrs = dict(reduced[0].attrs)
    table.loc[((table["phi_r_deg"] - table["phi_i_deg"]) % 360).between(5, 175), "brdf"] *= 1.1
    facts = shown(table)
    assert facts.checks is not None
    found = {one.name: one for one in facts.checks.checks}
    assert set(found) == NAMES  # those of the values anew, those of the run as they were kept
    assert found["left and right"].verdict == "bad"
    assert "Most of it lies" in found["left and right"].advice
    assert "bad: " in checks.in_words(facts.checks)
    kept = json.loads(json.dumps(as_json(facts)))["checks"]
    assert {one["name"]: one["verdict"] for one in kept["checks"]}["left and right"] == "bad"


def test_a_bad_check_of_the_measurement_stands_in_one_line_below_the_verdict(
    reduced: tuple[pd.DataFrame, str],
) -> None:
    facts = shown(reduced[0])
    assert facts.checks is not None
    assert checks.bad(facts.checks, "x") == []
    worse = [replace(one, verdict="bad") if one.name == "dark level" else one for one in facts.checks.checks]
    facts.__dict__["checks"] = replace(facts.checks, checks=worse)
    summary = summarise([facts], title="x", normalise="mirror", command="")
    first = sample.section(replace(summary, datasets=[facts]), facts, (), None).blocks[0]
    assert isinstance(first, Group)
    lead, line = first.blocks[:2]
    assert isinstance(lead, Paragraph)
    assert lead.look == "lead"
    assert isinstance(line, Paragraph)
    assert plain(line.text).startswith("Bad: dark level (")
    assert plain(line.text).endswith("; see Checks.")


def test_a_run_without_a_usable_value_ends_in_an_error_and_has_no_table(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "run", ignore=shutil.ignore_patterns("brdf*", "budget*"))
    for taken in Run.open(tmp_path / "run").steps():
        for frame in taken.frames if taken.kind == "point" else ():
            (tmp_path / "run" / "frames" / frame.file).unlink()
    before = sorted((tmp_path / "run").rglob("*"))
    done = gonio(tmp_path, "reduce", "run", expect=1)
    says(done.stderr, "run: none of its", "is usable", "damaged", "no table is written")
    assert sorted((tmp_path / "run").rglob("*")) == before


def test_the_page_has_both_uncertainties_of_a_reflectance_and_a_figure(reduced: tuple[pd.DataFrame, str]) -> None:
    facts = shown(reduced[0])
    (drawing,) = checks.draw(facts.checks, facts.rho_dh, "x")
    figure = drawing.rendered()
    tables = [block for block in checks.section(facts.checks, facts.rho_dh, [figure]) if isinstance(block, Table)]
    assert len(tables) == 2
    (first, second) = tables
    assert len(first.rows) == len(NAMES)
    header = [plain(cell) for cell in second.header]
    assert any("full covariance" in cell for cell in header)
    assert any("points independent" in cell for cell in header)
    (r, *_) = [one for one in facts.rho_dh if one.rho_dh is not None]
    assert r.u_values is not None
    assert r.u_values > some(r.u_independent)  # the certificate is common to all values
    assert r.u == pytest.approx(np.hypot(r.u_values, some(r.u_sampling)))
    assert len(figure.svg) < 60_000  # once on a page


def test_a_table_from_elsewhere_has_the_checks_of_its_values(reduced: tuple[pd.DataFrame, str]) -> None:
    table = reduced[0].copy()
    table.attrs = reduced[0].attrs | {"provenance": {"checks": [{"by": "another program"}], "reference": ["a tile"]}}
    assert {one.name for one in some(shown(table).checks).checks} == {"reciprocity", "left and right", "energy"}
