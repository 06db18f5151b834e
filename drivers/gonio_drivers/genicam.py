"""GenICam cameras through harvesters: an optional extra (`pip install gonio[genicam]`).

Any camera that follows the standard (GigE Vision, USB3 Vision, CoaXPress), of any maker, through a GenTL producer: the
file that ends with .cti and comes with a maker's software. The camera stands still until it is asked: the stream is
started for one frame, and stopped after it, with every automatic function off.

A camera with the event `ExposureEnd`, single frames and a global shutter says when an exposure is over, and is read out
while the arms move on. With a rolling shutter rows go on being exposed; in a stream that runs it may be the end of an
older frame.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from gonio.config import NonNegative, Positive, Strict, parse
from gonio.errors import ConfigError, DeviceError, PassingFault
from gonio.lab.rig import Arrived, Exposed, Frame, clock
from gonio.lab.rig.description import RigDescription
from gonio.typing import NDArray, TomlTable
from gonio_drivers import log

OFF = {
    "AcquisitionFrameRateEnable": False, "ExposureAuto": "Off", "GainAuto": "Off", "BlackLevelAuto": "Off",
    "BalanceWhiteAuto": "Off", "GammaEnable": False, "LUTEnable": False, "ReverseX": False, "ReverseY": False,
    "TriggerMode": "Off", "ExposureMode": "Timed",
}  # fmt: skip
"""What a camera that has the feature must have it at: linear values, timed by us alone (names of the SFNC)."""
EXPOSURES = ("ExposureTime", "ExposureTimeAbs")
"""Names of the exposure, in microseconds; the second in cameras from before the SFNC 2.0."""
GAINS, BLACKS = ("Gain", "GainRaw"), ("BlackLevel", "BlackLevelRaw")
BASES = {"RGGB": "BayerRG", "BGGR": "BayerBG", "GRBG": "BayerGR", "GBRG": "BayerGB", "mono": "Mono"}
OVER = ("EventExposureEndTimestamp", "ExposureEndEventTimestamp")
"""Time of the last end of an exposure, once there was one; the second in cameras from before the SFNC 2.0."""
NOTIFIED = ("On", "GenICamEvent")
LOOK_S = 0.002
ONCE_MORE_S = 0.01
EXPOSURE_TOLERANCE = 0.05
"""A camera counts in lines; the reduction takes what the camera says."""
READ_BACK = 1e-3
PATHS = "GENICAM_GENTL64_PATH"
"""Folders of producers, as makers' software sets it."""


class GenicamSettings(Strict):
    """The keys of `[devices.camera]` beside `driver = "genicam"`."""

    producer: str | None = None
    """The GenTL producer, a .cti file; without it those in the folders of GENICAM_GENTL64_PATH."""
    serial: str | None = None
    """Serial number; without it the only camera there is."""
    pixel_format: str | None = None
    """As "Mono12p"; without it the first that the camera has of those with the rig file's pattern and bits."""
    gain: NonNegative | None = None
    """In the camera's own unit; None leaves it."""
    black_level: NonNegative | None = None
    """The camera's own setting; None leaves it. What comes out of it is `camera.black_level_dn`."""
    timeout_s: Positive = 5.0
    """How long after the end of the exposure a frame may take."""


