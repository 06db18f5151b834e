"""Plots of BRDFs in the plane of incidence: each draws on the `ax` that it is given and returns its artists.

Nothing here shows a window, makes a figure or touches matplotlib's settings. Theory is solid and measurement dashed
with error bars, as in He et al. 1991; colours are those of Okabe and Ito (2008), and each curve has a marker of its
own.
"""

import math
from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np

from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.plots.style import BAND, FAINT, INK, THIN, WIDE, _half_disc, _radial_bars, around, ten_to, xy

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B8860B", "#56B4E9")
MARKERS = ("o", "s", "^", "D", "v", "P")
Stroke = str | tuple[float, tuple[float, ...]]
STROKES: tuple[Stroke, ...] = (
    "-",
    (0, (6, 2)),
    (0, (1.6, 1.4)),
    (0, (7, 1.8, 1.6, 1.8)),
    (0, (3, 1.4)),
    (0, (7, 1.8, 1.6, 1.8, 1.6, 1.8)),
)
CHORD = float(np.radians(3.0))
"""Longest straight piece of a line around a half-disc."""


class Style(TypedDict):
    """Colour and marker, as matplotlib's `plot` takes them."""

    color: str
    marker: str


def style(k: int) -> Style:
    """Colour and marker of curve number `k`."""
    return {"color": COLOURS[k % len(COLOURS)], "marker": MARKERS[_turned(k, len(MARKERS))]}


