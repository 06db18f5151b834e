"""Reciprocity and reflectance of in-plane infrared scans, beside emissivities that were measured independently.

    .venv/bin/python tools/infrared_metals.py FOLDER

FOLDER holds `mwir_inplane_reflected_radiance.csv` and `mwir_emissivity_reference.csv`. For each sample it prints the
check of reciprocity that a report has, and the directional-hemispherical reflectance beside 1 - emissivity
(docs/measurements/infrared_metals.md).

Scans in one plane do not span a hemisphere. The integral assumes that the lobe is a figure of revolution about the
mirror direction (`revolved`), which is wrong for brushed metal.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from gonio import measurement
from gonio.checks.values import values_of
from gonio.checks.verdicts import of_values
from gonio.typing import Floats

ANGLES = (20, 30, 45, 60, 70)
"""Of the receiver [deg]: inside, where lobe and footprint are whole on either side of the mirror direction."""


CORE = np.radians(5.0)
"""Within it a lobe is the image of the source's disc (0.9 degrees), which is round in angle."""


def revolved(theta_i: Floats, brdf: Floats, theta_r: float) -> float:
    """Integral of f cos(theta_i) over the hemisphere of the source, of a scan in the plane at one theta_r [rad].

    By reciprocity it is the reflectance for light from theta_r. `theta_i` ascends, on the mirror side. Both sides of
    the mirror direction are averaged; where one ends, the other goes on alone. Within `CORE` the lobe is taken as a
    figure of revolution in angle, beyond it in direction cosines, as lobes of rough surfaces nearly are.
    """
    across, logs = np.sin(theta_i) - np.sin(theta_r), np.log(np.maximum(brdf, 1e-12))
    alpha = np.linspace(0.0, CORE, 501)
    core = np.exp([np.interp(theta_r + sign * alpha, theta_i, logs) for sign in (1.0, -1.0)]).mean(axis=0)
    inside = np.trapezoid(core * 2.0 * np.pi * np.sin(alpha), alpha) * np.cos(theta_r)
    # a disc of direction cosines with the core's area, which is an ellipse there
    first = np.sin(CORE) * np.sqrt(np.cos(theta_r))
    radius = np.linspace(first, 1.0 + np.sin(theta_r), 2001)
    sides = np.exp([np.interp(sign * radius, across, logs) for sign in (1.0, -1.0)])
    there = np.array([radius <= across[-1], radius <= -across[0]])
    there[1] |= ~there.any(axis=0)  # what lies farther off is on the retro side, where the value nearest to it goes on
    lobe = (sides * there).sum(axis=0) / there.sum(axis=0)
    beyond = (1.0 - np.sin(theta_r) ** 2 - radius**2) / (2.0 * np.sin(theta_r) * radius)
    ring = 2.0 * np.pi - 2.0 * np.arccos(np.clip(beyond, -1.0, 1.0))  # of it, what lies above the horizon
    return float(inside + np.trapezoid(lobe * radius * ring, radius))


def main(folder: Path) -> None:
    """Print both tables."""
    scans = folder / "mwir_inplane_reflected_radiance.csv"
    emissivity: dict[tuple[str, float], tuple[float, float]] = {}
    with open(folder / "mwir_emissivity_reference.csv", encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            mean, u = float(row["eps_mean"]), float(row["eps_std"])
            emissivity[row["sample_de"], float(row["theta_deg"])] = mean, u
    with open(scans, encoding="utf-8", newline="") as file:
        german = {row["sample_en"]: row["sample_de"] for row in csv.DictReader(file)}
    for name, table in measurement.tables(scans).items():
        (values,) = values_of(table).values()
        reciprocity = of_values(values)[0]
        print(f"{name}\n  reciprocity {reciprocity.verdict}: {reciprocity.figure}")
        if reciprocity.advice:
            print(f"    {reciprocity.advice}")
        for theta_deg in ANGLES:
            one = table[np.isclose(table["theta_r_deg"], theta_deg)].sort_values("theta_i_deg")
            rho = revolved(
                np.radians(one["theta_i_deg"].to_numpy()), one["brdf"].to_numpy(), float(np.radians(theta_deg))
            )
            mean, u = emissivity[german[name], float(theta_deg)]
            print(f"  {theta_deg} deg: reflectance {rho:.2f}, 1 - emissivity {1 - mean:.2f} ± {u:.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
