"""Keys that pause a measurement, on a terminal of the test's own."""

import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gonio.lab.commands.align import End, Jog, JogKeys, LineDone
from tests.command_line import gonio

PATIENCE_S = 300.0
"""For what comes: a busy machine may take many seconds to start the program."""
SCRIPT = """
import sys, time
from pathlib import Path
sys.path.insert(0, {root!r})
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.progress import Pause
from gonio.lab.commands.progress import on_screen
from gonio.errors import GonioError
from tests.gonio.numpy_rig import PLAN, SAMPLE, NumpyRig, Plugin, describe

work = Path(sys.argv[1])
(work / "plan.toml").write_text(PLAN)

class Slow(NumpyRig):
    def begin(self, step):
        super().begin(step)
        if step.index == 2:
            print("READY", flush=True)
            while not (work / "go").exists():
                time.sleep(0.005)

    def present(self, target):
        super().present(target)
        if target == "sample" and self.step == 2:
            print("PROMPT", flush=True)
            print("GOT " + repr(sys.stdin.readline()), flush=True)

class Opens(Plugin):
    def open(self, description, *, sample, seed, confirm):
        return Slow(description, seed)

pause = Pause()
try:
    with on_screen(pause) as progress:
        run = carry_out(load_plan(work / "plan.toml"), RigChoice(Opens(), describe(), "numpy"), work / "run",
                        sample=SAMPLE, seed=1, progress=progress, pause=pause, last=True)
    print("DONE", [event["event"] for event in run.events()].count("paused"), flush=True)
except GonioError as error:
    print("ENDED", error.exit_code, flush=True)
"""


