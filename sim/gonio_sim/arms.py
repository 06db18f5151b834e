"""Simulated axes: encoder counts, backlash, and zeros that are known, not quite known, or hidden.

An encoder sits on the motor's side of the gear. It reads whole counts. The motor stops when its encoder shows the count
that is nearest to the goal; within that count it may stand anywhere, with equal probability. So the true position is
uniform over one encoder step around what is read, which is the standard uncertainty step / sqrt(12) of a reading.

The arm follows with backlash: on the way up the lower flank of the gear pushes it, on the way down the upper one, and
it lags by `backlash_deg`. Every goal is approached from below, from `acquisition.approach_deg` away (from above, where
that is negative), which takes up the backlash if the approach is longer; the zero offset is defined for that side.
The approach never leaves the limits, and is shorter near them. What is left is

    true = r - (the encoder's error within its turn at r) - (encoder_noise_deg, drawn at every landing)
    r    = encoder - zero_offset_deg - (what the calibration missed, drawn once from N(0, zero_u_deg))
    read = encoder in whole counts - zero_offset_deg, or without it where `zero_offset_known = false`

The first offset is the true one (`World.truth`), the second what the rig file or a calibration says.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gonio.errors import ConfigError
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Axis
from gonio.lab.rig.kinematics import AXES, encoder_error
from gonio.lab.rig.motion_planning import route, touching
from gonio_sim.world import SETTLE_S, Stream, World

LOOK_S = 0.05
"""How finely a way is looked at for collisions: 1.5 deg of an arm at its usual speed."""
NOISE = 1
"""Of a landing's random numbers the one for the encoder's noise."""
ROUNDING = 1e-9
"""A goal this close [rad] to a limit is at the limit."""


class Mechanism:
    """One axis. Angles are radians; the encoder's own zero is where the arm stands at -zero_offset."""

    def __init__(self, known: Axis, axis: Axis, zero_error: float, rest: float, approach: float) -> None:
        self._step = math.radians(axis.encoder_step_deg)
        self._backlash = math.radians(axis.backlash_deg)
        self._offset = math.radians(axis.zero_offset_deg)
        self._known_offset = math.radians(known.zero_offset_deg) if known.zero_offset_known else 0.0
        self._zero_error = zero_error
        self._axis = axis
        self.noise = math.radians(axis.encoder_noise_deg)
        """Standard deviation of readings [rad]."""
        self.speed = math.radians(axis.speed_deg_per_s)
        self._rest = rest
        self._play = (0.0, self._backlash) if approach >= 0.0 else (-self._backlash, 0.0)
        """How far the arm may lie from the motor, on either side; nothing where the approach has taken it up."""
        self.rest()

    def rest(self) -> None:
        """Stand at the rest position, reached from the wrong side: the backlash is open, as before a first approach."""
        self.encoder = self._rest + self._known_offset
        self._noise = 0.0
        self.arm = self.encoder + sum(self._play)

    def land(self, start: float, goal: float, within: float, noise: float = 0.0) -> None:
        """Go to `start`, then to the goal; the motor stops at `within`, in [-1/2, 1/2), of its count.

        The reading is wrong by `noise` [rad], beside what is always wrong with it.
        """
        self._noise = noise
        target = goal + self._known_offset
        if self._step > 0.0:
            target = (round(target / self._step) + within) * self._step
        for encoder in (target - (goal - start), target):
            self.encoder = encoder
            self.arm = min(max(self.arm, encoder + self._play[0]), encoder + self._play[1])

    @property
    def reading(self) -> float:
        """What the encoder shows, with the zero offset taken out if it is known."""
        counted = round(self.encoder / self._step) * self._step if self._step > 0.0 else self.encoder
        return counted - self._known_offset

    @property
    def true(self) -> float:
        """Where the arm is."""
        error = encoder_error(self._axis, self.encoder - self._offset - self._zero_error) + self._noise
        return self.arm - self._offset - self._zero_error - error


