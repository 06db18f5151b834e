"""Series and flats of a white, taken on an open rig by hand (`gonio.lab.by_hand.manual_rig`)."""

import math
from collections.abc import Callable

import numpy as np

from gonio.errors import ConfigError, DataError, DeviceError
from gonio.geometry import Directions
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.acquisition.waits import wait
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import beam
from gonio.lab.calibration.lamp_stability import COLUMNS
from gonio.lab.reduction import stray_light
from gonio.lab.rig import Frame, Pose, Step, imaging, inverse_kinematics, kinematics, regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import deviation_dn, linear_dn, straightened
from gonio.lab.rig.protocols import Monitors
from gonio.typing import Array, DataFrame, Floats

DARK_FRAMES = 8
BURST = 4
"""Frames that are taken one after the other each time."""
FLAT_FRAMES = 8
MOST_STEPS = 100_000


def _metered(manual: ManualRig, region: regions.Roi, pose: Pose) -> exposure.Metered:
    """The exposure for the white."""
    description = manual.description
    expected = exposure.expected_level_per_s(description, pose, 1.0)
    if description.reference.how == "beam":
        expected = exposure.expected_straight_level_per_s(description)
    metered = exposure.meter(description, manual.camera.capture, region.of, expected)
    if metered.saturated:
        raise DataError("the white saturates at the shortest exposure: dim the lamp, or close the lens's aperture")
    return metered


