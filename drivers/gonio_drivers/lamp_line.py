"""The line to a lamp's controller, and its language as data.

Languages (dialects) are shipped in `dialects/`, or come from a file of the user's. Commands, queries and replies are
repeated where one is lost. What an answer means is the driver's affair (`gonio_drivers.light`).
"""

import contextlib
import re
from collections import deque
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import serial
from pydantic import ValidationInfo, field_validator, model_validator

from gonio import config
from gonio.config import NonNegative, Positive
from gonio.errors import ConfigError, DeviceError, PassingFault
from gonio.lab.rig import clock
from gonio_drivers import log, ports

DIALECTS = ("scpi", "mightex", "arduino")
FILLS = {"set": ("value", "channel"), "select": ("wavelength_nm", "channel")}
"""What is filled into a command; the channel into any other."""
KEY = "devices.light.port"
TRIES = 3
LATENESS = 2.0
"""How much longer than its timeout a missing reply is awaited, so that it is not taken for the next one's."""
SLOWEST = 10.0
"""Longest wait for a controller that answers late, in timeouts of its dialect."""
ERROR = r"[-+]?\d.*"
"""What an entry of an error queue looks like: a number first."""
ERRORS_KEPT = 100
"""Entries of an error queue that are read, at most: no controller keeps more."""


class Dialect(config.Strict):
    """How a lamp controller is spoken to. Patterns are regular expressions for a whole reply."""

    name: str
    baud: Positive
    send_ending: str = "\n"
    reply_ending: str = "\n"
    timeout_s: Positive = 0.5
    prompt: str | None = None
    """What the controller writes when it awaits a command, without an ending; taken off the beginning of a reply."""
    banner: str | None = None
    """What the controller says when it has started; some restart whenever their port is opened."""
    banner_s: Positive = 4.0
    start: tuple[str, ...] = ()
    """Commands that put the line into its usual state; their replies are not looked at."""
    identify: str
    identity: str
    on: str
    off: str
    state: str
    state_on: str
    state_off: str
    set: str
    get: str
    got: str
    """Pattern of an answer whose one group is the number."""
    full_scale: Positive
    """Setting for level 1."""
    resolution: NonNegative
    """Step of the setting, in its own unit: a readback within one step is the same."""
    acknowledge: str | None = None
    refuse: str | None = None
    error_query: str | None = None
    no_error: str = "0.*"
    select: str | None = None
    """Choose a wavelength, for tunable sources."""
    selected: str | None = None
    selected_got: str = r"([-+.\deE]+)"
    monitor: str | None = None
    """Ask a monitor photodiode; its reading is proportional to the output."""
    monitor_got: str = r"([-+.\deE]+)"

    lock: str | None = None
    """Ask whether the source is in lock, or stabilised."""
    lock_good: str = "1|LOCKED"
    lock_lost: str = "0|UNLOCKED"

    @field_validator(
        "banner", "identity", "state_on", "state_off", "got", "acknowledge", "refuse", "no_error", "selected_got",
        "monitor_got", "lock_good", "lock_lost",
    )  # fmt: skip
    @classmethod
    def _pattern(cls, pattern: str | None) -> str | None:
        if pattern is not None:
            try:
                re.compile(pattern)
            except re.error as error:
                raise ValueError(f"is not a regular expression: {error}") from None
        return pattern

    @field_validator("got", "selected_got", "monitor_got")
    @classmethod
    def _number(cls, pattern: str) -> str:
        if re.compile(pattern).groups < 1:
            raise ValueError("needs a group, in round brackets, around the number")
        return pattern

    @field_validator("on", "off", "state", "set", "get", "select", "monitor", "lock")
    @classmethod
    def _template(cls, command: str | None, info: ValidationInfo) -> str | None:
        fills = FILLS.get(str(info.field_name), ("channel",))
        try:
            (command or "").format(**dict.fromkeys(fills, 1.0))
        except (KeyError, IndexError, ValueError):
            known = " and ".join(f"{{{name}}}" for name in fills)
            raise ValueError(f"only {known} can be filled in; write {{{{ and }}}} for braces") from None
        return command

    @model_validator(mode="after")
    def _read_back(self) -> "Dialect":
        if (self.select is None) != (self.selected is None):
            raise ValueError("select and selected go together: a wavelength that is set must be read back")
        return self


