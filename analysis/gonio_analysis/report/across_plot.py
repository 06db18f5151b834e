"""One plot of several samples, all of them at each incidence: for the page, and for print and files."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.changes.point_by_point import laid_on
from gonio_analysis.curves.in_plane import MOST_CURVES, Curve, Line, curves, evenly, labels
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import in_plane, thinning
from gonio_analysis.report import viewer
from gonio_analysis.report.comparison import sides_of
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.figures import key
from gonio_analysis.report.lobe_pairs import same_incidence
from gonio_analysis.selection.compare import Dataset

MOST_SAMPLES = 6
"""Samples in one plot: more lines nobody tells apart."""
MOST_PANELS = 4
"""Incidences of the printed figure."""
MOST_WAVES = 12
"""Wavelengths that can be chosen."""
MOST_DRAWN = 1200
"""Values in one panel."""
SPIKE, APART = 30.0, 6.0
"""Largest value over the median, or over the largest of the lowest sample, above which a logarithmic plot comes first:
a polar one shows the highest sample, and of one that is six times lower a blot."""


Together = list[tuple[str, Curve]]
"""The curves of one incidence, by the samples' names."""


def view(datasets: Sequence[Dataset], room: int = viewer.BYTES) -> viewer.ViewerData | None:
    """What the interactive plot shows: at each incidence the values of all samples; None where there is no curve.

    Parameters
    ----------
    datasets
        Two or more samples, of which the first `MOST_SAMPLES` are shown.
    room
        For the data, in bytes; longer curves are thinned, and `note` says so.
    """
    shown = datasets[:MOST_SAMPLES]
    data = _laid([side.measured for side in sides_of(shown)])
    names = [d.title for d in shown]
    waves = _waves(data, shown[0].wavelength_nm)
    every = {nm: _together(names, [x if nm is None else x.nearest(nm)[0] for x in data]) for nm in waves}
    every = {nm: groups for nm, groups in every.items() if groups}
    if not every:
        return None
    many = sum(len(group) for groups in every.values() for group in groups)
    most = max(int(room / (viewer.MEASURED_BYTES * many)), viewer.FEWEST)
    out, kept, known, listed = list[viewer.WaveView](), 0, 0, list[str]()
    for nm, groups in every.items():
        entries = []
        for group, label in zip(groups, labels([group[0][1] for group in groups]), strict=True):
            some = [(name, curve, thinning.of_curve(curve, most)) for name, curve in group]
            known += sum(curve.angle.size for _, curve, _ in some)
            kept += sum(short.angle.size for *_, short in some)
            series = [viewer.points(name, short, short.brdf, short.u) for name, _, short in some]
            entries.append(viewer.entry(group[0][1], label, series))
            listed.append(label)
        out.append({"nm": nm, "curves": entries})
    first = shown[0].wavelength_nm
    at = next((k for k, wave in enumerate(out) if wave["nm"] == first), 0)
    here = list(every.values())[at]
    none = [np.empty(0)]
    values = [np.concatenate([c.brdf for g in here for own, c in g if own == name] or none) for name in names]
    return {
        "name": " and ".join(names) if len(names) == 2 else f"{len(names)} samples",
        "plot": "log" if _logarithmic(values) else "polar",
        "moving": "θr" if here[0][0][1].scanned == "theta_r" else "θi",
        "at": at,
        "labels": list(dict.fromkeys(listed)),
        "shown": [curve["label"] for curve in out[at]["curves"]][:MOST_PANELS],
        "points": names,
        "models": [],
        "chosen": names,
        "normalise": "none",
        "note": viewer.note(kept, known, len(out), len(waves)),
        "waves": out,
    }


def _logarithmic(samples: Sequence[Floats]) -> bool:
    """Whether a polar plot of these values would hide a sample, or all but a spike."""
    positive = [values[values > 0.0] for values in samples if np.any(values > 0.0)]
    if not positive:
        return False
    largest = [float(values.max()) for values in positive]
    return max(largest) > min(SPIKE * float(np.median(np.concatenate(positive))), APART * min(largest))


