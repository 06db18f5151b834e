"""What watching costs, and how soon a step is on the screen: the figures of docs/measurements/watching.md.

    python tools/watching_cost.py writer [--lines 4000] [--watchers 10] [--rounds 5] [--clients]
    python tools/watching_cost.py run [--watchers 10] [--rounds 2] [--clients] [--apart 2.5]
    python tools/watching_cost.py screen [--steps 40]

`writer` plays a run on instant devices: a process that appends steps to a journal, one after the other. Rounds with and
without watchers (`gonio watch`, a process each) alternate; the ratio of their times is told, and the watchers' own
processor time. `run` measures a plan on the rig `sim`, with and without watchers in turns, and tells the processor time
of the process that measures and of the watchers. With `--clients` each watcher has a reader of its stream that fetches
values and frames as the page does. `screen` opens the page in Chromium, and times a step from the end of its line's
write until the page shows its number.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GONIO = [sys.executable, "-c", "from gonio.cli import main; main()"]


def event(number: int) -> dict[str, object]:
    """A step as long as those of a laboratory rig."""
    frames = [
        {"file": f"{number:06d}-550nm-{k:02d}.dng", "band": "550nm", "exposure_s": 0.1234, "time_s": 1.9e9 + number,
         "lamp": True, "sha256": "0" * 64, "bytes": 600000}
        for k in range(3)
    ]  # fmt: skip
    pose = {"light": 0.5, "camera": 0.25, "tilt": 0.0, "spin": 0.0, "azimuth": 0.0}
    health = [[axis, "temperature", 31.0, "C"] for axis in pose]
    return {
        "event": "step", "step": number, "kind": "point", "point": number, "time_s": 1.9e9 + number, "goal": pose,
        "pose": pose, "pose_time_s": 1.9e9, "level_per_s": {"550nm": 4.9}, "health": health, "flag": "",
        "frames": frames,
    }  # fmt: skip


def write(run: Path, lines: int) -> float:
    """Append so many steps to a new journal; how long that took [s]."""
    from gonio.acquisition.journal import Journal

    (run / "journal.jsonl").unlink(missing_ok=True)
    with Journal(run / "journal.jsonl") as journal:
        journal.append({"event": "session", "gonio": "", "steps": lines, "left": lines})
        began = time.perf_counter()
        for number in range(lines):
            journal.append(event(number))
        return time.perf_counter() - began


@contextmanager
def watchers(run: Path, count: int, clients: bool, state: Path) -> Iterator[list[int]]:
    """So many processes that watch a run; their ids."""
    with ExitStack() as running:
        started = []
        environment = dict(os.environ, XDG_STATE_HOME=str(state), XDG_RUNTIME_DIR="")
        for _ in range(count):
            watcher = subprocess.Popen([*GONIO, "watch", str(run)], stdout=subprocess.PIPE, env=environment, text=True)
            running.callback(watcher.wait)
            running.callback(watcher.terminate)
            started.append(watcher)
        for watcher in started:
            assert watcher.stdout is not None
            address = watcher.stdout.readline().strip()
            if clients:
                threading.Thread(target=drain, args=(address.replace("/?", "/events?"),), daemon=True).start()
        time.sleep(5.0)  # what was there before is read, and what begins has begun
        yield family({watcher.pid for watcher in started})


def family(processes: set[int]) -> list[int]:
    """Processes and those that they have begun: one of the watchers has values worked out by another process."""
    out = set(processes)
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(entry.read_text().rpartition(")")[2].split()[1]) in processes:
                out.add(int(entry.parent.name))
    return sorted(out)


def drain(address: str) -> None:
    """Take a stream's events until it ends; values and frames are fetched one at a time, as by a page."""

    def fetch(what: str) -> None:
        with contextlib.suppress(OSError), urllib.request.urlopen(address.replace("/events?", f"/{what}?")) as answer:
            answer.read()

    values = frame = None
    with contextlib.suppress(OSError), urllib.request.urlopen(address) as stream:
        busy: dict[str, threading.Thread] = {}
        kind = ""
        for line in stream:
            kind = line[7:].decode().strip() if line.startswith(b"event: ") else kind
            if not line.startswith(b"data: ") or kind not in ("status", "curves"):
                continue
            told = json.loads(line[6:])
            due = []
            if kind == "curves" and told["version"] != values:
                due, values = ["curves"], told["version"]
            elif kind == "status" and told["frame"] not in (None, frame):
                due, frame = ["frame"], told["frame"]
            for what in due:
                if what not in busy or not busy[what].is_alive():
                    busy[what] = threading.Thread(target=fetch, args=(what,), daemon=True)
                    busy[what].start()


