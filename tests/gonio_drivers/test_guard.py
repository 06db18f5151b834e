"""A lamp goes dark, whoever is killed or stands still: its program, its guard, in every phase of a measurement.

Kind: what watches over a device is watched itself, and what is alive has to show it. Real processes, real signals.
"""

import contextlib
import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from gonio_drivers import guard
from gonio_drivers import light as lights
from gonio_sim.wire.twins import Twins

from gonio.errors import DeviceError, PassingFault
from gonio.lab.acquisition.run import Run
from tests.command_line import gonio, some
from tests.gonio.numpy_rig import plan_in
from tests.gonio_drivers.conftest import COMMAND, LONGEST_S, by_hand, written
from tests.gonio_drivers.test_lab import PLAN, assert_true
from tests.gonio_drivers.test_light import Plugged, lamp

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("real_time")]

__all__ = ["lamp"]

STILL_S, ANSWER_S, DARKENS_S, FRAME_S = 15.0, 2.0, 5.0, 8.0
"""What docs/lab_setup.md states as 55 s, 10 s and 5 s, in these tests; and how long the camera is waited for."""
BUSY_S = 0.0 if "GONIO_CAMPAIGN_LOG" in os.environ else 60.0
"""How long the machine may be held up meanwhile. A campaign on an idle one tells whether the times are kept."""
QUICK = (
    "from gonio.lab.acquisition import waits; from gonio_drivers import guard, light; "
    f"waits.WAITS_S['lamp'] = (0.1, 0.1, 0.1); light.STILL_S = {STILL_S}; guard.ANSWER_S = {ANSWER_S}; "
    f"guard.LOOK_S = 0.2; {COMMAND[-1]}"
)
"""The command with short waits."""
MEASURE = ("measure", "plan.toml", "--rig", "my.toml", "--out", "run", "--yes")
PHASES = ["dark frames", "warm-up", "exposure", "move", "darkening"]
STRUCK = [*((phase, signal.SIGKILL) for phase in PHASES), *((phase, signal.SIGSTOP) for phase in PHASES[1:4:2])]
"""Killed in every phase, and stopped where the lamp warms up and where an arm moves: each takes seconds."""
Blow = Callable[[subprocess.Popen[str]], object]


def guards_of(program: int) -> list[psutil.Process]:
    """The guards of a program that run."""
    found = []
    with contextlib.suppress(psutil.Error):
        for child in psutil.Process(program).children():
            with contextlib.suppress(psutil.Error):
                if child.status() != psutil.STATUS_ZOMBIE and guard.__file__ in child.cmdline():
                    found.append(child)
    return found


