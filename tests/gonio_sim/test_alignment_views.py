"""What the simulated camera sees of a mirror, and of the lamp through an empty holder: one is the other, unfolded."""

import math
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SimulatedRig

from gonio.materials import ior
from gonio.models import fresnel
from gonio.rig import Pose
from tests.gonio_sim.conftest import describe

CAMERA: dict[str, Any] = {"camera": {"width": 96, "height": 72, "pixel_um": 33.0, "cos4": False, "vignetting": 0.0}}


def rates(what: Any, pose: Pose, **changes: dict[str, Any]) -> np.ndarray[Any, Any]:
    rig = SimulatedRig(describe("sim-ideal", lamp={"half_angle_deg": 0.5}, **CAMERA, **changes), None, 0, confirm=False)
    with rig:
        rig.put(what)
        rig.world.pose = pose
        return rig.camera._renderer.rate(rig.description.bands.containing(550))


def test_the_mirror_shows_the_lamp_as_straight_through_by_its_reflectance() -> None:
    angle = math.radians(40)
    mirror = rates("mirror", Pose(light=angle, camera=-angle))
    through = rates("empty", Pose(light=angle, camera=angle - math.pi))
    f_s, f_p = fresnel.amplitudes(np.cos(angle), ior("Al")(550.0))
    reflectance = 0.5 * (abs(f_s) ** 2 + abs(f_p) ** 2)
    middle = slice(30, 42), slice(42, 54)
    assert through[middle].mean() > 0
    assert mirror[middle].mean() / through[middle].mean() == pytest.approx(
        float(reflectance), rel=2e-3
    )  # its change in view


def test_the_lamp_moves_out_of_the_middle_as_the_arm_turns() -> None:
    light = math.radians(90)
    faced = rates("empty", Pose(light=light, camera=light - math.pi))
    off = [rates("empty", Pose(light=light, camera=light - math.pi + math.radians(d))) for d in (-0.4, 0.4)]
    rows, columns = (np.indices(faced.shape) * faced).sum(axis=(1, 2)) / faced.sum()
    assert (rows, columns) == pytest.approx((35.5, 47.5), abs=1e-3)
    left, right = ((np.indices(o.shape)[1] * o).sum() / o.sum() for o in off)
    assert left + right == pytest.approx(2 * 47.5, abs=0.05)
    assert abs(left - right) > 5
