"""The folder of a run: what was asked, what has happened, and the frames.

    RUN/  run.toml       resolved rig, sample, bands, seed, versions, command line, hash of the plan
          plan.csv       the points in order, with the flag and the reason of those that this rig cannot measure
          journal.jsonl  what has happened (gonio.journal)
          frames/        raw frames

A run whose journal holds no complete line counts as not started: `create` starts it again, whatever else lies there.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import hashlib
import json
import os
import platform
import shutil
import sys
import tomllib
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gonio.config import Strict, parse, to_toml
from gonio.description import Band, RigDescription, SampleDescription
from gonio.disk import half_written, sync_folder, write_whole
from gonio.errors import ConfigError, DataError
from gonio.formats.native import meta_path
from gonio.journal import Event, Journal, read_events
from gonio.plan import ANGLES, Assessed, Plan

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
OURS = ("run.toml", "plan.csv", "journal.jsonl", "frames", "reference.csv", "reference.meta.json")
RECORDED = ("gonio", "numpy", "scipy", "numba", "pandas", "rawpy")


class Header(Strict):
    """The table [run] of a run.toml."""

    format: int
    created: str
    command: str
    plan: str
    plan_sha256: str
    wavelength_nm: tuple[float, ...]
    bands: tuple[str, ...]
    rig: str
    """The entry point that drove it."""
    seed: int


class Settings(Strict):
    """A run.toml."""

    run: Header
    versions: dict[str, str]
    rig: RigDescription
    sample: SampleDescription | None = None


@dataclass(frozen=True, slots=True)
class Request:
    """What a run is asked to be."""

    plan: Plan
    points: list[Assessed]
    """The plan's points, as `description` sees them."""
    description: RigDescription
    sample: SampleDescription | None
    seed: int
    command: str
    """The command line, for the record."""


