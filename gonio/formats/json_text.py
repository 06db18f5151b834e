"""JSON from anybody: one object, with finite numbers, every error naming the line or the path inside the document."""

import contextlib
import json
import math
from pathlib import Path
from typing import Any

from gonio.errors import DataError
from gonio.shown import one_line
from gonio.typing import JsonObject


def load(data: bytes, path: Path, what: str) -> JsonObject:
    """The one JSON object of a file; `what` names the format in messages.

    Raises
    ------
    DataError
        The bytes are no text or no JSON (with the line), or the document is no object.
    """

    def refuse(word: str) -> Any:
        raise ValueError(f"{word} is not JSON")

    try:
        content = json.loads(data.decode("utf-8-sig"), parse_constant=refuse)
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: byte {error.start} is not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise DataError(f"{path}, line {error.lineno}, column {error.colno}: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: is not valid JSON: {one_line(error, 200)}") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: {what} is one JSON object")
    return content


def finite(value: Any, where: str) -> float:
    """A finite number; else `DataError` naming `where`."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"{where} is {short(value)}, not a number")
    with contextlib.suppress(OverflowError):
        if math.isfinite(value):
            return float(value)
    raise DataError(f"{where} is beyond the range of a float")


def short(value: Any) -> str:
    """A value as a message shows it: at most 40 characters."""
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
