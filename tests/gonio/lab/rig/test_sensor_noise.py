"""Rounding and noise of pixels against made ones, and what is known of numbers."""

import math

import numpy as np
import pytest

from gonio.lab.rig import light_and_camera
from gonio.lab.rig.light_and_camera import Camera
from gonio.samples.description import ParameterUncertainty

GAMMA = tuple(255.0 * (k / 255.0) ** 2 for k in range(256))
COUNT = 25


@pytest.mark.parametrize(
    ("camera", "charge_e"),
    [
        (Camera(electrons_per_dn=3.0, read_noise_e=6.0, black_level_dn=64.0), 300.0),
        (Camera(electrons_per_dn=3.0, photon_noise=True, black_level_dn=64.0), 900.0),
        (Camera(electrons_per_dn=3.0, dsnu_e=4.0, prnu=0.01, black_level_dn=64.0), 600.0),
        (Camera(electrons_per_dn=30.0, read_noise_e=0.1, black_level_dn=64.0), 300.0),
        (Camera(bits=8, response=GAMMA, electrons_per_dn=30.0, read_noise_e=90.0, black_level_dn=0.0), 3000.0),
    ],
)
def test_rounding_of_a_mean_is_that_of_pixels_that_were_rounded(camera: Camera, charge_e: float) -> None:
    """Means of 25 made pixels whose charge lies anywhere in a step: the rounded ones about those that are not."""
    rng = np.random.default_rng(4)
    shape = 4000, COUNT
    charge = charge_e + rng.uniform(-0.5, 0.5, (shape[0], 1)) * camera.electrons_per_dn * (
        2.0 if camera.response else 1.0
    )
    pixels = charge + camera.read_noise_e * rng.standard_normal(shape) + camera.dsnu_e * rng.standard_normal(shape)
    pixels += camera.prnu * charge_e * rng.standard_normal(shape)
    if camera.photon_noise:
        pixels += math.sqrt(charge_e) * rng.standard_normal(shape)
    linear = pixels / camera.electrons_per_dn + camera.black_level_dn
    if camera.response:
        read = np.rint(np.interp(linear, camera.response, np.arange(256)))
        rounded = np.interp(read, np.arange(256), camera.response)
    else:
        rounded = np.rint(linear)
    off = camera.electrons_per_dn * (rounded - linear).mean(axis=1)
    # 4000 draws of an even distribution: 2 %; a curve's step changes over the pixels' scatter
    assert float(light_and_camera.rounding_of_mean(camera, charge_e, COUNT)) == pytest.approx(np.var(off), rel=0.1)
    noise = (pixels - charge).var(axis=1, ddof=1).mean()
    assert float(light_and_camera.spread(camera, charge_e)) == pytest.approx(noise, rel=0.02)
    steady = camera.read_noise_e**2 + camera.photon_noise * charge_e + camera.electrons_per_dn**2 / 12.0
    assert light_and_camera.deviation_dn(camera, charge_e) == pytest.approx(math.sqrt(steady) / camera.electrons_per_dn)


def test_what_is_known_of_numbers_is_their_covariance_taken_apart() -> None:
    """Numbers without a variance are correlated with none; roundings beyond 1 are none."""
    by = np.array([[2.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    covariance = by @ by.T
    found = ParameterUncertainty.of(["a", "b", "c"], covariance)
    assert found.u == pytest.approx([2.0, math.sqrt(2.0), 0.0])
    assert np.outer(found.u, found.u) * found.correlation == pytest.approx(covariance)
    assert found.correlation[2] == [0.0, 0.0, 1.0]
    assert ParameterUncertainty.of(["a", "b"], np.array([[4.0, 6.0 + 1e-9], [6.0, 9.0]])).correlation[0][1] == 1.0
    with pytest.raises(ValueError, match="no numbers have this correlation"):
        ParameterUncertainty(
            parameters=["a", "b", "c"], u=[1, 1, 1], correlation=[[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]
        )
