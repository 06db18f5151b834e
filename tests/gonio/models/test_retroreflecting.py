"""The retroreflected lobe against 50 digits, and over the hemisphere."""

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.instrument import apparent_brdf
from gonio.models import Retroreflecting, hemispherical

PI = math.pi
EPS = float(np.finfo(float).eps)
polar = st.floats(0.0, 1.57)
azimuths = st.floats(-6.3, 6.3)
lobes = st.builds(Retroreflecting, st.floats(0.0, 1.0), st.floats(0.1, 60.0), st.floats(0.5, 10.0), st.floats(0.0, 5.0))


def exact(at: tuple[float, float, float, float], w_deg: float, tail: float, entrance: float) -> Any:
    """The lobe in 50 digits, normalised by a quadrature over the observation angle."""
    with mpmath.workdps(50):
        ti, pi_, tr, pr = (mpmath.mpf(x) for x in at)
        w, tail, entrance = mpmath.radians(mpmath.mpf(w_deg)), mpmath.mpf(tail), mpmath.mpf(entrance)

        def shape(x: Any) -> Any:
            return (1 + x / w**2) ** -tail

        # solid angle is pi d(x), x = |V - L|^2; in ln(1 + x/w^2) the integrand is smooth
        span = mpmath.linspace(0, mpmath.log(1 + 4 / w**2), 9)
        whole = mpmath.pi * mpmath.quad(lambda t: w**2 * mpmath.exp(t) * shape(w**2 * mpmath.expm1(t)), span)
        a, b = mpmath.cos(ti), mpmath.cos(tr)
        x = 2 - 2 * (a * b + mpmath.sin(ti) * mpmath.sin(tr) * mpmath.cos(pr - pi_))
        return shape(x) / whole * (a * b) ** entrance / (a + b - a * b)


@pytest.mark.parametrize(
    ("w", "tail", "entrance"), [(2.0, 1.5, 0.0), (0.05, 1.0, 0.7), (20.0, 6.0, 2.0), (1.0, 0.6, 1)]
)
@pytest.mark.parametrize(
    "at", [(0.7, 0.3, 0.7, 0.3), (0.7, 0.3, 0.7001, 0.3), (0.2, 0.0, 1.3, 2.0), (1.57, 0.0, 1.0, 0.1), (0, 0, 0, 0)]
)
def test_the_kernel_in_50_digits(at: tuple[float, float, float, float], w: float, tail: float, entrance: float) -> None:
    got = float(Retroreflecting(1.0, w, tail, entrance).brdf(*at))
    # |V - L| is uncertain by eps, D by tail/w of it; and the powers by their logarithms
    moved = tail / math.radians(w) + 30.0 * tail + entrance * (8.0 + 1.0 / math.cos(max(at[0], at[2])))
    assert got == pytest.approx(float(exact(at, w, tail, entrance)), rel=8.0 * EPS * (4.0 + moved))


@given(lobes, st.floats(0.0, PI / 2))
def test_no_more_is_returned_than_its_share(lobe: Retroreflecting, theta: float) -> None:
    assert lobe.directional_hemispherical(theta, tolerance=1e-4) <= lobe.returned * (1.0 + 1e-4)
    assert not lobe.depends_on_azimuth


@pytest.mark.parametrize("lobe", [Retroreflecting(1.0, 2.0, 1.0, 0.5), Retroreflecting(0.4, 30.0, 5.0, 0.3, 0.5)])
def test_over_observation_angles_and_over_directions(lobe: Retroreflecting) -> None:
    theta = np.radians([0.0, 8.0, 60.0, 85.0])
    got = lobe.directional_hemispherical(theta)
    other = hemispherical.over_directions(lobe, theta, np.zeros(4), 550.0, False, tolerance=1e-6)
    np.testing.assert_allclose(got, other, rtol=2e-6)  # the other rule's
    np.testing.assert_array_equal(lobe.hemispherical_directional(theta), got)


def test_a_narrow_lobe_returns_what_the_denominator_leaves() -> None:
    theta = np.radians([0.0, 30.0, 60.0])
    c = np.cos(theta)
    got = Retroreflecting(1.0, 1e-5, 2.0).directional_hemispherical(theta)
    np.testing.assert_allclose(got, 1.0 / (2.0 - c), rtol=1e-6)  # D cos/(c (2 - c)), and tails of the order of w


def test_exactly_grazing() -> None:
    assert Retroreflecting(0.5, 1.0).brdf(PI / 2, 0.0, PI / 2, 0.1) == math.inf
    assert Retroreflecting(0.5, 1.0, entrance=1.0).brdf(PI / 2, 0.0, PI / 2, 0.1) < 1e-140  # the limit's 0
    near = Retroreflecting(0.5, 1.0).brdf(PI / 2 - 1e-12, 0.0, 1.5, 0.1)
    assert Retroreflecting(0.5, 1.0).brdf(PI / 2, 0.0, 1.5, 0.1) == pytest.approx(near, rel=1e-10)


@pytest.mark.parametrize(("width_deg", "rel"), [(3.0, 1e-6), (0.3, 1e-5), (0.02, 1e-3)])
def test_through_cones(width_deg: float, rel: float) -> None:
    """Lobes wider and narrower than the cones, against random directions in both caps."""
    lobe = Retroreflecting(1.0, width_deg, 2.0)
    theta, half = 0.5, math.radians(0.5)
    omega = 2.0 * PI * (1.0 - math.cos(half))
    got = apparent_brdf(lobe, theta, 0.0, theta + 0.2 * half, 0.0, source_solid_angle_sr=omega,
                        receiver_solid_angle_sr=omega)  # fmt: skip
    rng = np.random.default_rng(2)
    n = 1 << 20
    z, turn = 1.0 - (1.0 - math.cos(half)) * rng.random((2, n)), 2.0 * PI * rng.random((2, n))
    x, y = np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn)
    sides = []
    for k, t in enumerate((theta, theta + 0.2 * half)):
        sides.append(
            np.stack([x[k] * math.cos(t) + z[k] * math.sin(t), y[k], z[k] * math.cos(t) - x[k] * math.sin(t)], 1)
        )
    values = lobe.brdf_vectors(*sides)
    drawn, spread = float(values.mean()), float(values.std()) / math.sqrt(n)
    assert abs(got - drawn) < rel * drawn + 4.0 * spread  # by chance once in 16 000
