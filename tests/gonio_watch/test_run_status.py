"""What is said of a run follows from its journal."""

import datetime
from typing import Any

import pytest
from gonio_watch.run_status import KEPT, RunStatus, ago, is_one_of_many, reasons, said, seconds, shortened

from gonio.lab.acquisition.journal import Event

BEGAN = 1_800_000_000.0


def wall(at: float) -> str:
    return datetime.datetime.fromtimestamp(BEGAN + at, datetime.UTC).isoformat().replace("+00:00", "Z")


class Told:
    """A journal in the making."""

    def __init__(self) -> None:
        self.run_status = RunStatus(every=3, angles_deg=[[30.0, 0.0, 10.0, 180.0]] * 6)
        self.n = 0

    def take(self, name: str, at: float, **values: Any) -> dict[str, Any]:
        event: Event = {"n": self.n, "event": name, **values, "wall": wall(at)}
        self.n += 1
        return self.run_status.take(event)

    def step(self, number: int, at: float, kind: str = "point", **values: Any) -> dict[str, Any]:
        point = number - 2 if kind == "point" else None
        lit = kind != "dark"
        frames = [{"file": f"{number}.dng", "band": "green", "exposure_s": 0.5, "lamp": lit, "bytes": 1000}]
        rest = {"point": point, "pose": {"light": 0.5}, "flag": "", "level_per_s": {"green": 1.2}, "frames": frames}
        return self.take("step", at, step=number, kind=kind, **(rest | values))


@pytest.fixture
def told() -> Told:
    out = Told()
    out.take("session", 0.0, steps=10, left=10, gonio="1")
    out.step(0, 20.0, "dark")
    out.step(1, 24.0, "reference")
    for number in (2, 3, 4):
        out.step(number, 24.0 + 4.0 * (number - 1))
    return out


def test_steps_are_counted_and_the_rest_takes_as_long_as_the_last_ones(told: Told) -> None:
    assert (len(told.run_status.done), told.run_status.total) == (5, 10)
    assert told.run_status.step_s == pytest.approx(4.0), "from the start to the first line everything is opened"
    assert told.run_status.state(BEGAN + 40.0, True) == ("running", "")
    assert told.run_status.bytes_left == pytest.approx(5000.0)


def test_a_step_says_what_a_page_shows(told: Told) -> None:
    event = told.step(5, 40.0, health=[["camera", "temperature", 31.25, "C"], ["lamp", "state", "on", ""]])
    assert event["angles_deg"] == [30.0, 0.0, 10.0, 180.0]
    assert event["pose_deg"] == {"light": pytest.approx(28.64789)}
    assert (event["level"], event["exposure_s"]) == (pytest.approx(0.6), 0.5)
    assert event["health"] == [["camera", "temperature", 31.25, "C"], ["lamp", "state", "on", ""]]
    assert told.run_status.last_shown is not None
    assert (told.run_status.last_shown[0], told.run_status.last_shown[1]["step"]) == ("5.dng", 5)
    dim = {"file": "6b.dng", "band": "blue", "exposure_s": 4.0, "lamp": True, "bytes": 1000}
    both = told.step(
        6, 44.0, level_per_s={"green": 1.2, "blue": 0.1}, frames=[{**dim, "band": "green", "exposure_s": 0.5}, dim]
    )
    assert (both["level"], both["exposure_s"]) == (pytest.approx(0.6), 4.0), "each band by its own exposure"


def test_a_pause_has_its_reason_and_does_not_count_as_a_step(told: Told) -> None:
    told.take("suspended", 50.0, rule="hot", message="camera is at 61 C")
    assert told.run_status.state(BEGAN + 900.0, True) == ("suspended", "camera is at 61 C")
    told.take("continued", 1000.0, waited_s=950.0)
    assert told.run_status.state(BEGAN + 1001.0, True) == ("running", "")
    told.step(5, 1010.0)
    assert told.run_status.step_s == pytest.approx(4.0)


def test_a_person_who_pauses_is_told_from_a_rule(told: Told) -> None:
    told.take("paused", 50.0, message="by the operator")
    assert told.run_status.state(BEGAN + 51.0, True) == ("paused", "by the operator")


def test_the_end_and_what_ends_early(told: Told) -> None:
    told.take("interrupted", 60.0, message="stopped after 5 of 10 steps")
    assert told.run_status.state(BEGAN + 1e6, False) == ("interrupted", "stopped after 5 of 10 steps")
    told.take("session", 90.0, steps=10, left=5)
    assert told.run_status.state(BEGAN + 91.0, True) == ("running", "")
    assert told.run_status.total == 10
    told.take("device_error", 95.0, message="the camera is gone")
    assert told.run_status.state(BEGAN + 96.0, True) == ("failed", "the camera is gone")
    told.take("end", 99.0, steps=10)
    assert told.run_status.state(BEGAN + 1e6, None) == ("ended", "")
    assert [session.steps for session in told.run_status.sessions] == [5, 0]


