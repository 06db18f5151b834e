"""Between the axes of a described rig and the directions at its sample, both ways.

The lab frame has its origin where the sample's axes cross, on the sample's surface, y along the axis that both arms
turn about, and z where the untilted sample's normal points. With a and c the angles of light and camera arm, t the tilt
and s the spin:

    light  L = (sin a, 0, cos a)          camera  V = Rz(azimuth) (sin c, 0, cos c)
    normal n = (0, sin t, cos t)          sample frame to lab frame  M = Rx(-t) Rz(s)

The inverse rests on one fact: both arms are perpendicular to y, so y = +-(L x V)/|L x V|, and n . y = sin t. The two
signs are the two branches: they mirror the arms, change the sign of the tilt and turn the sample by half a turn.

That is the rig as it was meant. Where its description names errors of alignment, `ends` does the same
with them, and the inverse starts from the closed form and goes on by Newton's method (docs/mechanics.md). A pose
is what encoders read, less their zeros; `true_pose` takes out what else is wrong with them.

With errors of alignment it is also said where lamp and lens truly are, and which pose brings them where they should
be. Its angles are true angles of the axes (`true_pose`). Rotations are right-handed, Rx, Ry and Rz about x, y
and z of the lab (docs/mechanics.md).
"""

import math
from collections import OrderedDict
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from gonio.geometry import AT_LIMIT, SAME_ANGLE, Directions
from gonio.lab.rig.description import ArmAxis, Arms, Axis, Holder, RigDescription, approach_start
from gonio.lab.rig.protocols import Pose
from gonio.typing import Floats

STEPS = 40
PROBE = 1e-7
"""Step of differences [rad]: their slopes are good to as much, and every step brings the pose as much closer."""
LONGEST_STEP = 0.3
"""Longest step of one axis [rad]: near a singular pose a longer one leads astray."""
HALVINGS = 10
CONVERGED = 1e-9
"""Directions that differ by less [rad] are the same."""
DIRECTIONS = 4
"""Numbers that two directions are made of: a rig with as many axes can show all of them."""
AXES = tuple(field.name for field in fields(Pose))
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


Vector = tuple[float, float, float]

Angles = tuple[float, float, float, float]
"""theta_i, phi_i, theta_r, phi_r of one pair of directions: what is done for one point at a time is done in floats."""


@dataclass(frozen=True, slots=True)
class View:
    """Source and camera in the frame of the sample: origin at its centre, z its outward normal, x its x axis.

    Positions are in millimetres; `image_x` and `image_y` are the unit vectors along which columns and rows grow.
    `image_x`, `image_y` and the optical axis are right-handed: the image is not mirrored. On a rig without errors the
    optical axis points from the camera to the origin, and `image_y` lies along the axis of the arms. So does `beam_y`,
    wherever an azimuth axis has turned the camera arm.
    """

    source_mm: Floats
    camera_mm: Floats
    image_x: Floats
    image_y: Floats
    sight: Floats | None = None
    """Unit vector of the optical axis; None where it points from the camera to the origin."""
    beam_y: Floats | None = None
    """None: `image_y`."""

    @property
    def optical_axis(self) -> Floats:
        """Unit vector from the camera into the middle of what it sees."""
        eye = np.asarray(self.camera_mm, dtype=float)
        return -eye / math.sqrt(eye.dot(eye)) if self.sight is None else self.sight  # as np.linalg.norm, sooner


@dataclass(frozen=True, slots=True)
class _Range:
    """Where an axis may stand."""

    name: str
    limits_deg: tuple[float, float]
    lower: float
    """The same [rad], and `upper`."""
    upper: float
    approach_deg: float
    backlash_deg: float
    """Its backlash."""

    def takes_up_play(self, place: float) -> bool:
        """Whether the approach to a place is as long as the axis's backlash, or as long as it is away from limits."""
        at = math.degrees(place)
        start = approach_start(at, self.approach_deg, *self.limits_deg)
        return abs(at - start) >= min(self.backlash_deg, abs(self.approach_deg)) - 1e-9


