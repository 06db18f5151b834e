"""What an instrument would measure of a model: the forward model of fits and of the theory curves in plots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.checks import values
from gonio.geometry import SAME_ANGLE, Directions
from gonio.typing import Floats
from gonio_analysis.fitting.observations import Observations

if TYPE_CHECKING:
    from gonio.instrument import Cones, Rules

NO_WAVELENGTH_NM = 550.0
"""Given to models whose value does not depend on it, in a broad band."""
EIGHT = math.radians(8.0)
"""The incidence of integrating spheres."""
MOST = 9
"""Incidences of a long list that are evaluated, evenly, both ends included."""


@dataclass(frozen=True)
class ByWavelength:
    """Models of one sample at several wavelengths."""

    models: Mapping[float, Any]

    @property
    def convention(self) -> str:
        """That of the models."""
        return str(next(iter(self.models.values())).convention)

    @property
    def parameter_notes(self) -> Mapping[str, str]:
        """Those of the models."""
        notes: Mapping[str, str] = next(iter(self.models.values())).parameter_notes
        return notes

    @property
    def depends_on_azimuth(self) -> bool:
        """Whether theirs do."""
        return any(model.depends_on_azimuth for model in self.models.values())


def _alone(model: Any, wavelength_nm: float) -> tuple[Any, float]:
    """The model at one wavelength, and what it is given as that [nm]."""
    one = model.models[wavelength_nm] if isinstance(model, ByWavelength) else model
    return one, known_wavelength(wavelength_nm)


def apparent(model: Any, at: Observations, *, quick: bool = False, rules: list[Rules | None] | None = None) -> Floats:
    """The BRDF [1/sr] that the instrument of a table sees of `model` in its directions.

    Averaged over the cones of source and receiver, the specular spike carried through the integral
    (`gonio.instrument.Cones`, spike "exact"). In a broad band (wavelength NaN) the model has to be one whose
    value does not depend on the wavelength. `quick` takes the lobe at the centre of the cones, for searches; `rules`
    (see `averaging`) averages it as was found good for a like model.
    """
    out = np.empty(len(at))
    for here, rule in zip(at.cones, rules or [None] * len(at.cones), strict=True):
        one, wave = _alone(model, here.wavelength_nm)
        out[here.rows] = _value(one, here.cones, wave, here.pointlike, quick, rule)
    return out


def averaging(model: Any, at: Observations) -> list[Rules | None] | None:
    """How the averages over the cones are taken for `model`; None where there are no cones."""
    if pointlike(at):
        return None
    several = ((here, *_alone(model, here.wavelength_nm)) for here in at.cones)
    return [None if here.pointlike else here.cones.rules(one, wavelength_nm=wave) for here, one, wave in several]


def pointlike(at: Observations) -> bool:
    """Whether all cones are directions."""
    return all(here.pointlike for here in at.cones)


def sees_spike(model: Any, at: Observations) -> bool:
    """Whether a value of the table has light of the model's specular spike in it."""
    several = ((here.cones, *_alone(model, here.wavelength_nm)) for here in at.cones if not here.pointlike)
    return any(bool(np.any(cones.spike(one, wavelength_nm=wave) > 0)) for cones, one, wave in several)


def seen(
    model: Any,
    at: Directions,
    *,
    wavelength_nm: float,
    cones: tuple[float, float],
) -> Floats:
    """As `apparent`, in the directions given, through cones of (source, receiver) solid angle [sr].

    Without a cone on either side a specular spike has no finite value: then the model without its spike is returned.
    """
    from gonio.instrument import LOBE_TOLERANCE, Cones

    through = Cones(
        *at.angles,
        source_solid_angle_sr=cones[0],
        receiver_solid_angle_sr=cones[1],
        spike="exact",
        tolerance=LOBE_TOLERANCE,
    )
    return _value(model, through, known_wavelength(wavelength_nm), cones == (0.0, 0.0))


def _value(
    model: Any, cones: Cones, wave: float, without_width: bool, quick: bool = False, rules: Rules | None = None
) -> Floats:
    if without_width:
        return np.asarray(cones.centre(model, wavelength_nm=wave))
    lobe = cones.centre(model, wavelength_nm=wave) if quick else cones.lobe(model, wavelength_nm=wave, rules=rules)
    return np.asarray(lobe + cones.spike(model, wavelength_nm=wave) if model.has_spike else lobe)


def known_wavelength(wavelength_nm: float) -> float:
    """The wavelength that a model is given [nm]: in a broad band (NaN) any."""
    return NO_WAVELENGTH_NM if np.isnan(wavelength_nm) else wavelength_nm


def rho_angles(data: Observations) -> list[float]:
    """Angles of incidence [rad] at which models are asked for rho_dh: those of a table, and 8 degrees."""
    found = values.apart(sorted({round(i.theta_i, 4) for i in values.incidences(data.directions)}))
    if len(found) > MOST:
        found = [found[k] for k in np.unique(np.linspace(0, len(found) - 1, MOST).round().astype(int))]
    return sorted([*found, *([EIGHT] if all(abs(a - EIGHT) > SAME_ANGLE for a in found) else [])])


def rho_dh(model: Any, theta_i: Floats, phi_i: float, wavelength_nm: float, tolerance: float) -> Floats:
    """Directional-hemispherical reflectance of a model at angles of incidence (n,) [rad]."""
    return np.asarray(
        model.directional_hemispherical(theta_i, phi_i=phi_i, wavelength_nm=wavelength_nm, tolerance=tolerance)
    )
