"""A rig as Bluesky's devices: its axes, its lamp and its camera, by the protocols of `bluesky.protocols`.

    import gonio
    from gonio_bluesky import devices

    with devices(gonio.open_rig("sim", sample="sample.toml")) as rig:
        RE(list_scan([rig.camera], rig.axis["camera"], [10, 20, 30]))

Angles are degrees here, as a person reads them. One thread owns the devices: what Bluesky asks of several at once is
done one after the other. Leaving the context darkens the lamp and parks the arms, whatever happened.

These are the devices and no more: no reference, no dark frames, no uncertainties. `gonio_bluesky.measurement` measures
BRDFs.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from gonio.errors import ArgumentError, ConfigError, DeviceError
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.typing import JsonObject

log = logging.getLogger("gonio.devices")

Result = TypeVar("Result")
Value = TypeVar("Value")
Reading = JsonObject
DARK = "dark"
AGAIN_S = 0.1
"""How often axes are told to stop until none is on its way: one that was about to leave may not have heard it."""
PATIENCE_S = 30.0
"""How long a stop waits for that, and for the lamp to be dark."""


class Status:
    """Whether something is done, and how it ended."""

    def __init__(self) -> None:
        self._ended: Future[None] = Future()

    @classmethod
    def finished(cls) -> Status:
        """A status that is done at once, for what takes no time."""
        status = cls()
        status.finish(None)
        return status

    def finish(self, error: BaseException | None) -> None:
        """It is done; with an error, it has failed. What comes later does not count."""
        if self._ended.done():
            return
        if error is None:
            self._ended.set_result(None)
        else:
            self._ended.set_exception(error)

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Have somebody told when it is done; at once where it is."""
        self._ended.add_done_callback(lambda _: callback(self))

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Why it failed; None where it did not. Waits up to `timeout` [s], then raises `TimeoutError`."""
        return self._ended.exception(timeout)

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end, and raise what it failed by."""
        self._ended.result(timeout)

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._ended.done()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._ended.exception() is None


