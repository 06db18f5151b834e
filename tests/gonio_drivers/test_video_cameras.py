"""Video cameras and sequences of pictures; files that are no frame."""

import itertools
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from gonio_drivers import cameras, settings
from gonio_drivers.uvc import UvcCamera
from gonio_sim.wire.uvc import VideoStandIn

from gonio.errors import ConfigError, DataError, DeviceError
from gonio.lab.rig import Frame
from gonio.lab.rig.dng import write_dng
from gonio.lab.rig.regions import require_frame
from tests.gonio_drivers.test_cameras import DESCRIPTION, PLAIN, SIZE, number


@pytest.fixture
def response(tmp_path: Path) -> str:
    path = tmp_path / "response.csv"
    levels = np.arange(0, 256, 15)
    rows = "\n".join(f"{dn},{(dn / 255) ** 2.2:.9f}" for dn in levels)
    path.write_text("dn,relative_exposure\n" + rows + "\n")
    return str(path)


def video(stand_in: VideoStandIn, response: str | None, **changes: object) -> UvcCamera:
    table = {"device": "/dev/video0", "response": response} | changes
    return UvcCamera(DESCRIPTION, settings.UvcCameraSettings.model_validate(table), stand_in)


def images(exposure_s: float) -> np.ndarray:
    return np.full(SIZE, min(255, round(25_500 * exposure_s)), np.uint8)


def test_a_video_camera_without_response_refuses() -> None:
    with pytest.raises(ConfigError, match=r"devices\.camera\.response is missing"):
        video(VideoStandIn(images), None)


def test_directshow_counts_exposures_in_octaves(response: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2.videoio_registry, "getCameraBackends", lambda: (cv2.CAP_MSMF, cv2.CAP_DSHOW))
    stand_in = VideoStandIn(lambda exposure_s: images(2.0 ** (exposure_s / 1e-4)))  # it counts as V4L2 does
    with video(stand_in, response) as camera:
        assert stand_in.opened_with == ("/dev/video0", cv2.CAP_DSHOW)
        assert stand_in.get(cv2.CAP_PROP_AUTO_EXPOSURE) == 0
        monkeypatch.setattr(stand_in, "_exposure_s", lambda: stand_in.get(cv2.CAP_PROP_EXPOSURE) * 1e-4)
        monkeypatch.setattr("gonio_sim.wire.uvc.clock", SimpleNamespace(monotonic=time.monotonic, sleep=lambda s: None))
        assert camera.capture(0.006).exposure_s == 2.0**-7  # 0.0078 s is the nearest
        assert stand_in.get(cv2.CAP_PROP_EXPOSURE) == -7
    monkeypatch.setattr(cv2.videoio_registry, "getCameraBackends", lambda: (cv2.CAP_GSTREAMER,))
    with pytest.raises(DeviceError, match=r"take no exposure time \(GSTREAMER\)"), video(stand_in, response):
        pass


def test_a_video_frame_is_fresh_manual_and_linear(response: str) -> None:
    stand_in = VideoStandIn(images)
    with video(stand_in, response) as camera:
        frame = camera.capture(0.006)
        assert stand_in.opened_with == ("/dev/video0", cv2.CAP_V4L2)
        assert (stand_in.get(cv2.CAP_PROP_AUTO_EXPOSURE), stand_in.get(cv2.CAP_PROP_EXPOSURE)) == (1, 60)
        assert stand_in.get(cv2.CAP_PROP_CONVERT_RGB) == 0
    # the calibration is interpolated between points 15 DN apart: second derivative times 15^2 / 8 is 0.32 %
    assert frame.mosaic[0, 0] == pytest.approx(65_535 * (round(25_500 * 0.006) / 255) ** 2.2, rel=4e-3)
    assert frame.exposure_s == pytest.approx(0.006, rel=1e-12)  # 60 steps of 0.1 ms


