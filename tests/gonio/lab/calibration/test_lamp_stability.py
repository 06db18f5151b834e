"""Warm-up, drift and noise of a lamp: recovered with honest uncertainties, refused where the model does not hold."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gonio.errors import ConfigError, DataError
from gonio.lab.calibration import lamp_stability
from gonio.typing import Floats

LOSS, TAU, DRIFT, NOISE, SHOT = 0.08, 420.0, 0.012, 0.003, 0.0005


def times(duration: float = 3600.0) -> Floats:
    """Bursts of four frames every 16 s."""
    starts = np.arange(0.0, duration, 16.0)
    return np.asarray(np.repeat(starts, 4) + np.tile(np.arange(4) * 0.06, starts.size))


def level(t: Floats, loss: float = LOSS) -> Floats:
    return np.asarray(1000.0 * (1.0 - loss * np.exp(-t / TAU) + DRIFT / 3600.0 * t))


def noisy(t: Floats, seed: int, clean: Floats) -> Floats:
    rng = np.random.default_rng(seed)
    return np.asarray(clean * (1.0 + NOISE * rng.standard_normal(t.size) + SHOT * rng.standard_normal(t.size)))


def test_pulls_of_forty_series_have_unit_spread() -> None:
    """Of level, loss, time constant, drift, noise. Forty pulls have a spread of 1 +- 0.11 and a mean of 0 +- 0.16."""
    pulls = []
    for seed in range(40):
        t = times()
        found = lamp_stability.fit(t, noisy(t, seed, level(t)), SHOT * level(t))
        u = np.sqrt(np.diag(found.covariance))
        pulls.append(
            [
                (found.level - 1000.0) / u[0],
                (found.loss - LOSS) / u[1],
                (found.time_constant_s - TAU) / u[2],
                (3600 * found.drift_per_s - DRIFT) / (3600 * u[3]),
                (found.noise - NOISE) / found.u_noise,
            ]
        )
        found.require_model()
    table = np.array(pulls)
    assert np.all(abs(table.mean(axis=0)) < 0.5)  # three standard deviations
    assert np.all((table.std(axis=0) > 0.68) & (table.std(axis=0) < 1.35))


@pytest.mark.slow
def test_short_series_of_lamps_that_follow_the_model_are_rejected_by_chance_alone() -> None:
    """The noise is an estimate from 60 frames, too: chi-square of one that came out small is no reason."""
    t, short = np.linspace(5.0, 3600.0, 60), []
    for seed in range(80):
        signal = 1000.0 * (1.0 + 0.002 * np.random.default_rng(seed).standard_normal(t.size))
        short.append(lamp_stability.fit(t, signal, np.full(t.size, 0.1)).probability < 0.05)
    # 5 % of 80, and three standard deviations
    assert np.mean(short) < 0.123


def test_the_warm_up_that_is_recommended_leaves_what_it_says() -> None:
    t = times()
    left = LOSS * math.exp(-lamp_stability.fit(t, noisy(t, 1, level(t)), SHOT * level(t)).warm_up_s / TAU)
    # the time has two standard uncertainties added, some 6 %
    assert 0.5 * lamp_stability.SETTLED < left < 1.1 * lamp_stability.SETTLED


@pytest.mark.parametrize("first_s", [0.0, 600.0])  # long after the shortest time constant that is tried
def test_a_warm_lamp_has_a_drift_alone(first_s: float) -> None:
    t = first_s + times(1800.0)
    found = lamp_stability.fit(t, noisy(t, 3, level(t, loss=0.0)), SHOT * level(t))
    assert (found.loss, found.warm_up_s) == (0.0, 0.0)
    assert abs(found.drift_per_s - DRIFT / 3600.0) < 4.0 * math.sqrt(found.covariance[3, 3])
    values, names, covariance = lamp_stability.values(found)
    assert set(values) == {"noise", "warm_up_s", "drift_per_hour"}
    assert names == ["noise", "drift_per_hour"]
    assert covariance[1, 1] == pytest.approx(3600.0**2 * found.covariance[3, 3])


def test_a_lamp_that_gains_a_tenth_an_hour_is_warming_up() -> None:
    """Beyond three standard uncertainties: 0.1 + 3 * 0.02."""
    t = times(1800.0)
    warm = lamp_stability.fit(t, noisy(t, 3, level(t, loss=0.0)), SHOT * level(t))
    covariance = np.diag([0.0, 0.0, 0.0, (0.02 / 3600.0) ** 2])
    replace(warm, drift_per_s=0.159 / 3600.0, covariance=covariance).require_model()
    with pytest.raises(DataError, match="gains 16 % an hour"):
        replace(warm, drift_per_s=0.161 / 3600.0, covariance=covariance).require_model()
    waits = replace(warm, loss=-0.08, time_constant_s=420.0, covariance=np.diag([0.0, 0.004, 30.0, 0.0]) ** 2)
    wait = 420.0 * math.log(0.08 / lamp_stability.SETTLED)
    # by tau it changes as wait / tau, by the loss as tau / loss
    assert waits.warm_up_s == pytest.approx(wait + 2.0 * math.hypot(30.0 * wait / 420.0, 0.004 * 420.0 / 0.08))


def test_shot_noise_is_not_the_lamp_s() -> None:
    """All noise is shot noise: the lamp's is 0 within its uncertainty, which is a bound then."""
    t = times()
    clean = level(t, loss=0.0)
    signal = clean * (1.0 + 0.002 * np.random.default_rng(5).standard_normal(t.size))
    found = lamp_stability.fit(t, signal, 0.002 * clean)
    assert found.noise < 2.0 * found.u_noise
    assert found.u_noise < 0.001


