"""Cook and Torrance, "A Reflectance Model for Computer Graphics" (Cook1982).

The paper's equations have no numbers: they stand here in the paper's order, under its sections and in its symbols, and
are cited by the letter on their left, as `Cook1982 R_s`. Vectors L, V and N = z have unit length.
"""

from collections.abc import Callable, Sequence

import numpy as np

from gonio.models.plain import fresnel
from gonio.models.plain.vectors import N, Numbers, Vectors, dot, polar, unit

PI = np.pi


# --- The reflectance model ------------------------------------------------------------------------------------------


def H(L: Vectors, V: Vectors) -> Vectors:
    """Cook1982 H: the unit vector halfway between light and viewer; 0/0 where they are opposite.

    Compiled: gonio.models._facets.facet
    """
    return unit(np.asarray(V) + L)


def E_i(I_i: Numbers, L: Vectors, domega_i: Numbers) -> Numbers:
    """Cook1982 E_i: the energy in an incoming beam of intensity I_i.

    Compiled: none, a definition
    """
    return I_i * dot(N, L) * domega_i


def R_of_intensities(I_r: Numbers, E_i: Numbers) -> Numbers:
    """Cook1982 R = I_r/E_i: the bidirectional reflectance, by its definition [1/sr].

    Compiled: none, a definition
    """
    return I_r / E_i


def I_r_of_one_light(R: Numbers, I_i: Numbers, L: Vectors, domega_i: Numbers) -> Numbers:
    """Cook1982 I_r = R E_i: the intensity that one light causes.

    Compiled: none, for a renderer
    """
    return R * I_i * dot(N, L) * domega_i


def R(s: float, R_s: Numbers, d: float, R_d: Numbers) -> Numbers:
    """Cook1982 R = s R_s + d R_d, s + d = 1: the bidirectional reflectance [1/sr].

    Compiled: gonio.models.CookTorrance.brdf
    """
    return s * R_s + d * R_d


def I_ra(R_a: Numbers, I_ia: Numbers, f: float = 1) -> Numbers:
    """Cook1982 I_ra = R_a I_ia f: the intensity that ambient light causes.

    Compiled: none, for a renderer
    """
    return R_a * I_ia * f


