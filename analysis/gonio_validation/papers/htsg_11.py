"""He, Torrance, Sillion and Greenberg (1991), Fig. 11: absolute BRDF of a smooth blue plastic."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.report.text import number

from gonio import geometry, materials
from gonio.models import fresnel
from gonio_validation.papers import htsg_scans
from gonio_validation.papers.figure import Claim, FigureParameter, PaperFigure, angle_panel
from gonio_validation.papers.htsg_scans import BRDF, InstrumentScan, agreement, each, scan
from gonio_validation.papers.htsg_surfaces import CONE_SR, PAPER, HtsgSurface, cones_parameter, energy_limit, measure
from gonio_validation.papers.htsg_surfaces import scan as directions

PLASTIC_A, PLASTIC_RHO = 0.15, 0.195
INCIDENCES = (15.0, 30.0, 45.0, 60.0)
WAVELENGTH_NM = 460.0


def plastic() -> HtsgSurface:
    """sigma0 = 0, a = 0.15, and the index that the measured rho_dh = 0.195 leaves for the surface."""

    n = float(fresnel.n_from_f0(PLASTIC_RHO - PLASTIC_A))
    return HtsgSurface(sigma0_um=0.0, tau_um=1.0, ior=n, diffuse_albedo=PLASTIC_A)


def claims() -> list[Claim]:
    """What the text says, judged by theory."""
    return _claims(plastic().model, _scans())


def _scans() -> list[InstrumentScan]:
    return [scan(plastic().model, i, WAVELENGTH_NM) for i in INCIDENCES]


def _claims(model: Any, scans: list[InstrumentScan]) -> list[Claim]:

    wave = WAVELENGTH_NM
    n = float(model.ior.real)
    reach = 2.0 * math.degrees(float(geometry.half_angle_of_cone(CONE_SR)))
    flat = PLASTIC_A / math.pi
    off = max(float(np.max(np.abs(s.total[np.abs(s.angle_deg - s.theta_i_deg) > reach] / flat - 1.0))) for s in scans)
    smooth = {}
    for s in scans:
        cosine = math.cos(math.radians(s.theta_i_deg))
        smooth[s.theta_i_deg] = float(s.spike.max()) * cosine * CONE_SR / float(fresnel.reflectance(cosine, n))
    heights = {s.theta_i_deg: float(s.spike.max() / scans[0].spike.max()) for s in scans}
    plastics = {name: float(complex(materials.ior(name)(wave)).real) for name in ("PMMA", "PC")}
    limit, _ = energy_limit(model, wave)
    as_printed = math.pi * PLASTIC_A + (PLASTIC_RHO - PLASTIC_A)
    return [
        Claim(
            "“The distributions for four incidence angles reveal a linear combination of specular and uniform diffuse "
            "behavior.”",
            off < 1e-6,
            f"beside the spikes every value is a/π = {flat:.4f} sr⁻¹ (to {number(max(off, 1e-16), 1)}); spikes "
            f"{each({i: number(h) for i, h in heights.items()})} times that at 15°",
            "outside the sum of the cones' half-angles nothing but a/π",
        ),
        Claim(
            "“For a smooth surface with σ0 = 0, the directional-diffuse term drops out and the specular term reduces "
            "to equation (10).”",
            all(abs(v - 1.0) < 1e-6 for v in smooth.values()),
            f"spike over |F|²/(cos θi dω_i): {each({i: f'{v:.6f}' for i, v in smooth.items()})}",
            "equal to 1e-6 at every incidence",
        ),
        Claim(
            "The measured ρ_dh = 0.195 at θi = 0 “yields the value a(λ) = 0.15”.",
            plastics["PMMA"] - 0.05 < n < plastics["PC"] + 0.05,
            f"the remaining 0.045 is |F|² of n = {n:.3f}; acrylic has {plastics['PMMA']:.3f}, polycarbonate "
            f"{plastics['PC']:.3f}. As a BRDF (eq. 72 as printed) a = 0.15 alone would reflect "
            f"{math.pi * PLASTIC_A:.2f}, {as_printed:.2f} in all: a is an albedo",
            "the index that is left for the surface is that of a plastic (within 0.05)",
        ),
        Claim(
            "“The shape of the specular spikes is determined by the geometry of the incident and receiving optical "
            "systems.”",
            max(s.spike_width_deg for s in scans) - min(s.spike_width_deg for s in scans) < 0.25,
            f"full width at half height {each({s.theta_i_deg: f'{s.spike_width_deg:.1f}' for s in scans}, '{}°')}",
            "the same width at every incidence (grid: 0.1°); the width itself hangs on the assumed cones",
        ),
        Claim(
            "a(λ) = 0.15 within “the constraint … based on energy conservation” (sec. 3.2.3)",
            limit is None,
            f"a + |F|² passes 1 at θi = {limit:.1f}°" if limit is not None else "a + |F|² stays below 1",
            "no more is reflected than falls in, at any incidence",
        ),
    ]


def build(progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 11."""
    progress("htsg-11: theory")
    surface = plastic()
    scans = _scans()
    taken = measure(
        surface,
        name="blue plastic",
        wavelength_nm=WAVELENGTH_NM,
        scans={i: directions(i, 10.0) for i in INCIDENCES},
        solid_angle_sr=CONE_SR,
        progress=lambda text: progress(f"htsg-11: {text}"),
    )
    caption = (
        "Absolute: BRDF, logarithmic as in the paper. Solid: theory; dashed, with error bars: simulated measurement."
    )
    zoomed = [_near(line, 6.0) for line in htsg_scans.absolute(scans, taken)]
    return PaperFigure(
        "htsg-11",
        "HTSG Fig. 11: smooth blue plastic at 0.46 µm",
        PAPER,
        [
            FigureParameter("σ0", "0", "paper", "a smooth surface; τ has no effect"),
            FigureParameter("a(λ)", f"{PLASTIC_A:g}", "paper", "an albedo: ρ_ud = a/π"),
            FigureParameter("n", f"{surface.ior:.4f} (k = 0)", "derived", "|F(0°)|² = ρ_dh − a = 0.195 − 0.15"),
            FigureParameter("θi", ", ".join(f"{i:g}°" for i in INCIDENCES), "paper"),
            FigureParameter("λ", "0.46 µm", "paper"),
            cones_parameter(
                "not given for this instrument; taken from Fig. 7. The height of the spikes goes as 1/dω_i, and no "
                "verdict uses it"
            ),
        ],
        _claims(surface.model, scans),
        [
            angle_panel("semilog", caption, htsg_scans.absolute(scans, taken), BRDF, logarithmic=True),
            angle_panel("spikes", "Spikes: the same within 6° of the mirror directions, linear.", zoomed, BRDF),
        ],
        htsg_scans.results(scans, taken),
        [agreement(taken)],
        [("simulated measurement", taken.words)],
        taken.files,
    )


def _near(line: Line, within_deg: float) -> Line:
    """A curve around its mirror direction alone."""
    assert line.mirror is not None
    inside = np.abs(np.degrees(line.theory_angle - line.mirror)) <= within_deg
    shown = np.abs(np.degrees(line.angle - line.mirror)) <= within_deg
    shown_part = (line.angle[shown], line.measured[shown], line.u[shown])
    return Line(line.label, line.theory_angle[inside], line.theory[inside], *shown_part, line.mirror)
