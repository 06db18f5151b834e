"""A lamp on a serial port: one driver, and the language of its controller as data.

Nothing is believed that was not read back: every setting is followed by its query, and the lamp counts as dark or lit
only when its controller says so. It is darkened when the port is opened, when it is left, and after every failure;
`guard` darkens it when the program is killed.
"""

from __future__ import annotations

import logging
import re
import time
from collections import deque
from types import TracebackType
from typing import Self

import serial

from gonio.errors import ConfigError, DeviceError
from gonio.rig.description import Band, RigDescription
from gonio_drivers import ports, settings
from gonio_drivers.dialect import dialect
from gonio_drivers.guard import Guard

log = logging.getLogger("gonio.devices")

TRIES = 3
LATENESS = 2.0
"""How much longer than its timeout a missing reply is awaited, so that it is not taken for the next one's."""
SLOWEST = 10.0
"""Longest wait for a controller that answers late, in timeouts of its dialect."""
ERROR = r"[-+]?\d.*"
"""What an entry of an error queue looks like: a number first."""
ERRORS_KEPT = 100
"""No controller's error queue holds more."""
WAVELENGTH_STEP_NM = 0.1


class Nak(DeviceError):
    """The controller refuses a command."""


class LampReset(DeviceError):
    """The lamp was not in the state that it was meant to be in."""


