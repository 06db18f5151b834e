"""Runs that are killed at random, with torn journals and full disks: every one resumes to the same table.

    python tools/kill_campaign.py [--times 100] [--seed 0] [--how parameters|curve]
    python tools/kill_campaign.py --plan PLAN.toml --sample SAMPLE.toml --rig RIG

The rig is `sim` with a sensor of 80 x 60 pixels. Its steps come so fast that they share their syncs; with `--rig sim`
each is synced by itself. Every run is a process of its own, forked from one that has the program loaded already.

Each time one of these happens to a run of `gonio measure`, in turn:

- kill: SIGKILL at a random moment, or after a random step;
- tear: the same, and the last line of the journal is cut at a random byte; zeros may follow, as a power cut leaves it;
- full: no file may grow beyond a random size, so that a write fails in its middle (RLIMIT_FSIZE needs no root).

Then the run is resumed, with the next such event, and in the end to its end. After every event it is asserted that no
step that was journalled is lost, and that none is there twice; in the end that the table is the one of a run that
nothing happened to. A run that ends before its event begins anew in another folder. With `--how` the run chooses its
points itself: the choices have to be the same too.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from gonio import plugins
from gonio.acquisition import measure, repair  # noqa: F401  here, rather than in every process
from gonio.cli import application  # noqa: F401
from gonio.cli import main as gonio
from gonio.reduction import table as reduction  # noqa: F401

PLAN = """name = "campaign"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 50]
theta_r_deg = { start = -60, stop = 60, step = 8 }
"""
ADAPTIVE = {
    "parameters": """name = "campaign"
wavelength_nm = [550]
[adaptive]
how = "parameters"
budget_h = 0.25
model = "lambert"
u_rel = { albedo = 0.001 }
theta_i_deg = [20, 50]
theta_r_deg = { start = -60, stop = 60, step = 10 }
""",
    "curve": """name = "campaign"
wavelength_nm = [550]
[adaptive]
how = "curve"
budget_h = 0.25
theta_i_deg = [30]
theta_r_deg = { start = -60, stop = 60, step = 5 }
""",
}
SAMPLE = 'name = "matte"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n'
EVENTS = ("kill", "tear", "full")
KILLED_UNSEEN_S = 0.01
"""Between two looks at how far a run is."""


def small(folder: Path) -> Path:
    """The rig file of `sim` with a small sensor of the same size in millimetres."""
    text: str = plugins.load("gonio.rigs", "sim").toml
    for key, value in (("width", 80), ("height", 60), ("pixel_um", 40.0)):
        text, found = re.subn(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", text)
        assert found == 1, key
    (folder / "rig.toml").write_text(text)
    return folder / "rig.toml"


def command(plan: Path, sample: Path, rig: str, out: Path, seed: int, *, resume: bool) -> list[str]:
    """The arguments of `gonio` for a run."""
    more = ["--resume"] if resume else []
    return ["measure", str(plan), "--rig", rig, "--sample", str(sample), "--seed", str(seed), "--out", str(out), *more]


def begin(arguments: list[str], tells: int, limit: int | None = None) -> int:
    """Start `gonio` in a process of its own, which writes what it says to a descriptor; the process's number."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(tells, 1)
        os.dup2(tells, 2)
        if limit is not None:
            limited(limit)
        sys.argv = ["gonio", *arguments]
        gonio()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)


def carried_out(arguments: list[str], limit: int | None = None) -> tuple[int, str]:
    """Let `gonio` run to its end: its exit code, and what it said."""
    hears, tells = os.pipe()
    child = begin(arguments, tells, limit)
    os.close(tells)
    with open(hears, encoding="utf-8", errors="replace") as file:
        said = file.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said


def lines(out: Path) -> list[bytes]:
    """The whole lines of a journal."""
    path = out / "journal.jsonl"
    whole, _, _ = path.read_bytes().rpartition(b"\n") if path.exists() else (b"", b"", b"")
    return whole.splitlines() if whole else []


def steps(out: Path) -> list[int]:
    """The steps of a journal, less those that it takes back, in the order of their lines."""
    found: list[int] = []
    for event in map(json.loads, lines(out)):
        if event["event"] == "step":
            found.append(event["step"])
        elif event["event"] == "lost":
            found = [number for number in found if number not in event["steps"]]
    return found


def choices(out: Path) -> list[object]:
    """What a journal says of the points that were chosen, and of whether they are enough."""
    told = [event for event in map(json.loads, lines(out)) if event["event"] in ("chosen", "enough")]
    return [{name: value for name, value in event.items() if name not in ("n", "wall", "crc")} for event in told]


