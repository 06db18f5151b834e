"""The report on laboratories compared (`gonio compare --laboratories A B C`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gonio.errors import ConfigError
from gonio.measurement import Reading
from gonio_analysis.changes.consensus import METHODS
from gonio_analysis.changes.laboratories import LEVEL, Comparison, Laboratory, compared
from gonio_analysis.changes.point_by_point import side
from gonio_analysis.report import files, laboratories_figures, pdf
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Group,
    Heading,
    Page,
    Paragraph,
    Table,
    code,
    facts,
    lead,
    notes,
    table,
)
from gonio_analysis.report.comparison import stamp
from gonio_analysis.report.drawing import figure_workers
from gonio_analysis.report.drawings import Figure
from gonio_analysis.report.tables import write_columns
from gonio_analysis.report.text import number, percent, with_u
from gonio_analysis.result_records import FigureSummary, as_json, finite

FIGURES = 5
"""That a comparison has, about."""
IN_WORDS = {
    "weighted": "weighted mean", "dersimonian-laird": "DerSimonian-Laird", "mandel-paule": "Mandel-Paule",
    "reml": "REML",
}  # fmt: skip
FOOTER = Footer(
    (
        *("Every number on this page is in ", code("summary.json"), ", every value in ", code("tables/values.csv")),
        *(", every direction in ", code("tables/geometries.csv"), ", the figures in ", code("figures/"), "."),
    )
)


@dataclass(frozen=True)
class LaboratorySummary:
    """A laboratory against all of them together; `scale`, `degree_of_equivalence` and `U` are relative."""

    name: str
    source: str
    simulated: bool
    values: int
    interpolated: int
    scale: float
    u_scale: float
    degree_of_equivalence: float
    U: float
    """2 u."""
    e_n: float
    zero_deg: float | None
    u_zero_deg: float | None
    scatter: float | None
    consistent: bool
    says: str
    """What sets it apart; "" where nothing does."""


@dataclass(frozen=True)
class ConsensusSummary:
    """The mean BRDF over the common directions [1/sr], or, in `methods`, the scale of all laboratories."""

    method: str
    value: float
    u: float
    tau: float
    u_rel: float
    tau_rel: float


@dataclass(frozen=True)
class LaboratoriesSummary:
    """Every number of the page."""

    title: str
    created: str
    command: str
    versions: dict[str, str]
    conclusion: str
    agree: bool
    laboratories: list[LaboratorySummary]
    consensus: ConsensusSummary
    methods: dict[str, ConsensusSummary]
    chi_square: float
    p_value: float
    level: float
    n_points: int
    in_directions_of: str
    wavelengths_nm: list[float | None]
    inconsistent_geometries: int
    """Directions whose chi-square has a probability below `level`; by chance that share of all has."""
    shared_causes: Sequence[str]
    notes: Sequence[str]
    figures: Sequence[FigureSummary] = ()
    tables: Sequence[str] = ("geometries.csv", "values.csv")


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
        The nearest wavelength alone is compared; columns and blank of the tables, where they need any.
    command, progress
        The command line, for the record; called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.
    """
    if len(specs) < 2:
        raise ConfigError("--laboratories compares two or more tables of one sample; one is named")
    with files.staged(out) as stage, figure_workers(FIGURES) as workers:
        sides = [replace(side(spec, how, u_rel), name=name) for spec, name in zip(specs, names(specs), strict=True)]
        found = compared(sides, shared or {}, wavelength_nm=wavelength_nm, say=progress)
        summary = summarise(found, command)
        progress(summary.conclusion)
        drawn = workers.draw(laboratories_figures.draw(found), progress)
        folder = stage.work
        (folder / "tables").mkdir()
        _write_tables(found, folder / "tables")
        summary = replace(summary, figures=[FigureSummary(f.name, f.caption, f.alt) for f in drawn])
        page = _page(summary, drawn)
        files.write_page(folder, page, as_json(summary), drawn)
        pdf.write(folder / "report.pdf", [page])
    return Path(out) / "index.html"


def names(specs: Sequence[str]) -> list[str]:
    """What laboratories are called: by their files or runs, by the folders of those that are called alike."""
    paths = [Path(spec) for spec in specs]
    own = [path.stem if path.suffix.lower() in (".csv", ".json", ".xlsx", ".txt") else path.name for path in paths]
    if len(set(own)) < len(own):
        own = [path.absolute().parent.name for path in paths]
    if len(set(own)) < len(own):
        own = list(specs)
    if len(set(own)) < len(own):
        twice = next(name for name in own if own.count(name) > 1)
        raise ConfigError(f"--laboratories: {twice} is named twice; a laboratory agrees with itself")
    return own


