"""Lobes narrower than a plan's steps: are stated uncertainties large enough, and not needlessly large?

    python tools/lobe_campaign.py --count 140 --seed 1

Each plan is drawn at random: a Cook-Torrance lobe (m from 0.02 to 0.15) on a matte ground, steps of 1 to 15 degrees,
one or three angles of incidence, the mirror direction on the grid or off it, noise of 0.5 % and errors of 0.03 degrees
in each arm. Compared are the standard deviation that the errors truly cause, from the model seen through the cones at
moved directions, and the one that the reduction's curves state. Printed are the largest ratios, by how many steps the
lobe is wide, and how many points state more than three times too much. Points that a specular spike may reach are left
out: what is stated there is about spikes.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import dataclass

import numpy as np

from gonio import instrument, models
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.reduction.angle_sensitivity import Curves
from gonio.reduction.spike_overlap import blurred_overlap
from gonio.typing import Floats

HALF = math.radians(0.5)
CONE_SR = float(solid_angle_of_cone(HALF))
U = math.radians(0.03)
NOISE = 0.005
KINDS = (0.0, 1.0, 2.0, 3.0, math.inf)
"""Ends of the classes of width over step."""


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
    values = here * (1.0 + NOISE * rng.standard_normal(here.size))
    stated, spiked = _stated(theta_i, signed, values)
    return Drawn(m, step_deg, theta_i, signed, np.sqrt(true) / stated, spiked)


def _stated(theta_i: Floats, signed: Floats, values: Floats) -> tuple[Floats, Floats]:
    """What the reduction states of values measured at these angles, as `gonio.reduction.brdf` adds it up."""
    goals = directions(theta_i, signed)
    moves = ((U, 0.0), (0.0, U))
    moved = [[directions(theta_i + s * i, signed + s * r) for s in (1.0, -1.0)] for i, r in moves]
    shares = [
        blurred_overlap(goals[k], Directions.stack([plus[k] for plus, _ in moved]), (HALF, HALF))
        for k in range(values.size)
    ]
    curves = Curves(goals, goals, values, NOISE * abs(values), (HALF, HALF), shares)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    drawn = [draw(np.random.default_rng([asked.seed, number])) for number in range(asked.count)]
    print("width/step    points  largest  above 1.2  below 1/3")
    for low, high in itertools.pairwise(KINDS):
        found = [d.ratio[~d.spiked.astype(bool)] for d in drawn if low <= d.width < high]
        if found:
            ratio = np.concatenate(found)
            print(f"{low:g} to {high:<6g} {ratio.size:8d} {ratio.max():8.2f}  {np.mean(ratio > 1.2):9.2%}  "
                  f"{np.mean(ratio < 1 / 3):9.2%}")  # fmt: skip


if __name__ == "__main__":
    main()
