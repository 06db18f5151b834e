"""Extinctions and azimuths from a polarised run over black glass, against what the simulated rig truly has."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.lab.acquisition.run import Run
from gonio.lab.calibration.polarisers import calibrate
from gonio.samples.description import SampleDescription
from tests.gonio_sim.conftest import describe, measured

BLACK = SampleDescription(name="black glass", model="ggx", parameters={"alpha": 0.2, "ior": [1.5, 0.0]})
TRUE: dict[str, Any] = {
    "light": {"extinction": 0.003, "azimuth_deg": 1.2, "transmittance": 0.8},
    "receiver": {"extinction": 0.0015, "azimuth_deg": -0.7, "transmittance": 0.9},
}
EVERY = ["ss", "sp", "ps", "pp", "ds", "as", "sd", "sa"]


def black_glass(folder: Path, words: list[str], known: dict[str, Any], theta_r: list[float]) -> Run:
    description = describe(camera={"width": 64, "height": 48, "pixel_um": 50.0}, polarisers=known)
    plan = {"polarisation": words} if words else {}
    return measured(folder, description, [56.3], theta_r, truth={"polarisers": TRUE}, plan=plan, sample=BLACK, seed=5)


@pytest.mark.slow
def test_both_polarisers_come_back_in_the_plane_of_the_arms(tmp_path: Path) -> None:
    known = {"light": {"azimuth_deg": 0.4}, "receiver": {}}  # an earlier calibration's, which was set against
    found = calibrate(black_glass(tmp_path, EVERY, known, [52.0, 56.3]), 1.5)
    true = [TRUE[name.split(".")[1]][name.split(".")[2]] for name in found.names]
    values = [found.values[name.split(".")[1]][name.split(".")[2]] for name in found.names]
    u = np.sqrt(np.diag(found.covariance))
    assert len(u) == 4
    assert np.abs((np.array(values) - true) / u).max() < 3.5  # of four numbers
    assert np.all(u < [3e-4, 0.3, 3e-4, 0.3])  # visits of 0.1 % in each state
    assert found.chi_square < found.freedom + 4.0 * np.sqrt(2.0 * found.freedom)


@pytest.mark.slow
def test_what_a_run_does_not_tell_is_left_out_and_said(tmp_path: Path) -> None:
    known = {"light": {"empty": True}, "receiver": {"empty": True}}
    found = calibrate(black_glass(tmp_path, ["s", "p", "d", "a", "us", "up"], known, [56.3]), 1.5)
    assert found.names == ["polarisers.light.extinction", "polarisers.light.azimuth_deg"]
    assert any("does not tell polarisers.receiver, of which an azimuth" in note for note in found.notes)
    (tmp_path / "plain").mkdir()
    plain = black_glass(tmp_path / "plain", [], {"light": {"empty": True}}, [56.3])
    with pytest.raises(DataError, match="is of unpolarised light"):
        calibrate(plain, 1.5)
