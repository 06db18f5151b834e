"""A GenICam camera behind harvesters: a real GenApi node map, and a stream with the faults of real ones.

It stands in for `harvesters.core.Harvester`. Frames from before the stream was started wait in its queue, and frames
may come with parts missing, which harvesters throws away.
"""

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from gonio.lab.rig import clock
from gonio.typing import NDArray

FORMATS = {
    "Mono8": 0x01080001, "Mono10": 0x01100003, "Mono10p": 0x010A0046, "Mono10Packed": 0x010C0004, "Mono12": 0x01100005,
    "Mono12p": 0x010C0047, "Mono12Packed": 0x010C0006, "Mono14": 0x01100025, "Mono16": 0x01100007,
}  # fmt: skip
"""Pixel formats and their numbers (GenICam PFNC)."""
LOOK_S = 1e-3
NAMESPACE = "http://www.genicam.org/GenApi/Version_1_1"
ENDED = 0x9C43
"""Number of the event "ExposureEnd"."""
EVENTS = {"EventSelector": ("ExposureEnd",), "EventNotification": ("Off", "On"),
          "SensorShutterMode": ("Global", "Rolling")}  # fmt: skip
EVENT_NODES = (
    f'<Port Name="ExposureEndPort"><EventID>{ENDED:X}</EventID></Port><IntReg Name="EventExposureEndTimestamp">'
    "<Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode><pPort>ExposureEndPort</pPort>"
    "<Cachable>NoCache</Cachable><Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></IntReg>"
)
MODES = {"AcquisitionMode": ("Continuous", "SingleFrame"), "ExposureAuto": ("Continuous", "Off"),
         "GainAuto": ("Continuous", "Off"), "TriggerMode": ("On", "Off")}  # fmt: skip


def described(
    formats: tuple[str, ...], shortest_us: float = 10.0, without: tuple[str, ...] = (), *, tells: bool = False
) -> str:
    """The XML that a camera describes itself by; `without` leaves features out. Every value is at its worst.

    One that `tells` has the event of an exposure that is over.
    """
    enums = {"PixelFormat": {name: FORMATS[name] for name in formats}}
    choices = MODES | (EVENTS if tells else {})
    enums |= {name: {entry: k for k, entry in enumerate(entries)} for name, entries in choices.items()}
    nodes = {
        name: f'<Enumeration Name="{name}">'
        + "".join(f'<EnumEntry Name="{entry}"><Value>{k}</Value></EnumEntry>' for entry, k in entries.items())
        + f"<Value>{next(iter(entries.values()))}</Value></Enumeration>"
        for name, entries in enums.items()
    }
    for name in ("Width", "Height"):
        nodes[name] = f'<Integer Name="{name}"><Value>32</Value><Min>8</Min><Max>4096</Max><Inc>2</Inc></Integer>'
    for name, lowest, highest in (("ExposureTime", shortest_us, 1e7), ("Gain", 0, 24), ("BlackLevel", 0, 255)):
        nodes[name] = f'<Float Name="{name}"><Value>{lowest}</Value><Min>{lowest}</Min><Max>{highest}</Max></Float>'
    nodes["GammaEnable"] = (
        '<Boolean Name="GammaEnable"><Value>1</Value><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>'
    )
    kept = {name: node for name, node in nodes.items() if name not in without}
    features = "".join(f"<pFeature>{name}</pFeature>" for name in kept)
    versions = "".join(f'{name}Version="1" ' for name in ("SchemaMajor", "SchemaMinor", "SchemaSubMinor", "Major"))
    versions += 'MinorVersion="0" SubMinorVersion="0" '
    guids = "".join(
        f'{name}Guid="00000000-0000-0000-0000-00000000000{k}" ' for k, name in enumerate(("Product", "Version"))
    )
    return (
        '<RegisterDescription ModelName="Twin" VendorName="gonio" ToolTip="" StandardNameSpace="None" '
        f"{versions}{guids}"
        f'xmlns="{NAMESPACE}"><Category Name="Root">{features}</Category>{"".join(kept.values())}'
        f"{EVENT_NODES if tells else ''}</RegisterDescription>"
    )


def packed(image: NDArray[np.uint16], name: str, padding: int = 0) -> bytes:
    """An image as its bytes in a pixel format, each line followed by some that mean nothing."""
    lines = (_line([int(value) for value in line], name) for line in image)
    return b"".join(line + b"\xee" * padding for line in lines)


