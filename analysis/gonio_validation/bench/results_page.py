"""`index.html` of `gonio bench models`: which model will do, a section a quantity, hard cases, calls, machine."""

from collections.abc import Sequence
from functools import partial

from gonio_analysis.report import frame
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Heading,
    Page,
    Paragraph,
    code,
    facts,
    footer,
    table,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.section import Part, parts
from gonio_analysis.report.text import number

from gonio.typing import JsonObject
from gonio_validation.bench.page import (
    Column,
    TableSection,
    held,
    listed,
    made,
    method,
    of_part,
    part,
    two_digits,
    verdict,
)
from gonio_validation.bench.quantity import PeerTime, QuantitySummary

FOOTER = footer(
    "Every number on this page is in `summary.json`; points and hard cases are in `tables/`, the figures as SVG and "
    "PNG in `figures/`."
)


def _error(value: float | None) -> str:
    return "not a number" if value is None else two_digits(value)


def _one_digit(value: float) -> str:
    return number(value, 1)


TOLERANCES = (
    Column("", "", "{0[family]}: {0[way]}".format), Column("stated", "stated", _one_digit),
    Column("largest", "worst", _error), Column("points", "points"), Column("holds", "holds", verdict),
)  # fmt: skip
RATIOS = (Column("time here", "what"), Column("ratio", "ratio", two_digits))
FORMS = (
    Column("form", "form"), Column("ns", "processor_ns", number), Column("misfit", "misfit", two_digits),
    Column("off the nearest", "off_nearest", two_digits),
)  # fmt: skip
HARD = TableSection(
    "Hard cases", "hard_cases",
    "Digits are −log10 of the relative error over 1 + conditioning, at the point with the least to spare; 16 means "
    "identical. NaN, infinite and negative results count where the formula's own value is none of it (Oren-Nayar's "
    "functional form is negative near forward grazing, as in the paper).",
    (
        Column("case", "case"), Column("models", "models", ", ".join), Column("points", "points"),
        Column("digits expected", "expected_digits", "{:g}".format),
        Column("achieved", "achieved_digits", "{:g}".format), Column("NaN", "nan"), Column("infinite", "infinite"),
        Column("negative", "negative"), Column("warning", "warning", lambda said: "yes" if said else "no"),
        Column("holds", "holds", verdict), Column("", "note"),
    ),
    (2, 3, 4, 5, 6, 7),
)  # fmt: skip
SINGLE = (
    Column("model", "model"), Column("call", "call", code), Column("best µs", "best_us", number),
    Column("median µs", "median_us", number),
)  # fmt: skip
START = (
    Column("first model", "model"), Column("import gonio.models", "import_s", number),
    Column("first evaluation", "first_evaluation_s", number), Column("together", "together_s", number),
)  # fmt: skip


def render(s: JsonObject, figures: Sequence[Figure]) -> Page:
    """The page.

    Parameters
    ----------
    s
        What `summary.json` holds.
    figures
        That of all models (`which_model.draw`), and one of a quantity where it has one, by name (`Figure.model`).
    """
    words = (
        "Every accuracy that an evaluation of ours states (He-Torrance's tolerance= among them), against the largest "
        "error over 1 + conditioning on grid and hard set."
    )

    def accuracies() -> list[Block]:
        shown = listed(s["tolerances"], TOLERANCES, (1, 2, 3))
        return part("Do the stated accuracies hold?", held(s["tolerances"], _holds), words, shown)

    drawn = {figure.model: figure for figure in figures}
    made_of: dict[str, Part] = {'section "Which model"': partial(_which_model, s), 'section "Accuracies"': accuracies}
    made_of[f'section "{HARD.title}"'] = lambda: of_part(s, HARD, held(s["hard_cases"], _holds))
    for q in s["families"]:
        made_of[f'section "{q.title}"'] = partial(_quantity, q, drawn.get(q.name))
    made_of |= {'section "Calls and start-up"': partial(_calls, s), 'section "Peers"': partial(_peers, s)}
    folds = [*parts(made_of), *_method(s)]
    ratios = partial(listed, s["ratios"], RATIOS, (1,))
    picture = [Figures((drawn["which-model"],))] if "which-model" in drawn else []
    flags = s["machine"]["flags"]
    vectors = "AVX-512" if "avx512f" in flags else "AVX2, no AVX-512" if "avx2" in flags else "no AVX2"
    what = f", {s['machine']['cpu']}, {s['machine']['cpus']} threads, {vectors}."
    rough = " A quick run: errors are right, times are rough." if s["quick"] else ""
    return frame.page(
        s["title"],
        made(s, what + rough),
        frame.answer(parts({"the headline": partial(_lead, s)}), picture, parts({'table "Ratios"': ratios})),
        folds=folds,
        foot=FOOTER,
    )


