"""Specular spikes in measured values: how high they stand, and what errors of the angles make of them.

A point sees the share of a spike's amplitude by which the lamp's mirror image overlaps the lens. This overlap is
averaged over the patch that is read, and over the directions that errors of the angles allow.

The amplitude at full overlap is estimated for every angle of incidence from all of its points, in the plane of
incidence and out of it, together with the height of the lobe below. Where these points do not tell it, neighbouring
angles of incidence do. Where those do not either, the amplitude is only bounded, and the bound is an uncertainty.

Each point that may see a spike gets a share (`blurred_overlap`): mean and variance of the overlap, over all pixels of
the region and the normal distribution of the angles' errors. The amplitude at full overlap is estimated for each angle
of incidence:

    value_k = lobe_k + (A + B t_k) share_k,    t_k = (theta_i + theta_r)/2 - theta

B lets the reflectivity change within the cones. The lobe's height is fitted too, with a prior from the points beyond
the spike. A (overlap - mean share) is given back to the value. The uncertainty is A^2 var(share), that of A, and 3 %
of the correction.

The points tell an amplitude where the sum of mean^2 / variance of their shares exceeds 9, and the fit leaves it
uncertain by less than 0.3 of its bound. Else, in turn:

1. Points of angles of incidence within 1.5 degrees, together.
2. The next angles of incidence above and below: ln(A cos theta_i) is interpolated over cos^2 theta_i (Rayleigh).
3. The bound, the smallest of: 1 / (cos theta_i omega), omega of the larger cone; what each value and two of its u
   allow; the amplitude at the next angle nearer to grazing, and two of its u. Nothing is corrected. The uncertainty
   holds the bound times sqrt(var(share) + (overlap - mean share)^2), but no more than the larger of the bound times
   the overlap at the directions read, and what stands above the lobe.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from gonio.geometry import SAME_SPIKE, Directions, mirrored, solid_angle_of_cone
from gonio.instrument.spherical_caps import lens_area
from gonio.typing import ArrayLike, Bools, Floats, Ints

QUANTILES = np.array([NormalDist().inv_cdf((k + 0.5) / 41) for k in range(41)])
QUANTILES /= QUANTILES.std()
"""Equally probable values of a standard normal number."""
FAR = 4.0
"""Standard deviations of the angles' errors beyond which a point sees nothing of a spike."""


def overlap(offset: ArrayLike, half_angle_1: float, half_angle_2: float) -> Floats:
    """Common solid angle of two caps whose axes are `offset` apart, over that of the smaller one.

    All angles in radians. Two caps without extent, or one, overlap fully inside the other and not at all outside.
    """
    d = np.abs(np.asarray(offset, dtype=float))
    small, large = sorted((half_angle_1, half_angle_2))
    if small <= 0:
        return np.where(d <= large, 1.0, 0.0)
    lens = lens_area(np.clip(d, large - small, large + small), small, large) / (
        4.0 * math.pi * math.sin(0.5 * small) ** 2
    )
    return np.where(d <= large - small, 1.0, np.where(d >= large + small, 0.0, lens))


def over_patch(d: Directions, radius_mm: float, light_mm: float, camera_mm: float) -> Floats:
    """What `Directions.from_mirror` changes by at 24 places spread evenly over a round patch, shape (24, 3).

    A spot x sees source and camera turned by -(x - (x . w) w) / distance, to first order.
    """
    turn = (np.arange(24) + 0.5) * math.pi * (3.0 - math.sqrt(5.0))  # Vogel's spiral
    radius = radius_mm * np.sqrt((np.arange(24) + 0.5) / 24)
    x = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(24)], axis=1)
    source, detector = d.vectors
    to_source = -(x - (x @ source)[:, None] * source) / light_mm
    return (-(x - (x @ detector)[:, None] * detector) / camera_mm) - mirrored(to_source)


@dataclass(frozen=True, slots=True)
class OverlapFraction:
    """What one point sees of a spike, as parts of its amplitude."""

    at_read: float = 0.0
    """Overlap at the directions that were read."""
    mean: float = 0.0
    """Mean over the patch, and over the errors of the angles."""
    variance: float = 0.0
    """Variance over the errors of the angles."""
    most: float = 0.0
    """For the largest errors of the angles, of `FAR` standard deviations."""
    least: float = 0.0
    """Likewise."""

    @property
    def with_rare(self) -> float:
        """The variance, but at least the square of what the largest errors take away, over `FAR`.

        A top that is flat for small errors falls for rare ones, of which the mean square knows nothing.
        """
        return max(self.variance, ((self.mean - self.least) / FAR) ** 2)


