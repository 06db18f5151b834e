"""`gonio convert`."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated

import typer

from gonio.cli.options import Blank, Columns, reading, remember


def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="IN", help="A measurement file, a run, FILE:SAMPLE, or a model: sample.toml.", show_default=False
        ),
    ],
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="The file to write; - for standard output.", show_default=False),
    ],
    source_format: Annotated[
        str | None,
        typer.Option("--from", help="Format of IN, where neither content nor ending tell.", show_default=False),
    ] = None,
    target_format: Annotated[
        str | None,
        typer.Option(
            "--to",
            help="Format of OUT, where its ending does not tell; mitsuba, radiance, gltf or principled (Blender); "
            "datacite; of a run bluesky.",
            show_default=False,
        ),
    ] = None,
    columns: Columns = None,
    blank: Blank = None,
    wavelength_nm: Annotated[
        float | None,
        typer.Option(help="For a renderer: this wavelength of a table alone, in grey.", show_default=False),
    ] = None,
) -> None:
    """Convert a measurement, or a model, to another file format. By file ending, or by a format's name."""
    from gonio import measurement, plugins
    from gonio.cli import console
    from gonio.errors import ConfigError

    if target.is_dir():
        raise ConfigError(f"{target}: is a folder; name the file to write in it, as {target / 'table.csv'}")
    how = reading(columns, blank)
    exports = plugins.available("gonio.exports")
    if target_format is not None:
        known = _known()
        if target_format in known and target_format in exports:
            console.note(
                f"--to {target_format} is the format of that name; an export that is installed under it too "
                f"({exports[target_format].value}) is passed over, and needs another name"
            )
        elif target_format in exports:
            _export(source, target, target_format, source_format or columns or blank or wavelength_nm)
            return
        elif target_format not in known:
            raise ConfigError(_unknown(target_format, known, list(exports)))
    to: str | None = "gltf" if target_format is None and target.suffix.lower() in (".gltf", ".glb") else target_format
    is_model = source.endswith(".toml")
    if is_model and to == "datacite":
        raise ConfigError(f"{source}: is a model; --to datacite takes a run, or its table")
    if is_model and (columns, blank) != (None, None):
        raise ConfigError(f"{source}: is a model, which has no --{'blank' if columns is None else 'columns'}")
    if wavelength_nm is not None and (is_model or to not in _RENDERERS):
        raise ConfigError(
            f"--wavelength-nm {wavelength_nm:g}: goes with a table and --to {', '.join(_RENDERERS)}; leave it out"
        )
    if is_model:
        from gonio import models
        from gonio.acquisition.measure import load_sample

        sample_file = load_sample(source)
        model = models.build(sample_file.model, sample_file.parameters)
        if to in _TRANSLATED:
            from gonio.renderers import translation

            remarks = translation.write(translation.of_model(model, sample_file.name), target, to)
        else:
            plain = _MODEL_FORMATS.get(to, to) if to else None
            remarks = measurement.write_model(model, target, name=sample_file.name, format=plain)
        for remark in remarks:
            console.note(remark)
        _done(target, sample_file.name)
        return
    path, sample = measurement.split(source)
    table = measurement.read(path, format=source_format, sample=sample, columns=how.columns, blank=how.blank)
    if to in _RENDERERS:
        from gonio.renderers import channels, measured, translation

        rows = channels.rows(table, sample or table.attrs.get("sample") or Path(path).stem, wavelength_nm=wavelength_nm)
        if to in _TRANSLATED:
            remarks = translation.write(translation.of_rows(rows), target, to)
        else:
            remarks = measured.write(rows, target, to)
    elif to == "datacite":
        from gonio.formats import datacite

        remarks = datacite.write(table, target)
    else:
        remarks = measurement.write(table, target, format=to)
    for remark in remarks:
        console.note(remark)
    remember([source], how)
    _done(target, f"{len(table)} values")


def _export(source: str, target: Path, name: str, more: object) -> None:
    """A whole run, as an entry point of the group `gonio.exports` writes it."""
    from gonio import plugins
    from gonio.cli import console
    from gonio.errors import ConfigError

    if more is not None or not Path(source).is_dir():
        what = "goes with --to alone" if more is not None else "is no folder"
        raise ConfigError(f"{source}: {what}; --to {name} takes a run as `gonio measure` has written it")
    *remarks, done = plugins.load("gonio.exports", name)(source, target)
    for remark in remarks:
        console.note(remark)
    _done(target, done)


def _done(target: Path, what: str) -> None:
    """Say what was written, and where; beside standard output, where that has the data."""
    from gonio.cli import console
    from gonio.disk import STDOUT

    (console.note if str(target) == STDOUT else console.show)(f"{target}: {what}")


def _known() -> list[str]:
    """Every word of --to that is no export: formats, those that are only read too, renderers, and DataCite."""
    from gonio import formats

    return [*formats.names(), *_RENDERERS, "datacite"]


def _unknown(name: str, known: list[str], exports: list[str]) -> str:
    """What is said of a word of --to that is none."""
    from gonio import formats

    written = formats.names(written=True)
    near = difflib.get_close_matches(name, [*known, *exports], n=1)
    return (
        f"--to {name}: there is no such format{f', did you mean {near[0]}?' if near else '.'} "
        f"There are {', '.join([*written, 'datacite'])}; for renderers {', '.join(_RENDERERS)}"
        + (f"; of a whole run {', '.join(exports)}" if exports else "")
    )


_TRANSLATED = ("gltf", "principled")
_MODEL_FORMATS = {"mitsuba": "rgl", "radiance": "klems"}
_RENDERERS = (*_MODEL_FORMATS, *_TRANSLATED)