class Struck:
    """A measurement as a process of its own, to which something is done once, in a phase of it.

    The twin deals the blow, while the program waits for its answer: no thread has to be woken for it.
    """

    def __init__(self, twins: Twins, tmp_path: Path, phase: str, blow: Blow, *, frame_s: float = FRAME_S) -> None:
        self.twins, self.folder, self.goes_on = twins, tmp_path, threading.Event()
        self.child: subprocess.Popen[str] | None = None
        self.struck_s = self.dark_s = math.inf
        """When it was struck, and when the lamp was dark after that."""
        self.exposure_s = 0.0
        """Of the last frame."""
        self._blow, self._log = blow, tmp_path / "said.txt"
        camera = twins.description.devices["camera"] | {"timeout_s": frame_s}
        written(twins, tmp_path, devices=twins.description.devices | {"camera": camera})
        text = (tmp_path / "my.toml").read_text()
        (tmp_path / "my.toml").write_text(text.replace("warm_up_s = 0.0", "warm_up_s = 2.0"))
        plan_in(tmp_path, PLAN)
        self._await(phase)

    def _await(self, phase: str) -> None:
        shine, servo = self.twins.lamp.shine, self.twins.servos["camera"]
        expose, command, follow = self.twins.camera._expose, self.twins.lamp.command, servo.leaving

        def exposing(exposure_s: float) -> Any:
            self.exposure_s = exposure_s
            if phase == ("exposure" if shine.lit else "dark frames"):
                self._strike()
            return expose(exposure_s)

        def commanded(line: str) -> str | None:
            lit = shine.lit
            if phase == "darkening" and lit and "OFF" in line.upper() and self._strike():
                return None  # it is lost
            answer = command(line)
            if phase == "warm-up" and shine.lit:
                self._strike()
            if lit and not shine.lit:
                self.dark_s = time.monotonic()
            return answer

        def leaving() -> None:
            follow()
            if phase == "move" and shine.lit and abs(servo.get("Goal Position") - servo.shaft()[0]) > 50:
                self._strike()

        self.twins.camera._expose, self.twins.lamp.command = exposing, commanded  # type: ignore[method-assign]
        servo.leaving = leaving

    def _strike(self) -> bool:
        """Strike, unless that is done already; whether it was now."""
        if self.struck_s < math.inf:
            return False
        self._blow(some(self.child))
        self.struck_s = time.monotonic()
        if not self.twins.lamp.shine.lit:
            self.dark_s = self.struck_s
        self.goes_on.wait(LONGEST_S)
        return True

    def until(self, happened: Callable[[], Any]) -> Any:
        """Wait until something is so; at once an error where the program has ended before."""
        end = time.monotonic() + LONGEST_S
        while not (so := happened()):
            ended = some(self.child).poll()
            assert ended in (None, -signal.SIGKILL), f"it ended with {ended}: {self.said}"
            assert time.monotonic() < end, self.said
            time.sleep(0.01)
        return so

    @property
    def said(self) -> str:
        """What the program has said so far, in one line."""
        return " ".join(self._log.read_text().split())

    @contextlib.contextmanager
    def measuring(self, *, held: bool = False) -> Iterator[subprocess.Popen[str]]:
        """The process, once it is struck; it is ended at the end. `held`: the twin waits for `goes_on` then."""
        if not held:
            self.goes_on.set()
        with self._log.open("w") as log:
            self.child = child = subprocess.Popen(
                [*COMMAND[:2], QUICK, *MEASURE], stderr=log, text=True, cwd=self.folder
            )
        with child:
            try:
                self.until(lambda: self.struck_s < math.inf)
                yield child
            finally:
                self.goes_on.set()
                child.kill()

    def ends(self, code: int = 0) -> None:
        """It ends by itself, with this exit code."""
        assert some(self.child).wait(LONGEST_S) == code, self.said

    def dark_within(self, limit_s: float, what: str) -> None:
        """The lamp is dark in time after it was struck; a line for a campaign's log."""
        self.until(lambda: not self.twins.lamp.shine.lit)
        took_s = self.dark_s - self.struck_s
        with open(os.environ.get("GONIO_CAMPAIGN_LOG", os.devnull), "a", encoding="utf-8") as log:
            print(f"{what}: dark after {took_s:.2f} s of {limit_s:.2f} s", file=log)
        assert took_s < limit_s + BUSY_S

    def measured(self, *, resume: bool = False) -> None:
        """The lamp is dark, and the whole table is right; of a killed program once its run is resumed."""
        if resume:
            gonio(self.folder, *MEASURE, "--resume", expect=0)
        assert not self.twins.lamp.shine.lit
        assert_true(Run.open(self.folder / "run"), 4)


@pytest.mark.parametrize(("phase", "number"), STRUCK)
def test_a_program_that_is_killed_or_stands_still_leaves_no_lamp_lit_and_its_frames_are_no_data(
    twins: Twins, tmp_path: Path, phase: str, number: signal.Signals
) -> None:
    struck, killed = Struck(twins, tmp_path, phase, lambda child: child.send_signal(number)), number == signal.SIGKILL
    with struck.measuring() as child:
        limit_s = DARKENS_S if killed else STILL_S + DARKENS_S
        if phase == "exposure" and not killed:
            limit_s += FRAME_S + twins.description.camera.frame_overhead_s + struck.exposure_s
        struck.dark_within(limit_s, f"program, {phase}, {number.name}")
        if not killed:
            child.send_signal(signal.SIGCONT)
        struck.ends(-signal.SIGKILL if killed else 0)
    struck.measured(resume=killed)


