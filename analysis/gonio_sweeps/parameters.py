"""The sampler "parameters": points for the parameters of a named model, and for whether it is the right one.

Each batch follows from a fit to all values so far. Most of its points are those that tell most of the parameters for
their rig time (`gonio_sweeps.expected`), on average over parameters that the values allow. The others cover: they look
where nothing was measured. Where the residuals of the fit say that the model is wrong (`gonio_sweeps.model_fit`),
batches that cover take turns with batches for the nearest model, whose misfit is in their design. docs/
adaptive_sweeps.md has the method.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from gonio_analysis.fitting.forward import apparent

from gonio.errors import ConfigError
from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Choice
from gonio.lab.reduction import brdf as reduction
from gonio.lab.rig.description import RigDescription
from gonio.typing import DataFrame, Floats, JsonObject
from gonio_sweeps import expected
from gonio_sweeps.candidates import (
    EVENLY,
    CandidateCurves,
    candidates,
    cover_by_errors,
    cover_evenly,
    nearby,
    places,
    spread,
)
from gonio_sweeps.model_fit import MANY, SEARCHES, Known, ModelFit, ParameterSettings
from gonio_sweeps.online import GrowingValues, Online
from gonio_sweeps.sampler import DEAREST, EVERY_S, REPEATS, BudgetSampler, highest, short

FIRST = 5
"""Points of the first covering, for each parameter; not fewer than `FEWEST`, and not more than `MOST` altogether."""
FEWEST, MOST = 12, 30
AROUND_MIRROR_DEG = 45.0
"""Largest distance of the first points from the mirror direction: farther away metals are dark and slow to measure."""
GROWTH = 1.0
"""A batch adds this part of the points so far: later ones are chosen with better knowledge."""
SMALLEST, LARGEST = 12, 25
"""Points of a batch, at least and at most: each ends with a visit to the reference."""
COVERS = ("covering", "filling")
"""Modes of batches that only cover: the model is wrong, or no point tells more of its parameters."""
NEAREST = "nearest"
"""Mode of batches for the parameters of a model that is wrong."""
COVERING = 0.15
"""Part of a batch that covers, whatever the model says."""
OUT_OF_REACH = 0.5
"""The same where the targets are out of reach of the budget."""
CHEAP = 0.25
"""What is chosen for a model costs as much as this part of the candidates at most, as a rule."""
HALF, LATER, LAST = 0.5, 0.95, 3
"""Part of the time that is left which a batch may take that lowers the curves' errors; and from which on it may take
more: levels are known then."""
DRAWS = 4
"""Parameters that are drawn from what the fit leaves open, beside its own."""
AIM = 1.0
"""A batch ends where it is expected to bring the uncertainties to this part of their targets."""
CLOSE = 1.5
"""Where the quick fit's uncertainties are within this factor of their targets the run is reduced and fitted in full, as
`gonio fit` will do it: its uncertainties decide."""
WORST = 3.0
"""Largest ratio, up or down, of a full reduction's uncertainties to those of the quick fit that counts."""
LEAST_GAIN = 2e-4
"""Where no point lowers the logarithm of the uncertainties by more, none adds anything."""


