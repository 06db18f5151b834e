"""Mirror facets whose slopes have a direction: anisotropic Trowbridge-Reitz (GGX) facets with Smith's shadowing.

Walter et al. 2007 have the distribution and Smith's function for it, Burley 2012 its two widths, Heitz 2014 the
height-correlated shadowing.
"""

import math
from dataclasses import dataclass
from itertools import product
from math import pi, sqrt
from typing import ClassVar

import numpy as np

from gonio.geometry import Directions
from gonio.models import hemispherical
from gonio.models._compile import device, with_others
from gonio.models._facets import OPPOSITE, fresnel, fresnel_constants, fresnel_real
from gonio.models._math import HALF_PI
from gonio.models.engine import Constants, Kernel
from gonio.models.fresnel import reflectance
from gonio.models.model import Model
from gonio.models.parameters import INDEX, Declaration, Index, Ior, Levels, Values, index_at, optical, parameter
from gonio.models.polarised import Facets
from gonio.typing import Floats

SAME_AZIMUTH_DEG = 2.0
"""Azimuths of incidence nearer than this, or half a turn apart, show one side of a surface with a direction."""


@device
def anisotropic(lx, ly, lz, vx, vy, vz, constants):  # type: ignore[no-untyped-def]
    """F D G_2/(4 (N.L)(N.V)) over a diffuse base.

    With s = L + V, q = s_1^2/a_1^2 + s_2^2/a_2^2 + s_z^2 and the projected areas A(V)^2 = v_z^2 + a_1^2 v_1^2 + a_2^2
    v_2^2 it is F |s|^4/(2 pi a_1 a_2 q^2 (l_z A(V) + v_z A(L))): finite where one direction is grazing.
    """
    diffuse, scale, contrast, real, imag, cos_b, sin_b, along, across, per_along, per_across = constants
    l1 = lx * cos_b + ly * sin_b
    l2 = ly * cos_b - lx * sin_b
    v1 = vx * cos_b + vy * sin_b
    v2 = vy * cos_b - vx * sin_b
    s1 = l1 + v1
    s2 = l2 + v2
    sz = lz + vz
    horizontal = s1 * s1 + s2 * s2
    square = horizontal + sz * sz
    apart = square >= OPPOSITE
    square = square if apart else 1.0
    # Walter2007 D over two widths: 1/(pi a_1 a_2 cos^4 (1 + tan^2 (cos^2 b/a_1^2 + sin^2 b/a_2^2))^2)
    q = s1 * s1 * per_along + s2 * s2 * per_across + sz * sz if apart else 1.0
    # Heitz2014 G_2 = 1/(1 + Lambda(L) + Lambda(V)), where 1 + 2 Lambda(V) = A(V)/v_z
    area_l = sqrt(lz * lz + along * l1 * l1 + across * l2 * l2)
    area_v = sqrt(vz * vz + along * v1 * v1 + across * v2 * v2)
    f_up, f_down = fresnel(0.25 * square if apart else 0.0, contrast, real, imag)
    up = scale * (square * square) * f_up
    down = (q * q) * (lz * area_v + vz * area_l) * f_down
    return diffuse + (up / down if up > 0.0 else 0.0)


_KERNELS: dict[str, Kernel] = {
    "exact": anisotropic,
    "real": with_others(anisotropic, "anisotropic_real", {fresnel: fresnel_real}),
}


def _brushed_along(values: Values) -> Values:
    """The same model with the smaller width along the brushing, whose azimuth lies within [-90, 90) degrees."""
    if not values.keys() >= {"alpha_along", "alpha_across", "brushing_deg"}:
        return values
    along, across, turn = values["alpha_along"], values["alpha_across"], values["brushing_deg"]
    turn += 90.0 * (along > across)
    narrow, wide = min(along, across), max(along, across)
    return {**values, "alpha_along": narrow, "alpha_across": wide, "brushing_deg": (turn + 90.0) % 180.0 - 90.0}


