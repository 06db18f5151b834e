"""The laboratory rig: servo arms, a lamp on a serial port and a camera, put together from a rig file.

Entering opens the lamp first and darkens it. Leaving, however that happens, darkens the lamp, then parks the arms; arms
that have failed, or that somebody has stopped, are left where they stand.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.resources import files
from types import FrameType, TracebackType
from typing import Any, Self

from gonio.config import Strict, parse
from gonio.errors import DeviceError, GonioError, Interrupted
from gonio.rig import Frame, Step, Target, ask_for
from gonio.rig.description import RigDescription, SampleDescription
from gonio_drivers import cameras, diagnosis
from gonio_drivers.arms import ServoArms
from gonio_drivers.light import LampReset, SerialLight
from gonio_drivers.settings import Devices

log = logging.getLogger("gonio.devices")

RETAKES = 3
ENDING = (
    signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM,
    signal.SIGPROF, signal.SIGXCPU,
)  # fmt: skip
"""Signals that would end the process with the lamp lit; Ctrl-C is an exception in Python already."""


class GuardedCamera:
    """The camera of a laboratory rig: a frame counts only if lamp and arms were as they should be when it was over."""

    def __init__(
        self, camera: cameras.OpenableCamera, light: SerialLight, arms: ServoArms, clock: Callable[[], float]
    ) -> None:
        self._camera = camera
        self._clock = clock
        self._light = light
        self._arms = arms

    def capture(self, exposure_s: float) -> Frame:
        """One frame that was exposed wholly after this call; its time is the start of its exposure, on the rig's clock.

        Raises
        ------
        DeviceError
            The camera fails, an axis has moved by itself, or the lamp does not stay as it is meant to be.
        """
        for _ in range(RETAKES):
            begun = self._clock()
            frame = self._camera.capture(exposure_s)
            self._arms.still()
            try:
                self._light.check()
            except LampReset as reset:
                log.warning("%s during an exposure; the frame is taken again", reset)
                continue
            return replace(frame, time_s=begun)
        raise DeviceError(f"the lamp on {self._light} does not stay as it is set, over {RETAKES} exposures")


class LabRig:
    """A goniometer of servos, lamp and camera.

    Parameters
    ----------
    description, devices
        The rig file, and its table `[devices]`.
    confirm
        Ask on the terminal when sample and reference have to be swapped by hand.
    """

    repeatable = False

    def __init__(self, description: RigDescription, devices: Devices, *, confirm: bool) -> None:
        self.description = description
        self.light = SerialLight(description, devices.light)
        self.arms = ServoArms(description, devices.servos)
        self._camera = cameras.build(description, devices.camera)
        self._clock_starts = time.time() - time.monotonic()
        self.camera = GuardedCamera(self._camera, self.light, self.arms, self.time_s)
        self._confirm = confirm
        self._target: Target = "sample"
        self._stack = contextlib.ExitStack()

    def begin(self, step: Step) -> None:
        """Nothing to prepare: a laboratory takes every step as it comes."""

    def present(self, target: Target) -> None:
        """Put the sample or the white reference into the beam: by the changer's servo, or by the user's hand."""
        how = self.description.reference.how
        if how == "axis":
            self.arms.change(target)
        elif how == "swap" and self._confirm and target != self._target:
            ask_for(target)
        self._target = target

    def time_s(self) -> float:
        """Seconds since 1970, so that the sittings of one run share a clock; it does not jump within a sitting."""
        return self._clock_starts + time.monotonic()

    def diagnose(self, *, move: bool) -> list[tuple[str, str, bool]]:
        """What `gonio rig check` reports of the devices: what, what was found, whether that is good."""
        return diagnosis.rows(self.arms, self.light, move=move)

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            stack.enter_context(_signals())
            stack.enter_context(self.light)
            stack.enter_context(self.arms)
            stack.enter_context(self._camera)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failure: GonioError | None = None
        try:  # whatever interrupts this, the stack still darkens the lamp and takes the torque off
            try:
                self.light.off()
            except GonioError as dark:
                failure = dark
            stopped = self.arms.stopped and not isinstance(error, DeviceError)  # by somebody, and not after a failure
            if not self.arms.faulted and not stopped:
                self.arms.park()
        except Interrupted:
            raise Interrupted(
                "stopped at once, on the way to the rest position; axes stopped, lamp dark; go on with --resume"
            ) from None
        except GonioError as stuck:
            failure = failure or stuck
        finally:
            with _undisturbed():
                self._stack.__exit__(kind, error, trace)
        if failure is not None:
            if error is None or isinstance(error, Interrupted):  # nobody may be told that the arms are parked
                raise failure
            log.error("while leaving: %s", failure)


@contextlib.contextmanager
def _signals() -> Any:
    """While nobody else listens, signals that would end the process leave the rig in order: lamp dark, arms parked."""

    def leave(number: int, frame: FrameType | None) -> None:
        for other in mine:  # once: a second one must not disturb the parking
            signal.signal(other, signal.SIG_IGN)
        raise Interrupted(f"stopped by {signal.Signals(number).name}")

    mine: list[signal.Signals] = []
    if threading.current_thread() is threading.main_thread():
        mine = [n for n in ENDING if signal.getsignal(n) is signal.SIG_DFL]
    for number in mine:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """For the moment that it takes to darken and to close the ports, Ctrl-C and its like are not heard."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is signal.SIG_IGN:  # nobody has changed it since
                signal.signal(number, handler)


class _File(Strict):
    """The part of the rig file that is the drivers' own, so that messages name keys in full."""

    devices: Devices


@dataclass(frozen=True, slots=True)
class LabPlugin:
    """The entry point `lab` of the group `gonio.rigs`."""

    @property
    def toml(self) -> str:
        """The shipped rig file."""
        return (files("gonio_drivers") / "lab.toml").read_text(encoding="utf-8")

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> LabRig:
        """Build the rig; what lies in the holder is the user's to know, so `sample` and `seed` change nothing.

        Raises
        ------
        ConfigError
            A key of `[devices]` is wrong.
        """
        table = parse(_File, {"devices": description.devices}, f'rig "{description.name}"')
        return LabRig(description, table.devices, confirm=confirm)


LAB = LabPlugin()
