"""What scans and snapshots take of a rig that a person moves: `gonio.by_hand.manual_rig.ManualRig` has it."""

from dataclasses import dataclass
from typing import Protocol

from gonio.rig import Pose
from gonio.rig.bands import Band
from gonio.rig.description import RigDescription
from gonio.rig.protocols import CameraDevice, LightDevice


@dataclass(frozen=True, slots=True)
class Moved:
    """What a move has come to."""

    asked: dict[str, float]
    """Goals by axis [rad]."""
    landed: dict[str, float]
    """What the encoders read there [rad]."""
    branch: str = ""
    """Of a move by directions: which way of reaching them was taken, and on further lines what of the others."""


class Movable(Protocol):
    """A rig whose axes are moved one by one."""

    @property
    def description(self) -> RigDescription:
        """What its file says."""

    @property
    def light(self) -> LightDevice:
        """Its lamp."""

    @property
    def camera(self) -> CameraDevice:
        """Its camera."""

    @property
    def band(self) -> Band:
        """What is looked at."""

    def pose(self) -> Pose | None:
        """Where the axes stand; None where one does not tell."""

    def check(self, goals: dict[str, float]) -> None:
        """Raise `ConfigError` where the axes cannot go to these goals [rad]."""

    def move(self, **angles: float) -> Moved:
        """Move axes [rad]."""

    def lamp(self, level: float | bool, *, wavelength_nm: float | None = None) -> None:
        """Light or darken the lamp."""
