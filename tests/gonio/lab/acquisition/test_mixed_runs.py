"""What does not belong to a run, or is not as it was written, is named and left out: frames, journals and lines of
other runs of the same plan, edited files, lines that are gone.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from gonio_watch.follow import Follower

from gonio.config import to_toml
from gonio.disk import MANIFEST, write_own
from gonio.errors import DataError
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.journal import Journal, encode, read_events
from gonio.lab.acquisition.run import AS_BEGUN, Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.laboratory import Laboratory
from tests.command_line import some
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import Plugin


@pytest.fixture(autouse=True)
def one_id() -> None:
    """Each run has an id of its own here."""


LAB = {"sample": None, "seed": 0, "yes": True}


def lab() -> Plugin:
    """A bench on which time goes by."""
    return Plugin(options={"repeatable": False})


def two_of_a_plan(measure: Measure) -> tuple[Run, Run]:
    """A laboratory's two runs of one plan on one rig: everything but the frames and the id is the same."""
    one, other = (measure(name, rig=lab(), **LAB) for name in ("one", "other"))
    assert one.asked_key == other.asked_key
    return one, other


def mixed(measure: Measure, first: int) -> tuple[Run, list[str]]:
    """A run that has lost its journal, and whose frames from a step on are another run's; these frames' names."""
    one, other = two_of_a_plan(measure)
    names = [frame.file for step in other.steps()[first:] for frame in step.frames]
    for name in names:
        shutil.copy(other.frame_path(name), one.frame_path(name))
    (one.path / "journal.jsonl").unlink()
    return Run.open(one.path), names


def told_times(run: Run) -> list[float]:
    """The times of steps, in the order of the journal's lines."""
    return [event["time_s"] for event in run.events() if event["event"] == "step"]


def line_out_of(path: Path, line: int) -> None:
    lines = path.read_bytes().splitlines(keepends=True)
    del lines[line]
    path.write_bytes(b"".join(lines))


def test_frames_of_another_run_of_the_plan_are_named_and_make_no_step(measure: Measure) -> None:
    run, names = mixed(measure, 5)
    before = {name: run.frame_path(name).read_bytes() for name in names}
    done = some(repair.repair(run.path))
    assert (done.rebuilt, done.foreign) == (list(range(5)), sorted(names))
    assert {name: run.frame_path(name).read_bytes() for name in names} == before
    again = measure("one", rig=lab(), resume=True, **LAB)
    assert {path.name for path in (run.path / "set-aside").iterdir()} == set(names)
    assert repair.check(run.path).damaged == {}
    assert sorted(told_times(again)) == told_times(again)


def test_one_frame_of_another_run_takes_its_step_along(measure: Measure) -> None:
    one, other = two_of_a_plan(measure)
    name = other.steps()[4].frames[0].file
    shutil.copy(other.frame_path(name), one.frame_path(name))
    for lost in (False, True):
        if lost:
            (one.path / "journal.jsonl").unlink()
        done = some(repair.repair(one.path))
        assert done.foreign == [name]
        assert 4 not in [step.step for step in Run.open(one.path).steps()]


def test_frames_of_another_run_beside_a_whole_journal_are_named_and_change_nothing(measure: Measure) -> None:
    one, other = two_of_a_plan(measure)
    name = other.steps()[2].frames[0].file
    stranger = f"000077{name[6:]}"
    shutil.copy(other.frame_path(name), one.frame_path(name).with_name(stranger))  # renamed: no label counts
    assert repair.repair(one.path) is None
    longer = measure("longer", rig=lab(), **LAB)
    line_out_of(longer.path / "journal.jsonl", -2)
    journal = (one.path / "journal.jsonl").read_bytes()
    events = [event for event in one.events() if event.get("step") != 8]
    (one.path / "journal.jsonl").write_bytes(b"".join(encode({**e, "n": n}) for n, e in enumerate(bare(events))))
    for frame in longer_frames(longer, 8):
        shutil.copy(frame, one.path / "frames")
    done = some(repair.repair(one.path))
    assert (done.changed, done.foreign) == (False, [frame.name for frame in longer_frames(longer, 8)])
    assert not list(one.path.glob("journal.damaged*"))
    assert journal.startswith((one.path / "journal.jsonl").read_bytes()[:100])


