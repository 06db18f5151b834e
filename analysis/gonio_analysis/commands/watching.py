"""`gonio watch`: a run on a page and in the terminal, while it is measured or afterwards."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from pathlib import Path

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.live import address
from gonio.live.server import Content, Request, Server
from gonio.live.watching import Watched
from gonio_analysis.report import watching


class _Curves:
    """The newest values, as the page reads them: they are made when it asks."""

    def __init__(self) -> None:
        self._version = 0
        self._made: tuple[int, bytes] = (0, watching.encoded(watching.so_far("", [], [], {}, 0)))
        self._one = threading.Lock()
        self.watched: Watched | None = None

    def changed(self, watched: Watched) -> None:
        self._version += 1
        watched.log.tell("curves", {"version": self._version})

    def answer(self, request: Request) -> Content:
        with self._one:
            watched = self.watched
            if watched is not None and self._made[0] != self._version:
                version = self._version
                name = watched.path.absolute().name
                shown = watching.so_far(
                    name, watched.values, watched.story.angles_deg, watched.story.visits_s, watched.behind
                )
                self._made = version, watching.encoded(shown)
            return Content(self._made[1], "application/json")


def watch(run: Path, host: str, port: int | None, text: bool) -> None:
    """Serve the page until a signal ends it; the address is the first line that is printed."""
    if run.exists() and not run.is_dir():
        raise ConfigError(f"{run}: is not a folder; a run is a folder that `gonio measure` writes")
    kept, token = address.recall(run)
    curves = _Curves()
    watched = Watched(run, curves.changed)
    curves.watched = watched
    routes = {
        "/": lambda request: Content(watching.page(request.nonce), "text/html"),
        "/curves": curves.answer,
        "/frame": watched.picture,
    }
    try:
        server = Server(routes, watched.log, host, kept if port is None else port, token)
    except ConfigError:
        if port is not None:
            raise
        server = Server(routes, watched.log, host, 0, token)  # somebody else has the port of last time
    with contextlib.suppress(AttributeError, OSError):
        os.nice(10)
    with server:
        print(server.address, flush=True)
        try:
            address.remember(run, server.port, server.token)
        except OSError as error:
            console.note(f"the address cannot be kept ({error.strerror}): after a restart it will be another one")
        try:
            with watched:
                if text:
                    from gonio.live.terminal import show

                    show(watched)
                else:
                    threading.Event().wait()
        except KeyboardInterrupt:  # that is how it ends
            sys.stdout.flush()
