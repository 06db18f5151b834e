"""The measurement table: what everything downstream of a measurement reads, whoever measured it.

A table is a `pandas.DataFrame` with one row a direction pair, wavelength and polarisation:

- `theta_i_deg, phi_i_deg` toward the source and `theta_r_deg, phi_r_deg` toward the detector: theta in [0, 90], phi in
  [0, 360), from the outward normal and the sample's x axis; the mirror half-plane is phi_r = phi_i + 180;
- `wavelength_nm`, NaN for a broad band; `polarisation`: "unpolarised", or another word of
  `gonio.polarisation`, as "sp" (light, then analyser) or "s" (light, and no analyser);
- `sample`, only where a file holds several samples;
- `side`, only where some rows are transmission: "reflection" or "transmission". In rows of transmission theta_r lies
  in (90, 180], behind the sample, and `brdf` is the BTDF (docs/transmission.md);
- `brdf` [1/sr], with the sign that it was measured with;
- `u_brdf`, its combined standard uncertainty (k = 1), NaN where nobody stated one; `u_random`, the part of it that is
  independent from row to row; `s_<cause>`, one signed column a common cause: the change of `brdf` for one standard
  deviation of that cause. The covariance of the values is diag(u_random^2) + sum over causes of s s^T;
- `m01` to `m33`, only where Mueller matrices were measured: their elements over the first one (docs/conventions.md),
  NaN where unknown, and `u_m01` to `u_m33`, their standard uncertainties;
- `u_angles`, only where a run chose its points: the part of `u_random` that errors of the angles make. Such points are
  too few to tell it well, and a model that is fitted knows it better;
- `flag`: "" or the reason why the row must not be used.

`frame.attrs` holds the rest: `quantity`, `source_solid_angle_sr`, `receiver_solid_angle_sr` (None where unknown),
`bands`, `polarisation`, `polarisers`, `source_file`, `sample`, `samples`, `provenance`, and `notes`: sentences for a
person about what a file leaves out or what a reader did to it.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from gonio import formats, polarisation
from gonio.disk import is_stream, only_file
from gonio.errors import ConfigError, DataError, GonioError, os_error_as
from gonio.formats import channels, native, own_columns, own_guess, own_pairs, rt300s
from gonio.formats.native import check, check_columns, meta_path, uncertainty
from gonio.formats.reader import (
    ANGLES,
    COLUMNS,
    LARGEST,
    MUELLER,
    U_ANGLES,
    U_MUELLER,
    Format,
    note_copies,
    one_value_a_direction,
    reflection_only,
)
from gonio.sides import reflection, transmission, turned_over
from gonio.typing import DataFrame

if TYPE_CHECKING:
    from gonio.models import Model

__all__ = [
    "COLUMNS", "Reading", "every_state", "is_simulated", "meta_path", "of_reader", "parse", "proposed", "read",
    "reflection", "said_once", "samples", "split", "tables", "transmission", "turned_over", "uncertainty",
    "unpolarised", "write", "write_model",
]  # fmt: skip


def read(
    path: str | Path,
    *,
    format: str | None = None,
    sample: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> DataFrame:
    """The measurement table in a file of any supported format, or in a RUN folder (its `brdf.csv`).

    Parameters
    ----------
    path
        A file or a RUN folder. The format is told from the content, then from the ending.
    format
        The name of a format (`gonio.formats.all_formats()`), where neither tells.
    sample
        Which sample to take from a file that holds several; without it all are there, told apart by a column `sample`.
    columns
        The file's own names and units of the columns of a text, a workbook or a Parquet file made by hand:
        `{"theta_i": "ti:rad", "brdf": "R:factor"}` (`gonio.formats.own_pairs`). Without it those in
        `<name>.columns.toml` beside the file, if it is there.

    Raises
    ------
    ConfigError
        There is no such file, or it cannot be opened; there is no such format; `columns` name what is no column.
    DataError
        The file is empty, damaged or in no known format; a value is not allowed (with file, line and column); it holds
        no such sample.

    Examples
    --------
    >>> import gonio
    >>> table = gonio.read("clay.csv")
    >>> len(table), round(float(table["brdf"].max()), 3)
    (16, 0.175)
    """
    path = Path(path)
    if path.is_dir():
        path = _table_of_run(path)
    with _opened(path) as file, os_error_as(ConfigError, f"{path}: cannot be read"):
        if not any(block.strip() for block in iter(lambda: file.read(formats.SNIFFED_BYTES), b"")):
            raise DataError(f"{path}: is empty")
        if _size(file) > LARGEST:
            raise DataError(f"{path}: is larger than {LARGEST >> 20} MiB, the largest file that is read")
        with _in_memory(path, _size(file)):
            frame = _parsed(file, path, format, columns)
    return frame if sample is None else _choose(frame, sample, path)


def parse(
    data: bytes,
    path: Path,
    *,
    format: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> DataFrame:
    """The table in the bytes of a file, as `read` gives it, with the same errors; `path` names the file in messages."""
    with _in_memory(path, len(data)):
        return _parsed(io.BytesIO(data), path, format, columns)


@contextmanager
def _in_memory(path: Path, size: int) -> Iterator[None]:
    """Turn want of memory into a `DataError` that names the file, and what was asked for."""
    try:
        yield
    except MemoryError as error:
        asked = f"; {error}" if str(error) else ""
        raise DataError(
            f"{path}: there is too little memory to read it: the file has {size / 2**20:.3g} MiB, and its table takes"
            f" several times as much{asked}; free some memory, or read a part of it"
        ) from None


def _parsed(file: BinaryIO, path: Path, format: str | None, columns: Mapping[str, str] | None) -> DataFrame:
    try:
        return _table_in(file, path, format, columns)
    except DataError as error:
        remedy = _remedy(file, path, columns) if format in (None, *_OWN) else ""
        if not remedy:
            raise
        raise DataError(f"{error}; {remedy}") from error


_OWN = ("gonio", "xlsx", "parquet")
"""Formats whose columns may have names of their maker's own."""
_MOST_GUESSED = 2**24
"""Bytes of a table that is read a second time, to say how."""


