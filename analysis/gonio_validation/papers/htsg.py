"""He, Torrance, Sillion and Greenberg (1991), Figs. 7 to 9: normalised polar curves of aluminium and a ceramic."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gonio_analysis.report.text import number

from gonio import geometry
from gonio_validation.papers import htsg_6, htsg_10, htsg_11, htsg_scans
from gonio_validation.papers.figure import Claim, FigureParameter, PaperFigure
from gonio_validation.papers.htsg_scans import InstrumentScan, agreement, each, scan
from gonio_validation.papers.htsg_surfaces import (
    CONE_SR,
    CONES,
    PAPER,
    HtsgSurface,
    Simulated,
    cones_parameter,
    energy_limit,
    index_parameter,
    measure,
)
from gonio_validation.papers.htsg_surfaces import scan as directions

ALUMINIUM = HtsgSurface(sigma0_um=0.28, tau_um=1.77, ior="Al")
CERAMIC = HtsgSurface(sigma0_um=1.45, tau_um=13.2, ior="MgO", diffuse_albedo=0.9)
SURFACES = {7: ALUMINIUM, 8: ALUMINIUM, 9: CERAMIC}
INCIDENCES = {7: (10.0, 45.0, 75.0), 8: (10.0, 30.0, 45.0, 60.0, 75.0), 9: (10.0, 45.0, 60.0, 75.0)}
WAVELENGTH_NM = {7: 2000.0, 8: 500.0, 9: 500.0}
_APART: dict[int, Any] = {6: htsg_6, 10: htsg_10, 11: htsg_11}
"""Figures with a module of their own."""
TITLES = {
    7: "HTSG Fig. 7: roughened aluminium at 2.0 µm",
    8: "HTSG Fig. 8: roughened aluminium at 0.5 µm",
    9: "HTSG Fig. 9: roughened magnesium oxide ceramic at 0.5 µm",
}


def build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 6, 7, 8, 9, 10 or 11."""
    return _APART[figure].build(progress) if figure in _APART else _build(figure, progress)


def claims(figure: int) -> list[Claim]:
    """What the text says about a figure, judged by theory."""
    if figure in _APART:
        found: list[Claim] = _APART[figure].claims()
        return found
    return {7: _claims_7, 8: _claims_8, 9: _claims_9}[figure](scans(figure))


def scans(figure: int) -> list[InstrumentScan]:
    """Every incidence of a figure."""
    model = SURFACES[figure].model
    return [scan(model, i, WAVELENGTH_NM[figure]) for i in INCIDENCES[figure]]


def _build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    progress(f"htsg-{figure}: theory")
    found = scans(figure)
    judged = {7: _claims_7, 8: _claims_8, 9: _claims_9}[figure](found)
    taken = measure(
        SURFACES[figure],
        name="magnesium oxide ceramic" if figure == 9 else "rough aluminium",
        wavelength_nm=WAVELENGTH_NM[figure],
        scans={i: directions(i) for i in INCIDENCES[figure]},
        solid_angle_sr=CONE_SR,
        progress=lambda text: progress(f"htsg-{figure}: {text}"),
    )
    metal = [
        FigureParameter("σ0", "0.28 µm", "paper", "measured roughness"),
        FigureParameter("τ", "1.77 µm", "paper", "best fit of the authors, at both wavelengths"),
        FigureParameter("a(λ)", "0", "paper", "best fit of the authors"),
    ]
    ceramic = [
        FigureParameter("σ0", "1.45 µm", "paper", "best fit of the authors; measured: 1.90 µm"),
        FigureParameter("τ", "13.2 µm", "paper", "best fit of the authors"),
        FigureParameter(
            "a(λ)", "0.9", "paper", "best fit; an albedo, ρ_ud = a/π (eq. 72 as printed would reflect 283 %)"
        ),
    ]
    return PaperFigure(
        f"htsg-{figure}",
        TITLES[figure],
        PAPER,
        [
            *(ceramic if figure == 9 else metal),
            index_parameter("MgO" if figure == 9 else "Al", WAVELENGTH_NM[figure]),
            FigureParameter("θi", ", ".join(f"{i:g}°" for i in INCIDENCES[figure]), "paper"),
            FigureParameter("λ", f"{WAVELENGTH_NM[figure] / 1000:g} µm", "paper"),
            cones_parameter(),
            FigureParameter(
                "shadowing", "Smith, with the factor exp(−h²)", "derived", "eq. 25 as printed lacks the factor"
            ),
        ],
        judged,
        htsg_scans.panels(found, taken, most=4.0 if figure == 9 else 2.5),
        htsg_scans.results(found, taken),
        _notes(figure, found, taken),
        [("simulated measurement", taken.words)],
        taken.files,
    )


