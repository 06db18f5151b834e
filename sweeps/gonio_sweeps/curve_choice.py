"""Which directions tell most about curves for the rig's time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gonio.geometry import Directions
from gonio.typing import Floats

from gonio_sweeps.posterior import Posterior

COVERING = 5
"""Every so many chosen points one goes where the curve is measured least, whatever the process expects there."""
DONE = 0.05
"""Weight of a place that is known well enough, beside one that is not."""
WORST = 16.0
"""A place counts at most so much more than one that is just not known well enough."""

Cost = Callable[[Sequence[int], int], Floats]
"""Rig time [s] of every candidate, given those of the batch so far, and how many points there are already."""


@dataclass(frozen=True)
class Grid:
    """Directions that may be measured, and over which curves are judged."""

    directions: Directions
    weight: Floats
    """What each stands for: its share of the curves' angle, or of the hemisphere."""
    position: Floats
    """(n, 3): places whose distance tells how far a direction lies from measured ones [rad]."""

    @classmethod
    def of(cls, d: Directions, weight: Floats) -> Grid:
        """From directions."""
        return cls(d, weight / weight.sum(), positions(d))

    def uncovered(self, measured: Directions) -> Floats:
        """Distance of every place from the nearest measured direction [rad]."""
        there = positions(measured)
        return np.asarray(np.sqrt(((self.position[:, None] - there) ** 2).sum(-1)).min(axis=1))


def positions(d: Directions) -> Floats:
    """Detector directions as points in the plane; incidences further apart than anything within one."""
    dphi = d.phi_r - d.phi_i
    theta_i, theta_r = np.broadcast_to(d.theta_i, d.shape), np.broadcast_to(d.theta_r, d.shape)
    return np.stack(
        [theta_r * np.cos(dphi), theta_r * np.sin(dphi), 10.0 * theta_i, 10.0 * np.broadcast_to(d.phi_i, d.shape)], -1
    )


def batch(
    known: Sequence[Posterior], grid: Grid, goal: float, cost: Cost, count: int, done: int, floor: float
) -> tuple[list[int], float]:
    """The next places of a grid, by the expected fall of the curves' variance per time; and the largest u_rel left.

    Each place is taken as measured before the next one is chosen: what a value will tell does not depend on the value,
    but for the kernel's parameters.

    Parameters
    ----------
    known
        One for each band.
    goal
        Relative standard uncertainty that is asked for.
    cost
        Rig time.
    count, done
        How many places; and how many points there are already.
    floor
        Of the largest value: below it uncertainties count relative to this value.
    """
    states = [_State.of(p, grid, goal, floor) for p in known]
    worst = max(float(s.u_rel.max()) for s in states)
    chosen: list[int] = []
    far = grid.uncovered(known[0].directions)
    for k in range(count):
        if (done + k) % COVERING == COVERING - 1 and far.max() > 0:
            best = int(np.argmax(far))
        else:
            gain = np.sum([s.gain(grid.weight) for s in states], axis=0)
            best = int(np.argmax(gain / cost(chosen, done)))
        chosen.append(best)
        for s in states:
            s.take(best)
        far = np.minimum(far, np.sqrt(((grid.position - grid.position[best]) ** 2).sum(-1)))
    return chosen, worst


@dataclass
class _State:
    """Of one band: what is not known yet, at the places of a grid."""

    covariance: Floats
    noise: Floats
    """Variance that a point would have."""
    scale: Floats
    """From the scale of the process to relative uncertainty."""
    goal: float

    @classmethod
    def of(cls, p: Posterior, grid: Grid, goal: float, floor: float) -> _State:
        f = p.at(grid.directions)[0]
        covariance = p.reducible(grid.directions)
        # a point's noise is that of the nearest point measured, but for slopes that no neighbour has resolved yet
        there = positions(p.directions)
        near = np.argmin(((grid.position[:, None] - there) ** 2).sum(-1), axis=1)
        usual = float(np.median(p.relative_noise))
        noise = np.clip(p.relative_noise[near], 0.5 * usual, 3.0 * usual) ** 2
        size = np.maximum(np.abs(f), floor * float(np.abs(p.brdf).max()))
        return cls(covariance, noise, 1.0 / (p.link.slope(f) * size), goal)

    @property
    def u_rel(self) -> Floats:
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) * self.scale)

    def gain(self, weight: Floats) -> Floats:
        """Of every place: the fall of the weighted variance, were it measured."""
        u = self.u_rel
        share = weight * np.where(u > self.goal, np.minimum((u / self.goal) ** 2, WORST), DONE)
        # in units of the goal: variances far above it count by their logarithm's fall rather than their size
        down = self.covariance**2 * (share * self.scale**2 / np.maximum(u, self.goal) ** 2)[:, None]
        return np.asarray(down.sum(axis=0) / (np.diag(self.covariance) + self.noise))

    def take(self, k: int) -> None:
        column = self.covariance[:, k].copy()
        self.covariance -= np.outer(column, column) / (column[k] + self.noise[k])
