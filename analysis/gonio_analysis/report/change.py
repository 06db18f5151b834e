"""The report on two things compared point by point (`gonio compare A B --change`)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gonio import lost
from gonio.measurement import Reading, of_reader, said_once
from gonio.run_facts import RunFacts
from gonio.run_facts import of as run_facts
from gonio.shown import finite
from gonio_analysis.changes.point_by_point import Change, compared
from gonio_analysis.changes.resampling import RowsAt
from gonio_analysis.changes.sides import Compared, side
from gonio_analysis.changes.verdict import FALSE_DISCOVERIES, LEVEL, OFTEN, Effect, Verdict
from gonio_analysis.curves.in_plane import Curve, curves, labels, selection
from gonio_analysis.fitting.objective import DESCRIPTIONS
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import thinning
from gonio_analysis.report import change_figures, change_page, files, viewer
from gonio_analysis.report.blocks import Stamp, stamp
from gonio_analysis.report.drawing import FigureWorkers, figure_workers
from gonio_analysis.report.files import ROWS_AT_ONCE, write_columns, write_csv

FIGURES = 6
"""Figures that a comparison has, about."""
SPIKE = 30.0
"""Largest value over the median above which it hides all others in a polar plot: a logarithmic one comes first."""
COLUMNS = (
    *("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "a", "b", "u_interpolation", "change"),
    *("u_change", "standard_deviations", "changed"),
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
        Columns of the tables, where they need any.
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
    waves, conclusion = _wavelengths(c), change_page.conclusion(c)
    progress(conclusion)
    at, shown = replace(c.at, brdf=c.value_a, rows=np.arange(len(c.at))).nearest(wavelength_nm)
    every = curves(at)
    drawn = selection(every)
    tables = files.written(folder / "tables" / "change.csv", lambda path: write_columns(path, COLUMNS, _columns(c)))
    if len(waves) > 1:
        tables += files.written(
            folder / "tables" / "wavelengths.csv",
            lambda path: write_csv(path, list(waves[0]), (list(w.values()) for w in waves)),
        )
    listed = selection(every, viewer.MOST_LISTED)
    view = None
    if drawn:
        view = lost.kept("the interactive plot", lambda: _view(c, at, listed, drawn, shown), lambda loss: None)
    summary = {**_summary(c, made, conclusion, runs), "wavelengths": waves, "notes": change_page.notes_of(c)}
    files.write_page(
        folder,
        change_page.title(c),
        lambda figures: change_page.page(c, made, runs, waves, figures, view),
        lambda figures: {**summary, "shown_wavelength_nm": shown, "figures": figures, "tables": tables},
        lambda: workers.draw(change_figures.draw(c, at, drawn, shown), progress),
    )


def _summary(c: Change, made: Stamp, conclusion: str, runs: Sequence[RunFacts | None]) -> dict[str, object]:
    """What `summary.json` says of the comparison as a whole."""
    v, w = c.verdict, c.within
    return {
        "title": change_page.title(c),
        **made,
        "a": _side(c.a, runs[0]),
        "b": _side(c.b, runs[1]),
        "n_points": len(c.at),
        "in_directions_of": c.onto,
        "interpolated": int(np.count_nonzero(c.error)),
        "median_interpolation_error_rel": change_page.median_error(c),
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


def _wavelengths(c: Change) -> change_page.Waves:
    v, rows, out = c.verdict, RowsAt(c.at.wavelength_nm), change_page.Waves()
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


def _view(c: Change, at: Observations, listed: list[Curve], drawn: list[Curve], shown: float) -> viewer.ViewerData:
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
