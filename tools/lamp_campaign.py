"""Lamps that wander at random between the visits to the white reference: do the values hold their uncertainties?

    python -m tools.lamp_campaign --seed 1 --count 40 --out DIR

Each lamp has a random walk of 0.05 to 2 % (drawn evenly in its logarithm) from one visit to the next, and three to
twelve visits. A matte sample is measured with it on the simulated rig, with all errors of "sim" but for the lamp's
noise from frame to frame (0.05 %), and reduced. Printed are chi-square over n with the table's whole covariance, and
how many values lie within 1.96 u_brdf.

    python -m tools.lamp_campaign --levels --seed 1 --count 200

draws levels alone, without frames: random walks, a steady drift, a warm-up. Visits are known to 0.05 %, six points lie
in every interval. Printed are how many levels lie within 1.96 u, their root mean square in u, and the median of u over
that of the straight line.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from gonio_analysis.fitting.observations import observations

from gonio import instrument, models
from gonio.acquisition.measure import carry_out
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.geometry import Directions
from gonio.reduction import brdf, white_reference
from gonio.rig.description import SampleDescription
from gonio.typing import Floats
from tools.spike_campaign import rig

NOISE = 5e-4
EVERY_S = 300.0
KINDS = {
    **{f"walk of {100 * x:g} %": ("walk", x) for x in (5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)},
    "steady": ("line", 0.0), "drift of 0.2 %": ("line", 2e-3), "warm-up by 3 %": ("warm", 3e-2),
}  # fmt: skip


def lamp(rng: np.random.Generator, kind: str, size: float, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Times and values of visits, times between them, and the true level there."""
    visits = EVERY_S * np.arange(count)
    at = EVERY_S * np.arange(0.5 / 6, count - 1, 1.0 / 6)
    every = np.sort(np.concatenate([visits, at]))
    level = 1.0 + size * every / EVERY_S
    if kind == "walk":
        level = 1.0 + np.cumsum(size * np.sqrt(np.diff(every, prepend=0.0) / EVERY_S) * rng.standard_normal(every.size))
    if kind == "warm":
        level = 1.0 - size * np.exp(-every / 400.0)
    seen = np.interp(visits, every, level) * (1.0 + NOISE * rng.standard_normal(count))
    return visits, seen, at, np.interp(at, every, level)


def levels(seed: int, count: int) -> None:
    """Draw levels, and print how well the reduction's hold them."""
    rng = np.random.default_rng(seed)
    print(f"{'lamp':16s} visits  within 1.96 u   rms    u over the line's")
    for name, (kind, size) in KINDS.items():
        for number in (3, 4, 5, 6, 8, 12):
            pulls, wider = [], []
            for _ in range(count):
                times, seen, at, true = lamp(rng, kind, size, number)
                fitted = white_reference.fit(times, seen, (NOISE * seen) ** 2, at)
                line = np.hypot(fitted.noise(at), fitted.drift(at))
                u = np.hypot(line, fitted.extra(at))
                pulls.append((fitted.at(at) - true) / u)
                wider.append(float(np.median(u / line)))
            z = np.array(pulls)
            held, rms = np.mean(abs(z) <= 1.96), np.sqrt(np.mean(z**2))
            print(f"{name:16s} {number:6d} {100 * held:11.1f} % {rms:7.2f} {np.median(wider):9.2f}", flush=True)


def measured(folder: Path, seed: int, number: int) -> tuple[float, float, str]:
    """Chi-square over n and the part of values within 1.96 u_brdf of one lamp, and what it was."""
    rng = np.random.default_rng([seed, number])
    visits, walk = int(rng.integers(3, 13)), math.exp(rng.uniform(math.log(5e-4), math.log(2e-2)))
    per = int(rng.integers(8, 16))
    points = [
        Point(5.0 * k, 0.0, abs(float(r)), 180.0 if r >= 0 else 0.0)
        for k in range(1, visits)
        for r in np.round(np.linspace(-65.0, 65.0, per), 1)
        if abs(r + 5.0 * k) > 3.0
    ]
    plan = Plan("matte", (500.0,), tuple(points), 0, "campaign")
    what = SampleDescription(name="matte", model="oren-nayar", parameters={"albedo": 0.6, "sigma_deg": 20.0})
    choice, out = rig(), folder / f"{seed}-{number}"
    from gonio_sim.world import slot_s

    known = choice.description
    hours = per * slot_s(known) / 3600.0
    light = known.lamp.model_copy(update={"noise": NOISE, "wander_per_sqrt_hour": walk / math.sqrt(hours)})
    reference = known.reference.model_copy(update={"every": per})
    choice = replace(choice, description=known.model_copy(update={"lamp": light, "reference": reference}))
    if not (out / "run.toml").exists():
        carry_out(plan, choice, out, sample=what, seed=1000 * seed + number, yes=True)
    table = brdf.reduce(Run.open(out))
    table = table[table["flag"] == ""]
    true = instrument.apparent_brdf(
        models.build(what.model, what.parameters), *Directions.from_table(table).angles, wavelength_nm=500.0,
        source_solid_angle_sr=table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=table.attrs["receiver_solid_angle_sr"],
    )  # fmt: skip
    off = table["brdf"].to_numpy() - true
    within = float(np.mean(abs(off) <= 1.96 * table["u_brdf"]))
    covariance = observations(table, "campaign").covariance
    assert covariance is not None
    chi_square = covariance.chi_square(off)
    shown = f"{visits:2d} visits, {per:2d} points an interval, walk of {100 * walk:.3f} %"
    return chi_square / len(off), within, shown


def main() -> None:
    """Draw or measure, and print."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--levels", action="store_true")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--count", type=int, default=40)
    arguments.add_argument("--out", type=Path)
    options = arguments.parse_args()
    if options.levels:
        levels(options.seed, options.count)
        return
    if options.out is None:
        arguments.error("--out DIR is needed, for the runs")
    found = []
    for number in range(options.count):
        chi_square, within, shown = measured(options.out, options.seed, number)
        found.append((chi_square, within))
        print(f"{number:3d} {shown}: chi-square / n {chi_square:.2f}, {100 * within:.0f} % within", flush=True)
    chi, within = np.array(found).T
    print(f"{len(chi)} lamps: chi-square / n {chi.mean():.2f} (median {np.median(chi):.2f}), "
          f"{100 * within.mean():.1f} % within 1.96 u")  # fmt: skip


if __name__ == "__main__":
    main()
