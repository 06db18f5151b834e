"""Does `gonio calibrate geometry` find what it cannot know? Random hidden errors of the simulated rig, and the verdict.

    python tools/geometry_campaign.py --setups 40 --seed 1

Every set-up hides zeros of several degrees, harmonics of both encoders, tilted and displaced axes, elevations, a
surface off the crossing and not normal to the spin, and a camera that is rolled and points aside. What comes out is
compared with what was drawn, number by number; and, since a zero and a cosine look alike over the range of an arm, the
whole error of each arm over the range that was measured.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from gonio_sim.rig import SIM, SimulatedRig

from gonio.by_hand.manual_rig import ManualRig
from gonio.calibration import geometry
from gonio.calibration.geometry_scans import GeometryScans, reversed_approach
from gonio.config import parse, to_toml
from gonio.documents import TomlTable
from gonio.rig import Step
from gonio.rig.description import RigDescription

RANGE_DEG = 70.0


def rig_tables(limit_deg: float = 95.0) -> TomlTable:
    """The rig file that everybody knows: `sim` with printed markers, a wider view and arms that can face each other."""
    tables = tomllib.loads(SIM.toml)
    tables["camera"] |= {"width": 400, "height": 300, "pixel_um": 8.0, "focal_length_mm": 50.0}
    tables["holder"] |= {"fiducials": {}}
    for arm in ("light", "camera"):
        tables["arms"][arm] |= {"limits_deg": [-limit_deg, limit_deg], "zero_offset_deg": 0.0, "zero_u_deg": 0.0}
    tables["holder"] |= {"zero_offset_deg": 0.0, "zero_u_deg": 0.0}
    return tables


def hidden(rng: np.random.Generator) -> TomlTable:
    """A truth file: keys of the rig file with what is true."""
    tables: TomlTable = {"arms": {}, "holder": {}, "camera": {}, "geometry": {}}
    for arm in ("light", "camera"):
        phases = rng.uniform(0.0, math.tau, 2)
        sizes = rng.uniform(0.0, (0.4, 0.2))
        tables["arms"][arm] = {
            "zero_offset_deg": float(rng.uniform(-4, 4)),
            "harmonics_deg": [[k + 1, float(a * math.cos(p)), float(a * math.sin(p))]
                              for k, (a, p) in enumerate(zip(sizes, phases, strict=True))],
            "axis_tilt_deg": [float(rng.normal(0, 0.3)) if arm == "light" else 0.0, float(rng.normal(0, 0.3))],
            "axis_offset_mm": [0.0, 0.0] if arm == "light" else rng.normal(0, 0.3, 2).tolist(),
            "elevation_deg": float(rng.normal(0, 0.3)),
            "backlash_deg": float(rng.uniform(0.0, 0.25)),
        }  # fmt: skip
    tables["holder"] = {
        "tilt_zero_offset_deg": float(rng.uniform(-1, 1)), "spin_zero_offset_deg": float(rng.uniform(-2, 2)),
        "surface_offset_mm": float(rng.normal(0, 0.3)), "surface_tilt_deg": rng.normal(0, 0.2, 2).tolist(),
        "sample_offset_mm": rng.normal(0, 0.3, 2).tolist(), "spin_axis_tilt_deg": float(rng.normal(0, 0.2)),
        "tilt_axis_offset_mm": float(rng.normal(0, 0.3)),
    }  # fmt: skip
    tables["camera"] = {"roll_deg": float(rng.normal(0, 0.5)), "pointing_deg": rng.normal(0, 0.2, 2).tolist()}
    tables["geometry"] = {n: float(1000.0 + rng.normal(0, 5)) for n in ("light_distance_mm", "camera_distance_mm")}
    return tables


def measured(description: RigDescription, seed: int, *, poses: tuple[int, int, int, int]) -> list[geometry.Sighting]:
    """All sightings of one calibration: mirror, straight through, markers, against the approach."""
    out: list[geometry.Sighting] = []

    def keep(sighting: geometry.Sighting, frames: object) -> None:
        out.append(sighting)

    rig = SimulatedRig(description, None, seed, confirm=False)
    with ManualRig(rig, "hidden") as manual:
        scans = GeometryScans(manual, search_deg=8.0, say=lambda text: None, keep=keep)
        rig.put("mirror")
        scans.mirror_frames(poses[0])
        sums, across = scans.where
        scans.marker_frames(poses[2])
        rig.put("empty")
        scans.straight_frames(poses[1])
    rig = SimulatedRig(reversed_approach(description), None, seed, confirm=False)
    with ManualRig(rig, "hidden") as manual:
        manual.begin(Step(1, "dark"))
        rig.put("mirror")
        scans = GeometryScans(manual, search_deg=8.0, say=lambda text: None, keep=keep)
        scans.against_frames(sums, across, poses[3])
    return out


def _kinds(sightings: list[geometry.Sighting]) -> str:
    """How many of each kind."""
    lamp = [s for s in sightings if s.spot_px is not None]
    mirror, straight = (sum(s.holder == holder for s in lamp) for holder in ("mirror", "empty"))
    return f"{mirror} mirror, {straight} straight, {sum(bool(s.corners) for s in sightings)} with markers"


def error_of(axis: Any, read_deg: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Zero and harmonics of an arm [deg], where its encoder reads."""
    turn = np.radians(read_deg - axis.zero_offset_deg)
    harmonics = sum(
        (c * np.cos(k * turn) + s * np.sin(k * turn) for k, c, s in axis.harmonics_deg), np.zeros(len(turn))
    )
    return np.asarray(axis.zero_offset_deg + harmonics)


