"""HDF5 from anybody: nothing outside the file is read, sizes are known before memory is taken, units are obeyed.

Each case stands for a kind: what a container says of itself is obeyed, or the file is refused with what it says.
"""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_maps.files import MapFile

from gonio import hdf5, measurement
from gonio.errors import DataError
from gonio.formats.reader import table
from gonio.hdf5 import is_map

h5py = pytest.importorskip("h5py", reason="h5py is not installed (pip install gonio[hdf5])")
ROWS = 6


@pytest.fixture(autouse=True)
def _no_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """No other process looks at these files first: `test_maps.py` has those that HDF5 does not come back from."""
    monkeypatch.setattr("gonio.seals.look", lambda path: True)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    frame = table(
        theta_i_deg=30.0, phi_i_deg=0.0, theta_r_deg=np.arange(ROWS) * 15.0, phi_r_deg=180.0, wavelength_nm=632.8,
        brdf=0.1 + 0.01 * np.arange(ROWS), u_brdf=0.002, attrs={},
    )  # fmt: skip
    measurement.write(frame, tmp_path / "t.h5")
    (tmp_path / "secret.bin").write_bytes(np.linspace(0.2, 0.7, ROWS).tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["brdf"] = np.linspace(0.2, 0.7, ROWS)
    return tmp_path / "t.h5"


def replaced(file: Path, change: Callable[[Any], None], name: str = "brdf") -> Path:
    """The file with a column made anew."""
    with h5py.File(file, "r+") as found:
        del found["entry/table"][name]
        change(found["entry/table"])
    return file


def external(group: Any) -> None:
    group.create_dataset(
        "brdf", (ROWS,), "f8", external=[(str(Path(group.file.filename).parent / "secret.bin"), 0, 48)]
    )


def virtual(group: Any) -> None:
    layout = h5py.VirtualLayout((ROWS,), "f8")
    layout[:] = h5py.VirtualSource(str(Path(group.file.filename).parent / "other.h5"), "brdf", (ROWS,))
    group.create_virtual_dataset("brdf", layout)


def linked(group: Any) -> None:
    group["brdf"] = h5py.ExternalLink(str(Path(group.file.filename).parent / "other.h5"), "/brdf")


def packed_by_a_plugin(group: Any) -> None:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((ROWS,))
    plist.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, ())  # zstd, which h5py does not bring
    h5py.h5d.create(group.id, b"brdf", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((ROWS,)), plist)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (external, r"brdf.*secret\.bin.*external storage"),
        (virtual, r"brdf.*virtual.*other\.h5"),
        (linked, r"brdf.*external link.*other\.h5"),
        (packed_by_a_plugin, "brdf.*filter 32015"),
    ],
)
def test_nothing_outside_of_the_file_is_read(file: Path, change: Callable[[Any], None], said: str) -> None:
    replaced(file, change)
    with pytest.raises(DataError, match=rf"t\.h5: .*{said}"):
        measurement.read(file)
    for opened in (is_map, MapFile):  # maps are opened in the same way
        with pytest.raises(DataError, match=said):
            opened(file)


def test_links_in_a_loop_end(file: Path) -> None:
    def loop(group: Any) -> None:
        group["brdf"], group["again"] = h5py.SoftLink("/entry/table/again"), h5py.SoftLink("/entry/table/brdf")
        group["inner"] = group  # a group within itself

    with pytest.raises(DataError, match=r"t\.h5: .*too many links"):
        measurement.read(replaced(file, loop))


def huge(group: Any) -> None:
    group.create_dataset("brdf", (10**9,), "f8", chunks=(10**6,), compression="gzip")


def huge_chunk(group: Any) -> None:
    group.create_dataset("brdf", (ROWS,), "f8", chunks=(10**8,), maxshape=(None,), compression="gzip")


