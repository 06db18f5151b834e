"""Foreign samples: do stated uncertainties hold for samples that no model has, measured by four kinds of plan?

    python -m tools.studies.foreign_samples --seed 7 --count 15

Each sample is drawn at random from families that are fitted nowhere, and measured with noise of 0.1 to 1 % and a common
scale of 0.2 %. The nearest of `MODELS` is asked for rho_dh at four incidences, and for values in directions that each
stand for an equal part of the reflected light. The truth is this file's own integral. A line a kind of plan says how
many intervals of 95 % hold it, and the largest departure in standard uncertainties.
"""

import argparse
import math
from collections.abc import Callable

import numpy as np
import pandas as pd
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.fit import FitResult, fit

from gonio.geometry import Directions
from gonio.models.corrected import reflected
from gonio.typing import Floats

Brdf = Callable[[Floats, Floats, Floats], Floats]
"""Of theta_i, theta_r and phi_r - phi_i [rad]."""
MODELS = ("blinn", "cook-torrance", "phong")
PLANS = ("plane", "few", "out of plane", "scattered")
SCALE = 0.002
K95 = 1.96


def vectors(theta_i: Floats, theta_r: Floats, dphi: Floats) -> tuple[Floats, Floats, Floats]:
    """Toward source, detector and between them, (..., 3)."""
    theta_i, theta_r, dphi = np.broadcast_arrays(theta_i, theta_r, dphi)
    source = np.stack([np.sin(theta_i), 0 * theta_i, np.cos(theta_i)], -1)
    detector = np.stack([np.sin(theta_r) * np.cos(dphi), np.sin(theta_r) * np.sin(dphi), np.cos(theta_r)], -1)
    middle = source + detector
    return source, detector, middle / np.maximum(np.linalg.norm(middle, axis=-1, keepdims=True), 1e-12)


def facets(width: float, tail: float, f0: float) -> Brdf:
    """Facets with slopes by a student's t (`tail` 2 is Trowbridge and Reitz's) and Smith's shadowing."""

    def shadow(cosine: Floats) -> Floats:
        return np.asarray(0.5 * (np.sqrt(1.0 + width**2 * (1.0 / cosine**2 - 1.0)) - 1.0))

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        source, detector, middle = vectors(theta_i, theta_r, dphi)
        cos_i, cos_r, cos_h = (np.maximum(x[..., 2], 1e-9) for x in (source, detector, middle))
        cos_d = np.clip(np.sum(source * middle, -1), 0.0, 1.0)
        spread = (1.0 + (1.0 / cos_h**2 - 1.0) / (width**2 * tail)) ** (-0.5 * tail - 1.0)
        spread = spread / (2.0 * math.pi * width**2) * 1.0 / cos_h**4
        fresnel = f0 + (1.0 - f0) * (1.0 - cos_d) ** 5
        return np.asarray(spread * fresnel / (1.0 + shadow(cos_i) + shadow(cos_r)) / (4.0 * cos_i * cos_r))

    return brdf


def smooth_scatter(a: float, b: float, c: float) -> Brdf:
    """The ABC model, of the distance from the mirror direction in direction cosines."""

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        source, detector, _ = vectors(theta_i, theta_r, dphi)
        return np.asarray(a / (1.0 + b * np.sum((source + detector)[..., :2] ** 2, -1)) ** (c / 2.0))

    return brdf


def ward(width: float, share: float) -> Brdf:
    """Ward's lobe."""

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        source, detector, middle = vectors(theta_i, theta_r, dphi)
        square = 1.0 / np.maximum(middle[..., 2], 1e-9) ** 2 - 1.0
        below = 4.0 * math.pi * width**2 * np.sqrt(np.maximum(source[..., 2] * detector[..., 2], 1e-9))
        return np.asarray(share * np.exp(-square / width**2) / below)

    return brdf


def rough_base(rho: float, rough: float) -> Brdf:
    """Fujii's form of a rough diffuse base; `rough` 0 is Lambert's."""

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        source, detector, _ = vectors(theta_i, theta_r, dphi)
        cos_i, cos_r = source[..., 2], detector[..., 2]
        beside = np.sum(source * detector, -1) - cos_i * cos_r
        below = np.where(beside > 0, np.maximum(cos_i, cos_r), 1.0)
        level = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * math.pi)) * rough)
        return np.asarray(rho / math.pi * level * (1.0 + rough * beside / np.maximum(below, 1e-9)))

    return brdf


