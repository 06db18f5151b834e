"""What a journal says of a step and of its frames, and what a frame's own file says: values with a JSON form.

`to_json` and `from_json` are inverse to each other: keys keep their order and numbers their digits, because a journal's
lines are checksummed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Literal, Self, TypeVar

from gonio.errors import DataError
from gonio.rig.health import Reading
from gonio.rig.protocols import Pose

Json = dict[str, Any]
"""An object of JSON."""
Kind = Literal["dark", "reference", "point"]
Parsed = TypeVar("Parsed")

LABEL_FORMAT = "gonio-frame-1"
AXES = tuple(field.name for field in fields(Pose))
_of_axes = attrgetter(*AXES)


@dataclass(frozen=True, slots=True)
class FrameFile:
    """What the file of a frame is, once it is on the disk."""

    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One frame of a step."""

    file: str
    """Its name in `frames/`."""
    band: str
    """"" for a dark frame."""
    exposure_s: float
    time_s: float
    """Start of the exposure on the rig's clock."""
    lamp: bool
    """Whether the lamp was lit."""
    sha256: str | None = None
    """None until the file is on the disk."""
    bytes: int | None = None
    """Size of the file; None where it is not known."""
    monitor: float | None = None
    """Reading of the lamp's monitor during the exposure, in its own unit; None where there is none."""

    def stored(self, file: FrameFile) -> FrameRecord:
        """This frame, with what its file is."""
        return FrameRecord(
            self.file, self.band, self.exposure_s, self.time_s, self.lamp, file.sha256, file.bytes, self.monitor
        )

    def to_json(self) -> Json:
        """As it stands in the journal."""
        out: Json = {"file": self.file, "band": self.band, "exposure_s": self.exposure_s, "time_s": self.time_s}
        out["lamp"] = self.lamp
        for name in ("sha256", "bytes", "monitor"):
            if (value := getattr(self, name)) is not None:
                out[name] = value
        return out

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Raises `DataError` where something is missing."""
        return _parsed("frame", lambda: cls._of(values))

    @classmethod
    def _of(cls, values: Mapping[str, Any]) -> Self:
        return cls(
            values["file"],
            sys.intern(values["band"]),
            values["exposure_s"],
            values["time_s"],
            values["lamp"],
            values.get("sha256"),
            values.get("bytes"),
            values.get("monitor"),
        )


@dataclass(frozen=True, slots=True)
class StepRecord:
    """A step that was taken whole: where the axes stood, and its frames."""

    step: int
    """Its number in the schedule."""
    kind: Kind
    point: int | None
    """Row of the plan, for a point."""
    time_s: float
    """Of its first frame on the rig's clock."""
    goal: Pose
    pose: Pose
    """What the encoders read before the frames; for a dark, after them."""
    pose_time_s: float | None
    """None in runs from before it was kept."""
    flag: str
    """"" or why the step counts for nothing: it has no frames, or none that tell of its pose ("unsteady")."""
    frames: tuple[FrameRecord, ...]
    pose_after: Pose | None = None
    """What the encoders read after the frames."""
    pose_after_time_s: float | None = None
    level_per_s: Mapping[str, float] | None = None
    """By band: the brightest used pixel, as a fraction of full scale, for an exposure of one second."""
    pose_spread: Pose | None = None
    """Largest less smallest of the readings whose mean `pose` is; None where the rig does not tell."""
    health: tuple[Reading, ...] = ()
    """What was read of the rig's devices after the frames, without limits; empty in runs from before it was kept."""

    def to_json(self) -> Json:
        """As it stands in the journal, without the line's number, time and checksum."""
        out: Json = {
            "event": "step",
            "step": self.step,
            "kind": self.kind,
            "point": self.point,
            "time_s": self.time_s,
            "goal": _axes(self.goal),
            "pose": _axes(self.pose),
        }
        if self.pose_time_s is not None:
            out["pose_time_s"] = self.pose_time_s
        if self.pose_after is not None:
            out |= {"pose_after": _axes(self.pose_after), "pose_after_time_s": self.pose_after_time_s}
        if self.pose_spread is not None:
            out["pose_spread"] = _axes(self.pose_spread)
        if self.level_per_s is not None:
            out["level_per_s"] = dict(self.level_per_s)
        if self.health:
            out["health"] = [[r.device, r.quantity, r.value, r.unit] for r in self.health]
        return out | {"flag": self.flag, "frames": [frame.to_json() for frame in self.frames]}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Raises `DataError` where something is missing."""
        return _parsed("step", lambda: cls._of(values))

    @classmethod
    def _of(cls, values: Mapping[str, Any]) -> Self:
        after, spread = values.get("pose_after"), values.get("pose_spread")
        return cls(
            values["step"],
            sys.intern(values["kind"]),  # type: ignore[arg-type]
            values["point"],
            values["time_s"],
            Pose(**values["goal"]),
            Pose(**values["pose"]),
            values.get("pose_time_s"),
            sys.intern(values["flag"]),
            tuple(map(FrameRecord._of, values["frames"])),
            None if after is None else Pose(**after),
            values.get("pose_after_time_s"),
            values.get("level_per_s"),
            None if spread is None else Pose(**spread),
            tuple(
                Reading(sys.intern(d), sys.intern(q), value, sys.intern(u))
                for d, q, value, u in values.get("health", ())
            ),
        )


@dataclass(frozen=True, slots=True)
class FrameLabel:
    """What the file of a frame says of itself: which frame it is, of which step of which run."""

    run: str
    """`Run.key`."""
    step: int
    kind: Kind
    point: int | None
    number: int
    """Of the frame in its step, from 1."""
    count: int
    """How many frames the step has; with planned brackets, up to the last one of the bands that were planned so far."""
    frame: FrameRecord
    goal: Pose | None
    """Where the step was to stand, and what the encoders read before its frames; None for a dark."""
    pose: Pose | None
    pose_time_s: float | None
    record: StepRecord | None = None
    """In the last frame of a step: all that the journal says of it, but for what this file is."""

    def to_json(self) -> Json:
        """As it stands in the frame's file."""
        out: Json = {"format": LABEL_FORMAT, "run": self.run, "step": self.step, "kind": self.kind, "point": self.point}
        out |= {"frame": self.number, "of": self.count, **self.frame.to_json()}
        if self.goal is not None and self.pose is not None:
            out |= {"goal": _axes(self.goal), "pose": _axes(self.pose), "pose_time_s": self.pose_time_s}
        return out if self.record is None else out | {"event": self.record.to_json()}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Raises `DataError` where something is missing."""
        return _parsed("frame", lambda: cls._of(values))

    @classmethod
    def _of(cls, values: Mapping[str, Any]) -> Self:
        if values["format"] != LABEL_FORMAT:
            raise ValueError(f'its format is "{values["format"]}"')
        goal, pose, record = (values.get(name) for name in ("goal", "pose", "event"))
        return cls(
            values["run"],
            values["step"],
            values["kind"],
            values["point"],
            values["frame"],
            values["of"],
            FrameRecord._of(values),
            None if goal is None else Pose(**goal),
            None if pose is None else Pose(**pose),
            values.get("pose_time_s"),
            None if record is None else StepRecord._of(record),
        )


def _axes(pose: Pose) -> Json:
    return dict(zip(AXES, _of_axes(pose), strict=True))


def _parsed(what: str, parse: Callable[[], Parsed]) -> Parsed:
    try:
        return parse()
    except KeyError as error:
        raise DataError(f"the record of a {what} has no {error.args[0]!r}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise DataError(f"the record of a {what} cannot be understood: {error}") from None