def dialect(name: str) -> Dialect:
    """A shipped dialect by name, or one from a TOML file.

    Raises
    ------
    ConfigError
        There is neither, or the file is wrong.
    """
    if name in DIALECTS:
        return config.load(Dialect, Path(str(files("gonio_drivers") / "dialects" / f"{name}.toml")))
    if name.endswith(".toml"):
        return config.load(Dialect, name)
    raise ConfigError(
        f'devices.light.dialect = "{name}": shipped are {", ".join(DIALECTS)}; or give the path of a .toml file'
    )


class Nak(DeviceError):
    """The controller refuses a command."""


class LampLine:
    """A serial port on which a controller's dialect is spoken.

    Parameters
    ----------
    port
        Its name, as the rig file has it.
    dialect
        The controller's language.

    Raises
    ------
    DeviceError
        The controller does not answer, refuses (`Nak`), or the port is lost.
    """

    def __init__(self, port: str, dialect: Dialect) -> None:
        self._name, self._dialect = port, dialect
        self._port: serial.Serial | None = None
        self._silent = False
        """It has not answered for longer than even a late answer takes."""
        self._sent: deque[str] = deque(maxlen=4)
        """The last commands, as an echo would return them."""
        self._ending = dialect.reply_ending.encode()
        self._lines: deque[str] = deque()
        """Lines that have come together, and have not been looked at."""

    def open(self, baud: int) -> None:
        """Open the port, for this process alone."""
        self._port = ports.opened(self._name, baud, self._dialect.timeout_s, KEY)

    def close(self) -> None:
        """Close the port, if it is open."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def order(self, command: str) -> None:
        """A command that changes something: acknowledged, or followed by a look into the error queue."""
        d = self._dialect
        for attempt in range(TRIES):
            reply = None
            try:
                self.send(command)
                if d.acknowledge is not None:
                    reply = self.reply(d.acknowledge)
                    if not re.fullmatch(d.acknowledge, reply):
                        raise self._disappointment(command, reply)
                if error := self._error():
                    raise Nak(f'the lamp on {self._name} refuses "{command}": {error}')
            except DeviceError as failure:
                last = failure
                self.calm(missing=reply == "")
                continue
            if attempt:
                log.warning("lamp on %s: %s; obeyed at attempt %d", self._name, last, attempt + 1)
            return
        raise last

    def ask(self, query: str, expected: str) -> str:
        """A query and its reply; `expected` is the pattern of a usual one, which the caller compares."""
        for attempt in range(TRIES):
            self.send(query)
            reply = self.reply(expected)
            if not reply or any(p and re.fullmatch(p, reply) for p in (self._dialect.refuse, self._dialect.banner)):
                last = self._disappointment(query, reply)
                self.calm(missing=not reply)
                continue
            if attempt:
                log.warning("lamp on %s: %s; answered at attempt %d", self._name, last, attempt + 1)
            return reply
        raise last

    def _disappointment(self, command: str, reply: str) -> DeviceError:
        if not reply:
            return PassingFault(f'the lamp on {self._name} does not answer "{command}"', "lamp")
        return Nak(f'the lamp on {self._name} answers "{command}" with "{reply}"')

    def number(self, query: str, pattern: str) -> float:
        """The number in the reply to a query, the first group of `pattern`."""
        for _ in range(TRIES):
            reply = self.ask(query, pattern)
            found = re.fullmatch(pattern, reply)
            try:
                return float(found.group(1))  # type: ignore[union-attr]
            except (AttributeError, ValueError):
                self.calm(missing=False)
        raise DeviceError(f'the lamp on {self._name} answers "{reply}" where a number was expected')

    def send(self, command: str) -> None:
        """Write a command; what came before it is dropped."""
        if self._port is None:
            raise DeviceError(f"the lamp on {self._name} is not open: enter the rig first")
        self._sent.append(command.strip())
        self._lines.clear()
        with ports.in_use(self._name, KEY):
            self._port.reset_input_buffer()
            ports.send(self._port, (command + self._dialect.send_ending).encode())

    def shout(self, orders: Sequence[bytes]) -> None:
        """Write whole orders at once, from whatever thread; what is answered to them nobody awaits. Never raises."""
        port = self._port
        if port is not None:
            with contextlib.suppress(*ports.FAILURES, TypeError, ValueError):  # it may be closed meanwhile
                for order in orders:
                    ports.send(port, order)

    def reply(self, good: str) -> str:
        """The line that is `good`; where none comes in time, the first one that may be meant as the answer.

        That is none that refuses, greets or is `good` itself: an echo (some controllers return what was sent), the
        acknowledgement of an earlier command, or a line that nobody has asked for may come before the answer.
        """
        assert self._port is not None
        d, answer = self._dialect, ""
        end = clock.monotonic() + float(self._port.timeout)
        while line := self.next():
            if any(pattern is not None and re.fullmatch(pattern, line) for pattern in (good, d.refuse, d.banner)):
                answer = line
                break
            if line not in self._sent and not re.fullmatch(d.acknowledge or "(?!)", line):
                answer = answer or line
            if clock.monotonic() > end:
                break
        self._silent = self._silent and not answer
        return answer

    def next(self) -> str:
        """One line without its ending and without a prompt; empty where no whole one comes in time."""
        assert self._port is not None
        end = clock.monotonic() + float(self._port.timeout)
        with ports.in_use(self._name, KEY):
            while not self._lines:
                raw = self._port.read_until(self._ending)
                if raw and not raw.endswith(self._ending):  # this computer, or the adapter, was held up in mid-line
                    raw += self._port.read_until(self._ending)
                if not raw.endswith((self._ending, b"\r", b"\n")):
                    return ""  # half a number is none
                parts = re.split(r"[\r\n]+", str(raw, "ascii", "replace"))
                self._lines.extend(text for part in parts if (text := self._without_prompt(part)))
                if not raw.endswith(self._ending) and self._lines and self._lines[-1] not in self._sent:
                    self._ending = raw[-1:]  # an echo may end otherwise than an answer
                    log.warning(
                        "lamp on %s: its lines end with %r, and reply_ending of its dialect is %r",
                        self._name, self._ending.decode(), self._dialect.reply_ending,
                    )  # fmt: skip
                if clock.monotonic() > end:
                    break
        return self._lines.popleft() if self._lines else ""

    def _without_prompt(self, text: str) -> str:
        prompt, text = (self._dialect.prompt or "").strip(), text.strip()
        while prompt and text.startswith(prompt):
            text = text.removeprefix(prompt).strip()
        return text

    def calm(self, *, missing: bool) -> None:
        """Let what is still on its way arrive, and drop it; for one that answers late, wait longer from now on."""
        if self._port is None:
            return
        timeout_s = self._port.timeout
        with ports.in_use(self._name, KEY):
            if missing and not self._silent:  # of one that says nothing at all no more is awaited
                begun = clock.monotonic()
                self._port.timeout = LATENESS * timeout_s
                late = self.next()
                self._port.timeout = timeout_s
                self._silent = not late
                if late and not re.fullmatch(self._dialect.banner or "", late):
                    timeout_s += 2 * (clock.monotonic() - begun)
                    timeout_s = min(timeout_s, SLOWEST * self._dialect.timeout_s)
                    self._port.timeout = timeout_s
                    log.warning(
                        "lamp on %s: it answers late; waiting for %.1f s from now on (timeout_s of its dialect)",
                        self._name, timeout_s,
                    )  # fmt: skip
            clock.sleep(0.05)
            self._lines.clear()
            self._port.reset_input_buffer()

    def _error(self) -> str:
        """The next entry of the error queue; "" where there is none."""
        d = self._dialect
        error = "" if d.error_query is None else self.ask(d.error_query, f"{d.no_error}|{ERROR}")
        return "" if re.fullmatch(d.no_error, error) else error

    def drain_errors(self) -> None:
        """Ask for what lies in the error queue until it is empty."""
        for _ in range(ERRORS_KEPT):
            if not self._error():
                return
        raise DeviceError(f"the lamp on {self._name} has an error queue that does not end")
