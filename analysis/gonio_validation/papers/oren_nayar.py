"""Oren and Nayar (1994), Figs. 5 and 6: radiance and BRDF of a rough diffuse surface, in and out of the plane."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from gonio_analysis.report.text import number

from gonio.models import OrenNayar
from gonio.typing import Floats
from gonio_validation.papers import oren_nayar_samples
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    PaperFigure,
    Results,
    Trace,
    agreed,
    angle_panel,
    at,
    signed,
    theory,
    trace_panel,
)
from gonio_validation.papers.oren_nayar_samples import (
    DRAWN_DEG,
    JUDGED_DEG,
    PAPER,
    SIDES,
    SOURCE_RIGHT,
    assumed,
    between,
    sides,
)

INCIDENCES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
AZIMUTHS = (0.0, 45.0, 90.0, 135.0, 180.0)
FLAT = 1.1
"""Largest over smallest value of a curve that counts as near-Lambertian."""
EDGE_DEG = 75.0


@dataclass(frozen=True)
class ScanChoice:
    """What the scan leaves open."""

    sigma_deg: float = 30.0
    albedo: float = 0.9
    theta_i_deg: float = 75.0

    @property
    def text(self) -> str:
        """As in "σ = 30°, ρ = 0.9, θi = 75°"."""
        return f"σ = {self.sigma_deg:g}°, ρ = {self.albedo:g}, θi = {self.theta_i_deg:g}°"


SHOWN = ScanChoice()
CHOICES = (
    SHOWN,
    replace(SHOWN, sigma_deg=20.0),
    replace(SHOWN, sigma_deg=40.0),
    replace(SHOWN, albedo=0.7),
    replace(SHOWN, theta_i_deg=60.0),
)
"""The drawn one first; a claim gets a verdict where all of them agree."""
ROUGHNESSES = (CHOICES[1], CHOICES[0], CHOICES[2])
"""Those that differ in sigma, in the order of sigma."""


def build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 5, 6, 8, 9, 10, 11 or 13."""
    progress(f"oren-nayar-{figure}: theory")
    if figure > 6:
        return oren_nayar_samples.build(figure, progress)
    return _radiance() if figure == 5 else _brdf()


def claims(figure: int) -> list[Claim]:
    """What the text says about a figure, judged with every choice of what the scan leaves open."""
    if figure > 6:
        return oren_nayar_samples.claims(figure)
    return _claims_5() if figure == 5 else _claims_6()


# --- Fig. 5 -------------------------------------------------------------------------------------------------------


@functools.cache
def radiance(choice: ScanChoice, interreflections: bool = True, step_deg: float = 1.0) -> tuple[Floats, Floats]:
    """Signed angles [deg] and radiance over E0, the irradiance head-on [1/sr], by the integral (eq. 13)."""

    angle = np.round(np.arange(-85.0, 85.1, step_deg), 6)
    theta_r, phi_r = signed(angle)
    model = OrenNayar(choice.albedo, choice.sigma_deg, "exact", interreflections=interreflections)
    theta_i = math.radians(choice.theta_i_deg)
    return angle, np.asarray(model.brdf(theta_i, 0.0, theta_r, phi_r)) * math.cos(theta_i)


def kink(choice: ScanChoice) -> float:
    """The angle [deg] at which the direct radiance bends most, on the retro side."""
    angle, direct = radiance(choice, False)
    curvature = np.abs(np.diff(direct, 2))
    inside = (angle[1:-1] < -30.0) & (angle[1:-1] > -84.0)
    return float(angle[1:-1][inside][int(np.argmax(curvature[inside]))])


def growth(choice: ScanChoice) -> float:
    """How fast the direct radiance grows beyond retro-reflection, over how fast it does before: over 5 degrees."""
    angle, direct = radiance(choice, False)
    retro = -choice.theta_i_deg
    inside, here, beyond = (at(angle, direct, retro + d) for d in (5.0, 0.0, -5.0))
    return (beyond - here) / (here - inside)


