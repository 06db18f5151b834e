"""Runs on a rig whose file names calibrations: what they say of these, and what they need of them later."""

import datetime
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import pytest
from gonio_sim.rig import SIM

from gonio.disk import write_own
from gonio.lab.acquisition.journal import Journal
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig.calibration_files import Calibration, identity, write_calibration
from gonio.measurement import read
from gonio.samples.description import ParameterUncertainty
from tests.command_line import gonio, says
from tests.gonio.lab.calibration.test_camera import small
from tests.system.conftest import LAMBERT

PLAN = 'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [20]\ntheta_r_deg = [-50, 5, 45]\n'
MEASURE = ("measure", "p.toml", "--rig", "rig.toml", "--sample", "s.toml", "--out", "run")
DRIFT = "lamp.drift_per_hour"


def calibrate(folder: Path, name: str = "light.toml", **changed: Any) -> None:
    """Write a calibration file of the rig in a folder."""
    description = find_rig("sim").description
    given: dict[str, Any] = {
        "kind": "light", "rig": description.name, "rig_identity": identity_of(folder),
        "made": datetime.date(2026, 1, 2), "values": {"lamp": {"drift_per_hour": 0.004}},
        "uncertainty": ParameterUncertainty(parameters=[DRIFT], u=[0.001], correlation=[[1.0]]),
    }  # fmt: skip
    write_calibration(Calibration(**(given | changed)), folder / name)


