"""Other people's files: one module a format, each with a `FORMAT` that says how to tell, read and write it.

To add one: write `formats/mine.py` with a `FORMAT`, and name it as an entry point of the group `gonio.formats` in
pyproject.toml; other packages do the same.

What a container says of itself is obeyed, or the file is refused with the statement named. An HDF5 column is taken in
its attribute `units` (`rad`, `um`, `sr^-1`, ...); `scale_factor` and `add_offset` are refused, `_FillValue` is a hole.
An HDF5 file that keeps values in other files (external storage or links, virtual datasets), or wants a filter that
h5py does not bring, is not read. Sizes are known before memory is taken: at most 20 million rows, 128 MiB a chunk and
20 000 groups and datasets.

Columns of Parquet are taken in the unit of their field's metadata (`unit`, `units`) or of the attribute `units` of the
table; numbers are integers and floating-point numbers, words are texts, and a bool, a decimal, a date or a nested
column is refused. A column may unpack to 16 bytes a row and 1 MiB, a column of words to 128 MiB. A Klems matrix is of
a band (unit "Integral"), its rings lie within their bounds. A tensor file has real numbers, radians, `jacobian` 1 and
a bit a node in `valid`. An expanded uncertainty of a certificate needs its coverage factor. Arrays of an `.npz` are as
large as its camera.

A direction that a file states in two ways (azimuths of 0 and 360 degrees, or of -180 and 180) counts once; where its
two values differ by more than a millionth the file is refused. So it is in tables under one's own names (`--columns`),
ALTA and NIST; in radians, azimuths within 0.003 degrees of a half turn are it (four decimals). A measurement table
itself states azimuths in [0, 360).

Files above 256 MiB (64 for JSON and XLS, 16 for XML) and texts above 5 million lines are not read. A table of this
program may have 1 GiB and 20 million rows: it is read in pieces, and so is Parquet. 10^7 rows of ten columns (691 MB)
take 1.0 GB of memory in `convert --to parquet`, 1.2 GB back to CSV and 1.5 GB in `fit`. Two such tables at 272
wavelengths take 2.0 GB in `compare --change`, 147 s of processor time (`/usr/bin/time -v`). `GONIO_MUTATIONS=10000
pytest tests/gonio/formats -k damaged` reads ten thousand damaged copies of each format.
"""

from dataclasses import replace
from functools import lru_cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from gonio import plugins
from gonio.errors import ConfigError, DataError, did_you_mean
from gonio.formats.reader import Format

_ALSO = {"bird-json": "bird"}
"""Other names of formats, for --from and --to."""
_OURS = "gonio.formats."
SNIFFED_BYTES = 65536


def all_formats() -> dict[str, Format]:
    """Every format by name, ours first; without those that `left_out` names."""
    return _every(*plugins.available("gonio.formats").values())[0]


def left_out() -> list[str]:
    """Formats of other packages that cannot be loaded, or whose names are taken, a sentence each."""
    broken = _every(*plugins.available("gonio.formats").values())[1]
    return [*broken, *plugins.passed_over("gonio.formats")]


@lru_cache(maxsize=4)
def _every(*points: EntryPoint) -> tuple[dict[str, Format], list[str]]:
    """The formats that these entry points name, and what is said of those that cannot be had."""
    found, broken = dict[str, Format](), list[str]()
    for point in sorted(points, key=lambda point: not point.module.startswith(_OURS)):
        try:
            found[point.name] = _loaded(point)
        except ConfigError as error:
            broken.append(str(error))
    return found, broken


@lru_cache(maxsize=128)
def _loaded(point: EntryPoint) -> Format:
    """The format that an entry point names; of another package its errors say whose they are."""
    found = plugins.load("gonio.formats", point.name)
    what = f'the format "{point.name}" ({point.value})'
    if not isinstance(found, Format):
        raise ConfigError(f"{what} is no gonio.formats.reader.Format")
    if found.name != point.name:
        raise ConfigError(f'{what} calls itself "{found.name}"; entry point and format need one name')
    if point.module.startswith(_OURS):
        return found

    def guarded(does: str, function: Any) -> Any:
        def called(*arguments: Any) -> Any:
            with plugins.blamed(f"{what}: {does}"):
                return function(*arguments)

        return called if function is not None else None

    return replace(
        found,
        sniff=guarded("sniff", found.sniff),
        read=guarded("read", found.read),
        write=guarded("write", found.write),
        remarks=guarded("remarks", found.remarks),
        write_model=guarded("write_model", found.write_model),
    )


def names(*, written: bool = False) -> list[str]:
    """The names of all formats, and their other names; with `written`, one name of each that can be written."""
    if not written:
        return [*plugins.available("gonio.formats"), *_ALSO]
    also = {name: other for other, name in _ALSO.items()}
    writable = [name for name, f in all_formats().items() if f.write is not None or f.write_model is not None]
    return [also.get(name, name) for name in writable]


def named(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    ConfigError
        There is none (with the nearest name), or it cannot be loaded.
    """
    points = plugins.available("gonio.formats")
    name = _ALSO.get(name, name)
    if name not in points:
        hint = did_you_mean(name, points, f"known: {', '.join(points) or 'none; install gonio anew'}")
        raise ConfigError(f'there is no file format named "{name}"; {hint}')
    return _loaded(points[name])


def of_content(data: bytes, path: Path) -> Format:
    """The format of a file, from its first bytes; where they do not tell, from its ending.

    Raises
    ------
    DataError
        Neither tells.
    """
    for magic, what in (
        (b"\x1f\x8b", "gzip"),
        (b"BZh", "bzip2"),
        (b"\xfd7zXZ", "xz"),
    ):
        if data.startswith(magic):
            raise DataError(f"{path}, byte 0: is compressed ({what}); unpack it first")
    head = data[:SNIFFED_BYTES]
    formats = all_formats().values()
    ending = path.suffix.lower()
    found, failed = list[Format](), list[str]()
    for f in formats:
        try:
            found += [f] if f.sniff(head) else []
        except DataError as error:  # another package's fault: no file of other formats is lost by it
            failed.append(str(error))
    if failed and not found:
        raise DataError(f"{path}: {'; '.join(failed)}; --from NAME needs no such look")
    by_ending = [f for f in formats if ending in f.endings]
    choice = [f for f in found if f in by_ending] or found or by_ending
    if not choice:
        known = ", ".join(f.title for f in formats)
        lacking = "".join(f"; {said}" for said in left_out())
        raise DataError(f"{path}: is in no format known here ({known}){lacking}")
    if not found and len(choice) > 1 and "gonio" not in (f.name for f in choice):
        either = " or ".join(f"{f.title} (--from {f.name})" for f in choice)
        raise DataError(f"{path}: ends as {either} does, and begins as none of them")
    return choice[0]


def of_name(path: Path) -> Format:
    """The format that a new file of this name is written in.

    Raises
    ------
    ConfigError
        No format that can be written has this ending.
    """
    writable = [f for f in all_formats().values() if f.write is not None]
    fitting = [(len(end), f) for f in writable for end in f.endings if path.name.lower().endswith(end)]
    if fitting:
        return max(fitting, key=lambda pair: pair[0])[1]  # .gtc.json before .json
    endings = ", ".join(dict.fromkeys(ending for f in writable for ending in f.endings))
    raise ConfigError(f'{path}: no format is written with the ending "{path.suffix}"; there are {endings}')
