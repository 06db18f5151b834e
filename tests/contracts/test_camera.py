"""What every camera has to do, in a rig and by itself."""

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.lab.rig import Exposes, Frame
from tests.contracts.cameras import Eye

AS_ASKED = 0.05
"""What an exposure may differ from what was asked; the reduction uses what the frame says."""


def level(frame: Frame) -> float:
    return float(np.mean(frame.mosaic)) - frame.black_level_dn


@pytest.mark.slow
def test_the_camera_sees_the_lamp_go_on_and_off(eye: Eye) -> None:
    """So a frame is newer than the call: those that waited in a queue show the lamp as it was."""
    if eye.lamp is None:
        pytest.skip("it sees no lamp")
    dark = level(eye.camera.capture(eye.exposure_s))
    eye.lamp(True)
    lit = level(eye.camera.capture(eye.exposure_s))
    eye.lamp(False)
    again = level(eye.camera.capture(eye.exposure_s))
    assert lit > dark + 5, "the lamp adds less than 5 DN: longer exposures, or no light"
    assert abs(again - dark) < 0.1 * (lit - dark)


def test_a_frame_is_what_the_rig_file_describes(eye: Eye) -> None:
    camera = eye.description.camera
    frame = eye.camera.capture(eye.exposure_s)
    assert frame.mosaic.shape == (camera.height, camera.width)
    assert frame.mosaic.dtype == np.uint16
    assert frame.pattern == camera.pattern
    assert 0 <= frame.black_level_dn < frame.white_level_dn
    assert frame.mosaic.max() <= frame.white_level_dn
    assert frame.exposure_s == pytest.approx(eye.exposure_s, rel=AS_ASKED)


def test_frames_begin_after_the_call_and_their_times_grow(eye: Eye) -> None:
    assert eye.time_s() >= 0
    times = []
    for _ in range(3):
        asked = eye.time_s()
        times.append(eye.camera.capture(eye.exposure_s).time_s)
        assert times[-1] >= asked
    assert times[0] < times[1] < times[2] <= eye.time_s()


@pytest.mark.parametrize("end", [0, 1])
def test_an_exposure_outside_the_limits_is_refused(eye: Eye, end: int) -> None:
    beyond = eye.description.camera.exposure_limits_s[end] * (0.5, 2.0)[end]
    with pytest.raises(ConfigError, match="exposure"):
        eye.camera.capture(beyond)


@pytest.mark.slow
def test_what_goes_dark_after_an_exposure_is_over_was_lit_on_its_frame(eye: Eye) -> None:
    """So the arms may move, too; and the next frame is a new one."""
    if eye.lamp is None or not isinstance(eye.camera, Exposes):
        pytest.skip("it sees no lamp, or does not say when an exposure is over")
    dark = level(eye.camera.capture(eye.exposure_s))
    eye.lamp(True)
    lit = level(eye.camera.capture(eye.exposure_s))
    exposed = eye.camera.expose(eye.exposure_s)
    eye.lamp(False)
    frame = exposed.result()
    assert frame.exposure_s == pytest.approx(eye.exposure_s, rel=AS_ASKED)
    assert abs(level(frame) - lit) < 0.1 * (lit - dark)
    again = eye.camera.capture(eye.exposure_s)
    assert abs(level(again) - dark) < 0.1 * (lit - dark)
    assert again.time_s > frame.time_s
