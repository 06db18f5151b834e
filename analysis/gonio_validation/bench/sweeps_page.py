"""`index.html` of `gonio bench sweeps`, and its drawings."""

from collections.abc import Sequence
from typing import Any

from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import FAINT, INK
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Group,
    Page,
    Paragraph,
    Text,
    code,
    table,
)
from gonio_analysis.report.drawings import Figure, rendered
from gonio_analysis.report.text import number

from gonio_validation.bench.page import head, method, part, verdict
from gonio_validation.bench.sweeps_plans import AROUND_DEG, FLOOR, INCIDENCES, LARGEST_DEG, WAVELENGTH_NM
from gonio_validation.bench.sweeps_results import ENOUGH, HELD, SHARE, Level, Sweeps

FOOTER = Footer(
    (
        *("Every number on this page is in ", code("results.json"), ", the levels of the plans in "),
        *(code("points.csv"), ", and every run in ", code("comparisons/"), "."),
    )
)
SHOWN = (
    ("uniform", "interpolated", "uniform, interpolated", "o", "-"),
    ("uniform", "process", "uniform", "o", "--"),
    ("mirror-dense", "process", "mirror-dense", "s", "--"),
    ("half-vector", "process", "half-vector", "^", "--"),
    ("adaptive", "process", "adaptive", "D", "-"),
)
"""Plan, way, name, marker and dashes of what is drawn."""


def render(s: Sweeps, figures: Sequence[Figure]) -> Page:
    """The page."""
    links = (("time", "Rig time"), ("points", "Points"), ("intervals", "Intervals"), ("method", "Method"))
    runs = "1 run" if s.seeds == 1 else f"{s.seeds} runs"
    what = (
        f": {runs} of every plan on every sample, each "
        f"with errors and noise of its own; {number(s.seconds / 60, 2)} min of one processor."
    )
    rough = " A quick run: two samples, in plane alone." if s.quick else ""
    body: list[Block] = [
        head(s, what + rough, links),
        _lead(s),
        _time(s, figures),
        _points(s),
        _intervals(s),
        _method(s),
    ]
    return Page(s.title, (*body, FOOTER))


def _lead(s: Sweeps) -> Paragraph:
    good = sum(b.holds for b in s.by_points)
    words = [
        f"With at most {100 * SHARE:.0f} % of the points of a uniform grid, adaptive curves are as good as its "
        f"(or {100 * ENOUGH:g} %) on {good} of {len(s.by_points)} samples."
    ]
    for h in s.held:
        if h.sample == "all":
            words.append(
                f"{_where(h.geometry)}: intervals of 95 % hold {_percent(h.inside)} of the curves of {h.runs} "
                "adaptive runs."
            )
    return Paragraph(" ".join(words), "lead")


def _where(geometry: str) -> str:
    return "In plane" if geometry == "in plane" else "Over the hemisphere"


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"


def _time(s: Sweeps, figures: Sequence[Figure]) -> Group:
    words = (
        "Root mean square of the relative error of the curve, over rig time: frames, metering, ways, visits to the "
        f"reference, darks. Errors of values below {FLOOR:g} of the largest one count relative to that. Where not said "
        "otherwise curves are made by the Gaussian process, of fixed plans too; interpolated means monotone cubics "
        "through logarithms in plane, and linear ones over triangles out of it."
    )
    rows: list[list[Text]] = []
    for name in dict.fromkeys((v.geometry, v.sample) for v in s.levels):
        for plan, way, label, *_ in SHOWN:
            own = _of(s, *name, plan, way)
            if own:
                v = own[-1]
                inside = "–" if v.inside is None else _percent(v.inside)
                rows.append(
                    [
                        *(v.sample, v.geometry, label, f"{v.points:.0f}", f"{v.seconds / 60:.1f}"),
                        *(_percent(v.rms), _percent(v.largest), inside),
                    ]
                )
    header = ["sample", "geometry", "plan", "points", "rig time [min]", "rms error", "largest", "in 95 % interval"]
    shown = table("The largest size of each plan; the adaptive one at its end.", header, rows, right=(3, 4, 5, 6, 7))
    return part("Rig time", "time", words, Figures(tuple(figures)), shown)


def _of(s: Sweeps, geometry: str, sample: str, plan: str, way: str) -> list[Level]:
    return [v for v in s.levels if (v.geometry, v.sample, v.plan, v.way) == (geometry, sample, plan, way)]


