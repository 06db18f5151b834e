"""A pipe, socket, device or folder where a file belongs: a named error at once, and nothing waits for it."""

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gonio.disk import only_file, read_file
from gonio.lab.acquisition.frame_writer import BESIDE
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from tests.gonio.numpy_rig import measured, plan_in

LIMIT_S = 60
"""A command that has not ended by then waits for something; each takes a second or two."""


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))


def _device(path: Path) -> None:
    path.symlink_to("/dev/zero")


KINDS: dict[str, Callable[[Path], None]] = {"pipe": _pipe, "socket": _socket, "device": _device, "folder": Path.mkdir}

CALLED = """
import json
import sys
from pathlib import Path
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.errors import GonioError
from gonio import measurement
from gonio.lab.reduction import brdf
from tests.gonio.numpy_rig import measured

todo = {
    "check": repair.check,
    "repair": repair.repair,
    "resume": lambda run: measured(load_plan(run.parent / "plan.toml"), run, resume=True),
    "reduce": lambda run: brdf.reduce(Run.open(run)),
    "read": measurement.read,
}

def told(run, name):
    try:
        out = todo[name](Path(run))
        return ",".join(out["flag"]) if name == "reduce" else "done"
    except (GonioError, OSError) as error:
        return f"{type(error).__name__} {error}"

for line in sys.stdin:
    run, *names = json.loads(line)
    print(json.dumps({name: told(run, name) for name in names}), flush=True)
"""

Call = Callable[..., dict[str, str]]


@pytest.fixture(scope="module")
def call() -> Iterator[Call]:
    """Do things with a run in a process of its own, which is killed where it waits; what each of them said."""
    with subprocess.Popen([sys.executable, "-c", CALLED], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:

        def ask(run: Path, *names: str) -> dict[str, str]:
            assert process.stdin is not None
            assert process.stdout is not None
            guard = threading.Timer(LIMIT_S, process.kill)
            guard.start()
            try:
                process.stdin.write(json.dumps([str(run), *names]).encode() + b"\n")
                process.stdin.flush()
                answer = process.stdout.readline()
            finally:
                guard.cancel()
            assert answer, f"of {names} one waits for something, or died"
            return dict(json.loads(answer))

        yield ask


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    run = measured(plan_in(folder), folder / "run", command="")
    run.write_table(brdf.reduce(run))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_only_files_are_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    monkeypatch.chdir(tmp_path)
    KINDS[kind](tmp_path / "there")
    with pytest.raises(OSError, match="directory" if kind == "folder" else "not a file"):
        read_file(tmp_path / "there")
    if kind != "device":  # one behind a link, opened for writing, would be the machine's own
        with pytest.raises(OSError, match=r"directory|not a file"):
            open(tmp_path / "there", "a+b", buffering=0, opener=only_file)  # noqa: SIM115


def test_a_file_that_is_made_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    with open(tmp_path / "made", "a+b", opener=only_file) as file:
        file.write(b"x")
    assert (tmp_path / "made").stat().st_mode == (tmp_path / "usual").stat().st_mode
    assert read_file(tmp_path / "made") == b"x"


@pytest.mark.parametrize(
    ("name", "kind"),
    [(name, "pipe") for name in ("run.toml", "journal.jsonl", "plan.csv", "brdf.csv", "brdf.meta.json")]
    + [("run.toml", "folder"), ("journal.jsonl", "socket"), ("plan.csv", "device"), ("brdf.csv", "device")],
)
def test_nothing_waits_for_what_is_no_file(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, name: str, kind: str
) -> None:
    shutil.copytree(whole, tmp_path / "w")
    run = tmp_path / "w" / "run"
    (run / name).unlink()
    monkeypatch.chdir(run)
    KINDS[kind](run / name)
    monkeypatch.undo()
    table = name.startswith("brdf")
    told = call(run, "read") if table else call(run, "check", "repair", "resume", "reduce")
    expected = {"repair"} if name == "plan.csv" else set()  # which it does not read
    for command, text in told.items():
        if command not in expected:
            assert text.startswith(("ConfigError", "DataError")), (command, text)
            assert name in text, (command, text)
            assert "irectory" in text or "not a file" in text, (command, text)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_point_whose_frame_is_no_file_is_flagged(whole: Path, tmp_path: Path, call: Call, kind: str) -> None:
    shutil.copytree(whole, tmp_path / "w")
    run = tmp_path / "w" / "run"
    step = next(step for step in Run.open(run).steps() if step.kind == "point")
    for frame in step.frames:
        (run / "frames" / frame.file).unlink()
        KINDS[kind](run / "frames" / frame.file)
    told = call(run, "reduce", "check", "resume", "repair")
    flags = told["reduce"].split(",")
    assert flags[step.point or 0] == "damaged"
    assert flags.count("damaged") == 2  # the point, in two bands
    if kind == "device":  # a link: it is set aside, and the step is taken again
        assert told["resume"] == "done"
        assert "damaged" not in call(run, "reduce")["reduce"]
        assert {path.name for path in (run / "set-aside").iterdir()} == {frame.file for frame in step.frames}
        return
    for command in ("check", "resume", "repair"):  # none touches what somebody else has put there
        assert told[command].startswith("ConfigError")
        assert "is not a file" in told[command]
    for frame in step.frames:
        (run / "frames" / frame.file).unlink()
    assert call(run, "repair")["repair"] == "done"
    assert step.step not in Run.open(run).steps().numbers  # it counts no more


@pytest.mark.slow
def test_a_record_that_is_a_pipe_is_named(whole: Path, tmp_path: Path, call: Call) -> None:
    shutil.copytree(whole, tmp_path / "w")
    run = tmp_path / "w" / "run"
    frame = run / "frames" / "000900-550nm-01.dng"
    frame.write_bytes(b"a camera's own file")
    _pipe(frame.with_name(frame.name + BESIDE))
    told = call(run, "repair")["repair"]
    assert told.startswith("ConfigError")
    assert BESIDE in told
