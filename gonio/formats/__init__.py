"""Other people's files: one module a format, each with a `FORMAT` that says how to tell, read and write it.

To add one: write `formats/mine.py` with a `FORMAT`, and name it in `_MODULES`.

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

import re
from functools import cache
from importlib import import_module
from pathlib import Path

from gonio.errors import ConfigError, DataError, did_you_mean
from gonio.formats.column_hints import columns_line
from gonio.formats.reader import Format
from gonio.formats.text import column_names

_MODULES = (
    "native",
    "astm",
    "nist_mueller",
    "gtc",
    "bird_json",
    "alta",
    "klems_xml",
    "zemax_bsdf",
    "rt300s",
    "pab",
    "workbook",
    "merl",
    "rgl",
    "nexus",
    "parquet",
)
_ALSO = {"bird-json": "bird"}
"""Other names of formats, for --from and --to."""
SNIFFED_BYTES = 65536


@cache
def all_formats() -> dict[str, Format]:
    """Every format by name."""
    return {f.name: f for f in [import_module(f"gonio.formats.{name}").FORMAT for name in _MODULES]}


def names(*, written: bool = False) -> list[str]:
    """The names of all formats, and their other names; with `written`, one name of each that can be written."""
    formats = all_formats()
    if not written:
        return [*formats, *_ALSO]
    also = {name: other for other, name in _ALSO.items()}
    return [also.get(name, name) for name, f in formats.items() if f.write is not None or f.write_model is not None]


def named(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    ConfigError
        There is none (with the nearest name).
    """
    formats = all_formats()
    name = _ALSO.get(name, name)
    if name not in formats:
        hint = did_you_mean(name, formats, f"known: {', '.join(formats)}")
        raise ConfigError(f'there is no file format named "{name}"; {hint}')
    return formats[name]


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
    found = [f for f in formats if f.sniff(head)]
    by_ending = [f for f in formats if ending in f.endings]
    choice = [f for f in found if f in by_ending] or found or by_ending
    if not choice:
        known = ", ".join(f.title for f in formats)
        raise DataError(f"{path}: is in no format known here ({known}){_of_ones_own(head)}")
    return choice[0]


def _of_ones_own(head: bytes) -> str:
    """How to read a text that may be a table of one's own; "" for other files."""
    if re.search(rb"[\x00-\x08\x0e-\x1f]|^\s*[<{\[]", head):
        return ""
    return f"; a table with its columns' names in the first line: {columns_line(column_names(head))}"


def of_name(path: Path) -> Format:
    """The format that a new file of this name is written in.

    Raises
    ------
    ConfigError
        No format that can be written has this ending.
    """
    writable = [f for f in all_formats().values() if f.write is not None]
    for f in writable:
        if path.name.lower().endswith(f.endings):
            return f
    endings = ", ".join(dict.fromkeys(ending for f in writable for ending in f.endings))
    raise ConfigError(f'{path}: no format is written with the ending "{path.suffix}"; there are {endings}')
