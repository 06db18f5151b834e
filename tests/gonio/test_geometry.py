"""Directions and cones against closed forms and mpmath."""

import math

import mpmath
import numpy as np
import pandas as pd
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
    assert (float(theta), float(phi)) == (0.0, 0.0)


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
    assert float(geometry.half_angle_of_cone(exact)) == pytest.approx(half, rel=1e-7 if half_deg == 180 else 32 * EPS)


@pytest.mark.parametrize("bad", [-0.1, 4.0, math.nan])
def test_cones_refuse_what_is_no_angle(bad: float) -> None:
    with pytest.raises(ArgumentError, match="half_angle"):
        geometry.solid_angle_of_cone(bad)
    with pytest.raises(ArgumentError, match="solid_angle_sr"):
        geometry.half_angle_of_cone(bad * 4)


def _vector(theta: mpmath.mpf, phi: mpmath.mpf) -> mpmath.matrix:
    return mpmath.matrix([mpmath.sin(theta) * mpmath.cos(phi), mpmath.sin(theta) * mpmath.sin(phi), mpmath.cos(theta)])


def _exact(d: geometry.Directions) -> dict[str, float]:
    """What follows from one pair of directions, from dot products in 60 digits: there an arccos loses nothing."""
    with mpmath.workdps(60):
        theta_i, phi_i, theta_r, phi_r = (mpmath.mpf(a) for a in d.floats)
        source, detector = _vector(theta_i, phi_i), _vector(theta_r, phi_r)
        x, y = _vector(mpmath.pi / 2, phi_i), _vector(mpmath.pi / 2, phi_i + mpmath.pi / 2)

        def dot(a: mpmath.matrix, b: mpmath.matrix) -> mpmath.mpf:
            return min(max(mpmath.fsum(p * q for p, q in zip(a, b, strict=True)), -1), 1)

        mirror = mpmath.matrix([-source[0], -source[1], source[2]])
        half = source + detector
        half /= mpmath.norm(half)
        return {
            "mirror_offset": float(mpmath.acos(dot(mirror, detector))),
            "out_of_plane": float(mpmath.asin(dot(detector, y))),
            "along": float(mpmath.atan2(-dot(detector, x), detector[2])),
            "theta_h": float(mpmath.acos(half[2])),
            "theta_d": float(mpmath.acos(dot(half, source))),
        }


def _found(d: geometry.Directions) -> dict[str, float]:
    theta_h, theta_d = d.half
    return {name: float(getattr(d, name)) for name in ("mirror_offset", "out_of_plane", "along")} | {
        "theta_h": float(theta_h),
        "theta_d": float(theta_d),
    }


CLOSE = [1e-3, 1e-6, 1e-9, 1e-12]
HARD = [
    *(geometry.Directions(a, 0.3, 0.5 * a, 2.0) for a in CLOSE),  # both near the normal
    *(geometry.Directions(0.7, 0.3, 0.7 + a, 0.3 + math.pi - a) for a in CLOSE),  # near the mirror direction
    *(geometry.Directions(0.7, 0.3, 0.7 - a, 0.3 + a) for a in CLOSE),  # near retro-reflection
    *(geometry.Directions(math.pi / 2 - a, 0.3, math.pi / 2 - 2 * a, 1.9) for a in CLOSE),  # both near grazing
    *(geometry.Directions(0.4, 1.0, 1.2, 1.0 + math.pi / 2 + a) for a in CLOSE),  # far out of the plane
    *(geometry.Directions(0.4, 1.0, math.pi / 2 - a, 1.0 + math.pi / 2) for a in CLOSE),  # along the plane's normal
]


@pytest.mark.parametrize("d", HARD, ids=lambda d: ", ".join(f"{a:.12g}" for a in d.floats))
def test_what_follows_from_directions_keeps_its_digits_near_normal_mirror_retro_and_grazing(
    d: geometry.Directions,
) -> None:
    exact, found = _exact(d), _found(d)
    for name, value in exact.items():
        # components of unit vectors are known to a rounding or two, of azimuths up to 2 pi to four of theirs; where
        # the half vector or the projection on the plane is short, that is a larger angle
        short = {"along": math.cos(exact["out_of_plane"]), "theta_h": math.cos(exact["theta_d"])}.get(name, 1.0)
        assert abs(found[name] - value) <= 8 * EPS * (1.0 + abs(value)) / max(short, 1e-12), name
    np.testing.assert_allclose(np.linalg.norm(d.from_mirror), 2 * math.sin(exact["mirror_offset"] / 2), atol=16 * EPS)