class Terminal:
    """A measurement on a pseudo-terminal of its own, which is its controlling terminal."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        root = str(Path(__file__).parents[3])
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT.format(root=root), str(work)],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            preexec_fn=self._own,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
        )
        self.seen = ""

    def _own(self) -> None:
        import fcntl

        os.setsid()
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    def until(self, text: str) -> None:
        """Read until a text was shown."""
        end = time.monotonic() + PATIENCE_S
        while text not in self.seen:
            assert time.monotonic() < end, self.seen[-2000:]
            ready, _, _ = select.select([self.master], [], [], 0.5)
            if ready:
                self.seen += os.read(self.master, 65536).decode(errors="replace")

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def go(self) -> None:
        (self.work / "go").touch()

    @property
    def as_before(self) -> bool:
        return termios.tcgetattr(self.slave)[3] == self.before[3]


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    out = Terminal(tmp_path)
    yield out
    if out.process.poll() is None:
        out.process.kill()
    out.process.wait()
    os.close(out.master)
    os.close(out.slave)


def test_p_pauses_and_c_goes_on_and_a_prompt_has_the_terminal_for_itself(terminal: Terminal) -> None:
    terminal.until("READY")
    terminal.until("p pauses, q ends the run")
    terminal.press("p")
    terminal.until("pausing: c goes on")
    terminal.go()
    terminal.until("PROMPT")
    terminal.press("yes\n")  # as a whole line, with its echo: the keys are not heard meanwhile
    terminal.until("GOT 'yes\\n'")
    terminal.until("paused before step 3 by a key")
    assert not terminal.as_before
    terminal.press("c")
    terminal.until("DONE 1")
    terminal.process.wait(120)
    assert terminal.as_before


@pytest.mark.parametrize("how", ["q", "SIGTERM"])
def test_the_terminal_is_as_it_was_however_a_run_ends(terminal: Terminal, how: str) -> None:
    terminal.until("READY")
    terminal.until("p pauses")
    assert not terminal.as_before
    terminal.press("\x1a")  # Ctrl-Z pauses; it does not stop the process
    terminal.until("pausing: c goes on")
    terminal.go()
    terminal.until("PROMPT")
    terminal.press("\n")
    terminal.until("paused before step 3 by SIGTSTP (Ctrl-Z)")
    if how == "SIGTERM":
        terminal.process.send_signal(signal.SIGTERM)
    else:
        terminal.press(how)
    terminal.until("ENDED 130")
    terminal.process.wait(120)
    assert terminal.as_before


# ---- what keys of a terminal mean ----


AXES = ("light", "camera", "tilt")


def test_a_line_is_what_was_typed_when_it_ends() -> None:
    keys = JogKeys(AXES)
    assert keys.feed(b"lamp onn") == []
    assert keys.typed == "lamp onn"
    assert keys.feed(b"\x7f\n") == [LineDone("lamp on")]
    assert keys.feed(b"rubbish\x15help\r") == [LineDone("help")]
    assert keys.feed(b"\n") == [LineDone("")]
    assert keys.feed(b"\x04") == [End()]


def test_arrows_jog_and_choose_the_step_and_tab_the_axis() -> None:
    keys = JogKeys(AXES)
    assert keys.feed(b"\x1b[C\x1b[D") == [Jog("light", 0.5), Jog("light", -0.5)]
    assert keys.feed(b"\x1b[A\x1b[C") == [Jog("light", 1.0)]
    assert keys.feed(b"\x1b[B\x1b[B\t\x1bOC") == [Jog("camera", 0.2)]
    assert keys.feed(20 * b"\x1b[B" + b"\x1b[D") == [Jog("camera", -0.01)]
    assert keys.feed(20 * b"\x1b[A" + b"\x1b[D") == [Jog("camera", -10.0)]
    assert keys.feed(b"\t\t\x1b[C") == [Jog("light", 10.0)]


def test_sequences_may_come_in_parts_and_unknown_ones_mean_nothing() -> None:
    keys = JogKeys(AXES)
    assert keys.feed(b"\x1b") == []
    assert keys.feed(b"[") == []
    assert keys.feed(b"C") == [Jog("light", 0.5)]
    assert keys.feed(b"\x1b[3~\x1b[1;5H\x1bxab\xc3") == []
    assert keys.feed(b"\xa9\n") == [LineDone("ab\xe9")]
    assert keys.feed(b"\x1b[Z\xff\n") == [LineDone("\ufffd")]


def test_wrong_wishes_are_refused_before_anything_is_opened(tmp_path: Path) -> None:
    (tmp_path / "there.toml").write_text("")
    for words, message in (
        (["--out", "there.toml"], "there.toml: is there already"),
        (["--out", "aligned.txt"], "must end with .toml"),
        (["--out", "no/aligned.toml"], "lie in a folder that is there"),
        (["--from", "scans.csv"], "--from belongs to scans"),
        (["--host", "no.such.host.invalid"], "cannot be served"),
        (["--wavelength-nm", "9000"], "lies in no band"),
    ):
        done = gonio(tmp_path, "rig", "align", "--live", "--rig", "sim", *words)
        assert (done.returncode, message in done.stderr) == (2, True), done.stderr
        assert done.stdout == ""


@pytest.mark.slow
def test_a_terminal_is_read_key_by_key_and_is_as_it_was_afterwards(tmp_path: Path) -> None:
    """A pseudo-terminal: an arrow jogs, the status line counts down, and the settings come back."""
    import termios

    (tmp_path / "s.toml").write_text('name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    command = [sys.executable, "-c", "from gonio.cli import main; main()"]
    command += ["rig", "align", "--live", "--rig", "sim", "--sample", "s.toml"]
    with subprocess.Popen(
        command, stdin=theirs, stderr=theirs, stdout=subprocess.PIPE, cwd=tmp_path, env=os.environ | {"COLUMNS": "180"}
    ) as child:
        said = b""

        def until(pattern: bytes) -> None:
            nonlocal said
            end = time.monotonic() + PATIENCE_S  # the status line is drawn again and again: silence ends nothing
            while not re.search(pattern, said):
                left = end - time.monotonic()
                if left <= 0 or not select.select([ours], [], [], left)[0]:
                    child.kill()
                    raise AssertionError(f"{pattern!r} does not come: {said[-2000:]!r}")
                said += os.read(ours, 4096)

        until(rb"\[light 0.5 deg\] > ")
        os.write(ours, b"go light 30\n")
        until(rb"lamp dark [^\r]*light (29|30)\.\d+")  # at rest: an arrow that comes during a move counts for nothing
        os.write(ours, b"\x1b[Clamp on\n")
        until(rb"light 30\.[3-7]\d* deg")
        until(rb"dark in \d+ s")
        os.write(ours, b"\x04")
        until(rb"the lamp is dark")
        assert child.wait() == 0
    assert termios.tcgetattr(theirs)[:4] == before[:4]
    os.close(ours)
    os.close(theirs)
