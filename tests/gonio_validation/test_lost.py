"""What fails late is named on every page of validation; its numbers and tables are there."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.report import frame
from gonio_analysis.report.drawing import Drawing
from gonio_maps.report import map_change
from gonio_validation import verify
from gonio_validation.bench import speed_and_error
from gonio_validation.papers.pictures import page as pictures

from gonio.errors import Incomplete
from tests.gonio_analysis.report import test_frame

Patch = pytest.MonkeyPatch


def bench_of_models(folder: Path, patch: Patch) -> object:
    patch.setattr(speed_and_error, "collect", lambda **given: test_frame.told_of_models(ways=3))
    return speed_and_error.make(folder)


def papers_pictures(folder: Path, patch: Patch) -> object:
    dark = np.zeros((40, 60, 3), np.uint8)
    patch.setattr(pictures, "_rendered", lambda folder, wanted, step: (dict.fromkeys(wanted, dark), {"claims": 1.0}))
    patch.setattr(pictures, "claims", lambda name: [])
    patch.setattr("gonio_validation.papers.pictures.cook_torrance.ambient_as_printed", lambda height: 1.0)
    return pictures.make(folder, figure="oren-nayar-13")


def a_verification(folder: Path, patch: Patch) -> object:
    return verify.make(folder, test_frame.told_of_verification())


def two_maps(folder: Path, patch: Patch) -> object:
    patch.setattr("gonio.platform.processors", lambda: 1)  # another process would not know the fault
    own = folder.with_name("maps")
    own.mkdir()
    return map_change.make([str(test_frame.fitted(own, "a")), str(test_frame.fitted(own, "b", 0.2))], folder)


DRAWN = (bench_of_models, papers_pictures, two_maps)


@pytest.mark.parametrize(
    ("make", "broken"),
    [*((make, "rendered") for make in DRAWN), *((make, "page") for make in (*DRAWN, a_verification))],
)
def test_a_page_without_what_fails(
    make: Callable[[Path, Patch], Any], broken: str, tmp_path: Path, monkeypatch: Patch
) -> None:
    def fails(*given: object, **more: object) -> None:
        raise ZeroDivisionError("late")

    folder = tmp_path / "out"
    monkeypatch.setattr(Drawing if broken == "rendered" else frame, broken, fails)
    with pytest.raises(Incomplete, match="ZeroDivisionError: late"):
        make(folder, monkeypatch)
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "What is missing" in page
    assert ("<details" in page) == (broken == "rendered")
    numbers = next(path for path in folder.iterdir() if path.name in ("summary.json", "results.json"))
    told = json.loads(numbers.read_text(encoding="utf-8"))
    assert "ZeroDivisionError: late" in [one["error"] for one in told.pop("failed")]
    assert len(told) > 2
