"""Photographs of spheres joined with in-plane sweeps: do the intervals of a fit cover the truth?

    python -m tools.studies.photograph_campaign --seed 1 --count 40 --out DIR
    python -m tools.studies.photograph_campaign --shape heightfield-facet --alone --seed 1 --count 20 --out DIR

Each case is drawn at random: a model (He-Torrance, Oren-Nayar, Cook-Torrance) and its parameters, a sphere, a camera
and a light (directional, a point or a disc), how well their places and the absolute scale are known, and the errors
themselves. The photograph is rendered with the errors and reduced without them. The sweep is measured on the simulated
goniometer with all errors of "sim". Both tables go into one fit. Printed are the pulls (fitted - true) / u of all
parameters, how many 95 % intervals cover the truth, and the same for each table alone.

With `--alone` no sweep is measured. Height fields are bumpy, drawn at random too.

A folder that holds a measured case already is not measured again: only the reduction and the fits are made anew.
"""

import argparse
import math
import tomllib
from collections.abc import Callable
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
from gonio.config import parse
from gonio.errors import GonioError
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.dng import write_dng
from gonio.samples.description import SampleDescription
from gonio.typing import Floats, TomlTable

KINDS = ("he-torrance", "oren-nayar", "cook-torrance")
METALS = (0.96 + 6.69j, 0.26 + 2.55j, 0.42 + 2.35j, 2.9 + 3.05j, 1.5 + 0j)  # about Al, Cu, Au, Fe, and glass
SHAPES = (
    "sphere", "cylinder", "revolution", "revolution-smooth", "heightfield-facet", "heightfield-smooth",
)  # fmt: skip
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


def shaped(shape: str, rng: np.random.Generator, radius: float, out: Path) -> TomlTable:
    """The table of a shape that is about as wide as a sphere; its file is written."""
    kind, _, normals = shape.partition("-")
    table: TomlTable = {"kind": kind, "material": "sample"}
    if kind == "sphere":
        return table | {"radius_mm": radius}
    if kind == "cylinder":
        return table | {"radius_mm": 0.8 * radius, "height_mm": 1.8 * radius, "axis": [0.3, 1.0, 0.1]}
    turns = rng.normal(size=(12, 3))
    waves, phases = 2.5 * turns, rng.uniform(0.0, 2.0 * math.pi, 12)
    if kind == "revolution":
        z = np.linspace(-0.9, 0.9, int(rng.integers(6, 12)))
        r = radius * np.sqrt(1.0 - z**2)
        profile = [[float(a), float(b)] for a, b in zip(r, radius * z, strict=True)]
        return table | {"axis": [0.2, 1.0, 0.3], "profile_mm": profile, "caps": True, "smooth": normals == "smooth"}
    x = np.linspace(-1.0, 1.0, int(rng.integers(9, 40)))
    place = np.stack(np.meshgrid(x, x), axis=-1)
    heights = np.cos(place @ waves[:, :2].T + phases).sum(axis=-1)
    slope = float(np.hypot(*np.gradient(heights, x, x)).max())
    np.save(out / "heights.npy", heights * math.tan(math.radians(float(rng.uniform(20.0, 50.0)))) / slope)
    size = {"size_mm": [1.8 * radius, 1.8 * radius], "height_mm": 0.9 * radius}
    return table | size | {"file": "heights.npy", "normals": normals}


def _light(kind: str, toward: Floats, far: float, even: Callable[[float, float], float]) -> TomlTable:
    """A light of one kind, as a scene file has it."""
    if kind == "directional":
        return {"kind": kind, "toward": toward.tolist(), "irradiance": 1.0}
    place = (far * toward).tolist()
    if kind == "point":
        return {"kind": kind, "position_mm": place, "intensity": far**2}
    size = far * math.tan(math.radians(even(0.2, 1.5)))
    light = {"kind": kind, "center_mm": place, "normal": (-toward).tolist(), "radius_mm": size, "samples": 16}
    return light | {"radiance": (far / size) ** 2 / math.pi}


