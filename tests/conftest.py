"""What holds for every test: none is timed, because machines that run them are busy with others."""

import gc
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings

# as the command has it: threads of BLAS that wait for each other cost more than they save; numpy is not imported yet
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# tests are collected in two thirds of the time, and what they are made of is looked through by no test's own collection
gc.disable()

# the same examples in every run; `pytest --hypothesis-profile=default` draws others
settings.register_profile("gonio", deadline=None, derandomize=True)
settings.load_profile("gonio")

# a shell without job control starts what it puts into the background deaf to two of these, and nohup to the third;
# what has a handler here, if only one that does nothing, is heard by the programs that tests start
for _number, _usual in (
    (signal.SIGINT, signal.default_int_handler), (signal.SIGQUIT, signal.SIG_DFL), (signal.SIGHUP, lambda *_: None)
):  # fmt: skip
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _usual)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rig", help="try the contracts (tests/contracts) on this rig alone: a rig file, or a rig's name")
    parser.addoption("--sample", help="the sample file that a simulated rig is given with --rig")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules with slow tests come first: at the end no process is left alone with one."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def _no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are written without waiting until a busy disk has them: no test cuts the power. Commands do wait."""
    monkeypatch.setattr("os.fsync", lambda descriptor: None)


@pytest.fixture(autouse=True)
def _drawn_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages start no process that draws along: each takes two seconds of processor. Tests of those say how many."""
    monkeypatch.setattr("gonio_analysis.report.drawing.MOST_PROCESSES", 1)


@pytest.fixture(autouse=True)
def _what_a_test_adds_goes_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models, choosers and other plug-ins that are added while a program runs."""
    from gonio import plugins

    monkeypatch.setattr(plugins, "_added", dict(plugins._added))


@pytest.fixture
def one_id(monkeypatch: pytest.MonkeyPatch) -> None:
    """All runs have one id, so that they can be compared to the byte: nothing else differs from run to run."""
    monkeypatch.setattr("secrets.token_hex", lambda size: "1d" * size)


@pytest.fixture(autouse=True)
def _hears_its_signals() -> Iterator[None]:
    """A test that left this process deaf to Ctrl-C would make the programs deaf that later tests start."""
    yield
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser's tab, for tests that are skipped where there is no browser (`tests.browser.CHROMIUM`)."""
    from tests.browser import browser  # not on every system

    with browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def _one_cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed", reason="the extra gonio[dask] is not installed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
    ) as found:
        yield found


@pytest.fixture
def cluster(_one_cluster: Any) -> Iterator[Any]:
    """A Dask cluster of two workers, processes of their own, on the loopback; those that a test ends are started anew.

    To be closed while it starts a worker anew is an error of distributed's own: tests wait until they are back.
    """
    yield _one_cluster
    ends = time.monotonic() + 60.0  # so that a failure ends
    while len(_one_cluster.scheduler.workers) < len(_one_cluster.workers) and time.monotonic() < ends:
        time.sleep(0.02)
