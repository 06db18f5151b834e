"""Does `gonio rig align` find zeros that it cannot know? Random hidden set-ups of the simulated rig, and the verdict.

    python tools/alignment_campaign.py --setups 40 --seed 1

Every set-up hides the zeros of light, camera and tilt, and draws backlash, encoder step, encoder nonlinearity, sizes of
lamp and lens, lamp noise and vignetting. What comes out is compared with the zeros that were drawn.
"""

from __future__ import annotations

import argparse
import math
import time
import tomllib

import numpy as np
from gonio_sim.arms import Mechanism
from gonio_sim.rig import SIM, SimulatedRig
from scipy.stats import binomtest

from gonio.by_hand import alignment
from gonio.by_hand.alignment_scans import Scans
from gonio.by_hand.manual_rig import ManualRig
from gonio.config import parse
from gonio.rig.description import RigDescription

plain_reading = Mechanism.reading.fget  # type: ignore[attr-defined]


def reading(self: Mechanism) -> float:
    """What the encoder shows, with the first two harmonics of its error."""
    shown = float(plain_reading(self))
    return shown + sum(
        a * math.sin(n * shown + phase) for n, (a, phase) in enumerate(getattr(self, "harmonics", ()), 1)
    )


def hidden(rng: np.random.Generator) -> tuple[RigDescription, dict[str, float]]:
    """A rig file whose zeros nobody knows, and the zeros [deg]."""
    tables = tomllib.loads(SIM.toml)
    tables["camera"] |= {"width": 160, "height": 120, "pixel_um": 20.0, "vignetting": float(rng.uniform(0, 0.3)),
                         "lens_half_angle_deg": float(rng.uniform(0.2, 0.8))}  # fmt: skip
    tables["lamp"] |= {"half_angle_deg": float(rng.uniform(0.2, 0.8)), "noise": float(rng.uniform(0.001, 0.015))}
    zeros = {}
    common = {"encoder_step_deg": float(rng.choice([0.044, 0.088])), "backlash_deg": float(rng.uniform(0, 0.25)),
              "zero_offset_known": False, "zero_u_deg": 0.0}  # fmt: skip
    for name in ("light", "camera"):
        zeros[name] = float(rng.uniform(-2, 2))
        tables["arms"][name] |= common | {"zero_offset_deg": zeros[name]}
    zeros["tilt"] = float(rng.uniform(-1, 1))
    tables["holder"] |= common | {"tilt_zero_offset_deg": zeros["tilt"]}
    tables["arms"]["light"]["limits_deg"], tables["arms"]["camera"]["limits_deg"] = [-95.0, 95.0], [-95.0, 95.0]
    return parse(RigDescription, tables, "hidden"), zeros


def main() -> None:
    """Run the set-ups one after the other, and print a row for each."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--setups", type=int, default=40)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--nonlinear-deg", type=float, default=0.05, help="largest amplitude of a harmonic")
    asked = arguments.parse_args()
    Mechanism.reading = property(reading)  # type: ignore[method-assign, assignment]
    within = {1: 0, 2: 0}
    ratios: list[float] = []
    failed = 0
    for number in range(asked.setups):
        rng = np.random.default_rng([asked.seed, number])
        description, zeros = hidden(rng)
        rig = SimulatedRig(description, None, number, confirm=False)
        for mechanism in rig.arms._axes.values():
            mechanism.harmonics = [(math.radians(rng.uniform(0, asked.nonlinear_deg) / n), rng.uniform(0, math.tau))
                                   for n in (1, 2)]  # type: ignore[attr-defined]  # fmt: skip
        began, scans = time.monotonic(), None
        try:
            with ManualRig(rig, "hidden") as manual:
                scans = Scans(manual, search_deg=6.0, say=lambda text: None)
                rig.put("mirror")
                scans.mirror()
                rig.put("empty")
                scans.straight_through()
        except Exception as error:
            failed += 1
            print(f"{number:3d} FAILED {type(error).__name__}: {error}", flush=True)
            continue
        found = alignment.align(scans.table, description).zeros
        off = {name: (zero.offset_deg - zeros[name]) / zero.u_deg for name, zero in found.items()}
        worst = max(abs(r) for r in off.values())
        ratios += off.values()
        for k in within:
            within[k] += worst <= k
        said = ", ".join(f"{n} {found[n].offset_deg - zeros[n]:+.3f} (u {found[n].u_deg:.3f})" for n in found)
        print(f"{number:3d} {said}  worst {worst:.2f} u, {time.monotonic() - began:.0f} s", flush=True)
    print(f"{failed} of {asked.setups} failed; rms of error / u {np.sqrt(np.mean(np.square(ratios))):.2f}")
    for k, count in within.items():
        low, high = binomtest(count, asked.setups).proportion_ci(0.95)
        print(f"all zeros within {k} u: {count} of {asked.setups} (95 % interval {low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