class Owner:
    """A thread in which all is done that devices do: they are not made for several."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-bluesky")

    def ask(self, do: Callable[[], Result]) -> Result:
        """Have something done, after what was asked for before; its result."""
        return self._pool.submit(do).result()

    def begin(self, do: Callable[[], Any], done: Callable[[BaseException | None], BaseException | None]) -> Status:
        """Have something done, and go on meanwhile; `done` says what of its error counts."""
        status = Status()

        def work() -> None:
            try:
                do()
            except BaseException as error:  # whoever waits is told, whatever it is
                status.finish(done(error))
            else:
                status.finish(done(None))

        self._pool.submit(work)
        return status

    def close(self) -> None:
        """End the thread, after what was asked for."""
        self._pool.shutdown()


class Named:
    """What every device has: a name, and readings with a time."""

    parent = None

    def __init__(self, name: str) -> None:
        self.name = name

    @staticmethod
    def _readings(values: JsonObject) -> dict[str, Reading]:
        now = time.time()
        return {key: {"value": value, "timestamp": now} for key, value in values.items()}


class Plotted(Named):
    """A device of which Bluesky plots something: what has its name, or `field`."""

    def __init__(self, name: str, field: str = "") -> None:
        super().__init__(name)
        self.hints: JsonObject = {"fields": [field or name]}


def number(source: str, units: str = "", **more: Any) -> JsonObject:
    """The data key of a number."""
    return {"source": source, "dtype": "number", "dtype_numpy": "<f8", "shape": [], "units": units, **more}


class Brake:
    """What stops the axes of a rig, and darkens its lamp where they were on their way.

    Bluesky stops every axis that it has moved when a run ends, well or not, when it pauses and when it is suspended.
    """

    def __init__(self, owner: Owner, rig: ManualRig, lamp: BlueskyLamp) -> None:
        self._owner, self._rig, self._lamp = owner, rig, lamp
        self._moves: list[Status] = []
        self._stops = 0
        self._cut: str | None = None
        """What was lit when axes were stopped on their way."""
        self._again: str | None = None
        """What is lit again when a pause ends."""

    def move(self, go: Callable[[], object], ended: Callable[[BaseException | None], BaseException | None]) -> Status:
        """Begin a move, unless the axes are stopped before its turn comes."""
        stops, self._cut = self._stops, None

        def unless_stopped() -> None:
            if self._stops != stops:
                raise DeviceError("the axes were stopped before this move began")
            go()

        status = self._owner.begin(unless_stopped, ended)
        self._moves = [*(move for move in self._moves if not move.done), status]
        return status

    def stop(self) -> None:
        """Stop every axis, and those that wait for their turn; the lamp is dark then if any was on its way."""
        self._stops += 1
        self._again = None
        self._rig.stop()
        cut = [move for move in self._moves if not move.done]
        if not cut:
            return
        end = time.monotonic() + PATIENCE_S
        while (going := [move for move in cut if not move.done]) and time.monotonic() < end:
            try:
                going[0].exception(AGAIN_S)
            except TimeoutError:
                self._rig.stop()
        lit = self._lamp.state
        if lit != DARK:
            self._cut = lit
            log.warning("axes were stopped on their way, and the lamp is darkened: light it again before you go on")
            try:
                self._lamp.set(DARK).wait(PATIENCE_S)
            except TimeoutError:
                log.error("the lamp is not dark yet: the rig is busy with something else; it follows then")

    def pause(self) -> None:
        """What was cut off by this pause is lit again after it."""
        self._again, self._cut = self._cut or self._again, None

    def resume(self) -> None:
        """A pause is over."""
        if self._again is not None:
            band, self._again = self._again, None
            self._lamp.set(band).wait()


class BlueskyAxis(Plotted):
    """One axis of a rig, in degrees: movable, readable, locatable, stoppable, pausable, checkable."""

    def __init__(self, owner: Owner, rig: ManualRig, brake: Brake, name: str) -> None:
        super().__init__(f"{name}_axis" if name in ("light", "camera") else name)
        self._owner, self._rig, self._brake, self._axis = owner, rig, brake, name
        self._setpoint: float | None = None
        self._stopped: bool | None = None
        """Whether it was stopped during this move, and then whether the plan wanted that."""

    def check_value(self, value: float) -> None:
        """Raise `ConfigError` where a goal [deg] is outside the axis's limits; nothing moves."""
        if not math.isfinite(value):
            raise ArgumentError(f"{self._axis} = {value}: must be a finite angle [deg]")
        self._rig.check({self._axis: math.radians(value)})

    def set(self, value: float) -> Status:
        """Drive there [deg]; the status is done when it has landed. A goal beyond a limit raises before it moves."""
        value = float(value)
        self.check_value(value)
        self._stopped = None
        status = self._brake.move(lambda: self._rig.move(**{self._axis: math.radians(value)}), self._ended)
        self._setpoint = value
        return status

    def _ended(self, error: BaseException | None) -> BaseException | None:
        """A move that was stopped as planned has ended well where it stands; one that was cut off has failed."""
        if self._stopped is None:
            return error
        return None if self._stopped else error or ConfigError(f"the axis {self._axis} was stopped on its way")

    def stop(self, success: bool = True) -> None:
        """Stop every axis of the rig at once, in the middle of a move too; the lamp goes dark if any was on its way.

        Moves that wait for their turn do not begin. It returns when the axes stand and the lamp is dark.
        """
        self._stopped = bool(success)
        self._brake.stop()

    def pause(self) -> None:
        """Bluesky pauses, and has stopped the axes."""
        self._brake.pause()

    def resume(self) -> None:
        """Bluesky goes on: a lamp that was darkened by the pause is lit again."""
        self._brake.resume()

    def locate(self) -> dict[str, float]:
        """Where it was sent, and what its encoder reads [deg]."""
        there = math.degrees(getattr(self._owner.ask(self._rig.arms.read), self._axis))
        return {"setpoint": there if self._setpoint is None else self._setpoint, "readback": there}

    def read(self) -> dict[str, Reading]:
        """What the encoder reads, and where it was sent [deg]."""
        at = self.locate()
        return self._readings({self.name: at["readback"], f"{self.name}_setpoint": at["setpoint"]})

    def describe(self) -> JsonObject:
        """The data keys of `read`."""
        lower, upper = self._rig.description.limits_deg()[self._axis]
        limits = {"control": {"low": lower, "high": upper}}
        names = (self.name, f"{self.name}_setpoint")
        return {name: number(f"arms.{self._axis}", "deg", limits=limits) for name in names}


class BlueskyLamp(Named):
    """The lamp: set to the name of a band, to a wavelength [nm], or to "dark"."""

    def __init__(self, owner: Owner, rig: ManualRig) -> None:
        super().__init__("lamp")
        self._owner, self._rig, self.state = owner, rig, DARK
        """The band that is lit, or "dark"."""

    def check_value(self, value: str | float) -> None:
        """Raise `ConfigError` where the rig has no such band."""
        self._wavelength_nm(value)

    def _wavelength_nm(self, value: str | float) -> float | None:
        if value == DARK:
            return None
        bands = self._rig.description.bands
        if isinstance(value, str):
            known = {band.name: band.centre_nm for band in bands.all()}
            if value not in known:
                rig, listed = self._rig.description.name, ", ".join(known)
                raise ConfigError(f'the rig "{rig}" has no band "{value}": it has {listed}, and "dark"')
            return known[value]
        return bands.containing(float(value)).centre_nm

    def set(self, value: str | float) -> Status:
        """Light a band, or darken; the status is done when the lamp has settled."""
        wavelength_nm = self._wavelength_nm(value)

        def switch() -> None:
            self.state = DARK
            self._rig.lamp(wavelength_nm is not None, wavelength_nm=wavelength_nm)
            if wavelength_nm is not None:
                self.state = self._rig.band.name

        return self._owner.begin(switch, lambda error: error)

    def read(self) -> dict[str, Reading]:
        """The band that is lit, or "dark"."""
        return self._readings({self.name: self.state})

    def describe(self) -> JsonObject:
        """The data key of `read`."""
        names = [*(band.name for band in self._rig.description.bands.all()), DARK]
        return {self.name: {"source": "light", "dtype": "string", "shape": [], "choices": names}}


