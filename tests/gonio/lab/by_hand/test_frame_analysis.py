"""Measures of a live frame, against scenes that are known."""

import math
import re
from itertools import pairwise

import numpy as np
import pytest

from gonio.lab.by_hand import frame_analysis
from gonio.lab.by_hand.live_view import pictures
from gonio.lab.by_hand.snapshot import Snapshot
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.regions import Roi
from tests.command_line import some
from tests.gonio.lab.by_hand.frames import HEIGHT, WIDTH, camera, ellipse, expose, texture
from tests.gonio.numpy_rig import describe

BOX = slice(60, 180), slice(80, 240)
REGION = Roi(slice(100, 140), slice(140, 180), np.ones((40, 40), bool))


def focus(blur_px: float, exposure_s: float = 1.0, seed: int = 0, pattern: str = "mono") -> frame_analysis.Focus:
    of, scene = camera(pattern), texture(blur_px)
    found = some(
        frame_analysis.focus(of, expose(of, scene, seed, exposure_s), expose(of, scene, seed + 1000, exposure_s), BOX)
    )
    return found


# ---- focus ----


@pytest.mark.parametrize("pattern", ["mono", "RGGB"])
def test_focus_falls_with_every_step_of_blur(pattern: str) -> None:
    values = [focus(blur, pattern=pattern).value for blur in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)]
    seen = [value for value in values if value is not None]
    assert len(seen) == len(values)
    assert all(a > 1.05 * b for a, b in pairwise(seen)), seen


def test_focus_is_the_same_at_all_exposures() -> None:
    """Noise is sixteen times apart in power; each value lies within four of its uncertainties of the others."""
    found = [focus(1.0, exposure_s, seed) for seed, exposure_s in enumerate((0.125, 0.5, 2.0))]
    longest = found[-1]
    for one in found:
        assert abs(some(one.value) - some(longest.value)) < 4 * math.hypot(one.u, longest.u)


def test_the_uncertainty_of_focus_is_its_scatter() -> None:
    found = [focus(2.0, 0.3, seed) for seed in range(40)]
    scatter = np.std([one.value or math.nan for one in found], ddof=1)
    # 40 values know their scatter to 11 %; how many pixels share noise depends on the scene, by a factor of 1.2
    assert 0.7 * scatter < np.mean([one.u for one in found]) < 1.8 * scatter


def test_noise_alone_is_no_structure() -> None:
    of = camera()
    even = np.full((HEIGHT, WIDTH), 2000.0)
    for seed in range(20):
        found = some(frame_analysis.focus(of, expose(of, even, seed), expose(of, even, seed + 1000), BOX))
        assert found.value is None
        assert "no structure" in found.why
        assert found.u < 0.003  # a hundredth of the textures' slope could be hidden, and no more


def test_the_pixels_own_differences_are_no_structure_where_the_rig_file_names_them() -> None:
    gain = 1.0 + 0.01 * np.random.default_rng(3).standard_normal((HEIGHT, WIDTH))
    even = np.full((HEIGHT, WIDTH), 2000.0)
    told = {}
    for prnu in (0.0, 0.01):
        of = camera(prnu=prnu)
        found = some(frame_analysis.focus(of, expose(of, even, 1, gain=gain), expose(of, even, 2, gain=gain), BOX))
        told[prnu] = found.value
    assert told[0.01] is None
    # the gradient of white noise of unit variance by Sobel in eighths: sqrt(2 x 12 / 64); known to 1 % by 19200 pixels
    assert told[0.0] == pytest.approx(0.01 * math.sqrt(0.375), rel=0.05)


def test_two_scenes_have_no_focus_between_them() -> None:
    of = camera()
    first, second = expose(of, texture(1.0), 1), expose(of, texture(1.0, 2000.0), 2)
    assert frame_analysis.focus(of, first, second, BOX) is None
    assert frame_analysis.noise(of, first, second, REGION) is None


def test_focus_of_a_saturated_or_dark_region_is_not_told() -> None:
    of = camera()
    bright, dark = texture(0.0, 30_000.0), np.zeros((HEIGHT, WIDTH))
    assert frame_analysis.noise(of, expose(of, bright, 1), expose(of, bright, 2), REGION) is None, "0 would be no truth"
    for scene, why in ((bright, "saturated"), (dark, "too dark")):
        found = some(frame_analysis.focus(of, expose(of, scene, 1), expose(of, scene, 2), BOX))
        assert (found.value, found.why.startswith(why)) == (None, True)


# ---- noise ----


