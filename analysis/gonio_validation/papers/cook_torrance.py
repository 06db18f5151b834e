"""Cook and Torrance (1982), Figs. 3 to 5: the spectrum of copper, its colour (Fig. 3: a file of its own)."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from gonio_analysis.report.text import number

from gonio import colour, materials
from gonio.models import fresnel
from gonio.typing import Floats
from gonio_validation.papers import cook_torrance_3
from gonio_validation.papers.cook_torrance_3 import PAPER, SIMILAR
from gonio_validation.papers.figure import (
    WIDTH_IN,
    Claim,
    CurveRow,
    FigureParameter,
    Panel,
    PaperFigure,
    Results,
    Trace,
    agreed,
    at,
    plain_axes,
    trace_panel,
)

D65_SOURCE = "CIE 15, relative power at 380 to 780 nm in steps of 5 nm"
NM = np.arange(380.0, 781.0, 5.0)
ANGLES_DEG = (0.0, 30.0, 60.0, 75.0, 85.0, 89.0)
EARLY_DEG = 70.0
SUFFICIENT = 0.01


def build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 3, 4 or 5."""
    progress(f"cook-torrance-{figure}: theory")
    return {3: cook_torrance_3.build, 4: _spectrum, 5: _colours}[figure]()


def claims(figure: int) -> list[Claim]:
    """What the text says about a figure."""
    return {3: cook_torrance_3.claims, 4: _claims_4, 5: _claims_5}[figure]()


def copper() -> FigureParameter:
    """The optical constants of all three figures."""

    source = (
        f"{materials.ior('Cu').source}; the paper took a measured reflectance (refs. 10, 17) that it does not print"
    )
    return FigureParameter("copper, n + ik", "380 to 780 nm", "database", source)


# --- Fig. 4: copper's spectrum ------------------------------------------------------------------------------------


def spectrum(theta: Floats, *, absorbing: bool = True) -> Floats:
    """Reflectance of a copper mirror at `NM`, (angles, wavelengths).

    With n + ik; or (`absorbing` False) with the real index that has the same normal reflectance, as the paper does for
    metals whose n and k are not known.
    """
    if absorbing:
        return colour.reflectance(theta, NM, "Cu")
    return colour.reflectance(theta, NM, colour.index_from_f0(colour.reflectance(0.0, NM, "Cu")))


def light() -> Floats:
    """Relative spectral power of D65 at `NM`."""
    return np.asarray(np.interp(NM, colour.wavelengths(), colour.illuminant("D65")))


def rgb(xyz: Floats) -> Floats:
    """Linear RGB of XYZ under D65, 1 in every channel for a perfect white."""
    return colour.SRGB.rgb(xyz) / colour.SRGB.rgb(colour.white())


def shares(linear: Floats) -> Floats:
    """Shares of the channels, (..., 3): what is left of a colour without its brightness."""
    return np.asarray(linear / linear.sum(axis=-1, keepdims=True))


def _claims_4() -> list[Claim]:
    nm = NM
    normal = spectrum(np.zeros(1))[0]
    again = spectrum(np.zeros(1), absorbing=False)[0]
    coarse: dict[int, tuple[float, float]] = {}
    for count in (10, 15):
        at = np.linspace(nm[0], nm[-1], count)
        guess = np.interp(nm, at, np.interp(at, nm, normal))
        shift = float(np.max(np.abs(rgb(colour.xyz(guess - normal, NM)))))
        coarse[count] = float(np.max(np.abs(guess - normal))), shift
    red, green, blue = (float(c) for c in rgb(colour.xyz(normal, NM)))
    return [
        Claim(
            "“Most materials are measured at only a few wavelengths (… 10 to 15) …; a simple linear interpolation "
            "seems to be sufficient.”",
            agreed(c < SUFFICIENT for _, c in coarse.values()),
            "; ".join(
                f"{k} wavelengths: reflectance off by at most {r:.3f}, colour by {c:.4f}"
                for k, (r, c) in coarse.items()
            ),
            "no channel of the colour changes by more than 1 % of white, with 10 and with 15 samples",
        ),
        Claim(
            "An effective index n = (1 + √F_0)/(1 − √F_0) “yields the correct value of F for normal incidence”.",
            bool(np.max(np.abs(again - normal)) < 1e-12),
            f"largest difference over the spectrum {number(float(np.max(np.abs(again - normal))), 1)}",
            "the same normal reflectance to 1e-12",
        ),
        Claim(
            "“The specular reflectance component has a copper color” (of the vase made with this spectrum, Fig. 6b).",
            red > green > blue and red > 1.2 * blue,
            f"linear RGB of reflected D6500 light: {red:.3f}, {green:.3f}, {blue:.3f}",
            "red above green above blue, and red a fifth above blue",
        ),
    ]


