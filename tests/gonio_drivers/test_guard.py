"""A lamp goes dark, whoever is killed or stands still: its program, its guard, in every phase of a measurement.

Kind: what watches over a device is watched itself, and what is alive has to show it. Real processes, real signals.
"""

import contextlib
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

from gonio.acquisition.run import Run
from gonio.errors import DeviceError, PassingFault
from tests.command_line import some
from tests.gonio.numpy_rig import plan_in
from tests.gonio_drivers.conftest import COMMAND, LONGEST_S, by_hand, written
from tests.gonio_drivers.test_by_hand import goes_dark
from tests.gonio_drivers.test_lab import PLAN, assert_true
from tests.gonio_drivers.test_light import Plugged, lamp
from tests.gonio_drivers.test_ways_out import when_it_sets_out

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("real_time")]

__all__ = ["lamp"]

QUICK = (
    "from gonio.acquisition import waits; from gonio_drivers import guard, light; "
    "waits.WAITS_S['lamp'] = (0.1, 0.1, 0.1); light.STILL_S = 15.0; guard.ANSWER_S = 2.0; guard.LOOK_S = 0.2; "
    "from gonio.cli import main; main()"
)
"""The command with short waits: what is stated as a minute are 15 seconds here, which a busy machine keeps."""
PHASES = ["dark frames", "warm-up", "exposure", "move", "darkening"]


def soon(happened: Callable[[], Any]) -> Any:
    """Wait until something is so."""
    end = time.monotonic() + LONGEST_S
    while not (so := happened()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return so


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
    """A measurement as a process of its own, to which something is done once, in a phase of it."""

    def __init__(self, twins: Twins, tmp_path: Path, phase: str) -> None:
        self.twins, self.folder, self.now, self._go = twins, tmp_path, threading.Event(), threading.Event()
        camera = twins.description.devices["camera"] | {"timeout_s": 8.0}
        rig = twins.description.model_dump()["lamp"] | {"warm_up_s": 2.0}
        written(twins, tmp_path, devices=twins.description.devices | {"camera": camera})
        text = (tmp_path / "my.toml").read_text()
        (tmp_path / "my.toml").write_text(text.replace("warm_up_s = 0.0", f"warm_up_s = {rig['warm_up_s']}"))
        plan_in(tmp_path, PLAN)
        self._await(phase)

    def _await(self, phase: str) -> None:
        twins, lit_before, done = self.twins, [False], [False]

        def strike() -> None:
            """The twin waits until the blow has fallen, so that it falls in this phase."""
            if not done[0]:
                done[0] = True
                self.now.set()
                self._go.wait(LONGEST_S)

        expose, command = twins.camera._expose, twins.lamp.command

        def exposing(exposure_s: float) -> Any:
            if (phase, twins.lamp.shine.lit) in (("dark frames", False), ("exposure", True)):
                strike()
            return expose(exposure_s)

        def commanded(line: str) -> Any:
            answer = command(line)
            lit = twins.lamp.shine.lit
            if (phase == "warm-up" and lit) or (phase == "darkening" and lit_before[0] and not lit):
                strike()
            lit_before[0] = lit
            return answer

        twins.camera._expose, twins.lamp.command = exposing, commanded  # type: ignore[method-assign]
        servo = twins.servos["camera"]
        self._usual = servo._limits
        if phase == "move":
            when_it_sets_out(servo, strike)

    @contextlib.contextmanager
    def measuring(self) -> Iterator[subprocess.Popen[str]]:
        """The process, in its phase; it is ended at the end."""
        words = ["measure", "plan.toml", "--rig", "my.toml", "--out", "run", "--yes"]
        command = [*COMMAND[:2], QUICK, *words]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=self.folder) as child:
            try:
                assert self.now.wait(LONGEST_S), child.stderr
                yield child
            finally:
                self._go.set()
                child.kill()

    def goes_on(self) -> None:
        """The twin goes on too, as fast as ever."""
        self.twins.servos["camera"]._limits = self._usual  # type: ignore[method-assign]
        self._go.set()


@pytest.mark.parametrize("phase", PHASES)
def test_a_program_that_stands_still_leaves_no_lamp_lit_and_its_frames_are_no_data(
    twins: Twins, tmp_path: Path, phase: str
) -> None:
    struck = Struck(twins, tmp_path, phase)
    with struck.measuring() as child:
        child.send_signal(signal.SIGSTOP)
        struck.goes_on()
        goes_dark(twins)
        child.send_signal(signal.SIGCONT)
        _, said = child.communicate(timeout=LONGEST_S)
        assert child.returncode == 0, said
    assert not twins.lamp.shine.lit
    assert_true(Run.open(tmp_path / "run"), 4)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("phase", PHASES)
def test_another_guard_comes_for_one_that_is_killed_or_stopped(
    twins: Twins, tmp_path: Path, phase: str, number: signal.Signals
) -> None:
    struck = Struck(twins, tmp_path, phase)
    with struck.measuring() as child:
        (first,) = guards_of(child.pid)
        first.send_signal(number)
        struck.goes_on()
        soon(lambda: [each for each in guards_of(child.pid) if each.pid != first.pid] or child.poll() is not None)
        if phase in ("dark frames", "warm-up"):  # the rest is the same
            soon(lambda: twins.lamp.shine.lit)
            child.kill()
            child.wait(LONGEST_S)
            goes_dark(twins)
            return
        _, said = child.communicate(timeout=LONGEST_S)
        assert child.returncode == 0, said
        why = "was ended" if number == signal.SIGKILL else "stood still"
        assert phase == "darkening" or f"the lamp's guard (process {first.pid}) {why}" in " ".join(said.split())
    assert not twins.lamp.shine.lit
    assert_true(Run.open(tmp_path / "run"), 4)


@pytest.mark.parametrize("stopped", [False, True])
def test_rig_dark_darkens_the_lamp_of_a_program_that_holds_the_port(
    twins: Twins, tmp_path: Path, stopped: bool
) -> None:
    """And that program, once it goes on, does not light it again: it ends with exit code 3."""
    struck = Struck(twins, tmp_path, "exposure")
    with struck.measuring() as child:
        if stopped:
            child.send_signal(signal.SIGSTOP)
        says = f"the order to darken is out, through the guard of process {child.pid}"
        by_hand(tmp_path / "my.toml", "dark", says=says)
        assert stopped or not twins.lamp.shine.lit
        goes_dark(twins)
        struck.goes_on()
        child.send_signal(signal.SIGCONT)
        _, said = child.communicate(timeout=LONGEST_S)
    assert child.returncode == 3, said
    assert "`gonio rig dark`, run beside this program, has darkened it" in " ".join(said.split())
    assert not twins.lamp.shine.lit
    assert twins.quiet
    by_hand(tmp_path / "my.toml", "dark", says="lamp dark")


# ---- the driver alone ----


def test_a_lamp_that_was_darkened_for_a_standstill_is_lit_again_after_its_warm_up(
    lamp: Plugged, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lights, "STILL_S", 0.2)
    with lamp.driver() as light:
        light.on()
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
