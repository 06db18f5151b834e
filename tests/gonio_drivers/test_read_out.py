"""Cameras that say when an exposure is over: what happens later is on no frame, and what does not come is named."""

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gonio_drivers import cameras, folder_camera
from gonio_drivers.cameras import OpenableCamera
from gonio_drivers.lab import GuardedCamera, TellingCamera
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.tether import TetheredCamera

from gonio.errors import ConfigError, Disturbed, PassingFault
from gonio.lab.rig import Exposed, Exposes, Frame
from gonio.lab.rig.dng import write_dng
from tests.gonio_drivers.genicam_twin import GenICamTwin, described
from tests.gonio_drivers.test_cameras import DESCRIPTION, PATIENCE_S, number, plain
from tests.gonio_drivers.test_genicam import EXPOSURE_S, rig
from tests.gonio_drivers.ticking import ticking

# ---- a release box, and a folder ----


class Scene:
    """What a tethered camera sees: a number that the test changes. A file comes when the test lets it."""

    def __init__(self) -> None:
        self.seen, self.shots, self.comes = 1, 0, threading.Event()

    def expose(self, exposure_s: float) -> Frame:
        self.shots += 1
        return replace(plain(self.seen), exposure_s=exposure_s)

    def sleep(self, seconds: float) -> None:
        if seconds == READOUT_S:
            self.comes.wait(PATIENCE_S)
            self.comes.clear()


READOUT_S = 2.0


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    out = Scene()
    monkeypatch.setattr("gonio_sim.wire.tether.clock", out)
    monkeypatch.setattr(folder_camera, "RELEASE_S", PATIENCE_S)
    return out


@pytest.fixture
def box(tmp_path: Path, scene: Scene) -> Iterator[TetheredCamera]:
    twin = TetheredCamera(scene.expose, tmp_path, readout_s=READOUT_S, says_done=True)
    with SerialPeer(twin) as peer:
        twin.port = peer.port  # type: ignore[attr-defined]
        yield twin
        scene.comes.set()


def by_serial(folder: Path, box: Any, timeout_s: float = PATIENCE_S) -> OpenableCamera:
    trigger = {"how": "serial", "port": box.port, "done": True}
    return cameras.build(
        DESCRIPTION, {"driver": "folder", "folder": str(folder), "timeout_s": timeout_s, "trigger": trigger}
    )


def test_a_release_box_says_that_the_exposure_is_over_before_the_file_comes(
    tmp_path: Path, box: TetheredCamera, scene: Scene
) -> None:
    with by_serial(tmp_path, box) as camera:
        assert isinstance(camera, Exposes)
        exposed = camera.expose(0.01)
        assert not list(tmp_path.glob("*.DNG"))
        assert not exposed.done()
        scene.seen = 2
        scene.comes.set()
        assert number(exposed.result()) == 1
        scene.comes.set()
        assert number(camera.capture(0.01)) == 2


def test_a_file_that_does_not_come_is_no_second_exposure_at_another_pose(
    tmp_path: Path, box: TetheredCamera, scene: Scene
) -> None:
    with by_serial(tmp_path, box, timeout_s=0.2) as camera:
        assert isinstance(camera, Exposes)
        exposed = camera.expose(0.01)
        with pytest.raises(PassingFault, match="no new file in"):
            exposed.result()
        assert scene.shots == 1
        scene.comes.set()


def test_a_release_box_that_does_not_say_done_is_named(
    tmp_path: Path, box: TetheredCamera, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_camera, "RELEASE_S", 0.2)
    monkeypatch.setattr(folder_camera, "TRIES", 1)
    box._says_done = False
    said = r'says "" instead of DONE after 0\.01 s \(devices\.camera\.trigger\.done\)'
    with by_serial(tmp_path, box, timeout_s=0.2) as camera:
        assert isinstance(camera, Exposes)
        with pytest.raises(PassingFault, match=said):
            camera.expose(0.01)


