"""Frames of one step merged pixel by pixel: maximum likelihood for linear frames of known noise.

The model, the choice of the weights, and what is left out without a bias, are explained in docs/acquisition.md,
"One rate of many frames".

Also here are the frames of a point as one rate, with its variance.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from gonio.lab.acquisition.exposure import SATURATED, USABLE
from gonio.lab.reduction.dark_signal import Darks
from gonio.lab.reduction.step_rates import Merged
from gonio.lab.rig import Target, light_and_camera
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera, rounding_of_mean
from gonio.lab.rig.regions import Roi
from gonio.typing import Bools, Floats, NDArray

DEVIATIONS = 5.0
"""The neighbours of a pixel that is used lie this many standard deviations of a full pixel below `SATURATED`."""
FALSE_ALARMS = 1e-3
"""Pixels of a step and band without any hit that are taken for hits of cosmic radiation, on average, at most."""
HOT = 0.05
"""A pixel whose dark charge in the longest frame is a larger part of full scale is hot, and left out of the mean."""
AROUND = 5
"""Side of the square of neighbours [pixels], among which a pixel itself never counts."""
BRIGHT = -3
"""The neighbour that says how bright it is around a pixel: two brighter ones may have been hit."""
TYPICAL = -8
"""The neighbour that says how steep it is there; in the corner of a rectangle it is the last one."""
ROUNDS = 4
"""Hits that hide behind larger ones are found one round later."""


def without_hits(camera: Camera, frames: NDArray[np.uint16], black_dn: float) -> tuple[Floats, int]:
    """Dark frames of one exposure [DN], shape (F, rows, columns), and how many pixels were hit.

    A pixel that was hit in one frame takes the mean of the others. It is known by the middle one of its values, of two
    the smaller one.
    """
    values = frames.astype(float)
    if len(values) < 2:
        return values, 0
    middle = np.sort(values, axis=0)[(len(values) - 1) // 2]
    charge = np.maximum(middle - black_dn, 0.0) * camera.electrons_per_dn
    variance = 2.0 * (charge + light_and_camera.variance(camera, 0.0))
    limit = math.log(values.size / FALSE_ALARMS)
    hit = (values - middle) * camera.electrons_per_dn > bound(variance, limit)
    others = np.where(hit, 0.0, values).sum(axis=0) / (~hit).sum(axis=0)
    return np.where(hit, others, values), int(np.count_nonzero(hit))


@dataclass(frozen=True, slots=True)
class Stack:
    """The frames of one step in one region: F frames of N used pixels."""

    electrons: Floats
    """Signals without dark signal [e-], shape (F, N)."""
    levels: Floats
    """Raw levels, as fractions of full scale above the black level, shape (F, N)."""
    exposures_s: Floats
    """Shape (F,)."""
    mask: Bools
    """Where the used pixels lie in a rectangle; N of them."""
    per_weight: Floats
    """What makes a pixel's rate that of the region, shape (N,): see `gonio.lab.rig.regions.per_weight`."""
    dark_rate: Floats
    """Dark electrons a second of each pixel, shape (N,)."""
    hot: Bools
    """Pixels whose dark signal says that they are not to be used, shape (N,)."""


def noise_is_known(description: RigDescription) -> bool:
    """Whether the camera's noise is known: a calibration of it is in use, or the rig file gives a read noise.

    A sensor without read noise does not exist: 0, the default, says that nobody has looked.
    """
    return description.camera.read_noise_e > 0 or any(k.kind == "camera" for k in description.calibration.known)


