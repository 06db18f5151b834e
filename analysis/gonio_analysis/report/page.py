"""`index.html`: the summary and the figures as one page that needs no other file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from gonio import geometry
from gonio_analysis.report import html, model_choice, viewer
from gonio_analysis.report.figures import Figure
from gonio_analysis.report.text import CAUSES, cause, difference, number, percent, with_u

MOST_BYTES = 4_500_000
"""Of one page: what a mail takes and a browser shows at once."""
MOST_SOURCES = 50
"""Samples whose provenance stands on the page."""
MOST_ROWS = 300
"""Of a table on a page; the files in `tables/` have all of them."""


def render(
    summary: dict[str, Any], drawn: Sequence[Sequence[Figure]], views: Sequence[dict[str, Any] | None]
) -> dict[str, str]:
    """The pages, as HTML by the name of their file: `index.html`, and further ones for samples that it cannot hold.

    No page is larger than `MOST_BYTES`, whatever was measured. Each needs no other file.

    Parameters
    ----------
    summary
        What `summary.json` holds.
    drawn
        The figures of each dataset, in the order of the summary.
    views
        What each dataset's interactive plot shows; None for one without curves.
    """
    datasets = summary["datasets"]
    script = viewer.script() if any(views) else ""
    overview = _overview(summary) if len(datasets) > 1 else ""
    frame = _conventions(summary) + _provenance(summary) + _footer() + script
    room = MOST_BYTES - html.size(html.document(summary["title"], [overview, frame])) - 300 * len(datasets) - 10_000
    sections = [
        html.within(_dataset(summary, *parts), max(room, MOST_BYTES // 4))
        for parts in zip(datasets, drawn, views, strict=True)
    ]
    groups: list[list[int]] = [[]]
    used = 0
    for k, section in enumerate(sections):
        if groups[-1] and used + html.size(section) > room:
            groups.append([])
            used = 0
        groups[-1].append(k)
        used += html.size(section)
    names = ["index.html", *(f"samples-{k}.html" for k in range(2, len(groups) + 1))]
    place = {datasets[k]["slug"]: name for name, group in zip(names, groups, strict=True) for k in group}
    pages = {}
    for name, group in zip(names, groups, strict=True):
        here = [sections[k] for k in group]
        body = [_header(summary, place, name), overview if name == "index.html" else "", *here]
        body += [_conventions(summary), _provenance(summary)] if name == "index.html" else []
        pages[name] = html.document(
            summary["title"], [_linked(part, place, name) for part in [*body, _footer()]] + [script]
        )
    return pages


def _linked(part: str, place: dict[str, str], name: str) -> str:
    """Links to samples, which may stand on another page."""
    if len(set(place.values())) == 1:
        return part
    return re.sub(
        r'href="#([^"]+)"',
        lambda m: f'href="{place[m[1]]}#{m[1]}"' if place.get(m[1], name) != name else m[0],
        part,
    )


def _header(s: dict[str, Any], place: dict[str, str], name: str) -> str:
    links = [(d["slug"], d["name"]) for d in s["datasets"]] if len(s["datasets"]) > 1 else []
    if name == "index.html":
        links += [("conventions", "Conventions"), ("provenance", "Provenance")]
    nav = "".join(f'<li><a href="#{slug}">{escape(label)}</a></li>' for slug, label in links[:MOST_ROWS])
    pages = list(dict.fromkeys(place.values()))
    parts = ""
    if len(pages) > 1:
        parts = (
            f'<p class="note">Page {pages.index(name) + 1} of {len(pages)}: all samples together would be too large for'
            f" one. The others are {', '.join(f'<code>{p}</code>' for p in pages if p != name)}.</p>\n"
        )
    return (
        f'<header>\n<h1>{escape(s["title"])}</h1>\n<p class="sub">BRDF comparison, {escape(s["created"][:10])}, gonio '
        f"{escape(s['versions']['gonio'])}. Uncertainties are standard uncertainties (k = 1).</p>\n"
        f'{parts}<nav aria-label="Sections"><ul>{nav}</ul></nav>\n</header>'
    )


def _overview(s: dict[str, Any]) -> str:
    rows = []
    for d in s["datasets"]:
        for name, f in d["models"].items():
            rows.append(
                [
                    f'<a href="#{d["slug"]}">{escape(d["name"])}</a>',
                    f"<b>{escape(name)}</b>",
                    number(f["reduced_chi_square"]),
                    difference(f["metrics"]["log_ratio"]),
                    escape(_short(f)),
                ]
            )
        for name in d["skipped"]:
            link = f'<a href="#{d["slug"]}">{escape(d["name"])}</a>'
            rows.append([link, f"<b>{escape(name)}</b>", "–", "–", "not fitted: see there"])
    return "<h2>All samples</h2>\n" + html.table(
        "Every model on every sample.",
        ["sample", "model", "reduced χ²", "typical difference", "fitted parameters"],
        rows,
        right=(2, 3),
        most=(MOST_ROWS, "metrics.csv and parameters.csv"),
    )


def _dataset(s: dict[str, Any], d: dict[str, Any], figures: Sequence[Figure], view: dict[str, Any] | None) -> str:
    by: dict[str, list[Figure]] = {}
    for f in figures:
        by.setdefault(f.kind, []).append(f)
    out = [f'<section id="{d["slug"]}">', f"<h2>{escape(d['name'])}</h2>" if len(s["datasets"]) > 1 else ""]
    out.append(f'<p class="lead">{escape(html.glued(d["conclusion"]))}</p>')
    out += ["<h3>What was measured, and how</h3>", _facts(d)]
    if d["notes"]:
        out.append(html.notes(d["notes"]))
    out += model_choice.section(d["choice"])
    out += ["<h3>Models</h3>", _models(d)] if d["models"] else ["<h3>Measured values</h3>", _values(d)]
    if d["skipped"]:
        out.append(
            '<ul class="notes">'
            + "".join(f"<li><b>{escape(m)}</b> was not fitted: {escape(why)}</li>" for m, why in d["skipped"].items())
            + "</ul>"
        )
    if "polar" in by:
        out += ["<h3>In the plane of incidence, normalised</h3>", _polar_words(s, d)]
        out += [viewer.element(view, d["slug"]) if view else "", html.grid(by["polar"])]
    if "absolute" in by:
        out += ["<h3>In the plane of incidence, absolute, with residuals</h3>", html.grid(by["absolute"])]
    beyond = [f for kind in ("heat", "slices", "lobe") for f in by.get(kind, [])]
    if beyond:
        out += ["<h3>Out of the plane of incidence</h3>", html.grid(beyond)]
    if d["models"]:
        out += ["<h3>Parameters</h3>", _parameters(d), html.grid(by["profile"]) if "profile" in by else ""]
        out += ["<h3>Metrics</h3>", _metrics(s, d)]
    if "budget" in by:
        shown = [*by["budget"], *by.get("budget-angle", [])]
        out += ["<h3>Uncertainty</h3>", html.grid(shown), _budget(d)]
    else:
        out.append(
            "<h3>Uncertainty</h3><p>The table states no uncertainties: there are no error bars and no chi-square, and "
            "fits compare logarithms, every value alike.</p>"
        )
    if "series" in by:
        out += ["<h3>Parameters over wavelength</h3>", html.grid(by["series"])]
    out.append("</section>")
    return "\n".join(out)


def _values(d: dict[str, Any]) -> str:
    rows = [
        [
            number(v["wavelength_nm"], 6),
            *(number(v[f"{angle}_deg"], 4) for angle in ("theta_i", "phi_i", "theta_r", "phi_r")),
            number(v["brdf"], 4) if v["u_brdf"] is None else with_u(v["brdf"], v["u_brdf"]),
            number(math.pi * v["brdf"], 4),
        ]
        for v in d["values"]
    ]
    return html.table(
        "π f is the albedo of a Lambertian surface with this BRDF, and the reflectance factor.",
        ["wavelength/nm", "θi/°", "φi/°", "θr/°", "φr/°", "BRDF f/sr⁻¹", "π f"],
        rows,
        right=tuple(range(7)),
        of=(d["usable_everywhere"], f"{d['slug']}-all-values.csv"),
    )


def _facts(d: dict[str, Any]) -> str:
    run = d["run"]
    wavelengths = [w for w in d["wavelengths_nm"] if w is not None]
    rows: list[tuple[str, str]] = [("source", d["source"] or "–")]
    if run:
        rows.append(("rig", f"{run['rig']} ({run['driver']}), seed {run['seed']}"))
        rows.append(("plan", f"{run['plan']}: {run['points']} points" + _unreachable(run)))
        if run["sample"]:
            given = ", ".join(f"{k} = {v}" for k, v in run["sample"]["parameters"].items())
            rows.append(("simulated sample", f"{run['sample']['name']}: {run['sample']['model']} with {given}"))
        rows.append(("white reference", run["reference"]))
    if wavelengths:
        others = (
            f", one of {len(wavelengths)} from {wavelengths[0]:g} to {wavelengths[-1]:g} nm"
            if len(wavelengths) > 1
            else ""
        )
        rows.append(("wavelength", f"{d['wavelength_nm']:g} nm{others}{_width(d)}"))
    else:
        rows.append(("band", ", ".join(_band(b) for b in d["bands"]) or "broad; no wavelength stated"))
    rows.append(("incidences", _angles(d["theta_i_deg"])))
    used = f"{d['used']} of {d['rows_here']}" + (" at this wavelength" if len(wavelengths) > 1 else "")
    rows.append(("values used", used + (f"; left out: {d['left_out_words']}" if d["left_out_words"] else "")))
    rows.append(
        (
            "BRDF",
            f"{number(d['brdf_min'])} to {number(d['brdf_max'])} sr⁻¹"
            + (f"; {d['negative']} values are negative within the noise" if d["negative"] else ""),
        )
    )
    cones = [("source", d["source_solid_angle_sr"]), ("receiver", d["receiver_solid_angle_sr"])]
    rows.append(("solid angles", ", ".join(f"{n} {_cone(w)}" for n, w in cones)))
    if d["uncertainty_stated"]:
        causes = ", ".join(cause(c) for c in d["causes"]) or "none"
        rows.append(("uncertainty", f"median {percent(d['median_u_rel'])}; causes common to all values: {causes}"))
    else:
        rows.append(("uncertainty", "none stated"))
    return html.facts(rows)


def _models(d: dict[str, Any]) -> str:
    rows, marks = [], []
    for name, f in d["models"].items():
        marks.append("best" if name == d["best"] and len(d["models"]) > 1 else "")
        rows.append(
            [
                escape(name),
                escape(_short(f)),
                number(f["reduced_chi_square"]),
                difference(f["metrics"]["log_ratio"]),
                escape(f["verdict"]),
            ]
        )
    note = "● marks the model that fits best. Typical difference: rms of ln(model / measured)." if any(marks) else ""
    return html.table(
        note,
        ["model", "fitted parameters", "reduced χ²", "typical difference", "verdict"],
        rows,
        right=(2, 3),
        marks=marks,
    )


def _polar_words(s: dict[str, Any], d: dict[str, Any]) -> str:
    kinds = {c["normalised_by"] for f in d["models"].values() for c in f["curves"]}
    first = (
        "The radius is the BRDF divided by its value in the direction of mirror reflection, as in eq. 11 of He, "
        f"Torrance, Sillion and Greenberg (1991): the measured value nearest the mirror, within "
        f"{s['mirror_tolerance_deg']:g}°; "
        "theory is divided by its own value in that direction. "
        if "mirror" in kinds
        else ""
    )
    if "max" in kinds:
        first += (
            "Where that direction was not measured, or the largest value was asked for, the divisor is the largest "
            "in-plane value, and theory is divided by its own value in that direction. "
        )
    if "model" in kinds:
        first += "Measurement and theory are both divided by the fitted model's value in the mirror direction. "
    moving = "detector" if d["scanned"] == "theta_r" else "source"
    return (
        f"<p>{escape(first)}The {moving} moves from −90° (retro side, left) to 90° (mirror side, right); the short "
        "strokes on the rim mark the mirror directions. In plane means within "
        f"{s['in_plane_tolerance_deg']:g}° of the plane of incidence; the values shown are within "
        f"{number(d['out_of_plane_deg'], 2) if d['out_of_plane_deg'] > 1e-6 else '0'}°.</p>"
    )


def _parameters(d: dict[str, Any]) -> str:
    rows = []
    for name, f in d["models"].items():
        first = True
        for p, e in [*f["parameters"].items(), *f["derived"].items()]:
            label = escape(name) if first else ""
            kind = "derived" if p in f["derived"] else "fixed" if e["fixed"] else "fitted"
            value = with_u(e["value"], 0.0 if e["fixed"] else e["u"])
            value += f" ({escape(e['material'])})" if e.get("material") else ""
            strong = _strongest(f, p)
            rows.append(
                [
                    label,
                    f"<code>{escape(p)}</code>",
                    value,
                    kind + (f", at its {e['at_bound']} bound" if e.get("at_bound") else ""),
                    strong,
                ]
            )
            first = False
    notes = [(m, n) for m, f in d["models"].items() for n in f["notes"] if n not in d["notes"] + d["data_notes"]]
    listed = "".join(f"<li><b>{escape(m)}</b>: {escape(n)}</li>" for m, n in notes)
    return html.table(
        "Standard errors are those of least squares with the stated covariance; they are not scaled by χ²."
        if d["uncertainty_stated"]
        else "The table states no uncertainties: standard errors come from the scatter of the residuals.",
        ["model", "parameter", "value", "", "strongest correlation"],
        rows,
    ) + (f'<ul class="notes">{listed}</ul>' if listed else "")


def _strongest(f: dict[str, Any], parameter: str) -> str:
    row = {k: v for k, v in f["correlation"].get(parameter, {}).items() if k != parameter and v is not None}
    if not row:
        return ""
    other = max(row, key=lambda k: abs(row[k]))
    return f"{number(row[other], 2)} with <code>{escape(other)}</code>"


def _metrics(s: dict[str, Any], d: dict[str, Any]) -> str:
    names = [n for n in s["metrics"] if any(f["metrics"][n] is not None for f in d["models"].values())]
    rows = [[escape(m), *(number(f["metrics"][n]) for n in names)] for m, f in d["models"].items()]
    table = html.table(
        "", ["model", *(s["metrics"][n]["label"] for n in names)], rows, right=tuple(range(1, len(names) + 1))
    )
    return table + html.facts((v["label"], v["meaning"]) for v in (s["metrics"][n] for n in names))


def _budget(d: dict[str, Any]) -> str:
    rows = [
        [escape(cause(p["cause"])), percent(p["median"]), percent(p["p95"]), escape(CAUSES.get(p["cause"], ""))]
        for p in d["budget"]
    ]
    return html.table(
        "Standard uncertainties relative to the value.",
        ["cause", "median", "95th percentile", "what it is"],
        rows,
        right=(1, 2),
        most=(MOST_ROWS, f"{d['slug']}-budget.csv"),
    )


def _conventions(s: dict[str, Any]) -> str:
    lines: dict[str, list[str]] = {}
    for d in s["datasets"]:
        for name, f in d["models"].items():
            if f["convention"] not in lines.setdefault(name, []):
                lines[name].append(f["convention"])
    models = "".join(
        f"<dt>{escape(n)}</dt><dd>{'<br>'.join(escape(t) for t in texts)}</dd>" for n, texts in lines.items()
    )
    return (
        '<section id="conventions"><h2>Conventions</h2>\n<p>The BRDF is reflected radiance over irradiance, in sr⁻¹. '
        "Polar angles count from the surface's normal; both directions leave the surface, toward source and detector. "
        "In the plane of incidence angles are signed: positive on the mirror side, negative on the retro side. Models "
        "are averaged over the stated cones of source and receiver before they are compared; a specular spike is "
        "carried through that average.</p>\n"
        f'<dl class="facts">{models}</dl></section>'
    )


def _provenance(s: dict[str, Any]) -> str:
    out = ['<section id="provenance"><h2>Provenance</h2>']
    rows = [("report made", s["created"]), ("command", s["command"] or "–")]
    rows.append(("versions", ", ".join(f"{k} {v}" for k, v in s["versions"].items())))
    out.append(html.facts(rows))
    if len(s["datasets"]) > MOST_SOURCES:
        out.append(f"<p>The first {MOST_SOURCES} of {len(s['datasets'])} samples; summary.json has all.</p>")
    for d in s["datasets"][:MOST_SOURCES]:
        rows = [("file", d["source"] or "–"), ("format", str(d["format"] or "–"))]
        if d["run"]:
            r = d["run"]
            rows += [("measured", r["created"]), ("command", r["command"]), ("plan's SHA-256", r["plan_sha256"])]
            rows += [("seed", str(r["seed"])), ("steps", str(r["steps"])), ("bands", ", ".join(r["bands"]))]
            rows.append(("versions", ", ".join(f"{k} {v}" for k, v in r["versions"].items())))
        given = dict(d["provenance"])
        visits = given.pop("reference", []) if d["run"] else []
        rows += list(_flat(given))
        rows += [("white reference", _reference(band)) for band in visits]
        out += [f"<h3>{escape(d['name'])}</h3>", html.facts(rows)]
    out.append("</section>")
    return "\n".join(out)


def _footer() -> str:
    return (
        "<footer>Every number on this page is in <code>summary.json</code>; the curves are in <code>tables/</code>, "
        "the figures as SVG and PNG in <code>figures/</code>.</footer>"
    )


# --- pieces --------------------------------------------------------------------------------------------------------


def _short(f: dict[str, Any]) -> str:
    parts = [f"{n} = {with_u(p['value'], p['u'])}" for n, p in f["parameters"].items() if not p["fixed"]]
    return ", ".join(parts)


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


def _reference(band: dict[str, Any]) -> str:
    """What the visits to the white reference said, as `gonio.reduction.brdf.reduce` leaves it."""
    level, slope, u_slope = band["level_e_per_s_sr"], band["drift_per_hour"], band["u_drift_per_hour"]
    drift = "unknown" if slope is None else f"({with_u(100 * slope, 100 * u_slope)}) % an hour"
    steady = "on a straight line" if band["straight"] else "on no straight line"
    steady = "that tell no drift" if slope is None else steady
    return (
        f"{band['band']}: BRDF {number(band['brdf'], 4)} sr⁻¹; {band['visits']} visits {steady} (chi-square "
        f"{number(band['chi_square'])}); level {number(level, 4)} electrons a second and steradian, known to "
        f"{percent(band['u_level_rel'])}; drift {drift}; frames of one step scatter as the noise "
        f"model says, times {number(band['frame_scatter'])} in variance"
    )


def _cone(solid_angle_sr: float | None) -> str:
    if solid_angle_sr is None:
        return "unknown"
    half = math.degrees(float(geometry.half_angle_of_cone(solid_angle_sr)))
    return f"{number(solid_angle_sr)} sr (half-angle {half:.3g}°)"


def _unreachable(run: dict[str, Any]) -> str:
    parts = [f"{count} {flag}" for flag, count in run["points_not_reachable"].items()]
    return f" ({', '.join(parts)})" if parts else ""


def _band(b: dict[str, Any]) -> str:
    if "lower_nm" in b:
        return f"{b.get('name', '')}, {b['lower_nm']:g} to {b['upper_nm']:g} nm, broad"
    if "centre_nm" not in b:
        return f"{b.get('name', 'unnamed')}, without stated limits"
    return f"{b.get('name', '')}, {b.get('centre_nm')} nm, {b.get('fwhm_nm')} nm wide"


def _width(d: dict[str, Any]) -> str:
    here = [b for b in d["bands"] if b.get("centre_nm") == d["wavelength_nm"] and b.get("fwhm_nm")]
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
