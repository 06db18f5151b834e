"""Numbers of a model without a level of its own are at the measured level; what it says by itself stands beside."""

import numpy as np
import pytest
from gonio_analysis.appearance.of_models import MEASURED_LEVEL, of_fit
from gonio_analysis.fitting.energy import of_model, too_much
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.level import level
from gonio_analysis.report.verdict import reflectances

from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure

ROUGH = build("he-torrance", {"sigma0_um": 0.2, "tau_um": 1.5, "ior": 0.9 + 6.1j, "diffuse_albedo": 0.05})
PAINT = build("cook-torrance", {"s": 0.2, "d": 0.8, "slopes": ((0.2, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})
REFERENCE = 0.003


def fitted(seed: int = 0, reference: float = REFERENCE) -> FitResult:
    views = np.arange(-70.0, 71.0, 5.0)
    frame = measure(ROUGH, noise=0.004, floor=0.0, views=views, reference=reference, cone_sr=1e-3, seed=seed)
    return fit(frame, "he-torrance", ior=0.9 + 6.1j)


@pytest.mark.slow
def test_the_reference_is_in_the_uncertainty_and_the_condition_beside_the_digits() -> None:
    result = fitted()
    for r in of_model(result):
        value, u = known(r.rho_dh), known(r.u)
        assert u / value == pytest.approx(REFERENCE, rel=0.15)  # noise of 87 values adds to the reference
        assert known(r.u_given) < 0.3 * u
        true = float(ROUGH.directional_hemispherical(np.radians(r.theta_i_deg), tolerance=1e-6))
        assert abs(value - true) < 4 * u
        assert abs(known(r.given) - true) < 4 * known(r.u_given)
    said = reflectances("he-torrance", of_model(result), result.given)
    assert said.startswith("rho_dh, by angle of incidence at the measured level: ")
    assert "By he-torrance alone (given n, k): " in said
    eight = of_fit(result, name="rough").rho_dh_8
    (own,) = (r for r in of_model(result) if r.theta_i_deg == pytest.approx(8.0))
    # appearance follows the same rule; its slopes are taken over a tenth of a standard uncertainty
    assert eight.value == pytest.approx(known(own.rho_dh), rel=1e-4)
    assert eight.u == pytest.approx(known(own.u), rel=0.02)
    assert MEASURED_LEVEL in of_fit(result, name="rough").notes


@pytest.mark.slow
def test_a_scale_that_is_off_is_the_measurements_and_not_the_models() -> None:
    """A reference that is 1 % off and says so: n and k would take that for nothing, the measured level follows it."""
    frame = measure(ROUGH, noise=0.004, floor=0.0, cone_sr=1e-3, reference=0.01, seed=3)
    off = fit(frame, "he-torrance", ior=0.9 + 6.1j)
    found = known(level(off))
    true = measure(ROUGH, noise=0.0, floor=0.0, cone_sr=1e-3)
    assert found.off == pytest.approx(float(np.mean(frame["brdf"] / true["brdf"])) - 1.0, abs=0.0015)  # 3 of the noise
    assert found.u == pytest.approx(0.01, rel=0.1)


def test_a_model_that_has_a_level_states_one_number() -> None:
    result = fit(measure(PAINT, noise=0.01, floor=0.0, reference=0.01), "cook-torrance")
    assert level(result) is None
    for r in of_model(result):
        assert r.given is None
        assert known(r.u) > 0.009 * known(r.rho_dh)
    assert "alone" not in reflectances("cook-torrance", of_model(result), result.given)
    assert not too_much(of_model(result))
