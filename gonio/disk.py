"""Files that are whole or not there, and files that are our own: what may be replaced, and what may not."""

import contextlib
import errno
import hashlib
import itertools
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from gonio import canvas, lost, platform
from gonio.errors import ConfigError, DataError, GonioError, os_error_as

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MANIFEST = "gonio.sha256"
"""The file of a folder that names what this program wrote there."""
NOT_OWN = f"was not written by this version of gonio (as its {MANIFEST} tells), or was changed since"
"""Why a file is not replaced: versions that wrote no manifest left what nothing tells from a person's own files."""
STDOUT = "-"
"""The path that stands for standard output."""
MEASURED = ("run.toml", "plan.csv", "journal.jsonl", "chosen.json")
"""Files of a run that nothing makes again, beside those of its folder `frames`."""
LONGEST_NAME, LONGEST_PATH = 255, 4000
"""Bytes that file systems take; the path leaves room for what is written below it."""


def only_file(path: str, flags: int) -> int:
    """An `opener` for `open`, which opens files alone: a pipe would be waited for, and a device may have no end.

    Raises
    ------
    OSError
        It cannot be opened, or is a folder, a pipe, a socket or a device.
    """
    none = OSError(errno.EINVAL, "it is a pipe, a socket or a device, not a file", path)
    try:
        handle = platform.opened(path, flags)
    except OSError as error:
        raise none if error.errno == errno.ENXIO else error from None  # a socket, or a pipe that nobody reads
    mode = os.fstat(handle).st_mode
    if stat.S_ISREG(mode):
        return handle
    os.close(handle)
    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path) if stat.S_ISDIR(mode) else none


def read_file(path: str | Path, most: int = -1) -> bytes:
    """The bytes of a file, `most` of them at most; raises `OSError` as `only_file` does."""
    with open(path, "rb", opener=only_file) as file:
        size = os.fstat(file.fileno()).st_size  # 0 of what is no file; for `most` bytes room would be made at once
        return file.read(min(most, size + 1) if most >= 0 and size else most)


def content(path: Path, where: str, hint: str = "", unreadable: type[GonioError] = ConfigError) -> bytes:
    """The bytes of a file that another file names; `where` begins messages, and `hint` says where files are looked for.

    Raises
    ------
    ConfigError
        There is no such file.
    GonioError
        It cannot be read: an error of the type `unreadable`.
    """
    try:
        return read_file(path)
    except FileNotFoundError:
        raise ConfigError(f"{where}: there is no such file{hint}") from None
    except OSError as error:
        raise unreadable(f"{where}: cannot be read: {error.strerror or error}") from None


def write_whole(path: Path, data: bytes | Iterable[bytes | memoryview]) -> None:
    """Write a file under a temporary name in its folder, sync it to the disk, and rename it.

    A large one is given in pieces. Standard output, a pipe or a device (`is_stream`) is written to directly.

    Raises
    ------
    OSError
        It cannot be written; what was there before is there still, and nothing lies beside it.
    """
    if is_stream(path):
        if str(path) == STDOUT:
            sys.stdout.buffer.writelines(_pieces(data))
            sys.stdout.flush()
            return
        with open(path, "wb", opener=platform.existing) as stream:
            stream.writelines(_pieces(data))
        return
    staged = Staged(path, data)
    staged.sync()
    staged.settle()


def _pieces(data: bytes | Iterable[bytes | memoryview]) -> Iterable[bytes | memoryview]:
    return (data,) if isinstance(data, bytes) else data


def require_not_measured(path: Path) -> None:
    """Raise `ConfigError` where a path is a file that a run was measured into: no result replaces it."""
    frame = path.parent.name == "frames"
    run = path.parent.parent if frame else path.parent
    if (frame or path.name in MEASURED) and (run / "journal.jsonl").is_file() and path.exists():
        raise ConfigError(f"{path}: is a file of the run {run}, and is not replaced; name another file")


def put(path: Path, data: bytes) -> None:
    """Write a result as `write_whole`; raises `DataError`, which names it, where it cannot be written."""
    require_not_measured(path)
    with os_error_as(DataError, f"{path}: cannot be written"):
        write_whole(path, data)


