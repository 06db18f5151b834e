"""Outlines of a rig's bodies at a pose, for pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gonio.rig.bodies import CARRIERS
from gonio.rig.description import Cable, RigDescription
from gonio.rig.motion_planning import _angles, _space_of
from gonio.rig.protocols import Pose
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
    from gonio.rig import _clearance

    space = _space_of(description)
    angles, out = space.true_angles(_angles(pose)), []
    for shape in space.shapes:
        points = np.empty((len(shape.points), 3))
        on = np.array([CARRIERS.index(each) for each in shape.on])
        _clearance.placed(on, np.array(shape.points), len(points), angles, space.frames, points)
        out.append(Outline(shape.body, shape.on, points, shape.radius, shape.cable))
    return out


def cable_ends(description: RigDescription, pose: Pose, cable: Cable) -> Floats:
    """Where the two ends of a cable are in the lab, shape (2, 3) [mm]."""
    from gonio.rig import _clearance

    space, out = _space_of(description), np.empty((2, 3))
    on = np.array([CARRIERS.index(cable.from_on), CARRIERS.index(cable.to_on)])
    points = np.array([cable.from_mm, cable.to_mm])
    _clearance.placed(on, points, 2, space.true_angles(_angles(pose)), space.frames, out)
    return out
