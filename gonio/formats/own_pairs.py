"""Which column of a table made by hand is which: the pairs that say so, and the file beside the table that keeps them.

The pairs stand on the command line (`--columns theta_i=ti:rad,brdf=R:factor`) or in `<name>.columns.toml` beside the
table (`theta_i = "ti:rad"`). Beside an instrument's workbook the file names its blank (`blank = "dark.xls"`). What may
stand for a column is in docs/formats.md.
"""

import itertools
import math
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tomli_w

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError
from gonio.formats.column_hints import unit_in
from gonio.formats.reader import ANGLES, COLUMNS, U_ANGLES, plain_degrees
from gonio.typing import Floats

_VALUES = ("brdf", "u_brdf", "u_random", U_ANGLES)
DPHI = "dphi_deg"
"""phi_r - phi_i, in place of `phi_r_deg`."""
_KEYS = {name.removesuffix("_deg").removesuffix("_nm"): name for name in (*COLUMNS, U_ANGLES, "sample", "side", DPHI)}
"""Names of columns in the pairs, without their units, and the table's names. A cause is named as the table does."""

_ANGLE: dict[str, Callable[[Floats], Floats]] = {"deg": np.positive, "rad": lambda values: plain_degrees(values, 15)}
_VALUE: dict[str, Callable[[Floats], Floats]] = {
    "1/sr": np.positive,
    "factor": lambda values: values / math.pi,
    "percent": lambda values: values / (100.0 * math.pi),
    "cos": np.positive,  # divided by cos(theta_r) once that is known
}
SHARES = {"relative": 1.0, "relative-percent": 0.01}
"""Further units of uncertainties: a share of the row's own value, or that in percent."""
_UNITS: dict[str, dict[str, Callable[[Floats], Floats]]] = {
    **dict.fromkeys((*ANGLES, DPHI), _ANGLE),
    # rounded so that 0.55 um becomes 550 and not the float beside it
    "wavelength_nm": {"nm": np.positive, "um": lambda values: np.round(values * 1000.0, 9)},
    **dict.fromkeys(_VALUES, _VALUE),
}
"""The units of each column; the first is taken where none is named, but of uncertainties that of `brdf`. A reflectance
factor is pi BRDF, "percent" a hundredth of one, and "cos" BRDF times cos(theta_r)."""
_SIGNS = {"theta_i_deg": ("signed",), "theta_r_deg": ("signed", "signed-retro")}
"""Of `theta_i`: a negative one is on the other side, at phi_i + 180. Of `theta_r`: on which side it is positive, the
mirror side or that of the retro-reflection."""
WIDE = {"*nm": "nm", "*um": "um", "*": ""}
"""Names for the columns of `brdf` that are one a wavelength, and the unit in their own names."""
MATRIX = "matrix"
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_SAID = {"%": ("percent", "relative-percent"), "1/sr": ("1/sr",), "deg": ("deg",), "rad": ("rad",), "nm": ("nm",),
         "um": ("um",)}  # fmt: skip
"""The units that a column may have whose own name says this one."""
_OWNERS = ((".csv", ".tsv", ".txt"), (".dat", ".asc", ".prn", ".tab"), (".xlsx", ".xlsm", ".xls"), (".parquet",))
"""Endings of files that have columns to name. Of files of one name those of the first kind that is there have them."""


@dataclass(frozen=True)
class Column:
    """Which of a file's columns is one of the table, and its unit."""

    own: str
    """Its name, `#3` for the third, a number or a word for all rows, or a name for several columns."""
    unit: str
    """"" of words."""
    stated: bool = field(default=False, compare=False)
    """Whether the pair names the unit."""
    sign: str = ""
    """"signed", "signed-retro" (of `theta_r`), or ""."""

    @property
    def spec(self) -> str:
        """As it is written in a pair."""
        return ":".join(part for part in (self.own, self.unit, self.sign) if part)


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

    It is that of a CSV of this name; where there is none, that of another text, a workbook or a Parquet file.

    Raises
    ------
    ConfigError
        The file cannot be read, or holds something else.
    """
    file = beside_path(path)
    if not os.path.lexists(file) or not owns(path):
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


def owns(path: Path) -> bool:
    """Whether `<name>.columns.toml` is about the table at `path`, and not about another of the same name."""
    return _has_columns(path) and _before(path) is None


def _has_columns(path: Path) -> bool:
    return any(path.suffix.lower() in endings for endings in _OWNERS)


def _before(path: Path) -> Path | None:
    """The table of this name whose `<name>.columns.toml` is, where it is not that of `path`."""
    kinds = itertools.takewhile(lambda endings: path.suffix.lower() not in endings, _OWNERS)
    return next((other for kind in kinds for one in kind if (other := path.with_suffix(one)).exists()), None)


def not_heeded(path: Path, title: str = "") -> list[str]:
    """A sentence where `<name>.columns.toml` lies beside a file and says nothing of it; `title` is its format's."""
    file = beside_path(path)
    if not os.path.lexists(file):
        return []
    if (other := _before(path)) is not None:
        return [f"{file.name} is about {other.name}, and is not heeded for {path.name}"] if _has_columns(path) else []
    if _has_columns(path):
        return [f"{file.name} is not heeded: {path.name} is read as {title}, whose columns have names of their own"]
    return [f"{file.name} is not heeded: {_NO_COLUMNS}"]


_NO_COLUMNS = f"it is for files that end in {', '.join(one for kind in _OWNERS for one in kind)}"


