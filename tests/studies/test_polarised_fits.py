"""Blind fits of polarised tables."""

import numpy as np
import pytest

from tools.studies import polarised_fits


@pytest.mark.slow
def test_u_is_that_of_the_fisher_information() -> None:
    found = list(polarised_fits.blind(3, 5))
    told = polarised_fits.summary(found)
    assert {b.kind for b in found} == set(polarised_fits.KINDS)
    assert told["parameters"] == 13
    # u stands at the fitted parameters, the information at the true ones: some percent apart at 1 % noise
    np.testing.assert_allclose(told["u_over_fisher"], 1.0, atol=0.1)
    assert told["rms_pull"] < 2.0  # of 13 numbers a correct one is above it once in 10^5