directions = st.tuples(
    st.floats(0, math.pi / 2), st.floats(0, 2 * math.pi), st.floats(0, math.pi / 2), st.floats(0, 2 * math.pi)
)


@given(st.floats(0, math.pi / 2), st.floats(0, 2 * math.pi), st.floats(-math.pi / 2, math.pi / 2))
def test_in_the_plane_of_incidence_along_and_signed_are_one_angle(theta_i: float, phi_i: float, signed: float) -> None:
    d = geometry.Directions(theta_i, phi_i, abs(signed), phi_i + math.pi * (signed > 0))
    assert float(d.signed) == signed
    assert float(d.along) == pytest.approx(signed, abs=16 * EPS * math.pi)  # phi_i + pi is rounded
    assert bool(d.in_plane)
    assert float(d.mirror_offset) == pytest.approx(abs(signed - theta_i), abs=16 * EPS * math.pi)


def test_in_plane_is_an_angle_and_no_azimuth() -> None:
    away = np.array([0.99, 1.01])
    d = geometry.Directions(0.5, 0.0, math.pi / 2, math.pi + away * geometry.IN_PLANE)
    np.testing.assert_array_equal(d.in_plane, [True, False])
    across = geometry.Directions(0.5, 0.0, away * geometry.IN_PLANE, math.pi / 2)  # near the normal
    np.testing.assert_array_equal(across.in_plane, [True, False])


def test_directions_of_a_table_of_degrees_and_of_vectors_are_the_same() -> None:
    table = pd.DataFrame(
        {"theta_i_deg": [10, 0], "phi_i_deg": [350.0, 0], "theta_r_deg": [20.0, 90], "phi_r_deg": [170.0, 45]}
    )
    d = geometry.Directions.from_table(table)
    np.testing.assert_allclose(np.degrees(d.dphi), [180.0, 45.0], rtol=4 * EPS)
    np.testing.assert_allclose(geometry.Directions.from_vectors(*d.vectors).angles, d.angles, atol=4 * EPS * math.pi)
    one = geometry.Directions.from_degrees(10, 350, 20, 170)
    assert one.floats == d[0].floats == next(iter(d)).floats
    assert [x.floats for x in geometry.Directions.stack([one, d[1]])] == [x.floats for x in d]
    assert len(geometry.Directions.stack([])) == 0


def test_directions_broadcast_and_are_chosen_by_rows() -> None:
    d = geometry.Directions(0.5, 0.0, np.array([0.1, 0.2, 0.3]), math.pi)
    assert (d.shape, len(d)) == ((3,), 3)
    some = d[np.array([False, True, True])]
    np.testing.assert_array_equal(some.theta_i, [0.5, 0.5])
    np.testing.assert_array_equal(some.signed, [0.2, 0.3])
    np.testing.assert_array_equal(d.seen_from(math.pi).signed, [-0.1, -0.2, -0.3])
    np.testing.assert_array_equal(d.swapped.signed, [0.5, 0.5, 0.5])
    np.testing.assert_allclose(d.turned(1.0).out_of_plane, d.out_of_plane, atol=4 * EPS)


def test_overlap_of_discs_by_counting() -> None:
    x, y = np.meshgrid(np.linspace(-1.0, 3.0, 2001), np.linspace(-2.0, 2.0, 2001))
    for apart, a, b in ((0.0, 1.0, 0.5), (0.8, 1.0, 0.5), (1.2, 1.0, 1.0), (1.49, 0.5, 1.0), (1.6, 0.5, 1.0)):
        shared = np.mean((np.hypot(x, y) < a) & (np.hypot(x - apart, y) < b)) * 16.0
        # a grid of 0.002 counts an outline of length 6 to some 1e-4
        assert geometry.overlap_of_discs(apart, a, b) == pytest.approx(shared / (math.pi * min(a, b) ** 2), abs=3e-3)
    np.testing.assert_array_equal(geometry.overlap_of_discs([0.5, 1.0, 1.1], 0.0, 1.0), [1.0, 1.0, 0.0])
    assert geometry.overlap_of_discs([0.0, 0.4, 0.6], 0.3, 0.3).tolist()[::2] == [1.0, 0.0]
