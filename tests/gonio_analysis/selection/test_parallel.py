"""Samples on several processes, and on a Dask cluster."""

import logging
import math
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.selection import parallel

from gonio.errors import ConfigError, DataError

# each process of these tests imports this module: fits and models are imported where they are used


def test_a_fit_goes_to_another_process_and_back() -> None:
    from gonio_analysis.fitting.fit import fit

    from gonio.models import build
    from tests.gonio_analysis.synthetic import measure

    paint = build("cook-torrance", {"s": 0.1, "d": 0.9, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})
    result = fit(measure(paint), "cook-torrance", fix={"ior": 1.5}, bounds={"m": (0.1, 0.5)})
    again = pickle.loads(pickle.dumps(result))
    assert again.to_json() == result.to_json()
    assert again.problem.model(again.vector) == result.model


def test_in_this_process_results_come_in_the_order_of_the_jobs() -> None:
    assert list(parallel.each(abs, [-3, 2, -1, 5], workers=1)) == [(0, 3), (1, 2), (2, 1), (3, 5)]


@pytest.mark.parametrize(
    ("count", "asked", "started"),
    [(3, None, None), (3, 2, None), (4, 1, None), (4, 2, 2), (4, None, 4), (4, 9, 4), (20, None, 16)],
)
def test_processes_are_started_for_four_jobs_or_more(
    count: int, asked: int | None, started: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On 16 processors; no more processes than jobs."""
    found: list[int] = []

    def elsewhere(function: Any, jobs: list[int], workers: int) -> Any:
        found.append(workers)
        return enumerate(map(function, jobs))

    monkeypatch.setattr(parallel, "_on_processors", elsewhere)
    monkeypatch.setattr("os.cpu_count", lambda: 16)
    assert list(parallel.each(abs, [-k for k in range(count)], workers=asked)) == [(k, k) for k in range(count)]
    assert found == ([] if started is None else [started])


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("way", ["processes", "cluster"])
def test_a_result_that_is_ready_waits_for_none_before_it(
    way: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    dask = request.getfixturevalue("cluster").scheduler_address if way == "cluster" else None
    another_came = tmp_path / "another came"
    jobs, found = [str(another_came), "", "", ""], dict[int, str]()
    for k, result in parallel.each(_held, jobs, dask=dask, workers=2):
        another_came.touch()
        found[k] = result
    assert found == dict(enumerate(jobs))


def _answers(at: tuple[str, int]) -> bool:
    with socket.socket() as tried:
        return tried.connect_ex(at) == 0


def _held(until: str) -> str:
    """A job that ends when a path exists, if it is given one; within ten minutes, so that a failure ends."""
    ends = time.monotonic() + 600.0
    while until and not Path(until).exists():
        if time.monotonic() > ends:
            raise TimeoutError(until)
        time.sleep(0.05)
    return until


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_scheduler_that_goes_is_one_line(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed")
    monkeypatch.setattr(logging.getLogger("distributed.client"), "propagate", True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        at = free.getsockname()
    words = ["--host", at[0], "--port", str(at[1]), "--no-dashboard"]
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *words]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as scheduler:
        try:
            ends = time.monotonic() + 120.0
            while not _answers(at) and time.monotonic() < ends:
                time.sleep(0.1)
            threading.Timer(2.0, scheduler.kill).start()  # once the client waits for a worker
            with pytest.raises(DataError, match=r"the cluster has given up: its scheduler has gone, or cannot"):
                list(parallel.each(_held, ["", ""], dask=f"tcp://{at[0]}:{at[1]}"))
        finally:
            scheduler.kill()
    assert not [record for record in caplog.records if record.exc_info]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_job_that_ends_every_worker_is_an_error(cluster: Any) -> None:
    with pytest.raises(DataError, match=r"the cluster has given up: .*exit") as raised:
        list(parallel.each(os._exit, [3], dask=cluster.scheduler_address))
    assert "\n" not in str(raised.value)


def test_an_examined_sample_comes_back_whole() -> None:
    from gonio_analysis.report.comparison import summarise
    from gonio_analysis.result_records import as_json
    from gonio_analysis.selection.compare import examine

    from gonio.models import Lambert
    from tests.gonio_analysis.synthetic import measure

    dataset = examine(measure(Lambert(0.5), name="matte"), ["lambert", "oren-nayar"], name="matte")
    again = pickle.loads(pickle.dumps(dataset))
    one, other = (summarise([d], title="", normalise="mirror", command="").datasets for d in (again, dataset))
    assert as_json(one) == as_json(other)


def test_on_a_cluster() -> None:
    with pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed").LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        assert list(parallel.each(abs, [-3, 2], dask=cluster.scheduler_address)) == [(0, 3), (1, 2)]


def test_a_cluster_without_its_package_or_scheduler_is_an_error() -> None:
    with pytest.raises(ConfigError, match="--dask"):
        list(parallel.each(abs, [1], dask="tcp://127.0.0.1:9"))


HANGING = """
import os, threading
def hang(job):
    os.write(1, b"here\\n")
    threading.Event().wait(600)
"""


@pytest.mark.parametrize(
    ("number", "to_all", "code"),
    [
        (signal.SIGINT, True, 130), (signal.SIGINT, False, 130), (signal.SIGTERM, True, 130),
        (signal.SIGKILL, False, -signal.SIGKILL),
    ],
)  # fmt: skip
def test_no_process_outlives_a_signal(tmp_path: Path, number: signal.Signals, to_all: bool, code: int) -> None:
    """The end of the output comes when the last process that holds it has gone."""
    (tmp_path / "hanging.py").write_text(HANGING)
    (tmp_path / "stranger.py").write_text(
        "def hang() -> None:\n    import hanging\n    from gonio_analysis.selection import parallel\n"
        "    list(parallel.each(hanging.hang, range(4)))\n"
    )
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[gonio.commands]\nhang = stranger:hang\n")
    with subprocess.Popen(
        [sys.executable, "-c", "from gonio.cli import main; main()", "hang"],
        env=os.environ | {"PYTHONPATH": str(tmp_path)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as started:  # fmt: skip
        assert started.stdout is not None
        assert started.stdout.readline() == "here\n"
        if to_all:
            os.killpg(started.pid, number)
        else:
            started.send_signal(number)
        _, said = started.communicate(timeout=600)
    assert started.returncode == code
    if number != signal.SIGKILL:
        assert said == "gonio: interrupted\n"


def test_a_process_that_dies_is_an_error() -> None:
    with pytest.raises(DataError, match="has died"):
        list(parallel.each(os._exit, [3, 3, 3, 3]))


def _at_30_degrees(theta_r: float) -> float:
    from gonio.models import CookTorrance

    return float(CookTorrance(ior=1.5).brdf(0.5, 0.0, theta_r, math.pi))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_models_in_a_pool_of_processes(method: str) -> None:
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"{method} is unknown to this system")
    angles = [0.1, 0.5, 0.9]
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(_at_30_degrees, angles) == [_at_30_degrees(angle) for angle in angles]


def test_a_scheduler_that_takes_the_connection_and_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed")
    monkeypatch.setattr(parallel, "PATIENCE_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as deaf:
        address = f"tcp://127.0.0.1:{deaf.getsockname()[1]}"
        with pytest.raises(ConfigError, match="nothing was said"):
            list(parallel.each(abs, [1], dask=address))


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("nonsense", "missing port"),
        ("", "missing port"),
        ("tcp://127.0.0.1:abc", "invalid literal"),
        ("tcp://127.0.0.1:99999", "ports go from 1 to 65535"),
        ("tcp://127.0.0.1:-1", "ports go from 1 to 65535"),
        ("foo://127.0.0.1:8786", "unknown address scheme"),
        ("tcp://[::1:8", "invalid address"),
        ("tcp://no host:8786", "the host is not known"),
    ],
)
def test_what_is_no_address_makes_no_client(address: str, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed")

    def client(*args: object, **kwargs: object) -> None:  # one that fails to be made complains when the process ends
        raise AssertionError("a client was made")

    monkeypatch.setattr(distributed, "Client", client)
    with pytest.raises(ConfigError, match=told) as raised:
        list(parallel.each(abs, [1], dask=address))
    assert "\n" not in str(raised.value)
