"""Run blind campaigns, as many as are asked for, and write the report of `gonio bench coverage`.

Every campaign leaves one record, written whole, in the folder's `campaigns/`. So a command that was cut short goes on
where it stood, and a larger number of campaigns adds to those that are there.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import fcntl
import io
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gonio_analysis.report import html
from gonio_analysis.result_records import as_json
from gonio_analysis.selection import parallel

from gonio.config import Strict, parse, read_toml, to_toml
from gonio.disk import require_name, write_own, write_whole
from gonio.errors import ConfigError, Interrupted
from gonio_validation.bench import coverage_campaign, coverage_hidden, coverage_judgement, coverage_page, timing
from gonio_validation.bench.coverage_campaign import FORMAT, Record
from gonio_validation.bench.coverage_results import CauseSummary, Coverage

CAMPAIGNS, FEW = 200, 12
"""Without a number; and of a quick run."""
POINTS, FEW_POINTS = 40, 15
"""At most, of a campaign's plan."""
SETTINGS = "coverage.toml"
"""In the folder: what its campaigns were drawn from."""

Step = Callable[[int, int], None]


class Settings(Strict):
    """What makes the campaigns of a folder what they are: with others they would be other campaigns."""

    format: int = FORMAT
    seed: int
    errors: tuple[str, ...]
    points: int
    gonio: str


@dataclass(frozen=True)
class Job:
    """One campaign that is still to be carried out."""

    number: int
    settings: Settings
    folder: Path


def make(
    out: str | Path,
    *,
    campaigns: int | None = None,
    seed: int = 1,
    jobs: int | None = None,
    only: Sequence[str] = (),
    quick: bool = False,
    command: str = "",
    step: Step = lambda done, total: None,
) -> Path:
    """Carry out the campaigns that are missing, and write the report on all.

    Parameters
    ----------
    out
        Folder of the report and of the records.
    campaigns
        How many; 200 by default, or 12 of a quick run.
    seed
        At least 0.
    jobs
        Processes; one for each processor by default.
    only
        Names of the errors that the benches have; all by default.
    quick
        Few campaigns of few points.
    command
        The command line, for the record.
    step
        Told how many campaigns are done, of how many.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        An argument is wrong; or the folder cannot be written, holds something else, or campaigns of another kind.
    Interrupted
        Somebody stopped it; the records that are there count.
    """
    total = campaigns if campaigns is not None else FEW if quick else CAMPAIGNS
    for name, value, least in (
        ("--campaigns", total, 1),
        ("--seed", seed, 0),
        ("--jobs", 1 if jobs is None else jobs, 1),
    ):
        if value < least:
            raise ConfigError(f"{name} {value}: must be {least} or more")
    errors = tuple(cause.name for cause in coverage_hidden.chosen(only))
    points = FEW_POINTS if quick else POINTS
    settings = Settings(seed=seed, errors=errors, points=points, gonio=version("gonio"))
    folder = Path(out)
    try:
        _begin(folder, settings)
        with alone(folder / SETTINGS, "coverage"):
            shutil.rmtree(folder / "work", ignore_errors=True)  # of campaigns that were cut short
            missing = [k for k in range(total) if not _record(folder, k)]
            done = total - len(missing)
            step(done, total)
            try:
                for _ in parallel.each(_carry_out, [Job(k, settings, folder) for k in missing], workers=jobs):
                    done += 1
                    step(done, total)
            except (KeyboardInterrupt, Interrupted):
                done = sum(_record(folder, k) is not None for k in range(total))
                raise Interrupted(
                    f"{folder}: {done} of {total} campaigns are done and kept; the same command goes on with the others"
                ) from None
            shutil.rmtree(folder / "work", ignore_errors=True)
            records = [record for k in range(total) if (record := _record(folder, k)) is not None]
            write(summary(records, settings, quick=quick, command=command), records, folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder / "index.html"


def _begin(folder: Path, settings: Settings) -> None:
    """A new folder, or one whose campaigns are of the same kind."""
    require_name(folder)
    file = folder / SETTINGS
    if file.is_file():
        before = parse(Settings, read_toml(file), file)
        for name, value in settings.model_dump().items():
            was = getattr(before, name)
            if was != value:
                raise ConfigError(
                    f"{file}: its campaigns have {name} = {_said(was)}, and {_said(value)} is asked for: they cannot "
                    "be counted together; choose another folder with --out"
                )
    elif folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder}: holds something else than campaigns; choose another folder with --out")
    elif folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; --out names a folder")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, to_toml(settings.model_dump(mode="json")).encode())
    (folder / "campaigns").mkdir(exist_ok=True)


