"""The reduction of a run of which something was lost: the rest counts."""

import numpy as np
import pandas as pd
import pytest

from gonio.errors import DataError
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from tests.command_line import some
from tests.gonio.lab.acquisition.test_repair import lose


@pytest.mark.parametrize("how", ["missing", "truncated", "changed"])
def test_reduction_leaves_out_what_is_damaged(run: Run, how: str, table: pd.DataFrame) -> None:
    before = table
    step = run.steps()[3]
    lose(run.frame_path(step.frames[0].file), how)  # of the first band
    table = brdf.reduce(run)
    row = 2 * some(step.point)
    assert table["flag"][row] == "damaged"
    assert np.isnan(table["brdf"][row])
    rest = [k for k in range(len(table)) if k != row]
    assert list(table["flag"][rest]) == list(before["flag"][rest])
    np.testing.assert_allclose(table["brdf"][rest], before["brdf"][rest], rtol=1e-12)
    (note,) = (note for note in table.attrs["notes"] if "damaged" in note)
    assert step.frames[0].file in note
    assert "--resume" in note


@pytest.mark.parametrize("number", [1, 5, 8])
def test_reduction_goes_on_without_a_visit_to_the_reference(run: Run, number: int, table: pd.DataFrame) -> None:
    before = table
    for frame in run.steps()[number].frames:
        lose(run.frame_path(frame.file), "changed")
    table = brdf.reduce(run)
    assert list(table["flag"]) == list(before["flag"])
    good = before["flag"] == ""
    # the level of two visits of three, of some 1e6 electrons each
    np.testing.assert_allclose(table["brdf"][good], before["brdf"][good], rtol=5e-3)
    assert any("4 frames are missing or damaged" in note for note in table.attrs["notes"])


def test_reduction_goes_on_with_the_dark_frames_that_are_left(run: Run, table: pd.DataFrame) -> None:
    dark = run.steps()[0].frames
    lose(run.frame_path(dark[0].file), "missing")
    assert list(brdf.reduce(run)["flag"]) == list(table["flag"])
    lose(run.frame_path(dark[1].file), "missing")  # one exposure is left
    assert any("dark frames of one exposure" in note for note in brdf.reduce(run).attrs["notes"])
    for frame in dark[2:]:
        lose(run.frame_path(frame.file), "changed")
    with pytest.raises(DataError, match=r"every dark frame .*--resume"):
        brdf.reduce(run)


def test_reduction_needs_one_visit(run: Run) -> None:
    for number in (1, 5, 8):
        for frame in run.steps()[number].frames:
            lose(run.frame_path(frame.file), "missing")
    with pytest.raises(DataError, match="no usable measurement of the white reference"):
        brdf.reduce(run)
