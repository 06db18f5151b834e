"""The chooser "parameters": points for the parameters of a named model, and for whether it is the right one.

Each batch follows from a fit to all values so far. Most of its points are those that tell most of the parameters for
their rig time (`gonio_sweeps.fisher`), on average over parameters that the values allow. The others cover: they look
where nothing was measured. Where the residuals of the fit say that the model is wrong (`gonio_sweeps.lack_of_fit`), all
further points cover. docs/adaptive_sweeps.md has the method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from gonio_analysis.commands import read_ior
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import alone
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM, Observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import refine
from gonio_analysis.fitting.value_covariance import Covariance
from pydantic import Field, field_validator

from gonio.acquisition.choosing import Choice
from gonio.acquisition.duration import Durations
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.acquisition.schedule import reference_pose
from gonio.config import Strict, parse
from gonio.errors import ConfigError, DataError
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.reduction import brdf as reduction
from gonio.rig import Pose, kinematics
from gonio.rig.description import Band, Positive, RigDescription
from gonio.typing import Floats
from gonio_sweeps import covering, expected, fisher, lack_of_fit
from gonio_sweeps.candidates import candidates, from_nearest, nearby, places, read, snake, spread
from gonio_sweeps.online import Online, Values

if TYPE_CHECKING:
    import pandas as pd

FIRST = 5
"""Points of the first covering, for each parameter; not fewer than `FEWEST`, and not more than `MOST` altogether."""
FEWEST, MOST = 12, 30
AROUND_MIRROR_DEG = 45.0
"""The first points lie so close to the mirror direction: farther away metals are dark, and a point takes minutes."""
GROWTH = 1.0
"""A batch adds this part of the points so far: later ones are chosen with better knowledge."""
SMALLEST, LARGEST = 12, 25
"""Points of a batch, at least and at most: each ends with a visit to the reference."""
COVERS = ("covering", "filling")
"""Modes of batches that only cover: the model is wrong, or no point tells more of its parameters."""
COVERING = 0.2
"""Part of a batch that covers, whatever the model says."""
OUT_OF_REACH = 0.5
"""The same where the targets are out of reach of the budget."""
CHEAP = 0.25
"""What is chosen for a model costs as much as this part of the candidates at most, as a rule."""
DEAREST = 0.25
"""Part of the time that is left which one point may take, at most."""
HALF, LATER, LAST = 0.5, 0.9, 4
"""Part of the time that is left which a batch may take that lowers the curves' errors; and from which on it may take
more: levels are known then."""
REPEATS = 3
"""Visits to one point in a batch, at most: what a repeat cannot tell is that the model is wrong beside it."""
SEARCHES, MANY = 6, 30
"""Short searches that a fit begins with; and before a model is found wrong. Chosen points lie in a few places, where
lobes of other widths may look alike."""
DRAWS = 4
"""Parameters that are drawn from what the fit leaves open, beside its own."""
OTHER_MODES = 4
"""Starting points from which other solutions are looked for."""
ALLOWED = 12.0
"""Solutions whose chi-square is larger than the best one's by less than this are not ruled out."""
APART = 5.0
"""Solutions differ where a parameter does by so many standard uncertainties."""
AIM = 0.985
"""A batch ends where it is expected to bring the uncertainties to this part of their targets."""
CLOSE = 1.5
"""Where the quick fit's uncertainties are within this factor of their targets the run is reduced and fitted in full, as
`gonio fit` will do it: its uncertainties decide."""
WORST = 3.0
"""A full reduction's uncertainties count as no more than so many times the quick fit's, and as no less than its part.
"""
EVERY_S = 3.0
"""Counted for every point beside its frames and its way [s]: a visit is work for the rig, however bright the point."""
LEAST_GAIN = 2e-4
"""Where no point lowers the logarithm of the uncertainties by more, none adds anything."""


