"""Do stated uncertainties hold on any plan? Scattered directions, few points, curves, on samples from matte to glossy.

    python tools/angle_campaign.py --seed 1 --count 56 --out DIR [--without-steps]

Campaign k of a seed draws a sample, a plan and a rig: the plan is `PLANS[k % 7]`, the sample is drawn from `SAMPLES`,
the rig is "sim", "sim-metrology", or "sim" with an azimuth axis. It is measured and reduced. Compared are the table's
values with the sample through the instrument's cones at the directions that the table states, with the covariance
diag(u_random^2) + sum s s^T: chi-square over the number of values, its probability, and the largest pull. Campaigns are
judged together by their mean chi-square, and by how many have a probability below 1 and 5 %.

A folder that holds measured runs already is not measured again: only the reduction is made anew. `--without-steps`
leaves the part `coarse_steps` of the budget out: what it adds is seen so.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import chdtrc

from gonio import instrument, models
from gonio.acquisition.measure import carry_out
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.geometry import Directions
from gonio.reduction import brdf
from gonio.rig.description import SampleDescription
from gonio.typing import Floats
from tools.spike_campaign import METALS, rig

if TYPE_CHECKING:
    import pandas as pd

PLANS = ("scattered", "around the mirror", "few", "incidences", "curves", "one curve", "mixed")
SAMPLES = ("he-torrance", "he-torrance", "cook-torrance", "cook-torrance", "blinn", "oren-nayar", "lambert")
RIGS = (("sim", False), ("sim-metrology", False), ("sim", True), ("sim-metrology", False))
Drawn = tuple[SampleDescription, Plan, tuple[str, bool]]


def sample(rng: np.random.Generator, kind: str) -> SampleDescription:
    """A sample of a family."""

    def even(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    given: dict[str, Any] = {"albedo": even(0.05, 0.95)}
    if kind == "oren-nayar":
        given["sigma_deg"] = even(5.0, 40.0)
    elif kind == "blinn":
        given = {"k_d": even(0.02, 0.3), "k_s": even(0.1, 1.0), "c": even(0.1, 0.5), "ior": even(1.35, 2.5)}
    elif kind == "cook-torrance":
        s = even(0.2, 0.9)
        given = {"s": s, "d": 1.0 - s, "slopes": [[float(np.exp(rng.uniform(math.log(0.08), math.log(0.45)))), 1.0]]}
        given |= {"diffuse_albedo": even(0.05, 0.9), "ior": even(1.35, 2.2)}
    elif kind == "he-torrance":
        sigma0 = even(0.08, 0.6)
        given = {"sigma0_um": sigma0, "tau_um": round(sigma0 * float(rng.uniform(5.0, 16.0)), 4)}
        given |= {"diffuse_albedo": even(0.0, 0.3), "ior": METALS[int(rng.integers(len(METALS)))]}
    elif kind == "anisotropic":
        given = {"s": even(0.3, 0.8), "diffuse_albedo": even(0.1, 0.2), "ior": [even(1.35, 2.2), 0.0]}
        given |= {"alpha_along": even(0.12, 0.25), "alpha_across": even(0.3, 0.6), "brushing_deg": even(0.0, 180.0)}
    return SampleDescription(name=kind, model=kind, parameters=given)


def plan(rng: np.random.Generator, kind: str) -> Plan:
    """Points of one kind of plan: (theta_i, phi_i, theta_r, phi_r) [deg]."""
    out: list[tuple[float, float, float, float]] = []
    turn = bool(rng.random() < 0.5)

    def scattered(count: int) -> None:
        for _ in range(count):
            phi_i = float(rng.uniform(0.0, 360.0)) if turn else 0.0
            theta = np.degrees(np.arcsin(np.sqrt(rng.uniform(0.0, math.sin(math.radians(78.0)) ** 2, 2))))
            out.append((float(theta[0]), phi_i, float(theta[1]), float(phi_i + rng.uniform(0.0, 360.0))))

    def around(count: int, incidences: list[float]) -> None:
        reach = float(rng.uniform(8.0, 30.0))
        for k in range(count):
            theta_i = incidences[k % len(incidences)] if incidences else float(rng.uniform(5.0, 70.0))
            phi_i = float(rng.uniform(0.0, 360.0)) if turn else 0.0
            x, y = rng.normal(0.0, reach, 2)
            theta_r = math.hypot(theta_i + x, y)
            out.append((theta_i, phi_i, theta_r, phi_i + 180.0 + math.degrees(math.atan2(y, theta_i + x))))

    def curves(count: int) -> None:
        step = float(rng.choice([2.5, 4.0, 5.0, 7.5, 10.0]))
        for theta_i in np.sort(rng.uniform(5.0, 72.0, count)):
            signed = np.arange(-80.0 + float(rng.uniform(0.0, step)), 81.0, step)
            out.extend((float(theta_i), 0.0, abs(r), 180.0 if r >= 0 else 0.0) for r in signed.tolist())

    incidences = np.round(np.sort(rng.uniform(5.0, 70.0, 3)), 1).tolist()
    if kind == "scattered":
        scattered(int(rng.integers(25, 60)))
    elif kind == "around the mirror":
        around(int(rng.integers(20, 50)), [])
    elif kind == "few":
        (scattered if rng.random() < 0.5 else lambda n: around(n, []))(int(rng.integers(4, 12)))
    elif kind == "incidences":
        around(40, incidences)
    elif kind == "mixed":
        curves(1)
        scattered(25)
    else:
        curves(1 if kind == "one curve" else int(rng.integers(2, 5)))
    points = [
        Point(*(round(float(a), 2) for a in (i, p % 360.0, r, q % 360.0))) for i, p, r, q in out if 0.5 < r < 80.0
    ]
    return Plan(kind, (500.0,), tuple(dict.fromkeys(points)), 0, "campaign")


def draw(seed: int, number: int, model: str | None = None) -> Drawn:
    """Everything of a campaign that is not the bench's own noise."""
    rng = np.random.default_rng([24, seed, number])
    chosen = plan(rng, PLANS[number % len(PLANS)])
    kind = SAMPLES[int(rng.integers(len(SAMPLES)))]
    which = RIGS[int(rng.integers(len(RIGS)))]
    return sample(rng, model or kind), chosen, which


