"""A run whose journal or frames were lost: nothing is removed, what can be told is told, the rest is taken again."""

import gc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from gonio import threads
from gonio.errors import ConfigError, DataError, DeviceError, GonioError
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.frame_writer import label_of
from gonio.lab.acquisition.progress import Silent
from gonio.lab.acquisition.records import FrameRecord, StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, count_rates
from gonio.lab.rig import Frame
from tests.command_line import some
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import NumpyRig, Plugin


class Told(Silent):
    def __init__(self) -> None:
        self.text = ""

    def say(self, text: str) -> None:
        self.text += text + "\n"


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def repaired(run: Run) -> repair.Repaired:
    """What a repair of a run that needs one has done."""
    return some(repair.repair(run.path))


def without_line(run: Run, line: int) -> None:
    """Take a line out of the journal; the first is the session's."""
    path = run.path / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:line], *lines[line + 1 :]]))


def test_every_frame_says_what_it_is(run: Run) -> None:
    for step in run.steps():
        for number, frame in enumerate(step.frames, 1):
            path = run.frame_path(frame.file)
            label = some(label_of(path, path.read_bytes()))
            assert (label.run, label.step, label.kind, label.point) == (run.key, step.step, step.kind, step.point)
            assert (label.number, label.count) == (number, len(step.frames))
            assert label.frame == replace(frame, sha256=None, bytes=None)
            if step.kind != "dark":
                assert (label.goal, label.pose) == (step.goal, step.pose)
            assert (label.record is not None) == (number == len(step.frames))
            assert path.stat().st_size == frame.bytes


@pytest.mark.parametrize("journal", [None, b"", b"\0" * 4096, b'{"n":0,"event":"ses', b'{"n":0,"eve\xff'])
def test_frames_without_a_journal_are_refused_and_stay(
    run: Run, measure: Measure, journal: bytes | None, whole: list[StepRecord]
) -> None:
    path = run.path / "journal.jsonl"
    path.unlink()
    if journal is not None:
        path.write_bytes(journal)
    before = tree(run.path)
    for resume in (True, False):
        with pytest.raises(DataError, match=r"gonio run repair"):
            measure(resume=resume)
        assert tree(run.path) == before
    done = repaired(run)
    assert (done.rebuilt, done.damaged) == (list(range(9)), [])
    assert list(Run.open(run.path).steps()) == whole
    assert sorted(p.name for p in run.path.glob("journal.damaged*")) == (["journal.damaged.jsonl"] if journal else [])
    told = Told()
    assert list(measure(resume=True, progress=told).steps()) == whole
    assert "every step is done" in told.text
    assert tree(run.path / "frames") == {k[7:]: v for k, v in before.items() if k.startswith("frames/")}


@pytest.mark.parametrize("line", [0, 1, 4, 9])
def test_a_journal_damaged_in_the_middle_keeps_what_is_readable(
    run: Run, measure: Measure, line: int, whole: list[StepRecord]
) -> None:
    path = run.path / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:line], lines[line].replace(b'"', b"'", 3), *lines[line + 1 :]]))
    damaged = path.read_bytes()
    for resume in (True, False):
        with pytest.raises((DataError, ConfigError), match=r"repair|--resume"):
            measure(resume=resume)
    with pytest.raises(DataError, match=f"line {line + 1} is damaged.*gonio run repair"):
        measure(resume=True)
    assert path.read_bytes() == damaged
    done = repaired(run)
    assert (done.kept, done.rebuilt) == (len(lines) - 1, [line - 1] if line else [])
    assert (run.path / "journal.damaged.jsonl").read_bytes() == damaged
    assert list(Run.open(run.path).steps()) == whole
    assert repair.repair(run.path) is None  # nothing is left to do


def test_a_step_that_is_not_provably_complete_is_taken_again(
    run: Run, measure: Measure, whole: list[StepRecord]
) -> None:
    files = [frame.file for frame in run.steps()[3].frames]
    (run.path / "journal.jsonl").unlink()
    run.frame_path(files[-1]).unlink()  # its label held the record of the step
    done = repaired(run)
    assert 3 not in done.rebuilt
    assert done.undetermined == files[:-1]
    assert list(measure(resume=True).steps()) == whole


