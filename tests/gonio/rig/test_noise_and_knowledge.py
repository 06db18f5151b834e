"""Noise of pixels, correlations of what is known, readings of a rig that comes to rest, and pictures of a texture."""

from __future__ import annotations

import datetime
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from gonio.documents import TomlTable
from gonio.errors import DataError
from gonio.rig import clock, sensor_noise, whereabouts
from gonio.rig.calibrated import Calibration
from gonio.rig.calibration_use import ParameterUncertainty
from gonio.rig.health import Health, Reading
from gonio.rig.light_and_camera import Camera
from gonio.rig.patterns import picture
from tests.gonio.numpy_rig import describe

GAMMA = tuple(255.0 * (k / 255.0) ** 2 for k in range(256))
COUNT = 25


@pytest.mark.parametrize(
    ("camera", "charge_e"),
    [
        (Camera(electrons_per_dn=3.0, read_noise_e=6.0, black_level_dn=64.0), 300.0),
        (Camera(electrons_per_dn=3.0, photon_noise=True, black_level_dn=64.0), 900.0),
        (Camera(electrons_per_dn=3.0, dsnu_e=4.0, prnu=0.01, black_level_dn=64.0), 600.0),
        (Camera(electrons_per_dn=30.0, read_noise_e=0.1, black_level_dn=64.0), 300.0),
        (Camera(bits=8, response=GAMMA, electrons_per_dn=30.0, read_noise_e=90.0, black_level_dn=0.0), 3000.0),
    ],
)
def test_rounding_of_a_mean_is_that_of_pixels_that_were_rounded(camera: Camera, charge_e: float) -> None:
    """Means of 25 made pixels whose charge lies anywhere in a step: the rounded ones about those that are not."""
    rng = np.random.default_rng(4)
    shape = 4000, COUNT
    charge = charge_e + rng.uniform(-0.5, 0.5, (shape[0], 1)) * camera.electrons_per_dn * (
        2.0 if camera.response else 1.0
    )
    pixels = charge + camera.read_noise_e * rng.standard_normal(shape) + camera.dsnu_e * rng.standard_normal(shape)
    pixels += camera.prnu * charge_e * rng.standard_normal(shape)
    if camera.photon_noise:
        pixels += math.sqrt(charge_e) * rng.standard_normal(shape)
    linear = pixels / camera.electrons_per_dn + camera.black_level_dn
    if camera.response:
        read = np.rint(np.interp(linear, camera.response, np.arange(256)))
        rounded = np.interp(read, np.arange(256), camera.response)
    else:
        rounded = np.rint(linear)
    off = camera.electrons_per_dn * (rounded - linear).mean(axis=1)
    # 4000 draws of an even distribution: 2 %; a curve's step changes over the pixels' scatter
    assert float(sensor_noise.rounding_of_mean(camera, charge_e, COUNT)) == pytest.approx(np.var(off), rel=0.1)
    noise = (pixels - charge).var(axis=1, ddof=1).mean()
    assert float(sensor_noise.spread(camera, charge_e)) == pytest.approx(noise, rel=0.02)
    steady = camera.read_noise_e**2 + camera.photon_noise * charge_e + camera.electrons_per_dn**2 / 12.0
    assert sensor_noise.deviation_dn(camera, charge_e) == pytest.approx(math.sqrt(steady) / camera.electrons_per_dn)


