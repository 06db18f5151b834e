"""What is missing or damaged in a run, and what can be made again: `gonio run check`, `gonio run repair`, resuming.

Nothing that was measured is removed: a frame that does not count any more is moved to `set-aside/`, and a damaged
journal is kept beside the one that is made again.

Every run has an id of 128 random bits, in `run.toml`, in the journal and in every frame. Frames with another id are
named and left out; they stay until `--resume` moves them to `set-aside/`. Neither numbers nor random numbers depend on
the id. Runs of earlier versions have none: what stands for it is a hash of plan, seed, rig and sample, which other
runs of the plan share. The repair says so. Of a laboratory's run it leaves out steps that were taken at the same time,
and names points that go back in time.
"""

import contextlib
import hashlib
import os
import re
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gonio import platform
from gonio.disk import free_name, half_written, read_file, set_aside, write_whole
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.lab.acquisition.frame_writer import BESIDE, NAME, label_of, pixels_of
from gonio.lab.acquisition.journal import Steps, encode, locked
from gonio.lab.acquisition.records import FrameFile, FrameLabel, FrameRecord, StepRecord
from gonio.lab.acquisition.remade import at_once, in_time, numbered, readable, taken, untold, with_choices
from gonio.lab.acquisition.repeats import FramePixels, repeated
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_folder import begun
from gonio.lab.rig.dng import encode_dng, read_raw, read_record
from gonio.typing import NDArray

LOOKED_INTO = 2_500
"""Last frames of a resumed run that are read from end to end, at most."""
LOOKED_INTO_BYTES = 2 * 10**9
"""Bytes of these frames, at most: a second or two. Of the others the sizes are compared."""
ASIDE = "set-aside"

CHANGED = "is damaged: its pixels are not those that it was written with"

Progress = Callable[[int, int], None]
Integers = NDArray[np.int64]


@dataclass(slots=True)
class FramesFound:
    """What was found among the frames of a run."""

    damaged: dict[int, list[str]] = field(default_factory=dict)
    """By step: which of its frames is missing or damaged, and how."""
    orphans: list[str] = field(default_factory=list)
    """Names in `frames/` that the journal does not name."""
    frames: int = 0
    """How many the journal names."""
    unchecked: int = 0
    """Frames of which only the size was looked at."""


def find_damage(run: Run, *, whole: bool = False, progress: Progress | None = None) -> FramesFound:
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
    steps, out = run.steps(), FramesFound()
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


def _read(
    run: Run, steps: Steps, suspects: set[int], out: FramesFound, *, whole: bool, progress: Progress | None
) -> None:
    """Read frames from end to end, the last ones first, as many as may be, and those of the suspects."""
    room, count, done, pictures = LOOKED_INTO_BYTES, LOOKED_INTO, 0, FramePixels(run.description.camera)
    for at in range(len(steps) - 1, -1, -1):
        number = steps.numbers[at]
        if not (whole or number in suspects or (room > 0 and count > 0)):
            continue
        step = steps[at]
        for frame in step.frames:
            state, pixels, size = _state_of(run, step, frame, unpacked=whole)
            if state:
                out.damaged.setdefault(number, []).append(f"frames/{frame.file} {state}")
            elif pixels:
                pictures.add(pixels, number, frame.exposure_s)
            room, count, done = room - size, count - 1, done + 1
            if progress is not None:
                progress(done, out.frames)
    alike = pictures.suspects
    for number, texts in repeated(run, (steps[at] for at, n in enumerate(steps.numbers) if n in alike)).items():
        out.damaged.setdefault(number, []).extend(texts)
    out.unchecked = out.frames - done