def bomb(group: Any) -> None:
    made = group.create_dataset("brdf", (ROWS,), "f8", chunks=(ROWS,), compression="gzip")
    import zlib

    made.id.write_direct_chunk((0,), zlib.compress(bytes(10**7)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (huge, "has 1000000000 values"),
        (huge_chunk, "chunks of 762 MiB"),
        (bomb, "unpacks to more than its 48 bytes"),
        (lambda group: group.create_dataset("brdf", data=np.ones((ROWS, 2))), r"the shape \(6, 2\)"),
        (lambda group: group.create_dataset("brdf", data=np.ones(ROWS) * 1j), "of the kind complex128; real numbers"),
        (lambda group: group.create_dataset("brdf", data=np.array([b"0.1"] * ROWS)), "of the kind .*; real numbers"),
        (lambda group: group.create_dataset("brdf", data=0.1), r"the shape \(\)"),
        (lambda group: group.create_group("brdf"), "is group, and no dataset"),
        (lambda group: group.create_dataset("brdf", (ROWS,), h5py.ref_dtype), "of the kind object; real numbers"),
    ],
)
def test_a_column_that_is_none_is_named_before_it_is_read(file: Path, change: Callable[[Any], None], said: str) -> None:
    with pytest.raises(DataError, match=rf"t\.h5: entry/table/brdf .*{said}"):
        measurement.read(replaced(file, change))


def test_texts_that_share_their_bytes_are_bounded(file: Path) -> None:
    """A text is kept once and named by many rows: the file is small, and what it says is not."""
    with h5py.File(file, "r") as found:
        at = found["entry/table/flag"].id.get_offset()
    with h5py.File(file, "r+") as found:
        group = found["entry/table"]
        del group["flag"]
        group.create_dataset("flag", data=["x" * 2**22] + [""] * 999, dtype=h5py.string_dtype())
        at = group["flag"].id.get_offset()
    data = bytearray(file.read_bytes())
    data[at : at + 16_000] = data[at : at + 16] * 1000
    file.write_bytes(data)
    with pytest.raises(DataError, match=r"entry/table/flag has texts of more than 128 MiB together"):
        measurement.read(file)


@pytest.mark.parametrize(
    ("name", "units", "factor"),
    [
        ("theta_r_deg", "rad", np.pi / 180),
        ("theta_i_deg", "degrees", 1.0),
        ("wavelength_nm", "um", 1e-3),
        ("wavelength_nm", "m", 1e-9),
        ("brdf", "sr^-1", 1.0),
        ("u_brdf", b"1 / sr", 1.0),
    ],
)
def test_stated_units_are_obeyed(file: Path, name: str, units: str | bytes, factor: float) -> None:
    before = measurement.read(file)
    with h5py.File(file, "r+") as found:
        column = found[f"entry/table/{name}"]
        column[:] = column[()] * factor
        column.attrs["units"] = units
    # two roundings of a double
    np.testing.assert_allclose(measurement.read(file)[name], before[name], rtol=5e-16)


@pytest.mark.parametrize(
    ("name", "key", "stated"),
    [
        ("theta_r_deg", "units", "gon"),
        ("brdf", "units", "percent"),
        ("brdf", "units", 7),
        ("wavelength_nm", "units", "1/cm"),
        ("brdf", "scale_factor", 0.01),
        ("brdf", "add_offset", 1.0),
    ],
)
def test_a_statement_that_is_not_understood_is_named(file: Path, name: str, key: str, stated: object) -> None:
    with h5py.File(file, "r+") as found:
        found[f"entry/table/{name}"].attrs[key] = stated
    with pytest.raises(DataError, match=rf"entry/table/{name} states {key} = .*{stated}"):
        measurement.read(file)


def test_what_fills_holes_is_no_value(file: Path) -> None:
    with h5py.File(file, "r+") as found:
        column = found["entry/table/brdf"]
        column[2] = -999.0
        column.attrs["_FillValue"] = -999.0
    frame = measurement.read(file)
    assert frame["flag"].tolist() == ["", "", "not_measured", "", "", ""]


def test_a_map_in_other_units_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "m.h5", "w") as made:
        made.attrs["format"] = "gonio-map-1"
        for name in ("x", "y"):
            made[name] = np.arange(3.0)
        made["x"].attrs["units"] = "m"
    with pytest.raises(DataError, match=r"m\.h5: x is in other units than mm"):
        MapFile(tmp_path / "m.h5")


def test_too_many_groups_are_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hdf5, "MOST_LINKS", 20)
    stream = io.BytesIO()
    with h5py.File(stream, "w") as made:
        for k in range(21):
            made.create_group(str(k))
    with pytest.raises(DataError, match="more than 20 groups"):
        hdf5.opened(Path("t.h5"), stream.getvalue())
