"""Every quantity of appearance of a table, a model or a fit, with its uncertainty (docs/appearance.md).

Hemispherical reflectances of a table are integrals over its values, each with its gradient by all of them, as in
`gonio_analysis.appearance.sampled`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gonio import colour
from gonio.geometry import SAME_ANGLE, Directions, groups
from gonio.measurement import is_simulated
from gonio.typing import DataFrame, Floats
from gonio_analysis.appearance import sampled
from gonio_analysis.appearance.assembled import MULTI_ANGLE, RETRO, _assembled, _key, _Numbers
from gonio_analysis.appearance.glossmeter import BOTH_COUNT, GLOSSMETERS, HAZEMETERS
from gonio_analysis.appearance.of_models import _sum_of
from gonio_analysis.appearance.sampled import NotMeasured, Rows, Sampled, cone_response, mean
from gonio_analysis.curves.in_plane import Curve, curves
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.result_records import Appearance

LEAST_COVERED = 0.85
"""Share of the projected hemisphere that an integral over it needs."""
PEAK = math.radians(2.5)
"""Distance from the mirror direction beyond which a specular peak may hide between values."""
MOST_INCIDENCES = 12
FEWEST_DIRECTIONS = 20
"""Fewest directions of an integral over a hemisphere."""
SAME_PLACE = 1e-3
"""Distance on the projected hemisphere within which values are of one direction, about 0.06 degrees."""
NEAR_8 = math.radians(2.5)
FARTHEST_FROM_8 = math.radians(30.0)


def reflectances(data: Observations) -> dict[float, Sampled | NotMeasured]:
    """Directional-hemispherical reflectance at the incidences [rad] of some observations.

    At most `MOST_INCIDENCES` of them, evenly chosen; the mean of several azimuths.
    """
    at = data.directions
    by_theta: dict[float, list[Rows]] = {}
    for rows in _incidences(at):
        by_theta.setdefault(round(math.degrees(float(at.theta_i[rows].mean())), 1), []).append(rows)
    known = sorted(by_theta)
    chosen = np.unique(np.round(np.linspace(0, len(known) - 1, min(len(known), MOST_INCIDENCES))).astype(int))
    near_8 = {theta for theta in known if abs(math.radians(theta - 8.0)) <= NEAR_8}
    out: dict[float, Sampled | NotMeasured] = {}
    for theta in sorted({known[k] for k in chosen} | near_8):
        found: list[Sampled] = []
        why: NotMeasured | None = None
        for rows in by_theta[theta]:
            try:
                found.append(_reflectance(data, rows))
            except NotMeasured as error:
                why = error
        if found:
            out[math.radians(theta)] = replace(mean(found), note=found[0].note)
        elif why is not None:
            out[math.radians(theta)] = why
    return out


def reflectance_at_8(every: Mapping[float, Sampled | NotMeasured]) -> Sampled:
    """Reflectance at 8 degrees from those at other incidences: of one near it, or linear in theta^2 between two."""
    goal = math.radians(8.0)
    known = {theta: one for theta, one in every.items() if isinstance(one, Sampled)}
    near = min(every, key=lambda theta: abs(theta - goal), default=math.inf)
    if near in known and abs(near - goal) <= NEAR_8:
        return known[near]
    below = max((t for t in known if t < goal), default=None)
    above = min((t for t in known if goal <= t <= FARTHEST_FROM_8), default=None)
    if below is not None and above is not None:
        share = (goal**2 - below**2) / (above**2 - below**2)
        mixed = known[below].times(1.0 - share).plus(known[above], share)
        return replace(mixed, error=mixed.error + abs(known[above].value - known[below].value) / 4.0)
    bound = every.get(near)
    if isinstance(bound, NotMeasured) and abs(near - goal) <= NEAR_8:
        raise bound
    reached = ", ".join(f"{math.degrees(t):.1f}°" for t in sorted(known)) or "none"
    raise NotMeasured(f"no hemisphere was measured at 8°, nor on both sides of it up to 30°; hemispheres: {reached}")


def spike_reflectivity(data: Observations, theta_i: float) -> Sampled:
    """Reflectivity of the specular spike at an incidence [rad], the mean over the azimuths that have a curve."""
    found = []
    for rows in _incidences(data.directions):
        if abs(float(data.directions.theta_i[rows].mean()) - theta_i) <= SAME_ANGLE:
            part = _Projected(data, rows)
            if part.spike is not None:
                found.append(part.spike)
    if not found:
        raise NotMeasured("no mirror direction was measured with stated cones of source and receiver")
    return mean(found)


def _incidences(at: Directions) -> list[Rows]:
    """Rows of one direction of incidence each; all azimuths of normal incidence are one."""
    return [rows for rows in groups(at.theta_i, at.phi_i, np.arange(len(at))) if rows.size >= 2]


def _reflectance(data: Observations, rows: Rows) -> Sampled:
    part = _Projected(data, rows)
    if part.points.shape[0] < FEWEST_DIRECTIONS or np.ptp(part.points[:, 1]) < 0.3:
        theta = math.degrees(float(data.directions.theta_i[rows].mean()))
        raise NotMeasured(f"at {theta:.1f}° of incidence values lie in or near one plane and do not span a hemisphere")
    lobe, rim, covered = part.integral(slice(None))
    if covered < LEAST_COVERED:
        least = lobe.plus(rim, -1.0).value - _unresolved(part, lobe)
        why = f"{100 * covered:.0f} % of the projected hemisphere was measured, {100 * LEAST_COVERED:.0f} % are needed"
        bounds = 0.0 < least <= 1.0 and bool(np.all(data.brdf[rows] >= 0.0))
        raise NotMeasured(why, at_least=least if bounds else None)
    note = None
    if part.gap > PEAK:
        away = f"{math.degrees(part.gap):.1f}°"
        note = f"the nearest value to the mirror direction is {away} away: a narrower peak is not in it"
    total = replace(lobe, error=_unresolved(part, lobe) / 3.0 + 0.5 * abs(rim.value))
    return replace(total if part.spike is None else total.plus(part.spike), note=note)


def _unresolved(part: _Projected, lobe: Sampled) -> float:
    """How far an integral changes when every other direction is left out: a peak is no wider than their distances."""
    return max(abs(lobe.value - part.integral(slice(first, None, 2))[0].value) for first in (0, 1))


class _Projected:
    """Values of one incidence over the projected hemisphere, both sides of the plane of incidence taken as alike."""

    def __init__(self, data: Observations, rows: Rows) -> None:
        at = data.directions[rows]
        if bool(at.theta_i.max() < SAME_ANGLE):  # at normal incidence azimuths of the source mean nothing
            at = at.seen_from(0.0)
        self._n = len(data)
        omega = at.from_incidence
        self.gap = float(at.mirror_offset.min())
        self._theta_i = float(at.theta_i.mean())
        response = cone_response(data, rows) if data.source_solid_angle_sr and data.receiver_solid_angle_sr else None
        lobe = np.ones(rows.size, dtype=bool) if response is None else response == 0.0
        xy = np.stack([omega[:, 0], np.abs(omega[:, 1])], axis=1)[lobe]
        # values in one direction (both sides of the plane, repeats) count as their mean
        keys = np.round(xy / SAME_PLACE).astype(np.int64)
        _, first, place = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.points = xy[first]
        order = np.lexsort((self.points[:, 0], self.points[:, 1]))
        back = np.argsort(order)
        self.points = self.points[order]
        self._place = back[place.reshape(-1)]
        self._rows = rows[lobe]
        self._share = 1.0 / np.bincount(self._place, minlength=len(self.points))[self._place]
        self._f = np.bincount(self._place, weights=data.brdf[self._rows] * self._share, minlength=len(self.points))
        self.spike: Sampled | None = None
        if response is not None and response.any():
            self.spike = self._spike(data, rows, response, omega)

    def _gradient(self, weights: Floats) -> Floats:
        """Weights of the points as those of the table's values."""
        out = np.zeros(self._n)
        np.add.at(out, self._rows, weights[self._place] * self._share)
        return out

    def _spike(self, data: Observations, rows: Rows, response: Floats, omega: Floats) -> Sampled | None:
        """The excess in the mirror direction over what lies around it."""
        caught = np.flatnonzero(response > 0.5 * response.max())
        distance = np.linalg.norm(
            self.points - [-math.sin(self._theta_i), 0.0], axis=1
        )  # the mirror direction; the lobe there: a plane through what is nearest
        nearest = np.argsort(distance, kind="stable")[:6]
        if nearest.size < 3:
            return None
        near = self.points[nearest] - [-math.sin(self._theta_i), 0.0]
        level = np.linalg.pinv(np.stack([np.ones(nearest.size), near[:, 0], near[:, 1] ** 2], axis=1))[0]
        weights = np.zeros(len(self.points))
        weights[nearest] = level
        expected = float(weights @ self._f)
        squares = float((response[caught] ** 2).sum())
        gradient = -self._gradient(weights) * float(response[caught].sum()) / squares
        gradient[rows[caught]] += response[caught] / squares
        value = float(response[caught] @ (data.brdf[rows[caught]] - expected)) / squares
        spread = float(np.ptp(self._f[nearest])) * float(response[caught].sum()) / squares
        return Sampled(value, gradient, spread / 3.0)

    def integral(self, taken: slice) -> tuple[Sampled, Sampled, float]:
        """Integral of the lobe; the part of it from beyond the outermost values; the share that those enclose."""
        from scipy.spatial import Delaunay, QhullError

        chosen = np.arange(len(self.points))[taken]
        points = self.points[chosen]
        off = np.flatnonzero(points[:, 1] > SAME_PLACE)
        both = np.concatenate([points, points[off] * (1.0, -1.0)])
        source = np.concatenate([chosen, chosen[off]])
        try:
            mesh = Delaunay(both)
        except QhullError:
            raise NotMeasured("values of this incidence lie in one plane and do not span a hemisphere") from None
        a, b, c = (both[mesh.simplices[:, k]] for k in range(3))
        area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        weights, rim = np.zeros(len(self.points)), np.zeros(len(self.points))
        for k in range(3):
            np.add.at(weights, source[mesh.simplices[:, k]], area / 3.0)
        first, second = (both[mesh.convex_hull[:, k]] for k in range(2))
        turn = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        sector = 0.5 * np.arctan2(turn, (first * second).sum(axis=1))  # of the unit circle
        for k in range(2):
            np.add.at(rim, source[mesh.convex_hull[:, k]], 0.5 * np.maximum(sector - 0.5 * turn, 0.0))
        lobe = Sampled(float((weights + rim) @ self._f), self._gradient(weights + rim), 0.0)
        return lobe, Sampled(float(rim @ self._f), self._gradient(rim), 0.0), float(area.sum()) / math.pi


