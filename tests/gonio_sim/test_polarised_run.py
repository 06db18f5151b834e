"""Polarised runs on the simulated rig: their values are those that the models show through its polarisers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio import models
from gonio.errors import ConfigError, Interrupted
from gonio.geometry import Directions
from gonio.instrument import apparent_brdf
from gonio.lab.acquisition.duration import Durations
from gonio.lab.reduction import brdf
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.polarisers import in_states
from gonio.models.polarised import Light
from gonio.polarisation import Polarisers, states
from gonio.samples.description import SampleDescription
from gonio.typing import DataFrame, Floats
from tests.gonio.numpy_rig import StopAfter
from tests.gonio_sim.conftest import describe, measured

GLASS = SampleDescription(
    name="glass", model="ggx", parameters={"alpha": 0.25, "ior": [1.5, 0.0], "diffuse_albedo": 0.2}
)
BOTH: dict[str, Any] = {
    "light": {"empty": True, "extinction": 0.01, "azimuth_deg": 2.0, "transmittance": 0.8},
    "receiver": {"empty": True, "extinction": 0.02, "azimuth_deg": -1.5, "retarder": True},
}
SMALL = {"width": 64, "height": 48, "pixel_um": 50.0}


def ideal(**changes: Any) -> RigDescription:
    return describe("sim-ideal", camera=SMALL, polarisers=BOTH, **changes)


def truth(table: DataFrame, sample: SampleDescription) -> Floats:
    model = models.build(sample.model, dict(sample.parameters))
    at = Directions.from_table(table)
    cones = {name: table.attrs[name] for name in ("source_solid_angle_sr", "receiver_solid_angle_sr")}
    light = Light(at, *states(list(table["polarisation"]), Polarisers.of(table.attrs)))
    return model.in_light(
        light, lambda one: np.asarray(apparent_brdf(one, *at.angles, wavelength_nm=550.0, **cones)), 550.0
    )


SWEEPS = [
    {"theta_i_deg": [35.0], "theta_r_deg": [-60.0, 20.0, 50.0]},
    {"theta_i_deg": [35.0], "theta_r_deg": [50.0], "dphi_deg": [130.0]},
]


def run(folder: Path, description: RigDescription, words: list[str]) -> DataFrame:
    folder.mkdir(exist_ok=True)
    plan = {"sweep": SWEEPS} | ({"polarisation": words} if words else {})
    return brdf.reduce(measured(folder, description, [], [], plan=plan, sample=GLASS))


def test_every_state_in_plane_and_out_of_it_is_what_the_model_shows(tmp_path: Path) -> None:
    """Extinctions and azimuths are in the values and in the attribute, transmittances in the white reference."""
    words = ["unpolarised", "s", "p", "us", "sp", "dd", "da", "pr"]
    table = run(tmp_path, ideal(), words)
    assert (table["flag"] == "").all()
    assert sorted(set(table["polarisation"])) == sorted(words)
    # 1e-3: the rate is a mean over a region of 2 mm, which sees 0.1 degrees of directions
    np.testing.assert_allclose(table["brdf"], truth(table, GLASS), rtol=1e-3)


def test_what_lamp_and_lens_polarise_themselves_is_divided_out_behind_polarisers(tmp_path: Path) -> None:
    """Out of the plane of the arms axes stand askew to it: 40 % of the signal."""
    of = {"polarisation": {"degree": 0.2, "azimuth_deg": 20.0}}
    clean = {"light": {"empty": True}, "receiver": {}}
    table = run(tmp_path, describe("sim-ideal", camera=SMALL | of, lamp=of, polarisers=clean), ["sp", "dd"])
    np.testing.assert_allclose(table["brdf"], truth(table, GLASS), rtol=1e-3)
    assert not np.any(table[[name for name in table if str(name).startswith("s_polarisation")]])


def test_an_unknown_azimuth_of_the_lamp_s_polarisation_is_in_the_budget(tmp_path: Path) -> None:
    clean = {"light": {"empty": True}, "receiver": {}}
    unknown = {"polarisation": {"degree": 0.02}}  # 0 in truth
    table = run(tmp_path, describe("sim-ideal", camera=SMALL, lamp=unknown, polarisers=clean), ["sp"])
    off = table["brdf"] / truth(table, GLASS) - 1.0
    askew = np.abs(np.sin(Directions.from_table(table).dphi)) > 0.1
    assert np.abs(off[~askew]).max() < 1e-3
    assert np.abs(off[askew]).min() > 2e-3
    assert np.all(np.abs(off * table["brdf"]) < 2.0 * table["u_brdf"] + 1e-3 * table["brdf"])


def test_a_lens_that_polarises_without_an_analyser_stays_in_the_budget(tmp_path: Path) -> None:
    """A facet of glass sends the lens all of s as s: 5 % too bright, which is the bound; a base depolarises."""
    lens = {"polarisation": {"degree": 0.05, "azimuth_deg": 0.0}}
    light = {"light": {"empty": True}}
    table = run(tmp_path, describe("sim-ideal", camera=SMALL | lens, polarisers=light), ["s", "p"])
    off = (table["brdf"] - truth(table, GLASS)).to_numpy()
    assert np.abs(off / table["brdf"]).max() > 0.03
    # between nothing and the bound, which is the root of 3 times u
    assert np.all(np.abs(off) < 1.05 * np.sqrt(3.0) * table["u_brdf"])
    assert np.all(table["u_brdf"] < 0.035 * table["brdf"])


def test_unpolarised_runs_do_not_notice_polarisers_that_are_out(tmp_path: Path) -> None:
    both = run(tmp_path / "both", ideal(), [])
    none = run(tmp_path / "none", describe("sim-ideal", camera=SMALL), [])
    assert "polarisers" not in both.attrs
    np.testing.assert_array_equal(both["brdf"], none["brdf"])
    np.testing.assert_array_equal(both["u_brdf"], none["u_brdf"])


def test_a_run_that_was_cut_short_goes_on_bit_for_bit(tmp_path: Path) -> None:
    noisy = describe("sim", camera=SMALL, polarisers=BOTH)
    plan = {"polarisation": ["s", "pp"]}
    whole = brdf.reduce(measured(tmp_path, noisy, [30.0], [0.0, 30.0, 60.0], plan=plan, name="whole"))
    with pytest.raises(Interrupted):
        measured(tmp_path, noisy, [30.0], [0.0, 30.0, 60.0], plan=plan, name="cut", progress=StopAfter(3))
    cut = brdf.reduce(measured(tmp_path, noisy, [30.0], [0.0, 30.0, 60.0], plan=plan, name="cut", resume=True))
    np.testing.assert_array_equal(cut["brdf"], whole["brdf"])
    with pytest.raises(ConfigError, match="the points or wavelengths"):
        measured(tmp_path, noisy, [30.0], [0.0, 30.0, 60.0], plan={"polarisation": ["s"]}, name="cut", resume=True)


def test_the_time_of_states_is_that_of_their_light_and_of_turning(tmp_path: Path) -> None:
    """A polariser of 0.8 halves the light of an unpolarised lamp, and takes a fifth of the rest: exposures by 2.5."""
    description = describe("sim", polarisers={"light": {"empty": True, "transmittance": 0.8, "turn_s": 3.0}})
    band = description.bands.containing(550.0)
    step = Step(2, "point", 0, Pose())
    plain, s = (Durations(description, in_states((band,), words)).frames_s(step) for words in ((), ("s",)))
    overheads = 4 * description.camera.frame_overhead_s  # two frames, a shorter one, and metering
    assert s - overheads == pytest.approx(2.5 * (plain - overheads), rel=1e-5)  # whole microseconds
    both = Durations(description, in_states((band,), ("unpolarised", "s"))).frames_s(step)
    assert both == pytest.approx(plain + s + 2 * 3.0, rel=1e-12)


def test_a_program_without_polarisers_is_refused_before_there_is_a_run(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("gonio_sim.rig.SIDES", ())
    with pytest.raises(ConfigError, match=r"\[polarisers.light\]: the program of the rig .* drives no polariser"):
        run(tmp_path, ideal(), ["s"])
    assert not (tmp_path / "run").exists()
