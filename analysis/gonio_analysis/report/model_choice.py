"""The section "Which model" of a report: what was tried, from the simplest up, and what the data say of it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from gonio.shown import interval
from gonio_analysis.report.blocks import Block, Heading, Notes, Paragraph, Table, Text, code, table
from gonio_analysis.report.text import glued, number, percent, with_u
from gonio_analysis.report.verdict import times
from gonio_analysis.result_records import CandidateSummary, ChoiceSummary, IntervalSummary


def section(choice: ChoiceSummary, alone_nm: float | None = None) -> list[Block]:
    """The section; nothing where one model alone was tried.

    Parameters
    ----------
    choice
        As `gonio_analysis.selection.choice.Choice.summary` has it.
    alone_nm
        The wavelength that it was made at, where the models shown afterwards share the geometry of several.
    """
    tried = choice.candidates
    if len(tried) < 2:
        return []
    stated = any(c.reduced_chi_square is not None for c in tried)
    aic, bic = (min(x for x in xs if x is not None) for xs in ([c.aic for c in tried], [c.bic for c in tried]))
    rows = [
        [
            c.label,
            str(c.n_free),
            number(c.reduced_chi_square),
            number(None if c.aic is None else c.aic - aic),
            number(None if c.bic is None else c.bic - bic),
            number(c.held_out),
            f"{c.wall_s:.1f} s",
            _verdict(c),
            _fails(c),
        ]
        for c in tried
    ]
    marks = ["best" if c.label == choice.named else "" for c in tried]
    out: list[Block] = [Heading(3, "Which model"), Paragraph(glued(choice.words))]
    if alone_nm is not None:
        out.append(
            Paragraph(
                f"The choice is made at {alone_nm:g} nm alone, and so are the numbers of this section. The models below"
                " are fitted to all wavelengths together, with one geometry."
            )
        )
    # of a chi-square the region with the largest part of it, else the one whose median is farthest from the measurement
    fails = "largest excess of χ²" if stated else "farthest off, by the median of a region"
    out.append(
        table(
            "From the simplest up. AIC and BIC are differences to the lowest; the held-out error is the mean squared"
            f" residual{', in units of the uncertainty,' if stated else ''} of values left out by"
            f" {choice.held_out_by}. A model is {'rejected' if stated else 'behind'} where"
            + (f" the probability of its chi-square is below {100 * choice.significance:g} %, or where" * stated)
            + f" another is better by more than {choice.decisive_aic:g} in AIC.",
            ["model", "parameters", "reduced χ²", "ΔAIC", "ΔBIC", "held-out", "time", "verdict", fails],
            rows,
            right=(1, 2, 3, 4, 5, 6),
            marks=marks,
        )
    )
    if choice.intervals:
        out.append(_intervals(choice))
    if choice.left_out:
        out.append(Notes(tuple(f"{m} was not tried: {why}." for m, why in choice.left_out.items())))
    return out


def _verdict(c: CandidateSummary) -> str:
    """Without the chi-square that stands beside it."""
    why = re.sub(r"^reduced chi-square \S+ \((.*)\)$", r"\1", c.rejected)
    if c.reduced_chi_square is None:
        return f"behind: {why}" if why else "as near as any"
    return f"rejected: {why}" if why else "not rejected"


def _fails(c: CandidateSummary) -> str:
    region = c.fails
    if region is None or (not c.rejected and c.reduced_chi_square is not None):
        return ""
    off = [f"model {times(region.ratio)}"] if region.ratio is not None and abs(region.ratio - 1) >= 1e-3 else []
    share = [f"{percent(region.share)} of it"] if c.reduced_chi_square is not None else []
    return f"{region.words}: {', '.join(share + off)}"


def in_words(i: IntervalSummary, value: float | None) -> tuple[str, str]:
    """A parameter's value and its interval, both to the digits that the interval leaves."""
    low, high, middle = interval(i.low, i.high, i.low if value is None else value)
    ends = (low + " (bound)" * i.open_low, high + " (bound)" * i.open_high)
    return "–" if value is None else middle, " to ".join(ends)


def _intervals(choice: ChoiceSummary) -> Table:
    named = next(c for c in choice.candidates if c.label == choice.named)
    rows: list[Sequence[Text]] = []
    for name, i in choice.intervals.items():
        p = named.parameters[name]
        # an error of the linearised fit beside an interval that contradicts it would be two truths
        value, ends = in_words(i, p.value)
        rows.append([code(name), with_u(p.value, p.u) if i.linear else value, ends])
    return table(
        f"Parameters of {named.label} with profile-likelihood intervals: each is held while all others follow.",
        ["parameter", "value and standard error (where it says the same as the interval)", "95 % interval"],
        rows,
    )
