"""A map of a plate of two paints whose frames are explicit rays: nothing of the simulated camera is in them."""

import contextlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis.fitting.problem import FitRequest
from gonio_maps.files import MapFile, Tile
from gonio_maps.fits import fits
from gonio_maps.reduction import maps

from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import Acquisition, Geometry, Holder, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Camera, Lamp
from gonio.typing import Floats
from tests.gonio.numpy_rig import SAMPLE, plan_in
from tests.independent_frames import Bench, Plugin, lambert

pytestmark = pytest.mark.slow

PAINTS = ((0.25, 10.0), (0.7, 30.0))
"""Albedo and sigma [deg] on either side."""
NORMAL, EDGE_MM = np.array([np.cos(0.3), np.sin(0.3)]), 0.9
"""The edge: x cos 0.3 + y sin 0.3 = 0.9 mm."""
PLAN = """name = "two paints"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20, 60]
theta_r_deg = [-70, -45, 0, 35, 70]
[[sweep]]
theta_i_deg = [50]
theta_r_deg = [30, 65]
dphi_deg = [70, 140]
"""


def oren_nayar(albedo: float, sigma: float, lamp: Floats, lens: Floats) -> Floats:
    """Oren and Nayar 1994, equations 30 with 27 to 29 of the paper (both bounces), from unit vectors; sigma [rad]."""
    theta = np.arccos(np.clip(np.stack([lamp[..., 2], lens[..., 2]]), -1.0, 1.0))
    alpha, beta = theta.max(axis=0), theta.min(axis=0)
    across = np.hypot(lamp[..., 0], lamp[..., 1]) * np.hypot(lens[..., 0], lens[..., 1])
    dot = (lamp[..., :2] * lens[..., :2]).sum(axis=-1)
    cos_dphi = np.divide(dot, across, out=np.zeros_like(dot), where=across > 0.0)
    s2 = sigma**2
    c1 = 1.0 - 0.5 * s2 / (s2 + 0.33)
    c2 = 0.45 * s2 / (s2 + 0.09) * (np.sin(alpha) - np.where(cos_dphi < 0.0, (2.0 * beta / np.pi) ** 3, 0.0))
    c3 = 0.125 * s2 / (s2 + 0.09) * (4.0 * alpha * beta / np.pi**2) ** 2
    once = c1 + cos_dphi * c2 * np.tan(beta) + (1.0 - np.abs(cos_dphi)) * c3 * np.tan((alpha + beta) / 2.0)
    twice = 0.17 * albedo * s2 / (s2 + 0.13) * (1.0 - cos_dphi * (2.0 * beta / np.pi) ** 2)
    return np.asarray(albedo / np.pi * (once + twice))


def plate(lamp: Floats, lens: Floats, x: Floats, y: Floats) -> Floats:
    """The paint of each spot."""
    first, second = (oren_nayar(albedo, math.radians(sigma), lamp, lens) for albedo, sigma in PAINTS)
    return np.where(beyond_mm(x, y) < 0.0, first, second)


def beyond_mm(x: Floats, y: Floats) -> Floats:
    """How far a spot lies beyond the edge."""
    return np.asarray(NORMAL[0] * x + NORMAL[1] * y - EDGE_MM)


def silent(title: str) -> contextlib.AbstractContextManager[Callable[[int, int], None]]:
    """Counts nothing."""
    return contextlib.nullcontext(lambda done, total: None)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of a run of the plan, through journal, raw files and table."""
    folder = tmp_path_factory.mktemp("rays")
    description = RigDescription.model_validate({
        "rig": "independent",
        "name": "independent bench",
        "geometry": Geometry(light_distance_mm=1000.0, camera_distance_mm=800.0),
        "lamp": Lamp(half_angle_deg=0.5),
        "holder": Holder(axes=("tilt", "spin"), sample_diameter_mm=12.0),
        "camera": Camera(width=72, height=72, pixel_um=20.0, lens_half_angle_deg=0.3, cos4=True, vignetting=0.3,
                         bits=16, electrons_per_dn=0.165, exposure_limits_s=(1e-5, 60.0)),
        "reference": Reference(albedo=0.98, every=0, frames=1),
        "bands": Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
        "acquisition": Acquisition(roi_radius_mm=0.7, frames=1, dark_frames=1),
    })  # fmt: skip
    rig = RigChoice(Plugin(Bench(description, plate, lambert(0.98), splits=3)), description, "independent")
    run = carry_out(plan_in(folder, PLAN), rig, folder / "run", sample=SAMPLE, yes=True)
    maps.write(run, brdf.reduce_in_parts(run), folder / "map.h5", None, silent)
    return folder / "map.h5"


def test_pixels_have_the_brdf_of_their_place_and_the_edge_is_as_wide_as_stated(mapped: Path) -> None:
    with MapFile(mapped) as found:
        x, y = np.meshgrid(found.x_mm, found.y_mm)
        values, _ = found.values(Tile(*(slice(0, count) for count in found.shape)))
        source, camera, footprint, shift = (
            found.array(f"{name}_mm") for name in ("source", "camera", "footprint", "shift")
        )
    spots, beyond = np.stack([x, y, np.zeros(x.shape)], axis=-1), beyond_mm(x, y)
    # the pictures lie where the geometry has them. A pixel is 0.14 mm wide, and three times wider seen from 70 degrees:
    # its stairs look like shifts of up to 0.015 pixels
    assert np.abs(shift).max() < 0.02 * 0.14
    for k in range(len(source)):
        ways = (source[k] - spots, camera[k] - spots)
        lamp, lens = (way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways)
        sides = [oren_nayar(albedo, math.radians(sigma), lamp, lens) for albedo, sigma in PAINTS]
        good, width = np.isfinite(values[..., k]), float(footprint[k] @ NORMAL)
        assert good[np.hypot(x, y) < 5.0].all()  # what a cell sees is at most 1 mm wide, of a disc of 6 mm
        step = (values[..., k] - sides[0]) / (sides[1] - sides[0])
        outside = good & (np.abs(beyond) > 0.5 * width)
        # 95 % of the step within the footprint, half of the rest on either side
        assert np.abs(step - (beyond > 0.0))[outside].max() < 0.025
        # one more pixel's width aside the edge is gone. 16 bits round to 2e-5 of a matte sample, and 0.5 degrees of
        # lamp and 0.3 of lens average the paint's curve to 3e-5
        aside = good & (np.abs(beyond) > 0.75 * width)
        np.testing.assert_allclose(values[aside, k], plate(lamp, lens, x, y)[aside], rtol=1e-4)


def test_fits_of_pixels_find_the_paints(mapped: Path) -> None:
    out = mapped.parent / "fits.h5"
    fits.make(mapped, out, FitRequest("oren-nayar"), count=lambda done, total: None, say=lambda line: None)
    with MapFile(out) as found:
        beyond = beyond_mm(*np.meshgrid(found.x_mm, found.y_mm))
        albedo, sigma_deg = found.array("albedo"), found.array("sigma_deg")
    for side, paint in ((beyond < -0.75, PAINTS[0]), (beyond > 0.75, PAINTS[1])):
        assert np.count_nonzero(side & np.isfinite(albedo)) > 1000
        # values are known to 1e-4; sigma of the smoother paint changes them by 1 % a degree at most
        np.testing.assert_allclose(albedo[side & np.isfinite(albedo)], paint[0], rtol=2e-4)
        np.testing.assert_allclose(sigma_deg[side & np.isfinite(sigma_deg)], paint[1], atol=0.05)
