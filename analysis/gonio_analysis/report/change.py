"""The report on two things compared point by point (`gonio compare A B --change`)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gonio.measurement import Reading, of_reader, said_once
from gonio_analysis.changes.point_by_point import Change, Compared, compared, side
from gonio_analysis.changes.resampling import RowsAt
from gonio_analysis.changes.verdict import CLOSER, FALSE_DISCOVERIES, LEVEL, OFTEN, Effect, Verdict, Within
from gonio_analysis.curves.in_plane import Curve, curves, labels, selection
from gonio_analysis.fitting.objective import DESCRIPTIONS, meaning
from gonio_analysis.fitting.observations import Observations, describe_left_out
from gonio_analysis.plots import thinning
from gonio_analysis.report import change_figures, files, html, lost, viewer
from gonio_analysis.report.blocks import (
    MOST_ROWS,
    Block,
    Figures,
    Heading,
    Page,
    Paragraph,
    Stamp,
    Table,
    Viewer,
    dated,
    facts,
    footer,
    header,
    lead,
    notes,
    provenance,
    stamp,
    table,
    titled,
)
from gonio_analysis.report.drawing import Figure, FigureWorkers, figure_workers
from gonio_analysis.report.files import ROWS_AT_ONCE, write_columns, write_csv
from gonio_analysis.report.page import MOST_BYTES
from gonio_analysis.report.text import number, percent, spoken_difference, with_u
from gonio_analysis.result_records import RunFacts, finite
from gonio_analysis.selection.run_record import run_facts

FIGURES = 6
"""Figures that a comparison has, about."""
ALIKE = 0.9
"""Cosine between what the zeros of both arms do, above which either may be it."""
LARGEST_ZERO = float(np.radians(5.0))
"""An error of an angle that nobody makes unseen."""
_ANGLES = {"theta_r": "θr", "theta_i": "θi"}
SPIKE = 30.0
"""Largest value over the median above which it hides all others in a polar plot: a logarithmic one comes first."""
COLUMNS = (
    *("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "a", "b", "u_interpolation", "change"),
    *("u_change", "standard_deviations", "changed"),
)
FOOTER = footer(
    "Every number on this page is in `summary.json`, every compared value in `tables/change.csv`, the figures as SVG "
    "and PNG in `figures/`."
)
Waves = list[dict[str, float | None]]
"""What is known of the values at each wavelength; counts where uncertainties are stated."""


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
        Where `index.html` is.
    """
    with files.staged(out) as stage, figure_workers(FIGURES) as workers:
        sides = [side(spec, how, u_rel) for spec in specs]
        if len({x.name for x in sides}) < len(sides):
            sides = [replace(x, name=f"{x.name} ({letter})") for x, letter in zip(sides, "AB", strict=True)]
        for note in said_once({x.name: of_reader(x.table) for x in sides if x.table is not None}):
            progress(note)
        progress("comparing {1} with {0}".format(*(x.title for x in sides)))
        found = compared(sides, wavelength_nm=wavelength_nm, say=progress)
        progress("drawing")
        runs = [run_facts(Path(spec)) for spec in specs]
        _write(found, stage.work, wavelength_nm, stamp(command), runs, workers, progress)
    return Path(out) / "index.html"


def _write(
    c: Change,
    folder: Path,
    wavelength_nm: float | None,
    made: Stamp,
    runs: Sequence[RunFacts | None],
    workers: FigureWorkers,
    progress: Callable[[str], None],
) -> None:
    waves, conclusion = _wavelengths(c), _conclusion(c)
    progress(conclusion)
    at, shown = replace(c.at, brdf=c.value_a, rows=np.arange(len(c.at))).nearest(wavelength_nm)
    every = curves(at)
    drawn = selection(every)
    drawings = lost.kept("figures", lambda: change_figures.draw(c, at, drawn, shown), lambda loss: [])
    figures = workers.draw(drawings, progress)
    tables = files.written(folder / "tables" / "change.csv", lambda path: write_columns(path, COLUMNS, _columns(c)))
    if len(waves) > 1:
        tables += files.written(
            folder / "tables" / "wavelengths.csv",
            lambda path: write_csv(path, list(waves[0]), (list(w.values()) for w in waves)),
        )
    last = {"shown_wavelength_nm": shown, "figures": figures, "tables": tables}
    listed = selection(every, viewer.MOST_LISTED)
    view = None
    if drawn:
        view = lost.kept("the interactive plot", lambda: _view(c, at, listed, drawn, shown), lambda loss: None)
    page = lost.kept(
        "the page", lambda: _page(c, made, conclusion, runs, waves, figures, view), lambda loss: titled(_title(c))
    )
    summary = {**_summary(c, made, conclusion, runs), "wavelengths": waves, "notes": _notes(c), **last}
    files.write_page(folder, page, summary, figures)


