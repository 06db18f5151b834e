"""What a plan is said to tell of two samples, against runs of it; and the sampler "models" against whole grids."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from gonio_analysis.fitting.observations import observations
from gonio_sweeps import expected
from gonio_sweeps.candidates import read
from gonio_sweeps.rivals import Rivals
from gonio_sweeps.separation import Gathered, separation

from gonio import models
from gonio.acquisition.duration import Durations
from gonio.acquisition.measure import assessed, carry_out, find_rig
from gonio.acquisition.plan import load_plan
from gonio.acquisition.run import Run
from gonio.acquisition.sampling import about, sampler_of
from gonio.errors import ConfigError, Interrupted
from gonio.reduction.brdf import reduce
from gonio.rig.description import SampleDescription
from tests.command_line import gonio
from tests.gonio.numpy_rig import StopAfter
from tests.gonio_sweeps.test_parameters import SMALL

GRID = """
name = "grid"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [0, 30, 60]
theta_r_deg = { start = -80, stop = 80, step = 10 }
"""
CHOSEN = """
name = "told apart"
wavelength_nm = [550]
[adaptive]
how = "models"
budget_h = 1.0
models = [MODELS]
theta_i_deg = [0, 30, 60]
theta_r_deg = { start = -80, stop = 80, step = 10 }
"""
MATT = 'name = "{name}"\nmodel = "oren-nayar"\n[parameters]\nalbedo = 0.5\nsigma_deg = {sigma}\n'
RIG = replace(find_rig("sim"), description=SMALL)


def matt(sigma_deg: float, albedo: float = 0.5) -> SampleDescription:
    return SampleDescription(
        name=f"rough {sigma_deg:g}", model="oren-nayar", parameters={"albedo": albedo, "sigma_deg": sigma_deg}
    )


def metal(tau_um: float) -> SampleDescription:
    parameters = {"ior": "Al", "sigma0_um": 0.28, "tau_um": tau_um, "diffuse_albedo": 0.0}
    return SampleDescription(name=f"tau {tau_um:g}", model="he-torrance", parameters=parameters)


def plan_file(folder: Path, text: str = GRID, **models: str) -> Path:
    for name, sample in models.items():
        (folder / f"{name}.toml").write_text(sample)
    (folder / "plan.toml").write_text(text)
    return folder / "plan.toml"


def test_what_is_gathered_is_the_chi_square_with_all_causes() -> None:
    rng = np.random.default_rng(4)
    d, u, columns = rng.normal(size=9), rng.uniform(0.5, 2.0, 9), rng.normal(size=(9, 3))
    known = Gathered.nothing(3).with_values(d[:5], u[:5], columns[:5])
    gain = known.gains(d[5:6], u[5:6], columns[5:6])
    after = known.with_values(d[5:6], u[5:6], columns[5:6])
    assert after.apart - known.apart == pytest.approx(float(gain[0]), rel=1e-9)  # one inverse against another
    whole = after.with_values(d[6:], u[6:], columns[6:])
    covariance = np.diag(u**2) + columns @ columns.T
    assert whole.apart == pytest.approx(float(d @ np.linalg.solve(covariance, d)), rel=1e-9)
    wanted = 1.5 * whole.apart
    times = whole.times_to(wanted)
    if math.isfinite(times):
        assert whole.repeated(times).apart == pytest.approx(wanted, rel=1e-6)  # brentq's tolerance
    assert whole.times_to(1e12) == math.inf, "what is common stays"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("a", "b"),
    [(matt(20.0), matt(20.6)), (matt(20.0), matt(20.0, 0.51)), (metal(1.77), metal(1.79))],
    ids=["roughness", "albedo", "correlation length"],
)
def test_the_expected_chi_square_is_that_of_runs(tmp_path: Path, a: SampleDescription, b: SampleDescription) -> None:
    """The mean over runs of what B's chi-square exceeds A's by; each run scatters by 2 sqrt(chi-square)."""
    plan = load_plan(plan_file(tmp_path))
    known = separation(assessed(plan, RIG), a, b)
    excess = []
    for seed in range(12):
        run = carry_out(plan, RIG, tmp_path / f"run-{seed}", sample=a, seed=seed)
        excess.append(chi_square(run, b) - chi_square(run, a))
    assert known.apart > 15.0, "a difference that a run can show"
    # 20 to 25 % is what users plan with; the mean of 12 runs scatters by 2 sqrt(15 / 12) = 2.2 of at least 15
    assert 0.8 <= known.apart / np.mean(excess) <= 1.25


def chi_square(run: Run, sample: SampleDescription) -> float:
    """Of what the run's table states, where a sample is predicted through the instrument."""
    values = observations(reduce(run))
    poses = read(run.description, [step.goal for step in run.steps() if step.kind == "point"])
    rows = expected.sights_at(run.description, poses, values.directions, 550.0).of_model(
        models.build(sample.model, sample.parameters)
    )
    assert values.covariance is not None
    return values.covariance.chi_square(values.brdf - rows.brdf)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "rivals"),
    [
        (metal(1.77), ("he-torrance", "cook-torrance")),
        (matt(20.0), ("a.toml", "b.toml")),
        (matt(26.0), ("a.toml", "b.toml")),
    ],
    ids=["two models", "the smoother", "the rougher"],
)
def test_half_of_a_grid_s_time_decides(tmp_path: Path, truth: SampleDescription, rivals: tuple[str, str]) -> None:
    samples = {"a": MATT.format(name="rough 20", sigma=20.0), "b": MATT.format(name="rough 26", sigma=26.0)}
    names = ", ".join(f'"{name}"' for name in rivals)
    text = CHOSEN.replace("MODELS", names) + ('ior = "Al"\n' if truth.model == "he-torrance" else "")
    (tmp_path / "grid").mkdir()
    grid = load_plan(plan_file(tmp_path / "grid"))
    everywhere = carry_out(grid, RIG, tmp_path / "everywhere", sample=truth, seed=5)
    whole_s = expected.spent_s(Durations(everywhere.description, everywhere.bands), everywhere)
    plan = load_plan(plan_file(tmp_path, text, **samples))
    run = carry_out(plan, RIG, tmp_path / "run", sample=truth, seed=5)
    (end,) = [event for event in run.events() if event["event"] == "enough"]
    assert end["met"]
    best = min(end["why"]["score"], key=end["why"]["score"].get)
    assert best == (truth.name if truth.model == "oren-nayar" else truth.model)
    assert expected.spent_s(Durations(run.description, run.bands), run) <= 0.5 * whole_s


