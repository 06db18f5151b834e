"""What is missing or damaged in a run, and what can be made again: `gonio run check`, `gonio run repair`, resuming.

Nothing that was measured is removed: a frame that does not count any more is moved to `set-aside/`, and a damaged
journal is kept beside the one that is made again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gonio.acquisition.frame_writer import BESIDE, NAME, label_of
from gonio.acquisition.journal import Event, decode, encode, locked, now
from gonio.acquisition.records import FrameFile, FrameRecord, StepRecord
from gonio.acquisition.run import CHOSEN, Run
from gonio.acquisition.run_folder import begun
from gonio.acquisition.steps import Steps
from gonio.disk import half_written, is_own, only_file, read_file, read_manifest, set_aside, write_whole
from gonio.errors import ConfigError, DataError

LOOKED_INTO = 2_500
"""When a run is resumed, at most so many of its last frames are read from end to end."""
LOOKED_INTO_BYTES = 2 * 10**9
"""Those frames have at most so many bytes: a second or two. Of the others the sizes are compared."""
ASIDE = "set-aside"

Progress = Callable[[int, int], None]
Integers = npt.NDArray[np.int64]


@dataclass(slots=True)
class Found:
    """What was found among the frames of a run."""

    damaged: dict[int, list[str]] = field(default_factory=dict)
    """By step: which of its frames is missing or damaged, and how."""
    orphans: list[str] = field(default_factory=list)
    """Names in `frames/` that the journal does not name."""
    frames: int = 0
    """How many the journal names."""
    unchecked: int = 0
    """Of how many only the size was looked at."""


def find_damage(run: Run, *, whole: bool = False, progress: Progress | None = None) -> Found:
    """Look for frames that the journal names and that are missing or damaged, and for files that it does not name.

    Parameters
    ----------
    run
        A run.
    whole
        Whether every frame is read from end to end. Otherwise all are looked for and their sizes compared, and the
        last 2500 (or 2 GB) are read.
    progress
        Told how many frames have been read, and how many there are to read.

    Raises
    ------
    ConfigError
        `frames/` holds something that is no file, or leads nowhere.
    DataError
        The journal is damaged.
    """
    steps, out = run.steps(), Found()
    there, sizes = _listed(run.path / "frames")
    named, expected, counts = _named(steps)
    out.frames = len(named)
    at = np.minimum(np.searchsorted(there, named), max(len(there) - 1, 0))
    found = there[at] == named if len(there) else np.zeros(len(named), dtype=bool)
    wrong, orphaned = ~found, np.ones(len(there), dtype=bool)
    if len(there):
        wrong |= (expected >= 0) & (sizes[at] != expected)
    orphaned[at[found]] = False
    suspects = set(np.repeat(np.array(steps.numbers, dtype=np.int64), counts)[wrong].tolist())
    if orphaned.any():
        out.orphans = _orphans(run, set(there[orphaned].tolist()))
    _read(run, steps, suspects, out, whole=whole, progress=progress)
    return out


def _read(run: Run, steps: Steps, suspects: set[int], out: Found, *, whole: bool, progress: Progress | None) -> None:
    """Read frames from end to end, the last ones first, as many as may be, and those of the suspects."""
    room, count, done = LOOKED_INTO_BYTES, LOOKED_INTO, 0
    for at in range(len(steps) - 1, -1, -1):
        number = steps.numbers[at]
        if not whole and not suspects and (room <= 0 or count <= 0):
            break
        suspect = number in suspects
        suspects.discard(number)
        if not (whole or suspect or (room > 0 and count > 0)):
            continue
        for frame in steps[at].frames:
            path = run.frame_path(frame.file)
            state = state_of(path, frame)
            if state:
                out.damaged.setdefault(number, []).append(f"frames/{frame.file} {state}")
            else:
                room -= path.stat().st_size
            count, done = count - 1, done + 1
            if progress is not None:
                progress(done, out.frames)
    out.unchecked = out.frames - done


def state_of(path: Path, frame: FrameRecord) -> str:
    """What is wrong with the file of a frame that the journal names; "" where nothing is."""
    try:
        with open(path, "rb", opener=only_file) as file:
            size = os.fstat(file.fileno()).st_size
            if frame.bytes is not None and size != frame.bytes:
                return f"is damaged: it holds {size} bytes, and was written with {frame.bytes}"
            if hashlib.file_digest(file, "sha256").hexdigest() != frame.sha256:
                return "is damaged: it was changed after it was written (its checksum differs)"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return ""


_FRAME = re.compile(rb'"file":"([^"]*)"(?:[^}]*"bytes":(\d+))?')
"""Name and size of a frame in a line of the journal; parsing all of the line takes four times as long."""


def _named(steps: Steps) -> tuple[Integers, Integers, Integers]:
    """Hash of the name and size (-1 where unknown) of every frame that the journal names, and frames of each step."""
    names, sizes, counts = array("q"), array("q"), array("q")
    for line in steps.raw():
        frames = _FRAME.findall(line)
        names.extend([hash(name) for name, _ in frames])
        sizes.extend([int(size) if size else -1 for _, size in frames])
        counts.append(len(frames))
    return (np.array(names, dtype=np.int64), np.array(sizes, dtype=np.int64), np.array(counts, dtype=np.int64))


def _listed(folder: Path) -> tuple[Integers, Integers]:
    """Hashes of the names in a folder, in order, and the sizes of the files."""
    names, sizes, foreign = array("q"), array("q"), []
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            with os.scandir(handle) as entries:  # by its handle: files are found without their folders' names
                for entry in entries:
                    if not entry.is_file():
                        foreign.append(entry.name)
                        continue
                    names.append(hash(os.fsencode(entry.name)))
                    sizes.append(entry.stat().st_size)
        finally:
            os.close(handle)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be read: {error.strerror}") from None
    if foreign:
        raise ConfigError(
            f'{folder}: holds "{min(foreign)}", which is not a file (or a link that leads nowhere); move it out of '
            "this folder, which belongs to the run"
        )
    order = np.argsort(np.array(names, dtype=np.int64))
    return np.array(names, dtype=np.int64)[order], np.array(sizes, dtype=np.int64)[order]


def _orphans(run: Run, hashes: set[int]) -> list[str]:
    frames = os.fsencode(run.path / "frames")
    names = sorted(os.fsdecode(entry.name) for entry in os.scandir(frames) if hash(entry.name) in hashes)
    beside = {name for name in names if name.endswith(BESIDE) and (run.frame_path(name[: -len(BESIDE)])).exists()}
    return [name for name in names if name not in beside]


def drop_orphans(run: Run, found: Found) -> None:
    """Remove what a step that was cut short left in `frames/`, and set aside what cannot be told, and lost steps.

    Only files that say themselves that they are frames of this run are removed: those of a step that is not done will
    be taken again.

    Raises
    ------
    ConfigError
        A file there is none of this program's; nothing is touched then.
    """
    frames, own, aside = run.path / "frames", [], []
    foreign = []
    for name in found.orphans:
        path = frames / name
        if path.is_symlink() or not (NAME.fullmatch(name) or half_written(name, NAME)):
            foreign.append(name)
        elif half_written(name, NAME) or _is_of(run, path):
            own.append(path)
        else:
            aside.append(path)
    if foreign:
        shown = ", ".join(f'"{name}"' for name in foreign[:5]) + (" ..." if len(foreign) > 5 else "")
        raise ConfigError(
            f"{frames}: holds {shown}, which this program did not write; move it out of this folder, which belongs to "
            "the run"
        )
    for steps in found.damaged:
        aside += [path for path in frames.glob(f"{steps:06d}-*") if NAME.fullmatch(path.name)]
    if frames.is_symlink() and (own or aside):
        raise ConfigError(f"{frames}: is a link, and {(own + aside)[0].name} in it does not count any more; remove it")
    for path in aside:
        if path.exists():
            set_aside(path, run.path / ASIDE)
    for path in own:
        path.with_name(path.name + BESIDE).unlink(missing_ok=True)
        path.unlink(missing_ok=True)


def _is_of(run: Run, path: Path) -> bool:
    """Whether a frame says of itself that it belongs to a run."""
    try:
        label = label_of(path, read_file(path))
    except OSError:
        return False
    return label is not None and label.run == run.key


@dataclass(frozen=True, slots=True)
class Repaired:
    """What a repair has come to."""

    kept: int
    """Events that could be read in the journal."""
    rebuilt: list[int]
    """Steps that were made again from what their frames say."""
    damaged: list[str]
    """Frames that are missing or damaged: their steps will be taken again."""
    untold: list[str]
    """Frames that say nothing of themselves, or not enough, or belong to another run."""
    journal: Path | None
    """Where the journal lies that was there before."""


def repair(path: str | Path, *, progress: Progress | None = None) -> Repaired | None:
    """Make a run's journal again, from the lines that can be read and from what the frames say of their steps.

    A step counts where all of its frames are whole and the last of them says what the journal has to say; any other is
    taken again when the run is resumed. The journal that was there is kept under another name. Frames are only read.

    Parameters
    ----------
    path
        A folder with run.toml and frames/.
    progress
        Told how many frames have been looked at, and how many there are.

    Returns
    -------
    Repaired, or None where nothing is wrong with journal and frames.

    Raises
    ------
    ConfigError
        The folder holds no run, or another process writes to it.
    DataError
        run.toml is damaged.
    """
    run = Run.open(path)
    journal = run.path / "journal.jsonl"
    if not os.path.lexists(run.path / "frames"):
        raise ConfigError(f"{run.path}: holds no frames: there is nothing to make a journal from")
    with _held(journal) as before:
        events, torn = _readable(before)
        frames = _Frames(run, progress)
        done: dict[int, StepRecord] = {}
        for event in events:
            if event.get("event") == "step":
                done[int(event["step"])] = StepRecord.from_json(event)
            elif event.get("event") == "lost":
                for number in event["steps"]:
                    done.pop(int(number), None)
        rebuilt, lost = [], {}
        for number in sorted({*done, *frames.told}):
            wrong = frames.wrong(done[number]) if number in done else []
            told = frames.told.get(number)
            if (number not in done or wrong) and told is not None and not frames.wrong(told):
                rebuilt.append(told)
            elif wrong:
                lost[number] = wrong
        numbers = {step.step for step in rebuilt}
        named = {frame.file for step in (*done.values(), *rebuilt) for frame in step.frames}
        untold = sorted(name for name in frames.names if name not in named)
        if not torn and events and not rebuilt and not lost:
            return None
        new = [*events, *_lost_choices(run, events), *(step.to_json() for step in rebuilt)]
        if lost:
            what = [text for number in sorted(lost) for text in lost[number]]
            new.append({"event": "lost", "steps": sorted(lost), "frames": what})
        new.append({"event": "repaired", "kept": len(events), "rebuilt": sorted(numbers)})
        kept = _keep(journal) if before else None
        write_whole(journal, b"".join(encode(_numbered(event, n)) for n, event in enumerate(new)))
    return Repaired(len(events), sorted(numbers), [t for n in sorted(lost) for t in lost[n]], untold, kept)


def _lost_choices(run: Run, events: list[Event]) -> list[Event]:
    """What was chosen and stands in no line that can be read."""
    own = read_manifest(run.path).get(CHOSEN)
    if own is None or not is_own(run.path / CHOSEN, own):
        return []
    known = {event["first_step"] for event in events if event.get("event") == "chosen"}
    return [event for event in json.loads(read_file(run.path / CHOSEN)) if event["first_step"] not in known]


@contextlib.contextmanager
def _held(journal: Path) -> Iterator[bytes]:
    """A journal's bytes, while nobody else writes it; it is not made where it is absent."""
    if not os.path.lexists(journal):
        yield b""
        return
    with locked(journal):
        try:
            data = read_file(journal)
        except OSError as error:
            raise DataError(f"{journal}: cannot be read: {error.strerror}") from None
        yield data


