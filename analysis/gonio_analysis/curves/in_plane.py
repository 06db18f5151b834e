"""Curves in the plane of incidence, and what each is normalised by.

A direction counts as in plane where it lies within `geometry.IN_PLANE` of the plane of incidence (the angle between the
direction and that plane, not an azimuth: near the normal a large azimuth is a small angle). At normal incidence that
plane is the one of `Directions.settled_at_normal`. The running angle is signed: negative on the retro side, positive on
the mirror side.

Usually the detector moves and theta_i is the curve's parameter. Where an instrument holds the detector still and moves
the source, a curve is what that instrument scanned: its parameter is theta_r, and the source's angle runs.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from gonio import geometry
from gonio.geometry import AT_MIRROR, AT_NORMAL, IN_PLANE, SAME_ANGLE, Directions, groups
from gonio.polarisation import UNPOLARISED
from gonio.typing import Floats, Ints
from gonio_analysis.fitting.forward import NO_WAVELENGTH_NM, seen
from gonio_analysis.fitting.observations import Observations


@dataclass(frozen=True)
class Line:
    """One curve of a plot: theory, measurement, or both, in the unit of the plot.

    Angles are signed and in radians (negative: retro side), values ascending in angle.
    """

    label: str
    theory_angle: Floats
    theory: Floats
    angle: Floats
    measured: Floats
    u: Floats
    """Standard uncertainties, NaN for none."""
    mirror: float | None = None
    """Angle of the mirror direction."""
    residual: Floats | None = None
    tau: float = 0.0
    """Theory is drawn with a band of a factor exp(tau) to either side, where it is above 0."""


Scanned = Literal["theta_r", "theta_i"]
Normalise = Literal["mirror", "max", "model"]

MOST_CURVES = 6
CONTINUOUS = np.radians(3.0)
"""What one direction's polar angles spread at most: encoders land some tenths of a degree beside their goal."""
DARK_MIRROR = 2.5
"""A curve that reaches this many times its mirror value is not divided by it if it peaks on the retro side, or if that
value is below the median too: an off-specular peak beyond a bright mirror direction is neither."""


@dataclass(frozen=True)
class Curve:
    """Values in the plane of incidence, by ascending signed angle."""

    scanned: Scanned
    parameter: float
    """Mean polar angle of the direction that stands still [rad]."""
    phi_i: float
    """Mean azimuth of incidence [rad]."""
    angle: Floats
    """Signed angle of the direction that moves [rad]."""
    rows: Ints
    """Which of the observations these are."""
    brdf: Floats
    u: Floats
    """Combined standard uncertainties [1/sr], NaN where none are stated."""
    out_of_plane: float
    """Largest angle of a value out of the plane of incidence [rad]."""
    state: str = UNPOLARISED
    """Of light and analyser, a word of `gonio.polarisation`."""

    @property
    def label(self) -> str:
        """As in "θi = 30°", to a tenth of a degree; "θi = 30°, sp" of polarised light."""
        state = "" if self.state == UNPOLARISED else f", {self.state}"
        return f"{'θi' if self.scanned == 'theta_r' else 'θr'} = {round(np.degrees(self.parameter), 1):g}°{state}"

    @property
    def mirror(self) -> int | None:
        """Index of the value in the mirror direction; None where that was not measured, or is not positive."""
        k = int(np.argmin(np.abs(self.angle - self.parameter)))
        return k if abs(self.angle[k] - self.parameter) <= AT_MIRROR and self.brdf[k] > 0 else None

    def theory(self, model: Any, angle: Floats, data: Observations) -> Floats:
        """The model through the instrument at signed angles [rad] along this curve [1/sr]."""
        wavelength = data.wavelengths[0]
        return seen(
            model,
            self.directions(angle),
            wavelength_nm=NO_WAVELENGTH_NM if np.isnan(wavelength) else wavelength,
            cones=(data.source_solid_angle_sr, data.receiver_solid_angle_sr),
            state=self.state,
            polarisers=data.polarisers,
        )

    def directions(self, angle: Floats) -> Directions:
        """The directions at signed angles [rad] along this curve."""
        still, (theta, dphi) = np.full(angle.shape, self.parameter), geometry.unsigned(angle)
        phi = np.full(angle.shape, self.phi_i)
        at = Directions(still, phi, theta, geometry.wrap(phi + dphi))
        if self.scanned == "theta_i":
            at = Directions(theta, geometry.wrap(phi + (np.pi - dphi)), still, geometry.wrap(phi + np.pi))
        return at


@dataclass(frozen=True)
class Norm:
    """What a curve is divided by."""

    kind: Normalise
    measured: float
    """[1/sr], for the measured values."""
    theory: float
    """[1/sr], for the theory."""
    angle: float
    """Signed angle [rad] that these values belong to."""


NORM_WORDS = {
    "mirror": "its value in the mirror direction (He et al. 1991, eq. 11)",
    "max": "its largest in-plane value",
    "model": "the fitted model's value in the mirror direction",
}