def _points(s: Sweeps) -> Group:
    words = (
        f"In plane, with a given number of points in place of a time. Allowed is the error of the uniform grid, "
        f"interpolated, or {100 * ENOUGH:g} % where that is smaller. The same grid with the Gaussian process is there "
        "to tell apart what the points do and what the process does."
    )
    rows: list[list[Text]] = [
        [
            *(b.sample, f"{b.uniform_points:.0f}", _percent(b.uniform_interpolated), _percent(b.uniform_process)),
            *(f"{b.points:.0f}", _percent(b.adaptive), verdict(b.holds)),
        ]
        for b in s.by_points
    ]
    header = ["sample", "uniform: points", "interpolated", "process", "adaptive: points", "error", "kept"]
    return part("Points", "points", words, table("", header, rows, right=(1, 2, 3, 4, 5)))


def _intervals(s: Sweeps) -> Group:
    words = (
        "Part of the curve, over its positions and over runs, where the stated interval of 95 % holds the truth. "
        f"It should be {100 * HELD[0]:.0f} to {100 * HELD[1]:.0f} % over all. Positions of one run share its scale "
        "and the zeros of its angles, so a single run may have much less."
    )
    rows: list[list[Text]] = [
        [
            *("all samples" if h.sample == "all" else h.sample, h.geometry, str(h.runs), _percent(h.inside)),
            *(_percent(h.lowest), verdict(h.holds) if h.sample == "all" else ""),
        ]
        for h in s.held
    ]
    return part(
        "Intervals",
        "intervals",
        words,
        table("", ["sample", "geometry", "runs", "held", "lowest run", "kept"], rows, right=(2, 3, 4)),
    )


def _method(s: Sweeps) -> Group:
    m = s.machine
    theta = {g: ", ".join(f"{i:g}" for i in of) for g, of in INCIDENCES.items()}
    rows = [
        ("rig", "sim, without frames: values, noise and times by its description (gonio_validation.bench.sweeps_rig)"),
        ("in plane", f"theta_i = {theta['in plane']} deg, theta_r from {-LARGEST_DEG:g} to {LARGEST_DEG:g} deg"),
        ("hemisphere", f"theta_i = {theta['hemisphere']} deg, theta_r up to {LARGEST_DEG:g} deg, both sides"),
        ("wavelength", f"{WAVELENGTH_NM:g} nm"),
        ("mirror-dense", f"half of the points within {AROUND_DEG:g} deg of the mirror direction"),
        ("half-vector", "even in asinh(theta_h/4 deg)"),
        ("truth", "the sample through the cones of lamp and lens, in directions between those of the plans"),
        ("processor", f"{m.cpu}, {m.cpus} usable"),
    ]
    return method(s, rows)


# --- drawings -----------------------------------------------------------------------------------------------------


def drawn(s: Sweeps) -> list[Figure]:
    """A figure for each geometry: a panel for each sample."""
    return [_panels(s, geometry) for geometry in dict.fromkeys(v.geometry for v in s.levels)]


def _panels(s: Sweeps, geometry: str) -> Figure:
    samples = list(dict.fromkeys(v.sample for v in s.levels if v.geometry == geometry))
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
                own = _of(s, geometry, sample, plan, way)
                x, y = [v.seconds / 60 for v in own], [100 * v.rms for v in own]
                colour = INK if plan == "uniform" and way == "interpolated" else COLOURS[(k - 1) % len(COLOURS)]
                handles += ax.plot(x, y, dashes, marker=marker, ms=3, lw=1.1, color=colour, label=label)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_title(sample, fontsize=8, loc="left", color=INK)
            _plain(ax)
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
        own = _of(s, geometry, sample, "adaptive", "process")
        if own:
            ends.append(f"{sample}: adaptive {100 * own[-1].rms:.2g} % after {own[-1].seconds / 60:.2g} min.")
    name = geometry.replace(" ", "-")
    return rendered(name, "sweeps", "", caption, f"{where}. " + " ".join(ends), size, on)


def _plain(ax: Any) -> None:
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

    low, high = ax.get_xlim()
    times = LogLocator(subs=(1.0, 2.0, 5.0)) if high > 5.0 * low else MaxNLocator(3, steps=[1, 2, 5, 10])
    for axis, locator in ((ax.xaxis, times), (ax.yaxis, LogLocator())):
        axis.set_major_locator(locator)
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
        axis.get_major_formatter().set_scientific(False)
    ax.xaxis.set_minor_locator(NullLocator())
    ax.grid(True, color=FAINT, lw=0.4)
    ax.tick_params(labelsize=7.5, length=2.5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
