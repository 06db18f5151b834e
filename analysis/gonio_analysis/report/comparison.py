"""Every number and every sentence of a report, as plain JSON: the page is printed from this and from nothing else."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from gonio import shown
from gonio.checks.symmetry import Pairs
from gonio.geometry import AT_MIRROR, IN_PLANE
from gonio.lost import kept
from gonio.shown import finite
from gonio.typing import DataFrame
from gonio_analysis.appearance.quantities import of_table
from gonio_analysis.changes import point_by_point
from gonio_analysis.fitting.objective import BELOW, DESCRIPTIONS
from gonio_analysis.fitting.observations import describe_left_out
from gonio_analysis.report import across, across_words, checks, verdict
from gonio_analysis.report.blocks import stamp
from gonio_analysis.report.facts import Comparison, DatasetSummary, Summary
from gonio_analysis.report.text import number, slugs, spoken_difference
from gonio_analysis.result_records import Appearance, MeasuredValue, as_json
from gonio_analysis.selection.across_models import across_models, remedy
from gonio_analysis.selection.compare import Dataset
from gonio_analysis.selection.judging import nearness

T = TypeVar("T")

MOST_VALUES = 200
"""Measured values that a page lists where it has no model."""
MOST_FOR_APPEARANCE = 100_000
"""Rows of a table whose quantities of appearance are worked out along the way."""
MOST_LISTED = 40
"""Curves that a note names one by one."""
MOST_REASONS = 12
"""Why values were left out, in words on the page; `left_out` has all."""
VALUES = ("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "brdf", "u_brdf")


def summarise(datasets: Sequence[Dataset], *, title: str, normalise: str, command: str) -> Summary:
    """The summary of a comparison; see `gonio_analysis.report.write`."""
    return Summary(
        title=_title(title, datasets),
        **stamp(command),
        normalise=normalise,
        models=list(dict.fromkeys(m for d in datasets for m in [*d.fitted, *d.skipped])),
        in_plane_tolerance_deg=math.degrees(IN_PLANE),
        mirror_tolerance_deg=math.degrees(AT_MIRROR),
        log_metrics_above_u=BELOW,
        metrics={k: {"label": label, "meaning": meaning} for k, (label, meaning) in DESCRIPTIONS.items()},
        datasets=[_dataset(d, slug) for d, slug in zip(datasets, slugs([d.name for d in datasets]), strict=True)],
        comparison=_comparison(datasets) if len(datasets) > 1 else None,
    )


def _comparison(datasets: Sequence[Dataset]) -> Comparison:
    """The first sample against every other one, without and with models."""
    beside = partial(across.across, wavelength_nm=finite(datasets[0].wavelength_nm))
    found = kept("the comparison of samples", lambda: beside(sides_of(datasets)), lambda loss: None)
    models = kept("what models say of all samples", lambda: across_models(datasets), lambda loss: None)
    said = ([], []) if found is None else (across_words.verdict(found), across_words.details(found))
    return Comparison(*said, found, models if any(d.fitted for d in datasets) else None)


def sides_of(datasets: Sequence[Dataset]) -> list[point_by_point.Side]:
    """Samples with all their wavelengths, for what compares them point by point."""
    made = point_by_point.of_table
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


def _dataset(d: Dataset, slug: str) -> DatasetSummary:
    attrs, covariance, best = d.table.attrs, d.data.covariance, _best(d)

    def known(what: str, make: Callable[[], T], instead: T) -> T:
        return kept(f"{what} of {d.name}", make, lambda _: instead)

    symmetries = known("symmetries", lambda: d.symmetries, list[Pairs]())
    said = known("the headline", lambda: _conclusion(d, best, symmetries), [d.choice.words])
    stated = covariance is not None and d.data.u_rel_assumed is None
    provenance = attrs.get("provenance") or {}
    return DatasetSummary(
        name=d.name,
        slug=slug,
        source=d.source,
        format=attrs.get("format"),
        quantity=attrs.get("quantity", "brdf"),
        rows=len(d.table),
        rows_here=len(d.data) + sum(d.data.left_out.values()),
        used=len(d.data),
        left_out=d.data.left_out,
        left_out_words=_left_out(d.data.left_out),
        negative=int(np.count_nonzero(d.data.brdf < 0)),
        wavelength_nm=finite(d.wavelength_nm),
        wavelengths_nm=[finite(w) for w in d.wavelengths],
        bands=attrs.get("bands") or [],
        source_solid_angle_sr=finite(attrs.get("source_solid_angle_sr")),
        receiver_solid_angle_sr=finite(attrs.get("receiver_solid_angle_sr")),
        uncertainty_stated=stated,
        u_rel_assumed=d.data.u_rel_assumed,
        causes=[] if covariance is None else list(covariance.causes),
        theta_i_deg=[float(x) for x in np.unique(np.round(np.degrees(d.data.directions.theta_i), 1))],
        brdf_min=float(d.data.brdf.min()),
        brdf_max=float(d.data.brdf.max()),
        median_u_rel=None if covariance is None else _median_u_rel(d),
        budget=known("the budget", d.data.budget, []) if stated else [],
        curves_known=d.curves_known,
        scanned=d.curves[0].scanned if d.curves else None,
        out_of_plane_deg=math.degrees(max((c.out_of_plane for c in d.curves), default=0.0)),
        curves_without_mirror=[round(math.degrees(angle), 4) for angle, _ in d.without_mirror],
        notes=_notes(d),
        data_notes=list(d.data.notes),
        provenance=_plain(provenance),
        run=d.run,
        models=d.fitted,
        skipped=dict(d.skipped),
        choice=d.choice,
        values=[] if d.fitted else _values(d),
        usable_everywhere=len(usable(d)),
        best=best,
        verdict=said[0],
        conclusion=" ".join(said),
        remedy=known("the remedy", lambda: _remedy(d), ""),
        appearance=known("quantities of appearance", lambda: _appearance(d), None),
        transmission=d.transmitted,
        mueller=known("Mueller matrices", lambda: d.polarisation, None),
        simulated=d.simulated,
        checks=known("checks", lambda: checks.summary(d.data.checked, symmetries, provenance, _bands(d)), None),
        rho_dh=known("rho_dh", lambda: d.rho_dh, []),
        rho_dh_near=known("rho_dh of models that are as near", lambda: d.rho_dh_near, {}),
        rho_dh_combined=known("rho_dh with the misfit", lambda: d.rho_dh_combined, []),
        symmetries=symmetries,
    )


def _remedy(d: Dataset) -> str:
    found = remedy(d) if d.fitted else None
    return "" if found is None else found.words


def _appearance(d: Dataset) -> Appearance | None:
    if len(d.table) > MOST_FOR_APPEARANCE:
        return None
    return of_table(d.table, name=d.name, source=d.source, wavelength_nm=finite(d.wavelength_nm))


def _median_u_rel(d: Dataset) -> float | None:
    with np.errstate(divide="ignore"):  # of a value of 0 it is infinite, and counts as the largest
        return finite(float(np.median(d.data.u / np.abs(d.data.brdf))))


def _bands(d: Dataset) -> list[str]:
    """The names of the bands of the wavelength that is shown."""
    shown = [b for b in d.table.attrs.get("bands") or [] if b.get("centre_nm") == finite(d.wavelength_nm)]
    return [str(b["name"]) for b in shown if b.get("name")]


def _left_out(reasons: Mapping[str, int]) -> str:
    """The most frequent reasons, and how many there are besides."""
    first = dict(sorted(reasons.items(), key=lambda item: -item[1])[:MOST_REASONS])
    rest = sum(reasons.values()) - sum(first.values())
    more = f", {rest} for {len(reasons) - len(first)} other reasons" if rest else ""
    return describe_left_out(first) + more


def usable(d: Dataset) -> DataFrame:
    """The rows of every wavelength that have a value and no flag, with the columns that a page lists."""
    kept = (d.table["flag"].fillna("") == "") & d.table["brdf"].notna()
    if "side" in d.table.columns:
        kept &= d.table["side"] == "reflection"
    return d.table.loc[kept, list(VALUES)]


def _values(d: Dataset) -> list[MeasuredValue]:
    """The measured values of every wavelength, where no model can say anything of them: the first few."""
    return [
        MeasuredValue(finite(nm), theta_i, phi_i, theta_r, phi_r, brdf, finite(u))
        for nm, theta_i, phi_i, theta_r, phi_r, brdf, u in usable(d).head(MOST_VALUES).itertuples(index=False)
    ]


def _best(d: Dataset) -> str | None:
    """The model to put first, as the choice among models says it; of those that are shown."""
    chosen = d.choice.best
    if chosen is not None and chosen.candidate.label in d.fitted:
        return chosen.candidate.label
    aic = {j.candidate.label: j.aic for j in d.choice.judged}
    return min(d.fitted, key=lambda name: aic.get(name, math.inf)) if d.fitted else None


def _conclusion(d: Dataset, best: str | None, symmetries: Sequence[Pairs]) -> list[str]:
    """The verdict in one or two sentences, and after it what else is to be said."""
    if best is None:
        return [f"No model was fitted. {d.choice.words}"]
    f, tried = d.fitted[best], len(d.choice.judged)
    ratio, chi = f.metrics["log_ratio"], f.fit.reduced_chi_square
    typical = "" if ratio is None else f"; model and measurement differ typically by {spoken_difference(ratio)}"
    if f.fit.misfit is not None:
        told = [nearness(best, f.fit, f.missed, d.choice.near, tried)]
        if chi is None:
            told.append(
                "The table states no uncertainties, so nothing is accepted or rejected; --u-rel 0.03 judges the models"
                " with an assumed uncertainty of 3 % of each value."
            )
        elif f.fit.rejected:
            told.append(f"{best}: reduced chi-square {number(chi)}; {f.fit.by_chi_square}.")
    elif chi is not None:
        told = [verdict.of_true_model(best, f.fit, tried, named=d.choice.named is not None)]
        told.append(f"{typical[2:3].upper()}{typical[3:]}." if typical else "")
    else:
        others = f"the nearest of the {tried} models tried" if tried > 1 else "the only model tried"
        told = [f"{best} is {others}{typical}.", verdict.where(f.missed)]
        told.append(f"--metric {f.fit.goal.metric} takes no account of uncertainties: nothing is rejected.")
    warnings = [
        verdict.too_bright({name: other.rho_dh for name, other in d.fitted.items()}, best),
        f.fit.outside,
        verdict.direction_of_its_own(symmetries, d.fitted),
        verdict.disagreement({name: other.metrics for name, other in d.fitted.items()}, best),
    ]
    return [sentence for sentence in (*told, *warnings) if sentence]


def _notes(d: Dataset) -> list[str]:
    notes = list(d.data.notes)
    fits = [f.fit for f in d.fitted.values()]
    if len(fits) > 1:  # what every fit says belongs to the data
        notes += [n for n in fits[0].notes if n not in fits[0].data.notes and all(n in f.notes for f in fits)]
    if math.isnan(d.wavelength_nm) and any(not math.isnan(f.wavelength_nm) for f in fits):
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
    if d.curves_known > len(d.curves):
        notes.append(f"{len(d.curves)} of {d.curves_known} in-plane curves are drawn; all values are fitted.")
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
