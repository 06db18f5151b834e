"""What arms of servos and arms of stages have in common: what is refused, moves, parking, failures."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, NoReturn, TypeVar

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Health, Pose, motion_planning
from gonio.lab.rig.description import Axis, RigDescription
from gonio.lab.rig.kinematics import AXES
from gonio_drivers import log

ROUNDING_DEG = 1e-6
STOPS_DEG = 2.0
"""What the reading of an axis that leans against a hard stop may lie beyond it."""


@dataclass(frozen=True, slots=True)
class ArmsReading:
    """Positions of the axes and when they were read, in seconds of the drivers' clock."""

    pose: Pose
    time_s: float
    counts: Mapping[str, float] = field(default_factory=dict)
    spread: Pose = field(default_factory=Pose)
    """The largest less the smallest of several readings [rad]."""


@dataclass
class AnyJoint(ABC):
    """An axis and what turns it."""

    name: str
    axis: Axis
    limits_deg: tuple[float, float]
    approach_deg: float
    """From how far below its goal it arrives; negative: from above."""
    hard_stops_deg: tuple[float, float] | None
    stood_at: float | None = field(default=None, kw_only=True)
    """What was read where it landed; None where it may have been moved since."""

    @property
    @abstractmethod
    def key(self) -> str:
        """The table of the rig file that describes it."""

    @property
    @abstractmethod
    def park_deg(self) -> float | None:
        """Where it rests, if the rig file says so."""

    @abstractmethod
    def run_up_deg(self, goal_deg: float) -> float:
        """How long the last part of its way to a goal is, inside its limits [deg]."""

    @property
    def offset_deg(self) -> float:
        """What the encoder reads at the true zero, as far as it is known [deg]."""
        return self.axis.zero_offset_deg if self.axis.zero_offset_known else 0.0

    def warn_of_backlash(self, goal_deg: float, rounding_deg: float = 0.0) -> None:
        """Say so where a limit leaves no way that takes up the axis's backlash."""
        way = self.run_up_deg(goal_deg)
        if way < min(self.axis.backlash_deg, abs(self.approach_deg)) - rounding_deg:
            log.warning(
                "axis %s at %g deg, %.2f deg from its limit: its backlash of %g deg is not taken up there, and it may "
                "stand that far off what it reads", self.name, goal_deg, way, self.axis.backlash_deg,
            )  # fmt: skip

    def require_between_stops(self, at_deg: float, zeros: str) -> None:
        """Raise `DeviceError` where it reads an angle beyond what stops it: then its zero is wrong, and its limits."""
        lower, upper = self.hard_stops_deg or (-math.inf, math.inf)
        if not lower - STOPS_DEG <= at_deg <= upper + STOPS_DEG:
            raise DeviceError(
                f"axis {self.name} reads {at_deg:.2f} deg, beyond its hard stops at {lower:g} and {upper:g} deg: its "
                f"zero is wrong (zero_offset_deg of the axis, or {self.key}.{zeros})"
            )


def axis_of(
    description: RigDescription, name: str
) -> tuple[str, Axis, tuple[float, float], float, tuple[float, float] | None]:
    """What a joint begins with: name, axis, limits, side of approach and hard stops, as the rig file has them."""
    limits, stops = description.limits_deg()[name], description.hard_stops_deg()[name]
    return name, description.axes()[name], limits, description.approach_deg()[name], stops


J = TypeVar("J", bound=AnyJoint)


