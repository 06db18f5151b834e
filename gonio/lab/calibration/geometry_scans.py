"""Frames for a calibration of the geometry: the lamp in a mirror and straight through, the markers at many poses.

The search for the lamp, its exposure and its centring are those of an alignment (`gonio.lab.by_hand.alignment_scans`).
Every sighting is kept as it is made: a line of `sightings.jsonl`, and the frames that it was found in.
"""

import json
import math
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from gonio.disk import content
from gonio.errors import ConfigError, DataError, DeviceError, os_error_as
from gonio.geometry import overlap_of_discs
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand.alignment_scans import BRIGHT, Scans
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import fiducials
from gonio.lab.calibration.geometry_problem import Sighting
from gonio.lab.rig import Pose, imaging, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.typing import Array, Bools, Floats, Ints

FILE = "sightings.jsonl"
MIRROR_POSES = 96
STRAIGHT_POSES = 40
MARKER_POSES = 120
AGAINST_POSES = 24
FEWEST = 6
STEEPEST_DEG = 72.0
"""Largest angle; beyond it a mirror of the sample's size shows a sliver of the lamp, and markers run together."""
AWAY_DEG = 3.0
"""Way to a pose that is to be reached with its backlash open, or taken up: more than any backlash."""
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
INSIDE, INSIDE_UNSURE = 0.85, 0.6
"""Part of the mirror's radius: its edge may lie a little beside where markers show it, or the rig file alone."""
SURE, SURE_PX = 12, 0.4
"""Corners, and their scatter, that show the mirror's edge."""
DARK = {
    "mirror": "frames are dark where its image should be. Is the mirror in the holder, whole and flat on it; does the "
    "lamp shine (gonio rig lamp on)",
    "empty": "frames are dark where it should be. Is the holder empty, and nothing between the arms; does the lamp "
    "shine (gonio rig lamp on)",
}
SHAPELESS = (
    "what is bright does not have the form of the lamp. Are lamp.half_angle_deg and camera.lens_half_angle_deg right; "
    "does other light flood the frame (gonio rig snap shows it); is the mirror, where there is one, clean and whole"
)
SIZE_U = 0.05
"""Relative standard uncertainty of the sizes of lamp and pupil in the rig file."""
SPOT_NOISE = 0.02
"""Part of full scale: what does not fit as well as this is no lamp in a mirror, or the mirror's edge is in it."""
WORST_PX = 0.15
PIXELS = 4000
"""Pixels, about, of the binned image in which a spot is fitted."""