def R_a(R: Callable[[Numbers, Numbers], Numbers], nodes: int = 64) -> Numbers:
    """Cook1982 R_a: the ambient reflectance, the integral of R (N.L) over the hemisphere of light.

    `R` is a function of theta_i and phi_i; product of Gauss and the midpoint rule, for lobes wider than pi/nodes. The
    paper's figures take R_a = pi R_d instead.

    Compiled: gonio.models.CookTorrance.ambient_reflectance
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    theta = PI / 4 * (1 + x)[:, np.newaxis]
    phi = PI / nodes * (np.arange(2 * nodes) + 0.5)
    over_phi = np.sum(R(theta, phi), axis=1) * PI / nodes
    return np.sum(over_phi * np.cos(theta[:, 0]) * np.sin(theta[:, 0]) * w) * PI / 4


def f(unblocked: Callable[[Numbers, Numbers], Numbers], nodes: int = 1000) -> Numbers:
    """Cook1982 f: the unblocked fraction of the hemisphere, (1/pi) times the integral of (N.L) over what is unblocked.

    `unblocked` is a function of theta and phi, true where the light comes through; midpoint rule in sin^2(theta), good
    to 1/nodes.

    Compiled: none, ambient light is not shadowed in scenes.
    """
    middle = (np.arange(nodes) + 0.5) / nodes
    theta, phi = np.arcsin(np.sqrt(middle))[:, np.newaxis], 2 * PI * middle  # (N.L) domega = d(sin^2 theta)/2 dphi
    return np.mean(np.where(unblocked(theta, phi), 1.0, 0.0))


def I_r(I_ia: Numbers, R_a: Numbers, lights: Sequence[tuple[Numbers, Vectors, Numbers, Numbers]]) -> Numbers:
    """Cook1982 I_r: the intensity of ambient light and all sources, (I_i, L, domega_i, R) each, with f = 1.

    Compiled: none, for a renderer
    """
    return I_ia * R_a + sum(I_r_of_one_light(R, I_i, L, domega_i) for I_i, L, domega_i, R in lights)


# --- Directional distribution of the reflected light ----------------------------------------------------------------


def R_s(F: Numbers, D: Numbers, G: Numbers, L: Vectors, V: Vectors) -> Numbers:
    """Cook1982 R_s = (F/pi) D G/((N.L)(N.V)): the specular part, as printed [1/sr].

    With the D of `D_beckmann` this is four times too large: a perfect mirror's facets would reflect 400 % of light at
    normal incidence. The workbench's convention "normalised" is a quarter of it.

    Compiled: gonio.models.CookTorrance.specular, gonio.models.cook_torrance.beckmann
    """
    return F / PI * D * G / (dot(N, L) * dot(N, V))


def G(L: Vectors, V: Vectors) -> Numbers:
    """Cook1982 G: the geometrical attenuation of V-grooves; its three cases are Blinn1977's.

    Compiled: gonio.models._facets.facet
    """
    h = H(L, V)
    masked = 2 * dot(N, h) * dot(N, V) / dot(V, h)
    shadowed = 2 * dot(N, h) * dot(N, L) / dot(V, h)
    return np.minimum(1.0, np.minimum(masked, shadowed))


def D_gaussian(alpha: Numbers, m: float, c: float = 1.0) -> Numbers:
    """Cook1982 D = c exp(-(alpha/m)^2): Gaussian facets; the constant c is arbitrary, 1 in the workbench.

    Compiled: gonio.models.cook_torrance.gaussian_slopes
    """
    return c * np.exp(-((alpha / m) ** 2))


def D_beckmann(alpha: Numbers, m: float) -> Numbers:
    """Cook1982 D = exp(-(tan alpha/m)^2)/(m^2 cos^4 alpha): Beckmann's facets (Beckmann1963).

    m is the total rms slope, sqrt(2) times the one along a line, and 2 sigma0/tau of He1991. The integral of
    D cos(alpha) over the hemisphere is pi.

    Compiled: gonio.models.cook_torrance.beckmann
    """
    return np.exp(-((np.tan(alpha) / m) ** 2)) / (m**2 * np.cos(alpha) ** 4)


def D(
    alpha: Numbers, slopes: Sequence[tuple[float, float]], distribution: Callable[[Numbers, float], Numbers]
) -> Numbers:
    """Cook1982 D = sum of w_j D(m_j): several scales of roughness, pairs (m_j, w_j), with weights that sum to 1.

    Compiled: gonio.models.cook_torrance.gaussian_slopes
    """
    return sum(w * distribution(alpha, m) for m, w in slopes)


# --- Spectral composition of the reflected light --------------------------------------------------------------------


def spectral_energy(illuminant: Numbers, reflectance: Numbers) -> Numbers:
    """Cook1982 Fig. 4b: the reflected light's spectrum is that of the light times the reflectance's.

    A mirror's measured reflectance is to be multiplied by 1/pi to be the bidirectional reflectance of a rough surface.

    Compiled: none, for a renderer
    """
    return illuminant * reflectance


def F(c: Numbers, n: Numbers) -> Numbers:
    """Cook1982 F: the Fresnel reflectance for unpolarised light and k = 0; c = cos(theta) = V.H, g^2 = n^2 + c^2 - 1.

    1 where g^2 is negative, by total reflection. With n and k both known the paper takes the whole Fresnel equation:
    `gonio.models.plain.fresnel.reflectance`. Loses digits where n approaches 1.

    Compiled: gonio.models._facets.fresnel, gonio.models.fresnel.reflectance
    """
    g2 = n**2 + c**2 - 1
    g = np.sqrt(np.maximum(g2, 0))
    value = (g - c) ** 2 / (g + c) ** 2 / 2 * (1 + (c * (g + c) - 1) ** 2 / (c * (g - c) + 1) ** 2)
    return np.where(g2 < 0, 1.0, value)[()]


def F_0(n: Numbers) -> Numbers:
    """Cook1982 F_0 = ((n - 1)/(n + 1))^2: the reflectance at normal incidence.

    Compiled: gonio.models.fresnel.reflectance
    """
    return ((n - 1) / (n + 1)) ** 2


def n(F_0: Numbers) -> Numbers:
    """Cook1982 n = (1 + sqrt F_0)/(1 - sqrt F_0): the index of a reflectance at normal incidence, k set to 0.

    Compiled: gonio.models.fresnel.n_from_f0
    """
    return (1 + np.sqrt(F_0)) / (1 - np.sqrt(F_0))


def colour(colour_0: Numbers, colour_90: Numbers, F_theta: Numbers, F_0: Numbers, F_90: Numbers = 1.0) -> Numbers:
    """Cook1982 Red_theta: a channel of the colour at an angle, from the material's at 0 and the light's at 90 degrees.

    F is that of the index which the average normal reflectance F_0 gives.

    Compiled: gonio.models.fresnel.colour_shift
    """
    return colour_0 + (colour_90 - colour_0) * np.maximum(0, F_theta - F_0) / (F_90 - F_0)


# --- Determining the RGB values -------------------------------------------------------------------------------------


def XYZ(spectrum: Numbers, matching: Numbers, step_nm: float) -> Numbers:
    """Cook1982, determining the RGB values: tristimulus values, of a spectrum and the functions x, y, z (..., 3).

    Compiled: none, for a renderer
    """
    return np.sum(np.asarray(spectrum)[..., np.newaxis] * matching, axis=-2) * step_nm


def RGB(XYZ: Numbers, matrix: Numbers) -> Numbers:
    """Cook1982, determining the RGB values: linear luminances, by a matrix for the monitor's phosphors and white.

    Compiled: none, for a renderer
    """
    return np.einsum("ij,...j->...i", matrix, XYZ)


# --- what the workbench makes of it ---------------------------------------------------------------------------------


def brdf(
    L: Vectors,
    V: Vectors,
    slopes: Sequence[tuple[float, float]],
    ior: complex,
    s: float = 1.0,
    d: float = 0.0,
    diffuse_albedo: float = 0.0,
    distribution: Callable[[Numbers, float], Numbers] = D_beckmann,
    reflectance: Callable[[Numbers, complex], Numbers] = fresnel.reflectance,
) -> Numbers:
    """Cook1982, the BRDF: R from all its parts, with R_d = diffuse_albedo/pi [1/sr], as printed.

    alpha and theta come from unit vectors whose last digits are uncertain: what that is worth is eps/alpha and
    eps/(V.H)^2, times D's and F's slopes; N.L and N.V are divided by.

    Compiled: gonio.models.CookTorrance.brdf
    """
    h = H(L, V)
    theta = np.arctan2(np.sqrt(dot(np.cross(V, h), np.cross(V, h))), dot(V, h))
    specular = R_s(reflectance(theta, ior), D(polar(h), slopes, distribution), G(L, V), L, V)
    return R(s, specular, d, diffuse_albedo / PI)
