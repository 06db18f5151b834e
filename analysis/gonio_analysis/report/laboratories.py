"""The report on laboratories compared (`gonio compare --laboratories A B C`)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gonio import lost
from gonio.errors import ConfigError
from gonio.measurement import Reading, of_reader, said_once
from gonio_analysis.changes.consensus import METHODS, Consensus
from gonio_analysis.changes.laboratories import LEVEL, LaboratoryComparison, LaboratoryVerdict, compared
from gonio_analysis.changes.sides import side
from gonio_analysis.report import change_figures, frame
from gonio_analysis.report.blocks import (
    Figures,
    Heading,
    Page,
    Paragraph,
    Stamp,
    Table,
    facts,
    footer,
    lead,
    notes,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Figure, figure_workers
from gonio_analysis.report.files import staged, write_columns, write_page
from gonio_analysis.report.text import number, percent, with_u

FIGURES = 5
"""Figures that a comparison has, about."""
NAMED = 3
"""Laboratories that a verdict names, at most."""
IN_WORDS = {
    "weighted": "weighted mean", "dersimonian-laird": "DerSimonian-Laird", "mandel-paule": "Mandel-Paule",
    "reml": "REML",
}  # fmt: skip
METHOD = (
    "Each laboratory's values are fitted by one shape, the weighted mean of all, times a scale, with a zero of the"
    " angle in the plane of incidence, by generalised least squares with all its stated causes. A laboratory is"
    " consistent where it belongs to the largest subset whose scales agree (Cox 2007) and to that of zeros, and"
    f" scatters as it states. The three tests share a level of {100 * LEVEL:g} %: where all are honest, so many"
    " comparisons accuse somebody. The consensus is the weighted mean of that subset while it holds two thirds of"
    " all laboratories, otherwise Mandel and Paule's mean of all with its dark uncertainty. |E_n| above 1 is what"
    " one honest laboratory in twenty has."
)
FOOTER = footer(
    "Every number on this page is in `summary.json`, every value in `tables/values.csv`, every direction in "
    "`tables/geometries.csv`, the figures in `figures/`."
)


def make(
    specs: Sequence[str],
    out: str | Path,
    *,
    shared: Mapping[str, Sequence[str] | None] | None = None,
    u_rel: float | None = None,
    wavelength_nm: float | None = None,
    how: Reading | None = None,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Compare laboratories and write a report: all of it or nothing.

    Parameters
    ----------
    specs
        Two or more tables, RUN folders or `FILE:SAMPLE`, of one sample.
    out
        Folder of the report; an earlier report there is replaced.
    shared
        Causes that are one and the same in some laboratories -> their names; None for all.
    u_rel
        Relative standard uncertainty to assume of tables that state none.
    wavelength_nm, how
        The nearest wavelength alone is compared; columns of the tables, where they need any.
    command, progress
        The command line, for the record; called with a line before each step.

    Returns
    -------
    Path
        Where `index.html` is.
    """
    if len(specs) < 2:
        raise ConfigError("--laboratories compares two or more tables of one sample; one is named")
    with staged(out) as stage, figure_workers(FIGURES) as workers:
        sides = [replace(side(spec, how, u_rel), name=name) for spec, name in zip(specs, names(specs), strict=True)]
        for note in said_once({x.name: of_reader(x.table) for x in sides if x.table is not None}):
            progress(note)
        found = compared(sides, shared or {}, wavelength_nm=wavelength_nm, say=progress)
        progress(conclusion(found))
        tables = lost.kept("tables", lambda: _write_tables(found, stage.work / "tables"), lambda loss: [])
        made = stamp(command)
        write_page(
            stage.work,
            _title(found),
            partial(_page, found, made),
            lambda figures: {**_summary(found, made), "figures": figures, "tables": tables},
            lambda: workers.draw(change_figures.draw_laboratories(found), progress),
        )
    return Path(out) / "index.html"


