"""The workbench on a Python that has only what one on Windows has (`shim/sitecustomize.py`): `make test-portable`."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from gonio_sim.wire.twins import Twins, rig_file

from gonio import measurement
from tests.gonio_drivers.conftest import PATIENT, SAMPLE, patient_dialect, small

pytestmark = pytest.mark.portable

SHIM = Path(__file__).with_name("shim")
HANGS_S = 600.0
"""A command that takes longer than this hangs."""
PATIENT_FIRST = "import os; exec(os.environ.get('GONIO_PATIENT', '')); from gonio.cli import main"
"""The command, which waits for twins in this process however long that is held up."""
COMMAND = [sys.executable, "-c", f"{PATIENT_FIRST}; main()"]
SAMPLE_TOML = 'name = "aux"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n'
PLAN = """name = "small"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 50]
theta_r_deg = [-60, -40, 0, 20, 40, 70]
"""
MEASURE = ("measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--seed", "5")


def plain() -> dict[str, str]:
    """What commands see without the shim, on a console of 40 columns."""
    return os.environ | {"COLUMNS": "40", "NO_COLOR": "1"}


def environment(**more: str) -> dict[str, str]:
    return plain() | {"PYTHONIOENCODING": "cp1252", "PYTHONPATH": str(SHIM)} | more


class Console:
    """A process in which commands run one after the other, as on a console of its own."""

    SERVES = f"""
import json, sys
{PATIENT_FIRST}
asked, sys.stdin = sys.stdin, open(os.devnull)
for line in asked:
    sys.argv, code = ["gonio", *json.loads(line)], 0
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    sys.stderr.flush()
    sys.stdout.flush()
    print(f"\\0{{code}}", file=sys.__stdout__, flush=True)
"""

    def __init__(self, folder: Path, env: dict[str, str] | None = None) -> None:
        env = env or environment()
        self._encoding = env.get("PYTHONIOENCODING", "utf-8")
        self._process = subprocess.Popen(
            [sys.executable, "-c", self.SERVES], cwd=folder, env=env,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    def __call__(self, *words: str | Path, expect: int = 0) -> str:
        """What a command printed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([*map(str, words)]).encode() + b"\n")
        self._process.stdin.flush()
        said, line = b"", b""
        while b"\0" not in line:
            line = self._process.stdout.readline()
            said += line
            assert line, said
        text, _, code = said.decode(self._encoding).rpartition("\0")
        return checked(text, int(code), expect)

    def __enter__(self) -> Console:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()


def run(folder: Path, *words: str | Path, expect: int = 0, env: dict[str, str] | None = None) -> str:
    """What one command printed, in a process that ends with it."""
    env = env or environment()
    done = subprocess.run(
        [*COMMAND, *map(str, words)], cwd=folder, env=env, capture_output=True, stdin=subprocess.DEVNULL,
        timeout=HANGS_S, check=False,
    )  # fmt: skip
    return checked((done.stdout + done.stderr).decode(env.get("PYTHONIOENCODING", "utf-8")), done.returncode, expect)


def checked(said: str, code: int, expect: int) -> str:
    """What a command printed; it ended as it should, and shows no traceback."""
    assert code == expect, said
    assert "Traceback" not in said
    assert "should not happen" not in said
    return said


