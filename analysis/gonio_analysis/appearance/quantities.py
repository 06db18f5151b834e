"""Every quantity of appearance of a table, a model or a fit, with its uncertainty (docs/appearance.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import colour
from gonio.measurement import is_simulated
from gonio.typing import Floats
from gonio_analysis.appearance import sampled, sampled_hemisphere
from gonio_analysis.appearance.assembled import MULTI_ANGLE, RETRO, _assembled, _key, _Numbers
from gonio_analysis.appearance.glossmeter import BOTH_COUNT, GLOSSMETERS, HAZEMETERS
from gonio_analysis.appearance.of_models import _sum_of
from gonio_analysis.appearance.sampled import NotMeasured, Sampled
from gonio_analysis.curves.in_plane import Curve, curves
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.result_records import Appearance

if TYPE_CHECKING:
    import pandas as pd


VISIBLE_NM = (380.0, 780.0)
LARGEST_STEP_NM = 20.0
REACH_NM = (420.0, 680.0)
"""A table's wavelengths have to lie no farther apart than this, and to reach these, for a colour."""
EIGHT = math.radians(8.0)
RETRO_GAP_DEG = 1.0
"""Between two values that one near the source is interpolated from."""


def of_table(
    table: pd.DataFrame | Observations, *, name: str = "the table", source: str = "", wavelength_nm: float | None = None
) -> Appearance:
    """The quantities of a measurement table of one sample.

    Parameters
    ----------
    table
        A measurement table, or what `observations` made of one.
    name, source
        What it is called, and the file that it came from.
    wavelength_nm
        Everything but colour is stated at the nearest wavelength; of 550 nm if none is given.

    Raises
    ------
    DataError
        No value of the table can be used.
    """
    data = table if isinstance(table, Observations) else observations(table, name)
    at, wavelength = data.nearest(wavelength_nm)
    numbers = _Numbers()
    for meter in GLOSSMETERS:
        numbers.put(f"gloss_{meter.angle_deg:g}_gu", partial(sampled.gloss, at, meter))
    for key, meters in HAZEMETERS.items():
        numbers.put(key, partial(_sum_of, [partial(sampled.gloss, at, meter) for meter in meters], BOTH_COUNT[key]))
    incidences = sampled_hemisphere.reflectances(at)
    numbers.put("rho_dh_8", lambda: sampled_hemisphere.reflectance_at_8(incidences))
    for theta, rho in incidences.items():
        numbers.take(f"rho_dh {math.degrees(theta)}", rho)
    numbers.put("spike_8", lambda: sampled_hemisphere.spike_reflectivity(at, _nearest_8(incidences)))
    every, n = curves(at), len(at)
    for key, pair in (("0_45", (0.0, 45.0)), ("45_0", (45.0, 0.0))):
        numbers.put(f"radiance_factor_{key}", partial(_value, every, n, *pair, times=math.pi))
    for entrance, observation, _ in RETRO:
        numbers.put(f"f {entrance}", partial(_retro, every, n, entrance, observation))
    _table_colours(numbers, data, at, every)
    notes = list(data.notes)
    if not VISIBLE_NM[0] <= wavelength <= VISIBLE_NM[1]:
        notes.append(
            "Gloss, haze and retroreflection are quantities of visible light; these are their like in this band."
        )
    if not (at.source_solid_angle_sr and at.receiver_solid_angle_sr):
        notes.append(
            "The cones of source and receiver are not both stated: a specular spike cannot be told from the lobe, and a"
            " spike that the values leave out is not in the gloss."
        )

    def uncertainty(one: Sampled) -> float | None:
        whole = data if one.gradient.size == len(data) else at
        if whole.covariance is None:
            return None
        own = one.gradient * whole.covariance.random
        common = (one.gradient[:, None] * whole.covariance.common).sum(axis=0)
        return math.sqrt(float((own**2).sum() + (common**2).sum()))

    found = _assembled(numbers, uncertainty, name, source, "table", wavelength, list(incidences), notes)
    return replace(found, simulated=not isinstance(table, Observations) and is_simulated(table))


