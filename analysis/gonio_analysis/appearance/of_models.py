"""Appearance of models and of fits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from gonio import colour, models
from gonio.config import numbers_in, with_numbers
from gonio.errors import ArgumentError
from gonio.geometry import ANGLES, Directions
from gonio.models import Model
from gonio.models.corrected import UNMEASURED, Correction, folded, reflected
from gonio.shown import finite
from gonio.spectra import CHANNELS_NM
from gonio.typing import Floats
from gonio_analysis.appearance.assembled import MULTI_ANGLE, RETRO, _assembled, _key, _Numbers
from gonio_analysis.appearance.glossmeter import BOTH_COUNT, GLOSSMETERS, HAZEMETERS, gloss, parts
from gonio_analysis.appearance.sampled import NotMeasured, Sampled
from gonio_analysis.fitting.energy import ANYWHERE, UNDETERMINED, UNKNOWN
from gonio_analysis.fitting.propagation import axes_of
from gonio_analysis.result_records import Appearance, Quantity

if TYPE_CHECKING:
    from gonio.samples.description import SampleDescription
    from gonio_analysis.fitting.fit import FitResult
    from gonio_analysis.fitting.level import MeasuredLevel

DEFAULT_WAVELENGTH_NM = 550.0
KNOWN_BY_PARAMETERS = "Uncertainties are those of the sample's parameters, as its file states them."
KNOWN_BY_MISFIT = "Values and uncertainties hold the smooth curve of the model's misfit, as the file states it."
MEASURED_LEVEL = "The model has no level of its own: values are at the measured level, whose uncertainty theirs hold."
SPECTRUM_NM = tuple(np.arange(400.0, 701.0, 10.0).tolist())
"""Where a model's colour is evaluated [nm]."""
MODEL_INCIDENCES_DEG = (0.0, 8.0, 30.0, 45.0, 60.0)
"""Where a model's directional-hemispherical reflectance is stated."""
INCIDENCES = [math.radians(theta) for theta in MODEL_INCIDENCES_DEG]
AZIMUTH = "The model depends on the sample's azimuth: the source stands at phi_i = 180 degrees."
FEWER = 3
"""Every third of the directions that stand for the light over a hemisphere is taken: all incidences come together."""
SHARE_OF_U = 0.1
"""Share of a standard uncertainty: slopes of a model's quantities are taken over it. They are straight there, and its
effect is far above the error of the quadratures wherever the uncertainty is."""


def _sum_of(parts: Sequence[Callable[[], Sampled]], weight: float) -> Sampled:
    first, second = (part() for part in parts)
    return first.plus(second).times(weight)


def of_model(model: Model, *, name: str, source: str = "", wavelength_nm: float | None = None) -> Appearance:
    """The quantities of a model with exact parameters: without uncertainties."""
    wavelength = DEFAULT_WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
    numbers = _of_model(model, wavelength)
    notes = ["The sample's parameters are taken as exact: no uncertainty is stated.", *_colourless(numbers)]
    notes += _of_the_model(model, wavelength)
    return _assembled(numbers, lambda _: None, name, source, "model", wavelength, INCIDENCES, notes)


def _of_the_model(model: Model, wavelength_nm: float) -> list[str]:
    """What is said of the model itself: that it reflects more than it receives, its validity, the azimuth."""
    found = models.examine(model, wavelength_nm)
    said = [f"{found.too_bright}." * bool(found.too_bright), found.outside, AZIMUTH * model.depends_on_azimuth]
    return [text for text in said if text]


def of_sample(sample: SampleDescription, *, source: str = "", wavelength_nm: float | None = None) -> Appearance:
    """The quantities of a sample file, with the covariance of its parameters where it states one."""
    known = sample.uncertainty
    model = models.build(sample.model, sample.parameters)
    misfit = model.correction if isinstance(model, models.Corrected) else None
    model = model.model if isinstance(model, models.Corrected) else model
    if misfit is None and (known is None or not known.parameters):
        return of_model(model, name=sample.name, source=source, wavelength_nm=wavelength_nm)
    wavelength = DEFAULT_WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
    everything = numbers_in(sample.parameters)
    names = [] if known is None else known.parameters
    centre = np.array([everything[name] for name in names])

    def moved(point: Floats) -> Model | None:
        numbers = dict(zip(names, point.tolist(), strict=True))
        try:
            found = models.build(sample.model, with_numbers(sample.parameters, numbers))
        except ArgumentError:
            return None
        return found.model if isinstance(found, models.Corrected) else found

    u = np.zeros(0) if known is None else np.array(known.u)
    correlation = np.zeros((0, 0)) if known is None else np.array(known.correlation)
    numbers = _of_model(model, wavelength)
    notes = [KNOWN_BY_MISFIT if misfit is not None else KNOWN_BY_PARAMETERS, *_colourless(numbers)]
    _propagate(numbers, moved, centre, correlation * np.outer(u, u), wavelength, notes)
    if misfit is not None:
        notes += _with_misfit(numbers, model, misfit, wavelength, corrected=True)
    elif known is not None and known.misfit:
        _with_tau(numbers, known.misfit)
        notes.append(f"The model is off by {100 * known.misfit:.2g} % (its misfit): every value may be.")
    notes += _of_the_model(model, wavelength)
    return _assembled(numbers, _length, sample.name, source, "model", wavelength, INCIDENCES, notes)


