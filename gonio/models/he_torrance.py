"""He, Torrance, Sillion and Greenberg (1991): a comprehensive physical model for light reflection."""

import math
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import numpy as np

from gonio.models import _htsg_kernels as kernels
from gonio.models import engine
from gonio.models._compile import loop
from gonio.models._facets import fresnel_constants
from gonio.models._hemisphere import about_mirror, about_source
from gonio.models._htsg_series import TIERS
from gonio.models._math import HALF_PI
from gonio.models.engine import Constants, Kernel
from gonio.models.hemispherical import COARSE_RULES, COARSE_TOLERANCE, TOLERANCE
from gonio.models.model import Model
from gonio.models.parameters import (
    INDEX,
    Declaration,
    Index,
    Ior,
    Levels,
    Values,
    checked_wavelength,
    index_at,
    number,
    optical,
    parameter,
)
from gonio.models.polarised import Facets
from gonio.typing import ArrayLike, Floats, NDArray

LARGEST_UM = 1e12
"""Largest roughness and correlation length [um]; the inverse is the smallest correlation length. Beyond these the
constants of the series leave the range of floating-point numbers."""
STEEP = 0.25
"""Mean square slope above which slopes are not gentle. At it the lobe of a perfect reflector has lost a third of the
light at normal incidence: what meets the surface twice is not in it."""
ORDERS = (4, 6, 8, 12, 18, 27, 40)
"""Orders of the rules that integrate the lobe over the hemisphere, one after the other."""