def take_series(
    manual: ManualRig,
    duration_s: float,
    every_s: float,
    *,
    keep: Callable[[DataFrame], None],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Frames of the white from the moment that the lamp is lit.

    One exposure for all, chosen while the lamp is fresh; `BURST` frames every `every_s` seconds of the rig's clock. The
    lamp is dark afterwards.

    Parameters
    ----------
    manual
        Open.
    duration_s, every_s
        How long, and how often [s].
    keep
        Gets the table, with the columns of `lamp_stability.COLUMNS` and with `monitor` where the lamp has one; whatever
        ends the series early, it gets what there is. (Then the camera's black level takes the place of dark frames.)
    progress
        Called with the seconds that are done, and with how many there are.

    Raises
    ------
    DataError
        A frame saturates, has no exposure, or a time that is not later than the one before it.
    DeviceError
        A device fails.
    """
    pose = reference_pose(description := manual.description)
    steps, taken, dark = _Steps(manual), _Series(description), math.nan
    try:
        manual.lamp(False)
        steps.next(pose)
        manual.present("reference")
        region = regions.roi(description, kinematics.view(description, pose), "reference", manual.band.channel)
        lit_s = 0.0 if manual.repeatable else manual.time_s()  # a simulated clock counts from when the lamp is lit
        manual.lamp(True, wavelength_nm=manual.band.centre_nm)
        metered = _metered(manual, region, pose)
        due = 0.0
        while due <= duration_s:
            now = manual.time_s() - lit_s
            if now < due and manual.repeatable:
                steps.next(pose)  # a simulated clock goes on with the steps
                continue
            wait(manual, max(due - now, 0.0))
            for _ in range(BURST):
                taken.add(manual.camera.capture(metered.exposure_s), region, lit_s, _monitor(manual))
            due = max(due + every_s, manual.time_s() - lit_s)
            progress(round(min(due, duration_s)), round(duration_s))
        manual.lamp(False)
        darks = (manual.camera.capture(metered.exposure_s) for _ in range(DARK_FRAMES))
        dark = float(np.mean([_linear(description, frame, region.of(frame.mosaic)) for frame in darks]))
    finally:
        manual.light.off()
        if taken.rows:
            keep(taken.table(dark if math.isfinite(dark) else taken.black_level_dn))


class _Series:
    """Frames as they come, each checked and reduced to what a series needs of it."""

    def __init__(self, description: RigDescription) -> None:
        self._description = description
        self.rows: list[dict[str, float]] = []
        self.black_level_dn = 0.0
        self._pixels = 1

    def add(self, frame: Frame, region: regions.Roi, lit_s: float, monitor: float | None) -> None:
        """One more frame; raises `DataError` where it cannot be used."""
        regions.require_frame(self._description.camera, frame, "the camera")
        _require(self._description, frame, np.asarray(region.of(frame.mosaic), float))
        time_s = float(frame.time_s) - lit_s
        if self.rows and time_s <= self.rows[-1]["time_s"]:
            raise DataError(
                f"a frame is stamped {time_s:g} s after the lamp was lit, and the one before it "
                f"{self.rows[-1]['time_s']:g} s: times must grow"
            )
        self.black_level_dn, self._pixels = frame.black_level_dn, region.count
        mean = float(_linear(self._description, frame, region.of(frame.mosaic)).mean())
        row = {"time_s": max(time_s, 0.0), "mean_dn": mean, "exposure_s": frame.exposure_s}
        self.rows.append(row | ({} if monitor is None else {"monitor": monitor}))

    def table(self, dark_dn: float) -> DataFrame:
        """With the columns of `lamp_stability.COLUMNS`."""
        import pandas as pd

        out = pd.DataFrame(self.rows)
        signal, exposure_s = out["mean_dn"] - dark_dn, out["exposure_s"]
        noise = [float(_noise(self._description, max(dn, 0.0), t)) for dn, t in zip(signal, exposure_s, strict=True)]
        out["signal_dn_per_s"] = signal / exposure_s
        out["u_shot_dn_per_s"] = np.array(noise) / math.sqrt(self._pixels) / exposure_s
        return out[[*COLUMNS, *(["monitor"] if "monitor" in out else [])]]


def take_flats(
    manual: ManualRig,
    *,
    keep: Callable[[DataFrame], None],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Flats of the white at several camera angles.

    `keep` gets a table with the columns of `beam.COLUMNS`, whatever ends the flats early; `told` how many flats are
    taken, and of how many. The lamp has to be warm: what it changes from flat to flat does not matter, what it changes
    in shape does. The camera's nonlinearity and stray light are taken out, as far as the rig file knows them.

    Raises
    ------
    ConfigError
        The rig reaches fewer than four of the angles.
    DataError
        A flat saturates.
    """
    import pandas as pd

    description = manual.description
    if description.reference.how == "beam":
        raise ConfigError(
            'reference.how = "beam": there is no white to see the beam on; calibrate its profile with a rig file that '
            "has a white, or take --only lamp"
        )
    poses = _poses(description)
    steps = _Steps(manual)
    tables = []
    try:
        manual.lamp(False)
        steps.next(poses[0])
        manual.present("reference")
        for number, pose in enumerate(poses, 1):
            landed = steps.next(pose)
            manual.lamp(True, wavelength_nm=manual.band.centre_nm)
            region = regions.roi(description, kinematics.view(description, landed), "reference", manual.band.channel)
            level = exposure.expected_level_per_s(description, pose, 1.0)
            metered = exposure.meter(description, manual.camera.capture, region.of, level)
            shots = [manual.camera.capture(metered.exposure_s) for _ in range(FLAT_FRAMES)]
            manual.lamp(False)
            darks = [manual.camera.capture(metered.exposure_s) for _ in range(DARK_FRAMES)]
            for shot in shots:
                _require(description, shot, np.asarray(region.of(shot.mosaic), float))
            dark, lit = (np.mean([_linear(description, f, f.mosaic) for f in some], axis=0) for some in (darks, shots))
            mean = _without_stray_light(description, lit - dark, manual.band.channel)
            t = shots[0].exposure_s
            noise = _noise(description, np.maximum(mean, 0.0), t) / math.sqrt(FLAT_FRAMES)
            noise = np.hypot(noise, _noise(description, np.zeros_like(mean), t) / math.sqrt(DARK_FRAMES))
            tables.append(beam.blocks(description, landed, mean / t, noise / t, number))
            progress(number, len(poses))
    finally:
        manual.light.off()
        if tables:
            keep(pd.concat(tables, ignore_index=True))


def _poses(description: RigDescription) -> list[Pose]:
    out = []
    for light, camera in beam.camera_angles(description):
        phi = 0.0 if camera >= 0 else math.pi  # the light's side, where both count from the normal
        try:
            out.append(
                inverse_kinematics.reach(
                    description, Directions(math.radians(light), 0.0, math.radians(abs(camera)), phi)
                )
            )
        except inverse_kinematics.Unreachable:
            continue
    if len(out) < 4:
        raise ConfigError(
            f'rig "{description.name}": reaches {len(out)} of the camera angles that a beam\'s profile needs; flats at '
            "four or more, some near the normal and some beyond 45 deg, tell it from the lens"
        )
    return out


class _Steps:
    """Steps of a series: a simulated rig sets its clock and its random numbers by them."""

    def __init__(self, manual: ManualRig) -> None:
        self._manual, self._number = manual, 0

    def next(self, pose: Pose) -> Pose:
        """Begin another step at a pose; where the axes stand then."""
        if self._number >= MOST_STEPS:
            raise DeviceError("the rig's clock does not go on: see its driver's time_s()")
        self._manual.begin(Step(self._number, "reference", pose=pose))
        self._number += 1
        self._manual.move(**{name: getattr(pose, name) for name in self._manual.description.axes()})
        return self._manual.arms.read()


def _monitor(manual: ManualRig) -> float | None:
    read = manual.light.monitor() if isinstance(manual.light, Monitors) else None
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


def _linear(description: RigDescription, frame: Frame, values: Array) -> Floats:
    """What pixels read [DN], with the camera's response curve and nonlinearity taken out."""
    camera = description.camera
    above = np.asarray(linear_dn(camera, values), float) - frame.black_level_dn
    return straightened(camera, above) + frame.black_level_dn


def _without_stray_light(description: RigDescription, signal: Floats, channel: imaging.Channel) -> Floats:
    """A frame's signal [DN] without the light that lens and sensor spread, as the rig file tells it."""
    camera = description.camera
    rows, cols = np.indices(signal.shape)
    added, _ = stray_light.spread(camera, signal, 0.0, channel).at(rows.ravel(), cols.ravel())
    return np.asarray(signal - added.reshape(signal.shape))


def _noise(description: RigDescription, signal_dn: Floats | float, exposure_s: float) -> Floats:
    """Standard deviation of a pixel [DN] from the camera alone."""
    camera = description.camera
    dark = camera.dark_current_e_per_s * exposure_s
    return deviation_dn(camera, np.asarray(signal_dn) * camera.electrons_per_dn + dark)
