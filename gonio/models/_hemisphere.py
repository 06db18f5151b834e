"""Directions and weights whose sum is the integral of a lobe times cos(theta_r) over the hemisphere.

The lobe is even about the plane of incidence: rules cover the half with sin(phi_r) >= 0, and their weights count twice.
Each is a product of Gauss-Legendre rules on panels that halve toward wherever the lobe changes fastest.
"""

import functools
import math

import numpy as np

from gonio.typing import Floats


@functools.cache
def gauss(order: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights on [-1, 1], read-only: made once, for that takes longer than most sums."""
    rule = np.polynomial.legendre.leggauss(order)
    for array in rule:
        array.setflags(write=False)
    return rule


def about_mirror(theta: float, narrow: float, steep: float, order: int) -> tuple[Floats, Floats]:
    """Directions (..., 3) and weights, in polar coordinates (r, psi) about the mirror point in the disc of cosines.

    There 1 - |v|^2 = (R - r)(r + R'), with R and -R' where the line leaves the disc. Panels in r halve toward the
    mirror and toward the horizon; r runs quadratically into R, where the integrand is a function of cos(theta_r);
    panels in psi shrink toward pi/2, where R changes fastest for a grazing source.

    Parameters
    ----------
    theta
        Polar angle of the source [rad], below pi/2.
    narrow
        The lobe's narrowest possible width, in cosines.
    steep
        Shadowing changes at cosines of 1/`steep`.
    order
        Nodes in each panel.
    """
    cos_i, sin_i = math.cos(theta), math.sin(theta)
    psi_steps = 0.25 ** np.arange(max(1, math.ceil(-math.log(cos_i) / math.log(4.0)) + 1))
    psi, w_psi = panels(math.pi / 2 * np.unique(np.concatenate([1.0 - psi_steps, [1.0], 1.0 + psi_steps])), order)
    t, w_t = panels(halved([(0.0, _halvings(narrow / 2.0)), (1.0, _halvings(1.0 / steep))], 1.0), order)
    along = -sin_i * np.cos(psi)  # of the mirror point (-sin_i, 0), along the ray
    root = np.sqrt(cos_i * cos_i + along * along)
    # the ray leaves the disc at R = -along + root; without cancellation on either side
    big = np.abs(along) + root
    other = cos_i * cos_i / big
    edge, back = np.where(along > 0, other, big), np.where(along > 0, big, other)
    left = (1.0 - t) ** 2  # (R - r)/R
    r = edge[:, None] * (1.0 - left)
    z = np.sqrt(edge[:, None] * left * (r + back[:, None]))
    directions = np.stack([-sin_i + r * np.cos(psi)[:, None], r * np.sin(psi)[:, None], z], axis=-1)
    return directions, 4.0 * w_psi[:, None] * (r * edge[:, None] * (1.0 - t)) * w_t


def about_source(theta: float, narrow: float, critical: float, order: int) -> tuple[Floats, Floats]:
    """Directions (..., 3) and weights, in polar coordinates (u, psi) about the direction to the source.

    u = 2 theta_h, so that total reflection sets in along a circle; psi runs from the mirror side to the horizon. Panels
    in u halve toward that circle, toward the mirror, and toward the circles that touch the horizon; panels in psi
    toward the plane of incidence and the horizon.

    Parameters
    ----------
    theta, narrow, order
        As `about_mirror` has them.
    critical
        The angle theta_h from which on reflection is total [rad].
    """
    cos_i, sin_i = math.cos(theta), math.sin(theta)
    depth, top = _halvings(narrow / 2.0), math.pi / 2 + theta
    u, w_u = panels(
        halved([(2.0 * critical, 24), (2.0 * theta, depth), (math.pi / 2 - theta, 16), (top, 16)], top), order
    )
    share, w_share = panels(halved([(0.0, depth), (1.0, 3 + _halvings(cos_i))], 1.0), order)
    cos_u, sin_u = np.cos(u), np.sin(u)
    reach = np.arccos(np.clip(-cos_u * cos_i / np.maximum(sin_u * sin_i, 1e-300), -1.0, 1.0))
    psi = np.multiply.outer(reach, share)
    along, across = sin_u[:, None] * np.cos(psi), sin_u[:, None] * np.sin(psi)
    z = np.maximum(cos_u[:, None] * cos_i + along * sin_i, 0.0)
    directions = np.stack([cos_u[:, None] * sin_i - along * cos_i, across, z], axis=-1)
    return directions, 2.0 * (w_u * sin_u * reach)[:, None] * z * w_share


def _halvings(scale: float) -> int:
    """How many times 1 is halved to come to a scale, at most 40."""
    return min(40, max(0, math.ceil(-math.log2(max(scale, 1e-12)))))


def halved(centres: list[tuple[float, int]], top: float) -> Floats:
    """Edges of panels of [0, top] that halve toward each centre; beside it stands how often."""
    steps = [centre + np.outer((-1.0, 1.0), 0.5 ** np.arange(1.0, depth + 1.0)).ravel() for centre, depth in centres]
    edges = np.unique(np.concatenate([[0.0, top], [centre for centre, _ in centres], *steps]))
    edges = edges[(edges >= 0.0) & (edges <= top)]
    return np.asarray(edges[np.append(True, np.diff(edges) > 1e-14)])


def panels(edges: Floats, order: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights of an order in each interval between `edges`."""
    x, w = gauss(order)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1.0 + x)).ravel(), (half * w).ravel()