def coated_base(rho: float) -> Brdf:
    """A base below a smooth interface (Ashikhmin and Shirley)."""

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        through_i, through_r = (1.0 - (1.0 - np.cos(theta) / 2.0) ** 5 for theta in (theta_i, theta_r))
        return np.asarray(28.0 * 0.95 * rho / (23.0 * math.pi) * through_i * through_r + 0.0 * dphi)

    return brdf


def retro(level: float, width: float) -> Brdf:
    """A lobe toward the source."""

    def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats) -> Floats:
        source, detector, _ = vectors(theta_i, theta_r, dphi)
        between = np.arccos(np.clip(np.sum(source * detector, -1), -1.0, 1.0))
        return np.asarray(level / (1.0 + (between / width) ** 2) ** 1.5)

    return brdf


def drawn(rng: np.random.Generator) -> Brdf:
    """A sample that reflects less than it receives."""
    even = rng.uniform

    def log(low: float, high: float) -> float:
        return math.exp(even(math.log(low), math.log(high)))

    while True:
        f0 = log(0.03, 0.3)
        kinds: list[list[Brdf]] = [
            [facets(log(0.08, 0.25), 2.0, even(0.3, 0.7) * f0), facets(log(0.3, 0.6), 2.0, 0.5 * f0),
             rough_base(even(0.05, 0.5), 0.0)],
            [smooth_scatter(log(0.2, 2.0), log(5.0, 80.0), even(1.5, 3.0)), rough_base(even(0.05, 0.6), 0.0)],
            [ward(log(0.1, 0.4), log(0.03, 0.4)), rough_base(even(0.1, 0.6), even(0.0, 0.5))],
            [facets(log(0.1, 0.4), even(1.2, 4.0), f0), rough_base(even(0.05, 0.5), 0.0)],
            [facets(log(0.15, 0.5), 2.0, f0), rough_base(even(0.1, 0.6), even(0.1, 0.8)),
             retro(log(0.02, 0.3), even(0.1, 0.5))],
            [facets(log(0.1, 0.4), 3.0, 0.05), coated_base(even(0.1, 0.8))],
        ]  # fmt: skip
        parts = kinds[int(rng.integers(len(kinds)))]

        def brdf(theta_i: Floats, theta_r: Floats, dphi: Floats, parts: list[Brdf] = parts) -> Floats:
            return np.asarray(sum(part(theta_i, theta_r, dphi) for part in parts))

        if max(reflectance(brdf, math.radians(theta)) for theta in (8.0, 45.0, 75.0)) < 0.99:
            return brdf


def reflectance(brdf: Brdf, theta_i: float, panels: int = 10, order: int = 24) -> float:
    """Directional-hemispherical reflectance by Gauss's rule in panels."""
    x, w = np.polynomial.legendre.leggauss(order)

    def nodes(high: float) -> tuple[Floats, Floats]:
        half = high / panels / 2.0
        return (np.arange(panels)[:, None] * 2.0 * half + half * (1.0 + x)).ravel(), np.tile(half * w, panels)

    (theta, of_theta), (phi, of_phi) = nodes(math.pi / 2.0), nodes(math.pi)
    values = brdf(np.full((1, 1), theta_i), theta[:, None], phi[None, :])
    return float(2.0 * np.einsum("ij,i,j->", values, of_theta * np.sin(theta) * np.cos(theta), of_phi))


