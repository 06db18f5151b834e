"""Which model will do: what an evaluation of each costs on this machine, against how far it stays off a sample."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import FAINT, INK
from gonio_analysis.report import notebook
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.text import number

from gonio.errors import ConfigError, DataError
from gonio.models import Model, OrenNayar
from gonio.models.parameters import Ior
from gonio.typing import DataFrame, Floats
from gonio_validation.bench import timing
from gonio_validation.bench.page import plain_axes
from gonio_validation.bench.pareto import front
from gonio_validation.bench.quantity import BenchQuantity, Way, directions, reference, to_angles

LIKE = 0.02
"""A cheaper form is as good as the nearest one where the two differ by less than this, or by less than the nearest one
is off the sample."""
PERFECT = 1e-9
"""What a misfit of less is stated as."""
LOWEST = 1e-4
"""What a misfit of less is drawn at: no measurement tells it from this."""
GREY = "#5f6670"


class Form(NamedTuple):
    """A model as it is evaluated: its name in the chart and on the command line, and what is not fitted."""

    label: str
    model: str
    fix: dict[str, float | str] = {}  # noqa: RUF012
    tolerance: float | None = None
    """Of He-Torrance's series, once the default one has been fitted."""


FORMS = (
    Form("Lambert", "lambert"),
    Form("Oren-Nayar, qualitative", "oren-nayar", {"form": "qualitative"}),
    Form("Oren-Nayar, functional", "oren-nayar"),
    Form("Oren-Nayar, exact", "oren-nayar", {"form": "exact"}),
    Form("Phong", "phong"),
    Form("Blinn", "blinn"),
    Form("Cook-Torrance", "cook-torrance"),
    Form("GGX", "ggx"),
    Form("EON", "eon"),
    Form("He-Torrance, 1e-12", "he-torrance", tolerance=1e-12),
    Form("He-Torrance, 1e-9", "he-torrance", tolerance=1e-9),
    Form("He-Torrance, 1e-6", "he-torrance", tolerance=1e-6),
)


class Sample(NamedTuple):
    """What is to be modelled."""

    title: str
    table: DataFrame
    ior: Ior = None


@dataclass(frozen=True)
class Candidate:
    """A form that was fitted to a sample."""

    form: str
    misfit: float
    """Root mean square of model over sample less 1; values close to 0 count by what the fit takes for small."""
    processor_ns: float
    """An evaluation, summed over threads."""
    off_nearest: float
    """Root mean square, on the same scale, of the difference to the form with the least misfit."""
    on_front: bool
    """Whether no other form is cheaper and nearer."""


@dataclass(frozen=True)
class Compared:
    """All forms on one sample, and what comes of it."""

    sample: str
    candidates: Sequence[Candidate]
    left_out: dict[str, str] = field(default_factory=dict)
    """Forms that could not be fitted, and why."""

    @property
    def words(self) -> str:
        """Which form is nearest, and which cheaper one will do as well."""
        nearest = min(self.candidates, key=lambda c: c.misfit)
        enough = max(LIKE, nearest.misfit)
        cheap = min((c for c in self.candidates if c.off_nearest <= enough), key=lambda c: c.processor_ns)
        words = f"{self.sample}: {nearest.form} is nearest, {_percent(nearest.misfit)} off"
        if cheap is not nearest:
            return f"{words}; {cheap.form} is within {_percent(cheap.off_nearest)} of it at {_cost(cheap, nearest)}."
        words += f", and nothing cheaper is within {_percent(enough)} of it"
        cheaper = [c for c in self.candidates if c.on_front and c is not nearest]
        if not cheaper:
            return f"{words}."
        second = min(cheaper, key=lambda c: c.misfit)
        return f"{words}: {second.form} is {_percent(second.misfit)} off at {_cost(second, nearest)}."


def _cost(of: Candidate, nearest: Candidate) -> str:
    return f"{_percent(of.processor_ns / nearest.processor_ns)} of the cost"


def _percent(share: float) -> str:
    return f"{number(100 * share, 2)} %" if share > PERFECT else f"less than {number(100 * PERFECT, 1)} %"


def built_in() -> list[Sample]:
    """A matt and a metallic sample, in the directions of the reference values."""
    metal = next(g for g in reference().he_torrance if g.set == "common")
    angles = to_angles(np.array(metal.omega_i), np.array(metal.omega_r))
    p = metal.parameters
    return [
        Sample("Rough matt surface", _table(angles, OrenNayar(0.9, 30.0, "exact").brdf(*angles), p["wavelength_nm"])),
        Sample(
            "Rough aluminium", _table(angles, np.array(metal.value), p["wavelength_nm"]), complex(p["n"], p["k"])
        ),
    ]  # fmt: skip


def _table(angles: Sequence[Floats], brdf: Floats, wavelength_nm: float) -> DataFrame:
    import pandas as pd

    theta_i, phi_i, theta_r, phi_r = np.degrees(angles)
    return pd.DataFrame(
        {
            "theta_i_deg": theta_i, "phi_i_deg": phi_i % 360.0, "theta_r_deg": theta_r, "phi_r_deg": phi_r % 360.0,
            "wavelength_nm": wavelength_nm, "polarisation": "unpolarised", "brdf": brdf,
            "u_brdf": math.nan, "u_random": math.nan, "flag": "",
        }
    )  # fmt: skip


