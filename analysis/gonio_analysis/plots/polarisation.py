"""Mueller matrices over the angle: a grid of four by four panels."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gonio.formats.reader import MUELLER
from gonio_analysis.curves.line import Line
from gonio_analysis.plots.in_plane import clean, style
from gonio_analysis.plots.style import FAINT, INK


def grid(axes: Any, lines: Mapping[str, Sequence[Line]]) -> list[Any]:
    """The elements m01 to m33, over the first one, against the signed angle; all panels have one scale.

    Parameters
    ----------
    axes
        An array of 4 x 4 axes; the first is left to its caller, and switched off.
    lines
        By element: measured values, and theory where there is any. Values are dots with bars of u, theory is a line.

    Returns
    -------
    list of artists
        The lines and error bars.
    """
    artists: list[Any] = []
    axes[0][0].axis("off")
    reach = _reach(lines)
    for name in MUELLER:
        i, j = int(name[1]), int(name[2])
        ax = axes[i][j]
        ax.axhline(0.0, color="#9aa3ae", lw=0.6, zorder=1)
        for k, line in enumerate(lines[name]):
            look = style(k)
            if line.theory.size:
                x = np.degrees(line.theory_angle)
                artists += ax.plot(x, line.theory, color=look["color"], lw=1.2, zorder=3, label=line.label)
            u = np.nan_to_num(line.u)
            bars = {"yerr": u if u.any() else None, "ls": "none", "ms": 2.0, "elinewidth": 0.7, "zorder": 4}
            artists.append(ax.errorbar(np.degrees(line.angle), line.measured, **bars, **look))
        ax.set(xlim=(-90, 90), ylim=(-reach, reach))
        ax.set_yticks([-0.8 * reach, 0.0, 0.8 * reach] if reach < 1.0 else [-1.0, 0.0, 1.0])
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
        ax.set_xticks([-60, 0, 60], ["−60°", "0°", "60°"] if i == 3 else ["", "", ""])
        ax.grid(color=FAINT, lw=0.4)
        clean(ax)
        first = j == (1 if i == 0 else 0)  # of its row: its axis says the scale
        ax.tick_params(labelleft=first)
        ax.text(0.04, 0.97, name, transform=ax.transAxes, ha="left", va="top", fontsize=7.5, color=INK, zorder=6)
    return artists


def _reach(lines: Mapping[str, Sequence[Line]]) -> float:
    """Half the height of every panel: round, and at most a little above 1."""
    values = [v for some in lines.values() for x in some for v in (x.measured, x.theory) if v.size]
    top = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    return next((step for step in (0.1, 0.2, 0.5) if top <= step), 1.08)
