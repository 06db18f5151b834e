"""A table made by hand under its maker's own column names and units: which of them is which column.

The pairs stand on the command line (`--columns theta_i=ti:rad,brdf=R:factor`) or in `<name>.columns.toml` beside the
table (`theta_i = "ti:rad"`). The table is a text or an Excel workbook. Beside an instrument's workbook the file names
its blank (`blank = "dark.xls"`). What may stand for a column is in docs/formats.md.
"""

import math
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tomli_w

from gonio import polarisation
from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError
from gonio.formats import workbook
from gonio.formats.column_hints import NEEDED, unit_in
from gonio.formats.reader import (
    ANGLES,
    COLUMNS,
    SIDES,
    U_ANGLES,
    fold,
    plain_degrees,
    whole_turns,
    wrap_deg,
)
from gonio.formats.sheets import WORDS
from gonio.formats.text import BLANKS, CsvTable, decode, header_in, lines_of, separator, table_from
from gonio.typing import Array, Floats

_VALUES = ("brdf", "u_brdf", "u_random", U_ANGLES)
_DPHI = "dphi_deg"
"""phi_r - phi_i, in place of `phi_r_deg`."""
_KEYS = {name.removesuffix("_deg").removesuffix("_nm"): name for name in (*COLUMNS, U_ANGLES, "sample", "side", _DPHI)}
"""Names of columns in the pairs, without their units, and the table's names. A cause is named as the table does."""

_ANGLE: dict[str, Callable[[Floats], Floats]] = {"deg": np.positive, "rad": lambda values: plain_degrees(values, 15)}
_VALUE: dict[str, Callable[[Floats], Floats]] = {
    "1/sr": np.positive,
    "factor": lambda values: values / math.pi,
    "percent": lambda values: values / (100.0 * math.pi),
    "cos": np.positive,  # divided by cos(theta_r) once that is known
}
_SHARES = {"relative": 1.0, "relative-percent": 0.01}
"""Further units of uncertainties: a share of the row's own value, or that in percent."""
_UNITS: dict[str, dict[str, Callable[[Floats], Floats]]] = {
    **dict.fromkeys((*ANGLES, _DPHI), _ANGLE),
    # rounded so that 0.55 um becomes 550 and not the float beside it
    "wavelength_nm": {"nm": np.positive, "um": lambda values: np.round(values * 1000.0, 9)},
    **dict.fromkeys(_VALUES, _VALUE),
}
"""The units of each column; the first is taken where none is named, but of uncertainties that of `brdf`. A reflectance
factor is pi BRDF, "percent" a hundredth of one, and "cos" BRDF times cos(theta_r)."""
_SIGNS = ("signed", "signed-retro")
"""Of `theta_r`: on which side it is positive, the mirror side or that of the retro-reflection."""
WIDE = {"*nm": "nm", "*um": "um", "*": ""}
"""Names for the columns of `brdf` that are one a wavelength, and the unit in their own names."""
MATRIX = "matrix"
_ROWS, _HEADER = "#1", "header"
"""Where a matrix has theta_r and theta_i."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_COS_LEAST = 1e-6
"""Nearer to grazing than 6e-5 degrees nothing is divided by cos(theta_r)."""
_SAID = {"%": ("percent", "relative-percent"), "1/sr": ("1/sr",), "deg": ("deg",), "rad": ("rad",), "nm": ("nm",),
         "um": ("um",)}  # fmt: skip
"""The units that a column may have whose own name says this one."""
_TEXTS, _WORKBOOKS = (".csv", ".tsv", ".txt"), (".xlsx", ".xlsm", ".xls")


@dataclass(frozen=True)
class Column:
    """Which of a file's columns is one of the table, and its unit."""

    own: str
    """Its name, `#3` for the third, a number or a word for all rows, or a name for several columns."""
    unit: str
    """"" of words."""
    follows: bool = field(compare=False)
    """Whether the unit is that of `brdf`, because none is named."""
    sign: str = ""
    """One of `_SIGNS`, or ""."""

    @property
    def spec(self) -> str:
        """As it is written in a pair."""
        return ":".join(part for part in (self.own, self.unit, self.sign) if part)


