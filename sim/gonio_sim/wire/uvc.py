"""A stand-in for a USB video camera: what `cv2.VideoCapture` offers, over images of a sequence or of a world.

It keeps a queue of frames that were exposed before anybody asked, as V4L2 does, and can be made as stubborn as real
cameras are.
"""

from collections import deque
from collections.abc import Callable, Iterable
from itertools import cycle
from typing import Any

import cv2
import numpy as np

from gonio.lab.rig import clock
from gonio.typing import Array

QUEUE = 4
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
        first = self._image(1e-3)
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
            self._queue.append((clock.monotonic() - 0.1 * (QUEUE - k), np.zeros_like(self._image(1e-3))))

    def _exposure_s(self) -> float:
        return self._values[cv2.CAP_PROP_EXPOSURE] * 1e-4
