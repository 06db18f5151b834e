"""What a run's own record says of how its table was made."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import GonioError
from gonio.shown import number
from gonio_analysis.result_records import HealthSummary, PauseSummary, RunFacts, SampleFacts
from gonio_analysis.selection.run_budget import run_budget
from gonio_analysis.selection.run_sessions import account, run_sessions

if TYPE_CHECKING:
    from gonio.acquisition.run import Run
    from gonio.rig.description import Reference

REFERENCE = {
    "beside": "beside the sample",
    "axis": "brought by an axis",
    "swap": "swapped with the sample by hand",
    "beam": "the lamp itself, seen straight through an attenuator",
}
STRETCHES = 120
"""Of a run, of each of which the lowest and the highest value of a quantity are kept."""
PAUSE = re.compile(rb'\{"n":\d+,"event":"(suspended|continued)"')
"""How the lines of a journal begin that tell of a pause; a long run's others are not parsed for it."""
SETTINGS = ("level",)
"""Quantities that say what was asked for, and nothing of health."""


def run_facts(path: Path) -> RunFacts | None:
    """What a RUN folder's record says of how its table was made; None for a path that is no run."""
    folder = path if path.is_dir() else path.parent
    if path.is_file() and path.name != "brdf.csv":
        return None
    if not (folder / "run.toml").is_file():
        return None
    from gonio.acquisition.run import Run

    run = Run.open(folder)
    settings = run.settings
    plan = run.plan
    cannot = plan["flag"].astype(str)
    rig = settings.rig
    health, pauses = _health(run)
    return RunFacts(
        folder=str(folder),
        plan=settings.run.plan,
        plan_sha256=settings.run.plan_sha256,
        points=len(plan),
        points_not_reachable={str(k): int(v) for k, v in cannot[cannot != ""].value_counts().items()},
        created=settings.run.created,
        command=settings.run.command,
        rig=rig.name,
        driver=settings.run.rig,
        seed=settings.run.seed,
        bands=list(settings.run.bands),
        steps=len(run.steps()),
        versions=dict(settings.versions),
        lamp_half_angle_deg=rig.lamp.half_angle_deg,
        lens_half_angle_deg=rig.camera.lens_half_angle_deg,
        reference=_reference(folder, rig.reference),
        sample=None
        if settings.sample is None
        else SampleFacts(settings.sample.name, settings.sample.model, dict(settings.sample.parameters)),
        health=health,
        pauses=pauses,
        budget=run_budget(folder),
        sessions=run_sessions(run),
    )


def _reference(folder: Path, reference: Reference) -> str:
    """How the white reference is reached, and how well it is known.

    That is what the reduction has put into the budget; a run that is not reduced says what its rig file states.
    """
    known = [band["u_brdf_rel"] for band in account(folder) if "u_brdf_rel" in band]
    if not known and reference.table is None:
        known = [reference.u_rel]
    words = [REFERENCE[reference.how]]
    if known:
        words.append(f"standard uncertainty {_range(min(known), max(known))}")
    if reference.table is not None:
        words.append(f"its table {_stated(reference.table)}")
    return "; ".join(words)


def _stated(path: str) -> str:
    from gonio import measurement
    from gonio.reduction import reference_table

    try:
        found = reference_table.stated(measurement.read(path))
    except GonioError:
        return "is no longer where it was"
    return "states no uncertainty" if found is None else f"states {_range(*found)}"


def _range(low: float, high: float) -> str:
    """Shares in percent, to two digits."""
    first, second = (f"{number(100 * share, 2)} %" for share in (low, high))
    return first if first == second else f"{first} to {second}"


def _health(run: Run) -> tuple[list[HealthSummary], list[PauseSummary]]:
    """What the devices of a run were like from step to step, and for what it waited."""
    series: dict[tuple[str, str, str], tuple[list[float], list[float]]] = {}
    first_s = None
    for step in run.steps():
        first_s = step.time_s if first_s is None else min(first_s, step.time_s)
        for r in step.health:
            if not isinstance(r.value, str) and r.quantity not in SETTINGS:
                times, values = series.setdefault((r.device, r.quantity, r.unit), ([], []))
                times.append(step.time_s)
                values.append(r.value)
    if first_s is None:
        return [], []
    pauses: list[PauseSummary] = []
    events = run.events()
    for line in events.lines(range(len(events))):
        if not PAUSE.match(line):
            continue
        event = json.loads(line)
        if event["event"] == "suspended":
            pauses.append(PauseSummary(event["message"], (event["time_s"] - first_s) / 3600, None))
        elif pauses and pauses[-1].waited_s is None:
            pauses[-1] = replace(pauses[-1], waited_s=event["waited_s"])
    return [_summary(*key, first_s, *found) for key, found in series.items()], pauses


def _summary(
    device: str, quantity: str, unit: str, first_s: float, times: list[float], values: list[float]
) -> HealthSummary:
    order = np.argsort(times, kind="stable")
    time_h, value = (np.asarray(times)[order] - first_s) / 3600, np.asarray(values)[order]
    low, high = int(np.argmin(value)), int(np.argmax(value))
    parts = np.array_split(np.arange(value.size), min(STRETCHES, value.size))
    kept = np.unique([part[f(value[part])] for part in parts for f in (np.argmin, np.argmax)] + [0, value.size - 1])
    return HealthSummary(
        device, quantity, unit, int(value.size),
        float(value[low]), float(time_h[low]), float(np.median(value)), float(value[high]), float(time_h[high]),
        [round(float(t), 6) for t in time_h[kept]], [float(f"{v:.6g}") for v in value[kept]],
    )  # fmt: skip