def test_frames_of_an_older_version_are_kept_and_said_to_tell_nothing(run: Run, measure: Measure) -> None:
    for path in (run.path / "frames").iterdir():
        path.write_bytes(path.read_bytes().replace(b"gonio-frame-1", b"another-one-1"))
    (run.path / "journal.jsonl").unlink()
    names = sorted(path.name for path in (run.path / "frames").iterdir())
    done = repaired(run)
    assert (done.undetermined, done.rebuilt) == (names, [])
    assert sorted(path.name for path in (run.path / "frames").iterdir()) == names
    measure(resume=True)
    assert sorted(path.name for path in (run.path / "set-aside").iterdir()) == names


def test_a_camera_s_own_files_have_their_labels_beside_them(
    measure: Measure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "IMG_0001.CR2"
    own.write_bytes(b"the camera's own bytes")
    capture = NumpyRig.capture
    monkeypatch.setattr(NumpyRig, "capture", lambda self, exposure_s: replace(capture(self, exposure_s), file=own))
    run = measure()
    assert run.steps()[0].frames[0].file == "000000-dark-01.cr2"
    assert run.frame_path("000000-dark-01.cr2").read_bytes() == own.read_bytes()
    whole = list(run.steps())
    (run.path / "journal.jsonl").unlink()
    done = repaired(run)
    assert (done.rebuilt, done.undetermined) == (list(range(9)), [])
    assert list(measure(resume=True).steps()) == whole


def lose(path: Path, how: str) -> None:
    data = path.read_bytes()
    if how == "missing":
        path.unlink()
    elif how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "changed":
        path.write_bytes(data[:-100] + bytes([data[-100] ^ 1]) + data[-99:])
    else:
        path.write_bytes(b"")


@pytest.mark.parametrize(
    ("how", "number"), [("missing", 0), ("truncated", 1), ("changed", 3), ("empty", 8), ("changed", 0), ("missing", 3)]
)
def test_resuming_takes_again_what_was_lost(
    run: Run, measure: Measure, how: str, number: int, whole: list[StepRecord]
) -> None:
    frame = run.steps()[number].frames[-1].file
    lose(run.frame_path(frame), how)
    damaged = run.frame_path(frame).read_bytes() if how != "missing" else None
    told, rig = Told(), Plugin()
    again = measure(resume=True, progress=told, rig=rig)
    assert frame in told.text
    assert list(again.steps()) == whole
    assert repair.find_damage(Run.open(run.path), whole=True).damaged == {}
    aside = run.path / "set-aside" / frame
    assert (aside.read_bytes() if aside.exists() else None) == damaged
    (lost,) = (event for event in again.events() if event["event"] == "lost")
    assert lost["steps"] == [number]
    assert len(again.events()) == 11 + 4  # lost, session, step, end


def test_a_change_among_very_many_frames_is_found_by_the_check(
    run: Run, measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run.frame_path(run.steps()[0].frames[0].file)
    lose(first, "changed")
    monkeypatch.setattr(repair, "LOOKED_INTO", 6)
    told = Told()
    measure(resume=True, progress=told)
    assert "only the size was compared" in told.text
    assert first.name in repair.check(run.path).damaged[0][0]
    last = run.frame_path(run.steps()[-1].frames[-1].file)
    lose(last, "changed")
    told = Told()
    measure(resume=True, progress=told)
    assert last.name in told.text


def test_a_missing_row_of_the_plan_is_named_and_can_be_written_again(run: Run, measure: Measure) -> None:
    path = run.path / "plan.csv"
    whole = path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for wrong in (lines[:-1], [*lines[:2], *lines[3:]], [*lines, lines[-1]], [*lines[:1], *lines[2:0:-1], *lines[3:]]):
        path.write_bytes(b"".join(wrong))
        with pytest.raises(DataError, match=r"plan\.csv: .*--resume"):
            brdf.reduce(Run.open(run.path))
        with pytest.raises(DataError, match=r"plan\.csv"):
            measure(resume=True)
        assert path.read_bytes() == b"".join(wrong)
    path.unlink()
    measure(resume=True)
    assert path.read_bytes() == whole


def test_a_repair_while_somebody_measures_is_refused(run: Run) -> None:
    from gonio.lab.acquisition.journal import locked

    with locked(run.path / "journal.jsonl"), pytest.raises(ConfigError, match="another process"):
        repair.repair(run.path)


def test_a_whole_run_needs_no_repair(run: Run) -> None:
    before = tree(run.path)
    assert repair.repair(run.path) is None
    assert repair.check(run.path).damaged == {}
    assert tree(run.path) == before


def zero_half(path: Path) -> None:
    """As a disk does that has lost a block of pixels."""
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(len(data) - len(data) // 2))


@pytest.mark.parametrize(("number", "line"), [(1, "there"), (4, "lost")])
def test_damage_is_never_taken_for_what_was_measured(
    run: Run, measure: Measure, number: int, line: str, whole: list[StepRecord], table: pd.DataFrame
) -> None:
    """The last frame of a step holds the step's record, so no other frame has its checksum. The journal's line has it,
    and the frame has that of its own pixels.
    """
    zero_half(run.frame_path(run.steps()[number].frames[-1].file))
    if line == "lost":
        without_line(run, number + 1)
    done = repaired(run)
    assert done.rebuilt == []
    assert (done.damaged != []) == (line == "there")
    assert [step.step for step in Run.open(run.path).steps()] == [k for k in range(9) if k != number]
    again = measure(resume=True)
    assert list(again.steps()) == whole
    assert brdf.reduce(again).equals(table)


def test_a_byte_of_a_header_is_damage_too_where_no_line_is_left(run: Run) -> None:
    """Exposure, levels and label of a last frame: reading does not notice a changed digit."""
    path = run.frame_path(run.steps()[3].frames[-1].file)
    data = path.read_bytes()
    journal = run.path / "journal.jsonl"
    without_line(run, 4)
    for at in (data.index(b'"pose":{"light":') + 20, data.index(b"gonio goniometer camera"), data.index(b'"of":') + 5):
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        kept = journal.read_bytes()
        assert repaired(run).rebuilt == [], at
        journal.write_bytes(kept)
    path.write_bytes(data)
    assert repaired(run).rebuilt == [3]


def test_frames_of_a_cut_step_are_set_aside(run: Run, measure: Measure, whole: list[StepRecord]) -> None:
    """Whether they were cut short, or somebody took their line out of the journal, nothing tells: all are kept."""
    journal = run.path / "journal.jsonl"
    journal.write_bytes(
        b"".join(journal.read_bytes().splitlines(keepends=True)[:6])
    )  # four steps and a session; the others were never written
    half = run.path / "frames" / ".000004-green550-01.dng.123.new"
    half.write_bytes(b"half")
    unknown = run.path / "frames" / "000099-left-01.dng"
    unknown.write_bytes(b"somebody's")
    before, kept = (
        tree(run.path / "frames"),
        {frame.file for step in Run.open(run.path).steps() for frame in step.frames},
    )
    told = Told()
    again = measure(resume=True, progress=told)
    assert list(again.steps()) == whole
    aside = {name: data for name, data in before.items() if name not in kept}
    assert {half.name, unknown.name} < set(aside)
    assert tree(run.path / "set-aside") == aside
    assert f"{len(aside)} files of steps that were cut short" in told.text
    assert any(f"{len(aside)} files" in event["message"] for event in again.events() if event["event"] == "remark")


@pytest.mark.parametrize("name", ["IMG 0001.CR2", ".hidden", "a folder/", "000002-green550-01.dng.json.bak", "link"])
def test_other_things_among_the_frames_are_named_and_stay(
    run: Run, measure: Measure, tmp_path: Path, name: str
) -> None:
    strange = run.path / "frames" / name.rstrip("/")
    (tmp_path / "thesis.tex").write_text("years of work")
    if name.endswith("/"):
        strange.mkdir()
        (strange / "notes").write_text("mine")
    elif name == "link":
        strange.symlink_to(tmp_path / "thesis.tex")
    else:
        strange.write_text("mine")
    before = tree(run.path)
    with pytest.raises(ConfigError, match=name.rstrip("/")):
        measure(resume=True)
    assert tree(run.path) == before
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_the_reduction_holds_the_frames_of_one_step_at_a_time(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither pictures nor what the journal says of frames pile up: a long run has a hundred thousand.

    Without threads, which may be late, and hold a few steps more: `test_threads_take_a_few_items_ahead`.
    """
    for module in (brdf, count_rates):
        monkeypatch.setattr(module, "in_threads", map)
    total = sum(len(step.frames) for step in run.steps())
    most = max(len(step.frames) for step in run.steps())
    pictures, entries = [], []

    def look(done: int, of: int) -> None:
        gc.collect()
        there = gc.get_objects()
        pictures.append(sum(isinstance(each, Frame) for each in there))
        entries.append(sum(isinstance(each, FrameRecord) for each in there))

    gc.collect()
    gc.freeze()  # what other tests have left is not looked at
    try:
        brdf.reduce(run, progress=look)
    finally:
        gc.unfreeze()
    assert len(pictures) > 3
    assert max(pictures) <= most
    assert max(entries) - min(entries) <= most < total / 3


def test_threads_take_a_few_items_ahead() -> None:
    asked: list[int] = []

    def ask() -> Iterator[int]:
        for k in range(100):
            asked.append(k)
            yield k

    for k, done in enumerate(threads.in_threads(abs, ask())):
        assert done == k
        assert len(asked) - k <= 2 * threads.THREADS + 1


def test_a_refused_resume_has_changed_nothing(run: Run, measure: Measure, whole: list[StepRecord]) -> None:
    """Whatever refuses: what was found before that is acted on only when nothing can refuse any more."""
    one, two = (run.frame_path(step.frames[0].file) for step in (run.steps()[3], run.steps()[4]))
    first, second = one.read_bytes(), two.read_bytes()
    one.write_bytes(second)
    two.write_bytes(first)
    with (run.path / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"n":11,"ev')
    (run.path / "frames" / "000009-green550-01.dng").write_bytes(first)
    plan = (run.path / "plan.csv").read_bytes()
    for refusal in ("plan", "seed", "room", "device", "stranger"):
        changes: dict[str, object] = {"seed": 2} if refusal == "seed" else {}
        with pytest.MonkeyPatch.context() as patch:
            if refusal == "plan":
                (run.path / "plan.csv").write_bytes(plan.replace(b"60", b"61", 1))
            elif refusal == "room":
                patch.setattr("gonio.lab.acquisition.waits.free_bytes", lambda path: 0)
            elif refusal == "device":
                patch.setattr(NumpyRig, "__enter__", lambda self: (_ for _ in ()).throw(DeviceError("no answer")))
            elif refusal == "stranger":
                (run.path / "frames" / "IMG.CR2").write_bytes(b"mine")
            before = tree(run.path)
            with pytest.raises(GonioError):
                measure(resume=True, **changes)
            assert tree(run.path) == before, refusal
        (run.path / "plan.csv").write_bytes(plan)
    (run.path / "frames" / "IMG.CR2").unlink()
    assert list(measure(resume=True).steps()) == whole
    assert {first, second} <= set(tree(run.path / "set-aside").values()) | set(tree(run.path / "frames").values())


def test_a_link_in_the_place_of_a_frame_is_moved_and_not_followed(
    run: Run, measure: Measure, whole: list[StepRecord]
) -> None:
    one, two = (run.frame_path(step.frames[0].file) for step in (run.steps()[3], run.steps()[4]))
    kept = two.read_bytes()
    one.unlink()
    one.symlink_to(two.name)
    without_line(run, 5)
    assert repair.repair(run.path) is not None
    again = measure(resume=True)
    assert list(again.steps()) == whole
    assert two.read_bytes() == kept
    assert (run.path / "set-aside" / one.name).is_symlink()
    brdf.reduce(again)