def _title(c: Change) -> str:
    return f"{c.b.title} against {c.a.title}"


def _summary(c: Change, made: Stamp, conclusion: str, runs: Sequence[RunFacts | None]) -> dict[str, object]:
    """What `summary.json` says of the comparison as a whole."""
    v, w = c.verdict, c.within
    return {
        "title": _title(c),
        **made,
        "a": _side(c.a, runs[0]),
        "b": _side(c.b, runs[1]),
        "n_points": len(c.at),
        "in_directions_of": c.onto,
        "interpolated": int(np.count_nonzero(c.error)),
        "median_interpolation_error_rel": _median_error(c),
        "without_counterpart": c.missing,
        "verdict": None if v is None else _verdict(v),
        "identical": c.identical,
        "agree_within": {
            "as_they_are": w.as_they_are,
            "with_scale": w.with_scale,
            "scale": w.scale,
            "with_zero": w.with_zero,
            "zero_deg": None if w.zero is None else np.degrees(w.zero),
            "zero_of": None if w.zero is None else w.angle,
        },
        "conclusion": conclusion,
        "metrics": {k: {"label": DESCRIPTIONS[k][0], "value": c.metrics[k]} for k in DESCRIPTIONS},
    }


def _side(s: Compared, run: RunFacts | None) -> dict[str, object]:
    own = {"name": s.name, "source": s.source, "kind": s.kind, "run": run}
    if s.model is not None:
        return own | {"model": s.model.name, "convention": s.model.convention}
    stated = {"uncertainty_stated": s.stated, "simulated": s.simulated}
    return own | {"values": s.values, "left_out": s.left_out} | stated


def _verdict(v: Verdict) -> dict[str, object]:
    return {
        "changed": v.changed,
        "found_by": v.found_by,
        "chi_square": v.chi_square,
        "p_value": v.p_value,
        "n_points": v.z.size,
        "beyond_2": v.beyond,
        "expected_beyond_2": v.expected,
        "largest": v.largest,
        "p_largest": v.p_largest,
        "changed_points": int(v.marked.sum()),
        "false_discoveries": FALSE_DISCOVERIES,
        "level": LEVEL,
        "scale": v.scale,
        "u_scale": v.u_scale,
        "p_scale": v.p_scale,
        "detectable_scale": finite(v.factor.detectable),
        "zeros": {angle: _zero(zero) for angle, zero in v.zeros.items()},
        "remains_rel": v.remains,
        "detectable_in": OFTEN,
    }


def _zero(x: Effect) -> dict[str, object]:
    value, u, detectable = (finite(float(np.degrees(one))) for one in (x.value, x.u, x.detectable))
    return {"zero_deg": value, "u_zero_deg": u, "p": x.p, "found": x.found, "detectable_deg": detectable}


def _wavelengths(c: Change) -> Waves:
    v, rows, out = c.verdict, RowsAt(c.at.wavelength_nm), Waves()
    for nm in c.at.wavelengths:
        here = rows.at(nm)
        one: dict[str, float | None] = {"wavelength_nm": finite(nm), "n_points": here.size}
        if v is not None:
            one |= {"beyond": int(np.count_nonzero(np.abs(v.z[here]) > 2)), "changed_points": int(v.marked[here].sum())}
        a, b = c.value_a[here], c.value_b[here]
        positive = (a > 0) & (b > 0)
        known = b[positive] / a[positive]
        out.append({**one, "median_ratio": float(np.median(known)) if known.size else None})
    return out


def _notes(c: Change) -> list[str]:
    """What the comparison says, and what the readers of both sides say."""
    read = {x.name: x.notes for x in (c.a, c.b) if x.model is None}
    known = {note for notes_of in read.values() for note in notes_of}
    return [*(note for note in c.notes if note not in known), *said_once(read)]


def _median_error(c: Change) -> float | None:
    carried = c.value_b if c.onto == "A" else c.value_a
    used = (c.error > 0) & (carried != 0)
    return float(np.median(c.error[used] / np.abs(carried[used]))) if used.any() else None


def _conclusion(c: Change) -> str:
    v, n = c.verdict, len(c.at)
    if c.identical:
        return f"The two are identical: each of the {n} values of B is that of A."
    typical = f"They differ typically by {spoken_difference(c.metrics['log_ratio'])}"
    if c.metrics["log_ratio"] is None:
        typical = "No value stands out of its uncertainty in both, so that no ratio is told"
    stated = c.within.as_they_are > 0.0 and v is not None
    agreement = f"{'Beyond what they state they' if stated else 'They'} agree {_agreement(c.within)}"
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
    scale += _zeros_found(v) + ("" if v.changed else _limits(v))
    return f"{head}: {test}; {chance}{kept}. {scale} {typical}. {agreement}."


