"""How long the ways take, single calls, handing over to threads, and the start of a process."""

import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from gonio import models
from gonio.models import engine
from gonio.typing import JsonObject
from gonio_validation.bench.quantity import BenchQuantity, Inputs, TimeSummary, Way, directions


@dataclass(frozen=True)
class Effort:
    """How long the ways are timed."""

    pairs: int
    """Evaluations a repeat."""
    repeats: int
    budget_s: float
    """How long one repeat of one way may take [s]: a way that needs longer gets fewer pairs."""


def times(quantity: BenchQuantity, effort: Effort) -> dict[str, TimeSummary]:
    """Wall-clock and processor ns an evaluation of each way, all ways in turn within each repeat."""
    jobs: dict[str, tuple[Callable[[], None], int]] = {}
    few = min(effort.pairs, 1000)
    for way in quantity.ways:
        small = _job(way, quantity.timed(few))
        small()  # compiles
        start = time.perf_counter()
        small()
        fits = int(effort.budget_s * few / (time.perf_counter() - start))
        inputs = quantity.timed(min(effort.pairs, max(few, fits)))
        jobs[way.name] = _job(way, inputs), sum(len(arrays[0]) for _, arrays in inputs)
    wall: dict[str, list[float]] = {name: [] for name in jobs}
    processor: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(effort.repeats):
        for name, (job, count) in jobs.items():
            start, used = time.perf_counter(), time.process_time()
            job()
            processor[name].append((time.process_time() - used) / count * 1e9)
            wall[name].append((time.perf_counter() - start) / count * 1e9)
    return {
        name: TimeSummary(
            best_ns=min(wall[name]),
            median_ns=float(np.median(wall[name])),
            processor_ns=min(processor[name]),
            pairs=jobs[name][1],
            repeats=effort.repeats,
        )
        for name in jobs
    }


def _job(way: Way, inputs: Inputs) -> Callable[[], None]:
    ready = [(way.prepare(p), way.convert(*arrays) if way.convert else arrays) for p, arrays in inputs]

    def job() -> None:
        for evaluate, arrays in ready:
            evaluate(*arrays)

    return job


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


def machine() -> JsonObject:
    """What the times are taken on, and how busy it is."""
    cpu, flags = platform.processor() or "unknown", ""
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = {k.strip(): v.strip() for k, _, v in (x.partition(":") for x in info.read_text().splitlines())}
        cpu, flags = lines.get("model name", cpu), lines.get("flags", "")
    wanted = [f for f in flags.split() if f in ("avx2", "fma", "bmi2") or f.startswith("avx512")]
    return {
        "cpu": cpu,
        "cpus": engine.threads(),
        "flags": wanted,
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("gonio", "numpy", "numba", "llvmlite", "scipy")},
    }