def names(specs: Sequence[str]) -> list[str]:
    """What laboratories are called: by their files or runs; those that are called alike by their folders."""
    paths = [Path(spec).absolute() for spec in specs]
    paths = [path.parent if path.name == "brdf.csv" else path for path in paths]
    own = [path.stem if path.suffix.lower() in (".csv", ".json", ".xlsx", ".txt") else path.name for path in paths]
    if len(set(own)) < len(own):
        own = [path.parent.name if own.count(name) > 1 else name for path, name in zip(paths, own, strict=True)]
    if len(set(own)) < len(own):
        own = list(specs)
    if len(set(own)) < len(own):
        twice = next(name for name in own if own.count(name) > 1)
        raise ConfigError(f"--laboratories: {twice} is named twice; a laboratory agrees with itself")
    return own


def _title(c: LaboratoryComparison) -> str:
    count, simulated = len(c.sides), sum(one.simulated for one in c.sides)
    mark = "" if not simulated else " (simulated)" if simulated == count else f", {simulated} of them simulated"
    return f"{count} laboratories compared{mark}"


def _consensus(c: LaboratoryComparison) -> dict[str, Consensus]:
    """The scale of all laboratories: the chosen one, and by every method."""
    return {"": c.scales.reference, **{m: c.methods[m] for m in METHODS}}


def _summary(c: LaboratoryComparison, made: Stamp) -> dict[str, object]:
    """Every number of the page; scales, degrees of equivalence and U = 2 u of laboratories are relative."""

    def absolute(method: str, x: Consensus) -> dict[str, object]:
        own = {"value": x.value * c.mean, "u": x.u * c.mean, "tau": x.tau * c.mean}
        return {"method": method, **own, "u_rel": x.u / x.value, "tau_rel": x.tau / x.value}

    chosen, *methods = [absolute(m or c.scales.method, x) for m, x in _consensus(c).items()]
    return {
        "title": _title(c),
        **made,
        "conclusion": conclusion(c),
        "agree": c.agree,
        "laboratories": [
            {
                "name": x.name,
                "source": x.source,
                "simulated": one.simulated,
                "values": len(c.at),
                "interpolated": between,
                "scale": x.scale,
                "u_scale": x.u_scale,
                "degree_of_equivalence": x.degree,
                "U": 2.0 * x.u_degree,
                "e_n": x.e_n,
                "zero_deg": _degrees(x.zero),
                "u_zero_deg": _degrees(x.u_zero),
                "scatter": x.scatter,
                "consistent": x.consistent,
                "says": says(x),
            }
            for x, one, between in zip(c.laboratories, c.sides, c.interpolated, strict=True)
        ],
        "consensus": chosen,
        "methods": dict(zip(METHODS, methods, strict=True)),
        "chi_square": c.chi_square,
        "p_value": c.p_value,
        "level": LEVEL,
        "n_points": len(c.at),
        "in_directions_of": c.onto,
        "wavelengths_nm": c.at.wavelengths,
        "inconsistent_geometries": _inconsistent(c),
        "shared_causes": c.shared,
        "notes": c.notes,
    }


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else float(np.degrees(angle))


def _inconsistent(c: LaboratoryComparison) -> int:
    """Directions whose chi-square has a probability below `LEVEL`; by chance that share of all has."""
    return int(np.count_nonzero(c.p_alone < LEVEL))


def says(x: LaboratoryVerdict) -> str:
    """What sets a laboratory apart, in words; "" where nothing does."""
    parts = []
    if not x.scale_consistent:
        word = "high" if x.degree > 0 else "low"
        size = with_u(100 * abs(x.degree), 100 * x.u_degree)
        parts.append(f"is ({size}) % {word} at all angles, as a wrong reference makes it")
    if not x.zero_consistent and x.zero is not None and x.u_zero is not None:
        word = "large" if x.zero > 0 else "small"
        size = with_u(float(np.degrees(abs(x.zero))), float(np.degrees(x.u_zero)))
        parts.append(f"reads its angle ({size})° too {word}, as a wrong zero makes it")
    if not x.scatter_consistent and x.scatter is not None:
        parts.append(f"scatters {x.scatter:.1f} times as much as it states")
    return " and ".join(parts)


