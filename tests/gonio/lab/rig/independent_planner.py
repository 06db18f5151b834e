"""Is anything hit on a way that was planned, and is what was refused refused for a true reason? Random rigs and plans.

Each draw is a rig (arms, tilt or azimuth, limits, sides of approach, errors of alignment, bodies, a cable) and some
directions. What looks at the result shares nothing with the planner but the rig file: its own rotations, distances by
projecting to and fro, and moves whose axes go each at a speed of its own, from places beside those that were meant.
"""

import math
import re
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.rig import Pose, motion_planning
from gonio.lab.rig.description import Body, RigDescription
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.lab.rig.light_and_camera import Band, Bands
from gonio.typing import Floats
from tests.gonio.lab.rig.plain_rig import rotation, turn

NAMES = ("light", "camera", "tilt", "spin", "azimuth")
SAME = 1e-9
"""Directions that differ by less [rad] are the same."""
LANDING_DEG = 0.15
"""How far beside its goal an axis lands here; the planner allows for 0.2."""
ROUNDING_MM = 1e-6
STATED_MM = 0.5
"""docs/mechanics.md: a refused way comes so close beyond the clearance."""
PROJECTIONS = 400
SAMPLES = 40
"""Moments of a move that are looked at."""


@dataclass
class Found:
    """What came out."""

    accepted: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    moves: int = 0
    closed: int = 0
    """Accepted beside what was asked, since errors of alignment close it."""
    worst_inverse: float = 0.0
    smallest_spare_mm: float = math.inf
    """Of all gaps on all ways, less the clearance."""
    wrong: list[str] = field(default_factory=list)


# ---- rigs ----


def some_rig(rng: np.random.Generator) -> RigDescription:
    """A rig as a laboratory might build it, or not."""
    far = rng.uniform(300.0, 1000.0, 2)
    kind = rng.choice(["tilt", "azimuth", "plane"], p=[0.5, 0.3, 0.2])

    def limits(most: float) -> list[float]:
        return [float(-rng.uniform(60.0, most)), float(rng.uniform(60.0, most))]

    bent = rng.random() < 0.3

    def arm(most: float) -> dict[str, object]:
        out: dict[str, object] = {"limits_deg": limits(most), "backlash_deg": float(rng.choice([0.0, 0.1]))}
        if rng.random() < 0.3:
            out["approach_deg"] = float(rng.choice([-2.0, -1.0, 0.5, 3.0]))
        if bent:
            out |= {"axis_tilt_deg": rng.normal(0, 0.3, 2).tolist(), "axis_offset_mm": rng.normal(0, 0.5, 2).tolist(),
                    "harmonics_deg": [[1, *rng.normal(0, 0.2, 2).tolist()]]}  # fmt: skip
        return out

    arms = {"light": arm(100.0), "camera": arm(100.0)}
    if bent:
        for name in ("light", "camera"):
            arms[name]["elevation_deg"] = float(rng.normal(0, 0.2))
    holder: dict[str, object] = {"axes": {"tilt": ["tilt", "spin"], "azimuth": ["spin"], "plane": []}[kind]}
    holder |= {"tilt_limits_deg": limits(90.0), "spin_limits_deg": [-200.0, float(rng.uniform(160, 300))]}
    if bent:
        holder |= {"surface_offset_mm": float(rng.normal(0, 0.3)),
                   "surface_tilt_deg": rng.normal(0, 0.2, 2).tolist(), "spin_axis_tilt_deg": float(rng.normal(0, 0.2)),
                   "tilt_axis_offset_mm": float(rng.normal(0, 1))}  # fmt: skip
    if kind == "azimuth":
        arms["azimuth"] = arm(190.0)
    bodies, cables = _some_bodies(rng, far)
    return RigDescription.model_validate(
        {
            "rig": "sim", "name": "drawn", "arms": arms, "holder": holder, "bodies": bodies, "cables": cables,
            "bands": Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)).model_dump(exclude_none=True),
            "geometry": {
                "light_distance_mm": far[0], "camera_distance_mm": far[1],
                "light_body_radius_mm": rng.uniform(10, 50), "camera_body_radius_mm": rng.uniform(10, 50),
                "clearance_mm": rng.uniform(0, 10),
            },
            "camera": {"focal_length_mm": 50.0}, "lamp": {"half_angle_deg": rng.uniform(0, 1)},
        }
    )  # fmt: skip