class SerialLight:
    """A lamp, as a `LightDevice`; dark whenever it is not asked to shine.

    Parameters
    ----------
    description
        The rig: its bands, and the lamp's warm-up time.
    light
        Port, dialect, level, channels.
    """

    def __init__(self, description: RigDescription, light: settings.Light) -> None:
        self._light = light
        self._dialect = dialect(light.dialect)
        self._bands = description.bands.all()
        self._warm_up_s = description.lamp.warm_up_s
        self._port: serial.Serial | None = None
        self._guard: Guard | None = None
        self._channel = light.channel
        self._band: Band | None = None
        self._lit_since: float | None = None
        self._monitored: float | None = None
        self._silent = False
        """It has not answered for longer than even a late answer takes."""
        self._sent: deque[str] = deque(maxlen=4)
        """The last commands, as an echo would return them."""
        self._ending = self._dialect.reply_ending.encode()
        self._lines: deque[str] = deque()
        """Lines that have come together, and have not been looked at."""
        self._warmed = False
        self.identity = ""
        self.lit = False
        """Whether the lamp is meant to shine."""
        for name in light.channels:
            if name not in {band.name for band in self._bands}:
                known = ", ".join(band.name for band in self._bands[:8])
                raise ConfigError(f'devices.light.channels."{name}": the rig has no such band; it has {known}')

    def __enter__(self) -> Self:
        ports.require_free(self._light.port, "devices.light.port")
        baud = int(self._light.baud or self._dialect.baud)
        try:
            self._port = serial.Serial(
                self._light.port,
                baud,
                timeout=self._dialect.timeout_s,
                exclusive=True,
            )
        except (*ports.FAILURES, ValueError) as error:
            raise ports.unopened(self._light.port, error, "devices.light.port") from None
        try:
            self._wake()
            self.off()
            self._guard = Guard(self._light.port, baud, self._orders_to_darken())
            try:
                self._guard.start()
            except OSError as error:
                log.warning("lamp on %s: nothing darkens it after a kill -9: %s", self._light.port, error)
        except BaseException:
            self._close(in_order=False)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        dark = False
        try:
            self.off()
            dark = True
        finally:
            self._close(in_order=dark)

    # ---- LightDevice ----

    def select(self, band: Band) -> None:
        """Choose the spectral band: a wavelength, or the channel of its emitter."""
        if band not in self._bands:
            raise ConfigError(f'the rig has no band "{band.name}"')
        if band == self._band:
            return
        channel = self._light.channels.get(band.name, self._light.channel)
        d = self._dialect
        if channel != self._channel and self.lit:
            self._off()
            self._channel = channel
            self._shine()
            time.sleep(self._light.settle_s)
        self._channel = channel
        if d.select is not None and d.selected is not None:
            wanted = band.centre_nm
            self._set(
                d.select.format(wavelength_nm=wanted, channel=channel),
                d.selected,
                d.selected_got,
                wanted,
                WAVELENGTH_STEP_NM,
            )
            if self.lit:
                time.sleep(self._light.settle_s)
        self._band = band

    def on(self) -> None:
        """Light up at the level of the rig file, and wait until the lamp has settled."""
        try:
            self._shine()
        except BaseException:
            self.off()
            raise
        self._settle()

    def off(self) -> None:
        """Darken.

        Raises
        ------
        DeviceError
            The controller does not say that the lamp is dark.
        """
        self.lit, self._lit_since = False, None
        try:
            self._off()
        except DeviceError as failure:
            raise DeviceError(f"{failure}; the lamp may still be lit: switch it off by hand") from None

    def check(self) -> None:
        """Ask the controller whether the lamp is as it is meant to be; light it again where it has gone dark.

        Raises
        ------
        LampReset
            It was not; what has been exposed since the last look is worth nothing.
        """
        d = self._dialect
        answer = self._ask(d.state.format(channel=self._channel), f"{d.state_on}|{d.state_off}")
        as_meant = re.fullmatch(d.state_on if self.lit else d.state_off, answer) is not None
        if as_meant and (not self.lit or (self._level_kept() and self._band_kept())):
            return
        if not self.lit:
            self.off()
            raise LampReset("the lamp was lit when it should have been dark; darkened")
        log.warning("lamp on %s: it has gone dark, or lost its settings, by itself; lit again", self._light.port)
        band, self._band = self._band, None
        if band is not None:
            self.select(band)
        self._shine()
        time.sleep(self._light.settle_s)
        raise LampReset("the lamp went dark, or lost its settings, by itself")

    def monitor(self) -> float | None:
        """Reading of the monitor photodiode in its own unit; None where the controller has none."""
        d = self._dialect
        if d.monitor is None:
            return None
        return self._number(d.monitor.format(channel=self._channel), d.monitor_got)

    def __str__(self) -> str:
        return f"{self.identity or self._dialect.name} on {self._light.port}"

    # ---- inside ----

    def _wake(self) -> None:
        d = self._dialect
        if d.banner is not None:
            end = time.monotonic() + d.banner_s
            while not re.fullmatch(d.banner, self._line()):
                if time.monotonic() > end:
                    log.warning("lamp on %s: no banner within %g s; asking anyway", self._light.port, d.banner_s)
                    break
        for command in d.start:
            self._send(command)
            self._reply(d.acknowledge or "")
        try:
            for _ in range(TRIES):
                self.identity = self._ask(d.identify, d.identity)
                if re.fullmatch(d.identity, self.identity):
                    break
                self._calm(missing=False)  # it may have answered what another program asked, or half a line
        except DeviceError as failure:
            raise DeviceError(
                f'devices.light.port = "{self._light.port}": {failure}; is it on, is devices.light.dialect = '
                f'"{self._light.dialect}" its language, and devices.light.baud = {self._light.baud or d.baud:g} its '
                "line speed?"
            ) from None
        if not re.fullmatch(d.identity, self.identity):
            raise DeviceError(
                f'devices.light.dialect = "{self._light.dialect}": the lamp on {self._light.port} says it is '
                f'"{self.identity}", which is no {d.name} controller; correct the dialect, or devices.light.port'
            )
        self._drain_errors()

    def _shine(self) -> None:
        d = self._dialect
        value = self._light.level * d.full_scale
        command = d.set.format(value=value, channel=self._channel)
        self._set(command, d.get.format(channel=self._channel), d.got, value, d.resolution)
        self._switch(d.on, d.state_on, self._channel)
        self.lit = True

    def _off(self) -> None:
        for channel in self._channels_to_darken():
            self._switch(self._dialect.off, self._dialect.state_off, channel)

    def _channels_to_darken(self) -> list[int]:
        channels = sorted({self._light.channel, *self._light.channels.values()})
        return channels if "{channel}" in self._dialect.off else channels[:1]

    def _orders_to_darken(self) -> list[bytes]:
        d = self._dialect
        return [(d.off.format(channel=channel) + d.send_ending).encode() for channel in self._channels_to_darken()]

    def _switch(self, command: str, wanted: str, channel: int) -> None:
        d = self._dialect
        for _ in range(TRIES):
            self._order(command.format(channel=channel))
            state = self._ask(d.state.format(channel=channel), f"{d.state_on}|{d.state_off}")
            if re.fullmatch(wanted, state):
                return
            log.warning('lamp on %s: after "%s" its state is "%s"; repeated', self._light.port, command, state)
        raise DeviceError(f'the lamp on {self._light.port} does not obey "{command}": its state is "{state}"')

    def _set(self, command: str, query: str, pattern: str, value: float, resolution: float) -> None:
        """A setting, read back; `resolution` is the largest difference that is none."""
        for _ in range(TRIES):
            self._order(command)
            got = self._number(query.format(channel=self._channel), pattern)
            if abs(got - value) <= resolution:
                return
            log.warning('lamp on %s: after "%s" it reads back %g; repeated', self._light.port, command, got)
        raise DeviceError(f'the lamp on {self._light.port} does not obey "{command}": it reads back {got:g}')

    def _level_kept(self) -> bool:
        d = self._dialect
        got = self._number(d.get.format(channel=self._channel), d.got)
        kept = abs(got - self._light.level * d.full_scale) <= d.resolution
        if kept and self._light.monitor_tolerance is not None and (seen := self.monitor()) is not None:
            first = self._monitored = self._monitored or seen
            if not first > 0:
                raise DeviceError(f"the lamp's monitor reads {first:g} while the lamp is lit: is it connected?")
            if abs(seen / first - 1) > self._light.monitor_tolerance:
                raise DeviceError(
                    f"the lamp's monitor reads {seen:g}, and read {first:g} after lighting up: more than "
                    f"devices.light.monitor_tolerance = {self._light.monitor_tolerance:g} apart"
                )
        return kept

    def _band_kept(self) -> bool:
        d = self._dialect
        if d.selected is None or self._band is None:
            return True
        return abs(self._number(d.selected, d.selected_got) - self._band.centre_nm) <= WAVELENGTH_STEP_NM

    def _settle(self) -> None:
        now = time.monotonic()
        first = self._lit_since is None
        if self._lit_since is None:
            self._lit_since = now
        wait = self._light.settle_s
        if first and not self._warmed:
            wait = max(wait, self._warm_up_s)
            self._warmed = True
        time.sleep(wait)
        self._monitored = self.monitor() if self._light.monitor_tolerance is not None else None

    # ---- the line ----

    def _order(self, command: str) -> None:
        """A command that changes something: acknowledged, or followed by a look into the error queue."""
        d = self._dialect
        last: DeviceError | None = None
        for attempt in range(TRIES):
            reply = None
            try:
                self._send(command)
                if d.acknowledge is not None:
                    reply = self._reply(d.acknowledge)
                    if not re.fullmatch(d.acknowledge, reply):
                        raise self._disappointment(command, reply)
                if d.error_query is not None:
                    error = self._ask(d.error_query, f"{d.no_error}|{ERROR}")
                    if not re.fullmatch(d.no_error, error):
                        raise Nak(f'the lamp on {self._light.port} refuses "{command}": {error}')
            except DeviceError as failure:
                last = failure
                self._calm(missing=reply == "")
                continue
            if attempt:
                log.warning("lamp on %s: %s; obeyed at attempt %d", self._light.port, last, attempt + 1)
            return
        assert last is not None
        raise last

    def _ask(self, query: str, expected: str) -> str:
        """A query and its reply; `expected` is the pattern of a usual one, which the caller compares."""
        last: DeviceError | None = None
        for attempt in range(TRIES):
            self._send(query)
            reply = self._reply(expected)
            if reply and not any(p and re.fullmatch(p, reply) for p in (self._dialect.refuse, self._dialect.banner)):
                if attempt:
                    log.warning("lamp on %s: %s; answered at attempt %d", self._light.port, last, attempt + 1)
                return reply
            last = self._disappointment(query, reply)
            self._calm(missing=not reply)
        assert last is not None
        raise last

    def _disappointment(self, command: str, reply: str) -> DeviceError:
        if not reply:
            return DeviceError(f'the lamp on {self._light.port} does not answer "{command}"')
        return Nak(f'the lamp on {self._light.port} answers "{command}" with "{reply}"')

    def _number(self, query: str, pattern: str) -> float:
        for _ in range(TRIES):
            reply = self._ask(query, pattern)
            found = re.fullmatch(pattern, reply)
            try:
                return float(found.group(1))  # type: ignore[union-attr]
            except (AttributeError, ValueError):
                self._calm(missing=False)
        raise DeviceError(f'the lamp on {self._light.port} answers "{reply}" where a number was expected')

    def _send(self, command: str) -> None:
        if self._port is None:
            raise DeviceError(f"the lamp on {self._light.port} is not open: enter the rig first")
        try:
            self._sent.append(command.strip())
            self._lines.clear()
            self._port.reset_input_buffer()
            ports.send(self._port, (command + self._dialect.send_ending).encode())
        except ports.FAILURES as error:
            raise ports.lost(self._light.port, error, "devices.light.port") from None

    def _reply(self, good: str) -> str:
        """The line that is `good`; where none comes in time, the first one that may be meant as the answer.

        That is none that refuses, greets or is `good` itself: an echo (some controllers return what was sent), the
        acknowledgement of an earlier command, or a line that nobody has asked for may come before the answer.
        """
        d = self._dialect
        end = time.monotonic() + self._timeout_s()
        answer = ""
        while line := self._line():
            if any(pattern is not None and re.fullmatch(pattern, line) for pattern in (good, d.refuse, d.banner)):
                answer = line
                break
            if line not in self._sent and not re.fullmatch(d.acknowledge or "(?!)", line):
                answer = answer or line
            if time.monotonic() > end:
                break
        self._silent = self._silent and not answer
        return answer

    def _timeout_s(self) -> float:
        assert self._port is not None
        return float(self._port.timeout)

    def _line(self) -> str:
        """One line without its ending and without a prompt; empty where no whole one comes in time."""
        assert self._port is not None
        end = time.monotonic() + self._timeout_s()
        try:
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
                        self._light.port, self._ending.decode(), self._dialect.reply_ending,
                    )  # fmt: skip
                if time.monotonic() > end:
                    break
        except ports.FAILURES as error:
            raise ports.lost(self._light.port, error, "devices.light.port") from None
        return self._lines.popleft() if self._lines else ""

    def _without_prompt(self, text: str) -> str:
        prompt, text = (self._dialect.prompt or "").strip(), text.strip()
        while prompt and text.startswith(prompt):
            text = text.removeprefix(prompt).strip()
        return text

    def _calm(self, *, missing: bool) -> None:
        """Let what is still on its way arrive, and drop it; for one that answers late, wait longer from now on."""
        if self._port is None:
            return
        timeout_s = self._port.timeout
        try:
            if missing and not self._silent:  # of one that says nothing at all no more is awaited
                begun = time.monotonic()
                self._port.timeout = LATENESS * timeout_s
                late = self._line()
                self._port.timeout = timeout_s
                self._silent = not late
                if late and not re.fullmatch(self._dialect.banner or "", late):
                    timeout_s += 2 * (time.monotonic() - begun)
                    timeout_s = min(timeout_s, SLOWEST * self._dialect.timeout_s)
                    self._port.timeout = timeout_s
                    log.warning(
                        "lamp on %s: it answers late; waiting for %.1f s from now on (timeout_s of its dialect)",
                        self._light.port, timeout_s,
                    )  # fmt: skip
            time.sleep(0.05)
            self._lines.clear()
            self._port.reset_input_buffer()
        except ports.FAILURES as error:
            raise ports.lost(self._light.port, error, "devices.light.port") from None

    def _drain_errors(self) -> None:
        d = self._dialect
        if d.error_query is not None:
            for _ in range(ERRORS_KEPT):
                if re.fullmatch(d.no_error, self._ask(d.error_query, f"{d.no_error}|{ERROR}")):
                    return
            raise DeviceError(f"the lamp on {self._light.port} has an error queue that does not end")

    def _close(self, *, in_order: bool) -> None:
        """Close the port; the guard tries once more where the lamp may not be dark."""
        if self._port is not None:
            self._port.close()
            self._port = None
        if self._guard is not None:
            self._guard.release(in_order=in_order)
            self._guard = None
