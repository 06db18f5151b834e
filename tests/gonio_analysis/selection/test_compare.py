"""The same fit at every wavelength, jumps between them, and the angles of theory curves; with fits that are made up."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from gonio_analysis.curves.in_plane import Curve
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.selection import compare
from gonio_analysis.selection.judging import Judged

from gonio import geometry
from gonio.errors import DataError

WAVES = (400.0, 500.0, 600.0, 700.0, 800.0)


def made(wave: float, slope: float, cost: float = 1.0, u: float | None = 0.0, scale: str = "log") -> FitResult:
    """A fit of one slope, with a sum of squares."""
    result = SimpleNamespace(
        wavelength_nm=wave, free=("m",), parameters={"m": SimpleNamespace(value=slope, u=u)}, data=[None] * 10,
        whitened=np.array([math.sqrt(cost)]), chi_square=cost, misfit=None,
        problem=SimpleNamespace(asked=FitRequest("phong"), parameter=lambda name: SimpleNamespace(scale=scale)),
    )  # fmt: skip
    return cast(FitResult, result)


@pytest.mark.parametrize(
    ("first", "second", "jumps"),
    [
        ((0.1, 0.0), (0.29, 0.0), []),
        ((0.1, 0.0), (0.31, 0.0), ["m"]),
        ((0.1, 0.0), (0.034, 0.0), []),
        ((0.1, 0.0), (0.032, 0.0), ["m"]),
        ((0.1, 0.05), (0.31, 0.05), []),  # 0.21 of 3 x 0.071
        ((0.1, 0.04), (0.31, 0.04), ["m"]),  # 0.21 of 3 x 0.057
        ((0.1, None), (0.31, None), ["m"]),
        ((0.0, 0.0), (0.31, 0.0), []),
        ((0.1, 0.0), (-1.0, 0.0), []),
    ],
)
def test_a_jump_is_a_factor_of_three_beyond_three_uncertainties(
    first: tuple[float, float], second: tuple[float, float], jumps: list[str]
) -> None:
    a, b = (made(500.0, value, u=u) for value, u in (first, second))
    assert compare.jump(a, b) == jumps
    assert compare.jump(made(500.0, 0.1, scale="linear"), made(600.0, 0.5, scale="linear")) == []


def test_jumps_that_are_left_are_named_with_both_wavelengths() -> None:
    (said,) = compare.jumps([made(400.0, 0.1), made(500.0, 0.12), made(600.0, 0.5)])
    assert said.startswith("From 500 to 600 nm m jumps from 0.12 to 0.5")


def series(
    monkeypatch: pytest.MonkeyPatch, found: Any, middle: float = 600.0
) -> tuple[list[tuple[float, float]], list[tuple[float, float | None]]]:
    """What is found, as (wavelength, slope), and the fits in their order, as (wavelength, slope of the start).

    `found(wavelength, start)` is a slope and a sum of squares; the fit at the middle wavelength has the slope 0.1.
    """
    calls: list[tuple[float, float | None]] = []

    def fit(wave: float, asked: FitRequest, name: str) -> FitResult:
        start = None if asked.start is None else float(asked.start[0]["m"])
        calls.append((wave, start))
        if (one := found(wave, start)) is None:
            raise DataError("too few values")
        return made(wave, *one)

    monkeypatch.setattr(compare, "fit", fit)
    data = SimpleNamespace(wavelengths=WAVES, at=lambda wave: wave)
    judged = SimpleNamespace(fit=made(middle, 0.1), candidate=SimpleNamespace(label="phong"))
    out = compare._series(cast(Judged, judged), cast(Observations, data), "s", lambda text: None)
    return [(one.wavelength_nm, one.parameters["m"].value) for one in out], calls


def test_each_wavelength_begins_at_its_neighbour_from_the_middle_outward(monkeypatch: pytest.MonkeyPatch) -> None:
    found, calls = series(monkeypatch, lambda wave, start: (wave / 6000.0, 1.0))
    assert found == [(wave, 0.1 if wave == 600.0 else wave / 6000.0) for wave in WAVES]
    assert calls == [(700.0, 0.1), (800.0, 700.0 / 6000.0), (500.0, 0.1), (400.0, 500.0 / 6000.0)]


@pytest.mark.parametrize(("better", "chosen"), [(0.0, 0.12), (9.0, 0.12), (11.0, 0.9)])
def test_another_valley_is_left_unless_it_is_better_by_far(
    better: float, chosen: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A start at the neighbour leads to a jump, a search of its own does not; AIC decides from 10 on."""

    def of(wave: float, start: float | None) -> tuple[float, float]:
        if wave == 700.0:
            return (0.12, 50.0) if start is None else (0.9, 50.0 - better)
        return start or 0.1, 50.0

    found, calls = series(monkeypatch, of)
    assert dict(found)[700.0] == chosen
    assert calls[:2] == [(700.0, 0.1), (700.0, None)]


def test_a_wavelength_with_too_few_values_is_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    found, calls = series(monkeypatch, lambda wave, start: None if wave == 700.0 else (0.1, 1.0))
    assert [wave for wave, _ in found] == [400.0, 500.0, 600.0, 800.0]
    assert (800.0, 0.1) in calls, "what follows a gap begins at the middle"


def test_one_wavelength_is_no_series(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "fit", None)
    data = SimpleNamespace(wavelengths=(600.0, math.nan))
    judged = SimpleNamespace(fit=made(600.0, 0.1), candidate=SimpleNamespace(label="phong"))
    assert compare._series(cast(Judged, judged), cast(Observations, data), "s", lambda text: None) == []


# ---- theory curves ----


@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("half_deg", [0.0, 0.5])
def test_theory_curves_are_close_at_the_lobe_and_closest_at_the_spike(half_deg: float, dense: bool) -> None:
    """In steps of a degree, of a quarter within six degrees of the mirror, and of a sixtieth of three cones there."""
    solid = float(geometry.solid_angle_of_cone(math.radians(half_deg)))
    data = SimpleNamespace(source_solid_angle_sr=solid, receiver_solid_angle_sr=solid)
    curve = SimpleNamespace(parameter=math.radians(30.0), angle=np.radians([-47.3, 12.34, 61.7]))
    found = np.degrees(compare.theory_angles(cast(Curve, curve), cast(Observations, data), dense=dense))
    assert np.all(np.diff(found) >= 0.0)
    end = 90.0 - max(half_deg, math.degrees(1e-3))
    assert found[[0, -1]] == pytest.approx([-end, end], abs=1e-3)
    for angle in (-47.3, 12.34, 61.7, 30.0):
        assert np.abs(found - angle).min() < 1e-6, "what was measured, and the mirror direction"

    def steps(low: float, high: float) -> float:
        return float(np.diff(found[(found >= low - 1e-6) & (found <= high + 1e-6)]).max())

    assert steps(-80.0, 20.0) == pytest.approx(1.0 if dense else 3.0, abs=1e-6)
    assert steps(24.0, 36.0) <= (0.25 if dense else 1.0) + 1e-6
    if half_deg:
        spike = found[np.abs(found - 30.0) <= 1.5 * 1.0 + 1e-6]
        assert np.diff(spike).max() <= 3.0 / (60.0 if dense else 12.0) + 1e-6
        assert spike[[0, -1]] == pytest.approx([28.5, 31.5], abs=1e-6)