def _remedy(file: BinaryIO, path: Path, columns: Mapping[str, str] | None) -> str:
    """The command that reads a table of one's own that was refused, or what of it is to be filled in; "" for others."""
    if _size(file) > _MOST_GUESSED:
        return ""
    data = file.read()
    given = columns if columns is not None else own_pairs.beside(path)
    of_others = [f for f in formats.all_formats().values() if f.name not in _OWN]
    if given is None and any(f.sniff(data[: formats.SNIFFED_BYTES]) for f in of_others):
        return ""
    found, read_so = proposed(data, path, given)
    if found is None or isinstance(read_so, GonioError):
        return ""
    names = ", ".join(repr(name[:40]) for name in found.header[:16])
    unknown = "" if found.whole else f" ({own_guess.UNKNOWN}: one of the file's columns {names}, or a number)"
    beside = f", or write {own_pairs.beside_path(path).name} beside it" if own_pairs.owns(path) else ""
    return f"to read it as it is, without its other columns: {found.line(path)}{unknown}{beside}"


def proposed(
    data: bytes, path: Path, given: Mapping[str, str] | None = None
) -> tuple[own_guess.Proposal | None, DataFrame | GonioError | None]:
    """What the columns of a table of one's own may be, and the table as it reads so, or why it does not."""
    found = own_guess.proposal(data, path, given)
    if found is None or not found.whole:
        return found, None
    try:
        return found, _table_in(io.BytesIO(data), path, None, own_pairs.pairs(found.text))
    except GonioError as error:
        return found, error


def _table_in(file: BinaryIO, path: Path, format: str | None, columns: Mapping[str, str] | None) -> DataFrame:
    where, stored = "columns", columns
    blank = own_pairs.blank_beside(path)
    if columns is None and blank is None and (stored := own_pairs.beside(path)) is not None:
        where = str(own_pairs.beside_path(path))
    if stored is not None and format in (None, *_OWN):
        own = own_columns.read(_within(file, path, native.FORMAT).read(), path, stored, where)
        with np.errstate(all="ignore"):
            frame = native.of_columns(own.columns, own.lines, path)
        return _complete(one_value_a_direction(frame, own.stated_deg, path), path, native.FORMAT, own.notes)
    if columns is not None:
        raise ConfigError(
            f"{path}: columns are named in texts, workbooks and Parquet files made by hand, and {format} files are none"
        )
    chosen = formats.named(format) if format else formats.of_content(file.read(formats.SNIFFED_BYTES), path)
    if blank is not None and chosen is not rt300s.FORMAT:
        raise ConfigError(
            f"{own_pairs.beside_path(path)}: a blank is subtracted from RT-300S workbooks alone, and {path} is "
            f"{chosen.title}"
        )
    _within(file, path, chosen)
    content: Any = file if chosen.in_pieces else file.read()
    with np.errstate(all="ignore"):  # absurd numbers overflow to what `check` then names
        frame = chosen.read(content, path) if blank is None else rt300s.read(content, path, blank)
    return _complete(frame, path, chosen, own_pairs.not_heeded(path, chosen.title) if blank is None else ())


