"""A white diffuser on the simulated rig, before and behind: plan, measure, reduce, fit, report."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis import change, fit
from gonio_analysis.report import make

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.acquisition.plan import assess, load_plan
from tests.command_line import gonio, some

PLAN = """name = "diffuser"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [0, 30]
theta_r_deg = [-60, -45, -20, 0, 20, 45, 60]
[[sweep]]
theta_i_deg = [0, 30]
theta_r_deg = [120, 150, 165, -135]
side = "transmission"
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [110, 180]
dphi_deg = [60]
side = "transmission"
"""
SAMPLE = """name = "opal glass"
model = "diffuse-transmitter"
[parameters]
reflectance = 0.45
transmittance = 0.35
"""


def far_reaching(name: str) -> str:
    """The file of a shipped rig, with a camera arm that reaches behind the sample."""
    from gonio_sim.rig import SIM, SIM_IDEAL

    toml = {"sim": SIM, "sim-ideal": SIM_IDEAL}[name].toml
    before, arm, after = toml.partition("[arms.camera]")
    return before + arm + after.replace("[-89.0, 89.0]", "[-175.0, 180.0]", 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plan, sample, rig, and a reduced run on the rig that is true to life."""
    folder = tmp_path_factory.mktemp("transmission")
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    (folder / "sample.toml").write_text(SAMPLE, encoding="utf-8")
    (folder / "rig.toml").write_text(far_reaching("sim"), encoding="utf-8")
    run = ("measure", "plan.toml", "--rig", "rig.toml", "--sample", "sample.toml", "--out", "run", "--seed", "5")
    for words in (run, ("reduce", "run")):
        gonio(folder, *words, expect=0)
    return folder


def test_both_sides_are_measured_within_their_uncertainty(folder: Path) -> None:
    frame = measurement.read(folder / "run")
    good = frame[frame["flag"] == ""]
    assert good.groupby("side").size().to_dict() == {"reflection": 13, "transmission": 10}  # one is blocked, at retro
    truth = np.where(good["side"] == "transmission", 0.35, 0.45) / np.pi
    pulls = (good["brdf"] - truth) / good["u_brdf"]
    assert np.abs(pulls).max() < 4.5  # of 23 values, beyond it by chance once in 6000 seeds
    assert good["u_brdf"].div(good["brdf"]).max() < 0.02
    assert good.loc[good["side"] == "transmission", "theta_r_deg"].min() > 100
    assert frame.attrs["quantity"] == "bsdf"


def test_a_fit_sees_reflection_alone_and_says_so(folder: Path) -> None:
    result = fit(str(folder / "run"), "lambert")
    albedo = result.parameters["albedo"]
    assert abs(albedo.value - 0.45) < 4.5 * some(albedo.u)
    assert len(result.data) == 13
    assert result.data.left_out["of transmission"] == 10
    assert any("10 rows are transmission" in note for note in result.data.notes)


@pytest.mark.slow
def test_the_report_has_a_section_of_its_own(folder: Path) -> None:
    make([str(folder / "run")], folder / "report", models=["lambert"])
    summary = json.loads((folder / "report" / "summary.json").read_text(encoding="utf-8"))
    (one,) = summary["datasets"]
    assert one["used"] == 13
    assert one["transmission"]["used"] == 10
    assert np.pi * one["transmission"]["btdf_max"] == pytest.approx(0.35, rel=0.03)
    page = (folder / "report" / "index.html").read_text(encoding="utf-8")
    assert re.search(r"<h3[^>]*>Transmission</h3>", page)
    assert {"both-sides", "transmission"} <= {f["name"].removeprefix("opal-glass-") for f in summary["figures"]}
    assert all("simulated" in f["caption"] for f in summary["figures"] if f["name"].endswith(("sides", "transmission")))


def test_transmission_alone_has_a_report_and_no_fit(folder: Path) -> None:
    through = some(measurement.transmission(measurement.read(folder / "run")))
    measurement.write(through, folder / "through.csv")
    with pytest.raises(DataError, match=r"10 of transmission; models .* reflection"):
        fit(str(folder / "through.csv"), "lambert")
    make([str(folder / "through.csv")], folder / "apart", models=["lambert"])
    summary = json.loads((folder / "apart" / "summary.json").read_text(encoding="utf-8"))
    assert summary["datasets"] == []
    assert summary["transmission_only"][0]["used"] == 10


def test_like_is_compared_with_like(folder: Path) -> None:
    same = change(str(folder / "run"), str(folder / "run"))
    assert len(same.at) == 13
    assert any(note.startswith("Transmission is compared apart, in 10 directions") for note in same.notes)
    through = some(measurement.transmission(measurement.read(folder / "run")))
    assert len(change(through, through).at) == 10
    with pytest.raises(DataError, match="not the same quantity"):
        change(through, str(folder / "run"))


@pytest.mark.parametrize(
    ("sweep", "told"),
    [
        ("theta_r_deg = [95]", 'theta_r_deg: 95 deg is outside -90 to 90 deg.*side = "transmission"'),
        ('theta_r_deg = [59]\nside = "transmission"', "59 deg is not behind the sample"),
        ('theta_r_deg = [190]\nside = "transmission"', "190 deg is not behind the sample"),
        ('theta_r_deg = [30]\nside = "both"', "side"),
    ],
)
def test_a_plan_has_to_say_transmission(tmp_path: Path, sweep: str, told: str) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(f'name = "a"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [30]\n{sweep}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=told):
        load_plan(path)


def test_a_list_of_points_says_it_in_a_column(tmp_path: Path) -> None:
    path, points = tmp_path / "plan.toml", tmp_path / "points.csv"
    path.write_text('name = "a"\nwavelength_nm = [550]\n[[points]]\nfile = "points.csv"\n', encoding="utf-8")
    head = "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg"
    points.write_text(f"{head},side\n30,0,150,180,transmission\n30,0,-20,180,\n", encoding="utf-8")
    assert [p.theta_r_deg for p in load_plan(path).points] == [150.0, 20.0]
    points.write_text(f"{head}\n30,0,150,180\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r'theta_r_deg = .150.; .*column "side"'):
        load_plan(path)
    points.write_text(f"{head},side\n30,0,50,180,transmission\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="is not behind the sample"):
        load_plan(path)


def test_a_rig_whose_arm_stops_at_the_horizon_reaches_none_of_it(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN, encoding="utf-8")
    seen = assess(load_plan(path), find_rig("sim").description)
    behind = [a for a in seen if a.point.theta_r_deg > 90]
    assert len(behind) == 10
    assert {a.flag for a in behind} == {"unreachable"}
