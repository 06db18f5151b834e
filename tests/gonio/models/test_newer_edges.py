"""The newer models at their edges: 60 digits of mpmath, energy at grazing, rho_dh of narrow facets, GGX in sums."""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from gonio_analysis.fitting.fit import fit

from gonio import models
from gonio.models import Model, build
from tests.gonio.models import newer_oracles
from tests.gonio.models.oracles import conditioning
from tests.gonio_analysis.synthetic import measure

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


@pytest.mark.parametrize("r", [1e-9, 0.3, 1.0])
def test_eon_s_furnace_down_to_grazing(r: float) -> None:
    angles = np.radians([0.0, 60.0, 85.0, 89.9, 89.99, 89.9999])
    assert models.EON(1.0, r).directional_hemispherical(angles) == pytest.approx(1.0, abs=1e-15)
    summed = Model._hemispherical(models.EON(1.0, r), angles, np.zeros(6), 550.0, False, 1e-7)
    assert summed == pytest.approx(1.0, abs=1e-7)  # what the rule was asked for


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
