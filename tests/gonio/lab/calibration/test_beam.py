"""The beam's profile from flats: told from the lens by several camera angles, and refused from one."""

import math

import numpy as np
import pandas as pd
import pytest

from gonio.errors import DataError
from gonio.lab.calibration import beam
from gonio.lab.rig import Pose, imaging, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Beam
from tests.gonio.lab.reduction.made_run import describe

TRUE = (0.002, -0.001, -2e-4, 3e-5, -1.5e-4)
NOISE, PIXELS = 0.002, 0.004


def rig() -> RigDescription:
    return describe(
        camera={"width": 96, "height": 80, "pixel_um": 25.0, "prnu": PIXELS}, reference={"diameter_mm": 24.0}
    )


def flats(angles: list[float], seed: int = 0) -> pd.DataFrame:
    """Frames written out here: a beam, a lens that takes light at the corners, pixels and frames with noise."""
    description, rng, tables = rig(), np.random.default_rng(seed), []
    camera = description.camera
    responsivity = 1.0 + PIXELS * rng.standard_normal((camera.height, camera.width))
    rows, cols = np.indices((camera.height, camera.width))
    r = np.hypot(rows - 0.5 * (camera.height - 1), cols - 0.5 * (camera.width - 1))
    lens = np.exp(-0.05 * (r / r.max()) ** 2 + 0.02 * (r / r.max()) ** 4)
    for number, angle in enumerate(angles):
        pose = Pose(light=0.0, camera=math.radians(angle))
        seen = imaging.pixel_map(description, kinematics.view(description, pose))
        # the light stands in the normal: the plane that faces it is the sample's; rays spread by less than 2e-4
        x, y = seen.x_mm, seen.y_mm
        profile = np.exp(sum(k * m for k, m in zip(TRUE, (x, y, x * x, x * y, y * y), strict=True)))
        lamp = 1.0 + 0.05 * rng.standard_normal()  # any level for each flat
        mean = 1e4 * lamp * seen.weight * profile * lens * responsivity
        mean = mean * (1.0 + NOISE * rng.standard_normal(mean.shape))
        tables.append(beam.blocks(description, pose, mean, NOISE * mean, number))
    return pd.concat(tables, ignore_index=True)


def test_a_beam_is_told_from_the_lens_with_honest_uncertainties() -> None:
    """Five benches: pulls of five numbers have a spread of 1 +- 0.14, and the lens is found too."""
    pulls = []
    for seed in range(5):
        found = beam.fit(flats([-60.0, -45.0, -30.0, -12.0, 12.0, 30.0, 45.0, 60.0], seed))
        pulls.append((np.array(found.beam.terms()) - TRUE) / np.sqrt(np.diag(found.covariance)))
        assert found.reduced_chi_square < 1.3
        assert found.lens[0] + found.lens[1] == pytest.approx(-0.03, abs=0.03)
    assert 0.6 < float(np.std(pulls)) < 1.45  # three standard deviations
    assert abs(float(np.mean(pulls))) < 0.6


def test_flats_at_one_angle_do_not_tell_the_beam_from_the_lens() -> None:
    with pytest.raises(DataError, match=r"taken at 1 angle\(s\) of the camera"):
        beam.fit(flats([20.0, 20.0, 20.0, 20.0]))


def test_a_white_that_is_not_in_the_frame_is_told() -> None:
    with pytest.raises(DataError, match="too few to tell a beam from a lens; is the white"):
        beam.fit(flats([-45.0, 12.0, 45.0])[:8])


def test_a_beam_is_no_brighter_than_e_times_its_centre() -> None:
    """What grows without end far outside of where it was measured would be nonsense in the frame's corners."""
    description = rig()
    lamp = description.lamp.model_copy(update={"beam": Beam(xx_per_mm2=1.0)})
    seen = imaging.pixel_map(
        description.model_copy(update={"lamp": lamp}), kinematics.view(description, Pose(camera=math.radians(30)))
    )
    assert seen.radiation.max() == pytest.approx(math.e)
