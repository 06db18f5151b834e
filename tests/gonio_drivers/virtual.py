"""Drivers and twins on one clock that nobody waits for: everything in this process, and no terminal between them.

A twin answers in the thread of who writes to it: what it waits for meanwhile is on a time of its own, and what it
says comes out of the cable when the clock is there. Where several threads are on the clock one runs at a time: when
all wait, the clock jumps to the moment that the first of them waits for. So nothing hangs on how busy this computer
is. What another process opens, or what waits otherwise than by `gonio.lab.rig.clock`, needs the real clock.
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
from gonio.lab.acquisition import waits
from gonio.lab.rig import clock

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
        self._twin = threading.local()
        """`now_s` in a thread that does the work of a twin: the twin's own time."""

    def monotonic(self) -> float:
        if hasattr(self._twin, "now_s"):
            self._twin.now_s += LOOK_S
            return float(self._twin.now_s)
        self.now_s += LOOK_S
        return self.now_s

    def sleep(self, seconds: float) -> None:
        if hasattr(self._twin, "now_s"):
            self._twin.now_s += max(seconds, 0.0)
        else:
            self.wait(lambda: False, seconds)

    def nap(self, seconds: float) -> None:
        """The same for a program that shares its computer."""
        self.sleep(seconds + self.held_up())

    def from_then(self, then_s: float, work: Callable[[], None]) -> float:
        """Do a twin's work now, as if it were begun at a time; the time at which it is done."""
        self._twin.now_s = then_s
        try:
            work()
            return float(self._twin.now_s)
        finally:
            del self._twin.now_s

    def twin_s(self) -> float:
        """The time of the twin whose work is being done; the clock's where there is none."""
        return float(getattr(self._twin, "now_s", self.now_s))

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

    def _wake(self) -> None:
        """Let one thread go on where none runs."""
        if self._running > 0 or not self._waiting:
            return
        while (first := next((one for one in self._waiting if one.ready()), None)) is None:
            first = min(self._waiting, key=lambda one: one.until_s)
            comes_s = min((line.coming[0][0] for line in self.lines.values() if line.coming), default=float("inf"))
            if first.until_s <= comes_s:
                break
            self.now_s = max(self.now_s, comes_s)
            for line in self.lines.values():
                line.arrive()
        if first.until_s == float("inf") and not first.ready():
            return
        if not first.ready():
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
        line.opened()

    @property
    def in_waiting(self) -> int:
        return len(self._line.arrive())

    def __enter__(self) -> VirtualPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.is_open = self._line.held = False

    def flush(self) -> None:
        """Nothing is on its way."""

    def reset_input_buffer(self) -> None:
        self._line.arrive().clear()

    def write(self, data: bytes) -> int:
        self._line.receive(bytes(data), self.baudrate)
        return len(data)

    def read(self, length: int = 1) -> bytes:
        box = self._line.arrive()
        if self.timeout and len(box) < length:
            self._line.clock.wait(lambda: len(box) >= length, self.timeout)
        return self.read_now(length)

    def read_until(self, ending: bytes = b"\n") -> bytes:
        box = self._line.arrive()
        if ending not in box:
            self._line.clock.wait(lambda: ending in box, self.timeout)
        return self.read_now(box.find(ending) + len(ending) if ending in box else len(box))

    readline = read_until

    def read_now(self, length: int) -> bytes:
        box = self._line.arrive()
        data = bytes(box[:length])
        del box[:length]
        return data


