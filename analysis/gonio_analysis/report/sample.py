"""One sample's section of the page: what was measured, which models were fitted, how far they are off."""

import math
from collections.abc import Callable, Mapping, Sequence

from gonio import geometry
from gonio.checks.symmetry import Pairs
from gonio.formats.reader import TableBand
from gonio.shown import finite
from gonio_analysis.fitting.objective import meaning as meaning_of_metric
from gonio_analysis.report import blocks, checks, frame, sections, verdict
from gonio_analysis.report import model_tables as models
from gonio_analysis.report.blocks import (
    Block,
    Facts,
    Figures,
    Group,
    Heading,
    Notes,
    Paragraph,
    Table,
    Text,
    Viewer,
    caused,
    facts,
    lead,
    notes,
    strong,
    table,
    term,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.facts import DatasetSummary, Summary
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import blocks_of, part
from gonio_analysis.report.sections import SECTIONS
from gonio_analysis.report.text import angle, counted, cut, difference, glued, number, percent, reasons, with_u
from gonio_analysis.report.viewer import ViewerData

FAR = 0.1
"""Share of a model's light in directions that were not measured, above which it is named."""
MOST_NAMED = 120
"""Characters of names beside the heading of a folded part."""


def section(s: Summary, d: DatasetSummary, figures: Sequence[Figure], view: ViewerData | None) -> Group:
    """One sample's part of the page: the answer open, the rest folded.

    Parameters
    ----------
    s, d
        What `summary.json` holds, of all samples and of this one.
    figures, view
        Its figures, and what its interactive plot shows; None where it has no curves.
    """
    by: dict[str, tuple[Figure, ...]] = {}
    for f in figures:
        by[f.kind] = (*by.get(f.kind, ()), f)

    def made(parts: Mapping[str, Callable[[], Sequence[Block]]]) -> list[Block]:
        return [block for words, make in parts.items() for block in part(words, d.name, make)]

    first = frame.answer(
        made(
            {
                "the verdict": lambda: [lead(d.verdict), *([Paragraph(d.remedy, "note")] if d.remedy else [])],
                "bad checks": lambda: checks.bad(d.checks, d.slug),
            }
        ),
        made({"plots in plane": lambda: _picture(d, by, view)}),
        made({"models": lambda: [models.beside_plot(d)] if d.models else [_values(d)]}),
        frame.folded(made({"all models": lambda: models.below_plot(d)}), d.slug),
    )
    chosen = frame.beside(made({"plots": lambda: _plots(d, by)}), made({"parameters": lambda: models.chosen(d)}))
    folds = made(
        {
            "the choice of a model": lambda: _choice(s, d),
            "other models": lambda: _other_models(d, by),
            "the polar plot": lambda: _polar_plot(s, d),
            "energy and symmetry": lambda: _energy(d),
            "intervals": lambda: _intervals(d, by),
            "out of plane": lambda: _out_of_plane(by),
        }
    )
    folds += [b for one in sections.every(SECTIONS) for b in blocks_of(one, d, by)]
    folds += made({"what was measured": lambda: _measured(d)})
    inside = (first, *chosen, *frame.folded(folds, d.slug))
    if len(s.datasets) == 1:
        return blocks.section(inside, d.slug)
    return Group("details", inside, d.slug, heading=Heading(2, d.title, d.verdict))


def _of_best(d: DatasetSummary, figures: Sequence[Figure], *, best: bool = True) -> tuple[Figure, ...]:
    """Figures of the model that is put first, or of the others."""
    return tuple(f for f in figures if (f.model == d.best) is best)


def _picture(d: DatasetSummary, by: ByKind, view: ViewerData | None) -> list[Block]:
    """The interactive polar plot; on paper the drawing of the model that is put first."""
    polar = _of_best(d, by.get("polar", ()))
    if view is not None:
        return [Viewer(d.slug, view), Figures(polar, printed=True)]
    return [Figures(polar or by.get("heat", ())[:1] or _of_best(d, by.get("absolute", ())))]


def _plots(d: DatasetSummary, by: ByKind) -> list[Block]:
    """Semilog with residuals, parameters over wavelength, and one map of the hemisphere: of the model put first."""
    polar, maps = by.get("polar"), by.get("heat", ())[:1]
    absolute = _of_best(d, by.get("absolute", ())) if polar or maps else ()  # else it is the picture
    return [Figures((*absolute, *_of_best(d, by.get("series", ())), *(maps if polar else ())))]


def _other_models(d: DatasetSummary, by: ByKind) -> list[Block]:
    others = [name for name in d.models if name != d.best]
    if not others:
        return []
    every = [*by.get("overlay", ()), *_of_best(d, by.get("polar", ()), best=False)]
    every += [f for kind in ("absolute", "series") for f in _of_best(d, by.get(kind, ()), best=False)]
    head = Heading(3, "Other models", cut(", ".join(others), MOST_NAMED))
    return [head, models.parameters(d, others), *_remarks(d, others), Figures(tuple(every))]


def _remarks(d: DatasetSummary, of: Sequence[str]) -> list[Block]:
    """What fits say of themselves, and what nobody says of the data."""
    said: dict[str, list[str]] = {}
    for m in of:
        for n in d.models[m].notes:
            if n not in d.notes + list(d.data.notes):
                said.setdefault(n, []).append(m)
    return [Notes(tuple((strong(", ".join(names)), f": {n}") for n, names in said.items()))]


def _choice(s: Summary, d: DatasetSummary) -> list[Block]:
    """The verdict in full, and the statistics behind it."""
    rest = " ".join(d.headline[1:])
    skipped = {m: why for m, why in d.skipped.items() if len(d.choice.judged) < 2 or m not in d.choice.left_out}
    out: list[Block] = [Paragraph(glued(rest))] if rest else []
    out += verdict.which_model(d)
    out += [Notes(tuple((strong(m), f" was not fitted: {why}") for m, why in skipped.items()))]
    out += _metrics(s, d) if d.models else []
    out += _remarks(d, [d.best]) if d.best else []
    out = [block for block in out if not block.empty]
    return [Heading(3, "How the model was chosen", verdict.tally(d)), *out] if out else []


def _polar_plot(s: Summary, d: DatasetSummary) -> list[Block]:
    if not any(f.drawn for f in d.models.values()):
        return []
    words = ", ".join(dict.fromkeys(c.norm.kind for f in d.models.values() for c in f.drawn))
    said = {"mirror": "the value in the mirror direction", "max": "the largest value", "model": "the model's value"}
    result = " or ".join(said[kind] for kind in words.split(", "))
    return [Heading(3, "What the polar plot shows", f"radius: BRDF over {result}"), _polar_words(s, d)]


def _intervals(d: DatasetSummary, by: ByKind) -> list[Block]:
    shown = Figures(by.get("profile", ()))
    return [] if shown.empty else [Heading(3, "Profiles of the parameters", ", ".join(d.choice.intervals)), shown]


def _out_of_plane(by: ByKind) -> list[Block]:
    maps = by.get("heat", ())
    shown = Figures((*(maps[1:] if by.get("polar") else maps), *by.get("slices", ()), *by.get("lobe", ())))
    return [] if shown.empty else [Heading(3, "Out of the plane of incidence", "maps, slices and lobe"), shown]


def _measured(d: DatasetSummary) -> list[Block]:
    what = "What was simulated, and how" if d.simulated else "What was measured, and how"
    rig = d.run.rig if d.run else d.source or "a table"
    at = "" if d.wavelength_nm is None else f", {d.wavelength_nm:g} nm"
    return [Heading(3, what, f"{counted(len(d.data), 'value')}{at}, {rig}"), _facts(d), notes(d.notes)]


def _values(d: DatasetSummary) -> Table:
    rows = [
        [
            number(finite(wavelength_nm), 6),
            *(number(angle, 4) for angle in angles),
            number(brdf, 4) if math.isnan(u) else with_u(brdf, u),
            number(math.pi * brdf, 4),
        ]
        for wavelength_nm, *angles, brdf, u in (v.values() for v in d.values)
    ]
    return table(
        "π f is the albedo of a Lambertian surface with this BRDF, and the reflectance factor.",
        ["wavelength/nm", "θi/°", "φi/°", "θr/°", "φr/°", "BRDF f/sr⁻¹", "π f"],
        rows,
        right=tuple(range(7)),
        of=(len(d.usable), f"{d.slug}-all-values.csv"),
    )


def _facts(d: DatasetSummary) -> Facts:
    run = d.run
    wavelengths = [w for w in d.wavelengths_nm if w is not None]
    rows: list[tuple[Text, Text]] = [("source", d.source or "–")]
    if run:
        left_out = ", ".join(f"{count} {flag}" for flag, count in run.points_not_reachable.items())
        rows.append(("rig", f"{run.rig} ({run.driver}), seed {run.seed}"))
        rows.append(("plan", f"{run.plan}: {run.points} points" + (f" ({left_out})" if left_out else "")))
        if run.sample:
            given = ", ".join(f"{k} = {v}" for k, v in run.sample.parameters.items())
            rows.append(("simulated sample", f"{run.sample.name}: {run.sample.model} with {given}"))
        rows.append(("white reference", run.reference))
    if wavelengths:
        of = f", one of {len(wavelengths)} from {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
        rows.append(("wavelength", f"{d.wavelength_nm:g} nm{of * (len(wavelengths) > 1)}{_width(d)}"))
    else:
        rows.append(("band", ", ".join(_band(b) for b in d.bands) or "no wavelength stated"))
    used = f"{len(d.data)} of {d.rows_here}" + " at this wavelength" * (len(wavelengths) > 1)
    negative = f"; {d.negative} values are negative within the noise" if d.negative else ""
    cones = [(n, finite(d.table.attrs.get(f"{n}_solid_angle_sr"))) for n in ("source", "receiver")]
    uncertainty: Text = "none stated"
    if d.uncertainty_stated:
        causes = [part for c in d.causes for part in (", ", caused(c))][1:] or ["none"]
        uncertainty = (f"median {percent(d.median_u_rel)}; causes common to all values: ", *causes)
    elif d.data.u_rel_assumed is not None:
        uncertainty = f"none stated; {percent(d.data.u_rel_assumed)} of each value is assumed"
    return facts(
        [
            *rows,
            ("incidences", _angles(d.theta_i_deg)),
            ("values used", used + (f"; left out: {d.left_out_words}" if d.left_out_words else "")),
            ("BRDF", f"{number(float(d.data.brdf.min()))} to {number(float(d.data.brdf.max()))} sr⁻¹{negative}"),
            ("solid angles", ", ".join(f"{n} {_cone(w)}" for n, w in cones)),
            ("uncertainty", uncertainty),
        ]
    )


def _energy(d: DatasetSummary) -> list[Block]:
    """Reflectances of the models and of the measurement, and its symmetries."""
    if not d.models:
        return []
    columns = {
        name + " ⚠ above 1" * f.reflects_too_much: {round(r.theta_i_deg, 1): r for r in f.rho_dh}
        for name, f in d.models.items()
    }
    at = sorted({angle for column in columns.values() for angle in column})
    own = [r for r in d.rho_dh if r.rho_dh is not None]
    if own:
        near = {a: [r for r in own if abs(a - r.theta_i_deg) < 0.5] for a in at}
        columns["the measurement itself"] = {a: found[0] for a, found in near.items() if found}
    if d.rho_dh_combined:
        columns["nearest, with the misfit"] = {round(r.theta_i_deg, 1): r for r in d.rho_dh_combined}
    rows = [[f"{a:g}°", *(with_u(c[a].rho_dh, c[a].u) if a in c else "–" for c in columns.values())] for a in at]
    out: list[Block] = [Heading(3, "Energy and symmetry", _in_short(d))]
    if at:
        caption = (
            "Directional-hemispherical reflectance rho_dh by angle of incidence: the share of the light that is"
            " reflected, at the measured level. Uncertainties of models follow from the covariance of their parameters"
            + (", which rests on the assumed uncertainty." if d.data.u_rel_assumed is not None else ".")
            + _of_misfits(d)
        )
        out.append(table(caption, ["θi", *columns], rows, right=tuple(range(1, len(columns) + 1))))
    said: list[Text] = [*reasons("The measurement's own rho_dh", d.rho_dh)]
    for name, f in d.models.items():
        said += [
            f"rho_dh {text[0].lower()}{text[1:]}" for text in [verdict.conditional(name, f.rho_dh, f.fit.given)] if text
        ]
        said += reasons(f"rho_dh of {name}", f.rho_dh)
    said += reasons("rho_dh of the nearest, with the misfit,", d.rho_dh_combined)
    for name, found in d.rho_dh_near.items():
        shares = {r.theta_i_deg: r.unmeasured for r in found if r.unmeasured}
        far = ", ".join(f"{percent(share)} at θi = {angle(at)}" for at, share in shares.items() if share > FAR)
        if far:
            said.append(f"Of the light that {name} reflects, part goes where no value near tells the misfit: {far}.")
    checked = set() if d.checks is None else {one.name for one in d.checks.checks}
    return [*out, Notes((*said, *(_symmetry(s) for s in d.symmetries if s.kind not in checked)))]


def _in_short(d: DatasetSummary) -> str:
    """A reflectance at one incidence, and symmetries that are broken."""
    found = d.rho_dh_combined or (d.models[d.best].rho_dh if d.best else [])
    first = next((r for r in found if r.rho_dh is not None), None)
    said = "reflectance not determined" if first is None else f"reflects {with_u(first.rho_dh, first.u)} at"
    said += "" if first is None else f" {angle(first.theta_i_deg)}"
    broken = [s.kind for s in d.symmetries if s.broken]
    return said + (f"; broken: {', '.join(broken)}" if broken else "")


def _symmetry(s: Pairs) -> str:
    """How well a symmetry is kept, as sentences."""
    limit = " (the limit without uncertainties: 10 %)"
    if s.reduced_chi_square is not None:
        limit = f"; χ² a pair {number(s.reduced_chi_square)}"
    return (
        f"Symmetry, {s.kind} ({s.words}): {'broken' if s.broken else 'kept'}. {s.pairs} pairs differ typically by"
        f" {difference(s.typical)}, at most by {difference(s.largest)}{limit}."
    )


def _of_misfits(d: DatasetSummary) -> str:
    """What the reflectances of models hold that are not true."""
    if not any(r.with_misfit is not None for f in d.models.values() for r in f.rho_dh):
        return ""
    said = " Of a model with a misfit they hold that misfit over the whole hemisphere."
    if d.rho_dh_combined:
        said += f" The last column is {', '.join(d.choice.near)} with what the values say of the misfit"
        if len(d.choice.near) > 1:
            said += ", weighted by how well they predict what was left out. Its uncertainty holds the spread among them"
        said += "."
    return said


def _polar_words(s: Summary, d: DatasetSummary) -> Paragraph:
    kinds = {c.norm.kind for f in d.models.values() for c in f.drawn}
    words = {
        "mirror": "The radius is the BRDF divided by its value in the direction of mirror reflection, as in eq. 11 of"
        " He, Torrance, Sillion and Greenberg (1991): the measured value nearest the mirror, within"
        f" {s.mirror_tolerance_deg:g}°; theory is divided by its own value in that direction. ",
        "max": "Where that direction was not measured, is dark beside the rest of the curve, or the largest value was"
        " asked for, measurement and theory are both divided by the largest in-plane measurement. ",
        "model": "Measurement and theory are both divided by the fitted model's value in the mirror direction. ",
    }
    first = "".join(text for kind, text in words.items() if kind in kinds)
    moving = "detector" if d.scanned == "theta_r" else "source"
    return Paragraph(
        f"{first}The {moving} moves from −90° (retro side, left) to 90° (mirror side, right); the short "
        "strokes on the rim mark the mirror directions. In plane means within "
        f"{s.in_plane_tolerance_deg:g}° of the plane of incidence; {_aside(d)}."
    )


def _aside(d: DatasetSummary) -> str:
    """How far the values that are shown as in plane lie out of it."""
    if d.out_of_plane_deg > 1e-6:
        return f"the values shown lie up to {number(d.out_of_plane_deg, 2)}° out of it"
    return "the values shown lie in it"


def _metrics(s: Summary, d: DatasetSummary) -> list[Block]:
    known = d.uncertainty_stated or d.data.u_rel_assumed is not None
    names = [n for n in s.metrics if any(f.metrics[n] is not None for f in d.models.values())]
    rows = [[m, number(f.fit.reduced_chi_square), *(number(f.metrics[n]) for n in names)] for m, f in d.models.items()]
    heads = [term(s.metrics[n]["label"], meaning_of_metric(n, known=known)) for n in names]
    chi = term("reduced χ²", "χ² over the number of values less that of the free parameters; about 1 of a true model.")
    return [table("", ["model", chi, *heads], rows, right=tuple(range(1, len(names) + 2)))]


def _cone(solid_angle_sr: float | None) -> str:
    if solid_angle_sr is None:
        return "unknown"
    half = math.degrees(float(geometry.half_angle_of_cone(solid_angle_sr)))
    return f"{number(solid_angle_sr)} sr (half-angle {half:.3g}°)"


def _band(b: TableBand) -> str:
    if "lower_nm" in b:
        return f"{b.get('name', '')}, {b['lower_nm']:g} to {b['upper_nm']:g} nm, broad"
    if "centre_nm" not in b:
        return f"{b.get('name', 'unnamed')}, without stated limits"
    return f"{b.get('name', '')}, {b.get('centre_nm')} nm, {b.get('fwhm_nm')} nm wide"


def _width(d: DatasetSummary) -> str:
    here = [b for b in d.bands_shown if b.get("fwhm_nm")]
    return f", {here[0]['fwhm_nm']:g} nm wide" if here else ""


def _angles(angles: Sequence[float]) -> str:
    """A list of angles, or its range where it is long (readbacks scatter by a few hundredths of a degree)."""
    distinct: list[float] = []
    for a in angles:
        if not distinct or a - distinct[-1] > 0.4:
            distinct.append(a)
    if len(distinct) > 12:
        return f"{len(distinct)} from {distinct[0]:g}° to {distinct[-1]:g}°"
    return ", ".join(f"{a:g}°" for a in distinct)