def blurred_overlap(
    read: Directions,
    moved: Directions,
    half_angles: tuple[float, float],
    patch: Floats | None = None,
    pixels: Floats | None = None,
) -> OverlapFraction:
    """The overlap, averaged over a patch, at directions whose true place is uncertain.

    Parameters
    ----------
    read
        The directions that were read.
    moved
        Those for one standard deviation of each independent error; together they are taken for normal.
    half_angles
        Of the lamp and of the lens [rad].
    patch
        What `Directions.from_mirror` changes by at a few places of the patch, shape (n, 3); none for a point.
    pixels
        The same at every pixel. Errors of the angles are averaged over the few places, which need not be exact; what
        the patch itself takes from a spike at the directions read is averaged over all pixels.
    """
    centre = read.from_mirror
    shifts = moved.from_mirror - centre
    values, vectors = np.linalg.eigh(shifts.T @ shifts)
    first, second = (math.sqrt(max(values[k], 0.0)) * vectors[:, k] for k in (2, 1))
    spots = np.zeros((1, 3)) if patch is None else patch

    def of(place: Floats) -> Floats:
        return overlap(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(place, axis=-1), 1.0)), *half_angles)

    at_read = float(of(centre))
    fixed = float(np.mean(of(centre + (spots if pixels is None else pixels))))
    mean, variance = fixed, 0.0
    if first.any():
        place = centre + QUANTILES[:, None, None] * first + QUANTILES[None, :, None] * second
        share = np.mean([of(place + spot) for spot in spots], axis=0)
        mean, variance = float(share.mean()), float(share.var())
        if pixels is not None:
            mean = max(mean + fixed - float(np.mean(of(centre + spots))), 0.0)
    least, most = mean, max(mean, at_read)
    if first.any():
        turn = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)[:, None]
        around = centre + FAR * (np.cos(turn) * first + np.sin(turn) * second)
        far = np.mean([of(around + spot) for spot in spots], axis=0)
        least, most = min(mean, float(np.min(far))), max(most, float(np.max(far)))
    return OverlapFraction(at_read, mean, variance, most, least)


STANDS_OUT = 0.05
"""A spike is given back what it lacks where it exceeds its lobe by more than this part and three standard errors."""
STEEPEST = 20.0
"""Prior of d ln(amplitude) / d theta [1/rad]; (4 pi sigma0/lambda)^2 sin(2 theta) for sigma0/lambda = 0.4."""
TELLS = 9.0
"""Points tell an amplitude above this sum of mean^2 / variance: errors of the angles then move it by under a third."""
SURELY = 25.0
"""Below this sum they tell it roughly: its uncertainty is the largest amplitude that the values allow."""
SEEN = 2.5
"""At an edge rare errors are large. A departure from the model that they explain is at most this many sigma."""
SHAPE = 0.03
"""Relative error of the lobe's shape under a spike, point by point; less where the lobe is known to less than a third
of this."""
SMOOTHEST = 0.002
"""No lobe is known better from its neighbours, relative."""
WITHIN = 0.03
"""Relative standard deviation of a spike's reflectivity within the cones: what a patch's mean overlap is worth."""
BESIDE = math.radians(10.0)
"""Points farther from the mirror direction than this do not tell a lobe's height there."""
COARSE = 0.3
"""Relative error of a lobe that only its nearest points tell."""


@dataclass(frozen=True, slots=True)
class SpikeScene:
    """The points of a band, as the search for spikes sees them; arrays have one number a point."""

    theta_i: Floats
    """As read [rad]."""
    across: Floats
    """Detector from the mirror direction in the plane of incidence, theta_r - theta_i, signed [rad]."""
    aside: Floats
    """Detector from the plane of incidence [rad]."""
    in_plane: Bools
    middle: Floats
    """Where a spike reflects: (theta_i + theta_r) / 2 [rad]."""
    brdf: Floats
    u: Floats
    """Independent standard uncertainty of `brdf` [1/sr]."""
    mean: Floats
    """`OverlapFraction.mean`."""
    variance: Floats
    """Of it: `OverlapFraction.with_rare`."""
    at_read: Floats
    """`OverlapFraction.at_read`."""
    most: Floats
    """`OverlapFraction.most`."""
    half_angles: tuple[float, float]


