"""The frames that a camera is calibrated from: a folder, and `frames.csv` in it, which says what each one is.

Columns: `file`, `kind` (dark, flat, trap, edge, field), `exposure_s`; where they are known `asked_s` (what the camera
was asked for), `time_s`, `temperature_c`. Trap and edge need `black_px` = top:bottom,left:right, pixels that see
nothing but black. Field needs `pose_deg` = light,camera, the angles of both arms. Without the list raw files tell their
exposures, and their names begin with the kind.
"""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError, DeviceError
from gonio.rig import Frame, Pose, dng
from gonio.rig.light_and_camera import Camera
from gonio.rig.regions import require_raw
from gonio.typing import NDArray

Kind = Literal["dark", "flat", "trap", "edge", "field"]
LIST = "frames.csv"
COLUMNS = ("file", "kind", "exposure_s", "asked_s", "time_s", "temperature_c", "black_px", "pose_deg")
RAW = (".dng", ".cr2", ".nef", ".arw", ".raf", ".rw2", ".orf")
PICTURES = (".png", ".tif", ".tiff", ".pgm")
CONTRADICTS = 0.01
"""Relative difference between the exposure that was asked for and the frame's own that is an error."""


@dataclass(frozen=True, slots=True)
class CameraFrame:
    """One entry of the list."""

    path: Path
    kind: Kind
    exposure_s: float
    time_s: float = math.nan
    temperature_c: float = math.nan
    black: tuple[slice, slice] | None = None
    """Rows and columns that see nothing but black."""
    pose: Pose | None = None
    """Where the arms stood [rad]."""

    def read(self, camera: Camera) -> NDArray[np.uint16]:
        """The mosaic [DN], checked against the rig file.

        Raises
        ------
        DataError
            It cannot be read, or is of another size or pattern.
        """
        frame = _read(self.path, camera, self.exposure_s)
        try:
            require_raw(camera, frame, str(self.path))
        except DeviceError as error:  # which is what a camera's own frame would be
            raise DataError(str(error)) from None
        return frame.mosaic


