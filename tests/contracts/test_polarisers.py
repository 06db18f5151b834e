"""What every polariser has to do, on rigs whose files name some."""

import math

import pytest

from gonio.errors import ConfigError
from gonio.lab.rig import Rig
from gonio.lab.rig.polariser_axes import opened
from tests.contracts.conftest import STANDS_DEG, off_deg
from tests.contracts.rigs import Case


@pytest.mark.slow
def test_axes_turn_all_the_way_and_no_arm_with_them(case: Case, rig: Rig) -> None:
    here = rig.arms.read()
    for polariser in opened(rig).values():
        for azimuth_deg in (-90.0, 0.0, 37.5, 37.5, 90.0):
            polariser.select("linear", math.radians(azimuth_deg))
    assert off_deg(rig.arms.read(), here, case) < STANDS_DEG


@pytest.mark.slow
def test_what_the_rig_file_does_not_promise_is_refused(case: Case, rig: Rig) -> None:
    for side, polariser in opened(rig).items():
        mount = case.description.polarisers.on(side)
        assert mount is not None
        for state in ("u", "r", "l"):
            if mount.refusal(state):
                with pytest.raises(ConfigError, match=f'polarisers.{side}.*"{state}"'):
                    polariser.select(state)
            else:
                polariser.select(state)
