"""The frames that a camera is calibrated from: a folder, and `frames.csv` in it, which says what each one is.

Columns: `file`, `kind` (dark, flat, trap, edge, field), `exposure_s`; where they are known `asked_s` (what the camera
was asked for), `time_s`, `temperature_c`. Trap and edge need `black_px` = top:bottom,left:right, pixels that see
nothing but black. Field needs `pose_deg` = light,camera, the angles of both arms. Without the list raw files tell their
exposures, and their names begin with the kind.
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np

from gonio.checks.values import CLIPPED
from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError, DeviceError
from gonio.lab.calibration import photon_transfer
from gonio.lab.rig import Frame, Pose, dng, raw_tags
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import Channel, of_channel
from gonio.lab.rig.light_and_camera import Camera, linear_dn
from gonio.lab.rig.regions import require_raw
from gonio.typing import Floats, NDArray

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

    data = read_file(path)
    raw_tags.require_plain(data, path)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
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
        if None in row:
            raise ConfigError(f"{where}: more cells than the header names columns; numbers have decimal points")
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


BRIGHT = 0.9
"""Part of the flats' brightest level: pixels above it are the region of the photon transfer."""
PARTS = (BRIGHT, 0.45, 0.2, 0.09, 0.04, 0.02, 0.01)
"""Edges of the parts of other brightness, from which the linearity is determined."""
FEWEST_PIXELS = 200
PAIR = 5.0
"""Standard deviations of the lamp's noise that the frames of a pair may differ by, beyond half a per cent."""
BIASED_PAIR = 0.005
MAP_LEVELS = 0.2, 0.8
"""Parts of the brightest flats' level between which flats make the map of responsivities."""


