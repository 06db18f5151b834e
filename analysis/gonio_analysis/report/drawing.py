"""Figures drawn by several processes: the same files as one process makes.

A drawing is sent to a process as a pickle of a few thousand values, and comes back as its SVG and PNG: only this
process writes files. Fits that do not wait for each other go the same way, with the same results to the last digit.
The others read from a pipe, and end when it closes, however this process ends. They import what drawing needs and
nothing else, in no relation to the program that runs here: a script needs no guard around its main part, and a
process that was spawned may have such processes of its own.
"""

import importlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import BinaryIO, TypeVar

from gonio import platform
from gonio.cli.pace import Pace, Say, silent
from gonio_analysis.report.drawings import Drawing, Figure

FEW = 6
"""Fewer figures than this are drawn here alone: to start a process takes as long as two of them."""
MOST_PROCESSES = 8
T = TypeVar("T")
_SERVE = "from gonio_analysis.report.drawing import serve; serve()"


class FigureWorkers:
    """Processes that draw beside this one, and do what else is independent of each other before there is a drawing."""

    def __init__(self, processes: Sequence[subprocess.Popen[bytes]] = ()) -> None:
        self._processes = processes

    def draw(
        self, drawings: Sequence[Drawing], say: Say = silent, meanwhile: Callable[[], object] = lambda: None
    ) -> list[Figure]:
        """Every drawing as SVG and PNG, in their order.

        Parameters
        ----------
        drawings
            What to draw.
        say
            Called with a line now and then.
        meanwhile
            Done here, while the others begin to draw.
        """
        return self._shared([partial(_rendered, one) for one in drawings], "drawing: figures", say, meanwhile)

    def share(self, jobs: Sequence[Callable[[Say], T]], what: str = "", say: Say = silent) -> list[T]:
        """See `gonio_analysis.selection.parallel.Share`."""
        return self._shared(jobs, what, say, lambda: None)

    def _shared(
        self, jobs: Sequence[Callable[[Say], T]], what: str, say: Say, meanwhile: Callable[[], object]
    ) -> list[T]:
        pace, made = Pace(what, len(jobs), say), dict[int, T]()
        waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
        for k in range(len(jobs)):
            waiting.put(k)
        helping = self._processes[: max(len(jobs) - 1, 0)]
        workers = [threading.Thread(target=_hand_over, args=(p, jobs, waiting, made, say)) for p in helping]
        for hand in workers:
            hand.start()
        try:
            meanwhile()
            for k in _taken(waiting):
                made[k] = jobs[k](say)
                pace.step(len(made))
        except BaseException:
            self.stop()
            raise
        finally:
            for hand in workers:
                hand.join()
        # what a process that died had taken
        return [made[k] if k in made else job(say) for k, job in enumerate(jobs)]

    def stop(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.kill()


@contextmanager
def figure_workers(figures: int, processes: int | None = None, modules: Sequence[str] = ()) -> Iterator[FigureWorkers]:
    """Processes for about so many figures; they end with the block.

    Parameters
    ----------
    figures
        How many are expected; for fewer than `FEW` no other process is started.
    processes
        How many draw, this one included; by default as many as there are processors.
    modules
        What they import while they wait, beside what drawing needs.
    """
    count = min(platform.processors(), MOST_PROCESSES) if processes is None else processes
    others = min(count, figures // 2) - 1 if figures >= FEW and sys.executable else 0
    started: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(others):
            try:
                started.append(_start(modules))
            except OSError:  # no process or no memory for one: the figures are drawn by those that there are
                break
        yield FigureWorkers(started)
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.communicate()


def serve() -> None:
    """Do the jobs that stand on standard input until it ends; the arguments are modules that will be needed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no figure
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

    for module in sys.argv[1:]:
        importlib.import_module(module)
    while True:
        try:
            job: Callable[[Say], object] = pickle.load(source)
        except EOFError:
            return
        _send((True, job(lambda text: _send((False, text), sink))), sink)


def _send(message: tuple[bool, object], sink: BinaryIO) -> None:
    """A result, or else a line of progress."""
    pickle.dump(message, sink)
    sink.flush()


def _rendered(drawing: Drawing, say: Say) -> Figure:
    return drawing.rendered()


def _start(modules: Sequence[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _SERVE, *modules],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _hand_over(
    process: subprocess.Popen[bytes],
    jobs: Sequence[Callable[[Say], T]],
    waiting: queue.SimpleQueue[int],
    made: dict[int, T],
    say: Say,
) -> None:
    """Have a process do what is waiting. One that dies leaves its job to this process."""
    assert process.stdin is not None
    assert process.stdout is not None
    for k in _taken(waiting):
        try:
            pickle.dump(jobs[k], process.stdin)
            process.stdin.flush()
            while k not in made:
                done, content = pickle.load(process.stdout)
                if done:
                    made[k] = content
                else:
                    say(content)
        except (OSError, EOFError, pickle.UnpicklingError):
            return


def _taken(waiting: queue.SimpleQueue[int]) -> Iterator[int]:
    while True:
        try:
            yield waiting.get_nowait()
        except queue.Empty:
            return