def _state_of(run: Run, step: StepRecord, frame: FrameRecord, *, unpacked: bool = False) -> tuple[str, str, int]:
    """What is wrong with a frame that the journal names ("" where nothing is), the checksum of its pixels where the
    file tells it, and its size in bytes. `unpacked` compares its own checksum of its pixels too.
    """
    path = run.frame_path(frame.file)
    try:
        data = read_file(path)
    except FileNotFoundError:
        return "is missing", "", 0
    except OSError as error:
        return f"cannot be read: {error.strerror}", "", 0
    if frame.bytes is not None and len(data) != frame.bytes:
        return f"is damaged: it holds {len(data)} bytes, and was written with {frame.bytes}", "", len(data)
    if hashlib.sha256(data).hexdigest() != frame.sha256:
        return "is damaged: it was changed after it was written (its checksum differs)", "", len(data)
    label = label_of(path, data)
    if label is None:
        return "", "", len(data)
    pixels = (_sound_pixels(label, path, data) if unpacked else label.pixels) or ""
    if unpacked and not pixels:
        return CHANGED, "", len(data)
    return label.otherwise(run.key, step, frame), pixels, len(data)


def _sound_pixels(label: FrameLabel, path: Path, data: bytes) -> str:
    """The checksum of a frame's pixels; "" where they cannot be read, or are not those that its label tells."""
    try:
        pixels = pixels_of(path, data)
    except DataError:
        return ""
    return pixels if label.pixels in (None, pixels) else ""


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
    return np.array(names), np.array(sizes), np.array(counts)


def _listed(folder: Path) -> tuple[Integers, Integers]:
    """Hashes of the names in a folder, in order, and the sizes of the files."""
    names, sizes, foreign = array("q"), array("q"), []
    with os_error_as(ConfigError, f"{folder}: cannot be read"), platform.entries(folder) as entries:
        for entry in entries:
            link = entry.is_symlink() and NAME.fullmatch(entry.name) is not None
            if not entry.is_file() and not link:
                foreign.append(entry.name)
                continue
            names.append(hash(os.fsencode(entry.name)))
            sizes.append(-1 if link else entry.stat().st_size)  # of a link the file is looked at
    if foreign:
        raise ConfigError(
            f'{folder}: holds "{min(foreign)}", which is not a file (or a link that leads nowhere); move it out of '
            "this folder, which belongs to the run"
        )
    order = np.argsort(names)
    return np.array(names)[order], np.array(sizes)[order]


def _orphans(run: Run, hashes: set[int]) -> list[str]:
    frames = os.fsencode(run.path / "frames")
    names = sorted(os.fsdecode(entry.name) for entry in os.scandir(frames) if hash(entry.name) in hashes)
    beside = {name for name in names if name.endswith(BESIDE) and (run.frame_path(name[: -len(BESIDE)])).exists()}
    return [name for name in names if name not in beside]


def require_frames_only(run: Run, names: Iterable[str]) -> None:
    """Raise `ConfigError` where `frames/` holds, under one of these names, what this program did not write; or is a
    link.
    """
    frames = run.path / "frames"
    foreign = [name for name in names if not (NAME.fullmatch(name) or half_written(name, NAME))]
    if foreign:
        shown = ", ".join(f'"{name}"' for name in foreign[:5]) + (" ..." if len(foreign) > 5 else "")
        raise ConfigError(
            f"{frames}: holds {shown}, which this program did not write; move it out of this folder, which belongs to "
            "the run"
        )


def set_orphans_aside(run: Run, found: FramesFound) -> list[str]:
    """Move to `set-aside/` what no step that counts has: frames of a step that was cut short, frames that nobody can
    tell the step of, and all frames of damaged steps, which will be taken again. Their names.

    Nothing is removed: what was cut short, or belongs to a line that somebody took out of the journal, looks alike.

    Raises
    ------
    ConfigError
        A file there is none of this program's; nothing is touched then.
    """
    frames = run.path / "frames"
    require_frames_only(run, found.orphans)
    aside = set(found.orphans)
    for name in os.listdir(frames) if found.damaged else ():
        if NAME.fullmatch(name) and int(name.split("-")[0]) in found.damaged:
            aside.add(name)
    aside |= {name + BESIDE for name in aside if os.path.lexists(frames / (name + BESIDE))}
    if frames.is_symlink() and aside:
        raise ConfigError(f"{frames}: is a link, and {min(aside)} in it does not count any more; remove it")
    for name in sorted(aside):
        set_aside(frames / name, run.path / ASIDE)
    return sorted(aside)


