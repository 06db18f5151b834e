"""What is left of a run, and going on with it.

What its frames and its journal are worth is found first, and acted on when nothing refuses.
"""

import os
from dataclasses import dataclass
from pathlib import Path

from gonio.disk import write_own
from gonio.errors import ConfigError, os_error_as
from gonio.lab.acquisition.journal import Journal
from gonio.lab.acquisition.plan import plan_csv
from gonio.lab.acquisition.repair import ASIDE, FramesFound, find_damage, require_frames_only, set_orphans_aside
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.run_settings import RunRequest, differences, settings_for
from gonio.lab.acquisition.schedule import Schedule
from gonio.lab.rig import Pose
from gonio.lab.rig.laboratory import Laboratory


@dataclass(frozen=True)
class Resumed:
    """A run that is gone on with, and what was found among its frames."""

    run: Run
    found: FramesFound
    stated: Laboratory | None

    @property
    def lost(self) -> list[str]:
        """Which frames are missing or damaged, and how."""
        return [text for number in sorted(self.found.damaged) for text in self.found.damaged[number]]

    def set_right(self) -> list[str]:
        """Set frames aside that do not count, and take back the steps of damaged ones.

        What may still refuse to go on comes before this: until then the folder is as it was. The names of frames that
        were set aside although nothing is wrong with them: their steps were cut short.

        Raises
        ------
        ConfigError
            The folder cannot be written.
        """
        run, orphans = self.run, self.found.orphans
        with os_error_as(ConfigError, f"{run.path}: cannot be written"):
            run.state(self.stated)
            set_orphans_aside(run, self.found)
            run.take_back(self.found.damaged)
            if orphans:
                names = ", ".join(orphans[:5]) + (" ..." if len(orphans) > 5 else "")
                text = f"{len(orphans)} files of no step that is done were moved to {ASIDE}/: {names}"
                run.append({"event": "remark", "message": text})
        return orphans


def unfinished(run: Run) -> str:
    """What of a run was not measured yet, in words; "" where every step is done."""
    rows = [row for row, flag in enumerate(run.planned.flags) if not flag]
    planned, done = Schedule(run.description, rows, lambda row: Pose()), set(run.steps().numbers)
    left = [planned[number] for number in range(len(planned)) if number not in done]
    left += [step for step in run.grown_steps() if step.index not in done]
    points = run.points.flags.count("")
    measured = points - sum(step.kind == "point" for step in left)
    if not left and (run.settings.adaptive is None or run.enough):
        return ""
    rest = ", and its sampler has not said that this is enough"
    if left:
        rest = "" if measured < points else f", and {len(left)} measurements of the reference or dark steps are not"
    known = f"{measured} of {points} points are measured{rest}"
    return f"the run is not finished: {known}; `gonio measure ... --resume` goes on"


def reopened(path: Path, request: RunRequest) -> Resumed:
    """Open a run that has begun, to go on with it. Nothing in it is changed but a plan.csv that is missing.

    Raises
    ------
    ConfigError
        Plan, rig, sample or seed are not those of the run (the message names what differs), another process writes to
        it, or among its frames lies something that is none.
    DataError
        The journal is damaged before its last line, or plan.csv was changed.
    """
    run = Run.open(path)
    run.journal = Journal(path / "journal.jsonl")
    try:
        now = settings_for(request, request.description)
        differing = differences(run.settings, now)
        if differing:
            raise ConfigError(
                f"{path}: this run was begun with something else, so it cannot be resumed:\n"
                + "\n".join(f"  {line}" for line in differing[:8])
                + "\nresume with what it was begun with, or measure into a new folder"
            )
        if os.path.lexists(path / "plan.csv"):
            _ = run.points
        (path / "frames").mkdir(exist_ok=True)
        found = find_damage(run)
        require_frames_only(run, found.orphans)
        if not os.path.lexists(path / "plan.csv"):
            write_own(path, {"plan.csv": plan_csv(request.points).encode()})
    except OSError as error:
        run.journal.close()
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
    except BaseException:
        run.journal.close()
        raise
    return Resumed(run, found, now.laboratory)
