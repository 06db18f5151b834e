"""The points that a sampler may choose from, and how far they lie from what was measured.

Where no model is to be trusted, points cover: they tell a curve whatever it is. First gaps are divided evenly, finer
about the mirror direction. Then single points are taken, by what they lower the mean square error of the curves by for
their time. A gap may be divided: how far a curve departs from what neighbours say is told by leaving each point out. Or
a point is visited again, where curves are resolved and noise is what is left.

A covering is a first batch of up to 75 points; then even gaps, half as large within 15 degrees of the mirror
direction, for 70 % of the time that is left; then single points, by what they lower the mean square error of the
curves by for their time.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.acquisition.plan import Plan, Point, assess, canonical, count_reasons
from gonio.lab.acquisition.plan_tables import Sweep
from gonio.lab.rig import Pose
from gonio.lab.rig.description import RigDescription
from gonio.typing import Floats, TomlTable

THETA_I_DEG = (10.0, 30.0, 60.0, 75.0)
THETA_R_DEG = {"start": -85.0, "stop": 85.0, "step": 1.0}
NEAR_MIRROR_DEG = 5.0
"""Points at this angle from the mirror direction lie half as dense as there: lobes change with the half vector."""
FAR_DEG = 20.0
"""Far from the mirror direction the density is even: this many degrees count like the first `NEAR_MIRROR_DEG`."""
INCIDENCE_DEG = 15.0
"""Difference of angles of incidence that counts like `NEAR_MIRROR_DEG` at the mirror direction."""


@dataclass(frozen=True)
class Candidates:
    """Points that a rig can reach, with their poses."""

    points: tuple[Point, ...]
    poses: tuple[Pose, ...]
    left_out: tuple[str, ...]
    """What cannot be reached, and why, in words."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def directions(self) -> Directions:
        """Those of all points."""
        rows = [(p.theta_i_deg, p.phi_i_deg, p.theta_r_deg, p.phi_r_deg) for p in self.points]
        return Directions.from_degrees(*zip(*rows, strict=True))


def candidates(plan: Plan, description: RigDescription, given: TomlTable) -> Candidates:
    """The combinations of the keys theta_i_deg, theta_r_deg and dphi_deg that a rig can reach.

    In the plane of incidence always; with `dphi_deg` at these azimuths, too.

    Raises
    ------
    ConfigError
        A key is wrong, or the rig reaches none of the points.
    """
    where = f"{plan.source}: [adaptive]"
    in_plane = {"theta_i_deg": list(THETA_I_DEG), "theta_r_deg": THETA_R_DEG}
    in_plane |= {name: given[name] for name in in_plane if given.get(name) is not None}
    try:
        sweep = Sweep.model_validate(in_plane)
        azimuths = given.get("dphi_deg")
        beyond = sweep if azimuths is None else Sweep.model_validate(in_plane | {"dphi_deg": azimuths})
    except ValidationError as error:
        item = error.errors()[0]
        key = ".".join(str(part) for part in item["loc"])
        said = str(item["msg"]).removeprefix("Value error, ")
        raise ConfigError(f"{where} {key + ': ' if key else ''}{said}") from None
    points = [canonical(i, 0.0, r, 180.0) for i in sweep.theta_i_deg for r in sweep.theta_r_deg]
    outside = [d for d in beyond.dphi_deg or () if d % 180.0]
    points += [canonical(i, 0.0, r, d) for i in beyond.theta_i_deg for d in outside for r in beyond.theta_r_deg]
    found = assess(replace(plan, points=tuple(dict.fromkeys(points)), adaptive=None), description)
    reached = [(one.point, one.pose) for one in found if one.pose is not None]
    out = tuple(f"{count} {flag}: {cause}" for (flag, cause), count in count_reasons(found))
    if not reached:
        raise ConfigError(f'{where} the rig "{description.name}" reaches none of the candidates: {"; ".join(out)}')
    return Candidates(tuple(p for p, _ in reached), tuple(pose for _, pose in reached), out)


def half_angles(description: RigDescription) -> tuple[float, float]:
    """Half-angles of the cones of lamp and lens [rad]."""
    return math.radians(description.lamp.half_angle_deg), math.radians(description.camera.lens_half_angle_deg)


def read(description: RigDescription, poses: Sequence[Pose]) -> tuple[Pose, ...]:
    """What the encoders will show at poses: whole steps, the nearest to the goals."""
    axes = {
        name: (math.radians(axis.encoder_step_deg), math.radians(axis.zero_offset_deg) * axis.zero_offset_known)
        for name, axis in description.axes().items()
        if axis.encoder_step_deg > 0.0
    }
    return tuple(
        replace(pose, **{n: round((getattr(pose, n) + at) / step) * step - at for n, (step, at) in axes.items()})
        for pose in poses
    )


