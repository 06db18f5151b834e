"""Files that do not fit into memory, or say so and lie: one message that names the file, and no other error."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gonio import measurement
from gonio.models import build
from tests.gonio.formats.test_names import one

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits of a process's memory are of Linux"),
]
ROOM_MIB = 3072
"""Address space of the process that reads: a whole file of MERL needs more than 2048 MiB of it, and is read in this."""
LONGEST_S = 20.0
"""Processor time of one file, at most."""
READS = """
import json, resource, sys, time
from pathlib import Path
import numpy as np
from gonio import measurement
from gonio.errors import GonioError
from tests.gonio.formats.conftest import damaged
path, count, room = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]) << 20
data = path.read_bytes()
resource.setrlimit(resource.RLIMIT_AS, (room, room))
found, longest, said = {}, 0.0, []
for case in (data, *damaged(data, count)):
    began = time.process_time()
    try:
        path.write_bytes(case)
        measurement.read(path)
        what = "read"
    except GonioError as error:
        what = "refused"
        said.append(str(error))
    except BaseException as error:
        what = type(error).__name__
    found[what] = found.get(what, 0) + 1
    longest = max(longest, time.process_time() - began)
print(json.dumps({"found": found, "longest": longest, "said": said}))
"""


def read(path: Path, count: int, room_mib: int = ROOM_MIB) -> tuple[dict[str, int], list[str]]:
    """What became of a file and of damaged copies of it in a process with little memory, and the messages."""
    command = [sys.executable, "-c", READS, str(path), str(count), str(room_mib)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[3])
    found = json.loads(done.stdout)
    assert found["longest"] < LONGEST_S
    assert set(found["found"]) <= {"read", "refused"}, found
    assert [text for text in found["said"] if not text.startswith(str(path)) or "\n" in text] == []
    return found["found"], found["said"]


@pytest.mark.parametrize(
    ("name", "kind", "count"), [("a.binary", "merl", 2), ("a.xml", "klems", 30), ("a.bsdf", "rgl", 20)]
)
def test_damaged_models_within_little_memory(name: str, kind: str, count: int, tmp_path: Path) -> None:
    measurement.write_model(build("lambert", {"albedo": 0.5}), tmp_path / name, name="a", format=kind)
    found, _ = read(tmp_path / name, count)
    assert found["read"] >= 1
    assert found["refused"] > count / 4


@pytest.mark.parametrize("ending", [".h5", ".parquet", ".xlsx"])
def test_damaged_tables_within_little_memory(ending: str, tmp_path: Path) -> None:
    measurement.write(one("a"), tmp_path / f"a{ending}")
    found, _ = read(tmp_path / f"a{ending}", 24)
    assert found["refused"] > 6


def test_a_small_file_of_more_than_the_memory_says_what_it_asked_for(tmp_path: Path) -> None:
    """18 million rows that were never written, of some columns: 14 KiB, and more than a gigabyte."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "huge.h5"
    measurement.write(one("a"), path)
    with h5py.File(path, "r+") as file:
        table = file["entry/table"]
        for column in [name for name in table if table[name].dtype.kind == "f"]:
            attributes, value = dict(table[column].attrs), table[column][0]
            del table[column]
            grown = table.create_dataset(
                column, (18_000_000,), np.float64, chunks=(100_000,), compression="gzip", fillvalue=value
            )
            grown.attrs.update(attributes)
    found, said = read(path, 0, room_mib=1200)
    assert found == {"refused": 1}
    assert "too little memory" in said[0]
    assert "Unable to allocate" in said[0]


def test_a_whole_file_that_does_not_fit_is_not_called_damaged(tmp_path: Path) -> None:
    measurement.write_model(build("lambert", {"albedo": 0.5}), tmp_path / "a.binary", name="a", format="merl")
    _, said = read(tmp_path / "a.binary", 0, room_mib=420)
    assert "too little memory to read it: the file has 33.4 MiB" in said[0]
