"""The section "Which model" of a report: what was tried, from the simplest up, and what the data say of it."""

import re
from collections.abc import Mapping, Sequence

from gonio.shown import interval
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.fitting.solution import SIGNIFICANCE
from gonio_analysis.report.blocks import Block, Heading, Notes, Paragraph, Table, Text, code, table
from gonio_analysis.report.text import glued, number, percent, with_u
from gonio_analysis.report.verdict import times
from gonio_analysis.result_records import MisfitSummary
from gonio_analysis.selection.choice import Choice
from gonio_analysis.selection.judging import DECISIVE, Judged
from gonio_analysis.selection.misfit_regions import ALIKE

TAU = (
    "Tau is the model's own misfit, relative, with its 95 % interval; of a model that the data do not reject, what"
    " would go unnoticed."
)
"""For tables that have such a column."""


def section(choice: Choice, alone_nm: float | None = None) -> list[Block]:
    """The section; nothing where one model alone was tried.

    Parameters
    ----------
    choice
        What was tried.
    alone_nm
        The wavelength that it was made at, where the models shown afterwards share the geometry of several.
    """
    tried = choice.judged
    if len(tried) < 2:
        return []
    stated = any(c.fit.reduced_chi_square is not None for c in tried)
    aic, bic = (min(xs) for xs in ([c.aic for c in tried], [c.bic for c in tried]))
    rows = [
        [
            c.candidate.label,
            str(len(c.fit.free)),
            misfit_words(c.fit.tau),
            *map(number, (c.fit.reduced_chi_square, c.aic - aic, c.bic - bic, c.held_out)),
            f"{c.wall_s:.1f} s",
            _verdict(c, choice.near),
            _fails(c),
        ]
        for c in tried
    ]
    named = next((c for c in tried if c.candidate.label in choice.near), choice.named)
    marks = ["best" if c is named else "" for c in tried]
    out: list[Block] = [Heading(3, "Which model"), Paragraph(glued(choice.words))]
    chi = "reduced χ²"
    if alone_nm is not None:
        chi += f", {alone_nm:g} nm alone"
        out.append(
            Paragraph(
                f"The choice is made at {alone_nm:g} nm alone, and so are the numbers of this section. The models below"
                " are fitted to all wavelengths together, with one geometry."
            )
        )
    fails = "farthest off, with the median there"
    caption = (
        "From the simplest up. AIC and BIC are differences to the lowest; the held-out error is the mean squared"
        f" residual{', in units of the uncertainty,' * stated} of values left out by"
        f" {choice.held_out_by}. {_rule(choice, stated)}"
    )
    header = ["model", "parameters", "misfit tau", chi, "ΔAIC", "ΔBIC", "held-out", "time", "verdict", fails]
    out.append(table(caption, header, rows, right=(1, 2, 3, 4, 5, 6, 7), marks=marks))
    if choice.intervals:
        out.append(_intervals(choice))
    return [*out, Notes(tuple(f"{m} was not tried: {why}." for m, why in choice.left_out.items()))]


def misfit_words(misfit: MisfitSummary | None) -> str:
    """As in "4.7 % (4 to 5.6)", or "< 0.3 %" where the data do not reject a model."""
    if misfit is None:
        return "–"
    return misfit.words if misfit.value > 0 else f"< {percent(misfit.interval[1])}"


def _verdict(c: Judged, near: Mapping[str, float]) -> str:
    """Without the chi-square that stands beside it."""
    label = c.candidate.label
    if near:
        place = "nearest" if label == next(iter(near)) else "as near" if label in near else "farther off"
        return f"{place}; not true by χ²" if c.fit.reduced_chi_square is not None else place
    why = re.sub(r"^reduced chi-square \S+ \((.*)\)$", r"\1", c.rejected)
    if c.fit.reduced_chi_square is None:
        return f"behind: {why}" if why else "as near as any"
    return f"rejected: {why}" if why else "not rejected"


def _rule(choice: Choice, stated: bool) -> str:
    """By what models are judged, in sentences."""
    said = [TAU] if any(c.fit.tau is not None for c in choice.judged) else []
    if choice.near:
        said.append(
            "The nearest model predicts best, as logarithms, what was left out; another one is as near where the"
            " difference lies within twice its own uncertainty."
        )
    else:
        said.append(
            f"A model is {'rejected' if stated else 'behind'} where"
            + (f" the probability of its chi-square is below {100 * SIGNIFICANCE:g} %, or where" * stated)
            + f" another is better by more than {DECISIVE:g} in AIC."
        )
    return " ".join(said)


def _fails(c: Judged) -> str:
    region = c.fails
    if region is None or (not c.rejected and c.fit.reduced_chi_square is not None):
        return ""
    off = [f"model {times(region.ratio)}"] if region.ratio is not None and abs(region.ratio - 1) >= ALIKE else []
    return f"{region.words}: {', '.join(off)}"


def in_words(i: Interval, value: float | None) -> tuple[str, str]:
    """A parameter's value and its interval, both to the digits that the interval leaves."""
    low, high, middle = interval(i.low, i.high, i.low if value is None else value)
    ends = (low + " (bound)" * i.open_low, high + " (bound)" * i.open_high)
    return "–" if value is None else middle, " to ".join(ends)


def _intervals(choice: Choice) -> Table:
    assert choice.named is not None
    named = choice.named.fit
    rows: list[Sequence[Text]] = []
    for name, i in choice.intervals.items():
        p = named.parameters[name]
        # an error of the linearised fit beside an interval that contradicts it would be two truths
        value, ends = in_words(i, p.value)
        rows.append([code(name), with_u(p.value, p.u) if choice.linear(name) else value, ends])
    how = (
        "intervals by its standard errors"
        if (named.misfit is not None)
        else "profile-likelihood intervals: each is held while all others follow"
    )
    return table(
        f"Parameters of {choice.named.candidate.label} with {how}.",
        ["parameter", "value and standard error (where it says the same as the interval)", "95 % interval"],
        rows,
    )
