"""Which rows and wavelengths of a table become which channels."""

import math

import numpy as np
import pandas as pd
import pytest

from gonio.errors import ConfigError, DataError
from gonio.formats.reader import table
from gonio.renderers.channels import rows


def at(
    theta_i: float, phi_i: float, theta_r: float, phi_r: float, brdf: float = 0.1, wave: float = 550.0
) -> pd.DataFrame:
    return table(
        theta_i_deg=[theta_i], phi_i_deg=[phi_i], theta_r_deg=[theta_r], phi_r_deg=[phi_r], wavelength_nm=wave,
        brdf=[brdf], attrs={"sample": "s"},
    )  # fmt: skip


def joined(*parts: pd.DataFrame) -> pd.DataFrame:
    return pd.concat(parts, ignore_index=True)


@pytest.mark.parametrize(("asked", "found"), [(640.4, True), (639.6, True), (640.6, False), (639.4, False)])
def test_a_wavelength_is_one_of_the_table_to_half_a_nanometre(asked: float, found: bool) -> None:
    both = joined(at(30, 0, 20, 180, 0.1, 620.0), at(30, 0, 20, 180, 0.2, 640.0))
    if found:
        np.testing.assert_array_equal(rows(both, "s", wavelength_nm=asked).values, [[0.2]])
        return
    with pytest.raises(ConfigError, match=r"s has 620, 640"):
        rows(both, "s", wavelength_nm=asked)


@pytest.mark.parametrize(
    ("phi_i", "phi_r", "dphi_deg"),
    [(0.0, 180.0, 180.0), (0.0, 0.0, 0.0), (350.0, 20.0, 30.0), (20.0, 350.0, 30.0), (10.0, 250.0, 120.0)],
)
def test_the_azimuth_is_that_between_the_planes_whichever_way(phi_i: float, phi_r: float, dphi_deg: float) -> None:
    found = rows(at(30, phi_i, 20, phi_r), "s").angles
    np.testing.assert_allclose(np.rad2deg(found), [[30.0, 20.0, dphi_deg]], atol=1e-9)


def test_at_normal_incidence_of_an_aligned_rig_azimuths_count_from_the_plane_of_the_detectors() -> None:
    plane = [at(0.015, 237, theta_r, phi_r) for theta_r in (20, 40) for phi_r in (0, 180)]
    found = rows(joined(*plane, at(30, 180, 20, 0)), "s").angles
    np.testing.assert_allclose(np.sort(np.rad2deg(found[:, 2])), [0, 0, 180, 180, 180], atol=1e-9)  # rounding


@pytest.mark.parametrize(("phi_i", "said"), [(1.5, False), (181.5, False), (178.5, False), (2.5, True), (90.0, True)])
def test_planes_of_incidence_are_one_within_two_degrees_and_after_half_a_turn(phi_i: float, said: bool) -> None:
    both = joined(at(30, 0, 20, 180), at(30, phi_i, 20, phi_i + 180.0 if phi_i < 180.0 else phi_i - 180.0))
    assert any("several azimuths" in note for note in rows(both, "s").notes) is said


def test_near_the_normal_an_azimuth_of_incidence_says_nothing() -> None:
    """Below one degree: the plane of incidence turns by many degrees for one step of an encoder."""
    for theta_i, said in ((0.9, False), (1.1, True)):
        both = joined(at(30, 0, 20, 180), at(theta_i, 90, 20, 270))
        assert any("several azimuths" in note for note in rows(both, "s").notes) is said


def test_rows_at_the_horizon_and_flagged_ones_are_left_out_and_counted() -> None:
    bad = at(30, 0, 50, 180).assign(flag="blocked")
    found = rows(joined(at(30, 0, 20, 180), at(90, 0, 20, 180), at(30, 0, 90, 180), at(30, 0, 120, 0), bad), "s")
    assert len(found.values) == 1
    assert found.notes[0].startswith("4 rows are left out")
    with pytest.raises(DataError, match="no row of the table can be used"):
        rows(bad, "s")


def test_values_below_zero_become_zero_and_are_counted() -> None:
    found = rows(joined(at(30, 0, 20, 180, -0.01), at(30, 0, 25, 180, 0.0), at(30, 0, 30, 180, 0.2)), "s")
    np.testing.assert_array_equal(found.values[:, 0], [0.0, 0.0, 0.2])
    assert any(note.startswith("1 of 3 values are below zero") for note in found.notes)


def spectrum(*waves: float) -> pd.DataFrame:
    return joined(*(at(30, 0, 20, 180, 0.5 / math.pi, w) for w in waves))


@pytest.mark.parametrize(
    ("waves", "sound"),
    [((450.0, 550.0, 650.0), True), ((381.0, 550.0, 729.0), True), ((380.0, 550.0, 650.0), False),
     ((450.0, 550.0, 730.0), False), ((450.0, 550.0), False)],
)  # fmt: skip
def test_three_visible_wavelengths_make_a_colour(waves: tuple[float, ...], sound: bool) -> None:
    if sound:
        assert rows(spectrum(*waves), "s").values.shape == (1, 3)
        return
    with pytest.raises(DataError, match="make no colour"):
        rows(spectrum(*waves), "s")


def test_wavelengths_beyond_what_is_tabulated_of_the_eye_do_not_count() -> None:
    """360 to 830 nm: CIE 15."""
    inside = rows(spectrum(360.0, 450.0, 550.0, 650.0, 830.0), "s")
    beyond = rows(spectrum(340.0, 360.0, 450.0, 550.0, 650.0, 830.0, 900.0), "s")
    np.testing.assert_allclose(beyond.values, inside.values, rtol=1e-12)
    assert beyond.notes[0].startswith("linear sRGB under D65 of 5 wavelengths")


def test_directions_that_lack_a_wavelength_are_left_out_of_a_colour() -> None:
    found = rows(joined(spectrum(450.0, 550.0, 650.0), at(30, 0, 40, 180, 0.1, 450.0)), "s")
    assert len(found.values) == 1
    assert found.notes[0].startswith("1 directions are left out")
