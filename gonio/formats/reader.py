"""What every file format shares: how it is described, and how a reader turns cells into the measurement table.

A reader gets the bytes of a file, or where `Format.in_pieces` says so the open file, and returns the table of
`gonio.measurement`. It never opens files itself (but for the blank that belongs to an RT-300S file) and never asks for
more memory than a small multiple of what it was given.
Everything that is wrong with a file is a `DataError` that names the file and the line or byte.

Also here is what a table states of its laboratory (`[laboratory]` of the run), and what a record still needs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict, cast

import numpy as np

from gonio.disk import require_not_measured, write_whole
from gonio.errors import ConfigError, DataError, os_error_as, refuse_masked
from gonio.geometry import ANGLES_DEG
from gonio.shown import visible
from gonio.typing import Array, ArrayLike, DataFrame, Floats, JsonObject

if TYPE_CHECKING:
    from pydantic import JsonValue

    from gonio.models import Model

ANGLES = ANGLES_DEG
COLUMNS = (*ANGLES, "wavelength_nm", "polarisation", "brdf", "u_brdf", "u_random", "flag")
SIDES = ("reflection", "transmission")
"""Words of the column `side`, which a table has where some of it is transmission."""
MUELLER = tuple(f"m{i}{j}" for i in range(4) for j in range(4) if i or j)
"""Columns of a table that holds Mueller matrices: their elements over the first one, which is `brdf` (conventions)."""
U_MUELLER = tuple(f"u_{name}" for name in MUELLER)
"""Their standard uncertainties, where they are stated."""
U_ANGLES = "u_angles"
"""The part of `u_random` that errors of the angles make: of tables whose points are too few to tell it themselves."""
EXTRA = ("sample", "side", *MUELLER, *U_MUELLER, U_ANGLES)
"""Columns that only some tables have."""
LARGEST = 2**30
"""No file above this size is opened: CSV tables of this program may have it."""
MAX_BYTES = 2**28
"""Most bytes of a file; less where a reader needs many bytes of memory a byte."""
SAME = 1e-6
"""Relative: two values that a file states for one direction are one where they differ by rounding to seven digits."""


@dataclass(frozen=True)
class Format:
    """One kind of file: how to tell it, to read it and to write it."""

    name: str
    """As in `gonio convert --from NAME --to NAME`."""
    title: str
    endings: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    """Whether the first 64 KiB of a file look like this format."""
    read: Callable[[Any, Path], DataFrame]
    """The table in a file's bytes; the path is for messages and for what lies beside the file."""
    in_pieces: bool = False
    """Whether `read` takes the open file, and not its bytes."""
    write: Callable[[DataFrame, Path], None] | None = None
    remarks: Callable[[DataFrame], list[str]] | None = None
    """What a reader of a written file should know, a sentence each."""
    write_model: Callable[[Model, str, Path], None] | None = None
    """Writes an isotropic model, with a name, at the directions of the format: for renderers."""
    max_bytes: int = MAX_BYTES
    carries: frozenset[str] = frozenset()
    """What it has room for besides angles and values: "uncertainty", "flag", "solid angle", "transmission",
    "mueller"."""
    only_flag: str = ""
    """The one flag that reads back, where a flagged value is written as a zero."""


