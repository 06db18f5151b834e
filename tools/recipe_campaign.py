"""The tour's calibration, on benches with fresh hidden truths: is what it finds true, and a run after it?

    python tools/recipe_campaign.py --setups 6 --seed 1

Every bench is `sim-uncalibrated` with limits of 95 or 120 deg and another truth: zeros up to 2 deg off, harmonics,
tilted axes, a tilted holder, a gain that is 15 % off, another black level. Every other rig file claims zeros to 0.02
deg, which is false. The four commands are run as docs/tour.md has them, then the white is measured as a sample.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np
from gonio_sim.rig import SIM_UNCALIBRATED

from gonio.config import numbers_in, read_toml, to_toml
from gonio.documents import TomlTable
from gonio.measurement import read

PLAN = """name = "the white, as a sample"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [0, 30, 60]
theta_r_deg = { start = -70, stop = 70, step = 10 }
"""
WHITE = 'name = "white"\nmodel = "lambert"\n[parameters]\nalbedo = 0.99\n'


def hidden(rng: np.random.Generator) -> TomlTable:
    """A truth file."""
    arms: TomlTable = {}
    for arm in ("light", "camera"):
        phases, sizes = rng.uniform(0.0, math.tau, 2), rng.uniform(0.0, (0.15, 0.08))
        arms[arm] = {
            "zero_offset_deg": float(rng.uniform(-2, 2)),
            "harmonics_deg": [[k + 1, float(a * math.cos(p)), float(a * math.sin(p))]
                              for k, (a, p) in enumerate(zip(sizes, phases, strict=True))],
            "axis_tilt_deg": [float(rng.normal(0, 0.2)) if arm == "light" else 0.0, float(rng.normal(0, 0.2))],
            "elevation_deg": float(rng.normal(0, 0.15)),
        }  # fmt: skip
    return {
        "arms": arms,
        "holder": {
            "tilt_zero_offset_deg": float(rng.uniform(-2, 2)), "spin_zero_offset_deg": float(rng.uniform(-2, 2)),
            "surface_tilt_deg": rng.normal(0, 0.3, 2).tolist(), "surface_offset_mm": float(rng.normal(0, 0.2)),
        },
        "camera": {
            "electrons_per_dn": 2.7 * float(rng.choice([0.85, 1.15])), "black_level_dn": float(rng.uniform(45, 95)),
            "read_noise_e": float(rng.uniform(2.0, 4.5)), "nonlinearity": [float(rng.uniform(-0.012, 0.004))],
            "stray_light": float(rng.uniform(0.0, 0.02)), "roll_deg": float(rng.normal(0, 0.5)),
            "pointing_deg": rng.normal(0, 0.15, 2).tolist(),
        },
        "lamp": {
            "noise": float(rng.uniform(0.002, 0.006)), "drift_per_hour": float(rng.uniform(-0.01, 0.01)),
            "warm_up_loss": float(rng.uniform(0.02, 0.08)), "warm_up_time_constant_s": float(rng.uniform(200, 600)),
            "beam": {"xx_per_mm2": float(rng.uniform(-3e-4, 0)), "yy_per_mm2": float(rng.uniform(-3e-4, 0))},
        },
    }  # fmt: skip


def rig_of(limit_deg: float, claim_deg: float) -> TomlTable:
    """The rig file."""
    tables = tomllib.loads(SIM_UNCALIBRATED.toml) | {"truth": "truth.toml"}
    for arm in ("light", "camera"):
        tables["arms"][arm] |= {"limits_deg": [-limit_deg, limit_deg], "zero_u_deg": claim_deg}
    tables["holder"]["zero_u_deg"] = claim_deg
    return tables


def follow(folder: Path, tables: TomlTable, seed: int) -> str:
    """The recipe; what was said, and an end with an error where there was one."""
    said = ""

    def run(*words: str) -> bool:
        nonlocal said
        command = [sys.executable, "-c", "from gonio.cli import main; main()", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False,
                              stdin=subprocess.DEVNULL, env=os.environ | {"COLUMNS": "100000"})  # fmt: skip
        said += done.stdout + done.stderr
        if done.returncode:
            print("  FAILED", " ".join(words), "\n  ", done.stderr[-600:], flush=True)
        return done.returncode == 0

    files: list[str] = []
    rig = ("--rig", "my-rig.toml", "--seed", str(seed))
    for kind in ("geometry", "camera", "light"):
        (folder / "my-rig.toml").write_text(to_toml(tables | ({"calibration": {"files": files}} if files else {})))
        if not run("calibrate", kind, *rig, "--out", f"{kind}.toml"):
            return said
        files.append(f"{kind}.toml")
    (folder / "my-rig.toml").write_text(to_toml(tables | {"calibration": {"files": files}}))
    if run("measure", "plan.toml", *rig, "--sample", "white.toml", "--out", "white", "--yes"):
        run("reduce", "white")
    return said


def pulls_of(folder: Path, truth: TomlTable, filed: TomlTable) -> dict[str, float]:
    """(found - true) / u by path."""
    out = {}
    for kind in ("geometry", "camera", "light"):
        if not (folder / f"{kind}.toml").exists():
            continue
        file = read_toml(folder / f"{kind}.toml")
        values = numbers_in(file["values"])
        for path, u in zip(file["uncertainty"]["parameters"], file["uncertainty"]["u"], strict=True):
            true = numbers_in(truth).get(path, numbers_in(filed).get(path, 0.0))
            if path == "camera.full_well_e":  # or what the converter holds
                camera = truth["camera"]
                true = min(true, (4095.0 - camera["black_level_dn"]) * camera["electrons_per_dn"])
            out[path] = (values[path] - true) / u
    return out


def main() -> None:
    """Run the benches one after the other, and print a line or two for each."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--setups", type=int, default=6)
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--seed", type=int, default=1)
    asked = arguments.parse_args()
    together: dict[str, list[float]] = {}
    whites = []
    for number in range(asked.first, asked.first + asked.setups):
        truth = hidden(np.random.default_rng([asked.seed, number]))
        limit, claim = (95.0, 120.0)[number % 2], (0.02, 1.0)[number // 2 % 2]
        tables, began = rig_of(limit, claim), time.process_time()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for file, text in (("truth.toml", to_toml(truth)), ("plan.toml", PLAN), ("white.toml", WHITE)):
                (folder / file).write_text(text)
            said = follow(folder, tables, seed=1000 * asked.seed + number)
            pulls = pulls_of(folder, truth, tables)
            for path, pull in pulls.items():
                together.setdefault(path, []).append(pull)
            white = "no white"
            if (folder / "white" / "brdf.csv").exists():
                table = read(folder / "white" / "brdf.csv")
                z = ((table["brdf"] - 0.99 / math.pi) / table["u_brdf"])[table["flag"] == ""].to_numpy()
                whites.append(z)
                white = f"white: {len(z)} values, rms pull {np.sqrt(np.mean(z**2)):.2f}, largest {np.abs(z).max():.1f}"
        far = {path: round(pull, 1) for path, pull in pulls.items() if abs(pull) > 3.0}
        quick = re.search(r"a DN is \S+ electrons", said)
        print(
            f"{number:3d} limits {limit:g}, claim {claim:g} deg, gain {truth['camera']['electrons_per_dn']:.3f} "
            f"(quick look: {quick[0] if quick else 'nothing'}): {len(pulls)} numbers, rms pull "
            f"{np.sqrt(np.mean(np.square(list(pulls.values())))):.2f}; beyond 3 u: {far}; "
            f"{said.count('They contradict each other')} contradictions said; {white}; "
            f"{time.process_time() - began:.0f} s",
            flush=True,
        )
    for path, list_ in sorted(together.items()):
        print(f"{path:36s} rms pull {np.sqrt(np.mean(np.square(list_))):6.2f} in {len(list_)}")
    every = np.concatenate([np.array(p) for path, p in together.items() if path != "camera.prnu"])
    print(f"all but camera.prnu: rms {np.sqrt(np.mean(every**2)):.3f} of {len(every)}; beyond 3 u: "
          f"{np.mean(np.abs(every) > 3):.4f}")  # fmt: skip
    if whites:
        z = np.concatenate(whites)
        print(f"white: rms {np.sqrt(np.mean(z**2)):.2f} of {len(z)}, beyond 3 u: {np.mean(np.abs(z) > 3):.4f}")


if __name__ == "__main__":
    main()
