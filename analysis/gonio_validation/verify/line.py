"""The line itself: files written and read back, and a blind measurement on the simulated rig."""

from pathlib import Path

import numpy as np

from gonio import formats as of_files
from gonio import measurement
from gonio.errors import GonioError
from gonio.formats.reader import table
from gonio.geometry import Directions
from gonio.shown import with_u
from gonio_validation.verify.finding import Finding, most

FORMATS = ("gonio", "astm", "bird", "alta", "xlsx", "nexus", "parquet")
"""Formats that hold a table in its own directions; others have a grid of theirs."""
EXACT = ("gonio", "parquet", "nexus")
SEED = 1991
SAMPLE = """\
name = "blind"
model = "oren-nayar"
[parameters]
albedo = {albedo:.6f}
sigma_deg = {sigma_deg:.6f}
"""
PLAN = """\
name = "verification"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [0, 30, 60]
theta_r_deg = { start = -75, stop = 75, step = 7.5 }
"""
FARTHEST = 4.0
"""Standard uncertainties: a normal number is beyond them once in 16 000."""


def formats(folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    rng = np.random.default_rng(SEED)
    signed = np.concatenate([np.arange(-70.0, 71.0, 10.0)] * 3)
    theta_i = np.repeat([10.0, 30.0, 60.0], signed.size // 3)
    brdf = 0.3 / np.pi * rng.uniform(0.9, 1.1, signed.size)
    frame = table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=np.abs(signed), phi_r_deg=np.where(signed >= 0, 180.0, 0.0),
        wavelength_nm=550.0, brdf=brdf, u_brdf=0.01 * brdf, u_random=0.01 * brdf,
        attrs={"source_solid_angle_sr": 1e-4, "receiver_solid_angle_sr": 1e-4, "sample": "verification"},
    )  # fmt: skip
    out = []
    for one in map(of_files.named, FORMATS):
        path = folder / f"table{one.endings[0]}"
        try:
            measurement.write(frame, path, format=one.name)
        except GonioError as error:
            out.append(Finding(one.title, True, f"not looked at: {error}"[:120], "recorded"))
            continue
        found = _lined_up(measurement.read(path), frame)
        limit = 0.0 if one.name in EXACT else 2e-5
        off = np.inf if found is None else float(np.max(np.abs(found / brdf - 1.0)))
        out.append(most(one.title, off, limit, "the values that were written"))
    return out


def _lined_up(back: object, frame: object) -> np.ndarray | None:
    """The values read, in the order of those that were written; None where directions differ."""
    a, b = (Directions.from_table(x) for x in (frame, back))  # type: ignore[arg-type]
    values = back["brdf"].to_numpy(np.float64)  # type: ignore[index]
    if len(a) != len(b):
        return None
    apart = sum(np.sum((x[:, None, :] - y[None, :, :]) ** 2, axis=2) for x, y in zip(a.vectors, b.vectors, strict=True))
    nearest = np.argmin(apart, axis=1)
    return values[nearest] if apart[np.arange(len(a)), nearest].max() < 1e-12 else None


def measured(folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    from gonio_analysis.fitting.fit import fit

    from gonio.lab.acquisition.measure import carry_out, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.reduction import brdf
    from gonio.samples.files import load_sample

    rng = np.random.default_rng(SEED)
    true = {"albedo": rng.uniform(0.3, 0.9), "sigma_deg": rng.uniform(15.0, 30.0)}
    sample, plan = folder / "sample.toml", folder / "plan.toml"
    sample.write_text(SAMPLE.format(**true), encoding="utf-8", newline="\n")
    plan.write_text(PLAN, encoding="utf-8", newline="\n")
    made = carry_out(load_plan(plan), find_rig("sim"), folder / "run", sample=load_sample(sample), seed=SEED, yes=True)
    reduced = brdf.reduce_in_parts(made)
    made.write_table(reduced.table, {"budget.csv": reduced.budget})
    frame = measurement.read(folder / "run" / "brdf.csv")
    good = frame["flag"].fillna("") == ""
    result = fit(frame, "oren-nayar", name="blind")
    out = [Finding("points measured", bool(good.mean() > 0.9), f"{int(good.sum())} of {len(frame)}", "nine of ten")]
    for name, value in true.items():
        e = result.parameters[name]
        called = f"{name}: {with_u(e.value, e.u)}, truth {value:.4g}"
        off = abs(e.value - value) / (e.u or 1e-300)
        out.append(most(called, off, FARTHEST, "standard uncertainties from the truth"))
    p = result.p_value
    out.append(
        Finding("the model is not rejected", p is not None and p > 1e-4, f"p = {p:.2g}" if p else "–", "p > 1e-4")
    )
    return out