def _spectrum() -> PaperFigure:
    nm = NM
    normal = spectrum(np.zeros(1))[0]
    power = light()
    rows = [
        {"wavelength_nm": w, "reflectance": at(nm, normal, w), "d65": at(nm, power, w)}
        for w in (400.0, 450.0, 500.0, 550.0, 600.0, 650.0, 700.0)
    ]
    return PaperFigure(
        "cook-torrance-4",
        "Cook-Torrance Fig. 4: reflectance and reflected light of a copper mirror",
        PAPER,
        [
            copper(),
            FigureParameter("illuminant", "CIE D6500", "database", D65_SOURCE),
            FigureParameter("θi", "0°", "paper"),
            FigureParameter(
                "colour",
                "CIE 1931, linear RGB of the sRGB primaries",
                "assumed",
                "the paper's monitor is not described",
            ),
        ],
        _claims_4(),
        [
            trace_panel(
                "reflectance",
                "(a) Reflectance: a copper mirror at normal incidence.",
                [Trace("copper", nm / 1000, normal)],
                "wavelength [µm]",
                "reflectance",
            ),
            trace_panel(
                "light",
                "(b) Spectral energy: of D6500 (top), and of the same light reflected by the mirror (bottom).",
                [Trace("D6500", nm / 1000, power), Trace("reflected by copper", nm / 1000, power * normal)],
                "wavelength [µm]",
                "relative spectral power",
            ),
        ],
        Results(
            "",
            {
                "wavelength": lambda r: f"{r['wavelength_nm'] / 1000:g} µm",
                "reflectance": lambda r: number(r["reflectance"]),
                "D6500": lambda r: number(r["d65"], 4),
                "reflected": lambda r: number(r["d65"] * r["reflectance"], 4),
            },
            rows,
        ),
    )


# --- Fig. 5: copper over the angle --------------------------------------------------------------------------------


def colours(theta: Floats) -> dict[str, Floats]:
    """Linear RGB of D65 light reflected by copper at these angles, (angles, 3), by each procedure."""
    return {
        "complete": rgb(colour.reflected_xyz(theta, NM, "Cu")),
        "complete, k = 0": rgb(colour.xyz(spectrum(theta, absorbing=False), NM)),
        "approximate": rgb(colour.shifted_xyz(theta, NM, "Cu")),
    }


def _shift(linear: Floats) -> Floats:
    """How much of the way of the chromaticity from normal incidence to the light's own has been gone."""
    way = shares(linear) - shares(linear[:1])
    whole = 1.0 / 3.0 - shares(linear[:1])
    return np.asarray(np.linalg.norm(way, axis=1) / np.linalg.norm(whole))


