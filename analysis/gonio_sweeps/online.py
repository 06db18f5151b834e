"""The values of a run that grows, quickly: every frame is read once, and only what hangs together is computed anew.

A step's count rate follows from its own frames and the dark frames. It is kept. What all values share, the level of the
white reference over time, is fitted again each time. A reduction at the end (`gonio.lab.reduction.brdf`) says more:
what errors of the angles do to each value. Samplers have models of the sample, and know that from these.
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import numpy.typing as npt

from gonio.geometry import Directions
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.reduction.growing import so_far
from gonio.lab.reduction.step_rates import Reduced, Rejected
from gonio.lab.rig import Pose
from gonio.lab.rig.light_and_camera import Band
from gonio.threads import in_threads
from gonio.typing import Floats


@dataclass(frozen=True)
class GrowingValues:
    """The values of one band so far, in the order in which they were measured."""

    rows: npt.NDArray[np.intp]
    """Of the run's points."""
    directions: Directions
    """What the encoders read."""
    poses: tuple[Pose, ...]
    """The same of the axes."""
    brdf: Floats
    """[1/sr]"""
    u_noise: Floats
    """Standard uncertainty [1/sr] of what is independent from value to value, errors of the angles left out."""
    common: dict[str, Floats]
    """By cause: the change of every value [1/sr] for one standard deviation of it; the zeros of the angles left out."""
    time_s: Floats
    """Time on the rig's clock."""

    def __len__(self) -> int:
        return int(self.brdf.size)


@dataclass
class Online:
    """What is known of a growing run: give it the run again and again."""

    band: Band
    _kept: dict[int, tuple[tuple[str, ...], Reduced | Rejected]] = field(default_factory=dict)
    """By the number of a step: its frames, and what they came to."""

    def values(self, run: Run) -> GrowingValues:
        """The values of all steps that are done.

        Frames of a batch are reduced together: what is kept follows from the journal, and a run that is gone on with
        has the values that it would have had.

        Raises
        ------
        DataError
            There are no dark frames or no usable visit to the white reference.
        """
        records = [record for record in run.steps() if record.kind == "dark" or not record.flag]
        darks = [record for record in records if record.kind == "dark"]
        lit = [record for record in records if record.kind != "dark"]
        visit = next((record for record in lit if record.kind == "reference"), None)
        starts = [batch.first_step for batch in run.batches]
        groups: dict[int, list[StepRecord]] = {}
        for record in lit:
            groups.setdefault(bisect_right(starts, record.step), []).append(record)
        seen = tuple(str(frame.sha256) for record in darks for frame in record.frames)
        for group in groups.values():
            if all(self._known(record, seen) for record in group):
                continue
            with_visit = group if visit is None or visit in group else [visit, *group]
            frames = RunFrames(run, [*darks, *with_visit])
            for record, reduced in zip(group, in_threads(partial(frames.reduce, band=self.band), group), strict=True):
                self._kept[record.step] = (_name(record, seen), reduced)
        every = [self._kept[record.step][1] for record in lit]
        points = [one for one in every if isinstance(one, Reduced) and one.point is not None]
        visits = [one for one in every if isinstance(one, Reduced) and one.point is None]
        return _values(run, points, visits, self.band)

    def _known(self, record: StepRecord, darks: tuple[str, ...]) -> bool:
        return record.step in self._kept and self._kept[record.step][0] == _name(record, darks)


def _name(record: StepRecord, darks: tuple[str, ...]) -> tuple[str, ...]:
    return (*(str(frame.sha256) for frame in record.frames), *darks)


def _values(run: Run, points: list[Reduced], visits: list[Reduced], band: Band) -> GrowingValues:
    known = so_far(run, points, visits, band)
    # the dark frames' noise, which neighbours share, counts as independent here
    variance = np.array([point.variance + float(np.sum(point.dark**2)) for point in points]) / known.level**2
    prnu = run.description.camera.prnu * np.sqrt([2.0 / point.pixels for point in points])
    return GrowingValues(
        rows=np.array([point.point for point in points], dtype=np.intp),
        directions=known.directions,
        poses=tuple(point.pose for point in points),
        brdf=known.brdf,
        u_noise=np.sqrt(variance + (prnu * known.brdf) ** 2 + known.u_visits**2),
        common=known.common,
        time_s=known.time_s,
    )
