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
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from gonio.acquisition.journal import Event
from gonio.acquisition.plan import ANGLES
from gonio.acquisition.run import TABLE, Run
from gonio.disk import is_own, read_file, read_manifest
from gonio.documents import JsonObject
from gonio.rig.dng import read_raw
from gonio_bluesky.event_values import _array, _finite, _flat, _integer, _key_of, _named, _number, _seconds, _text

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Document = tuple[str, JsonObject]
"""Its kind (start, descriptor, event, ...), and what it holds."""

SPEC = "GONIO_FRAMES"
"""What `resource` documents call the folder of frames; `Frames` reads it."""
SPACE = uuid.UUID("5b8f7a8e-4a0c-5c7b-9d5e-0f2a3c1d7e64")
"""Name space of the documents' identifiers, drawn once."""
STREAMS = {"point": "primary", "reference": "reference", "dark": "dark"}
PAGE = 500
"""So many steps are read ahead, to write what is said of their frames as one document."""


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

    def __call__(self, files: Sequence[str], **_: object) -> npt.NDArray[np.uint16]:
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

    counting: set[int] = field(default_factory=set)
    """Numbers of the lines of steps that count: those that were not lost, or taken again."""
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
        self._angles = run.points.angles_deg
        folder = run.path / "frames"
        self._there = frozenset(os.listdir(folder)) if folder.is_dir() else frozenset()
        self._missing: list[str] = []

    def all(self) -> Iterator[Document]:
        """Every document."""
        yield "start", self._start()
        yield from self._baseline()
        yield "resource", self._resource()
        page: list[Event] = []
        for event in self._events:
            if event["event"] != "step" or event["n"] in self._known.counting:
                page.append(event)
            if len(page) == PAGE:
                yield from self._page(page)
                page = []
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
        known, lines = _Known(), dict[int, int]()
        numbers: dict[str, None] = {}
        words: dict[str, None] = {}
        for event in self._events:
            kind = event["event"]
            if not known.first:
                known.first = event
            if kind == "step":
                lines[event["step"]] = event["n"]
                for device, quantity, value, unit in event.get("health", ()):
                    (words if isinstance(value, str) else numbers)[f"{device} {quantity}"] = None
                    known.units[f"{device} {quantity}"] = unit
            elif kind == "lost":
                for number in event["steps"]:
                    lines.pop(int(number), None)
            if kind in ("session", "end", "interrupted", "device_error", "lost"):
                known.ended, known.message = kind, event.get("message", "")
            known.last_time = max(known.last_time, _seconds(event.get("wall", "")))
        known.counting = set(lines.values())
        known.numbers, known.words = list(numbers), list(words)
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
            "motors": list(ANGLES),
            "detectors": ["camera"],
            "num_points": sum(1 for flag in self._run.points.flags if not flag),
            "hints": {"dimensions": [[[name], "primary"] for name in ANGLES]},
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
        if name not in self._streams:
            yield "descriptor", self._descriptor(name, self._step_keys(name), self._step_configuration(), "goniometer")
        frames, levels = event["frames"], event.get("level_per_s") or {}
        data: JsonObject = {"step": event["step"]}
        if name == "primary":
            data["point"] = event["point"]
            data |= dict(zip(ANGLES, map(float, self._angles[event["point"]]), strict=True))
        data |= {
            **{f"{axis}_deg": math.degrees(event["pose"].get(axis, 0.0)) for axis in self._axes},
            "goal_deg": self._pose(event["goal"]),
            "time_s": event["time_s"],
            "flag": event["flag"],
        }
        if name != "dark":
            data["pose_after_deg"] = self._pose(event.get("pose_after"))
            longest = {f["band"]: f["exposure_s"] for f in sorted(frames, key=lambda f: float(f["exposure_s"]))}
            data["exposure_s"] = [longest.get(band) for band in self._bands]
            data["level_per_s"] = [levels.get(band) for band in self._bands]
        read = {f"{device} {quantity}": value for device, quantity, value, _ in event.get("health", ())}
        if self._known.numbers:
            data["health"] = [read.get(name) for name in self._known.numbers]
        if self._known.words:
            data["health_words"] = json.dumps({name: read[name] for name in self._known.words if name in read})
        data["frames"] = f"{self._uid('frames')}/{event['n']}"
        yield self._event(name, event["n"], _seconds(event.get("wall", "")), data)

    def _pose(self, pose: Mapping[str, float] | None) -> list[float | None]:
        return [None if pose is None else math.degrees(pose.get(axis, 0.0)) for axis in self._axes]

    def _step_keys(self, name: str) -> dict[str, JsonObject]:
        axes, bands = len(self._axes), len(self._bands)
        camera = self._run.description.camera
        keys = {"step": _integer("journal")}
        if name == "primary":
            keys |= {"point": _integer("plan")} | {angle: _number("plan", "deg") for angle in ANGLES}
        keys |= {f"{axis}_deg": _number("journal", "deg") for axis in self._axes}
        keys |= {"goal_deg": _array("journal", axes, "deg", "axis")}
        keys |= {"time_s": _number("journal", "s"), "flag": _text("journal")}
        if name != "dark":
            keys["pose_after_deg"] = _array("journal", axes, "deg", "axis")
            keys["exposure_s"] = _array("journal", bands, "s", "band")
            keys["level_per_s"] = _array("journal", bands, "1/s", "band")
        if self._known.numbers:
            keys["health"] = _array("journal", len(self._known.numbers), "", "reading")
        if self._known.words:
            keys["health_words"] = _text("journal")
        keys["frames"] = {
            "source": "camera",
            "dtype": "array",
            "dtype_numpy": "<u2",
            "shape": [None, camera.height, camera.width],
            "dims": ["frame", "row", "column"],
            "units": "DN",
            "external": "FILESTORE:",
        }
        return keys

    def _step_configuration(self) -> JsonObject:
        known = self._known
        out: JsonObject = {"axes": self._axes, "bands": self._bands}
        if known.numbers:
            out |= {"health": known.numbers, "health_units": [known.units[name] for name in known.numbers]}
        return out

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
        units = dict.fromkeys(ANGLES, "deg") | {"wavelength_nm": "nm", "brdf": "1/sr", "u_brdf": "1/sr"}
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
        columns = {name: [_finite(value) for value in frame[name].tolist()] for name in frame.columns}
        for row in range(len(frame)):
            data = {name: values[row] for name, values in columns.items()}
            yield self._event("reduced", row, self._known.last_time, data)
