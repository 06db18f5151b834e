"""He, Torrance, Sillion and Greenberg (1991), Fig. 10: sandpaper at normal incidence."""

import math
from collections.abc import Callable

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.report.text import number

from gonio.typing import Floats
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    Panel,
    PaperFigure,
    Results,
    agreed,
    angle_panel,
    at,
    polar_panel,
)
from gonio_validation.papers.htsg_scans import agreement, label, scan
from gonio_validation.papers.htsg_surfaces import (
    CONE_SR,
    PAPER,
    HtsgSurface,
    cones_parameter,
    divided,
    index_parameter,
    measure,
)

SLOPE = 4.4
"""sigma0 / tau"""
SANDPAPER = HtsgSurface(sigma0_um=440.0, tau_um=100.0, ior="Al2O3")
WAVELENGTH_NM = 550.0


def sandpaper(wavelength_nm: float, ior: str | float, tau_um: float) -> tuple[Floats, Floats]:
    """Angles [deg] and BRDF over the BRDF along the normal, at normal incidence."""
    angle = np.arange(0.0, 88.01, 0.5)
    model = HtsgSurface(SLOPE * tau_um, tau_um, ior).model
    value = np.asarray(model.brdf(0.0, 0.0, np.radians(angle), np.pi, wavelength_nm=wavelength_nm))
    return angle, value / value[0]


def claims() -> list[Claim]:
    """What the text says, judged by theory with every choice of what it leaves open."""
    choices = {
        f"{nm:g} nm, {what}, τ = {tau:g} µm": sandpaper(nm, ior, tau)
        for nm in (500.0, 550.0)
        for what, ior in (("Al2O3", "Al2O3"), ("n = 1.5", 1.5), ("SiC, n = 2.65", 2.65))
        for tau in (10.0, 100.0)
    }
    lowest = [float(a[int(np.argmin(v))]) for a, v in choices.values()]
    grazing = [at(a, v, 85.0) for a, v in choices.values()]
    rising = [bool(np.all(np.diff(v[a >= 60.0]) > 0)) for a, v in choices.values()]
    keys = [key for key in choices if key.endswith("τ = 10 µm")]
    pairs = [(choices[key][1], choices[key.replace("τ = 10 µm", "τ = 100 µm")][1]) for key in keys]
    apart = max(float(np.max(np.abs(x / y - 1.0))) for x, y in pairs)
    angle, shown = sandpaper(WAVELENGTH_NM, SANDPAPER.ior, 100.0)
    return [
        Claim(
            "“The surface shows a large reflectance at grazing reflection angles.”",
            agreed(up and g > 1.0 for up, g in zip(rising, grazing, strict=True)),
            f"smallest at {min(lowest):g}° to {max(lowest):g}°, rising from there on; at 85° {number(min(grazing))} to "
            f"{number(max(grazing))} times the value along the normal (shown: {number(at(angle, shown, 85.0))})",
            "beyond 60° the BRDF grows with the angle, and at 85° it is above that along the normal; for both "
            "wavelengths and every index tried",
        ),
        Claim(
            "“For very rough surfaces, only the ratio σ0/τ is required, not σ0 and τ separately.”",
            apart < 1e-3,
            f"τ = 10 µm and τ = 100 µm at the same ratio differ by at most {100 * apart:.2g} %",
            "less than 0.1 % between them, at every angle up to 88°",
        ),
        Claim(
            "“The large ratio of σ0/τ challenges the gentle slope assumption of the model.”",
            2.0 * SLOPE > 1.0,
            f"the rms slope 2σ0/τ is {2 * SLOPE:g}, {math.degrees(math.atan(2 * SLOPE)):.0f}° from the horizontal",
            "an rms slope above 1",
        ),
    ]


def _parameters() -> list[FigureParameter]:
    return [
        FigureParameter("σ0/τ", "4.4", "paper", "the ratio alone counts for very rough surfaces"),
        FigureParameter("τ", "100 µm", "assumed", "not given, and of no effect: the claims are tried with 10 µm too"),
        FigureParameter("a(λ)", "0", "paper"),
        FigureParameter(
            "λ", "0.55 µm", "assumed", "the text says 0.55 µm, the caption 0.5 µm; the claims are tried with both"
        ),
        FigureParameter("θi", "0°", "paper"),
        index_parameter("Al2O3", WAVELENGTH_NM),
        FigureParameter(
            "grit",
            "aluminium oxide",
            "assumed",
            "the paper says 220 grit, not of what; the claims are tried with n = 1.5 and silicon carbide too",
        ),
        cones_parameter("given for Figs. 7 and 8 alone; the curve is broad, so that they hardly matter"),
    ]


def build(progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 10."""
    progress("htsg-10: theory")
    one = scan(SANDPAPER.model, 0.0, WAVELENGTH_NM)
    # the source stands before the normal: there is no measured mirror direction
    taken = measure(
        SANDPAPER,
        name="sandpaper",
        wavelength_nm=WAVELENGTH_NM,
        scans={0.0: [float(a) for a in np.arange(-85.0, 85.1, 5.0)]},
        solid_angle_sr=CONE_SR,
        progress=lambda text: progress(f"htsg-10: {text}"),
    )
    curve = taken.curve(0.0)
    by = float(one.total[one.mirror])
    line = Line(label(0.0), np.radians(one.angle_deg), one.normalised, *divided(curve, by), 0.0)
    caption = (
        "Normalised: by the model's BRDF along the normal, theory and simulated measurement alike; lamp and "
        "camera block each other there. Solid: theory; dashed, with error bars: simulated measurement. The paper's "
        "drawing ends at a radius of 1."
    )
    judged = claims()
    words = "BRDF / model's BRDF along the normal"
    shown: list[Panel] = [
        polar_panel("polar", caption, [line], words, most=4.0),
        angle_panel("linear", "The same: over the angle of reflection.", [line], words),
    ]
    rows = []
    for a in (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 80.0, 85.0):
        theory = at(one.angle_deg, one.normalised, a)
        k = int(np.argmin(np.abs(np.degrees(curve.angle) - a)))
        there = abs(float(np.degrees(curve.angle[k])) - a) < 0.5
        found = float(curve.brdf[k]) / by if there else None
        rows.append({"theta_r_deg": a, "normalised": theory, "measured_normalised": found})
    return PaperFigure(
        "htsg-10",
        "HTSG Fig. 10: sandpaper at normal incidence",
        PAPER,
        _parameters(),
        judged,
        shown,
        Results(
            "Divided by the model's BRDF along the normal.",
            {
                "direction": lambda r: f"θr = {r['theta_r_deg']:g}°",
                "theory": lambda r: number(r["normalised"]),
                "simulated measurement": lambda r: number(r["measured_normalised"]),
            },
            rows,
        ),
        [
            agreement(taken),
            "The paper sets a = 0. Facets this steep reflect light more than once; in this model that light is lost: "
            f"ρ_dh = {one.rho_dh:.3f} at normal incidence.",
        ],
        [("simulated measurement", taken.words)],
        taken.files,
    )
