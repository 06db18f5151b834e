"""A stand-in for a USB video camera: what `cv2.VideoCapture` offers, over images of a sequence or of a world.

It keeps a queue of frames that were exposed before anybody asked, as V4L2 does, and can be made as stubborn as real
cameras are. `uvc_twin` is the driver "uvc" with such a stand-in, which asks `gonio sim serve` for its frames.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Iterable
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gonio import plugins
from gonio.errors import DataError
from gonio.lab.rig import clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.dng import read_raw
from gonio.typing import Array, TomlTable

QUEUE = 4
WAIT_S = 20.0
"""So long may a frame of `gonio sim serve` take beside its exposure."""
OLD_S = 0.5
AUTOMATIC = 3.0


class VideoStandIn:
    """The side of `cv2.VideoCapture` that a driver uses.

    Parameters
    ----------
    images
        Shown over and over, or a callable that gives the image of an exposure [s].
    stubborn
        Properties that silently stay what they are.
    present
        Whether there is a camera at all.
    """

    def __init__(
        self,
        images: Iterable[Array] | Callable[[float], Array],
        *,
        stubborn: Iterable[int] = (),
        present: bool = True,
    ) -> None:
        source = None if callable(images) else cycle(images)
        self._image: Callable[[float], Array] = images if callable(images) else lambda _: next(source)  # type: ignore
        self._stubborn = frozenset(stubborn)
        self._open = present
        first = self._first = self._image(1e-3)
        self._values: dict[int, float] = {
            cv2.CAP_PROP_FRAME_HEIGHT: first.shape[0],
            cv2.CAP_PROP_FRAME_WIDTH: first.shape[1],
            cv2.CAP_PROP_AUTO_EXPOSURE: AUTOMATIC,
            cv2.CAP_PROP_EXPOSURE: 157.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_AUTOFOCUS: 1.0,
        }
        self._queue: deque[tuple[float, Array]] = deque()
        self.fall_behind()
        self._stamp = 0.0
        self.opened_with: tuple[Any, ...] = ()

    def __call__(self, *arguments: Any) -> "VideoStandIn":
        """Open it, as `cv2.VideoCapture(device, api)` does."""
        self.opened_with = arguments
        return self

    def isOpened(self) -> bool:
        return self._open

    def set(self, prop: int, value: float) -> bool:
        if prop not in self._stubborn:
            self._values[prop] = float(value)
        return True  # cameras claim success

    def get(self, prop: int) -> float:
        return 1e3 * self._stamp if prop == cv2.CAP_PROP_POS_MSEC else self._values.get(prop, 0.0)

    def grab(self) -> bool:
        if not self._open:
            return False
        self._stamp, self._grabbed = self._next()
        return True

    def read(self) -> tuple[bool, Array | None]:
        return (True, self._grabbed) if self.grab() else (False, None)

    def release(self) -> None:
        self._open = False

    def _next(self) -> tuple[float, Array]:
        if self._queue:
            return self._queue.popleft()
        clock.sleep(self._exposure_s())
        return clock.monotonic(), self._image(self._exposure_s())

    def fall_behind(self) -> None:
        """Let dark frames wait in the queue that were exposed a while ago."""
        for k in range(QUEUE):
            self._queue.append((clock.monotonic() - 0.1 * (QUEUE - k), np.zeros_like(self._first)))

    def _exposure_s(self) -> float:
        return self._values[cv2.CAP_PROP_EXPOSURE] * 1e-4


class ServedVideo(VideoStandIn):
    """The camera of `gonio sim serve`, as a process that measures sees it. Exposures take their real time.

    What is grabbed without being looked at is old: the frames that waited in the queue.
    """

    def __init__(self, port: str, folder: Path, size: tuple[int, int]) -> None:
        import serial

        super().__init__(lambda exposure_s: np.zeros(size, np.uint8))
        self._folder = folder
        self._line = serial.serial_for_url(port, baudrate=115_200, timeout=WAIT_S)

    def grab(self) -> bool:
        self._stamp = clock.monotonic() - OLD_S
        return self._open

    def read(self) -> tuple[bool, Array | None]:
        begun, exposure_s = clock.monotonic(), self._exposure_s()
        there = set(self._folder.iterdir())
        self._line.reset_input_buffer()
        self._line.write(f"EXPOSE {exposure_s:.9g}\n".encode())
        if not self._open or self._line.readline().strip() != b"OK":
            return False, None
        while not (new := {f for f in self._folder.iterdir() if f.suffix == ".DNG"} - there):
            if clock.monotonic() - begun > exposure_s + WAIT_S:
                return False, None
            clock.sleep(0.005)
        image = None
        for file in new:
            with contextlib.suppress(DataError):
                image = read_raw(file).mosaic.astype(np.uint8)
            file.unlink()
        clock.sleep(max(0.0, begun + exposure_s - clock.monotonic()))
        self._stamp = clock.monotonic()
        return image is not None, image

    def release(self) -> None:
        super().release()
        self._line.close()


def uvc_twin(description: RigDescription, table: TomlTable) -> Any:
    """The entry point `uvc-twin` of `gonio.cameras`: the driver of USB cameras, which opens a `ServedVideo`.

    `device` is the port at which `gonio sim serve` takes exposures, `folder` where its frames come.
    """
    rest = dict(table)
    folder, size = Path(rest.pop("folder", "twin/frames")), (description.camera.height, description.camera.width)
    return plugins.load("gonio.cameras", "uvc")(
        description, rest, capture=lambda device, api: ServedVideo(device, folder, size)
    )
