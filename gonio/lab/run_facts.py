"""What a run's own record says of how its table was made: health, pauses, sessions, and the reduction's budget.

A run that is gone on with has several sessions, over hours or days, with the reference as the thread.
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_right
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import fmean, stdev
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import GonioError
from gonio.geometry import Directions
from gonio.run_facts import (
    BudgetCurve,
    BudgetFacts,
    BudgetPart,
    HealthSummary,
    PauseSummary,
    ReferenceLevel,
    RunFacts,
    SampleFacts,
    SessionSummary,
)
from gonio.shown import finite, number
from gonio.typing import DataFrame, Floats, JsonObject

if TYPE_CHECKING:
    from gonio.lab.acquisition.run import Run
    from gonio.lab.rig.description import Reference
    from gonio.samples.description import SampleDescription

REFERENCE = {
    "beside": "beside the sample",
    "axis": "brought by an axis",
    "swap": "swapped with the sample by hand",
    "beam": "the lamp itself, seen straight through an attenuator",
}
STRETCHES = 120
"""Stretches of a run, of each of which the lowest and the highest value of a quantity are kept."""
PAUSE = re.compile(rb'\{"n":\d+,"event":"(suspended|continued)"')
"""How the lines of a journal begin that tell of a pause; a long run's others are not parsed for it."""
SETTINGS = ("level",)
"""Quantities that say what was asked for, and nothing of health."""
KIND = re.compile(rb'\{"n":\d+,"event":"(\w+)"(?:,"step":\d+,"kind":"(\w+)")?')
"""How the lines of a journal begin."""
ENDINGS = {"end": "all was measured", "interrupted": "was interrupted", "device_error": "a device failed"}
UNKNOWN = "no word of an end"
"""Ending of a session whose process was killed, or that goes on now."""
LARGEST = 5
"""Causes whose shares are drawn."""
MOST_POINTS = 120
"""Most points of one curve."""
INFORMATION = ("nu_eff", "coarse", "cone_difference", "flag")
"""Columns behind the parts that are no parts."""


def run_facts(path: Path) -> RunFacts | None:
    """What a RUN folder's record says of how its table was made; None for a path that is no run."""
    folder = path if path.is_dir() else path.parent
    if path.is_file() and path.name != "brdf.csv":
        return None
    if not (folder / "run.toml").is_file():
        return None
    from gonio.lab.acquisition.run import Run

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
        else SampleFacts(settings.sample.name, settings.sample.model, _given(settings.sample)),
        health=health,
        pauses=pauses,
        budget=run_budget(folder),
        sessions=run_sessions(run),
    )


def _given(sample: SampleDescription) -> JsonObject:
    """The parameters; of those that change over the sample, from where to where; of regions, their own."""
    changing = {
        name: f"{one.low:g} to {one.high:g} ({one.pattern or 'picture'})" for name, one in sample.texture.items()
    }
    regions = {
        f"region {k}": f"{one.name}, {one.model} of "
        + ", ".join(f"{name} {value}" for name, value in _given(one).items())
        for k, one in enumerate(sample.materials()[1:], 1)
    }
    return sample.parameters | changing | regions


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
    from gonio.lab.reduction import reference_table

    try:
        found = reference_table.stated(reference_table.read(path))
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


# ---- sessions ----


@dataclass
class _Session:
    began: str
    ended: str
    steps: int = 0
    ending: str = UNKNOWN
    levels: dict[str, list[float]] = field(default_factory=dict)
    """Signals of the visits to the reference, by band."""


def run_sessions(run: Run) -> list[SessionSummary]:
    """The sessions in which a run took steps, in order; levels of the reference where the run has been reduced."""
    found, visits_s = _sessions(run)
    times_s = [time_s for time_s, _ in visits_s]
    for band in account(run.path):
        for time_s, signal in zip(band["times_s"], band["signals"], strict=True):
            visit = bisect_right(times_s, time_s) - 1  # the visit that had begun last
            if visit >= 0:
                visits_s[visit][1].levels.setdefault(band["band"], []).append(signal)
    first: dict[str, float] = {}
    out = []
    for session in found:
        levels = []
        for name, signals in session.levels.items():
            level = fmean(signals)
            relative = level / first.setdefault(name, level)
            scatter = stdev(signals) / first[name] if len(signals) > 1 else None
            levels.append(ReferenceLevel(name, len(signals), relative, scatter))
        if session.steps:
            out.append(SessionSummary(session.began, session.ended, session.steps, session.ending, levels))
    return out


def _sessions(run: Run) -> tuple[list[_Session], list[tuple[float, _Session]]]:
    """Every session, and the visits to the reference: when each began [s, rig's clock], and in which session."""
    found: list[_Session] = []
    visits: list[tuple[float, _Session]] = []
    last = b""
    events = run.events()
    for line in events.lines(range(len(events))):
        match = KIND.match(line)
        kind = match[1].decode() if match else ""
        if kind == "session":
            if found:
                found[-1].ended = json.loads(last)["wall"]
            wall = json.loads(line)["wall"]
            found.append(_Session(wall, wall))
        elif found and match and kind == "step":
            found[-1].steps += 1
            if match[2] == b"reference":
                visits.append((float(json.loads(line)["time_s"]), found[-1]))
        elif found and kind in ENDINGS:
            found[-1].ending = ENDINGS[kind]
        last = line
    if found:
        found[-1].ended = json.loads(last)["wall"]
    return found, sorted(visits, key=lambda visit: visit[0])


