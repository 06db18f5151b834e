"""docs/planning.md: every plan that it shows is one, and has as many points as it says."""

import re
from pathlib import Path

import pytest

from gonio.geometry import ANGLES_DEG
from tests.gonio.numpy_rig import plan_in
from tests.places import ROOT

PLANS = re.findall(r"^```toml\n(.*?)^```", (ROOT / "docs" / "planning.md").read_text(), re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("number", range(len(PLANS)))
def test_every_plan_of_the_page_is_one(number: int, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(",".join(ANGLES_DEG) + "\n45,30,45,210\n")
    plan = plan_in(tmp_path, PLANS[number])
    assert plan.points
    said = re.search(r"or count = (\d+):", PLANS[number])
    if said is not None:
        assert len(plan.points) == 2 * int(said[1])
