"""Vignetting from flats of two directions, made by its formula on the pixels and a beam of known powers."""

import math

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.lab.calibration.beam import fit_vignetting
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.description import Reference, RigDescription
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats
from tests.gonio.numpy_rig import describe

WIDTH, HEIGHT = 64, 48
RIG = describe(
    camera=Camera(width=WIDTH, height=HEIGHT, pixel_um=100.0, vignetting=0.1), reference=Reference(diameter_mm=80.0)
)


def flat(
    rig: RigDescription, camera_deg: float, vignetting: float, level: float, noise: float = 0.0, seed: int = 0
) -> tuple[Floats, Pose]:
    """Level x beam x (1 - v rho^4); rho is 1 in the corner. The beam is a quartic on the sample."""
    pose = Pose(light=math.radians(20.0), camera=math.radians(camera_deg))
    bare = rig.model_copy(update={"camera": rig.camera.model_copy(update={"vignetting": 0.0})})
    seen = pixel_map(bare, kinematics.view(bare, pose))
    x, y = rig.reference.offset_mm if rig.reference.how == "beside" else (0.0, 0.0)
    u, v = (seen.x_mm - x) / 40.0, (seen.y_mm - y) / 40.0
    beam = np.exp(0.3 * u - 0.2 * v + 0.1 * u * v - 0.4 * u**2 - 0.3 * v**2 + 0.2 * u**2 * v**2 - 0.1 * u**4)
    i, j = np.mgrid[:HEIGHT, :WIDTH]
    squared = ((i - 23.5) ** 2 + (j - 31.5) ** 2) / (24.0**2 + 32.0**2)
    signal = level * seen.weight * beam * (1.0 - vignetting * squared**2)
    return signal * (1.0 + noise * np.random.default_rng(seed).standard_normal(signal.shape)), pose


@pytest.mark.parametrize("vignetting", [0.0, 0.3, 0.6, -0.1])
def test_vignetting_is_told_from_a_beam(vignetting: float) -> None:
    found = fit_vignetting([flat(RIG, 0.0, vignetting, 1000.0), flat(RIG, -40.0, vignetting, 700.0)], RIG)
    # four rounds of Newton's iteration from 0: each squares what is left
    assert found.value == pytest.approx(vignetting, abs=1e-5)
    assert found.residual < 1e-3


def test_the_residual_is_the_noise_and_the_uncertainty_its_share() -> None:
    """As many pixels are independent as one picture has: the same pictures twice say no more."""
    two = [flat(RIG, angle, 0.3, 1000.0, noise=0.01, seed=k) for k, angle in enumerate((0.0, -40.0))]
    once, twice = fit_vignetting(two, RIG), fit_vignetting([*two, *two], RIG)
    assert once.residual == pytest.approx(0.01, rel=0.05)  # of some thousand pixels
    assert twice.value == pytest.approx(once.value, rel=1e-9)
    assert twice.u == pytest.approx(once.u, rel=0.01)
    assert abs(once.value - 0.3) < 4.0 * once.u
    louder = fit_vignetting(
        [flat(RIG, angle, 0.3, 1000.0, noise=0.02, seed=k) for k, angle in enumerate((0.0, -40.0))], RIG
    )
    assert louder.u == pytest.approx(2.0 * once.u, rel=0.1)


def test_the_uncertainty_is_the_scatter_of_the_value_of_single_pictures_pixels() -> None:
    found = [
        fit_vignetting([flat(RIG, a, 0.3, 1000.0, noise=0.01, seed=2 * n + k) for k, a in enumerate((0.0, -40.0))], RIG)
        for n in range(20)
    ]
    scatter = float(np.std([one.value for one in found], ddof=1))
    # noise is independent in both pictures here, so that the stated one is larger by the root of two
    assert found[0].u / scatter == pytest.approx(math.sqrt(2.0), rel=4.0 / math.sqrt(2 * 19))


def test_a_reference_beside_the_sample_is_looked_for_there() -> None:
    beside = RIG.model_copy(update={"reference": Reference(how="beside", offset_mm=(12.0, -8.0), diameter_mm=80.0)})
    found = fit_vignetting([flat(beside, 0.0, 0.3, 1000.0), flat(beside, -40.0, 0.3, 700.0)], beside)
    assert found.value == pytest.approx(0.3, abs=1e-6)


def test_dark_and_defective_pixels_are_left_out() -> None:
    pictures = [flat(RIG, 0.0, 0.3, 1000.0), flat(RIG, -40.0, 0.3, 700.0)]
    for signal, _ in pictures:
        signal[10:13, 20:23] *= 0.1  # a shadow: less than a fifth of the median
        signal[30, 30] = math.nan
    assert fit_vignetting(pictures, RIG).value == pytest.approx(0.3, abs=1e-6)


def test_one_direction_and_a_reference_out_of_view_are_refused() -> None:
    fit_vignetting([flat(RIG, 0.0, 0.3, 1.0), flat(RIG, -10.1, 0.3, 1.0)], RIG)
    with pytest.raises(DataError, match="seen from one direction"):
        fit_vignetting([flat(RIG, 0.0, 0.3, 1.0), flat(RIG, -9.8, 0.3, 1.0)], RIG)
    away = RIG.model_copy(update={"reference": Reference(how="beside", offset_mm=(500.0, 0.0), diameter_mm=20.0)})
    with pytest.raises(DataError, match="do not hold the white reference"):
        fit_vignetting([flat(away, 0.0, 0.3, 1.0), flat(away, -40.0, 0.3, 1.0)], away)
