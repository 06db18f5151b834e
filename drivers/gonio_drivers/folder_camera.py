"""Frames from files: a tethered camera, whose RAW files appear in a folder, and the replay of an image sequence.

A program or a release makes the tethered camera expose.

The file says what was exposed: exposure and levels come from it, and an exposure that differs from what was asked is
not used. Files are matched to exposures by count and order. A file that is late is waited for before the next exposure,
so that it cannot be taken for that one; one that comes twice is recognised by its bytes; a camera that writes several
files an exposure is refused, by their count: a file that comes after it was given up belongs to its exposure. Files
move into the subfolder `taken`, where the last of them stay until the run has copied them.
"""

import contextlib
import hashlib
import stat
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self, TypeVar

import numpy as np
import serial

from gonio import platform
from gonio.errors import ConfigError, DataError, DeviceError, PassingFault, os_error_as
from gonio.lab.rig import Arrived, Exposed, Frame, clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.dng import read_raw
from gonio.lab.rig.regions import require_raw
from gonio_drivers import log, ports, settings
from gonio_drivers.patience import Patience

T = TypeVar("T")
Program = Literal["command", "fetch"]
POLL_S = 0.01
PORT_KEY = "devices.camera.trigger.port"
RELEASE_S = 2.0
"""A release box answers within this time."""
WHOLE_S = 1.0
"""A file that does not change for this long of looking, that nobody has open, and that cannot be read, is damaged."""
TRIES = 3
CROWDED = 2
"""Exposures in a row with files that nobody has asked for: it is the camera's habit."""
REMEMBERED = 64
"""Frames that a run may still have to copy are far fewer."""
TAKEN = "taken"
RAW = (".dng", ".cr2", ".nef", ".arw")
IMAGES = (".png", ".tif", ".tiff")
EXPOSURE_TOLERANCE = 1e-3
"""Largest relative error of the exposure of a sequence's RAW files."""