class Setting(Named, Generic[Value]):
    """A number that is kept, and used later; `check_value` raises where it could not be used."""

    source = "setting"

    def __init__(self, name: str, value: Value, units: str, check: Callable[[Value], object]) -> None:
        super().__init__(name)
        self.value, self._units, self.check_value = value, units, check

    def set(self, value: Value) -> Status:
        """Keep it; what cannot be used raises now, and not when the plan has moved everything."""
        self.check_value(value)
        self.value = value
        return Status.finished()

    def read(self) -> dict[str, Reading]:
        """What is kept."""
        return self._readings({self.name: self.value})

    def describe(self) -> JsonObject:
        """The data key of `read`."""
        return {self.name: number(self.source, self._units)}


NUMBERS = {
    "exposure_s": "s",
    "mean_dn": "DN",
    "median_dn": "DN",
    "max_dn": "DN",
    "brightest_level": "",
    "saturated_fraction": "",
    "patch_pixels": "",
    "patch_mean_dn": "DN",
    "patch_median_dn": "DN",
    "patch_max_dn": "DN",
    "patch_brightest_level": "",
    "patch_saturated_fraction": "",
}
"""What is read of a frame. The patch is what a measurement of the sample would use; NaN where it is out of sight."""


class BlueskyCamera(Plotted):
    """The camera: a frame at a trigger, of which numbers are read. With a folder the frame itself is kept, as DNG."""

    def __init__(self, owner: Owner, rig: ManualRig, folder: Path | None) -> None:
        super().__init__("camera", "camera_patch_mean_dn")
        self._owner, self._rig, self._folder = owner, rig, folder
        self.exposure_s: Setting[float | None] = Setting("camera_exposure_s", None, "s", self._exposure)
        """How long to expose [s]; None: what a matt white surface would need with the lamp on."""
        self._numbers: dict[str, float] | None = None
        self._file, self._taken = "", 0

    def _exposure(self, value: float | None) -> None:
        if value is not None:
            self._rig.description.camera.require_exposure(float(value))

    def trigger(self) -> Status:
        """Take a frame; the status is done when it is there, and in its file."""

        def take() -> None:
            file = None
            while self._folder is not None and (file is None or file.exists()):
                self._taken += 1
                file = self._folder / f"{self._taken:06d}.dng"
            self._numbers = self._rig.snap(file, exposure_s=self.exposure_s.value).numbers()
            self._file = str(file) if file is not None else ""

        return self._owner.begin(take, lambda error: error)

    def read(self) -> dict[str, Reading]:
        """Numbers of the last frame; `ConfigError` where none was taken."""
        if self._numbers is None:
            raise ConfigError("the camera has taken no frame yet: trigger it before it is read")
        values: JsonObject = {f"{self.name}_{key}": self._numbers.get(key, math.nan) for key in NUMBERS}
        return self._readings(values | ({f"{self.name}_file": self._file} if self._folder is not None else {}))

    def describe(self) -> JsonObject:
        """The data keys of `read`."""
        out: JsonObject = {f"{self.name}_{key}": number("camera", units) for key, units in NUMBERS.items()}
        if self._folder is not None:
            out[f"{self.name}_file"] = {"source": "camera", "dtype": "string", "shape": []}
        return out


class Devices:
    """The devices of a rig; see `devices`."""

    def __init__(self, rig: ManualRig, folder: Path | None) -> None:
        self._owner, self._rig = Owner(), rig
        self.lamp = BlueskyLamp(self._owner, rig)
        brake = Brake(self._owner, rig, self.lamp)
        self.axis = {name: BlueskyAxis(self._owner, rig, brake, name) for name in rig.description.axes()}
        """By their names in the rig file: light, camera, tilt, spin, azimuth."""
        self.camera = BlueskyCamera(self._owner, rig, folder)

    @property
    def all(self) -> list[Any]:
        """Every device: axes, lamp, camera."""
        return [*self.axis.values(), self.lamp, self.camera]

    def __enter__(self) -> Self:
        try:
            self._owner.ask(self._rig.__enter__)
        except BaseException:
            self._owner.close()
            raise
        return self

    def __exit__(self, *how: Any) -> None:
        try:
            self._owner.ask(lambda: self._rig.__exit__(*how))
        finally:
            self._owner.close()


def devices(rig: ManualRig, *, frames: str | Path | None = None) -> Devices:
    """The devices of a rig, for Bluesky's plans.

    Parameters
    ----------
    rig
        As `gonio.open_rig` gives it, not entered: `with devices(gonio.open_rig("sim")) as rig:` enters and leaves it.
    frames
        A folder that takes the raw frames (DNG), numbered; without it they are not kept.

    Raises
    ------
    ConfigError
        The folder is not there.
    """
    folder = Path(frames) if frames is not None else None
    if folder is not None and not folder.is_dir():
        raise ConfigError(f"{folder}: there is no such folder, and the frames are to be kept there")
    return Devices(rig, folder)
