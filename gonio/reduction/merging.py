"""Frames of one step merged pixel by pixel: maximum likelihood for linear frames of known noise.

The model, the choice of the weights, and what is left out without a bias, are explained in docs/exposure.md, "One rate
of many frames".
"""

import math
from dataclasses import dataclass

import numpy as np

from gonio.reduction.rates import Merged
from gonio.rig import sensor_noise
from gonio.rig.description import RigDescription
from gonio.rig.light_and_camera import Camera
from gonio.typing import Bools, Floats, NDArray

Mask = Bools

SATURATED = 0.98
"""Raw levels above this are full pixels (`gonio.acquisition.exposure.SATURATED`)."""
DEVIATIONS = 5.0
"""The neighbours of a pixel that is used lie this many standard deviations of a full pixel below `SATURATED`."""
FALSE_ALARMS = 1e-3
"""At most so many pixels of a step and band without any hit are taken for hits of cosmic radiation, on average."""
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
    variance = 2.0 * (charge + sensor_noise.variance(camera, 0.0))
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
    mask: Mask
    """Where the used pixels lie in a rectangle; N of them."""
    per_weight: Floats
    """What makes a pixel's rate that of the region, shape (N,): see `gonio.rig.beam_size.per_weight`."""
    dark_rate: Floats
    """Dark electrons a second of each pixel, shape (N,)."""
    hot: Mask
    """Pixels whose dark signal says that they are not to be used, shape (N,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MergedPixels(Merged):
    """The rate of a region, with the variance of the pixels' noise and lamp noise, and how it came from the frames."""

    shares: Floats
    """Change of the rate with each pixel's rate in each frame, shape (F, N): the rate is linear in these."""
    frame_weights: Floats
    """How much each frame counts, shape (F,); their sum is 1."""


def noise_is_known(description: RigDescription) -> bool:
    """Whether the camera's noise is known: a calibration of it is in use, or the rig file gives a read noise.

    A sensor without read noise does not exist: 0, the default, says that nobody has looked.
    """
    return description.camera.read_noise_e > 0 or any(k.kind == "camera" for k in description.calibration.known)


def merge(description: RigDescription, stack: Stack) -> MergedPixels | None:
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

    def __init__(self, camera: Camera, lamp: float, stack: Stack, rates: Floats, used: Mask) -> None:
        self._stack, self._rates, self._lamp, self._camera = stack, rates, lamp, camera
        t = stack.exposures_s[:, None]
        # total charge over total time is what the weights come from
        self.expected = _neighbours_mean(
            stack, np.where(used, stack.electrons, 0.0).sum(0), np.where(used, t, 0).sum(0)
        )
        shot = self._shot(self.expected * t)
        self.charge_variance = shot + sensor_noise.variance(camera, stack.dark_rate * t)
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
    def alone(self) -> Mask:
        """Used pixels of frames that no other frame can tell of."""
        return np.asarray((self.weights > 0.0) & (self.total <= self.weights * (1.0 + 1e-12)))

    def stands_out(self, limit: float) -> Mask:
        """Pixels that are brighter in a frame than the other frames allow, by Bernstein's bound of a Poisson number."""
        rest, known = self.total - self.weights, ~self.alone
        safe = np.where(known & (rest > 0.0), rest, 1.0)
        others = (self.total * self.mean - self.weights * self._rates) / safe
        t = self._stack.exposures_s[:, None]
        more = t * (self._rates - others * (1.0 + self.levels[:, None]))
        brighter = self._shot(np.maximum(others - self.expected, 0.0) * t)
        return np.asarray(known & (more > bound(self.charge_variance + brighter + t**2 / safe, limit)))

    def merged(self, hits: int, saturated: float) -> MergedPixels:
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
        variance = float(np.sum(shares**2 * charge_variance / t**2) + np.sum(lamp**2))
        alike = stack.per_weight[self.alive].mean()
        variance += self._alike_rounding(shares, rate / alike if alike else 0.0, count)
        frame_weights = (shares / np.where(stack.per_weight > 0, stack.per_weight, 1.0)).sum(axis=1)
        chi_square, frames = self._scatter()
        return MergedPixels(
            rate=rate,
            variance=variance,
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
        missing = np.where(sensor_noise.spread(camera, charge) >= 0.25 * step, 0.0, step / 12.0 * (1.0 - 1.0 / count))
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


def _above_neighbours(camera: Camera, stack: Stack, fit: _Fit, limit: float) -> Mask:
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
    noise = float(sensor_noise.variance(camera, full, rounding=False))
    return SATURATED - DEVIATIONS * math.sqrt(noise / full**2 + camera.prnu**2)
