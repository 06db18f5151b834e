"""Scans of a He-Torrance surface in the plane of incidence, as HTSG's figures show them: numbers and drawings."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.report.text import number

from gonio import geometry
from gonio.typing import Floats
from gonio_validation.papers.figure import NOTHING, Panel, Results, angle_panel, polar_panel, signed
from gonio_validation.papers.htsg_surfaces import CONE_SR, CONES, Simulated, beside, divided

BRDF = "BRDF [1/sr]"


@dataclass(frozen=True)
class InstrumentScan:
    """One incidence: what an instrument with two cones of `CONE_SR` sees, lobe and spike apart."""

    theta_i_deg: float
    angle_deg: Floats
    """Signed angle of reflection."""
    lobe: Floats
    """Directional and uniform diffuse, averaged over the cones [1/sr]."""
    spike: Floats
    """HTSG eq. 6 through the cones [1/sr]."""
    peak_deg: float | None
    """Where the BRDF without its spike is largest in one direction, to 0.01 degrees; None where it is even."""
    rho_s: float
    rho_dh: float
    """Directional-hemispherical reflectance: spike, lobe and uniform diffuse."""

    @property
    def total(self) -> Floats:
        """What is seen [1/sr]."""
        return self.lobe + self.spike

    @property
    def mirror(self) -> int:
        """Index of the mirror direction."""
        return int(np.argmin(np.abs(self.angle_deg - self.theta_i_deg)))

    @property
    def seen_peak_deg(self) -> float:
        """Where what is seen is largest."""
        return float(self.angle_deg[int(np.argmax(self.total))])

    @property
    def spike_over_lobe(self) -> float:
        """In the mirror direction."""
        return float(self.spike[self.mirror] / self.lobe[self.mirror])

    @property
    def normalised(self) -> Floats:
        """Divided by the value in the mirror direction, eq. 11."""
        return np.asarray(self.total / self.total[self.mirror])

    @property
    def spike_width_deg(self) -> float:
        """Full width of the spike at half its height."""
        high = self.angle_deg[self.spike >= 0.5 * self.spike.max()]
        return float(high[-1] - high[0])


def scan(model: Any, theta_i_deg: float, wavelength_nm: float) -> InstrumentScan:
    """A surface at one incidence."""
    from gonio.instrument import apparent_lobe, apparent_spike

    even = np.arange(-88.0, 88.01, 0.5)  # beyond, the horizon cuts the cones
    near = theta_i_deg + np.arange(-4.0, 4.01, 0.1)
    angle = np.unique(np.round(np.concatenate([even, near[np.abs(near) <= 88.0]]), 6))
    theta_r, phi_r = signed(angle)
    theta_i = math.radians(theta_i_deg)
    where = (theta_i, 0.0, theta_r, phi_r)
    fine = np.arange(-89.99, 90.0, 0.01)
    theta, phi = signed(fine)
    one_direction = model.brdf(theta_i, 0.0, theta, phi, wavelength_nm=wavelength_nm)
    return InstrumentScan(
        theta_i_deg,
        angle,
        np.asarray(apparent_lobe(model, *where, wavelength_nm=wavelength_nm, **CONES)),
        np.asarray(apparent_spike(model, *where, wavelength_nm=wavelength_nm, **CONES)),
        float(fine[int(np.argmax(one_direction))]) if np.ptp(one_direction) > 0.0 else None,
        float(model.specular_reflectivity(theta_i, wavelength_nm=wavelength_nm)),
        float(model.directional_hemispherical(theta_i, wavelength_nm=wavelength_nm)),
    )


def label(theta_i_deg: float) -> str:
    """As in "θi = 30°"."""
    return f"θi = {theta_i_deg:g}°"


def each(values: Mapping[float, Any], text: str = "{}") -> str:
    """A value an incidence, as in "13.3° at 10°, 41.9° at 30°"."""
    return ", ".join(f"{text.format(v)} at {i:g}°" for i, v in values.items())


def normalised(scans: Sequence[InstrumentScan], taken: Simulated) -> list[Line]:
    """Theory and the simulated measurement, each divided by its own value in the mirror direction (eq. 11)."""
    lines = []
    for s in scans:
        curve = taken.curve(s.theta_i_deg)
        k = curve.mirror
        measured = divided(curve, float(curve.brdf[k])) if k is not None else (NOTHING, NOTHING, NOTHING)
        mirror = math.radians(s.theta_i_deg)
        lines.append(Line(label(s.theta_i_deg), np.radians(s.angle_deg), s.normalised, *measured, mirror))
    return lines


def absolute(scans: Sequence[InstrumentScan], taken: Simulated) -> list[Line]:
    """Theory and the simulated measurement in 1/sr, without the values that are lost in the noise: for logarithms."""
    lines = []
    for s in scans:
        curve = taken.curve(s.theta_i_deg)
        clear = curve.brdf > 3.0 * curve.u
        angle, value, u = (v[clear] for v in divided(curve, 1.0))
        mirror = math.radians(s.theta_i_deg)
        lines.append(Line(label(s.theta_i_deg), np.radians(s.angle_deg), s.total, angle, value, u, mirror))
    return lines


def panels(scans: Sequence[InstrumentScan], taken: Simulated, *, most: float = 2.5) -> list[Panel]:
    """The polar drawing of Figs. 7 to 9, and the same curves in absolute units."""
    solid = "Solid: theory, averaged over the cones; dashed, with error bars: simulated measurement."
    missing = " Values within three standard uncertainties of zero are left out."
    caption = f"Normalised: each curve divided by its own value in the mirror direction (eq. 11). {solid}"
    return [
        polar_panel("polar", caption, normalised(scans, taken), "BRDF / BRDF in the mirror direction", most=most),
        angle_panel(
            "semilog", f"Absolute: BRDF. {solid}{missing}", absolute(scans, taken), "BRDF [1/sr]", logarithmic=True
        ),
    ]


CAPTION = (
    "Lobe's peak: where the BRDF without its spike is largest in one direction. Spike / lobe: in the mirror direction, "
    "through the cones (eq. 6); simulated: against the lobe of the directions around, which the spike misses. ρ_dh: "
    "all that is reflected."
)
COLUMNS: Mapping[str, Callable[[Any], str]] = {
    "incidence": lambda r: label(r["theta_i_deg"]),
    "lobe's peak": lambda r: f"{r['lobe_peak_deg']:.1f}°" if r["lobe_peak_deg"] is not None else "–",
    "peak through the cones": lambda r: f"{r['seen_peak_deg']:.1f}°",
    "spike / lobe": lambda r: number(r["spike_over_lobe"]),
    "simulated": lambda r: number(r["measured_spike_over_lobe"]),
    "ρ_s": lambda r: number(r["rho_s"]),
    "ρ_dh": lambda r: f"{r['rho_dh']:.3f}",
    "simulated peak": lambda r: f"{r['measured_peak_deg']:.1f}°",
}


def results(scans: Sequence[InstrumentScan], taken: Simulated) -> Results:
    """The results of each incidence; "lobe" and "spike" as in `InstrumentScan`."""
    width = 2.0 * float(geometry.half_angle_of_cone(CONE_SR))
    rows = []
    for s in scans:
        curve = taken.curve(s.theta_i_deg)
        # a spike below 1e-3 is below what can be seen of the lobe's curvature
        measured = beside(curve, s.theta_i_deg, width) if s.spike_over_lobe >= 1e-3 else None
        rows.append(
            {
                "theta_i_deg": s.theta_i_deg,
                "lobe_peak_deg": s.peak_deg,
                "seen_peak_deg": s.seen_peak_deg,
                "peak_over_mirror": float(s.normalised.max()),
                "spike_over_lobe": s.spike_over_lobe,
                "measured_spike_over_lobe": measured,
                "measured_peak_deg": float(np.degrees(curve.angle[int(np.argmax(curve.brdf))])),
                "rho_s": s.rho_s,
                "rho_dh": s.rho_dh,
            }
        )
    return Results(CAPTION, COLUMNS, rows)


def agreement(taken: Simulated) -> str:
    """How far the simulated measurement agrees with theory, as a sentence."""
    return (
        f"The simulated measurement against the model seen through the rig's own cones: reduced chi-square "
        f"{number(taken.chi_square)} over {len(taken.data)} values, nothing fitted."
    )