def remember(path: Path, columns: Mapping[str, str]) -> str | None:
    """Write the pairs to `<name>.columns.toml` beside the table they were right for; what was done, in a sentence.

    A file that is there stays as it is. None: it says the same already.
    """
    file, named = beside_path(path), wanted(columns, "--columns")
    if not owns(path):
        why = _NO_COLUMNS if (other := _before(path)) is None else f"{file.name} is about {other.name}"
        return f"--columns are not remembered for {path.name}: {why}"
    if os.path.lexists(file):
        try:
            same = wanted(beside(path) or {}, str(file)) == named
        except ConfigError:
            same = False
        return None if same else f"{file} says otherwise than --columns, which went before it; it is left as it is"
    head = f"# Which columns of {path.name} are which; --columns named them.\n"
    try:
        written = {key: one.spec for key, one in zip(columns, named.values(), strict=True)}
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
        if (name not in _KEYS.values() and not is_cause(name)) or name in found:
            known = f"{', '.join(_KEYS)}, s_<cause>"
            raise ConfigError(f"{where}: {key!r} is no column, or named twice; there are {known}")
        column = _column(name, spec, f"{where}: {key} = {spec[:40]!r}")
        if column.own in (other.own for other in found.values()) and not NUMBER.fullmatch(column.own):
            raise ConfigError(f"{where}: the column {column.own[:40]!r} is named twice")
        found[name] = column
    if DPHI in found and "phi_r_deg" in found:
        raise ConfigError(f"{where}: phi_r and dphi are both named, and one follows from the other; leave one out")
    for name, column in found.items():
        if not column.unit:
            found[name] = replace(_with_unit(name, column.own, found), sign=column.sign)
            _require_as_named(name, found[name], where)
    return found


def _column(name: str, spec: str, where: str) -> Column:
    """The column that the right side of a pair names, without a unit where it names none."""
    units = units_of(name)
    words = {"unit": units, "sign": _SIGNS.get(name, ())}
    own, said = spec, dict[str, str]()
    while ":" in own:
        rest, _, word = own.rpartition(":")
        kind = next((kind for kind, known in words.items() if word in known and kind not in said), None)
        if kind is None:
            if said:
                break  # a name with a colon in it
            known = " or ".join((*units, *words["sign"])) or "none"
            raise ConfigError(f"{where}: {word[:20]!r} is no unit of it; {known}")
        own, said[kind] = rest, word
    if not own:
        raise ConfigError(f"{where}: names no column")
    return Column(own, said.get("unit", ""), stated="unit" in said, sign=said.get("sign", ""))


def is_cause(name: str) -> bool:
    return name.startswith("s_") and len(name) > 2


def is_uncertainty(name: str) -> bool:
    return name in _VALUES[1:] or is_cause(name)


def units_of(name: str) -> tuple[str, ...]:
    """The units that a column may have; the first is taken where nothing says another."""
    return (*(_VALUE if is_cause(name) else _UNITS.get(name, {})), *(SHARES if is_uncertainty(name) else ()))


def in_table_units(name: str, unit: str, values: Floats) -> Floats:
    """The numbers of a column in the table's units; shares of a value, and values times cos(theta_r), as they are."""
    return (_VALUE if is_cause(name) else _UNITS.get(name, {})).get(unit, np.positive)(values)


def _with_unit(name: str, own: str, found: Mapping[str, Column]) -> Column:
    """A column that no unit is named for: an uncertainty has that of `brdf`."""
    follows = is_uncertainty(name)
    unit = next(iter(units_of(name)), "")
    return Column(own, found["brdf"].unit or unit if follows and "brdf" in found else unit)


def _require_as_named(name: str, column: Column, where: str) -> None:
    """`ConfigError` where a column's own name says another unit than the one that is taken."""
    said = unit_in(column.own)
    fitting = [unit for unit in units_of(name) if unit in _SAID.get(said, ())]
    if fitting and column.unit not in fitting:
        key = pair_key(name)
        shown = ", or ".join(f"{key}={column.own}:{unit}" for unit in (*fitting, column.unit))
        raise ConfigError(
            f"{where}: the name {column.own[:40]!r} says {said}, and {column.unit} is what is taken where no unit is "
            f"named; write {shown}"
        )


def require_units(every: Mapping[str, Column], units: Mapping[str, str], where: str) -> None:
    """`DataError` where a row of units says another unit than the one that is taken for a column."""
    for name, column in every.items():
        said = units.get(column.own, "")
        allowed = (*_SAID.get(said, ()), *(["cos"] if said == "1/sr" else ()))
        if not said or not column.unit or column.unit in allowed or (said == "-" and (column.stated or name != "brdf")):
            continue
        fitting = [unit for unit in units_of(name) if unit in (("factor", "1/sr") if said == "-" else allowed)]
        shown = ", or ".join(f"{pair_key(name)}={column.own}:{unit}" for unit in fitting)
        raise DataError(
            f"{where}: the row of units has {said} for {column.own[:40]!r}, and {column.unit} is taken for "
            f"{pair_key(name)}; {f'write {shown}, or ' if fitting else ''}correct that row, or delete it"
        )


def all_columns(found: Mapping[str, Column], header: Iterable[str]) -> dict[str, Column]:
    """The columns of a file with this header, by the table's names."""
    owned = [column.own for column in found.values()]
    others = [name for name in header if name not in owned and name not in found]
    plain = [name for name in others if name in _KEYS.values() or is_cause(name)]
    either = {"phi_r_deg": DPHI, DPHI: "phi_r_deg"}
    plain = [name for name in plain if either.get(name) not in (*found, *(plain if name == DPHI else ()))]
    return {**found, **{name: _with_unit(name, name, found) for name in plain}}


def pair_key(name: str) -> str:
    """A column's name as it stands in pairs."""
    return next((key for key, full in _KEYS.items() if full == name), name)


def table_name(key: str) -> str:
    """The measurement table's name for a key of the pairs."""
    return _KEYS.get(key, key)