@dataclass
class Run:
    """An opened run; the methods that write need `journal`, which `create` and `resume` open."""

    path: Path
    settings: Settings
    journal: Journal | None = None

    @classmethod
    def create(cls, path: str | Path, request: Request) -> Run:
        """Start a run in an empty or absent folder; where that fails nothing is left behind.

        Raises
        ------
        ConfigError
            The folder holds a run that has begun, or other things, or cannot be written.
        """
        path = Path(path)
        check_new(path)
        made = _make_folder(path)
        journal = None
        try:
            journal = Journal(path / "journal.jsonl")
            if journal.events:
                raise _needs_resume(path)
            shutil.rmtree(path / "frames", ignore_errors=True)
            for left in [entry for entry in path.iterdir() if half_written(entry.name, OURS)]:
                left.unlink()
            (path / "frames").mkdir()
            settings = _settings(request, _with_reference_table(path, request.description))
            write_whole(path / "plan.csv", _plan_csv(request.points).encode())
            write_whole(path / "run.toml", to_toml(settings.model_dump(mode="json", exclude_none=True)).encode())
            sync_folder(path)
        except BaseException as error:
            if journal is not None and not journal.events:  # the folder is ours, and nothing has happened in it
                for name in OURS:
                    shutil.rmtree(path / name, ignore_errors=True)
                    (path / name).unlink(missing_ok=True)
            if journal is not None:
                journal.close()
            for folder in reversed(made):
                with contextlib.suppress(OSError):
                    folder.rmdir()
            if isinstance(error, OSError):
                raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
            raise
        return cls(path, _resolved(settings, path), journal)

    @classmethod
    def resume(cls, path: str | Path, request: Request) -> Run:
        """Go on with a run, or start it where it has not begun.

        Raises
        ------
        ConfigError
            Plan, rig, sample or seed are not those of the run (the message names what differs), or another process
            writes to it.
        DataError
            The journal is damaged before its last line.
        """
        path = Path(path)
        if not begun(path):
            return cls.create(path, request)
        run = cls.open(path)
        journal = Journal(path / "journal.jsonl")
        try:
            differing = _differences(run.settings, _settings(request, request.description))
            if differing:
                raise ConfigError(
                    f"{path}: this run was begun with something else, so it cannot be resumed:\n"
                    + "\n".join(f"  {line}" for line in differing[:8])
                    + "\nresume with what it was begun with, or measure into a new folder"
                )
            _drop_orphans(path, journal.events)
        except BaseException:
            journal.close()
            raise
        run.journal = journal
        return run

    @classmethod
    def open(cls, path: str | Path) -> Run:
        """A run to read from.

        Raises
        ------
        ConfigError
            There is no such folder, or it holds no run.
        DataError
            Its run.toml is damaged.
        """
        path = Path(path)
        if not path.is_dir():
            raise ConfigError(f"{path}: there is no such folder; a run is a folder that `gonio measure` has written")
        try:
            values = tomllib.loads((path / "run.toml").read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ConfigError(
                f"{path}: holds no run.toml; a run is a folder that `gonio measure` has written"
            ) from None
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise DataError(f"{path / 'run.toml'}: is damaged: {error}") from None
        try:
            settings = parse(Settings, values, path / "run.toml")
        except ConfigError as error:
            raise DataError(str(error)) from None
        return cls(path, _resolved(settings, path))

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
    def bands(self) -> tuple[Band, ...]:
        """The bands that every point is measured in, in order."""
        known = {band.name: band for band in self.description.bands.all()}
        return tuple(known[name] for name in self.settings.run.bands)

    @cached_property
    def plan(self) -> pd.DataFrame:
        """The points in order: columns theta_i_deg, phi_i_deg, theta_r_deg, phi_r_deg, flag ("" or a word), reason.

        Raises
        ------
        DataError
            plan.csv is missing or damaged.
        """
        import pandas as pd

        path = self.path / "plan.csv"
        try:
            table = pd.read_csv(path, dtype={"flag": str, "reason": str}, keep_default_na=False)
            table = table.set_index("point")[[*ANGLES, "flag", "reason"]].astype(dict.fromkeys(ANGLES, float))
        except (OSError, ValueError, KeyError, UnicodeDecodeError) as error:
            raise DataError(f"{path}: cannot be read as the points of a run: {error}") from None
        table.index.name = None
        return table

    def events(self) -> list[Event]:
        """Every event so far, without a torn last line; `DataError` where the journal is damaged before that."""
        return self.journal.events if self.journal is not None else read_events(self.path / "journal.jsonl")

    def steps(self) -> list[Event]:
        """The completed steps, in the order of their numbers."""
        return sorted((e for e in self.events() if e["event"] == "step"), key=lambda e: int(e["step"]))

    def frame_path(self, name: str) -> Path:
        """Where a frame that an event names lies."""
        return self.path / "frames" / name

    def append(self, event: Event) -> Event:
        """Write an event to the journal; see `Journal.append`."""
        assert self.journal is not None, "a run that was opened for reading takes no events"
        return self.journal.append(event)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.journal is not None:
            self.journal.close()


def begun(path: Path) -> bool:
    """Whether a folder's journal holds a complete line (`DataError` where it is damaged)."""
    return bool(read_events(path / "journal.jsonl"))


def check_new(path: Path) -> None:
    """Raise `ConfigError` where a run cannot be started in a folder; touches nothing."""
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{path}: is not a folder")
    if path.is_dir():
        if begun(path):
            raise _needs_resume(path)
        names = sorted(entry.name for entry in path.iterdir())
        foreign = [name for name in names if name not in OURS and not half_written(name, OURS)]
        if foreign and not (path / "run.toml").exists():
            raise ConfigError(f'{path}: is not empty (it holds "{foreign[0]}"); a run needs a folder of its own')
    check_writable(path)


def check_writable(path: Path) -> None:
    """Raise `ConfigError` where a folder cannot be made, or files in it; touches nothing."""
    at = path.absolute()
    while not at.exists():
        at = at.parent
    if not at.is_dir():
        raise ConfigError(f"{path}: {at} is not a folder")
    if not os.access(at, os.W_OK | os.X_OK) or os.statvfs(at).f_flag & os.ST_RDONLY or _refuses(at):
        raise ConfigError(f"{path}: {at} is not writable; choose another folder, or change its permissions")


def _refuses(folder: Path) -> bool:
    """Whether a folder takes no new entries although its permissions say so (as in /proc)."""
    import tempfile

    try:
        with tempfile.TemporaryDirectory(prefix=".gonio-", dir=folder):
            return False
    except OSError:
        return True


def _settings(request: Request, description: RigDescription) -> Settings:
    versions = {"python": platform.python_version()}
    for name in RECORDED:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    return Settings(
        run=Header(
            format=FORMAT,
            created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
            command=request.command,
            plan=request.plan.name,
            plan_sha256=request.plan.sha256,
            wavelength_nm=request.plan.wavelength_nm,
            bands=tuple(band.name for band in request.plan.bands(description)),
            rig=description.rig,
            seed=request.seed,
        ),
        versions=versions,
        rig=description,
        sample=request.sample,
    )


def _differences(was: Settings, now: Settings) -> list[str]:
    """What keeps a run from being resumed with other settings, a line each."""
    out = []
    if was.run.plan_sha256 != now.run.plan_sha256:
        out.append(f'plan: the points or wavelengths of "{now.run.plan}" are not those of "{was.run.plan}"')
    if was.run.seed != now.run.seed:
        out.append(f"seed: {was.run.seed} in the run, {now.run.seed} now")
    out += _differing_keys("rig", _comparable(was.rig), _comparable(now.rig))
    samples = [s.model_dump(mode="json") if s is not None else {} for s in (was.sample, now.sample)]
    return out + _differing_keys("sample", *samples)


def _comparable(description: RigDescription) -> dict[str, Any]:
    """A rig's values; of its reference table the content counts, not where it lies."""
    values = description.model_dump(mode="json")
    if description.reference.table is not None:
        with contextlib.suppress(OSError):
            values["reference"]["table"] = hashlib.sha256(Path(description.reference.table).read_bytes()).hexdigest()[
                :12
            ]
    return values


def _differing_keys(name: str, was: Any, now: Any) -> list[str]:
    if isinstance(was, dict) and isinstance(now, dict):
        return [
            line
            for key in dict.fromkeys([*was, *now])
            for line in _differing_keys(f"{name}.{key}", was.get(key), now.get(key))
        ]
    return [] if was == now else [f"{name}: {json.dumps(was)} in the run, {json.dumps(now)} now"]


def _plan_csv(points: list[Assessed]) -> str:
    import io

    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(["point", *ANGLES, "flag", "reason"])
    for row, a in enumerate(points):
        lines.writerow([row, *(repr(getattr(a.point, name)) for name in ANGLES), a.flag, a.reason])
    return out.getvalue()


def _with_reference_table(path: Path, description: RigDescription) -> RigDescription:
    """Copy the reference's table into the run, so that the run can be reduced without the rig file's folder."""
    table = description.reference.table
    if table is None:
        return description
    source = Path(table)
    name = "reference.csv"
    try:
        write_whole(path / name, source.read_bytes())
        if meta_path(source).exists():
            write_whole(meta_path(path / name), meta_path(source).read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{source}: the table of the white reference ([reference] table) is not there") from None
    return description.model_copy(update={"reference": description.reference.model_copy(update={"table": name})})


def _resolved(settings: Settings, path: Path) -> Settings:
    """The settings with the path of the reference's table made whole."""
    table = settings.rig.reference.table
    if table is None:
        return settings
    reference = settings.rig.reference.model_copy(update={"table": str(path / table)})
    return settings.model_copy(update={"rig": settings.rig.model_copy(update={"reference": reference})})


def _drop_orphans(path: Path, events: list[Event]) -> None:
    """Remove the frames of a step that was cut short; the step is taken again."""
    named = {frame["file"] for event in events for frame in event.get("frames", ())}
    (path / "frames").mkdir(exist_ok=True)
    for file in (path / "frames").iterdir():
        if file.name not in named:
            file.unlink()


def _make_folder(path: Path) -> list[Path]:
    """Make a folder and its parents; those that were made, outermost first."""
    missing = [folder for folder in (path.absolute(), *path.absolute().parents) if not folder.exists()][::-1]
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for folder in reversed(missing):
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise ConfigError(f"{path}: cannot be made: {error.strerror}") from None
    return missing


def _needs_resume(path: Path) -> ConfigError:
    return ConfigError(f"{path}: a run has begun here; go on with --resume, or measure into a new folder")


def command_line() -> str:
    """The command line of this process, as it is stored with a run."""
    import shlex

    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
