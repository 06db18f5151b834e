"""Blinn (1977), Figs. 5 and 6: Phong's and Torrance and Sparrow's highlights at 30 and 70 degrees."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from gonio_analysis.report.text import number

from gonio.models import Blinn, Phong
from gonio.models.blinn import PRESETS
from gonio.typing import Floats
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    PaperFigure,
    Results,
    Row,
    agreed,
    polar_panel,
    signed,
    theory,
)

PAPER = "Blinn, Models of Light Reflection for Computer Synthesized Pictures, SIGGRAPH 1977"
INCIDENCE_DEG = {5: 30.0, 6: 70.0}
ALMOST, ALMOST_DEG = 0.1, 5.0
"""Peaks of two intensities that look the same: relative height, and direction."""


@dataclass(frozen=True)
class BlinnParameters:
    """A set of parameters; Phong's exponent is the one that falls to one half at the same angle."""

    name: str
    p_d: float
    p_s: float
    ior: float
    beta_deg: float


def surfaces() -> tuple[BlinnParameters, ...]:
    """What the figures may have been made with: the first one is drawn, all of them are judged."""

    def preset(name: str) -> BlinnParameters:
        p = PRESETS[name]
        c2 = p["c"] ** 2
        # D3 = 1/2 where cos^2 = (1 - sqrt(2) c3^2)/(1 - c3^2)
        beta = math.degrees(math.acos(math.sqrt((1.0 - math.sqrt(2.0) * c2) / (1.0 - c2))))
        return BlinnParameters(f"{name} of Fig. 7", p["k_d"], p["k_s"], p["ior"], beta)

    metal = PRESETS["aluminium"]
    fifty = math.degrees(math.acos(0.5 ** (1.0 / 50.0)))
    drawn = BlinnParameters("metal with c1 = 50", metal["k_d"], metal["k_s"], metal["ior"], fifty)
    return drawn, preset("aluminium"), preset("magnesium oxide")


def exponent(surface: BlinnParameters) -> float:
    """c1 = -ln 2/ln cos(beta)."""
    return -math.log(2.0) / math.log(math.cos(math.radians(surface.beta_deg)))


def highlights(surface: BlinnParameters, theta_i_deg: float, angle_deg: Floats) -> tuple[Floats, Floats]:
    """s of Phong and of Torrance and Sparrow in the plane of incidence."""

    theta_r, phi_r = signed(angle_deg)
    where = (math.radians(theta_i_deg), 0.0, theta_r, phi_r)
    phong = Phong(exponent=exponent(surface)).highlight(*where)
    facets = Blinn(ior=surface.ior, beta_deg=surface.beta_deg).highlight(*where)
    return np.asarray(phong), np.asarray(facets)


def _parameters(theta_i: float) -> list[FigureParameter]:
    first = surfaces()[0]
    return [
        FigureParameter("θi", f"{theta_i:g}°", "paper"),
        FigureParameter("p_d, p_s, n", f"{first.p_d:g}, {first.p_s:g}, {first.ior:g}", "assumed",
                  "the figure has none; those of the aluminium of Fig. 7"),
        FigureParameter("c1", "50", "assumed", "“typically 50 or 60”"),
        FigureParameter("β", f"{first.beta_deg:.2f}°", "derived",
                  "where cos^c1 falls to one half; D3 with the same β, as the paper compares distributions"),
        FigureParameter("judged with",
                  "; ".join(f"{s.name} (n = {s.ior:g}, β = {s.beta_deg:.1f}°)" for s in surfaces()),
                  "assumed", "a claim gets a verdict where all three agree"),
    ]  # fmt: skip


