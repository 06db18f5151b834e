"""What the visits to the white reference say: the signal per unit BRDF at any time in between."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gonio.checks.values import SIGNIFICANCE
from gonio.lab.reduction import lamp_wander
from gonio.typing import Bools, Floats

SAME_TIME_S = 1e-3
"""Visits closer than this count as one time: no drift is told from them."""
SMOOTH = 4
"""Visits from which on they tell how the level bends between them."""
EXTRAPOLATED = 0.1
"""Largest relative change of the level that a line may make farther outside of the visits than these are apart. Beyond
it a rate over the level is not linear in the level's error any more, and the level may turn negative."""


@dataclass(frozen=True, slots=True)
class Level:
    """The signal per unit BRDF as a function of time, fitted to the visits of one band.

    Where the visits lie on a straight line within their noise, K(t) = level + slope (t - centre), whose two
    parameters are uncorrelated. Otherwise K is interpolated linearly between the visits, and constant beyond the first
    and the last; `SMOOTH` visits and more by monotone cubics (Fritsch and Carlson). In either case `noise` and `drift`
    are what the noise of the visits does to the line, and `wander` what the lamp may do besides
    (`gonio.lab.reduction.lamp_wander`).
    Where the lamp was dark in between, as from one day to the next, K is not interpolated across that time: a point
    after the last visit of its session (`held`) has the K of that visit, and `wander` what the lamp drifts meanwhile.
    Where the visits do not tell the lamp's drift, K is their mean, `slope` and `u_slope` are zero, and `unknown` says
    why; `wander` is then what they scatter beyond their noise.
    """

    centre_s: float
    level: float
    u_level: float
    slope: float
    u_slope: float
    straight: bool
    chi_square: float
    times_s: Floats
    values: Floats
    variances: Floats
    unknown: str = ""
    """Why a drift of the lamp is in neither K nor its uncertainty; "" where the visits tell it."""
    scatter: float = 0.0
    """Standard deviation of K around a constant level, where the visits differ by more than their noise."""
    lit_s: Floats = field(default_factory=lambda: np.empty(0))
    """When the lamp was lit anew; empty where it shone from the first visit to the last."""

    def at(self, time_s: Floats) -> Floats:
        """K at given times."""
        return self.line(time_s) if self.straight else between(self.times_s, self.values, self.held(time_s))

    def held(self, time_s: Floats) -> Floats:
        """The time nearest to each that lies between two visits to which the lamp was lit without a break."""
        if self.straight or not len(self.lit_s):
            return time_s
        session, of_visit = (np.searchsorted(self.lit_s, t, side="right") for t in (time_s, self.times_s))
        out = np.array(time_s, dtype=float)
        for k in np.unique(of_visit):
            inside = self.times_s[of_visit == k]
            out = np.where(session == k, np.clip(out, inside[0], inside[-1]), out)
        return out

    @property
    def _steepest(self) -> float:
        """How fast K changes at most between two visits of one session; where no session has two, between any."""
        slopes = np.abs(np.diff(self.values) / np.diff(self.times_s))
        together = np.diff(np.searchsorted(self.lit_s, self.times_s, side="right")) == 0
        return float(slopes[together].max() if together.any() else slopes.max())

    def noise(self, time_s: Floats) -> Floats:
        """Change of K for one standard deviation of the mean level."""
        return np.full(np.shape(time_s), self.u_level)

    def changes(self, brdf: Floats, time_s: Floats, u_reference: float) -> dict[str, Floats]:
        """Columns of values [1/sr]: changes by the reference's relative uncertainty, and by `noise` and `drift`."""
        level = self.at(time_s)
        return {
            "s_reference": brdf * u_reference,
            "s_reference_noise": -brdf * self.noise(time_s) / level,
            "s_lamp_drift": -brdf * self.drift(time_s) / level,
        }

    def drift(self, time_s: Floats) -> Floats:
        """Change of K for one standard deviation of the slope."""
        return np.asarray(self.u_slope * (time_s - self.centre_s))

    def wander(self, time_s: Floats) -> lamp_wander.Wander:
        """What K may depart by beyond that."""
        session = np.searchsorted(self.lit_s, self.times_s, side="right")
        visits = lamp_wander.LampVisits(self.times_s, self.values, self.variances, session)
        held = self.held(time_s)
        found = lamp_wander.wander(visits, held, lambda t: (self.at(t), np.stack([self.noise(t), self.drift(t)], 1)))
        away = self._steepest * (time_s - held) if len(self.lit_s) and not self.straight else 0.0
        return replace(found, u=np.sqrt(found.u**2 + away**2 + self.scatter**2))

    def line(self, time_s: Floats) -> Floats:
        """The straight line that is nearest to all visits."""
        return self.level + self.slope * (time_s - self.centre_s)


def between(times_s: Floats, values: Floats, wanted_s: Floats) -> Floats:
    """K interpolated between visits, constant beyond them; by monotone cubics where there are `SMOOTH` visits.

    `values` has the shape (..., n), for n ascending times.
    """
    from scipy.interpolate import PchipInterpolator, interp1d

    within = np.clip(wanted_s, times_s[0], times_s[-1]) - times_s[0]
    how = PchipInterpolator if len(times_s) >= SMOOTH else interp1d
    return np.asarray(how(times_s - times_s[0], values, axis=-1)(within))