def summarise(c: Comparison, command: str) -> LaboratoriesSummary:
    """Every number of the page."""
    reference, method = c.scales.reference, c.scales.method
    rows = [
        LaboratorySummary(
            name=x.name,
            source=x.source,
            simulated=one.simulated,
            values=len(c.at),
            interpolated=between,
            scale=x.scale,
            u_scale=x.u_scale,
            degree_of_equivalence=x.degree,
            U=2.0 * x.u_degree,
            e_n=x.e_n,
            zero_deg=None if x.zero is None else float(np.degrees(x.zero)),
            u_zero_deg=None if x.u_zero is None else float(np.degrees(x.u_zero)),
            scatter=x.scatter,
            consistent=x.consistent,
            says=says(x),
        )
        for x, one, between in zip(c.laboratories, c.sides, c.interpolated, strict=True)
    ]
    mean = c.mean

    def absolute(method: str, value: float, u: float, tau: float) -> ConsensusSummary:
        return ConsensusSummary(method, value * mean, u * mean, tau * mean, u / value, tau / value)

    simulated = sum(row.simulated for row in rows)
    mark = "" if not simulated else " (simulated)" if simulated == len(rows) else f", {simulated} of them simulated"
    return LaboratoriesSummary(
        title=f"{len(rows)} laboratories compared{mark}",
        **stamp(command),
        conclusion=conclusion(c),
        agree=c.agree,
        laboratories=rows,
        consensus=absolute(method, *reference),
        methods={m: absolute(m, *c.methods[m]) for m in METHODS},
        chi_square=c.chi_square,
        p_value=c.p_value,
        level=LEVEL,
        n_points=len(c.at),
        in_directions_of=c.onto,
        wavelengths_nm=[finite(w) for w in c.at.wavelengths],
        inconsistent_geometries=int(np.count_nonzero(c.p_alone < LEVEL)),
        shared_causes=c.shared,
        notes=c.notes,
    )


def says(x: Laboratory) -> str:
    """What sets a laboratory apart, in words; "" where nothing does."""
    parts = []
    if not x.scale_consistent:
        word = "high" if x.degree > 0 else "low"
        size = with_u(100 * abs(x.degree), 100 * x.u_degree)
        parts.append(f"is ({size}) % {word} at all angles: a reference")
    if not x.zero_consistent and x.zero is not None and x.u_zero is not None:
        word = "large" if x.zero > 0 else "small"
        size = with_u(float(np.degrees(abs(x.zero))), float(np.degrees(x.u_zero)))
        parts.append(f"reads its angle ({size})° too {word}: a zero")
    if not x.scatter_consistent and x.scatter is not None:
        parts.append(f"scatters {x.scatter:.1f} times as much as it states")
    return " and ".join(parts)


def conclusion(c: Comparison) -> str:
    """The headline."""
    count = len(c.laboratories)
    u = percent(c.scales.reference.u / c.scales.reference.value)
    known = f"Their consensus over {len(c.at)} directions has a standard uncertainty of {u}."
    off = [x for x in c.laboratories if not x.consistent]
    if not off:
        worst = max(abs(x.degree) for x in c.laboratories)
        return f"All {count} laboratories agree within what they state, the farthest {percent(worst)} off. {known}"
    each = " ".join(f"{x.name} {says(x)}." for x in off)
    if count == 2:
        a, b = c.laboratories
        return f"{a.name} and {b.name} disagree, and nothing tells which is off. Against their mean: {each}"
    if c.scales.method != "weighted":
        tau = percent(c.scales.reference.tau / c.scales.reference.value)
        return (
            f"The {count} laboratories disagree in general: they differ by {tau} more than they state. {each}"
            f" {known} That includes this dark uncertainty."
        )
    return f"{count - len(off)} of {count} laboratories agree. {each} {known}"


