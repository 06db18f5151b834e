"""A small server for pages that are read and never written: fixed routes, and one stream of server-sent events.

It binds to this machine alone unless it is asked otherwise. Loopback is open to every user and to every page of a
browser, so each request has to name the token, by a `Host` that is ours (no name that somebody else's server may point
here), from no foreign `Origin`, with GET or HEAD. All else is refused: 405, 403 or 404. What is not in the table of
routes does not exist; no path reaches the disk.

Events come from an `EventLog`. What is appended has numbers from 1, which browsers send back as `Last-Event-ID`. What
is told has none: of each kind only the newest counts. A client is a place in the log, and not a queue: a slow one falls
behind, is dropped when it takes nothing for `SLOW_S`, and goes on from its number.

>>> events = EventLog()
>>> server = Server({"/": lambda request: Content(b"<!doctype html>", "text/html")}, events)  # doctest: +SKIP
>>> with server:                                                                              # doctest: +SKIP
...     print(server.address)
...     events.append("step", {"step": 1})
"""

import contextlib
import hmac
import io
import ipaddress
import secrets
import selectors
import socket
import socketserver
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple, Self
from urllib.parse import parse_qsl

from gonio.errors import ConfigError
from gonio.lab.live.event_log import EventLog

HEAD_BYTES = 16384
"""A request's head is not longer."""
HEAD_S = 5.0
"""Longest time from the connection to the end of the request's head."""
SLOW_S = 10.0
"""A client that takes a piece of an answer no faster is dropped."""
CONNECTIONS = 96
"""Most connections at once; whoever comes later is told 503."""
STREAMS = 64
"""Most streams of events among the connections, so that room for pages is left."""
HEARTBEAT_S = 3.0
"""Time between two signs of life of an idle stream."""
RETRY_MS = 1000
"""Wait of a browser before it asks again for a stream that broke."""
PIECE = 65536
"""Bytes that a client has to take within `SLOW_S`."""
LOOPBACK = "127.0.0.1"

CSP = (
    "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data: blob:; "
    "connect-src 'self'; worker-src blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # an address holds the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Content(NamedTuple):
    """What a route answers."""

    body: bytes
    kind: str
    """Its media type, such as "image/png"."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a route is asked."""

    query: Mapping[str, str]
    nonce: str
    """What the attribute `nonce` of the page's own scripts and styles has to say."""


Route = Callable[[Request], Content | None]
"""Answers a request; None where there is nothing (404). It is called in a thread of the client's own."""


class Server:
    """Serves while its block lasts.

    Parameters
    ----------
    routes
        By their paths: "/" is the page. "/events" is the stream, and "/favicon.ico" is answered, too.
    events
        What the stream sends.
    host
        Address or name to bind to: this machine alone by default.
    port
        0 takes any that is free.
    token
        What every request has to name as `?token=`; made where none is given.

    Raises
    ------
    ConfigError
        It cannot bind there.
    """

    def __init__(
        self, routes: Mapping[str, Route], events: EventLog, host: str = LOOPBACK, port: int = 0,
        token: str | None = None,
    ) -> None:  # fmt: skip
        self.token = token or secrets.token_urlsafe(32)
        self.events = events
        try:
            family, _, _, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            self._http = _Http(family, where[:2])  # type: ignore[arg-type]
        except (OSError, UnicodeError, OverflowError) as error:
            told = getattr(error, "strerror", None) or str(error)
            raise ConfigError(
                f"the page cannot be served at {_named(host, port)}: {told}; choose another --port (0 is any that is "
                "free) or --host"
            ) from None
        self.host = host
        self.port: int = self._http.server_address[1]
        self._http.routes, self._http.events, self._http.token = dict(routes), events, self.token.encode()
        self._http.hosts = _hosts(host, self.port)
        address = str(self._http.server_address[0]).partition("%")[0]
        self._http.wildcard = ipaddress.ip_address(address).is_unspecified
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.5,), name="server", daemon=True)

    @property
    def address(self) -> str:
        """Where a browser finds the page; it holds the token."""
        host = socket.gethostname() if self._http.wildcard else self.host
        return f"http://{_named(host, self.port)}/?token={self.token}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.events.close()
        self._http.shutdown()
        self._http.server_close()
        self._http.drained(1.0)


