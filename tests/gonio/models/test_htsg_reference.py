"""He-Torrance against 30-digit references: the vectors of tests/reference, conventions in each file's `meta`.

A case holds when the error is below 1e-12 (1 + condition number): the condition numbers are those of the formulas with
respect to their inputs, and 1e-12 is the accuracy that the model states. Values below 1e-290 count as 0.
"""

import csv
import math
from typing import Any

import numpy as np
import pytest

from gonio.instrument import apparent_brdf
from gonio.models import HeTorrance, htsg
from tests.gonio.models.reference import cases
from tests.places import REFERENCE


def condition(case: dict[str, Any]) -> dict[str, float]:
    """Condition numbers, 0 where the file has none (underflowed values)."""
    return {"rho_dd": 0.0, "rho_s": 0.0} | {key: value or 0.0 for key, value in (case["cond"] or {}).items()}


def model(given: dict[str, Any], **more: Any) -> HeTorrance:
    return HeTorrance(sigma0_um=given["sigma0"], tau_um=given["tau"], ior=complex(given["n"], given["k"]), **more)


def check(got: float, expected: str, tolerance: float) -> None:
    reference = float(expected)
    if abs(reference) < 1e-290:
        assert 0.0 <= got < 1e-280
    else:
        assert got == pytest.approx(reference, rel=tolerance)


@pytest.mark.parametrize("case", cases("htsg_unpolarised"), ids=lambda case: case["id"])
def test_unpolarised(case: dict[str, Any]) -> None:
    given, expected, cond = case["in"], case["out"], condition(case)
    # the file's phi counts from the mirror half-plane
    at = (given["theta_i"], 0.0, given["theta_r"], math.pi - given["phi"])
    wave = given["lam"] * 1000.0
    check(float(model(given).brdf(*at, wavelength_nm=wave)), expected["rho_dd"], 1e-12 * (1 + cond["rho_dd"]))
    printed = model(given, shadowing="paper").brdf(*at, wavelength_nm=wave)
    check(float(printed), expected["rho_dd_paper_noexp"], 1e-12 * (1 + cond["rho_dd"]))
    spike = model(given).specular_reflectivity(given["theta_i"], wavelength_nm=wave)
    check(float(spike), expected["rho_s"], 1e-12 * (1 + cond["rho_s"]))


@pytest.mark.parametrize("tolerance", [1e-9, 1e-6])
def test_tolerance_is_held(tolerance: float) -> None:
    for case in cases("htsg_unpolarised"):
        given, limit = case["in"], tolerance * (1 + condition(case)["rho_dd"])
        got = model(given, tolerance=tolerance).brdf(
            given["theta_i"], 0.0, given["theta_r"], math.pi - given["phi"], wavelength_nm=given["lam"] * 1000.0
        )
        check(float(got), case["out"]["rho_dd"], limit)


@pytest.mark.parametrize("case", cases("htsg_vectors_api"), ids=lambda case: case["id"])
def test_vectors(case: dict[str, Any]) -> None:
    given = case["in"]
    omega = [np.array([given[f"{end}{axis}"] for axis in "xyz"]) for end in "LV"]
    omega_i, omega_r = (v / np.linalg.norm(v) for v in omega)
    got = model(given).brdf_vectors(omega_i, omega_r, wavelength_nm=given["lam"] * 1000.0)
    check(float(got), case["out"]["rho_dd"], 1e-12 * (1 + case["cond"]["rho_dd"]))