def _write_tables(c: Comparison, folder: Path) -> None:
    angles = [np.round(np.degrees(x), 10) for x in c.at.directions.angles]
    where = ("wavelength_nm", "theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
    every = [x.name for x in c.laboratories]
    header, columns = [*where, "consensus", "p"], [c.at.wavelength_nm, *angles, c.at.brdf, c.p_alone]
    for m, results in c.alone_by_method.items():
        name = m.replace("-", "_")
        header += [name, f"u_{name}", *([f"tau_{name}"] if m != "weighted" else [])]
        columns += [np.array([x.value for x in results]), np.array([x.u for x in results])]
        columns += [np.array([x.tau for x in results])] if m != "weighted" else []
    for k, name in enumerate(every):
        header += [f"d:{name}", f"U:{name}", f"e_n:{name}", f"consistent:{name}"]
        columns += [np.array([x.degrees[k] for x in c.alone]), np.array([2.0 * x.u[k] for x in c.alone])]
        columns += [np.array([x.e_n[k] for x in c.alone])]
        columns += [np.array([bool(x.consistent[k]) for x in c.alone], dtype=object)]
    write_columns(folder / "geometries.csv", header, columns)
    header, columns = list(where), [c.at.wavelength_nm, *angles]
    for name, values, u in zip(every, c.values, c.u, strict=True):
        header, columns = [*header, f"brdf:{name}", f"u:{name}"], [*columns, values, u]
    write_columns(folder / "values.csv", header, columns)


# ---- the page ----


def _page(s: LaboratoriesSummary, figures: Sequence[Figure]) -> Page:
    sub = (
        f"Laboratories compared, {s.created[:10]}, gonio {s.versions['gonio']}. Uncertainties are standard"
        " uncertainties (k = 1); U is expanded (k = 2)."
    )
    made = [("sources", "; ".join(f"{x.name}: {x.source}" for x in s.laboratories)), ("command", s.command or "–")]
    made += [("report made", s.created), ("versions", ", ".join(f"{k} {v}" for k, v in s.versions.items()))]
    body: list[Block] = [
        Group("header", (Heading(1, s.title), Paragraph(sub, "sub"))),
        lead(s.conclusion),
        Heading(3, "Laboratories"),
        _laboratories(s),
        Figures(tuple(figures)),
        Heading(3, "Consensus"),
        _consensus(s),
        Heading(3, "What was compared"),
        facts(_facts(s)),
        *([notes(s.notes)] if s.notes else []),
        Heading(3, "How it is judged"),
        _method(s),
        Heading(2, "Provenance"),
        facts(made),
        FOOTER,
    ]
    return Page(s.title, tuple(body))


def _laboratories(s: LaboratoriesSummary) -> Table:
    rows = []
    for x in s.laboratories:
        zero = "–" if x.zero_deg is None or x.u_zero_deg is None else with_u(x.zero_deg, x.u_zero_deg)
        rows.append(
            [
                *(x.name, with_u(x.scale, x.u_scale), number(100 * x.degree_of_equivalence, 2), number(100 * x.U, 2)),
                *(f"{x.e_n:.2f}", zero, "–" if x.scatter is None else f"{x.scatter:.2f}"),
                x.says or "agrees",
            ]
        )
    header = ["laboratory", "scale", "d / %", "U(d) / %", "E_n", "zero / °", "scatter", ""]
    caption = "Scale and degree of equivalence d against the consensus. Scatter: over what the laboratory states."
    return table(caption, header, rows, right=(1, 2, 3, 4, 5, 6))


def _consensus(s: LaboratoriesSummary) -> Table:
    rows = [
        [IN_WORDS[m], with_u(x.value, x.u), percent(x.u_rel), percent(x.tau_rel) if m != "weighted" else "–"]
        for m, x in s.methods.items()
    ]
    head = s.consensus
    chosen = "largest consistent subset" if s.consensus.method == "weighted" else "headline, Mandel-Paule of all"
    rows.insert(0, [chosen, with_u(head.value, head.u), percent(head.u_rel), percent(head.tau_rel)])
    caption = (
        f"Mean BRDF over the common directions, 1/sr. Of all scales chi-square is {s.chi_square:.3g} for"
        f" {len(s.laboratories) - 1} differences, p = {s.p_value:.2g}."
    )
    return table(caption, ["method", "value", "u", "dark uncertainty"], rows, right=(1, 2, 3))


def _facts(s: LaboratoriesSummary) -> list[tuple[str, str]]:
    waves = [f"{w:g} nm" if w is not None else "broad band" for w in s.wavelengths_nm]
    between = ", ".join(f"{x.name} {x.interpolated}" for x in s.laboratories if x.interpolated)
    rows = [("common directions", f"{s.n_points}, in the directions of {s.in_directions_of}; {', '.join(waves)}")]
    rows += [("interpolated", between)] if between else []
    rows.append(
        ("shared causes", "; ".join(s.shared_causes) or "none is known: every cause counts as a laboratory's own")
    )
    by_chance = s.level * s.n_points
    rows.append(
        (
            "directions in which they disagree",
            f"{s.inconsistent_geometries} of {s.n_points} (p < {s.level:g}; by chance {by_chance:.1f})",
        )
    )
    return rows


def _method(s: LaboratoriesSummary) -> Paragraph:
    return Paragraph(
        "Each laboratory's values are fitted by one shape, the weighted mean of all, times a scale, with a zero of the"
        " angle in the plane of incidence, by generalised least squares with all its stated causes. A laboratory is"
        " consistent where it belongs to the largest subset whose scales agree (Cox 2007) and to that of zeros, and"
        f" scatters as it states. The three tests share a level of {100 * s.level:g} %: where all are honest, so many"
        " comparisons accuse somebody. The consensus is the weighted mean of that subset while it holds two thirds of"
        " all laboratories, otherwise Mandel and Paule's mean of all with its dark uncertainty. |E_n| above 1 is what"
        " one honest laboratory in twenty has."
    )
