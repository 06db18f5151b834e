"""How steep a lobe may be between the points of a curve: what steps that are coarser than it leave open.

A lobe around the mirror direction is taken for a sum of Gaussians of the half vector's slope, of any widths: a narrow
one, a broad one, and a matte ground, which is one without an end. Over t, the squared distance from the mirror
direction, such a sum is convex in its logarithm. So at a point it falls no faster than between the point and the next
one nearer to the mirror direction. Where there is none, the lobe could be as narrow as the instrument's cones, as far
as it reflects no more light than there is (docs/radiometry.md, "Narrow lobes and coarse steps").

Only what a point has beyond the trend of those farther out is bounded so. The trend is the logarithm going on straight
over t, above no base or above the lowest value farther out; between the two points next to the mirror direction also
the cubic through the logarithms of two points a side.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from gonio.lab.reduction.spikes import lagrange
from gonio.typing import Floats

MOST = 10.0
"""Times all light, which a lobe may reflect: Cook and Torrance's own convention makes lobes four times too bright, and
toward grazing incidence they rise again by twice."""
FALL = 0.2
"""Steps over which the logarithm of a lobe falls by less resolve it."""
SURE = 5.0
"""Standard uncertainties by which a value exceeds a base that it counts as above."""


def _outward(t: Floats, f: Floats, k: int, outside: Sequence[int]) -> float:
    """How fast a value falls toward the next point farther out, over t."""
    if not outside or f[k] <= 0.0:
        return 0.0
    j = outside[0]
    return float(f[k] * math.log(max(f[k] / max(f[j], 1e-3 * f[k]), 1.0)) / (t[j] - t[k]))


def steepest(
    from_mirror: Floats,
    values: Floats,
    u: Floats,
    theta_i: Floats,
    theta_r: Floats,
    half_angles: tuple[float, float],
    apart: float,
) -> Floats:
    """About the largest slope [1/sr per rad] that a lobe may have at each point of a curve.

    Of sums of Gaussians the true slope exceeds it by up to a sixth where steps resolve the lobe: differences between
    points tell the slope itself there.

    Parameters
    ----------
    from_mirror : (n,) array [rad], ascending
        The curve's points: signed distances from the mirror direction, in the plane of incidence.
    values, u : (n,) arrays [1/sr]
        Their values, and the standard uncertainties of these.
    theta_i, theta_r : (n,) arrays [rad]
        Their angles of incidence and of reflection.
    half_angles
        Of the lamp and of the lens [rad]: no lobe is seen narrower than they make it.
    apart
        Points that are nearer to each other [rad] do not tell a slope.
    """
    # values below the noise may be negative; no lobe is
    x, f = np.abs(from_mirror), np.maximum(np.asarray(values, dtype=float), 0.0)
    t = 4.0 * np.tan(0.5 * x) ** 2
    bound = np.zeros(f.size)
    # two discs blur by a quarter of the sum of their squared radii a direction
    narrowest = max(0.25 * (half_angles[0] ** 2 + half_angles[1] ** 2), (0.5 * apart) ** 2)
    cosine = np.cos(theta_r)
    order = np.argsort(x, kind="stable")
    sides = {side: order[(np.sign(from_mirror[order]) == side) & (x[order] > 0.0)] for side in (-1.0, 1.0)}
    for k in np.flatnonzero(x >= apart):
        own, other = (sides[side * float(np.sign(from_mirror[k]))] for side in (1.0, -1.0))
        inside = [*own[x[own] <= x[k] - apart][::-1], *np.flatnonzero(x < apart), *other[x[other] <= 0.5 * x[k]]][:1]
        outside = _apart(own[x[own] >= x[k] + apart], x, apart)
        far = _apart(other[x[other] >= x[k] + apart], x, apart)
        rest, fall, inner = _going_on(t, f, u, int(k), outside, inside)
        if len(outside) < 2:  # what lies on the other side of the mirror direction tells the ground, too
            rest, fall, inner = max((rest, fall, inner), _going_on(t, f, u, int(k), far, inside))
        if not inside:
            rest, fall = max((rest, fall), _across(from_mirror, t, f, int(k), outside[:2], far[:2]))
        excess = max(f[k] - rest, 0.0) + max(u[k], 1e-300)
        nearest = _energy(t[k], min(math.cos(theta_i[k]), float(cosine[k])) * excess)
        rate = min(nearest, 0.5 * t[k] / narrowest) / t[k]
        if inside:
            rise = math.log(max((f[inside[0]] + u[inside[0]] - inner) / excess, 1.0))
            if not outside and rise > FALL:
                # toward grazing reflection a lobe may rise as 1 / cos(theta_r), which hides some of its fall
                rise += max(math.log(cosine[inside[0]] / cosine[k]), 0.0)
            rate = min(rate, rise / (t[k] - t[inside[0]]))
        steep = max(fall + excess * rate, _outward(t, f, int(k), outside))
        bound[k] = 2.0 * math.sqrt(t[k]) * (1.0 + 0.25 * t[k]) * steep
    return bound


def _apart(places: Iterable[int], x: Floats, apart: float) -> list[int]:
    """The first of the places, and those that each lie far enough from the one before."""
    out: list[int] = []
    for j in places:
        if not out or x[j] >= x[out[-1]] + apart:
            out.append(int(j))
    return out


def _going_on(
    t: Floats, f: Floats, u: Floats, k: int, outside: list[int], inside: list[int]
) -> tuple[float, float, float]:
    """What the points farther out say of point k: the value there, how it falls over t, and the value farther in.

    The logarithm goes on straight, of what stands above a base: none, or the lowest value farther out. As a sum of
    Gaussians is convex, both say too little; the larger one counts.
    """
    inner = t[inside[0]] if inside else 0.0
    found = (0.0, 0.0, 0.0)
    if not outside:
        return found
    a, *more = outside
    options = [(max(f[a], 0.0), 0.0, max(f[a], 0.0))]
    if more:
        b, *last = more
        for base in (0.0, *([float(min(f[last]))] if last else [])):
            over_a, over_b = f[a] - base, f[b] - base
            if over_b > SURE * math.hypot(u[b], u[last].max() if base else 0.0) and over_a > over_b:
                rate = math.log(over_a / over_b) / (t[b] - t[a])
                here = over_a * math.exp(min(rate * (t[a] - t[k]), 50.0))
                options.append((base + here, here * rate, base + here * math.exp(min(rate * (t[k] - inner), 50.0))))
    value, fall, there = max(options)
    if value > f[k]:  # not more than there is
        return float(max(f[k], 0.0)), fall * max(f[k], 0.0) / value, there
    return value, fall, there


def _across(from_mirror: Floats, t: Floats, f: Floats, k: int, own: list[int], other: list[int]) -> tuple[float, float]:
    """What two points on each side of the mirror direction say of point k between them, and how that falls over t.

    The cubic through their logarithms: for a Gaussian it is exact, and it bends with what is not alike on both
    sides. Not more than there is.
    """
    four = [*own, *other]
    if len(four) < 4 or f[four].min() <= 0.0 or f[k] <= 0.0:
        return 0.0, 0.0
    step = 0.05 * from_mirror[k]
    here, out = lagrange(np.array([from_mirror[k], from_mirror[k] + step]), from_mirror[four], np.log(f[four]))
    value = min(math.exp(min(here, 300.0)), float(f[k]))
    return value, value * max(here - out, 0.0) / (4.0 * math.tan(0.5 * (from_mirror[k] + step)) ** 2 - t[k])


def _energy(t: float, brightness: float) -> float:
    """The largest y with y exp(-y) = pi t f cos(theta) / MOST: t/(4 m^2) of a Gaussian of slope m that is f at t.

    Its peak is f exp(y), and it reflects pi 4 m^2 cos(theta) times that. 1 where no lobe is as bright.
    """
    wanted = math.pi * t * max(brightness, 1e-300) / MOST
    if wanted >= math.exp(-1.0):
        return 1.0
    y = -math.log(wanted)
    for _ in range(50):
        y = math.log(y) - math.log(wanted)
    return y
