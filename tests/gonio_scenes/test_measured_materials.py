"""Materials of scenes by the name of a file: sample files, and measured tables with what of them is extrapolated."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_scenes import mitsuba
from gonio_scenes.commands import render as command

from gonio import config, measurement
from gonio.errors import GonioError
from gonio.formats.reader import table
from gonio.formats.rgl import RglMeasured
from gonio.geometry import SAME_ANGLE, angles, direction
from gonio.models import CookTorrance, Lambert, Model
from tests.gonio_scenes.scenes import SPHERE, rendered, scene, tables

GLOSSY = CookTorrance(0.5, 0.5, 0.2, 1.5, diffuse_albedo=0.3, convention="normalised")
FAR = SPHERE["camera"] | {"position_mm": [0.0, 0.0, 1e6], "vertical_field_deg": 0.0048, "width": 120, "height": 120}
"""A sphere of 40 mm from so far that all rays are parallel; it fills the picture but for two pixels."""
BEHIND = [{"kind": "directional", "toward": [0.0, 0.0, 1.0], "irradiance": 3.0}]

BEYOND = math.cos(math.radians(70.0) + SAME_ANGLE) ** 3
"""The share of light from beyond 70 degrees: a Lambertian sphere sends cos(theta) from a ring of 2 sin cos."""


def sampled(model: Model, wavelength_nm: float | None = 550.0, *, dphi_deg: tuple[float, ...] = ()) -> pd.DataFrame:
    """A model measured to 80 degrees in steps of 5, at incidences from 0 to 70, in plane and at azimuths out of it."""
    signed, incidences = np.arange(-80.0, 80.1, 5.0), np.arange(0.0, 71.0, 10.0)
    parts = [(t, abs(s), 180.0 if s >= 0 else 0.0) for t in incidences for s in signed]
    parts += [(t, s, d) for t in incidences for s in signed if s > 0 for d in dphi_deg]
    theta_i, theta_r, phi_r = np.array(parts).T
    brdf = model.brdf(*np.deg2rad([theta_i, 0 * theta_i, theta_r, phi_r]))
    return table(
        theta_i_deg=theta_i, phi_i_deg=0.0, theta_r_deg=theta_r, phi_r_deg=phi_r, brdf=brdf,
        wavelength_nm=math.nan if wavelength_nm is None else wavelength_nm, attrs={"sample": "s"},
    )  # fmt: skip


def material(folder: Path, frame: pd.DataFrame) -> dict[str, Any]:
    measurement.write(frame, folder / "brdf.csv")
    return {"m": {"file": "brdf.csv"}}


def test_a_sphere_of_a_table_is_one_of_the_model_that_it_was_sampled_from(tmp_path: Path) -> None:
    frame = sampled(GLOSSY, dphi_deg=tuple(np.arange(15.0, 180.0, 15.0)))
    made = rendered(tmp_path, material=material(tmp_path, frame))
    right = rendered(material={"m": {"model": "cook-torrance", "parameters": GLOSSY.parameters}})
    toward = np.array(SPHERE["light"][0]["toward"])
    incidence = np.degrees(np.arccos(np.clip(right.normal @ toward / np.linalg.norm(toward), -1.0, 1.0)))
    within = (right.shape >= 0) & (incidence < 70.0) & (right.normal[..., 2] > math.cos(math.radians(70.0)))
    ratio = made.radiance[within] / right.radiance[within]
    assert within.sum() > 400
    # steps of 5 degrees against a lobe of 11 degrees' slope; far off the mirror direction those of 15 in azimuth matter
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)
    # outside lie a limb beyond 70 degrees of incidence and 80 of view, and what no triangle reaches there
    assert made.extrapolated["m"] is not None
    assert made.extrapolated["m"] < 0.1


def test_the_share_of_light_that_is_extrapolated_is_that_of_the_limb(tmp_path: Path) -> None:
    """Light from behind the camera comes back where it came from: all in the plane of incidence."""
    made = rendered(tmp_path, camera=FAR, light=BEHIND, material=material(tmp_path, sampled(Lambert(0.4))))
    assert made.extrapolated["m"] == pytest.approx(BEYOND, rel=0.05)  # the ring is four pixels wide
    np.testing.assert_allclose(
        made.radiance[..., 0], np.where(made.shape >= 0, 3.0 * 0.4 / math.pi * made.normal[..., 2], 0.0), atol=1e-9
    )
    dark = rendered(
        tmp_path, camera=FAR, light=[{"kind": "ambient", "radiance": 1.0}], material={"m": {"file": "brdf.csv"}}
    )
    assert dark.extrapolated == {"m": None}
    np.testing.assert_allclose(dark.radiance[dark.shape >= 0], 0.4, rtol=2e-3)  # rho_hd, by its quadrature


def test_wavelengths_of_a_table_are_joined_by_straight_lines(tmp_path: Path) -> None:
    frame = pd.concat([sampled(Lambert(0.2), 500.0), sampled(Lambert(0.4), 600.0)], ignore_index=True)
    frame.attrs = sampled(Lambert(0.2)).attrs
    made = rendered(tmp_path, wavelength_nm=[500.0, 525.0, 600.0], camera=FAR, light=BEHIND,
                    material=material(tmp_path, frame))  # fmt: skip
    np.testing.assert_allclose(made.radiance[60, 60], 3.0 / math.pi * np.array([0.2, 0.25, 0.4]), rtol=1e-3)
    # a band of no wavelength holds at all of them
    made = rendered(tmp_path, wavelength_nm=[300.0, 900.0], camera=FAR, light=BEHIND,
                    material=material(tmp_path, sampled(Lambert(0.3), None)))  # fmt: skip
    np.testing.assert_allclose(made.radiance[60, 60], 3.0 / math.pi * 0.3, rtol=1e-3)


def test_a_sample_file_is_what_it_says(tmp_path: Path) -> None:
    given = {"model": "oren-nayar", "parameters": {"albedo": 0.6, "sigma_deg": 25.0}}
    (tmp_path / "fitted.toml").write_text(config.to_toml({"name": "plaster", **given}), encoding="utf-8")
    made = rendered(tmp_path, material={"m": {"file": "fitted.toml"}})
    np.testing.assert_array_equal(made.radiance, rendered(material={"m": given}).radiance)
    assert made.extrapolated == {}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"material": {"m": {"file": "gold.toml"}}}, 'material.m.file = "gold.toml": there is no such file or run'),
        ({"material": {"m": {"file": "brdf.csv"}}, "wavelength_nm": [450.0]}, "measured at 550 nm alone, not at 450"),
        ({"material": {"m": {"file": "plate.toml"}}}, 'm.file = "plate.toml": .*texture.albedo.*leave the texture out'),
        ({"material": {"m": {"file": "brdf.csv", "model": "lambert"}}}, "either model and parameters, or file"),
        ({"material": {"m": {}}}, "either model and parameters, or file"),
        ({"material": {"m": {"file": "brdf.csv", "textures": {"m": {"pattern": "dots"}}}}}, "has no parameters"),
    ],
)  # fmt: skip
def test_what_a_file_cannot_be(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    measurement.write(sampled(Lambert(0.4)), tmp_path / "brdf.csv")
    (tmp_path / "plate.toml").write_text(
        'name = "p"\nmodel = "lambert"\nparameters = { albedo = 0.2 }\n'
        'texture.albedo = { pattern = "edge", low = 0.2, high = 0.4 }\n',
        encoding="utf-8",
    )
    with pytest.raises(GonioError, match=said) as error:
        rendered(tmp_path, **changes)
    assert "scene.toml: material.m" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_picture_says_what_of_it_was_not_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    described = tables(camera=FAR, light=BEHIND, material=material(tmp_path, sampled(Lambert(0.4))))
    (tmp_path / "scene.toml").write_text(config.to_toml(described), encoding="utf-8")
    command(tmp_path / "scene.toml", tmp_path / "out")
    assert "material.m: a measured table, 4% of its light is extrapolated" in capsys.readouterr().err
    told = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["tables"]["m"]
    assert told["extrapolated_share"] == pytest.approx(BEYOND, rel=0.05)
    assert any("in the plane of incidence alone" in remark for remark in told["remarks"])


def test_a_table_goes_to_mitsuba_as_slices_with_what_is_said_of_it(tmp_path: Path) -> None:
    made = mitsuba.export(scene(tmp_path, material=material(tmp_path, sampled(GLOSSY))), nodes=48, incidences=24)
    read = RglMeasured(made.files["m.bsdf"], Path("m.bsdf"))
    value, _ = read.brdf(
        *angles(direction(np.array([0.5]), np.zeros(1))), *angles(direction(np.array([0.2]), np.full(1, math.pi)))
    )
    np.testing.assert_allclose(value[0], GLOSSY.brdf(0.2, 0.0, 0.5, math.pi), rtol=0.02)  # straight between the nodes
    assert any(left["what"] == "material.m: what was not measured" for left in made.left_out)
