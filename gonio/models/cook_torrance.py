"""Cook and Torrance, "A Reflectance Model for Computer Graphics", ACM Transactions on Graphics 1 (1982) 7-24."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, replace
from itertools import product
from math import pi, sqrt
from typing import Any, ClassVar, Self

import numpy as np

from gonio.errors import ArgumentError
from gonio.models import engine, hemispherical
from gonio.models._compile import device, of_columns, with_others
from gonio.models._facets import SINGLE_RANGE, by_angle, by_tan2, fresnel, fresnel_constants, fresnel_real
from gonio.models._math import _LOG2_E, exp2
from gonio.models.engine import Constants, Kernel
from gonio.models.fresnel import n_from_f0, reflectance
from gonio.models.model import Model, store
from gonio.models.parameters import (
    INDEX,
    Arguments,
    Declaration,
    Fitted,
    Index,
    Ior,
    Levels,
    Parameter,
    Parameters,
    Values,
    checked_index,
    checked_wavelength,
    choice,
    index_at,
    number,
    optical,
    optical_argument,
    parameter,
    row,
)
from gonio.models.polarised import Facets
from gonio.typing import ArrayLike, Floats

DEFAULT_INDEX = 0.64 + 2.6j


# --- kernels: constants are the diffuse BRDF, 3 numbers of F, then -log2(e)/m^2 and the factor of every slope ---


@device
def schlick(c2, f0, rest, unused):  # type: ignore[no-untyped-def]
    """F_0 + (1 - F_0)(1 - cos)^5 over 1, in the place of `fresnel`."""
    x = 1.0 - sqrt(c2)
    x2 = x * x
    return f0 + rest * (x2 * x2 * x), 1.0


@device
def gaussian_slopes(square, slopes):  # type: ignore[no-untyped-def]
    """D = c exp(-(alpha/m)^2) with c = 1, summed over slopes; of tan^2 in place of alpha^2 it is Beckmann's D cos^4."""
    d = 0.0
    for j in range(0, len(slopes), 2):
        rate, factor = slopes[j], slopes[j + 1]
        d += factor * exp2(square * rate)
    return d


@device
def beckmann_slope(m, scale):  # type: ignore[no-untyped-def]
    """Rate and factor of a slope for `gaussian_slopes`, of Beckmann's D."""
    return -_LOG2_E / (m * m), scale / (m * m)


@device
def facets(sz, g, diffuse, up, down):  # type: ignore[no-untyped-def]
    """The BRDF for D F = up / down: D F G/((N.L)(N.V)) with G/((N.L)(N.V)) = s_z/g."""
    up *= sz
    return diffuse + (up / (down * g) if up > 0.0 else 0.0)


@of_columns(by_tan2, 4, single_range=SINGLE_RANGE)
def beckmann(tan2, s2, sz, g, constants):  # type: ignore[no-untyped-def]
    """R_s with Beckmann's D and the exact F."""
    (diffuse, contrast, real, imag), slopes = constants[:4], constants[4:]
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    d = gaussian_slopes(tan2, slopes) * ((1.0 + tan2) * (1.0 + tan2))
    return facets(sz, g, diffuse, d * f_up, f_down)


@of_columns(by_angle, 4, single_range=SINGLE_RANGE)
def gaussian(alpha2, s2, sz, g, constants):  # type: ignore[no-untyped-def]
    """R_s with the Gaussian D and the exact F."""
    (diffuse, contrast, real, imag), slopes = constants[:4], constants[4:]
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    return facets(sz, g, diffuse, gaussian_slopes(alpha2, slopes) * f_up, f_down)


_REFLECTANCES: dict[str, Kernel] = {"exact": fresnel, "real": fresnel_real, "schlick": schlick}
_KERNELS: dict[tuple[str, str], Kernel] = {
    (kernel.__name__, name): kernel if f is fresnel else with_others(kernel, f"{kernel.__name__}_{name}", {fresnel: f})
    for kernel in (beckmann, gaussian)
    for name, f in _REFLECTANCES.items()
}