class FolderCamera:
    """RAW files from a watched folder, as a `CameraDevice`.

    Parameters
    ----------
    description
        The rig: size of the frame and limits of the exposure.
    camera
        Folder, trigger, tolerances.
    """

    def __init__(self, description: RigDescription, camera: settings.FolderCameraSettings) -> None:
        self._camera = camera
        self._folder = Path(camera.folder).expanduser()
        self._description = description.camera
        self._suffixes = tuple(f".{suffix.lstrip('.').lower()}" for suffix in camera.suffixes)
        self._release: serial.Serial | None = None
        self._seen: set[tuple[Path, int]] = set()
        self._others: set[str] = set()
        """Names of files with other suffixes that were there before."""
        self._known: deque[str] = deque(maxlen=REMEMBERED)
        self._taken: deque[Path] = deque()
        self._fetching: subprocess.Popen[str] | None = None
        """The program that brings the file of an exposure that is over."""
        self._owed = 0
        """Exposures that were triggered and whose files have not come."""
        self._given_up = 0
        """Exposures whose files did not come in time, and may come yet."""
        self._crowded = 0
        """Exposures in a row before which there were more files than had been asked for."""

    def __enter__(self) -> Self:
        _require_folder(self._folder)
        trigger = self._camera.trigger
        if trigger.how == "serial":
            ports.require_free(trigger.port, PORT_KEY)
            self._release = ports.opened(trigger.port, int(trigger.baud), RELEASE_S, PORT_KEY)
        self._seen, self._others = set(self._files().items()), self._other_names()
        return self

    def __exit__(self, *_: object) -> None:
        if self._release is not None:
            self._release.close()
            self._release = None
        fetching, self._fetching = self._fetching, None
        if fetching is not None:
            fetching.kill()
            fetching.communicate()
        self._forget(0)

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call.

        Raises
        ------
        ConfigError
            The exposure is outside the camera's limits.
        DeviceError
            No usable file came, after several attempts.
        """

        def whole() -> Frame:
            self._trigger(exposure_s)
            return self.frame(exposure_s)

        return self._tried(exposure_s, whole)

    def expose(self, exposure_s: float) -> Exposed:
        """An exposure that is over; its file comes later, where program or release box say so (`fetch`, `done`).

        Raises as `capture`. Its file is not waited for: one of no use is a `PassingFault`, at the first attempt.
        """
        if not (self._camera.trigger.fetch or self._camera.trigger.done):
            return Arrived(self.capture(exposure_s))

        def over() -> Exposed:
            self._trigger(exposure_s)
            return FileToCome(self, exposure_s)

        return self._tried(exposure_s, over)

    def _tried(self, exposure_s: float, take: Callable[[], T]) -> T:
        """Do it, and once more where no usable file came of it."""
        self._description.require_exposure(exposure_s)
        for attempt in range(TRIES):
            self._await_stragglers(exposure_s)
            try:
                taken = take()
            except UselessFile as failure:
                log.warning("camera: %s; exposed again", failure)
                last = failure
                continue
            if attempt:
                log.warning("camera: a good file at attempt %d", attempt + 1)
            return taken
        raise PassingFault(f"camera: {last}; {TRIES} attempts failed", "camera")

    # ---- one exposure ----

    def _trigger(self, exposure_s: float) -> None:
        trigger = self._camera.trigger
        self._owed += 1
        if trigger.how == "serial":
            self._press(exposure_s)
        elif trigger.how == "command":
            try:
                self._ended("command", self._started("command", exposure_s), exposure_s + self._camera.timeout_s)
            except FailedProgram:
                self._owed -= 1
                raise
            if trigger.fetch:
                self._fetching = self._started("fetch", exposure_s)
        else:  # exposes by itself: the next file may have begun before this call
            self._take(exposure_s + self._camera.timeout_s)

    def _press(self, exposure_s: float) -> None:
        """Ask the release box for an exposure; it answers OK when the shutter opens."""
        assert self._release is not None
        port = self._camera.trigger.port
        with ports.in_use(port, PORT_KEY):
            self._release.reset_input_buffer()
            ports.send(self._release, f"EXPOSE {exposure_s:.9g}\n".encode())
            line = self._release.readline()
            if self._camera.trigger.done and line == b"OK\n":
                self._await_shutter(self._release, exposure_s)
        reply = line.decode("ascii", "replace").strip() if line.endswith(b"\n") else ""  # half an OK may be one
        if reply != "OK":
            self._owed -= 1 if reply else 0
            raise NoFile(f'the release on {port} answers "{reply}" instead of OK')

    def _await_shutter(self, release: serial.Serial, exposure_s: float) -> None:
        """Wait until the release box says that it has closed the shutter."""
        release.timeout = exposure_s + RELEASE_S
        try:
            line = release.readline()
        finally:
            release.timeout = RELEASE_S
        if line != b"DONE\n":
            said = line.decode("ascii", "replace").strip()
            raise NoFile(
                f'the release on {self._camera.trigger.port} says "{said}" instead of DONE after {exposure_s:g} s '
                "(devices.camera.trigger.done)"
            )

    def _fetched(self) -> None:
        """Wait for the program that brings the file."""
        fetching, self._fetching = self._fetching, None
        if fetching is not None:
            self._ended("fetch", fetching, self._camera.timeout_s)

    def _started(self, key: Program, exposure_s: float) -> subprocess.Popen[str]:
        parts: tuple[str, ...] = getattr(self._camera.trigger, key)
        filled = [part.format(exposure_s=f"{exposure_s:.6g}", folder=self._folder) for part in parts]
        try:
            return subprocess.Popen(filled, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        except FileNotFoundError:
            raise ConfigError(f'devices.camera.trigger.{key}: there is no program "{filled[0]}"') from None

    def _ended(self, key: Program, program: subprocess.Popen[str], timeout_s: float) -> None:
        """Wait for a program; raises `FailedProgram`, or `NoFile` where it does not end in time."""
        name = getattr(self._camera.trigger, key)[0]
        try:
            _, told = program.communicate(timeout=timeout_s)
        except BaseException as error:
            program.kill()
            program.communicate()
            if isinstance(error, subprocess.TimeoutExpired):
                raise NoFile(f'the tethering program "{name}" did not end in time') from None
            raise
        if program.returncode != 0:
            raise FailedProgram(
                f'the tethering program "{name}" ended with {program.returncode}: {told.strip()[-200:]}'
            )

    def frame(self, exposure_s: float) -> Frame:
        """The frame of the exposure that is over; raises `UselessFile`."""
        self._fetched()
        path, frame = self._take(exposure_s + self._camera.timeout_s)
        if isinstance(frame, DataError):
            raise UselessFile(str(frame))
        require_raw(self._description, frame, str(path))
        if abs(frame.exposure_s / exposure_s - 1) > self._camera.exposure_tolerance:
            raise UselessFile(f"{path}: was exposed {frame.exposure_s:g} s, and {exposure_s:g} s were asked")
        return replace(frame, file=path)

    def _take(self, timeout_s: float) -> tuple[Path, Frame | DataError]:
        """The next new file, put away; one whose bytes have come before is passed over."""
        looked = Patience()
        while True:
            over = looked() > timeout_s  # a computer that is held up after its look must not miss a file
            for path in self._new():
                try:
                    digest, frame = self._whole(path)
                    moved = self._put_away(path)
                except FileNotFoundError:
                    continue  # a temporary name, or one that somebody has taken away
                except OSError as error:
                    raise DeviceError(f"{path}: cannot be taken: {error.strerror}") from None
                if digest in self._known:
                    log.warning("camera: %s holds an exposure that has come before; passed over", path)
                    continue
                self._known.append(digest)
                self._owed = max(0, self._owed - 1)
                return moved, frame
            if over:
                raise NoFile(
                    f"no new file in {self._folder} within {timeout_s:.1f} s after the exposure was asked{self._told()}"
                )
            clock.sleep(POLL_S)

    def _await_stragglers(self, exposure_s: float) -> None:
        """Files of earlier exposures that may still come must not be taken for the next one."""
        if self._owed and self._camera.trigger.fetch:  # its program has failed, or nobody has waited for it
            self._fetching = self._fetching or self._started("fetch", exposure_s)
            with contextlib.suppress(NoFile):
                self._fetched()
        looked, longest_s = Patience(), exposure_s + self._camera.timeout_s
        while self._owed and (left := longest_s - looked()) > 0:
            try:
                path, _ = self._take(left)
            except NoFile:
                break
            log.warning("camera: %s came late; passed over", path)
        self._given_up += self._owed
        self._owed = 0
        self._pass_over()

    def _pass_over(self) -> None:
        """Files that nobody has asked for; one may be anybody's, but a camera that writes two each time is no use."""
        others = self._new()
        for path in others:
            log.warning("camera: %s was not asked for; passed over", path)
        self._seen.update(others.items())
        if self._camera.trigger.how != "none":  # one that exposes by itself makes more files than are asked for
            late = min(self._given_up, len(others))
            self._given_up -= late
            self._crowded = self._crowded + 1 if len(others) > late else 0
            if self._crowded == CROWDED:
                raise DeviceError(
                    f"camera: more files than exposures come into {self._folder}, the last one {max(others).name}: "
                    "they cannot be told apart; let the camera write one kind of file, or name that in "
                    "devices.camera.suffixes"
                )

    # ---- files ----

    def _files(self) -> dict[Path, int]:
        """RAW files that are there now, by name, with their inodes: a program may write the same name again."""
        out = {}
        with os_error_as(DeviceError, f"{self._folder}: cannot be looked into"):
            for path in sorted(self._folder.iterdir(), key=lambda p: p.name):
                if path.suffix.lower() in self._suffixes and not path.name.startswith("."):
                    with contextlib.suppress(FileNotFoundError):  # a temporary name
                        status = path.stat()
                        if stat.S_ISREG(status.st_mode):
                            out[path] = status.st_ino
        return out

    def _other_names(self) -> set[str]:
        """Files that are there now, and are passed over for their suffix."""
        with os_error_as(DeviceError, f"{self._folder}: cannot be looked into"):
            there = (path for path in self._folder.iterdir() if path.suffix.lower() not in self._suffixes)
            return {path.name for path in there if not path.name.startswith(".") and path.is_file()}

    def _told(self) -> str:
        """What to say of files that came with another suffix than is waited for; "" where none did."""
        came = sorted(self._other_names() - self._others)
        if not came:
            return ""
        return (
            f'; "{came[0]}" came{" and others" if came[1:] else ""}, and only {", ".join(self._suffixes)} count '
            "(devices.camera.suffixes): name its suffix there if it is a RAW file, or let the camera write RAW"
        )

    def _new(self) -> dict[Path, int]:
        there = self._files()
        self._seen &= there.items()  # what has gone, with its inode, is forgotten: both may come again
        return {path: node for path, node in there.items() if (path, node) not in self._seen}

    def _whole(self, path: Path) -> tuple[str, Frame | DataError]:
        """Digest and frame of a file once it is whole: some programs write under the final name, bit by bit."""
        before, looked, closed = None, Patience(), False
        while True:
            data = path.read_bytes()
            frame = _read(path, data)
            status = path.stat()
            now = status.st_size, status.st_mtime_ns
            if now != before:
                before, looked, closed = now, Patience(), False
            whole = isinstance(frame, Frame) and status.st_size == len(data)
            if whole or closed or looked() >= self._camera.timeout_s:
                return hashlib.sha256(data).hexdigest(), frame
            # nobody has it open: what is read after this is all that there will be
            closed = looked() >= WHOLE_S and not platform.holders_of(str(path))
            clock.sleep(POLL_S)

    def _put_away(self, path: Path) -> Path:
        """Move a file out of the watched folder; where it lies then."""
        folder = self._folder / TAKEN
        folder.mkdir(exist_ok=True)
        moved = folder / f"{path.stem}-{time.time_ns()}{path.suffix}"
        path.replace(moved)
        self._taken.append(moved)
        self._forget(REMEMBERED)
        return moved

    def _forget(self, keep: int) -> None:
        """Delete all but the last files that were put away; a run has copied the others long since."""
        while not self._camera.keep and len(self._taken) > keep:
            self._taken.popleft().unlink(missing_ok=True)


