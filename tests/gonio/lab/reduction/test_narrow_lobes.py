"""The steepest slope between points: never below the truth of a sum of Gaussians, and near it where steps resolve."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from gonio import instrument, models
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.lab.reduction.angle_sensitivity import BandCurves
from gonio.lab.reduction.narrow_lobes import steepest
from gonio.lab.reduction.spikes import blurred_overlap
from gonio.typing import Floats

HALF = math.radians(0.5)
CONE_SR = float(solid_angle_of_cone(HALF))
U = math.radians(0.03)
NOISE = 0.005


@dataclass(frozen=True, slots=True)
class Drawn:
    """One plan on one lobe; arrays have one number a point."""

    m: float
    step_deg: float
    theta_i: Floats
    signed: Floats
    ratio: Floats
    """True over stated standard deviation."""
    spiked: Floats
    """Whether a specular spike might be seen."""

    @property
    def width(self) -> float:
        """The lobe's full width at half maximum, in steps."""
        return math.degrees(4.0 * self.m * math.sqrt(math.log(2.0))) / self.step_deg


def directions(theta_i: Floats, signed: Floats) -> Directions:
    """In the plane of incidence; positive on the mirror side."""
    return Directions(theta_i, np.zeros_like(signed), abs(signed), np.where(signed >= 0, math.pi, 0.0))


def draw(rng: np.random.Generator) -> Drawn:
    """One plan, and what is true and stated of it."""
    m = float(np.exp(rng.uniform(math.log(0.02), math.log(0.15))))
    step_deg = float(np.round(np.exp(rng.uniform(0.0, math.log(15.0))), 1))
    middle, phase = float(rng.choice([15, 30, 45, 60, 70])), float(rng.choice([0.0, 0.5, 0.3, rng.uniform()]))
    s = float(rng.choice([0.1, 0.5, 0.9]))
    ior = (0.77 + 6.08j, 1.5 + 0j)[int(rng.integers(2))]
    ground = float(rng.choice([0.02, 0.1, 0.4]))
    model = models.CookTorrance(s=s, d=1.0 - s, slopes=((m, 1.0),), ior=ior, diffuse_albedo=ground)
    points = []
    for theta_i in [middle] if rng.random() < 0.5 else [middle - 10.0, middle, middle + 10.0]:
        signed = theta_i + (phase + np.arange(-180, 181)) * step_deg
        points += [(theta_i, r) for r in signed if abs(r) < 86.0]
    theta_i, signed = np.radians(np.array(points)).T

    def seen(by_i: float, by_r: float) -> Floats:
        d = directions(theta_i + by_i, signed + by_r)
        value = instrument.apparent_brdf(
            model, d.theta_i, d.phi_i, np.minimum(d.theta_r, math.pi / 2), d.phi_r, wavelength_nm=550.0,
            source_solid_angle_sr=CONE_SR, receiver_solid_angle_sr=CONE_SR, spike="exact",
        )  # fmt: skip
        return np.asarray(value * np.cos(theta_i + by_i) / np.cos(theta_i))

    here = seen(0.0, 0.0)
    true = (NOISE * here) ** 2
    for by_i, by_r in ((U, 0.0), (0.0, U)):
        up, down = seen(by_i, by_r) - here, seen(-by_i, -by_r) - here
        true = true + (0.5 * (up - down)) ** 2 + (0.5 * (up + down)) ** 2
    stated, spiked = _stated(theta_i, signed, here * (1.0 + NOISE * rng.standard_normal(here.size)))
    return Drawn(m, step_deg, theta_i, signed, np.sqrt(true) / stated, spiked)


def _stated(theta_i: Floats, signed: Floats, values: Floats) -> tuple[Floats, Floats]:
    """What the reduction states of values measured at these angles, as `gonio.lab.reduction.brdf` adds it up."""
    goals = directions(theta_i, signed)
    moves = ((U, 0.0), (0.0, U))
    moved = [[directions(theta_i + s * i, signed + s * r) for s in (1.0, -1.0)] for i, r in moves]
    shares = [
        blurred_overlap(goals[k], Directions.stack([plus[k] for plus, _ in moved]), (HALF, HALF))
        for k in range(values.size)
    ]
    curves = BandCurves(goals, goals, values, NOISE * abs(values), (HALF, HALF), shares)
    odd, even, u_slope = np.zeros((3, values.size))
    for plus, minus in moved:
        for k in range(values.size):
            o, e = curves.effects(k, goals[k], plus[k], minus[k])
            odd[k], even[k], u_slope[k] = (
                odd[k] + o**2,
                even[k] + e**2,
                u_slope[k] + curves.slope_uncertainty(k, plus[k]) ** 2,
            )
    blur = curves.spikes.variance
    blurred = np.where(curves.spike != 0, np.maximum(blur - odd, 0.0), blur + even)
    spiked = np.array([share.most > 0.0 for share in shares])
    return np.sqrt((NOISE * values) ** 2 + odd + blurred + u_slope), spiked


