"""Blinn, "Models of Light Reflection for Computer Synthesized Pictures" (Blinn1977), with Phong1975 in his form.

The paper's equations have no numbers: they stand here in the paper's order, under its sections and in its symbols, and
are cited by the letter on their left, as `Blinn1977 D_3`. N = z; L goes to the light, E to the eye. The paper's
intensities are no BRDFs: `brdf` says what the workbench makes of them.
"""

import numpy as np

from gonio.models.plain.vectors import N, Numbers, Vectors, dot, polar, unit

PI = np.pi


# --- Introduction, and simple highlight models ----------------------------------------------------------------------


def d(L: Vectors) -> Numbers:
    """Blinn1977 d = max(0, N.L): the amount of diffuse reflection.

    Compiled: gonio.models.blinn.torrance_sparrow, whose diffuse term is k_d/pi: i over pi (N.L)
    """
    return np.maximum(0, dot(N, L))


def H(L: Vectors, E: Vectors) -> Vectors:
    """Blinn1977 H = (L + E)/len(L + E): the direction of maximum highlights; 0/0 where they are opposite.

    Compiled: gonio.models._facets.facet
    """
    return unit(np.asarray(L) + E)


def s_phong(L: Vectors, E: Vectors, c1: float) -> Numbers:
    """Blinn1977 s = (N.H)^c1: Phong's highlight.

    Compiled: gonio.models.blinn.phong_highlight
    """
    return dot(N, H(L, E)) ** c1


def i(p_a: float, d: Numbers, p_d: float, s: Numbers, p_s: float) -> Numbers:
    """Blinn1977 i = p_a + d p_d + s p_s: the perceived intensity (without s: the simple diffuse model).

    Compiled: gonio.models.Blinn.brdf and gonio.models.Phong.brdf, over pi (N.L)
    """
    return p_a + d * p_d + s * p_s


# --- Torrance-Sparrow model -----------------------------------------------------------------------------------------


def s(D: Numbers, G: Numbers, F: Numbers, E: Vectors) -> Numbers:
    """Blinn1977 s = D G F/(N.E): Torrance and Sparrow's highlight (Torrance1967), without 1/(N.L) and 1/4.

    Compiled: gonio.models.Blinn.highlight, gonio.models.blinn.torrance_sparrow_highlight
    """
    return D * G * F / dot(N, E)


def triangle(e: Numbers, a: Numbers) -> Numbers:
    """Blinn1977 Fig. 4: G_b = 1 - m/l = 1 - sin(f)/sin(b), in the plane of N and H; e and a as the figure has them.

    sin(b) = cos(e), c = 2 d, and d = pi/2 - a. The angles of the triangle sum to pi, not 2 pi as printed; sin(f) =
    sin(b + c) follows from that. In vectors, cos(a) = N.H, cos(e) = H.E and cos(e + a) = N.E.

    Compiled: gonio.models._facets.groove_over_viewer, as eq. G_b
    """
    b, c = PI / 2 - e, 2 * (PI / 2 - a)
    return 1 - np.sin(b + c) / np.sin(b)


def G_a() -> float:
    """Blinn1977 G_a = 1: neither shadowed nor masked.

    Compiled: gonio.models._facets.groove_over_viewer
    """
    return 1.0


def G_b(L: Vectors, E: Vectors) -> Numbers:
    """Blinn1977 G_b = 2 (N.H)(N.E)/(E.H): what is not masked.

    Compiled: gonio.models._facets.groove_over_viewer
    """
    h = H(L, E)
    return 2 * dot(N, h) * dot(N, E) / dot(E, h)


def G_c(L: Vectors, E: Vectors) -> Numbers:
    """Blinn1977 G_c = 2 (N.H)(N.L)/(E.H): what is not shadowed.

    Compiled: gonio.models._facets.groove_over_viewer
    """
    h = H(L, E)
    return 2 * dot(N, h) * dot(N, L) / dot(E, h)


def G(L: Vectors, E: Vectors) -> Numbers:
    """Blinn1977 G = min(G_a, G_b, G_c): the geometrical attenuation factor.

    Compiled: gonio.models._facets.facet, gonio.models._facets.groove_over_viewer
    """
    return np.minimum(G_a(), np.minimum(G_b(L, E), G_c(L, E)))


def F(phi: Numbers, n: float) -> Numbers:
    """Blinn1977 F: the Fresnel reflectance, sin(theta) = sin(phi)/n, phi the angle of incidence.

    0/0 at phi = 0, and not a number beyond the critical angle of n < 1.

    Compiled: gonio.models._facets.fresnel
    """
    theta = np.arcsin(np.sin(phi) / n)
    return (
        np.sin(phi - theta) ** 2 / np.sin(phi + theta) ** 2 + np.tan(phi - theta) ** 2 / np.tan(phi + theta) ** 2
    ) / 2


# --- Facet distribution functions -----------------------------------------------------------------------------------


def D_1(alpha: Numbers, c1: float) -> Numbers:
    """Blinn1977 D_1 = cos^c1(alpha): Phong's facets.

    Compiled: gonio.models._facets.cos_power
    """
    return np.cos(alpha) ** c1


def D_2(alpha: Numbers, c2: float) -> Numbers:
    """Blinn1977 D_2 = exp(-(alpha c2)^2): Torrance and Sparrow's Gaussian facets.

    c2 is a reciprocal width. The text calls it a standard deviation whose large values are dull; large c2 are shiny.

    Compiled: gonio.models.blinn.d2
    """
    return np.exp(-((alpha * c2) ** 2))


