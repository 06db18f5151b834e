"""Oren and Nayar, "Generalization of Lambert's Reflectance Model", SIGGRAPH 1994: V-grooves of Lambertian facets."""

import math
from dataclasses import KW_ONLY, dataclass, replace
from itertools import product
from math import pi, sqrt
from typing import Any, ClassVar

from gonio.errors import ArgumentError
from gonio.models import hemispherical
from gonio.models._compile import device, of_columns
from gonio.models._groove_integral import gaussian_constants, gaussian_grooves, isotropic_grooves, parallel_grooves
from gonio.models._groove_slopes import mean_slope_constants, mean_slope_grooves
from gonio.models._math import atan_over_near
from gonio.models.engine import SPLIT, Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import ALBEDO, Declaration, Ior, flag, parameter, plain
from gonio.typing import Floats

FORMS = ("functional", "exact", "qualitative", "single-slope")
TWO_OVER_PI = 2.0 / pi
INFINITE = math.inf
FLAT = 1e-75  # smaller cosines, and products of sines below its square, count as this: their powers stay in range
STEEP = 1e60  # the functional form beyond this is infinite at exactly grazing


@device
def shares(tan_half, steep):  # type: ignore[no-untyped-def]
    """(2 theta/pi, 1 - 2 theta/pi) of a polar angle, both to the last place.

    `tan_half` is the tangent of half the angle or, where the angle is `steep`, of half its complement.
    """
    near = 2.0 * TWO_OVER_PI * tan_half * atan_over_near(tan_half * tan_half)
    far = 1.0 - near
    return far if steep else near, near if steep else far


