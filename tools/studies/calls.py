"""What a call of a model costs beside its arithmetic: single calls, handing over to threads, the start of a process."""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import Page, Paragraph, Table, code, footer, lead
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.text import number
from gonio_validation.bench import timing
from gonio_validation.bench.page import Column, begun, listed, made, method
from gonio_validation.bench.quantity import directions

from gonio import models
from gonio.models import engine
from gonio.typing import JsonObject

FOOTER = footer("Every number on this page is in `summary.json`.")
SINGLE = (
    Column("model", "model"), Column("call", "call", code), Column("best µs", "best_us", number),
    Column("median µs", "median_us", number),
)  # fmt: skip
START = (
    Column("first model", "model"), Column("import gonio.models", "import_s", number),
    Column("first evaluation", "first_evaluation_s", number), Column("together", "together_s", number),
)  # fmt: skip


def make(
    out: str | Path, *, quick: bool = False, command: str = "", progress: Callable[[str], None] = lambda text: None
) -> Path:
    """Take the times, and write the page; where its `index.html` is.

    Parameters
    ----------
    out
        Folder of the page; an earlier one there is replaced.
    quick
        Fewer repeats: times are rough.
    command, progress
        The command line, for the record; called with a line before each step.
    """
    with files.staged(out) as stage:
        s = begun("Calls of models, and their start", command, quick) | {"machine": timing.machine()}
        progress("single calls")
        s["single_calls"] = single_calls(200 if quick else 3000)
        progress("handing over")
        s["hand_over"] = hand_over(50 if quick else 1000)
        progress("start-up")
        s["start_up"] = start_up(1 if quick else 4)
        files.write_page(stage.work, s["title"], partial(_page, s), lambda _: s)
    return Path(out) / "index.html"


def _page(s: JsonObject, figures: Sequence[Figure]) -> Page:
    slowest = max(row["together_s"] for row in s["start_up"])
    fresh = "Seconds in a fresh process, compiled code already cached; the import loads no numba."
    tables: list[Table] = [
        listed(s["single_calls"], SINGLE, (2, 3), "One geometry from Python."),
        listed(s["start_up"], START, (1, 2, 3), fresh),
    ]
    said = [lead(f"A fresh process has its first value within {number(slowest, 2)} s."), _hand_over(s["hand_over"])]
    return frame.page(s["title"], made(s, ""), frame.answer(said, [], tables), folds=method(s), foot=FOOTER)


def single_calls(repeats: int) -> list[JsonObject]:
    """us of one evaluation of one geometry from Python."""
    chosen: dict[str, models.Model] = {
        "lambert": models.Lambert(),
        "phong": models.Phong(),
        "blinn": models.Blinn(),
        "cook-torrance": models.CookTorrance(),
        "oren-nayar": models.OrenNayar(),
        "oren-nayar exact": models.OrenNayar(form="exact"),
        "he-torrance": models.HeTorrance(),
    }
    out: list[JsonObject] = []
    vectors = np.array([0.6, 0.0, 0.8]), np.array([-0.48, 0.36, 0.8])
    for name, model in chosen.items():
        for call, arguments in (("brdf", (0.7, 0.1, 0.6, 3.0)), ("brdf_vectors", vectors)):
            function = getattr(model, call)
            function(*arguments)
            taken = []
            for _ in range(repeats):
                start = time.perf_counter()
                function(*arguments)
                taken.append((time.perf_counter() - start) * 1e6)
            median = float(np.median(taken))
            out.append({"model": name, "call": call, "best_us": min(taken), "median_us": median})
    return out


def hand_over(repeats: int) -> JsonObject | None:
    """What it costs to hand half of a call to a second thread; None where this process may use one processor only.

    The smallest call that two threads share takes longer than a call of half as many pairs, which one thread does
    alone. The difference is the hand-over: waking a thread, waiting for it, and the interpreter's work for both.
    """
    half = engine.SPLIT
    if engine.threads() < 2:
        return None
    model = models.CookTorrance()
    calls = {count: directions(count) for count in (half, 2 * half)}
    taken: dict[int, list[float]] = {count: [] for count in calls}
    for _ in range(repeats + 1):  # the first compiles, and starts the threads
        for count, vectors in calls.items():
            start = time.perf_counter()
            model.brdf_vectors(*vectors)
            taken[count].append((time.perf_counter() - start) * 1e6)
    alone, shared = (float(np.median(taken[count][1:])) for count in (half, 2 * half))
    cost = max(shared - alone, 0.0)
    return {
        "model": "cook-torrance",
        "pairs": 2 * half,
        "shared_us": shared,
        "half_alone_us": alone,
        "hand_over_us": cost,
        "share": cost / shared,
        "repeats": repeats,
    }


_START = """
import sys, time
a = time.perf_counter()
import gonio.models
b = time.perf_counter()
assert "numba" not in sys.modules
gonio.models.{model}().brdf(0.5, 0.0, 0.4, 3.0)
c = time.perf_counter()
print(b - a, c - b)
"""


def start_up(repeats: int) -> list[JsonObject]:
    """Seconds that importing takes, and the first evaluation once it is cached, each in a process of its own."""
    out: list[JsonObject] = []
    for model in ("CookTorrance", "HeTorrance"):
        taken = []
        for _ in range(repeats + 1):
            made = subprocess.run(
                [sys.executable, "-c", _START.format(model=model)], capture_output=True, text=True, check=True
            )
            taken.append([float(x) for x in made.stdout.split()])
        best = min(taken[1:], key=sum)
        out.append({"model": model, "import_s": best[0], "first_evaluation_s": best[1], "together_s": sum(best)})
    return out


def _hand_over(h: JsonObject | None) -> Paragraph:
    if h is None:
        return Paragraph("This process may use one processor only: no call is handed to a second thread.")
    return Paragraph(
        f"A call of {h['pairs']} pairs or more is shared by threads. To hand half of it over costs"
        f" {number(h['hand_over_us'], 2)} µs: {h['model']} takes {number(h['shared_us'])} µs for {h['pairs']} pairs on"
        f" two threads, and {number(h['half_alone_us'])} µs for half as many on one (medians of {h['repeats']} calls in"
        f" turn). That is {100 * h['share']:.0f} % of the smallest shared call, and the less the larger a call is."
    )
