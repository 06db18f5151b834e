"""HDF5 files of whatever origin: opened so that they read no other file, and with the units that they state.

An HDF5 file can keep values of a dataset in other files of the disk, or make them of other files' datasets. Such a
file would read whatever its author names, so it is refused, and so is one that wants a filter from a plug-in.
"""

from __future__ import annotations

import io
import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio import seals
from gonio.errors import ConfigError, DataError, GonioError
from gonio.shown import one_line

if TYPE_CHECKING:
    from gonio.typing import Array

MAP_FORMAT, MAP_SUFFIXES = "gonio-map-1", (".h5", ".nc", ".hdf5")
"""Of a map's file: its attribute `format`, and how its name ends."""
MOST_LINKS = 20_000
"""Most groups and datasets that a file may have: each is looked at before anything is read."""
FILTERS = {1: "deflate", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}
"""What chunks may be packed with: none of these reads a file, or runs a library that is not part of h5py."""
BATCH_BYTES = 2**29
"""What texts may take that are read together, if each were as long as the file."""
UNITS = {
    "deg": {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "rad": 180.0 / math.pi, "radian": 180.0 / math.pi,
            "radians": 180.0 / math.pi, "mrad": 0.18 / math.pi},
    "nm": {"nm": 1.0, "nanometre": 1.0, "nanometer": 1.0, "um": 1e3, "µm": 1e3, "μm": 1e3, "micron": 1e3,
           "micrometre": 1e3, "micrometer": 1e3, "mm": 1e6, "m": 1e9, "angstrom": 0.1, "å": 0.1, "pm": 1e-3},
    "mm": {"mm": 1.0, "millimetre": 1.0, "millimeter": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "cm": 10.0, "m": 1e3},
    "1/sr": {"1/sr": 1.0, "sr-1": 1.0, "sr^-1": 1.0, "sr**-1": 1.0, "/sr": 1.0, "steradian-1": 1.0},
    "1": {"1": 1.0, "": 1.0, "dimensionless": 1.0, "%": 0.01, "percent": 0.01},
}  # fmt: skip
"""Units that a quantity may be stated in, and what they are of the one that the table has."""


def library() -> Any:
    """h5py; raises `ConfigError` where it is not installed."""
    try:
        import h5py
    except ImportError:
        raise ConfigError("HDF5 files need the package h5py: pip install gonio[hdf5]") from None
    return h5py


def opened(path: Path, data: bytes | None = None) -> Any:
    """The file, open for reading, once it is known to read no other file.

    Parameters
    ----------
    path
        The file; named in messages.
    data
        Its bytes, where the caller holds them.

    Raises
    ------
    DataError
        It is no HDF5 file, is damaged, or keeps something outside of itself (with the name of what, and of where).
    ConfigError
        h5py is not installed.
    """
    h5py = library()
    seals.look(path)
    try:
        file = h5py.File(path if data is None else io.BytesIO(data), "r")
    except MemoryError:
        raise
    except Exception as error:  # what HDF5 raises of damaged files is of any kind
        raise DataError(f"{path}: is damaged: it cannot be read as HDF5: {one_line(error, 200)}") from None
    try:
        _require_alone(file, path)
    except (DataError, MemoryError):
        file.close()
        raise
    except Exception as error:
        file.close()
        raise DataError(f"{path}: is damaged: {one_line(error)}") from None
    return file


def _require_alone(file: Any, path: Path) -> None:
    """`DataError` for what lies outside of the file, or needs what h5py does not bring with it."""
    h5py = library()
    names: list[bytes] = []

    def look(name: bytes, info: Any) -> str | None:
        """Why the file is refused; None: the next link is looked at."""
        shown = f"{path}: {name.decode('utf-8', 'replace')[:80]!r}"
        if info.type == h5py.h5l.TYPE_EXTERNAL:
            other = _end_of(file.id.links.get_val(name)[0].decode("utf-8", "replace"))
            return f"{shown} is an external link, to the file {other!r}: {_REFUSED}"
        if info.type not in (h5py.h5l.TYPE_HARD, h5py.h5l.TYPE_SOFT):
            return f"{shown} is a link of somebody's own kind ({info.type}): {_REFUSED}"
        if info.type == h5py.h5l.TYPE_HARD:
            names.append(name)
        many = f"{path}: has more than {MOST_LINKS} groups and datasets, the most that are read"
        return many if len(names) > MOST_LINKS else None

    if (why := file.id.links.visit(look, info=True)) is not None:  # nothing may be raised inside of HDF5
        raise DataError(why)
    for name in names:
        found = h5py.h5o.open(file.id, name)
        if isinstance(found, h5py.h5d.DatasetID):
            _require_within(found, f"{path}: {name.decode('utf-8', 'replace')[:80]!r}")


_REFUSED = "a file that reads others is not read; copy what it needs into it"


def _end_of(path: str) -> str:
    """A path of somebody's choice, in a message: its end tells the file."""
    return path if len(path) <= 80 else f"...{path[-77:]}"


def _require_within(dataset: Any, shown: str) -> None:
    h5py = library()
    plist = dataset.get_create_plist()
    if plist.get_external_count():
        other = _end_of(plist.get_external(0)[0].decode("utf-8", "replace"))
        raise DataError(f"{shown} has its values in the file {other!r} (external storage): {_REFUSED}")
    if plist.get_layout() == h5py.h5d.VIRTUAL:
        others = sorted({_end_of(plist.get_virtual_filename(k)) for k in range(min(plist.get_virtual_count(), 100))})
        raise DataError(f"{shown} is virtual, of the files {', '.join(map(repr, others[:3])) or 'none'}: {_REFUSED}")
    if plist.get_layout() == h5py.h5d.CHUNKED:
        codes = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
        for code in codes:
            if code not in FILTERS or codes.count(code) > 1:
                known = ", ".join(FILTERS.values())
                raise DataError(f"{shown} is packed with filter {code}; read are {known}, each once (h5repack)")


