"""The laboratory rig: servo arms, a lamp on a serial port and a camera, put together from a rig file.

Entering opens the lamp first and darkens it. Leaving, however that happens, darkens the lamp, then parks the arms; arms
that have failed, or that somebody has stopped, are left where they stand.
"""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from types import TracebackType
from typing import Self

from gonio.config import Strict, parse
from gonio.disk import write_whole
from gonio.errors import (
    ArgumentError,
    ConfigError,
    DeviceError,
    Disturbed,
    EmergencyStop,
    GonioError,
    Interrupted,
    PassingFault,
    os_error_as,
)
from gonio.lab.rig import (
    Arrived,
    Device,
    Exposed,
    Exposes,
    Frame,
    Health,
    PolariserDevice,
    Step,
    Target,
    ask_for,
    clock,
)
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.polarisers import Side
from gonio.lab.rig.regions import require_frame
from gonio.lab.rig.whereabouts import axes_stand
from gonio.samples.description import SampleDescription
from gonio_drivers import cameras, interlock, log, service, signals, survey
from gonio_drivers.arms import ServoArms
from gonio_drivers.light import LampReset, SerialLight
from gonio_drivers.settings import DeviceSettings
from gonio_drivers.stages import StageArms

RETAKES = 3
PERSON_S = 3600.0
"""How long a lamp that is lit waits for a person who swaps sample and reference."""
ALL: tuple[Device, ...] = ("light", "arms", "camera")


class GuardedCamera:
    """The camera of a laboratory rig: a frame counts only if lamp and arms were as they should be when it was over."""

    def __init__(
        self,
        description: Camera,
        camera: cameras.OpenableCamera,
        light: SerialLight,
        arms: ServoArms | StageArms,
        clock: Callable[[], float],
        late_s: float,
    ) -> None:
        self.watched: frozenset[str] = frozenset(ALL)
        """The devices beside it that are open, and looked at after each frame."""
        self._description = description
        self.signals = signals.Heard()
        self._bits = 0
        """Of its frames so far; 0 before the first."""
        self.allowed: Callable[[], None] = lambda: None
        """Called before and after each frame; raises where nothing may go on."""
        self._camera = camera
        self._clock, self._late_s = clock, late_s
        self._light = light
        self._arms = arms

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call; its time is the start of its exposure, on the rig's clock.

        Raises
        ------
        DeviceError
            The camera fails, an axis has moved by itself, or the lamp does not stay as it is meant to be.
        """
        return self._counting(exposure_s, lambda: Arrived(self._camera.capture(exposure_s))).result()

    def _counting(self, exposure_s: float, expose: Callable[[], Exposed]) -> Exposed:
        """An exposure during which lamp and arms were as they should be; a frame that is there is looked at first."""
        self.signals.again()
        for _ in range(RETAKES):
            self.allowed()
            self._light.alive(exposure_s + self._late_s)
            if "light" in self.watched:
                self._light.require_time()  # or a long exposure would be for nothing
            begun = self._clock()
            exposed = expose()
            try:
                self.allowed()
                if exposed.done():
                    exposed = Arrived(self.sound(exposed.result(), begun))
                if "arms" in self.watched:
                    self._arms.still()
                if "light" in self.watched:
                    self._light.check()
            except LampReset as reset:
                log.warning("%s during an exposure; the frame is taken again", reset)
                exposed.result()
                continue
            except (Disturbed, PassingFault):  # the camera has to be rid of what counts for nothing
                with contextlib.suppress(PassingFault):
                    exposed.result()
                raise
            return exposed if isinstance(exposed, Arrived) else Guarded(self, exposed, begun)
        raise PassingFault(f"the lamp on {self._light} does not stay as it is set, over {RETAKES} exposures", "lamp")

    def alive(self) -> None:
        """A sign of life before a frame is waited for."""
        self._light.alive(self._late_s)

    def sound(self, frame: Frame, begun: float) -> Frame:
        """A frame with its time, if it is what the rig file says."""
        require_frame(self._description, frame, "camera")
        bits = round(frame.white_level_dn).bit_length()
        if self._bits not in (0, bits):
            raise DeviceError(f"camera: a frame has {bits} bits, and the ones before it had {self._bits}")
        self._bits = bits
        return replace(frame, time_s=begun)


@dataclass(frozen=True, slots=True)
class Guarded:
    """An `Exposed` of the laboratory's camera: lamp and arms were looked at when its exposure was over."""

    camera: GuardedCamera
    exposed: Exposed
    begun: float

    def done(self) -> bool:
        """Whether the frame is there."""
        return self.exposed.done()

    def result(self) -> Frame:
        """Wait for the frame."""
        self.camera.alive()
        return self.camera.sound(self.exposed.result(), self.begun)