def verdict(c: LaboratoryComparison) -> list[str]:
    """The answer, in two sentences at most."""
    count, off = len(c.laboratories), [x for x in c.laboratories if not x.consistent]
    u = percent(c.scales.reference.u / c.scales.reference.value)
    known = f"Their consensus over {len(c.at)} directions has a standard uncertainty of {u}"
    if not off:
        worst = max(abs(x.degree) for x in c.laboratories)
        return [
            f"All {count} laboratories agree within what they state, the farthest {percent(worst)} off.",
            f"{known}.",
        ]
    if count == 2:
        a, b = c.laboratories
        return [f"{a.name} and {b.name} disagree, and nothing tells which is off.", f"Against their mean {_each(off)}."]
    if c.scales.method != "weighted":
        tau = percent(c.scales.reference.tau / c.scales.reference.value)
        return [
            f"The {count} laboratories disagree in general: they differ by {tau} more than they state.",
            f"{known}, this dark uncertainty included.",
        ]
    named = _each(off) if len(off) <= NAMED else f"the table says by what the other {len(off)} are off"
    return [f"{count - len(off)} of {count} laboratories agree; {named}.", f"{known}."]


def conclusion(c: LaboratoryComparison) -> str:
    """The verdict, and of every laboratory that is off by what."""
    said, off = " ".join(verdict(c)), [x for x in c.laboratories if not x.consistent]
    each = _each(off)
    return said if each in said else f"{said} {each[:1].upper()}{each[1:]}."


def _each(off: Sequence[LaboratoryVerdict]) -> str:
    return "; ".join(f"{x.name} {says(x)}" for x in off)


