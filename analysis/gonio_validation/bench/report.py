"""The report of `gonio bench models`: measure, judge, and write index.html, summary.json and CSV tables."""

from __future__ import annotations

import csv
import datetime
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from gonio_analysis.report import files, html

from gonio_validation.bench import bench_page, evaluators, figures, hard, peers, timing

POINT_COLUMNS = (
    *("family", "way", "ours", "set", "points", "max", "p99", "median", "max_scaled", "not_finite", "warning"),
    *("best_ns", "median_ns", "processor_ns", "pairs", "note"),
)
HARD_COLUMNS = (
    *("case", "models", "points", "expected_digits", "achieved_digits", "nan", "infinite", "negative", "warning"),
    *("holds", "note"),
)


def make(
    out: str | Path,
    *,
    quick: bool = False,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Measure every way of evaluating every model, and write the report: all of it or nothing.

    Parameters
    ----------
    out
        Folder of the report; an earlier report there is replaced.
    quick
        Fewer pairs and repeats: errors are the same, times are rough.
    command
        The command line, for the record.
    progress
        Called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that is not a report.
    """
    with files.staged(out) as stage:
        summary = collect(quick=quick, command=command, progress=progress)
        write(summary, stage.work)
    return Path(out) / "index.html"


def collect(
    *, quick: bool = False, command: str = "", progress: Callable[[str], None] = lambda text: None
) -> dict[str, Any]:
    """Every number of the report, as `summary.json` holds it; parameters as `make`."""
    pairs, repeats, budget_s = (20_000, 3, 0.02) if quick else (1_000_000, 9, 0.4)
    started = timing.machine()
    words, others = peers.find()
    found = evaluators.families()
    rows = []
    for family in found:
        here = others if family.name == peers.FAMILY else []
        progress(f"{family.title}: {len(family.ways) + len(here)} ways")
        rows.append(_family(family, here, pairs, repeats, budget_s))
    progress("hard cases")
    cases = hard.table(found, 200_000 if quick else 4_000_000)
    progress("single calls and start-up")
    single = timing.single_calls(200 if quick else 3000)
    handed = timing.hand_over(50 if quick else 1000)
    start = timing.start_up(1 if quick else 4)
    r = evaluators.reference()
    return {
        "title": "Models: speed against error",
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "command": command,
        "quick": quick,
        "machine": started,
        "reference": {key: r[key] for key in ("made_by", "with", "grid", "condition")},
        "families": rows,
        "targets": _targets(rows, single, start),
        "tolerances": [_tolerance(f, w) for f in rows for w in f["ways"] if w["stated"] is not None],
        "hard_cases": cases,
        "single_calls": single,
        "hand_over": handed,
        "start_up": start,
        "peers": words,
    }


def _family(
    family: evaluators.Quantity, others: Sequence[peers.Peer], pairs: int, repeats: int, budget_s: float
) -> dict[str, Any]:
    out: dict[str, Any] = {key: getattr(family, key) for key in ("name", "title", "about", "inputs")}
    settings: dict[str, Any] = {"pairs": pairs, "repeats": repeats, "budget_s": budget_s}
    taken = timing.times(family, **settings)
    found = [(way, timing.by_set(family, way), taken[way.name]) for way in family.ways]
    found += [(peer.way, *peers.measured(peer, **settings)) for peer in others]
    out["ways"] = [
        {
            "way": way.name,
            "ours": way.ours,
            "peer": way.peer,
            "note": way.note,
            "stated": way.stated,
            "errors": errors,
            "time": time,
        }
        for way, errors, time in found
    ]
    for kind in ("grid", "hard"):
        front = pareto([(w["time"]["best_ns"], w["errors"].get(kind, {}).get("max")) for w in out["ways"]])
        for k, w in enumerate(out["ways"]):
            w[f"on_front_{kind}"] = k in front
    return out


def pareto(points: Sequence[tuple[float, float | None]]) -> list[int]:
    """Which of the points (cost, error) no other point beats in both, by growing cost; None is never on it."""
    out: list[int] = []
    best = float("inf")
    for k in sorted(range(len(points)), key=lambda k: (points[k][0], points[k][1] or 0.0)):
        error = points[k][1]
        if error is not None and error < best:
            out.append(k)
            best = error
    return out


def _tolerance(family: dict[str, Any], way: dict[str, Any]) -> dict[str, Any]:
    worst = [e["max_scaled"] for e in way["errors"].values()]
    held = all(w is not None and w <= way["stated"] for w in worst)
    return {
        "family": family["title"],
        "way": way["way"],
        "stated": way["stated"],
        "points": sum(e["points"] for e in way["errors"].values()),
        "worst": None if None in worst else max(worst),
        "holds": held,
    }


TARGETS = (
    ("cook-torrance", "ours, vectors", 2.0, 1e-13),
    ("cook-torrance", "ours, angles", 4.0, 1e-13),
    ("blinn", "ours, vectors", 2.0, 1e-13),
    ("blinn", "ours, angles", 4.0, 1e-13),
    ("oren-nayar", "ours, vectors", 2.0, 1e-13),
    ("oren-nayar", "ours, angles", 4.0, 1e-13),
    ("he-torrance whole", "ours, tolerance 1e-12", 60.0, 1e-12),
    ("he-torrance common", "ours, tolerance 1e-12", 25.0, 1e-12),
    ("he-torrance common", "ours, tolerance 1e-6", 15.0, 1e-6),
    ("he-torrance common", "ours, Mueller matrix", 150.0, 1e-11),
    ("oren-nayar exact", "exact", 20_000.0, 1e-8),
)
"""Family, way, ns an evaluation, relative error over 1 + conditioning: for an idle AVX-512 machine and two threads."""


def _targets(rows: list[dict[str, Any]], single: list[dict[str, Any]], start: list[dict[str, Any]]) -> list[Any]:
    families = {f["name"]: {w["way"]: w for w in f["ways"]} for f in rows}
    titles = {f["name"]: f["title"] for f in rows}
    out = []
    for family, way, ns, error in TARGETS:
        w = families[family][way]
        worst = [e["max_scaled"] for e in w["errors"].values()]
        achieved = None if None in worst else max(worst)
        found = _target(f"{titles[family]}: {way}", f"{ns:,g} ns".replace(",", " "), w["time"]["best_ns"], "ns", ns)
        found |= {"processor_ns": w["time"]["processor_ns"], "target_error": error, "achieved_error": achieved}
        out.append(found | {"error_met": achieved is not None and achieved <= error})

    def ratio(what: str, family: str, slow: str, fast: str, least: float, of: str = "processor_ns") -> None:
        if slow in families.get(family, {}):
            # by processor time: wall-clock times of a busy machine have no ratio
            factor = families[family][slow]["time"][of] / families[family][fast]["time"][of]
            found = _target(f"{titles[family]}: {what}", f"at least {least:g} times", factor, "times", math.inf)
            out.append(found | {"time_met": factor >= least})

    for family in ("he-torrance common", "he-torrance whole"):
        ratio("public 64 terms / ours", family, "64 terms", "ours, tolerance 1e-12", 3.0)
    # by wall clock: both use all processors, and what Dr.Jit's threads take is not in its processor time
    ratio("Dr.Jit in float64 / ours, wall", "cook-torrance", "Dr.Jit, float64", "ours, vectors", 1.0, "best_ns")
    slowest = max((s for s in single if s["model"] != "oren-nayar exact"), key=lambda s: s["best_us"])
    out.append(_target(f"One geometry from Python ({slowest['model']})", "20 µs", slowest["best_us"], "µs", 20.0))
    longest = max(s["import_s"] for s in start)
    out.append(_target("import gonio.models", "0.3 s", longest, "s", 0.3))
    longest = max(s["together_s"] for s in start)
    out.append(_target("Import and first evaluation, once cached", "1.2 s", longest, "s", 1.2))
    return out


def _target(what: str, target: str, achieved: float, unit: str, most: float) -> dict[str, Any]:
    return {"what": what, "target": target, "achieved": achieved, "unit": unit, "time_met": achieved <= most}


def write(summary: dict[str, Any], folder: Path) -> None:
    """Write page, numbers, tables and figures into a folder that exists."""
    drawn = {f["name"]: figures.front(f) for f in summary["families"] if len(f["ways"]) > 2}
    files.write(folder, summary, drawn.values())
    (folder / "index.html").write_text(html.document(bench_page.render(summary, drawn)), encoding="utf-8")
    (folder / "tables").mkdir()
    points = [
        {"family": f["name"], **w, "set": kind, **e, **w["time"]}
        for f in summary["families"]
        for w in f["ways"]
        for kind, e in (w["errors"] or {"": {}}).items()
    ]
    _csv(folder / "tables" / "points.csv", POINT_COLUMNS, points)
    cases = [{**c, "models": " ".join(c["models"])} for c in summary["hard_cases"]]
    _csv(folder / "tables" / "hard_cases.csv", HARD_COLUMNS, cases)


def _csv(path: Path, columns: Sequence[str], rows: list[dict[str, Any]]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as stream:
        out = csv.DictWriter(stream, columns, extrasaction="ignore", restval="", lineterminator="\n")
        out.writeheader()
        out.writerows(rows)
