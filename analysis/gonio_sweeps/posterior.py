"""What is known of curves after some points: the BRDF between them, with intervals that hold the common causes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gonio.checks.values import NORMAL_95
from gonio.geometry import Directions, direction
from gonio.models.gaussian_process import (
    ENOUGH,
    Coordinates,
    Process,
    Training,
    learned,
    nearby,
    objective,
    shares,
    total,
)
from gonio.typing import Floats
from gonio_sweeps.lobe import Spike, begun, suspected, within

NEGLIGIBLE = 2e-6
"""Part of the largest value that is added to uncertainties, so that the faintest values do not bend the whole curve."""
FAINT = 10.0
"""Values below this many times the smallest uncertainty may be negative: the logarithm then becomes the value."""
FEWEST = 3
SLOPE_STEP = float(np.radians(0.05))
"""Step over which slopes are taken [rad]: an encoder's half step or so."""
SEARCHES = 3
"""For the kernel's parameters, where lobe and base are summands: each begins where the last one left these."""
STEPS, SETTLED = 40, 0.1
"""Gauss and Newton's: how many at most, and by which part of its noise no value changes any more."""
FAINTEST = 1e-6
"""Least size that a part begins with, in units of the link's: its logarithm is finite."""
COMPARED_AGAIN = 1.25
"""Growth of the number of values beyond `ENOUGH` after which all forms are compared again."""
Slopes = tuple[Floats, Floats, Floats]
MISFIT = 1.15
"""A root mean square of left-out residuals above it says that the process is smoother than the sample."""


@dataclass(frozen=True)
class Link:
    """z = asinh(f/2e): the logarithm of f/e for values far above e, and proportional to f below."""

    e: float

    def z(self, f: Floats) -> Floats:
        """On the scale of the process."""
        return np.arcsinh(f / (2.0 * self.e))

    def brdf(self, z: Floats) -> Floats:
        """Back [1/sr]."""
        return np.asarray(2.0 * self.e * np.sinh(z))

    def slope(self, f: Floats) -> Floats:
        """dz/df [sr]."""
        return np.asarray(1.0 / np.sqrt(f**2 + 4.0 * self.e**2))


@dataclass(frozen=True)
class AngleErrors:
    """Standard uncertainties of the angles [rad], in the plane of incidence and across it alike."""

    read: float
    """Uncertainty of a reading, independent from point to point."""
    zero: float
    """Uncertainty of the zeros of both arms, each common to all points."""


@dataclass(frozen=True)
class Before:
    """What fewer points told."""

    kernel: Floats
    """Parameters of the kernel."""
    form: str | None = None
    """How lobe, base and spike make up the values: the most probable form."""
    compared: int = 0
    """How many values there were when all forms were compared."""


@dataclass(frozen=True)
class _Learned:
    """What the values come to, and what they tell of the kernel."""

    values: Training
    p: Floats
    unlikely: float
    """-ln of the values' probability, but for a constant."""
    spike: Spike | None = None
    form: str = ""
    compared: int = 0
    """`Posterior.form`."""

    @classmethod
    def of(cls, values: Training, p: Floats, spike: Spike | None = None, jacobian: float = 0.0) -> _Learned:
        return cls(values, p, objective(p, values, float(np.median(values.z)))[0] + jacobian, spike)