def account(folder: Path) -> list[JsonObject]:
    """What the visits to the reference said, a band each, as the reduction has left it; nothing before it."""
    with suppress(OSError, ValueError):
        visits = _provenance(folder).get("reference") or []
        return [band for band in visits if isinstance(band, dict) and "times_s" in band]
    return []


def _provenance(folder: Path) -> JsonObject:
    """What the reduction says beside its table; raises `OSError` or `ValueError` where it has left none."""
    meta: JsonObject = json.loads((folder / "brdf.meta.json").read_text(encoding="utf-8"))
    return meta.get("provenance") or {}


# ---- the budget that a reduction wrote beside its table ----


def run_budget(folder: Path) -> list[BudgetFacts]:
    """The budget of a run, one a wavelength; none where the run has no budget of its table as it stands."""
    import pandas as pd

    try:
        parts = pd.read_csv(folder / "budget.csv", keep_default_na=True)
        stated = pd.read_csv(folder / "brdf.csv", usecols=["u_brdf"])["u_brdf"]
        provenance = _provenance(folder)
    except (OSError, ValueError):
        return []
    if "u_brdf" not in parts or not np.array_equal(parts["u_brdf"], stated, equal_nan=True):
        return []  # of another table
    left_out = {row["cause"]: row["why"] for row in provenance.get("not_in_budget") or []}
    verdict = (provenance.get("monte_carlo") or {}).get("verdict")
    columns = [str(name) for name in parts.columns]
    names = [name for name in columns[columns.index("u_brdf") + 1 :] if name not in INFORMATION]
    out = []
    for wavelength in parts["wavelength_nm"].unique().tolist():
        here = parts["wavelength_nm"].isna() if math.isnan(wavelength) else parts["wavelength_nm"] == wavelength
        used = parts[here & (parts["brdf"].abs() > 3.0 * parts["u_brdf"])]
        if len(used):
            out.append(_budget(finite(wavelength), used, names, left_out, verdict))
    return out


def _budget(
    wavelength_nm: float | None, rows: DataFrame, names: list[str], left_out: dict[str, str], verdict: str | None
) -> BudgetFacts:
    size, u = rows["brdf"].abs().to_numpy(), rows["u_brdf"].to_numpy()
    values = np.nan_to_num(rows[names].to_numpy(dtype=float))
    shares = values**2 / (u**2)[:, None]
    relative = abs(values) / size[:, None]
    parts = [
        BudgetPart(
            name.removeprefix("s_").replace("_", " "),
            name.startswith("s_"),
            float(np.median(relative[:, k])),
            float(relative[:, k].max()),
            float(shares[:, k].mean()),
        )
        for k, name in enumerate(names)
    ]
    order = sorted(range(len(parts)), key=lambda k: -parts[k].share)
    drawn = [k for k in order[:LARGEST] if parts[k].share > 0]
    apart = np.sqrt(np.maximum(u**2 - (rows["s_reference"].to_numpy() if "s_reference" in rows else 0.0) ** 2, 0.0))
    freedom = float(rows["nu_eff"].min())
    return BudgetFacts(
        wavelength_nm=wavelength_nm,
        values=len(rows),
        median=float(np.median(u / size)),
        highest=float(np.max(u / size)),
        median_apart=float(np.median(apart / size)),
        highest_apart=float(np.max(apart / size)),
        parts=[parts[k] for k in order],
        largest=[parts[k].cause for k in drawn],
        curves=_curves(rows, shares[:, drawn]),
        nu_eff=freedom if math.isfinite(freedom) else None,
        coarse=int(rows["coarse"].astype(bool).sum()),
        left_out=left_out,
        monte_carlo=verdict,
    )


def _curves(rows: DataFrame, shares: Floats) -> list[BudgetCurve]:
    """Curves in the plane of incidence, of at least two values."""
    at = Directions.from_table(rows).settled_at_normal()
    theta_i, signed = np.round(np.degrees(at.theta_i)), np.degrees(at.signed)
    out = []
    # encoders read the same nominal angle within a step
    for nominal in np.unique(theta_i):
        k = np.flatnonzero(at.in_plane & (theta_i == nominal))
        k = k[np.argsort(signed[k])]
        if k.size >= 2:
            k = k[np.unique(np.linspace(0, k.size - 1, min(k.size, MOST_POINTS)).round().astype(int))]
            rounded = [[float(f"{x:.4g}") for x in column] for column in shares[k].T]
            out.append(BudgetCurve(float(nominal), [round(float(x), 4) for x in signed[k]], rounded))
    return out
