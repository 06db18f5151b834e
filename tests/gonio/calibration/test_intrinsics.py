"""Camera intrinsics from pictures of a ChArUco board, drawn by OpenCV, and photographed."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from gonio.calibration import intrinsics
from gonio.calibration.board import BoardFile, read_board
from gonio.errors import ConfigError, DataError
from gonio.rig.fiducials import dictionary_of
from tests.places import measured

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
    with pytest.raises(DataError, match="shows no board"):
        intrinsics.calibrate([blank] * 3, BOARD, DICTIONARY, SIZE)
    with pytest.raises(DataError, match=r"torn.png: cannot be read as a picture"):
        intrinsics.calibrate([torn], BOARD, DICTIONARY, SIZE)
    with pytest.raises(DataError, match="2 pictures show the board"):
        intrinsics.calibrate([*pictures[:2], blank], BOARD, DICTIONARY, SIZE)
    with pytest.raises(DataError, match="480 x 360 pixels, and 640 x 480 are needed"):
        intrinsics.calibrate(pictures, BOARD, DICTIONARY, (640, 480))
    with pytest.raises(DataError, match="cannot be told apart"):
        intrinsics.calibrate([pictures[0]] * 4, BOARD, DICTIONARY, SIZE)


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
