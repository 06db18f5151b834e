"""Raw frames on disk: DNG written atomically; our own read back directly, other DNG and makers' RAW through rawpy.

The writer makes the smallest DNG 1.4 file that raw converters open: one uncompressed strip, as a Bayer mosaic or as a
monochrome LinearRaw image, 12-bit packed where the white level allows it and 16-bit otherwise. The exposure is an
exact rational of the EXIF directory.

Tags are read by their type and count. A black level of several values (`BlackLevelRepeatDim`, `BlackLevelDeltaH` and
`V`) is their mean, for frames are measured against dark frames pixel by pixel. Refused by name: filters that do not
repeat after 2 x 2 pixels (X-Trans), interpretations besides CFA and LinearRaw, several samples, formats that are not
unsigned, lossy compression, several white levels, BigTIFF. Orientation and lists of opcodes change no count and are
passed over.
"""

import datetime
import hashlib
import struct
from fractions import Fraction
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from gonio.disk import read_file, write_whole
from gonio.errors import ArgumentError, DataError, os_error_as
from gonio.lab.rig import raw_tags
from gonio.lab.rig.protocols import Frame
from gonio.lab.rig.raw_tags import EPOCH
from gonio.typing import NDArray

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
_OWN = {
    *(254, 256, 257, 258, 259, 262, 270, 273, 274, 277, 278, 279, 305),
    *(33421, 33422, 34665, 50706, 50714, 50717),
}
"""Tags that are read, and that a file of our own may have: with any other it is read as anybody's."""
_LATEST_S = (datetime.datetime(9999, 12, 31) - EPOCH).total_seconds()
_LARGEST = 2**32 - 1
# TIFF 6.0 field types: struct code and size
_TYPES = {1: ("B", 1), 2: ("c", 1), 3: ("H", 2), 4: ("I", 4), 5: ("II", 8), 7: ("B", 1), 9: ("i", 4), 10: ("ii", 8)}


def write_dng(frame: Frame, path: str | Path) -> None:
    """Write a frame as a DNG file, so that `path` either holds the whole file or is not touched.

    The file is written under a temporary name in the same folder, synced to the disk, and then renamed. Values fit
    into packed 12-bit words where `white_level_dn` is at most 4095, and into 16-bit words otherwise. The rig's clock
    stands in DateTime and SubSecTime, to the microsecond, counted from 1970-01-01 00:00:00; the frame's record (in
    ASCII) in ImageDescription.

    Parameters
    ----------
    frame
        The mosaic, shape (rows, columns), with its exposure [s] (kept as the closest rational of 32-bit integers,
        which restores the float to its last digits), its levels [DN] and its pattern ("mono" or a Bayer pattern in
        raster order).

    Raises
    ------
    ArgumentError
        The frame is not a two-dimensional array of 16-bit values of at least 32 x 32 pixels, its pattern is unknown, a
        value lies above the white level, or exposure, time or levels are not numbers that the format can hold.
    DataError
        The file cannot be written.
    """
    path = Path(path)
    with os_error_as(DataError, f"{path}: the frame cannot be written"):
        write_whole(path, encode_dng(frame))


def _check(frame: Frame) -> None:
    mosaic = frame.mosaic
    if mosaic.ndim != 2 or mosaic.dtype != np.uint16 or min(mosaic.shape) < 32:
        raise ArgumentError(
            f"mosaic: shape {mosaic.shape} of {mosaic.dtype}; a frame is two-dimensional, uint16, at least 32 x 32"
        )
    if frame.pattern != "mono" and frame.pattern not in BAYER:
        raise ArgumentError(f'pattern = "{frame.pattern}": known are mono, {", ".join(BAYER)}')
    if not 0 < frame.exposure_s <= 1e6:
        raise ArgumentError(f"exposure_s = {frame.exposure_s!r} must be positive, and at most 1e6 s")
    if not 0 <= frame.time_s < _LATEST_S:
        raise ArgumentError(f"time_s = {frame.time_s!r} must be at least 0, and seconds that reach to the year 9999")
    if not 0 < frame.white_level_dn <= 65535 or not 0 <= frame.black_level_dn < frame.white_level_dn:
        raise ArgumentError(
            f"black_level_dn = {frame.black_level_dn!r}, white_level_dn = {frame.white_level_dn!r}: "
            "0 <= black < white <= 65535 is needed"
        )
    top = int(mosaic.max())
    if top > frame.white_level_dn:
        raise ArgumentError(f"mosaic holds {top} DN, above white_level_dn = {frame.white_level_dn:g}")


