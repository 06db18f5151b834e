"""The report on two things compared point by point (`gonio compare A B --change`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gonio.measurement import Reading
from gonio_analysis.changes.point_by_point import Change, Side, change, side
from gonio_analysis.changes.verdict import FALSE_DISCOVERIES, LEVEL
from gonio_analysis.curves.in_plane import Curve, curves, labels, selection
from gonio_analysis.fitting.metrics import DESCRIPTIONS, meaning
from gonio_analysis.fitting.observations import Observations, describe_left_out, of_reader, said_once
from gonio_analysis.plots import thinning
from gonio_analysis.report import change_figures, files, html, pdf, viewer
from gonio_analysis.report.blocks import (
    MOST_ROWS,
    Block,
    Figures,
    Footer,
    Group,
    Heading,
    Page,
    Paragraph,
    Table,
    Viewer,
    code,
    facts,
    lead,
    notes,
    table,
)
from gonio_analysis.report.change_records import (
    ChangeAtWavelength,
    ChangeMetric,
    ChangeSummary,
    MeasuredSide,
    ModelSide,
    VerdictSummary,
    WithinSummary,
)
from gonio_analysis.report.comparison import stamp
from gonio_analysis.report.drawing import FigureWorkers, figure_workers
from gonio_analysis.report.drawings import Figure
from gonio_analysis.report.page import MOST_BYTES
from gonio_analysis.report.tables import write_columns, write_csv
from gonio_analysis.report.text import difference, number, percent, with_u
from gonio_analysis.result_records import FigureSummary, RunFacts, as_json, finite
from gonio_analysis.selection.run_record import run_facts

FIGURES = 6
"""That a comparison has, about."""
CLOSER = 0.9
"""A scale or a zero is worth words where what it leaves is less than this share."""
SPIKE = 30.0
"""A largest value so many times the median hides all others in a polar plot: a logarithmic one comes first."""
COLUMNS = (
    *("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "a", "b", "u_interpolation", "change"),
    *("u_change", "standard_deviations", "changed"),
)

FOOTER = Footer(
    (
        *("Every number on this page is in ", code("summary.json"), ", every compared value in "),
        *(code("tables/change.csv"), ", the figures as SVG and PNG in ", code("figures/"), "."),
    )
)


def make(
    specs: Sequence[str],
    out: str | Path,
    *,
    wavelength_nm: float | None = None,
    u_rel: float | None = None,
    how: Reading | None = None,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Compare two sides and write a report: all of it or nothing.

    Parameters
    ----------
    specs
        Two of: table, RUN folder, `FILE:SAMPLE`, sample file of a model (.toml).
    out
        Folder of the report; an earlier report there is replaced.
    wavelength_nm
        The nearest common wavelength is drawn (all are judged); for two models, the one they are evaluated at.
    u_rel
        Relative standard uncertainty to assume of tables that state none.
    how
        Columns and blank of the tables, where they need any.
    command, progress
        The command line, for the record; called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.
    """
    with files.staged(out) as stage, figure_workers(FIGURES) as workers:
        a, b = (side(spec, how, u_rel) for spec in specs)
        if a.name == b.name:
            a, b = replace(a, name=f"{a.name} (A)"), replace(b, name=f"{b.name} (B)")
        progress(f"comparing {b.title} with {a.title}")
        found = change(a, b, wavelength_nm=wavelength_nm, say=progress)
        progress("drawing")
        _write(found, stage.work, wavelength_nm, command, [run_facts(Path(spec)) for spec in specs], workers, progress)
    return Path(out) / "index.html"


def _write(
    c: Change,
    folder: Path,
    wavelength_nm: float | None,
    command: str,
    runs: Sequence[RunFacts | None],
    workers: FigureWorkers,
    progress: Callable[[str], None],
) -> None:
    found = summary(c, command, runs)
    progress(found.conclusion)
    at, shown = _one(c, wavelength_nm)
    every = curves(at)
    listed = selection(every, viewer.MOST_LISTED)
    drawn = selection(every)
    figures = workers.draw(change_figures.draw(c, at, drawn, shown), progress)
    (folder / "tables").mkdir()
    write_columns(folder / "tables" / "change.csv", COLUMNS, _columns(c))
    listed_tables = ["change.csv"]
    if len(found.wavelengths) > 1:
        listed_tables.append("wavelengths.csv")
        waves = [as_json(w) for w in found.wavelengths]
        write_csv(folder / "tables" / "wavelengths.csv", list(waves[0]), (list(w.values()) for w in waves))
    found = replace(
        found,
        shown_wavelength_nm=finite(shown),
        figures=[FigureSummary(f.name, f.caption, f.alt) for f in figures],
        tables=listed_tables,
    )
    view = _view(c, at, listed, drawn, shown) if drawn else None
    page = _page(found, figures, view)
    files.write_page(folder, page, as_json(found), figures)
    pdf.write(folder / "report.pdf", [page])


