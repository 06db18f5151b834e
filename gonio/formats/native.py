"""The project's own table: a CSV that a bare `pandas.read_csv` opens, and `<name>.meta.json` beside it.

A table made by hand may leave out what it does not know: the four angles and `brdf` are enough.
"""

import codecs
import contextlib
import csv
import io
import itertools
import json
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gonio import polarisation
from gonio.disk import is_stream, read_file, require_name
from gonio.errors import ConfigError, DataError
from gonio.formats.column_hints import NEEDED, column_hints
from gonio.formats.reader import (
    COLUMNS,
    EXTRA,
    LARGEST,
    MUELLER,
    NO_TEXT,
    SIDES,
    U_ANGLES,
    U_MUELLER,
    Attributes,
    Format,
    attributes,
    flag_holes,
    quantity,
    require_held,
    require_place,
    write_bytes,
)
from gonio.formats.sheets import WORDS
from gonio.formats.text import (
    DecimalMark,
    cell_of,
    column_names,
    decode,
    number,
    plain_word,
    require_cells,
    require_text,
    separator,
)
from gonio.typing import Bools, DataFrame, Floats, Series

_TEXTS = ("sample", "flag")
"""Words that are anybody's."""
_DEFAULTS: dict[str, float | str] = {
    "wavelength_nm": math.nan,
    "polarisation": "unpolarised",
    "u_brdf": math.nan,
    "u_random": math.nan,
    "flag": "",
}
"""What a file that lacks the column means."""
CHUNK = 200_000
"""Rows that pandas reads at once: its memory beside the table grows with them."""
LITTLE = 1 << 15
"""Bytes of a file below which the reader that goes line by line is the faster one: 300 rows."""
_BLOCK = 1 << 22
"""Bytes that are looked at together."""
_SURPRISE = re.compile(rb"[\x00-\x08\x0d-\x1f\x7f\"']")
"""Control characters, carriage returns and quotes."""
_WIDE = 1000
"""Columns from which on pandas takes longer than the reader that goes line by line."""
MOST_ROWS = 20_000_000
"""Most rows of a table that is read at once."""
ROUNDED = 0.01
"""Relative: by so much rounding to two digits can make a part larger than the whole."""


def meta_path(path: str | Path) -> Path:
    """Where the attributes of the table at `path` lie."""
    return Path(path).with_suffix(".meta.json")


def read(file: BinaryIO, path: Path, stored: Any = None) -> DataFrame:
    """The table, its numbers to the last bit, and its attributes: `stored`, or those that lie beside the file."""
    data = file.read(LITTLE)
    little = len(data) < LITTLE
    file.seek(0)
    frame = None if little else _read_in_pieces(file)
    if frame is None:
        if not little:
            file.seek(0)
            data = file.read()
        require_text(data, path, MOST_ROWS)
        frame = _read_line_by_line(decode(data, path), path)
        for name in _TEXTS:
            if name in frame.columns:
                frame[name] = _per_word(frame[name], plain_word)
    return _completed(
        frame, checked_attributes(stored, str(path)) if stored else _read_attrs(path, quantity(frame)), path
    )


def require_kinds(frame: DataFrame, path: Path) -> None:
    """`DataError` unless these are columns of a measurement table, with words and numbers where they belong."""
    check_columns(list(frame.columns), str(path), needed=NEEDED)
    for name in frame.columns:
        if (frame[name].dtype.kind in "biuf") == (name in WORDS):
            raise DataError(f"{path}: the column {name} holds {'words' if name not in WORDS else 'numbers'}")


def taken(frame: DataFrame, stored: Any, path: Path) -> DataFrame:
    """The table of columns and attributes that another file format has kept; `DataError` where they are none."""
    require_kinds(frame, path)
    attrs = checked_attributes(stored, str(path)) if stored else attributes(quantity=quantity(frame))
    return _completed(frame, attrs, path)


def of_columns(columns: Mapping[str, Any], lines: Sequence[int], path: Path) -> DataFrame:
    """The table of these columns, which stand in these lines of a file, with the attributes that lie beside it."""
    import pandas as pd

    frame = pd.DataFrame(dict(columns))
    check_columns(list(frame.columns), str(path), needed=NEEDED)
    for name in _TEXTS:
        if name in frame.columns:
            frame[name] = _per_word(frame[name], plain_word)
    return _completed(frame, _read_attrs(path, quantity(frame)), path, lines)


