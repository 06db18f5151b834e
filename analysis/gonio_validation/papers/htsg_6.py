"""He, Torrance, Sillion and Greenberg (1991), Fig. 6: the three parts of the reflected light, a sketch in the paper."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from gonio_analysis.report.text import number

from gonio import geometry
from gonio.instrument.parts import DIRECTIONAL, SPECULAR, Part, parts
from gonio.models import HeTorrance
from gonio.typing import Floats
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    PaperFigure,
    Results,
    agreed,
    angle_panel,
    signed,
    theory,
)
from gonio_validation.papers.htsg_scans import BRDF
from gonio_validation.papers.htsg_surfaces import CONE_SR, CONES, PAPER, cones_parameter

SHOWN = HeTorrance(sigma0_um=0.1, tau_um=1.5, ior=1.7, diffuse_albedo=0.3)
CHOICES = tuple(replace(SHOWN, sigma0_um=sigma0, tau_um=tau) for sigma0 in (0.05, 0.1, 0.2) for tau in (1.5, 3.0))
THETA_I_DEG, WAVELENGTH_NM = 45.0, 500.0
FAR = 2.0
"""A lobe is far from even where its largest value is this many times that in the direction of the normal."""


def build(progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 6."""
    progress("htsg-6: theory")
    angle = _angles()
    found = _parts(SHOWN, angle)
    whole = sum(part.seen for part in found.values())
    lines = [theory(name, np.radians(angle), part.seen) for name, part in found.items()]
    lines.append(theory("all", np.radians(angle), np.asarray(whole)))
    caption = "The parts: each through the cones, over the angle of reflection."
    return PaperFigure(
        "htsg-6",
        "HTSG Fig. 6: specular, directional diffuse and uniform diffuse",
        PAPER,
        [
            FigureParameter("σ0", f"{SHOWN.sigma0_um:g} µm", "assumed", "the paper's figure is a sketch"),
            FigureParameter("τ", f"{SHOWN.tau_um:g} µm", "assumed", "so that all three parts are seen"),
            FigureParameter("n", "1.7 (k = 0)", "assumed", "as a ceramic's"),
            FigureParameter("a(λ)", f"{SHOWN.diffuse_albedo:g}", "assumed", "an albedo"),
            FigureParameter("θi", f"{THETA_I_DEG:g}°", "assumed"),
            FigureParameter("λ", f"{WAVELENGTH_NM / 1000:g} µm", "assumed"),
            cones_parameter("those of Fig. 7"),
        ],
        claims(),
        [angle_panel("parts", caption, lines, BRDF)],
        Results(
            "Share of the incident light in each part (ρ_dh in all), and its largest value through the cones.",
            {
                "part": lambda r: str(r["part"]),
                "ρ_dh": lambda r: f"{r['reflected']:.4f}",
                "largest [1/sr]": lambda r: number(r["largest"]),
            },
            [
                {"part": name, "reflected": part.reflected, "largest": float(part.seen.max())}
                for name, part in found.items()
            ],
        ),
    )


def claims() -> list[Claim]:
    """What the text says of the parts, judged for several surfaces, as the paper names none."""
    angle = _angles()
    every = [_parts(model, angle) for model in CHOICES]
    reach = 2.0 * math.degrees(float(geometry.half_angle_of_cone(CONE_SR)))
    outside = np.abs(angle - THETA_I_DEG) > reach
    beyond = [float(found[SPECULAR].seen[outside].max()) for found in every]
    normal = int(np.argmin(np.abs(angle)))
    far = [float(found[DIRECTIONAL].seen.max() / found[DIRECTIONAL].seen[normal]) for found in every]
    theta_r, phi_r = signed(angle)
    where = (math.radians(THETA_I_DEG), 0.0, theta_r, phi_r)
    uneven = 0.0
    for model in CHOICES:
        whole, bare = (m.brdf(*where, wavelength_nm=WAVELENGTH_NM) for m in (model, replace(model, diffuse_albedo=0.0)))
        uneven = max(uneven, float(np.max(np.abs(whole - bare - model.diffuse_albedo / math.pi) / whole)))
    several = f"{len(CHOICES)} surfaces, σ0 0.05 to 0.2 µm, τ 1.5 and 3 µm"
    return [
        Claim(
            "“The specularly-reflected part is contained within the specular cone of reflection.”",
            agreed(b == 0.0 for b in beyond),
            f"beyond {reach:.2f}° from the mirror direction at most {number(max(beyond))} sr⁻¹",
            f"nothing outside the sum of the cones' half-angles; {several}",
        ),
        Claim(
            "“The diffraction-scattered part shows a directional distribution which is far from ideal diffuse.”",
            agreed(f > FAR for f in far),
            f"its largest value is {number(min(far))} to {number(max(far))} times that toward the normal",
            f"above {FAR:g} times; {several}",
        ),
        Claim(
            "“The last part is uniform diffuse (Lambertian).”",
            uneven < 1e-14,
            "in one direction the BRDF less that of the same surface without this part is a/π, but for "
            f"{number(max(uneven, 1e-16), 1)} of the whole",
            f"the same in every direction, to the rounding of a difference (1e-14); {several}",
        ),
    ]


def _angles() -> Floats:
    near = THETA_I_DEG + np.arange(-4.0, 4.01, 0.1)
    return np.unique(np.round(np.concatenate([np.arange(-88.0, 88.01, 1.0), near]), 6))


def _parts(model: HeTorrance, angle_deg: Floats) -> dict[str, Part]:
    theta_r, phi_r = signed(angle_deg)
    return parts(model, math.radians(THETA_I_DEG), 0.0, theta_r, phi_r, wavelength_nm=WAVELENGTH_NM, **CONES)
