"""Draws docs/lab_setup/*.svg: a picture for each step of the set-up guide.

python tools/lab_pictures.py
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("svg")
from matplotlib.figure import Figure
from matplotlib.patches import Arc, FancyBboxPatch, Rectangle

OUT = Path(__file__).resolve().parents[1] / "docs" / "lab_setup"
LIGHT, VIEW, AID, BODY = "#c25b00", "#1f5fa8", "#777777", "#e9e6df"


def page(width: float = 6.4, height: float = 3.6) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.axis("off")
    return figure, ax


def box(ax: Any, x: float, y: float, w: float, h: float, text: str, colour: str = BODY) -> None:
    patch = FancyBboxPatch((x - w / 2, y - h / 2), w, h, boxstyle="round,pad=0.02", fc=colour, ec="0.3", lw=0.9)
    ax.add_patch(patch)
    ax.text(x, y, text, ha="center", va="center", fontsize=8)


def line(ax: Any, x: tuple[float, ...], y: tuple[float, ...], colour: str = "0.3", **how: Any) -> None:
    ax.plot(x, y, color=colour, lw=how.pop("lw", 1.4), zorder=0, **how)


def at(angle_deg: float, length: float = 1.0) -> np.ndarray:
    """Seen from above: 0 is the normal (up), positive angles go to the right, as in the rig file."""
    angle = np.radians(angle_deg)
    return length * np.array([np.sin(angle), np.cos(angle)])


def arm(ax: Any, angle: float, name: str, colour: str, length: float = 1.0) -> None:
    end = at(angle, length)
    ax.plot([0, end[0]], [0, end[1]], color="0.75", lw=6, solid_capstyle="round", zorder=0)
    ax.plot(*end, "s", ms=17, color=colour)
    place = at(angle, length + 0.26)
    ax.text(*place, name, ha="center", va="center", fontsize=9, color=colour)


def ray(ax: Any, start: Any, end: Any, colour: str) -> None:
    ax.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.5})


def swept(ax: Any, angle: float, half: float = 11.0, radius: float = 1.06) -> None:
    ax.add_patch(
        Arc((0, 0), 2 * radius, 2 * radius, theta1=90 - angle - half, theta2=90 - angle + half, color=VIEW, lw=1.6)
    )
    for side in (-half, half):
        ax.plot(*at(angle + side, radius), "|", color=VIEW)


def sample(ax: Any, colour: str = "0.25", text: str = "sample") -> None:
    ax.add_patch(Rectangle((-0.16, -0.05), 0.32, 0.05, color=colour))
    ax.text(0, -0.15, text, ha="center", va="top", fontsize=9)


def wiring() -> Figure:
    figure, ax = page(6.4, 3.1)
    box(ax, 0.6, 1.0, 1.0, 0.5, "computer")
    for y, text in ((1.8, "USB adapter\n(U2D2)"), (1.0, "lamp\ncontroller"), (0.2, "release box\nor camera")):
        line(ax, (1.1, 1.75), (1.0, y))
        box(ax, 2.3, y, 1.1, 0.5, text)
    for k, text in enumerate(("1\nlight", "2\ncamera", "3\ntilt", "4\nspin", "5\nchanger")):
        x = 3.6 + 0.75 * k
        line(ax, (x - 0.75 if k else 2.85, x - 0.2), (1.8, 1.8))
        box(ax, x, 1.8, 0.5, 0.5, text)
    box(ax, 4.0, 2.7, 1.2, 0.36, "12 V, 5 A supply", "#f6d9c6")
    line(ax, (3.4, 2.3, 2.3), (2.7, 2.7, 2.1), LIGHT)
    line(ax, (2.85, 3.6), (1.0, 1.0), LIGHT)
    box(ax, 4.0, 1.0, 0.8, 0.4, "lamp", "#f6d9c6")
    line(ax, (2.85, 3.6), (0.2, 0.2), VIEW)
    box(ax, 4.0, 0.2, 0.8, 0.4, "camera", "#cfdff0")
    ax.text(4.6, 1.4, "servos in one chain, each with its own id", fontsize=8, color=AID)
    ax.set(xlim=(0, 7.1), ylim=(-0.2, 3.0))
    return figure


def geometry() -> Figure:
    figure, ax = page(6.4, 3.9)
    arm(ax, 40, "lamp", LIGHT)
    arm(ax, -50, "camera", VIEW)
    sample(ax)
    line(ax, (0, 0), (0, 1.2), AID, ls="--", lw=1)
    ax.text(0, 1.25, "normal: 0 deg", ha="center", fontsize=9, color=AID)
    ax.text(1.35, 0.1, "positive angles:\ntoward x", fontsize=9, color=AID)
    ray(ax, (0.25, -0.02), (1.25, -0.02), AID)
    ax.add_patch(Arc((0, 0), 0.9, 0.9, theta1=50, theta2=90, color=LIGHT))
    ax.add_patch(Arc((0, 0), 0.7, 0.7, theta1=90, theta2=140, color=VIEW))
    ax.text(*at(20, 0.55), "light", ha="center", fontsize=9, color=LIGHT)
    ax.text(*at(-24, 0.46), "camera", ha="center", fontsize=9, color=VIEW)
    ax.text(*(at(62, 0.78)), "light_distance_mm", fontsize=8, color=LIGHT)
    ax.text(*(at(-76, 0.80)), "camera_distance_mm", fontsize=8, color=VIEW, ha="right")
    ax.text(
        0, -0.42, "both arms turn about one line that lies in the sample's surface", ha="center", fontsize=8, color=AID
    )
    ax.set(xlim=(-2.0, 2.3), ylim=(-0.5, 1.45))
    return figure


def surface() -> Figure:
    figure, ax = page(6.4, 2.3)
    for x, up, text in ((1.2, 0.0, "right: the axis lies in the surface"), (4.4, 0.28, "wrong: the spot wanders")):
        ax.add_patch(Rectangle((x - 0.8, up - 0.12), 1.6, 0.12, color="0.35"))
        ax.plot(x, 0, "o", ms=9, mfc="white", mec=LIGHT, mew=1.8)
        for angle in (-55, 55):
            end = np.array([x, 0]) + at(angle, 1.15)
            line(ax, (x, end[0]), (0, end[1]), VIEW, lw=1.0)
            hit = x + up * np.tan(np.radians(angle))
            ax.plot(hit, up, "v", color=VIEW, ms=6)
        ax.text(x, -0.5, text, ha="center", fontsize=9)
    ax.text(2.8, 0.75, "o: the axis\nof both arms", ha="center", fontsize=8, color=LIGHT)
    ax.set(xlim=(-0.1, 5.7), ylim=(-0.6, 0.95))
    return figure


def servo_ids() -> Figure:
    figure, ax = page(6.4, 2.0)
    for k, (text, note) in enumerate((("id 1", "one servo at a time:\ngive it its id"), ("id 2", "then the next"),
                                      ("1 - 2 - 3 - 4 - 5", "then all in one chain"))):  # fmt: skip
        x = 0.8 + 2.1 * k
        box(ax, x, 1.0, 1.4, 0.45, text)
        ax.text(x, 0.55, note, ha="center", va="top", fontsize=8, color=AID)
        if k:
            ray(ax, (x - 1.3, 1.0), (x - 0.85, 1.0), AID)
    ax.set(xlim=(0, 5.9), ylim=(0.1, 1.35))
    return figure


def mirror() -> Figure:
    figure, ax = page(6.4, 3.6)
    arm(ax, 30, "lamp at 30", LIGHT)
    arm(ax, -30, "camera scans about -30", VIEW)
    swept(ax, -30)
    sample(ax, "#4aa3c7", "front-surface mirror in the holder")
    ray(ax, at(30, 0.9), (0, 0.02), LIGHT)
    ray(ax, (0, 0.02), at(-30, 0.9), LIGHT)
    ax.text(1.25, 0.35, "gives the sum of the\nzeros of both arms", fontsize=9, color=AID)
    ax.set(xlim=(-2.0, 2.6), ylim=(-0.35, 1.35))
    return figure


def straight() -> Figure:
    figure, ax = page(6.4, 2.6)
    arm(ax, 90, "", LIGHT, 1.5)
    arm(ax, -90, "", VIEW, 1.5)
    ax.text(1.5, -0.25, "lamp at 90", ha="center", fontsize=9, color=LIGHT)
    ax.text(-1.5, -0.45, "camera scans about -90", ha="center", fontsize=9, color=VIEW)
    swept(ax, -90, 9.0, 1.58)
    ax.add_patch(Rectangle((-0.16, -0.10), 0.32, 0.05, fc="none", ec="0.4", ls=":"))
    ax.text(0, -0.2, "holder empty", ha="center", va="top", fontsize=9)
    ray(ax, (1.35, 0.0), (-1.3, 0.0), LIGHT)
    ax.text(0, 0.35, "gives their difference", ha="center", fontsize=9, color=AID)
    ax.set(xlim=(-2.3, 2.1), ylim=(-0.55, 0.65))
    return figure


def first_point() -> Figure:
    figure, ax = page(6.4, 1.7)
    steps = ("rig new", "rig check", "rig align", "measure", "reduce")
    files = ("my.toml", "", "aligned.toml", "RUN/", "RUN/brdf.csv")
    for k, (step, file) in enumerate(zip(steps, files, strict=True)):
        x = 0.6 + 1.35 * k
        box(ax, x, 1.0, 1.0, 0.4, f"gonio\n{step}")
        ax.text(x, 0.62, file, ha="center", va="top", fontsize=8, color=VIEW)
        if k:
            ray(ax, (x - 0.83, 1.0), (x - 0.54, 1.0), AID)
    ax.set(xlim=(0, 6.7), ylim=(0.35, 1.3))
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    "wiring": wiring, "geometry": geometry, "surface": surface, "servo_ids": servo_ids, "mirror": mirror,
    "straight": straight, "first_point": first_point,
}  # fmt: skip


def main() -> None:
    """Write all pictures."""
    matplotlib.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "gonio", "font.family": "sans-serif"}
    OUT.mkdir(exist_ok=True)
    for name, draw in PICTURES.items():
        figure = draw()
        figure.savefig(OUT / f"{name}.svg", metadata={"Date": None})
        print(OUT / f"{name}.svg")


if __name__ == "__main__":
    main()
