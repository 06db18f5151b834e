"""The health of a run: what is journalled at each step, and what pauses a run."""

import json
import math
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from gonio.errors import ConfigError, DeviceError, Interrupted
from gonio.lab.acquisition import waits
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.progress import Silent
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig import Frame, Health, Reading
from gonio.lab.rig.description import Reference
from tests.gonio.numpy_rig import SAMPLE, NumpyRig, Plugin, describe

HOT = {"quantity": "temperature", "above": 60.0, "hysteresis": 5.0}
LOCK = {"quantity": "lock", "unless": "locked"}
ROOM = {"quantity": "room_light", "above": 20.0}
"""DN/s; this rig's frames have no noise without light."""


@dataclass
class Ward(NumpyRig):
    """The rig with a health that a script says: one entry a reading of it, the last one for ever."""

    temperatures: list[float] = field(default_factory=lambda: [40.0])
    locks: list[str] = field(default_factory=lambda: ["locked"])
    room_dn: list[float] = field(default_factory=lambda: [0.0])
    """What room light adds to a frame with the lamp off."""
    asked: int = 0

    def health(self) -> Health:
        self.asked += 1
        self.log.append("health")
        temperature, lock = (said.pop(0) if len(said) > 1 else said[0] for said in (self.temperatures, self.locks))
        return Health(
            (
                Reading("light", "angle", 3.0, "deg", (-90.0, 90.0)),
                Reading("light", "temperature", temperature, "C", (-math.inf, 80.0)),
                Reading("camera", "temperature", 35.0, "C"),
                Reading("lamp", "lock", lock if self.lit else "off"),
            )
        )

    def capture(self, exposure_s: float) -> Frame:
        frame = super().capture(exposure_s)
        if not self.lit and exposure_s < 1.0:  # no dark frame is as short, and no longer than a look
            more = self.room_dn.pop(0) if len(self.room_dn) > 1 else self.room_dn[0]
            frame.mosaic[:] += int(more)
        return frame


class Told(Silent):
    """Somebody who keeps what is said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def say(self, text: str) -> None:
        self.said.append(text)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waits, "RECHECK_S", 0.0)


Measure = Callable[..., tuple[Run, list[Ward], Told]]


@pytest.fixture
def measure(plan: Plan, tmp_path: Path) -> Measure:
    def go(
        out: str,
        rules: dict[str, object] | None = None,
        *,
        resume: bool = False,
        progress: Told | None = None,
        changes: dict[str, object] | None = None,
        **options: object,
    ) -> tuple[Run, list[Ward], Told]:
        told, rig = progress or Told(), Plugin(options=options, kind=Ward)
        choice = RigChoice(rig, describe(suspend=rules or {}, **(changes or {})), "numpy")
        run = carry_out(plan, choice, tmp_path / out, sample=SAMPLE, seed=1, resume=resume, progress=told, yes=True)
        return run, rig.opened, told

    return go


def kinds(run: Run) -> list[str]:
    return [event["event"] for event in run.events()]


def frames(run: Run) -> list[tuple[object, ...]]:
    """What was taken; a frame's own file holds the health too, and has another checksum by it."""
    return [(s.step, s.pose, s.flag, [(f.file, f.exposure_s, f.time_s) for f in s.frames]) for s in run.steps()]


# ---- the journal ----


def test_every_step_says_how_the_devices_were_and_no_angle_twice(measure: Measure) -> None:
    run, _, _ = measure("run", temperatures=[40.0 + k for k in range(30)])
    for k, step in enumerate(run.steps()):
        assert step.health == (
            Reading("light", "temperature", 40.0 + k, "C"),
            Reading("camera", "temperature", 35.0, "C"),
            Reading("lamp", "lock", "off" if step.kind == "dark" else "locked"),
        )
        assert StepRecord.from_json(json.loads(json.dumps(step.to_json()))) == step


def test_a_number_that_is_none_is_a_word_in_the_journal(measure: Measure) -> None:
    run, _, _ = measure("run", temperatures=[math.nan])
    assert {step.health[0].value for step in run.steps()} == {"nan"}


# ---- waiting ----


@pytest.mark.parametrize(("name", "rule"), [("hot", HOT), ("unlocked", LOCK)])
def test_a_run_waits_until_it_is_well_again_and_takes_the_point_anew(
    measure: Measure, name: str, rule: dict[str, object]
) -> None:
    # at the start, in the dark, at a reference, at a point; then 2 readings of the wait, the second inside
    script: dict[str, object] = {"temperatures": [40.0] * 5 + [61.0, 58.0, 54.0, 50.0]}
    if name == "unlocked":
        script = {"locks": ["locked"] * 5 + ["searching", "searching", "locked"]}
    run, _, told = measure("run", {name: rule}, **script)
    assert frames(run) == frames(measure("whole")[0])
    events = list(run.events())
    (paused,) = (e for e in events if e["event"] == "suspended")
    (back,) = (e for e in events if e["event"] == "continued")
    assert paused["rule"] == name
    assert paused["step"] == back["step"] == 3 if name == "hot" else True
    assert f"suspend.{name}: " in paused["message"]
    assert [text.partition(",")[0] for text in told.said] == [
        "waiting",
        f"going on after 0 s; step {back['step']} is taken again",
    ]
    assert paused["message"] in told.said[0]
    assert [e["step"] for e in events if e["event"] == "step"] == list(range(9))


