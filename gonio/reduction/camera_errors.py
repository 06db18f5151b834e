"""What a calibration leaves open of the camera's linearity and stray light, and what that does to values."""

import math

import numpy as np

from gonio.reduction.count_rates import camera_parameters
from gonio.reduction.values import MeasuredBand, Values
from gonio.rig.calibrated import covariance_of
from gonio.rig.description import RigDescription
from gonio.typing import Floats


def camera(measured: MeasuredBand, values: Values) -> None:
    """Add `s_linearity` and `s_stray_light`, as far as a calibration of the camera tells of them.

    A point's change is that of its own rate less that of the reference's, to which it is compared.
    """
    points, visit = measured.points, measured.visit
    by = np.array([point.by_camera for point in points]).reshape(len(points), visit.by_camera.size)
    change = by / measured.level[:, None] - values.brdf[:, None] * visit.by_camera / visit.rate
    values.common |= {name: change @ direction for name, direction in _causes(measured.description).items()}


def _causes(description: RigDescription) -> dict[str, Floats]:
    """Independent directions of the calibration's covariance of the camera, in `camera_parameters`, by their columns.

    The first direction of a cause has the name of the cause; others, where several numbers are known, have a number.
    """
    parameters = camera_parameters(description)
    out: dict[str, Floats] = {}
    for cause in dict.fromkeys(parameters.values()):
        names = [name for name, of in parameters.items() if of == cause]
        values, vectors = np.linalg.eigh(covariance_of(description, names))
        held = [k for k in range(len(names))[::-1] if values[k] > 1e-12 * max(values[-1], 1e-300)]
        for number, k in enumerate(held):
            direction = np.zeros(len(parameters))
            direction[[list(parameters).index(name) for name in names]] = vectors[:, k] * math.sqrt(values[k])
            out[cause if number == 0 else f"{cause}_{number + 1}"] = direction
    return out
