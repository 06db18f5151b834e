"""Blinn, "Models of Light Reflection for Computer Synthesized Pictures", SIGGRAPH 1977.

Phong's and Torrance and Sparrow's highlights.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, replace
from itertools import product
from math import pi
from typing import Any, ClassVar, Self

import numpy as np

from gonio.errors import ArgumentError
from gonio.models import engine, hemispherical
from gonio.models._compile import device, of_columns, with_others
from gonio.models._facets import (
    SINGLE_RANGE,
    alpha_squared,
    by_angle,
    by_log_cos,
    by_sxy2,
    cos_power,
    facet,
    fresnel,
    fresnel_constants,
    fresnel_real,
    groove_over_viewer,
    log_cos2,
)
from gonio.models._math import _LOG2_E, exp2
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model, store
from gonio.models.parameters import (
    INDEX,
    Declaration,
    Index,
    Ior,
    Levels,
    Parameter,
    Parameters,
    Values,
    checked_wavelength,
    choice,
    index_at,
    number,
    optical,
    parameter,
    plain,
    row,
)
from gonio.models.polarised import Facets
from gonio.typing import ArrayLike, Floats

DISTRIBUTIONS = ("trowbridge-reitz", "gaussian", "phong")


# --- kernels: p is (k_d/pi, k_s/pi, c1, c2 or c3, then |n~^2 - 1|^2, n^2 - k^2 - 1, n k) ---------------------------


@device
def log_cos_and_light(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """(ln (N.H)^2, N.L)."""
    sxy2, sz, s2, _, _, _ = facet(lx, ly, lz, vx, vy, vz)
    return log_cos2(sxy2, sz, s2), lz


@of_columns(log_cos_and_light, 2)
def phong_highlight(log_square, lz, p):  # type: ignore[no-untyped-def]
    """s = (N.H)^c1."""
    _, k_s, c1 = p
    return k_s * cos_power(log_square, c1)


@of_columns(log_cos_and_light, 2)
def phong(log_square, lz, p):  # type: ignore[no-untyped-def]
    """(k_d + k_s s / cos(theta_i)) / pi."""
    diffuse, k_s_over_pi, c1 = p
    specular = k_s_over_pi * cos_power(log_square, c1)
    return diffuse + (specular / lz if specular > 0.0 else 0.0)


@device
def d2(alpha2, c2):  # type: ignore[no-untyped-def]
    """D2 = exp(-(alpha c2)^2)."""
    return exp2(alpha2 * (-_LOG2_E * c2 * c2))


@device
def d3(sxy2, s2, sz, c3):  # type: ignore[no-untyped-def]
    """D3 = [c3^2 / (cos^2(alpha) (c3^2 - 1) + 1)]^2, numerator and denominator, as 1/(cos^2 + sin^2/c3^2)."""
    root = sz * sz + sxy2 * (1.0 / (c3 * c3))
    return s2 * s2, root * root


@device
def torrance_sparrow(d_up, d_down, s2, sz, g, diffuse, weight, contrast, real, imag):  # type: ignore[no-untyped-def]
    """The BRDF for a distribution d_up/d_down: (k_d + k_s D F G/((N.E)(N.L))) / pi."""
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    up = weight * d_up * f_up * sz
    return diffuse + (up / ((d_down * f_down) * g) if up > 0.0 else 0.0)


@device
def torrance_sparrow_highlight(d_up, d_down, lz, vz, s2, sz, weight, contrast, real, imag):  # type: ignore[no-untyped-def]
    """s = D F G/(N.E), from a distribution d_up/d_down."""
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    g_up, g_down = groove_over_viewer(lz, vz, sz, s2)
    up = weight * d_up * f_up * g_up
    return up / ((d_down * f_down) * g_down) if up > 0.0 else 0.0


@of_columns(by_log_cos, 4, single_range=SINGLE_RANGE)
def brdf_d1(log_square, s2, sz, g, p):  # type: ignore[no-untyped-def]
    """With D1 = cos^c1(alpha)."""
    diffuse, weight, c1, contrast, real, imag = p
    return torrance_sparrow(cos_power(log_square, c1), 1.0, s2, sz, g, diffuse, weight, contrast, real, imag)


@of_columns(by_angle, 4, single_range=SINGLE_RANGE)
def brdf_d2(alpha2, s2, sz, g, p):  # type: ignore[no-untyped-def]
    """With D2 = exp(-(alpha c2)^2)."""
    diffuse, weight, c2, contrast, real, imag = p
    return torrance_sparrow(d2(alpha2, c2), 1.0, s2, sz, g, diffuse, weight, contrast, real, imag)


@of_columns(by_sxy2, 4, single_range=SINGLE_RANGE)
def brdf_d3(sxy2, s2, sz, g, p):  # type: ignore[no-untyped-def]
    """With D3, Trowbridge and Reitz's."""
    diffuse, weight, c3, contrast, real, imag = p
    d_up, d_down = d3(sxy2, s2, sz, c3)
    return torrance_sparrow(d_up, d_down, s2, sz, g, diffuse, weight, contrast, real, imag)


