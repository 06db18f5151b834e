"""A rig is dark before and after its use, whatever ends it."""

import pytest

from gonio.errors import DeviceError
from gonio.lab.rig import Rig
from tests.contracts.conftest import begin
from tests.contracts.rigs import Case


class Stopped(Exception):
    """Something goes wrong while the rig is open."""


def light_up(rig: Rig, case: Case) -> None:
    begin(rig, case)
    rig.light.select(case.description.bands.all()[0])
    rig.light.on()
    assert case.is_seen(lit=True)


def test_a_rig_is_dark_when_it_is_entered_and_when_it_is_left(case: Case) -> None:
    with case.build() as rig:
        assert case.is_seen(lit=False)
        light_up(rig, case)
    assert case.is_seen(lit=False)


@pytest.mark.slow
@pytest.mark.parametrize("error", [Stopped, KeyboardInterrupt, DeviceError])
def test_a_rig_is_left_dark_whatever_ends_it(case: Case, error: type[BaseException]) -> None:
    def fail() -> None:
        with case.build() as rig:
            light_up(rig, case)
            raise error("of the test")

    with pytest.raises(error, match="of the test"):
        fail()
    assert case.is_seen(lit=False)
