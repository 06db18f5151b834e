"""What an instrument would measure of a model: the forward model of fits and of the theory curves in plots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_analysis.fitting.observations import Observations

if TYPE_CHECKING:
    from gonio.instrument import Cones, Rules

NO_WAVELENGTH_NM = 550.0
"""Given to models whose value does not depend on it, in a broad band."""


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


def _alone(model: Any, wavelength_nm: float) -> Any:
    return model.models[wavelength_nm] if isinstance(model, ByWavelength) else model


def apparent(model: Any, at: Observations, *, quick: bool = False, rules: list[Rules | None] | None = None) -> Floats:
    """The BRDF [1/sr] that the instrument of a table sees of `model` in its directions.

    Averaged over the cones of source and receiver, the specular spike carried through the integral
    (`gonio.instrument.Cones`, spike "exact"). In a broad band (wavelength NaN) the model has to be one whose
    value does not depend on the wavelength. `quick` takes the lobe at the centre of the cones, for searches; `rules`
    (see `averaging`) averages it as was found good for a like model.
    """
    out = np.empty(len(at))
    for k, here in enumerate(at.cones):
        out[here.rows] = _value(
            _alone(model, here.wavelength_nm),
            here.cones,
            here.wavelength_nm,
            here.pointlike,
            quick,
            None if rules is None else rules[k],
        )
    return out


def averaging(model: Any, at: Observations) -> list[Rules | None] | None:
    """How the averages over the cones are taken for `model`; None where there are no cones."""
    if pointlike(at):
        return None
    return [
        None
        if here.pointlike
        else here.cones.rules(_alone(model, here.wavelength_nm), wavelength_nm=_known(here.wavelength_nm))
        for here in at.cones
    ]


def pointlike(at: Observations) -> bool:
    """Whether all cones are directions."""
    return all(here.pointlike for here in at.cones)


def sees_spike(model: Any, at: Observations) -> bool:
    """Whether a value of the table has light of the model's specular spike in it."""
    return any(
        not here.pointlike
        and bool(
            np.any(here.cones.spike(_alone(model, here.wavelength_nm), wavelength_nm=_known(here.wavelength_nm)) > 0)
        )
        for here in at.cones
    )


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
    return _value(model, through, wavelength_nm, cones == (0.0, 0.0))


def _value(
    model: Any,
    cones: Cones,
    wavelength_nm: float,
    without_width: bool,
    quick: bool = False,
    rules: Rules | None = None,
) -> Floats:
    wave = _known(wavelength_nm)
    if without_width:
        return np.asarray(cones.centre(model, wavelength_nm=wave))
    lobe = cones.centre(model, wavelength_nm=wave) if quick else cones.lobe(model, wavelength_nm=wave, rules=rules)
    if not model.has_spike:
        return np.asarray(lobe)
    return np.asarray(lobe + cones.spike(model, wavelength_nm=wave))


def _known(wavelength_nm: float) -> float:
    return NO_WAVELENGTH_NM if np.isnan(wavelength_nm) else wavelength_nm
