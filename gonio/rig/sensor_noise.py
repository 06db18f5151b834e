"""The noise of a camera's pixels by the linear model of EMVA 1288 (release 4.0, section 2.4)."""

import numpy as np

from gonio.rig.light_and_camera import Camera
from gonio.typing import ArrayLike, Floats


def variance(camera: Camera, charge_e: ArrayLike, *, rounding: bool = True) -> Floats:
    """Variance [e-^2] of pixels from frame to frame: photons, dark electrons, read noise and rounding to whole DN.

    Parameters
    ----------
    charge_e
        Mean charge [e-] of light and dark current together; below 0 counts as 0.
    rounding
        Whether the frame holds whole DN.
    """
    charge = np.asarray(charge_e, dtype=float)
    shot = np.maximum(charge, 0.0) if camera.photon_noise else np.zeros_like(charge)
    steady = camera.read_noise_e**2 + (camera.electrons_per_dn**2 / 12.0 if rounding else 0.0)
    return np.asarray(shot + steady)


def deviation_dn(camera: Camera, charge_e: ArrayLike, *, rounding: bool = True) -> Floats:
    """Standard deviation of the same [DN]."""
    return np.asarray(np.sqrt(variance(camera, charge_e, rounding=rounding)) / camera.electrons_per_dn)


def spread(camera: Camera, charge_e: ArrayLike) -> Floats:
    """Variance [e-^2] among the pixels of one frame before rounding: noise, and what differs by nature."""
    fixed = camera.dsnu_e**2 + (camera.prnu * np.asarray(charge_e, dtype=float)) ** 2
    return np.asarray(variance(camera, charge_e, rounding=False) + fixed)


def rounding_of_mean(camera: Camera, charge_e: ArrayLike, count: int) -> Floats:
    """Variance [e-^2] of the mean of `count` pixels of about the same charge, from rounding to whole DN.

    Pixels round independently where they differ by half a DN or more, from noise or by nature (Widrow's condition: the
    remaining error is below 0.3 % of a DN). Pixels that are all alike round alike.
    """
    step = np.asarray(camera.electrons_per_dn**2)
    if camera.response:  # a step of a curve that is bent
        level = np.asarray(charge_e, dtype=float) / camera.electrons_per_dn + camera.black_level_dn
        step = step * np.interp(level, camera.response, np.gradient(camera.response)) ** 2
    return np.asarray(step / 12.0 / np.where(spread(camera, charge_e) >= 0.25 * step, count, 1))
