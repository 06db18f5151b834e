"""What differs between operating systems, in one place: everything else asks here.

What a system can do is found by trying (an import, a name that is there), and never by the system's name.

========================  ==============================  =====================================================
promise                   with POSIX                      elsewhere
========================  ==============================  =====================================================
a file is whole or gone   rename over the old one         the same; retried while another program has it open
on the disk               fsync, F_FULLFSYNC              fsync; a folder's names are left to the file system
one writer                flock on the file               a lock on one byte far beyond its end, or a note
who holds a lock          the kernel's list, or trying    trying for a moment
ending signals            INT, TERM, HUP                  INT, TERM, BREAK (closing the window, logging off)
pausing                   TSTP and CONT, keys             keys alone
keys from a terminal      terminal without line editing   the console's own key reader
a child that survives     a session of its own            a process group of its own
for this user alone       mode bits of files and folders  the user's profile, which others cannot read
who has a port open       /proc                           nobody is named; the system opens it once only
========================  ==============================  =====================================================
"""

import contextlib
import errno
import hashlib
import os
import selectors
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple, Self

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]
try:
    import termios
    import tty
except ImportError:
    termios = tty = None  # type: ignore[assignment]
try:
    import msvcrt
except ImportError:
    msvcrt = None  # type: ignore[assignment]


def _flags(*names: str) -> int:
    """Flags of `os.open`: those that this system has."""
    out = 0
    for name in names:
        out |= getattr(os, name, 0)
    return out


# ---- files -------------------------------------------------------------------------------------------------------

OPEN_S = 2.0
"""How long replacing a file that another program has open is tried."""
FAR = 1 << 42
"""Place of the byte that is locked where whole files cannot be: beyond the end of every file of ours (4 TB)."""
LOCKS = Path("/proc/locks")
LOOK_S = 0.02


def opened(path: str, flags: int) -> int:
    """A handle of what may be no file, without waiting for the other end of a pipe; bytes as they are."""
    try:
        return os.open(path, flags | _flags("O_NONBLOCK", "O_NOCTTY", "O_BINARY", "O_CLOEXEC", "O_NOINHERIT"), 0o666)
    except PermissionError:
        if os.path.isdir(path):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path) from None
        raise


def existing(path: str, flags: int) -> int:
    """An `opener` for `open` that neither makes nor empties what it opens."""
    return os.open(path, flags & ~(os.O_CREAT | os.O_TRUNC) | _flags("O_BINARY"))


def new_file(path: str) -> int:
    """A handle of a file to be written from its beginning, which no child inherits."""
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | _flags("O_BINARY", "O_CLOEXEC", "O_NOINHERIT"), 0o666)


def nowhere() -> int:
    """A handle that takes all that is written, and has nothing to read."""
    return os.open(os.devnull, os.O_RDWR)


def sync(handle: int) -> None:
    """Wait until a file is on the disk, and not in the drive's memory; raises `OSError`."""
    if hasattr(fcntl, "F_FULLFSYNC"):  # macOS: fsync alone ends when the drive has it
        with contextlib.suppress(OSError):  # a file system without it
            fcntl.fcntl(handle, fcntl.F_FULLFSYNC)
            return
    os.fsync(handle)


