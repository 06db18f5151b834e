"""A rig with errors of alignment: where lamp and lens truly are, and which pose brings them where they should be.

Angles here are true angles of the axes (`kinematics.true_pose`). Rotations are right-handed, Rx, Ry and Rz about x, y
and z of the lab (docs/pose_to_pixel.md).
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from gonio.geometry import AT_LIMIT
from gonio.rig.description import ArmAxis, Arms, Holder, RigDescription
from gonio.rig.protocols import Pose
from gonio.typing import Floats

STEPS = 40
PROBE = 1e-7
"""Of differences [rad]: their slopes are good to as much, and every step brings the pose as much closer."""
LONGEST_STEP = 0.3
"""Of one axis in one step [rad]: near a singular pose a longer one leads astray."""
HALVINGS = 10
CONVERGED = 1e-9
"""Directions that differ by less [rad] are the same."""
DIRECTIONS = 4
"""Numbers that two directions are made of: a rig with as many axes can show all of them."""
NAMES = ("light", "camera", "tilt", "spin", "azimuth")
FLAT = 1e-6
"""Combinations of axes that turn the directions less than this, per radian, are left alone."""


def ends(description: RigDescription, pose: Pose) -> tuple[Floats, Floats, Floats, Floats]:
    """Where lamp and lens are in the frame of the sample [mm], the rotation into it from the camera arm's frame, and
    the axis of the light arm in it."""
    arms, holder = description.arms, description.holder
    # each arm: its axis is tilted and displaced, and what it carries stands out of the plane across it
    of_light = _about_x_after(arms.light.axis_tilt_deg, "z")
    lamp = _carried(arms.light, of_light @ _rotation("y", pose.light), description.geometry.light_distance_mm)
    onto = _about_x_after(arms.camera.axis_tilt_deg, "z") @ _rotation("y", pose.camera)
    lens = _carried(arms.camera, onto, description.geometry.camera_distance_mm)
    if arms.azimuth is not None:
        upright = _about_x_after(arms.azimuth.axis_tilt_deg, "y")
        turn = upright @ _rotation("z", pose.azimuth) @ upright.T
        foot = np.array([*arms.azimuth.axis_offset_mm, 0.0])
        lens, onto = foot + turn @ (lens - foot), turn @ onto
    # the tilt turns about an axis that passes by the spin's; the surface lies and stands beside the spin axis
    upright = _rotation("y", math.radians(holder.spin_axis_tilt_deg)) @ _rotation("z", pose.spin)
    onto_sample = (upright @ _about_x_after(holder.surface_tilt_deg, "y")).T
    into = onto_sample @ _rotation("x", pose.tilt)
    tilted_about = np.array([0.0, holder.tilt_axis_offset_mm, 0.0])
    centre = np.array([*holder.sample_offset_mm, holder.surface_offset_mm])
    shift = onto_sample @ tilted_about - into @ tilted_about - centre
    return into @ lamp + shift, into @ lens + shift, into @ onto, into @ of_light[:, 1]


@lru_cache(maxsize=64)
def frames(arms: Arms, holder: Holder) -> Floats:
    """How the axes of a rig stand, shape (4, 3, 4): a rotation, and a shift [mm] in the last column.

    Of the light arm's axis, of the camera arm's, of the azimuth axis, and of the spin axis on the tilt axis. What is
    carried stands at `shift + rotation Ry(arm) p`; the azimuth turns that, and the tilt what is spun, around `shift`.
    """
    out = np.zeros((4, 3, 4))
    for k, arm in enumerate((arms.light, arms.camera)):
        out[k, :, :3] = _about_x_after(arm.axis_tilt_deg, "z")
        out[k, :, 3] = arm.axis_offset_mm[0], 0.0, arm.axis_offset_mm[1]
    out[2, :, :3] = np.eye(3)
    if arms.azimuth is not None:
        out[2, :, :3] = _about_x_after(arms.azimuth.axis_tilt_deg, "y")
        out[2, :2, 3] = arms.azimuth.axis_offset_mm
    out[3, :, :3] = _rotation("y", math.radians(holder.spin_axis_tilt_deg))
    out[3, 1, 3] = holder.tilt_axis_offset_mm
    return out


def patch(holder: Holder) -> tuple[Floats, Floats]:
    """The middle of the sample [mm], and its axes as columns, in the frame of what is on the spin axis."""
    surface = _about_x_after(holder.surface_tilt_deg, "y")
    centre: Floats = surface @ np.array([*holder.sample_offset_mm, holder.surface_offset_mm])
    return centre, surface


def head(axis: ArmAxis, distance_mm: float) -> tuple[float, float, float]:
    """Where lamp or lens is on its arm [mm]."""
    up = math.radians(axis.elevation_deg)
    return 0.0, distance_mm * math.sin(up), distance_mm * math.cos(up)


def camera_on_arm(description: RigDescription) -> Floats:
    """Columns: image_x, image_y and optical axis in the frame of the camera arm, whose z points to where it stands."""
    camera = description.camera
    return _camera_on_arm(description.arms.camera.elevation_deg, camera.pointing_deg, camera.roll_deg)


def closest_pose(description: RigDescription, start: Pose, wanted: Floats) -> tuple[Pose, float]:
    """The pose that brings source and detector to given directions, or as close as the way from a start leads, and how
    far off it is [rad].

    Gauss-Newton's method over all axes that the rig has. `wanted` is the unit vector to the source, and after it that
    to the detector.
    """
    names = list(description.axes())

    def off(place: Floats) -> Floats:
        source, eye, *_ = ends(description, replace(start, **dict(zip(names, place.tolist(), strict=True))))
        return np.concatenate([source / math.sqrt(source @ source), eye / math.sqrt(eye @ eye)]) - wanted

    at = np.array([getattr(start, name) for name in names])
    error = off(at)
    for _ in range(STEPS):
        size = math.sqrt(error @ error)
        if size < AT_LIMIT:
            break
        slopes = np.stack([(off(at + PROBE * unit) - error) / PROBE for unit in np.eye(len(names))], axis=1)
        step = np.linalg.lstsq(slopes, -error, rcond=FLAT)[0]
        step *= min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))
        for _ in range(HALVINGS):
            then = off(at + step)
            if math.sqrt(then @ then) < size:
                break
            step *= 0.5
        else:
            break
        at, error = at + step, then
    return (
        replace(start, **dict(zip(names, at.tolist(), strict=True))),
        max(float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))),
    )


def _carried(axis: ArmAxis, onto: Floats, distance_mm: float) -> Floats:
    """Where an arm's lamp or lens is in the lab [mm]."""
    x, z = axis.axis_offset_mm
    return np.asarray(np.array([x, 0.0, z]) + onto @ np.array(head(axis, distance_mm)))


@lru_cache(maxsize=1024)
def _about_x_after(tilt_deg: tuple[float, float], other: str) -> Floats:
    """Rx(first) R_other(second), of two small angles [deg]."""
    return np.asarray(_rotation("x", math.radians(tilt_deg[0])) @ _rotation(other, math.radians(tilt_deg[1])))


@lru_cache(maxsize=1024)
def _camera_on_arm(elevation_deg: float, pointing_deg: tuple[float, float], roll_deg: float) -> Floats:
    down = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    columns, rows = (math.radians(angle) for angle in pointing_deg)
    own = _rotation("y", columns) @ _rotation("x", -rows) @ _rotation("z", math.radians(roll_deg))
    return np.asarray(_rotation("x", -math.radians(elevation_deg)) @ down @ own)


def _rotation(about: str, angle: float) -> Floats:
    """Right-handed rotation matrix about x, y or z by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    if about == "x":
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    if about == "y":
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
