"""`gonio watch`: a run on a page and in the terminal, while it is measured or afterwards."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from pathlib import Path
from typing import NoReturn

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.live import address, terminal
from gonio.live.server import Content, Request, Route, Server
from gonio.live.watching import Watched


class Shown:
    """A run that is followed, and the routes of its page."""

    def __init__(self, run: Path) -> None:
        self.watched = Watched(run, self._changed)
        self.routes: dict[str, Route] = {
            "/": self._page,
            "/curves": self._curves,
            "/frame": self.watched.picture,
        }
        self._version = 0
        self._made: tuple[int, bytes] | None = None
        self._one = threading.Lock()

    def _changed(self, watched: Watched) -> None:
        self._version += 1
        watched.log.tell("curves", {"version": self._version})

    def _page(self, request: Request) -> Content:
        from gonio_analysis.report.watching import page  # what draws takes seconds to be imported: nobody may look

        return Content(page(request.nonce), "text/html")

    def _curves(self, request: Request) -> Content:
        """The newest values, made when they are asked for."""
        from gonio_analysis.report.watching import encoded, so_far

        with self._one:
            if self._made is None or self._made[0] != self._version:
                version, watched = self._version, self.watched
                story, name = watched.story, watched.path.absolute().name
                shown = so_far(name, watched.values, story.angles_deg, story.visits_s, watched.behind)
                self._made = version, encoded(shown)
            return Content(self._made[1], "application/json")


def watch(run: Path, host: str, port: int | None, text: bool) -> None:
    """Serve the page until a signal ends it; the address is the first line that is printed."""
    if run.exists() and not run.is_dir():
        raise ConfigError(f"{run}: is not a folder; a run is a folder that `gonio measure` writes")
    kept, token = address.recall(run)
    shown = Shown(run)
    try:
        server = Server(shown.routes, shown.watched.log, host, kept if port is None else port, token)
    except ConfigError:
        if port is not None or not kept:
            raise
        server = Server(shown.routes, shown.watched.log, host, 0, token)  # somebody else has the port of last time
    with contextlib.suppress(AttributeError, OSError):
        os.nice(10)
    try:
        with shown.watched:
            try:
                with server:  # it is left first: pages are told, and nobody waits for a value that is being worked out
                    _show(run, server, shown.watched, text)
            except KeyboardInterrupt:
                _end()
    except KeyboardInterrupt:
        _end()


def _show(run: Path, server: Server, watched: Watched, text: bool) -> None:
    """Until a signal ends it."""
    print(server.address, flush=True)
    try:
        address.remember(run, server.port, server.token)
    except OSError as error:
        console.note(f"the address cannot be kept ({error.strerror}): after a restart it will be another one")
    if text:
        terminal.show(watched)
    else:
        threading.Event().wait()


def _end() -> NoReturn:
    """A signal is how it ends. A thread that imports a library, or serves a slow client, would be torn out of it."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    os._exit(0)
