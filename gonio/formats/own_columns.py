"""A table made by hand under its maker's own column names and units: which of them is which column.

The pairs stand on the command line (`--columns theta_i=ti:rad,brdf=R:factor`) or in `<name>.columns.toml` beside the
table (`theta_i = "ti:rad"`). The table is a CSV or an Excel workbook.
"""

import math
import os
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import tomli_w

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError
from gonio.formats import workbook
from gonio.formats.native import NEEDED
from gonio.formats.reader import ANGLES, COLUMNS, plain_degrees
from gonio.formats.text import csv_of, csv_table
from gonio.typing import Floats

_KEYS = {name.removesuffix("_deg").removesuffix("_nm"): name for name in (*COLUMNS, "sample", "side")}
"""Names of columns in the pairs, without their units, and the table's names."""
_WORDS = ("polarisation", "side", "sample", "flag")


_ANGLE: dict[str, Callable[[Floats], Floats]] = {"deg": np.positive, "rad": lambda values: plain_degrees(values, 15)}
_VALUE: dict[str, Callable[[Floats], Floats]] = {
    "1/sr": np.positive,
    "factor": lambda values: values / math.pi,
    "percent": lambda values: values / (100.0 * math.pi),
}
_UNITS: dict[str, dict[str, Callable[[Floats], Floats]]] = {
    **dict.fromkeys(ANGLES, _ANGLE),
    # rounded so that 0.55 um becomes 550 and not the float beside it
    "wavelength_nm": {"nm": np.positive, "um": lambda values: np.round(values * 1000.0, 9)},
    **dict.fromkeys(("brdf", "u_brdf", "u_random"), _VALUE),
}
"""The units of each column; the first is taken where none is named. A reflectance factor is pi BRDF, and "percent" a
hundredth of one: of uncertainties, too, which are therefore never a share of the value."""
_TEXTS, _WORKBOOKS = (".csv", ".tsv", ".txt"), (".xlsx", ".xls")


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
    """The pairs in `<name>.columns.toml` beside a table; None where there is no such file, or it is not this table's.

    It is that of a CSV of this name; where there is none, that of a workbook.

    Raises
    ------
    ConfigError
        The file cannot be read, or holds something else.
    """
    file = beside_path(path)
    if not os.path.lexists(file) or not _owns(path):
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


def _owns(path: Path) -> bool:
    """Whether `<name>.columns.toml` is about the table at `path`, and not about another of the same name."""
    ending = path.suffix.lower()
    texts = any(path.with_suffix(other).exists() for other in _TEXTS)
    return ending in _TEXTS or (ending in _WORKBOOKS and not texts)


def remember(path: Path, columns: Mapping[str, str]) -> str | None:
    """Write the pairs to `<name>.columns.toml` beside the table they were right for; what was done, in a sentence.

    A file that is there stays as it is. None: it says the same already.
    """
    file = beside_path(path)
    if not _owns(path):
        return None
    if os.path.lexists(file):
        try:
            same = beside(path) == dict(columns)
        except ConfigError:
            same = False
        return None if same else f"{file} says otherwise than --columns, which went before it; it is left as it is"
    head = f"# Which columns of {path.name} are which; --columns named them.\n"
    try:
        write_whole(file, (head + tomli_w.dumps(dict(columns))).encode())
    except OSError as error:
        return f"{file}: the columns cannot be remembered there: {error.strerror}"
    return f"{file} now names these columns: every command reads {path.name} without --columns"


def renamed(data: bytes, path: Path, columns: Mapping[str, str], where: str) -> tuple[bytes, list[str]]:
    """The table as a CSV, under the measurement table's names and in its units, and notes on what was done to it.

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
    notes: list[str] = []
    if workbook.is_workbook(data):
        data, notes = workbook.as_csv(data, path, [own for own, _ in wanted.values()])
    table = csv_table(data, path, [own for own, _ in wanted.values()])
    taken = {own for own, _ in wanted.values()}
    for name in table.header:
        if (name in _KEYS.values() or name.startswith("s_")) and name not in taken and name not in wanted:
            wanted[name] = name, next(iter(_UNITS.get(name, {})), "")
    if missing := [name for name in NEEDED if name not in wanted]:
        listed = ", ".join(repr(name[:40]) for name in table.header[:16])
        raise DataError(
            f"{path}, line 1: no column is named for {', '.join(missing)} in {where}; the file has {listed}"
        )
    cells: list[list[str]] = []
    for name, (own, unit) in wanted.items():
        if name in _WORDS:
            cells.append(table.words(own))
            continue
        values = table.column(own, estimates=name not in ANGLES)
        cells.append([repr(value) for value in _UNITS.get(name, {}).get(unit, np.positive)(values).tolist()])
        if own != name:
            notes.append(f"{name} is the file's column {own!r}" + (f" [{unit}]" if unit else ""))
    if left := [name for name in table.header if name not in {own for own, _ in wanted.values()}]:
        notes.append(f"columns left out: {', '.join(repr(name[:40]) for name in left[:8])}")
    return csv_of(list(wanted), zip(*cells, strict=True)), notes
