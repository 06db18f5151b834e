"""NeXus, in HDF5: the table as it is, each curve as a group that viewers plot by themselves, units and errors.

There is no NeXus definition of a BRDF. So the file is an `NXentry` of the base classes alone, which h5web, silx and
NeXpy draw: `NXdata` with `signal`, `axes` and `_errors`, `NXsample`, `NXprocess`. It reads back to the last bit.
"""

import io
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from gonio import __version__, hdf5, seals
from gonio.errors import DataError
from gonio.formats import native
from gonio.formats.column_hints import NEEDED
from gonio.formats.curve_sheets import MOST, curves
from gonio.formats.reader import Format, require_held, write_bytes
from gonio.formats.sheets import WORDS
from gonio.shown import one_line
from gonio.typing import Array, DataFrame, Floats

TABLE = "entry/table"
UNITS = {"wavelength_nm": "nm"}


def _units(column: str) -> str:
    if column.endswith("_deg"):
        return "degree"
    if column in UNITS:
        return UNITS[column]
    return "1/sr" if column in ("brdf", "u_brdf", "u_random", "u_angles") or column.startswith("s_") else "1"


def _group(parent: Any, name: str, kind: str, **attributes: Any) -> Any:
    made = parent.create_group(name, track_order=True)
    made.attrs["NX_class"] = kind
    made.attrs.update(attributes)
    return made


def _column(group: Any, name: str, values: Any, units: str | None, words: Any) -> None:
    """A column of numbers with its units, or of words."""
    array = np.asarray(values)
    dataset = (
        group.create_dataset(name, data=array.astype(object), dtype=words, track_times=False)
        if array.dtype.kind in "OUT"
        else group.create_dataset(name, data=array.astype(np.float64), track_times=False)
    )
    if units is not None and array.dtype.kind not in "OUT":
        dataset.attrs["units"] = units


def write(frame: DataFrame, path: Path) -> None:
    """The table, its attributes, and its curves where there are not too many."""
    h5py = hdf5.library()
    words = h5py.string_dtype("utf-8")
    attrs = native.plain(frame.attrs)
    texts = (word for column in ("sample", "flag") if column in frame.columns for word in frame[column].unique())
    for word in (str(attrs.get("sample") or ""), *map(str, texts)):
        require_held(word, path, "HDF5", re.compile("\x00"))
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs.update(NX_class="NXroot", default="entry", creator=f"gonio {__version__}")
        entry = _group(file, "entry", "NXentry", default="table")
        quantity, name = str(attrs.get("quantity") or "brdf"), str(attrs.get("sample") or path.stem)
        entry.create_dataset("title", data=f"{quantity.upper()} of {name}", dtype=words, track_times=False)
        table = _group(entry, "table", "NXdata", signal="brdf", axes=["theta_r_deg"], gonio_columns=list(frame.columns))
        for column in frame.columns:
            _column(table, column, frame[column].to_numpy(), _units(column), words)
        _column(table, "brdf_errors", frame["u_brdf"].to_numpy(), "1/sr", words)
        try:
            shown = list(curves(frame, path))
        except DataError:  # too many: the table alone
            shown = []
        for number, curve in enumerate(shown, start=1):
            group = _group(entry, f"curve_{number:03d}", "NXdata", signal="brdf", axes=["angle"], title=curve.name)
            _column(group, "angle", curve.signed_deg, "degree", words)
            group["angle"].attrs["long_name"] = "viewing angle, positive toward the mirror direction (degree)"
            _column(group, "brdf", curve.rows["brdf"].to_numpy(), "1/sr", words)
            group["brdf"].attrs["long_name"] = f"{quantity.upper()} (1/sr)"
            _column(group, "brdf_errors", curve.rows["u_brdf"].to_numpy(), "1/sr", words)
            if number == 1:
                entry.attrs["default"] = group.name.rpartition("/")[2]
        sample = _group(entry, "sample", "NXsample")
        sample.create_dataset("name", data=name, dtype=words, track_times=False)
        process = _group(entry, "reduction", "NXprocess")
        process.create_dataset("program", data="gonio", dtype=words, track_times=False)
        process.create_dataset("version", data=__version__, dtype=words, track_times=False)
        note = _group(process, "attributes", "NXnote")
        note.create_dataset("type", data="application/json", dtype=words, track_times=False)
        text = json.dumps(attrs, ensure_ascii=False, allow_nan=False)
        note.create_dataset("data", data=text, dtype=words, track_times=False)
    write_bytes(path, seals.sealed(buffer.getvalue()))


