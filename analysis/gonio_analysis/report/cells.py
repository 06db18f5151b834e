"""What a cell of a notebook shows of a fit, a comparison and a table: plot and table, as on a page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import fields
from functools import partial
from html import escape
from typing import Any

import numpy as np

from gonio import measurement, shown
from gonio.errors import ArgumentError, ConfigError, DataError
from gonio.formats.reader import COLUMNS
from gonio.models import Lambert, Model
from gonio.typing import DataFrame
from gonio_analysis.curves.in_plane import Normalise, curves, labels, norm, selection
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import ByWavelength
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.plots import in_plane
from gonio_analysis.report import html, model_tables
from gonio_analysis.report.blocks import Block, lead
from gonio_analysis.report.drawing import as_svg
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.selection.compare import DrawnCurve, theory_angles

INCHES = (9.4, 3.5)
RADIUS = {"mirror": "BRDF / BRDF in the mirror direction", "max": "BRDF / its maximum", "model": "BRDF / model's"}
ALONG = "{}: retro side negative, mirror side positive"
ROWS = 10
"""Rows of a measurement table that a cell shows below its plot."""


class ShownFit(FitResult):
    """A fit that a notebook shows with its plot, and that draws itself."""

    def plot(self, ax: Any = None, *, semilog: bool = False, normalise: Normalise = "mirror") -> Any:
        """Draw measurement and model in the plane of incidence, normalised on a half disc, or absolute.

        Parameters
        ----------
        ax
            Axes of matplotlib to draw on; new ones by default.
        semilog
            Absolute values [1/sr] on a logarithmic axis.
        normalise
            What the polar plot divides by: "mirror", "max" or "model".

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        DataError
            No two values lie on one curve in the plane of incidence.
        """
        drawn = of_data(self.data, self.model, self.wavelength_nm, normalise)
        return plotted(ax, drawn, semilog=semilog, normalise=normalise)

    def _repr_html_(self) -> str:
        drawn = of_data(self.data, self.model, self.wavelength_nm, "mirror")
        return _picture(drawn, self.name) + super()._repr_html_()


class ShownComparison(DatasetSummary):
    """A comparison of models that a notebook shows as a report does: verdict, plot, models, parameters."""

    def plot(self, ax: Any = None, *, model: str = "", semilog: bool = False) -> Any:
        """Draw the measurement with one model, by default the one that is put first; see `ShownFit.plot`."""
        drawn = self._drawn(model)
        return plotted(ax, drawn, semilog=semilog, normalise=drawn[0].norm.kind if drawn else "mirror")

    def _drawn(self, model: str = "") -> list[DrawnCurve]:
        name = model or self.best or ""
        return self.models[name].drawn if name in self.models else []

    def _repr_html_(self) -> str:
        above: list[Block] = [lead(self.verdict)]
        below: list[Block] = [model_tables.compared(self), *model_tables.chosen(self)] if self.models else []
        return html.fragment(above) + _picture(self._drawn(), self.title) + html.fragment(below)


def shown_fit(result: FitResult) -> ShownFit:
    """The same fit, as a cell shows it."""
    return ShownFit(**{f.name: getattr(result, f.name) for f in fields(result)})


def of_data(data: Observations, model: Any, wavelength_nm: float, normalise: Normalise) -> list[DrawnCurve]:
    """The curves of values of one wavelength, with a model's as the instrument would see it; none for no curve."""
    drawn_curves = selection(curves(data))
    alone, out = at_wavelength(model, wavelength_nm), []
    for curve, label in zip(drawn_curves, labels(drawn_curves), strict=True):
        angle = theory = np.empty(0)
        if alone is not None:
            angle = theory_angles(curve, data)
            theory = curve.theory(alone, angle, data)
        by = norm(curve, normalise, Lambert(1.0) if alone is None else alone, data)
        out.append(DrawnCurve(curve, by, label, angle, theory, np.full(curve.angle.size, np.nan)))
    return out


