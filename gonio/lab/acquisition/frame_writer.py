"""Frames on their way to the disk: written in a thread of their own, whole or not at all, each with its label.

A frame is written under a temporary name. It gets its own, synced, with those that were written since, by
`Store.commit`: the disk takes many small files together in a third of the time that it takes for one after the other.

The label says which step of which run a frame belongs to. That of the last frame of a step holds all that the journal
will say of the step, so that a journal that was lost can be made again (`gonio.lab.acquisition.repair`).
"""

import contextlib
import hashlib
import os
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from pathlib import Path

from gonio.disk import Staged, read_file
from gonio.errors import ArgumentError, DataError
from gonio.lab.acquisition.journal import is_whole, sealed
from gonio.lab.acquisition.records import FrameFile, FrameLabel, FrameRecord, StepRecord
from gonio.lab.rig import Frame, Pose, Step
from gonio.lab.rig.dng import dng_pieces, pixels_sha256, read_raw, read_record
from gonio.lab.rig.light_and_camera import Band
from gonio.platform import sync_folder

WAITING = 8
"""How many frames may wait for the disk before the camera has to; of large ones fewer."""
PIXELS_WAITING = 2**22
"""Of a frame, that count as one of `WAITING`."""
MOST_STAGED = 128
"""Files that wait to be synced together, at most."""
SYNCING = 8
"""Threads that sync them: a disk that is asked to write out its cache answers all who wait at once."""
LARGE = 1_000_000
"""Bytes of a frame from which on it is synced by itself."""
NAME = re.compile(r"(\d{6,})-\w+-\d{2,}\.\w+(\.json)?", re.ASCII)
"""Names of frames, and of the labels of frames whose files are the camera's own."""
BESIDE = ".json"


