"""Map files: chunks that are packed here, and those that other programs write."""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pytest
from gonio_maps.files import MapFile, Packed, Parts, Tile, Variable, tiles

from gonio import platform, seals
from gonio.errors import ConfigError, DataError
from gonio.hdf5 import is_map
from tests.gonio_maps import map_files

ROWS, COLS, POINTS = 70, 130, 5


def values() -> npt.NDArray[np.float32]:
    """Numbers of all sizes, some of which are none."""
    rng = np.random.default_rng(4)
    out = rng.normal(size=(ROWS, COLS, POINTS)).astype(np.float32) * np.float32(10.0) ** rng.integers(-9, 9, POINTS)
    out[rng.random(out.shape) < 0.1] = np.nan
    return out.astype(np.float32)


def write(path: Path) -> Any:
    """A map of six tiles, of which one is a whole chunk along both sides."""
    brdf: Any = values()
    place = np.ones((POINTS, 3))
    map_files.values(path, brdf, np.abs(brdf), place, place, np.zeros((4, POINTS)))
    return brdf


@pytest.mark.parametrize("array", [values(), np.arange(6, dtype="u1").reshape(2, 3), np.zeros((0, 3)), np.eye(3)])
def test_what_is_packed_comes_back(array: npt.NDArray[Any]) -> None:
    found = Packed.of(array).array()
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)
    with pytest.raises(OSError, match="damaged"):
        Packed(array.dtype.str, array.shape, np.frombuffer(b"nothing", np.uint8)).array()


def test_chunks_are_read_as_hdf5_reads_them(tmp_path: Path) -> None:
    """The library's own filters unpack what was packed here, and the other way round."""
    brdf = write(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5") as file:
        np.testing.assert_array_equal(file["brdf"][()], brdf)
        assert (file["brdf"].compression, file["brdf"].compression_opts, file["brdf"].shuffle) == ("gzip", 1, True)
        with h5py.File(tmp_path / "other.h5", "w") as other:
            other.attrs.update(file.attrs)
            for name in file.keys() - {"brdf", "u_random", "flag"}:
                file.copy(name, other)
            for name in ("brdf", "u_random", "flag"):
                chunk = (64, 64, POINTS)
                other.create_dataset(name, data=file[name][()], chunks=chunk, compression="gzip", shuffle=True)
    for name in ("map.h5", "other.h5"):
        with MapFile(tmp_path / name) as found:
            packed = [isinstance(found.chunk("brdf", tile), Packed) for tile in tiles(ROWS, COLS)]
            assert packed == [True, True, False, False, False, False]
            for tile in tiles(ROWS, COLS):
                wanted = brdf[tile.rows, tile.cols]
                np.testing.assert_array_equal(found.values(tile)[0], wanted)
                np.testing.assert_array_equal(found.held(tile).values(np.array([1, 4]))[0], wanted[..., [1, 4]])


CHUNKS = {"chunks": (64, 64, POINTS)}


def test_a_dimension_may_be_empty(tmp_path: Path) -> None:
    one = {"m": np.full((2, 3), 0.3)}
    empty = Variable(("y", "x", "pair"), dtype="f4"), np.zeros((2, 3, 0))
    map_files.fits(tmp_path / "fits.h5", one, one, more={"correlation": empty})
    with MapFile(tmp_path / "fits.h5") as found:
        assert found.array("correlation").shape == (2, 3, 0)
        assert found.array("pair").shape == (0,)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"chunks": (32, 64, POINTS)},
        {**CHUNKS, "compression": "lzf"},
        {**CHUNKS, "compression": "gzip", "fletcher32": True},
    ],
)
def test_files_of_other_programs_have_other_chunks(tmp_path: Path, options: dict[str, Any]) -> None:
    brdf = write(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        del file["brdf"]
        file.create_dataset("brdf", data=brdf, **options)
    with MapFile(tmp_path / "map.h5") as found:
        for tile in tiles(ROWS, COLS):
            assert not isinstance(found.chunk("brdf", tile), Packed)
            np.testing.assert_array_equal(found.values(tile)[0], brdf[tile.rows, tile.cols])


def unsealed(path: Path) -> bytes:
    """A map as earlier versions wrote them, and as programs leave it that change it."""
    whole = path.read_bytes()[: -seals.LENGTH]
    path.write_bytes(whole)
    return whole


def test_a_chunk_that_is_damaged_is_named(tmp_path: Path) -> None:
    write(tmp_path / "map.h5")
    unsealed(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5") as file:
        chunk = file["u_random"].id.get_chunk_info(1)
    with open(tmp_path / "map.h5", "r+b") as stream:
        stream.seek(chunk.byte_offset)
        stream.write(bytes(chunk.size))
    with MapFile(tmp_path / "map.h5") as found:
        found.values(Tile(slice(0, 64), slice(0, 64)))
        with pytest.raises(DataError, match=r"map.h5: rows 0 to 64, columns 64 to 128 cannot be read: .* make the map"):
            found.values(Tile(slice(0, 64), slice(64, 128)))


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("x", None, "has no variable x"),
        ("y", np.full(ROWS, np.nan), "y is no list of places on the sample in mm"),
        ("y", np.array([b"a"] * ROWS), "y is no list of places on the sample in mm"),
        ("source_mm", None, "has no variable source_mm"),
        ("camera_mm", np.full((POINTS, 3), np.nan), "camera_mm has no finite value for each of the 5 points of brdf"),
        ("theta_i_deg", np.zeros(POINTS - 1), "theta_i_deg has no finite value for each of the 5 points of brdf"),
    ],
)
def test_what_every_map_has_is_required(tmp_path: Path, name: str, value: Any, told: str) -> None:
    write(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5", "r+") as file:
        del file[name]
        if value is not None:
            file.create_dataset(name, data=value)
    with pytest.raises(DataError, match=rf"map.h5: {told}"):
        MapFile(tmp_path / "map.h5")


def test_a_map_that_is_cut_short_or_has_a_hole_is_damaged(tmp_path: Path) -> None:
    write(tmp_path / "map.h5")
    whole = unsealed(tmp_path / "map.h5")
    with h5py.File(tmp_path / "map.h5") as file:
        begin = file["brdf"].id.get_chunk_info(0).byte_offset
    (tmp_path / "hole.h5").write_bytes(whole[:begin] + bytes(500) + whole[begin + 500 :])
    with MapFile(tmp_path / "hole.h5") as found, pytest.raises(DataError, match=r"hole.h5: brdf is damaged: "):
        found.array("brdf")
    (tmp_path / "short.h5").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match=r"short.h5: is damaged: .*truncated"):
        is_map(tmp_path / "short.h5")
    (tmp_path / "other.h5").write_bytes(b"of another kind")
    assert not is_map(tmp_path / "other.h5")


