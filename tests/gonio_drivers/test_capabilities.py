"""What a rig may offer beside `Rig` is offered by the simulated and by the laboratory's rig."""

import pytest
from gonio_drivers.lab import LabRig
from gonio_sim.rig import SimulatedRig

from gonio.lab.rig.protocols import Holds, Jogs, OpensSome, Surveys, TellsHealth


@pytest.mark.parametrize("rig", [LabRig, SimulatedRig])
def test_both_rigs_have_each_capability(rig: type) -> None:
    assert issubclass(rig, Holds)
    assert issubclass(rig, Jogs)
    assert issubclass(rig, OpensSome)
    assert issubclass(rig, Surveys)
    assert issubclass(rig, TellsHealth)
    assert not issubclass(object, Holds)
