"""Rays of a camera: a pinhole, a thin lens, or the camera of a described rig at a pose; and the sensor behind it."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import NonNegative, Positive, Strict
from gonio.errors import ConfigError
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.light_and_camera import Camera as SensorModel
from gonio.lab.rig.protocols import Frame, Pose
from gonio.typing import Floats, NDArray
from gonio_scenes.shapes.shape import LARGEST_MM, Length, Point
from gonio_scenes.world import toward_plane

MAX_PIXELS = 1 << 26


class PoseTable(Strict):
    """Angles of a rig's axes."""

    light_deg: float = 0.0
    camera_deg: float = 0.0
    tilt_deg: float = 0.0
    spin_deg: float = 0.0
    azimuth_deg: float = 0.0

    def pose(self) -> Pose:
        """The same in radians."""
        return Pose(*(math.radians(getattr(self, f"{n}_deg")) for n in ("light", "camera", "tilt", "spin", "azimuth")))


class CameraTable(Strict):
    """The table [camera] of a scene file: a pinhole, a thin lens (`lens_radius_mm`), or `rig` and `pose`."""

    position_mm: Point | None = None
    look_at_mm: Point = (0.0, 0.0, 0.0)
    up: Point = (0.0, 1.0, 0.0)
    vertical_field_deg: Annotated[float, Field(gt=0, lt=180)] | None = None
    width: Annotated[int, Field(ge=1, le=16384)] | None = None
    height: Annotated[int, Field(ge=1, le=16384)] | None = None
    samples: Annotated[int, Field(ge=1, le=65536)] = 1
    """Rays through a pixel: one goes through its centre, several are spread over it."""
    lens_radius_mm: Annotated[float, Field(ge=0.0, le=LARGEST_MM)] = 0.0
    focus_mm: Length | None = None
    """Distance of the plane in focus from the lens, along the axis; that of `look_at_mm` if it is not given."""
    rig: str | None = None
    """A rig's name or file: its camera looks at the origin of the scene, which is the centre of its sample."""
    pose: PoseTable | None = None

    @model_validator(mode="after")
    def _sound(self) -> "CameraTable":
        if self.rig is not None:
            odd = [n for n in ("position_mm", "vertical_field_deg", "focus_mm") if getattr(self, n) is not None]
            if odd:
                raise ValueError(f"{odd[0]} and rig exclude each other: the rig file says where its camera is")
            if self.pose is None:
                raise ValueError("rig needs pose = { light_deg = ..., camera_deg = ... }")
            return self
        if self.pose is not None:
            raise ValueError('pose belongs to rig = "...", which is missing')
        for name in ("position_mm", "vertical_field_deg", "width", "height"):
            if getattr(self, name) is None:
                raise ValueError(f"the key {name} is missing")
        assert self.position_mm is not None
        assert self.width is not None
        assert self.height is not None
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"{self.width} x {self.height} pixels are more than {MAX_PIXELS}")
        look = np.subtract(self.look_at_mm, self.position_mm)
        if not look.any():
            raise ValueError("position_mm and look_at_mm are the same point")
        across = np.cross(look, self.up)
        if not np.linalg.norm(across) > 1e-9 * np.linalg.norm(look) * np.linalg.norm(self.up):
            raise ValueError("up points along the line of sight: choose another up")
        return self


