"""The middle of the lamp in a frame, whose image is counted out here: lamp and pupil as discs, one over the other."""

import math

import numpy as np
import pytest
from scipy.signal import fftconvolve

from gonio.lab.calibration.geometry_scans import spot_of
from gonio.lab.rig import Pose, imaging, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera, Lamp
from gonio.typing import Floats
from tests.command_line import some
from tests.gonio.numpy_rig import describe

SHAPE, FINE, PAD = (96, 128), 4, 12
LAMP_PX, PUPIL_PX = 24.0, 10.0


def rig() -> RigDescription:
    """Half-angles that make discs of these radii: over a pixel a line of sight turns by pixel/camera + pixel/light."""
    plain = describe(camera=Camera(height=SHAPE[0], width=SHAPE[1], pixel_um=20.0))
    pixel_mm = imaging.pixel_on_sample_mm(plain, kinematics.view(plain, Pose()))
    turn_deg = math.degrees(pixel_mm / plain.geometry.light_distance_mm + pixel_mm / plain.geometry.camera_distance_mm)
    camera = plain.camera.model_copy(update={"lens_half_angle_deg": PUPIL_PX * turn_deg})
    return plain.model_copy(update={"camera": camera, "lamp": Lamp(half_angle_deg=LAMP_PX * turn_deg)})


def image(column: float, row: float, brightness: float) -> Floats:
    """Parts of the pupil that see the lamp, in pixels that are counted in sixteenths; over full scale it clips."""
    rows, columns = ((np.arange(-PAD * FINE, (n + PAD) * FINE) + 0.5) / FINE - 0.5 for n in SHAPE)
    lamp = np.hypot(columns[None, :] - column, rows[:, None] - row) <= LAMP_PX
    span = np.arange(-PUPIL_PX * FINE, PUPIL_PX * FINE + 1) / FINE
    pupil = np.hypot(span[None, :], span[:, None]) <= PUPIL_PX
    seen = fftconvolve(lamp.astype(float), pupil.astype(float), mode="same") / np.count_nonzero(pupil)
    seen = seen.reshape(len(rows) // FINE, FINE, len(columns) // FINE, FINE).mean(axis=(1, 3))[PAD:-PAD, PAD:-PAD]
    noise = np.random.default_rng(1).normal(0.0, 0.003, SHAPE)
    return np.asarray(np.minimum(0.04 + brightness * seen, 1.0) + noise)


@pytest.mark.parametrize(("column", "row", "part"), [
    (63.5, 47.5, "whole"), (20.3, 80.6, "left"), (100.2, 15.1, "edge"), (100.2, 15.1, "whole"),
])  # fmt: skip
@pytest.mark.parametrize("brightness", [0.5, 3.0])
def test_the_middle_is_found_from_the_whole_disc_or_a_part_of_its_edge(
    column: float, row: float, brightness: float, part: str
) -> None:
    inside = {
        "whole": None,
        "left": np.tile(np.arange(SHAPE[1]) < column, (SHAPE[0], 1)),
        "edge": np.tile(np.arange(SHAPE[0])[:, None] > row - 12.0, (1, SHAPE[1])),
    }[part]
    found = some(spot_of(image(column, row, brightness), rig(), inside))
    assert (
        math.hypot(found[0] - column, found[1] - row) < 0.15
    )  # of 24 pixels; 3000 pixels of 0.3 % noise would do better than the counted image
    assert found[2] < 0.1


def test_what_is_no_lamp_has_no_middle() -> None:
    rows, columns = np.indices(SHAPE)
    assert spot_of(np.full(SHAPE, 0.01), rig(), None) is None, "dark"
    assert spot_of(0.1 + 0.8 * columns / SHAPE[1], rig(), None) is None, "a slope"
    assert spot_of(((columns // 8 + rows // 8) % 2).astype(float), rig(), None) is None, "a chequer"
    assert spot_of(image(150.0, 47.5, 0.8), rig(), None) is None, "its middle is outside the frame"
