"""Live alignment over the twins: the real drivers, and a lamp that is dark whatever happens to the program."""

import signal
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest
from gonio_sim.wire.twins import Twins

from gonio.errors import DeviceError
from gonio.lab.by_hand.assistant import CAMERA_S, Assistant
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.rig import Frame
from tests.command_line import some
from tests.gonio.lab.by_hand.test_lamp_timer import Clock
from tests.gonio_drivers.conftest import COMMAND, LONGEST_S, angle, bench, opened, written
from tests.gonio_drivers.test_by_hand import LANDED_DEG, goes_dark
from tests.gonio_drivers.test_light import Plugged, lamp

pytestmark = pytest.mark.slow

__all__ = ["lamp"]


# ---- the guard process ----


@pytest.mark.usefixtures("real_time")
def test_the_guard_darkens_the_lamp_of_a_program_that_shows_no_sign_of_life(lamp: Plugged) -> None:
    with lamp.driver() as light:
        light.on()
        light.keep(1000.0)
        light.keep(0.05)
        lamp.goes_dark()
        light.keep(1000.0)
        light.on()  # whoever is back lights it again
        light.check()
        assert lamp.twin.shine.lit
    assert not lamp.twin.shine.lit


@pytest.mark.usefixtures("real_time")
def test_no_order_of_the_guard_comes_after_a_new_lighting(lamp: Plugged) -> None:
    with lamp.driver() as light:
        for _ in range(3):
            light.keep(1000.0)
            light.on()
            light.keep(0.001)
            lamp.goes_dark()
            with pytest.raises(DeviceError, match="its time is over"):  # nobody has shown a sign of life
                light.on()
            assert not lamp.twin.shine.lit
        light.keep(1000.0)
        light.on()
        assert some(light._guard).says() == b"good"
        light.check()  # after whatever lay on the line before this question
        assert lamp.twin.shine.lit
    assert not lamp.twin.shine.lit


# ---- the session ----


def test_jogs_frames_and_zeros_over_the_real_drivers(twins: Twins, tmp_path: Path) -> None:
    rig, out = written(twins, tmp_path), tmp_path / "aligned.toml"
    held = bench(twins, "arms", "light", "camera")
    told: list[dict[str, Any]] = []
    said: list[str] = []
    assistant = Assistant(held, tell=lambda what, _: told.append(what), say=said.append, rig_file=rig, out=out)
    with held:
        held.hold()
        for order in ("go light 20 camera -30", "jog camera 2", "lamp on", "exposure 0.2"):
            assistant.obey(order)
        assistant.look()
        assistant.look()
        assert twins.lamp.shine.lit
        assistant.obey("zero camera -27.5")
        assistant.obey("lamp off")
        assert not twins.lamp.shine.lit
    assert told[-1]["angles_deg"]["camera"] == pytest.approx(-28, abs=2 * LANDED_DEG)
    assert angle(twins, "light") == pytest.approx(20, abs=LANDED_DEG)
    assert told[-1]["noise"] is not None
    assert told[-1]["levels"][0]["pixels"] == 64 * 48
    assert out.is_file(), said
    assert twins.servos["camera"].torque, "after hold the arms hold"


@pytest.mark.usefixtures("real_time")
def test_the_watch_darkens_the_lamp_of_a_camera_that_hangs_and_the_driver_does_not_light_it_again(
    twins: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, clock = opened(twins), Clock()
    held = ManualRig(rig, "", ("arms", "light", "camera"))
    said: list[str] = []
    told: list[dict[str, Any]] = []
    assistant = Assistant(held, tell=lambda what, _: told.append(what), say=said.append, clock=clock)
    real, hangs = rig._camera.capture, [True]
    seen: list[str] = []

    def capture(exposure_s: float) -> Frame:
        frame = real(exposure_s)
        if seen and twins.lamp.shine.lit:
            seen.append("lit again by the driver")
        elif hangs and twins.lamp.shine.lit:
            hangs.clear()
            clock.now += CAMERA_S + 1.0  # of the sixty that the lamp may shine
            watch = threading.Thread(target=assistant.timer.look)
            watch.start()
            watch.join()
            goes_dark(twins)
            seen.append("dark")
        return frame

    monkeypatch.setattr(rig._camera, "capture", capture)
    with held:
        held.hold()
        with assistant.timer:
            assistant.obey("lamp on")
            lit = twins.lamp.shine.lit
            assistant.look()
            assert (lit, seen, told) == (True, ["dark"], [])
            assert not twins.lamp.shine.lit
            assert said[-1] == "lamp dark: the camera does not come back"
            assistant.look()
            assert not twins.lamp.shine.lit
            assert len(told) == 1
            assistant.obey("lamp on")
            assert twins.lamp.shine.lit
    assert not twins.lamp.shine.lit


ENDS = ["nobody there", signal.SIGTERM, signal.SIGHUP, signal.SIGKILL]


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("ends", ENDS)
def test_every_end_of_the_command_leaves_the_lamp_dark_and_the_arms_holding(
    twins: Twins, tmp_path: Path, ends: str | signal.Signals
) -> None:
    command = [*COMMAND, "rig", "align", "--live", "--rig", str(written(twins, tmp_path))]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, text=True, cwd=tmp_path) as child:
        assert child.stdin is not None
        assert "?token=" in some(child.stdout).readline()
        child.stdin.write("go light 25\nlamp on\n")
        child.stdin.flush()
        while "lamp lit" not in (line := some(child.stderr).readline()):
            assert line, "it ended"
        assert twins.lamp.shine.lit
        if isinstance(ends, signal.Signals):
            child.send_signal(ends)
            child.wait(LONGEST_S)  # before its input ends, which is another way out
        _, said = child.communicate()
    goes_dark(twins)
    assert child.returncode == {"nobody there": 0, signal.SIGKILL: -9}.get(ends, 130), said
    assert "Traceback" not in said
    assert angle(twins, "light") == pytest.approx(25, abs=LANDED_DEG)
    if ends != signal.SIGKILL:
        assert "the lamp is dark" in said or "lamp dark" in said
        assert twins.servos["light"].torque
