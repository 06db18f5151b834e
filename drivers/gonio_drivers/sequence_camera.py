"""Frames from a folder, in the order of their names: replay of a measurement without a camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from gonio.errors import ConfigError, DataError, DeviceError
from gonio.rig import Frame, clock
from gonio.rig.description import RigDescription
from gonio.rig.dng import read_raw
from gonio.rig.regions import require_raw
from gonio_drivers import settings

RAW = (".dng", ".cr2", ".nef", ".arw")
IMAGES = (".png", ".tif", ".tiff")
EXPOSURE_TOLERANCE = 1e-3


class SequenceCamera:
    """An image sequence, as a `CameraDevice`.

    RAW files say their own exposure, and must have the one that is asked for. PNG and TIFF images (8 or 16 bit, grey)
    are taken for linear levels at the exposure that is asked for, with the levels of the rig file.
    """

    def __init__(self, description: RigDescription, camera: settings.SequenceCamera) -> None:
        self._folder = Path(camera.folder).expanduser()
        self._description = description.camera
        self._left: Iterator[Path] = iter(())

    def __enter__(self) -> Self:
        if not self._folder.is_dir():
            raise ConfigError(
                f'devices.camera.folder = "{self._folder}": there is no such folder; make it, or correct the key'
            )
        paths = sorted(p for p in self._folder.iterdir() if p.suffix.lower() in RAW + IMAGES)
        if not paths:
            raise ConfigError(f'devices.camera.folder = "{self._folder}": holds no frames ({", ".join(RAW + IMAGES)})')
        self._left = iter(paths)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        return Frame(
            image.astype(np.uint16),
            exposure_s,
            camera.black_level_dn,
            camera.white_level_dn,
            camera.pattern,
            time_s=clock.monotonic(),
        )
