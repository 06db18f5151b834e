"""The server of live pages answers its own page and nobody else."""

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any
from urllib.parse import urlsplit

import pytest

from gonio.errors import ConfigError
from gonio.lab.live import server as module
from gonio.lab.live.event_log import EventLog
from gonio.lab.live.server import Content, Request, Server

PATIENCE_S = 120.0
"""Machines that test are busy."""
PAGE = Content(b"<!doctype html><title>a page</title>", "text/html")


def picture(request: Request) -> Content | None:
    return Content(b"PNG " + request.query["of"].encode(), "image/png") if "of" in request.query else None


@pytest.fixture(scope="module")
def served() -> Iterator[Server]:
    with Server({"/": lambda request: PAGE, "/picture": picture}, EventLog()) as server:
        yield server


@pytest.fixture
def fresh() -> Iterator[Server]:
    """One whose events are the test's own."""
    with Server({"/": lambda request: PAGE}, EventLog()) as server:
        yield server


def ask(server: Server, request: bytes) -> tuple[int, dict[str, str], bytes]:
    """Send bytes as they are; status, headers in lower case and body of the answer (0 where there is none)."""
    with closing(socket.create_connection(("127.0.0.1", server.port), PATIENCE_S)) as line:
        line.sendall(request)
        answer = b""
        while some := line.recv(65536):
            answer += some
    if not answer:
        return 0, {}, b""
    head, _, body = answer.partition(b"\r\n\r\n")
    first, *rest = head.decode().split("\r\n")
    headers = {name.lower(): value for name, _, value in (row.partition(": ") for row in rest)}
    return int(first.split()[1]), headers, body


def get(server: Server, path: str, *headers: str, method: str = "GET", host: str | None = None) -> Any:
    named = f"127.0.0.1:{server.port}" if host is None else host
    lines = [f"{method} {path} HTTP/1.1", f"Host: {named}", *headers]
    return ask(server, "\r\n".join([*lines, "", ""]).encode())


def test_the_page_is_served_to_whoever_has_the_token(served: Server) -> None:
    where = urlsplit(served.address)
    assert where.hostname == "127.0.0.1"
    status, headers, body = get(served, f"/?{where.query}")
    assert (status, body, headers["content-type"]) == (200, PAGE.body, "text/html; charset=utf-8")
    status, _, body = get(served, f"/picture?of=a%20frame&{where.query}")
    assert (status, body) == (200, b"PNG a frame")
    status, headers, body = get(served, f"/?{where.query}", method="HEAD")
    assert (status, body, headers["content-length"]) == (200, b"", str(len(PAGE.body)))
    assert get(served, f"/picture?{where.query}")[0] == 404, "a route that has nothing says so"
    assert get(served, "/favicon.ico")[0] == 204, "a browser looks for it, and finds none and no error"


def test_each_answer_says_that_it_is_kept_nowhere_and_shown_in_no_other_page(served: Server) -> None:
    for path in (f"/?token={served.token}", "/", f"/nothing?token={served.token}"):
        _, headers, _ = get(served, path)
        said = {"cache-control": "no-store", "referrer-policy": "no-referrer"}
        said |= {"x-content-type-options": "nosniff", "x-frame-options": "DENY"}
        assert said.items() <= headers.items()
        assert headers["content-security-policy"].startswith("default-src 'none'; script-src 'nonce-")
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert not any(name.startswith("access-control") for name in headers)


def test_scripts_carry_a_number_that_is_used_once() -> None:
    with Server({"/": lambda request: Content(request.nonce.encode(), "text/html")}, EventLog()) as served:
        first, second = (get(served, f"/?token={served.token}") for _ in range(2))
    assert f"'nonce-{first[2].decode()}'" in first[1]["content-security-policy"]
    assert first[2] != second[2]


@pytest.mark.parametrize(
    "query",
    ["", "?token=", "?token=wrong", "?Token={token}", "?token={token}x", "?token=%ff", "?token=x&token={token}"],
)
def test_without_the_token_nothing_is_told(served: Server, query: str) -> None:
    for path in ("/", "/events", "/picture", "/no-such-path"):
        status, _, body = get(served, path + query.format(token=served.token))
        assert status == 403, path
        assert PAGE.body not in body
        assert served.token.encode() not in body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "TRACE", "CONNECT", "BREW", "get"])