def _zeros_found(v: Verdict) -> str:
    """What is said of zeros that were found; "" where none was."""
    found = [angle for angle, x in v.zeros.items() if x.found]
    said = "".join(
        f" B's {_ANGLES[angle]} reads too large by ({with_u(np.degrees(x.value), np.degrees(x.u))})° (p {_p(x.p)})."
        for angle, x in v.zeros.items()
        if x.found
    )
    if len(found) == 1 and abs(v.alike) > ALIKE:
        (other,) = (name for angle, name in _ANGLES.items() if angle not in found)
        said += (
            f" An error of {other}, in the {'other' if v.alike < 0 else 'same'} direction, would look much the same."
        )
    return said


def _limits(v: Verdict) -> str:
    """What it would take to see an effect, in a sentence."""
    sizes = [f"a factor that is off by {percent(v.factor.detectable)}"] if v.factor.detectable < 1.0 else []
    sizes += [
        f"a zero of {_ANGLES[angle]} of {np.degrees(x.detectable):.2g}°"
        for angle, x in v.zeros.items()
        if x.detectable < LARGEST_ZERO
    ]
    flat = "" if len(sizes) > 1 else " These values hardly show a zero of an angle."
    if not sizes:
        return flat
    listed = ", ".join(sizes[:-1]) + " or " * (len(sizes) > 1) + sizes[-1]
    return f" Alone, {listed} would be found in {100 * OFTEN:g} % of the cases.{flat}"


def _agreement(w: Within) -> str:
    """The relative standard deviation within which both agree beyond stated uncertainties, in words."""
    if w.as_they_are == 0.0:
        return "within what they state"

    def so(x: float) -> str:
        return f"within {percent(x)}" if x > 0.0 else "as they state"

    said, divided = so(w.as_they_are), w.with_scale < CLOSER * w.as_they_are
    if divided:
        said += f"; {so(w.with_scale)} where B is divided by {w.scale:.4g}"
    if w.with_zero is not None and w.zero is not None and w.with_zero < CLOSER * w.with_scale:
        name = _ANGLES[w.angle]
        said += (
            f"; {so(w.with_zero)} where B's {name} is taken back by {number(np.degrees(w.zero), 2)}°{' too' * divided}"
        )
    return said


def _p(p: float) -> str:
    return "< 0.0001" if p < 1e-4 else f"= {p:.2g}"


def _columns(c: Change) -> Iterator[list[Any]]:
    """What `COLUMNS` names, some rows after the other."""
    v = c.verdict
    for begin in range(0, len(c.at), ROWS_AT_ONCE):
        some = slice(begin, begin + ROWS_AT_ONCE)
        angles = [np.round(np.degrees(x[some]), 10) for x in c.at.directions.angles]
        a, b, error, u = c.value_a[some], c.value_b[some], c.error[some], c.u[some]
        z = v.z[some] if v is not None else np.full(a.size, np.nan)
        marked = v.marked[some] if v is not None else np.full(a.size, "", dtype=object)
        yield [c.at.wavelength_nm[some], *angles, a, b, error, b - a, u, z, marked]


