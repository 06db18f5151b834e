"""What the plots of the page of `gonio watch` show of a run so far."""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
from gonio_analysis.curves.in_plane import MOST_CURVES, curves, labels, selection
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import independent
from gonio_analysis.plots import thinning
from gonio_analysis.report.viewer import MOST_LISTED, ViewerData, WaveView, entry, points

from gonio.geometry import IN_PLANE, SAME_ANGLE, Directions, groups, wrap
from gonio.typing import Floats
from gonio_watch import worker
from gonio_watch.provisional import ProvisionalValues
from gonio_watch.run_status import RunStatus, rounded

NAME = "so far"
MOST = 6000
"""Values of all curves of a wavelength together."""
MOST_MAPPED = 2500
"""Values of one map."""


class Map(TypedDict):
    """Values over the hemisphere, at one angle of incidence."""

    label: str
    points: list[tuple[float, float, float]]
    """theta_r and phi_r - phi_i [deg], BRDF [1/sr]."""


class DrawnVisits(TypedDict):
    """The levels of the visits to the reference in a band."""

    name: str
    points: list[tuple[float, float, float]]
    """Time [h], level over the first visit's, standard uncertainty of that."""


class PlotsSoFar(TypedDict):
    """What the plots of the page show."""

    view: ViewerData | None
    maps: list[Map]
    visits: list[DrawnVisits]
    says: str


def so_far(
    name: str, known: Sequence[ProvisionalValues], nominal_deg: Floats, visits_s: Mapping[int, float], behind: int
) -> PlotsSoFar:
    """Curves, maps and visits of a run so far.

    Parameters
    ----------
    name
        Of the run.
    known
        Its values, a band each.
    nominal_deg
        The four angles of each point that was asked for. Values are drawn there: what the encoders read is up to some
        tenths of a degree beside it, and a curve must not change its name with every value.
    visits_s
        When the visits to the reference were taken [s, rig's clock], by their steps.
    behind
        How many steps are not reduced yet.
    """
    waves: list[WaveView] = []
    maps: list[Map] = []
    names: list[str] = []
    latest: list[str] = []
    moving = "θr"
    for values in known:
        data = _observations(values, nominal_deg)
        found = selection(curves(data), MOST_LISTED) if len(data) else []
        listed = [thinning.of_curve(curve, thinning.share(found, MOST)) for curve in found]
        if not listed:
            continue
        moving = "θr" if listed[0].scanned == "theta_r" else "θi"
        own = labels(listed)
        names += own
        by_age = sorted(zip(found, own, strict=True), key=lambda pair: int(pair[0].rows.max()))
        latest += [label for _, label in by_age[-MOST_CURVES:]]
        entries = [entry(c, label, [points(NAME, c, c.brdf, c.u)]) for c, label in zip(listed, own, strict=True)]
        waves.append({"nm": values.band.centre_nm, "curves": entries})
        if not maps:
            maps = _maps(data)
    view: ViewerData = {
        "name": name, "moving": moving, "at": 0, "labels": list(dict.fromkeys(names)),
        "shown": list(dict.fromkeys(latest)), "points": [NAME], "models": [], "chosen": [NAME],
        "normalise": "mirror", "note": "", "waves": waves,
    }  # fmt: skip
    visits: list[DrawnVisits] = [
        {
            "name": v.band.name,
            "points": [(visits_s.get(n, 0.0) / 3600.0, rounded(r, 7), rounded(u, 3)) for n, r, u in v.visits],
        }
        for v in known
    ]
    says = f"{behind} steps are not reduced yet." if behind else ""
    if known and known[0].steps:
        says = f"At the plan's angles; the reference is known up to its last measurement. {says}".strip()
    return {"view": view if waves else None, "maps": maps, "visits": visits, "says": says}


def _observations(values: ProvisionalValues, nominal_deg: Floats) -> Observations:
    """Values at the angles that were asked for, those in front of the sample alone."""
    asked = nominal_deg[values.points]
    rows = np.flatnonzero(np.isfinite(values.brdf) & (asked[:, 2] <= 90.0))
    return Observations(
        Directions.from_degrees(*asked[rows].T),
        np.full(rows.size, values.band.centre_nm),
        values.brdf[rows],
        independent(values.u[rows]),
        np.arange(rows.size),
    )


def _maps(data: Observations) -> list[Map]:
    """A map of each direction of incidence with values out of its plane."""
    at, out = data.directions, list[Map]()
    for group in groups(at.theta_i, at.phi_i, np.arange(len(data))):
        here = at[group]
        if float(here.theta_i.max()) < SAME_ANGLE or not np.any(np.abs(here.out_of_plane) > IN_PLANE):
            continue
        chosen = group[:: -(-group.size // MOST_MAPPED)]
        dphi = np.degrees(wrap(at[chosen].phi_r - at[chosen].phi_i))
        polar, brdf = np.degrees(at[chosen].theta_r), data.brdf[chosen]
        rows = [(_short(t), _short(p), _short(f)) for t, p, f in zip(polar, dphi, brdf, strict=True)]
        out.append({"label": f"θi = {round(float(np.degrees(here.theta_i.mean())), 1):g}°", "points": rows})
    return out


def _short(value: Floats | float) -> float:
    return float(f"{float(value):.5g}")


def encoded(shown: PlotsSoFar) -> bytes:
    """As the page reads it."""
    return json.dumps(shown, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()


def work() -> None:
    """The process that works out a run's values: arguments are the run and the folder for what is found."""
    run, out = map(Path, sys.argv[1:])

    def draw(run_status: RunStatus, values: Sequence[ProvisionalValues], behind: int) -> bytes:
        return encoded(so_far(run.name, values, run_status.every_angle(), run_status.visits_s, behind))

    worker.serve(run, out, draw)
