"""What a calibration of a camera looks like: photon transfer, linearity, dark signal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gonio.calibration.camera import CameraCalibration
from gonio.calibration.photon_transfer import FIT_RANGE
from gonio.rig.light_and_camera import Camera
from gonio.shown import with_u

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(found: CameraCalibration, camera: Camera) -> Figure | None:
    """Three panels; None where no photon transfer was made."""
    from matplotlib.figure import Figure

    transfer, curve = found.transfer, found.curve
    if transfer is None or curve is None:
        return None
    figure = Figure(figsize=(14, 4.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    x = transfer.signal_dn
    left.loglog(x, np.maximum(transfer.variance_dn2, 1e-3), "o", ms=4, color="tab:blue", label="pairs")
    line = np.geomspace(max(float(x.min()), 0.5), float(x.max()), 50)
    left.loglog(
        line, transfer.gain * line, color="0.3", lw=1, label=f"K = {with_u(transfer.gain, transfer.u_gain)} DN/e-"
    )
    left.axvline(FIT_RANGE * transfer.saturation_dn, color="tab:green", lw=0.8, ls="--", label="70 % of saturation")
    left.axvline(transfer.saturation_dn, color="tab:orange", lw=0.8, ls="--", label="saturation")
    left.set(xlabel="signal [DN]", ylabel="variance above dark [DN²]", title="Photon transfer")
    left.legend(fontsize="small")

    level = np.linspace(0.0, transfer.saturation_dn, 100)
    departure, u = curve.departure(camera, level), curve.u_departure(camera, level)
    middle.plot(level, 100 * departure, color="tab:blue", label="fitted departure")
    middle.fill_between(level, 100 * (departure - 2 * u), 100 * (departure + 2 * u), alpha=0.25, label="k = 2")
    points = curve.departure(camera, curve.signal_dn) + curve.residuals
    middle.plot(curve.signal_dn.ravel(), 100 * points.ravel(), ".", ms=3, color="0.4", label="parts of the flats")
    spread = max(200 * float(np.max(np.abs(departure))), 0.5)
    middle.set(xlabel="signal [DN]", ylabel="departure [%]", title="Linearity", ylim=(-spread, spread))
    middle.legend(fontsize="small")

    exposures, means = found.darks
    right.plot(exposures, means, "o", ms=4, label="mean of each dark frame")
    rate = found.values["dark_current_e_per_s"] / found.values["electrons_per_dn"]
    right.plot(exposures, found.values["black_level_dn"] + rate * exposures, color="0.3", lw=1, label="line")
    right.set(xlabel="exposure [s]", ylabel="mean [DN]", title="Dark signal")
    right.legend(fontsize="small")
    return figure
