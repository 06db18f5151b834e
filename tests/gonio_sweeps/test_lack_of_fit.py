"""Wrong models are noticed, and right ones are accused as seldom as is stated."""

from __future__ import annotations

import numpy as np
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_sweeps.model_fit import FALSE_ALARMS, LackOfFit, judge

from gonio.geometry import Directions

THETA_I = np.repeat([10.0, 30.0, 60.0], 12)
THETA_R = np.tile(np.linspace(-40.0, 70.0, 12), 3)
AT = Directions.from_degrees(THETA_I, 0.0, np.abs(THETA_R), np.where(THETA_R < 0, 0.0, 180.0))
LOBE = np.exp(-(((THETA_R - THETA_I) / 40.0) ** 2))
JACOBIAN = np.stack([LOBE, LOBE * ((THETA_R - THETA_I) / 40.0) ** 2], axis=1)
COVARIANCE = Covariance(0.005 * LOBE, 0.01 * LOBE[:, None], ("reference",))


def of(values: np.ndarray) -> LackOfFit:
    """The test of the best lobe through values."""
    white, design = COVARIANCE.whiten(values - LOBE), COVARIANCE.whiten(JACOBIAN)
    best = JACOBIAN @ np.linalg.lstsq(design, white, rcond=None)[0]
    return judge(values - LOBE - best, JACOBIAN, LOBE, COVARIANCE, AT)


def noisy(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(LOBE * (1.0 + 0.005 * rng.normal(size=36) + 0.01 * rng.normal()))


def test_p_values_of_right_models_are_not_too_small() -> None:
    rng = np.random.default_rng(1)
    found = np.array([of(noisy(rng)).p_value for _ in range(2000)])
    for level in (0.01, 0.05):
        # Bonferroni keeps to the level; four standard deviations of a binomial count above it
        assert np.mean(found < level) < level + 4.0 * np.sqrt(level * (1.0 - level) / 2000)
    assert np.mean(found < 0.05) > 0.02, "and the test is not blunt either"


def test_a_smooth_departure_is_noticed_before_single_values_stand_out() -> None:
    rng = np.random.default_rng(2)
    bent = [of(noisy(rng) * (1.0 + 0.01 * np.sin(np.radians(3.0 * THETA_R)))).p_value for _ in range(20)]
    assert np.median(bent) < 1e-3, "1 % at most, where noise is 0.5 %"


def test_all_looks_together_keep_the_stated_rate() -> None:
    spent = 0.0
    for look in range(10000):
        threshold = FALSE_ALARMS * 6.0 / (np.pi * (look + 1)) ** 2
        assert LackOfFit(0.0, 1, 0.999 * threshold).rejects(look)
        assert not LackOfFit(0.0, 1, 1.001 * threshold).rejects(look)
        spent += threshold
    assert spent <= FALSE_ALARMS


def test_too_few_values_accuse_nobody() -> None:
    few = np.arange(2)
    assert judge(np.array([1.0, -1.0]), JACOBIAN[few], LOBE[few], COVARIANCE.take(few), AT[few]).p_value == 1.0