def _within(file: BinaryIO, path: Path, chosen: Format) -> BinaryIO:
    """The file, from its beginning; `DataError` where it is larger than is read of its format."""
    if _size(file) > chosen.max_bytes:
        raise DataError(f"{path}: is larger than {chosen.max_bytes >> 20} MiB, the largest {chosen.title} that is read")
    return file


def _complete(frame: DataFrame, path: Path, chosen: Format, notes: Sequence[str] = ()) -> DataFrame:
    """The table that a format's reader has made, checked, with its notes and the names of its samples."""
    frame.attrs["notes"] = [*notes, *frame.attrs.get("notes", ())]
    frame.attrs.setdefault("format", chosen.name)
    check_columns(list(frame.columns), str(path))
    if chosen.name != "gonio":  # whose reader has checked, with line numbers
        check(frame, lambda row: f"{path}, row {row + 1} of the table")
    note_copies(frame)
    frame.attrs.update(_whole(dict(frame.attrs)))
    if "sample" in frame.columns:
        if any(name != _whole(name) for name in frame["sample"].unique()):
            frame["sample"] = frame["sample"].map(_whole)
        frame.attrs["samples"] = frame["sample"].unique().tolist()
    return frame


def _whole(value: Any) -> Any:
    """A value whose texts have no halves of characters, which JSON may hold and no page or file takes: their codes."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, list | tuple):
        return [_whole(one) for one in value]
    return {_whole(key): _whole(one) for key, one in value.items()} if isinstance(value, Mapping) else value


def write(frame: DataFrame, path: str | Path, *, format: str | None = None) -> list[str]:
    """Write a table: all of it or nothing.

    Parameters
    ----------
    frame
        A measurement table.
    path
        The file. Without `format` its ending tells the format; `.csv` is the project's own table, whose attributes go
        to `<name>.meta.json` beside it.
    format
        The name of a format.

    Returns
    -------
    list of str
        What the format has no room for, a sentence each; nothing for the project's own table.

    Raises
    ------
    DataError
        The table is not valid (with row and column), or the format cannot hold it at all.
    ConfigError
        The file cannot be written, or the format is unknown or only read.

    Examples
    --------
    >>> import gonio
    >>> table = gonio.read("clay.csv")
    >>> gonio.write(table[table["theta_r_deg"] < 60], "steep.csv")
    []
    >>> len(gonio.read("steep.csv"))
    12
    """
    path = Path(path)
    chosen = written_as(path, format)
    assert chosen.write is not None
    check_columns(list(frame.columns), str(path))
    check(frame, lambda row: f"{path}, row {row + 1}")
    if "transmission" not in chosen.carries:
        reflection_only(frame, path, chosen.title)
    chosen.write(frame, path)
    return _left_out(frame, path, chosen)


def _left_out(frame: DataFrame, path: Path, chosen: Format) -> list[str]:
    """What a format has no room for, a sentence each."""
    lost = chosen.remarks(frame) if chosen.remarks is not None else []
    if chosen is native.FORMAT and is_stream(path):
        lost.append(f"{path}: takes the table alone; solid angles, bands and provenance need a file beside a file")
    if "mueller" not in chosen.carries and set(MUELLER) & set(frame.columns):
        lost.append(f"{chosen.title} has no room for Mueller matrices: m01 to m33 are not written")
    if "uncertainty" not in chosen.carries and frame["u_brdf"].notna().any():
        lost.append(f"{chosen.title} has no room for uncertainties: u_brdf, u_random and s_ columns are not written")
    if "solid angle" not in chosen.carries and any(
        frame.attrs.get(f"{w}_solid_angle_sr") for w in ("source", "receiver")
    ):
        lost.append(f"{chosen.title} has no room for solid angles: those of source and receiver are not written")
    if "flag" not in chosen.carries and (frame["flag"] != "").any():
        count = int((frame["flag"] != "").sum())
        lost.append(f"{chosen.title} has no room for flags: {count} flagged rows are left out")
    others = sorted(set(frame["flag"].unique()) - {"", chosen.only_flag})
    if chosen.only_flag and others:
        count = int(frame["flag"].isin(others).sum())
        lost.append(
            f"{chosen.title} knows one flag: {count} rows flagged {', '.join(others)} will read as {chosen.only_flag}"
        )
    return lost


def written_as(path: Path, format: str | None = None) -> Format:
    """The format that `write` writes a table in; raises its `ConfigError` of the format, before there is a table."""
    if format:
        chosen = formats.named(format)
    else:  # standard output and devices have no ending
        chosen = native.FORMAT if is_stream(path) and not path.suffix else formats.of_name(path)
    if chosen.write is None and chosen.write_model is not None:
        raise ConfigError(
            f'{path}: "{chosen.name}" is written of models, which have a value in every direction, and not of tables: '
            "fit one, and convert a sample file (TOML) with its parameters; or fill the table with --to mitsuba"
        )
    if chosen.write is None:
        raise ConfigError(f'{path}: files of the format "{chosen.name}" are read, not written')
    return chosen


def write_model(
    model: Model, path: str | Path, *, name: str, format: str | None = None, exchanged: bool = False
) -> list[str]:
    """Write a model as the file of a renderer, at the directions that the format wants.

    Parameters
    ----------
    model
        An isotropic model.
    path, format
        As for `write`; the formats that take models are rgl (Mitsuba 3), klems (Radiance) and merl.
    name
        The sample's name in the file.
    exchanged
        With source and detector exchanged, for who takes the first direction of a file for the viewer's: Mitsuba.

    Returns
    -------
    list of str
        What the file cannot hold, a sentence each.

    Raises
    ------
    ConfigError
        The format takes no models, or the file cannot be written.
    DataError
        The model depends on the sample's azimuth, or a value is not finite.
    """
    from gonio.models import examine
    from gonio.models.arrays import Exchanged

    path = Path(path)
    chosen = formats.named(format) if format else formats.of_name(path)
    if chosen.write_model is None:
        able = ", ".join(f.name for f in formats.all_formats().values() if f.write_model)
        raise ConfigError(f'{path}: a model cannot be written as "{chosen.name}"; name one of {able} with --to')
    turned = np.deg2rad([[0.0], [37.0], [101.0]])
    values = model.brdf(0.9, turned, np.array([0.2, 0.9, 1.2]), turned + np.array([0.5, 2.0, np.pi]))
    if not np.allclose(values, values[0], rtol=1e-6, atol=0):
        raise DataError(f"{path}: the model depends on the sample's azimuth; {chosen.title} is written isotropic only")
    chosen.write_model(Exchanged(model) if exchanged else model, name, path)
    too_bright = examine(model).too_bright
    remarks = [f"{too_bright}: a renderer that follows light may never end with it"] if too_bright else []
    if _goes_back(model):
        return [
            *remarks,
            "the lobe about the direction of incidence is sampled at the file's directions, which lie close about the "
            "mirror direction: a narrow one is blurred or lost",
        ]
    if model.has_spike:
        remarks.append("the specular spike has no width and is not in the file: only the lobe and the diffuse part are")
    return remarks


def is_simulated(frame: DataFrame) -> bool:
    """Whether a simulation made the values: its provenance says so, which copies and conversions keep."""
    provenance = frame.attrs.get("provenance")
    return isinstance(provenance, Mapping) and provenance.get("simulated") is True


def _goes_back(model: Model) -> bool:
    """Whether a model, or a term of a sum, has a lobe about the direction of incidence."""
    from gonio.models import Retroreflecting, Sum

    return isinstance(model, Retroreflecting) or (isinstance(model, Sum) and any(_goes_back(m) for m, _ in model.terms))


def samples(frame: DataFrame) -> dict[str, DataFrame]:
    """The samples of a table by name, in the order of the file."""
    if "sample" not in frame.columns:
        source = frame.attrs.get("source_file")
        return {frame.attrs.get("sample") or (Path(source).stem if source else "sample"): frame}
    path = Path(frame.attrs.get("source_file") or "table")
    return {name: _choose(frame, name, path) for name in frame.attrs["samples"]}


@dataclass(frozen=True)
class Reading:
    """What a command line says of its tables besides their names. Runs need none of it."""

    columns: Mapping[str, str] | None = None
    """Their own names and units of columns, as for `read`."""


def tables(spec: str | Path, how: Reading | None = None, *, apart: bool = False) -> dict[str, DataFrame]:
    """The tables that `FILE`, `RUN` or `FILE:SAMPLE` on a command line names, by sample.

    The channels red, green and blue of a sample are one table (`gonio.formats.channels.joined`), unless they shall
    stand `apart`.

    Raises
    ------
    ConfigError, DataError
        As `read` does.
    """
    path, sample = split(spec)
    how = Reading() if how is None or Path(path).is_dir() else how
    try:
        frame = read(path, sample=sample, columns=how.columns)
    except DataError:
        if sample is None or apart:
            raise
        whole = channels.joined(samples(read(path, columns=how.columns)))  # the name of three channels, perhaps
        if sample not in whole:
            raise
        return {sample: whole[sample]}
    found = samples(frame) if sample is None else {sample: frame}
    return found if apart else channels.joined(found)


def of_one(spec: str | Path, how: Reading | None = None) -> tuple[str, DataFrame]:
    """The one sample of these, and its name; a `ConfigError` where there are several."""
    found = tables(spec, how)
    if len(found) > 1:
        part = channels.incomplete(found, str(spec))
        several = f"holds {len(found)} samples: name one as {spec}:SAMPLE, of: {'; '.join(found)}"
        raise ConfigError(f"{spec}: {part}" if part else f"{spec} {several}")
    return next(iter(found.items()))


def unpolarised(frame: DataFrame) -> DataFrame:
    """The table of one sample with what unpolarised light would show, where every state of polarisation was measured.

    Values for incident s and p of one direction and wavelength become their mean; ss, sp, ps and pp half their sum.
    Such a row stands where the first of them stood, and a note says so. Other polarised rows stay as they are.
    Independent errors are added in squares, common causes with their signs.
    """
    already = frame["polarisation"] == "unpolarised"
    if already.all():
        return frame
    import pandas as pd

    place = [*ANGLES, "wavelength_nm"]
    causes = [name for name in frame.columns if name.startswith("s_")]
    left = frame.assign(u_random=uncertainty(frame)[0])
    known = pd.MultiIndex.from_frame(left.loc[already, place])
    count = 0
    for complete in (("s", "p"), ("ss", "sp", "ps", "pp")):
        part = left[left["polarisation"].isin(complete)]
        groups = part.groupby(place, sort=False, dropna=False)
        whole = groups["polarisation"].transform("size") == len(complete)
        whole &= groups["polarisation"].transform("nunique") == len(complete)
        part = part[whole & ~pd.MultiIndex.from_frame(part[place]).isin(known)]
        if part.empty:
            continue
        groups = part.groupby(place, sort=False, dropna=False)
        rows = part[~part.duplicated(place)].assign(polarisation="unpolarised")
        for name in ("brdf", *causes):
            rows[name] = groups[name].sum(min_count=len(complete)).to_numpy() / 2.0
        squares = (part["u_random"] ** 2).groupby([part[name] for name in place], sort=False, dropna=False)
        rows["u_random"] = np.sqrt(squares.sum(min_count=len(complete)).to_numpy()) / 2.0
        rows["u_brdf"] = np.sqrt(rows["u_random"] ** 2 + (rows[causes] ** 2).sum(axis=1))
        rows["flag"] = groups["flag"].max().to_numpy()
        rows[[name for name in (*MUELLER, *U_MUELLER, U_ANGLES) if name in rows.columns]] = np.nan  # was one state's
        left = pd.concat([left.drop(part.index), rows]).sort_index()
        count += len(rows)
    if not count:
        return frame
    out = left.reset_index(drop=True)
    note = f"{count} values were measured in every state of polarisation; taken is what unpolarised light would show"
    out.attrs = frame.attrs | {"notes": [*frame.attrs.get("notes", ()), note]}
    return out


FIRST = "first_element"
"""Column of `every_state`: the first element of a matrix [1/sr] that the row's value is a ratio times; else NaN."""


