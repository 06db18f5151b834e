"""What `summary.json` of `gonio bench models` holds, key by key: page, drawings and tables are made from these."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Set = Literal["grid", "hard"]
"""The stated grid of directions, and the hard cases."""
SETS: tuple[Set, ...] = ("grid", "hard")


# --- ways of evaluating a quantity --------------------------------------------------------------------------------


@dataclass(frozen=True)
class ErrorSummary:
    """Relative errors on one set; None where a result is not finite."""

    points: int
    max: float | None
    p99: float | None
    median: float | None
    max_scaled: float | None
    """The largest over 1 + conditioning."""
    not_finite: int
    warning: bool


@dataclass(frozen=True)
class TimeSummary:
    """What an evaluation takes [ns]."""

    best_ns: float
    median_ns: float
    processor_ns: float
    """Summed over threads, the least of the repeats."""
    pairs: int
    """Evaluations a repeat."""
    repeats: int


@dataclass(frozen=True)
class PeerTime(TimeSummary):
    """The same of a peer, in a process of its own."""

    threads: int | None
    """Of its process, idle ones included; None where the system does not say."""


@dataclass(frozen=True)
class WaySummary:
    """Errors and times of one way of evaluating a quantity."""

    way: str
    ours: bool
    peer: bool
    note: str
    stated: float | None
    """The accuracy that it promises: relative error over 1 + conditioning."""
    errors: dict[Set, ErrorSummary]
    """Nothing where its results are not comparable."""
    time: TimeSummary
    on_front_grid: bool
    on_front_hard: bool

    def on_front(self, kind: Set) -> bool:
        """Whether no other way is faster and better on this set."""
        return self.on_front_grid if kind == "grid" else self.on_front_hard

    @property
    def worst(self) -> float | None:
        """The largest error over 1 + conditioning on all sets; None where a result is not finite."""
        found = [e.max_scaled for e in self.errors.values()]
        return None if None in found else max(x for x in found if x is not None)


@dataclass(frozen=True)
class QuantitySummary:
    """Every way of evaluating one quantity."""

    name: str
    title: str
    about: str
    inputs: str
    ways: Sequence[WaySummary]

    @property
    def sets(self) -> list[Set]:
        """The sets that a way was held against."""
        return [kind for kind in SETS if any(kind in w.errors for w in self.ways)]


# --- what is judged -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TargetSummary:
    """A time, or a ratio of times, against its target."""

    what: str
    target: str
    achieved: float
    unit: str
    time_met: bool


@dataclass(frozen=True)
class WayTargetSummary(TargetSummary):
    """The time and the error of one way against their targets."""

    processor_ns: float
    target_error: float
    achieved_error: float | None
    error_met: bool


@dataclass(frozen=True)
class ToleranceSummary:
    """An accuracy that a way states, against its largest error over 1 + conditioning."""

    family: str
    way: str
    stated: float
    points: int
    worst: float | None
    holds: bool


@dataclass(frozen=True)
class HardCaseSummary:
    """A hard case: digits at the point with the least to spare, and what must not come out."""

    case: str
    models: list[str]
    points: int
    expected_digits: float
    achieved_digits: float
    nan: int
    infinite: int
    negative: int
    warning: bool
    holds: bool
    note: str


# --- calls, processes, machine ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SingleCallSummary:
    """One geometry from Python [us]."""

    model: str
    call: str
    best_us: float
    median_us: float


@dataclass(frozen=True)
class HandOverSummary:
    """What it costs to share a call between two threads: medians [us]."""

    model: str
    pairs: int
    shared_us: float
    half_alone_us: float
    hand_over_us: float
    share: float
    """Of the shared call."""
    repeats: int


@dataclass(frozen=True)
class StartUpSummary:
    """A fresh process with compiled code already cached [s]."""

    model: str
    import_s: float
    first_evaluation_s: float
    together_s: float


@dataclass(frozen=True)
class PeerState:
    """What was found of a peer, in words."""

    peer: str
    state: str


@dataclass(frozen=True)
class Machine:
    """What the times are taken on, and how busy it was."""

    cpu: str
    cpus: int
    flags: list[str]
    load: list[float] | None
    system: str
    python: str
    versions: dict[str, str]


@dataclass(frozen=True)
class SpeedAndError:
    """Every number of the report."""

    title: str
    created: str
    command: str
    quick: bool
    machine: Machine
    reference: dict[str, str]
    families: Sequence[QuantitySummary]
    targets: Sequence[TargetSummary]
    tolerances: Sequence[ToleranceSummary]
    hard_cases: Sequence[HardCaseSummary]
    single_calls: Sequence[SingleCallSummary]
    hand_over: HandOverSummary | None
    start_up: Sequence[StartUpSummary]
    peers: Sequence[PeerState]