def _line(values: list[int], name: str) -> bytes:
    bits = int("".join(c for c in name if c.isdigit()))
    if name.endswith("Packed"):  # GigE Vision 1.2: the high bits of two pixels, and between them the low bits of both
        low, out = bits - 8, bytearray()
        for a, b in zip(values[::2], values[1::2], strict=True):
            out += bytes([a >> low, a % (1 << low) | b % (1 << low) << 4, b >> low])
        return bytes(out)
    if name.endswith("p"):  # PFNC: one number, its lowest bits first
        return sum(value << bits * k for k, value in enumerate(values)).to_bytes(len(values) * bits // 8, "little")
    return b"".join(value.to_bytes(1 if bits == 8 else 2, "little") for value in values)


@dataclass
class GenICamTwin:
    """A camera, and the library that finds it: an instance stands in for the class `Harvester`.

    Parameters
    ----------
    see
        The scene: what the sensor sees of it in an exposure [s], at the time of the call [DN].
    """

    see: Callable[[float], NDArray[np.uint16]]
    xml: str = field(default_factory=lambda: described(tuple(FORMATS)))
    serials: tuple[str, ...] = ("22180001",)
    padding: int = 0
    stale: int = 0
    """Frames that wait in the queue at every start."""
    incomplete: int = 0
    """Number of next frames that come with parts missing."""
    readout_s: float = 0.0
    """Of a camera that tells the end of its exposures: how long its frame takes after that [s]."""
    later: Callable[[float, Callable[[], None]], None] = lambda seconds, what: threading.Timer(seconds, what).start()
    """Does something after a time [s], where a camera tells."""
    mute: bool = False
    """It does not tell, although it could."""
    silent: bool = False
    runs: bool = False
    opened: str = ""

    def __post_init__(self) -> None:
        from genicam.genapi import NodeMap

        self.nodes = NodeMap()
        self.nodes.load_xml_from_string(self.xml)
        self.remote_device = SimpleNamespace(node_map=self.nodes)
        self._queue: list[NDArray[np.uint16]] = []
        self._waiting: list[NDArray[np.uint16]] = []
        self._adapter: Any = None
        """Brings events to the node map, where somebody listens."""
        self._exposing = False
        self._shot = np.zeros((0, 0), np.uint16)
        self._ready_s, self._told = 0.0, 0

    # ---- Harvester ----

    def __call__(self) -> "GenICamTwin":
        return self

    def add_file(self, path: str) -> None:
        """A producer."""

    def update(self) -> None:
        """Look for cameras."""

    @property
    def device_info_list(self) -> list[Any]:
        """The cameras that there are."""
        return [SimpleNamespace(serial_number=serial, model="Twin") for serial in self.serials]

    def create(self, wanted: dict[str, str], config: Any = None) -> "GenICamTwin":
        """Open one of them; with `config` its events are listened to."""
        from genicam.genapi import EventAdapterGeneric

        self.opened = wanted["serial_number"]
        self._adapter = EventAdapterGeneric(self.nodes.pointer) if config is not None else None
        return self

    def reset(self) -> None:
        """Forget the cameras."""

    # ---- ImageAcquirer ----

    def start(self) -> None:
        """Start the stream."""
        self.runs = True
        self._queue, self._waiting = self._waiting, []
        self._queue += [self.see(self.nodes.ExposureTime.value * 1e-6) for _ in range(self.stale)]
        if self._adapter is not None:
            exposure_s = self.nodes.ExposureTime.value * 1e-6
            self._ready_s = math.inf
            self._exposing = True
            self.later(exposure_s, lambda: self._over(exposure_s))

    def _over(self, exposure_s: float) -> None:
        """The exposure is over: what is seen later is on no frame."""
        self._shot = self.see(exposure_s)
        self._ready_s = clock.monotonic() + self.readout_s
        self._told += 1
        if not self.mute:
            self._adapter.deliver_message(self._told.to_bytes(8, "little"), ENDED)

    def fall_behind(self) -> None:
        """A frame of what is seen now comes first when the stream is started."""
        self._waiting = [self.see(self.nodes.ExposureTime.value * 1e-6)]

    def try_fetch(self, *, timeout: float, is_raw: bool) -> Any:
        """The next buffer, of the queue or of the sensor; None where there is none in time, or it is not whole."""
        assert self.runs
        assert is_raw
        if self.silent:
            clock.sleep(timeout)
            return None
        if self._queue:
            image = self._queue.pop(0)
        elif self._exposing:
            end = clock.monotonic() + timeout
            while clock.monotonic() < self._ready_s:
                if clock.monotonic() >= end:
                    return None
                clock.sleep(LOOK_S)
            image = self._shot
        else:
            exposure_s = self.nodes.ExposureTime.value * 1e-6
            clock.sleep(exposure_s)
            image = self.see(exposure_s)
        if self.incomplete:
            self.incomplete -= 1
            return None
        data = packed(image, self.nodes.PixelFormat.value, self.padding)
        return SimpleNamespace(
            raw_buffer=data, image_offset=0, padding_x=self.padding, height=image.shape[0], width=image.shape[1],
            parent=SimpleNamespace(queue_buffer=lambda buffer: None),
        )  # fmt: skip

    def stop(self) -> None:
        """Stop the stream."""
        self.runs = self._exposing = False

    def destroy(self) -> None:
        """Close the camera."""
        self.opened, self._adapter = "", None
