"""What a plan will have for uncertainty, against formulas on paper; and which calibration is worth its evening."""

import math
from pathlib import Path

import numpy as np
import pytest

from gonio.lab.acquisition.measure import find_rig
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.calibration.expected_budget import CAREFUL, advice, expected, total, what_stays_open
from gonio.lab.calibration.geometry_problem import unknowns
from gonio.lab.rig import Pose
from gonio.lab.rig.description import RigDescription
from tests.command_line import gonio, says

POSES = [Pose(light=math.radians(a), camera=math.radians(-45.0)) for a in (0.0, 60.0)]


def of(rig: RigDescription) -> dict[str, tuple[np.ndarray, str]]:
    causes = expected(rig, POSES, reference_pose(rig), rig.bands.all()[0], 600.0)
    out = {cause.cause: (cause.u_rel, advice(cause, causes)) for cause in causes}
    return out | {"all": (total(causes), "")}


def test_causes_are_those_of_the_formulas() -> None:
    found = of(find_rig("lab").description)
    tan = math.tan(math.radians(60.0))
    # the white is looked at along its normal, where a cosine does not change with an error
    assert found["zeros of the axes"][0] == pytest.approx([0.0, tan * math.radians(0.02)], abs=1e-9, rel=1e-4)
    step = math.radians(0.088) / math.sqrt(12.0)
    assert found["encoder steps"][0] == pytest.approx([0.0, tan * step], abs=1e-9, rel=1e-4)
    # two frames and a shorter one of 0.8 % of the lamp's noise against sixteen and one; photons add less than a tenth
    lamp = 0.008 * math.sqrt(1 / 3 + 1 / 17)
    assert found["noise of camera and lamp"][0] == pytest.approx([lamp, lamp], rel=0.1)
    parts = [found[name][0] for name in ("white's certificate", "noise of camera and lamp", "encoder steps")]
    held = np.sqrt(np.sum(np.square([*parts, found["zeros of the axes"][0]]), axis=0))
    assert found["all"][0] == pytest.approx(held, rel=1e-12)
    assert found["zeros of the axes"][1].startswith("nothing to do")
    assert found["geometry"][1].startswith("gonio calibrate geometry: mostly ")


def test_open_numbers_are_sorted_by_what_they_do() -> None:
    rig = find_rig("lab").description
    leaning = [u for u in unknowns(rig, []) if u.words == "tilt of the surface against the spin axis about y"]
    distances = [u for u in unknowns(rig, []) if u.path.startswith("geometry.")]
    felt, rest = what_stays_open(rig, [*distances, *leaning])
    # the light falls on a plane that leans by a quarter of the degree that is expected
    lean = 100.0 * math.tan(math.radians(60.0)) * math.radians(CAREFUL * leaning[0].within)
    assert felt.endswith(f"tilt of the surface against the spin axis about y {lean:.2g} %")
    says(rest, "open, and nothing to do: distance of the lamp, distance of the camera; together 0.00 %")
    assert what_stays_open(rig, []) == []


def test_a_webcam_waits_for_its_response_and_a_plan_says_so(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text('name = "p"\nwavelength_nm = [530]\n[[sweep]]\ntheta_i_deg = [10, 60]\n'
                                     "theta_r_deg = [30, 45]\n")  # fmt: skip
    shown = gonio(tmp_path, "plan", "show", "p.toml", "--rig", "three-servos").stdout
    says(" ".join(shown.split()), "what to expect of a matt sample", "camera - - gonio calibrate camera --response")
    says(" ".join(shown.split()), "zeros of the axes 0.31 3 gonio rig align: light, camera, tilt by eye, 1 deg")