def bare(events: list[dict[str, object]]) -> list[dict[str, object]]:
    return [{key: value for key, value in event.items() if key != "crc"} for event in events]


def longer_frames(run: Run, step: int) -> list[Path]:
    return sorted((run.path / "frames").glob(f"{step:06d}-*"))


def test_copies_under_other_names_make_no_step(run: Run) -> None:
    """A frame says which file it is: neither a copy nor a renamed one counts for another step."""
    for name in sorted(path.name for path in (run.path / "frames").glob("000004-*")):
        shutil.copy(run.frame_path(name), run.frame_path("000009" + name[6:]))
    for name in sorted(path.name for path in (run.path / "frames").glob("000006-*")):
        run.frame_path(name).rename(run.frame_path("000010" + name[6:]))
    (run.path / "journal.jsonl").unlink()
    done = some(repair.repair(run.path))
    assert done.rebuilt == [0, 1, 2, 3, 4, 5, 7, 8]
    assert {name[:6] for name in done.undetermined} == {"000009", "000010"}


@pytest.mark.parametrize("lost", [(3,), (1, 5), (2, 3, 8)])
def test_steps_that_are_made_again_stand_where_their_time_puts_them(measure: Measure, lost: tuple[int, ...]) -> None:
    run = measure("one", rig=lab(), **LAB)
    for step in sorted(lost, reverse=True):
        line_out_of(run.path / "journal.jsonl", step + 1)
    done = some(repair.repair(run.path))
    assert done.rebuilt == list(lost)
    again = Run.open(run.path)
    assert told_times(again) == sorted(told_times(again))
    assert again.steps().latest().step == 8


def test_steps_taken_at_once_are_of_two_runs(measure: Measure) -> None:
    """As frames of two runs of earlier versions, which have no id, may be: one camera takes one frame at a time."""
    from gonio.lab.acquisition.remade import at_once

    steps = list(measure("one", rig=lab(), **LAB).steps())
    assert at_once(steps) == set()
    back = replace(steps[5], time_s=steps[3].time_s, frames=steps[3].frames)
    assert at_once([*steps[:5], back, *steps[6:]]) == {3, 5}


def earlier(run: Run) -> Run:
    """The run as an earlier version would have begun it: nothing has an id."""
    settings = run.settings.model_copy(update={"run": run.settings.run.model_copy(update={"id": None})})
    tables = settings.model_dump(mode="json", exclude_none=True)
    write_own(run.path, {"run.toml": to_toml(tables).encode()})
    journal = run.path / "journal.jsonl"
    events = [{k: v for k, v in event.items() if k not in ("run", "files", "crc")} for event in read_events(journal)]
    journal.write_bytes(b"".join(map(encode, events)))
    return Run.open(run.path)


def test_a_run_of_an_earlier_version_is_read_and_repaired_and_said_to_have_no_id(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Run, "key", Run.asked_key)
    run = earlier(measure("one", rig=lab(), **LAB))
    assert repair.check(run.path).damaged == {}
    assert repair.repair(run.path) is None
    (run.path / "journal.jsonl").unlink()
    done = some(repair.repair(run.path))
    assert done.rebuilt == list(range(9))
    assert any("an earlier version" in text for text in done.untold)
    assert "files" not in next(iter(Run.open(run.path).events()))


def test_points_that_go_back_in_time_are_named(measure: Measure) -> None:
    """Taken again, or after the clock was set back, or frames of several runs: nothing else tells."""
    from gonio.lab.acquisition.remade import _out_of_turn

    steps = list(measure("one", rig=lab(), **LAB).steps())
    assert _out_of_turn(steps) == []
    assert _out_of_turn([*steps[:6], *(replace(s, time_s=s.time_s - 1000.0) for s in steps[6:])]) == [2, 3, 4]


