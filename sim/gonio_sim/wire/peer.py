"""What is plugged in at the other end of a cable: a device on a pseudo-terminal, or behind a port of the network."""

import contextlib
import os
import select
import selectors
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from gonio import platform
from gonio.lab.rig import clock

OPENING_MS = 5
"""How often to look whether a closed port has been opened."""
Send = Callable[[bytes], None]


class Device(ABC):
    """What sits behind the terminal."""

    @abstractmethod
    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes that arrived at a line speed; answer with `send`."""

    def opened(self, send: Send) -> None:  # noqa: B027  (most devices do not notice)
        """Somebody has opened the port (told where `tells_opening` is true)."""


class Peer(ABC):
    """Serves one device from a thread, until it is closed; a driver may close and open its port as it likes.

    Parameters
    ----------
    device
        What answers.
    tells_opening
        Tell the device when its port is opened, as the DTR line does.
    """

    def __init__(self, device: Device, *, tells_opening: bool = False) -> None:
        self.device = device
        self._tells_opening = tells_opening
        self.port = ""
        self.failure: BaseException | None = None

    def __enter__(self) -> Self:
        self._wake, self._woken = socket.socketpair()
        self._plug_in()
        self._thread = threading.Thread(target=self._run, name=f"twin on {self.port}", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._wake.close()
        self._thread.join()
        self._woken.close()
        self._unplug()
        if self.failure is not None and error is None:
            raise self.failure

    def _run(self) -> None:
        try:
            self._serve()
        except BaseException as failure:  # shown when the peer is closed: a thread has nobody to raise to
            self.failure = failure

    @abstractmethod
    def _plug_in(self) -> None:
        """Open the port, and say where it is."""

    @abstractmethod
    def _serve(self) -> None:
        """Let the device answer until `_woken` can be read."""

    @abstractmethod
    def _unplug(self) -> None:
        """Close the port."""


class SerialPeer(Peer):
    """A device on a pseudo-terminal.

    Parameters
    ----------
    device, tells_opening
        As of `Peer`.
    link
        Where to put a symbolic link to the terminal; removed on closing.
    """

    def __init__(self, device: Device, link: Path | None = None, *, tells_opening: bool = False) -> None:
        super().__init__(device, tells_opening=tells_opening)
        self._link = link

    def _plug_in(self) -> None:
        self._master, self._slave, self.port = platform.pseudo_terminal()
        if self._link is not None:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(self.port)
            self.port = str(self._link)

    def _unplug(self) -> None:
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def send(self, data: bytes) -> None:
        """Put bytes on the line, whatever was asked (noise, banners)."""
        os.write(self._master, data)

    def baud(self) -> int:
        """The line speed that the other side has set; 0 where it is none of the standard ones."""
        return platform.baud_of(self._master)

    def _serve(self) -> None:
        if self._tells_opening:  # the terminal hangs up on its master while nobody has it open
            os.close(self._slave)
            self._slave = -1
        is_open = not self._tells_opening
        poll = select.poll()
        poll.register(self._master, select.POLLIN | select.POLLHUP)
        poll.register(self._woken, select.POLLIN)
        while True:
            events = dict(poll.poll(None if is_open else OPENING_MS))
            if self._woken.fileno() in events:
                return
            event = events.get(self._master, 0)
            if event & select.POLLIN:
                self.device.receive(os.read(self._master, 4096), self.baud(), self.send)
            elif event & select.POLLHUP:
                is_open = False
                clock.sleep(OPENING_MS / 1000)
            elif not is_open:
                is_open = True
                self.device.opened(self.send)


class SocketPeer(Peer):
    """The same over TCP, for one program at a time, on this computer alone: others are sent away, as ser2net does.

    Parameters
    ----------
    device, tells_opening
        As of `Peer`.
    speed
        At which line speed [baud] bytes come to the device: the network knows none.
    """

    def __init__(self, device: Device, speed: int, *, tells_opening: bool = False) -> None:
        super().__init__(device, tells_opening=tells_opening)
        self._speed = speed
        self._line: socket.socket | None = None

    def _plug_in(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def _unplug(self) -> None:
        self._server.close()
        if self._line is not None:
            self._line.close()

    def send(self, data: bytes) -> None:
        """Put bytes on the line, whatever was asked (noise, banners); nobody may listen."""
        with contextlib.suppress(OSError):
            if self._line is not None:
                self._line.sendall(data)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as look:
            look.register(self._woken, selectors.EVENT_READ)
            look.register(self._server, selectors.EVENT_READ)
            while True:
                ready = {key.fileobj for key, _ in look.select()}
                if self._woken in ready:
                    return
                if self._line is not None and self._line in ready:
                    self._hear(look, self._line)
                elif self._server in ready:  # after the line, which may have ended just before
                    self._answer(look)

    def _hear(self, look: selectors.BaseSelector, line: socket.socket) -> None:
        data = b""
        with contextlib.suppress(ConnectionError):
            data = line.recv(4096)
        if data:
            self.device.receive(data, self._speed, self.send)
        else:
            look.unregister(line)
            line.close()
            self._line = None

    def _answer(self, look: selectors.BaseSelector) -> None:
        line, _ = self._server.accept()
        if self._line is not None:
            line.close()
            return
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._line = line
        look.register(line, selectors.EVENT_READ)
        if self._tells_opening:
            self.device.opened(self.send)


@dataclass(frozen=True, slots=True)
class Clock:
    """The twins' clock [s]: 0 at `start_s` of `time.monotonic`, and `scale` times as fast."""

    scale: float
    start_s: float

    def __call__(self) -> float:
        return self.at(clock.monotonic())

    def at(self, wall_s: float) -> float:
        """What it shows at a time of `time.monotonic`."""
        return (wall_s - self.start_s) * self.scale


def scaled_clock(scale: float) -> Clock:
    """A clock that starts now and runs `scale` times faster than wall time."""
    return Clock(scale, clock.monotonic())
