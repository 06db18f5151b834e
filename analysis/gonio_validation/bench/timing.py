"""How long the ways take, and on what."""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from gonio.models import engine
from gonio.typing import JsonObject
from gonio_validation.bench.quantity import BenchQuantity, Inputs, TimeSummary, Way


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
