"""Cook and Torrance's model and Fresnel's formulas: kernels, and reference digits, against `gonio.models.plain`."""

import functools
import itertools
import math
from typing import Any

import numpy as np
import pytest

from gonio.models import CookTorrance, fresnel
from gonio.models.cook_torrance import unblocked_fraction
from gonio.models.plain import cook_torrance
from gonio.models.plain import fresnel as plain_fresnel
from gonio.models.plain.vectors import direction
from tests.gonio.models.agreement import (
    EPS,
    INDICES,
    PI,
    agree,
    facet_loss,
    in_frame,
    vectors,
)
from tests.gonio.models.reference import cases


def schlick(f0: Any, theta: Any, ior: complex) -> Any:
    return plain_fresnel.schlick(theta, f0)


@pytest.mark.parametrize("reflectance", ["exact", "schlick"])
@pytest.mark.parametrize("distribution", ["beckmann", "gaussian"])
def test_cook_torrance(distribution: str, reflectance: str) -> None:
    light, view = vectors(1)
    alpha, loss = facet_loss(light, view)
    D = {"beckmann": cook_torrance.D_beckmann, "gaussian": cook_torrance.D_gaussian}[distribution]
    for ior, slopes in itertools.product(INDICES, (((0.4, 0.4), (0.2, 0.6)), ((0.05, 1.0),), ((1.5, 1.0),))):
        f0 = plain_fresnel.reflectance(0.0, ior)
        F: dict[str, Any] = {"exact": plain_fresnel.reflectance, "schlick": functools.partial(schlick, f0)}
        plain = cook_torrance.brdf(light, view, slopes, ior, 0.3, 0.6, 0.8, D, F[reflectance])
        m = min(m for m, _ in slopes)
        # dlnD/dalpha, of an alpha that is uncertain as H is; N.L and N.V are exact
        steep = (
            np.tan(alpha) * (1.0 + 1.0 / np.cos(alpha) ** 2 / m**2) if D is cook_torrance.D_beckmann else alpha / m**2
        )
        more: dict[str, Any] = {"distribution": distribution, "fresnel": reflectance, "diffuse_albedo": 0.8, "ior": ior}
        model = CookTorrance(0.3, 0.6, slopes, **more)
        agree(model.brdf_vectors(light, view), plain, 4.0 * (1.0 + steep) * loss)
        base = 0.6 * 0.8 / PI
        quarter = CookTorrance(0.3, 0.6, slopes, convention="normalised", **more)
        agree(quarter.brdf_vectors(light, view) - base, (plain - base) / 4.0, 4.0 * (1.0 + steep) * loss, scale=plain)


def test_cook_torrance_index_of_a_reflectance_and_colours() -> None:
    f0 = np.array([0.0, 1e-6, 0.04, 0.5, 0.95, 0.999])
    n = cook_torrance.n(f0)
    agree([fresnel.n_from_f0(float(f)) for f in f0], n, 1.0 / (1.0 - f0))
    # F_0 = ((n - 1)/(n + 1))^2 of n near 1 loses n/(n - 1)
    agree(cook_torrance.F_0(n[1:]), f0[1:], 1.0 / (n[1:] - 1.0) + n[1:])
    cos = np.linspace(0.0, 1.0, 21)
    for k in (1, 2, 3, 4):
        F = cook_torrance.F(cos, n[k])
        # g - c cancels where n is near 1, and 1 - F where it is large
        agree(fresnel.reflectance(cos, n[k]), F, 10.0 * (n[k] + 1.0 / (n[k] - 1.0)))
        first, last = np.array([0.95, 0.64, 0.54]), np.array([1.0, 0.98, 0.9])
        shifted = cook_torrance.colour(first, last, F[:, np.newaxis], f0[k])
        agree(fresnel.colour_shift(cos, float(f0[k]), first, last), shifted, 20.0 / (1.0 - f0[k]) + 20.0 / (n[k] - 1.0))


def test_cook_torrance_ambient_light() -> None:
    # a horizon that rises toward one side; 1000 x 1000 cells are good to 1/1000
    def horizon(phi: Any) -> Any:
        return 0.5 * (1.0 + np.cos(phi))

    def unblocked(theta: Any, phi: Any) -> Any:
        return PI / 2 - theta > horizon(phi)

    phi = 2.0 * PI * np.arange(720) / 720
    assert cook_torrance.f(unblocked) == pytest.approx(unblocked_fraction(horizon(phi)), abs=1e-3)
    model = CookTorrance(0.4, 0.6, 0.4, ior=1.5, diffuse_albedo=0.7)
    theta_r = 0.6
    plain = cook_torrance.R_a(
        lambda theta, phi: cook_torrance.brdf(
            direction(theta, phi), direction(theta_r, 0.0), ((0.4, 1.0),), 1.5, 0.4, 0.6, 0.7
        ),
        128,
    )
    # 1e-3 is what the model states
    assert model.ambient_reflectance(theta_r) == pytest.approx(plain, rel=1e-3)
    assert model.ambient_reflectance() == pytest.approx(PI * 0.7 / PI, rel=4 * EPS)  # R_a = pi R_d


