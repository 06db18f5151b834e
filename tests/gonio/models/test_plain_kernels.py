"""Every compiled kernel against `gonio.models.plain`, and every loop with one kernel that goes through it.

Reference digits hold models and plain functions over many more parameters. Here each kernel stands beside the plain
function that specifies it, and a kernel without one is found.
"""

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from gonio import models
from gonio.models import (
    AnisotropicFacets,
    Blinn,
    CookTorrance,
    HeTorrance,
    Lambert,
    Model,
    OrenNayar,
    Phong,
    Retroreflecting,
    geometry,
)
from gonio.models import _groove_integral as groove_kernels
from gonio.models import _groove_slopes as slope_kernels
from gonio.models import _htsg_kernels as htsg_kernels
from gonio.models import abg as abg_kernels
from gonio.models import blinn as blinn_kernels
from gonio.models import eon as eon_kernels
from gonio.models import ggx as ggx_kernels
from gonio.models import hapke as hapke_kernels
from gonio.models import k_correlation as k_correlation_kernels
from gonio.models.plain import anisotropic, blinn, cook_torrance, he_torrance, oren_nayar, retroreflecting
from gonio.models.plain import fresnel as plain_fresnel
from gonio.models.plain.vectors import direction, dot
from tests.gonio.models import test_closed_reference, test_htsg_reference, test_mean_slope, test_newer_models
from tests.gonio.models.agreement import EPS, PI, Angles, agree, facet_loss, lobe_loss, pairs, vectors

METAL, GLASS = 0.77 + 6.08j, 1.5
WAVELENGTH_NM = 550.0
BLINN = {"phong": blinn.D_1, "gaussian": blinn.D_2, "trowbridge-reitz": blinn.D_3}


class Case(NamedTuple):
    model: Model
    plain: Callable[[Angles], Any]
    loss: Callable[[Angles], Any]
    roundings: float = 8.0
    scale: float | None = None
    """What the roundings are parts of, where a sum may pass through zero."""


def facets(at: Angles) -> tuple[Any, Any, Any, Any]:
    """The vectors, the angle alpha, and what F and G lose."""
    light, view = direction(at[0], at[1]), direction(at[2], at[3])
    return light, view, *facet_loss(light, view)


def cook(distribution: str, ior: complex, reflectance: str = "exact") -> Case:
    m = 0.4

    def plain(at: Angles) -> Any:
        light, view, _, _ = facets(at)
        D = {"beckmann": cook_torrance.D_beckmann, "gaussian": cook_torrance.D_gaussian}[distribution]
        f0 = plain_fresnel.reflectance(0.0, ior)
        F = {"exact": plain_fresnel.reflectance, "schlick": lambda theta, _: plain_fresnel.schlick(theta, f0)}
        return cook_torrance.brdf(light, view, ((m, 1.0),), ior, 0.3, 0.6, 0.8, D, F[reflectance])

    def loss(at: Angles) -> Any:
        _, _, alpha, lost = facets(at)
        # dlnD/dalpha, as in the tests of the paper
        steep = np.tan(alpha) * (1.0 + 1.0 / np.cos(alpha) ** 2 / m**2) if distribution == "beckmann" else alpha / m**2
        return 4.0 * (1.0 + steep) * lost

    more: dict[str, Any] = {"ior": ior, "distribution": distribution, "diffuse_albedo": 0.8, "fresnel": reflectance}
    return Case(CookTorrance(0.3, 0.6, m, **more), plain, loss)


def torrance_sparrow(distribution: str, c: float, ior: complex) -> Case:
    def plain(at: Angles) -> Any:
        light, eye, alpha, _ = facets(at)
        D = BLINN[distribution](alpha, c)
        F = plain_fresnel.reflectance(np.arccos(np.minimum(dot(eye, blinn.H(light, eye)), 1.0)), ior)
        return blinn.brdf(blinn.s(D, blinn.G(light, eye), F, eye), light, 0.6, 0.4)

    def loss(at: Angles) -> Any:
        _, _, alpha, lost = facets(at)
        steep = {"phong": c * np.tan(alpha), "gaussian": 2.0 * alpha * c**2}
        return 4.0 * (1.0 + steep.get(distribution, 1.0 / c**2 + np.tan(alpha))) * lost

    return Case(Blinn(0.6, 0.4, ior, distribution, c), plain, loss)


def phong(c1: float) -> Case:
    def plain(at: Angles) -> Any:
        light, eye, _, _ = facets(at)
        return blinn.brdf(blinn.s_phong(light, eye, c1), light, 0.5, 0.4)

    def loss(at: Angles) -> Any:
        _, _, alpha, lost = facets(at)
        return (1.0 + c1 * (1.0 + np.tan(alpha))) * lost

    return Case(Phong(0.5, 0.4, c1), plain, loss)


