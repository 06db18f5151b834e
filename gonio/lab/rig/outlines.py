"""Outlines of a rig's bodies at a pose, for pictures."""

from gonio.lab.rig.bodies import Hull, placed
from gonio.lab.rig.description import Cable, RigDescription
from gonio.lab.rig.motion_planning import _angles, _space_of
from gonio.lab.rig.protocols import Pose
from gonio.typing import Floats


def outlines(description: RigDescription, pose: Pose) -> list[tuple[Hull, Floats]]:
    """The two heads, the bodies, and the cables that hang, with their points in the lab, shape (n, 3) [mm]."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return [(each, placed(each.on, each.points, angles, space.frames)) for each in space.shapes]


def cable_ends(description: RigDescription, pose: Pose, cable: Cable) -> Floats:
    """Where the two ends of a cable are in the lab, shape (2, 3) [mm]."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return placed((cable.from_on, cable.to_on), (cable.from_mm, cable.to_mm), angles, space.frames)