class GenICamCamera:
    """A GenICam camera, as a `CameraDevice`."""

    def __init__(self, description: RigDescription, settings: GenicamSettings) -> None:
        self._settings = settings
        self._description = description.camera
        self._harvester: Any = None
        self._camera: Any = None
        self._format = ""
        self._failures: tuple[type[Exception], ...] = ()
        self._who = "GenICam camera"
        self._tells = False
        """Whether it says when an exposure is over."""
        if settings.pixel_format is not None and settings.pixel_format not in self._formats():
            raise ConfigError(
                f'devices.camera.pixel_format = "{settings.pixel_format}" does not fit camera.pattern = '
                f'"{self._description.pattern}" and camera.bits = {self._description.bits}: these have '
                f"{', '.join(self._formats())}"
            )

    def __enter__(self) -> Self:
        try:
            from genicam import genapi, gentl
            from harvesters.core import Harvester, ParameterKey, ParameterSet
        except ImportError:
            raise ConfigError(
                'devices.camera.driver = "genicam" needs harvesters: pip install "gonio[genicam]"'
            ) from None
        self._genapi = genapi
        self._failures = (genapi.GenericException, gentl.GenericException, ValueError, OSError)
        self._harvester = Harvester()
        try:
            for path in self._producers():
                self._harvester.add_file(str(path))
            self._harvester.update()
            chosen = self._chosen()
            with _keeping_ctrl_c():
                self._camera = self._harvester.create(chosen)
                if self._may_tell():  # events are listened to from the beginning, or not at all
                    self._camera.destroy()
                    listening = ParameterSet({ParameterKey.ENABLE_EVENT_MONITOR: True})
                    self._camera = self._harvester.create(chosen, config=listening)
            self._set_up()
            self._tells = self._may_tell() and self._notifies()
        except self._failures as error:
            self.__exit__()
            raise DeviceError(f"the {self._who} does not open: {error}") from None
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        camera, harvester = self._camera, self._harvester
        self._camera = self._harvester = None
        if camera is not None:
            with contextlib.suppress(*self._failures):
                camera.destroy()
        if harvester is not None:
            with contextlib.suppress(*self._failures):
                harvester.reset()

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call; its exposure is what the camera says."""
        return self._begun(exposure_s).result()

    def expose(self, exposure_s: float) -> Exposed:
        """The same once the camera says that the exposure is over; of one that does not, with its frame."""
        begun = self._begun(exposure_s)
        over = begun.over() if self._tells else None
        if self._tells and over is None:
            self._tells = False
            log.warning("the %s says it could tell when an exposure is over, and does not: moves wait", self._who)
        return over or Arrived(begun.result())

    # ---- inside ----

    def _begun(self, exposure_s: float) -> "Exposure":
        """An exposure of a stream that was just started."""
        if self._camera is None:
            raise DeviceError("the GenICam camera is not open: enter the rig first")
        self._description.require_exposure(exposure_s)
        with self.named_failures():
            feature = self._feature(*EXPOSURES)
            feature.value = type(feature.value)(1e6 * exposure_s)
            actual = float(feature.value) * 1e-6
            if abs(actual / exposure_s - 1) > EXPOSURE_TOLERANCE:
                raise DeviceError(f"the {self._who} exposes {actual:g} s where {exposure_s:g} s were asked")
            before = self.ended()
            begun = clock.monotonic()
            end = begun + 2 * actual + self._settings.timeout_s
            self._camera.start()
            return Exposure(self, actual, begun, end, before)

    @contextlib.contextmanager
    def named_failures(self) -> Iterator[None]:
        """Errors of the libraries become `DeviceError`."""
        try:
            yield
        except self._failures as error:
            raise DeviceError(f"the {self._who} gives no frame: {error}") from None

    def ended(self) -> int | None:
        """When the last exposure was over, on the camera's clock; None before the first, or where it does not say."""
        node = next((node for name in OVER if (node := self._node(name, "RO", "RW")) is not None), None)
        return None if node is None else int(node.value)

    def fresh(self, exposure_s: float, begun: float, end: float) -> Frame:
        """The first whole frame that came late enough to have begun after the call."""
        end, incomplete = max(end, clock.monotonic() + self._settings.timeout_s), 0
        try:
            while True:
                left = end - clock.monotonic()
                # `fetch` would wait without limit for a whole frame; one that has arrived when time is up still counts
                buffer = self._camera.try_fetch(timeout=max(left, ONCE_MORE_S), is_raw=True)
                arrived = clock.monotonic()
                if buffer is None and left <= 0:
                    said = f"{incomplete} frames with parts missing" if incomplete else "no frame"
                    within = f"within {self._settings.timeout_s:g} s"
                    raise PassingFault(
                        f"the {self._who} gives {said} {within}; check cable, network and power", "camera"
                    )
                if buffer is None:  # the time is over, or it had parts missing
                    incomplete += arrived < end
                    continue
                frame = self._framed(buffer, arrived, exposure_s, begun)
                if frame is not None:
                    return frame
        finally:
            self._camera.stop()

    def early(self, exposure_s: float, begun: float) -> tuple[bool, Frame | None]:
        """Whether a buffer came in a moment, and its frame: none of one that had waited, which is thrown away."""
        buffer = self._camera.try_fetch(timeout=LOOK_S, is_raw=True)
        if buffer is None:
            return False, None
        frame = self._framed(buffer, clock.monotonic(), exposure_s, begun)
        if frame is not None:
            self._camera.stop()
        return True, frame

    def _framed(self, buffer: Any, arrived: float, exposure_s: float, begun: float) -> Frame | None:
        """The frame of a buffer, if it came late enough to have begun after the call."""
        try:
            if arrived - exposure_s < begun:
                return None
            mosaic = self._mosaic(buffer)
        finally:
            buffer.parent.queue_buffer(buffer)
        camera = self._description
        levels = camera.black_level_dn, camera.white_level_dn
        return Frame(mosaic, exposure_s, *levels, camera.pattern, time_s=begun)

    def _may_tell(self) -> bool:
        """Whether the camera has what `_tells` needs."""
        nodes = self._camera.remote_device.node_map
        if not (self._has("EventSelector") and "ExposureEnd" in nodes.EventSelector.symbolics):
            return False
        single = self._has("AcquisitionMode") and "SingleFrame" in nodes.AcquisitionMode.symbolics
        return single and (not self._has("SensorShutterMode") or nodes.SensorShutterMode.value == "Global")

    def _notifies(self) -> bool:
        """Have it tell the end of exposures, where it does that."""
        nodes = self._camera.remote_device.node_map
        self._set("EventSelector", "ExposureEnd")
        how = next((name for name in NOTIFIED if name in nodes.EventNotification.symbolics), None)
        if how is not None:
            self._set("EventNotification", how)
        return how is not None

    def _mosaic(self, buffer: Any) -> NDArray[np.uint16]:
        camera = self._description
        if (buffer.height, buffer.width) != (camera.height, camera.width):
            raise DeviceError(
                f"the {self._who} gives {buffer.width} x {buffer.height} pixels; the rig file says {camera.width} x "
                f"{camera.height}"
            )
        data = np.frombuffer(buffer.raw_buffer, np.uint8, offset=buffer.image_offset)
        line = row_bytes(self._format, camera.width) + buffer.padding_x
        if data.size < line * camera.height:
            raise DeviceError(f"the {self._who} gives {data.size} bytes, fewer than {camera.height} lines of {line}")
        lines = data[: line * camera.height].reshape(camera.height, line)
        mosaic = unpack(lines[:, : line - buffer.padding_x], self._format, camera.width)
        if mosaic.max() > camera.white_level_dn:
            raise DeviceError(
                f"the {self._who} gives values up to {mosaic.max()}, beyond the {camera.bits} bits of {self._format}"
            )
        return mosaic

    def _producers(self) -> list[Path]:
        if self._settings.producer is not None:
            path = Path(self._settings.producer).expanduser()
            if not path.is_file():
                raise ConfigError(f'devices.camera.producer = "{path}": there is no such file')
            return [path]
        folders = [Path(folder) for folder in os.environ.get(PATHS, "").split(os.pathsep) if folder]
        found = sorted(path for folder in folders for path in folder.glob("*.cti"))
        if not found:
            raise ConfigError(
                "devices.camera.producer is missing: name the .cti file of the maker's software, or set "
                f"{PATHS} to its folder"
            )
        return found

    def _chosen(self) -> dict[str, str]:
        """What harvesters finds the camera by."""
        listed = self._harvester.device_info_list
        serials = [str(device.serial_number) for device in listed]
        found = ", ".join(f'"{s}" ({device.model})' for s, device in zip(serials, listed, strict=True)) or "none"
        wanted = self._settings.serial
        if wanted is None and len(serials) != 1:
            what = "there is no GenICam camera" if not serials else f"there are several GenICam cameras, {found}"
            remedy = "check cable, network and power" if not serials else "name one"
            raise DeviceError(f"devices.camera.serial is missing, and {what}: {remedy}")
        if wanted is not None and serials.count(wanted) != 1:
            raise DeviceError(f'devices.camera.serial = "{wanted}": no such GenICam camera; found: {found}')
        device = listed[0 if wanted is None else serials.index(wanted)]
        self._who = f"GenICam camera {device.model} {device.serial_number}"
        return {"serial_number": str(device.serial_number)}

    def _set_up(self) -> None:
        """Size and format of the rig file, and nothing automatic; what the camera does not take is an error."""
        camera, nodes = self._description, self._camera.remote_device.node_map
        for name, value in OFF.items():
            node = self._node(name, "RO", "RW")
            if node is not None and node.value != value:
                self._set(name, value)
        if self._has("AcquisitionMode"):
            single = "SingleFrame" in nodes.AcquisitionMode.symbolics
            self._set("AcquisitionMode", "SingleFrame" if single else "Continuous")
        formats = nodes.PixelFormat.symbolics if self._has("PixelFormat") else ()
        wanted = [self._settings.pixel_format] if self._settings.pixel_format else self._formats()
        chosen = next((name for name in wanted if name in formats), None)
        if chosen is None:
            raise DeviceError(
                f"the {self._who} has none of the formats {', '.join(wanted)} (camera.pattern, camera.bits); it has "
                f"{', '.join(formats) or 'none'}"
            )
        self._format = chosen
        row_bytes(chosen, camera.width)
        self._set("PixelFormat", chosen)
        for name, value in (("OffsetX", 0), ("OffsetY", 0), ("Width", camera.width), ("Height", camera.height)):
            if not name.startswith("Offset") or self._has(name):
                self._set(name, value)
        for names, asked in ((GAINS, self._settings.gain), (BLACKS, self._settings.black_level)):
            if asked is not None:
                feature = self._feature(*names)
                feature.value = type(feature.value)(asked)
                if abs(feature.value - asked) > READ_BACK * max(1.0, asked):
                    raise DeviceError(
                        f"the {self._who} does not take {names[0]} = {asked:g}: it says {feature.value:g}"
                    )
        self._feature(*EXPOSURES)

    def _formats(self) -> list[str]:
        """The pixel formats that have the rig file's pattern and bits, the simplest first (PFNC, and GigE Vision)."""
        name = f"{BASES[self._description.pattern]}{self._description.bits}"
        return [name] if self._description.bits in (8, 16) else [name, f"{name}p", f"{name}Packed"]

    def _has(self, name: str) -> bool:
        return bool(self._camera.remote_device.node_map.has_node(name))

    def _node(self, name: str, *modes: str) -> Any:
        """A feature of the camera, by the name of the standard; None where it lacks it, or not with this access."""
        node = getattr(self._camera.remote_device.node_map, name) if self._has(name) else None
        allowed = [getattr(self._genapi.EAccessMode, mode) for mode in modes]
        return node if node is not None and node.get_access_mode() in allowed else None

    def _set(self, name: str, value: Any) -> None:
        """Set a feature, and read it back."""

        node = getattr(self._camera.remote_device.node_map, name)
        try:
            if node.value != value:
                node.value = value
        except self._genapi.GenericException as error:
            raise DeviceError(f"the {self._who} does not take {name} = {value}: {error}") from None
        if node.value != value:
            raise DeviceError(f"the {self._who} does not take {name} = {value}: it stays at {node.value}")

    def _feature(self, *names: str) -> Any:
        """The first of these that the camera has, to be set."""
        for name in names:
            if (node := self._node(name, "RW")) is not None:
                return node
        raise DeviceError(f"the {self._who} has no feature {' or '.join(names)} that can be set")


