"""One thread that owns the devices of a rig, and what Bluesky waits for: `bluesky.protocols.Status`."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

Result = TypeVar("Result")


class Status:
    """Whether something is done, and how it ended."""

    def __init__(self) -> None:
        self._ended: Future[None] = Future()

    @classmethod
    def finished(cls) -> "Status":
        """Of what takes no time."""
        status = cls()
        status.finish(None)
        return status

    def finish(self, error: BaseException | None) -> None:
        """It is done; with an error, it has failed. What comes later does not count."""
        if self._ended.done():
            return
        if error is None:
            self._ended.set_result(None)
        else:
            self._ended.set_exception(error)

    def add_callback(self, callback: "Callable[[Status], None]") -> None:
        """Have somebody told when it is done; at once where it is."""
        self._ended.add_done_callback(lambda _: callback(self))

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Why it failed; None where it did not. Waits so long for the end [s], and raises `TimeoutError` after that."""
        return self._ended.exception(timeout)

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end, and raise what it failed by."""
        self._ended.result(timeout)

    @property
    def done(self) -> bool:
        """Whether it has ended."""
        return self._ended.done()

    @property
    def success(self) -> bool:
        """Whether it has ended well."""
        return self.done and self._ended.exception() is None


class Owner:
    """A thread in which all is done that devices do: they are not made for several."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-bluesky")

    def ask(self, do: Callable[[], Result]) -> Result:
        """Have something done, after what was asked for before; its result."""
        return self._pool.submit(do).result()

    def begin(self, do: Callable[[], Any], done: Callable[[BaseException | None], BaseException | None]) -> Status:
        """Have something done, and go on meanwhile; `done` says what of its error counts."""
        status = Status()

        def work() -> None:
            try:
                do()
            except BaseException as error:  # whoever waits is told, whatever it is
                status.finish(done(error))
            else:
                status.finish(done(None))

        self._pool.submit(work)
        return status

    def close(self) -> None:
        """End the thread, after what was asked for."""
        self._pool.shutdown()