def of_fits(parts: Sequence[tuple[float, FitResult]], *, name: str, source: str = "") -> Appearance:
    """The quantities over several models that predict about as well (`Choice.near`), each with its misfit.

    Parameters
    ----------
    parts
        Weights, and fits of one table.
    name, source
        What it is called, and the file that it came from.

    Returns
    -------
    Appearance
        Weighted means. Their variances are those of the models, and that among them. A model that does not determine a
        quantity has no weight in it; one that has none for another reason leaves none.
    """
    each = [of_fit(fit, name=name, source=source, residual=True) for _, fit in parts]
    weights = np.array([weight for weight, _ in parts])
    notes = dict.fromkeys(note for one in each for note in one.notes)
    mean: Appearance = _mean(weights / weights.sum(), [replace(one, notes=[]) for one in each])
    return replace(mean, notes=list(notes))


def _mean(weights: Floats, each: Sequence[Any]) -> Any:
    """The weighted mean of quantities, or of records and lists of them."""
    first = each[0]
    if isinstance(first, Quantity):
        known = np.array([one.value is not None and one.u is not None for one in each])
        missing = [one for one, there in zip(each, known, strict=True) if not there]
        other = [one for one in missing if one.why != UNDETERMINED]
        if other or not known.any():
            return (other or missing)[0]
        each = [one for one, there in zip(each, known, strict=True) if there]
        first, weights = each[0], weights[known] / weights[known].sum()
        values, u = (np.array([getattr(one, key) for one in each]) for key in ("value", "u"))
        mean = float(weights @ values)
        return replace(first, value=mean, u=math.sqrt(float(weights @ (u**2 + (values - mean) ** 2))))
    if isinstance(first, list):
        return [_mean(weights, ones) for ones in zip(*each, strict=True)]
    if is_dataclass(first):
        inner = {f.name: _mean(weights, [getattr(one, f.name) for one in each]) for f in fields(first)}
        return replace(cast(Any, first), **inner)
    return first


def of_fit(fit: FitResult, *, name: str, source: str = "", residual: bool = False) -> Appearance:
    """The quantities of a fitted model, with the covariance of its parameters and its misfit.

    Those of a model that the data reject are off by what the values tell of its misfit, which their uncertainties
    hold. With `residual` they are those of the model with the smooth curve of its misfit.
    """
    from gonio_analysis.fitting.level import level

    wavelength = DEFAULT_WAVELENGTH_NM if math.isnan(fit.wavelength_nm) else fit.wavelength_nm
    numbers = _of_model(fit.model, wavelength)
    lower, upper = fit.problem.bounds

    def moved(point: Floats) -> Model | None:
        return fit.problem.model(point) if bool(np.all((point >= lower) & (point <= upper))) else None

    notes = [*fit.notes, *_of_the_model(fit.model, wavelength)]
    if fit.misfit is not None:
        _propagate_far(numbers, [_of_model(fit.problem.model(point), wavelength) for point in fit.around])
        notes += _with_misfit(numbers, fit.model, fit.misfit.correction, wavelength, corrected=residual)
    else:
        levers = _propagate(numbers, moved, fit.vector, fit.spread, wavelength, notes)
        at_level = level(fit)
        if at_level is not None and levers.size:
            _at_level(numbers, fit.model, at_level, levers @ at_level.pull, wavelength)
            notes.append(MEASURED_LEVEL)
    return _assembled(numbers, _length, name, source, "fit", wavelength, INCIDENCES, notes)


