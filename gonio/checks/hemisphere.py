"""Directional-hemispherical reflectance of measured values, integrated where their sampling allows."""

import math
from dataclasses import dataclass, field

import numpy as np

from gonio.checks.values import CheckedValues, Incidence, incidences
from gonio.geometry import SAME_AZIMUTH
from gonio.typing import Floats

COVERED = 0.85
"""Share of the hemisphere's projection that the measured directions have to surround."""
MOST = 16
"""Directions of the source at which a table is integrated, evenly taken of very many."""
ROUGH = 0.25
"""Relative uncertainty above which an integral of a table says too little."""


@dataclass(frozen=True)
class Hemispherical:
    """Directional-hemispherical reflectance at one direction of the source."""

    theta_i_deg: float
    rho_dh: float | None
    """None where the values do not allow it."""
    why: str
    """Why there is none, or what was assumed."""
    u_sampling: float = 0.0
    """Standard uncertainty from interpolation between the directions, and from what lies beyond them."""
    u_values: float | None = None
    """Standard uncertainty from that of the values, with their whole covariance; None where they state none."""
    u_independent: float | None = None
    """The same, were every value's whole uncertainty independent of the others'."""
    weights: Floats = field(default_factory=lambda: np.zeros(0), repr=False, compare=False)
    """(n,) how much of each value is in it, where the values state uncertainties."""

    @property
    def u(self) -> float:
        """Combined standard uncertainty."""
        return math.hypot(self.u_sampling, self.u_values or 0.0)


def reflectances(data: CheckedValues) -> list[Hemispherical]:
    """At each direction of the source.

    The measured values are interpolated in a triangulation of the hemisphere's projection onto the sample, in which an
    area is a solid angle times cos(theta_r). Where only one side of the plane of incidence was measured the other one
    is taken as its mirror image. The uncertainty has the values', half the difference to interpolated logarithms, and
    all that lies beyond the outermost directions (which take the outermost values). Where it cannot be done, `why` says
    so.
    """
    found = incidences(data.directions)
    picks = np.unique(np.linspace(0, len(found) - 1, min(MOST, len(found))).round().astype(int))
    return [_integrated(data, found[k]) for k in picks]


def _integrated(data: CheckedValues, at: Incidence) -> Hemispherical:
    from scipy.spatial import Delaunay, QhullError

    theta_deg = math.degrees(at.theta_i)
    where = data.directions[at.rows]
    sine = np.sin(where.theta_r)
    x, y = sine * np.cos(where.dphi), sine * np.sin(where.dphi)
    f, rows = data.brdf[at.rows], at.rows
    away = np.abs(y) > np.sin(SAME_AZIMUTH) * np.maximum(sine, 0.1)
    if np.count_nonzero(away) < 6:
        return Hemispherical(theta_deg, None, "only the plane of incidence was measured")
    mirrored = "" if (y[away] > 0).any() and (y[away] < 0).any() else "the other side taken as the mirror image"
    if mirrored:
        x, y, f, rows = (np.concatenate([a, b[away]]) for a, b in ((x, x), (y, -y), (f, f), (rows, rows)))
    try:
        mesh = Delaunay(np.stack([x, y], axis=1))
    except QhullError:
        return Hemispherical(theta_deg, None, "the directions lie on one line")
    corners = mesh.points[mesh.simplices]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    covered = float(area.sum()) / math.pi
    if covered < COVERED:
        return Hemispherical(theta_deg, None, f"the directions surround {100 * covered:.0f} % of the hemisphere")
    weight = np.zeros(f.size)
    np.add.at(weight, mesh.simplices.ravel(), np.repeat(area / 3.0, 3))
    inside = float(weight @ f)
    logarithmic = float(area @ np.exp(np.log(np.maximum(f[mesh.simplices], 1e-12)).mean(axis=1)))
    rim = np.unique(mesh.convex_hull)
    outside = max(math.pi * (1.0 - covered), 0.0) * float(np.median(f[rim]))
    total, sampling = inside + outside, math.hypot(0.5 * (inside - logarithmic), outside)
    of_values, independent, each = None, None, np.zeros(0)
    if data.random is not None and data.common is not None:
        each = np.zeros(len(data))
        np.add.at(each, rows, weight)
        np.add.at(each, rows[rim], math.pi * max(1.0 - covered, 0.0) / rim.size)  # as a cause that scales all has it
        of_values = math.hypot(float(np.linalg.norm(each * data.random)), float(np.linalg.norm(each @ data.common)))
        independent = float(np.linalg.norm(each * data.u))
    found = Hemispherical(theta_deg, total, mirrored, sampling, of_values, independent, each)
    if found.u > ROUGH * abs(total):
        return Hemispherical(theta_deg, None, f"too few directions: {total:.2g} would be uncertain by {found.u:.2g}")
    return found
