"""Lamp controllers in three languages, each written from the language's own side.

`ScpiLamp` is a tunable source, `MightexLamp` and `ArduinoLamp` have an emitter for each of the rig's bands. All tell
the simulated rig through `changed` what they do: lit or dark, band, level.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from gonio.rig import clock
from gonio.rig.bands import Band
from gonio_sim.wire.faults import LAMP, LOCK_QUESTIONS, Faults

Send = Callable[[bytes], None]
RESET_S = 0.3


@dataclass(slots=True)
class Shine:
    """What the lamp does now."""

    lit: bool = False
    level: float = 0.0
    band: Band | None = None


class Lamp:
    """What the three have in common: lines in, lines out, faults, resets.

    Parameters
    ----------
    bands
        Of the rig; channel k has the k-th.
    changed
        Called with what the lamp does now, whenever that changes.
    """

    ending = b"\n"
    bauds: tuple[int, ...] = (9600,)
    resets_on_open = False
    refusal = b""

    def __init__(
        self, bands: tuple[Band, ...], changed: Callable[[Shine], None] | None = None, faults: Faults | None = None
    ) -> None:
        self.bands = bands
        self.shine = Shine(band=bands[0] if bands else None)
        self.faults = faults or Faults()
        self._changed = changed or (lambda shine: None)
        self._buffer = b""
        self._dead_until = 0.0

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        if baud not in self.bauds or clock.monotonic() < self._dead_until:
            return
        self._buffer += data
        while (end := re.search(rb"[\r\n]+", self._buffer)) is not None:
            line, self._buffer = self._buffer[: end.start()], self._buffer[end.end() :]
            if not line.strip():
                continue
            fault = self.faults.take(*LAMP)
            if fault == "lamp-silent":
                continue
            if fault == "lamp-nak":
                self.refuse(line.decode("ascii", "replace"), send)
                continue
            if fault == "lamp-reset":
                self.reset(send)
                continue
            reply = self.command(line.decode("ascii", "replace").strip())
            self._changed(self.shine)
            if reply is not None:
                send(reply.encode() + self.ending)

    def opened(self, send: Send) -> None:
        """Somebody has opened the port; an Arduino restarts at that."""
        if self.resets_on_open:
            self.reset(send)

    def reset(self, send: Send) -> None:
        """Start anew: dark, with default settings."""
        self.shine = Shine(band=self.bands[0] if self.bands else None)
        self._buffer = b""
        self._changed(self.shine)

    def refuse(self, line: str, send: Send) -> None:
        """Answer a line as a wrong one."""
        send(self.refusal + self.ending)

    def command(self, line: str) -> str | None:
        """Carry out a line; its reply."""
        raise NotImplementedError


class ScpiLamp(Lamp):
    """`OUTPut`, `SOURce:LEVel` [%], `SOURce:WAVelength` [nm], `SYSTem:ERRor?`, `MEASure:POWer?`, `SOURce:LOCK?`."""

    bauds = (9600, 115_200)

    def __init__(self, *arguments: object, **keywords: object) -> None:
        super().__init__(*arguments, **keywords)  # type: ignore[arg-type]
        self._errors: list[str] = []
        self._unlocked = 0

    def refuse(self, line: str, send: Send) -> None:
        """The error goes into the queue; a query gets no answer, as SCPI has it."""
        self._errors.append('-200,"Execution error"')

    def reset(self, send: Send) -> None:
        super().reset(send)
        self._errors = []

    def command(self, line: str) -> str | None:
        head, _, argument = line.partition(" ")
        head = head.upper().lstrip(":")
        query = head.endswith("?")
        short = ":".join(_short(word) for word in head.removesuffix("?").split(":"))
        if head == "*IDN?":
            return "Gonio,Twin lamp,0001,1.0"
        if head in ("*RST", "*CLS"):
            self._errors = []
            return None
        if short == "SYST:ERR" and query:
            return self._errors.pop(0) if self._errors else '0,"No error"'
        try:
            return self._subsystem(short, argument.strip(), query=query)
        except ValueError:
            self._errors.append('-222,"Data out of range"')
        except KeyError:
            self._errors.append('-113,"Undefined header"')
        return None

    def _subsystem(self, short: str, argument: str, *, query: bool) -> str | None:
        shine = self.shine
        if short == "OUTP":
            if query:
                return str(int(shine.lit))
            shine.lit = {"ON": True, "1": True, "OFF": False, "0": False}[argument.upper()]
        elif short == "SOUR:LEV":
            if query:
                return f"{100 * shine.level:.2f}"
            shine.level = _within(float(argument), 0, 100) / 100
        elif short == "SOUR:WAV":
            if query:
                return f"{shine.band.centre_nm:.1f}" if shine.band else "0.0"
            nm = float(argument)
            near = min(self.bands, key=lambda band: abs(band.centre_nm - nm))
            if abs(near.centre_nm - nm) > near.fwhm_nm / 2:
                raise ValueError
            shine.band = near
        elif short == "SOUR:LOCK" and query:
            if self.faults.take("unlock"):
                self._unlocked = LOCK_QUESTIONS
            self._unlocked -= self._unlocked > 0
            return str(int(not self._unlocked))
        elif short == "MEAS:POW" and query:
            return f"{1e-3 * shine.level * shine.lit:.6e}"
        else:
            raise KeyError(short)
        return None


class MightexLamp(Lamp):
    """`MODE`, `NORMAL`, `CURRENT`, `?MODE`, `?CURRENT`, `DEVICEINFO`; currents in mA, a channel for each band."""

    ending = b"\n\r"
    refusal = b"#!"

    def __init__(self, *arguments: object, **keywords: object) -> None:
        super().__init__(*arguments, **keywords)  # type: ignore[arg-type]
        self._mode = dict.fromkeys(range(1, max(1, len(self.bands)) + 1), 0)
        self._current = {channel: (1000, 0) for channel in self._mode}

    def reset(self, send: Send) -> None:
        super().reset(send)
        self._mode = dict.fromkeys(self._mode, 0)
        self._current = {channel: (1000, 0) for channel in self._mode}

    def command(self, line: str) -> str | None:
        word, *arguments = line.upper().split()
        try:
            numbers = [int(argument) for argument in arguments]
            reply = self._known(word, numbers)
        except (ValueError, KeyError, IndexError):
            return "#!"
        return f"{word} is not defined" if reply is None else reply

    def _known(self, word: str, numbers: list[int]) -> str | None:
        if word == "ECHOOFF":
            return "##"
        if word == "DEVICEINFO":
            return "Mightex-like LED controller: twin, Device Module No.: SLC-TWIN, Serial No.:0001"
        if word == "MODE":
            channel, mode = numbers
            if mode not in (0, 1) or channel not in self._mode:
                return "#!"
            self._mode[channel] = mode
        elif word == "NORMAL":
            channel, most, now = numbers
            if not 0 <= now <= most <= 1000 or channel not in self._mode:
                return "#!"
            self._current[channel] = (most, now)
        elif word == "CURRENT":
            channel, now = numbers
            most, _ = self._current[channel]
            if not 0 <= now <= most:
                return "#!"
            self._current[channel] = (most, now)
        elif word == "?MODE":
            return f"#{self._mode[numbers[0]]}"
        elif word == "?CURRENT":
            most, now = self._current[numbers[0]]
            return f"#128 256 {most} {now}"
        else:
            return None
        lit = [channel for channel, mode in self._mode.items() if mode]
        level = self._current[lit[0]][1] / 1000 if lit else 0.0
        band = self.bands[lit[0] - 1] if lit and self.bands else None
        self.shine = Shine(bool(lit), level, band)
        return "##"


class ArduinoLamp(Lamp):
    """`ID`, `SET channel level`, `GET channel`, `ON channel`, `OFF`, `STATE`, `PD`; restarts when it is opened."""

    bauds = (115_200,)
    ending = b"\r\n"
    refusal = b"ERR bad command"
    resets_on_open = True

    def __init__(self, *arguments: object, **keywords: object) -> None:
        super().__init__(*arguments, **keywords)  # type: ignore[arg-type]
        self._levels = dict.fromkeys(range(1, max(1, len(self.bands)) + 1), 0.0)
        self._lit: int | None = None

    def reset(self, send: Send) -> None:
        super().reset(send)
        self._levels = dict.fromkeys(self._levels, 0.0)
        self._lit = None
        clock.sleep(RESET_S)
        send(b"READY gonio lamp 1.2\r\n")

    def command(self, line: str) -> str | None:
        word, *arguments = line.split()
        try:
            reply = self._known(word.upper(), arguments)
        except (ValueError, KeyError, IndexError):
            return "ERR bad argument"
        lit = self._lit
        self.shine = Shine(
            lit is not None, self._levels[lit] if lit else 0.0, self.bands[lit - 1] if lit and self.bands else None
        )
        return reply

    def _known(self, word: str, arguments: list[str]) -> str:
        if word == "ID":
            return "gonio lamp 1.2"
        if word == "SET":
            channel = int(arguments[0])
            if channel not in self._levels:
                return "ERR bad channel"
            self._levels[channel] = _within(float(arguments[1]), 0.0, 1.0)
        elif word == "GET":
            return f"{self._levels[int(arguments[0])]:.4f}"
        elif word == "ON":
            channel = int(arguments[0])
            if channel not in self._levels:
                return "ERR bad channel"
            self._lit = channel
        elif word == "OFF":
            self._lit = None
        elif word == "STATE":
            return "OFF" if self._lit is None else "ON"
        elif word == "PD":
            return f"{self._levels[self._lit] if self._lit else 0.0:.4f}"
        else:
            return "ERR unknown command"
        return "OK"


LAMPS: dict[str, type[Lamp]] = {"scpi": ScpiLamp, "mightex": MightexLamp, "arduino": ArduinoLamp}


def _short(word: str) -> str:
    return {"OUTPUT": "OUTP", "SOURCE": "SOUR", "LEVEL": "LEV", "WAVELENGTH": "WAV", "SYSTEM": "SYST", "ERROR": "ERR",
            "MEASURE": "MEAS", "POWER": "POW"}.get(word, word)  # fmt: skip


def _within(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError
    return value
