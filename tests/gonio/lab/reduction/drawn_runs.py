"""Runs that are drawn at random and measured on the simulated rig: plans around spikes, and plans of all kinds."""

from __future__ import annotations

import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import instrument, models
from gonio.config import parse
from gonio.geometry import Directions
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from gonio.typing import Floats

if TYPE_CHECKING:
    import pandas as pd

METALS = ([0.77, 6.08], [0.26, 2.55], [2.9, 3.05], [1.5, 0.0])
SPIKE_PLANS = ("curve", "zoom", "mixed", "out of plane", "both", "few")
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


def spiked_sample(rng: np.random.Generator) -> SampleDescription:
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


def plan_around_spikes(rng: np.random.Generator, kind: str, most: int = MOST) -> Plan:
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


def measured_around_spikes(
    folder: Path, seed: int, number: int, most: int = MOST
) -> tuple[pd.DataFrame, SampleDescription, Plan]:
    """The table of one plan, measured unless its run is there, and reduced."""
    rng = np.random.default_rng([seed, number])
    what, chosen = spiked_sample(rng), plan_around_spikes(rng, SPIKE_PLANS[number % len(SPIKE_PLANS)], most)
    out = folder / f"{seed}-{number}"
    if not (out / "run.toml").exists():
        carry_out(
            chosen, rig(bool((number // len(SPIKE_PLANS)) % 2)), out, sample=what, seed=1000 * seed + number, yes=True
        )
    return brdf.reduce(Run.open(out)), what, chosen


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


def chi_square(table: pd.DataFrame, off: Floats) -> float:
    """Of departures from the truth, with the table's covariance."""
    common = table[[name for name in table.columns if name.startswith("s_")]].to_numpy(dtype=float)
    random = table["u_random"].to_numpy(dtype=float) ** 2
    return float(off @ np.linalg.solve(np.diag(random) + common @ common.T, off))


def pulls(table: pd.DataFrame, what: SampleDescription) -> Floats:
    """(brdf - truth) / u_brdf of every row; NaN where a flag says why it is not to be used."""
    return np.where(table["flag"] == "", (table["brdf"] - truth(table, what)) / table["u_brdf"], np.nan)
