"""float32, `out=`, wavelengths on their own axis, and what a checked geometry keeps, against the plain call."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from gonio.errors import ArgumentError
from gonio.models import (
    AnisotropicFacets,
    Blinn,
    CookTorrance,
    HeTorrance,
    Lambert,
    Model,
    OrenNayar,
    Phong,
    Sum,
    geometry,
)
from gonio.models._loops import BLOCK
from tests.gonio.models.agreement import drawn_vectors

RNG = np.random.default_rng(16)
CLOSED = [
    Lambert(0.3),
    Phong(),
    Blinn(),
    Blinn(distribution="phong", c=20.0, ior=1.5),
    Blinn(distribution="gaussian", c=3.0, ior=0.6 + 2.0j),
    CookTorrance(d=0.0),
    CookTorrance(s=0.5, d=0.5, diffuse_albedo=0.4, slopes=0.3, ior=1.5),
    CookTorrance(distribution="gaussian"),
    CookTorrance(f0=0.04, fresnel="schlick"),
    OrenNayar(),
    OrenNayar(form="qualitative"),
    HeTorrance(),
    HeTorrance(sigma0_um=0.16, tau_um=1.5, ior="Al", diffuse_albedo=0.0),
]
PATHS = [CookTorrance(), HeTorrance(), OrenNayar(form="single-slope", slope_deg=20, groove_azimuth_deg=30)]
"""One model for each way through the engine: by columns, in several passes, by absolute azimuths."""
ALL = [*CLOSED, OrenNayar(form="single-slope", slope_deg=20, groove_azimuth_deg=30)]


pairs = partial(drawn_vectors, RNG)


def unit(x: np.ndarray) -> np.ndarray:
    exact = x.astype(np.float64)
    return exact / np.linalg.norm(exact, axis=-1, keepdims=True)


def hard_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Normal and grazing incidence, retro, mirror and forward grazing, and near them."""
    theta = np.array([0.0, 1e-4, 1e-2, 0.5, 1.0, 1.5, 1.57, 1.5707])
    away = np.array([0.0, 1e-6, 1e-3, 0.1])
    ti, off, dphi, tilt = np.meshgrid(theta, away, [0.0, 1e-4, np.pi / 2, np.pi - 1e-4, np.pi], [-1, 1], indexing="ij")
    tr = np.clip(ti + tilt * off, 0.0, 1.5707).ravel()
    ti, dphi = ti.ravel(), dphi.ravel()
    light = np.stack([np.sin(ti), 0.0 * ti, np.cos(ti)], axis=-1)
    return light, np.stack([np.sin(tr) * np.cos(dphi), np.sin(tr) * np.sin(dphi), np.cos(tr)], axis=-1)


# --- float32 --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("model", CLOSED, ids=repr)
def test_float32_vectors_give_float32_results_within_the_stated_error(model: Model) -> None:
    light, view = (np.concatenate(both).astype(np.float32) for both in zip(pairs(20_000), hard_pairs(), strict=True))
    found = model.brdf_vectors(light, view)
    assert found.dtype == np.float32
    expected = np.asarray(model.brdf_vectors(unit(light), unit(view)))
    assert not np.isnan(found).any()
    lit = np.abs(expected) > 1e-25  # float32 has fewer digits below 1e-38 / conditioning, and 0 below
    # docs/reference/models_evaluation.md: rounding of the inputs' components, 6e-8 / cos(theta), and of twenty steps
    grazing = np.minimum(light[:, 2], view[:, 2])
    error = np.abs(found.astype(np.float64) - expected) / np.maximum(np.abs(expected), 1e-25)
    random_lit = lit & (grazing > 0.01)
    random_lit[20_000:] = False
    assert error[random_lit].max() < 3e-5
    # He-Torrance's exponents are rounded, too, and its series is the one for 1e-6
    assert np.median(error[random_lit]) < (6e-7 if isinstance(model, HeTorrance) else 4e-7)
    # hard directions: 3e-5 away from grazing, and toward it what rounding does to a cosine, 1e-6 / cos (docs)
    hard = lit & np.isfinite(expected)
    hard[:20_000] = False
    assert np.all(error[hard] <= 3e-5 + 1e-6 / grazing[hard])


def test_float32_is_evaluated_in_float64_where_its_range_does_not_hold() -> None:
    light, view = (x.astype(np.float32) for x in pairs(500))
    for model in (
        CookTorrance(slopes=50.0),
        Blinn(c=1e-3),
        CookTorrance(ior=1e7),
        HeTorrance(tau_um=1e6),
        AnisotropicFacets(0.2, 0.5, 30.0),
        OrenNayar(form="exact"),
    ):
        n = 20 if isinstance(model, OrenNayar) else 500
        found = model.brdf_vectors(light[:n], view[:n])
        expected = model.brdf_vectors(light[:n].astype(np.float64), view[:n].astype(np.float64))
        np.testing.assert_array_equal(found, expected.astype(np.float32))


