"""The reduction, and the geometry that it shares with the simulated camera, against frames that share none of it."""

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pytest

from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.reduction.brdf import reduce
from gonio.lab.rig import Pose, imaging, inverse_kinematics, kinematics
from gonio.lab.rig.description import Acquisition, ArmAxis, Arms, Geometry, Holder, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands, Camera, Lamp
from tests.gonio.numpy_rig import SAMPLE, plan_in
from tests.independent_frames import Bench, Brdf, Placed, Plugin, brushed, lambert, lobe

PLAN = """name = "in plane and out of it"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [10, 45]
theta_r_deg = [-70, -20, 0, 25, 45, 70]
[[sweep]]
theta_i_deg = [30, 60]
theta_r_deg = [20, 50]
dphi_deg = [60, 150, 250]
[[sweep]]
theta_i_deg = [0]
theta_r_deg = [30]
dphi_deg = [120]
"""
HOLDER: dict[str, Any] = {"holder": Holder(axes=("tilt", "spin"), sample_diameter_mm=20.0), "arms": Arms()}
AZIMUTH: dict[str, Any] = {
    "holder": Holder(axes=("spin",), sample_diameter_mm=20.0),
    "arms": Arms(azimuth=ArmAxis(limits_deg=(-180.0, 180.0))),
}
RIGS = {"tilt and spin": HOLDER, "azimuth arm": AZIMUTH}

AGREEMENT = 3e-4
"""Largest relative difference; there is no noise. A matte sample agrees within the rounding of 16-bit levels (3e-6).
Beside a lobe the mean over the patch is not the value at its centre: a patch of 2 mm turns the mirror direction by up
to 4.5e-3 rad, which is 1.3e-2 of the lobe's width of 0.35. Its square, 1.7e-4, is what the reduction does not correct;
at one point it takes a part of the lobe for a spike, within its stated uncertainty."""


def describe(**tables: object) -> RigDescription:
    """A noiseless rig of finite distances and cones, with a falling-off lens and few, big pixels."""
    return RigDescription.model_validate(
        {
            "rig": "independent",
            "name": "independent bench",
            "geometry": Geometry(light_distance_mm=1000.0, camera_distance_mm=800.0),
            "lamp": Lamp(half_angle_deg=0.5),
            "camera": Camera(
                width=48, height=36, pixel_um=40.0, lens_half_angle_deg=0.5, cos4=True, vignetting=0.3, bits=16,
                electrons_per_dn=0.165, exposure_limits_s=(1e-5, 60.0),
            ),
            "reference": Reference(albedo=0.98, every=0, frames=1),
            "bands": Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
            "acquisition": Acquisition(roi_radius_mm=2.0, frames=1, dark_frames=1),
        }
        | tables
    )  # fmt: skip


def measured(tmp_path: Path, bench: Bench, plan: str = PLAN) -> pd.DataFrame:
    """The table of a plan that the bench has measured: through journal, raw files and reduction, as a user would."""
    rig = RigChoice(Plugin(bench), bench.description, "independent")
    table = reduce(carry_out(plan_in(tmp_path, plan), rig, tmp_path / "run", sample=SAMPLE, yes=True))
    assert (table["flag"] == "").all()
    return table


def goals(bench: Bench, table: pd.DataFrame) -> list[Pose]:
    """The poses that the rig went to, point by point."""
    from gonio.geometry import Directions

    return [inverse_kinematics.reach(bench.description, d) for d in Directions.from_table(table)]


SURFACES: dict[str, Brdf] = {
    "matte": lambert(0.5),
    "lobe": lobe(0.2, 0.8, 0.35),
    "brushed": brushed(0.7, 0.5, 0.9),
}


@pytest.mark.parametrize("kind", RIGS)
@pytest.mark.parametrize("surface", SURFACES)
def test_frames_by_rays_are_reduced_to_the_brdf_that_made_them(kind: str, surface: str, tmp_path: Path) -> None:
    bench = Bench(describe(**RIGS[kind]), SURFACES[surface], lambert(0.98))
    table = measured(tmp_path, bench)
    poses = goals(bench, table)
    angles = [Placed.at(pose).angles_deg for pose in poses]
    wanted = np.column_stack(
        [table["theta_i_deg"], table["theta_r_deg"], (table["phi_r_deg"] - table["phi_i_deg"]) % 360.0]
    )
    apart = np.abs(np.array(angles) - wanted)
    apart[:, 2] = np.minimum(apart[:, 2], 360.0 - apart[:, 2]) * np.sin(np.radians(wanted[:, :2])).prod(axis=1)
    assert apart.max() < 1e-9
    truth = np.array([bench.averaged(pose) for pose in poses])
    np.testing.assert_allclose(table["brdf"].to_numpy() / truth, 1.0, atol=AGREEMENT)


@pytest.mark.parametrize("radiation", ["isotropic", "lambertian"])
@pytest.mark.parametrize("kind", RIGS)
def test_a_reference_beside_the_sample_is_looked_for_where_rays_show_it(
    kind: str, radiation: Literal["isotropic", "lambertian"], tmp_path: Path
) -> None:
    """It lies off both axes of the image: an image that is mirrored, turned or swapped shows black there.

    A lamp at 0.3 m lights it differently, by the distance law and by the lamp's own cosine.
    """
    geometry = Geometry(light_distance_mm=300.0, camera_distance_mm=800.0)
    beside = Reference(how="beside", albedo=0.98, every=0, frames=1, offset_mm=(3.5, -2.0), diameter_mm=3.5,
                       theta_i_deg=20.0, theta_r_deg=30.0)  # fmt: skip
    lamp = Lamp(half_angle_deg=0.5, radiation=radiation)
    rig = RIGS[kind] | {"holder": RIGS[kind]["holder"].model_copy(update={"sample_diameter_mm": 4.0})}
    description = describe(geometry=geometry, reference=beside, lamp=lamp, **rig)
    acquisition = Acquisition(roi_radius_mm=1.2, frames=1, dark_frames=1)
    bench = Bench(description.model_copy(update={"acquisition": acquisition}), lambert(0.5), lambert(0.98))
    table = measured(tmp_path, bench, PLAN.split("[[sweep]]")[0] + "[[sweep]]\ntheta_i_deg=[30]\ntheta_r_deg=[20]\n")
    np.testing.assert_allclose(table["brdf"], 0.5 / math.pi, rtol=AGREEMENT)


@pytest.mark.parametrize(
    "pose", [Pose(0.3, 0.8, 0.4, 0.9), Pose(0.3, 0.8, 0.0, -0.7, 1.1), Pose(-0.5, -0.6, -0.7, 2.5)]
)
def test_a_mark_beside_the_centre_lies_on_the_pixels_that_see_it(pose: Pose) -> None:
    """A small bright disc at x = 3 mm, y = -1.5 mm of the sample."""
    mark = (3.0, -1.5)

    def marked(to_lamp: np.ndarray, to_lens: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(np.hypot(x - mark[0], y - mark[1]) < 1.0, 1.0, 0.0)

    description = describe()
    picture = Bench(description, marked, lambert(0.98), splits=4, pose=pose).rates()
    seen = imaging.pixel_map(description, kinematics.view(description, pose))
    share = picture / seen.weight
    found = [float(np.sum(share * where) / np.sum(share)) for where in (seen.x_mm, seen.y_mm)]
    # edges cut pixels of 0.29 mm into 4 x 4 squares: their mean is known to a few hundredths of a pixel
    np.testing.assert_allclose(found, mark, atol=0.02)
