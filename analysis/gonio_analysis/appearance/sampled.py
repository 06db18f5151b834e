"""Quantities of appearance from the values of a table, each with its gradient by all of them.

Every function takes observations at one wavelength and returns a `Sampled`; where the angles are missing it raises
`NotMeasured`, whose message says which. docs/appearance.md says what is assumed of a sample between its values.

Gloss of a table is read along its in-plane curve at that incidence, or along one by reciprocity. The scattering is
taken to depend on the half vector's angle theta_h: ln(f cos(theta_i) cos(theta_r)) is linear in tan^2(theta_h) between
measured values, exact for Gaussian slopes. Isotropy is assumed. Values out of the plane within 25 degrees of the
mirror direction correct this: their ratio to what the curve says there is linear over the receiver's focal plane. A
curve made by reciprocity is not corrected. Where values out of the plane agree much better with f alone, with f
cos(theta_i) cos(theta_r) over the Fresnel reflectance of glass, or with the shadowing of V-grooves (Cook and Torrance
1982), that one is taken.

The spike is the excess of the value in the mirror direction over what its neighbours outside of the cones predict,
times the overlap of the two cones. Without stated cones all is interpolated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gonio.errors import DataError
from gonio.geometry import IN_PLANE, SAME_ANGLE, SAME_AZIMUTH, Directions, wrap
from gonio.models import HeTorrance, fresnel
from gonio.typing import Floats
from gonio_analysis.appearance.glossmeter import STANDARD_INDEX, Glossmeter
from gonio_analysis.curves.in_plane import Curve, curves
from gonio_analysis.fitting.observations import Observations

Rows = npt.NDArray[np.intp]
Shape = Literal["cosines", "plain", "fresnel", "grooves"]
SHAPES: tuple[Shape, ...] = ("cosines", "plain", "fresnel", "grooves")
"""What depends on the half vector alone: f cos cos, f, f cos cos over the Fresnel reflectance of glass, or that over
the shadowing of V-grooves (Cook and Torrance 1982), too. Values out of the plane of incidence say which.
Without any the first is taken, and the next two say how far the choice matters: where grooves matter, those two do."""
CLEARLY_BETTER = 0.6
"""Misfit [ln] out of the plane of the shape that is taken in place of the first, over that of the first."""
NEARLY_AS_GOOD, ANY_MISFIT = 1.5, 0.01
"""A shape whose misfit is at most this many times the best one's, plus this much, may be right as well."""

LARGEST_GAP = math.radians(10.0)
"""Largest gap between two directions of a curve that a third is interpolated from."""
WING = math.radians(6.0)
"""Width on both sides of the mirror direction within which a gloss needs values."""
LARGEST_LN_RATIO = 3.0
"""Largest log ratio of a value out of the plane of incidence to what the curve says; beyond, the curve says nothing."""
WINDOW = math.radians(25.0)
"""Window around the mirror direction: values out of the plane of incidence that count for a gloss."""
BEYOND = 0.02
"""Share of a glossmeter's flux that may come from beyond the measured directions."""
LARGEST_ERROR_GU, LARGEST_ERROR = 1.0, 0.2
"""A gloss is stated up to this error: the larger of a number of gloss units and a share."""
MIRROR = HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=STANDARD_INDEX)
"""A surface with nothing but a spike, of known reflectivity: what an instrument's cones make of one."""


class NotMeasured(DataError):
    """A table does not hold the angles that a quantity needs.

    Attributes
    ----------
    at_least
        A lower bound of the quantity, where what was measured gives one.
    """

    def __init__(self, why: str, at_least: float | None = None) -> None:
        super().__init__(why)
        self.at_least = at_least


@dataclass(frozen=True)
class Sampled:
    """A number made from a table's values."""

    value: float
    gradient: Floats
    """Derivatives by every value of the observations, (n,)."""
    error: float
    """Estimated error of the interpolation between values."""
    note: str | None = None

    def times(self, factor: float) -> Sampled:
        """The number times an exact one."""
        return Sampled(self.value * factor, self.gradient * factor, self.error * abs(factor))

    def plus(self, other: Sampled, weight: float = 1.0) -> Sampled:
        """The number plus `weight` times another of the same observations."""
        return Sampled(
            self.value + weight * other.value,
            self.gradient + weight * other.gradient,
            self.error + abs(weight) * other.error,
        )


