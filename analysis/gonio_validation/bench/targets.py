"""What is judged: speeds and errors against their targets, and the accuracies that ways state."""

from collections.abc import Sequence

from gonio.documents import JsonObject
from gonio_validation.bench.quantity import QuantitySummary, WaySummary

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
"""Quantity, way, ns an evaluation on an idle AVX-512 machine with two threads, relative error over 1 + conditioning."""


def judged(
    quantities: Sequence[QuantitySummary], single: Sequence[JsonObject], start: Sequence[JsonObject]
) -> list[JsonObject]:
    """Every target with what was achieved: a time or a ratio of times, and the error of a way."""
    ways = {q.name: {w.way: w for w in q.ways} for q in quantities}
    titles = {q.name: q.title for q in quantities}
    out: list[JsonObject] = []
    for name, way, ns, error in TARGETS:
        w = ways[name][way]
        target = f"{ns:,g} ns".replace(",", " ")
        found = _target(f"{titles[name]}: {way}", target, w.time.best_ns, "ns", w.time.best_ns <= ns)
        errors = {
            "processor_ns": w.time.processor_ns, "target_error": error, "achieved_error": w.worst,
            "error_met": w.worst is not None and w.worst <= error,
        }  # fmt: skip
        out.append(found | errors)

    def ratio(what: str, name: str, slow: float, fast: float, least: float) -> None:
        factor = slow / fast
        out.append(_target(f"{titles[name]}: {what}", f"at least {least:g} times", factor, "times", factor >= least))

    for name in ("he-torrance common", "he-torrance whole"):
        if "64 terms" in ways.get(name, {}):
            # by processor time: wall-clock times of a busy machine have no ratio
            slow, fast = (ways[name][way].time.processor_ns for way in ("64 terms", "ours, tolerance 1e-12"))
            ratio("public 64 terms / ours", name, slow, fast, 3.0)
    if "Dr.Jit, float64" in ways.get("cook-torrance", {}):
        # by wall clock: both use all processors, and what Dr.Jit's threads take is not in its processor time
        slow, fast = (ways["cook-torrance"][way].time.best_ns for way in ("Dr.Jit, float64", "ours, vectors"))
        ratio("Dr.Jit in float64 / ours, wall", "cook-torrance", slow, fast, 1.0)
    slowest = max((s for s in single if s["model"] != "oren-nayar exact"), key=lambda s: float(s["best_us"]))
    for what, achieved, most, unit in (
        (f"One geometry from Python ({slowest['model']})", slowest["best_us"], 20.0, "µs"),
        ("import gonio.models", max(s["import_s"] for s in start), 0.3, "s"),
        ("Import and first evaluation, once cached", max(s["together_s"] for s in start), 1.2, "s"),
    ):
        out.append(_target(what, f"{most:g} {unit}", achieved, unit, achieved <= most))
    return out


def _target(what: str, target: str, achieved: float, unit: str, met: bool) -> JsonObject:
    return {"what": what, "target": target, "achieved": achieved, "unit": unit, "time_met": met}


def tolerances(quantities: Sequence[QuantitySummary]) -> list[JsonObject]:
    """Every accuracy that a way states, with its largest error over 1 + conditioning."""
    return [
        {
            "family": q.title, "way": w.way, "stated": w.stated, "points": sum(e.points for e in w.errors.values()),
            "worst": w.worst, "holds": holds(w, w.stated),
        }
        for q in quantities
        for w in q.ways
        if w.stated is not None
    ]  # fmt: skip


def holds(way: WaySummary, stated: float) -> bool:
    """A stated accuracy holds where the largest error on every set is finite and not larger."""
    return way.worst is not None and way.worst <= stated
