"""The branch-free elementary functions against mpmath, in units of 2.2e-16."""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from gonio.models import _math
from gonio.models._compile import device, loop, template

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
        (sine, mp.sin, PHASES, 2.0),
        (cosine, mp.cos, PHASES, 2.0),
        (polar_sine, mp.sin, POLAR, 1.0),
        (polar_cosine, mp.cos, POLAR, 1.5),
        (_math.atan_over, atan_over, UNIT, 2.0),
        (_math.atan_over_near, atan_over, UNIT * math.tan(math.pi / 8) ** 2, 1.5),
    ],
    ids=["exp", "exp2", "log", "sin", "cos", "polar sin", "polar cos", "atan", "atan near 0"],
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
