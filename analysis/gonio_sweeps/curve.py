"""The sampler "curve": points for the BRDF over the angle of reflection, without a model of the sample.

Each batch follows from a Gaussian process (`gonio.models.gaussian_process`) given all values so far. Its
points are those that are expected to lower the variance of the whole curve most for their rig time. A share of them
covers: they look where nothing was measured. docs/adaptive_sweeps.md has the method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import field_validator

from gonio.config import Positive, Strict
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Choice
from gonio.lab.reduction.angle_errors import angle_axes, zero_uncertainties
from gonio.lab.rig.description import RigDescription
from gonio.models.gaussian_process import ENOUGH
from gonio.typing import Floats, JsonObject
from gonio_sweeps import expected
from gonio_sweeps.candidates import Candidates, candidates, curves, half_angles, signed_deg, spread
from gonio_sweeps.online import GrowingValues, Online
from gonio_sweeps.posterior import FEWEST, AngleErrors, Before, Posterior
from gonio_sweeps.sampler import BudgetSampler, highest, short

COVERING = 5
"""One of this many chosen points goes where the curve is measured least, whatever the process expects there."""
STEEP_TURNS = (1, 3)
"""Of every `COVERING` points so many go into the steepest gap, as long as there is one."""
STEEP = 0.7
"""A gap is steep where the logarithm of the curve changes by more from the nearest point on."""
DONE = 0.05
"""Weight of a place that is known well enough, beside one that is not."""
WORST = 400.0
"""Largest weight of a place, over that of one that is just not known well enough."""


@dataclass(frozen=True)
class CurveGrid:
    """Directions that may be measured, and over which curves are judged."""

    directions: Directions
    weight: Floats
    """What each stands for: its share of the curves' angle, or of the hemisphere."""
    position: Floats
    """(n, 3): places whose distance tells how far a direction lies from measured ones [rad]."""

    @classmethod
    def of(cls, d: Directions, weight: Floats) -> CurveGrid:
        """From directions."""
        return cls(d, weight / weight.sum(), positions(d))

    def uncovered(self, measured: Directions) -> Floats:
        """Distance of every place from the nearest measured direction [rad]."""
        return np.asarray(np.sqrt(((self.position[:, None] - positions(measured)) ** 2).sum(-1)).min(axis=1))


def positions(d: Directions) -> Floats:
    """Detector directions as points in the plane; incidences further apart than anything within one."""
    dphi = d.phi_r - d.phi_i
    theta_i, theta_r = np.broadcast_to(d.theta_i, d.shape), np.broadcast_to(d.theta_r, d.shape)
    return np.stack(
        [theta_r * np.cos(dphi), theta_r * np.sin(dphi), 10.0 * theta_i, 10.0 * np.broadcast_to(d.phi_i, d.shape)], -1
    )


def batch(
    known: Sequence[Posterior],
    noise: Sequence[Floats],
    grid: CurveGrid,
    goal: float,
    cost: Floats,
    count: int,
    done: int,
    floor: float,
) -> tuple[list[int], list[Floats], list[int]]:
    """The next places of a grid, by the expected fall of the curves' variance per cost.

    Each place is taken as measured before the next one is chosen: what a value will tell does not depend on the value,
    but for the kernel's parameters.

    Parameters
    ----------
    known, noise
        For each band: what is known, and the relative standard uncertainty that every place would be measured with.
    goal
        Relative standard uncertainty that is asked for.
    cost
        Of every place.
    count, done
        How many places; and how many points there are already.
    floor
        Of the largest value: below it uncertainties count relative to this value.

    Returns
    -------
    tuple
        The places in the order of their choice; for each band the relative standard uncertainty of every place now;
        those of the chosen places that cover.
    """
    states = [_State.of(p, u, grid, goal, floor) for p, u in zip(known, noise, strict=True)]
    u_rel = [s.u_rel for s in states]
    chosen, covers = list[int](), list[int]()
    far = grid.uncovered(known[0].directions)
    slope = np.max([p.steepness(grid.directions, floor) for p in known], axis=0)
    for k in range(count):
        turn = (done + k) % COVERING
        # a steep gap is measured whatever the process expects: it easily takes a flank for that of another incidence
        steep = turn in STEEP_TURNS and (far * slope).max() > STEEP
        if steep or (turn == COVERING - 1 and far.max() > 0):
            best = int(np.argmax(np.round(far * slope if steep else far, 9)))
            covers.append(best)
        else:
            best = highest(np.sum([s.gain(grid.weight) for s in states], axis=0) / cost)
        chosen.append(best)
        for s in states:
            s.take(best)
        far = np.minimum(far, np.sqrt(((grid.position - grid.position[best]) ** 2).sum(-1)))
    return chosen, u_rel, covers