def places(directions: Directions) -> Floats:
    """Coordinates (n, 3) in which points should lie about evenly: dense at the mirror direction, wider away from it."""
    omega = directions.from_mirror
    size = np.linalg.norm(omega, axis=-1)
    near, far = (2.0 * np.sin(0.5 * np.radians(angle)) for angle in (NEAR_MIRROR_DEG, FAR_DEG))
    scale = np.arcsinh(size / near) / np.maximum(size, 1e-12) + 1.0 / far
    # in the frame of the plane of incidence: along it and across it
    phi = directions.phi_i
    along = omega[..., 0] * np.cos(phi) + omega[..., 1] * np.sin(phi)
    across = omega[..., 1] * np.cos(phi) - omega[..., 0] * np.sin(phi)
    # signed by the side of the mirror direction; the length is that of the chord
    signed = np.copysign(np.hypot(along, omega[..., 2]), along)
    return np.stack([signed * scale, across * scale, (np.degrees(directions.theta_i) / INCIDENCE_DEG)], axis=-1)


def nearby(at: Floats, among: Floats, brdf: Floats, u: Floats) -> Floats:
    """About the BRDF [1/sr] at places (n, 3): the geometric mean of the three values nearest to each, the nearer more.

    Values below their uncertainty count as that.
    """
    from scipy.spatial import cKDTree

    distance, which = cKDTree(among).query(at, k=list(range(1, min(3, len(among)) + 1)))
    weights = 1.0 / np.maximum(distance, 1e-3) ** 2
    logarithm = np.log(np.maximum(brdf, np.maximum(u, 1e-12)))[which]
    return np.asarray(np.exp((weights * logarithm).sum(axis=1) / weights.sum(axis=1)))


def spread(
    at: Floats, count: int, begin: Sequence[int], among: Floats | None = None, cost: Floats | None = None
) -> list[int]:
    """Places (n, 3) that cover the others: first `begin`, then the one that is farthest from those chosen, in turn
    [Johnson1990].

    Other places `among` (m, 3) count as chosen. With a `cost` (n,) the square of the distance over it counts. Of equals
    the first one is taken, and none that lies on another.
    """
    from scipy.spatial import cKDTree

    chosen = list(begin[:count])
    there = at[chosen] if among is None else np.concatenate([among, at[chosen]])
    distance = np.asarray(cKDTree(there).query(at)[0]) if len(there) else np.full(len(at), np.inf)
    while len(chosen) < min(count, len(at)):
        score = np.minimum(distance, 1e3) ** 2 / (1.0 if cost is None else cost)
        k = int(np.argmax(np.round(score, 12)))
        if score[k] <= 1e-12:
            break
        chosen.append(k)
        distance = np.minimum(distance, np.linalg.norm(at - at[k], axis=1))
    return chosen


def snake(points: list[Point]) -> list[int]:
    """An order that saves travel: by incidence and azimuth, to and fro over the angle of reflection."""
    return [
        k
        for number, line in enumerate(curves(points))
        for k in sorted(line, key=lambda k: signed_deg(points[k]), reverse=bool(number % 2))
    ]


def _curve(p: Point) -> tuple[float, float]:
    return p.theta_i_deg, (p.phi_r_deg - p.phi_i_deg) % 180.0


def signed_deg(p: Point) -> float:
    """The angle of reflection [deg], positive on the side of the mirror direction."""
    return p.theta_r_deg if 90.0 < (p.phi_r_deg - p.phi_i_deg) % 360.0 <= 270.0 else -p.theta_r_deg


def from_mirror_deg(p: Point) -> float:
    """How far a point lies from the mirror direction along its curve [deg]; 180 where that is not in it."""
    return abs(signed_deg(p) - p.theta_i_deg) if _curve(p)[1] % 180.0 == 0.0 else 180.0


def curves(points: Sequence[Point]) -> list[list[int]]:
    """The points of each incidence and azimuth, by the angle of reflection."""
    lines: dict[tuple[float, float], list[int]] = {}
    for k, p in enumerate(points):
        lines.setdefault(_curve(p), []).append(k)
    return [sorted(lines[of], key=lambda k: signed_deg(points[k])) for of in sorted(lines)]


