"""Raw frames of anybody: a tag is read by its type and how often it stands, and what is not read is named.

Each case stands for a kind of statement of a container, which is obeyed or refused, and never passed over.
"""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.lab.rig import raw_tags
from gonio.lab.rig.dng import read_raw

SHORT, LONG, RATIONAL, SRATIONAL = 3, 4, 5, 10
CODES = {1: "B", 2: "s", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i", 7: "B", 11: "f", 12: "d"}
MOSAIC = np.random.default_rng(7).integers(100, 900, (40, 52)).astype(np.uint16)


def dng(changes: dict[int, tuple[int, Any] | None] | None = None, *, order: str = "<", mosaic: Any = MOSAIC) -> bytes:
    """A DNG of a Bayer mosaic (RGGB, black 64, white 1000, 1/50 s), with tags changed, or left out (None)."""
    rows, columns = mosaic.shape
    tags: dict[int, tuple[int, Any] | None] = {
        254: (LONG, [0]), 256: (LONG, [columns]), 257: (LONG, [rows]), 258: (SHORT, [16]), 259: (SHORT, [1]),
        262: (SHORT, [32803]), 273: (LONG, [0]), 277: (SHORT, [1]), 278: (LONG, [rows]), 279: (LONG, [mosaic.size * 2]),
        33421: (SHORT, [2, 2]), 33422: (1, [0, 1, 1, 2]), 33434: (RATIONAL, [1, 50]), 50706: (1, [1, 4, 0, 0]),
        50708: (2, b"somebody's camera\0"), 50714: (SHORT, [64]), 50717: (LONG, [1000]),
        50721: (SRATIONAL, [1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1]),
    }  # fmt: skip
    kept: dict[int, tuple[int, Any]] = {
        tag: entry for tag, entry in sorted((tags | (changes or {})).items()) if entry is not None
    }
    behind = 8 + 2 + 12 * len(kept) + 4
    values, entries = b"", b""
    start = behind + sum(4 * len(v[1]) * 2 for v in kept.values()) + 64
    for tag, (kind, items) in kept.items():
        items = [start] if tag == 273 else items
        data: Any = items if kind == 2 else struct.pack(f"{order}{len(items)}{CODES[kind]}", *items)
        count = len(items) // (2 if kind in (RATIONAL, SRATIONAL) else 1)
        entries += struct.pack(order + "HHI", tag, kind, count)
        if len(data) > 4:
            entries += struct.pack(order + "I", behind + len(values))
            values += data + bytes(len(data) % 2)
        else:
            entries += data.ljust(4, b"\0")
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HIH", 42, 8, len(kept))
    head += entries + bytes(4) + values
    return head.ljust(start, b"\0") + mosaic.astype(order + "u2").tobytes()


def frame(changes: dict[int, tuple[int, Any] | None] | None = None, **how: Any) -> Any:
    return read_raw(Path("a.dng"), dng(changes, **how))


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_plain_file_is_read_in_both_byte_orders(order: str) -> None:
    found = frame(order=order)
    np.testing.assert_array_equal(found.mosaic, MOSAIC)
    assert (found.pattern, found.exposure_s, found.black_level_dn, found.white_level_dn) == ("RGGB", 0.02, 64, 1000)


@pytest.mark.parametrize(
    ("changes", "black"),
    [
        ({50713: (SHORT, [1, 2]), 50714: (SHORT, [60, 70])}, 65.0),
        ({50713: (SHORT, [1, 2]), 50714: (LONG, [60, 70])}, 65.0),
        ({50713: (SHORT, [2, 1]), 50714: (RATIONAL, [121, 2, 63, 1])}, 61.75),
        ({50713: (SHORT, [2, 2]), 50714: (SHORT, [60, 62, 64, 70])}, 64.0),
        ({50714: (RATIONAL, [129, 2])}, 64.5),
        ({50714: (SHORT, [64]), 50715: (SRATIONAL, [1, 2] * 52)}, 64.5),
        ({50714: (SHORT, [64]), 50716: (SRATIONAL, [k for _ in range(20) for k in (1, 1, -3, 1)])}, 63.0),
        ({50714: None}, 0.0),
    ],
)
def test_black_levels_are_read_by_type_and_repeat(changes: dict[int, Any], black: float) -> None:
    assert frame(changes).black_level_dn == black


@pytest.mark.parametrize(("kind", "values", "seconds"), [(RATIONAL, [3, 8], 0.375), (LONG, [2], 2.0), (11, [0.5], 0.5)])
def test_an_exposure_is_read_by_its_type(kind: int, values: list[float], seconds: float) -> None:
    assert frame({33434: (kind, values)}).exposure_s == seconds


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({50714: (SHORT, [60, 70])}, r"BlackLevel \(tag 50714\) = \[60, 70\]; 1 numbers are needed"),
        ({50713: (SHORT, [1, 3]), 50714: (SHORT, [60, 70])}, r"BlackLevel .*3 numbers"),
        ({50715: (SRATIONAL, [1, 2] * 51)}, r"BlackLevelDeltaH .*52 numbers"),
        ({50714: (SHORT, [1000])}, "black level, 1000 DN, is not below the white one"),
        ({50717: (LONG, [1000, 900])}, r"WhiteLevel .*\[1000, 900\]; one level"),
        ({33434: (LONG, [1, 50])}, r"ExposureTime .*\[1, 50\]"),
        ({33421: (SHORT, [6, 6]), 33422: (1, [1, 1, 0, 1, 1, 2] * 6)}, r"CFARepeatPatternDim = \[6, 6\]"),
        ({33421: (SHORT, [2, 4]), 33422: (1, [0, 1, 1, 2] * 2)}, r"CFARepeatPatternDim = \[2, 4\]"),
        ({33422: (1, [3, 4, 5, 1])}, r"CFAPattern = \[3, 4, 5, 1\]"),
        ({50710: (1, [0, 1, 2, 3])}, r"CFAPlaneColor = \[0, 1, 2, 3\]"),
        ({50710: (1, [2, 1, 0])}, r"CFAPlaneColor = \[2, 1, 0\]"),
        ({50711: (SHORT, [2])}, r"CFALayout = \[2\]"),
        ({262: (SHORT, [0])}, r"PhotometricInterpretation = 0 \(WhiteIsZero\)"),
        ({262: (SHORT, [2]), 277: (SHORT, [3])}, r"PhotometricInterpretation = 2 \(RGB\)"),
        ({262: (SHORT, [6]), 277: (SHORT, [3])}, r"PhotometricInterpretation = 6 \(YCbCr\)"),
        ({262: (SHORT, [34892]), 277: (SHORT, [3])}, r"SamplesPerPixel = \[3\]"),
        ({339: (SHORT, [3])}, r"SampleFormat = \[3\]"),
        ({339: (SHORT, [2])}, r"SampleFormat = \[2\]"),
        ({258: (SHORT, [32])}, r"BitsPerSample = \[32\]"),
        ({259: (SHORT, [34892])}, "Compression = 34892"),
        ({256: (LONG, [60_000]), 257: (LONG, [60_000])}, "60000 x 60000: at most"),
        ({50829: (LONG, [0, 0, 41, 52])}, "ActiveArea"),
    ],
)
def test_what_is_not_read_is_named(changes: dict[int, Any], said: str) -> None:
    with pytest.raises(DataError, match=rf"a\.dng: .*{said}"):
        frame(changes)


