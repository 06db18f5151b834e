"""What the tests of the models against `gonio.models.plain` share: directions, losses, and how agreement is judged.

The kernels are good to some 1e-15 (1 + conditioning); the plain formulas lose more, and each tolerance says what: a
count of roundings, eps, times the factor by which the formula lets them grow. Directions are drawn at random, and set
where formulas have difficulties. Where a plain formula is 0/0 it is not asked.
"""

import math
from typing import Any

import numpy as np

from gonio.models.plain import cook_torrance, he_torrance, he_torrance_appendix_a
from gonio.models.plain.vectors import direction, dot, length, polar

EPS = float(np.finfo(float).eps)
PI = math.pi
"""Glass, its inverse, and metals."""

HARD_DEG = [
    (0.0, 0.0, 0.0, 0.0),  # both along the normal
    (0.0, 0.0, 40.0, 10.0),
    (30.0, 0.0, 30.0, 180.0),  # mirror
    (30.0, 20.0, 30.0, 20.0),  # retro
    (50.0, 0.0, 50.0001, 180.0001),  # beside the mirror
    (50.0, 0.0, 50.0, 1e-5),  # beside retro
    (70.0, 0.0, 20.0, 90.0),  # cos(dphi) = 0
    (89.9, 0.0, 30.0, 180.0),  # grazing
    (45.0, 0.0, 89.9, 100.0),
    (89.0, 0.0, 89.5, 180.0),  # forward grazing
    (89.5, 0.0, 89.0, 3.0),  # backward grazing
    (80.0, 350.0, 80.0, 170.0),
]

Angles = tuple[Any, Any, Any, Any]


def pairs(seed: int, count: int = 60) -> Angles:
    """theta_i, phi_i, theta_r, phi_r [rad]: hard ones, then random ones, up to 89 degrees."""
    rng = np.random.default_rng(seed)
    theta, phi = rng.uniform(0.0, math.radians(89.0), (2, count)), rng.uniform(0.0, 2.0 * PI, (2, count))
    drawn = np.stack([theta[0], phi[0], theta[1], phi[1]], axis=1)
    return tuple(np.concatenate([np.radians(HARD_DEG), drawn]).T)


def vectors(seed: int) -> tuple[np.ndarray, np.ndarray]:
    theta_i, phi_i, theta_r, phi_r = pairs(seed)
    return direction(theta_i, phi_i), direction(theta_r, phi_r)


def drawn_vectors(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of random directions above the surface."""
    w = rng.normal(size=(2, count, 3))
    w[..., 2] = np.abs(w[..., 2])
    w /= np.linalg.norm(w, axis=-1, keepdims=True)
    return w[0], w[1]


def agree(got: Any, plain: Any, loss: Any, roundings: float = 8.0, scale: Any = None) -> None:
    """`got` is within so many roundings of `plain`, each worth eps (1 + loss); below 1e-290 both are 0."""
    got, plain = np.asarray(got), np.asarray(plain)
    limit = roundings * EPS * (1.0 + np.asarray(loss)) * (np.abs(plain) if scale is None else scale) + 1e-290
    worst = np.argmax(np.abs(got - plain) / limit)
    assert np.all(np.abs(got - plain) <= limit), (
        f"[{worst}]: {np.ravel(got)[worst]!r} instead of {np.ravel(plain)[worst]!r}, "
        f"{np.ravel(np.abs(got - plain) / limit)[worst]:.3g} of the tolerance"
    )


def facet_loss(light: np.ndarray, view: np.ndarray) -> tuple[Any, Any]:
    """The angle alpha, and what F and G lose: unit vectors are uncertain by eps, and H by eps/|L + V|."""
    h = cook_torrance.H(light, view)
    return polar(h), 1.0 / dot(view, h) ** 2


def in_frame(values: dict[str, float], *names: str) -> list[np.ndarray]:
    """Unit vectors in a frame whose z is N."""
    n, *others = (np.array([values[name + axis] for axis in "xyz"]) for name in ("N", *names))
    z = n / np.linalg.norm(n)
    x = np.cross([1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return [np.array([o @ x, o @ np.cross(z, x), o @ z]) / np.linalg.norm(o) for o in others]


def lobe_loss(theta_i: Any, phi_i: Any, theta_r: Any, phi_r: Any, sigma0: float, tau: float, lam: float) -> Any:
    """What eq. 71 loses: the logarithm of the series g ln(g) + c; c by v_xy, tau k0; angles near grazing; shadowing."""
    k_i, k_r = he_torrance.directions(theta_i, phi_i, theta_r, phi_r)
    g = he_torrance.g(theta_i, theta_r, he_torrance_appendix_a.sigma(theta_i, theta_r, sigma0, tau), lam)
    c = he_torrance_appendix_a.v_xy(k_i, k_r, lam) ** 2 * tau**2 / 4.0
    series = g * (1.0 + np.abs(np.log(g))) + np.minimum(c, g + np.sqrt(c)) + np.sqrt(c) * tau * 2.0 * PI / lam
    return 4.0 * series + (np.tan(theta_i) + np.tan(theta_r)) * (1.0 + g) + 1.0 / length(k_r - k_i) ** 2
