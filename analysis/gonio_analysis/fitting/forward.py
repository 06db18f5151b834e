"""What an instrument would measure of a model: the forward model of fits and of the theory curves in plots.

It also says what errors of the arms' angles do to the values of a table. A reduction takes the slopes of its columns
`s_theta_i_zero` and `s_theta_r_zero` from neighbouring points. Those of a run that chose its points are few and far
apart: where facets hide each other, toward grazing, a column can have the wrong sign, and a fit that many such points
decide would state too small an uncertainty. Elsewhere no value shows how steep a lobe is between two points, and
`u_random` holds the uncertainty of that slope. The fitted model knows the slopes. The provenance of such a table names
the uncertainties of the zeros (`zeros_rad`) and of the encoders' readings (`readings_rad`), and its column `u_angles`
says what readings have added to `u_random`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from gonio.checks import values
from gonio.geometry import SAME_ANGLE, Directions
from gonio.models.polarised import Light
from gonio.polarisation import PERFECT, UNPOLARISED, Polarisers, states
from gonio.typing import Floats
from gonio_analysis.fitting.observations import Observations

if TYPE_CHECKING:
    from gonio.instrument import Cones, Rules

Averaging: TypeAlias = "list[Rules | None] | None"
"""How averages over the cones are taken, by instrument and wavelength; see `averaging`."""

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


def apparent(model: Any, at: Observations, *, quick: bool = False, rules: Averaging = None) -> Floats:
    """The BRDF [1/sr] that the instrument of a table sees of `model` in its directions.

    Averaged over the cones of source and receiver, the specular spike carried through the integral
    (`gonio.instrument.Cones`, spike "exact"). What polarised light and an analyser change is taken at the axes of the
    cones. In a broad band (wavelength NaN) the model has to be one whose
    value does not depend on the wavelength. `quick` takes the lobe at the centre of the cones, for searches; `rules`
    (see `averaging`) averages it as was found good for a like model.
    """
    out = np.empty(len(at))
    for here, rule in zip(at.cones, rules or [None] * len(at.cones), strict=True):
        one, wave = _alone(model, here.wavelength_nm)
        value = partial(_value, cones=here.cones, wave=wave, without_width=here.pointlike, quick=quick, rules=rule)
        out[here.rows] = value(one) if here.light is None else here.light.seen(one, value, wave)
    return out


def averaging(model: Any, at: Observations) -> Averaging:
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
    state: str = UNPOLARISED,
    polarisers: Polarisers = PERFECT,
) -> Floats:
    """As `apparent`, in the directions given, through cones of (source, receiver) solid angle [sr].

    `state` is that of light and analyser, a word of `gonio.polarisation`, made by such polarisers.

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
    wave = known_wavelength(wavelength_nm)
    value = partial(_value, cones=through, wave=wave, without_width=cones == (0.0, 0.0))
    if state == UNPOLARISED:
        return value(model)
    return np.asarray(model.in_light(Light(at, *states([state] * len(at), polarisers)), value, wave))


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


IN_PLANE = 2e-3
"""Directions [rad] closer to the plane of incidence lie in it: more than an encoder's step."""
HIGHEST = 0.5 * math.pi - 1e-6
"""Polar angles [rad] are held below this where an arm is moved in thought."""
EXTREME = 2.6
"""Standard deviations that an error of a zero hardly exceeds: one in a hundred does."""


