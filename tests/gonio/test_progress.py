"""What long work says of itself."""

import pandas as pd
import pytest
from gonio_analysis.changes.point_by_point import change
from gonio_analysis.changes.sides import Side
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.selection.compare import examine

from gonio.models import build
from gonio.progress import Pace, Stage
from tests.gonio_analysis.synthetic import joined, measure


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Every look at the clock is three seconds after the last."""
    now = [0.0]

    def look() -> float:
        now[0] += 3.0
        return now[0]

    monkeypatch.setattr("gonio.progress.time.monotonic", look)
    return now


def table(albedo: float = 0.6, seed: int = 0) -> pd.DataFrame:
    parts = [
        measure(build("oren-nayar", {"albedo": albedo, "sigma_deg": 20.0}), wavelength_nm=w, seed=seed)
        for w in (450.0, 550.0, 650.0)
    ]
    return joined(*parts)


def test_a_stage_counts_what_comes_after_it(clock: list[float]) -> None:
    said: list[str] = []
    steps = Pace("curves", 4, Stage(said.append, 20.0))
    for k in range(4):
        steps.step(k)
    assert said == ["curves: 2 of 4, about 26 s left", "curves: 3 of 4, about 23 s left"]  # 3 s a step, and 20


def test_steps_are_told_with_the_time_that_is_left(clock: list[float]) -> None:
    said: list[str] = []
    steps = Pace("drawing", 4, said.append)
    for k in range(5):
        steps.step(k)
    assert said == [
        "drawing: 2 of 4, about 6 s left",  # 3 s for the second step
        "drawing: 3 of 4, about 3 s left",
    ]


def test_what_is_done_soon_says_nothing() -> None:
    said: list[str] = []
    steps = Pace("drawing", 1000, said.append)
    for k in range(1000):
        steps.step(k)
    assert said == []


@pytest.mark.slow
def test_fits_comparisons_and_changes_tell_how_far_they_are(clock: list[float]) -> None:
    said: list[str] = []
    fit(table(), "oren-nayar", each=["albedo"], say=said.append)
    assert any(line.startswith("fitting: starts tried: ") and " left" in line for line in said)
    assert any(line.startswith("fitting: trial points: ") and "at most" in line for line in said)
    said.clear()
    a, b = (Side(n, n, frame, observations(frame)) for n, frame in (("a", table()), ("b", table(0.5, 1))))
    change(a, b, say=said.append)
    assert any(line.startswith("comparing: wavelengths: 2 of 3, about ") for line in said)
    said.clear()
    examine(table(), ["lambert", "oren-nayar"], name="clay", progress=said.append)
    assert any(line.startswith("clay: fitting oren-nayar (2 of 2") for line in said)
    assert any("wavelengths: 2 of 3, about " in line for line in said)
