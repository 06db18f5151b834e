"""Directional-hemispherical reflectance rho_dh, of a fitted model and of a measurement itself."""

import math
from collections.abc import Sequence

import numpy as np

from gonio.checks import hemisphere
from gonio.models.corrected import UNMEASURED, folded, reflected
from gonio.shown import finite
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import ByWavelength, known_wavelength, rho_angles, rho_dh
from gonio_analysis.fitting.level import TIGHTER, MeasuredLevel, level
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.solution import LOOSE
from gonio_analysis.result_records import Reflectance

STEP = 1e-3
"""Step of derivatives by the parameters, on the search scale; right to a thousandth, with integrals to `TOLERANCE`."""
TOLERANCE = 1e-6
UNKNOWN, ANYWHERE = 0.5, 1.0 / math.sqrt(12.0)
"""Standard uncertainties above which a reflectance is not determined: half of it, for then it may be nothing; and that
of any number between 0 and 1, which is all that energy leaves."""
UNDETERMINED = "not determined by these directions"
ABOVE_ONE = 1e-4
"""What a model may reflect beyond all that it receives: far below any uncertainty, above the error of the integral."""


def too_much(found: Sequence[Reflectance]) -> bool:
    """Whether a model reflects more than it receives at one of these incidences."""
    return any(r.of_model[0] is not None and r.of_model[0] > 1.0 + ABOVE_ONE for r in found)


def of_model(result: FitResult) -> list[Reflectance]:
    """rho_dh of a fitted model at `rho_angles`, with its standard uncertainty.

    For a model that is not rejected it comes from the fit's covariance, and where the model has no level of its own, at
    the level of the measurement (`gonio_analysis.fitting.level`). For one with a misfit (docs/misfit.md) it is
    the integral of the misfit: what the residuals say of it, and what they leave open. The parameters count as
    far as no value near by tells the misfit. Where the directions leave it open there is no number, and `why`. Empty
    for a fit of several wavelengths together.
    """
    if isinstance(result.model, ByWavelength):
        return []
    theta = np.array(rho_angles(result.data))
    phi = float(result.data.directions.phi_i[0])
    wave = known_wavelength(result.wavelength_nm)

    def rho(vector: Floats) -> Floats:
        return rho_dh(result.problem.model(vector), theta, phi, wave, TOLERANCE)

    value = rho_dh(result.model, theta, phi, wave, TOLERANCE)
    if result.misfit is not None:
        return [_with_misfit(result, float(t), phi, wave, float(r)) for t, r in zip(theta, value, strict=True)]
    jacobian = result.problem.slopes(rho, result.vector, STEP)
    felt = np.abs(jacobian).max(axis=1) > 1e-9
    spread = result.spread[np.ix_(felt, felt)]
    u = np.sqrt(np.maximum(np.einsum("ki,kl,li->i", jacobian[felt], spread, jacobian[felt]), 0.0))
    if np.any((u > LOOSE * value) & np.isfinite(u)):
        away = np.array([rho(point) for point in result.around]) - value
        u = np.where(u > LOOSE * value, np.sqrt(0.5 * np.sum(away**2, axis=0)), u)
    found = list(zip(theta.tolist(), value.tolist(), u.tolist(), strict=True))
    at_level = level(result)
    if at_level is None:
        return [_stated(Reflectance(math.degrees(t), r, finite(e), "")) for t, r, e in found]
    along = jacobian[felt].T @ (spread @ at_level.pull[felt])
    return [_stated(_measured(at_level, one, float(moves))) for one, moves in zip(found, along, strict=True)]


def _measured(at_level: MeasuredLevel, found: tuple[float, float, float], along: float) -> Reflectance:
    """rho_dh at the measured level, with the model's own where that is sharper."""
    theta_i, value, u = found
    measured, of_measured = at_level.applied(value, u, along)
    if not of_measured > TIGHTER * u:
        return Reflectance(math.degrees(theta_i), value, u if math.isfinite(u) else None, "")
    return Reflectance(math.degrees(theta_i), measured, of_measured, "", given=value, u_given=u)


def _stated(found: Reflectance) -> Reflectance:
    """A reflectance that is known; of one that may be anywhere no number is left."""
    if found.rho_dh is None or found.u is None or found.u <= min(UNKNOWN * found.rho_dh, ANYWHERE):
        return found
    return Reflectance(found.theta_i_deg, None, None, UNDETERMINED, unmeasured=found.unmeasured, given=found.rho_dh)


def _with_misfit(result: FitResult, theta_i: float, phi_i: float, wave: float, value: float) -> Reflectance:
    """rho_dh with its misfit, from directions that each stand for an equal part of the reflected light."""
    assert result.misfit is not None
    at, model = reflected(result.model, theta_i, phi_i, wave)
    if not model.size:
        return Reflectance(math.degrees(theta_i), value, None, "the model reflects nothing")
    spike = float(result.model.specular_reflectivity(theta_i, wavelength_nm=wave))
    correction = result.misfit.correction
    of_parameters = result.parameter_root(at, wave)
    at = folded(at, result.model)
    open_part = correction.open(at)
    unmeasured = (1.0 - spike / value) * float(np.mean(open_part > UNMEASURED))
    share = (value - spike) / model.size / model
    known, of_misfit = correction.total(at, model, share)
    known += spike
    parts = ([of_misfit], (share * open_part) @ of_parameters, [spike * correction.spike])
    open_ = float(np.linalg.norm(np.concatenate(parts)))
    u = math.hypot(open_, known - value)
    return _stated(
        Reflectance(math.degrees(theta_i), value, u, "", with_misfit=known, u_with_misfit=open_, unmeasured=unmeasured)
    )


def combined(parts: Sequence[tuple[float, Sequence[Reflectance]]]) -> list[Reflectance]:
    """rho_dh of several models that cannot be told apart, each with what the values say of its misfit.

    Parameters
    ----------
    parts
        Weight of a model, and what `of_model` says of it.

    Returns
    -------
    list of Reflectance
        The weighted means. Their variances are those of the models and that among them. A model that does not determine
        one has no weight in it. Empty where no model has any.
    """
    weights, several = [w for w, found in parts if found], [found for _, found in parts if found]
    out = []
    for ones in zip(*several, strict=True):
        known = [
            (w, r.with_misfit, r.u_with_misfit)
            for w, r in zip(weights, ones, strict=True)
            if r.with_misfit is not None and r.u_with_misfit is not None
        ]
        if not known and any(r.rho_dh is None for r in ones):
            out.append(Reflectance(ones[0].theta_i_deg, None, None, UNDETERMINED))
        if known:
            weight, value, u = np.array(known).T
            weight = weight / weight.sum()
            mean = float(weight @ value)
            spread = math.sqrt(float(weight @ (u**2 + (value - mean) ** 2)))
            out.append(Reflectance(ones[0].theta_i_deg, mean, spread, ""))
    return out


def of_table(data: Observations) -> list[Reflectance]:
    """rho_dh of the measurement at each direction of its source; see `gonio.checks.hemisphere.reflectances`."""
    return [
        Reflectance(r.theta_i_deg, r.rho_dh, None, r.why)
        if r.rho_dh is None
        else Reflectance(r.theta_i_deg, r.rho_dh, r.u, r.why, r.u_sampling, r.u_values, r.u_independent)
        for r in hemisphere.reflectances(data.checked)
    ]