def _some_bodies(rng: np.random.Generator, far: Floats) -> tuple[list[dict[str, object]], list[dict[str, object]]]:
    side = rng.uniform(60, 200, 2)
    light, camera = (float(v) for v in far)
    every: list[dict[str, object]] = [
        {"name": "light bar", "on": "light", "from_mm": [0, side[0], 0], "to_mm": [0, side[0], light],
         "radius_mm": 15.0},
        {"name": "camera bar", "on": "camera", "from_mm": [0, -side[1], 0], "to_mm": [0, -side[1], camera],
         "radius_mm": 15.0},
        {"name": "bracket", "on": "camera", "centre_mm": [0, -side[1] / 2, camera + 20], "size_mm": [30, side[1], 20]},
        {"name": "plate", "on": "spin", "centre_mm": [0, 0, -8], "size_mm": [rng.uniform(30, 200), 60, 10]},
        {"name": "motor", "on": "tilt", "centre_mm": [0, 0, -80], "size_mm": [60, 60, 100]},
        {"name": "post", "on": "bench", "from_mm": [float(rng.uniform(-400, 400)), float(rng.uniform(-300, 300)), -300],
         "to_mm": [float(rng.uniform(-400, 400)), float(rng.uniform(-300, 300)), float(rng.uniform(-50, 500))],
         "radius_mm": 20.0},
        {"name": "cabinet", "on": "bench", "centre_mm": rng.uniform([-700, -400, 100], [700, 400, 900]).tolist(),
         "size_mm": rng.uniform(40, 300, 3).tolist()},
    ]  # fmt: skip
    chosen = [body for body in every if rng.random() < 0.4]
    cable: dict[str, object] = {
        "name": "lead", "from_on": "bench", "from_mm": [0, 300, 200], "to_on": str(rng.choice(["light", "camera"])),
        "to_mm": [0, 60, light], "length_mm": float(rng.uniform(0.9, 2.5) * light),
    }  # fmt: skip
    if rng.random() < 0.5:
        cable["sag_mm"] = float(rng.uniform(10, 60))
    return chosen, [cable] if rng.random() < 0.3 else []


# ---- an independent look at them ----


def frames(rig: RigDescription, read: dict[str, Floats]) -> dict[str, tuple[Floats, Floats]]:
    """Rotation and shift of all that is carried, at many poses: the axes as docs/mechanics.md has them."""
    arms, holder = rig.arms, rig.holder
    true = dict(read)
    for name, axis in (("light", arms.light), ("camera", arms.camera), ("azimuth", arms.azimuth)):
        for k, c, s in axis.harmonics_deg if axis is not None else ():
            true[name] = true[name] - np.radians(c * np.cos(k * read[name]) + s * np.sin(k * read[name]))
    out = {"bench": (np.broadcast_to(np.eye(3), (len(read["light"]), 3, 3)), np.zeros((len(read["light"]), 3)))}
    for name, axis in (("light", arms.light), ("camera", arms.camera)):
        leaning = turn("xz", *axis.axis_tilt_deg).as_matrix()
        shift = np.array([axis.axis_offset_mm[0], 0.0, axis.axis_offset_mm[1]])
        out[name] = leaning @ rotation("y", true[name]), np.broadcast_to(shift, (len(read["light"]), 3))
    if arms.azimuth is not None:
        leaning = turn("xy", *arms.azimuth.axis_tilt_deg).as_matrix()
        swing = leaning @ rotation("z", true["azimuth"]) @ leaning.T
        foot, (onto, shift) = np.array([*arms.azimuth.axis_offset_mm, 0.0]), out["camera"]
        out["camera"] = swing @ onto, foot + np.einsum("pij,pj->pi", swing, shift - foot)
    beside = np.array([0.0, holder.tilt_axis_offset_mm, 0.0])
    tilt = rotation("x", -true["tilt"])
    out["tilt"] = tilt, beside - tilt @ beside
    spin = rotation("y", math.radians(holder.spin_axis_tilt_deg)) @ rotation("z", true["spin"])
    out["spin"] = tilt @ spin, out["tilt"][1]
    return out


