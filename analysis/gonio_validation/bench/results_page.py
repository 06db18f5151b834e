"""`index.html` of `gonio bench models`: targets, a section a quantity, hard cases, calls, and the machine."""

from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Group,
    Heading,
    Page,
    Paragraph,
    Text,
    code,
    facts,
    section,
    table,
)
from gonio_analysis.report.drawings import Figure
from gonio_analysis.report.text import number, slug

from gonio_validation.bench.page import head, method, part, verdict
from gonio_validation.bench.results import (
    HandOverSummary,
    PeerTime,
    QuantitySummary,
    SpeedAndError,
    TargetSummary,
    WayTargetSummary,
)

FOOTER = Footer(
    (
        *("Every number on this page is in ", code("summary.json"), "; points and hard cases are in "),
        *(code("tables/"), ", the figures as SVG and PNG in ", code("figures/"), "."),
    )
)


def render(s: SpeedAndError, drawn: dict[str, Figure]) -> Page:
    """The page.

    Parameters
    ----------
    s
        What `summary.json` holds.
    drawn
        The figures by quantity.
    """
    body: list[Block] = [_header(s), _lead(s), _targets(s), _tolerances(s)]
    body += [_quantity(q, drawn.get(q.name)) for q in s.families]
    body += [_hard(s), _calls(s), *_peers(s), _method(s), FOOTER]
    return Page(s.title, tuple(body))


def _header(s: SpeedAndError) -> Group:
    links = [("targets", "Targets"), *((slug(q.name), q.title) for q in s.families)]
    links += [("hard-cases", "Hard cases"), ("calls", "Calls and start-up"), ("method", "Method and machine")]
    machine = f"{s.machine.cpu}, {s.machine.cpus} threads"
    what = f", {machine}, {_vectors(s)}."
    rough = " A quick run: errors are right, times are rough." if s.quick else ""
    return head(s, what + rough, links)


def _vectors(s: SpeedAndError) -> str:
    flags = s.machine.flags
    return "AVX-512" if "avx512f" in flags else "AVX2, no AVX-512" if "avx2" in flags else "no AVX2"


def _lead(s: SpeedAndError) -> Paragraph:
    broken = [c.case for c in s.hard_cases if not c.holds]
    loose = [t for t in s.tolerances if not t.holds]
    missed = [t for t in s.targets if not t.time_met]
    words = [
        f"All {len(s.hard_cases)} hard cases hold."
        if not broken
        else f"{len(broken)} of {len(s.hard_cases)} hard cases do not hold: {'; '.join(broken)}.",
        f"All {len(s.tolerances)} stated accuracies hold."
        if not loose
        else f"{len(loose)} of {len(s.tolerances)} stated accuracies do not hold.",
        f"{len(s.targets) - len(missed)} of {len(s.targets)} speeds are reached here.",
    ]
    return Paragraph(" ".join(words), "lead")


def _error(value: float | None) -> str:
    return "not a number" if value is None else f"{number(value, 2)}"


def _target(t: TargetSummary, cpus: int) -> list[Text]:
    best = f"{number(t.achieved)} {t.unit}"
    if not isinstance(t, WayTargetSummary):
        return [t.what, t.target, best, "", verdict(t.time_met), "", "", ""]
    idle = f"{number(t.processor_ns / cpus)} ns"
    errors = (number(t.target_error, 1), _error(t.achieved_error), verdict(t.error_met))
    return [t.what, t.target, best, idle, verdict(t.time_met), *errors]


def _targets(s: SpeedAndError) -> Group:
    rows = [_target(t, s.machine.cpus) for t in s.targets]
    load, cpus = s.machine.load, s.machine.cpus
    busy = f"; the load was {load[0]:.1f} on {cpus} processors when this run began" if load else ""
    words = (
        "Targets are for two threads of an idle machine with AVX-512. Best: wall-clock time of several repeats, all "
        f"arguments checked{busy}. Idle: processor time over threads, what an idle machine of this kind would take. "
        "Ratios are of processor times. Errors are relative, over 1 + conditioning, the largest of grid and hard set."
    )
    header = ["", "target", "best", "idle", "met", "error: allowed", "largest", "held"]
    return part("Targets", "targets", words, table("", header, rows, right=(1, 2, 3, 5, 6)))


def _tolerances(s: SpeedAndError) -> Group:
    rows = [
        [
            f"{t.family}: {t.way}",
            number(t.stated, 1),
            _error(t.worst),
            str(t.points),
            verdict(t.holds),
        ]
        for t in s.tolerances
    ]
    words = (
        "Every accuracy that an evaluation of ours states (He-Torrance's tolerance= among them), against the largest "
        "error over 1 + conditioning on grid and hard set."
    )
    return part(
        "Do the stated accuracies hold?",
        "tolerances",
        words,
        table("", ["", "stated", "largest", "points", "holds"], rows, right=(1, 2, 3)),
        level=3,
    )


