"""Rigs with errors of alignment and of encoders: against a plain implementation, and there and back."""

import math
from typing import Any

import cv2
import numpy as np
import pytest

from gonio.errors import ArgumentError, ConfigError
from gonio.geometry import Directions
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.calibration_files import covariance_of
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_map, place, spot
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.lab.rig.kinematics import directions, read_pose, separation, true_pose, view
from gonio.lab.rig.regions import outline
from tests.gonio.lab.rig import plain_rig
from tests.gonio.numpy_rig import describe

KINDS = ("tilt", "azimuth")


def rig(rng: np.random.Generator, kind: str, size: float = 1.0, **camera: Any) -> RigDescription:
    """A rig with every error at once, of up to `size` times 2 deg and 5 mm."""

    def two(most: float) -> list[float]:
        return [float(v) for v in rng.uniform(-most * size, most * size, 2)]

    def arm(**more: Any) -> dict[str, Any]:
        harmonics = [[1, *two(0.5)], [2, *two(0.2)], [7, *two(0.05)]] if size else []
        return {"limits_deg": [-175.0, 175.0], "harmonics_deg": harmonics, "axis_tilt_deg": two(2.0),
                "axis_offset_mm": two(5.0), **more}  # fmt: skip

    arms = {"light": arm(elevation_deg=two(2.0)[0]), "camera": arm(elevation_deg=two(2.0)[0])}
    holder: dict[str, Any] = {
        "axes": ["tilt", "spin"], "tilt_limits_deg": [-90.0, 90.0], "spin_limits_deg": [-400.0, 400.0],
        "surface_offset_mm": two(3.0)[0], "surface_tilt_deg": two(2.0), "sample_offset_mm": two(2.0),
        "spin_axis_tilt_deg": two(1.0)[0], "tilt_axis_offset_mm": two(2.0)[0],
    }  # fmt: skip
    if kind == "azimuth":
        arms["azimuth"] = arm(limits_deg=[-400.0, 400.0])
        holder["axes"] = ["spin"]
    looks = {"principal_point_px": two(3.0), "roll_deg": two(3.0)[0], "pointing_deg": two(0.2)}
    values = describe().model_dump(mode="json", exclude_none=True)
    values |= {"arms": arms, "holder": holder, "camera": values["camera"] | looks | camera}
    return RigDescription.model_validate(values)


def some_pose(rng: np.random.Generator, kind: str) -> Pose:
    light, camera, third, spin = (float(a) for a in rng.uniform(-1.2, 1.2, 4))
    return Pose(light, camera, third, spin) if kind == "tilt" else Pose(light, camera, spin=spin, azimuth=third)


