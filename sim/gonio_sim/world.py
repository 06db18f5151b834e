"""The truth of a simulated measurement: where the axes really are, the lamp, the sample, the clock, the random numbers.

The simulated devices change and read this one object; nothing that runs a measurement or reduces it may. Random numbers
and the clock are functions of (seed, step, frame within the step) and of nothing that happened before the step: a step
gives the same frames whenever it is run.
"""

import math
import tomllib
from enum import IntEnum
from importlib.resources import files
from pathlib import Path
from typing import Literal

import numpy as np

from gonio.config import read_toml
from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Pose, Target
from gonio.lab.rig.calibration_files import uncalibrated, with_keys
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polarisers import SIDES, Side
from gonio.samples.description import SampleDescription
from gonio_sim.polarised import NO_ERRORS, OUT

InHolder = Target | Literal["mirror", "empty", "trap", "edge"]
"""What may lie in the beam: beside what a measurement needs, what an alignment does, and a calibration of the camera: a
black trap, and a knife edge before the white reference, which covers x > 0."""

FRAMES_S = 10.0
"""What a step is given for its frames, beyond the longest move [s]."""
LAST_S = 1e-3
"""The end of a step's time, which is left to the frames of a step that is too long [s]."""
SETTLE_S = 0.2
"""Time from the end of a move until the arms stand still [s]."""


class Stream(IntEnum):
    """What a random number is for; the first part of its address."""

    ZERO = 1
    REFERENCE = 2
    LAMP = 3
    LANDING = 4
    SENSOR = 5
    PRNU = 6
    DSNU = 7
    MONITOR = 8
    HOT = 9
    WANDER = 10
    POLARISER = 11
    COSMIC = 20


