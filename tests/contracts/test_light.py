"""What every lamp has to do."""

import pytest

from gonio.lab.rig import Rig
from tests.contracts.rigs import Case


@pytest.mark.slow
def test_every_band_can_be_selected_in_the_dark_and_lit(case: Case, rig: Rig) -> None:
    bands = case.description.bands.all()
    for band in {bands[0], bands[len(bands) // 2], bands[-1]}:
        rig.light.off()
        rig.light.select(band)
        assert case.is_seen(lit=False)
        rig.light.on()
        assert case.is_seen(lit=True)
