"""Directions and cones against closed forms and mpmath."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio import geometry
from gonio.errors import ArgumentError

EPS = np.finfo(float).eps


@given(st.floats(1e-9, math.pi - 1e-9), st.floats(0, 2 * math.pi, exclude_max=True))
def test_angles_undo_direction(theta: float, phi: float) -> None:
    again_theta, again_phi = geometry.angles(geometry.direction(theta, phi))
    assert abs(again_theta - theta) <= 4 * EPS * math.pi  # sine and cosine carry one rounding each
    turn = abs(float(again_phi) - phi)
    # sin(phi) near pi or 2 pi is known to the rounding of phi itself
    assert min(turn, 2 * math.pi - turn) <= 16 * EPS * math.pi


def test_directions_have_shape_and_length() -> None:
    omega = geometry.direction(np.linspace(0, 1.5, 4)[:, None], np.linspace(0, 6, 5))
    assert omega.shape == (4, 5, 3)
    np.testing.assert_allclose(np.linalg.norm(omega, axis=-1), 1.0, rtol=4 * EPS)  # three roundings


@pytest.mark.parametrize(
    ("phi", "expected"), [(0.0, 0.0), (-0.0, 0.0), (2 * math.pi, 0.0), (-1e-20, 0.0), (-1.0, 2 * math.pi - 1)]
)
def test_wrap_stays_below_a_turn(phi: float, expected: float) -> None:
    wrapped = float(geometry.wrap(phi))
    assert 0 <= wrapped < 2 * math.pi
    assert wrapped == expected  # exact: one subtraction at most


def test_the_normal_has_azimuth_zero() -> None:
    theta, phi = geometry.angles([0.0, 0.0, 2.0])
    assert theta == 0.0
    assert phi == 0.0


def test_signed_angle_is_positive_on_the_mirror_side() -> None:
    np.testing.assert_array_equal(geometry.in_plane_angle([0.3, 0.3, 0.0], [math.pi, 0.0, 0.0]), [0.3, -0.3, 0.0])
    assert not np.signbit(geometry.in_plane_angle(0.0, 0.0))
    assert geometry.in_plane_angle(0.3, -math.pi) == 0.3


@pytest.mark.parametrize("half_deg", [1e-9, 1e-4, 0.5, 30.0, 90.0, 180.0])
def test_solid_angle_of_a_cone(half_deg: float) -> None:
    mpmath.mp.dps = 40
    half = math.radians(half_deg)
    exact = float(2 * mpmath.pi * (1 - mpmath.cos(mpmath.mpf(half))))
    assert float(geometry.solid_angle_of_cone(half)) == pytest.approx(exact, rel=8 * EPS)  # four roundings
    # 4 pi sin^2 is flat at half a turn: an ulp of the solid angle there is sqrt(eps) in the angle
    tolerance = 1e-7 if half_deg == 180 else 32 * EPS
    assert float(geometry.half_angle_of_cone(exact)) == pytest.approx(half, rel=tolerance)


@pytest.mark.parametrize("bad", [-0.1, 4.0, math.nan])
def test_cones_refuse_what_is_no_angle(bad: float) -> None:
    with pytest.raises(ArgumentError, match="half_angle"):
        geometry.solid_angle_of_cone(bad)
    with pytest.raises(ArgumentError, match="solid_angle_sr"):
        geometry.half_angle_of_cone(bad * 4)
