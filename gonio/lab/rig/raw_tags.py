"""What the directories of a TIFF-based raw file say (TIFF 6.0, TIFF/EP, EXIF, DNG 1.7), each field by its type.

Of a DNG what changes the meaning of its values is obeyed, or the file is refused with the tag named: interpretation,
samples, bits and format of a pixel, colour filters, levels of black and white, active area. What tells a viewer how to
turn or to develop the picture (Orientation, colour matrices, lists of opcodes) changes no count, and is passed over.
"""

import contextlib
import datetime
import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gonio.errors import DataError

EPOCH = datetime.datetime(1970, 1, 1)
MOST_PIXELS = 2**28
"""Most pixels of a frame: twice half a gigabyte."""
_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
"""How numbers lie in a TIFF file, by its first bytes."""
_BIG = (b"II+\0", b"MM\0+")
_WANTED = {
    *(254, 256, 257, 258, 259, 262, 270, 273, 274, 277, 278, 279, 305, 324, 325, 330, 339),
    *(33421, 33422, 33434, 34665, 36867, 37521),
    *(50706, 50710, 50711, 50712, 50713, 50714, 50715, 50716, 50717, 50829),
}
_TYPES = {
    1: ("B", 1), 2: ("s", 1), 3: ("H", 2), 4: ("I", 4), 5: ("II", 8), 6: ("b", 1), 7: ("B", 1), 8: ("h", 2),
    9: ("i", 4), 10: ("ii", 8), 11: ("f", 4), 12: ("d", 8), 13: ("I", 4),
}  # fmt: skip
"""TIFF 6.0 field types: struct code and size; of 5 and 10 a value is a quotient of two numbers."""
_MOST_VALUES = 70_000
"""Most values of one field: a black level for every column of a sensor, or an offset for every strip."""
_MOST_DIRECTORIES = 64
_CFA, _LINEAR_RAW = 32803, 34892
_INTERPRETATIONS = {
    0: "WhiteIsZero", 1: "BlackIsZero", 2: "RGB", 3: "a palette", 4: "a mask", 5: "CMYK", 6: "YCbCr", 8: "CIELab",
    52527: "a mask", 51177: "depth",
}  # fmt: skip
_COMPRESSIONS = {34892: "lossy JPEG"}
Fields = dict[int, Any]
"""Values by tag: bytes of a text, else a list of numbers."""


@dataclass
class Tags:
    """What the directories of a TIFF-based file say; None where they do not."""

    exposure_s: float | None = None
    black_level_dn: float | None = None
    white_level_dn: float | None = None
    pattern: str | None = None
    size: tuple[int, int] = (0, 0)
    """Rows and columns of a DNG's raw image, where `pattern` is known."""
    active: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Its first row and column that are meant, and the ones after the last."""
    time_s: float = math.nan
    own: Fields = field(default_factory=dict)
    """All fields of the image's directory, where this program wrote the file."""


def read(data: bytes, path: Path) -> Tags:
    """Walk the directories; refuse image data that reach beyond the end, which rawpy would fill with zeros.

    Raises
    ------
    DataError
        The file is truncated or damaged, or states what is not read (with the tag's name and value).
    """
    tags = Tags()
    if data[:4] in _BIG:
        raise DataError(f"{path}: is a BigTIFF (TIFF of 64 bits), which no raw file here is")
    if data[:4] not in _ORDERS:
        return tags  # CR3, RAF and others are containers of their own: rawpy judges them
    clock = b""
    try:
        every = _directories(data, path)
        for fields in every:
            if fields.get(305) == b"gonio":
                tags.own = fields
            if 33434 in fields and tags.exposure_s is None:
                tags.exposure_s = _exposure(fields[33434], path)
            if 36867 in fields and 37521 in fields:
                clock = fields[36867] + b"." + fields[37521]
        if every and 50706 in every[0]:
            _image(every, tags, path)
    except struct.error:
        raise DataError(f"{path}: is damaged: a directory reaches beyond the end at byte {len(data)}") from None
    except (TypeError, IndexError, ValueError, OverflowError) as error:
        raise DataError(f"{path}: is damaged: a directory holds what cannot be ({error})") from None
    if clock:
        with contextlib.suppress(ValueError):
            moment = datetime.datetime.strptime(clock.decode("ascii", "replace"), "%Y:%m:%d %H:%M:%S.%f")
            tags.time_s = (moment - EPOCH).total_seconds()
    return tags