@dataclass(frozen=True)
class Posterior:
    """The BRDF in all directions, given the points of one band."""

    directions: Directions
    brdf: Floats
    u_random: Floats
    """Independent from point to point [1/sr]."""
    causes: Floats
    """(n, m) [1/sr]: the change of every value for one standard deviation of each common cause."""
    angles: AngleErrors | None = None
    """What `u_random` and `causes` do not hold yet: the slopes of the process tell what it does to each value."""
    before: Before | None = None
    cones: tuple[float, float] | None = None
    """Half angles of lamp and lens [rad]: what shape a specular spike has; None where they are not known."""

    @cached_property
    def link(self) -> Link:
        """Of the scale that the process works on."""
        return Link(0.5 * FAINT * float(self._u.min()))

    @cached_property
    def _u(self) -> Floats:
        return np.hypot(self.u_random, NEGLIGIBLE * float(np.abs(self.brdf).max()))

    @cached_property
    def parameters(self) -> Floats:
        """The kernel's parameters, learned from these points."""
        return self._learned.p

    @property
    def spike(self) -> Spike | None:
        """A specular spike, where the values tell of one."""
        return self._learned.spike

    @property
    def _values(self) -> Training:
        return self._learned.values

    @property
    def form(self) -> tuple[str, int]:
        """The most probable form, and how many values there were when all forms were compared."""
        return self._learned.form, self._learned.compared

    @cached_property
    def _learned(self) -> _Learned:
        """Lobe and base as factors or as summands, and with a spike or without: what makes the values most probable.

        A form that many values have told is taken as long as few came since; its parameters are sought anew.
        """
        suspect = None if self.cones is None else suspected(self.directions, self.brdf, self.cones)
        forms: dict[str, Callable[[], _Learned | None]] = {
            "factors": lambda: self._without_spike,
            "summands": lambda: self._summed(None),
        }
        if suspect is not None:
            forms["factors, spike"] = lambda: self._with_spike(suspect)
            forms["summands, spike"] = lambda: self._summed(suspect)
        n, last = self.brdf.size, self.before
        if last is not None and last.form in forms and ENOUGH < n < COMPARED_AGAIN * last.compared:
            again = forms[last.form]()
            if again is not None:
                return replace(again, form=last.form, compared=last.compared)
        found = {form: one for form, learn in forms.items() if (one := learn()) is not None}
        form = min(found, key=lambda name: found[name].unlikely)
        return replace(found[form], form=form, compared=n)

    @cached_property
    def _without_spike(self) -> _Learned:
        """The values on the scale of the process, and its parameters; twice where slopes have to be known first."""
        slope = self.link.slope(self.brdf)
        at, z, u, causes = Coordinates.of(self.directions), self.link.z(self.brdf), self._u * slope, self.causes
        values = Training(at, z, u, causes * slope[:, None])
        if self.angles is None:
            return _Learned.of(values, learned(values, self._kernel_before))
        p = learned(values) if self.before is None else self.before.kernel
        by_detector, by_source, across = self._slopes(_process(values, p), self.directions)
        u = np.sqrt(u**2 + self.angles.read**2 * (by_detector**2 + by_source**2 + across**2))
        zeros = self.angles.zero * np.stack([by_detector, by_source, across], axis=-1)
        values = Training(at, z, u, np.concatenate([values.causes, zeros], axis=-1))
        return _Learned.of(values, learned(values, p))

    @property
    def _kernel_before(self) -> Floats | None:
        return None if self.before is None else self.before.kernel

    def _summed(self, spike: Spike | None) -> _Learned | None:
        """The values as a sum of lobe and base, by Gauss and Newton's steps; None where they do not settle.

        Near lobe and base so far, a value tells of the sum of what their logarithms change, each by its share. What a
        spike's unknowns do to it is a common cause.
        """
        d, at, e = self.directions, Coordinates.of(self.directions), self.link.e
        beyond = np.ones(d.shape, dtype=bool) if spike is None or self.cones is None else ~within(d, self.cones)
        begin = begun(at, self.brdf, self._u, beyond)
        if begin is None:
            return None
        lobe, base = (np.log(np.maximum(part / e, FAINTEST)) for part in begin)
        by: Slopes | None = None
        values, gain = self._near(lobe, base, by, spike)
        p = learned(values, self._kernel_before)
        for number in range(SEARCHES):
            p = learned(values, p, on=True) if number else p
            process = _process(values, p)
            for k in range(STEPS):
                ends = process.summands_at()
                if (np.abs(total(*ends) - total(lobe, base)) < SETTLED * values.u).all():
                    break
                # a summand that values hardly tell of swings to and fro if it is let
                part = 1.0 / (1 + k // 5)
                lobe, base = (
                    old + np.clip(part * (end - old), -1.0, 1.0) for end, old in zip(ends, (lobe, base), strict=True)
                )
                values, gain = self._near(lobe, base, by, spike)
                process = _process(values, p, process.parts)
            else:
                return None
            if spike is not None:
                factor = 1.0 + process.causes[: spike.theta_i.size]
                if (factor < 0.2).any():
                    return None
            if number < SEARCHES - 1:
                by = None if self.angles is None else self._slopes(process, d)
                if spike is not None:
                    spike = spike.scaled(np.clip(factor, 0.2, 5.0))
                values, gain = self._near(lobe, base, by, spike)
        return _Learned.of(values, p, spike, -float(np.log(gain / self.link.slope(self.brdf)).sum()))

    def _near(self, lobe: Floats, base: Floats, by: Slopes | None, spike: Spike | None) -> tuple[Training, Floats]:
        """The values as what they tell near a lobe and a base; and how a change of each value is seen there.

        `by` are the slopes of the sum, where errors of angles are to be counted by them.
        """
        f = self.link.brdf(total(lobe, base))
        gain = self.link.slope(f)
        of_lobe, of_base = shares(lobe, base)
        u, causes = self._u**2, self.causes
        read, zero = (0.0, 0.0) if self.angles is None else (self.angles.read, self.angles.zero)
        slopes = None if by is None else [s / gain for s in by]
        if spike is not None:
            effects, scatter = spike.effects(self.directions, read)
            f = f + effects @ spike.base
            u, causes = u + scatter**2, np.concatenate([effects, causes], axis=-1)
        if slopes is not None:
            u = u + read**2 * sum(s**2 for s in slopes)
            if spike is not None:
                # both arms move a point away from the mirror direction
                steep = self._steepness_of(spike, read)
                slopes = [slopes[0] + steep, slopes[1] - steep, slopes[2]]
            causes = np.concatenate([causes, zero * np.stack(slopes, axis=-1)], axis=-1)
        z = gain * (self.brdf - f) + of_lobe * lobe + of_base * base
        at = Coordinates.of(self.directions).seen(of_lobe, of_base)
        return Training(at, z, np.sqrt(u) * gain, causes * gain[:, None], summed=True), gain

    def _steepness_of(self, spike: Spike, read: float) -> Floats:
        """What a spike changes along the plane of the mirror direction [1/sr/rad]."""
        ends = [_moved(self.directions, SLOPE_STEP * side) for side in (1.0, -1.0)]
        plus, minus = (spike.effects(end, read)[0] @ spike.base for end in ends)
        return np.asarray((plus - minus) / (2.0 * SLOPE_STEP))

    def _with_spike(self, spike: Spike) -> _Learned | None:
        """The same of what a spike leaves, by Gauss and Newton's steps; None where the values want none.

        A value is f = L(z) + spike. Near z0 it is as good as a value of z whose noise is that of f over dL/dz; what the
        spike's unknowns do to it is a common cause.
        """
        d, at = self.directions, Coordinates.of(self.directions)
        assert self.cones is not None
        beyond = ~within(d, self.cones)
        slope = self.link.slope(self.brdf)
        read, zero = (0.0, 0.0) if self.angles is None else (self.angles.read, self.angles.zero)
        z0 = self.link.z(self.brdf)
        values = Training(at, z0, self._u * slope, self.causes * slope[:, None])
        # the lobe alone, first: it is known beyond the cones
        start = values.only(beyond)
        if start.z.size < FEWEST:
            return None
        p = learned(start)
        process = _process(start, p)
        for last in (False, False, True, True):
            z0 = np.where(beyond, self.link.z(self.brdf), process.mean_at(at))
            gain = self.link.slope(self.link.brdf(z0))
            effects, scatter = spike.effects(d, read)
            rest = self.brdf - self.link.brdf(z0) - effects @ spike.base
            z = z0 + np.where(beyond, 0.0, rest * gain)
            by = self._slopes(process, d)
            steep = self._steepness_of(spike, read) * gain
            u = np.sqrt((self._u * gain) ** 2 + (scatter * gain) ** 2 + read**2 * sum(s**2 for s in by))
            # both arms move a point away from the mirror direction
            zeros = zero * np.stack([by[0] + steep, by[1] - steep, by[2]], axis=-1)
            values = Training(
                at, z, u, np.concatenate([effects * gain[:, None], self.causes * gain[:, None], zeros], axis=-1)
            )
            if last:
                p = learned(values, p)
            process = _process(values, p)
            factor = 1.0 + process.causes[: spike.theta_i.size]
            spike = spike.scaled(np.clip(factor, 0.2, 5.0))
            if (factor < 0.2).any():
                return None
        return _Learned.of(values, p, spike.scaled(1.0 / np.clip(factor, 0.2, 5.0)), -float(np.log(gain / slope).sum()))

    def _slopes(self, process: Process, d: Directions) -> Slopes:
        """Derivatives by theta_r, by theta_i, and by an angle across the plane of theta_r [1/rad]."""
        (omega_i, omega_r), h = d.vectors, SLOPE_STEP
        down_r, down_i = direction(d.theta_r + np.pi / 2, d.phi_r), direction(d.theta_i + np.pi / 2, d.phi_i)
        aside = direction(np.full(d.shape, np.pi / 2), d.phi_r + np.pi / 2)

        def by(source: Floats, detector: Floats) -> Floats:
            ends = [Directions.from_vectors(omega_i + k * h * source, omega_r + k * h * detector) for k in (1.0, -1.0)]
            plus, minus = (process.mean_at(Coordinates.of(end)) for end in ends)
            return (plus - minus) / (2.0 * h)

        none = np.zeros_like(omega_r)
        return by(none, down_r), by(down_i, none), by(none, aside)

    @cached_property
    def _process(self) -> Process:
        return _process(self._values, self.parameters)

    @cached_property
    def _nearby(self) -> list[tuple[Process, Process]]:
        """With other parameters that the values allow."""
        v, mean = self._values, float(np.median(self._values.z))
        return [(Process(v, a, mean), Process(v, b, mean)) for a, b in nearby(self.parameters, v, mean)]

    @cached_property
    def _without_causes(self) -> Process:
        """But for a spike's, which further points can tell."""
        v = self._values
        kept = 0 if self.spike is None else self.spike.base.size
        causes = v.causes[:, :kept] if kept else np.zeros((v.z.size, 1))
        return _process(Training(v.at, v.z, v.u, causes, v.summed), self.parameters)

    @cached_property
    def left_out(self) -> Floats:
        """For each point: its departure from what the others predict, in standard deviations."""
        return self._without_causes.left_out

    @property
    def misfit(self) -> float:
        """By how much intervals are widened: 1, or the scatter of left-out points where it is larger than it may be."""
        scatter = float(np.sqrt(np.mean(np.clip(self.left_out, -4.0, 4.0) ** 2)))
        return scatter if scatter > MISFIT else 1.0

    def expected(self, directions: Directions, noise: Floats) -> tuple[Floats, Floats, Floats]:
        """BRDF [1/sr]; covariance of what more points can tell; variance of one point, in each direction.

        Both are on the scale of the process, and leave out the common causes. `noise` is the relative standard
        uncertainty of points, that of their angles apart.
        """
        process = self._without_causes
        f, covariance, gain, scatter = self._curve(process, directions)
        slope = self.link.slope(f)
        u = np.hypot(noise * np.abs(f), NEGLIGIBLE * float(np.abs(self.brdf).max())) * slope
        variance = np.minimum(np.hypot(u, scatter * slope), 10.0) ** 2
        if self.angles is not None:
            by = self._slopes(process, directions)
            variance = variance + (gain * self.angles.read) ** 2 * sum(s**2 for s in by)
        return f, covariance * self.misfit**2, variance

    def steepness(self, directions: Directions, floor: float) -> Floats:
        """Slope of the curve over the detector's direction, relative to its value [1/rad], a spike apart.

        Relative to the part `floor` of the largest value where the curve is below that.
        """
        process = self._without_causes
        by_detector, _, across = self._slopes(process, directions)
        f = self.link.brdf(process.mean_at(Coordinates.of(directions)))
        size = np.maximum(np.abs(f), floor * float(np.abs(self.brdf).max()))
        return np.asarray(np.hypot(by_detector, across) / (self.link.slope(f) * size))

    def brdf_at(self, directions: Directions) -> Floats:
        """BRDF [1/sr], zero or more: what `at` gives first, without what uncertainties take."""
        return np.maximum(self._mean(self._process, directions)[0], 0.0)

    def at(self, directions: Directions) -> tuple[Floats, Floats, Floats, Floats]:
        """BRDF, standard uncertainty, and the interval of 95 % [1/sr], common causes included.

        The BRDF is zero or more; an interval may begin below zero.
        """
        at, process = Coordinates.of(directions), self._process
        f, lobe, effects = self._mean(process, directions)
        # near the most probable curve: a faint summand that is hardly known counts by its share
        seen = process.seen(at)
        variance, changes = process.variance_at(seen, effects), process.changes_at(seen)
        # what the kernel's parameters are is not known either
        of_means, of_variances = np.zeros(f.shape), np.zeros(f.shape)
        for pair in self._nearby:
            for one in pair:
                away = one.changes_at(seen) - changes
                if effects is not None:
                    count = effects.shape[1]
                    away = away + effects @ (one.causes[:count] - process.causes[:count])
                of_means += 0.5 * away**2
                of_variances += 0.5 * (one.variance_at(seen, effects) - variance)
        variance = np.maximum(variance, 0.0) + of_means + np.maximum(of_variances, 0.0)
        gain = self.link.slope(f) / self.link.slope(lobe)
        z = self.link.z(f)
        # no BRDF is below zero: where the process is, it is wrong by that at least
        sd = np.maximum(np.sqrt(variance) * gain * self.misfit, -z)
        low, high = (self.link.brdf(z + k * sd) for k in (-NORMAL_95, NORMAL_95))
        return np.maximum(f, 0.0), sd / self.link.slope(f), low, high

    def _mean(self, process: Process, d: Directions) -> tuple[Floats, Floats, Floats | None]:
        """BRDF [1/sr] with the spike and without; what the spike's unknowns change on the scale of the link."""
        lobe = self.link.brdf(process.mean_at(Coordinates.of(d)))
        if self.spike is None:
            return lobe, lobe, None
        added, _ = self.spike.effects(d)
        f = lobe + added @ (self.spike.base + process.causes[: added.shape[1]])
        return f, lobe, added * self.link.slope(lobe)[:, None]

    def _curve(self, process: Process, d: Directions) -> tuple[Floats, Floats, Floats, Floats]:
        """BRDF [1/sr] with the spike; covariance on the scale of the link; what one unit of the process is there;
        standard deviation [1/sr] of a new value by what errors of its angles do to a spike.
        """
        f, lobe, effects = self._mean(process, d)
        covariance = process.covariance_at(Coordinates.of(d), effects)
        if self.spike is None:
            return f, covariance, np.ones(d.shape), np.zeros(d.shape)
        _, scatter = self.spike.effects(d, 0.0 if self.angles is None else self.angles.read)
        # a unit of the process is 1/slope there, and slope(f) on the scale of the link
        gain = self.link.slope(f) / self.link.slope(lobe)
        return f, covariance * gain * gain[:, None], gain, scatter


def _process(values: Training, p: Floats, parts: tuple[Floats, Floats] | None = None) -> Process:
    """With the median as its mean."""
    return Process(values, p, float(np.median(values.z)), parts)


def _moved(d: Directions, by: float) -> Directions:
    """Detectors further from the normal, on the far side of it: in the plane of the source's mirror direction."""
    omega_i, omega_r = d.vectors
    return Directions.from_vectors(omega_i, omega_r + by * direction(d.theta_i + np.pi / 2, d.phi_i + np.pi))