def test_fresnel() -> None:
    theta = np.concatenate([[0.0, 1e-6, PI / 2 - 1e-6, PI / 2], np.linspace(0.01, 1.56, 40)])
    for ior in (*INDICES, 1.0001, 1.0 + 1e-3j):
        F_s, F_p = plain_fresnel.amplitudes(theta, ior)
        got_s, got_p = fresnel.amplitudes(np.cos(theta), ior)
        # the numerators cancel for n near 1, to |n^2 - 1|; sin^2 of the angle and of the cosine differ by eps,
        # which q magnifies by 1/|q|, |q|^2 >= |n^2 - sin^2|
        q2 = np.abs(ior**2 - np.sin(theta) ** 2)
        loss = 4.0 * (1.0 + abs(ior) ** 2) / abs(ior**2 - 1.0) * (1.0 + 1.0 / q2)
        agree(got_s, F_s, loss, scale=np.maximum(np.abs(F_s), abs(ior**2 - 1.0)))
        agree(got_p, F_p, loss, scale=np.maximum(np.abs(F_p), abs(ior**2 - 1.0)))
        agree(fresnel.reflectance(np.cos(theta), ior), plain_fresnel.reflectance(theta, ior), loss, scale=1.0)


def test_plain_cook_torrance_digits() -> None:
    """Formulas of scalars, so that N need not be z."""
    for case in cases("cook_torrance_colour"):
        i, out = case["in"], case["out"]
        n = cook_torrance.n(i["F0"])
        # 1 - sqrt(F_0) cancels; F as in test_cook_torrance_index_of_a_reflectance_and_colours
        agree(n, float(out["n_from_F0"]), 1.0 / (1.0 - i["F0"]))
        agree(cook_torrance.F(i["cos"], i["n"]), float(out["F_n"]), 2.0 * (i["n"] + 1.0 / abs(i["n"] - 1.0)))
        F = cook_torrance.F(i["cos"], n)
        agree(F, float(out["F_theta"]), 2.0 * (n + 1.0 / (n - 1.0)))
        colours = cook_torrance.colour(np.array(i["col0"]), np.array(i["col90"]), F, i["F0"])
        agree(colours, [float(c) for c in out["colour"]], 20.0 / (1.0 - i["F0"]) + 20.0 / (n - 1.0))


def test_plain_cook_torrance_facet_digits() -> None:
    tried = 0
    for case in cases("cook_torrance"):
        i, out = case["in"], case["out"]
        light, view = in_frame(i, "L", "V")
        if min(light[2], view[2]) <= 1e-6:  # below the surface models are 0; the turned N.L has lost its digits
            continue
        tried += 1
        _, loss = facet_loss(light, view)
        loss = loss + 1.0 / (light[2] * view[2]) + (case["cond"]["R_s"] or 0.0)
        slopes = tuple((i[f"m{j}"], i[f"w{j}"]) for j in range(1, 9) if f"m{j}" in i)
        ior = cook_torrance.n(i["F0"]) if "F0" in i else complex(i["n"], i.get("k", 0.0))
        D = cook_torrance.D_gaussian if "gauss" in case["tags"] else cook_torrance.D_beckmann
        got = cook_torrance.brdf(light, view, slopes, ior, distribution=D)
        agree(got, float(out["R_s"]), 4.0 * loss * (1.0 + 1.0 / min(m for m, _ in slopes)))
        agree(cook_torrance.G(light, view), float(out["G"]), 4.0 * loss)
    assert tried > 40


def test_plain_fresnel_digits() -> None:
    for case in cases("fresnel_complex"):
        i, out = case["in"], case["out"]
        n = complex(i["n"], i["k"])
        theta = math.acos(i["cos"])
        F_s, F_p = plain_fresnel.amplitudes(theta, n)
        # numerators cancel to |n^2 - 1|; the angle is rounded, which counts near the critical angle
        loss = 2.0 * (1.0 + abs(n) ** 2) / abs(n**2 - 1.0) * (1.0 + 1.0 / abs(n**2 - math.sin(theta) ** 2))
        for got, key in ((F_s, "Fs"), (F_p, "Fp")):
            expected = complex(float(out[key + "_re"]), float(out[key + "_im"]))
            agree(got, expected, loss, scale=max(abs(expected), abs(n**2 - 1.0)))
        # F_p changes within cosines of 1/|n|
        agree(plain_fresnel.reflectance(theta, n), float(out["F2"]), loss + 4.0 * abs(n), scale=1.0)
