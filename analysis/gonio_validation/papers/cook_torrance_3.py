"""Cook and Torrance (1982), Fig. 3: Beckmann's and the Gaussian facet distribution."""

import math

import numpy as np
from gonio_analysis.report.text import number

from gonio.models import CookTorrance
from gonio.typing import Floats
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    PaperFigure,
    Results,
    Row,
    Trace,
    polar_panel,
    theory,
    trace_panel,
)

PAPER = "Cook and Torrance, A Reflectance Model for Computer Graphics, ACM Transactions on Graphics 1 (1982) 7-24"
SLOPES = (0.2, 0.6)
FORMS = ("beckmann", "gaussian")
CURVES = [(m, form) for m in SLOPES for form in FORMS]
NAMES = {
    (m, form): f"({letter}) {form.capitalize()}, m = {m:g}" for letter, (m, form) in zip("abcd", CURVES, strict=True)
}
SHOWN_DEG = 30.0
SIMILAR = 0.1


def distribution(slope: float, form: str, alpha: Floats) -> Floats:
    """D(alpha), read off the model as a goniometer would: a scan of retro-reflection meets facets of every slope."""

    f0 = 0.04
    scanned = CookTorrance(1.0, 0.0, slope, distribution=form, f0=f0).specular(alpha, 0.0, alpha, 0.0)
    cosine2 = np.cos(alpha) ** 2  # R_s = F0/pi D G/cos^2, G = min(1, 2 cos^2)
    return np.asarray(scanned * math.pi * cosine2 / (f0 * np.minimum(1.0, 2.0 * cosine2)))


def _alpha() -> Floats:
    return np.asarray(np.radians(np.arange(0.0, 89.76, 0.25)))


def _half_angle(slope: float, form: str) -> float:
    """Where D falls to half of its value at 0 [deg]."""
    alpha = _alpha()
    d = distribution(slope, form, alpha)
    k = int(np.argmax(d < 0.5 * d[0]))
    return float(np.degrees(np.interp(0.5 * d[0], [d[k], d[k - 1]], [alpha[k], alpha[k - 1]])))


def _projected(slope: float) -> float:
    """Integral of Beckmann's D cos(alpha) over the hemisphere, over pi."""
    node, weight = np.polynomial.legendre.leggauss(200)
    alpha = (node + 1.0) * math.pi / 4
    d = distribution(slope, "beckmann", alpha)
    return float(2.0 * (weight * d * np.cos(alpha) * np.sin(alpha)).sum() * math.pi / 4)


def _reflected(slope: float) -> float:
    """What a surface of perfect mirrors reflects at normal incidence with R_s as printed."""

    return CookTorrance(1.0, 0.0, slope, f0=0.9999999).ambient_reflectance(0.0)


def _apart(slope: float) -> float:
    alpha = _alpha()
    first, second = (distribution(slope, form, alpha) for form in FORMS)
    return float(np.max(np.abs(first / first[0] - second / second[0])))


