"""The progress of a measurement: a bar with a line of live values on a terminal, a few plain lines elsewhere.

Keys that pause a measurement, heard while it runs; prompts of the rig have the terminal for themselves meanwhile.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Self

from gonio import platform
from gonio.cli.console import LINES, note, progress_bar, terminal
from gonio.progress import duration
from gonio.shown import visible

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from gonio.lab.acquisition.progress import Live, Pause, Progress, Remaining, TimeLeft

UNSURE = 0.02
"""An uncertainty of a time below this share of it is not said."""


def on_screen(pause: Pause | None = None) -> contextlib.AbstractContextManager[Progress]:
    """Somebody who shows a measurement: a bar with a line of live values on a terminal, a few plain lines elsewhere.

    With `pause` its keys are heard where a terminal is there to press them on (`PauseKeys`).
    """
    return _on_terminal(pause) if sys.stderr.isatty() else contextlib.nullcontext(_Lines())


def values(live: Live) -> str:
    """The line of live values."""
    what = live.step.kind if live.step.point is None else f"point {live.step.point}"
    if live.angles_deg is not None:
        theta_i, phi_i, theta_r, phi_r = live.angles_deg
        what += f": theta_i {theta_i:g}, theta_r {theta_r:g}, dphi {(phi_r - phi_i) % 360:g} deg"
    signal = "" if live.step.kind == "dark" else f"{100 * live.level:.0f} % of full scale in "
    return f"{what}; {signal}{live.exposure_s:.3g} s" + (f"  [{live.flag}]" if live.flag else "")


def time_left(left: TimeLeft | None) -> str:
    """How long something takes yet, with its uncertainty where that matters; "" where nobody knows."""
    if left is None:
        return ""
    unsure = left.u_seconds >= max(UNSURE * left.seconds, 1.0)
    return f"{duration(left.seconds)}" + (f" ± {duration(left.u_seconds)}" if unsure else "") + " left"


class _Rest:
    """Times the steps of a measurement, and says how long the rest takes."""

    def __init__(self) -> None:
        self._remaining: Remaining | None = None
        self._since_s = 0.0
        self._said_s = -math.inf
        self._words = ""

    def expects(self, remaining: Remaining) -> None:
        self._remaining = remaining

    def start(self, steps: int = 0, done: int = 0) -> None:
        self._since_s = time.monotonic()

    def more(self, steps: int) -> None:
        if self._remaining is not None:
            self._remaining.more(steps)

    def step(self, live: Live) -> None:
        before_s, self._since_s = self._since_s, time.monotonic()
        if self._remaining is not None and live.record is not None:
            self._remaining.took(live.record, self._since_s - before_s)

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Time that is nobody's."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            self.waited(time.monotonic() - began_s)

    def waited(self, seconds: float) -> None:
        self._since_s += seconds

    def words(self, every_s: float = 0.0) -> str:
        """What is left, in words that are that old at most."""
        if self._remaining is not None and time.monotonic() - self._said_s >= every_s:
            self._words, self._said_s = time_left(self._remaining.left), time.monotonic()
        return self._words


class _Lines(_Rest):
    """Progress in a log file."""

    def start(self, steps: int = 0, done: int = 0) -> None:
        super().start()
        self._steps, self._done = steps, done
        note(f"{steps - done} steps to take" + (f", {done} of {steps} were done before" if done else ""))

    def more(self, steps: int) -> None:
        super().more(steps)
        self._steps += steps

    def step(self, live: Live) -> None:
        super().step(live)
        self._done += 1
        if self._done * LINES // self._steps > (self._done - 1) * LINES // self._steps:
            words = (f"{self._done:>{len(str(self._steps))}}/{self._steps}", self.words(), values(live))
            note("  ".join(filter(None, words)))

    def say(self, text: str) -> None:
        note(text)


class _Bar(_Rest):
    """Progress on a terminal."""

    def __init__(self, console: Console, pause: Pause | None) -> None:
        from rich.live import Live as Screen

        super().__init__()
        self._pause, self._console, self._text = pause, console, ""
        self.keys = PauseKeys(pause) if pause is not None and platform.has_keys() else contextlib.nullcontext()
        self._bar = progress_bar("measuring", console, own_rest=True)
        self._task = self._bar.add_task("", total=None, left="")
        self.screen = Screen(get_renderable=self._render, console=console, refresh_per_second=8)

    def _render(self) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        lines = [Text(self._text, style="dim", no_wrap=True, overflow="ellipsis")]
        if self._pause is not None and self._pause.attended:
            said = "pausing: c goes on, q ends the run" if self._pause.requested else "p pauses, q ends the run"
            lines.append(Text(said, style="bold" if self._pause.requested else "dim", no_wrap=True))
        return Group(self._bar, *lines)

    def start(self, steps: int = 0, done: int = 0) -> None:
        super().start()
        self._bar.reset(self._task, total=steps, completed=done, left=self.words())

    def more(self, steps: int) -> None:
        super().more(steps)
        self._bar.update(self._task, total=(self._bar.tasks[0].total or 0.0) + steps)

    def step(self, live: Live) -> None:
        super().step(live)
        self._text = values(live)
        self._bar.update(self._task, advance=1, left=self.words(every_s=0.5))

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        self.screen.stop()
        self.keys.__exit__(None, None, None)
        try:
            with super().paused():
                yield
        finally:
            self.keys.__enter__()
            self.screen.start()

    def say(self, text: str) -> None:
        self._console.print(visible(text), highlight=False, markup=False)


@contextlib.contextmanager
def _on_terminal(pause: Pause | None) -> Iterator[Progress]:
    bar = _Bar(terminal(stderr=True), pause)
    with bar.screen, bar.keys:
        yield bar


PAUSE, GO_ON, END = "p ", "c", "q"
LOOK_S = 0.05
"""How long leaving waits at most for the thread that listens."""


class PauseKeys:
    """p or space asks for a pause, c lets the run go on, q ends it as Ctrl-C does.

    Enter it more than once, if need be: on leaving, the terminal is as it was.
    """

    def __init__(self, pause: Pause) -> None:
        self._pause = pause
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        if self._thread is None and platform.has_keys():
            self._keys, self._ended = platform.Keys(), threading.Event()
            self._keys.__enter__()
            self._pause.attended = True
            self._thread = threading.Thread(target=self._listen, name="gonio-keys", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *how: Any) -> None:
        if self._thread is None:
            return
        thread, self._thread = self._thread, None
        self._pause.attended = False
        self._ended.set()
        thread.join()
        self._keys.__exit__(*how)

    def _listen(self) -> None:
        while not self._ended.is_set():
            try:
                pressed = self._keys.read(LOOK_S)
            except EOFError:
                return
            for key in pressed.lower().decode(errors="replace"):
                if key in PAUSE:
                    self._pause.ask("a key")
                elif key == GO_ON:
                    self._pause.go_on()
                elif key == END:
                    platform.interrupt()
