"""Files that were made to take memory, time or other people's files: each ends in one message that names the file.

Kinds: a container that unpacks to far more than it has; a count that is believed before it is looked at; a text whose
encoding hides what is refused in it.
"""

import io
import re
import struct
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats import certificate, rgl, workbook, xml_text
from gonio.lab.rig.light_and_camera import read_maps

TYPED = '<?xml version="1.0"{}?><!DOCTYPE a [<!ENTITY b "c">]><WindowElement>&b;</WindowElement>'
SOON_S = 5.0
"""A refusal before anything is unpacked takes milliseconds; a busy computer some hundred."""


@pytest.mark.parametrize(
    ("encoding", "stated"),
    [
        ("utf-8", ""),
        ("utf-8", ' encoding="UTF-8"'),
        ("utf-8-sig", ""),
        ("utf-16", ' encoding="UTF-16"'),
        ("utf-16-le", ""),
        ("utf-16-be", ""),
        ("latin-1", ' encoding="ISO-8859-1"'),
    ],
)
def test_no_encoding_hides_a_document_type(tmp_path: Path, encoding: str, stated: str) -> None:
    data = TYPED.format(stated).encode(encoding)
    for name, read in (("a.xml", measurement.read), ("c.xml", certificate.reflectance)):
        (tmp_path / name).write_bytes(data)
        with pytest.raises((DataError, ConfigError), match=rf"{name}.*document type"):
            read(tmp_path / name)


@pytest.mark.parametrize("name", ["UTF-7", "utf-32", "cp037", "no-such", "hex", "idna", "a\0b"])
def test_an_encoding_that_is_not_read_is_named(name: str) -> None:
    with pytest.raises(DataError, match=r"a\.xml: its encoding is " + re.escape(repr(name))):
        xml_text.root(f'<?xml version="1.0" encoding="{name}"?><a/>'.encode(), "a.xml")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"<a>" * 300, "more than 200 elements within each other"),
        (b'<?xml version="1.0" encoding="UTF-8"?><a>\xff</a>', "byte 41 is no text in utf-8"),
        (b"<a><b></a>", "line 1, column 9: not valid XML"),
        (b"", "not valid XML"),
        (b"<a>\0</a>", "not valid XML"),
    ],
)
def test_what_is_no_xml_is_named(data: bytes, said: str) -> None:
    with pytest.raises(DataError, match=rf"a\.xml.*{said}"):
        xml_text.root(data, "a.xml")


def test_text_in_utf16_is_read() -> None:
    assert xml_text.root('<?xml version="1.0" encoding="UTF-16"?><a>é</a>'.encode("utf-16"), "a.xml").text == "é"


def packed(parts: dict[str, bytes]) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return made.getvalue()


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({f"xl/worksheets/sheet{k}.xml": bytes(5 * 2**20) for k in range(30)}, "31 parts that unpack to 150 MiB"),
        ({f"xl/{k}.xml": b"<a/>" for k in range(2001)}, "has 2002 parts"),
        ({"xl/a.xml": b"<d/>" * 3_000_000, "xl/b.xml": b"<d/>" * 3_000_001}, "elem"),
        ({"xl/a.xml": TYPED.format(' encoding="UTF-16"').encode("utf-16")}, "part 'xl/a.xml': has a document type"),
        ({"xl/a.xml": b'<?xml version="1.0" encoding="UTF-7"?><a/>'}, "part 'xl/a.xml': its encoding is 'UTF-7'"),
    ],
)
def test_all_parts_of_a_workbook_are_bounded_together(parts: dict[str, bytes], said: str) -> None:
    data = packed({"xl/workbook.xml": b"<a/>", **parts})
    with pytest.raises(DataError, match=rf"b\.xlsx.*{said}"):
        workbook.as_csv(data, Path("b.xlsx"), lambda names: "a" in names)