class AllAxes(ABC, Generic[J]):
    """All axes of a rig, as an `ArmsDevice`."""

    unparked = "not parked"
    """What is said of axes that are absent."""

    def __init__(self, description: RigDescription, every: dict[str, J], table: str) -> None:
        park = {n: joint.park_deg for n, joint in every.items() if n in AXES and joint.park_deg is not None}
        motion_planning.require_parking(description, park, table + ".axes.{}.park_deg")
        self._description = description
        self.every = every
        """All axes of the rig file, `absent` ones too, changer and polarisers."""
        self.joints: dict[str, J] = {}
        """The joints that are used."""
        self.last: ArmsReading | None = None
        self.faulted = False
        """An axis has failed: nothing moves any more until the rig is opened again."""
        self.stopped = False
        """Somebody has called `stop` since the last move."""
        self.partial = False
        """Open those axes that answer and are well; without it, all or none."""
        self.holds = True
        """The axes hold when this is left."""
        self.as_found = False
        """Every axis is left holding or free, as it was found when this was entered."""
        self.absent: dict[str, DeviceError] = {}
        """Axes that could not be opened (`partial`), and why; they are missing from `joints`."""
        self.allowed: Callable[[], None] = lambda: None
        """Called before axes move, and at every look while they do; raises where nothing may move."""

    @abstractmethod
    def stop(self) -> None:
        """Stop every axis where it is. Never raises."""

    @abstractmethod
    def _drive(self, goals: Mapping[str, float], *, parking: bool) -> Pose:
        """Drive axes to goals [deg], each from its side, until all have landed; the readback [rad]."""

    @abstractmethod
    def _readback(self, looks: int = 1) -> ArmsReading:
        """Where the axes stand."""

    def move(self, goal: Pose) -> Pose:
        """Drive every axis to `goal`, from its side, wait until all have landed; the encoders' readback [rad].

        Raises
        ------
        ConfigError
            A goal is beyond a limit, or the rig has no such axis; nothing has moved.
        DeviceError
            An axis does not land, or is unwell; every axis has been stopped.
        """
        self._require_all()
        return self._move(self._checked(goal))

    def jog(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Drive some axes [rad], and leave the others where they are; the readback of those [rad]; errors of `move`."""
        return self._jog(goals, parking=False)

    def strain(self) -> Health:
        """What strained the axes since this was last asked, where their controllers tell it."""
        return Health()

    def _jog(self, goals: Mapping[str, float], *, parking: bool) -> dict[str, float]:
        for name in goals:
            if name in self.absent:
                raise DeviceError(f"axis {name} cannot be moved: {self.absent[name]}")
            if name not in AXES or name not in self.every:
                raise ConfigError(f"the rig has no axis {name}; it has {', '.join(n for n in self.every if n in AXES)}")
        landed = self._move(self._checked(Pose(**goals), tuple(goals)), parking=parking)
        return {name: float(getattr(landed, name)) for name in goals}

    def park(self) -> None:
        """Drive every axis that is there to its rest position.

        Raises
        ------
        DeviceError
            As of `move`; or axes are absent, and the others have been parked.
        """
        goals = dict.fromkeys((name for name in self.every if name in AXES), 0.0)
        goals |= {"light": self.every["light"].limits_deg[0], "camera": self.every["camera"].limits_deg[1]}
        goals |= {n: j.park_deg for n, j in self.every.items() if n in AXES and j.park_deg is not None}
        wanted = {name: math.radians(angle) for name, angle in goals.items() if name in self.joints}
        for leg in self._legs(wanted):
            self._jog(leg, parking=True)
        if self.absent:
            parked = ", ".join(wanted) or "no axis"
            why = "; ".join(f"{name}: {failure}" for name, failure in self.absent.items())
            raise DeviceError(f"parked: {parked}; {self.unparked}: {why}")

    def _legs(self, goals: dict[str, float]) -> list[dict[str, float]]:
        """What to move one after the other, so that no bodies touch; all at once where an axis is absent."""
        if not self._description.looks_ahead or self.absent:
            return [goals]
        return motion_planning.legs(self._description, self._readback().pose, goals)

    def _require_all(self) -> None:
        """Raise where an axis is absent: what it would be said to read, or to do, would not be true."""
        for name, failure in self.absent.items():
            raise DeviceError(f"axis {name} is missing: {failure}")
        if not self.joints:
            raise DeviceError("the arms are not open: enter the rig first")

    def _checked(self, goal: Pose, names: Sequence[str] = AXES) -> dict[str, float]:
        """Goals [deg] by axis, or `ConfigError`."""
        out = {}
        for name in names:
            angle = math.degrees(getattr(goal, name))
            if not math.isfinite(angle):
                raise ConfigError(f"{name} = {angle}: a goal must be a finite angle")
            if name not in self.every:
                if abs(angle) > ROUNDING_DEG:
                    known = ", ".join(self.every)
                    raise ConfigError(f"{name} = {angle:g} deg: the rig has no such axis; it has {known}")
                continue
            lower, upper = self.every[name].limits_deg
            if not lower - ROUNDING_DEG <= angle <= upper + ROUNDING_DEG:
                raise ConfigError(f"{name} = {angle:g} deg is outside this axis's limits, {lower:g} to {upper:g} deg")
            out[name] = min(max(angle, lower), upper)
        return out

    def _move(self, goals: Mapping[str, float], *, parking: bool = False) -> Pose:
        if self.faulted:
            raise DeviceError("the arms have been stopped after a failure; open the rig again")
        self.stopped = False
        try:
            self.allowed()
            return self._drive(goals, parking=parking)
        except BaseException as error:
            self.stop()
            self.faulted = isinstance(error, DeviceError)
            raise

    def _fail(self, message: str) -> NoReturn:
        self.stop()
        self.faulted = True
        raise DeviceError(message)
