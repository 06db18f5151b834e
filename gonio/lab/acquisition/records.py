"""What a journal says of a step and of its frames, and what a frame's own file says: values with a JSON form.

Each field of a record declares its key, what may stand there, and how it is written and read. So text and record are
inverse to each other: keys keep their order and numbers their digits, because a journal's lines are checksummed. A pose
is encoded once: the same one stands in the labels of a step's frames and in its line.

A line that is whole may still be forged, or come from another version. Numbers have bounds, so that what is read can be
computed with.
"""

import datetime
import json
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, Literal, NamedTuple, NotRequired, Self

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from gonio.errors import DataError
from gonio.lab.rig.health import Reading
from gonio.lab.rig.kinematics import AXES
from gonio.lab.rig.protocols import Pose
from gonio.typing import JsonObject

Kind = Literal["dark", "reference", "point"]
Extra = Literal["allow", "ignore", "forbid"]

LABEL_FORMAT = "gonio-frame-1"
_of_axes = attrgetter(*AXES)
compact = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode
"""JSON without spaces; raises `ValueError` for numbers that it does not have."""

# ---- what may stand in a line ----

_LARGEST = 2**53
Count = Annotated[int, Field(ge=0, lt=_LARGEST)]
Seconds = Annotated[float, Field(ge=-1e11, le=1e11)]
"""Some three thousand years either way: more is no time that a clock tells."""
Exposure = Annotated[float, Field(gt=0.0, le=1e6)]
"""Exposure of a frame [s]: `gonio.lab.rig.dng.write_dng` takes no longer one."""
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]
"""What an encoder may read [rad]: some turns."""
Degrees = Annotated[float, Field(ge=-720.0, le=720.0)]
ThetaI = Annotated[float, Field(ge=0.0, le=90.0)]
Finite = Annotated[float, Field(ge=-1e15, le=1e15)]
FileName = Annotated[str, Field(pattern=r"^\d{6,}-\w+-\d{2,}\.\w+$", max_length=200)]


def _shape(keys: Mapping[str, Any], extra: Extra = "ignore") -> Any:
    """An object of JSON with these keys."""
    shape = TypedDict("shape", dict(keys))  # type: ignore[misc]  # noqa: UP013
    return with_config(ConfigDict(strict=True, extra=extra, allow_inf_nan=False))(shape)


_POSE = _shape(dict.fromkeys(AXES, NotRequired[Angle]) | {"light": Angle, "camera": Angle}, "forbid")

# ---- how it is written ----

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
    kind = value.__class__
    return repr(value) if kind is int or (kind is float and math.isfinite(value)) else compact(value)  # type: ignore[arg-type]


def _truth(value: bool) -> str:
    return "true" if value else "false"


class _Key(NamedTuple):
    """A field of a record as a key of JSON."""

    name: str
    """"" where the object of the field is not nested: its keys stand among those of the record."""
    prefix: str
    """What is written before the value."""
    write: Callable[[Any], str]
    default: Any
    """The key is left out where the field has this value; `MISSING` where it is always there."""
    shape: Any
    read: Callable[[Any], Any] | None


def _key(
    shape: Any, write: Callable[[Any], str] = compact, read: Callable[[Any], Any] | None = None, name: str | None = None
) -> dict[str, Any]:
    """What a field declares: what may stand there, how it is written and read, and its key, if that is not its name."""
    return {"name": name, "shape": shape, "write": write, "read": read}


class _Keys:
    """The keys of a kind of record, in the order of JSON."""

    def __init__(self, record: Any) -> None:
        self.all: dict[str, _Key] = {}
        """By the names of fields."""
        for each in fields(record):
            name = each.name if each.metadata["name"] is None else each.metadata["name"]
            shape, write, read = (each.metadata[what] for what in ("shape", "write", "read"))
            self.all[each.name] = _Key(name, f'"{name}":' if name else "", write, each.default, shape, read)
        self.values_of = attrgetter(*self.all)
        self.writing = [key[1:4] for key in self.all.values()]

    def shapes(self) -> dict[str, Any]:
        """What may stand at each key of JSON."""
        out: dict[str, Any] = {}
        for key in self.all.values():
            shape: Any = key.shape if key.default is MISSING else NotRequired[key.shape | None]
            out |= {key.name: shape} if key.name else shape
        return out


_found: dict[Any, _Keys] = {}
"""The keys of each kind of record."""


def _keys(record: Any) -> _Keys:
    found = _found.get(record)
    if found is None:
        found = _found[record] = _Keys(record)
    return found


