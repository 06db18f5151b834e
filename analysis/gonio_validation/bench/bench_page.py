"""`index.html` of the bench: targets, a section a family, hard cases, what a call costs, and on what machine."""

from __future__ import annotations

from typing import Any

from gonio_analysis.report.blocks import (
    Block,
    Contents,
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
    strong,
    table,
)
from gonio_analysis.report.figures import Figure
from gonio_analysis.report.text import number, slug

FOOTER = Footer(
    (
        *("Every number on this page is in ", code("summary.json"), "; points and hard cases are in "),
        *(code("tables/"), ", the figures as SVG and PNG in ", code("figures/"), "."),
    )
)


def render(s: dict[str, Any], drawn: dict[str, Figure]) -> Page:
    """The page.

    Parameters
    ----------
    s
        What `summary.json` holds.
    drawn
        The figures by family.
    """
    body: list[Block] = [_header(s), _lead(s), _targets(s), _tolerances(s)]
    body += [_family(f, drawn.get(f["name"])) for f in s["families"]]
    body += [_hard(s), _calls(s), *_peers(s), _method(s), FOOTER]
    return Page(s["title"], tuple(body))


def _header(s: dict[str, Any]) -> Group:
    links = [("targets", "Targets"), *((slug(f["name"]), f["title"]) for f in s["families"])]
    links += [("hard-cases", "Hard cases"), ("calls", "Calls and start-up"), ("method", "Method and machine")]
    machine = f"{s['machine']['cpu']}, {s['machine']['cpus']} threads"
    what = f"{s['created'][:10]}, gonio {s['machine']['versions']['gonio']}, {machine}, {_vectors(s)}."
    rough = " A quick run: errors are right, times are rough." if s["quick"] else ""
    contents = Contents(tuple((f"#{anchor}", name) for anchor, name in links))
    return Group("header", (Heading(1, s["title"]), Paragraph(what + rough, "sub"), contents))


def _vectors(s: dict[str, Any]) -> str:
    flags = s["machine"]["flags"]
    return "AVX-512" if "avx512f" in flags else "AVX2, no AVX-512" if "avx2" in flags else "no AVX2"


def _lead(s: dict[str, Any]) -> Paragraph:
    broken = [c["case"] for c in s["hard_cases"] if not c["holds"]]
    loose = [t for t in s["tolerances"] if not t["holds"]]
    missed = [t for t in s["targets"] if t["time_met"] is False]
    words = [
        f"All {len(s['hard_cases'])} hard cases hold."
        if not broken
        else f"{len(broken)} of {len(s['hard_cases'])} hard cases do not hold: {'; '.join(broken)}.",
        f"All {len(s['tolerances'])} stated accuracies hold."
        if not loose
        else f"{len(loose)} of {len(s['tolerances'])} stated accuracies do not hold.",
        f"{len(s['targets']) - len(missed)} of {len(s['targets'])} speeds are reached here.",
    ]
    return Paragraph(" ".join(words), "lead")


def _verdict(met: bool | None) -> Text:
    return "" if met is None else "yes" if met else strong("no")


def _error(value: float | None) -> str:
    return "not a number" if value is None else f"{number(value, 2)}"


def _targets(s: dict[str, Any]) -> Group:
    rows = [
        [
            t["what"],
            t["target"],
            f"{number(t['achieved'])} {t['unit']}",
            f"{number(t['processor_ns'] / s['machine']['cpus'])} ns" if "processor_ns" in t else "",
            _verdict(t["time_met"]),
            number(t["target_error"], 1) if "target_error" in t else "",
            _error(t["achieved_error"]) if "target_error" in t else "",
            _verdict(t.get("error_met")),
        ]
        for t in s["targets"]
    ]
    load, cpus = s["machine"]["load"], s["machine"]["cpus"]
    busy = f"; the load was {load[0]:.1f} on {cpus} processors when this run began" if load else ""
    words = (
        "Targets are for two threads of an idle machine with AVX-512. Best: wall-clock time of several repeats, all "
        f"arguments checked{busy}. Idle: processor time over threads, what an idle machine of this kind would take. "
        "Ratios are of processor times. Errors are relative, over 1 + conditioning, the largest of grid and hard set."
    )
    header = ["", "target", "best", "idle", "met", "error: allowed", "largest", "held"]
    shown = table("", header, rows, right=(1, 2, 3, 5, 6))
    return section([Heading(2, "Targets"), Paragraph(words, "note"), shown], "targets")


def _tolerances(s: dict[str, Any]) -> Group:
    rows = [
        [
            f"{t['family']}: {t['way']}",
            number(t["stated"], 1),
            _error(t["worst"]),
            str(t["points"]),
            _verdict(t["holds"]),
        ]
        for t in s["tolerances"]
    ]
    words = (
        "Every accuracy that an evaluation of ours states (He-Torrance's tolerance= among them), against the largest "
        "error over 1 + conditioning on grid and hard set."
    )
    shown = table("", ["", "stated", "largest", "points", "holds"], rows, right=(1, 2, 3))
    return section([Heading(3, "Do the stated accuracies hold?"), Paragraph(words, "note"), shown], "tolerances")


