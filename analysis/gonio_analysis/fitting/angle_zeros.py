"""What the zeros of the arms do to the values of a table, by the model that is fitted.

A reduction takes the slopes of its columns `s_theta_i_zero` and `s_theta_r_zero` from neighbouring points. Those of a
run that chose its points are few and far apart: where facets hide each other, toward grazing, a column can have the
wrong sign, and a fit that many such points decide would state too small an uncertainty. The fitted model knows the
slopes. The provenance of such a table names the zeros' uncertainties (`zeros_rad`).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import Observations

IN_PLANE = 2e-3
"""Directions [rad] closer to the plane of incidence lie in it: more than an encoder's step."""
MOST = 0.5 * math.pi - 1e-6
"""Polar angles [rad] are held below this where an arm is moved in thought."""


def by_model(data: Observations, model: Any, predicted: Floats) -> Observations:
    """The same values, their changes by the zeros of the arms being those of a model.

    A value stands for f(true) cos(true theta_i) / cos(read theta_i). Points out of the plane of incidence keep what the
    table says: there a zero turns both arms' plane.

    Parameters
    ----------
    data
        As a table states it; `zeros_rad` names what is replaced.
    model
        The model that is fitted.
    predicted
        Its values in the directions of `data` [1/sr].
    """
    known = data.covariance
    if known is None or not data.zeros_rad:
        return data
    d, common = data.directions, known.common.copy()
    in_plane = np.abs(np.sin(d.dphi)) * np.sin(d.theta_r) < IN_PLANE
    in_plane &= (data.brdf > 0.0) & (predicted > 0.0)
    for cause, u in data.zeros_rad.items():
        if cause not in known.causes or not in_plane.any():
            continue
        column = known.causes.index(cause)
        up, down = (_moved(data, model, cause, by) for by in (u, -u))
        # columns are as large as the measured values, and are scaled to the model's later
        effect = 0.5 * (up - down) * data.brdf / np.where(predicted > 0.0, predicted, 1.0)
        sign = math.copysign(1.0, float(np.sum((common[:, column] * effect / known.random**2)[in_plane])))
        common[in_plane, column] = sign * effect[in_plane]
    return replace(data, covariance=replace(known, common=common))


def _moved(data: Observations, model: Any, cause: str, by: float) -> Floats:
    """The values where an arm truly stands `by` [rad] beside what was read."""
    d = data.directions
    theta_i, signed = d.theta_i, d.signed
    if cause == "theta_i_zero":
        theta_i = np.minimum(theta_i + by, MOST)
    else:
        signed = np.clip(signed + by, -MOST, MOST)
    phi_i = d.phi_i + np.where(theta_i < 0.0, math.pi, 0.0)
    phi_r = d.phi_i + np.where(signed < 0.0, 0.0, math.pi)
    there = replace(data, directions=Directions(np.abs(theta_i), phi_i, np.abs(signed), phi_r))
    return apparent(model, there) * np.cos(theta_i) / np.cos(d.theta_i)
