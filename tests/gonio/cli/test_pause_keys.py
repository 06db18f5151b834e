"""Keys that pause a measurement, on a terminal of the test's own."""

import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

SCRIPT = """
import sys, time
from pathlib import Path
sys.path.insert(0, {root!r})
from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import load_plan
from gonio.acquisition.stop import Pause
from gonio.cli import console
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
    with console.progress(pause) as progress:
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
        end = time.monotonic() + 60.0
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