PAGE = 4096


def damages(whole: bytes, count: int) -> Iterator[bytes]:
    """Files as disks and copies spoil them: pages of zeros, of ones or of noise, two exchanged, a bit, a cut."""
    rng = random.Random(3)
    starts = range(0, len(whole), PAGE)
    for k in range(count):
        one, other = rng.sample(starts[:-1], 2)
        page = slice(one if k % 12 else starts[-1], None if k % 12 == 0 else one + PAGE)  # the last one, too
        spoilt, size = bytearray(whole), len(whole[page])
        if k % 6 < 3:
            spoilt[page] = (bytes(size), b"\xff" * size, rng.randbytes(size))[k % 6]
        elif k % 6 == 3:
            spoilt[page], spoilt[other : other + PAGE] = whole[other : other + PAGE], whole[page]
        elif k % 6 == 4:
            spoilt[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        else:
            del spoilt[rng.randrange(len(whole) - seals.LENGTH) :]
        yield bytes(spoilt)


def test_no_damage_of_a_map_is_read(tmp_path: Path) -> None:
    """Kind: bytes that are not those that were written. None becomes a number, none stops the program."""
    path = tmp_path / "map.h5"
    write(path)
    assert is_map(path)
    for spoilt in damages(path.read_bytes(), 60):
        path.unlink()  # a new file each time: what was looked at is known by its number and times
        path.write_bytes(spoilt)
        for read in (is_map, MapFile):
            try:
                found = read(path)
            except DataError as error:
                assert str(path) in str(error)  # noqa: PT017
            else:  # nothing of HDF5 is left of it
                assert found is False
                assert spoilt[:8] != seals.SIGNATURE


def test_a_file_that_hdf5_does_not_come_back_from_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kind: a library that works without end. The collection of long attributes is without a length."""
    path = tmp_path / "map.h5"
    write(path)
    whole = unsealed(path)
    at = whole.index(b"GCOL")
    path.write_bytes(whole[: at + 16] + bytes(PAGE - 16) + whole[at + PAGE :])
    monkeypatch.setattr(seals, "LOOK_S", 1)
    for read in (is_map, MapFile):
        with pytest.raises(DataError, match=r"map.h5: is damaged: HDF5 does not get through it; remove it and"):
            read(path)


def test_whoever_changes_a_map_takes_its_seal_away(tmp_path: Path) -> None:
    path = tmp_path / "map.h5"
    write(path)
    assert seals.SEAL.search(path.read_bytes())
    with h5py.File(path, "r+") as file:
        file["u_random"][0, 0, 0] = 7.0
    assert not seals.SEAL.search(path.read_bytes())
    with MapFile(path) as found:
        assert found.array("u_random")[0, 0, 0] == 7.0


def test_a_map_is_on_the_disk_before_its_tiles_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kind: sources that are removed while their product is in memory alone."""
    done: list[str] = []

    def noted(owner: Any, name: str) -> None:
        work = getattr(owner, name)

        def instead(*arguments: Any) -> Any:
            done.append(f"{name} {arguments[0] if isinstance(arguments[0], Path) else ''}".removesuffix(" "))
            return work(*arguments)

        monkeypatch.setattr(owner, name, instead)

    noted(platform, "sync_folder")
    noted(platform, "sync")
    noted(Path, "replace")
    noted(Path, "unlink")
    write(tmp_path / "map.h5")
    order = [
        "sync", f"replace {tmp_path / 'map.h5.parts' / 'whole.h5'}", f"sync_folder {tmp_path}",
        f"sync_folder {tmp_path / 'map.h5.parts'}", f"unlink {tmp_path / 'map.h5.parts' / '000000-000000.npz'}",
    ]  # fmt: skip
    begin = done.index(order[1]) - 1
    assert done[begin : begin + 5] == order


def test_a_folder_of_parts_with_files_of_others_is_left_alone(tmp_path: Path) -> None:
    """It would be removed with them once the map is whole."""
    folder = tmp_path / "map.h5.parts"
    folder.mkdir()
    (folder / "mine.txt").write_text("notes", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"map.h5.parts: holds what is no part of a map.* than map.h5"):
        Parts(tmp_path / "map.h5", {})
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]


