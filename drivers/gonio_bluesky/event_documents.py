"""A run as documents of Bluesky's event model, as `gonio convert RUN OUT --to bluesky` writes them: one JSON line each.

    start                 metadata: plan, rig, sample, seed, versions, laboratory
    baseline              the rig's configuration, one event
    resource, datum_page  the folder of raw frames, and which of them a step has
    primary               an event for every point that was measured
    reference, dark       the visits to the white reference, and the dark steps
    journal               what else happened: sessions, remarks, interruptions, choices
    reduced               the rows of the table, where the run has been reduced
    stop                  how it ended

Everything follows from the files of the run: the same run gives the same documents, and a run that has grown gives
those that it gave, and more. Nothing of Bluesky is needed to write them. Where `event_model` is installed, every
document is checked against its models. docs/interchange.md says what each key holds.

The baseline has every key of the rig as run.toml has it, as `geometry_light_distance_mm`; lists of tables are JSON.
`stop` says `success`; `abort` where the run was stopped or the journal says no end; `fail` where a device failed. An
event of `primary` has

- `step`, `point`, `theta_i_deg` ... `phi_r_deg` of the plan,
- `light_deg`, `camera_deg`, `tilt_deg`, ...: what the encoders read before the frames,
- `goal_deg`, `pose_after_deg`: where the axes were sent, and what they read after the frames,
- `time_s`, `flag`: time of the first frame on the rig's clock, and why the step counts for nothing,
- `exposure_s`, `level_per_s` of each band: the longest exposure, and the brightest used pixel for one second,
- `health`, `health_words`: what was read of the devices: numbers; words as JSON.

A number that is not known is `null`. Steps that were lost are left out. The time of an event is when its line was
written to the journal (UTC).
"""

import datetime
import hashlib
import json
import math
import os
import re
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

import numpy as np

from gonio.disk import is_own, read_file, read_manifest
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.journal import Event
from gonio.lab.acquisition.run import TABLE, Run
from gonio.lab.rig.dng import read_raw
from gonio.typing import JsonObject, NDArray

Document = tuple[str, JsonObject]
"""Its kind (start, descriptor, event, ...), and what it holds."""

Column = tuple[JsonObject, Callable[[Event], Any]]
"""A data key, and how its value is found in a line of the journal."""

SPEC = "GONIO_FRAMES"
"""What `resource` documents call the folder of frames; `Frames` reads it."""
SPACE = uuid.UUID("5b8f7a8e-4a0c-5c7b-9d5e-0f2a3c1d7e64")
"""Name space of the documents' identifiers, drawn once."""
STREAMS = {"point": "primary", "reference": "reference", "dark": "dark"}
PAGE = 500
"""Steps that are read ahead, to write what is said of their frames as one document."""


class Frames:
    """The frames of a run, for readers of Bluesky documents: `handler_registry={"GONIO_FRAMES": Frames}`.

    Parameters
    ----------
    folder
        Where the raw files lie.
    """

    specs = frozenset({SPEC})

    def __init__(self, folder: str | Path, **_: object) -> None:
        self._folder = Path(folder)

    def __call__(self, files: Sequence[str], **_: object) -> NDArray[np.uint16]:
        """The raw frames of a step [DN], shape (frames, height, width); none have the shape (0, 0, 0)."""

        frames = [read_raw(self._folder / name).mosaic for name in files]
        return np.stack(frames) if frames else np.empty((0, 0, 0), np.uint16)


def documents(run: Run, remarks: list[str] | None = None) -> Iterator[Document]:
    """The documents of a run, in their order.

    Parameters
    ----------
    run
        Opened for reading; it may be unfinished, and another process may be measuring into it.
    remarks
        Takes sentences for a person: frames that are missing, a table that was left out.

    Raises
    ------
    DataError
        Journal, points or table are damaged.
    """
    remarks = [] if remarks is None else remarks
    yield from _Documents(run, remarks).all()


@dataclass
class _Stream:
    """A descriptor, and how many events it has."""

    uid: str
    keys: list[str]
    count: int = 0


