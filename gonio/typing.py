"""Array types that every package names."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
"""Float64 of any shape."""
