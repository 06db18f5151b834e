"""Keys of a terminal that is read one by one: a line that is typed, and arrows that jog."""

import codecs
from collections.abc import Sequence
from dataclasses import dataclass

STEPS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
FIRST_STEP = 5
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
END_OF_INPUT = "\x04"
ESCAPE = "\x1b"


@dataclass(frozen=True, slots=True)
class Line:
    """A line was finished."""

    text: str


@dataclass(frozen=True, slots=True)
class Jog:
    """An arrow was pressed."""

    axis: str
    degrees: float


@dataclass(frozen=True, slots=True)
class End:
    """There will be no more: Ctrl-D."""


class JogKeys:
    """What is typed: bytes in, and what they mean out.

    Left and right jog an axis by a step; up and down choose the step, Tab the axis. Ctrl-U takes a line back.

    Parameters
    ----------
    axes
        Names of the axes, the first one is chosen.
    """

    def __init__(self, axes: Sequence[str]) -> None:
        self.typed = ""
        """Of the line so far."""
        self._axes, self._axis, self._step = list(axes), 0, FIRST_STEP
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._escape = ""

    @property
    def axis(self) -> str:
        """The axis that arrows jog."""
        return self._axes[self._axis]

    @property
    def step_deg(self) -> float:
        """By how much [deg]."""
        return STEPS_DEG[self._step]

    def feed(self, data: bytes) -> list[Line | Jog | End]:
        """What some bytes of the terminal mean; an escape sequence may come in parts."""
        out: list[Line | Jog | End] = []
        for character in self._decoder.decode(data):
            if self._escape or character == ESCAPE:
                self._in_escape(character, out)
            elif character in "\r\n":
                out.append(Line(self.typed))
                self.typed = ""
            elif character in "\x7f\b":
                self.typed = self.typed[:-1]
            elif character == "\x15":
                self.typed = ""
            elif character == "\t":
                self._axis = (self._axis + 1) % len(self._axes)
            elif character == END_OF_INPUT:
                out.append(End())
            elif character.isprintable():
                self.typed += character
        return out

    def _in_escape(self, character: str, out: list[Line | Jog | End]) -> None:
        """ESC [ A, or ESC O A; other sequences end with a letter or ~, and mean nothing."""
        self._escape += character
        if len(self._escape) == 1 or (len(self._escape) == 2 and character in "[O"):
            return
        if not (character.isalpha() or character == "~" or len(self._escape) == 2):
            return
        sequence, self._escape = self._escape, ""
        arrow = ARROWS.get(sequence[2:], "")
        if arrow == "up":
            self._step = min(self._step + 1, len(STEPS_DEG) - 1)
        elif arrow == "down":
            self._step = max(self._step - 1, 0)
        elif arrow:
            out.append(Jog(self.axis, self.step_deg if arrow == "right" else -self.step_deg))
