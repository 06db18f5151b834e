"""Lamp controllers in three languages, each written from the language's own side.

`ScpiLamp` is a tunable source, `MightexLamp` and `ArduinoLamp` have an emitter for each of the rig's bands. All tell
the simulated rig through `changed` what they do: lit or dark, band, level.
"""

import re
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from gonio.lab.rig import clock
from gonio.lab.rig.light_and_camera import Band
from gonio_sim.wire.faults import LAMP, LOCK_QUESTIONS, Faults
from gonio_sim.wire.peer import Device, Send

RESET_S = 0.3
SHORT = {
    "OUTPUT": "OUTP", "SOURCE": "SOUR", "LEVEL": "LEV", "WAVELENGTH": "WAV", "SYSTEM": "SYST", "ERROR": "ERR",
    "MEASURE": "MEAS", "POWER": "POW",
}  # fmt: skip
"""SCPI's short forms of words."""


@dataclass(slots=True)
class Shine:
    """What the lamp does now."""

    lit: bool = False
    level: float = 0.0
    band: Band | None = None


class LampTwin(Device):
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
        self.faults = faults or Faults()
        self._changed = changed or (lambda shine: None)
        self._begin()

    def _begin(self) -> None:
        """Everything as it is when the power comes: dark, with default settings."""
        self.shine = Shine(band=self.bands[0] if self.bands else None)
        self._buffer = b""

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        if baud not in self.bauds:
            return
        self._buffer += data
        while (end := re.search(rb"[\r\n]+", self._buffer)) is not None:
            line, self._buffer = self._buffer[: end.start()].decode("ascii", "replace"), self._buffer[end.end() :]
            fault = self.faults.take(*LAMP) if line.strip() else "lamp-silent"
            if fault == "lamp-nak":
                self.refuse(send)
            elif fault == "lamp-reset":
                self.reset(send)
            elif fault is None:
                reply = self.command(line.strip())
                self._changed(self.shine)
                if reply is not None:
                    send(reply.encode() + self.ending)

    def opened(self, send: Send) -> None:
        """Somebody has opened the port; an Arduino restarts at that."""
        if self.resets_on_open:
            self.reset(send)

    def reset(self, send: Send) -> None:
        """Start anew: dark, with default settings."""
        self._begin()
        self._changed(self.shine)

    def refuse(self, send: Send) -> None:
        """Answer a line as a wrong one."""
        send(self.refusal + self.ending)

    @abstractmethod
    def command(self, line: str) -> str | None:
        """Carry out a line; its reply."""

    @property
    def channels(self) -> range:
        """Numbers of the emitters: one for each band, and one for a rig without bands."""
        return range(1, max(1, len(self.bands)) + 1)

    def _emits(self, channel: int | None, level: float) -> None:
        """One emitter shines, or None does."""
        self.shine = Shine(channel is not None, level, self.bands[channel - 1] if channel and self.bands else None)


class ScpiLamp(LampTwin):
    """`OUTPut`, `SOURce:LEVel` [%], `SOURce:WAVelength` [nm], `SYSTem:ERRor?`, `MEASure:POWer?`, `SOURce:LOCK?`."""

    bauds = (9600, 115_200)
    _unlocked = 0
    """Number of next questions that are answered "out of lock"."""

    def _begin(self) -> None:
        super()._begin()
        self._errors: list[str] = []

    def refuse(self, send: Send) -> None:
        """The error goes into the queue; a query gets no answer, as SCPI has it."""
        self._errors.append('-200,"Execution error"')

    def command(self, line: str) -> str | None:
        head, _, argument = line.partition(" ")
        head = head.upper().lstrip(":")
        short = ":".join(SHORT.get(word, word) for word in head.removesuffix("?").split(":"))
        if head == "*IDN?":
            return "Gonio,Twin lamp,0001,1.0"
        if head in ("*RST", "*CLS"):
            self._errors = []
            return None
        if short == "SYST:ERR" and head.endswith("?"):
            return self._errors.pop(0) if self._errors else '0,"No error"'
        try:
            if head.endswith("?"):
                return self._asked(short)
            self._told(short, argument.strip())
        except ValueError:
            self._errors.append('-222,"Data out of range"')
        except KeyError:
            self._errors.append('-113,"Undefined header"')
        return None

    def _asked(self, short: str) -> str:
        shine = self.shine
        if short == "SOUR:LOCK":
            self._unlocked = LOCK_QUESTIONS if self.faults.take("unlock") else self._unlocked
            self._unlocked -= self._unlocked > 0
        return {
            "OUTP": str(int(shine.lit)),
            "SOUR:LEV": f"{100 * shine.level:.2f}",
            "SOUR:WAV": f"{shine.band.centre_nm:.1f}" if shine.band else "0.0",
            "SOUR:LOCK": str(int(not self._unlocked)),
            "MEAS:POW": f"{1e-3 * shine.level * shine.lit:.6e}",
        }[short]

    def _told(self, short: str, argument: str) -> None:
        if short == "OUTP":
            self.shine.lit = {"ON": True, "1": True, "OFF": False, "0": False}[argument.upper()]
        elif short == "SOUR:LEV":
            self.shine.level = _within(float(argument), 0, 100) / 100
        elif short == "SOUR:WAV":
            nm = float(argument)
            near = min(self.bands, key=lambda band: abs(band.centre_nm - nm))
            _within(nm, near.centre_nm - near.fwhm_nm / 2, near.centre_nm + near.fwhm_nm / 2)
            self.shine.band = near
        else:
            raise KeyError(short)


