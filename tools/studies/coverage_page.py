"""`index.html` of the study `coverage`, and its drawings."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import INK
from gonio_analysis.report import frame
from gonio_analysis.report.blocks import Block, Figures, Page, Paragraph, Table, Text, footer, table
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import number
from gonio_validation.bench.page import (
    Column,
    TableSection,
    held,
    listed,
    made,
    method,
    of_parts,
    part,
    plain_axes,
    two_digits,
    verdict,
)

from gonio.typing import JsonObject
from tools.studies.coverage_judgement import LEVEL, Count

FOOTER = footer(
    "Every number on this page is in `results.json`, a line a campaign in `campaigns.csv`, and what was drawn, "
    "measured and fitted in `campaigns/`."
)
KINDS = {
    "points": "BRDF of one point",
    "joint": "BRDF, all points together",
    "parameters": "fitted parameters",
    "joint parameters": "fitted parameters, all together",
    "wrong": "a model that the sample does not have",
    "calibrated": "calibrated",
}
METHOD = (
    ("truth of a point", "the true sample through the cones of lamp and lens, in the directions that the row states"),
    ("interval of a point", "brdf - 1.96 u_brdf to brdf + 1.96 u_brdf"),
    (
        "all points together",
        "chi-square with diag(u_random^2) + sum of s s^T; inside where its probability is above 5 %",
    ),
    ("interval of a parameter", "profile likelihood, as gonio fit states it"),
)


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _of(group: str) -> str:
    return "all campaigns" if group == "all" else group


PULLS = (
    Column("", "kind", KINDS.__getitem__), Column("of", "group", _of), Column("campaigns", "campaigns"),
    Column("mean", "mean", "{:.2f}".format), Column("its u", "u_mean", "{:.2f}".format),
    Column("standard deviation", "sd", "{:.2f}".format), Column("from", "sd_low", "{:.2f}".format),
    Column("to", "sd_high", "{:.2f}".format), Column("largest", "largest", "{:.2f}".format),
)  # fmt: skip
UNIFORM = (
    Column("test", "what"), Column("campaigns", "campaigns"),
    Column("uniform: p (Kolmogorov-Smirnov)", "p_uniform", two_digits),
    Column("campaigns a bin", "bins", lambda bins: " ".join(map(str, bins))),
)  # fmt: skip
HIDDEN = TableSection(
    "What is hidden", "causes",
    "Drawn anew for every campaign, and read by the simulated devices alone. Distances, the cones of lamp and "
    "lens, the beam, the wavelength, the kind of model and a metal's optical constants are known rightly.",
    (
        Column("error", "name"), Column("hidden", "hidden"),
        Column("what the laboratory knows", "learned", lambda text: text.replace("`", "")),
        Column("here", "on", lambda on: "yes" if on else "off"),
    ),
    (),
)  # fmt: skip
FAR = TableSection(
    "Points far off", "worst",
    "The largest normalised error of a campaign, for the campaigns in which it is largest. Angles in degrees, values"
    " in 1/sr.",
    (
        Column("campaign", "campaign"), Column("model", "model"), Column("plan", "plan"), Column("region", "region"),
        Column("theta_i", "theta_i_deg", "{:.2f}".format), Column("theta_r", "theta_r_deg", "{:.2f}".format),
        Column("dphi", "dphi_deg", "{:.2f}".format), Column("BRDF", "brdf", lambda x: number(x, 4)),
        Column("true", "truth", lambda x: number(x, 4)), Column("u", "u_brdf", two_digits),
        Column("normalised error", "pull", "{:+.2f}".format),
    ),
    tuple(range(4, 11)),
)  # fmt: skip
REFUSED = TableSection(
    "Campaigns that were refused", "refused",
    "A program refused these, and said why. They count nowhere above.",
    tuple(Column(name, name) for name in ("campaign", "model", "plan", "step", "message")),
    (),
)  # fmt: skip


def render(s: JsonObject, figures: Sequence[Figure]) -> Page:
    """The page."""
    what = (
        f", seed {s['seed']}: {s['campaigns']} campaigns, {s['values']} "
        f"values of BRDF, {number(s['seconds'] / max(s['campaigns'], 1), 2)} s of one process a campaign."
    )
    rough = " A quick run: few campaigns of few points." if s["quick"] else ""
    m = s["machine"]
    groups = [c for c in s["counts"] if c.group != "all"]
    folds = parts(
        {
            'section "Coverage by group"': lambda: part(
                "Coverage by group", held(groups, lambda c: c.holds), COVERAGE, _coverage(groups)
            ),
            'section "Normalised errors"': partial(_pulls, s, figures),
        }
    )
    tables = [
        (HIDDEN, f"{len(s['causes'])} errors, drawn anew for every campaign"),
        (FAR, f"the largest normalised errors of {len(s['worst'])} campaigns"),
        *([(REFUSED, f"{len(s['refused'])}")] if s["refused"] else []),
    ]
    folds += of_parts(s, *tables)
    folds += method(s, *METHOD, ("processor", f"{m['cpu']}, {m['cpus']} usable"))
    forest = Figures(tuple(f for f in figures if f.kind == "forest"))
    every = partial(_coverage, [c for c in s["counts"] if c.group == "all"])
    first = frame.answer(parts({"the headline": partial(_lead, s)}), [forest], parts({'table "Coverage"': every}))
    return frame.page(s["title"], made(s, what + rough), first, folds=folds, foot=FOOTER)


def _lead(s: JsonObject) -> Paragraph:
    every = [c for c in s["counts"] if c.group == "all"]
    missed = [KINDS[c.kind] for c in every if not c.holds]
    words = f"Intervals of 95 % hold the truth as often as they say for {len(every) - len(missed)} of {len(every)}"
    words += " quantities"
    words += f", and NOT for: {', '.join(missed)}." if missed else "."
    if s["refused"]:
        words += f" {len(s['refused'])} campaigns were refused by a program, and count nowhere."
    return Paragraph(words, "lead")


COVERAGE = (
    "Frequentist coverage: in how many campaigns the interval of 95 % holds the truth. All values of a campaign share"
    " its errors, so each campaign counts once in a row: by one value that was chosen at random beforehand, or by one"
    " test of all its values. The interval is Clopper and Pearson's; it should contain 95 %. Of many rows up to one in"
    " twenty may miss it by chance alone."
)


def _coverage(counts: Sequence[Count]) -> Table:
    """Rows of one group need no column for it."""
    several = any(c.group != "all" for c in counts)
    rows: list[list[Text]] = [
        [
            KINDS[c.kind], c.group if several else "", str(c.campaigns), str(c.inside),
            _percent(c.inside / c.campaigns), f"{_percent(c.low)} to {_percent(c.high)}", verdict(c.holds),
        ]
        for c in counts
    ]  # fmt: skip
    header = ["", "of", "campaigns", "inside", "coverage", "its interval", "contains 95 %"]
    return table("", header, rows, right=(2, 3, 4))


def _pulls(s: JsonObject, figures: Sequence[Figure]) -> list[Block]:
    words = (
        "A normalised error is (found - true) / u, one a campaign. Its standard deviation should be 1: larger, and "
        "uncertainties are too small; smaller, and they are too large. Intervals are 95 %, of campaigns drawn again. "
        "Probabilities of the tests of all values together are uniform where the stated covariance is right."
    )
    shown = listed(s["pulls"], PULLS, tuple(range(2, 9)))
    caption = "Campaigns by the probability of a larger chi-square, in ten equal bins from 0 to 1."
    uniform = listed(s["uniform"], UNIFORM, (1, 2), caption)
    others = Figures(tuple(f for f in figures if f.kind != "forest"))
    spread = [f"{p['sd']:.2f}" for p in s["pulls"] if p["group"] == "all"]
    result = f"standard deviation {', '.join(spread)}" if spread else f"{len(s['pulls'])} rows"
    return part("Normalised errors", result, words, others, shown, uniform)


# --- drawings -----------------------------------------------------------------------------------------------------


def drawn(s: JsonObject) -> list[Figure]:
    """Every figure of the page that there are campaigns for."""
    out = [_forest(s)] if s["counts"] else []
    if s["single_pulls"]:
        out.append(_histograms(s))
    if s["uniform"]:
        out.append(_probabilities(s))
    return out


def _forest(s: JsonObject) -> Figure:
    rows = list(s["counts"])
    height = 0.9 + 0.19 * len(rows)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.44, 0.55 / height, 0.54, 1.0 - 0.65 / height))
        ax.axvline(100 * LEVEL, color=INK, lw=0.8, ls=(0, (4, 2)), zorder=1)
        names = []
        for k, c in enumerate(rows):
            colour = COLOURS[0] if c.holds else COLOURS[1]
            ax.plot([100 * c.low, 100 * c.high], [k, k], color=colour, lw=1.3, zorder=2)
            ax.plot([100 * c.inside / c.campaigns], [k], marker="o", ms=4, color=colour, zorder=3)
            names.append(f"{KINDS[c.kind]}: {_of(c.group)} ({c.campaigns})")
        ax.set_yticks(range(len(rows)), names, fontsize=7)
        ax.set_ylim(len(rows) - 0.4, -0.6)
        ax.set_xlim(max(0.0, min(80.0, 5.0 * np.floor(min(100 * c.low for c in rows) / 5.0))), 100.5)
        ax.set_xlabel("campaigns whose interval of 95 % holds the truth [%]", fontsize=8)
        plain_axes(ax, "x")

    caption = (
        "Coverage with its binomial interval (95 %, Clopper and Pearson). Dashed: 95 %. Orange: the interval does not "
        "contain it. In brackets: campaigns."
    )
    alt = "Coverage by quantity and group. " + " ".join(
        f"{KINDS[c.kind]}, {_of(c.group)}: {_percent(c.inside / c.campaigns)}." for c in rows
    )
    return rendered("coverage", "forest", "", caption, alt, (7.2, height), on)


def _histograms(s: JsonObject) -> Figure:
    def on(figure: Any) -> None:
        left, right = figure.subplots(1, 2, sharey=True)
        figure.subplots_adjust(0.1, 0.19, 0.985, 0.9, wspace=0.06)
        edges = np.arange(-4.0, 4.01, 0.5)
        x = np.linspace(-4.0, 4.0, 200)
        for ax, values, title in (
            (left, s["single_pulls"], "one point a campaign"),
            (right, s["parameter_pulls"], "one parameter a campaign"),
        ):
            ax.hist(np.clip(values, -3.999, 3.999), edges, color=COLOURS[0], alpha=0.75)
            ax.plot(x, 0.5 * len(values) * np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), color=INK, lw=1.0)
            ax.set_title(title, fontsize=8, loc="left", color=INK)
            ax.set_xlabel("(found - true) / u", fontsize=8)
            plain_axes(ax, "x")
        left.set_ylabel("campaigns", fontsize=8)

    caption = (
        "Normalised errors, with the normal distribution of standard deviation 1. Those beyond 4 stand in the last bin."
    )
    alt = f"Histograms of {len(s['single_pulls'])} errors of points and {len(s['parameter_pulls'])} of parameters."
    return rendered("pulls", "histogram", "", caption, alt, (5.4, 2.6), on)


def _probabilities(s: JsonObject) -> Figure:
    def on(figure: Any) -> None:
        axes = figure.subplots(1, len(s["uniform"]), squeeze=False)[0]
        figure.subplots_adjust(0.09, 0.19, 0.985, 0.9, wspace=0.22)
        for ax, u in zip(axes, s["uniform"], strict=True):
            count = len(u["bins"])
            ax.bar((np.arange(count) + 0.5) / count, u["bins"], 0.92 / count, color=COLOURS[0], alpha=0.75)
            ax.axhline(u["campaigns"] / count, color=INK, lw=1.0)
            ax.set_title(u["what"], fontsize=8, loc="left", color=INK)
            ax.set_xlabel("probability", fontsize=8)
            plain_axes(ax, "x")
        axes[0].set_ylabel("campaigns", fontsize=8)

    caption = (
        "Probability of a larger chi-square. It is uniform (line) where the stated covariance is right; many at 0 mean "
        "that it is too small, many at 1 that it is too large."
    )
    alt = " ".join(f"{u['what']}: {', '.join(map(str, u['bins']))} campaigns in ten bins." for u in s["uniform"])
    return rendered("probabilities", "histogram", "", caption, alt, (7.2, 2.6), on)