def _notes(figure: int, scans: Sequence[InstrumentScan], taken: Simulated) -> list[str]:
    last = scans[-1]
    out = [agreement(taken)]
    if figure == 9:
        out.append(
            f"At {last.theta_i_deg:g}° the spike has {number(float(last.spike.max()), 1)} sr⁻¹ beside a lobe of "
            f"{number(float(last.lobe[last.mirror]))} sr⁻¹: what rises there is the directional diffuse."
        )
    else:
        exact = exact_spike(SURFACES[figure].model, last.theta_i_deg, WAVELENGTH_NM[figure])
        more = exact / float(last.spike.max()) - 1.0
        out.append(
            "Theory averages the spike as eq. 6 has it, with ρ_s of the cone's axis. What an instrument sees carries "
            f"ρ_s and cos θ through the cone: {100 * more:.1f} % more at {last.theta_i_deg:g}°. The simulated "
            "measurement has that, and so has its chi-square."
        )
    if figure == 7:
        out.append(
            "The rig's camera is one for visible light; it is given a band at 2.0 µm, because surface, cones and "
            "reduction are what the figure is about."
        )
    return [*out, "Near retro-reflection lamp and camera block each other: nothing is measured there."]


def exact_spike(model: Any, theta_i_deg: float, wavelength_nm: float) -> float:
    """The spike in the mirror direction with rho_s carried through the cones [1/sr]."""
    from gonio.instrument import apparent_spike

    theta = math.radians(theta_i_deg)
    return float(apparent_spike(model, theta, 0.0, theta, math.pi, wavelength_nm=wavelength_nm, spike="exact", **CONES))


def _claims_7(scans: Sequence[InstrumentScan]) -> list[Claim]:
    ratios = {s.theta_i_deg: s.spike_over_lobe for s in scans}
    first = scans[0]
    visible = {s.theta_i_deg: 1.0 / (1.0 + s.spike_over_lobe) for s in scans}
    share = 1.0 - first.rho_s / first.rho_dh
    reach = 2.0 * math.degrees(float(geometry.half_angle_of_cone(CONE_SR)))
    widths = {s.theta_i_deg: s.spike_width_deg for s in scans}
    outside = max(float(s.spike[np.abs(s.angle_deg - s.theta_i_deg) > reach].max()) for s in scans)
    short = {i: scan(SURFACES[8].model, i, WAVELENGTH_NM[8]).spike_over_lobe for i in INCIDENCES[7]}
    return [
        Claim(
            "“When σ0 is small compared to λ, as in Figure 7, strong specular reflection occurs.”",
            all(r > 10.0 for r in ratios.values()),
            f"spike over lobe: {each({i: number(r) for i, r in ratios.items()})}",
            "at every incidence the spike is more than ten times the lobe below it",
        ),
        Claim(
            "“For incidence at θi = 10°, the reflected pattern displays both specular and directional diffuse "
            "components.”",
            0.02 < visible[10.0] < 0.5,
            f"the lobe has {100 * visible[10.0]:.1f} % of the whole in the mirror direction "
            f"({each({i: f'{100 * v:.2g}' for i, v in visible.items() if i > 10}, '{} %')}), and "
            f"{100 * share:.0f} % of the reflected flux",
            "in the drawing the lobe is between 2 % and half of the spike's length",
        ),
        Claim(
            "“The angular width of the measured specular peak is determined by the solid angles of incident and "
            "received light.”",
            outside == 0.0 and max(widths.values()) - min(widths.values()) < 0.25,
            f"full width at half height {each({i: f'{w:.1f}' for i, w in widths.items()}, '{}°')}; nothing beyond "
            f"{reach:.2f}° from the mirror direction",
            "the same width at every incidence (grid: 0.1°), and no spike beyond the sum of the cones' half-angles",
        ),
        Claim(
            "“Both materials display an emerging specular peak as the angle of incidence is increased …”",
            all(np.diff(list(ratios.values())) > 0),
            f"spike over lobe: {each({i: number(r) for i, r in ratios.items()})}",
            "spike over lobe grows from incidence to incidence",
        ),
        Claim(
            "“… and, for the metal, as the wavelength is increased.”",
            all(ratios[i] > short[i] for i in ratios),
            "spike over lobe from 0.5 to 2.0 µm: "
            + ", ".join(f"{number(short[i])} to {number(ratios[i])} at {i:g}°" for i in ratios),
            "larger than in Fig. 8 at each of these incidences",
        ),
    ]


