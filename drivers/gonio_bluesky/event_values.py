"""Values of event documents: numbers, texts and arrays as JSON has them, with their keys."""

from __future__ import annotations

import datetime
import json
import math
import re
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from gonio.documents import JsonObject

if TYPE_CHECKING:
    pass


def _seconds(wall: str) -> float:
    """Seconds since 1970 of a time of day (UTC) as run.toml and journal hold it; 0 where they do not."""
    return datetime.datetime.fromisoformat(wall).timestamp() if wall else 0.0


def _finite(value: Any) -> Any:
    """A value as JSON has it: null for a number that is not known."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(source: str, units: str = "") -> JsonObject:
    return {"source": source, "dtype": "number", "dtype_numpy": "<f8", "shape": [], "units": units}


def _integer(source: str) -> JsonObject:
    return {"source": source, "dtype": "integer", "dtype_numpy": "<i8", "shape": []}


def _text(source: str) -> JsonObject:
    return {"source": source, "dtype": "string", "shape": []}


def _array(source: str, length: int, units: str, dim: str) -> JsonObject:
    out = {"source": source, "dtype": "array", "dtype_numpy": "<f8", "shape": [length], "dims": [dim]}
    return out | ({"units": units} if units else {})


def _key_of(value: Any, source: str) -> JsonObject:
    """The data key of a value of the configuration."""
    if isinstance(value, bool):
        return {"source": source, "dtype": "boolean", "shape": []}
    if isinstance(value, int):
        return _integer(source)
    if isinstance(value, float):
        return _number(source)
    if isinstance(value, list):
        text = any(isinstance(one, str) for one in value)
        return _array(source, len(value), "", "entry") | ({"dtype_numpy": "<U64"} if text else {})
    return _text(source)


_NOT_IN_NAMES = re.compile(r"[^\w-]+")


def _named(value: Any) -> Any:
    """Nested tables with names that the event model takes: no dots and no slashes."""
    if isinstance(value, dict):
        return {_NOT_IN_NAMES.sub("_", str(key)): _named(inner) for key, inner in value.items()}
    return [_named(inner) for inner in value] if isinstance(value, list) else value


def _flat(tables: Mapping[str, Any], where: str = "") -> Iterable[tuple[str, Any]]:
    """Nested tables as one, by names such as `geometry_light_distance_mm`."""
    for key, value in tables.items():
        name = _NOT_IN_NAMES.sub("_", f"{where}_{key}" if where else key)
        if isinstance(value, dict):
            yield from _flat(value, name)
        elif isinstance(value, list) and not all(
            isinstance(one, int | float) and not isinstance(one, bool) for one in value
        ):
            yield name, json.dumps(value, ensure_ascii=False)
        else:
            yield name, value
