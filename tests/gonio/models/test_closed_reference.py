"""The closed-form models against 50-digit reference vectors.

Tolerance: 100 eps (1 + cond), cond being the file's own condition number; values below 1e-290 count as 0 (the files'
README).
"""

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from gonio.models import Blinn, CookTorrance, OrenNayar, fresnel
from gonio.models.blinn import coefficient
from tests.gonio.models.reference import cases

EPS = float(np.finfo(float).eps)
mp.mp.dps = 60


def close(got: float, reference: str, condition: float | None, scale: float | None = None) -> None:
    ref = float(reference)
    if abs(ref) < 1e-290 and 0.0 <= got < 1e-280:
        return
    limit = 100.0 * EPS * (1.0 + (condition or 0.0)) * (scale or abs(ref))
    assert abs(got - ref) <= limit, f"{got!r} instead of {reference}"


def local(values: dict[str, float], a: str, b: str) -> tuple[Any, Any]:
    """Directions in a frame whose z is N, turned there in 60 digits, so that only their last rounding is left."""

    def unit(v: Any) -> Any:
        return v / mp.sqrt((v.T * v)[0])

    def vector(prefix: str) -> Any:
        return unit(mp.matrix([mp.mpf(values[prefix + axis]) for axis in "xyz"]))

    def cross(u: Any, v: Any) -> Any:
        return mp.matrix([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])

    n = vector("N")
    x = unit(cross(mp.matrix([1, 0, 0]) if abs(n[0]) < 0.9 else mp.matrix([0, 1, 0]), n))
    y = cross(n, x)
    if n[0] == 0 and n[1] == 0:
        x, y = mp.matrix([1, 0, 0]), mp.matrix([0, 1, 0])

    def turned(prefix: str) -> Any:
        v = vector(prefix)
        return np.array([float((axis.T * v)[0]) for axis in (x, y, n)])

    return turned(a), turned(b)


