"""The budget that a reduction wrote beside its table (RUN/budget.csv), as a report needs it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio_analysis.result_records import BudgetCurve, BudgetFacts, BudgetPart, finite

if TYPE_CHECKING:
    import pandas as pd

LARGEST = 5
"""Causes whose shares are drawn."""
MOST_POINTS = 120
"""Of one curve."""
OUT_OF_PLANE_DEG = 1.0
INFORMATION = ("nu_eff", "coarse", "cone_difference", "flag")
"""Columns behind the parts that are no parts."""


def run_budget(folder: Path) -> list[BudgetFacts]:
    """The budget of a run, one a wavelength; none where the run has no budget of its table as it stands."""
    import pandas as pd

    try:
        parts = pd.read_csv(folder / "budget.csv", keep_default_na=True)
        stated = pd.read_csv(folder / "brdf.csv", usecols=["u_brdf"])["u_brdf"]
        meta = json.loads((folder / "brdf.meta.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    if "u_brdf" not in parts or not np.array_equal(parts["u_brdf"], stated, equal_nan=True):
        return []  # of another table
    provenance = meta.get("provenance") or {}
    left_out = {row["cause"]: row["why"] for row in provenance.get("not_in_budget") or []}
    verdict = (provenance.get("monte_carlo") or {}).get("verdict")
    columns = [str(name) for name in parts.columns]
    names = [name for name in columns[columns.index("u_brdf") + 1 :] if name not in INFORMATION]
    out = []
    for wavelength in parts["wavelength_nm"].unique().tolist():
        here = parts["wavelength_nm"].isna() if math.isnan(wavelength) else parts["wavelength_nm"] == wavelength
        used = parts[here & (parts["brdf"].abs() > 3.0 * parts["u_brdf"])]
        if len(used):
            out.append(_facts(finite(wavelength), used, names, left_out, verdict))
    return out


def _facts(
    wavelength_nm: float | None, rows: pd.DataFrame, names: list[str], left_out: dict[str, str], verdict: str | None
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


def _curves(rows: pd.DataFrame, shares: Any) -> list[BudgetCurve]:
    """Curves in the plane of incidence, of at least two values."""
    turn = (rows["phi_r_deg"] - rows["phi_i_deg"]).to_numpy() % 360.0
    theta_i, theta_r = rows["theta_i_deg"].to_numpy(), rows["theta_r_deg"].to_numpy()
    mirror = abs(turn - 180.0) < OUT_OF_PLANE_DEG
    level = (theta_r < OUT_OF_PLANE_DEG) | (theta_i < OUT_OF_PLANE_DEG)
    in_plane = mirror | (np.minimum(turn, 360.0 - turn) < OUT_OF_PLANE_DEG) | level
    signed = np.where(turn > 90.0, theta_r, -theta_r) * np.where(turn > 270.0, -1.0, 1.0)
    out = []
    # encoders read the same nominal angle within a step
    for nominal in np.unique(np.round(theta_i)):
        k = np.flatnonzero(in_plane & (np.round(theta_i) == nominal))
        k = k[np.argsort(signed[k])]
        if k.size >= 2:
            k = k[np.unique(np.linspace(0, k.size - 1, min(k.size, MOST_POINTS)).round().astype(int))]
            rounded = [[float(f"{x:.4g}") for x in column] for column in shares[k].T]
            out.append(BudgetCurve(float(nominal), [round(float(x), 4) for x in signed[k]], rounded))
    return out