def test_a_video_camera_with_a_calibrated_curve_gives_its_own_values(response: str) -> None:
    curve = tuple(255.0 * (np.arange(256) / 255.0) ** 2.2)
    known = DESCRIPTION.camera.model_copy(update={"bits": 8, "black_level_dn": 2.0, "response": curve})
    rig = DESCRIPTION.model_copy(update={"camera": known})
    with UvcCamera(rig, settings.UvcCameraSettings(device="/dev/video0"), VideoStandIn(images)) as camera:
        frame = camera.capture(0.006)
    assert (frame.mosaic[0, 0], frame.black_level_dn, frame.white_level_dn) == (round(25_500 * 0.006), 2.0, 255.0)
    with pytest.raises(ConfigError, match="both make the frames linear"):
        UvcCamera(rig, settings.UvcCameraSettings(device="/dev/video0", response=response))


def test_time_stamps_of_another_clock_make_no_queued_frame_fresh(
    response: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = itertools.count(step=5e-4)  # the four queued frames are read within the exposure
    monkeypatch.setattr("gonio_drivers.uvc.clock", SimpleNamespace(monotonic=lambda: next(clock)))
    stand_in = VideoStandIn(images)  # it stamps its frames with the computer's clock, which is ahead of this one
    with video(stand_in, response, drop=0) as camera:
        assert camera.capture(0.006).mosaic[0, 0] > 0  # those in the queue are black


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (np.zeros((SIZE[0], 10), np.uint8), "gives 10 x 48 pixels; the rig file says 64 x 48"),
        (np.zeros(SIZE, np.uint16), "gives uint16 instead of uint8: its format has changed"),
        (np.zeros(700, np.uint8), "gives 700 x 1 pixels.*a compressed format"),
        (np.zeros((0, 0), np.uint8), "gives 0 x 0 pixels"),
    ],
)
def test_a_video_camera_that_changes_its_frames_in_a_run_is_an_error(
    response: str, changed: np.ndarray, message: str
) -> None:
    kind = [images(0.006)]
    with video(VideoStandIn(lambda exposure_s: kind[0]), response) as camera:
        camera.capture(0.006)
        kind[0] = changed
        with pytest.raises(DeviceError, match=message):
            camera.capture(0.006)


def test_the_luminance_of_a_frame_that_is_not_converted_is_used(response: str) -> None:
    yuyv = VideoStandIn(lambda exposure_s: np.dstack([images(exposure_s), np.full(SIZE, 128, np.uint8)]))
    with video(yuyv, response) as camera, video(VideoStandIn(images), response) as grey:
        assert (camera.capture(0.006).mosaic == grey.capture(0.006).mosaic).all()


@pytest.mark.parametrize(
    ("stubborn", "what"),
    [(cv2.CAP_PROP_EXPOSURE, "exposure = 60"), (cv2.CAP_PROP_AUTO_EXPOSURE, "automatic exposure"),
     (cv2.CAP_PROP_AUTO_WB, "automatic white balance"), (cv2.CAP_PROP_AUTOFOCUS, "automatic focus"),
     (cv2.CAP_PROP_GAIN, "gain")],
)  # fmt: skip
def test_settings_that_are_ignored_are_noticed(response: str, stubborn: int, what: str) -> None:
    def use() -> None:
        with video(VideoStandIn(images, stubborn=[stubborn]), response, gain=2.0) as camera:
            camera.capture(0.006)

    with pytest.raises(DeviceError, match=f"does not take {what}"):
        use()


class Lacking(VideoStandIn):
    """A camera without some properties: OpenCV's `set` is False, and its `get` is -1."""

    def __init__(self, *lacking: int) -> None:
        super().__init__(images)
        self._lacking = lacking

    def set(self, prop: int, value: float) -> bool:
        return prop not in self._lacking and super().set(prop, value)

    def get(self, prop: int) -> float:
        return -1.0 if prop in self._lacking else super().get(prop)


AUTOMATIC = [cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_AUTO_EXPOSURE]


@pytest.mark.parametrize("backend", [cv2.CAP_V4L2, cv2.CAP_DSHOW])
@pytest.mark.parametrize("lacking", [*([one] for one in AUTOMATIC), AUTOMATIC])
def test_what_a_video_camera_lacks_is_off(
    response: str, monkeypatch: pytest.MonkeyPatch, lacking: list[int], backend: int
) -> None:
    """Kind: what is to be switched off, and is not there, is off: a grey camera has no white balance."""
    monkeypatch.setattr(cv2.videoio_registry, "getCameraBackends", lambda: (backend,))
    stand_in = Lacking(*lacking)
    with video(stand_in, response):
        there = [stand_in.get(prop) for prop in (cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_AUTOFOCUS)]
        assert set(there) <= {0.0, -1.0}


