"""What one process works out for all watchers of a run by one user: a folder of its own, and how it is begun.

A watcher that somebody looks at says so by the time of the file `looked`. Whoever gets the lock on the file `lock`
begins the process (`gonio_watch.worker`), and hands it the lock. It ends with the watcher that began it; then
another one begins it again.

The address of a watcher's page outlives its server: port and token are kept where nobody else can read them.

A page that is open when its server dies asks for more at the same address, with the same token. So the next server of
the same run takes both again, if the port is free.
"""

import contextlib
import errno
import hashlib
import json
import os
import stat
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from gonio import platform
from gonio.typing import JsonObject


def folder() -> Path:
    """Where programs keep what outlives them, by the XDG base directory specification."""
    home = os.environ.get("XDG_STATE_HOME", "")
    return (Path(home) if os.path.isabs(home) else Path.home() / ".local" / "state") / "gonio" / "pages"


def _closed(made: Path) -> None:
    """Make a folder of this program's, and those above it, for this user alone; one that is open to others is closed.

    `mkdir` gives its mode to the last folder only, and versions before this one left the others readable.
    """
    made.mkdir(mode=0o700, parents=True, exist_ok=True)
    for one in (made, *made.parents):
        with contextlib.suppress(OSError):
            if platform.is_own_but_open(os.lstat(one)):
                one.chmod(0o700)
        if one.name == "gonio":
            break


def _name(what: Path) -> str:
    return hashlib.sha256(os.fsencode(what.absolute())).hexdigest()[:24]


def _file(what: Path) -> Path:
    return folder() / f"{_name(what)}.json"


def private(what: Path) -> Path:
    """A folder that all watchers of a run by one user share, made where it is absent.

    Raises
    ------
    OSError
        It cannot be made, or others could write or read there.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    made = (Path(runtime) / "gonio" if os.path.isabs(runtime) else folder()) / _name(what)
    _closed(made.parent)
    made.mkdir(mode=0o700, exist_ok=True)
    there = os.lstat(made)
    if not stat.S_ISDIR(there.st_mode) or not platform.is_private(there):
        raise PermissionError(errno.EPERM, "is open to others", str(made))
    return made


def recall(what: Path) -> tuple[int, str | None]:
    """Port and token of the last page of a folder; 0 and None where nothing is known, or others could know it."""
    file = _file(what)
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        if platform.is_private(os.lstat(file)):
            kept = json.loads(file.read_text(encoding="utf-8"))
            port, token = int(kept["port"]), str(kept["token"])
            if 0 < port < 65536 and len(token) >= 32 and token.replace("-", "").replace("_", "").isalnum():
                return port, token
    return 0, None


def remember(what: Path, port: int, token: str) -> None:
    """Keep port and token for the next page of a folder; raises `OSError` where that cannot be written."""
    file = _file(what)
    _closed(file.parent)
    with tempfile.NamedTemporaryFile("w", dir=file.parent, encoding="utf-8", delete=False) as made:  # mode 0600
        json.dump({"port": port, "token": token}, made)
    platform.replace(made.name, file)


NOW, CURVES, FRAME, LOOKED, LOCK = "now.json", "curves.json", "frame.png", "looked", "lock"
LOOKED_S = 5.0
"""How long after the last watcher's sign of life the values of a run are still worked out."""
LOOK_S = 1.0
"""Time between two signs of life of a watcher."""
AGAIN_S = 10.0
"""Wait before a process that failed is begun again."""


@dataclass
class Now:
    """What has been worked out so far."""

    journal: str = ""
    """Identity of the journal (`gonio_watch.follow.Follower.identity`)."""
    version: int = 0
    """Version of the values; 0 before there are any."""
    behind: int = 0
    """Steps that were not reduced then."""
    frame: list[Any] | None = None
    """The name of the frame of which there is a picture, and the number of its step."""
    left: list[float] | None = None
    """How long the rest of the run takes, and the standard uncertainty of that [s]; None where nobody knows."""
    problem: str = ""
    bands: list[JsonObject] = field(default_factory=list)
    """By band: `name`; the newest `values` (the four angles [deg], BRDF and its standard uncertainty [1/sr]) of all
    `count`; and of the last `visit` to the reference, its level over that of the first and the uncertainty of that."""

    def encode(self) -> bytes:
        """As it lies in the file."""
        return json.dumps(asdict(self)).encode()


class Shared:
    """What is worked out for a run.

    Parameters
    ----------
    run
        The folder of the run.
    command
        What begins the process that works it out; the two folders are added. Where there is none, another one does.
    """

    def __init__(self, run: Path, command: Sequence[str] = ()) -> None:
        self._run, self._command = run, command
        self._own: tempfile.TemporaryDirectory[str] | None = None
        try:
            self.folder = private(run)
        except OSError:  # then it is worked out for this watcher alone
            self._own = tempfile.TemporaryDirectory(prefix="gonio-watch-")
            self.folder = Path(self._own.name)
        self.problem = ""
        self._child: subprocess.Popen[bytes] | None = None
        self._looked_s = self._next_s = -1e9
        self._seen: tuple[int, int] | None = None

    def look(self) -> Now | None:
        """Say that somebody looks; what has been worked out, where that is new."""
        now_s = time.monotonic()
        if now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            with contextlib.suppress(OSError):
                (self.folder / LOOKED).touch(mode=0o600)
            self._begin(now_s)
        try:
            there = os.stat(self.folder / NOW)
            seen = there.st_ino, there.st_mtime_ns
            if seen == self._seen:
                return None
            found = Now(**json.loads((self.folder / NOW).read_bytes()))
        except (OSError, ValueError, TypeError):
            return None  # there is none yet, or another version of this program has written it
        self._seen = seen
        return found

    def read(self, name: str) -> bytes | None:
        """A file of what has been worked out; None where there is none."""
        try:
            return (self.folder / name).read_bytes()
        except OSError:
            return None

    def _begin(self, now_s: float) -> None:
        """Begin the process where nobody has."""
        if not self._command or now_s < self._next_s:
            return
        if self._child is not None:
            ended = self._child.poll()
            if ended is None:
                return
            if ended:  # and not because another one works there
                self.problem = f"the values cannot be worked out: their process has ended ({ended})"
            assert self._child.stdin is not None
            self._child.stdin.close()
            self._child, self._next_s = None, now_s + AGAIN_S
            return
        with contextlib.suppress(OSError), open(self.folder / LOCK, "ab") as lock:
            os.chmod(self.folder / LOCK, 0o600)
            if not platform.lock(lock):
                return
        with contextlib.suppress(OSError):  # the process takes the lock itself
            self._child = subprocess.Popen(
                [*self._command, str(self._run.absolute()), str(self.folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                **platform.detached(),  # Ctrl-C ends it through its input, which ends with the watcher
            )

    def close(self) -> None:
        """End the process that was begun here."""
        if self._child is not None:
            assert self._child.stdin is not None
            self._child.stdin.close()
            try:
                self._child.wait(0.5)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()
            self._child = None
        if self._own is not None:
            self._own.cleanup()
