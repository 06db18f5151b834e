"""Plots out of the plane of incidence, and of changes: each draws on the `ax` that it is given and returns its artists.

On a hemisphere the radius is the polar angle (equidistant: the rim is the horizon), the mirror half-plane points right
and azimuths run counterclockwise. What was not measured stays empty: colours are spread over a triangle between
measured directions only where its corners are at most `FARTHEST` apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.geometry import FARTHEST, direction
from gonio.typing import Floats, Ints
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots.in_plane import angle_axis, bars_above_0, log_axis, style
from gonio_analysis.plots.style import FAINT, INK

FEWEST = 4
"""Values that make a slice."""
FAR = 1.5
"""Largest measured value in a drawing of a lobe, in largest values of the model."""
PATCH = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}
"""Behind words that stand on a drawing."""
Marks = npt.NDArray[np.bool_]
SEQUENTIAL, DIVERGING = "viridis", "RdBu_r"
"""Colour maps that readers with any colour vision can tell; signs are told by markers, too, for print in grey."""


def heat_map(
    ax: Any, theta_r: Floats, dphi: Floats, value: Floats, *, label: str, theta_i: float | None = None
) -> list[Any]:
    """Positive values over the hemisphere of the receiver, on a logarithmic colour scale if they span a decade.

    Parameters
    ----------
    ax
        Cartesian axes; their frame is taken away.
    theta_r, dphi : (n,) arrays [rad]
        Directions of the receiver, azimuths from the source's.
    value
        Above 0 to be shown.
    label
        Of the colour bar, with the unit.
    theta_i
        Marks the mirror direction with a cross, and the source with a circle.
    """
    from matplotlib.colors import LogNorm, Normalize

    shown = value > 0
    low, high = float(value[shown].min()), float(value[shown].max())
    scale = LogNorm(low, high) if high > 10 * low else Normalize(low, high)
    artists = _disc(ax, theta_r[shown], dphi[shown], value[shown], SEQUENTIAL, scale)
    if theta_i is not None:
        x, y = _on_disc(np.array([theta_i, theta_i]), np.array([np.pi, 0.0]))
        artists += ax.plot(x[:1], y[:1], ls="none", marker="+", ms=8, mew=1.2, color="#ffffff", zorder=5)
        artists += ax.plot(x[:1], y[:1], ls="none", marker="x", ms=4, mew=0.8, color=INK, zorder=6)
        artists += ax.plot(x[1:], y[1:], ls="none", marker="o", ms=6, mfc="none", color=INK, zorder=6)
    _bar(ax, artists[0], label)
    return artists


def change_map(
    ax: Any, theta_r: Floats, dphi: Floats, value: Floats, *, label: str, top: float, marked: Marks | None = None
) -> list[Any]:
    """Signed values over the hemisphere, white at 0 and saturated at +-`top`; `marked` ones get a ring."""
    from matplotlib.colors import Normalize

    _hemisphere(ax)
    artists = _signed(ax, *_on_disc(theta_r, dphi), value, Normalize(-top, top), size=20)
    artists += _rings(ax, *_on_disc(theta_r, dphi), marked)
    _bar(ax, artists[0], label)
    return artists


def plane_map(
    ax: Any, angle: Floats, parameter: Floats, value: Floats, *, label: str, top: float, y_label: str,
    marked: Marks | None = None,
) -> list[Any]:  # fmt: skip
    """Signed values in the plane of incidence, over the signed angle [rad] and that of the direction that stood still.

    White is 0, colours are saturated at +-`top`; `marked` values get a ring.
    """
    from matplotlib.colors import Normalize

    levels = np.unique(np.round(np.degrees(parameter), 1))
    y = np.searchsorted(levels, np.round(np.degrees(parameter), 1)).astype(np.float64)
    cells = _signed(ax, np.degrees(angle), y, value, Normalize(-top, top), size=22)
    artists = [*cells, *_rings(ax, np.degrees(angle), y, marked)]
    angle_axis(ax)
    ax.set_yticks(range(levels.size), [f"{v:g}°" for v in levels])
    ax.set_ylim(-0.6, levels.size - 0.4)
    ax.set_ylabel(y_label)
    _bar(ax, cells[0], label)
    return artists


def both(ax: Any, lines: Sequence[Line], points: tuple[bool, bool]) -> list[Any]:
    """Curves of A (dashed, `measured` of the lines) and of B (solid, their `theory`) on a logarithmic axis.

    Parameters
    ----------
    ax
        Axes.
    lines
        The curves [1/sr]; what is not above 0 is left out.
    points
        Whether A and B were measured: filled and hollow markers stand for values, and a model is a line alone.
    """
    artists: list[Any] = []
    ends: list[Floats] = []
    for k, line in enumerate(lines):
        colour, marker = style(k)["color"], style(k)["marker"]
        sides = ((line.angle, line.measured, line.u), (line.theory_angle, line.theory, None))
        for (angle, value, u), measured, stroke, face in zip(
            sides, points, ((0, (4, 2)), "-"), (colour, "white"), strict=True
        ):
            shown = (value > 0) & np.isfinite(value)
            x, y = np.degrees(angle[shown]), value[shown]
            look = {"marker": marker, "ms": 3.0, "mfc": face, "mew": 0.8} if measured else {}
            artists += ax.plot(x, y, color=colour, ls=stroke, lw=0.7 if measured else 1.3, zorder=3, **look)
            if u is not None and np.any(u > 0):
                look = {"ls": "none", "elinewidth": 0.8, "color": colour, "zorder": 2}
                artists.append(bars_above_0(ax, angle[shown], y, u[shown], **look))
            if measured or not any(points):
                ends.append(y)
    every = np.concatenate(ends) if ends else np.empty(0)
    if every.size:
        log_axis(ax, float(every.min()), float(every.max()))
    angle_axis(ax)
    ax.set_ylabel("BRDF [1/sr]")
    return artists


def changes(ax: Any, lines: Sequence[Line], marked: Sequence[Marks | None]) -> list[Any]:
    """Relative changes in percent over the signed angle, with error bars; `measured` and `u` of the lines are those."""
    artists: list[Any] = [ax.axhline(0, color=INK, lw=0.7, zorder=1)]
    reach = [0.1]
    for k, (line, ring) in enumerate(zip(lines, marked, strict=True)):
        x, u = np.degrees(line.angle), np.nan_to_num(line.u)
        look = {"ls": "none", "elinewidth": 0.9, "ms": 3.2, "zorder": 3, "label": line.label, **style(k)}
        artists.append(ax.errorbar(x, line.measured, yerr=u, **look))
        artists += _rings(ax, x, line.measured, ring)
        if line.measured.size:
            reach.append(float(np.quantile(np.abs(line.measured) + u, 0.98)))
    ax.set_ylim(-1.15 * max(reach), 1.15 * max(reach))
    angle_axis(ax)
    ax.set_ylabel("change [%]")
    return artists


def significance(ax: Any, lines: Sequence[Line], limit: float) -> list[Any]:
    """Differences in standard deviations over the signed angle, with the limit that n values reach together."""
    artists: list[Any] = [ax.axhspan(-2, 2, color="#e9eef5", zorder=0), ax.axhline(0, color=INK, lw=0.7, zorder=1)]
    top = limit
    for k, line in enumerate(lines):
        artists += ax.plot(np.degrees(line.angle), line.measured, ls="none", ms=3, zorder=3, **style(k))
        top = max(top, float(np.abs(line.measured).max(initial=0.0)))
    artists += [ax.axhline(side, color=INK, lw=0.8, ls=(0, (4, 3)), zorder=2) for side in (-limit, limit)]
    ax.set_ylim(-1.2 * top, 1.2 * top)
    angle_axis(ax)
    ax.set_ylabel("standard\ndeviations")
    return artists


def slices(data: Observations, rows: Ints) -> list[Line]:
    """Values of one incidence out of the plane, by half-plane and its opposite, as lines for `polar.semilog`.

    The signed angle is positive where the receiver is on the mirror side of the plane across the plane of incidence.
    """
    at = data.directions.settled_at_normal()
    rows = rows[~at.in_plane[rows]]
    at = at[rows]
    turn = np.round(np.degrees(at.dphi) % 180.0, 0)
    out, nothing = [], np.empty(0)
    for half in np.unique(turn):
        here = np.flatnonzero(turn == half)
        here = here[np.argsort(at[here].signed)]
        if here.size >= FEWEST:
            azimuth = round(float(np.mean(np.degrees(at[here].dphi) % 180.0)), 1)
            label, chosen = f"Δφ = {azimuth:g}°/{azimuth + 180:g}°", rows[here]
            out.append(Line(label, nothing, nothing, at[here].signed, data.brdf[chosen], data.u[chosen]))
    return out


@dataclass(frozen=True)
class Mesh:
    """A lobe's values over the hemisphere."""

    theta: Floats
    dphi: Floats
    value: Floats


