"""What a fit uses of a table, and what it leaves out and why."""

from __future__ import annotations

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


def test_a_table_without_a_usable_row_is_an_error_that_says_why() -> None:
    table = measure(Lambert(0.5), incidences=(30.0,)).assign(flag="saturated")
    with pytest.raises(DataError, match=r"tile: none of its 33 rows .*33 flagged saturated"):
        observations(table, "tile")
