"""What a rig is asked for to calibrate its camera: dark frames, flats of the white reference, a trap, a knife edge.

Also here is a quick look at a camera before something else is calibrated with it, at gain, black level and clipping.

Pairs of frames of whatever is lit, at ten exposures, make a photon transfer of some per cent. That is enough to tell a
rig file of another camera, or of another setting of its gain. `gonio calibrate camera` measures.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Literal

import numpy as np

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError, DataError, DeviceError
from gonio.lab.acquisition import exposure
from gonio.lab.by_hand.alignment_scans import LONGEST_S
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import photon_transfer
from gonio.lab.calibration.camera import black_rectangle
from gonio.lab.calibration.camera_frames import CONTRADICTS, CameraFrame, Kind, write_list
from gonio.lab.rig import Frame, Pose, dng, kinematics
from gonio.lab.rig.calibration_files import covariance_of
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.regions import require_raw
from gonio.typing import Bools, Floats

Put = Literal["reference", "trap", "edge", "sample"]

DARK_FRAMES = 8
"""Dark frames at each of four exposures."""
LOW = np.linspace(0.03, 0.7, 14)
HIGH = np.linspace(0.75, 1.15, 9)
"""Levels of the flats, as fractions of full scale: the gain's range, and around saturation."""
BRACKET = np.geomspace(0.01, 6.0, 18)
"""Exposures of a response curve, over the one that meters well."""
ROUNDED = 0.3
"""What a video camera, which counts exposures coarsely, may make of one that was asked for; its frames say which."""
STRAY_FRAMES = 8
FIELD_FRAMES = 4
FIELD_DEG = (15.0, 40.0, 65.0)
"""Directions that the white reference is seen from, for the lens's vignetting."""
BRIGHTEST = 99.5
"""Percentile of a frame's pixels that its exposure is chosen by: hot pixels do not count."""
INSIDE = 0.6
"""Half the side of the square that is taken for black, over the radius of what lies in the holder."""
EDGE_MM = 0.5
"""Pixels that see the screen closer to its edge than this do not count: the lens blurs the edge."""


def _uncounted(what: str) -> AbstractContextManager[Callable[[int, int], None]]:
    return nullcontext(lambda done, total: None)