def test_a_step_of_the_lamp_is_refused_and_told_where() -> None:
    t = times()
    signal = noisy(t, 2, level(t)) * np.where(t > 2400.0, 1.004, 1.0)
    found = lamp_stability.fit(t, signal, SHOT * signal)
    with pytest.raises(DataError, match=r"drifts more than warm-up and steady drift allow.*around (2[2-6]\d\d) s"):
        found.require_model()


def test_frames_beyond_five_standard_deviations_are_told_and_no_others() -> None:
    t = times()
    signal, sigma = level(t), math.hypot(NOISE, SHOT)
    signal = signal * (1.0 + sigma * np.clip(np.random.default_rng(6).standard_normal(t.size), -3.0, 3.0))
    signal[[100, 300]] = level(t)[[100, 300]] * (1.0 + sigma * np.array([4.2, 6.5]))
    found = lamp_stability.fit(t, signal, SHOT * signal)
    # the noise of this series is found within 10 %, so that 4.2 and 6.5 stay on their sides of 5
    assert found.noise == pytest.approx(NOISE, rel=0.1)
    assert found.outliers.tolist() == [t[300]]


@pytest.mark.parametrize(
    ("duration", "words"), [(600.0, "too short: the lamp warms up"), (80.0, "frames; at least 24")]
)
def test_a_series_that_is_too_short_is_refused(duration: float, words: str) -> None:
    t = times(duration)
    with pytest.raises(DataError, match=words):
        lamp_stability.fit(t, noisy(t, 1, level(t)), SHOT * level(t))


def test_bad_series_are_refused_by_file_row_and_column(tmp_path: Path) -> None:
    t = times(160.0)
    good = pd.DataFrame({"time_s": t, "signal_dn_per_s": 5.0, "u_shot_dn_per_s": 0.1, "exposure_s": 0.01})
    file = tmp_path / "series.csv"
    good.to_csv(file, index=False)
    assert len(lamp_stability.read_series(file)) == t.size
    for column, value, words in (
        ("exposure_s", 0.0, r"series.csv: row 3: exposure_s = 0 is no exposure"),
        ("time_s", 0.0, r"row 3: time_s = 0 is not later than the row before"),
        ("signal_dn_per_s", -1.0, r"row 3: signal_dn_per_s = -1 is no light"),
        ("time_s", math.nan, r"row 3: time_s = nothing: is no number"),
    ):
        bad = good.copy()
        bad.loc[2, column] = value
        bad.to_csv(file, index=False)
        with pytest.raises(DataError, match=words):
            lamp_stability.read_series(file)
    good.drop(columns="exposure_s").to_csv(file, index=False)
    with pytest.raises(DataError, match="the column exposure_s is missing"):
        lamp_stability.read_series(file)
    with pytest.raises(DataError, match="pipe"):  # which has no end
        lamp_stability.read_series(Path("/dev/zero"))
    with pytest.raises(ConfigError, match="no such file"):
        lamp_stability.read_series(tmp_path / "none.csv")