def lobe_mesh(brdf: Any) -> Mesh:
    """The values to draw of a function of (theta_r, dphi) [rad]."""
    theta, phi = np.meshgrid(np.radians(np.linspace(0, 89, 46)), np.radians(np.linspace(0, 360, 73)), indexing="ij")
    return Mesh(theta, phi, brdf(theta.ravel(), phi.ravel()).reshape(theta.shape))


def beyond(mesh: Mesh, value: Floats) -> Marks:
    """Which measured values a drawing of this lobe leaves out: they would shrink it to a dot, or are not numbers."""
    return np.asarray(~(value <= FAR * float(np.nanmax(mesh.value))))


def lobe(ax: Any, brdf: Any, *, measured: tuple[Floats, Floats, Floats] | None = None, label: str = "") -> list[Any]:
    """A lobe in three dimensions: the radius in each direction is the value in it, divided by the largest one.

    Parameters
    ----------
    ax
        Axes with projection "3d".
    brdf
        Function of (theta_r, dphi) [rad] to the value [1/sr], or what `lobe_mesh` made of it.
    measured
        theta_r, dphi [rad] and values of measurements, drawn as points. The box grows with them to `FAR` times the
        mesh's largest value; what is larger is left out (`beyond` counts it).
    label
        Of the whole, with the divisor.
    """
    # a wire mesh: readable in print, and a hundredth of the size of shaded facets
    mesh = brdf if isinstance(brdf, Mesh) else lobe_mesh(brdf)
    top = float(np.nanmax(mesh.value))
    x, y, z = _in_space(mesh.theta, mesh.dphi, mesh.value / top)
    artists: list[Any] = [ax.plot_wireframe(x, y, z, rstride=3, cstride=3, color=style(0)["color"], lw=0.45, zorder=2)]
    points = (np.empty(0), np.empty(0), np.empty(0))
    if measured is not None:
        near = ~beyond(mesh, measured[2])
        points = _in_space(measured[0][near], measured[1][near], np.clip(measured[2][near] / top, 0.0, None))
        artists.append(ax.scatter(*points, s=4, color=style(1)["color"], depthshade=False, zorder=3))
    turn = np.radians(np.linspace(0, 360, 121))
    reach = max(0.3, *(float(np.abs(a).max(initial=0.0)) for a in (x, y, *points[:2])))
    artists += ax.plot(reach * np.cos(turn), reach * np.sin(turn), 0 * turn, color=FAINT, lw=0.7)
    artists += ax.plot([-reach, reach], [0, 0], [0, 0], color=FAINT, lw=0.7)
    ax.text(reach, 0, 0, "mirror side", fontsize=7, color=INK, ha="right", va="top", bbox=PATCH, zorder=9)
    ax.set_axis_off()
    high = max(0.2, float(z.max()), float(points[2].max(initial=0.0)))
    tall = high / (2 * reach)
    across = max(1.15, 0.75 + 0.93 * tall)  # of the drawing, seen from 22 degrees above, in widths of the disc
    ax.set_box_aspect((1, 1, tall), zoom=1.03 * float(np.sqrt(2.0 + tall**2)) / across)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(0, high))
    ax.view_init(elev=22, azim=-60)
    ax.text2D(0.5, 0.0, label, fontsize=7.5, color=INK, ha="center", va="bottom", transform=ax.transAxes)
    return artists


