"""What a live picture shows of a rig: what is in each frame, beside where the rig file has things from this pose.

All of it as numbers that JSON can hold, for a page; and the pictures: the whole frame made smaller, and its middle
pixel by pixel. Devices are not asked here.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass

import cv2
import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import ANGLES
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand import frame_analysis
from gonio.lab.rig import Frame, Pose, Target, imaging, kinematics, regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band, Camera
from gonio.typing import Array, Bools, Floats, JsonObject, NDArray

HISTORY = 240
HISTORY_S = 0.25
"""Points of the curve of the focus over time, at most, and the time between two of them."""
FPS_OF = 20
"""Frames from which their rate is determined."""
STEADY_DEG = 0.1
"""An axis whose reading differs by more than this has moved; the curve of the focus then begins anew."""
WIDEST = 960
"""Columns of the picture, at most."""
ZOOM_PX = 96
"""Pixels of the frame along each side of the enlarged part, at most."""
JPEG_QUALITY = 85
FAINTEST = 0.02
"""Part of full scale: a picture that is darker throughout is not brightened further, to noise that looks lit."""
SRGB_GAMMA = 1.0 / 2.2
"""Screens undo it: what is shown is proportional to the light."""
SPECK_PX = 3
"""Width of a single saturated pixel in the picture."""
SATURATED_BGR = (40, 40, 235)


class Sight:
    """Frames, one after the other.

    Parameters
    ----------
    description
        The rig.
    clock
        Seconds, growing.
    """

    def __init__(self, description: RigDescription, clock: Callable[[], float]) -> None:
        self.region: regions.Roi | None = None
        """What a measurement of sample or reference would use from this pose; None where there is none."""
        self._description, self._clock = description, clock
        self._pose: Pose | None = None
        self._band: Band | None = None
        self._target: Target = "sample"
        self._view: kinematics.View | None = None
        self._predicted: JsonObject = {}
        self._last: Frame | None = None
        self._number = 0
        self._times: deque[float] = deque(maxlen=FPS_OF)
        self._history: deque[tuple[float, float | None]] = deque(maxlen=HISTORY)
        self._best: float | None = None

    def stand(self, pose: Pose | None, band: Band, target: Target) -> None:
        """Where the axes stand (None: not known), the band that is seen, and what lies in the beam; from now on."""
        if self._predicted and (pose, band, target) == (self._pose, self._band, self._target):
            return
        before, was = self._pose, self._target
        self._pose, self._band, self._target = pose, band, target
        if pose is None or before is None or target != was or _apart_deg(before, pose) > STEADY_DEG:
            self.forget_focus()
        if pose != before or self._view is None:
            self._view = None if pose is None else kinematics.view(self._description, pose)
        self._predict()

    def changed(self) -> None:
        """Light or exposure are others now: the next frame is not compared with the one before."""
        self._last = None

    def forget_focus(self) -> None:
        """Another scene: the best focus, and its history, count no more."""
        self._best, self._last = None, None
        self._history.clear()

    @property
    def middle(self) -> tuple[float, float]:
        """Column and row of the sample's centre, or of the optical axis where that is not known."""
        column, row = self._predicted["centre"] or self._predicted["axis"]
        return column, row

    # ---- by the rig file ----

    def _predict(self) -> None:
        """Axis, centre, region and outlines in the frame."""
        description, view = self._description, self._view
        camera, self.region = description.camera, None
        right, down = camera.principal_point_px
        out = self._predicted = {
            "axis": [0.5 * (camera.width - 1) + right, 0.5 * (camera.height - 1) + down], "centre": None,
            "sample": None, "reference": None, "beam": None, "target": self._target, "region_pixels": None, "why": "",
        }  # fmt: skip
        if view is None or self._band is None:
            out["why"] = "the arms do not say where they stand"
            return
        try:
            self.region = regions.roi(description, view, self._target, self._band.channel)
            out["centre"] = list(imaging.place(description, view, self._target))
        except ConfigError as error:
            out["why"] = str(error)
            return
        out["region_pixels"] = self.region.count
        out["sample"] = _places(*regions.outline(description, view))
        if description.reference.how == "beside":
            out["reference"] = _places(*regions.outline(description, view, "reference"))
        out["beam"] = _beam(description, view)

    def _angles(self) -> JsonObject:
        description, pose = self._description, self._pose
        if pose is None:
            return {"angles_deg": None, "directions_deg": None}
        seen = kinematics.directions(description, pose)
        return {
            "angles_deg": {name: math.degrees(getattr(pose, name)) for name in description.axes()},
            "directions_deg": {name: math.degrees(float(getattr(seen, name))) for name in ANGLES},
        }

    # ---- in the frame ----

    def told(self, frame: Frame) -> JsonObject:
        """What there is to show of a frame; `stand` was called before."""
        description, region, last = self._description, self.region, self._last
        camera = description.camera
        self._number += 1
        self._times.append(self._clock())
        span = self._times[-1] - self._times[0]
        noise = frame_analysis.noise(camera, last, frame, region) if last is not None and region is not None else None
        spot, said = frame_analysis.spot(camera, frame)
        pixels = None if region is None else region.of(frame.mosaic)
        over = None if pixels is None else int(np.count_nonzero(frame_analysis.saturated(camera, frame, pixels)))
        full = exposure.full_scale_dn(camera, frame)
        out = {
            "n": self._number, "rig": description.name, "width": camera.width, "height": camera.height,
            "exposure_s": frame.exposure_s, "fps": (len(self._times) - 1) / span if span > 0 else None,
            "predicted": self._predicted, **self._angles(),
            "levels": [asdict(one) for one in frame_analysis.levels(camera, frame)],
            "black_dn": frame.black_level_dn, "white_dn": frame.white_level_dn,
            "saturated_dn": frame.black_level_dn + exposure.SATURATED * full, "saturated_in_region": over,
            "advice": asdict(frame_analysis.advice(description, frame, region)), "noise": noise and asdict(noise),
            "focus": self._focus(frame), "spot": spot and self._placed(spot), "spot_said": said,
        }  # fmt: skip
        self._last = frame
        return out

    def _focus(self, frame: Frame) -> JsonObject:
        camera, now = self._description.camera, self._clock()
        rows, cols = box = frame_analysis.focus_box(camera, self.region)
        found = frame_analysis.focus(camera, self._last, frame, box) if self._last is not None else None
        if found is not None and found.value is not None:
            self._best = max(found.value, self._best or 0.0)
        if found is not None and (not self._history or now - self._history[-1][0] >= HISTORY_S):
            self._history.append((now, found.value))
        return {
            "value": found and found.value, "u": found and _finite(found.u), "best": self._best,
            "why": "waiting for two frames of one scene" if found is None else found.why,
            "box": [cols.start - 0.5, rows.start - 0.5, cols.stop - cols.start, rows.stop - rows.start],
            "history": [[round(t - now, 2), value] for t, value in self._history],
        }  # fmt: skip

    def _placed(self, spot: frame_analysis.Spot) -> JsonObject:
        """A spot with its offset from the sample's centre, and its size on the sample, where the pose is known."""
        out = asdict(spot) | {"from_centre_px": None, "from_centre_mm": None, "axes_mm": None}
        centre, view = self._predicted["centre"], self._view
        if centre is None or view is None:
            return out

        def on_sample(column: float, row: float) -> Floats:
            return imaging.spot(self._description, view, column, row)

        out["from_centre_px"] = [spot.column - centre[0], spot.row - centre[1]]
        out["from_centre_mm"] = [_finite(float(x)) for x in on_sample(spot.column, spot.row)]
        c, r = math.cos(math.radians(spot.angle_deg)), math.sin(math.radians(spot.angle_deg))
        lengths = []
        for half, (right, down) in ((0.5 * spot.major_px, (c, r)), (0.5 * spot.minor_px, (-r, c))):
            ends = [on_sample(spot.column + k * half * right, spot.row + k * half * down) for k in (-1, 1)]
            lengths.append(_finite(float(np.linalg.norm(ends[1] - ends[0]))))
        out["axes_mm"] = lengths
        return out