def claims() -> list[Claim]:
    """What the text says about the figure."""
    half = {(m, form): _half_angle(m, form) for m in SLOPES for form in FORMS}
    narrow, wide = SLOPES
    apart = {m: _apart(m) for m in SLOPES}
    projected = {m: _projected(m) for m in SLOPES}
    reflected = {m: _reflected(m) for m in SLOPES}

    def similar(m: float) -> Claim:
        return Claim(
            f"“Note the similarity between the two models”, m = {m:g}.",
            apart[m] < SIMILAR,
            f"D/D(0) differ by at most {number(apart[m], 2)}; half of it at {half[m, 'beckmann']:.1f}° (Beckmann) and "
            f"{half[m, 'gaussian']:.1f}° (Gaussian)",
            "nowhere more than a tenth of the peak apart",
        )

    return [
        Claim(
            "“Small values of m … give a distribution that is highly directional around the specular direction …; "
            "large values … give a distribution that is spread out.”",
            all(half[wide, form] > 2.0 * half[narrow, form] for form in FORMS),
            "half of the peak at "
            + "; ".join(
                f"{half[narrow, f]:.1f}° for m = 0.2 and {half[wide, f]:.1f}° for m = 0.6 ({f})" for f in FORMS
            ),
            "the half-angle more than doubles from m = 0.2 to 0.6, in both models",
        ),
        similar(narrow),
        similar(wide),
        Claim(
            "“The advantage of the Beckmann function is that it gives the absolute magnitude … without introducing "
            "arbitrary constants.”",
            all(abs(v - 1.0) < 1e-3 for v in projected.values()),
            f"∫ D cos α dω = {', '.join(f'{v:.4f} π (m = {m:g})' for m, v in projected.items())}: the facets' "
            "projected areas add up to the surface, up to the constant π",
            "the integral is π, whatever m is",
        ),
        Claim(
            "The absolute magnitude of R_s = (F/π) D G/((N·L)(N·V)), as printed with this D.",
            all(v <= 1.0 for v in reflected.values()),
            "perfect mirrors (F = 1) would reflect "
            + ", ".join(f"{number(v)} of the light (m = {m:g})" for m, v in reflected.items())
            + " at normal incidence: four times too much, for with ∫ D cos α dω = π the factor is 1/(4π)",
            "no more is reflected than falls in",
        ),
    ]


def _parameters() -> list[FigureParameter]:
    return [
        FigureParameter("m", "0.2 and 0.6", "paper", "the total rms slope: √2 times that along a line"),
        FigureParameter("c of the Gaussian", "1", "paper", "arbitrary; drawings are divided by D(0)"),
        FigureParameter(
            "θi", f"{SHOWN_DEG:g}°", "assumed", "the scan gives none; it only turns the drawing: no verdict uses it"
        ),
    ]


def build() -> PaperFigure:
    """The page of Fig. 3."""
    alpha = _alpha()
    theta_r = np.radians(np.arange(-90.0, 90.01, 0.5))
    off = np.abs(theta_r - math.radians(SHOWN_DEG)) / 2.0
    lines, traces, rows = [], [], list[Row]()
    for (m, form), name in NAMES.items():
        d = distribution(m, form, alpha)
        lines.append(theory(name, theta_r, distribution(m, form, off) / d[0], math.radians(SHOWN_DEG)))
        traces.append(Trace(name, np.degrees(alpha), d / d[0], dashed=form == "gaussian"))
        beckmann = form == "beckmann"
        rows.append(
            {
                "distribution": form,
                "m": m,
                "d_0": float(d[0]),
                "half_angle_deg": _half_angle(m, form),
                "projected_over_pi": _projected(m) if beckmann else None,
                "reflected_as_printed": _reflected(m) if beckmann else None,
            }
        )
    return PaperFigure(
        "cook-torrance-3",
        "Cook-Torrance Fig. 3: facet distributions",
        PAPER,
        _parameters(),
        claims(),
        [
            polar_panel(
                "polar",
                f"Around the mirror direction: D/D(0) of the facets that send light from θi = {SHOWN_DEG:g}° toward "
                "θr, α = |θr − θi|/2.",
                lines,
                "D / D(0)",
            ),
            trace_panel(
                "slopes",
                "Over the facets' angle: D/D(0). Solid: Beckmann; dashed: Gaussian.",
                traces,
                "α, angle between facet and surface [deg]",
                "D / D(0)",
            ),
        ],
        Results(
            "α½: where D is half of D(0). Reflected: with R_s as printed and F = 1, at normal incidence.",
            {
                "distribution": lambda r: NAMES[r["m"], r["distribution"]],
                "D(0)": lambda r: number(r["d_0"]),
                "α½": lambda r: f"{r['half_angle_deg']:.1f}°",
                "∫ D cos α dω / π": lambda r: number(r["projected_over_pi"], 5),
                "reflected": lambda r: number(r["reflected_as_printed"]),
            },
            rows,
        ),
        ["D is read off the model in retro-reflection, where H = L = V: a retro scan measures the distribution."],
    )