@dataclass(frozen=True)
class SceneCamera:
    """A camera in the scene: a lens (or hole) at a point, and a picture on the plane at distance 1 before it."""

    position: Floats
    right: Floats
    """Unit vector along which columns grow."""
    down: Floats
    """Unit vector along which rows grow."""
    forward: Floats
    width: int
    height: int
    step: float
    """Distance of neighbouring pixels on the plane at distance 1."""
    lens_radius: float
    focus: float
    samples: int

    @property
    def pixels(self) -> int:
        """How many pixels the picture has."""
        return self.width * self.height

    @property
    def noiseless(self) -> bool:
        """Whether one ray a pixel is all: through its centre, from a pinhole."""
        return self.samples == 1 and self.lens_radius == 0.0

    def rays(self, pixel: NDArray[np.int64], sample: int, shift: Floats | None) -> tuple[Floats, Floats]:
        """Origins and unit directions (n, 3) of one ray through each of some pixels, numbered row by row.

        Parameters
        ----------
        pixel
            Their numbers, (n,).
        sample
            The number of the ray in its pixel, from 0.
        shift
            (n, 4): where each pixel's sequence of points starts, in [0, 1); None for the pixel's centre and the
            lens's.
        """
        row, column = np.divmod(pixel, self.width)
        wide = self.lens_radius > 0.0
        at = point(sample, shift[:, : 4 if wide else 2]) if shift is not None else np.full((2, pixel.size), 0.5)
        x = (column + at[0] - 0.5 * self.width) * self.step
        y = (row + at[1] - 0.5 * self.height) * self.step
        direction = toward_plane(x, y, self.right, self.down, self.forward)
        origin = np.broadcast_to(self.position, direction.shape)
        if wide and shift is not None:
            a, b = on_disc(at[2], at[3])
            lens = self.lens_radius * (a[:, None] * self.right + b[:, None] * self.down)
            origin = origin + lens
            direction = self.focus / (direction @ self.forward)[:, None] * direction - lens
            direction /= np.linalg.norm(direction, axis=1)[:, None]
        return origin, direction

    def through(self, column: Floats, row: Floats) -> tuple[Floats, Floats]:
        """Origins and unit directions (n, 3) of rays from the lens's centre through places of the picture.

        Columns and rows are fractions of pixels, 0 the picture's left and upper edge, as in `project`.
        """
        x, y = (column - 0.5 * self.width) * self.step, (row - 0.5 * self.height) * self.step
        direction = self.forward + x[:, None] * self.right + y[:, None] * self.down
        return np.broadcast_to(self.position, direction.shape), direction / np.linalg.norm(direction, axis=1)[:, None]

    def project(self, point: Floats) -> tuple[Floats, Floats]:
        """Column and row (fractions of pixels, 0 the picture's left and upper edge) of points (n, 3) before the lens.

        NaN for a point behind it.
        """
        away = point - self.position
        depth = away @ self.forward
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(depth > 0.0, 1.0 / (depth * self.step), np.nan)
        return (
            np.asarray(away @ self.right * scale + 0.5 * self.width),
            np.asarray(away @ self.down * scale + 0.5 * self.height),
        )


# --- points that fill a square, or a square of squares, evenly: for pixels, lenses and discs of lamps ----------------

_ROOTS = {2: 1.3247179572447460, 4: 1.1673039782614187}
"""The root above 1 of x^(d + 1) = x + 1: multiples of its powers 1/x, 1/x^2, ... fill d dimensions evenly."""


def point(sample: int, shift: Floats) -> Floats:
    """Point number `sample` of an even sequence in [0, 1)^d, moved by each row of `shift` (n, d), d 2 or 4; (d, n).

    The sequence is Roberts' generalised golden ratio (2018). Moved by a random shift each of its points is uniformly
    distributed, so that means over them are without bias.
    """
    dimensions = shift.shape[1]
    step = _ROOTS[dimensions] ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray(((shift + (sample + 0.5) * step) % 1.0).T)