@dataclass(frozen=True)
class Solid:
    """A segment or a box, with a radius around it; the ends of a cable are carried by two."""

    name: str
    on: tuple[str, str]
    low: Floats
    high: Floats
    radius: float
    box: bool

    def placed(self, at: dict[str, tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """Of a box: its frame. Of a segment: its ends, in the lab."""
        ends = [np.einsum("pij,j->pi", at[on][0], end) + at[on][1] for on, end in zip(self.on, (self.low, self.high),
                                                                                   strict=True)]  # fmt: skip
        return at[self.on[0]] if self.box else (ends[0], ends[1])

    def nearest(self, place: tuple[Floats, Floats], to: Floats) -> Floats:
        """Its point nearest to others, at each pose."""
        if self.box:
            own = np.einsum("pji,pj->pi", place[0], to - place[1])
            inside: Floats = np.einsum("pij,pj->pi", place[0], np.clip(own, self.low, self.high)) + place[1]
            return inside
        along = place[1] - place[0]
        length = np.maximum((along**2).sum(1), 1e-300)
        t = np.clip(((to - place[0]) * along).sum(1) / length, 0.0, 1.0)
        out: Floats = place[0] + t[:, None] * along
        return out


def solids(rig: RigDescription) -> list[Solid]:
    """The bodies of a rig, its two heads, and the cables that hang."""
    out = []
    for name, on, axis, far, radius in (
        ("source head", "light", rig.arms.light, rig.geometry.light_distance_mm, rig.geometry.light_body_radius_mm),
        ("camera head", "camera", rig.arms.camera, rig.geometry.camera_distance_mm, rig.geometry.camera_body_radius_mm),
    ):
        up = math.radians(axis.elevation_deg)
        place = np.array([0.0, far * math.sin(up), far * math.cos(up)])
        out.append(Solid(name, (on, on), place, place, radius, False))
    for body in rig.bodies:
        out.append(_solid(body))
    for c in rig.cables:
        if c.sag_mm is not None:
            ends = np.array(c.from_mm), np.array(c.to_mm)
            out.append(Solid(c.name, (c.from_on, c.to_on), *ends, c.radius_mm + c.sag_mm, False))
    return out


def _solid(body: Body) -> Solid:
    on = (body.on, body.on)
    if body.from_mm is not None and body.to_mm is not None and body.radius_mm is not None:
        return Solid(body.name, on, np.array(body.from_mm), np.array(body.to_mm), body.radius_mm, False)
    centre, half = np.array(body.centre_mm), np.array(body.size_mm) / 2.0
    return Solid(body.name, on, centre - half, centre + half, 0.0, True)


def gap(one: Solid, other: Solid, at: dict[str, tuple[Floats, Floats]]) -> Floats:
    """Distances by projecting to and fro between two convex bodies, which ends at their two closest points."""
    place, there = one.placed(at), other.placed(at)
    point = there[0] if not other.box else there[1] + np.einsum("pij,j->pi", there[0], (other.low + other.high) / 2)
    before = np.full(len(point), np.inf)
    for _ in range(PROJECTIONS):
        mine = one.nearest(place, point)
        point = other.nearest(there, mine)
        size = np.linalg.norm(point - mine, axis=1)
        if np.all(before - size < 1e-9):
            break
        before = size
    out: Floats = size - one.radius - other.radius
    return out


def spare(rig: RigDescription, read: dict[str, Floats], only: str = "") -> float:
    """The smallest gap beyond the clearance at many poses, and what every cable has left; `only`: of named bodies."""
    at, every, out = frames(rig, read), solids(rig), [math.inf]

    def holder(on: str) -> str:
        return "holder" if on in ("tilt", "spin") else on

    for k, one in enumerate(every):
        for other in every[k + 1 :]:
            if {*map(holder, one.on)} & {*map(holder, other.on)} or (
                one.on[0] != one.on[1] and other.on[0] != other.on[1]
            ):
                continue
            if only and only not in (f"{one.name} and {other.name}", f"{other.name} and {one.name}"):
                continue
            out.append(float(gap(one, other, at).min()) - rig.geometry.clearance_mm)
    for cable in rig.cables:
        if only in ("", cable.name):
            ends = [np.einsum("pij,j->pi", at[on][0], np.array(p)) + at[on][1]
                    for on, p in ((cable.from_on, cable.from_mm), (cable.to_on, cable.to_mm))]  # fmt: skip
            out.append(cable.length_mm - float(np.linalg.norm(ends[0] - ends[1], axis=1).max()))
    return min(out)


def shown(rig: RigDescription, pose: Pose) -> Floats:
    """The unit vectors to source and detector in the sample's frame, one after the other."""
    at = frames(rig, {name: np.array([getattr(pose, name)]) for name in NAMES})
    holder = rig.holder
    surface = turn("xy", *holder.surface_tilt_deg).as_matrix()
    out = []
    for head in solids(rig)[:2]:
        onto, shift = at[head.on[0]]
        drawn = at["spin"][0][0].T @ (onto[0] @ head.low + shift[0] - at["spin"][1][0])
        seen = surface.T @ drawn - np.array([*holder.sample_offset_mm, holder.surface_offset_mm])
        out.append(seen / np.linalg.norm(seen))
    return np.concatenate(out)


def motion(
    rng: np.random.Generator, rig: RigDescription, start: Pose, goal: Pose, samples: int
) -> tuple[dict[str, Floats], Pose]:
    """A move whose axes go each at its own speed, to where they approach from, and then to beside their goals."""
    tracks, end, landed, approach = {}, 0.0, {}, rig.approach_deg()
    for name in NAMES:
        a, b = getattr(start, name), getattr(goal, name)
        if name not in rig.limits_deg():
            tracks[name] = np.array([0.0, 1.0]), np.array([a, a])
            continue
        lower, upper = (math.radians(v) for v in rig.limits_deg()[name])
        before = min(max(b - math.radians(approach[name]), lower), upper)
        landed[name] = min(max(b + math.radians(rng.uniform(-1, 1) * LANDING_DEG), lower), upper)
        way = np.abs(np.diff([a, before, landed[name]])) / rng.uniform(0.2, 3.0)
        tracks[name] = np.array([0.0, way[0], way.sum()]), np.array([a, before, landed[name]])
        end = max(end, way.sum())
    grid = np.linspace(0.0, end, samples)
    return {name: np.interp(grid, *track) for name, track in tracks.items()}, replace(goal, **landed)


def examine(rng: np.random.Generator, found: Found, points: int = 5, samples: int = SAMPLES) -> None:
    """One rig with some directions."""
    rig = some_rig(rng)
    poses = []
    for _ in range(points):
        theta = np.radians(rng.uniform(0, 85, 2))
        phi = rng.uniform(0, 2 * math.pi, 2) if rig.holder.axes else np.array([0.0, rng.choice([0.0, math.pi])])
        d = Directions(float(theta[0]), float(phi[0]), float(theta[1]), float(phi[1]))
        try:
            pose = reach(rig, d)
        except Unreachable as why:
            found.refused[f"{why.flag}: {why.cause.split(':')[0]}"] += 1
            _judge_refusal(rig, d, why, found)
            continue
        found.accepted += 1
        off = float(np.linalg.norm(shown(rig, pose) - np.concatenate(d.vectors)))
        if off > SAME and not rig.as_meant:
            found.closed += 1
        else:
            found.worst_inverse = max(found.worst_inverse, off)
            if off > SAME:
                found.wrong.append(f"inverse off by {off:.2g} rad: {rig.arms} {d}")
        for name, (lower, upper) in rig.limits_deg().items():
            if not lower - 1e-9 <= math.degrees(getattr(pose, name)) <= upper + 1e-9:
                found.wrong.append(f"{name} = {math.degrees(getattr(pose, name))} is beyond its limits")
        poses.append(pose)
    limits = {name: np.radians(values) for name, values in rig.limits_deg().items()}
    rest = Pose(light=float(limits["light"][0]), camera=float(limits["camera"][1]))
    if not rig.looks_ahead or not poses:
        return
    here = rest
    for goal in (*poses, *poses[::-1], rest):
        try:
            stations = motion_planning.route(rig, here, goal)
        except ConfigError as error:
            found.wrong.append(f"no way in the night: {error}")
            continue
        for station in stations:
            read, here = motion(rng, rig, here, station, samples)
            left = spare(rig, read)
            found.moves += 1
            found.smallest_spare_mm = min(found.smallest_spare_mm, left)
            if left < -ROUNDING_MM:
                found.wrong.append(f"{-left:.2f} mm inside the clearance on the way to {station}: {rig.bodies}")


def _judge_refusal(rig: RigDescription, d: Directions, why: Unreachable, found: Found) -> None:
    """Bodies that are said to be too close somewhere are: at the angles that the message names."""
    message = str(why)
    if why.flag == "blocked" and "around retro" in message:
        light, camera = np.split(np.concatenate(d.vectors), 2)
        apart = math.atan2(float(np.linalg.norm(np.cross(light, camera))), float(light @ camera))
        g = rig.geometry
        cone = math.asin(g.light_body_radius_mm / g.light_distance_mm)
        if apart > cone + math.asin(g.camera_body_radius_mm / g.camera_distance_mm) + 1e-9:
            found.wrong.append(f"not in the cone: {message}")
        return
    for part in message.removeprefix("blocked: ").split("; or "):
        way = re.search(r"would (?:touch: |tear the cable )(.*?), near (.*) deg$", part)
        at = re.search(r"^at (.*?) deg (?:the cable )?(.*?) (?:are|is) ", part)
        if not way and not at:
            continue
        bodies, angles = (way[1], way[2]) if way else (at[2], at[1]) if at else ("", "")
        read = {name: np.zeros(1) for name in NAMES}
        for named in angles.split(", "):
            name, value = named.split(" ")
            read[name] = np.radians([float(value)])
        # angles are said in tenths of a degree: half of one moves a body by so much
        rounding = math.radians(0.05) * 1.2 * max(rig.geometry.light_distance_mm, rig.geometry.camera_distance_mm) * 3
        left = spare(rig, read, bodies)
        if left > STATED_MM + rounding:
            found.wrong.append(f"{left:.2f} mm to spare: {part}")