class Passes:
    """Frames, read one after the other: dark levels, pairs and defects, then the levels of the flats.

    Raises
    ------
    DataError
        Frames are missing, full, cut off at 0 DN, or do not go together; the message says which.
    """

    def __init__(self, frames: Sequence[CameraFrame], description: RigDescription, channel: Channel) -> None:
        self.description = description
        self.camera, self.channel = description.camera, channel
        # what is measured is not to be taken out before
        self.raw = self.camera.model_copy(update={"nonlinearity": (), "stray_light": 0.0, "stray_halo": 0.0})
        self.of = {kind: [f for f in frames if f.kind == kind] for kind in ("dark", "flat", "trap", "edge", "field")}
        shape = self.camera.height, self.camera.width
        self.colour = of_channel(self.camera.pattern, channel, slice(0, shape[0]), slice(0, shape[1]))
        self.notes: list[str] = []

    def read(self, frame: CameraFrame) -> Floats:
        """A frame's linear values [DN]."""
        return np.asarray(linear_dn(self.camera, frame.read(self.camera)), dtype=float)

    def mean(self, frames: Sequence[CameraFrame]) -> Floats:
        """The mean of some frames [DN]."""
        return np.asarray(np.mean([self.read(f) for f in frames], axis=0))

    # ---- dark frames ----

    def darks(self) -> None:
        """Each pixel's line over exposure, defects, pairs, and the level of the frame."""
        from scipy.stats import linregress

        taken = self.of["dark"]
        exposures = sorted({f.exposure_s for f in taken})
        if len(exposures) < 2 or any(sum(f.exposure_s == t for f in taken) < 2 for t in exposures):
            raise DataError(
                f"there are {len(taken)} dark frames of {len(exposures)} exposures; two exposures with two frames each "
                "are needed (lamp off, lens covered): a short one, and the longest that is used"
            )
        t = np.array([f.exposure_s for f in taken])
        total, first, zero = np.zeros(self.colour.shape), np.zeros(self.colour.shape), 0.0
        for f in taken:
            image = f.read(self.camera)
            zero += float(np.mean(image == 0)) / len(taken)
            values = np.asarray(linear_dn(self.camera, image), dtype=float)
            total += values
            first += (f.exposure_s - t.mean()) * values
        if CLIPPED < zero < 1.0:
            raise DataError(
                f"{100 * zero:.2g} % of the pixels of the dark frames read 0 DN: what lies below is cut off, and "
                "neither noise nor dark level can be determined; raise the camera's black level"
            )
        self.dark_mean, self.dark_t = total / len(taken), float(t.mean())
        self.dark_slope = first / float(np.sum((t - t.mean()) ** 2))
        self.defects = photon_transfer.outliers(self.dark_slope) | photon_transfer.outliers(self.dark_at(0.0))
        self.good = self.colour & ~self.defects
        means: list[tuple[float, float, float]] = []
        self.dark_pairs: list[photon_transfer.FramePair] = []
        for exposure in exposures:
            group = [f for f in taken if f.exposure_s == exposure]
            images = [self.read(f)[self.good] for f in group]
            means += [(f.exposure_s, float(i.mean()), f.temperature_c) for f, i in zip(group, images, strict=True)]
            self.dark_pairs += [
                photon_transfer.pair(a, b, exposure) for a, b in zip(images[::2], images[1::2], strict=False)
            ]
        *self.dark_means, self.temperatures = np.array(means).T
        line = linregress(*self.dark_means)
        self.level, self.u_level = float(line.intercept), float(line.intercept_stderr)
        self.slope, self.u_slope = float(line.slope), float(line.stderr)

    def dark_at(self, exposure_s: float) -> Floats:
        """Each pixel's dark level at an exposure [DN]."""
        return self.dark_mean + self.dark_slope * (exposure_s - self.dark_t)

    def dark_variance(self, exposure_s: float) -> tuple[float, float]:
        """Temporal variance [DN^2] of a pixel's dark line at an exposure, of the frames that it is made of; and u."""
        x = self.dark_means[0]
        share = (1.0 / len(x) + (exposure_s - x.mean()) * (x - x.mean()) / np.sum((x - x.mean()) ** 2)) ** 2
        variance = u_square = 0.0
        for t in set(x):
            pairs, weight = [p for p in self.dark_pairs if p.exposure_s == t], float(np.sum(share[x == t]))
            variance += weight * float(np.mean([p.variance_dn2 for p in pairs]))
            u_square += weight**2 * float(np.sum([p.u_variance**2 for p in pairs])) / len(pairs) ** 2
        return variance, math.sqrt(u_square)

    def uneven_darks(self) -> tuple[photon_transfer.Unevenness, float, Floats]:
        """Unevenness of the dark level at no exposure [DN], the standard uncertainty of its total, and the level."""
        bias = self.dark_at(0.0)
        filled = np.where(self.defects, float(np.median(bias)), bias)
        temporal, u_temporal = self.dark_variance(0.0)
        uneven = photon_transfer.unevenness(filled, temporal)
        u_variance = math.hypot((uneven.total**2 + temporal) * math.sqrt(2.0 / filled.size), u_temporal)
        return uneven, u_variance / (2.0 * max(uneven.total, math.sqrt(u_variance))), filled

    # ---- flat frames ----

    def flats(self) -> None:
        """Parts of the picture, levels of every frame, and pairs over the brightest part."""
        taken = self.of["flat"]
        fewest = photon_transfer.FEWEST_LEVELS
        exposures = len({f.exposure_s for f in taken})
        if len(taken) < 2 * fewest:
            raise DataError(f"there are {len(taken)} flat frames; pairs at {fewest} exposures and more are needed")
        if exposures < fewest:
            raise DataError(
                f"the flat frames have {exposures} exposures; at least {fewest} from dark to full are needed: flats of "
                "one level tell no line"
            )
        tops: dict[float, float] = {}
        for f in taken:
            tops.setdefault(f.exposure_s, float(np.percentile(self.read(f)[self.good], 99.0)) - self.level)
        # of the converter, or of a well that fills up before
        white = self.camera.white_level_dn - self.level
        self.full = min(white, max(tops.values()))
        inside = {t: top for t, top in tops.items() if top < 0.7 * self.full}
        if not inside:
            raise DataError(
                "every flat frame is full: take flats at shorter exposures, from a few per cent of full scale on"
            )
        if max(inside.values()) < 0.05 * white:
            raise DataError(
                f"the brightest flat frames reach {100 * max(tops.values()) / white:.1f} % of full scale: light the "
                "white reference more, or expose longer"
            )
        middle = max(inside, key=lambda t: inside[t])
        picture = self.mean([f for f in taken if f.exposure_s == middle]) - self.dark_at(middle)
        top = float(np.percentile(picture[self.good], 99.0))
        # noise must not choose the pixels
        self.even = photon_transfer.smooth(picture, self.good, 2.0)
        edges = [math.inf, *(part * top for part in PARTS)]
        masks = [self.good & (self.even < high) & (self.even >= low) for high, low in pairwise(edges)]
        self.bright = masks[0]
        self.masks = [mask for mask in masks if np.count_nonzero(mask) >= FEWEST_PIXELS]
        if np.count_nonzero(self.bright) < FEWEST_PIXELS:
            raise DataError("the flat frames hold no even bright part: is the white reference in view, and in focus?")
        self._levels(taken)

    def _levels(self, taken: list[CameraFrame]) -> None:
        """Level of every part in every frame, and its uncertainty; frames that are no pair are left out (NaN)."""
        self.u_dark_dn = np.sqrt([self.dark_variance(0.0)[0] / np.count_nonzero(m) for m in self.masks])
        level, u = np.full((2, len(self.masks), len(taken)), math.nan)
        self.level_dn, self.u_dn, self.pairs = level, u, list[photon_transfer.FramePair]()
        limit = PAIR * math.sqrt(2.0) * self.description.lamp.noise + BIASED_PAIR
        self.map_sum, of_map = np.zeros(self.colour.shape), list[float]()
        waiting: dict[float, tuple[int, Floats]] = {}
        dropped = 0
        for k, f in enumerate(taken):
            image = self.read(f)
            signal = image - self.dark_at(f.exposure_s)
            level[:, k] = [signal[mask].mean() for mask in self.masks]
            mean = level[0, k]
            if MAP_LEVELS[0] * self.full <= mean <= MAP_LEVELS[1] * self.full:
                self.map_sum += signal
                of_map.append(f.exposure_s)
            if f.exposure_s not in waiting:
                waiting[f.exposure_s] = (k, image)
                continue
            first, before = waiting.pop(f.exposure_s)
            found = [photon_transfer.pair(before[mask], image[mask], f.exposure_s) for mask in self.masks]
            for b, one in enumerate(found):
                u[b, [first, k]] = math.sqrt(max(one.variance_dn2, 0.05) / one.pixels)
            apart = abs(level[0, first] - level[0, k]) / max(mean, 1.0)
            if apart > limit + 5.0 * math.sqrt(2.0) * u[0, k] / max(mean, 1.0):
                dropped += 1
                self.notes.append(
                    f"{f.path.name} and {taken[first].path.name} differ by {100 * apart:.2g} % and are left out: the "
                    f"lamp is taken to be steady within {100 * limit:.2g} % (lamp.noise)"
                )
                level[:, [first, k]] = math.nan
            else:
                self.pairs.append(found[0])
        if waiting:
            level[:, [left for left, _ in waiting.values()]] = math.nan
            self.notes.append(f"{len(waiting)} flat frames have no second one of their exposure and are left out")
        pairs, exposures = dropped + len(self.pairs), len({p.exposure_s for p in self.pairs})
        if dropped > 0.5 * pairs:
            raise DataError(
                f"{dropped} of {pairs} pairs of flat frames differ by more than {100 * limit:.2g} %: the lamp drifts "
                "or flickers more than lamp.noise says; let it warm up, or give its noise in the rig file"
            )
        if exposures < photon_transfer.FEWEST_LEVELS:
            raise DataError(
                f"there are pairs of flat frames at {exposures} exposures; {photon_transfer.FEWEST_LEVELS} are needed: "
                "two frames and more at each exposure"
            )
        self.map_count, self.map_exposure = len(of_map), float(np.mean(of_map)) if of_map else 0.0