def test_settings_that_are_no_text_are_those_of_another_map(tmp_path: Path) -> None:
    folder = tmp_path / "map.h5.parts"
    folder.mkdir()
    (folder / "settings.json").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match=r"map.h5.parts: holds parts of another map"):
        Parts(tmp_path / "map.h5", {})


def test_a_map_that_does_not_fit_into_memory_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_large(*given: Any) -> Any:
        raise MemoryError("Unable to allocate 8 TiB")

    write(tmp_path / "map.h5")
    monkeypatch.setattr(h5py.Dataset, "__getitem__", too_large)
    with pytest.raises(MemoryError, match=r"map\.h5: Unable to allocate 8 TiB"), MapFile(tmp_path / "map.h5") as file:
        file.array(file.names[-1])


def test_what_the_parts_are_of_goes_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that is killed while it tidies up can be given again, also where a run's pictures lie there."""
    path, tile = tmp_path / "map.h5", Tile(slice(0, 64), slice(0, 64))
    parts = Parts(path, {})
    parts.write(tile, {"brdf": np.ones((64, 64))})
    np.save(parts.folder / "plane-000001-0.npy", np.ones(3))
    monkeypatch.setattr("gonio_maps.files.shutil.rmtree", lambda folder: None)
    parts.assemble({"y": 64, "x": 64}, {"brdf": Variable(("y", "x"))}, {})
    assert [left.name for left in parts.folder.iterdir()] == ["settings.json"]
    Parts(path, {})


@pytest.mark.parametrize("left", [0, 1, 100])
def test_a_tile_that_is_damaged_is_named(tmp_path: Path, left: int) -> None:
    parts, tile = Parts(tmp_path / "map.h5", {}), Tile(slice(0, 64), slice(0, 64))
    parts.write(tile, {"brdf": np.ones((64, 64))})
    path = parts.folder / tile.name
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(DataError, match=rf"{path.name}: is damaged; remove the folder .*map.h5.parts, and the command"):
        parts.read(tile)