@contextlib.contextmanager
def alone(settings: Path, bench: str) -> Iterator[None]:
    """Nobody else works in the folder of these settings meanwhile; `bench` is what works there."""
    with open(settings, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"{settings.parent}: another bench {bench} is at work there; wait until it has ended, or stop it"
            ) from None
        yield


def _said(value: object) -> str:
    return ", ".join(value) if isinstance(value, tuple) else str(value)


def _carry_out(job: Job) -> int:
    s = job.settings
    drawn = coverage_hidden.campaign(s.seed, job.number, s.errors, s.points)
    record = coverage_campaign.carried_out(drawn, job.folder / "work" / f"{job.number:05d}")
    text = json.dumps(record, ensure_ascii=False, allow_nan=False)
    write_whole(_path(job.folder, job.number), text.encode())
    return job.number


def _path(folder: Path, number: int) -> Path:
    return folder / "campaigns" / f"{number:05d}.json"


def _record(folder: Path, number: int) -> Record | None:
    """The record of a campaign; None where there is none yet, or one that a disk has damaged."""
    try:
        record = json.loads(_path(folder, number).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    whole = isinstance(record, dict) and record.get("format") == FORMAT and record.get("campaign") == number
    return record if whole else None


def summary(records: Sequence[Record], settings: Settings, *, quick: bool = False, command: str = "") -> Coverage:
    """Every number of the report, as `results.json` holds it."""
    counts, pulls, uniform = coverage_judgement.judged(records)
    measured = [r for r in records if r["points"] and r["points"]["brdf"]]
    drawn = [coverage_judgement.chosen_parameter(r) for r in records if r["fit"]]
    return Coverage(
        title="Do the stated intervals hold the truth?",
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=command,
        quick=quick,
        seed=settings.seed,
        campaigns=len(records),
        values=sum(len(r["points"]["brdf"]) for r in measured),
        seconds=sum(r["seconds"] for r in records),
        machine=timing.machine(),
        causes=[CauseSummary(c.name, c.hidden, c.learned, c.name in settings.errors) for c in coverage_hidden.CAUSES],
        counts=counts,
        pulls=pulls,
        uniform=uniform,
        single_pulls=coverage_judgement.single_points(measured),
        parameter_pulls=coverage_judgement.known_pulls(drawn),
        worst=coverage_judgement.worst(records),
        failed=coverage_judgement.failed(records),
    )


def write(s: Coverage, records: Sequence[Record], folder: Path) -> None:
    """Write page, numbers and figures into a folder that exists; an earlier report there is replaced."""
    drawn = coverage_page.drawn(s)
    files = {
        "index.html": html.document(coverage_page.render(s, drawn)).encode(),
        "results.json": (json.dumps(as_json(s), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode(),
        "campaigns.csv": _csv(coverage_judgement.line(r) for r in records),
    }
    for figure in drawn:
        files |= {f"{figure.name}.svg": figure.svg.encode(), f"{figure.name}.png": figure.png}
    write_own(folder, files)


def _csv(rows: Iterable[dict[str, Any]]) -> bytes:
    every = list(rows)
    text = io.StringIO()
    out = csv.DictWriter(text, list(every[0]), lineterminator="\n")
    out.writeheader()
    out.writerows({k: "" if v is None else v for k, v in row.items()} for row in every)
    return text.getvalue().encode()
