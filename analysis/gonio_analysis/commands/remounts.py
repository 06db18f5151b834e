"""`gonio remounts`."""

import json
from io import BytesIO
from pathlib import Path
from typing import Annotated

import typer

from gonio import canvas
from gonio.cli.options import Columns, reading, remember


def remounts(
    mounts: Annotated[list[str], typer.Argument(metavar="A B [...]", help="Tables of one sample, one a mount.")],
    add_to: Annotated[
        str | None, typer.Option(metavar="TABLE", help="Put what they show into the budget of this table.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="With --add-to: the table to write.")] = None,
    wavelength_nm: Annotated[float | None, typer.Option(help="Of tables with several wavelengths.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the deviations: a .png, .svg or .pdf.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    columns: Columns = None,
) -> None:
    """What an instrument repeats to when a sample is mounted again: scale, zero of the angle, and the rest."""
    from gonio import measurement
    from gonio.cli import console
    from gonio.disk import put
    from gonio.errors import ConfigError
    from gonio_analysis.changes import remounts as scatter
    from gonio_analysis.fitting.observations import check_wavelength

    if len(set(mounts)) < 2:
        raise ConfigError("gonio remounts: two tables are needed at least, each named once")
    if (add_to is None) != (out is None):
        raise ConfigError("--add-to and --out go together: the table that is read, and the one that is written")
    check_wavelength(wavelength_nm)
    how = reading(columns)
    tables = {}
    for one in dict.fromkeys(mounts):
        path, sample = measurement.split(one)
        name = Path(path).stem if Path(path).stem not in tables else one
        tables[name] = measurement.read(path, sample=sample, columns=how.columns)
    for note in measurement.said_once({name: measurement.of_reader(table) for name, table in tables.items()}):
        console.note(note)
    found = scatter.remounts(tables, wavelength_nm)
    if as_json:
        print(json.dumps(found.to_json(), indent=1))
    else:
        console.show(*found.lines())
    if picture is not None:
        drawn = BytesIO()
        try:
            kind = picture.suffix.removeprefix(".") or "png"
            canvas.save(scatter.draw(found), drawn, format=kind, dpi=150)
        except ValueError as error:
            raise ConfigError(f"--picture {picture}: cannot be written: {error}") from None
        put(picture, drawn.getvalue())
    if add_to is not None and out is not None:
        path, sample = measurement.split(add_to)
        table = measurement.read(path, sample=sample, columns=how.columns)
        for remark in measurement.write(scatter.with_remount(table, found), out):
            console.note(remark)
        console.note(f"{out}: written, with the scatter of {len(tables)} mounts in its budget")
    remember(mounts, how)