def sync_folder(folder: Path) -> None:
    """Wait until the names of a folder's files are on the disk, where folders can be opened; raises `OSError`."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace(new: str | Path, path: str | Path) -> None:
    """Give a file the name of another, which goes; raises `OSError`, and both are as they were."""
    until = time.monotonic() + OPEN_S
    while True:
        try:
            os.replace(new, path)
            return
        except PermissionError as error:
            if not os.path.isfile(path) or not os.access(os.path.dirname(os.path.abspath(path)), os.W_OK):
                raise
            if time.monotonic() > until:
                why = "it is open in another program; close it there, and try again"
                raise PermissionError(error.errno, why, str(path)) from None
        time.sleep(LOOK_S)


@contextlib.contextmanager
def entries(folder: Path) -> Iterator[Iterator[os.DirEntry[str]]]:
    """`os.scandir` of a folder, by its handle where folders have one: the path is not looked up for every file."""
    if os.scandir not in os.supports_fd:
        with os.scandir(folder) as found:
            yield found
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with os.scandir(handle) as by_handle:
            yield by_handle
    finally:
        os.close(handle)


def lock(file: Any) -> bool:
    """Take a file for this process alone, until it is closed or the process ends; False where another one has it.

    Raises
    ------
    OSError
        The file system knows no locks.
    """
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
    if msvcrt is None:
        listed = _listed(file.name)
        if _is_elsewhere(listed):
            return False
        listed.write_text(str(os.getpid()), encoding="ascii")
        return True
    handle = file.fileno()
    place = os.lseek(handle, 0, os.SEEK_CUR)
    try:
        os.lseek(handle, FAR, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except PermissionError:
        return False
    finally:
        os.lseek(handle, place, os.SEEK_SET)
    return True


def _listed(path: str | Path) -> Path:
    """Where the process that has locked a file is noted, for a Python that can lock none."""
    whole = os.path.realpath(path).encode(errors="surrogateescape")
    return Path(tempfile.gettempdir(), f"gonio-{hashlib.sha256(whole).hexdigest()[:16]}.lock")


def _is_elsewhere(listed: Path) -> bool:
    """Whether another process that still lives is noted there."""
    try:
        holder = int(listed.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return False
    return holder != os.getpid() and is_alive(holder)


def is_locked(path: Path) -> bool | None:
    """Whether a process holds the lock of a file; None where the file system knows no locks.

    The kernel's list is looked at where there is one: to try the lock would keep another from taking it for a moment.
    """
    if fcntl is None and msvcrt is None:
        return _is_elsewhere(_listed(path))
    try:
        number = os.stat(path).st_ino
        held = LOCKS.read_text()
    except FileNotFoundError:
        try:
            with open(path, "rb") as file:
                return not lock(file)
        except OSError:
            return None
    except OSError:
        return None
    rows = (row.split() for row in held.splitlines())
    return any("FLOCK" in row and any(word.endswith(f":{number}") for word in row) for row in rows)


def is_reserved(path: str | Path) -> bool:
    """Whether the system takes a name for a device or a stream (`aux`, `con.txt`, `a:b`): what is written there
    is lost.

    Names that only other systems refuse are names here.
    """
    if hasattr(os.path, "isreserved"):
        return bool(os.path.isreserved(path))
    return isinstance(path := Path(path), PureWindowsPath) and path.is_reserved()


def free_bytes(folder: Path) -> int:
    """What this user may still write into a folder; raises `OSError`."""
    return shutil.disk_usage(folder).free


def is_private(there: os.stat_result) -> bool:
    """Whether a file or folder is this user's, and nobody else may use it; where modes say nothing, it is."""
    if not hasattr(os, "getuid"):
        return True
    return there.st_uid == os.getuid() and not there.st_mode & 0o077


def is_own_but_open(there: os.stat_result) -> bool:
    """Whether a folder is this user's, and others may use it too."""
    if not hasattr(os, "getuid") or not stat.S_ISDIR(there.st_mode):
        return False
    return there.st_uid == os.getuid() and not is_private(there)


def group_of(path: str) -> str:
    """The group that may use a device; "" where there are no groups."""
    try:
        import grp

        return grp.getgrgid(os.stat(path).st_gid).gr_name
    except (ImportError, KeyError, OSError):
        return ""