def identity_of(folder: Path) -> str:
    (folder / "bare.toml").write_text(small(SIM.toml))
    return identity(find_rig(str(folder / "bare.toml")).description)


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with plan, sample, and a rig file that names `light.toml`, which is there."""
    (tmp_path / "p.toml").write_text(PLAN)
    (tmp_path / "s.toml").write_text(LAMBERT)
    (tmp_path / "rig.toml").write_text('calibration.files = ["light.toml"]\n' + small(SIM.toml))
    calibrate(tmp_path)
    return tmp_path


def test_a_run_tells_of_its_calibrations_and_is_reduced_without_their_files(bench: Path) -> None:
    assert "calibrations: light.toml (light, made on 2026-01-02)" in gonio(bench, *MEASURE, "--dry-run").stdout
    assert gonio(bench, *MEASURE, "--seed", "3").returncode == 0
    assert gonio(bench, "reduce", "run").returncode == 0
    first = (bench / "run" / "brdf.csv").read_bytes()
    (bench / "light.toml").unlink()
    gonio(bench, "reduce", "run", expect=0)
    assert (bench / "run" / "brdf.csv").read_bytes() == first
    (used,) = json.loads((bench / "run" / "brdf.meta.json").read_text())["provenance"]["calibrations"]
    assert (used["kind"], used["file"], used["made"]) == ("light", "light.toml", "2026-01-02")
    assert gonio(bench, "run", "check", "run").returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"valid_until": datetime.date(2026, 2, 1)}, "it was valid until 2026-02-01"),
        ({"rig_identity": "0" * 12}, "was made on another rig"),
    ],
)
def test_a_calibration_that_is_unfit_is_warned_of_from_plan_to_report(
    bench: Path, changed: dict[str, Any], why: str
) -> None:
    calibrate(bench, **changed)
    refused = gonio(bench, *MEASURE)
    assert (refused.returncode, (bench / "run").exists()) == (2, False)
    says(
        refused.stderr,
        f"light.toml: {'is out of date' if 'valid' in why else 'was made on another rig'}",
        'when_unfit = "warn"',
    )
    (bench / "rig.toml").write_text('calibration.when_unfit = "warn"\n' + (bench / "rig.toml").read_text())
    shown = gonio(bench, "plan", "show", "p.toml", "--rig", "rig.toml").stdout
    assert shown.count("warning: calibration light.toml") == 1
    assert why in gonio(bench, *MEASURE).stderr
    assert why in gonio(bench, "reduce", "run").stderr
    (note,) = (n for n in json.loads((bench / "run" / "brdf.meta.json").read_text())["notes"] if "light.toml" in n)
    assert why in note
    assert note.endswith("it was used all the same")
    assert gonio(bench, "report", "run", "--models", "lambert", "--out", "report").returncode == 0
    assert why in (bench / "report" / "index.html").read_text()


@pytest.mark.parametrize("to", ["another covariance", "another value", "none"])
def test_a_run_is_not_resumed_with_other_calibrations(bench: Path, to: str) -> None:
    assert gonio(bench, *MEASURE).returncode == 0
    kept = (bench / "run" / "journal.jsonl").read_bytes()
    if to == "none":
        (bench / "rig.toml").write_text(small(SIM.toml))
        said = "calibration light.toml: in the run, and not in the rig file now"
    elif to == "another value":
        calibrate(bench, values={"lamp": {"drift_per_hour": 0.006}}, made=datetime.date(2026, 3, 4))
        said = "rig.lamp.drift_per_hour: 0.004 in the run, 0.006 now"
    else:
        more = ParameterUncertainty(parameters=[DRIFT], u=[0.002], correlation=[[1.0]])
        calibrate(bench, uncertainty=more, made=datetime.date(2026, 3, 4))
        said = "calibration light.toml: made on 2026-01-02 in the run, and another one, made on 2026-03-04, now"
    done = gonio(bench, *MEASURE, "--resume", expect=2)
    assert said in done.stderr
    assert '"correlation"' not in done.stderr  # a matrix says nothing to a person
    assert (bench / "run" / "journal.jsonl").read_bytes() == kept


def test_a_run_is_resumed_where_its_calibration_has_run_out_and_that_is_only_warned_of(bench: Path) -> None:
    (bench / "rig.toml").write_text('calibration.when_unfit = "warn"\n' + (bench / "rig.toml").read_text())
    assert gonio(bench, *MEASURE).returncode == 0
    text = (bench / "run" / "run.toml").read_text()
    assert text.count("\nremarks = []\n") == 1
    before = text.replace("\nremarks = []\n", '\nremarks = ["x"]\n').encode()
    with Journal(bench / "run" / "journal.jsonl") as journal:  # as if it had been begun so
        journal.append({"event": "remark", "message": "", "files": {"run.toml": hashlib.sha256(before).hexdigest()}})
    write_own(bench / "run", {"run.toml": before})
    gonio(bench, *MEASURE, "--resume", expect=0)


def test_a_run_whose_charge_clips_below_the_converter_is_not_reduced_to_wrong_numbers(tmp_path: Path) -> None:
    """The rig file says 2.7 e-/DN, and 3.5 is true: the well is full at 3207 DN, where the file expects 4095.

    Exposures for 85 % of full scale lie beyond that. Sample and white clip alike, so that their ratio would look good.
    """
    (tmp_path / "truth.toml").write_text("[camera]\nelectrons_per_dn = 3.5\n")
    rig = 'truth = "truth.toml"\n' + small(SIM.toml)
    (tmp_path / "p.toml").write_text(PLAN)
    (tmp_path / "s.toml").write_text(LAMBERT)
    for target, code in ((0.85, 1), (0.6, 0)):
        (tmp_path / "rig.toml").write_text(rig.replace("exposure_target = 0.6", f"exposure_target = {target}"))
        out = f"run-{code}"
        assert gonio(tmp_path, *MEASURE[:-1], out, "--seed", "3", "--yes").returncode == 0
        done = gonio(tmp_path, "reduce", out, expect=code)
        assert ("lower acquisition.exposure_target" in " ".join(done.stderr.split())) == bool(code)
    table = read(tmp_path / "run-0" / "brdf.csv")
    used = table[table["flag"] == ""]
    assert len(used) >= 2
    assert (abs(used["brdf"] - 0.5 / math.pi) < 4 * used["u_brdf"]).all()