def merge(description: RigDescription, stack: Stack) -> Merged | None:
    """The maximum-likelihood rate of a region; None where some of its pixels are too bright in every frame.

    Every pixel has a rate of its own, and every frame a level of the lamp. Weights, and the choice of what is used,
    come from a pixel's neighbours, whose noise is independent of its own: given these, the estimate is linear in the
    data, and unbiased.
    """
    camera, lamp = description.camera, description.lamp.frame_noise
    rates = stack.electrons / stack.exposures_s[:, None]
    bright = _levels_around(stack) >= usable(camera)
    used = ~bright & (stack.levels < SATURATED) & ~stack.hot
    # a full pixel among others that are not is out of order, or was hit
    if bool(np.any(bright.all(axis=0) & ~stack.hot)):
        return None
    if not used.any():
        return None
    limit = math.log(2.0 * max(used.size, 1) / FALSE_ALARMS)
    hits = np.zeros(used.shape, dtype=bool)
    fit = _Fit(camera, lamp, stack, rates, used)
    for _ in range(ROUNDS):
        found = used & (fit.stands_out(limit) | _above_neighbours(camera, stack, fit, limit))
        if not found.any():
            break
        hits |= found
        used = used & ~found
        if not used.any():
            return None
        fit = _Fit(camera, lamp, stack, rates, used)
    full = ~bright & (stack.levels >= SATURATED) & ~stack.hot
    return fit.merged(int(np.count_nonzero(hits | full)), float(np.mean(bright)))


class _Fit:
    """Rates of pixels and levels of frames by weighted least squares, for one choice of what is used."""

    def __init__(self, camera: Camera, lamp: float, stack: Stack, rates: Floats, used: Bools) -> None:
        self._stack, self._rates, self._lamp, self._camera = stack, rates, lamp, camera
        t = stack.exposures_s[:, None]
        # total charge over total time is what the weights come from
        self.expected = _neighbours_mean(
            stack, np.where(used, stack.electrons, 0.0).sum(0), np.where(used, t, 0).sum(0)
        )
        shot = self._shot(self.expected * t)
        self.charge_variance = shot + light_and_camera.variance(camera, stack.dark_rate * t)
        self.weights = np.where(used, t**2 / self.charge_variance, 0.0)
        self.total = self.weights.sum(axis=0)
        self.alive = self.total > 0
        self._parts = self.weights / np.where(self.alive, self.total, 1.0)
        self.mean = (self._parts * rates).sum(axis=0)
        self.levels, self._inverse = self._frame_levels()

    def _shot(self, charge: Floats) -> Floats:
        """The variance of photons [e-^2]; of a camera whose noise nobody knows, too."""
        return charge if self._camera.photon_noise or not self._camera.read_noise_e else np.zeros_like(charge)

    def _frame_levels(self) -> tuple[Floats, Floats]:
        """The lamp's level in each frame less 1, with its scatter as a prior; and the inverse of its normal matrix."""
        frames = len(self._rates)
        if not self._lamp:
            return np.zeros(frames), np.zeros((frames, frames))
        p, w = self.expected, self.weights
        matrix = np.diag((w * p**2).sum(axis=1) + 1.0 / self._lamp**2) - (w * p**2) @ self._parts.T
        inverse = np.linalg.inv(matrix)
        return np.asarray(inverse @ (w * p * (self._rates - self.mean)).sum(axis=1)), np.asarray(inverse)

    @property
    def alone(self) -> Bools:
        """Used pixels of frames that no other frame can tell of."""
        return np.asarray((self.weights > 0.0) & (self.total <= self.weights * (1.0 + 1e-12)))

    def stands_out(self, limit: float) -> Bools:
        """Pixels that are brighter in a frame than the other frames allow, by Bernstein's bound of a Poisson number."""
        rest, known = self.total - self.weights, ~self.alone
        safe = np.where(known & (rest > 0.0), rest, 1.0)
        others = (self.total * self.mean - self.weights * self._rates) / safe
        t = self._stack.exposures_s[:, None]
        more = t * (self._rates - others * (1.0 + self.levels[:, None]))
        brighter = self._shot(np.maximum(others - self.expected, 0.0) * t)
        return np.asarray(known & (more > bound(self.charge_variance + brighter + t**2 / safe, limit)))

    def merged(self, hits: int, saturated: float) -> Merged:
        stack, p = self._stack, self.expected
        count = int(np.count_nonzero(self.alive))
        take = np.where(self.alive, stack.per_weight, 0.0) / count
        by_level = self._inverse @ (self._parts @ (take * p))  # what the levels' errors do to the rate
        pulled = (by_level[:, None] * self.weights * p).sum(axis=0)
        shares = self._parts * (take + pulled) - by_level[:, None] * self.weights * p
        rate = float(np.sum(shares * self._rates))
        lamp = self._lamp * (shares @ p)
        t = stack.exposures_s[:, None]
        # where a pixel is brighter than its neighbours say, its own rate tells its noise; on average, without a bias
        charge_variance = self.charge_variance + self._shot((self.mean - p) * t)
        of_lamp = float(np.sum(lamp**2))
        variance = float(np.sum(shares**2 * charge_variance / t**2)) + of_lamp
        alike = stack.per_weight[self.alive].mean()
        variance += self._alike_rounding(shares, rate / alike if alike else 0.0, count)
        frame_weights = (shares / np.where(stack.per_weight > 0, stack.per_weight, 1.0)).sum(axis=1)
        chi_square, frames = self._scatter()
        return Merged(
            rate=rate,
            variance=variance,
            of_lamp=of_lamp,
            shares=shares,
            frame_weights=frame_weights / (frame_weights.sum() or 1.0),
            chi_square=chi_square,
            frames=frames,
            hits=hits,
            hot=len(self.alive) - count,
            saturated=saturated,
        )

    def _alike_rounding(self, shares: Floats, rate: float, count: int) -> float:
        """What is missing of the rounding's variance in frames whose pixels all round alike (Widrow's condition)."""
        camera, t = self._camera, self._stack.exposures_s
        charge = np.maximum(rate, 0.0) * t
        step = camera.electrons_per_dn**2
        missing = np.where(
            light_and_camera.spread(camera, charge) >= 0.25 * step, 0.0, step / 12.0 * (1.0 - 1.0 / count)
        )
        return float(np.sum((shares.sum(axis=1) / t) ** 2 * missing))

    def _scatter(self) -> tuple[float, int]:
        p, w = self.expected, self.weights
        weight = (w * p**2).sum(axis=1)
        there = weight > 0
        if not there.any():
            return 0.0, max(int(np.count_nonzero(w.sum(axis=1))), 1)
        # the error of the pixels' means, of which a frame is a part, is left out of each frame's own
        level = (w * p * (self._rates - self.mean)).sum(axis=1)[there] / weight[there]
        variance = 1.0 / weight[there] + self._lamp**2
        centre = np.sum(level / variance) / np.sum(1.0 / variance)
        return float(np.sum((level - centre) ** 2 / variance)), int(np.count_nonzero(there))


