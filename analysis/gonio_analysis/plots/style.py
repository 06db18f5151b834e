"""What plots share: colours, and the half disc of normalised polar plots."""

from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Line

INK, FAINT = "#222222", "#c9ced6"


def _half_disc(ax: Any, rim: float, label: str, *, retro_right: bool) -> None:
    from matplotlib.collections import LineCollection

    ax.axis("off")
    right = -1.14 * rim if retro_right else 1.14 * rim
    ax.set(aspect="equal", xlim=(-right, right), ylim=(-0.2 * rim, 1.13 * rim))
    turn = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ticks = _ticks(rim)
    inner = [t for t in ticks[1:] if abs(t - rim) > 1e-9 * rim]
    rays = np.radians(np.arange(-75.0, 76.0, 15.0))
    faint = [xy(turn, np.full(turn.size, t)) for t in inner] + [xy(np.full(2, r), np.array([0.0, rim])) for r in rays]
    edges = [xy(turn, np.full(turn.size, rim)), (np.array([-rim, rim]), np.zeros(2))]
    marks = [(np.full(2, x), np.array([0.0, -0.015 * rim])) for t in ticks for x in sorted({-t, t})]
    for lines, colour, width in ((faint, FAINT, 0.5), (edges, INK, 0.9), (marks, INK, 0.7)):
        paths = LineCollection([np.stack(line, axis=1) for line in lines], colors=colour, linewidths=width, zorder=1)
        ax.add_collection(paths, autolim=False)
        paths.set_clip_on(False)
    for degrees in range(-90, 91, 30):
        upright = degrees % 90 == 0
        (tx,), (ty,) = xy(np.radians([degrees]), np.array([rim * (1.075 if upright else 1.045)]))
        ha = "center" if upright else "left" if (degrees > 0) != retro_right else "right"
        ax.text(tx, ty, f"{degrees}°".replace("-", "−"), ha=ha, va="center", fontsize=7, color=INK)
    for t in ticks:
        for side in (-1, 1) if t else (1,):
            ax.text(side * t, -0.03 * rim, f"{t:.3g}", ha="center", va="top", fontsize=7, color=INK)
    sides = ("right", "left") if retro_right else ("left", "right")
    for x, words, ha in ((-rim, "retro side", sides[0]), (rim, "mirror side", sides[1])):
        ax.text(x, -0.12 * rim, words, ha=ha, va="top", fontsize=7, color="#5a6472")
    ax.text(0, -0.12 * rim, label, ha="center", va="top", fontsize=7.5, color=INK)


def _radial_bars(ax: Any, line: Line, clip: Any, colour: str) -> list[Any]:
    """Error bars along the radius, drawn where they are long enough to be seen."""
    from matplotlib.collections import LineCollection

    known = np.isfinite(line.u)
    if not known.any():
        return []
    ends = (np.maximum(line.measured[known] + sign * line.u[known], 0.0) for sign in (-1.0, 1.0))
    segments = np.stack([np.stack(xy(line.angle[known], end), axis=1) for end in ends], axis=1)
    bars = LineCollection(list(segments), colors=colour, linewidths=0.9, zorder=4)
    ax.add_collection(bars, autolim=False)
    bars.set_clip_path(clip)
    return [bars]


def xy(angle: Floats, radius: Floats) -> tuple[Floats, Floats]:
    return radius * np.sin(angle), radius * np.cos(angle)


def _ticks(rim: float) -> list[float]:
    for step in (0.2, 0.25, 0.5, 1.0):
        count = rim / step
        if count <= 8.01 and abs(count - round(count)) < 1e-6:
            return [float(step * k) for k in range(round(count) + 1)]
    return [float(rim * k / 4) for k in range(5)]
