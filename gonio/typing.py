"""Types that every package names: arrays; tables and drawings, without loading pandas or matplotlib; and documents.

A document is a JSON object or a TOML table, whose values are known by their readers alone.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray as NDArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure

    DataFrame = pd.DataFrame
    Series = pd.Series[Any]
else:  # pandas takes a third of a second to load, matplotlib more: only functions that use them import them
    DataFrame = Series = Axes = Figure = Any

ArrayLike = npt.ArrayLike
Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
"""Float64 of any shape."""
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.intp]
"""Places in another array, or counts."""


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