@dataclass
class _State:
    """What is not known yet of one band, at the places of a grid."""

    covariance: Floats
    noise: Floats
    """Variance that a point would have."""
    scale: Floats
    """Factor from the scale of the process to relative uncertainty."""
    goal: float

    @classmethod
    def of(cls, p: Posterior, noise: Floats, grid: CurveGrid, goal: float, floor: float) -> _State:
        f, covariance, variance = p.expected(grid.directions, noise)
        size = np.maximum(np.abs(f), floor * float(np.abs(p.brdf).max()))
        return cls(covariance, variance, 1.0 / (p.link.slope(f) * size), goal)

    @property
    def u_rel(self) -> Floats:
        """Relative standard uncertainty of every place."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) * self.scale)

    def gain(self, weight: Floats) -> Floats:
        """For every place: the fall of the weighted variance, were it measured."""
        u = self.u_rel
        share = weight * np.where(u > self.goal, np.minimum((u / self.goal) ** 2, WORST), DONE)
        # in units of what is there, where that is far above the goal: a place that nothing is known of is not all
        down = self.covariance**2 * (share * self.scale**2 / np.maximum(u, self.goal) ** 2)[:, None]
        return np.asarray(down.sum(axis=0) / (np.diag(self.covariance) + self.noise))

    def take(self, k: int) -> None:
        """Lower the covariance as a value measured at a place does, whatever it is."""
        column = self.covariance[:, k].copy()
        self.covariance -= np.outer(column, column) / (column[k] + self.noise[k])


FIRST, FURTHER = 12, 7
"""Points of the first covering: of one angle of incidence, and of each further one, in a plane."""
GROWTH = 0.25
"""Points of a batch, as a part of the points so far."""
SMALLEST, LARGEST = 5, 25
"""Points of a batch, at least and at most: each ends with a visit to the reference."""
NEAR_MIRROR_DEG = (2.0, 3.0, 4.0, 5.0, 6.0)
IN_CONES = (0.25, 0.5, 0.75, 1.0, 1.25)
"""Beside a range of theta_r, these offsets from the mirror direction may be measured: lobes are narrow there. The
second ones are parts of the angle at which the lens sees no more of the lamp's mirror image."""
FLANK = 0.5
"""The same unit: the first points have one on either side of each mirror direction, which tell of a spike."""
MOST_CANDIDATES = 1500
"""The process holds the covariance of all: 2 s a batch on one core."""
DEFAULT_GOAL = 0.005
"""Without `u_rel`: what is known so well counts little."""


class CurveSettings(Strict):
    """The keys of `[adaptive]` with how = "curve", beside `how` and `budget_h`."""

    u_rel: Positive | None = None
    """Relative standard uncertainty wanted of the curve everywhere, of what further points can improve."""
    floor: Positive = 1e-3
    """Part of the largest value: below it `u_rel` counts relative to this value."""
    most_points: int | None = None
    """Most points of the whole run. Where it is stated, points are chosen for what each tells, whatever its time."""
    theta_i_deg: Any = None
    theta_r_deg: Any = None
    dphi_deg: Any = None
    """The candidates, as in a `[[sweep]]`."""

    @field_validator("most_points")
    @classmethod
    def _enough(cls, value: int | None) -> int | None:
        if value is not None and value < FIRST:
            raise ValueError(f"{value} points; a curve needs at least {FIRST}")
        return value

    @field_validator("floor")
    @classmethod
    def _part(cls, value: float) -> float:
        if value >= 1.0:
            raise ValueError(f"{value:g} of the largest value; it lies below 1")
        return value


