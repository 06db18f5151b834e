"""Map files: values of many pixels of a sample, in HDF5 as netCDF-4 has it (docs/maps.md).

A map is made tile by tile. A finished tile is written whole into a folder beside the file to be; at the end the tiles
become the file. What was killed goes on with the tiles that are missing, and the file is the same to the byte.

A tile is a chunk of the file. Whoever makes or reads it packs and unpacks it, so that this goes on in all threads at
once; the file itself only moves packed bytes.
"""

import json
import math
import os
import re
import shutil
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from gonio import hdf5, platform, seals
from gonio.disk import half_written, require_name, sha256_of, write_whole
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.geometry import ANGLES_DEG, Directions
from gonio.hdf5 import MAP_FORMAT, is_map
from gonio.typing import Array, Bools, DataFrame, Floats, Ints, JsonObject, NDArray

VERSION = ("v110", "v110")
"""Of HDF5: the oldest whose own records all have checksums."""
ABOUT = "about"
"""Key of a tile's file for the kinds and shapes of its packed arrays."""
TILE = 64
"""Pixels along a side of a tile."""
GZIP = 1
"""Level of compression; higher ones take much longer, and noise does not get smaller."""
FLAGS = ("outside", "saturated", "hot", "shadowed", "blurred")
"""Why a value must not be used, by bits of `flag` from the lowest."""
FIT_FLAGS = ("too_few", "at_bound", "undetermined", "rejected")
"""What is said of a fitted pixel, by bits of `flag` from the lowest."""

_STATED = {
    **{"x": "mm", "y": "mm", "source_mm": "mm", "camera_mm": "mm", "wavelength_nm": "nm"},
    **{"brdf": "1/sr", "u_random": "1/sr"},
    **dict.fromkeys(ANGLES_DEG, "deg"),
}
"""Units that maps are in: a file that states others is refused."""


@dataclass(frozen=True)
class Tile:
    """Some rows and columns of a map."""

    rows: slice
    cols: slice

    @property
    def name(self) -> str:
        """Name of its file among the parts."""
        return f"{self.rows.start:06d}-{self.cols.start:06d}.npz"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows.stop - self.rows.start, self.cols.stop - self.cols.start


def tiles(rows: int, cols: int) -> Iterator[Tile]:
    """All tiles of a map, row by row."""
    for top in range(0, rows, TILE):
        for left in range(0, cols, TILE):
            yield Tile(slice(top, min(top + TILE, rows)), slice(left, min(left + TILE, cols)))


@dataclass(frozen=True)
class Packed:
    """An array as a chunk of the file has it: bytes of equal weight side by side (HDF5's shuffle), then deflated."""

    dtype: str
    shape: tuple[int, ...]
    data: NDArray[np.uint8]
    """An array, for arrays go to other processes without being copied."""

    @classmethod
    def of(cls, array: Array) -> Self:
        """Pack an array."""
        flat = np.ascontiguousarray(array).reshape(-1)
        bytes_of = flat.view(np.uint8).reshape(-1, flat.dtype.itemsize)
        return cls(flat.dtype.str, array.shape, np.frombuffer(zlib.compress(bytes_of.T.tobytes(), GZIP), np.uint8))

    def array(self) -> Array:
        """The array; raises `OSError` where the bytes are damaged."""
        kind = np.dtype(self.dtype)
        try:
            whole = zlib.decompress(self.data.data, bufsize=max(kind.itemsize * math.prod(self.shape), 1))
            bytes_of = np.frombuffer(whole, np.uint8).reshape(kind.itemsize, -1)
            return np.ascontiguousarray(bytes_of.T).reshape(-1).view(kind).reshape(self.shape)
        except (zlib.error, ValueError) as error:
            raise OSError(f"a chunk is damaged: {error}") from None


@dataclass(frozen=True)
class Variable:
    """An array of a map file: either given, or put together from the tiles."""

    dims: tuple[str, ...]
    """Dimensions, of "y", "x", "point" and others; those of tiles begin with y, x."""
    data: Array | None = None
    """None: it comes from the tiles."""
    dtype: str = "f8"
    units: str = "1"
    about: str = ""
    """A few words, as `long_name`."""
    attrs: Mapping[str, Any] | None = None


SETTINGS = "settings.json"
"""The file of a folder of parts that tells what they are of."""


