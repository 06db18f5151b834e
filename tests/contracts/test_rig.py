"""What every rig has to do, whoever wrote it (docs/writing_a_driver.md): `python -m pytest tests/contracts --rig R`."""

import numpy as np
import pytest

from gonio.lab.rig import Frame
from tests.contracts.conftest import begin, exposure_s, start
from tests.contracts.rigs import Case


def test_a_rig_can_be_built_and_thrown_away(case: Case) -> None:
    """`--dry-run` and `gonio rig list` do: no device is touched before a rig is entered."""
    for _ in range(2):
        assert case.build().description == case.description
    with case.build() as rig:  # nothing is held by those that were thrown away
        assert rig.time_s() >= 0


@pytest.mark.slow
def test_sample_and_reference_are_presented_in_turn(case: Case) -> None:
    with case.build() as rig:
        begin(rig, case)
        for target in ("reference", "reference", "sample"):
            rig.present(target)


def test_what_is_repeatable_gives_the_same_step_again(case: Case) -> None:
    """Whatever was done before, in another session too; other rigs must not promise it."""

    def taken(*indices: int) -> Frame:
        with case.build() as rig:
            for index in indices:
                start(rig, case, index)
                rig.light.on()
                frame = rig.camera.capture(exposure_s(case))
        return frame

    if not case.build().repeatable:
        pytest.skip("it is no simulation: it promises nothing")
    alone, after = taken(7), taken(2, 7)
    np.testing.assert_array_equal(alone.mosaic, after.mosaic)
    assert alone.time_s == after.time_s


@pytest.mark.slow
def test_arms_can_be_stopped_before_they_have_moved_and_after_the_rig_was_left(case: Case) -> None:
    """`stop` never raises."""
    with case.build() as rig:
        rig.arms.stop()
        start(rig, case)  # and they go on after it
    rig.arms.stop()
