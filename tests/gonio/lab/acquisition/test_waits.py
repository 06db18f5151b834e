"""What a run waits for between two steps: a person, room on the disk, a fault that passes. The result is the same."""

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from gonio.errors import ConfigError, DataError, DeviceError, Interrupted, PassingFault
from gonio.lab.acquisition import waits
from gonio.lab.acquisition.measure import RigChoice, check
from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.progress import Live, Pause, Silent
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.commands.progress import _Rest
from gonio.lab.rig import Frame
from gonio.lab.rig.description import Reference
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import SAMPLE, NumpyRig, Plugin, describe


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waits take no time."""
    monkeypatch.setattr(waits, "LOOK_S", 0.0)
    monkeypatch.setattr(waits, "WAITS_S", {"camera": (0.0, 0.0), "lamp": (0.0,)})


def names(run: Run) -> list[str]:
    return [event["event"] for event in run.events()]


class Person(Silent):
    """Asks for a pause after so many steps, and does something else when the run says that it is paused."""

    def __init__(self, after: int, ask: Callable[[], None], then: Callable[[], None]) -> None:
        self.after, self.ask, self.then, self.count = after, ask, then, 0
        self.said: list[str] = []

    def step(self, live: Live) -> None:
        self.count += 1
        if self.count == self.after:
            self.ask()

    def say(self, text: str) -> None:
        self.said.append(text)
        if text.startswith("paused"):
            self.then()


def test_a_pause_comes_after_the_step_with_the_lamp_dark_and_changes_nothing(
    measure: Measure, whole: list[StepRecord]
) -> None:
    pause, rig = Pause(), Plugin()
    seen: list[bool] = []

    def then() -> None:
        seen.append(rig.opened[0].lit)
        pause.go_on()

    person = Person(3, lambda: pause.ask("a key"), then)
    run = measure("run", rig=rig, progress=person, pause=pause)
    assert seen == [False]
    assert list(run.steps()) == whole
    assert names(run) == ["session", *["step"] * 4, "paused", "continued", *["step"] * 5, "end"]
    paused, continued = (event for event in run.events() if event["event"] in ("paused", "continued"))
    assert paused["step"] == continued["step"] == 4
    assert paused["message"] == "paused before step 4 by a key"
    assert "goes on" in person.said[0]


class Clocked(Person):
    """A person with the clock of the terminal, which learns how long steps take."""

    def __init__(self, rest: _Rest, *how: Any) -> None:
        super().__init__(*how)
        self.rest = rest

    def start(self, steps: int, done: int) -> None:
        self.rest.start()

    def waited(self, seconds: float) -> None:
        self.rest.waited(seconds)

    def step(self, live: Live) -> None:
        self.rest.step(live)
        super().step(live)


def test_no_step_took_the_time_of_a_pause(measure: Measure, monkeypatch: pytest.MonkeyPatch) -> None:
    away_s, clock, pause = [0.0], time.monotonic, Pause()
    monkeypatch.setattr(time, "monotonic", lambda: clock() + away_s[0])

    def then() -> None:
        away_s[0] = 1e6
        pause.go_on()

    told: list[float] = []

    class Learns:
        def took(self, record: object, seconds: float) -> None:
            told.append(seconds)

    rest = _Rest()
    rest.expects(Learns())  # type: ignore[arg-type]
    run = measure("run", progress=Clocked(rest, 3, lambda: pause.ask("a key"), then), pause=pause)
    assert names(run).count("paused") == 1
    assert len(told) == len(run.steps())
    assert max(told) < 1e3


def test_ctrl_z_pauses_and_sigcont_goes_on(measure: Measure) -> None:
    person = Person(2, lambda: signal.raise_signal(signal.SIGTSTP), lambda: signal.raise_signal(signal.SIGCONT))
    before = signal.getsignal(signal.SIGTSTP), signal.getsignal(signal.SIGCONT)
    run = measure("run", progress=person)
    assert (signal.getsignal(signal.SIGTSTP), signal.getsignal(signal.SIGCONT)) == before
    assert names(run).count("paused") == names(run).count("continued") == 1
    assert names(run)[-1] == "end"
    assert f"kill -CONT {os.getpid()}" in next(text for text in person.said if text.startswith("paused"))


def test_a_paused_run_that_is_stopped_goes_on_with_resume(
    measure: Measure, tmp_path: Path, whole: list[StepRecord]
) -> None:
    pause, rig = Pause(), Plugin()
    person = Person(2, lambda: pause.ask("a key"), lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(Interrupted, match="stopped while paused, after 3 of 9 steps"):
        measure("run", rig=rig, progress=person, pause=pause)
    assert not rig.opened[0].lit
    assert names(Run.open(tmp_path / "run"))[-2:] == ["paused", "interrupted"]
    assert list(measure("run", resume=True).steps()) == whole


@pytest.mark.parametrize("how", ["axis", "swap"])
def test_where_time_goes_by_a_visit_to_the_reference_follows_a_pause(measure: Measure, how: Any) -> None:
    """The lamp was dark: it may be another one now. Where a person swaps the reference nobody may be there."""
    pause = Pause()
    person = Person(3, lambda: pause.ask("a key"), pause.go_on)
    rig = describe(reference=Reference(every=3, frames=2, how=how))
    options: dict[str, object] = {"repeatable": False}
    run = measure("run", rig=Plugin(options=options), description=rig, progress=person, pause=pause, yes=True)
    kinds = [(event["step"], event["kind"]) for event in run.events() if event["event"] == "step"]
    following = [(9, "reference")] if how == "axis" else []
    assert kinds[4 : 5 + len(following)] == [*following, (4, "point")]


@dataclass
class Faulty(NumpyRig):
    """A camera that gives no frame in a step, so many times."""

    faults: dict[int, int] = field(default_factory=dict)
    lit_in_wait: list[bool] = field(default_factory=list)

    def capture(self, exposure_s: float) -> Frame:
        if self.faults.get(self.step, 0) and self.frame == 2:
            self.faults[self.step] -= 1
            raise PassingFault("camera: no frame came within 5 s", "camera")
        return super().capture(exposure_s)


def faults(by_step: dict[int, int], **options: object) -> Plugin:
    return Plugin(options={"faults": by_step, **options}, kind=Faulty)


def test_a_step_with_a_fault_that_passes_is_taken_again_and_nothing_changes(
    measure: Measure, whole: list[StepRecord]
) -> None:
    run = measure("run", rig=faults({1: 1, 3: 2, 8: 1}))
    assert list(run.steps()) == whole
    tried = [(e["step"], e["device"], e["attempt"]) for e in run.events() if e["event"] == "retry"]
    assert tried == [(1, "camera", 1), (3, "camera", 1), (3, "camera", 2), (8, "camera", 1)]
    named = {frame.file for step in run.steps() for frame in step.frames}
    assert {path.name for path in (run.path / "frames").iterdir()} == named


def test_a_fault_that_does_not_pass_ends_the_run_which_can_go_on(
    measure: Measure, tmp_path: Path, whole: list[StepRecord]
) -> None:
    with pytest.raises(DeviceError, match="no frame came within 5 s; step 3 was tried 3 times"):
        measure("run", rig=faults({3: 99}))
    assert names(Run.open(tmp_path / "run"))[-1] == "device_error"
    assert list(measure("run", resume=True).steps()) == whole


def test_any_other_fault_is_not_tried_again(measure: Measure, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="no frame came"):
        measure("run", rig=Plugin(options={"fails_at": 3}))
    assert "retry" not in names(Run.open(tmp_path / "run"))


def test_after_a_fault_the_lamp_was_dark_so_that_the_reference_is_visited(measure: Measure) -> None:
    rig = describe(reference=Reference(every=3, frames=2, how="axis"))
    run = measure("run", rig=faults({3: 1}, repeatable=False), description=rig)
    kinds = [(event["step"], event["kind"]) for event in run.events() if event["event"] == "step"]
    assert kinds[2:5] == [(2, "point"), (9, "reference"), (3, "point")]


class Disk:
    """A disk with so much room at each look; the last one for ever."""

    def __init__(self, *free: int) -> None:
        self.free = list(free)

    def __call__(self, folder: Path) -> int:
        return self.free.pop(0) if len(self.free) > 1 else self.free[0]


PLENTY, NOTHING = 10**12, 0


def test_a_run_that_cannot_fit_is_refused_before_anything_is_touched(
    measure: Measure, plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waits, "free_bytes", Disk(1_500_000))
    rig = Plugin()
    with pytest.raises(ConfigError, match=r"run: 9 steps need about 2\.\d+ MB on the disk, and 1\.5 MB are free"):
        measure("run", rig=rig)
    assert not (tmp_path / "run").exists()
    assert not rig.opened[0].log
    with pytest.raises(ConfigError, match="are free"):
        check(
            plan, RigChoice(rig, describe(), "numpy"), tmp_path / "run", sample=SAMPLE, seed=0, resume=False, yes=False
        )


def test_what_a_run_needs_is_what_it_takes(run: Run) -> None:
    need = waits.Bytes(run.description, len(run.bands))
    steps, taken = run.steps(), 0
    for step in steps:
        taken += sum(frame.bytes or 0 for frame in step.frames)
    taken += (run.path / "journal.jsonl").stat().st_size
    # small frames: their heads, of up to HEAD bytes, weigh as much as their pixels
    assert taken <= need.of_run(len(steps)) - waits.RESERVE < 2.0 * taken


def test_a_full_disk_is_waited_for(measure: Measure, monkeypatch: pytest.MonkeyPatch, whole: list[StepRecord]) -> None:
    rig, person = Plugin(), Person(99, lambda: None, lambda: None)
    # before the run; before each of four steps; then full for two looks (and the message), and there is room again
    monkeypatch.setattr(waits, "free_bytes", Disk(*[PLENTY] * 5, *[NOTHING] * 4, PLENTY))
    run = measure("run", rig=rig, progress=person)
    (paused,) = (event for event in run.events() if event["event"] == "paused")
    assert (paused["step"], paused["why"]) == (4, "disk")
    assert "0 bytes are free, and step 4 needs" in paused["message"]
    monkeypatch.undo()
    assert list(run.steps()) == whole


def test_a_disk_that_stays_full_ends_the_run_which_can_go_on(
    measure: Measure, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: list[StepRecord]
) -> None:
    rig = Plugin()
    with monkeypatch.context() as full:
        full.setattr(waits, "ROOM_UNATTENDED_S", 0.0)
        full.setattr(waits, "free_bytes", Disk(*[PLENTY] * 5, NOTHING))
        with pytest.raises(DataError, match=r"0 bytes are free, and step 4 needs .*; make room, then go on"):
            measure("run", rig=rig)
    assert not rig.opened[0].lit
    assert rig.opened[0].log[-1] == "park"
    assert len(Run.open(tmp_path / "run").steps()) == 4
    assert list(measure("run", resume=True).steps()) == whole


def test_a_run_that_cannot_fit_is_begun_with_yes(measure: Measure, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waits, "free_bytes", Disk(1_500_000, PLENTY))
    person = Person(99, lambda: None, lambda: None)
    assert names(measure("run", progress=person, yes=True))[-1] == "end"
    assert "waits where it is full (--yes)" in person.said[0]
