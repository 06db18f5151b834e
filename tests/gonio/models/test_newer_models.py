"""GGX, EON, ABg, K-correlation, Hapke and RPV: others' digits, energy, reciprocity, edges, and that fits find them."""

import json
import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit

from gonio import materials, models
from gonio.errors import ArgumentError
from gonio.models import Model, build, fresnel
from tests.gonio.models import newer_oracles
from tests.gonio.models.oracles import conditioning
from tests.gonio_analysis.synthetic import measure
from tests.places import REFERENCE

PUBLIC = json.loads((REFERENCE / "newer_models_public.json").read_text(encoding="utf-8"))
ALL: list[Any] = [
    models.GGX(0.2, 1.5 + 3j),
    models.GGX(0.2, 1.5, 0.1, alpha_y=0.5),
    models.GGXMultiscatter(0.4, 1.5),
    models.EON(0.7, 0.6),
    models.ABg(1e-3, 1e-4, 2.0),
    models.Hapke(0.6, 0.06, 1.0),
    models.Hapke(0.8, 0.1, 0.5, 0.3, 25.0, "2002"),
    models.RPV(0.1, -0.5, 0.5),
    models.KCorrelation(0.003, 20.0, 1.8, "Al"),
]
NAMES = [f"{k} {m.name}" for k, m in enumerate(ALL)]
GRAZING = np.radians([0.0, 10.0, 45.0, 80.0, 89.0, 89.99])


def of_case(name: str, p: dict[str, float]) -> Any:
    return build(name, {"alpha": p["alpha"], "ior": complex(p["n"], p["k"])} if name == "ggx" else p)


@pytest.mark.parametrize("name", ["eon", "ggx", "abg"])
def test_public_digits(name: str) -> None:
    """Computed by others to 25 digits; a formula of some tens of operations keeps 1e-12."""
    for case in PUBLIC[name]:
        at = (case["theta_i_deg"], 0.0, case["theta_r_deg"], case["dphi_deg"])
        value = of_case(name, case["parameters"]).brdf(*np.radians(at))
        assert value == pytest.approx(float(case["brdf"]), rel=1e-12), case


def test_the_digits_of_vlidort_s_kernels() -> None:
    """VLIDORT's table is pi brdf times 0.99, its azimuth 180 degrees from ours; printed to 8 digits."""
    for model, digits in (
        (models.RPV(0.1, -0.5, 0.5), (0.22766692, 0.29628877, 0.48588198)),
        (models.Hapke(0.6, 0.06, 1.0), (0.18424879, 0.19048329, 0.20382905)),
    ):
        found = [0.99 * math.pi * model.brdf(*np.radians([35.0, 0.0, 10.0, 180.0 - d])) for d in (0.0, 79.0, 180.0)]
        assert found == pytest.approx(digits, abs=6e-9)


@pytest.mark.parametrize("rho", [1.0, 0.9])
@pytest.mark.parametrize("r", [0.0, 1e-9, 0.4, 1.0])
def test_eon_loses_no_light(rho: float, r: float) -> None:
    model, angles = models.EON(rho, r), np.append(GRAZING, np.radians(89.9999))
    closed = model.directional_hemispherical(angles)
    if rho == 1.0:
        assert closed == pytest.approx(1.0, abs=1e-14 if r == 0.0 else 1e-15)
    summed = models.Model._hemispherical(model, angles, np.zeros(7), 550.0, False, 1e-7)
    assert summed == pytest.approx(closed, abs=1e-7)  # what the rule was asked for


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1e-3, 0.01, 0.05, 0.3, 0.7, 1.0])
def test_a_mirror_s_facets_lose_no_light_between_them(alpha: float) -> None:
    """n = 1e-3, k = 1e4 reflects all but 4e-7. The stated error of the energy is 1e-3."""
    model = models.GGXMultiscatter(alpha, complex(1e-3, 1e4))
    assert model.directional_hemispherical(GRAZING, tolerance=1e-5) == pytest.approx(1.0, abs=1e-3)


def test_single_facets_lose_what_others_found() -> None:
    """The furnace of single GGX at 60 degrees: .86, .66 and .45 for roughness .5, .75 and 1, whose square is alpha."""
    found = [
        float(models.GGX(x * x, complex(1e-3, 1e4)).directional_hemispherical(math.pi / 3, tolerance=1e-5))
        for x in (0.5, 0.75, 1.0)
    ]
    assert found == pytest.approx([0.86, 0.66, 0.45], abs=0.006)  # two digits are known