def _signed(ax: Any, x: Floats, y: Floats, value: Floats, norm: Any, *, size: float) -> list[Any]:
    """Points of a diverging map: triangles up above 0 and down below it, circles at 0, which grey print shows too."""
    look = {"cmap": DIVERGING, "norm": norm, "s": size, "linewidths": 0.3, "edgecolors": "#555f6b", "zorder": 3}
    parts = (("^", value > 0), ("v", value < 0), ("o", value == 0))
    return [ax.scatter(x[k], y[k], c=value[k], marker=m, rasterized=x.size > 1000, **look) for m, k in parts]


def _disc(ax: Any, theta: Floats, dphi: Floats, value: Floats, colours: str, norm: Any) -> list[Any]:
    """Points in colours, which are spread over the triangles between them."""
    x, y = _on_disc(theta, dphi)
    _hemisphere(ax)
    artists: list[Any] = []
    mesh = _triangles(theta, dphi)
    if mesh is not None:
        artists.append(ax.tripcolor(mesh, value, cmap=colours, norm=norm, shading="gouraud", zorder=1, rasterized=True))
    look = {"s": 7, "linewidths": 0.25, "edgecolors": "#444444", "zorder": 3}
    artists.append(ax.scatter(x, y, c=value, cmap=colours, norm=norm, rasterized=x.size > 1000, **look))
    return artists


