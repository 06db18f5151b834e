"""Cameras: RAW files from a folder with everything that can go wrong, a video camera, an image sequence."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gonio_drivers import cameras, folder_camera, settings
from gonio_drivers.folder_camera import FolderCamera
from gonio_sim.wire import tether
from gonio_sim.wire.faults import FILE_LATE_S, Faults
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.tether import TetheredCamera

from gonio.errors import ConfigError, DataError, DeviceError
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.dng import read_raw, write_dng
from gonio.lab.rig.light_and_camera import Band, Bands, Camera
from tests.command_line import some

SIZE = (48, 64)
DESCRIPTION = RigDescription(
    rig="lab",
    name="bench",
    bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
    camera=Camera(width=SIZE[1], height=SIZE[0], pattern="RGGB", exposure_limits_s=(1e-4, 1.0)),
)
PLAIN = Frame(np.full(SIZE, 7, np.uint16), 0.01, 64.0, 4095.0, "RGGB", time_s=0.0)
PATIENCE_S = 60.0
"""For files that come: a busy machine may take seconds for any of them."""
SHORT_S = 0.3
"""For files that do not come."""


@dataclass
class Tether:
    """A tethered camera whose frames are numbered by their first pixel."""

    folder: Path
    port: str
    faults: Faults
    exposed: list[float]
    given_up: threading.Event = field(default_factory=threading.Event)
    """What a late file comes after."""

    def driver(self, description: RigDescription = DESCRIPTION, **changes: object) -> FolderCamera:
        table = {"driver": "folder", "folder": str(self.folder), "timeout_s": PATIENCE_S}
        table |= {"trigger": {"how": "serial", "port": self.port}}
        camera = cameras.build(description, table | changes)
        assert isinstance(camera, FolderCamera)
        return camera

    def await_briefly(self, camera: FolderCamera, times: int) -> None:
        """Let the next `times` waits of a camera end after a moment, and all others when the file is there."""
        take = camera._take

        def brief(timeout_s: float) -> tuple[Path, Frame | DataError]:
            nonlocal times
            times -= 1
            if times < 0:
                return take(timeout_s)
            try:
                return take(SHORT_S)
            finally:
                self.given_up.set()

        camera._take = brief  # type: ignore[method-assign]


@pytest.fixture
def tethered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Tether]:
    monkeypatch.setattr(folder_camera, "RELEASE_S", PATIENCE_S)
    monkeypatch.setattr(folder_camera, "WHOLE_S", 0.3)  # the twin writes a damaged file at once
    exposed: list[float] = []
    given_up = threading.Event()

    def sleep(seconds: float) -> None:
        if seconds == FILE_LATE_S:
            given_up.wait(PATIENCE_S)  # later than the driver waits, however long that is on this machine
        else:
            time.sleep(seconds)

    monkeypatch.setattr(tether, "clock", SimpleNamespace(sleep=sleep))

    def expose(exposure_s: float) -> Frame:
        exposed.append(exposure_s)
        return replace(plain(len(exposed)), exposure_s=exposure_s, time_s=float(len(exposed)))

    write_dng(expose(0.01), tmp_path / "warm-up.dng")  # compiled code is loaded once, and not while a driver waits
    (tmp_path / "warm-up.dng").unlink()
    exposed.clear()
    faults = Faults()
    twin = TetheredCamera(expose, tmp_path, scale=50.0, faults=faults)
    with SerialPeer(twin) as peer:
        yield Tether(tmp_path, peer.port, faults, exposed, given_up)


def number(frame: Frame | DataError) -> int:
    assert isinstance(frame, Frame), frame
    return int(frame.mosaic[0, 0])


def test_frames_come_in_order_with_the_exposure_and_levels_of_their_files(tethered: Tether) -> None:
    with tethered.driver() as camera:
        for k, exposure_s in enumerate((0.01, 0.5, 1 / 3), 1):
            frame = camera.capture(exposure_s)
            assert number(frame) == k
            # the file holds the exposure as a rational of 32-bit integers
            assert frame.exposure_s == pytest.approx(exposure_s, rel=1e-9)
            assert (frame.black_level_dn, frame.white_level_dn, frame.pattern) == (64.0, 4095.0, "RGGB")
            assert some(frame.file).exists()


def test_used_files_are_deleted_on_leaving_unless_they_are_to_be_kept(tethered: Tether) -> None:
    with tethered.driver() as camera:
        camera.capture(0.01)
    assert list((tethered.folder / "taken").iterdir()) == []
    with tethered.driver(keep=True) as camera:
        camera.capture(0.01)
    assert len(list((tethered.folder / "taken").iterdir())) == 1


@pytest.mark.parametrize(
    ("fault", "waits"), [("file-late", 1), ("file-truncated", 0), ("wrong-exposure", 0), ("file-missing", 2)]
)
def test_a_bad_file_is_exposed_again(tethered: Tether, fault: str, waits: int) -> None:
    with tethered.driver() as camera:
        first = camera.capture(0.01)
        tethered.faults.arm(fault)
        tethered.await_briefly(camera, waits)
        second = camera.capture(0.02)
        third = camera.capture(0.03)
    assert [number(frame) for frame in (first, second, third)] == [1, 3, 4]  # the second exposure is the bad one
    assert [f.exposure_s for f in (first, second, third)] == pytest.approx([0.01, 0.02, 0.03], rel=1e-9)
    assert tethered.faults.fired == [fault]


def test_a_duplicate_is_not_the_next_frame(tethered: Tether) -> None:
    with tethered.driver() as camera:
        tethered.faults.arm("file-duplicate")
        frames = [camera.capture(0.01) for _ in range(3)]
    assert [number(frame) for frame in frames] == [1, 2, 3]


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("file-missing", "no new file in"),
        ("file-truncated", "truncated|damaged"),
        ("wrong-exposure", r"was exposed 0\.02 s, and 0\.01 s were asked"),
    ],
)
def test_a_fault_that_stays_ends_in_an_error(tethered: Tether, fault: str, message: str) -> None:
    tethered.faults.arm(fault, times=100)
    timeout_s = SHORT_S if fault == "file-missing" else PATIENCE_S
    with tethered.driver(timeout_s=timeout_s) as camera, pytest.raises(DeviceError, match=message):
        camera.capture(0.01)


@pytest.mark.parametrize("name", ["IMG_1.CR3", "IMG_1.jpg", "x.raf"])
def test_a_file_of_another_suffix_is_named_where_none_comes_that_counts(tmp_path: Path, name: str) -> None:
    """A camera writes what it is set to: the message says what came, which key chooses, and what it chooses now."""
    (tmp_path / "old.jpg").write_bytes(b"old")
    said = rf'no new file in .*"{name}" came, and only \.dng, \.cr2, \.nef, \.arw count \(devices\.camera\.suffixes\)'
    with opened(tmp_path) as camera:
        with pytest.raises(DeviceError, match=r"no new file in .* asked$"):
            camera._take(0.0)
        (tmp_path / name).write_bytes(b"new")
        with pytest.raises(DeviceError, match=said):
            camera._take(0.0)


@pytest.mark.parametrize("suffix", [".TIF", "tif", "TIF"])
def test_a_suffix_may_be_named_as_people_write_it(tmp_path: Path, suffix: str) -> None:
    table = {"folder": str(tmp_path), "timeout_s": 1.0, "trigger": {"how": "none"}, "suffixes": [suffix]}
    with FolderCamera(DESCRIPTION, settings.FolderCameraSettings.model_validate(table)) as camera:
        (tmp_path / "a.tif").write_bytes(b"new")
        assert [path.name for path in camera._new()] == ["a.tif"]


def test_files_that_are_there_already_are_left_alone(tethered: Tether) -> None:
    old = tethered.folder / "OLD.DNG"
    write_dng(plain(7), old)
    with tethered.driver() as camera:
        assert number(camera.capture(0.01)) == 1
    assert old.exists()


def plain(value: int) -> Frame:
    return replace(PLAIN, mosaic=np.full(SIZE, value, np.uint16))


def opened(folder: Path, timeout_s: float = 1.0, *command: str) -> FolderCamera:
    trigger = {"how": "command", "command": command or ["true"]}
    table = {"folder": str(folder), "timeout_s": timeout_s, "trigger": trigger}
    return FolderCamera(DESCRIPTION, settings.FolderCameraSettings.model_validate(table))


def test_a_program_may_write_the_same_name_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_camera, "REMEMBERED", 1)  # the inodes of deleted files come again, too
    with opened(tmp_path) as camera:
        for k in range(100, 106):
            write_dng(plain(k), tmp_path / "new")
            (tmp_path / "capt0000.dng").write_bytes((tmp_path / "new").read_bytes())
            assert number(camera._take(0.0)[1]) == k


def test_a_temporary_name_that_is_gone_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = read_raw

    def renamed(path: Path, data: bytes) -> Frame:
        if path.name == "part.dng":
            path.rename(path.with_name("whole.dng"))
        return real(path, data)

    monkeypatch.setattr(folder_camera, "read_raw", renamed)
    with opened(tmp_path) as camera:
        (tmp_path / "folder.dng").mkdir()
        write_dng(plain(7), tmp_path / "part.dng")
        assert number(camera._take(PATIENCE_S)[1]) == 7


def test_a_file_that_was_made_in_full_size_and_never_filled_is_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folder_camera, "WHOLE_S", 0.05)
    with opened(tmp_path) as camera:
        write_dng(plain(0x0111), tmp_path / "a.dng")
        data = (tmp_path / "a.dng").read_bytes()
        pixels = b"\x11" * (SIZE[0] * SIZE[1] * 3 // 2)  # two of 12 bits in three bytes
        assert pixels in data
        (tmp_path / "a.dng").write_bytes(data.replace(pixels, pixels[: len(pixels) // 2].ljust(len(pixels), b"\0")))
        _, found = camera._take(0.0)
    assert "its last row is empty" in str(found)


def test_a_camera_that_writes_two_files_an_exposure_is_refused(
    tethered: Tether, caplog: pytest.LogCaptureFixture
) -> None:
    with tethered.driver() as camera:
        write_dng(plain(200), tethered.folder / "JUST_ONE.DNG")
        assert number(camera.capture(0.01)) == 1
        assert "JUST_ONE.DNG was not asked for; passed over" in caplog.text
        assert number(camera.capture(0.01)) == 2
        write_dng(plain(201), tethered.folder / "IMG_A.DNG")
        assert number(camera.capture(0.01)) == 3
        write_dng(plain(202), tethered.folder / "IMG_B.DNG")
        with pytest.raises(DeviceError, match=r"more files than exposures.*IMG_B\.DNG.*devices\.camera\.suffixes"):
            camera.capture(0.01)


def test_a_file_is_not_damaged_while_its_writer_is_held_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the file open, and has written half of it; this process looks at it ever so long meanwhile."""
    monkeypatch.setattr(folder_camera, "WHOLE_S", 0.0)
    write_dng(plain(7), tmp_path / ".whole")
    half = (tmp_path / ".whole").stat().st_size // 2
    write = (
        "import sys\nfrom pathlib import Path\nfolder, half = Path(sys.argv[1]), int(sys.argv[2])\n"
        "data = (folder / '.whole').read_bytes()\n"
        "with open(folder / 'a.dng', 'wb', buffering=0) as file:\n"
        "    file.write(data[:half])\n    print('half', flush=True)\n    input()\n    file.write(data[half:])\n"
    )
    command = [sys.executable, "-c", write, str(tmp_path), str(half)]
    looks: list[Path] = []
    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer,
        opened(tmp_path, PATIENCE_S) as camera,
    ):
        assert writer.stdin is not None
        camera._seen.clear()
        assert some(writer.stdout).readline() == "half\n"
        read = folder_camera._read

        def look(path: Path, data: bytes) -> Frame | DataError:
            looks.append(path)
            if len(looks) == 20:
                assert writer.stdin is not None
                writer.stdin.write("\n")
                writer.stdin.flush()
            return read(path, data)

        monkeypatch.setattr(folder_camera, "_read", look)
        _, found = camera._take(PATIENCE_S)
    assert isinstance(found, Frame), found
    assert len(looks) > 20


