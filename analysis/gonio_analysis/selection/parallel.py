"""Many independent jobs at once: on the processors here, or on a Dask cluster whose scheduler is named."""

import logging
import os
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

from gonio.errors import ConfigError, DataError
from gonio.progress import Pace, Say, silent
from gonio_analysis.processes import Processes, processes

FEW = 4
"""Fewer jobs than this run here: to start a process and its imports takes longer than most fits."""

LEAST_AHEAD = 8
"""Jobs that a cluster has at a time, at least: workers may come while it works."""
PATIENCE_S = 20.0
"""Longest wait for an answer of a Dask scheduler."""

In = TypeVar("In")
Out = TypeVar("Out")


class Share(Protocol):
    """Does several jobs, perhaps with the help of other processes, and returns their results in the jobs' order.

    A job is called with what takes lines of progress; to travel, it is a function of a module with its arguments
    (`functools.partial`).
    """

    def __call__(self, jobs: Sequence[Callable[[Say], Out]], what: str = "", say: Say = silent) -> list[Out]: ...


def here(jobs: Sequence[Callable[[Say], Out]], what: str = "", say: Say = silent) -> list[Out]:
    """Do jobs one after another in this process; `what` they are is said before how many are done."""
    pace = Pace(what, len(jobs), say)
    out = []
    for k, job in enumerate(jobs):
        pace.step(k)
        out.append(job(say))
    return out


def each(
    function: Callable[[In], Out],
    jobs: Iterable[In],
    *,
    dask: str | None = None,
    workers: int | None = None,
    pool: Processes | None = None,
) -> Iterator[tuple[int, Out]]:
    """The number of every job and the function's result for it, as they become ready.

    Who calls keeps the results, so that whatever ends this process leaves those that are done.

    Parameters
    ----------
    function
        Of a module's top level, so that other processes find it; what is the main program's own is done here.
    jobs
        One argument each. Fewer than `FEW` run here, unless a scheduler is named.
    dask
        Address of a Dask scheduler, as in "tcp://127.0.0.1:8786"; its workers need this package. What a lost worker was
        at is done by another one. Jobs are taken when workers are near them, so that few are in memory at a time.
    workers
        Processes, where no scheduler is named: one for each processor by default. With 1 all jobs run here.
    pool
        Processes that are there already; more are started where it has too few.

    Raises
    ------
    ConfigError
        The optional package `distributed` is missing, or the scheduler does not answer.
    DataError
        A job ended the process that it was given to, and another one after that: most often for want of memory. Or it
        ended several workers of a cluster, or the scheduler went.
    """
    if dask is not None:
        yield from _on_cluster(function, jobs, dask)
        return
    jobs = list(jobs)
    if len(jobs) < FEW or workers == 1:
        yield from enumerate(map(function, jobs))
        return
    count = min(len(jobs), workers or os.cpu_count() or 1)
    if pool is None:
        yield from _on_processors(function, jobs, count)
    else:
        pool.grow(count)
        yield from pool.each(function, jobs)


def _on_processors(function: Callable[[In], Out], jobs: Sequence[In], workers: int) -> Iterator[tuple[int, Out]]:
    """Whatever ends this, an error, a signal or the death of this process, ends the other processes at once."""
    with processes(workers) as pool:
        yield from pool.each(function, jobs)


def _on_cluster(function: Callable[[In], Out], jobs: Iterable[In], address: str) -> Iterator[tuple[int, Out]]:
    try:
        from distributed import Client, KilledWorker
        from distributed import as_completed as as_completed_there
    except ImportError:
        raise ConfigError("--dask needs the package distributed: pip install 'gonio[dask]'") from None
    _require_address(address)
    found: Future[Any] = Future()

    def call() -> None:  # what takes the connection and says nothing is waited for beyond Client's own timeout
        try:
            found.set_result(Client(address, timeout=10, set_as_default=False))
        except Exception as error:
            found.set_exception(error)

    threading.Thread(target=call, daemon=True).start()
    try:
        client = found.result(timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        reason = str(error) or f"nothing was said for {PATIENCE_S:g} s"
        raise ConfigError(f"--dask {address}: no scheduler answers there: {reason}") from None
    with _without_tracebacks("distributed.client"), client:
        ahead = max(LEAST_AHEAD, 2 * sum(client.nthreads().values()))
        waiting: dict[Any, int] = {}
        ready = as_completed_there(loop=client.loop)
        try:
            for k, job in enumerate(jobs):
                future = client.submit(function, job, pure=False)
                waiting[future] = k
                ready.add(future)
                if len(waiting) >= ahead:
                    future = next(ready)
                    yield waiting.pop(future), future.result()
            for future in ready:
                yield waiting.pop(future), future.result()
        except (KilledWorker, CancelledError) as error:
            reason = str(error).partition("\n")[0]
            if "scheduler-connection-lost" in reason:
                reason = "its scheduler has gone, or cannot be reached any more"
            raise DataError(f"--dask {address}: the cluster has given up: {reason}") from None


@contextmanager
def _without_tracebacks(name: str) -> Iterator[None]:
    """What a library logs of a lost connection, pages of its own code, is left out: an error says it in a line."""
    log = logging.getLogger(name)
    before = log.level
    if not os.environ.get("GONIO_TRACEBACK"):
        log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def _require_address(address: str) -> None:
    """`ConfigError` for what cannot be a scheduler's address: a `Client` of it would be left half made."""
    from distributed.comm import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, location = parse_address(address)
        get_backend(scheme)
        if scheme == "inproc":
            return
        host, port = parse_host_port(location)
        if not 0 < int(port) < 65536:
            raise ValueError(f"the port is {port}, and ports go from 1 to 65535")
        socket.getaddrinfo(host, port)
    except (OSError, ValueError) as error:
        reason = f"the host is not known ({error.strerror})" if isinstance(error, OSError) else error
        raise ConfigError(
            f"--dask {address!r}: is no address of a scheduler: {reason}; one looks like tcp://127.0.0.1:8786"
        ) from None
