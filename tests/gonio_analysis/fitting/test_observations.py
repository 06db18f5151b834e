"""What a fit uses of a table, and what it leaves out and why."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
import pytest
from gonio_analysis.fitting.observations import observations

from gonio.errors import DataError
from gonio.models import Lambert
from tests.gonio_analysis.synthetic import measure


def test_every_row_that_is_left_out_is_counted_by_its_reason() -> None:
    table = measure(Lambert(0.5), incidences=(30.0,))
    rows = table.index.to_numpy()
    table["flag"] = np.where(rows == 0, "blocked", table["flag"])
    table["polarisation"] = np.where(rows == 1, "ss", table["polarisation"])
    table["brdf"] = np.where(rows == 2, np.nan, table["brdf"])
    table["theta_r_deg"] = np.where(rows == 3, 90.0, table["theta_r_deg"])
    table.loc[4, ["u_brdf", "u_random"]] = np.nan
    used = observations(table)
    assert list(used.rows) == [r for r in rows if r > 4]
    reasons = ("flagged blocked", "polarised", "without a value", "at the horizon", "without an uncertainty")
    assert used.left_out == dict.fromkeys(reasons, 1)
    np.testing.assert_array_equal(used.brdf, table["brdf"].to_numpy()[5:])
    np.testing.assert_array_equal(used.directions.theta_r, np.radians(table["theta_r_deg"].to_numpy()[5:]))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([4], "1 row states no uncertainty .* row 5 of the table"),
        ([1, 3], "2 rows state no uncertainty .* rows 2, 4 of the table"),
        (range(13), r"13 rows state .* rows 1, 2, .*, 12, \.\.\. of the table"),
    ],
)
def test_rows_without_an_uncertainty_are_listed_as_a_person_counts_them(rows: Iterable[int], said: str) -> None:
    table = measure(Lambert(0.5), incidences=(30.0,))
    table.loc[list(rows), ["u_brdf", "u_random"]] = np.nan
    assert any(re.search(said, note) for note in observations(table).notes)


def test_a_table_without_a_usable_row_is_an_error_that_says_why() -> None:
    table = measure(Lambert(0.5), incidences=(30.0,)).assign(flag="saturated")
    with pytest.raises(DataError, match=r"tile: none of its 33 rows .*33 flagged saturated"):
        observations(table, "tile")