@contextlib.contextmanager
def running(folder: Path, *words: str | Path, **streams: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A command that goes on until it is killed."""
    command = [*COMMAND, *map(str, words)]
    with subprocess.Popen(command, cwd=folder, env=environment(COLUMNS="200"), **streams) as child:
        try:
            yield child
        finally:
            child.kill()


@contextlib.contextmanager
def lit(twins: Twins, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A program that keeps the twins' lamp lit until it is killed."""
    words = ("rig", "lamp", "on", "--for", "1000", "--rig", folder.parent / "rig.toml")
    with running(folder, *words, stderr=subprocess.PIPE) as child:
        assert child.stderr is not None
        while b"lamp lit" not in (line := child.stderr.readline()):
            assert line, "it ended"
        assert twins.lamp.shine.lit
        yield child


@pytest.fixture
def files(tmp_path: Path) -> Path:
    # blanks and letters outside of ASCII in the path, as in a user's folder
    folder = tmp_path / "My Höhe"
    folder.mkdir()
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    (folder / "sample.toml").write_text(SAMPLE_TOML, encoding="utf-8")
    return folder


def test_the_shim_takes_away_what_it_says(tmp_path: Path) -> None:
    program = (
        "import importlib.util, sys\n"
        "spec = importlib.util.spec_from_file_location('gonio_tried', sys.argv[1])\n"
        "spec.loader.exec_module(importlib.util.module_from_spec(spec))\n"
    )
    lines = """
import fcntl
import os; os.O_NONBLOCK
import os; os.open("x", os.O_CREAT | os.O_WRONLY)
import os; os.fork()
import os; os.getuid()
import os; f = open("x", "w"); os.replace("y", "x")
import signal; signal.SIGKILL
import select; select.poll
open("con.txt", "w")
open("a:b", "w")
open("x", "w").write("\u03b8")
"""
    for number, line in enumerate(lines.split("\n")[1:-1]):
        (tmp_path / "y").touch()
        tried = tmp_path / f"tried{number}.py"
        tried.write_text(line, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-c", program, str(tried)],
            env=environment(),
            capture_output=True,
            cwd=tmp_path,
            check=False,
        )
        assert done.returncode != 0, line


def test_the_quick_demo(tmp_path: Path) -> None:
    run(tmp_path, "demo", "--quick", "--out", "demo", env=environment(PYTHONIOENCODING="cp850"))
    page = (tmp_path / "demo" / "run" / "report" / "index.html").read_text(encoding="utf-8")
    assert "rough aluminium" in page
    assert "θ" in page


def test_read_fit_compare_report_convert(files: Path) -> None:
    with Console(files) as console:
        console(*MEASURE, "--out", "run")
        console("reduce", "run")
        console("fit", "run/brdf.csv", "--model", "lambert", "--save", "fit.toml")
        console("compare", "run/brdf.csv", "--models", "lambert,oren-nayar", "--out", "page")
        console("convert", "run/brdf.csv", "run.astm")
        console("convert", "run.astm", "back.csv")
    back = measurement.read(files / "back.csv")
    assert len(back) == 12
    names = {path.name.split(".")[0] for path in files.rglob("*")}
    assert not names & {"aux", "con", "nul", "prn"}, "a sample's name became the name of a device"
    with Console(files, plain()) as console:  # without the shim: the same bytes
        console(*MEASURE, "--out", "other")
        console("reduce", "other")
    assert (files / "run" / "brdf.csv").read_bytes() == (files / "other" / "brdf.csv").read_bytes()


def steps_in(run_folder: Path) -> list[int]:
    whole = (run_folder / "journal.jsonl").read_bytes().rpartition(b"\n")[0]
    return [event["step"] for event in map(json.loads, whole.splitlines()) if event["event"] == "step"]


@pytest.mark.parametrize("console", ["yes", "no"])
def test_a_killed_run_is_taken_up_again_and_followed(files: Path, console: str) -> None:
    """With the locks of Windows, and without any: what else a console has no part in commands."""
    env = environment(GONIO_SHIM_CONSOLE=console)
    begun = subprocess.Popen(
        [*COMMAND, *MEASURE, "--out", "run"], cwd=files, env=env, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    journal = files / "run" / "journal.jsonl"
    while begun.poll() is None and not (journal.exists() and steps_in(files / "run")):
        time.sleep(0.001)
    with contextlib.suppress(psutil.NoSuchProcess):  # it has ended, on a computer that was busy here
        psutil.Process(begun.pid).suspend()
    if begun.poll() is None:
        said = run(files, *MEASURE, "--out", "run", "--resume", expect=2, env=env)
        assert "another process is measuring" in " ".join(said.split())
    begun.kill()
    begun.wait()
    run(files, *MEASURE, "--out", "run", "--resume", env=env)
    assert steps_in(files / "run") == list(range(len(steps_in(files / "run"))))
    with running(files, "watch", "run", stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as watch:
        assert watch.stdout is not None
        with urllib.request.urlopen(watch.stdout.readline().decode().strip(), timeout=60) as page:
            assert b"<html" in page.read()


def test_a_file_that_is_open_elsewhere_is_named_and_kept(files: Path) -> None:
    fit, report = (
        ("fit", "run/brdf.csv", "--model", "lambert", "--save", "fit.toml"),
        ("report", "run", "--models", "lambert"),
    )
    with Console(files) as console:
        for words in ((*MEASURE, "--out", "run"), ("reduce", "run"), fit, report):
            console(*words)
        for opened, words in (
            ("fit.toml", fit),
            ("run/brdf.csv", ("reduce", "run")),
            ("run/report/index.html", report),
        ):
            before = (files / opened).read_bytes()
            with (files / opened).open("rb"):
                said = " ".join(console(*words, expect=2).split())
            assert "in another program" in said or "used by another process" in said
            assert (files / opened).read_bytes() == before
        console(*fit)
    assert not [name for at, names, more in os.walk(files) for name in names + more if name.startswith(".")]


@pytest.mark.parametrize("name", ["aux", "a:b", "x" * 250])
def test_a_name_that_cannot_be_had_is_said(files: Path, name: str) -> None:
    said = run(files, *MEASURE, "--out", name, expect=2)
    assert "Errno" not in said
    assert set(os.listdir(files)) == {"plan.toml", "sample.toml"}


@pytest.fixture
def twins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Twins]:
    monkeypatch.setenv("GONIO_PATIENT", PATIENT)
    with Twins(small(), SAMPLE, 3, folder=tmp_path / "twin", scale=20.0, tcp=True) as served:
        served.world.description.devices["light"]["dialect"] = str(patient_dialect(tmp_path))
        (tmp_path / "rig.toml").write_text(rig_file(served.description), encoding="utf-8")
        yield served


def test_the_laboratory_over_tcp(twins: Twins, files: Path) -> None:
    rig = files.parent / "rig.toml"
    assert all(peer.port.startswith("socket://127.0.0.1:") for peer in twins.peers.values())
    with Console(files) as console:
        console("rig", "check", "--rig", rig)
        console("measure", "plan.toml", "--rig", rig, "--out", "run", "--yes")
        console("reduce", "run")
    assert len(measurement.read(files / "run" / "brdf.csv")) == 12
    assert twins.quiet


def test_the_lamp_of_a_program_that_was_killed_goes_dark_over_tcp(twins: Twins, files: Path) -> None:
    with lit(twins, files):
        pass
    end = time.monotonic() + 60.0
    while twins.lamp.shine.lit:
        assert time.monotonic() < end
        time.sleep(0.01)
    run(files, "rig", "dark", "--rig", files.parent / "rig.toml")


def test_one_program_at_a_time_has_a_port_of_the_network(twins: Twins, files: Path) -> None:
    with lit(twins, files):
        said = run(files, "rig", "lamp", "on", "--for", "1", "--rig", files.parent / "rig.toml", expect=3)
        assert "does another program use it?" in " ".join(said.split())
        assert twins.lamp.shine.lit


def test_twins_are_served_over_tcp_by_command(files: Path) -> None:
    words = ("sim", "serve", "--rig", "lab", "--tcp", "--out", "twin")
    with running(files, *words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as serving:
        assert serving.stdout is not None
        assert b"twins of lab are running" in serving.stdout.readline()
        run(files, "rig", "read", "--rig", "twin/rig.toml")
