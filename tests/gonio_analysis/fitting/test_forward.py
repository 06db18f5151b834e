"""What an instrument would measure of a model; its derivatives, and averages by rules against searched ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.forward import apparent, averaging, rho_angles, seen
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.search import STEP, derivatives

from gonio.geometry import Directions
from gonio.instrument import LOBE_TOLERANCE, apparent_brdf
from gonio.models import HeTorrance, build
from tests.gonio_analysis.synthetic import measure

METAL = build("he-torrance", {"sigma0_um": 0.28, "tau_um": 1.77, "ior": 0.77 + 6.08j})
CONE_SR = math.pi / 1024  # the solid angles of the 1991 paper
AT = {
    "lambert": {"albedo": 0.4},
    "oren-nayar": {"albedo": 0.4, "sigma_deg": 20.0},
    "cook-torrance": {"s": 0.3, "m": 0.3, "diffuse_albedo": 0.2, "ior": 1.6},
    "he-torrance": {"sigma0_um": 0.28, "tau_um": 1.77, "diffuse_albedo": 0.1, "ior": 1.6},
    "lambert+he-torrance": {"albedo": 0.2, "weight": 0.7, "sigma0_um": 0.28, "tau_um": 1.77, "ior": 1.6},
}


@pytest.mark.parametrize("name", AT)
def test_against_central_differences(name: str) -> None:
    data = observations(measure(METAL, cone_sr=CONE_SR, wavelength_nm=500.0))
    problem = pose(FitRequest(name))
    vector = problem.vector({**problem.fixed, **AT[name]})
    rules = averaging(problem.model(vector), data)
    full, quick = derivatives(problem, data, vector, rules=rules), derivatives(problem, data, vector, quick=True)
    rough = derivatives(problem, data, vector, here=apparent(problem.model(vector), data, quick=True))
    for k in range(vector.size):
        for column, rule, is_quick in ((full, rules, False), (quick, None, True)):
            # an independent order: five points instead of two, with a step ten times as large
            def f(x: float, k: int = k, rule: object = rule, is_quick: bool = is_quick) -> np.ndarray:
                moved = vector.copy()
                moved[k] += 10 * STEP * x
                return apparent(problem.model(moved), data, quick=is_quick, rules=rule)  # type: ignore[arg-type]

            expected = (8 * (f(1) - f(-1)) - (f(2) - f(-2))) / (120 * STEP)
            # the error of the two-point rule is STEP^2/6 times the third derivative: hundreds at a spike's edge
            np.testing.assert_allclose(column[:, k], expected, rtol=2e-5, atol=2e-6 * np.abs(expected).max())
        # a step of 1e-6 leaves 1e-6 of the curvature, and 1e-10 of rounding
        np.testing.assert_allclose(rough[:, k], quick[:, k], rtol=1e-4, atol=2e-5 * np.abs(quick[:, k]).max())


def test_rules_of_one_model_serve_its_neighbours() -> None:
    data = observations(measure(METAL, cone_sr=CONE_SR, wavelength_nm=500.0))
    rules = averaging(METAL, data)
    # a kept rule is the smaller of the two that agreed
    np.testing.assert_allclose(apparent(METAL, data, rules=rules), apparent(METAL, data), rtol=LOBE_TOLERANCE)
    near = build("he-torrance", {"sigma0_um": 0.29, "tau_um": 1.75, "ior": 0.77 + 6.08j})
    # a rule is chosen with room to spare: a lobe a few per cent narrower costs no more than ten times its tolerance
    np.testing.assert_allclose(apparent(near, data, rules=rules), apparent(near, data), rtol=10 * LOBE_TOLERANCE)


MODEL = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5)
THETA_I, PHI_I, THETA_R, PHI_R = np.radians(
    [[30.0, 30.0, 60.0], [0.0, 0.0, 0.0], [30.0, 45.0, 20.0], [180.0, 180.0, 90.0]]
)


def test_without_cones_it_is_the_model() -> None:
    got = seen(MODEL, Directions(THETA_I, PHI_I, THETA_R, PHI_R), wavelength_nm=550.0, cones=(0.0, 0.0))
    want = MODEL.brdf(THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0)
    np.testing.assert_allclose(got, want, rtol=1e-13)  # alone or in a batch: roundings


def test_with_cones_it_is_the_average_over_them_spike_included() -> None:
    cone = 2.4e-4  # half-angles of 0.5 degrees
    got = seen(MODEL, Directions(THETA_I, PHI_I, THETA_R, PHI_R), wavelength_nm=550.0, cones=(cone, cone))
    want = apparent_brdf(
        MODEL, THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0,
        source_solid_angle_sr=cone, receiver_solid_angle_sr=cone, spike="exact",
    )  # fmt: skip
    np.testing.assert_allclose(got, want, rtol=1e-4)  # fits average with fewer directions
    lobe = MODEL.brdf(THETA_I, PHI_I, THETA_R, PHI_R, wavelength_nm=550.0)
    # in the mirror direction the whole spike comes in; He1991 eq. 6, with the cosine of the cones' middle
    spike = MODEL.specular_reflectivity(THETA_I[0], wavelength_nm=550.0) / (np.cos(THETA_I[0]) * cone)
    # 1 %: the cosine over half a degree at 30 degrees, and the lobe over the cones
    np.testing.assert_allclose(got[0], lobe[0] + spike, rtol=0.01)


def test_energy_is_asked_for_at_the_incidences_of_a_table_and_at_8_degrees_once() -> None:
    def asked_deg(*incidences_deg: float) -> list[float]:
        data = observations(measure(build("lambert", {"albedo": 0.4}), incidences=incidences_deg))
        return np.degrees(rho_angles(data)).round(1).tolist()

    assert (asked_deg(30.0, 60.0), asked_deg(8.0, 30.0)) == ([8.0, 30.0, 60.0], [8.0, 30.0])
    many = asked_deg(*np.arange(5.0, 85.0, 5.0))
    assert (len(many), many[0], many[-1]) == (10, 5.0, 80.0), "nine of sixteen, evenly, and 8"
