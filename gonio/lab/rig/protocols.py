"""What a goniometer is: small protocols that a rig implements, and the values that pass through them.

A rig is opened by an entry point of the group `gonio.rigs`: an object with the methods of `RigPlugin`. Entering the
rig's context opens its devices with the lamp dark; leaving it, however that happens, darkens the lamp and parks the
arms.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, Self, runtime_checkable

import numpy as np

from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.health import Health
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polarisers import Side
from gonio.samples.description import SampleDescription
from gonio.typing import NDArray

Target = Literal["sample", "reference"]
Device = Literal["arms", "light", "camera"]


@dataclass(frozen=True, slots=True)
class Pose:
    """Positions of the axes [rad], with zero offsets already taken out.

    `light` and `camera` are arm angles in the plane of the arms, from the direction that the untilted sample's normal
    points to, positive toward the lab's x axis. `tilt` turns the normal out of that plane, `spin` turns the sample
    about its normal, `azimuth` turns the camera arm about the normal (rigs that have that axis).
    """

    light: float = 0.0
    camera: float = 0.0
    tilt: float = 0.0
    spin: float = 0.0
    azimuth: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """One raw frame: the linear mosaic as the sensor gave it.

    Row 0 is the top of `gonio.lab.rig.kinematics.View`: rows grow along the arms' axis y. Levels are in DN; `pattern`
    is "mono" or a Bayer pattern in raster order.
    """

    mosaic: NDArray[np.uint16]
    exposure_s: float
    black_level_dn: float
    white_level_dn: float
    pattern: str = "mono"
    time_s: float = field(kw_only=True)
    """Start of the exposure on the rig's clock (`Rig.time_s`) [s]. It grows from frame to frame, or a measurement ends:
    the lamp's drift is told from it. A file that does not say its time is read with NaN."""
    monitor: float | None = field(default=None, kw_only=True)
    """Reading of the lamp's monitor during the exposure, where the camera's driver takes one; else the engine asks the
    lamp for it after the frame (`monitor()`), on a rig with `lamp.monitor = true`."""
    file: Path | None = field(default=None, kw_only=True)
    """Set when a camera delivered a raw file of its own (CR2, NEF, ARW, DNG); the engine keeps that file."""
    record: str = field(default="", kw_only=True)
    """The engine's: what a frame's own file says of its step (`gonio.lab.acquisition.frame_writer`)."""


@dataclass(frozen=True, slots=True)
class Step:
    """A numbered step of a run; its number is the same in every run of the same plan on the same rig."""

    index: int
    kind: Literal["dark", "reference", "point"]
    point: int | None = None
    """Row of the plan, for a point."""
    pose: Pose = field(default_factory=Pose)


class ArmsDevice(Protocol):
    """The motion of a rig, all axes together."""

    def move(self, goal: Pose) -> Pose:
        """Drive every axis to `goal`, arriving from below, wait until all have landed; the encoders' readback.

        Raises `DeviceError` where an axis does not land, and `ConfigError` where a goal is outside a limit.
        """

    def read(self) -> Pose:
        """The encoders' readback, now."""

    def stop(self) -> None:
        """Stop every axis at once; never raises."""

    def park(self) -> None:
        """Drive to the rest position."""


class LightDevice(Protocol):
    """The lamp; dark after construction and after every exit."""

    def select(self, band: Band) -> None:
        """Choose the spectral band (filter, grating or channel)."""

    def on(self) -> None:
        """Light up, and wait until the lamp has settled."""

    def off(self) -> None:
        """Darken."""


