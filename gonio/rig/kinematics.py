"""Between the axes of a described rig and the directions at its sample, both ways.

The lab frame has its origin where the sample's axes cross, on the sample's surface, y along the axis that both arms
turn about, and z where the untilted sample's normal points. With a and c the angles of light and camera arm, t the tilt
and s the spin:

    light  L = (sin a, 0, cos a)          camera  V = Rz(azimuth) (sin c, 0, cos c)
    normal n = (0, sin t, cos t)          sample frame to lab frame  M = Rx(-t) Rz(s)

The inverse rests on one fact: both arms are perpendicular to y, so y = +-(L x V)/|L x V|, and n . y = sin t. The two
signs are the two branches: they mirror the arms, change the sign of the tilt and turn the sample by half a turn.

That is the rig as it was meant. Where its description names errors of alignment, `misalignment` does the same
with them, and the inverse starts from the closed form and goes on by Newton's method (docs/pose_to_pixel.md). A pose
is what encoders read, less their zeros; `true_pose` takes out what else is wrong with them.
"""

from __future__ import annotations

import contextlib
import math
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import AT_LIMIT, EXACTLY_IN_PLANE, PARALLEL, SAME_ANGLE, Directions
from gonio.rig import misalignment
from gonio.rig.description import ArmAxis, Axis, RigDescription
from gonio.rig.motion_planning import Blocked, require_free
from gonio.rig.protocols import Pose
from gonio.typing import Floats

Vector = tuple[float, float, float]

Angles = tuple[float, float, float, float]
"""theta_i, phi_i, theta_r, phi_r of one pair of directions: what is done for one point at a time is done in floats."""