def bound(variance: Floats, limit: float) -> Floats:
    """How far a sum of a Poisson and a normal number exceeds its mean with a probability of at most exp(-limit).

    Bernstein's inequality for a variance [e-^2]: x with x^2 / (2 (variance + x/3)) = limit.
    """
    return np.asarray(limit / 3.0 + np.sqrt(limit**2 / 9.0 + 2.0 * variance * limit))


def _ranked(stack: Stack, values: Floats, rank: int) -> Floats:
    """The neighbour of a rank (-1: the brightest) of every pixel in every frame; -inf where there are too few."""
    from scipy.ndimage import rank_filter

    footprint = np.ones((AROUND, AROUND), dtype=bool)
    footprint[AROUND // 2, AROUND // 2] = False
    out = np.empty(values.shape)
    for k, frame in enumerate(values):
        box = np.full(stack.mask.shape, -np.inf)
        box[stack.mask] = np.where(stack.hot, -np.inf, frame)
        out[k] = rank_filter(box, rank, footprint=footprint, mode="constant", cval=-np.inf)[stack.mask]
    return out


def _levels_around(stack: Stack) -> Floats:
    """How bright it is around each pixel in each frame: all but two neighbours have at most this level, shape (F, N).

    Two neighbours may be hit by cosmic radiation. In a region too small to tell, it is that of the brightest pixel.
    """
    around = _ranked(stack, stack.levels, BRIGHT)
    peak = np.where(stack.hot, -np.inf, stack.levels).max(axis=1, keepdims=True)
    return np.asarray(np.where(np.isfinite(around), around, peak))


def _above_neighbours(camera: Camera, stack: Stack, fit: _Fit, limit: float) -> Bools:
    """Pixels, seen in one frame alone, that are brighter than all but two of the pixels around them allow.

    A peak of the sample's own rises above its surroundings too: twice what the third neighbour rises above the eighth
    is granted.
    """
    alone = fit.alone
    if not alone.any():
        return alone
    t = stack.exposures_s[:, None]
    rates = stack.electrons / t * stack.per_weight
    third, middle = (_ranked(stack, rates, rank) for rank in (BRIGHT, TYPICAL))
    there = np.isfinite(middle)
    third, middle = np.where(there, third, 0.0), np.where(there, middle, 0.0)
    more = stack.electrons - (third + 2.0 * (third - middle)) * t / stack.per_weight
    fixed = (camera.prnu * fit.expected * t) ** 2 + camera.read_noise_e**2  # of responsivities, and of the dark frames
    return np.asarray(alone & there & (more > bound(fit.charge_variance + fixed, limit)))


def _neighbours_mean(stack: Stack, charge: Floats, time: Floats) -> Floats:
    """The rate of each pixel [e-/s] that its neighbours lead to, without itself; never negative."""
    from scipy.ndimage import uniform_filter

    def around(values: Floats) -> Floats:
        box = np.zeros(stack.mask.shape)
        box[stack.mask] = values
        total = uniform_filter(box, AROUND, mode="constant") * AROUND**2
        return np.asarray(total[stack.mask] - values)

    weighted = np.where(time > 0, charge * stack.per_weight, 0.0)
    seen = around(time)
    region = weighted.sum() / max(float(time.sum()), 1e-300)
    near = np.where(seen > 0.01 * time.mean(), around(weighted) / np.maximum(seen, 1e-300), region)
    return np.asarray(np.maximum(near / stack.per_weight, 0.0))


def usable(camera: Camera) -> float:
    """The level of neighbours up to which a pixel is used: its noise then does not reach `SATURATED`."""
    full = camera.saturation_e
    noise = float(light_and_camera.variance(camera, full, rounding=False))
    return SATURATED - DEVIATIONS * math.sqrt(noise / full**2 + camera.prnu**2)


@dataclass(frozen=True, slots=True)
class Region:
    """What the frames of one step and band are averaged over."""

    roi: Roi
    target: Target
    per_weight: Floats
    """What makes a used pixel's signal the region's: `gonio.lab.rig.regions.per_weight`, over the pixels'
    responsivities where they are mapped."""
    lit: Roi
    """Pixels of the region that the beam falls on."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame, reduced to its region."""

    rate: float
    """Electrons a second, over the known geometry."""
    exposure_s: float
    time_s: float
    peak: float
    """Brightest used pixel, as a fraction of full scale."""
    leverage: Floats
    """Of the dark frames: `Darks.leverage`."""
    by_camera: Floats
    """Derivatives of the rate by `camera_parameters`."""
    lamp: float
    """The reading of the lamp's monitor over its mean in the run; 1 without a monitor."""
    hidden: float = 0.0
    """What may be missing of the rate [e-/s], where noise is cut off at black: `gonio.lab.reduction.dark_signal`."""
    electrons: Floats | None = None
    """Signals of the used pixels [e-], where frames are merged by pixels."""
    levels: Floats | None = None
    """Their raw levels, as fractions of full scale."""


def pool(description: RigDescription, region: Region, shots: list[Shot], dark_exposures_s: Floats) -> Merged:
    """The merged rate of a point's frames [e-/s], and what goes with it.

    Weights come from the pooled rate, not from each frame's own: a frame that is dark by chance gets no larger weight.
    """
    camera, of_lamp = description.camera, description.lamp.frame_noise
    exposure = np.array([shot.exposure_s for shot in shots])
    rates = np.array([shot.rate for shot in shots])
    count = region.per_weight.size
    mean_1, mean_2 = float(np.mean(region.per_weight)), float(np.mean(region.per_weight**2))
    dark = light_and_camera.variance(camera, camera.dark_current_e_per_s * exposure, rounding=False)
    pooled = float(np.sum(rates * exposure) / np.sum(exposure))
    for _ in range(3):
        signal = max(pooled, 0.0)
        shot_noise = signal * mean_1 / exposure if camera.photon_noise else 0.0
        rounding = rounding_of_mean(camera, signal * exposure / mean_1, count)
        single = dark * mean_2 / exposure**2 + shot_noise
        variances = single / count + rounding * mean_2 / exposure**2 + (of_lamp * signal) ** 2
        weights = (1.0 / variances) / np.sum(1.0 / variances)
        pooled = float(np.sum(weights * rates))
    # the dark frames are one and the same for all frames of the point
    charge = camera.dark_current_e_per_s * dark_exposures_s
    of_pixels = light_and_camera.variance(camera, charge, rounding=False) / count + rounding_of_mean(
        camera, charge, count
    )
    lines = np.array([shot.leverage for shot in shots])
    of_darks = np.zeros(2)
    of_darks[: charge.size] = -((weights / exposure) @ lines) * np.sqrt(of_pixels * mean_2)
    chi_square = float(np.sum((rates - pooled) ** 2 / variances))
    # a curve is wrong otherwise at each exposure, most near black, and its camera's noise nobody has measured
    wider = max(1.0, chi_square / (len(shots) - 1)) if camera.response and len(shots) > 1 else 1.0
    return Merged(
        rate=pooled,
        variance=float(1.0 / np.sum(1.0 / variances)) * wider,
        of_lamp=float(np.sum((weights * of_lamp * max(pooled, 0.0)) ** 2)) * wider,
        chi_square=chi_square,
        frames=len(shots),
        frame_weights=weights,
        of_darks=of_darks,
    )


def pool_pixels(description: RigDescription, region: Region, shots: list[Shot], darks: Darks) -> Merged | None:
    """The frames of a point, merged pixel by pixel (`merging.merge`); None where pixels saturate in every frame.

    Where the noise of the camera is not known, frames that scatter more than photons say make the variance larger.
    """
    camera, acquired = description.camera, [shot for shot in shots if shot.electrons is not None]
    # a brighter lamp is as good as a longer exposure
    exposure = np.array([shot.exposure_s * shot.lamp for shot in acquired])
    rate = np.maximum(darks.rate(region.roi) * camera.electrons_per_dn, camera.dark_current_e_per_s)
    stack = Stack(
        electrons=np.stack([shot.electrons for shot in acquired if shot.electrons is not None]),
        levels=np.stack([shot.levels for shot in acquired if shot.levels is not None]),
        exposures_s=exposure,
        mask=region.roi.mask,
        per_weight=region.per_weight,
        dark_rate=rate,
        hot=_hot(rate, float(exposure.max()), float(darks.exposures_s.max()), camera.saturation_e),
    )
    merged = merge(description, stack)
    if merged is None:
        return None
    # the dark frames are one and the same for all frames of the point, and independent from pixel to pixel
    charge = camera.dark_current_e_per_s * darks.exposures_s
    count = region.per_weight.size
    noise = light_and_camera.variance(camera, charge, rounding=False) + count * rounding_of_mean(camera, charge, count)
    lines = np.array([shot.leverage for shot in acquired])
    of_darks = np.zeros(2)
    for k, variance in enumerate(noise):
        change = (lines[:, k] / exposure) @ merged.shares
        of_darks[k] = -math.copysign(math.sqrt(float(np.sum(change**2)) * variance), float(change.sum()))
    wider = 1.0
    if not noise_is_known(description) and merged.frames > 1:
        wider = max(1.0, merged.chi_square / (merged.frames - 1))
    return replace(
        merged, variance=merged.variance * wider, of_lamp=merged.of_lamp * wider, shares=None, of_darks=of_darks
    )


def _hot(rate: Floats, longest_s: float, dark_s: float, full: float) -> Bools:
    """Pixels with so many more dark electrons a second than others that they are not to be used.

    Their charge would be too large a part of full scale in the longest frame; or it filled the longer dark frames,
    which then do not tell the rate.
    """
    excess = rate - np.median(rate)
    return np.asarray((excess * longest_s > HOT * full) | (excess * dark_s > USABLE * full))
