"""Figures drawn by several processes: the same files as one process makes.

A drawing is sent to a process as a pickle of a few thousand values, and comes back as its SVG and PNG: only this
process writes files. The others read from a pipe, and end when it closes, however this process ends. They import what
drawing needs and nothing else, in no relation to the program that runs here: a script needs no guard around its main
part, and a process that was spawned may have such processes of its own.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from gonio.cli.pace import Pace, Say, silent
from gonio_analysis.report.figures import Drawing, Figure

FEW = 6
"""Fewer figures than this are drawn here alone: to start a process takes as long as two of them."""
MOST_PROCESSES = 8
_SERVE = "from gonio_analysis.report.drawing import serve; serve()"


class Draughtsmen:
    """Processes that draw beside this one."""

    def __init__(self, processes: Sequence[subprocess.Popen[bytes]] = ()) -> None:
        self._processes = processes

    def draw(self, drawings: Sequence[Drawing], say: Say = silent) -> list[Figure]:
        """Every drawing as SVG and PNG, in their order; `say` is called with a line now and then."""
        pace = Pace("drawing: figures", len(drawings), say)
        made: list[Figure | None] = [None] * len(drawings)
        waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
        for k in range(len(drawings)):
            waiting.put(k)
        hands = [threading.Thread(target=_hand_over, args=(p, drawings, waiting, made)) for p in self._processes]
        for hand in hands:
            hand.start()
        try:
            for k in _taken(waiting):
                made[k] = drawings[k].rendered()
                pace.step(sum(figure is not None for figure in made))
        except BaseException:
            self.stop()
            raise
        finally:
            for hand in hands:
                hand.join()
        # what a process that died had taken
        return [figure if figure is not None else drawings[k].rendered() for k, figure in enumerate(made)]

    def stop(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.kill()


@contextmanager
def draughtsmen(figures: int, processes: int | None = None) -> Iterator[Draughtsmen]:
    """Processes for about so many figures; they end with the block.

    Parameters
    ----------
    figures
        How many are expected; for fewer than `FEW` no other process is started.
    processes
        How many draw, this one included; by default as many as there are processors.
    """
    count = min(_processors(), MOST_PROCESSES) if processes is None else processes
    others = min(count, figures // 2) - 1 if figures >= FEW and sys.executable else 0
    started: list[subprocess.Popen[bytes]] = []
    try:
        for _ in range(others):
            try:
                started.append(_start())
            except OSError:  # no process or no memory for one: the figures are drawn by those that there are
                break
        yield Draughtsmen(started)
    finally:
        for process in started:
            process.kill()
        for process in started:
            process.communicate()


def serve() -> None:
    """Draw what stands on standard input until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that started this one decides
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no figure
    import matplotlib.backends.backend_agg
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

    while True:
        try:
            drawing: Drawing = pickle.load(source)
        except EOFError:
            return
        pickle.dump(drawing.rendered(), sink)
        sink.flush()


def _start() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-P", "-c", _SERVE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def _hand_over(
    process: subprocess.Popen[bytes],
    drawings: Sequence[Drawing],
    waiting: queue.SimpleQueue[int],
    made: list[Figure | None],
) -> None:
    """Have a process draw what is waiting. One that dies leaves its drawing to this process."""
    assert process.stdin is not None
    assert process.stdout is not None
    for k in _taken(waiting):
        try:
            pickle.dump(drawings[k], process.stdin)
            process.stdin.flush()
            made[k] = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            return


def _taken(waiting: queue.SimpleQueue[int]) -> Iterator[int]:
    while True:
        try:
            yield waiting.get_nowait()
        except queue.Empty:
            return


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