def _nearest_8(incidences: Mapping[float, object]) -> float:
    near = min(incidences, key=lambda theta: abs(theta - EIGHT), default=math.inf)
    if abs(near - EIGHT) > sampled_hemisphere.NEAR_8:
        raise NotMeasured(f"no incidence within {math.degrees(sampled_hemisphere.NEAR_8):g}° of 8° was measured")
    return near


def _value(every: Sequence[Curve], n: int, theta_i_deg: float, signed_deg: float, *, times: float = 1.0) -> Sampled:
    return sampled.in_plane_value(every, n, math.radians(theta_i_deg), math.radians(signed_deg)).times(times)


def _retro(every: Sequence[Curve], n: int, entrance: float, observation: float) -> Sampled:
    """The BRDF at an observation angle to either side of the source: the mean of those that were measured."""
    theta, gap, found, why = math.radians(entrance), math.radians(RETRO_GAP_DEG), list[Sampled](), None
    for side in (1.0, -1.0):
        signed = -math.radians(entrance + side * observation)
        try:
            found.append(sampled.in_plane_value(every, n, theta, signed, gap=gap))
        except NotMeasured as error:
            why = error
    if why is not None and not found:
        raise why
    return sampled.mean(found)


def _table_colours(numbers: _Numbers, data: Observations, at: Observations, every: list[Curve]) -> None:
    waves = [w for w in data.wavelengths if 360.0 <= w <= 830.0]  # not a broad band, whose wavelength is NaN
    coloured = (
        len(waves) > 1
        and max(np.diff(waves)) <= LARGEST_STEP_NM + 1e-6
        and waves[0] <= REACH_NM[0]
        and waves[-1] >= REACH_NM[1]
    )
    if coloured:
        matrix = math.pi * colour.weights(waves)
        spectra = [(np.flatnonzero(np.abs(data.wavelength_nm - w) <= 1e-6), curves(data.at(w))) for w in waves]
    for theta_i, aspecular in MULTI_ANGLE:
        found: Sequence[Sampled | NotMeasured] = [_no_spectrum(data.wavelengths)] * 3
        if coloured:
            signed = theta_i - aspecular
            try:
                values = [(rows, _value(along, rows.size, theta_i, signed)) for rows, along in spectra]
                found = _lab(values, matrix, len(data))
            except NotMeasured as error:
                found = [error] * 3
        for letter, number in zip("Lab", found, strict=True):
            numbers.take(f"{letter} {_key(theta_i, aspecular)}", number)


def _no_spectrum(waves: Sequence[float]) -> NotMeasured:
    """Why the values at these wavelengths [nm] (NaN: a broad band) have no colour, nor a lightness."""
    known = [w for w in waves if not math.isnan(w)]
    have = (
        "states none"
        if not known
        else f"has one, {known[0]:g} nm"
        if len(known) == 1
        else f"has {len(known)}, from {known[0]:g} to {known[-1]:g} nm"
    )
    return NotMeasured(
        f"a colour needs a spectrum, wavelengths in steps of at most {LARGEST_STEP_NM:g} nm that reach"
        f" {REACH_NM[0]:g} and {REACH_NM[1]:g} nm: the table {have}"
    )


def _lab(values: Sequence[tuple[Any, Sampled]], matrix: Floats, n: int) -> list[Sampled]:
    """L*a*b* from the BRDF at each wavelength and its rows of the table."""
    xyz = np.array([one.value for _, one in values]) @ matrix
    gradient = np.zeros((3, n))
    for weights, (rows, one) in zip(matrix, values, strict=True):
        gradient[:, rows] += weights[:, None] * one.gradient
    error = np.abs(np.array([one.error for _, one in values]) @ matrix)
    slope = colour.lab_slope(xyz)
    numbers = zip(colour.lab(xyz), slope @ gradient, np.abs(slope) @ error, strict=True)
    return [Sampled(float(value), g, float(e)) for value, g, e in numbers]