class Settings(Strict):
    """The keys of `[adaptive]` with how = "parameters", beside `how` and `budget_h`."""

    model: str
    """As `gonio fit --model`."""
    ior: str | float | tuple[float, float] | None = None
    """A material, n, or [n, k]; or text, as in `gonio fit --ior 1.37+7.6j`."""
    fix: dict[str, str | float] = Field(default_factory=dict)
    free: tuple[str, ...] = ()
    slopes: int = 1
    wavelength_nm: Positive | None = None
    """Where the plan has several: the one that the model is fitted at; by default the nearest to 550 nm."""
    u: dict[str, Positive] = Field(default_factory=dict)
    """Standard uncertainty wanted of each parameter, in its own unit."""
    u_rel: dict[str, Positive] = Field(default_factory=dict)
    """The same, relative to its value."""
    theta_i_deg: Any = None
    theta_r_deg: Any = None
    dphi_deg: Any = None
    """The candidates, as in a `[[sweep]]`."""

    @field_validator("ior", mode="before")
    @classmethod
    def _index(cls, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError('give a material as "Al", a number n, [n, k], or text as "1.37+7.6j"')
        return tuple(value) if isinstance(value, list) else value

    @property
    def index(self) -> complex | str | None:
        """What `ior` stands for."""
        if self.ior is None or isinstance(self.ior, str):
            return read_ior(self.ior)
        n, k = self.ior if isinstance(self.ior, tuple) else (self.ior, 0.0)
        return read_ior(f"{n:.17g}{k:+.17g}j")


@dataclass(frozen=True)
class Known:
    """What a fit to all values so far says."""

    result: FitResult
    data: Observations
    sights: fisher.Sights
    rows: fisher.Rows
    modes: list[tuple[Floats, float]]
    """Solutions that are not ruled out, as points of the search scale, with their weights; the best one first."""
    test: lack_of_fit.Verdict
    worse: float = 1.0
    """The uncertainties of a full reduction and fit, over those of the quick one: targets are harder by so much."""


class Plugin:
    """What the entry point names."""

    def open(self, plan: Plan, description: RigDescription) -> Parameters:
        """The chooser of a plan on a rig; see `gonio.acquisition.choosing.ChooserPlugin`."""
        return Parameters(plan, description)


class Parameters:
    """Chooses points that tell the parameters of a model.

    Raises
    ------
    ConfigError
        A key of `[adaptive]` is wrong.
    """

    def __init__(self, plan: Plan, description: RigDescription) -> None:
        assert plan.adaptive is not None
        where = f"{plan.source}: [adaptive]"
        self._settings = parse(Settings, plan.adaptive.own, where)
        self._description = description
        self._budget_s = 3600.0 * plan.adaptive.budget_h
        try:
            self._problem = pose(self._request)
        except ConfigError as error:
            raise ConfigError(f"{where} {str(error).removeprefix('--')}") from None
        for key, given in (("u", self._settings.u), ("u_rel", self._settings.u_rel)):
            for name in given:
                if name not in self._problem.free:
                    raise ConfigError(
                        f"{where} {key}: {name} of {self._settings.model} is not fitted; "
                        f"fitted are {', '.join(self._problem.free)}"
                    )
        twice = sorted(self._settings.u.keys() & self._settings.u_rel.keys())
        if twice:
            raise ConfigError(f"{where} {twice[0]} has a target in u and one in u_rel; keep one of them")
        self._bands = plan.bands(description)
        self._band = self._fitted_band(where)
        self.candidates = candidates(plan, description, self._settings.model_dump())
        self._durations = Durations(description, self._bands)
        self._online = Online(self._band)
        self._places = places(self.candidates.directions)
        self._first = self._covering()
        self._check_budget(where)

    @property
    def _request(self) -> FitRequest:
        s = self._settings
        return FitRequest(s.model, ior=s.index, fix=s.fix, free=s.free, slopes=s.slopes)

    def _fitted_band(self, where: str) -> Band:
        wanted = self._settings.wavelength_nm
        if wanted is not None:
            for band in self._bands:
                if abs(band.centre_nm - wanted) <= max(0.5 * band.fwhm_nm, 1e-6):
                    return band
            known = ", ".join(f"{band.centre_nm:g}" for band in self._bands)
            raise ConfigError(f"{where} wavelength_nm = {wanted:g}: the plan's bands lie at {known} nm")
        return min(self._bands, key=lambda band: abs(band.centre_nm - DEFAULT_WAVELENGTH_NM))

    def _check_budget(self, where: str) -> None:
        """The budget holds what is measured before anything is known."""
        poses = [self.candidates.poses[k] for k in self._first]
        expected.require_budget(where, self._budget_s, self._durations, poses)

    def about(self) -> list[str]:
        """What it will do, a line each."""
        s, free = self._settings, self._problem.free
        wanted = [f"{name} to {100 * u:.3g} %" for name, u in s.u_rel.items()] + [
            f"{n} to {u:.3g}" for n, u in s.u.items()
        ]
        target = ", ".join(wanted) or "as well as the budget allows"
        return [
            f"model: {s.model} at {self._band.centre_nm:g} nm; fitted: {', '.join(free)}",
            f"target (standard uncertainty): {target}",
            f"budget: {self._budget_s / 3600.0:g} h of rig time for the whole run",
            f"candidates: {len(self.candidates)} points that the rig can reach"
            + (f" ({'; '.join(self.candidates.left_out)})" if self.candidates.left_out else ""),
            f"batches of {SMALLEST} to {LARGEST} points; {100 * COVERING:g} % of them cover, and all of them once the "
            "model is found wrong",
        ]

    # ---- what is measured first ----

    def _covering(self) -> list[int]:
        """The candidates of the first covering, in the order in which they are measured."""
        directions = self.candidates.directions
        offset = np.degrees(np.asarray(directions.mirror_offset))
        near = np.flatnonzero(offset <= max(AROUND_MIRROR_DEG, float(offset.min())))
        count = min(max(FIRST * len(self._problem.free), FEWEST), MOST)
        middle = near[np.argsort(offset[near], kind="stable")[:1]]
        begin = np.flatnonzero(np.isin(near, middle))
        chosen = near[spread(self._places[near], count, begin)]
        points = [self.candidates.points[k] for k in chosen]
        return [int(chosen[k]) for k in snake(points)]

    def first(self, planned: Sequence[Point]) -> Sequence[Point]:
        """A covering of the candidates; nothing where the plan has as many points of its own."""
        return [] if len(planned) >= len(self._first) else [self.candidates.points[k] for k in self._first]

    # ---- what is measured next ----

    def next(self, run: Run) -> Choice:
        """See `gonio.acquisition.choosing.Chooser`."""
        return self.choose(
            self._online.values(run),
            spent_s=expected.spent_s(self._durations, run),
            modes=[str(batch.why.get("mode")) for batch in run.batches],
            reduced=lambda: reduction.reduce(run),
        )

    def choose(
        self, values: Values, *, spent_s: float, modes: Sequence[str], reduced: Callable[[], pd.DataFrame]
    ) -> Choice:
        """What is measured next.

        Parameters
        ----------
        values
            All so far.
        spent_s
            Rig time so far [s].
        modes
            What the batches before this one were for, in turn: `mode` of what the journal keeps of them.
        reduced
            Gives the measurement table of the run so far.
        """
        look, wrong = len(modes), "covering" in modes
        known = None if wrong else self.fitted(values)
        why: dict[str, Any] = {"spent_s": round(spent_s, 1), "values": len(values)}
        said = []
        if known is not None and known.test.rejects(look):  # unless it is the search that has failed
            known = min(known, self.fitted(values, MANY) or known, key=lambda one: one.test.chi_square)
        if known is not None:
            why |= self._of_fit(known)
            if known.test.rejects(look):
                wrong = True
                said.append(
                    f"{self._settings.model} does not describe the values (chi-square {known.test.chi_square:.3g} of "
                    f"{known.test.degrees_of_freedom}, p = {known.test.p_value:.2g}): all further points cover"
                )
        why["mode"] = "covering" if wrong else "parameters"
        if known is not None and not wrong:
            said.append(self._progress(known.result))
            if self._reached(self._ratios(known.result) / CLOSE) and len(known.modes) == 1:
                final = self._final(reduced(), known.result)
                why["u_final"] = {n: _short(final.parameters[n].u) for n in final.free}
                if self._reached(self._ratios(final)):
                    return Choice((), why, "enough: " + self._progress(final), met=True)
                worse = float(np.nanmax(self._ratios(final) / self._ratios(known.result)))
                worse = min(max(worse, 1.0 / WORST), WORST) if math.isfinite(worse) else WORST
                known = replace(known, result=replace(known.result, spread=final.spread), worse=worse)
        left_s = self._budget_s - spent_s
        picked, gains = ([], {}) if wrong else self._pick(values, known, left_s)
        if not picked and not gains.get("cut"):
            picked, gains = self._cover(values, left_s, sum(mode in COVERS for mode in modes))
            if picked and not wrong:
                why["mode"] = "filling"
                said.append("no point tells more of the parameters: all next points cover")
        why |= gains
        if not picked:
            said.insert(0, "the budget is spent" if gains.get("cut") else "no point adds anything")
            at_fault = f" ({self._settings.model} does not describe the sample)" if wrong else ""
            return Choice((), why, f"enough{at_fault}: " + "; ".join(said))
        points = [self.candidates.points[k] for k in picked]
        ordered = tuple(points[k] for k in snake(points))
        said.append(f"{len(ordered)} points next, {gains['cover']} of them to cover")
        said.append(f"{spent_s / 60:.3g} of {self._budget_s / 60:.3g} min")
        return Choice(ordered, why, "; ".join(said))

    # ---- fits ----

    def _observed(self, values: Values, covariance: Covariance) -> Observations:
        lamp, lens = self._description.lamp.half_angle_deg, self._description.camera.lens_half_angle_deg
        return Observations(
            directions=values.directions,
            wavelength_nm=np.full(len(values), self._band.centre_nm),
            brdf=values.brdf,
            covariance=covariance,
            rows=np.arange(len(values)),
            source_solid_angle_sr=float(solid_angle_of_cone(math.radians(lamp))),
            receiver_solid_angle_sr=float(solid_angle_of_cone(math.radians(lens))),
        )

    def fitted(self, values: Values, searches: int = SEARCHES) -> Known | None:
        """The fit to all values, with what errors of the angles do by the model itself; None where it is impossible."""
        free = len(self._problem.free)
        if len(values) <= free + 1:
            return None
        names = tuple(values.common)
        common = np.stack([values.common[name] for name in names], axis=1)
        u = np.hypot(values.u_noise, 0.003 * np.abs(values.brdf))
        data = self._observed(values, Covariance(np.maximum(u, 1e-12), common, names))
        try:
            result = fit(data, replace(self._request, searches=searches), name="the values so far")
        except DataError:
            return None
        sights = fisher.Sights(data, values.poses, self._description)
        rows = sights.rows(self._problem, result.vector)
        u = np.hypot(values.u_noise, rows.u_landing)
        causes = (*names, *rows.of_angles)
        columns = np.concatenate([common, np.stack(list(rows.of_angles.values()), axis=1)], axis=1)
        data = self._observed(values, Covariance(np.maximum(u, 1e-12), columns, causes))
        start = result.problem.values(result.vector)
        result = fit(data, replace(self._request, start=[start]), name="the values so far")
        assert data.covariance is not None
        lower, upper = self._problem.bounds
        inside = (result.vector > lower + 1e-6) & (result.vector < upper - 1e-6)
        test = lack_of_fit.judge(
            values.brdf - result.predicted,
            rows.parameters[:, inside],
            result.predicted,
            result.goal.weights or data.covariance,
            values.directions,
        )
        return Known(result, data, sights, rows, self._modes(result, data), test)

    def _modes(self, result: FitResult, data: Observations) -> list[tuple[Floats, float]]:
        """The fit's solution, and others that the values do not rule out."""
        problem, goal = self._problem, alone(data)
        starts = [problem.vector({"k": 1.0, **start}) for start in problem.family.starts(data)]
        cost = [float((goal.residual(apparent(problem.model(x), data, quick=True)) ** 2).sum()) for x in starts]
        here, best = refine(problem, data, goal, result.vector, quick=True, limit=20)
        lower, upper = problem.bounds
        u = np.sqrt(np.diag(result.spread))
        apart = APART * np.clip(np.where(np.isfinite(u), u, np.inf), 1e-3 * (upper - lower), 0.2 * (upper - lower))
        found, out = [here], [(result.vector, 1.0)]
        for k in np.argsort(cost, kind="stable")[:OTHER_MODES]:
            vector, half = refine(problem, data, goal, starts[k], quick=True, limit=25)
            more = 2.0 * (half - best)
            if more < ALLOWED and all((np.abs(vector - other) > apart).any() for other in found):
                found.append(vector)
                out.append((vector, math.exp(-0.5 * max(more, 0.0))))
        return out

    def _final(self, table: pd.DataFrame, result: FitResult) -> FitResult:
        """What `gonio fit` will say of the run."""
        start = result.problem.values(result.vector)
        return fit(table, replace(self._request, start=[start], wavelength_nm=self._band.centre_nm))

    # ---- targets ----

    def _targets(self, problem: Problem, vector: Floats) -> Floats:
        """The wanted standard uncertainties on the search scale; NaN where none is stated."""
        values, slope = problem.values(vector), problem.slope(vector)
        out = np.full(vector.size, math.nan)
        for k, name in enumerate(problem.free):
            if name in self._settings.u:
                out[k] = self._settings.u[name] / max(abs(slope[k]), 1e-300)
            elif name in self._settings.u_rel:
                out[k] = self._settings.u_rel[name] * abs(values[name]) / max(abs(slope[k]), 1e-300)
        return out

    def _ratios(self, result: FitResult) -> Floats:
        """Uncertainty over target of every parameter; NaN without a target."""
        return np.sqrt(np.diag(result.spread)) / np.maximum(self._targets(result.problem, result.vector), 1e-300)

    def _reached(self, ratios: Floats) -> bool:
        """Whether all targets are met; never where none is stated."""
        return bool(np.isfinite(ratios).any() and np.nanmax(ratios) <= 1.0)

    def _progress(self, result: FitResult) -> str:
        """What is known of the parameters, for a person."""
        out = []
        for name in result.free:
            e = result.parameters[name]
            wanted = self._settings.u.get(name)
            if wanted is None and name in self._settings.u_rel:
                wanted = self._settings.u_rel[name] * abs(e.value)
            u = "unknown" if e.u is None else f"{e.u:.2g}"
            out.append(f"{name} = {e.value:.4g} +- {u}" + (f" (wanted {wanted:.2g})" if wanted is not None else ""))
        return ", ".join(out)

    def _of_fit(self, known: Known) -> dict[str, Any]:
        result, test = known.result, known.test
        return {
            "fit": {name: float(f"{result.parameters[name].value:.6g}") for name in result.free},
            "u": {name: _short(result.parameters[name].u) for name in result.free},
            "modes": len(known.modes),
            "chi_square": _short(test.chi_square),
            "degrees_of_freedom": test.degrees_of_freedom,
            "p_value": _short(test.p_value),
        }

    # ---- choosing ----

    def _cover(self, values: Values, left_s: float, stage: int) -> tuple[list[int], dict[str, Any]]:
        """The candidates of a batch that covers; so many of these were measured before.

        The first of these batches is small: how dark the sample is where nothing was measured nobody knows before.
        """
        seen, here = self._seen(values, None), reference_pose(self._description)
        points = self.candidates.points
        known = covering.Curves.of(
            points, self._places, places(values.directions), values.brdf, values.u_noise, seen.u_rel
        )
        open_to = np.flatnonzero(seen.seconds < DEAREST * max(left_s, 0.0)).tolist()
        numbers: dict[str, Any] = {"gain": None}

        def fits(share: float, most: int) -> Callable[[list[int]], bool]:
            return lambda batch: len(batch) <= most and self._batch_s(batch, seen, here) <= share * left_s

        batch: list[int] = []
        finer = True
        if stage == 0:
            batch, finer = covering.evenly(known, open_to, fits(DEAREST, 3 * LARGEST))
        elif stage == 1:
            batch, finer = covering.evenly(known, open_to, fits(covering.EVENLY, len(points)))
        if not batch:
            cost = seen.seconds + 0.2 * self._durations.moves_s(here, self.candidates.poses)
            batch = covering.by_errors(known, open_to, cost, fits(HALF if stage < LAST else LATER, len(points)))
        if (finer and not batch) or len(open_to) < len(points):
            numbers["cut"] = True
        numbers["cover"] = len(batch)
        if batch:
            numbers["batch_s"] = round(self._batch_s(batch, seen, here), 1)
        return batch, numbers

    def _pick(self, values: Values, known: Known | None, left_s: float) -> tuple[list[int], dict[str, Any]]:
        """The candidates of a batch, in the order of their choice, and numbers for the journal."""
        count = LARGEST if known is None else min(max(round(GROWTH * len(values)), SMALLEST), LARGEST)
        seen = self._seen(values, known)
        here = reference_pose(self._description)
        way = self._durations.moves_s(here, self.candidates.poses)
        cost = seen.seconds + EVERY_S + 0.2 * way  # most ways are those between neighbours
        affordable = cost < DEAREST * max(left_s, 0.0)
        measured = [places(values.directions)] if len(values) else []
        part = 1.0 if known is None else OUT_OF_REACH if self._out_of_reach(values, known, left_s, cost) else COVERING
        share = round(part * count)
        picked: list[int] = []
        gain = math.nan
        if known is not None:
            open_to = np.where(affordable, cost, np.inf)
            apart = self._telling_apart(known, (count - share) // 2, open_to)
            picked, gain = self._informative(values, known, count - share - len(apart), open_to)
            picked += apart
            share = min(share, math.ceil(part / (1.0 - part) * len(picked)))
        at = np.concatenate([*measured, self._places[picked]]) if measured else self._places[picked]
        distance = np.minimum(from_nearest(self._places, at), 1e3)
        cover: list[int] = []
        for _ in range(share if picked or known is None else 0):
            score = np.where(affordable, distance**2 / cost, -1.0)
            k = int(np.argmax(np.round(score, 12)))
            if score[k] <= 1e-12:
                break
            cover.append(k)
            distance = np.minimum(distance, np.linalg.norm(self._places - self._places[k], axis=1))
        batch = [*picked, *cover]
        numbers: dict[str, Any] = {"gain": None if math.isnan(gain) else _short(gain)}
        if not affordable.any():
            numbers["cut"] = True
        while batch and self._batch_s(batch, seen, here) > left_s:
            numbers["cut"] = True
            # the last of each kind in turn, so that a short batch is like a long one
            (cover if len(cover) > share / max(count, 1) * len(batch) or not picked else picked).pop()
            batch = [*picked, *cover]
        numbers["cover"] = len(cover)
        if batch:
            numbers["batch_s"] = round(self._batch_s(batch, seen, here), 1)
        return batch, numbers

    def _out_of_reach(self, values: Values, known: Known, left_s: float, cost: Floats) -> bool:
        """Whether the targets would take more points than there is time for; what is known grows as their number."""
        ratios = self._ratios(known.result)
        if not np.isfinite(ratios).any():
            return False
        return len(values) * (float(np.nanmax(ratios)) ** 2 - 1.0) > left_s / float(np.quantile(cost, CHEAP))

    def _batch_s(self, batch: list[int], seen: expected.Visits, here: Pose) -> float:
        order = [batch[k] for k in snake([self.candidates.points[k] for k in batch])]
        poses = [self.candidates.poses[k] for k in order]
        return expected.batch_s(self._durations, poses, [float(seen.seconds[k]) for k in order], here)

    def _seen(self, values: Values, known: Known | None) -> expected.Visits:
        """What visits to the candidates come to: by the fit, or by values nearby where no model is to be trusted."""
        if known is not None:
            return self._expected.visits(apparent(self._problem.model(known.result.vector), self._ahead.at, quick=True))
        if not len(values):
            return self._expected.visits(np.full(len(self.candidates), 0.5 / math.pi))
        return self._expected.visits(nearby(self._places, places(values.directions), values.brdf, values.u_noise))

    @cached_property
    def _expected(self) -> expected.Expected:
        return expected.Expected(self._durations, self.candidates.poses)

    @cached_property
    def _ahead(self) -> fisher.Sights:
        """The candidates, as the forward model takes them."""
        none, poses = np.zeros(len(self.candidates)), read(self._description, self.candidates.poses)
        rows = none.astype(np.intp)
        directions = Directions.stack([kinematics.directions(self._description, pose) for pose in poses])
        values = Values(rows, directions, poses, none, none, {}, none)
        observed = self._observed(values, Covariance(none + 1.0, np.zeros((none.size, 0))))
        return fisher.Sights(observed, poses, self._description)

    def _samples(self, known: Known) -> list[tuple[Floats, float]]:
        """Parameters that the values allow, with weights: the solutions, and draws around the best one."""
        lower, upper = self._problem.bounds
        u = np.sqrt(np.diag(known.result.spread))
        finite = np.where(np.isfinite(known.result.spread), known.result.spread, 0.0)
        correlation = finite / np.outer(u, u) if np.isfinite(u).all() and (u > 0).all() else np.eye(u.size)
        values, vectors = np.linalg.eigh(correlation)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        wide = np.minimum(np.where(np.isfinite(u), u, np.inf), 0.25 * (upper - lower))
        normal = np.random.default_rng(len(known.data)).standard_normal((DRAWS, u.size))
        drawn = [np.clip(known.result.vector + wide * (root @ z), lower, upper) for z in normal]
        return [*known.modes, *((vector, 1.0 / DRAWS) for vector in drawn)]

    def _telling_apart(self, known: Known, count: int, cost: Floats) -> list[int]:
        """The candidates where the solutions that are not ruled out differ most for their time; none where it is one.

        [Hunter1965]: squared differences of the predictions, in units of the noise.
        """
        if len(known.modes) < 2:
            return []
        predicted = [apparent(self._problem.model(vector), self._ahead.at, quick=True) for vector, _ in known.modes]
        seen = self._expected.visits(predicted[0])
        landing = self._ahead.rows(self._problem, known.modes[0][0]).u_landing
        u = np.hypot(np.where(np.isfinite(seen.u_rel), seen.u_rel * predicted[0], 1e3), landing)
        score = sum(((other - predicted[0]) / u) ** 2 for other in predicted[1:]) / cost
        out: list[int] = []
        for k in np.argsort(-score, kind="stable"):
            if score[k] > 0.0 and len(out) < count:
                out += [int(k)] * min(REPEATS, count - len(out))
        return out

    def _informative(self, values: Values, known: Known, count: int, cost: Floats) -> tuple[list[int], float]:
        """The candidates that tell most for their time, and what all of them lower the log uncertainty by."""
        free = len(self._problem.free)
        states, designs, errors, weights, share = [], [], [], [], []
        for vector, weight in self._samples(known):
            measured = known.sights.rows(self._problem, vector)
            ahead = self._ahead.rows(self._problem, vector)
            relative = {n: c / np.where(values.brdf == 0, 1.0, values.brdf) for n, c in values.common.items()}
            past = _design(measured, relative)
            lower, upper = self._problem.bounds
            before = fisher.Known.nothing(upper - lower, past.shape[1] - free)
            u = np.maximum(np.hypot(values.u_noise, measured.u_landing), 1e-12)
            state = before.with_values(past, u)
            seen = self._expected.visits(ahead.brdf)
            latest = {n: np.full(len(cost), c[-1]) for n, c in relative.items()}
            noise = np.where(np.isfinite(seen.u_rel), seen.u_rel * ahead.brdf, 1e3)
            states.append(state)
            designs.append(_design(ahead, latest))
            errors.append(np.maximum(np.hypot(noise, ahead.u_landing), 1e-12))
            targets = self._targets(self._problem, vector) / known.worse
            weights.append(targets if np.isfinite(targets).any() else None)
            share.append(weight)
        share = [one / sum(share) for one in share]
        times = np.zeros(len(cost), dtype=int)
        picked: list[int] = []
        total = 0.0
        for _ in range(count):
            covariances = [state.covariance for state in states]
            if weights[0] is not None and all(
                np.nanmax(np.sqrt(np.diag(c)[:free]) / t) <= AIM for c, t in zip(covariances, weights, strict=True)
            ):
                break
            gains = np.zeros(len(cost))
            for c, design, u, target, part in zip(covariances, designs, errors, weights, share, strict=True):
                gains += part * fisher.gains(c, free, design, u, _weights(c, free, target))
            score = np.where(times < REPEATS, gains / cost, -1.0)
            k = int(np.argmax(np.round(score / max(float(score.max()), 1e-300), 9)))
            if gains[np.isfinite(cost)].max(initial=0.0) < LEAST_GAIN:
                break
            picked.append(k)
            times[k] += 1
            total += float(gains[k])
            states = [
                s.with_values(d[k : k + 1], u[k : k + 1]) for s, d, u in zip(states, designs, errors, strict=True)
            ]
        return picked, total


def _design(rows: fisher.Rows, relative: dict[str, Floats]) -> Floats:
    """d(value)/d(parameter) and the change by each common cause, (n, p + k)."""
    common = [rows.brdf * column for column in relative.values()]
    return np.concatenate([rows.parameters, np.stack([*common, *rows.of_angles.values()], axis=1)], axis=1)


def _weights(covariance: Floats, count: int, targets: Floats | None) -> Floats | None:
    """1 / target^2, larger for the parameter that is farthest from its target."""
    if targets is None:
        return None
    stated = np.isfinite(targets)
    ratios = np.where(stated, np.sqrt(np.diag(covariance)[:count]) / np.where(stated, targets, 1.0), 0.0)
    return np.where(stated, (ratios / max(float(ratios.max()), 1e-300)) ** 2 / np.where(stated, targets, 1.0) ** 2, 0.0)


def _short(value: float | None) -> float | None:
    """Three digits, for the journal."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.3g}")


CHOOSER = Plugin()