def _completed(frame: DataFrame, attrs: Attributes, path: Path, lines: Sequence[int] | None = None) -> DataFrame:
    """The table with the columns that a file may lack, and its attributes; `DataError` where a value is not allowed."""
    absent = [name for name in _DEFAULTS if name not in frame.columns]
    read_as = frame.attrs.pop("notes", [])
    if absent:
        causes = [name for name in frame.columns if name.startswith("s_")]
        frame = frame.assign(**{name: _DEFAULTS[name] for name in absent})
        words, numbers = ([name for name in some if name in frame.columns] for some in (EXTRA[:2], EXTRA[2:]))
        frame = frame[[*COLUMNS[:6], *words, *COLUMNS[6:9], *causes, *numbers, "flag"]]
    flag_holes(frame)  # before the attributes, which each access to a column would copy
    check(frame, lambda row: f"{path}, line {lines[row] if lines is not None else row + 2}")
    lacking = [f"the file has no columns {', '.join(absent)}: taken as unknown, or none"] if absent else []
    notes = [*read_as, *attrs["notes"], *lacking, *frame.attrs.get("notes", [])]
    frame.attrs.update(attrs | {"notes": notes})
    return frame


def _read_in_pieces(file: BinaryIO) -> DataFrame | None:
    """The columns of a file without quotes, blank lines and other surprises, quickly; None for any other file.

    Neither its bytes nor its text are ever in memory as a whole.
    """
    import pandas as pd

    first = file.readline(_BLOCK)
    begin = len(codecs.BOM_UTF8) if first.startswith(codecs.BOM_UTF8) else 0
    header = first[begin:].decode("ascii", "replace").removesuffix("\n").split(",")
    if len(header) > _WIDE:
        return None
    lines, commas, end = 0, 0, b""
    file.seek(begin)
    while block := file.read(_BLOCK):
        if not block.isascii() or _SURPRISE.search(block):
            return None
        lines, commas, end = lines + block.count(b"\n"), commas + block.count(b","), block[-1:]
    lines += end != b"\n"
    if lines > 2 * MOST_ROWS or commas != lines * (len(header) - 1):
        return None
    file.seek(begin)
    try:
        check_columns(header, "", needed=NEEDED)
        words = [name for name in WORDS if name in header]
        kinds: dict[str, type[str | np.float64]] = {name: str if name in words else np.float64 for name in header}
        empty: Any = {name: ["", "nan", "NaN"] for name in header if name not in words}
        # exact by default since pandas 3.1, which asks not to say so
        exact: Any = {"float_precision": "round_trip"} if pd.__version__ < "3.1" else {}
        with pd.read_csv(
            file,
            dtype=kinds,
            index_col=False,
            keep_default_na=False,
            na_values=empty,
            skip_blank_lines=False,
            chunksize=CHUNK,
            **exact,
        ) as chunks:
            frame = together(chunks, header, lines - 1)
        if frame is None:
            return None
        whole = frame.assign(**{name: value for name, value in _DEFAULTS.items() if name not in header})
        flag_holes(whole)
        check(whole, str)
    except (DataError, ValueError, OverflowError, pd.errors.ParserWarning):
        return None  # the slow reader says what is wrong, and where
    return frame


def together(chunks: Iterable[DataFrame], header: Sequence[str], rows: int) -> DataFrame | None:
    """Pieces of a table as one, without holding a row twice; None where they have not `rows` rows."""
    import pandas as pd

    columns: dict[str, Any] = {name: [] if name in WORDS else np.empty(rows) for name in header}
    same: dict[tuple[str, int], Series] = {}
    end = 0
    for chunk in chunks:
        begin, end = end, end + len(chunk)
        if end > rows:
            return None
        for name, column in columns.items():
            words = chunk[name]
            if name not in WORDS:
                column[begin:end] = words.to_numpy()
                continue
            words = words.fillna("")
            if len(alone := words.unique()) == 1:  # one piece serves for all that say the same
                column.append(same.setdefault((alone[0], len(words)), words))
            else:
                column.append(words)
    if end != rows or not rows:
        return None
    for name in (name for name in header if name in WORDS):
        columns[name] = pd.concat(columns[name], ignore_index=True)
    return pd.DataFrame(columns, copy=False)


