"""A rig of three servos, for the tests of arms: its description, its poses, and whether it lands and rests."""

import math
from typing import Any

import pytest
from gonio_drivers import settings
from gonio_drivers.arms import ServoArms
from gonio_drivers.joints import COUNTS

from gonio.lab.rig import Pose
from gonio.lab.rig.description import Acquisition, ArmAxis, Arms, Holder, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands
from tests.gonio_drivers.conftest import BAUD, Line

TOLERANCE_DEG = 0.15
COUNT_DEG = 360 / COUNTS


def describe(**axes: Any) -> RigDescription:
    return RigDescription(
        rig="lab",
        name="bench",
        arms=Arms(light=axes.get("light", ArmAxis()), camera=axes.get("camera", ArmAxis())),
        holder=axes.get("holder", Holder(axes=("tilt",))),
        reference=Reference(how="swap"),
        bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
        acquisition=Acquisition(approach_deg=1.0),
    )


def servos(port: str, **changes: Any) -> settings.Servos:
    axes = {name: {"id": k, "model": "xm430-w350"} for k, name in enumerate(("light", "camera", "tilt"), 1)}
    for name in tuple(changes):
        if name in axes:
            axes[name] |= changes.pop(name)
    table = {"port": port, "baud": BAUD, "axes": axes, "settle_s": 0.02} | changes
    return settings.Servos.model_validate(table)


def pose(light: float = 0.0, camera: float = 0.0, tilt: float = 0.0) -> Pose:
    return Pose(light=math.radians(light), camera=math.radians(camera), tilt=math.radians(tilt))


def degrees(read: Pose) -> tuple[float, float, float]:
    return math.degrees(read.light), math.degrees(read.camera), math.degrees(read.tilt)


def lands(arms: ServoArms, *goal: float, within_deg: float = TOLERANCE_DEG) -> bool:
    """Whether a move ends where it should, by the readback."""
    return degrees(arms.move(pose(*goal))) == pytest.approx(goal, abs=within_deg)


BRAKING_S = 1.0
"""A stop at 30 deg/s and 90 deg/s^2 takes 0.33 s, and the 5 deg back to where it was told to stay 0.47 s."""


def at_rest(line: Line) -> bool:
    """Whether every shaft stands, or has at most the way to go that a stop leaves, on the twins' clock."""
    return not any(
        servo.powered and servo.moves() and servo._path.end_s - servo._clock() > BRAKING_S
        for servo in line.servos.values()
    )
