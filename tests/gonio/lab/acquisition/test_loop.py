"""The loop on a rig of numpy: what a run holds, and that stopping it anywhere changes nothing."""

import hashlib
import math
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import ConfigError, DataError, DeviceError, Interrupted
from gonio.lab.acquisition.progress import Live, Silent
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Acquisition
from gonio.lab.rig.dng import read_raw
from tests.command_line import some
from tests.gonio.lab.acquisition.conftest import Measure
from tests.gonio.numpy_rig import SAMPLE, NumpyRig, Plugin, StopAfter, describe


def test_a_run_holds_what_was_asked_and_what_happened(measure: Measure) -> None:
    rig = Plugin()
    run = measure("run", rig=rig)
    assert (run.seed, run.sample, run.description) == (1, SAMPLE, describe())
    assert [band.centre_nm for band in run.bands] == [550, 650]
    assert list(run.plan["flag"]) == ["", "blocked", "", "", "", ""]
    assert "around retro" in run.plan["reason"][1]
    assert [event["event"] for event in run.events()] == ["session", *["step"] * 9, "end"]
    assert [step.kind for step in run.steps()] == [
        *["dark", "reference", "point", "point", "point", "reference", "point", "point", "reference"]
    ]
    assert rig.opened[0].log[-2:] == ["off", "park"]
    assert not rig.opened[0].lit


def test_frames_are_those_that_the_journal_names(run: Run) -> None:
    named = [frame for step in run.steps() for frame in step.frames]
    assert {path.name for path in (run.path / "frames").iterdir()} == {frame.file for frame in named}
    for frame in named:
        assert hashlib.sha256(run.frame_path(frame.file).read_bytes()).hexdigest() == frame.sha256
    point = run.steps()[2]
    assert [f.file for f in point.frames] == [
        *[f"000002-green550-{k:02d}.dng" for k in (1, 2, 3)],
        *[f"000002-red650-{k:02d}.dng" for k in (1, 2, 3)],
    ]
    assert [f.band for f in point.frames] == ["green, 550"] * 3 + ["red 650"] * 3
    first, _, short = point.frames[:3]
    assert short.exposure_s == pytest.approx(first.exposure_s / 4, abs=1e-6)  # whole microseconds
    raw = read_raw(run.frame_path(first.file))
    assert raw.exposure_s == first.exposure_s
    level = (float(np.max(raw.mosaic)) - 64) / (11_000 / 3)
    assert level == pytest.approx(0.6, abs=0.05)  # photon noise of the brightest pixel in the metering frame


def test_darks_are_dark_and_the_lamp_is_lit_for_the_rest(whole: list[StepRecord]) -> None:
    for step in whole:
        assert {frame.lamp for frame in step.frames} == {step.kind != "dark"}
    dark = whole[0]
    assert len({frame.exposure_s for frame in dark.frames}) == 2
    assert len(dark.frames) == 4


def test_readbacks_before_and_after_the_frames_are_recorded_with_their_times(whole: list[StepRecord]) -> None:
    dark, *others = whole
    assert some(dark.pose_time_s) >= dark.frames[-1].time_s
    for step in others:
        assert step.pose == step.pose_after == step.goal  # this rig has no errors
        times = [frame.time_s for frame in step.frames]
        assert some(step.pose_time_s) <= times[0] < times[-1] <= some(step.pose_after_time_s)


def test_a_step_during_which_an_arm_was_pushed_is_taken_again(measure: Measure, whole: list[StepRecord]) -> None:
    run = measure("run", rig=Plugin(options={"pushes": {3: 1}}))
    assert list(run.steps()) == whole
    (remark,) = (event["message"] for event in run.events() if event["event"] == "remark")
    assert remark == "step 3: axis camera has moved by 0.30 deg during the exposures; it is taken again"


def test_a_step_during_which_an_arm_never_stands_still_is_flagged(measure: Measure) -> None:
    run = measure("run", rig=Plugin(options={"pushes": {1: 9, 3: 9}}))  # a visit to the reference, and a point
    assert {step.step: step.flag for step in run.steps()} == dict.fromkeys(range(9), "") | {1: "moved", 3: "moved"}
    assert [event["message"].rpartition("; ")[2] for event in run.events() if event["event"] == "remark"] == [
        *["it is taken again", "it is taken again", 'it is flagged "moved"'] * 2
    ]
    flagged = run.steps()[3]
    assert flagged.frames == ()
    assert flagged.pose.camera - flagged.goal.camera == pytest.approx(
        math.radians(0.3), abs=1e-15
    )  # a sum and back: roundings
    table = brdf.reduce(run)
    assert list(table["flag"])[:4] == ["", "", "blocked", "blocked"]
    assert set(table["flag"][table["flag"] != "blocked"]) == {"", "moved"}
    assert (table["flag"] == "moved").sum() == 2  # in both bands