# --- values in one direction -----------------------------------------------------------------------------------------


def in_plane_value(
    every: Sequence[Curve], n: int, theta_i: float, signed: float, *, gap: float = LARGEST_GAP
) -> Sampled:
    """The BRDF [1/sr] in a direction in the plane of incidence, linear between the two measured beside it.

    Curves by reciprocity count; several (azimuths of the sample) are averaged.

    Parameters
    ----------
    every, n
        The curves of some observations, and how many values those have.
    theta_i, signed
        Angle of incidence, and signed angle of the detector [rad].
    gap
        Largest distance of the two [rad].
    """
    found = []
    for still, moving in ((theta_i, signed), (abs(signed), math.copysign(theta_i, signed))):
        for curve in every:
            if abs(curve.parameter - still) <= SAME_ANGLE:
                sides = (moving, -moving) if still < SAME_ANGLE else (moving,)
                found += [one for one in (_along(curve, side, gap, n) for side in sides) if one is not None]
    if not found:
        raise NotMeasured(
            f"no value within {math.degrees(gap):g}° of theta_i = {math.degrees(theta_i):g}°, theta_r ="
            f" {math.degrees(signed):g}° (signed) in the plane of incidence"
        )
    return mean(found)


def _along(curve: Curve, angle: float, gap: float, n: int) -> Sampled | None:
    nearest = int(np.argmin(np.abs(curve.angle - angle)))
    gradient = np.zeros(n)
    if abs(curve.angle[nearest] - angle) <= SAME_ANGLE / 2:
        gradient[curve.rows[nearest]] = 1.0
        return Sampled(float(curve.brdf[nearest]), gradient, 0.0)
    above = int(np.searchsorted(curve.angle, angle))
    if not 0 < above < curve.angle.size or curve.angle[above] - curve.angle[above - 1] > gap:
        return None
    low, high = curve.angle[above - 1], curve.angle[above]
    share = float((angle - low) / (high - low))
    gradient[curve.rows[above - 1]], gradient[curve.rows[above]] = 1.0 - share, share
    value = float((1.0 - share) * curve.brdf[above - 1] + share * curve.brdf[above])
    others = [k for k in (above - 2, above + 1) if 0 <= k < curve.angle.size and curve.angle[k] not in (low, high)]
    curvature = 0.0
    for k in others:  # the parabola through a third value, less the straight line
        slope = (curve.brdf[above] - curve.brdf[above - 1]) / (high - low)
        second = ((curve.brdf[k] - curve.brdf[above]) / (curve.angle[k] - high) - slope) / (curve.angle[k] - low)
        curvature = max(curvature, abs(float(second * (angle - low) * (angle - high))))
    return Sampled(value, gradient, curvature)


def made_of(function: Callable[..., float], *parts: Sampled, step: float | None = None) -> Sampled:
    """A smooth function of several numbers, by its difference quotients over `step`, or over a millionth of each."""
    at = [part.value for part in parts]
    gradient, error = np.zeros_like(parts[0].gradient), 0.0
    for k, part in enumerate(parts):
        step_k = 1e-6 * max(abs(part.value), 1e-3) if step is None else step
        ahead, behind = (function(*at[:k], at[k] + sign * step_k, *at[k + 1 :]) for sign in (1.0, -1.0))
        slope = (ahead - behind) / (2.0 * step_k)
        gradient = gradient + slope * part.gradient
        error += abs(slope) * part.error
    return Sampled(function(*at), gradient, error)


def mean(found: Sequence[Sampled]) -> Sampled:
    return reduce(Sampled.plus, found).times(1.0 / len(found))


# --- gloss -----------------------------------------------------------------------------------------------------------


