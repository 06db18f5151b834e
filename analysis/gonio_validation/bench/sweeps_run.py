"""One comparison of plans: a sample, a geometry, a seed; every plan measured, every curve held against the truth."""

import time
from dataclasses import asdict, dataclass

import numpy as np
from gonio_sweeps.posterior import Posterior

from gonio.acquisition.measure import find_rig
from gonio.documents import JsonObject
from gonio.typing import Floats
from gonio_validation.bench import sweeps_plans
from gonio_validation.bench.sweeps_plans import FLOOR, INCIDENCES, SIZES, WAVELENGTH_NM, Geometry, Places
from gonio_validation.bench.sweeps_rig import FrameFreeRig, MeasuredSweep, in_order

FORMAT = 3
FIXED = ("uniform", "mirror-dense", "half-vector")
SHARE = 0.45
"""An adaptive run by points has so many of the points of the largest uniform one."""


@dataclass(frozen=True)
class Result:
    """A plan, measured and made into a curve."""

    plan: str
    """"uniform", "mirror-dense", "half-vector", "adaptive" (by rig time) or "adaptive by points"."""
    way: str
    """"interpolated" or "process": how the curve was made of the points."""
    points: int
    seconds: float
    """Rig time."""
    rms: float
    """Root mean square of the relative error over the curve, or the hemisphere."""
    largest: float
    inside: float | None
    """Part of the curve whose interval of 95 % holds the truth."""
    u_rel: float | None
    """Median stated relative standard uncertainty."""


def carried_out(name: str, geometry: Geometry, seed: int) -> JsonObject:
    """The record of a comparison, as JSON has it."""
    began = time.perf_counter()
    description = find_rig("sim").description
    band = description.bands.containing(WAVELENGTH_NM)
    model = sweeps_plans.sample(name)
    number = list(sweeps_plans.SAMPLES).index(name)
    places = sweeps_plans.judged(geometry, description)

    def rig(kind: int) -> FrameFreeRig:
        # all plans of one comparison have the same errors of zeros and scale, and noise of their own
        return FrameFreeRig(description, band, model, (seed, number), kind)

    truth = rig(0).truth(places.directions)
    # what the values' uncertainties are made of is the rig's, and alike in all plans
    known = sweeps_plans.sampler(geometry, description, None).known
    results: list[Result] = []
    for kind, plan in enumerate(FIXED):
        for size in SIZES[geometry]:
            points = sweeps_plans.fixed(plan, geometry, size, description)
            poses = [a.pose for a in points if a.pose is not None]
            measured = rig(10 * size + kind).measure(in_order([a.point for a in points], poses))
            results.append(_simple(plan, measured, places, truth))
            results.append(_by_process(plan, measured, known(measured.values), places, truth))
    most = max(SIZES[geometry]) * len(INCIDENCES[geometry])
    results += _adaptive("adaptive", rig(1), geometry, None, round(0.6 * most), places, truth)
    if geometry == "in plane":
        # of those that the blocked cone leaves
        by_points = int(SHARE * max(r.points for r in results if r.plan == "uniform"))
        results += _adaptive("adaptive by points", rig(2), geometry, by_points, by_points, places, truth)[-1:]
    seconds = time.perf_counter() - began
    return {
        "format": FORMAT, "sample": name, "geometry": geometry, "seed": seed, "seconds": seconds,
        "results": [asdict(r) for r in results],
    }  # fmt: skip


def _adaptive(
    plan: str, rig: FrameFreeRig, geometry: Geometry, most: int | None, stop: int, places: Places, truth: Floats
) -> list[Result]:
    """After every batch: what is known by then."""
    sampler = sweeps_plans.sampler(geometry, rig.description, most)
    out: list[Result] = []
    measured: MeasuredSweep | None = None
    kernel: list[list[float]] | None = None
    wanted = list(sampler.first(()))
    rows = [sampler.candidates.points.index(point) for point in wanted]
    while rows:
        measured = rig.measure([sampler.candidates.poses[k] for k in rows], measured)
        decided = sampler.decided([measured.values], measured.seconds, kernel)
        before, kernel = kernel, decided.why["kernel"]
        posterior = sampler.known(measured.values, None if before is None else before[0])
        out.append(_by_process(plan, measured, posterior, places, truth))
        rows = decided.picked if len(measured.values) < stop else []
    return out


def _relative(f: Floats, truth: Floats) -> Floats:
    return np.asarray((f - truth) / np.maximum(truth, FLOOR * truth.max()))


def _simple(plan: str, measured: MeasuredSweep, places: Places, truth: Floats) -> Result:
    error = _relative(sweeps_plans.interpolated(measured.values, places.directions), truth)
    return Result(
        plan, "interpolated", len(measured.values), measured.seconds, _rms(error, places), float(np.abs(error).max()),
        None, None,
    )  # fmt: skip


def _by_process(plan: str, measured: MeasuredSweep, known: Posterior, places: Places, truth: Floats) -> Result:
    f, u, low, high = known.at(places.directions)
    error = _relative(f, truth)
    inside = float(places.weight @ ((low <= truth) & (truth <= high)))
    u_rel = float(np.median(u / np.maximum(truth, FLOOR * truth.max())))
    return Result(
        plan, "process", len(measured.values), measured.seconds, _rms(error, places), float(np.abs(error).max()),
        inside, u_rel,
    )  # fmt: skip


def _rms(error: Floats, places: Places) -> float:
    return float(np.sqrt(places.weight @ error**2))