class Parts:
    """The tiles of a map that are done, in the folder `NAME.parts` beside the map file.

    Parameters
    ----------
    path
        The map file to be.
    settings
        What makes the tiles what they are; a folder that was begun with others is refused.

    Raises
    ------
    ConfigError
        The file exists and is no map, the folder holds tiles of other settings or none, or it cannot be written.
    """

    def __init__(self, path: Path, settings: JsonObject) -> None:
        require_name(path)
        self.path, self.folder = path, path.with_name(path.name + ".parts")
        if path.exists() and not is_map(path):
            raise ConfigError(f"{path}: is there already, and no map; choose another name")
        text = json.dumps({"format": MAP_FORMAT, **settings}, sort_keys=True, indent=1).encode()
        known = self.folder / SETTINGS
        with os_error_as(ConfigError, f"{self.folder}: cannot be written"):
            if known.exists():
                if known.read_bytes() != text:
                    raise ConfigError(
                        f"{self.folder}: holds parts of another map of this name; remove the folder, or choose"
                        f" another name than {path.name}"
                    )
            else:
                self.folder.mkdir(parents=True, exist_ok=True)
                if not all(half_written(entry.name, {known.name}) for entry in self.folder.iterdir()):
                    raise ConfigError(
                        f"{self.folder}: holds what is no part of a map, and would go with it; move it away, or choose"
                        f" another name than {path.name}"
                    )
                write_whole(known, text)

    def has(self, tile: Tile) -> bool:
        """Whether a tile is done."""
        return (self.folder / tile.name).is_file()

    def write(self, tile: Tile, arrays: Mapping[str, Array]) -> None:
        """Keep a tile, whole; raises `OSError` where the disk is full."""
        packed = {name: Packed.of(array) for name, array in arrays.items()}
        about = {name: (one.dtype, one.shape) for name, one in packed.items()}
        held = {name: one.data for name, one in packed.items()}
        write_tile(self.folder / tile.name, held | {ABOUT: np.array(json.dumps(about))})

    def read(self, tile: Tile, *names: str) -> dict[str, Array]:
        """The arrays of a tile that is done: those of these names, or all."""
        return {name: packed.array() for name, packed in self._packed(tile, names).items()}

    def _packed(self, tile: Tile, names: Sequence[str] = ()) -> dict[str, Packed]:
        path = self.folder / tile.name
        with readable_part(path), path.open("rb") as file, np.load(file) as found:
            about = json.loads(str(found[ABOUT]))
            return {name: Packed(about[name][0], tuple(about[name][1]), found[name]) for name in names or about}

    def assemble(self, sizes: Mapping[str, int], variables: Mapping[str, Variable], attrs: Mapping[str, Any]) -> None:
        """Make the file of all tiles, which then go. `sizes`: of every dimension, "y" and "x" among them."""
        unfinished = self.folder / "whole.h5"
        try:
            with hdf5.library().File(unfinished, "w", libver=VERSION) as file:
                _fill(file, sizes, variables, attrs)
                for tile in tiles(sizes["y"], sizes["x"]):
                    for name, packed in self._packed(tile).items():
                        _put(file[RENAMED.get(name, name)], tile, packed)
            seals.seal(unfinished)
        except (OSError, RuntimeError) as error:  # a file that HDF5 cannot close is a RuntimeError
            unfinished.unlink(missing_ok=True)
            raise _plain(error) from None
        unfinished.replace(self.path)
        for folder in (self.path.parent, self.folder):
            platform.sync_folder(folder)  # the file has its name on the disk before a tile goes
        for part in sorted(self.folder.iterdir()):
            if part.name != SETTINGS:
                part.unlink()
        shutil.rmtree(self.folder)  # what the parts are of goes after them: without it nobody knows whose they are

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Turn what a disk that is full, or a folder that is gone, raises into a `ConfigError` that says what to do."""
        try:
            yield
        except OSError as error:
            raise ConfigError(
                f"{self.path}: cannot be written: {error.strerror or error}; the tiles that are done stay, and the same"
                " command goes on with the others"
            ) from None


@contextmanager
def readable_part(path: Path) -> Iterator[None]:
    """Turn what reading a damaged file of a folder of parts raises into a `DataError` that says what to do."""
    try:
        yield
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
        raise DataError(f"{path}: is damaged; remove the folder {path.parent}, and the command begins anew") from None


def _plain(error: Exception) -> Exception:
    """An error of HDF5 as the system has it, where it tells its number."""
    number = re.search(r"errno = (\d+)", str(error))
    if number is None:
        return error
    return OSError(int(number[1]), os.strerror(int(number[1])))


def write_tile(path: Path, arrays: Mapping[str, Array]) -> None:
    """A tile's file, written whole."""
    import io

    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    write_whole(path, stream.getvalue())


