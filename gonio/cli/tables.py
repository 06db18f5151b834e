"""`gonio convert`."""

from __future__ import annotations

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
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write.", show_default=False)],
    source_format: Annotated[
        str | None,
        typer.Option("--from", help="Format of IN, where neither content nor ending tell.", show_default=False),
    ] = None,
    target_format: Annotated[
        str | None, typer.Option("--to", help="Format of OUT, where its ending does not tell.", show_default=False)
    ] = None,
    columns: Columns = None,
    blank: Blank = None,
) -> None:
    """Convert a measurement, or a model, to another file format. By file ending, or by a format's name."""
    from gonio import measurement
    from gonio.cli import console
    from gonio.errors import ConfigError

    how = reading(columns, blank)
    if source.endswith(".toml") and (columns, blank) != (None, None):
        raise ConfigError(f"{source}: is a model, which has no --{'blank' if columns is None else 'columns'}")
    if source.endswith(".toml"):
        from gonio import models
        from gonio.acquisition.measure import load_sample

        sample_file = load_sample(source)
        model = models.build(sample_file.model, sample_file.parameters)
        for remark in measurement.write_model(model, target, name=sample_file.name, format=target_format):
            console.note(remark)
        console.show(f"{target}: {sample_file.name}")
        return
    path, sample = measurement.split(source)
    table = measurement.read(path, format=source_format, sample=sample, columns=how.columns, blank=how.blank)
    for remark in measurement.write(table, target, format=target_format):
        console.note(remark)
    remember([source], how)
    console.show(f"{target}: {len(table)} values")
