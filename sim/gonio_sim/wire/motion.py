"""Motion of a servo's shaft in closed form: position and velocity at any time, without a simulation loop."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Phase:
    """Constant acceleration from a state, for a while (for ever in the last phase)."""

    start: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time: float) -> tuple[float, float]:
        """Position and velocity at a time [s] after the start of the phase."""
        t = time - self.start
        a = self.acceleration
        return self.position + self.velocity * t + 0.5 * a * t * t, self.velocity + a * t


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Phases in order of time; counts, and counts a second."""

    phases: tuple[Phase, ...]

    @property
    def end_s(self) -> float:
        """When the shaft comes to rest."""
        return self.phases[-1].start

    def at(self, time: float) -> tuple[float, float]:
        """Position and velocity at a time."""
        here = self.phases[0]
        for phase in self.phases:
            if phase.start <= time:
                here = phase
        return here.at(max(time, here.start))


def rest(time: float, position: float) -> Trajectory:
    """Standing still."""
    return Trajectory((Phase(time, position, 0.0, 0.0),))


def to_speed(time: float, position: float, velocity: float, speed: float, acceleration: float) -> Trajectory:
    """Ramp to a constant speed and keep it."""
    ramp = abs(speed - velocity) / acceleration
    rate = math.copysign(acceleration, speed - velocity)
    first = Phase(time, position, velocity, rate)
    there, _ = first.at(time + ramp)
    return Trajectory((first, Phase(time + ramp, there, speed, 0.0)))


def to_position(
    time: float, position: float, velocity: float, goal: float, speed: float, acceleration: float
) -> Trajectory:
    """Trapezoidal profile to a goal, from whatever the shaft is doing now.

    Parameters
    ----------
    speed, acceleration
        Positive limits [counts/s], [counts/s^2].
    """
    phases = []
    if velocity != 0:
        stop = velocity * abs(velocity) / (2 * acceleration)
        if (goal - position - stop) * velocity < 0 or abs(velocity) > speed:  # must turn round or slow down
            phases.append(Phase(time, position, velocity, -math.copysign(acceleration, velocity)))
            time += abs(velocity) / acceleration
            position, velocity = position + stop, 0.0
    way = goal - position
    sign = math.copysign(1.0, way)
    v0 = abs(velocity)
    peak = min(speed, math.sqrt(acceleration * abs(way) + v0 * v0 / 2))
    rise, fall = (peak - v0) / acceleration, peak / acceleration
    cruise = max(0.0, abs(way) - (v0 + peak) / 2 * rise - peak / 2 * fall) / peak if peak > 0 else 0.0
    for length, rate in ((rise, acceleration), (cruise, 0.0), (fall, -acceleration)):
        phase = Phase(time, position, sign * v0, sign * rate)
        phases.append(phase)
        position, v = phase.at(time + length)
        v0 = abs(v)
        time += length
    phases.append(Phase(time, goal, 0.0, 0.0))
    return Trajectory(tuple(phases))
