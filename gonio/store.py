"""Frames on their way to the disk: written in a thread of their own, whole or not at all."""

from __future__ import annotations

import hashlib
import re
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gonio.description import Band
from gonio.disk import sync_folder, write_whole
from gonio.errors import DataError
from gonio.frames import write_dng
from gonio.rig import Frame, Step

WAITING = 8
"""How many frames may wait for the disk before the camera has to."""


class Store:
    """Writes frames in a thread of its own, in order, so that the disk and the camera work at the same time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-frames")
        self._room = threading.Semaphore(WAITING)

    def put(self, frame: Frame, name: str) -> Future[str]:
        """Begin to write a frame; the future is the SHA-256 of its file, once that is on the disk."""
        self._room.acquire()
        return self._pool.submit(self._write, frame, self._folder / name)

    def _write(self, frame: Frame, path: Path) -> str:
        try:
            if frame.file is None:
                write_dng(frame, path)
            else:
                write_whole(path, frame.file.read_bytes())  # the camera's own
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}") from None
        finally:
            self._room.release()

    def sync(self) -> None:
        """Wait until the names of the frames are on the disk too."""
        sync_folder(self._folder)

    def close(self) -> None:
        """End the thread; frames that wait are not written any more."""
        self._pool.shutdown(cancel_futures=True)


@dataclass(slots=True)
class Files:
    """The frames of one step in one band."""

    store: Store
    step: Step
    slug: str
    band: str
    lamp: bool
    frames: list[dict[str, Any]] = field(default_factory=list)
    written: list[Future[str]] = field(default_factory=list)

    def keep(self, frame: Frame) -> None:
        """Begin to write a frame, and note what the journal will say of it."""
        suffix = ".dng" if frame.file is None else frame.file.suffix.lower()
        name = f"{self.step.index:06d}-{self.slug}-{len(self.frames) + 1:02d}{suffix}"
        self.frames.append(
            {
                "file": name,
                "band": self.band,
                "exposure_s": frame.exposure_s,
                "time_s": float(frame.time_s),
                "lamp": self.lamp,
            }
        )
        self.written.append(self.store.put(frame, name))


def slugs(bands: tuple[Band, ...]) -> dict[str, str]:
    """A part of a file name for every band."""
    out: dict[str, str] = {}
    for band in bands:
        slug = re.sub(r"[^A-Za-z0-9_]+", "", band.name) or "band"
        out[band.name] = slug if slug not in out.values() else f"{slug}_{len(out)}"
    return out