class World:
    """Everything that is true of the simulated rig, and known to nobody who measures there.

    Parameters
    ----------
    description
        The rig; the world suffers what it names. With `truth` in it, it suffers what that file says instead, and
        nothing is drawn from stated uncertainties. A calibration changes what is known, and not what is true.
    sample
        What lies in the holder; None for a rig without a sample, where only the reference can be looked at.
    seed
        At least 0. The remaining errors of the zeros and of the reference, the pixels' differences and every noise
        follow from it.

    Raises
    ------
    ConfigError
        The seed is negative.
    """

    def __init__(self, description: RigDescription, sample: SampleDescription | None, seed: int) -> None:
        if seed < 0:
            raise ConfigError(f"seed = {seed}: it must be 0 or more")
        self.description = description
        """What who measures knows."""
        self.truth = truth_of(description)
        """The same keys, with what is true."""
        self.optics = with_exact_encoders(self.truth)
        """What is true, for `pose`: it says where the axes are, and not what encoders read."""
        if len(self.truth.bands.all()) != len(description.bands.all()):
            raise ConfigError(
                f"{description.truth or 'truth'}: [bands] has {len(self.truth.bands.all())} bands, and the rig file "
                f"{len(description.bands.all())}: the truth says of each band what it truly is, and needs as many"
            )
        self.sample = sample
        self.seed = seed
        self.open = False
        self.lamp_on = False
        self.brightness = 1.0
        """Brightness of the lamp, relative to the level that the rig file means."""
        self.last_level = 1.0
        """Level of the lamp during the last frame."""
        self.ambient_e_per_s = 0.0
        """Photo-electrons a second that light in the room adds to every pixel."""
        self.band: Band | None = None
        self.target: InHolder = "sample"
        self.pose = Pose()
        """True positions of the axes [rad]."""
        self.touched: list[tuple[str, str]] = []
        """Bodies of the rig file that have met on a way, two by two."""
        drawing = 1.0 if description.truth is None else 0.0
        self.zero_error = {
            name: drawing * np.radians(axis.zero_u_deg) * self.normal(Stream.ZERO, number)
            for number, (name, axis) in enumerate(self.truth.axes().items())
        }
        """What the calibration of each zero missed [rad]: the true position is the calibrated one minus this."""
        reference = self.truth.reference
        drawn = drawing * self.normal(Stream.REFERENCE) if reference.error == "drawn" else 0.0
        self.reference_scale = reference.scale * (1.0 + reference.u_rel * drawn)
        """True reflectance of the white reference over the certified one."""
        self.polarisers: dict[Side, tuple[str, float]] = dict(OUT)
        """How those before lamp and camera stand: state, and azimuth [rad] that the axis was turned to."""
        self.polariser_errors = {side: self._drawn_of_polariser(number, drawing) for number, side in enumerate(SIDES)}
        self.step = 0
        self.frame = 0
        self._elapsed_s = 0.0
        self.watch_s = 0.0
        """What a watch beside the rig shows [s]: moves, frames and waits one after the other, of all steps."""
        self._slot_s = slot_s(self.truth)

    def _drawn_of_polariser(self, number: int, drawing: float) -> tuple[float, float, float, float]:
        """What nobody knows of a polariser; see `gonio_sim.polarised.ends`."""
        mount = self.truth.polarisers.on(SIDES[number])
        if mount is None:
            return NO_ERRORS
        azimuth, uneven = math.radians(mount.u_azimuth_deg), mount.u_transmittance
        sizes = enumerate((mount.u_extinction, azimuth, uneven, uneven))
        a, b, c, d = (drawing * u * self.normal(Stream.POLARISER, number, which) if u else 0.0 for which, u in sizes)
        return a, b, c, d

    def begin(self, step: int) -> None:
        """Set the clock and the random numbers to the start of a step."""
        self.step, self.frame, self._elapsed_s = step, 0, 0.0

    def now_s(self) -> float:
        """Seconds since the lamp was lit for the run.

        Step n starts at n times `slot_s`, and time goes on with every move and frame, but never into the next step: in
        a step that is longer than its slot the clock, and with it the lamp's drift, waits at the end of the slot.
        """
        return self.description.lamp.warm_up_s + self.step * self._slot_s + min(self._elapsed_s, self._slot_s)

    def frame_time_s(self) -> float:
        """What a frame is stamped with [s]: `now_s`, except that no two frames have one time.

        In a step that is longer than its slot the stamps go on ever more slowly, through the slot's last millisecond.
        """
        beyond = self._elapsed_s - self._slot_s + LAST_S
        if beyond <= 0.0:
            return self.now_s()
        end = self.description.lamp.warm_up_s + (self.step + 1) * self._slot_s
        return end - LAST_S / (1.0 + math.log1p(beyond / LAST_S))

    def spend(self, seconds: float) -> None:
        """Let time pass."""
        self._elapsed_s += seconds
        self.watch_s += seconds

    def lamp_level(self) -> float:
        """The lamp's output during the present frame, relative to its mean when the run began."""
        lamp = self.truth.lamp
        now = self.now_s()
        drift = 1.0 + lamp.drift_per_hour * now / 3600.0 + self._wander(now)
        if lamp.warm_up_loss:
            drift -= lamp.warm_up_loss * self.cold()
        noise = lamp.noise * self.normal(Stream.LAMP, self.step, self.frame) if lamp.noise else 0.0
        return max(0.0, drift * (1.0 + noise)) * self.brightness

    def cold(self) -> float:
        """How much of its warm-up the lamp has before it: 1 where it is lit after a long time in the dark."""
        return math.exp(-self.now_s() / self.truth.lamp.warm_up_time_constant_s)

    def _wander(self, now_s: float) -> float:
        """How far the lamp has walked: Brownian motion by Lévy's midpoints, alike whatever was asked before."""
        if not self.truth.lamp.wander_per_sqrt_hour:
            return 0.0
        begin, length, first = 0.0, 2.0**22, 0.0  # 48 days; later it stays where it is
        last = math.sqrt(length) * self.normal(Stream.WANDER, 0, 0)
        for level in range(1, 23):  # down to a second, within which it goes straight on
            length /= 2.0
            number = int(min(now_s, 2.0**22 - 1.0) // length)
            odd = number % 2
            middle = 0.5 * (first + last) + math.sqrt(0.5 * length) * self.normal(Stream.WANDER, level, number // 2)
            begin, first, last = (begin + length, middle, last) if odd else (begin, first, middle)
        walked = first + (last - first) * min((now_s - begin) / length, 1.0)
        return self.truth.lamp.wander_per_sqrt_hour / 60.0 * walked

    def true_band(self, band: Band) -> Band:
        """What a band of the rig truly is: the one that has its place in the list of the true bands."""
        known, true = self.description.bands, self.truth.bands
        return band if known == true else true.all()[known.all().index(band)]

    def normal(self, stream: Stream, *address: int) -> float:
        """A standard normal number, the same at every call with the same address."""
        return float(self.generator(stream, *address).standard_normal())

    def uniform(self, stream: Stream, *address: int) -> float:
        """A uniform number in [-1/2, 1/2), the same at every call with the same address."""
        return float(self.generator(stream, *address).random()) - 0.5

    def key(self, stream: Stream, *address: int) -> np.uint64:
        """64 bits that start a counter-based generator for one whole frame or map."""
        return key(self.seed, stream, *address)

    def generator(self, stream: Stream, *address: int) -> np.random.Generator:
        """The random numbers of an address, from their start."""
        return np.random.default_rng([self.seed, stream, *address])

    def require_open(self, device: str) -> None:
        """Raise `DeviceError` where a device is used before its rig was entered, or after it was left."""
        if not self.open:
            name = self.description.name
            raise DeviceError(f'the {device} of the simulated rig "{name}" is not open: enter the rig first')


def truth_of(description: RigDescription) -> RigDescription:
    """What is true of a simulated rig: the rig file without calibrations, and over it the file that `truth` names.

    Where that is not there, and a shipped file has its name, the shipped one is meant.
    """
    own = uncalibrated(description)
    if own.truth is None:
        return own
    shipped = files("gonio_sim") / "rigs" / Path(own.truth).name
    if not Path(own.truth).exists() and shipped.is_file():
        return with_keys(own, tomllib.loads(shipped.read_text(encoding="utf-8")), shipped.name)
    return with_keys(own, read_toml(own.truth), own.truth)


def with_exact_encoders(description: RigDescription) -> RigDescription:
    """A rig whose encoders have no errors within their turn: what they read is where the axes are."""
    arms = description.arms
    exact = {name: getattr(arms, name) for name in ("light", "camera", "azimuth")}
    exact = {n: axis.model_copy(update={"harmonics_deg": ()}) for n, axis in exact.items() if axis is not None}
    return description.model_copy(update={"arms": arms.model_copy(update=exact)})


def key(seed: int, stream: Stream, *address: int) -> np.uint64:
    """64 bits that start a counter-based generator, a function of a seed and an address."""
    return np.uint64(np.random.SeedSequence([seed, stream, *address]).generate_state(1, np.uint64)[0])


def slot_s(description: RigDescription) -> float:
    """Simulated duration of a step [s]: the longest travel of any axis, `FRAMES_S` for the frames, and read-outs."""
    limits = description.limits_deg()
    travel = max((limits[n][1] - limits[n][0]) / axis.speed_deg_per_s for n, axis in description.axes().items())
    frames = description.acquisition.frames + 2  # one for metering, and the shorter one
    return travel + SETTLE_S + FRAMES_S + frames * description.camera.readout_s
