"""The health of a rig at every step, and what `[suspend]` in the rig file makes of it: the run waits, and goes on."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.acquisition import exposure
from gonio.errors import ConfigError, DeviceError
from gonio.rig import Frame, Health, Pose, Reading, Rig
from gonio.rig.description import ROOM_LIGHT

LOOK_S = 2.0
"""Between two looks while the run waits."""
NAP_S = 0.1
"""Ctrl-C is heard so soon meanwhile."""
LAMP = "lamp"


@dataclass(frozen=True, slots=True)
class Cause:
    """A rule that is broken, and by which reading."""

    rule: str
    reading: Reading
    limit: str

    def __str__(self) -> str:
        r = self.reading
        value = r.value if isinstance(r.value, str) else f"{r.value:.4g} {r.unit}".strip()
        return f"suspend.{self.rule}: {r.device} {r.quantity} is {value}, and {self.limit} pauses the run"


class Suspended(Exception):
    """A step was exposed while a rule was broken: it counts for nothing."""

    def __init__(self, causes: Sequence[Cause]) -> None:
        super().__init__("; ".join(map(str, causes)))
        self.causes = list(causes)


class Watch:
    """Reads the health of a rig, and judges it by the rules of its file.

    Parameters
    ----------
    rig
        Entered. It may offer `health()`; without one nothing is read but the light in the room.

    Raises
    ------
    ConfigError
        A rule is about a quantity that the rig does not read.
    """

    def __init__(self, rig: Rig) -> None:
        self._description = rig.description
        self._rules = rig.description.suspend
        self._ask: Callable[[], Health] | None = getattr(rig, "health", None)
        self._room_s = exposure.expected_exposure_s(rig.description, Pose(), 1.0)
        if any(rule.quantity != ROOM_LIGHT for rule in self._rules.values()):
            there = self.readings()
            for name, rule in self._rules.items():
                if rule.quantity != ROOM_LIGHT and not any(map(rule.concerns, there)):
                    known = ", ".join(sorted({f'"{r.device}" {r.quantity}' for r in there})) or "nothing"
                    device = f' of device = "{rule.device}"' if rule.device else ""
                    raise ConfigError(
                        f'suspend.{name}: quantity = "{rule.quantity}"{device} is not read on the rig '
                        f'"{self._description.name}"; read are {known}, "frames" {ROOM_LIGHT}'
                    )

    @property
    def room_light(self) -> bool:
        """Whether a rule asks for frames with the lamp off."""
        return any(rule.quantity == ROOM_LIGHT for rule in self._rules.values())

    def readings(self) -> tuple[Reading, ...]:
        """What a journal keeps: numbers that are finite, and words; no angles, which it has as poses."""
        if self._ask is None:
            return ()
        return tuple(_plain(r) for r in self._ask().readings if r.quantity != "angle")

    def room(self, capture: Callable[[float], Frame]) -> Reading:
        """The light in the room, by a frame that is taken with the lamp off."""
        frame = capture(self._room_s)
        dn = float(np.mean(frame.mosaic)) - frame.black_level_dn
        return Reading("frames", ROOM_LIGHT, dn / frame.exposure_s, "DN/s")

    def broken(self, readings: Sequence[Reading], *, lit: bool, waiting: Sequence[str] = ()) -> list[Cause]:
        """Which rules these readings break, by the worst reading of each.

        Parameters
        ----------
        readings
            What was read.
        lit
            Whether the lamp is meant to shine: a dark one says nothing of how it shines.
        waiting
            Rules that are waited for: their quantities have to come back by the hysteresis.

        Raises
        ------
        DeviceError
            A rule's quantity was not read.
        """
        out = []
        for name, rule in self._rules.items():
            seen = [r for r in readings if rule.concerns(r)]
            if not lit and all(r.device == LAMP for r in seen):
                continue
            if not seen and rule.quantity == ROOM_LIGHT:
                continue
            if not seen:
                raise DeviceError(f'suspend.{name}: the rig says nothing of "{rule.quantity}" any more')
            back = rule.hysteresis if name in waiting else 0.0
            found = [r for r in seen if rule.breaks(r.value, back)]
            if found:
                out.append(Cause(name, max(found, key=rule.badness), rule.words(back)))
        return out

    def require_patience(self, causes: Sequence[Cause], since: Mapping[str, float]) -> None:
        """Raise `DeviceError` where a rule is broken for longer than it allows; `since` when, by rule, on a watch."""
        for cause in causes:
            if time.monotonic() - since[cause.rule] > self.longest_s(cause):
                raise DeviceError(
                    f"{cause}; that has not ended within suspend.{cause.rule}.longest_s = {self.longest_s(cause):g} s; "
                    "remove the cause, then go on with --resume"
                )

    def longest_s(self, cause: Cause) -> float:
        """How long a run waits at most [s]."""
        return self._rules[cause.rule].longest_s

    def in_the_dark(self, causes: Sequence[Cause]) -> bool:
        """Whether the lamp is dark while a run waits."""
        return any(self._rules[cause.rule].dark for cause in causes)


def _plain(r: Reading) -> Reading:
    """A reading as JSON can hold it: a number that is none becomes a word."""
    value = r.value if isinstance(r.value, str) else float(r.value)
    countable = isinstance(value, str) or math.isfinite(value)
    return Reading(r.device, r.quantity, value if countable else str(value), r.unit)


def naps(seconds: float) -> Iterator[None]:
    """So long, in naps after which a caller can look whether to go on."""
    end = time.monotonic() + seconds
    yield
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(NAP_S, left))
        yield


def lasting(seconds: float) -> str:
    """A duration, for a person."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def wait(rig: Rig, seconds: float) -> None:
    """Wait so long with a rig that is open; raises `EmergencyStop` as soon as its interlock has stopped it."""
    for _ in naps(seconds):
        require(rig)


def require(rig: Rig) -> None:
    """Raise `EmergencyStop` where the interlock of an open rig has stopped it; nothing on a rig without one."""
    allowed = getattr(rig.light, "allowed", None)
    if allowed is not None:
        allowed()
