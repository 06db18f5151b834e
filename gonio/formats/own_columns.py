"""A table made by hand under its maker's own column names and units: which of them is which column.

The pairs stand on the command line (`--columns theta_i=ti:rad,brdf=R:factor`) or in `<name>.columns.toml` beside the
table (`theta_i = "ti:rad"`).
"""

from __future__ import annotations

import csv
import io
import math
import os
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from gonio.disk import read_file
from gonio.errors import ConfigError, DataError
from gonio.formats.native import NEEDED
from gonio.formats.reader import ANGLES, COLUMNS, plain_degrees
from gonio.formats.text import csv_table
from gonio.typing import Floats

_KEYS = {name.removesuffix("_deg").removesuffix("_nm"): name for name in (*COLUMNS, "sample", "side")}
"""What the pairs call the columns, whose units they state on the other side."""
_WORDS = ("polarisation", "side", "sample", "flag")


def _from_radians(values: Floats) -> Floats:
    return plain_degrees(values, 15)


def _from_factor(values: Floats) -> Floats:
    return values / math.pi


def _from_micrometres(values: Floats) -> Floats:
    return np.round(values * 1000.0, 9)  # so that 0.55 becomes 550 and not the float beside it


def _as_they_are(values: Floats) -> Floats:
    return values


_UNITS: dict[str, dict[str, Callable[[Floats], Floats]]] = {
    **{name: {"deg": _as_they_are, "rad": _from_radians} for name in ANGLES},
    "wavelength_nm": {"nm": _as_they_are, "um": _from_micrometres},
    **{name: {"1/sr": _as_they_are, "factor": _from_factor} for name in ("brdf", "u_brdf", "u_random")},
}
"""The units of each column; the first is taken where none is named. A reflectance factor is pi BRDF."""


def pairs(text: str) -> dict[str, str]:
    """The pairs in `theta_i=ti,brdf=R:factor`.

    Raises
    ------
    ConfigError
        A piece is no pair, or a column is named twice.
    """
    found: dict[str, str] = {}
    for piece in text.split(","):
        key, equals, own = (part.strip() for part in piece.partition("="))
        if not equals or not key or not own:
            raise ConfigError(f"--columns: {piece.strip()!r} is no pair; write them as theta_i=ti,brdf=R:factor")
        if key in found:
            raise ConfigError(f"--columns: {key!r} is named twice")
        found[key] = own
    return found


def beside_path(path: Path) -> Path:
    """Where the pairs of the table at `path` lie."""
    return path.parent / f"{path.stem}.columns.toml"


def beside(path: Path) -> dict[str, str] | None:
    """The pairs in `<name>.columns.toml` beside a table; None where there is no such file, or the table is no CSV.

    Raises
    ------
    ConfigError
        The file cannot be read, or holds something else.
    """
    file = beside_path(path)
    if path.suffix.lower() not in (".csv", ".tsv", ".txt") or not os.path.lexists(file):
        return None
    try:
        stored = tomllib.loads(read_file(file).decode())
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{file}: is not valid TOML: {error}") from None
    for key, own in stored.items():
        if not isinstance(own, str) or not own:
            raise ConfigError(f'{file}: {key} = {str(own)[:40]}; the name of a column is needed, as {key} = "name"')
    return stored


def renamed(data: bytes, path: Path, columns: Mapping[str, str], where: str) -> tuple[bytes, list[str]]:
    """The CSV under the measurement table's names and in its units, and notes on what was done to it.

    A column of a measurement table's name that no pair names is taken as it is; every other one is left out.
    `where` names the origin of the pairs in messages.

    Raises
    ------
    ConfigError
        A pair names no column of a measurement table, no unit of it, or one of the file's columns twice.
    DataError
        The file has no such column; a cell is no number (with its line).
    """
    wanted: dict[str, tuple[str, str]] = {}
    for key, spec in columns.items():
        name = _KEYS.get(key, key)
        if name not in _KEYS.values() or name in wanted:
            raise ConfigError(f"{where}: {key!r} is no column, or named twice; there are {', '.join(_KEYS)}")
        units = _UNITS.get(name, {})
        own, colon, unit = spec.rpartition(":")
        if not colon:
            own, unit = spec, next(iter(units), "")
        elif unit not in units:
            known = " or ".join(units) or "none"
            raise ConfigError(f"{where}: {key} = {spec[:40]!r}: {unit[:20]!r} is no unit of it; {known}")
        if own in (other for other, _ in wanted.values()):
            raise ConfigError(f"{where}: the column {own[:40]!r} is named twice")
        wanted[name] = own, unit
    table = csv_table(data, path, [own for own, _ in wanted.values()])
    taken = {own for own, _ in wanted.values()}
    for name in table.header:
        if (name in _KEYS.values() or name.startswith("s_")) and name not in taken and name not in wanted:
            wanted[name] = name, next(iter(_UNITS.get(name, {})), "")
    missing = [name for name in NEEDED if name not in wanted]
    if missing:
        listed = ", ".join(repr(name[:40]) for name in table.header[:16])
        unnamed = f"no column is named for {', '.join(missing)} in {where}"
        raise DataError(f"{path}, line 1: {unnamed}; the file has {listed}")
    notes = []
    cells: list[list[str]] = []
    for name, (own, unit) in wanted.items():
        if name in _WORDS:
            cells.append(table.words(own))
            continue
        values = table.column(own, estimates=name not in ANGLES)
        convert = _UNITS.get(name, {}).get(unit, _as_they_are)
        cells.append([repr(value) for value in convert(values).tolist()])
        if own != name:
            notes.append(f"{name} is the file's column {own!r}" + (f" [{unit}]" if unit else ""))
    left = [name for name in table.header if name not in {own for own, _ in wanted.values()}]
    if left:
        notes.append(f"columns left out: {', '.join(repr(name[:40]) for name in left[:8])}")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(list(wanted))
    writer.writerows(zip(*cells, strict=True))
    return out.getvalue().encode(), notes