@dataclass(eq=False)
class Line:
    """A cable, and the twin at its end."""

    clock: VirtualClock
    peer: SerialPeer
    coming: deque[tuple[float, bytes]] = field(default_factory=deque)
    """What the twin says, and when it comes out of the cable."""
    outbox: bytearray = field(default_factory=bytearray)
    """What came out, and nobody has read."""
    held: bool = False
    done_s: float = 0.0
    """When the twin has done what it was told."""

    def opened(self) -> None:
        """Somebody has opened the port."""
        if self.peer._tells_opening:
            self._at_work(lambda: self.peer.device.opened(self.send))

    def receive(self, data: bytes, baud: int) -> None:
        """Bytes go to the twin."""
        self._at_work(lambda: self.peer.device.receive(data, baud, self.send))

    def _at_work(self, work: Callable[[], None]) -> None:
        if self.peer.failure is not None:
            return
        try:
            self.done_s = self.clock.from_then(max(self.clock.now_s, self.done_s), work)
        except BaseException as failure:  # as `SerialPeer` has it
            self.peer.failure = failure

    def send(self, data: bytes) -> None:
        """The twin says something."""
        self.coming.append((self.clock.twin_s(), bytes(data)))

    def arrive(self) -> bytearray:
        """What has come out of the cable by now."""
        while self.coming and self.coming[0][0] <= self.clock.now_s:
            self.outbox.extend(self.coming.popleft()[1])
        return self.outbox


class Unneeded:
    """The guard of a lamp, in a process that does not die."""

    def __init__(self, *arguments: object) -> None:
        """As of `Guard`."""

    def start(self) -> None:
        """Nothing to be started."""

    def allow(self, limit_s: float) -> None:
        """No limit."""

    by_hand = False

    def alive(self, limit_s: float) -> None:
        """No limit."""

    def rest(self) -> None:
        """No limit."""

    def says(self) -> bytes:
        return b"good"

    def news(self) -> list[str]:
        return []

    def release(self, *, in_order: bool) -> None:
        """Nothing to be ended."""


@contextlib.contextmanager
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualClock]:
    """From now on drivers and twins are on this clock, and twins that are served from now on at no terminal."""
    hours = VirtualClock()
    started_s = clock.time() - hours.now_s
    lines = hours.lines
    numbers = itertools.count()

    def enter(peer: SerialPeer) -> SerialPeer:
        peer.port = str(peer._link) if peer._link is not None else f"{PORT}{next(numbers) or ''}"
        if peer._link is not None:
            peer._link.unlink(missing_ok=True)
            peer._link.touch()
        lines[peer.port] = Line(hours, peer)
        return peer

    def leave(peer: SerialPeer, kind: object, error: BaseException | None, trace: object) -> None:
        del lines[peer.port]
        if peer._link is not None:
            with contextlib.suppress(OSError):
                peer._link.unlink()
        if peer.failure is not None and error is None:
            raise peer.failure

    by_terminal = ports.opened

    def opened(port: str, baud: int, timeout_s: float, key: str) -> Any:
        return VirtualPort(lines[port], baud, timeout_s) if port in lines else by_terminal(port, baud, timeout_s, key)

    monkeypatch.setattr(ports, "opened", opened)
    monkeypatch.setattr(ports, "require_free", lambda port, key: None)
    monkeypatch.setattr(platform, "holders_of", lambda port: [])
    for name, method in (("__enter__", enter), ("__exit__", leave)):
        monkeypatch.setattr(SerialPeer, name, method)
    monkeypatch.setattr(SerialPeer, "send", lambda peer, data: lines[peer.port].send(data))
    monkeypatch.setattr(guard, "Guard", Unneeded)
    monkeypatch.setattr(clock, "monotonic", hours.monotonic)
    monkeypatch.setattr(clock, "sleep", hours.sleep)
    monkeypatch.setattr(clock, "time", lambda: started_s + hours.monotonic())
    napping = SimpleNamespace(monotonic=hours.monotonic, sleep=hours.nap)
    monkeypatch.setattr(motion, "clock", napping)
    monkeypatch.setattr(waits, "time", SimpleNamespace(monotonic=hours.monotonic, sleep=hours.sleep))
    yield hours


def servo_bus(built: Callable[[], Iterable[Servo]]) -> ServoBus:
    """Servos, made on the virtual clock, at the port `PORT`."""
    bus = ServoBus(built())
    SerialPeer(bus).__enter__()
    return bus
