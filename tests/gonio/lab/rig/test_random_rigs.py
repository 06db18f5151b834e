"""Random rigs: an independent look finds no collision, and no refusal without a reason."""

import numpy as np
import pytest

from tests.gonio.lab.rig.independent_planner import Found, examine

pytestmark = pytest.mark.slow


def test_random_rigs_touch_nothing_and_refuse_for_true_reasons() -> None:
    found = Found()
    for number in range(24):
        examine(np.random.default_rng([5, number]), found, points=3)
    assert found.wrong == []
    assert found.accepted > 20
    assert found.refused.total() > 10
    assert found.moves > 50
    assert found.worst_inverse < 1e-9
    assert found.smallest_spare_mm >= 0.0
