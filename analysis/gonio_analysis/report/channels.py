"""A sample of three channels, red, green and blue: their curves in one picture, and the colours that they make."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio import colour
from gonio.spectra import RGB_NM
from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Curve, curves
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots.in_plane import angle_axis, bars_above_0, log_axis
from gonio_analysis.report.blocks import Block, Figures, Heading
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import Section
from gonio_analysis.selection.compare import Dataset, FittedModel

KIND = "colour"
PAINT = {"red": "#c0272d", "green": "#2f8a3c", "blue": "#2456b8"}
INCIDENCE = np.radians(45.0)
"""The curve nearest to it is drawn; where nothing lies in the plane of incidence the models are drawn there."""
STILL = np.radians(1.0)
"""The incidence of a curve changes by less: in the plane of a scattered table lie values of all incidences."""
ANGLES = np.radians(np.arange(-85.0, 85.5, 1.0))
SIZE_IN = (5.6, 3.9)


def _of(d: Dataset) -> FittedModel | None:
    """The model that is put first, where it was fitted to all three channels."""
    f = d.models.get(d.best or "")
    return f if f is not None and d.data.of_channels and len(f.series) == len(RGB_NM) else None


def _curves(every: Sequence[Curve], data: Observations) -> list[Curve]:
    """Those along which the detector moves and the source stands still."""
    incidence = data.directions.theta_i
    return [c for c in every if c.scanned == "theta_r" and np.ptp(incidence[c.rows]) < STILL]


def draw(d: Dataset, facts: DatasetSummary) -> Sequence[Drawing]:
    """Curves of the channels of one incidence, and above them the colour at each angle."""
    f = _of(d)
    if f is None:
        return []
    nothing = np.zeros(0)
    shown = min(
        _curves(d.every_curve, d.data),
        key=lambda c: abs(c.parameter - INCIDENCE),
        default=Curve("theta_r", float(INCIDENCE), 0.0, nothing, nothing.astype(np.intp), nothing, nothing, 0.0),
    )
    by_wave = {fit.wavelength_nm: fit for fit in f.series}
    theory, measured = list[Floats](), list[tuple[Floats, Floats, Floats]]()
    for fit in (by_wave[nm] for nm in RGB_NM.values()):
        theory.append(np.asarray(shown.theory(fit.model, ANGLES, fit.data)))
        like = [c for c in _curves(curves(fit.data), fit.data) if abs(c.parameter - shown.parameter) < 1e-3]
        found = like[:1] if shown.angle.size else []
        measured += [(c.angle, c.brdf, c.u) for c in found] or [(nothing, nothing, nothing)]
    caption = (
        f"The channels red, green and blue at {shown.label}: points, measurement; lines, {f.fit.name}. The strip has"
        " the colour of the model at each angle beside a perfect white: linear sRGB, in which highlights are white."
    )
    on = partial(_on_channels, theory=theory, measured=measured)
    return [Drawing(f"{facts.slug}-colour", KIND, "", caption, caption, SIZE_IN, on)]


def _on_channels(figure: Any, *, theory: list[Floats], measured: list[tuple[Floats, Floats, Floats]]) -> None:
    strip, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1, 9))
    figure.subplots_adjust(0.12, 0.14, 0.97, 0.98, hspace=0.06)
    blue_first = np.pi * np.maximum(np.stack(theory, axis=-1)[:, ::-1], 0.0)
    seen = colour.display_srgb(blue_first @ colour.channel_weights())
    edge = float(np.degrees(ANGLES[-1]))
    strip.imshow(seen[None], aspect="auto", extent=(-edge, edge, 0.0, 1.0))
    strip.set_axis_off()
    for name, line, (angle, brdf, u) in zip(PAINT, theory, measured, strict=True):
        ax.plot(np.degrees(ANGLES), np.where(line > 0, line, np.nan), color=PAINT[name], lw=1.4, label=name)
        if np.any(brdf > 0):
            bars_above_0(ax, angle, brdf, u, color=PAINT[name], marker="o", ms=2.6, ls="", elinewidth=0.8)
    every = np.concatenate([*theory, *(brdf for _, brdf, _ in measured)])
    log_axis(ax, float(every[every > 0].min()), float(every.max()))
    angle_axis(ax)
    ax.set_xlabel("signed angle of reflection (negative: retro side)")
    ax.set_ylabel("BRDF [1/sr]")
    ax.legend(frameon=False, fontsize=8, ncols=3, loc="upper left")


def _blocks(d: DatasetSummary, figures: ByKind) -> list[Block]:
    found = figures.get(KIND, ())
    return [Heading(3, "Colour", "red, green and blue together"), Figures(found)] if found else []


SECTIONS = (Section("colour", _blocks, draw),)