@pytest.mark.parametrize(("phase", "number"), STRUCK)
def test_another_guard_comes_for_one_that_is_killed_or_stopped(
    twins: Twins, tmp_path: Path, phase: str, number: signal.Signals
) -> None:
    guards: list[psutil.Process] = []

    def blow(child: subprocess.Popen[str]) -> None:
        guards.extend(struck.until(lambda: guards_of(child.pid)))  # where it was held up another one may just come
        guards[0].send_signal(number)

    struck, killed = Struck(twins, tmp_path, phase, blow), phase in ("dark frames", "warm-up")
    with struck.measuring() as child:
        (first,) = guards
        struck.until(lambda: [each for each in guards_of(child.pid) if each.pid != first.pid] or phase == "darkening")
        what = f"guard, {phase}, {number.name}, another after {time.monotonic() - struck.struck_s:.2f} s"
        if killed:  # the rest is the same
            struck.until(lambda: twins.lamp.shine.lit)
            struck.struck_s, struck.dark_s = time.monotonic(), math.inf
            child.kill()
            struck.dark_within(DARKENS_S, f"{what}, program killed")
        struck.ends(-signal.SIGKILL if killed else 0)
        why = "was ended" if number == signal.SIGKILL else "stood still"
        assert killed or phase == "darkening" or f"the lamp's guard (process {first.pid}) {why}" in struck.said
    if not killed:
        struck.dark_within(LONGEST_S, f"{what}, to the end")
    struck.measured(resume=killed)


@pytest.mark.parametrize("stopped", [False, True])
def test_rig_dark_darkens_the_lamp_of_a_program_that_holds_the_port(
    twins: Twins, tmp_path: Path, stopped: bool
) -> None:
    """And that program, once it goes on, does not light it again: it ends with exit code 3."""

    def blow(child: subprocess.Popen[str]) -> None:
        if stopped:
            child.send_signal(signal.SIGSTOP)

    struck = Struck(twins, tmp_path, "exposure", blow, frame_s=LONGEST_S)
    with struck.measuring(held=True) as child:
        says = f"the order to darken is out, through the guard of process {child.pid}"
        by_hand(tmp_path / "my.toml", "dark", says=says)
        struck.until(lambda: not twins.lamp.shine.lit)
        struck.goes_on.set()
        child.send_signal(signal.SIGCONT)
        struck.ends(3)
    assert "`gonio rig dark`, run beside this program, has darkened it" in struck.said
    assert not twins.lamp.shine.lit
    assert twins.quiet
    by_hand(tmp_path / "my.toml", "dark", says="lamp dark")


# ---- the driver alone ----


def test_a_lamp_that_was_darkened_for_a_standstill_is_lit_again_after_its_warm_up(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch
) -> None:
    with lamp.driver() as light:
        light.on()
        monkeypatch.setattr(lights, "STILL_S", 0.2)
        light.alive()
        lamp.goes_dark()
        light.alive()  # too late: a sign of life lights nothing
        with pytest.raises(PassingFault, match="stood still"):
            light.check()
        assert (light.lit, light.known_dark, light._warmed) == (False, True, False)
        monkeypatch.setattr(lights, "STILL_S", 60.0)
        light.on()
        light.check()
        assert lamp.twin.shine.lit
    assert not lamp.twin.shine.lit


def test_a_lamp_without_a_guard_stays_dark(lamp: Plugged, monkeypatch: pytest.MonkeyPatch) -> None:
    """A guard that ends as soon as it is started protects nobody."""
    with lamp.driver() as light:
        light.on()
        monkeypatch.setattr(guard, "__file__", os.devnull)  # what is started from now on ends at once
        os.kill(some(some(light._guard)._process).pid, signal.SIGKILL)
        lamp.goes_dark()
        with pytest.raises(DeviceError, match="cannot run"):
            light.check()
        with pytest.raises(DeviceError, match="cannot run"):
            light.on()
        assert not lamp.twin.shine.lit


@pytest.mark.parametrize("in_order", [True, False])
def test_leaving_ends_a_guard_that_stands_still(lamp: Plugged, monkeypatch: pytest.MonkeyPatch, in_order: bool) -> None:
    """Whether the lamp is dark or not: then another guard darkens it."""
    monkeypatch.setattr(guard, "LOOK_S", LONGEST_S)  # nobody sees before that it stands still
    with lamp.driver() as light:
        light.on()
        watching = some(light._guard)
        process = some(watching._process)
        if in_order:
            light.off()
        process.send_signal(signal.SIGSTOP)
        monkeypatch.setattr(guard, "ANSWER_S", 0.2)
        monkeypatch.setattr(guard, "DARKENED_S", 0.2)
        waits = process.wait

        def wait(timeout: float | None = None) -> int:
            try:
                return waits(timeout)
            finally:
                monkeypatch.setattr(guard, "DARKENED_S", LONGEST_S)  # of the guard that comes after it

        monkeypatch.setattr(process, "wait", wait)
        light._close(in_order=in_order)
        assert process.poll() == -signal.SIGKILL
        lamp.goes_dark()
        light._line.open(light._baud)
