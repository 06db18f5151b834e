"""The lobe of a curve in the plane of incidence: how high its maximum is, how wide it is at half of it, and where.

The base is the median of the values away from the mirror direction. A lobe rises from it by `RISE` at least. The
maximum is that of a parabola through the logarithms near it. Width and half height are those above the base. Flanks
with many values are smoothed by a parabola, others are joined by a cubic of logarithms, whose error is stated as in
`gonio_analysis.changes.resampling`. Uncertainties are those of `DRAWS` draws of the curve's values.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from gonio.geometry import FARTHEST, half_angle_of_cone
from gonio.typing import Bools, Floats, Ints
from gonio_analysis.curves.in_plane import Curve
from gonio_analysis.fitting.observations import Observations

RISE = 1.5
"""A maximum near the mirror direction is a lobe from so many times the base on; retro peaks and Fresnel's slow rise
toward grazing make less within the directions around it."""
DRAWS = 50
"""Of which a standard deviation is known to 10 %."""
SEARCHED = float(np.radians(30.0))
"""Off-specular maxima of rough surfaces lie within it of the mirror direction."""
AWAY = float(np.radians(40.0)), float(np.radians(25.0))
"""Values so far from the mirror direction make the base; the second where fewer than `FEWEST` are."""
NEAR_SOURCE = float(np.radians(15.0))
"""Within it of the source retroreflection is looked for, which is no base."""
GRAZING = float(np.radians(65.0))
"""From this polar angle of the detector on values rise for grazing alone."""
FEWEST = 3
"""Values that a base is made of, and that a resolved lobe has above half of its height."""
TOP = 0.7
"""Values above this share of the height make the parabola at the maximum."""
FLANK = (0.2, 0.8)
"""Values between these shares of the height make a flank."""
MANY = 5
"""So many values of a flank are smoothed."""
CONES = 1.5
"""A lobe below so many times the width of the instrument's cones shows the instrument."""


@dataclass(frozen=True)
class CurveLobe:
    """What is near the mirror direction of one curve. Uncertainties are NaN where the table states none."""

    parameter: float
    """Angle of incidence [rad]."""
    base: float
    """[1/sr], NaN where too few values lie away from the mirror direction."""
    height: float
    """Largest value near the mirror direction [1/sr]."""
    exists: bool
    """Whether it rises from the base."""
    why: str
    """Why width and place are not known, in words; "" where they are."""
    width: float = math.nan
    """Full width at half height above the base [rad]."""
    at: float = math.nan
    """Signed angle of the maximum [rad]."""
    u_height_rel: float = math.nan
    u_width: float = math.nan
    u_at: float = math.nan

    @property
    def resolved(self) -> bool:
        """Whether width and place are known."""
        return not self.why

    @property
    def contrast(self) -> float:
        """Height over base; a base that is lost in the height counts as a millionth of it."""
        return self.height / max(self.base, 1e-6 * self.height) if self.height > 0.0 else math.nan


@dataclass(frozen=True)
class _Measured:
    """Numbers of a curve's values as they are, or as they are drawn."""

    base: float
    height: float
    width: float
    at: float
    error: float
    """Of the width, by interpolation [rad]."""
    why: str


def lobe(curve: Curve, data: Observations) -> CurveLobe | None:
    """The lobe of a curve of `data`; None where no value lies near the mirror direction.

    A maximum at an end of the curve, or one that drops on one side alone, has no width.
    """
    near = np.abs(curve.angle - curve.parameter) <= SEARCHED
    if not near.any():
        return None
    away = _away(curve)
    found = _measure(curve.angle, curve.brdf, near, away)
    exists = found.height > RISE * found.base or (math.isnan(found.base) and not found.why)
    if not exists:
        return CurveLobe(curve.parameter, found.base, found.height, exists=False, why="there is none")
    why = found.why or _too_narrow(found.width, data)
    out = CurveLobe(curve.parameter, found.base, found.height, True, why, found.width, found.at)
    if data.covariance is None:
        return out
    random, common = data.covariance.random[curve.rows], data.covariance.common[curve.rows]
    rng = np.random.default_rng(0)  # the same curve has the same uncertainties
    drawn = []
    for _ in range(DRAWS):
        noise = random * rng.normal(size=random.size) + common @ rng.normal(size=common.shape[1])
        one = _measure(curve.angle, curve.brdf + noise, near, away)
        drawn.append((math.log(max(one.height, 1e-300)), one.width, one.at))
    spread = [float(np.std(x[np.isfinite(x)])) if np.isfinite(x).sum() > DRAWS // 2 else math.nan
              for x in np.array(drawn).T]  # fmt: skip
    u_width = math.hypot(spread[1], found.error)
    return replace(out, u_height_rel=spread[0], u_width=u_width, u_at=spread[2])


def _too_narrow(width: float, data: Observations) -> str:
    cones = half_angle_of_cone([data.source_solid_angle_sr, data.receiver_solid_angle_sr])
    seen = 2.0 * float(np.nan_to_num(cones).sum())
    return "it is as narrow as the instrument's cones" if width < CONES * seen else ""


