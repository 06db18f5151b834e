"""The two tables of a sample's models: all that were tried, and the parameters of the one that is put first."""

import math
from collections.abc import Sequence

from gonio.checks.values import NORMAL_95
from gonio.models import Model, Sum
from gonio.models.parameters import described
from gonio.shown import interval
from gonio_analysis.fitting.solution import Estimate
from gonio_analysis.report import verdict
from gonio_analysis.report.blocks import Block, Heading, Span, Table, Text, code, plain, table, term
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.text import difference, number, percent, with_u
from gonio_analysis.selection.compare import FittedModel
from gonio_analysis.selection.judging import Judged
from gonio_analysis.selection.regions import WorstRegion

FEW, NEAR = 8, 6
"""Models whose table fits beside the plot as it is; and the best of more that stand there."""
SHORT = 18
"""Characters of a name that stay on one line."""
TOO_BRIGHT = term(
    "⚠ too bright", "It reflects more light than it receives at an angle of incidence: see Energy. --energy forbids it."
)
OFF = term("off by", f"How far the model is from the sample, typically, over all directions. {verdict.MISFIT}")
TYPICAL = term("off by", "The root mean square of ln(model / measured), over all directions.")
WORST = term("worst", "The region of angles in which the model is farther off than it typically is.")
FREE = term("free", "How many parameters were fitted.")
TIME = term("time", "Of the fit and of its judgement, on the computer that made this page.")


def beside_plot(d: DatasetSummary) -> Table:
    """`compared`; of many models the best ones, without where they are worst and the time."""
    every = compared(d)
    if len(every.rows) <= FEW:
        return every
    kept = [k for k, name in enumerate(every.header) if plain(name) not in (plain(WORST), plain(TIME))]
    rows = [[row[k] for k in kept] for row in every.rows[:NEAR]]
    header = [every.header[k] for k in kept]
    return table(every.caption, header, rows, right=(1,), marks=every.marks[:NEAR], draws=every.draws[:NEAR])


def below_plot(d: DatasetSummary) -> list[Block]:
    """Of many models all of them, to be folded."""
    every = compared(d)
    count = len(every.rows)
    more = f"{count - NEAR} more, and where each is worst"
    return [Heading(3, f"All {count} models", more), every] if count > FEW else []


def compared(d: DatasetSummary) -> Table:
    """Every model, the best first: how far off it is, where, and what the data say; a click draws it in the plot."""
    judged = {j.candidate.label: j for j in d.choice.judged}
    shared = any(f.fit.shared is not None for f in d.models.values())
    # models that were tried at one wavelength alone have no numbers of all wavelengths
    labels = list(d.models) if shared else [*(label for label in judged if label not in d.models), *d.models]
    labels.sort(key=lambda label: (label != d.best, judged[label].aic if label in judged else math.inf))
    alone = all(f.fit.tau is None for f in d.models.values())
    rows = [_row(d, label, judged.get(label), alone) for label in labels]
    header: list[Text] = ["model", FREE, TYPICAL if alone else OFF, WORST, "verdict", TIME]
    caption = ""
    if shared and (together := next(f.fit.shared for f in d.models.values() if f.fit.shared is not None)):
        caption = f"Fitted to {len(together.wavelengths_nm)} wavelengths together, with one geometry."
    marks = ["best" if label == d.best and len(labels) > 1 else "" for label in labels]
    return table(caption, header, rows, right=(1, 5), marks=marks, draws=labels)


def _row(d: DatasetSummary, label: str, j: Judged | None, alone: bool) -> list[Text]:
    f = d.models.get(label)
    fit = f.fit if f is not None else j.fit if j is not None else None
    assert fit is not None
    typical = verdict.misfit_words(fit.tau) if f is None or not alone else off_by(f)
    missed = f.missed if f is not None else j.fails if j is not None else None
    said: Text = verdict.brief(d.choice, label, fit)
    if f is not None and f.reflects_too_much:
        said = (f"{said}; ", TOO_BRIGHT)
    wall = "–" if j is None else f"{j.wall_s:.1f}\u00a0s"
    name: Text = Span(label, "name") if len(label) <= SHORT else label
    return [
        name,
        str(len(fit.free)),
        typical,
        _worst(missed, rejected=fit.rejected or fit.chi_square is None),
        said,
        wall,
    ]


def off_by(f: FittedModel) -> str:
    """How far off a model is: its misfit, or where a fit states none the root mean square of ln(model / measured)."""
    return difference(f.metrics["log_ratio"]) if f.fit.tau is None else verdict.misfit_words(f.fit.tau)


def _worst(missed: WorstRegion | None, *, rejected: bool) -> str:
    return missed.off if missed is not None and rejected and missed.typical >= missed.misfit else ""


def chosen(d: DatasetSummary) -> list[Block]:
    """The parameters of the model that is put first: value, standard uncertainty, 95 % interval, correlations."""
    return [Heading(3, f"Parameters of {d.best}"), parameters(d, [d.best])] if d.best else []


