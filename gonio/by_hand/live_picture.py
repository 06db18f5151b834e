"""Pictures of raw frames for a screen: the whole frame made smaller, and its middle pixel by pixel."""

import math
from dataclasses import dataclass

import numpy as np

from gonio.acquisition import exposure
from gonio.by_hand import looking
from gonio.rig import Frame
from gonio.rig.light_and_camera import Camera
from gonio.typing import Array, Bools, NDArray

WIDEST = 960
"""Columns of the picture, at most."""
ZOOM_PX = 96
"""Pixels of the frame along each side of the enlarged part, at most."""
JPEG_QUALITY = 85
FAINTEST = 0.02
"""Of full scale: a picture that is darker than this throughout is not brightened any more, to noise that looks lit."""
SRGB_GAMMA = 1.0 / 2.2
"""Screens undo it: what is shown is proportional to the light."""
SPECK_PX = 3
"""A single saturated pixel is so wide in the picture."""
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

    height, width = frame.mosaic.shape
    shrink = min(1.0, WIDEST / width)
    size = max(round(width * shrink), 1), max(round(height * shrink), 1)
    if shrink <= 0.5 and not camera.response:  # cells of a mosaic are averaged by that
        small = cv2.resize(frame.mosaic, size, interpolation=cv2.INTER_AREA).astype(np.float32) - frame.black_level_dn
    else:
        cells = looking.cells(frame.pattern, looking.signal(camera, frame))
        small = cv2.resize(cells, size, interpolation=cv2.INTER_AREA)
    over = looking.saturated(camera, frame).view(np.uint8)
    red = np.zeros(small.shape, dtype=bool)
    if over.any():
        reach = np.ones((math.ceil(SPECK_PX / shrink),) * 2, np.uint8)
        red = cv2.resize(cv2.dilate(over, reach), size, interpolation=cv2.INTER_NEAREST) > 0
    full = exposure.full_scale_dn(camera, frame)
    brightest = cv2.medianBlur(np.ascontiguousarray(small, np.float32), 3).max()  # single hot pixels aside
    white = max(float(brightest), FAINTEST * full)
    rows, cols = _part(middle[1], height), _part(middle[0], width)
    zoomed = _shown(looking.signal(camera, frame, frame.mosaic[rows, cols]), over[rows, cols] > 0, white)
    colours = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444  # of every pixel
    return Pictures(
        whole=_encoded(".jpg", _shown(small, red, white), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, *colours]),
        zoom=_encoded(".png", zoomed, [cv2.IMWRITE_PNG_COMPRESSION, 1]),
        zoom_box=(cols.start, rows.start, cols.stop - cols.start, rows.stop - rows.start),
        white_dn=white,
    )


def _part(middle: float, size: int) -> slice:
    """Around a place, inside the frame."""
    length = min(ZOOM_PX, size)
    first = min(max(round(middle) - length // 2, 0), size - length)
    return slice(first, first + length)


def _shown(signal: Array, over: Bools, white: float) -> NDArray[np.uint8]:
    grey = np.rint(255.0 * np.clip(signal / white, 0.0, 1.0) ** SRGB_GAMMA).astype(np.uint8)
    out = np.repeat(grey[..., None], 3, axis=2)
    out[over] = SATURATED_BGR
    return out


def _encoded(suffix: str, image: NDArray[np.uint8], options: list[int]) -> bytes:
    import cv2

    good, data = cv2.imencode(suffix, image, options)
    assert good, "OpenCV writes JPEG and PNG wherever it is built"
    return data.tobytes()