class CameraDevice(Protocol):
    """A camera with raw frames and manual exposure."""

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call."""


class Exposed(Protocol):
    """An exposure that is over; its frame may be on its way still."""

    def done(self) -> bool:
        """Whether the frame is there."""

    def result(self) -> Frame:
        """Wait for the frame; asked once. Raises as `CameraDevice.capture`, which takes no second exposure here."""


@runtime_checkable
class Exposes(Protocol):
    """A camera that says when an exposure is over, before its frame is read out."""

    def expose(self, exposure_s: float) -> Exposed:
        """Expose wholly after this call, and return once that is over: what moves or shines then changes no pixel.

        No other exposure is asked for before the frame was. Where the device cannot tell, this returns with the frame.
        Raises as `CameraDevice.capture`.
        """


@dataclass(frozen=True, slots=True)
class Arrived:
    """An `Exposed` whose frame is there."""

    frame: Frame

    def done(self) -> bool:
        """It is."""
        return True

    def result(self) -> Frame:
        """The frame."""
        return self.frame


class PolariserDevice(Protocol):
    """A polariser on an arm; out of the beam after construction, where it has an empty place."""

    def select(self, state: str, azimuth: float = 0.0) -> None:
        """Take a state, and wait until it is there.

        "u": out of the beam. "linear": in it, with its axis at an azimuth [rad] (`gonio.lab.rig.polariser_axes`), which
        means the same half a turn on. "r", "l": circular.
        """


@runtime_checkable
class Polarises(Protocol):
    """A rig with polarisers: those that `polarisers` of its rig file names."""

    @property
    def polarisers(self) -> Mapping[Side, PolariserDevice]:
        """By `light` and `receiver`."""


class Rig(Protocol):
    """A goniometer that is open."""

    @property
    def description(self) -> RigDescription:
        """Its rig file."""

    @property
    def arms(self) -> ArmsDevice:
        """Its axes, all together."""

    @property
    def light(self) -> LightDevice:
        """Its lamp."""

    @property
    def camera(self) -> CameraDevice:
        """Its camera."""

    @property
    def repeatable(self) -> bool:
        """True for a simulation alone: a step gives the same frames at the same times whenever it is taken.

        A resumed run then needs no new darks and references; a sample file must be named, and no hand swaps anything.
        """

    def begin(self, step: Step) -> None:
        """Called before anything of a step is done; a simulated rig sets its clock and random numbers from it."""

    def present(self, target: Target) -> None:
        """Put the sample or the white reference into the beam (an axis, or a prompt that the user confirms)."""

    def time_s(self) -> float:
        """Seconds on the rig's own clock, at least 0. It never goes back, nor from one session of a run to the next."""

    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class RigPlugin(Protocol):
    """What an entry point of the group `gonio.rigs` names."""

    @property
    def toml(self) -> str:
        """The shipped rig file, as `gonio rig show` prints it ("" for a rig that always needs a file)."""

    def open(self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool) -> Rig:
        """Build the rig without touching a device; `confirm` is False where no prompt may be shown (`--yes`).

        Raises `ConfigError` for a description that this rig cannot be built from.
        """


@runtime_checkable
class OpensSome(Protocol):
    """Opens some of its devices."""

    def only(self, *devices: Device) -> None:
        """Called before the rig is entered: what is not named is neither opened nor needed, and stays as it is.

        Of the arms those axes are opened whose servos answer; the others stand in `health().silent`.
        """


@runtime_checkable
class Holds(Protocol):
    """Can leave its arms where they stand."""

    def hold(self) -> None:
        """On leaving, the arms stay where they stand and hold, instead of parking; the lamp is darkened as ever."""