@device
def angular_terms(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """What eqs. 14 and 15 make of the directions, for every sigma and rho.

    With dphi = phi_r - phi_i, and C_2 and C_3 without their functions of sigma: cos(dphi) C_2 tan(beta), then
    (1 - |cos(dphi)|) C_3 tan((alpha + beta)/2), and the braces of eq. 15, 1 - cos(dphi) (2 beta/pi)^2.
    """
    cos_i = lz if lz > FLAT else FLAT
    cos_r = vz if vz > FLAT else FLAT
    sin_i = sqrt(lx * lx + ly * ly)
    sin_r = sqrt(vx * vx + vy * vy)
    dot = lx * vx + ly * vy  # sin(theta_i) sin(theta_r) cos(dphi)
    cross = lx * vy - ly * vx  # sin(theta_i) sin(theta_r) sin(dphi)
    # alpha = max(theta_r, theta_i), beta = min(theta_r, theta_i)
    cos_alpha = cos_i if cos_i < cos_r else cos_r
    cos_beta = cos_r if cos_i < cos_r else cos_i
    sin_alpha = sin_i if sin_i > sin_r else sin_r
    sin_beta = sin_r if sin_i > sin_r else sin_i
    # tan(x/2) = sin(x)/(1 + cos(x)); of a steep angle that of half its complement, cos(x)/(1 + sin(x))
    steep_alpha = cos_alpha < sin_alpha
    steep_beta = cos_beta < sin_beta
    half_alpha = 1.0 + (sin_alpha if steep_alpha else cos_alpha)
    half_beta = 1.0 + (sin_beta if steep_beta else cos_beta)
    # one division for all: the reciprocals of the three products follow from that of their product
    sines = sin_i * sin_r
    sines_1_cos = sines + abs(dot)  # sin(theta_i) sin(theta_r) (1 + |cos(dphi)|)
    azimuth = sines * sines_1_cos
    azimuth = azimuth if azimuth > FLAT * FLAT else FLAT * FLAT  # at normal incidence the azimuth has no effect
    halves = half_alpha * half_beta
    sum_cos = cos_alpha + cos_beta
    cosines = cos_beta * sum_cos
    inverse = 1.0 / (azimuth * (halves * cosines))
    per_azimuth = inverse * (halves * cosines)
    per_polar = inverse * azimuth  # 1/(halves cosines)
    per_sines = per_azimuth * sines_1_cos
    cos_dphi = dot * per_sines
    cos_dphi = cos_dphi if cos_dphi < 1.0 else 1.0
    cos_dphi = cos_dphi if cos_dphi > -1.0 else -1.0
    sin_dphi = cross * per_sines
    per_halves = per_polar * cosines
    tan_half_alpha = (cos_alpha if steep_alpha else sin_alpha) * half_beta * per_halves
    tan_half_beta = (cos_beta if steep_beta else sin_beta) * half_alpha * per_halves
    alpha_share, _ = shares(tan_half_alpha, steep_alpha)  # 2 alpha/pi
    beta_share, beta_rest = shares(tan_half_beta, steep_beta)  # 2 beta/pi, 1 - 2 beta/pi
    per_cosines = per_polar * halves
    # eq. 14, C_2: sin(alpha), less (2 beta/pi)^3 where cos(dphi) < 0
    one_sin_alpha = cos_alpha * tan_half_alpha if steep_alpha else 1.0 - sin_alpha  # 1 - sin(alpha)
    mirror_side = beta_rest * (3.0 - beta_rest * (3.0 - beta_rest)) - one_sin_alpha  # sin(alpha) - (2 beta/pi)^3
    c2_term = (dot if dot >= 0.0 else cos_dphi * mirror_side * sin_beta) * (per_cosines * sum_cos)
    # eq. 14, C_3: 1 - |cos(dphi)| = sin^2(dphi)/(1 + |cos(dphi)|)
    sin2_dphi = sin_dphi * sin_dphi
    sin2_dphi = sin2_dphi if sin2_dphi > 1e-30 else 0.0
    tan_mean = (sin_alpha + sin_beta) * (per_cosines * cos_beta)  # tan((alpha + beta)/2)
    off_plane = sin2_dphi * (sines * sines * per_azimuth) * tan_mean
    c3_term = (alpha_share * beta_share) * (alpha_share * beta_share) * off_plane
    # eq. 15
    interreflection = 1.0 - cos_dphi * beta_share * beta_share
    return c2_term, c3_term, interreflection


@of_columns(angular_terms, 3)
def functional(c2_term, c3_term, interreflection, p):  # type: ignore[no-untyped-def]
    """Eqs. 14 to 16, with s2 = sigma^2.

    p: rho/pi times C_1, times 0.45 s2/(s2 + 0.09), times 0.125 s2/(s2 + 0.09), and 0.17 rho^2/pi s2/(s2 + 0.13).
    """
    c1, c2, c3, twice = p
    value = c1 + c2 * c2_term + c3 * c3_term + twice * interreflection
    return value if value < STEEP else INFINITE


@device
def functional_constants(albedo, sigma, bounces):  # type: ignore[no-untyped-def]
    """What `functional` takes of its parameters; sigma [rad], and 1 with interreflection or 0 without."""
    s2, once = sigma * sigma, albedo / pi
    narrow = s2 / (s2 + 0.09)
    return (
        once * (1.0 - 0.5 * s2 / (s2 + 0.33)),
        once * 0.45 * narrow,
        once * 0.125 * narrow,
        0.17 * albedo * (once * bounces) * s2 / (s2 + 0.13),
    )


@device
def qualitative(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """Eq. 17, rho/pi (A + B max(0, cos(dphi)) sin(alpha) tan(beta)); p as `functional`."""
    a, b, _, _ = p  # A and B times rho/pi
    dot = lx * vx + ly * vy  # sin(alpha) sin(beta) cos(dphi)
    cos_beta = lz if lz > vz else vz
    return a + (b * dot / cos_beta if dot > 0.0 and b > 0.0 else 0.0)


_KERNELS: dict[str, Kernel] = {"functional": functional, "qualitative": qualitative, "exact": gaussian_grooves}


@dataclass(frozen=True, repr=False)
class OrenNayar(Model):
    """Lambertian facets in V-grooves, with shadowing, masking and light that goes twice.

    "exact": the integral over facets (eqs. 4 to 13) with two bounces, its relative error at most 1e-8, also with
    `mean_slope_deg` (sec. 3.3: P = c exp(-(theta_a - mu)^2/(2 sigma^2)) on 0 to 90 degrees). "functional":
    the paper's fit to it (eqs. 14 to 16). "qualitative": the fit without its minor terms (eq. 17, without
    interreflection). "single-slope": facets of one slope, in every direction (eq. 12) or, with `groove_azimuth_deg`,
    in parallel grooves (sec. 3.1). All are reciprocal and give Lambert's law for sigma = 0.

    The functional form is the paper's, and negative near forward grazing for sigma above about 42 degrees. Where both
    directions are exactly grazing the limit along equal polar angles is returned; it is infinite except in the
    forward direction.
    """

    albedo: float = parameter(0.9, "[0, 1]", "Albedo of the facets.", scale="linear", bounds=ALBEDO)
    sigma_deg: float = parameter(
        30.0,
        "[0, 90)",
        'Standard deviation of the facets\' angles; not used by "single-slope".',
        "deg",
        scale="linear",
        bounds=(0.0, 60.0),
        geometry=True,
    )
    form: str = parameter("functional", FORMS, "Which of the paper's forms.")
    _: KW_ONLY
    slope_deg: float | None = parameter(
        None,
        "[0, 89.9999]",
        'Angle between the facets and the surface: "single-slope" only, and required there.',
        "deg",
    )
    groove_azimuth_deg: float | None = parameter(
        None,
        "[-1e6, 1e6]",
        "Azimuth of the facets' normals, across the grooves (the paper's phi_a); None for grooves in every direction.",
        "deg",
    )
    mean_slope_deg: float = parameter(
        0.0,
        "[0, 89.9999]",
        'Mean of the facets\' angles, about which sigma_deg spreads them: "exact" only.',
        "deg",
        scale="linear",
        bounds=(0.0, 60.0),
        geometry=True,
    )
    interreflections: bool = parameter(True, flag, "Whether light that goes twice counts.")
    name: ClassVar[str] = "oren-nayar"
    rank: ClassVar[int] = 2
    assumes: ClassVar[str] = "facets that are large against the wavelength (Oren and Nayar 1994, sec. 2)"
    in_sums: ClassVar[str] = "base"

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        """See `Model.declaration`; `--free mean_slope_deg --fix form=exact` fits facets whose angles have a mean."""
        flat = {"mean_slope_deg": 0.0}
        return replace(
            plain(cls.name, cls.fitted),
            free=("albedo", "sigma_deg"),
            starts=lambda levels: [
                {"albedo": cls.fitted["albedo"].inside(scale * levels.median), "sigma_deg": sigma, **flat}
                for scale, sigma in product((0.5, 1.0, 1.3), (5.0, 25.0, 45.0))
            ],
            base_starts=lambda albedo: [{"albedo": albedo, "sigma_deg": 20.0, **flat}],
        )

    def __post_init__(self, *_: Any) -> None:
        super().__post_init__()
        for key in ("slope_deg", "groove_azimuth_deg"):
            if getattr(self, key) is not None and self.form != "single-slope":
                raise ArgumentError(f'{key} belongs to form="single-slope", not to "{self.form}"')
        if self.mean_slope_deg > 0.0 and self.form != "exact":
            raise ArgumentError(f'mean_slope_deg belongs to form="exact", not to "{self.form}"')
        if self.form == "single-slope" and self.slope_deg is None:
            raise ArgumentError('form="single-slope" needs slope_deg')

    @property
    def convention(self) -> str:
        what = {
            "exact": "exact V-groove integral (eqs. 4 to 13)",
            "functional": "functional approximation (eqs. 14 to 16)",
            "qualitative": "qualitative model (eq. 17)",
            "single-slope": "facets of one slope (sec. 3.1 and eq. 12)",
        }[self.form]
        twice = "with" if self.interreflections and self.form != "qualitative" else "without"
        return f"Oren and Nayar 1994, {what}, {twice} interreflection; sigma in radians in the formulas, C1 with 0.33."

    @property
    def grain(self) -> int:  # type: ignore[override]
        """How many evaluations are worth a thread of their own."""
        return SPLIT if self.form in ("functional", "qualitative") else 64

    @property
    def depends_on_azimuth(self) -> bool:
        return self.groove_azimuth_deg is not None

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        once = self.albedo / pi
        twice = once if self.interreflections else 0.0
        if self.form == "single-slope":
            assert self.slope_deg is not None
            slope = math.radians(self.slope_deg)
            if self.groove_azimuth_deg is None:
                return isotropic_grooves, (once, twice, math.tan(slope), math.cos(slope))
            azimuth = math.radians(self.groove_azimuth_deg)
            return parallel_grooves, (
                once,
                twice,
                math.tan(slope),
                math.cos(slope),
                math.cos(azimuth),
                math.sin(azimuth),
            )
        sigma = math.radians(self.sigma_deg)
        if self.form == "exact":
            mean = math.radians(self.mean_slope_deg)
            if sigma < 1e-9:  # one slope to the last digit
                return isotropic_grooves, (once, twice, math.tan(mean), math.cos(mean))
            if mean > 0.0:
                return mean_slope_grooves, (once, twice, *mean_slope_constants(sigma, mean))
            return gaussian_grooves, (once, twice, *gaussian_constants(sigma))
        return _KERNELS[self.form], functional_constants(self.albedo, sigma, float(self.interreflections))

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """The same for both sides, as the model is reciprocal; to 1e-6 for the forms whose kinks lie anywhere."""
        tolerance = max(tolerance, 1e-6) if self.form in ("exact", "single-slope") else tolerance
        even = self.groove_azimuth_deg is None
        return hemispherical.over_directions(self, theta, phi, wavelength_nm, viewer, even=even, tolerance=tolerance)