def remarks(frame: DataFrame) -> list[str]:
    """That there are too many curves for groups of their own."""
    try:
        list(curves(frame, Path("table")))
    except DataError:
        return [f"the table has more than {MOST} curves: it is written as a whole, without a group for each"]
    return []


def read(data: bytes, path: Path) -> DataFrame:
    """A table that `write` has written, or somebody else in the same way: each column in the units that it states."""
    import pandas as pd

    with hdf5.opened(path, data) as file:
        try:
            if TABLE not in file or "gonio_columns" not in file[TABLE].attrs:
                raise DataError(
                    f"{path}: is HDF5 without a table of gonio (entry/table); there is no standard for BRDFs"
                )
            table = file[TABLE]
            if math.prod(table.attrs.get_id("gonio_columns").shape) > 1000:
                raise DataError(f"{path}: {TABLE} names more than 1000 columns")
            names = [str(name) for name in np.ravel(table.attrs["gonio_columns"])]
            native.check_columns(names, f"{path}: {TABLE}", needed=NEEDED)
            columns = {name: _read_column(table, name, path) for name in names}
            stored = _stored(file, path)
        except (DataError, MemoryError):
            raise
        except Exception as error:  # what HDF5 raises of damaged files is of any kind
            raise DataError(f"{path}: the HDF5 file is damaged, or none of gonio: {one_line(error)}") from None
    if len({len(column) for column in columns.values()}) != 1:
        raise DataError(f"{path}: the columns of entry/table differ in length")
    return native.taken(pd.DataFrame(columns), stored, path)


def _read_column(table: Any, name: str, path: Path) -> Any:
    shown = f"{path}: {TABLE}/{name}"
    if name not in table:
        raise DataError(f"{shown} is missing, although gonio_columns names it")
    dataset = table[name]
    if name in WORDS:
        return hdf5.values(dataset, shown, native.MOST_ROWS, "OS")
    numbers = hdf5.values(dataset, shown, native.MOST_ROWS).astype(np.float64)
    for key in ("_FillValue", "missing_value"):
        if key in dataset.attrs:
            numbers[np.isin(numbers, np.ravel(dataset.attrs[key]))] = np.nan
    return in_units(numbers, name, hdf5.factor(dataset, unit_of(name), shown), fine=dataset.dtype.itemsize > 4)


def unit_of(column: str) -> str:
    """The unit of a column, as a key of `gonio.hdf5.UNITS`."""
    return "deg" if (wanted := _units(column)) == "degree" else wanted


def in_units(numbers: Array, column: str, factor: float, *, fine: bool = True) -> Floats:
    """The numbers of a column times a factor; angles with as many decimals as they had: pi / 2 is 90."""
    scaled = np.asarray(numbers, np.float64) * factor
    return np.round(scaled, 10 if fine else 5) if column.endswith("_deg") and factor != 1.0 else scaled


def _stored(file: Any, path: Path) -> Any:
    """The attributes of the table."""
    name = "entry/reduction/attributes/data"
    note = file[name]
    if note.shape != () or note.dtype.itemsize > hdf5.BATCH_BYTES // 4:
        raise DataError(f"{path}: {name} is not one text")
    return json.loads(note.asstr()[()])


FORMAT = Format(
    name="nexus",
    title="NeXus (HDF5)",
    endings=(".h5", ".hdf5", ".nxs"),
    sniff=lambda head: head.startswith(seals.SIGNATURE),
    read=read,
    write=write,
    remarks=remarks,
    max_bytes=128 * 2**20,
    carries=native.FORMAT.carries,
)
