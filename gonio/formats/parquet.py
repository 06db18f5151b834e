"""Parquet, for large tables: a tenth of a CSV's bytes, read in a hundredth of its time, to the last bit.

Attributes of the table lie in the metadata, as pandas keeps them.
"""

import io
import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

from gonio import hdf5
from gonio.errors import ConfigError, DataError
from gonio.formats import native, nexus
from gonio.formats.column_hints import NEEDED, are_units
from gonio.formats.reader import Format, write_bytes
from gonio.formats.sheets import WORDS
from gonio.formats.text import csv_of
from gonio.shown import one_line
from gonio.typing import DataFrame

MAGIC = b"PAR1"


def _require_library() -> None:
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise ConfigError("Parquet files need the package pyarrow: pip install gonio[parquet]") from None


def write(frame: DataFrame, path: Path) -> None:
    """The table and its attributes."""
    _require_library()
    plain = frame.copy(deep=False)
    plain.attrs = native.plain(frame.attrs)
    buffer = io.BytesIO()
    plain.to_parquet(buffer, engine="pyarrow", index=False)
    write_bytes(path, (buffer.getbuffer(),))


def read(file: BinaryIO, path: Path) -> DataFrame:
    """A table of the measurement table's columns, each in the unit that it states; numbers, and words as texts.

    What it takes in memory is bounded by what the file's metadata say, before a column is unpacked.
    """
    _require_library()
    from pyarrow.parquet import ParquetFile

    try:
        content = ParquetFile(file)
        stored = json.loads((content.schema_arrow.metadata or {}).get(b"PANDAS_ATTRS", b"{}"))
        names, rows = [str(name) for name in content.schema_arrow.names], int(content.metadata.num_rows)
    except MemoryError:
        raise
    except Exception as error:  # what pyarrow raises of damaged files is of any kind
        raise _damaged(path, error) from None
    native.check_columns(names, str(path), needed=NEEDED)
    factors = _factors(content.schema_arrow, stored, path)
    _require_bounded(content.metadata, path)
    try:
        file.seek(0)
        # a long text that is there often is held once
        words = [name for name in names if name in WORDS]
        content = ParquetFile(file, metadata=content.metadata, read_dictionary=words)
        chunks = (_plain(batch.to_pandas(), factors) for batch in content.iter_batches(native.CHUNK))
        some = native.together(chunks, names, rows)
    except MemoryError:
        raise
    except Exception as error:
        raise _damaged(path, error) from None
    if some is None:
        raise DataError(f"{path}: the Parquet file is damaged: it states {rows} rows, and holds others")
    return native.taken(some, stored, path)


def as_csv(data: bytes, path: Path) -> bytes:
    """The table under columns of its maker's own, as a CSV; a row of units follows the header where columns state some.

    Numbers have every digit.
    """
    _require_library()
    from pyarrow.parquet import ParquetFile

    try:
        content = ParquetFile(io.BytesIO(data))
        _require_bounded(content.metadata, path)
        frame = content.read().to_pandas()
        stated = [
            {key.decode("utf-8", "replace").lower(): value.decode("utf-8", "replace") for key, value in pairs.items()}
            for pairs in (field.metadata or {} for field in content.schema_arrow)
        ]
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what pyarrow raises of damaged files is of any kind
        raise _damaged(path, error) from None
    units = [own.get("units", own.get("unit", "")) for own in stated]
    head = csv_of(map(str, frame.columns), [units] if are_units(units) else [])
    text: str = frame.to_csv(index=False, header=False, lineterminator="\n")
    return head + text.encode()


def _factors(schema: Any, stored: Any, path: Path) -> dict[str, float]:
    """What numbers are multiplied by, by the units that their columns state; `DataError` for other types of values."""
    from pyarrow import types

    units = stored.get("units") if isinstance(stored, dict) else None
    found: dict[str, float] = {}
    for field in schema:
        shown = f"{path}: the column {field.name}"
        kind = field.type.value_type if types.is_dictionary(field.type) else field.type
        words = types.is_string(kind) or types.is_large_string(kind)
        numbers = types.is_integer(field.type) or types.is_floating(field.type)
        if not (words if field.name in WORDS else numbers):
            what = "texts" if field.name in WORDS else "integers or floating-point numbers"
            raise DataError(f"{shown} holds {str(field.type)[:60]}; {what} are needed")
        if words:
            continue
        own = {key.decode("utf-8", "replace").lower(): value for key, value in (field.metadata or {}).items()}
        said = own.get("units", own.get("unit", units.get(field.name) if isinstance(units, dict) else None))
        stating = SimpleNamespace(attrs=own if said is None else own | {"units": said})
        if (factor := hdf5.factor(stating, nexus.unit_of(field.name), shown)) != 1.0:
            found[field.name] = factor
    return found


def _require_bounded(known: Any, path: Path) -> None:
    """`DataError` where the metadata state more rows than a table has, or more bytes than they can need."""
    if not 0 < known.num_rows <= native.MOST_ROWS:
        raise DataError(f"{path}: has {known.num_rows} rows; 1 to {native.MOST_ROWS} are read")
    for number in range(known.num_row_groups):
        group = known.row_group(number)
        for k in range(group.num_columns):
            column = group.column(k)
            most = _MOST_TEXT if column.path_in_schema in WORDS else 16 * group.num_rows + 2**20
            if column.total_uncompressed_size > most:
                raise DataError(
                    f"{path}: row group {number}, column {column.path_in_schema[:40]}: unpacks to "
                    f"{column.total_uncompressed_size} bytes; at most {most} are read of {group.num_rows} rows"
                )


_MOST_TEXT = 2**27
"""Bytes of a column of words."""


def _plain(frame: DataFrame, factors: Mapping[str, float]) -> DataFrame:
    """Some rows, words as texts and numbers in the table's units."""
    for name in frame.columns:
        if name in WORDS:
            frame[name] = frame[name].astype(object)
        elif name in factors:
            numbers = frame[name].to_numpy()
            frame[name] = nexus.in_units(numbers, name, factors[name], fine=numbers.dtype.itemsize > 4)
    return frame


def _damaged(path: Path, error: Exception) -> DataError:
    return DataError(f"{path}: the Parquet file is damaged: {one_line(error)}")


FORMAT = Format(
    name="parquet",
    title="Parquet",
    endings=(".parquet",),
    sniff=lambda head: head.startswith(MAGIC),
    read=read,
    in_pieces=True,
    write=write,
    carries=native.FORMAT.carries,
)
