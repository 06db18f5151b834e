"""The sampler and the export of docs/writing_a_sampler.md, as a stranger would install them."""

from __future__ import annotations

import csv
import math
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gonio import plugins
from gonio.errors import ConfigError, Interrupted
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from tests.command_line import gonio
from tests.gonio.cli.test_cli import installed
from tests.gonio.numpy_rig import NumpyRig, Plugin, StopAfter, measured
from tests.places import ROOT, example, fenced

pytestmark = pytest.mark.slow

GUIDE = ROOT / "docs" / "writing_a_sampler.md"
block = partial(fenced, GUIDE)


@pytest.fixture
def stranger(tmp_path: Path) -> str:
    """The guide's packages, installed; what goes onto the search path."""
    points = []
    for group in ("gonio.choosers", "gonio.exports"):
        named = tomllib.loads(block("toml", f'entry-points."{group}"'))["project"]["entry-points"][group]
        points += [f"[{group}]", *(f"{name} = stranger:{target.partition(':')[2]}" for name, target in named.items())]
    module = example("halving.py") + "\n\n" + example("list_of_frames.py")
    site = installed(tmp_path, points[0].strip("[]"), "\n".join(points[1:]), module)
    (tmp_path / "plan.toml").write_text(block("toml", 'how = "halving"'))
    return site


class Glossy(NumpyRig):
    """A lobe of eight degrees around the mirror direction, on a matt ground."""

    def capture(self, exposure_s: float) -> Frame:
        """Camera and light are on either side of the normal."""
        off = math.degrees(self.pose.camera + self.pose.light)
        self.albedo = 0.1 + 0.7 * math.exp(-((off / 8.0) ** 2))
        return super().capture(exposure_s)


class GlossyPlugin(Plugin):
    """Its entry point."""

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> NumpyRig:
        """Without a device."""
        return Glossy(description, seed)


def measure(tmp_path: Path, out: str, **options: Any) -> Run:
    return measured(load_plan(tmp_path / "plan.toml"), tmp_path / out, GlossyPlugin(), **options)


@pytest.fixture
def here(stranger: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The same in this process."""
    monkeypatch.syspath_prepend(stranger)
    yield stranger
    sys.modules.pop("stranger", None)


@pytest.mark.usefixtures("one_id")
def test_its_chooser_measures_and_goes_on_as_it_would_have_gone(tmp_path: Path, here: str) -> None:
    whole = measure(tmp_path, "whole")
    (end,) = [event for event in whole.events() if event["event"] == "enough"]
    assert end["met"]
    chosen = [point.theta_r_deg for batch in whole.batches for point in batch.points]
    assert len(whole.batches) >= 3
    assert sum(abs(angle - 30.0) < 20.0 for angle in chosen) > 0.8 * len(chosen), "the lobe is where points are wanted"
    with pytest.raises(Interrupted):
        measure(tmp_path, "run", progress=StopAfter(whole.batches[1].first_step + 1))
    again = measure(tmp_path, "run", resume=True)
    assert again.batches == whole.batches
    assert list(again.steps()) == list(whole.steps())


def test_its_budget_and_its_keys_count(tmp_path: Path, here: str) -> None:
    plan = (tmp_path / "plan.toml").read_text()
    (tmp_path / "plan.toml").write_text(plan.replace("budget_h = 2.0", "budget_h = 0.001"))
    run = measure(tmp_path, "short")
    (end,) = [event for event in run.events() if event["event"] == "enough"]
    assert not end["met"]
    assert "the budget is spent" in end["message"]
    (tmp_path / "plan.toml").write_text(plan + "ration = 2\n")
    with pytest.raises(ConfigError, match=r'plan\.toml: \[adaptive\].*unknown key ration; did you mean "ratio"'):
        measure(tmp_path, "none")


def test_a_stranger_s_entry_points_are_found_by_the_commands(tmp_path: Path, here: str) -> None:
    shown = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "sim", expect=0)
    assert "halves gaps over which the BRDF changes by more than 1.5 times" in shown.stdout
    run = measure(tmp_path, "run")
    done = gonio(tmp_path, "convert", "run", "frames.csv", "--to", "frames", expect=0)
    assert re.search(r"frames\.csv: \d+ frames", done.stdout)
    with (tmp_path / "frames.csv").open() as table:
        rows = list(csv.DictReader(table))
    frames = [frame for step in run.steps() for frame in step.frames]
    assert [row["file"] for row in rows] == [frame.file for frame in frames]
    assert [float(row["exposure_s"]) for row in rows] == [frame.exposure_s for frame in frames]
    with pytest.raises(ConfigError, match=r"name a \.csv"):
        plugins.load("gonio.exports", "frames")(str(tmp_path / "run"), tmp_path / "frames.txt")
    assert not (tmp_path / "frames.txt").exists()