def fold(theta_deg: ArrayLike, phi_deg: ArrayLike, *, slack_deg: float = 0.0) -> tuple[Floats, Floats]:
    """Directions with a signed polar angle as the table has them: (-theta, phi) is (theta, phi + 180).

    A polar angle above 90 degrees by no more than `slack_deg` (the file's rounding) is 90.
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta_deg, dtype=np.float64), np.asarray(phi_deg, dtype=np.float64))
    phi = wrap_deg(np.where(theta < 0, phi + 180.0, phi))
    theta = np.abs(theta)
    return np.where((theta > 90) & (theta <= 90 + slack_deg), 90.0, theta), phi


def plain_degrees(radians: ArrayLike, decimals: int) -> Floats:
    """Angles in degrees that a file gives in radians with `decimals` decimals: the shortest that its digits stand for.

    0.174533 stands for 10 degrees and not for 10.0000043; the same digits come out when the angle is written again.
    """
    rad = np.asarray(radians, dtype=np.float64)
    half = max(0.5 * 10.0**-decimals, 1e-15)
    degrees = np.rad2deg(rad)
    for digits in range(12, -1, -1):
        candidate = np.round(np.rad2deg(rad), digits)
        degrees = np.where(np.abs(np.deg2rad(candidate) - rad) <= half, candidate, degrees)
    return degrees


def whole_turns(phi_deg: Floats) -> Floats:
    """Azimuths of a file in radians: those within `_RADIANS_SHORT` of a multiple of 180 degrees are that.

    6.2832 stands for 360 degrees, which is the direction that 0 is; not for 360.0004.
    """
    near = 180.0 * np.round(phi_deg / 180.0)
    return np.where(np.abs(phi_deg - near) <= _RADIANS_SHORT, near, phi_deg)


_RADIANS_SHORT = 0.003
"""Half of the fourth decimal of a radian, in degrees: fewer decimals are no angles of a goniometer."""


def wrap_deg(phi_deg: ArrayLike) -> Floats:
    """Azimuths in [0, 360) degrees."""
    phi = np.asarray(phi_deg, dtype=np.float64)
    wrapped = np.round(np.mod(phi, 360.0), 10)  # so that -22.5 becomes 337.5 and not the float beside it
    wrapped = np.where(wrapped >= 360.0, 0.0, wrapped)
    return np.where((phi >= 0) & (phi < 360), phi, wrapped)


def table(
    *,
    theta_i_deg: ArrayLike,
    phi_i_deg: ArrayLike,
    theta_r_deg: ArrayLike,
    phi_r_deg: ArrayLike,
    wavelength_nm: ArrayLike,
    brdf: ArrayLike,
    u_brdf: ArrayLike = math.nan,
    u_random: ArrayLike = math.nan,
    polarisation: str | Sequence[str] = "unpolarised",
    flag: str | Sequence[str] | Array = "",
    sample: Sequence[str] | Array | None = None,
    side: str | Sequence[str] | Array | None = None,
    mueller: Mapping[str, ArrayLike] | None = None,
    attrs: Mapping[str, Any],
) -> DataFrame:
    """A measurement table, its columns in order; arguments broadcast to one length, attributes get their defaults.

    A row whose `brdf` is NaN and that has no flag is flagged "not_measured". `side` is left out where all is
    reflection.
    """
    import pandas as pd

    values = {
        "theta_i_deg": theta_i_deg, "phi_i_deg": phi_i_deg, "theta_r_deg": theta_r_deg, "phi_r_deg": phi_r_deg,
        "wavelength_nm": wavelength_nm, "brdf": brdf, "u_brdf": u_brdf, "u_random": u_random,
    }  # fmt: skip
    for name, value in values.items():
        refuse_masked(name, value)
    arrays = [np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in values.values()]
    (count,) = np.broadcast_shapes(*(array.shape for array in arrays))
    # a whole column that is its own array is taken as it is: millions of rows are held once
    whole = (
        np.require(np.broadcast_to(array, count) if array.size != count else array, requirements=["C", "O", "W"])
        for array in arrays
    )
    frame = pd.DataFrame(dict(zip(values, whole, strict=True)), copy=False)
    frame.insert(5, "polarisation", _words(polarisation, count))
    if sample is not None:
        frame.insert(6, "sample", _words(sample, count))
    if side is not None and (words := _words(side, count) == SIDES[1]).any():
        frame.insert(list(frame.columns).index("brdf"), "side", np.where(words, *reversed(SIDES)).astype(object))
    for name, values_of in (mueller or {}).items():
        frame[name] = np.asarray(values_of, dtype=np.float64)
    frame["flag"] = _words(flag, count)
    frame.attrs.update(attributes(**({"quantity": quantity(frame)} | dict(attrs))))
    flag_holes(frame)
    return frame


def one_value_a_direction(frame: DataFrame, stated_deg: Floats, path: Path) -> DataFrame:
    """The table with one row where a file states one direction in two ways, as azimuths of 0 and 360 degrees.

    Parameters
    ----------
    frame
        The table, in the file's order.
    stated_deg
        The four angles as the file states them, shape (n, 4); n divides the rows of the table.
    path
        For messages.

    Raises
    ------
    DataError
        The values of such a direction differ.
    """
    place = [name for name in (*ANGLES, "wavelength_nm", "polarisation", "sample", "side") if name in frame.columns]
    if not frame.duplicated(place).any():
        return frame
    stated = np.repeat(stated_deg, len(frame) // len(stated_deg), axis=0)
    group = frame.groupby(place, sort=False, dropna=False).ngroup().to_numpy()
    first = np.unique(group, return_index=True)[1][group]
    again = (stated[first] != stated).any(axis=1)
    if not again.any():
        return frame  # the same statement twice is a repeated measurement
    value = frame["brdf"].to_numpy(np.float64)
    same = np.isclose(value, value[first], rtol=SAME, atol=0.0, equal_nan=True)
    for row in np.flatnonzero(again & ~same)[:1]:
        a, b = (", ".join(f"{angle:g}" for angle in stated[k]) for k in (first[row], row))
        raise DataError(
            f"{path}: the directions ({a}) and ({b}) degrees are one, and their values are {value[first[row]]:g} and "
            f"{value[row]:g}; keep the one that holds"
        )
    out: DataFrame = frame[~again].reset_index(drop=True)
    note = f"{int(again.sum())} values are of a direction that is stated in two ways (as 0 and 360 degrees): left out"
    out.attrs = {**frame.attrs, "notes": [*frame.attrs.get("notes", ()), note]}
    return out


def spectra(
    directions: Sequence[Floats],
    wavelength_nm: Sequence[float],
    brdf: Floats,
    *,
    flag: str | Array = "",
    attrs: Mapping[str, Any],
) -> DataFrame:
    """The table of values (n, m) at n directions (their four angles [degrees]) and m wavelengths."""
    theta_i, phi_i, theta_r, phi_r = (np.repeat(angle, len(wavelength_nm)) for angle in directions)
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=np.tile(wavelength_nm, len(directions[0])),
        brdf=brdf.ravel(),
        flag=flag,
        attrs=attrs,
    )


def quantity(frame: DataFrame) -> str:
    """What the values of a table are: "brdf", "btdf", or "bsdf" where it has both."""
    if "side" not in frame.columns:
        return "brdf"
    through = (frame["side"] == "transmission").to_numpy()
    return "btdf" if through.all() else "bsdf" if through.any() else "brdf"


def flag_holes(frame: DataFrame) -> None:
    """Flag rows whose `brdf` is NaN and that have no flag as "not_measured", and note how many they are."""
    holes = np.isnan(frame["brdf"].to_numpy(np.float64))
    if holes.any():
        holes &= (frame["flag"] == "").to_numpy()
    if holes.any():
        frame.loc[holes, "flag"] = "not_measured"
        note = f'{holes.sum()} of {len(frame)} values are empty: flagged "not_measured"'
        frame.attrs["notes"] = [*frame.attrs.get("notes", ()), note]


def note_copies(frame: DataFrame) -> None:
    """Say how many rows are the same as another in every column: copies of it, or repeats that came out the same.

    Both stay. A run's own table is left out: what was measured several times is known there.
    """
    if "reduced_by" in frame.attrs.get("provenance", {}):
        return
    values = frame["brdf"].to_numpy(np.float64)
    ordered = np.sort(values)
    several = np.unique(ordered[1:][ordered[1:] == ordered[:-1]])
    del ordered  # of ten million rows it takes 80 MB
    if not several.size:
        return
    same = np.zeros(values.size, dtype=bool)
    for begin in range(0, values.size, 1 << 20):
        some = values[begin : begin + (1 << 20)]
        same[begin : begin + some.size] = several[np.minimum(np.searchsorted(several, some), several.size - 1)] == some
    rows = np.flatnonzero(same & (frame["flag"] == "").to_numpy())
    there = frame.iloc[rows]
    copies = np.flatnonzero(there.duplicated().to_numpy())
    if copies.size:
        places = there[[*ANGLES, "brdf"]].to_numpy(np.float64)
        first = int(np.flatnonzero((places == places[copies[0]]).all(axis=1))[0])
        note = (
            f"rows that are the same as another in every column: {copies.size} (the first are {rows[first] + 1} and "
            f"{rows[copies[0]] + 1} of the table); each counts as a measurement of its own, so leave out what is a copy"
        )
        frame.attrs["notes"] = [*frame.attrs.get("notes", ()), note]


def _words(words: str | Sequence[str] | Array, count: int) -> Array:
    if not isinstance(words, str):
        return np.asarray(words, dtype=object)
    same = np.empty(count, dtype=object)
    same.fill(words)  # np.full would make a text of its own for every row
    return same


class TableBand(TypedDict):
    """A spectral band of a table, as far as it is known."""

    name: NotRequired[str]
    centre_nm: NotRequired[float]
    fwhm_nm: NotRequired[float]
    channel: NotRequired[str]
    lower_nm: NotRequired[float]
    upper_nm: NotRequired[float]


class Attributes(TypedDict):
    """What a table says of itself besides its columns: `attrs` of the frame, and `<name>.meta.json`."""

    quantity: str
    source_solid_angle_sr: float | None
    receiver_solid_angle_sr: float | None
    bands: list[TableBand]
    polarisation: str
    source_file: str | None
    sample: str | None
    provenance: Mapping[str, JsonValue]
    notes: list[str]
    samples: NotRequired[list[str]]


def attributes(**known: Any) -> Attributes:
    """The attributes that every table has, with what is known of them filled in."""
    defaults: Attributes = {
        "quantity": "brdf",
        "source_solid_angle_sr": None,
        "receiver_solid_angle_sr": None,
        "bands": [],
        "polarisation": "unpolarised",
        "source_file": None,
        "sample": None,
        "provenance": {},
        "notes": [],
    }
    return cast(Attributes, {**defaults, **known})


def wide(frame: DataFrame, path: Path, format_name: str) -> tuple[Floats, Floats, Floats]:
    """Directions (n, 4), wavelengths (m,) and BRDF (n, m) of a table, for formats that have one row a direction.

    Directions keep the order of the table; what is flagged, and what was not measured, is NaN.

    Raises
    ------
    DataError
        The table is polarised, holds several samples, repeats a direction, or has no wavelength.
    """
    single(frame, path, format_name)
    if frame["wavelength_nm"].isna().any():
        raise DataError(f"{path}: {format_name} needs a wavelength in each row, and this table has a broad band")
    key = frame[[*ANGLES, "wavelength_nm"]]
    if key.duplicated().any():
        row = int(np.flatnonzero(key.duplicated().to_numpy())[0])
        raise DataError(
            f"{path}: {format_name} holds one value for each direction and wavelength; row {row + 1} is a second"
        )
    angles = frame[list(ANGLES)].to_numpy(np.float64)
    _, first, inverse = np.unique(angles, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size)
    wavelengths, column = np.unique(frame["wavelength_nm"].to_numpy(np.float64), return_inverse=True)
    values = np.full((order.size, wavelengths.size), np.nan)
    values[rank[inverse.ravel()], column] = np.where(frame["flag"] == "", frame["brdf"].to_numpy(np.float64), np.nan)
    return angles[first[order]], wavelengths, values


def single(frame: DataFrame, path: Path, format_name: str) -> None:
    """`DataError` unless the table holds one unpolarised sample."""
    if (frame["polarisation"] != "unpolarised").any():
        raise DataError(f"{path}: {format_name} holds unpolarised values only; this table has polarised rows")
    if "sample" in frame.columns:
        raise DataError(
            f'{path}: {format_name} holds one sample; name one as "FILE:SAMPLE": '
            + ", ".join(f'"{name}"' for name in frame.attrs["samples"])
        )


def reflection_only(frame: DataFrame, path: Path, format_name: str) -> None:
    """`DataError` where a table has transmission, and the format has no way to say so."""
    if "side" in frame.columns and (count := int((frame["side"] == "transmission").sum())):
        raise DataError(
            f"{path}: {format_name} holds reflection only, and {count} of {len(frame)} rows are transmission (theta_r "
            "beyond 90 degrees); write it as .csv, or leave those rows out (side = reflection)"
        )


NO_TEXT = re.compile(r"[\x00-\x08\x0e-\x1f\x7f\ud800-\udfff]")
"""What no reader takes for text (`gonio.formats.text.require_text`), and halves of a character."""
NOT_IN_A_LINE = re.compile(rf"{NO_TEXT.pattern}|[\x0b\x0c\x85\u2028\u2029]")
"""And what ends a line beside its end."""
NOT_XML = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
"""What XML does not hold, or gives back as something else; and what no reader takes for text."""


def require_held(text: str, path: Path, format_name: str, unfit: re.Pattern[str]) -> None:
    """`DataError` where a text has a character that a format cannot hold: nothing is written instead of it."""
    if bad := unfit.search(text):
        named = bad[0].encode("unicode_escape").decode()
        raise DataError(
            f'{path}: "{visible(text[:60])}" has the character {named}, which {format_name} cannot hold; rename it, or '
            "write .parquet"
        )


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file of these lines, as `write_bytes` does."""
    write_bytes(path, "".join(f"{line}\n" for line in lines).encode())


