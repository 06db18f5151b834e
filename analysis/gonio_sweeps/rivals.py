"""The sampler "models": points that tell rival models, or samples, apart (Hunter and Reiner 1965; Box and Hill 1967).

Each batch follows from fits of all rivals to all values so far. Its points raise the expected chi-square between the
best rival and each other most for their rig time (`gonio_sweeps.separation`), rivals weighted by what the values leave
them. A rival's own parameters, and the common causes of the run, may imitate a difference: what they can is taken away.
A rival without free parameters is a sample file. docs/adaptive_sweeps.md has the method.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.value_covariance import Covariance
from pydantic import Field, field_validator

from gonio import models
from gonio.config import Positive, Strict
from gonio.errors import ConfigError
from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Choice
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_sample
from gonio.typing import Floats, JsonObject
from gonio_sweeps import expected
from gonio_sweeps import separation as separations
from gonio_sweeps.candidates import candidates, spread
from gonio_sweeps.model_fit import ModelFit, ParameterSettings
from gonio_sweeps.online import GrowingValues, Online
from gonio_sweeps.sampler import DEAREST, EVERY_S, REPEATS, BudgetSampler, highest
from gonio_sweeps.separation import SIGMAS, Gathered

FIRST = 8
"""Points of a first covering where parameters have to be fitted; nothing is known before."""
BATCH = 8
"""Points of a batch: each ends with a visit to the reference."""
LEAST_WEIGHT = 0.02
"""Least weight of a rival, also of one that the values have almost ruled out: a fit may have failed."""
REJECTED = 1e-4
"""A rival whose chi-square has a smaller probability describes the values as little as those that lose."""


class RivalSettings(Strict):
    """The keys of `[adaptive]` with how = "models", beside `how` and `budget_h`."""

    models: tuple[str, ...] = Field(min_length=2)
    """Models, as `gonio fit --model`, or sample files (.toml), whose parameters are known."""
    ior: str | float | tuple[float, float] | None = None
    """Optical constants of the models that have them, as with how = "parameters"."""
    wavelength_nm: Positive | None = None
    theta_i_deg: Any = None
    theta_r_deg: Any = None
    dphi_deg: Any = None
    """The candidates, as in a `[[sweep]]`."""

    @field_validator("models")
    @classmethod
    def _once(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(value)) < len(value):
            raise ValueError("a rival is named twice; name each once")
        return value


@dataclass(frozen=True)
class Rival:
    """A model with free parameters, or a sample."""

    name: str
    fits: ModelFit | None
    sample: SampleDescription | None


@dataclass(frozen=True)
class Stand:
    """Where a rival stands after some values."""

    name: str
    score: float
    """-2 ln(likelihood), and 2 a free parameter (Akaike 1974), but for a constant."""
    chi_square: float
    freedom: int
    model: Any
    problem: Problem | None
    vector: Floats | None

    def rows(self, sights: expected.Sights) -> expected.PredictedRows:
        """What it has at some poses."""
        if self.problem is None or self.vector is None:
            return sights.of_model(self.model)
        return sights.rows(self.problem, self.vector)

    @property
    def ranges(self) -> Floats:
        """Ranges of the free parameters on the search scale."""
        if self.problem is None:
            return np.zeros(0)
        lower, upper = self.problem.bounds
        return np.asarray(upper - lower)


class Rivals(BudgetSampler[RivalSettings]):
    """Chooses points that tell rivals apart.

    Raises
    ------
    ConfigError
        A key of `[adaptive]` is wrong.
    """

    keys = RivalSettings

    def __init__(self, plan: Plan, description: RigDescription) -> None:
        super().__init__(plan, description)
        s = self._settings
        self._band = self._band_at(s.wavelength_nm)
        self._rivals = [self._rival(name, Path(plan.source).parent) for name in s.models]
        self.candidates = candidates(plan, description, s.model_dump())
        self._online = Online(self._band)
        if all(one.sample is not None for one in self._rivals):
            self.first_rows = self._pick([self._stand(one, None, None) for one in self._rivals], None, math.inf)[0]
        else:
            middle = int(np.argmin(np.asarray(self.candidates.directions.mirror_offset)))
            self.first_rows = spread(self._places, FIRST, [middle])
        self._require_budget()
        self.first_rows = self._ordered(self.first_rows)

    def _rival(self, name: str, folder: Path) -> Rival:
        if name.endswith(".toml"):
            sample = load_sample(folder / name, uniform=True)
            return Rival(sample.name, None, sample)
        settings = ParameterSettings(model=name, ior=self._settings.ior)
        try:
            return Rival(name, ModelFit(settings, self._description, self._band.centre_nm), None)
        except ConfigError as error:
            raise ConfigError(f"{self._where} models: {str(error).removeprefix('--')}") from None

    def about(self) -> list[str]:
        """What it will do, a line each."""
        said = [one.name if one.fits is None else f"{one.name} (fitted)" for one in self._rivals]
        return [
            f"rivals: {', '.join(said)}, at {self._band.centre_nm:g} nm",
            f"target: the best one ahead of every other by {SIGMAS:g} sigma (chi-square {SIGMAS**2:g})",
            f"budget: {self._budget_s / 3600.0:g} h of rig time for the whole run",
            f"candidates: {len(self.candidates)} points that the rig can reach",
        ]

    def next(self, run: Run) -> Choice:
        """See `gonio.lab.acquisition.sampling.Sampler`."""
        return self.choose(self._online.values(run), expected.spent_s(self.durations, run))

    def choose(self, values: GrowingValues, spent_s: float) -> Choice:
        """What is measured next, after these values and the rig time `spent_s` [s]."""
        stands = [self._of_values(one, values) for one in self._rivals]
        why: JsonObject = {"spent_s": round(spent_s, 1), "values": len(values)}
        known = sorted((one for one in stands if one is not None), key=lambda one: one.score)
        said = f"{spent_s / 60:.3g} of {self._budget_s / 60:.3g} min"
        if len(known) < len(stands):  # too few values for a fit
            picked = spread(self._places, len(values) + BATCH, [0])[len(values) :]
        else:
            best, second = known[0], known[1]
            margin = second.score - best.score
            why["score"] = {one.name: round(one.score - best.score, 3) for one in known}
            why["chi_square"] = {one.name: round(one.chi_square, 3) for one in known}
            verdict = f"{best.name} is ahead of {second.name} by {margin:.3g}, {math.sqrt(max(margin, 0.0)):.2g} sigma"
            said = f"{verdict}; {said}"
            if margin >= SIGMAS**2:
                return Choice((), why, f"enough: {verdict}{_doubt(best)}", met=True)
            picked, gain = self._pick(known, values, self._budget_s - spent_s)
            why["gain"] = round(gain, 3)
        brdf = known[0].rows(self._ahead).brdf if known else np.full(len(self.candidates), 0.5 / math.pi)
        seconds = self._expected.visits(brdf).seconds
        while picked and self._batch_s(picked, seconds) > self._budget_s - spent_s:
            why["cut"] = True
            picked.pop()
        if not picked:
            return Choice((), why, f"enough: the budget is spent; {said}")
        return Choice(tuple(self.candidates.points[k] for k in self._ordered(picked)), why, said)

    # ---- rivals ----

    def _of_values(self, rival: Rival, values: GrowingValues) -> Stand | None:
        """Where a rival stands; None where its parameters cannot be fitted yet."""
        if rival.fits is None:
            return self._stand(rival, values, None)
        found = rival.fits.fitted(values)
        return None if found is None else self._stand(rival, values, found.result.vector)

    def _stand(self, rival: Rival, values: GrowingValues | None, vector: Floats | None) -> Stand:
        problem = None if rival.fits is None else rival.fits.problem
        model: Any
        if problem is not None and vector is not None:
            model = problem.model(vector)
        else:
            assert rival.sample is not None
            model = models.build(rival.sample.model, rival.sample.parameters)
        stand = Stand(rival.name, 0.0, 0.0, 0, model, problem, vector)
        if values is None or not len(values):
            return stand
        sights = expected.sights_at(self._description, values.poses, values.directions, self._band.centre_nm)
        rows = sights.of_model(model)
        level = np.where(values.brdf == 0.0, 1.0, values.brdf)
        common = [rows.brdf * column / level for column in values.common.values()]
        u = np.maximum(np.hypot(values.u_noise, rows.u_landing), 1e-12)
        covariance = Covariance(
            u, np.stack([*common, *rows.of_angles.values()], axis=1), (*values.common, *rows.of_angles)
        )
        chi_square = covariance.chi_square(values.brdf - rows.brdf)
        free = 0 if vector is None else vector.size
        score = chi_square + covariance.log_determinant + 2.0 * free
        return Stand(rival.name, score, chi_square, len(values) - free, model, problem, vector)

    # ---- choosing ----

    def _pick(self, stands: Sequence[Stand], values: GrowingValues | None, left_s: float) -> tuple[list[int], float]:
        """The candidates of a batch, and by how much they are expected to raise chi-square between the rivals."""
        best = stands[0]
        rows = best.rows(self._ahead)
        seen = self._expected.visits(rows.brdf)
        u = separations.independent(seen, rows)
        cost = seen.seconds + EVERY_S + self._ways_s
        cost = np.where(cost < DEAREST * max(left_s, 0.0), cost, np.inf)
        pairs = []
        for other in stands[1:]:
            theirs = other.rows(self._ahead)
            columns = separations.rival_columns(self._description, theirs, other.ranges)
            so_far = Gathered.nothing(columns.shape[1])
            if values is not None and len(values):
                at = expected.sights_at(self._description, values.poses, values.directions, self._band.centre_nm)
                mine, measured = best.rows(at), other.rows(at)
                noise = np.maximum(np.hypot(values.u_noise, mine.u_landing), 1e-12)
                past = separations.rival_columns(self._description, measured, other.ranges)
                so_far = so_far.with_values(measured.brdf - mine.brdf, noise, past)
            weight = max(math.exp(-0.5 * min(other.score - best.score, 1e3)), LEAST_WEIGHT)
            pairs.append((theirs.brdf - rows.brdf, columns, weight, so_far))
        times, picked, total = np.zeros(len(cost), dtype=int), list[int](), 0.0
        for _ in range(BATCH):
            gains = sum(weight * known.gains(d, u, columns) for d, columns, weight, known in pairs)
            score = np.where(times < REPEATS, gains / cost, -1.0)
            k = highest(score)
            if not score[k] > 0.0:
                break
            picked.append(k)
            times[k] += 1
            total += float(np.asarray(gains)[k])
            one = slice(k, k + 1)
            pairs = [(d, c, w, known.with_values(d[one], u[one], c[one])) for d, c, w, known in pairs]
        return picked, total


def _doubt(best: Stand) -> str:
    """What is said of a winner that does not describe the values either."""
    from scipy.special import chdtrc

    if best.freedom < 1 or chdtrc(best.freedom, best.chi_square) >= REJECTED:
        return ""
    return f", and does not describe the values itself (chi-square {best.chi_square:.3g} of {best.freedom})"


SAMPLER = SimpleNamespace(
    open=Rivals, separation=separations.separation, about=separations.about, draw=separations.draw
)
"""What the entry point names; `gonio plan show --separate` asks it for separations."""
