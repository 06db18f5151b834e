"""The study `maps`: what a fit of a pixel takes, and how far it is from a fit of one table and from the truth."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gonio_analysis.fitting.fit import fit
from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import Heading, Page, Paragraph, Stamp, footer, lead, stamp
from gonio_analysis.report.text import number
from gonio_maps.models import batch
from gonio_validation.bench.page import Column, listed, part
from scipy.optimize import least_squares

from gonio.geometry import Directions
from gonio.models import build
from gonio.typing import Floats, JsonObject
from tools.studies import maps_jax

POINTS, PIXELS, QUICK = 100, 20_000, 500
"""Directions; drawn pixels of a model; those of a quick run."""
COMPARED = 12
"""Pixels that `gonio fit` and scipy fit as well."""
NOISE = 0.01
RANGES: dict[str, tuple[dict[str, tuple[float, float]], dict[str, float]]] = {
    "cook-torrance": ({"s": (0.1, 0.8), "m": (0.1, 0.5), "diffuse_albedo": (0.1, 0.8)}, {"ior": 1.5}),
    "ggx": ({"alpha": (0.1, 0.5), "diffuse_albedo": (0.1, 0.8)}, {"ior": 1.5}),
    "oren-nayar": ({"albedo": (0.1, 0.9), "sigma_deg": (8.0, 40.0)}, {}),
    "blinn": ({"k_s": (0.1, 1.0), "k_d": (0.1, 0.6), "c": (0.1, 0.5)}, {"ior": 1.5}),
    "he-torrance": ({"sigma0_um": (0.06, 0.2), "tau_um": (1.0, 3.0), "diffuse_albedo": (0.1, 0.5)}, {"ior": 1.5}),
}
"""What is drawn of each model, and what is known."""


def _in(unit: str, digits: int) -> Callable[[float], str]:
    return lambda value: f"{number(value, digits)} {unit}"


TIMES = [
    Column("model", "model"),
    Column("pixels", "pixels"),
    Column("own directions", "own_us", _in("µs", 3)),
    Column("shared", "shared_us", _in("µs", 3)),
    Column("rejected", "rejected_us", _in("µs", 3)),
    Column("gonio fit", "fit_ms", _in("ms", 3)),
    Column("scipy", "scipy_ms", _in("ms", 3)),
]
ERRORS = [
    Column("model", "model"),
    Column("from gonio fit", "from_fit", _in("u", 2)),
    Column("(found - true) / u: standard deviation", "pull_sd", lambda values: ", ".join(f"{x:.3f}" for x in values)),
    Column("beyond 5 u", "beyond_5"),
    Column("worse than the truth", "worse_than_truth"),
]
TITLE = "Fits of maps: speed against error"
FOOTER = footer("Every number is in `summary.json`.")


def drawn(name: str, pixels: int, seed: int, reach_mm: float = 10.0) -> dict[str, Any]:
    """Pixels of drawn parameters, half of their directions around the mirror direction, with noise of 1 %."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(rng.choice([5.0, 20.0, 40.0, 60.0, 72.0], POINTS))
    theta_r, phi = np.radians(rng.uniform(0.0, 75.0, POINTS)), rng.uniform(0.0, 2.0 * np.pi, POINTS)
    near = np.arange(POINTS) % 2 == 0
    theta_r[near] = np.clip(theta_i[near] + rng.normal(0.0, 0.2, near.sum()), 0.02, 1.4)
    phi[near] = np.pi + rng.normal(0.0, 0.3, near.sum())
    source = 500.0 * np.stack([np.sin(theta_i), 0.0 * theta_i, np.cos(theta_i)], axis=1)
    camera = 600.0 * np.stack([np.sin(theta_r) * np.cos(phi), np.sin(theta_r) * np.sin(phi), np.cos(theta_r)], axis=1)
    ranges, fixed = RANGES[name]
    x, y = rng.uniform(-reach_mm, reach_mm, (2, pixels))
    true = {one: rng.uniform(*limits, pixels) for one, limits in ranges.items()}
    exact = np.empty((pixels, POINTS))
    for p in range(pixels):
        at = seen(source, camera, x[p], y[p])
        exact[p] = build(name, {one: float(v[p]) for one, v in true.items()} | fixed).brdf(*at.angles)
    values = exact * (1.0 + NOISE * rng.standard_normal(exact.shape))
    return {"x": x, "y": y, "source": source, "camera": camera, "exact": exact, "values": values,
            "u": NOISE * exact, "true": true, "fixed": fixed}  # fmt: skip


