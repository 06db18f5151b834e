"""Plans around specular spikes: do stated uncertainties hold where an error of an angle changes everything?

    python tools/spike_campaign.py --seed 1 --count 40 --out DIR

Each plan is drawn at random: a He-Torrance sample (sigma0 0.05 to 0.4 um), one to three angles of incidence (30 to 80
degrees), steps of 0.1 to 5 degrees around the mirror direction, in the plane of incidence and out of it. It is measured
on a simulated rig with all errors of "sim" (every other plan on one whose camera arm has an azimuth axis instead of
a tilt), and reduced. Printed are the pulls (brdf - truth) / u_brdf of all rows that may be used, where the truth is the
sample through the instrument's cones at the directions that the table states.

A folder that holds measured runs already is not measured again: only the reduction is made anew.
"""

from __future__ import annotations

import argparse
import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio import instrument, models
from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.config import parse
from gonio.geometry import Directions
from gonio.reduction import brdf
from gonio.rig.description import RigDescription, SampleDescription

if TYPE_CHECKING:
    import pandas as pd

METALS = ([0.77, 6.08], [0.26, 2.55], [2.9, 3.05], [1.5, 0.0])
KINDS = ("curve", "zoom", "mixed", "out of plane", "both", "few")
MOST = 90
"""Points of a plan."""


def rig(azimuth: bool = False, name: str = "sim") -> RigChoice:
    """A shipped rig with a sensor just large enough; with a camera arm on an azimuth axis instead of a tilt."""
    from gonio_sim.rig import SimulatedRigPlugin

    table = tomllib.loads((files("gonio_sim") / "rigs" / f"{name}.toml").read_text(encoding="utf-8"))
    table["camera"] |= {"width": 48, "height": 48}
    table["holder"]["sample_diameter_mm"] = 3.0
    if azimuth:
        table["holder"]["axes"] = ["spin"]
        table["arms"]["azimuth"] = {
            "limits_deg": [-180.0, 180.0], "encoder_step_deg": 0.088, "backlash_deg": 0.1, "zero_u_deg": 0.02,
        }  # fmt: skip
    return RigChoice(SimulatedRigPlugin(name), parse(RigDescription, table, f"{name}.toml"), name)


def sample(rng: np.random.Generator) -> SampleDescription:
    """A sample whose spike may stand high above its lobe, or drown in it."""
    sigma0 = float(rng.uniform(0.05, 0.4))
    return SampleDescription(
        name="spiked",
        model="he-torrance",
        parameters={
            "sigma0_um": round(sigma0, 3),
            "tau_um": round(sigma0 * float(rng.uniform(5.0, 16.0)) + 0.5, 3),
            "ior": METALS[int(rng.integers(len(METALS)))],
            "diffuse_albedo": round(float(rng.choice([0.0, 0.1, 0.3])), 1),
        },
    )


