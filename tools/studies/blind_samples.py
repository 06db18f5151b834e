"""Blind samples: does the analysis name the family of a sample that it knows nothing about, with honest intervals?

    python -m tools.studies.blind_samples --seed 7 --count 20 --out DIR

Each sample is drawn at random (one of the six families or a sum of two, parameters over realistic ranges), measured on
the simulated rig with all its errors, reduced, and given to `gonio_analysis.selection.choice` without a word about
it. A sample counts as right where its family is named, or a simpler model whose difference from the truth lies below
the data's uncertainty everywhere (2.58 u: the 1 % level). Intervals are counted where the true family was named.

A folder that holds measured samples already is not measured again: only the choice is made anew.
"""

import argparse
import json
import math
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from gonio.typing import JsonObject

PLAN = """\
name = "blind sample: in plane, and out of it"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [10, 30, 50, 70]
theta_r_deg = { start = -80, stop = 80, step = 2.5 }
[[sweep]]
theta_i_deg = [30, 60]
theta_r_deg = [15, 30, 45, 60, 75]
dphi_deg = [30, 60, 90, 120, 150, 165]
"""
CLASSES = ("lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance", "sum")
METALS = (0.96 + 6.69j, 0.26 + 2.55j, 0.42 + 2.35j, 2.9 + 3.05j)  # about Al, Cu (red side), Au, Fe at 550 nm
LEVEL = 2.576
"""Standard uncertainties that a value exceeds in 1 % of the cases."""


def draw(rng: np.random.Generator) -> tuple[str, JsonObject]:
    """A random family and its parameters."""
    kind = str(rng.choice(CLASSES))
    if kind != "sum":
        return kind, _parameters(kind, rng)
    base = str(rng.choice(["lambert", "oren-nayar"]))
    gloss = str(rng.choice(["phong", "blinn", "cook-torrance", "he-torrance"]))
    share = float(rng.uniform(0.2, 0.7))
    own = _parameters(gloss, rng)
    own = {k: 0.0 if k in ("k_d", "diffuse_albedo") else v for k, v in own.items()}
    # the base's share goes into its albedo: Oren-Nayar's light between facets grows with its square, so that a weight
    # would be a parameter of its own
    below = _parameters(base, rng)
    below["albedo"] = round((1 - share) * below["albedo"], 4)
    return "sum", {base: below, gloss: {"weight": share, **own}}


