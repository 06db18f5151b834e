"""`gonio rig align`: the zeros of the axes, from scans over a mirror and straight through an empty holder.

`gonio rig align --live`: a live picture on a page, and a prompt that jogs, lights the lamp and sets zeros. Keys of a
terminal are read one by one: a line that is typed, and arrows that jog.
"""

import codecs
import contextlib
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from gonio import lost, platform
from gonio.cli import console
from gonio.disk import put_picture
from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.by_hand import alignment, rig_file
from gonio.lab.by_hand.alignment_scans import Scans
from gonio.lab.by_hand.assistant import Assistant
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.commands.opened import free_name, holding, manual_rig_of, put, require_new, require_rig_file, told_where
from gonio.lab.live.alignment import AlignmentPage
from gonio.lab.live.server import Server
from gonio.lab.rig.description import RigDescription
from gonio.shown import apart, number, visible

PROMPTS = {
    "mirror": "Put a front-surface mirror into the holder, as the sample lies",
    "empty": "Take the mirror out: the holder is empty, and nothing stands between the arms",
    "sample": "Put the sample back into the holder",
}


def align(
    rig: str, out: Path, only: str, again: Sequence[Path], *, search_deg: float, seed: int, yes: bool
) -> None:  # fmt: skip
    """Scan, or take the scans of earlier alignments, and write the zeros that they lead to into a copy of a rig file.

    Parameters
    ----------
    rig, out
        The rig file, and the copy.
    only
        Which scans: "both", "mirror" or "straight".
    again
        Files of scans: these are fitted, and nothing moves.
    search_deg
        How far to look for the lamp.
    seed
        Of a simulated rig.
    yes
        Nobody is asked for what has to lie in the holder.

    Raises
    ------
    ConfigError
        A file is not there, or is where it must not be; the arms cannot make the scans.
    DataError
        The scans determine no zero.
    """
    require_rig_file(rig)
    require_new(out)
    picture = free_name(out, "residuals", ".png")
    if again:
        description, table = find_rig(rig).description, _joined([alignment.read(path) for path in again])
    else:
        manual = manual_rig_of(rig, "arms", "light", "camera", seed=seed)
        scans = Scans(manual, search_deg=search_deg, say=console.note)
        _take(rig, manual, scans, only, free_name(out, "scans", ".csv"), yes=yes)
        description, table = manual.description, scans.table
    found = alignment.align(table, description)
    with lost.whole(out):
        pictures = put_picture(picture, lambda: alignment.draw(table, found))
        _show(found, description)
        values = alignment.zero_values(found, description)
        if not values:
            raise DataError(f"{out} is not written: these scans determine no zero alone")
        rig_file.write_values(rig, values, out=out)
        console.show(f"{out}: {', '.join(found.zeros)}", *map(str, pictures))


def _take(rig: str, manual: ManualRig, scans: Scans, only: str, file: Path, *, yes: bool) -> None:
    """The scans, which are kept whatever ends them."""
    straight = only != "mirror"
    if straight and not scans.facing():
        if only == "straight":
            raise ConfigError(f"{rig}: {scans.why_not_facing()}")
        console.note(f"{rig}: {scans.why_not_facing()}. The mirror scan is made alone")
        straight = False
    try:
        with told_where(manual), manual:
            if only != "straight":
                put(manual, "mirror", PROMPTS["mirror"], yes=yes)
                scans.mirror()
            if straight:
                manual.lamp(False)  # hands are in the beam now
                put(manual, "empty", PROMPTS["empty"], yes=yes)
                scans.straight_through()
            manual.lamp(False)
            put(manual, "sample", PROMPTS["sample"], yes=True)  # nobody has to press a key for it
    finally:
        if len(scans.table):
            alignment.write(scans.table, file)
            console.note(f"{file}: {scans.table['scan'].nunique()} scans")
    console.note("lamp dark, arms parked; put the sample back")


