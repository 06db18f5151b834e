"""The folder of a report: what it holds, and all of it or nothing.

Among its files are the tables as CSV.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gonio import lost, platform
from gonio.disk import (
    MANIFEST,
    NOT_OWN,
    check_writable,
    foreign_files,
    manifest_of,
    remove_own,
    require_name,
    write_manifest,
)
from gonio.errors import ConfigError, os_error_as
from gonio.formats.text import cell_of
from gonio.shown import visible
from gonio.typing import Floats, JsonObject
from gonio_analysis.report import html, viewer
from gonio_analysis.report.blocks import Page, titled, with_notice
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.facts import VALUES, DatasetSummary, Summary
from gonio_analysis.result_records import as_json
from gonio_analysis.selection.compare import DrawnCurve

ROWS_AT_ONCE = 10_000


def write_tables(summary: Summary, views: Sequence[viewer.ViewerData | None], folder: Path) -> list[str]:
    """Write parameters, metrics, curves, theory, profiles, and parameters over wavelength; the names of the files."""
    files = [*written(folder / "parameters.csv", partial(_parameters, summary))]
    files += written(folder / "metrics.csv", partial(_metrics, summary))
    for s, view in zip(summary.datasets, views, strict=True):
        files += written(folder / f"{s.slug}-values.csv", partial(_values, s))
        files += written(folder / f"{s.slug}-curves.csv", partial(_curves, s))
        if s.values and len(s.usable) > len(s.values):
            files += written(folder / f"{s.slug}-all-values.csv", partial(_all_values, s))
        if s.budget:
            files += written(folder / f"{s.slug}-budget.csv", partial(_budget, s))
        if view is not None:
            files += written(folder / f"{s.slug}-interactive.csv", partial(_interactive, view))
        if any(f.series for f in s.models.values()):
            files += written(folder / f"{s.slug}-wavelengths.csv", partial(_wavelengths, s))
        if s.choice.intervals and s.choice.named:
            files += written(folder / f"{s.slug}-profiles.csv", partial(_profiles, s))
    return files


def written(path: Path, write: Callable[[Path], object]) -> list[str]:
    """The name of a table that is written, as a list; an empty one where it fails while a page is made."""

    def make() -> list[str]:
        write(path)
        return [path.name]

    def instead(loss: lost.Loss) -> list[str]:
        path.unlink(missing_ok=True)
        return []

    within = "tables/" if path.parent.name == "tables" else ""
    return lost.kept(f"{within}{path.name}", make, instead)


def _parameters(summary: Summary, path: Path) -> None:
    write_csv(
        path,
        ("sample", "model", "parameter", "value", "standard_error", "fixed", "at_bound"),
        (
            (s.name, m, n, p.value, p.u, p.fixed, p.at_bound or "")
            for s in summary.datasets
            for m, f in s.models.items()
            for n, p in f.fit.parameters.items()
        ),
    )


def _metrics(summary: Summary, path: Path) -> None:
    names = list(summary.metrics)
    write_csv(
        path,
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
            for s in summary.datasets
            for m, f in s.models.items()
        ),
    )


def _all_values(d: DatasetSummary, path: Path) -> None:
    write_columns(path, VALUES, [[d.usable[name].to_numpy() for name in VALUES]])


def _budget(s: DatasetSummary, path: Path) -> None:
    write_csv(path, ("cause", "median_relative", "p95_relative"), ((b.cause, b.median, b.p95) for b in s.budget))


def _interactive(view: viewer.ViewerData, path: Path) -> None:
    write_csv(path, viewer.COLUMNS, viewer.rows(view))


def _wavelengths(s: DatasetSummary, path: Path) -> None:
    """Parameters over wavelength."""
    write_csv(
        path,
        ("model", "wavelength_nm", "points", "reduced_chi_square", "parameter", "value", "standard_error"),
        (
            (m, r.wavelength_nm, len(r.data), r.reduced_chi_square, n, p.value, p.u)
            for m, f in s.models.items()
            for r in f.series
            for n, p in r.parameters.items()
        ),
    )


def _profiles(s: DatasetSummary, path: Path) -> None:
    """Profiles of the model that is named."""
    assert s.choice.named is not None
    named = s.choice.named.candidate.label
    write_csv(
        path,
        ("model", "parameter", "value", "rise_of_chi_square"),
        (
            (named, n, value, rise)
            for n, i in s.choice.intervals.items()
            for value, rise in zip(i.values.tolist(), i.rise.tolist(), strict=True)
        ),
    )


def _values(d: DatasetSummary, path: Path) -> None:
    """Fitted values with every model's prediction."""
    data = d.every_state
    angles = [_degrees(x) for x in data.directions.angles]
    states = {"polarisation": data.states} if data.states.size else {}
    models, c = list(d.models), data.covariance
    values = [v for f in d.models.values() for v in (f.fit.predicted, f.fit.whitened)]
    write_columns(
        path,
        (
            *("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", *states, "brdf", "u_brdf"),
            *(f"{m} {what}" for m in models for what in ("brdf", "whitened_residual")),
            *(("u_random", *(f"s_{cause}" for cause in c.causes)) if c is not None else ()),
        ),
        [[*angles, *states.values(), data.brdf, data.u, *values, *((c.random, *c.common.T) if c is not None else ())]],
    )


