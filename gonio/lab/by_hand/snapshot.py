"""One frame, what is in it, and a picture of it with the outline of the patch that a measurement would use."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio import lost
from gonio.disk import check_writable, free_name, put, put_picture
from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand import frame_analysis
from gonio.lab.rig import Frame, Pose, dng, kinematics, regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Array, Figure, Floats

if TYPE_CHECKING:
    from gonio.lab.by_hand.manual_rig import ManualRig

EIGHT_BITS = 256
ROUNDING_DN = 1 / math.sqrt(12)
"""Standard deviation of what rounding to whole numbers adds."""
SUFFIXES = (".dng", ".tif", ".tiff", ".png")
BINS = 256


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A frame and where it was taken from."""

    frame: Frame
    camera: Camera
    pose: Pose | None
    """Where the axes stood [rad]; None where that is not known."""
    patch: regions.Roi | None
    """The pixels that a measurement of the sample would use, from that pose."""
    outline: tuple[Floats, Floats] | None
    """Columns and rows of its edge."""
    without: str
    """Why there is no patch; "" where there is one."""
    files: tuple[Path, ...] = ()
    """What was written: the frame, and the picture of it."""

    def numbers(self) -> dict[str, float]:
        """What is in the frame: levels [DN], fractions of full scale and of pixels; of the patch where there is one."""
        out = {"exposure_s": self.frame.exposure_s} | self._of("", self.frame.mosaic)
        if self.patch is not None:
            out |= {"patch_pixels": float(self.patch.count)} | self._of("patch_", self.patch.of(self.frame.mosaic))
        return out

    def _of(self, prefix: str, pixels: Array) -> dict[str, float]:
        full = exposure.full_scale_dn(self.camera, self.frame)
        levels = frame_analysis.signal(self.camera, self.frame, pixels) / full
        return {
            f"{prefix}mean_dn": float(pixels.mean()),
            f"{prefix}median_dn": float(np.median(pixels)),
            f"{prefix}max_dn": float(pixels.max()),
            f"{prefix}brightest_level": float(levels.max()),
            f"{prefix}saturated_fraction": float(frame_analysis.saturated(self.camera, self.frame, pixels).mean()),
        }

    def remarks(self, *, lit: bool | None = None) -> list[str]:
        """What a person should know of the frame, in sentences; `lit`: whether the lamp shone, as far as is known."""
        said, frame = [], self.frame
        noise_dn = frame_analysis.noise_of_one(frame)
        if frame_analysis.is_black(self.camera, frame):
            lamp = "the lamp is lit" if lit else "is the lamp dark" if lit is None else "the lamp is dark"
            said.append(f"the frame is black: no light stands out of its noise ({lamp}; is the lens cap on?)")
        if frame.white_level_dn < EIGHT_BITS:
            full = frame.mosaic[frame_analysis.saturated(self.camera, frame)]
            top = int(np.min(full, initial=round(frame.white_level_dn)))
            said.append(
                f"8 bits: a step is {100 / exposure.full_scale_dn(self.camera, frame):.2g} % of full scale; noise of a "
                f"pixel {noise_dn:.2g} DN, {ROUNDING_DN:.2g} of it at least from rounding; "
                f"{100 * self.numbers()['saturated_fraction']:.3g} % of the pixels are saturated (from {top} DN)"
            )
        return said

    def draw(self) -> Figure:
        """The frame in grey with the outline of the patch, and its histogram."""
        from matplotlib.figure import Figure

        frame, numbers = self.frame, self.numbers()
        figure = Figure(figsize=(11, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
        top = max(float(np.percentile(frame.mosaic, 99.9)), frame.black_level_dn + 1.0)
        picture = left.imshow(frame.mosaic, cmap="gray", vmin=frame.black_level_dn, vmax=top, interpolation="nearest")
        figure.colorbar(picture, ax=left, label="DN", shrink=0.8)
        if self.outline is not None:
            left.plot(*self.outline, color="tab:red", lw=1.2, label="patch of the sample, as predicted")
            left.legend(loc="lower left", fontsize="small")
        left.set_xlim(-0.5, frame.mosaic.shape[1] - 0.5)
        left.set_ylim(frame.mosaic.shape[0] - 0.5, -0.5)
        left.set(xlabel="column", ylabel="row", title=f"{frame.exposure_s:.4g} s")
        edges = np.linspace(0.0, frame.white_level_dn + 1.0, BINS + 1)
        right.hist(frame.mosaic.ravel(), edges, histtype="stepfilled", color="0.7", label="all pixels")
        if self.patch is not None:
            pixels = self.patch.of(frame.mosaic)
            right.hist(pixels, edges, histtype="step", color="tab:red", label="patch")
        right.axvline(frame.black_level_dn, color="0.2", lw=0.8, ls=":", label="black level")
        full = frame.black_level_dn + exposure.SATURATED * exposure.full_scale_dn(self.camera, frame)
        right.axvline(full, color="tab:orange", lw=0.8, ls="--", label="saturated from here")
        saturated = 100 * numbers["saturated_fraction"]
        right.set(yscale="log", xlabel="DN", ylabel="pixels", title=f"{saturated:.3g} % of the pixels saturated")
        right.legend(fontsize="small")
        return figure


def require_free(file: Path) -> tuple[Path, Path]:
    """The names of a frame and of its picture, of which a free one is found; `ConfigError` where that of the frame is
    taken, or of no format, or cannot be written.
    """
    if file.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{file}: a frame is written as {', '.join(SUFFIXES)}; the name must end so")
    if file.exists():
        raise ConfigError(f"{file}: is there already; name another file")
    if not file.absolute().parent.is_dir():
        raise ConfigError(f"{file}: there is no folder {file.parent}")
    check_writable(file)
    return file, free_name(file.with_name(f"{file.stem}-view.png"))


def take(manual: "ManualRig", file: Path | None, *, exposure_s: float | None) -> Snapshot:
    """See `ManualRig.snap`."""
    names = require_free(file) if file is not None else None
    description, pose = manual.description, manual.pose()
    if exposure_s is None:
        exposure_s = exposure.expected_exposure_s(description, pose or Pose(), 1.0)
    description.camera.require_exposure(exposure_s)
    frame = manual.camera.capture(exposure_s)
    patch, outline, without = _patch(description, pose, frame)
    shot = Snapshot(frame, description.camera, pose, patch, outline, without, names or ())
    if names is not None:
        _write(shot, *names)
    return shot


def _patch(
    description: RigDescription, pose: Pose | None, frame: Frame
) -> tuple[regions.Roi | None, tuple[Floats, Floats] | None, str]:
    if pose is None:
        return None, None, "the arms do not say where they stand"
    camera = description.camera
    if frame.mosaic.shape != (camera.height, camera.width):
        height, width = frame.mosaic.shape
        return None, None, f"the frame has {width} x {height} pixels, and the rig file {camera.width} x {camera.height}"
    try:
        view = kinematics.view(description, pose)
        return regions.roi(description, view), regions.outline(description, view), ""
    except ConfigError as error:
        return None, None, str(error)


def _write(shot: Snapshot, file: Path, picture: Path) -> None:
    suffix = file.suffix.lower()
    if suffix == ".dng":
        dng.write_dng(shot.frame, file)
    else:
        import cv2

        good, data = cv2.imencode(suffix, shot.frame.mosaic)
        if not good:
            raise DataError(f"{file}: the frame cannot be written as {file.suffix}")
        put(file, data.tobytes())
    with lost.whole(file):
        try:
            put_picture(picture, shot.draw)
        except DataError as failure:
            raise DataError(f"{failure}; the frame itself is whole, in {file}") from None
