"""The cameras' twins alone: bytes of pixel formats as their standards have them, and queues of old frames."""

from types import SimpleNamespace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from gonio_sim.wire import uvc
from gonio_sim.wire.peer import Clock
from gonio_sim.wire.uvc import VideoStandIn

from tests.gonio_drivers import genicam_twin
from tests.gonio_drivers.genicam_twin import FORMATS, NAMESPACE, described, packed

A, B = 0xABC, 0x123


@pytest.mark.parametrize(
    ("name", "values", "data"),
    [
        ("Mono8", (0xAB, 0x12), "ab 12"),
        ("Mono16", (0xABCD, 0x0012), "cd ab 12 00"),
        ("Mono12", (A, B), "bc 0a 23 01"),
        ("Mono12p", (A, B), "bc 3a 12"),  # PFNC: lowest bits first, without gaps
        ("Mono12Packed", (A, B), "ab 3c 12"),  # GigE Vision: both low halves in the middle
        ("Mono10p", (0x3FF, 0, 0x3FF, 0), "ff 03 f0 3f 00"),
        ("Mono10Packed", (0x2AB, 0x123), "aa 33 48"),
    ],
)
def test_pixels_are_packed_as_the_standards_say(name: str, values: tuple[int, ...], data: str) -> None:
    image = np.array([values, values], dtype=np.uint16)
    line = bytes.fromhex(data)
    assert packed(image, name) == line * 2
    assert packed(image, name, padding=3) == (line + b"\xee" * 3) * 2


def test_numbers_of_formats_hold_their_bits() -> None:
    """PFNC: the second byte is how many bits a pixel takes, those that are unused included."""
    assert {name: FORMATS[name] >> 16 & 0xFF for name in FORMATS} == {
        "Mono8": 8, "Mono10": 16, "Mono10p": 10, "Mono10Packed": 12, "Mono12": 16, "Mono12p": 12, "Mono12Packed": 12,
        "Mono14": 16, "Mono16": 16,
    }  # fmt: skip


def test_a_description_holds_its_features_at_their_worst() -> None:
    root = ElementTree.fromstring(described(("Mono12", "Mono8"), 25.0, without=("Gain",)))
    space = {"g": NAMESPACE}
    names = [node.text for node in root.iterfind(".//g:pFeature", space)]
    assert "Gain" not in names
    assert {"PixelFormat", "ExposureAuto", "Width", "ExposureTime", "GammaEnable"} <= set(names)
    exposure = root.find(".//g:Float[@Name='ExposureTime']", space)
    assert exposure is not None
    assert [exposure.findtext(f"g:{key}", None, space) for key in ("Value", "Min", "Max")] == [
        "25.0", "25.0", "10000000.0",
    ]  # fmt: skip
    entries = root.findall(".//g:Enumeration[@Name='PixelFormat']/g:EnumEntry", space)
    assert [(e.get("Name"), e.findtext("g:Value", None, space)) for e in entries] == [
        ("Mono12", str(0x01100005)), ("Mono8", str(0x01080001)),
    ]  # fmt: skip


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that goes on when somebody sleeps; for how long each time [s]."""
    out: list[float] = []
    fake = SimpleNamespace(sleep=out.append, monotonic=lambda: 100.0 + sum(out))
    monkeypatch.setattr(uvc, "clock", fake)
    monkeypatch.setattr(genicam_twin, "clock", fake)
    return out


def test_a_video_camera_hands_out_old_dark_frames_first(slept: list[float]) -> None:
    """Four, 0.1 s apart, the last one 0.1 s before it was opened; then one in each exposure, in units of 0.1 ms."""
    camera = VideoStandIn(lambda exposure_s: np.full((4, 6), round(1e4 * exposure_s), np.uint16))
    assert (camera.get(cv2.CAP_PROP_FRAME_HEIGHT), camera.get(cv2.CAP_PROP_FRAME_WIDTH)) == (4.0, 6.0)
    camera.set(cv2.CAP_PROP_EXPOSURE, 250.0)
    for k in range(4):
        good, image = camera.read()
        assert good
        assert image is not None
        assert not image.any()
        assert camera.get(cv2.CAP_PROP_POS_MSEC) == pytest.approx(1e3 * (100.0 - 0.4 + 0.1 * k))
    assert slept == []
    _, image = camera.read()
    assert image is not None
    assert image.max() == 250
    assert slept == [pytest.approx(0.025)]
    assert camera.get(cv2.CAP_PROP_POS_MSEC) == pytest.approx(1e3 * 100.025)


def test_a_stubborn_property_stays_what_it_is(slept: list[float]) -> None:
    camera = VideoStandIn([np.zeros((4, 6))], stubborn=[cv2.CAP_PROP_AUTO_WB])
    assert camera.set(cv2.CAP_PROP_AUTO_WB, 0.0), "it claims success"
    assert camera.get(cv2.CAP_PROP_AUTO_WB) == 1.0
    camera.set(cv2.CAP_PROP_GAIN, 3.0)
    assert camera.get(cv2.CAP_PROP_GAIN) == 3.0
    camera.release()
    assert camera.read() == (False, None)


def test_clocks_of_twins_run_faster() -> None:
    clock = Clock(scale=8.0, start_s=100.0)
    assert (clock.at(100.0), clock.at(102.5)) == (0.0, 20.0)
