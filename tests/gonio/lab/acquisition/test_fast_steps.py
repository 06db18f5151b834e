"""Steps that come faster than the disk takes them one by one: fewer syncs, the same record, nothing lost."""

import json
import os
import signal
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.lab.acquisition import commits
from gonio.lab.acquisition.journal import Events
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan, load_plan
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.repair import find_damage
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Frame, Step
from gonio.lab.rig.description import Acquisition, Reference
from gonio.lab.rig.light_and_camera import Bands
from tests.gonio.numpy_rig import BANDS, SAMPLE, NumpyRig, Plugin, describe

POINTS = 240


@dataclass
class Instant(NumpyRig):
    """A camera that takes no time: every frame is the same. The process dies in a step, if asked."""

    dies_at: int = -1
    _mosaic: np.ndarray = field(default_factory=lambda: np.full((48, 64), 2300, dtype=np.uint16))

    def begin(self, step: Step) -> None:
        super().begin(step)
        if step.index == self.dies_at:
            os.kill(os.getpid(), signal.SIGKILL)

    def capture(self, exposure_s: float) -> Frame:
        camera = self.description.camera
        time_s, self.frame = self.time_s(), self.frame + 1
        return Frame(self._mosaic, exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=time_s)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    tmp_path = tmp_path_factory.mktemp("plan")
    (tmp_path / "plan.toml").write_text(
        'name = "many"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [20]\n'
        f"theta_r_deg = {[round(30 + 0.1 * k, 3) for k in range(POINTS)]}\n"
    )
    return load_plan(tmp_path / "plan.toml")


def measure(plan: Plan, out: Path, *, dies_at: int = -1, resume: bool = False) -> Run:
    description = describe(
        bands=Bands(list=BANDS[:1]),
        reference=Reference(every=100, frames=2),
        acquisition=Acquisition(frames=1, dark_frames=2, roi_radius_mm=3.0),
    )
    rig = Plugin(options={"dies_at": dies_at}, kind=Instant)
    return carry_out(plan, RigChoice(rig, description, "instant"), out, sample=SAMPLE, resume=resume)


@pytest.fixture(scope="module")
def steps(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> list[StepRecord]:
    """Those of the whole run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("secrets.token_hex", lambda size: "1d" * size)
        patch.setattr("os.fsync", lambda descriptor: None)
        return list(measure(plan, tmp_path_factory.mktemp("whole") / "run").steps())


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often the journal and other files were synced, and the journal was read."""
    counts: Counter[str] = Counter()
    opened = Events._open

    def sync(descriptor: int) -> None:
        counts["journal" if os.readlink(f"/proc/self/fd/{descriptor}").endswith("journal.jsonl") else "others"] += 1

    def read(events: Events) -> object:
        counts["read"] += 1
        return opened(events)

    monkeypatch.setattr("os.fsync", sync)
    monkeypatch.setattr(Events, "_open", read)
    return counts


def test_fast_steps_share_their_syncs_and_the_record_is_the_same(
    plan: Plan, tmp_path: Path, counted: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commits, "FAST_STEP_S", 10.0)  # every machine is fast enough
    together = measure(plan, tmp_path / "together")
    fast = Counter(counted)
    counted.clear()
    monkeypatch.setattr(commits, "FAST_STEP_S", 0.0)
    assert list(together.steps()) == list(measure(plan, tmp_path / "single").steps())
    assert len(together.steps()) == POINTS + 5  # a dark, and visits before, after 100, after 200 and at the end
    assert counted["journal"] >= POINTS
    # 64 steps show the pace; then the clock decides, and a machine that is busy needs more than a few
    assert fast["journal"] < commits.PACE_STEPS + (POINTS - commits.PACE_STEPS) / 2
    assert fast["others"] <= counted["others"]
    assert fast["read"] < 20, "the journal is not read again at every step"


def test_a_kill_among_fast_steps_loses_nothing_that_was_journalled(
    plan: Plan, steps: list[StepRecord], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commits, "FAST_STEP_S", 10.0)
    monkeypatch.setattr(commits, "TOGETHER_S", 0.01)
    child = os.fork()
    if child == 0:
        try:
            measure(plan, tmp_path / "cut", dies_at=200)
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    before = list(Run.open(tmp_path / "cut").steps())
    assert len(before) >= commits.PACE_STEPS
    run = measure(plan, tmp_path / "cut", resume=True)
    assert list(run.steps())[: len(before)] == before
    assert list(run.steps()) == steps
    named = {frame.file for step in run.steps() for frame in step.frames}
    assert {path.name for path in (run.path / "frames").iterdir()} == named


def test_no_frame_has_its_name_before_it_is_on_the_disk_nor_a_line_before_that(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commits, "FAST_STEP_S", 10.0)
    synced, named, told = set[int](), dict[str, int](), list[str]()
    replace, append_all = os.replace, Run.append_all

    def renames(source: str | Path, target: str | Path) -> None:
        if os.path.basename(os.path.dirname(target)) == "frames":
            named[os.path.basename(target)] = os.stat(source).st_ino
            assert named[os.path.basename(target)] in synced, "named before it was synced"
        replace(source, target)

    def appends(run: Run, events: Sequence[str]) -> None:
        for event in events:
            told.extend(frame["file"] for frame in json.loads(event)["frames"])
        assert named.keys() >= set(told), "journalled before it was named"
        assert folder in synced, "journalled before the folder was synced"
        synced.discard(folder)
        append_all(run, events)

    monkeypatch.setattr("os.fsync", lambda descriptor: synced.add(os.fstat(descriptor).st_ino))
    monkeypatch.setattr("os.replace", renames)
    monkeypatch.setattr(Run, "append_all", appends)
    (tmp_path / "run" / "frames").mkdir(parents=True)
    folder = (tmp_path / "run" / "frames").stat().st_ino
    run = measure(plan, tmp_path / "run")
    assert sorted(told) == sorted(path.name for path in (run.path / "frames").iterdir())
    assert len(told) == 2 * POINTS + 2 * 4 + 4


@pytest.mark.parametrize("at", [100, 480])
def test_a_disk_that_fails_among_fast_steps_leaves_no_line_without_its_frames(
    plan: Plan, steps: list[StepRecord], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    monkeypatch.setattr(commits, "FAST_STEP_S", 10.0)
    synced = count(1)  # by several threads

    def fails(descriptor: int) -> None:
        if os.readlink(f"/proc/self/fd/{descriptor}").endswith(".new") and next(synced) == at:
            raise OSError(5, "Input/output error")

    with monkeypatch.context() as broken:
        broken.setattr("os.fsync", fails)
        with pytest.raises(DataError, match="Input/output error"):
            measure(plan, tmp_path / "cut")
    cut = Run.open(tmp_path / "cut")
    assert not find_damage(cut, whole=True).damaged
    assert not [path for path in (cut.path / "frames").iterdir() if path.name.endswith(".new")]
    assert list(measure(plan, tmp_path / "cut", resume=True).steps()) == steps
