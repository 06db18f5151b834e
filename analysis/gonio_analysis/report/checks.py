"""The checks of a measurement: each with its figure of merit and verdict, and what they rest on as small figures."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.checks.symmetry import Pairs, repeats
from gonio.checks.values import CheckedValues
from gonio.checks.verdicts import Check, of_values
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.plots.in_plane import COLOURS, clean, style
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import Block, Figures, Heading, Notes, Paragraph, Span, Table, Text, strong, table
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import angle, number, with_u
from gonio_analysis.result_records import ChecksSummary, Reflectance

KIND = "checks"
MARKS = {"ok": "✓\u00a0ok", "look": "▲\u00a0look", "bad": "✕\u00a0bad", "undetermined": "undetermined"}
WORDS = {"bad": "bad", "look": "worth a look", "undetermined": "not determined by these values"}
PARTS = {
    "u_values": "u of the values, full covariance",
    "u_independent": "the same, points independent",
    "u_sampling": "u of the sampling",
}
MOST_DRAWN = 200
"""Pairs and visits of a panel, evenly taken."""
PANEL_IN = 1.85


def summary(
    data: CheckedValues, known: Sequence[Pairs], provenance: dict[str, Any], bands: Sequence[str]
) -> ChecksSummary:
    """The checks of the values of one wavelength, and of the run that measured them in some bands."""
    kept = [one for one in map(Check.from_json, provenance.get("checks") or []) if one is not None]
    values = of_values(data)
    here = {one.name for one in values}
    given = [v for v in provenance.get("reference") or [] if isinstance(v, dict) and v.get("band") in bands]
    visits = given[0] if given and given[0].get("times_s") else {"times_s": [], "signals": []}
    again = repeats(data)
    return ChecksSummary(
        checks=[*values, *(one for one in kept if one.band in bands and one.name not in here)],
        differences={one.kind: _thinned(sorted(one.logs)) for one in [*known, *([] if again is None else [again])]},
        visits_h=_thinned([(t - visits["times_s"][0]) / 3600.0 for t in visits["times_s"]]),
        visits=_thinned([float(v) for v in visits.get("signals", [])]),
    )


def draw(c: ChecksSummary | None, rho: Sequence[Reflectance], slug: str) -> list[Drawing]:
    """One figure of up to three panels; none where there is nothing to see."""
    if c is None:
        return []
    there = {"pairs": bool(c.differences), "visits": len(c.visits) > 1, "energy": any(r.rho_dh for r in rho)}
    panels = [name for name, has in there.items() if has]
    if not panels:
        return []
    captions = {
        "pairs": "differences of pairs that should be alike, in ascending order",
        "visits": "signal of the white reference against time, relative to its mean",
        "energy": "directional-hemispherical reflectance of the measurement, with two standard uncertainties; above"
        " the line at 1 more light leaves the sample than falls on it",
    }
    head = "Checks, from left to right" if len(panels) > 1 else "Checks"
    caption = f"{head}: {'; '.join(captions[name] for name in panels)}."
    alt = " ".join(f"{one.name}: {one.verdict}, {one.figure}." for one in c.checks)
    size = (0.35 + 2.05 * max(len(panels), 2), PANEL_IN)
    return [Drawing(f"{slug}-checks", KIND, "", caption, alt, size, partial(_on, panels=panels, c=c, rho=list(rho)))]


def section(c: ChecksSummary | None, rho: Sequence[Reflectance], figures: Sequence[Figure]) -> list[Block]:
    """The table of checks, what would tell those that are not determined, and reflectances with both uncertainties."""
    if c is None or not c.checks:
        return []
    rows: list[Sequence[Text]] = [
        [one.name, MARKS[one.verdict], one.figure, one.limit if one.verdict != "undetermined" else "–"]
        for one in c.checks
    ]
    advice = [(strong(one.name), f": {one.advice}.") for one in c.checks if one.advice and one.verdict != "ok"]
    out: list[Block] = [
        Heading(3, "Checks", in_words(c)),
        table("", ["check", "verdict", "what was found", "the limit"], rows),
        Notes(tuple(advice)),
        Figures(tuple(figures)),
    ]
    own = [r for r in rho if r.rho_dh is not None]
    return [*out, _reflectances(own)] if own else out


def _reflectances(own: Sequence[Reflectance]) -> Table:
    """Those of the measurement itself, with what their uncertainties are made of."""
    known = any(r.u_values is not None for r in own)
    parts = list(PARTS) if known else ["u_sampling"]
    words = "Directional-hemispherical reflectance of the measurement itself. "
    if known:
        words += (
            "The standard uncertainty that the values give it, with their full covariance, stands beside the one that"
            " they would give were all points independent. What the sampling leaves open is added in squares."
        )
    else:
        words += "The table states no uncertainties: only what the sampling leaves open is known."
    rows = [
        [angle(r.theta_i_deg), with_u(r.rho_dh, r.u), *(number(getattr(r, part), 2) for part in parts)] for r in own
    ]
    return table(words, ["θi", "rho_dh", *(PARTS[part] for part in parts)], rows, right=(1, 2, 3, 4))


def bad(c: ChecksSummary | None, slug: str) -> list[Block]:
    """One line for what is wrong with the measurement itself, which leads to the checks of the sample; else nothing."""
    said = [f"{one.name} ({one.figure})" for one in ([] if c is None else c.checks) if one.verdict == "bad"]
    where = Span("Checks", href=f"#{slug}.checks")
    return [Paragraph((strong("Bad: "), f"{', '.join(said)}; see ", where, "."), "note")] if said else []


def in_words(c: ChecksSummary) -> str:
    """How many are fine, and which are not."""
    counts = Counter(one.verdict for one in c.checks)
    determined = len(c.checks) - counts["undetermined"]
    ok = f"{counts['ok']} of {determined} checks {'is' if counts['ok'] == 1 else 'are'} ok"
    if not determined:
        return "none is determined by these values"
    said = ok
    for verdict, words in WORDS.items():
        names = ", ".join(one.name for one in c.checks if one.verdict == verdict)
        said += f"; {words}: {names}" if names else ""
    return said


def _thinned(values: Sequence[float]) -> list[float]:
    return [float(values[k]) for k in evenly(len(values), MOST_DRAWN)]


def _on(figure: Any, *, panels: list[str], c: ChecksSummary, rho: list[Reflectance]) -> None:
    width = figure.get_figwidth()
    axes = figure.subplots(1, max(len(panels), 2), squeeze=False)[0]
    figure.subplots_adjust(0.62 / width, 0.23, 1 - 0.1 / width, 0.96, wspace=0.48)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for ax, name in zip(axes, panels, strict=False):
        clean(ax)
        ax.tick_params(labelsize=7)
        if name == "pairs":
            labels = _pairs(ax, c)
        elif name == "visits":
            visits = 100 * (np.array(c.visits) / float(np.mean(c.visits)) - 1.0)
            ax.plot(c.visits_h, visits, "o-", ms=2.5, lw=0.7, color=COLOURS[0])
            ax.axhline(0.0, lw=0.6, color=FAINT)
            labels = "time [h]", "reference [%]"
        else:
            own = [(r.theta_i_deg, r.rho_dh, 2 * (r.u or 0.0)) for r in rho if r.rho_dh is not None]
            ax.errorbar(*zip(*own, strict=True), fmt="o", ms=2.5, lw=0.7, color=COLOURS[0])
            ax.axhline(1.0, lw=0.8, color=COLOURS[1])
            ax.set(ylim=(0.0, None), xlim=(0, 90), xticks=[0, 30, 60, 90])
            labels = "θi [°]", "reflectance"
        ax.set_xlabel(labels[0], fontsize=7.5)
        ax.set_ylabel(labels[1], fontsize=7.5)


def _pairs(ax: Any, c: ChecksSummary) -> tuple[str, str]:
    """The differences of pairs; what the axes are."""
    far = max(abs(log) for logs in c.differences.values() for log in logs) > np.log(2.0)
    for k, (kind, logs) in enumerate(c.differences.items()):
        place, shown = (np.arange(len(logs)) + 0.5) / len(logs), np.asarray(logs) if far else 100 * np.expm1(logs)
        ax.plot(place, shown, ls="none", ms=2.2, label=kind, **style(k))
    ax.axhline(0.0, lw=0.6, color=FAINT)
    ax.set_xlim(0, 1)
    ax.legend(fontsize=6.5, frameon=False, handletextpad=0.1, borderpad=0.0, loc="upper left")
    ax.margins(y=0.35)
    return "share of the pairs", "ln(one / other)" if far else "difference [%]"


SECTIONS = (
    Section(
        "checks",
        lambda d, figures: section(d.checks, d.rho_dh, figures.get(KIND, ())),
        lambda d, facts: draw(facts.checks, facts.rho_dh, facts.slug),
    ),
)
