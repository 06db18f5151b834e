"""The cameras that the contracts are tried on by themselves, without a rig around them."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from gonio_drivers.cameras import build
from gonio_sim.wire.uvc import VideoStandIn

from gonio.lab.rig import CameraDevice, LightDevice, clock
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Camera
from tests.gonio_drivers.ticking import ticking

NAMES = ("sequence", "uvc", "genicam", "genicam-event")
DESCRIPTION = RigDescription(
    rig="lab",
    name="bench",
    bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
    camera=Camera(width=64, height=48, pattern="mono", bits=12, exposure_limits_s=(1e-3, 0.02)),
)
SIZE = (DESCRIPTION.camera.height, DESCRIPTION.camera.width)
DARK, LIT = 20, 200
"""Of 8 bits."""
FRAMES = 20
"""More than the tests of a camera take."""


@dataclass(frozen=True)
class Eye:
    """A camera that is open, and what it stands in."""

    camera: CameraDevice
    description: RigDescription
    time_s: Callable[[], float]
    """The clock that its frames' times are of."""
    lamp: Callable[[bool], None] | None
    """Switches what it sees on and off; None where it sees nothing."""

    @property
    def exposure_s(self) -> float:
        return short_s(self.description)


def short_s(description: RigDescription) -> float:
    """A short exposure that is inside the limits."""
    low, high = description.camera.exposure_limits_s
    return min(max(low, 0.05), high)


def switch(light: LightDevice) -> Callable[[bool], None]:
    """The lamp of a rig."""
    return lambda on: light.on() if on else light.off()


def opened(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Eye]:
    """A camera of the laboratory, without a laboratory."""
    kinds = {"sequence": sequence, "uvc": uvc, "genicam": genicam, "genicam-event": genicam_event}
    yield from kinds[name](folder, monkeypatch)


def sequence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Eye]:
    """Images that show what the lamp does from now on."""

    def lamp(on: bool) -> None:
        for k in range(FRAMES):
            cv2.imwrite(str(folder / f"{k:02d}.png"), np.full(SIZE, 16 * (LIT if on else DARK), np.uint16))

    lamp(False)
    with build(DESCRIPTION, {"driver": "sequence", "folder": str(folder)}) as camera:
        yield Eye(camera, DESCRIPTION, time.monotonic, lamp)


def uvc(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Eye]:
    """The twin of a video camera: dark frames from before wait in its queue whenever the lamp has been switched."""
    lit = False
    twin = VideoStandIn(lambda exposure_s: np.full(SIZE, LIT if lit else DARK, np.uint8))

    def lamp(on: bool) -> None:
        nonlocal lit
        lit = on
        twin.fall_behind()

    response = folder / "response.csv"
    response.write_text("dn,relative_exposure\n0,0\n255,1\n")
    monkeypatch.setattr(cv2, "VideoCapture", twin)
    with build(DESCRIPTION, {"driver": "uvc", "response": str(response)}) as camera:
        yield Eye(camera, DESCRIPTION, time.monotonic, lamp)


def genicam_event(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Eye]:
    """The same, which says when an exposure is over."""
    yield from genicam(folder, monkeypatch, tells=True)


def genicam(folder: Path, monkeypatch: pytest.MonkeyPatch, *, tells: bool = False) -> Iterator[Eye]:
    """The twin of a GenICam camera behind harvesters: a frame from before waits whenever the lamp is switched."""
    core = pytest.importorskip("harvesters.core", reason="harvesters is not installed (the extra genicam)")
    from tests.gonio_drivers.genicam_twin import FORMATS, GenICamTwin, described

    lit = False
    seen, later = described(tuple(FORMATS), tells=tells), ticking(monkeypatch)
    twin = GenICamTwin(
        lambda exposure_s: np.full(SIZE, 16 * (LIT if lit else DARK), np.uint16), seen, readout_s=0.02, later=later
    )
    producer = folder / "maker.cti"
    producer.touch()

    def lamp(on: bool) -> None:
        nonlocal lit
        twin.fall_behind()
        lit = on

    monkeypatch.setattr(core, "Harvester", twin)
    with build(DESCRIPTION, {"driver": "genicam", "producer": str(producer)}) as camera:
        yield Eye(camera, DESCRIPTION, clock.monotonic, lamp)