def seen(source: Floats, camera: Floats, x: float, y: float) -> Directions:
    """Directions from a spot of the sample [mm]."""
    spot = np.array([x, y, 0.0])
    return Directions.from_vectors(source - spot, camera - spot)


def timed(work: Callable[[], Any], count: int) -> tuple[Any, float]:
    """What comes out, and processor time of one of `count` [s]."""
    began = time.process_time()
    found = work()
    return found, (time.process_time() - began) / count


def measured(name: str, pixels: int) -> JsonObject:
    """One model: processor time of one thread a pixel (of `gonio fit` and scipy: a table), and errors.

    Errors are in standard uncertainties: the largest difference of a parameter from that of `gonio fit` and of jax
    (Cook-Torrance alone, None where it is not installed), and the standard deviation of (found - true) / u by free
    parameter. `worse_than_truth` counts pixels whose chi-square is above that of the truth: fits in a wrong valley.
    """
    d, flat = drawn(name, pixels, 1), drawn(name, pixels, 1, 0.0)

    def fitted(d: dict[str, Any], wave: Floats | float = 1.0) -> batch.Fits:
        return batch.fit(
            name, d["x"], d["y"], d["source"], d["camera"], d["values"] * wave, d["u"], fixed=d["fixed"], threads=1
        )  # fmt: skip

    fitted(d)  # compiles
    found, own = timed(lambda: fitted(d), pixels)
    _, shared = timed(lambda: fitted(flat), pixels)
    middle = seen(d["source"], d["camera"], 0.0, 0.0)
    wave = np.exp(0.05 * np.sin(6.0 * middle.theta_i + 3.0 * middle.theta_r))
    _, rejected = timed(lambda: fitted(d, wave), pixels)
    columns = [found.names.index(one) for one in found.free]
    pulls = (found.values[:, columns] - np.stack([d["true"][one] for one in found.free], axis=1)) / found.u
    of_truth = (((d["values"] - d["exact"]) / d["u"]) ** 2).sum(axis=1)
    off, fit_s, scipy_s = compared(name, d, found, columns)
    jax_us = from_jax = None
    if name == "cook-torrance" and maps_jax.there():
        start = np.stack([d["true"][one] for one in found.free], axis=1)
        other, seconds = maps_jax.fitted(d["source"], d["camera"], d, start)
        jax_us, from_jax = 1e6 * seconds, float(np.max(np.abs(other - found.values[:, columns]) / found.u))
    return {
        "model": name,
        "pixels": pixels,
        "own_us": 1e6 * own,
        "shared_us": 1e6 * shared,
        "rejected_us": 1e6 * rejected,
        "fit_ms": 1e3 * fit_s,
        "scipy_ms": 1e3 * scipy_s,
        "jax_us": jax_us,
        "from_jax": from_jax,
        "from_fit": off,
        "pull_sd": np.nanstd(pulls, axis=0).tolist(),
        "beyond_5": int((np.abs(pulls) > 5.0).any(axis=1).sum()),
        "worse_than_truth": int((found.chi_square > of_truth + 1e-6).sum()),
    }