def _read(path: Path, data: bytes) -> Frame | DataError:
    try:
        frame = read_raw(path, data)
    except DataError as damage:
        return damage
    if frame.black_level_dn > 0 and not frame.mosaic[-1].any():  # made with its full size, and then filled
        return DataError(f"{path}: its last row is empty: it has not been written to its end")
    return frame


class UselessFile(DeviceError):
    """A file came that is not what was asked, or none."""


class NoFile(UselessFile):
    """No file came."""


class FailedProgram(NoFile):
    """A tethering program says that it has failed."""


@dataclass(frozen=True, slots=True)
class FileToCome:
    """An exposure that is over, and whose file comes later."""

    camera: FolderCamera
    exposure_s: float

    def done(self) -> bool:
        """Nobody looks at the folder before the file is asked for."""
        return False

    def result(self) -> Frame:
        """The frame of the file; raises `PassingFault` where none of use comes in time."""
        try:
            return self.camera.frame(self.exposure_s)
        except UselessFile as failure:
            raise PassingFault(f"camera: {failure}", "camera") from None


def _require_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f'devices.camera.folder = "{folder}": there is no such folder; make it, or correct the key')


class SequenceCamera:
    """An image sequence, as a `CameraDevice`.

    RAW files say their own exposure, and must have the one that is asked for. PNG and TIFF images (8 or 16 bit, grey)
    are taken for linear levels at the exposure that is asked for, with the levels of the rig file.
    """

    def __init__(self, description: RigDescription, camera: settings.SequenceCameraSettings) -> None:
        self._folder = Path(camera.folder).expanduser()
        self._description = description.camera
        self._left: Iterator[Path] = iter(())

    def __enter__(self) -> Self:
        _require_folder(self._folder)
        paths = sorted(p for p in self._folder.iterdir() if p.suffix.lower() in RAW + IMAGES)
        if not paths:
            raise ConfigError(f'devices.camera.folder = "{self._folder}": holds no frames ({", ".join(RAW + IMAGES)})')
        self._left = iter(paths)
        return self

    def __exit__(self, *_: object) -> None:
        self._left = iter(())

    def capture(self, exposure_s: float) -> Frame:
        """The next frame.

        Raises
        ------
        ConfigError
            The exposure is outside the limits of the rig file.
        DeviceError
            The sequence has ended, or the next frame has another size, pattern or bits, or was exposed otherwise.
        DataError
            The next file is damaged.
        """
        camera = self._description
        camera.require_exposure(exposure_s)
        path = next(self._left, None)
        if path is None:
            raise DeviceError(f"{self._folder}: the image sequence has ended")
        frame = read_raw(path) if path.suffix.lower() in RAW else self._image(path, exposure_s)
        require_raw(camera, frame, str(path))
        if abs(frame.exposure_s / exposure_s - 1) > EXPOSURE_TOLERANCE:
            raise DeviceError(f"{path}: was exposed {frame.exposure_s:g} s, and {exposure_s:g} s were asked")
        return frame

    def _image(self, path: Path, exposure_s: float) -> Frame:
        import cv2

        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise DataError(f"{path}: is no image that OpenCV reads")
        if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
            raise DataError(f"{path}: has shape {image.shape} of {image.dtype}; a linear frame is grey, 8 or 16 bit")
        camera = self._description
        if image.dtype == np.uint8 and camera.bits > 8:
            raise DeviceError(f"{path}: the image has 8 bits; the rig file says camera.bits = {camera.bits}")
        levels = camera.black_level_dn, camera.white_level_dn
        return Frame(image.astype(np.uint16), exposure_s, *levels, camera.pattern, time_s=clock.monotonic())