def _parameters(kind: str, rng: np.random.Generator) -> JsonObject:
    def even(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    def log(low: float, high: float) -> float:
        return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")

    def index() -> list[float]:
        if rng.random() < 0.5:
            return [even(1.3, 2.2), 0.0]
        metal = METALS[int(rng.integers(len(METALS)))]
        return [metal.real, metal.imag]

    if kind == "lambert":
        return {"albedo": even(0.05, 0.95)}
    if kind == "oren-nayar":
        return {"albedo": even(0.1, 0.95), "sigma_deg": even(5, 40)}
    if kind == "phong":
        return {"k_d": even(0.05, 0.6), "k_s": log(0.05, 0.5), "exponent": log(4, 200)}
    if kind == "blinn":
        return {"k_d": even(0.05, 0.6), "k_s": log(0.05, 0.5), "c": log(0.08, 0.6), "ior": index()}
    if kind == "cook-torrance":
        s = even(0.1, 0.7)
        return {
            "s": s,
            "d": 1 - s,
            "slopes": [[log(0.1, 0.5), 1.0]],
            "diffuse_albedo": even(0.05, 0.8),
            "ior": index(),
        }
    sigma0, slope = log(0.05, 1.0), log(0.1, 0.5)
    return {
        "sigma0_um": sigma0,
        "tau_um": float(f"{2 * sigma0 / slope:.4g}"),
        "diffuse_albedo": even(0, 0.4),
        "ior": index(),
    }


def measured(folder: Path, seed: int) -> Path:
    """The table of one sample: drawn, measured and reduced, unless that was done before."""
    table = folder / "brdf.csv"
    if table.exists():
        return table
    from gonio import measurement
    from gonio.config import to_toml
    from gonio.lab.acquisition.measure import carry_out, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.reduction import brdf
    from gonio.samples.files import load_sample

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    kind, parameters = draw(np.random.default_rng([20, seed]))
    sample = {"name": f"blind {seed}", "model": kind, "parameters": parameters}
    (folder / "sample.toml").write_text(to_toml({"sample": sample}).replace("[sample]", "").replace("[sample.", "["))
    (folder / "plan.toml").write_text(PLAN)
    run = carry_out(
        load_plan(folder / "plan.toml"),
        find_rig("sim"),
        folder / "run",
        sample=load_sample(folder / "sample.toml"),
        seed=seed,
        yes=True,
    )
    measurement.write(brdf.reduce(run), table)
    shutil.rmtree(folder / "run")
    return table


def judged(folder: Path) -> JsonObject:
    """What the analysis says of a measured sample, beside the truth."""
    import tomllib

    from gonio_analysis.fitting.forward import apparent
    from gonio_analysis.fitting.observations import observations
    from gonio_analysis.result_records import as_json
    from gonio_analysis.selection.choice import candidates, choose

    from gonio import measurement, models

    data = observations(measurement.read(folder / "brdf.csv"))
    chosen = choose(data, candidates(["all"]))
    sample = tomllib.loads((folder / "sample.toml").read_text())
    kind, true = _family(sample["model"], sample["parameters"])
    truth = apparent(models.build(sample["model"], sample["parameters"]), data)
    out: JsonObject = {"sample": folder.name, "true": kind, "parameters": true, **as_json(chosen.summary())}
    whitened = (
        chosen.judged[0].fit.goal.residual(truth) if chosen.named is None else chosen.named.fit.goal.residual(truth)
    )
    out["reduced_chi_square_of_truth"] = float(whitened @ whitened) / len(data)
    named = chosen.named
    out["right"] = out["is_true"] = named is not None and named.candidate.model == kind
    out["covered"] = {}
    if named is None:
        return out
    far = np.abs(named.fit.predicted - truth) / data.u
    out["largest_difference_u"] = float(far.max())
    simpler = len(named.fit.free) <= len(true) + (0 if true.get("k", 1.0) else -1)
    out["right"] = out["right"] or (simpler and float(far.max()) < LEVEL)
    if out["is_true"]:
        out["covered"] = {n: i.holds(true[n]) for n, i in chosen.intervals.items()}
    return out


def _family(kind: str, parameters: JsonObject) -> tuple[str, dict[str, float]]:
    """Name and parameters of a truth as fits have them."""
    if kind != "sum":
        return kind, _flat(kind, parameters, 1.0)
    (base, below), (gloss, above) = parameters.items()
    level, weight = below.get("weight", 1.0), above["weight"]
    shine = _flat(gloss, above, weight)
    if base == "oren-nayar":
        shine = {n: v for n, v in shine.items() if n not in ("k_d", "diffuse_albedo")}
        shine |= {"albedo": level * below["albedo"], "sigma_deg": below["sigma_deg"]}
        return f"{base}+{gloss}", shine | ({"weight": weight} if gloss == "he-torrance" else {})
    if gloss == "he-torrance":
        del shine["diffuse_albedo"]
        return f"{base}+{gloss}", shine | {"albedo": level * below["albedo"], "weight": weight}
    if gloss == "cook-torrance":  # its own Lambertian part is d albedo with d = 1 - s
        return gloss, shine | {"diffuse_albedo": level * below["albedo"] / (1.0 - shine["s"])}
    return gloss, shine | {"k_d": level * below["albedo"]}


def _flat(kind: str, parameters: JsonObject, weight: float) -> dict[str, float]:
    out = {n: v for n, v in parameters.items() if n not in ("ior", "slopes", "d", "weight")}
    for level in ("s", "k_s"):
        if level in out:
            out[level] *= weight
    if "slopes" in parameters:
        out["m"] = parameters["slopes"][0][0]
    if "ior" in parameters:
        out["ior"], out["k"] = parameters["ior"]
    return out


def study(folder: Path, seed: int) -> JsonObject:
    """Measure and judge one sample."""
    measured(folder, seed)
    verdict = judged(folder)
    (folder / "choice.json").write_text(json.dumps(verdict, indent=1))
    return verdict


def main() -> None:
    parser = argparse.ArgumentParser(description="blind samples")
    parser.add_argument("--seed", type=int, default=1, help="of the first sample; the others count on from it")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    seeds = range(asked.seed, asked.seed + asked.count)
    verdicts = []
    with ProcessPoolExecutor(asked.jobs) as pool:
        for v in pool.map(study, [asked.out / f"{seed}" for seed in seeds], seeds):
            verdicts.append(v)
            missed = [n for n, held in v["covered"].items() if not held]
            print(
                f"{v['sample']}: {v['true']} -> {v['named']}; {'right' if v['right'] else 'WRONG'}; chi-square of the "
                f"truth {v['reduced_chi_square_of_truth']:.3f}; intervals {len(v['covered']) - len(missed)} of "
                f"{len(v['covered'])}{' without ' + ', '.join(missed) if missed else ''}",
                flush=True,
            )
    right = sum(v["right"] for v in verdicts)
    held = [h for v in verdicts for h in v["covered"].values()]
    print(f"right: {right} of {len(verdicts)} ({sum(v['is_true'] for v in verdicts)} by name)")
    print(f"95 % intervals that hold the truth: {sum(held)} of {len(held)}: {100 * np.mean(held):.1f} %")


if __name__ == "__main__":
    main()