@dataclass(frozen=True, slots=True)
class Exposure:
    """An exposure that has begun."""

    camera: GenICamCamera
    exposure_s: float
    begun: float
    end: float
    """When its frame is given up."""
    before: int | None
    """When the last exposure before it was over, as the camera says."""

    def over(self) -> Exposed | None:
        """Wait until the camera says that it is over; None where it does not in time.

        Buffers from before are thrown away meanwhile: afterwards the time at which one is looked at tells nothing.
        """
        camera, came = self.camera, True
        while clock.monotonic() < self.end:
            with camera.named_failures():
                if came or clock.monotonic() < self.begun + self.exposure_s:
                    came, frame = camera.early(self.exposure_s, self.begun)
                    if frame is not None:
                        return Arrived(frame)
                elif camera.ended() not in (None, self.before):
                    return self
                else:
                    clock.sleep(LOOK_S)
        return None

    def done(self) -> bool:
        """Nobody looks for the frame before it is asked for."""
        return False

    def result(self) -> Frame:
        """Wait for the frame."""
        with self.camera.named_failures():
            return self.camera.fresh(self.exposure_s, self.begun, self.end)


@contextlib.contextmanager
def _keeping_ctrl_c() -> Iterator[None]:
    """harvesters takes SIGINT for itself where a camera is made: the run would no longer be ended by it."""
    here = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGINT, before)