@dataclass
class _Known:
    """What a first look at the journal tells."""

    counting: dict[int, int] = field(default_factory=dict)
    """By step that counts (not those that were lost, or taken again), the number of its line."""
    numbers: list[str] = field(default_factory=list)
    """What is read of the rig's health in numbers, as `device quantity`."""
    words: list[str] = field(default_factory=list)
    """The same, in words."""
    units: dict[str, str] = field(default_factory=dict)
    ended: str = "session"
    """The last event that says whether the run goes on."""
    message: str = ""
    first: Event = field(default_factory=dict)
    last_time: float = 0.0


class _Documents:
    """The documents of one run."""

    def __init__(self, run: Run, remarks: list[str]) -> None:
        self._run, self._remarks, self._settings = run, remarks, run.settings
        self._axes = list(run.description.axes())
        self._bands = [band.name for band in run.bands]
        self._events = run.events()
        self._known = self._look()
        first = self._known.first
        self._start_s = _seconds(self._settings.run.created)
        identity = json.dumps([run.key, self._settings.run.created, first.get("wall"), first.get("crc")])
        self._run_uid = uuid.uuid5(SPACE, identity)
        self._streams: dict[str, _Stream] = {}
        self._columns: dict[str, dict[str, Column]] = {}
        self._angles = run.points.angles_deg
        folder = run.path / "frames"
        self._there = frozenset(os.listdir(folder)) if folder.is_dir() else frozenset()
        self._missing: list[str] = []

    def all(self) -> Iterator[Document]:
        """Every document."""
        yield "start", self._start()
        yield from self._baseline()
        yield "resource", self._resource()
        counting = set(self._known.counting.values())
        told = (event for event in self._events if event["event"] != "step" or event["n"] in counting)
        while page := list(islice(told, PAGE)):
            yield from self._page(page)
        yield from self._reduced()
        if self._missing:
            more = f" and {len(self._missing) - 1} more" if len(self._missing) > 1 else ""
            self._remarks.append(
                f"{self._missing[0]}{more}: named by the journal and not there; `gonio run check {self._run.path}` "
                "says what is wrong"
            )
        yield "stop", self._stop()

    def _look(self) -> _Known:
        known = _Known(first=next(iter(self._events), {}))
        for event in self._events:
            kind = event["event"]
            if kind == "step":
                known.counting[event["step"]] = event["n"]
                known.units |= {f"{device} {quantity}": unit for device, quantity, _, unit in event.get("health", ())}
                for name, value in _health(event).items():
                    listed = known.words if isinstance(value, str) else known.numbers
                    if name not in listed:
                        listed.append(name)
            for number in event["steps"] if kind == "lost" else ():
                known.counting.pop(int(number), None)
            if kind in ("session", "end", "interrupted", "device_error", "lost"):
                known.ended, known.message = kind, event.get("message", "")
            known.last_time = max(known.last_time, _seconds(event.get("wall", "")))
        return known

    def _uid(self, *parts: object) -> str:
        return str(uuid.uuid5(self._run_uid, "/".join(map(str, parts))))

    # ---- start and stop ----

    def _start(self) -> JsonObject:
        settings, header = self._settings, self._settings.run
        sample = settings.sample
        out: JsonObject = {
            "uid": str(self._run_uid),
            "time": self._start_s,
            "plan_name": header.plan,
            "plan_type": "gonio",
            "plan_sha256": header.plan_sha256,
            "wavelength_nm": list(header.wavelength_nm),
            "bands": list(header.bands),
            "motors": list(ANGLES_DEG),
            "detectors": ["camera"],
            "num_points": sum(1 for flag in self._run.points.flags if not flag),
            "hints": {"dimensions": [[[name], "primary"] for name in ANGLES_DEG]},
            "rig": {"name": settings.rig.name, "driver": header.rig},
            "simulated": sample is not None,
            "seed": header.seed,
            "command": header.command,
            "versions": dict(settings.versions),
            "run_folder": str(self._run.path.absolute()),
        }
        if sample is not None:
            out["sample"] = sample.model_dump(mode="json", exclude_none=True)
        if settings.laboratory is not None:
            out["laboratory"] = settings.laboratory.stated()
        return cast("JsonObject", _named(out))

    def _stop(self) -> JsonObject:
        known = self._known
        told = {
            "end": ("success", ""),
            "interrupted": ("abort", known.message),
            "device_error": ("fail", known.message),
            "lost": ("abort", "frames of some steps were lost, and their steps are not taken again yet"),
        }
        unfinished = "the journal says no end: the run goes on, or its process was killed"
        status, reason = told.get(known.ended, ("abort", unfinished))
        return {
            "uid": self._uid("stop"),
            "run_start": str(self._run_uid),
            "time": known.last_time,
            "exit_status": status,
            "reason": reason,
            "num_events": {name: stream.count for name, stream in self._streams.items()},
        }

    # ---- streams ----

    def _descriptor(
        self, name: str, keys: dict[str, JsonObject], configuration: Mapping[str, Any], device: str
    ) -> JsonObject:
        """The descriptor of a stream; another set of keys gives another one, as the event model has it."""
        config_keys = {key: _key_of(value, "run.toml") for key, value in configuration.items()}
        hinted = [key for key in ("level_per_s", "brdf", "event") if key in keys][:1]
        document: JsonObject = {
            "run_start": str(self._run_uid),
            "time": self._start_s,
            "name": name,
            "data_keys": {key: value | {"object_name": device} for key, value in keys.items()},
            "object_keys": {device: list(keys)},
            "configuration": {
                device: {
                    "data": dict(configuration),
                    "timestamps": dict.fromkeys(configuration, self._start_s),
                    "data_keys": config_keys,
                }
            },
            "hints": {device: {"fields": hinted}},
        }
        uid = self._uid("descriptor", name, json.dumps(document, sort_keys=True))
        self._streams[name] = _Stream(uid, list(keys))
        return {"uid": uid} | document

    def _event(self, name: str, number: object, time: float, data: JsonObject) -> Document:
        stream = self._streams[name]
        stream.count += 1
        return "event", {
            "uid": self._uid("event", name, number),
            "descriptor": stream.uid,
            "time": time,
            "seq_num": stream.count,
            "data": data,
            "timestamps": dict.fromkeys(data, time),
            "filled": {"frames": False} if "frames" in data else {},
        }

    def _baseline(self) -> Iterator[Document]:
        """The rig as run.toml has it: a number, a list of numbers or a word for each key; other lists as JSON."""
        values = dict(_flat(self._settings.rig.model_dump(mode="json", exclude_none=True)))
        keys = {name: _key_of(value, "run.toml") for name, value in values.items()}
        yield "descriptor", self._descriptor("baseline", keys, {}, "rig")
        yield self._event("baseline", 0, self._start_s, values)

    def _resource(self) -> JsonObject:
        return {
            "uid": self._uid("frames"),
            "run_start": str(self._run_uid),
            "spec": SPEC,
            "root": str(self._run.path.absolute()),
            "resource_path": "frames",
            "resource_kwargs": {},
            "path_semantics": "posix",
        }

    def _page(self, events: list[Event]) -> Iterator[Document]:
        """The frames of some steps, then their events."""
        steps = [event for event in events if event["event"] == "step"]
        if steps:
            yield "datum_page", self._datum_page(steps)
        for event in events:
            yield from self._step(event) if event["event"] == "step" else self._happened(event)

    def _datum_page(self, steps: list[Event]) -> JsonObject:
        resource = self._uid("frames")
        listed = [event["frames"] for event in steps]
        self._missing += [f["file"] for frames in listed for f in frames if f["file"] not in self._there]
        names = ("file", "band", "exposure_s", "time_s", "lamp", "monitor", "sha256")
        return {
            "resource": resource,
            "datum_id": [f"{resource}/{event['n']}" for event in steps],
            "datum_kwargs": {
                f"{name}s" if name == "file" else name: [[frame.get(name) for frame in frames] for frames in listed]
                for name in names
            }
            # a folder is one asset: without this Tiled would list it once for every event
            | {"indices": [{"start": 0, "stop": 0}] * len(steps)},
        }

    def _step(self, event: Event) -> Iterator[Document]:
        name = STREAMS[event["kind"]]
        if name not in self._columns:
            self._columns[name] = columns = self._columns_of(name)
            known, configuration = self._known, {"axes": self._axes, "bands": self._bands}
            if known.numbers:
                configuration |= {"health": known.numbers, "health_units": [known.units[n] for n in known.numbers]}
            keys = {key: column[0] for key, column in columns.items()}
            yield "descriptor", self._descriptor(name, keys, configuration, "goniometer")
        data = {key: value(event) for key, (_, value) in self._columns[name].items()}
        yield self._event(name, event["n"], _seconds(event.get("wall", "")), data)

    def _columns_of(self, name: str) -> dict[str, Column]:
        """What an event of a step holds: each data key, and how its value is found in a line of the journal."""
        known, camera = self._known, self._run.description.camera
        out: dict[str, Column] = {"step": (_integer("journal"), itemgetter("step"))}
        if name == "primary":
            out["point"] = _integer("plan"), itemgetter("point")
            for k, angle in enumerate(ANGLES_DEG):
                out[angle] = _number("plan", "deg"), partial(self._angle_deg, k)
        for axis in self._axes:
            out[f"{axis}_deg"] = _number("journal", "deg"), partial(_axis_deg, axis)
        pose, bands = _array("journal", len(self._axes), "deg", "axis"), len(self._bands)
        out["goal_deg"] = pose, lambda e: self._pose(e["goal"])
        out["time_s"] = _number("journal", "s"), itemgetter("time_s")
        out["flag"] = _text("journal"), itemgetter("flag")
        if name != "dark":
            out["pose_after_deg"] = pose, lambda e: self._pose(e.get("pose_after"))
            out["exposure_s"] = _array("journal", bands, "s", "band"), self._longest
            levels = _array("journal", bands, "1/s", "band")
            out["level_per_s"] = levels, lambda e: [(e.get("level_per_s") or {}).get(band) for band in self._bands]
        if known.numbers:
            health = _array("journal", len(known.numbers), "", "reading")
            out["health"] = health, lambda e: [_health(e).get(name) for name in known.numbers]
        if known.words:
            out["health_words"] = _text("journal"), self._words
        frames: JsonObject = {
            "source": "camera", "dtype": "array", "dtype_numpy": "<u2", "shape": [None, camera.height, camera.width],
            "dims": ["frame", "row", "column"], "units": "DN", "external": "FILESTORE:",
        }  # fmt: skip
        out["frames"] = frames, lambda e: f"{self._uid('frames')}/{e['n']}"
        return out

    def _words(self, event: Event) -> str:
        read = _health(event)
        return json.dumps({name: read[name] for name in self._known.words if name in read})

    def _angle_deg(self, k: int, event: Event) -> float:
        return float(self._angles[event["point"]][k])

    def _longest(self, event: Event) -> list[float | None]:
        """The longest exposure in each band."""
        longest = {f["band"]: f["exposure_s"] for f in sorted(event["frames"], key=lambda f: float(f["exposure_s"]))}
        return [longest.get(band) for band in self._bands]

    def _pose(self, pose: Mapping[str, float] | None) -> list[float | None]:
        return [None if pose is None else math.degrees(pose.get(axis, 0.0)) for axis in self._axes]

    def _happened(self, event: Event) -> Iterator[Document]:
        if "journal" not in self._streams:
            keys = {"event": _text("journal"), "message": _text("journal"), "content": _text("journal")}
            yield "descriptor", self._descriptor("journal", keys, {}, "journal")
        content = {key: value for key, value in event.items() if key not in ("n", "wall", "crc", "event")}
        data = {"event": event["event"], "message": str(event.get("message", "")), "content": json.dumps(content)}
        yield self._event("journal", event["n"], _seconds(event.get("wall", "")), data)

    def _reduced(self) -> Iterator[Document]:
        """The rows of the table."""
        path = self._run.path / TABLE[0]
        if not os.path.lexists(path):
            return
        from gonio import measurement

        if not is_own(path, read_manifest(self._run.path).get(path.name, ())):
            self._remarks.append(f"{path}: was changed after it was written, and is left out (no stream `reduced`)")
            return
        frame = measurement.read(path)
        units = dict.fromkeys(ANGLES_DEG, "deg") | {"wavelength_nm": "nm", "brdf": "1/sr", "u_brdf": "1/sr"}
        units |= {name: "1/sr" for name in frame.columns if name in ("u_random", "u_angles") or name.startswith("s_")}
        keys = {
            name: _number("table", units.get(name, "")) if frame[name].dtype.kind in "fiu" else _text("table")
            for name in frame.columns
        }
        provenance = frame.attrs.get("provenance") or {}
        configuration = {
            "sha256": hashlib.sha256(read_file(path)).hexdigest(),
            "reduced_by": str(provenance.get("reduced_by", "")),
            "quantity": str(frame.attrs.get("quantity", "brdf")),
        }
        yield "descriptor", self._descriptor("reduced", keys, configuration, "reduction")
        columns = {name: list(map(_finite, frame[name].tolist())) for name in frame.columns}
        for row in range(len(frame)):
            data = {name: values[row] for name, values in columns.items()}
            yield self._event("reduced", row, self._known.last_time, data)