def test_a_pose_whose_readings_scatter_is_recorded_and_flagged(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    visits: list[str] = []

    def spread(arms: object) -> Pose:
        visits.append("")
        return Pose(camera=math.radians(0.44 if len(visits) in (1, 3) else 0.005))  # a visit to the reference; a point

    monkeypatch.setattr(NumpyRig, "spread", property(spread), raising=False)
    run = measure("run")
    assert [step.flag for step in run.steps()] == ["", "", "", "unsteady", *[""] * 5]
    taken = run.steps()[3]
    assert taken.pose_spread == Pose(camera=math.radians(0.44))
    assert len(taken.frames) == 6
    (remark,) = (event["message"] for event in run.events() if event["event"] == "remark")
    assert remark == 'step 3: the readings of axis camera at rest lie 0.44 deg apart; it is flagged "unsteady"'
    table = brdf.reduce(run)
    assert set(table["flag"]) == {"", "blocked", "unsteady"}
    assert table["brdf"][table["flag"] == "unsteady"].isna().all()


def test_one_seed_gives_one_run(measure: Measure, whole: list[StepRecord]) -> None:
    assert list(measure("again").steps()) == whole
    assert list(measure("other", seed=2).steps()) != whole


def metering_frames(step: StepRecord) -> int:
    """How many frames a step took before those that it kept: on this rig a frame's time counts the step's frames."""
    return round(step.frames[-1].time_s) - 100 * int(step.step) + 1 - len(step.frames)


def test_a_point_is_metered_with_what_the_point_before_it_needed(measure: Measure) -> None:
    """Fifty times darker than white, a sample costs a search at its first point and one frame a band from then on."""
    points = [step for step in measure("run", rig=Plugin(options={"albedo": 0.02})).steps() if step.kind == "point"]
    taken = [metering_frames(step) for step in points]
    assert taken[0] > 2
    assert taken[1:] == [2] * (len(points) - 1)


def test_a_white_that_is_full_at_the_shortest_exposure_ends_the_run_before_its_points(measure: Measure) -> None:
    camera = describe().camera.model_copy(update={"exposure_limits_s": (5.0, 10.0)})
    with pytest.raises(DeviceError, match=r"white reference is full at the shortest exposure, 5 s .*dim the lamp"):
        measure("run", description=describe(camera=camera))
    measure("by-pixels", description=describe(camera=camera, acquisition=Acquisition(merge="pixels", dark_frames=2)))


def test_a_point_without_frames_is_no_guide(measure: Measure) -> None:
    """The point before it is: with step 3 flagged, step 4 is metered by step 2."""
    steps = measure("run", rig=Plugin(options={"albedo": 0.02, "pushes": {3: 9}})).steps()
    assert steps[3].frames == ()
    assert metering_frames(steps[4]) == 2


@pytest.mark.parametrize("stops", [[1], [5], [1, 1, 2]])
def test_an_interrupted_run_resumes_to_the_same(measure: Measure, stops: list[int], whole: list[StepRecord]) -> None:
    before = signal.getsignal(signal.SIGINT)
    for number, after in enumerate(stops):
        rig = Plugin()
        with pytest.raises(Interrupted, match="--resume"):
            measure("cut", rig=rig, resume=bool(number), progress=StopAfter(after))
        assert rig.opened[0].log[-2:] == ["off", "park"]
    assert signal.getsignal(signal.SIGINT) is before
    run = measure("cut", resume=True)
    assert list(run.steps()) == whole
    assert [e["event"] for e in run.events()].count("interrupted") == len(stops)


def test_a_second_signal_stops_every_axis_at_once(measure: Measure, whole: list[StepRecord]) -> None:
    class Impatient(Silent):
        def step(self, live: Live) -> None:
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)

    rig = Plugin()
    with pytest.raises(Interrupted, match="at once"):
        measure("run", rig=rig, progress=Impatient())
    assert rig.opened[0].log[-3:] == ["stop", "off", "park"]
    assert list(measure("run", resume=True).steps()) == whole


def test_killed_at_any_byte_of_the_journal_it_resumes_to_the_same(
    run: Run, measure: Measure, whole: list[StepRecord]
) -> None:
    journal = run.path / "journal.jsonl"
    data = journal.read_bytes()
    ends = [at + 1 for at, byte in enumerate(data) if byte == ord("\n")]
    cuts = sorted({0, 1, *(end + d for end in (*ends[:4], *ends[-2:]) for d in (-1, 0, 1)), *range(0, len(data), 2999)})
    for cut in cuts:
        journal.write_bytes(data[:cut])
        if cut < ends[0]:  # frames, and no journal
            with pytest.raises(DataError, match="gonio run repair"):
                measure(resume=True)
            continue
        assert list(measure(resume=True).steps()) == whole
    assert len(cuts) > 20


