"""Photographs of spheres joined with in-plane sweeps: do the intervals of a fit cover the truth?

    python tools/photograph_campaign.py --seed 1 --count 40 --out DIR

Each case is drawn at random: a model (He-Torrance, Oren-Nayar, Cook-Torrance) and its parameters, a sphere, a camera
and a light (directional, a point or a disc), how well their places and the absolute scale are known, and the errors
themselves. The photograph is rendered with the errors and reduced without them. The sweep is measured on the simulated
goniometer with all errors of "sim". Both tables go into one fit. Printed are the pulls (fitted - true) / u of all
parameters, how many 95 % intervals cover the truth, and the same for each table alone.

A folder that holds a measured case already is not measured again: only the reduction and the fits are made anew.
"""

from __future__ import annotations

import argparse
import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import observations, together
from gonio_scenes import picture, scene
from gonio_scenes.photograph import reduce
from gonio_scenes.render import render

from gonio import measurement
from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.config import parse
from gonio.reduction import brdf
from gonio.rig.description import RigDescription, SampleDescription
from gonio.rig.dng import write_dng

KINDS = ("he-torrance", "oren-nayar", "cook-torrance")
METALS = (0.96 + 6.69j, 0.26 + 2.55j, 0.42 + 2.35j, 2.9 + 3.05j, 1.5 + 0j)  # about Al, Cu, Au, Fe, and glass
LEVEL = 1.96
WAVELENGTH_NM = 550.0
PIXELS = 200