def summary(c: Change, command: str, runs: Sequence[RunFacts | None]) -> ChangeSummary:
    """Every number of the page."""
    v = c.verdict
    positive = (c.value_a > 0) & (c.value_b > 0)
    ratio = np.full(len(c.at), np.nan)
    ratio[positive] = c.value_b[positive] / c.value_a[positive]
    waves = []
    for nm in c.at.wavelengths:
        here = np.isnan(c.at.wavelength_nm) if math.isnan(nm) else c.at.wavelength_nm == nm
        known = ratio[here & positive]
        waves.append(
            ChangeAtWavelength(
                wavelength_nm=finite(nm),
                n_points=int(here.sum()),
                beyond=None if v is None else int(np.count_nonzero(np.abs(v.z[here]) > 2)),
                changed_points=None if v is None else int(v.marked[here].sum()),
                median_ratio=float(np.median(known)) if known.size else None,
            )
        )
    verdict = None
    if v is not None:
        verdict = VerdictSummary(
            changed=v.changed,
            found_by=v.found_by,
            chi_square=v.chi_square,
            p_value=v.p_value,
            n_points=int(v.z.size),
            beyond_2=v.beyond,
            expected_beyond_2=v.expected,
            largest=v.largest,
            p_largest=v.p_largest,
            changed_points=int(v.marked.sum()),
            false_discoveries=FALSE_DISCOVERIES,
            level=LEVEL,
            scale=v.scale,
            u_scale=v.u_scale,
            p_scale=v.p_scale,
        )
    return ChangeSummary(
        title=f"{c.b.title} against {c.a.title}",
        **stamp(command),
        a=_side(c.a, runs[0]),
        b=_side(c.b, runs[1]),
        n_points=len(c.at),
        in_directions_of=c.onto,
        interpolated=int(np.count_nonzero(c.error)),
        median_interpolation_error_rel=_median_error(c),
        without_counterpart=c.missing,
        verdict=verdict,
        identical=c.identical,
        agree_within=_within(c),
        conclusion=_conclusion(c),
        metrics={k: ChangeMetric(DESCRIPTIONS[k][0], finite(c.metrics[k])) for k in DESCRIPTIONS},
        wavelengths=waves,
        notes=_notes(c),
    )


def _side(s: Side, run: RunFacts | None) -> MeasuredSide | ModelSide:
    if s.data is None:
        return ModelSide(s.name, s.source, s.kind, run, s.model.name, s.model.convention)
    stated = s.data.covariance is not None
    return MeasuredSide(s.name, s.source, s.kind, run, len(s.data), s.data.left_out, stated, s.simulated)


def _notes(c: Change) -> list[str]:
    """What the comparison says, and what the readers of both sides say."""
    told = said_once({x.name: of_reader(x.table) for x in (c.a, c.b) if x.table is not None})
    read = {note for x in (c.a, c.b) if x.table is not None for note in of_reader(x.table)}
    return [*(note for note in c.notes if note not in read), *told]


def _median_error(c: Change) -> float | None:
    carried = c.value_b if c.onto == "A" else c.value_a
    used = (c.error > 0) & (carried != 0)
    return float(np.median(c.error[used] / np.abs(carried[used]))) if used.any() else None


def _conclusion(c: Change) -> str:
    v, n = c.verdict, len(c.at)
    if c.identical:
        return f"The two are identical: each of the {n} values of B is that of A."
    typical = f"They differ typically by {_words(c.metrics['log_ratio'])}"
    stated = c.within.as_they_are > 0.0 and v is not None
    agreement = f"{'Beyond what they state they' if stated else 'They'} agree {_agreement(_within(c))}"
    if v is None:
        return f"{agreement}, over {n} values. {typical}. No uncertainty is stated: --u-rel assumes one."
    same = "the sample changed" if c.a.kind == c.b.kind else "the two disagree"
    head = f"{same[:1].upper()}{same[1:]}, by {' and '.join(v.found_by)}" if v.changed else f"No sign that {same}"
    chance = f"{v.beyond} of {n} values lie beyond 2 standard deviations, where {v.expected:.1f} are expected by chance"
    marked = int(v.marked.sum())
    between = int(np.count_nonzero(v.marked & (c.error > 0)))
    kept = (
        f"; judged together, {marked} {'values have' if marked != 1 else 'value has'} changed (about"
        f" {100 * FALSE_DISCOVERIES:g} % of these by chance"
        + (f"; {between} of them compared by interpolation: measure there before believing it)" if between else ")")
        if marked
        else "; judged together, no single value stands out"
    )
    test = f"chi-square is {v.chi_square:.4g} for {n} values (p {_p(v.p_value)})"
    scale = f"The common factor of B over A is {with_u(1 + v.scale, v.u_scale)} (p {_p(v.p_scale)})."
    return f"{head}: {test}; {chance}{kept}. {scale} {typical}. {agreement}."