def _put(dataset: Any, tile: Tile, packed: Packed) -> None:
    """A tile into a variable of a file: as it is where it is a whole chunk."""
    if packed.shape == dataset.chunks and packed.dtype == dataset.dtype.str:
        dataset.id.write_direct_chunk((tile.rows.start, tile.cols.start, *(0,) * (len(packed.shape) - 2)), packed.data)
    else:
        dataset[tile.rows, tile.cols] = packed.array()


def _fill(file: Any, sizes: Mapping[str, int], variables: Mapping[str, Variable], attrs: Mapping[str, Any]) -> None:
    """Dimensions, variables and attributes, as netCDF-4 has them."""
    file.attrs.update({"format": MAP_FORMAT, "Conventions": "CF-1.10"} | {n: _attribute(v) for n, v in attrs.items()})
    for name, variable in variables.items():
        shape = tuple(sizes[d] for d in variable.dims)
        options: dict[str, Any] = {"track_times": False}
        if variable.data is None and 0 not in shape:
            chunk = tuple(min(TILE, n) if d in ("y", "x") else n for d, n in zip(variable.dims, shape, strict=True))
            options |= {"chunks": chunk, "compression": "gzip", "compression_opts": GZIP, "shuffle": True}
        dataset = file.create_dataset(name, shape, variable.dtype, data=variable.data, **options)
        dataset.attrs.update({"units": variable.units, "long_name": variable.about, **(variable.attrs or {})})
    for name, size in sizes.items():
        if name not in file:
            file.create_dataset(name, data=np.arange(size), track_times=False)
        file[name].make_scale(name)
    for name, variable in variables.items():
        if variable.dims != (name,):
            for axis, dimension in enumerate(variable.dims):
                file[name].dims[axis].attach_scale(file[dimension])


def _attribute(value: Any) -> Any:
    return value if isinstance(value, str | int | float) else json.dumps(value, ensure_ascii=False)


@dataclass(frozen=True)
class Held:
    """Values of a tile as the file has them: so that the thread or the worker that uses them unpacks them."""

    where: str
    brdf: Packed | Array
    u: Packed | Array
    flag: Packed | Array

    def values(self, points: Ints | None = None) -> tuple[Floats, Floats]:
        """BRDF [1/sr] and its own standard uncertainty, shape (rows, columns, n); NaN where flagged.

        Parameters
        ----------
        points
            Which points; None: all.

        Raises
        ------
        DataError
            The file is damaged there.
        """
        try:
            brdf, u, flag = (
                each.array() if isinstance(each, Packed) else each for each in (self.brdf, self.u, self.flag)
            )
        except OSError as error:
            raise DataError(f"{self.where} cannot be read: {error}; make the map anew") from None
        if points is not None and len(points) < brdf.shape[-1]:
            brdf, u, flag = (each[..., points] for each in (brdf, u, flag))
        out = brdf.astype(float), u.astype(float)
        if flag.any():
            for each in out:
                each[flag != 0] = np.nan
        return out


RENAMED = {"tau": "misfit"}
"""Variables by the names that earlier versions wrote; both are read."""
WRITTEN = {new: old for old, new in RENAMED.items()}