def _curves(d: DatasetSummary, path: Path) -> None:
    """The plotted curves."""
    header = ("model", "curve", "kind", "signed_angle_deg", "brdf", "u_brdf", "normalised", "u_normalised")
    parts = [part for m, f in d.models.items() for c in f.drawn for part in _of_drawn(m, c)]
    columns = [list(column) for column in zip(*parts, strict=True)] or [[] for _ in range(9)]
    write_columns(
        path,
        (*header, "normalised_by"),
        [[np.concatenate(column) if column else np.empty(0) for column in columns]],
    )


def _of_drawn(model: str, c: DrawnCurve) -> list[list[Any]]:
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


@dataclass(frozen=True)
class StagedFolder:
    """A folder in the making."""

    work: Path
    """Where to write now."""
    final: Path
    """Where it will be."""


@contextmanager
def staged(folder: str | Path) -> Iterator[StagedFolder]:
    """A temporary folder beside `folder` that takes its place when the block ends, and vanishes when the block fails.

    An earlier report in `folder` is replaced where nothing else lies there and no file of it was changed since, as its
    manifest tells (`gonio.disk`). What a killed process had begun beside it is tidied up.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that this program did not write.
    Incomplete
        All is written, but for parts that could not be made (`gonio.lost`).
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
        with lost.collecting() as losses:
            yield StagedFolder(work, final)
        write_manifest(work, manifest_of(work))
        _check(final, shown)  # once more: somebody may have put something there meanwhile
        _put(work, final)
    except BaseException as error:
        shutil.rmtree(work, ignore_errors=True)
        _remove(made)
        if isinstance(error, OSError) and (error.errno in lost.FULL or str(work.parent) in str(error.filename)):
            raise ConfigError(f"{shown}: cannot be written: {error.strerror}") from None
        raise
    if losses:
        raise lost.incomplete(shown / "index.html", losses)


def require(folder: str | Path) -> None:
    """Raise the `ConfigError` of `staged` where a folder takes no report, before the work that it would be of."""
    shown = Path(folder)
    require_name(shown)
    _check(shown.resolve(), shown)
    check_writable(shown.parent)


def write_pages(folder: Path, pages: Mapping[str, Page], summary: object, figures: Iterable[Figure] = ()) -> None:
    """Write pages by the name of their file, `summary.json`, and the drawings as they come (`figures/`).

    What fails is named on the pages, which therefore come last, and in `summary.json`.
    """
    for figure in figures:
        if not figure.failed:
            lost.kept(f'files of figure "{figure.name}"', partial(_write_figure, folder, figure), lambda loss: None)
    content = lost.kept("summary.json", partial(plain, summary), lambda loss: {})
    for name, page in pages.items():
        (folder / name).write_bytes(encoded(name, page))
    (folder / "summary.json").write_bytes(as_text(content))


def _write_figure(folder: Path, figure: Figure) -> None:
    drawn = folder / "figures"
    drawn.mkdir(exist_ok=True)
    (drawn / f"{figure.name}.svg").write_text(figure.svg, encoding="utf-8", newline="\n")
    if figure.png:
        (drawn / f"{figure.name}.png").write_bytes(figure.png)


def plain(summary: object) -> JsonObject:
    """What JSON can hold of a summary; an error where it cannot hold all of it."""
    content: JsonObject = as_json(summary)
    _encoded_json(content)
    return content


def as_text(content: JsonObject) -> bytes:
    """The numbers of a page (`plain`) as a file of JSON, with what the page has lost."""
    failed = lost.so_far()
    return _encoded_json(content | {"failed": as_json(failed)} if failed else content)


def _encoded_json(content: JsonObject) -> bytes:
    return (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def encoded(name: str, page: Page) -> bytes:
    """A page as the file of this name, with what it has lost; where it cannot be written, its title and that."""
    made = lost.kept(f"the page {name}", partial(_encoded, page), lambda loss: None)
    return _encoded(titled(page.title)) if made is None else made


def _encoded(page: Page) -> bytes:
    return html.document(with_notice(page)).encode()


def drawn_and_said(
    title: str, draw: Callable[[], Sequence[Figure]], render: Callable[[Sequence[Figure]], Page]
) -> tuple[Sequence[Figure], Page]:
    """The figures of a page, and the page with them, as far as they can be made."""
    figures = lost.kept("figures", draw, lambda loss: ())
    return figures, lost.kept("the page", lambda: render(figures), lambda loss: titled(title))


def write_page(
    folder: Path,
    title: str,
    render: Callable[[Sequence[Figure]], Page],
    summary: Callable[[Sequence[Figure]], object],
    draw: Callable[[], Sequence[Figure]] = tuple,
) -> None:
    """Write `index.html`, and what `write_pages` writes: page and summary are made with the figures of `draw`."""
    figures, page = drawn_and_said(title, draw, render)
    write_pages(folder, {"index.html": page}, summary(figures), figures)


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