def curves(data: Observations) -> list[Curve]:
    """The in-plane curves of observations at one wavelength, by their parameter; at least two values each.

    Of polarised light each state has curves of its own; differences (Stokes parameters) are none.
    """
    frames = [(_frame(data.directions, scanned), scanned) for scanned in get_args(Scanned)]
    out = []
    for state in sorted({*data.states.tolist()}) or [UNPOLARISED]:
        here = data.states == state if data.states.size else np.ones(len(data), bool)
        if state != UNPOLARISED and not state.islower():
            continue
        by_incidence, by_view = (
            _at_one_angle(at.theta_i, groups(at.theta_i, at.phi_i, np.flatnonzero(here & (side <= IN_PLANE))))
            for (at, side), _ in frames
        )
        moved = len(by_view) * 3 <= len(by_incidence)  # the source was, in steps finer than the detector's
        out += _curves(data, by_view if moved else by_incidence, *frames[moved], state)
    return sorted(out, key=lambda c: (c.scanned, round(np.degrees(c.parameter), 1), c.phi_i, c.state))


def _at_one_angle(theta: Floats, chains: list[Ints]) -> list[Ints]:
    """The groups of `geometry.groups`; one that goes through many angles without a step, as of files that state every
    half vector (MERL), becomes those about every tenth degree."""
    out = []
    for chain in chains:
        if np.ptp(theta[chain]) <= CONTINUOUS:
            out.append(chain)
            continue
        about = (chain[np.abs(theta[chain] - np.radians(angle)) <= SAME_ANGLE] for angle in range(0, 90, 10))
        out += [rows for rows in about if rows.size]
    return out


def _frame(at: Directions, scanned: Scanned) -> tuple[Directions, Floats]:
    """Directions as of a curve, the one that stands still as that of the source, and how far out of plane each is."""
    if scanned == "theta_r":
        frame = at.settled_at_normal()
        return frame, np.abs(frame.out_of_plane)
    frame = at.swapped.settled_at_normal()
    near = np.minimum(at.theta_i, at.theta_r) < AT_NORMAL  # a plane of incidence means nothing there
    return frame, np.abs(np.where(near, frame.out_of_plane, frame.swapped.out_of_plane))


def _curves(
    data: Observations, groups: list[Ints], frame: tuple[Directions, Floats], scanned: Scanned, state: str
) -> list[Curve]:
    (every, side), u = frame, data.u
    out = []
    for group in groups:
        if group.size < 2:
            continue
        rows = group[np.argsort(every[group].signed, kind="stable")]
        at = every[rows]
        phi = np.arctan2(np.sin(at.phi_i).mean(), np.cos(at.phi_i).mean())
        out.append(
            Curve(
                scanned=scanned,
                parameter=float(at.theta_i.mean()),
                phi_i=float(geometry.wrap(phi if scanned == "theta_r" else phi + np.pi)),
                angle=at.signed,
                rows=rows,
                brdf=data.brdf[rows],
                u=u[rows],
                out_of_plane=float(side[rows].max()),
                state=state,
            )
        )
    return out


def evenly(count: int, most: int) -> list[int]:
    """Indices of at most `most` of `count` things, spread evenly."""
    return np.unique(np.round(np.linspace(0, count - 1, min(most, count))).astype(int)).tolist() if count else []


def selection(all_curves: list[Curve], most: int = MOST_CURVES) -> list[Curve]:
    """At most `most` curves for one figure, spread evenly; those with a mirror direction and many values first."""
    if len(all_curves) <= most:
        return all_curves
    enough = max(c.angle.size for c in all_curves) / 2
    good = [c for c in all_curves if c.mirror is not None and c.angle.size >= enough]
    pool = good if len(good) >= min(most, 3) else all_curves
    return [pool[k] for k in evenly(len(pool), most)]


def labels(shown: list[Curve]) -> list[str]:
    """Labels of curves on one plot: with the azimuth of incidence where the angle alone leaves two alike."""
    twins = len({c.label for c in shown}) < len(shown)
    return [c.label + (f", φi = {np.degrees(c.phi_i):.0f}°" if twins else "") for c in shown]


def norm(curve: Curve, kind: Normalise, model: Any, data: Observations) -> Norm:
    """What to divide a measured curve and its theory by.

    Parameters
    ----------
    kind
        "mirror": each by its own value in the measured direction nearest the mirror, and where that was not measured,
        or is dark beside the rest (`DARK_MIRROR`), both by the largest in-plane measurement; "max": the latter for all
        curves; "model": both by the fitted model in the mirror direction.
    """

    def of_model(angle: float) -> float:
        return float(curve.theory(model, np.array([angle]), data)[0])

    if kind == "model":
        value = of_model(curve.parameter)
        if np.isfinite(value) and value > 0:
            return Norm("model", value, value, curve.parameter)
    k = bright_mirror(curve) if kind == "mirror" else None
    chosen = int(np.argmax(curve.brdf)) if k is None else k
    angle, measured = float(curve.angle[chosen]), float(curve.brdf[chosen])
    safe = measured if measured > 0 else 1.0
    if k is None:  # where the measurement peaks a model may be dark: by its own value there it would seem bright
        return Norm("max", safe, safe, angle)
    value = of_model(angle)
    return Norm("mirror", safe, value if np.isfinite(value) and value > 0 else safe, angle)


def bright_mirror(curve: Curve) -> int | None:
    """`Curve.mirror`; None where that value is low beside the rest, too, as that of a retroreflector is."""
    if (k := curve.mirror) is None:
        return None
    value, top = curve.brdf[k], int(np.argmax(curve.brdf))
    dark = (curve.angle[top] < 0.0 or value < np.median(curve.brdf)) and curve.brdf[top] > DARK_MIRROR * value
    return None if dark else k