class MapFile:
    """A map file that is read tile by tile.

    Raises
    ------
    DataError
        It cannot be read, or is no map.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file = hdf5.opened(self.path)
        try:
            self._require_map()
        except DataError:
            self._file.close()
            raise

    def _require_map(self) -> None:
        """Raise `DataError` where the file is no map, or lacks what every map has."""
        if self.attrs.get("format") != MAP_FORMAT:
            raise DataError(f"{self.path}: is no map: it lacks the attribute format = {MAP_FORMAT}; see docs/maps.md")
        for name, unit in _STATED.items():
            shown = f"{self.path}: {name}"
            if name not in self.names or self.said(name, "units") == "1":  # as of `Variable`: unstated
                continue
            with hdf5.understood(shown):
                factor = hdf5.factor(self._variable(name), unit, shown)
            if factor != 1.0:
                raise DataError(f"{shown} is in other units than {unit}; write the map anew in these")
        for name in ("x", "y"):
            places = self.array(name)
            if places.ndim != 1 or places.dtype.kind not in "fiu" or not np.isfinite(places).all():
                raise DataError(f"{self.path}: {name} is no list of places on the sample in mm")
        if "brdf" in self.names:
            count = self._variable("brdf").shape[-1]
            for name in (*ANGLES_DEG, "wavelength_nm", "source_mm", "camera_mm"):
                if len(found := self.array(name)) != count or not np.isfinite(found).all():
                    raise DataError(f"{self.path}: {name} has no finite value for each of the {count} points of brdf")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @cached_property
    def attrs(self) -> dict[str, Any]:
        """Attributes of the file; those that were lists or tables are again."""
        out = {}
        with hdf5.understood(f"{self.path}: its attributes cannot be read"):
            for name, value in self._file.attrs.items():
                text = value if isinstance(value, str) else None
                out[name] = json.loads(text) if text and text[0] in "{[" else value
        return out

    @cached_property
    def names(self) -> list[str]:
        """Its variables."""
        with hdf5.understood(f"{self.path}: cannot be read"):
            return [RENAMED.get(name, name) for name in self._file]

    def array(self, name: str, tile: Tile | None = None) -> Array:
        """A variable, or a tile of it; raises `DataError` where there is none, or it is damaged."""
        found = self._variable(name)
        with hdf5.understood(f"{self.path}: {name} is damaged"):
            return np.asarray(found[()] if tile is None else found[tile.rows, tile.cols])

    def chunk(self, name: str, tile: Tile) -> Packed | Array:
        """A tile of a variable: packed as the file has it where it is a chunk of it, otherwise as an array."""
        found = self._variable(name)
        packing = found.compression, found.shuffle, found.fletcher32, found.scaleoffset
        if found.chunks == (*tile.shape, *found.shape[2:]) and packing == ("gzip", True, False, None):
            begin = (tile.rows.start, tile.cols.start, *(0,) * (found.ndim - 2))
            if not any(start % side for start, side in zip(begin, found.chunks, strict=True)):
                mask, data = found.id.read_direct_chunk(begin)
                if mask == 0:
                    return Packed(found.dtype.str, found.chunks, np.frombuffer(data, np.uint8))
        return np.asarray(found[tile.rows, tile.cols])

    def _variable(self, name: str) -> Any:
        name = RENAMED.get(name, name)
        if name not in self.names:
            raise DataError(f"{self.path}: has no variable {name}")
        with hdf5.understood(f"{self.path}: {name} cannot be read"):
            return self._file[name if name in self._file else WRITTEN[name]]

    def dims(self, name: str) -> tuple[str, ...]:
        """The dimensions of a variable."""
        found = self._variable(name)
        with hdf5.understood(f"{self.path}: {name} cannot be read"):
            return tuple((d[0].name or "").strip("/") for d in found.dims if len(d))

    def said(self, name: str, attribute: str) -> str:
        """An attribute of a variable, as text; "" where it has none."""
        found = self._variable(name)
        with hdf5.understood(f"{self.path}: {name} cannot be read"):
            return str(found.attrs.get(attribute, ""))

    @cached_property
    def x_mm(self) -> Floats:
        """Middle of the columns on the sample [mm]."""
        return self.array("x").astype(float)

    @cached_property
    def y_mm(self) -> Floats:
        """Middle of the rows on the sample [mm]."""
        return self.array("y").astype(float)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.y_mm), len(self.x_mm)

    @cached_property
    def causes(self) -> dict[str, Floats]:
        """Relative changes of the values of each point (n,) for one standard deviation of causes that pixels share."""
        return {name: self.array(name).astype(float) for name in self.names if name.startswith("s_")}

    def tiles(self) -> list[Tile]:
        """All tiles."""
        return list(tiles(*self.shape))

    def sha256(self) -> str:
        """Checksum of the whole file, by which fits name their map."""
        return sha256_of(self.path)

    def held(self, tile: Tile) -> Held:
        """The values of a tile, which are not unpacked yet; raises `DataError` where they cannot be read."""
        where = f"rows {tile.rows.start} to {tile.rows.stop}, columns {tile.cols.start} to {tile.cols.stop}"
        where = f"{self.path}: {where}"
        with hdf5.understood(f"{where} cannot be read"):
            return Held(where, *(self.chunk(name, tile) for name in ("brdf", "u_random", "flag")))

    def values(self, tile: Tile) -> tuple[Floats, Floats]:
        """BRDF [1/sr] and its own standard uncertainty of a tile, shape (rows, columns, n); NaN where flagged."""
        return self.held(tile).values()

    def table(self, row: int, col: int) -> DataFrame:
        """The measurement table of one pixel, in its own directions (`gonio.measurement`)."""
        import pandas as pd

        spot = np.array([self.x_mm[col], self.y_mm[row], 0.0])
        at = Directions.from_vectors(self.array("source_mm") - spot, self.array("camera_mm") - spot)
        tile = Tile(slice(row, row + 1), slice(col, col + 1))
        brdf, u = (self.array(name, tile)[0, 0].astype(float) for name in ("brdf", "u_random"))
        flags = [",".join(f for k, f in enumerate(FLAGS) if bits >> k & 1) for bits in self.array("flag", tile)[0, 0]]
        columns: dict[str, Any] = dict(zip(ANGLES_DEG, np.degrees(np.array(at.angles)), strict=True))
        columns |= {"wavelength_nm": self.array("wavelength_nm"), "polarisation": "unpolarised", "brdf": brdf}
        common = {name: relative * brdf for name, relative in self.causes.items()}
        total = np.sqrt(u**2 + sum((change**2 for change in common.values()), np.zeros(len(brdf))))
        frame = pd.DataFrame(columns | {"u_brdf": total, "u_random": u, **common, "flag": flags})
        frame.attrs.update(self.attrs)
        frame.attrs["source_file"] = f"{self.path}, x = {spot[0]:g} mm, y = {spot[1]:g} mm"
        return frame


class FitFile(MapFile):
    """A map file of fitted parameters: what `gonio fit MAP` writes.

    Raises
    ------
    DataError
        It cannot be read, is no map, or is one of values.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        if not self.parameters:
            self._file.close()
            raise DataError(f"{path}: is a map of values, not of fits: gonio fit {path} --model M --out FITS.h5")
        if "model" not in self.attrs:
            raise DataError(f"{path}: does not say which model was fitted (attribute model)")

    @cached_property
    def parameters(self) -> list[str]:
        """Fitted parameters: those that have a standard uncertainty."""
        known = [name for name in self.names if f"u_{name}" in self.names and self.dims(name) == ("y", "x")]
        order = self.attrs.get("parameters")
        order = list(order) if isinstance(order, list | dict) else []
        return sorted(known, key=lambda name: order.index(name) if name in order else len(order))

    @property
    def model(self) -> str:
        """Which model was fitted."""
        return str(self.attrs.get("model", "unknown"))

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Parameters that were not fitted, with their values."""
        found = self.attrs.get("fixed", {})
        return {name: float(value) for name, value in found.items()} if isinstance(found, dict) else {}

    def unit(self, name: str) -> str:
        """Unit of a parameter; "" where it has none."""
        found = self.said(name, "units")
        return "" if found == "1" else found

    @cached_property
    def flags(self) -> NDArray[np.uint8]:
        """Bits of `FIT_FLAGS`, shape (rows, columns)."""
        return self.array("flag").astype(np.uint8)

    def flagged(self, name: str) -> Bools:
        """Where a flag is set, shape (rows, columns)."""
        return np.asarray(self.flags >> FIT_FLAGS.index(name) & 1 == 1)

    def parameter(self, name: str, tile: Tile | None = None) -> tuple[Floats, Floats]:
        """Values and standard uncertainties of a parameter (or those of a tile), shape (rows, columns).

        What is not determined is NaN. A value at its bound has no uncertainty: NaN.
        """
        value, u = (self.array(one, tile).astype(float) for one in (name, f"u_{name}"))
        return value, np.where(np.isfinite(value) & (u > 0), u, np.nan)

    def correlations(self, names: list[str], tile: Tile) -> Floats:
        """Correlations of parameters with each other, shape (rows, columns, k, k); 0 where the file has none."""
        out = np.zeros((*tile.shape, len(names), len(names))) + np.eye(len(names))
        if "correlation" in self.names:
            found = np.nan_to_num(self.array("correlation", tile).astype(float))
            for k, pair in enumerate(self.said("correlation", "pairs").split()):
                first, _, second = pair.partition(":")
                if first in names and second in names:
                    a, b = names.index(first), names.index(second)
                    out[..., a, b] = out[..., b, a] = found[..., k]
        return out