def _holds(row: JsonObject) -> bool:
    return bool(row["holds"])


def _lead(s: JsonObject) -> Paragraph:
    hard, tolerances = s["hard_cases"], s["tolerances"]
    words = (
        f"{sum(map(_holds, hard))} of {len(hard)} hard cases hold, and {sum(map(_holds, tolerances))} of"
        f" {len(tolerances)} stated accuracies."
    )
    return Paragraph(" ".join([*(c.words for c in s["which_model"]), words]), "lead")


def _which_model(s: JsonObject) -> list[Block]:
    load, cpus = s["machine"]["load"], s["machine"]["cpus"]
    busy = f"; the load was {load[0]:.1f} on {cpus} processors when this run began" if load else ""
    words = (
        "Each form is fitted to the sample by relative differences. Misfit is what is left of them, root mean square; "
        f"ns is the processor time of one evaluation of the fitted model on this machine{busy}. ● marks the Pareto "
        "front."
    )
    tables = [
        table(
            c.sample,
            [column.header for column in FORMS],
            [[column.shown(getattr(one, column.key)) for column in FORMS] for one in c.candidates],
            right=(1, 2, 3),
            marks=["best" if one.on_front else "" for one in c.candidates],
        )
        for c in s["which_model"]
    ]
    lost = [facts((f"{c.sample}: {form}", why) for c in s["which_model"] for form, why in c.left_out.items())]
    return part("Which model will do?", f"{len(tables[0].rows)} forms", words, *tables, *lost)


def _quantity(q: QuantitySummary, figure: Figure | None) -> list[Block]:
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
    return [
        Heading(3, q.title, f"{len(q.ways)} ways"),
        Paragraph(f"{q.about} Timed on {q.inputs}."),
        *([Figures((figure,))] if figure else []),
        Paragraph(words, "note"),
        table("", header, rows, right=right, marks=marks),
        facts((w.way, w.note) for w in q.ways if w.note),
    ]


def _calls(s: JsonObject) -> list[Block]:
    fresh = "Seconds in a fresh process, compiled code already cached; the import loads no numba."
    slowest = max((row["together_s"] for row in s["start_up"]), default=0.0)
    return [
        Heading(3, "Calls and start-up", f"the first value within {number(slowest, 2)} s"),
        _hand_over(s["hand_over"]),
        listed(s["single_calls"], SINGLE, (2, 3), "One geometry from Python."),
        listed(s["start_up"], START, (1, 2, 3), fresh),
    ]


def _hand_over(h: JsonObject | None) -> Paragraph:
    if h is None:
        return Paragraph("This process may use one processor only: no call is handed to a second thread.")
    return Paragraph(
        f"A call of {h['pairs']} pairs or more is shared by threads. To hand half of it over costs"
        f" {number(h['hand_over_us'], 2)} µs: {h['model']} takes {number(h['shared_us'])} µs for {h['pairs']} pairs on"
        f" two threads, and {number(h['half_alone_us'])} µs for half as many on one (medians of {h['repeats']} calls in"
        f" turn). That is {100 * h['share']:.0f} % of the smallest shared call, and the less the larger a call is."
    )


def _peers(s: JsonObject) -> list[Block]:
    threads = [
        (w.way, f"{w.time.threads} threads in its process")
        for q in s["families"]
        for w in q.ways
        if isinstance(w.time, PeerTime) and w.time.threads
    ]
    words = (
        "Each peer is measured in a process of its own, after our ways: idle workers that spin would slow down what is"
        " measured beside them. Its wall-clock times count; its processor time may leave out threads of its own."
    )
    states = [(p["peer"], p["state"]) for p in s["peers"]]
    return part("Peers", ", ".join(p["peer"] for p in s["peers"]) or "none", words, facts([*states, *threads]))


def _method(s: JsonObject) -> list[Block]:
    m, r = s["machine"], s["reference"]
    return method(
        s,
        ("times", "all ways of a family in turn within each repeat; slow ways on fewer pairs (see tables/points.csv)"),
        ("reference", f"{r['made_by']}: {r['with']}"),
        ("grid", r["grid"]),
        ("conditioning", r["condition"]),
        (
            "comparison code",
            "through the models' own loops, checks and compiler; He-Torrance's share all but the series",
        ),
        ("processor", f"{m['cpu']}, {m['cpus']} usable; {' '.join(m['flags']) or 'flags unknown'}"),
    )
