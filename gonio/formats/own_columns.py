"""A table made by hand under its maker's own column names and units, as the measurement table has it.

`gonio.formats.own_pairs` says which column is which, `gonio.formats.own_layouts` where the cells are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.column_hints import NEEDED
from gonio.formats.own_layouts import GIVEN_WORDS, table_of, unrolled
from gonio.formats.own_pairs import (
    DPHI,
    NUMBER,
    SHARES,
    Column,
    all_columns,
    in_table_units,
    is_cause,
    is_uncertainty,
    pair_key,
    require_units,
    wanted,
)
from gonio.formats.reader import ANGLES, fold, whole_turns, wrap_deg
from gonio.formats.sheets import WORDS
from gonio.formats.text import CsvTable
from gonio.typing import Array, Floats

_COS_LEAST = 1e-6
"""Nearer to grazing than 6e-5 degrees nothing is divided by cos(theta_r)."""


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
    cells = table_of(data, path, found)
    notes = cells.notes
    found, table, given = unrolled(found, cells, where)
    every = all_columns(found, [*table.header, *given])
    require_units(every, cells.units, f"{path}, line {cells.units_line}")
    missing = [name for name in NEEDED if name not in every]
    if DPHI in every or ("theta_r_deg" in every and every["theta_r_deg"].sign):
        missing = [name for name in missing if name != "phi_r_deg"]
        if "phi_i_deg" in missing:
            missing.remove("phi_i_deg")
            every["phi_i_deg"] = Column("0", "deg")
    if missing:
        raise DataError(_no_column(missing, table, where))
    count = len(table.rows)
    for name, column in every.items():
        if column.own not in table.header and column.own not in given:
            given[column.own] = _constant(name, column, count, table, where)
            notes.append(f"{pair_key(name)} is {column.own} in all rows, in place of a column of that name")
    values = {name: _in_units(table, given, name, column) for name, column in every.items() if name not in WORDS}
    last = values.get("phi_r_deg", values.get(DPHI, np.zeros(count)))
    stated = np.column_stack([*(values[name] for name in ANGLES[:3]), last])
    for name in {"phi_i_deg", "phi_r_deg", DPHI} & values.keys():
        values[name] = _azimuths(values[name], every[name].unit)
    _place(values, every, table, notes)
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


def _no_column(missing: Sequence[str], table: CsvTable, where: str) -> str:
    listed = ", ".join(repr(name[:40]) for name in table.header[:16])
    return f"{table.path}, line 1: no column is named for {', '.join(missing)} in {where}; the file has {listed}"


def _constant(name: str, column: Column, count: int, table: CsvTable, where: str) -> Array:
    """What all rows have."""
    if name in GIVEN_WORDS and column.own in GIVEN_WORDS[name]:
        return np.full(count, column.own, dtype=object)
    if name in (*WORDS, "brdf") or not NUMBER.fullmatch(column.own):
        raise DataError(_no_column([name], table, where))
    return np.full(count, float(column.own))


def _place(values: dict[str, Floats], every: Mapping[str, Column], table: CsvTable, notes: list[str]) -> None:
    """Angles as the table has them: azimuths from those from the plane of incidence, and from signs."""
    phi_i = values["phi_i_deg"]
    if every["theta_i_deg"].sign:
        theta_i = values["theta_i_deg"]
        values["theta_i_deg"], values["phi_i_deg"] = fold(theta_i, phi_i)
        negative = theta_i < 0
        notes.append(f"theta_i is signed: {int(negative.sum())} of {negative.size} rows have the source at phi_i + 180")
        if (theta_i <= 0).all():  # then the mirror side is that of the light as it is, else that of positive theta_i
            phi_i = values["phi_i_deg"]
        elif DPHI in values or every["theta_r_deg"].sign:
            notes.append("theta_i has both signs: the mirror side is that of positive theta_i")
    if DPHI in values:
        values["phi_r_deg"] = _sum(phi_i, values.pop(DPHI))
    if every["theta_r_deg"].sign:
        _fold_receiver(values, phi_i, every["theta_r_deg"].sign, table)


def _fold_receiver(values: dict[str, Floats], phi_i: Floats, sign: str, table: CsvTable) -> None:
    """Directions toward the detector from a signed theta_r; `phi_i` is that of which the sign tells the side."""
    theta, side = values["theta_r_deg"], 180.0 if sign == "signed" else 0.0
    dphi = values.get("phi_r_deg", np.full(len(theta), np.nan)) - phi_i
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
        if share := SHARES.get(column.unit):
            signed = values["brdf"] if is_cause(name) else np.abs(values["brdf"])
            values[name] = share * values[name] * signed


def _azimuths(phi: Floats, unit: str) -> Floats:
    """Azimuths in [0, 360) degrees; those beyond a turn as they are, which the table then refuses."""
    phi = whole_turns(phi) if unit == "rad" else phi
    return np.where(np.abs(phi) <= 360.0, wrap_deg(phi), phi)


def _in_units(table: CsvTable, given: Mapping[str, Array], name: str, column: Column) -> Floats:
    """The numbers of a column in the table's units, as `in_table_units` gives them."""
    if column.own in table.header:
        values = table.column(column.own, estimates=name not in (*ANGLES, DPHI))
    else:
        values = given[column.own].astype(np.float64)
    return in_table_units(name, column.unit, values)


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
            for one in [every["theta_r_deg"]]
            if one.sign
        ),
        *("phi_r is phi_i + dphi: where dphi is 180 is the mirror side" for name in every if name == DPHI),
        *(
            f"the unit of brdf is that of {pairs[name]} too, for none is named; if it is in 1/sr, write "
            f"{name} = {f'{one.own}:1/sr'!r}"
            for name, one in every.items()
            if is_uncertainty(name) and not one.stated and one.unit != "1/sr" and name in pairs
        ),
    ]
