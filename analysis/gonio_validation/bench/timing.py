"""Errors and times of the ways."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gonio import models
from gonio.models import engine
from gonio.typing import Floats
from gonio_validation.bench.evaluators import Quantity, Sample, Way, directions
from gonio_validation.bench.plain import Parameters

NOTHING = 1e-290
"""References below this count as 0."""


@dataclass(frozen=True)
class Errors:
    """What a way made of some samples; NaN and infinite results count as infinite errors."""

    scaled: Floats
    """Relative error over 1 + conditioning."""
    plain: Floats
    """Relative error."""
    values: Floats
    warned: bool


def errors(way: Way, samples: list[Sample]) -> Errors:
    """Evaluate a way on reference samples."""
    got, value, condition = [], [], []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for s in samples:
            arrays = way.convert(*s.arrays) if way.convert else s.arrays
            got.append(np.asarray(way.prepare(s.parameters)(*arrays), dtype=float))
            value.append(s.value)
            condition.append(s.condition)
    result, truth = np.concatenate(got), np.concatenate(value)
    with np.errstate(all="ignore"):
        plain = np.abs(result - truth) / np.abs(truth)
        tiny = np.abs(truth) < NOTHING
        plain[tiny] = np.where(np.abs(result[tiny]) < 1e10 * NOTHING, 0.0, 1.0)
    plain[~np.isfinite(result)] = np.inf
    return Errors(plain / (1.0 + np.concatenate(condition)), plain, result, bool(caught))


def summary(e: Errors) -> dict[str, Any]:
    """Largest, 99th percentile and median relative error, and the largest over 1 + conditioning; None: not finite."""

    def finite(x: float) -> float | None:
        return float(x) if np.isfinite(x) else None

    return {
        "points": int(e.plain.size),
        "max": finite(e.plain.max()),
        "p99": finite(float(np.percentile(e.plain, 99, method="higher"))),
        "median": finite(float(np.percentile(e.plain, 50, method="lower"))),
        "max_scaled": finite(e.scaled.max()),
        "not_finite": int(np.sum(~np.isfinite(e.values))),
        "warning": e.warned,
    }


def by_set(family: Quantity, way: Way) -> dict[str, Any]:
    """Errors of a way on each set of the family's samples; none where its results are not comparable."""
    sets = {s.kind: [x for x in family.samples if x.kind == s.kind] for s in family.samples}
    return {kind: summary(errors(way, sets[kind])) for kind in ("grid", "hard") if kind in sets and way.accurate}


def times(family: Quantity, *, pairs: int, repeats: int, budget_s: float) -> dict[str, dict[str, Any]]:
    """Wall-clock and processor ns an evaluation of each way, all ways in turn within each repeat.

    Parameters
    ----------
    pairs
        Evaluations a repeat.
    repeats
        How often.
    budget_s
        How long one repeat of one way may take [s]: a way that needs longer gets fewer pairs.
    """
    jobs: dict[str, tuple[Callable[[], None], int]] = {}
    few = min(pairs, 1000)
    for way in family.ways:
        small = _job(way, family.timed(few))
        small()  # compiles
        start = time.perf_counter()
        small()
        fits = int(budget_s * few / (time.perf_counter() - start))
        inputs = family.timed(min(pairs, max(few, fits)))
        jobs[way.name] = _job(way, inputs), sum(len(arrays[0]) for _, arrays in inputs)
    wall: dict[str, list[float]] = {name: [] for name in jobs}
    processor: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, (job, count) in jobs.items():
            start, used = time.perf_counter(), time.process_time()
            job()
            processor[name].append((time.process_time() - used) / count * 1e9)
            wall[name].append((time.perf_counter() - start) / count * 1e9)
    return {
        name: {
            "best_ns": min(wall[name]),
            "median_ns": float(np.median(wall[name])),
            "processor_ns": min(processor[name]),
            "pairs": jobs[name][1],
            "repeats": repeats,
        }
        for name in jobs
    }


def _job(way: Way, inputs: list[tuple[Parameters, tuple[Floats, ...]]]) -> Callable[[], None]:
    ready = [(way.prepare(p), way.convert(*arrays) if way.convert else arrays) for p, arrays in inputs]

    def job() -> None:
        for evaluate, arrays in ready:
            evaluate(*arrays)

    return job


def single_calls(repeats: int) -> list[dict[str, Any]]:
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
    out = []
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
            out.append({"model": name, "call": call, "best_us": min(taken), "median_us": float(np.median(taken))})
    return out


def hand_over(repeats: int) -> dict[str, Any] | None:
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


def start_up(repeats: int) -> list[dict[str, Any]]:
    """Seconds that importing takes, and the first evaluation once it is cached, each in a process of its own."""
    out = []
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


def machine() -> dict[str, Any]:
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