def _away(curve: Curve) -> Bools:
    """Which values make the base."""
    from_mirror, from_source = np.abs(curve.angle - curve.parameter), np.abs(curve.angle + curve.parameter)
    plain = (from_source > NEAR_SOURCE) & (np.abs(curve.angle) < GRAZING)
    for far in AWAY:
        for kept in (plain, np.ones_like(plain)):
            if np.count_nonzero(out := (from_mirror >= far) & kept) >= FEWEST:
                return out
    return np.zeros(curve.angle.size, dtype=bool)


def _measure(x: Floats, f: Floats, near: Bools, away: Bools) -> _Measured:
    base = float(np.median(f[away])) if away.any() else math.nan
    top = int(np.flatnonzero(near)[np.argmax(f[near])])
    if not f[top] > 0.0:
        return _Measured(base, float(f[top]), math.nan, math.nan, math.nan, "its values are lost in noise")
    floor = 0.0 if math.isnan(base) else base
    if top in (0, x.size - 1):
        return _Measured(base, float(f[top]), math.nan, math.nan, math.nan, "its maximum is at the end of the curve")
    height, at = _maximum(x, f, top, floor)
    share = (f - floor) / (height - floor) if height > floor else np.zeros(f.size)
    ends = [_crossing(x, f, share, top, step, floor + 0.5 * (height - floor)) for step in (-1, 1)]
    if any(end is None for end in ends):
        return _Measured(base, height, math.nan, at, math.nan, "one of its flanks was not measured")
    (left, of_left), (right, of_right) = (end for end in ends if end is not None)
    if np.count_nonzero((x > left) & (x < right)) < FEWEST:
        return _Measured(base, height, math.nan, at, math.nan, "the steps are too wide for it")
    return _Measured(base, height, float(right - left), at, math.hypot(of_left, of_right), "")


def _maximum(x: Floats, f: Floats, top: int, floor: float) -> tuple[float, float]:
    """Height and place of the maximum, by a parabola of logarithms."""
    low, high, least = top, top, floor + TOP * (f[top] - floor)
    while low > 0 and f[low - 1] > least:
        low -= 1
    while high < x.size - 1 and f[high + 1] > least:
        high += 1
    if high - low < 2:
        low, high = max(top - 1, 0), min(top + 1, x.size - 1)
    some = np.arange(low, high + 1)
    some = some[f[some] > 0.0]
    if some.size < 3 or np.ptp(x[some]) == 0.0:
        return float(f[top]), float(x[top])
    scale = float(np.ptp(x[some]))
    curvature, slope, level = np.polyfit((x[some] - x[top]) / scale, np.log(f[some]), 2)
    at = -0.5 * slope / curvature if curvature < 0.0 else math.inf
    if not x[some[0]] <= x[top] + scale * at <= x[some[-1]]:
        return float(f[top]), float(x[top])
    return math.exp(level + 0.5 * slope * at), float(x[top] + scale * at)


def _crossing(x: Floats, f: Floats, share: Floats, top: int, step: int, half: float) -> tuple[float, float] | None:
    """Where the curve passes half of its height, on one side of the maximum, and the error of that [rad]; None: not."""
    side = np.arange(top, x.size) if step > 0 else np.arange(top, -1, -1)
    below = np.flatnonzero(share[side] < FLANK[0])
    walked = side[: below[0] + 1] if below.size else side
    under = np.flatnonzero(share[walked] < 0.5)
    if not under.size or not under[0]:  # not passed, or the maximum itself does not rise from the base
        return None
    flank = walked[(share[walked] > FLANK[0]) & (share[walked] < FLANK[1])]
    if flank.size >= MANY:
        ln = np.log(share[flank]) - math.log(0.5)
        return float(np.polyfit(ln, x[flank], 2)[2]), 0.0
    beyond = int(walked[under[0]])
    before = beyond - step
    if abs(x[beyond] - x[before]) > FARTHEST or min(f[beyond], f[before]) <= 0.0:
        return None
    return _between(x, f, min(before, beyond), half)


def _between(x: Floats, f: Floats, k: int, half: float) -> tuple[float, float]:
    """Where the curve is `half` between the values k and k + 1, and the error of that [rad]."""
    log, goal = np.log(np.maximum(f, 1e-300)), math.log(half)
    slope = (log[k + 1] - log[k]) / (x[k + 1] - x[k])
    chord = float(x[k] + (goal - log[k]) / slope)
    first = int(np.clip(k - 1, 0, x.size - 4)) if x.size >= 4 else 0
    around: Ints = np.arange(first, min(first + 4, x.size))
    if around.size < 4 or f[around].min() <= 0.0 or np.diff(x[around]).max() > FARTHEST:
        return chord, abs(x[k + 1] - x[k]) / 4.0
    u = x[around] - x[k]
    fine = np.linspace(0.0, x[k + 1] - x[k], 401)
    cubic, one, other = (np.polyval(np.polyfit(u[some], log[around][some], len(u[some]) - 1), fine)
                         for some in (slice(0, 4), slice(0, 3), slice(1, 4)))  # fmt: skip
    at = int(np.argmin(np.abs(cubic - goal)))
    off = 0.5 * abs(one[at] - other[at]) / max(abs(slope), 1e-12)
    return float(x[k] + fine[at]), float(min(off, x[k + 1] - x[k]))