def _claims_of_index(theta: Floats) -> list[Claim]:
    """What the paper says of one real index in place of n + ik."""
    deg = np.degrees(theta)
    exact, effective = spectrum(theta), spectrum(theta, absorbing=False)
    off, below = np.abs(exact - effective), deg <= 70.0
    k = np.unravel_index(int(np.argmax(off)), exact.shape)
    worst, worst_early = float(off[k]), float(np.max(off[deg <= EARLY_DEG]))
    change, change_real = (float(np.max(np.abs(r[below] - r[:1]))) for r in (exact, effective))
    return [
        Claim(
            "The effective index gives “a good estimate of [F's] angular dependence, which is only weakly dependent on "
            "the extinction coefficient k”.",
            worst < SIMILAR,
            f"up to {EARLY_DEG:g}° reflectances differ by at most {worst_early:.3f}, beyond by at most {worst:.3f} (at "
            f"{deg[k[0]]:g}° and {NM[k[1]]:g} nm, near the Brewster angle of an index so large)",
            "less than 0.1 apart at every angle and wavelength",
        ),
        Claim(
            "“The reflectance varies only slightly for incidence angles within about 70° of the surface normal.”",
            agreed(v < SIMILAR for v in (change, change_real)),
            f"up to 70° it changes by at most {change:.3f} (n + ik), {change_real:.3f} (effective index)",
            "by less than 0.1 at every wavelength",
        ),
    ]


def _claims_5() -> list[Claim]:
    theta = np.radians(np.append(np.arange(0.0, 90.0, 0.5), 89.999))
    deg = np.degrees(theta)
    complete, real, short = colours(theta).values()
    last = [float(np.max(np.abs(c[-1] - 1.0))) for c in (complete, real)]
    at_60 = [float(_shift(c)[int(np.argmin(np.abs(deg - 60.0)))]) for c in (complete, real)]
    half = [float(deg[int(np.argmax(_shift(c) > 0.5))]) for c in (complete, real)]
    near, far = deg <= EARLY_DEG, deg > EARLY_DEG
    early, late = ([float(np.max(np.abs(c - short)[at])) for c in (complete, real)] for at in (near, far))
    worst_deg = float(deg[int(np.argmax(np.abs(complete - short).max(axis=1)))])
    brewster = math.degrees(math.atan(fresnel.n_from_f0(float(spectrum(np.zeros(1)).mean()))))
    return [
        Claim(
            "“As the incidence angle approaches π/2, the color of the reflected light approaches the color of the "
            "light source.”",
            agreed(v < 0.01 for v in last),
            f"at 89.999° no channel is more than {number(max(last), 2)} from white",
            "within 1 % of white at 89.999°",
        ),
        Claim(
            "“The color shift … only becomes important as θ approaches π/2.”",
            agreed(v < 0.1 for v in at_60),
            f"at 60° the chromaticity has gone {100 * max(at_60):.1f} % of its way, half of it at {min(half):g}° to "
            f"{max(half):g}°",
            "less than a tenth of the way at 60°, with n + ik and with the effective index",
        ),
        Claim(
            "“The approximate procedure yields results that are similar to those from the complete … procedure”, up to "
            f"{EARLY_DEG:g}°.",
            agreed(v < SIMILAR for v in early),
            f"channels differ by at most {number(early[0], 2)} of white (against n + ik) and {number(early[1], 2)} "
            "(against the effective index)",
            "less than a tenth of white, in every channel",
        ),
        Claim(
            f"The same beyond {EARLY_DEG:g}°, where the colour shifts.",
            agreed(v < SIMILAR for v in late),
            f"channels differ by at most {number(late[0], 2)} of white (against n + ik, at {worst_deg:g}°) and "
            f"{number(late[1], 2)} (against the effective index): one real index for the whole spectrum has its "
            f"Brewster angle at {brewster:.1f}°, and until there the colour stays that of normal incidence",
            "less than a tenth of white, in every channel",
        ),
        *_claims_of_index(theta),
    ]


