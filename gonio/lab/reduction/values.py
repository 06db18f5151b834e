"""The values of one band, and what each cause of uncertainty does to them: the one table that a reduction fills.

A cause is a function that takes a measured band and its values, and adds what it does: to `own` a standard uncertainty
of each value's own, to `common` a signed change that values share. `u_random` and `u_brdf` follow from these.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from gonio.lab.reduction import white_reference
from gonio.lab.reduction.angle_sensitivity import PointLobes
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.reduction.dark_signal import strongest
from gonio.lab.reduction.step_rates import Reduced
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.typing import Bools, Floats, Ints, JsonObject


@dataclass(frozen=True, slots=True)
class MeasuredBand:
    """The points of one band, and the light in which they were measured."""

    frames: RunFrames
    band: Band
    points: list[Reduced]
    """Those that have a rate. For the causes of uncertainty, those on one side of the sample: directions behind it are
    mirrored at its plane."""
    visits: list[Reduced]
    """The usable visits to the white reference."""
    fitted: white_reference.Level
    reference_brdf: float
    """Mean over the visits [1/sr]; 1 where the lamp itself is the reference."""
    u_reference: float
    """Relative standard uncertainty of that: of the certificate, and of what is interpolated in it."""

    @property
    def description(self) -> RigDescription:
        """The rig."""
        return self.frames.description

    @property
    def visit(self) -> Reduced:
        """The first visit to the white reference."""
        return self.visits[0]

    @property
    def rows(self) -> Ints:
        """The rows of the plan that have a value."""
        return np.array([point.point for point in self.points], dtype=np.intp)

    @property
    def times_s(self) -> Floats:
        """When each point was measured, on the rig's clock."""
        return np.array([point.time_s for point in self.points])

    @property
    def level(self) -> Floats:
        """Signal per unit BRDF when each point was measured [e- sr/s]."""
        return self.fitted.at(self.times_s)


@dataclass(slots=True)
class Values:
    """The values of some points [1/sr], and what is known of each."""

    brdf: Floats
    lobes: PointLobes
    """How the values follow the angles."""
    bounded: Bools
    """Whether a value may see a spike of which only a bound is known."""
    coarse: Bools
    """Whether the plan's steps leave a slope open by more than everything else."""
    own: dict[str, Floats] = field(default_factory=dict)
    """Standard uncertainties [1/sr] of each value's own, by the parts of `u_random`."""
    common: dict[str, Floats] = field(default_factory=dict)
    """Changes [1/sr] for one standard deviation of causes that values share, by columns of the table."""
    shared: dict[str, Floats] = field(default_factory=dict)
    """Changes [1/sr], shape (points, causes), by causes that all bands share and that are too many for columns: `share`
    makes the strongest columns, and leaves the rest to the part of `u_random` whose name they have here."""
    of_readings: dict[str, Floats] = field(default_factory=dict)
    """Of `own`: `u_angles`, by errors of the readings; and `geometry_slopes`, what the steps leave of the geometry."""

    @property
    def u_random(self) -> Floats:
        """Standard uncertainty of each value's own [1/sr]."""
        return np.asarray(np.sqrt(sum(u**2 for u in self.own.values())))

    @property
    def u_brdf(self) -> Floats:
        """Combined standard uncertainty [1/sr]."""
        return np.asarray(np.sqrt(self.u_random**2 + sum(change**2 for change in self.common.values())))

    def columns(self) -> dict[str, Floats]:
        """What the measurement table has of these values."""
        return {"brdf": self.brdf, "u_brdf": self.u_brdf, "u_random": self.u_random} | self.common | self.of_readings


Cause = Callable[[MeasuredBand, Values], None]
"""Adds what a cause of uncertainty does to the values of a band."""


@dataclass(frozen=True, slots=True)
class BandResult:
    """One band of a run: its values, why other points have none, and what the table's attributes say of it."""

    measured: MeasuredBand
    values: Values
    flags: dict[int, str]
    """Why points have none, by their rows of the plan."""
    unusable: list[str]
    """The flags of the other visits."""
    scatter: float
    """Reduced chi-square of the frames around the means of their steps."""
    freedom: int
    frames: int
    """Frames of points and visits, used or not."""
    left_out: int
    """Of these, frames left out because a used pixel is nearly full."""
    merged: JsonObject = field(default_factory=dict)
    """How the frames were merged pixel by pixel; empty where whole frames were."""

    @property
    def band(self) -> Band:
        """Its name, centre and width."""
        return self.measured.band

    @property
    def rows(self) -> Ints:
        """The rows of the plan that have a value."""
        return self.measured.rows


def joined(parts: Sequence[Any], rows: Sequence[Ints]) -> Any:
    """Values, or a part of them, of which each has some rows, as one."""
    first = parts[0]
    if is_dataclass(first):
        named = {f.name: joined([getattr(part, f.name) for part in parts], rows) for f in fields(first)}
        return type(first)(**named)  # type: ignore[misc]
    if isinstance(first, dict):
        return {name: joined([part[name] for part in parts], rows) for name in first}
    out = np.zeros((sum(map(len, rows)), *first.shape[1:]), first.dtype)
    for part, at in zip(parts, rows, strict=True):
        out[at] = part
    return out


def share(bands: Sequence[Values], part: str, names: Sequence[str]) -> None:
    """Give all values the columns `names` of the causes `shared[part]`; what these leave goes to `own[part]`."""
    effects = [values.shared.pop(part) for values in bands]
    wide = max(each.shape[1] for each in effects)
    padded = np.concatenate([np.pad(each, ((0, 0), (0, wide - each.shape[1]))) for each in effects])
    names = names[: min(len(names), wide)]
    columns, rest = np.zeros((len(padded), len(names))), np.zeros(len(padded))
    if padded.size:
        columns, rest = strongest(padded, np.concatenate([values.u_random for values in bands]), len(names))
    start = 0
    for values in bands:
        at = slice(start, start + values.brdf.size)
        start = at.stop
        values.common |= dict(zip(names, columns[at].T, strict=True))
        values.own[part] = np.sqrt(values.own.get(part, 0.0) ** 2 + rest[at])