class TellingCamera(GuardedCamera):
    """The same of a camera that may say when its exposure is over, as `gonio.lab.rig.Exposes`."""

    def expose(self, exposure_s: float) -> Exposed:
        """An exposure during which lamp and arms were as they should be; raises as `capture`."""
        camera = self._camera
        assert isinstance(camera, Exposes)
        return self._counting(exposure_s, lambda: camera.expose(exposure_s))


@dataclass(frozen=True, slots=True)
class ServoPolariser:
    """A polariser that a servo on the arms' bus turns, as a `PolariserDevice`."""

    arms: ServoArms
    side: str

    def select(self, state: str, azimuth: float = 0.0) -> None:
        """Turn its axis; other states than "linear" are refused, as the rig file cannot promise them."""
        if state != "linear":
            raise ConfigError(f'[polarisers.{self.side}]: a servo turns the polariser, and cannot do "{state}"')
        self.arms.polarise(self.side, math.degrees(azimuth))


class LabRig:
    """A goniometer of servos, lamp and camera.

    Parameters
    ----------
    description, devices
        The rig file, and its table `[devices]`.
    confirm
        Ask on the terminal when sample and reference have to be swapped by hand.
    lenient
        A camera that cannot be made is an error where it is opened, and not before.
    """

    repeatable = False

    def __init__(
        self, description: RigDescription, devices: DeviceSettings, *, confirm: bool, lenient: bool = False
    ) -> None:
        self.description = description
        self.light = SerialLight(description, devices.light)
        self.arms = _arms(description, devices)
        self.polarisers: dict[Side, PolariserDevice] = {}
        if isinstance(self.arms, ServoArms):
            self.polarisers = {side: ServoPolariser(self.arms, side) for side in description.polarisers.sides()}
        self._camera: cameras.OpenableCamera
        try:
            self._camera = cameras.build(description, devices.camera)
        except ConfigError as error:
            if not lenient:
                raise
            self._camera = cameras.Unbuilt(error)
        self._clock_starts = clock.time() - clock.monotonic()
        late_s = description.camera.beside_s
        if isinstance(patience_s := devices.camera.get("timeout_s", 0.0), int | float):
            late_s += patience_s  # how long a driver of ours waits for a frame beside its exposure
        guarded = TellingCamera if isinstance(self._camera, Exposes) else GuardedCamera
        self.camera = guarded(description.camera, self._camera, self.light, self.arms, self.time_s, late_s)
        self.interlock: interlock.Interlock | None = None
        if devices.interlock is not None:
            servos = self.arms.joints if isinstance(self.arms, ServoArms) else {}
            self.interlock = interlock.build(devices.interlock, servos, self.light.darken_at_once)
        self.light.allowed = self.arms.allowed = self.camera.allowed = self._look
        self._camera_driver = str(devices.camera.get("driver"))
        self._confirm = confirm
        self._target_file = devices.holder.target_file if devices.holder else None
        self._target: Target = "sample"
        self._opened: frozenset[str] = frozenset(ALL)
        self._holds_on_exit = self.arms.holds
        self._stays = self._parked = self._as_found = False
        self._stack = contextlib.ExitStack()

    def _look(self) -> None:
        """Called at every turn of a wait or a motion, and around exposures: nothing has stopped the rig; a sign of
        life."""
        if self.interlock is not None:
            self.interlock.require()
        self.light.alive()

    def begin(self, step: Step) -> None:
        """Nothing to prepare: a laboratory takes every step as it comes."""

    def present(self, target: Target) -> None:
        """Put the sample or the white reference into the beam: by the changer's servo, whoever reads
        `devices.holder.target_file`, or the user's hand.
        """
        how = self.description.reference.how
        if how == "axis":
            self.arms.change(target)
        elif how == "swap" and self.put(target):
            pass
        elif how in ("swap", "beam") and self._confirm and target != self._target:
            self.light.alive(PERSON_S)
            ask_for(target, beam=how == "beam")
        self._target = target

    def put(self, what: str) -> bool:
        """Have a mirror, nothing ("empty") or the sample put into the holder; False where only a person can do it.

        Raises
        ------
        DeviceError
            `devices.holder.target_file` cannot be written.
        """
        if self._target_file is None:
            return False
        path = Path(self._target_file)
        with os_error_as(DeviceError, f'devices.holder.target_file = "{path}": cannot be written'):
            write_whole(path, f"{what}\n".encode())
        return True

    def time_s(self) -> float:
        """Seconds since 1970, so that the sessions of one run share a clock; it does not jump within a session."""
        return self._clock_starts + clock.monotonic()

    # ---- ByHand ----

    def only(self, *devices: Device) -> None:
        """Called before the rig is entered: what is not named is neither opened nor needed, and stays as it is."""
        for name in devices:
            if name not in ALL:
                raise ArgumentError(f'devices: there is no "{name}"; there are {", ".join(ALL)}')
        self._opened = self.camera.watched = frozenset(devices)
        self.arms.partial = "arms" in devices

    def hold(self) -> None:
        """On leaving, the arms stay where they stand and hold, instead of parking; the lamp is darkened as ever."""
        self._stays = self.arms.holds = True

    def leave_as_found(self) -> None:
        """Called before the rig is entered: on leaving no axis parks, and each holds or is free as it was found."""
        self._as_found = True

    def left(self) -> str:
        """After it was left: whether the lamp is dark, where every axis stands and whether it holds, as read back.

        More presses of Ctrl-C do not cut it off.
        """
        with signals.undisturbed():
            return self._left()

    def _left(self) -> str:
        said = []
        if "arms" in self._opened:
            stopped = "axes stopped"
            if isinstance(self.arms, ServoArms) and self.arms.deaf:  # a watchdog of theirs may have done it
                stopped = "no servo answered when the axes were to stop"
            unparked = "not every axis parked" if self.arms.absent else "arms not parked"
            said.append("arms parked" if self._parked else stopped if self.arms.stopped else unparked)
        if "light" in self._opened:
            dark = self.light.known_dark
            said.append("lamp dark" if dark else "whether the lamp is dark is not known: look at it")
        if "arms" not in self._opened:
            return ", ".join(said)
        return ", ".join(said) + "; " + axes_stand(lambda: self.survey("arms"), self.description.axes())

    def jog(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Drive some axes [rad] and leave the others; the readback of those that moved [rad]."""
        return self.arms.jog(goals)

    def health(self) -> Health:
        """What servos and lamp say of themselves now, as far as they are open; and the strain since the last time."""
        if self.interlock is not None:
            self.interlock.require()
        health = Health()
        if "arms" in self._opened:
            health += self.arms.health() + self.arms.strain()
        if "light" in self._opened:
            try:
                health += survey.of_open_light(self.light)
            except DeviceError as failure:  # whether a frame counts, `GuardedCamera` asks by itself
                health += Health((), {survey.LAMP: str(failure)})
        return health

    def survey(self, *devices: Device) -> Health:
        """What the devices say that nobody has opened; nothing is changed by it."""
        ask = {
            "arms": lambda: self.arms.survey(),
            "light": lambda: survey.of_light(self.light),
            "camera": lambda: survey.of_camera(self._camera, self._camera_driver),
        }
        health = sum((ask[name]() for name in devices or ALL), Health())
        if self.interlock is not None and not devices:
            health += self.interlock.survey()
        return health

    def diagnose(self, *, move: bool) -> list[tuple[str, str, bool]]:
        """What `gonio rig check` reports of the devices: what, what was found, whether that is good."""
        return survey.rows(self.arms, self.light, move=move)

    def __enter__(self) -> Self:
        self._stays = self._parked = False
        self.arms.holds = self._holds_on_exit
        self.arms.as_found = True  # where a device cannot be opened, nobody's arms are let fall for it
        with contextlib.ExitStack() as stack:
            self.camera.signals = stack.enter_context(signals.heard())
            for name, device in (("light", self.light), ("arms", self.arms), ("camera", self._camera)):
                if name == "arms":
                    self._guard(stack, before_arms=True)
                if name in self._opened:
                    stack.enter_context(device)
                if name == "arms":
                    self._guard(stack, before_arms=False)
            self._stack = stack.pop_all()
        self.arms.as_found = self._as_found
        return self

    def _guard(self, stack: contextlib.ExitStack, *, before_arms: bool) -> None:
        """A serial line is watched before any torque comes on, a servo's port once its servo is an input.

        Without arms, to darken a lamp is allowed whatever the contact says.
        """
        watched = self.interlock
        if watched is None or self._opened <= {"camera"}:
            return
        its_turn = isinstance(watched.contact, interlock.ServoPort) != before_arms
        if its_turn:
            stack.enter_context(watched)
        if "arms" in self._opened and before_arms:
            watched.latch.require()
        if "arms" in self._opened and its_turn:
            watched.require()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failure: GonioError | None = None
        try:  # whatever interrupts this, the stack still darkens the lamp and takes the torque off
            try:
                if "light" in self._opened:
                    self.light.off()
            except GonioError as dark:
                failure = dark
            try:
                if self.interlock is not None and not isinstance(error, EmergencyStop):  # which has told it
                    self.interlock.look_again()
            except EmergencyStop as opened:
                failure = failure or opened
            stopped = self.arms.stopped and not isinstance(error, DeviceError)  # by somebody, and not after a failure
            stays = self._stays or self._as_found
            tripped = self.interlock is not None and self.interlock.tripped  # then nothing moves, not to park either
            if not (self.arms.faulted or stopped or stays or tripped) and "arms" in self._opened:
                self.arms.park()
                self._parked = True
        except Interrupted:
            raise Interrupted("stopped at once, on the way to the rest position") from None
        except GonioError as stuck:
            failure = failure or stuck
        finally:
            with signals.undisturbed():
                self._stack.__exit__(kind, error, trace)
        if failure is not None:
            if error is None or isinstance(error, Interrupted):  # nobody may be told that the arms are parked
                raise failure
            log.error("while leaving: %s", failure)


def _arms(description: RigDescription, devices: DeviceSettings) -> ServoArms | StageArms:
    if devices.stages is not None:
        return StageArms(description, devices.stages)
    assert devices.servos is not None  # as `Devices` has it
    return ServoArms(description, devices.servos)


class _File(Strict):
    """The part of the rig file that is the drivers' own, so that messages name keys in full."""

    devices: DeviceSettings


@dataclass(frozen=True, slots=True)
class LabPlugin(service.ServoService):
    """An entry point of the group `gonio.rigs`, with work on single servos, and a look at unknown ports."""

    file: str
    """The shipped rig file."""
    lamp_on = staticmethod(service.lamp_on)
    is_release = staticmethod(service.is_release)
    wiggle = staticmethod(service.wiggle)
    count_of = staticmethod(service.count_of)

    @property
    def toml(self) -> str:
        """The shipped rig file."""
        return (files("gonio_drivers") / self.file).read_text(encoding="utf-8")

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> LabRig:
        """Build the rig; `sample` and `seed` change nothing, since only the user knows what lies in the holder.

        Raises
        ------
        ConfigError
            A key of `[devices]` is wrong.
        """
        return LabRig(description, _devices(description), confirm=confirm)

    def open_by_hand(self, description: RigDescription, *, confirm: bool) -> LabRig:
        """The same for work by hand: other devices work without a camera that cannot be made yet (uncalibrated)."""
        return LabRig(description, _devices(description), confirm=confirm, lenient=True)

    def acknowledge(self, description: RigDescription) -> str:
        """A person says that the cause of an emergency stop is removed; which one that was, "" where there was none.

        Raises
        ------
        ConfigError
            The rig file has no interlock.
        DeviceError
            Its contact is open still, or cannot be read.
        """
        rig = LabRig(description, _devices(description), confirm=False)
        if rig.interlock is None:
            raise ConfigError("devices.interlock is missing: the rig has no interlock that could have stopped it")
        return rig.interlock.acknowledge()


def _devices(description: RigDescription) -> DeviceSettings:
    return parse(_File, {"devices": description.devices}, f'rig "{description.name}"').devices


LAB = LabPlugin("lab.toml")
THREE_SERVOS = LabPlugin("three-servos.toml")
