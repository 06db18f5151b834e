"""What the study `sweeps` found, judged: the results, `index.html`, and its drawings."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import INK
from gonio_analysis.report import frame
from gonio_analysis.report.blocks import Block, Figures, Page, Paragraph, footer
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import number
from gonio_validation.bench.page import Column, TableSection, listed, made, method, of_parts, part, plain_axes, verdict

from gonio.typing import JsonObject
from tools.studies.campaigns import Record
from tools.studies.sweeps_rig import AROUND_DEG, FLOOR, INCIDENCES, LARGEST_DEG, WAVELENGTH_NM

ENOUGH = 0.005
"""An error that is small enough, whatever a uniform grid has: 0.5 %."""
SHARE = 0.45
"""Largest share of a uniform grid's points that an adaptive plan may take."""
HELD = (0.93, 0.97)
"""Between these lies the part of curves that intervals of 95 % hold, over all runs."""


@dataclass(frozen=True)
class ByPoints:
    """The adaptive plan with a given number of points, beside the uniform grid."""

    sample: str
    runs: int
    uniform_points: float
    points: float
    uniform_interpolated: float
    """Root mean square of the relative error."""
    uniform_process: float
    adaptive: float

    @property
    def allowed(self) -> float:
        """The error of the uniform grid, interpolated in the usual way, or what is small enough."""
        return max(self.uniform_interpolated, ENOUGH)

    @property
    def holds(self) -> bool:
        """Whether the adaptive plan keeps to it."""
        return self.adaptive <= self.allowed and self.points <= SHARE * self.uniform_points


@dataclass(frozen=True)
class Held:
    """How much of the curves the stated intervals of 95 % hold."""

    geometry: str
    sample: str
    """"all" of them, or one."""
    runs: int
    inside: float
    lowest: float
    """Lowest share of any run: a whole curve moves with its scale."""

    @property
    def holds(self) -> bool:
        """Whether it is about 95 %."""
        return HELD[0] <= self.inside <= HELD[1]


def levels(records: Sequence[Record]) -> list[JsonObject]:
    """Results of a plan's size, put together over seeds; of the adaptive plan batch by batch.

    `seconds` is rig time, `rms` the relative error over the curve and the runs, `largest` that of any run, and `inside`
    the part of the curve within its intervals of 95 %.
    """
    groups: dict[tuple[str, str, str, str, int], list[JsonObject]] = {}
    for record in records:
        count: dict[tuple[str, str], int] = {}
        for r in record["results"]:
            place = count[r["plan"], r["way"]] = count.get((r["plan"], r["way"]), -1) + 1
            groups.setdefault((record["sample"], record["geometry"], r["plan"], r["way"], place), []).append(r)
    return [
        dict(zip(("sample", "geometry", "plan", "way"), key[:4], strict=True)) | {
            "runs": len(rs), "points": _mean([r["points"] for r in rs]), "seconds": _mean([r["seconds"] for r in rs]),
            "rms": math.sqrt(_mean([r["rms"] ** 2 for r in rs])), "largest": max(r["largest"] for r in rs),
            "inside": None if rs[0]["inside"] is None else _mean([r["inside"] for r in rs]),
        }
        for key, rs in groups.items()
    ]  # fmt: skip


def of_plan(found: Sequence[JsonObject], geometry: str, sample: str, plan: str, way: str) -> list[JsonObject]:
    """The levels of one plan."""
    wanted = {"geometry": geometry, "sample": sample, "plan": plan, "way": way}
    return [level for level in found if wanted.items() <= level.items()]


def by_points(found: Sequence[JsonObject]) -> list[ByPoints]:
    """For each sample in plane."""
    out = []
    for sample in dict.fromkeys(level["sample"] for level in found):
        adaptive, simple, process = (
            of_plan(found, "in plane", sample, plan, way)
            for plan, way in (("adaptive by points", "process"), ("uniform", "interpolated"), ("uniform", "process"))
        )
        if adaptive and simple and process:
            last, grid, again = adaptive[-1], *(max(v, key=lambda v: float(v["points"])) for v in (simple, process))
            out.append(
                ByPoints(
                    sample, last["runs"], grid["points"], last["points"], grid["rms"], again["rms"], last["rms"],
                )
            )  # fmt: skip
    return out


def held(records: Sequence[Record]) -> list[Held]:
    """What held when the adaptive runs ended: one by one sample, and all together."""
    out = []
    for geometry in dict.fromkeys(r["geometry"] for r in records):
        own = [(r["sample"], _ends(r)) for r in records if r["geometry"] == geometry]
        for sample in ("all", *dict.fromkeys(name for name, _ in own)):
            inside = [x for name, xs in own for x in xs if sample in ("all", name)]
            out.append(Held(geometry, sample, len(inside), _mean(inside), min(inside)))
    return out


