"""Measure speed against error of every way of evaluating the models, judge it, and write the report."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from gonio_analysis.report import files
from gonio_analysis.report.drawing import Figure

from gonio import measurement
from gonio.typing import JsonObject
from gonio_validation.bench import accuracy, evaluators, hard_cases, pareto, peers, results_page, timing, which_model
from gonio_validation.bench.page import begun
from gonio_validation.bench.quantity import BenchQuantity, PeerTime, QuantitySummary, Set, WaySummary, reference

POINT_COLUMNS = (
    *("family", "way", "ours", "set", "points", "max", "p99", "median", "max_scaled", "not_finite", "warning"),
    *("best_ns", "median_ns", "processor_ns", "pairs", "note"),
)


def make(
    out: str | Path,
    *,
    sample: str | Path | None = None,
    quick: bool = False,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Measure every way of evaluating every model, and write the report: all of it or nothing.

    Parameters
    ----------
    out
        Folder of the report; an earlier report there is replaced.
    sample
        A measurement table that the models are compared on; a matt and a metallic sample if none is given.
    quick
        Fewer pairs and repeats: errors are the same, times are rough.
    command
        The command line, for the record.
    progress
        Called with a line before each step.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that is not a report; the table cannot be read.
    DataError
        No model can be fitted to the table.
    """
    with files.staged(out) as stage:
        write(collect(sample=sample, quick=quick, command=command, progress=progress), stage.work)
    return Path(out) / "index.html"


def collect(
    *,
    sample: str | Path | None = None,
    quick: bool = False,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> JsonObject:
    """Every number of the report, as `summary.json` holds it; parameters as `make`."""
    effort = timing.Effort(20_000, 3, 0.02) if quick else timing.Effort(1_000_000, 9, 0.4)
    started = timing.machine()
    states, others = peers.find()
    samples = (
        which_model.built_in() if sample is None else [which_model.Sample(Path(sample).stem, measurement.read(sample))]
    )
    chosen = [which_model.compared(one, effort, progress) for one in samples]
    found = evaluators.quantities()
    rows = []
    for quantity in found:
        here = others if quantity.name == peers.QUANTITY else []
        progress(f"{quantity.title}: {len(quantity.ways) + len(here)} ways")
        rows.append(_measured(quantity, here, effort))
    progress("hard cases")
    cases = hard_cases.judged(found, 200_000 if quick else 4_000_000)
    progress("single calls and start-up")
    single = timing.single_calls(200 if quick else 3000)
    handed = timing.hand_over(50 if quick else 1000)
    start = timing.start_up(1 if quick else 4)
    return begun("Models: speed against error", command, quick) | {
        "machine": started,
        "reference": reference().made,
        "families": rows,
        "ratios": ratios(rows),
        "which_model": chosen,
        "tolerances": tolerances(rows),
        "hard_cases": cases,
        "single_calls": single,
        "hand_over": handed,
        "start_up": start,
        "peers": states,
    }


def _measured(quantity: BenchQuantity, others: Sequence[peers.PeerProgram], effort: timing.Effort) -> QuantitySummary:
    """Errors and times of all ways, those of peers included."""
    taken = timing.times(quantity, effort)
    ways = [*quantity.ways, *(peer.way for peer in others)]
    apart = [peers.measured(peer, effort) for peer in others]
    errors = [*(accuracy.by_set(quantity, way) for way in quantity.ways), *(m.errors for m in apart)]
    times = [*(taken[way.name] for way in quantity.ways), *(m.time for m in apart)]

    def front(kind: Set) -> list[int]:
        found = (e.get(kind) for e in errors)
        return pareto.front([(t.best_ns, e.max if e else None) for t, e in zip(times, found, strict=True)])

    grid, hard = front("grid"), front("hard")
    summaries = [
        WaySummary(way.name, way.ours, way.peer, way.note, way.stated, e, time, k in grid, k in hard)
        for k, (way, e, time) in enumerate(zip(ways, errors, times, strict=True))
    ]
    return QuantitySummary(quantity.name, quantity.title, quantity.about, quantity.inputs, summaries)


def write(summary: JsonObject, folder: Path) -> None:
    """Write page, numbers, tables and figures into a folder that exists."""
    files.written(folder / "tables" / "points.csv", partial(_points_table, summary))
    files.written(folder / "tables" / "hard_cases.csv", partial(_hard_table, summary))

    def draw() -> list[Figure]:
        fronts = [pareto.draw(q) for q in summary["families"] if len(q.ways) > 2]
        return [which_model.draw(summary["which_model"]), *fronts]

    files.write_page(folder, summary["title"], partial(results_page.render, summary), lambda _: summary, draw)


def _points_table(summary: JsonObject, path: Path) -> None:
    files.write_csv(path, POINT_COLUMNS, _points(summary["families"]))


def _hard_table(summary: JsonObject, path: Path) -> None:
    hard = [c | {"models": " ".join(c["models"])} for c in summary["hard_cases"]]
    files.write_csv(path, list(hard[0]), (list(c.values()) for c in hard))


def _points(families: Sequence[QuantitySummary]) -> Iterator[list[object]]:
    """The rows of `points.csv`: a way on a set, or a way without comparable results."""
    for quantity in families:
        for way in quantity.ways:
            facts = {"family": quantity.name, **vars(way), **vars(way.time)}
            rows = [facts | {"set": kind} | vars(errors) for kind, errors in way.errors.items()] or [facts]
            yield from ([row.get(column) for column in POINT_COLUMNS] for row in rows)


# --- what is judged: costs on this machine, and the accuracies that ways state -------------------------------------


def ratios(quantities: Sequence[QuantitySummary]) -> list[JsonObject]:
    """How many times longer others take than ours, on this machine."""
    ways = {q.name: {w.way: w.time for w in q.ways} for q in quantities}
    titles = {q.name: q.title for q in quantities}
    out: list[JsonObject] = []
    for name, slow, fast in COMPARED:
        times = ways.get(name, {})
        if slow in times and fast in times:
            # by processor time, as wall-clock times of a busy machine have no ratio; but what Dr.Jit's threads take is
            # not in its processor time
            kind = "best_ns" if isinstance(times[slow], PeerTime) else "processor_ns"
            ratio = getattr(times[slow], kind) / getattr(times[fast], kind)
            out.append({"what": f"{titles[name]}: {slow} / {fast}", "ratio": ratio, "of": kind})
    return out


COMPARED = (
    ("he-torrance common", "64 terms", "ours, tolerance 1e-12"),
    ("he-torrance whole", "64 terms", "ours, tolerance 1e-12"),
    ("cook-torrance", "plain numpy", "ours, vectors"),
    ("cook-torrance", "Dr.Jit, float64", "ours, vectors"),
    ("oren-nayar exact", "exact", "functional"),
)
"""Quantity, and two ways whose times are divided."""


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