def tangent(choice: ScanChoice) -> float:
    """Rms deviation of the middle section from a + b tan(theta_r), over the section's range."""
    angle, total = radiance(choice)
    middle = (angle > -choice.theta_i_deg) & (angle <= 0.0)
    x = np.stack([np.ones(np.count_nonzero(middle)), np.tan(np.radians(angle[middle]))], axis=1)
    coefficients = np.linalg.lstsq(x, total[middle], rcond=None)[0]
    return float(np.sqrt(np.mean((x @ coefficients - total[middle]) ** 2)) / np.ptp(total[middle]))


def twice(choice: ScanChoice) -> tuple[Floats, Floats]:
    """Signed angles [deg] and the share of the radiance that comes from interreflection."""
    angle, total = radiance(choice)
    return angle, 1.0 - radiance(choice, False)[1] / total


def _claims_5() -> list[Claim]:
    spread, toward, shares, last = [], [], [], []
    for c in CHOICES:
        angle, total = radiance(c)
        spread.append(float(total.max() / total.min()))
        inside = (angle >= -c.theta_i_deg) & (angle <= 0.0)
        toward.append(bool(np.all(np.diff(total[inside]) < 0)))
        last.append(at(angle, twice(c)[1], c.theta_i_deg))
        shares.append(last[-1] / at(angle, twice(c)[1], -c.theta_i_deg))
    kinks, tails = {c: kink(c) for c in CHOICES}, [growth(c) for c in CHOICES]
    beyond = [float(radiance(c)[1].max()) / at(*radiance(c), -c.theta_i_deg) for c in CHOICES]
    tangents = [tangent(c) for c in CHOICES]
    mirror = ", ".join(f"{100 * s:.0f} % ({c.text})" for c, s in zip(CHOICES, last, strict=True))
    return [
        Claim(
            "“These radiance plots deviate substantially from Lambertian reflectance.”",
            agreed(s > 2.0 for s in spread),
            f"largest over smallest radiance within 85°: {between(spread)}",
            "more than 2, with every choice",
        ),
        Claim(
            "“Surface radiance increases as the viewing direction approaches the source direction.”",
            agreed(toward),
            "from the normal to the source's direction the radiance grows at every step of 1°",
            "monotonic, with every choice",
        ),
        Claim(
            "“In the backward (source) direction, the radiance is maximum and gets cut off … when θr exceeds θi. This "
            "cut-off occurs exactly at θr = θi and is independent of roughness.”",
            agreed(
                k == -c.theta_i_deg and t < 0.5 and m < 1.1
                for (c, k), t, m in zip(kinks.items(), tails, beyond, strict=True)
            ),
            f"direct light bends at {', '.join(f'{-k:g}° ({c.text})' for c, k in kinks.items())}; beyond, it grows "
            f"{between(tails)} times as fast as before, and the whole radiance to {between(beyond)} times that there",
            "sharpest bend at θr = θi (grid: 1°); beyond it growth falls below half, and less than 10 % is gained",
        ),
        Claim(
            "“In the middle section of the plot, radiance varies approximately as a scaled tan θr function with "
            "constant offset.”",
            agreed(t < 0.03 for t in tangents),
            f"rms deviation from a + b tan θr between source and normal: {between([100 * t for t in tangents])} % of "
            "the section's range",
            "less than 3 %, with every choice",
        ),
        Claim(
            "“Most facets are self-shadowed and the visible facets receive light primarily from adjacent facets” in "
            "the forward direction: the two curves part there.",
            agreed(s > 5.0 for s in shares),
            f"the share of interreflection in the mirror direction, {between([100 * s for s in last])} %, is "
            f"{between(shares)} times that at retro-reflection",
            "more than five times, with every choice",
        ),
        Claim(
            "“Interreflections dominate in the forward direction.”",
            agreed(s > 0.5 for s in last),
            f"in the mirror direction {mirror}",
            "more than half of the radiance in the mirror direction; hangs on σ and θi",
        ),
    ]  # fmt: skip