class Store:
    """Writes frames in a thread of its own, in order, so that the disk and the camera work at the same time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-frames")
        self._syncing = ThreadPoolExecutor(SYNCING, thread_name_prefix="gonio-syncs")
        self._room = threading.Semaphore(WAITING)
        self._staged: deque[Staged] = deque()
        """Written, and not yet synced; taken from it by the thread alone."""
        self._failed: DataError | None = None
        self._settling: Future[None] = Future()
        """What brings the files that were staged before to the disk, while more are."""
        self._settling.set_result(None)
        self.at_once = False
        """Whether `put` writes frames itself: with a camera that takes no time a thread saves none."""
        self.waited_s = 0.0
        """How long `put` has waited for the disk."""

    def put(self, frame: Frame, name: str, label: Callable[[str], str]) -> Future[FrameFile]:
        """Begin to write a frame; what is returned says what its file is, once that is written (see `commit`).

        `label` is called when all frames before this one are there, with the checksum of the frame's pixels.
        """
        path, began = f"{self._folder}{os.sep}{name}", time.monotonic()
        if self.at_once:
            out = Future[FrameFile]()
            try:
                out.set_result(self._write(frame, path, label))
            except (DataError, ArgumentError) as error:
                out.set_exception(error)
            if len(self._staged) >= MOST_STAGED:
                self._settling.result()
                self._settling = self._pool.submit(self._settle)
        else:
            places = min(WAITING, 1 + frame.mosaic.size // PIXELS_WAITING)
            for _ in range(places):
                self._room.acquire()
            out = self._pool.submit(self._in_thread, frame, path, label, places)
        self.waited_s += time.monotonic() - began
        return out

    def commit(self) -> Future[None]:
        """Begin to bring all frames that were put before to the disk, under their names; done once they are there."""
        return self._pool.submit(self._commit)

    def _write(self, frame: Frame, path: str, label: Callable[[str], str]) -> FrameFile:
        try:
            pieces: Sequence[bytes | memoryview]
            if frame.file is None:
                pieces = dng_pieces(frame, label(pixels_sha256(frame.mosaic)))
            else:  # the camera's own file is kept as it is
                pieces = [frame.file.read_bytes()]
            whole = hashlib.sha256()
            for piece in pieces:
                whole.update(piece)
            digest = whole.hexdigest()
            if frame.file is not None:
                self._staged.append(Staged(path + BESIDE, label(digest).encode()))
            self._staged.append(Staged(path, pieces))
            return FrameFile(digest, sum(map(len, pieces)))
        except OSError as error:
            raise _not_written(path, error) from None

    def _in_thread(self, frame: Frame, path: str, label: Callable[[str], str], places: int) -> FrameFile:
        try:
            file = self._write(frame, path, label)
            if len(self._staged) >= MOST_STAGED or file.bytes >= LARGE:
                self._settle()
            return file
        finally:
            self._room.release(places)

    def _settle(self) -> None:
        """Bring what is staged to the disk. Once that has failed nothing is committed any more: a frame is missing."""
        if self._failed is not None:
            raise self._failed
        count = len(self._staged)
        try:
            for k in range(count if count > 1 else 0):
                self._staged[k].begin()
            self._sync([self._staged[k] for k in range(count)])
            for _ in range(count):
                self._staged.popleft().settle()
        except OSError as error:
            self._failed = _not_written(error.filename or self._folder, error)
            raise self._failed from None

    def _sync(self, staged: list[Staged]) -> None:
        """Sync all, before the first gets its name: renames between syncs double their cost."""
        begun = [self._syncing.submit(_sync_all, staged[k::SYNCING]) for k in range(1, min(SYNCING, len(staged)))]
        try:
            _sync_all(staged[::SYNCING])
        finally:
            wait(begun)
        for part in begun:
            part.result()

    def _commit(self) -> None:
        self._settle()
        try:
            sync_folder(self._folder)
        except OSError as error:
            raise _not_written(self._folder, error) from None

    def close(self) -> None:
        """End the thread; frames that wait are not written any more, and those without a commit are removed."""
        self._pool.shutdown(cancel_futures=True)
        self._syncing.shutdown()
        for staged in self._staged:
            staged.drop()


def _sync_all(staged: list[Staged]) -> None:
    for each in staged:
        each.sync()


def _not_written(path: str | Path, error: OSError) -> DataError:
    return DataError(f"{path}: cannot be written: {error.strerror}")


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
        step, last, before = self.step, self.frames[-1], list(self.written)
        told = FrameLabel(  # now: the count may have grown when the label is written
            run=self.run, step=step.index, kind=step.kind, point=step.point, number=len(self.frames), count=self.count,
            frame=last, goal=step.pose if self.pose is not None else None, pose=self.pose, pose_time_s=self.pose_time_s,
        )  # fmt: skip

        def label(pixels: str) -> str:
            whole = None if record is None else record.stored([done.result() for done in before])
            return sealed(replace(told, record=whole, pixels=pixels).text()[:-1].encode()).decode().rstrip("\n")

        self.written.append(self.store.put(frame, last.file, label))


def label_of(path: Path, data: bytes) -> FrameLabel | None:
    """What the frame with these bytes says of itself; None where it says nothing.

    The label of a camera's own file lies beside it, and counts where the frame is the one that it was written for.
    """
    found = _parsed(read_record(data))
    if found is None:
        with contextlib.suppress(OSError, UnicodeDecodeError):
            found = _parsed(read_file(path.with_name(path.name + BESIDE)).decode())
    return found if found is not None and found.frame.file == path.name else None


def pixels_of(path: Path, data: bytes) -> str:
    """The checksum of a frame's pixels, as its label should have it: of all bytes of a camera's own file.

    Raises
    ------
    DataError
        The file is damaged.
    """
    return pixels_sha256(read_raw(path, data).mosaic) if read_record(data) else hashlib.sha256(data).hexdigest()


def _parsed(text: str) -> FrameLabel | None:
    try:
        label = FrameLabel.parsed(text)
        return None if label.pixels is not None and not is_whole(f"{text}\n".encode()) else label
    except (ValueError, RecursionError, DataError):
        return None


def slugs(bands: tuple[Band, ...]) -> dict[str, str]:
    """A part of a file name for every band."""
    out: dict[str, str] = {}
    for band in bands:
        slug = re.sub(r"[^A-Za-z0-9_]+", "", band.name) or "band"
        out[band.name] = slug if slug not in out.values() else f"{slug}_{len(out)}"
    return out