@runtime_checkable
class Jogs(Protocol):
    """Drives some axes alone."""

    def jog(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Drive some axes [rad] as `ArmsDevice.move` does, and leave the others; the readback of those that moved."""


@runtime_checkable
class TellsHealth(Protocol):
    """Tells how its open devices are."""

    def health(self) -> Health:
        """What the devices that are open say of themselves, now."""


@runtime_checkable
class Surveys(Protocol):
    """Tells how its devices are without being entered."""

    def survey(self, *devices: Device) -> Health:
        """The same without being entered: each device is opened, asked and closed, and nothing is changed by it.

        No torque comes or goes, and a lamp that shines goes on. A device that is missing or mute stands in `silent`
        and raises nothing. Without `devices`, all.
        """


@runtime_checkable
class Puts(Protocol):
    """Has something put into its holder."""

    def put(self, what: str) -> bool:
        """Have a "mirror", nothing ("empty") or the "sample" put into the holder, for an alignment.

        False where only a person can do that, who is then asked.
        """


@runtime_checkable
class Dims(Protocol):
    """A lamp with levels."""

    def dim(self, level: float | None) -> None:
        """Shine at a fraction of the largest output from the next `on`; None: at the rig file's level."""


@runtime_checkable
class Monitors(Protocol):
    """A lamp with a monitor."""

    def monitor(self) -> float | None:
        """The reading of the monitor, or None; asked after each frame where `lamp.monitor = true`."""


class ByHand(OpensSome, Holds, Jogs, TellsHealth, Surveys, Puts, Protocol):
    """What a rig may offer beside `Rig`, so that a person can work on one device while others are missing.

    Every method is optional by itself, and is looked for by its name; those of the bases are capabilities with a
    protocol each. Without `only` a rig opens everything.
    """

    def left(self) -> str:
        """After it was left: what is true of its lamp and its axes, as read back, for a message."""

    def leave_as_found(self) -> None:
        """Called before the rig is entered: on leaving no axis parks, and each holds or is free as it was found."""


@dataclass(frozen=True, slots=True)
class FoundServo:
    """A servo that answers on a port."""

    port: str
    baud: int
    id: int
    model: str
    firmware: int
    alone: bool = True
    """False where two servos answer to this id, or its answers are damaged as theirs would be."""


@dataclass(frozen=True, slots=True)
class Homed:
    """What a homing has found."""

    at_deg: float
    """Where the rig file has the place."""
    off_deg: float
    """Where it was found, from there."""
    spread_deg: float
    """Largest less smallest of the repetitions."""
    found: int
    """How often."""


@runtime_checkable
class RigService(Protocol):
    """What a rig's plugin may offer beside `open`: work on servos before the rig can be opened, or that opening spoils.

    A plugin that lacks one of these methods has no such devices.
    """

    def ports(self, description: RigDescription | None = None) -> list[str]:
        """The serial ports that a rig file's servos hang at; without one, all that this computer has."""

    def servos(self, port: str, say: Callable[[str], None]) -> list[FoundServo]:
        """Every servo that answers on a port, at every line speed; nothing is changed. `say` hears how far it is."""

    def assign(self, servo: FoundServo, *, identity: int | None = None, baud: int | None = None) -> FoundServo:
        """Give a servo another id or line speed, for good; as it answers now. Its torque goes off.

        Raises `DeviceError` where two servos answer to its id, the new one is taken, or it does not take it.
        """

    def reboot(self, description: RigDescription, axes: Sequence[str] = ()) -> dict[str, str]:
        """Restart the servos of axes (of all, without `axes`); by axis, "" or why it failed. Their torque goes off."""

    def home(
        self, description: RigDescription, axes: Sequence[str], say: Callable[[str], None]
    ) -> dict[str, Homed | str]:
        """Find the turn of axes that count turns (without `axes`, of those that need it); by axis, or why it failed."""


class RigDiscovery(Protocol):
    """What a rig's plugin may offer beside `RigService`, for `gonio rig new`: a look at unknown ports."""

    def lamp_on(self, port: str) -> tuple[str, str] | None:
        """Dialect and name of the lamp at a port, asked for nothing else; None where there is none."""

    def is_release(self, port: str) -> bool:
        """Whether a camera's release box hangs at a port; nothing is exposed."""

    def wiggle(self, servo: FoundServo) -> None:
        """Turn a servo a little toward growing counts and back, so that a person sees which axis it turns."""

    def count_of(self, servo: FoundServo) -> int:
        """Where a servo stands, as its count within one turn."""