def sample(rng: np.random.Generator, kind: str) -> tuple[SampleDescription, dict[str, float], complex | None]:
    """A sample, its parameters as a fit calls them, and the optical constants that the fit is told."""

    def even(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    if kind == "oren-nayar":
        truth = {"albedo": even(0.2, 0.9), "sigma_deg": even(8.0, 35.0)}
        return SampleDescription(name=kind, model=kind, parameters=dict(truth)), truth, None
    if kind == "cook-torrance":
        m, s = even(0.15, 0.4), even(0.2, 0.7)
        truth = {"s": s, "m": m, "diffuse_albedo": even(0.1, 0.8), "ior": even(1.35, 2.2)}
        given = {"d": 1.0 - s, "slopes": [[m, 1.0]]} | {n: v for n, v in truth.items() if n != "m"}
        return SampleDescription(name=kind, model=kind, parameters=given), truth, None
    index = METALS[int(rng.integers(len(METALS)))]
    sigma0 = even(0.12, 0.5)
    truth = {
        "sigma0_um": sigma0,
        "tau_um": round(sigma0 * float(rng.uniform(6.0, 12.0)), 4),
        "diffuse_albedo": even(0.05, 0.3),
    }
    given = {**truth, "ior": [index.real, index.imag]}
    return SampleDescription(name=kind, model=kind, parameters=given), truth, index


def sweep(out: Path, what: SampleDescription, seed: int) -> Any:
    """The table of an in-plane sweep on the simulated goniometer."""
    if not (out / "run.toml").exists():
        from gonio_sim.rig import SimulatedRigPlugin

        table = tomllib.loads((files("gonio_sim") / "rigs" / "sim.toml").read_text(encoding="utf-8"))
        table["camera"] |= {"width": 48, "height": 48}
        table["holder"]["sample_diameter_mm"] = 3.0
        rig = RigChoice(SimulatedRigPlugin("sim"), parse(RigDescription, table, "sim.toml"), "sim")
        points = [
            Point(theta_i, 0.0, float(abs(angle)), 180.0 if angle >= 0 else 0.0)
            for theta_i in (25.0, 55.0)
            for angle in range(-75, 76, 6)
            if abs(angle + theta_i) > 4.0
        ]
        plan = Plan("in plane", (WAVELENGTH_NM,), tuple(points), 0, "campaign")
        carry_out(plan, rig, out, sample=what, seed=seed, yes=True)
    return brdf.reduce(Run.open(out))


def turned(vector: Any, rng: np.random.Generator, u_deg: float) -> list[float]:
    """A direction turned at random, by a standard deviation along each of two axes across it."""
    toward = np.array(vector) / np.linalg.norm(vector)
    error = math.radians(u_deg) * rng.standard_normal(3)
    moved = toward + error - (error @ toward) * toward
    return [float(x) for x in moved / np.linalg.norm(moved)]


def scenes(rng: np.random.Generator, what: SampleDescription) -> tuple[dict[str, Any], dict[str, Any]]:
    """A scene as it is described, and as it truly is: tables of scene files."""

    def even(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def normal(u: float, count: int = 3) -> Any:
        return u * rng.standard_normal(count)

    radius, distance = even(15.0, 50.0), even(600.0, 1500.0)
    apart, turn = math.radians(even(20.0, 90.0)), even(0.0, 2.0 * math.pi)
    toward = np.array([math.sin(apart) * math.cos(turn), math.sin(apart) * math.sin(turn), math.cos(apart)])
    kind = str(rng.choice(["directional", "point", "disc"]))
    u = {
        "irradiance_rel": even(0.003, 0.02),
        "center_mm": radius * even(0.001, 0.004),
        "radius_mm": radius * even(0.0005, 0.003),
        "black_level_dn": even(0.05, 0.4),
    }
    far = even(500.0, 1500.0)
    u |= {"light_deg": even(0.05, 0.3)} if kind == "directional" else {"light_mm": far * math.radians(even(0.05, 0.25))}
    light: dict[str, Any] = {"kind": kind}
    if kind == "directional":
        light |= {"toward": toward.tolist(), "irradiance": 1.0}
    elif kind == "point":
        light |= {"position_mm": (far * toward).tolist(), "intensity": far**2}
    else:
        size = far * math.tan(math.radians(even(0.2, 1.5)))
        light |= {"center_mm": (far * toward).tolist(), "normal": (-toward).tolist(), "radius_mm": size, "samples": 16}
        light["radiance"] = (far / size) ** 2 / math.pi
    camera = {
        "position_mm": [0.0, 0.0, distance],
        "vertical_field_deg": 2.0 * math.degrees(math.asin(radius / distance)) * even(1.1, 1.5),
        "width": PIXELS,
        "height": PIXELS,
        "samples": int(rng.choice([1, 36])),  # fewer rays an area would add noise of their own
    }
    described: dict[str, Any] = {
        "name": what.name,
        "wavelength_nm": [WAVELENGTH_NM],
        "camera": camera,
        "shape": [{"kind": "sphere", "radius_mm": radius, "material": "sample"}],
        "material": {"sample": {"model": "lambert", "parameters": {"albedo": 0.5}}},
        "light": [light],
    }
    truly = dict(light)
    if kind == "directional":
        truly["toward"] = turned(light["toward"], rng, u["light_deg"])
    else:
        place = "position_mm" if kind == "point" else "center_mm"
        truly[place] = (np.array(light[place]) + normal(u["light_mm"])).tolist()
    power = {"directional": "irradiance", "point": "intensity", "disc": "radiance"}[kind]
    truly[power] = light[power] * (1.0 + float(normal(u["irradiance_rel"], 1)[0]))
    sphere = described["shape"][0] | {
        "center_mm": normal(u["center_mm"]).tolist(),
        "radius_mm": radius + float(normal(u["radius_mm"], 1)[0]),
    }
    own = {"sample": {"model": what.model, "parameters": what.parameters}}
    real = described | {"shape": [sphere], "light": [truly], "material": own, "seed": int(rng.integers(1 << 31))}
    described["photograph"] = {"uncertainty": u}
    return described, real


def photograph(out: Path, rng: np.random.Generator, what: SampleDescription) -> Any:
    """The table of a photograph that was taken with errors, and reduced without knowing them."""
    described, real = scenes(rng, what)
    sensor = {
        "electrons_per_dn": 2.7, "black_level_dn": 64.0, "full_well_e": 11000.0, "read_noise_e": 2.5,
        "prnu": 0.005, "dsnu_e": 2.0, "cos4": True, "vignetting": 0.08,
    }  # fmt: skip
    black, brightest, seed = rng.standard_normal(), float(rng.uniform(0.6, 1.5)), int(rng.integers(1 << 31))
    image = out / "photograph.dng"
    truth = scene.build(parse(scene.SceneFile, real, "truth"), out / "truth.toml")
    note = out / "responsivity.txt"
    if not image.exists():
        seen = render(truth)
        sensor["responsivity_e_per_s"] = brightest * 10000.0 / float(np.quantile(seen.radiance, 0.999))
        note.write_text(repr(sensor["responsivity_e_per_s"]), encoding="utf-8")
        off = 64.0 + described["photograph"]["uncertainty"]["black_level_dn"] * black
        taken = {"exposure_s": 1.0, "seed": seed, "sensor": sensor | {"black_level_dn": off}}
        shot = scene.build(parse(scene.SceneFile, real | {"photograph": taken}, "truth"), out / "truth.toml")
        write_dng(picture.photograph(shot, seen), image)
    sensor["responsivity_e_per_s"] = float(note.read_text(encoding="utf-8"))
    described["photograph"] |= {"sensor": sensor}
    return reduce(scene.build(parse(scene.SceneFile, described, "described"), out / "described.toml"), image)


def case(folder: Path, seed: int, number: int) -> tuple[dict[str, FitResult], dict[str, float], Any]:
    """The fits of one case ("both" tables, each alone), its true parameters, and the photograph's table."""
    rng = np.random.default_rng([seed, number])
    what, truth, index = sample(rng, KINDS[number % len(KINDS)])
    out = folder / f"{seed}-{number}"
    out.mkdir(parents=True, exist_ok=True)
    taken = photograph(out, rng, what)
    measurement.write(taken, out / "photograph.csv")
    tables = {"sweep": sweep(out / "sweep", what, 1000 * seed + number), "photo": taken}
    parts = {name: observations(table, name) for name, table in tables.items()}
    each = {"both": together(parts), **parts}
    return {name: fit(data, what.model, ior=index, name=name) for name, data in each.items()}, truth, taken


def pulls(result: FitResult, truth: dict[str, float]) -> dict[str, float]:
    """(fitted - true) / u of every parameter that the data determine."""
    out = {}
    for name, value in truth.items():
        found = result.parameters[name]
        if found.u:
            out[name] = (found.value - value) / found.u
    return out


def main() -> None:
    """Draw, measure, fit and print."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--count", type=int, default=40)
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--out", type=Path, required=True)
    options = arguments.parse_args()
    every: dict[str, list[tuple[str, float]]] = {"both": [], "sweep": [], "photo": []}
    for number in range(options.first, options.first + options.count):
        results, truth, taken = case(options.out, options.seed, number)
        used = int((taken["flag"] == "").sum())
        found = {name: pulls(result, truth) for name, result in results.items()}
        for name, z in found.items():
            every[name] += [(f"{KINDS[number % len(KINDS)]} {p}", value) for p, value in z.items()]
        shown = ", ".join(f"{p} {v:+.2f}" for p, v in found["both"].items())
        alone = ", ".join(f"{v:+.2f}" for v in found["photo"].values())
        chi = {name: result.reduced_chi_square for name, result in results.items()}
        print(
            f"{number:3d} {KINDS[number % len(KINDS)]:14s} {used:5d} rows; chi2/n both {chi['both']:.3f} sweep "
            f"{chi['sweep']:.3f} photo {chi['photo']:.3f}; both: {shown}; photo alone: {alone}",
            flush=True,
        )
    for name, values in every.items():
        z = np.array([v for _, v in values])
        print(
            f"{name}: {z.size} pulls, sd {z.std(ddof=1):.3f}, root mean square {np.sqrt(np.mean(z**2)):.3f}, mean "
            f"{z.mean():+.3f}, {100 * np.mean(abs(z) <= LEVEL):.1f} % of the 95 % intervals cover the truth, largest "
            f"{abs(z).max():.2f}"
        )
    for parameter in dict.fromkeys(p for p, _ in every["both"]):
        z = np.array([v for p, v in every["both"] if p == parameter])
        inside = np.count_nonzero(abs(z) <= LEVEL)
        print(f"  {parameter}: {inside} of {z.size}, root mean square {np.sqrt(np.mean(z**2)):.2f}")


if __name__ == "__main__":
    main()