@dataclass(slots=True)
class Spikes:
    """What is known of the spike at every point; arrays have one number a point."""

    amplitude: Floats
    """Amplitude at full overlap [1/sr]; 0 without a spike, and where it is only bounded."""
    u_amplitude: Floats
    """Its standard uncertainty [1/sr]; a bound, where nothing tells the amplitude."""
    lobe: Floats
    """The value without the spike [1/sr]."""
    told: Bools
    """False where a point may see a spike whose amplitude nothing tells."""
    correction: Floats
    """What the value lacks on average [1/sr]: errors of the angles lead down from the top of a spike."""
    variance: Floats
    """Variance of the value [1/sr^2], from the errors of all angles together and from the amplitude's."""


@dataclass(frozen=True, slots=True)
class _Fit:
    """One angle of incidence: a point sees lobe + (amplitude + tilt (middle - theta)) share."""

    theta: float
    lobe: Floats
    """Of the fitted points."""
    u_lobe: float
    """Relative."""
    solution: Floats
    """Amplitude [1/sr] and tilt [1/sr per rad]."""
    covariance: Floats
    common: float
    """Standard uncertainty of the amplitude from zeros, which all points share."""
    told: bool
    most: float
    """The largest amplitude that the values allow [1/sr]."""
    stands_out: bool


def _fits(scene: SpikeScene, groups: Sequence[Ints], near: Bools) -> list[_Fit | None]:
    """A fit of each group that may see a spike; with groups at nearly the same angle, where one alone does not tell."""
    centres = [float(np.mean(scene.theta_i[group])) for group in groups]
    fits: list[_Fit | None] = []
    for group, centre in zip(groups, centres, strict=True):
        fit = _fit(scene, group, near) if near[group].any() else None
        if fit is not None and not fit.told:
            beside = [g for g, c in zip(groups, centres, strict=True) if abs(c - centre) < SAME_SPIKE]
            pooled = _fit(scene, np.concatenate([group, *(g for g in beside if g is not group)]), near, group)
            fit = pooled if pooled.told else fit
        fits.append(fit)
    return fits


def find(scene: SpikeScene, groups: Sequence[Ints]) -> Spikes:
    """Spikes of a band.

    Parameters
    ----------
    scene
        Its points.
    groups
        Places of the points of each nominal angle of incidence, which ascends.
    """
    count, mean, at_read, variance = scene.brdf.size, scene.mean, scene.at_read, scene.variance
    zero = np.zeros(count)
    out = Spikes(zero.copy(), zero.copy(), scene.brdf.astype(float), np.ones(count, bool), zero.copy(), zero.copy())
    if sum(scene.half_angles) <= 0:
        return out
    near = scene.most > 0.0
    fits = _fits(scene, groups, near)
    for group, fit in zip(groups, fits, strict=True):
        if fit is None:
            continue
        k = group[near[group]]
        if not fit.told:
            fit = _from_neighbours(fit, [f for f in fits if f is not None and f.told])
        out.told[k] = fit.told
        if not fit.told:
            out.u_amplitude[k] = fit.most
            inside = abs(scene.brdf[k])
            if fit.u_lobe < 1.0:  # the lobe is known; slopes to the neighbours are not the flanks of what stands on it
                out.lobe[k] = np.minimum(out.lobe[k], fit.lobe)
                u_above = np.hypot(scene.u[k], max(fit.u_lobe, SHAPE) * fit.lobe)
                inside = np.minimum(inside, np.maximum(scene.brdf[k] - fit.lobe, 0.0) + 2.0 * u_above)
            spread = fit.most * np.sqrt(variance[k] + (at_read[k] - mean[k]) ** 2)
            # a value holds no more of the spike than stands above the lobe, and lacks no more than is seen as read
            out.variance[k] = np.minimum(spread, np.maximum(inside, fit.most * at_read[k])) ** 2
            continue
        t = np.stack([np.ones(group.size), scene.middle[group] - fit.theta])
        u = np.sqrt(np.einsum("ik,ij,jk->k", t, fit.covariance, t) + fit.common**2)
        amplitude = np.maximum(fit.solution @ t, 0.0)
        if fit.stands_out:
            out.amplitude[group] = amplitude
            out.lobe[k] = fit.lobe
        else:
            u = np.maximum(u, amplitude)
        out.u_amplitude[group] = u
        lacks = at_read - mean
        out.correction[k] = out.amplitude[k] * lacks[k]
        of_correction = np.hypot(out.u_amplitude[k], WITHIN * out.amplitude[k]) * lacks[k]
        out.variance[k] = (out.amplitude[k] ** 2 + out.u_amplitude[k] ** 2) * variance[k] + of_correction**2
        if fit.stands_out and variance[k].any():
            departs = abs(scene.brdf[k] - out.lobe[k] - out.amplitude[k] * at_read[k])
            rare = out.amplitude[k] * (scene.most[k] - mean[k]) / FAR
            out.variance[k] = np.maximum(out.variance[k], np.minimum(rare, departs / SEEN) ** 2)
    return out


