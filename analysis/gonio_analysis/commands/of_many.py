"""What `gonio fit` does with very many: every pixel of a map, every table of a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio import maps
from gonio.cli import console
from gonio.errors import ConfigError
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.maps import each as each_table
from gonio_analysis.maps import fits
from gonio_analysis.report.text import with_u

if TYPE_CHECKING:
    from gonio.measurement import Reading
    from gonio_analysis.commands.carried_out import Wanted

PLAIN = ("model", "ior", "fix", "wavelength_nm", "separate")
"""What of a request maps are fitted by."""


def fit(
    table: str | None, each: list[str] | None, asked: FitRequest, how: Reading, wanted: Wanted, *, out: Path | None,
    dask: str | None, materials: str | None, others: Mapping[str, Any],
) -> bool:  # fmt: skip
    """Fit a map or each of many tables, where that is asked for; otherwise False.

    Raises
    ------
    ConfigError
        What is asked for does not go together; `others`: options that have no part in either.
    """
    if table is None:
        if not each:
            raise ConfigError("gonio fit: name a TABLE; or a folder or a list of tables with --each")
        _require_plain(
            "each of many tables",
            asked,
            wanted,
            {**others, "--json": wanted.as_json, "--materials": materials},
            plain=None,
        )
        fit_each(each, out, asked, how, dask)
        return True
    if not is_map(table, out):
        if materials is not None:
            raise ConfigError("--materials: goes with a map; leave it out")
        if dask is not None:
            raise ConfigError("--dask: goes with a map, or with --each FOLDER|LIST; leave it out")
        return False
    _require_plain("a map", asked, wanted, {**others, "--columns": how.columns, "--blank": how.blank})
    fit_map(Path(table), out, asked, dask, materials, as_json=wanted.as_json)
    return True


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


def _require_plain(
    what: str, asked: FitRequest, wanted: Wanted, others: Mapping[str, Any], plain: Sequence[str] | None = PLAIN
) -> None:
    """`ConfigError` where an option is given that has no part; `plain` of a request have one, or all for None."""
    usual = FitRequest(asked.model)
    given = {f"--{f.name.replace('_', '-')}": (getattr(asked, f.name) or None) != (getattr(usual, f.name) or None)
             for f in fields(asked) if plain is not None and f.name not in plain}  # fmt: skip
    names = {"--bounds": "--bound", "--priors": "--prior", "--each": "--joint"}
    given |= {"--u-ior": wanted.u_ior, "--intervals": wanted.intervals, "--save": wanted.save,
              "--residual": wanted.residual, **others}  # fmt: skip
    odd = [names.get(name, name) for name, value in given.items() if value]
    if odd:
        raise ConfigError(f"{odd[0]}: has no part in the fit of {what}; leave it out")


def fit_each(where: list[str], out: Path | None, asked: FitRequest, how: Reading, dask: str | None) -> None:
    """Fit each table of a folder or a list, and print what came out."""
    if len(where) > 1:
        raise ConfigError("--each: name one folder or one list, or the TABLE whose wavelengths --each NAME is about")
    if out is None:
        raise ConfigError(f"--each {where[0]}: name the table of its fits with --out TABLE.csv")
    if out.suffix != ".csv":
        raise ConfigError(f"--out {out}: one row a table is written as CSV; choose a name that ends in .csv")
    with console.counter("fitting tables", lines=True) as count:
        found = each_table.make(where[0], out, asked, how, dask=dask, count=count)
    if found.before:
        console.note(f"{found.before} tables were done before")
    flags = [row.get("flag") or "" for row in found.rows]
    failed = [row["table"] for row, flag in zip(found.rows, flags, strict=True) if flag.startswith("not fitted")]
    rejected = sum("rejected" in flag.split("; ") for flag in flags)
    first = f", the first of them {failed[0]} (column flag says why)" if failed else ""
    console.show(
        f"{asked.model}: fitted {len(flags) - len(failed)} of {len(flags)}; the model is rejected in {rejected};"
        f" {len(failed)} could not be fitted{first}"
    )
    print(out)


def fit_map(
    path: Path, out: Path | None, asked: FitRequest, dask: str | None, materials: str | None, *, as_json: bool
) -> None:
    """Fit every pixel of a map, and print what came out."""
    if out is None:
        raise ConfigError(f"{path}: is a map; name the file of its fits with --out FITS.h5")
    with console.counter("fitting tiles", lines=True) as count:
        fits.make(path, out, asked, materials=materials, dask=dask, count=count, say=console.note)
    found = fits.summary(out)
    if as_json:
        print(json.dumps({"model": asked.model, "map": str(path), "out": str(out), **found.to_json()}, indent=1))
        return
    _print(found, f"{asked.model} on {path.name}")
    if found.materials:
        _print_materials(found)
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


def _print_materials(found: fits.Summary) -> None:
    rows = console.table("material", "pixels", "chi-square", *found.parameters, title="materials")
    for k, one in enumerate(found.materials):
        values = [with_u(one[f"material_{name}"], one[f"u_material_{name}"]) for name in found.parameters]
        rows.add_row(str(k), f"{one['material_pixels']:.0f}", f"{one['material_chi_square']:.4g}", *values)
    console.show(rows, "chi-square: a degree of freedom, of the values of a material's pixels fitted together")
