"""NeXus, in HDF5: the table as it is, each curve as a group that viewers plot by themselves, units and errors.

There is no NeXus definition of a BRDF. So the file is an `NXentry` of the base classes alone, which h5web, silx and
NeXpy draw: `NXdata` with `signal`, `axes` and `_errors`, `NXsample`, `NXprocess`. It reads back to the last bit.
"""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from gonio import __version__
from gonio.errors import ConfigError, DataError
from gonio.formats import native
from gonio.formats.curve_sheets import MOST, curves
from gonio.formats.reader import Format, write_bytes
from gonio.typing import DataFrame

MAGIC = b"\x89HDF\r\n\x1a\n"
TABLE = "entry/table"
UNITS = {"wavelength_nm": "nm"}


def _library() -> Any:
    try:
        import h5py
    except ImportError:
        raise ConfigError("HDF5 files need the package h5py: pip install gonio[hdf5]") from None
    return h5py


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
    h5py = _library()
    words = h5py.string_dtype("utf-8")
    attrs = native.plain(frame.attrs)
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
    write_bytes(path, buffer.getvalue())


def remarks(frame: DataFrame) -> list[str]:
    """That there are too many curves for groups of their own."""
    try:
        list(curves(frame, Path("table")))
    except DataError:
        return [f"the table has more than {MOST} curves: it is written as a whole, without a group for each"]
    return []


def read(data: bytes, path: Path) -> DataFrame:
    """A table that `write` has written."""
    import pandas as pd

    h5py = _library()
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            if TABLE not in file or "gonio_columns" not in file[TABLE].attrs:
                raise DataError(
                    f"{path}: is HDF5 without a table of gonio (entry/table); there is no standard for BRDFs"
                )
            table, columns = file[TABLE], {}
            for name in map(str, table.attrs["gonio_columns"]):
                dataset = table[name]
                kind = h5py.check_string_dtype(dataset.dtype)
                values = dataset.asstr()[()] if kind is not None else dataset[()]
                columns[name] = np.asarray(values, dtype=object if kind is not None else np.float64)
            stored = json.loads(file["entry/reduction/attributes/data"].asstr()[()])
    except DataError:
        raise
    except Exception as error:  # what HDF5 raises of damaged files is of any kind
        raise DataError(f"{path}: the HDF5 file is damaged, or none of gonio: {str(error)[:80]}") from None
    if len({len(column) for column in columns.values()}) != 1:
        raise DataError(f"{path}: the columns of entry/table differ in length")
    return native.taken(pd.DataFrame(columns), stored, path)


FORMAT = Format(
    name="nexus",
    title="NeXus (HDF5)",
    endings=(".h5", ".hdf5", ".nxs"),
    sniff=lambda head: head.startswith(MAGIC),
    read=read,
    write=write,
    remarks=remarks,
    carries=native.FORMAT.carries,
)