def require_plain(data: bytes, path: Path) -> None:
    """`DataError` for a picture in TIFF whose numbers are not plain counts of grey or of RGB; others pass."""
    if data[:4] not in _ORDERS and data[:4] not in _BIG:
        return
    fields = first_directory(data)
    try:
        kind, form = (_one(fields, tag, default) for tag, default in ((262, 1), (339, 1)))
    except ValueError as error:
        raise DataError(f"{path}: is damaged: {error}") from None
    if kind not in (1, 2) or form != 1:
        raise DataError(
            f"{path}: PhotometricInterpretation = {kind:g} ({_INTERPRETATIONS.get(int(kind), 'unknown')}), SampleFormat"
            f" = {form:g}: a picture is read whose values are counts of light, 1 (BlackIsZero) or 2 (RGB), unsigned"
        )


def first_directory(data: bytes) -> Fields:
    """The fields of the first directory; nothing where there is none, or it is damaged."""
    order = _ORDERS.get(data[:4])
    if order is None:
        return {}
    try:
        return _directory(data, struct.unpack_from(order + "I", data, 4)[0], order)[0]
    except struct.error:
        return {}


def _directories(data: bytes, path: Path) -> list[Fields]:
    order = _ORDERS[data[:4]]
    queue, seen, out = [struct.unpack_from(order + "I", data, 4)[0]], set[int](), list[Fields]()
    while queue and len(seen) < _MOST_DIRECTORIES:
        at = queue.pop(0)
        if at == 0 or at in seen:
            continue
        seen.add(at)
        fields, following = _directory(data, at, order)
        queue += [following, *fields.get(34665, []), *fields.get(330, [])]
        for starts, sizes in ((273, 279), (324, 325)):  # of strips, and of tiles
            for start, size in zip(fields.get(starts, []), fields.get(sizes, []), strict=False):
                if (end := start + size) > len(data):
                    raise DataError(f"{path}: is truncated: its image ends at byte {end}, the file at {len(data)}")
        out.append(fields)
    return out


def _directory(data: bytes, at: int, order: str) -> tuple[Fields, int]:
    """The fields that matter here, and the offset of the next directory (0 for none)."""
    (count,) = struct.unpack_from(order + "H", data, at)
    fields: Fields = {}
    for k in range(count):
        tag, kind, items = struct.unpack_from(order + "HHI", data, at + 2 + 12 * k)
        if tag not in _WANTED or tag in fields or kind not in _TYPES:
            continue
        code, size = _TYPES[kind]
        place = at + 10 + 12 * k
        if items * size > 4:
            (place,) = struct.unpack_from(order + "I", data, place)
        if place + items * size > len(data):
            raise struct.error
        if kind == 2:
            fields[tag] = data[place : place + items].rstrip(b"\0 ")
            continue
        if items > _MOST_VALUES:
            raise ValueError(f"tag {tag} of {items} values")
        found = struct.unpack_from(f"{order}{items * len(code)}{code[0]}", data, place)
        fields[tag] = list(map(_quotient, found[::2], found[1::2])) if len(code) == 2 else list(found)
    (following,) = struct.unpack_from(order + "I", data, at + 2 + 12 * count)
    return fields, following


def _quotient(over: int, under: int) -> float:
    return over / under if under else math.nan


def _one(fields: Fields, tag: int, default: float) -> float:
    """A number of which there is one, or several that are the same."""
    values = fields.get(tag, [default])
    if isinstance(values, bytes) or not values or any(value != values[0] for value in values):
        raise ValueError(f"tag {tag} = {str(values)[:40]}")
    return float(values[0])


def _exposure(values: Any, path: Path) -> float | None:
    if isinstance(values, bytes) or len(values) != 1 or math.isinf(values[0]):
        raise DataError(f"{path}: ExposureTime (tag 33434) is {str(values)[:60]}; one number of seconds is needed")
    return None if math.isnan(values[0]) or values[0] == 0 else float(values[0])