@dataclass(frozen=True, slots=True)
class Repaired:
    """What a repair has come to."""

    kept: int
    """Events that could be read in the journal."""
    rebuilt: list[int]
    """Steps that were made again from what their frames say."""
    damaged: list[str]
    """Frames that are missing or damaged: their steps will be taken again."""
    undetermined: list[str]
    """Frames that say nothing of themselves, or not enough."""
    foreign: list[str]
    """Frames that say that they belong to another run."""
    journal: Path | None
    """Where the journal lies that was there before."""
    unproved: list[str]
    """Frames of an earlier version, which hold no checksum of their pixels, and none is left of them elsewhere."""
    untold: list[str]
    """What could not be checked, a sentence each."""
    changed: bool
    """Whether the journal was made again."""


def _judged(run: Run, frames: "_Frames", done: dict[int, StepRecord]) -> tuple[list[StepRecord], dict[int, list[str]]]:
    """Steps that the frames tell anew, and what is wrong with those that are lost."""
    rebuilt: list[StepRecord] = []
    lost: dict[int, list[str]] = {}
    for number in sorted({*done, *frames.told}):
        line, told = done.get(number), frames.told.get(number)
        wrong = frames.wrong(line) if line is not None else []
        if line is not None and wrong:  # what the journal says of its frames counts, not what lies there now
            lost[number] = wrong
        elif told is not None and told != line and not frames.wrong(told) and (line or frames.is_as_written(told)):
            rebuilt.append(told)
    sound = {step.step: step for step in (*(done[n] for n in done if n not in lost), *rebuilt)}
    alike = repeated(run, (sound[n] for n in sorted(frames.pictures.suspects & {*sound})))
    lost |= {number: texts for number, texts in alike.items() if number in done}
    apart = {*alike, *(at_once(sound.values()) if run.sample is None else ())}
    return [step for step in rebuilt if step.step not in apart], lost


def repair(path: str | Path, *, progress: Progress | None = None) -> Repaired | None:
    """Make a run's journal again, from the lines that can be read and from what the frames say of their steps.

    A step counts where all of its frames are whole and the last of them says what the journal has to say; any other is
    taken again when the run is resumed. Whether a frame is whole its checksum in the journal says, where a line is left
    that names it; else the checksum of its pixels that the frame itself holds. The journal that was there is kept under
    another name. Frames are only read.

    Parameters
    ----------
    path
        A folder with run.toml and frames/.
    progress
        Told how many frames have been looked at, and how many there are.

    Frames that name another run, or a step that was taken while another one was, make no step.

    Returns
    -------
    Repaired, or None where nothing is wrong with journal and frames.

    Raises
    ------
    ConfigError
        The folder holds no run, another process writes to it, or among its frames lies something that is none.
    DataError
        run.toml or plan.csv is damaged.
    """
    run = Run.open(path)
    journal = run.path / "journal.jsonl"
    _require_frames(run)
    with _held(journal) as before:
        events, torn = readable(before)
        kept = len(events)
        events, choices = with_choices(run, events)
        torn = torn or len(events) < kept
        frames = _Frames(run, progress)
        done = taken(events)
        rebuilt, lost = _judged(run, frames, done)
        what = [text for number in sorted(lost) for text in lost[number]]
        named = {frame.file for step in (*done.values(), *rebuilt) for frame in step.frames}
        undetermined = sorted(name for name in frames.names if name not in named and name not in frames.foreign)
        needed = bool(torn or not events or rebuilt or lost)
        if not (needed or frames.foreign):
            return None
        found = Repaired(
            kept=len(events), rebuilt=[step.step for step in rebuilt], damaged=what, undetermined=undetermined,
            foreign=sorted(frames.foreign), journal=_keep(journal) if before and needed else None,
            unproved=sorted(step.frames[-1].file for step in rebuilt if step.step in frames.unproved),
            untold=untold(run, rebuilt, done) if needed else [], changed=needed,
        )  # fmt: skip
        if needed:
            new = [*in_time(run, events, rebuilt), *choices]
            if lost:
                new.append({"event": "lost", "steps": sorted(lost), "frames": what})
            new.append({"event": "repaired", "kept": len(events), "rebuilt": found.rebuilt})
            if not any("files" in event for event in new):
                new[0] |= run.identity
            write_whole(journal, b"".join(encode(numbered(event, n)) for n, event in enumerate(new)))
    return found


