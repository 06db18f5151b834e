"""What `summary.json` of a comparison of two measurements, or of a measurement and a model, holds, key by key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gonio_analysis.result_records import WHERE_KNOWN, FigureSummary, RunFacts


@dataclass(frozen=True)
class SideSummary:
    """One of two sides."""

    name: str
    source: str
    kind: str
    run: RunFacts | None


@dataclass(frozen=True)
class MeasuredSide(SideSummary):
    """A measurement."""

    values: int
    left_out: Mapping[str, int]
    uncertainty_stated: bool
    simulated: bool
    """Whether a simulation made the values."""


@dataclass(frozen=True)
class ModelSide(SideSummary):
    """A model."""

    model: str
    convention: str


@dataclass(frozen=True)
class VerdictSummary:
    """Whether the two differ, as `gonio_analysis.changes.verdict.Verdict`."""

    changed: bool
    found_by: Sequence[str]
    chi_square: float
    p_value: float
    n_points: int
    beyond_2: int
    expected_beyond_2: float
    largest: float
    p_largest: float
    changed_points: int
    false_discoveries: float
    level: float
    scale: float
    u_scale: float
    p_scale: float


@dataclass(frozen=True)
class ChangeMetric:
    """A distance between the two."""

    label: str
    value: float | None


@dataclass(frozen=True)
class ChangeAtWavelength:
    """The values at one wavelength, or in a broad band; counts are known where uncertainties are stated."""

    wavelength_nm: float | None
    n_points: int
    beyond: int | None = field(default=None, metadata=WHERE_KNOWN)
    changed_points: int | None = field(default=None, metadata=WHERE_KNOWN)
    median_ratio: float | None = None


@dataclass(frozen=True)
class WithinSummary:
    """Within what the two agree, relative, as `gonio_analysis.changes.verdict.Within`."""

    as_they_are: float
    with_scale: float
    scale: float
    with_zero: float | None
    zero_deg: float | None


@dataclass(frozen=True)
class ChangeSummary:
    """Two things compared point by point."""

    title: str
    created: str
    command: str
    versions: dict[str, str]
    a: MeasuredSide | ModelSide
    b: MeasuredSide | ModelSide
    n_points: int
    in_directions_of: str
    interpolated: int
    median_interpolation_error_rel: float | None
    without_counterpart: Mapping[str, int]
    verdict: VerdictSummary | None
    identical: bool
    agree_within: WithinSummary
    conclusion: str
    metrics: dict[str, ChangeMetric]
    wavelengths: list[ChangeAtWavelength]
    notes: list[str]
    shown_wavelength_nm: float | None = None
    figures: Sequence[FigureSummary] = ()
    tables: Sequence[str] = ()
