"""The lens's vignetting, determined from the beam's profile: the white reference seen from several directions.

Vignetting stays with the pixels, beam and reference stay with the sample. Seen more obliquely, the same spots fall on
other pixels. So ln(signal / known geometry) = level of the direction + ln(1 - v rho^4) + polynomial in x and y.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.errors import DataError
from gonio.rig import Pose, kinematics
from gonio.rig.description import RigDescription
from gonio.rig.imaging import Channel, of_channel, pixel_map
from gonio.typing import Floats

RIM = 0.9
"""Of the reference's radius: what lies inside is used."""
MOST = 20_000
"""Pixels used of each direction."""
BEAM = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (4, 0), (2, 2), (0, 4))
"""Powers of x and y in the beam's profile."""


@dataclass(frozen=True, slots=True)
class Vignetting:
    """`camera.vignetting` and its standard uncertainty, and how far pixels lie from the fit (relative)."""

    value: float
    u: float
    residual: float


def fit(pictures: Sequence[tuple[Floats, Pose]], description: RigDescription, channel: Channel = "mono") -> Vignetting:
    """From mean flats, with their dark signals taken out (NaN where a pixel is not to be used), and their poses.

    Raises
    ------
    DataError
        All are seen from one direction, from which vignetting and beam look alike; or the reference is not in view.
    """
    angles = {round(math.degrees(pose.camera), 1) for _, pose in pictures}
    if max(angles) - min(angles) < 10.0:
        raise DataError(
            "the frames of the field are seen from one direction, from which vignetting and the beam's profile "
            "look alike: "
            "take them from directions that are 10 degrees apart or more"
        )
    camera = description.camera
    plain = description.model_copy(update={"camera": camera.model_copy(update={"vignetting": 0.0})})
    reference = description.reference
    centre = reference.offset_mm if reference.how == "beside" else (0.0, 0.0)
    corner = 0.5 * math.hypot(camera.width, camera.height)
    rows, values = [], []
    for number, (signal, pose) in enumerate(pictures):
        seen = pixel_map(plain, kinematics.view(plain, pose))
        x, y = seen.x_mm - centre[0], seen.y_mm - centre[1]
        radius = 0.5 * reference.diameter_mm
        good = (x**2 + y**2 <= (RIM * radius) ** 2) & np.isfinite(signal) & (seen.weight > 0)
        good &= of_channel(camera.pattern, channel, seen.rows, seen.cols)
        if good.any():
            good &= np.nan_to_num(signal) > 0.2 * np.median(signal[good])
        at = np.flatnonzero(good)[:: max(np.count_nonzero(good) // MOST, 1)]
        if at.size < 100:
            raise DataError(
                "the frames of the field do not hold the white reference where the rig file says that it lies"
            )
        i, j = np.unravel_index(at, signal.shape)
        rho = np.hypot(i - 0.5 * (camera.height - 1), j - 0.5 * (camera.width - 1)) / corner
        u, v = x.ravel()[at] / radius, y.ravel()[at] / radius
        level = np.zeros((len(pictures), at.size))
        level[number] = 1.0
        rows.append(np.vstack([rho**4, level, [u**p * v**q for p, q in BEAM]]).T)
        values.append(np.log(signal.ravel()[at] / seen.weight.ravel()[at]))
    design, value, found = np.vstack(rows), np.concatenate(values), 0.0
    for _ in range(4):  # ln(1 - v rho^4) about the last v
        loss = 1.0 - found * design[:, 0]
        now = design.copy()
        now[:, 0] = -design[:, 0] / loss
        solution, *_ = np.linalg.lstsq(now, value - np.log(loss) + now[:, 0] * found, rcond=None)
        found = float(np.clip(solution[0], -0.5, 0.9))
    left = value - np.log(loss) + now[:, 0] * found - now @ solution
    residual = float(np.sqrt(np.sum(left**2) / max(left.size - solution.size, 1)))
    # pixels keep their responsivities from direction to direction: as many are independent as one picture has
    covariance = np.linalg.inv(now.T @ now) * residual**2 * len(pictures)
    return Vignetting(found, math.sqrt(float(covariance[0, 0])), residual)
