"""What the reduction makes of one band of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gonio.documents import JsonObject
from gonio.geometry import Directions
from gonio.reduction import white_reference
from gonio.reduction.count_rates import Reduced
from gonio.rig.description import Band
from gonio.typing import Floats


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the values of a band were computed from."""

    points: list[Reduced]
    """Those that have a value, in the order of `BandResult.points`."""
    visits: list[Reduced]
    """To the white reference."""
    prnu: float
    """Relative standard deviation of the pixels' responsivities, after maps where there are any."""


@dataclass(frozen=True, slots=True)
class BandResult:
    """One band of a run: its rows by point, why others have none, and what the attributes say of it."""

    band: Band
    points: npt.NDArray[np.intp]
    """Those that have a value."""
    columns: dict[str, Floats]
    """Of the table and of its budget, a number for each of them."""
    darks: Floats
    """Change of each value [1/sr] by the noise of the dark frames, see `Reduced.dark`; shape (points, 2, n)."""
    geometry: Floats
    """Change of each value [1/sr] by the causes of `GeometryErrors`, shape (points, causes)."""
    lamp: Floats
    """By how the lamp may wander between visits to the white reference, shape (points, causes)."""
    flags: dict[int, str]
    level: white_reference.Level
    reference_brdf: float
    u_reference_rel: float
    """Relative standard uncertainty of it: of the certificate, and of what is interpolated in it."""
    visits: int
    unusable: list[str]
    """The flags of the other visits."""
    scatter: float
    """Reduced chi-square of the frames around the means of their steps."""
    freedom: int
    frames: int
    """Of points and visits, used or not."""
    left_out: int
    """Of these: because a used pixel is nearly full."""
    undetermined: Directions
    """Nominal directions of points that may see a spike of which only a bound is known."""
    coarse: Directions
    """Nominal directions of points beside a lobe that is narrower than the plan's steps."""
    inputs: Inputs
    merged: JsonObject = field(default_factory=dict)
    """How the frames were merged pixel by pixel; empty where whole frames were."""
