"""The sampler "parameters": against values drawn from models, and in whole runs that are stopped and gone on with."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_sweeps import expected
from gonio_sweeps.candidates import read
from gonio_sweeps.online import GrowingValues, Online
from gonio_sweeps.parameters import LARGEST, Parameters

from gonio import measurement, models
from gonio.errors import ConfigError, Interrupted
from gonio.geometry import Directions
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import Plan, Point, canonical, load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Choice, about, sampler_of
from gonio.lab.reduction.brdf import reduce
from gonio.lab.rig import Pose, inverse_kinematics, kinematics
from gonio.samples.description import SampleDescription
from tests.gonio.numpy_rig import StopAfter, plan_in
from tests.gonio_analysis.synthetic import known

PLAN = """
name = "adaptive"
wavelength_nm = [500]
[adaptive]
how = "parameters"
budget_h = 0.5
{keys}
theta_i_deg = [20, 45, 70]
theta_r_deg = {{ start = -80, stop = 80, step = 4 }}
"""
MATTE = 'model = "oren-nayar"\nu_rel = {{ albedo = {albedo} }}\nu = {{ sigma_deg = {sigma} }}'
SIM = find_rig("sim").description
NOISE = 0.005


def sampler(tmp_path: Path, keys: str) -> Parameters:
    made = sampler_of(plan_in(tmp_path, PLAN.format(keys=keys)), SIM)[1]
    assert isinstance(made, Parameters)
    return made


@dataclass
class ManualRig:
    """Draws values of a model as the rig would measure them: noise, landings, the reference's error, zeros."""

    model: Any
    seed: int
    poses: list[Pose] = field(default_factory=list)
    brdf: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.scale = 1.0 + SIM.reference.u_rel * self.rng.normal()
        zeros = {name: math.radians(axis.zero_u_deg) for name, axis in SIM.axes().items()}
        self.zero = {name: u * self.rng.normal() for name, u in zeros.items() if name in ("light", "camera")}

    def measure(self, points: tuple[Point, ...]) -> None:
        for point in points:
            read = inverse_kinematics.reach(SIM, point.directions)
            step = math.radians(SIM.arms.light.encoder_step_deg)
            off = {name: zero + step * (self.rng.random() - 0.5) for name, zero in self.zero.items()}
            true = kinematics.directions(SIM, Pose(**{n: getattr(read, n) + off.get(n, 0.0) for n in AXES}))
            cosine = math.cos(true.theta_i) / math.cos(point.directions.theta_i)
            value = float(self.model.brdf(*true.floats, wavelength_nm=500.0)) * cosine
            self.poses.append(read)
            self.brdf.append(value * self.scale * (1.0 + NOISE * self.rng.normal()))

    @property
    def values(self) -> GrowingValues:
        brdf = np.array(self.brdf)
        return GrowingValues(
            rows=np.arange(brdf.size),
            directions=Directions.stack([kinematics.directions(SIM, pose) for pose in self.poses]),
            poses=tuple(self.poses),
            brdf=brdf,
            u_noise=NOISE * np.abs(brdf),
            common={"s_reference": SIM.reference.u_rel * brdf},
            time_s=np.arange(brdf.size, dtype=float),
        )


AXES = ("light", "camera", "tilt", "spin", "azimuth")


def nobody() -> pd.DataFrame:
    raise AssertionError("nothing is reduced where no target is near")


def grow(made: Parameters, bench: ManualRig, batches: int) -> list[Choice]:
    """So many batches, each of them measured."""
    bench.measure(tuple(made.first([])))
    out: list[Choice] = []
    for look in range(batches):
        modes = [choice.why["mode"] for choice in out]
        out.append(made.choose(bench.values, spent_s=60.0 * look, modes=modes, reduced=nobody))
        bench.measure(out[-1].points)
    return out


