"""Adaptive sweeps towards parameters without frames: how often a right model is accused, and what a wrong one costs.

    python tools/adaptive_values.py alarms --designs 4 --draws 100 --seed 1
    python tools/adaptive_values.py wrong --pairs 8 --seed 1

Values are drawn as the simulated rig would measure them: the model through the cones, in the directions in which the
axes truly stand (zeros, and landings that are uniform over an encoder's step), times the reference's error, with the
noise of camera and lamp.

`alarms`: runs of a right model grow until the target is met. Then the values of each are drawn again many times, at the
same points, and every look is judged again. Printed are the shares of small probabilities, and of accused runs.

`pulls`: errors of the parameters over their stated uncertainties, of runs that grow until the target is met.

`wrong`: he-torrance is asked of samples that it does not describe, with as much rig time as a uniform grid takes. The
error is that of monotone cubics through the logarithms, visits to the same point averaged, over all angles above a
thousandth of the peak, at the grid's incidences. Printed are ratios to the grid's mean error, with the standard error
of the mean and the bound that holds with 95 %.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import independent
from gonio_sweeps import candidates, expected
from gonio_sweeps.candidates import snake
from gonio_sweeps.online import Values
from gonio_sweeps.parameters import Parameters
from scipy.interpolate import PchipInterpolator
from scipy.stats import t as student

from gonio import models
from gonio.acquisition.choosing import chooser_of
from gonio.acquisition.duration import Durations
from gonio.acquisition.measure import find_rig
from gonio.acquisition.plan import Point, load_plan
from gonio.acquisition.schedule import reference_pose
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.reduction.table import CAUSES, angle_axes
from gonio.rig import Pose, Step, kinematics

RIG = find_rig("sim").description
NM = 500.0
PLAN = """name = "adaptive"
wavelength_nm = [500]
[adaptive]
how = "parameters"
budget_h = %g
model = "he-torrance"
ior = "%s"
u_rel = { sigma0_um = %g, tau_um = %g }
theta_i_deg = %s
theta_r_deg = { start = -85, stop = 85, step = %g }
"""
FOUR, FIVE = [10, 30, 60, 75], [10, 30, 45, 60, 75]
PEAK = 1e-3
"""Angles where a curve is below this part of its highest value are not judged."""


def chooser(budget_s: float, u_rel: float, theta_i: Sequence[float], step: float, ior: str = "Al") -> Parameters:
    """That of a plan for he-torrance."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.toml"
        path.write_text(PLAN % (budget_s / 3600.0, ior, u_rel, u_rel, json.dumps(theta_i), step))
        made = chooser_of(load_plan(path), RIG)[1]
    assert isinstance(made, Parameters)
    return made


def at(directions: Directions) -> Observations:
    """Directions, as the forward model takes them."""
    one = np.ones(len(directions))
    lamp, lens = (
        float(solid_angle_of_cone(math.radians(a))) for a in (RIG.lamp.half_angle_deg, RIG.camera.lens_half_angle_deg)
    )
    return Observations(directions, NM * one, one, independent(one), np.arange(one.size), lamp, lens)


