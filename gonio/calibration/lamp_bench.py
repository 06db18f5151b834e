"""Series and flats of a white, taken on an open rig by hand (`gonio.by_hand.bench`)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from gonio.acquisition import exposure
from gonio.acquisition.schedule import reference_pose
from gonio.calibration import beam
from gonio.errors import ConfigError, DataError, DeviceError
from gonio.geometry import Directions
from gonio.rig import Frame, Pose, Step, imaging, kinematics
from gonio.rig.description import RigDescription
from gonio.typing import Floats

if TYPE_CHECKING:
    import pandas as pd

    from gonio.by_hand.bench import Bench

DARK_FRAMES = 8
BURST = 4
"""Frames that are taken one after the other each time."""
FLAT_FRAMES = 8
MOST_STEPS = 100_000


def take_series(
    bench: Bench,
    duration_s: float,
    every_s: float,
    *,
    told: Callable[[float], None] | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> pd.DataFrame:
    """Frames of the white from the moment that the lamp is lit: a table with the columns of `lamp_stability.COLUMNS`.

    One exposure for all, chosen while the lamp is fresh; `BURST` frames every `every_s` seconds of the rig's clock. The
    lamp is dark afterwards. `monitor` is there where the lamp has one.

    Raises
    ------
    DataError
        A frame saturates, or has a time that is not later than the one before it.
    DeviceError
        A device fails.
    """
    import pandas as pd

    description = bench.description
    pose = reference_pose(description)
    expected = exposure.expected_level_per_s(description, pose, 1.0)
    if description.reference.how == "beam":
        expected = exposure.expected_straight_level_per_s(description)
    steps = _Steps(bench)
    rows: list[dict[str, float]] = []
    raw: list[tuple[Frame, float | None]] = []
    try:
        bench.lamp(False)
        steps.next(pose)
        bench.present("reference")
        region = imaging.roi(description, kinematics.view(description, pose), "reference", bench.band.channel)
        bench.lamp(True, wavelength_nm=bench.band.centre_nm)
        lit_s = bench.time_s()
        metered = exposure.meter(description, bench.camera.capture, region.of, expected)
        if metered.saturated:
            raise DataError("the white saturates at the shortest exposure: dim the lamp, or close the lens's aperture")
        kept: list[Floats] = []
        due = 0.0
        while due <= duration_s:
            now = bench.time_s() - lit_s
            if now < due and not bench.repeatable:
                sleep(due - now)
            elif now < due:
                steps.next(pose)  # a simulated clock goes on with the steps
                continue
            for _ in range(BURST):
                frame = bench.camera.capture(metered.exposure_s)
                imaging.require_frame(description.camera, frame, "the camera")
                raw.append((frame, _monitor(bench)))
                kept.append(np.asarray(region.of(frame.mosaic), float))
            due = max(due + every_s, bench.time_s() - lit_s)
            if told is not None:
                told(min(due, duration_s))
        bench.lamp(False)
        darks = [
            np.asarray(region.of(bench.camera.capture(metered.exposure_s).mosaic), float) for _ in range(DARK_FRAMES)
        ]
    finally:
        bench.light.off()
    dark = np.mean(darks, axis=0)
    camera = description.camera
    for (frame, monitor), pixels in zip(raw, kept, strict=True):
        _require(description, frame, pixels)
        time_s = float(frame.time_s) - lit_s
        if rows and time_s <= rows[-1]["time_s"]:
            raise DataError(
                f"a frame is stamped {time_s:g} s, and the one before it {rows[-1]['time_s']:g} s: times must grow"
            )
        signal = float(np.mean(pixels - dark))
        u = float(_noise(description, max(signal, 0.0), frame.exposure_s)) / math.sqrt(region.count)
        row: dict[str, float] = {
            "time_s": max(time_s, 0.0),
            "signal_dn_per_s": signal / frame.exposure_s,
            "u_shot_dn_per_s": u / frame.exposure_s,
            "exposure_s": frame.exposure_s,
        }
        rows.append(row | ({} if monitor is None else {"monitor": monitor}))
    table = pd.DataFrame(rows)
    table.attrs["electrons_per_dn"] = camera.electrons_per_dn
    return table


def take_flats(bench: Bench, *, told: Callable[[int, int], None] | None = None) -> pd.DataFrame:
    """Flats of the white at several camera angles: a table with the columns of `beam.COLUMNS`.

    The lamp has to be warm: what it changes from flat to flat does not matter, what it changes in shape does.

    Raises
    ------
    ConfigError
        The rig reaches fewer than four of the angles.
    DataError
        A flat saturates.
    """
    import pandas as pd

    description = bench.description
    if description.reference.how == "beam":
        raise ConfigError(
            'reference.how = "beam": there is no white to see the beam on; calibrate its profile with a rig file that '
            "has a white, or take --only lamp"
        )
    poses = _poses(description)
    steps = _Steps(bench)
    tables = []
    try:
        bench.lamp(False)
        steps.next(poses[0])
        bench.present("reference")
        for number, pose in enumerate(poses, 1):
            landed = steps.next(pose)
            bench.lamp(True, wavelength_nm=bench.band.centre_nm)
            region = imaging.roi(description, kinematics.view(description, landed), "reference", bench.band.channel)
            level = exposure.expected_level_per_s(description, pose, 1.0)
            metered = exposure.meter(description, bench.camera.capture, region.of, level)
            shots = [bench.camera.capture(metered.exposure_s) for _ in range(FLAT_FRAMES)]
            bench.lamp(False)
            darks = [bench.camera.capture(metered.exposure_s) for _ in range(DARK_FRAMES)]
            for shot in shots:
                _require(description, shot, np.asarray(region.of(shot.mosaic), float))
            dark = np.mean([np.asarray(d.mosaic, float) for d in darks], axis=0)
            mean = np.mean([np.asarray(s.mosaic, float) for s in shots], axis=0) - dark
            t = shots[0].exposure_s
            noise = _noise(description, np.maximum(mean, 0.0), t) / math.sqrt(FLAT_FRAMES)
            noise = np.hypot(noise, _noise(description, np.zeros_like(mean), t) / math.sqrt(DARK_FRAMES))
            tables.append(beam.blocks(description, landed, mean / t, noise / t, number))
            if told is not None:
                told(number, len(poses))
    finally:
        bench.light.off()
    return pd.concat(tables, ignore_index=True)


def _poses(description: RigDescription) -> list[Pose]:
    out = []
    for light, camera in beam.camera_angles(description):
        phi = math.pi if camera >= 0 else 0.0
        try:
            out.append(
                kinematics.reach(description, Directions(math.radians(light), 0.0, math.radians(abs(camera)), phi))
            )
        except kinematics.Unreachable:
            continue
    if len(out) < 4:
        raise ConfigError(
            f'rig "{description.name}": reaches {len(out)} of the camera angles that a beam\'s profile needs; flats at '
            "four or more, some near the normal and some beyond 45 deg, tell it from the lens"
        )
    return out


class _Steps:
    """Steps of a series: a simulated rig sets its clock and its random numbers by them."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self._number = bench, 0

    def next(self, pose: Pose) -> Pose:
        """Begin another step at a pose; where the axes stand then."""
        if self._number >= MOST_STEPS:
            raise DeviceError("the rig's clock does not go on: see its driver's time_s()")
        self._bench.begin(Step(self._number, "reference", pose=pose))
        self._number += 1
        names = self._bench.description.axes()
        self._bench.move(**{name: getattr(pose, name) for name in names})
        return self._bench.arms.read()


