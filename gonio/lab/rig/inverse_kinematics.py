"""From directions to poses of the axes: which there are, and which is taken."""

import contextlib
import math
from collections.abc import Sequence

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import AT_LIMIT, EXACTLY_IN_PLANE, PARALLEL, Directions
from gonio.lab.rig import kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import (
    ASIDE,
    CLOSE,
    CLOSE_ENOUGH,
    FREE_TURNS,
    NAMES,
    SIDES,
    TURN,
    Angles,
    Vector,
    _angles,
    _direction,
    _known,
    blocked_cone,
    read_pose,
    separation,
)
from gonio.lab.rig.motion_planning import Blocked, require_free
from gonio.lab.rig.protocols import Pose
from gonio.typing import Floats

FEW_STEPS, MANY_STEPS, BEST = 8, 200, 12
"""Of `_poses_around`."""
ALIKE = 1e-6
"""Poses that differ by less [rad] are the same."""


class Unreachable(ConfigError):
    """A direction that a rig cannot measure.

    `flag` is the word for tables, the message is the reason for people, and `cause` is the reason without the numbers
    of this one point, so that points can be counted by it.
    """

    def __init__(self, flag: str, reason: str, cause: str = "") -> None:
        super().__init__(reason)
        self.flag = flag
        self.cause = cause or reason


def _misaligned_poses(description: RigDescription, d: Angles, nearby: bool) -> list[tuple[Pose, Pose | Unreachable]]:
    """The true angles of the axes of a rig with errors of alignment that show the sample from given directions: by
    each pose of the closed form, or why there is none.

    Where the errors leave no such pose (an arm that stands out of a plane which no axis can turn), it is the closest
    one.
    """
    wanted = np.array([*_direction(*d[:2]), *_direction(*d[2:])])
    found = [(meant, *kinematics.closest_pose(description, meant, wanted)) for meant in _closed_form(description, d)]
    whole = len(description.axes()) >= kinematics.DIRECTIONS
    if whole and any(off > kinematics.CONVERGED for *_, off in found):
        # near a singular pose the way may end in a place from which every step leads away
        exact, closest = _poses_around(description, _around(description, d), wanted)
        found = [each for each in found if each[2] <= kinematics.CONVERGED]
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
    across = math.cos(toward) * x + math.sin(toward) * np.cross(direction, x)
    return np.asarray(math.cos(off) * direction + math.sin(off) * across)


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
    apart, cone = separation(one), blocked_cone(description)
    if apart < cone - AT_LIMIT:
        cause = f"the bodies of source and detector block {math.degrees(cone):.1f} deg around retro"
        raise Unreachable("blocked", f"source and detector are {math.degrees(apart):.1f} deg apart: {cause}", cause)
    verdicts = [verdict for _, verdict in branches(description, one, nearby=nearby)]
    fitting = [verdict for verdict in verdicts if isinstance(verdict, Pose)]
    failed = [verdict for verdict in verdicts if isinstance(verdict, Unreachable)]
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
    found: list[tuple[Pose, Pose | Unreachable]] = (
        [(pose, pose) for pose in _closed_form(description, one)]
        if _known(description).as_meant
        else _misaligned_poses(description, one, nearby)
    )
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
    return poses if "spin" in axes else _without_spin(poses, d, leans="tilt" in description.holder.axes)


def _with_azimuth(description: RigDescription, d: Angles) -> list[Pose]:
    """Both sides of the light arm, times both sides of the camera arm, which an azimuth axis carries."""
    theta_i, phi_i, theta_r, phi_r = d
    poses = []
    for light_side in (0.0, math.pi):
        # the light stands at the azimuth 0 or pi of the lab, and phi_i = that azimuth - spin
        spin = math.remainder(light_side - phi_i, TURN) if theta_i > PARALLEL else 0.0
        light = theta_i if light_side == 0.0 else -theta_i
        for camera_side in (0.0, math.pi):
            azimuth = math.remainder(phi_r + spin - camera_side, TURN) if theta_r > PARALLEL else 0.0
            camera = theta_r if camera_side == 0.0 else -theta_r
            poses.append(Pose(light=light, camera=camera, spin=spin, azimuth=azimuth))
    return (
        poses if "spin" in description.holder.axes else _without_spin(poses, d, leans="tilt" in description.holder.axes)
    )


def _without_spin(poses: list[Pose], d: Angles, *, leans: bool) -> list[Pose]:
    """The poses that need no spin."""
    still = [pose for pose in poses if abs(math.sin(pose.spin / 2.0)) <= EXACTLY_IN_PLANE]
    if not still:
        theta_i, phi_i, _, phi_r = d
        name, phi = ("phi_i", phi_i) if theta_i > EXACTLY_IN_PLANE else ("phi_r", phi_r)
        cause = (
            f"{name} other than 0 and 180 deg needs an axis that spins the sample, and the rig has none: its arms "
            f"stay in one plane{'; its tilt leans the sample out of it: tilt_deg of a sweep' if leans else ''}"
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


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(v: Vector) -> Vector:
    length = math.hypot(*v)
    return (v[0] / length, v[1] / length, v[2] / length)


def _poses_around(
    description: RigDescription, starts: Sequence[Pose], wanted: Floats
) -> tuple[list[Pose], tuple[Pose, float]]:
    """Where no way from the closed form leads to given directions: the poses that show them, and the closest found.

    Close to retro the arms' plane may lie anyhow, and at a pole the azimuth; so the ways begin from many `starts`. All
    of them go some steps, and the `BEST` go on to their ends.
    """
    from gonio.lab.rig import _solving

    axes = np.array([kinematics.AXES.index(name) for name in description.axes()])
    centre, surface = kinematics.patch(description.holder)
    heads = np.array(
        [
            kinematics.head(description.arms.light, description.geometry.light_distance_mm),
            kinematics.head(description.arms.camera, description.geometry.camera_distance_mm),
        ]
    )
    at = kinematics.frames(description.arms, description.holder)
    rig = wanted, at, heads, centre, np.ascontiguousarray(surface)
    first = []
    for start in starts:
        place = np.empty(len(kinematics.AXES))
        left = _solving.closer(
            np.array([getattr(start, name) for name in kinematics.AXES]), axes, *rig, FEW_STEPS, AT_LIMIT, place
        )
        first.append((float(left), place))
    exact: list[Pose] = []
    closest: tuple[Pose, float] = starts[0], math.inf
    for _, begun in sorted(first, key=lambda each: each[0])[:BEST]:
        place = np.empty(len(kinematics.AXES))
        _solving.closer(begun, axes, *rig, MANY_STEPS, AT_LIMIT, place)
        pose, left = Pose(**dict(zip(kinematics.AXES, place.tolist(), strict=True))), np.empty(6)
        _solving.beside(place, *rig, left)
        off = max(float(np.linalg.norm(left[:3])), float(np.linalg.norm(left[3:])))
        if off < closest[1]:
            closest = pose, off
        if off <= kinematics.CONVERGED and not any(_alike(pose, other) for other in exact):
            exact.append(pose)
    return exact, closest


def _alike(one: Pose, other: Pose) -> bool:
    return all(abs(math.remainder(getattr(one, n) - getattr(other, n), math.tau)) < ALIKE for n in kinematics.AXES)