def values(dataset: Any, shown: str, most: int, kinds: Collection[str] = "fiu") -> Array:
    """A column: numbers, or texts ("S" and "O" among the kinds), after its size is known to be no more than is read.

    Parameters
    ----------
    dataset
        Of a file that `opened` has opened.
    shown
        The file and the column, for messages.
    most
        Most values.
    kinds
        Kinds of numpy's that are wanted: without "O", numbers.

    Raises
    ------
    DataError
        It has another shape than a column, too many values, or other ones; or it unpacks to more than it says.
    """
    import numpy as np

    h5py = library()
    if not isinstance(dataset, h5py.Dataset):
        raise DataError(f"{shown} is {type(dataset).__name__.lower()}, and no dataset")
    if dataset.shape is None or len(dataset.shape) != 1:
        raise DataError(f"{shown} has the shape {dataset.shape}; a column has one dimension")
    words = h5py.check_string_dtype(dataset.dtype) is not None
    if dataset.dtype.kind not in kinds or (dataset.dtype.kind in "OS" and not words):
        what = "texts" if "O" in kinds else "real numbers"
        raise DataError(f"{shown} holds values of the kind {str(dataset.dtype)[:40]}; {what} are needed")
    if not 0 < dataset.size <= most or dataset.size * dataset.dtype.itemsize > BATCH_BYTES:
        raise DataError(f"{shown} has {dataset.size} values of {dataset.dtype.itemsize} bytes; 1 to {most} are read")
    _require_unpacked(dataset, shown)
    if not words:
        return np.asarray(dataset[()])
    step = max(8, BATCH_BYTES // dataset.file.id.get_filesize()) if dataset.dtype.kind == "O" else dataset.size
    out, left = [], BATCH_BYTES // 4
    for begin in range(0, dataset.size, step):
        some = dataset.asstr()[begin : begin + step]
        left -= sum(map(len, some))
        if left < 0:
            raise DataError(f"{shown} has texts of more than {BATCH_BYTES >> 22} MiB together")
        out.append(some)
    return np.concatenate(out).astype(object)


def _require_unpacked(dataset: Any, shown: str) -> None:
    """`DataError` where a chunk is larger than is read, or unpacks to more than its size, before HDF5 unpacks it."""
    import zlib

    if dataset.chunks is None:
        return
    size = math.prod(dataset.chunks) * dataset.dtype.itemsize
    if size > BATCH_BYTES // 4:
        raise DataError(f"{shown} has chunks of {size >> 20} MiB; at most {BATCH_BYTES >> 22} MiB are unpacked")
    if dataset.compression != "gzip":
        return
    limit = size + 4096  # checksums and what packers add
    for k in range(dataset.id.get_num_chunks()):
        mask, packed = dataset.id.read_direct_chunk(dataset.id.get_chunk_info(k).chunk_offset)
        if mask:
            continue
        unpacker = zlib.decompressobj()
        try:
            unpacker.decompress(packed, limit)
        except zlib.error as error:
            raise DataError(f"{shown} is damaged: {error}") from None
        if unpacker.unconsumed_tail:
            raise DataError(f"{shown} has a chunk that unpacks to more than its {size} bytes")


def factor(dataset: Any, wanted: str, shown: str) -> float:
    """What the values of a dataset are multiplied by to be in `wanted` (a key of `UNITS`), by its attribute `units`.

    Anything with `attrs` will do.

    Raises
    ------
    DataError
        The units are none of this quantity; or the dataset states a scale or an offset of its values.
    """
    for name, nothing in (("scale_factor", 1.0), ("scaling_factor", 1.0), ("add_offset", 0.0), ("offset", 0.0)):
        if name in dataset.attrs and dataset.attrs[name] != nothing:
            raise DataError(f"{shown} states {name} = {dataset.attrs[name]!r:.40}; write the values themselves")
    if "units" not in dataset.attrs:
        return 1.0
    stated = dataset.attrs["units"]
    text = stated.decode("utf-8", "replace") if isinstance(stated, bytes) else stated
    known = UNITS[wanted]
    if not isinstance(text, str) or (plain := text.replace(" ", "").lower()) not in known:
        raise DataError(f"{shown} states units = {text!r:.40}; read are {', '.join(filter(None, known))}")
    return known[plain]


def is_map(path: str | Path) -> bool:
    """Whether a file is a map of ours, of values or of fits; `DataError` where it is HDF5 that cannot be read."""
    if Path(path).suffix not in MAP_SUFFIXES or not Path(path).is_file():
        return False
    if not seals.look(path):
        return False
    with understood(f"{path}: is damaged"), opened(Path(path)) as file:
        return bool(file.attrs.get("format") == MAP_FORMAT)


@contextmanager
def understood(what: str) -> Iterator[None]:
    """Turn what h5py raises of a file that it makes no sense of into a `DataError`; want of memory names it, too."""
    try:
        yield
    except GonioError:
        raise
    except MemoryError as error:
        raise MemoryError(f"{what.rpartition(': ')[0]}: {error}") from None
    except Exception as error:
        reason = error.args[0] if isinstance(error, KeyError) and error.args else error  # its text has quotes
        raise DataError(f"{what}: {reason}") from None