def _within(c: Change) -> WithinSummary:
    w = c.within
    zero_deg = None if w.zero is None else float(np.degrees(w.zero))
    return WithinSummary(w.as_they_are, w.with_scale, w.scale, w.with_zero, zero_deg)


def _agreement(w: WithinSummary) -> str:
    """In words: within what relative standard deviation, beyond what is stated, and with what set free."""
    if w.as_they_are == 0.0:
        return "within what they state"

    def so(x: float) -> str:
        return f"within {percent(x)}" if x > 0.0 else "as they state"

    parts = [so(w.as_they_are)]
    if w.with_scale < CLOSER * w.as_they_are:
        parts.append(f"{so(w.with_scale)} where B is divided by {w.scale:.4g}")
    if w.with_zero is not None and w.zero_deg is not None and w.with_zero < CLOSER * w.with_scale:
        parts.append(f"{so(w.with_zero)} where B's angle is taken back by {w.zero_deg:.2g}° too")
    return "; ".join(parts)


def _p(p: float) -> str:
    return "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


def _words(ratio: float | None) -> str:
    text = difference(ratio)
    return f"a {text}" if text.startswith("factor") else text


def _columns(c: Change) -> list[Any]:
    v, n = c.verdict, len(c.at)
    angles = [np.round(np.degrees(x), 10) for x in c.at.directions.angles]
    z = v.z if v is not None else np.full(n, np.nan)
    marked = v.marked.astype(object) if v is not None else np.full(n, "", dtype=object)
    return [c.at.wavelength_nm, *angles, c.value_a, c.value_b, c.error, c.difference, c.u, z, marked]


def _one(c: Change, wavelength_nm: float | None) -> tuple[Observations, float]:
    """The shared directions at the wavelength that is drawn, `rows` pointing into the whole."""
    at = replace(c.at, brdf=c.value_a, rows=np.arange(len(c.at)))
    return at.nearest(wavelength_nm)


