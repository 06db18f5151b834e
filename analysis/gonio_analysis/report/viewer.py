"""What the interactive plot of a page shows: the JSON embedded in the page, which is also written as a table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

import numpy as np

from gonio.instrument.parts import DIRECTIONAL, SPECULAR, UNIFORM, uniform
from gonio.models import Model, Sum
from gonio.polarisation import UNPOLARISED
from gonio.shown import finite
from gonio.typing import Floats
from gonio_analysis.curves.in_plane import MOST_CURVES, Curve, bright_mirror, curves, evenly, labels, selection
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import known_wavelength
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import thinning
from gonio_analysis.selection.compare import theory_angles

if TYPE_CHECKING:
    from gonio_analysis.report.facts import DatasetSummary

MOST_LISTED = 16
"""Curves of one wavelength that can be chosen, at most."""
BYTES = 1_200_000
"""Room on a page for the data of all its interactive plots, about."""
LEVELS = ((MOST_LISTED, 40), (MOST_CURVES, 40), (MOST_CURVES, 12), (3, 8), (2, 4))
"""Curves of one wavelength, and wavelengths: the first of these that leaves `FEWEST` values a curve is taken."""
FEWEST = 60
MEASURED_BYTES, THEORY_BYTES = 28, 17
"""Bytes of one measured value, and of one of theory."""
COLUMNS = ("wavelength_nm", "curve", "series", "signed_angle_deg", "brdf", "u_brdf")


LineParts = dict[str, list[float | None] | float | None]
"""By the name of a part [1/sr]: its values along a line, one for all angles, or None for what the others leave."""


class Series(TypedDict):
    """Points or a line along a curve."""

    name: str
    angle: list[float]
    """Degrees."""
    brdf: list[float | None]
    """1/sr."""
    u: list[float | None] | None
    by: dict[str, float | None]
    """What it is divided by, in each normalisation."""
    parts: NotRequired[LineParts]
    """Of a model that has several."""


class CurveView(TypedDict):
    """One in-plane curve."""

    label: str
    mirror: float
    """Where the mirror direction is [deg]."""
    series: list[Series]


class WaveView(TypedDict):
    """The curves at one wavelength, or (None) in a broad band."""

    nm: float | None
    curves: list[CurveView]


class ViewerData(TypedDict):
    """The data that the page's script reads, as JSON."""

    name: str
    plot: NotRequired[str]
    moving: str
    at: int
    """Which of `waves` is shown at first."""
    labels: list[str]
    shown: list[str]
    points: list[str]
    models: list[str]
    chosen: list[str]
    normalise: str
    note: str
    waves: list[WaveView]


def viewer(d: DatasetSummary, normalise: str, room: int = BYTES) -> ViewerData:
    """In-plane curves of a sample at every wavelength that was fitted, with every model's theory.

    Parameters
    ----------
    d
        The measurement with its fitted models.
    normalise
        What the plot divides by at first.
    room
        For its data, in bytes. Where they need more, curves are thinned as in the figures, then fewer of them and of
        the wavelengths can be chosen; `note` says so.

    Returns
    -------
    View
        Values have seven digits, theory five.
    """
    waves = _results(d)
    here, own = d.wavelength_nm, "simulated" if d.simulated else "measured"
    drawn = {int(c.rows[0]) for c in d.curves}
    known = {
        nm: d.every_state if nm == here else next(iter(results.values())).data
        for nm, results in sorted(waves.items(), key=lambda item: item[0] or 0.0)
    }
    chosen, most = _level({nm: curves(data) for nm, data in known.items()}, here, drawn, len(d.models), room)
    ready = {m: {int(c.curve.rows[0]): (c.theory_angle, c.theory) for c in f.drawn} for m, f in d.models.items()}
    first, out, values, shown = list[str](), list[WaveView](), 0, 0
    for nm, listed in chosen.items():
        entries: list[CurveView] = []
        for whole, name in zip(listed, labels(listed), strict=True):
            curve = thinning.of_curve(whole, most)
            values, shown = values + whole.angle.size, shown + curve.angle.size
            kept = nm == here and int(whole.rows[0]) in drawn
            first += [name] * kept
            theory = {}
            for model, result in waves[nm].items():
                found = ready[model].get(int(whole.rows[0])) if kept and curve is whole else None
                if found is None or found[0].size > most + 400:
                    angle = theory_angles(curve, known[nm], dense=False)
                    found = angle, curve.theory(result.model, angle, known[nm])
                theory[model] = (*found, of_line(result.model, curve, found[0], known[nm]))
            entries.append(_curve(curve, name, own, theory))
        out.append({"nm": nm, "curves": entries})
    return {
        "name": d.title,
        "moving": "θr" if d.scanned == "theta_r" else "θi",
        "at": next(k for k, w in enumerate(out) if w["nm"] == here),
        "labels": list(dict.fromkeys([*first, *(c["label"] for w in out for c in w["curves"])])),
        "shown": first,
        "points": [own],
        "models": list(d.models),
        "chosen": [own, *([d.best] if d.best else [])],
        "normalise": normalise,
        "note": note(shown, values, len(out), len(known)),
        "waves": out,
    }


def _results(d: DatasetSummary) -> dict[float | None, dict[str, FitResult]]:
    """Every fit by wavelength, None for a broad band, and by model."""
    waves: dict[float | None, dict[str, FitResult]] = {}
    for model, f in d.models.items():
        for result in f.series or [f.fit]:
            at = finite(result.data.wavelengths[0]) if len(d.wavelengths_nm) > 1 else d.wavelength_nm
            waves.setdefault(at, {})[model] = result
    return waves