def fill(
    points: Sequence[Point], measured: Collection[int], step_deg: float, near_mirror_deg: float = 0.0
) -> list[int]:
    """Points that are still to be measured so that no curve has a step larger than this: gaps are divided evenly.

    Both ends of a curve are taken, and those beside what is missing in it, such as the cone around retro. Closer to the
    mirror direction than `near_mirror_deg` the steps are half as large.
    """
    out: list[int] = []
    for line in curves(points):
        at = np.array([signed_deg(points[k]) for k in line])
        dense = np.where([from_mirror_deg(points[k]) < near_mirror_deg for k in line], 2.0, 1.0)
        along = np.concatenate([[0.0], np.cumsum(0.5 * (dense[1:] + dense[:-1]) * np.diff(at))])
        steps = np.diff(at)
        missing = np.flatnonzero(steps > 1.5 * np.median(steps)) if steps.size else np.zeros(0, dtype=int)
        ends = {0, len(line) - 1, *missing.tolist(), *(missing + 1).tolist()}
        there = sorted(ends | {n for n, k in enumerate(line) if k in measured})
        wanted = ends.copy()
        for a, b in itertools.pairwise(there):
            even = np.linspace(along[a], along[b], math.ceil((along[b] - along[a]) / step_deg - 1e-9) + 1)
            wanted |= {a + int(np.argmin(abs(along[a : b + 1] - x))) for x in even}
        out += [line[n] for n in sorted(wanted) if line[n] not in measured]
    return out


STEPS_DEG = tuple(60.0 / 1.05**k for k in range(120))
"""Steps that a covering may have."""
FINER_DEG = 15.0
"""Closer to the mirror direction the steps are half as large: lobes lie there."""
EVENLY = 0.7
"""Share of a covering's time for points that divide gaps evenly; the rest is for points where curves err most."""
SAME_PLACE = 0.03
"""Distance (of `places`) from a measured candidate within which others count as measured: about an encoder's step."""
ENOUGH = 1e-3
"""Relative errors below this are not made smaller: the reference is not known as well."""
OF_NOISE = 0.7
"""Mean variance of a curve through noisy points, in units of the points' own: between them some of it averages out."""


@dataclass(frozen=True)
class CandidateCurves:
    """What was measured at candidates."""

    points: Sequence[Point]
    visits: npt.NDArray[np.intp]
    """Of each candidate."""
    logarithm: Floats
    """Mean logarithm of the values; 0 without a visit."""
    u: Floats
    """Relative standard uncertainty of one visit by noise: as it was, or as it is expected."""

    @classmethod
    def of(
        cls, points: Sequence[Point], at: Floats, among: Floats, brdf: Floats, u: Floats, expected: Floats
    ) -> CandidateCurves:
        """From values (m,) at places `among` (m, 3), candidates being at places `at` (n, 3).

        `u` [1/sr] is the noise of the values, `expected` the relative noise of a visit to each candidate (n,).
        """
        visits, total, squares = np.zeros(len(at), dtype=np.intp), np.zeros(len(at)), np.zeros(len(at))
        if len(among):
            from scipy.spatial import cKDTree

            distance, which = cKDTree(at).query(among)
            here = which[distance < SAME_PLACE]
            level = np.maximum(brdf, np.maximum(u, 1e-12))[distance < SAME_PLACE]
            np.add.at(visits, here, 1)
            np.add.at(total, here, np.log(level))
            np.add.at(squares, here, (u[distance < SAME_PLACE] / level) ** 2)
        times = np.maximum(visits, 1)
        own = np.where(visits > 0, np.sqrt(squares / times), np.minimum(expected, 1.0))
        return cls(points, visits, total / times, np.maximum(own, 1e-6))

    def departures(self, line: list[int]) -> Floats:
        """Squares of the relative departure of the points of a curve from what the others there say, less noise."""
        from scipy.interpolate import PchipInterpolator

        x, y = np.array([signed_deg(self.points[k]) for k in line]), self.logarithm[line]
        variance = self.u[line] ** 2 / self.visits[line]
        out = np.zeros(len(line))
        for n in range(1, len(line) - 1) if len(line) > 3 else ():
            near = [m for m in range(max(n - 3, 0), min(n + 4, len(line))) if m != n]
            predicted = float(PchipInterpolator(x[near], y[near])(x[n]))
            share = (x[n] - x[n - 1]) / (x[n + 1] - x[n - 1])
            noise = variance[n] + (1.0 - share) ** 2 * variance[n - 1] + share**2 * variance[n + 1]
            out[n] = max((y[n] - predicted) ** 2 - noise, 0.0)
        if len(line) > 3:
            out[0], out[-1] = out[1], out[-2]
        return out


