"""Runs that are killed at random, with torn journals and full disks: every one resumes to the same table.

    python tools/kill_campaign.py [--times 100] [--seed 0] [--how parameters|curve]
    python tools/kill_campaign.py --plan PLAN.toml --sample SAMPLE.toml --rig RIG

Each time one of these happens to a run of `gonio measure`, in turn:

- kill: SIGKILL at a random moment;
- tear: the same, and the last line of the journal is cut at a random byte; zeros may follow, as a power cut leaves it;
- full: no file may grow beyond a random size, so that a write fails in its middle (RLIMIT_FSIZE needs no root).

Then the run is resumed, with the next such event, and in the end to its end. After every event it is asserted that no
step that was journalled is lost, and that none is there twice; in the end that the table is the one of a run that
nothing happened to. A run that ends before its event begins anew in another folder. With `--how` the run chooses its
points itself: the choices have to be the same too.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

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
KILLED_UNSEEN_S = 0.02
"""Between two looks at how far a run is."""


def command(plan: Path, sample: Path, rig: str, out: Path, seed: int, *, resume: bool) -> list[str]:
    """The command line of a run."""
    gonio = [sys.executable, "-c", "from gonio.cli import main; main()", "measure", str(plan), "--rig", rig]
    more = ["--resume"] if resume else []
    return [*gonio, "--sample", str(sample), "--seed", str(seed), "--out", str(out), *more]


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


def strike(how: str, call: list[str], out: Path, whole: int, draw: random.Random) -> str:
    """Let a run be struck; what happened, "" where it ended before."""
    before = len(steps(out))
    if how == "full":
        # frames are of one size: a limit below it lets none be written, one above the journal's size tears a line
        limit = draw.choice([draw.randrange(1, 4096), journal_size(out) + draw.randrange(1, 20_000)])
        done = subprocess.run(call, capture_output=True, text=True, check=False, preexec_fn=lambda: limited(limit))
        assert "Traceback" not in done.stderr, done.stderr
        assert done.returncode in (0, 1, 2), f"exit code {done.returncode}: {done.stderr}"
        return "" if done.returncode == 0 else done.stderr.strip().splitlines()[-1][-90:]
    target = before + draw.randrange(0, max(whole - before, 1)) if draw.random() < 0.8 else -1
    process = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)
    began, patience_s = time.monotonic(), draw.uniform(0.0, 4.0)
    while process.poll() is None:
        if (target < 0 and time.monotonic() - began > patience_s) or (target >= 0 and len(steps(out)) > target):
            time.sleep(draw.uniform(0.0, 0.05))
            process.send_signal(signal.SIGKILL)
            break
        time.sleep(KILLED_UNSEEN_S)
    process.wait()
    if process.returncode != -signal.SIGKILL:
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
    done = subprocess.run(
        [sys.executable, "-c", "from gonio.cli import main; main()", "reduce", str(out)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return (out / "brdf.csv").read_bytes()


def campaign(times: int, seed: int, plan: Path, sample: Path, rig: str, work: Path) -> Counter[str]:
    """Strike runs so many times, and resume each to its end; how often each event happened."""
    draw, happened = random.Random(seed), Counter[str]()
    done = subprocess.run(command(plan, sample, rig, work / "whole", 5, resume=False), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
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
            told = strike(how, call, out, len(every), draw)
            begun = True
            after = steps(out)
            missing = set(before) - set(after)
            assert len(missing) <= (how == "tear"), f"lost: {sorted(missing)}"  # the line that was torn, at most
            assert len(after) == len(set(after)), f"twice: {after}"
            if not told:
                break
            happened[how] += 1
            print(f"{sum(happened.values()):4d} run {number}: {how} {told}", flush=True)
        last = subprocess.run(
            command(plan, sample, rig, out, 5, resume=True), capture_output=True, text=True, check=False
        )
        assert last.returncode == 0, last.stderr
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
    parser.add_argument("--rig", default="sim")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        work = Path(folder)
        (work / "plan.toml").write_text(ADAPTIVE.get(asked.how, PLAN))
        (work / "sample.toml").write_text(SAMPLE)
        plan, sample = asked.plan or work / "plan.toml", asked.sample or work / "sample.toml"
        happened = campaign(asked.times, asked.seed, plan, sample, asked.rig, work)
    print(f"{sum(happened.values())} times: " + ", ".join(f"{count} {how}" for how, count in sorted(happened.items())))


if __name__ == "__main__":
    main()
