"""Basler cameras through pypylon: an optional extra (`pip install gonio[basler]`), and a model for other drivers.

The camera stands still until it is asked: one frame is exposed for one call, with every automatic function off.
"""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any, Self

import numpy as np

from gonio.config import Strict, parse
from gonio.errors import ConfigError, DeviceError, PassingFault
from gonio.rig import Frame
from gonio.rig.description import Positive, RigDescription

AUTOMATIC = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")
EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
"""The feature's name in newer and in older cameras [us]."""
BAYER = {"RGGB": "BayerRG", "BGGR": "BayerBG", "GRBG": "BayerGR", "GBRG": "BayerGB", "mono": "Mono"}
EXPOSURE_TOLERANCE = 0.01


class Settings(Strict):
    """The keys of `[devices.camera]` beside `driver = "basler"`."""

    serial: str | None = None
    """Serial number; without it the only camera there is."""
    timeout_s: Positive = 5.0


class BaslerCamera:
    """A Basler camera, as a `CameraDevice`."""

    def __init__(self, description: RigDescription, settings: Settings) -> None:
        self._settings = settings
        self._description = description.camera
        self._camera: Any = None

    def __enter__(self) -> Self:
        try:
            from pypylon import genicam, pylon
        except ImportError:
            raise ConfigError('devices.camera.driver = "basler" needs pypylon: pip install "gonio[basler]"') from None
        factory = pylon.TlFactory.GetInstance()
        found = {device.GetSerialNumber(): device for device in factory.EnumerateDevices()}
        wanted = self._settings.serial or (next(iter(found)) if len(found) == 1 else "")
        if wanted not in found:
            raise DeviceError(
                f'devices.camera.serial = "{wanted}": no such Basler camera; found: {", ".join(found) or "none"}'
            )
        try:
            self._camera = pylon.InstantCamera(factory.CreateDevice(found[wanted]))
            self._camera.Open()
            self._set_up()
        except genicam.GenericException as error:
            self.__exit__(None, None, None)
            raise DeviceError(f"the Basler camera {wanted} does not open: {error}") from None
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._camera is not None and self._camera.IsOpen():
            self._camera.Close()
        self._camera = None

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call."""
        from pypylon import genicam

        if self._camera is None:
            raise DeviceError("the Basler camera is not open: enter the rig first")
        self._description.require_exposure(exposure_s)
        try:
            feature = self._feature(*EXPOSURES)
            feature.SetValue(1e6 * exposure_s)
            actual = feature.GetValue() * 1e-6
            if abs(actual / exposure_s - 1) > EXPOSURE_TOLERANCE:
                raise DeviceError(f"the Basler camera exposes {actual:g} s where {exposure_s:g} s were asked")
            begun = time.monotonic()
            result = self._camera.GrabOne(round(1e3 * (exposure_s + self._settings.timeout_s)))
            if not result.GrabSucceeded():
                raise PassingFault(f"the Basler camera gives no frame: {result.GetErrorDescription()}", "camera")
            mosaic = np.array(result.Array, dtype=np.uint16)
        except genicam.GenericException as error:
            raise DeviceError(f"the Basler camera gives no frame: {error}") from None
        camera = self._description
        return Frame(mosaic, actual, camera.black_level_dn, camera.white_level_dn, camera.pattern, time_s=begun)

    def _set_up(self) -> None:
        """Size and bits of the rig file, and nothing automatic; what the camera does not take is an error."""
        from pypylon import genicam

        camera = self._description
        for name in AUTOMATIC:
            feature = getattr(self._camera, name)
            if feature.IsWritable():
                feature.SetValue("Off")
        wanted = {
            "Width": camera.width,
            "Height": camera.height,
            "PixelFormat": f"{BAYER[camera.pattern]}{camera.bits}",
        }
        for name, value in wanted.items():
            feature = getattr(self._camera, name)
            try:
                feature.SetValue(value)
            except genicam.GenericException as error:
                raise DeviceError(f"the Basler camera does not take {name} = {value}: {error}") from None
            if feature.GetValue() != value:
                raise DeviceError(f"the Basler camera does not take {name} = {value}: it stays at {feature.GetValue()}")

    def _feature(self, *names: str) -> Any:
        for name in names:
            feature = getattr(self._camera, name)
            if feature.IsWritable():
                return feature
        raise DeviceError(f"the Basler camera has no feature {' or '.join(names)} that can be set")


def basler(description: RigDescription, table: dict[str, Any]) -> BaslerCamera:
    """The entry point `basler` of the group `gonio.cameras`."""
    return BaslerCamera(description, parse(Settings, table, "[devices.camera]"))