@dataclass(frozen=True)
class Own:
    """The columns of a table of one's own, under the measurement table's names and in its units."""

    columns: dict[str, Array]
    lines: list[int]
    """The line that each row comes from; for workbooks that of the worksheet's table."""
    notes: list[str]
    stated_deg: Floats
    """The four angles as the file states them, shape (n, 4): azimuths from -360 to 360 become those of the table, so
    that a direction may be there in two ways (`gonio.formats.reader.one_value_a_direction`)."""


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
    ending = path.suffix.lower()
    texts = any(path.with_suffix(other).exists() for other in _TEXTS)
    return ending in _TEXTS or (ending in _WORKBOOKS and not texts)


def remember(path: Path, columns: Mapping[str, str]) -> str | None:
    """Write the pairs to `<name>.columns.toml` beside the table they were right for; what was done, in a sentence.

    A file that is there stays as it is. None: it says the same already.
    """
    file, named = beside_path(path), wanted(columns, "--columns")
    if not owns(path):
        return None
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
        if (name not in _KEYS.values() and not _is_cause(name)) or name in found:
            known = f"{', '.join(_KEYS)}, s_<cause>"
            raise ConfigError(f"{where}: {key!r} is no column, or named twice; there are {known}")
        column = _column(name, spec, f"{where}: {key} = {spec[:40]!r}")
        if column.own in (other.own for other in found.values()) and not _NUMBER.fullmatch(column.own):
            raise ConfigError(f"{where}: the column {column.own[:40]!r} is named twice")
        found[name] = column
    if _DPHI in found and "phi_r_deg" in found:
        raise ConfigError(f"{where}: phi_r and dphi are both named, and one follows from the other; leave one out")
    for name, column in found.items():
        if not column.unit:
            found[name] = replace(_with_unit(name, column.own, found), sign=column.sign)
            _require_as_named(name, found[name], where)
    return found


def _column(name: str, spec: str, where: str) -> Column:
    """The column that the right side of a pair names, without a unit where it names none."""
    units = _units(name)
    words = {"unit": units, "sign": _SIGNS if name == "theta_r_deg" else ()}
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
    return Column(own, said.get("unit", ""), follows=False, sign=said.get("sign", ""))


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
        key = pair_key(name)
        shown = ", or ".join(f"{key}={column.own}:{unit}" for unit in (*fitting, column.unit))
        raise ConfigError(
            f"{where}: the name {column.own[:40]!r} says {said}, and {column.unit} is what is taken where no unit is "
            f"named; write {shown}"
        )


def read(data: bytes, path: Path, columns: Mapping[str, str], where: str) -> Own:
    """The table under the measurement table's names and in its units, and notes on what was done to it.

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
    table, notes = _table(data, path, found)
    found, table, given = _unrolled(found, table, where, notes)
    every = _taken(found, [*table.header, *given])
    missing = [name for name in NEEDED if name not in every]
    if _DPHI in every or ("theta_r_deg" in every and every["theta_r_deg"].sign):
        missing = [name for name in missing if name != "phi_r_deg"]
        if "phi_i_deg" in missing:
            missing.remove("phi_i_deg")
            every["phi_i_deg"] = Column("0", "deg", follows=False)
    if missing:
        raise DataError(_no_column(missing, table, where))
    count = len(table.rows)
    for name, column in every.items():
        if column.own not in table.header and column.own not in given:
            given[column.own] = _constant(name, column, count, table, where)
            notes.append(f"{pair_key(name)} is {column.own} in all rows, in place of a column of that name")
    values = {name: _in_units(table, given, name, column) for name, column in every.items() if name not in WORDS}
    last = values.get("phi_r_deg", values.get(_DPHI, np.zeros(count)))
    stated = np.column_stack([*(values[name] for name in ANGLES[:3]), last])
    for name in {"phi_i_deg", "phi_r_deg", _DPHI} & values.keys():
        values[name] = _azimuths(values[name], every[name].unit)
    _place(values, every, table)
    _divide(values, every)
    made: dict[str, Array] = {
        name: (np.array(table.words(column.own), dtype=object) if column.own in table.header else given[column.own])
        for name, column in every.items()
        if name in WORDS
    }
    notes += [*table.notes(), *_told(every, given)]
    if left := [name for name in table.header if name not in {column.own for column in every.values()}]:
        notes.append(f"columns left out: {', '.join(repr(name[:40]) for name in left[:8])}")
    return Own({**values, **made}, table.line_numbers, notes, stated)


def _taken(found: Mapping[str, Column], header: Iterable[str]) -> dict[str, Column]:
    """The columns of a file with this header, by the table's names."""
    owned = [column.own for column in found.values()]
    others = [name for name in header if name not in owned and name not in found]
    plain = [name for name in others if name in _KEYS.values() or _is_cause(name)]
    either = {"phi_r_deg": _DPHI, _DPHI: "phi_r_deg"}
    plain = [name for name in plain if either.get(name) not in (*found, *(plain if name == _DPHI else ()))]
    return {**found, **{name: _with_unit(name, name, found) for name in plain}}


