"""`gonio watch`: a run on a page and in the terminal, while it is measured or afterwards."""

import contextlib
import os
import sys
import time
from importlib.resources import files
from pathlib import Path
from typing import NoReturn

from gonio_analysis.report.html import program

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_folder import begun
from gonio.lab.live.server import Content, Route, Server
from gonio.look import part
from gonio_watch import shared, watching
from gonio_watch.watching import Watched

WORK = "from gonio_watch.plots import work; work()"
COMMAND = (sys.executable, "-P", "-c", WORK)
"""Begins the process that works out values: what draws takes seconds to be imported, and nobody may look."""

HEARD_S = 0.5
"""Longest time until a signal is heard."""


class ServedRun:
    """A run that is followed, and the routes of its page."""

    def __init__(self, run: Path) -> None:
        self.watched = Watched(run, COMMAND)
        self.routes: dict[str, Route] = {
            "/": lambda request: Content(page(request.nonce), "text/html"),
            "/curves": self.watched.curves,
            "/frame": self.watched.picture,
        }


def page(nonce: str) -> bytes:
    """The page as HTML: the look and the programs of every page, and its own; all of them carry a nonce."""
    folder = files("gonio_watch")
    own = {"style": "watch.css", "program": "watch.js"}
    parts = {word: folder.joinpath(name).read_text(encoding="utf-8") for word, name in own.items()}
    parts |= {"look": part("style.css"), "live": part("live.css"), "every": part("page.js"), "viewer": program()}
    text = folder.joinpath("watch.html").read_text(encoding="utf-8")
    for word, filled in (parts | {"nonce": nonce}).items():
        text = text.replace("{{" + word + "}}", filled)
    return text.encode()


def watch(run: Path, host: str, port: int | None, text: bool) -> None:
    """Serve the page until a signal ends it, or with `text` the run; the address is the first line that is printed."""
    if run.exists() and not run.is_dir():
        raise ConfigError(f"{run}: is not a folder; a run is a folder that `gonio measure` writes")
    if begun(run):
        Run.open(run)  # what was changed after it was written is refused
    kept, token = shared.recall(run)
    shown = ServedRun(run)
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
    """Until a signal ends it, or with `text` the run."""
    print(server.address, flush=True)
    try:
        shared.remember(run, server.port, server.token)
    except OSError as error:
        console.note(f"the address cannot be kept ({error.strerror}): after a restart it will be another one")
    if text:
        watching.show(watched)
    else:
        while True:  # a signal that the system hands to another thread is heard when this one wakes
            time.sleep(HEARD_S)


def _end() -> NoReturn:
    """End at a signal, at once: other threads may be importing a library, or serving a slow client."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    os._exit(0)
