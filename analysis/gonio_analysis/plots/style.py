"""What plots share: colours, and the half disc of normalised polar plots."""

import math
import unicodedata
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Line

INK, FAINT = "#222222", "#c9ced6"
BAND, THIN = 0.14, 0.6
"""Opacity of a band, and width of the lines in its place."""
CLEAR_PX = 3.0
"""Room around the words of axes: they are set a little larger where their minus signs are."""
ASIDE_PT = 8.0
"""Room at both sides of a legend."""
LETTER_PT = (4.9, 7.8)
"""Width of a letter of a legend, at 7.5 pt: of most alphabets, and of those whose letters are square."""
WIDE = 2.0
"""A band of this factor to either side, or more, is drawn as two lines."""


def _half_disc(ax: Any, rim: float, label: str, *, retro_right: bool) -> None:
    from matplotlib.collections import LineCollection

    ax.axis("off")
    right = -1.14 * rim if retro_right else 1.14 * rim
    ax.set(aspect="equal", xlim=(-right, right), ylim=(-0.2 * rim, 1.13 * rim))
    turn = np.linspace(-np.pi / 2, np.pi / 2, 181)
    ticks, power = _ticks(rim), 0 if 0.1 <= rim < 1e4 else max(math.floor(math.log10(rim)), -300)
    unit, label = 10.0**power, f"{label}, in {ten_to(power)}" if power else label  # longer numbers would meet
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
            ax.text(side * t, -0.03 * rim, f"{t / unit:.3g}", ha="center", va="top", fontsize=7, color=INK)
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


def around(ax: Any, low: tuple[Floats, Floats], high: tuple[Floats, Floats], colour: str, *, wide: bool) -> list[Any]:
    """A band between two lines (x, y); where it is `wide` the two alone, which leave what lies between to be seen."""
    if wide:
        return [line for edge in (low, high) for line in ax.plot(*edge, color=colour, lw=THIN, zorder=2)]
    x, y = (np.concatenate([one, other[::-1]]) for one, other in zip(low, high, strict=True))
    return [*ax.fill(x, y, color=colour, alpha=BAND, lw=0, zorder=1)]


def ten_to(power: int) -> str:
    """As in 10⁻², in plain characters: setting formulas costs more than the rest of a plot."""
    return "10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def columns(names: Sequence[str], inches: float, *, most: int = 6, handle_pt: float = 34.0) -> int:
    """Columns of a legend of these names that is no wider than a figure."""
    widest = max(map(_wide_pt, names), default=0.0) + handle_pt
    return max(1, min(len(names), most, int((72.0 * inches - ASIDE_PT) / widest)))


def short(name: str, inches: float, *, beside: int = 1, handle_pt: float = 34.0) -> str:
    """A name of a legend of some columns, with its middle left out where it is wider than there is room for it."""
    while len(name) > 8 and _wide_pt(name) > (72.0 * inches - ASIDE_PT) / beside - handle_pt:
        half = (len(name) - 2) // 2
        name = f"{name[:half]}…{name[-half:]}"
    return name


def _wide_pt(name: str) -> float:
    """Width of a name in a legend [pt], rather too large than too small."""
    return sum(LETTER_PT[unicodedata.east_asian_width(letter) in "WF"] for letter in name)


def apart(figure: Any) -> None:
    """Along every axis of a figure, labels that would meet lose every second of them until none do.

    Axes choose their ticks without knowing how wide the labels are. A power of ten of theirs, which would stand
    somewhere near, goes to what the axis is called.
    """
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis) if ax.axison else ():
            _with_power(ax, axis)
            ends = sorted(axis.get_view_interval())
            labels = [(tick.get_loc(), tick.label1) for tick in _drawn_ticks(axis)]
            shown = [label for at, label in sorted(labels, key=_place) if ends[0] <= at <= ends[1] and label.get_text()]
            while len(shown) > 2 and _meet([label.get_window_extent() for label in shown]):
                for label in shown[1::2]:
                    label.set_visible(False)
                shown = shown[::2]


