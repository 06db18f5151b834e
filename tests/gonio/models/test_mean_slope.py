"""Oren and Nayar's exact form with a mean slope: the paper's equations integrated another way, and its two limits."""

import math

import numpy as np
import pytest

from gonio.models import OrenNayar
from gonio.models.forms import ModelDirections, forms
from gonio.models.plain import oren_nayar
from gonio.models.plain.vectors import direction, dot
from gonio.typing import Floats

PI = math.pi
# degrees: one along the normal, retro, generic, beside the mirror direction, grazing, both grazing
PLACES = [
    (0.0, 65.0, 0.0),
    (60.0, 60.0, 0.0),
    (40.0, 70.0, 110.0),
    (75.0, 75.2, 179.9),
    (89.5, 30.0, 50.0),
    (88.0, 87.0, 170.0),
    (87.0, 88.5, 4.0),
]

STEP = 0.12


def tanh_sinh(edges: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights (..., n) over the intervals between edges (..., k), by steps of STEP."""
    t = STEP * np.arange(-int(3.2 / STEP), int(3.2 / STEP) + 1)
    x, w = np.tanh(PI / 2 * np.sinh(t)), STEP * PI / 2 * np.cosh(t) / np.cosh(PI / 2 * np.sinh(t)) ** 2
    half = 0.5 * np.diff(edges)[..., np.newaxis]
    nodes = edges[..., :-1, np.newaxis] + half * (1.0 + x)
    return nodes.reshape(*edges.shape[:-1], -1), (half * w).reshape(*edges.shape[:-1], -1)


def twice(s: Floats, v: Floats, a: Floats, opposite: Floats, rho: float) -> Floats:
    """Eqs. 9 to 11, with d^2 = (x - y)^2 + 4 x y cos^2(theta_a), which loses nothing where grooves are steep."""
    c = a[..., 2]

    def d(x: Floats | int, y: Floats | int) -> Floats:
        return np.asarray(np.sqrt((x - y) ** 2 + 4 * x * y * c * c))

    seen, lit = (np.maximum(dot(*pair), 1e-300) for pair in ((v, a), (s, opposite)))
    m_v, m_s = np.minimum(1, 2 * v[2] * c / seen), np.minimum(1, 2 * s[2] * c / lit)
    both = PI / 2 * (d(1, 1 - m_v) + d(1, 1 - m_s) - d(1 - m_s, 1 - m_v) - d(1, 1))
    return np.asarray((rho / PI) ** 2 * seen * lit / (c * v[2]) * both)


def integrated(at: tuple[float, float, float], sigma: float, mu: float, rho: float) -> float:
    """Eqs. 5 to 13 with P of sec. 3.3, by tanh-sinh rules between all kinks in theta_a and phi_a; radians."""
    theta_i, theta_r, delta = at
    s, v = direction(theta_i, 0.0), direction(theta_r, delta)
    ti, tr = math.tan(theta_i), math.tan(theta_r)
    # tan(theta_i) cos(phi_a) = +-tan(theta_r) cos(phi_a - delta)
    turns = [math.atan2(ti - e * tr * math.cos(delta), e * tr * math.sin(delta)) for e in (1.0, -1.0)]
    steep = [ti, tr, *(abs(ti * math.cos(turn)) for turn in turns)]
    # P is below 1e-14 of its largest value beyond 8 sigma; the rest only keeps intervals short
    slopes = [PI / 2 - math.atan(x) for x in steep] + [mu + k * sigma for k in range(-8, 9, 4)]
    low, high = max(mu - 8 * sigma, 0.0), min(mu + 8 * sigma, PI / 2)
    theta, weight = tanh_sinh(np.unique(np.clip(slopes, low, high)))
    P = np.exp(-((theta - mu) ** 2) / (2 * sigma**2)) * np.sin(theta) * weight
    used = np.greater(P, 1e-13 * P.sum())
    theta, P = theta[used].astype(np.longdouble), P[used] / P.sum()
    a, b = np.maximum(ti * np.tan(theta), 1.0), np.maximum(tr * np.tan(theta), 1.0)
    wide, seen = np.arccos(1.0 / a), np.arccos(1.0 / b)
    kinks = [wide, -wide, PI - wide, wide - PI]
    kinks += [delta + seen, delta - seen, delta + PI - seen, delta + seen - PI]
    kinks += [np.full_like(theta, turn + more) for turn in turns for more in (0.0, PI)]
    edges = np.sort(np.mod(np.stack(kinks, axis=-1), 2 * PI))
    phi, arc = tanh_sinh(np.concatenate([edges, edges[:, :1] + 2 * PI], axis=-1))
    ring = np.empty_like(theta)
    for j, slope in enumerate(theta):
        a = direction(slope, phi[j])
        ring[j] = arc[j] @ (oren_nayar.L1_rp(s, v, a, rho) + twice(s, v, a, direction(slope, phi[j] + PI), rho))
    return float(P @ ring) / (2 * PI) / math.cos(theta_i)


@pytest.mark.parametrize(
    ("sigma_deg", "mean_deg"),
    [(3.0, 15.0), *(pytest.param(*of, marks=pytest.mark.slow) for of in ((10.0, 30.0), (30.0, 50.0), (0.5, 75.0)))],
)
def test_against_the_paper_s_equations(sigma_deg: float, mean_deg: float) -> None:
    model = OrenNayar(0.9, sigma_deg, "exact", mean_slope_deg=mean_deg)
    for degrees in PLACES:
        theta_i, theta_r, dphi = map(math.radians, degrees)
        expected = integrated((theta_i, theta_r, dphi), math.radians(sigma_deg), math.radians(mean_deg), 0.9)
        # the stated error of the form; with steps of 0.1 the two agree to 3e-10
        assert float(model.brdf(theta_i, 0.0, theta_r, dphi)) == pytest.approx(expected, rel=1e-8), degrees


ANGLES = tuple(np.radians([(*degrees[:1], 0.0, *degrees[1:]) for degrees in PLACES]).T)


def test_a_mean_near_zero_is_as_none() -> None:
    # the BRDF moves by mu tan(theta) at most, 2e-11 rad times 115, beside the two quadratures' 1e-8
    for sigma_deg in (2.0, 20.0, 60.0):
        with_mean = OrenNayar(0.9, sigma_deg, "exact", mean_slope_deg=1e-9).brdf(*ANGLES)
        np.testing.assert_allclose(with_mean, OrenNayar(0.9, sigma_deg, "exact").brdf(*ANGLES), rtol=2e-8)


def test_a_narrow_distribution_is_one_slope() -> None:
    for mean_deg in (0.5, 40.0, 80.0):
        one = OrenNayar(0.9, form="single-slope", slope_deg=mean_deg).brdf(*ANGLES)
        none = OrenNayar(0.9, 0.0, "exact", mean_slope_deg=mean_deg).brdf(*ANGLES)
        np.testing.assert_array_equal(none, one)
        # sin(theta_a) P has its mean at mu + sigma^2/tan(mu), and eq. 12 a slope below tan(theta) < 115; sigma is
        # 2e-7 rad, and squares of it are below 1e-11
        narrow = OrenNayar(0.9, 1e-5, "exact", mean_slope_deg=mean_deg).brdf(*ANGLES)
        np.testing.assert_allclose(narrow, one, rtol=1e-9)


def test_a_fit_leaves_the_mean_alone() -> None:
    assert OrenNayar.declaration().free == ("albedo", "sigma_deg")
    assert not OrenNayar.declaration().fixed


def test_cheaper_forms_have_no_mean_and_more_spread() -> None:
    seen = ModelDirections(*(direction(np.linspace(0.0, 1.2, 30), phi) for phi in (0.0, 2.0)))
    model = OrenNayar(0.8, 0.0, "exact", mean_slope_deg=25.0)
    _, qualitative, functional = (form.change(model) for form in forms(model, seen))
    for cheap in (qualitative, functional):
        assert isinstance(cheap, OrenNayar)
        assert cheap.mean_slope_deg == 0.0
        assert cheap.sigma_deg > 10.0