class MightexLamp(LampTwin):
    """`MODE`, `NORMAL`, `CURRENT`, `?MODE`, `?CURRENT`, `DEVICEINFO`; currents in mA, a channel for each band."""

    ending = b"\n\r"
    refusal = b"#!"

    def _begin(self) -> None:
        super()._begin()
        self._mode = dict.fromkeys(self.channels, 0)
        self._current = dict.fromkeys(self.channels, (1000, 0))

    def command(self, line: str) -> str | None:
        word, *arguments = line.upper().split()
        try:
            return self._known(word, [int(argument) for argument in arguments])
        except (ValueError, KeyError, IndexError):
            return "#!"

    def _known(self, word: str, numbers: list[int]) -> str:
        match word:
            case "ECHOOFF":
                return "##"
            case "DEVICEINFO":
                return "Mightex-like LED controller: twin, Device Module No.: SLC-TWIN, Serial No.:0001"
            case "?MODE":
                return f"#{self._mode[numbers[0]]}"
            case "?CURRENT":
                most, now = self._current[numbers[0]]
                return f"#128 256 {most} {now}"
            case "MODE":
                channel, mode = numbers
                _within(channel, 1, len(self._mode))
                self._mode[channel] = int(_within(mode, 0, 1))
            case "NORMAL":
                channel, most, now = numbers
                self._limit(channel, most, now)
            case "CURRENT":
                channel, now = numbers
                self._limit(channel, self._current[channel][0], now)
            case _:
                return f"{word} is not defined"
        lit = next((channel for channel, mode in self._mode.items() if mode), None)
        self._emits(lit, self._current[lit][1] / 1000 if lit else 0.0)
        return "##"

    def _limit(self, channel: int, most: int, now: int) -> None:
        """The largest current of a channel, and that of now [mA]."""
        if channel not in self._current or not 0 <= now <= most <= 1000:
            raise ValueError
        self._current[channel] = most, now


class ArduinoLamp(LampTwin):
    """`ID`, `SET channel level`, `GET channel`, `ON channel`, `OFF`, `STATE`, `PD`; restarts when it is opened."""

    bauds = (115_200,)
    ending = b"\r\n"
    refusal = b"ERR bad command"
    resets_on_open = True

    def _begin(self) -> None:
        super()._begin()
        self._levels = dict.fromkeys(self.channels, 0.0)
        self._lit: int | None = None

    def reset(self, send: Send) -> None:
        super().reset(send)
        clock.sleep(RESET_S)
        send(b"READY gonio lamp 1.2\r\n")

    def command(self, line: str) -> str | None:
        word, *arguments = line.split()
        try:
            reply = self._known(word.upper(), arguments)
        except (ValueError, KeyError, IndexError):
            return "ERR bad argument"
        self._emits(self._lit, self._level)
        return reply

    @property
    def _level(self) -> float:
        return self._levels[self._lit] if self._lit else 0.0

    def _known(self, word: str, arguments: list[str]) -> str:
        match word:
            case "ID":
                return "gonio lamp 1.2"
            case "GET":
                return f"{self._levels[int(arguments[0])]:.4f}"
            case "STATE":
                return "OFF" if self._lit is None else "ON"
            case "PD":
                return f"{self._level:.4f}"
            case "SET" | "ON" if int(arguments[0]) not in self._levels:
                return "ERR bad channel"
            case "SET":
                self._levels[int(arguments[0])] = _within(float(arguments[1]), 0.0, 1.0)
            case "ON":
                self._lit = int(arguments[0])
            case "OFF":
                self._lit = None
            case _:
                return "ERR unknown command"
        return "OK"


LAMPS: dict[str, type[LampTwin]] = {"scpi": ScpiLamp, "mightex": MightexLamp, "arduino": ArduinoLamp}


def _within(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise ValueError
    return value