def scenes(rng: np.random.Generator, what: SampleDescription, shape: str, out: Path) -> tuple[TomlTable, TomlTable]:
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
    light = _light(kind, toward, far, even)
    camera = {
        "position_mm": [0.0, 0.0, distance],
        "vertical_field_deg": 2.0 * math.degrees(math.asin(radius / distance)) * even(1.1, 1.5),
        "width": PIXELS,
        "height": PIXELS,
        "samples": int(rng.choice([1, 36])),  # fewer rays an area would add noise of their own
    }
    described: TomlTable = {
        "name": what.name,
        "wavelength_nm": [WAVELENGTH_NM],
        "camera": camera,
        "shape": [shaped(shape, rng, radius, out)],
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
    body = described["shape"][0] | {"center_mm": normal(u["center_mm"]).tolist()}
    wider = float(normal(u["radius_mm"], 1)[0])
    if "radius_mm" in body:
        body["radius_mm"] += wider
    else:
        del u["radius_mm"]
    own = {"sample": {"model": what.model, "parameters": what.parameters}}
    real = described | {"shape": [body], "light": [truly], "material": own, "seed": int(rng.integers(1 << 31))}
    described["photograph"] = {"uncertainty": u}
    return described, real


def photograph(out: Path, rng: np.random.Generator, what: SampleDescription, shape: str) -> Any:
    """The table of a photograph that was taken with errors, and reduced without knowing them."""
    described, real = scenes(rng, what, shape, out)
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


def case(
    folder: Path, seed: int, number: int, shape: str = "sphere", *, alone: bool = False
) -> tuple[dict[str, FitResult], dict[str, float], Any]:
    """The fits of one case ("both" tables, each alone), its true parameters, and the photograph's table."""
    rng = np.random.default_rng([seed, number])
    what, truth, index = sample(rng, KINDS[number % len(KINDS)])
    out = folder / f"{shape}-{seed}-{number}"
    out.mkdir(parents=True, exist_ok=True)
    taken = photograph(out, rng, what, shape)
    measurement.write(taken, out / "photograph.csv")
    tables = {} if alone else {"sweep": sweep(out / "sweep", what, 1000 * seed + number)}
    tables["photo"] = taken
    parts = {name: observations(table, name) for name, table in tables.items()}
    each = parts if alone else {"both": together(parts), **parts}
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
    arguments.add_argument("--shape", choices=SHAPES, default="sphere")
    arguments.add_argument("--alone", action="store_true", help="no sweep beside the photograph")
    options = arguments.parse_args()
    every: dict[str, list[tuple[str, float]]] = {}
    ratios: dict[str, list[float]] = {}
    for number in range(options.first, options.first + options.count):
        try:
            results, truth, taken = case(options.out, options.seed, number, options.shape, alone=options.alone)
        except GonioError as error:
            print(f"{number:3d} refused: {error}", flush=True)
            continue
        kind = KINDS[number % len(KINDS)]
        found = {name: pulls(result, truth) for name, result in results.items()}
        for name, z in found.items():
            every.setdefault(name, []).extend((f"{kind} {p}", value) for p, value in z.items())
            ratios.setdefault(name, []).append(results[name].reduced_chi_square or math.nan)
        shown = "; ".join(
            f"{name}: chi2/n {ratios[name][-1]:.3f}, " + ", ".join(f"{p} {v:+.2f}" for p, v in z.items())
            for name, z in found.items()
        )
        print(f"{number:3d} {kind:14s} {int((taken['flag'] == '').sum()):5d} rows; {shown}", flush=True)
    for name, values in every.items():
        drawn = np.array([v for _, v in values])
        print(
            f"{name}: {drawn.size} pulls, sd {drawn.std(ddof=1):.3f}, root mean square "
            f"{np.sqrt(np.mean(drawn**2)):.3f}, mean {drawn.mean():+.3f}, "
            f"{100 * np.mean(abs(drawn) <= LEVEL):.1f} % of the 95 % intervals cover the truth, largest "
            f"{abs(drawn).max():.2f}; chi2/n {np.mean(ratios[name]):.3f}"
        )
    first = next(iter(every), "")
    for parameter in dict.fromkeys(p for p, _ in every.get(first, [])):
        drawn = np.array([v for p, v in every[first] if p == parameter])
        inside = np.count_nonzero(abs(drawn) <= LEVEL)
        print(f"  {parameter}: {inside} of {drawn.size}, root mean square {np.sqrt(np.mean(drawn**2)):.2f}")


if __name__ == "__main__":
    main()