def _named(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _hosts(host: str, port: int) -> frozenset[str]:
    """What a request's Host may be, in lower case."""
    names = {LOOPBACK, "localhost", "::1", host.lower()}
    out = {_named(name, port) for name in names}
    return frozenset(out | {name.rpartition(":")[0] for name in out} if port == 80 else out)


class _Http(ThreadingHTTPServer):
    """Threads for clients, not more of them than `CONNECTIONS`."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 128
    routes: Mapping[str, Route]
    events: EventLog
    token: bytes
    hosts: frozenset[str]
    wildcard: bool

    def __init__(self, family: socket.AddressFamily, where: tuple[str, int]) -> None:
        self.address_family = family
        self._free = threading.BoundedSemaphore(CONNECTIONS)
        self.streams = threading.BoundedSemaphore(STREAMS)
        super().__init__(where, _Client)

    def server_bind(self) -> None:
        """Bind, without a look-up of this machine's name: it may take long."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own; 503 where all are busy."""
        if not self._free.acquire(blocking=False):
            request.settimeout(0.1)
            answer = b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 2\r\nContent-Length: 0\r\n"
            with contextlib.suppress(OSError):  # it does not listen
                request.sendall(answer + b"Connection: close\r\n\r\n")
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve one client."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that has gone is no news."""

    def drained(self, patience_s: float) -> None:
        """Wait until the clients have been told of the end."""
        until = time.monotonic() + patience_s
        taken = 0
        while taken < CONNECTIONS and self._free.acquire(timeout=max(0.0, until - time.monotonic())):
            taken += 1
        for _ in range(taken):
            self._free.release()


class _Client(BaseHTTPRequestHandler):
    """One connection: one request, one answer."""

    server: _Http
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "gonio", ""  # nothing about what it runs on

    def handle(self) -> None:
        """Read the head of a request in bounded time, and answer it."""
        self.close_connection = True
        self.nonce = secrets.token_urlsafe(16)
        self.command, self.requestline, self.request_version = "GET", "", self.protocol_version
        try:
            head = self._head()
            if head is None:
                return
            self.connection.settimeout(SLOW_S)
            self.rfile = io.BufferedReader(io.BytesIO(head))
            self.raw_requestline = self.rfile.readline(65537)
            if self.parse_request():
                self.close_connection = True
                if self.headers.defects:  # what follows a line that is none would go unread
                    self._refuse(HTTPStatus.BAD_REQUEST)
                else:
                    self._answer()
        except OSError:
            pass  # it has gone, or takes nothing

    def _head(self) -> bytes | None:
        """The head of a request; None where none comes, after an answer that says so."""
        until, head = time.monotonic() + HEAD_S, b""
        while True:
            end = head.find(b"\r\n\r\n")
            if end >= 0:
                return head[: end + 4]
            if len(head) > HEAD_BYTES:
                self._refuse(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
                return None
            left = until - time.monotonic()
            if left <= 0.0:
                return None
            self.connection.settimeout(left)
            some = self.connection.recv(4096)
            if not some:
                return None
            head += some

    def _answer(self) -> None:
        if self.command not in ("GET", "HEAD"):
            return self._refuse(HTTPStatus.METHOD_NOT_ALLOWED)
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return self._refuse(HTTPStatus.FORBIDDEN, "this server does not go by that name")
        origins = self.headers.get_all("Origin", [])
        if any(not o.lower().startswith("http://") or not self._is_ours(o[len("http://") :]) for o in origins):
            return self._refuse(HTTPStatus.FORBIDDEN, "another page asks")
        path, _, asked = self.requestline.split()[1].partition("?")  # as it was sent: `self.path` has been tidied
        if path == "/favicon.ico":  # a browser asks for it without being told to
            return self._send(HTTPStatus.NO_CONTENT, b"", None)
        try:
            pairs = parse_qsl(asked, keep_blank_values=True, max_num_fields=32)
        except ValueError:
            pairs = []
        query = dict(pairs) if len({name for name, _ in pairs}) == len(pairs) else {}
        if not hmac.compare_digest(query.get("token", "").encode(errors="replace"), self.server.token):
            return self._refuse(HTTPStatus.FORBIDDEN, "the address lacks the token that was printed, or has an old one")
        if path == "/events":
            self._stream(query)
            return
        route = self.server.routes.get(path)
        content = None if route is None else route(Request(query, self.nonce))
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
        else:
            self._send(HTTPStatus.OK, content.body, content.kind)

    def _is_ours(self, host: str) -> bool:
        """Whether a Host names this server, and not a name that somebody else may point here."""
        host = host.strip().lower()
        if host in self.server.hosts:
            return True
        if not self.server.wildcard:
            return False
        arrived, port = self.connection.getsockname()[0], self.server.server_address[1]
        arrived = arrived.removeprefix("::ffff:")
        return host in (_named(arrived, port), _named(socket.gethostname().lower(), port))

    def _stream(self, query: Mapping[str, str]) -> None:
        """Events from a number on, until the client goes or the server ends."""
        said = self.headers.get("Last-Event-ID") or query.get("last-event-id") or query.get("after") or "0"
        number = int(said) if said.isascii() and said.isdigit() and len(said) < 16 else 0
        if self.command == "HEAD":
            return self._send(HTTPStatus.OK, b"", "text/event-stream")
        if not self.server.streams.acquire(blocking=False):
            return self._refuse(HTTPStatus.SERVICE_UNAVAILABLE)
        try:
            self._head_of(HTTPStatus.OK, "text/event-stream; charset=utf-8", None)
            self.connection.sendall(b"retry: %d\n\n" % RETRY_MS)
            version = 0
            with self.server.events.listening():
                while not self._gone():
                    events, number, version = self.server.events.after(number, version, HEARTBEAT_S)
                    if events:
                        data = b"".join(event.encode() for event in events)
                        for at in range(0, len(data), PIECE):
                            self.connection.sendall(data[at : at + PIECE])
                    elif self.server.events.closed:
                        self.connection.sendall(b"event: bye\ndata: {}\n\n")
                        return
                    else:
                        self.connection.sendall(b": heartbeat\nevent: beat\ndata: {}\n\n")
        finally:
            self.server.streams.release()

    def _gone(self) -> bool:
        """Whether the client has closed its end."""
        with selectors.DefaultSelector() as look:
            look.register(self.connection, selectors.EVENT_READ)
            return bool(look.select(0)) and self.connection.recv(1, socket.MSG_PEEK) == b""

    def _refuse(self, status: HTTPStatus, why: str = "") -> None:
        body = f"{status.value} {status.phrase}" + (f": {why}" if why else "")
        self._send(status, body.encode() + b"\n", "text/plain")

    def handle_expect_100(self) -> bool:
        """Nobody's body is waited for."""
        return True

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Requests that cannot be parsed are refused like all others that are refused."""
        self._refuse(HTTPStatus(code))

    def _send(self, status: HTTPStatus, body: bytes, kind: str | None) -> None:
        text = kind is not None and kind.startswith("text/") and "charset" not in kind
        self._head_of(status, f"{kind}; charset=utf-8" if text else kind, len(body))
        if self.command != "HEAD":
            self.connection.sendall(body)

    def _head_of(self, status: HTTPStatus, kind: str | None, length: int | None) -> None:
        self.request_version = self.protocol_version  # of what was not understood nothing is known
        self.send_response(status)
        if kind is not None:
            self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        if status == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.send_header("Content-Security-Policy", CSP.format(nonce=self.nonce))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Connection", "close")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the address holds the token, and the terminal is somebody's."""
