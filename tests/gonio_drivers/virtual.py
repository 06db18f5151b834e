"""Drivers and twins on one clock that nobody waits for: everything in this process, and no terminal between them.

Each twin has a thread of its own. One thread runs at a time: when all wait, the clock jumps to the moment that the
first of them waits for. So nothing hangs on how busy this computer is. What another process opens, or what waits
otherwise than by `gonio.rig.clock`, needs the real clock.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import serial
from gonio_drivers import guard, motion, ports
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.servo import Servo

from gonio import platform
from gonio.acquisition import holding, suspending
from gonio.rig import clock

PORT = "/dev/virtual"
HANGS_S = 60.0
"""Real seconds after which a wait that nothing ends is an error."""
LOOK_S = 1e-5
"""A look at the clock takes so long: whoever waits for a time without sleeping comes to it."""


@dataclass(eq=False)
class Waiting:
    """A thread that waits for something, or for a time."""

    until_s: float
    ready: Callable[[], bool]
    asleep: threading.Lock = field(default_factory=threading.Lock)
    """Taken until the thread is woken: a tenth of the work of a `threading.Event`."""


class VirtualClock:
    """Time that passes when every thread on this clock waits; who makes it is one of them."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.held_up: Callable[[], float] = lambda: 0.0
        """How long the computer is held up after each nap of the drivers between two looks at the arms [s]."""
        self._lock = threading.Lock()
        self._waiting: list[Waiting] = []
        self._members = {threading.get_ident()}
        self.lines: dict[str, Line] = {}
        """Cables that are plugged in, by port."""
        self._running = 1

    def monotonic(self) -> float:
        self.now_s += LOOK_S
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.wait(lambda: False, seconds)

    def nap(self, seconds: float) -> None:
        """The same for a program that shares its computer."""
        self.sleep(seconds + self.held_up())

    def wait(self, ready: Callable[[], bool], seconds: float = float("inf")) -> None:
        """Let time pass until something is so, or for so long."""
        me = Waiting(self.now_s + max(seconds, 0.0), ready)
        me.asleep.acquire()
        member = threading.get_ident() in self._members
        with self._lock:
            self._waiting.append(me)
            self._running -= member
            self._wake()
        try:
            while not me.asleep.acquire(timeout=HANGS_S):
                if seconds < float("inf"):
                    raise RuntimeError("nothing ends a wait on the virtual clock: does something wait otherwise?")
        except BaseException:  # an interrupt, say
            with self._lock:
                if me in self._waiting:
                    self._waiting.remove(me)
                    self._running += 1
            raise
        if not member:  # a thread that is none of this clock's came by
            with self._lock:
                self._running -= 1
                self._wake()

    def run(self, work: Callable[[], None]) -> None:
        """Do work in a thread on this clock."""

        def go() -> None:
            self._members.add(threading.get_ident())
            try:
                work()
            finally:
                with self._lock:
                    self._members.discard(threading.get_ident())
                    self._running -= 1
                    self._wake()

        with self._lock:
            self._running += 1
        threading.Thread(target=go, daemon=True).start()

    def _wake(self) -> None:
        """Let one thread go on where none runs."""
        if self._running > 0 or not self._waiting:
            return
        first = next((one for one in self._waiting if one.ready()), None)
        if first is None:
            first = min(self._waiting, key=lambda one: one.until_s)
            if first.until_s == float("inf"):
                return
            self.now_s = max(self.now_s, first.until_s)
        self._waiting.remove(first)
        self._running += 1
        first.asleep.release()


class VirtualPort:
    """The drivers' end of a cable to a twin: what they use of `serial.Serial`."""

    def __init__(self, line: Line, baud: int, timeout_s: float) -> None:
        if line.held:
            raise serial.SerialException("Could not exclusively lock port")
        self._line, self.baudrate, self.timeout = line, baud, timeout_s
        self.is_open = line.held = True
        line.inbox.append(None)

    @property
    def in_waiting(self) -> int:
        return len(self._line.outbox)

    def __enter__(self) -> VirtualPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.is_open = self._line.held = False

    def flush(self) -> None:
        """Nothing is on its way."""

    def reset_input_buffer(self) -> None:
        self._line.outbox.clear()

    def write(self, data: bytes) -> int:
        self._line.inbox.append((bytes(data), self.baudrate))
        return len(data)

    def read(self, length: int = 1) -> bytes:
        box = self._line.outbox
        if self.timeout:
            self._line.clock.wait(lambda: len(box) >= length, self.timeout)
        data = bytes(box[:length])
        del box[:length]
        return data

    def read_until(self, ending: bytes = b"\n") -> bytes:
        box = self._line.outbox
        self._line.clock.wait(lambda: ending in box, self.timeout)
        return self.read_now(box.find(ending) + len(ending) if ending in box else len(box))

    readline = read_until

    def read_now(self, length: int) -> bytes:
        data = bytes(self._line.outbox[:length])
        del self._line.outbox[:length]
        return data


