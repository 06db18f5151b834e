"""What the engine itself costs: runs of many points on a rig whose devices answer at once.

    python tools/engine_overhead.py [--points 100000] [--out FOLDER] [--frames 1] [--without-sync] [--profile]

Wall time and processor time a point, as the run grows; memory; how long a plan, a start and a resume take. With
`--without-sync` nothing waits for the disk, so that what is left is the engine's own work. `--profile` prints where the
main thread's time goes.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import resource
import shutil
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import Plan, load_plan
from gonio.acquisition.progress import Live, Silent
from gonio.errors import Interrupted
from gonio.rig import Frame, Pose, Step, Target
from gonio.rig.bands import Band, Bands
from gonio.rig.description import Acquisition, Arms, Holder, Reference, RigDescription, SampleDescription
from gonio.rig.light_and_camera import Camera

SAMPLE = SampleDescription(name="matte", model="lambert", parameters={"albedo": 0.5})
PARTS = 10
"""A run is timed in so many parts."""


def describe(frames: int) -> RigDescription:
    """A rig with every axis, one band, and the smallest frames that hold the patch."""
    return RigDescription(
        rig="instant",
        name="bench of instant devices",
        holder=Holder(axes=("tilt", "spin")),
        arms=Arms(),
        bands=Bands(list=(Band(name="550", centre_nm=550, fwhm_nm=20),)),
        camera=Camera(width=64, height=48, pixel_um=40, exposure_limits_s=(1e-4, 10.0)),
        reference=Reference(every=100, frames=2),
        acquisition=Acquisition(frames=frames, dark_frames=2, roi_radius_mm=3.0),
    )


@dataclass
class Instant:
    """A rig of which every device answers at once, and is all that the engine waits for."""

    description: RigDescription
    repeatable: bool = True
    pose: Pose = field(default_factory=Pose)
    _time_s: float = 0.0

    def __post_init__(self) -> None:
        camera = self.description.camera
        level = camera.black_level_dn + 0.6 * (
            min(camera.white_level_dn - camera.black_level_dn, camera.full_well_e / camera.electrons_per_dn)
        )
        self._mosaic = np.full((camera.height, camera.width), level, dtype=np.uint16)

    @property
    def arms(self) -> Self:
        return self

    @property
    def light(self) -> Self:
        return self

    @property
    def camera(self) -> Self:
        return self

    def begin(self, step: Step) -> None: ...
    def present(self, target: Target) -> None: ...
    def time_s(self) -> float:
        self._time_s += 1e-3
        return self._time_s

    def move(self, goal: Pose) -> Pose:
        self.pose = goal
        return goal

    def read(self) -> Pose:
        return self.pose

    def stop(self) -> None: ...
    def park(self) -> None: ...
    def select(self, band: Band) -> None: ...
    def on(self) -> None: ...
    def off(self) -> None: ...
    def capture(self, exposure_s: float) -> Frame:
        camera = self.description.camera
        return Frame(self._mosaic, exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=self.time_s())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Plugin:
    """Opens the instant rig."""

    toml = ""

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> Instant:
        return Instant(description)


class Timed(Silent):
    """Notes time and memory as the run grows; ends it before its last steps where that is asked for."""

    def __init__(self, every: int, most: int | None = None) -> None:
        self.every, self.most, self.count = every, most, 0
        self.marks: list[tuple[int, float, float, float, float]] = []

    def step(self, live: Live) -> None:
        """After every step."""
        if self.count % self.every == 0:
            self.marks.append((self.count, time.perf_counter(), time.process_time(), memory_mb(), time.thread_time()))
        self.count += 1
        if self.count == self.most:
            raise Interrupted("left before its end")


def memory_mb() -> float:
    """Resident memory of this process, now [MB]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6


def many_points(points: int, folder: Path) -> Plan:
    """A plan of about so many points in and out of plane."""
    theta_r = max(points // 1000, 1)
    text = f"""name = "many"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = {{ start = 10, stop = 50, step = {40 / 49} }}
theta_r_deg = {[round(5 + 60 * k / theta_r, 6) for k in range(theta_r)]}
dphi_deg = {[20 + 8 * k for k in range(20)]}
"""
    (folder / "plan.toml").write_text(text)
    return load_plan(folder / "plan.toml")


def main() -> None:
    """Measure, resume, and say what it cost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--frames", type=int, default=1, help="equal frames a point; a shorter one follows them")
    parser.add_argument("--out", type=Path, help="a folder on the disk that is meant; else a temporary one")
    parser.add_argument("--without-sync", action="store_true")
    parser.add_argument("--profile", action="store_true")
    asked = parser.parse_args()
    if asked.without_sync:
        os.fsync = lambda descriptor: None
    description = describe(asked.frames)
    rig = RigChoice(Plugin(), description, "instant")
    with tempfile.TemporaryDirectory(prefix="overhead-", dir=asked.out) as work:
        folder = Path(work)
        began = time.perf_counter()
        plan = many_points(asked.points, folder)
        print(f"plan of {len(plan.points)} points: {time.perf_counter() - began:.2f} s")
        watcher = Timed(max(len(plan.points) // PARTS, 1))
        profile = cProfile.Profile() if asked.profile else None
        began = time.perf_counter()
        if profile is not None:
            profile.enable()
        carry_out(plan, rig, folder / "run", sample=SAMPLE, progress=watcher)
        if profile is not None:
            profile.disable()
        ended, steps = time.perf_counter(), watcher.count
        print(f"before the first step: {watcher.marks[0][1] - began:.2f} s; {steps} steps in {ended - began:.1f} s")
        for (n0, w0, c0, _, t0), (n1, w1, c1, m1, t1) in zip(watcher.marks, watcher.marks[1:], strict=False):
            each = 1e3 / (n1 - n0)
            spent = f"processor {(c1 - c0) * each:.3f} ms (main thread {(t1 - t0) * each:.3f})"
            print(f"steps {n0:>6} to {n1:>6}: {(w1 - w0) * each:.3f} ms a step, {spent}, memory {m1:.1f} MB")
        if profile is not None:
            pstats.Stats(profile).sort_stats("tottime").print_stats(40)
            return
        journal = folder / "run" / "journal.jsonl"
        kept = journal.read_bytes()
        journal.write_bytes(b"".join(kept.splitlines(keepends=True)[:-6]))  # as if it had been cut short
        for name in sorted(os.listdir(folder / "run" / "frames"))[-4 * (asked.frames + 1) :]:
            (folder / "run" / "frames" / name).unlink()
        again = Timed(1)
        began = time.perf_counter()
        carry_out(plan, rig, folder / "run", sample=SAMPLE, resume=True, progress=again)
        first = again.marks[0][1] - began
        print(f"resumed: first step after {first:.2f} s, {again.count} steps, memory {memory_mb():.1f} MB")
        shutil.rmtree(folder / "run")


if __name__ == "__main__":
    main()