def cover_evenly(
    known: CandidateCurves, open_to: Sequence[int], fits: Callable[[list[int]], bool]
) -> tuple[list[int], bool]:
    """The candidates of the smallest even step that fits, and whether a smaller step would take more of them."""
    some = [known.points[k] for k in open_to]
    seen = {n for n, k in enumerate(open_to) if known.visits[k]}

    def with_steps(number: int) -> list[int]:
        return [open_to[n] for n in fill(some, seen, STEPS_DEG[number], FINER_DEG)]

    fine = bisect_left(range(len(STEPS_DEG)), True, key=lambda n: not fits(with_steps(n)))
    batch = with_steps(fine - 1) if fine else []
    finer = with_steps(fine) if fine < len(STEPS_DEG) else []
    if not batch and finer:  # not all of them: some, evenly
        for count in range(len(finer), 0, -1):
            part = [finer[k] for k in np.linspace(0, len(finer) - 1, count).round().astype(int)]
            if fits(part):
                return part, True
    return batch, bool(finer)


def cover_by_errors(
    known: CandidateCurves, open_to: Sequence[int], cost: Floats, fits: Callable[[list[int]], bool]
) -> list[int]:
    """Candidates, some of them more than once, that lower the mean square relative error of the curves most for their
    time; as many as fit.

    Parameters
    ----------
    known
        What was measured.
    open_to
        Candidates that may be taken.
    cost
        Of each candidate [s].
    fits
        Whether a batch fits into the time.
    """
    allowed = set(open_to)
    lines = [_Line.of(known, line, allowed) for line in curves(known.points)]
    lines = [line for line in lines if len(line.there) > 1]
    best = [line.best(cost) for line in lines]
    batch: list[int] = []
    while best:
        n = max(range(len(best)), key=lambda m: best[m][0])
        score, chosen = best[n]
        if score <= 0.0:
            break
        batch.append(chosen)
        if len(batch) % 8 == 0 and not fits(batch):
            break
        lines[n].take(chosen)
        best[n] = lines[n].best(cost)
    while batch and not fits(batch):
        batch.pop()
    return batch


@dataclass
class _Line:
    """One curve while points are taken."""

    line: list[int]
    """Candidates, by the angle of reflection."""
    x: Floats
    allowed: npt.NDArray[np.bool_]
    visits: Floats
    variance: Floats
    """Of one visit to each."""
    there: list[int]
    """Candidates that were visited or are taken, as numbers in `line`."""
    squares: Floats
    """Square of the relative error in the middle of the gap after each point, over the fourth power of the gap."""

    @classmethod
    def of(cls, known: CandidateCurves, line: list[int], allowed: set[int]) -> _Line:
        x = np.array([signed_deg(known.points[k]) for k in line])
        there = [n for n, k in enumerate(line) if known.visits[k]]
        out = np.zeros(len(line))
        if len(there) > 1:
            found, at = known.departures([line[n] for n in there]), x[there]
            across = np.concatenate([at[2:3] - at[:1], at[2:] - at[:-2], at[-1:] - at[-3:-2]])
            curvature = found / np.maximum(across, 1e-9) ** 4 if len(there) > 3 else np.full(len(there), 0.0)
            ends = np.maximum(curvature[:-1], curvature[1:])
            for n, (a, b) in enumerate(itertools.pairwise(there)):
                out[a:b] = ends[n]
        free = np.array([k in allowed for k in line])
        return cls(line, x, free, known.visits[line].astype(float), known.u[line] ** 2, there, out)

    def best(self, cost: Floats) -> tuple[float, int]:
        """What a second brings at most, and where."""
        at = np.array(self.there)
        x, gap = self.x[at], np.diff(self.x[at])
        width = 0.5 * (np.concatenate([[0.0], gap]) + np.concatenate([gap, [0.0]]))
        times, variance = self.visits[at], self.variance[at]
        of_noise = np.where(variance / times > ENOUGH**2, OF_NOISE * variance / (times * (times + 1.0)) * width, 0.0)
        of_noise = np.where(self.allowed[at], of_noise, 0.0) / cost[[self.line[n] for n in at]]
        best = max(zip(of_noise.tolist(), at.tolist(), strict=True))
        error = np.minimum(self.squares[at[:-1]] * gap**4, 1.0)
        for n in np.flatnonzero((error > ENOUGH**2) & (np.diff(at) > 1)):
            inside = np.arange(at[n] + 1, at[n + 1])
            inside = inside[self.allowed[inside]]
            if inside.size:
                middle = int(inside[np.argmin(np.abs(self.x[inside] - 0.5 * (x[n] + x[n + 1])))])
                best = max(best, (float(error[n] * gap[n] / cost[self.line[middle]]), middle))
        return best[0], self.line[best[1]]

    def take(self, candidate: int) -> None:
        """One more visit."""
        n = self.line.index(candidate)
        if self.visits[n] == 0.0:
            self.there = sorted([*self.there, n])
        self.visits[n] += 1.0
