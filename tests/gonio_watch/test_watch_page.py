"""What `gonio watch` serves, and to whom: the routes of a run's page, asked as a browser and as an attacker asks."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from gonio_watch.serving import ServedRun, page
from gonio_watch.watching import asked

from gonio.lab.acquisition.journal import encode
from gonio.lab.acquisition.plan import Adaptive
from gonio.lab.acquisition.run import Run
from gonio.lab.live.server import Server
from tests.gonio.lab.live.test_server import get, numbers, received, stream

ROUTES = ("/", "/events", "/curves", "/frame")
LINES = 5000


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Server, Path]]:
    """The page of a run that waits."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        environment.delenv("XDG_RUNTIME_DIR", raising=False)
        run = tmp_path_factory.mktemp("run")
        made = ServedRun(run)
        made.watched.shared._command = ()  # nothing is worked out here
        with Server(made.routes, made.watched.log) as server, made.watched:
            yield server, run


@pytest.mark.parametrize("path", ROUTES)
def test_whoever_is_not_its_own_page_is_refused(shown: tuple[Server, Path], path: str) -> None:
    server, _ = shown
    mine = f"{path}?token={server.token}"
    assert get(server, path)[0] == 403
    assert get(server, f"{path}?token={server.token[:-1]}")[0] == 403
    assert get(server, mine, host=f"evil.example:{server.port}")[0] == 403
    assert get(server, mine, "Origin: http://evil.example")[0] == 403
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        assert get(server, mine, "Content-Length: 0", method=method)[0] == 405


@pytest.mark.parametrize("path", ["/../run.toml", "/run.toml", "/frame/../run.toml", "/%2e%2e/now.json", "/now.json"])
def test_no_file_is_behind_a_path(shown: tuple[Server, Path], path: str) -> None:
    server, run = shown
    (run / "run.toml").write_text("secret = 1")
    status, _, body = get(server, f"{path}?token={server.token}")
    assert status in (400, 404)
    assert b"secret" not in body


def test_before_there_are_values_there_are_none_and_no_error(shown: tuple[Server, Path]) -> None:
    server, _ = shown
    status, _, body = get(server, f"/curves?token={server.token}")
    assert (status, body[:13]) == (200, b'{"view":null,')
    assert get(server, f"/frame?token={server.token}")[0] == 404


def test_every_line_of_a_long_run_is_an_event_once_from_wherever_a_client_goes_on(shown: tuple[Server, Path]) -> None:
    server, run = shown
    lines = [encode({"n": 0, "event": "session", "gonio": "", "left": LINES, "wall": "2026-01-01T00:00:00Z"})]
    step: dict[str, object] = {
        "event": "step",
        "kind": "point",
        "flag": "",
        "frames": [],
        "wall": "2026-01-01T00:00:00Z",
    }
    step |= {"goal": {"light": 0.0, "camera": 0.0}, "pose": {"light": 0.0, "camera": 0.0}, "time_s": 0.0}
    lines += [encode({"n": n, **step, "step": n, "point": n}) for n in range(1, LINES)]
    last = b'"n":%d,' % (LINES - 1)
    with stream(server) as line:
        (run / "journal.jsonl").write_bytes(b"".join(lines))
        assert numbers(received(line, last)) == list(range(1, LINES + 1))
    for at in (1, 1999, LINES - 1):
        with stream(server, f"Last-Event-ID: {at}") as line:
            assert numbers(received(line, last)) == list(range(at + 1, LINES + 1))
    assert sum(len(event.data) for event in server.events.events(0, LINES - 2000)) < 130 * (LINES - 2000), "in short"


def test_the_page_needs_no_other_file() -> None:
    text = page("N").decode()
    assert "{{" not in text
    assert text.count('nonce="N"') >= 3
    assert 'src="http' not in text


def test_a_run_that_grows_says_what_it_was_asked_for() -> None:
    adaptive = Adaptive.model_validate({"how": "curve", "budget_h": 1.5, "u_rel": 0.01, "theta_i_deg": [30, 60]})
    run = cast(Run, SimpleNamespace(settings=SimpleNamespace(adaptive=adaptive)))
    assert asked(run) == "grows by curve for 1.5 h at most; u rel 0.01; theta i deg 30, 60"
    assert asked(cast(Run, SimpleNamespace(settings=SimpleNamespace(adaptive=None)))) == ""
