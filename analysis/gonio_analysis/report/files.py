"""The folder of a report: what it holds, and all of it or nothing.

Among its files are the tables as CSV.
"""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import platform
from gonio.acquisition.run_folder import check_writable
from gonio.disk import MANIFEST, NOT_OWN, foreign_files, manifest_of, remove_own, require_name, write_manifest
from gonio.errors import ConfigError, os_error_as
from gonio.formats.text import cell_of
from gonio.shown import visible
from gonio.typing import Floats
from gonio_analysis.report import html, pdf, viewer
from gonio_analysis.report.comparison import VALUES, usable
from gonio_analysis.report.facts import DatasetSummary, Summary
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.compare import Dataset, Drawn

if TYPE_CHECKING:
    from gonio_analysis.report.blocks import Page
    from gonio_analysis.report.drawing import Figure

ROWS_AT_ONCE = 10_000


def write_tables(
    datasets: Sequence[Dataset], summary: Summary, views: Sequence[viewer.View | None], folder: Path
) -> list[str]:
    """Write parameters, metrics, curves, theory, profiles, and parameters over wavelength; the names of the files."""
    facts = summary.datasets
    write_csv(
        folder / "parameters.csv",
        ("sample", "model", "parameter", "value", "standard_error", "fixed", "at_bound"),
        (
            (s.name, m, n, p.value, p.u, p.fixed, p.at_bound or "")
            for s in facts
            for m, f in s.models.items()
            for n, p in f.fit.parameters.items()
        ),
    )
    names = list(summary.metrics)
    write_csv(
        folder / "metrics.csv",
        ("sample", "model", "points", "free_parameters", "reduced_chi_square", "p_value", *names, "n_log"),
        (
            (
                s.name,
                m,
                len(f.fit.data),
                len(f.fit.free),
                f.fit.reduced_chi_square,
                f.fit.p_value,
                *(f.metrics[n] for n in names),
                f.metrics["n_log"],
            )
            for s in facts
            for m, f in s.models.items()
        ),
    )
    files = ["parameters.csv", "metrics.csv"]
    for d, s, view in zip(datasets, facts, views, strict=True):
        files += _of_dataset(d, s.slug, folder)
        if s.values and s.usable_everywhere > len(s.values):
            files.append(f"{s.slug}-all-values.csv")
            rows = usable(d)
            write_columns(folder / files[-1], VALUES, [[rows[name].to_numpy() for name in VALUES]])
        if s.budget:
            files.append(f"{s.slug}-budget.csv")
            header = ("cause", "median_relative", "p95_relative")
            write_csv(folder / files[-1], header, ((b.cause, b.median, b.p95) for b in s.budget))
        if view is not None:
            files.append(f"{s.slug}-interactive.csv")
            write_csv(folder / files[-1], viewer.COLUMNS, viewer.rows(view))
        files += _of_choice(s, folder)
    return files


def _of_choice(s: DatasetSummary, folder: Path) -> list[str]:
    """Parameters over wavelength, and profiles of the model that is named; the names of the files."""
    tables: dict[str, tuple[Sequence[str], Iterable[Sequence[Any]]]] = {}
    if any(f.series for f in s.models.values()):
        tables[f"{s.slug}-wavelengths.csv"] = (
            ("model", "wavelength_nm", "points", "reduced_chi_square", "parameter", "value", "standard_error"),
            (
                (m, r.wavelength_nm, len(r.data), r.reduced_chi_square, n, p.value, p.u)
                for m, f in s.models.items()
                for r in f.series
                for n, p in r.parameters.items()
            ),
        )
    if s.choice.intervals and s.choice.named:
        named = s.choice.named.candidate.label
        tables[f"{s.slug}-profiles.csv"] = (
            ("model", "parameter", "value", "rise_of_chi_square"),
            (
                (named, n, value, rise)
                for n, i in s.choice.intervals.items()
                for value, rise in zip(i.values.tolist(), i.rise.tolist(), strict=True)
            ),
        )
    for name, (header, rows) in tables.items():
        write_csv(folder / name, header, rows)
    return list(tables)


