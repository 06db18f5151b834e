"""Degree and azimuth of polarisation, from a polariser that is turned (docs/calibrate_light.md)."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.calibration.tables import read_numbers
from gonio.errors import DataError
from gonio.typing import Floats

FEWEST = 6


@dataclass(frozen=True, slots=True)
class Polarised:
    """What a turned polariser tells."""

    degree: float
    azimuth_deg: float
    """In [0, 180)."""
    covariance: Floats
    """Of degree and azimuth [deg]."""


def polarised(path: str | Path) -> Polarised:
    """From a table `polariser_deg, signal` and, where known, `u_signal`: signal = I (1 + P cos 2 (angle - azimuth)).

    Without `u_signal` all values count alike, and their scatter around the curve tells the uncertainty.

    Raises
    ------
    DataError
        The table is damaged, the angles cover too little, or the signal does not follow the curve.
    """
    table = read_numbers(path, ("polariser_deg", "signal"), ("u_signal",))
    angle, y = np.radians(table["polariser_deg"].to_numpy()), table["signal"].to_numpy()
    if len(y) < FEWEST:
        raise DataError(f"{path}: {len(y)} angles of the polariser; at least {FEWEST} over half a turn are needed")
    weight = np.ones(len(y))
    if "u_signal" in table:
        if (table["u_signal"] <= 0).any():
            raise DataError(f"{path}: u_signal must be above 0")
        weight = 1.0 / table["u_signal"].to_numpy()
    design = np.stack([np.ones(len(y)), np.cos(2 * angle), np.sin(2 * angle)], axis=1) * weight[:, None]
    normal = design.T @ design
    if np.linalg.cond(normal / normal[0, 0]) > 100.0:
        raise DataError(f"{path}: the angles of the polariser cover too little: turn it over 180 deg in even steps")
    covariance = np.linalg.inv(normal)
    mean, cosine, sine = covariance @ design.T @ (y * weight)
    if mean <= 0:
        raise DataError(f"{path}: the signal is not above 0")
    reduced = float(np.sum((y * weight - design @ [mean, cosine, sine]) ** 2)) / (len(y) - 3)
    covariance *= reduced if "u_signal" not in table else max(reduced, 1.0)
    size = math.hypot(cosine, sine)
    degree, azimuth = size / mean, 0.5 * math.degrees(math.atan2(sine, cosine)) % 180.0
    if degree > 1.0:
        raise DataError(
            f"{path}: the signal would have a degree of polarisation of {degree:.3g}: was the dark left in?"
        )
    at = max(size, math.sqrt(covariance[1, 1]))  # the azimuth of no polarisation is any
    jacobian = np.array(
        [
            [-degree / mean, cosine / (at * mean), sine / (at * mean)],
            [0.0, -0.5 * math.degrees(sine / at**2), 0.5 * math.degrees(cosine / at**2)],
        ]
    )
    return Polarised(degree, azimuth, jacobian @ covariance @ jacobian.T)
