"""What the pages of a comparison are printed from, and `summary.json` holds: samples with their fits, in numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gonio import shown
from gonio.checks.symmetry import Pairs
from gonio.formats.reader import TableBand
from gonio.run_facts import RunFacts
from gonio_analysis.report.across import Across
from gonio_analysis.report.drawing import Described
from gonio_analysis.result_records import (
    WHERE_KNOWN,
    Appearance,
    CauseSummary,
    ChecksSummary,
    MeasuredValue,
    Reflectance,
)
from gonio_analysis.selection.across_models import AcrossModels
from gonio_analysis.selection.beyond_reflection import MuellerFacts, Transmitted
from gonio_analysis.selection.choice import ModelChoice
from gonio_analysis.selection.compare import FittedModel


@dataclass(frozen=True)
class DatasetSummary:
    """One measured sample with every model that was fitted to it."""

    name: str
    slug: str
    source: str
    format: str | None
    quantity: str
    rows: int
    rows_here: int
    used: int
    left_out: Mapping[str, int]
    left_out_words: str
    negative: int
    wavelength_nm: float | None
    wavelengths_nm: list[float | None]
    bands: list[TableBand]
    source_solid_angle_sr: float | None
    receiver_solid_angle_sr: float | None
    uncertainty_stated: bool
    u_rel_assumed: float | None
    causes: list[str]
    theta_i_deg: list[float]
    brdf_min: float
    brdf_max: float
    median_u_rel: float | None
    budget: list[CauseSummary]
    curves_known: int
    scanned: str | None
    out_of_plane_deg: float
    curves_without_mirror: list[float]
    notes: list[str]
    data_notes: list[str]
    provenance: Any
    """As the table has it, whoever wrote it."""
    run: RunFacts | None
    models: dict[str, FittedModel]
    skipped: dict[str, str]
    choice: ModelChoice
    values: list[MeasuredValue]
    usable_everywhere: int
    best: str | None
    verdict: str
    """The answer, in one or two sentences."""
    conclusion: str
    """The verdict, and what else is to be said about it."""
    remedy: str
    """What would mend the fit of a metal whose index is not given; "" where nothing is wrong."""
    rho_dh: list[Reflectance]
    """Directional-hemispherical reflectances of the measurement itself."""
    rho_dh_near: dict[str, list[Reflectance]]
    """rho_dh of each model that cannot be told from the nearest (`ModelChoice.near`), also where `models` lacks it."""
    rho_dh_combined: list[Reflectance]
    """rho_dh of these models together; empty where one is true."""
    symmetries: list[Pairs]
    sections: dict[str, Any] | None = field(default=None, metadata=WHERE_KNOWN)
    """Numbers of sections of their own (`gonio_analysis.report.section`), by their names."""
    appearance: Appearance | None = None
    """None where a table is too large for a quick look."""
    transmission: Transmitted | None = None
    """None where the table holds reflection alone."""
    mueller: MuellerFacts | None = None
    simulated: bool = False
    """Whether a simulation made the values."""
    checks: ChecksSummary | None = None

    @property
    def title(self) -> str:
        """The name, with a mark where the values are simulated."""
        return shown.marked(self.name, self.simulated)


@dataclass(frozen=True)
class Comparison:
    """What is said of several samples beside each other."""

    verdict: list[str]
    """At most two sentences, without models."""
    details: list[str]
    """What it rests on, in sentences."""
    across: Across | None
    """None where nothing but the models is known."""
    models: AcrossModels | None
    """What models say, in `words`, and `remedies`; None where none was fitted."""


@dataclass(frozen=True)
class Summary:
    """A comparison of models on one or more samples."""

    title: str
    created: str
    command: str
    versions: dict[str, str]
    normalise: str
    models: list[str]
    in_plane_tolerance_deg: float
    mirror_tolerance_deg: float
    log_metrics_above_u: float
    metrics: dict[str, dict[str, str]]
    """Label and meaning of each."""
    datasets: list[DatasetSummary]
    comparison: Comparison | None = field(default=None, metadata=WHERE_KNOWN)
    """Of several samples beside each other; None of one."""
    transmission_only: Sequence[Transmitted] = field(default_factory=list)
    """Samples of which no reflection was measured."""
    figures: Sequence[Described] = ()
    tables: Sequence[str] = ()