def _ends(record: Record) -> list[float]:
    """For every adaptive run of a comparison: the part of the curve within its intervals when it ended."""
    last = {r["plan"]: float(r["inside"]) for r in record["results"] if r["plan"].startswith("adaptive")}
    return list(last.values())


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


# --- results ------------------------------------------------------------------------------------------------------


FOOTER = footer(
    "Every number on this page is in `results.json`, the levels of the plans in `points.csv`, and every run in "
    "`comparisons/`."
)
SHOWN = (
    ("uniform", "interpolated", "uniform, interpolated", "o", "-"),
    ("uniform", "process", "uniform", "o", "--"),
    ("mirror-dense", "process", "mirror-dense", "s", "--"),
    ("half-vector", "process", "half-vector", "^", "--"),
    ("adaptive", "process", "adaptive", "D", "-"),
)
"""Plan, way, name, marker and dashes of what is drawn."""


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"


LEVELS = (
    Column("sample", "sample"), Column("geometry", "geometry"), Column("plan", "label"),
    Column("points", "points", "{:.0f}".format), Column("rig time [min]", "seconds", lambda s: f"{s / 60:.1f}"),
    Column("rms error", "rms", _percent), Column("largest", "largest", _percent),
    Column("in 95 % interval", "inside", lambda part: "–" if part is None else _percent(part)),
)  # fmt: skip
TIME = (
    "Root mean square of the relative error of the curve, over rig time: frames, metering, ways, "
    f"reference, darks. Errors of values below {FLOOR:g} of the largest one count relative to that. Where not said "
    "otherwise curves are made by the Gaussian process, of fixed plans too; interpolated means monotone cubics "
    "through logarithms in plane, and linear ones over triangles out of it."
)
POINTS = TableSection(
    "Points", "by_points",
    f"In plane, with a given number of points in place of a time. Allowed is the error of the uniform grid, "
    f"interpolated, or {100 * ENOUGH:g} % where that is smaller. The same grid with the Gaussian process is there "
    "to tell apart what the points do and what the process does.",
    (
        Column("sample", "", lambda b: b.sample), Column("uniform: points", "", lambda b: f"{b.uniform_points:.0f}"),
        Column("interpolated", "", lambda b: _percent(b.uniform_interpolated)),
        Column("process", "", lambda b: _percent(b.uniform_process)),
        Column("adaptive: points", "", lambda b: f"{b.points:.0f}"),
        Column("error", "", lambda b: _percent(b.adaptive)), Column("kept", "", lambda b: verdict(b.holds)),
    ),
    (1, 2, 3, 4, 5),
)  # fmt: skip
INTERVALS = TableSection(
    "Intervals", "held",
    "Part of the curve, over its positions and over runs, where the stated interval of 95 % holds the truth. "
    f"It should be {100 * HELD[0]:.0f} to {100 * HELD[1]:.0f} % over all. Positions of one run share its scale "
    "and the zeros of its angles, so a single run may have much less.",
    (
        Column("sample", "", lambda h: "all samples" if h.sample == "all" else h.sample),
        Column("geometry", "", lambda h: h.geometry), Column("runs", "", lambda h: str(h.runs)),
        Column("held", "", lambda h: _percent(h.inside)), Column("lowest run", "", lambda h: _percent(h.lowest)),
        Column("kept", "", lambda h: verdict(h.holds) if h.sample == "all" else ""),
    ),
    (2, 3, 4),
)  # fmt: skip


def render(s: JsonObject, figures: Sequence[Figure]) -> Page:
    """The page."""
    runs = "1 run" if s["seeds"] == 1 else f"{s['seeds']} runs"
    what = (
        f": {runs} of every plan on every sample, each "
        f"with errors and noise of its own; {number(s['seconds'] / 60, 2)} min of one processor."
    )
    rough = " A quick run: two samples, in plane alone." if s["quick"] else ""
    rows = [
        own[-1] | {"label": label}
        for name in dict.fromkeys((v["geometry"], v["sample"]) for v in s["levels"])
        for plan, way, label, *_ in SHOWN
        if (own := of_plan(s["levels"], *name, plan, way))
    ]

    def times() -> list[Block]:
        shown = listed(rows, LEVELS, (3, 4, 5, 6, 7), "The largest size of each plan; the adaptive one at its end.")
        return part("Rig time", f"{len(rows)} plans and samples", TIME, Figures(tuple(figures[1:])), shown)

    folds = [*parts({'section "Rig time"': times}), *of_parts(s, (INTERVALS, _intervals(s))), *_method(s)]
    points = partial(listed, s[POINTS.rows], POINTS.columns, POINTS.right, POINTS.words)
    first = frame.answer(
        parts({"the headline": partial(_lead, s)}),
        [Figures(tuple(figures[:1]))],
        parts({f'table "{POINTS.title}"': points}),
    )
    return frame.page(s["title"], made(s, what + rough), first, folds=folds, foot=FOOTER)