def bound(from_mirror: Floats, values: Floats, u_rel: float = 1e-3, theta_i: float = 0.5) -> Floats:
    return steepest(
        from_mirror,
        values,
        u_rel * values,
        np.full(values.size, theta_i),
        abs(theta_i + from_mirror),
        (HALF, HALF),
        HALF,
    )


def gaussians(x: Floats, *lobes: tuple[float, float]) -> Floats:
    """Height and slope m of each; m = inf is a matte ground."""
    t = 4.0 * np.tan(0.5 * x) ** 2
    return np.asarray(sum(height * np.exp(-t / (4.0 * m**2)) for height, m in lobes))


def slope(x: Floats, *lobes: tuple[float, float]) -> Floats:
    step = 1e-6
    return (gaussians(x + step, *lobes) - gaussians(x - step, *lobes)) / (2.0 * step)


@pytest.mark.parametrize("step_deg", [2.0, 5.0, 12.0])
@pytest.mark.parametrize("start", [0.0, 0.3, 0.5])
@pytest.mark.parametrize(
    "lobes",
    [
        ((5.0, 0.05), (0.05, math.inf)),
        ((20.0, 0.03), (1.0, 0.2), (0.02, math.inf)),
        ((0.3, 0.12), (0.3, math.inf)),
    ],
)
def test_no_sum_of_gaussians_is_steeper_by_what_matters(
    step_deg: float, start: float, lobes: tuple[tuple[float, float], ...]
) -> None:
    x = np.radians((np.arange(-9, 6) + start) * step_deg)
    x = x[abs(x) < 0.9]
    values = gaussians(x, *lobes)
    found = bound(x, values)
    beside = abs(x) > HALF
    # what errors of 0.03 degrees in each arm do more than the bound says: less than half of a noise of 0.5 %
    short = (abs(slope(x, *lobes)) - found) * math.radians(0.03 * math.sqrt(2.0))
    assert np.all(short[beside] < 0.0025 * values[beside])


def test_where_steps_resolve_a_lobe_the_bound_is_near_its_slope() -> None:
    lobes = ((3.0, 0.15), (0.1, math.inf))
    x = np.radians(np.arange(-40.0, 41.0, 2.0))
    found = bound(x, gaussians(x, *lobes), u_rel=1e-5)
    steep = abs(slope(x, *lobes)) > 0.02 * abs(slope(x, *lobes)).max()
    inner = steep & (abs(x) > math.radians(3.0)) & (abs(x) < math.radians(31.0))
    # secants over 2 degrees of a lobe 29 degrees wide; at its top and at its foot there is hardly a slope
    assert np.all(found[inner] < 1.35 * abs(slope(x, *lobes))[inner])


def test_a_matte_sample_has_no_slope_to_speak_of() -> None:
    x = np.radians((np.arange(-8, 5) + 0.5) * 10.0)
    # noise of 0.1 % might be a lobe as narrow as energy allows: errors of 0.03 degrees move that by less than the noise
    assert np.all(bound(x, np.full(x.size, 0.3), u_rel=1e-3) * math.radians(0.03) < 1e-3 * 0.3)


def test_beside_a_peak_between_two_points_energy_is_the_bound() -> None:
    """Nothing nearer to the mirror direction: m such that a Gaussian of this value reflects ten times all light."""
    x = np.radians(np.array([-37.5, -22.5, -7.5, 7.5, 22.5, 37.5]))
    found = bound(x, np.array([0.05, 0.05, 0.5, 0.5, 0.05, 0.05]), u_rel=1e-6)
    t = 4.0 * math.tan(0.5 * x[3]) ** 2
    y = np.linspace(1.0, 20.0, 200_001)
    cosine = min(math.cos(0.5), math.cos(0.5 + x[3]))
    reflected = math.pi * (t / y) * cosine * 0.45 * np.exp(y)  # pi 4 m^2 cos(theta) times the peak
    largest = y[np.searchsorted(reflected, 10.0)]
    # d exp(-t y/t0)/dx = 2 sqrt(t) (1 + t/4) y / t0 of it
    assert found[3] == pytest.approx(0.45 * largest * 2.0 * (1.0 + 0.25 * t) / math.sqrt(t), rel=1e-3)


@pytest.mark.parametrize("number", [0, 51, 57])
def test_drawn_plans_on_drawn_lobes(number: int) -> None:
    """Of the campaign's: steps wider than the lobe, where the ratio was 2.8, 10.5 and 8.4."""
    drawn = draw(np.random.default_rng([1, number]))
    assert drawn.width < 1.0
    # 1.2, as docs/radiometry.md has it
    assert drawn.ratio.max() < 1.2


def test_values_below_the_noise_have_a_bound_too() -> None:
    x = np.radians((np.arange(-8, 5) + 0.5) * 10.0)
    values = np.where(np.arange(x.size) % 2, -1e-4, 2e-4)
    found = steepest(x, values, np.full(x.size, 2e-4), np.full(x.size, 0.5), abs(0.5 + x), (HALF, HALF), HALF)
    assert np.isfinite(found).all()