class _Record:
    """A frozen dataclass whose fields declare their keys by `_key`, in the order of JSON."""

    __slots__ = ()
    CALLED = "record"

    def members(self) -> str:
        """The object of JSON, without braces."""
        keys = _keys(self.__class__)
        told = zip(keys.writing, keys.values_of(self), strict=True)
        return ",".join([prefix + write(value) for (prefix, write, default), value in told if value is not default])

    def text(self) -> str:
        """As it stands in a journal or in a frame's file."""
        return f"{{{self.members()}}}"

    def to_json(self) -> JsonObject:
        """`text` as an object."""
        return dict(json.loads(self.text()))

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Raises `DataError` where something is missing."""
        try:
            return cls.of(values)
        except KeyError as error:
            raise DataError(f"the record of a {cls.CALLED} has no {error.args[0]!r}") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise DataError(f"the record of a {cls.CALLED} cannot be understood: {error}") from None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """`from_json`, of values that were looked at."""
        out = {}
        for attribute, (name, _, _, default, _, read) in _keys(cls).all.items():
            required = default is MISSING
            value = values if not name else values[name] if required else values.get(name)
            if required or value is not None:
                out[attribute] = value if read is None else read(value)
        return cls(**out)


def _read_pose(values: Mapping[str, float]) -> Pose:
    return Pose(**values)


def _pose_key() -> dict[str, Any]:
    return _key(_POSE, _axes, _read_pose)


@dataclass(frozen=True, slots=True)
class FrameFile:
    """What the file of a frame is, once it is on the disk."""

    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class FrameRecord(_Record):
    """One frame of a step."""

    CALLED = "frame"

    file: str = field(metadata=_key(FileName))
    """Its name in `frames/`."""
    band: str = field(metadata=_key(str, read=sys.intern))
    """"" for a dark frame."""
    exposure_s: float = field(metadata=_key(Exposure, _number))
    time_s: float = field(metadata=_key(Seconds, _number))
    """Start of the exposure on the rig's clock."""
    lamp: bool = field(metadata=_key(bool, _truth))
    """Whether the lamp was lit."""
    sha256: str | None = field(default=None, metadata=_key(str))
    """None until the file is on the disk."""
    bytes: int | None = field(default=None, metadata=_key(Count, _number))
    """Size of the file; None where it is not known."""
    monitor: float | None = field(default=None, metadata=_key(Finite, _number))
    """Reading of the lamp's monitor during the exposure, in its own unit; None where there is none."""

    def stored(self, file: FrameFile) -> "FrameRecord":
        """This frame, with what its file is."""
        return FrameRecord(
            self.file, self.band, self.exposure_s, self.time_s, self.lamp, file.sha256, file.bytes, self.monitor
        )


def _levels(level_per_s: Mapping[str, float]) -> str:
    return f"{{{','.join(f'{compact(band)}:{_number(level)}' for band, level in level_per_s.items())}}}"


def _readings(health: Sequence[Reading]) -> str:
    return compact([[r.device, r.quantity, r.value, r.unit] for r in health])


def _read_readings(rows: Sequence[tuple[str, str, float | str, str]]) -> tuple[Reading, ...]:
    return tuple(Reading(sys.intern(d), sys.intern(q), value, sys.intern(u)) for d, q, value, u in rows)


def _frames(frames: Sequence[FrameRecord]) -> str:
    return f"[{','.join([frame.text() for frame in frames])}]"


def _read_frames(rows: Sequence[Mapping[str, Any]]) -> tuple[FrameRecord, ...]:
    return tuple(map(FrameRecord.of, rows))