def test_a_failing_device_is_in_the_journal_and_everything_is_dark(measure: Measure, whole: list[StepRecord]) -> None:
    rig = Plugin(options={"fails_at": 4})
    with pytest.raises(DeviceError, match="no frame came"):
        measure("run", rig=rig)
    assert rig.opened[0].log[-3:] == ["stop", "off", "park"]
    run = measure("run", resume=True)
    events = [event["event"] for event in run.events()]
    assert events[:6] == ["session", "step", "step", "step", "step", "device_error"]
    assert list(run.steps()) == whole


def test_a_swap_by_hand_needs_a_terminal_or_yes(measure: Measure, tmp_path: Path) -> None:
    laboratory = Plugin(options={"repeatable": False})
    with pytest.raises(ConfigError, match=r"swapped by hand .*--yes"):
        measure("run", rig=laboratory)  # the tests have no terminal
    assert not (tmp_path / "run").exists()
    measure("run", rig=laboratory, yes=True)


def test_a_laboratory_takes_fresh_darks_and_references(measure: Measure) -> None:
    with pytest.raises(Interrupted):
        measure("run", rig=Plugin(options={"repeatable": False}), yes=True, progress=StopAfter(4))
    run = measure("run", rig=Plugin(options={"repeatable": False}), yes=True, resume=True)
    taken = [(e["step"], e["kind"]) for e in run.events() if e["event"] == "step"]
    assert taken[5:8] == [(9, "dark"), (10, "reference"), (5, "reference")]
    assert (len(taken), len(set(taken))) == (11, 11)


def test_a_computer_s_clock_that_jumps_changes_nothing(
    measure: Measure, monkeypatch: pytest.MonkeyPatch, whole: list[StepRecord]
) -> None:
    years = iter(range(2100, 1900, -1))
    monkeypatch.setattr("gonio.lab.acquisition.journal.now", lambda: f"{next(years)}-01-01T00:00:00.000Z")
    with pytest.raises(Interrupted):
        measure("run", progress=StopAfter(4))
    run = measure("run", resume=True)
    assert list(run.steps()) == whole
    walls = [event["wall"] for event in run.events()]
    assert walls == sorted(walls, reverse=True)
    assert set(brdf.reduce(run)["flag"]) == {"", "blocked"}


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (lambda now: 0.0, r"time_s = 0\.0, and the one before it had 0\.0 s"),
        (lambda now: 7.5, r"time_s = 7\.5, and the one before it had 7\.5 s"),
        (lambda now: 5000.0 - now, r"time_s = 4999\.0, and the one before it had 5000\.0 s"),
        (lambda now: now % 400.0, r"time_s = 0\.0, and the one before it had 30\d\.0 s"),  # set back in the middle
        (lambda now: math.nan, r"time_s = nan: seconds of at least 0"),
        (lambda now: math.inf, r"time_s = inf: seconds of at least 0"),
        (lambda now: None, r"time_s = None: seconds of at least 0"),
        (lambda now: -1.0, r"time_s = -1\.0: seconds of at least 0"),
    ],
    ids=["never", "always the same", "backwards", "set back", "nan", "infinite", "none", "negative"],
)
def test_frames_whose_times_do_not_grow_end_the_run(
    measure: Measure, stamps: Callable[[float], float], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(NumpyRig, "time_s", lambda self: 100.0 * self.step + self.frame)
    rig = Plugin(options={"stamps": stamps, "repeatable": False})
    with pytest.raises(DeviceError, match=f'the camera of the rig "bench of numpy" .*{words}') as caught:
        measure("run", rig=rig, yes=True)
    assert "In the rig's driver, give each Frame the rig's time_s()" in str(caught.value)
    assert caught.value.exit_code == 3
    assert rig.opened[0].log[-3:] == ["stop", "off", "park"]


def test_a_clock_that_was_set_back_between_two_sessions(measure: Measure) -> None:
    """Times of the second session lie before those of the first; set right, the run goes on."""
    with pytest.raises(Interrupted):
        measure("run", rig=Plugin(options={"repeatable": False}), yes=True, progress=StopAfter(4))
    again: dict[str, object] = {"yes": True, "resume": True}
    for stamps in (lambda now: now - 1.9e9, lambda now: now - 3600.0):
        late = Plugin(options={"repeatable": False, "stamps": stamps})
        with pytest.raises(DeviceError, match=r"this run holds a frame of 19\d+\.0 s: .*computer's clock"):
            measure("run", rig=late, **again)
    run = measure("run", rig=Plugin(options={"repeatable": False}), **again)
    assert len([step for step in run.steps() if step.kind == "point"]) == 5
    assert np.all(np.diff([f["time_s"] for e in run.events() if e["event"] == "step" for f in e["frames"]]) > 0)