def _write_tables(c: LaboratoryComparison, folder: Path) -> list[str]:
    """Every direction, and every value; the names of the files."""
    where = ("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
    angles = [np.round(np.degrees(x), 10) for x in c.at.directions.angles]
    at = dict(zip(where, [c.at.wavelength_nm, *angles], strict=True))
    geometries = at | {"consensus": c.at.brdf, "p": c.p_alone}
    for m, results in c.alone_by_method.items():
        names = [f"{what}{m.replace('-', '_')}" for what in ("", "u_", "tau_")]
        geometries |= dict(zip(names[: 2 if m == "weighted" else 3], np.array(results).T, strict=False))
    values = dict(at)
    for k, x in enumerate(c.laboratories):
        geometries |= {
            f"d:{x.name}": np.array([one.degrees[k] for one in c.alone]),
            f"U:{x.name}": np.array([2.0 * one.u[k] for one in c.alone]),
            f"e_n:{x.name}": np.array([one.e_n[k] for one in c.alone]),
            f"consistent:{x.name}": np.array([bool(one.consistent[k]) for one in c.alone], dtype=object),
        }
        values |= {f"brdf:{x.name}": c.values[k], f"u:{x.name}": c.u[k]}
    tables = {"geometries.csv": geometries, "values.csv": values}
    for name, columns in tables.items():
        write_columns(folder / name, list(columns), [list(columns.values())])
    return list(tables)


# ---- the page ----


def _page(c: LaboratoryComparison, made: Stamp, figures: Sequence[Figure]) -> Page:
    sub = (
        f"Laboratories compared, {made['created'][:10]}, gonio {made['versions']['gonio']}. Uncertainties are standard"
        " uncertainties (k = 1); U is expanded (k = 2)."
    )
    sources = ("sources", "; ".join(f"{x.name}: {x.source}" for x in c.laboratories))
    consistent = sum(x.consistent for x in c.laboratories)
    folds = [
        Heading(3, "Scales, zeros and scatter", f"{consistent} of {len(c.laboratories)} are consistent"),
        _in_full(c),
        Heading(3, "Deviations by direction", f"{_inconsistent(c)} of {len(c.at)} directions disagree"),
        Figures(tuple(figures[1:])),
        Heading(3, "Consensus", IN_WORDS.get(c.scales.method, c.scales.method)),
        _methods(c),
        Heading(3, "What was compared", f"{len(c.at)} directions, {len(c.laboratories)} laboratories"),
        facts(_facts(c)),
        *([notes(c.notes)] if c.notes else []),
        Heading(3, "How it is judged", f"scale, zero and scatter share a level of {100 * LEVEL:g} %"),
        Paragraph(METHOD),
        *frame.provenance(made, sources),
    ]
    first = frame.answer([lead(" ".join(verdict(c)))], [Figures(tuple(figures[:1]))], [_laboratories(c)])
    return frame.page(_title(c), sub, first, folds=folds, foot=FOOTER)


def _laboratories(c: LaboratoryComparison) -> Table:
    rows = []
    for x in c.laboratories:
        degree, u = 100 * x.degree, 100 * x.u_degree
        e_n = f"{round(x.e_n, 2) + 0.0:.2f}".replace("-", "−")
        rows.append([x.name, with_u(degree, u), number(2 * u, 2), e_n, _cause(x) or "agrees"])
    caption = "Degree of equivalence d of each scale, against the consensus."
    return table(caption, ["laboratory", "d / %", "U(d) / %", "E_n", "verdict"], rows, right=(1, 2, 3))


def _cause(x: LaboratoryVerdict) -> str:
    """What sets a laboratory apart, in few words; `says` has the numbers."""
    parts = ["scale"] * (not x.scale_consistent) + ["zero"] * (not x.zero_consistent)
    return "off: " + ", ".join(parts + ["scatter"] * (not x.scatter_consistent)) if not x.consistent else ""


def _in_full(c: LaboratoryComparison) -> Table:
    rows = []
    for x in c.laboratories:
        zero = "–" if x.zero is None or x.u_zero is None else with_u(_degrees(x.zero), _degrees(x.u_zero))
        rows.append([x.name, with_u(x.scale, x.u_scale), zero, "–" if x.scatter is None else f"{x.scatter:.2f}"])
    caption = "Scale: against the consensus. Scatter: over what the laboratory states."
    return table(caption, ["laboratory", "scale", "zero / °", "scatter"], rows, right=(1, 2, 3))


def _methods(c: LaboratoryComparison) -> Table:
    chosen = "largest consistent subset" if c.scales.method == "weighted" else "headline, Mandel-Paule of all"
    rows = [
        [IN_WORDS.get(m, chosen), with_u(x.value * c.mean, x.u * c.mean), percent(x.u / x.value),
         percent(x.tau / x.value) if m != "weighted" else "–"]
        for m, x in _consensus(c).items()
    ]  # fmt: skip
    caption = (
        f"Mean BRDF over the common directions, 1/sr. Of all scales chi-square is {c.chi_square:.3g} for"
        f" {len(c.laboratories) - 1} differences, p = {c.p_value:.2g}."
    )
    return table(caption, ["method", "value", "u", "dark uncertainty"], rows, right=(1, 2, 3))


def _facts(c: LaboratoryComparison) -> list[tuple[str, str]]:
    waves = ", ".join("broad band" if np.isnan(w) else f"{w:g} nm" for w in c.at.wavelengths)
    between = ", ".join(f"{x.name} {count}" for x, count in zip(c.laboratories, c.interpolated, strict=True) if count)
    n, by_chance = len(c.at), f"p < {LEVEL:g}; by chance {LEVEL * len(c.at):.1f}"
    return [
        ("common directions", f"{n}, in the directions of {c.onto}; {waves}"),
        *([("interpolated", between)] if between else []),
        ("shared causes", "; ".join(c.shared) or "none is known: every cause counts as a laboratory's own"),
        ("directions in which they disagree", f"{_inconsistent(c)} of {n} ({by_chance})"),
    ]