def test_facets_of_one_width_are_isotropic() -> None:
    at = np.radians([40.0, 10.0, 55.0, 150.0])
    assert models.GGX(0.3, 1.5, alpha_y=0.3 * (1 + 1e-12)).brdf(*at) == pytest.approx(models.GGX(0.3, 1.5).brdf(*at))
    turned = models.GGX(0.3, 1.5, alpha_y=0.1).brdf(at[0], at[1] + math.pi / 2, at[2], at[3] + math.pi / 2)
    assert models.GGX(0.1, 1.5, alpha_y=0.3).brdf(*at) == pytest.approx(turned)


@pytest.mark.parametrize(
    "model",
    [models.GGX(1e-3, "Al"), models.GGXMultiscatter(1e-3, "Al"), models.EON(1.0, 1.0), models.ABg(1.0, 1e-9, 0.0)],
    ids=lambda m: m.name,
)
def test_edges_have_values(model: Any) -> None:
    theta = np.append(GRAZING, math.pi / 2)
    i, r = (x.ravel() for x in np.meshgrid(theta, theta))
    for phi in (0.0, 0.5 * math.pi, math.pi):
        values = model.brdf(i, 0.0, r, phi)
        assert not np.isnan(values).any()
        assert np.all(values >= 0.0)


def test_scattered_light_is_what_tis_says() -> None:
    """At normal incidence, to first order in (4 pi sigma/lambda)^2 = 0.0016, and to the cosines that TIS leaves out."""
    model = models.KCorrelation(0.002, 60.0, 1.8, "Al")
    scattered = float(model.directional_hemispherical(0.0, spike=False, wavelength_nm=633.0, tolerance=1e-5))
    mirror = float(fresnel.reflectance(1.0, complex(materials.ior("Al")(633.0))))
    assert scattered / mirror == pytest.approx(model.tis(633.0), rel=0.01)
    assert float(model.specular_reflectivity(0.0, wavelength_nm=633.0)) + scattered == pytest.approx(mirror, rel=1e-4)


def test_scatter_scales_with_the_wavelength() -> None:
    """Of a perfect conductor in the plateau of the spectrum: as 1/lambda^4."""
    model = models.KCorrelation(0.001, 0.05, 2.0, complex(1e-3, 1e4))
    at = np.radians([5.0, 0.0, 20.0, 180.0])
    ratio = model.brdf(*at, wavelength_nm=500.0) / model.brdf(*at, wavelength_nm=1000.0)
    assert ratio == pytest.approx(16.0, rel=0.005)  # B f is 0.03: a spectrum white to (B f)^2


@pytest.mark.parametrize(
    ("name", "parameters", "ior"),
    [
        ("ggx", {"alpha": 0.25, "ior": 1.5, "diffuse_albedo": 0.1}, 1.5),
        ("ggx-multiscatter", {"alpha": 0.4, "ior": 1.5, "diffuse_albedo": 0.1}, 1.5),
        ("eon", {"rho": 0.6, "r": 0.7}, None),
        ("abg", {"A": 0.01, "B": 0.002, "g": 1.8}, None),
        ("k-correlation", {"sigma_um": 0.01, "b_um": 5.0, "c": 2.2, "ior": "Al"}, "Al"),
        ("hapke", {"w": 0.7, "h": 0.2, "b0": 0.6, "b": 0.3, "theta_bar_deg": 15.0}, None),
        ("rpv", {"rho_0": 0.2, "theta_g": -0.2, "k": 0.8}, None),
    ],
)
def test_a_fit_finds_what_made_the_values(name: str, parameters: dict[str, Any], ior: Any) -> None:
    found = fit(measure(build(name, parameters), noise=0.002, floor=1e-7), name, ior=ior)
    for key, value in parameters.items():
        if key == "ior":
            continue
        e = found.parameters[key]
        assert e.u is not None
        assert abs(e.value - value) <= 4.5 * e.u, key  # one of 16 beyond 4.5 standard errors: 1e-4