def test_float32_angles_are_evaluated_in_float64() -> None:
    theta = np.array([0.0, 0.5, 1.5], np.float32)
    found = CookTorrance().brdf(theta, 0.0, theta, 3.0)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, CookTorrance().brdf(theta.astype(float), 0.0, theta.astype(float), 3.0))


def test_one_float64_array_makes_the_result_float64() -> None:
    light, view = pairs(5)
    assert CookTorrance().brdf_vectors(light.astype(np.float32), view).dtype == np.float64
    assert CookTorrance().brdf_vectors(light.astype(np.float32), [0.0, 0.0, 1.0]).dtype == np.float64


def test_bad_float32_vectors_are_named() -> None:
    light, view = (x.astype(np.float32) for x in pairs(100))
    view[40] *= np.float32(1.01)
    with pytest.raises(ArgumentError, match=r"omega_r.*\(40,\)"):
        CookTorrance().brdf_vectors(light, view)
    view[40] = np.nan
    with pytest.raises(ArgumentError, match="omega_r"):
        Blinn().brdf_vectors(light, view)


# --- out= -----------------------------------------------------------------------------------------------------------


def calls(n: int) -> list[tuple[str, Callable[..., Any], tuple[int, ...]]]:
    light, view = pairs(n)
    angles = np.arccos(light[:, 2]), 0.1, np.arccos(view[:, 2]), np.arctan2(view[:, 1], view[:, 0])
    where = geometry(*angles)
    waves = np.array([[450.0], [650.0]])
    by_model = [
        call
        for m in (*PATHS, Sum((Lambert(), 0.5), (CookTorrance(), 0.5)))
        for call in (
            (f"{m.name} brdf", partial(m.brdf, *angles), (n,)),
            (f"{m.name} brdf_vectors", partial(m.brdf_vectors, light, view), (n,)),
            (f"{m.name} at", partial(m.at, where), (n,)),
        )
    ]
    return [
        *by_model,
        ("phong highlight", partial(Phong().highlight, *angles), (n,)),
        ("blinn highlight", partial(Blinn().highlight, *angles), (n,)),
        ("specular", partial(CookTorrance().specular, *angles), (n,)),
        ("rho_s", partial(HeTorrance().specular_reflectivity, angles[0]), (n,)),
        ("mueller", partial(HeTorrance().mueller, *angles), (n, 4, 4)),
        ("wavelengths", partial(HeTorrance().brdf, *angles, wavelength_nm=waves), (2, n)),
    ]


def test_out_takes_the_result_wherever_it_lies() -> None:
    for name, call, shape in calls(40):
        expected = call()
        whole = np.full(shape, 7.0)
        assert call(out=whole) is whole, name
        np.testing.assert_array_equal(whole, expected, err_msg=name)
        strided = np.full((2 * shape[0], *shape[1:]), 7.0)
        call(out=strided[::2])
        np.testing.assert_array_equal(strided[::2], expected, err_msg=name)
        np.testing.assert_array_equal(strided[1::2], 7.0, err_msg=name)


def test_out_of_another_shape_or_type_is_refused() -> None:
    frozen = np.zeros(40)
    frozen.flags.writeable = False
    for _, call, shape in calls(40):
        for bad in (np.zeros((*shape, 1)), np.zeros(shape, np.float32), np.zeros(shape, int), [0.0] * 40, frozen):
            with pytest.raises(ArgumentError, match="out"):
                call(out=bad)


def test_out_may_overlap_the_arguments() -> None:
    light, view = pairs(50)
    expected = CookTorrance().brdf_vectors(light, view)
    target = light.reshape(-1)[:50]
    CookTorrance().brdf_vectors(light, view, out=target)
    np.testing.assert_array_equal(target, expected)
    theta = np.linspace(0.0, 1.5, 50)
    expected = Sum((Lambert(), 1.0), (CookTorrance(), 1.0)).brdf(theta, 0.0, 0.3, 3.0)
    Sum((Lambert(), 1.0), (CookTorrance(), 1.0)).brdf(theta, 0.0, 0.3, 3.0, out=theta)
    np.testing.assert_array_equal(theta, expected)


def test_nothing_is_written_into_out_when_an_argument_is_refused() -> None:
    light, view = pairs(3 * BLOCK)
    bad = view.copy()
    bad[-1] = np.nan
    theta = np.full(len(light), 0.3)
    theta[-1] = 1.6
    out = np.full(len(light), 7.0)
    for model in PATHS:
        with pytest.raises(ArgumentError, match="omega_r"):
            model.brdf_vectors(light, bad, out=out)
        with pytest.raises(ArgumentError, match="theta_r"):
            model.brdf(0.3, 0.0, theta, 1.0, out=out)
    single = np.full(len(light), 7.0, np.float32)
    with pytest.raises(ArgumentError, match="omega_r"):
        CookTorrance().brdf_vectors(light.astype(np.float32), bad.astype(np.float32), out=single)
    np.testing.assert_array_equal(out, 7.0)
    np.testing.assert_array_equal(single, 7.0)


