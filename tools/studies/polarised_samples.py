"""Blind polarised samples: is the truth of each state as far from a value as its uncertainty says?

    python -m tools.studies.polarised_samples --seed 1 --count 40 --out DIR

Each sample is drawn at random: facets of GGX or Cook and Torrance, or He-Torrance, of a dielectric or a metal, with or
without a diffuse part. It is measured on `sim` with coarse frames and all its errors, in s, p and at 45 degrees
crossed, in the plane of incidence and out of it, through polarisers with faults: extinction and azimuth that are known
and not quite, a transmittance, a throughput that changes with the azimuth; and with a lamp and a lens that polarise by
themselves. The truth of a value is the true model through the polarisers that the table states, in the row's
directions; a pull is (value - truth)/u.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from gonio.typing import JsonObject
from tools.studies.blind_samples import METALS

WORDS = ("s", "p", "da")
PLAN = """\
name = "polarised blind sample"
wavelength_nm = [550]
polarisation = ["s", "p", "da"]
[[sweep]]
theta_i_deg = [20, 55]
theta_r_deg = { start = -75, stop = 75, step = 7.5 }
[[sweep]]
theta_i_deg = [40]
theta_r_deg = [30, 60]
dphi_deg = [45, 100, 150]
"""


def draw(rng: np.random.Generator) -> tuple[str, JsonObject]:
    """A model and its parameters."""
    kind = str(rng.choice(["ggx", "cook-torrance", "he-torrance"]))
    metal = METALS[int(rng.integers(len(METALS)))]
    ior = [float(rng.uniform(1.3, 2.0)), 0.0] if rng.random() < 0.5 else [metal.real, metal.imag]
    diffuse = float(rng.uniform(0.05, 0.5)) if rng.random() < 0.7 else 0.0
    width = float(rng.uniform(0.15, 0.4))
    if kind == "ggx":
        return kind, {"alpha": width, "ior": ior, "diffuse_albedo": diffuse}
    if kind == "cook-torrance":
        s = float(rng.uniform(0.3, 0.7))
        return kind, {"s": s, "d": 1.0 - s, "slopes": [[width, 1.0]], "ior": ior, "diffuse_albedo": diffuse}
    sigma0 = float(rng.uniform(0.4, 1.0))  # rough enough to leave no spike, whose bound would be most of u
    return kind, {"sigma0_um": sigma0, "tau_um": 2.0 * sigma0 / width, "ior": ior, "diffuse_albedo": diffuse}


def faults(rng: np.random.Generator) -> JsonObject:
    """Keys of the rig file."""
    polarisers = {}
    for side in ("light", "receiver"):
        extinction = float(10.0 ** rng.uniform(-4.0, -2.0))
        polarisers[side] = {
            "empty": True, "extinction": extinction, "u_extinction": 0.2 * extinction,
            "azimuth_deg": float(rng.uniform(-3.0, 3.0)), "u_azimuth_deg": float(rng.uniform(0.05, 0.5)),
            "transmittance": float(rng.uniform(0.5, 0.95)), "u_transmittance": float(rng.uniform(0.0, 0.005)),
        }  # fmt: skip
    lamp = {"degree": float(rng.uniform(0.0, 0.05)), "azimuth_deg": float(rng.uniform(0.0, 180.0))}
    # behind an analyser alone: the bound on a lens where there is none is wider than its effect, on purpose
    return {"polarisers": polarisers, "lamp": {"polarisation": lamp}}


def pulls(folder: Path, seed: int) -> JsonObject:
    """Those of one sample: drawn, measured and reduced; by state, in plane and out of it, and chi-square."""
    from gonio_analysis.fitting.forward import apparent, by_model
    from gonio_analysis.fitting.observations import observations

    from gonio import models
    from gonio.config import to_toml
    from gonio.lab.acquisition.measure import carry_out, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.reduction import brdf
    from gonio.lab.rig.calibration_files import with_keys
    from gonio.samples.description import SampleDescription

    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([43, seed])
    kind, parameters = draw(rng)
    camera = {"width": 96, "height": 72, "pixel_um": 33.0}
    choice = find_rig("sim")
    rig = with_keys(choice.description, {"camera": camera, **faults(rng)}, "faults")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "sample.toml").write_text(to_toml({"name": f"blind {seed}", "model": kind, "parameters": parameters}))
    sample = SampleDescription(name=f"blind {seed}", model=kind, parameters=parameters)
    run = carry_out(
        load_plan(folder / "plan.toml"), type(choice)(choice.plugin, rig, "sim"), folder / f"run-{seed}",
        sample=sample, seed=seed, yes=True,
    )  # fmt: skip
    table = brdf.reduce(run)
    data = observations(table, polarised=True)
    model = models.build(kind, dict(parameters))
    truth = apparent(model, data)
    pull = (data.brdf - truth) / data.u
    off_plane = np.abs(np.sin(data.directions.dphi)) * np.sin(data.directions.theta_r) > 0.05
    out: JsonObject = {"seed": seed, "model": kind, "parameters": parameters}
    for word in WORDS:
        for name, there in (("in plane", ~off_plane), ("out of plane", off_plane)):
            out[f"{word}, {name}"] = pull[(data.states == word) & there].tolist()
    known = by_model(data, model, truth).covariance
    assert known is not None
    whole = np.diag(known.random**2) + known.common @ known.common.T
    out["chi_square"] = float((data.brdf - truth) @ np.linalg.solve(whole, data.brdf - truth)) / len(data)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="blind polarised samples")
    parser.add_argument("--seed", type=int, default=1, help="of the first sample; the others count on from it")
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    seeds = range(asked.seed, asked.seed + asked.count)
    with ProcessPoolExecutor(asked.jobs) as pool:
        found = list(pool.map(pulls, [asked.out / str(seed) for seed in seeds], seeds))
    (asked.out / "pulls.json").write_text(json.dumps(found, indent=1))
    print(summary(found))


def summary(found: list[JsonObject]) -> str:
    """Mean and standard deviation of the pulls, of all and by state."""
    states = [name for name in found[0] if name.startswith(tuple(f"{word}, " for word in WORDS))]
    lines = []
    for name in (*states, "all"):
        values = np.concatenate([one[key] for one in found for key in (states if name == "all" else [name])])
        lines.append(f"{name}: {values.size} values, mean {values.mean():+.3f}, standard deviation {values.std():.3f}")
    chi = [one["chi_square"] for one in found]
    return "\n".join([*lines, f"chi-square of the truth over n: {np.mean(chi):.3f}, {min(chi):.2f} to {max(chi):.2f}"])


if __name__ == "__main__":
    main()
