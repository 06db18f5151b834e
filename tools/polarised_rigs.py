"""Polarised rigs: is a sample's own model accepted where the polarisation of lamp and lens is known only as a bound?

    python tools/polarised_rigs.py --seed 7 --count 20

Each rig is "sim" with a lamp and a lens that polarise by 1 to 20 %, half of them at an azimuth that nobody knows. On it
a rough surface without a base is measured, which keeps all of the polarisation: the error reaches its bound. Zeros and
certificate are off by what is stated of them. A line a rig gives p of the true model's fit, and departures over u.
"""

import argparse
import math
import tempfile
import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_sim.rig import SimulatedRigPlugin

from gonio import models
from gonio.config import parse, to_toml
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.brdf import Reduction, reduce_in_parts
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription

NM = 550.0
K95 = 1.96
METAL = [0.96, 6.69]
"""Index of refraction of aluminium at 550 nm."""


def plan() -> Plan:
    """53 points or fewer: three incidences in the plane in steps of 10 degrees, and some beside it."""
    signed = [(i, float(r)) for i in (10.0, 35.0, 60.0) for r in range(-75, 80, 10)]
    points = [Point(i, 0.0, abs(r), 180.0 if r > 0 else 0.0) for i, r in signed]
    points += [Point(35.0, 0.0, r, phi) for r in (20.0, 45.0, 65.0) for phi in (60.0, 120.0)]
    return Plan("polarised", (NM,), tuple(points), 0, "tool")


def sample(rng: np.random.Generator) -> SampleDescription:
    """A rough metal or glass, of slopes from 0.15 to 0.5."""
    sigma, slope = (math.exp(rng.uniform(math.log(low), math.log(high))) for low, high in ((0.15, 0.8), (0.15, 0.5)))
    ior = METAL if rng.random() < 0.5 else [round(float(rng.uniform(1.4, 1.9)), 3), 0.0]
    parameters = {"sigma0_um": round(sigma, 4), "tau_um": round(2.0 * sigma / slope, 4), "ior": ior}
    return SampleDescription(name="rough", model="he-torrance", parameters=parameters)


def rig(folder: Path, rng: np.random.Generator) -> RigChoice:
    """What is known of the rig; what is true of it is in a file that only the simulated rig reads."""
    table = tomllib.loads((files("gonio_sim") / "rigs" / "sim.toml").read_text(encoding="utf-8"))
    table["camera"] |= {"width": 48, "height": 48}
    table["holder"]["sample_diameter_mm"] = 3.0
    true: dict[str, Any] = {"reference": {"scale": 1.0 + table["reference"]["u_rel"] * float(rng.normal())}}
    for name in ("lamp", "camera"):
        degree, azimuth = math.exp(rng.uniform(math.log(0.01), math.log(0.2))), float(rng.uniform(0.0, 180.0))
        true[name] = {"polarisation": {"degree": degree, "azimuth_deg": azimuth}}
        known = {"degree": degree} | ({"azimuth_deg": azimuth} if rng.random() < 0.5 else {})
        table[name]["polarisation"] = known
    true["arms"] = {
        name: {"zero_offset_deg": arm["zero_offset_deg"] + arm["zero_u_deg"] * float(rng.normal())}
        for name, arm in table["arms"].items()
    }
    (folder / "truth.toml").write_text(to_toml(true))
    table["truth"] = str(folder / "truth.toml")
    return RigChoice(SimulatedRigPlugin("sim"), parse(RigDescription, table, "sim.toml"), "sim")


def measured(folder: Path, seed: int, number: int) -> tuple[Reduction, SampleDescription]:
    """One rig's run, reduced, and what its sample truly is."""
    rng = np.random.default_rng([39, seed, number])
    what = sample(rng)
    carry_out(plan(), rig(folder, rng), folder / "run", sample=what, seed=1000 * seed + number, yes=True)
    return reduce_in_parts(Run.open(folder / "run")), what


@dataclass(frozen=True, slots=True)
class Found:
    """What the fit of the true model to one run says."""

    result: FitResult
    rho: list[float]
    """(rho_dh - truth)/u at the incidences that a report has."""
    parameters: dict[str, float]
    """(value - truth)/u of the heights and of their correlation length."""


def judged(found: Reduction, what: SampleDescription) -> Found:
    """The true model, with its index of refraction known."""
    ior = what.parameters["ior"]
    result = fit(found.table, what.model, ior=complex(*ior))
    true = models.build(what.model, what.parameters)
    rho = [
        (r.rho_dh - float(true.directional_hemispherical(math.radians(r.theta_i_deg), wavelength_nm=NM))) / r.u
        for r in energy.of_model(result)
        if r.rho_dh is not None and r.u is not None
    ]
    free = {name: result.parameters[name] for name in ("sigma0_um", "tau_um")}
    off = {name: (one.value - what.parameters[name]) / one.u for name, one in free.items() if one.u is not None}
    return Found(result, rho, off)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--count", type=int, default=20)
    asked = parser.parse_args()
    every: list[Found] = []
    for number in range(asked.count):
        with tempfile.TemporaryDirectory() as folder:
            found = judged(*measured(Path(folder), asked.seed, number))
        every.append(found)
        off = ", ".join(f"{name} {pull:+.2f}" for name, pull in found.parameters.items())
        print(f"{number}: p = {found.result.p_value:.3g}; rho_dh {np.round(found.rho, 2).tolist()}; {off}", flush=True)
    rho = np.abs([pull for found in every for pull in found.rho])
    parameters = np.abs([pull for found in every for pull in found.parameters.values()])
    print(
        f"{asked.count} rigs: rejected {sum(found.result.rejected for found in every)};"
        f" rho_dh held {np.sum(rho < K95)} of {rho.size}, farthest {rho.max():.2f} u;"
        f" parameters held {np.sum(parameters < K95)} of {parameters.size}, farthest {parameters.max():.2f} u"
    )


if __name__ == "__main__":
    main()