def _propagate(
    numbers: _Numbers,
    moved: Callable[[Floats], Model | None],
    centre: Floats,
    covariance: Floats,
    wavelength_nm: float,
    notes: list[str],
) -> Floats:
    """Give numbers of a model their gradients, in units of the independent directions of a covariance.

    Returned are these directions, (k, parameters).
    `moved` is the model at a point of the parameters, None where there is none; then the slope is taken on one side.
    """
    levers = axes_of(covariance)
    gradients: dict[str, Floats] = {key: np.zeros(len(levers)) for key in numbers.values}
    for k, lever in enumerate(levers):
        ends = [(sign, moved(centre + sign * SHARE_OF_U * lever)) for sign in (1.0, -1.0)]
        sides = [(sign, _of_model(model, wavelength_nm).values) for sign, model in ends if model is not None]
        if not sides:
            notes.append("The parameters lie at bounds on both sides: uncertainties are left out.")
            for key, one in numbers.values.items():
                numbers.values[key] = replace(one, gradient=np.full(1, np.nan))
            return np.zeros(0)
        if len(sides) < len(ends):
            sides.append((0.0, numbers.values))
        (first, ahead), (second, behind) = sides
        for key, gradient in gradients.items():
            if key in ahead and key in behind:
                gradient[k] = (ahead[key].value - behind[key].value) / (SHARE_OF_U * (first - second))
    for key, gradient in gradients.items():
        numbers.values[key] = replace(numbers.values[key], gradient=gradient)
    return levers


def _at_level(numbers: _Numbers, model: Model, measured: MeasuredLevel, pull: Floats, wavelength_nm: float) -> None:
    """Bring numbers of a model without a level of its own to the measured level; `pull` is by their gradients' axes."""
    slopes: dict[str, float] = {}
    for theta_i, aspecular in MULTI_ANGLE:
        key = _key(theta_i, aspecular)
        if f"L {key}" in numbers.values:
            xyz = _xyz(model, theta_i, aspecular)
            slopes |= dict(zip((f"{letter} {key}" for letter in "Lab"), colour.lab_slope(xyz) @ xyz, strict=True))
    for key, one in numbers.values.items():
        per = float(slopes.get(key, one.value)) - float(one.gradient @ pull)
        value, gradient = one.value + per * measured.off, np.append(one.gradient, per * measured.u)
        numbers.values[key] = replace(one, value=value, gradient=gradient)


def _propagate_far(numbers: _Numbers, around: Sequence[_Numbers]) -> None:
    """The same from both ends of every direction of a covariance, each no farther than bounds and data let it go."""
    for key, one in numbers.values.items():
        ends = [there.values[key].value if key in there.values else one.value for there in around]
        numbers.values[key] = replace(one, gradient=(np.array(ends) - one.value) / math.sqrt(2.0))


def _length(one: Sampled) -> float | None:
    """Standard uncertainty of a number whose gradient is by independent variables of variance 1."""
    return finite(float(np.linalg.norm(one.gradient)))


def _in_plane(theta_i_deg: float, signed_deg: float) -> Directions:
    """A pair of directions in the plane of incidence, the source at phi_i = 180 degrees."""
    return Directions.from_degrees(theta_i_deg, 180.0, abs(signed_deg), 0.0 if signed_deg >= 0.0 else 180.0)


def _xyz(model: Model, theta_i_deg: float, aspecular_deg: float) -> Floats:
    """XYZ in a direction; raises `ArgumentError` where an index is not known over the whole of the spectrum."""
    at = _in_plane(theta_i_deg, theta_i_deg - aspecular_deg)
    if isinstance(model, models.SpectralModel) and model.of_channels:
        channels = model.brdf(*at.angles, wavelength_nm=np.array(CHANNELS_NM))
        return np.asarray(channels @ (math.pi * colour.channel_weights()))
    spectrum = model.brdf(*at.angles, wavelength_nm=np.array(SPECTRUM_NM))
    return np.asarray(spectrum @ (math.pi * colour.weights(SPECTRUM_NM)))


