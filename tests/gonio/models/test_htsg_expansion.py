"""The generated approximations beside scipy's functions, to the digits that each of them states."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import erfcx, lambertw

from gonio.models import _htsg_expansion as expansion
from gonio.typing import Floats


def plain(function: Any) -> Callable[[Floats], Any]:
    """The function as it is written, not compiled: it takes arrays too."""
    out: Callable[[Floats], Any] = getattr(function, "py_func", function)
    return out


def test_the_scaled_complement_of_the_error_function() -> None:
    h = np.linspace(0.0, 6.5, 4001)
    found = plain(expansion.scaled_erfcx)((h - 3.0) / (h + 3.0))
    # 3e-16 as stated, and the roundings of (h - 3)/(h + 3) and of scipy
    np.testing.assert_allclose(found, (1.0 + 2.0 * h) * erfcx(h), rtol=3e-15)


def test_the_rough_logarithm() -> None:
    f = np.linspace(np.sqrt(0.5) - 1.0, np.sqrt(2.0) - 1.0, 2000)
    f = f[np.abs(f) > 1e-6]
    np.testing.assert_allclose(plain(expansion.rough_log1p)(f), np.log1p(f), rtol=1.01e-5)


def test_the_start_for_lamberts_function() -> None:
    y = np.geomspace(1e-3, 650.0, 2000)
    above, below = plain(expansion.lambert_start)(y)
    np.testing.assert_allclose(above / below, lambertw(np.expm1(y)).real / y, rtol=1.05e-4)


@pytest.mark.parametrize(("name", "within"), [("exp2_full", 1e-15), ("exp2_micro", 3.1e-8)])
def test_powers_of_two(name: str, within: float) -> None:
    f = np.linspace(-0.5, 0.5, 2001)
    # 1e-16 and 3e-8 as stated, and roundings
    np.testing.assert_allclose(plain(getattr(expansion, name))(f), np.exp2(f), rtol=within)
