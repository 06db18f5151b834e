"""Measured Mueller matrices against He-Torrance's: the model's own matrices come back, and errors are what they are."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.report import make
from gonio_analysis.selection.compare import examine

from gonio import measurement
from gonio.formats.reader import MUELLER, U_MUELLER
from gonio.models.plain import he_torrance as paper
from tests.gonio_analysis.synthetic import known, measure

SIGMA0, TAU, INDEX = 0.28, 1.77, 0.77 + 6.08j
WAVELENGTH_NM = 550.0


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """The paper's matrices, from the specification in plain numpy, with noise of a known size."""
    from gonio.models import HeTorrance

    model = HeTorrance(sigma0_um=SIGMA0, tau_um=TAU, ior=INDEX)
    frame = measure(model, incidences=(20.0, 50.0), views=np.arange(-68.0, 73.0, 10.0), noise=0.01, name="metal")
    frame.attrs.update(source_solid_angle_sr=None, receiver_solid_angle_sr=None)
    angles = np.radians(frame[["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg"]].to_numpy()).T
    theta_i, phi_i, theta_r, phi_r = angles
    matrix = paper.mueller(theta_i, phi_i, theta_r, phi_r, SIGMA0, TAU, WAVELENGTH_NM * 1e-3, INDEX)
    ratios = (matrix / matrix[:, :1, :1]).reshape(-1, 16)[:, 1:]
    noisy = ratios + np.random.default_rng(3).normal(scale=0.02, size=ratios.shape)
    flag = frame.pop("flag")
    frame = frame.assign(**dict(zip(MUELLER, noisy.T, strict=True)), **dict.fromkeys(U_MUELLER, 0.02), flag=flag)
    return frame.assign(wavelength_nm=WAVELENGTH_NM)


@pytest.mark.slow
def test_the_models_own_matrices_leave_noise(table: pd.DataFrame) -> None:
    dataset = examine(table, ["lambert", "he-torrance"], name="metal", ior=INDEX)
    found = known(dataset.mueller)
    assert found.model == "he-torrance"
    assert [e.name for e in found.elements] == list(MUELLER)
    values = found.points * len(MUELLER)
    each = [e.chi_square_per_value for e in found.elements if e.chi_square_per_value is not None]
    assert len(each) == len(MUELLER)
    chi = float(np.mean(each))
    # mean square of so many standard normal numbers, within four standard deviations
    assert abs(chi - 1.0) < 4.0 * np.sqrt(2.0 / values)
    assert all(e.rms_residual == pytest.approx(0.02, rel=0.6) for e in found.elements)


def test_a_wrong_sign_is_seen(table: pd.DataFrame) -> None:
    dataset = examine(table.assign(m22=-table["m22"]), ["he-torrance"], name="metal", ior=INDEX)
    chi = {e.name: e.chi_square_per_value for e in known(dataset.mueller).elements}
    assert known(chi["m22"]) > 100
    # the matrix is fitted whole, so that a wrong element pulls at all
    assert max(value for name, value in chi.items() if name != "m22" and value is not None) < known(chi["m22"])


@pytest.mark.slow
def test_a_model_that_depolarises_stands_beside_them(table: pd.DataFrame, tmp_path: Path) -> None:
    measurement.write(table, tmp_path / "metal.csv")
    make([str(tmp_path / "metal.csv")], tmp_path / "out", models=["lambert"])
    (one,) = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["datasets"]
    assert one["mueller"]["model"] == "lambert"
    first = one["mueller"]["elements"][0]
    assert first["rms_residual"] == pytest.approx(first["rms"])  # its elements are 0
    assert (tmp_path / "out" / "figures" / "metal-mueller.svg").exists()
    assert "Polarisation: Mueller matrix" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