def _radiance() -> PaperFigure:
    angle, total = radiance(SHOWN)
    _, direct = radiance(SHOWN, False)
    flat = SHOWN.albedo / math.pi * math.cos(math.radians(SHOWN.theta_i_deg))
    lines = [
        theory("with interreflection", np.radians(angle), total),
        theory("direct light alone", np.radians(angle), direct),
        theory("Lambertian", np.radians(angle), np.full(angle.size, flat)),
    ]
    rows = []
    for a in (-85.0, -75.0, -60.0, -30.0, 0.0, 30.0, 60.0, 75.0, 85.0):
        whole, alone = at(angle, total, a), at(angle, direct, a)
        rows.append({"theta_r_deg": a, "radiance": whole, "direct": alone, "interreflection": 1.0 - alone / whole})
    return PaperFigure(
        "oren-nayar-5",
        "Oren-Nayar Fig. 5: radiance in the plane of incidence",
        PAPER,
        [
            *assumed(f"{SHOWN.sigma_deg:g}°", f"{SHOWN.albedo:g}", f"{SHOWN.theta_i_deg:g}°", "a “very rough surface”"),
            _judged(),
        ],
        _claims_5(),
        [
            angle_panel(
                "radiance",
                "Radiance: over the irradiance head-on, in the plane of incidence, by the integral (eq. 13).",
                lines,
                "L / E0 [1/sr]",
                retro_right=True,
            ),
            angle_panel(
                "share",
                "Interreflection: its share of the radiance.",
                [theory(f"σ = {c.sigma_deg:g}°", np.radians(angle), twice(c)[1]) for c in ROUGHNESSES],
                "share of interreflection",
                retro_right=True,
            ),
        ],
        Results(
            "",
            {
                "direction": lambda r: f"θr = {r['theta_r_deg']:g}°".replace("-", "−"),
                "radiance": lambda r: number(r["radiance"]),
                "direct light alone": lambda r: number(r["direct"]),
                "interreflection": lambda r: f"{100 * r['interreflection']:.0f} %",
            },
            rows,
        ),
        [SOURCE_RIGHT],
    )  # fmt: skip


def _judged() -> FigureParameter:
    return FigureParameter(
        "judged with", "; ".join(c.text for c in CHOICES), "assumed", "a verdict where all of them agree"
    )


# --- Fig. 6 -------------------------------------------------------------------------------------------------------


def plane(choice: ScanChoice, theta_i_deg: float, step_deg: float = JUDGED_DEG) -> tuple[Floats, Floats]:
    """Signed angles [deg] and BRDF [1/sr] in the plane of incidence."""

    angle = np.round(np.arange(-85.0, 85.1, step_deg), 6)
    theta_r, phi_r = signed(angle)
    model = OrenNayar(choice.albedo, choice.sigma_deg, "exact")
    return angle, np.asarray(model.brdf(math.radians(theta_i_deg), 0.0, theta_r, phi_r))


def beside(choice: ScanChoice, dphi_deg: float, step_deg: float = JUDGED_DEG) -> tuple[Floats, Floats]:
    """Polar angles [deg] and radiance over E0 [1/sr] at an azimuth from the source."""

    angle = np.round(np.arange(0.0, 85.1, step_deg), 6)
    model = OrenNayar(choice.albedo, choice.sigma_deg, "exact")
    theta_i = math.radians(choice.theta_i_deg)
    return angle, np.asarray(model.brdf(theta_i, 0.0, np.radians(angle), math.radians(dphi_deg))) * math.cos(theta_i)


def _spread(angle: Floats, value: Floats) -> float:
    inside = np.abs(angle) <= EDGE_DEG
    return float(value[inside].max() / value[inside].min())


