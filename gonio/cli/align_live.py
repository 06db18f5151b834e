"""`gonio rig align --live`: a live picture on a page, and a prompt that jogs, lights the lamp and sets zeros."""

import contextlib
import shutil
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from gonio import platform
from gonio.by_hand.assistant import Assistant
from gonio.cli import console
from gonio.cli.jog_keys import End, Jog, JogKeys, Line
from gonio.cli.opened import holding, manual_rig_of, require_new, told_where
from gonio.live.alignment import AlignmentPage
from gonio.live.server import Server

REFRESH_S = 0.25
CLEAR = "\r\x1b[K"
END_S = 0.7
"""The page is served so much longer than the session lasts: pictures that a browser has asked for are on their way."""


def live(
    rig: str, out: Path, sample: Path | None, *,
    seed: int, host: str, port: int, keep_s: float, wavelength: float | None,
) -> None:  # fmt: skip
    """The session, until `quit`, the end of the input, or a signal. The lamp is dark afterwards, and the arms hold."""
    file = Path(rig) if Path(rig).is_file() else None
    require_new(out)
    manual = manual_rig_of(rig, "arms", "light", "camera", sample=sample, seed=seed)
    if wavelength is not None:
        manual.choose_band(wavelength)
    page, terminal = AlignmentPage(), Terminal(list(manual.description.axes()))
    assistant = Assistant(manual, tell=page.tell, say=terminal.say, rig_file=file, out=out, keep_s=keep_s)
    with Server(page.routes, page.events, host, port) as server:
        print(server.address, flush=True)
        try:
            with told_where(manual), manual, terminal.listening(assistant):
                if manual.can_hold:
                    manual.hold()
                terminal.say("lamp on lights the lamp; help lists what else there is")
                assistant.run()
        finally:
            page.end(dark=bool(getattr(manual.light, "known_dark", not assistant.timer.left_s)))
            if page.seen:
                time.sleep(END_S)
    console.note(holding(manual))


class Terminal:
    """The person's terminal: a status line with what is being typed; or, where there is none, lines of a pipe."""

    def __init__(self, axes: list[str]) -> None:
        self._keys, self._terminal = JogKeys(axes), platform.Keys()
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._assistant: Assistant | None = None
        self._drawn = False

    def say(self, text: str) -> None:
        """A line on stderr, above the status line."""
        with self._lock:
            print((CLEAR if self._drawn else "") + text, file=sys.stderr, flush=True)
            self._drawn = False

    @contextlib.contextmanager
    def listening(self, assistant: Assistant) -> Iterator[None]:
        """Read in a thread of its own; the terminal is as it was afterwards."""
        self._assistant = assistant
        keys = sys.stdin.isatty() and sys.stderr.isatty()
        with self._terminal if keys else contextlib.nullcontext():
            reader = threading.Thread(
                target=self._read_keys if keys else self._read_lines, name="terminal", daemon=True
            )
            reader.start()
            try:
                yield
            finally:
                self._ended.set()
                if keys:
                    reader.join(2.0 * REFRESH_S)
                with self._lock:
                    print(CLEAR if self._drawn else "", end="", file=sys.stderr, flush=True)
                    self._drawn = False

    def _read_lines(self) -> None:
        assert self._assistant is not None
        for line in sys.stdin:
            if self._ended.is_set():
                return
            self._assistant.alive()
            self._assistant.orders.put(line)
        self._assistant.orders.put("quit")

    def _read_keys(self) -> None:
        assistant = self._assistant
        assert assistant is not None
        while not self._ended.is_set():
            try:
                data = self._terminal.read(REFRESH_S)
            except EOFError:
                assistant.orders.put("quit")
                return
            if data:
                assistant.alive()
                for what in self._keys.feed(data):
                    self._act(what, assistant)
            self._draw(assistant.status)

    def _act(self, what: Line | Jog | End, assistant: Assistant) -> None:
        if isinstance(what, Jog):
            assistant.nudge(what.axis, what.degrees)
        elif isinstance(what, End):
            assistant.orders.put("quit")
        elif what.text.strip():
            self.say(f"> {what.text}")
            assistant.orders.put(what.text)

    def _draw(self, status: str) -> None:
        keys = self._keys
        prompt = f"[{keys.axis} {keys.step_deg:g} deg] > {keys.typed}"
        room = shutil.get_terminal_size().columns - 1
        text = f"{status}  {prompt}"
        if len(text) > room:
            text = f"{status[: max(room - len(prompt) - 2, 0)]}  {prompt}"[-room:]
        with self._lock:
            print(CLEAR + text, end="", file=sys.stderr, flush=True)
            self._drawn = True