def test_a_laboratory_visits_the_reference_after_a_pause_and_the_table_is_right(measure: Measure) -> None:
    changes = {"reference": Reference(every=3, frames=2, how="axis")}
    run, _, _ = measure(
        "run", {"hot": HOT}, temperatures=[40.0] * 6 + [61.0, 54.0, 50.0], changes=changes, repeatable=False
    )
    events = [(e["event"], e.get("step")) for e in run.events() if e["event"] != "session"]
    at = events.index(("suspended", 4))
    assert events[at : at + 4] == [("suspended", 4), ("continued", 4), ("step", 9), ("step", 4)]
    assert run.steps()[9].kind == "reference"
    whole, _, _ = measure("whole", changes=changes, repeatable=False)
    got, wanted = (brdf.reduce(one)["brdf"].dropna().to_numpy() for one in (run, whole))
    assert len(got) == 10
    assert got == pytest.approx(wanted, rel=5e-3)  # the visit has photon noise of its own, 0.1 % of its mean


def test_the_lamp_is_dark_while_it_waits_where_that_is_asked_for(measure: Measure) -> None:
    for dark in (False, True):
        run, (rig,), _ = measure(f"run-{dark}", {"hot": HOT | {"dark": dark}}, temperatures=[40.0] * 5 + [61.0, 50.0])
        hot = [k for k, entry in enumerate(rig.log) if entry == "health"][5]
        assert rig.log[hot + 1] == ("off" if dark else "health")
        assert frames(run) == frames(measure(f"whole-{dark}")[0])


def test_light_in_the_room_pauses_the_run(measure: Measure) -> None:
    run, _, _ = measure("run", {"room": ROOM}, room_dn=[0.0] * 3 + [40.0, 30.0, 0.0])
    assert kinds(run).count("suspended") == kinds(run).count("continued") == 1
    assert [s.step for s in run.steps()] == list(range(9))
    assert {r.value for s in run.steps() for r in s.health if r.quantity == "room_light"} == {0.0}
    kept = [[f for f in s.frames] for s in run.steps()]
    assert [len(f) for f in kept] == [len(s.frames) for s in measure("whole")[0].steps()]


class Presses(Told):
    """A user who presses Ctrl-C when the run begins to wait."""

    def say(self, text: str) -> None:
        super().say(text)
        if text.startswith("waiting"):
            signal.raise_signal(signal.SIGINT)


def test_ctrl_c_ends_the_wait_and_the_run_goes_on_later(measure: Measure, tmp_path: Path) -> None:
    script = [40.0] * 5 + [61.0]
    with pytest.raises(Interrupted, match=r"while waiting \(suspend.hot: .*after 3 of 9 steps; .*--resume"):
        measure("run", {"hot": HOT}, temperatures=script, progress=Presses())
    assert not list((tmp_path / "run" / "frames").glob("000003-red650-03.dng"))  # no frame claims a step that is none
    run, _, _ = measure("run", {"hot": HOT}, resume=True, temperatures=[62.0, 61.0, 50.0])  # still hot at the start
    assert frames(run) == frames(measure("whole")[0])
    assert kinds(run).count("suspended") == 2


def test_what_does_not_come_back_ends_the_run_which_can_be_resumed(measure: Measure) -> None:
    rule = HOT | {"longest_s": 1e-6}
    with pytest.raises(DeviceError, match=r"suspend.hot: light temperature is 61 C.*longest_s = 1e-06 s.*--resume"):
        measure("run", {"hot": rule}, temperatures=[40.0] * 5 + [61.0])
    run, _, _ = measure("run", {"hot": HOT}, resume=True)  # and with another rule
    assert frames(run) == frames(measure("whole")[0])


# ---- rules ----


@pytest.mark.parametrize(
    ("rule", "says"),
    [
        ({"quantity": "pressure", "above": 1}, 'suspend.x: quantity = "pressure" is not read.*"light" temperature'),
        ({"quantity": "temperature", "device": "tilt", "above": 1}, 'of device = "tilt" is not read'),
    ],
)
def test_a_rule_about_what_nobody_reads_is_refused_before_anything_is_measured(
    measure: Measure, tmp_path: Path, rule: dict[str, object], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        measure("run", {"x": rule})
    assert not (tmp_path / "run" / "journal.jsonl").read_bytes()