@pytest.mark.parametrize("kind", KINDS)
def test_views_are_those_of_a_plain_implementation(kind: str) -> None:
    rng = np.random.default_rng(11)
    for _ in range(25):
        description, pose = rig(rng, kind), some_pose(rng, kind)
        seen, plain = view(description, pose), plain_rig.place(description, pose)
        # rounding of some ten rotations of vectors of a metre [mm]
        np.testing.assert_allclose(seen.source_mm, plain["lamp"], atol=1e-9)
        np.testing.assert_allclose(seen.camera_mm, plain["lens"], atol=1e-9)
        for mine, its in ((seen.image_x, "image_x"), (seen.image_y, "image_y"), (seen.optical_axis, "sight")):
            np.testing.assert_allclose(mine, plain[its], atol=1e-12)
        for mine, its in zip(directions(description, pose).vectors, ("lamp", "lens"), strict=True):
            np.testing.assert_allclose(mine, plain[its] / np.linalg.norm(plain[its]), atol=1e-12)
        point = np.array([1.5, -2.0, 0.0])
        column, row = plain_rig.imaged(description, plain, point)
        # rounding of 1e-12 of the image's extent of thousands of pixels
        np.testing.assert_allclose(spot(description, seen, column, row), point[:2], atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_reached_pose_shows_the_directions_that_were_asked_for(kind: str) -> None:
    """Directions that several degrees of misalignment leave to reach: not around retro, and not at a pole of the
    azimuth, where errors of elevation close a cone."""
    rng = np.random.default_rng(12)
    reached = 0
    for _ in range(30):
        description = rig(rng, kind)
        for _ in range(5):
            theta = rng.uniform(0.0 if kind == "tilt" else math.radians(12.0), math.radians(80.0), 2)
            d = Directions(theta[0], rng.uniform(0, 6.28), theta[1], rng.uniform(0, 6.28))
            if not math.radians(15.0) < separation(d.floats):
                continue
            back = directions(description, reach(description, d))
            assert max(np.linalg.norm(a - b) for a, b in zip(back.vectors, d.vectors, strict=True)) < 1e-9
            reached += 1
    assert reached > 120


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_around_retro_and_the_poles_a_pose_is_exact_or_there_is_none(kind: str) -> None:
    """Where a pose is within 0.4 deg and not exact, or refused, 20 searches from anywhere find no exact one either."""
    from scipy.optimize import least_squares

    rng, inexact = np.random.default_rng(17), 0
    for number in range(40):
        if number % 5 == 0:
            description = rig(rng, kind)
            bare = {"light_body_radius_mm": 0.0, "camera_body_radius_mm": 0.0}
            description = description.model_copy(update={"geometry": description.geometry.model_copy(update=bare)})
        theta, phi = rng.uniform(0.1, 1.3, 2), rng.uniform(0, 6.28, 2)
        if kind == "tilt":
            theta[1], phi[1] = theta[0] + rng.normal(0, 0.03), (phi[0] + rng.normal(0, 0.03)) % 6.28
        else:
            theta[number % 2] = abs(rng.normal(0, 0.03))
        d = Directions(*(float(v) for pair in zip(theta, phi, strict=True) for v in pair))
        wanted = np.concatenate(d.vectors)
        try:
            off = float(np.linalg.norm(np.concatenate(directions(description, reach(description, d)).vectors) - wanted))
        except Unreachable:
            off = 1.0
        if off < 1e-9 or inexact == 3:
            continue
        inexact += 1
        names = list(description.axes())

        def beside(x: np.ndarray, rig: RigDescription = description, names: list[str] = names,
                   wanted: np.ndarray = wanted) -> np.ndarray:  # fmt: skip
            source, eye, *_ = kinematics.ends(rig, Pose(**dict(zip(names, x.tolist(), strict=True))))
            return np.concatenate([source / np.linalg.norm(source), eye / np.linalg.norm(eye)]) - wanted

        starts = rng.uniform(-1.5, 1.5, (20, 4))
        best = min(math.sqrt(2 * least_squares(beside, s, xtol=1e-14, gtol=1e-14).cost) for s in starts)
        assert best > 1e-6, (kind, number, off, best)
    assert inexact == 3


def test_a_rig_that_cannot_turn_out_of_its_plane_stands_as_close_as_it_can() -> None:
    values = describe().model_dump(mode="json", exclude_none=True)
    values["holder"] = {}
    values["arms"] = {
        "light": {"elevation_deg": 1.5},
        "camera": {"elevation_deg": -0.5, "harmonics_deg": [[1, 0.3, 0]]},
    }
    description = RigDescription.model_validate(values)
    d = Directions(math.radians(30), 0.0, math.radians(50), math.pi)
    # the polar angles along the plane are met, and what stands out of it is the elevation
    (source, detector), wanted = directions(description, reach(description, d)).vectors, d.vectors
    assert math.degrees(np.linalg.norm(source - wanted[0])) == pytest.approx(1.5, abs=1e-3)
    assert math.degrees(np.linalg.norm(detector - wanted[1])) == pytest.approx(0.5, abs=1e-3)
    values["arms"]["light"]["elevation_deg"] = 8.0
    with pytest.raises(Unreachable, match=r"errors of alignment keep it 8\.0 deg"):
        reach(RigDescription.model_validate(values), d)


@pytest.mark.parametrize("kind", KINDS)
def test_without_errors_both_ways_to_a_view_agree_and_the_short_one_is_taken(kind: str) -> None:
    rng = np.random.default_rng(13)
    description = rig(rng, kind, size=0.0)
    assert description.as_meant
    for _ in range(10):
        pose = some_pose(rng, kind)
        seen, (source, eye, onto, _) = view(description, pose), kinematics.ends(description, pose)
        assert seen.sight is None
        np.testing.assert_allclose(source, seen.source_mm, atol=1e-10)
        np.testing.assert_allclose(eye, seen.camera_mm, atol=1e-10)
        axes = (onto @ kinematics.camera_on_arm(description)).T
        np.testing.assert_allclose(axes, [seen.image_x, seen.image_y, seen.optical_axis], atol=1e-13)
        assert true_pose(description, pose) is pose
        assert read_pose(description, pose) is pose


def test_the_errors_of_encoders_are_taken_out_and_put_back() -> None:
    rng = np.random.default_rng(14)
    description = rig(rng, "azimuth")
    for _ in range(20):
        pose = some_pose(rng, "azimuth")
        true = true_pose(description, pose)
        for name, axis in (("light", description.arms.light), ("camera", description.arms.camera)):
            plain = plain_rig.true_deg(axis, math.degrees(getattr(pose, name)))
            assert math.degrees(getattr(true, name)) == pytest.approx(plain, abs=1e-12)
        back = read_pose(description, true)
        assert [back.light, back.camera, back.azimuth] == pytest.approx(
            [pose.light, pose.camera, pose.azimuth], abs=1e-12
        )
        assert (back.tilt, back.spin) == (pose.tilt, pose.spin)


def test_a_lens_with_distortion_images_as_opencv_says() -> None:
    rng = np.random.default_rng(15)
    bent = (-0.35, 0.2, 0.004, -0.003, 0.05)
    description = rig(rng, "tilt", width=160, height=120, pixel_um=80.0, focal_length_mm=40.0, distortion=bent)
    seen = view(description, Pose(0.3, -0.4, 0.1, 0.2))
    column, row = 140.0, 9.0
    x, y = spot(description, seen, column, row)
    camera = description.camera
    pixels = 1.0 / (1.0 / 40.0 - 1.0 / description.geometry.camera_distance_mm) / 0.08
    middle = [(160 - 1) / 2 + camera.principal_point_px[0], (120 - 1) / 2 + camera.principal_point_px[1]]
    matrix = np.array([[pixels, 0.0, middle[0]], [0.0, pixels, middle[1]], [0.0, 0.0, 1.0]])
    axes = np.array([seen.image_x, seen.image_y, seen.optical_axis])
    turned, _ = cv2.Rodrigues(axes)
    imaged, _ = cv2.projectPoints(np.array([[[x, y, 0.0]]]), turned, -axes @ seen.camera_mm, matrix, np.array(bent))
    assert imaged.ravel() == pytest.approx([column, row], abs=1e-6)  # OpenCV's rotation vector: 1e-9 of 1000 pixels
    # the whole frame, and the way back: lens and frame agree where the corner of the frame is bent by pixels
    whole = pixel_map(description, seen)
    assert (whole.x_mm[9, 140], whole.y_mm[9, 140]) == pytest.approx(tuple(spot(description, seen, 140, 9)), abs=1e-9)
    columns, rows = outline(description, seen)
    around = [spot(description, seen, c, r) for c, r in zip(columns[::16], rows[::16], strict=True)]
    assert np.hypot(*np.transpose(around)) == pytest.approx(description.acquisition.roi_radius_mm, abs=1e-9)
    straight = description.model_copy(update={"camera": camera.model_copy(update={"distortion": (0.0,) * 5})})
    assert math.dist(place(straight, seen, "sample"), place(description, seen, "sample")) < 1e-2  # the middle
    assert abs(pixel_map(straight, seen).x_mm[9, 140] - whole.x_mm[9, 140]) > 0.5 * 0.08 / pixels * 700


def test_a_distortion_that_folds_the_frame_is_refused() -> None:
    description = rig(np.random.default_rng(16), "tilt", width=160, height=120, pixel_um=200.0, focal_length_mm=40.0,
                      distortion=(-9.0, 0.0, 0.0, 0.0, 0.0))  # fmt: skip
    with pytest.raises(ConfigError, match=r"camera\.distortion"):
        pixel_map(description, view(description, Pose(0.3, -0.4))).weight  # noqa: B018


def test_an_azimuth_axis_has_no_elevation() -> None:
    values = describe().model_dump(mode="json", exclude_none=True)
    with pytest.raises(ValueError, match=r"azimuth\.elevation_deg"):
        RigDescription.model_validate(values | {"arms": {"azimuth": {"elevation_deg": 1.0}}})


def test_the_covariance_of_numbers_is_that_of_the_last_file_that_knows_them() -> None:
    first = Calibrated(kind="geometry", file="a", sha256="", made="2026-01-01", parameters=["a", "b", "c"],  # type: ignore[arg-type]
                       u=[1.0, 2.0, 3.0], correlation=[[1, 0.5, 0.1], [0.5, 1, 0.2], [0.1, 0.2, 1]])  # fmt: skip
    second = Calibrated(kind="camera", file="b", sha256="", made="2026-01-02", parameters=["b", "d"],  # type: ignore[arg-type]
                        u=[4.0, 5.0], correlation=[[1, -0.4], [-0.4, 1]])  # fmt: skip
    description = describe().model_copy(update={"calibration": CalibrationUse(known=(first, second))})
    found = covariance_of(description, ["d", "a", "e", "b", "c"])
    expected = [[25, 0, 0, -8, 0], [0, 1, 0, 0, 0.3], [0, 0, 0, 0, 0], [-8, 0, 0, 16, 0], [0, 0.3, 0, 0, 9]]
    np.testing.assert_allclose(found, np.array(expected), rtol=1e-12)
    with pytest.raises(ArgumentError):
        covariance_of(description, ["a", "a"])
