"""Array types that every package names, and those of tables and drawings without loading pandas or matplotlib."""

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