def _of_model(model: Model, wavelength_nm: float) -> _Numbers:
    numbers, none = _Numbers(), np.zeros(0)

    def exact(value: float, error: float = 0.0) -> Sampled:
        return Sampled(float(value), none, error)

    for meter in GLOSSMETERS:
        numbers.take(f"gloss_{meter.angle_deg:g}_gu", exact(*gloss(model, meter, wavelength_nm)))
    for key, meters in HAZEMETERS.items():
        both = [partial(exact, *gloss(model, meter, wavelength_nm)) for meter in meters]
        numbers.take(key, _sum_of(both, BOTH_COUNT[key]))
    theta = np.radians(MODEL_INCIDENCES_DEG)
    every = model.directional_hemispherical(theta, phi_i=math.pi, wavelength_nm=wavelength_nm, tolerance=1e-6)
    for angle, rho in zip(theta, every, strict=True):
        numbers.take(f"rho_dh {math.degrees(angle)}", exact(rho, 1e-6 * rho))
    eight = math.radians(8.0)
    numbers.take("rho_dh_8", numbers.values[f"rho_dh {math.degrees(eight)}"])
    numbers.take("spike_8", exact(model.specular_reflectivity(eight, wavelength_nm=wavelength_nm)))

    def f(theta_i_deg: float, signed_deg: float) -> float:
        return float(model.brdf(*_in_plane(theta_i_deg, signed_deg).floats, wavelength_nm=wavelength_nm))

    numbers.take("radiance_factor_0_45", exact(math.pi * f(0.0, 45.0)))
    numbers.take("radiance_factor_45_0", exact(math.pi * f(45.0, 0.0)))
    for entrance, observation, _ in RETRO:
        sides = [f(entrance, -(entrance + side * observation)) for side in (1.0, -1.0)]
        numbers.take(f"f {entrance}", exact(0.5 * sum(sides)))
    for theta_i, aspecular in MULTI_ANGLE:
        key = _key(theta_i, aspecular)
        found: Sequence[Sampled | NotMeasured]
        try:  # the rounding of sums over a grey spectrum is none
            found = [exact(round(value, 9)) for value in colour.lab(_xyz(model, theta_i, aspecular))]
        except ArgumentError as error:  # an index that is not known over the whole of the spectrum
            found = [NotMeasured(str(error))] * 3
        for letter, one in zip("Lab", found, strict=True):
            numbers.take(f"{letter} {key}", one)
    return numbers


@dataclass(frozen=True)
class _Light:
    """Where the light comes from that makes a number of a model: the number is spike + share @ brdf."""

    at: Directions
    brdf: Floats
    share: Floats
    spike: float = 0.0

    def times(self, factor: float) -> _Light:
        return replace(self, share=factor * self.share, spike=factor * self.spike)


def _lights(numbers: _Numbers, model: Model, wavelength_nm: float) -> dict[str, list[_Light]]:
    """The light for every number that is a sum over directions."""

    def point(theta_i_deg: float, signed_deg: float, share: float) -> _Light:
        at = Directions.stack([_in_plane(theta_i_deg, signed_deg)])
        return _Light(at, np.asarray(model.brdf(*at.angles, wavelength_nm=wavelength_nm)), np.array([share]))

    out = {f"gloss_{m.angle_deg:g}_gu": [_Light(*parts(model, m, wavelength_nm))] for m in GLOSSMETERS}
    for key, meters in HAZEMETERS.items():
        out[key] = [_Light(*parts(model, meter, wavelength_nm)).times(BOTH_COUNT[key]) for meter in meters]
    for degrees in MODEL_INCIDENCES_DEG:
        theta = math.radians(degrees)
        key = f"rho_dh {math.degrees(theta)}"
        spike = float(model.specular_reflectivity(theta, wavelength_nm=wavelength_nm))
        at, brdf = reflected(model, theta, math.pi, wavelength_nm)
        at, brdf = at[1::FEWER], brdf[1::FEWER]
        out[key] = [_Light(at, brdf, (numbers.values[key].value - spike) / max(brdf.size, 1) / brdf, spike)]
        if degrees == 8.0:
            out["rho_dh_8"] = out[key]
            out["spike_8"] = [_Light(at[:0], brdf[:0], brdf[:0], spike)]
    out["radiance_factor_0_45"] = [point(0.0, 45.0, math.pi)]
    out["radiance_factor_45_0"] = [point(45.0, 0.0, math.pi)]
    for entrance, observation, _ in RETRO:
        out[f"f {entrance}"] = [point(entrance, -(entrance + side * observation), 0.5) for side in (1.0, -1.0)]
    for theta_i, aspecular in MULTI_ANGLE:
        out[f"L {_key(theta_i, aspecular)}"] = [point(theta_i, theta_i - aspecular, 1.0)]
    return out