def strike(how: str, call: list[str], out: Path, whole: int, longest_s: float, draw: random.Random) -> str:
    """Let a run be struck; what happened, "" where it ended before.

    `whole` is how many steps the run has, and `longest_s` how long it takes.
    """
    before = len(steps(out))
    if how == "full":
        # frames are of one size: a limit below it lets none be written, one above the journal's size tears a line
        limit = draw.choice([draw.randrange(1, 4096), journal_size(out) + draw.randrange(1, 20_000)])
        code, said = carried_out(call, limit)
        assert "Traceback" not in said, said
        assert code in (0, 1, 2), f"exit code {code}: {said}"
        return "" if code == 0 else f"at {limit} bytes: " + (said.strip().splitlines() or ["said nothing"])[-1][-90:]
    target = before + draw.randrange(0, max(whole - before, 1)) if draw.random() < 0.5 else -1
    nobody = os.open(os.devnull, os.O_WRONLY)
    child = begin(call, nobody)
    os.close(nobody)
    began, patience_s = time.monotonic(), draw.uniform(0.0, longest_s)
    status = 0
    while os.waitpid(child, os.WNOHANG) == (0, 0):
        if (target < 0 and time.monotonic() - began > patience_s) or (target >= 0 and len(steps(out)) > target):
            time.sleep(draw.uniform(0.0, KILLED_UNSEEN_S))
            os.kill(child, signal.SIGKILL)
            status = os.waitpid(child, 0)[1]
            break
        time.sleep(KILLED_UNSEEN_S)
    if not os.WIFSIGNALED(status) or os.WTERMSIG(status) != signal.SIGKILL:
        return ""
    if how == "tear" and len(found := lines(out)) > 1:
        journal = out / "journal.jsonl"
        kept = b"\n".join(found[:-1]) + b"\n"
        cut = draw.randrange(0, len(found[-1]) + 1)
        zeros = bytes(draw.randrange(0, 512)) if draw.random() < 0.3 else b""
        journal.write_bytes(kept + found[-1][:cut] + zeros)
        return f"torn at byte {cut} of the last line" + (f", {len(zeros)} zeros" if zeros else "")
    return f"at {len(steps(out))} steps"


def journal_size(out: Path) -> int:
    """Bytes of a journal."""
    path = out / "journal.jsonl"
    return path.stat().st_size if path.exists() else 0


def limited(limit: int) -> None:
    """In the child: writes beyond a size fail, and do not end the process."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))


def table(out: Path) -> bytes:
    """The reduced table of a run."""
    code, said = carried_out(["reduce", str(out)])
    assert code == 0, said
    return (out / "brdf.csv").read_bytes()


def campaign(times: int, seed: int, plan: Path, sample: Path, rig: str, work: Path) -> Counter[str]:
    """Strike runs so many times, and resume each to its end; how often each event happened."""
    draw, happened = random.Random(seed), Counter[str]()
    began = time.monotonic()
    code, said = carried_out(command(plan, sample, rig, work / "whole", 5, resume=False))
    assert code == 0, said
    took_s = time.monotonic() - began
    wanted, every, chosen = table(work / "whole"), sorted(steps(work / "whole")), choices(work / "whole")
    print(f"{len(every)} steps, {len(chosen)} choices", flush=True)
    number = 0
    while sum(happened.values()) < times:
        number += 1
        out = work / f"run-{number}"
        begun = False
        while sum(happened.values()) < times:
            how = EVENTS[sum(happened.values()) % len(EVENTS)]
            before = steps(out)
            call = command(plan, sample, rig, out, 5, resume=begun)
            told = strike(how, call, out, len(every), took_s, draw)
            begun = True
            after = steps(out)
            missing = set(before) - set(after)
            assert len(missing) <= (how == "tear"), f"lost: {sorted(missing)}"  # the line that was torn, at most
            assert len(after) == len(set(after)), f"twice: {after}"
            if not told:
                break
            happened[how] += 1
            print(f"{sum(happened.values()):4d} run {number}: {how} {told}", flush=True)
        code, said = carried_out(command(plan, sample, rig, out, 5, resume=True))
        assert code == 0, said
        assert sorted(steps(out)) == every, f"{out}: {len(steps(out))} steps of {len(every)}"
        assert choices(out) == chosen, f"{out}: other points were chosen"
        assert table(out) == wanted, f"{out}: another table"
        named = {frame["file"] for e in map(json.loads, lines(out)) if e["event"] == "step" for frame in e["frames"]}
        there = {path.name for path in (out / "frames").iterdir()}
        assert there == named, f"{out}: frames that nothing names: {sorted(there - named)[:5]}"
        print(f"     run {number}: complete, the same table", flush=True)
        shutil.rmtree(out)
    return happened


def main() -> None:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--how", choices=sorted(ADAPTIVE), help="a run that chooses its points")
    parser.add_argument("--plan", type=Path)
    parser.add_argument("--sample", type=Path)
    parser.add_argument("--rig", help="in place of `sim` with a small sensor")
    asked = parser.parse_args()
    if asked.how:
        plugins.load("gonio.choosers", asked.how)
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        work = Path(folder)
        (work / "plan.toml").write_text(ADAPTIVE.get(asked.how, PLAN))
        (work / "sample.toml").write_text(SAMPLE)
        plan, sample = asked.plan or work / "plan.toml", asked.sample or work / "sample.toml"
        happened = campaign(asked.times, asked.seed, plan, sample, asked.rig or str(small(work)), work)
    print(f"{sum(happened.values())} times: " + ", ".join(f"{count} {how}" for how, count in sorted(happened.items())))


if __name__ == "__main__":
    main()