def test_a_process_that_is_gone_is_said_at_once_where_it_can_be_told(told: Told) -> None:
    state, why = told.run_status.state(BEGAN + 60.0, False)
    assert (state, "--resume goes on" in why) == ("died", True)
    assert told.run_status.state(BEGAN + 60.0, None) == ("running", ""), "a step may take so long"
    assert told.run_status.state(BEGAN + 400.0, None)[0] == "silent"
    assert told.run_status.state(BEGAN + 400.0, True) == ("running", "nothing was written for 6 min")


def test_a_run_grows_by_what_is_chosen(told: Told) -> None:
    points = [[30.0, 0.0, float(k), 180.0] for k in range(4)]
    event = told.take("chosen", 50.0, first_step=10, points=points, why={"sigma": 0.01234, "curve": "theta_i 30"})
    assert told.run_status.total == 10 + 4 + 2, (
        "a measurement of the reference after three points, and one after the last"
    )
    assert event["text"] == "4 points more, from step 10 on"
    assert event["why"] == ["sigma: 0.01234", "curve: theta_i 30"]
    assert event["points_deg"] == points
    assert told.step(10, 60.0, point=8)["angles_deg"] == points[2]


def test_why_points_were_chosen_is_said_in_words() -> None:
    curve = {"spent_s": 831.0, "values": 19, "u_rel": 0.117, "misfit": 1.27, "kernel": [[-1.9, -3.4]], "batch_s": 32.0}
    assert reasons(curve) == [
        *("rig time so far: 14 min", "values so far: 19", "relative uncertainty, at worst: 12 %"),
        *("scatter over what was expected: 1.27", "rig time of these: 32 s"),
    ]
    fit = {"fit": {"sigma0_um": 0.279972, "tau_um": 1.76947}, "u": {"sigma0_um": 0.00084}, "mode": "parameters"}
    assert reasons(fit) == ["sigma0_um: 0.27997 ± 0.00084", "tau_um: 1.769", "mode: parameters"]
    assert reasons("so") == ["so"]
    assert reasons(None) == reasons({}) == []
    met = {"event": "enough", "met": True, "message": "enough: curve known to 1 %", "why": curve}
    assert said(met) == "the target is reached: curve known to 1 %"


def test_steps_that_are_taken_back_are_left_again(told: Told) -> None:
    before = told.run_status.points
    told.take("lost", 50.0, steps=[3, 4], frames=["3.dng is missing"])
    assert sorted(told.run_status.done) == [0, 1, 2]
    assert told.run_status.points == before - 2
    told.step(3, 60.0)
    told.step(3, 61.0)
    assert told.run_status.points == before - 1, "a step counts once"


def test_of_very_many_steps_the_least_is_told_and_of_flagged_ones_and_some_others_all() -> None:
    long_ago = {"event": "step", "step": 7, "kind": "point", "point": 6, "flag": "", "wall": wall(0.0), "frames": []}
    assert shortened(long_ago | {"n": 8}) == {"n": 8, "event": "step", "step": 7, "kind": "point", "point": 6}
    assert is_one_of_many(long_ago | {"n": 8})
    assert not is_one_of_many(long_ago | {"n": KEPT})
    assert not is_one_of_many(long_ago | {"n": 8, "flag": "moved"})
    assert not is_one_of_many(long_ago | {"n": 8, "event": "suspended"})
    run_status = RunStatus()
    assert run_status.take(long_ago | {"n": 8}, short=True) == shortened(long_ago | {"n": 8})
    assert run_status.points == 1


def test_an_event_that_nobody_knows_says_what_it_holds() -> None:
    event = {"n": 3, "event": "retry", "kind": "camera", "attempt": 2, "wait_s": 1.5, "wall": "x", "crc": "y"}
    assert said(event) == "kind camera, attempt 2, wait s 1.5"
    assert said({"event": "remark", "message": "the arm was pushed"}) == "the arm was pushed"
    assert said({"event": "new", "list": list(range(50))}).endswith("11 ...")


@pytest.mark.parametrize(
    ("length", "words"), [(3.0, "3 s"), (600.0, "10 min"), (12000.0, "3 h 20 min"), (200_000.0, "2 d 7 h")]
)
def test_durations(length: float, words: str) -> None:
    assert ago(length) == words


def test_a_time_that_is_none_is_the_beginning_of_time() -> None:
    assert seconds("yesterday") == seconds(None) == 0.0
    assert seconds(wall(5.0)) == BEGAN + 5.0


def test_visits_and_steps_stand_at_the_rig_s_time(told: Told) -> None:
    """A simulated hour passes in a second, and a run may rest for days: neither is the lamp's time."""
    told.step(5, 41.0, "reference", time_s=1810.0)
    told.take("session", 86_000.0, steps=10, left=4, gonio="1")
    event = told.step(6, 86_001.0, "reference", time_s=3620.5)
    assert told.run_status.visits_s == {1: 0.0, 5: 1810.0, 6: 3620.5}
    assert event["time_s"] == 3620.5
    assert told.step(7, 86_002.0, time_s="soon")["time_s"] == 0.0
