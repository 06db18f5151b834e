"""Runs of a bench that are drawn, carried out, recorded, gone on with and reported: coverage, sweeps, materials.

Every run leaves one record, written whole. So a command that was cut short goes on where it stood, and a larger number
of runs adds to those that are there.
"""

import contextlib
import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gonio_analysis.report import files
from gonio_analysis.report.blocks import Page
from gonio_analysis.report.drawing import Figure
from gonio_analysis.selection import parallel

from gonio import lost, platform
from gonio.config import Strict, parse, read_toml, to_toml
from gonio.disk import require_name, write_own, write_whole
from gonio.errors import ConfigError, Interrupted
from gonio.typing import JsonObject

Record = JsonObject
Step = Callable[[int, int], None]
"""Called with how many runs are done, and how many there are."""


@dataclass(frozen=True)
class Campaigns:
    """The runs in a folder, all of one kind."""

    folder: Path
    bench: str
    """What works there: "coverage"."""
    runs: str
    """What a run is called, in plural; their records lie in a folder of this name."""
    settings: Strict
    """What makes the runs what they are: with others they would be other runs."""

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """A new folder, or one whose runs are of the same kind; nobody else works there meanwhile.

        Raises
        ------
        ConfigError
            The folder cannot be written, holds something else, or runs of another kind; or somebody works there.
        """
        file = self.folder / f"{self.bench}.toml"
        try:
            self._begin(file)
            with open(file, "rb") as held:
                if not platform.lock(held):
                    raise ConfigError(
                        f"{self.folder}: another bench {self.bench} is at work there; wait until it has ended, or stop"
                        " it"
                    )
                yield
        except OSError as error:
            raise ConfigError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def _begin(self, file: Path) -> None:
        require_name(self.folder)
        if file.is_file():
            before = parse(type(self.settings), read_toml(file), file)
            for name, value in self.settings.model_dump().items():
                was = getattr(before, name)
                if was != value:
                    raise ConfigError(
                        f"{file}: its {self.runs} have {name} = {_said(was)}, and {_said(value)} is asked for: they "
                        "cannot be counted together; choose another folder with --out"
                    )
        elif self.folder.exists() and not self.folder.is_dir():
            raise ConfigError(f"{self.folder}: is a file; --out names a folder")
        elif self.folder.is_dir() and any(self.folder.iterdir()):
            raise ConfigError(f"{self.folder}: holds something else than {self.runs}; choose another folder with --out")
        else:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(file, to_toml(self.settings.model_dump(mode="json")).encode())
        (self.folder / self.runs).mkdir(exist_ok=True)

    def carried_out(
        self, wanted: Mapping[str, Callable[[], Record]], jobs: int | None, dask: str | None, step: Step
    ) -> list[Record]:
        """The records of the runs that are wanted, by name; those that are missing are carried out.

        A run is a function of a module with its arguments, so that it can travel: to `jobs` processes here, or to the
        workers of the Dask scheduler at the address `dask`.

        Raises
        ------
        ConfigError
            No scheduler answers at `dask`.
        Interrupted
            Somebody stopped it; the records that are there count.
        """
        missing = [name for name in wanted if self.record(name) is None]
        done = len(wanted) - len(missing)
        step(done, len(wanted))
        try:
            for k, found in parallel.each(_called, [wanted[name] for name in missing], dask=dask, workers=jobs):
                write_whole(self._path(missing[k]), json.dumps(found, ensure_ascii=False, allow_nan=False).encode())
                done += 1
                step(done, len(wanted))
        except (KeyboardInterrupt, Interrupted):
            raise Interrupted(
                f"{self.folder}: {done} of {len(wanted)} {self.runs} are done and kept; the same command goes on with "
                "the others"
            ) from None
        return [record for name in wanted if (record := self.record(name)) is not None]

    def record(self, name: str) -> Record | None:
        """The record of one run; None where there is none yet, or one that a disk has damaged."""
        try:
            record = json.loads(self._path(name).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None
        whole = isinstance(record, dict) and record.get("format") == getattr(self.settings, "format", None)
        return record if whole else None

    def _path(self, name: str) -> Path:
        return self.folder / self.runs / f"{name}.json"


def _called(run: Callable[[], Record]) -> Record:
    return run()


def _said(value: object) -> str:
    return ", ".join(value) if isinstance(value, tuple) else str(value)


def write(
    folder: Path,
    results: JsonObject,
    draw: Callable[[], Sequence[Figure]],
    render: Callable[[Sequence[Figure]], Page],
    tables: Mapping[str, Callable[[], bytes]],
) -> None:
    """Write page, numbers, tables and figures into a folder that exists; an earlier report there is replaced.

    Raises
    ------
    ConfigError
        A file there is not our own; nothing is written then.
    Incomplete
        All is written, but for parts that could not be made (`gonio.lost`).
    """
    with lost.whole(folder / "index.html"):
        content = lost.kept("results.json", partial(files.plain, results), lambda loss: {})
        made = {name: lost.kept(name, make, lambda loss: b"") for name, make in tables.items()}
        figures, page = files.drawn_and_said(results["title"], draw, render)
        for figure in figures:
            if not figure.failed:
                made |= {f"{figure.name}.svg": figure.svg.encode(), f"{figure.name}.png": figure.png}
        made = {name: data for name, data in made.items() if data}
        made["index.html"] = files.encoded("index.html", page)
        write_own(folder, made | {"results.json": files.as_text(content)})


def as_csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> bytes:
    """A table with these columns, or those of its first row; None is an empty cell."""
    text = io.StringIO()
    out = csv.DictWriter(text, columns or list(rows[0]), lineterminator="\n")
    out.writeheader()
    out.writerows({k: "" if v is None else v for k, v in row.items()} for row in rows)
    return text.getvalue().encode()


def at_least(**given: tuple[int | None, int]) -> None:
    """Raise `ConfigError` for an option (without dashes) below its least value."""
    for name, (value, least) in given.items():
        if value is not None and value < least:
            raise ConfigError(f"--{name} {value}: must be {least} or more")