def test_noise_is_that_of_the_sensor() -> None:
    of, even = camera(), np.full((HEIGHT, WIDTH), 2000.0)
    found = some(frame_analysis.noise(of, expose(of, even, 1), expose(of, even, 2), REGION))
    true = math.hypot(math.sqrt(2000.0 + 25.0) / 3.0, math.sqrt(1 / 12))
    assert found.expected_dn == pytest.approx(true, rel=0.01)  # by the mean of the frame
    assert found.dn == pytest.approx(true, rel=0.08)  # 1600 differences know it to 1.8 %: four and a half of that
    assert found.signal_dn == pytest.approx(2000 / 3, rel=0.01)
    assert found.u_rel == pytest.approx(true / 40 / (2000 / 3), rel=0.1)


def test_noise_of_a_dark_region_has_no_relative_uncertainty() -> None:
    of, dark = camera(), np.zeros((HEIGHT, WIDTH))
    found = some(frame_analysis.noise(of, expose(of, dark, 1), expose(of, dark, 2), REGION))
    assert found.u_rel is None
    assert found.dn == pytest.approx(math.hypot(5 / 3, math.sqrt(1 / 12)), rel=0.08)


# ---- levels ----


@pytest.mark.parametrize("pattern", ["mono", "RGGB", "GBRG"])
def test_histograms_count_every_pixel_of_their_colour_once(pattern: str) -> None:
    of = camera(pattern)
    mosaic = np.full((HEIGHT, WIDTH), 100, np.uint16)
    colours = np.array(list(pattern if pattern != "mono" else "mmmm")).reshape(2, 2)
    red_at = np.argwhere(colours == ("R" if pattern != "mono" else "m"))[0]
    mosaic[red_at[0] : 20 + red_at[0] : 2, red_at[1] : 10 + red_at[1] : 2] = 4095  # 10 x 5 pixels of one colour
    told = frame_analysis.levels(of, Frame(mosaic, 1.0, 64.0, 4095.0, pattern, time_s=0.0))
    size = HEIGHT * WIDTH
    shares = {"mono": 1.0, "R": 0.25, "G": 0.5, "B": 0.25}
    assert [one.channel for one in told] == (["mono"] if pattern == "mono" else ["R", "G", "B"])
    for one in told:
        assert sum(one.counts) == one.pixels == shares[one.channel] * size
        over = 50 if one.channel in ("mono", "R") else 0
        assert (one.saturated, one.counts[-1]) == (over, over)
        assert one.counts[100 * frame_analysis.BINS // 4096] == one.pixels - over


def test_a_full_well_counts_as_saturated_below_the_converters_end() -> None:
    of = camera(full_well_e=6000.0)
    frame = expose(of, np.full((HEIGHT, WIDTH), 9000.0), 1)
    assert frame.mosaic.max() < 2200
    assert frame_analysis.levels(of, frame)[0].saturated > 0.99 * frame.mosaic.size


def description(**changes: object) -> RigDescription:
    return describe(camera=camera(exposure_limits_s=(0.01, 10.0)), **changes)


@pytest.mark.parametrize(
    ("electrons", "exposure_s", "text", "advised_s"),
    [
        (7256.0, 1.0, "good", None),  # 60 % of 4031 DN of 3 e-
        (3628.0, 1.0, "longer by 2x", 2.0),
        (10_884.0, 1.0, "shorter by 1.5x", 0.667),
        (40_000.0, 1.0, "saturated: shorter by 4x or more", 0.25),
        (40_000.0 / 0.01, 0.01, "saturated at the shortest exposure: less light is needed", 0.01),
        (40_000.0 / 0.02, 0.02, "saturated: shorter by 2x or more", 0.01),
        (500.0 / 10, 10.0, "too dark at the longest exposure, 10 s: more light is needed", 10.0),
        (3000.0 / 8, 8.0, "longer by 1.2x, the camera's limit (10 s)", 10.0),
        (0.0, 0.1, "longer by 16x or more: hardly any light", 1.6),
    ],
)
def test_advice_leads_to_the_target_within_the_cameras_limits(
    electrons: float, exposure_s: float, text: str, advised_s: float | None
) -> None:
    rig = description()
    # a scene without noise: what the brightest pixel is, is known
    quiet = rig.camera.model_copy(update={"photon_noise": False, "read_noise_e": 0.0})
    mosaic = np.full((HEIGHT, WIDTH), 64, np.uint16)
    mosaic[120, 160] = round(float(np.clip(64 + electrons * exposure_s / 3, 0, 4095)))
    mosaic[0, 0] = 4095  # outside the region nothing counts
    frame = Frame(mosaic, exposure_s, 64.0, 4095.0, time_s=0.0)
    told = frame_analysis.advice(rig.model_copy(update={"camera": quiet}), frame, REGION)
    assert (told.text, told.target) == (text, 0.6)
    if advised_s is not None:
        assert told.exposure_s == pytest.approx(advised_s, rel=2e-3)  # of whole DN


# ---- the spot ----


@pytest.mark.parametrize(("soft", "pattern"), [(False, "mono"), (True, "RGGB")])
@pytest.mark.parametrize(
    ("column", "row", "a", "b", "angle"),
    [(150.3, 99.7, 40, 20, 0.4), (220.0, 150.5, 25, 15, -1.2), (90.4, 60, 9, 9, 0)],
)
def test_a_spot_is_where_it_is(
    column: float, row: float, a: float, b: float, angle: float, pattern: str, soft: bool
) -> None:
    of = camera(pattern)
    found, said = frame_analysis.spot(of, expose(of, ellipse(column, row, a, b, angle, soft=soft), 5))
    assert found is not None
    step = 1.0 if pattern == "mono" else 2.0  # a cell of a mosaic
    assert (found.column, found.row) == pytest.approx((column, row), abs=0.15 * step)
    # the smoothing widens a soft spot, whose half height lies at sqrt(2 ln 2) of its standard deviation
    wider = 2 * math.log(2) * (frame_analysis.SMOOTH_PX * step) ** 2 if soft else 0.0
    for length, half in ((found.major_px, a), (found.minor_px, b)):
        assert length == pytest.approx(2 * math.sqrt(half**2 + wider), rel=0.01, abs=0.7 * step)  # by whole cells
    if a > b:
        assert math.remainder(math.radians(found.angle_deg) - angle, math.pi) == pytest.approx(0, abs=0.02)
    assert (found.cut, found.saturated, found.others, said) == (False, False, 0, "")
    edge = np.array(found.outline) - (column, row)
    c, s = math.cos(angle), math.sin(angle)
    radius = np.hypot((edge @ (c, s)) / a, (edge @ (-s, c)) / b)
    assert np.abs(radius - 1).max() < 2.5 * step / b  # the outline runs through pixels' centres, and noise moves it


def test_a_spot_that_reaches_the_edge_of_the_frame_says_so() -> None:
    of = camera()
    found, said = frame_analysis.spot(of, expose(of, ellipse(30, 120, 60, 60, 0), 5))
    assert found is not None
    assert found.cut
    assert "reaches the edge of the frame" in said


def test_a_saturated_spot_and_a_second_one_are_told() -> None:
    of = camera()
    scene = ellipse(100, 100, 20, 20, 0, peak=40_000.0) + ellipse(250, 180, 15, 15, 0, peak=40_000.0)
    found, said = frame_analysis.spot(of, expose(of, scene, 5))
    assert found is not None
    assert found.column == pytest.approx(100, abs=0.2)
    assert (found.saturated, found.others) == (True, 1)
    assert said == "saturated: its outline is too wide; 1 more bright place"


@pytest.mark.parametrize(
    ("scene", "why"),
    [
        (np.zeros((HEIGHT, WIDTH)), "no light stands out of the noise"),
        (np.full((HEIGHT, WIDTH), 4000.0), "the light fills the frame evenly"),
        (ellipse(160, 120, 400, 400, 0, soft=True), "the light fills the frame, 8"),
        (6000.0 + ellipse(150, 100, 40, 20, 0, peak=2000.0), "the light fills the frame, 7"),
    ],
)
def test_where_there_is_no_spot_none_is_made_up(scene: np.ndarray, why: str) -> None:
    of = camera()
    for seed in range(5):
        found, said = frame_analysis.spot(of, expose(of, scene, seed))
        assert found is None
        assert said.startswith(f"no spot: {why}"), said


def test_hot_pixels_are_no_spot() -> None:
    of = camera()
    frame = expose(of, np.zeros((HEIGHT, WIDTH)), 1)
    places = np.random.default_rng(2).integers(0, (HEIGHT, WIDTH), (40, 2))
    frame.mosaic[places[:, 0], places[:, 1]] = 4000
    found, said = frame_analysis.spot(of, frame)
    assert found is None, found
    assert said.startswith("no spot")


def test_a_frame_of_many_pixels_gives_places_of_the_frame() -> None:
    """Wider than `WIDEST`, it is averaged down; places and sizes are those of the frame."""
    of = camera(width=2 * frame_analysis.WIDEST + 64, height=512)
    rows, cols = np.mgrid[:512, : of.width]
    scene = np.where((cols - 1500.0) ** 2 + (rows - 200.0) ** 2 < 60.0**2, 6000.0, 0.0)
    found, _ = frame_analysis.spot(of, expose(of, scene, 1))
    assert found is not None
    assert (found.column, found.row) == pytest.approx((1500, 200), abs=0.3)  # a third of a pixel of the smaller picture
    assert (found.major_px, found.minor_px) == pytest.approx((120, 120), abs=3)  # one pixel of it


# ---- pictures ----


@pytest.mark.parametrize(("width", "pattern"), [(2048, "mono"), (2048, "RGGB"), (1200, "RGGB"), (320, "mono")])
def test_a_single_saturated_pixel_is_red_in_the_smaller_picture_too(width: int, pattern: str) -> None:
    import cv2

    of = camera(pattern, width=width)
    mosaic = np.full((HEIGHT, width), 64 + 500, np.uint16)
    mosaic[101, width // 2 + 7] = 4095
    made = pictures(of, Frame(mosaic, 1.0, 64.0, 4095.0, pattern, time_s=0.0), (width / 2, 100.0))
    whole, zoom = (
        np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)).astype(int)
        for data in (made.whole, made.zoom)
    )
    shrink = whole.shape[1] / width
    assert whole.shape[1] == min(width, 960)
    red = np.argwhere(whole[..., 2] - whole[..., 0] > 100)  # a speck of 3 pixels; JPEG spreads it by one
    assert 4 <= len(red) <= 25
    assert red.mean(0) == pytest.approx(((101.5 * shrink - 0.5), (width // 2 + 7.5) * shrink - 0.5), abs=1.0)
    column, row, _, _ = made.zoom_box
    assert np.argwhere(zoom[..., 2] > zoom[..., 0]).tolist() == [[101 - row, width // 2 + 7 - column]]
    assert 495 < made.white_dn < 750, "one pixel does not darken the picture"


# ---- what is said of a single frame ----


def shot(of: Camera, frame: Frame) -> Snapshot:
    return Snapshot(frame, of, None, None, None, "the arms do not say where they stand")


def eight_bits(pattern: str = "mono", **changes: object) -> Camera:
    numbers: dict[str, object] = {"bits": 8, "black_level_dn": 4.0, "electrons_per_dn": 40.0}
    return camera(pattern, **numbers | changes)


def plain(dn: int, of: Camera) -> Frame:
    mosaic = np.full((HEIGHT, WIDTH), dn, np.uint16)
    return Frame(mosaic, 1.0, of.black_level_dn, of.white_level_dn, of.pattern, time_s=0.0)


@pytest.mark.parametrize("pattern", ["mono", "RGGB"])
def test_noise_and_saturation_of_8_bits_are_said(pattern: str) -> None:
    of = eight_bits(pattern)
    scene = np.full((HEIGHT, WIDTH), 4000.0)
    scene[:24] = 1e6  # a tenth of the pixels, far beyond full scale
    (said,) = shot(of, expose(of, scene, seed=3)).remarks()
    assert "10 % of the pixels are saturated" in said
    noise = float(re.findall(r"noise of a pixel ([0-9.]+) DN", said)[0])
    # photons, reading and rounding; the median of 7e4 second differences of whole numbers tells it to a third
    assert noise == pytest.approx(np.hypot(np.sqrt(4025.0) / 40.0, 12.0**-0.5), rel=0.33)


def test_noise_that_rounding_hides_is_not_called_none() -> None:
    of = eight_bits()
    (said,) = shot(of, plain(90, of)).remarks()
    assert "noise of a pixel 0.29 DN, 0.29 of it at least from rounding; 0 % of the pixels are saturated" in said


def test_levels_are_those_of_the_linear_signal() -> None:
    """A video camera whose curve is steep at its lower end: 200 of 255 DN are less than half of what it can hold."""
    curve = 255.0 * (np.arange(256) / 255.0) ** 3.0
    bent = eight_bits(black_level_dn=0.0, response=tuple(map(float, curve)))
    assert shot(bent, plain(200, bent)).numbers()["brightest_level"] == pytest.approx(curve[200] / 255.0, abs=0.01)


@pytest.mark.parametrize("of", [camera(), camera("RGGB"), eight_bits()])
def test_a_black_frame_is_told_from_a_faint_and_from_an_even_one(of: Camera) -> None:
    dark = np.zeros((HEIGHT, WIDTH))
    spot = dark.copy()
    spot[100:120, 100:120] = 2000.0
    even = np.full_like(dark, 0.05 * (of.white_level_dn - of.black_level_dn) * of.electrons_per_dn)
    said = ["black" in " ".join(shot(of, expose(of, scene, seed=1)).remarks(lit=True)) for scene in (dark, spot, even)]
    assert said == [True, False, False]
