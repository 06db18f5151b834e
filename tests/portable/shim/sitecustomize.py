"""Takes from this Python what one on Windows does not have, and lets files behave as they do there.

It is imported at the start of each Python whose PYTHONPATH begins with its folder. The project's own modules see `os`,
`signal`, `select` and `subprocess` without the names of POSIX, and cannot import its modules. For everybody files that
are open cannot be replaced or removed, folders cannot be opened, text has the encoding and the line ends of Windows
where none are stated, names are refused that Windows refuses, no process is forked, and clocks step by 16 ms.

`GONIO_SHIM_CONSOLE=no` takes the module `msvcrt` away too.
"""

import builtins
import errno
import functools
import io
import os
import signal
import subprocess
import sys
import time
import types

GONE = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp", "posix", "syslog", "crypt", "readline", "curses"}
OWN = ("gonio",)
CLOCK_S = 0.015625
BINARY, NOINHERIT = 1 << 40, 1 << 41
LONGEST = 259
RESERVED = {"con", "prn", "aux", "nul", *(f"{kind}{k}" for kind in ("com", "lpt") for k in range(1, 10))}


def words(text: str) -> list[str]:
    return text.split()


FLAGS = {"O_RDONLY", "O_WRONLY", "O_RDWR", "O_APPEND", "O_CREAT", "O_EXCL", "O_TRUNC"}
PREFIXES = tuple(
    words(
        """posix_ sched_ fork setre setres getres spawn pread pwrite wait WIF WEXIT WTERM WNO WCO WST WUN getx
    setx listx removex P_ SCHED_ PRIO_ POSIX_"""
    )
)
PLAIN = words(
    """fchmod fchown fchdir chown lchown chroot getuid geteuid getgid getegid getgroups getpgid getpgrp
    getsid setsid setpgid setpgrp setuid setgid setpriority getpriority nice killpg openpty
    login_tty ttyname tcgetpgrp tcsetpgrp ctermid mkfifo mknod statvfs fstatvfs pathconf fpathconf
    confstr sysconf sync fdatasync sendfile readv writev pipe2 getloadavg uname memfd_create eventfd
    pidfd_open get_blocking set_blocking register_at_fork copy_file_range splice lockf initgroups"""
)
SIGNALS = {"SIGINT", "SIGTERM", "SIGABRT", "SIGFPE", "SIGILL", "SIGSEGV", "SIG_DFL", "SIG_IGN"}
WAITING = words(
    """pthread_kill pthread_sigmask sigwait sigwaitinfo sigtimedwait sigpending alarm setitimer getitimer
    siginterrupt pause pidfd_send_signal"""
)
LACKING = {
    os: {name for name in dir(os) if (name.startswith("O_") and name not in FLAGS) or name.startswith(PREFIXES)}
    | {*PLAIN},
    signal: {name for name in dir(signal) if name.startswith("SIG") and name not in SIGNALS} | {*WAITING},
}
KNOWN_SIGNALS = {2, 4, 6, 8, 11, 15, 21}
BREAK = 21


def path_of(path: object) -> str:
    return os.fsdecode(path) if isinstance(path, str | bytes | os.PathLike) else ""


def refuse(path: object) -> None:
    """Names that Windows takes for devices, streams or nothing at all, and paths that are too long for it."""
    text = path_of(path)
    if not text or text.startswith(("/proc/", "/dev/", "/sys/")):
        return
    for part in text.split("/"):
        if part.split(".")[0].strip().lower() in RESERVED or set(part) & set('<>:"|?*\\') or part != part.rstrip(" "):
            raise OSError(errno.EINVAL, "The filename, directory name, or volume label syntax is incorrect", text)
    if len(os.path.abspath(text)) > LONGEST:
        raise FileNotFoundError(errno.ENOENT, "The system cannot find the path specified", text)


def is_open(path: object) -> bool:
    """Whether any process has a file open."""
    try:
        there = os.stat(path_of(path))
    except OSError:
        return False
    for process in os.listdir("/proc"):
        if process.isdigit():
            try:
                for handle in os.scandir(f"/proc/{process}/fd"):
                    other = handle.stat()
                    if (other.st_dev, other.st_ino) == (there.st_dev, there.st_ino):
                        return True
            except OSError:
                continue
    return False


def sharing(function: object) -> object:
    """Replacing or removing a file: refused while it is open."""

    def wrapped(*paths: object, **more: object) -> object:
        for path in paths:
            refuse(path)
            inside = [os.path.join(at, name) for at, _, names in os.walk(path_of(path)) for name in names]
            if any(map(is_open, inside or [path])):
                raise PermissionError(errno.EACCES, "The process cannot access the file because it is being used by"
                                      " another process", path_of(path))  # fmt: skip
        return function(*paths, **more)

    return wrapped


for name in ("replace", "rename", "unlink", "remove"):
    setattr(os, name, sharing(getattr(os, name)))
make_folder, open_file, open_handle = os.mkdir, io.open, os.open
os.supports_dir_fd.clear()
os.supports_fd.clear()


def mkdir(path: object, *rest: object, **more: object) -> None:
    refuse(path)
    make_folder(path, *rest, **more)