def _require_frames(run: Run) -> None:
    """Raise `ConfigError` or `DataError` where there is nothing to make a journal from, or something strange."""
    if not os.path.lexists(run.path / "frames"):
        raise ConfigError(f"{run.path}: holds no frames: there is nothing to make a journal from")
    if os.path.lexists(run.path / "plan.csv"):
        _ = run.planned
    _listed(run.path / "frames")
    require_frames_only(run, os.listdir(run.path / "frames"))


@contextlib.contextmanager
def _held(journal: Path) -> Iterator[bytes]:
    """A journal's bytes, while nobody else writes it; it is not made where it is absent."""
    if not os.path.lexists(journal):
        yield b""
        return
    with locked(journal):
        with os_error_as(DataError, f"{journal}: cannot be read"):
            data = read_file(journal)
        yield data


def _keep(journal: Path) -> Path:
    """Give a journal a second name, which stays when the first is taken by another file."""
    free = free_name(journal.with_name("journal.damaged.jsonl"))
    os.link(journal, free)
    return free


class _Frames:
    """What the frames of a run say, and their checksums."""

    def __init__(self, run: Run, progress: Progress | None) -> None:
        self.told: dict[int, StepRecord] = {}
        """By step: its record, from the label of its last frame."""
        self.unproved: set[int] = set()
        """Steps whose last frame does not say what its pixels are."""
        self.foreign: set[str] = set()
        """Frames that name another run."""
        self.pictures = FramePixels(run.description.camera)
        self._digests: dict[str, str] = {}
        self._strange: dict[str, str] = {}
        """What is wrong with frames, whatever the journal says."""
        self._run = run
        files = sorted(os.listdir(run.path / "frames"))
        there = set(files)
        self.names = [name for name in files if not (name.endswith(BESIDE) and name[: -len(BESIDE)] in there)]
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
        if label is None:
            return
        if label.run != self._run.key:
            self._strange[name] = "says that it belongs to another run"
            self.foreign.add(name)
            return
        pixels = _sound_pixels(label, path, data)
        if not pixels:
            self._strange[name] = CHANGED
            return
        self.pictures.add(pixels, label.step, label.frame.exposure_s)
        step = label.record
        if step is None or step.step != label.step or not step.frames or step.frames[-1].file != name:
            return
        if label.pixels is None:
            self.unproved.add(step.step)
        last = step.frames[-1].stored(FrameFile(self._digests[name], len(data)))
        self.told[step.step] = replace(step, frames=(*step.frames[:-1], last))

    def is_as_written(self, step: StepRecord) -> bool:
        """Whether the last frame of a step, of which no checksum is left, is what this program makes of its content."""
        path = self._run.frame_path(step.frames[-1].file)
        data = read_file(path)
        record = read_record(data)
        return not record or encode_dng(read_raw(path, data), record) == data

    def wrong(self, step: StepRecord) -> list[str]:
        """What is wrong with the frames of a step, a line each."""
        out = []
        for frame in step.frames:
            digest = self._digests.get(frame.file)
            if frame.file in self._strange:
                out.append(f"frames/{frame.file} {self._strange[frame.file]}")
            elif digest is None or digest != frame.sha256:
                out.append(f"frames/{frame.file} {_state_of(self._run, step, frame)[0] or 'cannot be read'}")
        return out


def check(path: str | Path, *, progress: Progress | None = None) -> FramesFound:
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
