"""One model fitted to each of very many tables, in one process: one row a table."""

import csv
import hashlib
import io
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import gonio
from gonio import measurement, platform, plugins
from gonio.disk import require_name, write_whole
from gonio.errors import ConfigError, GonioError, os_error_as
from gonio.formats import own_pairs
from gonio.measurement import Reading, meta_path
from gonio_analysis.fitting.by_engine import fit_by
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.spectrum import fit_table
from gonio_analysis.selection import parallel

BESIDE = (".meta.json", ".columns.toml", ".ior.toml")
"""Endings of files that belong to a table."""
MANY = 100
"""Tables from which on the engine of maps fits them: what it may have to compile takes as long as so many fits."""
NO_ENGINE = "gonio_maps is not installed"
Row = dict[str, str]
Count = Callable[[int, int], None]


@dataclass(frozen=True)
class TablesOutcome:
    """What came of all tables."""

    rows: list[Row]
    before: int
    """Tables that had been done before."""
    alone: Mapping[str, int]
    """Why samples of this try were searched for one by one, and how many; empty of few tables."""


@dataclass(frozen=True)
class _Job:
    """One table to fit."""

    table: str
    digest: str
    asked: FitRequest
    how: Reading
    settings: str
    by_engine: bool


def listed(where: str) -> list[str]:
    """The tables of a folder, by name, or those that a text file lists, one a line ("#" begins a remark).

    Raises
    ------
    ConfigError
        There is no such folder or file, it cannot be read, or it names none.
    """
    path = Path(where)
    if path.is_dir():
        files = [one for one in sorted(path.iterdir()) if not one.name.startswith(".")]
        found = [str(one) for one in files if (one.is_file() and not one.name.endswith(BESIDE)) or _is_run(one)]
    else:
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"--each {where}: a folder, or a text file with a table a line, is needed: {why}"
            ) from None
        found = list(dict.fromkeys(line.strip() for line in lines if line.strip() and not line.startswith("#")))
    if not found:
        raise ConfigError(f"--each {where}: names no table")
    return found


def make(
    where: str, out: Path, asked: FitRequest, how: Reading, *, dask: str | None = None, count: Count
) -> TablesOutcome:
    """Fit every table, and write a row for each.

    Parameters
    ----------
    where
        A folder, or a text file that lists tables.
    out
        The table of rows (CSV). While the fits go on rows are in `<out>.part`; who begins again keeps those whose
        files, model and options are the same.
    asked, how
        What is fitted, and how tables are read.
    dask
        Address of a Dask scheduler; otherwise the fits run on the processors here.
    count
        Called with how many tables are done, and how many there are.

    Raises
    ------
    ConfigError
        The request fits no table, or `out` cannot be written or is another table.
    """
    names = _columns(pose(asked).free)
    require_name(out)
    part, settings = out.with_name(out.name + ".part"), _settings(asked, how)
    tables = [one for one in listed(where) if Path(one) not in (out, part)]
    known = _known(out, names) + _known(part, names)
    done: dict[tuple[str, str], list[Row]] = {}
    for row in known:
        if row["settings"] == settings:
            done.setdefault((row["table"], row["sha256"]), []).append(row)
    jobs = [_Job(one, _digest(one), asked, how, settings, len(tables) >= MANY) for one in tables]
    todo = [job for job in jobs if (job.table, job.digest) not in done]
    alone = Counter[str]()
    with os_error_as(ConfigError, f"{out}: cannot be written"):
        write_whole(
            part, _csv(names, [row for job in jobs for row in done.get((job.table, job.digest), ())], head=True)
        )
        with open(part, "ab", buffering=0) as file:
            for many, (k, (rows, reasons)) in enumerate(parallel.each(_rows, todo, dask=dask), 1):
                file.write(_csv(names, rows))
                done[todo[k].table, todo[k].digest] = rows
                alone.update(reasons)
                count(many, len(todo))
        every = [row for job in jobs for row in done[job.table, job.digest]]
        write_whole(out, _csv(names, every, head=True))
        platform.sync_folder(out.parent)  # the table has its name on the disk before the rows of this try go
        part.unlink()
    return TablesOutcome(every, len(jobs) - len(todo), alone)


def _columns(free: Iterable[str]) -> list[str]:
    parameters = [column for name in free for column in (name, f"u_{name}")]
    return [
        "table",
        "sample",
        "wavelength_nm",
        "n",
        *parameters,
        "misfit",
        "chi_square",
        "flag",
        "notes",
        "sha256",
        "settings",
    ]


