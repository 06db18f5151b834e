"""Polar plots of what a sample reflects, in the upper half, and of what it lets through, in the lower one."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gonio_analysis.curves.line import Line
from gonio_analysis.plots.half_disc import xy
from gonio_analysis.plots.in_plane import style
from gonio_analysis.plots.style import FAINT, INK

RIM = 1.0


def disc(
    ax: Any, reflected: Sequence[Line], transmitted: Sequence[Line], order: Sequence[str], *, words: tuple[str, str]
) -> list[Any]:
    """Full disc: the normal of the lit side is up, that of the back down; the mirror's side and straight through right.

    Parameters
    ----------
    ax
        Cartesian axes; their frame is taken away.
    reflected, transmitted
        Measured curves, each already divided so that its largest value is 1. Angles of transmission are turned over:
        counted from the normal of the back, with the straight direction where reflection has the mirror's.
    order
        Labels of all curves: the place tells colour and marker, so that one incidence looks alike in both halves.
    words
        What the radius is, above and below.

    Returns
    -------
    list of artists
        Of each curve: the line, and the stroke that marks the mirror or the straight direction.
    """
    _frame(ax, words)
    artists: list[Any] = []
    for lines, sign in ((reflected, 1.0), (transmitted, -1.0)):
        for line in lines:
            place = order.index(line.label)
            look = style(place)
            size = max(5.0 - 0.9 * place, 2.0)  # those that coincide show around each other
            x, y = xy(line.angle, np.clip(line.measured, 0.0, RIM))
            artists += ax.plot(x, sign * y, lw=0.9, ls=(0, (4, 2)), ms=size, zorder=4, clip_on=False, **look)
            if line.mirror is not None:
                x, y = xy(np.array([line.mirror, line.mirror]), np.array([RIM, 1.04 * RIM]))
                artists += ax.plot(
                    x, sign * y, color=look["color"], lw=2.2, solid_capstyle="butt", clip_on=False, zorder=5
                )
    return artists


def _frame(ax: Any, words: tuple[str, str]) -> None:
    from matplotlib.collections import LineCollection

    ax.axis("off")
    ax.set(aspect="equal", xlim=(-1.14, 1.14), ylim=(-1.3, 1.3))
    turn = np.linspace(-np.pi, np.pi, 361)
    rings = [np.stack(xy(turn, np.full(turn.size, r)), axis=1) for r in (0.25, 0.5, 0.75)]
    rays = [np.stack(xy(np.full(2, a), np.array([0.0, RIM])), axis=1) for a in np.radians(np.arange(-165, 181, 15))]
    rim, sample = np.stack(xy(turn, np.full(turn.size, RIM)), axis=1), np.array([(-RIM, 0.0), (RIM, 0.0)])
    for lines, colour, width, order in (
        ([*rings, *rays], FAINT, 0.5, 1),
        ([rim], INK, 0.9, 1),
        ([sample], INK, 1.8, 2),
    ):
        ax.add_collection(LineCollection(lines, colors=colour, linewidths=width, zorder=order), autolim=False)
    for degrees in range(-150, 181, 30):
        (tx,), (ty,) = xy(np.radians([degrees]), np.array([1.085]))
        ax.text(tx, ty, f"{degrees}°".replace("-", "−"), ha="center", va="center", fontsize=7, color=INK)
    for r in (0.5, 1.0):
        ax.text(0.012, r - 0.035, f"{r:g}", ha="left", va="center", fontsize=6.5, color=INK, zorder=6)
        ax.text(0.012, 0.035 - r, f"{r:g}", ha="left", va="center", fontsize=6.5, color=INK, zorder=6)
    for y, text in zip((1.245, -1.245), words, strict=True):
        ax.text(0, y, text, ha="center", va="center", fontsize=7.5, color=INK)
    for x, y, text in ((-1.13, 1.13, "retro side"), (1.13, 1.13, "mirror side"), (1.13, -1.13, "straight on")):
        ax.text(x, y, text, ha="left" if x < 0 else "right", fontsize=7, color="#5a6472", va="center")