@dataclass(frozen=True, slots=True, kw_only=True)
class StepRecord(_Record):
    """A step that was taken whole: where the axes stood, and its frames."""

    CALLED = "step"

    step: int = field(metadata=_key(Count, _number))
    """Its number in the schedule."""
    kind: Kind = field(metadata=_key(Kind, read=sys.intern))
    point: int | None = field(metadata=_key(Count | None, _number))
    """Row of the plan, for a point."""
    time_s: float = field(metadata=_key(Seconds, _number))
    """Time of its first frame on the rig's clock."""
    goal: Pose = field(metadata=_pose_key())
    pose: Pose = field(metadata=_pose_key())
    """What the encoders read before the frames; for a dark, after them."""
    pose_time_s: float | None = field(default=None, metadata=_key(Seconds, _number))
    """None in runs from before it was kept."""
    pose_after: Pose | None = field(default=None, metadata=_pose_key())
    """What the encoders read after the frames."""
    pose_after_time_s: float | None = field(default=None, metadata=_key(Seconds, _number))
    pose_spread: Pose | None = field(default=None, metadata=_pose_key())
    """Largest less smallest of the readings whose mean `pose` is; None where the rig does not tell."""
    level_per_s: Mapping[str, float] | None = field(default=None, metadata=_key(dict[str, Finite], _levels))
    """By band: the brightest used pixel, as a fraction of full scale, for an exposure of one second."""
    health: tuple[Reading, ...] = field(
        default=(), metadata=_key(list[tuple[str, str, Finite | str, str]], _readings, _read_readings)
    )
    """What was read of the rig's devices after the frames, without limits; empty in runs from before it was kept."""
    overlapped: bool = field(default=False, metadata=_key(bool, _truth))
    """Whether the arms went on to the next step while its last frame was read out."""
    flag: str = field(metadata=_key(str, read=sys.intern))
    """"" or why the step counts for nothing: it has no frames, or none that tell of its pose ("unsteady")."""
    frames: tuple[FrameRecord, ...] = field(
        metadata=_key(list[_shape(_keys(FrameRecord).shapes())], _frames, _read_frames)  # type: ignore[misc]
    )

    def text(self) -> str:
        """As it stands in the journal, without the line's number, time and checksum."""
        return f'{{"event":"step",{self.members()}}}'

    def stored(self, files: Sequence[FrameFile]) -> "StepRecord":
        """This step, with what the files of its first frames are."""
        first = [frame.stored(file) for frame, file in zip(self.frames, files, strict=False)]
        return replace(self, frames=(*first, *self.frames[len(files) :]))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLabel(_Record):
    """What the file of a frame says of itself: which frame it is, of which step of which run."""

    CALLED = "frame"

    run: str = field(metadata=_key(str))
    """`Run.key`."""
    step: int = field(metadata=_key(Count, _number))
    kind: Kind = field(metadata=_key(Kind))
    point: int | None = field(metadata=_key(Count | None, _number))
    number: int = field(metadata=_key(Count, _number, name="frame"))
    """Number of the frame in its step, from 1."""
    count: int = field(metadata=_key(Count, _number, name="of"))
    """How many frames the step has; with planned brackets, up to the last one of the bands that were planned so far."""
    frame: FrameRecord = field(metadata=_key(_keys(FrameRecord).shapes(), FrameRecord.members, FrameRecord.of, name=""))
    pixels: str | None = field(default=None, metadata=_key(str))
    """SHA-256 of the frame's pixels (`gonio.lab.rig.dng.pixels_sha256`), or of all of a camera's own file; None in
    frames from before it was kept."""
    goal: Pose | None = field(default=None, metadata=_pose_key())
    """Where the step was to stand, and what the encoders read before its frames; None for a dark."""
    pose: Pose | None = field(default=None, metadata=_pose_key())
    pose_time_s: float | None = field(default=None, metadata=_key(Seconds, _number))
    record: StepRecord | None = field(
        default=None, metadata=_key(_shape(_keys(StepRecord).shapes()), StepRecord.text, StepRecord.of, name="event")
    )
    """In the last frame of a step: all that the journal says of it, but for what this file is."""

    def otherwise(self, run: str, step: StepRecord, frame: FrameRecord) -> str:
        """What this label says otherwise than the journal does of a step and its frame; "" where they agree.

        `run` is the key of the run.
        """
        if self.run != run:
            return "says that it belongs to another run"
        bare = replace(frame, sha256=None, bytes=None)
        pairs: list[tuple[object, object, tuple[str, ...]]] = [
            (self, step, ("step", "kind", "point")), (self.frame, bare, FrameRecord.__slots__)
        ]  # fmt: skip
        if self.goal is not None:
            pairs.append((self, step, ("goal", "pose", "pose_time_s")))
        if self.record is not None:
            whole = replace(step, frames=(*step.frames[:-1], bare))
            pairs.append((self.record, whole, StepRecord.__slots__))
        differing = dict.fromkeys(
            name for own, other, names in pairs for name in names if getattr(own, name) != getattr(other, name)
        )
        return f"says otherwise of {', '.join(differing)} than the journal does" if differing else ""

    def text(self) -> str:
        """As it stands in the frame's file."""
        return f'{{"format":"{LABEL_FORMAT}",{self.members()}}}'

    @classmethod
    def parsed(cls, text: str) -> Self:
        """The label that stands in a frame's file; raises `DataError` as `event_of` does."""
        label = _read(_adapter("label"), text, "the label of a frame")
        if label.get("event") is not None:
            _checked_step(label["event"])
        return cls.from_json(json.loads(text))  # with the digits of its numbers, as they stand there