def test_chosen_points_tell_more_than_a_grid_of_them(tmp_path: Path) -> None:
    truth = models.Phong(k_d=0.2, k_s=0.5, exponent=60.0)
    made = sampler(tmp_path, 'model = "phong"\nu_rel = { k_s = 1e-5, exponent = 1e-5 }')
    chosen, grid = ManualRig(truth, 1), ManualRig(truth, 2)
    choices = grow(made, chosen, 2)
    grid.measure(made.candidates.points)
    found, of_grid = made.fitted(chosen.values), made.fitted(grid.values)
    assert found is not None
    assert of_grid is not None
    assert len(chosen.brdf) < 0.5 * len(grid.brdf)
    for name, true in (("k_s", 0.5), ("exponent", 60.0)):
        one, all_of_them = found.result.parameters[name], of_grid.result.parameters[name]
        per_visit = (known(one.u) / known(all_of_them.u)) ** 2 * len(chosen.brdf) / len(grid.brdf)
        assert per_visit < 0.7, "a chosen visit tells more than one and a half of the grid's"
        assert abs(one.value - true) < 4.0 * known(one.u), "one in 16 000 fails"
    assert [choice.why["mode"] for choice in choices] == ["parameters"] * 2
    assert all(choice.why["cover"] >= 1 for choice in choices), "a part of every batch covers"


def test_a_wrong_model_is_noticed_and_then_points_cover(tmp_path: Path) -> None:
    made = sampler(tmp_path, MATTE.format(albedo=0.01, sigma=1.0))
    bench = ManualRig(models.Phong(k_d=0.4, k_s=0.1, exponent=20.0), 3)
    choices = grow(made, bench, 3)
    assert choices[0].why["p_value"] < 1e-6
    assert choices[0].message.startswith("oren-nayar does not describe the values (chi-square")
    assert [choice.why["mode"] for choice in choices] == ["covering", "nearest", "covering"], "they take turns"
    assert choices[1].message.startswith("oren-nayar comes nearest with albedo")
    assert 2 * LARGEST < len(choices[0].points) <= 3 * LARGEST
    seen = [(p.theta_i_deg, p.theta_r_deg, p.phi_r_deg) for choice in choices[::2] for p in choice.points]
    assert len(set(seen)) == len(seen), "covering does not repeat what was measured"
    again = [(p.theta_i_deg, p.theta_r_deg, p.phi_r_deg) for p in choices[1].points]
    assert len(set(again)) == len(again), "a misfit is the same at every visit"
    assert all(choice.why["batch_s"] < 360.0 for choice in choices), "levels are those of the values, not of the model"
    spent = made.choose(bench.values, spent_s=1799.0, modes=["covering"] * 3, reduced=nobody)
    assert not spent.points
    assert not spent.met
    assert spent.message.startswith("enough (oren-nayar does not describe the sample): the budget is spent")


def test_where_no_point_tells_more_of_the_parameters_the_rest_of_the_budget_covers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = sampler(tmp_path, 'model = "lambert"\nu_rel = { albedo = 1e-5 }')
    bench = ManualRig(models.Lambert(albedo=0.6), 6)
    monkeypatch.setattr("gonio_sweeps.parameters.LEAST_GAIN", 10.0)  # as after very many points
    choices = grow(made, bench, 2)
    assert [choice.why["mode"] for choice in choices] == ["filling"] * 2
    filling = choices[0]
    assert len(filling.points) > LARGEST
    assert "no point tells more of the parameters" in filling.message
    seen = [(p.theta_i_deg, p.theta_r_deg, p.phi_r_deg) for p in filling.points]
    assert len(set(seen)) == len(seen)


def test_half_of_the_points_cover_where_the_target_is_out_of_reach(tmp_path: Path) -> None:
    bench = ManualRig(models.OrenNayar(albedo=0.5, sigma_deg=25.0), 8)
    covers, sizes = {}, {}
    for sigma in (0.1, 1e-6):
        made = sampler(tmp_path, MATTE.format(albedo=0.05, sigma=sigma))
        bench.measure(() if bench.brdf else tuple(made.first([])))
        choice = made.choose(bench.values, spent_s=60.0, modes=[], reduced=nobody)
        covers[sigma], sizes[sigma] = choice.why["cover"], len(choice.points)
    # a quarter and a half of the points that were wanted; some points that would tell little more are left out then
    assert covers[0.1] <= 0.25 * sizes[0.1] + 1
    assert covers[1e-6] == pytest.approx(0.5 * sizes[1e-6], abs=1)


