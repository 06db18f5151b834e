"""Effects of light and lens on a value, by their formulas: bands, polarisation, stray light, hot pixels."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gonio.lab.acquisition.exposure import USABLE
from gonio.lab.reduction import light_and_lens, merging, stray_light
from gonio.lab.reduction.light_and_lens import _curvatures, diattenuation, polarisation_bound
from gonio.lab.reduction.polarised import FACET
from gonio.lab.rig import Pose
from gonio.lab.rig.light_and_camera import Band, Camera
from tests.gonio_sim.conftest import describe


def test_the_curvature_of_a_parabola_is_that_of_its_formula() -> None:
    x = np.array([400.0, 450.0, 470.0, 560.0, 600.0])  # uneven bands
    np.testing.assert_allclose(_curvatures(3.0 * x**2 - 5.0 * x + 2.0, x), 6.0, rtol=1e-9)  # rounding of 1e6
    assert _curvatures(x[:2], x[:2]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("waves", [(450.0, 500.0, 600.0), (600.0, 450.0, 500.0), (450.0, 600.0)])
def test_errors_of_a_band_are_slope_and_curvature_of_the_spectrum(
    monkeypatch: pytest.MonkeyPatch, waves: tuple[float, ...]
) -> None:
    """f = 1e-5 (w - 400)^2: at the middle of three bands slope and curvature are exact; a second point lies at one."""
    u = {f"{w:g}": 0.5 + 0.1 * k for k, w in enumerate(waves)}
    monkeypatch.setattr(light_and_lens, "centre_uncertainties", lambda description: u)
    results: Any = []
    for k, w in enumerate(waves):
        rows = [3, 7] if k == 0 else [3]
        results.append(
            SimpleNamespace(
                band=Band(name=f"{w:g}", centre_nm=w, fwhm_nm=20.0), rows=np.array(rows),
                values=SimpleNamespace(brdf=np.full(len(rows), 1e-5 * (w - 400.0) ** 2), common={}),
            )
        )  # fmt: skip
    light_and_lens.add_wavelength(SimpleNamespace(), results)  # type: ignore[arg-type]
    of = dict(zip(waves, results, strict=True))
    if len(waves) == 3:
        assert of[500.0].values.common["s_wavelength"][0] == pytest.approx(2e-5 * 100.0 * u["500"], rel=1e-12)
        sigma = 20.0 / (2.0 * math.sqrt(2.0 * math.log(2.0)))
        for one in results:  # 0.5 f'' sigma^2; the ends take their neighbour's
            assert one.values.common["s_bandwidth"][0] == pytest.approx(1e-5 * sigma**2, rel=1e-9)
    else:
        slope = 1e-5 * (200.0**2 - 50.0**2) / 150.0
        assert of[600.0].values.common["s_wavelength"][0] == pytest.approx(slope * u["600"], rel=1e-12)
        assert "s_bandwidth" not in of[600.0].values.common
    assert results[0].values.common["s_wavelength"][1] == 0.0  # a point of one band has no slope


def test_a_facet_polarises_as_fresnel_says() -> None:
    assert diattenuation(0.0) == pytest.approx(0.0, abs=1e-15)
    assert diattenuation(math.atan(FACET)) == pytest.approx(1.0)  # Brewster: nothing is reflected along the plane
    for theta in (0.3, 0.8, 1.3):
        c, t = math.cos(theta), math.sqrt(1.0 - (math.sin(theta) / FACET) ** 2)
        s, p = ((c - FACET * t) / (c + FACET * t)) ** 2, ((FACET * c - t) / (FACET * c + t)) ** 2
        assert diattenuation(theta) == pytest.approx((s - p) / (s + p))


@pytest.mark.parametrize(
    ("lamp", "lens", "expected"),
    [
        ((0.1, 0.0), (0.0, None), lambda d: 0.1 * d),
        ((0.1, 90.0), (0.0, None), lambda d: -0.1 * d),
        ((0.1, 30.0), (0.0, None), lambda d: 0.05 * d),
        ((0.1, 0.0), (0.2, 0.0), lambda d: 0.3 * d + 2 * 0.02),
        ((0.1, 90.0), (0.2, 0.0), lambda d: 0.1 * d + 2 * 0.02),
        ((0.2, 90.0), (0.1, 0.0), lambda d: -(0.1 * d + 2 * 0.02)),
        ((0.1, 90.0), (0.2, None), lambda d: -(0.3 * d + 2 * 0.02)),  # one whose azimuth nobody knows adds to it
        ((0.1, None), (0.2, None), lambda d: 0.3 * d + 2 * 0.02),
    ],
)
def test_polarisation_of_lamp_and_camera_in_the_plane_of_the_arms(lamp: Any, lens: Any, expected: Any) -> None:
    """Malus: the part across the plane is the degree times cos 2 azimuth; facets stand at half the angle between."""
    tables = [{"polarisation": {"degree": d} | ({} if a is None else {"azimuth_deg": a})} for d, a in (lamp, lens)]
    description = describe("sim-ideal", lamp=tables[0], camera=tables[1])
    pose = Pose(light=math.radians(-30.0), camera=math.radians(50.0))
    from gonio.lab.rig.kinematics import view

    seen = view(description, pose)
    cosine = seen.source_mm @ seen.camera_mm / np.linalg.norm(seen.source_mm) / np.linalg.norm(seen.camera_mm)
    d = diattenuation(0.5 * math.acos(float(cosine)))
    assert polarisation_bound(description, pose) == pytest.approx(expected(d), rel=1e-9)


@pytest.mark.parametrize("halo", [0.0, 0.02])
def test_light_spread_over_an_even_frame(halo: float) -> None:
    """Of an even scene r a frame reads (1 + s + h) r far from its edges; two terms leave the cube of s + h."""
    camera = Camera(width=240, height=200, stray_light=0.015, stray_halo=halo, stray_halo_px=8.0)
    found = stray_light.spread(camera, np.full((200, 240), 20.0 + (1.015 + halo) * 700.0), 20.0, "mono")
    assert found.uniform == pytest.approx(700.0, rel=2e-3 if halo else 1e-12)  # the halo leaves the frame at its rim
    added, by = found.at(np.array([100, 90]), np.array([120, 131]))
    np.testing.assert_allclose(added, (0.015 + halo) * 700.0, rtol=2e-3)  # as above
    np.testing.assert_allclose(by, [[700.0, 700.0], [700.0 if halo else 0.0] * 2], rtol=2e-3)


def test_a_halo_has_the_width_that_the_rig_file_says() -> None:
    """A bright square of 8 pixels; beside it the halo falls as a Gaussian, but for bins of a quarter of its width."""
    camera = Camera(width=320, height=320, stray_light=0.0, stray_halo=0.02, stray_halo_px=16.0)
    frame = np.zeros((320, 320))
    frame[156:164, 156:164] = 1000.0
    at = np.array([159.5, 167.5, 175.5, 191.5])
    _, by = stray_light.spread(camera, frame, 0.0, "mono").at(np.full(4, 159.5), at)
    # a square for a point, 1 %; bins that are interpolated, 2 %
    np.testing.assert_allclose(by[1], 64_000.0 / (2 * np.pi * 256.0) * np.exp(-((at - 159.5) ** 2) / 512.0), rtol=0.06)


def test_colours_of_a_mosaic_are_pictures_of_their_own() -> None:
    camera = Camera(pattern="RGGB")
    mosaic = np.arange(16.0).reshape(4, 4)
    assert stray_light.planes(camera, mosaic, "R").tolist() == [[0, 2], [8, 10]]
    assert stray_light.planes(camera, mosaic, "G").tolist() == [[2.5, 4.5], [10.5, 12.5]]  # the mean of two
    assert stray_light.planes(camera, mosaic, "B").mean() == 10.0
    assert (stray_light.pitch(camera, "B"), stray_light.pitch(camera, "mono")) == (2, 1)


def test_a_hot_pixel_is_one_by_its_part_of_the_longest_frame_or_by_a_full_dark_frame() -> None:
    from gonio.lab.reduction.merging import HOT

    full = 10_000.0
    for longest_s, dark_s, limit in ((2.0, 1e-3, HOT * full / 2.0), (1e-3, 4.0, USABLE * full / 4.0)):
        rate = 5.0 + np.array([0.0, 0.0, 0.0, 0.99 * limit, 1.01 * limit])
        assert merging._hot(rate, longest_s, dark_s, full).tolist() == [False] * 4 + [True]