def pair_key(name: str) -> str:
    """A column's name as it stands in pairs."""
    return next((key for key, full in _KEYS.items() if full == name), name)


def table_name(key: str) -> str:
    """The measurement table's name for a key of the pairs."""
    return _KEYS.get(key, key)


def _no_column(missing: Sequence[str], table: CsvTable, where: str) -> str:
    listed = ", ".join(repr(name[:40]) for name in table.header[:16])
    return f"{table.path}, line 1: no column is named for {', '.join(missing)} in {where}; the file has {listed}"


def _table(data: bytes, path: Path, found: Mapping[str, Column]) -> tuple[CsvTable, list[str]]:
    """The cells of the file: of a workbook, or of a text, where its header is looked for."""
    named = [one.own for name, one in found.items() if not _is_given(name, one)]
    notes: list[str] = []
    if workbook.is_workbook(data):

        def takes(header: Iterable[str]) -> dict[str, str]:
            names = list(header)
            units = {column.own: column.unit for column in _taken(found, names).values()}
            return units | {name: found["brdf"].unit for name, _ in _wide(found, names)}

        data, notes = workbook.as_csv(data, path, named, takes)
    text = decode(data, path)
    lines = lines_of(text)
    matrix = "brdf" in found and found["brdf"].own == MATRIX
    if not matrix and any(name.startswith("#") and name[1:].isdigit() for name in named):
        return _by_position(lines, path, found, notes)
    place = header_in(lines, lambda cells: _is_header(cells, found))
    first, mark = place if place is not None else (0, separator(text))
    table = table_from(lines, first, mark, path)
    if missing := [name for name in named if name not in (_ROWS, _HEADER) and table.header.count(name) != 1]:
        there = ", ".join(repr(name[:40]) for name in table.header[:16])
        raise DataError(
            f"{path}, line {first + 1}: columns missing, or there twice: {', '.join(missing)}; the file has {there}"
        )
    if not table.rows:
        raise DataError(f"{path}: has a header and no rows")
    return table, [*notes, *_skipped(first)]


def _skipped(first: int) -> list[str]:
    return [f"the table begins at line {first + 1}; what stands before it is not read"] if first else []


def _is_given(name: str, column: Column) -> bool:
    """Whether this may be no name of one column: a value for all rows, or a name for several columns."""
    if name == "brdf":
        return column.own in (*WIDE, MATRIX)
    return bool(_NUMBER.fullmatch(column.own)) or column.own in _GIVEN_WORDS.get(name, ())


_GIVEN_WORDS = {"polarisation": polarisation.WORDS, "side": SIDES}


def _is_header(cells: list[str], found: Mapping[str, Column]) -> bool:
    """Whether these cells name every column that is needed."""
    if "brdf" in found and found["brdf"].own == MATRIX:
        return len(cells) > 1 and all(_NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells[1:])
    if any(cells.count(one.own) != 1 for name, one in found.items() if not _is_given(name, one)):
        return False
    if "brdf" in found and found["brdf"].own in WIDE:
        return bool(_wide(found, cells))
    return "brdf" in _taken(found, cells)


def _by_position(
    lines: Sequence[str], path: Path, found: Mapping[str, Column], notes: list[str]
) -> tuple[CsvTable, list[str]]:
    """The table whose columns are named by their places, from the first line that has numbers there."""
    if others := [one.own for name, one in found.items() if not _is_given(name, one) and not one.own.startswith("#")]:
        raise DataError(f"{path}: a table without names has no {others[0]!r}; name all its columns as #1, #2, ...")
    places = {name: int(one.own[1:]) - 1 for name, one in found.items() if one.own.startswith("#")}
    numbers = [k for name, k in places.items() if name not in WORDS]

    def begins(cells: list[str]) -> bool:
        return len(cells) > max(places.values()) and all(
            k >= 0 and _NUMBER.fullmatch(cells[k].replace(",", ".")) for k in numbers
        )

    place = header_in(lines, begins)
    if place is None:
        raise DataError(f"{path}: no line has numbers in the columns {', '.join(f'#{k + 1}' for k in sorted(numbers))}")
    first, mark = place
    width = len(lines[first].split()) if mark == BLANKS else lines[first].count(mark) + 1
    table = table_from(lines, first, mark, path, [f"#{k}" for k in range(1, width + 1)])
    return table, [*notes, *_skipped(first)]