@dataclass
class Bench:
    """Values of a model, as the rig would measure them."""

    model: Any
    seed: int
    durations: Durations
    poses: list[Pose] = field(default_factory=list)
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    """Value, its true one, and its noise [1/sr]."""
    spent_s: float = 0.0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.scale = 1.0 + RIG.reference.u_rel * self.rng.normal()
        self.zeros = {n: math.radians(axis.zero_u_deg) * self.rng.normal() for n, axis in angle_axes(RIG).items()}
        visit = Step(0, "reference", pose=reference_pose(RIG))
        self.spent_s = RIG.lamp.warm_up_s + self.durations.frames_s(Step(0, "dark")) + self.durations.frames_s(visit)

    def measure(self, points: Sequence[Point]) -> None:
        """Points of a batch, in the order that saves travel."""
        self.measure_at([kinematics.reach(RIG, points[k].directions) for k in snake(list(points))])

    def measure_at(self, goals: Sequence[Pose]) -> None:
        """Poses of a batch."""
        axes = angle_axes(RIG)
        true, read = [], []
        for goal in goals:
            steps = {n: math.radians(axis.encoder_step_deg) for n, axis in axes.items()}
            (shown_at,) = candidates.read(RIG, [goal])
            off = {n: getattr(shown_at, n) + self.zeros[n] + s * (self.rng.random() - 0.5) for n, s in steps.items()}
            read.append(shown_at)
            true.append(kinematics.directions(RIG, replace(goal, **off)))
        shown = Directions.stack([kinematics.directions(RIG, pose) for pose in read])
        there = Directions.stack(true)
        value = apparent(self.model, at(there)) * np.cos(there.theta_i) / np.cos(shown.theta_i)
        seen = expected.Expected(self.durations, goals).visits(value)
        noise = np.where(np.isfinite(seen.u_rel), seen.u_rel * value, 1e-6)
        found = self.scale * (value + noise * self.rng.standard_normal(value.size))
        self.rows += list(zip(found.tolist(), value.tolist(), noise.tolist(), strict=True))
        here = self.poses[-1] if self.poses else Pose()
        self.poses += read
        self.spent_s += expected.batch_s(self.durations, goals, seen.seconds.tolist(), here)

    def values(self, count: int | None = None) -> Values:
        """All, or the first ones."""
        poses = self.poses[:count]
        brdf, _, noise = np.array(self.rows[:count]).T
        return Values(
            rows=np.arange(brdf.size),
            directions=Directions.stack([kinematics.directions(RIG, pose) for pose in poses]),
            poses=tuple(poses),
            brdf=brdf,
            u_noise=noise,
            common={"s_reference": RIG.reference.u_rel * brdf},
            time_s=np.arange(brdf.size, dtype=float),
        )


@dataclass
class Grown:
    """A run that chose its points."""

    bench: Bench
    ends: list[int]
    """Values before each look."""
    modes: str
    met: bool
    p_values: list[float]


def grow(made: Parameters, bench: Bench) -> Grown:
    """A run from its first points to its end."""
    modes, out = list[str](), Grown(bench, [], "", False, [])
    bench.measure(made.first([]))
    while True:
        values = bench.values()
        out.ends.append(len(values))
        choice = made.choose(
            values,
            spent_s=bench.spent_s,
            modes=modes,
            reduced=lambda values=values: table(made, values),  # type: ignore[misc]
        )
        modes.append(choice.why["mode"])
        out.modes += choice.why["mode"][0]
        out.p_values += [choice.why["p_value"]] if "p_value" in choice.why else []
        if not choice.points:
            out.met = choice.met
            return out
        bench.measure(choice.points)


def table(made: Parameters, values: Values) -> pd.DataFrame:
    """What a reduction would state, were its slopes those of the fitted model."""
    known = made.fitted(values)
    assert known is not None
    d, rows = values.directions, known.rows
    out = pd.DataFrame({f"{name}_deg": np.degrees(getattr(d, name)) for name in ANGLES})
    out = out.assign(wavelength_nm=NM, polarisation="unpolarised", brdf=values.brdf, flag="")
    out["u_random"] = np.hypot(values.u_noise, rows.u_landing)
    zeros = {name: rows.of_angles[name] for name in (CAUSES["light"], CAUSES["camera"])}
    columns = {**values.common, **zeros}
    for name, column in columns.items():
        out[name] = column
    out["u_brdf"] = np.sqrt(out["u_random"] ** 2 + sum(out[name] ** 2 for name in columns))
    lamp, lens = at(d).source_solid_angle_sr, at(d).receiver_solid_angle_sr
    out.attrs["provenance"] = {"zeros_rad": {name: math.radians(0.02) for name in ("theta_i_zero", "theta_r_zero")}}
    out.attrs.update(quantity="brdf", source_solid_angle_sr=lamp, receiver_solid_angle_sr=lens)
    return out


ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")


