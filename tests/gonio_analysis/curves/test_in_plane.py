"""In-plane curves: signs, tolerances, the mirror direction, and what a curve is divided by."""

import math

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.curves.in_plane import MOST_CURVES, curves, norm, selection
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.viewer import _curve

from gonio.models import build
from tests.gonio_analysis.synthetic import measure

GLOSS = build("phong", {"k_d": 0.2, "k_s": 0.8, "exponent": 30})


def test_sign_is_positive_on_the_mirror_side() -> None:
    c = curves(observations(measure(GLOSS, incidences=(40.0,), noise=0.0, floor=1e-9)))[0]
    assert np.degrees(c.angle[0]) == pytest.approx(-80, rel=1e-14)  # to radians and back
    assert np.degrees(c.angle[-1]) == pytest.approx(80, rel=1e-14)
    assert np.degrees(c.angle[np.argmax(c.brdf)]) == pytest.approx(40, abs=5)  # the spacing of the sweep
    assert c.mirror is not None
    assert np.degrees(c.angle[c.mirror]) == pytest.approx(40, rel=1e-14)
    assert c.label == "θi = 40°"


def test_theory_passes_through_noiseless_values_on_both_sides() -> None:
    data = observations(measure(GLOSS, noise=0.0, floor=1e-9))
    for c in curves(data):
        np.testing.assert_allclose(c.theory(GLOSS, c.angle, data), c.brdf, rtol=1e-6, atol=1e-7)  # the noise of 1e-9


def test_turning_the_whole_plane_changes_nothing() -> None:
    table = measure(GLOSS)
    turned = table.copy()
    turned["phi_i_deg"] = (table["phi_i_deg"] + 200) % 360
    turned["phi_r_deg"] = (table["phi_r_deg"] + 200) % 360
    for a, b in zip(curves(observations(table)), curves(observations(turned)), strict=True):
        np.testing.assert_allclose(a.angle, b.angle, atol=1e-12)  # rounding of the azimuths
        np.testing.assert_array_equal(a.brdf, b.brdf)


def test_rows_out_of_the_plane_are_not_in_a_curve() -> None:
    table = measure(GLOSS, incidences=(40.0,))
    table.loc[table["theta_r_deg"] == 30, "phi_r_deg"] = 175.0  # asin(sin 30 sin 5) = 2.5 degrees out of the plane
    table.loc[table["theta_r_deg"] == 5, "phi_r_deg"] += 10.0  # 0.9 degrees: within the tolerance
    c = curves(observations(table))[0]
    assert c.angle.size == len(table) - 2
    aside = math.asin(math.sin(math.radians(5)) * math.sin(math.radians(10)))
    assert c.out_of_plane == pytest.approx(aside, rel=1e-12)  # of azimuths near 180 degrees: 1e-16 of pi in 0.17 rad


def test_readbacks_beside_the_goal_are_one_curve() -> None:
    table = measure(GLOSS)
    table["theta_i_deg"] += np.random.default_rng(1).uniform(-0.05, 0.05, len(table))
    assert [c.label for c in curves(observations(table))] == ["θi = 10°", "θi = 30°", "θi = 60°"]


def test_source_that_moves_gives_curves_of_one_view() -> None:
    table = measure(GLOSS, incidences=(15.0, 45.0), views=np.arange(1.0, 89.0, 2.0))
    swapped = table.rename(columns={"theta_i_deg": "theta_r_deg", "theta_r_deg": "theta_i_deg"})
    swapped.attrs = table.attrs
    found = curves(observations(swapped))
    assert [c.scanned for c in found] == ["theta_i"] * 2
    assert [c.label for c in found] == ["θr = 15°", "θr = 45°"]
    assert found[1].mirror is not None


def test_normal_incidence_at_any_azimuth_is_one_plane() -> None:
    table = measure(GLOSS, incidences=(0.0,))
    c = curves(observations(table))[0]
    assert c.angle.size == len(table)
    assert np.all(np.diff(c.angle) > 0)


@pytest.mark.parametrize(("kind", "expected"), [("mirror", "mirror"), ("max", "max"), ("model", "model")])
def test_normalisation_that_was_asked_for(kind: str, expected: str) -> None:
    data = observations(measure(GLOSS, incidences=(40.0,)))
    c = curves(data)[0]
    n = norm(c, kind, GLOSS, data)  # type: ignore[arg-type]
    assert n.kind == expected
    own = float(c.theory(GLOSS, np.array([n.angle]), data)[0])
    assert n.theory == pytest.approx(c.brdf.max() if kind == "max" else own, rel=1e-14)  # alone or in an array
    if kind == "mirror":
        assert np.degrees(n.angle) == pytest.approx(40, rel=1e-14)
        assert n.measured == c.brdf[c.mirror]
    if kind == "max":
        assert n.measured == c.brdf.max()
    if kind == "model":
        assert n.measured == n.theory


