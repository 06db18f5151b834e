"""A USB video camera through OpenCV: V4L2, or DirectShow where that is what the system has.

A video camera is a poor radiometer: its exposure may silently stay what it was, frames queue up, and gamma and white
balance bend its response. So every setting is read back, queued frames are thrown away until one was surely exposed
after the call, and without a response calibration the camera does not open for measurements.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from gonio.errors import ConfigError, DeviceError, PassingFault
from gonio.lab.rig import Frame, clock
from gonio.lab.rig.description import RigDescription
from gonio.typing import Array, NDArray
from gonio_drivers import settings
from gonio_drivers.patience import LATE_S, Patience

EXPOSURE_UNIT_S = 1e-4
"""V4L2 counts exposure in units of 100 us."""


class Backend(NamedTuple):
    """How OpenCV reaches cameras on one kind of system."""

    code: int
    """OpenCV's, by which it is chosen: another one may count otherwise."""
    name: str
    manual: float
    automatic: float
    """Codes for the mode of the exposure; switching through automatic makes stubborn cameras listen."""
    in_octaves: bool
    """Exposures are powers of two, and counted by their logarithm."""

    def count_of(self, exposure_s: float) -> int:
        """The number that stands for an exposure, or for the one that is nearest to it."""
        return round(math.log2(exposure_s) if self.in_octaves else exposure_s / EXPOSURE_UNIT_S)

    def seconds(self, count: int) -> float:
        """The exposure that a number stands for [s]."""
        return 2.0**count if self.in_octaves else count * EXPOSURE_UNIT_S


def backend() -> Backend:
    """The first of those that this OpenCV has; raises `DeviceError` where it has none that takes exposures."""
    import cv2

    known = (
        Backend(cv2.CAP_V4L2, "V4L2", 1, 3, in_octaves=False),
        Backend(cv2.CAP_DSHOW, "DirectShow", 0, 1, in_octaves=True),
    )
    there = cv2.videoio_registry.getCameraBackends()
    for one in known:
        if one.code in there:
            return one
    names = ", ".join(cv2.videoio_registry.getBackendName(code) for code in there) or "none"
    raise DeviceError(
        'devices.camera.driver = "uvc": OpenCV reaches video cameras here by ways that take no exposure time '
        f"({names}); measure on a system with V4L2 or DirectShow, or with another camera"
    )


WHITE = 65535.0
LACKING = -1.0
"""What OpenCV reads of a property that a camera has not."""