def _laid(data: Sequence[Observations]) -> list[Observations]:
    """All planes of incidence on that of the first sample."""
    return [data[0], *(laid_on(data[0], one)[0] for one in data[1:])]


def _waves(data: Sequence[Observations], shown: float | None) -> list[float | None]:
    """The wavelengths of the first sample that all have, the one of the report among them; None for a broad band."""
    known = [w for w in data[0].wavelengths if not math.isnan(w)]
    common = [w for w in known if all(abs(x.nearest(w)[1] - w) <= 0.5 for x in data)]
    picked = {common[k] for k in evenly(len(common), MOST_WAVES)} | {w for w in common if w == shown}
    return [*sorted(picked)] or [None]


def _together(names: Sequence[str], data: Sequence[Observations]) -> list[Together]:
    """Curves in the plane of incidence that lie at one incidence; at most `MOST_CURVES` of those that most have."""
    groups = list[Together]()
    for name, one in zip(names, data, strict=True):
        for curve in curves(one):
            found = next((g for g in groups if same_incidence(g[0][1], curve) and g[-1][0] != name), None)
            if found is None:
                groups.append([(name, curve)])
            else:
                found.append((name, curve))
    most = max((len(group) for group in groups), default=0)
    groups = [group for group in groups if len(group) == most]
    return sorted((groups[k] for k in evenly(len(groups), MOST_CURVES)), key=lambda group: group[0][1].parameter)


def draw(datasets: Sequence[Dataset]) -> list[Drawing]:
    """The same for print and files: a panel an incidence, a line a sample."""
    shown = datasets[:MOST_SAMPLES]
    names = [d.title for d in shown]
    groups = _together(names, _laid([d.data for d in shown]))
    groups = [groups[k] for k in evenly(len(groups), MOST_PANELS)]
    if not groups:
        return []
    nothing = np.empty(0)
    panels = []
    for group, label in zip(groups, labels([group[0][1] for group in groups]), strict=True):
        short = {name: thinning.of_curve(curve, MOST_DRAWN // len(group)) for name, curve in group}
        lines = [
            Line(name, c.angle, c.brdf, nothing, nothing, c.u) if (c := short.get(name)) else
            Line(name, nothing, nothing, nothing, nothing, nothing) for name in names
        ]  # fmt: skip
        panels.append((label, lines))
    logarithmic = any(_logarithmic([line.theory for line in lines]) for _, lines in panels)
    at = "" if shown[0].wavelength_nm is None else f" at {shown[0].wavelength_nm:g} nm"
    caption = f"All samples in the plane of incidence{at}: {', '.join(names)}; a panel for each angle of incidence."
    rows = -(-len(panels) // 2)
    on = partial(_on_panels, panels=panels, logarithmic=logarithmic)
    return [Drawing("samples", "samples", "", caption, caption, (7.0, 0.5 + 2.1 * rows), on)]


def _on_panels(figure: Any, *, panels: Sequence[tuple[str, list[Line]]], logarithmic: bool) -> None:
    rows, columns = -(-len(panels) // 2), min(len(panels), 2)
    high = figure.get_figheight()
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(0.09 if logarithmic else 0.03, 0.75 / high, 0.97, 1.0 - 0.25 / high, 0.2, 0.45)
    for ax in axes.ravel()[len(panels) :]:
        ax.set_visible(False)
    for ax, (label, lines) in zip(axes.ravel(), panels, strict=False):
        if logarithmic:
            for k, line in enumerate(lines):
                some = line.theory > 0.0
                ax.semilogy(np.degrees(line.theory_angle[some]), line.theory[some], color=in_plane.style(k)["color"])
            ax.set_ylabel("BRDF / sr⁻¹")
            in_plane.angle_axis(ax)
            in_plane.clean(ax)
        else:
            in_plane.polar(ax, lines, radius=in_plane.radius_of(lines, math.inf), radius_label="BRDF / sr⁻¹")
        ax.set_title(label, fontsize=8, pad=2)
    key(figure, in_plane.handles(panels[0][1]), min(len(panels[0][1]), 3))
