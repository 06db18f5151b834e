"""What an instrument with a finite source and a finite receiver sees of a model.

Both are circular cones: `theta_i, phi_i` and `theta_r, phi_r` are their axes. The BRDF that it measures is

    (1/w_r) int_r int_s f cos(theta_s) dw_s dw_r / int_s cos(theta_s) dw_s

for the lobe, and for the specular spike (He1991 eqs. 6, 70) the flux that the source's mirror image sends through the
receiver's cone. A cone that crosses the horizon is cut there, and averages run over what is left; a solid angle of zero
is a direction.

`Cones` holds directions that many models are evaluated in; the functions do the same for one.
"""

import math
from functools import cached_property
from typing import Any, Literal

import numpy as np

from gonio.errors import ArgumentError
from gonio.geometry import half_angle_of_cone
from gonio.instrument.lobe import TOLERANCE, Lobe, Rules
from gonio.instrument.spike import Overlaps
from gonio.models import Model, geometry
from gonio.models.parameters import checked_wavelength, choice, number
from gonio.typing import ArrayLike

__all__ = ["Cones", "Rules", "apparent_brdf", "apparent_lobe", "apparent_spike"]

Spike = Literal["nominal", "exact"]


class Cones:
    """The cones of source and receiver about directions that are checked and prepared once, for many models.

    The methods take a `gonio.models.Model` and a wavelength [nm], and return a float64 array of the shape that the
    angles broadcast to; a wavelength that is no positive number, or at which the model's index is not known, raises
    `ArgumentError`.

    Parameters
    ----------
    theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike
        As `apparent_brdf` takes them, with its errors.
    tolerance
        Relative error of a lobe's average (see `apparent_lobe`).
    """

    def __init__(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        source_solid_angle_sr: float,
        receiver_solid_angle_sr: float,
        *,
        spike: Spike = "nominal",
        tolerance: float = TOLERANCE,
    ) -> None:
        self._where = geometry(theta_i, phi_i, theta_r, phi_r)
        self._omega_i, self._omega_r = self._where.omega_i.reshape(-1, 3), self._where.omega_r.reshape(-1, 3)
        self._half_angles = _half_angles(source_solid_angle_sr, receiver_solid_angle_sr)
        self._exact = choice("spike", spike, ("nominal", "exact")) == "exact"
        self._tolerance = tolerance

    def centre(self, model: Model, *, wavelength_nm: float = 550.0) -> Any:
        """The lobe [1/sr] along the axes of the cones."""
        return model.at(self._where, wavelength_nm=wavelength_nm)

    def lobe(self, model: Model, *, wavelength_nm: float = 550.0, rules: Rules | None = None) -> Any:
        """The lobe's average over the cones [1/sr]; with the `rules` of a like model, not searched for again."""
        lobe, at = self._lobe(model, wavelength_nm), (self._omega_i, self._omega_r)
        values = lobe.choose(*at)[0] if rules is None else lobe.by_rules(*at, rules)
        return values.reshape(self._where.shape)[()]

    def rules(self, model: Model, *, wavelength_nm: float = 550.0) -> Rules:
        """How the average over the cones is taken for this model: what `lobe` can take for others that are like it."""
        return self._lobe(model, wavelength_nm).choose(self._omega_i, self._omega_r)[1]

    def _lobe(self, model: Model, wavelength_nm: float) -> Lobe:
        return Lobe(model, checked_wavelength(wavelength_nm), *self._half_angles, self._tolerance)

    def spike(self, model: Model, *, wavelength_nm: float = 550.0) -> Any:
        """What the receiver gets of the specular spike [1/sr]; 0 for a model without one."""
        if not model.has_spike:
            return np.zeros(self._where.shape)[()]
        return self._overlaps.seen(model, checked_wavelength(wavelength_nm)).reshape(self._where.shape)[()]

    @cached_property
    def _overlaps(self) -> Overlaps:
        return Overlaps(self._omega_i, self._omega_r, *self._half_angles, self._exact)


def apparent_brdf(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    spike: Spike = "nominal",
) -> Any:
    """BRDF [1/sr] that an instrument with circular source and receiver cones measures: lobe and specular spike.

    Parameters
    ----------
    model
        Any `gonio.models.Model`.
    theta_i, phi_i, theta_r, phi_r
        The cones' axes [rad], as in `Model.brdf`; they broadcast.
    wavelength_nm
        Wavelength [nm].
    source_solid_angle_sr, receiver_solid_angle_sr
        The cones' solid angles [sr], in [0, 2 pi).
    spike
        "nominal": rho_s(theta_i) |cap_s' and cap_r| / (cos(theta_i) w_s w_r), HTSG's eq. 6; "exact": rho_s carried
        through the integral, with the lobe's denominator, as an instrument measures it.

    Returns
    -------
    float64 array of the shape that the angles broadcast to.

    Raises
    ------
    ArgumentError
        `model` is none, or an angle, a solid angle or `spike` is outside its domain; it names the argument.

    Notes
    -----
    The lobe is averaged to 1e-7 (see `apparent_lobe`); the spike to 1e-8 of itself.
    """
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike=spike)
    lobe = cones.lobe(_checked(model), wavelength_nm=wavelength_nm)
    return lobe + cones.spike(model, wavelength_nm=wavelength_nm) if model.has_spike else lobe


def apparent_lobe(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    tolerance: float = TOLERANCE,
) -> Any:
    """The part of `apparent_brdf` that is not the spike; arguments and errors as there.

    Notes
    -----
    A second-order expansion where its own error estimate holds `tolerance`, else products of two disc rules of growing
    degree (5, 7, 11, 19, 31, 47) until two agree to `tolerance`, geometry by geometry. The kinks of V-groove models
    leave some 1e-6. A lobe that the finest rules cannot resolve (narrower than about a tenth of the cones' radius) is
    integrated in polar coordinates about the mirror direction, over the wider cone: to 1e-6 where the other cone is a
    direction or narrower than the lobe, to about 2e-3 where the lobe is narrower than both. Where the horizon cuts a
    cone the average is good to about 1e-5, and the spike's overlap to 1e-3.
    """
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, tolerance=tolerance)
    return cones.lobe(_checked(model), wavelength_nm=wavelength_nm)


def apparent_spike(
    model: Model,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    wavelength_nm: float = 550.0,
    source_solid_angle_sr: float,
    receiver_solid_angle_sr: float,
    spike: Spike = "nominal",
) -> Any:
    """The spike's part of `apparent_brdf`; arguments and errors as there. 0 for a model without a spike."""
    cones = Cones(theta_i, phi_i, theta_r, phi_r, source_solid_angle_sr, receiver_solid_angle_sr, spike=spike)
    return cones.spike(_checked(model), wavelength_nm=wavelength_nm)


def _checked(model: Model) -> Model:
    if not isinstance(model, Model):
        raise ArgumentError(f"model must be one of gonio.models, not {type(model).__name__}")
    return model


def _half_angles(source_solid_angle_sr: float, receiver_solid_angle_sr: float) -> tuple[float, float]:
    out = []
    for name, value in (
        ("source_solid_angle_sr", source_solid_angle_sr),
        ("receiver_solid_angle_sr", receiver_solid_angle_sr),
    ):
        checked = number(name, value, 0.0, unit="sr")
        if checked >= 2.0 * math.pi:
            raise ArgumentError(f"{name} = {checked:g} sr: a cone must be narrower than the hemisphere, 2 pi sr")
        out.append(float(half_angle_of_cone(checked)))
    return out[0], out[1]
