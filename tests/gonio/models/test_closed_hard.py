"""The hard cases of the closed-form models: no NaN, no warning, infinite only where the formula's own limit is.

Digits near the mirror direction, retro and grazing are held by `test_closed_reference` and `test_plain_kernels`.
"""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from gonio.models import Blinn, CookTorrance, Lambert, Model, OrenNayar, Phong, _math, fresnel
from gonio.models._compile import device, loop, template

PI = math.pi


def test_oren_nayar_functional_is_negative_near_forward_grazing_as_in_the_paper() -> None:
    # notes: f_r = -0.0028 at sigma = 60 degrees, rho = 0.3, 85/85 degrees, forward
    value = OrenNayar(0.3, 60.0).brdf(math.radians(85.0), 0.0, math.radians(85.0), PI)
    assert value == pytest.approx(-0.0028, abs=5e-5)


@pytest.mark.parametrize(
    "model", [CookTorrance(), CookTorrance(distribution="gaussian"), Blinn(), Blinn(distribution="phong"), Phong()]
)
def test_exactly_grazing_the_mirror_direction_is_infinite(model: Model) -> None:
    assert model.brdf(PI / 2, 0.0, PI / 2, PI) == math.inf
    assert model.brdf(PI / 2, 0.7, PI / 2, 0.7 + PI) == math.inf
    assert model.brdf_vectors([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]) == math.inf


@pytest.mark.parametrize(
    "model",
    [
        Lambert(),
        CookTorrance(),
        CookTorrance(distribution="gaussian"),
        Blinn(),
        Blinn(distribution="gaussian"),
        OrenNayar(),
    ],
    ids=repr,
)
@pytest.mark.parametrize(("theta_r", "dphi"), [(0.0, 0.0), (0.4, 1.0), (1.2, PI), (1.2, 0.0)])
def test_exactly_grazing_off_the_mirror_is_the_limit(model: Model, theta_r: float, dphi: float) -> None:
    # at 1e-9 rad from grazing the value is within some 1e-9 times the slope of its limit
    near = float(model.brdf(PI / 2 - 1e-9, 0.0, theta_r, dphi))
    at = float(model.brdf(PI / 2, 0.0, theta_r, dphi))
    assert math.isfinite(at)
    assert at == pytest.approx(near, rel=1e-6, abs=1e-290)
    assert float(model.brdf(theta_r, 0.0, PI / 2, dphi)) == pytest.approx(at, rel=1e-13, abs=1e-290)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["functional", "qualitative", "exact"])
def test_oren_nayar_with_both_directions_grazing(form: str) -> None:
    model = OrenNayar(0.9, 30.0, form)
    assert model.brdf(PI / 2, 0.0, PI / 2, 0.0) == math.inf
    forward = float(model.brdf(PI / 2, 0.0, PI / 2, PI))
    # the limit along equal polar angles, which is reached like e ln e in e = pi/2 - theta
    assert forward == pytest.approx(float(model.brdf(PI / 2 - 1e-8, 0.0, PI / 2 - 1e-8, PI)), rel=1e-6)


@pytest.mark.parametrize("m", [1e-3, 1e-6, 1e-12, 1e-60])
def test_cook_torrance_as_the_slope_vanishes(m: float) -> None:
    model = CookTorrance(slopes=m, ior=1.5)
    assert model.brdf(0.5, 0.0, 0.6, PI) == pytest.approx(0.0, abs=1e-300)
    # in the mirror direction D = 1/m^2, G = 1
    expected = fresnel.reflectance(math.cos(0.5), 1.5) / (PI * m * m * math.cos(0.5) ** 2)
    assert model.brdf_vectors(
        [math.sin(0.5), 0.0, math.cos(0.5)], [-math.sin(0.5), 0.0, math.cos(0.5)]
    ) == pytest.approx(expected, rel=1e-14)


def test_index_1_reflects_nothing() -> None:
    theta = np.append(np.arccos(np.random.default_rng(1).random(50)), [0.0, PI / 2])
    assert np.all(CookTorrance(ior=1.0).brdf(theta, 0.0, 0.3, 2.0) == 0.0)
    assert np.all(fresnel.reflectance(np.cos(theta), 1.0) == 0.0)
    assert np.all(fresnel.reflectance([0.0, 0.5, 1.0], 1.0) == 0.0)


def test_total_reflection_beyond_the_critical_angle() -> None:
    # inside glass the critical angle is 41.8 degrees: |F|^2 = 1 beyond it, to ten roundings
    cosine = np.cos(np.radians([42.0, 60.0, 80.0, 89.999]))
    np.testing.assert_allclose(fresnel.reflectance(cosine, 1.0 / 1.5), 1.0, rtol=2e-15)


@pytest.mark.parametrize("sigma_deg", [1e-12, 1e-7, 1e-4])
def test_oren_nayar_exact_as_sigma_vanishes(sigma_deg: float) -> None:
    theta_i, theta_r = np.arccos(np.random.default_rng(2).random((2, 40)))
    theta_i[:3] = [0.0, 1.5, 0.2]
    # a facet tilted by sigma changes the BRDF by sigma tan(theta) at most, with tan below 60 here
    np.testing.assert_allclose(
        OrenNayar(0.8, sigma_deg, "exact").brdf(theta_i, 0.0, theta_r, 2.0),
        0.8 / PI,
        rtol=1e-12 + 60 * math.radians(sigma_deg),
    )


