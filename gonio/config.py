"""TOML into checked, frozen models, with messages that name the file, the key, the value and the remedy; and back.

Ranges of numbers that keys of a rig file share.
"""

import re
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from gonio.disk import only_file
from gonio.errors import ConfigError, did_you_mean
from gonio.typing import TomlTable

MAX_DEPTH = 32
"""Tables and lists within each other; a rig file has four levels."""
LONGEST_SHOWN = 100
"""Characters of a value in a message."""
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{2 * MAX_DEPTH}}}""")
"""A dotted key for whose length squared tomllib takes memory; no text that has a space between two words is one."""


class Strict(BaseModel):
    """A configuration table: frozen, with every unknown key an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_numbers(cls, values: Any) -> Any:
        """Refuse text and true for a number, which pydantic would make one of (12.0 of "12", 1.0 of true)."""
        if not isinstance(values, dict):
            return values
        wrong: list[InitErrorDetails] = []
        for name in _fields_of_numbers(cls) & values.keys():
            if what := _no_number(values[name]):
                error = PydanticCustomError("number", "must be a number, not {what}", {"what": what})
                wrong.append({"type": error, "loc": (name,), "input": values[name]})
        if wrong:
            raise ValidationError.from_exception_data(cls.__name__, wrong)
        return values


def _no_number(value: Any) -> str:
    """What a value, or an entry of a list, is that must not stand for a number."""
    if isinstance(value, list | tuple):
        return next(filter(None, map(_no_number, value)), "")
    return "true or false" if isinstance(value, bool) else "text" if isinstance(value, str) else ""


@cache
def _fields_of_numbers(table: type[Strict]) -> frozenset[str]:
    """The keys of a table that hold numbers; asked for at every table that is read."""
    return frozenset(name for name, field in table.model_fields.items() if _is_number(field.annotation))


def _is_number(annotation: Any) -> bool:
    """Whether a type holds numbers alone, or lists of them; None may stand for none."""
    if get_origin(annotation) is Annotated:
        return _is_number(get_args(annotation)[0])
    if inner := get_args(annotation):
        return get_origin(annotation) is not Literal and all(_is_number(a) or a in (type(None), ...) for a in inner)
    return annotation in (int, float)


Table = TypeVar("Table", bound=Strict)
LARGEST_WHOLE = 2**63 - 1
"""What TOML promises of a whole number."""


def read_toml(path: str | Path) -> TomlTable:
    """The tables of a TOML file.

    Raises
    ------
    ConfigError
        The file is missing, cannot be read, or is not TOML (with the line).
    """
    path = Path(path)
    too_deep = ConfigError(f"{path}: is nested too deeply: at most {MAX_DEPTH} levels are read")
    try:
        with open(path, encoding="utf-8-sig", opener=only_file) as file:
            text = file.read()
        if _LONG_KEY.search(text):
            raise too_deep
        tables = tomllib.loads(text)
    except FileNotFoundError:
        near = did_you_mean(path.name, (file.name for file in path.parent.glob("*.toml")), "")
        raise ConfigError(f"{path}: there is no such file{near and '; '}{near}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start})") from None
    except ValueError as error:  # a TOMLDecodeError, or a number of thousands of digits
        raise ConfigError(f"{path}: is not valid TOML: {error}") from None
    except RecursionError:
        raise too_deep from None
    inside: list[tuple[list[Any], Any]] = [([], tables)]
    for _ in range(MAX_DEPTH):
        parts = [
            ([*where, key], part)
            for where, whole in inside
            for key, part in (whole.items() if isinstance(whole, dict) else enumerate(whole))
        ]
        for where, part in parts:
            if isinstance(part, int) and abs(part) > LARGEST_WHOLE:
                raise ConfigError(f"{path}: {_dotted(where)} has {len(str(abs(part)))} digits: at most 18 are read")
        inside = [(where, part) for where, part in parts if isinstance(part, dict | list)]
        if not inside:
            return tables
    raise too_deep


def parse(table: type[Table], values: TomlTable, source: str | Path) -> Table:
    """Check `values` (from `source`, named in messages) against a configuration table.

    Raises
    ------
    ConfigError
        One line for each wrong key: where it is, what was given, what is allowed, and the nearest known key.
    """
    try:
        return table.model_validate(values)
    except ValidationError as error:
        told = [_explain(table, item) for item in error.errors() if not _is_said(item)]
    ways: dict[str, list[str]] = {}
    for where, what in told:
        ways.setdefault(where, []).append(what)
    lines = [
        f"{source}: {where}{' or '.join(dict.fromkeys(what)).replace(' or must be ', ' or ')}"
        for where, what in ways.items()
    ]
    raise ConfigError("\n".join(lines[:8]))


def _is_said(item: Any) -> bool:
    """Whether an entry is missing from a list that ends before the entry in front of it, which is said already."""
    last = item["loc"][-1] if item["loc"] else None
    return item["type"] == "missing" and isinstance(last, int) and last > len(item["input"])


def load(table: type[Table], path: str | Path) -> Table:
    """Read and check one TOML file; see `read_toml` and `parse` for the errors."""
    return parse(table, read_toml(path), path)


