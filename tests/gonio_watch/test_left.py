"""How long the rest takes is learnt from the journal's lines, as who measures learns it."""

import pytest
from gonio_watch import worker as module
from gonio_watch.worker import Left

from gonio.lab.acquisition.progress import Remaining
from gonio.lab.acquisition.run import Run
from tests.command_line import some
from tests.gonio.lab.live.runs import Played


def fed(left: Left, played: Played, lines: range) -> None:
    for event in map(played.event, lines):
        left.take(event, 2.0 if event["event"] == "step" else None)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "LEFT_S", 0.0)


def test_nobody_knows_before_a_step_was_taken(played: Played) -> None:
    played.go_on(1)
    left = Left(played.path)
    fed(left, played, range(1))
    assert left.now() is None


def test_the_rest_takes_as_long_as_steps_like_it_did(played: Played) -> None:
    played.go_on(10)
    left = Left(played.path)
    fed(left, played, range(10))
    assert some(left.now()).seconds == pytest.approx(2.0 * (24 - 9), rel=1e-9), "every step took 2 s"
    played.go_on(5)
    fed(left, played, range(10, 15))
    assert some(left.now()).seconds == pytest.approx(2.0 * (24 - 14), rel=1e-9)


def test_it_is_what_who_measures_is_told(played: Played) -> None:
    played.go_on(12)
    left = Left(played.path)
    fed(left, played, range(12))
    run = Run.open(played.path)
    theirs = Remaining.of_run(run)
    for record in run.steps():
        theirs.took(record, 2.0)
    assert left.now() == theirs.left


def test_a_run_that_cannot_be_read_has_no_end_in_sight(played: Played) -> None:
    played.go_on(5)
    (played.path / "run.toml").write_text("not = [toml")
    left = Left(played.path)
    fed(left, played, range(5))
    assert left.now() is None
