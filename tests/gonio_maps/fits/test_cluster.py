"""Maps and tables on a Dask cluster: the same bytes, whatever becomes of a worker."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.selection import many_tables
from gonio_maps.fits import fits

from gonio.measurement import Reading
from tests.gonio_analysis.selection.test_many_tables import tables
from tests.gonio_maps.fits.made import write

pytestmark = pytest.mark.slow
PLASTIC = {"s": 0.4, "d": 0.6, "m": 0.3, "diffuse_albedo": 0.5, "ior": 1.5}
ASKED = FitRequest("cook-torrance")


@pytest.mark.filterwarnings("default")
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX")
def test_a_lost_worker_costs_its_tile_and_the_bytes_are_those_of_one_process(tmp_path: Path, cluster: Any) -> None:
    path, here, there = (tmp_path / name for name in ("map.h5", "here.h5", "there.h5"))
    write(path, lambda x, y: PLASTIC, rows=256, cols=192, pixel_mm=0.0)
    fits.make(path, here, ASKED, count=lambda done, total: None, say=lambda text: None)
    lost = cluster.workers[0].process.process.pid

    def kill(done: int, total: int) -> None:
        assert total == 12
        if done == 1:
            os.kill(lost, signal.SIGKILL)

    fits.make(path, there, ASKED, dask=cluster.scheduler_address, count=kill, say=lambda text: None)
    assert there.read_bytes() == here.read_bytes()


CLIENT = """
import os, signal, sys
from pathlib import Path
from gonio.measurement import Reading
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.selection import many_tables
from gonio_maps.fits import fits
def dies(done, total):
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
what, path, out, address, model = sys.argv[1:]
if what == "map":
    fits.make(Path(path), Path(out), FitRequest(model), dask=address, count=dies, say=print)
else:
    many_tables.make(path, Path(out), FitRequest(model), Reading(), dask=address, count=dies)
"""


def killed(*arguments: object) -> None:
    """A client that is killed after two results."""
    command = [sys.executable, "-c", CLIENT, *map(str, arguments)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL


@pytest.mark.filterwarnings("default")
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX")
def test_a_killed_client_goes_on_with_the_same_cluster(tmp_path: Path, cluster: Any) -> None:
    path, here, there = (tmp_path / name for name in ("map.h5", "here.h5", "there.h5"))
    write(path, lambda x, y: PLASTIC, rows=192, cols=128, pixel_mm=0.0)
    fits.make(path, here, ASKED, count=lambda done, total: None, say=lambda text: None)
    killed("map", path, there, cluster.scheduler_address, ASKED.model)
    said: list[str] = []
    fits.make(
        path, there, ASKED, dask=cluster.scheduler_address, count=lambda done, total: None, say=said.append
    )  # fmt: skip
    assert any("of 6 tiles were done before" in line for line in said)
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.filterwarnings("default")
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX")
def test_tables_outlive_a_client_and_a_worker(tmp_path: Path, cluster: Any) -> None:
    folder, asked = str(tables(tmp_path / "tables", 8)), FitRequest("oren-nayar")
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    many_tables.make(folder, here, asked, Reading(), count=lambda done, total: None)
    killed("tables", folder, there, cluster.scheduler_address, asked.model)
    lost = cluster.workers[0].process.process.pid

    def kill(done: int, total: int) -> None:
        if done == 1:
            os.kill(lost, signal.SIGKILL)

    found = many_tables.make(folder, there, asked, Reading(), dask=cluster.scheduler_address, count=kill)
    assert found.before >= 1
    assert there.read_bytes() == here.read_bytes()