def _with_power(ax: Any, axis: Any) -> None:
    """Write the power of ten of an axis beside its label, or without one beside the title."""
    from matplotlib.ticker import ScalarFormatter

    numbers = axis.get_major_formatter()
    if not isinstance(numbers, ScalarFormatter):
        return
    numbers.set_useOffset(False)
    numbers.set_useMathText(False)
    axis.get_ticklabels()
    said = numbers.get_offset().replace("\u2212", "-")  # "1e-07", or nothing
    power = int(said.removeprefix("1e") or 0)
    axis.get_offset_text().set_visible(False)
    if power:
        titles = [one for one in (ax.title, ax._left_title, ax._right_title) if one.get_text()]
        label = axis.label if axis.label.get_text() or not titles else titles[0]
        label.set_text(f"{label.get_text()}, in {ten_to(power)}".removeprefix(", "))


def _drawn_ticks(axis: Any) -> list[Any]:
    axis.get_ticklabels()  # puts every tick in its place
    return [tick for tick in axis.get_major_ticks() if tick.label1.get_visible()]


def _place(label: tuple[float, Any]) -> float:
    return label[0]


def _meet(boxes: Sequence[Any]) -> bool:
    return any(one.overlaps(other) for one, other in pairwise(boxes))


def beside_points(ax: Any, points: Sequence[tuple[float, float, str]]) -> list[Any]:
    """Names beside points: as near as they stand clear of each other and of all points, else with a thin line there."""
    figure, taken = ax.figure, [one.get_window_extent().padded(CLEAR_PX) for one in _words_of(ax)]
    from matplotlib.text import Text

    marks = ax.transData.transform([(x, y) for x, y, _ in points])
    artists = []
    for (x, y, name), (px, _) in zip(points, marks, strict=True):
        words = ax.annotate(
            name, (x, y), (0, 0), textcoords="offset points", fontsize=7.5, va="center", zorder=6,
            arrowprops={"arrowstyle": "-", "lw": 0.4, "color": INK, "shrinkA": 0, "shrinkB": 2},
        )  # fmt: skip
        box = Text.get_window_extent(words)  # without the line
        for dx, ha, dy in _places():
            left = px + (dx if ha == "left" else -dx - box.width * 72 / figure.dpi) * figure.dpi / 72
            at = box.translated(left - box.x0, dy * figure.dpi / 72)
            clear = not any(at.overlaps(other) for other in taken) and not any(at.contains(*mark) for mark in marks)
            if clear and figure.bbox.containsx(at.x0) and figure.bbox.containsx(at.x1):
                break
        words.set(ha=ha, position=(dx if ha == "left" else -dx, dy))
        words.arrow_patch.set_visible(abs(dy) > 6 or dx > 8)
        taken.append(at)
        artists.append(words)
    return artists


def _words_of(ax: Any) -> list[Any]:
    return [*ax.get_xticklabels(), *ax.get_yticklabels(), ax.xaxis.label, ax.yaxis.label]


def _places() -> Iterator[tuple[float, str, float]]:
    """Offsets [pt] of a name, the nearest first: to the right and left of its point, then above and below."""
    for dx in (5.0, 16.0, 32.0):
        for step in range(12):
            for dy in sorted({11.0 * step, -11.0 * step}, reverse=True):
                yield from ((dx, "left", dy), (dx, "right", dy))


def xy(angle: Floats, radius: Floats) -> tuple[Floats, Floats]:
    return radius * np.sin(angle), radius * np.cos(angle)


def _ticks(rim: float) -> list[float]:
    """Radii of rings: at most 8 round steps, the last one at the rim where that is round."""
    power = 10.0 ** math.floor(math.log10(rim))
    steps = [one * power for one in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0) if rim <= 8.01 * one * power]
    step = next((one for one in steps if abs(rim / one - round(rim / one)) < 1e-6), steps[0])
    return [float(step * k) for k in range(math.floor(rim / step + 1e-6) + 1)]