@pytest.mark.parametrize("case", cases("htsg_polarised"), ids=lambda case: case["id"])
def test_polarised(case: dict[str, Any]) -> None:
    given, expected = case["in"], case["out"]
    # the file's phi_i is the azimuth of k_i, pi from that of the source
    at = (given["theta_i"], given["phi_i"] + math.pi, given["theta_r"], given["phi_i"] + given["phi"])
    wave = given["lam"] * 1000.0
    reference = np.array(expected["mueller"], dtype=float).reshape(4, 4)
    got = model(given).mueller(*at, wavelength_nm=wave)
    # elements pass through zero: compared with the largest (1e-11: the accuracy stated for Mueller matrices)
    limit = 1e-11 * (1 + case["cond"]["rho_dd_total"])
    np.testing.assert_allclose(got, reference, rtol=0.0, atol=limit * np.abs(reference).max())
    jones = model(given).jones(*at, wavelength_nm=wave)
    parts = [[complex(float(expected[f"J{a}{b}_re"]), float(expected[f"J{a}{b}_im"])) for b in "sp"] for a in "sp"]
    # a common phase is free; 2e-15 a rounding of each angle, times the azimuth's size of up to 10 rad
    ratio = np.vdot(np.array(parts), jones)
    np.testing.assert_allclose(jones * np.exp(-1j * np.angle(ratio)), parts, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("case", cases("htsg_cone_avg"), ids=lambda case: case["id"])
def test_cone_average(case: dict[str, Any]) -> None:
    given, cone = case["in"], math.pi / 1024
    got = apparent_brdf(
        model(given),
        given["theta_i"],
        0.0,
        given["theta_r"],
        math.pi,
        wavelength_nm=given["lam"] * 1000.0,
        source_solid_angle_sr=cone,
        receiver_solid_angle_sr=cone,
    )
    check(float(got), case["out"]["total_a0"], max(1e-7, 20 * case["est_rel_err"]))  # our TOLERANCE; the file's own


@pytest.mark.parametrize("case", cases("htsg_dir_hemi"), ids=lambda case: case["id"])
def test_directional_hemispherical(case: dict[str, Any]) -> None:
    given = case["in"]
    got = model(given).directional_hemispherical(given["theta_i"], wavelength_nm=given["lam"] * 1000.0)
    check(float(got), case["out"]["total_first_surface"], max(1e-9, 20 * case["est_rel_err"]))  # 1e-9: where we stop


def test_series() -> None:
    for case in cases("htsg_series"):
        got = float(htsg.log_series(case["in"]["g"], case["in"]["c"]))
        # 1e-14: a few roundings of the terms of ln S, whose sizes the condition number counts
        assert got == pytest.approx(float(case["out"]["ln_S"]), abs=1e-14 * (1 + case["cond"]["S"])), case["id"]


def test_shadowing() -> None:
    for case in cases("htsg_shadowing"):
        given, limit = case["in"], 1e-15 * (1 + case["cond"]["S1"])  # some five roundings
        for form, key in (("smith", "S1"), ("paper", "S1_paper_noexp")):
            got = float(htsg.shadowing(given["theta"], given["sigma0"], given["tau"], form))
            assert got == pytest.approx(float(case["out"][key]), rel=limit), case["id"]


def test_effective_roughness() -> None:
    for case in cases("htsg_z0"):
        got = float(htsg.effective_roughness(case["in"]["K"]))
        assert got == pytest.approx(float(case["out"]["sigma_over_sigma0"]), rel=5e-16), case["id"]  # two roundings


def test_sweeps() -> None:
    with (REFERENCE / "htsg_directional_diffuse_sweeps.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for case in {(r["case"], r["sigma0_um"], r["tau_um"], r["lambda_nm"], r["n"], r["k"]) for r in rows}:
        _, sigma0, tau, wave, n, k = case
        here = [r for r in rows if r["case"] == case[0] and r["lambda_nm"] == wave]
        surface = HeTorrance(sigma0_um=float(sigma0), tau_um=float(tau), ior=complex(float(n), float(k)))

        def column(name: str, here: list[dict[str, str]] = here) -> np.ndarray:
            return np.array([float(r[name]) for r in here])

        theta_i, theta_r, phi_r = (np.radians(column(f"{name}_deg")) for name in ("theta_i", "theta_r", "phi_r"))
        got = surface.brdf(theta_i, 0.0, theta_r, phi_r, wavelength_nm=float(wave))
        # the file holds 12 digits; degrees to radians is worth 2e-16 tan(theta) and the lobe's slope, up to 1e3
        np.testing.assert_allclose(got, column("rho_dd_series_mpmath_sr-1"), rtol=2e-11, atol=1e-290)
        np.testing.assert_allclose(
            surface.specular_reflectivity(theta_i, wavelength_nm=float(wave)),
            column("rho_s_theta_i"),
            rtol=1e-9,  # 10 digits in the file
        )
