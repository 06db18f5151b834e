"""Whether a folder takes a run, and making and emptying one; what this program did not write stays untouched."""

import contextlib
import os
from collections.abc import Collection
from pathlib import Path

from gonio.disk import (
    MANIFEST,
    Manifest,
    check_writable,
    half_written,
    is_manifest,
    is_own,
    read_manifest,
    require_name,
)
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.lab.acquisition.frame_writer import NAME
from gonio.lab.acquisition.journal import files_named, has_lines, read_events

OURS = (
    "run.toml",
    "plan.csv",
    "chosen.json",
    "journal.jsonl",
    "frames",
    "reference.csv",
    "reference.meta.json",
    "camera_maps.npz",
    MANIFEST,
)


def begun(path: Path) -> bool:
    """Whether a folder's journal begins with a complete line (`DataError` where it cannot be read)."""
    require_name(path)
    return has_lines(path / "journal.jsonl")


def check_new(path: Path) -> None:
    """Raise `ConfigError` where a run cannot be started in a folder, `DataError` where its journal was lost; touches
    nothing.

    A run is started in an absent or empty folder, or in one that holds nothing but what a run that was never begun
    left there: no other file is removed or replaced.
    """
    require_name(path)
    if path.exists() and not path.is_dir():
        raise ConfigError(f"{path}: is not a folder")
    if path.is_dir():
        with os_error_as(ConfigError, f"{path}: cannot be read"):
            _check_holds_nothing(path)
    check_writable(path)


def _check_holds_nothing(path: Path) -> None:
    if begun(path):
        raise ConfigError(f"{path}: a run has begun here; go on with --resume, or measure into a new folder")
    if (path / "journal.jsonl").is_file():
        read_events(path / "journal.jsonl")  # damaged in its first line, or somebody else's
    own, foreign = read_manifest(path), []
    for entry in sorted(path.iterdir(), key=lambda entry: (entry.name != "frames", entry.name)):
        name = entry.name
        if name == "frames" and entry.is_dir() and not entry.is_symlink():
            inside = sorted(file.name for file in entry.iterdir() if not half_written(file.name, NAME))
            if any(NAME.fullmatch(file) for file in inside):
                raise DataError(
                    f"{path}: holds {len(inside)} frames, and no journal that says what they are; "
                    f"`gonio run repair {path}` makes it again from what the frames carry"
                )
            foreign += [f"frames/{file}" for file in inside]
        elif entry.is_symlink() or not entry.is_file() or not _left(entry, own):
            foreign.append(name)
    if foreign:
        shown = ", ".join(f'"{name}"' for name in foreign[:5]) + (" ..." if len(foreign) > 5 else "")
        raise ConfigError(
            f"{path}: is not empty (it holds {shown}), and what this program did not write it leaves alone; "
            "a run needs a folder of its own"
        )


def _left(file: Path, own: Manifest) -> bool:
    """Whether a file is one that a run which never began may leave; of a journal this was looked at before."""
    if file.name == MANIFEST:
        return is_manifest(file)
    return file.name == "journal.jsonl" or half_written(file.name, OURS) or is_own(file, own.get(file.name, ()))


def changed(path: Path, names: Collection[str]) -> str:
    """Which file of a run, of these names, is not as the manifest names it, or a line of the journal; "" for none."""
    there = {name for name in names if os.path.lexists(path / name)}
    own = read_manifest(path)
    wrong = {name for name in there & own.keys() if not is_own(path / name, own[name])}
    named: dict[str, bool] = {}
    for files in files_named(path / "journal.jsonl"):
        for name in there & files.keys():
            named[name] = named.get(name, False) or is_own(path / name, {files[name]})
        if all(named.values()):  # the first line's, unless the laboratory was stated anew
            break
    return min(wrong | {name for name, same in named.items() if not same}, default="")


def remove_begun(path: Path) -> None:
    """Remove what `Run.create` has written, and nothing else."""
    own = read_manifest(path)
    for name in (*own, "journal.jsonl"):
        with contextlib.suppress(OSError):
            if name == "journal.jsonl" or (name in OURS and is_own(path / name, own[name])):
                (path / name).unlink()
    for left in path.iterdir():
        if left.name == MANIFEST or half_written(left.name, OURS):
            left.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        (path / "frames").rmdir()


def make_folder(path: Path) -> list[Path]:
    """Make a folder and its parents; those that were made, outermost first."""
    missing = [folder for folder in (path.absolute(), *path.absolute().parents) if not folder.exists()][::-1]
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for folder in reversed(missing):
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise ConfigError(f"{path}: cannot be made: {error.strerror}") from None
    return missing