def put_picture(path: Path, draw: Callable[[], "Figure | None"]) -> list[Path]:
    """Write a figure, where there is one, as PNG; its path, as a list. One that cannot be drawn is lost (`gonio.lost`).

    Raises `DataError`, which names it, where it cannot be written.
    """

    def drawn() -> bytes:
        figure, stream = draw(), BytesIO()
        if figure is not None:
            canvas.save(figure, stream, format="png", dpi=110)
        return stream.getvalue()

    data = lost.kept(f"the picture {path.name}", drawn, lambda loss: b"")
    if not data:
        return []
    put(path, data)
    return [path]


def is_stream(path: str | Path) -> bool:
    """Whether a path is something to write to that no file can stand for: `-` (standard output), a pipe, a device.

    What the system lists as open files of a process (as /dev/stdout) is one too, whatever it leads to.
    """
    if str(path) == STDOUT:
        return True
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    opened = os.path.islink(path) and os.readlink(path).startswith(("/proc/", "/dev/fd/"))
    return opened or stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


_STAGED = itertools.count()


class Staged:
    """A file that is written under a temporary name in its folder; `sync` brings it to the disk, `settle` renames it.

    Raises
    ------
    OSError
        It cannot be written, or something that is no file has its name; nothing lies beside it then.
    """

    __slots__ = ("_handle", "_temporary", "path")

    def __init__(self, path: str | Path, data: bytes | Iterable[bytes | memoryview]) -> None:
        self.path = os.path.realpath(path) if os.path.islink(path) else path  # a link stays one
        if platform.is_reserved(path):
            raise OSError(errno.EINVAL, "the system keeps this name for a device; choose another", str(path))
        self._require_file()
        number = f"{os.getpid()}{next(_STAGED):09d}"  # a file may be staged twice, and the later one counts
        folder, name = os.path.split(path)
        self._temporary = os.path.join(folder, f".{name}.{number}.new")
        self._handle = -1
        with self._whole_or_gone():
            self._handle = platform.new_file(self._temporary)
            for piece in _pieces(data):
                left = memoryview(piece)
                while len(left):
                    left = left[os.write(self._handle, left) :]

    def begin(self) -> None:
        """Let the disk begin to write it, where the system takes such a hint.

        Of many files that have begun, the first to be synced waits for most of what the others need: a file system
        keeps what it knows of all of them in one journal.
        """
        if hasattr(os, "posix_fadvise"):
            with contextlib.suppress(OSError):
                os.posix_fadvise(self._handle, 0, 0, os.POSIX_FADV_DONTNEED)

    def sync(self) -> None:
        """Wait until it is on the disk; raises `OSError`, and nothing lies beside it then."""
        with self._whole_or_gone():
            platform.sync(self._handle)

    def settle(self) -> None:
        """Give it its name, once it is on the disk; raises `OSError`, and nothing lies beside it then."""
        with self._whole_or_gone():
            os.close(self._handle)
            self._handle = -1
            self._require_file()
            platform.replace(self._temporary, self.path)

    def _require_file(self) -> None:
        """Only a file is ever replaced: renamed over a device or a pipe, a file would stand in its place."""
        try:
            mode = os.lstat(self.path).st_mode
        except FileNotFoundError:
            return
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(self.path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is a pipe, a socket or a device, and is not replaced", str(self.path))

    def drop(self) -> None:
        """Remove it."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._temporary)

    @contextlib.contextmanager
    def _whole_or_gone(self) -> Iterator[None]:
        """Nothing lies beside the file after an error or a signal."""
        try:
            yield
        except OSError as error:
            self.drop()
            raise OSError(error.errno, error.strerror, str(self.path)) from None  # nobody knows the temporary name
        except BaseException:
            self.drop()
            raise


@contextlib.contextmanager
def work_folder(parent: Path, name: str) -> Iterator[Path]:
    """A hidden folder to work in, which goes at the end; those that processes left there when they died go, too.

    Raises
    ------
    OSError
        It cannot be made or removed.
    """
    for left in list(parent.iterdir()):
        found = re.fullmatch(rf"\.{re.escape(name)}\.(\d+)\.\w+\.work", left.name)
        if found and left.is_dir() and not left.is_symlink() and not platform.is_alive(int(found[1])):
            shutil.rmtree(left)
    with tempfile.TemporaryDirectory(prefix=f".{name}.{os.getpid()}.", suffix=".work", dir=parent) as made:
        yield Path(made)


def half_written(name: str, of: Collection[str] | re.Pattern[str]) -> bool:
    """Whether `name` is that of a file among `of` (names, or their pattern) that a process was writing when it died."""
    found = re.fullmatch(r"\.(.+)\.\d+\.new", name)
    return found is not None and bool(of.fullmatch(found[1]) if isinstance(of, re.Pattern) else found[1] in of)


def require_name(path: str | Path) -> None:
    """Raise `ConfigError` where a path is longer than file systems take, or the system keeps its name for a device."""
    if platform.is_reserved(path):
        raise ConfigError(f"{path}: the system keeps this name for a device; choose another")
    for part in Path(path).parts:
        if len(os.fsencode(part)) > LONGEST_NAME:
            raise ConfigError(
                f"{part[:40]}...: a name of {len(os.fsencode(part))} bytes is too long; "
                f"files and folders have names of at most {LONGEST_NAME}"
            )
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise ConfigError(f"{str(path)[:40]}...: a path of {len(os.fsencode(path))} bytes is too long")


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal; raises `OSError`."""
    with open(path, "rb", opener=only_file) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# Whose files these are. A folder that this program writes into holds a manifest: path and SHA-256 of each file that it
# wrote, as `sha256sum -c` reads it. Only a file whose content is still the one that the manifest names is replaced or
# removed. While files are replaced the manifest names the old content and the new, so that a process may die anywhere.

Manifest = dict[str, set[str]]
"""By path inside the folder: SHA-256 of what was written there."""


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a folder; empty where there is none, or one that cannot be read."""
    found = Manifest()
    if is_manifest(folder / MANIFEST):
        for line in _lines(folder / MANIFEST):
            digest, _, name = line.partition("  ")
            found.setdefault(name, set()).add(digest)
    return found


def is_manifest(path: Path) -> bool:
    """Whether a path is a file, and no link, with the lines of a manifest: all of them name files inside the folder."""
    try:
        return not path.is_symlink() and path.is_file() and all(map(_LINE.fullmatch, _lines(path)))
    except (OSError, UnicodeDecodeError):
        return False


_LINE = re.compile(r"[0-9a-f]{64}  (?!(.*/)?\.{0,2}(/|$))[^\\\0]+")
"""A checksum and a path that leads nowhere but into the folder: no part of it is empty, "." or ".."."""


def _lines(path: Path) -> list[str]:
    return read_file(path).decode().splitlines()


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a folder's manifest; raises `OSError`."""
    lines = [f"{digest}  {name}\n" for name in sorted(manifest) for digest in sorted(manifest[name])]
    write_whole(folder / MANIFEST, "".join(lines).encode())


def manifest_of(folder: Path) -> Manifest:
    """What a manifest of all files in a folder holds; raises `OSError`."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(folder).as_posix(): {sha256_of(path)} for path in files}


def is_own(path: Path, digests: Collection[str]) -> bool:
    """Whether a path is a file, and no link, with one of these contents."""
    try:
        return not path.is_symlink() and path.is_file() and bool(digests) and sha256_of(path) in digests
    except OSError:
        return False


def _judged(folder: Path, own: Manifest) -> Iterator[tuple[Path, Manifest | None, bool]]:
    """What lies in a folder, by name; what is ours inside, where it is a folder of ours; and whether it is our own."""
    own = own | read_manifest(folder)
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        path, start = Path(entry.path), entry.name + "/"
        if entry.is_dir(follow_symlinks=False):
            below = {name.removeprefix(start): found for name, found in own.items() if name.startswith(start)}
            ours = bool(below) or (path / MANIFEST).is_file()
            yield path, below if ours else None, ours
        else:
            yield path, None, is_manifest(path) if path.name == MANIFEST else is_own(path, own.get(path.name, ()))


def foreign_files(folder: Path, own: Manifest) -> list[str]:
    """What lies in a folder, and below it, that this program did not write, or that was changed since; no link is
    followed. A manifest inside the folder, or inside a folder of it, says what is ours there, beside `own`.

    Raises
    ------
    OSError
        A folder cannot be read.
    """
    out = []
    for path, below, ours in _judged(folder, own):
        if below is not None:
            out += [f"{path.name}/{name}" for name in foreign_files(path, below)]
        elif not ours:
            out.append(path.name + "/" * (path.is_dir() and not path.is_symlink()))
    return out


def remove_own(folder: Path, own: Manifest) -> None:
    """Remove what `foreign_files` does not name, and the folders that are empty then; raises `OSError`.

    The manifest goes last, so that what a process that dies leaves is still known.
    """
    for path, below, ours in _judged(folder, own):
        if below is not None:
            remove_own(path, below)
        elif ours and path.name != MANIFEST:
            path.unlink()
    if [entry.name for entry in os.scandir(folder)] in ([], [MANIFEST]):
        (folder / MANIFEST).unlink(missing_ok=True)
        folder.rmdir()


def require_own(folder: Path, names: Iterable[str], own: Manifest | None = None) -> None:
    """Raise `ConfigError` where files of these names are in a folder and are not what this program wrote there."""
    own = read_manifest(folder) if own is None else own
    foreign = [
        name for name in names if os.path.lexists(folder / name) and not is_own(folder / name, own.get(name, ()))
    ]
    if os.path.lexists(folder / MANIFEST) and not is_manifest(folder / MANIFEST):
        foreign.insert(0, MANIFEST)
    if foreign:
        raise ConfigError(
            f"{folder / foreign[0]}: {NOT_OWN}, and is not replaced; move it away, or remove it if nobody needs it"
        )


def write_own(folder: Path, files: Mapping[str, bytes | Path]) -> None:
    """Write files into a folder that exists, each whole; one that is there is replaced only where it is our own.

    What is given as a path is a file of the same disk, which is moved.

    Raises
    ------
    ConfigError
        A file of such a name is not our own; nothing is written then.
    OSError
        A file cannot be written.
    """
    own = read_manifest(folder)
    require_own(folder, files, own)
    new = {
        name: {sha256_of(data) if isinstance(data, Path) else hashlib.sha256(data).hexdigest()}
        for name, data in files.items()
    }
    write_manifest(folder, own | {name: own.get(name, set()) | new[name] for name in new})
    for name, data in files.items():
        if isinstance(data, Path):
            platform.replace(data, folder / name)
        else:
            write_whole(folder / name, data)
    write_manifest(folder, own | new)


def free_name(path: Path) -> Path:
    """The path, or where something lies there the same with the first number, from 2 on, that is free."""
    free, count = path, 1
    while os.path.lexists(free):
        count += 1
        free = path.with_name(f"{path.stem}-{count}{path.suffix}")
    return free


def set_aside(path: Path, folder: Path) -> Path:
    """Move a file into a folder, made where it is absent, under a name that is free there; where it lies then.

    Raises `OSError`.
    """
    folder.mkdir(exist_ok=True)
    free, count = folder / path.name, 1
    while os.path.lexists(free):
        count += 1
        free = folder / f"{path.stem}.{count}{path.suffix}"
    path.rename(free)
    return free


def check_writable(path: Path) -> None:
    """Raise `ConfigError` where a folder cannot be made, or files in it; touches nothing."""
    at = path.absolute()
    while not at.exists():
        at = at.parent
    if not at.is_dir():
        raise ConfigError(f"{path}: {at} is not a folder")
    if not os.access(at, os.W_OK | os.X_OK) or _refuses(at):
        raise ConfigError(f"{path}: {at} is not writable; choose another folder, or change its permissions")


def _refuses(folder: Path) -> bool:
    """Whether a folder takes no new entries although its permissions say so (a read-only disk, /proc)."""
    try:
        with tempfile.TemporaryDirectory(prefix=".gonio-", dir=folder):
            return False
    except OSError:
        return True