def compared(sample: Sample, effort: timing.Effort, progress: Callable[[str], None]) -> Compared:
    """Fit every form to a sample by its relative differences, and time what was fitted.

    Raises
    ------
    DataError
        None can be fitted.
    """
    found: dict[str, _Fitted] = {}
    left_out = {}
    for form in FORMS:
        progress(f"{sample.title}: {form.label}")
        try:
            found[form.label] = _fitted(sample, form)
        except (ConfigError, DataError) as error:  # as a model with a length in a broad band
            left_out[form.label] = str(error)
    if not found:
        raise DataError(f"{sample.title}: no model can be fitted: {next(iter(left_out.values()))}")
    taken = _times({label: one.model for label, one in found.items()}, effort)
    misfits = {label: math.hypot(_rms(one.residuals), one.inexact) for label, one in found.items()}
    nearest = found[min(misfits, key=lambda label: misfits[label])]
    off = {label: math.hypot(_rms(one.residuals - nearest.residuals), one.inexact) for label, one in found.items()}
    best = front([(taken[label], misfits[label]) for label in found])
    rows = [Candidate(label, misfits[label], taken[label], off[label], k in best) for k, label in enumerate(found)]
    return Compared(sample.title, rows, left_out)


class _Fitted(NamedTuple):
    model: Any
    residuals: Floats
    """Relative differences of the fit to the sample."""
    inexact: float
    """What a coarser tolerance adds to them, root mean square."""


def _fitted(sample: Sample, form: Form) -> _Fitted:
    fit = notebook.fit(sample.table, form.model, fix=form.fix, ior=sample.ior, metric="relative")
    if form.tolerance is None:
        return _Fitted(fit.model, fit.whitened, 0.0)
    coarse = replace(fit.model, tolerance=form.tolerance)
    above = fit.predicted > 0.0
    return _Fitted(coarse, fit.whitened, _rms(apparent(coarse, fit.data)[above] / fit.predicted[above] - 1.0))


def _times(models: dict[str, Model], effort: timing.Effort) -> dict[str, float]:
    """Processor time [ns] of an evaluation of each, in directions even over the hemisphere."""

    def way(label: str) -> Way:
        return Way(label, lambda p: models[label].brdf_vectors)

    ways = tuple(map(way, models))
    quantity = BenchQuantity("", "", "", (), lambda count: [({}, directions(count))], "", ways)
    return {label: time.processor_ns for label, time in timing.times(quantity, effort).items()}


def _rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x**2)))


def draw(samples: Sequence[Compared]) -> Figure:
    """ns an evaluation against misfit, a panel a sample, with the Pareto front."""
    forms = list(dict.fromkeys(c.form for s in samples for c in s.candidates))
    rows = math.ceil(len(forms) / 3)
    height = 3.4 + 0.2 * rows

    def on(figure: Any) -> None:
        axes = figure.subplots(1, len(samples), sharey=True, squeeze=False)[0]
        figure.subplots_adjust(0.12, (0.62 + 0.2 * rows) / height, 0.985, 1 - 0.24 / height, wspace=0.06)
        for ax, sample in zip(axes, samples, strict=True):
            _panel(ax, sample, forms)
        axes[0].set_ylabel("misfit (relative, root mean square)", fontsize=8)
        for k, form in enumerate(forms):
            x, y = 0.1 + 0.3 * (k // rows), (0.2 * (rows - k % rows) - 0.06) / height
            figure.text(x, y, f"{k + 1}  {form}", fontsize=7.5, va="center", color=INK)

    caption = (
        "Processor time of one evaluation here against the misfit that is left after the fit. Line: Pareto front. "
        f"Misfits below {LOWEST:g} are drawn at the lower edge."
    )
    alt = " ".join(s.words for s in samples)
    return rendered("which-model", "front", "which-model", caption, alt, (6.4, height), on)


def _panel(ax: Any, sample: Compared, forms: Sequence[str]) -> None:
    points = [(c.processor_ns, max(c.misfit, LOWEST), c) for c in sample.candidates]
    steps = sorted((x, y) for x, y, c in points if c.on_front)
    ax.step(*zip(*steps, strict=True), where="post", color="#9fb8d6", lw=1.2, zorder=1)
    for x, y, c in points:
        ax.plot([x], [y], marker="o", ms=4.5, color=COLOURS[0] if c.on_front else GREY, zorder=4)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(0.5 * LOWEST, 2.0 * max(y for _, y, _ in points))
    ax.margins(x=0.12)
    for (x, y, c), place in zip(points, _beside(ax, [(x, y) for x, y, _ in points]), strict=True):
        colour = COLOURS[0] if c.on_front else GREY
        ax.annotate(
            str(forms.index(c.form) + 1), (x, y), place, textcoords="offset points", fontsize=7, color=colour,
            ha="center", va="center", zorder=5, arrowprops={"arrowstyle": "-", "color": FAINT, "lw": 0.6, "shrinkB": 2},
        )  # fmt: skip
    ax.set_xlabel("ns an evaluation", fontsize=8)
    ax.set_title(sample.sample, fontsize=8, loc="left", color=INK)
    plain_axes(ax)


def _beside(ax: Any, points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Where the number of each point stands from it [pt]: off all points, and off the numbers placed before."""
    at = ax.transData.transform(points) * 72.0 / ax.figure.dpi
    low, high = ax.transAxes.transform([(0.0, 0.0), (1.0, 1.0)]) * 72.0 / ax.figure.dpi
    turns = np.arange(0.5, 8.0) * 2.0 * np.pi / 8
    tried = np.array([(r * math.cos(t), r * math.sin(t)) for r in range(9, 80, 3) for t in turns])
    taken = list(at)
    out = []
    for point in at:
        places = point + tried
        room = np.min(np.linalg.norm(places[:, None] - np.array(taken), axis=-1), axis=1)
        room[np.any((places < low + 5.0) | (places > high - 5.0), axis=1)] = 0.0
        free = room >= 8.5
        best = int(np.argmax(free)) if free.any() else int(np.argmax(room))
        taken.append(places[best])
        out.append((float(tried[best][0]), float(tried[best][1])))
    return out