class SimulatedArms:
    """All axes of the simulated rig, as an `ArmsDevice`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._limits = {name: tuple(map(math.radians, pair)) for name, pair in world.description.limits_deg().items()}
        self._approach = {n: math.radians(value) for n, value in world.description.approach_deg().items()}
        # out of each other's way: the light on its lower end, the camera on its upper end, the holder at zero
        self._rest = {name: 0.0 for name in world.description.axes()}
        self._rest["light"], self._rest["camera"] = self._limits["light"][0], self._limits["camera"][1]
        known = world.description.axes()
        self._axes = {
            name: Mechanism(known[name], axis, world.zero_error[name], self._rest[name], self._approach[name])
            for name, axis in world.truth.axes().items()
        }
        self._moves = 0
        self._publish()

    def begin(self) -> None:
        """Stand where every step begins: at rest."""
        for axis in self._axes.values():
            axis.rest()
        self._moves = 0
        self._publish()

    def move(self, goal: Pose) -> Pose:
        """Drive every axis to `goal` from below; what the encoders read there."""
        self._world.require_open("arms")
        self._drive(self._checked(goal))
        return self.read()

    def jog(self, goals: Mapping[str, float]) -> Pose:
        """Drive some axes from below, and leave the others where they stand; what all encoders read then.

        Raises
        ------
        ConfigError
            The rig has no such axis, or a goal [rad] is beyond a limit; nothing has moved.
        """
        self._world.require_open("arms")
        for name in goals:
            if name not in self._axes:
                known = ", ".join(self._axes)
                raise ConfigError(f'the rig "{self._world.description.name}" has no axis {name}; it has {known}')
        inside = Pose(**{name: limits[0] for name, limits in self._limits.items()})  # a pose that no limit forbids
        wanted = self._checked(replace(inside, **goals))
        self._drive({name: wanted[name] for name in goals})
        return self.read()

    def read(self) -> Pose:
        """What the encoders read, now."""
        self._world.require_open("arms")
        return self._inner()

    def stop(self) -> None:
        """Nothing moves between two calls, so there is nothing to stop."""

    def park(self) -> None:
        """Drive to the rest position, by a free way."""
        for pose in route(self._world.description, self._inner(), Pose(**self._rest)):
            self._drive({name: getattr(pose, name) for name in self._axes})

    def _drive(self, goals: Mapping[str, float]) -> None:
        durations = []
        before = self._world.pose
        for number, (name, axis) in enumerate(self._axes.items()):
            if name not in goals:
                continue
            way = abs(goals[name] - axis.reading) + 2.0 * abs(self._approach[name])
            durations.append(way / axis.speed)
            within = self._world.uniform(Stream.LANDING, self._world.step, self._moves, number)
            address = Stream.LANDING, self._world.step, self._moves, number, NOISE
            noise = self._world.normal(*address) * axis.noise if axis.noise else 0.0
            axis.land(self._start(name, goals[name]), goals[name], within, noise)
        self._moves += 1
        self._world.spend(max(durations) + SETTLE_S)
        self._publish()
        if self._world.description.looks_ahead:
            self._collide(before, goals)

    def _collide(self, before: Pose, goals: Mapping[str, float]) -> None:
        """Follow the axes on their way, each at its own speed, and note what meets what."""
        ways: dict[str, list[tuple[float, float]]] = {}
        for name, goal in goals.items():
            speed, at, time = self._axes[name].speed, getattr(before, name), 0.0
            ways[name] = [(0.0, at)]
            for place in (self._start(name, goal), getattr(self._world.pose, name)):
                time += abs(place - at) / speed
                at = place
                ways[name].append((time, at))
        end = max(way[-1][0] for way in ways.values())
        for time in np.linspace(0.0, end, 2 + int(end / LOOK_S)):
            angles = {n: float(np.interp(time, *np.array(way).T)) for n, way in ways.items()}
            self._world.touched += touching(self._world.description, replace(before, **angles))

    def _inner(self) -> Pose:
        """What the encoders read, the rig being open or not."""
        return Pose(**{name: axis.reading for name, axis in self._axes.items()})

    def _start(self, name: str, goal: float) -> float:
        """Where the approach to a goal begins: inside the limits."""
        lower, upper = self._limits[name]
        return min(max(goal - self._approach[name], lower), upper)

    def _publish(self) -> None:
        self._world.pose = Pose(**{name: axis.true for name, axis in self._axes.items()})

    def _checked(self, goal: Pose) -> dict[str, float]:
        out = {}
        for name in AXES:
            value = getattr(goal, name)
            if name not in self._axes:
                if abs(value) > ROUNDING:
                    raise ConfigError(
                        f'{name} = {math.degrees(value):g} deg: the rig "{self._world.description.name}" has no such '
                        f"axis; it has {', '.join(self._axes)}"
                    )
                continue
            lower, upper = self._limits[name]
            if not lower - ROUNDING <= value <= upper + ROUNDING:
                raise ConfigError(
                    f"{name} = {math.degrees(value):g} deg is outside the limits of this axis, "
                    f"{math.degrees(lower):g} to {math.degrees(upper):g} deg, of the rig "
                    f'"{self._world.description.name}"'
                )
            out[name] = min(max(value, lower), upper)
        return out
