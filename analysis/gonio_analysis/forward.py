"""What an instrument would measure of a model: the forward model of fits and of the theory curves in plots."""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio_analysis.observations import Observations
from gonio_analysis.uncertainty import Floats

NO_WAVELENGTH_NM = 550.0
"""Given to models whose value does not depend on it, in a broad band."""


def apparent(model: Any, at: Observations, *, quick: bool = False) -> Floats:
    """The BRDF [1/sr] that the instrument of a table sees of `model` in its directions.

    Averaged over the cones of source and receiver, the specular spike carried through the integral
    (`gonio.instrument.apparent_brdf`, spike "exact"). In a broad band (wavelength NaN) the model has to be one whose
    value does not depend on the wavelength. `quick` takes the lobe at the centre of the cones, for searches.
    """
    out = np.empty(len(at))
    for wavelength in at.wavelengths:
        rows = np.isnan(at.wavelength_nm) if np.isnan(wavelength) else at.wavelength_nm == wavelength
        out[rows] = seen(
            model,
            at.theta_i[rows],
            at.phi_i[rows],
            at.theta_r[rows],
            at.phi_r[rows],
            wavelength_nm=NO_WAVELENGTH_NM if np.isnan(wavelength) else wavelength,
            cones=(at.source_solid_angle_sr, at.receiver_solid_angle_sr),
            quick=quick,
        )
    return out


def seen(
    model: Any,
    theta_i: Floats,
    phi_i: Floats,
    theta_r: Floats,
    phi_r: Floats,
    *,
    wavelength_nm: float,
    cones: tuple[float, float],
    quick: bool = False,
) -> Floats:
    """As `apparent`, in the directions [rad] given, through cones of (source, receiver) solid angle [sr].

    Without a cone on either side a specular spike has no finite value: then the model without its spike is returned.
    """
    centre = cones == (0.0, 0.0) or quick
    lobe = np.asarray(model.brdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wavelength_nm)) if centre else None
    if lobe is not None and (cones == (0.0, 0.0) or not hasattr(model, "specular_reflectivity")):
        return lobe
    from gonio.instrument import apparent_brdf, apparent_spike

    value = (apparent_brdf if lobe is None else apparent_spike)(
        model,
        theta_i,
        phi_i,
        theta_r,
        phi_r,
        wavelength_nm=wavelength_nm,
        source_solid_angle_sr=cones[0],
        receiver_solid_angle_sr=cones[1],
        spike="exact",
    )
    return np.asarray(value, dtype=np.float64) + (0.0 if lobe is None else lobe)