# ---- how often a right model is accused ----


def alarms(designs: int, draws: int, seed: int, truth: Any) -> None:
    """See the module."""
    small, accused, total = {level: 0 for level in (0.1, 0.05, 0.01, 0.003, 0.001)}, 0, 0
    looks = 0
    for design in range(seed, seed + designs):
        made = chooser(3600.0, 0.0014, FOUR, 1.0, truth.ior)
        grown = grow(made, Bench(truth, design, Durations(RIG, made._bands)))
        for draw in range(draws):
            again = Bench(truth, 100_000 * design + draw, grown.bench.durations)
            again.measure_at(grown.bench.poses)
            rejected = False
            for look, count in enumerate(grown.ends):
                known = made.fitted(again.values(count))
                assert known is not None
                looks += 1
                for level in small:
                    small[level] += known.test.p_value < level
                rejected |= known.test.rejects(look)
            accused += rejected
            total += 1
        shares = {level: round(count / looks, 4) for level, count in small.items()}
        said = {"values": len(grown.bench.rows), "modes": grown.modes, "met": grown.met}
        print(design, said, "looks", looks, shares, f"accused {accused} of {total}", flush=True)


# ---- errors over stated uncertainties ----


def pulls(count: int, seed: int, truth: Any) -> None:
    """See the module."""
    found = []
    for number in range(seed, seed + count):
        made = chooser(3600.0, 0.0013, FOUR, 1.0, truth.ior)
        grown = grow(made, Bench(truth, number, Durations(RIG, made._bands)))
        result = fit(table(made, grown.bench.values()), "he-torrance", ior=truth.ior)
        of = [result.parameters[name] for name in ("sigma0_um", "tau_um")]
        true = (truth.sigma0_um, truth.tau_um)
        found.append([(e.value - t) / (e.u or math.nan) for e, t in zip(of, true, strict=True)])
        u = [round(100.0 * (e.u or math.nan) / t, 4) for e, t in zip(of, true, strict=True)]
        said = {"points": len(grown.bench.rows), "modes": grown.modes, "met": grown.met, "u %": u}
        print(number, said, "pulls", np.round(found[-1], 2).tolist(), flush=True)
    print("root mean squares of the pulls", np.sqrt(np.mean(np.square(found), axis=0)).round(3).tolist())


# ---- what a wrong model costs ----

SAMPLES: dict[str, Any] = {
    "lambert 0.7": models.Lambert(albedo=0.7),
    "oren-nayar 30": models.OrenNayar(albedo=0.5, sigma_deg=30.0),
    "oren-nayar 12": models.OrenNayar(albedo=0.6, sigma_deg=12.0),
    "cook-torrance 0.25": models.CookTorrance(s=0.6, d=0.4, slopes=((0.25, 1.0),), ior=1.5, diffuse_albedo=0.4),
    "cook-torrance 0.15": models.CookTorrance(s=0.5, d=0.5, slopes=((0.15, 1.0),), ior=1.5, diffuse_albedo=0.3),
    "cook-torrance 0.4": models.CookTorrance(s=0.7, d=0.3, slopes=((0.4, 1.0),), ior=1.6, diffuse_albedo=0.2),
    "phong 400": models.Phong(k_d=0.2, k_s=0.4, exponent=400.0),
    # not looked at while the chooser was made
    "lambert 0.3": models.Lambert(albedo=0.3),
    "oren-nayar 20": models.OrenNayar(albedo=0.8, sigma_deg=20.0),
    "phong 60": models.Phong(k_d=0.2, k_s=0.5, exponent=60.0),
    "cook-torrance 0.1": models.CookTorrance(s=0.3, d=0.7, slopes=((0.1, 1.0),), ior=1.5, diffuse_albedo=0.5),
    "cook-torrance 0.3 metal": models.CookTorrance(s=0.9, d=0.1, slopes=((0.3, 1.0),), ior=2.5, diffuse_albedo=0.1),
}