@pytest.mark.parametrize("case", cases("cook_torrance"), ids=lambda c: c["id"])
def test_cook_torrance(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    light, view = local(i, "L", "V")
    slopes = tuple((i[f"m{j}"], i[f"w{j}"]) for j in range(1, 9) if f"m{j}" in i)
    index = {"f0": i["F0"]} if "F0" in i else {"ior": complex(i["n"], i.get("k", 0.0))}
    distribution = "gaussian" if "gauss" in case["tags"] else "beckmann"
    # components rounded once more than the file's own: twice its condition
    condition = 2.0 * (case["cond"]["R_s"] or 0.0)
    for convention, key in (("paper", "R_s"), ("normalised", "R_s_energy_correct")):
        model = CookTorrance(slopes=slopes, distribution=distribution, convention=convention, **index)
        close(float(model.brdf_vectors(light, view)), out[key], condition)


@pytest.mark.parametrize("case", cases("blinn"), ids=lambda c: c["id"])
def test_blinn(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    light, view = local(i, "L", "E")
    distribution = {1: "phong", 2: "gaussian", 3: "trowbridge-reitz"}[i["dist"]]
    c = coefficient(distribution, i["beta"])
    close(c, out["c"], 1.0)
    condition = 2.0 * (case["cond"]["s"] or 0.0)
    lit = float(out["s"]) > 0.0
    for form, key in (("exact", "s"), ("1977", "s_if_F_printed_without_half")):
        model = Blinn(k_d=0.0, k_s=1.0, ior=i["n"], distribution=distribution, c=c, fresnel=form)
        got = float(model.brdf_vectors(light, view)) * math.pi
        close(got * light[2] if lit else got, out[key], condition + 1.0)
        if lit:
            angles = [f(w) for w in (light, view) for f in (polar, azimuth)]
            # angles rounded on the way: their conditioning is that of the cosines, tan(theta)
            steep = 1.0 / light[2] + 1.0 / view[2]
            close(float(model.highlight(*angles)), out[key], 30.0 * (condition + steep))


def polar(w: Any) -> float:
    return math.atan2(math.hypot(w[0], w[1]), w[2])


def azimuth(w: Any) -> float:
    return math.atan2(w[1], w[0])


@pytest.mark.parametrize("case", cases("blinn_texture"), ids=lambda c: c["id"])
def test_blinn_texture_and_half_angle_coefficients(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    close(float(Blinn.textured_d3(i["cosa"], i["cmin"], i["t"])), out["D3_texture"], 10.0)
    for name, key in (("phong", "c1_beta"), ("gaussian", "c2_beta"), ("trowbridge-reitz", "c3_beta")):
        close(coefficient(name, i["beta"]), out[key], 1.0)


@pytest.mark.parametrize("case", cases("fresnel_complex"), ids=lambda c: c["id"])
def test_fresnel_amplitudes(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    f_s, f_p = fresnel.amplitudes(i["cos"], complex(i["n"], i["k"]))
    for got, key in ((f_s, "Fs"), (f_p, "Fp")):
        # a component may be far smaller than the amplitude: held against the amplitude
        scale = abs(complex(float(out[key + "_re"]), float(out[key + "_im"])))
        close(got.real, out[key + "_re"], 0.0, scale)
        close(got.imag, out[key + "_im"], 0.0, scale)
    close(fresnel.reflectance(i["cos"], complex(i["n"], i["k"])), out["F2"], 0.0)


@pytest.mark.parametrize("case", cases("cook_torrance_colour"), ids=lambda c: c["id"])
def test_cook_torrance_colour(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    close(fresnel.reflectance(i["cos"], i["n"]), out["F_n"], 10.0)
    n = fresnel.n_from_f0(i["F0"])
    close(n, out["n_from_F0"], 1.0 / (1.0 - i["F0"]))
    close(fresnel.reflectance(i["cos"], n), out["F_theta"], 10.0)
    got = fresnel.colour_shift(i["cos"], i["F0"], i["col0"], i["col90"])
    for value, reference in zip(got, out["colour"], strict=True):
        close(float(value), reference, 10.0 / (1.0 - i["F0"]))


@pytest.mark.parametrize("case", cases("oren_nayar_closed"), ids=lambda c: c["id"])
def test_oren_nayar_functional_and_qualitative(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    angles = (i["theta_i"], 0.0, i["theta_r"], i["phi"])
    for form, key in (("functional", "f_r"), ("qualitative", "qual_fr")):
        close(float(OrenNayar(i["rho"], math.degrees(i["sigma"]), form).brdf(*angles)), out[key], case["cond"]["f_r"])


@pytest.mark.parametrize("case", cases("oren_nayar_exact"), ids=lambda c: c["id"])
def test_oren_nayar_exact(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    sigma = math.degrees(i["sigma"])
    angles = (i["theta_i"], 0.0, i["theta_r"], i["phi"])
    # 1e-8 is what the model promises for its quadrature
    assert float(OrenNayar(i["rho"], sigma, "exact").brdf(*angles)) == pytest.approx(float(out["f_r"]), rel=1e-8)
    once = OrenNayar(i["rho"], sigma, "exact", interreflections=False)
    assert float(once.brdf(*angles)) * math.cos(i["theta_i"]) == pytest.approx(float(out["L1"]), rel=1e-8)


@pytest.mark.parametrize("case", cases("oren_nayar_single_slope"), ids=lambda c: c["id"])
def test_oren_nayar_single_slope(case: dict[str, Any]) -> None:
    i, out = case["in"], case["out"]
    angles = (i["theta_i"], 0.0, i["theta_r"], i["phi"])
    cosine = math.cos(i["theta_i"])
    slope, across = math.degrees(i["theta_a"]), math.degrees(i["phi_a"])
    once: dict[str, Any] = {"form": "single-slope", "slope_deg": slope, "interreflections": False}
    one = float(OrenNayar(i["rho"], groove_azimuth_deg=across, **once).brdf(*angles)) * cosine
    # degrees and back, and tan(theta_a) up to 6: 2e-14
    assert one == pytest.approx(float(out["uni_L1"]), rel=2e-14)
    both = (
        float(OrenNayar(i["rho"], form="single-slope", slope_deg=slope, groove_azimuth_deg=across).brdf(*angles))
        * cosine
    )
    assert both == pytest.approx(float(out["uni_L1"]) + float(out["uni_L2"]), rel=2e-14)
    around = float(OrenNayar(i["rho"], **once).brdf(*angles)) * cosine
    assert around == pytest.approx(float(out["isotropic_L1"]), rel=2e-14)