class CurveSampler(BudgetSampler[CurveSettings]):
    """Chooses points that tell the curves of a plan.

    Raises
    ------
    ConfigError
        A key of `[adaptive]` is wrong.
    """

    keys = CurveSettings

    def __init__(self, plan: Plan, description: RigDescription) -> None:
        super().__init__(plan, description)
        self.candidates = _with_mirror(plan, description, self._settings.model_dump())
        if len(self.candidates) > MOST_CANDIDATES:
            raise ConfigError(
                f"{self._where} theta_i_deg, theta_r_deg and dphi_deg make {len(self.candidates)} candidates; "
                f"at most {MOST_CANDIDATES}: take larger steps"
            )
        self._online = [Online(band) for band in self._bands]
        self._directions = self.candidates.directions
        self._grid = CurveGrid.of(self._directions, _weights(self.candidates.points))
        self._errors = _angle_errors(description)
        self._cones = half_angles(description)
        self.first_rows = self._covering()
        self._require_budget()

    def about(self) -> list[str]:
        """What it will do, a line each."""
        s, out = self._settings, self.candidates.left_out
        target = "as well as the budget allows" if s.u_rel is None else f"{100 * s.u_rel:.3g} % everywhere"
        most = "" if s.most_points is None else f"; at most {s.most_points} points"
        left = f" ({'; '.join(out)})" if out else ""
        return [
            f"target (relative standard uncertainty of the curve): {target}",
            f"budget: {self._budget_s / 3600.0:g} h of rig time for the whole run{most}",
            f"candidates: {len(self.candidates)} points that the rig can reach{left}",
            f"batches of {SMALLEST} to {LARGEST} points; one in {COVERING} covers",
        ]

    # ---- what is measured first ----

    def _covering(self) -> list[int]:
        incidences = len({(p.theta_i_deg, p.phi_i_deg) for p in self.candidates.points})
        count = (FIRST + FURTHER * (incidences - 1)) * (1 if self._settings.dphi_deg is None else 2)
        if self._settings.most_points is not None:
            count = min(count, max(FIRST, self._settings.most_points // 2))
        count = min(count, len(self.candidates))
        return self._ordered(spread(self._places, count, self._at_mirror()))

    def _at_mirror(self) -> list[int]:
        """For each angle of incidence the candidate nearest to the mirror direction, and one on either side of it."""
        d = self._directions
        flank, out = FLANK * sum(self._cones), []
        for theta_i in np.unique(d.theta_i):
            for goal in (0.0, flank, -flank):
                own = np.flatnonzero((d.theta_i == theta_i) & d.in_plane)
                away = np.abs(d.signed[own] - theta_i - goal)
                if own.size and (not goal or away.min() < 0.5 * flank):
                    out.append(int(own[np.argmin(np.round(away, 9))]))
        return list(dict.fromkeys(out))

    # ---- what is measured next ----

    def next(self, run: Run) -> Choice:
        """See `gonio.lab.acquisition.sampling.Sampler`."""
        values = [online.values(run) for online in self._online]
        before = run.batches[-1].why if run.batches else None
        return self.decided(values, expected.spent_s(self.durations, run), before)

    def known(self, values: GrowingValues, before: JsonObject | None = None, band: int = 0) -> Posterior:
        """What the values of one band tell; `before` is why the choice before was made, `band` its number there."""
        kernels, forms = ((before or {}).get(name, []) for name in ("kernel", "form"))
        last = None
        if band < len(kernels):
            last = Before(np.array(kernels[band]), *(forms[band] if band < len(forms) else ()))
        return Posterior(
            values.directions,
            values.brdf,
            values.u_noise,
            np.stack(list(values.common.values()), axis=1) if values.common else np.zeros((len(values), 0)),
            self._errors,
            last,
            self._cones,
        )

    def decided(self, values: Sequence[GrowingValues], spent_s: float, before: JsonObject | None = None) -> Choice:
        """The next batch; it follows from the arguments alone.

        Parameters
        ----------
        values
            Of every band.
        spent_s
            Rig time that they took.
        before
            What the choice before this one gave as `why`.
        """
        usable = [v for v in values if len(v) >= FEWEST]
        left_s, n = self._budget_s - spent_s, max((len(v) for v in values), default=0)
        why: JsonObject = {"spent_s": round(spent_s, 1), "values": n}
        if not usable:
            return Choice((), why, f"enough: only {n} points could be used; a curve needs {FEWEST}")
        same = before is not None and len(before.get("kernel", ())) == len(usable)
        known = [self.known(v, before if same else None, k) for k, v in enumerate(usable)]
        count, most = min(max(round(GROWTH * n), SMALLEST), LARGEST), self._settings.most_points
        seen = [self._expected.visits(p.brdf_at(self._directions)) for p in known]
        seconds = np.mean([s.seconds for s in seen], axis=0)
        cost = seconds + self._ways_s
        if most is not None:
            count, cost = min(count, most - n), np.ones(len(seconds))
        picked, u_rel, covers = batch(
            known, [s.u_rel for s in seen], self._grid, self._settings.u_rel or DEFAULT_GOAL, cost, max(count, 0), n,
            self._settings.floor,
        )  # fmt: skip
        worst = max(float(u.max()) for u in u_rel)
        where = self.candidates.points[int(np.argmax(np.max(u_rel, axis=0)))]
        misfit = max(p.misfit for p in known)
        why |= {"u_rel": short(worst), "median_u_rel": short(float(np.median(u_rel))), "misfit": short(misfit)}
        why["kernel"] = [[round(float(x), 4) for x in p.parameters] for p in known]
        if n > ENOUGH:
            why["form"] = [p.form for p in known]
        said = f"curve known to {100 * worst:.2g} % at worst (theta_i = {where.theta_i_deg:g}, {_place(where)})"
        if self._settings.u_rel is not None and worst <= self._settings.u_rel:
            return Choice((), why, f"enough: {said}", met=True)
        if count <= 0:
            return Choice((), why, f"enough: {said}; all {n} points are taken")
        while picked and self._batch_s(picked, seconds) > left_s:
            picked = picked[:-1]
        if not picked:
            return Choice((), why, f"enough: the budget is spent; {said}")
        ordered = self._ordered(picked)
        why |= {"cover": sum(k in covers for k in ordered), "batch_s": round(self._batch_s(ordered, seconds), 1)}
        minutes = f"{spent_s / 60:.3g} of {self._budget_s / 60:.3g} min"
        points = tuple(self.candidates.points[k] for k in ordered)
        return Choice(points, why, f"{said}; {len(ordered)} points next; {minutes}")


def _with_mirror(plan: Plan, description: RigDescription, given: JsonObject) -> Candidates:
    """The candidates of the keys, and where theta_r is a range those around the mirror direction too."""
    found = candidates(plan, description, given)
    if isinstance(given["theta_r_deg"], list):
        return found
    reached = dict(zip(found.points, found.poses, strict=True))
    reach = math.degrees(sum(half_angles(description)))
    offsets = (0.0, *(part * reach for part in IN_CONES), *(d for d in NEAR_MIRROR_DEG if d > 1.5 * reach))
    for theta_i in sorted({p.theta_i_deg for p in found.points}):
        largest = max(p.theta_r_deg for p in found.points if p.theta_i_deg == theta_i)
        near = {theta_i + s * d for d in offsets for s in (1, -1) if abs(theta_i + s * d) <= largest}
        more = candidates(plan, description, {"theta_i_deg": [theta_i], "theta_r_deg": sorted(near)})
        reached |= {p: pose for p, pose in zip(more.points, more.poses, strict=True) if p not in reached}
    return Candidates(tuple(reached), tuple(reached.values()), found.left_out)


def _weights(points: Sequence[Point]) -> Floats:
    """What each point stands for: half the way to its neighbours on either side [deg]; out of the plane times sine."""
    out = np.ones(len(points))
    for line in curves(points):
        if len(line) > 1:
            out[line] = np.abs(np.gradient([signed_deg(points[k]) for k in line]))
    if any((p.phi_r_deg - p.phi_i_deg) % 180.0 for p in points):
        out *= np.sin(np.radians([max(p.theta_r_deg, 1.0) for p in points]))
    return out


def _place(p: Point) -> str:
    dphi = (p.phi_r_deg - p.phi_i_deg) % 360.0
    if dphi % 180.0 == 0.0:
        return f"theta_r = {signed_deg(p):g} deg"
    return f"theta_r = {p.theta_r_deg:g}, dphi = {dphi:g} deg"


def _angle_errors(description: RigDescription) -> AngleErrors:
    """Uncertainty of the angles of the rig's worst axis: one number for all directions."""
    axes = angle_axes(description)
    read = max(math.hypot(a.encoder_step_deg / math.sqrt(12.0), a.encoder_noise_deg) for a in axes.values())
    return AngleErrors(math.radians(read), max(zero_uncertainties(description).values(), default=0.0))


SAMPLER = CurveSampler
