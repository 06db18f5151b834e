"""Values into a rig file, with everything else in it, comments included, as it was."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gonio.config import parse, read_toml
from gonio.disk import write_whole
from gonio.errors import ConfigError, DataError
from gonio.rig.description import Axis, RigDescription

Values = Mapping[tuple[str, ...], Any]
"""By the path of a key, as ("arms", "light", "zero_offset_deg"); None takes a key out."""


def with_values(path: str | Path, values: Values) -> str:
    """The text of a rig file with some values changed.

    Raises
    ------
    ConfigError
        The file cannot be read, or would be no rig file with these values.
    """
    import tomlkit

    path = Path(path)
    read_toml(path)  # says in our words what is wrong with the file
    with path.open(encoding="utf-8-sig", newline="") as file:  # line endings stay too
        document = tomlkit.parse(file.read())
    for (*tables, key), value in values.items():
        table: Any = document
        for name in tables:
            if name not in table:
                table[name] = tomlkit.table()
            table = table[name]
        if value is not None:
            table[key] = value
        elif key in table:
            del table[key]
    parse(RigDescription, document.unwrap(), path)
    return tomlkit.dumps(document)


def zero_values(
    description: RigDescription, axis: str, *, read_deg: float, true_deg: float
) -> tuple[dict[tuple[str, ...], Any], float]:
    """What to write into a rig file so that an axis that reads one angle is said to stand at another one [deg].

    Returns
    -------
    values, offset
        For `write_values`; and the new zero offset [deg].
    """
    known = description.axes()[axis]
    taken_out = known.zero_offset_deg if known.zero_offset_known else 0.0
    offset = round(read_deg + taken_out - true_deg, 4)
    if axis in ("tilt", "spin"):
        table: tuple[str, ...] = ("holder",)
        key = f"{axis}_zero_offset_deg" if len(description.holder.axes) > 1 else "zero_offset_deg"
        if len(description.holder.axes) == 1:  # one of its own would go before the common one
            return {(*table, key): offset, (*table, f"{axis}_zero_offset_deg"): None} | _said(known, table), offset
    else:
        table, key = ("arms", axis), "zero_offset_deg"
    return {(*table, key): offset} | _said(known, table), offset


def _said(axis: Axis, table: tuple[str, ...]) -> dict[tuple[str, ...], Any]:
    """An offset that nobody knew is known now."""
    return {} if axis.zero_offset_known else {(*table, "zero_offset_known"): True}


def write_values(path: str | Path, values: Values, *, out: Path | None = None) -> Path | None:
    """Change values in a rig file itself, or write a changed copy to `out`.

    Returns
    -------
    Path or None
        Where the file as it was is kept; None for a copy.

    Raises
    ------
    ConfigError
        As `with_values`; or there is a file at `out`, or no folder for it.
    DataError
        It cannot be written.
    """
    path = Path(path)
    text = with_values(path, values)
    kept = None
    try:
        if out is None:
            kept = _free_name(path)
            write_whole(kept, path.read_bytes())
        elif out.exists():
            raise ConfigError(f"{out}: is there already; name another file")
        elif not out.absolute().parent.is_dir():
            raise ConfigError(f"{out}: there is no folder {out.parent}")
        write_whole(out or path.resolve(), text.encode())
    except OSError as error:
        raise DataError(f"{error.filename or path}: cannot be written: {error.strerror}") from None
    return kept


def _free_name(path: Path) -> Path:
    """my.toml.bak, or my.toml.bak2 and so on where that is taken."""
    name = path.with_name(f"{path.name}.bak")
    number = 1
    while name.exists():
        number += 1
        name = path.with_name(f"{path.name}.bak{number}")
    return name