# ---- a program that exposes, and one that fetches ----


def by_programs(tmp_path: Path, fetch: str) -> OpenableCamera:
    """The camera's card is a folder: one program counts its exposures there, another one moves files from it."""
    folder, card = tmp_path / "frames", tmp_path / "card"
    folder.mkdir()
    card.mkdir()
    for value in range(1, 5):
        write_dng(plain(value), tmp_path / f"{value}.dng")
    command = f"n=$(ls {card} {folder}/taken 2>/dev/null | grep -c dng); cp {tmp_path}/$((n + 1)).dng {card}"
    trigger = {
        "how": "command",
        "command": ["sh", "-c", command],
        "fetch": ["sh", "-c", fetch.format(card=card, folder=folder)],
    }
    table = {"driver": "folder", "folder": str(folder), "timeout_s": PATIENCE_S, "trigger": trigger, "keep": True}
    return cameras.build(DESCRIPTION, table)


def test_a_program_fetches_the_file_of_an_exposure_that_is_over(tmp_path: Path) -> None:
    with by_programs(tmp_path, "mv {card}/*.dng {folder}") as camera:
        assert isinstance(camera, Exposes)
        exposed = camera.expose(0.01)
        assert number(exposed.result()) == 1
        assert number(camera.capture(0.01)) == 2


def test_a_file_that_was_not_fetched_is_not_taken_for_the_next_one(tmp_path: Path) -> None:
    once = "touch {card}/../failed; echo no cable >&2; exit 1"
    fetch = f"if [ -e {{card}}/../failed ]; then mv {{card}}/*.dng {{folder}}; else {once}; fi"
    with by_programs(tmp_path, fetch) as camera:
        assert isinstance(camera, Exposes)
        with pytest.raises(PassingFault, match='the tethering program "sh" ended with 1: no cable'):
            camera.expose(0.01).result()
        assert number(camera.capture(0.01)) == 2


def test_keys_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    for trigger, said in (
        ({"how": "none", "fetch": ["true"]}, '`fetch` needs how = "command"'),
        ({"how": "command", "command": ["true"], "done": True}, 'done = true needs how = "serial"'),
    ):
        with pytest.raises(ConfigError, match=said):
            cameras.build(DESCRIPTION, {"driver": "folder", "folder": str(tmp_path), "trigger": trigger})


def test_a_camera_that_cannot_tell_gives_its_frame_at_once(tmp_path: Path) -> None:
    trigger = {
        "how": "command",
        "command": [sys.executable, "-c", f"import shutil; shutil.copy('{tmp_path}/.a', '{tmp_path}/a.dng')"],
    }
    write_dng(plain(7), tmp_path / ".a")
    with cameras.build(DESCRIPTION, {"driver": "folder", "folder": str(tmp_path), "trigger": trigger}) as camera:
        assert isinstance(camera, Exposes)
        exposed = camera.expose(0.01)
        assert exposed.done()
        assert number(exposed.result()) == 7
    shutil.rmtree(tmp_path / "taken")


# ---- GenICam ----


class Sight:
    """What the sensor sees: one value, which the test changes."""

    later: Callable[[float, Callable[[], None]], None]

    def __init__(self) -> None:
        self.value = 100

    def __call__(self, exposure_s: float) -> npt.NDArray[np.uint16]:
        return np.full((32, 32), self.value, np.uint16)


@pytest.fixture
def sight(monkeypatch: pytest.MonkeyPatch) -> Sight:
    out = Sight()
    out.later = ticking(monkeypatch)
    return out


def genicam(twin: GenICamTwin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **keys: Any) -> OpenableCamera:
    core = pytest.importorskip("harvesters.core", reason="harvesters is not installed (the extra genicam)")
    (tmp_path / "maker.cti").touch()
    monkeypatch.setattr(core, "Harvester", twin)
    return cameras.build(rig(), {"driver": "genicam", "producer": str(tmp_path / "maker.cti"), **keys})


