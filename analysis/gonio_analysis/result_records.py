"""What `summary.json` and `--json` hold, key by key: the page, the figures and the tables are made from these."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from gonio import shown
from gonio.checks.verdicts import Check

WHERE_KNOWN = {"where_known": True}
"""Metadata of a field that JSON has only where it is not None."""


def as_json(value: Any) -> Any:
    """Results as dictionaries and lists, their fields in order; None for numbers that are not finite."""
    if hasattr(value, "summary"):
        return as_json(value.summary())
    if is_dataclass(value):
        pairs = ((f, getattr(value, f.name)) for f in fields(value))
        return {f.name: as_json(v) for f, v in pairs if not (v is None and f.metadata.get("where_known"))}
    if isinstance(value, Mapping):
        return {str(k): as_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [as_json(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --- fits ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SharedGeometry:
    """What fits at several wavelengths have in common (`gonio_analysis.fitting.spectrum`)."""

    wavelengths_nm: list[float]
    parameters: list[str]
    """Parameters that are the same at all wavelengths."""
    n_points: int
    n_free: int
    """Number of free parameters of all wavelengths together."""
    chi_square: float | None
    reduced_chi_square: float | None


FAR = math.log(2.0)
"""A misfit that is said as a factor."""


@dataclass(frozen=True)
class MisfitSummary:
    """tau: how far a model itself is off, relative (docs/misfit.md); 0 where the data do not reject it."""

    value: float
    u: float
    interval: tuple[float, float]
    """95 %; of a model that is not rejected from 0 to the smooth misfit that half of the tests would find."""

    def of(self, what: str) -> str:
        """As in "describes this sample to 4.7 % (4 to 5.6)"; far from it nothing is described."""
        return f"describes {what} to {self.words}" if self.value < FAR else f"misses {what} by {self.words}"

    @property
    def words(self) -> str:
        """As in "4.7 % (4 to 5.6)", or as a factor, where percents of a logarithm mislead."""
        three = (self.value, *self.interval)
        if self.value < FAR:
            middle, low, high = (shown.number(100 * x, 2) for x in three)
            return f"{middle} % ({low} to {high})"
        middle, low, high = (shown.number(math.exp(min(x, 700.0)), 2) for x in three)
        return f"a factor of {middle} ({low} to {high})"


@dataclass(frozen=True)
class Reflectance:
    """Directional-hemispherical reflectance at one angle of incidence."""

    theta_i_deg: float
    rho_dh: float | None
    """None where a table does not allow it, or its directions do not determine it."""
    u: float | None
    """Standard uncertainty; None where it is not determined."""
    why: str
    """Why there is none, or what was assumed."""
    u_sampling: float | None = None
    """Of a table's integral: the part of `u` from interpolation and from what lies beyond the directions."""
    u_values: float | None = None
    """The part of `u` from the uncertainty of the values, with their whole covariance."""
    u_independent: float | None = None
    """The same, were every value's uncertainty independent of the others'."""
    with_misfit: float | None = None
    """Where the model is not true: its value with what the measurement says of the misfit."""
    u_with_misfit: float | None = None
    """Standard uncertainty of that."""
    unmeasured: float | None = None
    """Share of the light that goes where no value near by tells the misfit: only the model tells it."""
    given: float | None = field(default=None, metadata=WHERE_KNOWN)
    """Where a model has no level of its own: what it says by itself, given it and its n and k; `rho_dh` is at the
    measured level. Where the directions leave `rho_dh` open: the model's integral, which bounds of energy judge."""
    u_given: float | None = field(default=None, metadata=WHERE_KNOWN)
    """Standard uncertainty of that."""

    @property
    def of_model(self) -> tuple[float | None, float | None]:
        """The model's own number and its uncertainty."""
        return (self.rho_dh, self.u) if self.given is None else (self.given, self.u_given)


@dataclass(frozen=True)
class MuellerElement:
    """One element of measured Mueller matrices, over the first one, against a model's."""

    name: str
    points: int
    rms: float | None
    """Root mean square of the measured values."""
    mean_residual: float | None
    """Measured less model."""
    rms_residual: float | None
    chi_square_per_value: float | None
    """Mean square of the residuals over their stated uncertainties."""


@dataclass(frozen=True)
class ChecksSummary:
    """The checks of a measurement, and what they rest on, thinned for a figure."""

    checks: list[Check]
    differences: dict[str, list[float]]
    """By kind of pair: ln(one / other), ascending."""
    visits_h: list[float]
    """When the white reference was visited, from the first visit on."""
    visits: list[float]
    """Its signal per unit BRDF."""


# --- appearance ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Quantity:
    """A number, its standard uncertainty and its numerical error; or why there is none."""

    value: float | None
    u: float | None
    error: float | None
    unit: str
    why: str | None = field(default=None, metadata=WHERE_KNOWN)
    at_least: float | None = field(default=None, metadata=WHERE_KNOWN)
    """A lower bound where there is no value."""
    note: str | None = field(default=None, metadata=WHERE_KNOWN)


@dataclass(frozen=True)
class AtIncidence(Quantity):
    """A quantity at one angle of incidence."""

    theta_i_deg: float = 0.0


@dataclass(frozen=True)
class Retroreflection:
    """Both coefficients in one geometry."""

    after: str
    entrance_deg: float
    observation_deg: float
    R_A: Quantity
    R_L: Quantity


@dataclass(frozen=True)
class Colour:
    """L*a*b* in one geometry."""

    theta_i_deg: float
    aspecular_deg: float
    theta_r_deg: float
    """Signed."""
    L: Quantity
    a: Quantity
    b: Quantity


@dataclass(frozen=True)
class Appearance:
    """All quantities of one sample, as `gonio appearance --json` prints them."""

    name: str
    source: str
    kind: str
    """"table", "model" or "fit"."""
    wavelength_nm: float | None
    gloss_20_gu: Quantity
    gloss_60_gu: Quantity
    gloss_85_gu: Quantity
    haze_gu: Quantity
    """ASTM D4039: G60 - G20."""
    haze_e430_20: Quantity
    haze_e430_30: Quantity
    """ASTM E430, narrow-angle reflection haze of methods B and A: percent of what the standard glass reflects."""
    rho_dh_8: Quantity
    rho_dh: Sequence[AtIncidence]
    radiance_factor_0_45: Quantity
    radiance_factor_45_0: Quantity
    retroreflection: Sequence[Retroreflection]
    lab: Sequence[Colour]
    flop_index: Quantity
    tis_8: Quantity
    rms_roughness_nm: Quantity
    notes: Sequence[str] = ()
    simulated: bool = False
    """Whether a simulation made the table."""

    @property
    def title(self) -> str:
        """The name, with a mark where the values are simulated."""
        return shown.marked(self.name, self.simulated)


# --- what was measured -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CauseSummary:
    """One cause of uncertainty: median and 95th percentile of |u / value|."""

    cause: str
    median: float
    p95: float
