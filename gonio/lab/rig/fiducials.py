"""Printed markers around the holder's aperture: where they lie, and what is black of them."""

from functools import lru_cache
from typing import Any

import numpy as np

from gonio.errors import ConfigError
from gonio.lab.rig.description import Fiducials
from gonio.typing import Bools, Floats, NDArray

RIM = 0.2
"""White around each marker, of its side: without it the black square has no edge."""


def dictionary_of(name: str) -> Any:
    """A dictionary of OpenCV's by its name.

    Raises
    ------
    ConfigError
        There is none of this name.
    """
    import cv2

    known = [each for each in dir(cv2.aruco) if each.startswith("DICT_")]
    if name not in known:
        raise ConfigError(f'dictionary = "{name}": OpenCV knows {", ".join(known[:4])} ... and {len(known) - 4} more')
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def centres_mm(marks: Fiducials) -> Floats:
    """Middles of the markers in the sample's plane [mm], shape (count, 2)."""
    turn = 2.0 * np.pi * np.arange(marks.count) / marks.count
    return marks.ring_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)


@lru_cache(maxsize=4)
def corners_mm(marks: Fiducials) -> Floats:
    """Corners of the black squares in the sample's plane [mm], shape (count, 4, 2), in OpenCV's order: top left, top
    right, bottom right, bottom left, for who looks onto the sample with its y up; not to be written to."""
    square = 0.5 * marks.marker_mm * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    out = np.asarray(centres_mm(marks)[:, None, :] + square)
    out.setflags(write=False)
    return out


@lru_cache(maxsize=4)
def cells(name: str, first_id: int, count: int) -> Bools:
    """What is white of each marker, shape (count, n, n) from its top row down, the black border of one cell included.

    Raises
    ------
    ConfigError
        There is no such dictionary, or it has not so many markers.
    """
    import cv2

    dictionary = dictionary_of(name)
    if first_id + count > dictionary.bytesList.shape[0]:
        raise ConfigError(
            f"holder.fiducials: ids {first_id} to {first_id + count - 1} are needed, and {name} has "
            f"{dictionary.bytesList.shape[0]} markers"
        )
    n = dictionary.markerSize + 2
    return np.array([cv2.aruco.generateImageMarker(dictionary, first_id + k, n) for k in range(count)]) > 127


def white(marks: Fiducials, x_mm: Floats, y_mm: Floats) -> NDArray[np.int8]:
    """What is printed at spots of the sample's plane: 1 paper (marker's white or rim), 0 ink, -1 the bare plate."""
    pattern = cells(marks.dictionary, marks.first_id, marks.count)
    n = pattern.shape[1]
    out = np.full(np.shape(x_mm), -1, np.int8)
    reach = (0.5 + RIM) * marks.marker_mm
    for k, (cx, cy) in enumerate(centres_mm(marks)):
        across, up = x_mm - cx, y_mm - cy
        near = (np.abs(across) <= reach) & (np.abs(up) <= reach)
        if not near.any():
            continue
        column = np.floor((across[near] / marks.marker_mm + 0.5) * n).astype(int)
        row = np.floor((0.5 - up[near] / marks.marker_mm) * n).astype(int)
        inside = (column >= 0) & (column < n) & (row >= 0) & (row < n)
        here = np.ones(column.shape, np.int8)
        here[inside] = pattern[k][row[inside], column[inside]]
        out[near] = here
    return out