@dataclass(frozen=True, slots=True)
class _Known:
    """What follows from a description alone, and is asked for at every pose."""

    as_meant: bool
    erring: dict[str, ArmAxis]
    """The axes whose encoders have errors within their turn."""
    blocked_cone: float
    ranges: tuple[_Range, ...]


_KEPT = 8
_kept: OrderedDict[int, tuple[RigDescription, _Known]] = OrderedDict()
"""By the identity of descriptions, which are frozen: to compare or to hash one takes longer than a pose."""


def _known(description: RigDescription) -> _Known:
    found = _kept.get(id(description))
    if found is not None and found[0] is description:
        return found[1]
    g, axes, approach = description.geometry, description.axes(), description.approach_deg()
    known = _Known(
        as_meant=description.as_meant,
        erring={name: axis for name, axis in description.arms.axes().items() if axis.harmonics_deg},
        blocked_cone=math.asin(min(1.0, g.light_body_radius_mm / g.light_distance_mm))
        + math.asin(min(1.0, g.camera_body_radius_mm / g.camera_distance_mm)),
        ranges=tuple(
            _Range(
                name, limits, math.radians(limits[0]), math.radians(limits[1]), approach[name], axes[name].backlash_deg
            )
            for name, limits in description.limits_deg().items()
        ),
    )
    _kept[id(description)] = (description, known)
    while len(_kept) > _KEPT:
        _kept.popitem(last=False)
    return known


def true_pose(description: RigDescription, pose: Pose) -> Pose:
    """Where the axes stand when their encoders read a pose: the errors of encoders within their turn taken out.

    The only place where that happens. What stands elsewhere as a pose is what encoders read, less their zeros.
    """
    erring = _known(description).erring
    if not erring:
        return pose
    return replace(pose, **{n: getattr(pose, n) - encoder_error(axis, getattr(pose, n)) for n, axis in erring.items()})


def read_pose(description: RigDescription, true: Pose) -> Pose:
    """What the encoders read where the axes stand: the inverse of `true_pose`."""
    erring, out = _known(description).erring, {}
    for name, axis in erring.items():
        stands: float = getattr(true, name)
        read = stands
        for _ in range(ENCODER_STEPS):  # errors change slowly with the angle, so that this closes in fast
            before, read = read, stands + encoder_error(axis, read)
            if abs(read - before) < 0.1 * AT_LIMIT:
                break
        out[name] = read
    return replace(true, **out) if out else true


def encoder_error(axis: Axis, read: float) -> float:
    """What an encoder reads too much [rad], beside its zero, where it reads an angle [rad]."""
    if not isinstance(axis, ArmAxis):
        return 0.0
    return math.radians(sum(c * math.cos(k * read) + s * math.sin(k * read) for k, c, s in axis.harmonics_deg))


def view(description: RigDescription, pose: Pose) -> View:
    """Where source and camera are, and how the image lies, in the sample's frame, for a pose of the axes."""
    if not _known(description).as_meant:
        source, eye, onto, beam_y = ends(description, true_pose(description, pose))
        image_x, image_y, sight = np.ascontiguousarray((onto @ camera_on_arm(description)).T)
        return View(source_mm=source, camera_mm=eye, image_x=image_x, image_y=image_y, sight=sight, beam_y=beam_y)
    light, camera, *axes = map(np.array, _sample_frame(true_pose(description, pose)))
    geometry, (image_x, image_y, beam_y) = description.geometry, axes
    source, eye = geometry.light_distance_mm * light, geometry.camera_distance_mm * camera
    return View(source_mm=source, camera_mm=eye, image_x=image_x, image_y=image_y, beam_y=beam_y)


def directions(description: RigDescription, pose: Pose) -> Directions:
    """The directions at the centre of the sample for a pose; polar angles above pi/2 lie behind the surface.

    The azimuth of a direction along the normal is 0.
    """
    if not _known(description).as_meant:
        source, eye, *_ = ends(description, true_pose(description, pose))
        return Directions(*_angles(source.tolist()), *_angles(eye.tolist()))
    light, camera, *_ = _sample_frame(true_pose(description, pose))
    return Directions(*_angles(light), *_angles(camera))