class Parameters(BudgetSampler[ParameterSettings]):
    """Chooses points that tell the parameters of a model.

    Raises
    ------
    ConfigError
        A key of `[adaptive]` is wrong.
    """

    keys = ParameterSettings

    def __init__(self, plan: Plan, description: RigDescription) -> None:
        super().__init__(plan, description)
        s, where = self._settings, self._where
        self._band = self._band_at(s.wavelength_nm)
        try:
            self._fits = ModelFit(s, description, self._band.centre_nm)
        except ConfigError as error:
            raise ConfigError(f"{where} {str(error).removeprefix('--')}") from None
        free = self._fits.problem.free
        for key, name in (*(("u", n) for n in s.u), *(("u_rel", n) for n in s.u_rel)):
            if name not in free:
                raise ConfigError(f"{where} {key}: {name} of {s.model} is not fitted; fitted are {', '.join(free)}")
        if twice := sorted(s.u.keys() & s.u_rel.keys()):
            raise ConfigError(f"{where} {twice[0]} has a target in u and one in u_rel; keep one of them")
        self.candidates = candidates(plan, description, s.model_dump())
        self._online = Online(self._band)
        self.first_rows = self._covering()
        self._require_budget()

    def about(self) -> list[str]:
        """What it will do, a line each."""
        s, left_out = self._settings, self.candidates.left_out
        wanted = [f"{n} to {100 * u:.3g} %" for n, u in s.u_rel.items()] + [f"{n} to {u:.3g}" for n, u in s.u.items()]
        return [
            f"model: {s.model} at {self._band.centre_nm:g} nm; fitted: {', '.join(self._fits.problem.free)}",
            f"target (standard uncertainty): {', '.join(wanted) or 'as well as the budget allows'}",
            f"budget: {self._budget_s / 3600.0:g} h of rig time for the whole run",
            f"candidates: {len(self.candidates)} points that the rig can reach"
            + (f" ({'; '.join(left_out)})" if left_out else ""),
            f"batches of {SMALLEST} to {LARGEST} points; {100 * COVERING:g} % of them cover, and every second batch "
            "once the model is found wrong",
        ]

    # ---- what is measured first ----

    def _covering(self) -> list[int]:
        """The candidates of the first covering, in the order in which they are measured."""
        offset = np.degrees(np.asarray(self.candidates.directions.mirror_offset))
        near = np.flatnonzero(offset <= max(AROUND_MIRROR_DEG, float(offset.min())))
        count = min(max(FIRST * len(self._fits.problem.free), FEWEST), MOST)
        chosen = near[spread(self._places[near], count, [int(np.argmin(offset[near]))])]
        return self._ordered(chosen.tolist())

    # ---- what is measured next ----

    def next(self, run: Run) -> Choice:
        """See `gonio.lab.acquisition.sampling.Sampler`."""
        return self.choose(
            self._online.values(run),
            spent_s=expected.spent_s(self.durations, run),
            modes=[str(batch.why.get("mode")) for batch in run.batches],
            reduced=lambda: reduction.reduce(run),
        )

    def choose(
        self, values: GrowingValues, *, spent_s: float, modes: Sequence[str], reduced: Callable[[], DataFrame]
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
        covered, nearest = (sum(mode in names for mode in modes) for names in (COVERS, (NEAREST,)))
        turn = wrong and covered > nearest  # of the nearest model
        known = self._fits.fitted(values) if turn or not wrong else None
        why: JsonObject = {"spent_s": round(spent_s, 1), "values": len(values)}
        said = []
        if known is not None and not wrong and known.test.rejects(look):  # unless it is the search that has failed
            known = min(known, self._fits.fitted(values, MANY) or known, key=lambda one: one.test.chi_square)
        if known is not None:
            why |= self._fits.of_fit(known)
            if turn:
                said.append(f"{self._settings.model} comes nearest with {self._fits.progress(known.result)}")
            elif known.test.rejects(look):
                wrong = True
                said.append(
                    f"{self._settings.model} does not describe the values (chi-square {known.test.chi_square:.3g} of "
                    f"{known.test.degrees_of_freedom}, p = {known.test.p_value:.2g}): from now on points cover, and "
                    "tell the nearest model"
                )
        why["mode"] = NEAREST if turn else "covering" if wrong else "parameters"
        if known is not None and not wrong:
            said.append(self._fits.progress(known.result))
            if self._fits.reached(self._fits.ratios(known.result) / CLOSE) and len(known.modes) == 1:
                final = self._fits.final(reduced(), known.result)
                why["u_final"] = {n: short(final.parameters[n].u) for n in final.free}
                if self._fits.reached(self._fits.ratios(final)):
                    return Choice((), why, "enough: " + self._fits.progress(final), met=True)
                worse = float(np.nanmax(self._fits.ratios(final) / self._fits.ratios(known.result)))
                worse = min(max(worse, 1.0 / WORST), WORST) if math.isfinite(worse) else WORST
                known = replace(known, result=replace(known.result, spread=final.spread), worse=worse)
        left_s = self._budget_s - spent_s
        picked, gains = self._pick(values, known, left_s) if turn or not wrong else ([], {})
        if not picked and not gains.get("cut"):
            picked, gains = self._cover(values, left_s, covered)
            if picked and wrong:
                why["mode"] = "covering"
            elif picked:
                why["mode"] = "filling"
                said.append("no point tells more of the parameters: all next points cover")
        return self._chosen(picked, why | gains, said, spent_s, wrong=wrong)

    def _chosen(self, picked: list[int], why: JsonObject, said: list[str], spent_s: float, *, wrong: bool) -> Choice:
        """The points picked in an order of short ways; or that it is enough, where there is none."""
        if not picked:
            said.insert(0, "the budget is spent" if why.get("cut") else "no point adds anything")
            at_fault = f" ({self._settings.model} does not describe the sample)" if wrong else ""
            return Choice((), why, f"enough{at_fault}: " + "; ".join(said))
        said.append(f"{len(picked)} points next, {why['cover']} of them to cover")
        said.append(f"{spent_s / 60:.3g} of {self._budget_s / 60:.3g} min")
        return Choice(tuple(self.candidates.points[k] for k in self._ordered(picked)), why, "; ".join(said))

    def fitted(self, values: GrowingValues, searches: int = SEARCHES) -> Known | None:
        """See `gonio_sweeps.model_fit.ModelFit.fitted`."""
        return self._fits.fitted(values, searches)

    # ---- choosing ----

    def _cover(self, values: GrowingValues, left_s: float, stage: int) -> tuple[list[int], JsonObject]:
        """The candidates of a covering batch, after `stage` such batches.

        The first one is small: it is not known yet how dark the sample is where nothing was measured.
        """
        points, seen = self.candidates.points, self._seen(values, None)
        known = CandidateCurves.of(
            points, self._places, places(values.directions), values.brdf, values.u_noise, seen.u_rel
        )
        open_to = np.flatnonzero(seen.seconds < DEAREST * max(left_s, 0.0)).tolist()

        def fits(share: float, most: int = len(points)) -> Callable[[list[int]], bool]:
            return lambda batch: len(batch) <= most and self._batch_s(batch, seen.seconds) <= share * left_s

        batch, finer = list[int](), True
        if stage < 2:
            batch, finer = cover_evenly(known, open_to, fits(DEAREST, 3 * LARGEST) if stage == 0 else fits(EVENLY))
        if not batch:
            cost = seen.seconds + self._ways_s
            batch = cover_by_errors(known, open_to, cost, fits(HALF if stage < LAST else LATER))
        cut = (finer and not batch) or len(open_to) < len(points)
        return batch, self._numbers(batch, seen, math.nan, len(batch), cut=cut)

    def _numbers(
        self, batch: list[int], seen: expected.ExpectedVisits, gain: float, cover: int, *, cut: bool
    ) -> JsonObject:
        """What the journal keeps of a batch."""
        numbers: JsonObject = {"gain": short(gain)} | ({"cut": True} if cut else {}) | {"cover": cover}
        return numbers | ({"batch_s": round(self._batch_s(batch, seen.seconds), 1)} if batch else {})

    def _pick(self, values: GrowingValues, known: Known | None, left_s: float) -> tuple[list[int], JsonObject]:
        """The candidates of a batch, in the order of their choice, and numbers for the journal."""
        count = LARGEST if known is None else min(max(round(GROWTH * len(values)), SMALLEST), LARGEST)
        seen = self._seen(values, known)
        cost = seen.seconds + EVERY_S + self._ways_s
        affordable = cost < DEAREST * max(left_s, 0.0)
        open_to = np.where(affordable, cost, np.inf)
        part = 1.0 if known is None else OUT_OF_REACH if self._out_of_reach(values, known, left_s, cost) else COVERING
        share = round(part * count)
        cover = spread(self._places, share, [], places(values.directions), open_to)
        picked, gain = list[int](), math.nan
        if known is not None:
            apart = self._telling_apart(known, (count - share) // 2, open_to)
            rest = count - share - len(apart)
            picked, gain, enough = self._informative(values, known, [*apart, *cover], rest, open_to)
            picked += apart
            cover = cover if picked or enough else []
        cut = not affordable.any()
        while (batch := [*picked, *cover]) and self._batch_s(batch, seen.seconds) > left_s:
            cut = True
            # the last of each kind in turn, so that a short batch is like a long one
            (cover if len(cover) > share / max(count, 1) * len(batch) or not picked else picked).pop()
        return batch, self._numbers(batch, seen, gain, len(cover), cut=cut)

    def _out_of_reach(self, values: GrowingValues, known: Known, left_s: float, cost: Floats) -> bool:
        """Whether the targets would take more points than there is time for; what is known grows as their number."""
        ratios = self._fits.ratios(known.result)
        if not np.isfinite(ratios).any():
            return False
        return len(values) * (float(np.nanmax(ratios)) ** 2 - 1.0) > left_s / float(np.quantile(cost, CHEAP))

    def _seen(self, values: GrowingValues, known: Known | None) -> expected.ExpectedVisits:
        """What visits to the candidates come to: by the fit, or by values nearby where no model is to be trusted."""
        if known is not None:
            return self._expected.visits(
                apparent(self._fits.problem.model(known.result.vector), self._ahead.at, quick=True)
            )
        if not len(values):
            return self._expected.visits(np.full(len(self.candidates), 0.5 / math.pi))
        return self._expected.visits(nearby(self._places, places(values.directions), values.brdf, values.u_noise))

    def _samples(self, known: Known) -> list[tuple[Floats, float]]:
        """Parameters that the values allow, with weights: the solutions, and draws around the best one."""
        lower, upper = self._fits.problem.bounds
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
        predicted = [
            apparent(self._fits.problem.model(vector), self._ahead.at, quick=True) for vector, _ in known.modes
        ]
        seen = self._expected.visits(predicted[0])
        landing = self._ahead.rows(self._fits.problem, known.modes[0][0]).u_landing
        u = np.hypot(np.where(np.isfinite(seen.u_rel), seen.u_rel * predicted[0], 1e3), landing)
        score = sum(((other - predicted[0]) / u) ** 2 for other in predicted[1:]) / cost
        best = [int(k) for k in np.argsort(-score, kind="stable") if score[k] > 0.0]
        return [k for k in best for _ in range(REPEATS)][:count]

    def _informative(
        self, values: GrowingValues, known: Known, taken: list[int], count: int, cost: Floats
    ) -> tuple[list[int], float, bool]:
        """The candidates that tell most for their time, beside those that are taken already; what all of them lower the
        log uncertainty by; and whether the targets are met then.
        """
        free = len(self._fits.problem.free)
        states, designs, errors, weights, share = [], [], [], [], []
        for vector, weight in self._samples(known):
            measured = known.sights.rows(self._fits.problem, vector)
            ahead = self._ahead.rows(self._fits.problem, vector)
            relative = {n: c / np.where(values.brdf == 0, 1.0, values.brdf) for n, c in values.common.items()}
            past = _design(measured, relative)
            lower, upper = self._fits.problem.bounds
            before = expected.KnownTogether.nothing(upper - lower, past.shape[1] - free)
            u = np.maximum(np.hypot(values.u_noise, measured.u_landing), 1e-12)
            u = np.hypot(u, known.tau * np.abs(measured.brdf))
            seen = self._expected.visits(ahead.brdf)
            latest = {n: np.full(len(cost), c[-1]) for n, c in relative.items()}
            noise = np.where(np.isfinite(seen.u_rel), seen.u_rel * ahead.brdf, 1e3)
            designs.append(_design(ahead, latest))
            noise = np.hypot(noise, known.tau * np.abs(ahead.brdf))
            errors.append(np.maximum(np.hypot(noise, ahead.u_landing), 1e-12))
            states.append(before.with_values(past, u).with_values(designs[-1][taken], errors[-1][taken]))
            targets = self._fits.targets(self._fits.problem, vector) / known.worse
            weights.append(targets if np.isfinite(targets).any() else None)
            share.append(weight)
        share = [one / sum(share) for one in share]
        times = np.zeros(len(cost), dtype=int)
        picked: list[int] = []
        total, enough = 0.0, False
        for _ in range(count):
            covariances = [state.covariance for state in states]
            enough = weights[0] is not None and all(
                np.nanmax(np.sqrt(np.diag(c)[:free]) / t) <= AIM for c, t in zip(covariances, weights, strict=True)
            )
            if enough:
                break
            gains = np.zeros(len(cost))
            for c, design, u, target, part in zip(covariances, designs, errors, weights, share, strict=True):
                gains += part * expected.gains(c, free, design, u, _weights(c, free, target))
            score = np.where(times < (1 if known.tau else REPEATS), gains / cost, -1.0)  # a misfit stays on repetition
            k = highest(score)
            if gains[np.isfinite(cost)].max(initial=0.0) < LEAST_GAIN:
                break
            picked.append(k)
            times[k] += 1
            total += float(gains[k])
            states = [
                s.with_values(d[k : k + 1], u[k : k + 1]) for s, d, u in zip(states, designs, errors, strict=True)
            ]
        return picked, total, enough


def _design(rows: expected.PredictedRows, relative: dict[str, Floats]) -> Floats:
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


SAMPLER = Parameters