def _monitor(bench: Bench) -> float | None:
    read = getattr(bench.light, "monitor", lambda: None)()
    return None if read is None else float(read)


def _require(description: RigDescription, frame: Frame, pixels: Floats) -> None:
    if not 0.0 < frame.exposure_s < math.inf:
        raise DataError(
            f"a frame says its exposure was {frame.exposure_s!r} s: without it nothing is known of the lamp"
        )
    if not math.isfinite(frame.time_s):
        raise DataError("a frame has no time: without it nothing is known of a drift")
    full = exposure.full_scale_dn(description.camera, frame)
    if float(pixels.max()) - frame.black_level_dn >= exposure.SATURATED * full:
        raise DataError(
            f"a frame of {frame.exposure_s:g} s saturates: the lamp grew too bright for the exposure that it was given "
            "when it was lit; set a lower acquisition.exposure_target in the rig file"
        )


def _noise(description: RigDescription, signal_dn: Floats | float, exposure_s: float) -> Floats:
    """Standard deviation of a pixel [DN] from the camera alone."""
    camera = description.camera
    electrons = np.asarray(signal_dn) * camera.electrons_per_dn + camera.dark_current_e_per_s * exposure_s
    shot = electrons if camera.photon_noise else 0.0 * electrons
    rounding = 1.0 / 12.0
    return np.sqrt((shot + camera.read_noise_e**2) / camera.electrons_per_dn**2 + rounding)
