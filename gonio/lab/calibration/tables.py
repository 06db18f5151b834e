"""Tables of numbers that a calibration reads."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np

from gonio.disk import content
from gonio.errors import DataError
from gonio.typing import DataFrame


def read_numbers(
    path: str | Path, needed: Sequence[str], optional: Sequence[str] = (), words: Sequence[str] = ()
) -> DataFrame:
    """A CSV with some columns, whose values are finite numbers; columns in `words` stay as they are.

    Raises
    ------
    ConfigError
        There is no such file.
    DataError
        The file cannot be read, lacks a column, is empty, or holds what is no number; the message names the row.
    """
    import pandas as pd

    data = content(Path(path), str(path), unreadable=DataError)
    try:
        table = pd.read_csv(BytesIO(data), skipinitialspace=True, comment="#", dtype=str)
    except ValueError as error:
        raise DataError(f"{path}: cannot be read as a table: {error}") from None
    if not isinstance(table.index, pd.RangeIndex):  # pandas takes the first cells as names of the rows
        raise DataError(f"{path}: row 1 has more cells than the header names columns; numbers need decimal points")
    missing = [name for name in (*words, *needed) if name not in table]
    if missing:
        raise DataError(f"{path}: the column {missing[0]} is missing; needed are {', '.join((*words, *needed))}")
    if table.empty:
        raise DataError(f"{path}: holds no rows")
    out: dict[str, pd.Series[str] | pd.Series[float]] = {name: table[name].str.strip() for name in words}
    for name in (*needed, *(n for n in optional if n in table)):
        numbers = pd.to_numeric(table[name], errors="coerce").astype(float)
        bad = np.flatnonzero(~np.isfinite(numbers.to_numpy()))
        if bad.size:
            said = table[name].iloc[bad[0]]
            raise DataError(f"{path}: row {bad[0] + 1}: {name} = {'nothing' if pd.isna(said) else said}: is no number")
        out[name] = numbers
    return pd.DataFrame(out)