def test_a_run_goes_on_as_it_would_have_gone(tmp_path: Path) -> None:
    text = CHOSEN.replace("MODELS", '"oren-nayar", "blinn"')
    plan = load_plan(plan_file(tmp_path, text))

    def measured(out: str, **options: object) -> Run:
        return carry_out(plan, RIG, tmp_path / out, sample=matt(25.0), seed=2, **options)  # type: ignore[arg-type]

    whole = measured("whole")
    assert whole.enough
    stopped = whole.batches[0].first_step + 2 if whole.batches else 5
    with pytest.raises(Interrupted):
        measured("stopped", progress=StopAfter(stopped))
    again = measured("stopped", resume=True)
    assert list(again.batches) == list(whole.batches)
    assert list(again.steps()) == list(whole.steps())


def test_it_says_what_it_will_do_and_refuses_what_it_cannot(tmp_path: Path) -> None:
    text = CHOSEN.replace("MODELS", '"a.toml", "blinn"')
    plan = load_plan(plan_file(tmp_path, text, a=MATT.format(name="rough 20", sigma=20.0)))
    made = sampler_of(plan, SMALL)[1]
    assert isinstance(made, Rivals)
    assert about(made)[0] == "rivals: rough 20, blinn (fitted), at 550 nm"
    for named, said in (
        ('"blinn"', "models"),
        ('"blinn", "blinn"', "named twice"),
        ('"blinn", "blin"', "blin"),
        ('"blinn", "none.toml"', "none.toml"),
    ):
        with pytest.raises(ConfigError, match=said):
            sampler_of(load_plan(plan_file(tmp_path, CHOSEN.replace("MODELS", named))), SMALL)


def test_the_command_names_the_best_points_and_draws_the_map(tmp_path: Path) -> None:
    plan_file(tmp_path, a=MATT.format(name="rough 20", sigma=20.0), b=MATT.format(name="rough 26", sigma=26.0))
    asked = ("plan", "show", "plan.toml", "--separate", "a.toml", "b.toml")
    shown = gonio(tmp_path, *asked, "--rig", "sim", "--picture", "map.png")
    assert shown.returncode == 0, shown.stderr
    said = " ".join(shown.stdout.split())
    assert "expected chi-square between rough 20 and rough 26" in said
    assert "where the model of rough 26 is fitted" in said
    assert matplotlib.image.imread(tmp_path / "map.png").std() > 0.05, "dots on paper"
    refused = gonio(tmp_path, *asked)
    assert refused.returncode == 2
    assert "--separate: what a plan tells depends on the rig" in refused.stderr