def oren(form: str) -> Case:
    rho, sigma = 0.8, math.radians(30.0)

    def plain(at: Angles) -> Any:
        theta_i, phi_i, theta_r, phi_r = at
        where = (theta_i, theta_r, phi_r - phi_i, sigma, rho)
        if form == "qualitative":
            return oren_nayar.f_r(oren_nayar.L_qualitative(*where), theta_i)
        return oren_nayar.f_r(oren_nayar.L(oren_nayar.L1(*where), oren_nayar.L2(*where)), theta_i)

    def loss(at: Angles) -> Any:
        beta, half = np.minimum(at[0], at[2]), (at[0] + at[2]) / 2.0
        return 8.0 * (np.tan(beta) ** 2 + np.tan(half) ** 2 + np.tan(beta))

    return Case(OrenNayar(rho, 30.0, form), plain, loss, scale=rho / PI)


def grooves() -> Case:
    theta_a, phi_a = math.radians(40.0), math.radians(75.0)

    def plain(at: Angles) -> Any:
        light, view = direction(at[0], at[1]), direction(at[2], at[3])
        return oren_nayar.L_uni_directional(light, view, theta_a, phi_a, 0.8) / np.cos(at[0])

    def loss(at: Angles) -> Any:
        return 4.0 * np.tan(theta_a) ** 2 + 1.0 / (np.cos(at[0]) * np.cos(at[2]))

    model = OrenNayar(0.8, form="single-slope", slope_deg=40.0, groove_azimuth_deg=75.0)
    return Case(model, plain, loss, scale=0.8 / PI)


def he(sigma0: float, tau: float, ior: complex, tolerance: float) -> Case:
    lam = WAVELENGTH_NM * 1e-3

    def plain(at: Angles) -> Any:
        return he_torrance.rho_dd(*at, sigma0, tau, lam, ior) + he_torrance.rho_ud(0.3)

    def loss(at: Angles) -> Any:
        return lobe_loss(*at, sigma0, tau, lam)

    model = HeTorrance(sigma0, tau, ior, 0.3, tolerance=tolerance)
    return Case(model, plain, loss, 8.0 + tolerance / EPS)  # the series is good to `tolerance` (1 + conditioning)


def brushed(ior: complex) -> Case:
    along, across, azimuth = 0.2, 0.5, math.radians(25.0)

    def plain(at: Angles) -> Any:
        light, view = direction(at[0], at[1] - azimuth), direction(at[2], at[3] - azimuth)
        return 0.6 * anisotropic.f_r(light, view, along, across, ior) + 0.4 * 0.8 / PI

    def loss(at: Angles) -> Any:
        _, _, alpha, lost = facets(at)
        # dlnD/dalpha = 4 tan cos^2 (1/a^2 - 1)/(cos^2 + sin^2/a^2), at most 2/a with the smaller width
        return 4.0 * (1.0 + 2.0 / along) * lost + 0.0 * alpha

    return Case(AnisotropicFacets(along, across, 25.0, ior, 0.6, 0.8), plain, loss)


def retro(width_deg: float, tail: float, entrance: float) -> Case:
    w = math.radians(width_deg)

    def plain(at: Angles) -> Any:
        light, view = direction(at[0], at[1]), direction(at[2], at[3])
        return 0.3 * retroreflecting.f_r(light, view, w, tail, entrance) + 0.7 * 0.5 / PI

    def loss(at: Angles) -> Any:
        # |V - L| is uncertain by eps, D by tail/w of it; powers by their logarithms
        cosines = np.abs(np.log(np.cos(at[0]) * np.cos(at[2])))
        return tail / w + tail * math.log(4.0 / w**2) + entrance * cosines + tail

    return Case(Retroreflecting(0.3, width_deg, tail, entrance, 0.5), plain, loss)


CASES = {
    "anisotropic": brushed(METAL),
    "anisotropic real": brushed(GLASS),
    "retroreflecting": retro(2.0, 1.4, 0.7),
    "retroreflecting, even in entrance": retro(15.0, 3.0, 0.0),
    "lambert": Case(Lambert(0.5), lambda at: 0.5 / PI + 0.0 * at[0], lambda at: 0.0),
    "cook-torrance beckmann": cook("beckmann", METAL),
    "cook-torrance beckmann real": cook("beckmann", GLASS),
    "cook-torrance beckmann schlick": cook("beckmann", METAL, "schlick"),
    "cook-torrance gaussian": cook("gaussian", METAL),
    "cook-torrance gaussian real": cook("gaussian", GLASS),
    "cook-torrance gaussian schlick": cook("gaussian", METAL, "schlick"),
    "blinn D_1": torrance_sparrow("phong", 30.0, METAL),
    "blinn D_1 real": torrance_sparrow("phong", 30.0, GLASS),
    "blinn D_2": torrance_sparrow("gaussian", 3.0, METAL),
    "blinn D_2 real": torrance_sparrow("gaussian", 3.0, GLASS),
    "blinn D_3": torrance_sparrow("trowbridge-reitz", 0.3, METAL),
    "blinn D_3 real": torrance_sparrow("trowbridge-reitz", 0.3, GLASS),
    "phong": phong(50.0),
    "oren-nayar functional": oren("functional"),
    "oren-nayar qualitative": oren("qualitative"),
    "oren-nayar parallel grooves": grooves(),
    "he-torrance 1e-12": he(0.28, 1.77, METAL, 1e-12),
    "he-torrance 1e-9": he(0.28, 1.77, METAL, 1e-9),
    "he-torrance 1e-6": he(0.28, 1.77, METAL, 1e-6),
    "he-torrance rough": he(1.45, 13.2, 1.7, 1e-12),
}

