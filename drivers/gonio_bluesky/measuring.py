"""A measurement that Bluesky drives: its plan names the points, and the rig's own engine takes each of them whole.

    from gonio_bluesky import measurement

    with measurement("plan.toml", rig="sim", sample="sample.toml", seed=5, out="RUN") as m:
        RE(list_scan([m.camera], *m.points()))

RUN is then what `gonio measure plan.toml --rig sim --sample sample.toml --seed 5 --out RUN` would have made, and
`gonio reduce RUN` makes the same table of it. The four directions are movable. They are numbers until the camera is
triggered: then the engine drives the arms, finds the exposures and takes the frames of every band. Darks and visits to
the white reference come between the points where they belong.
"""

import math
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from gonio.errors import ConfigError, Interrupted
from gonio.geometry import ANGLES
from gonio.lab.acquisition import measure
from gonio.lab.acquisition.plan import Plan, Point, canonical, load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_folder import begun
from gonio.lab.rig import Frame, Pose, Rig, Step
from gonio.lab.rig.description import RigDescription
from gonio.platform import command_line
from gonio.samples.description import SampleDescription
from gonio.typing import JsonObject
from gonio_bluesky.devices import Plotted, Reading, Setting, Status, number

DIGITS = 7
"""Decimals in which angles [deg] agree that count as one, as in a plan (`gonio.lab.acquisition.plan.SAME_DEG`)."""


class Direction(Setting[float]):
    """One of the four angles of a point [deg]: movable, readable, locatable, stoppable; used at the next trigger."""

    source = "plan"

    def __init__(self, measurement: "Measurement", name: str) -> None:
        super().__init__(name, 0.0, "deg", self._require)
        self.hints: JsonObject = {"fields": [name]}
        self._measurement = measurement

    def _require(self, value: float) -> None:
        """Raise `ConfigError` where no direction has such an angle [deg]."""
        lower, upper = {"theta_i": (0.0, 90.0), "theta_r": (-180.0, 180.0)}.get(self.name, (-360.0, 360.0))
        if not lower <= value <= upper:
            raise ConfigError(f"{self.name} = {value:g} deg is outside {lower:g} to {upper:g} deg")

    def set(self, value: float) -> Status:
        """Name the angle of the next point [deg]."""
        return super().set(float(value))

    def stop(self, success: bool = True) -> None:
        """Nothing moves by `set`. Where the plan has failed, the measurement ends after the step that it is in."""
        if not success:
            self._measurement.interrupt()

    def locate(self) -> dict[str, float]:
        """The angle that was named [deg]; what the encoders read is in the readings of the camera."""
        return {"setpoint": self.value, "readback": self.value}


class StepCamera(Plotted):
    """Triggering it takes the whole step of the point that the directions name."""

    def __init__(self, measurement: "Measurement") -> None:
        super().__init__("camera", "camera_level_per_s")
        self._measurement = measurement

    def trigger(self) -> Status:
        """Take the step; the status is done when its frames have been taken.

        Raises `ConfigError`, before anything moves, where the directions are no point of the plan, or not its next.
        """
        return self._measurement.take()

    def read(self) -> dict[str, Reading]:
        """Which step it was, and where the axes stood; NaN and step -1 for a point that the rig cannot measure."""
        return self._readings({f"{self.name}_{key}": value for key, value in self._measurement.last.items()})

    def describe(self) -> JsonObject:
        """The data keys of `read`."""
        units = {"exposure_s": "s", "level_per_s": "1/s", "time_s": "s"}
        whole = {"dtype": "integer", "dtype_numpy": "<i8"}
        keys: JsonObject = {
            key: number("engine", units.get(key, "deg" if key.endswith("_deg") else ""))
            for key in self._measurement.last
        }
        return {f"{self.name}_{key}": of | (whole if key in ("step", "point") else {}) for key, of in keys.items()}