def test_a_tethering_program_is_run(tmp_path: Path) -> None:
    good = tmp_path / "shoot.py"
    good.write_text(
        "import sys, numpy as np\nfrom gonio.lab.rig.dng import write_dng\nfrom gonio.lab.rig import Frame\n"
        f"mosaic = np.full({SIZE}, 9, np.uint16)\n"
        "write_dng(Frame(mosaic, float(sys.argv[1]), 64.0, 4095.0, 'RGGB', time_s=0.0), sys.argv[2] + '/a.dng')\n"
    )
    with opened(tmp_path, PATIENCE_S, sys.executable, str(good), "{exposure_s}", "{folder}") as camera:
        assert number(camera.capture(0.25)) == 9
    asleep = opened(tmp_path, PATIENCE_S, sys.executable, "-c", "import sys; sys.exit('the camera is asleep')")
    with asleep as camera, pytest.raises(DeviceError, match="ended with 1: the camera is asleep"):
        camera.capture(0.25)
    absent = opened(tmp_path, PATIENCE_S, "no-such-tool")
    with absent as camera, pytest.raises(ConfigError, match='no program "no-such-tool"'):
        camera.capture(0.25)


def test_settings_are_refused_with_their_key(tethered: Tether, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r'\[devices\.camera\]: unknown key foldr; did you mean "folder"'):
        tethered.driver(foldr="x")
    with pytest.raises(ConfigError, match='there is no camera named "foldr"'):
        cameras.build(DESCRIPTION, {"driver": "foldr"})
    with pytest.raises(ConfigError, match="the key driver is missing"):
        cameras.build(DESCRIPTION, {})
    with pytest.raises(ConfigError, match="there is no such folder"):
        tethered.driver(folder=str(tmp_path / "no")).__enter__()
    with pytest.raises(DeviceError, match=r"devices\.camera\.trigger\.port"):
        tethered.driver(trigger={"how": "serial", "port": "/dev/no-release"}).__enter__()


def test_exposures_outside_the_limits(tethered: Tether) -> None:
    with tethered.driver() as camera, pytest.raises(ConfigError, match=r"exposure of 2 s is outside .* 0\.0001 to 1 s"):
        camera.capture(2.0)


def test_a_frame_of_another_size(tethered: Tether) -> None:
    bigger = DESCRIPTION.model_copy(update={"camera": DESCRIPTION.camera.model_copy(update={"width": 128})})
    with tethered.driver(bigger) as camera, pytest.raises(DeviceError, match="64 x 48 pixels; the rig file says"):
        camera.capture(0.01)


# ---- video ----
