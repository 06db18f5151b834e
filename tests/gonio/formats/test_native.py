"""Our own tables: which values are allowed, each limit from both sides, and the covariance in factors."""

import math
import re
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio.errors import DataError
from gonio.formats.native import check, checked_attributes, plain, uncertainty
from gonio.formats.reader import table


def rows(**changes: Any) -> pd.DataFrame:
    """Two rows that are sound, and changes of the second one."""
    frame = table(
        theta_i_deg=[30.0, 30.0], phi_i_deg=0.0, theta_r_deg=[20.0, 40.0], phi_r_deg=180.0, wavelength_nm=550.0,
        brdf=[0.3, 0.2], attrs={"sample": "s"},
    ).assign(u_brdf=0.02, u_random=0.01)  # fmt: skip
    for column, value in changes.items():
        usual = "reflection" if column == "side" else 0.0
        first = frame[column].iloc[0] if column in frame else usual
        frame[column] = pd.Series([first, value], dtype=object if isinstance(value, str) else None)
    return frame


def checked(frame: pd.DataFrame) -> None:
    check(frame, lambda row: f"row {row}")


@pytest.mark.parametrize(
    ("column", "good", "bad"),
    [
        ("theta_i_deg", (0.0, 90.0), (-0.001, 90.001, math.nan)),
        ("theta_r_deg", (0.0, 90.0), (-0.001, 90.001, math.nan)),
        ("phi_i_deg", (0.0, 359.999), (-0.001, 360.0, math.nan)),
        ("phi_r_deg", (0.0, 359.999), (-0.001, 360.0, math.nan)),
        ("wavelength_nm", (100.0, 2e5, math.nan), (0.0, -1.0, 0.55, 10.6, 2.01e5, math.inf)),
        ("brdf", (-1.0, 0.0, 1e9), (math.nan, math.inf)),
        ("u_brdf", (0.01, 1.0, math.nan), (-0.1, math.inf)),
        ("u_random", (0.0, 0.02, math.nan), (-0.1, math.inf)),
        ("polarisation", ("unpolarised", "sp"), ("x", "")),
        ("s_scale", (-1.0, 0.0, 1.0), (math.nan, math.inf)),
        ("m01", (-1.0, 2.0, math.nan), (math.inf, -math.inf)),
        ("u_m01", (0.0, 2.0, math.nan), (-0.1, math.inf)),
        ("u_angles", (0.0, 2.0, math.nan), (-0.1, math.inf)),
        ("side", ("reflection",), ("beside", "transmission")),  # of which theta_r is beyond 90
    ],
)
def test_each_column_has_its_values(column: str, good: tuple[Any, ...], bad: tuple[Any, ...]) -> None:
    for value in good:
        checked(rows(**{column: value}))
    for value in bad:
        with pytest.raises(DataError, match=r"^row 1: "):
            checked(rows(**{column: value}))


def test_a_part_of_an_uncertainty_is_no_larger_than_the_whole() -> None:
    checked(rows(u_random=0.02))
    with pytest.raises(DataError, match=r"row 1: u_random = 0\.021; a part of the combined u_brdf"):
        checked(rows(u_random=0.021))


@pytest.mark.parametrize(
    ("column", "value"),
    [("brdf", math.nan), ("u_brdf", -0.1), ("u_random", 0.5), ("s_scale", math.nan)],
)
def test_a_flagged_row_needs_no_values(column: str, value: float) -> None:
    with pytest.raises(DataError):
        checked(rows(**{column: value}))
    checked(rows(**{column: value}).assign(flag=["", "blocked"]))


@pytest.mark.parametrize(("theta_r", "sound"), [(90.0, False), (90.001, True), (180.0, True), (180.001, False)])
def test_transmission_lies_behind_the_sample(theta_r: float, sound: bool) -> None:
    frame = rows(theta_r_deg=theta_r, side="transmission")
    if sound:
        checked(frame)
        return
    with pytest.raises(DataError, match="row 1: theta_r_deg"):
        checked(frame)


def test_many_causes_are_looked_at_to_the_last() -> None:
    frame = rows()
    many = pd.DataFrame({f"s_{k}": [0.0, 0.0] for k in range(200)})
    many.loc[1, "s_150"] = math.nan
    with pytest.raises(DataError, match=r"row 1: s_150 = nan"):
        checked(pd.concat([frame, many], axis=1))


def test_a_table_without_rows_is_none() -> None:
    with pytest.raises(DataError, match="has no rows"):
        checked(rows().iloc[:0])


# ---- attributes ----


@pytest.mark.parametrize(
    ("value", "sound"), [(None, True), (0, True), (0.1, True), (6.28, True), (6.29, False), (-0.1, False),
                         (True, False), ("wide", False)],
)  # fmt: skip
def test_a_solid_angle_is_that_of_half_a_space_at_most(value: Any, sound: bool) -> None:
    for key in ("source_solid_angle_sr", "receiver_solid_angle_sr"):
        if sound:
            checked_attributes({key: value}, "t.meta.json")
            continue
        with pytest.raises(DataError, match=re.escape(f"t.meta.json: {key} is {value!r}; a solid angle")):
            checked_attributes({key: value}, "t.meta.json")


@pytest.mark.parametrize(("key", "value"), [("notes", "one"), ("bands", {}), ("sample", 3), ("provenance", [])])
def test_attributes_are_of_their_kinds(key: str, value: Any) -> None:
    with pytest.raises(DataError, match=f"t: {key} is"):
        checked_attributes({key: value}, "t")
    with pytest.raises(DataError, match="an object of attributes"):
        checked_attributes([], "t")


def test_attributes_become_plain() -> None:
    value = {1: np.array([1.5, 2.5]), "a": (np.float64(0.5), [np.int64(3)])}
    assert plain(value) == {"1": [1.5, 2.5], "a": [0.5, [3]]}


# ---- uncertainties ----


def test_the_covariance_is_that_of_its_parts() -> None:
    frame = rows().assign(u_random=[0.01, math.nan], u_brdf=[0.5, 0.05], s_scale=[0.03, -0.03], s_zero=[0.0, 0.02])
    u, common, causes = uncertainty(frame)
    assert causes == ["scale", "zero"]
    # what is not stated is what the causes leave of the combined one
    np.testing.assert_allclose(u, [0.01, math.sqrt(0.05**2 - 0.03**2 - 0.02**2)], rtol=1e-12)
    np.testing.assert_array_equal(common, [[0.03, 0.0], [-0.03, 0.02]])


def test_causes_larger_than_the_whole_leave_nothing() -> None:
    u, _, _ = uncertainty(rows().assign(u_random=math.nan, u_brdf=0.02, s_scale=0.03))
    np.testing.assert_array_equal(u, [0.0, 0.0])
    u, common, causes = uncertainty(rows().assign(u_random=math.nan))
    np.testing.assert_array_equal(u, 0.02)
    assert (common.shape, causes) == ((2, 0), [])