def gloss(data: Observations, meter: Glossmeter) -> Sampled:
    """Gloss [GU] from the curves at a glossmeter's angle; those of several azimuths are averaged."""
    every = curves(data)
    near = [c for c in every if abs(c.parameter - meter.theta) <= SAME_ANGLE]
    if not near:
        known = ", ".join(f"{a:g}°" for a in sorted({round(math.degrees(c.parameter), 1) for c in every}))
        raise NotMeasured(
            f"no in-plane curve at {meter.angle_deg:g}° (within {math.degrees(SAME_ANGLE):g}°); measured:"
            f" {known or 'none'}"
        )
    return mean([_gloss(data, curve, meter) for curve in near])


def _gloss(data: Observations, curve: Curve, meter: Glossmeter) -> Sampled:
    offset = curve.angle - curve.parameter
    if not np.any(np.abs(offset - meter.offset) <= meter.reach):
        raise NotMeasured(
            f"no value within {math.degrees(meter.reach):.1f}° of the {meter.where} on the curve at"
            f" {math.degrees(curve.parameter):.1f}°"
        )
    if not (np.any(np.abs(offset + 0.5 * WING) <= 0.5 * WING) and np.any(np.abs(offset - 0.5 * WING) <= 0.5 * WING)):
        raise NotMeasured(
            f"the curve at {math.degrees(curve.parameter):.1f}° has no values on both sides of the mirror direction"
            f" within {math.degrees(WING):g}°"
        )
    response = spike_response(data, curve)
    scale = 100.0 / meter.standard
    shapes = _shapes(data, curve, response)
    full, beyond = _through(data, curve, meter, response, slice(None), shapes[0])
    thin = _every_other(curve)
    try:
        whole, half = (
            _through(data, curve, meter, response, k, shapes[0], flat=True)[0].value for k in (slice(None), thin)
        )
        error = abs(whole - half) / 3.0
    except NotMeasured:
        error = math.nan
    others = [_through(data, curve, meter, response, slice(None), kind)[0].value for kind in shapes[1:]]
    if len(shapes) == 1:  # what the values out of the plane changed is what the plane left open
        others.append(_through(data, curve, meter, response, slice(None), shapes[0], flat=True)[0].value)
    error += max((abs(value - full.value) for value in others), default=0.0) + abs(beyond)
    if abs(beyond) > BEYOND * abs(full.value):
        raise NotMeasured(
            f"{100 * abs(beyond / full.value):.0f} % of the flux through the apertures at {meter.angle_deg:g}° comes"
            " from directions beyond the measured ones"
        )
    if error > max(LARGEST_ERROR_GU / scale, LARGEST_ERROR * abs(full.value)):
        every = [full.value, *others]
        if len(shapes) < len(SHAPES):
            every.append(_through(data, curve, meter, response, slice(None), SHAPES[-1])[0].value)
        raise NotMeasured(
            f"the measured directions do not say enough about the apertures at {meter.angle_deg:g}°: lobes of several"
            f" shapes through them have {scale * min(every):.3g} to {scale * max(every):.3g} GU; values out of the"
            f" plane of incidence within {math.degrees(WINDOW):g}° of the mirror direction may tell"
        )
    return replace(full, error=error).times(scale)


def _shapes(data: Observations, curve: Curve, response: Floats) -> tuple[Shape, ...]:
    """The shape to take first, then those that may be right as well."""
    rows = _around(data, curve)
    rows = rows[(np.abs(data.directions.out_of_plane[rows]) > 2.0 * IN_PLANE) & (data.brdf[rows] > 0.0)]
    if rows.size < 4:
        return SHAPES[:3]
    misfits: dict[Shape, float] = {}
    for shape in SHAPES:
        lobe = _HalfVector(curve, np.flatnonzero(response == 0.0), slice(None), shape)
        on_curve, _ = lobe.total(data.directions[rows], np.ones(rows.size), None)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(np.log(data.brdf[rows] / on_curve))
        misfits[shape] = float(np.median(np.where(np.isfinite(ratio), ratio, LARGEST_LN_RATIO)))
    ordered = sorted(SHAPES, key=lambda shape: misfits[shape])
    if misfits[ordered[0]] > CLEARLY_BETTER * misfits[SHAPES[0]]:
        return SHAPES[:3]
    worst = NEARLY_AS_GOOD * misfits[ordered[0]] + ANY_MISFIT
    return tuple(shape for shape in ordered if misfits[shape] <= worst)


