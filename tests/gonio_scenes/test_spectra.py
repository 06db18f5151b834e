"""Spectra of scene files, and pixels whose noise was cut off."""

import numpy as np
import pytest
from gonio_scenes.exposures import _piled
from gonio_scenes.picture import display
from gonio_scenes.render import render
from pydantic import ValidationError

from gonio.colour import SRGB
from gonio.errors import ConfigError
from gonio.spectra import Spectrum
from tests.gonio_scenes.scenes import scene


@pytest.mark.parametrize(("wavelengths", "values"), [((400.0, 500.0), (1.0,)), ((400.0,), (1.0, 2.0)), ((), ())])
def test_wavelengths_and_values_go_together(wavelengths: tuple[float, ...], values: tuple[float, ...]) -> None:
    with pytest.raises(ValidationError, match="they go together, and there must be one at least"):
        Spectrum(wavelength_nm=wavelengths, value=values)


def test_a_scene_of_channels_shows_a_material_of_channels_as_linear_srgb() -> None:
    albedo = {"red": 0.6, "green": 0.3, "blue": 0.1}
    material = {"m": {"model": "lambert", "parameters": {"albedo": albedo}}}
    light = {"kind": "directional", "toward": [0, 0, 1], "irradiance": 1.0, "spectrum": "D65"}
    one = scene(wavelength_nm="rgb", material=material, light=[light], picture={"white": 1.0 / np.pi})
    picture = render(one)
    middle = picture.radiance[20, 24]
    assert list(one.wavelength_nm) == [465.0, 550.0, 610.0]
    # a directional light without losses: sums of a few rounded products
    assert middle / middle[2] == pytest.approx([0.1 / 0.6, 0.3 / 0.6, 1.0], rel=1e-12)
    shown = SRGB.decode(display(one, picture.radiance)[0][20, 24] / 255.0)
    # the picture has 255 steps, of which one is 0.009 at 0.6; the light falls almost along the normal there
    assert shown == pytest.approx([0.6, 0.3, 0.1], abs=0.009)


def test_light_of_another_white_is_refused_in_a_scene_of_channels() -> None:
    light = {"kind": "directional", "toward": [0, 0, 1], "irradiance": 1.0, "spectrum": "A"}
    with pytest.raises(ConfigError, match=r'light\[1\]\.spectrum = "A": in channels of sRGB white is D65'):
        scene(wavelength_nm="rgb", light=[light])


def test_noise_is_cut_off_where_an_end_has_more_pixels_than_the_value_inside_it() -> None:
    assert not _piled(np.repeat([0.0, 1.0], [400, 400]), 0.0, 1.0, 1.0)
    assert not _piled(np.repeat([0.0, 1.0], [430, 370]), 0.0, 1.0, 1.0)  # 60 of sqrt(800) = 28: two sigma
    assert _piled(np.repeat([0.0, 1.0], [500, 300]), 0.0, 1.0, 1.0)
    assert not _piled(np.repeat([0.0, 1.0], [500, 300]), 0.0, 1.0, 0.1)  # hardly any noise: one value holds all