def opened(file: object, mode: str = "r", buffering: int = -1, encoding: object = None, errors: object = None,
           newline: object = None, closefd: bool = True, opener: object = None) -> object:  # fmt: skip
    if not isinstance(file, int):
        refuse(file)
        if opener is None and os.path.isdir(path_of(file)):
            raise PermissionError(errno.EACCES, "Permission denied", path_of(file))
    if "b" not in mode:
        encoding = "cp1252" if encoding in (None, "locale") else encoding
        newline = "\r\n" if newline is None and mode[0] in "wax" else newline
    return open_file(file, mode, buffering, encoding, errors, newline, closefd, opener)


def own_open(path: object, flags: int, mode: int = 0o777, **more: object) -> int:
    """`os.open` as the project sees it."""
    refuse(path)
    if os.path.isdir(path_of(path)):
        raise PermissionError(errno.EACCES, "Permission denied", path_of(path))
    if not flags & BINARY and path != os.devnull:
        raise AssertionError(f"{path_of(path)} is opened without O_BINARY: its line ends would change")
    return open_handle(path, flags & ~(BINARY | NOINHERIT), mode, **more)


os.mkdir = mkdir
builtins.open = io.open = opened
monotonic, now = time.monotonic, time.time


def stepped(clock: object) -> float:
    return clock() // CLOCK_S * CLOCK_S


time.monotonic, time.time = functools.partial(stepped, monotonic), functools.partial(stepped, now)

# ---- processes ----

begin = subprocess.Popen.__init__


def begun(self: object, *words: object, **more: object) -> None:
    for key in ("preexec_fn", "pass_fds", "process_group", "user", "group"):
        if more.get(key):
            raise ValueError(f"{key} is not supported on Windows")
    if more.pop("creationflags", 0):
        more["start_new_session"] = True
    begin(self, *words, **more)


def no_fork(*_: object) -> None:
    raise OSError(errno.ENOSYS, "this system cannot fork")


subprocess.Popen.__init__ = begun
subprocess.CREATE_NEW_PROCESS_GROUP = 0x200
os.fork = no_fork

import multiprocessing.context  # noqa: E402

multiprocessing.context._default_context._default_context = multiprocessing.context._concrete_contexts["spawn"]
for name in ("fork", "forkserver"):
    multiprocessing.context._concrete_contexts.pop(name, None)


# ---- what the project's modules see ----


class Seen(types.ModuleType):
    """A module without some of its names."""

    def __init__(self, module: types.ModuleType, **own: object) -> None:
        super().__init__(module.__name__)
        self.__dict__["_module"], self.__dict__["_lacking"] = module, LACKING.get(module, set())
        self.__dict__.update(own)

    def __getattr__(self, name: str) -> object:
        if name in self._lacking:
            raise AttributeError(f"module {self._module.__name__!r} has no attribute {name!r} on Windows")
        return getattr(self._module, name)

    def __dir__(self) -> list[str]:
        return [name for name in dir(self._module) if name not in self._lacking]


def set_signal(number: int, handler: object) -> object:
    if int(number) not in KNOWN_SIGNALS:
        raise ValueError("invalid signal value")
    return signal.signal(number, handler)


def kill(process: int, number: int) -> None:
    """Whatever the signal, the process ends at once."""
    os.kill(process, signal.SIGKILL)


import select  # noqa: E402

LACKING[select] = {"poll", "epoll", "kqueue", "EPOLLIN", "POLLIN"}
CONSOLE = types.ModuleType("msvcrt")
CONSOLE.LK_NBLCK, CONSOLE.LK_UNLCK = 2, 0
CONSOLE.kbhit = lambda: False
CONSOLE.getwch = lambda: ""


def locking(handle: int, mode: int, count: int) -> None:
    import fcntl
    import struct

    kind = fcntl.F_UNLCK if mode == CONSOLE.LK_UNLCK else fcntl.F_WRLCK
    place = os.lseek(handle, 0, os.SEEK_CUR)
    try:  # of the handle, and not of the process: closing another handle of the file must not free it
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, struct.pack("hhqqi", kind, os.SEEK_SET, place, count, 0))
    except OSError:
        raise PermissionError(errno.EACCES, "Permission denied") from None


CONSOLE.locking = locking
VIEWS = {
    "os": Seen(os, open=own_open, name="nt", O_BINARY=BINARY, O_NOINHERIT=NOINHERIT, O_TEXT=0, kill=kill),
    "signal": Seen(signal, SIGBREAK=signal.Signals(BREAK), signal=set_signal),
    "select": Seen(select),
}
if os.environ.get("GONIO_SHIM_CONSOLE") != "no":
    sys.modules["msvcrt"] = CONSOLE
imported = builtins.__import__


def importing(
    name: str, globals: object = None, locals: object = None, fromlist: object = (), level: int = 0
) -> object:
    who = str((globals or {}).get("__name__", ""))
    file = str((globals or {}).get("__file__", ""))
    if who.startswith(OWN) or (who == "__main__" and "gonio" in file):
        if level == 0 and name.partition(".")[0] in GONE:
            raise ModuleNotFoundError(f"No module named {name!r} on Windows", name=name)
        if level == 0 and name in VIEWS:
            return VIEWS[name]
        if name == "os.path" and not fromlist:
            imported("os.path")
            return VIEWS["os"]
    return imported(name, globals, locals, fromlist, level)


builtins.__import__ = importing
