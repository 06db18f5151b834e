"""`gonio convert`."""

from __future__ import annotations

import contextlib
import difflib
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio import plugins
from gonio.cli import console
from gonio.cli.options import Columns, reading, remember
from gonio.disk import STDOUT, check_writable, is_stream, read_file
from gonio.errors import ConfigError, DataError, GonioError, os_error_as

if TYPE_CHECKING:
    import pandas as pd
    from rich.table import Table


def convert(
    source: Annotated[str, typer.Argument(
        metavar="IN", help="A measurement file, a run, FILE:SAMPLE, a model: sample.toml, or a map of fits.")],
    target: Annotated[Path | None, typer.Argument(
        metavar="OUT", help="The file to write; - for standard output; for textures a folder.")] = None,
    source_format: Annotated[str | None, typer.Option(
        "--from", help="Format of IN, where neither content nor ending tell.")] = None,
    target_format: Annotated[str | None, typer.Option(
        "--to", help="Format of OUT, where its ending does not tell; mitsuba or radiance; datacite; of a run bluesky;"
        " of a map textures.")] = None,
    columns: Columns = None,
    wavelength_nm: Annotated[float | None, typer.Option(
        help="For a renderer: this wavelength of a table alone, in grey.")] = None,
    ask: Annotated[bool, typer.Option(
        "--ask", help="Propose --columns for a table of one's own, and show how it would be read."
    )] = False,
) -> None:  # fmt: skip
    """Convert a measurement, or a model, to another file format. By file ending, or by a format's name."""
    from gonio import formats, measurement, plugins

    if ask:
        _ask(Path(measurement.split(source)[0]), columns)
        return
    if target is None:
        raise ConfigError(f"{source}: name the file to write after it, as {Path(source).stem}-brdf.csv; or add --ask")
    if target_format == _TEXTURES:
        _textures(source, target, source_format or columns or wavelength_nm)
        return
    for said in formats.left_out():
        console.note(said)
    original = Path(measurement.split(source)[0])
    _require_place(target, original)
    how = reading(columns)
    exports = plugins.available("gonio.exports")
    if target_format is not None:
        known = _known()
        if target_format in known and target_format in exports:
            console.note(
                f"--to {target_format} is the format of that name; an export that is installed under it too "
                f"({exports[target_format].value}) is passed over, and needs another name"
            )
        elif target_format in exports:
            _export(source, target, target_format, source_format or columns or wavelength_nm)
            return
        elif target_format not in known:
            missing = plugins.left_out("gonio.exports", target_format)
            raise ConfigError(missing or _unknown(target_format, known, list(exports)))
    if source.endswith(".toml"):
        for name, given in (("columns", columns), ("wavelength-nm", wavelength_nm)):
            if given is not None:
                raise ConfigError(f"{source}: is a model, which has no --{name}")
        remarks, done = _model(source, target, target_format)
    elif wavelength_nm is not None and target_format not in _RENDERERS:
        raise ConfigError(
            f"--wavelength-nm {wavelength_nm:g}: goes with a table and --to {', '.join(_RENDERERS)}; leave it out"
        )
    else:
        if target_format not in (*_RENDERERS, "datacite") and original.exists():
            measurement.written_as(target, target_format)
        path, sample = measurement.split(source)
        table = measurement.read(path, format=source_format, sample=sample, columns=how.columns)
        for note in measurement.of_reader(table):
            console.note(note)
        remarks, done = _table(
            table, target, target_format, sample or table.attrs.get("sample") or Path(path).stem, wavelength_nm
        )
    for remark in remarks:
        console.note(remark)
    remember([source], how)
    _done(target, done)


def _ask(path: Path, columns: str | None) -> None:
    """Say what the columns of a table may be and why, and the first rows as they would be read."""
    from gonio import measurement
    from gonio.formats import own_pairs

    with os_error_as(ConfigError, f"{path}: cannot be read"):
        data = read_file(path)
    found, read_so = measurement.proposed(data, path, own_pairs.pairs(columns) if columns else None)
    if found is None:
        raise DataError(f"{path}: no table is seen in it: no line of names or numbers, with rows as long as it")
    for reason in found.reasons:
        console.show(reason)
    if isinstance(read_so, GonioError):
        console.show(f"So it is not read: {read_so}")
    elif read_so is not None:
        console.show(f"{len(read_so)} rows; the first:", _first_rows(read_so))
        for note in measurement.of_reader(read_so):
            console.note(note)
    unknown = "" if found.whole else " (in place of NAME a column, or a number for all rows)"
    print(f"{found.line(path)}{unknown}", flush=True)  # on one line, to copy
    beside = own_pairs.beside_path(path)
    if read_so is None or isinstance(read_so, GonioError) or not (sys.stdin.isatty() and sys.stdout.isatty()):
        return
    if typer.confirm(f"Write {beside}, so that every command reads it so?"):
        console.note(own_pairs.remember(path, own_pairs.pairs(found.text)) or f"{beside} is there, and stays")