# ---- lines ----

_SAID: JsonObject = {"step": Count, "message": str, "time_s": Seconds}
_OTHERS: Mapping[str, Mapping[str, Any]] = {
    "session": {"gonio": str, "steps": Count, "left": Count},
    "remark": {"message": str},
    "suspended": {"rule": str, **_SAID},
    "paused": {"why": str, **_SAID},
    "retry": {"device": str, "attempt": Count, **_SAID},
    "continued": {"step": Count, "waited_s": Seconds, "time_s": Seconds},
    "enough": {"met": bool, "message": str, "why": JsonObject},
    "interrupted": {"message": str},
    "device_error": {"message": str},
    "repaired": {"kept": Count, "rebuilt": list[Count]},
    "end": {"steps": Count},
}
"""Of these every key may be missing: nothing is computed from them."""
_KINDS: Mapping[str, Mapping[str, Any]] = {
    "step": _keys(StepRecord).shapes(),
    "chosen": {
        "first_step": Count,
        "points": list[tuple[ThetaI, Degrees, Degrees, Degrees]],
        "why": NotRequired[JsonObject],
    },
    "lost": {"steps": list[Count], "frames": NotRequired[list[str]]},
} | {kind: {key: NotRequired[what] for key, what in keys.items()} for kind, keys in _OTHERS.items()}
_BEGINNING = re.compile(rb'\{"n":\d+,"event":"(\w+)"')


def _time_of_day(value: str) -> str:
    if datetime.datetime.fromisoformat(value).year < 1970:
        raise ValueError("no time after 1970")
    return value


_EVERY = {
    "n": Count,
    "event": str,
    "wall": NotRequired[Annotated[str, AfterValidator(_time_of_day)]],
    "run": NotRequired[str],
    "files": NotRequired[dict[str, str]],
}
"""What any line may hold; `run` and `files` are `Run.identity`."""


@cache
def _adapter(kind: str) -> TypeAdapter[JsonObject]:
    """What checks a line of the journal of this kind; "" checks what all lines have, "label" the labels of frames."""
    if kind == "label":
        return TypeAdapter(_shape(_keys(FrameLabel).shapes() | {"format": Literal["gonio-frame-1"]}))
    own = {"event": Literal[kind], **_KINDS[kind]} if kind else {}
    return TypeAdapter(_shape(_EVERY | own, "allow"))


def event_of(line: bytes) -> JsonObject:
    """The event of a line whose checksum is right.

    Raises
    ------
    DataError
        Something is missing, is of another type, or is no number that one can compute with; the message names it.
    """
    found = _BEGINNING.match(line)
    kind = found[1].decode() if found is not None else ""
    event = _read(_adapter(kind if kind in _KINDS else ""), line, f"the record of a {kind}" if kind else "it")
    if found is None and event["event"] in _KINDS:
        event = _read(_adapter(event["event"]), line, f"the record of a {event['event']}")
    if event["event"] == "step":
        return _checked_step(event)
    if (wrong := _uncountable(event)) is not None:
        raise DataError(f"the record of a {event['event']} cannot be understood: it holds {str(wrong)[:40]}")
    return event


def _read(adapter: TypeAdapter[JsonObject], text: str | bytes, what: str) -> JsonObject:
    try:
        return adapter.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(map(str, first["loc"]))
        if first["type"] == "missing":
            raise DataError(f'{what} has no "{place}"') from None
        value = repr(first["input"])
        shown = f" = {value if len(value) <= 40 else value[:36] + ' ...'}" if place else ""
        raise DataError(f"{what} cannot be understood: {place}{shown}: {first['msg']}") from None


def _checked_step(step: JsonObject) -> JsonObject:
    if (step["kind"] == "point") != (step["point"] is not None):
        raise DataError(f'the record of a step cannot be understood: kind = "{step["kind"]}", point = {step["point"]}')
    for frame in step["frames"]:
        if not frame["file"].startswith(f"{step['step']:06d}-"):
            raise DataError(f'the record of step {step["step"]} names "{frame["file"]}", which is of another step')
    return step


def _uncountable(value: Any) -> Any:
    """A number that is not finite, or that no float holds; None where there is none."""
    if isinstance(value, float):
        return None if math.isfinite(value) else value
    if isinstance(value, int):
        return value if abs(value) >= _LARGEST else None
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return next((wrong for part in parts if (wrong := _uncountable(part)) is not None), None)
