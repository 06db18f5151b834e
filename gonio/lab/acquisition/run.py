"""The folder of a run: what was asked, what has happened, and the frames.

    RUN/  run.toml       resolved rig, sample, bands, seed, versions, command line, hash of the plan
          plan.csv       the points in order, with the flag and the reason of those that this rig cannot measure
          chosen.json    of a run that grows: what was chosen, as the journal has it
          journal.jsonl  what has happened (gonio.lab.acquisition.journal)
          frames/        raw frames
          gonio.sha256   what the program wrote beside journal and frames (gonio.disk)

A run whose journal holds no complete line, and that has no frames, counts as not started. Frames without a readable
journal are not touched: `gonio.lab.acquisition.repair` makes the journal again.
"""

import contextlib
import csv
import hashlib
import json
import os
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np

from gonio.config import parse, to_toml
from gonio.disk import (
    MANIFEST,
    Manifest,
    check_writable,
    half_written,
    is_manifest,
    is_own,
    only_file,
    read_file,
    read_manifest,
    require_name,
    require_own,
    sha256_of,
    work_folder,
    write_own,
)
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.formats import native
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.frame_writer import NAME, label_of
from gonio.lab.acquisition.journal import Event, Events, Index, Journal, Steps, first_event, read_events
from gonio.lab.acquisition.plan import PLAN_COLUMNS, Point, plan_csv, points_sha256
from gonio.lab.acquisition.run_folder import OURS, changed, check_new, make_folder, remove_begun
from gonio.lab.acquisition.run_settings import RunRequest, RunSettings, named_files, resolved, settings_for
from gonio.lab.acquisition.schedule import Batch
from gonio.lab.rig import Step
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.laboratory import Laboratory
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polarisers import in_states
from gonio.platform import sync_folder
from gonio.samples.description import SampleDescription
from gonio.typing import DataFrame, Floats, JsonObject

ROWS = 4096
"""Rows of a plan.csv that are read at once."""
_LIT = re.compile(rb'\{"n":\d+,"event":"(session|continued)"')
_STEP_LINE = re.compile(rb'\{"n":\d+,"event":"step"')
CHOSEN = "chosen.json"
"""A copy of the journal's events "chosen", for `gonio run repair`."""
TABLE = ("brdf.csv", "brdf.meta.json")
AS_BEGUN = {"run.toml", "reference.csv", "reference.meta.json", "certificate.xml", "camera_maps.npz"}
"""What says how the frames of a run were taken, beside its plan."""
BESIDE_TABLE = ("budget.csv", "monte_carlo.csv", "monte_carlo.npz")
"""What a reduction writes beside its table."""
RESTORE = "restore it, or move it away: `gonio measure ... --resume` writes it again"


@dataclass(frozen=True, slots=True)
class Points:
    """A plan.csv."""

    angles_deg: Floats
    """theta_i, phi_i, theta_r, phi_r of each point, shape (points, 4)."""
    flags: list[str]
    """"" for a point that is measured, or why not."""
    reasons: list[str]