def D_3(alpha: Numbers, c3: float) -> Numbers:
    """Blinn1977 D_3 = [c3^2/(cos^2(alpha)(c3^2 - 1) + 1)]^2: Trowbridge and Reitz's ellipsoids (Trowbridge1975).

    Loses 1/c3^2 near alpha = 0 for small c3: the denominator cancels.

    Compiled: gonio.models.blinn.d3
    """
    return (c3**2 / (np.cos(alpha) ** 2 * (c3**2 - 1) + 1)) ** 2


def c_1(beta: Numbers) -> Numbers:
    """Blinn1977 c_1 = -ln 2/ln cos(beta): D_1 is 1/2 at beta.

    Compiled: gonio.models.blinn.coefficient
    """
    return -np.log(2) / np.log(np.cos(beta))


def c_2(beta: Numbers) -> Numbers:
    """Blinn1977 c_2 = sqrt(ln 2)/beta: D_2 is 1/2 at beta.

    Compiled: gonio.models.blinn.coefficient
    """
    return np.sqrt(np.log(2)) / beta


def c_3(beta: Numbers) -> Numbers:
    """Blinn1977 c_3 = sqrt((cos^2(beta) - 1)/(cos^2(beta) - sqrt 2)): D_3 is 1/2 at beta.

    Both are negative: the sign of the print is right.

    Compiled: gonio.models.blinn.coefficient
    """
    return np.sqrt((np.cos(beta) ** 2 - 1) / (np.cos(beta) ** 2 - np.sqrt(2)))


# --- Computational considerations -----------------------------------------------------------------------------------


def k_1(c3: Numbers) -> Numbers:
    """Blinn1977 k_1 = 1/(c3^2 - 1): infinite for c3 = 1, where D_3 = 1.

    Compiled: none, gonio.models.blinn.d3 has another form of D_3
    """
    return 1 / (c3**2 - 1)


def k_2(c3: Numbers) -> Numbers:
    """Blinn1977 k_2 = k_1 + 1: for `D_3_fast`.

    Compiled: none, gonio.models.blinn.d3 has another form of D_3
    """
    return k_1(c3) + 1


def D_3_fast(alpha: Numbers, c3: Numbers) -> Numbers:
    """Blinn1977 D_3 = (k_2/(cos^2(alpha) + k_1))^2: D_3 from values that one picture needs once.

    Compiled: gonio.models.blinn.d3
    """
    return (k_2(c3) / (np.cos(alpha) ** 2 + k_1(c3))) ** 2


def G_over_NE(L: Vectors, E: Vectors) -> Numbers:
    """Blinn1977, computational considerations: G/(N.E) by cases, without a division by zero where G takes N.E out.

    Compiled: gonio.models._facets.groove_over_viewer
    """
    h = H(L, E)
    NE, NL, NH, EH = dot(N, E), dot(N, L), dot(N, h), dot(E, h)
    one = np.where(2 * NE * NH < EH, 2 * NH / EH, 1 / NE)
    other = np.where(2 * NL * NH < EH, 2 * NH * NL / (EH * NE), 1 / NE)
    return np.where(NE < NL, one, other)[()]


def F_shortcut(c: Numbers, n: float, printed: bool = False) -> Numbers:
    """Blinn1977 F by c and g: c = E.H, g = sqrt(n^2 + c^2 - 1), with the factor 1/2 that the print lacks (Cook1982).

    `printed` leaves it out. Not a number beyond the critical angle of n < 1.

    Compiled: gonio.models._facets.fresnel; gonio.models.Blinn with fresnel="1977" is as printed
    """
    g = np.sqrt(n**2 + c**2 - 1)
    value = (g - c) ** 2 / (g + c) ** 2 * (1 + (c * (g + c) - 1) ** 2 / (c * (g - c) + 1) ** 2)
    return value if printed else value / 2


# --- Varying surface shininess --------------------------------------------------------------------------------------


def C_3(c_min: float, t: Numbers) -> Numbers:
    """Blinn1977 C_3 = c_min + (1 - c_min) t(u, v): the roughness by a texture.

    Compiled: gonio.models.Blinn.textured_d3
    """
    return c_min + (1 - c_min) * t


def D_3_textured(alpha: Numbers, c_min: float, t: Numbers) -> Numbers:
    """Blinn1977 D_3 = [c_min C_3/(cos^2(alpha)(C_3^2 - 1) + 1)]^2: one scale for the whole surface.

    Compiled: gonio.models.Blinn.textured_d3
    """
    c3 = C_3(c_min, t)
    return (c_min * c3 / (np.cos(alpha) ** 2 * (c3**2 - 1) + 1)) ** 2


# --- what the workbench makes of it ---------------------------------------------------------------------------------


def alpha(L: Vectors, E: Vectors) -> Numbers:
    """Blinn1977 alpha = acos(N.H): by the arc tangent, since an arc cosine loses half the digits near 0.

    Compiled: gonio.models._facets.alpha_squared
    """
    return polar(H(L, E))


def brdf(s: Numbers, L: Vectors, k_d: float, k_s: float) -> Numbers:
    """Blinn1977, the BRDF: i over pi (N.L) with p_d = k_d, p_s = k_s and p_a = 0 [1/sr].

    That makes k_d an albedo, and Torrance and Sparrow's highlight reciprocal; Phong's is not.

    Compiled: gonio.models.Blinn.brdf, gonio.models.Phong.brdf
    """
    return (k_d + k_s * s / dot(N, L)) / PI