@pytest.mark.parametrize(("area", "pattern"), [([2, 4, 40, 50], "RGGB"), ([1, 3, 37, 51], "GBRG")])
def test_an_active_area_is_what_is_read(area: list[int], pattern: str) -> None:
    top, left, bottom, right = area
    cells = ["RGB".index(letter) for letter in pattern]
    found = frame({50829: (LONG, area), 33422: (1, cells)})
    np.testing.assert_array_equal(found.mosaic, MOSAIC[top:bottom, left:right])
    assert found.pattern == pattern


def test_a_table_of_linear_values_is_obeyed() -> None:
    table = (np.arange(1024) // 2 + 7).tolist()
    np.testing.assert_array_equal(frame({50712: (SHORT, table)}).mosaic, MOSAIC // 2 + 7)


@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
def test_the_mosaic_stays_as_the_sensor_has_it(orientation: int) -> None:
    np.testing.assert_array_equal(frame({274: (SHORT, [orientation])}).mosaic, MOSAIC)


def test_a_file_under_our_name_with_foreign_tags_is_read_as_anybody_s() -> None:
    table = (np.arange(1024) // 2 + 7).tolist()
    ours: dict[int, Any] = {305: (2, b"gonio\0"), 274: (SHORT, [1])}
    np.testing.assert_array_equal(frame(ours).mosaic, MOSAIC)
    np.testing.assert_array_equal(frame({**ours, 50712: (SHORT, table)}).mosaic, MOSAIC // 2 + 7)
    assert frame({**ours, 50715: (SRATIONAL, [1, 1] * 52)}).black_level_dn == 65.0


def test_directories_in_a_loop_and_of_many_values_end() -> None:
    data = bytearray(dng())
    (count,) = struct.unpack_from("<H", data, 8)
    struct.pack_into("<I", data, 10 + 12 * count, 8)  # the next directory is the first
    np.testing.assert_array_equal(read_raw(Path("a.dng"), bytes(data)).mosaic, MOSAIC)
    with pytest.raises(DataError, match=r"a\.dng: is damaged: .*tag 50714 of 80000 values"):
        frame({50714: (1, [0] * 80_000)})


def test_a_big_tiff_is_named() -> None:
    with pytest.raises(DataError, match=r"a\.dng: is a BigTIFF"):
        read_raw(Path("a.dng"), b"II+\0" + bytes(100))


@pytest.mark.parametrize(("tag", "value"), [(262, 0), (262, 3), (262, 6), (339, 3), (339, 2)])
def test_a_picture_of_a_calibration_is_counts_of_light(tag: int, value: int) -> None:
    plain: dict[int, Any] = {262: (SHORT, [1]), 33421: None, 33422: None}
    raw_tags.require_plain(dng(plain), Path("dark.tif"))
    with pytest.raises(DataError, match=r"dark\.tif: PhotometricInterpretation"):
        raw_tags.require_plain(dng({**plain, tag: (SHORT, [value])}), Path("dark.tif"))
