"""Which of many values are enough to draw: where markers would cover each other, some of them show the same."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats, Ints
from gonio_analysis.curves.in_plane import Curve, Line
from gonio_analysis.plots.style import xy

CELL_PT = 1.3
"""Half of a marker: values that share a square of this side [pt] are drawn on top of each other."""
POINTS_AN_INCH = 72.0


def enough(x: Floats, y: Floats, *, most: int, keep: npt.NDArray[np.bool_] | None = None) -> Ints:
    """Which values to draw, in their order: one a square of the drawing, and the extremes.

    The squares have the side `CELL_PT`, and grow until at most `most` values are left. In each, a value of `keep` goes
    before all others. Of every column of squares the lowest and the highest value stay, and the first and last one.

    Parameters
    ----------
    x, y : (n,) arrays [pt]
        Places on the drawing; values that are not finite are never chosen.
    most
        At least 16. A few more are returned where the extremes alone are more.
    keep
        Values that a reader looks for, such as marked ones.
    """
    seen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if seen.size <= most:
        return seen
    x, y = x[seen] - x[seen].min(), y[seen] - y[seen].min()
    late = np.zeros(seen.size, dtype=bool) if keep is None else ~keep[seen]
    cell, widest = CELL_PT, max(float(x.max()), float(y.max()))
    while True:  # what a coarser grid chooses is always among what a finer one chose
        column, row = np.floor(x / cell), np.floor(y / cell)
        squares = 2.0 * (column * (row.max() + 1.0) + row) + late
        order = np.argsort(squares, kind="stable")
        first = np.ones(order.size, dtype=bool)
        first[1:] = np.diff(squares[order] // 2.0) != 0
        by_height = np.lexsort((y, column))
        edge = np.flatnonzero(np.diff(column[by_height]) != 0)
        ends = by_height[np.concatenate([[0], edge + 1, edge, [order.size - 1]])]
        chosen = np.unique(np.concatenate([order[first], ends, [np.argmin(x), np.argmax(x)]]))
        seen, x, y, late = seen[chosen], x[chosen], y[chosen], late[chosen]
        if seen.size <= most or cell > widest:
            return np.asarray(seen)
        cell *= max(1.1, float(np.sqrt(seen.size / most)) ** 0.7)


def share(lines: Sequence[Line] | Sequence[Curve], most: int) -> int:
    """Values of one curve of several that may be drawn, if all of them together may have `most`."""
    return max(most // max(len(lines), 1), 16)


def on_half_disc(lines: Sequence[Line], rim: float, radius_pt: float, most: int) -> list[Line]:
    """Lines for `polar.polar` with at most `most` measured values together."""
    out = []
    for line in lines:
        x, y = xy(line.angle, np.clip(line.measured, 0.0, rim) * radius_pt / rim)
        rows = enough(x, y, most=share(lines, most))
        if line.measured.size:  # what is cut at the rim is named by its largest value
            rows = np.union1d(rows, [np.nanargmax(line.measured)]).astype(np.intp)
        out.append(_taken(line, rows))
    return out


def on_logarithm(lines: Sequence[Line], width_pt: float, height_pt: float, most: int) -> list[Line]:
    """Lines for `polar.semilog` with at most `most` measured values together; those not above 0 are left out."""
    with np.errstate(divide="ignore", invalid="ignore"):
        heights = [np.log(line.measured) for line in lines]
    every = np.concatenate([h[np.isfinite(h)] for h in heights]) if heights else np.empty(0)
    span = float(np.ptp(every)) or 1.0 if every.size else 1.0
    return [
        _taken(line, enough(_across(line.angle, width_pt), h * height_pt / span, most=share(lines, most)))
        for line, h in zip(lines, heights, strict=True)
    ]


def of_residuals(lines: Sequence[Line], width_pt: float, height_pt: float, most: int) -> list[Line]:
    """Lines for `polar.residuals` with at most `most` residuals together."""
    known = [(line, line.residual) for line in lines if line.residual is not None]
    most = share([line for line, _ in known], most)
    return [_taken(line, residuals(line.angle, residual, width_pt, height_pt, most)) for line, residual in known]


def residuals(
    angle: Floats,
    value: Floats,
    width_pt: float,
    height_pt: float,
    most: int,
    keep: npt.NDArray[np.bool_] | None = None,
) -> Ints:
    """Which residuals to draw over the signed angle, where small and large ones share an axis."""
    height = np.arcsinh(value / 3.0)  # about what the axis does to values far beyond 3
    finite = height[np.isfinite(height)]
    span = 2.0 * float(np.abs(finite).max()) if finite.size else 1.0
    return enough(_across(angle, width_pt), height * height_pt / (span or 1.0), most=most, keep=keep)


DISC_PT = 135.0
"""Radius of a disc."""


def over_hemisphere(
    theta: Floats, dphi: Floats, value: Floats, most: int, keep: npt.NDArray[np.bool_] | None = None
) -> Ints:
    """Which directions to draw on a disc whose radius is the polar angle: the extreme values are among them."""
    x, y = xy(dphi, np.degrees(theta) * DISC_PT / 90.0)
    return np.union1d(enough(x, y, most=most, keep=keep), ends(value)).astype(np.intp)


def ends(value: Floats) -> Ints:
    """Where the smallest and the largest finite value are."""
    finite = np.flatnonzero(np.isfinite(value))
    if not finite.size:
        return np.empty(0, dtype=np.intp)
    return finite[[int(np.argmin(value[finite])), int(np.argmax(value[finite]))]]


def of_curve(curve: Curve, most: int) -> Curve:
    """A curve with at most about `most` of its values: the extremes, the mirror direction and an even choice."""
    if curve.angle.size <= most:
        return curve
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.log(np.abs(curve.brdf))
    known = height[np.isfinite(height)]
    least, span = (float(known.min()), float(np.ptp(known))) if known.size else (0.0, 0.0)
    height = np.where(np.isfinite(height), height, least)
    rows = enough(_across(curve.angle, 400.0), height * 250.0 / (span or 1.0), most=most)
    more = [int(np.argmax(curve.brdf)), int(np.argmin(curve.brdf)), *([] if curve.mirror is None else [curve.mirror])]
    rows = np.union1d(rows, more).astype(np.intp)
    return replace(curve, angle=curve.angle[rows], rows=curve.rows[rows], brdf=curve.brdf[rows], u=curve.u[rows])


def words(drawn: int, of: int) -> str:
    """A sentence for a caption on how many values are drawn; empty where all of them are."""
    if drawn >= of:
        return ""
    return (
        f" Drawn are {_grouped(drawn)} of {_grouped(of)} values: where markers overlap one stands for its neighbours,"
        " and the extremes stay."
    )


def measured(lines: Sequence[Line]) -> int:
    """How many measured values lines have."""
    return sum(int(line.angle.size) for line in lines)


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\u00a0")


def _across(angle: Floats, width_pt: float) -> Floats:
    return np.asarray(angle * width_pt / np.pi)


def _taken(line: Line, rows: Ints) -> Line:
    if rows.size == line.angle.size:
        return line
    return replace(
        line,
        angle=line.angle[rows],
        measured=line.measured[rows] if line.measured.size else line.measured,
        u=line.u[rows] if line.u.size else line.u,
        residual=None if line.residual is None else line.residual[rows],
    )