def _turned(k: int, count: int) -> int:
    """Which of `count` markers or dashes goes with colour `k`: another one each time that the colours come again."""
    return (k + k // len(COLOURS)) % count


def stroke(k: int, lines: Sequence[Line]) -> Stroke:
    """Of theory along curve number `k`: solid beside measurements, which are dashed; without any, its own dashes.

    A marker stands for a value that was measured. Where none was, dashes tell curves apart in print.
    """
    return "-" if any(line.measured.size for line in lines) else dashes(k)


def dashes(k: int) -> Stroke:
    """Dashes of line number `k` of those that no marker tells apart."""
    return STROKES[_turned(k, len(STROKES))]


def handles(lines: Sequence[Line]) -> list[Any]:
    """What a legend says of curves: their colours, with markers where values were measured, or their dashes."""
    from matplotlib.lines import Line2D

    looks: list[dict[str, Any]] = [{"color": COLOURS[k % len(COLOURS)]} for k in range(len(lines))]
    if any(line.measured.size for line in lines):
        looks = [dict(style(k)) for k in range(len(lines))]
    return [
        Line2D([], [], lw=1.5, ms=3.5, ls=stroke(k, lines), label=line.label, **look)
        for k, (line, look) in enumerate(zip(lines, looks, strict=True))
    ]


def kinds(theory: str, measured: str) -> list[Any]:
    """What a legend says of solid and dashed lines."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=INK, lw=1.4, label=theory),
        Line2D([], [], color=INK, lw=0.9, ls=(0, (4, 2)), marker=".", ms=4, label=measured),
    ]


def pair(first: str, second: str, points: tuple[bool, bool]) -> list[Any]:
    """What a legend says of two sides: a dashed and a solid line, with markers where values were measured."""
    from matplotlib.lines import Line2D

    looks: list[dict[str, Any]] = [{"marker": "o", "mfc": face} for face in (INK, "white")]
    sides = zip((first, second), ((0, (4, 2)), "-"), looks, points, strict=True)
    return [
        Line2D([], [], color=INK, lw=0.9, ls=ls, ms=3.5, label=name, **(look if one else {}))
        for name, ls, look, one in sides
    ]


def band(line: Line) -> tuple[Floats, Floats]:
    """Theory less and more the model's own misfit tau, NaN where theory is not above 0."""
    value = np.where(line.theory > 0, line.theory, np.nan)
    factor = math.exp(min(line.tau, 700.0))
    with np.errstate(over="ignore"):
        return value / factor, value * factor


def wide(line: Line) -> bool:
    """Whether theory's misfit is such a factor that two lines stand for its band."""
    return line.tau >= math.log(WIDE)


def radius_of(lines: Sequence[Line], most: float = 2.5) -> float:
    """A round radius that holds what is shown, theory and measurement.

    What reaches beyond `most` times the middle one of the lobes, as a spike or theory of a rejected model may do, is
    cut at the rim: otherwise it would leave nothing of them to see. Lobes are measured ones, or without any theory's.
    """
    measured, theory = (
        [t for t in map(_top, values) if 0.0 < t < np.inf]
        for values in ([x.measured for x in lines], [x.theory for x in lines])
    )
    lobes = sorted(measured or theory)
    if not lobes:
        return 1.0
    limit = most * lobes[(len(lobes) - 1) // 2]
    return _round_up(max(t for t in (*measured, *theory) if t <= limit))


def rim_words(lines: Sequence[Line], rim: float, asked: float | None = None) -> str:
    """Sentences for the caption of `polar`: where its rim is, and what the strokes on it are."""
    words = f" The rim is at {rim:.4g}" + (", as asked for." if asked is not None else ", by what is shown.")
    if all(line.mirror is None for line in lines):
        return words
    return words + " Strokes on the rim, in the colours of the curves: their mirror directions."


def polar(
    ax: Any,
    lines: Sequence[Line],
    *,
    radius: float | None = None,
    radius_label: str = "",
    retro_right: bool = False,
    called: str = "measured",
) -> list[Any]:
    """Half-disc from -90 (left, retro side) to 90 degrees (right, mirror side), the radius labelled along the base.

    Parameters
    ----------
    ax
        Cartesian axes; their frame is taken away.
    lines
        The curves, in the unit of the radius.
    radius
        Of the rim; `radius_of(lines)` if it is not given. What lies beyond it is cut, with a note at the rim.
    radius_label
        What the radius is, with its unit; below the base.
    retro_right
        The source's side lies on the right, as in papers whose light comes from there.
    called
        What notes at the rim call the values: "measured", or "simulated".

    Returns
    -------
    list of artists
        Of each curve: the theory line, the measurement line, the error bars and the notes at the rim.
    """
    from matplotlib.patches import Wedge

    rim = radius_of(lines) if radius is None else radius
    _half_disc(ax, rim, radius_label, retro_right=retro_right)
    clip = Wedge((0, 0), rim, 0, 180, transform=ax.transData)
    artists, beyond = list[Any](), list[tuple[str, str]]()
    for k, line in enumerate(lines):
        look, notes = style(k), list[str]()
        if line.theory.size:
            artists += _theory(ax, k, lines, *xy(line.theory_angle, line.theory), lw=1.5)
            artists[-1].set_clip_path(clip)
            if line.tau > 0:
                artists += _misfit_band(ax, line, look["color"], rim, clip)
        if line.measured.size:
            artists += _measured(ax, line, look, rim, clip)
        for what, values in (("theory", line.theory), (called, line.measured)):
            if _top(values) > rim * 1.001:
                notes.append(f"{what} to {_top(values):.3g}")
        if line.mirror is not None:
            x, y = xy(np.array([line.mirror, line.mirror]), np.array([rim, rim * 1.03]))
            artists += ax.plot(x, y, color=look["color"], lw=2.2, solid_capstyle="butt", clip_on=False, zorder=5)
        if notes:
            beyond.append((f"{line.label}: {' and '.join(notes)}", look["color"]))
    return artists + _notes_at_rim(ax, beyond, rim, retro_right=retro_right)


def _theory(ax: Any, k: int, lines: Sequence[Line], x: Floats, y: Floats, *, lw: float = 1.4) -> list[Any]:
    """The line of theory along curve number `k`."""
    look = {"color": style(k)["color"], "ls": stroke(k, lines), "label": lines[k].label}
    return [*ax.plot(x, y, lw=lw, zorder=3, **look)]


def _notes_at_rim(ax: Any, beyond: Sequence[tuple[str, str]], rim: float, *, retro_right: bool) -> list[Any]:
    """What is cut off, each note in its curve's colour."""
    artists = []
    rows = max(3, -(-len(beyond) // 2))  # three find room above the rim, on each side of the label of the normal
    for k, (text, colour) in enumerate(beyond):
        side, ha = (-1.0, "left") if k < rows else (1.0, "right")
        x, y = (-side if retro_right else side) * 1.12 * rim, (1.105 - 0.048 * (k % rows)) * rim
        artists.append(ax.text(x, y, text, color=colour, fontsize=6.5, ha=ha, va="center", zorder=6))
    return artists


def _misfit_band(ax: Any, line: Line, colour: str, rim: float, clip: Any) -> list[Any]:
    """How far the model is off, as a band about its curve."""
    low, high = (xy(line.theory_angle, np.fmin(np.nan_to_num(edge), 2 * rim)) for edge in band(line))
    drawn = around(ax, low, high, colour, wide=wide(line))
    for one in drawn:
        one.set_clip_path(clip)
    return drawn


def _measured(ax: Any, line: Line, look: Style, rim: float, clip: Any) -> list[Any]:
    """The measurement's line, its marks within the rim, and error bars."""
    shown = np.maximum(line.measured, 0.0)
    x, y = xy(line.angle, shown)
    inside = shown <= rim * 1.0001
    artists: list[Any] = [
        *ax.plot(*xy(*_around(line.angle, shown)), color=look["color"], lw=0.9, ls=(0, (4, 2)), zorder=4)
    ]
    artists[-1].set_clip_path(clip)
    artists += ax.plot(
        x[inside], y[inside], ls="none", marker=look["marker"], ms=2.6, color=look["color"],
        label=None if line.theory.size else line.label, zorder=4, clip_on=False,
    )  # fmt: skip
    return artists + _radial_bars(ax, line, clip, look["color"])


def semilog(ax: Any, lines: Sequence[Line], *, unit: str = "BRDF [1/sr]") -> list[Any]:
    """Absolute values on a logarithmic axis over the signed angle; values at or below 0 cannot be shown.

    Returns
    -------
    list of artists
        The lines and error bars.
    """
    artists: list[Any] = []
    positive = [v[v > 0] for line in lines for v in (line.theory, line.measured) if np.any(v > 0)]
    for k, line in enumerate(lines):
        if line.theory.size:
            x = np.degrees(line.theory_angle)
            artists += _theory(ax, k, lines, x, np.where(line.theory > 0, line.theory, np.nan))
            if line.tau > 0:
                colour = style(k)["color"]
                if wide(line):
                    artists += [one for edge in band(line) for one in ax.plot(x, edge, color=colour, lw=THIN, zorder=2)]
                else:
                    artists.append(ax.fill_between(x, *band(line), color=colour, alpha=BAND, lw=0, zorder=1))
        if np.any(line.measured > 0):
            label = None if line.theory.size else line.label
            look = {"lw": 0.8, "label": label, "elinewidth": 0.8, "ms": 2.6, "zorder": 4, **style(k)}
            artists.append(bars_above_0(ax, line.angle, line.measured, line.u, ls=(0, (4, 2)), **look))
    if positive:
        measured = [line.measured[line.measured > 0] for line in lines if np.any(line.measured > 0)]
        low = min(float(np.min(v)) for v in (measured or positive))
        log_axis(ax, low, min(max(float(np.max(v)) for v in positive), ceiling(lines)))
    else:
        ax.set_yscale("log")
    angle_axis(ax)
    ax.set_ylabel(unit)
    return artists


def bars_above_0(ax: Any, angle: Floats, value: Floats, u: Floats, **look: Any) -> Any:
    """Values above 0 over an angle [rad] with error bars that do not reach down to 0, for a logarithmic axis."""
    shown = value > 0
    y, bar = value[shown], np.nan_to_num(u[shown])
    return ax.errorbar(np.degrees(angle[shown]), y, yerr=[np.minimum(bar, 0.999 * y), bar], **look)


def overlay(ax: Any, line: Line, theory: Sequence[tuple[Floats, Floats]]) -> tuple[float, float]:
    """One measured curve with the theory of several models, on an axis that `log_axis` makes logarithmic.

    Parameters
    ----------
    ax
        Axes.
    line
        The measurement; its own theory is not drawn.
    theory
        Signed angles [rad] and values of each model.

    Returns
    -------
    tuple
        The smallest value above 0 that is measured, and the largest of all; NaN where there is none.
    """
    for k, (angle, value) in enumerate(theory):
        shown = np.where(value > 0, value, np.nan)
        ax.plot(np.degrees(angle), shown, color=COLOURS[k % len(COLOURS)], ls=dashes(k), lw=1.2, zorder=4)
    kept = line.measured > 0
    x, y = np.degrees(line.angle[kept]), line.measured[kept]
    if np.any(line.u[kept] > 0):
        bars_above_0(ax, line.angle, line.measured, line.u, ls="none", elinewidth=0.7, color="#77808c", zorder=3)
    ax.plot(x, y, ls="none", marker=".", ms=3.5, color=INK, zorder=3)
    angle_axis(ax)
    every = np.concatenate([y, *(v[(v > 0) & np.isfinite(v)] for _, v in theory)])
    least = float(y.min()) if y.size else float(every.min()) if every.size else np.nan
    return least, float(every.max()) if every.size else np.nan


def ceiling(lines: Sequence[Line]) -> float:
    """How high a logarithmic panel reaches for theory: measured values keep two thirds of it. Infinite without any."""
    values = np.concatenate([np.empty(0), *(line.measured[line.measured > 0] for line in lines)])
    if not values.size:
        return np.inf
    low, high = float(values.min()), float(values.max())
    with np.errstate(over="ignore"):
        return float(high * max(np.sqrt(high / low), 1.5))


def log_axis(ax: Any, low: float, high: float) -> None:
    """A logarithmic y axis around these values, with the labels that its decades leave room for."""
    ax.set_yscale("log")  # before the limits: a linear axis refuses limits as small as a table may hold
    low, high = low / 1.5, high * 1.5
    ax.set_ylim(low, high)
    from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator

    if high < 100 * low:  # few decades: label the steps between them too
        digits = (1, 1.5, 2, 3, 4, 5, 6, 8) if high < 10 * low else (1, 2, 5)
        steps = [m * 10.0**p for p in range(-9, 9) for m in digits if low <= m * 10.0**p <= high]
        ax.yaxis.set_major_locator(FixedLocator(steps))
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.yaxis.set_minor_locator(NullLocator())
        return
    ax.yaxis.set_major_formatter(lambda value, _: _power_of_ten(value))
    if high > 1e4 * low:  # a tick is slow to draw, and eight a decade are too close to count
        ax.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0), numticks=50))
    ax.yaxis.set_minor_formatter(NullFormatter())


def linear(ax: Any, lines: Sequence[Line], *, y_label: str, retro_right: bool = False) -> list[Any]:
    """Values on a linear axis from 0 over the signed angle.

    Returns
    -------
    list of artists
        The lines and error bars.
    """
    artists: list[Any] = []
    for k, line in enumerate(lines):
        if line.theory.size:
            artists += _theory(ax, k, lines, np.degrees(line.theory_angle), line.theory)
        if line.measured.size:
            look = {"yerr": np.nan_to_num(line.u), "lw": 0.8, "elinewidth": 0.8, "ms": 2.6, "zorder": 4, **style(k)}
            artists.append(ax.errorbar(np.degrees(line.angle), line.measured, ls=(0, (4, 2)), **look))
    ax.set_ylim(bottom=0.0)
    angle_axis(ax, retro_right=retro_right)
    ax.set_ylabel(y_label)
    return artists


def residuals(
    ax: Any, lines: Sequence[Line], *, whitened: bool, others: tuple[Floats, Floats] | None = None
) -> list[Any]:
    """Residuals over the signed angle: whitened ones, model - measurement, with the band of 2 standard deviations.

    Parameters
    ----------
    whitened
        False: residuals are model / measurement - 1, and drawn as that ratio on a logarithmic axis, where a model that
        is ten times too low stands as far from 1 as one that is ten times too high; ratios not above 0 are left out.
    others
        Angles [rad] and residuals of values that belong to no curve (out of plane), in grey.
    """
    artists: list[Any] = [ax.axhspan(-2, 2, color="#e9eef5", zorder=0)] if whitened else []
    artists.append(ax.axhline(0 if whitened else 1, color=INK, lw=0.7, zorder=1))
    everything: list[Floats] = []

    def points(angle: Floats, residual: Floats, **look: Any) -> Any:
        shown = np.isfinite(residual) if whitened else np.isfinite(residual) & (residual > -1.0)
        value = residual[shown] if whitened else 1.0 + residual[shown]
        everything.append(np.abs(value if whitened else np.log10(value)))
        artists.extend(ax.plot(np.degrees(angle[shown]), value, ls="none", **look))
        return artists[-1]

    if others is not None and others[0].size:
        grey = points(*others, marker=".", ms=2, color="#9aa3ae", zorder=2)
        grey.set_rasterized(others[0].size > 1000)  # an SVG element a point would be megabytes
    for k, line in enumerate(lines):
        if line.residual is not None:
            points(line.angle, line.residual, ms=3, zorder=3, **style(k))
    top = max((float(size.max()) for size in everything if size.size), default=0.0)
    if not whitened:
        _ratio_axis(ax, max(1.1 * top, 0.1))
    elif top > 15.0:
        _far_axis(ax, top)
    else:
        ax.set_ylim(-max(top * 1.15, 3.0), max(top * 1.15, 3.0))
    angle_axis(ax)
    ax.set_ylabel("residual\n/ u" if whitened else "model /\nmeasured")
    return artists


def _far_axis(ax: Any, top: float) -> None:
    """An axis that is linear up to 3 and logarithmic beyond, with the few labels that a low panel holds."""
    near = 3.0
    ax.set_yscale("symlog", linthresh=near)
    ax.set_ylim(-top * 1.6, top * 1.6)
    power = 10.0 ** np.floor(np.log10(top * 1.3))
    far = 3.0 * power if 3.0 * power < top * 1.3 else power
    steps = [near] if np.log10(top / near) < 2.5 else []
    steps += [far] if far > 8 * near or not steps else []
    ticks = [-t for t in reversed(steps)] + [0.0, *steps]
    ax.set_yticks(ticks, [_plain(t) for t in ticks])
    ax.minorticks_off()


def _ratio_axis(ax: Any, reach: float) -> None:
    """A logarithmic axis of `reach` decades on both sides of 1."""
    from matplotlib.ticker import FixedLocator, NullLocator

    ax.set_yscale("log")
    ax.set_ylim(10.0**-reach, 10.0**reach)
    if reach >= 1.0:
        step = -(-int(reach) // 2)
        ticks = [10.0 ** (step * k) for k in range(-2, 3)]
    else:
        ticks = [0.2, 0.5, 1.0, 2.0, 5.0] if reach > 0.4 else [0.5, 0.8, 1.0, 1.25, 2.0]
    ax.yaxis.set_major_locator(FixedLocator(ticks))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}" if 1e-3 < value < 1e4 else _power_of_ten(value))


def _plain(value: float) -> str:
    """A number of an axis, with a true minus sign."""
    text = f"{value:g}" if abs(value) < 1e4 else ("-" if value < 0 else "") + _power_of_ten(abs(value))
    return text.replace("-", "−", 1)


def _around(angle: Floats, radius: Floats) -> tuple[Floats, Floats]:
    """The line through values, even in angle: between values far apart a straight one would cut through the disc."""
    gaps = np.diff(angle)
    if not np.any(gaps > 2 * CHORD):
        return angle, radius
    between = [np.linspace(a, a + gap, int(gap / CHORD) + 2)[:-1] for a, gap in zip(angle[:-1], gaps, strict=True)]
    every = np.concatenate([*between, angle[-1:]])
    return every, np.interp(every, angle, radius)


def _power_of_ten(value: float) -> str:
    """As in 10⁻²."""
    if not 0.0 < value < np.inf:  # ticks beyond the ends of an axis that reaches to the smallest numbers
        return ""
    return ten_to(round(np.log10(value)))


def _top(values: Floats) -> float:
    return float(np.nanmax(values)) if values.size else 0.0


def _round_up(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(value))
    steps = (1.0, 1.2, 1.4, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return float(next(s for s in steps if s * power >= value * 0.999) * power)


def angle_axis(ax: Any, *, retro_right: bool = False) -> None:
    """The signed angle from -90 to 90 degrees along x, or (as some papers draw it) from 90 to -90."""
    ax.set_xlim(*((90, -90) if retro_right else (-90, 90)))
    degrees_along(ax, 90, 30)
    ax.grid(color=FAINT, lw=0.5)
    clean(ax)


def degrees_along(ax: Any, end: int, step: int) -> None:
    """Labels of angles along x, from minus `end` to `end`."""
    places = range(-end, end + 1, step)
    ax.set_xticks(places, [f"{place}°".replace("-", "−") for place in places])


def clean(ax: Any) -> None:
    """Axes with two quiet spines and small labels."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color("#77808c")
    ax.tick_params(labelsize=7.5, color="#77808c")
    ax.xaxis.label.set_size(8)
    ax.yaxis.label.set_size(8)
    ax.set_axisbelow(True)
