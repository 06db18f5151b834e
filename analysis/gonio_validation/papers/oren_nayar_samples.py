"""Oren and Nayar (1994), Figs. 8 to 11 and 13: plaster, sand, foam, cloth, and the cross-section of a vase.

The scan has lost the samples' parameters, and the measured points are nowhere printed: what is drawn is the model for
assumed values, beside a simulated measurement of such a surface. A claim gets a verdict where it holds, or fails, for
all of those that are tried.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.report.text import number, percent

from gonio.models import Blinn, Lambert, Model, OrenNayar, Sum
from gonio.progress import silent
from gonio.typing import Floats
from gonio_validation.papers.figure import (
    Claim,
    FigureParameter,
    PaperFigure,
    Results,
    Row,
    Trace,
    agreed,
    angle_panel,
    at,
    signed,
    theory,
    trace_panel,
)
from gonio_validation.papers.htsg_scans import agreement
from gonio_validation.papers.htsg_surfaces import CONE_SR, Simulated, divided, measure

PAPER = "Oren and Nayar, Generalization of Lambert's Reflectance Model, SIGGRAPH 1994"
LOST = "lost in the scan"
MATCHED = "the authors chose theirs to match their measurements, this one is a rough surface's"
SAMPLES = {8: ("wall plaster", "A"), 9: ("white sand", "B"), 10: ("foam", "C"), 11: ("cotton towel", "D")}
ROUGHNESS = {8: (30.0, 0.9), 9: (35.0, 0.8), 10: (20.0, 0.8), 11: (40.0, 0.75)}
"""Drawn: sigma [deg] and rho."""
SOURCE_RIGHT = (
    "The source stands on the right, as in the paper's Fig. 5 (“forward” is its left, “backward” its right); the sign "
    "of θr stays this program's: positive on the mirror side."
)
TRIED_SIGMA = (20.0, 30.0, 40.0)
TRIED_SURFACE = (0.02, 0.1, 0.2)
SURFACE, INDEX = 0.1, 1.5
INCIDENCES = (30.0, 45.0, 60.0)
JUDGED_DEG, DRAWN_DEG = 2.5, 0.25
"""Steps of the angle of reflection: those that claims are judged on, and those that are drawn. The model's own corners
lie on both: at theta_r = theta_i, and where Torrance and Sparrow's masking sets in."""
MEASURED_DEG = [float(a) for a in np.arange(-80.0, 80.1, 5.0)]
WAVELENGTH_NM = 550.0
"""Of the simulated measurement; no formula of the paper has a wavelength."""
CLOSE = 0.03
VASE_SIGMA = (20.0, 30.0, 40.0, 50.0)
VASE = (40.0, 0.7)
VASE_LIGHT_DEG = (0.0, 20.0)
NEAR_CONSTANT, MOST = 0.8, 0.75


SIDES: Mapping[str, Callable[[Any], str]] = {
    "incidence": lambda r: f"θi = {r['theta_i_deg']:g}°",
    "source's side": lambda r: number(r["source_side"]),
    "normal": lambda r: number(r["normal"]),
    "mirror side": lambda r: number(r["mirror_side"]),
}
ACROSS = {"−0.95": -0.95, "−0.5": -0.5, "0": 0.0, "0.5": 0.5, "0.95": 0.95}
"""Positions across the vase, over its radius."""


def sides(theta_i_deg: float, angle: Floats, value: Floats) -> dict[str, float]:
    """A curve at theta_r = theta_i on the source's and on the mirror side, and along the normal [1/sr]."""
    source_side, normal, mirror_side = (at(angle, value, where) for where in (-theta_i_deg, 0.0, theta_i_deg))
    return {"theta_i_deg": theta_i_deg, "source_side": source_side, "normal": normal, "mirror_side": mirror_side}


def vase_row(light_deg: float, curve: Trace) -> Row:
    """Brightness across the vase, where it is largest and at some positions; its largest value is 1."""
    across = {f"at {x:g}": at(curve.x, curve.y, x) for x in ACROSS.values()}
    return {"light_deg": light_deg, "model": curve.label, "peak": float(curve.x[int(np.argmax(curve.y))]), **across}


