"""Blinn's and Phong's models: kernels, and reference digits, against `gonio.models.plain`."""

import itertools
import math

import numpy as np
import pytest

from gonio.models import Blinn, Phong
from gonio.models.blinn import coefficient
from gonio.models.plain import blinn
from gonio.models.plain.vectors import dot
from tests.gonio.models.agreement import (
    EPS,
    PI,
    agree,
    facet_loss,
    in_frame,
    pairs,
    vectors,
)
from tests.gonio.models.reference import cases

BLINN = {"phong": blinn.D_1, "gaussian": blinn.D_2, "trowbridge-reitz": blinn.D_3}


@pytest.mark.parametrize("distribution", list(BLINN))
def test_blinn(distribution: str) -> None:
    light, eye = vectors(2)
    alpha, loss = facet_loss(light, eye)
    for n, beta in itertools.product((1.5, 1.8, 200.0), (0.05, 0.3, 1.2)):
        c = {"phong": blinn.c_1, "gaussian": blinn.c_2, "trowbridge-reitz": blinn.c_3}[distribution](beta)
        # 1 - cos^2(beta) cancels
        assert coefficient(distribution, beta) == pytest.approx(c, rel=20 * EPS / beta**2)
        D = BLINN[distribution](alpha, c)
        # dlnD/dalpha; and the denominator of D_3 cancels
        steep = {
            "phong": c * np.tan(alpha),
            "gaussian": 2.0 * alpha * c**2,
            "trowbridge-reitz": 1.0 / c**2 + np.tan(alpha),
        }[distribution]
        cos = np.minimum(dot(eye, blinn.H(light, eye)), 1.0)
        for form in ("exact", "1977"):
            F = blinn.F_shortcut(cos, n, printed=form == "1977")
            s = blinn.s(D, blinn.G(light, eye), F, eye)
            model = Blinn(0.6, 0.4, n, distribution, float(c), form)
            # 1 - F is 4 g c of order 1/n: nothing is lost in F
            agree(model.brdf_vectors(light, eye), blinn.brdf(s, light, 0.6, 0.4), 4.0 * (1.0 + steep) * loss)
            theta_i, phi_i, theta_r, phi_r = pairs(2)
            # N.E by its angle: tan(theta_r)
            agree(
                model.highlight(theta_i, phi_i, theta_r, phi_r), s, 4.0 * (1.0 + steep) * loss * (1.0 + np.tan(theta_r))
            )
            by_cases = blinn.G_over_NE(light, eye) * D * F
            agree(
                model.highlight(theta_i, phi_i, theta_r, phi_r),
                by_cases,
                4.0 * (1.0 + steep) * loss * (1.0 + np.tan(theta_r)),
            )


def test_phong() -> None:
    light, eye = vectors(3)
    alpha, loss = facet_loss(light, eye)
    for c1 in (0.0, 1.0, 50.0, 1000.0):
        s = blinn.s_phong(light, eye, c1)
        # cos^c1 of a rounded N.H: c1 roundings, and c1 tan(alpha) of H's own
        steep = c1 * (1.0 + np.tan(alpha))
        model = Phong(0.5, 0.4, c1)
        agree(model.brdf_vectors(light, eye), blinn.brdf(s, light, 0.5, 0.4), (1.0 + steep) * loss)
        agree(model.highlight(*pairs(3)), s, (1.0 + steep) * loss)


def test_blinn_texture() -> None:
    alpha = np.linspace(0.0, PI / 2, 40)
    for c_min, t in itertools.product((0.1, 0.5, 1.0), (0.0, 0.3, 1.0)):
        plain = blinn.D_3_textured(alpha, c_min, t)
        # the denominator of D_3 cancels
        agree(Blinn.textured_d3(np.cos(alpha), c_min, t), plain, 2.0 / c_min**2)


def test_plain_blinn_facet_digits() -> None:
    tried = 0
    for case in cases("blinn"):
        i, out = case["in"], case["out"]
        light, view = in_frame(i, "L", "E")
        if min(light[2], view[2]) <= 1e-6:  # below the surface models are 0; the turned N.L has lost its digits
            continue
        tried += 1
        alpha, loss = facet_loss(light, view)
        loss = loss + 1.0 / (light[2] * view[2]) + (case["cond"]["s"] or 0.0)
        c = {1: blinn.c_1, 2: blinn.c_2, 3: blinn.c_3}[i["dist"]](i["beta"])
        agree(c, float(out["c"]), 1.0 / i["beta"] ** 2)
        D = {1: blinn.D_1, 2: blinn.D_2, 3: blinn.D_3}[i["dist"]](alpha, c)
        cos = min(float(dot(view, blinn.H(light, view))), 1.0)
        # 1 - cos^2(beta) cancels in c, the denominator in D_3
        loss = 4.0 * loss * (1.0 + (1.0 / i["beta"] ** 2))
        if i["n"] ** 2 + cos**2 > 1.0:  # beyond the critical angle Blinn's F is not a number
            for printed, key in ((False, "s"), (True, "s_if_F_printed_without_half")):
                F = blinn.F_shortcut(cos, i["n"], printed)
                # g - c cancels for n near 1
                agree(
                    blinn.s(D, blinn.G(light, view), F, view),
                    float(out[key]),
                    loss * (1.0 + 1.0 / abs(i["n"] - 1.0)),
                )
        agree(blinn.G_over_NE(light, view), float(out["G_over_NE"]), loss)
    assert tried > 40


def test_plain_blinn_texture_digits() -> None:
    for case in cases("blinn_texture"):
        i, out = case["in"], case["out"]
        agree(blinn.C_3(i["cmin"], i["t"]), float(out["c3"]), 0.0)
        alpha = math.acos(i["cosa"])
        # acos loses 1/sin(alpha), which D_3 takes times its slope, sin(alpha) cos(alpha)/c3^2
        loss = 2.0 / i["cmin"] ** 2
        agree(blinn.D_3_textured(alpha, i["cmin"], i["t"]), float(out["D3_texture"]), loss)
        agree(blinn.D_3(alpha, float(out["c3"])), float(out["D3"]), loss)
        for function, key in ((blinn.c_1, "c1_beta"), (blinn.c_2, "c2_beta"), (blinn.c_3, "c3_beta")):
            agree(function(i["beta"]), float(out[key]), 1.0 / i["beta"] ** 2 + 1.0 / abs(math.log(math.cos(i["beta"]))))
