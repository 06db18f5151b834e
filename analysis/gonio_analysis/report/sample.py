"""One sample's section of the page: what was measured, which models were fitted, how far they are off."""

import math
from collections.abc import Callable, Sequence

from gonio import geometry
from gonio.checks.symmetry import Pairs
from gonio.formats.reader import TableBand
from gonio_analysis.fitting.objective import meaning as meaning_of_metric
from gonio_analysis.fitting.solution import Estimate
from gonio_analysis.report import blocks, sections, verdict
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
    code,
    facts,
    lead,
    notes,
    strong,
    table,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.facts import DatasetSummary, Summary
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import blocks_of, part
from gonio_analysis.report.sections import SECTIONS
from gonio_analysis.report.text import angle, cause, difference, number, percent, reasons, with_u
from gonio_analysis.report.viewer import View
from gonio_analysis.selection.compare import Fitted

FAR = 0.1
"""Share of a model's light in directions that were not measured, above which it is named."""


OTHER_FIGURES = {
    "In the plane of incidence, absolute, with residuals": ("absolute",),
    "All models together": ("overlay",),
    "Out of the plane of incidence": ("heat", "slices", "lobe"),
}


def section(s: Summary, d: DatasetSummary, figures: Sequence[Figure], view: View | None) -> Group:
    """One sample's section of the page.

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
    what = "What was simulated, and how" if d.simulated else "What was measured, and how"
    shared = any(f.fit.shared is not None for f in d.models.values())
    skipped = {m: why for m, why in d.skipped.items() if len(d.choice.judged) < 2 or m not in d.choice.left_out}
    values = "Simulated values" if d.simulated else "Measured values"
    parts: dict[str, Callable[[], Sequence[Block]]] = {
        "the headline": lambda: [*([Heading(2, d.title)] if len(s.datasets) > 1 else []), lead(d.conclusion)],
        "what was measured": lambda: [Heading(3, what), _facts(d), notes(d.notes)],
        "the choice of a model": lambda: verdict.which_model(d.choice, d.wavelength_nm if shared else None),
        "models": lambda: [Heading(3, "Models"), _models(d)] if d.models else [Heading(3, values), _values(d)],
        "models that were not fitted": lambda: [
            Notes(tuple((strong(m), f" was not fitted: {why}") for m, why in skipped.items()))
        ],
        "energy and symmetry": lambda: _energy(d),
        "plots in plane": lambda: _in_plane(s, d, by.get("polar", ()), view),
        "other plots": lambda: _other_plots(by),
        "parameters": lambda: _with_heading("Parameters", d, [*_parameters(d), Figures(by.get("profile", ()))]),
        "metrics": lambda: _with_heading("Metrics", d, _metrics(s, d)),
    }
    out = [block for words, make in parts.items() for block in part(words, d.name, make)]
    return blocks.section([*out, *(b for one in sections.every(SECTIONS) for b in blocks_of(one, d, by))], d.slug)


def _in_plane(s: Summary, d: DatasetSummary, figures: tuple[Figure, ...], view: View | None) -> list[Block]:
    if not figures:
        return []
    heading = Heading(3, "In the plane of incidence, normalised")
    return [heading, _polar_words(s, d), *([Viewer(d.slug, view)] if view else []), Figures(figures)]


def _other_plots(by: ByKind) -> list[Block]:
    out: list[Block] = []
    for heading, kinds in OTHER_FIGURES.items():
        if shown := tuple(f for kind in kinds for f in by.get(kind, ())):
            out += [Heading(3, heading), Figures(shown)]
    return out


def _with_heading(heading: str, d: DatasetSummary, found: Sequence[Block]) -> list[Block]:
    """Blocks about models, where there are any."""
    return [Heading(3, heading), *found] if d.models else []


def _values(d: DatasetSummary) -> Table:
    rows = [
        [
            number(v.wavelength_nm, 6),
            *(number(angle, 4) for angle in (v.theta_i_deg, v.phi_i_deg, v.theta_r_deg, v.phi_r_deg)),
            number(v.brdf, 4) if v.u_brdf is None else with_u(v.brdf, v.u_brdf),
            number(math.pi * v.brdf, 4),
        ]
        for v in d.values
    ]
    return table(
        "π f is the albedo of a Lambertian surface with this BRDF, and the reflectance factor.",
        ["wavelength/nm", "θi/°", "φi/°", "θr/°", "φr/°", "BRDF f/sr⁻¹", "π f"],
        rows,
        right=tuple(range(7)),
        of=(d.usable_everywhere, f"{d.slug}-all-values.csv"),
    )


def _facts(d: DatasetSummary) -> Facts:
    run = d.run
    wavelengths = [w for w in d.wavelengths_nm if w is not None]
    rows: list[tuple[str, str]] = [("source", d.source or "–")]
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
    used = f"{d.used} of {d.rows_here}" + " at this wavelength" * (len(wavelengths) > 1)
    negative = f"; {d.negative} values are negative within the noise" if d.negative else ""
    cones = [("source", d.source_solid_angle_sr), ("receiver", d.receiver_solid_angle_sr)]
    uncertainty = "none stated"
    if d.uncertainty_stated:
        causes = ", ".join(cause(c) for c in d.causes) or "none"
        uncertainty = f"median {percent(d.median_u_rel)}; causes common to all values: {causes}"
    elif d.u_rel_assumed is not None:
        uncertainty += f"; {percent(d.u_rel_assumed)} of each value is assumed"
    return facts(
        [
            *rows,
            ("incidences", _angles(d.theta_i_deg)),
            ("values used", used + (f"; left out: {d.left_out_words}" if d.left_out_words else "")),
            ("BRDF", f"{number(d.brdf_min)} to {number(d.brdf_max)} sr⁻¹{negative}"),
            ("solid angles", ", ".join(f"{n} {_cone(w)}" for n, w in cones)),
            ("uncertainty", uncertainty),
        ]
    )


def _models(d: DatasetSummary) -> Table:
    marks = ["best" if name == d.best and len(d.models) > 1 else "" for name in d.models]
    alone = all(f.fit.misfit is None for f in d.models.values())  # beside tau it would be a second measure of one thing
    rows = [
        [
            name,
            fitted_words(d, name, f),
            verdict.misfit_words(f.fit.tau),
            number(f.fit.reduced_chi_square) + " (assumed u)" * (f.fit.data.u_rel_assumed is not None),
            *([difference(f.metrics["log_ratio"])] * alone),
            f.fit.verdict.partition("; it ")[0] + "; ⚠ reflects more than it receives" * f.reflects_too_much,
        ]
        for name, f in d.models.items()
    ]
    together = next((f.fit.shared for f in d.models.values() if f.fit.shared is not None), None)
    chi = "reduced χ²" if together is None else f"reduced χ², {len(together.wavelengths_nm)} wavelengths together"
    note = "● marks the model that the first line names. " if any(marks) else ""
    if any(f.fit.tau is not None for f in d.models.values()):
        note += f"{verdict.TAU} "
    return table(
        note + "Typical difference: rms of ln(model / measured)." * alone,
        ["model", "fitted parameters", "misfit tau", chi, *["typical difference"] * alone, "verdict"],
        rows,
        right=(2, 3, 4) if alone else (2, 3),
        marks=marks,
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
    out: list[Block] = [Heading(3, "Energy and symmetry")]
    if at:
        caption = (
            "Directional-hemispherical reflectance rho_dh by angle of incidence: the share of the light that is"
            " reflected, at the measured level. Uncertainties of models follow from the covariance of their parameters"
            + (", which rests on the assumed uncertainty." if d.u_rel_assumed is not None else ".")
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
    said = " Of a model with a misfit tau they hold that misfit over the whole hemisphere."
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
        " asked for, the divisor is the largest in-plane value, and theory is divided by its own value in that"
        " direction. ",
        "model": "Measurement and theory are both divided by the fitted model's value in the mirror direction. ",
    }
    first = "".join(text for kind, text in words.items() if kind in kinds)
    moving = "detector" if d.scanned == "theta_r" else "source"
    return Paragraph(
        f"{first}The {moving} moves from −90° (retro side, left) to 90° (mirror side, right); the short "
        "strokes on the rim mark the mirror directions. In plane means within "
        f"{s.in_plane_tolerance_deg:g}° of the plane of incidence; the values shown are within "
        f"{number(d.out_of_plane_deg, 2) if d.out_of_plane_deg > 1e-6 else '0'}°."
    )


def _parameters(d: DatasetSummary) -> list[Block]:
    rows: list[Sequence[Text]] = []
    for name, f in d.models.items():
        label, told = name, f.fit.model.parameter_notes
        for p, e in [*f.fit.parameters.items(), *f.fit.derived.items()]:
            kind = "derived" if p in f.fit.derived else "fixed" if e.fixed else "fitted"
            kind += f", at its {e.at_bound} bound" if e.at_bound else ""
            kind += f"; {told[p]}" if p in told else ""
            value = _value(d, name, p, e)
            value += f" ({e.material})" if e.material else ""
            rows.append((label, code(p), value, kind, _strongest(f, p)))
            label = ""
    remarks: dict[str, list[str]] = {}
    for m, f in d.models.items():
        for n in f.notes:
            if n not in d.notes + d.data_notes:
                remarks.setdefault(n, []).append(m)
    return [
        table(" ".join(_of_errors(d)), ["model", "parameter", "value", "", "strongest correlation"], rows),
        Notes(tuple((strong(", ".join(of)), f": {n}") for n, of in remarks.items())),
    ]


def _of_errors(d: DatasetSummary) -> list[str]:
    """What the standard errors of these models are, in sentences."""
    off = [f.fit.misfit is not None for f in d.models.values()]
    said = []
    if not all(off):
        said.append(
            "Standard errors come from the scatter of the residuals, by the metric of the fit."
            if all(f.fit.chi_square is None for f in d.models.values())
            else f"Standard errors rest on the assumed uncertainty of {percent(d.u_rel_assumed)} of each value."
            if d.u_rel_assumed is not None
            else "Standard errors are those of least squares with the stated covariance; they are not scaled by χ²."
        )
    if any(off):
        said.append(
            "Of a model with a misfit tau the parameters are those of the nearest one over the measured directions. The"
            " errors say by how much they change where a part of the directions is left out."
        )
    return said


def _value(d: DatasetSummary, model: str, parameter: str, e: Estimate) -> str:
    """value ± u; the interval alone where a standard error would contradict it."""
    i = d.choice.intervals.get(parameter) if d.choice.named and model == d.choice.named.candidate.label else None
    # an interval is of the choice, at one wavelength alone
    if i is not None and d.models[model].fit.shared is None and not d.choice.linear(parameter):
        value, ends = verdict.in_words(i, e.value)
        return f"{value} ({100 * i.level:g} % interval {ends})"
    return with_u(e.value, 0.0 if e.fixed else e.u)


def _strongest(f: Fitted, parameter: str) -> Text:
    if parameter not in f.fit.free:
        return ""
    row = dict(zip(f.fit.free, f.fit.correlation[f.fit.free.index(parameter)].tolist(), strict=True))
    known = {k: v for k, v in row.items() if k != parameter and math.isfinite(v)}
    if not known:
        return ""
    other = max(known, key=lambda k: abs(known[k]))
    return f"{number(known[other], 2)} with ", code(other)


def _metrics(s: Summary, d: DatasetSummary) -> list[Block]:
    known = d.uncertainty_stated or d.u_rel_assumed is not None
    names = [n for n in s.metrics if any(f.metrics[n] is not None for f in d.models.values())]
    rows = [[m, *(number(f.metrics[n]) for n in names)] for m, f in d.models.items()]
    return [
        table("", ["model", *(s.metrics[n]["label"] for n in names)], rows, right=tuple(range(1, len(names) + 1))),
        facts((s.metrics[n]["label"], meaning_of_metric(n, known=known)) for n in names),
    ]


def fitted_words(d: DatasetSummary, model: str, f: Fitted) -> str:
    """The fitted parameters of a model, with their uncertainties."""
    said = ", ".join(f"{n} = {_value(d, model, n, p)}" for n, p in f.fit.parameters.items() if not p.fixed)
    if f.fit.shared is not None:
        said += f"; geometry shared by {len(f.fit.shared.wavelengths_nm)} wavelengths"
    return said


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
    here = [b for b in d.bands if b.get("centre_nm") == d.wavelength_nm and b.get("fwhm_nm")]
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
