"""What the samplers here share: their keys, a budget of rig time, candidates, and batches in an order of short ways."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Generic, Self, TypeVar

import numpy as np
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM

from gonio.config import Strict, parse
from gonio.errors import ConfigError
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.typing import Floats
from gonio_sweeps import expected
from gonio_sweeps.candidates import Candidates, places, snake

DEAREST = 0.25
"""Part of the time that is left which one point may take, at most."""
REPEATS = 3
"""Visits to one point in a batch, at most: what a repeat cannot tell is that the model is wrong beside it."""
EVERY_S = 3.0
"""Counted for every point beside its frames and its way [s]: a visit is work for the rig, however bright the point."""
Keys = TypeVar("Keys", bound=Strict)


class BudgetSampler(Generic[Keys]):
    """A sampler that chooses among candidates within a budget of rig time.

    Raises
    ------
    ConfigError
        A key of `[adaptive]` is wrong.
    """

    keys: type[Keys]
    """What `[adaptive]` may hold beside `how` and `budget_h`."""
    _band: Band
    """Where models are fitted: the band that they are fitted to."""
    candidates: Candidates
    first_rows: Sequence[int]
    """The candidates that are measured before anything is known."""

    def __init__(self, plan: Plan, description: RigDescription) -> None:
        assert plan.adaptive is not None
        self._where = f"{plan.source}: [adaptive]"
        self._settings = parse(self.keys, plan.adaptive.own, self._where)
        self._description, self._here = description, reference_pose(description)
        self._budget_s = 3600.0 * plan.adaptive.budget_h
        self._bands = plan.bands(description)
        self.durations = Durations(description, self._bands)

    @classmethod
    def open(cls, plan: Plan, description: RigDescription) -> Self:
        """The sampler of a plan on a rig; see `gonio.lab.acquisition.sampling.SamplerPlugin`."""
        return cls(plan, description)

    def first(self, planned: Sequence[Point]) -> Sequence[Point]:
        """What is measured first; nothing where the plan has as many points of its own."""
        return [] if len(planned) >= len(self.first_rows) else [self.candidates.points[k] for k in self.first_rows]

    def _band_at(self, wavelength_nm: float | None) -> Band:
        """The band that holds a wavelength, the nearest of several; the nearest to 550 nm where none is named."""
        goal = DEFAULT_WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
        band = min(self._bands, key=lambda one: abs(one.centre_nm - goal))
        if wavelength_nm is not None and abs(band.centre_nm - goal) > max(0.5 * band.fwhm_nm, 1e-6):
            known = ", ".join(f"{one.centre_nm:g}" for one in self._bands)
            raise ConfigError(f"{self._where} wavelength_nm = {goal:g}: the plan's bands lie at {known} nm")
        return band

    def _require_budget(self) -> None:
        poses = [self.candidates.poses[k] for k in self.first_rows]
        expected.require_budget(self._where, self._budget_s, self.durations, poses)

    @cached_property
    def _expected(self) -> expected.Expected:
        return expected.Expected(self.durations, self.candidates.poses)

    @cached_property
    def _ahead(self) -> expected.Sights:
        """The candidates, as the forward model takes them in the band that models are fitted to."""
        return expected.sights_ahead(self._description, self.candidates.poses, self._band.centre_nm)

    @cached_property
    def _places(self) -> Floats:
        return places(self.candidates.directions)

    @cached_property
    def _ways_s(self) -> Floats:
        """Time of the way to each candidate within a batch [s]: most ways are those between neighbours."""
        return np.asarray(0.2 * self.durations.moves_s(self._here, self.candidates.poses))

    def _ordered(self, batch: Sequence[int]) -> list[int]:
        """In an order of short ways."""
        return [batch[k] for k in snake([self.candidates.points[k] for k in batch])]

    def _batch_s(self, batch: Sequence[int], seconds: Floats) -> float:
        """How long a batch takes [s], with visits of `seconds` to the candidates."""
        order = self._ordered(batch)
        poses = [self.candidates.poses[k] for k in order]
        return expected.batch_s(self.durations, poses, [float(seconds[k]) for k in order], self._here)


def highest(score: Floats) -> int:
    """The first place of the highest score; scores that differ by rounding alone are equal."""
    return int(np.argmax(np.round(score / max(float(score.max()), 1e-300), 9)))


def short(value: float | None) -> float | None:
    """Three digits, for the journal."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.3g}")