def _hemisphere(ax: Any) -> None:
    """Rings of equal polar angle, spokes, and which side is which."""
    turn = np.linspace(0, 2 * np.pi, 181)
    for ring in (30, 60, 90):
        edge = ring == 90
        ax.plot(
            ring * np.cos(turn), ring * np.sin(turn), color=INK if edge else FAINT, lw=0.9 if edge else 0.5, zorder=2
        )
        # below, where measurements of one half have nothing, and on a patch of their own where they have
        ax.text(0, 2 - ring, f"{ring}°", fontsize=6, color=INK, ha="center", va="bottom", zorder=6, bbox=PATCH)
    for k in range(4):
        c, s = 90 * np.cos(k * np.pi / 4), 90 * np.sin(k * np.pi / 4)
        ax.plot([-c, c], [-s, s], color=FAINT, lw=0.5, zorder=2)
    ax.set_aspect("equal")
    ax.set(xlim=(-94, 94), ylim=(-94, 94))
    ax.set_axis_off()
    ax.text(0, -96, "retro side  ←  →  mirror side", fontsize=6.5, color="#5a6472", ha="center", va="top")


def _triangles(theta: Floats, dphi: Floats) -> Any:
    from matplotlib.tri import Triangulation

    x, y = _on_disc(theta, dphi)
    if x.size < 4 or min(float(np.ptp(x)), float(np.ptp(y))) < 5.0:
        return None
    mesh = Triangulation(x, y)
    corner = direction(theta, dphi)[mesh.triangles]
    edges = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    if np.mean(edges > FARTHEST) > 0.5:  # shards between scattered points would say less than the points
        return None
    mesh.set_mask(edges > FARTHEST)
    return mesh


def _rings(ax: Any, x: Floats, y: Floats, marked: Marks | None) -> list[Any]:
    if marked is None or not marked.any():
        return []
    return [*ax.plot(x[marked], y[marked], ls="none", marker="o", ms=7, mfc="none", mec=INK, mew=0.9, zorder=5)]


def _on_disc(theta: Floats, dphi: Floats) -> tuple[Floats, Floats]:
    # the mirror half-plane (dphi = pi) points right
    return -np.degrees(theta) * np.cos(dphi), -np.degrees(theta) * np.sin(dphi)


def _in_space(theta: Floats, dphi: Floats, radius: Floats) -> tuple[Floats, Floats, Floats]:
    x, y, z = np.moveaxis(direction(theta, dphi), -1, 0)
    return -radius * x, -radius * y, radius * z


def _bar(ax: Any, artist: Any, label: str) -> None:
    bar = ax.figure.colorbar(artist, ax=ax, fraction=0.04, pad=0.02)
    bar.set_label(label, fontsize=7.5)
    bar.ax.tick_params(which="both", labelsize=7)
    bar.outline.set_linewidth(0.5)