def test_nothing_but_get_and_head_is_allowed(served: Server, method: str) -> None:
    status, headers, _ = get(served, f"/?token={served.token}", "Content-Length: 0", method=method)
    assert status == 405
    assert headers["allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    "host",
    [
        *("evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:{port}"),
        *("127.0.0.1:{port}.evil.example", "", "127.0.0.2:{port}", "0.0.0.0:{port}", "[::1]", "127.0.0.1:{port}@e"),
    ],
)
def test_a_name_that_somebody_else_points_here_is_refused(served: Server, host: str) -> None:
    status, _, body = get(served, f"/?token={served.token}", host=host.format(port=served.port))
    assert (status, PAGE.body in body) == (403, False)


def test_its_own_names_and_origin_are_taken(served: Server) -> None:
    for host in ("127.0.0.1", "localhost", "LOCALHOST", "[::1]"):
        assert get(served, f"/?token={served.token}", host=f"{host}:{served.port}")[0] == 200, host
    assert get(served, f"/?token={served.token}", f"Origin: http://127.0.0.1:{served.port}")[0] == 200


def test_one_host_is_named_and_not_none_or_two(served: Server) -> None:
    path, mine = f"/?token={served.token}".encode(), f"127.0.0.1:{served.port}".encode()
    assert ask(served, b"GET %b HTTP/1.1\r\n\r\n" % path)[0] == 403
    assert ask(served, b"GET %b HTTP/1.0\r\n\r\n" % path)[0] == 403
    assert ask(served, b"GET %b HTTP/1.1\r\nHost: %b\r\nHost: evil.example\r\n\r\n" % (path, mine))[0] == 403
    assert ask(served, b"GET %b HTTP/1.0\r\nHost: %b\r\n\r\n" % (path, mine))[0] == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "http://127.0.0.1", ""]
)
def test_a_page_of_another_origin_is_refused(served: Server, origin: str) -> None:
    assert get(served, f"/?token={served.token}", f"Origin: {origin.format(port=served.port)}")[0] == 403


@pytest.mark.parametrize(
    "path",
    [
        *("/..", "/../", "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc/passwd", "/picture/.."),
        *(
            "//",
            "//picture",
            "//etc/passwd",
            "/etc/passwd",
            "/./picture",
            "/picture/",
            "/%70icture",
            "/events/",
            "/events/../picture",
        ),
        *("/picture%00", "/\\..\\..\\etc\\passwd", "http://evil.example/", "*", "picture"),
    ],
)
def test_what_is_not_in_the_table_does_not_exist(served: Server, path: str) -> None:
    status, _, body = get(served, f"{path}?token={served.token}&of=x")
    assert status in (400, 404)
    assert b"root:" not in body


@pytest.mark.parametrize(
    "request_",
    [
        b"\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"GET /\r\n\r\n", b"\0\0\0\0\r\n\r\n",
        b"GET / HTTP/1.1\r\nno colon\r\n\r\n", b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\r\n\r\n",
        b"GET /" + b"a" * 12000 + b" HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 2000 + b"\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"x" * 100_000, b"GET / HTTP/1.1\r\n" + b"X: " + b"x" * 15000 + b"\r\n\r\n",
    ],
)  # fmt: skip
def test_what_cannot_be_understood_is_refused_and_stops_nothing(served: Server, request_: bytes) -> None:
    try:
        status, _, body = ask(served, request_)
    except ConnectionError:  # refused while it was still being sent
        status, body = 0, b""
    assert status in (0, 400, 403, 431, 505)
    assert PAGE.body not in body
    assert get(served, f"/?token={served.token}")[0] == 200


