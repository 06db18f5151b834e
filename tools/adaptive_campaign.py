"""Adaptive sweeps towards parameters, as whole runs with frames: rig time against a grid's, and errors over stated
uncertainties.

    python tools/adaptive_campaign.py --sample aluminium --count 11 --seed 1

First a uniform grid is measured and fitted: five incidences by 2.5 degrees. The uncertainties that `gonio fit` states
of it are the targets of the adaptive runs, which have other seeds. Printed are, of each run, points, steps, shares of
the grid's rig time, and the pulls of what `gonio fit` finds: errors over stated uncertainties; then the root mean
square of these.

Rig time is counted in three ways: steps; exposures that were taken, with ways, metering and darks; and the same as if
every point were a matt white of albedo 0.5. The sensor is the rig's, but with larger pixels (`--pixels-across`), which
makes the runs faster.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_sweeps import expected

from gonio.acquisition.duration import Durations
from gonio.acquisition.measure import RigChoice, carry_out, find_rig
from gonio.acquisition.plan import load_plan
from gonio.acquisition.run import Run
from gonio.reduction import brdf
from gonio.rig import Pose, Step
from gonio.rig.description import SampleDescription

UNIFORM = """name = "uniform"
wavelength_nm = [500]
[[sweep]]
theta_i_deg = [10, 30, 45, 60, 75]
theta_r_deg = { start = -85, stop = 85, step = 2.5 }
"""
ADAPTIVE = """name = "adaptive"
wavelength_nm = [500]
[adaptive]
how = "parameters"
budget_h = 1.0
model = "%s"
ior = %s
u_rel = { %s }
theta_i_deg = [10, 30, 60, 75]
theta_r_deg = { start = -85, stop = 85, step = 1 }
"""


@dataclass(frozen=True)
class Case:
    """A sample, and what of it is wanted."""

    sample: SampleDescription
    ior: str | float
    wanted: tuple[str, ...]

    @property
    def truth(self) -> dict[str, float]:
        """The true values of what is wanted."""
        given = self.sample.parameters
        flat = {**given, "m": given["slopes"][0][0]} if "slopes" in given else given
        return {name: float(flat[name]) for name in self.wanted}


def metal(sigma0_um: float, tau_um: float, ior: str = "Al") -> Case:
    """A rough metal."""
    parameters = {"sigma0_um": sigma0_um, "tau_um": tau_um, "ior": ior, "diffuse_albedo": 0.0}
    sample = SampleDescription(name="metal", model="he-torrance", parameters=parameters)
    return Case(sample, ior, ("sigma0_um", "tau_um"))


GLOSSY = {"s": 0.6, "d": 0.4, "slopes": [[0.25, 1.0]], "ior": [1.5, 0.0], "diffuse_albedo": 0.4}
CASES = {
    "aluminium": metal(0.28, 1.77),
    "smoother": metal(0.15, 1.5),
    "gold": metal(0.22, 2.4, "Au"),
    "glossy": Case(SampleDescription(name="glossy", model="cook-torrance", parameters=GLOSSY), 1.5, ("s", "m")),
    "matte": Case(
        SampleDescription(name="matte", model="oren-nayar", parameters={"albedo": 0.5, "sigma_deg": 25.0}),
        1.5,
        ("albedo", "sigma_deg"),
    ),
}


def rig_with(pixels_across: int) -> RigChoice:
    """The simulated rig, its pixels so large that so many lie across the sensor."""
    rig = find_rig("sim")
    camera = rig.description.camera
    by = camera.width / pixels_across
    update = {"width": pixels_across, "height": round(camera.height / by), "pixel_um": camera.pixel_um * by}
    return replace(rig, description=rig.description.model_copy(update={"camera": camera.model_copy(update=update)}))


@dataclass(frozen=True)
class Measured:
    """One run, from frames to fit."""

    table: pd.DataFrame
    result: FitResult
    times: dict[str, float]
    ends: dict[str, Any]
    """Why it ended, where it chose its points."""
    looks: list[float]
    """Probabilities of the tests of the model, in turn."""


def measure(rig: RigChoice, case: Case, plan: str, seed: int) -> Measured:
    """Carry it out in a folder that is left behind by nobody."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "plan.toml").write_text(plan)
        out = Path(folder) / "run"
        run = carry_out(load_plan(Path(folder) / "plan.toml"), rig, out, sample=case.sample, seed=seed, yes=True)
        table = brdf.reduce(run)
        ends = [event for event in run.events() if event["event"] == "enough"]
        taken = times(run)
        looks = [batch.why["p_value"] for batch in run.batches if "p_value" in batch.why]
    ior = {} if case.sample.model == "oren-nayar" else {"ior": case.ior if isinstance(case.ior, str) else case.ior + 0j}
    return Measured(table, fit(table, case.sample.model, **ior), taken, ends[-1] if ends else {}, looks)


def times(run: Run) -> dict[str, float]:
    """The rig time, in three ways."""
    durations = Durations(run.description, run.bands)
    matt, here = 0.0, Pose()
    for record in run.steps():
        matt += durations.frames_s(Step(record.step, record.kind, record.point, record.goal))
        if record.kind != "dark":
            matt += durations.move_s(here, record.goal)
            here = record.goal
    return {"steps": float(len(run.steps())), "exposures_s": expected.spent_s(durations, run), "matt_s": matt}


def line(one: Measured, case: Case, uniform: Mapping[str, float]) -> dict[str, Any]:
    """What is printed of a run."""
    out: dict[str, Any] = {"points": len(one.table)}
    out |= {f"{name} %": round(100.0 * t / uniform[name], 1) for name, t in one.times.items()}
    for name, true in case.truth.items():
        found = one.result.parameters[name]
        u = found.u or math.nan
        out |= {f"u {name} %": round(100 * u / true, 4), f"pull {name}": round((found.value - true) / u, 2)}
    return out | {"met": one.ends["met"], "mode": one.ends["why"]["mode"], "p": one.looks}


def main() -> None:
    """As a program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", choices=CASES, default="aluminium")
    parser.add_argument("--count", type=int, default=11)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pixels-across", type=int, default=160)
    parser.add_argument("--tables", type=Path, help="keep the measurement tables in this folder")
    given = parser.parse_args()
    case, rig = CASES[given.sample], rig_with(given.pixels_across)
    grid = measure(rig, case, UNIFORM, 0)
    u_rel = {name: (grid.result.parameters[name].u or math.nan) / abs(true) for name, true in case.truth.items()}
    stated = {f"u {name} %": round(100 * u, 4) for name, u in u_rel.items()}
    print("uniform", {"points": len(grid.table)} | grid.times | stated, flush=True)
    wanted = ", ".join(f"{name} = {u:.6f}" for name, u in u_rel.items())
    plan = ADAPTIVE % (case.sample.model, json.dumps(case.ior), wanted)
    if case.sample.model == "oren-nayar":
        plan = plan.replace(f"ior = {json.dumps(case.ior)}\n", "")
    lines = []
    for seed in range(given.seed, given.seed + given.count):
        one = measure(rig, case, plan, seed)
        lines.append(line(one, case, grid.times))
        print(seed, lines[-1], flush=True)
        if given.tables is not None:
            given.tables.mkdir(parents=True, exist_ok=True)
            one.table.to_csv(given.tables / f"{given.sample}-{seed}.csv", index=False)
    for name in case.wanted:
        pulls = np.array([one[f"pull {name}"] for one in lines])
        print(f"{name}: root mean square of the pulls {np.sqrt(np.mean(pulls**2)):.2f}, mean {pulls.mean():.2f}")


if __name__ == "__main__":
    main()
