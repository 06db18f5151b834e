"""A measurement that is killed at any moment resumes: every point once, none lost, the same table."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gonio.measurement import read
from tests.system.conftest import HANGS_S, Command, environment

MEASURE = ("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--seed", "5")


HELD = """
import sys, time
from pathlib import Path
from gonio.cli import main
from gonio.lab.acquisition.journal import Journal

steps, heard, write = int(sys.argv.pop(1)), Path(sys.argv.pop(1)), Journal._write

def held(journal, lines):
    while sum(event["event"] == "step" for event in journal.events) >= steps and not heard.exists():
        time.sleep(0.001)
    write(journal, lines)

Journal._write = held
main()
"""
"""The command `gonio`, whose journal gets no longer than some steps until it has been sent its signal."""


def kill_after(files: Path, out: str, steps: int, how: signal.Signals, *more: str) -> int:
    """Start a measurement, send `how` as soon as the journal holds `steps` steps, and return the exit code."""
    heard = files / f"{out}-{steps}-heard"
    process = subprocess.Popen(
        [sys.executable, "-c", HELD, str(steps), str(heard), *MEASURE, "--out", out, *more],
        cwd=files,
        env=environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    journal = files / out / "journal.jsonl"
    while process.poll() is None:
        if journal.exists() and len(steps_in(files, out)) >= steps:
            process.send_signal(how)
            heard.touch()
            break
        time.sleep(0.001)
    process.communicate(timeout=HANGS_S)
    return process.returncode


def steps_in(files: Path, out: str) -> list[int]:
    """The steps of a journal, which may be in the middle of its last line."""
    whole, _, _ = (files / out / "journal.jsonl").read_bytes().rpartition(b"\n")
    return [event["step"] for event in map(json.loads, whole.splitlines()) if event["event"] == "step"]


@pytest.mark.slow
def test_killed_run_resumes_to_the_same_table(here: Command, files: Path) -> None:
    here(*MEASURE, "--out", "whole")
    for steps in (2, 5, 9):
        more = ["--resume"] if (files / "cut" / "journal.jsonl").exists() else []
        assert kill_after(files, "cut", steps, signal.SIGKILL, *more) == -signal.SIGKILL
    with (files / "cut" / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"torn')
    here(*MEASURE, "--out", "cut", "--resume")
    assert steps_in(files, "cut") == steps_in(files, "whole")
    for out in ("whole", "cut"):
        here("reduce", out)
    whole, cut = read(files / "whole" / "brdf.csv"), read(files / "cut" / "brdf.csv")
    assert len(whole) == 12
    numbers = whole.select_dtypes("number").columns
    # one seed gives one table, whatever was interrupted: exactly, not nearly
    np.testing.assert_array_equal(whole[numbers].to_numpy(), cut[numbers].to_numpy())
    assert (whole["flag"] == cut["flag"]).all()


@pytest.mark.slow
def test_interrupt_finishes_the_step_and_exits_130(here: Command, files: Path) -> None:
    assert kill_after(files, "run", 3, signal.SIGINT) == 130
    assert len(steps_in(files, "run")) >= 3
    here(*MEASURE, "--out", "run", "--resume")
    assert len(set(steps_in(files, "run"))) == len(steps_in(files, "run"))


@pytest.mark.slow
def test_a_lost_journal_is_made_again_and_a_damaged_frame_is_taken_again(here: Command, files: Path) -> None:
    here(*MEASURE, "--out", "run")
    here("reduce", "run")
    run = files / "run"
    table = (run / "brdf.csv").read_bytes()
    frames = {path.name: path.read_bytes() for path in (run / "frames").iterdir()}
    (run / "journal.jsonl").unlink()
    assert "gonio run repair run" in here(*MEASURE, "--out", "run", "--resume", expect=1).stderr
    assert {path.name: path.read_bytes() for path in (run / "frames").iterdir()} == frames
    assert "15 steps" in here("run", "repair", "run").stdout
    here("run", "check", "run")
    damaged = run / "frames" / "000004-550nm-02.dng"
    damaged.write_bytes(frames[damaged.name][:-1000])
    assert damaged.name in here("run", "check", "run", expect=1).stderr
    assert damaged.name in here("reduce", "run").stderr
    assert read(run / "brdf.csv")["flag"].tolist().count("damaged") == 1
    assert damaged.name in here(*MEASURE, "--out", "run", "--resume").stderr
    here("reduce", "run")
    assert (run / "brdf.csv").read_bytes() == table
    (run / "brdf.csv").write_bytes(table.replace(b"unpolarised", b"UNPOLARISED"))
    assert "brdf.csv" in here("reduce", "run", expect=2).stderr
