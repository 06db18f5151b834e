"""The hard cases of the closed-form models: right digits, no NaN, no warning, infinite only where the formula's own
limit is.

Digits are held against the papers' formulas in 60 digits (tests/gonio/models/oracles.py) at 1e-13 (1 + conditioning)
relative, and values below 1e-290 count as 0.
"""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from gonio.models import Blinn, CookTorrance, Lambert, Model, OrenNayar, Phong, _math, fresnel
from gonio.models._compile import device, loop, template
from tests.gonio.models import oracles

PI = math.pi
NEAR_90 = math.radians(89.9999)

GEOMETRIES: dict[str, tuple[float, float, float, float]] = {
    "normal incidence": (0.0, 0.0, 0.7, 1.0),
    "both normal": (0.0, 0.0, 0.0, 0.0),
    "exact retro": (0.6, 0.4, 0.6, 0.4),
    "1e-9 from retro": (0.6, 0.4, 0.6 + 1e-9, 0.4),
    "mirror": (0.6, 0.0, 0.6, PI),
    "1e-9 from the mirror": (0.6, 0.0, 0.6 + 1e-9, PI),
    "1e-9 from the mirror, out of plane": (0.6, 0.0, 0.6, PI - 1e-9),
    "incidence at 89.9999 degrees": (NEAR_90, 0.3, 0.5, 2.0),
    "view at 89.9999 degrees": (0.5, 0.3, NEAR_90, 2.0),
    "retro at 89.9999 degrees": (NEAR_90, 0.0, NEAR_90, 0.0),
    "forward at 89.9999 degrees": (NEAR_90, 0.0, NEAR_90, PI),
    "forward at 89 and 88 degrees": (math.radians(89.0), 0.0, math.radians(88.0), PI - 0.01),
    "1e-9 from normal": (1e-9, 0.0, 1e-9, 2.0),
    "at 90 degrees to each other": (0.8, 0.0, 0.9, PI / 2),
}
INDICES = {
    "metal": 0.77 + 6.08j,
    "glass": 1.5,
    "k = 1e-9": 1.5 + 1e-9j,
    "inside glass": 0.6667,
    "inside glass, k = 1e-12": 0.6667 + 1e-12j,
    "nearly 1": 1.0 + 1e-9,
    "1": 1.0,
}


def check(got: float, formula: Callable[..., Any], angles: tuple[float, ...]) -> None:
    reference = formula(*[mp.mpf(a) for a in angles])
    assert math.isfinite(got)
    if abs(reference) < 1e-290:
        assert 0.0 <= got < 1e-280
        return
    off = abs(got / reference - 1)
    if off > 1e-13:  # the conditioning takes ten times as long as the value
        limit = 1e-13 * (1.0 + oracles.conditioning(formula, angles))
        assert off <= limit, f"{got!r} instead of {mp.nstr(reference, 20)}, allowed {limit:.1e}"


@pytest.mark.slow
@pytest.mark.parametrize("index", INDICES.values(), ids=INDICES.keys())
@pytest.mark.parametrize("angles", GEOMETRIES.values(), ids=GEOMETRIES.keys())
def test_cook_torrance(angles: tuple[float, float, float, float], index: complex) -> None:
    for distribution in ("beckmann", "gaussian"):
        for slopes in (((0.3, 1.0),), ((1e-3, 1.0),), ((0.4, 0.4), (0.2, 0.6))):
            model = CookTorrance(slopes=slopes, ior=index, distribution=distribution)
            check(
                float(model.brdf(*angles)),
                lambda a, b, e, f, s=slopes, d=distribution: oracles.cook_torrance(a, b, e, f, s, index, d),
                angles,
            )


@pytest.mark.parametrize("angles", GEOMETRIES.values(), ids=GEOMETRIES.keys())
@pytest.mark.parametrize(
    ("distribution", "c"),
    [
        ("phong", 50.0),
        ("phong", 1e4),
        ("gaussian", 5.0),
        ("trowbridge-reitz", 0.35),
        ("trowbridge-reitz", 1e-3),
        ("trowbridge-reitz", 1.0),
    ],
)
def test_blinn(angles: tuple[float, float, float, float], distribution: str, c: float) -> None:
    for index in (200.0, 1.8, 0.6667):
        model = Blinn(k_d=0.0, k_s=1.0, ior=index, distribution=distribution, c=c)
        check(
            float(model.brdf(*angles)),
            lambda a, b, e, f, n=index: oracles.blinn(a, b, e, f, c, n, distribution),
            angles,
        )


@pytest.mark.parametrize("angles", GEOMETRIES.values(), ids=GEOMETRIES.keys())
@pytest.mark.parametrize("sigma_deg", [0.0, 1e-6, 1.0, 30.0, 60.0])
def test_oren_nayar_functional(angles: tuple[float, float, float, float], sigma_deg: float) -> None:
    got = float(OrenNayar(0.7, sigma_deg).brdf(*angles))
    check(got, lambda a, b, e, f: oracles.oren_nayar(a, b, e, f, 0.7, math.radians(sigma_deg)), angles)


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