def _wide(found: Mapping[str, Column], header: Iterable[str]) -> list[tuple[str, float]]:
    """The columns of a file that have one wavelength each, and which [in the unit of their names]."""
    unit = WIDE.get(found["brdf"].own) if "brdf" in found else None
    if unit is None:
        return []
    pattern = re.compile(rf"\s*({_NUMBER.pattern})\s*{unit}\s*", re.IGNORECASE)
    shown = [(name, pattern.fullmatch(name.replace(",", "."))) for name in header]
    return [(name, float(match[1])) for name, match in shown if match]


def _unrolled(
    found: dict[str, Column], table: CsvTable, where: str, notes: list[str]
) -> tuple[dict[str, Column], CsvTable, dict[str, Array]]:
    """A table with a row a value, of one with several values a row; and what its header gives for each row."""
    own = found["brdf"].own if "brdf" in found else ""
    if own not in (*WIDE, MATRIX) or own in table.header:
        return found, table, {}
    if own == MATRIX:
        key, unit = "theta_i_deg", found.get("theta_i_deg", Column("", "deg", follows=False)).unit
        wide = [(name, float(name.replace(",", "."))) for name in table.header[1:]]
        found.setdefault("theta_r_deg", Column(_ROWS, "deg", follows=False))
        for name, place in (("theta_r_deg", _ROWS), (key, _HEADER)):
            if found.get(name, Column(place, "", follows=False)).own != place:
                raise ConfigError(
                    f"{where}: of a matrix {pair_key(name)} is in its {place}; write {pair_key(name)}={place}"
                )
        header = [_ROWS]
        notes.append(f"a matrix: theta_r in its rows, theta_i in its header ({_range(wide)})")
    else:
        key, unit = "wavelength_nm", WIDE[own] or "nm"
        wide = _wide(found, table.header)
        if key in found:
            raise ConfigError(f"{where}: wavelength is named, and brdf={own} takes it from the header; leave it out")
        header = [name for name in table.header if name not in dict(wide)]
        notes.append(f"brdf is in {len(wide)} columns, one a wavelength ({_range(wide)} {unit})")
    if len({value for _, value in wide}) < len(wide):
        raise DataError(f"{table.path}: two columns of {own!r} are of one value; leave one out")
    at = {name: k for k, name in enumerate(table.header)}
    kept = [0] if own == MATRIX else [at[name] for name in header]
    columns = [at[name] for name, _ in wide]
    rows = [[*(row[k] for k in kept), row[column]] for row in table.rows for column in columns]
    lines = [line for line in table.line_numbers for _ in columns]
    given: dict[str, Array] = {_HEADER: np.tile([value for _, value in wide], len(table.rows))}
    found[key] = Column(_HEADER, unit, follows=False)
    return found, CsvTable(table.path, [*header, own], rows, lines, table.decimal), given


def _range(wide: Sequence[tuple[str, float]]) -> str:
    values = [value for _, value in wide]
    return f"{min(values):g} to {max(values):g}"


def _constant(name: str, column: Column, count: int, table: CsvTable, where: str) -> Array:
    """What all rows have."""
    if name in _GIVEN_WORDS and column.own in _GIVEN_WORDS[name]:
        return np.full(count, column.own, dtype=object)
    if name in (*WORDS, "brdf") or not _NUMBER.fullmatch(column.own):
        raise DataError(_no_column([name], table, where))
    return np.full(count, float(column.own))


