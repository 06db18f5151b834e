"""Colour over angle, and the beams of a glossmeter, on axes that are given."""

import math
from collections.abc import Sequence
from typing import Any

from gonio.typing import Floats

LETTERS = ("L*", "a*", "b*")
STYLES = (("#222222", "o", "-"), ("#b3322c", "s", "--"), ("#2a6db0", "^", ":"))
"""Colour, marker and line of L*, a* and b*."""


def colours(ax: Any, aspecular_deg: Floats, values: Sequence[Floats], u: Sequence[Floats], *, label: str) -> list[Any]:
    """L*, a* and b* over the aspecular angle at one incidence; a number that is missing is NaN.

    Parameters
    ----------
    aspecular_deg
        Angles from the mirror direction toward the normal, (n,).
    values, u
        Three arrays (n,) each; NaN in `u` draws no bar.
    label
        Of the incidence, as a title.
    """
    drawn = []
    for name, value, bar, (colour, marker, line) in zip(LETTERS, values, u, STYLES, strict=True):
        look = {"color": colour, "marker": marker, "ls": line, "ms": 4, "lw": 1, "capsize": 2, "label": name}
        drawn.append(ax.errorbar(aspecular_deg, value, yerr=bar, **look))
    ax.axhline(0.0, color="0.8", lw=0.7, zorder=0)
    ax.set_title(label, fontsize=9)
    ax.set_xticks(list(aspecular_deg))
    ax.tick_params(labelsize=8)
    return drawn


def beams(ax: Any, angle_deg: float, source_deg: float, receiver_deg: float, *, label: str) -> list[Any]:
    """A glossmeter's source and receiver in the plane of incidence, as wedges over the surface."""
    from matplotlib.patches import Wedge

    drawn = [ax.plot([-1.1, 1.1], [0.0, 0.0], color="0.3", lw=1.2)[0]]
    drawn += ax.plot([0.0, 0.0], [0.0, 1.0], color="0.7", lw=0.8, ls=":")
    for side, width, colour in ((-1.0, source_deg, "#c8861a"), (1.0, receiver_deg, "#2a6db0")):
        centre = 90.0 - side * angle_deg
        wedge = Wedge((0.0, 0.0), 1.0, centre - width / 2.0, centre + width / 2.0, facecolor=colour, edgecolor=colour)
        drawn.append(ax.add_patch(wedge))
        turn = math.radians(centre)
        above = 0.12 if angle_deg > 80.0 else 0.0  # clear of the surface
        place = (1.14 * math.cos(turn), 1.14 * math.sin(turn) + above)
        ax.annotate(f"{width:g}°", place, ha="center", va="center", fontsize=8)
    ax.set(xlim=(-1.35, 1.35), ylim=(-0.1, 1.25), aspect="equal")
    ax.set_axis_off()
    ax.set_title(label, fontsize=9)
    return drawn