def parameters(d: DatasetSummary, of: Sequence[str]) -> Table:
    """The parameters of some models."""
    rows: list[Sequence[Text]] = []
    for name in of:
        label, f = name, d.models[name]
        told = _meanings(f.fit.model)
        for p, e in [*f.fit.parameters.items(), *f.fit.derived.items()]:
            row = [Span(p, "code", meaning=told.get(p, "")), *_value(d, name, p, e), _remark(f, p, e)]
            rows.append(row if len(of) == 1 else [label, *row])
            label = ""
    interval = term("95 % interval", " ".join(_of_intervals(d, of)))
    header: list[Text] = ["parameter", "value ± u", interval, "remarks"]
    return table(
        " ".join(_of_errors([d.models[m] for m in of], d)), header if len(of) == 1 else ["model", *header], rows
    )


def _meanings(model: Model) -> dict[str, str]:
    """What the parameters of a fitted model are, in a line each."""
    return described(*(type(term) for term, _ in model.terms)) if isinstance(model, Sum) else described(type(model))


def _value(d: DatasetSummary, model: str, parameter: str, e: Estimate) -> tuple[str, str]:
    """A parameter with its standard uncertainty, and its interval of 95 %."""
    named = d.choice.named
    i = d.choice.intervals.get(parameter) if named and model == named.candidate.label else None
    if i is not None and d.models[model].fit.shared is None:  # intervals are of the choice, at one wavelength alone
        value, ends = verdict.in_words(i, e.value)
        # a standard error beside an interval that contradicts it would be two truths
        return (with_u(e.value, e.u) if d.choice.linear(parameter) else value), ends
    if e.fixed or e.u is None or not math.isfinite(e.u):
        return with_u(e.value, 0.0 if e.fixed else e.u) + (f" ({e.material})" if e.material else ""), ""
    if parameter in d.models[model].fit.derived:
        return with_u(e.value, e.u), ""
    problem = d.models[model].fit.problem
    lowest, highest = (problem.values(end)[parameter] for end in problem.bounds)
    below, above = e.value - NORMAL_95 * e.u, e.value + NORMAL_95 * e.u
    low, high, _ = interval(max(below, lowest), min(above, highest), e.value)
    return with_u(e.value, e.u), f"{low}{' (bound)' * (below < lowest)} to {high}{' (bound)' * (above > highest)}"


def _remark(f: FittedModel, parameter: str, e: Estimate) -> Text:
    """What a parameter trades with, or why it has no uncertainty."""
    parts: list[Text] = []
    if parameter in f.fit.derived:
        parts.append("follows from the others")
    elif e.fixed:
        parts.append("fixed")
    if e.at_bound:
        parts.append(f"at its {e.at_bound} bound")
    told = f.fit.model.parameter_notes
    parts += [told[parameter]] if parameter in told else []
    parts += _strongest(f, parameter)
    joined: list[str | Span] = []
    for k, one in enumerate(parts):
        joined += ["; "] * bool(k)
        joined += one if isinstance(one, tuple) else [one]
    return tuple(joined)


def _strongest(f: FittedModel, parameter: str) -> list[Text]:
    if parameter not in f.fit.free:
        return []
    row = dict(zip(f.fit.free, f.fit.correlation[f.fit.free.index(parameter)].tolist(), strict=True))
    known = {k: v for k, v in row.items() if k != parameter and math.isfinite(v)}
    if not known:
        return []
    other = max(known, key=lambda k: abs(known[k]))
    return [("trades with ", code(other), f" (correlation {number(known[other], 2)})")]


def _of_intervals(d: DatasetSummary, of: Sequence[str]) -> list[str]:
    said = []
    named = d.choice.named.candidate.label if d.choice.named else None
    if named in of and d.choice.intervals:
        said.append("Of a model that is not rejected: each is held while all others follow (profile likelihood).")
    said.append("Otherwise the value ± 1.96 u, as of a normal distribution.")
    return said


def _of_errors(fits: Sequence[FittedModel], d: DatasetSummary) -> list[str]:
    """What the standard uncertainties of these models are, in sentences."""
    off = [f.fit.misfit is not None for f in fits]
    said = []
    if not all(off):
        said.append(
            "Standard uncertainties come from the scatter of the residuals, by the metric of the fit."
            if all(f.fit.chi_square is None for f in fits)
            else f"Standard uncertainties rest on the assumed {percent(d.data.u_rel_assumed)} of each value."
            if d.data.u_rel_assumed is not None
            else "Standard uncertainties follow from those of the values, by least squares with their covariance."
        )
    if any(off):
        said.append(
            "Of a model with a misfit the parameters are those of the nearest one over the measured directions;"
            " u says by how much they change where a part of the directions is left out."
        )
    return said


def fitted_words(d: DatasetSummary, model: str, f: FittedModel) -> str:
    """The fitted parameters of a model, with their uncertainties."""
    said = ", ".join(f"{n} = {_in_line(d, model, n, p)}" for n, p in f.fit.parameters.items() if not p.fixed)
    if f.fit.shared is not None:
        said += f"; geometry shared by {len(f.fit.shared.wavelengths_nm)} wavelengths"
    return said


def _in_line(d: DatasetSummary, model: str, parameter: str, e: Estimate) -> str:
    value, ends = _value(d, model, parameter, e)
    return value if "±" in value or not ends else f"{value} (95 % interval {ends})"
