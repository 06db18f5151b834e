"""Work in a few threads, in order."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from gonio import platform

In = TypeVar("In")
Out = TypeVar("Out")
THREADS = platform.processors()


def in_threads(work: Callable[[In], Out], items: Iterable[In]) -> Iterator[Out]:
    """`map` in a thread a processor, in order, a few items ahead: hashing and decoding release the interpreter."""
    with ThreadPoolExecutor(THREADS, thread_name_prefix="gonio-reduce") as pool:
        waiting = []
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > 2 * THREADS:
                    yield waiting.pop(0).result()
            for future in waiting:
                yield future.result()
        finally:
            for future in waiting:
                future.cancel()