class CameraScan:
    """Takes the frames, one kind after the other, and keeps each in a folder as it comes."""

    def __init__(
        self,
        manual: ManualRig,
        folder: Path,
        *,
        pairs: int = 2,
        say: Callable[[str], None] = print,
        counter: Callable[[str], AbstractContextManager[Callable[[int, int], None]]] = _uncounted,
    ) -> None:
        self._manual, self._folder, self._pairs, self._say, self._counter = manual, folder, pairs, say, counter
        self.frames: list[CameraFrame] = []

    def go(self) -> None:
        """Drive to where the white reference is looked at."""
        reference = self._manual.description.reference
        self._manual.move(theta_i=math.radians(reference.theta_i_deg), theta_r=math.radians(reference.theta_r_deg))

    def darks(self) -> None:
        """With the lamp dark, from the shortest to the longest exposure that is used."""
        self._manual.lamp(False)
        short, longest = exposure.dark_exposures_s(self._manual.description)
        times = [short, longest / 4, longest / 2, longest]
        self._say(f"dark frames: {DARK_FRAMES} at each of {len(times)} exposures up to {longest:g} s")
        self._take_all("dark", times * DARK_FRAMES)  # a camera that grows warm is as warm at every exposure

    def flats(self) -> None:
        """Pairs over the white reference from dark to full, in an order in which no drift looks like a level."""
        self._manual.lamp(True)
        times = self._times(np.concatenate([LOW, HIGH]) / self._meter("flat").level_per_s)
        shuffled = [float(t) for t in np.random.default_rng(0).permutation(np.repeat(times, self._pairs))]
        self._say(f"flats: {len(shuffled)} pairs at {len(times)} exposures from {times[0]:.3g} to {times[-1]:.3g} s")
        self._take_all("flat", [t for t in shuffled for _ in range(2)])
        self._manual.lamp(False)

    def bracket(self) -> None:
        """Four frames of the white reference at each of many exposures from dark to full, for a response curve."""
        self._manual.lamp(True)
        times = self._times(BRACKET * self._meter("flat").exposure_s)
        self._say(f"bracket: 4 frames at each of {len(times)} exposures from {times[0]:.3g} to {times[-1]:.3g} s")
        self._take_all("flat", [float(t) for t in (*times, *times[::-1]) * 2])  # there and back: the lamp drifts
        self._manual.lamp(False)

    def stray(self, kind: Literal["trap", "edge"]) -> None:
        """Frames of a trap in the holder, or of a knife edge before the white reference."""
        self._manual.lamp(True)
        black = self._black(kind)
        t = float(self._times(np.array([self._meter(kind).exposure_s]))[0])
        self._say(f"{kind}: {STRAY_FRAMES} frames of {t:.3g} s")
        self._take_all(kind, [t] * STRAY_FRAMES, black)
        self._manual.lamp(False)

    def field(self) -> None:
        """The white reference from several directions: what stays with the pixels is the lens."""
        self._manual.lamp(True)
        first = math.radians(self._manual.description.reference.theta_i_deg)
        for angle in FIELD_DEG:
            try:
                self._manual.move(theta_i=first, theta_r=math.radians(angle))
            except ConfigError:
                continue  # the rig cannot reach this pose
            t = float(self._times(np.array([self._meter("field").exposure_s]))[0])
            self._say(f"field: {FIELD_FRAMES} frames at theta_r = {angle:g} deg")
            pose = self._manual.arms.read()
            for _ in range(FIELD_FRAMES):
                self._take("field", t, pose=pose)
        self._manual.lamp(False)

    def _times(self, wanted: Floats) -> Floats:
        shortest, longest = self._manual.description.camera.exposure_limits_s
        return np.unique(np.clip(np.round(wanted, exposure.MICROSECONDS), shortest, longest))

    def _meter(self, kind: Kind) -> exposure.Metered:
        description, pose = self._manual.description, self._manual.pose() or Pose()
        expected = exposure.expected_level_per_s(description, pose, 1.0 if kind != "trap" else 0.03)
        # a level is that of the brightest used pixel: the used "pixel" is a percentile of all
        return exposure.meter(description, self._shot, lambda mosaic: np.percentile(mosaic, [BRIGHTEST]), expected)

    def _shot(self, exposure_s: float) -> Frame:
        camera = self._manual.description.camera
        frame = self._manual.camera.capture(exposure_s)
        require_raw(camera, frame, str(frame.file or "the camera"))
        within = ROUNDED if camera.response else CONTRADICTS
        if not frame.exposure_s > 0 or abs(frame.exposure_s / exposure_s - 1.0) > within:
            raise DeviceError(
                f"the camera was asked for {exposure_s:g} s, and its frame says {frame.exposure_s:g} s: a calibration "
                "needs exposures that are what they say"
            )
        return frame

    def _take_all(self, kind: Kind, times: list[float], black: tuple[slice, slice] | None = None) -> None:
        """One frame after the other; whoever watches is told."""
        with self._counter(f"{kind} frames") as told:
            for done, t in enumerate(times, 1):
                self._take(kind, t, black)
                told(done, len(times))

    def _take(
        self, kind: Kind, exposure_s: float, black: tuple[slice, slice] | None = None, pose: Pose | None = None
    ) -> None:
        frame = self._shot(exposure_s)
        number = len(self.frames)
        if frame.file is not None:
            path = self._folder / f"{kind}-{number:04d}{frame.file.suffix.lower()}"
            write_whole(path, read_file(frame.file))
        else:
            path = self._folder / f"{kind}-{number:04d}.dng"
            dng.write_dng(frame, path)
        self.frames.append(CameraFrame(path, kind, frame.exposure_s, frame.time_s, black=black, pose=pose))

    def keep(self) -> None:
        """Write the list of what was taken."""
        write_list(self._folder, self.frames)

    def _black(self, kind: Literal["trap", "edge"]) -> tuple[slice, slice]:
        """The pixels that see the trap, or the screen well behind its edge at x = 0."""
        description = self._manual.description
        diameter = description.reference.diameter_mm if kind == "edge" else description.holder.sample_diameter_mm
        half = 0.5 * INSIDE * diameter
        seen = pixel_map(description, kinematics.view(description, self._manual.arms.read()))
        inside = (np.abs(seen.x_mm) <= half) & (np.abs(seen.y_mm) <= half)
        if kind == "edge":
            inside &= seen.x_mm >= EDGE_MM
        found = black_rectangle(inside)
        if found is None:
            raise DeviceError(f"the camera does not see the {kind} from here: does it look at the holder?")
        return found


LIGHT_DEG, CAMERA_DEG = 30.0, 0.0
"""Where a mirror in the holder shows no lamp, and the holder around it is lit."""
LEVEL = 0.7
EXPOSURES = 10
LEAST_DN = 100.0
"""Least level of the brightest hundredth over black, below which nothing is concluded."""
PART = 0.2
"""Part of the brightness of the brightest hundredth: pixels that are darker say little of the gain."""
NONLINEAR = 0.03
"""Relative: what a departure from linearity, which nobody has taken out yet, does to a gain."""
BLACK_DN = 2.0
DOUBT = 3.0
"""Standard uncertainties."""


