"""Array types that every package names, and the table's type without loading pandas."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray as NDArray

if TYPE_CHECKING:
    import pandas as pd

    DataFrame = pd.DataFrame
    Series = pd.Series[Any]
else:  # pandas takes a third of a second to load: only functions that use it import it
    DataFrame = Series = Any

ArrayLike = npt.ArrayLike
Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
"""Float64 of any shape."""
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.intp]
"""Places in another array, or counts."""
