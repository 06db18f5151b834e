"""What `gonio fit` does with a map: a fit of every pixel."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio import maps
from gonio.cli import console
from gonio.errors import ConfigError
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.maps import fits

if TYPE_CHECKING:
    from gonio_analysis.commands.carried_out import Wanted

PLAIN = ("model", "ior", "fix", "wavelength_nm")
"""What of a request maps are fitted by."""


def is_map(table: str, out: Path | None) -> bool:
    """Whether what is to be fitted is a map.

    Raises
    ------
    ConfigError
        `out` is given for what is none.
    """
    found = maps.is_map(table)
    if out is not None and not found:
        why = "is no map" if Path(table).exists() else "there is no such file"
        raise ConfigError(f"{table}: {why}; --out goes with a map, as gonio reduce RUN --map makes it")
    return found


def require_plain(what: str, asked: FitRequest, wanted: Wanted, others: Mapping[str, Any]) -> None:
    """`ConfigError` where an option is given that says nothing to a map."""
    usual = FitRequest(asked.model)
    given = {f"--{f.name.replace('_', '-')}": (getattr(asked, f.name) or None) != (getattr(usual, f.name) or None)
             for f in fields(asked) if f.name not in PLAIN}  # fmt: skip
    names = {"--bounds": "--bound", "--priors": "--prior", "--each": "--joint"}
    given |= {"--u-ior": wanted.u_ior, "--intervals": wanted.intervals, "--save": wanted.save,
              "--residual": wanted.residual, **others}  # fmt: skip
    odd = [names.get(name, name) for name, value in given.items() if value]
    if odd:
        raise ConfigError(f"{odd[0]}: has no part in the fit of {what}; leave it out")


def fit_map(path: Path, out: Path | None, asked: FitRequest, *, as_json: bool) -> None:
    """Fit every pixel of a map, and print what came out."""
    if out is None:
        raise ConfigError(f"{path}: is a map; name the file of its fits with --out FITS.h5")
    with console.counter("fitting tiles", lines=True) as count:
        fits.make(path, out, asked, count=count, say=console.note)
    found = fits.summary(out)
    if as_json:
        print(json.dumps({"model": asked.model, "map": str(path), "out": str(out), **found.to_json()}, indent=1))
        return
    _print(found, f"{asked.model} on {path.name}")
    print(out)


def _print(found: fits.Summary, title: str) -> None:
    rows = console.table("parameter", "median", "spread", "typical u", "", title=f"{title}: {found.pixels} pixels")
    for name, one in found.parameters.items():
        unit = "" if one.unit == "1" else f" {one.unit}"
        masked = f"not determined in {one.undetermined} pixels, masked there" if one.undetermined else ""
        numbers = [f"{v:.4g}{unit}" if math.isfinite(v) else "-" for v in (one.median, one.spread)]
        rows.add_row(name, *numbers, f"{one.u:.2g}{unit}" if math.isfinite(one.u) else "-", masked)
    share = 100.0 * found.rejected / max(found.fitted, 1)
    tau = f", their misfit tau {found.tau:.2g} (median)" if found.rejected else ""
    console.show(
        rows,
        f"fitted {found.fitted} of {found.pixels} pixels; the model is rejected in {share:.3g} % of them{tau};"
        f" a parameter is at its bound in {found.at_bound}",
        "spread: half the distance between the 16th and the 84th percentile over the map",
    )
