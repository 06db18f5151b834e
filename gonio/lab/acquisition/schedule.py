"""The steps of a run in their order."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import overload

from gonio.errors import ConfigError
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.plan import Assessed, Plan, Point, assess, canonical, count_reasons
from gonio.lab.rig import Pose, Step, regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.motion_planning import Blocked, require_free
from gonio.typing import JsonObject

EXPECTED_ALBEDO = 0.5
"""Reflectance factor (pi times the BRDF) that estimates take for a sample of which nothing is known."""


def reference_pose(description: RigDescription) -> Pose:
    """The pose for visits to the white reference.

    Raises
    ------
    ConfigError
        The rig cannot reach the geometry that its own file asks for.
    """
    reference = description.reference
    if reference.how == "beam":
        return _straight(description)
    point = canonical(reference.theta_i_deg, 0.0, reference.theta_r_deg, 180.0)
    try:
        pose = reach(description, point.directions, nearby=True)
    except Unreachable as error:
        raise ConfigError(
            f'rig "{description.name}": [reference] theta_i_deg = {reference.theta_i_deg:g}, '
            f"theta_r_deg = {reference.theta_r_deg:g} cannot be reached: {error}"
        ) from None
    regions.require_whole(description, view(description, pose), "reference")
    return pose


def _straight(description: RigDescription) -> Pose:
    """The pose in which the camera looks straight into the lamp; the nearer to 90 deg the light stands, the better.

    Every limit is taken as it is, and an approach may need room: a backlash's worth is left to each.
    """
    limits, axes = description.limits_deg(), description.axes()
    room = {n: max(axes[n].backlash_deg, abs(description.approach_deg()[n])) for n in ("light", "camera")}
    fitting = []
    for turn in (180.0, -180.0):
        lower = max(limits["light"][0] + room["light"], limits["camera"][0] + room["camera"] + turn)
        upper = min(limits["light"][1] - room["light"], limits["camera"][1] - room["camera"] + turn)
        if lower <= upper:
            light = min(max(math.copysign(90.0, turn), lower), upper)
            fitting.append(Pose(light=math.radians(light), camera=math.radians(light - turn)))
    if not fitting:
        said = " and ".join(f"{n} {limits[n][0]:g} to {limits[n][1]:g} deg" for n in ("light", "camera"))
        raise ConfigError(
            f'rig "{description.name}": reference.how = "beam" needs arms that stand 180 deg apart, so that the camera '
            f"looks into the lamp; their limits do not allow it ({said}, less the room of an approach). Widen "
            'limits_deg where nothing is in the way, or take a white reference (how = "swap")'
        )
    blocked = []
    for pose in fitting:
        try:
            require_free(description, pose)
            return pose
        except Blocked as error:
            blocked.append(str(error))
    raise ConfigError(f'rig "{description.name}": reference.how = "beam": {"; or ".join(dict.fromkeys(blocked))}')


def schedule(plan: Plan, description: RigDescription, points: list[Assessed] | None = None) -> list[Step]:
    """The numbered steps of a run: darks, a reference visit, points with a visit every `reference.every`, a last visit.

    Parameters
    ----------
    plan, description
        What to measure, and on which rig.
    points : list of Assessed, optional
        What `assess` made of them, where it has been called already.

    Raises
    ------
    ConfigError
        No point can be reached, or the reference cannot.
    """
    points = assess(plan, description) if points is None else points
    reachable = {row: a.pose for row, a in enumerate(points) if a.pose is not None}
    if not reachable:
        reasons = "".join(f"\n  {count} {flag}: {cause}" for (flag, cause), count in count_reasons(points)[:3])
        raise ConfigError(f'{plan.source}: no point can be reached on the rig "{description.name}":{reasons}')
    return list(Schedule(description, list(reachable), lambda row: reachable[row]))


class Schedule(Sequence[Step]):
    """The steps of a run by their numbers, made when they are asked for.

    Parameters
    ----------
    description
        The rig.
    rows
        The points that it can reach, as rows of the plan.
    pose
        The pose of such a point.

    Raises
    ------
    ConfigError
        The reference cannot be reached.
    """

    def __init__(self, description: RigDescription, rows: Sequence[int], pose: Callable[[int], Pose]) -> None:
        self._rows, self._pose = rows, pose
        self._at_reference = reference_pose(description)
        self._every = description.reference.every or len(rows)

    def __len__(self) -> int:
        return 2 + len(self._rows) + -(-len(self._rows) // self._every)

    @overload
    def __getitem__(self, at: int) -> Step: ...
    @overload
    def __getitem__(self, at: slice) -> list[Step]: ...
    def __getitem__(self, at: int | slice) -> Step | list[Step]:
        if isinstance(at, slice):
            return [self[number] for number in range(len(self))[at]]
        number = range(len(self))[at]
        if number == 0:
            return Step(0, "dark")
        group, place = divmod(number - 2, self._every + 1)
        if number == 1 or place == self._every or number == len(self) - 1:
            return Step(number, "reference", pose=self._at_reference)
        row = self._rows[group * self._every + place]
        return Step(number, "point", row, self._pose(row))


@dataclass(frozen=True, slots=True)
class Batch:
    """Points that were chosen as the run grew."""

    first_step: int
    first_row: int
    points: tuple[Point, ...]
    why: JsonObject = field(default_factory=dict)
    """What its sampler wrote down."""

    def steps(self, description: RigDescription) -> list[Step]:
        """Its points with a visit to the reference every `reference.every`, and a last visit.

        Raises
        ------
        ConfigError
            The rig cannot reach one of them.
        """
        every = description.reference.every or len(self.points)
        reference, out = reference_pose(description), list[Step]()
        for k, point in enumerate(self.points):
            try:
                pose = reach(description, point.directions)
            except Unreachable as error:
                angles = ", ".join(f"{name} = {getattr(point, name):g}" for name in ANGLES_DEG)
                raise ConfigError(f"the sampler named a point that the rig cannot reach ({angles}): {error}") from None
            out.append(Step(self.first_step + len(out), "point", self.first_row + k, pose))
            if (k + 1) % every == 0 or k + 1 == len(self.points):
                out.append(Step(self.first_step + len(out), "reference", pose=reference))
        return out


def going_on(plan: Plan, description: RigDescription, flags: Sequence[str]) -> Schedule:
    """The schedule of a run that has begun; poses are sought for the steps that are asked for alone.

    Parameters
    ----------
    plan, description
        What is measured, and on which rig.
    flags
        Of each point: "", or why it cannot be measured, as `assess` found when the run began.
    """
    rows = [row for row, flag in enumerate(flags) if not flag]
    return Schedule(description, rows, lambda row: reach(description, plan.points[row].directions))