def _fit(scene: SpikeScene, group: Ints, near: Bools, own: Ints | None = None) -> _Fit:
    """Lobe and spike of a group of points; `lobe` is that of the points of `own`, all by default."""
    k = group[near[group]]
    values, share, variance = scene.brdf[k], scene.mean[k], scene.variance[k]
    # at an edge rare errors are larger than the variance says: no such point may tell the lobe
    blur = np.maximum(variance, ((scene.most[k] - share) / FAR) ** 2)
    lobe, u_lobe = _lobe_below(scene, group, near)
    shape = min(SHAPE, 3.0 * u_lobe)
    theta = float(np.mean(scene.theta_i[group if own is None else own]))
    t = scene.middle[k] - theta
    most = _bound(scene, k, theta)
    seen = share > 0.2 * np.max(share)
    amplitude = max(float(np.max((values - lobe)[seen] / share[seen])), 0.0) if seen.any() else 0.0
    design = np.stack([lobe, share, share * t], axis=1)
    prior = np.array([1.0 / u_lobe**2, 0.0, 0.0])
    for _ in range(12):
        prior[2] = 1.0 / (STEEPEST * max(amplitude, 1e-9 * most)) ** 2
        weight = 1.0 / (scene.u[k] ** 2 + amplitude**2 * blur + (shape * lobe) ** 2)
        normal = design.T @ (design * weight[:, None]) + np.diag(prior)
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        covariance = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
        right = design.T @ (values * weight)
        right[0] += prior[0]
        solution = covariance @ right
        amplitude = max(float(solution[1]), 0.0)
    left = values - design @ solution
    scatter = float(np.sum(left**2 * weight)) / max(k.size - 2, 1) if k.size > 3 else 1.0
    covariance = covariance * max(scatter, 1.0)
    u = math.sqrt(covariance[1, 1])
    strength = float(np.sum(weight * share**2))
    scaled = lobe * max(float(solution[0]), 0.0)
    with np.errstate(divide="ignore"):
        tells = float(np.sum(share**2 / np.maximum(variance, 1e-300)))
    if tells < SURELY:
        # errors of the angles that hid most of a spike make its fitted amplitude small, and its fitted error, too
        highest = _largest(share, variance, values - scaled + 2.0 * np.hypot(scene.u[k], shape * scaled))
        u = max(u, min(highest, most))
    common = 0.6 * amplitude * float(np.sum(weight * share * np.sqrt(variance))) / strength if strength > 0 else 0.0
    covariance[1, 1] = u**2
    lobe = scaled
    top = amplitude * float(np.max(share))
    return _Fit(
        theta=theta,
        lobe=lobe if own is None else lobe[: int(np.count_nonzero(near[own]))],
        u_lobe=min(math.sqrt(covariance[0, 0]), u_lobe),
        solution=np.array([amplitude, solution[2]]),
        covariance=covariance[1:, 1:],
        common=common,
        told=tells > TELLS and u < 0.3 * most and float(np.max(share)) > 0.0,
        most=most,
        stands_out=amplitude > 3.0 * math.hypot(u, common) and top > STANDS_OUT * float(np.max(lobe, initial=0.0)),
    )


def _bound(scene: SpikeScene, k: Ints, theta: float) -> float:
    """The largest amplitude that points allow: a spike reflects at most all light, and is part of each value."""
    most = 1.0 / (math.cos(theta) * float(solid_angle_of_cone(max(scene.half_angles))))
    values = np.maximum(scene.brdf[k], 0.0) + 2.0 * scene.u[k]
    return min(most, _largest(scene.mean[k], scene.variance[k], values))


def _largest(share: Floats, variance: Floats, values: Floats) -> float:
    """The largest amplitude with which no point exceeds its value by more than two standard deviations of its share."""
    surely = share - 2.0 * np.sqrt(variance)
    seen = surely > 0.0
    return max(float(np.min(values[seen] / surely[seen])), 0.0) if seen.any() else math.inf


