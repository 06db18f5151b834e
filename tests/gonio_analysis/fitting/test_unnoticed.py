"""The misfit that a model which is not rejected may have: it is added, and the test finds it in half of the cases."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import fit as fits
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.unnoticed import LARGEST, MOST_NODES, SMOOTH, half_found, smooth_root

from gonio.checks.values import SIGNIFICANCE
from gonio.geometry import Directions
from gonio.models import CookTorrance, Lambert
from gonio.typing import Floats

from ..synthetic import known, measure

METAL = CookTorrance(s=1.0, d=0.0, slopes=((0.09, 1.0),), ior=1.5, diffuse_albedo=0.0)
VIEWS = np.linspace(-75.0, 75.0, 31)


def metal(seed: int) -> pd.DataFrame:
    """Glossy, seven decades from the peak to the tails, where all is noise."""
    return measure(METAL, incidences=(15.0, 45.0, 65.0), views=VIEWS, noise=0.005, floor=1e-5, reference=0.003,
                   seed=seed)  # fmt: skip


def few(seed: int) -> pd.DataFrame:
    views = np.array([-60.0, -40.0, -20.0, 0.0, 40.0, 60.0, 75.0])
    return measure(Lambert(0.5), incidences=(20.0,), views=views, noise=0.003, floor=1e-6, reference=0.002, seed=seed)


def smooth(table: pd.DataFrame, rng: np.random.Generator) -> Floats:
    """A misfit of root mean square 1, worked out here without any low rank."""
    angles = (table[n].to_numpy() for n in ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"))
    omega_i, omega_r = Directions.from_degrees(*angles).vectors
    half = omega_i + omega_r
    places = np.hstack([half / np.linalg.norm(half, axis=1)[:, None], omega_r])
    kernel = np.exp(-0.5 * ((places[:, None] - places[None]) ** 2).sum(axis=2) / SMOOTH**2)
    drawn = np.linalg.cholesky(kernel + 1e-6 * np.eye(len(table))) @ rng.normal(size=len(table))
    return np.asarray(drawn / np.sqrt(np.mean(drawn**2)))


@pytest.mark.slow
@pytest.mark.parametrize(("make", "model"), [(metal, "cook-torrance"), (few, "lambert")])
def test_a_misfit_of_that_size_is_found_in_half_of_the_cases(
    make: Callable[[int], pd.DataFrame], model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = fit(make(1), model)
    size = known(base.tau).interval[1]
    asked = FitRequest(model, start=[base.problem.values(base.vector)])
    monkeypatch.setattr(fits, "nearest", lambda rejected, *_, **__: rejected)  # whether it is rejected is enough
    count = 30

    def found(times: float) -> float:
        out = 0
        for k in range(count):
            table = make(7000 + k)
            table["brdf"] *= 1.0 + times * size * smooth(table, np.random.default_rng(9000 + k))
            out += fit(table, asked).rejected
        return out / count

    # 1 % and about 50 and 95 % are expected; three standard deviations of 30 cases beside them
    assert found(0.0) <= 0.07
    assert 0.23 <= found(1.0) <= 0.77
    assert found(2.0) >= 0.80


def test_one_misfit_is_found_as_the_noncentral_chi_square_says() -> None:
    from scipy.stats import chi2, ncx2

    rng = np.random.default_rng(1)
    n, freedom = 50, 47
    shape, parameter = rng.normal(size=(n, 1)), rng.normal(size=(n, 1))
    u = 0.01
    size = half_found(shape, shape / u, parameter, freedom, SIGNIFICANCE)
    left = shape - parameter * np.sum(parameter * shape) / np.sum(parameter**2)
    raised = (size / u) ** 2 * float(np.sum(left**2) / np.mean(shape**2))
    # X is sought to 1e-4
    assert ncx2.sf(chi2.isf(SIGNIFICANCE, freedom), freedom, raised) == pytest.approx(0.5, abs=1e-3)


def test_what_parameters_take_up_is_never_found() -> None:
    shape = np.linspace(1.0, 2.0, 20)[:, None]
    noise = 1e-13 * np.random.default_rng(2).normal(size=shape.shape)
    assert half_found(shape, shape + noise, shape, 19, SIGNIFICANCE) == LARGEST


def test_values_near_zero_do_not_decide() -> None:
    """Half of the values are tails known to 1e-5 of the peak: on the scale of logarithms they made X 0.002 %."""
    table = metal(1)
    lit = table["brdf"].to_numpy() > 3.0 * table["u_brdf"].to_numpy()
    assert np.count_nonzero(~lit) >= 10
    some = table[lit].reset_index(drop=True)
    some.attrs.update(table.attrs)
    whole, without = (known(fit(t, "cook-torrance").tau).interval[1] for t in (table, some))
    # 93 values of 0.5 %, of which some tens are lit: neither a tenth of that nor several times as much
    assert 0.002 < whole < 0.02
    # the dark ones are among the degrees of freedom, and misfits have their root mean square over them too
    assert without <= whole < 1.6 * without  # (93/60)^(1/4) of one, and up to (93/60)^(1/2) of the other


def test_a_low_rank_holds_what_the_kernel_does() -> None:
    rng = np.random.default_rng(6)
    count = 5 * MOST_NODES
    at = Directions.from_degrees(
        rng.uniform(5, 65, count), np.zeros(count), rng.uniform(0, 75, count), rng.uniform(0, 180, count)
    )
    root = smooth_root(at)
    assert root.shape == (count, MOST_NODES)
    np.testing.assert_allclose((root**2).sum(axis=1), 1.0, rtol=1e-9)
    omega_i, omega_r = at.vectors
    half = omega_i + omega_r
    places = np.hstack([half / np.linalg.norm(half, axis=1)[:, None], omega_r])
    kernel = np.exp(-0.5 * ((places[:, None] - places[None]) ** 2).sum(axis=2) / SMOOTH**2)
    # 200 nodes over a hemisphere of sources and of detectors stand some 10 degrees apart, half of the length
    assert np.sqrt(np.mean((root @ root.T - kernel) ** 2)) < 0.03