def test_missing_mirror_falls_back_to_the_largest_value() -> None:
    table = measure(GLOSS, incidences=(42.0,))  # views every 5 degrees
    data = observations(table)
    c = curves(data)[0]
    assert c.mirror is None
    n = norm(c, "mirror", GLOSS, data)
    assert n.kind == "max"
    assert n.measured == c.brdf.max()


@pytest.mark.parametrize("incidence", [20.0, 40.0])  # above the dark floor in the mirror direction, and on it
def test_a_retroreflector_is_not_divided_by_its_dark_mirror_direction(incidence: float) -> None:
    table = measure(build("lambert", {"albedo": 0.5}), incidences=(incidence,))
    signed = np.where(table["phi_r_deg"] == 180.0, table["theta_r_deg"], -table["theta_r_deg"])
    table["brdf"] = 0.01 + np.exp(-(((signed + incidence) / 20.0) ** 2))
    data = observations(table)
    c = curves(data)[0]
    n = norm(c, "mirror", GLOSS, data)
    assert n.kind == "max"
    assert n.measured == c.brdf.max()
    assert np.degrees(n.angle) == pytest.approx(-incidence, rel=1e-14)
    # by its own value there a model without that peak was drawn 19 times as bright as it is
    assert n.theory == n.measured
    seen = _curve(c, c.label, "measured", {"gloss": (c.angle, c.theory(GLOSS, c.angle, data), {})})
    by = {s["name"]: s["by"] for s in seen["series"]}
    assert by["gloss"]["max"] == by["measured"]["max"] == pytest.approx(n.measured, rel=1e-8)
    assert by["gloss"]["mirror"] is by["measured"]["mirror"] is None


def test_selection_prefers_curves_with_a_mirror_direction() -> None:
    chosen = selection(curves(observations(pd.concat([measure(GLOSS, incidences=tuple(np.arange(10.0, 70.0, 2.5)))]))))
    assert len(chosen) == MOST_CURVES
    assert all(c.mirror is not None for c in chosen)


def test_angles_without_a_step_are_curves_of_every_tenth_degree() -> None:
    """Files that state every half vector (MERL) have incidences 0.3 degrees apart: one chain, and no one incidence."""
    rows = [
        (theta_i, 0.0, abs(theta_r), 180.0 * (theta_r >= 0), 0.1)
        for theta_i in np.arange(0.0, 75.0, 0.3)
        for theta_r in np.arange(-60.0, 61.0, 5.0)
    ]
    frame = pd.DataFrame(rows, columns=["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "brdf"])
    frame = frame.assign(wavelength_nm=550.0, polarisation="unpolarised", u_brdf=np.nan, u_random=np.nan, flag="")
    found = curves(observations(frame))
    assert [round(math.degrees(c.parameter) / 10.0) for c in found] == [0, 1, 2, 3, 4, 5, 6, 7]
    assert all(abs(math.degrees(c.parameter) - 10 * k) < 0.4 for k, c in enumerate(found))


def test_normal_incidence_of_an_aligned_rig_is_in_the_plane_of_its_detectors() -> None:
    table = measure(GLOSS, incidences=(0.0, 30.0))
    known = curves(observations(table))
    aligned = table.copy()
    aligned.loc[table["theta_i_deg"] == 0.0, ["theta_i_deg", "phi_i_deg"]] = 0.015, 237.0
    for swap in (False, True):
        if swap:  # a detector that stands at the normal: the same with source and detector exchanged
            names = {f"{a}_{i}_deg": f"{a}_{r}_deg" for a in ("theta", "phi") for i, r in ("ir", "ri")}
            aligned = aligned.rename(columns=names)
        found = curves(observations(aligned))
        assert len(found) == len(known)
        for a, b in zip(found, known, strict=True):
            np.testing.assert_allclose(a.angle, b.angle, atol=1e-12)  # rounding of the azimuths
            np.testing.assert_array_equal(a.brdf, b.brdf)
            assert a.scanned == ("theta_i" if swap else "theta_r")
            assert a.out_of_plane < 1e-12