def _joined(tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Scans of several files, numbered on."""
    first = 0
    for table in tables:
        table["scan"] += first
        first = int(table["scan"].max())
    joined: pd.DataFrame = pd.concat(tables, ignore_index=True)
    return joined


def _show(found: alignment.Alignment, description: RigDescription) -> None:
    table = console.table(
        "axis", "zero_offset_deg", "was", "u (k = 1)", "of it: scans", "encoder", "backlash", "departures"
    )
    for name, zero in found.zeros.items():
        known = description.axes()[name]
        was = f"{known.zero_offset_deg:.3f}" if known.zero_offset_known else "not known"
        now, u = apart(zero.offset_deg, zero.u_deg)
        table.add_row(name, now, was, u, *(number(part, 2) for part in zero.parts.values()))
    rows = console.table("scan", "holder", "axis", "light [deg]", "centre [deg]", "u [deg]", "residual [deg]")
    for r in found.scans.itertuples():
        numbers = (f"{r.at_deg:.2f}", f"{r.centre_deg:.3f}", f"{r.u_deg:.3f}", f"{r.residual_deg:+.3f}")
        rows.add_row(str(r.scan), str(r.holder), str(r.axis), *numbers)
    console.show(table, rows, f"rank {found.rank} of {len(found.axes)} ({', '.join(found.axes)})")
    if "light" in found.zeros:
        i, j = found.axes.index("light"), found.axes.index("camera")
        c = found.covariance
        console.show(f"correlation of light and camera: {c[i, j] / (c[i, i] * c[j, j]) ** 0.5:+.2f}")
    console.show(*(f"not determined: {sentence}" for sentence in found.open))


STEPS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
FIRST_STEP = 5
ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
END_OF_INPUT = "\x04"
ESCAPE = "\x1b"


@dataclass(frozen=True, slots=True)
class LineDone:
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

    def feed(self, data: bytes) -> list[LineDone | Jog | End]:
        """What some bytes of the terminal mean; an escape sequence may come in parts."""
        out: list[LineDone | Jog | End] = []
        for character in self._decoder.decode(data):
            if self._escape or character == ESCAPE:
                self._in_escape(character, out)
            elif character in "\r\n":
                out.append(LineDone(self.typed))
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

    def _in_escape(self, character: str, out: list[LineDone | Jog | End]) -> None:
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


REFRESH_S = 0.25
CLEAR = "\r\x1b[K"
END_S = 0.7
"""How long the page is served after the session's end: pictures that a browser has asked for are on their way."""


def live(
    rig: str, out: Path, sample: Path | None, *,
    seed: int, host: str, port: int, keep_s: float, wavelength: float | None,
) -> None:  # fmt: skip
    """The session, until `quit`, the end of the input, or a signal. The lamp is dark afterwards, and the arms hold."""
    file = Path(rig) if Path(rig).is_file() else None
    require_new(out)
    manual = manual_rig_of(rig, "arms", "light", "camera", sample=sample, seed=seed)
    if wavelength is not None:
        manual.choose_band(wavelength)
    page, terminal = AlignmentPage(), Terminal(list(manual.description.axes()))
    assistant = Assistant(manual, tell=page.tell, say=terminal.say, rig_file=file, out=out, keep_s=keep_s)
    with Server(page.routes, page.events, host, port) as server:
        print(server.address, flush=True)
        try:
            with told_where(manual), manual, terminal.listening(assistant):
                if manual.can_hold:
                    manual.hold()
                terminal.say("lamp on lights the lamp; help lists what else there is")
                assistant.run()
        finally:
            page.end(dark=bool(getattr(manual.light, "known_dark", not assistant.timer.left_s)))
            if page.seen:
                time.sleep(END_S)
    console.note(holding(manual))


class Terminal:
    """The person's terminal: a status line with what is being typed; or, where there is none, lines of a pipe."""

    def __init__(self, axes: list[str]) -> None:
        self._keys, self._terminal = JogKeys(axes), platform.Keys()
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._assistant: Assistant | None = None
        self._drawn = False

    def say(self, text: str) -> None:
        """A line on stderr, above the status line."""
        with self._lock:
            print((CLEAR if self._drawn else "") + visible(text), file=sys.stderr, flush=True)
            self._drawn = False

    @contextlib.contextmanager
    def listening(self, assistant: Assistant) -> Iterator[None]:
        """Read in a thread of its own; the terminal is as it was afterwards."""
        self._assistant = assistant
        keys = sys.stdin.isatty() and sys.stderr.isatty()
        with self._terminal if keys else contextlib.nullcontext():
            reader = threading.Thread(
                target=self._read_keys if keys else self._read_lines, name="terminal", daemon=True
            )
            reader.start()
            try:
                yield
            finally:
                self._ended.set()
                if keys:
                    reader.join(2.0 * REFRESH_S)
                with self._lock:
                    print(CLEAR if self._drawn else "", end="", file=sys.stderr, flush=True)
                    self._drawn = False

    def _read_lines(self) -> None:
        assert self._assistant is not None
        for line in sys.stdin:
            if self._ended.is_set():
                return
            self._assistant.alive()
            self._assistant.orders.put(line)
        self._assistant.orders.put("quit")

    def _read_keys(self) -> None:
        assistant = self._assistant
        assert assistant is not None
        while not self._ended.is_set():
            try:
                data = self._terminal.read(REFRESH_S)
            except EOFError:
                assistant.orders.put("quit")
                return
            if data:
                assistant.alive()
                for what in self._keys.feed(data):
                    self._act(what, assistant)
            self._draw(assistant.status)

    def _act(self, what: LineDone | Jog | End, assistant: Assistant) -> None:
        if isinstance(what, Jog):
            assistant.nudge(what.axis, what.degrees)
        elif isinstance(what, End):
            assistant.orders.put("quit")
        elif what.text.strip():
            self.say(f"> {what.text}")
            assistant.orders.put(what.text)

    def _draw(self, status: str) -> None:
        keys = self._keys
        prompt = f"[{keys.axis} {keys.step_deg:g} deg] > {keys.typed}"
        room = shutil.get_terminal_size().columns - 1
        status = visible(status)
        text = f"{status}  {prompt}"
        if len(text) > room:
            text = f"{status[: max(room - len(prompt) - 2, 0)]}  {prompt}"[-room:]
        with self._lock:
            print(CLEAR + text, end="", file=sys.stderr, flush=True)
            self._drawn = True
