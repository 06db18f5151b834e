"""The bench as a user runs it: the `gonio` command, in a process of its own where that is what counts."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command_line import gonio as in_this_process

HANGS_S = 600.0
"""A command that takes longer than this hangs; an idle machine takes seconds, and a busy one a minute or two."""

Command = Callable[..., "subprocess.CompletedProcess[str]"]

LAMBERT = 'name = "matte"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n'
PLAN = """name = "small"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 50]
theta_r_deg = [-60, -40, 0, 20, 40, 70]
"""


def command_line() -> list[str]:
    """The installed console script, beside the interpreter that runs the tests."""
    return [str(Path(sys.executable).with_name("gonio"))]


def environment() -> dict[str, str]:
    return os.environ | {"COLUMNS": "100", "NO_COLOR": "1"}


@pytest.fixture
def gonio(tmp_path: Path) -> Command:
    """Run a command in `tmp_path` and return what it printed; fails when a traceback shows."""

    def run(*arguments: str | Path, expect: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [*command_line(), *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=environment(),
            timeout=HANGS_S,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        return checked(done, expect)

    return run


@pytest.fixture
def here(tmp_path: Path) -> Command:
    """As `gonio`, in this process: without a second or two for each command to start."""
    return lambda *arguments, expect=0: checked(in_this_process(tmp_path, *arguments), expect)


def checked(done: subprocess.CompletedProcess[str], expect: int) -> subprocess.CompletedProcess[str]:
    """What a command did, if it ended with this exit code and without a traceback."""
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    assert done.returncode == expect, f"exit code {done.returncode}, expected {expect}:\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with a small plan (`plan.toml`) and a Lambertian sample (`sample.toml`)."""
    (tmp_path / "sample.toml").write_text(LAMBERT)
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path