def plan(rng: np.random.Generator, kind: str, most: int = MOST) -> Plan:
    """Points around the mirror directions of one to three angles of incidence."""
    incidences = np.round(np.sort(rng.uniform(30.0, 80.0, int(rng.integers(1, 4)))), int(rng.integers(0, 2)))
    out: list[tuple[float, float, float]] = []
    for theta_i in incidences:
        share = most // len(incidences)
        step = float(np.round(math.exp(rng.uniform(math.log(0.1), math.log(5.0))), 2))
        start = float(rng.choice([0.0, round(float(rng.uniform(0.0, step)), 2)]))
        if kind == "zoom":
            step = float(np.round(rng.uniform(0.1, 0.6), 1))
        if kind in ("curve", "zoom", "mixed", "both"):
            half = min(share // (2 if kind in ("curve", "zoom") else 4), math.floor(90.0 / step))
            out += [(theta_i, theta_i + start + k * step, 180.0) for k in range(-half, half + 1)]
        if kind == "mixed":
            fine = float(np.round(rng.uniform(0.1, 1.0), 1))
            out += [(theta_i, theta_i + k * fine, 180.0) for k in range(-share // 6, share // 6 + 1)]
        if kind in ("out of plane", "both"):
            turns = step / math.sin(math.radians(theta_i)) * np.arange(-2, 3) + float(rng.choice([0.0, step / 2]))
            out += [(theta_i, theta_i + start + k * step, 180.0 + turn) for k in range(-2, 3) for turn in turns]
        if kind == "few":
            apart = rng.uniform(-1.3, 1.3, (int(rng.integers(1, 5)), 2))
            out += [(theta_i, theta_i + x, 180.0 + y / math.sin(math.radians(theta_i))) for x, y in apart]
    points = []
    for theta_i, theta_r, dphi in out:
        turn = dphi if theta_r >= 0 else dphi + 180.0
        if abs(theta_r) <= 86.0:
            points.append(Point(float(theta_i), 0.0, round(abs(float(theta_r)), 6), round(float(turn) % 360.0, 6)))
    return Plan(kind, (500.0,), tuple(dict.fromkeys(points)), 0, "campaign")


def measured(folder: Path, seed: int, number: int, most: int = MOST) -> tuple[pd.DataFrame, SampleDescription, Plan]:
    """The table of one plan, measured unless its run is there, and reduced."""
    rng = np.random.default_rng([seed, number])
    what, chosen = sample(rng), plan(rng, KINDS[number % len(KINDS)], most)
    out = folder / f"{seed}-{number}"
    if not (out / "run.toml").exists():
        carry_out(chosen, rig(bool((number // len(KINDS)) % 2)), out, sample=what, seed=1000 * seed + number, yes=True)
    return brdf.reduce(Run.open(out)), what, chosen


def pulls(table: pd.DataFrame, what: SampleDescription) -> np.ndarray:
    """(brdf - truth) / u_brdf of every row; NaN where a flag says why it is not to be used."""
    model = models.build(what.model, what.parameters)
    truth = instrument.apparent_brdf(
        model,
        *Directions.from_table(table).angles,
        wavelength_nm=float(table["wavelength_nm"].iloc[0]),
        source_solid_angle_sr=table.attrs["source_solid_angle_sr"],
        receiver_solid_angle_sr=table.attrs["receiver_solid_angle_sr"],
        spike="exact",
    )
    return np.where(table["flag"] == "", (table["brdf"] - truth) / table["u_brdf"], np.nan)


def main() -> None:
    """Measure, reduce and print."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--count", type=int, default=40)
    arguments.add_argument("--out", type=Path, required=True)
    options = arguments.parse_args()
    every = []
    for number in range(options.count):
        table, what, chosen = measured(options.out, options.seed, number)
        z = pulls(table, what)
        used = np.flatnonzero(np.isfinite(z))
        every.append(z[used])
        if used.size:
            worst = used[int(np.argmax(abs(z[used])))]
            row = table.iloc[worst]
            print(
                f"{number:3d} {chosen.name:12s} sigma0 {what.parameters['sigma0_um']:.3f} {used.size:3d} rows, "
                f"sd {z[used].std():5.2f}, mean {z[used].mean():5.2f}, largest {z[worst]:7.2f} at theta_i "
                f"{row['theta_i_deg']:.2f} theta_r {row['theta_r_deg']:.2f} dphi "
                f"{(row['phi_r_deg'] - row['phi_i_deg']) % 360:.2f}: {row['brdf']:.4g} +- {row['u_brdf']:.2g}",
                flush=True,
            )
    z = np.concatenate(every)
    print(f"{z.size} pulls: sd {z.std():.3f}, root mean square {np.sqrt(np.mean(z**2)):.3f}, mean {z.mean():.3f}")
    print(f"beyond 3: {np.sum(abs(z) > 3)}, beyond 5: {np.sum(abs(z) > 5)}, largest {abs(z).max():.2f}")


if __name__ == "__main__":
    main()