def tensor(count: int, *fields: bytes) -> bytes:
    return b"tensor_file\0\1\0" + struct.pack("<I", count) + b"".join(fields)


def field(name: bytes, shape: tuple[int, ...], kind: int = 10, dimensions: int | None = None) -> bytes:
    stated = len(shape) if dimensions is None else dimensions
    return struct.pack("<H", len(name)) + name + struct.pack(f"<HBQ{len(shape)}Q", stated, kind, 0, *shape)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (tensor(1, field(b"rgb", (2**40,) * 60_000)), "has 60000 dimensions; at most 8"),
        (tensor(2**31, field(b"a", (1,)) * 5000), "states 2147483648 fields"),
        (tensor(1, field(b"rgb", (2**62, 2**62))), "reaches beyond the end"),
        (tensor(1, field(b"rgb", (1,), dimensions=8)), "the list of fields is cut"),
        (tensor(1, field(b"rgb", (1,), kind=77)), "no type or shape"),
    ],
)
def test_counts_of_a_tensor_file_are_looked_at_first(data: bytes, said: str) -> None:
    began = time.process_time()
    with pytest.raises(DataError, match=rf"t\.bsdf, byte .*{said}"):
        rgl.tensors(data, Path("t.bsdf"))
    assert time.process_time() - began < SOON_S


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (packed({"format.npy": bytes(10**6)}), "unpacks to 1000000 bytes"),
        (packed({"format.npy": b"x"})[:-30], "is no file of maps"),
        (b"PK\3\4", "is no file of maps"),
    ],
    ids=["much", "cut", "begun"],  # an archive holds the time, so that two workers would name these tests differently
)
def test_maps_of_a_camera_are_bounded_before_they_are_unpacked(tmp_path: Path, data: bytes, said: str) -> None:
    (tmp_path / "m.npz").write_bytes(data)
    with pytest.raises(ConfigError, match=rf"m\.npz: {said}"):
        read_maps(str(tmp_path / "m.npz"), (20, 30))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"theta_i": np.array([0.0, 45.0], np.float32)}, r"theta_i goes from 0 to 45; radians are needed"),
        ({"theta_i": np.array([0, 1], np.uint8)}, r"the field theta_i holds uint8; real numbers are needed"),
        ({"jacobian": np.zeros(1, np.uint8)}, r"jacobian is not 1"),
        ({"valid": np.zeros(3, np.uint8)}, r"the field valid has 3 uint8; a bit a node is needed"),
        ({"rgb": np.zeros((1, 2, 3, 2, 2), np.uint16)}, r"the field rgb holds uint16"),
    ],
)
def test_what_a_tensor_file_states_is_obeyed_or_refused(change: dict[str, Any], said: str) -> None:
    """Kind: a container's own statement (angles in degrees, integers, values without a factor, a mask)."""
    fields: dict[str, Any] = {
        "phi_i": np.zeros(1, np.float32), "theta_i": np.array([0.0, 1.0], np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "sigma": np.ones((2, 2), np.float32), "vndf": np.ones((1, 2, 2, 2), np.float32),
        "rgb": np.ones((1, 2, 3, 2, 2), np.float32),
    }  # fmt: skip
    rgl.RglMeasured(rgl._pack(fields), Path("t.bsdf"))
    with pytest.raises(DataError, match=rf"t\.bsdf: {said}"):
        rgl.RglMeasured(rgl._pack(fields | change), Path("t.bsdf"))


def test_maps_of_a_camera_hold_what_maps_hold(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    maps: dict[str, Any] = {
        name: np.ones((2, 3), np.float32) for name in ("responsivity", "u_responsivity", "dark_offset_e")
    }
    np.savez(path, format=1, defects=np.zeros((2, 3), bool), **maps | {"responsivity": np.ones((2, 3), complex)})
    with pytest.raises(ConfigError, match=r"m\.npz: responsivity holds values of the kind complex128"):
        read_maps(str(path), (2, 3))
