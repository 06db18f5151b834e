"""La Coupole's measurement equation (Lucat2026, supplement, eq. S19), with the example of the package `pycoupole`.

Another laboratory's instrument: a camera over a sample, LEDs on a dome, a scan of the sample's shape. Their package
draws 10^8 random numbers a value. Positions are in metres, the BRDF in 1/sr.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.special import ndtri
from scipy.stats import poisson

from gonio.lab.reduction.monte_carlo import Drawn, drawn
from gonio.typing import Floats
from gonio_validation.verify.finding import Finding, near

PIXEL, CHANNEL, LEVEL_LSB, EXPOSURE_S = (1521, 915), 1, 10.0, 0.122374
LIGHT_M, LIGHT_NORMAL = (-1.14251, 0.507025, 0.391015), (0.965928, 0.00172073, -0.258806)
PLACE_M, NORMAL = (0.490908, -0.0674868, 0.0267361), (0.0135288, -0.00660755, 0.999887)
"""The example: a dim pixel of grazing light."""
TICK_S = 19e-6
GAIN_E, PRNU, DARK_E_PER_S, READ_E, DSNU_E = 3.33, 0.0127, 22.0, 13.0, 2.0
F_NUMBER = 8.0
FLAT = np.array([-0.12480557, 0.00580036, -0.06220726, -0.01976859, 0.99836206])
U_FLAT = np.array([1.08971155e-04, 5.62999256e-05, 1.08935718e-04, 5.62907629e-05, 6.08405915e-05])
"""Of green: x^2, x, y^2, y, 1."""
WHITE, U_WHITE = 0.98, 0.0027
CALIBRATION, U_CALIBRATION, BALANCE = 17434401087.369884, 702675.41479146033, 1.0 / 0.83213626924054
LED_M, U_LED_M, LED_PLACE_M, ARM_M = 0.007, 40e-6, 700e-6, 0.250
SCAN_M, NOISE_OF_SCAN_M, SIDE_M = 200e-6, 30e-6, 200e-6
"""Spheres that a place and a vertex of the scan lie in, and side of a facet."""
INPUTS = 45
VALUE = 0.0213540596178
LIMITS = (0.00513229, 0.0228932, 0.123578)
"""Of the package (0.2.2, 3 10^7 draws in bins of a ten-thousandth), of 2.5 %, 50 % and 97.5 %: with random numbers of
its own for each of its functions. In the package as it is each function begins with the same ones (docs/budget.md)."""


class DrawnErrors:
    """Takes columns of uniform numbers (m, `INPUTS`) one after another."""

    exact = False
    """Whether there are no errors at all."""

    def __init__(self, x: Floats) -> None:
        self._x, self._next = x, 0

    def start(self) -> None:
        """Another part of the equation begins."""

    def uniform(self, count: int) -> Floats:
        """`count` columns of uniform numbers, shape (m, count)."""
        self._next += count
        return self._x[:, self._next - count : self._next]

    def even(self, count: int) -> Floats:
        """Within +-1."""
        return 2.0 * self.uniform(count) - 1.0

    def normal(self, count: int) -> Floats:
        """With a standard deviation of 1."""
        return np.asarray(ndtri(self.uniform(count)))

    def counts(self, mean: Floats) -> Floats:
        """Poisson's."""
        return np.asarray(poisson.ppf(self.uniform(1)[:, 0], mean))

    def ball(self, radius: float) -> Floats:
        """A place in a ball, shape (m, 3)."""
        u = self.uniform(3)
        height, turn = 1.0 - 2.0 * u[:, 0], 2.0 * math.pi * u[:, 1]
        around = np.sqrt(1.0 - height**2)
        way = np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=1)
        return np.asarray(radius * np.cbrt(u[:, 2:]) * way)


class Exact(DrawnErrors):
    """Every input is what it should be."""

    exact = True

    def __init__(self) -> None:
        super().__init__(np.full((1, INPUTS), 0.5))

    def ball(self, radius: float) -> Floats:
        """Its middle."""
        return np.zeros((1, 3))


def value(errors: DrawnErrors) -> Floats:
    """BRDF [1/sr] with errors of all inputs (m,)."""
    exposure = _exposure(errors)
    return level(errors, exposure) * over_level(errors, exposure)


def _exposure(errors: DrawnErrors) -> Floats:
    return np.maximum(EXPOSURE_S + TICK_S * errors.even(1)[:, 0], TICK_S)


def level(errors: DrawnErrors, exposure: Floats) -> Floats:
    """What the camera's converter gives [LSB]: photons, dark current, readout, pattern and rounding."""
    errors.start()
    if errors.exact:
        return np.array([LEVEL_LSB])
    electrons = errors.counts(LEVEL_LSB * GAIN_E * (1.0 + PRNU * errors.even(1)[:, 0]))
    electrons = electrons + errors.counts(DARK_E_PER_S * exposure)
    read, pattern = errors.normal(2).T
    return np.asarray(np.round((electrons + READ_E * read + DSNU_E * pattern) / GAIN_E) + 0.5 * errors.even(1)[:, 0])