def _is_run(path: Path) -> bool:
    return (path / "brdf.csv").is_file()


def _settings(asked: FitRequest, how: Reading) -> str:
    """What rows depend on besides their tables, as a short digest."""
    said = {"gonio": gonio.__version__, "asked": asdict(asked), "columns": how.columns}
    return hashlib.sha256(json.dumps(said, default=str, sort_keys=True).encode()).hexdigest()[:16]


def _digest(table: str) -> str:
    """SHA-256 of a table's file and of what belongs to it; "" where it cannot be read."""
    path = Path(measurement.split(table)[0])
    path = path / "brdf.csv" if path.is_dir() else path
    digest = hashlib.sha256()
    try:
        digest.update(path.read_bytes())
        for beside in (meta_path(path), own_pairs.beside_path(path)):
            if beside.is_file():
                digest.update(beside.read_bytes())
    except OSError:
        return ""
    return digest.hexdigest()


def _known(path: Path, names: list[str]) -> list[Row]:
    """The rows of an earlier try; a line that a kill has torn is left out, with all rows of its table."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}; choose another --out") from None
    whole, _, torn = text.rpartition("\n")
    read = csv.DictReader(io.StringIO(whole, newline=""))
    if read.fieldnames is not None and list(read.fieldnames) != names:
        raise ConfigError(f"{path}: is there already, and holds no rows of these parameters; choose another --out")
    rows = list(read)
    half = next(csv.reader([torn]), [""])[0] if torn else None
    return [row for row in rows if row["table"] != half]


def _csv(names: list[str], rows: list[Row], *, head: bool = False) -> bytes:
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    if head:
        writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue().encode()


def _rows(job: _Job) -> tuple[list[Row], list[str]]:
    """The rows of one table, one a sample that it holds; and why samples are no work of the engine."""
    row = {"table": job.table, "sha256": job.digest, "settings": job.settings}
    try:
        samples = measurement.tables(job.table, job.how, apart=True)
    except Exception as error:
        return [row | {"flag": _reason(error)}], []
    out, reasons = [], list[str]()
    for sample, frame in samples.items():
        try:
            data = observations(frame, job.table, job.asked.u_rel, polarised=True)
            row["notes"] = " ".join(measurement.of_reader(frame))
            result, why = _fit(data, job)
            out.append(row | {"sample": sample} | _fitted(result))
            reasons += [why] if why else []
        except Exception as error:  # whatever is wrong with one table, the others go on
            out.append(row | {"sample": sample, "flag": _reason(error)})
    return out, reasons


def _fit(data: Observations, job: _Job) -> tuple[FitResult, str]:
    """The fit of a sample, and why it is no work of the engine where that is asked."""
    why = ""
    if job.by_engine:
        found = _by_engine(data, job)
        if isinstance(found, FitResult):
            return found, ""
        why = found
    return fit_table(data, job.asked, name=job.table)[0], why


def _by_engine(data: Observations, job: _Job) -> FitResult | str:
    if plugins.left_out("gonio.rooms", "maps"):
        return NO_ENGINE
    return fit_by(plugins.room("maps").solved, data, job.asked, name=job.table)


def _reason(error: Exception) -> str:
    kind = "" if isinstance(error, GonioError) else f"{type(error).__name__}: "
    return f"not fitted: {kind}{' '.join(str(error).split())}"


def _fitted(result: FitResult) -> Row:
    """What a row says of a fit; numbers in all their digits."""
    flags = ["rejected"] if result.rejected else []
    row = {"wavelength_nm": repr(float(result.wavelength_nm)), "n": str(len(result.data))}
    for name in result.free:
        one = result.parameters[name]
        row[name] = repr(float(one.value))
        row[f"u_{name}"] = "" if one.u is None else repr(float(one.u))
        flags += [f"at its {one.at_bound} bound: {name}"] if one.at_bound else []
        flags += [f"undetermined: {name}"] if one.u is None else []
    reduced, misfit = result.reduced_chi_square, result.misfit
    row["misfit"] = repr(float(misfit.tau)) if misfit is not None else "0.0" if reduced is not None else ""
    return row | {"chi_square": "" if reduced is None else repr(float(reduced)), "flag": "; ".join(flags)}
