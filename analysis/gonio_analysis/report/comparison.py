"""Every number and every sentence of a report, as plain JSON: the page is printed from this and from nothing else."""

import math
from collections.abc import Sequence
from functools import partial

from gonio import shown
from gonio.geometry import AT_MIRROR, IN_PLANE
from gonio.lost import kept
from gonio_analysis.changes import sides
from gonio_analysis.fitting.objective import BELOW, DESCRIPTIONS
from gonio_analysis.report import across, across_words
from gonio_analysis.report.blocks import stamp
from gonio_analysis.report.facts import Comparison, DatasetSummary, Summary
from gonio_analysis.report.section import Section, facts_of
from gonio_analysis.report.text import slugs
from gonio_analysis.selection.across_models import across_models
from gonio_analysis.selection.beyond_reflection import Transmitted
from gonio_analysis.selection.compare import Dataset


def summarise(
    datasets: Sequence[Dataset], *, title: str, normalise: str, command: str, sections: Sequence[Section] = (),
    transmission_only: Sequence[Transmitted] = (),
) -> Summary:  # fmt: skip
    """The summary of a comparison; see `gonio_analysis.report.write`."""
    return Summary(
        title=_title(title, datasets),
        **stamp(command),
        normalise=normalise,
        models=list(dict.fromkeys(m for d in datasets for m in [*d.models, *d.skipped])),
        in_plane_tolerance_deg=math.degrees(IN_PLANE),
        mirror_tolerance_deg=math.degrees(AT_MIRROR),
        log_metrics_above_u=BELOW,
        metrics={k: {"label": label, "meaning": meaning} for k, (label, meaning) in DESCRIPTIONS.items()},
        datasets=[
            DatasetSummary.of(d, slug, facts_of(sections, d))
            for d, slug in zip(datasets, slugs([d.name for d in datasets]), strict=True)
        ],
        comparison=_comparison(datasets) if len(datasets) > 1 else None,
        transmission_only=transmission_only,
    )


def _comparison(datasets: Sequence[Dataset]) -> Comparison:
    """The first sample against every other one, without and with models."""
    beside = partial(across.across, wavelength_nm=datasets[0].wavelength_nm)
    found = kept("the comparison of samples", lambda: beside(sides_of(datasets)), lambda loss: None)
    models = kept("what models say of all samples", lambda: across_models(datasets), lambda loss: None)
    said = ([], []) if found is None else (across_words.verdict(found), across_words.details(found))
    return Comparison(*said, found, models if any(d.models for d in datasets) else None)


def sides_of(datasets: Sequence[Dataset]) -> list[sides.Side]:
    """Samples with all their wavelengths, for what compares them point by point."""
    made = sides.of_table
    return [made(d.name, d.source, d.table, d.data.u_rel_assumed) for d in datasets]


def _title(title: str, datasets: Sequence[Dataset]) -> str:
    """The heading, in which samples whose values are simulated are marked."""
    if len(datasets) <= 1:
        return shown.marked(title, any(d.simulated for d in datasets))
    if len(datasets) == 2 and title == " and ".join(d.name for d in datasets):
        return " and ".join(d.title for d in datasets)
    simulated = sum(d.simulated for d in datasets)
    if 0 < simulated < len(datasets):
        return f"{title}, {simulated} of them simulated"
    return shown.marked(title, simulated > 0)