def _place(values: dict[str, Floats], every: dict[str, Column], table: CsvTable) -> None:
    """Azimuths toward the detector from those from the plane of incidence, and from the sign of theta_r."""
    phi_i, theta, sign = values["phi_i_deg"], values["theta_r_deg"], every["theta_r_deg"].sign
    if _DPHI in values:
        values["phi_r_deg"] = _sum(phi_i, values.pop(_DPHI))
    if not sign:
        return
    side = 180.0 if sign == "signed" else 0.0
    if "phi_r_deg" not in values:
        values["phi_r_deg"] = np.full(len(theta), np.nan)
    dphi = values["phi_r_deg"] - phi_i
    plane = np.isclose(np.mod(dphi + 90.0, 180.0), 90.0, rtol=0.0, atol=_AS_ONE_DEG)
    if np.isnan(dphi).all() or (plane.all() and np.ptp(np.cos(np.deg2rad(dphi))) < 1.0):
        dphi = np.full(len(theta), side)
    wrong = np.flatnonzero(np.cos(np.deg2rad(dphi - side)) < -_COS_LEAST)
    if wrong.size:
        row = int(wrong[0])
        raise DataError(
            f"{table.where(row)}: theta_r is {sign}, and phi_r - phi_i = {np.mod(dphi[row], 360):g} says that its "
            f"positive side is another one (180 is the mirror side); where the sign alone is right, add dphi={side:g}, "
            "which goes before a column phi_r"
        )
    values["theta_r_deg"], values["phi_r_deg"] = fold(theta, _sum(phi_i, dphi))


_AS_ONE_DEG = 1e-6
"""Azimuths that differ by less are one."""


def _sum(phi_i: Floats, dphi: Floats) -> Floats:
    """phi_i + dphi in [0, 360); where one lies beyond a turn NaN, which is refused."""
    known = (np.abs(phi_i) <= 360.0) & (np.abs(dphi) <= 360.0)
    return np.where(known, wrap_deg(phi_i + dphi), np.nan)


def _divide(values: dict[str, Floats], every: Mapping[str, Column]) -> None:
    """Shares of a value, and values times cos(theta_r), as values; what is no value at grazing is a hole."""
    cosine = np.abs(np.cos(np.deg2rad(values["theta_r_deg"])))
    for name, column in every.items():
        if column.unit == "cos":
            values[name] = np.where(cosine > _COS_LEAST, values[name] / np.maximum(cosine, _COS_LEAST), np.nan)
    for name, column in every.items():
        if share := _SHARES.get(column.unit):
            signed = values["brdf"] if _is_cause(name) else np.abs(values["brdf"])
            values[name] = share * values[name] * signed


def _azimuths(phi: Floats, unit: str) -> Floats:
    """Azimuths in [0, 360) degrees; those beyond a turn as they are, which the table then refuses."""
    phi = whole_turns(phi) if unit == "rad" else phi
    return np.where(np.abs(phi) <= 360.0, wrap_deg(phi), phi)


def _in_units(table: CsvTable, given: Mapping[str, Array], name: str, column: Column) -> Floats:
    """The numbers of a column in the table's units; shares of a value as numbers."""
    if column.own in table.header:
        values = table.column(column.own, estimates=name not in (*ANGLES, _DPHI))
    else:
        values = given[column.own].astype(np.float64)
    return (_VALUE if _is_cause(name) else _UNITS.get(name, {})).get(column.unit, np.positive)(values)


_SAID_SIGN = {"signed": "the mirror side", "signed-retro": "the side of the source"}


def _told(every: Mapping[str, Column], given: Mapping[str, Array]) -> list[str]:
    """What was taken for the columns, where it is not as their names say."""
    pairs = {
        name: repr(one.own) + (f" [{one.unit}]" if one.unit else "")
        for name, one in every.items()
        if one.own not in given
    }
    named = [f"{shown} is {name}" for name, shown in pairs.items() if every[name].own != name]
    return [
        *([f"the file's columns by the table's names: {', '.join(named)}"] if named else []),
        *(
            f"theta_r is signed: positive is {_SAID_SIGN[one.sign]}, and phi_r follows from the sign"
            for one in every.values()
            if one.sign
        ),
        *("phi_r is phi_i + dphi: where dphi is 180 is the mirror side" for name in every if name == _DPHI),
        *(
            f"the unit of brdf is that of {pairs[name]} too, for none is named; if it is in 1/sr, write "
            f"{name} = {f'{one.own}:1/sr'!r}"
            for name, one in every.items()
            if one.follows and one.unit != "1/sr" and name in pairs
        ),
    ]