class GeometryScans(Scans):
    """Takes the sightings of one calibration on an open rig.

    Parameters
    ----------
    manual, search_deg, say
        As of an alignment.
    keep
        Is given each sighting with its frames, by a word each, as soon as it is made.
    """

    def __init__(
        self, manual: ManualRig, *, search_deg: float, say: Callable[[str], None],
        keep: Callable[[Sighting, dict[str, Array]], None],
    ) -> None:  # fmt: skip
        super().__init__(manual, search_deg=search_deg, say=say)
        self._keep_sighting = keep
        self._sums: dict[float, float] = {}
        """Sum of both encoders at which the lamp's mirror image is in the middle, by the light's angle as read."""
        self._across: float | None = None
        """The tilt, as read, at which it is as high as the frame's middle."""
        self._lost = 0
        self._dark = 0
        """Frames in which nothing was bright where the lamp should be."""
        self._beside: Floats | None = None
        """How far from where the rig file has it the sample's centre is in the frame [px], columns and rows."""

    def _meter(self, *, whole: bool = False) -> None:
        """As of an alignment; but the white of the markers must never pass for the lamp, which is far brighter."""
        super()._meter(whole=whole)
        if self._description.holder.fiducials is not None:
            white = exposure.expected_exposure_s(self._description, Pose(), 1.0)
            self._exposure_s = max(min(self._exposure_s, round(0.02 * white, 6)), self._shortest_s)

    # ---- the kinds of sightings ----

    def mirror_frames(self, poses: int = MIRROR_POSES) -> None:
        """A mirror is in the holder: the lamp in it, at light angles over the whole range; markers where there are."""
        clear = 0.5 * math.degrees(kinematics.blocked_cone(self._description)) + 2.0
        limits = self._description.limits_deg()
        steepest = min(STEEPEST_DEG, *(abs(v) - 1.0 for n in ("light", "camera") for v in limits[n]))
        angles = [float(a) for a in np.linspace(-steepest, steepest, poses) if abs(a) > clear]
        if not angles:
            raise ConfigError("the limits of light and camera leave no mirror direction")
        first = min(angles, key=lambda a: abs(a - 30.0))
        self._begin_mirror(first)
        self._meter(whole=True)  # the image need not lie in the middle: where the camera points is not known yet
        self._sums[first] = self._encoder("camera") + self._encoder("light")
        if "tilt" in self._axes:
            self._across = self._read("tilt")
        angles.sort(key=lambda a: (a * first < 0, abs(a - math.copysign(first, a))))
        for number, light in enumerate(angles):
            self._mirror_at(light, number)
        self._require("mirror", len(angles))

    def straight_frames(self, poses: int = STRAIGHT_POSES) -> None:
        """The holder is empty: the lamp itself, with both arms face to face."""
        difference = self._begin_straight()
        self._meter(whole=True)
        lower, upper = self._description.limits_deg()["light"]
        everywhere = np.linspace(lower, upper, max(round(20 * (upper - lower)), 1)).tolist()
        angles = [a for a in everywhere if self._fits("camera", self._camera_at(a, difference), 0.5)]
        if not angles:
            raise ConfigError(self.why_not_facing())
        for number in range(poses):
            light = angles[round((number + 0.5) / poses * len(angles) - 0.5)]
            goals = {"light": light, "camera": self._camera_at(light, difference) + 0.5 * _spread(number)}
            self._lost += not self._try_to_go(goals) or self._look("empty", marks=False) is None
        self._require("empty", poses)

    def marker_frames(self, poses: int = MARKER_POSES) -> None:
        """Markers alone, at poses all over the range of the camera, of tilt and spin."""
        apart = math.degrees(kinematics.blocked_cone(self._description)) + 5.0
        for number in range(poses):
            camera, light = STEEPEST_DEG * _spread(number, 1), 60.0 * _spread(number, 2)
            if abs(light - camera) < apart:
                light += math.copysign(2.0 * apart, -light)
            turned = {"tilt": 50.0 * _spread(number, 3), "spin": 160.0 * _spread(number, 4)}
            goals = {"camera": camera, "light": light} | turned
            if self._try_to_go({name: goals[name] for name in goals if name in self._description.axes()}):
                self._look("mirror", spot=False)

    def against_frames(self, sums: dict[float, float], across: float | None, poses: int = AGAINST_POSES) -> None:
        """The lamp in the mirror again, each arm in turn arriving from the other side: its backlash stands open.

        The rig's axes approach from nowhere (`reversed_approach`); `sums`, `across`: where the image was.
        """
        self._sums, self._across = dict(sums), across
        side = {n: math.copysign(1.0, a or 1.0) for n, a in self._description.approach_deg().items()}
        lights = sorted((a for a in sums if 10.0 < abs(a) < 65.0), key=lambda a: _spread(int(10 * a), 5))
        self._manual.lamp(True)
        for number in range(poses if lights else 0):
            light = lights[number % len(lights)]
            odd = ("light", "camera")[number % 2]
            goals = self._mirror_goals(light, number)
            before = {n: v - AWAY_DEG * side[n] * (-1.0 if n == odd else 1.0) for n, v in goals.items()}
            if self._try_to_go(before) and self._try_to_go(goals):
                if not self._exposure_s:
                    self._meter(whole=True)
                self._look("mirror", against=(odd,))

    @property
    def where(self) -> tuple[dict[float, float], float | None]:
        """For `against_frames`."""
        return self._sums, self._across

    # ---- one pose ----

    def _mirror_goals(self, light: float, number: int) -> dict[str, float]:
        near = min(self._sums, key=lambda a: (a * light < 0, abs(a - light)))
        camera = self._sums[near] - light - self._offset("light") - self._offset("camera") + 0.4 * _spread(number, 1)
        goals = {"light": light, "camera": camera}
        if self._across is not None:
            goals["tilt"] = self._across + 0.2 * _spread(number, 2)
        if "spin" in self._description.axes():
            goals["spin"] = 160.0 * _spread(number, 3)
        return goals

    def _mirror_at(self, light: float, number: int) -> None:
        """Go where the image should be; where it is far from the middle, go there and look again."""
        for attempt in range(3):
            if not self._try_to_go(self._mirror_goals(light, number)):
                return
            found = self._look("mirror", keep=False)
            if found is None and attempt < 2:
                self._meter(whole=True)
                continue
            if found is None:
                self._lost += 1
                return
            sighting, frames = found
            camera = self._description.camera
            size = np.array([camera.width, camera.height])
            off = sighting.pixels[0] - 0.5 * (size - 1)
            turn = self._turn(sighting, off)
            self._sums[light] = sighting.encoder_deg["camera"] + sighting.encoder_deg["light"] + turn.get("camera", 0.0)
            if self._across is not None and (number == 0 or sighting.u_spot_px > WORST_PX):
                self._across += turn.get("tilt", 0.0)
            if sighting.u_spot_px <= WORST_PX and (np.all(np.abs(off) < 0.3 * size) or attempt == 2):
                self._keep_sighting(sighting, frames)
                return
            self._lost += attempt == 2

    def _turn(self, s: Sighting, off: Floats) -> dict[str, float]:
        """How far camera and tilt have to go for the spot to be in the middle [deg], if the rig file were true."""
        rig, pose = self._description, self._pose()
        names = [n for n in ("camera", "tilt") if n in s.encoder_deg]

        def lamp_at(name: str, shift_deg: float) -> Floats:
            view = kinematics.view(rig, replace(pose, **{name: getattr(pose, name) + math.radians(shift_deg)}))
            return np.array(imaging.project(rig, view, np.asarray(view.source_mm) * [1.0, 1.0, -1.0]))

        slopes = [(lamp_at(name, 0.05) - lamp_at(name, -0.05)) / 0.1 for name in names]
        turn = np.linalg.lstsq(np.array(slopes).T, -off, rcond=1e-3)[0]
        return dict(zip(names, map(float, np.clip(turn, -3.0, 3.0)), strict=True))

    def _pose(self) -> Pose:
        return Pose(**{n: math.radians(self._read(n)) for n in self._description.axes()})

    def _look(
        self, holder: str, *, spot: bool = True, marks: bool = True, against: tuple[str, ...] = (), keep: bool = True
    ) -> tuple[Sighting, dict[str, Array]] | None:
        """Frames at the present pose, and what they show; None where they show nothing."""
        rig, frames, pose = self._description, dict[str, Array](), self._pose()
        numbers, pixels, u_corner = np.zeros(0, np.intp), np.zeros((0, 2)), 0.0
        if marks and rig.holder.fiducials is not None:
            wanted = exposure.expected_exposure_s(rig, pose, rig.holder.fiducials.albedo)
            frame = self._captured(round(min(max(wanted, self._shortest_s), self._longest_s, 2.0), 6))
            frames["markers"] = frame.mosaic
            numbers, pixels = fiducials.detect(frame.mosaic, rig.holder.fiducials)
            numbers, pixels, u_corner = fiducials.consistent(rig.holder.fiducials, numbers, pixels)
        sure = len(numbers) >= SURE and u_corner < SURE_PX
        if sure and rig.holder.fiducials is not None:
            self._beside = fiducials.middle(rig.holder.fiducials, numbers, pixels) - self._middle(pose)
        found: tuple[float, float, float] | None = None
        if spot:
            frame = self._captured(self._exposure_s)
            frames["lamp"] = frame.mosaic
            if self._is_bright(frame):
                seen = self._mirror(pose, numbers if sure else None, pixels) if holder == "mirror" else None
                light = np.asarray(frame.mosaic, float) - frame.black_level_dn
                found = spot_of(light / exposure.full_scale_dn(rig.camera, frame), rig, seen)
            else:
                self._dark += 1
        if found is None and (spot or not len(numbers)):
            return None
        sighting = Sighting(
            holder=holder,
            encoder_deg={n: round(self._encoder(n), 6) for n in rig.axes()},
            against=against,
            spot_px=found[:2] if found else None,
            u_spot_px=found[2] if found else 0.0,
            corners=tuple(map(int, numbers)),
            corners_px=tuple((float(c), float(r)) for c, r in pixels),
            u_corner_px=u_corner,
        )
        if keep and sighting.u_spot_px <= WORST_PX:
            self._keep_sighting(sighting, frames)
        return sighting, frames

    def _middle(self, pose: Pose) -> Floats:
        """Where the sample's centre would be in the frame, by the rig file."""
        return np.array(imaging.project(self._description, kinematics.view(self._description, pose), np.zeros(3)))

    def _mirror(self, pose: Pose, numbers: Ints | None, pixels: Floats) -> Bools:
        """Pixels that surely see the mirror: as corners of markers in this frame show it; or, where they do not (None),
        as the rig file has it, shifted to where markers have last shown its middle."""
        rig, camera = self._description, self._description.camera
        radius_mm, size = 0.5 * rig.holder.sample_diameter_mm, (camera.height, camera.width)
        if rig.holder.fiducials is not None and numbers is not None:
            return fiducials.on_plane(rig.holder.fiducials, numbers, pixels, size) <= INSIDE * radius_mm
        view = kinematics.view(rig, pose)
        if view.camera_mm[2] <= 0.0:
            return np.zeros(size, bool)
        column, row = np.array(camera.principal_point_px) + (0.0 if self._beside is None else self._beside)
        camera = camera.model_copy(update={"principal_point_px": (float(column), float(row))})
        seen = imaging.pixel_map(rig.model_copy(update={"camera": camera}), view)
        return np.asarray(np.hypot(seen.x_mm, seen.y_mm) <= INSIDE_UNSURE * radius_mm)

    def _try_to_go(self, goals: dict[str, float]) -> bool:
        """Whether the rig can go there, and has."""
        if not all(self._fits(name, goal, 0.0) for name, goal in goals.items()):
            return False
        try:
            self._manual.goals(**{n: math.radians(a) for n, a in goals.items()})
        except ConfigError:
            return False
        self._go(**goals)
        return True

    def _require(self, holder: str, tried: int) -> None:
        if tried - self._lost < min(FEWEST, tried):
            raise DeviceError(
                f"the lamp was seen at {tried - self._lost} of {tried} poses with holder {holder}: "
                + (SHAPELESS if self._dark < self._lost / 2 else DARK[holder])
            )
        if self._lost:
            self._say(f"{holder}: at {self._lost} of {tried} poses the lamp was not seen")
        self._lost = self._dark = 0


