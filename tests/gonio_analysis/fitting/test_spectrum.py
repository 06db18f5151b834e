"""Wavelengths of one sample share its geometry: the same estimates as one dense least squares, one fit a wavelength."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.spectrum import fit_table, geometry, shares
from gonio_analysis.selection.compare import examine

from gonio import measurement
from gonio.models import build
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import joined, known, measure

WAVES = {450.0: 0.10, 550.0: 0.20, 650.0: 0.30}
SURFACE = {"sigma0_um": 0.28, "tau_um": 1.77, "ior": 0.77 + 6.08j}


def several(*, reference: float = 0.0, cone_sr: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """One rough surface whose diffuse albedo grows with the wavelength."""
    parts = [
        measure(
            build("he-torrance", {**SURFACE, "diffuse_albedo": a}),
            wavelength_nm=w,
            noise=0.01,
            seed=int(w) + 1000 * seed,
            cone_sr=cone_sr,
        )
        for w, a in WAVES.items()
    ]
    whole = joined(*parts)
    if reference:
        whole["brdf"] *= 1 + reference * np.random.default_rng(seed).normal()
        whole.insert(list(whole.columns).index("flag"), "s_reference", reference * whole["brdf"])
        whole["u_brdf"] = np.hypot(whole["u_random"], reference * whole["brdf"])
    return whole


@pytest.mark.parametrize(("cone_sr", "reference"), [(0.0, 0.0), (1e-4, 0.0), (0.0, 0.02)])
def test_blocks_give_what_one_dense_least_squares_gives(cone_sr: float, reference: float) -> None:
    """With cones, and with a cause that all wavelengths have in common, whose covariance couples them."""
    table = several(cone_sr=cone_sr, reference=reference)
    slices = fit_table(table, FitRequest("he-torrance", ior=SURFACE["ior"]))
    dense = fit(table, "he-torrance", ior=SURFACE["ior"], each=["diffuse_albedo"])
    assert [r.wavelength_nm for r in slices] == [550.0, 450.0, 650.0]  # what is reported stands first
    for r in slices:
        for name in ("sigma0_um", "tau_um", "diffuse_albedo"):
            other = dense.parameters[name if name != "diffuse_albedo" else f"{name}@{r.wavelength_nm:g}"]
            # both searches end where a step is below 1e-8 or the sum below 1e-8: far inside a thousandth of an error
            assert r.parameters[name].value == pytest.approx(other.value, abs=1e-2 * known(other.u))
            assert r.parameters[name].u == pytest.approx(other.u, rel=1e-2)
    shared = known(slices[0].shared)
    assert shared.chi_square == pytest.approx(known(dense.chi_square), rel=1e-6)
    assert (shared.parameters, shared.n_points, shared.n_free) == (["sigma0_um", "tau_um"], len(table), 5)


def test_a_geometry_from_all_wavelengths_is_known_better_and_holds_the_truth() -> None:
    table = several(seed=1)
    shared = fit_table(table, FitRequest("he-torrance", ior=SURFACE["ior"]))[0].parameters
    alone = fit(table, "he-torrance", ior=SURFACE["ior"]).parameters
    for name in ("sigma0_um", "tau_um"):
        assert known(shared[name].u) < known(alone[name].u)
        assert abs(shared[name].value - SURFACE[name]) < 3.5 * known(shared[name].u)


def test_what_is_asked_for_alone_stays_alone() -> None:
    table = several()
    data = observations(table)
    assert shares(FitRequest("he-torrance"), data)
    for alone in (
        FitRequest("he-torrance", separate=True),
        FitRequest("he-torrance", each=[]),
        FitRequest("he-torrance", energy=True),
        FitRequest("he-torrance", loss="huber"),
        FitRequest("lambert"),
    ):
        assert not shares(alone, data), alone
    assert not shares(FitRequest("he-torrance"), data.at(550.0))
    (one,) = fit_table(table, FitRequest("he-torrance", ior=SURFACE["ior"], wavelength_nm=450))
    assert one.shared is None
    assert one.wavelength_nm == 450


def test_geometry_is_what_belongs_to_the_surface() -> None:
    from gonio_analysis.fitting.problem import pose

    assert geometry(pose(FitRequest("cook-torrance", slopes=2))) == ("m_1", "m_2", "w_1")
    assert geometry(pose(FitRequest("oren-nayar+phong"))) == ("sigma_deg", "exponent")
    assert geometry(pose(FitRequest("he-torrance", fix={"tau_um": 1.77}))) == ("sigma0_um",)


def test_a_surface_that_is_another_at_each_wavelength_is_said_to_be() -> None:
    parts = [
        measure(build("phong", {"k_d": 0.3, "k_s": 0.3, "exponent": e}), wavelength_nm=w, seed=int(w))
        for w, e in {450.0: 20.0, 550.0: 40.0, 650.0: 60.0}.items()
    ]
    result = fit_table(joined(*parts), FitRequest("phong"))[0]
    assert any(
        "550 nm alone asks for another geometry: exponent = 4" in n or "exponent = 39" in n for n in result.notes
    )
    assert not any(
        "another geometry" in n for n in fit_table(several(), FitRequest("he-torrance", ior=SURFACE["ior"]))[0].notes
    )


def test_a_report_shows_one_geometry_at_all_wavelengths_and_separate_ones_if_asked() -> None:
    table = several()
    shown = examine(table, ["he-torrance"], name="x", ior=SURFACE["ior"]).models["he-torrance"]
    assert len({r.parameters["sigma0_um"].value for r in shown.series}) == 1
    assert shown.fit.parameters["sigma0_um"].value == shown.series[0].parameters["sigma0_um"].value
    assert [r.wavelength_nm for r in shown.series] == list(WAVES)
    apart = examine(table, ["he-torrance"], name="x", ior=SURFACE["ior"], separate=True).models["he-torrance"]
    assert len({r.parameters["sigma0_um"].value for r in apart.series}) == 3
    assert apart.fit.shared is None


def test_the_command_line_shares_by_default(tmp_path: Path) -> None:
    file = tmp_path / "several.csv"
    measurement.write(several(), file)
    common = ["fit", str(file), "--model", "he-torrance", "--ior", "0.77+6.08j", "--json"]
    together = json.loads(gonio(tmp_path, *common).stdout)
    assert (together["wavelength_nm"], together["shared"]["wavelengths_nm"]) == (550, list(WAVES))
    assert [line["wavelength_nm"] for line in together["series"]] == list(WAVES)
    assert {"value", "u", "fixed"} <= set(together["parameters"]["diffuse_albedo"])
    alone = json.loads(gonio(tmp_path, *common, "--separate").stdout)
    assert alone["shared"] is None
    assert "series" not in alone
    assert alone["parameters"]["sigma0_um"]["u"] > together["parameters"]["sigma0_um"]["u"]
    assert together["n_points"] == alone["n_points"]