def _with_misfit(
    numbers: _Numbers, model: Model, correction: Correction, wavelength_nm: float, *, corrected: bool
) -> list[str]:
    """Give numbers of a model the uncertainty of its misfit, and say which the values tell nothing of.

    `corrected` ones hold the misfit that the values tell, too. Of others that is an error, which is in the uncertainty.
    """
    lights = _lights(numbers, model, wavelength_nm)
    flat = [one for key, ones in lights.items() if key != "rho_dh_8" for one in ones]
    at = folded(Directions(*(np.concatenate([getattr(one.at, a) for one in flat]) for a in ANGLES)), model)
    brdf = np.concatenate([one.brdf for one in flat])
    known, root = correction.beside(at, brdf)
    open_part = correction.open(at)
    ends = np.cumsum([one.brdf.size for one in flat])
    rows = {id(one): np.arange(end - one.brdf.size, end) for one, end in zip(flat, ends, strict=True)}
    unmeasured = []
    for key, ones in lights.items():
        here = np.concatenate([rows[id(one)] for one in ones])
        share = np.concatenate([one.share for one in ones])
        spike = sum(one.spike for one in ones)
        lobe = share * brdf[here]
        left = float(lobe @ open_part[here]) / lobe.sum() if lobe.sum() > 0 else 0.0
        if key[:2] == "L ":
            if key in numbers.values:  # else the model has no spectrum
                by = brdf[here[0]]
                ratio, of_ratio = known[here[0]] / by, root[here[0]] / by
                _colour_with_misfit(numbers, model, key[2:], ratio, of_ratio, left, corrected)
        else:
            off = float(share @ (known[here] - brdf[here]))
            one = numbers.values[key]
            gradient = [*(share @ root[here]), spike * correction.spike, 0.0 if corrected else off]
            numbers.values[key] = replace(
                one, value=one.value + corrected * off, gradient=np.append(gradient, left * one.gradient)
            )
        if left > UNMEASURED and lobe.sum() > spike:
            unmeasured.append(key)
    _leave_out(numbers, [key for key in unmeasured if key[:2] != "L "])
    named = dict.fromkeys(_in_words(key) for key in unmeasured if key != "rho_dh_8")
    return [f"No value near tells the misfit of: {', '.join(named)}. There the model alone speaks."] if named else []


def _leave_out(numbers: _Numbers, keys: Sequence[str]) -> None:
    """Take back numbers of which the directions tell too little."""
    for key in keys:
        one = numbers.values[key]
        most = min(UNKNOWN * one.value, ANYWHERE if key[:6] == "rho_dh" else math.inf)
        if float(np.linalg.norm(one.gradient)) > most:
            del numbers.values[key]
            numbers.take(key, NotMeasured(UNDETERMINED))


def _colour_with_misfit(
    numbers: _Numbers, model: Model, key: str, ratio: float, root: Floats, left: float, corrected: bool
) -> None:
    """L*a*b* in one direction, where the misfit is the same at all wavelengths."""
    xyz = _xyz(model, *map(float, key.split("as")))
    off = np.asarray(colour.lab(ratio * xyz)) - np.asarray(colour.lab(xyz))
    gradient = colour.lab_slope(ratio * xyz) @ np.outer(xyz, root)
    for k, letter in enumerate("Lab"):
        one = numbers.values[f"{letter} {key}"]
        own = np.array([*gradient[k], 0.0, 0.0 if corrected else off[k], *(left * one.gradient)])
        value = round(one.value + corrected * float(off[k]), 9)
        numbers.values[f"{letter} {key}"] = replace(one, value=value, gradient=own)


def _in_words(key: str) -> str:
    """The name of a number, for a note."""
    kind, _, at = key.partition(" ")
    if at:
        return {"L": f"colour at {at}", "f": f"retroreflection at {at}°"}.get(kind) or f"rho_dh at {float(at):.3g}°"
    words = key.split("_")
    return {"gloss": f"gloss at {words[1]}°", "radiance": f"radiance factor {':'.join(words[2:])}"}.get(
        words[0], words[0]
    )


def _with_tau(numbers: _Numbers, tau: float) -> None:
    """Add the misfit of a model of which nothing but its size is known: each number is off for itself."""
    for k, (key, one) in enumerate(numbers.values.items()):
        size = (one.value + 16.0 * (key[0] == "L")) / 3.0 if key[:2] in ("L ", "a ", "b ") else one.value
        own = np.zeros(len(numbers.values))
        own[k] = tau * size  # lightness goes by the cube root of the light
        numbers.values[key] = replace(one, gradient=np.append(one.gradient, own))


def _colourless(numbers: _Numbers) -> list[str]:
    """A remark where a model has the same value at every wavelength, as one that was fitted at a single one."""
    tints = [value.value for key, value in numbers.values.items() if key[:2] in ("a ", "b ")]
    if not tints or any(tints):
        return []
    return ["The model is the same at every wavelength: its colours are those of a grey, not of a measured spectrum."]