def _apart_deg(one: Pose, other: Pose) -> float:
    return max(abs(math.degrees(getattr(one, name) - getattr(other, name))) for name in kinematics.AXES)


def _places(columns: Floats, rows: Floats) -> list[list[float]] | None:
    """Corners for JSON; None where one of them is not in front of the camera."""
    if not (np.isfinite(columns).all() and np.isfinite(rows).all()):
        return None
    return [[round(float(c), 2), round(float(r), 2)] for c, r in zip(columns, rows, strict=True)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _beam(description: RigDescription, view: kinematics.View) -> list[list[float]] | None:
    """The edge of the lamp's beam on the sample's plane, by the rig file; None for a beam without one."""
    diameter, source = description.lamp.beam_diameter_mm, np.asarray(view.source_mm, dtype=float)
    if diameter is None or source[2] <= 0:
        return None
    toward = source / np.linalg.norm(source)
    first = np.cross(toward, np.eye(3)[np.argmin(np.abs(toward))])
    first /= np.linalg.norm(first)
    turn = np.linspace(0.0, 2 * np.pi, 65)[:, None]
    circle = 0.5 * diameter * (np.cos(turn) * first + np.sin(turn) * np.cross(toward, first))
    down = source[2] - circle[:, 2:]
    if (down <= 0).any():
        return None
    return _places(*imaging.project(description, view, source + (circle - source) * source[2] / down))


@dataclass(frozen=True, slots=True)
class FramePictures:
    """Pictures of one frame; grey, with saturated pixels red."""

    whole: bytes
    """JPEG, in the proportions of the frame."""
    zoom: bytes
    """PNG, one pixel of it for a pixel of the frame."""
    zoom_box: tuple[int, int, int, int]
    """Its first column and row, and its columns and rows, in the frame."""
    white_dn: float
    """The signal above the black level that is shown white [DN]."""


def pictures(camera: Camera, frame: Frame, middle: tuple[float, float]) -> FramePictures:
    """Both pictures; `middle`: column and row around which the frame is enlarged."""
    height, width = frame.mosaic.shape
    shrink = min(1.0, WIDEST / width)
    size = max(round(width * shrink), 1), max(round(height * shrink), 1)
    if shrink <= 0.5 and not camera.response:  # cells of a mosaic are averaged by that
        small = cv2.resize(frame.mosaic, size, interpolation=cv2.INTER_AREA).astype(np.float32) - frame.black_level_dn
    else:
        cells = frame_analysis.cells(frame.pattern, frame_analysis.signal(camera, frame))
        small = cv2.resize(cells, size, interpolation=cv2.INTER_AREA)
    over = frame_analysis.saturated(camera, frame).view(np.uint8)
    red = np.zeros(small.shape, dtype=bool)
    if over.any():
        reach = np.ones((math.ceil(SPECK_PX / shrink),) * 2, np.uint8)
        red = cv2.resize(cv2.dilate(over, reach), size, interpolation=cv2.INTER_NEAREST) > 0
    full = exposure.full_scale_dn(camera, frame)
    brightest = cv2.medianBlur(np.ascontiguousarray(small, np.float32), 3).max()  # single hot pixels aside
    white = max(float(brightest), FAINTEST * full)
    rows, cols = _part(middle[1], height), _part(middle[0], width)
    zoomed = _shown(frame_analysis.signal(camera, frame, frame.mosaic[rows, cols]), over[rows, cols] > 0, white)
    colours = cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444  # of every pixel
    return FramePictures(
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
    good, data = cv2.imencode(suffix, image, options)
    assert good, "OpenCV writes JPEG and PNG wherever it is built"
    return data.tobytes()
