"""The pages of a comparison: its summary and its figures as blocks.

The section "Provenance" says when and how a report was made, and where its values come from.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gonio.run_facts import RunFacts
from gonio_analysis.report import beyond_reflection, frame, html, sample
from gonio_analysis.report.blocks import (
    MOST_ROWS,
    Block,
    Contents,
    Facts,
    Figures,
    Group,
    Heading,
    Page,
    Paragraph,
    Span,
    Text,
    Viewer,
    code,
    facts,
    footer,
    header,
    lead,
    notes,
    section,
    strong,
    table,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.facts import DatasetSummary, Summary
from gonio_analysis.report.model_tables import OFF, fitted_words, off_by
from gonio_analysis.report.section import part
from gonio_analysis.report.text import FILLING, counted, number, percent, slug, with_u
from gonio_analysis.report.viewer import ViewerData

MOST_SOURCES = 50
"""Samples whose provenance stands on the page."""


def _provenance(s: Summary) -> list[Block]:
    """The section, from a summary."""
    made = [("report made", s.created), ("command", s.command or "–"), ("versions", _versions(s))]
    out: list[Block] = [Heading(3, "Provenance", f"{s.created[:10]}, gonio {s.versions['gonio']}"), facts(made)]
    if len(s.datasets) > MOST_SOURCES:
        out.append(Paragraph(f"The first {MOST_SOURCES} of {len(s.datasets)} samples; summary.json has all."))
    for d in s.datasets[:MOST_SOURCES]:
        rows = [("file", d.source or "–"), ("format", str(d.table.attrs.get("format") or "–"))]
        if d.run:
            r = d.run
            rows += [("simulated" if d.simulated else "measured", r.created), ("command", r.command)]
            rows += [("plan's SHA-256", r.plan_sha256), ("seed", str(r.seed)), ("steps", str(r.steps))]
            rows += [("bands", ", ".join(r.bands)), ("versions", _versions(r))]
        # those have sections of their own
        given = {k: v for k, v in d.provenance.items() if k not in ("checks", "not_in_budget", "monte_carlo")}
        calibrations = given.pop("calibrations", [])
        visits = given.pop("reference", []) if d.run else []
        filling = FILLING.get(given.pop("filling", "") if d.run else "")
        rows += [*_flat(given), *([("beam on the sample", filling)] if filling else [])]
        rows += [("calibration", _calibration(one)) for one in calibrations]
        rows += [("white reference", _reference(band)) for band in visits]
        out += [Paragraph(strong(d.title)), facts(rows)]
    return out


def _versions(s: Summary | RunFacts) -> str:
    return ", ".join(f"{k} {v}" for k, v in s.versions.items())


def _flat(values: Any, prefix: str = "") -> Iterable[tuple[str, str]]:
    """Provenance, one line a leaf."""
    if isinstance(values, dict):
        for key, value in values.items():
            yield from _flat(value, f"{prefix}, {key}" if prefix else str(key))
    elif isinstance(values, list) and any(isinstance(v, dict) for v in values):
        for k, value in enumerate(values):
            yield from _flat(value, f"{prefix} {k + 1}" if len(values) > 1 else prefix)
    else:
        shown = ", ".join(map(str, values)) if isinstance(values, list) else values
        yield prefix.replace("_", " "), number(shown, 5) if isinstance(shown, float) else str(shown)


def _calibration(used: Mapping[str, Any]) -> str:
    """A calibration file that the run was measured with."""
    until = f"valid until {used['valid_until']}" if used["valid_until"] else "valid without an end"
    return f"{used['kind']}: {used['file']}, made on {used['made']}, {until}; SHA-256 {used['sha256']}"


def _reference(band: Mapping[str, Any]) -> str:
    """What the measurements of the white reference said, as `gonio.lab.reduction.brdf.reduce` leaves it."""
    level, slope, u_slope = band["level_e_per_s_sr"], band["drift_per_hour"], band["u_drift_per_hour"]
    drift, steady = "unknown", "that tell no drift"
    if slope is not None:
        drift = f"({with_u(100 * slope, 100 * u_slope)}) % an hour"
        steady = "on a straight line" if band["straight"] else "on no straight line"
    # a table of an earlier version does not say how well the BRDF of the reference is known
    known = f", known to {percent(band['u_brdf_rel'])}" if "u_brdf_rel" in band else ""
    return (
        f"{band['band']}: BRDF {number(band['brdf'], 4)} sr⁻¹{known}; {band['visits']} measurements {steady} "
        f"(chi-square {number(band['chi_square'])}); level {number(level, 4)} electrons a second and steradian,"
        f" known to {percent(band['u_level_rel'])}; drift {drift}; frames of one step scatter as the noise "
        f"model says, times {number(band['frame_scatter'])} in variance"
    )


MOST_BYTES = 4_500_000
"""Most bytes of one page: what a mail takes and a browser shows at once."""
FOOTER = footer(
    "Every number on this page is in `summary.json`; the curves are in `tables/`, the figures as SVG in `figures/`."
)


Beside = tuple[ViewerData | None, Sequence[Figure]]
"""What shows several samples in one plot: on a screen, and on paper."""
SAMPLES = "page.samples"
"""The identifier of that plot: no name of a sample has a dot."""


def render(
    summary: Summary,
    drawn: Sequence[Sequence[Figure]],
    views: Sequence[ViewerData | None],
    beside: Beside = (None, ()),
) -> dict[str, Page]:
    """The pages by the name of their file: `index.html`, and further ones for samples that it cannot hold.

    None is larger than `MOST_BYTES` as HTML, whatever was measured. Each needs no other file.

    Parameters
    ----------
    summary
        What `summary.json` holds.
    drawn
        The figures of each dataset, in the order of the summary.
    views
        What each dataset's interactive plot shows; None for one without curves.
    beside
        What shows all of them in one plot.
    """
    datasets, title = summary.datasets, summary.title
    several = len(datasets) > 1
    rest = drawn[len(datasets) :]
    last = [
        *part("samples of transmission alone", title, lambda: _transmission_only(summary, rest)),
        *frame.folded(
            [
                *part("conventions", title, lambda: _conventions(summary)),
                *part("provenance", title, lambda: _provenance(summary)),
            ]
        ),
    ]

    def overview(place: Mapping[str, str]) -> list[Block]:
        return part("the overview", title, lambda: _overview(summary, place, beside)) if several else []

    bare = Page(title, (*overview({}), *last, FOOTER))
    room = MOST_BYTES - html.size(html.document(bare)) - 300 * len(datasets) - 10_000
    room -= html.size(html.program()) if any(views) or beside[0] else 0
    sections = [
        html.within(sample.section(summary, *parts), max(room, MOST_BYTES // 4))
        for parts in zip(datasets, drawn[: len(datasets)], views, strict=True)
    ]
    groups = _grouped([html.size(html.fragment([one])) if several else 0 for one in sections], room)
    names = ["index.html", *(f"samples-{k}.html" for k in range(2, len(groups) + 1))]
    place = {datasets[k].slug: name for name, group in zip(names, groups, strict=True) for k in group}
    pages = {}
    for name, group in zip(names, groups, strict=True):
        first = name == "index.html"
        here = {slug: f"{'' if at == name else at}#{slug}" for slug, at in place.items()}
        blocks = [_header(summary, here, names, name), *(overview(here) if first else ())]
        blocks += [sections[k] for k in group]
        pages[name] = Page(title, (*blocks, *(last if first else ()), FOOTER))
    return pages


def _grouped(sizes: Sequence[int], room: int) -> list[list[int]]:
    """What stands on one page: as many in a row as have room there."""
    groups, used = [list[int]()], 0
    for k, needed in enumerate(sizes):
        if groups[-1] and used + needed > room:
            groups, used = [*groups, []], 0
        groups[-1].append(k)
        used += needed
    return groups


def slugs_of_transmission(s: Summary) -> list[str]:
    """Of the samples of which transmission alone was measured."""
    return [f"{slug(t.name) or 'sample'}-transmission-{k + 1}" for k, t in enumerate(s.transmission_only)]


def _transmission_only(s: Summary, drawn: Sequence[Sequence[Figure]]) -> list[Group]:
    """Their sections."""
    many = len(s.datasets) + len(s.transmission_only) > 1
    return [
        section([*([Heading(2, t.name)] if many else []), *beyond_reflection.section(t, figures)], name)
        for t, name, figures in zip(s.transmission_only, slugs_of_transmission(s), drawn, strict=True)
    ]


def _header(s: Summary, place: Mapping[str, str], names: Sequence[str], name: str) -> Group:
    links = [(place[d.slug], d.title) for d in s.datasets] if len(s.datasets) > 1 else []
    sub = (
        f"{'BRDF' if s.datasets else 'BTDF'} comparison, {s.created[:10]}, gonio {s.versions['gonio']}."
        " Uncertainties are standard uncertainties (k = 1)."
    )
    more: list[Block] = []
    if len(names) > 1:
        others = [part for p in names if p != name for part in (", ", code(p))][1:]
        words = (
            f"Page {names.index(name) + 1} of {len(names)}: all samples together would be too large for"
            " one. The others are "
        )
        more.append(Paragraph((words, *others, "."), "note"))
    return header(s.title, sub, *more, Contents(tuple(links[:MOST_ROWS])))


def _overview(s: Summary, place: Mapping[str, str], beside: Beside) -> list[Block]:
    """Several samples beside each other: the verdict without models, all in one plot, and what models say."""
    view, figures = beside
    rows: list[Sequence[Text]] = []
    for d in s.datasets:
        link = Span(d.title, href=place.get(d.slug, f"#{d.slug}"))
        for name, f in d.models.items():
            numbers = (number(f.fit.reduced_chi_square), off_by(f))
            rows.append((link, strong(name), *numbers, fitted_words(d, name, f)))
        for name in d.skipped:
            rows.append((link, strong(name), "–", "–", "not fitted: see there"))
    c = s.comparison
    said = [] if c is None else [lead(" ".join(c.verdict))] if c.verdict else []
    remedies = [] if c is None or c.models is None else [Paragraph(one.words, "note") for one in c.models.remedies]
    plot = [Viewer(SAMPLES, view)] if view is not None else []
    nearest = table(
        "The nearest model of each sample, and how far it is off, typically.",
        ["sample", "best model", OFF, "verdict"],
        [_headline(d, place) for d in s.datasets],
        right=(2,),
        most=(MOST_ROWS, "metrics.csv"),
    )
    first = frame.answer([*said, *remedies], [*plot, Figures(tuple(figures), printed=view is not None)], [nearest])
    folds: list[Block] = []
    if c is not None and c.details:
        folds += [Heading(3, "The comparison in full", counted(len(c.details), "sentence")), notes(c.details)]
    if c is not None and c.models is not None and c.models.words:
        shared = ", ".join(one.label for one in c.models.shared)
        folds += [Heading(3, "What models say", shared or "no model describes all of them"), notes(c.models.words)]
    folds += [
        Heading(3, "Every model on every sample", counted(len(rows), "fit")),
        table(
            "Parameters of a geometry that several wavelengths share say so.",
            ["sample", "model", "reduced χ²", OFF, "fitted parameters"],
            rows,
            right=(2, 3),
            most=(MOST_ROWS, "metrics.csv and parameters.csv"),
        ),
    ]
    return [first, *frame.folded(folds)]


def _headline(d: DatasetSummary, place: Mapping[str, str]) -> list[Text]:
    """One sample in one line."""
    link = Span(d.title, href=place.get(d.slug, f"#{d.slug}"))
    if d.best is None:
        return [link, "–", "–", "no model was fitted"]
    f = d.models[d.best]
    said = f.fit.verdict.partition("; it ")[0] if f.fit.reduced_chi_square is not None else "no uncertainty is stated"
    return [link, strong(d.best), off_by(f), said]


def _conventions(s: Summary) -> list[Block]:
    lines: dict[str, list[str]] = {}
    for d in s.datasets:
        for name, f in d.models.items():
            said = " ".join([f.fit.model.convention, *filter(None, [f.fit.assumes])])
            if said not in lines.setdefault(name, []):
                lines[name].append(said)
    return [
        Heading(3, "Conventions", "angles, units, what each model takes for granted"),
        Paragraph(
            "The BRDF is reflected radiance over irradiance, in sr⁻¹. "
            "Polar angles count from the surface's normal; both directions leave the surface, toward source and"
            " detector. In the plane of incidence angles are signed: positive on the mirror side, negative on the"
            " retro side. Models are averaged over the stated cones of source and receiver before they are"
            " compared; a specular spike is carried through that average."
        ),
        Facts(tuple((name, _below(texts)) for name, texts in lines.items())),
    ]


def _below(texts: Sequence[str]) -> Text:
    """Texts, each on a line of its own."""
    return tuple(part for text in texts for part in (Span(" ", "break"), text))[1:]