@dataclass
class Run:
    """An opened run; methods that write need `journal`, which `create` and `gonio.lab.acquisition.resuming` open."""

    path: Path
    settings: RunSettings
    journal: Journal | None = None
    _index: Index = field(default_factory=Index)
    _grown: tuple[int, Points] | None = None
    """How many batches were chosen, and all points with them."""
    _closed: Events | None = None
    """The events of a run that was written by this object, and is closed."""

    @classmethod
    def create(cls, path: str | Path, request: RunRequest) -> "Run":
        """Start a run in an empty or absent folder; where that fails nothing is left behind.

        Raises
        ------
        ConfigError
            The folder holds a run that has begun, or other things, or cannot be written.
        """
        path = Path(path)
        check_new(path)
        made = make_folder(path)
        journal = None
        try:
            journal = Journal(path / "journal.jsonl")
            check_new(path)  # once more: nobody else writes a run here now
            for left in [entry for entry in path.iterdir() if half_written(entry.name, OURS)]:
                left.unlink()
            (path / "frames").mkdir(exist_ok=True)
            files, description = named_files(request.description)
            settings = settings_for(request, description)
            plan = plan_csv(request.points).encode()
            tables = settings.model_dump(mode="json", exclude_none=True)
            if settings.laboratory is not None:
                tables["laboratory"] = settings.laboratory.stated()
            write_own(path, files | {"plan.csv": plan, "run.toml": to_toml(tables).encode()})
            sync_folder(path)
        except BaseException as error:
            if journal is not None:
                if not len(journal.events):  # nothing has happened in it
                    remove_begun(path)
                journal.close()
            for folder in reversed(made):
                with contextlib.suppress(OSError):
                    folder.rmdir()
            if isinstance(error, OSError):
                raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
            raise
        return cls(path, resolved(settings, path), journal)

    @classmethod
    def open(cls, path: str | Path) -> "Run":
        """A run to read from.

        Raises
        ------
        ConfigError
            There is no such folder, or it holds no run.
        DataError
            Its run.toml is damaged, or a file that belongs to it was changed.
        """
        path = Path(path)
        require_name(path)
        if not path.is_dir():
            raise ConfigError(f"{path}: there is no such folder; a run is a folder that `gonio measure` has written")
        if os.path.lexists(path / MANIFEST) and not is_manifest(path / MANIFEST):
            raise DataError(
                f"{path / MANIFEST}: is no list of files of this folder with their checksums; restore it, or move it "
                "away"
            )
        try:
            values = tomllib.loads(read_file(path / "run.toml").decode())
        except FileNotFoundError:
            raise ConfigError(
                f"{path}: holds no run.toml; a run is a folder that `gonio measure` has written"
            ) from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise DataError(f"{path / 'run.toml'}: is damaged: {error}") from None
        try:
            settings = parse(RunSettings, values, path / "run.toml")
        except ConfigError as error:
            raise DataError(str(error)) from None
        if other := changed(path, AS_BEGUN):
            raise DataError(
                f"{path / other}: was changed after it was written (its checksum differs), and the frames were not "
                "taken with what it says now; restore it. What is to be another rig, measure into another folder"
            )
        if first_event(path / "journal.jsonl").get("run", settings.run.id) != settings.run.id:
            raise DataError(
                f"{path / 'journal.jsonl'}: is the journal of another run than run.toml ([run] id); restore it, or "
                f"move it away: `gonio run repair {path}` makes it again from what the frames carry"
            )
        return cls(path, resolved(settings, path))

    @property
    def description(self) -> RigDescription:
        """The rig, as it was resolved when the run began."""
        return self.settings.rig

    @property
    def sample(self) -> SampleDescription | None:
        """What a simulated rig measured."""
        return self.settings.sample

    @property
    def seed(self) -> int:
        """The seed of a simulated rig."""
        return self.settings.run.seed

    @property
    def laboratory(self) -> JsonObject:
        """What is stated of who measured what, with the time of the run and its plan; nothing where nobody has."""
        stated, header = self.settings.laboratory, self.settings.run
        return {} if stated is None else stated.stated() | {"measured": header.created, "plan": header.plan}

    @cached_property
    def bands(self) -> tuple[Band, ...]:
        """The bands that every point is measured in, in order."""
        header = self.settings.run
        known = {band.name: band for band in in_states(self.description.bands.all(), header.polarisation)}
        return tuple(known[name] for name in header.bands)

    @property
    def plan(self) -> DataFrame:
        """The points in order: columns theta_i_deg, phi_i_deg, theta_r_deg, phi_r_deg, flag ("" or a word), reason.

        Those of the plan, and after them those that were chosen.

        Raises
        ------
        DataError
            plan.csv is missing or damaged, or does not hold the points that the run was begun with.
        """
        import pandas as pd

        points = self.points
        table = pd.DataFrame(points.angles_deg, columns=list(ANGLES_DEG))
        return table.assign(flag=pd.Series(points.flags, dtype=str), reason=pd.Series(points.reasons, dtype=str))

    @property
    def points(self) -> Points:
        """What `plan` holds, without a data frame."""
        batches = self._indexed.chosen
        self._require_own_choices(batches)
        count = len(self.planned.flags) + sum(len(batch["points"]) for batch in batches)
        if self._index.last_point >= count:  # by a line that counts, or by one that a later line took back
            for step in self.steps():
                if step.point is not None and step.point >= count:
                    line = self._index.lines[step.step] + 1
                    raise DataError(
                        f"{self.path / 'journal.jsonl'}: line {line}: its step is of point {step.point}, and the run "
                        f"has {count} points; `gonio run repair {self.path}` asks the frames what the line said"
                    )
        if not batches:
            return self.planned
        if self._grown is None or self._grown[0] != len(batches):
            chosen = [angles for batch in batches for angles in batch["points"]]
            table = np.concatenate(
                [self.planned.angles_deg, np.array(chosen, dtype=float).reshape(-1, len(ANGLES_DEG))]
            )
            more = [""] * len(chosen)
            self._grown = len(batches), Points(table, self.planned.flags + more, self.planned.reasons + more)
        return self._grown[1]

    def _require_own_choices(self, batches: Sequence[Event]) -> None:
        """Raise `DataError` where the journal has other points chosen than `CHOSEN`, which is written before it."""
        own = read_manifest(self.path).get(CHOSEN) if batches else None
        if own is None or not is_own(self.path / CHOSEN, own):
            return
        kept = {batch["first_step"]: batch["points"] for batch in json.loads(read_file(self.path / CHOSEN))}
        for batch in batches:
            told = [list(map(float, angles)) for angles in batch["points"]]
            if kept.get(batch["first_step"]) != told:
                raise DataError(
                    f"{self.path / 'journal.jsonl'}: line {batch['n'] + 1}: chose other points from step "
                    f"{batch['first_step']} on than {CHOSEN} holds; `gonio run repair {self.path}` takes those"
                )

    @property
    def batches(self) -> list[Batch]:
        """What was chosen as an adaptive run grew, in order."""
        out, row = [], len(self.planned.flags)
        for event in self._indexed.chosen:
            points = tuple(Point(*map(float, angles)) for angles in event["points"])
            out.append(Batch(int(event["first_step"]), row, points, event.get("why", {})))
            row += len(points)
        return out

    def grown_steps(self) -> list[Step]:
        """The steps of all batches."""
        return [step for batch in self.batches for step in batch.steps(self.description)]

    @property
    def enough(self) -> bool:
        """Whether the sampler of an adaptive run has said that no more points are needed."""
        return self._indexed.enough

    @cached_property
    def planned(self) -> Points:
        """The points of plan.csv: all that was known when the run began."""
        path, run = self.path / "plan.csv", self.settings.run
        own = read_manifest(self.path).get("plan.csv")
        if path.is_file() and changed(self.path, {"plan.csv"}):
            raise DataError(f"{path}: was changed after it was written (its checksum differs); {RESTORE}")
        angles: list[Floats] = [np.empty((0, len(ANGLES_DEG)))]
        flags: list[str] = []
        reasons: list[str] = []
        try:
            with open(path, encoding="utf-8", newline="", opener=only_file) as file:
                rows = csv.reader(file, strict=True)
                if next(rows, None) != PLAN_COLUMNS:
                    raise ValueError(f"its columns are not {', '.join(PLAN_COLUMNS)}")
                while some := list(islice(rows, ROWS)):
                    number, (point, *cells, flag, reason) = len(flags), zip(*some, strict=True)
                    for expected, there in enumerate(map(int, point), number):
                        if there != expected:
                            raise ValueError(f'point {expected} is missing, or stands at another place ("{there}")')
                    angles.append(np.array([list(map(float, column)) for column in cells]).T)
                    flags += map(sys.intern, flag)
                    reasons += map(sys.intern, reason)
        except (OSError, ValueError, csv.Error) as error:
            told = error.strerror if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
            raise DataError(f"{path}: cannot be read as the points of the run: {told}; {RESTORE}") from None
        table = np.concatenate(angles)
        asked = run.wavelength_nm, table.tolist(), self.settings.adaptive, run.polarisation
        if own is None and points_sha256(*asked) != run.plan_sha256:
            raise DataError(f"{path}: does not hold the points that the run was begun with; {RESTORE}")
        return Points(table, flags, reasons)

    def events(self) -> Events:
        """Every event so far, without a torn last line; `DataError` where the journal is damaged before that, or a
        line holds what nobody can use.
        """
        if self.journal is not None:
            events = self.journal.events
        else:
            events = self._closed or read_events(self.path / "journal.jsonl")
        self._index.go_on(events)
        return events

    def steps(self) -> Steps:
        """The completed steps, in the order of their numbers; without those whose frames were lost."""
        return Steps(self.events(), self._index)

    @property
    def _indexed(self) -> Index:
        self.events()
        return self._index

    @cached_property
    def lit_anew_s(self) -> list[float]:
        """When the lamp was lit after it had been dark [s, rig's clock]: at later sessions, and after waits.

        Empty for a simulated run: there time does not go by between two sessions.
        """
        if self.sample is not None:
            return []
        out: list[float] = []
        events, waiting = self.events(), False
        for line in events.lines(range(len(events))):
            if _LIT.match(line):
                waiting = True
            elif waiting and _STEP_LINE.match(line):
                out.append(float(json.loads(line)["time_s"]))
                waiting = False
        return out[1:]

    @property
    def key(self) -> str:
        """What tells the frames of this run from those of others: its id; of earlier versions `asked_key`."""
        return self.settings.run.id or self.asked_key

    @property
    def identity(self) -> JsonObject:
        """What a line of the journal says of the run: its id, and SHA-256 of the files that its frames rest on."""
        if self.settings.run.id is None:
            return {}
        there = [name for name in sorted(AS_BEGUN | {"plan.csv"}) if (self.path / name).is_file()]
        return {"run": self.settings.run.id, "files": {name: sha256_of(self.path / name) for name in there}}

    @cached_property
    def asked_key(self) -> str:
        """A hash of plan, seed, rig and sample: the same for every run that measures them."""
        run, sample = self.settings.run, self.settings.sample
        content = [run.plan_sha256, run.seed, run.rig, self.settings.rig.name]
        content += [sample.name, sample.model] if sample is not None else []
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]

    def frame_path(self, name: str) -> Path:
        """Where a frame that an event names lies."""
        return self.path / "frames" / name

    def append(self, event: Event) -> Event:
        """Write an event to the journal; see `Journal.append`."""
        assert self.journal is not None, "a run that was opened for reading takes no events"
        return self.journal.append(event)

    def append_all(self, events: Sequence[str]) -> None:
        """Write events to the journal together; see `Journal.append_all`."""
        assert self.journal is not None, "a run that was opened for reading takes no events"
        self.journal.append_all(events)

    def grow(self, batch: Batch, why: Mapping[str, Any]) -> None:
        """Say in the journal what was chosen, and why; `CHOSEN` has it too, for a journal that gets lost.

        Raises
        ------
        DataError
            The disk is full or fails.
        """
        points = [[float(getattr(point, name)) for name in ANGLES_DEG] for point in batch.points]
        event = {"event": "chosen", "first_step": batch.first_step, "points": points, "why": dict(why)}
        kept = [*({k: v for k, v in e.items() if k in event} for e in self._indexed.chosen), event]
        with os_error_as(DataError, f"{self.path / CHOSEN}: cannot be written"):
            write_own(self.path, {CHOSEN: json.dumps(kept).encode()})
        self.append(event)

    def state(self, laboratory: Laboratory | None) -> None:
        """Keep what rig file and plan say now of who measures what, where it differs from what the run has."""
        if laboratory is None or laboratory == self.settings.laboratory:
            return
        tables = tomllib.loads(read_file(self.path / "run.toml").decode()) | {"laboratory": laboratory.stated()}
        data = to_toml(tables).encode()
        self.append(  # before: what no line names is refused
            {"event": "remark", "message": "[laboratory] of run.toml is what rig file and plan say now"}
            | ({"files": {"run.toml": hashlib.sha256(data).hexdigest()}} if self.settings.run.id else {})
        )
        write_own(self.path, {"run.toml": data})
        self.settings = self.settings.model_copy(update={"laboratory": laboratory})

    def take_back(self, damaged: Mapping[int, Sequence[str]]) -> list[str]:
        """Say in the journal which steps count no more, because of which frames; what is wrong with each frame."""
        what = [text for number in sorted(damaged) for text in damaged[number]]
        if damaged:
            self.append({"event": "lost", "steps": sorted(damaged), "frames": what})
        return what

    def check_table(self) -> None:
        """Raise `ConfigError` where the folder takes no table: brdf.csv is somebody else's there, or was changed."""
        require_own(self.path, (*TABLE, *BESIDE_TABLE))
        check_writable(self.path)

    def write_table(self, table: DataFrame, beside: Mapping[str, DataFrame | bytes] | None = None) -> Path:
        """Write the measurement table of the run, brdf.csv; one that is there is replaced only if it was written so.

        Parameters
        ----------
        table
            The measurement table.
        beside
            Other tables, or whole files, by their names among `BESIDE_TABLE`. Earlier ones that are not among them are
            removed: they would speak of other values.

        Raises
        ------
        ConfigError
            See `check_table`; or it cannot be written.
        DataError
            The table is not valid.
        """

        with os_error_as(ConfigError, f"{self.path / TABLE[0]}: cannot be written"):
            with work_folder(self.path, "table") as work:
                try:
                    native.write(table, work / TABLE[0])
                except ConfigError as error:
                    raise ConfigError(str(error).replace(str(work), str(self.path))) from None
                tables = {
                    name: held if isinstance(held, bytes) else held.to_csv(index=False).encode()
                    for name, held in (beside or {}).items()
                }
                write_own(self.path, {name: (work / name).read_bytes() for name in TABLE} | tables)
            own = read_manifest(self.path)
            for name in BESIDE_TABLE:
                if name not in tables and is_own(self.path / name, own.get(name, ())):
                    (self.path / name).unlink()
        return self.path / TABLE[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.journal is not None:
            self.journal.close()
            self._closed, self.journal = self.journal.events, None


def own_files(path: Path) -> Manifest:
    """What the program wrote into the folder of a run.

    That is what the manifest names, the journal, the frames that it names, and frames whose own label names this run.
    Nothing where there is no run, or a damaged one.
    """
    out = read_manifest(path)
    with contextlib.suppress(DataError, ConfigError, OSError):
        run = Run.open(path)
        for step in run.steps():
            out |= {f"frames/{frame.file}": {frame.sha256} for frame in step.frames if frame.sha256 is not None}
        if (path / "journal.jsonl").is_file():
            out["journal.jsonl"] = {sha256_of(path / "journal.jsonl")}
        for file in (path / "frames").iterdir():
            if f"frames/{file.name}" not in out and NAME.fullmatch(file.name) and file.is_file():
                label = label_of(file, read_file(file))
                if label is not None and label.run == run.key:
                    out[f"frames/{file.name}"] = {sha256_of(file)}
    return out