def _around(data: Observations, curve: Curve) -> Rows:
    """Rows around the mirror direction at a curve's incidence, where its detector was moved."""
    d = data.directions
    turned = np.abs(wrap(d.phi_i - curve.phi_i + math.pi) - math.pi)
    near = (np.abs(d.theta_i - curve.parameter) <= SAME_ANGLE) & (turned <= SAME_AZIMUTH) & (d.mirror_offset <= WINDOW)
    return np.flatnonzero(near & (curve.scanned == "theta_r"))


def spike_response(data: Observations, curve: Curve) -> Floats:
    """BRDF [1/sr] that the instrument sees of a spike of reflectivity 1, at the values of a curve."""
    if data.source_solid_angle_sr == 0.0 or data.receiver_solid_angle_sr == 0.0:
        return np.zeros(curve.angle.size)
    return cone_response(data, curve.rows)


def cone_response(data: Observations, rows: Rows) -> Floats:
    from gonio.instrument import apparent_spike

    at = data.directions[rows]
    seen = apparent_spike(
        MIRROR,
        *at.angles,
        wavelength_nm=550.0,
        spike="exact",
        source_solid_angle_sr=data.source_solid_angle_sr,
        receiver_solid_angle_sr=data.receiver_solid_angle_sr,
    )
    return np.asarray(seen / MIRROR.specular_reflectivity(at.theta_i))


def _every_other(curve: Curve) -> npt.NDArray[np.intp]:
    """Every other value to either side of the one nearest to the mirror direction."""
    return np.arange(int(np.argmin(np.abs(curve.angle - curve.parameter))) % 2, curve.angle.size, 2)