def test_what_is_known_of_numbers_is_their_covariance_taken_apart() -> None:
    """Numbers without a variance are correlated with none; roundings beyond 1 are none."""
    by = np.array([[2.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    covariance = by @ by.T
    found = ParameterUncertainty.of(["a", "b", "c"], covariance)
    assert found.u == pytest.approx([2.0, math.sqrt(2.0), 0.0])
    assert np.outer(found.u, found.u) * found.correlation == pytest.approx(covariance)
    assert found.correlation[2] == [0.0, 0.0, 1.0]
    assert ParameterUncertainty.of(["a", "b"], np.array([[4.0, 6.0 + 1e-9], [6.0, 9.0]])).correlation[0][1] == 1.0
    with pytest.raises(ValueError, match="no numbers have this correlation"):
        ParameterUncertainty(
            parameters=["a", "b", "c"], u=[1, 1, 1], correlation=[[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]
        )
    known = ParameterUncertainty.of(["camera.prnu"], np.array([[1e-8]]))
    values: TomlTable = {"camera": {"prnu": 0.01}}
    made = Calibration.made_today("camera", describe(), 30, values=values, uncertainty=known, measured={}, notes=[])
    assert made.valid_until == made.made + datetime.timedelta(days=30)


def test_an_axis_may_land_a_quarter_of_a_degree_beyond_its_limit_and_a_voltage_may_not() -> None:
    for value, good in ((-90.2, True), (-90.3, False), (0.0, True), (90.2, True), (90.3, False)):
        assert Reading("light", "angle", value, "deg", (-90.0, 90.0)).good == good
    assert not Reading("light", "voltage", 14.1, "V", (10.0, 14.0)).good
    assert Reading("lamp", "state", "lit", limit=(0.0, 1.0)).good
    assert Reading("light", "angle", 1e9, "deg").good


class Axes:
    """What is read of axes, look after look; the clock is the test's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, angles: list[float], moves: int = 0) -> None:
        self.now, self.looks, self.angles, self.moves = 100.0, 0, angles, moves
        monkeypatch.setattr(clock, "monotonic", lambda: self.now)
        monkeypatch.setattr(clock, "sleep", self.wait)

    def wait(self, seconds: float) -> None:
        self.now += seconds

    def look(self) -> Health:
        angle = self.angles[min(self.looks, len(self.angles) - 1)]
        self.looks += 1
        moving = Reading("light", "motion", "moves" if self.looks <= self.moves else "rests")
        here = Health((Reading("light", "angle", angle, "deg"), Reading("light", "torque", "holds"), moving))
        return here + Health(
            (Reading("tilt", "angle", 1.0), Reading("tilt", "torque", "off")), {"camera": "it is mute"}
        )


def test_where_axes_stand_is_said_once_they_are_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("light", "camera", "tilt", "spin")
    swings = Axes(monkeypatch, [10.0, 12.0, 11.4, 11.31, 11.32, 40.0])
    said = whereabouts.axes_stand(swings.look, names)
    assert (
        "stand now: light 11.32 deg, holds; camera not known (it is mute); tilt 1.00 deg, torque off; spin not" in said
    )
    assert swings.looks == 5, "two looks alike within a tenth of a degree"
    slow = Axes(monkeypatch, [10.0], moves=4)
    assert "moves still" not in whereabouts.axes_stand(slow.look, names)
    assert slow.looks == 5, "the first that does not move"
    runs = Axes(monkeypatch, [10.0], moves=1000)
    assert "holds, and moves still" in whereabouts.axes_stand(runs.look, names)
    assert runs.now - 100.0 == pytest.approx(whereabouts.AT_REST_S, abs=whereabouts.LOOK_S + 1e-6)
    mute = whereabouts.axes_stand(lambda: Health((), {"light": "no answer", "camera": "no answer"}), names)
    assert mute == "where the axes stand is not known: no answer"


@pytest.mark.parametrize(("kind", "top"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("channels", [1, 3])
def test_a_picture_s_greys_are_fractions_of_white_with_its_first_row_on_top(
    tmp_path: Path, kind: type, top: int, channels: int
) -> None:
    grey: npt.NDArray[Any] = np.array([[0, top // 5, top], [top // 3, 0, 0]], kind)
    cv2.imwrite(str(tmp_path / "p.png"), grey if channels == 1 else np.repeat(grey[..., None], 3, axis=2))
    value, levels = picture(tmp_path / "p.png", "file")
    at = np.array([[0.1, 0.9], [0.5, 0.6], [0.9, 0.51], [0.1, 0.49], [0.999999999, 0.0]])
    assert value(at, np.zeros((5, 2))) == pytest.approx([0.0, 0.2, 1.0, 1 / 3, 0.0], abs=1e-6)
    assert levels == pytest.approx([0.0, 0.2, 1 / 3, 1.0], abs=1e-6)
    coloured = np.zeros((4, 4, 3), np.uint8)
    coloured[2, 2, 0] = 9
    cv2.imwrite(str(tmp_path / "c.png"), coloured)
    with pytest.raises(DataError, match="is in colour"):
        picture(tmp_path / "c.png", "file")