def _parameters_5() -> list[FigureParameter]:
    return [
        copper(),
        FigureParameter("illuminant", "CIE D6500", "database", D65_SOURCE),
        FigureParameter("average normal reflectance", f"{float(spectrum(np.zeros(1)).mean()):.4f}", "derived",
                  "mean over the spectrum; the approximation's index is that of this reflectance"),
        FigureParameter("index", "n + ik, and the effective real one", "assumed",
                  "the scan does not say which one the figure was made with: both are judged"),
        FigureParameter("monitor", "sRGB primaries and curve", "assumed", "the paper's monitor is not described"),
    ]  # fmt: skip


CHANNELS = ("red", "green", "blue")


def _draw_colours(figure: Any, deg: Floats, found: Mapping[str, Floats]) -> None:
    """Stripes of the colours, and their channels over the angle."""
    for place, (letter, name) in enumerate((("b", "complete"), ("b'", "complete, k = 0"), ("c", "approximate"))):
        ax = figure.add_axes((0.13, 0.86 - 0.125 * place, 0.85, 0.075))
        ax.imshow(colour.SRGB.encode(found[name])[None], aspect="auto", extent=(0, 90, 0, 1))
        ax.set_xticks([])
        ax.set_yticks([])
        ax.set_title(f"({letter}) {name}", fontsize=7.5, loc="left", pad=2)
    ax = figure.add_axes((0.13, 0.13, 0.85, 0.42))
    for c, tint in enumerate(("#D55E00", "#009E73", "#0072B2")):
        for name, dashes in (("complete", "-"), ("approximate", (0, (4, 2)))):
            ax.plot(deg, found[name][:, c], color=tint, lw=1.3, ls=dashes)
        ax.text(1.0, found["complete"][0, c] + 0.012, CHANNELS[c], color=tint, fontsize=7)
    ax.set_xlim(0, 90)
    plain_axes(ax, "θ, angle of incidence [deg]", "linear RGB")


def _rgb(name: str, row: Mapping[str, Any]) -> str:
    return ", ".join(f"{v:.3f}" for v in row[name])


def _colours() -> PaperFigure:
    theta = np.radians(np.append(np.arange(0.0, 90.0, 0.5), 89.999))
    deg, nm = np.degrees(theta), NM
    found = colours(theta)
    mirrors = spectrum(np.radians(np.array(ANGLES_DEG)))
    rows: list[CurveRow] = [
        (f"{name}: {channel}", "theory", float(x), float(y), None)
        for name, values in found.items()
        for c, channel in enumerate(CHANNELS)
        for x, y in zip(deg, values[:, c], strict=True)
    ]

    results = [
        {"theta_deg": d} | {name: values[int(np.argmin(np.abs(deg - d)))].tolist() for name, values in found.items()}
        for d in (0.0, 30.0, 60.0, 70.0, 80.0, 85.0, 89.0)
    ]
    columns = {name: partial(_rgb, name) for name in found}
    return PaperFigure(
        "cook-torrance-5",
        "Cook-Torrance Fig. 5: copper over the angle of incidence",
        PAPER,
        _parameters_5(),
        _claims_5(),
        [
            trace_panel(
                "spectra",
                "(a) Reflectance: of a copper mirror over the wavelength, at six angles of incidence.",
                [Trace(f"{a:g}°", nm / 1000, r) for a, r in zip(ANGLES_DEG, mirrors, strict=True)],
                "wavelength [µm]",
                "reflectance",
            ),
            Panel(
                "colours",
                "(b), (c) Colours: of D6500 light reflected by copper, complete from the spectrum (b; b' with the "
                "effective real index) and approximate (c). Below: linear RGB, complete solid, approximate dashed.",
                (WIDTH_IN, 3.72),
                partial(_draw_colours, deg=deg, found=found),
                ("angle of incidence [deg]", "linear RGB"),
                rows,
            ),
        ],
        Results("Linear RGB, 1 for white.", {"angle": lambda r: f"{r['theta_deg']:g}°", **columns}, results),
    )  # fmt: skip