def _level(
    every: dict[float | None, list[Curve]], here: float | None, drawn: set[int], models: int, room: int
) -> tuple[dict[float | None, list[Curve]], int]:
    """The curves to list at each wavelength, and how many values of one are shown."""
    names, chosen, most = list(every), dict[float | None, list[Curve]](), 0
    for curves_listed, waves_listed in LEVELS:
        picks = evenly(len(names), waves_listed)
        chosen = {}
        for k, nm in enumerate(names):
            if k in picks or nm == here:
                listed = {int(c.rows[0]) for c in selection(every[nm], curves_listed)}
                listed |= drawn if nm == here else set()
                chosen[nm] = [c for c in every[nm] if int(c.rows[0]) in listed]
        sizes = [c.angle.size for shown in chosen.values() for c in shown]
        each = room / max(len(sizes), 1) - 100 * THEORY_BYTES * models
        most = int(each / (MEASURED_BYTES + THEORY_BYTES * models))
        if most >= FEWEST or most >= max(sizes, default=0):
            break
    return chosen, max(most, 24)


def note(drawn: int, of: int, waves: int, known: int) -> str:
    """A sentence on what the plot leaves out; empty where that is nothing."""
    parts = []
    if drawn < of:
        parts.append(
            f"{drawn} of the {of} values of these curves are here: the extremes, and some of those that overlap"
        )
    if waves < known:
        parts.append(f"{waves} of {known} wavelengths are here")
    return "; ".join(parts) + "; all values are in tables/." if parts else ""


def _curve(c: Curve, name: str, own: str, theory: dict[str, tuple[Floats, Floats, LineParts]]) -> CurveView:
    mirror = bright_mirror(c)
    places = {"mirror": None if mirror is None else c.angle[mirror], "model": c.parameter}
    series = [points(own, c, c.brdf, c.u)]
    for model, (angle, value, parts) in theory.items():
        by = {
            kind: None if where is None else _positive(value[int(np.argmin(np.abs(angle - where)))])
            for kind, where in places.items()
        } | {"max": series[0]["by"]["max"]}
        line: Series = {"name": model, "angle": _degrees(angle), "brdf": _rounded(value, 5), "u": None, "by": by}
        series.append(line | {"parts": parts} if parts else line)
    return entry(c, name, series)


def of_line(model: Any, c: Curve, angle: Floats, data: Observations) -> LineParts:
    """The parts of a model along a curve, as `gonio.instrument.parts`; empty where it has one alone.

    Polarised light has none: a part shows it in another way than the whole.
    """
    if not isinstance(model, Model) or c.state != UNPOLARISED:
        return {}
    if isinstance(model, Sum):
        *first, last = ((f"{term.name} {j}", term, weight) for j, (term, weight) in enumerate(model.terms, 1))
        return {name: _rounded(weight * c.theory(term, angle, data), 5) for name, term, weight in first} | {
            last[0]: None
        }
    wave = known_wavelength(data.wavelengths[0])
    cones = {
        "source_solid_angle_sr": data.source_solid_angle_sr, "receiver_solid_angle_sr": data.receiver_solid_angle_sr
    }  # fmt: skip
    out: LineParts = {}
    if model.has_spike and any(cones.values()):
        from gonio.instrument import apparent_spike

        spike = np.asarray(
            apparent_spike(model, *c.directions(angle).angles, wavelength_nm=wave, spike="exact", **cones)
        )
        out |= {SPECULAR: _rounded(spike, 5)} if spike.any() else {}
    even = uniform(model, wave)
    out |= {UNIFORM: float(f"{even:.5g}")} if even > 0.0 else {}
    return out | {DIRECTIONAL: None} if out else {}


def entry(c: Curve, label: str, series: list[Series]) -> CurveView:
    """A curve with what is drawn along it."""
    return {"label": label, "mirror": round(float(np.degrees(c.parameter)), 4), "series": series}


def points(name: str, c: Curve, brdf: Floats, u: Floats) -> Series:
    """Values [1/sr] along a curve as a series; it is divided by its own value in the mirror direction, or largest."""
    mirror = None if (k := bright_mirror(c)) is None else _positive(brdf[k])
    return {
        "name": name,
        "angle": _degrees(c.angle),
        "brdf": _rounded(brdf, 7),
        "u": _rounded(u, 4) if np.isfinite(u).any() else None,
        "by": {"max": _positive(brdf[int(np.argmax(c.brdf))]), "mirror": mirror},
    }


def rows(view: ViewerData) -> Iterator[tuple[Any, ...]]:
    """The same curves as rows of a table with `COLUMNS`."""
    for wave in view["waves"]:
        for curve in wave["curves"]:
            for s in curve["series"]:
                for angle, brdf, u in zip(s["angle"], s["brdf"], s["u"] or [None] * len(s["angle"]), strict=True):
                    yield wave["nm"], curve["label"], s["name"], angle, brdf, u


def _degrees(angle: Floats) -> list[float]:
    """To a ten-thousandth: finer than any readback."""
    return [float(a) for a in np.round(np.degrees(angle), 4)]


def _rounded(values: Floats, digits: int) -> list[float | None]:
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in values]


def _positive(value: float) -> float | None:
    return float(f"{value:.9g}") if np.isfinite(value) and value > 0 else None