class Measurement:
    """A run that goes on point by point; see `measurement`.

    `theta_i`, `phi_i`, `theta_r`, `phi_r` are the movable directions, `camera` is the detector.
    """

    def __init__(self, plan: Plan, choice: measure.RigChoice, out: Path, given: JsonObject) -> None:
        self._plan, self._choice, self._out, self._given = plan, choice, out, given
        self.theta_i, self.phi_i, self.theta_r, self.phi_r = (Direction(self, name) for name in ANGLES)
        self.camera = StepCamera(self)
        steps = choice.schedule(plan)
        self._scheduled = len(steps)
        self._order = [step.point for step in steps if step.point is not None]
        self._measurable = frozenset(self._order)
        self._rows = {_key(point): row for row, point in reversed(list(enumerate(plan.points)))}
        self._next = 0
        """Place of the next step in `_order`; all before it are done."""
        self._gate = _Gate(self._scheduled)
        self._done: set[int] = set()
        self._thread: threading.Thread | None = None
        self.last: JsonObject = {}
        """What the camera reads of the last point."""
        self._note(None)

    @property
    def directions(self) -> list[Direction]:
        """theta_i, phi_i, theta_r, phi_r."""
        return [self.theta_i, self.phi_i, self.theta_r, self.phi_r]

    def points(self) -> list[Any]:
        """What `list_scan` takes after its detectors: each direction, and its angles [deg] in the order of the run.

        Points that the rig cannot measure come last; at them nothing moves.
        """
        rest = [row for row in range(len(self._plan.points)) if row not in self._measurable]
        listed = [self._plan.points[row] for row in [*self._order, *rest]]
        angles = [[getattr(point, f"{name}_deg") for point in listed] for name in ANGLES]
        return [part for pair in zip(self.directions, angles, strict=True) for part in pair]

    @property
    def complete(self) -> bool:
        """Whether every point that the rig can measure has been."""
        return self._done >= self._measurable

    # ---- what the devices ask for ----

    def take(self) -> Status:
        """Take the step of the point that the directions name."""
        row = self._row()
        if row in self._done or row not in self._measurable:
            self._note(row)
            return Status.finished()
        while self._order[self._next] in self._done:
            self._next += 1
        expected = self._order[self._next]
        if row != expected:
            raise ConfigError(
                f"{self._said(self._plan.points[row])} is not the next point of the run: that is "
                f"{self._said(self._plan.points[expected])}. A run has one order, and points() has it"
            )
        status = Status()

        def taken(error: BaseException | None) -> None:
            if error is None:
                self._done.add(row)
                self._note(row)
            status.finish(error)

        self._gate.want(row, taken)
        return status

    def interrupt(self) -> None:
        """End the measurement after the step that it is in; it can be resumed."""
        self._gate.end(whole=False)

    def _row(self) -> int:
        point = canonical(*(direction.value for direction in self.directions))
        row = self._rows.get(_key(point))
        if row is not None:
            return row
        raise ConfigError(f"{self._said(point)} is no point of the plan {self._plan.source}: points() has them")

    @staticmethod
    def _said(point: Point) -> str:
        return ", ".join(f"{name} = {getattr(point, f'{name}_deg'):g}" for name in ANGLES) + " deg"

    def _note(self, row: int | None) -> None:
        seen = self._gate.seen if row is not None and row == self._gate.row else _Seen()
        read = ("step", "exposure_s", "level_per_s", "time_s")
        self.last = {"point": -1 if row is None else row} | {name: getattr(seen, name) for name in read}
        for name in self._choice.description.axes():
            self.last[f"{name}_deg"] = math.nan if seen.pose is None else math.degrees(getattr(seen.pose, name))

    # ---- the engine, in a thread of its own ----

    def __enter__(self) -> Self:
        if self._given["resume"] and begun(self._out):
            self._done = {step.point for step in Run.open(self._out).steps() if step.point is not None}
        choice = (replace(self._choice, plugin=_Gated(self._choice.plugin, self._gate)),)
        self._thread = threading.Thread(target=self._measure, args=choice, name="gonio-bluesky-engine")
        self._thread.start()
        try:
            self._gate.wait_until_open()
        except BaseException:
            self._close(whole=False)
            raise
        return self

    def _measure(self, choice: measure.RigChoice) -> None:
        try:
            measure.carry_out(self._plan, choice, self._out, command=command_line(), **self._given)
            self._gate.left(None)
        except BaseException as error:  # whoever waits is told
            self._gate.left(error)

    def _close(self, *, whole: bool) -> None:
        self._gate.end(whole=whole)
        if self._thread is not None:
            self._thread.join()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close(whole=self.complete and error is None)
        failed = self._gate.error
        if error is None and failed is not None and not isinstance(failed, Interrupted):
            raise failed


@dataclass
class _Seen:
    """What has been seen of a step while it was taken."""

    step: int = -1
    pose: Pose | None = None
    exposure_s: float = math.nan
    level_per_s: float = math.nan
    time_s: float = math.nan


class _Gate:
    """Where the engine waits until Bluesky wants its next step."""

    def __init__(self, scheduled: int) -> None:
        self._scheduled = scheduled
        self._changed = threading.Condition()
        self._open = self._over = False
        self._ending: bool | None = None
        """None: goes on. True: what is left of the schedule is taken. False: it ends as it stands."""
        self._told: Any = None
        self._begun = False
        self.row: int | None = None
        """The point that is wanted, or was last."""
        self.seen = _Seen()
        self.error: BaseException | None = None

    # from Bluesky's side

    def wait_until_open(self) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._open or self._over)
            if self.error is not None:
                raise self.error

    def want(self, row: int, told: Any) -> None:
        with self._changed:
            if self._over:
                told(self.error or Interrupted("the measurement has ended"))
                return
            self.row, self._told, self._begun, self.seen = row, told, False, _Seen()
            self._changed.notify_all()

    def end(self, *, whole: bool) -> None:
        with self._changed:
            if self._ending is None:
                self._ending = whole
            self._changed.notify_all()

    # from the engine's side

    def entered(self) -> None:
        with self._changed:
            self._open = True
            self._changed.notify_all()

    def pass_by(self, step: Step) -> None:
        """Called before a step: what was wanted is there, if this is another; then wait until this one is wanted."""
        if step.index >= self._scheduled:
            return  # visits to the reference that belong to the step that is wanted, or to a resumed run
        with self._changed:
            if self._begun and step.index != self.seen.step:
                self._tell(None)
            self._changed.wait_for(lambda: self._told is not None or self._ending is not None)
            if self._ending is False or (self._ending and step.kind == "point"):
                raise Interrupted("stopped")
            if step.kind == "point" and not self._begun:
                self._begun, self.seen = True, _Seen(step.index)

    def left(self, error: BaseException | None) -> None:
        with self._changed:
            self._over, self.error = True, error
            if self._told is not None:
                self._tell(error or (None if self._begun else Interrupted("the measurement has ended")))
            self._changed.notify_all()

    def _tell(self, error: BaseException | None) -> None:
        told, self._told, self._begun = self._told, None, False
        told(error)