def _readable(data: bytes) -> tuple[list[Event], bool]:
    """The events whose lines are whole, in their order; and whether anything else is there."""
    lines = data.splitlines(keepends=True)
    events = [event for line in lines if (event := decode(line)) is not None]
    whole = len(events) == len(lines) and all(event.get("n") == n for n, event in enumerate(events))
    return events, not whole


def _numbered(event: Event, number: int) -> Event:
    """An event with its place in the journal; `wall` stays that of the event, where it is known."""
    content = {key: value for key, value in event.items() if key not in ("n", "wall", "crc")}
    return {"n": number, **content, "wall": event.get("wall", now())}


def _keep(journal: Path) -> Path:
    """Give a journal a second name, which stays when the first is taken by another file."""
    free, count = journal.with_name("journal.damaged.jsonl"), 1
    while os.path.lexists(free):
        count += 1
        free = journal.with_name(f"journal.damaged-{count}.jsonl")
    os.link(journal, free)
    return free


class _Frames:
    """What the frames of a run say, and their checksums."""

    def __init__(self, run: Run, progress: Progress | None) -> None:
        self.told: dict[int, StepRecord] = {}
        """By step: what the label of its last frame says of it."""
        self._digests: dict[str, str] = {}
        self._run = run
        files = sorted(entry.name for entry in os.scandir(run.path / "frames") if entry.is_file())
        self.names = [name for name in files if not (name.endswith(BESIDE) and name[: -len(BESIDE)] in set(files))]
        for done, name in enumerate(self.names, 1):
            self._look(name)
            if progress is not None:
                progress(done, len(self.names))

    def _look(self, name: str) -> None:
        path = self._run.frame_path(name)
        try:
            data = read_file(path)
        except OSError:
            return
        self._digests[name] = hashlib.sha256(data).hexdigest()
        label = label_of(path, data)
        if label is None or label.run != self._run.key or label.record is None:
            return
        step = label.record
        last = step.frames[-1].stored(FrameFile(self._digests[name], len(data)))
        self.told[step.step] = replace(step, frames=(*step.frames[:-1], last))

    def wrong(self, step: StepRecord) -> list[str]:
        """What is wrong with the frames of a step, a line each."""
        out = []
        for frame in step.frames:
            digest = self._digests.get(frame.file)
            if digest is None or digest != frame.sha256:
                what = state_of(self._run.frame_path(frame.file), frame) or "cannot be read"
                out.append(f"frames/{frame.file} {what}")
        return out


def check(path: str | Path, *, progress: Progress | None = None) -> Found:
    """Look at a whole run without changing anything: its journal, its plan, and every byte of its frames.

    Raises
    ------
    ConfigError, DataError
        The folder holds no run, or its journal or plan.csv is damaged.
    """
    run = Run.open(path)
    if not begun(run.path):
        raise DataError(f"{run.path}: has no readable journal; `gonio run repair {run.path}` makes it again")
    _ = run.plan
    return find_damage(run, whole=True, progress=progress)
