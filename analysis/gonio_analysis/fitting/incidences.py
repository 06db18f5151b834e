"""The directions of the source that a table has, and the angles at which a model's reflectance is asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from gonio.geometry import SAME_ANGLE, SAME_AZIMUTH, wrap
from gonio_analysis.fitting.observations import Observations

EIGHT = math.radians(8.0)
"""The incidence of integrating spheres."""
MOST = 9
"""Incidences of a long list that are evaluated, evenly, both ends included."""


@dataclass(frozen=True)
class Incidence:
    """One direction of the source, and the values measured at it."""

    theta_i: float
    phi_i: float
    rows: npt.NDArray[np.intp]


def incidences(data: Observations) -> list[Incidence]:
    """The directions of the source: angles of incidence within 0.4 degrees and azimuths within 2 are one."""
    theta, phi = data.directions.theta_i, wrap(np.asarray(data.directions.phi_i))
    out = []
    order = np.argsort(theta, kind="stable")
    for ring in np.split(order, np.flatnonzero(np.diff(theta[order]) > SAME_ANGLE) + 1):
        if theta[ring].mean() < SAME_ANGLE:
            out.append(Incidence(float(theta[ring].mean()), 0.0, ring))
            continue
        turned = ring[np.argsort(phi[ring], kind="stable")]
        for group in np.split(turned, np.flatnonzero(np.diff(phi[turned]) > SAME_AZIMUTH) + 1):
            out.append(Incidence(float(theta[group].mean()), float(phi[group].mean()), group))
    return out


def angles(data: Observations) -> list[float]:
    """Angles of incidence [rad] at which models are asked: those of the table, and the 8 degrees of spheres."""
    found = sorted({round(i.theta_i, 4) for i in incidences(data)})
    apart = [found[0]] + [b for a, b in pairwise(found) if b - a > SAME_ANGLE]
    if len(apart) > MOST:
        apart = [apart[k] for k in np.unique(np.linspace(0, len(apart) - 1, MOST).round().astype(int))]
    return sorted([*apart, *([EIGHT] if all(abs(a - EIGHT) > SAME_ANGLE for a in apart) else [])])