def _lead(s: JsonObject) -> Paragraph:
    good = sum(b.holds for b in s["by_points"])
    words = (
        f"With at most {100 * SHARE:.0f} % of the points of a uniform grid, adaptive curves are as good as its "
        f"(or {100 * ENOUGH:g} %) on {good} of {len(s['by_points'])} samples."
    )
    inside = _intervals(s)
    return Paragraph(f"{words} Intervals of 95 % hold {inside}." if inside else words, "lead")


def _intervals(s: JsonObject) -> str:
    """What the intervals of all samples hold, by geometry."""
    each = [
        f"{_percent(h.inside)} {_where(h.geometry)} ({h.runs} adaptive runs)" for h in s["held"] if h.sample == "all"
    ]
    return ", ".join(each)


def _where(geometry: str) -> str:
    return "in plane" if geometry == "in plane" else "over the hemisphere"


def _method(s: JsonObject) -> list[Block]:
    m = s["machine"]
    theta = {g: ", ".join(f"{i:g}" for i in of) for g, of in INCIDENCES.items()}
    return method(
        s,
        ("rig", "sim, without frames: values, noise and times by its description (tools.studies.sweeps_rig)"),
        ("in plane", f"theta_i = {theta['in plane']} deg, theta_r from {-LARGEST_DEG:g} to {LARGEST_DEG:g} deg"),
        ("hemisphere", f"theta_i = {theta['hemisphere']} deg, theta_r up to {LARGEST_DEG:g} deg, both sides"),
        ("wavelength", f"{WAVELENGTH_NM:g} nm"),
        ("mirror-dense", f"half of the points within {AROUND_DEG:g} deg of the mirror direction"),
        ("half-vector", "even in asinh(theta_h/4 deg)"),
        ("truth", "the sample through the cones of lamp and lens, in directions between those of the plans"),
        ("processor", f"{m['cpu']}, {m['cpus']} usable"),
    )


# --- drawings -----------------------------------------------------------------------------------------------------


def drawn(s: JsonObject) -> list[Figure]:
    """A figure for each geometry: a panel for each sample."""
    return [_panels(s, geometry) for geometry in dict.fromkeys(v["geometry"] for v in s["levels"])]


def _panels(s: JsonObject, geometry: str) -> Figure:
    samples = list(dict.fromkeys(v["sample"] for v in s["levels"] if v["geometry"] == geometry))
    across = min(4, len(samples))
    down = -(-len(samples) // across)
    size = (7.4, 0.75 + 1.75 * down)

    def on(figure: Any) -> None:
        axes = figure.subplots(down, across, sharey=True, squeeze=False)
        figure.subplots_adjust(0.085, 0.42 / size[1], 0.985, 1.0 - 0.55 / size[1], wspace=0.08, hspace=0.48)
        handles: list[Any] = []
        for ax, sample in zip(axes.flat, samples, strict=False):
            handles = []
            for k, (plan, way, label, marker, dashes) in enumerate(SHOWN):
                own = of_plan(s["levels"], geometry, sample, plan, way)
                x, y = [v["seconds"] / 60 for v in own], [100 * v["rms"] for v in own]
                colour = INK if plan == "uniform" and way == "interpolated" else COLOURS[(k - 1) % len(COLOURS)]
                handles += ax.plot(x, y, dashes, marker=marker, ms=3, lw=1.1, color=colour, label=label)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_title(sample, fontsize=8, loc="left", color=INK)
            _round_ticks(ax)
        for ax in axes.flat[len(samples) :]:
            ax.set_visible(False)
        for ax in axes[:, 0]:
            ax.set_ylabel("rms error [%]", fontsize=8)
        for ax in axes[-1]:
            ax.set_xlabel("rig time [min]", fontsize=8)
        figure.legend(handles=handles, loc="upper center", ncols=5, fontsize=7.5, frameon=False)

    where = _where(geometry)
    caption = f"{where}: error of the curve over rig time, by plan. Dashed and adaptive: the Gaussian process."
    ends = []
    for sample in samples:
        own = of_plan(s["levels"], geometry, sample, "adaptive", "process")
        if own:
            ends.append(f"{sample}: adaptive {100 * own[-1]['rms']:.2g} % after {own[-1]['seconds'] / 60:.2g} min.")
    return rendered(geometry.replace(" ", "-"), "sweeps", "", caption, f"{where}. " + " ".join(ends), size, on)


def _round_ticks(ax: Any) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

    low, high = ax.get_xlim()
    times = LogLocator(subs=(1.0, 2.0, 5.0)) if high > 5.0 * low else MaxNLocator(3, steps=[1, 2, 5, 10])
    for axis, locator in ((ax.xaxis, times), (ax.yaxis, LogLocator())):
        axis.set_major_locator(locator)
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
        axis.get_major_formatter().set_scientific(False)
    ax.xaxis.set_minor_locator(NullLocator())
    plain_axes(ax)