# --- a checked geometry ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ALL, ids=repr)
def test_a_checked_geometry_gives_what_its_vectors_give(model: Model) -> None:
    light, view = pairs(300)
    where = geometry(
        np.arccos(light[:, 2]),
        np.arctan2(light[:, 1], light[:, 0]),
        np.arccos(view[:, 2]),
        np.arctan2(view[:, 1], view[:, 0]),
    )
    expected = model.brdf_vectors(where.omega_i.reshape(-1, 3), where.omega_r.reshape(-1, 3))
    # the same formula; the vectors' lengths are not taken out again: some last digits, times tan^2/m^2 (below 100)
    np.testing.assert_allclose(model.at(where), expected, rtol=1e-12)


def test_parameter_sets_share_what_the_directions_give() -> None:
    where = geometry(np.linspace(0.0, 1.5, 20), 0.0, 0.3, 3.0)
    CookTorrance(slopes=0.1).at(where)
    CookTorrance(slopes=((0.2, 0.5), (0.4, 0.5)), ior=1.5).at(where)
    (kept,) = where._kept.values()
    Blinn(distribution="gaussian").at(where)
    CookTorrance(distribution="gaussian").at(where)
    assert len(where._kept) == 2
    assert kept.shape == (4 * 20,)


def test_a_real_index_is_the_limit_of_a_complex_one() -> None:
    light, view = (np.concatenate(both) for both in zip(pairs(2000), hard_pairs(), strict=True))
    makers: tuple[Callable[[complex], Model], ...] = (
        lambda ior: CookTorrance(ior=ior),
        lambda ior: CookTorrance(ior=ior, distribution="gaussian"),
        *(lambda ior, d=d: Blinn(ior=ior, distribution=d) for d in ("phong", "gaussian", "trowbridge-reitz")),
    )
    for make in makers:
        for n in (0.5, 1.0 + 1e-9, 1.5, 200.0):
            # k = 1e-18 changes F by less than 1e-15, but where 1 - n is as small, and at the critical angle
            real, nearly = (make(ior).brdf_vectors(light, view) for ior in (n, complex(n, 1e-18)))
            np.testing.assert_allclose(real, nearly, rtol=1e-8 if n == 0.5 else 1e-13)


# --- wavelengths ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("model", [HeTorrance(ior="Al", diffuse_albedo=0.1), CookTorrance(ior="Cu")], ids=repr)
def test_wavelengths_on_an_axis_of_their_own(model: Model) -> None:
    light, view = pairs(30)
    light[3, 2] *= -1.0  # below the surface
    angles = [np.arccos(np.abs(light[:, 2])), np.zeros(30), np.arccos(view[:, 2]), np.linspace(0.0, 6.0, 30)]
    waves = np.array([650.0, 450.0, 550.0, 450.0])
    one = np.stack([model.brdf(*angles, wavelength_nm=w) for w in waves])
    # shadowing and the effective roughness are multiplied in another order: some last digits
    for shape in ((4, 1), (4, 1, 1)):
        found = model.brdf(*angles, wavelength_nm=waves.reshape(shape))
        np.testing.assert_allclose(found, one.reshape(*shape[:-1], 30), rtol=1e-13)
    np.testing.assert_allclose(model.brdf(*(a[:, None] for a in angles), wavelength_nm=waves), one.T, rtol=1e-13)
    grid = model.brdf(angles[0][:, None, None], 0.0, angles[2][:5], 1.0, wavelength_nm=waves[:, None])
    assert grid.shape == (30, 4, 5)
    np.testing.assert_allclose(grid[7, 2, 3], model.brdf(angles[0][7], 0.0, angles[2][3], 1.0), rtol=1e-13)
    along = model.brdf(*angles, wavelength_nm=np.resize(waves, 30))
    np.testing.assert_allclose(along, [one[k % 4, k] for k in range(30)], rtol=1e-13)
    by_vectors = model.brdf_vectors(light, view, wavelength_nm=waves[:, None])
    np.testing.assert_allclose(
        by_vectors, [model.brdf_vectors(light, view, wavelength_nm=w) for w in waves], rtol=1e-13, atol=0
    )
    assert by_vectors[0, 3] == 0.0


def test_bad_arguments_beside_wavelengths_are_named() -> None:
    waves = np.array([[450.0], [550.0]])
    for model in (HeTorrance(), CookTorrance()):
        with pytest.raises(ArgumentError, match="theta_r"):
            model.brdf(0.1, 0.0, [0.2, 1.6], 0.0, wavelength_nm=waves)
        with pytest.raises(ArgumentError, match="omega_i"):
            model.brdf_vectors([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]], [0.0, 0.0, 1.0], wavelength_nm=waves)
        with pytest.raises(ArgumentError, match="wavelength_nm"):
            model.brdf(0.1, 0.0, [0.2, 0.3], 0.0, wavelength_nm=[[500.0], [np.nan]])
        with pytest.raises(ArgumentError, match="wavelength_nm"):
            model.brdf_vectors([[0.0, 0.0, 1.0]] * 2, [0.0, 0.0, 1.0], wavelength_nm=[500.0, 600.0, 700.0])
        assert model.brdf(np.zeros((0, 1)), 0.0, 0.1, 0.2, wavelength_nm=[500.0, 600.0]).shape == (0, 2)
