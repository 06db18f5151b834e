"""Outlines of a rig's bodies at a pose, for pictures."""

from dataclasses import dataclass

from gonio.lab.rig.bodies import placed
from gonio.lab.rig.description import Cable, RigDescription
from gonio.lab.rig.motion_planning import _angles, _space_of
from gonio.lab.rig.protocols import Pose
from gonio.typing import Floats


@dataclass(frozen=True, slots=True)
class Outline:
    """A body where it stands: all within `radius` of the hull of some points of the lab, shape (n, 3) [mm]."""

    name: str
    on: tuple[str, str]
    points: Floats
    radius: float
    cable: bool


def outlines(description: RigDescription, pose: Pose) -> list[Outline]:
    """The two heads, the bodies, and the cables that hang, for a picture."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return [
        Outline(each.body, each.on, placed(each.on, each.points, angles, space.frames), each.radius, each.cable)
        for each in space.shapes
    ]


def cable_ends(description: RigDescription, pose: Pose, cable: Cable) -> Floats:
    """Where the two ends of a cable are in the lab, shape (2, 3) [mm]."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return placed((cable.from_on, cable.to_on), (cable.from_mm, cable.to_mm), angles, space.frames)
