"""What the pages of a comparison are printed from, and `summary.json` holds: samples with their fits, in numbers."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from typing import Any, Self

import numpy as np

from gonio.formats.reader import TableBand
from gonio.geometry import AT_MIRROR
from gonio.lost import kept
from gonio.shown import finite
from gonio.typing import DataFrame, JsonObject
from gonio_analysis.appearance.quantities import of_table
from gonio_analysis.fitting.observations import describe_left_out
from gonio_analysis.report import checks, verdict
from gonio_analysis.report.across import Across
from gonio_analysis.report.drawing import Described
from gonio_analysis.result_records import WHERE_KNOWN, Appearance, CauseSummary, ChecksSummary, as_json
from gonio_analysis.selection.across_models import AcrossModels, remedy
from gonio_analysis.selection.beyond_reflection import Transmitted
from gonio_analysis.selection.compare import Dataset, worked_out

MOST_VALUES = 200
"""Measured values that a page lists where it has no model."""
MOST_FOR_APPEARANCE = 100_000
"""Rows of a table whose quantities of appearance are worked out along the way."""
MOST_LISTED = 40
"""Curves that a note names one by one."""
MOST_REASONS = 12
"""Why values were left out, in words on the page; `left_out` has all."""
VALUES = ("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "brdf", "u_brdf")


@dataclass(frozen=True, repr=False)
class DatasetSummary(Dataset):
    """One measured sample with its fits, and what its part of the page and `summary.json` say of it."""

    slug: str
    """Its name in file names and identifiers of the page."""
    sections: Mapping[str, Any]
    """Numbers of sections of their own (`gonio_analysis.report.section`), by their names."""

    @classmethod
    def of(cls, d: Dataset, slug: str, sections: Mapping[str, Any] | None = None) -> Self:
        """The same sample, ready for a page."""
        return cls(**{f.name: getattr(d, f.name) for f in fields(Dataset)}, slug=slug, sections=sections or {})

    @cached_property
    def headline(self) -> list[str]:
        """The verdict, and after it what else is to be said, in sentences."""
        what = f"the headline of {self.name}"
        return kept(what, lambda: verdict.headline(self), lambda _: [self.choice.words])

    @property
    def verdict(self) -> str:
        """The answer, in one or two sentences."""
        return self.headline[0]

    @property
    def conclusion(self) -> str:
        """The verdict, and what else is to be said about it."""
        return " ".join(self.headline)

    @worked_out("the remedy", "")
    def remedy(self) -> str:
        """What would mend the fit of a metal whose index is not given; "" where nothing is wrong."""
        found = remedy(self)
        return "" if found is None else found.words

    @worked_out("quantities of appearance", None)
    def appearance(self) -> Appearance | None:
        """None where a table is too large for a quick look, or has polarised light alone."""
        if len(self.table) > MOST_FOR_APPEARANCE or self.data.light is not None:
            return None
        return of_table(self.table, name=self.name, source=self.source, wavelength_nm=self.wavelength_nm)

    @cached_property
    def checks(self) -> ChecksSummary | None:
        """Of the values at the wavelength that is shown, and of the run that measured them."""
        names = [str(b["name"]) for b in self.bands_shown if b.get("name")]
        given = self.table.attrs.get("provenance") or {}
        found = partial(checks.summary, self.data.checked, self.symmetries, given, names)
        return kept(f"checks of {self.name}", found, lambda _: None)

    @property
    def provenance(self) -> JsonObject:
        """As the table has it, whoever wrote it."""
        return dict(_plain(self.table.attrs.get("provenance") or {}))

    @property
    def bands(self) -> list[TableBand]:
        """The bands that the table states."""
        return self.table.attrs.get("bands") or []

    @property
    def bands_shown(self) -> list[TableBand]:
        """Those of the wavelength that is shown."""
        return [b for b in self.bands if b.get("centre_nm") == self.wavelength_nm]

    @property
    def uncertainty_stated(self) -> bool:
        """Whether the table states uncertainties, and none is assumed."""
        return self.data.covariance is not None and self.data.u_rel_assumed is None

    @property
    def causes(self) -> list[str]:
        """Causes of uncertainty that are common to all values."""
        return [] if self.data.covariance is None else list(self.data.covariance.causes)

    @property
    def median_u_rel(self) -> float | None:
        """Median of u / value; None where no uncertainty is known."""
        if self.data.covariance is None:
            return None
        with np.errstate(divide="ignore"):  # of a value of 0 it is infinite, and counts as the largest
            return finite(float(np.median(self.data.u / np.abs(self.data.brdf))))

    @worked_out("the budget", list[CauseSummary]())
    def budget(self) -> list[CauseSummary]:
        """Uncertainty by cause, where it is stated."""
        return self.data.budget() if self.uncertainty_stated else []

    @property
    def rows_here(self) -> int:
        """Values at the wavelength that is shown, used or left out."""
        return len(self.data) + sum(self.data.left_out.values())

    @property
    def left_out_words(self) -> str:
        """The most frequent reasons why values were left out, and how many there are besides."""
        reasons = self.data.left_out
        first = dict(sorted(reasons.items(), key=lambda item: -item[1])[:MOST_REASONS])
        rest = sum(reasons.values()) - sum(first.values())
        more = f", {rest} for {len(reasons) - len(first)} other reasons" if rest else ""
        return describe_left_out(first) + more

    @property
    def negative(self) -> int:
        """How many of the values are below 0."""
        return int(np.count_nonzero(self.data.brdf < 0))

    @property
    def theta_i_deg(self) -> list[float]:
        """The angles of incidence, in tenths of a degree."""
        return [float(x) for x in np.unique(np.round(np.degrees(self.data.directions.theta_i), 1))]

    @property
    def scanned(self) -> str | None:
        """Which angle runs along the curves; None without one."""
        return self.curves[0].scanned if self.curves else None

    @property
    def out_of_plane_deg(self) -> float:
        """How far the values of curves lie out of the plane of incidence, at most."""
        return math.degrees(max((c.out_of_plane for c in self.curves), default=0.0))

    @cached_property
    def usable(self) -> DataFrame:
        """The rows of every wavelength that have a value and no flag, with the columns that a page lists."""
        use = (self.table["flag"].fillna("") == "") & self.table["brdf"].notna()
        if "side" in self.table.columns:
            use &= self.table["side"] == "reflection"
        return self.table.loc[use, list(VALUES)]

    @property
    def values(self) -> list[dict[Hashable, float]]:
        """The first few of these, where no model can say anything of them."""
        return [] if self.models else self.usable.head(MOST_VALUES).to_dict("records")

    @cached_property
    def notes(self) -> list[str]:
        """What is to be known of the values, of their curves and of all fits, in sentences."""
        return _notes(self)

    def summary(self) -> JsonObject:
        """As `summary.json` holds it."""
        d, attrs = self.data, self.table.attrs
        return {
            "name": self.name,
            "slug": self.slug,
            "source": self.source,
            "format": attrs.get("format"),
            "quantity": attrs.get("quantity", "brdf"),
            "rows": len(self.table),
            "rows_here": self.rows_here,
            "used": len(d),
            "left_out": d.left_out,
            "left_out_words": self.left_out_words,
            "negative": self.negative,
            "wavelength_nm": self.wavelength_nm,
            "wavelengths_nm": self.wavelengths_nm,
            "bands": self.bands,
            "source_solid_angle_sr": attrs.get("source_solid_angle_sr"),
            "receiver_solid_angle_sr": attrs.get("receiver_solid_angle_sr"),
            "uncertainty_stated": self.uncertainty_stated,
            "u_rel_assumed": d.u_rel_assumed,
            "causes": self.causes,
            "theta_i_deg": self.theta_i_deg,
            "brdf_min": d.brdf.min(),
            "brdf_max": d.brdf.max(),
            "median_u_rel": self.median_u_rel,
            "budget": self.budget,
            "curves_known": len(self.every_curve),
            "scanned": self.scanned,
            "out_of_plane_deg": self.out_of_plane_deg,
            "curves_without_mirror": [round(math.degrees(angle), 4) for angle, _ in self.without_mirror],
            "notes": self.notes,
            "data_notes": d.notes,
            "provenance": self.provenance,
            "run": self.run,
            "models": self.models,
            "skipped": self.skipped,
            "choice": self.choice,
            "values": self.values,
            "usable_everywhere": len(self.usable),
            "best": self.best,
            "verdict": self.verdict,
            "conclusion": self.conclusion,
            "remedy": self.remedy,
            "rho_dh": self.rho_dh,
            "rho_dh_near": self.rho_dh_near,
            "rho_dh_combined": self.rho_dh_combined,
            "symmetries": self.symmetries,
            **({"sections": self.sections} if self.sections else {}),
            "appearance": self.appearance,
            "transmission": self.transmission,
            "mueller": self.mueller,
            "simulated": self.simulated,
            "checks": self.checks,
        }


def _notes(d: DatasetSummary) -> list[str]:
    notes = list(d.data.notes)
    fits = [f.fit for f in d.models.values()]
    if len(fits) > 1:  # what every fit says belongs to the data
        notes += [n for n in fits[0].notes if n not in fits[0].data.notes and all(n in f.notes for f in fits)]
    if d.wavelength_nm is None and any(not math.isnan(f.wavelength_nm) for f in fits):
        notes.append(
            "Models that need a wavelength are evaluated at the one given with --wavelength-nm"
            + (", not over the band." if d.table.attrs.get("bands") else "; the table states none.")
        )
    if not d.curves:
        notes.append("No in-plane curve: fewer than two values of any incidence lie in the plane of incidence.")
    elif d.curves[0].scanned == "theta_i":
        notes.append(
            "The detector stood still and the source moved: each curve has one θr, and the angle along it is θi."
        )
    if len(d.every_curve) > len(d.curves):
        notes.append(f"{len(d.curves)} of {len(d.every_curve)} in-plane curves are drawn; all values are fitted.")
    without = [label for _, label in d.without_mirror]
    if without:
        many = f"{len(without)} curves, from {without[0]} to {without[-1]}"
        named = ", ".join(without) if len(without) <= MOST_LISTED else many
        notes.append(f"The mirror direction was not measured (within {math.degrees(AT_MIRROR):.1f}°) for {named}.")
    sparse = [c for c in d.curves if c.angle.size < 20]
    if sparse:
        counts = sorted({c.angle.size for c in sparse})
        many = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
        where = "every curve" if len(sparse) == len(d.curves) else ", ".join(c.label for c in sparse)
        notes.append(f"Sparse plane: {many} in-plane values for {where}; dashed lines only join neighbours.")
    return notes


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bool | str | int | float | np.integer | np.floating) or value is None:
        return as_json(value)
    return str(value)


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