PRESETS: dict[str, Parameters] = {
    # Table I: s, d, m. The paper does not print the materials' reflectances: give `ior` or `f0`.
    "carbon": {"s": 0.3, "d": 0.7, "slopes": ((0.40, 1.0),)},
    "rubber": {"s": 0.4, "d": 0.6, "slopes": ((0.30, 1.0),)},
    "obsidian": {"s": 0.8, "d": 0.2, "slopes": ((0.15, 1.0),)},
    "lunar dust": {"s": 0.0, "d": 1.0, "slopes": ((1.0, 1.0),)},  # m "not used"
    "olive drab": {"s": 0.3, "d": 0.7, "slopes": ((0.50, 1.0),)},
    "rust": {"s": 0.2, "d": 0.8, "slopes": ((0.35, 1.0),)},
    # Fig. 6: the copper vase, and the copper-coloured plastic one with the Fresnel reflectance of vinyl
    "copper": {"s": 1.0, "d": 0.0, "slopes": ((0.4, 0.4), (0.2, 0.6)), "ior": "Cu"},
    "plastic": {"s": 0.1, "d": 0.9, "slopes": ((0.15, 1.0),), "ior": 1.54},
}
"""The paper's parameter sets by name. The index 1.54 of vinyl (polyvinyl chloride) is ours: the paper gives none."""


def _checked_slopes(name: str, slopes: Any) -> tuple[tuple[float, float], ...]:
    if isinstance(slopes, (int, float)):
        slopes = ((slopes, 1.0),)
    try:
        pairs = [(m, w) for m, w in slopes]
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} = {slopes!r}: must be pairs (rms slope m, weight), or one slope") from None
    if not pairs:
        raise ArgumentError(f"{name}: needs at least one pair (rms slope m, weight)")
    checked = []
    for j, (m, w) in enumerate(pairs):
        checked.append((number(f"{name}[{j}] m", m, 1e-100, 1e6), number(f"{name}[{j}] weight", w, 0.0)))
    total = math.fsum(w for _, w in checked)
    if abs(total - 1.0) > 1e-6:
        raise ArgumentError(f"{name}: the weights sum to {total:g}, and must sum to 1")
    return tuple(checked)


