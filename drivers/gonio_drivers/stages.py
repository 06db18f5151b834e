"""Motorised stages by name: entry points of the group `gonio.stages`, ours and others' alike.

An entry point names a callable `(table, key) -> stage`: the table of one axis in the rig file, and its name for
messages. What it returns speaks for one axis, in degrees of the stage's own readout; it touches no device before it is
entered. docs/writing_a_driver.md shows one.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from gonio import plugins
from gonio.documents import TomlTable
from gonio.errors import DeviceError
from gonio.rig import Reading
from gonio_drivers import settings

log = logging.getLogger("gonio.devices")

STOPS_DEG = 2.0
"""What the reading of an axis that leans against a hard stop may lie beyond it."""


@dataclass(frozen=True, slots=True)
class StageState:
    """What a stage says of itself."""

    position_deg: float
    """In the stage's own readout, counted from its home."""
    moving: bool
    homed: bool
    """Its readout means something: it has found its home since it was switched on."""
    fault: str = ""
    """What it complains of, in words; "" where it is well."""


class Stage(Protocol):
    """One motorised axis, as the context in which it is open. Every method raises `DeviceError` where it fails.

    Angles are those of the stage's readout [deg]. A driver may have an attribute `absolute = True`: it needs no home.
    """

    @property
    def axis(self) -> settings.StageAxis:
        """Its table of the rig file."""

    def __enter__(self) -> Self:
        """Open the line and see who is there; nothing turns."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def prepare(self, speed_deg_per_s: float, acceleration_deg_per_s2: float) -> None:
        """Set the motion's profile, and see that the stage has taken it; nothing turns."""

    def state(self) -> StageState:
        """What it says now; an answer to an earlier question is not good enough."""

    def go(self, position_deg: float) -> None:
        """Start a move to a readout, and return at once."""

    def home(self) -> None:
        """Start the search for home, and return at once."""

    def stop(self) -> None:
        """Come to rest at once, whatever it is doing."""


def build(driver: str, table: TomlTable, key: str) -> Stage:
    """The stage that a table of the rig file describes; `key` is its name, for messages.

    Raises
    ------
    ConfigError
        There is no such driver, or one of its keys is wrong.
    """
    stage: Stage = plugins.load("gonio.stages", driver)(table, key)
    return stage


@dataclass(slots=True)
class Joint:
    """An axis of the rig and its stage: angles, and what the stage's readout is there."""

    name: str
    stage: Stage
    limits_deg: tuple[float, float]
    speed_deg_per_s: float
    offset_deg: float
    """What the encoder reads at the true zero, as far as it is known."""
    still_deg: float
    approach_deg: float = 1.0
    """How far from its goal the last part of its way begins: below it, or above where this is negative."""
    backlash_deg: float = 0.0
    hard_stops_deg: tuple[float, float] | None = None
    stood_at: float | None = None
    """Where it landed [deg]; None where nobody knows."""

    @property
    def key(self) -> str:
        """The table of the rig file that describes it."""
        return f"devices.stages.axes.{self.name}"

    @property
    def park_deg(self) -> float | None:
        """Where it rests, if the rig file says so."""
        return self.stage.axis.park_deg

    def to_deg(self, readout_deg: float) -> float:
        """Angle of the axis, with the zero offset taken out."""
        return (readout_deg - self.stage.axis.zero_deg) * self.stage.axis.direction - self.offset_deg

    def to_readout(self, angle_deg: float) -> float:
        """What the stage shows at an angle of the axis."""
        return self.stage.axis.zero_deg + (angle_deg + self.offset_deg) * self.stage.axis.direction

    def approach_start(self, goal_deg: float) -> float:
        """Where the last part of the way to a goal begins [deg]; a limit is not crossed on the way either."""
        lower, upper = self.limits_deg
        return min(max(goal_deg - self.approach_deg, lower), upper)

    def warn_of_play(self, goal_deg: float) -> None:
        """Say so where a limit leaves no way that takes up the axis's backlash."""
        way = abs(goal_deg - self.approach_start(goal_deg))
        if way < min(self.backlash_deg, abs(self.approach_deg)):
            log.warning(
                "axis %s at %g deg, %.2f deg from its limit: its backlash of %g deg is not taken up there, and it may "
                "stand that far off what it reads", self.name, goal_deg, way, self.backlash_deg,
            )  # fmt: skip

    def require_between_stops(self) -> None:
        """Raise `DeviceError` where it reads an angle beyond what stops it: then its zero is wrong, and its limits."""
        if self.hard_stops_deg is None:
            return
        at, (lower, upper) = self.angle_deg(), self.hard_stops_deg
        if not lower - STOPS_DEG <= at <= upper + STOPS_DEG:
            raise DeviceError(
                f"axis {self.name} reads {at:.2f} deg, beyond its hard stops at {lower:g} and {upper:g} deg: its zero "
                f"is wrong (zero_offset_deg of the axis, or {self.key}.zero_deg or direction)"
            )

    def state(self) -> StageState:
        """What the stage says, where it is well; `DeviceError` where it is not."""
        said = self.stage.state()
        if said.fault:
            raise DeviceError(f"axis {self.name}: {self.stage} reports: {said.fault}; remove the cause")
        if not math.isfinite(said.position_deg):
            raise DeviceError(f"axis {self.name}: {self.stage} reads {said.position_deg}")
        return said

    def angle_deg(self) -> float:
        """Where it stands."""
        said = self.state()
        self.require_home(said)
        return self.to_deg(said.position_deg)

    def require_home(self, said: StageState) -> None:
        """Raise `DeviceError` where the stage's readout means nothing."""
        if not said.homed and not getattr(self.stage, "absolute", False):
            raise DeviceError(
                f"axis {self.name}: {self.stage} has not found its home since it was switched on, so that its readout "
                f'means nothing; clear its whole way and set {self.key}.home = "on-opening", or home it by the program '
                "of its maker"
            )


def readings(joint: Joint, said: StageState) -> list[Reading]:
    """An angle only where the readout means one."""
    name, known = joint.name, said.homed or getattr(joint.stage, "absolute", False)
    angle = [Reading(name, "angle", joint.to_deg(said.position_deg), "deg", joint.limits_deg)] if known else []
    return [
        *angle,
        Reading(name, "motion", "moves" if said.moving else "still"),
        Reading(name, "home", "home found" if known else "home not found since it was switched on"),
        Reading(name, "error", said.fault or "none"),
    ]