def plan(kind: str, rng: np.random.Generator) -> Floats:
    """Angles (3, n) [degrees]: theta_i, theta_r, phi_r - phi_i."""
    if kind == "scattered":
        n = int(rng.integers(30, 61))
        return np.array([rng.uniform(5, 70, n), rng.uniform(5, 75, n), rng.uniform(0, 180, n)])
    incidences = np.sort(rng.uniform(8, 67, int(rng.integers(*{"plane": (3, 6), "few": (2, 4)}.get(kind, (2, 5))))))
    if kind == "out of plane":
        theta_r, dphi = np.arange(10.0, 76.0, rng.choice([10.0, 15.0])), np.arange(0.0, 181.0, rng.choice([20, 30, 45]))
        found = np.array([a.ravel() for a in np.meshgrid(incidences, theta_r, dphi, indexing="ij")])
    else:
        steps = np.arange(-80.0, 81.0, 5.0)
        each = [
            steps if kind == "plane" else rng.uniform(-76, 76, max(int(rng.integers(8, 21)) // incidences.size, 4))
            for _ in incidences
        ]
        pairs = np.array([(t, s) for t, signed in zip(incidences, each, strict=True) for s in signed]).T
        found = np.array([pairs[0], np.abs(pairs[1]), np.where(pairs[1] > 0, 180.0, 0.0)])
    return found[:, ~((found[2] == 0.0) & (np.abs(found[0] - found[1]) < 4.0))]  # the camera hides the light


def measured(brdf: Brdf, angles: Floats, rng: np.random.Generator) -> pd.DataFrame:
    """The measurement table."""
    true, noise = brdf(*np.radians(angles)), math.exp(rng.uniform(math.log(1e-3), math.log(1e-2)))
    values = true * (1.0 + SCALE * rng.normal()) * (1.0 + noise * rng.normal(size=true.size))
    table = pd.DataFrame(
        dict(zip(("theta_i_deg", "theta_r_deg", "phi_r_deg"), angles, strict=True))
        | {"phi_i_deg": 0.0, "wavelength_nm": 550.0, "polarisation": "unpolarised", "brdf": values, "flag": ""}
        | {"u_brdf": math.hypot(noise, SCALE) * values, "u_random": noise * values, "s_scale": SCALE * values}
    )
    table.attrs.update(source_solid_angle_sr=0.0, receiver_solid_angle_sr=0.0)
    return table


def nearest(table: pd.DataFrame) -> FitResult | None:
    """The model that is nearest; None where one is not rejected."""
    found = [fit(table, model) for model in MODELS]
    return (
        None
        if any(one.misfit is None for one in found)
        else min(found, key=lambda one: one.tau.value if one.tau else 0.0)
    )


def pulls(result: FitResult, brdf: Brdf) -> tuple[list[float], Floats, list[float], int]:
    """Departures over u, of rho_dh and of values; relative u of rho_dh; how many of them are not determined."""
    every = energy.of_model(result)
    found = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, 4).round().astype(int))]
    stated = [(r.theta_i_deg, r.rho_dh, r.u) for r in found if r.rho_dh is not None and r.u is not None]
    off = [abs(rho - reflectance(brdf, math.radians(theta))) / u for theta, rho, u in stated]
    at: Directions = reflected(result.model, math.radians(found[-1].theta_i_deg), 0.0, 550.0)[0][::10]
    value, u = result.predict(at)
    of_values = np.abs(value - brdf(at.theta_i, at.theta_r, at.dphi)) / u
    return off, of_values, [u / rho for _, rho, u in stated], len(found) - len(stated)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--count", type=int, default=15, help="samples a kind of plan")
    asked = parser.parse_args()
    for kind in PLANS:
        of_rho, of_values, relative, lacking, samples = list[float](), list[float](), list[float](), 0, 0
        for k in range(asked.count):
            rng = np.random.default_rng([asked.seed, PLANS.index(kind), k])
            brdf = drawn(rng)
            result = nearest(measured(brdf, plan(kind, rng), rng))
            if result is not None:
                samples += 1
                off, values, u, none = pulls(result, brdf)
                of_rho, of_values, relative, lacking = of_rho + off, [*of_values, *values], relative + u, lacking + none
        held, seen = np.array(of_rho), np.array(of_values)
        print(
            f"{kind}: {samples} samples; rho_dh held {np.sum(held < K95)} of {held.size}, farthest {held.max():.2f} u,"
            f" median u {100 * np.median(relative):.2g} %, not determined {lacking};"
            f" values held {100 * np.mean(seen < K95):.1f} % of {seen.size}",
            flush=True,
        )


if __name__ == "__main__":
    main()
