"""A camera that is read out while the arms go on: the run is the same, and no frame is lost or of another pose."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from gonio.errors import DeviceError, Interrupted, PassingFault
from gonio.lab.acquisition import waits
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.description import Reference, Suspender
from tests.gonio import numpy_rig
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import NumpyRig, Plugin, StopAfter, describe

BESIDE = describe(reference=Reference(every=3, frames=2, how="axis"))
"""Nobody is asked to swap anything."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waits take no time."""
    monkeypatch.setattr(waits, "LOOK_S", 0.0)
    monkeypatch.setattr(waits, "WAITS_S", {"camera": (0.0, 0.0), "lamp": (0.0,)})


class Killed(BaseException):
    """The process is gone."""


@dataclass
class SlowRig(NumpyRig):
    """Says when an exposure is over; the frame comes when it is asked for."""

    errors: dict[int, list[Exception]] = field(default_factory=dict)
    """What read-outs of a step end with, one after the other."""
    dies_in_move: int | None = None
    """The step on the way to which the process dies."""

    def move(self, goal: Pose) -> Pose:
        if self.step == self.dies_in_move:
            self.dies_in_move = None
            raise Killed
        return super().move(goal)

    def capture(self, exposure_s: float) -> Frame:
        self.log.append(f"expose {self.step}")
        return super().capture(exposure_s)

    def expose(self, exposure_s: float) -> "Later":
        return Later(self, self.capture(exposure_s), self.step)


@dataclass
class Later:
    """A frame that has not come."""

    rig: SlowRig
    frame: Frame
    step: int

    def done(self) -> bool:
        return False

    def result(self) -> Frame:
        self.rig.log.append(f"frame {self.step}")
        if self.rig.errors.get(self.step):
            raise self.rig.errors[self.step].pop(0)
        return self.frame


class ReadAtOnce(SlowRig):
    """Without the capability."""

    expose = None  # type: ignore[assignment]


def slow(**options: Any) -> Plugin:
    return Plugin(options=options, kind=SlowRig)


def bare(steps: Iterable[StepRecord]) -> list[StepRecord]:
    """Without what says that moves overlapped: in the step, and in the label of its last frame."""
    out = []
    for step in steps:
        *frames, last = step.frames or [None]
        last = last and replace(last, sha256=None, bytes=None)
        out.append(replace(step, overlapped=False, frames=tuple(filter(None, [*frames, last]))))
    return out


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run of a rig whose moves wait."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("secrets.token_hex", lambda size: "1d" * size)
        plugin = Plugin(kind=ReadAtOnce)
        return numpy_rig.measured(
            numpy_rig.plan_in(folder), folder / "run", plugin, description=BESIDE, command="gonio measure ..."
        )


@pytest.fixture(scope="module")
def table(whole: Run) -> pd.DataFrame:
    """Its reduction; not to be written to."""
    return brdf.reduce(whole)


def events(run: Run) -> Counter[str]:
    return Counter(event["event"] for event in run.events())


def test_the_run_is_the_same_and_says_that_moves_overlapped(measure: Measure, whole: Run, table: pd.DataFrame) -> None:
    plugin = slow()
    run = measure("run", rig=plugin, description=BESIDE)
    assert [step.overlapped for step in run.steps()] == [True] * 8 + [False]  # nobody moves after the last one
    assert not any(step.overlapped for step in whole.steps())
    assert '"overlapped":true' in (run.path / "journal.jsonl").read_text()
    assert "overlapped" not in (whole.path / "journal.jsonl").read_text()
    assert bare(run.steps()) == bare(whole.steps())
    pd.testing.assert_frame_equal(brdf.reduce(run), table, check_exact=True)


def test_a_frame_comes_after_the_next_move_and_before_the_next_exposure_and_lamp(measure: Measure) -> None:
    plugin = slow()
    measure("run", rig=plugin, description=BESIDE)
    log = plugin.opened[0].log
    for step in range(8):
        begun, come = log.index(f"expose {step + 1}"), log.index(f"frame {step}")
        between = log[come - log[come::-1].index(f"expose {step}") + 1 : come]
        assert between.count("move") == 1, between
        assert "on" not in between
        assert come < begun
    assert log.index("frame 0") < log.index("on"), "the lamp was lit before the last dark frame had come"


def test_a_frame_that_does_not_come_is_taken_again_from_its_own_pose(
    measure: Measure, whole: Run, table: pd.DataFrame
) -> None:
    plugin = slow(errors={3: [PassingFault("camera: no file came", "camera")]})
    run = measure("run", rig=plugin, description=BESIDE)
    assert bare(run.steps()) == bare(whole.steps())
    assert [step.step for step in run.steps() if not step.overlapped] == [3, 8]
    (retry,) = (event for event in run.events() if event["event"] == "retry")
    assert (retry["step"], retry["message"]) == (3, "camera: no file came")
    pd.testing.assert_frame_equal(brdf.reduce(run), table, check_exact=True)


def test_where_time_goes_by_the_reference_is_visited_before_such_a_step(measure: Measure) -> None:
    plugin = slow(errors={3: [PassingFault("camera: no file came", "camera")]}, repeatable=False)
    run = measure("run", rig=plugin, description=BESIDE)
    taken = [(event["step"], event["kind"]) for event in run.events() if event["event"] == "step"]
    assert taken[2:6] == [(2, "point"), (9, "reference"), (3, "point"), (4, "point")]