def _lobe_below(scene: SpikeScene, group: Ints, near: Bools) -> tuple[Floats, float]:
    """Lobe under the points of a group that may see the spike, and its relative standard uncertainty."""
    k, free = group[near[group]], group[~near[group] & (scene.brdf[group] > 0.0)]
    x = scene.across[k]
    line = free[scene.in_plane[free]]
    line = line[np.argsort(scene.across[line])]
    place, logs = scene.across[line], np.log(scene.brdf[line])
    left, right = np.flatnonzero(place < np.min(x))[::-1], np.flatnonzero(place > np.max(x))
    if left.size and right.size:
        # points far enough from the next one to tell a slope: noise would, and the gap is as wide as the cones
        ends = [
            (side[0], side[abs(place[side] - place[side[0]]) > 0.5 * sum(scene.half_angles)][:1])
            for side in (left, right)
        ]
        inside = np.clip(x, place[left[0]], place[right[0]])
        straight = np.interp(inside, place[[left[0], right[0]]], logs[[left[0], right[0]]])
        open_ = 0.0
        if min(abs(place[left[0]]), abs(place[right[0]])) > BESIDE:
            # a lobe may stand there whole between them: what lies above the line may be lobe as well as spike
            above = float(np.max(scene.brdf[k] * np.exp(-straight))) - 1.0
            open_ = min(max(10.0 * above, 0.05), 10.0)
        noise = float(np.max(scene.u[line[[left[0], right[0]]]] / scene.brdf[line[[left[0], right[0]]]]))
        if ends[0][1].size and ends[1][1].size:
            four = np.array([ends[0][1][0], left[0], right[0], ends[1][1][0]])
            cubic = lagrange(inside, place[four], logs[four])
            return np.exp(cubic), max(0.5 * float(np.max(abs(cubic - straight))), noise, SMOOTHEST, open_)
        # between points this far apart a lobe may have risen and fallen by more than they differ
        part = 0.5 if place[right[0]] - place[left[0]] < 2.0 * BESIDE else 1.0
        return np.exp(straight), max(part * float(abs(logs[left[0]] - logs[right[0]])), noise, 0.05, open_)
    apart = np.hypot(scene.across[free], scene.aside[free])
    if apart.size and apart.min() < BESIDE:
        logs = np.log(scene.brdf[free[np.argsort(apart)[:4]]])
        return np.full(k.size, math.exp(float(np.mean(logs)))), max(COARSE, float(np.ptp(logs)))
    return np.full(k.size, max(float(np.min(scene.brdf[k])), 1e-12)), 10.0


def _from_neighbours(fit: _Fit, told: list[_Fit]) -> _Fit:
    """The spike of an angle of incidence that only its neighbours tell, or its bound.

    ln(amplitude cos(theta)) is nearly linear in cos(theta)^2, because a rough surface's spike is exp(-g) with
    g = (4 pi sigma cos(theta) / lambda)^2 (Rayleigh); and a spike does not shrink toward grazing incidence.
    """
    below = max((f for f in told if f.theta < fit.theta), key=lambda f: f.theta, default=None)
    above = min((f for f in told if f.theta > fit.theta), key=lambda f: f.theta, default=None)
    most = fit.most
    if above is not None:
        most = min(most, float(above.solution[0]) + 2.0 * math.hypot(math.sqrt(above.covariance[0, 0]), above.common))
    amplitude, told_by, u = 0.0, False, most
    if above is not None and not above.stands_out:
        told_by = True
    elif above is not None and below is not None and below.stands_out:
        ends = [math.log(float(f.solution[0]) * math.cos(f.theta)) for f in (below, above)]
        places = [math.cos(f.theta) ** 2 for f in (below, above)]
        part = (math.cos(fit.theta) ** 2 - places[0]) / (places[1] - places[0])
        amplitude = min(math.exp(ends[0] + part * (ends[1] - ends[0])) / math.cos(fit.theta), fit.most)
        u = amplitude * (0.1 + 0.1 * abs(ends[1] - ends[0]))
        told_by = True
    return _Fit(
        theta=fit.theta,
        lobe=fit.lobe,
        u_lobe=fit.u_lobe,
        solution=np.array([amplitude, 0.0]),
        covariance=np.diag([u**2, 0.0]),
        common=0.0,
        told=told_by,
        most=most,
        stands_out=amplitude > 0.0,
    )


def lagrange(x: Floats, at: Floats, values: Floats) -> Floats:
    """Lagrange's polynomial through `values` at `at`, both shape (..., n) with the n points of each x last."""
    out = np.zeros(np.shape(x))
    for j in range(at.shape[-1]):
        others = np.delete(at, j, axis=-1)
        steps = (np.asarray(x)[..., None] - others) / (at[..., j, None] - others)
        out += values[..., j] * np.prod(steps, axis=-1)
    return out
