"""What an instrument sees of a model part by part: specular spike, directional diffuse and uniform diffuse."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gonio.instrument.apparent import apparent_lobe, apparent_spike
from gonio.models import Lambert, Model, Sum
from gonio.typing import ArrayLike, Floats

SPECULAR, DIRECTIONAL, UNIFORM = "specular", "directional diffuse", "uniform diffuse"


class Part(NamedTuple):
    """One part of a model."""

    seen: Floats
    """Its part of the BRDF through the cones [1/sr]."""
    reflected: float
    """The share of the incident light that it reflects, its part of rho_dh."""


def uniform(model: Model, wavelength_nm: float) -> float:
    """What a model has beside its facets, the same in every direction [1/sr]; 0 of a model without facets."""
    facets = model.facets(wavelength_nm)
    return 0.0 if facets is None else facets.beside


def parts(
    model: Model,
    theta_i: float,
    phi_i: float,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
) -> dict[str, Part]:
    """The parts of a model under light from one direction; together they are the whole (He1991 eq. 5 and Fig. 6).

    "specular" is the spike through the cones, "uniform diffuse" what the model has beside its facets
    (`Model.facets`), "directional diffuse" the rest of its lobe. A model without facets has a lobe alone, and Lambert's
    is uniform. Of a sum the parts are its terms, "lambert 1", "phong 2", each times its weight.

    Parameters
    ----------
    model
        Any model.
    theta_i, phi_i, theta_r, phi_r
        The cones' axes [rad], as in `apparent_brdf`; one direction of the source.
    wavelength_nm
        Wavelength [nm].
    source_solid_angle_sr, receiver_solid_angle_sr
        The cones' solid angles [sr], in [0, 2 pi).

    Returns
    -------
    dict
        By name, only parts that the model has. The directional diffuse is a difference: where it is far below the
        uniform part, it has the rounding and the averaging error of their sum (`apparent_lobe`).

    Raises
    ------
    ArgumentError
        As `apparent_brdf`.

    Examples
    --------
    >>> from gonio.models import HeTorrance
    >>> plastic = HeTorrance(sigma0_um=0.08, tau_um=1.5, ior=1.5, diffuse_albedo=0.3)
    >>> cones = {"source_solid_angle_sr": 0.003, "receiver_solid_angle_sr": 0.003}
    >>> for name, part in parts(plastic, 0.5, 0.0, [0.5], 3.14159, **cones).items():
    ...     print(f"{name}: {part.reflected:.3f} of the light")
    specular: 0.003 of the light
    directional diffuse: 0.038 of the light
    uniform diffuse: 0.300 of the light
    """
    cones = {
        "wavelength_nm": wavelength_nm,
        "source_solid_angle_sr": source_solid_angle_sr,
        "receiver_solid_angle_sr": receiver_solid_angle_sr,
    }
    directions = (theta_i, phi_i, theta_r, phi_r)
    terms = model.terms if isinstance(model, Sum) else ()
    if terms:
        found = {}
        for j, (term, weight) in enumerate(terms, 1):
            of_term = list(parts(term, *directions, **cones).values())
            seen, reflected = sum(p.seen for p in of_term), sum(p.reflected for p in of_term)
            found[f"{term.name} {j}"] = Part(weight * np.asarray(seen), weight * reflected)
        return found
    out = {}
    if model.has_spike:
        spike = np.asarray(apparent_spike(model, *directions, spike="nominal", **cones))
        out[SPECULAR] = Part(spike, float(model.specular_reflectivity(theta_i, wavelength_nm=wavelength_nm)))
    lobe = np.asarray(apparent_lobe(model, *directions, **cones))
    reflected = float(
        model.directional_hemispherical(theta_i, phi_i=phi_i, wavelength_nm=wavelength_nm, spike=False)
    )  # fmt: skip
    if isinstance(model, Lambert):
        return {UNIFORM: Part(lobe, reflected)}
    even = uniform(model, wavelength_nm)
    out[DIRECTIONAL] = Part(lobe - even, reflected - math.pi * even)
    if even > 0.0:
        out[UNIFORM] = Part(np.full(lobe.shape, even), math.pi * even)
    return out