IN_EVERY_LOOP = (
    "anisotropic",
    "retroreflecting",
    "cook-torrance beckmann",
    "phong",
    "oren-nayar functional",
    "oren-nayar parallel grooves",
)
"""Of both azimuths, of three, four and two columns, and of directions; He and Torrance's have loops of their own."""


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


ELSEWHERE: dict[Any, Callable[..., None]] = {
    **dict.fromkeys(blinn_kernels._HIGHLIGHTS.values(), test_closed_reference.test_blinn),
    blinn_kernels.phong_highlight: test_phong,
    groove_kernels.gaussian_grooves: test_closed_reference.test_oren_nayar_exact,
    slope_kernels.mean_slope_grooves: test_mean_slope.test_against_the_paper_s_equations,
    groove_kernels.isotropic_grooves: test_closed_reference.test_oren_nayar_single_slope,
    htsg_kernels.spike_reflectivity: test_htsg_reference.test_unpolarised,
    abg_kernels.abg: test_newer_models.test_public_digits,
    eon_kernels.eon: test_newer_models.test_public_digits,
    ggx_kernels.isotropic: test_newer_models.test_public_digits,
    ggx_kernels.anisotropic: test_newer_models.test_facets_of_one_width_are_isotropic,
    ggx_kernels.multiscatter: test_newer_models.test_a_mirror_s_facets_lose_no_light_between_them,
    **dict.fromkeys(
        (hapke_kernels.smooth, hapke_kernels.rough, hapke_kernels.scattered, k_correlation_kernels.first_order),
        test_newer_models.test_digits_at_the_edges,
    ),
    models.htsg._shadowing: test_htsg_reference.test_shadowing,
    models.htsg._effective_roughness: test_htsg_reference.test_effective_roughness,
    models.htsg._log_series: test_htsg_reference.test_series,
}
"""Kernels that are no model's BRDF, whose plain form takes a quadrature, or that others' digits hold: the tests."""


def ways(model: Model, at: Angles, every: bool) -> Iterator[tuple[str, Any]]:
    """The BRDF at vectors and at angles, and by every other method, each of which has a loop of its own."""
    light, view = direction(at[0], at[1]), direction(at[2], at[3])
    waves = [WAVELENGTH_NM, 1.1 * WAVELENGTH_NM]
    apart: Any = [a[:, None] for a in at]
    yield "vectors", model.brdf_vectors(light, view, wavelength_nm=WAVELENGTH_NM)
    yield "angles", model.brdf(*at, wavelength_nm=WAVELENGTH_NM)
    if not every:
        return
    yield "geometry", model.at(geometry(*at), wavelength_nm=WAVELENGTH_NM)
    yield "angles, wavelengths", model.brdf(*apart, wavelength_nm=waves)[:, 0]
    yield "vectors, wavelengths", model.brdf_vectors(light[:, None], view[:, None], wavelength_nm=waves)[:, 0]


@pytest.mark.parametrize("name", CASES)
def test_a_kernel_is_its_plain_function(name: str) -> None:
    case = CASES[name]
    at = pairs(21, 30)
    plain = case.plain(at)
    # a vector's components are rounded, an angle's sine and cosine are too: worth the tangents
    loss = (1.0 + case.loss(at)) * (1.0 + np.tan(at[0]) + np.tan(at[2]))
    for way, got in ways(case.model, at, name in IN_EVERY_LOOP or name.startswith("he-torrance")):
        try:
            agree(got, plain, loss, case.roundings, case.scale)
        except AssertionError as error:
            raise AssertionError(f"by {way}: {error}") from None


def kernels() -> set[Any]:
    """Everything in `gonio.models` that maps what depends on directions, and a tuple of constants, to a number."""
    found = set()
    for module in pkgutil.iter_modules(models.__path__, "gonio.models."):
        # parts of `lobe_state`'s series, whose p is a width
        if module.name == "gonio.models._htsg_series":
            continue
        names = vars(importlib.import_module(module.name))
        tables = [table.values() for table in names.values() if isinstance(table, dict)]
        for value in [*names.values(), *(value for table in tables for value in table)]:
            marked = inspect.isfunction(value) and value.__dict__.get("__device__")
            if marked and [*inspect.signature(value).parameters][-1:] in (["p"], ["constants"]):
                found.add(value)
    return found


def test_every_kernel_is_held_against_the_specification() -> None:
    held = {case.model._evaluation(WAVELENGTH_NM)[0] for case in CASES.values()} | set(ELSEWHERE)
    assert {f"{k.__module__}.{k.__name__}" for k in kernels() - held} == set()
    assert held <= kernels()
