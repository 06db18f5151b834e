"""Spectra of scene files, and pixels whose noise was cut off."""

import numpy as np
import pytest
from gonio_scenes.exposures import _piled
from pydantic import ValidationError

from gonio.spectra import Spectrum


@pytest.mark.parametrize(("wavelengths", "values"), [((400.0, 500.0), (1.0,)), ((400.0,), (1.0, 2.0)), ((), ())])
def test_wavelengths_and_values_go_together(wavelengths: tuple[float, ...], values: tuple[float, ...]) -> None:
    with pytest.raises(ValidationError, match="they go together, and there must be one at least"):
        Spectrum(wavelength_nm=wavelengths, value=values)


def test_noise_is_cut_off_where_an_end_has_more_pixels_than_the_value_inside_it() -> None:
    assert not _piled(np.repeat([0.0, 1.0], [400, 400]), 0.0, 1.0, 1.0)
    assert not _piled(np.repeat([0.0, 1.0], [430, 370]), 0.0, 1.0, 1.0)  # 60 of sqrt(800) = 28: two sigma
    assert _piled(np.repeat([0.0, 1.0], [500, 300]), 0.0, 1.0, 1.0)
    assert not _piled(np.repeat([0.0, 1.0], [500, 300]), 0.0, 1.0, 0.1)  # hardly any noise: one value holds all