def _quantity(q: QuantitySummary, figure: Figure | None) -> Group:
    header = ["way", "best ns", "median", "processor"]
    header += [what for kind in q.sets for what in (f"{kind}: largest", "99 %", "median")]
    rows, k = [], 0
    for w in q.ways:
        k += bool(w.errors)
        row = [(f"{k}\u2002" if w.errors else "") + w.way]
        row += [number(ns) for ns in (w.time.best_ns, w.time.median_ns, w.time.processor_ns)]
        for kind in q.sets:
            e = w.errors.get(kind)
            row += [_error(x) for x in (e.max, e.p99, e.median)] if e else ["–"] * 3
        rows.append(row)
    marks = ["best" if w.on_front_grid else "" for w in q.ways]
    words = "Processor: summed over threads. Errors are relative. ● marks the Pareto front on the grid."
    right = tuple(range(1, len(header)))
    return section(
        [
            Heading(2, q.title),
            Paragraph(f"{q.about} Timed on {q.inputs}."),
            *([Figures((figure,))] if figure else []),
            Paragraph(words, "note"),
            table("", header, rows, right=right, marks=marks),
            facts((w.way, w.note) for w in q.ways if w.note),
        ],
        slug(q.name),
    )


def _hard(s: SpeedAndError) -> Group:
    rows = [
        [
            c.case,
            ", ".join(c.models),
            str(c.points),
            f"{c.expected_digits:g}",
            f"{c.achieved_digits:g}",
            str(c.nan),
            str(c.infinite),
            str(c.negative),
            "yes" if c.warning else "no",
            verdict(c.holds),
            c.note,
        ]
        for c in s.hard_cases
    ]
    words = (
        "Digits are −log10 of the relative error over 1 + conditioning, at the point with the least to spare; 16 means "
        "identical. NaN, infinite and negative results count where the formula's own value is none of it (Oren-Nayar's "
        "functional form is negative near forward grazing, as in the paper)."
    )
    header = [
        "case",
        "models",
        "points",
        "digits expected",
        "achieved",
        "NaN",
        "infinite",
        "negative",
        "warning",
        "holds",
    ]
    return part("Hard cases", "hard-cases", words, table("", [*header, ""], rows, right=(2, 3, 4, 5, 6, 7)))


def _calls(s: SpeedAndError) -> Group:
    single: list[list[Text]] = [[c.model, code(c.call), number(c.best_us), number(c.median_us)] for c in s.single_calls]
    start = [[c.model, number(c.import_s), number(c.first_evaluation_s), number(c.together_s)] for c in s.start_up]
    return section(
        [
            Heading(2, "Calls and start-up"),
            _hand_over(s.hand_over),
            table("One geometry from Python.", ["model", "call", "best µs", "median µs"], single, right=(2, 3)),
            table(
                "Seconds in a fresh process, compiled code already cached; the import loads no numba.",
                ["first model", "import gonio.models", "first evaluation", "together"],
                start,
                right=(1, 2, 3),
            ),
        ],
        "calls",
    )


def _hand_over(h: HandOverSummary | None) -> Paragraph:
    if h is None:
        return Paragraph("This process may use one processor only: no call is handed to a second thread.")
    text = (
        f"A call of {h.pairs} pairs or more is shared by threads. To hand half of it over costs"
        f" {number(h.hand_over_us, 2)} µs: {h.model} takes {number(h.shared_us)} µs for {h.pairs} pairs on"
        f" two threads, and {number(h.half_alone_us)} µs for half as many on one (medians of {h.repeats} calls in"
        f" turn). That is {100 * h.share:.0f} % of the smallest shared call, and the less the larger a call is."
    )
    return Paragraph(text)


def _peers(s: SpeedAndError) -> list[Block]:
    threads = [
        (w.way, f"{w.time.threads} threads in its process")
        for q in s.families
        for w in q.ways
        if isinstance(w.time, PeerTime) and w.time.threads
    ]
    words = (
        "Each peer is measured in a process of its own, after our ways: idle workers that spin would slow down what is"
        " measured beside them. Its wall-clock times count; its processor time may leave out threads of its own."
    )
    states = [(p.peer, p.state) for p in s.peers]
    return [Heading(3, "Peers"), Paragraph(words, "note"), facts([*states, *threads])]


def _method(s: SpeedAndError) -> Group:
    m, r = s.machine, s.reference
    rows = [
        ("times", "all ways of a family in turn within each repeat; slow ways on fewer pairs (see tables/points.csv)"),
        ("reference", f"{r['made_by']}: {r['with']}"),
        ("grid", r["grid"]),
        ("conditioning", r["condition"]),
        (
            "comparison code",
            "through the models' own loops, checks and compiler; He-Torrance's share all but the series",
        ),
        ("processor", f"{m.cpu}, {m.cpus} usable; {' '.join(m.flags) or 'flags unknown'}"),
    ]
    return method(s, rows)
