"""What errors of the arms' angles do to the values of a table, by the model that is fitted.

A reduction takes the slopes of its columns `s_theta_i_zero` and `s_theta_r_zero` from neighbouring points. Those of a
run that chose its points are few and far apart: where facets hide each other, toward grazing, a column can have the
wrong sign, and a fit that many such points decide would state too small an uncertainty. Elsewhere no value shows how
steep a lobe is between two points, and `u_random` holds the uncertainty of that slope. The fitted model knows the
slopes. The provenance of such a table names the uncertainties of the zeros (`zeros_rad`) and of the encoders' readings
(`readings_rad`), and its column `u_angles` says what readings have added to `u_random`.
"""

import itertools
import math
from collections.abc import Mapping
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
EXTREME = 2.6
"""Standard deviations that an error of a zero hardly exceeds: one in a hundred does."""


def by_model(data: Observations, model: Any, predicted: Floats) -> Observations:
    """The same values, their changes by errors of the arms' angles being those of a model.

    A value stands for f(true) cos(true theta_i) / cos(read theta_i). Points out of the plane of incidence keep what the
    table says: there a zero turns both arms' plane.

    Parameters
    ----------
    data
        As a table states it; `zeros_rad`, `readings_rad` and `u_angles` name what is replaced.
    model
        The model that is fitted.
    predicted
        Its values in the directions of `data` [1/sr], by the quick forward model.
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
        up, down = (_moved(data, model, {cause: by}) for by in (u, -u))
        # columns are as large as the measured values, and are scaled to the model's later
        effect = 0.5 * (up - down) * data.brdf / np.where(predicted > 0.0, predicted, 1.0)
        sign = math.copysign(1.0, float(np.sum((common[:, column] * effect / known.random**2)[in_plane])))
        common[in_plane, column] = sign * effect[in_plane]
    random = known.random.copy()
    if data.u_angles.size:
        by_readings = _of_readings(data, model, predicted)
        rest = np.sqrt(np.maximum(known.random**2 - data.u_angles**2, (1e-6 * known.total) ** 2))
        random[in_plane] = np.hypot(rest, by_readings)[in_plane]
    return replace(data, covariance=replace(known, random=random, common=common))


def _of_readings(data: Observations, model: Any, predicted: Floats) -> Floats:
    """Standard uncertainties [1/sr] by the encoders' readings.

    Beside the edge of a spike values are not normally distributed: most visits see nothing of it, and a few see much.
    What stands for it is the largest departure from the slopes, with both arms anywhere within their counts.
    """
    odd, variance = {}, np.zeros(len(data))
    for cause, u in data.readings_rad.items():
        up, down = (_moved(data, model, {cause: by}, quick=True) for by in (u, -u))
        odd[cause] = 0.5 * (up - down)
        variance += odd[cause] ** 2
    far = {c: math.sqrt(3.0) * u + EXTREME * data.zeros_rad.get(c, 0.0) for c, u in data.readings_rad.items()}
    most = np.zeros(len(data))
    for signs in itertools.product((1.0, -1.0), repeat=len(far)):
        by = {cause: sign * off for sign, (cause, off) in zip(signs, far.items(), strict=True)}
        straight = sum((odd[c] * (off / data.readings_rad[c]) for c, off in by.items()), predicted)
        most = np.maximum(most, np.abs(_moved(data, model, by, quick=True) - straight))
    return np.asarray(np.hypot(np.sqrt(variance), most))


def _moved(data: Observations, model: Any, by: Mapping[str, float], *, quick: bool = False) -> Floats:
    """The values where arms truly stand so far [rad] beside what was read."""
    d = data.directions
    theta_i, signed = d.theta_i, d.signed
    theta_i = np.minimum(theta_i + by.get("theta_i_zero", 0.0), MOST)
    signed = np.clip(signed + by.get("theta_r_zero", 0.0), -MOST, MOST)
    phi_i = d.phi_i + np.where(theta_i < 0.0, math.pi, 0.0)
    phi_r = d.phi_i + np.where(signed < 0.0, 0.0, math.pi)
    there = replace(data, directions=Directions(np.abs(theta_i), phi_i, np.abs(signed), phi_r))
    return apparent(model, there, quick=quick) * np.cos(theta_i) / np.cos(d.theta_i)
