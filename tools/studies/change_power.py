"""How often `gonio compare A B --change` says "changed": where nothing changed, and where one thing did.

    python -m tools.studies.change_power --pairs 200 --nulls 1000

Pairs of tables are drawn: a gloss lobe over a matte base, 3 incidences in the plane, steps of 5 degrees, noise 0.5 %,
a reference of 0.3 %, zeros of both arms of 0.02 degrees. All is stated, and drawn anew for each table. B is measured in
the same directions as A, or half a step apart. A line a case says how many pairs were called changed.
"""

import argparse
import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from gonio_analysis.changes.point_by_point import change
from gonio_analysis.changes.sides import of_table

from gonio.typing import Floats

STEP = 5.0
NOISE, REFERENCE, ZERO = 0.005, 0.003, math.radians(0.02)


@dataclass(frozen=True)
class Case:
    """What B differs from A by."""

    words: str
    factor: float = 1.0
    theta_r: float = 0.0
    """By how much B's angle of the detector reads too large [rad]."""
    theta_i: float = 0.0
    noise: float = 1.0
    """B's noise, over what it states."""


NOTHING = Case("nothing")
CASES = (
    Case("a zero of theta_r, 0.1 degrees", theta_r=math.radians(0.1)),
    Case("a zero of theta_r, 0.2 degrees", theta_r=math.radians(0.2)),
    Case("a zero of theta_i, 0.2 degrees", theta_i=math.radians(0.2)),
    Case("a factor of 1.02", factor=1.02),
    Case("noise 1.25 times what is stated", noise=1.25),
    Case("noise 1.5 times what is stated", noise=1.5),
)


def true(theta_i: Floats, signed: Floats) -> Floats:
    """BRDF in the plane of incidence [1/sr]; the signed angle of the detector is positive on the mirror's side."""
    return np.asarray(0.1 + 0.6 * np.exp(-0.5 * ((signed - theta_i) / np.radians(12.0)) ** 2))


def table(rng: np.random.Generator, shift_deg: float, case: Case = NOTHING) -> pd.DataFrame:
    """A measurement."""
    grid = np.meshgrid([20.0, 40.0, 60.0], np.arange(-75.0, 75.1, STEP) + shift_deg, indexing="ij")
    theta_i, signed = (np.radians(a.ravel()) for a in grid)

    def read(of_i: float, of_r: float) -> Floats:
        turned = theta_i - of_i
        return np.asarray(true(turned, signed - of_r) * np.cos(turned) / np.cos(theta_i))

    off = rng.normal(0.0, ZERO, 2)
    value = read(case.theta_i + off[0], case.theta_r + off[1]) * case.factor * (1.0 + rng.normal(0.0, REFERENCE))
    value = value * (1.0 + case.noise * NOISE * rng.normal(size=value.size))
    model = read(0.0, 0.0)
    common = {
        "s_reference": REFERENCE * value,
        "s_theta_i_zero": 0.5 * (read(ZERO, 0.0) - read(-ZERO, 0.0)) * value / model,
        "s_theta_r_zero": 0.5 * (read(0.0, ZERO) - read(0.0, -ZERO)) * value / model,
    }
    total = np.sqrt((NOISE * value) ** 2 + sum(column**2 for column in common.values()))
    angles = {"theta_i_deg": np.degrees(theta_i), "theta_r_deg": np.degrees(np.abs(signed)), "phi_i_deg": 0.0}
    found = pd.DataFrame(angles | {"phi_r_deg": np.where(signed > 0, 180.0, 0.0), "wavelength_nm": 550.0})
    found = found.assign(polarisation="unpolarised", brdf=value, u_brdf=total, u_random=NOISE * value, flag="")
    found.attrs.update(source_solid_angle_sr=0.0, receiver_solid_angle_sr=0.0)
    return found.assign(**common)


def changed(case: Case, pairs: int, apart: bool, seed: int) -> int:
    """How many of some pairs are called changed."""
    rng, found = np.random.default_rng(seed), 0
    for _ in range(pairs):
        a, b = table(rng, 0.0), table(rng, 0.5 * STEP if apart else 0.0, case)
        verdict = change(of_table("A", "A", a), of_table("B", "B", b)).verdict
        assert verdict is not None
        found += verdict.changed
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=200, help="of each case")
    parser.add_argument("--nulls", type=int, default=1000, help="pairs in which nothing changed")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    for case in (NOTHING, *CASES):
        pairs = asked.nulls if case is NOTHING else asked.pairs
        same, apart = (changed(case, pairs, half, asked.seed) for half in (False, True))
        print(f"{case.words}: same directions {same} of {pairs}, half a step apart {apart} of {pairs}", flush=True)


if __name__ == "__main__":
    main()