def processor_s(process: int) -> float:
    """What a process has used of processors [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def writer(lines: int, count: int, rounds: int, clients: bool) -> None:
    """Print how much longer the journal's writer takes with watchers, and what they use."""
    with tempfile.TemporaryDirectory() as folder:
        run, state = Path(folder) / "run", Path(folder) / "state"
        run.mkdir()
        write(run, 100)
        alone, watched, used = [], [], []
        for _ in range(rounds):
            alone.append(write(run, lines))
            with watchers(run, count, clients, state) as ids:
                before = sum(map(processor_s, ids))
                watched.append(write(run, lines))
                time.sleep(1.0)  # they catch up
                used.append(sum(map(processor_s, ids)) - before)
        ratios = [b / a for a, b in zip(alone, watched, strict=True)]
        print(
            f"{lines} steps alone: {statistics.median(alone):.2f} s, {1e3 * min(alone) / lines:.3f} ms a step at best"
        )
        print(f"with {count} watchers{' and clients' if clients else ''}: {statistics.median(watched):.2f} s")
        print(f"ratio, median of {rounds}: {statistics.median(ratios):.4f} ({', '.join(f'{r:.3f}' for r in ratios)})")
        each = statistics.median(used) / lines / count
        print(f"a watcher uses {1e6 * each:.0f} us of a processor a step")


PLAN = """
name = "in plane"
wavelength_nm = [500]
[[sweep]]
theta_i_deg = [30, 60]
theta_r_deg = {{ start = -80, stop = 80, step = {apart} }}
"""


def measured(folder: Path, run: Path, apart: float) -> tuple[float, float]:
    """Measure the plan on the rig `sim`; how long that took [s], and the processor time of it [s]."""
    (folder / "plan.toml").write_text(PLAN.format(apart=apart))
    (folder / "sample.toml").write_text('name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    sample = ["--sample", str(folder / "sample.toml")]
    rest = ["--rig", "sim", "--out", str(run), "--seed", "1", "--yes"]
    command = [*GONIO, "measure", str(folder / "plan.toml"), *sample, *rest]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def whole_run(count: int, rounds: int, clients: bool, apart: float) -> None:
    """Print what watchers of a real run cost it, and themselves."""
    wall, processor = [], []
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        for round_ in range(rounds):
            took, own = measured(here, here / "alone", apart)
            run = here / "run"
            with watchers(run, count, clients, here / "state") as ids:
                before = sum(map(processor_s, ids))
                took_too, own_too = measured(here, run, apart)
                used = sum(map(processor_s, ids)) - before
            wall.append(took_too / took)
            processor.append(own_too / own)
            print(
                f"round {round_}: alone {took:.1f} s, processor {own:.1f} s; with {count} watchers"
                f"{' and clients' if clients else ''} {took_too:.1f} s, processor {own_too:.1f} s; "
                f"all watchers {used:.2f} s of processor, {100 * used / took_too:.1f} % of one",
                flush=True,
            )
            for done in (here / "alone", run):
                shutil.rmtree(done)
        print(f"with watchers over alone, medians: time {statistics.median(wall):.4f}, processor of the run ", end="")
        print(f"{statistics.median(processor):.4f}")


def screen(steps: int) -> None:
    """Print how long a step takes from the journal to the page."""
    sys.path.insert(0, str(ROOT))
    from gonio.acquisition.journal import Journal
    from tests.browser import browser

    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        run.mkdir()
        environment = dict(os.environ, XDG_STATE_HOME=folder)
        with subprocess.Popen(
            [*GONIO, "watch", str(run)], stdout=subprocess.PIPE, env=environment, text=True
        ) as watcher:
            assert watcher.stdout is not None
            address = watcher.stdout.readline().strip()
            with browser(Path(folder) / "profile") as page, Journal(run / "journal.jsonl") as journal:
                page.open(address, 1280)
                journal.append({"event": "session", "gonio": "", "steps": steps, "left": steps})
                took = []
                for number in range(steps):
                    time.sleep(0.25 + 0.013 * (number % 16))  # at any moment of the watcher's round
                    journal.append(event(number))
                    took.append(page.until(f"document.getElementById('done').textContent === '{number + 1}'"))
                print(
                    f"from line to screen: median {statistics.median(took):.2f} s, longest {max(took):.2f} s of {steps}"
                )
            watcher.terminate()


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("writer", "run", "screen"))
    parser.add_argument("--lines", type=int, default=4000)
    parser.add_argument("--watchers", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--clients", action="store_true")
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--apart", type=float, default=2.5, help="degrees from point to point: the smaller, the longer")
    asked = parser.parse_args()
    if asked.what == "writer":
        writer(asked.lines, asked.watchers, asked.rounds, asked.clients)
    elif asked.what == "run":
        whole_run(asked.watchers, asked.rounds, asked.clients, asked.apart)
    else:
        screen(asked.steps)


if __name__ == "__main__":
    main()