def test_points_in_few_places_do_not_mislead_the_search(tmp_path: Path) -> None:
    """A search from two starts ends at sigma0_um = 100 here, and the right model would be found wrong."""
    made = sampler(tmp_path, 'model = "he-torrance"\nior = "Al"\nu_rel = { tau_um = 0.001 }')
    bench = ManualRig(models.HeTorrance(sigma0_um=0.28, tau_um=1.77, ior="Al", diffuse_albedo=0.0), 7)
    bench.measure(tuple(canonical(75.0, 0.0, r, 180.0) for r in (80.0, 81.0, 82.0, 64.0, 72.0, 31.0) for _ in range(8)))
    bench.measure(tuple(canonical(60.0, 0.0, r, 180.0) for r in (65.0, 85.0, 51.0, 22.0)))
    bench.measure(
        tuple(canonical(i, 0.0, r, 180.0) for i, r in ((10.0, 10.0), (10.0, 60.0), (30.0, 36.0), (30.0, 83.0)))
    )
    found = known(made.fitted(bench.values))
    assert found.result.parameters["sigma0_um"].value == pytest.approx(0.28, rel=0.02)
    assert found.test.p_value > 1e-3


def test_the_same_values_give_the_same_choice(tmp_path: Path) -> None:
    keys = MATTE.format(albedo=1e-4, sigma=1e-2)
    bench = ManualRig(models.OrenNayar(albedo=0.5, sigma_deg=25.0), 4)
    first = sampler(tmp_path, keys)
    bench.measure(tuple(first.first([])))
    choices = [
        made.choose(bench.values, spent_s=50.0, modes=[], reduced=nobody)
        for made in (first, first, sampler(tmp_path, keys))
    ]
    assert choices[0] == choices[1] == choices[2]
    json.dumps(choices[0].why, allow_nan=False)


def test_a_batch_stays_within_the_budget(tmp_path: Path) -> None:
    made = sampler(tmp_path, MATTE.format(albedo=1e-4, sigma=1e-2))
    bench = ManualRig(models.OrenNayar(albedo=0.5, sigma_deg=25.0), 5)
    bench.measure(tuple(made.first([])))
    for left_s in (40.0, 25.0, 12.0, 5.0):
        choice = made.choose(bench.values, spent_s=1800.0 - left_s, modes=[], reduced=nobody)
        assert choice.why.get("batch_s", 0.0) <= left_s
    assert not choice.points
    assert "the budget is spent" in choice.message


