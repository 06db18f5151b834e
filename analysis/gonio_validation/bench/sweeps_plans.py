"""The plans and samples that `gonio bench sweeps` compares, and how a curve is made of their points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from gonio_sweeps.curve import Curve
from gonio_sweeps.online import GrowingValues

from gonio import models
from gonio.acquisition.plan import Adaptive, Assessed, Plan, Point, assess, canonical
from gonio.acquisition.plan_tables import HalfVector, Hemisphere
from gonio.geometry import Directions, direction
from gonio.models import Model
from gonio.rig.description import RigDescription
from gonio.typing import Floats

Geometry = Literal["in plane", "hemisphere"]
WAVELENGTH_NM = 500.0
INCIDENCES: dict[Geometry, tuple[float, ...]] = {"in plane": (30.0, 60.0), "hemisphere": (45.0,)}
LARGEST_DEG = 80.0
"""theta_r goes so far."""
SIZES: dict[Geometry, tuple[int, ...]] = {"in plane": (20, 35, 60), "hemisphere": (50, 100)}
"""Points of the fixed plans, for each angle of incidence."""
AROUND_DEG = 12.0
"""So far around the mirror direction a mirror-dense plan has the other half of its points."""
FLOOR = 1e-3
"""Of the largest value: errors of values below it count relative to this value."""

SAMPLES: dict[str, tuple[str, dict[str, object]]] = {
    "rough aluminium": ("he-torrance", {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al"}),
    "aluminium": ("he-torrance", {"sigma0_um": 0.16, "tau_um": 1.5, "ior": "Al"}),
    "matte": ("oren-nayar", {"albedo": 0.8, "sigma_deg": 25.0}),
    "satin": ("cook-torrance", {"s": 0.3, "m": 0.2, "diffuse_albedo": 0.5, "ior": 1.5}),
    "semi-gloss": ("blinn", {"k_d": 0.4, "k_s": 0.3, "c": 0.12, "ior": 1.5}),
    "glossy paint": ("cook-torrance", {"s": 0.4, "m": 0.05, "diffuse_albedo": 0.5, "ior": 1.5}),
    "retroreflecting": ("retroreflecting", {"returned": 0.1, "width_deg": 4.0, "diffuse_albedo": 0.4}),
    "brushed metal": ("anisotropic", {"alpha_along": 0.08, "alpha_across": 0.25, "ior": "Al"}),
}


def sample(name: str) -> Model:
    """A sample of `SAMPLES`."""
    return models.build(*SAMPLES[name])


@dataclass(frozen=True)
class Places:
    """Directions in which curves are judged: those of the rig that the blocked cone leaves."""

    directions: Directions
    weight: Floats
    """Their share of the angle, or of the hemisphere."""


def judged(geometry: Geometry, description: RigDescription) -> Places:
    """Between the points that plans have, too."""
    incidences = INCIDENCES[geometry]
    if geometry == "in plane":
        # finer than any plan
        signed = np.arange(-LARGEST_DEG, LARGEST_DEG + 0.01, 0.5)
        points = [canonical(i, 0.0, r, 180.0) for i in incidences for r in signed]
    else:
        points = [
            canonical(i, 0.0, r, d) for i in incidences for d in np.arange(0.0, 360.0, 11.0)
            for r in np.arange(2.5, LARGEST_DEG - 4.0, 2.5)
        ]  # fmt: skip
    reached = [a.point for a in assess(_plan(points), description) if a.pose is not None]
    d = Plan("", (WAVELENGTH_NM,), tuple(reached), 0, "").directions
    weight = np.ones(d.shape) if geometry == "in plane" else np.sin(d.theta_r)
    return Places(d, weight / weight.sum())


def _plan(points: Sequence[Point], adaptive: Adaptive | None = None) -> Plan:
    return Plan("bench", (WAVELENGTH_NM,), tuple(points), 0, "bench", adaptive)


def fixed(name: str, geometry: Geometry, size: int, description: RigDescription) -> list[Assessed]:
    """The points of a plan of so many for each incidence, as far as the rig can reach them.

    Parameters
    ----------
    name
        "uniform", "mirror-dense" or "half-vector".
    """
    rows: list[tuple[float, float, float, float]] = []
    for i in INCIDENCES[geometry]:
        rows += (_in_plane if geometry == "in plane" else _hemisphere)(name, i, size)
    points = tuple(dict.fromkeys(canonical(*row) for row in rows))
    return [a for a in assess(_plan(points), description) if a.pose is not None]


Rows = list[tuple[float, float, float, float]]


def _in_plane(name: str, theta_i: float, size: int) -> Rows:
    if name == "half-vector":
        found: Rows = []
        extra = 0
        while len(found) < size:  # some half vectors lie beyond the largest theta_r
            theta_h = _spaced(size // 2 + extra, 0.5 * (LARGEST_DEG + theta_i))
            grid = _half_vectors(theta_i, theta_h)
            found = [row for row in grid.rows() if row[2] <= LARGEST_DEG + 1e-9]
            extra += 1
        return found
    even = np.linspace(-LARGEST_DEG, LARGEST_DEG, size if name == "uniform" else size - size // 2)
    near = np.linspace(max(theta_i - AROUND_DEG, -LARGEST_DEG), min(theta_i + AROUND_DEG, LARGEST_DEG), size // 2)
    signed = even if name == "uniform" else np.union1d(even, near)
    return [(theta_i, 0.0, float(r), 180.0) for r in signed]


def _hemisphere(name: str, theta_i: float, size: int) -> Rows:
    count = size if name == "uniform" else size - size // 2
    even = Hemisphere.model_validate({"theta_i_deg": [theta_i], "count": count, "theta_r_max_deg": LARGEST_DEG})
    if name == "uniform":
        return list(even.rows())
    azimuths = max(4, 2 * round(math.sqrt(size) / 2.0))
    phi = tuple(float(x) for x in np.linspace(0.0, 360.0, azimuths, endpoint=False))
    if name == "mirror-dense":
        theta_h = np.linspace(0.0, 0.5 * AROUND_DEG, max(2, size // 2 // azimuths + 1)).tolist()
        near = _half_vectors(theta_i, theta_h, phi)
        return [*even.rows(), *near.rows()]
    theta_h = _spaced(max(3, round(1.5 * size / azimuths)), 80.0)
    grid = _half_vectors(theta_i, theta_h, phi)
    return [row for row in grid.rows() if row[2] <= LARGEST_DEG + 1e-9]


def _half_vectors(theta_i: float, theta_h: Sequence[float], phi_h: Sequence[float] = (0.0, 180.0)) -> HalfVector:
    keys = {"theta_i_deg": [theta_i], "theta_h_deg": list(theta_h), "phi_h_deg": list(phi_h)}
    return HalfVector.model_validate(keys)


def _spaced(count: int, largest: float, narrow: float = 4.0) -> list[float]:
    """Angles from 0, even in asinh(theta/narrow): dense at 0."""
    return [float(x) for x in narrow * np.sinh(np.linspace(0.0, math.asinh(largest / narrow), count))]


def sampler(geometry: Geometry, description: RigDescription, most_points: int | None) -> Curve:
    """The adaptive plan: by rig time, or where a number of points is given by points."""
    keys: dict[str, object] = {
        "theta_i_deg": list(INCIDENCES[geometry]),
        "theta_r_deg": {"start": -LARGEST_DEG, "stop": LARGEST_DEG, "step": 1.0 if geometry == "in plane" else 5.0},
    }
    if geometry == "hemisphere":
        keys["dphi_deg"] = [float(x) for x in range(15, 180, 15)]
    if most_points is not None:
        keys["most_points"] = most_points
    return Curve(_plan([], Adaptive(how="curve", budget_h=1000.0, **keys)), description)


def interpolated(values: GrowingValues, at: Directions) -> Floats:
    """The usual way: in plane monotone cubics through logarithms, out of it linear ones over Delaunay's triangles.

    Values that are not above zero are replaced by the smallest that is. Beyond the outermost triangles the nearest
    value counts.
    """
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator, PchipInterpolator

    d = values.directions
    logs = np.log(np.maximum(values.brdf, values.brdf[values.brdf > 0].min()))
    out = np.empty(at.shape)
    nominal = np.round(np.degrees(at.theta_i))
    for i in np.unique(nominal):
        own = np.flatnonzero(np.abs(np.degrees(d.theta_i) - i) < 0.5)
        here = np.flatnonzero(nominal == i)
        if bool(d[own].in_plane.all()) and bool(at[here].in_plane.all()):
            x, inverse = np.unique(d.signed[own], return_inverse=True)
            mean = np.bincount(inverse, logs[own]) / np.bincount(inverse)
            out[here] = PchipInterpolator(x, mean)(at.signed[here])
            continue
        flat = direction(d.theta_r, d.phi_r - d.phi_i)[own, :2]
        where = direction(at.theta_r, at.phi_r - at.phi_i)[here, :2]
        linear = LinearNDInterpolator(flat, logs[own])(where)
        near = NearestNDInterpolator(flat, logs[own])(where)
        out[here] = np.where(np.isfinite(linear), linear, near)
    return np.asarray(np.exp(out))
