"""A table made by hand under its maker's own column names and units: which of them is which column.

The pairs stand on the command line (`--columns theta_i=ti:rad,brdf=R:factor`) or in `<name>.columns.toml` beside the
table (`theta_i = "ti:rad"`). The table is a CSV or an Excel workbook. Beside an instrument's workbook the file names
its blank (`blank = "dark.xls"`).
"""

import math
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tomli_w

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError
from gonio.formats import workbook
from gonio.formats.column_hints import NEEDED, columns_line, unit_in
from gonio.formats.reader import ANGLES, COLUMNS, U_ANGLES, plain_degrees, whole_turns, wrap_deg
from gonio.formats.sheets import WORDS
from gonio.formats.text import CsvTable, csv_of, csv_table
from gonio.typing import Floats

_VALUES = ("brdf", "u_brdf", "u_random", U_ANGLES)
_KEYS = {name.removesuffix("_deg").removesuffix("_nm"): name for name in (*COLUMNS, U_ANGLES, "sample", "side")}
"""Names of columns in the pairs, without their units, and the table's names. A cause is named as the table does."""

_ANGLE: dict[str, Callable[[Floats], Floats]] = {"deg": np.positive, "rad": lambda values: plain_degrees(values, 15)}
_VALUE: dict[str, Callable[[Floats], Floats]] = {
    "1/sr": np.positive,
    "factor": lambda values: values / math.pi,
    "percent": lambda values: values / (100.0 * math.pi),
}
_SHARES = {"relative": 1.0, "relative-percent": 0.01}
"""Further units of uncertainties: a share of the row's own value, or that in percent."""
_UNITS: dict[str, dict[str, Callable[[Floats], Floats]]] = {
    **dict.fromkeys(ANGLES, _ANGLE),
    # rounded so that 0.55 um becomes 550 and not the float beside it
    "wavelength_nm": {"nm": np.positive, "um": lambda values: np.round(values * 1000.0, 9)},
    **dict.fromkeys(_VALUES, _VALUE),
}
"""The units of each column; the first is taken where none is named, but of uncertainties that of `brdf`. A reflectance
factor is pi BRDF, and "percent" a hundredth of one."""
_SAID = {"%": ("percent", "relative-percent"), "1/sr": ("1/sr",), "deg": ("deg",), "rad": ("rad",), "nm": ("nm",),
         "um": ("um",)}  # fmt: skip
"""The units that a column may have whose own name says this one."""
_TEXTS, _WORKBOOKS = (".csv", ".tsv", ".txt"), (".xlsx", ".xlsm", ".xls")


@dataclass(frozen=True)
class Column:
    """Which of a file's columns is one of the table, and its unit."""

    own: str
    unit: str
    """"" of words."""
    follows: bool = field(compare=False)
    """Whether the unit is that of `brdf`, because none is named."""


def pairs(text: str) -> dict[str, str]:
    """The pairs in `theta_i=ti,brdf=R:factor`; a comma ends a pair only before the next.

    Raises
    ------
    ConfigError
        A piece is no pair, or a column is named twice.
    """
    found: dict[str, str] = {}
    for piece in re.split(r",(?=[^,=]*=)", text):
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


def blank_beside(path: Path) -> Path | None:
    """The blank of an instrument's workbook that `blank = "FILE"`, the only key there, names beside it; else None."""
    stored = beside(path)
    return path.parent / stored["blank"] if stored is not None and set(stored) == {"blank"} else None


def _owns(path: Path) -> bool:
    """Whether `<name>.columns.toml` is about the table at `path`, and not about another of the same name."""
    ending = path.suffix.lower()
    texts = any(path.with_suffix(other).exists() for other in _TEXTS)
    return ending in _TEXTS or (ending in _WORKBOOKS and not texts)


def remember(path: Path, columns: Mapping[str, str]) -> str | None:
    """Write the pairs to `<name>.columns.toml` beside the table they were right for; what was done, in a sentence.

    A file that is there stays as it is. None: it says the same already.
    """
    file, named = beside_path(path), wanted(columns, "--columns")
    if not _owns(path):
        return None
    if os.path.lexists(file):
        try:
            same = wanted(beside(path) or {}, str(file)) == named
        except ConfigError:
            same = False
        return None if same else f"{file} says otherwise than --columns, which went before it; it is left as it is"
    head = f"# Which columns of {path.name} are which; --columns named them.\n"
    try:
        every = zip(columns, named.values(), strict=True)
        written = {key: f"{one.own}:{one.unit}" if one.unit else one.own for key, one in every}
        write_whole(file, (head + tomli_w.dumps(written)).encode())
    except OSError as error:
        return f"{file}: the columns cannot be remembered there: {error.strerror}"
    return f"{file} now names these columns: every command reads {path.name} without --columns"


def wanted(columns: Mapping[str, str], where: str) -> dict[str, Column]:
    """The columns that pairs name, by the table's names; `where` names their origin in messages.

    Raises
    ------
    ConfigError
        A pair names no column of a measurement table, no unit of it, or one of the file's columns twice; the name of a
        column says another unit than the one that is taken for it.
    """
    found: dict[str, Column] = {}
    for key, spec in columns.items():
        name = _KEYS.get(key, key)
        if (name not in _KEYS.values() and not _is_cause(name)) or name in found:
            known = f"{', '.join(_KEYS)}, s_<cause>"
            raise ConfigError(f"{where}: {key!r} is no column, or named twice; there are {known}")
        units = _units(name)
        own, colon, unit = spec.rpartition(":")
        if not colon:
            own, unit = spec, ""
        elif unit not in units:
            known = " or ".join(units) or "none"
            raise ConfigError(f"{where}: {key} = {spec[:40]!r}: {unit[:20]!r} is no unit of it; {known}")
        if own in (other.own for other in found.values()):
            raise ConfigError(f"{where}: the column {own[:40]!r} is named twice")
        found[name] = Column(own, unit, follows=False)
    for name, column in found.items():
        if not column.unit:
            found[name] = _with_unit(name, column.own, found)
            _require_as_named(name, found[name], where)
    return found