def _read(path: Path, camera: Camera, exposure_s: float) -> Frame:
    if path.suffix.lower() not in PICTURES:
        return dng.read_raw(path)
    import cv2

    image = cv2.imdecode(np.frombuffer(read_file(path), np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DataError(f"{path}: is damaged, or no picture that can be read")
    if image.ndim == 3 and image.shape[2] >= 3 and camera.bits == 8:
        image = image[..., 1]  # a video camera's green is nearest to its luminance
    return Frame(
        np.asarray(image), exposure_s, camera.black_level_dn, camera.white_level_dn, camera.pattern, time_s=math.nan
    )


def read_list(folder: str | Path) -> list[CameraFrame]:
    """The frames of a folder, in the order of the list, or of their names.

    Raises
    ------
    ConfigError
        There is no such folder, or no frame in it whose kind and exposure are known.
    DataError
        An exposure is zero, or the file's own contradicts what was asked for.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder of frames")
    listed = folder / LIST
    frames = _listed(listed) if listed.exists() else _named(folder)
    if not frames:
        raise ConfigError(
            f"{folder}: holds neither {LIST} nor raw files whose names begin with {', '.join(get_args(Kind))}"
        )
    for frame in frames:
        if not (math.isfinite(frame.exposure_s) and frame.exposure_s > 0):
            raise DataError(
                f"{frame.path}: its exposure is {frame.exposure_s:g} s; give the true one in {LIST} (exposure_s)"
            )
    return frames


def _listed(path: Path) -> list[CameraFrame]:
    try:
        rows = list(csv.DictReader(io.StringIO(read_file(path).decode("utf-8-sig"))))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: is no table of text with commas: {error}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    out = []
    for number, row in enumerate(rows, 2):
        where = f"{path}, line {number}"
        if row.get("kind") not in get_args(Kind) or not row.get("file"):
            raise ConfigError(f"{where}: needs file and kind ({', '.join(get_args(Kind))})")
        file = path.parent / row["file"]
        if not file.is_file():
            raise ConfigError(f"{where}: there is no file {file}")
        numbers = {}
        for name in ("exposure_s", "asked_s", "time_s", "temperature_c"):
            text = (row.get(name) or "").strip()
            try:
                numbers[name] = float(text) if text else math.nan
            except ValueError:
                raise ConfigError(f'{where}: {name} = "{text}" is no number') from None
        exposure = numbers["exposure_s"]
        if file.suffix.lower() in RAW:
            own = dng.read_raw(file).exposure_s
            exposure = own if math.isnan(exposure) else exposure
            if exposure > 0 and abs(own / exposure - 1.0) > CONTRADICTS:
                raise DataError(f"{where}: exposure_s = {exposure:g}, but {file.name} itself says {own:g} s")
        elif math.isnan(exposure):
            raise ConfigError(f"{where}: a picture does not say its exposure: give exposure_s")
        asked = numbers["asked_s"]
        if not math.isnan(asked) and exposure > 0 and abs(asked / exposure - 1.0) > CONTRADICTS:
            raise DataError(
                f"{where}: {asked:g} s were asked for, and the frame was exposed for {exposure:g} s: the camera "
                f"does not do "
                "what it is told"
            )
        kind = cast(Kind, row["kind"])
        black = _rectangle(row.get("black_px") or "", where)
        pose = _pose(row.get("pose_deg") or "", where)
        out.append(CameraFrame(file, kind, exposure, numbers["time_s"], numbers["temperature_c"], black, pose))
    return out


def _named(folder: Path) -> list[CameraFrame]:
    out = []
    for file in sorted(folder.iterdir()):
        kind = next((k for k in get_args(Kind) if file.name.lower().startswith(k)), None)
        if kind is None:
            continue
        if file.suffix.lower() in PICTURES:
            raise ConfigError(f"{file}: a picture does not say its exposure: list it in {folder / LIST}")
        if file.suffix.lower() in RAW:
            frame = dng.read_raw(file)
            out.append(CameraFrame(file, kind, frame.exposure_s, frame.time_s))
    return out


def _rectangle(text: str, where: str) -> tuple[slice, slice] | None:
    if not text.strip():
        return None
    try:
        rows, cols = ([int(n) for n in part.split(":")] for part in text.split(","))
        if not (0 <= rows[0] < rows[1] and 0 <= cols[0] < cols[1]):
            raise ValueError
        return slice(*rows), slice(*cols)
    except (ValueError, TypeError, IndexError):
        raise ConfigError(f'{where}: black_px = "{text}": write top:bottom,left:right, in pixels') from None


def _pose(text: str, where: str) -> Pose | None:
    if not text.strip():
        return None
    try:
        light, camera = (math.radians(float(part)) for part in text.split(","))
    except ValueError:
        raise ConfigError(f'{where}: pose_deg = "{text}": write light,camera, in degrees') from None
    return Pose(light=light, camera=camera)


def write_list(folder: Path, frames: list[CameraFrame]) -> None:
    """Write `frames.csv` into a folder of frames."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for f in frames:
        numbers = {name: getattr(f, name) for name in ("exposure_s", "time_s", "temperature_c")}
        row = {name: "" if math.isnan(value) else repr(float(value)) for name, value in numbers.items()}
        black = ""
        if f.black is not None:
            rows, cols = f.black
            black = f"{rows.start}:{rows.stop},{cols.start}:{cols.stop}"
        pose = "" if f.pose is None else f"{math.degrees(f.pose.light)!r},{math.degrees(f.pose.camera)!r}"
        writer.writerow({"file": f.path.name, "kind": f.kind, "asked_s": "", "black_px": black, "pose_deg": pose} | row)
    write_whole(folder / LIST, out.getvalue().encode())
