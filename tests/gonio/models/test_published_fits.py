"""Published fits to measured materials: what their parameters mean in our models.

Ngan, Durand and Matusik 2005 ("Experimental Analysis of BRDF Models") and Low et al. 2012 ("BRDF models for accurate
and efficient rendering of glossy surfaces") fitted Cook and Torrance's model to MERL's materials, colour by colour:

    f = a_d/pi + a_s F D G / (pi (N.L)(N.V)),    D = exp(-tan^2/m^2) / (m^2 cos^4)

with G of V grooves. Low's is the print's: D as here, F exact with a real index "eta". Ngan's D has a further 1/pi, and
F is Schlick's with F_0 = "eta". Ngan's colours are in MERL's unscaled units: green is to be multiplied by 1.15, blue by
1.66.
"""

import math
import re

import numpy as np
import pytest

from gonio.models import CookTorrance, Lambert, Model, Sum
from tests.places import measured

FIT = re.compile(
    r"(?P<name>\S+) = Aggregate\(Lambertian\(albedo = \[(?P<diffuse>[^]]+)\]\), "
    r"(?P<model>\w+)\(albedo = \[(?P<specular>[^]]+)\](?P<rest>[^)]*)\)\)"
)
THETA_I = np.deg2rad([5.0, 45.0, 75.0])[:, np.newaxis, np.newaxis]
THETA_R = np.deg2rad(np.linspace(0.0, 88.0, 45))[:, np.newaxis]
DPHI = np.deg2rad([0.0, 90.0, 160.0, 180.0])


def published(file: str) -> dict[str, tuple[list[float], list[float], dict[str, float]]]:
    """Diffuse and specular weights of red, green and blue, and the other parameters, by material."""
    path = measured(f"fits/{file}")
    out = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        match = FIT.fullmatch(line.strip())
        if match:
            rest = dict(re.findall(r"(\w+) = ([-+.\deE]+)", match["rest"]))
            colours = [[float(word) for word in match[key].split(",")] for key in ("diffuse", "specular")]
            out[match["name"]] = (colours[0], colours[1], {key: float(value) for key, value in rest.items()})
    return out


def low(a_d: float, a_s: float, p: dict[str, float]) -> Model:
    """A fit of Low et al. in our models."""
    return Sum((Lambert(albedo=a_d), 1.0), (CookTorrance(slopes=p["roughness"], ior=p["eta"]), a_s))


def ngan(a_d: float, a_s: float, p: dict[str, float]) -> Model:
    """A fit of Ngan et al. in our models."""
    lobe = CookTorrance(slopes=p["roughness"], f0=p["eta"], fresnel="schlick")
    return Sum((Lambert(albedo=a_d), 1.0), (lobe, a_s / math.pi))


def geometry() -> tuple[np.ndarray, ...]:
    """Cosines (N.L), (N.V), (N.H), (V.H) by spherical trigonometry, away from our kernels' route."""
    i, r = np.cos(THETA_I), np.cos(THETA_R)
    between = i * r + np.sin(THETA_I) * np.sin(THETA_R) * np.cos(DPHI)  # cosine of twice the angle to H
    vh = np.sqrt(np.maximum((1.0 + between) / 2.0, 0.0))
    return tuple(np.broadcast_arrays(i, r, np.minimum((i + r) / (2.0 * vh), 1.0), vh))


def formula(a_d: float, a_s: float, m: float, reflectance: np.ndarray) -> np.ndarray:
    """The formula at the head of this file."""
    nl, nv, nh, vh = geometry()
    d = np.exp(-(1.0 - nh * nh) / (nh * m) ** 2) / (m**2 * nh**4)
    g = np.minimum(1.0, np.minimum(2.0 * nh * nv / vh, 2.0 * nh * nl / vh))
    return a_d / math.pi + a_s * reflectance * d * g / (math.pi * nl * nv)


def agree(model: Model, wanted: np.ndarray, m: float) -> None:
    value = model.brdf(THETA_I, 0.0, THETA_R, DPHI)
    # the formula's 1 - cos^2 cancels, and D amplifies that by 1/m^2
    assert (np.abs(value / wanted - 1.0) <= 1e-12 + 8 * 2.2e-16 / (m * geometry()[2]) ** 2).all()


def test_low_cook_torrance_is_reproduced() -> None:
    fits = published("low_cooktorrance_E1.fit")
    assert len(fits) == 100
    for diffuse, specular, p in list(fits.values())[::5]:
        m, n = p["roughness"], p["eta"]
        c = geometry()[3]
        g = np.sqrt(n * n + c * c - 1.0)  # Cook and Torrance 1982, p. 10
        f = 0.5 * ((g - c) / (g + c)) ** 2 * (1.0 + ((c * (g + c) - 1.0) / (c * (g - c) + 1.0)) ** 2)
        for a_d, a_s in zip(diffuse, specular, strict=True):
            agree(low(a_d, a_s, p), formula(a_d, a_s, m, f), m)


def test_ngan_cook_torrance_is_reproduced() -> None:
    fits = published("ngan_cooktorrance.fit")
    assert len(fits) == 86
    for diffuse, specular, p in list(fits.values())[::4]:
        m, f0 = p["roughness"], p["eta"]
        f = f0 + (1.0 - f0) * (1.0 - geometry()[3]) ** 5
        for a_d, a_s in zip(diffuse, specular, strict=True):
            agree(ngan(a_d, a_s, p), formula(a_d, a_s / math.pi, m, f), m)


@pytest.mark.parametrize("distribution", ["beckmann", "gaussian"])
def test_schlick_is_exact_at_normal_incidence_and_one_at_grazing(distribution: str) -> None:
    exact, schlick = (
        CookTorrance(slopes=0.3, f0=0.04, distribution=distribution, fresnel=f) for f in ("exact", "schlick")
    )
    assert schlick.brdf(0.0, 0.0, 0.0, 0.0) == pytest.approx(exact.brdf(0.0, 0.0, 0.0, 0.0), rel=1e-14)
    near = math.pi / 2 - 1e-6  # 1 - F of both is below 1e-4 there: 5 cos, and 4 cos n/(n^2 - 1)
    mirror = (near, 0.0, near, math.pi)
    assert schlick.brdf(*mirror) == pytest.approx(exact.brdf(*mirror), rel=1e-4)
    assert schlick.parameters["fresnel"] == "schlick"
    assert "Schlick" in schlick.convention