def assumed(sigma: str, rho: str, theta_i: str, why: str) -> list[FigureParameter]:
    """The three parameters that the scan has lost."""
    return [
        FigureParameter("σ", sigma, "assumed", f"{LOST}; {why}"),
        FigureParameter("ρ", rho, "assumed", LOST),
        FigureParameter("θi", theta_i, "assumed", LOST),
    ]


def between(values: Iterable[float]) -> str:
    """As in "1.2 to 3.4"."""
    found = list(values)
    low, high = number(min(found)), number(max(found))
    return low if low == high else f"{low} to {high}"


def build(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    """The page of Fig. 8, 9, 10, 11 or 13."""
    return _vase() if figure == 13 else _sample(figure, progress)


def claims(figure: int, progress: Callable[[str], None] = silent) -> list[Claim]:
    """What the text says about a figure."""
    if figure == 13:
        return _claims_vase()
    return [*_claims_body(), match(figure, simulated(figure, progress))] if figure < 10 else _claims_surface()


# --- Figs. 8 to 11: samples ---------------------------------------------------------------------------------------


def body(sigma_deg: float, albedo: float) -> Any:
    """Plaster and sand: the integral (eq. 13)."""

    return OrenNayar(albedo, sigma_deg, "exact")


def body_and_surface(sigma_deg: float, albedo: float, share: float) -> Any:
    """Foam and cloth, eq. 18: the functional form, and Torrance and Sparrow's on the same grooves."""

    # D2 = exp(-(c2 a)^2) is the Gaussian exp(-a^2/(2 sigma^2))
    surface = Blinn(0.0, 1.0, INDEX, "gaussian", c=1.0 / (math.sqrt(2.0) * math.radians(sigma_deg)))
    return Sum((OrenNayar(albedo, sigma_deg), 1.0), (surface, share))


@dataclass(frozen=True)
class Sample:
    """One of the four samples, with assumed parameters."""

    model: Model

    @property
    def parameters(self) -> Mapping[str, Any]:
        """As a sample file has them."""
        return {name: _plain(one) for name, one in self.model.parameters.items() if one is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items() if one is not None}
    return [value.real, value.imag] if isinstance(value, complex) else value


def model_of(figure: int) -> Model:
    """The surface of a figure, as it is drawn and measured."""
    sigma, albedo = ROUGHNESS[figure]
    model: Model = body_and_surface(sigma, albedo, SURFACE) if figure >= 10 else body(sigma, albedo)
    return model


@cache
def simulated(figure: int, progress: Callable[[str], None]) -> Simulated:
    """The surface of a figure on the simulated goniometer, as those of He and Torrance's figures."""
    return measure(
        Sample(model_of(figure)),
        name=SAMPLES[figure][0],
        wavelength_nm=WAVELENGTH_NM,
        scans=dict.fromkeys(INCIDENCES, MEASURED_DEG),
        solid_angle_sr=CONE_SR,
        progress=lambda text: progress(f"oren-nayar-{figure}: {text}"),
    )


def match(figure: int, taken: Simulated) -> Claim:
    """How near the paper's two forms come to a measurement of such a surface, and Lambert's law."""
    sigma, albedo = ROUGHNESS[figure]

    def off(model: Model) -> float:
        ratio = taken.data.brdf / apparent(model, taken.data)
        return float(
            np.std(ratio / ratio.mean()) if isinstance(model, Lambert) else np.sqrt(np.mean((ratio - 1.0) ** 2))
        )

    integral, functional, flat = (off(m) for m in (body(sigma, albedo), OrenNayar(albedo, sigma), Lambert(albedo)))
    return Claim(
        "“The model predictions and experimental measurements match remarkably well.”",
        integral < CLOSE < flat,
        f"{len(taken.data)} simulated values: off by {percent(integral)} (eq. 13), {percent(functional)} (eqs. 14 to "
        f"16), {percent(flat)} (Lambert, any albedo), root mean square",
        f"eq. 13, which the paper draws, is off by less than {percent(CLOSE)}, a dot's size in print, and Lambert by "
        "more. The paper's dots are lost: measured is a surface of V-grooves through the frames of a goniometer",
    )


def radiance(model: Any, theta_i_deg: float, step_deg: float = JUDGED_DEG) -> tuple[Floats, Floats]:
    """Signed angles [deg] and radiance over the irradiance head-on [1/sr], in the plane of incidence."""
    angle = np.round(np.arange(-85.0, 85.1, step_deg), 6)
    theta_r, phi_r = signed(angle)
    theta_i = math.radians(theta_i_deg)
    return angle, np.asarray(model.brdf(theta_i, 0.0, theta_r, phi_r)) * math.cos(theta_i)


def _claims_body() -> list[Claim]:
    toward, forward, peak = [], [], []
    for sigma in TRIED_SIGMA:
        for i in INCIDENCES:
            angle, value = radiance(body(sigma, 0.9), i)
            inside = (angle >= -i) & (angle <= 0.0)
            toward.append(bool(np.all(np.diff(value[inside]) < 0)))
            forward.append(at(angle, value, -i) / at(angle, value, i))
            around = max(at(angle, value, -i - 5.0), at(angle, value, -i + 5.0))
            peak.append(at(angle, value, -i) / around - 1.0)
    return [
        Claim(
            "“For both samples, radiance increases as the viewing direction θr approaches the source direction.”",
            agreed(toward),
            "from the normal to the source's direction the radiance grows at every step",
            "monotonic, for σ = 20°, 30°, 40° and θi = 30°, 45°, 60°",
        ),
        Claim(
            "“This is in contrast to the behavior of rough specular surfaces that reflect more in the forward "
            "direction, or Lambertian surfaces where radiance does not vary with viewing direction.”",
            agreed(r > 1.05 for r in forward),
            f"radiance at θr = θi on the source's side over that on the mirror side: {between(forward)}",
            "more than 1.05 with every choice (Lambert: 1; forward reflection: less)",
        ),
        Claim(
            "The small measured peak near the source direction “is caused by a different backscattering mechanism from "
            "the one described by our model”.",
            agreed(p < 0.02 for p in peak),
            f"the model's radiance at retro over the larger one 5° beside it: {between(1.0 + p for p in peak)}; it has "
            "no such peak",
            "below 1.02, with every choice",
        ),
    ]


def _claims_surface() -> list[Claim]:
    back, rising = [], {}
    for share in TRIED_SURFACE:
        for sigma in TRIED_SIGMA:
            for i in INCIDENCES:
                angle, value = radiance(body_and_surface(sigma, 0.8, share), i)
                back.append(at(angle, value, -i) / at(angle, value, 0.0))
                forward = value[angle >= 0.0]
                rising[share, sigma, i] = float(forward.max() / forward[0])
    bumps = [r > 1.0 + 1e-9 for (_, _, i), r in rising.items() if i == INCIDENCES[-1]]
    at_60 = {s: [r for (k, _, i), r in rising.items() if k == s and i == INCIDENCES[-1]] for s in TRIED_SURFACE}
    return [
        Claim(
            "The sample “has not only a body reflectance component”: radiance increases toward the source.",
            agreed(b > 1.05 for b in back),
            f"radiance at θr = θi on the source's side over that along the normal: {between(back)}",
            f"more than 1.05, for σ = 20° to 40°, k_s = {', '.join(f'{s:g}' for s in TRIED_SURFACE)} and every θi",
        ),
        Claim(
            "“… but also a significant surface reflection component”: a peak in the forward direction.",
            agreed(bumps),
            "largest forward value over that along the normal at θi = 60°: "
            + ", ".join(f"{between(v)} (k_s = {s:g})" for s, v in at_60.items()),
            "more than 1; hangs on k_s, which the scan lacks",
        ),
    ]


def _lines(curves: Sequence[tuple[float, Floats, Floats]], taken: Simulated) -> list[Line]:
    """Radiance by the model, and as it was measured."""
    out = []
    for i, angle, value in curves:
        measured = divided(taken.curve(i), 1.0 / math.cos(math.radians(i)))
        out.append(Line(f"θi = {i:g}°", np.radians(angle), value, *measured, math.radians(i)))
    return out


def _sample(figure: int, progress: Callable[[str], None]) -> PaperFigure:
    name, letter = SAMPLES[figure]
    sigma, albedo = ROUGHNESS[figure]
    specular = figure >= 10
    curves = [(i, *radiance(model_of(figure), i, DRAWN_DEG)) for i in INCIDENCES]
    taken = simulated(figure, progress)
    lines = _lines(curves, taken)
    words = "eq. 18: k_b times the functional form, k_s times Torrance-Sparrow" if specular else "the integral (eq. 13)"
    parameters = assumed(f"{sigma:g}°", f"{albedo:g}", ", ".join(f"{i:g}°" for i in INCIDENCES), MATCHED)
    if specular:
        parameters += [
            FigureParameter("k_b, k_s", f"1, {SURFACE:g}", "assumed", f"{LOST}; the authors fitted theirs"),
            FigureParameter(
                "n of the surface", f"{INDEX:g}", "assumed", "the paper gives none; a polymer's or fibre's"
            ),
        ]
    panels = [
        angle_panel(
            "radiance",
            f"Radiance: over the irradiance head-on; {words}. Marks: simulated measurement.",
            lines,
            "L / E0 [1/sr]",
            retro_right=True,
        )
    ]
    if specular:
        alone = [(i, *radiance(body_and_surface(sigma, albedo, 0.0), i, DRAWN_DEG)) for i in INCIDENCES]
        panels.append(
            angle_panel(
                "body",
                "Body alone: the same without surface reflection (k_s = 0).",
                [theory(f"θi = {i:g}°", np.radians(a), v, math.radians(i)) for i, a, v in alone],
                "L / E0 [1/sr]",
                retro_right=True,
            )
        )
    return PaperFigure(
        f"oren-nayar-{figure}",
        f"Oren-Nayar Fig. {figure}: {name} (sample {letter})",
        PAPER,
        parameters,
        claims(figure, progress),
        panels,
        Results("Radiance over E0 [1/sr].", SIDES, [sides(*curve) for curve in curves]),
        [
            "The paper's dots, its measurements, are not in the scan: the marks are a simulated measurement.",
            agreement(taken),
            SOURCE_RIGHT,
            "The corners of the curves are the model's own: it changes its branch at θr = θi on the source's side"
            + (", and Torrance and Sparrow's masking factor has two more." if specular else "."),
        ],
        [("simulated measurement", taken.words)],
        taken.files,
    )  # fmt: skip


# --- Fig. 13: a vase ----------------------------------------------------------------------------------------------


def cross_section(model: Any, light_deg: float) -> tuple[Floats, Floats]:
    """Position across a cylinder of radius 1 (right positive) and brightness, its largest value 1.

    The camera is far away; the lamp stands `light_deg` to the right of it.
    """
    x = np.round(np.arange(-0.995, 0.9951, 0.005), 6)
    normal = np.arcsin(x)
    source, view = math.radians(light_deg) - normal, -normal
    lit = np.abs(source) < math.pi / 2 - 1e-6
    same_side = np.where(source * view >= 0.0, 0.0, math.pi)
    value = np.zeros(x.size)
    f = model.brdf(np.abs(source[lit]), 0.0, np.abs(view[lit]), same_side[lit])
    value[lit] = np.asarray(f) * np.cos(source[lit])
    return x, value / value.max()


def _width(x: Floats, value: Floats) -> float:
    """The share of the cross-section where the brightness is near its largest."""
    return float(np.count_nonzero(value >= NEAR_CONSTANT) / x.size)


def _claims_vase() -> list[Claim]:
    flat = {light: cross_section(Lambert(VASE[1]), light) for light in VASE_LIGHT_DEG}
    rough = {(s, light): cross_section(body(s, VASE[1]), light) for s in VASE_SIGMA for light in VASE_LIGHT_DEG}
    front, right = VASE_LIGHT_DEG
    widths = {s: _width(*rough[s, front]) for s in VASE_SIGMA}
    limb = {s: at(*rough[s, front], 0.95) for s in VASE_SIGMA}
    edge = {s: at(*rough[s, right], 0.95) for s in VASE_SIGMA}
    asymmetry = [at(*rough[s, right], 0.9) / at(*rough[s, right], -0.9) for s in VASE_SIGMA]
    peaks = {s: float(rough[s, right][0][int(np.argmax(rough[s, right][1]))]) for s in VASE_SIGMA}
    lambert_peak = float(flat[right][0][int(np.argmax(flat[right][1]))])
    names = {s: f"σ = {s:g}°" for s in VASE_SIGMA}
    return [
        Claim(
            "(a) The brightness “remains nearly constant over most of the cross-section … the proposed model does very "
            "well in predicting this behavior”.",
            agreed(w > MOST for w in widths.values()),
            "share of the width with at least 80 % of the largest brightness: "
            + ", ".join(f"{100 * w:.0f} % ({names[s]})" for s, w in widths.items())
            + f"; Lambert {100 * _width(*flat[front]):.0f} %",
            "more than three quarters of the width; hangs on σ",
        ),
        Claim(
            "(a) “… the Lambertian model produces large brightness errors.”",
            agreed(v > 1.2 * at(*flat[front], 0.95) for v in limb.values()),
            f"at 0.95 of the radius: model {between(limb.values())}, Lambert {number(at(*flat[front], 0.95))}",
            "near the limb the rough surface is more than 1.2 times as bright, for every σ",
        ),
        Claim(
            "(b) With the lamp 20° to the right “brightness variation on the real vase is asymmetric”.",
            agreed(a > 1.2 for a in asymmetry),
            f"brightness at 0.9 of the radius, right over left: {between(asymmetry)}",
            "more than 1.2, for every σ",
        ),
        Claim(
            "(b) “The Lambertian model forces the brightness close to the right limb … to drop much faster than in the "
            "real image.”",
            agreed(v > 1.2 * at(*flat[right], 0.95) for v in edge.values()),
            f"at 0.95 of the radius: model {between(edge.values())}, Lambert {number(at(*flat[right], 0.95))}",
            "the rough surface is more than 1.2 times as bright there, for every σ",
        ),
        Claim(
            "(b) “The brightness peak predicted by the Lambertian model is significantly away from the actual peak.”",
            agreed(p - lambert_peak > 0.1 for p in peaks.values()),
            f"Lambert's at {lambert_peak:.2f} of the radius; the model's at "
            + ", ".join(f"{p:.2f} ({names[s]})" for s, p in peaks.items()),
            "more than 0.1 of the radius apart; hangs on σ",
        ),
    ]


def _across(x: float, row: Mapping[str, Any]) -> str:
    return number(row[f"at {x:g}"])


def _vase() -> PaperFigure:
    sigma, albedo = VASE
    models = (("Lambertian", Lambert(albedo)), (f"Oren-Nayar, σ = {sigma:g}°", body(sigma, albedo)))
    panels, rows = [], []
    for letter, light in zip("ab", VASE_LIGHT_DEG, strict=True):
        traces = [Trace(name, *cross_section(m, light)) for name, m in models]
        where = "from the camera" if light == 0 else f"{light:g}° to the right of the camera"
        panels.append(
            trace_panel(
                f"light-{light:g}",
                f"({letter}) Light {where}: brightness across the vase, its largest value 1.",
                traces,
                "position / radius (left negative)",
                "brightness",
            )
        )
        rows += [vase_row(light, trace) for trace in traces]
    return PaperFigure(
        "oren-nayar-13",
        "Oren-Nayar Fig. 13: cross-section of a clay vase",
        PAPER,
        [
            *assumed(f"{sigma:g}°", f"{albedo:g}", "", MATCHED)[:2],
            FigureParameter("light", "from the camera; 20° to its right", "paper"),
            FigureParameter("vase", "a cylinder, camera and lamp far away", "derived", "“cylindrical clay vase”"),
            FigureParameter("judged with", ", ".join(f"{s:g}°" for s in VASE_SIGMA), "assumed", "σ; all have to agree"),
        ],
        _claims_vase(),
        panels,
        Results(
            "Brightness at positions across the vase (radius 1), and where it is largest.",
            {
                "curve": lambda r: f"({'ab'[VASE_LIGHT_DEG.index(r['light_deg'])]}) {r['model']}",
                **{shown: partial(_across, x) for shown, x in ACROSS.items()},
                "peak": lambda r: f"{r['peak']:.2f}".replace("-", "−"),
            },
            rows,
        ),
        ["The measured brightness is not in the scan: only models are compared."],
    )  # fmt: skip