def fit(
    times_s: Floats,
    values: Floats,
    variances: Floats,
    wanted_s: Floats | None = None,
    lit_s: Sequence[float] = (),
) -> Level:
    """Fit the level of the visits by weighted least squares; see `Level`.

    Visits at one time (within `SAME_TIME_S`) count as one, with their mean. One time gives a constant level without
    any knowledge of drift; two give a line without a test of it. A line is not used far outside of its visits, where
    it would change the level by more than `EXTRAPOLATED`: the level is constant then, too.

    Parameters
    ----------
    times_s, values, variances : (n,) arrays, n >= 1
        Of each visit: when it was [s], the signal per unit BRDF [e- sr/s], and that signal's variance.
    wanted_s : (m,) array, optional
        When the level will be asked for [s]; between the visits, if it is not given.
    lit_s : sequence of float, optional
        When the lamp was lit anew [s], if it was dark in between.
    """
    order = np.argsort(times_s, kind="stable")
    every = times_s[order], values[order], variances[order]
    later = np.diff(every[0], prepend=-np.inf) > SAME_TIME_S
    times_s, values, variances = _means(*every, later)
    if len(times_s) == 1:
        several = f"the {len(later)} measurements of the white reference have one and the same time"
        return _constant(*every, "one measurement of the white reference only" if len(later) == 1 else several)
    weights = 1.0 / variances
    level, u_level = float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
    after = times_s - times_s[0]  # seconds since 1970 have few digits to spare
    mean = float(np.average(after, weights=weights))
    spread = float(np.sum(weights * (after - mean) ** 2))
    slope, u_slope = float(np.sum(weights * (after - mean) * (values - level)) / spread), spread**-0.5
    chi_square, freedom = float(np.sum(weights * (values - level - slope * (after - mean)) ** 2)), len(values) - 2
    straight = not _rejected(chi_square, freedom)
    centre = float(times_s[0]) + mean
    if wanted_s is not None and np.size(wanted_s):
        outside = np.maximum(np.maximum(times_s[0] - wanted_s, wanted_s - times_s[-1]), 0.0)
        steepest = max(abs(slope), u_slope * max(1.0, chi_square / max(freedom, 1)) ** 0.5)
        far = (outside > after[-1]) & (steepest * np.abs(wanted_s - centre) > EXTRAPOLATED * abs(level))
        if far.any():
            return _constant(
                *every,
                f"the measurements of the white reference lie within {after[-1]:.3g} s, and points up to "
                f"{outside.max():.3g} s away from them",
            )
    chi_square = chi_square if freedom else 0.0
    lit = np.sort(np.asarray(lit_s, dtype=float))
    return Level(centre, level, u_level, slope, u_slope, straight, chi_square, times_s, values, variances, lit_s=lit)


def _constant(times_s: Floats, values: Floats, variances: Floats, unknown: str) -> Level:
    """The mean of all visits, without any drift."""
    time, mean, variance = _means(times_s, values, variances, np.arange(len(times_s)) == 0)
    level, u_level = float(mean[0]), float(variance[0] ** 0.5)
    noise = 1.0 / float(np.sum(1.0 / variances))
    scatter = math.sqrt(max(float(variance[0]) - noise, 0.0) * len(values))
    return Level(float(time[0]), level, u_level, 0.0, 0.0, True, 0.0, time, mean, variance, unknown, scatter)


def _means(times_s: Floats, values: Floats, variances: Floats, first: Bools) -> tuple[Floats, Floats, Floats]:
    """Weighted means of groups of visits that follow each other; `first` marks where a group begins.

    Where the visits of a group differ by more than their noise, the variance of their mean is that of their scatter.
    """
    starts = np.flatnonzero(first)
    group = np.cumsum(first) - 1
    weights = 1.0 / variances
    total = np.add.reduceat(weights, starts)
    begun = times_s[starts]
    time = begun + np.add.reduceat(weights * (times_s - begun[group]), starts) / total
    base = values[starts]
    mean = base + np.add.reduceat(weights * (values - base[group]), starts) / total
    chi_square = np.add.reduceat(weights * (values - mean[group]) ** 2, starts)
    freedom = np.bincount(group) - 1
    wider = [c / f if _rejected(c, f) else 1.0 for c, f in zip(chi_square.tolist(), freedom.tolist(), strict=True)]
    return time, mean, np.array(wider) / total


def _rejected(chi_square: float, freedom: int) -> bool:
    """Whether a chi-square is rarer than noise allows; nothing is tested without degrees of freedom."""
    from scipy.special import chdtrc  # of chi-square, beyond

    return freedom > 0 and bool(chdtrc(freedom, chi_square) < SIGNIFICANCE)


def notes(fitted: Level, visits: int, unusable: list[str]) -> list[str]:
    """What a table has to say of its white reference in a band.

    Parameters
    ----------
    fitted
        The level.
    visits
        How many visits it was fitted to.
    unusable
        The flags of the other visits.
    """
    out = []
    if unusable:
        why = ", ".join(f"{unusable.count(flag)} {flag}" for flag in dict.fromkeys(unusable))
        out.append(
            f"{len(unusable)} of {visits + len(unusable)} measurements of the white reference cannot be used ({why})"
        )
    if fitted.unknown:
        only = " except for how far the measurements scatter" if fitted.scatter else ""
        out.append(f"{fitted.unknown}, so a drift of the lamp is not in u_brdf{only}")
    if not fitted.straight:
        out.append(
            "the measurements of the white reference do not lie on a straight line (chi-square "
            f"{fitted.chi_square:.1f} of {visits} measurements): the level is interpolated between them"
        )
    return out