def _is_cause(name: str) -> bool:
    return name.startswith("s_") and len(name) > 2


def _is_uncertainty(name: str) -> bool:
    return name in _VALUES[1:] or _is_cause(name)


def _units(name: str) -> tuple[str, ...]:
    """The units that a column may have; the first is taken where nothing says another."""
    return (*(_VALUE if _is_cause(name) else _UNITS.get(name, {})), *(_SHARES if _is_uncertainty(name) else ()))


def _with_unit(name: str, own: str, found: Mapping[str, Column]) -> Column:
    """A column that no unit is named for: an uncertainty has that of `brdf`."""
    follows = _is_uncertainty(name)
    unit = next(iter(_units(name)), "")
    return Column(own, found["brdf"].unit or unit if follows and "brdf" in found else unit, follows)


def _require_as_named(name: str, column: Column, where: str) -> None:
    """`ConfigError` where a column's own name says another unit than the one that is taken."""
    said = unit_in(column.own)
    fitting = [unit for unit in _units(name) if unit in _SAID.get(said, ())]
    if fitting and column.unit not in fitting:
        key = next((key for key, full in _KEYS.items() if full == name), name)
        shown = ", or ".join(f"{key}={column.own}:{unit}" for unit in (*fitting, column.unit))
        raise ConfigError(
            f"{where}: the name {column.own[:40]!r} says {said}, and {column.unit} is what is taken where no unit is "
            f"named; write {shown}"
        )


def renamed(data: bytes, path: Path, columns: Mapping[str, str], where: str) -> tuple[bytes, list[str], Floats]:
    """The table as a CSV, under the measurement table's names and in its units, and notes on what was done to it.

    Third are the four angles as the file states them, shape (n, 4) [degrees]: azimuths from -360 to 360 become those
    of the table, so that a direction may be there in two ways (`gonio.formats.reader.one_value_a_direction`).

    A column of a measurement table's name that no pair names is taken as it is, and an uncertainty in the unit of
    `brdf`; every other one is left out. `where` names the origin of the pairs in messages.

    Raises
    ------
    ConfigError
        As `wanted` does.
    DataError
        The file has no such column; a cell is no number (with its line).
    """
    found = wanted(columns, where)
    owned = [column.own for column in found.values()]

    def taken(header: Iterable[str]) -> dict[str, Column]:
        """The columns of a file with this header, by the table's names."""
        others = [name for name in header if name not in owned and name not in found]
        plain = (name for name in others if name in _KEYS.values() or _is_cause(name))
        return found | {name: _with_unit(name, name, found) for name in plain}

    notes: list[str] = []
    if workbook.is_workbook(data):
        data, notes = workbook.as_csv(
            data, path, owned, lambda header: {column.own: column.unit for column in taken(header).values()}
        )
    table = csv_table(data, path, owned)
    every = taken(table.header)
    if missing := [name for name in NEEDED if name not in every]:
        listed = ", ".join(repr(name[:40]) for name in table.header[:16])
        raise DataError(
            f"{path}, line 1: no column is named for {', '.join(missing)} in {where}; the file has {listed}; "
            f"{columns_line(table.header, {name: column.own for name, column in found.items()})}"
        )
    values = {name: _in_units(table, name, column) for name, column in every.items() if name not in WORDS}
    stated = np.column_stack([values[name] for name in ANGLES])
    for name in ("phi_i_deg", "phi_r_deg"):
        values[name] = _azimuths(values[name], every[name].unit)
    for name, column in every.items():
        if share := _SHARES.get(column.unit):
            signed = values["brdf"] if _is_cause(name) else np.abs(values["brdf"])
            values[name] = share * values[name] * signed
    cells = [
        table.words(column.own) if name in WORDS else map(repr, values[name].tolist()) for name, column in every.items()
    ]
    notes += [*table.notes(), *_told(every)]
    if left := [name for name in table.header if name not in {column.own for column in every.values()}]:
        notes.append(f"columns left out: {', '.join(repr(name[:40]) for name in left[:8])}")
    return csv_of(list(every), zip(*cells, strict=True)), notes, stated


def _azimuths(phi: Floats, unit: str) -> Floats:
    """Azimuths in [0, 360) degrees; those beyond a turn as they are, which the table then refuses."""
    phi = whole_turns(phi) if unit == "rad" else phi
    return np.where(np.abs(phi) <= 360.0, wrap_deg(phi), phi)


def _in_units(table: CsvTable, name: str, column: Column) -> Floats:
    """The numbers of a column in the table's units; shares of a value as numbers."""
    values = table.column(column.own, estimates=name not in ANGLES)
    return (_VALUE if _is_cause(name) else _UNITS.get(name, {})).get(column.unit, np.positive)(values)


def _told(every: Mapping[str, Column]) -> list[str]:
    """What was taken for the columns, where it is not as their names say."""
    pairs = {name: repr(one.own) + (f" [{one.unit}]" if one.unit else "") for name, one in every.items()}
    named = [f"{shown} is {name}" for name, shown in pairs.items() if every[name].own != name]
    return [
        *([f"the file's columns by the table's names: {', '.join(named)}"] if named else []),
        *(
            f"the unit of brdf is that of {pairs[name]} too, for none is named; if it is in 1/sr, write "
            f"{name} = {f'{one.own}:1/sr'!r}"
            for name, one in every.items()
            if one.follows and one.unit != "1/sr"
        ),
    ]