@device
def highlight_d1(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    _, weight, c1, contrast, real, imag = p
    sxy2, sz, s2, _, lz, vz = facet(lx, ly, lz, vx, vy, vz)
    d1 = cos_power(log_cos2(sxy2, sz, s2), c1)
    return torrance_sparrow_highlight(d1, 1.0, lz, vz, s2, sz, weight, contrast, real, imag)


@device
def highlight_d2(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    _, weight, c2, contrast, real, imag = p
    sxy2, sz, s2, _, lz, vz = facet(lx, ly, lz, vx, vy, vz)
    gaussian = d2(alpha_squared(sxy2, sz, s2), c2)
    return torrance_sparrow_highlight(gaussian, 1.0, lz, vz, s2, sz, weight, contrast, real, imag)


@device
def highlight_d3(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    _, weight, c3, contrast, real, imag = p
    sxy2, sz, s2, _, lz, vz = facet(lx, ly, lz, vx, vy, vz)
    d_up, d_down = d3(sxy2, s2, sz, c3)
    return torrance_sparrow_highlight(d_up, d_down, lz, vz, s2, sz, weight, contrast, real, imag)


_BRDFS: dict[str, Kernel] = {"phong": brdf_d1, "gaussian": brdf_d2, "trowbridge-reitz": brdf_d3}
_REAL: dict[str, Kernel] = {
    key: with_others(kernel, f"{kernel.__name__}_real", {fresnel: fresnel_real}) for key, kernel in _BRDFS.items()
}
_HIGHLIGHTS: dict[str, Kernel] = {"phong": highlight_d1, "gaussian": highlight_d2, "trowbridge-reitz": highlight_d3}


# --- models -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Phong(Model):
    """Phong's highlight in Blinn's form over a diffuse base.

    brdf = (k_d + k_s s / cos(theta_i)) / pi [1/sr], s = (N.H)^exponent. The paper gives intensities; dividing by pi
    and by cos(theta_i) makes k_d an albedo. Not reciprocal, and infinite at grazing incidence where s > 0.
    """

    k_d: float = parameter(0.5, "[0, 1]", "Diffuse albedo.", scale="linear")
    k_s: float = parameter(0.5, "[0, inf)", "Weight of the highlight.", scale="linear", bounds=(0.0, 1e4))
    exponent: float = parameter(
        50.0,
        "[0, inf)",
        "Blinn's c1: the larger, the narrower the highlight.",
        scale="log",
        bounds=(0.1, 1e6),
        geometry=True,
    )
    name: ClassVar[str] = "phong"
    rank: ClassVar[int] = 3
    in_sums: ClassVar[str] = "gloss"
    bases: ClassVar[tuple[str, ...]] = ("oren-nayar",)

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            return [
                {"k_d": min(levels.diffuse, 1.0), "k_s": min(levels.peak * scale, 100.0), "exponent": exponent}
                for exponent, scale in product((3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 10000.0), (0.3, 1.0))
            ]

        return replace(plain(cls.name, cls.fitted), starts=starts)

    @property
    def convention(self) -> str:
        return (
            "Phong in Blinn's 1977 form, s = (N.H)^c1; brdf = (k_d + k_s s/cos theta_i)/pi, "
            "neither reciprocal nor normalised."
        )

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return phong, (self.k_d / pi, self.k_s / pi, self.exponent)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        if self.k_s == 0.0:
            return np.full(theta.size, self.k_d)
        constants = (0.0, self.k_s / pi, self.exponent)
        *scales, reach = _scales("phong", self.exponent)
        return (
            hemispherical.over_facets(phong, constants, theta, viewer, scales=scales, reach=reach, tolerance=tolerance)
            + self.k_d
        )

    def highlight(
        self, theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike, *, out: Any = None
    ) -> Any:
        """Blinn's s = (N.H)^c1 without its weight; arguments as `brdf`."""
        return engine.over_angles(phong_highlight, (0.0, 1.0, self.exponent), theta_i, phi_i, theta_r, phi_r, out=out)


PRESETS: dict[str, Parameters] = {
    "aluminium": {"k_s": 0.4, "k_d": 0.6, "ior": 200.0, "distribution": "trowbridge-reitz", "c": 0.5},
    "magnesium oxide": {"k_s": 0.667, "k_d": 0.333, "ior": 1.8, "distribution": "trowbridge-reitz", "c": 0.35},
}
"""The parameter sets of Blinn's Fig. 7."""


@dataclass(frozen=True, init=False, repr=False)
class Blinn(Model):
    """Torrance and Sparrow's highlight as Blinn computes it, over a diffuse base.

    brdf = (k_d + k_s s / cos(theta_i)) / pi [1/sr], s = D F G/(N.E). D1 = cos^c1(a), D2 = exp(-(a c2)^2), D3 =
    [c3^2/(cos^2(a)(c3^2 - 1) + 1)]^2, all 1 at a = 0. c2 is a reciprocal width: the paper's text calls it a standard
    deviation. G/(N.E) is taken without dividing by a cosine. The paper gives intensities, and s is not normalised;
    with the division by cos(theta_i) the BRDF is reciprocal. At exactly grazing the limit along equal polar angles is
    returned: +inf in the mirror direction.
    """

    k_d: float = parameter(MISSING, "[0, 1]", "Diffuse albedo.", scale="linear")
    k_s: float = parameter(MISSING, "[0, inf)", "Weight of the highlight.", scale="linear", bounds=(0.0, 1e4))
    ior: Any = parameter(MISSING, *INDEX)
    distribution: str = parameter(
        MISSING, DISTRIBUTIONS, "The paper's D1 (phong), D2 (gaussian) or D3 (trowbridge-reitz)."
    )
    c: float = parameter(
        MISSING,
        "[0, inf)",
        "The distribution's coefficient: c1, c2, or c3, which is in (0, 1]; 0.5 without it.",
        scale="log",
        bounds=(0.001, 1.0),
        geometry=True,
    )
    fresnel: str = parameter(
        MISSING, ("exact", "1977"), '"1977" is Blinn\'s shortcut as printed, without its 1/2 (twice the reflectance).'
    )
    besides: ClassVar[Mapping[str, Parameter]] = {
        "beta_deg": row(None, "(0, 90)", "Instead of `c`: the angle from the normal where D falls to one half.", "deg")
    }
    name: ClassVar[str] = "blinn"
    rank: ClassVar[int] = 4
    assumes: ClassVar[str] = "facets that are large against the wavelength (Torrance and Sparrow 1967)"
    in_sums: ClassVar[str] = "gloss"
    bases: ClassVar[tuple[str, ...]] = ("oren-nayar",)
    has_ior: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            grid = product((0.03, 0.08, 0.15, 0.3, 0.5, 0.8), (0.03, 0.3, 1.0), (1.5, 5.0, 50.0))
            k_d = min(levels.diffuse, 1.0)
            return [{"k_d": k_d, "k_s": levels.peak * scale, "c": c, "ior": n} for c, scale, n in grid]

        return optical(cls.name, cls.fitted, ior, starts)

    def __init__(
        self,
        k_d: float = 0.6,
        k_s: float = 0.4,
        ior: Index = 200.0,
        distribution: str = "trowbridge-reitz",
        c: float | None = None,
        fresnel: str = "exact",
        *,
        beta_deg: float | None = None,
    ) -> None:
        if c is not None and beta_deg is not None:
            raise ArgumentError("c and beta_deg are both given: beta_deg stands instead of c")
        if beta_deg is not None:
            c = coefficient(distribution, math.radians(self.besides["beta_deg"].checked("beta_deg", beta_deg)))
        elif c is None:
            c = 0.5
        store(self, k_d=k_d, k_s=k_s, ior=ior, distribution=distribution, c=c, fresnel=fresnel)
        self.__post_init__()
        if self.distribution == "trowbridge-reitz":
            number("c", self.c, 1e-50, 1.0)

    @classmethod
    def preset(cls, preset: str, **changes: Any) -> Self:
        """One of the paper's parameter sets (`PRESETS`: "aluminium", "magnesium oxide"), with changes.

        Raises
        ------
        ArgumentError
            There is no such set (with the nearest name), or a change is out of range.
        """
        values = {**PRESETS[choice("preset", preset, tuple(PRESETS))], **changes}
        if "beta_deg" in changes:
            values.pop("c")
        return cls(**values)

    @property
    def convention(self) -> str:
        halved = "exact Fresnel reflectance" if self.fresnel == "exact" else "the 1977 Fresnel shortcut without its 1/2"
        return (
            f"Blinn 1977, {self.distribution} facets, {halved}; brdf = (k_d + k_s s/cos theta_i)/pi, s = D F G/(N.E), "
            "which is not normalised."
        )

    def _constants(self, wavelength_nm: float, k_d: float, k_s: float) -> Constants:
        twice = 2.0 if self.fresnel == "1977" else 1.0
        return (k_d, k_s * twice, self.c, *fresnel_constants(index_at(self.ior, wavelength_nm)))

    def facets(self, wavelength_nm: float) -> Facets:
        return Facets(index_at(self.ior, wavelength_nm), self.k_d / pi)

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        constants = self._constants(wavelength_nm, self.k_d / pi, self.k_s / pi)
        real = index_at(self.ior, wavelength_nm).imag == 0.0
        return (_REAL if real else _BRDFS)[self.distribution], constants

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The same for both sides, as the model is reciprocal."""
        if self.k_s == 0.0:
            return np.full(theta.size, self.k_d)
        kernel, (_, *constants) = self._evaluation(wavelength_nm)
        *scales, reach = _scales(self.distribution, self.c)
        lobe = hemispherical.over_facets(
            kernel,
            (0.0, *constants),
            theta,
            scales=scales,
            reach=reach,
            index=(constants[3], constants[4]),
            tolerance=tolerance,
        )
        return lobe + self.k_d

    def highlight(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
        out: Any = None,
    ) -> Any:
        """Blinn's s = D F G/(N.E) without its weight; arguments as `brdf`."""
        constants = self._constants(checked_wavelength(wavelength_nm), 0.0, 1.0)
        return engine.over_angles(_HIGHLIGHTS[self.distribution], constants, theta_i, phi_i, theta_r, phi_r, out=out)

    @staticmethod
    def textured_d3(cos_alpha: ArrayLike, c_min: float, t: ArrayLike) -> Any:
        """The distribution with a texture in c3 = c_min + (1 - c_min) t.

        D3 = [c_min c3/(cos^2(a)(c3^2 - 1) + 1)]^2, in which c_min^2 keeps one scale for the whole surface.

        Parameters
        ----------
        cos_alpha
            Cosine of the angle between the half-vector and the normal, in [0, 1].
        c_min
            The smallest c3 on the surface, in (0, 1].
        t
            The texture's value, in [0, 1]; broadcasts with `cos_alpha`.

        Raises
        ------
        ArgumentError
            An argument is NaN or out of range; the message names it.
        """
        least = number("c_min", c_min, 1e-50, 1.0)
        cosine, texture = engine.real_array("cos_alpha", cos_alpha), engine.real_array("t", t)
        for key, array in (("cos_alpha", cosine), ("t", texture)):
            if not bool(np.all((array >= 0.0) & (array <= 1.0))):
                raise ArgumentError(f"{key}: must lie in [0, 1]")
        engine.common_shape(("cos_alpha", "t"), [cosine.shape, texture.shape])
        c3 = least + (1.0 - least) * texture
        return (least * c3 / ((1.0 - cosine) * (1.0 + cosine) + (c3 * cosine) ** 2)) ** 2


def _scales(distribution: str, c: float) -> list[float]:
    """Angles from the normal [rad] where a distribution changes, and beyond the last of which nothing is left of it."""
    if distribution == "trowbridge-reitz":  # falls like the fourth power
        return [*(math.atan(c * 3.0**k) for k in range(math.ceil(math.log(10.0 / c, 3.0)))), pi / 2]
    if c == 0.0:
        return [pi / 2]
    if distribution == "gaussian":
        return [q / c for q in hemispherical.WIDTHS]
    # cos^c = exp(-q^2), by 1 - cos without cancellation
    return [2.0 * math.asin(math.sqrt(-0.5 * math.expm1(-q * q / c))) for q in hemispherical.WIDTHS]


def coefficient(distribution: str, beta: float) -> float:
    """The coefficient c1, c2 or c3 for which a distribution falls to one half at `beta` [rad], in (0, pi/2).

    Raises
    ------
    ArgumentError
        There is no such distribution (with the nearest name), or `beta` is out of range.
    """
    choice("distribution", distribution, DISTRIBUTIONS)
    if not 0.0 < beta < pi / 2:
        raise ArgumentError(f"beta_deg = {math.degrees(beta):g}: must lie between 0 and 90 deg")
    sin2 = math.sin(beta) ** 2
    if distribution == "phong":
        return -2.0 * math.log(2.0) / math.log1p(-sin2)
    if distribution == "gaussian":
        return math.sqrt(math.log(2.0)) / beta
    return math.sqrt(sin2 / ((math.sqrt(2.0) - 1.0) + sin2))
