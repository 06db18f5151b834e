"""The directions of the source that a table has, and the angles at which a model's reflectance is asked for."""

from __future__ import annotations

import math

import numpy as np

from gonio.checks import values
from gonio.checks.values import Incidence
from gonio.geometry import SAME_ANGLE
from gonio_analysis.fitting.observations import Observations

EIGHT = math.radians(8.0)
"""The incidence of integrating spheres."""
MOST = 9
"""Incidences of a long list that are evaluated, evenly, both ends included."""


def incidences(data: Observations) -> list[Incidence]:
    """The directions of the source: angles of incidence within 0.4 degrees and azimuths within 2 are one."""
    return values.incidences(data.directions)


def angles(data: Observations) -> list[float]:
    """Angles of incidence [rad] at which models are asked: those of the table, and the 8 degrees of spheres."""
    found = sorted({round(i.theta_i, 4) for i in incidences(data)})
    apart = values.apart(found)
    if len(apart) > MOST:
        apart = [apart[k] for k in np.unique(np.linspace(0, len(apart) - 1, MOST).round().astype(int))]
    return sorted([*apart, *([EIGHT] if all(abs(a - EIGHT) > SAME_ANGLE for a in apart) else [])])