def test_a_plan_with_points_of_its_own_needs_no_covering(tmp_path: Path) -> None:
    made = sampler(tmp_path, MATTE.format(albedo=0.01, sigma=1.0))
    assert not made.first(made.candidates.points)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('model = "he-torance"', r'plan\.toml: \[adaptive\] .*did you mean "he-torrance"'),
        ('model = "lambert"\nmodell = 1', 'unknown key modell; did you mean "model"'),
        ('model = "lambert"\nu_rel = { albdo = 0.1 }', "u_rel: albdo of lambert is not fitted; fitted are albedo"),
        ('model = "lambert"\nu_rel = { albedo = 1 }\nu = { albedo = 1 }', "albedo has a target in u and one in u_rel"),
        ('model = "lambert"\nu = { albedo = -1 }', "u.albedo = -1"),
        ('model = "lambert"\nfix = { albedo = 2 }', "fix albedo=2: albedo of lambert lies between"),
        ('model = "he-torrance"\nior = "Unobtainium"', 'there is no material named "Unobtainium"'),
        ('model = "lambert"\nwavelength_nm = 600', r"wavelength_nm = 600: the plan's bands lie at 500 nm"),
    ],
)  # fmt: skip
def test_a_wrong_key_is_named(tmp_path: Path, keys: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        sampler(tmp_path, keys)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (
            "budget_h = 0.5",
            "budget_h = 0.01",
            "budget_h = 0.01: dark frames, a measurement of the reference and the first",
        ),
        ("theta_i_deg = [20, 45, 70]", "theta_i_deg = [95]", "theta_i_deg: 95 deg is outside 0 to 90 deg"),
        ("step = 4", "stop = 9", "theta_r_deg"),
    ],
)
def test_wrong_candidates_are_named(tmp_path: Path, before: str, after: str, said: str) -> None:
    text = PLAN.format(keys='model = "lambert"').replace(before, after)
    if "stop = 9" in after:
        text = text.replace("stop = 80, ", "")
    (tmp_path / "plan.toml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        sampler_of(load_plan(tmp_path / "plan.toml"), SIM)


def test_it_says_what_it_will_do(tmp_path: Path) -> None:
    lines = "\n".join(about(sampler(tmp_path, MATTE.format(albedo=0.01, sigma=0.5))))
    assert "oren-nayar at 500 nm; fitted: albedo, sigma_deg" in lines
    assert "albedo to 1 %, sigma_deg to 0.5" in lines
    assert "budget: 0.5 h of rig time for the whole run\ncandidates: 1" in lines
    assert "block" in lines, "those near retro that the rig cannot reach"


SMALL = SIM.model_copy(
    update={
        "camera": SIM.camera.model_copy(update={"width": 64, "height": 48, "pixel_um": 50.0}),
        "reference": SIM.reference.model_copy(update={"frames": 3}),
        "acquisition": SIM.acquisition.model_copy(update={"dark_frames": 2}),
    }
)
"""The simulated rig with a small sensor and few frames."""


def measured(plan: Plan, out: Path, **options: Any) -> Run:
    rig = find_rig("sim")
    from dataclasses import replace

    sample = SampleDescription(name="matte", model="oren-nayar", parameters={"albedo": 0.5, "sigma_deg": 25.0})
    return carry_out(plan, replace(rig, description=SMALL), out, sample=sample, seed=2, **options)


@pytest.mark.slow
@pytest.mark.usefixtures("one_id")
def test_a_run_reaches_its_target_and_stopping_it_changes_nothing(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, PLAN.format(keys=MATTE.format(albedo=0.0045, sigma=0.2)))
    whole = measured(plan, tmp_path / "whole")
    assert whole.enough
    (end,) = [event for event in whole.events() if event["event"] == "enough"]
    assert end["met"]
    assert end["why"]["u_final"]["sigma_deg"] <= 0.2
    assert len(whole.batches) >= 1
    shown = Online(whole.bands[0]).values(whole).poses
    goals = [step.goal for step in whole.steps() if step.kind == "point"]
    for name in AXES:
        found, there = ([getattr(pose, name) for pose in poses] for poses in (shown, read(SMALL, goals)))
        assert found == pytest.approx(there, abs=1e-9), "what encoders will show is known before"
    zeros = reduce(whole).attrs["provenance"]["zeros_rad"]
    assert zeros == {name: pytest.approx(math.radians(0.02)) for name in ("theta_i_zero", "theta_r_zero")}
    assert_a_file_keeps_what_a_fit_needs(whole, tmp_path / "brdf.csv")
    for stopped_after in (whole.batches[0].first_step - 1, whole.batches[0].first_step + 3):
        out = tmp_path / f"stopped-{stopped_after}"
        with pytest.raises(Interrupted):
            measured(plan, out, progress=StopAfter(stopped_after))
        again = measured(plan, out, resume=True)
        assert [batch for batch in again.batches] == [batch for batch in whole.batches], "and for the same reasons"
        assert list(again.steps()) == list(whole.steps())


def assert_a_file_keeps_what_a_fit_needs(run: Run, path: Path) -> None:
    table = reduce(run)
    step = math.radians(SMALL.arms.light.encoder_step_deg) / math.sqrt(12.0)
    readings = table.attrs["provenance"]["readings_rad"]
    assert readings == {name: pytest.approx(step) for name in ("theta_i_zero", "theta_r_zero")}
    assert (table["u_angles"] <= table["u_random"]).all()
    measurement.write(table, path)
    again = measurement.read(path)
    assert again.attrs["provenance"]["zeros_rad"] == table.attrs["provenance"]["zeros_rad"]
    np.testing.assert_array_equal(again["u_angles"].to_numpy(), table["u_angles"].to_numpy())
    in_memory, of_file = fit(table, "oren-nayar"), fit(again, "oren-nayar")
    assert of_file.parameters == in_memory.parameters, "to the last bit"
    table.attrs["provenance"] = {}
    assert fit(table.drop(columns="u_angles"), "oren-nayar").covariance[0, 0] != in_memory.covariance[0, 0]


def test_spent_time_is_that_of_the_frames_that_were_taken(tmp_path: Path) -> None:
    from gonio.lab.acquisition.duration import Durations

    run = measured(plan_in(tmp_path, PLAN.format(keys=MATTE.format(albedo=0.5, sigma=60.0))), tmp_path / "run")
    exposures = sum(frame.exposure_s for step in run.steps() for frame in step.frames)
    spent = expected.spent_s(Durations(run.description, run.bands), run)
    assert spent > exposures
    # a matt sample takes what was planned for it, but for its albedo and metering
    planned = Durations(run.description, run.bands).parts([_step(record) for record in run.steps()]).total_s
    assert spent == pytest.approx(planned, rel=0.2)


def _step(record: Any) -> Any:
    from gonio.lab.rig import Step

    return Step(record.step, record.kind, record.point, record.goal)