def test_a_grain_is_fitted_where_it_is_freed() -> None:
    one = measure(build("ggx", {"alpha": 0.2, "alpha_y": 0.5, "ior": 1.5}), noise=0.002, floor=1e-7)
    turned = one.assign(phi_i_deg=90.0, phi_r_deg=(one["phi_r_deg"] + 90.0) % 360.0)
    across = models.GGX(0.2, 1.5, alpha_y=0.5)
    angles = [np.radians(turned[name].to_numpy()) for name in ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")]
    both = pd.concat([one, turned.assign(brdf=across.brdf(*angles))], ignore_index=True)
    both.attrs = one.attrs
    found = fit(both, "ggx", ior=1.5, free=("alpha_y",)).parameters
    assert found["alpha"].value == pytest.approx(0.2, rel=0.01)  # 2e-3 of noise
    assert found["alpha_y"].value == pytest.approx(0.5, rel=0.01)
    plain = fit(measure(build("ggx", {"alpha": 0.2, "ior": "Al"})), "ggx", ior="Al").parameters
    assert "alpha_y" not in plain
    assert plain["k"].material == "Al"


@pytest.mark.parametrize(
    ("kind", "parameters", "said"),
    [
        (models.GGX, {"alpha": 0.0}, "alpha"),
        (models.GGX, {"alpha_y": 2.0}, "alpha_y"),
        (models.GGXMultiscatter, {"alpha": 1e-4}, r"alpha = 0\.0001: must be finite and in \[0\.001, 1\]"),
        (models.GGXMultiscatter, {"alpha_y": 0.2}, "alpha_y"),
        (models.EON, {"r": 1.1}, "r = 1.1"),
        (models.ABg, {"B": 0.0}, "B = 0"),
        (models.Hapke, {"theta_bar_deg": 80.0}, "theta_bar_deg"),
        (models.Hapke, {"h_function": "2003"}, "h_function"),
        (models.RPV, {"theta_g": 1.0}, "theta_g"),
        (models.KCorrelation, {"c": 1.0}, "c = 1"),
    ],
)
def test_what_is_out_of_range_is_named(kind: Any, parameters: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        kind(**parameters)


# ---- The newer models at their edges: 60 digits of mpmath, energy at grazing, rho_dh of narrow facets, GGX in
# sums


D = math.radians
G = D(89.99)
AT = [
    (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, D(40), 0.3), (D(40), 0.2, 0.0, 0.0), (1e-6, 0.0, 2e-6, math.pi),
    (1e-6, 0.0, 1e-6, 0.0), (D(1e-3), 0.0, D(50), 1.0), (D(1e-5), 0.0, G, 1.0),
    (D(45), 0.0, D(45), math.pi), (D(45), 0.0, D(45), 0.0), (D(45), 0.0, D(45), 1e-9), (D(45), 0.0, D(45) + 1e-9, 0.0),
    (D(45), 0.0, D(45), math.pi - 1e-9), (D(45), 0.7, D(30), 0.7 + 1e-7), (D(45), 0.0, D(30), math.pi / 2),
    (D(30), 0.0, D(60), math.pi), (G, 0.0, G, math.pi), (G, 0.0, G, 0.0), (G, 0.0, G, 1e-6), (G, 0.0, G, math.pi / 2),
    (G, 0.0, D(10), math.pi), (D(10), 0.0, G, 0.0), (G, 0.0, 0.0, 0.0), (G, 0.0, D(89.98), math.pi),
]  # fmt: skip
"""Normal, mirror and retro to the last digit and a little off, grazing."""
CASES: list[tuple[Model, Callable[..., Any], dict[str, Any]]] = [
    *((models.GGX(a, n), newer_oracles.ggx, {"alpha": a, "ior": n})
      for a in (1e-3, 0.1, 1.0) for n in (1.5, 1.001, 0.2 + 3j, 0.5)),
    (models.GGX(1e-3, 1.5 + 3j, alpha_y=0.8), newer_oracles.ggx, {"alpha": 1e-3, "ior": 1.5 + 3j, "alpha_y": 0.8}),
    *((models.EON(rho, r), newer_oracles.eon, {"rho": rho, "r_": r}) for rho in (1e-6, 1.0) for r in (0.0, 1e-9, 1.0)),
    *((models.ABg(A, B, g), newer_oracles.abg, {"A": A, "B": B, "g": g})
      for A, B, g in ((1.0, 1e-9, 0.0), (1e-3, 1e-12, 1.5), (1.0, 1e-12, 20.0))),
    *((models.RPV(rho, q, k), newer_oracles.rpv, {"rho_0": rho, "theta_g": q, "k": k})
      for rho, q, k in ((0.1, -0.5, 0.5), (1.0, -0.9999, 0.0), (0.1, 0.9999, 3.0))),
    *((models.Hapke(w, h, b0, b, t, f), newer_oracles.hapke,
       {"w": w, "h": h, "b0": b0, "b_": b, "theta_bar_deg": t, "h_function": f})
      for w, h, b0, b in ((0.6, 0.06, 1.0, 0.5), (1.0, 1e-3, 1.0, -1.0), (1e-3, 2.0, 0.0, 1.0))
      for t in (0.0, 1e-3, 25.0, 60.0) for f in ("1981", "2002")),
    *((models.KCorrelation(s, b, c, n), newer_oracles.k_correlation,
       {"sigma_um": s, "b_um": b, "c": c, "ior": n, "nm": 550.0})
      for s, b, c in ((0.005, 50.0, 2.0), (1e-5, 0.01, 1.01)) for n in (1.5, 1.001, 0.2 + 3j)),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("model", "formula", "p"), CASES, ids=[f"{k} {m.name}" for k, (m, *_) in enumerate(CASES)])
def test_digits_at_the_edges(model: Model, formula: Callable[..., Any], p: dict[str, Any]) -> None:
    """1e-12 of the value, times 1 + conditioning: tens of roundings, and the directions are made of angles first."""
    for at in AT:

        def value(*angles: Any) -> Any:
            return formula(*angles, **p)

        wanted = value(*[mp.mpf(x) for x in at])
        off = abs(float(mp.mpf(float(model.brdf(*at))) / wanted - 1))
        assert off <= 1e-12 or off <= 1e-12 * (1.0 + conditioning(value, at)), at


def test_eon_forward_at_grazing_is_right_to_its_last_digits() -> None:
    """Where 1 + r s/t and 1 - E both vanish; from vectors, which leave the angles' own conditioning out."""
    for deg in (80.0, 89.0, 89.99):
        s, c = math.sin(D(deg)), math.cos(D(deg))
        light, view = np.array([s, 0.0, c]), np.array([-s, 0.0, c])
        theta = mp.atan2(mp.mpf(s), mp.mpf(c))
        wanted = float(newer_oracles.eon(theta, mp.mpf(0), theta, mp.pi, rho=1.0, r_=1.0))
        assert models.EON(1.0, 1.0).brdf_vectors(light, view) == pytest.approx(wanted, rel=1e-14)  # tens of roundings


@pytest.mark.parametrize("index", [1.5, 0.2 + 3j, 1e-3 + 1e4j], ids=str)
@pytest.mark.parametrize("alpha", [1e-4, 0.01, 0.1, 1.0])
def test_what_narrow_facets_reflect_is_found_at_every_angle(alpha: float, index: complex) -> None:
    """Without a tolerance of one's own; a narrow lobe at 8 degrees reflects what a mirror does, but for its tails."""
    model = models.GGX(alpha, index)
    angles = np.radians([0.0, 8.0, 30.0, 60.0, 85.0, 89.99, 90.0])
    shares = model.directional_hemispherical(angles)
    assert np.all((shares > 0.0) & (shares <= 1.0))
    if alpha <= 0.01:  # facets beyond 45 degrees: alpha^2 of them
        mirror = models.fresnel.reflectance(np.cos(angles[:4]), index)
        assert shares[:4] == pytest.approx(mirror, rel=20 * alpha**2 + 1e-6, abs=4 * alpha**2)


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "index"), [(0.1, 1.5), (0.4, 1.4 + 7.5j), (1.0, 0.2 + 3j)])
def test_what_facets_reflect_is_the_sum_over_directions(alpha: float, index: complex) -> None:
    model, angles = models.GGX(alpha, index), np.radians([0.0, 45.0, 80.0])
    summed = Model._hemispherical(model, angles, np.zeros(3), 550.0, False, 1e-5)
    assert model.directional_hemispherical(angles) == pytest.approx(summed, rel=2e-5)  # the sum's tolerance, twice


@pytest.mark.parametrize(("base", "ior"), [("oren-nayar", "Al"), ("eon", 1.5), ("lambert", 0.2 + 3j)])
def test_ggx_over_a_base_is_fitted(base: str, ior: Any) -> None:
    matte = {
        "oren-nayar": {"albedo": 0.3, "sigma_deg": 20.0},
        "eon": {"rho": 0.3, "r": 0.6},
        "lambert": {"albedo": 0.3},
    }
    given = [ior.real, ior.imag] if isinstance(ior, complex) else ior
    made = build("sum", {base: {"weight": 1.0, **matte[base]}, "ggx": {"weight": 0.6, "alpha": 0.2, "ior": given}})
    found = fit(measure(made, noise=0.002, floor=1e-7), f"{base}+ggx", ior=ior).parameters
    for name, value in {**matte[base], "weight": 0.6, "alpha": 0.2}.items():
        u = found[name].u
        assert u is not None
        assert abs(found[name].value - value) <= 4.5 * u  # one of some ten beyond 4.5 standard errors: 1e-4