def _claims_8(scans: Sequence[InstrumentScan]) -> list[Claim]:
    lobes, last = scans[:-1], scans[-1]
    spikes = {s.theta_i_deg: s.rho_s / s.rho_dh for s in lobes}
    return [
        Claim(
            "“For θi = 10°, 30°, 45°, and 60°, the reflected intensity is maximal at larger-than-specular angles.”",
            all(s.peak_deg is not None and min(s.peak_deg, s.seen_peak_deg) > s.theta_i_deg + 0.5 for s in lobes),
            f"peaks at {each({s.theta_i_deg: f'{s.peak_deg:.1f}' for s in lobes}, '{}°')}; through the cones at "
            f"{', '.join(f'{s.seen_peak_deg:.1f}°' for s in lobes)}",
            "the largest value lies beyond the mirror direction, with and without the cones",
        ),
        Claim(
            "“For θi = 75°, a specular peak emerges as the surface appears somewhat smoother to the incident "
            "radiation.”",
            last.spike_over_lobe > 1.0 and abs(last.seen_peak_deg - last.theta_i_deg) < 0.3,
            f"spike over lobe {number(last.spike_over_lobe)}, largest value at {last.seen_peak_deg:.1f}°; at 60° the "
            f"spike is {number(lobes[-1].spike_over_lobe)} of the lobe",
            "the spike is larger than the lobe, and the largest value is in the mirror direction",
        ),
        Claim(
            "“When the roughness is more comparable to the wavelength, a strong directional diffuse pattern appears.”",
            all(share < 0.01 for share in spikes.values()),
            f"the lobe has all of what is reflected, but for a share of at most {number(max(spikes.values()), 2)} in "
            "the spike",
            "at 10° to 60° more than 99 % of the reflected flux is in the lobe",
        ),
    ]


def _claims_9(scans: Sequence[InstrumentScan]) -> list[Claim]:
    a = CERAMIC.diffuse_albedo
    flat = a / math.pi
    first = scans[0]
    over = {s.theta_i_deg: float(s.total.max() / flat) for s in scans}
    shares = {s.theta_i_deg: a / s.rho_dh for s in scans}
    spikes = {s.theta_i_deg: s.spike_over_lobe for s in scans}
    limit, allowed = energy_limit(SURFACES[9].model, WAVELENGTH_NM[9])
    return [
        Claim(
            "“This surface shows nearly uniform diffuse behavior at θi = 10° …”",
            float(first.total.max() / first.total.min()) < 1.5 and shares[10.0] > 0.9,
            f"largest over smallest value {number(float(first.total.max() / first.total.min()))}; "
            f"{100 * shares[10.0]:.0f} % of what is reflected is uniform diffuse",
            "less than 1.5, and more than 90 %",
        ),
        Claim(
            "“… and an emerging … peak for larger values of θi.”",
            all(np.diff(list(over.values())) > 0) and over[75.0] > 10.0,
            f"largest value over a/π: {each({i: number(v) for i, v in over.items()})}",
            "grows from incidence to incidence, to more than ten times the uniform diffuse",
        ),
        Claim(
            "The emerging peak is “specular”.",
            all(r > 1.0 for i, r in spikes.items() if i >= 45),
            f"spike over the rest: {each({i: number(r) for i, r in spikes.items()})}; the peaks lie off the mirror "
            f"direction, at {each({s.theta_i_deg: f'{s.peak_deg:.1f}' for s in scans}, '{}°')}: an off-specular "
            "directional diffuse lobe",
            "in the mirror direction the specular term is larger than the rest",
        ),
        Claim(
            "“The nonmetal [shows] a strong uniform diffuse pattern.”",
            all(v > 0.5 for v in shares.values()),
            f"share of the uniform diffuse in what is reflected: "
            f"{each({i: f'{100 * v:.0f}' for i, v in shares.items()}, '{} %')}",
            "more than half at every incidence",
        ),
        Claim(
            "a(λ) = 0.9 within “the constraint … based on energy conservation” (sec. 3.2.3)",
            limit is None,
            f"ρ_dh passes 1 at θi = {limit:.1f}° ({each({s.theta_i_deg: f'{s.rho_dh:.3f}' for s in scans})}); up to "
            f"90° at most a = {allowed:.3f} keeps energy"
            if limit is not None
            else "ρ_dh stays below 1",
            "no more is reflected than falls in, at any incidence",
        ),
    ]
