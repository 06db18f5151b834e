"""Printed markers: what the simulated camera shows of them, and OpenCV finds."""

import math
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from gonio_sim.rig import SIM, SimulatedRig

from gonio.config import parse
from gonio.errors import ConfigError, DataError
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import fiducials, intrinsics
from gonio.lab.calibration.board import BoardFile, read_board
from gonio.lab.rig import imaging, kinematics
from gonio.lab.rig.description import Fiducials, RigDescription
from gonio.lab.rig.fiducials import corners_mm, dictionary_of, white
from tests.command_line import gonio, some
from tests.places import measured


@pytest.fixture(scope="module")
def description() -> RigDescription:
    tables = tomllib.loads(SIM.toml)
    tables["camera"] |= {"width": 400, "height": 300, "pixel_um": 8.0, "focal_length_mm": 50.0}
    tables["holder"] |= {"fiducials": {}}
    return parse(RigDescription, tables, "test")


@pytest.mark.parametrize(("camera", "tilt"), [(5.0, 0.0), (40.0, 10.0)])
def test_corners_are_where_the_markers_are(description: RigDescription, camera: float, tilt: float) -> None:
    """Corners scatter by 0.1 to 0.2 px in frames with noise; together they show no shift."""
    rig = SimulatedRig(description, None, 1, confirm=False)
    marks = some(description.holder.fiducials)
    with ManualRig(rig, "test") as manual:
        rig.put("mirror")
        manual.lamp(True)
        manual.move(
            light=math.radians(-30), camera=math.radians(camera), tilt=math.radians(tilt), spin=math.radians(20)
        )
        frame = manual.camera.capture(0.05)
        view = kinematics.view(rig.world.truth, rig.world.pose)
    numbers, pixels = fiducials.detect(frame.mosaic, marks)
    numbers, pixels, scatter = fiducials.consistent(marks, numbers, pixels)
    assert len(numbers) >= 16  # of the eight markers, those above and below lie at the frame's edge
    flat = corners_mm(marks).reshape(-1, 2)[numbers]
    off = pixels - np.stack(imaging.project(description, view, np.column_stack([flat, np.zeros(len(flat))])), axis=1)
    assert np.abs(off.mean(axis=0)).max() < 0.1
    assert off.std() < 0.3
    assert scatter < 0.3


def test_raw_values_are_grey_between_their_darkest_and_brightest_thousandth() -> None:
    picture = np.repeat([1000, 1510, 1765, 2020], [2000, 500, 500, 2000]).reshape(50, 100)
    picture[0, 0], picture[-1, -1] = 0, 4095
    grey = intrinsics.stretched(picture.astype(np.uint16))
    assert np.unique(grey).tolist() == [0, 127, 191, 255]  # 1020 DN are 255 steps; a cold and a hot pixel are beyond
    assert intrinsics.stretched(grey) is grey


def test_a_spoiled_corner_is_left_out() -> None:
    marks = Fiducials()
    flat = corners_mm(marks).reshape(-1, 2)
    pixels = 200.0 + 7.0 * flat + np.random.default_rng(1).normal(0.0, 0.1, flat.shape)
    pixels[5] += 3.0
    numbers, kept, scatter = fiducials.consistent(marks, np.arange(len(flat)), pixels)
    assert 5 not in numbers
    assert len(kept) == len(numbers) >= len(flat) - 2
    assert 0.05 < scatter < 0.15


def drawn_svg(file: Path, scale: float) -> npt.NDArray[np.uint8]:
    """The rectangles of a drawing in millimetres, at so many pixels a millimetre."""
    root = ElementTree.parse(file).getroot()
    left, top, width, height = (float(x) for x in root.attrib["viewBox"].split())
    assert (root.attrib["width"], root.attrib["height"]) == (f"{width:g}mm", f"{height:g}mm"), "printed at 100 %"
    grey = np.full((round(height * scale), round(width * scale)), 90, np.uint8)
    for each in root.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, w, h = (float(each.attrib[name]) for name in ("x", "y", "width", "height"))
        columns, rows = (
            slice(round(a * scale), round(b * scale)) for a, b in ((x - left, x + w - left), (y - top, y + h - top))
        )
        grey[rows, columns] = 255 if each.attrib.get("fill") == "white" else 0
    assert grey.min() == 0
    assert not (grey == 90).any(), "the paper is white all over"
    (circle,) = root.iter("{http://www.w3.org/2000/svg}circle")
    assert float(circle.attrib["r"]) == 10.0, "the hole of 20 mm"
    (ruler,) = root.iter("{http://www.w3.org/2000/svg}path")
    level = ruler.attrib["d"].split()[2]
    assert ruler.attrib["d"] == f"M -10 {level} H 10", "20 mm"
    below = grey[round((float(level) - top - 0.5) * scale) :]
    assert 0 < len(below) < len(grey) / 4
    assert (below == 255).all(), "on the sheet, and beside the markers"
    return grey