def _first_rows(table: pd.DataFrame) -> Table:
    from gonio.measurement import COLUMNS

    shown = [name for name in (*COLUMNS, "sample", "side") if name in table.columns and name != "flag"]
    out = console.table(*shown)
    for row in table[shown].head(5).itertuples(index=False):
        out.add_row(*(f"{value:.6g}" if isinstance(value, float) else str(value) for value in row))
    return out


def _require_place(target: Path, original: Path) -> None:
    """Raise `ConfigError` where nothing can be written to the target, or it is what is read."""
    if target.is_dir():
        raise ConfigError(f"{target}: is a folder; name the file to write in it, as {target / 'table.csv'}")
    if target.is_file() and original.exists() and target.samefile(original):
        raise ConfigError(f"{target}: is the file that is converted, and is not replaced; name another")
    if not is_stream(target):
        check_writable(target.parent)


def _model(source: str, target: Path, to: str | None) -> tuple[list[str], str]:
    """Write a model; remarks, and what was written."""
    from gonio import measurement
    from gonio.samples.files import load_model

    if to == "datacite":
        raise ConfigError(f"{source}: is a model; --to datacite takes a run, or its table")
    model, given = load_model(source)
    plain = _RENDERERS.get(to, to) if to else None
    exchanged = to == "mitsuba"  # its first direction is the viewer's
    return measurement.write_model(model, target, name=given.name, format=plain, exchanged=exchanged), given.name


def _table(
    table: pd.DataFrame, target: Path, to: str | None, name: str, wavelength_nm: float | None
) -> tuple[list[str], str]:
    """Write a measurement; remarks, and what was written."""
    from gonio import measurement

    if to in _RENDERERS:
        from gonio.renderers import channels, measured

        taken = table if "sample" in table.columns else measurement.unpolarised(table)
        remarks = measured.write(channels.rows(taken, name, wavelength_nm=wavelength_nm), target, to)
    elif to == "datacite":
        from gonio.formats import datacite

        remarks = datacite.write(table, target)
    else:
        remarks = measurement.write(table, target, format=to)
    return remarks, f"{len(table)} values"


def _export(source: str, target: Path, name: str, more: object) -> None:
    """A whole run, as an entry point of the group `gonio.exports` writes it."""

    if more is not None or not Path(source).is_dir():
        what = "goes with --to alone" if more is not None else "is no folder"
        raise ConfigError(f"{source}: {what}; --to {name} takes a run as `gonio measure` has written it")
    *remarks, done = _exported(plugins.load("gonio.exports", name), source, target, name)
    for remark in remarks:
        console.note(remark)
    _done(target, done)


def _exported(write: Any, source: str, target: Path, name: str) -> list[str]:
    """What an export says; one that fails leaves the place as it was."""

    with _as_it_was(target), plugins.blamed(f"{source}: the export --to {name}"):
        said = [str(line) for line in write(source, target)]
        if not said:
            raise ValueError("it does not say what it has written")
        return said


@contextlib.contextmanager
def _as_it_was(target: Path) -> Iterator[None]:
    """Where the block fails, what it had begun there goes, and a file that it had replaced comes back."""
    if is_stream(target) or target.is_dir():
        yield
        return
    before = target.with_name(f".{target.name}.{os.getpid()}.before") if target.is_file() else None
    if before is not None:
        shutil.copy2(target, before)
    try:
        yield
    except BaseException:
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target, ignore_errors=True)
        if before is not None:
            os.replace(before, target)
        else:
            target.unlink(missing_ok=True)
        raise
    if before is not None:
        before.unlink()


def _textures(source: str, target: Path, more: object) -> None:
    """A map of fits as textures for renderers."""
    from gonio.hdf5 import is_map

    if more is not None or not is_map(source):
        what = "goes with --to alone" if more is not None else "is no map"
        raise ConfigError(f"{source}: {what}; --to {_TEXTURES} takes a map of fits (.h5), and writes a folder")
    *remarks, done = plugins.room("maps").textures(source, target)
    for remark in remarks:
        console.note(remark)
    _done(target, done)


def _done(target: Path, what: str) -> None:
    """Say what was written, and where; beside standard output, where that has the data."""
    (console.note if str(target) == STDOUT else console.show)(f"{target}: {what}")


def _known() -> list[str]:
    """Every word of --to that is no export: formats, those that are only read too, renderers, and DataCite."""
    from gonio import formats

    return [*formats.names(), *_RENDERERS, "datacite", _TEXTURES]


def _unknown(name: str, known: list[str], exports: list[str]) -> str:
    """What is said of a word of --to that is none."""
    from gonio import formats

    written = formats.names(written=True)
    near = difflib.get_close_matches(name, [*known, *exports], n=1)
    return (
        f"--to {name}: there is no such format{f', did you mean {near[0]}?' if near else '.'} "
        f"There are {', '.join([*written, 'datacite'])}; for renderers {', '.join(_RENDERERS)}"
        + f"; of a map of fits {_TEXTURES}"
        + (f"; of a whole run {', '.join(exports)}" if exports else "")
    )


_TEXTURES = "textures"
"""Folder for the textures of maps of fits."""
_RENDERERS = {"mitsuba": "rgl", "radiance": "klems"}
"""What writes tables for a renderer -> the format that writes models for it."""
