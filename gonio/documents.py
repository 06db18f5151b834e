"""The types of documents: JSON objects and TOML tables, whose values are known by their readers alone."""

from typing import Any

JsonObject = dict[str, Any]
"""A JSON object: what is written to a file, or sent, under names."""
TomlTable = dict[str, Any]
"""A table of a TOML file as it is read: keys, and values or tables below them."""


def laid_over(tables: TomlTable, values: TomlTable) -> TomlTable:
    """Nested tables with other values for some keys; a table lies over a table, anything else takes its place."""
    out = dict(tables)
    for key, value in values.items():
        below = out.get(key)
        out[key] = laid_over(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return out
