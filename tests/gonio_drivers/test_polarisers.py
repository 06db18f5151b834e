"""Polarisers that servos on the arms' bus turn: the real driver over the twins, and what it refuses."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_drivers import folder_camera
from gonio_drivers.lab import LAB
from gonio_sim.wire import motion
from gonio_sim.wire.twins import Twins

from gonio.errors import ConfigError, Disturbed
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from tests.gonio.numpy_rig import plan_in
from tests.gonio_drivers.conftest import LONGEST_S, SCALE, opened, small
from tests.gonio_sim.test_polarised_run import GLASS, truth

PLAN = """
name = "polarised"
wavelength_nm = [550]
polarisation = ["sp", "dd"]
[[sweep]]
theta_i_deg = [35]
theta_r_deg = [50]
[[sweep]]
theta_i_deg = [35]
theta_r_deg = [50]
dphi_deg = [130]
"""
SERVOS = {
    "light": {"id": 21, "model": "xl430-w250", "direction": -1, "zero_count": 1900},
    "receiver": {"id": 22, "model": "xl430-w250", "gear_ratio": 1.5},
}
KNOWN: dict[str, Any] = {"light": {"azimuth_deg": 3.0, "extinction": 0.01}, "receiver": {"u_azimuth_deg": 0.1}}


def with_polarisers(servos: dict[str, Any] = SERVOS, **known: Any) -> RigDescription:
    plain = small()
    table = plain.devices["servos"] | {"polarisers": servos}
    mounts = type(plain.polarisers).model_validate(known or KNOWN)
    return plain.model_copy(update={"devices": plain.devices | {"servos": table}, "polarisers": mounts})


@pytest.fixture
def twins(tmp_path: Path, hours: object, monkeypatch: pytest.MonkeyPatch) -> Iterator[Twins]:
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
    monkeypatch.setattr(folder_camera, "RELEASE_S", LONGEST_S)
    with Twins(with_polarisers(), GLASS, 3, folder=tmp_path / "twin", scale=SCALE) as served:
        yield served


@pytest.mark.slow
def test_a_polarised_run_over_the_wire_is_what_the_model_shows(twins: Twins, tmp_path: Path) -> None:
    choice = RigChoice(LAB, twins.description, "twin")
    table = brdf.reduce(carry_out(plan_in(tmp_path, PLAN), choice, tmp_path / "run", yes=True))
    assert (table["flag"] == "").all()
    assert np.abs((table["brdf"] - truth(table, GLASS)) / table["u_brdf"]).max() < 5.0  # of four values
    # the light's stands at d before what was asked of it by its known error; servos turn by 0.088 degrees a count
    state, turned = twins.world.polarisers["light"]
    assert state == "linear"
    assert math.degrees(turned) == pytest.approx(-45.0 - 3.0, abs=0.3)


@pytest.mark.slow
def test_a_polariser_that_is_pushed_is_noticed_and_stands_where_it_is_told(twins: Twins) -> None:
    with opened(twins) as rig:
        rig.polarisers["receiver"].select("linear", math.radians(-90.0))
        rig.polarisers["light"].select("linear", math.radians(30.0))
        servo = twins.servos["polariser_receiver"]
        twins._stand()
        found = {side: math.degrees(turned) for side, (_, turned) in twins.world.polarisers.items()}
        assert found == pytest.approx({"light": 30.0, "receiver": -90.0}, abs=0.3)
        with pytest.raises(ConfigError, match='cannot do "u"'):
            rig.polarisers["light"].select("u")
        servo._path = motion.rest(0.0, servo.shaft()[0] - 12)
        with pytest.raises(Disturbed, match="axis polariser_receiver has moved"):
            rig.arms.still()


@pytest.mark.parametrize(
    ("servos", "known", "why"),
    [
        ({"light": SERVOS["light"]}, KNOWN, r"\[polarisers.receiver\] .* devices.servos.polarisers.receiver which"),
        (SERVOS, {"light": {}}, r"needs both tables"),
        (SERVOS, KNOWN | {"light": {"empty": True}}, r"neither takes it out of the beam"),
        ({**SERVOS, "light": SERVOS["light"] | {"id": 1}}, KNOWN, "two servos have the same id"),
        ({**SERVOS, "light": SERVOS["light"] | {"zero_count": 500}}, KNOWN, r"polarisers.light.zero_count"),
    ],
)
def test_tables_that_do_not_belong_together_are_refused(
    servos: dict[str, Any], known: dict[str, Any], why: str
) -> None:
    with pytest.raises(ConfigError, match=why):
        LAB.open(with_polarisers(servos, **known), sample=None, seed=0, confirm=False)
