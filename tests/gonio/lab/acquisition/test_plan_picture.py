"""The picture of a plan on a rig: what is drawn where, and what is said."""

from pathlib import Path

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.lab.acquisition import plan_picture
from gonio.lab.acquisition.plan import assess
from gonio.lab.acquisition.schedule import schedule
from gonio.lab.rig import Pose, motion_planning
from gonio.lab.rig.description import ArmAxis, Arms, Body, Cable, Holder
from tests.gonio.numpy_rig import describe, plan_in

POST = Body(name="post", on="bench", from_mm=(500, 0, 870), to_mm=(500, 0, 870), radius_mm=40.0)
LEAD = Cable(
    name="lead", from_on="bench", from_mm=(0, 500, 0), to_on="light", to_mm=(0, 0, 1000), length_mm=2000, sag_mm=30
)
PLAN = """
name = "both"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [10, 45]
theta_r_deg = [-60, -10, 30, 60]
"""
OUT_OF_PLANE = PLAN + "dphi_deg = [45, 180]\n"


@pytest.mark.parametrize(("text", "azimuth"), [(PLAN, True), (OUT_OF_PLANE, False)])
def test_a_picture_counts_all_points_and_shows_the_most_crowded_step(tmp_path: Path, text: str, azimuth: bool) -> None:
    plan = plan_in(tmp_path, text)
    rig = describe(
        arms=Arms(azimuth=ArmAxis(limits_deg=(-190, 190)) if azimuth else None),
        holder=Holder(axes=("spin",) if azimuth else ("tilt", "spin")),
        bodies=(POST,),
        cables=(LEAD,),
    )
    points = assess(plan, rig)
    steps = schedule(plan, rig, points)
    figure = plan_picture.draw(plan, points, steps, rig)
    figure.savefig(tmp_path / "out.svg")
    assert (tmp_path / "out.svg").stat().st_size > 10_000
    said = [text.get_text() for part in figure.subfigs for legend in part.legends for text in legend.get_texts()]
    assert sum([int(words.split()[0]) for words in said if words.split()[0].isdigit()]) == len(points)
    measured = sum(each.pose is not None for each in points)
    assert 0 < measured < len(points)
    assert f"{measured} measured" in said
    crowded = steps[plan_picture.most_crowded(steps, rig)]
    closest = [
        min(each.values())
        for each in motion_planning.clearances(rig, [step.pose for step in steps if step.kind != "dark"])
    ]
    assert min(motion_planning.clearances(rig, [crowded.pose])[0].values()) == min(closest)
    with pytest.raises(ConfigError, match=r"--step 99: the steps of this plan are numbered 0 to \d+"):
        plan_picture.draw(plan, points, steps, rig, 99)


def test_a_body_is_drawn_where_it_stands() -> None:
    rig = describe(bodies=(POST, Body(name="box", on="light", centre_mm=(0, 0, 500), size_mm=(20, 40, 60))))
    found = {body.body: (points, body.radius) for body, points in motion_planning.outlines(rig, Pose(light=np.pi / 2))}
    box = plan_picture._hull(*found["box"], plan_picture.SIDE)
    # turned from z to x: 60 long along x around 500, 20 high around 0
    assert box.min(axis=0) == pytest.approx([470, -10])
    assert box.max(axis=0) == pytest.approx([530, 10])
    assert np.hypot(*(plan_picture._hull(*found["post"], plan_picture.ABOVE) - [500, 0]).T) == pytest.approx(40.0)