def errors(bench: Bench) -> tuple[float, float]:
    """Root mean square and 95 % of the relative errors of the curves at five incidences."""
    values = bench.values()
    signed, theta_i = np.degrees(values.directions.signed), np.degrees(values.directions.theta_i)
    out = []
    for incidence in FIVE:
        here = np.abs(theta_i - incidence) < 1.0
        x = np.round(signed[here], 1)
        y = np.log(np.maximum(values.brdf[here] / bench.scale, 1e-9))
        places, which = np.unique(x, return_inverse=True)
        level = np.bincount(which, y) / np.bincount(which)
        grid = np.arange(-84.0, 84.1, 0.5)
        there = Directions.from_degrees(float(incidence), 0.0, np.abs(grid), np.where(grid < 0, 0.0, 180.0))
        true = apparent(bench.model, at(there))
        if places.size < 3:
            out.append(np.ones(int((true > PEAK * true.max()).sum())))
            continue
        scaled = np.arcsinh((places - incidence) / 5.0)
        inside = np.arcsinh((np.clip(grid, places.min(), places.max()) - incidence) / 5.0)
        found = np.exp(PchipInterpolator(scaled, level)(inside))
        out.append(np.abs(found / true - 1.0)[true > PEAK * true.max()])
    error = np.minimum(np.concatenate(out), 1.0)
    return float(np.sqrt(np.mean(error**2))), float(np.percentile(error, 95.0))


def wrong(pairs: int, seed: int, names: Sequence[str], uniforms: int = 24) -> None:
    """See the module."""
    for name in names:
        truth, grid = SAMPLES[name], chooser(1e6, 0.001, FIVE, 2.5)
        durations = Durations(RIG, grid._bands)
        of_grid = []
        for k in range(uniforms):
            uniform = Bench(truth, 10_000 + seed + k, durations)
            uniform.measure(grid.candidates.points)
            of_grid.append(errors(uniform))
        ratios, modes = [], []
        for k in range(pairs):
            made = chooser(uniform.spent_s, 0.001, FIVE, 1.0)
            grown = grow(made, Bench(truth, seed + k, durations))
            ratios.append(np.array(errors(grown.bench)) / np.mean(of_grid, axis=0))
            modes.append(f"{grown.modes.find('c')}/{len(grown.bench.rows)}")
        mean, u = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / math.sqrt(pairs)
        bound = mean + student.ppf(0.95, pairs - 1) * u
        said = [f"{m:.3f} +- {e:.3f} (95 % below {b:.3f})" for m, e, b in zip(mean, u, bound, strict=True)]
        worst = np.max(ratios, axis=0).round(2).tolist()
        print(f"{name}: rms {said[0]}, 95 % of the errors {said[1]}; worst {worst}; noticed/points {modes}", flush=True)


def main() -> None:
    """As a program."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["alarms", "pulls", "wrong"])
    parser.add_argument("--designs", type=int, default=4)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--samples", nargs="*", default=list(SAMPLES))
    parser.add_argument("--sigma0-um", type=float, default=0.28)
    parser.add_argument("--tau-um", type=float, default=1.77)
    parser.add_argument("--ior", default="Al")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    truth = models.HeTorrance(sigma0_um=given.sigma0_um, tau_um=given.tau_um, ior=given.ior, diffuse_albedo=0.0)
    if given.what == "alarms":
        alarms(given.designs, given.draws, given.seed, truth)
    elif given.what == "pulls":
        pulls(given.designs, given.seed, truth)
    else:
        wrong(given.pairs, given.seed, given.samples)


if __name__ == "__main__":
    main()
