"""Raw frames on disk: what is written comes back bit for bit, and what is damaged is said to be."""

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import rawpy

from gonio.errors import ArgumentError, DataError
from gonio.lab.rig import Frame
from gonio.lab.rig.dng import BAYER, read_raw, write_dng

WHITE = {8: 255.0, 10: 1023.0, 12: 4095.0, 14: 16383.0, 16: 65535.0}


def noise(bits: int, shape: tuple[int, int] = (480, 640), seed: int = 0) -> npt.NDArray[np.uint16]:
    """Every value of the range can occur, both ends do."""
    mosaic = np.random.default_rng(seed).integers(0, 2**bits, shape).astype(np.uint16)
    mosaic[0, 0], mosaic[-1, -1] = 0, 2**bits - 1
    return mosaic


@pytest.mark.parametrize("shape", [(480, 640), (32, 32), (33, 35)])
@pytest.mark.parametrize("bits", WHITE)
@pytest.mark.parametrize("pattern", ["mono", *BAYER])
def test_every_layout_depth_and_size_comes_back_bit_for_bit(
    tmp_path: Path, pattern: str, bits: int, shape: tuple[int, int]
) -> None:
    mosaic = noise(bits, shape)
    write_dng(Frame(mosaic, 0.0125, 64.125, WHITE[bits], pattern, time_s=83.25), tmp_path / "a.dng")
    back = read_raw(tmp_path / "a.dng")
    np.testing.assert_array_equal(back.mosaic, mosaic)
    assert back.mosaic.dtype == np.uint16
    assert (back.pattern, back.exposure_s, back.black_level_dn) == (pattern, 0.0125, 64.125)
    assert (back.white_level_dn, back.time_s, back.file) == (WHITE[bits], 83.25, tmp_path / "a.dng")


@pytest.mark.parametrize("shape", [(480, 640), (33, 35)])
@pytest.mark.parametrize("bits", [12, 16])
@pytest.mark.parametrize("pattern", ["mono", "GBRG"])
def test_libraw_reads_what_we_read_ourselves(tmp_path: Path, pattern: str, bits: int, shape: tuple[int, int]) -> None:
    """The same file under another program's name goes through LibRaw: every value of the frame is the same."""
    write_dng(Frame(noise(bits, shape), 1 / 3, 64.25, WHITE[bits], pattern, time_s=83.25), tmp_path / "own.dng")
    data = (tmp_path / "own.dng").read_bytes()
    assert data.count(b"gonio\0") == 2  # make and software
    (tmp_path / "other.dng").write_bytes(data.replace(b"gonio\0", b"other\0"))
    own, other = (read_raw(tmp_path / name) for name in ("own.dng", "other.dng"))
    np.testing.assert_array_equal(own.mosaic, other.mosaic)
    for name in ("exposure_s", "black_level_dn", "white_level_dn", "pattern", "time_s"):
        assert getattr(own, name) == getattr(other, name)


def test_our_own_frames_need_no_libraw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its decoder takes most of the time of a reduction."""
    write_dng(Frame(noise(12), 0.5, 64.0, 4095.0, time_s=1.0), tmp_path / "a.dng")
    monkeypatch.delattr(rawpy, "RawPy")
    np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").mosaic, noise(12))


def test_a_mosaic_with_strides_is_written_as_it_looks(tmp_path: Path) -> None:
    wide = noise(12, (64, 80))
    for number, mosaic in enumerate((wide.T, wide[::-1], wide[:, ::2])):
        write_dng(Frame(mosaic, 1.0, 0.0, 4095.0, time_s=0.0), tmp_path / f"{number}.dng")
        np.testing.assert_array_equal(read_raw(tmp_path / f"{number}.dng").mosaic, mosaic)


def test_libraw_itself_sees_levels_pattern_and_exposure(tmp_path: Path) -> None:
    """Without our own reading of the directories: other people's converters must find the same."""
    write_dng(Frame(noise(12), 0.008, 64.0, 4095.0, "GRBG", time_s=0.0), tmp_path / "a.dng")
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        names = raw.color_desc.decode()
        assert "".join(names[k] for k in raw.raw_pattern.ravel()) == "GRBG"
        assert (raw.white_level, set(raw.black_level_per_channel)) == (4095, {64})
        assert raw.other.shutter_speed == pytest.approx(0.008, rel=1e-6)  # LibRaw holds it in single precision
        assert raw.other.iso_speed == 100