def on_disc(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """The unit square onto the unit disc, areas in proportion and neighbours kept (Shirley and Chiu 1997)."""
    x, y = 2.0 * a - 1.0, 2.0 * b - 1.0
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    ratio = np.where(wide, y, x) / np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    return radius * np.cos(angle), radius * np.sin(angle)


# --- from files ------------------------------------------------------------------------------------------------------


def from_table(table: CameraTable, rig: RigDescription | None) -> SceneCamera:
    """The camera that a scene file describes; `rig` is the description that its key `rig` names."""
    if rig is not None:
        return _of_rig(table, rig)
    assert table.position_mm is not None
    assert table.vertical_field_deg is not None
    assert table.width is not None
    assert table.height is not None
    position = np.array(table.position_mm)
    look = np.array(table.look_at_mm) - position
    distance = float(np.linalg.norm(look))
    forward = look / distance
    right = np.cross(forward, np.array(table.up))
    right /= np.linalg.norm(right)
    return SceneCamera(
        position=position,
        right=right,
        down=np.cross(forward, right),
        forward=forward,
        width=table.width,
        height=table.height,
        step=2.0 * math.tan(math.radians(table.vertical_field_deg) / 2.0) / table.height,
        lens_radius=table.lens_radius_mm,
        focus=table.focus_mm or distance,
        samples=table.samples,
    )


def _of_rig(table: CameraTable, rig: RigDescription) -> SceneCamera:
    """The rig's camera as its lens forms the image: in focus at the sample's centre."""
    assert table.pose is not None
    seen = view(rig, table.pose.pose())
    distance = rig.geometry.camera_distance_mm
    image_mm = 1.0 / (1.0 / rig.camera.focal_length_mm - 1.0 / distance)
    return SceneCamera(
        position=seen.camera_mm,
        right=seen.image_x,
        down=seen.image_y,
        forward=-seen.camera_mm / distance,
        width=table.width or rig.camera.width,
        height=table.height or rig.camera.height,
        step=rig.camera.pixel_um * 1e-3 / image_mm * rig.camera.height / (table.height or rig.camera.height),
        lens_radius=table.lens_radius_mm or distance * math.tan(math.radians(rig.camera.lens_half_angle_deg)),
        focus=distance,
        samples=table.samples,
    )


# --- the sensor behind the lens, and its simulated raw frame ------------------------------------------------------


SMALLEST = 32
"""Rows and columns that a raw file has at least."""


class SensorTable(Strict):
    """The table [photograph.sensor]: the terms of EMVA 1288 as in a rig file, and the lens's falloff."""

    responsivity_e_per_s: Positive
    """Electrons a second of a pixel on the optical axis that sees the radiance 1, in the scene's own units."""
    bits: Literal[8, 10, 12, 14, 16] = 12
    electrons_per_dn: Positive = 3.0
    black_level_dn: NonNegative | None = None
    """64 where a photograph is simulated; that of the raw file where one is read, unless it is given."""
    full_well_e: Positive = 11_000.0
    photon_noise: bool = True
    read_noise_e: NonNegative = 0.0
    dark_current_e_per_s: NonNegative = 0.0
    prnu: Annotated[float, Field(ge=0, lt=1)] = 0.0
    dsnu_e: NonNegative = 0.0
    cos4: bool = False
    """Whether the lens loses light with the fourth power of the field angle's cosine."""
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Relative loss at the picture's corner beyond cos^4, growing as the fourth power of the radius."""

    @model_validator(mode="after")
    def _sound(self) -> "SensorTable":
        black, white = 64.0 if self.black_level_dn is None else self.black_level_dn, float(2**self.bits - 1)
        if black >= white:
            raise ValueError(
                f"black_level_dn = {black:g} must lie below the highest value of {self.bits} bits, {white:g}"
            )
        return self

    def model(self, width: int, height: int) -> SensorModel:
        """The same as a rig's camera of a size."""
        own = self.model_dump(exclude={"responsivity_e_per_s", "cos4", "vignetting"}, exclude_none=True)
        return SensorModel.model_validate({"width": width, "height": height, **own})


def falloff(sensor: SensorTable, camera: SceneCamera) -> Floats:
    """The lens's share of light at each pixel's centre, 1 on the axis, (height, width)."""
    u = (np.arange(camera.width) + 0.5 - 0.5 * camera.width) * camera.step
    v = (np.arange(camera.height) + 0.5 - 0.5 * camera.height) * camera.step
    squared = v[:, None] ** 2 + u[None, :] ** 2
    out = np.ones(squared.shape)
    if sensor.cos4:
        out /= (1.0 + squared) ** 2
    if sensor.vignetting:
        corner = 0.25 * camera.step**2 * (camera.width**2 + camera.height**2)
        out *= 1.0 - sensor.vignetting * (squared / corner) ** 2
    return out


def require_size(camera: SceneCamera) -> None:
    """Raise `ConfigError` where a picture is too small for a raw file."""
    if min(camera.width, camera.height) < SMALLEST:
        raise ConfigError(
            f"photograph: camera.width = {camera.width} and camera.height = {camera.height}; a raw file has at least "
            f"{SMALLEST} x {SMALLEST} pixels"
        )


def expose(sensor: SensorTable, camera: SceneCamera, radiance: Floats, exposure_s: float, seed: int) -> Frame:
    """The raw frame of radiances (height, width), with the noise of the simulated rig's camera."""
    from gonio_sim.camera import Sensor
    from gonio_sim.world import Stream, key

    model = sensor.model(camera.width, camera.height)
    chip = Sensor(model, lambda stream: key(seed, stream))
    rate = radiance * sensor.responsivity_e_per_s * falloff(sensor, camera)
    try:
        mosaic = chip.read_out(rate.astype(np.float32), exposure_s, 1.0, key(seed, Stream.SENSOR))
    finally:
        chip.close()
    return Frame(mosaic, exposure_s, model.black_level_dn, model.white_level_dn, time_s=0.0)
