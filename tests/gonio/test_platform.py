"""What differs between systems: each promise where a name is there, and where it has been taken away."""

import ast
import errno
import ntpath
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest

from gonio import disk, platform
from gonio.errors import ConfigError

ROOT = Path(__file__).parents[2]
PRODUCT = [file for top in ("gonio", "drivers", "sim", "analysis") for file in (ROOT / top).rglob("*.py")]
MODULES = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp", "msvcrt", "winreg"}
NAMES = re.compile(
    r"\b(os\.O_|os\.(fork|killpg|statvfs|getuid|openpty)\b|signal\.SIG(?!INT\b|TERM\b|_DFL\b|_IGN\b|nals\b)[A-Z])"
)


@pytest.mark.slow
def test_nothing_else_knows_what_a_system_has() -> None:
    wrong = []
    for file in PRODUCT:
        text = file.read_text(encoding="utf-8")
        nodes = list(ast.walk(ast.parse(text)))
        imported = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        imported |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
        if file.name != "platform.py" and (imported & MODULES or NAMES.search(text)):
            wrong.append(str(file))
    assert not wrong


class Console:
    """The module `msvcrt` as far as it is used: one lock a byte, and keys that are waiting."""

    LK_NBLCK = 2

    def __init__(self, keys: str = "") -> None:
        self.locked: dict[tuple[int, int], int] = {}
        self.keys = list(keys)

    def locking(self, handle: int, mode: int, count: int) -> None:
        place = (os.fstat(handle).st_ino, os.lseek(handle, 0, os.SEEK_CUR))
        if self.locked.get(place, handle) != handle:
            raise PermissionError(errno.EACCES, "locked")
        self.locked[place] = handle

    def kbhit(self) -> bool:
        return bool(self.keys)

    def getwch(self) -> str:
        return self.keys.pop(0)


def test_one_process_has_a_file_where_there_is_no_flock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "fcntl", None)
    monkeypatch.setattr(platform, "msvcrt", Console())
    file = tmp_path / "journal"
    file.write_bytes(b"lines")
    with file.open("r+b") as one, file.open("r+b") as other:
        one.seek(3)
        assert platform.lock(one)
        assert not platform.lock(other)
        assert one.read() == b"es"  # nothing was moved
    assert file.read_bytes() == b"lines"


def test_a_file_that_is_open_elsewhere_is_replaced_once_it_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    new, old = tmp_path / "new", tmp_path / "old"
    new.write_text("new")
    old.write_text("old")
    tries = []

    def shared(source: Path, target: Path) -> None:
        tries.append(1)
        if len(tries) < 3:
            raise PermissionError(errno.EACCES, "The process cannot access the file")
        Path(target).write_text(Path(source).read_text())

    monkeypatch.setattr(os, "replace", shared)
    platform.replace(new, old)
    assert (len(tries), old.read_text()) == (3, "new")
    tries.clear()
    monkeypatch.setattr(platform, "OPEN_S", -1.0)
    with pytest.raises(PermissionError, match="open in another program; close it there, and try again"):
        platform.replace(new, old)


def test_folders_that_cannot_be_opened_are_left_to_the_file_system(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    platform.sync_folder(tmp_path)
    monkeypatch.delattr(os, "O_DIRECTORY")
    monkeypatch.setattr(os, "open", lambda *_: pytest.fail("a folder was opened"))
    platform.sync_folder(tmp_path)


def test_keys_of_a_console(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "termios", None)
    monkeypatch.setattr(platform, "msvcrt", Console("pq"))
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(fileno=lambda: 0, isatty=lambda: True))
    assert platform.has_keys()
    with platform.Keys() as keys:
        assert [keys.read(0.0) for _ in range(3)] == [b"p", b"q", b""]


def test_signals_that_a_system_lacks_are_not_asked_for() -> None:
    assert platform.signals("SIGINT", "SIGNONE") == (signal.SIGINT,)


def test_a_child_has_a_group_of_its_own_where_there_are_no_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    assert platform.detached() == {"start_new_session": True}
    monkeypatch.delattr(os, "setsid")
    monkeypatch.setattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0x200, raising=False)
    monkeypatch.delattr(subprocess, "DETACHED_PROCESS", raising=False)
    assert platform.detached() == {"creationflags": 0x200}
    # a console that closes does not take the guard along
    monkeypatch.setattr(subprocess, "DETACHED_PROCESS", 0x8, raising=False)
    assert platform.detached() == {"creationflags": 0x208}


def test_a_process_that_has_ended_is_not_alive() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    assert platform.is_alive(os.getpid())
    assert not platform.is_alive(child.pid)


def test_where_there_are_no_pseudo_terminals_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "tty", None)
    with pytest.raises(OSError, match="no pseudo-terminals; serve over TCP"):
        platform.pseudo_terminal()


def test_one_process_has_a_file_where_nothing_can_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("fcntl", "msvcrt"):
        monkeypatch.setattr(platform, name, None)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    journal = tmp_path / "journal"
    journal.touch()
    assert platform.is_locked(journal) is False
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        platform._listed(journal).write_text(str(other.pid))
        with journal.open("rb") as file:
            assert not platform.lock(file)
        assert platform.is_locked(journal)
        other.kill()
    with journal.open("rb") as file:  # of a process that has died
        assert platform.lock(file)
    assert platform.is_locked(journal) is False  # its own is no other's


def test_a_name_that_is_a_device_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not platform.is_reserved(tmp_path / "aux")  # here it is a name
    monkeypatch.setattr(os.path, "isreserved", ntpath.isreserved if hasattr(ntpath, "isreserved") else reserved, False)
    for name in ("aux", "con.txt", "a:b"):
        assert platform.is_reserved(name)
        with pytest.raises(ConfigError, match="keeps this name for a device"):
            disk.require_name(name)
        with pytest.raises(OSError, match="keeps this name for a device"):
            disk.write_whole(tmp_path / name, b"")
    assert not platform.is_reserved("auxiliary.csv")


def reserved(path: str | Path) -> bool:
    """What Python 3.13 has for the names of Windows."""
    name = os.path.basename(path)
    return name.partition(".")[0].lower() in ("aux", "con") or ":" in name


def test_a_process_is_found_by_its_command() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()", "a-word-of-this-test"], stdin=subprocess.PIPE) as child:
        assert any(words[-1:] == ["a-word-of-this-test"] for words in platform.command_lines())
        child.kill()