@pytest.mark.parametrize("manifest", ["there", "gone", "written anew"])
@pytest.mark.parametrize("name", ["run.toml", "plan.csv"])
def test_an_edited_file_is_refused_whatever_became_of_the_manifest(
    run: Run, measure: Measure, name: str, manifest: str
) -> None:
    """Files that numbers rest on: all readers refuse, whether the list of checksums was edited as well or is gone."""
    path = run.path / name
    data = path.read_bytes().replace(b"20.0" if name == "plan.csv" else b"albedo = 0.99", b"21.0", 1)
    if name == "run.toml":
        data = path.read_bytes().replace(b"albedo = 0.99", b"albedo = 0.5", 1)
    assert data != path.read_bytes()
    if manifest == "written anew":
        write_own(run.path, {name: data})
    else:
        path.write_bytes(data)
    if manifest == "gone":
        (run.path / MANIFEST).unlink()
    for read in (brdf.reduce, lambda run: repair.check(run.path), lambda run: repair.repair(run.path)):
        with pytest.raises(DataError, match=rf"{name}: was changed after it was written.*restore it"):
            read(Run.open(run.path))
    with pytest.raises(DataError, match=rf"{name}: was changed"):
        measure(resume=True)


def test_a_table_beside_the_frames_that_was_edited_is_refused_too(run: Run) -> None:
    """A reference's table rules every value, as run.toml does."""
    assert {"reference.csv", "certificate.xml", "camera_maps.npz"} < AS_BEGUN
    (run.path / "reference.csv").write_text("theta_i_deg\n")
    journal = run.path / "journal.jsonl"
    events = bare(list(read_events(journal)))
    events[0]["files"] = {**events[0]["files"], "reference.csv": "0" * 64}  # type: ignore[dict-item]
    journal.write_bytes(b"".join(map(encode, events)))
    with pytest.raises(DataError, match=r"reference\.csv: was changed"):
        Run.open(run.path)


def test_the_laboratory_may_be_stated_anew_and_a_kill_in_the_middle_does_no_harm(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    for fails in (True, False):
        with monkeypatch.context() as patch, Journal(run.path / "journal.jsonl") as journal:
            if fails:
                patch.setattr("gonio.lab.acquisition.run.write_own", killed)
            opened = replace(Run.open(run.path), journal=journal)
            try:
                opened.state(Laboratory(operator=f"Ada {fails}"))
            except KeyboardInterrupt:
                assert fails
        assert (Run.open(run.path).settings.laboratory is None) == fails
    (run.path / "run.toml").write_text((run.path / "run.toml").read_text().replace("Ada", "Eve"))
    (run.path / MANIFEST).unlink()
    with pytest.raises(DataError, match=r"run\.toml: was changed"):
        Run.open(run.path)


def test_a_repaired_journal_says_in_its_first_line_which_run_it_is_of(run: Run) -> None:
    (run.path / "journal.jsonl").unlink()
    assert some(repair.repair(run.path)).untold == []
    first = json.loads((run.path / "journal.jsonl").read_bytes().splitlines()[0])
    assert (first["event"], first["run"]) == ("step", run.key)
    assert "run.toml" in first["files"]
    (run.path / MANIFEST).unlink()
    (run.path / "journal.jsonl").unlink()
    assert any("run.toml: no checksum is left" in text for text in some(repair.repair(run.path)).untold)


def test_the_journal_of_another_run_is_refused(measure: Measure) -> None:
    one, other = two_of_a_plan(measure)
    shutil.copy(other.path / "journal.jsonl", one.path)
    shutil.copy(other.path / "plan.csv", one.path)
    for read in (Run.open, repair.repair):
        with pytest.raises(DataError, match=r"run\.toml|journal of another run"):
            read(one.path)


@pytest.mark.parametrize("line", [0, 3, -3, -2])
def test_a_line_that_is_gone_is_seen(run: Run, measure: Measure, line: int) -> None:
    """The last but one as any other: a whole line is no torn one."""
    path = run.path / "journal.jsonl"
    number = len(path.read_bytes().splitlines()) + line + 1 if line < 0 else line + 1
    line_out_of(path, line)
    with pytest.raises(DataError, match=rf"line {number} is missing.*gonio run repair"):
        read_events(path)
    follower = Follower(run.path)
    assert sum(map(len, follower.poll())) == number - 1
    assert "damaged" in follower.damaged
    if line:
        with pytest.raises(DataError, match=rf"line {number} is missing"):
            measure(resume=True)
        with pytest.raises(DataError, match=rf"line {number} is missing"):
            brdf.reduce(Run.open(run.path))
    if line == 3:
        line_out_of(path, line)
        with pytest.raises(DataError, match=r"line 4 is missing \(2 of them"):
            read_events(path)
    assert some(repair.repair(run.path)).changed
    assert len(Run.open(run.path).steps()) == 9
