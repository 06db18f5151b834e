"""Fits, comparisons and plots straight from tables and models, for scripts and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gonio import measurement, plugins
from gonio.errors import ArgumentError, ConfigError, DataError
from gonio.formats import channels
from gonio.models import Model, Sum
from gonio.models.parameters import Ior
from gonio.typing import DataFrame
from gonio_analysis.changes import point_by_point
from gonio_analysis.changes.consensus import consensus as consensus
from gonio_analysis.changes.sides import Side, of_table
from gonio_analysis.curves.in_plane import Normalise
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import check_u_rel, observations
from gonio_analysis.fitting.problem import FitRequest, check_metric
from gonio_analysis.fitting.spectrum import fit_table
from gonio_analysis.report.cells import (
    ShownComparison,
    ShownFit,
    in_notebook,
    of_data,
    on_half_disc,
    on_logarithm,
    shown_fit,
)
from gonio_analysis.selection.compare import DrawnCurve, check_models, examine

Table: TypeAlias = "DataFrame | str | Path"
"""A measurement table, or where one is: a file, a run, or "FILE:SAMPLE"."""


def fit(table: Table, model: str | type[Model] | Model, *, name: str | None = None, **options: Any) -> ShownFit:
    """Fit one model to a table: at one wavelength, with the geometry of the surface shared by all that it has.

    Parameters
    ----------
    table
        A table of `gonio.read`, or where one is.
    model
        A name as on the command line ("he-torrance", "oren-nayar+phong"), or the class of a model, one's own too
        (docs/writing_a_model.md). Of a model the class counts: where the search starts is its own affair.
    name
        What messages call the table.
    options
        The attributes of `gonio_analysis.fitting.problem.FitRequest`: ior, fix, free, bounds, wavelength_nm, each, ...

    Raises
    ------
    ConfigError
        Unknown model, parameter or option, or a file of several samples.
    DataError
        Too few usable values.

    Examples
    --------
    >>> from gonio_analysis import fit
    >>> found = fit("clay.csv", "oren-nayar")
    >>> print(f"{found.parameters['sigma_deg'].value:.2f} deg")
    20.00 deg
    """
    frame, called = _table(table, name)
    return shown_fit(fit_table(frame, FitRequest(_model_name(model), **options), name=called)[0])


def compare(
    table: Table,
    models: str | type[Model] | Sequence[str | type[Model]] = ("all",),
    *,
    name: str | None = None,
    ior: Ior = None,
    wavelength_nm: float | None = None,
    normalise: Normalise = "mirror",
    metric: str | None = None,
    u_rel: float | None = None,
) -> ShownComparison:
    """Fit several models to a table, and say which the data ask for (`Dataset.choice`).

    Parameters
    ----------
    table, name
        As in `fit`.
    models
        Names or classes; "all" for every model, with sums and n + ik.
    ior
        Optical constants n + ik or a material, for the models that have any.
    wavelength_nm
        The nearest wavelength of the table is fitted (550 nm if none is given).
    normalise
        What the curves of polar plots are divided by.
    metric
        What fits make small, as `--metric`: "weighted", "log", "ngan", "cube-root" or "relative".
    u_rel
        Relative standard uncertainty to assume, where the table states none.

    Raises
    ------
    ConfigError, DataError
        As `fit`.

    Examples
    --------
    >>> from gonio_analysis import compare
    >>> found = compare("clay.csv", ["lambert", "oren-nayar"])
    >>> found.choice.named.candidate.label
    'oren-nayar'
    """
    frame, called = _table(table, name)
    names = [_model_name(m) for m in ([models] if isinstance(models, str | type) else models)]
    check_models(names)
    check_metric(metric)
    check_u_rel(u_rel)
    found = examine(
        frame, names, name=called, ior=ior, wavelength_nm=wavelength_nm, normalise=normalise, metric=metric,
        u_rel=u_rel,
    )  # fmt: skip
    return ShownComparison.of(found, "sample")


def change(a: Table | Model, b: Table | Model, *, wavelength_nm: float | None = None) -> point_by_point.Change:
    """B against A, point by point; each is a table, or a model.

    Raises
    ------
    ConfigError, DataError
        As `gonio_analysis.changes.point_by_point.change`.

    Examples
    --------
    >>> from gonio import OrenNayar
    >>> from gonio_analysis import change
    >>> later = change("clay.csv", OrenNayar(albedo=0.54, sigma_deg=20.0))
    >>> print(f"{(later.difference / later.value_a).mean():.2f}")
    -0.11
    """
    return point_by_point.change(_side(a, "A"), _side(b, "B"), wavelength_nm=wavelength_nm)


def polar(
    ax: Any,
    table: Table,
    model: Model | FitResult | None = None,
    *,
    wavelength_nm: float | None = None,
    normalise: Normalise = "mirror",
) -> list[Any]:
    """The curves in the plane of incidence on a half disc, with a model's as the instrument would see it.

    Parameters
    ----------
    ax
        Axes of matplotlib, Cartesian ones.
    table
        As in `fit`.
    model
        A model, or a fit, whose wavelength is taken; None draws the measurement alone.
    wavelength_nm
        The nearest wavelength of the table is drawn (550 nm if none is given).
    normalise
        What curves are divided by: "mirror", "max" or "model".

    Returns
    -------
    list of artists

    Raises
    ------
    ConfigError
        A file of several samples.
    DataError
        No usable value, or no curve in the plane of incidence.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from gonio_analysis import fit, polar
    >>> figure, ax = plt.subplots()
    >>> drawn = polar(ax, "clay.csv", fit("clay.csv", "lambert"))
    >>> figure.savefig("clay.svg")
    >>> plt.close(figure)
    """
    if model is None and normalise == "model":
        raise ArgumentError('normalise = "model": no model is given')
    return on_half_disc(ax, _drawn(table, model, wavelength_nm, normalise), normalise)


def semilog(
    ax: Any, table: Table, model: Model | FitResult | None = None, *, wavelength_nm: float | None = None
) -> list[Any]:
    """The same curves absolute, on a logarithmic axis; arguments, result and errors as `polar`.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from gonio_analysis import semilog
    >>> figure, ax = plt.subplots()
    >>> drawn = semilog(ax, "clay.csv")
    >>> ax.get_yscale()
    'log'
    >>> plt.close(figure)
    """
    return on_logarithm(ax, _drawn(table, model, wavelength_nm, "mirror"))


def _drawn(
    table: Table, model: Model | FitResult | None, wavelength_nm: float | None, normalise: Normalise
) -> list[DrawnCurve]:
    frame, called = _table(table, None)
    if wavelength_nm is None and isinstance(model, FitResult) and np.isfinite(model.wavelength_nm):
        wavelength_nm = model.wavelength_nm
    data, wave = observations(frame, called).nearest(wavelength_nm)
    found = of_data(data, model, wave, normalise)
    if not found:
        raise DataError(f"{called}: no two usable values lie on one curve in the plane of incidence")
    return found


def _model_name(model: str | type[Model] | Model) -> str:
    """The name that fits know it by; a class that no package brought is made known by it."""
    if isinstance(model, str):
        return model
    kind = model if isinstance(model, type) else type(model)
    if not issubclass(kind, Model) or not hasattr(kind, "name"):
        raise ArgumentError(f"model must be a name, or a class of gonio.models.Model with a name, not {kind.__name__}")
    if kind.name != Sum.name:
        plugins.add("gonio.models", kind.name, kind)
    return kind.name


def _table(table: Table, name: str | None) -> tuple[DataFrame, str]:
    """The table of one sample, and what it is called."""
    frames = (
        measurement.tables(table)
        if isinstance(table, (str, Path))
        else channels.joined({n: measurement.unpolarised(part) for n, part in measurement.samples(table).items()})
    )
    if len(frames) > 1:
        raise ConfigError(f"{name or 'the table'} holds {len(frames)} samples: take one, of: {'; '.join(frames)}")
    called, frame = next(iter(frames.items()))
    return frame, name or called or "the table"


def _side(one: Table | Model, letter: str) -> Side:
    if isinstance(one, Model):
        return Side(f"{letter}: {one.name}", letter, model=one)
    frame, called = _table(one, None)
    return of_table(f"{letter}: {called}", called, frame)


in_notebook()
