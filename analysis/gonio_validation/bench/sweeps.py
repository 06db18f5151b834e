"""`gonio bench sweeps`: rig time against the error of the curves that come of it, for fixed and for adaptive plans.

Every comparison leaves one record, written whole, in the folder's `comparisons/`. So a command that was cut short goes
on where it stood, and a larger number of seeds adds to those that are there.
"""

from __future__ import annotations

import csv
import datetime
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from gonio_analysis.report import html
from gonio_analysis.result_records import as_json
from gonio_analysis.selection import parallel

from gonio.config import Strict, parse, read_toml, to_toml
from gonio.disk import require_name, write_own, write_whole
from gonio.errors import ConfigError, Interrupted
from gonio_validation.bench import sweeps_page, sweeps_results, timing
from gonio_validation.bench.coverage import alone
from gonio_validation.bench.sweeps_plans import INCIDENCES, SAMPLES, Geometry
from gonio_validation.bench.sweeps_results import Record, Sweeps
from gonio_validation.bench.sweeps_run import FORMAT, carried_out

SEEDS = 3
SETTINGS = "sweeps.toml"
"""In the folder: what its comparisons were made by."""
QUICK = ("rough aluminium", "matte")

Step = Callable[[int, int], None]


class Settings(Strict):
    """What makes the comparisons of a folder what they are."""

    format: int = FORMAT
    gonio: str


@dataclass(frozen=True)
class Job:
    """One comparison that is still to be made."""

    sample: str
    geometry: Geometry
    seed: int
    folder: Path

    @property
    def path(self) -> Path:
        """Of its record."""
        name = f"{self.geometry} {self.sample} {self.seed:03d}.json".replace(" ", "-")
        return self.folder / "comparisons" / name


def make(
    out: str | Path,
    *,
    seeds: int | None = None,
    jobs: int | None = None,
    quick: bool = False,
    command: str = "",
    step: Step = lambda done, total: None,
) -> Path:
    """Make the comparisons that are missing, and write the report on all.

    Parameters
    ----------
    out
        Folder of the report and of the records.
    seeds
        Runs of every plan, each with errors and noise of its own; 3 by default, or 1 of a quick run.
    jobs
        Processes; one for each processor by default.
    quick
        Two samples, in plane alone.
    command
        The command line, for the record.
    step
        Told how many comparisons are done, of how many.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        An argument is wrong; or the folder cannot be written, or holds something else.
    Interrupted
        Somebody stopped it; the records that are there count.
    """
    count = seeds if seeds is not None else 1 if quick else SEEDS
    for name, value in (("--seeds", count), ("--jobs", 1 if jobs is None else jobs)):
        if value < 1:
            raise ConfigError(f"{name} {value}: must be 1 or more")
    folder = Path(out)
    geometries: Sequence[Geometry] = ("in plane",) if quick else tuple(INCIDENCES)
    wanted = [
        Job(sample, geometry, seed, folder)
        for seed in range(count)
        for geometry in geometries
        for sample in (QUICK if quick else SAMPLES)
    ]
    try:
        _begin(folder)
        with alone(folder / SETTINGS, "sweeps"):
            missing = [job for job in wanted if _record(job) is None]
            done = len(wanted) - len(missing)
            step(done, len(wanted))
            try:
                for _ in parallel.each(_carry_out, missing, workers=jobs):
                    done += 1
                    step(done, len(wanted))
            except (KeyboardInterrupt, Interrupted):
                kept = sum(_record(job) is not None for job in wanted)
                raise Interrupted(
                    f"{folder}: {kept} of {len(wanted)} comparisons are done and kept; the same command goes on with "
                    "the others"
                ) from None
            records = [record for job in wanted if (record := _record(job)) is not None]
            write(summary(records, seeds=count, quick=quick, command=command), folder)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    return folder / "index.html"


def _begin(folder: Path) -> None:
    """A new folder, or one whose comparisons are of the same kind."""
    require_name(folder)
    file, now = folder / SETTINGS, Settings(gonio=version("gonio"))
    if file.is_file():
        before = parse(Settings, read_toml(file), file)
        if before != now:
            raise ConfigError(
                f"{file}: its comparisons were made by gonio {before.gonio}, format {before.format}, and this is "
                f"{now.gonio}, format {now.format}: they cannot be put together; choose another folder with --out"
            )
    elif folder.is_dir() and any(folder.iterdir()):
        raise ConfigError(f"{folder}: holds something else than comparisons; choose another folder with --out")
    elif folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; --out names a folder")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(file, to_toml(now.model_dump(mode="json")).encode())
    (folder / "comparisons").mkdir(exist_ok=True)


def _carry_out(job: Job) -> None:
    record = carried_out(job.sample, job.geometry, job.seed)
    write_whole(job.path, json.dumps(record, ensure_ascii=False, allow_nan=False).encode())


def _record(job: Job) -> Record | None:
    """The record of a comparison; None where there is none yet, or one that a disk has damaged."""
    try:
        record = json.loads(job.path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return None
    return record if isinstance(record, dict) and record.get("format") == FORMAT else None


def summary(records: Sequence[Record], *, seeds: int, quick: bool = False, command: str = "") -> Sweeps:
    """Every number of the report, as `results.json` holds it."""
    found = sweeps_results.levels(records)
    return Sweeps(
        title="Rig time against error of curves",
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=command,
        quick=quick,
        seeds=seeds,
        seconds=sum(r["seconds"] for r in records),
        machine=timing.machine(),
        levels=found,
        by_points=sweeps_results.by_points(found),
        held=sweeps_results.held(records),
    )


def write(s: Sweeps, folder: Path) -> None:
    """Write page, numbers and figures into a folder that exists; an earlier report there is replaced."""
    drawn = sweeps_page.drawn(s)
    text = io.StringIO()
    table = csv.DictWriter(text, list(asdict(s.levels[0])), lineterminator="\n")
    table.writeheader()
    table.writerows({k: "" if v is None else v for k, v in asdict(level).items()} for level in s.levels)
    files = {
        "index.html": html.document(sweeps_page.render(s, drawn)).encode(),
        "results.json": (json.dumps(as_json(s), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode(),
        "points.csv": text.getvalue().encode(),
    }
    for figure in drawn:
        files |= {f"{figure.name}.svg": figure.svg.encode(), f"{figure.name}.png": figure.png}
    write_own(folder, files)