@pytest.mark.parametrize("name", ["sheet.png", "sheet.svg"])
def test_the_sheet_shows_the_markers_that_are_looked_for(tmp_path: Path, name: str) -> None:
    """The picture of the sheet, found by OpenCV, has the corners of the rig file at 600 pixels an inch."""
    import cv2

    marks, file, scale = Fiducials(), tmp_path / name, 600 / 25.4
    fiducials.print_sheet(marks, 20.0, file)
    grey = drawn_svg(file, scale) if name.endswith("svg") else some(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    numbers, pixels = fiducials.detect(grey, marks)
    assert len(numbers) == 4 * marks.count
    middle = 0.5 * (np.array(grey.shape[::-1]) - 1.0)
    there = middle + scale * corners_mm(marks).reshape(-1, 2)[numbers] * [1.0, -1.0]
    assert np.abs(pixels - there).max() < 2.0  # of 142 pixels a side: matplotlib rounds the page to whole pixels
    with pytest.raises(ConfigError, match=r"written as .svg or .png"):
        fiducials.print_sheet(marks, 20.0, tmp_path / "sheet.pdf")


def test_command_refuses_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "old.toml").write_text("")
    (tmp_path / "none").mkdir()
    for arguments, said in (
        (["--print-fiducials", "sheet.svg"], "has no [holder.fiducials]"),
        ([], "--out CALIBRATION.toml is missing"),
        (["--out", "old.toml"], "is there already"),
        (["--out", "new.toml", "--images", "none"], "--images and --board go together"),
        (["--out", "new.toml", "--holder", "window"], '"window" is none of mirror, empty'),
        (["--out", "new.toml", "--scans", "gone"], "gone"),
        (["--out", "new.toml", "--images", "none", "--board", "gone.toml"], "holds no picture"),
    ):
        done = gonio(tmp_path, "calibrate", "geometry", "--rig", "sim", *arguments)
        assert done.returncode != 0
        assert said in done.stderr, done.stderr
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.parametrize("turn_deg", [10.0, 28.0, 45.0, 65.0])
def test_corners_of_squares_oblique_to_the_pixels_are_not_turned_about_their_middles(turn_deg: float) -> None:
    """What is drawn has no noise: what is left is pixels. OpenCV's single corners are turned by 0.1 to 0.2 px here."""
    marks, pitch_mm, size, parts = Fiducials(), 0.152, (320, 320), 8
    turn = np.exp(-1j * np.radians(turn_deg))  # rows run down

    def at_mm(column: Any, row: Any) -> Any:
        return pitch_mm * np.conj((column - 159.3) + 1j * (row - 160.4)) * np.conj(turn)

    rows, columns = np.indices(size)
    frame = np.zeros(size)
    for across in (np.arange(parts) + 0.5) / parts - 0.5:
        for down in (np.arange(parts) + 0.5) / parts - 0.5:
            there = at_mm(columns + across, rows + down)
            frame += white(marks, there.real, there.imag) == 1
    numbers, pixels = fiducials.detect((200 + 3000 * frame / parts**2).astype(np.uint16), marks)
    assert len(numbers) >= 16
    true = corners_mm(marks).reshape(-1, 2)[numbers]
    middles = corners_mm(marks).mean(axis=1)[numbers // 4]
    off = at_mm(*pixels.T) - (true[:, 0] + 1j * true[:, 1])
    outward = (true - middles) @ np.array([1.0, 1.0j])
    turned, drawn = (np.mean(off * np.conj(outward / np.abs(outward))) / pitch_mm).imag, off / pitch_mm
    assert abs(turned) < 0.02
    assert np.abs(drawn).max() < 0.15
    assert np.sqrt(np.mean(np.abs(drawn) ** 2)) < 0.08


# ---- camera intrinsics from pictures of a ChArUco board, drawn by OpenCV, and photographed ----


SIZE = (480, 360)
BOARD = BoardFile(squares=(6, 8), square_mm=20.0, marker_mm=15.0, dictionary="DICT_5X5_100")
DICTIONARY = dictionary_of("DICT_5X5_100")
FOCAL = 620.0
MATRIX = np.array([[FOCAL, 0, 244.0], [0, FOCAL, 173.0], [0, 0, 1]])
TURNS = ((0.5, 0.1, 0.0), (-0.4, 0.3, 0.1), (0.1, -0.6, 0.3), (0.2, 0.5, -0.4), (-0.5, -0.3, 1.2))


def picture(turn: tuple[float, ...], *, square_px: int = 60) -> npt.NDArray[np.uint8]:
    """The board as a pinhole sees it, four times as large as the frame and then averaged down."""
    board = cv2.aruco.CharucoBoard(BOARD.squares, BOARD.square_mm, BOARD.marker_mm, DICTIONARY)
    across, down = BOARD.squares
    flat = board.generateImage((across * square_px, down * square_px))
    rotation = cv2.Rodrigues(np.array(turn))[0]
    middle = np.array([0.5 * across, 0.5 * down, 0.0]) * BOARD.square_mm
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], np.array([0.0, 0.0, 420.0]) - rotation @ middle])
    to_mm = np.diag([BOARD.square_mm / square_px] * 2 + [1.0]) @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    finer = np.array([[4, 0, 1.5], [0, 4, 1.5], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        flat, finer @ MATRIX @ plane @ to_mm, (4 * SIZE[0], 4 * SIZE[1]), flags=cv2.INTER_AREA, borderValue=(128,)
    )
    return np.asarray(cv2.resize(large, SIZE, interpolation=cv2.INTER_AREA), np.uint8)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five pictures from different sides."""
    folder = tmp_path_factory.mktemp("board")
    files = []
    for number, turn in enumerate(TURNS):
        files.append(folder / f"{number}.png")
        cv2.imwrite(str(files[-1]), picture(turn))
    return files


def test_a_known_lens_is_found_within_its_uncertainty(pictures: list[Path]) -> None:
    """Focal length and principal point within 3 u; corners of drawn boards scatter by a tenth of a pixel."""
    found = intrinsics.calibrate(pictures, BOARD, DICTIONARY, SIZE)
    assert found.rms_px < 0.25
    u = np.sqrt(np.diag(found.covariance))
    truth = dict(zip(intrinsics.NAMES, (FOCAL, 244.0, 173.0, 0.0, 0.0, 0.0, 0.0), strict=True))
    for k, name in enumerate(intrinsics.NAMES):
        assert abs(found.values[name] - truth[name]) < 3 * u[k], name
    assert u[0] < 0.01 * FOCAL
    assert (u >= 0.999 * found.without_one).all()


def test_a_moved_corner_is_left_out_and_counted(pictures: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    plain = intrinsics.calibrate(pictures, BOARD, DICTIONARY, SIZE)
    refine = intrinsics.refine
    moved: list[int] = []

    def spoiled(grey: Any, corners: Any, half: int) -> Any:
        out = refine(grey, corners, half)
        if len(out) > 4 and not moved:
            out[3] += (4.0, -3.0)
            moved.append(3)
        return out

    monkeypatch.setattr(intrinsics, "refine", spoiled)
    found = intrinsics.calibrate(pictures, BOARD, DICTIONARY, SIZE)
    assert found.rejected >= plain.rejected + 1
    assert abs(found.values["f"] - plain.values["f"]) < 0.002 * FOCAL


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"squares": (8, 6)}, "do not lie as they should|which it does not have"),
        ({"marker_mm": 10.0}, "marker_mm / square_mm = 0.500"),
        ({"dictionary": "DICT_4X4_50"}, "another board than stated"),
    ],
)
def test_another_board_is_refused(pictures: list[Path], change: dict[str, Any], said: str) -> None:
    board = BOARD.model_copy(update=change)
    with pytest.raises(DataError, match=said):
        intrinsics.calibrate(pictures, board, dictionary_of(board.dictionary), SIZE)


def test_pictures_that_cannot_serve_are_refused(pictures: list[Path], tmp_path: Path) -> None:
    blank, torn = tmp_path / "blank.png", tmp_path / "torn.png"
    cv2.imwrite(str(blank), np.full(SIZE[::-1], 90, np.uint8))
    torn.write_bytes(b"\x89PNG no more")
    for those, size, message in (
        ([blank] * 3, SIZE, "shows no board"),
        ([torn], SIZE, r"torn.png: cannot be read as a picture"),
        ([*pictures[:2], blank], SIZE, "2 pictures show the board"),
        (pictures, (640, 480), "480 x 360 pixels, and 640 x 480 are needed"),
        ([pictures[0]] * 4, SIZE, "cannot be told apart"),
    ):
        with pytest.raises(DataError, match=message):
            intrinsics.calibrate(those, BOARD, DICTIONARY, size)


def test_boards_that_cannot_be(tmp_path: Path) -> None:
    file = tmp_path / "board.toml"
    file.write_text('squares = [6, 8]\nsquare_mm = 20\nmarker_mm = 25\ndictionary = "DICT_5X5_100"\n')
    with pytest.raises(ConfigError, match=r"marker_mm = 25 must be smaller than square_mm = 20"):
        read_board(file)
    file.write_text('squares = [6, 8]\nsquare_mm = 20\nmarker_mm = 15\ndictionary = "DICT_5X5"\n')
    with pytest.raises(ConfigError, match='dictionary = "DICT_5X5"'):
        read_board(file)


def test_four_photographs_with_a_published_calibration(tmp_path: Path) -> None:
    """0.25 px is asked for; the published calibration of these photographs leaves 0.182 px, without leaving any out.

    Its focal lengths are 452.5 and 456.8 px. The four boards lie within 5 deg of each other, so u is large.
    """
    photographs = measured("camera/charuco")
    file = tmp_path / "board.toml"
    file.write_text('squares = [5, 7]\nsquare_mm = 40\nmarker_mm = 20\ndictionary = "DICT_6X6_250"\n')
    board, dictionary = read_board(file)
    found = intrinsics.calibrate(sorted(photographs.glob("*.jpg")), board, dictionary, (640, 480))
    assert found.rms_px < 0.25
    assert found.rejected <= 5
    assert abs(found.values["f"] - 454.7) < 2 * np.sqrt(np.diag(found.covariance))[0]
    with pytest.raises(ConfigError, match="is a dictionary of markers, and not a board"):
        read_board(photographs / "tutorial_dict.yml")
