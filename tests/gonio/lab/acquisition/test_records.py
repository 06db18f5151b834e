"""What a journal says of a step: typed values whose JSON comes back to the byte."""

import json
import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.errors import DataError
from gonio.lab.acquisition.frame_writer import Files, Store
from gonio.lab.acquisition.journal import Index, Journal, decode, encode
from gonio.lab.acquisition.records import FrameFile, FrameLabel, FrameRecord, StepRecord
from gonio.lab.rig import Frame, Pose, Step

# a line as runs hold it from before records were typed
LINE = (
    b'{"n":3,"event":"step","step":2,"kind":"point","point":0,"time_s":27.25,'
    b'"goal":{"light":-0.35,"camera":0.35,"tilt":0.0,"spin":0.0,"azimuth":0.0},'
    b'"pose":{"light":-0.349,"camera":0.351,"tilt":0.0,"spin":0.0,"azimuth":0.0},"pose_time_s":27.0,'
    b'"pose_after":{"light":-0.349,"camera":0.351,"tilt":0.0,"spin":0.0,"azimuth":0.0},"pose_after_time_s":29.5,'
    b'"level_per_s":{"550 nm":0.7},"flag":"","frames":[{"file":"000002-550nm-01.dng","band":"550 nm",'
    b'"exposure_s":1.0,"time_s":27.25,"lamp":true,"sha256":"ab","bytes":12}],"wall":"2026-11-20T10:00:00.000Z"'
)

numbers = st.floats(allow_nan=False, allow_infinity=False)
text = st.text(max_size=8)
poses = st.builds(Pose, numbers, numbers, numbers, numbers, numbers)
frames = st.builds(
    FrameRecord,
    text,
    text,
    numbers,
    numbers,
    st.booleans(),
    st.none() | text,
    st.none() | st.integers(0, 2**40),
    st.none() | numbers,
)
# the readback after the frames and the levels stand in a record together, or not at all
afters = st.none() | st.tuples(poses, numbers, st.dictionaries(text, numbers), st.none() | poses)


@st.composite
def records(draw: st.DrawFn) -> StepRecord:
    after = draw(afters) or (None, None, None, None)
    return StepRecord(
        step=draw(st.integers(0)), kind=draw(st.sampled_from(["dark", "reference", "point"])),
        point=draw(st.none() | st.integers(0)), time_s=draw(numbers), goal=draw(poses), pose=draw(poses),
        pose_time_s=draw(st.none() | numbers), flag=draw(text), frames=tuple(draw(st.lists(frames, max_size=3))),
        pose_after=after[0], pose_after_time_s=after[1], level_per_s=after[2], pose_spread=after[3],
    )  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(records())
def test_a_step_comes_back_from_its_json(record: StepRecord) -> None:
    written = json.dumps(record.to_json())
    assert StepRecord.from_json(json.loads(written)) == record
    assert json.dumps(StepRecord.from_json(json.loads(written)).to_json()) == written


@settings(max_examples=40, deadline=None)
@given(text, frames, poses, records(), st.booleans())
def test_a_label_comes_back_from_its_json(
    run: str, frame: FrameRecord, pose: Pose, step: StepRecord, last: bool
) -> None:
    dark = FrameLabel(
        run=run, step=0, kind="dark", point=None, number=1, count=8, frame=frame, record=step if last else None
    )
    for label in (dark, replace(dark, kind="point", point=3, goal=pose, pose=pose, pose_time_s=0.5)):
        assert FrameLabel.from_json(json.loads(json.dumps(label.to_json()))) == label


@settings(max_examples=40, deadline=None)
@given(records(), st.lists(st.builds(FrameFile, text, st.integers(0, 2**40)), max_size=3))
def test_the_text_is_that_of_an_encoder_of_json(record: StepRecord, files: list[FrameFile]) -> None:
    told = record.stored(files[: len(record.frames)]).text()
    assert told == json.dumps(json.loads(told), separators=(",", ":"))


def test_every_pose_is_written_with_its_own_digits() -> None:
    base = StepRecord(step=1, kind="point", point=0, time_s=1.0, goal=Pose(), pose=Pose(), flag="", frames=())
    for values, told in (
        ((0.0,), "0.0"), ((-0.0,), "-0.0"), ((0,), "0"), ((np.float64(0.1),), "0.1"), ((1e-7,), "1e-07"),
    ):  # fmt: skip
        assert f'"goal":{{"light":{told},"camera"' in replace(base, goal=Pose(*values)).text()
    for number in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            replace(base, pose=Pose(0.1, number)).text()
        with pytest.raises(ValueError, match="not JSON compliant"):
            replace(base, time_s=number).text()


def test_a_line_of_an_older_journal_is_read_and_written_to_the_byte() -> None:
    import zlib

    line = LINE + b',"crc":"%08x"}\n' % zlib.crc32(LINE)
    event = decode(line, 3)
    assert event is not None
    record = StepRecord.from_json(event)
    assert (record.frames[0].exposure_s, record.pose) == (1.0, Pose(-0.349, 0.351))
    assert encode({"n": 3, **record.to_json(), "wall": event["wall"]}) == line


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("frames", None, 'has no "frames"'),
        ("goal", {"light": 0, "camera": 0, "lihgt": 0}, "cannot be understood.*lihgt"),
        ("frames", [{"file": "000002-a-01.dng"}], 'has no "frames.0.band"'),
    ],
)
def test_a_step_that_says_too_little_is_named(tmp_path: Path, key: str, value: object, message: str) -> None:
    event = json.loads(LINE + b"}") | {key: value}
    if value is None:
        del event[key]
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append({name: value for name, value in event.items() if name not in ("n", "wall")})
    with pytest.raises(DataError, match=rf"journal.jsonl: line 1 is whole.*the record of a step {message}"):
        Index().go_on(journal.events)


# ---- what a frame's label says does not depend on when the thread that writes it comes to it ----


FRAME = Frame(np.full((48, 64), 100, dtype=np.uint16), 0.1, 64.0, 4095.0, time_s=1.0)


class Later(Store):
    """A thread that comes to its frames when the step is over."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.labels: list[Callable[[str], str]] = []

    def put(self, frame: Frame, name: str, label: Callable[[str], str]) -> Future[FrameFile]:
        self.labels.append(label)
        return Future()


def test_a_band_that_is_planned_later_does_not_change_the_labels_of_the_one_before(tmp_path: Path) -> None:
    store = Later(tmp_path)
    files = Files(store, Step(3, "point", 1, Pose()), "run", 0, Pose(), 1.0)
    for count in (2, 3):  # a bracket for each of two bands
        files.count += count
        for _ in range(count):
            files.keep(FRAME, "band", "band", lamp=True)
    # four are with the thread by now, the fifth waits for the step's record; the first was put before band two was
    # planned, the second when its first frame came
    assert [json.loads(label("ab"))["of"] for label in store.labels] == [2, 5, 5, 5]
    store.close()