def write_bytes(path: str | Path, data: bytes | Iterable[bytes | memoryview]) -> None:
    """Write a whole file, which may be given in pieces, or nothing (`gonio.disk.write_whole`).

    Raises
    ------
    ConfigError
        The folder is missing or cannot be written to, or a run was measured into the file.
    """
    path = Path(path)
    require_place(path)
    with os_error_as(ConfigError, f"{path}: cannot be written"):
        write_whole(path, data)


def require_place(path: Path) -> None:
    """`ConfigError` where the folder of a file is missing, or a run was measured into the file."""
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: cannot be written: there is no folder {path.parent}")
    require_not_measured(path)


Need = str | tuple[str, ...]
"""A key that a record needs; of several keys in a tuple one is enough."""


def laboratory_of(frame: DataFrame) -> JsonObject | None:
    """The table `[laboratory]` of the run that a table was reduced from; None where it had none."""
    provenance = frame.attrs.get("provenance")
    stated = provenance.get("laboratory") if isinstance(provenance, Mapping) else None
    return stated if isinstance(stated, dict) else None


def get(stated: Mapping[str, Any], key: str) -> Any:
    """A value by its key, as `address.city`; None where it is not stated."""
    inner: Any = stated
    for part in key.split("."):
        inner = inner.get(part) if isinstance(inner, Mapping) else None
    return inner


def require(stated: Mapping[str, Any], keys: Sequence[Need], what: str, path: Path) -> None:
    """Raise `ConfigError` that names every key that a record needs and nobody has stated."""
    missing = [
        one if isinstance(one, str) else f"{one[0]} (or {', '.join(one[1:])})"
        for one in keys
        if all(get(stated, key) in (None, [], "") for key in ([one] if isinstance(one, str) else one))
    ]
    if missing:
        named = "".join(f"\n  laboratory.{key}" for key in missing)
        raise ConfigError(
            f"{path}: {what} needs what nobody has stated, and nothing is invented:{named}\n"
            "state these keys in [laboratory] of the plan or of the rig file; for a run that is measured, say the same "
            "`gonio measure` with --resume, and `gonio reduce` again"
        )