@dataclass(frozen=True, repr=False)
class AnisotropicFacets(Model):
    """Mirror facets with a direction over a diffuse base: brdf = s F D G_2/(4 (N.L)(N.V)) + (1 - s) albedo/pi [1/sr].

    D is the Trowbridge-Reitz (GGX) distribution with two widths (Walter 2007, Burley 2012), G_2 Smith's shadowing and
    masking, correlated in height (Heitz 2014), F the exact unpolarised reflectance for a complex index. It is
    reciprocal, and reflects no more than it receives. For brushed metal the slopes across the scratches are the
    larger: `alpha_along` < `alpha_across`. Turning the brushing by 90 degrees exchanges the two.
    """

    alpha_along: float = parameter(
        0.1,
        "[1e-50, 10]",
        "Width of the distribution of slopes along the brushing: the slope at which D cos^4 of the facet's angle has"
        " fallen to a quarter.",
        scale="log",
        bounds=(0.002, 3.0),
    )
    alpha_across: float = parameter(
        0.3, "[1e-50, 10]", "The same across the brushing.", scale="log", bounds=(0.002, 3.0)
    )
    brushing_deg: float = parameter(
        0.0,
        "[-1e6, 1e6]",
        "Azimuth of the brushing from the sample's x axis; 180 degrees more are the same.",
        "deg",
        scale="linear",
        bounds=(-180.0, 180.0),  # twice round, so that no direction of brushing lies at a bound
    )
    ior: Index = parameter("Al", *INDEX)
    s: float = parameter(1.0, "[0, 1]", "The share of the facets; 1 - s is that of the diffuse base.", scale="linear")
    diffuse_albedo: float = parameter(0.0, "[0, 1]", "The diffuse base's reflectance.", scale="linear")
    name: ClassVar[str] = "anisotropic"
    rank: ClassVar[int] = 7
    assumes: ClassVar[str] = "facets that are large against the wavelength (Walter et al. 2007)"
    in_sums: ClassVar[str] = "gloss"
    has_ior: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            indices = (1.5,) if ior is not None else (1.5, 20.0)
            grid = product((0.03, 0.1, 0.3), (1.5, 4.0), (-45.0, 0.0, 45.0, 90.0), (0.03, 0.2, 0.7), indices)
            return [
                {
                    "s": s,
                    "alpha_along": alpha,
                    "alpha_across": alpha * ratio,
                    "brushing_deg": brushing,
                    "diffuse_albedo": min(levels.diffuse / (1 - s), 1.0),
                    "ior": n,
                }
                for alpha, ratio, brushing, s, n in grid
            ]

        def flat(v: Values) -> Values:
            return {"diffuse_albedo": (1.0 - v["s"]) / math.pi}

        return optical(cls.name, {"s": cls.fitted["s"], **cls.fitted}, ior, starts, flat=flat, stated=_brushed_along)

    @classmethod
    def undetermined_by(cls, directions: Directions) -> str:
        tilted = directions.theta_i > math.radians(SAME_AZIMUTH_DEG)
        half_turns = np.exp(2j * directions.phi_i[tilted])  # azimuths half a turn apart are the same
        if np.any(np.abs(np.angle(half_turns / half_turns[:1])) > 2.0 * math.radians(SAME_AZIMUTH_DEG)):
            return ""
        return "the light comes from one azimuth, which does not tell a surface's own direction"

    @property
    def convention(self) -> str:
        return (
            "Trowbridge-Reitz (GGX) facets of two widths (Walter et al. 2007, Burley 2012), height-correlated Smith "
            "shadowing (Heitz 2014), exact Fresnel reflectance for n + ik; the sample's x axis is azimuth 0."
        )

    @property
    def depends_on_azimuth(self) -> bool:
        return self.alpha_along != self.alpha_across and self.s > 0.0

    def facets(self, wavelength_nm: float) -> Facets:
        return Facets(index_at(self.ior, wavelength_nm), (1.0 - self.s) * self.diffuse_albedo / pi)

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        ior = index_at(self.ior, wavelength_nm)
        turn, along, across = math.radians(self.brushing_deg % 180.0), self.alpha_along, self.alpha_across
        return _KERNELS["real" if ior.imag == 0.0 else "exact"], (
            (1.0 - self.s) * self.diffuse_albedo / pi,
            self.s / (2.0 * pi * along * across),
            *fresnel_constants(ior),
            math.cos(turn),
            math.sin(turn),
            along * along,
            across * across,
            1.0 / (along * along),
            1.0 / (across * across),
        )

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The same for both sides, as the model is reciprocal. Right to 1e-5 alone where n < 1 with hardly any k."""
        base = (1.0 - self.s) * self.diffuse_albedo
        if self.s == 0.0:
            return np.full(theta.size, base)
        ior = index_at(self.ior, wavelength_nm)
        if ior.real < 1.0 and ior.imag < 0.1:  # the onset of total reflection is a root, along no edge of the boxes
            tolerance = max(tolerance, 1e-5)
        turn = math.radians(self.brushing_deg % 180.0)
        lobe = np.array([self._lobe(t, p - turn, ior, tolerance) for t, p in zip(theta, phi, strict=True)])
        return self.s * lobe + base

    def _lobe(self, theta: float, phi: float, ior: complex, tolerance: float) -> float:
        """The integral of F D G_2/(4 N.V) for a direction V in the brushing's frame, over the facets' slopes.

        The slopes over their widths are tan(x) (cos g, sin g): D cos of the facet's angle is then sin(2 x) dx dg/(2
        pi) whatever the widths, and light leaves below the horizon beyond an x in closed form.
        """
        a1, a2 = self.alpha_along, self.alpha_across
        v1, v2 = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi)
        vz = max(math.cos(theta) if theta < HALF_PI else 0.0, 1e-9 * min(a1, a2))  # the limit toward grazing
        layer = min(max(vz * min(a1, a2), 1e-12), 0.3)
        area_v = math.sqrt(vz * vz + (a1 * v1) ** 2 + (a2 * v2) ** 2)

        def integrand(g: Floats, y: Floats) -> Floats:
            rest = layer**y  # the share of x that is left, where light leaves near the horizon, on a logarithmic scale
            share, stretch = (1.0 - rest) / (1.0 - layer), -math.log(layer) * rest / (1.0 - layer)
            e1, e2 = a1 * np.cos(g), a2 * np.sin(g)
            toward, steep = v1 * e1 + v2 * e2, e1 * e1 + e2 * e2
            root = np.sqrt(toward * toward + steep * vz * vz)
            # the last x: tan x = (toward + root)/(steep v_z), without cancellation
            last = np.where(toward > 0.0, np.arctan2(toward + root, steep * vz), np.arctan2(vz, root + np.abs(toward)))
            x = last * share
            sine, cosine = np.sin(x), np.cos(x)
            m1, m2 = sine * e1, sine * e2  # a vector along the facet's normal, with cosine as its z
            vm, mm = cosine * vz + sine * toward, cosine * cosine + sine * sine * steep
            l1, l2 = 2.0 * vm * m1 / mm - v1, 2.0 * vm * m2 / mm - v2
            lz = np.maximum(2.0 * vm * cosine / mm - vz, 0.0)
            area_l = np.sqrt(lz * lz + (a1 * l1) ** 2 + (a2 * l2) ** 2)
            facet = np.minimum(np.maximum(vm, 0.0) / np.sqrt(mm), 1.0)
            with np.errstate(invalid="ignore"):
                shown = np.where(lz > 0.0, 2.0 * lz / (lz * area_v + vz * area_l), 0.0)  # G_2/v_z
            return np.asarray(reflectance(facet, ior) * shown * vm * 2.0 * sine * last * stretch / (2.0 * pi))

        own = math.atan2(v2 * a2, v1 * a1) % HALF_PI
        quarters = np.unique([*(HALF_PI * np.arange(5.0)), *(own + HALF_PI * np.arange(4.0))])
        boxes = hemispherical.boxes(quarters, np.linspace(0.0, 1.0, 1 + math.ceil(-math.log(layer) / 3.0)))
        return hemispherical.adaptive(integrand, boxes, tolerance, f"{self.name}: {math.degrees(theta):.6g} deg")