@pytest.mark.parametrize("line", ["Origin : http://evil.example", "no colon", "X\0Y: z", ": z"])
def test_a_head_with_a_line_that_is_no_header_is_refused(served: Server, line: str) -> None:
    status, _, body = get(served, f"/?token={served.token}", line, "Origin: http://evil.example")
    assert (status, PAGE.body in body) in ((400, False), (403, False))
    assert get(served, f"/?token={served.token}", line)[0] == 400


def test_nobody_is_asked_to_go_on_with_a_body(served: Server) -> None:
    more = ("Content-Length: 3", "Expect: 100-continue")
    assert get(served, f"/?token={served.token}", *more, method="POST")[0] == 405
    assert get(served, f"/?token={served.token}", *more)[0] == 200


def test_a_connection_serves_one_request(served: Server) -> None:
    one = f"GET /?token={served.token} HTTP/1.1\r\nHost: localhost:{served.port}\r\nConnection: keep-alive\r\n\r\n"
    _, headers, body = ask(served, one.encode() * 3)
    assert headers["connection"] == "close"
    assert body == PAGE.body


def test_who_sends_a_head_byte_by_byte_is_not_waited_for(served: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HEAD_S", 0.05)
    with closing(socket.create_connection(("127.0.0.1", served.port), PATIENCE_S)) as line:
        line.sendall(b"GET / HT")
        assert line.recv(100) == b""


def test_more_clients_than_there_is_room_for_are_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONNECTIONS", 2)
    with Server({"/": lambda request: PAGE}, EventLog()) as server:
        held = [stream(server) for _ in range(2)]
        status, headers, _ = get(server, f"/?token={server.token}")
        assert (status, headers["retry-after"]) == (503, "2")
        for line in held:
            line.close()


def test_streams_leave_room_for_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STREAMS", 1)
    with Server({"/": lambda request: PAGE}, EventLog()) as server, closing(stream(server)):
        assert get(server, f"/events?token={server.token}")[0] == 503
        assert get(server, f"/?token={server.token}")[0] == 200


# --- the stream ------------------------------------------------------------------------------------------------------


def stream(server: Server, *headers: str, query: str = "") -> socket.socket:
    """A connection that receives events; its head has been read."""
    line = socket.create_connection(("127.0.0.1", server.port), PATIENCE_S)
    lines = [f"GET /events?token={server.token}{query} HTTP/1.1", f"Host: localhost:{server.port}", *headers, "", ""]
    line.sendall("\r\n".join(lines).encode())
    head = b""
    while not head.endswith(b"\r\n\r\n"):
        head += line.recv(1)
    assert head.startswith(b"HTTP/1.1 200 ")
    assert b"text/event-stream" in head
    return line


def received(line: socket.socket, until: bytes) -> list[dict[str, str]]:
    """The messages of a stream, up to and with one that holds certain bytes."""
    text, found = bytearray(), False
    while not (found and text.endswith(b"\n\n")):
        some = line.recv(1 << 20)
        assert some, "the stream ended"
        text += some
        found = found or until in text[-len(some) - len(until) :]
    messages = [dict(row.split(": ", 1) for row in part.split("\n")) for part in text.decode().split("\n\n") if part]
    return [message for message in messages if "data" in message]


def numbers(messages: list[dict[str, str]]) -> list[int]:
    return [int(message["id"]) for message in messages if "id" in message]


def test_events_come_in_order_from_the_first_and_as_they_happen(fresh: Server) -> None:
    fresh.events.append(("step", {"n": 0}), ("step", {"n": 1}))
    with closing(stream(fresh)) as line:
        first = received(line, b'"n":1')
        fresh.events.append(("end", {"n": 2}))
        then = received(line, b'"n":2')
    assert numbers(first + then) == [1, 2, 3]
    assert [json.loads(message["data"])["n"] for message in first + then] == [0, 1, 2]
    assert [message["event"] for message in first + then] == ["step", "step", "end"]


@pytest.mark.parametrize("how", ["header", "query", "both"])
def test_a_client_goes_on_after_the_last_event_that_it_has(fresh: Server, how: str) -> None:
    fresh.events.append(*(("step", {"n": n}) for n in range(1000)))
    headers = ["Last-Event-ID: 990"] if how != "query" else []
    query = {"header": "", "query": "&after=990", "both": "&after=3"}[how]  # a browser's own is the newer one
    with closing(stream(fresh, *headers, query=query)) as line:
        assert numbers(received(line, b'"n":999')) == list(range(991, 1001))


@pytest.mark.parametrize("last", ["-1", "1e3", "abc", "9" * 40, "٣", " ", "0x10", "1\t2"])
def test_a_last_event_that_is_no_number_is_none(fresh: Server, last: str) -> None:
    fresh.events.append(("step", {"n": 0}))
    with closing(stream(fresh, f"Last-Event-ID: {last}")) as line:
        assert numbers(received(line, b'"n":0')) == [1]


def test_of_what_is_told_the_newest_counts_and_it_has_no_number(fresh: Server) -> None:
    for n in range(5):
        fresh.events.tell("status", {"n": n})
    with closing(stream(fresh, "Last-Event-ID: 7")) as line:
        assert received(line, b'"n"') == [{"event": "status", "data": '{"n":4}'}]


def test_an_idle_stream_says_that_it_lives(fresh: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HEARTBEAT_S", 0.02)
    with closing(stream(fresh)) as line:
        text = b""
        while b": heartbeat\n" not in text:
            text += line.recv(1000)
    assert b"retry: 1000\n" in text


def clients() -> int:
    return sum("process_request_thread" in thread.name for thread in threading.enumerate())


def test_a_client_that_takes_nothing_is_dropped_and_delays_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    before = clients()
    with Server({"/": lambda request: PAGE}, EventLog()) as server, ExitStack() as lines:
        with monkeypatch.context() as hasty:
            hasty.setattr(module, "SLOW_S", 0.2)
            slow = lines.enter_context(closing(stream(server)))
        fast = lines.enter_context(closing(stream(server)))  # with the patience of every day: machines are busy
        server.events.append(
            *(("step", {"text": "x" * 100_000}) for _ in range(120))
        )  # more than a socket's buffers hold
        server.events.append(("last", {}))
        assert numbers(received(fast, b"event: last"))[-1] == 121
        while clients() > before + 1:
            threading.Event().wait(0.01)  # until the slow one's is gone
        taken = bytearray()
        with contextlib.suppress(ConnectionError):
            while some := slow.recv(1 << 20):
                taken += some
    assert b"event: last" not in taken


def test_a_server_that_ends_says_so_to_its_streams() -> None:
    with Server({"/": lambda request: PAGE}, EventLog()) as server:
        line = stream(server)
    with closing(line):
        assert received(line, b"bye") == [{"event": "bye", "data": "{}"}]
        assert line.recv(100) == b""


def test_the_next_server_goes_on_at_the_same_address() -> None:
    events = EventLog()
    events.append(*(("step", {"n": n}) for n in range(10)))
    with Server({"/": lambda request: PAGE}, events) as server:
        first = server
    again = EventLog()
    again.append(*(("step", {"n": n}) for n in range(12)))
    with Server({"/": lambda request: PAGE}, again, port=first.port, token=first.token) as server:
        assert server.address == first.address
        with closing(stream(server, "Last-Event-ID: 10")) as line:
            assert numbers(received(line, b'"n":11')) == [11, 12]


def test_a_port_that_is_taken_and_a_host_that_is_not_ours_are_clear_errors(served: Server) -> None:
    with pytest.raises(ConfigError, match=f"127.0.0.1:{served.port}: .*; choose another --port"):
        Server({}, EventLog(), port=served.port)
    with pytest.raises(ConfigError, match=r"192\.0\.2\.1:0: "):  # an address for documentation (RFC 5737)
        Server({}, EventLog(), host="192.0.2.1")


def test_a_server_for_every_interface_goes_by_the_address_that_was_called() -> None:
    with Server({"/": lambda request: PAGE}, EventLog(), host="0.0.0.0") as server:
        asked = {"127.0.0.1": 200, socket.gethostname(): 200, "evil.example": 403, "192.0.2.1": 403}
        for host, status in asked.items():
            assert get(server, f"/?token={server.token}", host=f"{host}:{server.port}")[0] == status, host