def _claims_6() -> list[Claim]:
    rough = ROUGHNESSES
    normal = [_spread(*plane(c, 0.0)) for c in rough]
    back: list[Sequence[float]] = []
    for c in rough:
        curves = [plane(c, i) for i in INCIDENCES[1:]]
        back.append([at(a, v, -i) / at(a, v, i) for (a, v), i in zip(curves, INCIDENCES[1:], strict=True)])
    across = [_spread(*beside(c, 90.0)) for c in rough]
    along = [_spread(*beside(c, 0.0)) for c in rough]
    low = [replace(c, theta_i_deg=60.0) for c in rough]
    across_60 = [_spread(*beside(c, 90.0)) for c in low]
    names = [f"σ = {c.sigma_deg:g}°" for c in rough]
    return [
        Claim(
            "(a) “The model predicts near-Lambertian behavior for very small incidence angles.”",
            agreed(s < FLAT for s in normal),
            f"at θi = 0 largest over smallest BRDF within 75°: {between(normal)}",
            "less than 1.1, for σ = 20°, 30° and 40°",
        ),
        Claim(
            "(a) “As the incidence angle increases, the backscatter phenomenon begins to dominate.”",
            agreed(bool(np.all(np.diff(b) > 0)) and b[-1] > 2.0 for b in back),
            "; ".join(
                f"{n}: {', '.join(number(v) for v in b)} at θi = {', '.join(f'{i:g}°' for i in INCIDENCES[1:])}"
                for n, b in zip(names[1:2], back[1:2], strict=True)
            )
            + f"; at 75° {between([b[-1] for b in back])} for the three σ",
            "BRDF at θr = θi on the source's side over that on the mirror side grows with θi, to more than 2",
        ),
        Claim(
            "(b) “When the sensor-normal plane is perpendicular to the source-normal plane, the rough surface again "
            "exhibits near-Lambertian characteristics.”",
            agreed(s < FLAT for s in [*across, *across_60]),
            f"largest over smallest radiance within 75°, perpendicular: {between(across)} at θi = 75°, "
            f"{between(across_60)} at 60°; in the plane: {between(along)} at θi = 75°",
            "less than 1.1, with every σ and θi; hangs on them",
        ),
        Claim(
            "(b) The same, in comparison: the radiance varies less across than along the plane of incidence.",
            agreed(a - 1.0 < 0.25 * (b - 1.0) for a, b in zip(across, along, strict=True)),
            ", ".join(
                f"{n}: {number(a)} across, {number(b)} along" for n, a, b in zip(names, across, along, strict=True)
            ),
            "its relative variation within 75° is less than a quarter of that toward the source",
        ),
    ]


def _brdf() -> PaperFigure:
    curves = [(i, *plane(SHOWN, i, DRAWN_DEG)) for i in INCIDENCES]
    lines = [theory(f"θi = {i:g}°", np.radians(a), v) for i, a, v in curves]
    out = [Trace(f"Δφ = {d:g}°", *beside(SHOWN, d, DRAWN_DEG)) for d in AZIMUTHS]
    rows = [sides(i, a, v) | {"spread": _spread(a, v)} for i, a, v in curves]
    return PaperFigure(
        "oren-nayar-6",
        "Oren-Nayar Fig. 6: BRDF by incidence, and radiance out of plane",
        PAPER,
        [
            *assumed(
                f"{SHOWN.sigma_deg:g}°",
                f"{SHOWN.albedo:g}",
                f"(a) {', '.join(f'{i:g}°' for i in INCIDENCES)}; (b) {SHOWN.theta_i_deg:g}°",
                "as in Fig. 5",
            ),
            FigureParameter("judged with", "σ = 20°, 30° and 40°", "assumed", "a verdict where all of them agree"),
        ],
        _claims_6(),
        [
            angle_panel(
                "incidence",
                "(a) BRDF: in the plane of incidence, by the integral (eq. 13).",
                lines,
                "BRDF [1/sr]",
                retro_right=True,
            ),
            trace_panel(
                "azimuth",
                f"(b) Radiance: at θi = {SHOWN.theta_i_deg:g}°, in and out of the plane; Δφ = 0 is the source's side.",
                out,
                "θr [deg]",
                "L / E0 [1/sr]",
            ),
        ],
        Results(
            "BRDF at θr = θi on either side and along the normal [1/sr]; largest over smallest value within 75°.",
            {**SIDES, "largest / smallest": lambda r: number(r["spread"])},
            rows,
        ),
        [SOURCE_RIGHT],
    )
