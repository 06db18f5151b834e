"""Small parts of a rig file against values by hand: sensor, patterns, markers, rules that pause a run."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.config import parse
from gonio.errors import ConfigError, DataError
from gonio.lab.rig import fiducials, light_and_camera
from gonio.lab.rig.description import Fiducials, Suspender
from gonio.lab.rig.light_and_camera import Camera
from gonio.samples.textures import PATTERNS, picture


def test_a_camera_is_full_at_its_well_or_at_the_range_of_its_converter() -> None:
    camera = Camera(bits=10, black_level_dn=23.0, electrons_per_dn=3.0, full_well_e=1e6)
    assert (camera.white_level_dn, camera.saturation_e) == (1023.0, 3000.0)
    assert camera.model_copy(update={"full_well_e": 2000.0}).saturation_e == 2000.0
    for exposure_s in camera.exposure_limits_s:
        camera.require_exposure(exposure_s)
        with pytest.raises(ConfigError, match="exposure"):
            camera.require_exposure(exposure_s * (1.01 if exposure_s > 1.0 else 0.99))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"exposure_limits_s": (1.0, 1.0)}, "shortest < longest"),
        ({"bits": 8, "black_level_dn": 255.0}, "must lie below"),
        ({"nonlinearity": (-0.26,)}, "more than a sensor's"),  # the slope may fall by 2 x 0.25
        ({"nonlinearity": (0.1, 0.11)}, "more than a sensor's"),  # 0.2 + 0.33
        ({"bits": 8, "black_level_dn": 0.0, "response": tuple(range(255))}, "needs 256"),
        ({"bits": 10, "black_level_dn": 0.0, "response": tuple(range(256))}, "needs 256"),
        ({"bits": 8, "black_level_dn": 0.0, "response": (0.0, *range(255))}, "must grow"),
        ({"bits": 8, "black_level_dn": 0.0, "response": (0.1, *range(1, 256))}, "begin with 0"),
        ({"bits": 8, "black_level_dn": 0.0, "response": (*range(255), 255.1)}, "end with 255"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse(Camera, keys, "camera")


def test_a_bent_response_is_straightened() -> None:
    """x (1 - 0.1 s + 0.05 s^2) of 1023 DN: half of the range reads 511.5 x (1 - 0.05 + 0.0125)."""
    camera = Camera(bits=10, nonlinearity=(-0.1, 0.05))
    signal = np.array([0.0, 102.3, 511.5, 1023.0])
    read = light_and_camera.bent(camera, signal)
    np.testing.assert_allclose(read, signal * [1.0, 0.9905, 0.9625, 0.95], rtol=1e-14)
    np.testing.assert_allclose(light_and_camera.straightened(camera, read), signal, rtol=1e-13, atol=1e-13)
    slopes = light_and_camera.by_coefficients(camera, signal)
    for k, c in enumerate(camera.nonlinearity):
        up, down = (
            light_and_camera.straightened(
                camera.model_copy(update={"nonlinearity": tuple(
                    value + (step if at == k else 0.0) for at, value in enumerate(camera.nonlinearity))}), read)
            for step in (1e-5, -1e-5)
        )  # fmt: skip
        np.testing.assert_allclose(slopes[k], (up - down) / 2e-5, rtol=1e-6, atol=1e-8, err_msg=str(c))  # differences
    table = Camera(bits=8, black_level_dn=0.0, response=tuple(x * x / 255.0 for x in range(256)))
    linear = light_and_camera.linear_dn(table, np.array([0, 51, 255, 300]))
    np.testing.assert_allclose(linear, [0.0, 10.2, 255.0, 255.0], rtol=1e-12)  # rounding


def test_bricks_have_mortar_and_shades_of_their_own() -> None:
    """Two courses to a tile. Mortar: 6 % of a course above and below, 1.5 % of a brick at each end."""
    pattern, shades = PATTERNS["bricks"]
    for x, y, brick in [
        (0.5, 0.25, True), (0.5, 0.02, False), (0.5, 0.04, True), (0.5, 0.48, False), (0.5, 0.46, True),
        (0.01, 0.25, False), (0.02, 0.25, True), (0.99, 0.25, False), (0.5, 0.75, False), (0.48, 0.75, True),
        (0.01, 0.75, True),
    ]:  # fmt: skip
        value = pattern(np.array([[x, y]]), np.zeros((1, 2)))
        assert (value[0] >= 0.5) == brick, (x, y)
        assert value[0] in shades
    upper = pattern(np.array([[0.9, 0.75], [0.1, 0.75]]), np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert upper[0] == upper[1]  # one brick, across the border of two tiles
    tiles = np.array([[float(k), 0.0] for k in range(200)])
    assert len(set(pattern(np.full((200, 2), [0.5, 0.25]), tiles).tolist())) == 16  # all shades, among 200 bricks
    assert set(PATTERNS["speckle"][0](np.random.default_rng(0).random((2000, 2)), tiles).tolist()) <= set(
        PATTERNS["speckle"][1].tolist()
    )


def test_a_picture_s_first_row_is_its_upper_edge(tmp_path: Path) -> None:
    np.save(tmp_path / "t.npy", np.array([[0.0, 0.25, 0.5], [0.75, 1.0, 0.125]]))
    value, occurring = picture(tmp_path / "t.npy", "map")
    at = np.array([[0.0, 0.99], [0.34, 0.6], [0.99, 0.51], [0.1, 0.49], [0.5, 0.2], [1.0, 0.0]])
    assert value(at, at).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0, 0.125]
    assert occurring.tolist() == [0.0, 0.125, 0.25, 0.5, 0.75, 1.0]
    for number, (array, message) in enumerate([
        (np.array([[0.0, 1.001]]), "outside"), (np.array([[-0.001, 1.0]]), "outside"), (np.zeros(3), "shape"),
        (np.array([["a"]]), "real numbers"), (np.zeros((0, 3)), "outside"),
    ]):  # fmt: skip
        np.save(tmp_path / f"{number}.npy", array)
        with pytest.raises(DataError, match=message):
            picture(tmp_path / f"{number}.npy", "map")


def test_markers_stand_around_the_aperture_and_are_seen_from_above() -> None:
    import cv2

    marks = Fiducials(count=4, marker_mm=8.0, ring_mm=18.0)
    np.testing.assert_allclose(
        fiducials.centres_mm(marks), [[18, 0], [0, 18], [-18, 0], [0, -18]], atol=1e-14
    )  # rounding
    np.testing.assert_allclose(
        fiducials.corners_mm(marks)[1], [[-4, 22], [4, 22], [4, 14], [-4, 14]], atol=1e-14
    )  # top left, top right, bottom right, bottom left
    # OpenCV finds the printed markers where they are said to be: 10 pixels a millimetre, y up
    across = (np.arange(600) - 299.5) / 10.0
    x, y = np.meshgrid(across, -across)
    printed = fiducials.white(marks, x, y)
    assert set(np.unique(printed)) == {-1, 0, 1}
    reach = 0.7 * 8.0  # half a marker, and a fifth of one as its rim
    for inside, dx in ((1, 0.999), (-1, 1.001)):
        assert fiducials.white(marks, np.array([18.0 + dx * reach]), np.zeros(1)).tolist() == [inside]
    picture_8 = np.where(printed == 0, 0, 255).astype(np.uint8)
    corners, ids, _ = cv2.aruco.ArucoDetector(fiducials.dictionary_of(marks.dictionary)).detectMarkers(picture_8)
    assert sorted(ids.ravel().tolist()) == [marks.first_id + k for k in range(4)]
    for found, number in zip(corners, ids.ravel(), strict=True):
        expected = fiducials.corners_mm(marks)[number - marks.first_id] * [10.0, -10.0] + 299.5
        np.testing.assert_allclose(found[0], expected, atol=1.0)  # whole pixels


@pytest.mark.parametrize(
    ("keys", "value", "back", "broken"),
    [
        ({"above": 5.0}, 5.0, 0.0, False), ({"above": 5.0}, 5.1, 0.0, True), ({"above": 5.0}, 4.6, 0.5, True),
        ({"above": 5.0}, 4.5, 0.5, False), ({"above": 5.0}, "open", 0.0, True), ({"below": 2.0}, 2.0, 0.0, False),
        ({"below": 2.0}, 1.9, 0.0, True), ({"below": 2.0}, 2.4, 0.5, True), ({"below": 2.0}, 2.5, 0.5, False),
        ({"below": 2.0}, math.nan, 0.0, True), ({"above": 5.0}, math.nan, 0.0, True),
        ({"unless": "locked"}, "locked", 0.0, False),
        ({"unless": "locked"}, "lost", 0.0, True),
    ],
)  # fmt: skip
def test_a_threshold_and_its_hysteresis(keys: dict[str, Any], value: Any, back: float, broken: bool) -> None:
    rule = parse(Suspender, {"quantity": "temperature", "longest_s": 60.0} | keys, "suspend.room")
    assert rule.breaks(value, back) is broken
    words = {"above": f"above {5.0 - back:g}", "below": f"below {2.0 + back:g}", "unless": 'anything but "locked"'}
    assert rule.words(back) == words[next(iter(keys))]