def _family(f: dict[str, Any], figure: Figure | None) -> Group:
    kinds = [k for k in ("grid", "hard") if any(k in w["errors"] for w in f["ways"])]
    header = ["way", "best ns", "median", "processor"]
    header += [what for k in kinds for what in (f"{k}: largest", "99 %", "median")]
    rows, k = [], 0
    for w in f["ways"]:
        k += bool(w["errors"])
        t = w["time"]
        row = [
            (f"{k}\u2002" if w["errors"] else "") + w["way"],
            *(number(t[key]) for key in ("best_ns", "median_ns", "processor_ns")),
        ]
        for kind in kinds:
            e = w["errors"].get(kind)
            row += [_error(e[q]) for q in ("max", "p99", "median")] if e else ["–"] * 3
        rows.append(row)
    marks = ["best" if w.get("on_front_grid") else "" for w in f["ways"]]
    words = "Processor: summed over threads. Errors are relative. ● marks the Pareto front on the grid."
    right = tuple(range(1, len(header)))
    return section(
        [
            Heading(2, f["title"]),
            Paragraph(f"{f['about']} Timed on {f['inputs']}."),
            *([Figures((figure,))] if figure else []),
            Paragraph(words, "note"),
            table("", header, rows, right=right, marks=marks),
            facts((w["way"], w["note"]) for w in f["ways"] if w["note"]),
        ],
        slug(f["name"]),
    )


def _hard(s: dict[str, Any]) -> Group:
    rows = [
        [
            c["case"],
            ", ".join(c["models"]),
            str(c["points"]),
            f"{c['expected_digits']:g}",
            f"{c['achieved_digits']:g}",
            str(c["nan"]),
            str(c["infinite"]),
            str(c["negative"]),
            "yes" if c["warning"] else "no",
            _verdict(c["holds"]),
            c["note"],
        ]
        for c in s["hard_cases"]
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
    shown = table("", [*header, ""], rows, right=(2, 3, 4, 5, 6, 7))
    return section([Heading(2, "Hard cases"), Paragraph(words, "note"), shown], "hard-cases")


def _calls(s: dict[str, Any]) -> Group:
    single = [[c["model"], code(c["call"]), number(c["best_us"]), number(c["median_us"])] for c in s["single_calls"]]
    start = [
        [c["model"], number(c["import_s"]), number(c["first_evaluation_s"]), number(c["together_s"])]
        for c in s["start_up"]
    ]
    return section(
        [
            Heading(2, "Calls and start-up"),
            _hand_over(s["hand_over"]),
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


def _hand_over(h: dict[str, Any] | None) -> Paragraph:
    if h is None:
        return Paragraph("This process may use one processor only: no call is handed to a second thread.")
    text = (
        f"A call of {h['pairs']} pairs or more is shared by threads. To hand half of it over costs"
        f" {number(h['hand_over_us'], 2)} µs: {h['model']} takes {number(h['shared_us'])} µs for {h['pairs']} pairs on"
        f" two threads, and {number(h['half_alone_us'])} µs for half as many on one (medians of {h['repeats']} calls in"
        f" turn). That is {100 * h['share']:.0f} % of the smallest shared call, and the less the larger a call is."
    )
    return Paragraph(text)


def _peers(s: dict[str, Any]) -> list[Block]:
    threads = [
        (w["way"], f"{w['time']['threads']} threads in its process")
        for f in s["families"]
        for w in f["ways"]
        if w["time"].get("threads")
    ]
    words = (
        "Each peer is measured in a process of its own, after our ways: idle workers that spin would slow down what is"
        " measured beside them. Its wall-clock times count; its processor time may leave out threads of its own."
    )
    states = [(p["peer"], p["state"]) for p in s["peers"]]
    return [Heading(3, "Peers"), Paragraph(words, "note"), facts([*states, *threads])]


def _method(s: dict[str, Any]) -> Group:
    m, r = s["machine"], s["reference"]
    rows = [
        ("times", "all ways of a family in turn within each repeat; slow ways on fewer pairs (see tables/points.csv)"),
        ("reference", f"{r['made_by']}: {r['with']}"),
        ("grid", r["grid"]),
        ("conditioning", r["condition"]),
        (
            "comparison code",
            "through the models' own loops, checks and compiler; He-Torrance's share all but the series",
        ),
        ("processor", f"{m['cpu']}, {m['cpus']} usable; {' '.join(m['flags']) or 'flags unknown'}"),
        ("system", f"{m['system']}, Python {m['python']}, " + ", ".join(f"{k} {v}" for k, v in m["versions"].items())),
        ("command", s["command"] or "–"),
    ]
    return section([Heading(2, "Method and machine"), facts(rows)], "method")