@pytest.mark.parametrize("exposure", [1e-5, 1.25e-4, 0.1, 1 / 3, 0.7071067811865476, 12.345678, 60.0])
def test_exposures_are_exact_rationals(tmp_path: Path, exposure: float) -> None:
    write_dng(Frame(noise(12, (32, 32)), exposure, 0.0, 4095.0, time_s=0.0), tmp_path / "a.dng")
    data = (tmp_path / "a.dng").read_bytes()
    # the closest fraction of 32-bit integers misses by at most 1/(q 2^32): rounding of a double is 1e-16
    assert read_raw(tmp_path / "a.dng").exposure_s == pytest.approx(exposure, rel=1e-14, abs=1e-19)
    if exposure == 1e-5:
        assert Fraction(1, 100_000) == Fraction(*rational(data, 33434))


def rational(data: bytes, tag: int) -> tuple[int, int]:
    (place,) = struct.unpack_from("<I", data, data.index(struct.pack("<HHI", tag, 5, 1)) + 8)
    return struct.unpack_from("<II", data, place)


def test_equal_frames_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.dng", "b.dng"):
        write_dng(Frame(noise(12), 0.5, 64.0, 4095.0, time_s=7.5), tmp_path / name)
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.dng", "b.dng"]


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dng(Frame(noise(12), 0.5, 64.0, 4095.0, time_s=0.0), tmp_path / "a.dng")
    before = (tmp_path / "a.dng").read_bytes()

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(DataError, match=r"a\.dng: the frame cannot be written: No space left on device"):
        write_dng(Frame(noise(12, seed=1), 0.5, 64.0, 4095.0, time_s=0.0), tmp_path / "a.dng")
    assert (tmp_path / "a.dng").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.dng"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mosaic": np.zeros((16, 16), np.uint16)}, "at least 32 x 32"),
        ({"mosaic": np.zeros((64, 64))}, "uint16"),
        ({"pattern": "RGBW"}, "RGBW.*known are mono"),
        ({"exposure_s": 0.0}, "exposure_s = 0.0 must be positive"),
        ({"exposure_s": float("nan")}, "exposure_s"),
        ({"time_s": -1e-6}, "time_s = -1e-06 must be at least 0"),
        ({"time_s": float("nan")}, "time_s = nan"),
        ({"time_s": 1e12}, "year 9999"),
        ({"black_level_dn": 5000.0}, "black < white"),
        ({"white_level_dn": 70_000.0}, "<= 65535"),
        ({"mosaic": np.full((64, 64), 5000, np.uint16)}, "holds 5000 DN, above white_level_dn = 4095"),
    ],
)
def test_frames_that_no_file_can_hold_are_refused(tmp_path: Path, change: dict[str, object], message: str) -> None:
    values: dict[str, object] = {
        "mosaic": noise(12, (64, 64)), "exposure_s": 1.0, "black_level_dn": 0.0, "white_level_dn": 4095.0,
        "time_s": 0.0,
    }  # fmt: skip
    with pytest.raises(ArgumentError, match=message):
        write_dng(Frame(**(values | change)), tmp_path / "a.dng")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("bits", "pattern"), [(12, "mono"), (16, "RGGB")])
def test_a_file_cut_anywhere_is_an_error_that_names_it(tmp_path: Path, bits: int, pattern: str) -> None:
    write_dng(Frame(noise(bits, (64, 48)), 1.0, 0.0, WHITE[bits], pattern, time_s=0.0), tmp_path / "whole.dng")
    data = (tmp_path / "whole.dng").read_bytes()
    for cut in [*range(0, 900, 7), *range(900, len(data), 211), len(data) - 2, len(data) - 1]:
        path = tmp_path / "cut.dng"
        path.write_bytes(data[:cut])
        with pytest.raises(DataError, match=r"cut\.dng"):
            read_raw(path)


def test_damage_in_the_directories_is_an_error_or_leaves_the_image_alone(tmp_path: Path) -> None:
    write_dng(Frame(noise(12, (64, 48)), 1.0, 64.0, 4095.0, time_s=0.0), tmp_path / "whole.dng")
    data = (tmp_path / "whole.dng").read_bytes()
    rng, messages = np.random.default_rng(4), []
    header = data.index(b"1970")
    for _ in range(400):
        broken = bytearray(data)
        broken[int(rng.integers(header))] ^= 1 << int(rng.integers(8))
        (tmp_path / "broken.dng").write_bytes(bytes(broken))
        try:
            back = read_raw(tmp_path / "broken.dng")
        except DataError as error:
            messages.append(str(error))
        else:
            assert back.mosaic.ndim == 2
            assert back.exposure_s > 0
    assert len(messages) > 20
    assert all("broken.dng" in message for message in messages)


@pytest.mark.parametrize("content", [b"", b"not a frame at all\n" * 50, b"II*\0" + b"\xff" * 64, bytes(2000)])
def test_other_files_are_not_frames(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.dng").write_bytes(content)
    with pytest.raises(DataError, match=r"a\.dng"):
        read_raw(tmp_path / "a.dng")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere\.dng: cannot be read: No such file"):
        read_raw(tmp_path / "nowhere.dng")
