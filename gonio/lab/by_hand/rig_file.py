"""Values into a rig file, with everything else in it, comments included, as it was."""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gonio.config import parse, read_toml
from gonio.disk import write_whole
from gonio.errors import ConfigError, DataError, DeviceError, GonioError
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.rig import Health
from gonio.lab.rig.description import RigDescription

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


@dataclass(frozen=True, slots=True)
class Zero:
    """The zero of an axis as a person gives it: what to write into the rig file, and what to report."""

    axis: str
    read_deg: float
    """What the axis reads where it stands at `true_deg`."""
    true_deg: float
    offset_deg: float
    """The new zero offset."""
    values: dict[tuple[str, ...], Any]
    """For `write_values`."""
    remark: str
    """What else has to be set; "" for nothing."""

    def __str__(self) -> str:
        return (
            f"{self.axis} reads {self.read_deg:.3f} deg and stands at {self.true_deg:g} deg: zero_offset_deg = "
            f"{self.offset_deg:.3f}"
        )


def read_zero(
    manual: ManualRig, axis: str, true_deg: float, read: Callable[[], Health],
    unclear: type[GonioError] = DeviceError, hint: str = "",
) -> Zero:  # fmt: skip
    """The zero of an axis that stands at an angle now; `read` asks the devices.

    Raises
    ------
    ConfigError
        There is no such axis.
    unclear
        Its angle is not known; or its readings at rest lie apart, which is said with `hint`.
    """
    limits = manual.description.limits_deg()
    manual.check({axis: 0.5 * math.radians(sum(limits.get(axis, (0.0, 0.0))))})
    health = read()
    read_deg = health.of(axis, "angle")
    if not isinstance(read_deg, float):
        raise unclear(f"axis {axis}: {health.silent.get(axis, 'its angle is not known')}")
    if isinstance(apart := health.of(axis, "angle_spread"), float):
        raise unclear(f"axis {axis}: its readings at rest lie {apart:.2f} deg apart, and tell no zero{hint}")
    values, offset = zero_values(manual.description, axis, read_deg=read_deg, true_deg=true_deg)
    others = [name for name in manual.description.holder.axes if name != axis]
    both = others and ("holder", "zero_offset_known") in values  # one key for both axes of the holder
    remark = f"holder.zero_offset_known = true holds for {others[0]} too: set its zero as well" if both else ""
    return Zero(axis, read_deg, true_deg, offset, values, remark)


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
    offset = round(read_deg + (known.zero_offset_deg if known.zero_offset_known else 0.0) - true_deg, 4)
    if axis not in ("tilt", "spin"):
        table: tuple[str, ...] = ("arms", axis)
        out: dict[tuple[str, ...], Any] = {(*table, "zero_offset_deg"): offset}
    elif len(description.holder.axes) > 1:
        table, out = ("holder",), {("holder", f"{axis}_zero_offset_deg"): offset}
    else:  # a key of its own would go before the common one
        table, out = ("holder",), {("holder", "zero_offset_deg"): offset, ("holder", f"{axis}_zero_offset_deg"): None}
    if not known.zero_offset_known:
        out[*table, "zero_offset_known"] = True
    return out, offset


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
    names = (path.with_name(f"{path.name}.bak{number}") for number in itertools.chain([""], itertools.count(2)))
    return next(name for name in names if not name.exists())
