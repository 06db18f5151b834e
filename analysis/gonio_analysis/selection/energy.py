"""Directional-hemispherical reflectance rho_dh, of a fitted model and of a measurement itself."""

from __future__ import annotations

import math

import numpy as np

from gonio.geometry import SAME_AZIMUTH
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import NO_WAVELENGTH_NM, ByWavelength
from gonio_analysis.fitting.incidences import Incidence, angles, incidences
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.result_records import Reflectance

STEP = 1e-3
"""Of derivatives by the parameters, on the search scale; right to a thousandth where integrals are to `TOLERANCE`."""
TOLERANCE = 1e-6
ABOVE_ONE = 1e-4
"""What a model may reflect beyond all that it receives: far below any uncertainty, above the error of the integral."""
COVERED = 0.85
"""Share of the hemisphere's projection that the measured directions have to surround."""
MOST = 16
"""Directions of the source at which a table is integrated, evenly taken of very many."""
ROUGH = 0.25
"""Relative uncertainty above which an integral of a table says too little."""


def of_model(result: FitResult) -> list[Reflectance]:
    """rho_dh of a fitted model at `angles`, with the standard uncertainty of the fit's covariance.

    Empty for a fit of several wavelengths together, which has a model for each.
    """
    if isinstance(result.model, ByWavelength):
        return []
    theta = np.array(angles(result.data))
    phi = float(result.data.directions.phi_i[0])
    wave = NO_WAVELENGTH_NM if math.isnan(result.wavelength_nm) else result.wavelength_nm
    value = _rho(result.model, theta, phi, wave)
    lower, upper = result.problem.bounds
    slopes = []
    for k in range(result.vector.size):
        up, down = result.vector.copy(), result.vector.copy()
        up[k], down[k] = min(up[k] + STEP, upper[k]), max(down[k] - STEP, lower[k])
        high, low = (_rho(result.problem.model(x), theta, phi, wave) for x in (up, down))
        slopes.append((high - low) / (up[k] - down[k]))
    jacobian = np.array(slopes)
    felt = np.abs(jacobian).max(axis=1) > 1e-9
    spread = result.spread[np.ix_(felt, felt)]
    variance = np.einsum("ki,kl,li->i", jacobian[felt], spread, jacobian[felt])
    u = np.sqrt(np.maximum(variance, 0.0))
    return [
        Reflectance(math.degrees(t), float(r), float(e) if math.isfinite(e) else None, "")
        for t, r, e in zip(theta, value, u, strict=True)
    ]


def _rho(model: object, theta: Floats, phi: float, wave: float) -> Floats:
    return np.asarray(
        model.directional_hemispherical(theta, phi_i=phi, wavelength_nm=wave, tolerance=TOLERANCE)  # type: ignore[attr-defined]
    )


def of_table(data: Observations) -> list[Reflectance]:
    """rho_dh of the measurement at each direction of its source, integrated where the sampling allows.

    The measured values are interpolated in a triangulation of the hemisphere's projection onto the sample, in which an
    area is a solid angle times cos(theta_r). Where only one side of the plane of incidence was measured the other one
    is taken as its mirror image. The uncertainty has the values', half the difference to interpolated logarithms, and
    all that lies beyond the outermost directions (which take the outermost values). Where it cannot be done, `why` says
    so.
    """
    found = incidences(data)
    picks = np.unique(np.linspace(0, len(found) - 1, min(MOST, len(found))).round().astype(int))
    return [_integrated(data, found[k]) for k in picks]


def _integrated(data: Observations, at: Incidence) -> Reflectance:
    from scipy.spatial import Delaunay, QhullError

    theta_deg = math.degrees(at.theta_i)
    where = data.directions[at.rows]
    sine = np.sin(where.theta_r)
    x, y = sine * np.cos(where.dphi), sine * np.sin(where.dphi)
    f, rows = data.brdf[at.rows], at.rows
    away = np.abs(y) > np.sin(SAME_AZIMUTH) * np.maximum(sine, 0.1)
    if np.count_nonzero(away) < 6:
        return Reflectance(theta_deg, None, None, "only the plane of incidence was measured")
    mirrored = "" if (y[away] > 0).any() and (y[away] < 0).any() else "the other side taken as the mirror image"
    if mirrored:
        x, y, f, rows = (np.concatenate([a, b[away]]) for a, b in ((x, x), (y, -y), (f, f), (rows, rows)))
    try:
        mesh = Delaunay(np.stack([x, y], axis=1))
    except QhullError:
        return Reflectance(theta_deg, None, None, "the directions lie on one line")
    corners = mesh.points[mesh.simplices]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    covered = float(area.sum()) / math.pi
    if covered < COVERED:
        return Reflectance(theta_deg, None, None, f"the directions surround {100 * covered:.0f} % of the hemisphere")
    weight = np.zeros(f.size)
    np.add.at(weight, mesh.simplices.ravel(), np.repeat(area / 3.0, 3))
    inside = float(weight @ f)
    positive = np.maximum(f[mesh.simplices], 1e-12)
    logarithmic = float(area @ np.exp(np.log(positive).mean(axis=1)))
    rim = np.unique(mesh.convex_hull)
    outside = max(math.pi * (1.0 - covered), 0.0) * float(np.median(f[rim]))
    total = inside + outside
    variance = (0.5 * (inside - logarithmic)) ** 2 + outside**2
    if data.covariance is not None:
        each = np.zeros(len(data))
        np.add.at(each, rows, weight)
        variance += float(((each * data.covariance.random) ** 2).sum() + ((each @ data.covariance.common) ** 2).sum())
    u = math.sqrt(variance)
    if u > ROUGH * abs(total):
        return Reflectance(theta_deg, None, None, f"too few directions: {total:.2g} would be uncertain by {u:.2g}")
    return Reflectance(theta_deg, total, u, mirrored)
