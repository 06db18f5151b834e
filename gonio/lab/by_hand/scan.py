"""A signal against the angle of one axis: for finding zeros, mirrors and lobes by hand.

At each angle the mean of the patch that a measurement of the sample would use, with the dark signal taken off, divided
by the exposure. Every angle has an exposure of its own unless one is given, so a mirror's peak and what is around it
are both in scale.
"""

import contextlib
import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gonio import lost
from gonio.disk import put, put_picture
from gonio.errors import ArgumentError, ConfigError, DataError
from gonio.lab.acquisition import exposure
from gonio.lab.rig import Frame, Pose, kinematics, light_and_camera, regions
from gonio.lab.rig.description import RigDescription
from gonio.typing import Axes, Figure, Floats

if TYPE_CHECKING:
    from gonio.lab.by_hand.manual_rig import ManualRig

DARK_FRAMES = 4
LONGEST = 8.0
"""The longest exposure of a scan, in exposures of a matt white surface: a scan must come to an end."""
MOST_POINTS = 10_000


def angles_between(start: float, stop: float, step: float) -> list[float]:
    """The angles from `start` to `stop`, both included where a whole number of steps lies between, in any unit.

    Raises
    ------
    ArgumentError
        The step is 0 or no number, or leads to too many angles.
    """
    if not all(map(math.isfinite, (start, stop, step))) or step == 0:
        raise ArgumentError(f"step = {step:g}, from {start:g} to {stop:g}: must be finite, and the step not 0")
    count = math.floor(abs(stop - start) / abs(step) + 1e-6) + 1
    if count > MOST_POINTS:
        raise ArgumentError(f"step = {step:g}: {count} angles; at most {MOST_POINTS}")
    return [start + k * math.copysign(step, stop - start) for k in range(count)]


@dataclass(frozen=True, slots=True)
class _Dark:
    """Mean dark frames [DN] at one or two exposures [s], and between them the dark signal of any pixel."""

    exposures_s: list[float]
    means: list[Floats]

    def of(self, exposure_s: float) -> Floats:
        """The dark mosaic [DN] for an exposure [s]."""
        if self.exposures_s[0] == self.exposures_s[-1]:
            return self.means[0]
        part = (exposure_s - self.exposures_s[0]) / (self.exposures_s[-1] - self.exposures_s[0])
        return np.asarray(self.means[0] + part * (self.means[-1] - self.means[0]))


def scan(
    manual: "ManualRig", axis: str, angles: Sequence[float], *, frames: int = 2, exposure_s: float | None = None,
    progress: Callable[[pd.DataFrame, int], None] = lambda table, total: None,
) -> pd.DataFrame:  # fmt: skip
    """Scan one axis of a rig that is open, the others standing where they are; the lamp is dark before and after.

    Parameters
    ----------
    manual
        Open, with arms, light and camera.
    axis
        As in `ManualRig.move`.
    angles
        Goals [rad], in the order in which they are gone to.
    frames
        At each angle.
    exposure_s
        For all angles; without it every angle is metered, within `LONGEST` exposures of a matt white surface.
    progress
        Hears the table so far, and how many angles there will be.

    Returns
    -------
    DataFrame
        A row an angle: `angle_deg` (the encoder's readback), `asked_deg`, `signal_dn_per_s`, `u_signal_dn_per_s`
        (standard uncertainty: scatter of the frames or the noise of camera and lamp, whichever is more, and the dark
        signal's), `exposure_s`, `frames`, `pixels`, `saturated` (fraction of the patch), `patch` and `flag`.
        `patch` is "sample", or "centre" (of the frame) where the camera does not look down on the sample; `flag` is
        "saturated" or "". `attrs` hold the axis, where the others stood, and the band.

    Raises
    ------
    ConfigError
        An angle is beyond a limit; nothing has moved. An exposure that the camera does not have.
    DeviceError
        A device fails; what was measured so far was told.
    """
    bounded = _checked(manual, axis, angles, frames, exposure_s)
    rows: list[dict[str, object]] = []
    attrs: dict[Hashable | None, object] = {"axis": axis, "rig": bounded.name, "band": manual.band.name}
    try:
        manual.lamp(False)
        manual.move(**{axis: float(angles[0])})
        dark = _darks(manual, bounded)
        manual.lamp(True, wavelength_nm=manual.band.centre_nm)
        expected = exposure.expected_level_per_s(bounded, Pose(), 1.0)
        for angle in angles:
            landed, pose = manual.move(**{axis: float(angle)}).landed[axis], manual.pose()
            if pose is not None:
                others = {n: round(math.degrees(getattr(pose, n)), 3) for n in bounded.axes() if n != axis}
                attrs.setdefault("others_deg", others)
            seen, expected = _seen(manual, bounded, pose, frames, dark, expected)
            rows.append({"angle_deg": math.degrees(landed), "asked_deg": round(math.degrees(angle), 9)} | seen)
            table = pd.DataFrame(rows)
            table["flag"] = np.where(table["saturated"] > 0, "saturated", "")
            table.attrs = attrs
            progress(table, len(angles))
    finally:
        manual.light.off()
    return table


