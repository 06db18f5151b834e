"""The types of documents: JSON objects and TOML tables, whose values are known by their readers alone."""

from typing import Any

JsonObject = dict[str, Any]
"""A JSON object: what is written to a file, or sent, under names."""
TomlTable = dict[str, Any]
"""A table of a TOML file as it is read: keys, and values or tables below them."""