def _read_line_by_line(text: str, path: Path) -> DataFrame:
    """The columns of any file, as text and numbers; messages name line and column."""
    import pandas as pd

    mark = separator(text)
    decimal = None if mark == "," else DecimalMark(path)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=mark, strict=True)
    try:
        header = next(reader, [])
        check_columns(header, f"{path}, line 1", needed=NEEDED)
        parts: list[list[Any]] = [[] for _ in header]
        line = 2
        while chunk := list(itertools.islice(reader, 20_000)):
            for row, cells in enumerate(chunk):
                require_cells(cells, header, f"{path}, line {line + row}")
            for part, name, column in zip(parts, header, zip(*chunk, strict=True), strict=True):
                part.append(_column(column, name, path, line, decimal))
            line += len(chunk)
    except csv.Error as error:
        raise DataError(f"{path}, line {reader.line_num}: {error}") from None
    if line == 2:
        raise DataError(f"{path}: has a header and no rows")
    frame = pd.DataFrame({name: np.concatenate(part) for name, part in zip(header, parts, strict=True)})
    if decimal is not None:
        decimal.require_settled()
        frame.attrs["notes"] = decimal.notes()
    return frame


def write(frame: DataFrame, path: Path) -> None:
    """The table, its numbers to the last bit, and its attributes beside it."""
    check_columns(list(frame.columns), str(path))
    check(frame, lambda row: f"{path}, row {row + 1}")
    words = [name for name in _TEXTS if name in frame.columns]
    for word in (str(word) for name in words for word in frame[name].unique()):
        require_held(word, path, "a CSV", NO_TEXT)
    cells = frame.assign(**{name: _per_word(frame[name], cell_of) for name in words})
    # pandas writes a carriage return without quotes, as if it ended no line
    ends = any("\r" in word for name in words for word in cells[name].unique())
    quoting: Any = csv.QUOTE_NONNUMERIC if ends else csv.QUOTE_MINIMAL
    try:
        meta = json.dumps(plain(frame.attrs), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: an attribute of the table cannot be written as JSON: {error}") from None
    require_place(path)
    if not is_stream(path):  # nothing lies beside standard output, a pipe or a device
        _require_own_attributes(meta_path(path))
        write_bytes(meta_path(path), meta.encode())
    write_bytes(path, _as_csv(cells, quoting))


def _as_csv(cells: DataFrame, quoting: Any) -> Iterator[bytes]:
    """The text of a table, some rows after the other."""
    for begin in range(0, len(cells), CHUNK):
        # pandas writes numbers as numpy prints them, and a package may have set that to twelve digits (colour-science
        # does)
        with np.printoptions(legacy=False):
            some = cells.iloc[begin : begin + CHUNK]
            text = some.to_csv(index=False, header=begin == 0, lineterminator="\n", quoting=quoting)
        yield text.encode()


def _require_own_attributes(meta: Path) -> None:
    """Nobody has named the file beside the table: `ConfigError` where one is there that holds something else."""
    require_name(meta)
    if not os.path.lexists(meta):
        return
    stored = None
    with contextlib.suppress(OSError, ValueError, RecursionError):
        stored = json.loads(read_file(meta))
    if not isinstance(stored, dict) or not stored.keys() <= attributes().keys() | {"samples", "format"}:
        raise ConfigError(f"{meta}: is not the attributes of a table, and is not replaced; give the table another name")


def check_columns(header: list[str], where: str, *, needed: tuple[str, ...] = COLUMNS) -> None:
    """`DataError` unless these are the columns of a measurement table, each once, and the `needed` ones are there."""
    missing = [name for name in needed if name not in header]
    extra = [n for n in header if n not in COLUMNS and n not in EXTRA and not (n.startswith("s_") and len(n) > 2)]
    twice = sorted(name for name, count in Counter(header).items() if count > 1)
    for names, what in ((missing, "missing"), (extra, "not known"), (twice, "there twice")):
        if names:
            shown = ", ".join(repr(n if len(n) <= 40 else n[:37] + "...") for n in names[:8])
            known = f"a measurement table has {', '.join(NEEDED)}, and may have {', '.join(_DEFAULTS)}, side, "
            known += "s_<cause> and m01 to m33"
            hints = "".join(f"; {hint}" for hint in column_hints(header))
            raise DataError(f"{where}: columns {what}: {shown}{hints}; {known}")


def check(frame: DataFrame, where: Any) -> None:
    """`DataError` naming row and column of the first value that is not allowed; `where(row)` says where a row lies."""
    if len(frame) == 0:
        raise DataError(f"{where(0)}: the table has no rows")
    bare = frame.copy(deep=False)
    bare.attrs = {}  # which each access to a column would copy
    there = {name: bare[name] for name in bare.columns}
    flagged = ~np.asarray(_one_of(there["flag"], lambda word: word == ""))

    def demand(ok: Any, column: str, allowed: str) -> None:
        bad = np.flatnonzero(~np.asarray(ok, dtype=bool))
        if bad.size:
            value = there[column].iloc[int(bad[0])]
            shown = f"{value:.9g}" if isinstance(value, float) else repr(value)[:40]
            raise DataError(f"{where(int(bad[0]))}: {column} = {shown}; {allowed}")

    def of(column: str) -> Floats:
        return there[column].to_numpy(np.float64)

    def known(values: Floats) -> Bools:
        """Which are unknown (NaN), or finite and not negative."""
        return np.isnan(values) | ((values >= 0) & np.isfinite(values))

    _check_angles(there, demand)
    wavelength, value = of("wavelength_nm"), of("brdf")
    demand(known(wavelength) & (wavelength != 0), "wavelength_nm", "a positive number, or NaN for a broad band")
    told = "from 100 to 200000 nanometres; of a column in micrometres: --columns wavelength=NAME:um"
    demand(~((wavelength < 100.0) | (wavelength > 200_000.0)), "wavelength_nm", told)
    words = _one_of(there["polarisation"], lambda word: word in polarisation.WORDS)
    demand(words, "polarisation", polarisation.SAID)
    demand(np.isfinite(value) | flagged, "brdf", "a row without a flag needs a finite value [1/sr]")
    for column in (name for name in ("u_brdf", "u_random", U_ANGLES) if name in there):
        told = "a standard uncertainty [1/sr] >= 0, or NaN where it is unknown"
        demand(known(of(column)) | flagged, column, told)
    combined = of("u_brdf")
    part = np.nan_to_num(of("u_random")) <= (1.0 + ROUNDED) * combined
    demand(part | np.isnan(combined) | flagged, "u_random", "a part of the combined u_brdf, and at most as large")
    for column in (name for name in MUELLER if name in there):
        told = "an element of the Mueller matrix over the first one, or NaN where unknown"
        demand(~np.isinf(of(column)), column, told)
    for column in (name for name in U_MUELLER if name in there):
        demand(known(of(column)), column, "a standard uncertainty >= 0, or NaN")
    for column in (name for name in there if name.startswith("s_")):
        demand(np.isfinite(of(column)) | flagged, column, "a row without a flag needs a finite value [1/sr]")
    for column in (name for name in ("flag", "sample") if name in there):
        demand(_one_of(there[column], lambda word: isinstance(word, str)), column, "text is needed")


def _check_angles(there: Mapping[str, Series], demand: Callable[[Any, str, str], None]) -> None:
    through = nowhere = np.zeros(len(there["theta_i_deg"]), dtype=bool)
    if "side" in there:
        demand(_one_of(there["side"], lambda word: word in SIDES), "side", f"one of {', '.join(SIDES)}")
        through = (there["side"] == "transmission").to_numpy()
    polar = "polar angles lie in [0, 90] degrees; write (-theta, phi) as (theta, phi + 180)"
    seen = polar + '; of transmission they go on to 180, in rows whose column "side" says "transmission"'
    told = 'a row whose column "side" says "transmission" has its detector behind the sample, in (90, 180] degrees'
    for column, behind, stated in (("theta_i_deg", nowhere, polar), ("theta_r_deg", through, seen)):
        theta = there[column].to_numpy(np.float64)
        demand(behind | ((theta >= 0) & (theta <= 90)), column, stated)
        demand(~behind | ((theta > 90) & (theta <= 180)), column, told)
    for column in ("phi_i_deg", "phi_r_deg"):
        phi = there[column].to_numpy(np.float64)
        demand((phi >= 0) & (phi < 360), column, f"azimuths lie in [0, 360) degrees; {_TURNED}")


_TURNED = (
    "write 360 as 0 and -90 as 270, and no direction twice; or --columns with the four angles reads them as they are"
)


def _per_word(words: Series, change: Callable[[str], str]) -> Series:
    """The words, changed; each different word is looked at once."""
    changed = {word: change(word) for word in words.unique()}
    return words.map(changed) if any(old != new for old, new in changed.items()) else words


def _one_of(words: Series, allowed: Callable[[Any], bool]) -> Any:
    """Which rows have an allowed word; each different word is looked at once."""
    bad = [word for word in words.unique() if not allowed(word)]
    return ~words.isin(bad) if bad else np.ones(len(words), dtype=bool)


def _column(cells: Sequence[str], name: str, path: Path, line: int, decimal: DecimalMark | None) -> Any:
    """The words or the numbers of some rows of a column, from a line on."""
    if name in WORDS:
        return np.array(cells, dtype=object)
    if decimal is not None:
        cells = decimal.plain(cells, lambda row: f"{path}, line {line + row}", name)
    return _floats(cells, name, path, line)


def _floats(cells: Sequence[str], name: str, path: Path, line: int) -> Floats:
    """A column of numbers, NaN where the cell is empty; exact, as Python reads them."""
    joined = "".join(cells)
    if joined.isascii() and "_" not in joined:
        with contextlib.suppress(ValueError):  # below it is said which cell is wrong
            return np.array([float(cell or "nan") for cell in cells])
    holes = ("", "nan", "NaN")
    where = (f"{path}, line {line + row}" for row in range(len(cells)))
    return np.array([math.nan if c in holes else number(c, at, name) for c, at in zip(cells, where, strict=True)])


def _read_attrs(path: Path, known: str = "brdf") -> Attributes:
    meta = meta_path(path)
    try:
        stored = json.loads(read_file(meta))
    except FileNotFoundError:
        note = f"there is no {meta.name} beside the table, so its solid angles and provenance are unknown"
        return attributes(quantity=known, source_file=str(path), notes=[note])
    except OSError as error:
        raise DataError(f"{meta}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"{meta}: is not valid JSON: {error}") from None
    return checked_attributes(stored, str(meta))


def checked_attributes(stored: Any, where: str) -> Attributes:
    """Attributes from a file, with defaults for what is not there; `DataError` where one is of the wrong kind."""
    if not isinstance(stored, dict):
        raise DataError(f"{where}: an object of attributes is needed")
    for key in ("source_solid_angle_sr", "receiver_solid_angle_sr"):
        value = stored.get(key)
        known = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 2 * math.pi
        if value is not None and not known:
            raise DataError(f"{where}: {key} is {repr(value)[:40]}; a solid angle [sr], or null where it is unknown")
    kinds = {"quantity": str, "bands": list, "sample": str, "notes": list, "provenance": dict, "source_file": str}
    for key, kind in kinds.items():
        if stored.get(key) is not None and not isinstance(stored[key], kind):
            raise DataError(f"{where}: {key} is {repr(stored[key])[:40]}; a {kind.__name__} is needed")
    return attributes(**stored)


def plain(value: Any) -> Any:
    """Attributes as JSON has them."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return str(value) if isinstance(value, Path) else value


FORMAT = Format(
    name="gonio",
    title="measurement table",
    endings=(".csv",),
    sniff=lambda head: {"theta_i_deg", "brdf"} <= set(column_names(head)),
    read=read,
    in_pieces=True,
    write=write,
    max_bytes=LARGEST,
    carries=frozenset({"uncertainty", "flag", "solid angle", "transmission", "mueller"}),
)


def uncertainty(frame: DataFrame) -> tuple[Floats, Floats, list[str]]:
    """The covariance of a table's values in factors: C = diag(u_random^2) + S S^T.

    Returns
    -------
    u_random : (n,) array [1/sr]
        Independent part. Where a file states only a combined uncertainty it counts as independent; NaN where none is
        stated.
    S : (n, k) array [1/sr]
        One signed column a common cause.
    causes : list of str
        The names of the k causes, without `s_`.
    """
    columns = [name for name in frame.columns if name.startswith("s_")]
    common = np.empty((len(frame), len(columns)))
    for k, name in enumerate(columns):
        common[:, k] = frame[name].to_numpy(np.float64)
    independent = frame["u_random"].to_numpy(np.float64)
    rest = np.sqrt(np.maximum(frame["u_brdf"].to_numpy(np.float64) ** 2 - (common**2).sum(axis=1), 0.0))
    return np.where(np.isnan(independent), rest, independent), common, [name.removeprefix("s_") for name in columns]