def _through(
    data: Observations,
    curve: Curve,
    meter: Glossmeter,
    response: Floats,
    taken: slice | npt.NDArray[np.intp],
    shape: Shape = "cosines",
    *,
    flat: bool = False,
) -> tuple[Sampled, float]:
    """The flux through the apertures from some values of a curve; and that from beyond the measured directions.

    Values out of the plane of incidence count too, unless it is to be `flat`.
    """
    lobe = _HalfVector(curve, np.flatnonzero(response == 0.0), taken, shape)
    omega_i, share = meter.source(3)
    omega_r, solid = meter.receiver(12)
    n_r = len(omega_r)
    omega_i, share = np.repeat(omega_i, n_r, axis=0), np.repeat(share, n_r)
    omega_r, solid = np.tile(omega_r, (len(omega_i) // n_r, 1)), np.tile(solid, len(omega_i) // n_r)
    gradient = np.zeros(len(data))
    at, weights = Directions.from_vectors(omega_i, omega_r), share * solid * omega_r[:, 2]
    across = None if flat else _Across.of(data, curve, meter, lobe)
    if across is None:
        parts, beyond = lobe.total(at, weights, gradient)
        value = float(parts.sum())
    else:
        value, beyond = across.total(lobe, at, weights, gradient)
    caught = (
        np.flatnonzero(response > 0.5 * response.max(initial=0.0)) if response.any() else np.empty(0, dtype=np.intp)
    )
    caught = np.intersect1d(caught, np.arange(response.size)[taken])
    if caught.size and not meter.offset:
        squares = float((response[caught] ** 2).sum())
        for k in caught:
            own = np.zeros(len(data))
            expected, _ = lobe.total(data.directions[curve.rows[k : k + 1]], np.ones(1), own)
            weight = response[k] / squares
            value += weight * (curve.brdf[k] - float(expected[0]))
            gradient -= weight * own
            gradient[curve.rows[k]] += weight
    return Sampled(value, gradient, 0.0), beyond


@dataclass(frozen=True)
class _Across:
    """What values out of the plane of incidence add: their ratio to what the curve says there, linear between them."""

    meter: Glossmeter
    mesh: Any
    """Triangles between the places of the values."""
    rows: Rows
    at: Directions
    f: Floats

    @classmethod
    def of(cls, data: Observations, curve: Curve, meter: Glossmeter, lobe: _HalfVector) -> _Across | None:
        """The values around a curve's mirror direction; None where those out of its plane do not span a surface."""
        from scipy.spatial import Delaunay, QhullError

        d = data.directions
        rows = _around(data, curve)
        if rows.size < 4 or not np.any(np.abs(d.out_of_plane[rows]) > 2.0 * IN_PLANE):
            return None
        rows = (
            rows[cone_response(data, rows) == 0.0]
            if data.source_solid_angle_sr and data.receiver_solid_angle_sr
            else rows
        )
        on_curve, _ = lobe.total(d[rows], np.ones(rows.size), None)
        with np.errstate(divide="ignore", invalid="ignore"):
            rows = rows[np.abs(np.log(data.brdf[rows] / on_curve)) < LARGEST_LN_RATIO]
        if rows.size < 4:
            return None
        try:
            mesh = Delaunay(_places(d[rows], meter))
        except (QhullError, ValueError):
            return None
        return cls(meter, mesh, rows, d[rows], data.brdf[rows])

    def total(self, lobe: _HalfVector, at: Directions, weights: Floats, gradient: Floats) -> tuple[float, float]:
        """As `_HalfVector.total`, summed, for a curve whose values are times the ratios between."""
        plain, _ = lobe.total(at, weights, None)
        on_curve, _ = lobe.total(self.at, np.ones(self.rows.size), None)
        ratio = self.f / on_curve
        places = _places(at, self.meter)
        simplex = self.mesh.find_simplex(places)
        inside = simplex >= 0
        transform = self.mesh.transform[simplex[inside]]
        first = np.einsum("nij,nj->ni", transform[:, :2], places[inside] - transform[:, 2])
        shares = np.column_stack([first, 1.0 - first.sum(axis=1)])
        corners = self.mesh.simplices[simplex[inside]]
        factor = np.ones(plain.size)
        factor[inside] = (shares * ratio[corners]).sum(axis=1)
        parts, beyond = lobe.total(at, weights * factor, gradient)
        lever = np.bincount(corners.ravel(), (plain[inside, None] * shares).ravel(), self.rows.size)
        np.add.at(gradient, self.rows, lever / on_curve)
        lobe.total(self.at, -lever * ratio / on_curve, gradient)
        return float(parts.sum()), beyond


def _places(at: Directions, meter: Glossmeter) -> Floats:
    """Where pairs of directions meet the receiver's focal plane, the source on the glossmeter's axis, (n, 2).

    The detector is moved so that the half vector stays. The second number is the square of the tangent across the
    plane of incidence: both sides are alike, and what grows across begins as a square.
    """
    source, detector = at.vectors
    half = source + detector
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    turn = at.phi_i + math.pi  # into the frame in which the light comes from -x
    x = half[:, 0] * np.cos(turn) + half[:, 1] * np.sin(turn)
    half = np.stack([x, half[:, 1] * np.cos(turn) - half[:, 0] * np.sin(turn), half[:, 2]], axis=1)
    nominal = np.array([-math.sin(meter.theta), 0.0, math.cos(meter.theta)])
    along, across = meter.in_focal_plane(2.0 * (half @ nominal)[:, None] * half - nominal).T
    return np.stack([along, across**2], axis=1)


class _HalfVector:
    """A curve as a function of the half vector: ln(f cos cos) linear in tan^2(theta_h), on either side of the mirror.

    Where a value is not above zero its neighbourhood is linear in f cos cos instead.
    """

    def __init__(
        self, curve: Curve, lobe: npt.NDArray[np.intp], taken: slice | npt.NDArray[np.intp], shape: Shape
    ) -> None:
        kept = np.intersect1d(lobe, np.arange(curve.angle.size)[taken])
        self._theta = curve.parameter
        tilt = 0.5 * (curve.angle[kept] - curve.parameter)
        self._shape = shape
        weight = self._weight(
            np.full(kept.size, math.cos(curve.parameter)),
            np.cos(curve.angle[kept]),
            0.5 * (curve.angle[kept] - self._theta),
            0.5 * (curve.angle[kept] + self._theta),
        )
        self._branches = []
        touching = math.radians(0.02)
        for side in (1.0, -1.0):
            mine = np.flatnonzero(side * tilt >= -touching)
            mine = mine[np.argsort(np.abs(tilt[mine]), kind="stable")]
            x = np.tan(np.abs(tilt[mine])) ** 2
            mine = mine[np.concatenate([[True], np.diff(x) > 1e-14])] if mine.size else mine
            rows = curve.rows[kept[mine]]
            self._branches.append((np.tan(np.abs(tilt[mine])) ** 2, curve.brdf[kept[mine]], weight[mine], rows))
        if max(x.size for x, *_ in self._branches) < 2:
            raise NotMeasured("fewer than two values beside the mirror direction")

    def _weight(self, cos_i: Floats, cos_r: Floats, theta_h: Floats, theta_d: Floats) -> Floats:
        """What f is multiplied by, so that the product depends on the half vector alone."""
        if self._shape == "plain":
            return np.ones(cos_i.shape)
        if self._shape == "cosines":
            return np.asarray(cos_i * cos_r)
        weight = np.asarray(cos_i * cos_r / fresnel.reflectance(np.cos(theta_d), STANDARD_INDEX))
        if self._shape == "fresnel":
            return weight
        # the G of Cook1982: masking and shadowing of V-grooves
        lit = 2.0 * np.cos(theta_h) * np.minimum(cos_i, cos_r) / np.maximum(np.cos(theta_d), 1e-9)
        return weight / np.clip(lit, 1e-9, 1.0)

    def total(self, at: Directions, weights: Floats, gradient: Floats | None) -> tuple[Floats, float]:
        """Weights times f in some directions, and how much of their sum lies beyond the data.

        The gradient of the sum is added to `gradient`.
        """
        theta_h, theta_d = at.half
        x = np.tan(theta_h) ** 2
        factor = weights / self._weight(np.cos(at.theta_i), np.cos(at.theta_r), theta_h, theta_d)
        # how far the pair of directions is from the curve's two that have the same theta_h
        along = np.clip(0.5 + (theta_d - self._theta) / (2.0 * np.maximum(theta_h, 1e-9)), 0.0, 1.0)
        reach = [branch[0][-1] if branch[0].size >= 2 else -1.0 for branch in self._branches]
        first = np.where((x <= reach[0]) & (x <= reach[1]), along, (x <= reach[0]) | (reach[0] >= reach[1]))
        out, beyond = np.zeros(x.size), 0.0
        for branch, end, mine in zip(self._branches, reach, (first, 1.0 - first), strict=True):
            used = np.flatnonzero(mine > 0.0)
            if used.size == 0 or end < 0.0:
                continue
            inside = np.minimum(x[used], end)  # beyond the outermost value it stands for what lies there
            part = mine[used] * factor[used]
            values = self._read(branch, inside, part, gradient)
            out[used] += part * values
            beyond += float(np.abs(part[x[used] > end]) @ np.abs(values[x[used] > end]))
        return out, beyond

    @staticmethod
    def _read(branch: tuple[Floats, Floats, Floats, Rows], x: Floats, part: Floats, gradient: Floats | None) -> Floats:
        knots, f, weight, rows = branch
        low = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, knots.size - 2)
        high = low + 1
        # short of the innermost value: along the line through a second one not too close to it
        second = min(int(np.searchsorted(knots, 3.0 * knots[0])), knots.size - 1)
        high = np.where(x < knots[0], max(second, 1), high)
        share = (x - knots[low]) / (knots[high] - knots[low])
        y_low, y_high = f[low] * weight[low], f[high] * weight[high]
        positive = (y_low > 0.0) & (y_high > 0.0)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            logarithmic = np.exp((1.0 - share) * np.log(y_low) + share * np.log(y_high))
            by_low, by_high = logarithmic * (1.0 - share) / y_low, logarithmic * share / y_high
        values = np.where(positive, logarithmic, (1.0 - share) * y_low + share * y_high)
        if gradient is None:
            return np.asarray(values)
        by_low = part * weight[low] * np.where(positive, by_low, 1.0 - share)
        by_high = part * weight[high] * np.where(positive, by_high, share)
        np.add.at(gradient, rows, np.bincount(low, by_low, knots.size) + np.bincount(high, by_high, knots.size))
        return np.asarray(values)
