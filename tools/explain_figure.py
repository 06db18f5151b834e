"""Draws docs/measurement_explained.svg: the directions at a sample, and the signed angle in the plane of incidence.

python tools/explain_figure.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("svg")
OUT = Path(__file__).resolve().parents[1] / "docs" / "measurement_explained.svg"
LIGHT, VIEW, AID = "#c25b00", "#1f5fa8", "#777777"
THETA_I, PHI_I, THETA_R, PHI_R = np.radians([40.0, 200.0, 55.0, 300.0])


def along(theta: float, phi: float) -> np.ndarray:
    """A unit vector that leaves the surface."""
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def flat(points: Any) -> np.ndarray:
    """Points (..., 3) on the paper, by a parallel projection: x to the lower left, y to the lower right, z up."""
    turn, lift = np.radians(55.0), np.radians(22.0)
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    right = -np.sin(turn) * x + np.cos(turn) * y
    toward = np.cos(turn) * x + np.sin(turn) * y
    return np.stack([right, z * np.cos(lift) - toward * np.sin(lift)], axis=-1)


def arrow(ax: Any, start: Any, end: Any, colour: str, width: float = 1.8) -> None:
    ax.annotate(
        "",
        xy=end,
        xytext=start,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0},
    )


def arc(ax: Any, points: Any, colour: str) -> np.ndarray:
    shown = flat(points)
    ax.plot(*shown.T, color=colour, lw=1.0)
    return shown[len(shown) // 2]


def in_space(ax: Any) -> None:
    """The sample with its axes, both directions, and the four angles."""
    turn = np.linspace(0, 2 * np.pi, 120)
    disc = flat(np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1))
    ax.fill(*disc.T, color="#ececec", ec="#bbbbbb")
    zero = flat(np.zeros(3))
    for vector, name in (((1.25, 0, 0), "x"), ((0, 1.2, 0), "y"), ((0, 0, 1.25), "z, the normal")):
        end = flat(np.array(vector))
        arrow(ax, zero, end, "black", 1.0)
        ax.annotate(name, end, xytext=(4, 2), textcoords="offset points")
    for theta, phi, colour, name, sign in (
        (THETA_I, PHI_I, LIGHT, "to the source  $\\omega_i$", "i"),
        (THETA_R, PHI_R, VIEW, "to the camera  $\\omega_r$", "r"),
    ):
        tip = along(theta, phi) * 1.15
        arrow(ax, zero, flat(tip), colour)
        ax.annotate(
            name,
            flat(tip),
            xytext=(0, 5),
            textcoords="offset points",
            color=colour,
            ha="left" if sign == "i" else "center",
        )
        foot = tip * [1, 1, 0]
        ax.plot(*flat(np.stack([tip, foot, np.zeros(3)])).T, color=colour, lw=0.8, ls=":")
        t = np.linspace(0, theta, 30)
        middle = arc(ax, [0.45 * along(v, phi) for v in t], colour)
        ax.annotate(
            f"$\\theta_{sign}$", middle, xytext=(-4 if sign == "i" else 3, 4), textcoords="offset points", color=colour
        )
        size = 0.5 if sign == "i" else 0.75
        p = np.linspace(0, phi, 60)
        place = arc(ax, [size * np.array([np.cos(v), np.sin(v), 0]) for v in p], colour)
        ax.annotate(f"$\\phi_{sign}$", place, xytext=(3, -10), textcoords="offset points", color=colour)
    ax.set_title("Four angles: two directions that leave the surface", fontsize=10)


def in_plane(ax: Any) -> None:
    """The plane of incidence with the sign of theta_r."""
    ax.plot([-1.15, 1.15], [0, 0], color="#999999", lw=3)
    arrow(ax, (0, 0), (0, 1.2), "black", 1.0)
    ax.annotate("normal", (0, 1.2), xytext=(4, -2), textcoords="offset points")
    for deg, colour, name, where in (
        (-40, LIGHT, "source, $\\theta_i$ = 40°", "right"),
        (40, AID, "mirror direction\n$\\theta_r$ = +40°, $\\Delta\\phi$ = 180°", "left"),
        (65, VIEW, "camera\n$\\theta_r$ = +65°, $\\Delta\\phi$ = 180°", "left"),
        (-65, VIEW, "camera\n$\\theta_r$ = −65°, $\\Delta\\phi$ = 0°", "right"),
    ):
        a = np.radians(deg)
        end = np.array([np.sin(a), np.cos(a)])
        arrow(ax, (0, 0), end, colour)
        ax.annotate(
            name,
            end,
            xytext=(5 if where == "left" else -5, 3),
            textcoords="offset points",
            ha=where,
            color=colour,
            fontsize=8.5,
        )
    for low, high, name in ((4, 86, "mirror side:\n$\\theta_r$ > 0"), (-86, -4, "retro side:\n$\\theta_r$ < 0")):
        t = np.radians(np.linspace(low, high, 40))
        ax.plot(0.33 * np.sin(t), 0.33 * np.cos(t), color=AID, lw=0.8)
        ax.text(0.62 * np.sign(high + low), -0.22, name, ha="center", color=AID, fontsize=8.5)
    ax.set_title("In the plane of incidence $\\theta_r$ has a sign", fontsize=10)


def main(out: Path = OUT) -> None:
    """Draw both."""
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "gonio"
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    in_space(left)
    in_plane(right)
    left.set(xlim=(-1.45, 1.55), ylim=(-0.75, 1.45))
    right.set(xlim=(-2.0, 2.0), ylim=(-0.6, 1.4))
    for ax in (left, right):
        ax.set_aspect("equal")
        ax.axis("off")
    figure.savefig(out, metadata={"Date": None} if out.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
