"""What is told of frames one after the other: rates, histories, and when the focus is forgotten; on a test's clock."""

import math
from typing import Any

import numpy as np
import pytest

from gonio.lab.by_hand.live_view import Sight
from gonio.lab.rig import Frame, Pose
from gonio.lab.rig.description import Reference
from gonio.lab.rig.light_and_camera import Band, Camera, Lamp
from tests.gonio.lab.by_hand.test_lamp_timer import Clock
from tests.gonio.numpy_rig import BANDS, describe

CAMERA = Camera(width=96, height=80, pixel_um=40, exposure_limits_s=(1e-3, 10.0), photon_noise=True, read_noise_e=5.0)
RIG = describe(camera=CAMERA, reference=Reference(how="beside", offset_mm=(8.0, 0.0), diameter_mm=6.0))


def frame(seed: int, level_dn: float = 800.0) -> Frame:
    """A rough surface, of which each frame has noise of its own."""
    rough = 1.0 + 0.2 * np.random.default_rng(1).standard_normal((80, 96))
    noise = 10.0 * np.random.default_rng(100 + seed).standard_normal(rough.shape)
    mosaic = np.clip(64.0 + level_dn * rough + noise, 0, 4095).astype(np.uint16)
    return Frame(mosaic, 0.1, 64.0, 4095.0, time_s=float(seed))


class Watched:
    """A sight, with a clock that goes on by so much with every frame."""

    def __init__(self, every_s: float = 0.1) -> None:
        self.clock, self.every_s, self.count = Clock(), every_s, 0
        self.sight = Sight(RIG, self.clock)

    def stand(self, band: Band = BANDS[0], target: Any = "sample", **angles_deg: float) -> None:
        pose = Pose(**{name: math.radians(angle) for name, angle in angles_deg.items()})
        self.sight.stand(pose, band, target)

    def look(self) -> Any:
        self.count += 1
        told = self.sight.told(frame(self.count))
        self.clock.now += self.every_s
        return told


def test_frames_are_counted_and_their_rate_is_that_of_the_last_twenty() -> None:
    watched = Watched(0.1)
    watched.stand()
    first = watched.look()
    assert (first["n"], first["fps"]) == (1, None)
    for _ in range(30):
        told = watched.look()
    assert told["n"] == 31
    assert told["fps"] == pytest.approx(10.0)
    watched.every_s = 0.4
    for _ in range(21):
        told = watched.look()
    assert told["fps"] == pytest.approx(2.5), "older ones count no more"


@pytest.mark.parametrize(("every_s", "points"), [(0.1, 4), (0.25, 11), (0.5, 11)])
def test_the_history_of_the_focus_has_a_point_every_quarter_of_a_second(every_s: float, points: int) -> None:
    """Of twelve frames, of which the first has none before it; at 0.1 s every third one."""
    watched = Watched(every_s)
    watched.stand()
    for _ in range(12):
        told = watched.look()
    history = told["focus"]["history"]
    assert len(history) == points
    assert all(value is not None and value > 0.0 for _, value in history)
    before = [t for t, _ in history]
    assert np.diff(before) == pytest.approx(max(every_s, 0.3 if every_s == 0.1 else 0.0), abs=0.011)
    assert -0.25 < before[-1] <= 0.0, "times are those before now"
    assert told["focus"]["best"] >= told["focus"]["value"]


@pytest.mark.parametrize(
    ("angles_deg", "forgotten"),
    [
        ({"light": 30.05, "camera": -20.0}, False),  # a tenth of a degree is no motion
        ({"light": 30.15, "camera": -20.0}, True),
        ({"light": 29.85, "camera": -20.0}, True),
        ({"light": 30.0, "camera": -20.15}, True),
        ({"light": 30.0, "camera": -20.0, "tilt": 0.15}, True),
        ({"light": 30.0, "camera": -20.0, "spin": 0.15}, True),
        ({"light": 30.0, "camera": -20.0}, False),
    ],
)
def test_another_pose_is_another_focus(angles_deg: dict[str, float], forgotten: bool) -> None:
    watched = Watched()
    watched.stand(light=30.0, camera=-20.0)
    watched.look()
    assert watched.look()["focus"]["best"] > 0.0
    watched.stand(BANDS[0], "sample", **angles_deg)
    told = watched.look()
    assert (told["focus"]["best"] is None) is forgotten
    assert told["angles_deg"]["light"] == pytest.approx(angles_deg["light"])
    assert told["angles_deg"]["camera"] == pytest.approx(angles_deg["camera"])


def test_another_target_is_another_focus_and_another_band_is_not() -> None:
    watched = Watched()
    watched.stand()
    watched.look()
    watched.look()
    watched.stand(BANDS[1])
    assert watched.look()["focus"]["best"] is not None
    watched.stand(BANDS[1], target="reference")
    told = watched.look()
    assert told["focus"]["best"] is None
    assert told["predicted"]["target"] == "reference"


def test_light_that_has_changed_is_not_compared_with_what_was_before() -> None:
    watched = Watched()
    watched.stand()
    watched.look()
    assert watched.look()["noise"] is not None
    watched.sight.changed()
    told = watched.look()
    assert (told["noise"], told["focus"]["value"]) == (None, None)
    assert told["focus"]["best"] > 0.0
    assert watched.look()["noise"] is not None


def test_where_nobody_knows_the_pose_there_are_no_places() -> None:
    watched = Watched()
    watched.sight.stand(None, BANDS[0], "sample")
    told = watched.look()
    assert (told["angles_deg"], told["directions_deg"], told["saturated_in_region"]) == (None, None, None)
    assert told["predicted"]["why"] == "the arms do not say where they stand"
    assert watched.sight.middle == (47.5, 39.5)


def test_saturation_is_counted_in_the_region_and_at_its_level() -> None:
    watched = Watched()
    watched.stand()
    told = watched.look()
    full = min(4095.0 - 64.0, CAMERA.full_well_e / CAMERA.electrons_per_dn)
    assert told["saturated_dn"] == pytest.approx(64.0 + 0.98 * full)
    assert told["saturated_in_region"] == 0
    told = watched.sight.told(Frame(np.full((80, 96), 4095, np.uint16), 0.1, 64.0, 4095.0, time_s=99.0))
    assert told["saturated_in_region"] == told["predicted"]["region_pixels"] > 20


@pytest.mark.parametrize(("light_deg", "long"), [(0.0, 1.0), (60.0, 2.0)])
def test_the_beam_is_an_ellipse_as_long_as_it_is_oblique(light_deg: float, long: float) -> None:
    """Seen from above: a circle of 4 mm, and under 60 degrees twice as long across the axis of the arms."""
    sight = Sight(describe(camera=CAMERA, lamp=Lamp(beam_diameter_mm=4.0)), Clock())
    sight.stand(Pose(light=math.radians(light_deg)), BANDS[0], "sample")
    width, height = np.ptp(np.array(sight.told(frame(1))["predicted"]["beam"]), axis=0)
    # the lamp is a point at 1 m: its beam is a cone, and not quite an ellipse about the middle
    assert width / height == pytest.approx(long, rel=0.01)
    image_mm = 1.0 / (1.0 / CAMERA.focal_length_mm - 1.0 / 1000.0)
    assert height * 0.04 * 1000.0 / image_mm == pytest.approx(4.0, rel=0.01)