def every_state(frame: DataFrame) -> DataFrame:
    """The table with a row for each element of its Mueller matrices, after all others.

    Such a row has the word of the element (`gonio.polarisation.MUELLER`) and the index of the row that it comes from.
    Tables state elements over the first one, in which all that is common to both cancels. So the value is that ratio
    times the measured first element (column `first_element`), with the uncertainty of the ratio alone; where none is
    stated, with the relative one of the first element.
    """
    import pandas as pd

    parts = [frame]
    for element, word in polarisation.MUELLER.items():
        if element not in frame.columns or not (there := frame[element].notna()).any():
            continue
        rows = frame[there]
        stated = np.abs(rows["brdf"]) * rows[f"u_{element}"] if f"u_{element}" in rows else np.nan
        u = uncertainty(rows)[0]
        own = np.where(np.isfinite(stated), stated, u) if np.isfinite(u).any() else stated
        causes = {name: 0.0 for name in rows.columns if name.startswith("s_")}
        values = {"brdf": rows["brdf"] * rows[element], "u_random": own, "u_brdf": own, FIRST: rows["brdf"], **causes}
        parts.append(rows.assign(polarisation=word, **values))
    if len(parts) == 1:
        return frame
    out: DataFrame = pd.concat(parts)
    out.attrs = frame.attrs
    return out