def over_level(errors: DrawnErrors, exposure: Floats) -> Floats:
    """BRDF over the converter's level [1/sr]: flat field, white, calibration, and the LED's light on the facet."""
    errors.start()
    at = 2.0 * np.array(PIXEL) / (4096.0, 3072.0) - 1.0
    flat = (FLAT + U_FLAT * errors.normal(5)) @ np.array([at[0] ** 2, at[0], at[1] ** 2, at[1], 1.0])
    errors.start()
    white, calibration = errors.normal(2).T
    scale = BALANCE * WHITE * (1.0 + U_WHITE * white) / math.pi / (CALIBRATION + U_CALIBRATION * calibration)
    return np.asarray(F_NUMBER**2 * scale / (flat * exposure * _irradiance(errors)))


def _frame(normal: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors across each normal (m, 3), as Duff et al. have them."""
    x, y, z = normal.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1), np.stack([b, sign + y * y * a, -y], axis=1)


def _turned(errors: DrawnErrors, normal: tuple[float, ...], arm: float, radius: float) -> Floats:
    """The normal of three places on a circle, each of which lies somewhere in a ball (m, 3)."""
    errors.start()
    straight = np.array([normal])
    turn = 2.0 * math.pi * errors.uniform(1)
    u, v = _frame(straight)
    places = [
        arm * (np.cos(turn + k * math.tau / 3.0) * u + np.sin(turn + k * math.tau / 3.0) * v) + errors.ball(radius)
        for k in range(3)
    ]
    if errors.exact:
        return straight
    across = np.cross(places[1] - places[0], places[2] - places[0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(np.copysign(1.0, across @ straight.T) * across)


def _irradiance(errors: DrawnErrors) -> Floats:
    """Irradiance by a square Lambertian LED on the sample, from the vectors of its edges, and its own cosine."""
    normal = _turned(errors, NORMAL, SIDE_M / math.sqrt(3.0), NOISE_OF_SCAN_M)
    light_normal = _turned(errors, LIGHT_NORMAL, ARM_M, LED_PLACE_M)
    errors.start()
    place, light = PLACE_M + errors.ball(SCAN_M), LIGHT_M + errors.ball(LED_PLACE_M)
    half = 0.5 * (LED_M + U_LED_M * errors.even(1))
    u, v = (half * each for each in _frame(light_normal))
    corners = [light - u - v, light + u - v, light + u + v, light - u + v]
    on_light, on_facet = errors.uniform(2), errors.uniform(2)
    if not errors.exact:
        light = corners[0] + 2.0 * u * on_light[:, :1] + 2.0 * v * on_light[:, 1:]
        a, b = (SIDE_M * each for each in _frame(normal))
        root = np.sqrt(on_facet[:, :1])
        first, second = 1.0 - root, root * on_facet[:, 1:]
        ends = [place - 0.5 * a - b * math.sqrt(3.0) / 6.0, place + 0.5 * a - b * math.sqrt(3.0) / 6.0,
                place + b * math.sqrt(3.0) / 3.0]  # fmt: skip
        place = ends[0] * (1.0 - first - second) + ends[1] * first + ends[2] * second
    total = np.zeros_like(normal)
    for one, other in zip(corners, [*corners[1:], corners[0]], strict=True):
        start, end = ((each - place) / np.linalg.norm(each - place, axis=1, keepdims=True) for each in (one, other))
        across = np.cross(start, end)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        total = total + np.arccos(np.sum(start * end, axis=1, keepdims=True)) * across
    toward = (light - place) / np.linalg.norm(light - place, axis=1, keepdims=True)
    return np.asarray(np.abs(np.sum(total * normal, axis=1) * np.sum(light_normal * toward, axis=1)))


def example(draws: int = 2**16, seed: int = 0) -> Drawn:
    """The example's value, drawn; its dark current, 0.8 LSB, has the exposure that is meant."""

    def of_camera(x: Floats) -> Floats:
        return level(DrawnErrors(x), np.full(len(x), EXPOSURE_S))

    def of_light(x: Floats) -> Floats:
        errors = DrawnErrors(x)
        return over_level(errors, _exposure(errors))

    return drawn([(of_camera, 6), (of_light, 39)], draws=draws, seed=seed)


def counted(found: Drawn, probabilities: Sequence[float]) -> list[float]:
    """Quantiles of the values that the package counts: from 0 to ten times the median."""
    least, most = found.probability(0.0), found.probability(10.0 * found.quantile(0.5))
    return [found.quantile(least + p * (most - least)) for p in probabilities]


def look(_folder: Path) -> list[Finding]:
    """See `gonio_validation.verify`."""
    limits = counted(example(), (0.025, 0.5, 0.975))
    return [near("La Coupole: BRDF / (1/sr)", float(value(Exact())[0]), VALUE, rel=1e-9)] + [
        near(f"La Coupole: {n} / (1/sr)", x, right, rel=0.01, digits=4)
        for n, x, right in zip(("lower limit", "median", "upper limit"), limits, LIMITS, strict=True)
    ]
