"""Which directions tell most about curves for the rig's time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_sweeps.posterior import Posterior
from gonio_sweeps.sampler import highest

COVERING = 5
"""Every so many chosen points one goes where the curve is measured least, whatever the process expects there."""
STEEP_TURNS = (1, 3)
"""Of every `COVERING` points these go into the steepest gap, as long as there is one."""
STEEP = 0.7
"""A gap is steep where the logarithm of the curve changes by more from the nearest point on."""
DONE = 0.05
"""Weight of a place that is known well enough, beside one that is not."""
WORST = 400.0
"""A place counts at most so much more than one that is just not known well enough."""


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
        return np.asarray(np.sqrt(((self.position[:, None] - positions(measured)) ** 2).sum(-1)).min(axis=1))


def positions(d: Directions) -> Floats:
    """Detector directions as points in the plane; incidences further apart than anything within one."""
    dphi = d.phi_r - d.phi_i
    theta_i, theta_r = np.broadcast_to(d.theta_i, d.shape), np.broadcast_to(d.theta_r, d.shape)
    return np.stack(
        [theta_r * np.cos(dphi), theta_r * np.sin(dphi), 10.0 * theta_i, 10.0 * np.broadcast_to(d.phi_i, d.shape)], -1
    )


def batch(
    known: Sequence[Posterior],
    noise: Sequence[Floats],
    grid: Grid,
    goal: float,
    cost: Floats,
    count: int,
    done: int,
    floor: float,
) -> tuple[list[int], list[Floats], list[int]]:
    """The next places of a grid, by the expected fall of the curves' variance per cost.

    Each place is taken as measured before the next one is chosen: what a value will tell does not depend on the value,
    but for the kernel's parameters.

    Parameters
    ----------
    known, noise
        For each band: what is known, and the relative standard uncertainty that every place would be measured with.
    goal
        Relative standard uncertainty that is asked for.
    cost
        Of every place.
    count, done
        How many places; and how many points there are already.
    floor
        Of the largest value: below it uncertainties count relative to this value.

    Returns
    -------
    tuple
        The places in the order of their choice; for each band the relative standard uncertainty of every place now;
        those of the chosen places that cover.
    """
    states = [_State.of(p, u, grid, goal, floor) for p, u in zip(known, noise, strict=True)]
    u_rel = [s.u_rel for s in states]
    chosen, covers = list[int](), list[int]()
    far = grid.uncovered(known[0].directions)
    slope = np.max([p.steepness(grid.directions, floor) for p in known], axis=0)
    for k in range(count):
        turn = (done + k) % COVERING
        # whatever the process expects in a steep gap: a flank is easily taken for that of another incidence
        steep = turn in STEEP_TURNS and (far * slope).max() > STEEP
        if steep or (turn == COVERING - 1 and far.max() > 0):
            best = int(np.argmax(np.round(far * slope if steep else far, 9)))
            covers.append(best)
        else:
            best = highest(np.sum([s.gain(grid.weight) for s in states], axis=0) / cost)
        chosen.append(best)
        for s in states:
            s.take(best)
        far = np.minimum(far, np.sqrt(((grid.position - grid.position[best]) ** 2).sum(-1)))
    return chosen, u_rel, covers


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
    def of(cls, p: Posterior, noise: Floats, grid: Grid, goal: float, floor: float) -> _State:
        f, covariance, variance = p.expected(grid.directions, noise)
        size = np.maximum(np.abs(f), floor * float(np.abs(p.brdf).max()))
        return cls(covariance, variance, 1.0 / (p.link.slope(f) * size), goal)

    @property
    def u_rel(self) -> Floats:
        """Relative standard uncertainty of every place."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)) * self.scale)

    def gain(self, weight: Floats) -> Floats:
        """Of every place: the fall of the weighted variance, were it measured."""
        u = self.u_rel
        share = weight * np.where(u > self.goal, np.minimum((u / self.goal) ** 2, WORST), DONE)
        # in units of what is there, where that is far above the goal: a place that nothing is known of is not all
        down = self.covariance**2 * (share * self.scale**2 / np.maximum(u, self.goal) ** 2)[:, None]
        return np.asarray(down.sum(axis=0) / (np.diag(self.covariance) + self.noise))

    def take(self, k: int) -> None:
        """A value at a place is there, whatever it is."""
        column = self.covariance[:, k].copy()
        self.covariance -= np.outer(column, column) / (column[k] + self.noise[k])
