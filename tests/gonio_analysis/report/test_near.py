"""Names of a choice meet a page that shows fewer models: what the page says of a model has to be in its own numbers."""

from dataclasses import replace
from pathlib import Path

import pytest
from gonio_analysis import report
from gonio_analysis.report.text import percent
from gonio_analysis.selection.compare import Dataset, examine

from gonio.models import build
from tests.gonio_analysis.synthetic import measure

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def hidden() -> Dataset:
    """Of three models that noise of 20 % cannot tell apart the page shows all but one, as `--models all` does of sums
    and of a model's second form.
    """
    frame = measure(build("lambert", {"albedo": 0.5}), incidences=(20.0, 65.0), noise=0.2, floor=0.0)
    frame[["u_brdf", "u_random"]] = float("nan")
    whole = examine(frame, ["lambert", "oren-nayar", "phong"], name="matte")
    assert set(whole.choice.near) == set(whole.models)
    shown = {name: one for name, one in whole.models.items() if name != "phong"}
    return replace(whole, models=shown)


def test_a_page_speaks_of_models_that_it_does_not_show(hidden: Dataset, tmp_path: Path) -> None:
    summary = report.write([hidden], tmp_path, title="matte")
    (facts,) = summary.datasets
    assert "phong" in facts.choice.near
    assert "phong" not in facts.models
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    shares = [r.unmeasured for r in facts.rho_dh_near["phong"] if r.unmeasured]
    assert shares, "in plane alone little of the hemisphere is seen"
    assert "Of the light that phong reflects" in page
    assert percent(max(shares)) in page.replace("\u00a0", " ")


def test_the_reflectances_together_hold_those_of_models_that_are_not_shown(hidden: Dataset) -> None:
    whole = examine(hidden.table, ["lambert", "oren-nayar", "phong"], name="matte")
    assert hidden.rho_dh_combined == whole.rho_dh_combined
    assert list(hidden.rho_dh_near) == list(hidden.choice.near)
