"""Draws docs/planning.svg: where the detector stands in the kinds of grids that a plan can name.

python tools/planning_figure.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("svg")
OUT = Path(__file__).resolve().parents[1] / "docs" / "planning.svg"
LIGHT, VIEW, MIRROR = "#c25b00", "#1f5fa8", "#222222"
THETA_I = 40.0


def rows(table: Any) -> np.ndarray:
    """theta_r and phi_r [deg] of its points."""
    from gonio.acquisition.plan import canonical

    points = [canonical(*row) for row in table.rows()]
    return np.array([[point.theta_r_deg, point.phi_r_deg] for point in points])


def kinds() -> dict[str, np.ndarray]:
    from gonio.acquisition.grids import HalfVector, Hemisphere
    from gonio.acquisition.sweeps import Sweep

    whole = {"start": -80.0, "stop": 80.0, "step": 5.0}
    plane = Sweep.model_validate({"theta_i_deg": [THETA_I], "theta_r_deg": whole})
    across = Sweep.model_validate({"theta_i_deg": [THETA_I], "theta_r_deg": whole, "dphi_deg": [60.0, 120.0]})
    even = Hemisphere.model_validate({"theta_i_deg": [THETA_I], "step_deg": 9.0, "theta_r_max_deg": 80.0})
    dense = HalfVector.model_validate(
        {
            "theta_i_deg": [THETA_I],
            "theta_h_deg": {"stop": 36.0, "count": 13, "spacing": "square"},
            "phi_h_deg": {"start": 0.0, "stop": 345.0, "step": 15.0},
        }
    )
    return {
        "sweeps, in the plane and out of it": np.concatenate([rows(plane), rows(across)]),
        "hemisphere: each has the same solid angle": rows(even),
        "half vectors: dense at the mirror direction": rows(dense),
    }


def main() -> None:
    import matplotlib.pyplot as plt

    plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "gonio", "font.size": 9})
    figure, axes = plt.subplots(1, 3, figsize=(10.2, 3.9), subplot_kw={"projection": "polar"})
    for ax, (name, points) in zip(axes, kinds().items(), strict=True):
        ax.set_title(f"{name}\n{len(points)} points", fontsize=9, pad=12)
        ax.plot(np.radians(points[:, 1]), points[:, 0], ".", ms=3.2, color=VIEW)
        ax.plot(0.0, THETA_I, "o", ms=8, color=LIGHT, label="light")
        ax.plot(np.pi, THETA_I, "o", ms=9, mfc="none", mec=MIRROR, label="mirror direction")
        ax.set_rlim(0, 90)
        ax.set_rticks([30, 60], ["30°", "60°"], color="#777777", fontsize=8)
        ax.set_rlabel_position(100)
        ax.set_thetagrids([0, 90, 180, 270])
        ax.grid(color="#dddddd")
        ax.spines["polar"].set_color("#999999")
    axes[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)
    figure.subplots_adjust(left=0.05, right=0.95, bottom=0.13, top=0.83, wspace=0.42)
    figure.savefig(OUT, metadata={"Date": None})


if __name__ == "__main__":
    main()