def reversed_approach(description: RigDescription) -> RigDescription:
    """A rig whose axes go straight to their goals: from either side, as they come."""
    tables = description.model_dump(mode="python")
    for axis in filter(None, tables["arms"].values()):
        axis["approach_deg"] = None
    tables["holder"] |= {"tilt_approach_deg": None, "spin_approach_deg": None}
    tables["acquisition"]["approach_deg"] = math.copysign(1e-6, description.acquisition.approach_deg or 1.0)
    return RigDescription.model_validate(tables)


def spot_of(light: Floats, description: RigDescription, inside: Bools | None) -> tuple[float, float, float] | None:
    """Column, row and standard uncertainty [px] of the middle of the lamp in a frame; None where it shows none.

    Parameters
    ----------
    light
        Pixels over the black level, in units of full scale.
    description
        For the sizes of lamp and pupil.
    inside
        Pixels that may show the lamp: those of the mirror; None for all.

    Notes
    -----
    The lamp's disc, blurred by the lens's pupil, is round in the frame however the mirror lies. Its brightness at a
    distance from its middle is what two discs share, as far apart: those of lamp and pupil, as the plane in focus shows
    them. Their sizes are the rig file's, but for one factor. So no whole image is needed: a part of its edge tells.
    """
    from scipy.optimize import least_squares

    camera = description.camera
    inside = np.ones(light.shape, bool) if inside is None else inside
    size = max(1, round(math.sqrt(np.count_nonzero(inside) / PIXELS)))
    rows, cols = camera.height // size, camera.width // size

    def binned(image: Array) -> Floats:
        return np.asarray(image[: rows * size, : cols * size].reshape(rows, size, cols, size).mean(axis=(1, 3)))

    whole = binned(inside) == 1.0
    y, x = np.nonzero(whole)
    values = binned(np.clip(light / exposure.MAY_BE_FULL, 0.0, 1.0))[whole]
    if len(values) < 30 or values.max() < BRIGHT:
        return None
    at = values > 0.5 * values.max()
    lamp, pupil = (max(r / size, 0.5) for r in _disc_radii_px(description))
    reach = lamp + pupil

    def left(p: Floats) -> Floats:
        """Residuals of column, row, brightness, factor of the size, background."""
        r = np.hypot(x - p[0], y - p[1])
        form = np.minimum(p[2] * overlap_of_discs(r, p[3] * lamp, p[3] * pupil) + p[4], 1.0)  # where it saturates
        return np.append(form - values, (p[3] - 1.0) / SIZE_U * SPOT_NOISE)

    bounds = ([-reach, -reach, 0.1, 0.6, -0.3], [cols + reach, rows + reach, 50.0, 1.6, 0.6])
    found: Any = None
    for right, down in ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)):
        start = [x[at].mean() + right * reach, y[at].mean() + down * reach, float(values.max()), 1.0, 0.0]
        tried = least_squares(left, np.clip(start, *bounds), bounds=bounds, x_scale=[1, 1, 0.1, 0.05, 0.1])
        if found is None or tried.cost < found.cost:
            found = tried
        if math.sqrt(2.0 * found.cost / len(values)) < SPOT_NOISE:
            break
    variance = 2.0 * found.cost / max(len(values) - 5, 1)
    variances = variance * np.diag(np.linalg.pinv(found.jac.T @ found.jac))
    column, row = (size * float(v) + 0.5 * (size - 1) for v in found.x[:2])
    if not (0.0 <= column <= camera.width - 1 and 0.0 <= row <= camera.height - 1) or math.sqrt(variance) > SPOT_NOISE:
        return None
    return column, row, size * math.sqrt(max(*map(float, variances[:2]), 0.0))