def _view(c: Change, at: Observations, listed: list[Curve], drawn: list[Curve], shown: float) -> viewer.View:
    """Both sides as an interactive plot."""
    names = labels(listed)
    keep = {int(k.rows[0]) for k in drawn}
    first = [n for k, n in zip(listed, names, strict=True) if int(k.rows[0]) in keep]
    sides = {f"A: {c.a.title}": (c.a, c.value_a, c.u_a), f"B: {c.b.title}": (c.b, c.value_b, c.u_b)}
    entries: list[viewer.CurveView] = []
    most = max(viewer.BYTES // (2 * viewer.MEASURED_BYTES * max(len(listed), 1)), viewer.FEWEST)
    shorter = [thinning.of_curve(curve, most) for curve in listed]
    for curve, name in zip(shorter, names, strict=True):
        rows = at.rows[curve.rows]
        series = [viewer.points(n, curve, values[rows], u[rows]) for n, (_, values, u) in sides.items()]
        entries.append({"label": name, "mirror": round(float(np.degrees(curve.parameter)), 4), "series": series})
    values = np.concatenate([curve.brdf[curve.brdf > 0] for curve in drawn])
    high = values.size > 0 and float(values.max()) > SPIKE * float(np.median(values))
    return {
        "name": f"{c.a.title} and {c.b.title}",
        "plot": "log" if high else "polar",
        "moving": "θr" if drawn[0].scanned == "theta_r" else "θi",
        "at": 0,
        "labels": list(dict.fromkeys([*first, *names])),
        "shown": first,
        "points": [n for n, (x, *_) in sides.items() if x.kind == "measurement"],
        "models": [n for n, (x, *_) in sides.items() if x.kind == "model"],
        "chosen": list(sides),
        "normalise": "none",
        "note": viewer.note(sum(k.angle.size for k in shorter), sum(k.angle.size for k in listed), 1, 1),
        "waves": [{"nm": finite(shown), "curves": entries}],
    }


def _page(s: ChangeSummary, figures: Sequence[Figure], view: viewer.View | None) -> Page:
    sub = (
        f"Point by point, {s.created[:10]}, gonio {s.versions['gonio']}."
        " Uncertainties are standard uncertainties (k = 1)."
    )
    body: list[Block] = [
        Group("header", (Heading(1, s.title), Paragraph(sub, "sub"))),
        lead(s.conclusion),
        Heading(3, "What was compared"),
        facts(_facts(s)),
    ]
    body += [notes(s.notes)] if s.notes else []
    if view is not None:
        body += [Heading(3, "Both in the plane of incidence"), Viewer("change", view)]
    drawings = Figures(tuple(figures))
    after: list[Block] = [Heading(3, "Metrics"), _metrics(s)]
    if len(s.wavelengths) > 1:
        after += [Heading(3, "Wavelengths"), _wavelengths(s)]
    after += [Heading(3, "How it is judged"), _method(s)] if s.verdict else []
    made = [("command", s.command or "–"), ("report made", s.created)]
    made.append(("versions", ", ".join(f"{k} {v}" for k, v in s.versions.items())))
    after += [Heading(2, "Provenance"), facts(made), FOOTER]
    room = MOST_BYTES - html.size(html.document(Page(s.title, (*body, *after))))
    return Page(s.title, (*body, html.within(drawings, room), *after))


def _wavelengths(s: ChangeSummary) -> Table:
    rows = []
    for w in s.wavelengths:
        name = "no single wavelength" if w.wavelength_nm is None else f"{w.wavelength_nm:g} nm"
        counts = ["–" if n is None else str(n) for n in (w.n_points, w.beyond, w.changed_points)]
        rows.append([name, *counts, number(w.median_ratio, 4)])
    header = ["wavelength", "values", "beyond 2", "changed", "median B/A"]
    return table("", header, rows, right=(1, 2, 3, 4), most=(MOST_ROWS, "wavelengths.csv"))


def _facts(s: ChangeSummary) -> list[tuple[str, str]]:
    rows = []
    for key, x in (("A", s.a), ("B", s.b)):
        if isinstance(x, ModelSide):
            rows.append((key, f"{x.name}: {x.model} ({x.source}); {x.convention}"))
            continue
        stated = "with uncertainties" if x.uncertainty_stated else "no uncertainties stated"
        left = f"; left out: {describe_left_out(x.left_out)}" if x.left_out else ""
        run = f"; rig {x.run.rig}, {x.run.created[:10]}, seed {x.run.seed}" if x.run else ""
        rows.append((key, f"{x.name} ({x.source}): {x.values}{' simulated' * x.simulated} values, {stated}{left}{run}"))
    shared = f"{s.n_points}"
    if {s.a.kind, s.b.kind} == {"measurement"}:
        shared += f", in the directions of {s.in_directions_of}"
    if s.interpolated:
        error = percent(s.median_interpolation_error_rel)
        shared += f", {s.interpolated} of them by interpolation (median error {error})"
    rows.append(("shared values", shared))
    if s.without_counterpart:
        rows.append(
            (
                "not compared",
                "; ".join(f"{n} values of {s.in_directions_of} {why}" for why, n in s.without_counterpart.items()),
            )
        )
    return rows


def _metrics(s: ChangeSummary) -> Table:
    rows = [[m.label, number(m.value), meaning(k, known=s.verdict is not None)] for k, m in s.metrics.items()]
    return table(
        "B takes the place of the model, A that of the measurement.",
        ["metric", "value", "what it is"],
        rows,
        right=(1,),
    )


def _method(s: ChangeSummary) -> Paragraph:
    v = s.verdict
    assert v is not None
    text = (
        "The difference of each value is judged against what all the others predict of it, with the covariance of both"
        " measurements: what a common cause (a reference, a drift, the zero of an angle) does to all values alike does"
        " not count as a change of each. The causes of two measurements count as independent; where both used the same"
        " reference its part cancels, and the verdict is on the safe side. "
        f"Of {v.n_points} values {v.expected_beyond_2:.1f} are expected beyond 2 standard deviations by chance."
        f" Values are marked by Benjamini and Hochberg's procedure, which lets"
        f" {100 * v.false_discoveries:g} % of the marks be wrong."
        f" The verdict rests on chi-square of all values (p {_p(v.p_value)}), on the largest of"
        f" them ({v.largest:.2f} standard deviations, p {_p(v.p_largest)}), and on the common factor of B over A"
        f" ({with_u(1 + v.scale, v.u_scale)}, p {_p(v.p_scale)}), each at a third of {100 * v.level:g} %; where"
        f" nothing changed it says so in {100 * (1 - v.level):g} % of the cases."
    )
    return Paragraph(text)