def by_model(data: Observations, model: Any, predicted: Floats) -> Observations:
    """The same values, their changes by errors of the arms' angles being those of a model.

    A value stands for f(true) cos(true theta_i) / cos(read theta_i). Points out of the plane of incidence keep what the
    table says: there a zero turns both arms' plane.

    Parameters
    ----------
    data
        As a table states it; `zeros_rad`, `readings_rad` and `u_angles` name what is replaced.
    model
        The model that is fitted.
    predicted
        Its values in the directions of `data` [1/sr], by the quick forward model.
    """
    data = _with_polarisers(data, model)
    known = data.covariance
    if known is None or not data.zeros_rad:
        return data
    d, common = data.directions, known.common.copy()
    in_plane = np.abs(np.sin(d.dphi)) * np.sin(d.theta_r) < IN_PLANE
    in_plane &= (data.brdf > 0.0) & (predicted > 0.0)
    for cause, u in data.zeros_rad.items():
        if cause not in known.causes or not in_plane.any():
            continue
        column = known.causes.index(cause)
        up, down = (_moved(data, model, {cause: by}) for by in (u, -u))
        # columns are as large as the measured values, and are scaled to the model's later
        effect = 0.5 * (up - down) * data.brdf / np.where(predicted > 0.0, predicted, 1.0)
        sign = math.copysign(1.0, float(np.sum((common[:, column] * effect / known.random**2)[in_plane])))
        common[in_plane, column] = sign * effect[in_plane]
    random = known.random.copy()
    if data.u_angles.size:
        by_readings = _of_readings(data, model, predicted)
        rest = np.sqrt(np.maximum(known.random**2 - data.u_angles**2, (1e-6 * known.total) ** 2))
        random[in_plane] = np.hypot(rest, by_readings)[in_plane]
    return replace(data, covariance=replace(known, random=random, common=common))


def _with_polarisers(data: Observations, model: Any) -> Observations:
    """The same values with a common cause for each uncertain number of the polarisers, as the model has it."""
    known = data.covariance
    if known is None or data.light is None:
        return data
    causes, columns = list(known.causes), list(known.common.T)
    for which, number in itertools.product(("light", "receiver"), ("azimuth", "extinction")):
        cause, u = f"{which}_{number}", getattr(getattr(data.polarisers, which), f"u_{number}")
        if u > 0.0:
            up, down = (replace(data, polarisers=data.polarisers.moved(which, number, by)) for by in (u, -u))
            column = 0.5 * (apparent(model, up, quick=True) - apparent(model, down, quick=True))
            if cause in causes:  # as the table had it, which knew no model
                columns[causes.index(cause)] = column
            else:
                causes.append(cause)
                columns.append(column)
    if not columns:
        return data
    return replace(data, covariance=replace(known, common=np.stack(columns, axis=1), causes=tuple(causes)))


def _of_readings(data: Observations, model: Any, predicted: Floats) -> Floats:
    """Standard uncertainties [1/sr] by the encoders' readings.

    Beside the edge of a spike values are not normally distributed: most visits see nothing of it, and a few see much.
    What stands for it is the largest departure from the slopes, with both arms anywhere within their counts.
    """
    odd, variance = {}, np.zeros(len(data))
    for cause, u in data.readings_rad.items():
        up, down = (_moved(data, model, {cause: by}, quick=True) for by in (u, -u))
        odd[cause] = 0.5 * (up - down)
        variance += odd[cause] ** 2
    far = {c: math.sqrt(3.0) * u + EXTREME * data.zeros_rad.get(c, 0.0) for c, u in data.readings_rad.items()}
    most = np.zeros(len(data))
    for signs in itertools.product((1.0, -1.0), repeat=len(far)):
        by = {cause: sign * off for sign, (cause, off) in zip(signs, far.items(), strict=True)}
        straight = sum((odd[c] * (off / data.readings_rad[c]) for c, off in by.items()), predicted)
        most = np.maximum(most, np.abs(_moved(data, model, by, quick=True) - straight))
    return np.asarray(np.hypot(np.sqrt(variance), most))


def _moved(data: Observations, model: Any, by: Mapping[str, float], *, quick: bool = False) -> Floats:
    """The values where arms truly stand so far [rad] beside what was read."""
    d = data.directions
    theta_i, signed = d.theta_i, d.signed
    theta_i = np.minimum(theta_i + by.get("theta_i_zero", 0.0), HIGHEST)
    signed = np.clip(signed + by.get("theta_r_zero", 0.0), -HIGHEST, HIGHEST)
    phi_i = d.phi_i + np.where(theta_i < 0.0, math.pi, 0.0)
    phi_r = d.phi_i + np.where(signed < 0.0, 0.0, math.pi)
    there = replace(data, directions=Directions(np.abs(theta_i), phi_i, np.abs(signed), phi_r))
    return apparent(model, there, quick=quick) * np.cos(theta_i) / np.cos(d.theta_i)