def _disc_radii_px(description: RigDescription) -> tuple[float, float]:
    """Radii of the discs of lamp and pupil in the frame, as lines of sight through the plane in focus turn."""
    g, camera = description.geometry, description.camera
    pitch_mm = 1e-3 * camera.pixel_um * g.camera_distance_mm / imaging.image_distance_mm(description)
    turn = (1.0 / g.light_distance_mm + 1.0 / g.camera_distance_mm) * pitch_mm  # [rad] a pixel
    return math.radians(description.lamp.half_angle_deg) / turn, math.radians(camera.lens_half_angle_deg) / turn


def _spread(number: int, k: int = 0) -> float:
    """In [-1, 1), evenly over many numbers, another sequence for every k (Weyl's)."""
    return 2.0 * (((number + 1) * math.sqrt((2.0, 3.0, 5.0, 7.0, 11.0, 13.0)[k]) + 0.5 * k * GOLDEN) % 1.0) - 1.0


# ---- what is kept ----


class Kept:
    """A folder of sightings and their frames, to which each is added as it is made."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.sightings = folder, []  # type: tuple[Path, list[Sighting]]
        with os_error_as(DataError, f"{folder}: cannot be made"):
            folder.mkdir()

    def keep(self, sighting: Sighting, frames: dict[str, Array]) -> None:
        """Write the frames, then the line that tells of them."""
        import cv2

        number = len(self.sightings)
        names = {}
        with os_error_as(DataError, f"{self.folder}: cannot be written"):
            for what, mosaic in frames.items():
                name = f"{number:04d}-{what}.png"
                good, data = cv2.imencode(".png", mosaic, [cv2.IMWRITE_PNG_COMPRESSION, 1])
                if not good:
                    raise DataError(f"{self.folder / name}: this frame cannot be written as a picture")
                (self.folder / name).write_bytes(data.tobytes())
                names[what] = name
            with (self.folder / FILE).open("a", encoding="utf-8", newline="\n") as file:
                file.write(json.dumps(asdict(sighting) | {"frames": names}) + "\n")
        self.sightings.append(sighting)


def read_sightings(path: Path) -> list[Sighting]:
    """The sightings of a folder that `Kept` wrote, or of its file.

    Raises
    ------
    ConfigError
        There is no such file.
    DataError
        It cannot be read, or a line is no sighting.
    """
    file = path / FILE if path.is_dir() else path
    try:
        lines = content(file, str(file), unreadable=DataError).decode().splitlines()
    except UnicodeDecodeError as error:
        raise DataError(f"{file}: cannot be read: {error}") from None
    out = [_sighting(line, f"{file}, line {number}") for number, line in enumerate(lines, 1)]
    if not out:
        raise DataError(f"{file}: holds no sighting")
    return out


def _sighting(line: str, where: str) -> Sighting:
    try:
        values = json.loads(line)
        values.pop("frames", None)
        sighting = TypeAdapter(Sighting).validate_python(values)
        numbers = [*sighting.pixels.ravel(), *sighting.encoder_deg.values()]
        if set(values) != {field.name for field in fields(Sighting)} or not np.isfinite(numbers).all():
            raise ValueError("other fields, or not finite")
        if len(sighting.corners) != len(sighting.corners_px):
            raise ValueError("corners without places")
    except (ValueError, TypeError, AttributeError):
        raise DataError(f"{where}: is no sighting of gonio calibrate geometry") from None
    return sighting
