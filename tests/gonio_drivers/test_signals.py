"""Signals that come at whatever moment end nothing undetermined, and print nothing of Python's own."""

import signal
import subprocess
import sys
import time

import pytest
from gonio_drivers import signals


def test_signals_without_pause_are_not_heard_and_leave_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda what: told.append(str(what.exc_value)))
    heard: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(number))
    press = "import os, signal\nwhile True: os.kill(os.getppid(), signal.SIGINT)"
    with subprocess.Popen([sys.executable, "-c", press]) as presses:
        try:
            while not heard:
                time.sleep(0.01)
            for _ in range(400):
                with signals.undisturbed():
                    pass
        finally:
            presses.kill()
            presses.wait()
            signal.signal(signal.SIGINT, before)
    assert not [said for said in told if "ignored" in said]