def compared(name: str, d: dict[str, Any], found: batch.Fits, columns: list[int]) -> tuple[float, float, float]:
    """The largest difference from `gonio fit` in units of u, and the times of both, and of scipy, for a table [s]."""
    worst, times = 0.0, np.zeros((2, COMPARED))
    for p in range(COMPARED):
        at = seen(d["source"], d["camera"], d["x"][p], d["y"][p])
        angles = dict(zip(("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"), np.degrees(at.angles), strict=True))
        u = d["u"][p]
        frame = pd.DataFrame(angles | {"wavelength_nm": 550.0, "brdf": d["values"][p], "u_brdf": u, "u_random": u})
        frame["polarisation"], frame["flag"] = "unpolarised", ""
        frame.attrs.update(source_solid_angle_sr=0.0, receiver_solid_angle_sr=0.0, quantity="brdf")
        one, times[0, p] = timed(partial(fit, frame, name, ior=d["fixed"].get("ior")), 1)
        for k, parameter in enumerate(found.free):
            known = one.parameters[parameter]
            if known.u:
                worst = max(worst, abs(found.values[p, columns[k]] - known.value) / known.u)

        def residual(t: Floats, at: Directions = at, p: int = p) -> Floats:
            model = build(name, dict(zip(found.free, map(float, t), strict=True)) | d["fixed"])
            return np.asarray((model.brdf(*at.angles) - d["values"][p]) / d["u"][p])

        low = [0.5 * x for x in found.values[p, columns]]
        high = [1.5 * x for x in found.values[p, columns]]
        start = [float(d["true"][n][p]) for n in found.free]
        _, times[1, p] = timed(partial(least_squares, residual, np.clip(start, low, high), bounds=(low, high)), 1)
    fit_s, scipy_s = np.median(times, axis=1)
    return worst, float(fit_s), float(scipy_s)


def make(
    out: str | Path, *, quick: bool = False, command: str = "", progress: Callable[[str], None] = lambda text: None
) -> Path:
    """Measure, and write the page: all of it or nothing. Arguments as of `gonio bench models`."""
    rows = []
    with files.staged(out) as stage:
        for name in RANGES:
            progress(f"{name} ...")
            rows.append(measured(name, QUICK if quick or name == "he-torrance" else PIXELS))
        made = stamp(command)
        files.write_page(stage.work, TITLE, lambda _: _page(rows, made), lambda _: {"rows": rows, **made})
    return Path(out) / "index.html"


def _page(rows: list[JsonObject], made: Stamp) -> Page:
    each = ", ".join(f"{number(row['shared_us'], 3)} µs for {row['model']}" for row in rows)
    worst = max(row["from_fit"] for row in rows)
    words = (
        f"A pixel takes {each}, of one thread where directions are shared. Parameters are within {number(worst, 2)} u"
        " of what gonio fit finds."
    )
    times = (
        "Processor time of one thread, in microseconds a pixel: starts, fit, standard errors. Rejected: the model is"
        " not true, so its misfit is found and errors come from leaving out blocks. scipy: least squares on the same"
        " kernel, from the truth on."
    )
    errors = (
        f"From gonio fit: the largest difference of a parameter, of {COMPARED} pixels. A fit in a wrong valley would"
        " have a larger chi-square than the truth."
    )
    jax = "not installed" if all(row["jax_us"] is None for row in rows) else "a batched fit of one model"
    return frame.page(
        TITLE,
        f"{POINTS} directions, noise of {100 * NOISE:g} %.",
        frame.answer([lead(words)], [], [listed(rows, TIMES, (1, 2, 3, 4, 5, 6), times)]),
        folds=[
            *part("Error", f"{sum(row['worse_than_truth'] for row in rows)} worse than the truth", errors,
                  listed(rows, ERRORS, (1, 3, 4))),
            Heading(3, "Beside jax", jax), Paragraph(_of_jax(rows)),
            *frame.provenance(made),
        ],
        foot=FOOTER,
    )  # fmt: skip


def _of_jax(rows: list[JsonObject]) -> str:
    """What a batched fit by jax comes to."""
    for row in rows:
        if row["jax_us"] is not None:
            return (
                f"A batched fit of {row['model']} by jax ({maps_jax.STEPS} damped Gauss-Newton steps from the truth on,"
                f" float64) takes {number(row['jax_us'], 3)} µs of processor time a pixel; its parameters are within"
                f" {number(row['from_jax'], 2)} u of ours."
            )
    return "jax is not installed, so its batched fit is left out: pip install 'gonio[peers]'."