@dataclass
class Line:
    """A cable: what goes to the twin, and what comes from it."""

    clock: VirtualClock
    inbox: deque[tuple[bytes, int] | None] = field(default_factory=deque)
    """None where somebody has opened the port."""
    outbox: bytearray = field(default_factory=bytearray)
    held: bool = False
    ends: bool = False
    ended: bool = False


class Unneeded:
    """The guard of a lamp, in a process that does not die."""

    def __init__(self, *arguments: object) -> None:
        """As of `Guard`."""

    def start(self) -> None:
        """Nothing to be started."""

    def allow(self, limit_s: float) -> None:
        """No limit."""

    def over(self) -> bool:
        return False

    def release(self, *, in_order: bool) -> None:
        """Nothing to be ended."""


@contextlib.contextmanager
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualClock]:
    """From now on drivers and twins are on this clock, and twins that are served from now on at no terminal."""
    hours = VirtualClock()
    started_s = clock.time() - hours.now_s
    lines = hours.lines
    numbers = itertools.count()

    def serve(peer: SerialPeer, line: Line) -> None:
        try:
            while True:
                hours.wait(lambda: bool(line.inbox) or line.ends)
                if line.ends:
                    return
                came = line.inbox.popleft()
                if came is not None:
                    peer.device.receive(*came, line.outbox.extend)
                elif peer._tells_opening:
                    peer.device.opened(line.outbox.extend)
        except BaseException as failure:  # as `SerialPeer` has it
            peer.failure = failure
        finally:
            line.ended = True

    def enter(peer: SerialPeer) -> SerialPeer:
        peer.port = str(peer._link) if peer._link is not None else f"{PORT}{next(numbers) or ''}"
        if peer._link is not None:
            peer._link.unlink(missing_ok=True)
            peer._link.touch()
        line = lines[peer.port] = Line(hours)
        hours.run(lambda: serve(peer, line))
        return peer

    def leave(peer: SerialPeer, kind: object, error: BaseException | None, trace: object) -> None:
        end(lines.pop(peer.port))
        if peer._link is not None:
            with contextlib.suppress(OSError):
                peer._link.unlink()
        if peer.failure is not None and error is None:
            raise peer.failure

    def end(line: Line) -> None:
        line.ends = True
        hours.wait(lambda: line.ended)

    by_terminal = ports.opened

    def opened(port: str, baud: int, timeout_s: float, key: str) -> Any:
        return VirtualPort(lines[port], baud, timeout_s) if port in lines else by_terminal(port, baud, timeout_s, key)

    monkeypatch.setattr(ports, "opened", opened)
    monkeypatch.setattr(ports, "require_free", lambda port, key: None)
    monkeypatch.setattr(platform, "holders_of", lambda port: [])
    for name, method in (("__enter__", enter), ("__exit__", leave)):
        monkeypatch.setattr(SerialPeer, name, method)
    monkeypatch.setattr(SerialPeer, "send", lambda peer, data: lines[peer.port].outbox.extend(data))
    monkeypatch.setattr(guard, "Guard", Unneeded)
    monkeypatch.setattr(clock, "monotonic", hours.monotonic)
    monkeypatch.setattr(clock, "sleep", hours.sleep)
    monkeypatch.setattr(clock, "time", lambda: started_s + hours.monotonic())
    napping = SimpleNamespace(monotonic=hours.monotonic, sleep=hours.nap)
    monkeypatch.setattr(motion, "clock", napping)
    for module in (holding, suspending):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=hours.monotonic, sleep=hours.sleep))
    yield hours
    for line in lines.values():
        end(line)


def servo_bus(built: Callable[[], Iterable[Servo]]) -> ServoBus:
    """Servos, made on the virtual clock, at the port `PORT`."""
    bus = ServoBus(built())
    SerialPeer(bus).__enter__()
    return bus
