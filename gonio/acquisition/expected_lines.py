"""What the lines of a journal and the labels of frames have to hold: a line that is whole may still be forged, or come
from another version. Numbers have bounds, so that what is read can be computed with.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict

from gonio.acquisition.records import AXES, Kind
from gonio.documents import JsonObject
from gonio.errors import DataError

_LARGEST = 2**53
Count = Annotated[int, Field(ge=0, lt=_LARGEST)]
Seconds = Annotated[float, Field(ge=-1e11, le=1e11)]
"""Some three thousand years either way: more is no time that a clock tells."""
Exposure = Annotated[float, Field(gt=0.0, le=1e6)]
"""Of a frame [s]: `gonio.rig.dng.write_dng` takes no longer one."""
Angle = Annotated[float, Field(ge=-100.0, le=100.0)]
"""What an encoder may read [rad]: some turns."""
Degrees = Annotated[float, Field(ge=-720.0, le=720.0)]
ThetaI = Annotated[float, Field(ge=0.0, le=90.0)]
Finite = Annotated[float, Field(ge=-1e15, le=1e15)]


def _time_of_day(value: str) -> str:
    if datetime.datetime.fromisoformat(value).year < 1970:
        raise ValueError("no time after 1970")
    return value


def _shape(fields: Mapping[str, Any], extra: Literal["allow", "ignore", "forbid"] = "ignore") -> Any:
    """An object of JSON with these keys."""
    shape = TypedDict("shape", dict(fields))  # type: ignore[misc]  # noqa: UP013
    return with_config(ConfigDict(strict=True, extra=extra, allow_inf_nan=False))(shape)


_POSE = _shape(dict.fromkeys(AXES, NotRequired[Angle]) | {"light": Angle, "camera": Angle}, "forbid")
_FRAME = {
    "file": Annotated[str, Field(pattern=r"^\d{6,}-\w+-\d{2,}\.\w+$", max_length=200)],
    "band": str,
    "exposure_s": Exposure,
    "time_s": Seconds,
    "lamp": bool,
    "sha256": NotRequired[str | None],
    "bytes": NotRequired[Count | None],
    "monitor": NotRequired[Finite | None],
}
_OF_STEP = {"step": Count, "kind": Kind, "point": Count | None}
_STEP = _OF_STEP | {
    "time_s": Seconds,
    "goal": _POSE,
    "pose": _POSE,
    "pose_time_s": NotRequired[Seconds | None],
    "pose_after": NotRequired[_POSE | None],
    "pose_after_time_s": NotRequired[Seconds | None],
    "pose_spread": NotRequired[_POSE | None],
    "level_per_s": NotRequired[dict[str, Finite] | None],
    "health": NotRequired[list[tuple[str, str, Finite | str, str]]],
    "flag": str,
    "frames": list[_shape(_FRAME)],  # type: ignore[misc]
}
_LABEL = (
    _FRAME
    | _OF_STEP
    | {
        "format": Literal["gonio-frame-1"],
        "run": str,
        "frame": Count,
        "of": Count,
        "goal": NotRequired[_POSE | None],
        "pose": NotRequired[_POSE | None],
        "pose_time_s": NotRequired[Seconds | None],
        "pixels": NotRequired[str | None],
        "event": NotRequired[_shape(_STEP) | None],
    }
)
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
    "step": _STEP,
    "chosen": {
        "first_step": Count,
        "points": list[tuple[ThetaI, Degrees, Degrees, Degrees]],
        "why": NotRequired[JsonObject],
    },
    "lost": {"steps": list[Count], "frames": NotRequired[list[str]]},
} | {kind: {key: NotRequired[what] for key, what in keys.items()} for kind, keys in _OTHERS.items()}
_BEGINNING = re.compile(rb'\{"n":\d+,"event":"(\w+)"')
_EVERY = {"n": Count, "event": str, "wall": NotRequired[Annotated[str, AfterValidator(_time_of_day)]]}


@cache
def _adapter(kind: str) -> TypeAdapter[Any]:
    """What reads a line of a kind; of one that nobody knows here ("") what every line has; "label" reads labels."""
    if kind == "label":
        return TypeAdapter(_shape(_LABEL))
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
    event: JsonObject = _read(
        _adapter(kind if kind in _KINDS else ""), line, f"the record of a {kind}" if kind else "it"
    )
    if found is None and event["event"] in _KINDS:
        event = _read(_adapter(event["event"]), line, f"the record of a {event['event']}")
    if event["event"] == "step":
        return _checked_step(event)
    if (wrong := _uncountable(event)) is not None:
        raise DataError(f"the record of a {event['event']} cannot be understood: it holds {str(wrong)[:40]}")
    return event


def label_json(text: str | bytes) -> JsonObject:
    """The label of a frame; raises `DataError` as `event_of` does."""
    label: JsonObject = _read(_adapter("label"), text, "the label of a frame")
    if label.get("event") is not None:
        _checked_step(label["event"])
    return label


def _read(adapter: TypeAdapter[Any], text: str | bytes, what: str) -> Any:
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
    start = f"{step['step']:06d}-"
    for frame in step["frames"]:
        if not frame["file"].startswith(start):
            raise DataError(f'the record of step {step["step"]} names "{frame["file"]}", which is of another step')
    return step


def _uncountable(value: Any) -> Any:
    """A number that is none, or that no float holds; None where there is none."""
    if isinstance(value, float):
        return None if math.isfinite(value) else value
    if isinstance(value, int):
        return value if abs(value) >= _LARGEST else None
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return next((wrong for part in parts if (wrong := _uncountable(part)) is not None), None)
