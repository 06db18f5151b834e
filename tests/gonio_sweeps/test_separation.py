"""What a plan is said to tell of two samples, against runs of it; and the sampler "models" against whole grids."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from gonio_analysis.fitting.observations import observations
from gonio_sweeps import expected, rivals, sampler
from gonio_sweeps.candidates import read
from gonio_sweeps.online import GrowingValues
from gonio_sweeps.rivals import Rivals
from gonio_sweeps.separation import Gathered, separation
from scipy.stats import multivariate_normal

from gonio import models
from gonio.errors import ConfigError, Interrupted
from gonio.geometry import Directions
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.measure import assessed, carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import about, sampler_of
from gonio.lab.reduction.brdf import reduce
from gonio.samples.description import SampleDescription
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


def matt(sigma_deg: float) -> SampleDescription:
    return SampleDescription(
        name=f"rough {sigma_deg:g}", model="oren-nayar", parameters={"albedo": 0.5, "sigma_deg": sigma_deg}
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
    assert whole.apart == pytest.approx(float(d @ np.linalg.solve(np.diag(u**2) + columns @ columns.T, d)), rel=1e-9)
    wanted = 1.5 * whole.apart
    times = whole.times_to(wanted)
    if math.isfinite(times):
        assert whole.repeated(times).apart == pytest.approx(wanted, rel=1e-6)  # brentq's tolerance
    assert whole.times_to(1e12) == math.inf, "what is common stays"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("a", "b"),
    [(matt(20.0), matt(20.6)), (metal(1.77), metal(1.79))],
    ids=["roughness", "correlation length"],
)
def test_the_expected_chi_square_is_that_of_runs(tmp_path: Path, a: SampleDescription, b: SampleDescription) -> None:
    """The mean over runs of what B's chi-square exceeds A's by; each run scatters by 2 sqrt(chi-square)."""
    plan = load_plan(plan_file(tmp_path))
    known = separation(assessed(plan, RIG), a, b)
    excess = []
    for seed in range(8):
        run = carry_out(plan, RIG, tmp_path / f"run-{seed}", sample=a, seed=seed)
        excess.append(chi_square(run, b) - chi_square(run, a))
    assert known.apart > 15.0, "a difference that a run can show"
    # 20 to 25 % is what users plan with; the mean of 8 runs scatters by 2 sqrt(15 / 8) = 2.7 of at least 15
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
    ("truth", "named"),
    [
        (metal(1.77), ("he-torrance", "cook-torrance")),
        (matt(26.0), ("a.toml", "b.toml")),
    ],
    ids=["two models", "two samples"],
)
def test_half_of_a_grid_s_time_decides(tmp_path: Path, truth: SampleDescription, named: tuple[str, str]) -> None:
    samples = {"a": MATT.format(name="rough 20", sigma=20.0), "b": MATT.format(name="rough 26", sigma=26.0)}
    names = ", ".join(f'"{name}"' for name in named)
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


@pytest.mark.usefixtures("one_id")
def test_a_run_goes_on_as_it_would_have_gone(tmp_path: Path) -> None:
    plan = load_plan(plan_file(tmp_path, CHOSEN.replace("MODELS", '"oren-nayar", "blinn"')))

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


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Rivals:
    samples = {"a": MATT.format(name="rough 20", sigma=20.0), "b": MATT.format(name="rough 26", sigma=26.0)}
    text = CHOSEN.replace("MODELS", '"a.toml", "b.toml"')
    return Rivals(load_plan(plan_file(tmp_path_factory.mktemp("rivals"), text, **samples)), SMALL)


def test_a_batch_is_what_raises_chi_square_most_for_its_time(made: Rivals) -> None:
    stands = [made._stand(one, None, None) for one in made._rivals]
    rows, theirs = (stand.rows(made._ahead) for stand in stands)
    seen, d = made._expected.visits(rows.brdf), theirs.brdf - rows.brdf
    u = np.hypot(seen.u_rel * rows.brdf, rows.u_landing)
    columns = np.stack([SMALL.reference.u_rel * theirs.brdf, *theirs.of_angles.values()], axis=1)

    def apart(some: list[int]) -> float:
        return float(d[some] @ np.linalg.solve(np.diag(u[some] ** 2) + columns[some] @ columns[some].T, d[some]))

    picked, gain = made._pick(stands, None, math.inf)
    assert len(picked) == rivals.BATCH
    assert gain == pytest.approx(apart(picked), rel=1e-9)
    for n, chosen in enumerate(picked):
        rate = np.array([apart([*picked[:n], k]) for k in range(d.size)]) - (apart(picked[:n]) if n else 0.0)
        rate /= seen.seconds + sampler.EVERY_S + made._ways_s
        rate[[k for k in range(d.size) if picked[:n].count(k) == sampler.REPEATS]] = 0.0
        assert rate[chosen] == pytest.approx(rate.max(), rel=1e-7)  # differences of numbers that are 1e3 times larger


@pytest.mark.parametrize(("u", "enough"), [(0.003, True), (0.02, False)])
def test_the_winner_is_ahead_by_the_ratio_of_likelihoods(made: Rivals, u: float, enough: bool) -> None:
    """Values of the first sample, as they would be read: those of two normal distributions, written out."""
    picked, (a, b) = made.first_rows, [made._stand(one, None, None) for one in made._rivals]
    poses, read_at = [made.candidates.poses[k] for k in picked], [made._ahead.at.directions[k] for k in picked]
    at = expected.sights_at(SMALL, poses, Directions.stack(read_at), 550.0)
    rows, theirs = a.rows(at), b.rows(at)
    values = GrowingValues(
        np.arange(8), at.at.directions, tuple(poses), rows.brdf, np.full(8, u), {"s": 0.01 * rows.brdf}, np.zeros(8)
    )
    logs = []
    for one in (rows, theirs):
        columns = np.stack([0.01 * one.brdf, *one.of_angles.values()], axis=1)
        covariance = np.diag(u**2 + one.u_landing**2) + columns @ columns.T
        logs.append(multivariate_normal(one.brdf, covariance).logpdf(rows.brdf))
    choice = made.choose(values, 600.0)
    assert choice.why["score"] == {"rough 20": 0.0, "rough 26": pytest.approx(2.0 * (logs[0] - logs[1]), abs=6e-4)}
    assert choice.met == enough
    assert enough or choice.message.endswith("sigma; 10 of 60 min")
    assert enough or not made.choose(values, 3590.0).points  # ten seconds are left


def test_it_says_what_it_will_do_and_refuses_what_it_cannot(tmp_path: Path) -> None:
    text = CHOSEN.replace("MODELS", '"a.toml", "blinn"')
    made = sampler_of(load_plan(plan_file(tmp_path, text, a=MATT.format(name="rough 20", sigma=20.0))), SMALL)[1]
    assert isinstance(made, Rivals)
    assert about(made)[:3] == [
        "rivals: rough 20, blinn (fitted), at 550 nm",
        "target: the best one ahead of every other by 5 sigma (chi-square 25)",
        "budget: 1 h of rig time for the whole run",
    ]
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