def build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 5 or 6."""
    progress(f"blinn-{figure}: theory")
    theta_i = INCIDENCE_DEG[figure]
    angle = _angles()
    panels, rows = [], list[Row]()
    for k, s in enumerate(surfaces()):
        phong, facets = highlights(s, theta_i, angle)
        diffuse = s.p_d * math.cos(math.radians(theta_i))
        lines = [
            theory(name, np.radians(angle), diffuse + s.p_s * v, math.radians(theta_i))
            for name, v in (("Phong", phong), ("Torrance-Sparrow", facets))
        ]
        if k != 1:  # the aluminium of Fig. 7 is a wider copy of the first
            caption = f"{s.name[:1].upper()}{s.name[1:]}: intensity i = p_d (N·L) + p_s s in the plane of incidence."
            panels.append(polar_panel(f"surface-{k + 1}", caption, lines, "intensity", most=math.inf, retro_right=True))
        rows.append(
            {
                "surface": s.name,
                "phong_peak_deg": _peak(angle, phong),
                "torrance_sparrow_peak_deg": _peak(angle, facets),
                "phong_peak": float(phong.max()),
                "torrance_sparrow_peak": float(facets.max()),
                "intensity_peak_ratio": _peaks(s, theta_i)[0],
            }
        )
    return PaperFigure(
        f"blinn-{figure}",
        f"Blinn Fig. {figure}: Phong and Torrance-Sparrow at {theta_i:g}°",
        PAPER,
        _parameters(theta_i),
        claims(figure),
        panels,
        Results(
            "Peaks of s. Intensities: Torrance-Sparrow's largest over Phong's.",
            {
                "surface": lambda r: r["surface"],
                "Phong's peak at": lambda r: f"{r['phong_peak_deg']:.1f}°",
                "Torrance-Sparrow's": lambda r: _degrees(r["torrance_sparrow_peak_deg"]),
                "Phong's s": lambda r: number(r["phong_peak"]),
                "Torrance-Sparrow's s": lambda r: number(r["torrance_sparrow_peak"]),
                "intensities": lambda r: number(r["intensity_peak_ratio"]),
            },
            rows,
        ),
        [
            "Light comes from the right and the mirror direction lies on the left, as in the paper, which draws it in "
            "three dimensions.",
            "s is no BRDF: the peak of Torrance and Sparrow's s grows with 1/(N·E) toward the horizon.",
        ],
    )  # fmt: skip


def claims(figure: int) -> list[Claim]:
    """What the text says about a figure, judged with every surface."""
    return _claims_5() if figure == 5 else _claims_6()


def _angles() -> Floats:
    return np.arange(-89.0, 89.01, 0.1)


def _peak(angle: Floats, value: Floats) -> float:
    return float(np.round(angle[int(np.argmax(value))], 6))


def _degrees(value: float) -> str:
    return "the horizon" if value >= 88.9 else f"{value:.1f}°"


def _peaks(s: BlinnParameters, theta_i: float) -> tuple[float, float]:
    """Of the intensities: the peak of Torrance and Sparrow's over that of Phong's, and how far apart they are [deg]."""
    phong, facets = highlights(s, theta_i, _angles())
    diffuse = s.p_d * math.cos(math.radians(theta_i))
    height = (diffuse + s.p_s * facets.max()) / (diffuse + s.p_s * phong.max())
    return float(height), _peak(_angles(), facets) - _peak(_angles(), phong)


def _alike(s: BlinnParameters, theta_i: float) -> bool:
    height, apart = _peaks(s, theta_i)
    return abs(height - 1.0) < ALMOST and abs(apart) < ALMOST_DEG


def _in_words(theta_i: float) -> dict[str, str]:
    return {s.name: "{:.2f} times as high, {:.1f}° off".format(*_peaks(s, theta_i)) for s in surfaces()}


def _claims_5() -> list[Claim]:
    return [
        Claim(
            "“For this angle of incidence the functions are almost identical.”",
            agreed(_alike(s, 30.0) for s in surfaces()),
            f"Torrance-Sparrow's peak is {_list(_in_words(30.0))}",
            "peaks of the intensities within a tenth of their height and 5°; hangs on n and c3, which the scan lacks",
        )
    ]


def _claims_6() -> list[Claim]:
    angle = _angles()
    ratio, shift, growth = {}, {}, {}
    for s in surfaces():
        phong, facets = highlights(s, 70.0, angle)
        early_phong, early_facets = highlights(s, 30.0, angle)
        ratio[s.name] = float(facets.max() / phong.max())
        shift[s.name] = _peak(angle, facets)
        growth[s.name] = float(facets.max() / early_facets.max()), float(phong.max() / early_phong.max())
    return [
        Claim(
            "“The specular bump is much larger for the Torrance Sparrow function …”",
            agreed(v > 2.0 for v in ratio.values()),
            f"its largest s over Phong's: {_list({k: number(v) for k, v in ratio.items()})}",
            "more than twice Phong's, with every surface",
        ),
        Claim(
            "“… and not in quite the same direction.”",
            agreed(v > 75.0 for v in shift.values()),
            f"Phong's peak at 70°; Torrance-Sparrow's {_list({k: _degrees(v) for k, v in shift.items()})}",
            "more than 5° beyond the mirror direction, with every surface",
        ),
        Claim(
            "“The specular bump … varies with the direction of the light source”; it “will be much higher” at “shallow "
            "angles of incident light”.",
            agreed(a > 2.0 and abs(b - 1.0) < 1e-3 for a, b in growth.values()),
            f"largest s at 70° over that at 30°: {_list({k: number(a) for k, (a, _) in growth.items()})}; Phong's: 1",
            "more than doubles from 30° to 70°, while Phong's stays",
        ),
        Claim(
            "“The new function will be materially different only for shallow angles of incident light.”",
            agreed(_alike(s, 30.0) and not _alike(s, 70.0) for s in surfaces()),
            f"Torrance-Sparrow's peak at 30°: {_list(_in_words(30.0))}; at 70°: {_list(_in_words(70.0))}",
            "peaks within a tenth of their height and 5° at 30°, and not so at 70°; hangs on n and c3, as in Fig. 5",
        ),
    ]


def _list(values: dict[str, str]) -> str:
    return ", ".join(f"{v} ({k})" for k, v in values.items())