def measured(folder: Path, seed: int, number: int, model: str | None = None) -> tuple[brdf.Reduction, Drawn]:
    """One campaign, measured unless its run is there, and reduced."""
    drawn = draw(seed, number, model)
    what, chosen, (name, azimuth) = drawn
    out = folder / f"{seed}-{number}"
    if not (out / "run.toml").exists():
        carry_out(chosen, rig(azimuth, name), out, sample=what, seed=1000 * seed + number, yes=True)
    return brdf.reduce_in_parts(Run.open(out)), drawn


def truth(table: pd.DataFrame, what: SampleDescription) -> Floats:
    """The sample through the instrument's cones at the directions of the table [1/sr]."""
    return np.asarray(instrument.apparent_brdf(
        models.build(what.model, what.parameters), *Directions.from_table(table).angles,
        wavelength_nm=float(table["wavelength_nm"].iloc[0]), spike="exact",
        source_solid_angle_sr=table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=table.attrs["receiver_solid_angle_sr"],
    ))  # fmt: skip


def chi_square(table: pd.DataFrame, off: Floats, less: Floats | float = 0.0) -> float:
    """Of departures from the truth, with the table's covariance; `less` is taken from the squares of `u_random`."""
    common = table[[name for name in table if name.startswith("s_")]].to_numpy(dtype=float)
    random = table["u_random"].to_numpy(dtype=float) ** 2 - less
    return float(off @ np.linalg.solve(np.diag(random) + common @ common.T, off))


def main() -> None:
    """Measure, reduce, and print a line for each campaign."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--count", type=int, default=28)
    arguments.add_argument("--model", help="one family instead of drawn ones; anisotropic is not drawn")
    arguments.add_argument("--without-steps", action="store_true")
    arguments.add_argument("--out", type=Path, required=True)
    options = arguments.parse_args()
    found: dict[str, list[tuple[float, int]]] = {}
    for number in range(options.first, options.first + options.count):
        parts, (what, chosen, which) = measured(options.out, options.seed, number, options.model)
        good = (parts.table["flag"] == "").to_numpy()
        table, budget = parts.table[good], parts.budget[good]
        off = table["brdf"].to_numpy() - truth(table, what)
        chi = chi_square(table, off, options.without_steps * budget["coarse_steps"].to_numpy() ** 2)
        pulls = off / table["u_brdf"].to_numpy()
        worst = int(np.argmax(abs(pulls)))
        found.setdefault(chosen.name, []).append((chi, off.size))
        row = table.iloc[worst]
        print(
            f"{number:3d} {chosen.name:17s} {what.model:13s} {which[0]:13s} {'azimuth' if which[1] else 'tilt':7s} "
            f"{off.size:3d} rows, chi-square/n {chi / off.size:5.2f}, p {chdtrc(off.size, chi):.1e}, largest "
            f"{pulls[worst]:6.2f} at {row['theta_i_deg']:.2f} {row['theta_r_deg']:.2f} "
            f"{(row['phi_r_deg'] - row['phi_i_deg']) % 360:.1f}: {row['brdf']:.4g} +- {row['u_brdf']:.2g}; "
            f"median u {100 * np.median(table['u_brdf'] / abs(table['brdf'])):.2f} %",
            flush=True,
        )
    found["all"] = [one for some in found.values() for one in some]
    for name, some in found.items():
        chi, count = np.array(some, dtype=float).T
        mean, p = chi / count, chdtrc(count, chi)
        print(
            f"{name:17s} {len(some):3d} campaigns: chi-square/n {mean.mean():.3f} +- "
            f"{mean.std(ddof=min(1, len(some) - 1)) / math.sqrt(len(some)):.3f}, median {np.median(mean):.2f}; "
            f"below 1 %: {np.sum(p < 0.01)}, below 5 %: {np.sum(p < 0.05)}, above 95 %: {np.sum(p > 0.95)}"
        )


if __name__ == "__main__":
    main()