def _view(c: Change, at: Observations, listed: list[Curve], drawn: list[Curve], shown: float) -> viewer.View:
    """Both sides as an interactive plot."""
    names = labels(listed)
    keep = {int(k.rows[0]) for k in drawn}
    first = [n for k, n in zip(listed, names, strict=True) if int(k.rows[0]) in keep]
    sides = {f"A: {c.a.title}": (c.a, c.value_a, c.u_a), f"B: {c.b.title}": (c.b, c.value_b, c.u_b)}
    most = max(viewer.BYTES // (2 * viewer.MEASURED_BYTES * max(len(listed), 1)), viewer.FEWEST)
    shorter = [thinning.of_curve(curve, most) for curve in listed]
    entries = []
    for curve, name in zip(shorter, names, strict=True):
        rows = at.rows[curve.rows]
        series = [viewer.points(n, curve, values[rows], u[rows]) for n, (_, values, u) in sides.items()]
        entries.append(viewer.entry(curve, name, series))
    values = np.concatenate([curve.brdf[curve.brdf > 0] for curve in drawn])
    return {
        "name": f"{c.a.title} and {c.b.title}",
        "plot": "log" if values.size > 0 and float(values.max()) > SPIKE * float(np.median(values)) else "polar",
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


def _page(
    c: Change,
    made: Stamp,
    conclusion: str,
    runs: Sequence[RunFacts | None],
    waves: Waves,
    figures: Sequence[Figure],
    view: viewer.View | None,
) -> Page:
    title, noted = _title(c), _notes(c)
    body: list[Block] = [
        header(title, dated("Point by point", made)),
        lead(conclusion),
        Heading(3, "What was compared"),
        facts(_facts(c, runs)),
    ]
    body += [notes(noted)] if noted else []
    if view is not None:
        body += [Heading(3, "Both in the plane of incidence"), Viewer("change", view)]
    after: list[Block] = [Heading(3, "Metrics"), _metrics(c)]
    if len(waves) > 1:
        after += [Heading(3, "Wavelengths"), _of_wavelengths(waves)]
    after += [Heading(3, "How it is judged"), _method(c.verdict)] if c.verdict else []
    after += [Heading(2, "Provenance"), provenance(made), FOOTER]
    room = MOST_BYTES - html.size(html.document(Page(title, (*body, *after))))
    return Page(title, (*body, html.within(Figures(tuple(figures)), room), *after))


def _of_wavelengths(waves: Waves) -> Table:
    rows = []
    for w in waves:
        nm, counts = w["wavelength_nm"], (w.get(name) for name in ("n_points", "beyond", "changed_points"))
        name = "no single wavelength" if nm is None else f"{nm:g} nm"
        rows.append([name, *("–" if n is None else str(n) for n in counts), number(w["median_ratio"], 4)])
    header = ["wavelength", "values", "beyond 2", "changed", "median B/A"]
    return table("", header, rows, right=(1, 2, 3, 4), most=(MOST_ROWS, "wavelengths.csv"))


def _facts(c: Change, runs: Sequence[RunFacts | None]) -> list[tuple[str, str]]:
    rows = []
    for key, x, run in zip("AB", (c.a, c.b), runs, strict=True):
        if x.model is not None:
            rows.append((key, f"{x.name}: {x.model.name} ({x.source}); {x.model.convention}"))
            continue
        stated = "with uncertainties" if x.stated else "no uncertainties stated"
        left = f"; left out: {describe_left_out(x.left_out)}" if x.left_out else ""
        made = f"; rig {run.rig}, {run.created[:10]}, seed {run.seed}" if run else ""
        values = f"{x.values}{' simulated' * x.simulated} values"
        rows.append((key, f"{x.name} ({x.source}): {values}, {stated}{left}{made}"))
    shared, interpolated = f"{len(c.at)}", int(np.count_nonzero(c.error))
    if {c.a.kind, c.b.kind} == {"measurement"}:
        shared += f", in the directions of {c.onto}"
    if interpolated:
        shared += f", {interpolated} of them by interpolation (median error {percent(_median_error(c))})"
    rows.append(("shared values", shared))
    missing = "; ".join(f"{n} values of {c.onto} {why}" for why, n in c.missing.items())
    return [*rows, ("not compared", missing)] if missing else rows


def _metrics(c: Change) -> Table:
    known = c.verdict is not None
    rows = [[label, number(c.metrics[k]), meaning(k, known=known)] for k, (label, _) in DESCRIPTIONS.items()]
    caption = "B takes the place of the model, A that of the measurement."
    return table(caption, ["metric", "value", "what it is"], rows, right=(1,))


def _method(v: Verdict) -> Paragraph:
    return Paragraph(
        "The difference of each value is judged against what all the others predict of it, with the covariance of both"
        " measurements: what a common cause (a reference, a drift, the zero of an angle) does to all values alike does"
        " not count as a change of each. The causes of two measurements count as independent; where both used the same"
        " reference its part cancels, and the verdict is on the safe side. "
        f"Of {v.z.size} values {v.expected:.1f} are expected beyond 2 standard deviations by chance."
        f" Values are marked by Benjamini and Hochberg's procedure, which lets"
        f" {100 * FALSE_DISCOVERIES:g} % of the marks be wrong."
        f" The verdict rests on chi-square of all values (p {_p(v.p_value)}), on the largest of"
        f" them ({v.largest:.2f} standard deviations, p {_p(v.p_largest)}), and on the common factor of B over A"
        f" ({with_u(1 + v.scale, v.u_scale)}, p {_p(v.p_scale)}){_zeros_tested(v)}, each at"
        f" {100 * LEVEL / len(v.tests):.2g} %; where nothing changed it says so in {100 * (1 - LEVEL):g} % of the"
        f" cases.{_limits(v)}"
        + (
            " The factor and the zeros are named, and have their uncertainties, with what remains beside them as an"
            f" uncertainty of each value ({percent(v.remains)})."
            if v.remains > 0.0
            else ""
        )
    )


def _zeros_tested(v: Verdict) -> str:
    return "".join(
        f" and the zero of {_ANGLES[angle]} (B reads too large by"
        f" ({with_u(np.degrees(x.value), np.degrees(x.u))})°, p {_p(x.p)})"
        for angle, x in v.zeros.items()
    )
