"""The tables of a report as CSV files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gonio.formats.base import cell_of
from gonio_analysis.compare import Dataset
from gonio_analysis.report import viewer
from gonio_analysis.uncertainty import Floats


def write(
    datasets: Sequence[Dataset], summary: dict[str, Any], views: Sequence[dict[str, Any] | None], folder: Path
) -> list[str]:
    """Write parameters, metrics, curves, theory, profiles, and parameters over wavelength; the names of the files."""
    facts = summary["datasets"]
    write_csv(
        folder / "parameters.csv",
        ("sample", "model", "parameter", "value", "standard_error", "fixed", "at_bound"),
        (
            (s["name"], m, n, p["value"], p["u"], p["fixed"], p.get("at_bound", ""))
            for s in facts
            for m, f in s["models"].items()
            for n, p in f["parameters"].items()
        ),
    )
    names = list(summary["metrics"])
    write_csv(
        folder / "metrics.csv",
        ("sample", "model", "points", "free_parameters", "reduced_chi_square", "p_value", *names, "n_log"),
        (
            (
                s["name"],
                m,
                f["n_points"],
                f["n_free"],
                f["reduced_chi_square"],
                f["p_value"],
                *(f["metrics"][n] for n in names),
                f["metrics"]["n_log"],
            )
            for s in facts
            for m, f in s["models"].items()
        ),
    )
    files = ["parameters.csv", "metrics.csv"]
    for d, s, view in zip(datasets, facts, views, strict=True):
        files += _of_dataset(d, s["slug"], folder)
        if view is not None:
            files.append(f"{s['slug']}-interactive.csv")
            write_csv(folder / files[-1], viewer.COLUMNS, viewer.rows(view))
        if any(f["series"] for f in s["models"].values()):
            files.append(f"{s['slug']}-wavelengths.csv")
            write_csv(
                folder / files[-1],
                ("model", "wavelength_nm", "points", "reduced_chi_square", "parameter", "value", "standard_error"),
                (
                    (m, r["wavelength_nm"], r["n_points"], r["reduced_chi_square"], n, p["value"], p["u"])
                    for m, f in s["models"].items()
                    for r in f["series"]
                    for n, p in r["parameters"].items()
                ),
            )
        intervals = (s["choice"] or {}).get("intervals") or {}
        if intervals:
            files.append(f"{s['slug']}-profiles.csv")
            write_csv(
                folder / files[-1],
                ("model", "parameter", "value", "rise_of_chi_square"),
                (
                    (s["choice"]["named"], n, value, rise)
                    for n, i in intervals.items()
                    for value, rise in zip(i["profile"]["values"], i["profile"]["rise"], strict=True)
                ),
            )
    return files


def _of_dataset(d: Dataset, slug: str, folder: Path) -> list[str]:
    """Fitted values with every model's prediction, and the plotted curves."""
    data = d.data
    angles = [_degrees(x) for x in (data.theta_i, data.phi_i, data.theta_r, data.phi_r)]
    models, c = list(d.fitted), data.covariance
    values = [v for f in d.fitted.values() for v in (f.fit.predicted, f.fit.whitened)]
    write_csv(
        folder / f"{slug}-values.csv",
        (
            *("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "brdf", "u_brdf"),
            *(f"{m} {what}" for m in models for what in ("brdf", "whitened_residual")),
            *(("u_random", *(f"s_{cause}" for cause in c.causes)) if c is not None else ()),
        ),
        zip(*angles, data.brdf, data.u, *values, *((c.random, *c.common.T) if c is not None else ()), strict=True),
    )
    write_csv(
        folder / f"{slug}-curves.csv",
        ("model", "curve", "kind", "signed_angle_deg", "brdf", "u_brdf", "normalised", "u_normalised", "normalised_by"),
        (
            row
            for m, f in d.fitted.items()
            for c in f.drawn
            for row in [
                *((m, c.label, "measured", *rest, c.norm.kind) for rest in _measured(c)),
                *((m, c.label, "theory", *rest, c.norm.kind) for rest in _theory(c)),
            ]
        ),
    )
    return [f"{slug}-values.csv", f"{slug}-curves.csv"]


def _measured(c: Any) -> Iterable[tuple[Any, ...]]:
    n = c.norm.measured
    k = c.curve
    return zip(_degrees(k.angle), k.brdf, k.u, k.brdf / n, k.u / n, strict=True)


def _theory(c: Any) -> Iterable[tuple[Any, ...]]:
    return ((a, t, "", t / c.norm.theory, "") for a, t in zip(_degrees(c.theory_angle), c.theory, strict=True))


def _degrees(angle: Floats) -> Floats:
    """Radians in degrees, without the rounding of the way there and back."""
    return np.asarray(np.round(np.degrees(angle), 10))


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV in which None and NaN are empty cells, floats keep every digit, and no text is a spreadsheet's formula."""
    with open(path, "w", encoding="utf-8", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow(header)
        out.writerows([_cell(cell) for cell in row] for row in rows)


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    if isinstance(value, str):
        return cell_of(value)
    return value