def main() -> None:
    """Run the set-ups one after the other, and print a line for each."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--setups", type=int, default=20)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument(
        "--poses", type=int, nargs=4, default=(96, 40, 120, 24), help="mirror, straight, markers, against"
    )
    arguments.add_argument(
        "--limits", type=float, nargs="+", default=(95.0, 120.0), help="of both arms [deg], one set-up after the other"
    )
    asked = arguments.parse_args()
    found: dict[str, list[tuple[float, float]]] = {}
    curves: list[float] = []
    failed = 0
    for number in range(asked.setups):
        rng = np.random.default_rng([asked.seed, number])
        truth, limit = hidden(rng), asked.limits[number % len(asked.limits)]
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "truth.toml"
            file.write_text(to_toml(truth))
            description = parse(RigDescription, rig_tables(limit) | {"truth": str(file)}, "hidden")
            try:
                sightings = measured(description, number, poses=tuple(asked.poses))
                taken = time.monotonic() - began
                fit = geometry.solve(description, sightings)
            except Exception as error:
                failed += 1
                print(f"{number:3d} FAILED {type(error).__name__}: {error}", flush=True)
                continue
            from gonio_sim.world import truth_of

            true = truth_of(description)
        numbers = geometry._numbers(geometry.start_of(true), [u.path for u in fit.unknowns])
        for k, unknown in enumerate(fit.unknowns):
            u = math.sqrt(float(fit.covariance[k, k]))
            if fit.known[k]:
                found.setdefault(unknown.path, []).append((float(fit.values[k] - numbers[k]), u))
        read = np.linspace(-RANGE_DEG, RANGE_DEG, 101)
        off = [error_of(getattr(fit.description.arms, arm), read) - error_of(getattr(true.arms, arm), read)
               for arm in ("light", "camera")]  # fmt: skip
        curves += [math.sqrt(float(np.mean(o**2))) for o in off]
        print(
            f"{number:3d} {_kinds(sightings)} in {taken:.0f} s, fit in {time.monotonic() - began - taken:.0f} s; "
            f"misfit {fit.misfit:.2f}, {len(fit.dropped)} dropped; limits +-{limit:g} deg, "
            f"arms off by {curves[-2]:.4f} and {curves[-1]:.4f} deg rms; {'; '.join(fit.open)}",
            flush=True,
        )
    print(f"{failed} of {asked.setups} failed")
    if curves:
        _summarise(found, curves)


def _summarise(found: dict[str, list[tuple[float, float]]], curves: list[float]) -> None:
    print(f"zero and harmonics of an arm over +-{RANGE_DEG:g} deg: {np.median(curves):.4f} deg rms (median), "
          f"{np.max(curves):.4f} (largest)")  # fmt: skip
    pulls = []
    for path, pairs in found.items():
        off_by, u = np.array(pairs).T
        pulls.append(off_by / u)
        print(
            f"{path:36s} error {np.sqrt(np.mean(off_by**2)):8.4f} rms   u {np.mean(u):8.4f}   "
            f"pull {np.sqrt(np.mean((off_by / u) ** 2)):5.2f}   known in {len(pairs)}"
        )
    together = np.concatenate(pulls)
    print(f"all pulls: {np.sqrt(np.mean(together**2)):.3f} rms of {len(together)}; "
          f"within 2 u: {np.mean(np.abs(together) < 2):.3f}")  # fmt: skip


if __name__ == "__main__":
    main()