def _image(every: list[Fields], tags: Tags, path: Path) -> None:
    """What the directory of a DNG's raw image says; `DataError` for what is not read."""
    full = [fields for fields in every if _one(fields, 254, 0.0) == 0 and 256 in fields]
    raw = [fields for fields in full if _one(fields, 262, -1.0) in (_CFA, _LINEAR_RAW)]
    if not full:
        return  # rawpy says what is wrong
    fields = (raw or full)[0]
    kind = int(_one(fields, 262, -1.0))

    def refuse(name: str, value: object, wanted: str) -> DataError:
        return DataError(f"{path}: {name} = {str(value)[:60]}: {wanted}")

    if kind not in (_CFA, _LINEAR_RAW):
        shown = f"{kind} ({_INTERPRETATIONS.get(kind, 'unknown')})"
        raise refuse("PhotometricInterpretation", shown, f"read are {_CFA} (colour filters) and {_LINEAR_RAW} (linear)")
    for name, tag, default, ok, wanted in (
        ("SamplesPerPixel", 277, 1, (1,), "a mosaic holds one sample a pixel"),
        ("BitsPerSample", 258, 16, range(1, 17), "at most 16 bits are read"),
        ("SampleFormat", 339, 1, (1,), "only unsigned whole numbers (1) are counts of a sensor"),
        ("CFALayout", 50711, 1, (1,), "only filters in a rectangle (1) are read"),
    ):
        values = fields.get(tag, [default])
        if isinstance(values, bytes) or not values or any(value not in ok for value in values):
            raise refuse(name, values, wanted)
    if (how := int(_one(fields, 259, 1.0))) in _COMPRESSIONS:
        raise refuse("Compression", f"{how} ({_COMPRESSIONS[how]})", "values that lost something are no counts")
    rows, columns = (int(_one(fields, tag, 0.0)) for tag in (257, 256))
    if rows * columns > MOST_PIXELS:
        raise refuse("ImageLength x ImageWidth", f"{rows} x {columns}", f"at most {MOST_PIXELS} pixels are read")
    top, left, bottom, right = map(int, fields.get(50829, [0, 0, rows, columns]))
    if not (0 <= top < bottom <= rows and 0 <= left < right <= columns):
        raise refuse("ActiveArea", [top, left, bottom, right], f"it lies within {rows} x {columns} pixels")
    tags.size, tags.active = (rows, columns), (top, left, bottom, right)
    tags.pattern = _pattern(fields, path) if kind == _CFA else "mono"
    tags.black_level_dn, tags.white_level_dn = _black(fields, (bottom - top, right - left), path), _white(fields, path)


def _pattern(fields: Fields, path: Path) -> str:
    dimensions, cells = fields.get(33421, []), fields.get(33422, [])
    if list(dimensions) != [2, 2] or len(cells) != 4:
        raise DataError(
            f"{path}: CFARepeatPatternDim = {str(dimensions)[:40]}, CFAPattern of {len(cells)} cells: colour filters "
            "are read that repeat after 2 x 2 pixels (Bayer)"
        )
    if list(fields.get(50710, [0, 1, 2])) != [0, 1, 2] or any(cell not in (0, 1, 2) for cell in cells):
        raise DataError(
            f"{path}: CFAPlaneColor = {str(fields.get(50710, [0, 1, 2]))[:40]}, CFAPattern = {cells}: "
            "filters are read that are red (0), green (1) and blue (2)"
        )
    return "".join("RGB"[int(cell)] for cell in cells)


def _black(fields: Fields, shape: tuple[int, int], path: Path) -> float:
    """The mean black level over the sensor [DN]: of the repeated pattern, and of what rows and columns add."""
    repeat = fields.get(50713, [1, 1])
    level = 0.0
    for name, tag, count in (
        ("BlackLevel", 50714, math.prod(repeat)),
        ("BlackLevelDeltaH", 50715, shape[1]),
        ("BlackLevelDeltaV", 50716, shape[0]),
    ):
        if tag not in fields:
            continue
        values = fields[tag]
        good = not isinstance(values, bytes) and len(values) == count and all(map(math.isfinite, values))
        if not good or (tag == 50714 and min(values) < 0):
            raise DataError(
                f"{path}: {name} (tag {tag}) = {str(values)[:40]}; {count} numbers are needed, by BlackLevelRepeatDim "
                f"= {repeat} and an active area of {shape[0]} x {shape[1]}"
            )
        level += sum(values) / count
    return level


def _white(fields: Fields, path: Path) -> float | None:
    values = fields.get(50717)
    if values is None:
        return None
    if isinstance(values, bytes) or len(set(values)) != 1 or not 0 < values[0] <= 65535:
        raise DataError(f"{path}: WhiteLevel (tag 50717) = {str(values)[:40]}; one level up to 65535 is needed")
    return float(values[0])
