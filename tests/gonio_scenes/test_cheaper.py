"""Pictures by cheaper forms, against the same pictures as written, pixel by pixel."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gonio_scenes.cheaper import WRITTEN, Taken, render_to_error
from gonio_scenes.render import render

from gonio.errors import ConfigError
from gonio.typing import Floats
from tests.gonio_scenes.scenes import scene, tables

FLOOR = {"kind": "plane", "center_mm": [0.0, 0.0, -40.0], "material": "floor"}
SUNS = [
    {"kind": "directional", "toward": [1.0, 0.5, 2.0], "irradiance": 3.0},
    {"kind": "directional", "toward": [0.6, 0.9, 1.0], "irradiance": 2.0},
]
EXACT = {"model": "oren-nayar", "parameters": {"albedo": 0.8, "sigma_deg": 30.0, "form": "exact"}}
MATT = {"model": "lambert", "parameters": {"albedo": 0.5}}
ALUMINIUM = {"model": "he-torrance", "parameters": {"sigma0_um": 0.28, "tau_um": 1.77, "ior": "Al"}}


def both(error: float, samples: int = 1, **changes: Any) -> tuple[Floats, list[Taken], Floats]:
    """Relative differences to the picture as written, what was taken, and that picture."""
    camera = tables()["camera"] | {"width": 96, "height": 84, "samples": samples}
    described = scene(camera=camera, **changes)
    written = render(described).radiance
    made, taken = render_to_error(described, error)
    assert made.scene is described
    off = np.zeros_like(written)
    np.divide(made.radiance - written, written, out=off, where=made.radiance != written)
    return np.abs(off), taken, written


@pytest.mark.parametrize("samples", [1, 4])
def test_no_pixel_is_off_by_more_and_evaluations_are_saved(samples: int) -> None:
    shapes = [*tables()["shape"], FLOOR]
    off, taken, written = both(0.01, samples, shape=shapes, light=SUNS, material={"m": EXACT, "floor": MATT})
    assert 0.0 < off.max() <= 0.01
    floor, matt = sorted(taken, key=lambda t: t.material)
    assert floor.form == WRITTEN
    assert matt.form in ("functional", "qualitative")
    assert matt.worst <= 0.01
    assert matt.mean <= 0.01
    # the exact integral is dozens of times dearer than the fit to it: what is checked is most of what is spent
    assert matt.cost < 0.3
    assert matt.as_written < 0.5
    assert matt.as_written <= matt.evaluated < 1.0
    assert matt.spent == matt.cost + matt.evaluated
    assert written.min() >= 0.0


def test_tiers_of_a_series_hold_by_their_own_bound() -> None:
    off, (taken,), _ = both(0.001, material={"m": ALUMINIUM}, wavelength_nm=[450.0, 650.0])
    assert taken.form == "tolerance 1e-06"
    assert taken.evaluated < 0.05  # the grid alone
    assert off.max() < 1e-5


def test_what_has_no_cheaper_form_stays_as_it_is() -> None:
    off, (taken,), _ = both(0.01)
    assert (taken.form, taken.spent) == (WRITTEN, 1.0)
    assert off.max() == 0.0


def test_a_form_that_fails_nearly_everywhere_is_not_taken() -> None:
    _, (taken,), _ = both(1e-5, material={"m": EXACT})
    assert taken.form == WRITTEN


def test_a_tolerance_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"tolerance = 0.05: with --error both forms"):
        render_to_error(replace(scene(), tolerance=0.05), 0.01)