class UvcCamera:
    """A UVC camera, as a `CameraDevice`: its frames are made linear by a CSV, or left to `camera.response`.

    Parameters
    ----------
    description
        The rig: size of the frame, pattern.
    camera
        Device, response calibration, gain.
    capture
        What opens the device; OpenCV's `VideoCapture` by default.
    """

    def __init__(
        self, description: RigDescription, camera: settings.UvcCameraSettings, capture: Callable[..., Any] | None = None
    ) -> None:
        self._camera = camera
        self._description = description.camera
        self._open = capture
        self._capture: Any = None
        self._dtype: np.dtype[Any] | None = None
        self._response: NDArray[np.uint16] | None = None
        if camera.response is not None and self._description.response:
            raise ConfigError(
                "devices.camera.response and camera.response (of a calibration) both make the frames linear: take one "
                "out"
            )
        if camera.response is not None:
            self._response = read_response(Path(camera.response))
        elif not self._description.response:
            raise ConfigError(
                "devices.camera.response is missing: a video camera is not linear until its response was calibrated "
                '(docs/lab_setup.md, "Response of a video camera"); give the CSV of the calibration, or the file of '
                "`gonio calibrate camera --response` in [calibration]"
            )

    def __enter__(self) -> Self:
        import cv2

        self._by = backend()
        self._capture = (self._open or cv2.VideoCapture)(self._camera.device, self._by.code)
        if not self._capture.isOpened():
            self._capture = None
            raise DeviceError(
                f'devices.camera.device = "{self._camera.device}": no video camera opens there through '
                f"{self._by.name} (is it plugged in, "
                "used by another program, and are you in the group video?)"
            )
        self._require("width", cv2.CAP_PROP_FRAME_WIDTH, self._description.width)
        self._require("height", cv2.CAP_PROP_FRAME_HEIGHT, self._description.height)
        self._dtype = None
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # Y16 would become 8 bit
        self._switch_off("automatic white balance", cv2.CAP_PROP_AUTO_WB)
        self._switch_off("automatic focus", cv2.CAP_PROP_AUTOFOCUS)
        if self._camera.gain is not None:
            self._require("gain", cv2.CAP_PROP_GAIN, self._camera.gain)
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, self._by.automatic)
        self._switch_off("automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, self._by.manual)
        return self

    def __exit__(self, *_: object) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call, made linear by the response calibration."""
        import cv2

        if self._capture is None:
            raise DeviceError("the video camera is not open: enter the rig first")
        self._description.require_exposure(exposure_s)
        count = self._by.count_of(exposure_s)
        if not self._by.in_octaves and count < 1:
            raise ConfigError(
                f"an exposure of {exposure_s:g} s is below the {EXPOSURE_UNIT_S:g} s that a video camera counts in; "
                "see camera.exposure_limits_s"
            )
        self._require("exposure", cv2.CAP_PROP_EXPOSURE, count)
        exposure_s = self._by.seconds(count)
        begun = clock.monotonic()
        image = self._fresh(exposure_s)
        if self._response is None:  # the reduction makes linear what the camera gave
            raw, black, white = image, self._description.black_level_dn, self._description.white_level_dn
            if raw.dtype != np.uint8:
                raise DeviceError(
                    f"the video camera gives {raw.dtype}; camera.response is that of 8 bits: calibrate it as it is now"
                )
        else:
            raw, black, white = self._response[image] if image.dtype == np.uint8 else image, 0.0, WHITE
        mosaic = np.ascontiguousarray(raw.astype(np.uint16))
        return Frame(mosaic, exposure_s, black, white, self._description.pattern, time_s=begun)

    def _fresh(self, exposure_s: float) -> Array:
        """A frame that began after now: queued ones are dropped by count and by time."""
        import cv2

        begin, looked = clock.monotonic(), Patience(2 * exposure_s + LATE_S)
        stamped = float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        flows = all(self._capture.grab() for _ in range(self._camera.drop))
        while True:
            good, image = self._capture.read() if flows else (False, None)
            if not good or image is None:
                raise PassingFault(f"the video camera {self._camera.device} gives no frames", "camera")
            # V4L2 stamps frames with the monotonic clock; where a camera has no stamps, or such of another clock, which
            # show by lying in the future, the time of arrival must do
            stamp, now = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3, clock.monotonic()
            arrived = stamp if 0 < stamp <= now and stamp * 1e3 != stamped else now
            if arrived - exposure_s >= begin:
                break
            if looked() > 10 * exposure_s + 5.0:
                raise DeviceError(
                    f"the video camera {self._camera.device} gives only old frames, or its time stamps lag"
                )
        # unconverted YUYV has its luminance first; a converted frame is blue, green, red, and green is nearest to it
        image = np.asarray(image)
        channels = image.shape[2] if image.ndim == 3 else 0
        grey = image[..., 1 if channels > 2 else 0] if channels else np.atleast_2d(image)
        if self._dtype is not None and grey.dtype != self._dtype:
            raise DeviceError(f"the video camera gives {grey.dtype} instead of {self._dtype}: its format has changed")
        self._dtype = grey.dtype
        if grey.shape != (self._description.height, self._description.width):
            raise DeviceError(
                f"the video camera gives {grey.shape[1]} x {grey.shape[0]} pixels; the rig file says "
                f"{self._description.width} x {self._description.height} (a compressed format, MJPG, is not decoded: "
                "set the camera to YUYV, GREY or Y16)"
            )
        return np.asarray(grey)

    def _switch_off(self, what: str, property_: int, off: float = 0) -> None:
        """As `_require`; what the camera has not, of which OpenCV reads -1, is off already."""
        self._capture.set(property_, off)
        if self._capture.get(property_) != LACKING:
            self._require(what, property_, off)

    def _require(self, what: str, property_: int, value: float) -> None:
        """Set something, and read it back: cameras ignore settings without a word."""
        self._capture.set(property_, value)
        got = self._capture.get(property_)
        if abs(got - value) > 1e-6 + 1e-3 * abs(value):
            raise DeviceError(
                f"the video camera {self._camera.device} does not take {what} = {value:g}: it stays at {got:g}"
            )


def read_response(path: Path) -> NDArray[np.uint16]:
    """Linear level for every 8-bit value, from a CSV with the columns `dn` and `relative_exposure`.

    Returns
    -------
    array of 256 uint16, 0 where nothing shone and 65535 at full scale

    Raises
    ------
    ConfigError
        The file is missing or its values do not grow.
    """
    try:
        table = np.genfromtxt(path, delimiter=",", names=True, dtype=float, encoding="utf-8")
        dn, exposure = np.atleast_1d(table["dn"]), np.atleast_1d(table["relative_exposure"])
    except OSError:
        raise ConfigError(f'devices.camera.response = "{path}": there is no such file') from None
    except (ValueError, IndexError, TypeError):
        raise ConfigError(f"{path}: a response has the columns dn, relative_exposure") from None
    if dn.size < 2 or np.any(np.diff(dn) <= 0) or np.any(np.diff(exposure) <= 0) or not np.isfinite(exposure).all():
        raise ConfigError(f"{path}: dn and relative_exposure must both grow from row to row")
    curve = np.interp(np.arange(256), dn, exposure)
    scaled = (curve - curve[0]) / (curve[-1] - curve[0]) * WHITE
    return np.asarray(np.round(scaled), dtype=np.uint16)