@pytest.mark.parametrize("stale", [0, 2])
def test_a_genicam_camera_tells_by_its_event(
    stale: int, tmp_path: Path, sight: Sight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames that had waited in its queue are thrown away while it is exposed, and not found afterwards."""
    twin = GenICamTwin(sight, described(("Mono12",), tells=True), readout_s=0.05, stale=stale, later=sight.later)
    with genicam(twin, tmp_path, monkeypatch) as camera:
        assert isinstance(camera, Exposes)
        for value in (100, 200, 300):
            sight.value = value + 1
            twin.fall_behind()
            sight.value = value
            exposed = camera.expose(EXPOSURE_S)
            assert not exposed.done()
            assert twin.runs, "the stream was stopped before its frame had come"
            sight.value = 4000
            frame = exposed.result()
            assert frame.mosaic.max() == frame.mosaic.min() == value
            assert not twin.runs
        sight.value = 50
        assert camera.capture(EXPOSURE_S).mosaic.max() == 50


@pytest.mark.parametrize("lacks", ["event", "single frames", "global shutter"])
def test_a_genicam_camera_of_which_it_is_not_sure_is_waited_for(
    lacks: str, tmp_path: Path, sight: Sight, monkeypatch: pytest.MonkeyPatch
) -> None:
    without = ("AcquisitionMode",) if lacks == "single frames" else ()
    twin = GenICamTwin(sight, described(("Mono12",), without=without, tells=lacks != "event"), later=sight.later)
    if lacks == "global shutter":
        twin.nodes.SensorShutterMode.value = "Rolling"
    with genicam(twin, tmp_path, monkeypatch) as camera:
        assert isinstance(camera, Exposes)
        exposed = camera.expose(EXPOSURE_S)
        assert exposed.done()
        assert exposed.result().mosaic.max() == 100


def test_a_genicam_camera_that_does_not_send_its_event_is_named_once(
    tmp_path: Path, sight: Sight, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    twin = GenICamTwin(sight, described(("Mono12",), tells=True), readout_s=0.05, mute=True, later=sight.later)
    with genicam(twin, tmp_path, monkeypatch, timeout_s=0.2) as camera:
        assert isinstance(camera, Exposes)
        for _ in range(2):
            assert camera.expose(EXPOSURE_S).done()
    assert caplog.text.count("could tell when an exposure is over, and does not: moves wait") == 1


# ---- the guard around it ----


class Lamp:
    """Shines as it should."""

    def alive(self, busy_s: float = 0.0) -> None:
        """Noted by nobody."""

    require_time = check = lambda self: None


class Arms:
    """Stand still while the exposure lasts."""

    def __init__(self) -> None:
        self.moves = False

    def still(self) -> None:
        if self.moves:
            raise Disturbed("an axis moves")


class Later:
    """A camera whose frames come when they are asked for."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.asked = frame, 0

    def capture(self, exposure_s: float) -> Frame:
        return self.frame

    def expose(self, exposure_s: float) -> Exposed:
        return self

    def done(self) -> bool:
        return False

    def result(self) -> Frame:
        self.asked += 1
        return self.frame


def test_lamp_and_arms_are_looked_at_when_the_exposure_is_over_and_not_later() -> None:
    later, arms = Later(plain(7)), Arms()
    guarded: Any = TellingCamera(DESCRIPTION.camera, later, Lamp(), arms, iter([5.0, 6.0, 7.0]).__next__, 0.1)  # type: ignore[arg-type]
    exposed = guarded.expose(0.01)
    arms.moves = True  # on to the next pose
    assert exposed.result().time_s == 5.0
    with pytest.raises(Disturbed):
        guarded.expose(0.01)
    assert later.asked == 2, "a frame that counts for nothing was left in the camera"
    assert not isinstance(GuardedCamera(DESCRIPTION.camera, later, Lamp(), arms, float, 0.1), Exposes)  # type: ignore[arg-type]