@pytest.mark.parametrize(
    ("lacking", "what"),
    [(cv2.CAP_PROP_EXPOSURE, "exposure = 60"), (cv2.CAP_PROP_GAIN, "gain"), (cv2.CAP_PROP_FRAME_WIDTH, "width")],
)
def test_what_a_video_camera_lacks_and_is_needed_is_an_error(response: str, lacking: int, what: str) -> None:
    def use() -> None:
        with video(Lacking(lacking), response, gain=2.0) as camera:
            camera.capture(0.006)

    with pytest.raises(DeviceError, match=f"does not take {what}"):
        use()


def test_no_video_camera(response: str) -> None:
    with pytest.raises(DeviceError, match="no video camera opens there"):
        video(VideoStandIn(images, present=False), response).__enter__()


def test_a_bad_response(tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("dn,relative_exposure\n0,0\n10,5\n20,5\n")
    with pytest.raises(ConfigError, match="must both grow"):
        video(VideoStandIn(images), str(path))
    with pytest.raises(ConfigError, match="there is no such file"):
        video(VideoStandIn(images), str(tmp_path / "none.csv"))


# ---- sequence ----


DEEP = DESCRIPTION.model_copy(update={"camera": DESCRIPTION.camera.model_copy(update={"bits": 16})})


def test_a_sequence_keeps_16_bits_and_ends(tmp_path: Path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.full(SIZE, 40_000 + k, np.uint16))
    with cameras.build(DEEP, {"driver": "sequence", "folder": str(tmp_path)}) as camera:
        assert [number(camera.capture(0.01)) for _ in range(2)] == [40_000, 40_001]
        with pytest.raises(DeviceError, match="has ended"):
            camera.capture(0.01)


def test_an_empty_sequence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="holds no frames"):
        cameras.build(DESCRIPTION, {"driver": "sequence", "folder": str(tmp_path)}).__enter__()


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (b"no image", "no image that OpenCV reads"),
        (np.full(SIZE, 200, np.uint8), r"a\.png: the image has 8 bits; the rig file says camera\.bits = 12"),
        (
            np.full(SIZE, 5000, np.uint16),
            r"a\.png: a pixel holds 5000 DN, above the highest value, 4095;.*camera\.bits",
        ),
        (np.full((*SIZE, 3), 200, np.uint16), r"a\.png: has shape \(48, 64, 3\).*a linear frame is grey"),
        (np.full(SIZE[::-1], 200, np.uint16), r"a\.png: the frame has 48 x 64 pixels; the rig file says"),
        (replace(PLAIN, exposure_s=0.02), r"was exposed 0\.02 s, and 0\.01 s were asked"),
        (replace(PLAIN, pattern="GBRG"), r'a\.dng: the frame has the colour pattern "GBRG"; the rig file says'),
    ],
)
def test_a_file_of_another_kind_is_no_frame(tmp_path: Path, file: bytes | np.ndarray | Frame, message: str) -> None:
    if isinstance(file, Frame):
        write_dng(file, tmp_path / "a.dng")
    elif isinstance(file, bytes):
        (tmp_path / "a.png").write_bytes(file)
    else:
        cv2.imwrite(str(tmp_path / "a.png"), file)
    camera = cameras.build(DESCRIPTION, {"driver": "sequence", "folder": str(tmp_path)})
    with camera, pytest.raises((DeviceError, DataError), match=message):
        camera.capture(0.01)


@pytest.mark.parametrize(
    "mosaic",
    [
        np.zeros((0, 0), np.uint16), np.zeros(SIZE[0] * SIZE[1], np.uint16), np.zeros((*SIZE, 3), np.uint16),
        np.zeros((SIZE[0], 8), np.uint16), np.zeros(SIZE, np.float32),
    ],
)  # fmt: skip
def test_no_camera_gets_a_frame_of_another_kind_into_a_run(mosaic: np.ndarray) -> None:
    frame = replace(PLAIN, mosaic=mosaic)
    with pytest.raises(DeviceError, match=r"mine: (the frame has|the frame holds float32)"):
        require_frame(DESCRIPTION.camera, frame, "mine")
