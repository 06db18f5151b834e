"""The values of a run that is being measured, from the rates that its steps have come to so far.

Two kinds of readers keep these rates, and each step's frames are read once. `gonio_watch.provisional` takes steps in
any order, and shows them soon. `gonio_sweeps.online` reduces the frames of a batch together, so that what it says
follows from the journal, however often the run was stopped. What both make of the rates is here: the level of the white
reference is fitted again each time, because every visit changes it. `gonio.lab.reduction.brdf` says more at the end:
what errors of the angles do to each value.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.geometry import Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.reduction.step_rates import Reduced
from gonio.lab.rig.light_and_camera import Band
from gonio.typing import Floats


@dataclass(frozen=True, slots=True)
class SoFar:
    """The values of one band; arrays run over the points as they were given."""

    points: tuple[Reduced, ...]
    """Empty where only their rates were given."""
    directions: Directions
    """What the encoders read."""
    time_s: Floats
    """Time on the rig's clock."""
    level: Floats
    """Signal per unit BRDF when each was measured [e- sr/s]."""
    brdf: Floats
    """[1/sr]"""
    u_visits: Floats
    """Standard uncertainty [1/sr], independent from value to value, by what the level does between two visits."""
    common: dict[str, Floats]
    """By cause: the change of every value [1/sr] for one standard deviation of it; the zeros of the angles left out."""


def so_far(run: Run, points: Sequence[Reduced], visits: Sequence[Reduced], band: Band) -> SoFar:
    """The values that the rates of points and of visits to the white reference give.

    Raises
    ------
    DataError
        There is no usable visit to the white reference, or one of them saw no light.
    ConfigError
        The reference's table is missing, or neither a table nor an albedo is given.
    """
    rate, time_s = (np.array([getattr(point, name) for point in points]) for name in ("rate", "time_s"))
    directions = Directions.stack([point.directions for point in points])
    return replace(of_rates(run, rate, time_s, directions, visits, band), points=tuple(points))


def of_rates(
    run: Run, rate: Floats, time_s: Floats, directions: Directions, visits: Sequence[Reduced], band: Band
) -> SoFar:
    """`so_far` of points of which only this is kept: their rates [e-/s], times and directions."""
    fitted, _, u_reference = brdf.level(run, time_s, list(visits), band)
    level = fitted.at(time_s)
    value = rate / level
    return SoFar(
        points=(),
        directions=directions,
        time_s=time_s,
        level=level,
        brdf=value,
        u_visits=value * fitted.wander(time_s).u / level,
        common=fitted.changes(value, time_s, u_reference),
    )
