"""Whether a model is reciprocal, bound in energy and defined everywhere: one line for a model of one's own."""

import math
from dataclasses import dataclass

import numpy as np

from gonio.errors import DataError
from gonio.models.corrected import Corrected
from gonio.models.model import Model
from gonio.models.spectral import SpectralModel
from gonio.models.sum import Sum

INCIDENCES_DEG = (0.0, 30.0, 60.0, 75.0, 85.0)
"""Where the reflected light is added up."""
TOLERANCE = 1e-4
"""Relative error of those sums."""
DRAWN = 4000
"""Pairs of directions, a tenth of them within a degree of grazing."""


@dataclass(frozen=True)
class Examination:
    """What an examination found; its text is one line."""

    name: str
    reciprocity: float
    """Largest relative change when source and detector are exchanged."""
    reflected: float
    """The largest share of light from one direction that is reflected; NaN where it cannot be added up."""
    at_deg: float
    """The angle of incidence [deg] of that."""
    negative: int
    """Pairs of directions whose value is below 0."""
    undefined: int
    """Pairs whose value is not a number."""
    outside: str = ""
    """What `outside` says."""
    assumes: str = ""
    """What `assumptions` says."""

    @property
    def too_bright(self) -> str:
        """A sentence where the model reflects more than it receives, else ""."""
        if not self.reflected > 1.0 + 10.0 * TOLERANCE:
            return ""
        return f"{self.name} reflects {self.reflected:.3g} times what it receives at {self.at_deg:g} deg of incidence"

    def __str__(self) -> str:
        exchanged = "reciprocal" if self.reciprocity < 1e-9 else f"not reciprocal (by up to {self.reciprocity:.2g})"
        share = f"reflects at most {self.reflected:.3g} of what it receives (at {self.at_deg:g} deg)"
        share = share if math.isfinite(self.reflected) else "what it reflects could not be added up"
        light = self.too_bright.removeprefix(f"{self.name} ") or share
        counted = ((self.negative, "negative"), (self.undefined, "NaN"))
        wrong = [f"{n} of {DRAWN} values are {what}" for n, what in counted if n]
        validity = [text.removeprefix(f"{self.name} ").rstrip(".") for text in (self.outside, self.assumes) if text]
        return f"{self.name}: {'; '.join([exchanged, light, *wrong, *validity])}"


def _single(model: Model) -> list[Model]:
    """A model, or those that it is made of."""
    if isinstance(model, Corrected):
        return _single(model.model)
    if isinstance(model, SpectralModel):
        return _single(model.middle)
    return [one for term, _ in model.terms for one in _single(term)] if isinstance(model, Sum) else [model]


def outside(model: Model, wavelength_nm: float) -> str:
    """Where a model is used outside the conditions of its own derivation, a sentence for each (`Model.outside`).

    Parameters
    ----------
    model
        Any model; of a sum each term counts.
    wavelength_nm
        Wavelength [nm].
    """
    here = model.plain(wavelength_nm) if isinstance(model, SpectralModel) else model
    found = [(one.name, one.outside(wavelength_nm)) for one in _single(here)]
    return " ".join(f"{name} is used outside its validity: {why}." for name, why in found if why)


def assumptions(model: Model) -> str:
    """What a model's derivation asks of a surface that no parameter of it tells, a sentence for each model."""
    found = {one.name: one.assumes for one in _single(model) if one.assumes}
    return " ".join(f"{name} holds for {what}; it has no length that would tell." for name, what in found.items())


def examine(model: Model, wavelength_nm: float = 550.0) -> Examination:
    """Exchange directions, look for values below 0 and NaN, and add up what is reflected at `INCIDENCES_DEG`.

    Parameters
    ----------
    model
        Any model.
    wavelength_nm
        Wavelength [nm].

    Examples
    --------
    >>> from gonio.models import Lambert, examine
    >>> print(examine(Lambert(0.5)))  # doctest: +ELLIPSIS
    lambert: reciprocal; reflects at most 0.5 of what it receives (at ... deg)
    """
    rng = np.random.default_rng(1)
    theta = np.arccos(rng.uniform(0.0, 1.0, (2, DRAWN)))
    near = rng.random((2, DRAWN)) < 0.1
    theta[near] = 0.5 * math.pi - 10.0 ** rng.uniform(-4.0, -1.76, int(near.sum()))
    phi = rng.uniform(0.0, 2.0 * math.pi, (2, DRAWN))
    there = np.asarray(model.brdf(theta[0], phi[0], theta[1], phi[1], wavelength_nm=wavelength_nm))
    back = np.asarray(model.brdf(theta[1], phi[1], theta[0], phi[0], wavelength_nm=wavelength_nm))
    both = np.isfinite(there) & np.isfinite(back)
    size = np.maximum(np.maximum(np.abs(there[both]), np.abs(back[both])), 1e-300)
    changed = float(np.max(np.abs(there[both] - back[both]) / size, initial=0.0))
    shares = []
    for angle in INCIDENCES_DEG:
        try:
            rho = model.directional_hemispherical(math.radians(angle), wavelength_nm=wavelength_nm, tolerance=TOLERANCE)
        except DataError:
            continue
        shares.append((float(rho), angle))
    most, at = max(shares, default=(math.nan, math.nan))
    wrong = (int(np.sum(there < 0.0)), int(np.sum(np.isnan(there))))
    return Examination(model.name, changed, most, at, *wrong, outside(model, wavelength_nm), assumptions(model))
