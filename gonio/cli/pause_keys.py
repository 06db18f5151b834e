"""Keys that pause a measurement, heard while it runs; prompts of the rig have the terminal for themselves meanwhile."""

import threading
from typing import Any, Self

from gonio import platform
from gonio.acquisition.stop import Pause

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
