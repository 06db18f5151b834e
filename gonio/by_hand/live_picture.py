"""Pictures of raw frames for a screen: the whole frame made smaller, and its middle pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.acquisition import exposure
from gonio.by_hand import looking
from gonio.rig import Frame
from gonio.rig.description import Camera

WIDEST = 960
"""Columns of the picture, at most."""
ZOOM_PX = 96
"""Pixels of the frame along each side of the enlarged part, at most."""
JPEG_QUALITY = 85
FAINTEST = 0.02
"""Of full scale: a picture that is darker than this throughout is not brightened any more, to noise that looks lit."""
SRGB_GAMMA = 1.0 / 2.2
"""Screens undo it: what is shown is proportional to the light."""
SATURATED_BGR = (40, 40, 235)


@dataclass(frozen=True, slots=True)
class Pictures:
    """Of one frame; grey, with saturated pixels red."""

    whole: bytes
    """JPEG, in the proportions of the frame."""
    zoom: bytes
    """PNG, one pixel of it for a pixel of the frame."""
    zoom_box: tuple[int, int, int, int]
    """Its first column and row, and its columns and rows, in the frame."""
    white_dn: float
    """The signal above the black level that is shown white [DN]."""


def pictures(camera: Camera, frame: Frame, middle: tuple[float, float]) -> Pictures:
    """Both pictures; `middle`: column and row around which the frame is enlarged."""
    import cv2

    image, over = looking.signal(camera, frame), looking.saturated(camera, frame)
    shrink = min(1.0, WIDEST / image.shape[1])
    size = max(round(image.shape[1] * shrink), 1), max(round(image.shape[0] * shrink), 1)
    small = cv2.resize(looking.cells(frame.pattern, image), size, interpolation=cv2.INTER_AREA)
    red = cv2.resize(over.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0  # a single pixel shows too
    full = exposure.full_scale_dn(camera, frame)
    brightest = cv2.medianBlur(np.ascontiguousarray(small, np.float32), 3).max()  # single hot pixels aside
    white = max(float(brightest), FAINTEST * full)
    rows, cols = (_part(middle[1], image.shape[0]), _part(middle[0], image.shape[1]))
    zoomed = _shown(image[rows, cols], over[rows, cols], white)
    return Pictures(
        whole=_encoded(".jpg", _shown(small, red, white), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]),
        zoom=_encoded(".png", zoomed, [cv2.IMWRITE_PNG_COMPRESSION, 1]),
        zoom_box=(cols.start, rows.start, cols.stop - cols.start, rows.stop - rows.start),
        white_dn=white,
    )


def _part(middle: float, size: int) -> slice:
    """Around a place, inside the frame."""
    length = min(ZOOM_PX, size)
    first = min(max(round(middle) - length // 2, 0), size - length)
    return slice(first, first + length)


def _shown(signal: npt.NDArray[Any], over: npt.NDArray[np.bool_], white: float) -> npt.NDArray[np.uint8]:
    grey = np.rint(255.0 * np.clip(signal / white, 0.0, 1.0) ** SRGB_GAMMA).astype(np.uint8)
    out = np.repeat(grey[..., None], 3, axis=2)
    out[over] = SATURATED_BGR
    return out


def _encoded(suffix: str, image: npt.NDArray[np.uint8], options: list[int]) -> bytes:
    import cv2

    good, data = cv2.imencode(suffix, image, options)
    assert good, "OpenCV writes JPEG and PNG wherever it is built"
    return data.tobytes()