@dataclass(frozen=True, init=False, repr=False)
class CookTorrance(Model):
    """Mirror facets with V-groove shadowing over a diffuse base: brdf = s R_s + d diffuse_albedo / pi [1/sr].

    R_s = (F/pi) D G / ((N.L)(N.V)) as printed ("paper"), or a quarter of it ("normalised"): with D as defined here
    the printed form reflects four times what falls on a surface of gentle slopes. D = sum of w_j D(m_j); "beckmann":
    exp(-(tan a/m)^2)/(m^2 cos^4 a); "gaussian": c exp(-(a/m)^2) with the arbitrary c = 1. G = min(1, 2 N.H N.V/V.H, 2
    N.H N.L/V.H). F is the exact unpolarised reflectance for a complex index. m is the total rms slope, sqrt(2) times
    the one along a line. Reciprocal. At exactly grazing the limit along equal polar angles is returned: +inf in the
    mirror direction. Accurate to some 1e-15 (1 + the formula's conditioning); from angles within some milliradians of
    grazing, for slopes below 1e-3, to that of the vectors they are turned into, 1/cos(theta) times more.
    """

    normalisation: str
    s: float = parameter(MISSING, "[0, 1]", "Share of the facets.", scale="linear")
    d: float = parameter(
        MISSING, "[0, 1]", "Share of the diffuse base, s + d <= 1. Without it 0; with `m` it is 1 - s."
    )
    slopes: tuple[tuple[float, float], ...] = parameter(
        MISSING,
        _checked_slopes,
        "Pairs (rms slope m, weight); weights are at least 0 and sum to 1. A single number is one slope.",
    )
    ior: Any = parameter(MISSING, INDEX[0], INDEX[1] + " Without it that of copper at 550 nm, 0.64 + 2.6i.")
    distribution: str = parameter(MISSING, ("beckmann", "gaussian"), "Distribution of the facets' slopes.")
    diffuse_albedo: float = parameter(
        MISSING, "[0, 1]", "Albedo of the diffuse part: R_d = diffuse_albedo / pi.", scale="linear"
    )
    fresnel: str = parameter(
        MISSING,
        ("exact", "schlick"),
        '"schlick": F_0 + (1 - F_0)(1 - V.H)^5 (Schlick 1994), as many published fits have it.',
    )
    besides: ClassVar[Mapping[str, Parameter]] = {
        "convention": row("paper", ("paper", "normalised"), "R_s as printed, or a quarter of it."),
        "f0": row(
            None,
            "[0, 1)",
            "Reflectance at normal incidence, instead of `ior`: n = (1 + sqrt F_0)/(1 - sqrt F_0), k = 0.",
        ),
        "m": row(
            None,
            "[1e-100, 1e6]",
            "Rms slope of the facets: one slope in the place of `slopes`.",
            scale="log",
            bounds=(0.0005, 3.0),
            geometry=True,
        ),
    }
    name: ClassVar[str] = "cook-torrance"
    rank: ClassVar[int] = 5
    assumes: ClassVar[str] = "facets that are large against the wavelength (Cook and Torrance 1982, sec. 1)"
    in_sums: ClassVar[str] = "gloss"
    bases: ClassVar[tuple[str, ...]] = ("oren-nayar", "retroreflecting")
    has_ior: ClassVar[bool] = True
    several_slopes: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        names = ("m",) if slopes == 1 else ("m_1", "m_2", "w_1")

        def arguments(v: Values) -> Arguments:
            slope = ((v["m"], 1.0),) if slopes == 1 else ((v["m_1"], v["w_1"]), (v["m_2"], 1.0 - v["w_1"]))
            # s + d = 1 to the last bit: the constructor refuses more
            return {
                "s": v["s"],
                "d": 1.0 - v["s"],
                "slopes": slope,
                "diffuse_albedo": v["diffuse_albedo"],
                "ior": optical_argument(v, ior),
            }

        def starts(levels: Levels) -> list[Values]:
            widths = [{"m": m} for m in (0.005, 0.03, 0.08, 0.15, 0.25, 0.4, 0.7)]
            if slopes == 2:
                pairs = product((0.03, 0.08, 0.15, 0.25), (0.25, 0.5, 0.9))
                widths = [{"m_1": a, "m_2": b, "w_1": 0.5} for a, b in pairs if a < b]
            return [
                {"s": s, **width, "diffuse_albedo": min(levels.diffuse / (1 - s), 1.0), "ior": n}
                for width, s, n in product(widths, (0.03, 0.2, 0.7), (1.5, 3.0, 20.0))
            ]

        width, share = cls.besides["m"].fitted, Fitted(0.0, 1.0, geometry=True)
        own = {n: share if n == "w_1" or width is None else width for n in names}
        rows = {"s": cls.fitted["s"], **own, "diffuse_albedo": cls.fitted["diffuse_albedo"]}
        return replace(
            optical(cls.name, rows, ior, starts),
            arguments=arguments,
            flat=lambda v: {"diffuse_albedo": (1.0 - v["s"]) / math.pi},
            derived=lambda v: {"d": 1.0 - v["s"]} | ({"w_2": 1.0 - v["w_1"]} if slopes == 2 else {}),
        )

    def __init__(
        self,
        s: float = 1.0,
        d: float | None = None,
        slopes: float | Sequence[Sequence[float]] | None = None,
        ior: Index | None = None,
        distribution: str = "beckmann",
        diffuse_albedo: float = 0.0,
        convention: str = "paper",
        *,
        f0: float | None = None,
        fresnel: str = "exact",
        m: float | None = None,
    ) -> None:
        if m is not None and slopes is not None:
            raise ArgumentError("m and slopes are both given: m is the one slope, instead of slopes")
        if slopes is None:
            slopes = ((0.4, 0.4), (0.2, 0.6)) if m is None else ((self.besides["m"].checked("m", m), 1.0),)
        if d is None:
            d = 0.0 if m is None else 1.0 - self.table["s"].checked("s", s)
        if f0 is not None and ior is not None:
            raise ArgumentError("f0 and ior are both given: f0 stands instead of ior")
        if f0 is not None:
            ior = n_from_f0(f0)
        store(
            self,
            s=s,
            d=d,
            slopes=slopes,
            ior=DEFAULT_INDEX if ior is None else ior,
            distribution=distribution,
            diffuse_albedo=diffuse_albedo,
            normalisation=self.besides["convention"].checked("convention", convention),
            fresnel=fresnel,
        )
        self.__post_init__()
        if self.s + self.d > 1.0 + 1e-12:
            raise ArgumentError(f"s + d = {self.s + self.d:g}: the shares must not exceed 1")

    @classmethod
    def preset(cls, preset: str, **changes: Any) -> Self:
        """One of the paper's parameter sets (`PRESETS`), with changes.

        The paper gives Table I's materials without their reflectance: pass `ior` or `f0`. Where the set has a diffuse
        part and no `diffuse_albedo` is given, it is the normal reflectance of the material at 550 nm, as in the
        paper's figures (R_d = F_0/pi); for the copper-coloured "plastic" that of copper.

        Raises
        ------
        ArgumentError
            There is no such set (with the nearest name), it needs `ior` or `f0`, or a change is out of range.
        """
        chosen = choice("preset", preset, tuple(PRESETS))
        values = {**PRESETS[chosen], **changes}
        if "f0" in changes:
            values.pop("ior", None)
        if "ior" not in values and "f0" not in values:
            raise ArgumentError(f'the paper gives no reflectance for "{chosen}": pass ior= or f0=')
        if values["d"] > 0.0 and "diffuse_albedo" not in values:
            colour = "Cu" if chosen == "plastic" else values.get("ior")
            values["diffuse_albedo"] = (
                values["f0"] if colour is None else float(reflectance(1.0, index_at(checked_index(colour), 550.0)))
            )
        return cls(**values)

    @property
    def parameters(self) -> Parameters:
        values = super().parameters
        values["convention"] = values.pop("normalisation")
        return values

    @property
    def convention(self) -> str:
        return (
            f"Cook and Torrance 1982, {self.distribution} facets, "
            + (
                "exact Fresnel reflectance for n + ik; "
                if self.fresnel == "exact"
                else "Schlick's Fresnel reflectance; "
            )
            + (
                "R_s as printed, F D G/(pi N.L N.V), four times the energy-normalised form"
                if self.normalisation == "paper"
                else "R_s = F D G/(4 pi N.L N.V), a quarter of the print: no more than falls on gentle slopes"
            )
            + "; m is the total rms slope."
        )

    @property
    def parameter_notes(self) -> Mapping[str, str]:
        if self.normalisation == "paper":
            return {"s": "share of R_s over π, as the paper prints it; over 4π, as today, s would be 4 times this"}
        return {"s": "share of R_s over 4π; over π, as the paper prints it, s would be a quarter of this"}

    def _weighted(self, wavelength_nm: float, diffuse: float, scale: float) -> tuple[Kernel, Constants]:
        scale /= pi * (4.0 if self.normalisation == "normalised" else 1.0)
        slopes = [value for m, w in self.slopes for value in beckmann_slope(m, scale * w)]
        if self.distribution == "gaussian":
            slopes[1::2] = [scale * w for _, w in self.slopes]
        ior = index_at(self.ior, wavelength_nm)
        if self.fresnel == "schlick":
            f0 = float(reflectance(1.0, ior))
            return _KERNELS[self.distribution, "schlick"], (diffuse, f0, 1.0 - f0, 0.0, *slopes)
        kind = "real" if ior.imag == 0.0 else "exact"
        return _KERNELS[self.distribution, kind], (diffuse, *fresnel_constants(ior), *slopes)

    def facets(self, wavelength_nm: float) -> Facets:
        return Facets(index_at(self.ior, wavelength_nm), self.d * self.diffuse_albedo / pi)

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return self._weighted(wavelength_nm, self.d * self.diffuse_albedo / pi, self.s)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The same for both sides, as the model is reciprocal."""
        if self.s == 0.0:
            return np.full(theta.size, self.d * self.diffuse_albedo)
        beckmann_facets = self.distribution == "beckmann"
        widths = [[q * m for q in hemispherical.WIDTHS] for m, _ in self.slopes]
        angles = [[math.atan(q) for q in row] if beckmann_facets else row for row in widths]
        kernel, constants = self._weighted(wavelength_nm, 0.0, self.s)
        lobe = hemispherical.over_facets(
            kernel,
            constants,
            theta,
            scales=[angle for row in angles for angle in row],
            reach=max(row[-1] for row in angles),
            index=None if self.fresnel == "schlick" else (constants[2], constants[3]),
            tolerance=tolerance,
        )
        return lobe + self.d * self.diffuse_albedo

    def specular(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
        out: Any = None,
    ) -> Any:
        """R_s [1/sr] without its share s, in the model's normalisation; arguments as `brdf`."""
        kernel, constants = self._weighted(checked_wavelength(wavelength_nm), 0.0, 1.0)
        return engine.over_angles(kernel, constants, theta_i, phi_i, theta_r, phi_r, out=out)

    def ambient_reflectance(self, theta_r: float | None = None, *, wavelength_nm: float = 550.0) -> float:
        """R_a, the reflectance for light that falls in evenly from everywhere.

        Parameters
        ----------
        theta_r
            None: what the paper's figures use, R_a = pi R_d = diffuse_albedo. A polar angle of the viewer [rad]: the
            hemispherical-directional reflectance.
        """
        if theta_r is None:
            return self.diffuse_albedo
        theta = number("theta_r", theta_r, 0.0, pi / 2, "rad")
        return float(self.hemispherical_directional(theta, wavelength_nm=wavelength_nm))