def _seen(
    manual: "ManualRig", bounded: RigDescription, pose: Pose | None, frames: int, dark: _Dark, expected: float
) -> tuple[dict[str, object], float]:  # fmt: skip
    """The signal at a pose, from the level for one second that is expected; and the level to expect next."""
    roi, where = _patch(bounded, pose)
    metered = exposure.meter(bounded, manual.camera.capture, roi.of, expected)
    shots = [manual.camera.capture(metered.exposure_s) for _ in range(frames)]
    next_level = metered.level_per_s if metered.level_per_s > 0 else expected
    return _signal(bounded, shots, roi, dark) | {"patch": where}, next_level


def _checked(
    manual: "ManualRig", axis: str, angles: Sequence[float], frames: int, exposure_s: float | None
) -> RigDescription:  # fmt: skip
    """The rig with the exposures that a scan may have; raises what `scan` raises before anything moves."""
    description = manual.description
    if not len(angles):
        raise ArgumentError("angles: there are none to go to")
    if frames < 1:
        raise ArgumentError(f"frames = {frames}: must be at least 1")
    for angle in angles:
        manual.check({axis: float(angle)})
    if exposure_s is not None:
        description.camera.require_exposure(exposure_s)
    shortest, longest = description.camera.exposure_limits_s
    white = exposure.expected_exposure_s(description, Pose(), 1.0)
    limits = shortest, min(longest, max(LONGEST * white, 2 * shortest))
    if exposure_s is not None:
        limits = exposure_s, exposure_s
    camera = description.camera.model_copy(update={"exposure_limits_s": limits})
    return description.model_copy(update={"camera": camera})


def _darks(manual: "ManualRig", bounded: RigDescription) -> _Dark:
    dark = _Dark([], [])
    for exposure_s in dict.fromkeys(bounded.camera.exposure_limits_s):
        shots = [manual.camera.capture(exposure_s) for _ in range(DARK_FRAMES)]
        dark.exposures_s.append(shots[0].exposure_s)
        dark.means.append(np.mean([shot.mosaic for shot in shots], axis=0))
    return dark


def _patch(description: RigDescription, pose: Pose | None) -> tuple[regions.Roi, str]:
    """The patch of the sample; of the frame's centre, as large as it is seen from above, where there is none."""
    if pose is not None:
        with contextlib.suppress(ConfigError):
            return regions.roi(description, kinematics.view(description, pose)), "sample"
    return regions.roi(description, kinematics.view(description, Pose())), "centre"


def _signal(description: RigDescription, shots: list[Frame], roi: regions.Roi, dark: _Dark) -> dict[str, object]:
    """Signal and its standard uncertainty [DN/s] of a patch, from frames of one exposure."""
    camera = description.camera
    exposure_s, n = shots[0].exposure_s, len(shots)
    lit = np.array([roi.of(shot.mosaic) for shot in shots], float)
    means = (lit - roi.of(dark.of(exposure_s))).mean(axis=1)
    mean = float(means.mean())
    light_e, dark_e = max(mean, 0.0) * camera.electrons_per_dn, camera.dark_current_e_per_s * exposure_s
    pixel_dn, dark_dn = light_and_camera.deviation_dn(camera, [light_e + dark_e, dark_e]).tolist()
    noise = math.hypot(pixel_dn / math.sqrt(roi.count), mean * description.lamp.noise) / math.sqrt(n)
    scatter = float(means.std(ddof=1)) / math.sqrt(n) if n > 1 else 0.0
    u = math.hypot(max(noise, scatter), dark_dn / math.sqrt(DARK_FRAMES * roi.count))
    full = [shot.black_level_dn + exposure.SATURATED * exposure.full_scale_dn(camera, shot) for shot in shots]
    return {
        "signal_dn_per_s": mean / exposure_s,
        "u_signal_dn_per_s": u / exposure_s,
        "exposure_s": exposure_s,
        "frames": n,
        "pixels": roi.count,
        "saturated": float(np.mean(lit >= np.reshape(full, (-1, 1)))),
    }


def plot(table: pd.DataFrame, ax: Axes) -> None:
    """Draw a scan on axes that are given."""
    good = table["flag"] == ""
    for rows, colour, label in ((good, "tab:blue", "standard uncertainty"), (~good, "tab:red", "saturated")):
        if rows.any():
            part = table[rows]
            ax.errorbar(part["angle_deg"], part["signal_dn_per_s"], part["u_signal_dn_per_s"], fmt=".", color=colour,
                        ecolor="0.6", label=label)  # fmt: skip
    others = table.attrs.get("others_deg", {})
    stood = ", ".join(f"{name} {angle:g}" for name, angle in others.items())
    ax.set(
        xlabel=f"{table.attrs['axis']} [deg], as read",
        ylabel="signal of the patch, dark subtracted [DN/s]",
        title=f"{table.attrs['rig']}, {table.attrs['band']}" + (f"; {stood} deg" if stood else ""),
    )
    ax.grid(alpha=0.3)
    ax.legend(fontsize="small")


def write(table: pd.DataFrame, file: Path) -> Path:
    """Write a scan as a CSV, and its plot beside it; the plot's name.

    Raises
    ------
    DataError
        They cannot be written.
    """

    picture = file.with_suffix(".png")
    put(file, table.to_csv(index=False).encode())  # before anything that takes time, or may fail

    def draw() -> Figure:
        from matplotlib.figure import Figure as Canvas

        figure = Canvas(figsize=(7.5, 4.8), layout="constrained")
        plot(table, figure.subplots())
        return figure

    with lost.whole(file):
        try:
            put_picture(picture, draw)
        except DataError as failure:
            raise DataError(f"{failure}; the table itself is whole, in {file}") from None
    return picture