def _axis_deg(axis: str, event: Event) -> float:
    return math.degrees(event["pose"].get(axis, 0.0))


def _health(event: Event) -> dict[str, float | str]:
    """What a step's line holds of the rig's health, as `device quantity`."""
    return {f"{device} {quantity}": value for device, quantity, value, _ in event.get("health", ())}


def _seconds(wall: str) -> float:
    """Seconds since 1970 of a time of day (UTC) as run.toml and journal hold it; 0 where they do not."""
    return datetime.datetime.fromisoformat(wall).timestamp() if wall else 0.0


def _finite(value: Any) -> Any:
    """A value as JSON has it: null for a number that is not known."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(source: str, units: str = "") -> JsonObject:
    return {"source": source, "dtype": "number", "dtype_numpy": "<f8", "shape": [], "units": units}


def _integer(source: str) -> JsonObject:
    return {"source": source, "dtype": "integer", "dtype_numpy": "<i8", "shape": []}


def _text(source: str) -> JsonObject:
    return {"source": source, "dtype": "string", "shape": []}


def _array(source: str, length: int, units: str, dim: str) -> JsonObject:
    out = {"source": source, "dtype": "array", "dtype_numpy": "<f8", "shape": [length], "dims": [dim]}
    return out | ({"units": units} if units else {})


def _key_of(value: Any, source: str) -> JsonObject:
    """The data key of a value of the configuration."""
    if isinstance(value, bool):
        return {"source": source, "dtype": "boolean", "shape": []}
    if isinstance(value, int):
        return _integer(source)
    if isinstance(value, float):
        return _number(source)
    if isinstance(value, list):
        text = any(isinstance(one, str) for one in value)
        return _array(source, len(value), "", "entry") | ({"dtype_numpy": "<U64"} if text else {})
    return _text(source)


_NOT_IN_NAMES = re.compile(r"[^\w-]+")


def _named(value: Any) -> Any:
    """Nested tables with names that the event model takes: no dots and no slashes."""
    if isinstance(value, dict):
        return {_NOT_IN_NAMES.sub("_", str(key)): _named(inner) for key, inner in value.items()}
    return [_named(inner) for inner in value] if isinstance(value, list) else value


def _flat(tables: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, Any]]:
    """Nested tables as one, by names such as `geometry_light_distance_mm`."""
    for key, value in tables.items():
        name = _NOT_IN_NAMES.sub("_", f"{where}_{key}" if where else key)
        if isinstance(value, dict):
            yield from _flat(value, name)
        else:
            numbers = isinstance(value, list) and all(type(one) in (int, float) for one in value)
            words = isinstance(value, list) and not numbers
            yield name, json.dumps(value, ensure_ascii=False) if words else value