VISIBLE_NM = (380.0, 780.0)
LARGEST_STEP_NM = 20.0
REACH_NM = (420.0, 680.0)
"""A table's wavelengths have to lie no farther apart than this, and to reach these, for a colour."""
EIGHT = math.radians(8.0)
RETRO_GAP_DEG = 1.0
"""Largest gap between two values that one near the source is interpolated from."""


def of_table(
    table: DataFrame | Observations, *, name: str = "the table", source: str = "", wavelength_nm: float | None = None
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
    incidences = reflectances(at)
    numbers.put("rho_dh_8", lambda: reflectance_at_8(incidences))
    for theta, rho in incidences.items():
        numbers.take(f"rho_dh {math.degrees(theta)}", rho)
    numbers.put("spike_8", lambda: spike_reflectivity(at, _nearest_8(incidences)))
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
    if abs(near - EIGHT) > NEAR_8:
        raise NotMeasured(f"no incidence within {math.degrees(NEAR_8):g}° of 8° was measured")
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
    coloured = data.of_channels or (
        len(waves) > 1
        and max(np.diff(waves)) <= LARGEST_STEP_NM + 1e-6
        and waves[0] <= REACH_NM[0]
        and waves[-1] >= REACH_NM[1]
    )
    if coloured:
        matrix = math.pi * (colour.channel_weights() if data.of_channels else colour.weights(waves))
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