ENCODER_STEPS = 60
"""Enough for errors of 30 deg in a turn; those of an encoder take five."""
ASIDE, SIDES = (math.radians(3.0), math.radians(15.0)), 8
"""How far beside given directions a rig with errors of alignment looks for a start, and on how many sides."""
CLOSE = math.radians(5.0)
"""Where a rig cannot stand exactly so for its errors of alignment, a pose this close counts: of a rig that has not the
axes for it, and for the white reference."""
CLOSE_ENOUGH = SAME_ANGLE
"""Of a rig that has an axis for every direction, around the few that its errors close: one angle of a curve."""


def left_its_side(description: RigDescription, goal: Pose, read: Pose) -> bool:
    """Whether the pose that was read has the source behind the sample, or the camera on the other side than asked."""
    source, camera = _heights(description, read)
    return source <= 0.0 or camera * (camera if read == goal else _heights(description, goal)[1]) <= 0.0


def _heights(description: RigDescription, pose: Pose) -> tuple[float, float]:
    """How far source and camera stand in front of the sample's plane [mm]: the z of a `view`."""
    if not _known(description).as_meant:
        seen = view(description, pose)
        return float(seen.source_mm[2]), float(seen.camera_mm[2])
    light, camera, *_ = _sample_frame(true_pose(description, pose))
    return description.geometry.light_distance_mm * light[2], description.geometry.camera_distance_mm * camera[2]


def separation(d: Angles) -> float:
    """Angle [rad] between source and detector, without cancellation near 0 and near pi."""
    light, camera = _direction(*d[:2]), _direction(*d[2:])
    difference = math.dist(light, camera)
    total = math.dist(light, (-camera[0], -camera[1], -camera[2]))
    return 2.0 * math.atan2(difference, total)


def blocked_cone(description: RigDescription) -> float:
    """Half-angle [rad] of the cone around retro in which light and camera stand in each other's way.

    Each body is a ball; seen from the sample's centre they overlap below the sum of their angular radii.
    """
    return _known(description).blocked_cone


TURN = 2.0 * math.pi
FREE_TURNS = ("camera", "spin", "azimuth")
"""Axes that stand alike after a whole turn: only an arm that reaches behind the sample has limits that far apart."""
NAMES = {
    "light": "light arm",
    "camera": "camera arm",
    "tilt": "tilt of the holder",
    "spin": "spin of the sample",
    "azimuth": "azimuth axis of the camera arm",
}


def _sample_frame(pose: Pose) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Light, camera, image_x, image_y and the axis of the arms as unit vectors of the sample's frame."""
    sin_c, cos_c = math.sin(pose.camera), math.cos(pose.camera)
    sin_az, cos_az = math.sin(pose.azimuth), math.cos(pose.azimuth)
    light = (math.sin(pose.light), 0.0, math.cos(pose.light))
    camera = (sin_c * cos_az, sin_c * sin_az, cos_c)
    image_y = (-sin_az, cos_az, 0.0)
    # image_x x image_y = optical axis = -camera
    image_x = (-cos_c * cos_az, -cos_c * sin_az, sin_c)
    st, ct, ss, cs = math.sin(pose.tilt), math.cos(pose.tilt), math.sin(pose.spin), math.cos(pose.spin)

    def to_sample(v: Vector) -> Vector:
        y, z = ct * v[1] - st * v[2], st * v[1] + ct * v[2]  # Rx(t), the inverse of Rx(-t)
        return (cs * v[0] + ss * y, cs * y - ss * v[0], z)

    return to_sample(light), to_sample(camera), to_sample(image_x), to_sample(image_y), to_sample((0.0, 1.0, 0.0))


def _direction(theta: float, phi: float) -> Vector:
    return (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))


def _angles(v: Vector) -> tuple[float, float]:
    phi = math.atan2(v[1], v[0]) % (2.0 * math.pi)
    return math.atan2(math.hypot(v[0], v[1]), v[2]), phi if phi < 2.0 * math.pi else 0.0