def pixels_sha256(mosaic: NDArray[np.uint16]) -> str:
    """SHA-256 of a mosaic's pixels in raster order, two bytes each, the lower one first: whatever packs them."""
    return hashlib.sha256(np.ascontiguousarray(mosaic, dtype="<u2").data).hexdigest()


def encode_dng(frame: Frame, record: str = "") -> bytes:
    """The bytes of the DNG file of a frame; with a record, where the frame has none of its own.

    Raises
    ------
    ArgumentError
        See `write_dng`.
    """
    return b"".join(dng_pieces(frame, record))


def dng_pieces(frame: Frame, record: str = "") -> tuple[bytes, memoryview]:
    """What `encode_dng` gives, in two pieces: of large frames the second is the mosaic itself."""
    _check(frame)
    record = record or frame.record
    rows, columns = frame.mosaic.shape
    bits = 12 if frame.white_level_dn <= 4095 else 16
    if bits == 12:
        from gonio.lab.rig._dng_packing import pack12

        strip = np.empty((rows, (3 * columns + 1) // 2), dtype=np.uint8)
        pack12(frame.mosaic, strip)
    else:
        strip = np.ascontiguousarray(frame.mosaic, dtype="<u2")
    kind = (rows, columns, bits, frame.pattern, frame.black_level_dn, frame.white_level_dn)
    empty, at = _head(*kind, len(record))
    t = EPOCH + datetime.timedelta(seconds=frame.time_s)
    stamp = f"{t.year:04d}:{t.month:02d}:{t.day:02d} {t.hour:02d}:{t.minute:02d}:{t.second:02d}".encode()
    head = bytearray(empty)
    struct.pack_into("<II", head, at[33434], *_rational(frame.exposure_s))
    for tag, value in ((36867, stamp), (306, stamp), (37521, f"{t.microsecond:06d}".encode())):
        head[at[tag] : at[tag] + len(value)] = value
    if record:
        head[at[270] : at[270] + len(record)] = record.encode("ascii")
    return bytes(head), strip.reshape(-1).view(np.uint8).data


@lru_cache(256)
def _head(
    rows: int, columns: int, bits: int, pattern: str, black_dn: float, white_dn: float, record: int
) -> tuple[bytes, dict[int, int]]:
    """All that stands before the strip in frames of one kind with records of one length, and where the values of tags
    lie in it; exposure, times and record are left empty.
    """
    stamp = _text("0000:00:00 00:00:00")
    main: dict[int, tuple[int, Any]] = {
        254: (4, [0]),  # the full image
        256: (4, [columns]),
        257: (4, [rows]),
        258: (3, [bits]),
        259: (3, [1]),  # uncompressed
        262: (3, [34892 if pattern == "mono" else 32803]),  # LinearRaw or CFA
        271: (2, _text("gonio")),
        272: (2, _text("gonio goniometer camera")),
        273: (4, [0]),  # where the strip starts
        274: (3, [1]),
        277: (3, [1]),
        278: (4, [rows]),
        279: (4, [rows * ((bits * columns + 7) // 8)]),
        284: (3, [1]),
        305: (2, _text("gonio")),
        306: (2, stamp),
        34665: (4, [0]),  # EXIF directory
        50706: (1, [1, 4, 0, 0]),
        50707: (1, [1, 1, 0, 0]),
        50708: (2, _text("gonio goniometer camera")),
        50714: (5, _rational(black_dn)),
        50717: (4, [round(white_dn)]),
        50721: (10, [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]),  # ColorMatrix1: identity
        50778: (3, [23]),  # D50
    }
    if pattern == "mono":
        main[50721] = (10, [1, 1])
    else:
        main |= {33421: (3, [2, 2]), 33422: (1, ["RGB".index(colour) for colour in pattern])}
    if record:
        main[270] = (2, bytes(record + 1))  # ImageDescription
    exif: dict[int, tuple[int, Any]] = {
        33434: (5, [0, 0]),  # ExposureTime
        34855: (3, [100]),  # ISO; LibRaw reads it here only
        36867: (2, stamp),  # DateTimeOriginal
        37521: (2, _text("000000")),  # SubSecTimeOriginal
    }
    header_size = 8
    at_exif = header_size + len(_directory(main, header_size)[0])
    behind, at = _directory(exif, at_exif)
    start = -(-(at_exif + len(behind)) // 16) * 16
    main[273], main[34665] = (4, [start]), (4, [at_exif])
    front, at_main = _directory(main, header_size)
    return (struct.pack("<2sHI", b"II", 42, header_size) + front + behind).ljust(start, b"\0"), at | at_main


@lru_cache(1024)
def _rational(value: float) -> tuple[int, int]:
    fraction = Fraction(value).limit_denominator(int(_LARGEST / max(value, 1.0)))
    return fraction.numerator, fraction.denominator


def _text(text: str) -> bytes:
    return text.encode("ascii") + b"\0"


def _directory(tags: dict[int, tuple[int, Any]], offset: int) -> tuple[bytes, dict[int, int]]:
    """A TIFF image file directory that starts at `offset`, with its values behind it, and where each value lies."""
    entries, values, at = struct.pack("<H", len(tags)), b"", {}
    behind = offset + 2 + 12 * len(tags) + 4
    for tag, (kind, items) in sorted(tags.items()):
        code, size = _TYPES[kind]
        data = items if kind == 2 else struct.pack(f"<{len(items)}{code[0]}", *items)
        entries += struct.pack("<HHI", tag, kind, len(data) // size)
        if len(data) <= 4:
            at[tag] = offset + len(entries)
            entries += data.ljust(4, b"\0")
        else:
            at[tag] = behind + len(values)
            entries += struct.pack("<I", at[tag])
            values += data + b"\0" * (len(data) % 2)
    return entries + b"\0\0\0\0" + values, at


def read_raw(path: str | Path, data: bytes | None = None) -> Frame:
    """Read a raw frame: the linear mosaic exactly as it lies in the file (DNG, CR2, NEF, ARW, ...).

    A file that `write_dng` wrote is read directly, many times faster than through rawpy, which reads all others. Of
    these, too, exposure, levels and clock come from the directories, where rawpy rounds them. A black level of several
    values (of colours, rows or columns) is their mean: frames are measured against dark frames, pixel by pixel. A file
    that does not say its time to a fraction of a second has `time_s` = NaN. The mosaic stays as the sensor has it,
    within the active area: how a viewer would turn or develop it changes no count.

    Parameters
    ----------
    path
        The file; named in messages and in the frame's `file`.
    data
        The file's bytes, where the caller holds them already.

    Raises
    ------
    DataError
        The file is missing, truncated, damaged, not a raw file, has several samples a pixel, colour filters that are
        not 2 x 2, or values that are not plain counts (with the tag that says so); or it does not say its exposure.
    """
    path = Path(path)
    if data is None:
        with os_error_as(DataError, f"{path}: cannot be read"):
            data = read_file(path)
    tags = raw_tags.read(data, path)
    own = _read_own(tags, data)
    if own is not None and tags.exposure_s and tags.black_level_dn is not None:
        mosaic, pattern, white = own
        return Frame(mosaic, tags.exposure_s, tags.black_level_dn, white, pattern, time_s=tags.time_s, file=path)
    frame = _by_libraw(data, tags, path)
    if not (np.isfinite(frame.exposure_s) and frame.exposure_s > 0):
        raise DataError(f"{path}: does not say its exposure time (EXIF tag 33434)")
    if not frame.black_level_dn < frame.white_level_dn:
        raise DataError(
            f"{path}: the black level, {frame.black_level_dn:g} DN, is not below the white one, "
            f"{frame.white_level_dn:g} DN"
        )
    return frame


def _by_libraw(data: bytes, tags: raw_tags.Tags, path: Path) -> Frame:
    import rawpy

    try:
        with rawpy.RawPy() as raw:
            raw.open_buffer(BytesIO(data))
            if (pixels := raw.sizes.raw_width * raw.sizes.raw_height) > raw_tags.MOST_PIXELS:
                raise DataError(f"{path}: has {pixels} pixels; at most {raw_tags.MOST_PIXELS} are read")
            raw.unpack()
            if raw.raw_type != rawpy.RawType.Flat:
                raise DataError(f"{path}: holds {raw.num_colors} samples a pixel; a mosaic holds one")
            if tags.pattern is not None:  # LibRaw moves odd edges of an active area
                mosaic, pattern = _active(raw.raw_image, tags, path), tags.pattern
            else:
                mosaic = np.array(raw.raw_image_visible, dtype=np.uint16)
                pattern = "mono" if raw.num_colors == 1 else _pattern(raw.raw_pattern, raw.color_desc.decode(), path)
            black = [float(level) for level in raw.black_level_per_channel]
            white = float(raw.white_level) if tags.white_level_dn is None else tags.white_level_dn
            exposure = float(raw.other.shutter_speed) if tags.exposure_s is None else tags.exposure_s
    except (rawpy.LibRawError, NotImplementedError) as error:
        text = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise DataError(f"{path}: is damaged or not a raw frame: {text}") from None
    # Makers' colours may differ by a count; every frame is measured against dark frames, pixel by pixel.
    mean = black[0] if pattern == "mono" else sum(black) / len(black)
    level = mean if tags.black_level_dn is None else tags.black_level_dn
    return Frame(mosaic, exposure, level, white, pattern, time_s=tags.time_s, file=path)


def _active(whole: NDArray[np.uint16], tags: raw_tags.Tags, path: Path) -> NDArray[np.uint16]:
    if whole.shape != tags.size:
        raise DataError(f"{path}: states {tags.size} pixels, and LibRaw finds {whole.shape}")
    top, left, bottom, right = tags.active
    return np.array(whole[top:bottom, left:right], dtype=np.uint16)


def _pattern(cells: NDArray[np.uint8] | None, names: str, path: Path) -> str:
    """The Bayer pattern; `DataError` for other colour filters."""
    shape = cells.shape if cells is not None else ()
    pattern = "".join(names[k : k + 1] for k in cells.ravel()) if cells is not None else "unknown"
    if shape != (2, 2) or pattern not in BAYER:
        shown = f"{' x '.join(map(str, shape))}, {pattern[:36]}"
        raise DataError(f"{path}: its colour filters are {shown}; read are 2 x 2: {', '.join(BAYER)}, and none")
    return pattern


def _read_own(tags: raw_tags.Tags, data: bytes) -> tuple[NDArray[np.uint16], str, float] | None:
    """Mosaic, pattern and white level [DN] of a file as `encode_dng` makes it; None where anything is otherwise."""
    if not tags.own.keys() <= _OWN:
        return None
    lists = ((tag, values) for tag, values in tags.own.items() if isinstance(values, list) and len(values) == 1)
    one = {tag: values[0] for tag, values in lists if isinstance(values[0], int)}
    columns, rows, bits, start, size, white = (one.get(tag, 0) for tag in (256, 257, 258, 273, 279, 50717))
    layout = one.get(259), one.get(262), one.get(277), one.get(278), one.get(274)
    if bits not in (12, 16) or min(columns, rows, start, white) <= 0 or size != rows * -(-columns * bits // 8):
        return None
    if layout == (1, 34892, 1, rows, 1):
        pattern = "mono"
    elif layout == (1, 32803, 1, rows, 1) and tags.own.get(33421) == [2, 2]:
        pattern = "".join("RGB"[k] if k < 3 else "?" for k in tags.own.get(33422, []))
        if pattern not in BAYER:
            return None
    else:
        return None
    strip = np.frombuffer(data, np.uint8, size, start)
    if bits == 16:  # as it lies in the file, which cannot be written to
        return strip.view("<u2").reshape(rows, columns).astype(np.uint16, copy=False), pattern, float(white)
    from gonio.lab.rig._dng_packing import unpack12

    mosaic = np.empty((rows, columns), np.uint16)
    unpack12(strip.reshape(rows, -1), mosaic)
    return mosaic, pattern, float(white)


def read_record(data: bytes) -> str:
    """The record in the ImageDescription of a frame's file; "" where the file has none, or is damaged there."""
    text = raw_tags.first_directory(data).get(270, b"")
    return text.decode("ascii", "replace") if isinstance(text, bytes) else ""
