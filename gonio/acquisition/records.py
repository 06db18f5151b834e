"""What a journal says of a step and of its frames, and what a frame's own file says: values with a JSON form.

`text` and `from_json` are inverse to each other: keys keep their order and numbers their digits, because a journal's
lines are checksummed. The text is put together by hand: the same poses stand in the labels of a step's frames and in
its line, and to encode each of them anew would take as long as the frames themselves.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from operator import attrgetter
from typing import Any, Literal, Self, TypeVar

from gonio.documents import JsonObject
from gonio.errors import DataError
from gonio.rig.health import Reading
from gonio.rig.protocols import Pose

"""An object of JSON."""
Kind = Literal["dark", "reference", "point"]
Parsed = TypeVar("Parsed")

LABEL_FORMAT = "gonio-frame-1"
AXES = tuple(field.name for field in fields(Pose))
_of_axes = attrgetter(*AXES)
compact = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
"""JSON without spaces; raises `ValueError` for numbers that it does not have."""


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

    def members(self, file: FrameFile | None = None) -> str:
        """As it stands in the journal, without braces; `file` is what its file is, where it does not say so itself."""
        out = (
            f'"file":{compact(self.file)},"band":{compact(self.band)},"exposure_s":{_number(self.exposure_s)},'
            f'"time_s":{_number(self.time_s)},"lamp":{"true" if self.lamp else "false"}'
        )
        sha256, count = (self.sha256, self.bytes) if file is None else (file.sha256, file.bytes)
        if sha256 is not None:
            out += f',"sha256":{compact(sha256)}'
        if count is not None:
            out += f',"bytes":{_number(count)}'
        if self.monitor is not None:
            out += f',"monitor":{_number(self.monitor)}'
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

    def text(self, files: Sequence[FrameFile] = ()) -> str:
        """As it stands in the journal, without the line's number, time and checksum.

        `files` says of its first frames what their files are, where the record does not.
        """
        out = [
            f'{{"event":"step","step":{_number(self.step)},"kind":{compact(self.kind)},"point":{_number(self.point)},'
            f'"time_s":{_number(self.time_s)},"goal":{_axes(self.goal)},"pose":{_axes(self.pose)}'
        ]
        if self.pose_time_s is not None:
            out.append(f',"pose_time_s":{_number(self.pose_time_s)}')
        if self.pose_after is not None:
            out.append(f',"pose_after":{_axes(self.pose_after)},"pose_after_time_s":{_number(self.pose_after_time_s)}')
        if self.pose_spread is not None:
            out.append(f',"pose_spread":{_axes(self.pose_spread)}')
        if self.level_per_s is not None:
            levels = (f"{compact(band)}:{_number(level)}" for band, level in self.level_per_s.items())
            out.append(f',"level_per_s":{{{",".join(levels)}}}')
        if self.health:
            rows = [[r.device, r.quantity, r.value, r.unit] for r in self.health]
            out.append(f',"health":{compact(rows)}')
        known = [*files, *(None for _ in self.frames[len(files) :])]
        frames = (f"{{{frame.members(file)}}}" for frame, file in zip(self.frames, known, strict=True))
        out.append(f',"flag":{compact(self.flag)},"frames":[{",".join(frames)}]}}')
        return "".join(out)

    def to_json(self) -> JsonObject:
        """`text` as an object."""
        out: JsonObject = json.loads(self.text())
        return out

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
    pixels: str | None = None
    """SHA-256 of the frame's pixels (`gonio.rig.dng.pixels_sha256`), or of all of a camera's own file; None in frames
    from before it was kept."""

    def otherwise(self, run: str, step: StepRecord, frame: FrameRecord) -> str:
        """What this label says otherwise than the journal does of a step and its frame; "" where they agree.

        `run` is the key of the run.
        """
        bare = replace(frame, sha256=None, bytes=None)
        told: dict[str, tuple[object, object]] = {
            name: (getattr(self, name), getattr(step, name)) for name in ("step", "kind", "point")
        } | {name: (getattr(self.frame, name), getattr(bare, name)) for name in _OF_FRAME}
        if self.goal is not None:
            told |= {name: (getattr(self, name), getattr(step, name)) for name in ("goal", "pose", "pose_time_s")}
        if self.record is not None:
            whole = replace(step, frames=(*step.frames[:-1], bare))
            told |= {name: (getattr(self.record, name), getattr(whole, name)) for name in _OF_STEP}
        if self.run != run:
            return "says that it belongs to another run"
        differing = [name for name, (own, other) in told.items() if own != other]
        return f"says otherwise of {', '.join(differing)} than the journal does" if differing else ""

    def text(self, files: Sequence[FrameFile] = ()) -> str:
        """As it stands in the frame's file; `files` says what those of the frames before it in its step are."""
        out = (
            f'{{"format":"{LABEL_FORMAT}","run":{compact(self.run)},"step":{_number(self.step)},"kind":{compact(self.kind)},'
            f'"point":{_number(self.point)},"frame":{_number(self.number)},"of":{_number(self.count)},'
            f"{self.frame.members()}"
        )
        if self.pixels is not None:
            out += f',"pixels":{compact(self.pixels)}'
        if self.goal is not None and self.pose is not None:
            time_s = _number(self.pose_time_s)
            out += f',"goal":{_axes(self.goal)},"pose":{_axes(self.pose)},"pose_time_s":{time_s}'
        return f"{out}}}" if self.record is None else f'{out},"event":{self.record.text(files)}}}'

    def to_json(self) -> JsonObject:
        """`text` as an object."""
        out: JsonObject = json.loads(self.text())
        return out

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
            values.get("pixels"),
        )


_OF_FRAME = tuple(field.name for field in fields(FrameRecord))
_OF_STEP = tuple(field.name for field in fields(StepRecord))

_KEPT = 16
_kept: dict[int, tuple[Pose, str]] = {}
"""By the identity of poses, not by their values: -0.0 equals 0.0 and is written otherwise."""


def _axes(pose: Pose) -> str:
    found = _kept.get(id(pose))
    if found is not None and found[0] is pose:
        return found[1]
    text = "{" + ",".join([f'"{axis}":{_number(at)}' for axis, at in zip(AXES, _of_axes(pose), strict=True)]) + "}"
    if len(_kept) >= _KEPT:
        _kept.clear()
    _kept[id(pose)] = (pose, text)
    return text


def _number(value: float | None) -> str:
    """JSON of a number, or of none; raises `ValueError` for one that is not finite."""
    return repr(value) if value.__class__ is float and isfinite(value) else compact(value)


def _parsed(what: str, parse: Callable[[], Parsed]) -> Parsed:
    try:
        return parse()
    except KeyError as error:
        raise DataError(f"the record of a {what} has no {error.args[0]!r}") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise DataError(f"the record of a {what} cannot be understood: {error}") from None
