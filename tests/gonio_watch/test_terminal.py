"""The run in the terminal says what the page says."""

import re
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from gonio_watch import watching
from gonio_watch.watching import Watched
from rich.console import Console

import gonio
from gonio.lab.acquisition.journal import encode
from gonio.lab.commands.align import Terminal
from gonio.lab.commands.progress import _Bar
from tests.command_line import says
from tests.gonio.lab.live.runs import Played
from tests.gonio_watch.test_watching import until
from tests.gonio_watch.test_worker import measuring, worked


@pytest.fixture
def ended(played: Played) -> Iterator[Watched]:
    """A run that has ended, with a point that was flagged, all values made."""
    played.lines[4] = encode(played.event(4) | {"flag": "moved"})
    played.go_on(100)
    with Watched(played.path) as watched, worked(played.path, watched.shared.folder):
        watched.wanted = True
        until(lambda: len(watched.log) == len(played.lines) and watched.stands["state"] == "ended")
        until(lambda: [band["count"] for band in watched.values.bands] == [15, 15])
        yield watched


def test_the_panel_shows_steps_values_flags_drift_and_events(ended: Watched) -> None:
    console = Console(width=110, record=True, file=None, force_terminal=False)
    with console.capture() as shown:
        console.print(watching.render(ended))
    says(
        shown.get(),
        "ended: step 24 of 24, 1 flagged",
        "[moved]",
        "since the first measurement of it",
        "1/sr",
        " ± ",
        "provisional",
        "session: a session begins: 24 steps to take",
        "camera",
    )


def test_a_step_in_a_line(ended: Watched) -> None:
    steps = [event for event in ended.events_after(0) if event["event"] == "step"]
    lines = [watching.step_line(event) for event in steps]
    assert lines[0] == "step 0: dark"
    assert lines[1].startswith("step 1: reference; ")
    point = next(event for event in steps if event["kind"] == "point")
    theta_r = point["angles_deg"][2]
    says(watching.step_line(point), f"theta_i 30, theta_r {theta_r:g}, dphi 0 deg; ", "% of full scale in")


def test_a_summary_in_a_line() -> None:
    status = {"state": "running", "done": 3, "total": 9, "left_s": 7200, "flagged": 1, "free_bytes": 5e9, "why": "so"}
    assert watching.summary(status) == "running: step 3 of 9, about 2 h 00 min left, 1 flagged, 5 GB free (so)"


def test_plain_lines_come_where_nobody_looks_and_end_with_the_run(
    ended: Watched, capsys: pytest.CaptureFixture[str]
) -> None:
    watching.show(ended)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith(f"session: a session begins: 24 steps to take (gonio {gonio.__version__})")
    assert sum("  step " in line for line in lines) == 24
    assert lines[-1].startswith("ended: step 24 of 24, 1 flagged")


@pytest.mark.parametrize("last", ["end", "interrupted", "device_error"])
def test_text_returns_where_a_run_was_over_before_or_ends_meanwhile(
    played: Played, last: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """However it came to its end: who waits for the command in a script waits for nothing else."""
    before = played.lines[:-1]
    number = len(before)
    played.lines = [*before, encode({"n": number, "event": last, "message": "so", "wall": "2026-01-02T03:04:05Z"})]
    played.go_on(number - 2)
    with measuring(played.path), Watched(played.path) as watched:
        watched.wanted = True
        shown = threading.Thread(target=watching.show, args=(watched,))
        shown.start()
        until(lambda: len(watched.log) == number - 2)
        played.go_on(3)
        shown.join(60.0)  # a hung one fails here
        assert not shown.is_alive()
    with Watched(played.path) as again:
        watching.show(again)
    word = {"end": "ended", "interrupted": "interrupted", "device_error": "failed"}[last]
    assert sum(line.startswith(f"{word}: step 24 of 24") for line in capsys.readouterr().out.splitlines()) == 2


ACTS = "name [/bold] \x1b[2J\u202e"


def test_names_act_on_no_terminal(
    ended: Watched, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kind: a name as data of a screen; control characters, a turned direction, and brackets as of rich's markup."""
    monkeypatch.setattr(watching, "event_line", lambda event: ACTS)
    monkeypatch.setattr(ended, "path", Path(f"/somewhere/{ACTS}"))
    watching.show(ended)
    Terminal(["light"]).say(ACTS)
    screen = Console(width=110, file=sys.stdout)
    screen.print(watching.render(ended))
    _Bar(screen, None).say(ACTS)
    said = capsys.readouterr()
    for text in (said.out, said.err):
        assert not {"\x1b[2J", "\u202e"} & set(re.findall("\x1b\\[2J|\u202e", text))
        assert r"name [/bold] \x1b[2J\u202e" in text
    assert said.out.count("[/bold]") >= 4  # lines, the panel's title, its events, the bar
