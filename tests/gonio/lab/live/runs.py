"""A measured run, and one that is being measured: its journal comes line by line."""

import shutil
from pathlib import Path

from gonio.lab.acquisition.journal import Event, decode
from tests.gonio import numpy_rig

PLAN = """
name = "in plane and out of it"
wavelength_nm = [550, 650]
[[sweep]]
theta_i_deg = [30, 45]
theta_r_deg = [-60, -10, 10, 30, 45, 60]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [20, 40]
dphi_deg = [45, 90]
"""


def measured(folder: Path, plan: str = PLAN) -> Path:
    """A whole run on the rig of numpy."""
    return numpy_rig.measured(numpy_rig.plan_in(folder, plan), folder / "run").path


class Played:
    """A run that another process seems to measure: what a whole one wrote, in the same order."""

    def __init__(self, whole: Path, path: Path) -> None:
        self.path = path
        self.lines = (whole / "journal.jsonl").read_bytes().splitlines(keepends=True)
        shutil.copytree(whole, path)
        (path / "journal.jsonl").unlink()
        self.written = 0

    def event(self, number: int) -> Event:
        """What a line of the journal says."""
        found = decode(self.lines[number])
        assert found is not None
        return found

    def go_on(self, lines: int = 1) -> None:
        """Write more lines of the journal."""
        self.append(b"".join(self.lines[self.written : self.written + lines]))
        self.written += lines

    def append(self, data: bytes) -> None:
        """Write bytes to the journal."""
        with open(self.path / "journal.jsonl", "ab") as journal:
            journal.write(data)