def of_reader(table: DataFrame) -> list[str]:
    """What whoever read or made a table has to say of it, as sentences; a name keeps its letters."""
    notes = table.attrs.get("notes")
    told = (str(note).strip() for note in notes) if isinstance(notes, list | tuple) else ()
    every = (
        text if re.match(r"\S*[^a-z\s]|brdf\b|btdf\b", text) else text[:1].upper() + text[1:] for text in told if text
    )
    return list(dict.fromkeys(text if text.endswith((".", "!", "?")) else f"{text}." for text in every))


def said_once(several: Mapping[str, Sequence[str]]) -> list[str]:
    """Notes of several tables by their names, each with the names of all that it belongs to."""
    names: dict[str, list[str]] = {}
    for name, notes in several.items():
        for note in notes:
            names.setdefault(note, []).append(name)
    return [
        f"{', '.join(of) if len(of) < max(len(several), 2) else f'all {len(of)} tables'}: {note}"
        for note, of in names.items()
    ]


def split(spec: str | Path) -> tuple[str, str | None]:
    """`FILE:SAMPLE` on a command line in its parts; the sample is None where `spec` is a file's name as it stands."""
    text = str(spec)
    if not Path(text).exists():
        for colon in (k for k, letter in enumerate(text) if letter == ":"):
            if Path(text[:colon]).exists():
                return text[:colon], text[colon + 1 :]
    return text, None


