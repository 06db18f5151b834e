"""The checks of a measurement: each with its figure of merit and verdict, and what they rest on as small figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.checks import verdicts
from gonio.checks.symmetry import Pairs, repeats
from gonio.checks.values import CheckedValues
from gonio.checks.verdicts import Check
from gonio_analysis.plots.in_plane import COLOURS, clean
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import Block, Figures, Heading, Notes, Paragraph, Text, strong, table
from gonio_analysis.report.drawings import Drawing, Figure
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import angle, number, with_u
from gonio_analysis.result_records import ChecksSummary, Reflectance

KIND = "checks"
MARKS = {"ok": "✓\u00a0ok", "look": "▲\u00a0look", "bad": "✕\u00a0bad", "undetermined": "undetermined"}
MOST_DRAWN = 200
"""Pairs and visits of a panel, evenly taken."""
PANEL_IN = 1.85


def summary(
    data: CheckedValues, known: Sequence[Pairs], provenance: dict[str, Any], bands: Sequence[str]
) -> ChecksSummary:
    """The checks of the values of one wavelength, and of the run that measured them in some bands."""
    read = [Check.from_json(one) for one in provenance.get("checks") or []]
    kept = [one for one in read if one is not None]
    values = verdicts.of_values(data)
    here = {one.name for one in values}
    of_run = [one for one in kept if one.band in bands and one.name not in here]
    given = [v for v in provenance.get("reference") or [] if isinstance(v, dict) and v.get("band") in bands]
    visits = given[0] if given and given[0].get("times_s") else {}
    found = [*known, *(one for one in [repeats(data)] if one is not None)]
    return ChecksSummary(
        checks=[*values, *of_run],
        differences={one.kind: _thinned(sorted(one.logs)) for one in found},
        visits_h=_thinned([(t - visits["times_s"][0]) / 3600.0 for t in visits.get("times_s", [])]),
        visits=_thinned([float(v) for v in visits.get("signals", [])]),
    )


def draw(c: ChecksSummary | None, rho: Sequence[Reflectance], slug: str) -> list[Drawing]:
    """One figure of up to three panels; none where there is nothing to see."""
    if c is None:
        return []
    panels = _panels(c, rho)
    if not panels:
        return []
    captions = {
        "pairs": "differences of pairs that should be alike, in ascending order",
        "visits": "signal of the white reference against time, relative to its mean",
        "energy": "directional-hemispherical reflectance of the measurement, with two standard uncertainties; above"
        " the line at 1 more light leaves the sample than falls on it",
    }
    caption = (
        ("Checks, from left to right: " if len(panels) > 1 else "Checks: ")
        + "; ".join(captions[name] for name in panels)
        + "."
    )
    alt = " ".join(f"{one.name}: {one.verdict}, {one.figure}." for one in c.checks)
    size = (0.35 + 2.05 * max(len(panels), 2), PANEL_IN)
    return [Drawing(f"{slug}-checks", KIND, "", caption, alt, size, partial(_on, panels=panels, c=c, rho=list(rho)))]


def section(c: ChecksSummary | None, rho: Sequence[Reflectance], figures: Sequence[Figure]) -> list[Block]:
    """The table of checks, what would tell those that are not determined, and reflectances with both uncertainties."""
    if c is None or not c.checks:
        return []
    out: list[Block] = [Heading(3, "Checks"), Paragraph(in_words(c) + ".")]
    rows: list[Sequence[Text]] = [
        [one.name, MARKS[one.verdict], one.figure, one.limit if one.verdict != "undetermined" else "–"]
        for one in c.checks
    ]
    out.append(table("", ["check", "verdict", "what was found", "the limit"], rows))
    advice = [(strong(one.name), f": {one.advice}.") for one in c.checks if one.advice and one.verdict != "ok"]
    if advice:
        out.append(Notes(tuple(advice)))
    if figures:
        out.append(Figures(tuple(figures)))
    own = [r for r in rho if r.rho_dh is not None]
    if own:
        known = any(r.u_values is not None for r in own)
        head = ["θi", "rho_dh", "u of the values, full covariance", "the same, points independent", "u of the sampling"]
        parts = [(r.u_values, r.u_independent, r.u_sampling) for r in own]
        body = [[angle(r.theta_i_deg), with_u(r.rho_dh, r.u), *map(_u, us)] for r, us in zip(own, parts, strict=True)]
        words = (
            "Directional-hemispherical reflectance of the measurement itself. The standard uncertainty that the values"
            " give it, with their full covariance, stands beside the one that they would give were all points"
            " independent. What the sampling leaves open is added in squares."
            if known
            else "Directional-hemispherical reflectance of the measurement itself. The table states no uncertainties:"
            " only what the sampling leaves open is known."
        )
        out.append(table(words, head if known else [*head[:2], *head[4:]],
                         body if known else [[*row[:2], *row[4:]] for row in body], right=(1, 2, 3, 4)))  # fmt: skip
    return out


def in_words(c: ChecksSummary) -> str:
    """How many are fine, and which are not."""
    counts = Counter(one.verdict for one in c.checks)
    determined = len(c.checks) - counts["undetermined"]
    ok = f"{counts['ok']} of {determined} checks {'is' if counts['ok'] == 1 else 'are'} ok"
    parts = [ok if determined else "No check is determined by these values"]
    for verdict, words in (
        ("bad", "bad"),
        ("look", "worth a look"),
        ("undetermined", "not determined by these values"),
    ):
        names = [one.name for one in c.checks if one.verdict == verdict]
        parts += [f"{words}: {', '.join(names)}"] if names else []
    return "; ".join(parts)


def _u(u: float | None) -> str:
    return "–" if u is None else number(u, 2)


def _thinned(values: Sequence[float]) -> list[float]:
    picks = np.unique(np.linspace(0, len(values) - 1, min(len(values), MOST_DRAWN)).round().astype(int))
    return [float(values[k]) for k in picks] if len(values) else []


def _panels(c: ChecksSummary, rho: Sequence[Reflectance]) -> list[str]:
    there = {"pairs": bool(c.differences), "visits": len(c.visits) > 1, "energy": any(r.rho_dh for r in rho)}
    return [name for name, has in there.items() if has]


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
            far = max(abs(log) for logs in c.differences.values() for log in logs) > np.log(2.0)
            for (kind, logs), colour in zip(c.differences.items(), COLOURS, strict=False):
                place = (np.arange(len(logs)) + 0.5) / len(logs)
                shown = np.asarray(logs) if far else 100 * np.expm1(logs)
                ax.plot(place, shown, ".", ms=2.5, color=colour, label=kind)
            ax.axhline(0.0, lw=0.6, color=FAINT)
            ax.set_xlim(0, 1)
            ax.set_xlabel("share of the pairs", fontsize=7.5)
            ax.set_ylabel("ln(one / other)" if far else "difference [%]", fontsize=7.5)
            ax.legend(fontsize=6.5, frameon=False, handletextpad=0.1, borderpad=0.0, loc="upper left")
            ax.margins(y=0.35)
        elif name == "visits":
            mean = float(np.mean(c.visits))
            ax.plot(c.visits_h, 100 * (np.array(c.visits) / mean - 1.0), "o-", ms=2.5, lw=0.7, color=COLOURS[0])
            ax.axhline(0.0, lw=0.6, color=FAINT)
            ax.set_xlabel("time [h]", fontsize=7.5)
            ax.set_ylabel("reference [%]", fontsize=7.5)
        else:
            own = [r for r in rho if r.rho_dh is not None]
            error = [2 * (r.u or 0.0) for r in own]
            ax.errorbar([r.theta_i_deg for r in own], [r.rho_dh for r in own], error, fmt="o", ms=2.5, lw=0.7,
                        color=COLOURS[0])  # fmt: skip
            ax.axhline(1.0, lw=0.8, color=COLOURS[1])
            ax.set_ylim(bottom=0.0)
            ax.set_xlim(0, 90)
            ax.set_xticks([0, 30, 60, 90])
            ax.set_xlabel("θi [°]", fontsize=7.5)
            ax.set_ylabel("reflectance", fontsize=7.5)


SECTION = Section(
    "checks",
    lambda d, figures: section(d.checks, d.rho_dh, figures.get(KIND, ())),
    lambda d, facts: draw(facts.checks, facts.rho_dh, facts.slug),
)
