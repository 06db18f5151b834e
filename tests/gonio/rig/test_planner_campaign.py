"""Some draws of `tools/planner_campaign.py`: its own geometry finds no collision, and no refusal without a reason."""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

import numpy as np
import pytest

from tests.places import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def campaign() -> ModuleType:
    spec = importlib.util.spec_from_file_location("planner_campaign", ROOT / "tools" / "planner_campaign.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["planner_campaign"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_random_rigs_touch_nothing_and_refuse_for_true_reasons(campaign: ModuleType) -> None:
    found = campaign.Found()
    for number in range(24):
        campaign.examine(np.random.default_rng([5, number]), found, points=3)
    assert found.wrong == []
    assert found.accepted > 20
    assert found.refused.total() > 10
    assert found.moves > 50
    assert found.worst_inverse < 1e-9
    assert found.smallest_spare_mm >= 0.0