# ---- signals and processes ---------------------------------------------------------------------------------------


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """Those of some signals that this system has."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


ENDING = signals("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
"""Ctrl-C, a request to end, and a terminal or console that goes."""
HANG_UP = signals("SIGHUP")
PAUSE, GO_ON = signals("SIGTSTP"), signals("SIGCONT")
"""Ctrl-Z of a shell, and `fg`."""
KILLING = signals(
    "SIGTERM", "SIGHUP", "SIGBREAK", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGXCPU",
    "SIGABRT", "SIGIO", "SIGPWR",
)  # fmt: skip
"""All that end a process that does not listen; Ctrl-C is an exception in Python already."""


@contextlib.contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that are started meanwhile hear no signal of `ENDING`, where a process can be started so."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def detached() -> dict[str, Any]:
    """What `subprocess.Popen` takes for a child that no Ctrl-C reaches and that outlives this process."""
    if hasattr(os, "setsid"):
        return {"start_new_session": True}
    # without the console, which takes all of its processes with it when its window is closed
    names = "CREATE_NEW_PROCESS_GROUP", "DETACHED_PROCESS"
    return {"creationflags": sum(getattr(subprocess, name, 0) for name in names)}


def is_alive(process: int) -> bool:
    """Whether there is a process with this number."""
    import psutil

    return bool(psutil.pid_exists(process))


def command_lines() -> Iterator[list[str]]:
    """The words of the command of every process that may be looked at."""
    import psutil

    for process in psutil.process_iter(["cmdline"]):
        yield process.info["cmdline"] or []


def interrupt() -> None:
    """What Ctrl-C does, from any thread."""
    if hasattr(signal, "pthread_kill"):  # wakes the main thread where it sleeps
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)


def work_modestly() -> None:
    """Let others go first."""
    with contextlib.suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, 0, 19)


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


# ---- terminals and ports -----------------------------------------------------------------------------------------

TERMINAL_ERRORS: tuple[type[Exception], ...] = () if termios is None else (termios.error,)
"""What calls to a terminal raise beside `OSError`."""
KEY_S = 0.05
LOOKS, LOOK_AGAIN_S = 3, 0.1
"""How often, and when, to look again who holds a port: starting a program takes a busy computer 0.1 s."""
PSEUDO_TERMINALS = {"/dev/ptmx", "/dev/pts/ptmx"}


def has_keys() -> bool:
    """Whether there is a terminal to press keys on, and this process may read from it."""
    try:
        if not sys.stdin.isatty():
            return False
        if termios is None:
            return msvcrt is not None
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):
        return False


class Keys:
    """The terminal gives every key at once, and shows none, while it is entered; Ctrl-C stays what it is."""

    def __enter__(self) -> Self:
        self._handle = sys.stdin.fileno()
        self._before: list[Any] | None = None
        if termios is not None:
            self._before = termios.tcgetattr(self._handle)
            changed: list[Any] = termios.tcgetattr(self._handle)
            changed[3] &= ~(termios.ICANON | termios.ECHO)
            termios.tcsetattr(self._handle, termios.TCSADRAIN, changed)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            with contextlib.suppress(*TERMINAL_ERRORS):  # the terminal has gone
                termios.tcsetattr(self._handle, termios.TCSADRAIN, self._before)

    def read(self, seconds: float) -> bytes:
        """Keys that come within `seconds`; b"" for none. Raises `EOFError` where the terminal has gone."""
        if msvcrt is not None:
            until = time.monotonic() + seconds
            while not msvcrt.kbhit():  # type: ignore[attr-defined]
                if time.monotonic() > until:
                    return b""
                time.sleep(KEY_S)
            return msvcrt.getwch().encode()  # type: ignore[attr-defined,no-any-return]
        with selectors.DefaultSelector() as look:
            look.register(self._handle, selectors.EVENT_READ)
            if not look.select(seconds):
                return b""
        try:
            data = os.read(self._handle, 1024)
        except OSError:
            data = b""
        if not data:
            raise EOFError
        return data


def pseudo_terminal() -> tuple[int, int, str]:
    """Handles of both ends of a terminal without line editing, and the name of the second; raises `OSError`."""
    if tty is None or not hasattr(os, "openpty"):
        raise OSError(errno.ENOSYS, "this system has no pseudo-terminals; serve over TCP")
    master, slave = os.openpty()
    tty.setraw(slave)
    return master, slave, os.ttyname(slave)


def baud_of(terminal: int) -> int:
    """The line speed that a terminal is set to; 0 where it is none of the standard ones."""
    speed = termios.tcgetattr(terminal)[4]
    known = (name for name in dir(termios) if name.startswith("B") and name[1:].isdigit() and name != "B0")
    return next((int(name[1:]) for name in known if getattr(termios, name) == speed), 0)


class PortHolder(NamedTuple):
    """A process that has a file or a port open."""

    number: int
    name: str
    command: str


def holders_of(port: str) -> list[PortHolder]:
    """The other processes that have a port open, as far as they can be seen.

    A process that has the other end of a pseudo-terminal is the device, and no rival for it. Nor is a program that this
    one is starting: until it runs it has its parent's files, so that what is found is looked at again.
    """
    for _ in range(LOOKS):
        if not (out := _holders_of(port)):
            return []
        time.sleep(LOOK_AGAIN_S)
    return out


def _holders_of(port: str) -> list[PortHolder]:
    target, out = os.path.realpath(port), list[PortHolder]()
    if "://" in port:
        return out
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with contextlib.suppress(OSError):  # another user's process, or one that has just ended
            handles = {os.readlink(link) for link in (process / "fd").iterdir()}
            if target in handles and not handles & PSEUDO_TERMINALS:
                name, command = (process / "comm").read_text().strip(), (process / "cmdline").read_bytes()
                out.append(PortHolder(int(process.name), name, command.decode(errors="replace")))
    return out


def command_line() -> str:
    """The command line of this process, as it is stored with a run."""
    import shlex

    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