def test_a_camera_that_fails_while_the_arms_move_is_waited_for_from_then_on(measure: Measure, whole: Run) -> None:
    faults = {step: [PassingFault("camera: no file came", "camera")] for step in (2, 3, 4)}
    run = measure("run", rig=slow(errors=faults), description=BESIDE)
    assert bare(run.steps()) == bare(whole.steps())
    assert [step.step for step in run.steps() if step.overlapped] == [0, 1]
    assert any("moves wait from here on" in event.get("message", "") for event in run.events())


def test_a_camera_that_never_gives_its_frame_ends_the_run_after_three_attempts(measure: Measure) -> None:
    faults = [PassingFault("camera: no file came", "camera") for _ in range(9)]
    plugin = slow(errors={3: faults})
    with pytest.raises(DeviceError, match="camera: no file came; step 3 was tried 3 times"):
        measure("run", rig=plugin, description=BESIDE)
    assert not plugin.opened[0].lit
    assert plugin.opened[0].log[-2:] == ["off", "park"]


def test_a_camera_that_breaks_ends_the_run_and_names_the_step(measure: Measure, whole: Run, tmp_path: Path) -> None:
    plugin = slow(errors={3: [DeviceError("camera: unplugged")]})
    with pytest.raises(DeviceError, match="step 3, which was read out during the next move: camera: unplugged"):
        measure("run", rig=plugin, description=BESIDE)
    log = plugin.opened[0].log
    assert log[-3:] == ["stop", "off", "park"]
    assert [step.step for step in Run.open(tmp_path / "run").steps()] == [0, 1, 2]
    assert bare(measure("run", rig=slow(), description=BESIDE, resume=True).steps()) == bare(whole.steps())


@pytest.mark.parametrize("at", [1, 2, 4, 5])
def test_a_process_that_dies_in_an_overlapped_move_is_gone_on_with(
    measure: Measure, whole: Run, table: pd.DataFrame, tmp_path: Path, at: int
) -> None:
    with pytest.raises(Killed):
        measure("run", rig=slow(dies_in_move=at), description=BESIDE)
    assert len(Run.open(tmp_path / "run").steps()) >= at - 2  # a plug that is pulled costs two steps at most
    run = measure("run", rig=slow(), description=BESIDE, resume=True)
    assert bare(run.steps()) == bare(whole.steps())
    pd.testing.assert_frame_equal(brdf.reduce(run), table, check_exact=True)


def test_ctrl_c_waits_for_the_frame_that_is_on_its_way_in_the_dark(
    measure: Measure, whole: Run, tmp_path: Path
) -> None:
    plugin = slow()
    with pytest.raises(Interrupted):
        measure("run", rig=plugin, description=BESIDE, progress=StopAfter(3))
    log = plugin.opened[0].log
    assert log[-4:] == ["off", log[-3], "off", "park"]
    assert log[-3].startswith("frame ")
    last = int(log[-3].removeprefix("frame "))
    assert [step.step for step in Run.open(tmp_path / "run").steps()] == list(range(last + 1))
    assert bare(measure("run", rig=slow(), description=BESIDE, resume=True).steps()) == bare(whole.steps())


def test_a_frame_that_fails_when_the_run_is_stopped_is_left_for_the_next_session(
    measure: Measure, whole: Run, tmp_path: Path
) -> None:
    faults = {step: [PassingFault("camera: no file came", "camera")] for step in range(3, 9)}
    plugin = slow(errors=faults)
    with pytest.raises(Interrupted):
        measure("run", rig=plugin, description=BESIDE, progress=StopAfter(2))
    run = Run.open(tmp_path / "run")
    assert [step.step for step in run.steps()] == [0, 1, 2]
    assert any(
        event.get("message") == "step 3: camera: no file came; it is not in this run yet" for event in run.events()
    )
    assert plugin.opened[0].log[-4:] == ["off", "frame 3", "off", "park"]
    assert bare(measure("run", rig=slow(), description=BESIDE, resume=True).steps()) == bare(whole.steps())


@pytest.mark.parametrize("pushes", [{3: 1}, {3: 9}])
def test_an_arm_that_was_pushed_is_seen_before_the_next_move(measure: Measure, pushes: dict[int, int]) -> None:
    run = measure("run", rig=slow(pushes=dict(pushes)), description=BESIDE)
    plain = measure("plain", rig=Plugin(options={"pushes": dict(pushes)}, kind=ReadAtOnce), description=BESIDE)
    assert bare(run.steps()) == bare(plain.steps())
    assert events(run) == events(plain)


def test_nothing_overlaps_where_the_room_is_looked_at_or_a_person_swaps(measure: Measure) -> None:
    rule = Suspender(quantity="room_light", above=1e9)
    looked = measure("looked", rig=slow(), description=BESIDE.model_copy(update={"suspend": {"room": rule}}))
    assert not any(step.overlapped for step in looked.steps())
    by_hand = measure("by_hand", rig=slow(), description=describe())
    kinds = [step.kind for step in by_hand.steps()]
    same = [one == other for one, other in pairwise(kinds)]
    assert [step.overlapped for step in by_hand.steps()] == [*same, False]


def test_a_pause_waits_for_the_frame_first(measure: Measure, whole: Run) -> None:
    from gonio.lab.acquisition.progress import Pause
    from tests.gonio.lab.acquisition.test_waits import Person

    pause, plugin = Pause(), slow()
    at: list[str] = []

    def then() -> None:
        at.append(next(entry for entry in reversed(plugin.opened[0].log) if entry.startswith(("frame", "expose"))))
        pause.go_on()

    run = measure(
        "run", rig=plugin, description=BESIDE, pause=pause, progress=Person(3, lambda: pause.ask("a key"), then)
    )
    assert at
    assert at[0].startswith("frame")
    assert bare(run.steps()) == bare(whole.steps())
