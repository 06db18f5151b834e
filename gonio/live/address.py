"""The address of a page outlives its server: port and token are kept where nobody else can read them.

A page that is open when its server dies asks for more at the same address, with the same token. So the next server of
the same run takes both again, if the port is free.
"""

import contextlib
import errno
import hashlib
import json
import os
import stat
import tempfile
from pathlib import Path

from gonio import platform


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
            there = os.lstat(one)
            if platform.is_own_but_open(there):
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
        there = os.lstat(file)
        if platform.is_private(there):
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