def _choose(frame: DataFrame, sample: str, path: Path) -> DataFrame:
    names = frame.attrs["samples"] if "sample" in frame.columns else [frame.attrs.get("sample") or path.stem]
    listed = ", ".join(f'"{path}:{name}"' for name in names)
    meant = _meant(sample, names)
    if len(meant) != 1:
        several = f'{len(meant)} samples whose names begin or end with "{sample}"' if meant else f'no sample "{sample}"'
        part = channels.incomplete(meant, str(path))
        raise DataError(f"{path}: holds {several}; name one of {listed}" + (f"; {part}" if part else ""))
    if meant[0] != sample:
        note = f'the sample "{meant[0]}" is the one that "{sample}" names'
        frame.attrs["notes"] = [*frame.attrs.get("notes", ()), note]
    (sample,) = meant
    if "sample" not in frame.columns:
        return frame
    chosen = frame[frame["sample"] == sample].drop(columns="sample").reset_index(drop=True)
    chosen.attrs.update({key: value for key, value in frame.attrs.items() if key != "samples"} | {"sample": sample})
    chosen.attrs.pop("samples", None)
    own = [band for band in chosen.attrs["bands"] if str(band.get("name")) == sample.rpartition(" ")[2]]
    chosen.attrs["bands"] = own or chosen.attrs["bands"]  # colours and broad bands end their samples' names
    return chosen


def _meant(said: str, names: Sequence[str]) -> list[str]:
    """The names that are this one; else those that begin or end so, in any case of letters."""
    if said in names:
        return [said]
    low = " ".join(said.lower().split())
    same = [name for name in names if " ".join(name.lower().split()) == low]
    return same or [name for name in names if low and (name.lower().startswith(low) or name.lower().endswith(low))]


def _table_of_run(folder: Path) -> Path:
    path = folder / "brdf.csv"
    if os.path.lexists(path):
        return path
    if os.path.lexists(folder / "run.toml"):
        raise ConfigError(f"{folder}: this run has no brdf.csv yet; make it with: gonio reduce {folder}")
    raise ConfigError(f"{folder}: is a folder, but not a run (there is no run.toml and no brdf.csv in it)")


def _opened(path: Path) -> BinaryIO:
    try:
        return open(path, "rb", opener=only_file)
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise ConfigError(f"{str(path)!r}: is not a file name") from None


def _size(file: BinaryIO) -> int:
    """The bytes of a file, which is read from its beginning then."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    return size
