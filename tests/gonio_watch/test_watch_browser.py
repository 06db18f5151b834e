"""The page of `gonio watch` in a real browser: what it shows, how soon, and what it does when its server goes."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_watch.serving import ServedRun

from gonio.lab.acquisition import repair
from gonio.lab.acquisition.journal import encode
from gonio.lab.acquisition.run import Run
from gonio.lab.live.server import Server
from tests.browser import CHROMIUM, Page
from tests.gonio.lab.live.runs import Played, measured

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not opened"),
]

SERVER = "document.getElementById('server').className"


@pytest.fixture(autouse=True)
def state_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What watchers keep lies in no folder that outlives a test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return measured(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def page(tab: Page) -> Iterator[Page]:
    tab.complaints.clear()
    first = tab._session
    assert first is not None
    yield tab
    tab.to_tab(first)
    tab.send("Page.navigate", url="about:blank")
    # a page that looks for its server while there is none is refused: the browser says so where that takes long
    assert [said for said in tab.complaints if "net::ERR_CONNECTION_REFUSED" not in said] == []


@pytest.fixture
def played(whole: Path, tmp_path: Path) -> Iterator[Played]:
    """A run that this process measures: it holds the journal."""
    run = Played(whole, tmp_path / "run")
    run.append(b"")
    with open(run.path / "journal.jsonl", "ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield run


@contextmanager
def served(run: Path, like: Server | None = None) -> Iterator[Server]:
    """The page of a run; at the address of an earlier one."""
    shown = ServedRun(run)
    port, token = (0, None) if like is None else (like.port, like.token)
    with Server(shown.routes, shown.watched.log, port=port, token=token) as server, shown.watched:
        yield server


def says(page: Page, name: str) -> str:
    return page.run(f"document.getElementById('{name}').textContent")


def has(page: Page, name: str, text: str) -> None:
    page.until(f"document.getElementById('{name}').textContent.includes({json.dumps(text)})")


def taken(page: Page, lines: int) -> None:
    """Wait until the page has so many lines of the journal, each of them once."""
    page.until(f"window.gonioWatch?.last === {lines}")


def test_a_run_is_waited_for_and_shown_as_it_is_measured(page: Page, played: Played) -> None:
    with served(played.path) as server:
        page.open(server.address, 1280)
        has(page, "state", "waiting")
        at = page.run("document.querySelector('.beside').getBoundingClientRect().top")
        played.go_on(3)  # a session, the dark and the reference
        has(page, "done", "2")
        has(page, "state", "running")
        assert says(page, "total") == "24"
        played.go_on(4)
        has(page, "done", "6")
        assert page.run("document.querySelector('.beside').getBoundingClientRect().top") == at, "nothing jumps"
        page.until("document.querySelectorAll('#curves .stage g > [transform]').length > 0")
        page.until("!document.getElementById('frame').hidden && document.getElementById('frame').naturalWidth === 64")
        played.go_on(100)
        has(page, "state", "ended")
        taken(page, len(played.lines))
        assert page.run("gonioWatch.steps") == 24
        page.until("document.querySelectorAll('#curves .stage g > [transform]').length === 12")
        page.until("document.querySelectorAll('#map circle[stroke]').length === 10")  # of one angle of incidence
        named = page.run("[...document.querySelectorAll('#axes span')].map((n) => n.textContent).join()")
        assert named.split(",") == list(Run.open(played.path).description.axes()), "no axis that the rig lacks"
        events = [json.loads(line) for line in played.lines]
        visits = np.array([e["time_s"] for e in events if e.get("kind") == "reference"])
        page.until(f"document.querySelectorAll('#drift circle').length >= {len(visits)}")
        drawn = page.run("[...document.querySelectorAll('#drift circle')].map((c) => Number(c.getAttribute('cx')))")
        drawn = drawn[: len(visits)]  # the first band's; the others' come after it
        share = (np.array(drawn) - drawn[0]) / (drawn[-1] - drawn[0])
        # the rig's time, whatever the clock on the wall said; numbers of the page have a dozen digits
        np.testing.assert_allclose(share, (visits - visits[0]) / (visits[-1] - visits[0]), atol=1e-6)


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_the_window(page: Page, played: Played, width: int, scheme: str) -> None:
    played.go_on(100)
    page.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    with served(played.path) as server:
        page.open(server.address, width)
        page.until("document.querySelector('#curves .stage svg') !== null")
        assert page.run("document.documentElement.scrollWidth") <= width
        back = page.run("getComputedStyle(document.body).backgroundColor")
        assert (int(back[4:].split(",")[0]) < 100) == (scheme == "dark")
    page.send("Emulation.setEmulatedMedia", features=[])


def test_what_was_flagged_paused_chosen_and_never_heard_of_is_told_as_text(page: Page, played: Played) -> None:
    hostile = "<img src=x onerror=alert(1)>"
    played.go_on(6)
    step = json.loads(played.lines[6])
    step = {key: value for key, value in step.items() if key != "crc"} | {"flag": "moved", "frames": []}
    events: list[dict[str, Any]] = [
        step,
        {"event": "retry", "fault": hostile, "attempt": 2},
        {"event": "chosen", "first_step": 24, "points": [[30, 0, 12.5, 180]], "why": {"expected_gain": 0.25}},
        {"event": "suspended", "rule": "hot", "message": "camera is at 61 C", "step": 7},
    ]
    played.append(
        b"".join(encode(event | {"n": 6 + k, "wall": "2026-01-01T00:00:00Z"}) for k, event in enumerate(events))
    )
    with served(played.path) as server:
        page.open(server.address, 1280)
        has(page, "state", "suspended")
        has(page, "why", "camera is at 61 C")
        has(page, "flags", "moved")
        has(page, "events", f"fault {hostile}, attempt 2")
        has(page, "events", "expected gain: 0.25")
        assert says(page, "total") == "26", "the point that was chosen, and a visit after it"
        assert page.run("document.querySelectorAll('#events img').length") == 0


def test_a_page_goes_on_when_its_server_ends_and_another_one_begins(page: Page, played: Played) -> None:
    played.go_on(5)
    with served(played.path) as first:
        page.open(first.address, 1280)
        taken(page, 5)
    page.until(f"{SERVER} === 'lost'")
    assert "has ended" in says(page, "server")
    played.go_on(4)
    with served(played.path, first):
        page.until(f"{SERVER} === 'live'")
        played.go_on(1)
        taken(page, 10)
        assert page.run("gonioWatch.steps") == 9


def test_a_repaired_journal_is_read_anew(page: Page, played: Played) -> None:
    played.go_on(10)
    with served(played.path) as server:
        page.open(server.address, 1280)
        taken(page, 10)
        journal = played.path / "journal.jsonl"
        journal.write_bytes(b"".join(played.lines[:5]) + b"x" * 400 + b"\n" + b"".join(played.lines[6:10]))
        fresh = played.path / "journal.new"  # the lock of this process is on the old file
        fresh.write_bytes(journal.read_bytes())
        fresh.rename(journal)
        has(page, "why", "line 6 of the journal is damaged")
        repair.repair(played.path)
        taken(page, len(journal.read_bytes().splitlines()))
        assert page.run("gonioWatch.steps") == journal.read_bytes().count(b'"event":"step"')


def test_seven_tabs_and_more_all_answer(page: Page, played: Played) -> None:
    played.go_on(9)
    with served(played.path) as server:
        tabs = [page.new_tab(server.address), *(page.new_tab(server.address) for _ in range(6))]
        for one in tabs:
            page._session = one  # where it is, in front or behind others
            taken(page, 9)
        played.go_on(1)
        for one in tabs:
            page.to_tab(one)
            taken(page, 10)
        for one in tabs:
            page.to_tab(one)
            page.send("Page.close")


def test_a_hidden_tab_holds_no_connection(page: Page, played: Played) -> None:
    played.go_on(3)
    shown = ServedRun(played.path)
    with Server(shown.routes, shown.watched.log) as server, shown.watched:
        hidden = page.new_tab(server.address)
        taken(page, 3)
        page.new_tab()
        waited(lambda: shown.watched.log.listeners == 0)
        page.send("Page.close")
        page.to_tab(hidden)
        page.until(f"{SERVER} === 'live'")
        waited(lambda: shown.watched.log.listeners == 1)
        page.send("Page.close")


def waited(so: Callable[[], bool]) -> None:
    until = time.monotonic() + 120.0
    while not so():
        assert time.monotonic() < until
        time.sleep(0.01)


@pytest.mark.slow
def test_a_page_goes_on_when_its_server_is_killed(page: Page, played: Played, tmp_path: Path) -> None:
    environment = dict(os.environ, XDG_STATE_HOME=str(tmp_path / "state"))
    played.go_on(5)
    with ExitStack() as running:

        def start() -> tuple[subprocess.Popen[str], str]:
            process = running.enter_context(
                subprocess.Popen(
                    [sys.executable, "-c", "from gonio.cli import main; main()", "watch", str(played.path)],
                    stdout=subprocess.PIPE,
                    text=True,
                    env=environment,
                )
            )
            running.callback(process.kill)
            assert process.stdout is not None
            return process, process.stdout.readline().strip()

        process, where = start()
        page.open(where, 1280)
        taken(page, 5)
        process.kill()
        page.until(f"{SERVER} === 'lost'")
        played.go_on(3)
        process, again = start()
        assert again == where, "port and token are those of before"
        taken(page, 8)
        assert page.run("gonioWatch.steps") == 7
        process.send_signal(signal.SIGINT)
        assert process.wait(120) == 0