_KINDS = {
    "string": "text in quotes", "bool": "true or false", "int": "a whole number", "float": "a number",
    "tuple": "a list in square brackets", "list": "a list in square brackets", "dict": "a table", "model": "a table",
    "date": "a date, as 2026-11-22",
}  # fmt: skip
"""What a value must be, by the first word of the kind of pydantic's error (as in tuple_type, int_from_float)."""
_WAY = re.compile(r"str|float|int|(tuple|list|dict)\[.*\]")
"""What pydantic adds to the place of a value that may be of several kinds: the one that it tried."""


def _explain(table: type[BaseModel], item: Any) -> tuple[str, str]:
    """Where it is and what was given; and what is wrong, where that does not say it."""
    loc, kind = item["loc"], item["type"]
    location, tables = _found(table, loc[:-1] if loc and _WAY.fullmatch(str(loc[-1])) else loc)
    where = _dotted(location)
    if kind == "extra_forbidden":
        known = list(_found(table, loc[:-1])[1][0].model_fields)
        hint = did_you_mean(str(loc[-1]), known, f"known here: {', '.join(sorted(known))}")
        return f"unknown key {where}; {hint}", ""
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        key, known = item["ctx"]["discriminator"].strip("'"), [tag for each in tables for tag in _tags(each)]
        if kind == "union_tag_not_found":
            return f"the key {where}.{key} is missing; known here: {', '.join(known)}", ""
        hint = did_you_mean(item["ctx"]["tag"], known, f"known here: {', '.join(known)}")
        return f"{where}.{key} = {item['ctx']['tag']!r}: is unknown; {hint}", ""
    if kind == "missing" and isinstance(location[-1], int):
        return f"{_dotted(location[:-1])} = {_shown(item['input'])}: ", f"its entry {location[-1] + 1} is missing"
    if kind == "missing":
        return f"the key {where} is missing", ""
    value = item.get("input")
    head = f"{where or 'the file'}{'' if isinstance(value, dict) else f' = {_shown(value)}'}: "
    if kind in ("too_long", "too_short"):
        ends = {"too_long": "at most {max_length}", "too_short": "at least {min_length}"}[kind].format(**item["ctx"])
        return head, f"must hold {ends}, and holds {item['ctx']['actual_length']}"
    if re.search("_(type|parsing|from_float)$", kind) and (what := _KINDS.get(kind.partition("_")[0])):
        if what == _KINDS["tuple"] and tables != _found(table, loc[:-1])[1]:
            return head, f"must be a list of tables, each below [[{where}]]"
        return head, f"must be {what}{' (it is a table)' if isinstance(value, dict) else ''}"
    message = item["msg"].removeprefix("Value error, ").replace("Input should", "must", 1)
    return head, f"{message[:1].lower()}{message[1:]}"


def _shown(value: Any) -> str:
    """A value as messages have it."""
    text = repr(value)
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _dotted(location: list[Any]) -> str:
    out = ""
    for part in location:
        out += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if out else str(part)
    return out


def _found(table: type[BaseModel], location: tuple[Any, ...]) -> tuple[list[Any], list[type[BaseModel]]]:
    """Where pydantic's `location` is in the file, which has no tags of tables, and the tables that may stand there."""
    tables, place = [table], []
    for part in location:
        if len(tables) > 1 and any(part in _tags(each) for each in tables):
            tables = [each for each in tables if part in _tags(each)]
            continue
        place.append(part)
        fields = [each.model_fields[part] for each in tables if isinstance(part, str) and part in each.model_fields]
        if fields:
            tables = _tables_inside(fields[0].annotation) or tables
    return place, tables


def _tags(table: type[BaseModel]) -> list[Any]:
    """What tells a table from others in its place: keys that can have one value only."""
    notes = [field.annotation for field in table.model_fields.values()]
    return [get_args(note)[0] for note in notes if get_origin(note) is Literal and len(get_args(note)) == 1]


def _tables_inside(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for inner in get_args(annotation) for found in _tables_inside(inner)]


def to_toml(tables: TomlTable) -> str:
    """TOML of nested tables of strings, booleans, finite numbers and lists; None does not occur."""
    import tomli_w

    return tomli_w.dumps(tables)


def numbers_in(tables: Any, where: str = "") -> dict[str, float]:
    """The numbers in nested tables and lists, by the path to each: `tau_um`, `slopes[0][1]`, `phong.k_s`."""
    if isinstance(tables, dict):
        inner = [(f"{where}.{key}" if where else str(key), value) for key, value in tables.items()]
    elif isinstance(tables, list):
        inner = [(f"{where}[{k}]", value) for k, value in enumerate(tables)]
    else:
        is_one = isinstance(tables, int | float) and not isinstance(tables, bool)
        return {where: float(tables)} if is_one else {}
    return {name: number for path, value in inner for name, number in numbers_in(value, path).items()}


def with_numbers(tables: Any, numbers: Mapping[str, Any], where: str = "") -> Any:
    """Nested tables and lists with other numbers, or spectra, at some of the paths of `numbers_in`."""
    if isinstance(tables, dict):
        return {
            key: with_numbers(value, numbers, f"{where}.{key}" if where else str(key)) for key, value in tables.items()
        }
    if isinstance(tables, list):
        return [with_numbers(value, numbers, f"{where}[{k}]") for k, value in enumerate(tables)]
    return numbers.get(where, tables)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
SmallAngle = Annotated[float, Field(ge=-30, le=30)]
"""Error of alignment [deg]: what is larger is another construction."""