def _of_dataset(d: Dataset, slug: str, folder: Path) -> list[str]:
    """Fitted values with every model's prediction, and the plotted curves."""
    data = d.data
    angles = [_degrees(x) for x in data.directions.angles]
    models, c = list(d.fitted), data.covariance
    values = [v for f in d.fitted.values() for v in (f.fit.predicted, f.fit.whitened)]
    write_columns(
        folder / f"{slug}-values.csv",
        (
            *("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "brdf", "u_brdf"),
            *(f"{m} {what}" for m in models for what in ("brdf", "whitened_residual")),
            *(("u_random", *(f"s_{cause}" for cause in c.causes)) if c is not None else ()),
        ),
        [[*angles, data.brdf, data.u, *values, *((c.random, *c.common.T) if c is not None else ())]],
    )
    header = ("model", "curve", "kind", "signed_angle_deg", "brdf", "u_brdf", "normalised", "u_normalised")
    parts = [part for m, f in d.fitted.items() for c in f.drawn for part in _of_drawn(m, c)]
    columns = [list(column) for column in zip(*parts, strict=True)] or [[] for _ in range(9)]
    write_columns(
        folder / f"{slug}-curves.csv",
        (*header, "normalised_by"),
        [[np.concatenate(column) if column else np.empty(0) for column in columns]],
    )
    return [f"{slug}-values.csv", f"{slug}-curves.csv"]


def _of_drawn(model: str, c: Drawn) -> list[list[Any]]:
    """The columns of a curve: measured values, and theory."""
    k, none = c.curve, np.full(c.theory.size, np.nan)
    measured, theory = c.norm.measured, c.norm.theory
    parts = [
        ("measured", k.angle, (k.brdf, k.u, k.brdf / measured, k.u / measured)),
        ("theory", c.theory_angle, (c.theory, none, c.theory / theory, none)),
    ]
    out: list[list[Any]] = []
    for kind, angle, values in parts:
        *words, by = (np.full(angle.size, word, dtype=object) for word in (model, c.label, kind, c.norm.kind))
        out.append([*words, _degrees(angle), *values, by])
    return out


def _degrees(angle: Floats) -> Floats:
    """Radians in degrees, without the rounding of the way there and back."""
    return np.asarray(np.round(np.degrees(angle), 10))


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV in which None and NaN are empty cells, floats keep every digit, and no text is a spreadsheet's formula."""
    path.parent.mkdir(exist_ok=True)
    with open(path, "w", encoding="utf-8", newline="") as stream:
        out = csv.writer(stream, lineterminator="\n")
        out.writerow(header)
        out.writerows([_cell(cell) for cell in row] for row in rows)


def write_columns(path: Path, header: Sequence[str], pieces: Iterable[Sequence[Any]]) -> None:
    """The same from the columns of pieces of a table: numbers of 64 bits, or words. A million rows take seconds."""
    path.parent.mkdir(exist_ok=True)
    with open(path, "w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(header)
        for columns in pieces:
            for begin in range(0, len(columns[0]), ROWS_AT_ONCE):
                part = [_words(column[begin : begin + ROWS_AT_ONCE]) for column in columns]
                stream.writelines(map(",".join, ((*row[:-1], row[-1] + "\n") for row in zip(*part, strict=True))))


def _words(column: Any) -> list[str]:
    if column.dtype.kind == "f":
        words = list(map(repr, column.tolist()))
        for k in np.flatnonzero(np.isnan(column)):
            words[k] = ""
        return words
    quoted = {word: _quoted(str(word)) for word in set(column.tolist())}
    return [quoted[word] for word in column.tolist()]


def _quoted(word: str) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow([word])
    return line.getvalue()


def _cell(value: object) -> object:
    if value is None:
        return ""
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return cell_of(visible(value)) if isinstance(value, str) else value


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a write that name no file."""


@dataclass(frozen=True)
class Staged:
    """A folder in the making."""

    work: Path
    """Where to write now."""
    final: Path
    """Where it will be."""


@contextmanager
def staged(folder: str | Path) -> Iterator[Staged]:
    """A temporary folder beside `folder` that takes its place when the block ends, and vanishes when the block fails.

    An earlier report in `folder` is replaced where nothing else lies there and no file of it was changed since, as its
    manifest tells (`gonio.disk`). What a killed process had begun beside it is tidied up.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that this program did not write.
    """
    shown = Path(folder)
    require_name(shown)
    final = shown.resolve()  # where the folder is a link its target is replaced, and the link stays
    _check(final, shown)
    made: list[Path] = []
    try:
        for parent in reversed([final.parent, *final.parent.parents]):
            if not parent.exists():
                parent.mkdir()
                made.append(parent)
        _tidy(final)
        work = _beside(final, "part")
    except OSError as error:
        _remove(made)
        raise ConfigError(f"{shown}: cannot be written: {error.strerror}") from None
    try:
        mask = os.umask(0)  # it is read by being set
        os.umask(mask)
        work.chmod(0o777 & ~mask)
        write_manifest(work, {})
        yield Staged(work, final)
        write_manifest(work, manifest_of(work))
        _check(final, shown)  # once more: somebody may have put something there meanwhile
        _put(work, final)
    except BaseException as error:
        shutil.rmtree(work, ignore_errors=True)
        _remove(made)
        if isinstance(error, OSError) and (error.errno in FULL or str(work.parent) in str(error.filename)):
            raise ConfigError(f"{shown}: cannot be written: {error.strerror}") from None
        raise


def require(folder: str | Path) -> None:
    """Raise the `ConfigError` of `staged` where a folder takes no report, before the work that it would be of."""
    shown = Path(folder)
    require_name(shown)
    _check(shown.resolve(), shown)
    check_writable(shown.parent)


def write(folder: Path, summary: object, figures: Iterable[Figure] = ()) -> None:
    """Write `summary.json` and the drawings (`figures/`, as SVG and PNG) into a folder that exists."""
    for figure in figures:
        drawn = folder / "figures"
        drawn.mkdir(exist_ok=True)
        (drawn / f"{figure.name}.svg").write_text(figure.svg, encoding="utf-8", newline="\n")
        (drawn / f"{figure.name}.png").write_bytes(figure.png)
    text = json.dumps(as_json(summary), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def write_page(
    folder: Path, page: Page, summary: object, figures: Iterable[Figure] = (), *, printed: bool = False
) -> None:
    """Write `index.html`, and with it what `write` writes; `printed` as `report.pdf`, too."""
    write(folder, summary, figures)
    (folder / "index.html").write_text(html.document(page), encoding="utf-8", newline="\n")
    if printed:
        pdf.write(folder / "report.pdf", [page])


def _check(final: Path, shown: Path) -> None:
    with os_error_as(ConfigError, f"{shown}: cannot be read"):
        if final.is_dir():
            foreign = foreign_files(final, {})
            if foreign:
                names = ", ".join(foreign[:5]) + (" ..." if len(foreign) > 5 else "")
                raise ConfigError(
                    f"{shown}: holds what {NOT_OWN} ({names}), and is not replaced; move it away, or choose another "
                    "folder with --out"
                )
        elif os.path.lexists(final):
            raise ConfigError(f"{shown}: is a file; --out names a folder")


def _put(work: Path, final: Path) -> None:
    if not final.exists():
        os.rename(work, final)
        return
    old = _beside(final, "old")
    try:
        os.rename(final, old / "report")
        try:
            os.rename(work, final)
        except OSError:
            os.rename(old / "report", final)
            raise
    finally:
        _discard(old)


def _discard(old: Path) -> None:
    """Remove an earlier report that was moved aside; what is not our own in it stays where it is then."""
    with suppress(OSError):
        if (old / "report").is_dir():
            remove_own(old / "report", {})
        old.rmdir()


def _beside(final: Path, what: str) -> Path:
    """A new hidden folder beside the report, whose name tells the process that made it."""
    return Path(tempfile.mkdtemp(prefix=f".{final.name}.{os.getpid()}.", suffix=f".{what}", dir=final.parent))


def _tidy(final: Path) -> None:
    """Remove the hidden folders of processes that died; a report that one had moved aside comes back."""
    for left in final.parent.iterdir():
        found = re.fullmatch(rf"\.{re.escape(final.name)}\.(\d+)\.\w+\.(part|old)", left.name)
        if found is None or platform.is_alive(int(found[1])):
            continue
        if left.is_symlink() or not left.is_dir():
            continue
        if (left / "report").is_dir() and not final.exists():
            os.rename(left / "report", final)
        if found[2] == "part" and (left / MANIFEST).is_file():
            shutil.rmtree(left, ignore_errors=True)
        else:
            _discard(left)


def _remove(folders: list[Path]) -> None:
    for folder in reversed(folders):
        folder.rmdir()