@dataclass(frozen=True)
class HeTorrance(Model):
    """A Gaussian random surface seen by physical optics: specular spike, directional diffuse lobe and uniform diffuse.

    ``brdf`` holds the lobe (He1991 eq. 71) and ``diffuse_albedo / pi``; the spike's reflectivity is
    `specular_reflectivity`, and `gonio.instrument` spreads it over an instrument's cones.

    Notes
    -----
    At exactly grazing (cos theta = 0) the effective roughness is 0 in the limit, reached like 1/sqrt(ln), and with it
    the lobe and the spike's reflectivity.
    """

    sigma0_um: float = parameter(
        0.28,
        f"[0, {LARGEST_UM:g}]",
        "Rms roughness; at 0 the lobe is 0 and the spike that of a smooth surface.",
        "um",
        scale="log",
        bounds=(1e-4, 100.0),
        geometry=True,
    )
    tau_um: float = parameter(
        1.77,
        f"[{1.0 / LARGEST_UM:g}, {LARGEST_UM:g}]",
        "Correlation length of the Gaussian autocorrelation exp(-r^2/tau^2).",
        "um",
        scale="log",
        bounds=(1e-3, 1e4),
        geometry=True,
    )
    ior: Index = parameter(0.77 + 6.08j, *INDEX)
    diffuse_albedo: float = parameter(
        0.0,
        "[0, 1]",
        "Albedo of the uniform diffuse part: the paper's a(lambda), whose BRDF is a/pi (the print's eq. 72 leaves the"
        " pi out).",
        scale="linear",
    )
    shadowing: str = parameter(
        "smith",
        ("smith", "paper"),
        '"smith": eq. 25 with the factor exp(-h^2) that the print lacks; "paper": as printed.',
    )
    tolerance: float = parameter(
        1e-12,
        f"[{min(TIERS):g}, inf)",
        "Largest relative error (times 1 + conditioning) of the series: the cheapest of the evaluations for 1e-12, 1e-9"
        " and 1e-6 that holds it is taken.",
    )
    name: ClassVar[str] = "he-torrance"
    rank: ClassVar[int] = 6
    in_sums: ClassVar[str] = "weighted gloss"
    bases: ClassVar[tuple[str, ...]] = ("lambert", "oren-nayar")
    has_ior: ClassVar[bool] = True
    grain: ClassVar[int] = 8192

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            wave, albedo = levels.wavelength_um, min(levels.diffuse, 1.0)
            roughness = (0.01, 0.03, 0.06, 0.1, 0.16, 0.25, 0.4, 0.6, 1.0, 2.0, 5.0)
            slope = (0.02, 0.05, 0.1, 0.17, 0.25, 0.35, 0.5, 0.8, 1.3)
            indices = (1.5,) if ior is not None else (1.3, 1.5, 3.0, 20.0)
            return [
                {"sigma0_um": r * wave, "tau_um": 2 * r * wave / m, "diffuse_albedo": albedo, "ior": n}
                for r, m, n in product(roughness, slope, indices)
            ]

        return optical(
            cls.name,
            cls.fitted,
            ior,
            starts,
            needs_wavelength=True,
            flat=lambda v: {"diffuse_albedo": 1.0 / math.pi},
            derived=lambda v: {"slope_m": 2.0 * v["sigma0_um"] / v["tau_um"]},
        )

    def outside(self, wavelength_nm: float) -> str:
        """Which of the paper's conditions fail: the tangent plane (sec. 2.2) and gentle slopes (sec. 3.1).

        Notes
        -----
        The surface's heights have the autocorrelation sigma0^2 exp(-r^2/tau^2). Its derivatives at r = 0 are the mean
        squares of slope and curvature along a line: <z'^2> = 2 (sigma0/tau)^2 and <z''^2> = 12 sigma0^2/tau^4. The
        paper asks for a radius of curvature that is large against the wavelength, and for <z'^2> much below 1. It
        states no number; said is what breaks a condition by any reading: a radius tau^2/(2 sqrt(3) sigma0) below one
        wavelength, and a mean square slope above `STEEP`.
        """
        if self.sigma0_um == 0.0:
            return ""
        ratio, said = self.sigma0_um / self.tau_um, []
        radius, wave = self.tau_um / (2.0 * math.sqrt(3.0) * ratio), 1e-3 * wavelength_nm
        if radius < wave:
            said.append(
                f"the surface's radius of curvature, tau^2/(2 sqrt(3) sigma0) = {radius:.2g} um, has to be large"
                f" against the wavelength of {wave:.3g} um"
            )
        if 2.0 * ratio**2 > STEEP:
            said.append(f"its mean square slope, 2 (sigma0/tau)^2 = {2.0 * ratio**2:.2g}, has to be small against 1")
        return " and ".join(said) + " (He et al. 1991, secs. 2.2 and 3.1)" * bool(said)

    @property
    def convention(self) -> str:
        shadow = "Smith's shadowing" if self.shadowing == "smith" else "shadowing as printed in eq. 25"
        return f"He-Torrance 1991, unpolarised (eqs. 69-86), {shadow}, a(lambda) as an albedo: brdf = lobe + a/pi."

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return kernels.lobe_state, self._constants(wavelength_nm)

    def _constants(self, wavelength_nm: float) -> Constants:
        k0 = 2.0 * math.pi / (wavelength_nm * 1e-3)  # rad/um
        index = fresnel_constants(index_at(self.ior, wavelength_nm))
        tier = sum(self.tolerance >= limit for limit in TIERS) - 1
        return (
            self.diffuse_albedo / math.pi,
            *kernels.surface_constants(k0, self.sigma0_um, self.tau_um),
            float(self.shadowing == "paper"),
            *index,
            float(tier),
            0.0,  # 1: without Fresnel
        )

    def _spectra(self, arguments: list[Floats], waves: list[float]) -> Floats:
        several = [self._constants(wave) for wave in waves]
        diffuse, _, _, _, slope, printed, _, _, _, tier, _ = several[0]
        shared = (diffuse, slope, printed, tier)
        each = np.array([[scale, phase, width, *index] for _, scale, phase, width, _, _, *index, _, _ in several])
        pairs = arguments[0].size // (3 if len(arguments) == 2 else 1)
        loop_over = kernels.spectrum_over_vectors if len(arguments) == 2 else kernels.spectrum_over_angles
        flat = [part for array in arguments for part in (np.ascontiguousarray(array).reshape(-1), 1)]
        out = np.empty((len(waves), pairs))
        run = loop(loop_over, kernels.pair_state, len(shared))
        numbers, target = each.reshape(-1), out.reshape(-1)
        split = max(1, self.grain // len(waves))
        if pairs and engine.in_parts(lambda i, j: run(*flat, pairs, shared, numbers, target, i, j), pairs, split):
            raise engine.explain(arguments)
        return out

    # --- the specular spike -------------------------------------------------------------------------------------

    def _spike(self, theta: Floats, wavelength_nm: float) -> Floats:
        """rho_s (He1991 eq. 73), for unpolarised light."""
        constants = self._constants(wavelength_nm)
        out = np.empty(theta.size)
        run = loop(kernels.over_thetas, kernels.spike_reflectivity, len(constants))
        engine.in_parts(lambda i, j: run(theta, constants, out, i, j), theta.size)
        return out

    def facets(self, wavelength_nm: float) -> Facets:
        return Facets(index_at(self.ior, wavelength_nm), self.diffuse_albedo / math.pi)

    # --- polarisation -------------------------------------------------------------------------------------------

    def mueller(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
        out: Floats | None = None,
    ) -> Floats:
        """Mueller matrix of the BRDF [1/sr], lobe and uniform diffuse (which depolarises), He1991 eqs. 59-68.

        Parameters
        ----------
        theta_i, phi_i, theta_r, phi_r
            Directions as in `brdf` [rad].
        wavelength_nm
            Wavelength [nm].

        Returns
        -------
        float64 array (..., 4, 4). Stokes vectors are I = |E_s|^2 + |E_p|^2, Q = |E_s|^2 - |E_p|^2, U = 2 Re(E_s E_p*),
        V = i (E_s E_p* - E_p E_s*), fields exp(-i omega t), on the bases s = k x z / |k x z| (at normal incidence the
        limit at the given azimuth), p = s x k, k the direction in which the light travels.

        Raises
        ------
        ArgumentError
            As `brdf`.
        """
        constants = self._constants(checked_wavelength(wavelength_nm))
        bare = (0.0, *constants[1:10], 1.0)  # the lobe without Fresnel
        arrays, shape = engine.angle_arrays(theta_i, phi_i, theta_r, phi_r)
        lobe = np.asarray(engine.over_angles(kernels.lobe_state, bare, *arrays, split=self.grain))
        flat = [part for array in arrays for part in engine.flat(array, shape, lobe.size)]
        engine.checked_out(out, (*shape, 4, 4))
        values = np.empty((*shape, 4, 4))
        run = loop(kernels.mueller_over_angles, kernels.jones, len(constants))
        factor, target = lobe.reshape(-1), values.reshape(-1)
        engine.in_parts(lambda i, j: run(*flat, constants, factor, target, i, j), lobe.size, self.grain)
        return np.asarray(engine.delivered(out, values))

    def jones(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
    ) -> NDArray[np.complex128]:
        """Jones matrix `J[e_r][e_i]` of one facet, on the bases of `mueller`: E_r = J E_i up to a common phase.

        Parameters
        ----------
        theta_i, phi_i, theta_r, phi_r
            Directions as in `brdf` [rad].
        wavelength_nm
            Wavelength [nm].

        Returns
        -------
        complex128 array (..., 2, 2): rows s, p of the reflected field, columns s, p of the incident one. For exactly
        retro-reflecting or mirror geometry and at normal incidence these are the limits.
        """
        constants = self._constants(checked_wavelength(wavelength_nm))
        arrays, shape = engine.angle_arrays(theta_i, phi_i, theta_r, phi_r)
        engine.check_angles(arrays)
        angles = np.stack(np.broadcast_arrays(*arrays)).reshape(4, -1)
        out = np.empty((*shape, 2, 2, 2))
        run = loop(kernels.jones_over_angles, kernels.jones, len(constants))
        run(angles[0], angles[2], angles[3] - angles[1], constants, out.reshape(-1), 0, angles.shape[1])
        return np.asarray(out.view(np.complex128)[..., 0])

    # --- energy -------------------------------------------------------------------------------------------------

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """Lobe and diffuse part; the model is reciprocal, so that the side does not count."""
        return self._lobe(theta, wavelength_nm, tolerance) + self.diffuse_albedo

    def _lobe(self, theta: Floats, wavelength_nm: float, tolerance: float = TOLERANCE) -> Floats:
        constants = (0.0, *self._constants(wavelength_nm)[1:])
        each, place = np.unique(theta, return_inverse=True)
        return np.array([self._lobe_hemispherical(t, constants, tolerance) for t in each])[place]

    def _lobe_hemispherical(self, theta: float, constants: Constants, tolerance: float) -> float:
        """The integral of lobe * cos(theta_r): two rules agree to a tenth of `tolerance`, and the better one counts."""
        _, scale, _, width, slope, _, _, rise, *_ = constants
        if theta >= HALF_PI or scale == 0.0:
            return 0.0
        narrow = min(0.25, 1.0 / math.sqrt(1.0 + 4.0 * width))  # 1/(k0 tau)
        critical = math.asin(math.sqrt(1.0 + rise)) if -1.0 < rise < 0.0 else None  # 0 < Re n^2 < 1
        omega_i = np.array([math.sin(theta), 0.0, math.cos(theta)])
        before = math.inf
        for order in ORDERS[0 if tolerance > COARSE_TOLERANCE else COARSE_RULES :]:
            omega_r, weight = (
                about_mirror(theta, narrow, slope, order)
                if critical is None
                else about_source(theta, narrow, critical, order)
            )
            lobe = engine.over_vectors(kernels.lobe_state, constants, omega_i, omega_r, split=self.grain)
            total = float(np.vdot(lobe, weight))
            if abs(total - before) <= 0.1 * tolerance * abs(total):
                break
            before = total
        return total

    def max_diffuse_albedo(self, *, wavelength_nm: float = 550.0, theta_max_deg: float = 90.0) -> float:
        """The largest a(lambda) that keeps energy: max(0, 1 - largest first-surface reflectance up to `theta_max_deg`).

        Parameters
        ----------
        wavelength_nm
            Wavelength [nm].
        theta_max_deg
            Largest polar angle of the source that counts [deg], in [0, 90].

        Returns
        -------
        An albedo in [0, 1]. It is reported and never enforced: the paper's own Figs. 9, 11 and 14 exceed it.
        """
        wave = checked_wavelength(wavelength_nm)
        top = math.radians(number("theta_max_deg", theta_max_deg, 0.0, 90.0, unit="deg"))
        grid = np.linspace(0.0, top, 46)
        first = self._lobe(grid, wave) + self._spike(grid, wave)
        best = int(np.argmax(first))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
        grid = np.linspace(low, high, 33)
        finer = self._lobe(grid, wave) + self._spike(grid, wave)
        return max(0.0, 1.0 - float(max(first.max(), finer.max())))
