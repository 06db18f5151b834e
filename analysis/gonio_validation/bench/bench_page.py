"""`index.html` of the bench: targets, a section a family, hard cases, what a call costs, and on what machine."""

from __future__ import annotations

from html import escape
from typing import Any

from gonio_analysis.report import html
from gonio_analysis.report.figures import Figure
from gonio_analysis.report.text import number, slug


def render(s: dict[str, Any], drawn: dict[str, Figure]) -> str:
    """The page, as HTML text.

    Parameters
    ----------
    s
        What `summary.json` holds.
    drawn
        The figures by family.
    """
    body = [_header(s), _lead(s), _targets(s), _tolerances(s)]
    body += [_family(f, drawn.get(f["name"])) for f in s["families"]]
    body += [_hard(s), _calls(s), _peers(s), _method(s), _footer()]
    return html.document(s["title"], body)


def _header(s: dict[str, Any]) -> str:
    links = [("targets", "Targets"), *((slug(f["name"]), f["title"]) for f in s["families"])]
    links += [("hard-cases", "Hard cases"), ("calls", "Calls and start-up"), ("method", "Method and machine")]
    nav = "".join(f'<li><a href="#{anchor}">{escape(name)}</a></li>' for anchor, name in links)
    machine = f"{s['machine']['cpu']}, {s['machine']['cpus']} threads"
    what = f"{s['created'][:10]}, gonio {s['machine']['versions']['gonio']}, {machine}, {_vectors(s)}."
    rough = " A quick run: errors are right, times are rough." if s["quick"] else ""
    return (
        f'<header>\n<h1>{escape(s["title"])}</h1>\n<p class="sub">{escape(what + rough)}</p>\n'
        f'<nav aria-label="Sections"><ul>{nav}</ul></nav>\n</header>'
    )


def _vectors(s: dict[str, Any]) -> str:
    flags = s["machine"]["flags"]
    return "AVX-512" if "avx512f" in flags else "AVX2, no AVX-512" if "avx2" in flags else "no AVX2"


def _lead(s: dict[str, Any]) -> str:
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
    return f'<p class="lead">{escape(" ".join(words))}</p>'


def _verdict(met: bool | None) -> str:
    return "" if met is None else "yes" if met else "<b>no</b>"


def _error(value: float | None) -> str:
    return "not a number" if value is None else f"{number(value, 2)}"


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>\n'


def _targets(s: dict[str, Any]) -> str:
    rows = [
        [
            escape(t["what"]),
            escape(t["target"]),
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
    table = html.table("", header, rows, right=(1, 2, 3, 5, 6))
    return f'<section id="targets"><h2>Targets</h2>\n{_note(words)}{table}</section>'


def _tolerances(s: dict[str, Any]) -> str:
    rows = [
        [
            escape(f"{t['family']}: {t['way']}"),
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
    table = html.table("", ["", "stated", "largest", "points", "holds"], rows, right=(1, 2, 3))
    return f'<section id="tolerances"><h3>Do the stated accuracies hold?</h3>\n{_note(words)}{table}</section>'


def _family(f: dict[str, Any], figure: Figure | None) -> str:
    kinds = [k for k in ("grid", "hard") if any(k in w["errors"] for w in f["ways"])]
    header = ["way", "best ns", "median", "processor"]
    header += [what for k in kinds for what in (f"{k}: largest", "99 %", "median")]
    rows, k = [], 0
    for w in f["ways"]:
        k += bool(w["errors"])
        t = w["time"]
        row = [
            (f"{k}&ensp;" if w["errors"] else "") + escape(w["way"]),
            *(number(t[key]) for key in ("best_ns", "median_ns", "processor_ns")),
        ]
        for kind in kinds:
            e = w["errors"].get(kind)
            row += [_error(e[q]) for q in ("max", "p99", "median")] if e else ["–"] * 3
        rows.append(row)
    marks = ["best" if w.get("on_front_grid") else "" for w in f["ways"]]
    words = "Processor: summed over threads. Errors are relative. ● marks the Pareto front on the grid."
    return (
        f'<section id="{slug(f["name"])}"><h2>{escape(f["title"])}</h2>\n'
        f"<p>{escape(f['about'])} Timed on {escape(f['inputs'])}.</p>\n"
        + (html.grid([figure]) if figure else "")
        + _note(words)
        + html.table("", header, rows, right=tuple(range(1, len(header))), marks=marks)
        + html.facts((w["way"], w["note"]) for w in f["ways"] if w["note"])
        + "</section>"
    )


def _hard(s: dict[str, Any]) -> str:
    rows = [
        [
            escape(c["case"]),
            escape(", ".join(c["models"])),
            str(c["points"]),
            f"{c['expected_digits']:g}",
            f"{c['achieved_digits']:g}",
            str(c["nan"]),
            str(c["infinite"]),
            str(c["negative"]),
            "yes" if c["warning"] else "no",
            _verdict(c["holds"]),
            escape(c["note"]),
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
    table = html.table("", [*header, ""], rows, right=(2, 3, 4, 5, 6, 7))
    return f'<section id="hard-cases"><h2>Hard cases</h2>\n{_note(words)}{table}</section>'


def _calls(s: dict[str, Any]) -> str:
    single = [
        [escape(c["model"]), f"<code>{c['call']}</code>", number(c["best_us"]), number(c["median_us"])]
        for c in s["single_calls"]
    ]
    start = [
        [c["model"], number(c["import_s"]), number(c["first_evaluation_s"]), number(c["together_s"])]
        for c in s["start_up"]
    ]
    return (
        '<section id="calls"><h2>Calls and start-up</h2>\n'
        + _hand_over(s["hand_over"])
        + html.table("One geometry from Python.", ["model", "call", "best µs", "median µs"], single, right=(2, 3))
        + html.table(
            "Seconds in a fresh process, compiled code already cached; the import loads no numba.",
            ["first model", "import gonio.models", "first evaluation", "together"],
            start,
            right=(1, 2, 3),
        )
        + "</section>"
    )


def _hand_over(h: dict[str, Any] | None) -> str:
    if h is None:
        return "<p>This process may use one processor only: no call is handed to a second thread.</p>\n"
    text = (
        f"A call of {h['pairs']} pairs or more is shared by threads. To hand half of it over costs"
        f" {number(h['hand_over_us'], 2)} µs: {h['model']} takes {number(h['shared_us'])} µs for {h['pairs']} pairs on"
        f" two threads, and {number(h['half_alone_us'])} µs for half as many on one (medians of {h['repeats']} calls in"
        f" turn). That is {100 * h['share']:.0f} % of the smallest shared call, and the less the larger a call is."
    )
    return f"<p>{escape(text)}</p>\n"


def _peers(s: dict[str, Any]) -> str:
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
    return "<h3>Peers</h3>\n" + _note(words) + html.facts([*((p["peer"], p["state"]) for p in s["peers"]), *threads])


def _method(s: dict[str, Any]) -> str:
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
    return '<section id="method"><h2>Method and machine</h2>\n' + html.facts(rows) + "</section>"


def _footer() -> str:
    return (
        "<footer>Every number on this page is in <code>summary.json</code>; points and hard cases are in "
        "<code>tables/</code>, the figures as SVG and PNG in <code>figures/</code>.</footer>"
    )
