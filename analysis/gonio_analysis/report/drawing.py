"""Drawings of a page, and the figures that several processes make of them: the same files as one process makes.

A drawing is sent to a process as a pickle of a few thousand values, and comes back as its SVG and PNG: only this
process writes files. Fits that do not wait for each other go the same way, with the same results to the last digit.
The others read from a pipe, and end when it closes, however this process ends. They import what drawing needs and
nothing else, in no relation to the program that runs here: a script needs no guard around its main part, and a
process that was spawned may have such processes of its own.
"""

import hashlib
import importlib
import io
import os
import pickle
import queue
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, BinaryIO, TypeVar

from gonio import canvas, platform
from gonio.cli.console import Pace, Say, silent
from gonio.shown import visible

SVG = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gonio",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
}
FONTS = "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"
"""Metrics close to those that matplotlib lays out with, so that labels keep their places."""
PNG_DPI = 160


@dataclass(frozen=True)
class Described:
    """What a page says of a figure."""

    name: str
    kind: str
    """"polar", "absolute", "budget" or "series": the page groups by it."""
    model: str
    caption: str
    alt: str

    def summary(self) -> dict[str, str]:
        """What `summary.json` says of it."""
        return {"name": self.name, "caption": self.caption, "alt": self.alt}


@dataclass(frozen=True)
class Figure(Described):
    """One drawn figure."""

    svg: str
    png: bytes


@dataclass(frozen=True)
class Drawing(Described):
    """A figure that is still to be drawn, with what its drawing needs: little enough to be sent to another process."""

    inches: tuple[float, float]
    on: Callable[[Any], None]
    """Draws on a canvas of that size: a function of a module, with its arguments (`functools.partial`)."""

    def rendered(self) -> Figure:
        """The figure as SVG and PNG; the same drawing gives the same bytes."""
        from matplotlib import rc_context
        from matplotlib.figure import Figure as Canvas

        png, svg = io.BytesIO(), io.StringIO()
        with rc_context(SVG):
            figure = Canvas(figsize=self.inches)
            with canvas.literal():
                self.on(figure)
            quick = {"compress_level": 3}  # a tenth larger than at best, in a third of the time
            canvas.save(figure, png, format="png", dpi=PNG_DPI, metadata={"Software": "gonio"}, pil_kwargs=quick)
            canvas.save(figure, svg, format="svg", metadata={"Date": None, "Creator": "gonio"})
        words = (self.name, self.kind, self.model, self.caption, self.alt)
        return Figure(*words, _tidy(svg.getvalue(), self.name), png.getvalue())


def rendered(
    name: str, kind: str, model: str, caption: str, alt: str, inches: tuple[float, float], on: Callable[[Any], None]
) -> Figure:
    """What `on` draws on a canvas of some `inches`, at once."""
    return Drawing(name, kind, model, caption, alt, inches, on).rendered()


def _tidy(svg: str, name: str) -> str:
    """SVG that can stand in an HTML page: no prologue, no fixed size, ids of its own, and a third of the bytes.

    What is referred to is numbered as it comes, so that the same drawing gives the same bytes in every process.
    """
    svg = visible(svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    for size in ("height", "width"):
        svg = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", svg, count=1)
    svg = _numbered(svg, "f" + hashlib.sha256(name.encode()).hexdigest()[:8])
    svg = re.sub(r"font-family: 'DejaVu Sans'(, sans-serif|, '[^']*')*(; )?", "", svg)
    svg = svg.replace("<svg", f'<svg style="font-family: {FONTS}"', 1)
    # inside of tags alone: what a label says stays as it is
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"\.(\d\d)\d+|\.(\d+)", _decimals, tag[0]), svg)
    svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"\s*([MLCQz])\s*", r"\1", d[0]).replace(' "', '"'), svg)
    svg = re.sub(r">\s+<", ">\n<", svg)
    return _joined(svg)


def _numbered(svg: str, prefix: str) -> str:
    """Only ids that something refers to, numbered."""
    found = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg)
    new = {old: f"{prefix}-{k}" for k, old in enumerate(dict.fromkeys(a or b for a, b in found))}
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{new[m[1]]}"' if m[1] in new else "", svg)
    svg = re.sub(r"url\(#([^)]+)\)", lambda m: f"url(#{new[m[1]]})", svg)
    return re.sub(r'href="#([^"]+)"', lambda m: f'href="#{new[m[1]]}"', svg)


def _decimals(match: re.Match[str]) -> str:
    digits = (match[1] or match[2]).rstrip("0")
    return f".{digits}" if digits else ""


def _joined(svg: str) -> str:
    """Markers of one look in one group, and lines of one look in one path."""

    def group(run: re.Match[str]) -> str:
        uses = re.sub(r' style="[^"]*"', "", run[0])
        return f'<g style="{run[2]}">\n{uses}</g>\n'

    def path(run: re.Match[str]) -> str:
        every = "".join(re.findall(r' d="([^"]*)"', run[0]))
        return f'<path d="{every}" {run[1]}/>\n'

    use, style = r'<use xlink:href="(#[^"]+)" x="[^"]*" y="[^"]*"', r' style="([^"]*)"/>\n'
    svg = re.sub(rf'{use}{style}(?:<use xlink:href="\1" x="[^"]*" y="[^"]*" style="\2"/>\n)+', group, svg)
    return re.sub(r'<path d="[^"]*" ([^>]*fill: none[^>]*)/>\n(?:<path d="[^"]*" \1/>\n)+', path, svg)


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
        # figures that a process had taken and died over are drawn here
        return [made[k] if k in made else job(say) for k, job in enumerate(jobs)]

    def stop(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.kill()


@contextmanager
def figure_workers(figures: int, processes: int | None = None, modules: Sequence[str] = ()) -> Iterator[FigureWorkers]:
    """Processes that draw about `figures` figures; they end with the block.

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