def row_bytes(name: str, width: int) -> int:
    """Bytes of a line of `width` pixels in a pixel format.

    Raises
    ------
    ConfigError
        The line would end within a byte.
    """
    bits = _bits(name)
    if name.endswith("Packed"):
        bits = 12  # two pixels in three bytes, whatever they have
    elif not name.endswith("p"):
        bits = 8 if bits == 8 else 16
    if width * bits % 8:
        raise ConfigError(f"camera.width = {width}: a line of {name} ends within a byte; take a multiple of 4 pixels")
    return width * bits // 8


def unpack(lines: NDArray[np.uint8], name: str, width: int) -> NDArray[np.uint16]:
    """Values of pixels from the bytes of lines, shape (height, bytes), in a pixel format: shape (height, width) [DN].

    "Mono12p" has its pixels' bits one after the other, lowest first (PFNC 2.0); "Mono12Packed" and "Mono10Packed" have
    the high bits of two pixels around a byte with their low bits (GigE Vision 1.2).
    """
    bits, height = _bits(name), lines.shape[0]
    if name.endswith("Packed"):
        low = bits - 8
        first, both, second = (lines[:, k::3].astype(np.uint16) for k in range(3))
        mask = (1 << low) - 1
        pairs = np.stack([first << low | both & mask, second << low | both >> 4 & mask], axis=-1)
        return pairs.reshape(height, width)
    if name.endswith("p"):
        ones = np.unpackbits(np.ascontiguousarray(lines), axis=1, bitorder="little").reshape(height, width, bits)
        return np.asarray((ones.astype(np.uint16) << np.arange(bits, dtype=np.uint16)).sum(axis=-1, dtype=np.uint16))
    if bits == 8:
        return lines.astype(np.uint16)
    return np.ascontiguousarray(lines).view("<u2").astype(np.uint16)


def _bits(name: str) -> int:
    return int("".join(c for c in name if c.isdigit()))


def genicam(description: RigDescription, table: TomlTable) -> GenICamCamera:
    """The entry point `genicam` of the group `gonio.cameras`."""
    return GenICamCamera(description, parse(GenicamSettings, table, "[devices.camera]"))