class _Gated:
    """A rig's plugin whose rigs wait at a gate."""

    def __init__(self, plugin: Any, gate: _Gate) -> None:
        self._plugin, self._gate = plugin, gate
        self.toml: str = plugin.toml

    def open(self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool) -> Rig:
        """The rig, built."""
        rig = self._plugin.open(description, sample=sample, seed=seed, confirm=confirm)
        return cast("Rig", _GatedRig(rig, self._gate))


class _Watched:
    """A device, or a rig, of which some things are others; all else is its own."""

    def __init__(self, device: Any, **instead: Any) -> None:
        self._device = device
        vars(self).update(instead)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


class _GatedRig(_Watched):
    """A rig that waits at a gate before every step, and what is seen of whose arms and camera is noted there."""

    def __init__(self, rig: Rig, gate: _Gate) -> None:
        arms = _Watched(rig.arms, move=self._move)
        camera = _Watched(rig.camera, capture=self._capture, expose=None)  # at a gate a frame would wait for the plan
        super().__init__(rig, arms=arms, camera=camera)
        self._gate = gate

    def _move(self, goal: Pose) -> Pose:
        pose: Pose = self._device.arms.move(goal)
        self._gate.seen.pose = pose
        return pose

    def _capture(self, exposure_s: float) -> Frame:
        frame: Frame = self._device.camera.capture(exposure_s)
        seen = self._gate.seen
        if math.isnan(seen.time_s):
            seen.time_s = frame.time_s
        top = (float(frame.mosaic.max()) - frame.black_level_dn) / (frame.white_level_dn - frame.black_level_dn)
        seen.exposure_s, seen.level_per_s = frame.exposure_s, top / frame.exposure_s
        return frame

    def begin(self, step: Step) -> None:
        self._gate.pass_by(step)
        self._device.begin(step)

    def __enter__(self) -> Self:
        self._device.__enter__()
        self._gate.entered()
        return self

    def __exit__(self, *how: Any) -> None:
        self._device.__exit__(*how)


def measurement(
    plan: str | Path | Plan,
    *,
    rig: str | measure.RigChoice,
    out: str | Path,
    sample: str | Path | SampleDescription | None = None,
    seed: int = 0,
    resume: bool = False,
    yes: bool = False,
) -> Measurement:
    """A run into the folder `out`, point by point as a Bluesky plan asks for them. Enter it: that opens the rig.

    Parameters
    ----------
    plan
        A plan file, or a plan.
    rig
        "sim", another entry point, or the path of a rig file; or what `find_rig` makes of them.
    out
        The folder of the run, empty or absent; with `resume` one that has begun.
    sample, seed
        Of a simulated rig.
    resume
        Go on with a run: points that it has are not taken again.
    yes
        Ask for no confirmation when sample and reference are swapped by hand.

    Raises
    ------
    ConfigError
        Plan, rig or sample is wrong, or no point can be reached. Entering it raises what `gonio measure` would say.
    """
    choice = measure.find_rig(rig) if isinstance(rig, str) else rig
    loaded = plan if isinstance(plan, Plan) else load_plan(plan)
    if loaded.adaptive is not None:
        raise ConfigError(f"{loaded.source}: [adaptive] chooses its points itself; measure it with `gonio measure`")
    described = measure.load_sample(sample) if isinstance(sample, (str, Path)) else sample
    return Measurement(loaded, choice, Path(out), {"sample": described, "seed": seed, "resume": resume, "yes": yes})


def _key(point: Point) -> tuple[float, ...]:
    """Equal for points with the same directions; along the normal there is no azimuth."""
    theta_i, theta_r = round(point.theta_i_deg, DIGITS), round(point.theta_r_deg, DIGITS)
    phi_i, phi_r = (round(phi, DIGITS) % 360.0 for phi in (point.phi_i_deg, point.phi_r_deg))
    return theta_i, phi_i if theta_i else 0.0, theta_r, phi_r if theta_r else 0.0
