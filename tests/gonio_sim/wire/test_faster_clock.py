"""Twins whose clock runs faster: what a rehearsal of the calibrations needs of them."""

import datetime
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gonio_drivers import folder_camera
from gonio_drivers.lab import LAB
from gonio_sim.wire.twins import Twins, WireWorld, rig_file

from gonio.lab.acquisition.measure import find_rig
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import lamp_scan, lamp_stability
from gonio.lab.rig.calibration_files import Calibration, identity, write_calibration
from gonio.samples.description import ParameterUncertainty
from tests.gonio_drivers.conftest import LONGEST_S, SAMPLE, be_patient, small
from tests.gonio_sim.wire.conftest import HandClock

pytestmark = pytest.mark.slow

TAU_S, LOSS, SCALE = 60.0, 0.3, 60.0
WARM = {"warm_up_loss": LOSS, "warm_up_time_constant_s": TAU_S, "noise": 0.001, "drift_per_hour": 0.0}


def test_a_lamp_is_cold_until_it_is_lit_and_cools_in_the_dark() -> None:
    clock = HandClock()
    world = WireWorld(small(lamp=WARM | {"noise": 0.0}), SAMPLE, 0, clock)  # type: ignore[arg-type]

    def level_after(seconds: float) -> float:
        clock.now_s += seconds
        return world.lamp_level()

    level_after(1e4)  # twins that were served hours ago
    world.switch(True)
    # the same formula, written with other operations: 1e-12
    assert level_after(0.0) == pytest.approx(1.0 - LOSS, rel=1e-12)
    assert level_after(TAU_S) == pytest.approx(1.0 - LOSS / math.e, rel=1e-12)
    world.switch(True)  # at another level: as warm as before
    assert level_after(TAU_S) == pytest.approx(1.0 - LOSS / math.e**2, rel=1e-12)
    world.switch(False)
    level_after(TAU_S)
    world.switch(True)
    assert level_after(0.0) == pytest.approx(1.0 - LOSS * (1.0 - (1.0 - math.e**-2) / math.e), rel=1e-12)
    world.switch(False)
    level_after(100 * TAU_S)
    world.switch(True)
    assert level_after(0.0) == pytest.approx(1.0 - LOSS, rel=1e-12)


def test_a_rehearsal_on_a_faster_clock_finds_the_warm_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_camera, "RELEASE_S", LONGEST_S)
    tables: list[pd.DataFrame] = []
    with Twins(small(lamp=WARM), SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE) as served:
        be_patient(served.peers["servos"], served.faults, monkeypatch)
        seen_s: list[float] = []
        level = served.world.lamp_level

        def noted() -> float:
            if served.world.lamp_on:
                seen_s.append(served.world.now_s())
            return level()

        monkeypatch.setattr(served.world, "lamp_level", noted)
        path = tmp_path / "rig.toml"
        path.write_text(rig_file(served.description))
        rig = LAB.open(find_rig(str(path)).description, sample=None, seed=0, confirm=False)
        with ManualRig(rig) as bench:
            lamp_scan.take_series(bench, 8.0 * TAU_S / SCALE, 0.1, keep=tables.append)
        assert served.quiet
    (table,) = tables
    # each frame by the twins' own clock: a busy computer may take them when it likes
    at_s = np.asarray(seen_s[-len(table) :], float)
    signal, u_shot = (np.asarray(table[name], float) for name in ("signal_dn_per_s", "u_shot_dn_per_s"))
    found = lamp_stability.fit(at_s, signal, u_shot)
    values, names, covariance = lamp_stability.values(found)
    u = dict(zip(names, covariance.diagonal() ** 0.5, strict=True))
    tau = next(name for name in names if name.endswith("warm_up_time_constant_s"))
    # 4 of its standard uncertainties: beyond chance, for one seed; the shutter opens when the computer comes to it
    assert abs(values["warm_up_time_constant_s"] - TAU_S) < 4 * u[tau]
    assert u[tau] < 0.1 * TAU_S  # so that the line before says something


def test_the_rig_file_of_twins_takes_the_calibrations_of_its_own_and_can_be_given_others(tmp_path: Path) -> None:
    with Twins(small(), SAMPLE, 0, folder=tmp_path / "twin", scale=SCALE) as served:
        text = rig_file(served.description)
    assert "[calibration" not in text  # a person appends the table
    path, found = tmp_path / "rig.toml", "arms.light.zero_offset_deg"
    path.write_text(f'{text}\n[calibration]\nfiles = ["geometry.toml"]\n')
    calibration = Calibration(
        format=1, kind="geometry", rig="lab", rig_identity=identity(small()), made=datetime.date(2020, 1, 1),
        values={"arms": {"light": {"zero_offset_deg": 1.25}}},
        uncertainty=ParameterUncertainty(parameters=[found], u=[0.01], correlation=[[1.0]]),
    )  # fmt: skip
    write_calibration(calibration, tmp_path / "geometry.toml")
    calibrated = find_rig(str(path)).description
    again = tmp_path / "elsewhere" / "rig.toml"
    again.parent.mkdir()
    again.write_text(rig_file(calibrated, tmp_path))
    read = find_rig(str(again)).description
    assert read.arms.light.zero_offset_deg == 1.25
    assert [one.parameters for one in read.calibration.known] == [[found]]
    assert read.calibration.replaced == calibrated.calibration.replaced
