"""A plan on a rig with bodies: what is blocked is left out and said, the rest is measured, and nothing is touched."""

from pathlib import Path

import pandas as pd
import pytest
from gonio_sim.rig import SIM_IDEAL
from gonio_sim.world import World

from tests.command_line import gonio as run
from tests.command_line import says

BODIES = """
[[bodies]]
name = "light bar"
on = "light"
from_mm = [0, 200, 0]
to_mm = [0, 200, 1020]
radius_mm = 20

[[bodies]]
name = "cabinet"
on = "bench"
centre_mm = [260, 0, 960]
size_mm = [100, 300, 100]
"""
PLAN = """
name = "in plane"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [0, 20, 45, 60]
"""
SAMPLE = """
name = "matt"
model = "lambert"
parameters = { albedo = 0.5 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.toml").write_text(SIM_IDEAL.toml + BODIES)
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "sample.toml").write_text(SAMPLE)
    return tmp_path


def test_blocked_points_are_left_out_and_said(folder: Path) -> None:
    shown = run(folder, "plan", "show", "plan.toml", "--rig", "rig.toml")
    assert shown.returncode == 0, shown.stderr
    says(shown.stdout, "blocked: 0, 20", "the way there would touch: ", "cabinet")
    measured = run(
        folder, "measure", "plan.toml", "--rig", "rig.toml", "--sample", "sample.toml", "--out", "RUN", "--yes"
    )
    assert "2 points measured, 2 not (2 blocked)" in measured.stdout + measured.stderr
    assert run(folder, "reduce", "RUN").returncode == 0
    table = pd.read_csv(folder / "RUN" / "brdf.csv", comment="#")
    assert list(table["flag"].fillna("")) == ["blocked", "blocked", "", ""]
    # a matt sample on a rig without errors: noise apart the value is albedo/pi
    assert table["brdf"].iloc[2:].to_numpy() == pytest.approx(0.5 / 3.14159265, rel=1e-3)


def test_nothing_is_touched_on_the_ways_of_a_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    worlds: list[World] = []
    begin = World.begin

    def kept(world: World, step: int) -> None:
        worlds.append(world)
        begin(world, step)

    monkeypatch.setattr(World, "begin", kept)
    run(
        folder,
        "measure",
        "plan.toml",
        "--rig",
        "rig.toml",
        "--sample",
        "sample.toml",
        "--out",
        "RUN",
        "--yes",
        expect=0,
    )
    assert worlds
    assert worlds[-1].touched == []


def test_a_blocked_way_by_hand_moves_nothing(folder: Path) -> None:
    refused = run(folder, "rig", "move", "light=30", "camera=-30", "--rig", "rig.toml")
    assert refused.returncode == 2
    assert "would touch: source head and camera head" in refused.stderr