def at_wavelength(model: Any, wavelength_nm: float) -> Model | None:
    """The model that holds at a wavelength, of one or of a fit; None for None."""
    one = model.model if isinstance(model, FitResult) else model
    if isinstance(one, ByWavelength):
        one = one.models[wavelength_nm]
    if one is not None and not isinstance(one, Model):
        raise ArgumentError(f"model must be one of gonio.models, or a fit, not {type(one).__name__}")
    return one


def on_half_disc(ax: Any, drawn: Sequence[DrawnCurve], normalise: str) -> list[Any]:
    """Normalised curves."""
    return in_plane.polar(ax, [d.normalised() for d in drawn], radius_label=RADIUS[normalise])


def on_logarithm(ax: Any, drawn: Sequence[DrawnCurve]) -> list[Any]:
    """Absolute curves [1/sr]."""
    artists = in_plane.semilog(ax, [d.absolute() for d in drawn])
    ax.set_xlabel(ALONG.format("θr" if drawn[0].curve.scanned == "theta_r" else "θi"))
    return artists


def plotted(ax: Any, drawn: Sequence[DrawnCurve], *, semilog: bool, normalise: str) -> Any:
    """See `ShownFit.plot`."""
    if not drawn:
        raise DataError("no two values lie on one curve in the plane of incidence")
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.figure(figsize=(INCHES[0] / 2, INCHES[1])).add_subplot()
    if semilog:
        on_logarithm(ax, drawn)
    else:
        on_half_disc(ax, drawn, normalise)
    return ax


def _picture(drawn: Sequence[DrawnCurve], name: str) -> str:
    """Both plots side by side as SVG, with the curves' labels; nothing where there is no curve."""
    if not drawn:
        return ""
    svg = as_svg(partial(_on_both, drawn=list(drawn)), INCHES, f"cell {name}")
    words = f"Polar and semilogarithmic plot of {name}"
    return f'<div style="max-width: 940px">{html.labelled(svg, words)}</div>'


def _on_both(figure: Any, *, drawn: list[DrawnCurve]) -> None:
    on_half_disc(figure.add_axes((0.0, 0.14, 0.5, 0.84)), drawn, drawn[0].norm.kind)
    on_logarithm(figure.add_axes((0.6, 0.24, 0.39, 0.73)), drawn)
    _key(figure, [d.label for d in drawn])


def _key(figure: Any, names: Sequence[str]) -> None:
    """The curves' labels, below."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], lw=1.5, ms=3.5, label=x, **in_plane.style(k)) for k, x in enumerate(names)]
    figure.legend(handles=handles, loc="lower center", ncol=min(len(handles), 7), fontsize=7.5, frameon=False)


def table_html(frame: DataFrame) -> str | None:
    """A measurement table as a plot above its first rows; None for any other table."""
    if "quantity" not in frame.attrs or not set(COLUMNS) <= set(
        frame.columns
    ):  # some columns of one are no measurement
        return None
    names = list(measurement.samples(frame))
    name = names[0] if len(names) == 1 else f"{len(names)} samples"
    try:
        data, nm = observations(frame, name).nearest(None)
        picture = _picture(of_data(data, None, nm, "mirror"), name)
    except (ConfigError, DataError):  # several samples, or no value that can be used: the rows alone
        picture = ""
    title = f"{shown.visible(name)}: {len(frame)} rows"
    main = frame[[c for c in frame.columns if not str(c).startswith("s_")]]  # the causes of u are many
    return f"{picture}<p>{escape(title)}</p>{main.head(ROWS).to_html()}"


def in_notebook() -> None:
    """Lets a running IPython show measurement tables with their plot; does nothing elsewhere."""
    ipython = sys.modules.get("IPython")
    running = ipython.get_ipython() if ipython is not None else None
    if running is not None:
        add(running.display_formatter)


def add(formatter: Any) -> None:
    """Let a formatter of IPython show measurement tables with their plot."""
    from pandas import DataFrame as Frame

    html_of = formatter.formatters["text/html"]
    html_of.for_type(Frame, lambda frame: table_html(frame) or frame._repr_html_())
