"""Many samples at once: on the processors here, or on a Dask cluster whose scheduler is named."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from gonio.errors import ConfigError

FEW = 4
"""Fewer jobs than this run here: to start a process and its imports takes longer than most fits."""

In = TypeVar("In")
Out = TypeVar("Out")


def each(function: Callable[[In], Out], jobs: Sequence[In], *, dask: str | None = None) -> Iterator[Out]:
    """The function's results for every job, in their order, as they become ready.

    Parameters
    ----------
    function
        Of a module's top level: other processes have to find it.
    jobs
        One argument each. Fewer than `FEW` run here, unless a scheduler is named.
    dask
        Address of a Dask scheduler, as in "tcp://127.0.0.1:8786"; its workers need this package.

    Raises
    ------
    ConfigError
        The optional package `distributed` is missing, or the scheduler does not answer.
    """
    if dask is not None:
        yield from _on_cluster(function, jobs, dask)
    elif len(jobs) < FEW:
        yield from map(function, jobs)
    else:
        workers = min(len(jobs), os.cpu_count() or 1)
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            yield from pool.map(function, jobs)


def _on_cluster(function: Callable[[In], Out], jobs: Sequence[In], address: str) -> Iterator[Out]:
    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--dask needs the package distributed: pip install 'gonio[dask]'") from None
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--dask {address}: no scheduler answers there: {error}") from None
    with client:
        yield from client.gather(client.map(function, jobs, pure=False))
