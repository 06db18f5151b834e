"""What a run's own record says of how its table was made: the laboratory tells it, and pages show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gonio import plugins
from gonio.typing import JsonObject


def of(path: Path) -> RunFacts | None:
    """What the record of a RUN folder says, or of the one that a table lies in; None for a path that is no run."""
    for name in plugins.available("gonio.records"):
        found: RunFacts | None = plugins.load("gonio.records", name)(path)
        if found is not None:
            return found
    return None


@dataclass(frozen=True)
class SampleFacts:
    """The sample of a simulated run."""

    name: str
    model: str
    parameters: JsonObject


@dataclass(frozen=True)
class HealthSummary:
    """One quantity of one device over a run: its extremes, and enough values to draw it."""

    device: str
    quantity: str
    unit: str
    steps: int
    """Steps at which it was read."""
    lowest: float
    lowest_h: float
    """When, in hours from the run's first step."""
    median: float
    highest: float
    highest_h: float
    time_h: list[float]
    value: list[float]
    """The lowest and the highest value in every stretch of the run."""


@dataclass(frozen=True)
class PauseSummary:
    """A time for which a run waited."""

    message: str
    begun_h: float
    waited_s: float | None
    """None where the run ended meanwhile."""


@dataclass(frozen=True)
class ReferenceLevel:
    """What the white reference said in one session, in one band."""

    band: str
    visits: int
    relative: float
    """Mean signal of the visits, relative to that of the first session that has one in this band."""
    scatter: float | None
    """Standard deviation of the visits, relative to the same; None of one visit."""


@dataclass(frozen=True)
class SessionSummary:
    """From the start of the program that measured to its last line in the journal."""

    began: str
    ended: str
    """By the computer's clock, UTC (ISO 8601)."""
    steps: int
    ending: str
    levels: list[ReferenceLevel]
    """One a band; empty where the run is not reduced, or this session has no visit."""


@dataclass(frozen=True)
class BudgetPart:
    """One cause in the budget of a run's values, relative to them (k = 1)."""

    cause: str
    common: bool
    """Whether all values share it (a column `s_...` of the table)."""
    median: float
    largest: float
    share: float
    """Share of the variance, mean over the values."""


@dataclass(frozen=True)
class BudgetCurve:
    """Shares of the variance along the curve of one angle of incidence through the plane."""

    theta_i_deg: float
    theta_r_deg: list[float]
    """Signed: positive on the mirror side."""
    shares: list[list[float]]
    """For each of `BudgetFacts.largest`, one number a value."""


@dataclass(frozen=True)
class BudgetFacts:
    """The parts of the uncertainties of a run's values (RUN/budget.csv) at one wavelength, largest share first."""

    wavelength_nm: float | None
    values: int
    """How many are in it: those within 3 u of zero are not."""
    median: float
    highest: float
    """Highest value of u_brdf / |brdf|."""
    median_apart: float
    highest_apart: float
    """The same without the certificate of the white reference."""
    parts: list[BudgetPart]
    largest: list[str]
    """The causes whose shares are drawn."""
    curves: list[BudgetCurve]
    nu_eff: float | None
    """Smallest effective degrees of freedom; None where no part rests on a scatter."""
    coarse: int
    """How many values lie beside a lobe that the plan's steps do not resolve."""
    left_out: dict[str, str]
    """Cause -> why it is not in the budget."""
    monte_carlo: str | None
    """The verdict of draws of the inputs, where they were asked for."""


@dataclass(frozen=True)
class RunFacts:
    """What a run's own record says of how its table was made."""

    folder: str
    plan: str
    plan_sha256: str
    points: int
    points_not_reachable: dict[str, int]
    created: str
    command: str
    rig: str
    driver: str
    seed: int | None
    bands: list[str]
    steps: int
    versions: dict[str, str]
    lamp_half_angle_deg: float
    lens_half_angle_deg: float
    reference: str
    sample: SampleFacts | None
    health: list[HealthSummary] = field(default_factory=list)
    """Empty for runs from before it was kept, and on rigs that read nothing."""
    pauses: list[PauseSummary] = field(default_factory=list)
    budget: list[BudgetFacts] = field(default_factory=list)
    """One a wavelength; empty for runs that an older version reduced."""
    sessions: list[SessionSummary] = field(default_factory=list)
    """Sessions in which steps were taken."""