class Unreachable(ConfigError):
    """A direction that a rig cannot measure.

    `flag` is the word for tables, the message is the reason for people, and `cause` is the reason without the numbers
    of this one point, so that points can be counted by it.
    """

    def __init__(self, flag: str, reason: str, cause: str = "") -> None:
        super().__init__(reason)
        self.flag = flag
        self.cause = cause or reason


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
        at, approach, (lower, upper) = math.degrees(place), self.approach_deg, self.limits_deg
        start = at - approach  # as `RigDescription.approach_starts_deg`
        start = max(start, min(lower, at)) if approach > 0 else min(start, max(upper, at))
        return abs(at - start) >= min(self.backlash_deg, abs(approach)) - 1e-9


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
    arms, g = description.arms, description.geometry
    axes, approach = description.axes(), description.approach_deg()
    encoders = {"light": arms.light, "camera": arms.camera, "azimuth": arms.azimuth}
    known = _Known(
        as_meant=description.as_meant,
        erring={name: axis for name, axis in encoders.items() if axis is not None and axis.harmonics_deg},
        blocked_cone=_angular_radius(g.light_body_radius_mm, g.light_distance_mm)
        + _angular_radius(g.camera_body_radius_mm, g.camera_distance_mm),
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
        return _misaligned(description, true_pose(description, pose))
    light, camera, image_x, image_y, beam_y = _sample_frame(true_pose(description, pose))
    geometry = description.geometry
    return View(
        source_mm=geometry.light_distance_mm * np.array(light),
        camera_mm=geometry.camera_distance_mm * np.array(camera),
        image_x=np.array(image_x),
        image_y=np.array(image_y),
        beam_y=np.array(beam_y),
    )


def directions(description: RigDescription, pose: Pose) -> Directions:
    """The directions at the centre of the sample for a pose; polar angles above pi/2 lie behind the surface.

    The azimuth of a direction along the normal is 0.
    """
    if not _known(description).as_meant:
        source, eye, *_ = misalignment.ends(description, true_pose(description, pose))
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


def _misaligned(description: RigDescription, pose: Pose) -> View:
    """The view of a rig with errors of alignment, at the true angles of its axes."""
    source, eye, onto, beam_y = misalignment.ends(description, pose)
    image_x, image_y, sight = np.ascontiguousarray((onto @ misalignment.camera_on_arm(description)).T)
    return View(source_mm=source, camera_mm=eye, image_x=image_x, image_y=image_y, sight=sight, beam_y=beam_y)


def _misaligned_poses(description: RigDescription, d: Angles, nearby: bool) -> list[tuple[Pose, Pose | Unreachable]]:
    """The true angles of the axes of a rig with errors of alignment that show the sample from given directions: by
    each pose of the closed form, or why there is none.

    Where the errors leave no such pose (an arm that stands out of a plane which no axis can turn), it is the closest
    one.
    """
    wanted = np.array([*_direction(*d[:2]), *_direction(*d[2:])])
    found = [(meant, *misalignment.closest_pose(description, meant, wanted)) for meant in _closed_form(description, d)]
    whole = len(description.axes()) >= misalignment.DIRECTIONS
    if whole and any(off > misalignment.CONVERGED for *_, off in found):
        # near a singular pose the way may end in a place from which every step leads away
        exact, closest = misalignment.poses_around(description, _around(description, d), wanted)
        found = [each for each in found if each[2] <= misalignment.CONVERGED]
        found += [(pose, pose, 0.0) for pose in exact] or ([] if found else [(closest[0], *closest)])
    out: list[tuple[Pose, Pose | Unreachable]] = []
    for meant, pose, off in found:
        error = Unreachable(
            "unreachable",
            f"the rig's errors of alignment keep it {math.degrees(off):.1f} deg from these directions",
            "too far from what the rig can show, for its errors of alignment",
        )
        close = CLOSE_ENOUGH if whole and not nearby else CLOSE
        out.append((pose, pose) if off <= close else (meant, error))
    return out


def _around(description: RigDescription, d: Angles) -> list[Pose]:
    """Poses of the closed form for directions some degrees beside given ones, all around."""
    light, camera = np.array(_direction(*d[:2])), np.array(_direction(*d[2:]))
    out: list[Pose] = []
    for off in ASIDE:
        for k in range(SIDES):
            one = _beside(light, off, k * TURN / SIDES)
            other = _beside(camera, off, (3 * k + 1) * TURN / SIDES)
            for i, r in ((light, other), (one, camera), (one, other)):
                beside = (*_angles((i[0], i[1], abs(i[2]))), *_angles((r[0], r[1], r[2])))
                with contextlib.suppress(Unreachable):
                    out += _closed_form(description, beside)
    return out


def _beside(direction: Floats, off: float, toward: float) -> Floats:
    """A direction turned by an angle [rad], toward the side that another says."""
    x = np.cross(direction, (0.0, 1.0, 0.0) if abs(direction[1]) < 0.7 else (1.0, 0.0, 0.0))
    x /= np.linalg.norm(x)
    out: Floats = math.cos(off) * direction + math.sin(off) * (
        math.cos(toward) * x + math.sin(toward) * np.cross(direction, x)
    )
    return out


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


def separation(d: Directions) -> float:
    """Angle [rad] between source and detector of one pair of directions, without cancellation near 0 and near pi."""
    return _separation(d.floats)


def _separation(d: Angles) -> float:
    light, camera = _direction(*d[:2]), _direction(*d[2:])
    difference = math.dist(light, camera)
    total = math.dist(light, (-camera[0], -camera[1], -camera[2]))
    return 2.0 * math.atan2(difference, total)


def blocked_cone(description: RigDescription) -> float:
    """Half-angle [rad] of the cone around retro in which light and camera stand in each other's way.

    Each body is a ball; seen from the sample's centre they overlap below the sum of their angular radii.
    """
    return _known(description).blocked_cone


def reach(description: RigDescription, d: Directions | Angles, *, nearby: bool = False) -> Pose:
    """The pose that shows the sample from given directions.

    Of the two branches the one inside all limits is taken; where both are, the one with the smaller spin, then the one
    with the tilt, then with the light arm, on the positive side (then the one with the smaller azimuth). Limits may be
    wider than a turn: of the windings the one nearest to 0 is taken. Where the rig file has bodies, the first of these
    is taken that has a free way to and from the rest position.

    Parameters
    ----------
    description : RigDescription
        Limits, axes and bodies.
    d : Directions, or the four floats of one
        One pair of them: theta_i in [0, pi/2], theta_r in [0, pi] (beyond pi/2 the camera stands behind the sample and
        sees transmission), azimuths in any turn.
    nearby : bool
        Where the rig's errors of alignment close these directions, take a pose up to `CLOSE` beside them.

    Raises
    ------
    Unreachable
        With flag "blocked" where one body hides the other, or bodies of the rig file would touch on the way between
        the rest position and every branch; "unreachable" where the rig has no axis for the directions
        or both branches leave a limit, "below_horizon" for a source below the surface.
    """
    one = d if isinstance(d, tuple) else d.floats
    for name, theta, most in (("theta_i", one[0], math.pi / 2), ("theta_r", one[2], math.pi)):
        if not 0.0 <= theta <= most + AT_LIMIT:
            allowed = f"0 to {math.degrees(most):g} deg"
            raise Unreachable("below_horizon", f"{name} = {math.degrees(theta):g} deg is outside {allowed}")
    apart, cone = _separation(one), blocked_cone(description)
    if apart < cone - AT_LIMIT:
        cause = f"the bodies of source and detector block {math.degrees(cone):.1f} deg around retro"
        raise Unreachable("blocked", f"source and detector are {math.degrees(apart):.1f} deg apart: {cause}", cause)
    fitting: list[Pose] = []
    failed: list[Unreachable] = []
    for _, verdict in branches(description, one, nearby=nearby):
        if isinstance(verdict, Pose):
            fitting.append(verdict)
        else:
            failed.append(verdict)
    if not fitting:
        reasons, causes = (list(dict.fromkeys(each)) for each in (map(str, failed), (e.cause for e in failed)))
        raise Unreachable("unreachable", "; or ".join(reasons), "; or ".join(causes))
    blocked: list[Blocked] = []
    for pose in sorted(fitting, key=_preference):
        try:
            require_free(description, pose)
            return pose
        except Blocked as error:
            blocked.append(error)
    by_what: dict[str, dict[str, None]] = {}
    for each in blocked:
        by_what.setdefault(each.what, {})[each.bodies] = None
    causes = [f"{what} {'; or '.join(bodies)}" for what, bodies in by_what.items()]
    raise Unreachable(
        "blocked",
        "blocked: " + "; or ".join(dict.fromkeys(map(str, [*blocked, *failed]))),
        "; or ".join(dict.fromkeys([*causes, *(error.cause for error in failed)])),
    )


def branches(
    description: RigDescription, d: Directions | Angles, *, nearby: bool = False
) -> list[tuple[Pose, Pose | Unreachable]]:
    """Every pose that would show the sample from given directions; with each, itself inside all limits, or why not.

    An axis whose limits are wider than a turn has a pose for each of its windings.

    Whether light and camera hide each other is not looked at here; raises `Unreachable` where the rig has no axis for
    the directions.
    """
    one = d if isinstance(d, tuple) else d.floats
    found: list[tuple[Pose, Pose | Unreachable]]
    if _known(description).as_meant:
        found = [(pose, pose) for pose in _closed_form(description, one)]
    else:
        found = _misaligned_poses(description, one, nearby)
    out: list[tuple[Pose, Pose | Unreachable]] = []
    for meant, verdict in found:
        if isinstance(verdict, Unreachable):
            out.append((meant, verdict))
            continue
        pose = read_pose(description, verdict)
        try:
            out += [(inside, inside) for inside in _inside_limits(description, pose)]
        except Unreachable as error:
            out.append((pose, error))
    return out


def _closed_form(description: RigDescription, d: Angles) -> list[Pose]:
    """The poses of a rig that is as it was meant."""
    return _with_azimuth(description, d) if description.arms.azimuth is not None else _with_holder(description, d)


def _preference(pose: Pose) -> tuple[float, bool, bool, float]:
    return (round(abs(pose.spin), 9), pose.tilt < -1e-9, pose.light < -1e-9, round(abs(pose.azimuth), 9))


def _with_holder(description: RigDescription, d: Angles) -> list[Pose]:
    """Both branches of arms with tilt and spin; without those axes, what is left of them."""
    axes = description.holder.axes
    theta_i, phi_i, theta_r, phi_r = d
    light, camera = _direction(theta_i, phi_i), _direction(theta_r, phi_r)
    normal_to_arms = _normal_of_plane(light, camera, d)
    if "tilt" not in axes:
        # the arms' plane must hold the normal of the sample: both directions in one vertical plane
        if abs(normal_to_arms[2]) > EXACTLY_IN_PLANE and min(theta_i, theta_r) > EXACTLY_IN_PLANE:
            raise Unreachable(
                "unreachable",
                "the detector lies out of the plane of incidence, and the rig has no axis for that: neither a tilt of "
                "the holder nor an azimuth of the camera arm",
            )
        normal_to_arms = _unit((normal_to_arms[0], normal_to_arms[1], 0.0))
    poses = []
    for sign in (1.0, -1.0):
        y = (sign * normal_to_arms[0], sign * normal_to_arms[1], sign * normal_to_arms[2])
        # n lies perpendicular to the tilt axis x, and x to y: x = y x n
        flat = math.hypot(y[0], y[1])
        x = (y[1] / flat, -y[0] / flat, 0.0) if flat > 0.0 else (1.0, 0.0, 0.0)
        z = _cross(x, y)
        poses.append(
            Pose(
                light=math.atan2(_dot(light, x), _dot(light, z)),
                camera=math.atan2(_dot(camera, x), _dot(camera, z)),
                tilt=math.atan2(y[2], flat) if "tilt" in axes else 0.0,
                spin=math.atan2(-x[1], x[0]) + 0.0,
            )
        )
    return poses if "spin" in axes else _without_spin(poses, d)


def _with_azimuth(description: RigDescription, d: Angles) -> list[Pose]:
    """Both sides of the light arm, times both sides of the camera arm, which an azimuth axis carries."""
    theta_i, phi_i, theta_r, phi_r = d
    poses = []
    for light_side in (0.0, math.pi):
        # the light stands at the azimuth 0 or pi of the lab, and phi_i = that azimuth - spin
        spin = _half_turns(light_side - phi_i) if theta_i > PARALLEL else 0.0
        light = theta_i if light_side == 0.0 else -theta_i
        for camera_side in (0.0, math.pi):
            azimuth = _half_turns(phi_r + spin - camera_side) if theta_r > PARALLEL else 0.0
            camera = theta_r if camera_side == 0.0 else -theta_r
            poses.append(Pose(light=light, camera=camera, spin=spin, azimuth=azimuth))
    return poses if "spin" in description.holder.axes else _without_spin(poses, d)


def _without_spin(poses: list[Pose], d: Angles) -> list[Pose]:
    """The poses that need no spin."""
    still = [pose for pose in poses if abs(math.sin(pose.spin / 2.0)) <= EXACTLY_IN_PLANE]
    if not still:
        theta_i, phi_i, _, phi_r = d
        name, phi = ("phi_i", phi_i) if theta_i > EXACTLY_IN_PLANE else ("phi_r", phi_r)
        cause = (
            f"{name} other than 0 and 180 deg needs an axis that spins the sample, and the rig has none: its arms "
            "stay in one plane"
        )
        raise Unreachable("unreachable", f"{name} = {math.degrees(phi) % 360.0:g} deg; {cause}", cause)
    return [Pose(light=p.light, camera=p.camera, tilt=p.tilt, azimuth=p.azimuth) for p in still]


def _inside_limits(description: RigDescription, pose: Pose) -> list[Pose]:
    """The poses that show the same with every axis in its limits, or `Unreachable` with the axis that has no place.

    Axes that are free of whole turns may have several places, where their limits are wider than a turn. A place that
    the axis can only arrive at with its backlash open, because its limit is in the way of the approach, is none.
    """
    ranges = _known(description).ranges
    found = [{axis.name: float(getattr(pose, axis.name)) for axis in ranges}]
    for axis in ranges:
        name, lower, upper = axis.name, axis.lower, axis.upper
        value = found[0][name]
        turns = range(math.ceil((lower - value - AT_LIMIT) / TURN), math.floor((upper - value + AT_LIMIT) / TURN) + 1)
        places = [value + k * TURN for k in sorted(turns, key=abs) if name in FREE_TURNS or k == 0]
        inside = [min(max(place, lower), upper) for place in places]
        taken_up = [place for place in inside if axis.takes_up_play(place)]
        if not taken_up:
            limits = f"the limits {axis.limits_deg[0]:g} to {axis.limits_deg[1]:g} deg of the {NAMES[name]}"
            cause = f"outside {limits}"
            if inside:
                side = "lower" if axis.approach_deg > 0 else "upper"
                cause = (
                    f"closer to the {side} limit of the {NAMES[name]} than its backlash of {axis.backlash_deg:g} deg, "
                    "which an approach from that side could not take up"
                )
            raise Unreachable("unreachable", f"{math.degrees(value):.2f} deg is {cause}", cause)
        found = [one | {name: place} for one in found for place in taken_up]
    return [Pose(**one) for one in found]


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


def _normal_of_plane(light: Vector, camera: Vector, d: Angles) -> Vector:
    """Unit normal of the plane of both directions; of the vertical plane through them where they are parallel.

    (L + V) x (V - L) = 2 L x V keeps its digits where L and V nearly agree, or are nearly opposite.
    """
    total = (light[0] + camera[0], light[1] + camera[1], light[2] + camera[2])
    difference = (camera[0] - light[0], camera[1] - light[1], camera[2] - light[2])
    cross = _cross(total, difference)
    if math.hypot(*cross) > 2.0 * PARALLEL:
        return _unit(cross)
    theta_i, phi_i, theta_r, phi_r = d
    phi = phi_i if theta_i > PARALLEL else phi_r if theta_r > PARALLEL else 0.0
    return (-math.sin(phi), math.cos(phi), 0.0)


def _half_turns(angle: float) -> float:
    """The angle in [-pi, pi]."""
    return math.remainder(angle, 2.0 * math.pi)


def _angular_radius(radius: float, distance: float) -> float:
    return math.asin(min(1.0, radius / distance))


def _direction(theta: float, phi: float) -> Vector:
    return (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))


def _angles(v: Vector) -> tuple[float, float]:
    phi = math.atan2(v[1], v[0]) % (2.0 * math.pi)
    return math.atan2(math.hypot(v[0], v[1]), v[2]), phi if phi < 2.0 * math.pi else 0.0


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(v: Vector) -> Vector:
    length = math.hypot(*v)
    return (v[0] / length, v[1] / length, v[2] / length)
