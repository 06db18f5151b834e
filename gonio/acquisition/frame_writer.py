"""Frames on their way to the disk: written in a thread of their own, whole or not at all, each with its label.

The label says which step of which run a frame belongs to. That of the last frame of a step holds all that the journal
will say of the step, so that a journal that was lost can be made again (`gonio.acquisition.repair`).
"""

from __future__ import annotations

import hashlib
import json
import re
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

from gonio.acquisition.records import FrameFile, FrameLabel, FrameRecord, StepRecord
from gonio.disk import read_file, sync_folder, write_whole
from gonio.errors import DataError
from gonio.rig import Frame, Pose, Step
from gonio.rig.description import Band
from gonio.rig.dng import read_record, write_dng

WAITING = 8
"""How many frames may wait for the disk before the camera has to."""
NAME = re.compile(r"(\d{6,})-\w+-\d{2,}\.\w+(\.json)?", re.ASCII)
"""Names of frames, and of the labels of frames whose files are the camera's own."""
BESIDE = ".json"


class Store:
    """Writes frames in a thread of its own, in order, so that the disk and the camera work at the same time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-frames")
        self._room = threading.Semaphore(WAITING)

    def put(self, frame: Frame, name: str, label: Callable[[], FrameLabel]) -> Future[FrameFile]:
        """Begin to write a frame; the future says what its file is, once that is on the disk.

        `label` is called when all frames before this one are there.
        """
        self._room.acquire()
        return self._pool.submit(self._write, frame, self._folder / name, label)

    def _write(self, frame: Frame, path: Path, label: Callable[[], FrameLabel]) -> FrameFile:
        try:
            text = json.dumps(label().to_json(), separators=(",", ":"), allow_nan=False)
            if frame.file is None:
                write_dng(replace(frame, record=text), path)
            else:  # the camera's own file is kept as it is
                write_whole(path.with_name(path.name + BESIDE), text.encode())
                write_whole(path, frame.file.read_bytes())
            with path.open("rb") as file:
                return FrameFile(hashlib.file_digest(file, "sha256").hexdigest(), file.tell())
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}") from None
        finally:
            self._room.release()

    def sync(self) -> None:
        """Wait until the names of the frames are on the disk too."""
        try:
            sync_folder(self._folder)
        except OSError as error:
            raise DataError(f"{self._folder}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """End the thread; frames that wait are not written any more."""
        self._pool.shutdown(cancel_futures=True)


@dataclass(slots=True)
class Files:
    """The frames of one step. The last frame is held back until `close` tells what its label says of the step."""

    store: Store
    step: Step
    run: str
    """The run's key."""
    count: int
    """How many frames the step has."""
    pose: Pose | None = None
    """What the encoders read before the frames; None for a dark."""
    pose_time_s: float | None = None
    frames: list[FrameRecord] = field(default_factory=list)
    """What the journal will say of them, but for their files."""
    written: list[Future[FrameFile]] = field(default_factory=list)
    _last: Frame | None = None
    _numbers: Counter[str] = field(default_factory=Counter)

    def keep(self, frame: Frame, slug: str, band: str, *, lamp: bool) -> None:
        """Keep a frame, and note what the journal will say of it."""
        self._put(None)
        self._numbers[slug] += 1
        suffix = ".dng" if frame.file is None else frame.file.suffix.lower()
        name = f"{self.step.index:06d}-{slug}-{self._numbers[slug]:02d}{suffix}"
        self.frames.append(FrameRecord(name, band, frame.exposure_s, float(frame.time_s), lamp, monitor=frame.monitor))
        self._last = frame

    def close(self, record: StepRecord) -> None:
        """Write the last frame, with the step's record in its label."""
        self._put(record)

    def _put(self, record: StepRecord | None) -> None:
        frame, self._last = self._last, None
        if frame is None:
            return
        last, number, before = self.frames[-1], len(self.frames), list(zip(self.frames, self.written, strict=False))
        step, pose, pose_time_s = self.step, self.pose, self.pose_time_s
        goal = step.pose if pose is not None else None

        def label() -> FrameLabel:
            whole = record
            if whole is not None:
                whole = replace(whole, frames=(*(done.stored(file.result()) for done, file in before), last))
            return FrameLabel(
                self.run, step.index, step.kind, step.point, number, self.count, last, goal, pose, pose_time_s, whole
            )

        self.written.append(self.store.put(frame, last.file, label))


def label_of(path: Path, data: bytes) -> FrameLabel | None:
    """What the frame with these bytes says of itself; None where it says nothing.

    The label of a camera's own file lies beside it, and counts where the frame is the one that it was written for.
    """
    text = read_record(data)
    found = _parsed(text)
    if found is None:
        try:
            found = _parsed(read_file(path.with_name(path.name + BESIDE)).decode())
        except (OSError, UnicodeDecodeError):
            return None
    return found if found is not None and found.frame.file == path.name else None


def _parsed(text: str) -> FrameLabel | None:
    try:
        return FrameLabel.from_json(json.loads(text))
    except (ValueError, RecursionError, DataError):
        return None


def slugs(bands: tuple[Band, ...]) -> dict[str, str]:
    """A part of a file name for every band."""
    out: dict[str, str] = {}
    for band in bands:
        slug = re.sub(r"[^A-Za-z0-9_]+", "", band.name) or "band"
        out[band.name] = slug if slug not in out.values() else f"{slug}_{len(out)}"
    return out
