"""What `results.json` of `gonio bench coverage` holds, key by key: the page and its drawings are made from these."""

from collections.abc import Sequence
from dataclasses import dataclass

from gonio_validation.bench.results import Machine

LEVEL = 0.95
"""Of every interval that is judged, and of those of what is counted here."""


@dataclass(frozen=True)
class Count:
    """In how many campaigns an interval of 95 % holds the truth."""

    kind: str
    """"points", "joint", "parameters", "joint parameters", "wrong" or "calibrated"."""
    what: str
    """The quantity."""
    group: str
    """Of which campaigns: "all", or those of a model, a plan or a region; of "parameters" model and parameter."""
    campaigns: int
    inside: int
    low: float
    """Clopper-Pearson interval (95 %) of the coverage."""
    high: float

    @property
    def holds(self) -> bool:
        """Whether the interval contains 95 %."""
        return self.low <= LEVEL <= self.high


@dataclass(frozen=True)
class Pulls:
    """(found - true) / u, one number a campaign."""

    kind: str
    what: str
    group: str
    campaigns: int
    mean: float
    u_mean: float
    """Standard error of the mean."""
    sd: float
    sd_low: float
    """Interval (95 %) of the standard deviation: campaigns drawn again with replacement."""
    sd_high: float
    largest: float


@dataclass(frozen=True)
class Uniform:
    """Probabilities that are uniform between 0 and 1 where the stated covariance is right, one a campaign."""

    what: str
    campaigns: int
    p_uniform: float
    """Kolmogorov and Smirnov's test of that."""
    bins: Sequence[int]
    """Campaigns in ten equal bins."""


@dataclass(frozen=True)
class Worst:
    """A point far off, to be looked at."""

    campaign: int
    model: str
    plan: str
    region: str
    theta_i_deg: float
    theta_r_deg: float
    dphi_deg: float
    brdf: float
    truth: float
    u_brdf: float
    pull: float


@dataclass(frozen=True)
class Failed:
    """A campaign that a program refused."""

    campaign: int
    model: str
    plan: str
    step: str
    message: str


@dataclass(frozen=True)
class CauseSummary:
    """One error: what is hidden, and what the laboratory knows of it."""

    name: str
    hidden: str
    learned: str
    on: bool


@dataclass(frozen=True)
class Coverage:
    """Every number of the report."""

    title: str
    created: str
    command: str
    quick: bool
    seed: int
    campaigns: int
    values: int
    """Of BRDF, in all campaigns together."""
    seconds: float
    """What the campaigns took, summed over processes."""
    machine: Machine
    causes: Sequence[CauseSummary]
    counts: Sequence[Count]
    pulls: Sequence[Pulls]
    uniform: Sequence[Uniform]
    single_pulls: Sequence[float]
    """Of the one point a campaign that is judged."""
    parameter_pulls: Sequence[float]
    """Of the one fitted parameter a campaign that is judged."""
    worst: Sequence[Worst]
    failed: Sequence[Failed]

    def count(self, kind: str, group: str = "all") -> Count | None:
        """The count of a kind over a group of campaigns; None where there is no campaign for it."""
        return next((c for c in self.counts if (c.kind, c.group) == (kind, group)), None)