def contradictions(manual: ManualRig) -> str:
    """What the frames of a rig say against its rig file's camera; "" where they say nothing.

    The rig is open, and a mirror lies in its holder. The lamp is lit afterwards.
    """
    description, camera = manual.description, manual.description.camera
    if not camera.photon_noise or camera.response:
        return ""
    shortest, longest = camera.exposure_limits_s
    limits = manual.description.limits_deg()
    goals = {"light": LIGHT_DEG, "camera": CAMERA_DEG}
    manual.move(**{n: math.radians(float(np.clip(a, *limits[n]))) for n, a in goals.items()})
    manual.lamp(True)
    t = min(max(LONGEST_S, shortest), longest)
    frame = manual.camera.capture(t)
    while (level := _level(camera, frame)) > LEVEL and t > shortest:
        t = max(round(t * min(LEVEL / level, 0.9) if level < exposure.SATURATED else t / 4.0, 6), shortest)
        frame = manual.camera.capture(t)
    full = exposure.full_scale_dn(camera, frame)
    bright = np.asarray(frame.mosaic, float) - frame.black_level_dn
    if level * full < LEAST_DN or level >= exposure.SATURATED:
        return ""
    region = (bright > PART * level * full) & (bright < 0.9 * full)
    times = [max(round(t * (k + 1) / EXPOSURES, 6), shortest) for k in range(EXPOSURES)]
    lit = [(s, _values(manual.camera.capture(s), region), _values(manual.camera.capture(s), region)) for s in times]
    over = manual.camera.capture(round(min(4.0 * t, longest), 6))
    clips = exposure.clipped_dn(camera, over)
    manual.lamp(False)
    dark = [(s, _values(manual.camera.capture(s), region), _values(manual.camera.capture(s), region))
            for s in (shortest, shortest, t, t)]  # fmt: skip
    manual.lamp(True)
    said = []
    levels = [float(np.mean([a.mean(), b.mean()])) for _, a, b in dark]
    black = 0.5 * (levels[0] + levels[1])
    slope = (0.5 * (levels[2] + levels[3]) - black) / (t - shortest) if t > shortest else 0.0
    if abs(black - camera.black_level_dn) > BLACK_DN:
        said.append(f"dark frames read {black:.1f} DN (camera.black_level_dn = {camera.black_level_dn:g})")
    try:
        found = photon_transfer.photon_transfer(
            [photon_transfer.pair(*_alike(a, b, black), s) for s, a, b in lit],
            [photon_transfer.pair(a, b, s) for s, a, b in dark],
            (black, slope), camera.model_copy(update={"nonlinearity": ()}),
        )  # fmt: skip
    except DataError:
        found = None
    if found is not None:
        gain, stated = found.electrons_per_dn, camera.electrons_per_dn
        known = float(covariance_of(description, ["camera.electrons_per_dn"])[0, 0])
        u = math.sqrt(found.u_electrons_per_dn**2 + known)
        if abs(gain - stated) > math.hypot(DOUBT * u, NONLINEAR * gain):
            said.append(f"a DN is {gain:.3g} electrons, u = {u:.2g} (camera.electrons_per_dn = {stated:g})")
    expected = min(over.white_level_dn, over.black_level_dn + camera.full_well_e / camera.electrons_per_dn)
    if clips < exposure.SATURATED * expected:
        said.append(f"charge clips at {clips:.0f} DN (where the rig file leads to expect {expected:.0f})")
    if not said:
        return ""
    return (
        f"a quick look at the camera contradicts the rig file: {'; '.join(said)}. Zeros do not rest on it, and what is "
        "reduced does: `gonio calibrate camera` next, and name its file in the rig file"
    )


def _level(camera: Camera, frame: Frame) -> float:
    bright = float(np.percentile(frame.mosaic, 99.0)) - frame.black_level_dn
    return bright / exposure.full_scale_dn(camera, frame)


def _values(frame: Frame, region: Bools) -> Floats:
    return np.asarray(frame.mosaic[region], float)


def _alike(a: Floats, b: Floats, black: float) -> tuple[Floats, Floats]:
    """Two frames with what the lamp's level changed between them taken out."""
    first, second = float(a.mean()) - black, float(b.mean()) - black
    middle = 0.5 * (first + second)
    return black + (a - black) * (middle / first), black + (b - black) * (middle / second)