@pytest.mark.parametrize(
    ("degrees", "value"),
    [
        ((76.1366, 76.0548, 179.99985, 58.24), 0.14035747344318542),
        ((83.5532, 83.5536, 179.98656, 71.24), 0.11988589354017518),
        ((86.738, 86.7379, 179.99467, 39.85), 0.09304511521670876),
        ((88.81, 88.835, 177.295, 5.78), 0.03932316905824097),
        # the same in float64, with steps of 1/12 and 1/20
        ((74.545, 74.465, 179.964, 62.29), 0.144958894901708),
        ((88.5891, 89.9983, 199.938, 2.997), 0.0906772069476783),
        ((4.8389, 38.4372, 315.993, 80.4), 0.230140676139045),
    ],
)
def test_oren_nayar_exact_beside_the_forward_direction(degrees: tuple[float, ...], value: float) -> None:
    # eqs. 5 to 13 by tanh-sinh rules between the kinks, in 80-bit floats, the same with steps of 1/24 and 1/32;
    # theta_i, theta_r, dphi, sigma; albedo 1. The stated error of the form.
    theta_i, theta_r, dphi, _ = np.radians(degrees)
    assert OrenNayar(1.0, degrees[3], "exact").brdf(theta_i, 0.0, theta_r, dphi) == pytest.approx(value, rel=1e-8)


# ---- the branch-free elementary functions against mpmath, in units of 2.2e-16 ----


RNG = np.random.default_rng(4)


kernel: Any
"""Put in by the template."""


@template("r1 p w1 i i")
def over_values(x: Any, p: Any, out: Any, start: int, stop: int) -> None:
    for j in range(start, stop):
        out[j] = kernel(x[j])  # noqa: F821


@device
def sine(x: Any) -> Any:
    return _sincos(x)[0]


@device
def cosine(x: Any) -> Any:
    return _sincos(x)[1]


@device
def polar_sine(x: Any) -> Any:
    return _polar(x)[0]


@device
def polar_cosine(x: Any) -> Any:
    return _polar(x)[1]


_sincos, _polar = _math.sincos, _math.sincos_polar


def atan_over(z: Any) -> Any:
    return mp.atan(mp.sqrt(z)) / mp.sqrt(z) if z else mp.mpf(1)


HALF_PI = math.pi / 2
PHASES = np.concatenate([RNG.uniform(-13, 13, 600), RNG.uniform(-1e6, 1e6, 400), np.arange(-20, 21) * HALF_PI])
POLAR = np.concatenate(
    [RNG.uniform(0, HALF_PI, 600), HALF_PI - 10 ** RNG.uniform(-15, -1, 200), 10 ** RNG.uniform(-15, -1, 200)]
)
POSITIVE = np.concatenate(
    [10 ** RNG.uniform(-307, 307, 500), 1 + RNG.uniform(-1, 1, 500) * 10 ** RNG.uniform(-15, 0, 500)]
)
UNIT = np.concatenate([RNG.random(600), 10 ** RNG.uniform(-18, 0, 200), [0.0, 1.0]])


@pytest.mark.parametrize(
    ("function", "reference", "values", "allowed"),
    [
        (_math.exp, mp.exp, RNG.uniform(-707, 709.7, 1000), 2.0),
        (_math.exp2, lambda x: mp.mpf(2) ** x, RNG.uniform(-1020, 1022, 1000), 1.5),
        (_math.log, mp.log, POSITIVE, 1.0),
        (_math.per_root, lambda x: 1 / mp.sqrt(x), POSITIVE, 1.0),
        (sine, mp.sin, PHASES, 2.0),
        (cosine, mp.cos, PHASES, 2.0),
        (polar_sine, mp.sin, POLAR, 1.0),
        (polar_cosine, mp.cos, POLAR, 1.5),
        (_math.atan_over, atan_over, UNIT, 2.0),
        (_math.atan_over_near, atan_over, UNIT * math.tan(math.pi / 8) ** 2, 1.5),
    ],
    ids=["exp", "exp2", "log", "1/sqrt", "sin", "cos", "polar sin", "polar cos", "atan", "atan near 0"],
)
def test_within_units_of_the_last_place(
    function: Callable[..., Any], reference: Any, values: Any, allowed: float
) -> None:
    got = evaluate(function, values)
    with mp.workdps(60):
        for x, value in zip(values, got, strict=True):
            exact = reference(mp.mpf(float(x)))
            assert abs(mp.mpf(float(value)) - exact) <= allowed * 2**-52 * abs(exact), f"at {float(x)!r}"


def evaluate(function: Callable[..., Any], values: Any) -> Any:
    out = np.empty(len(values))
    loop(over_values, function, 1)(np.asarray(values, dtype=float), (0.0,), out, 0, len(values))
    return out


def test_ends_of_the_ranges() -> None:
    np.testing.assert_array_equal(
        evaluate(_math.exp, [-math.inf, -1e300, -709.0, 0.0, 710.0, 1e300, math.inf]),
        [0.0, 0.0, 0.0, 1.0] + [math.inf] * 3,
    )
    np.testing.assert_array_equal(
        evaluate(_math.exp2, [-math.inf, -1e300, -1021.0, 0.0, 1.0]), [0.0, 0.0, 0.0, 1.0, 2.0]
    )
    np.testing.assert_array_equal(evaluate(_math.log, [0.0, 1.0]), [-math.inf, 0.0])
    np.testing.assert_array_equal(evaluate(polar_cosine, [0.0, HALF_PI]), [1.0, 0.0])
    np.testing.assert_array_equal(evaluate(polar_sine, [0.0, HALF_PI]), [0.0, 1.0])
