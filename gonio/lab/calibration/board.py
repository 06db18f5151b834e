"""A ChArUco board as it was printed, from a file of ours or of OpenCV's."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from gonio.config import Strict, parse, read_toml
from gonio.errors import ConfigError
from gonio.lab.rig.fiducials import dictionary_of
from gonio.typing import TomlTable

OPENCV = (".yml", ".yaml")
"""Files of OpenCV's FileStorage."""


class BoardFile(Strict):
    """A ChArUco board, as it was printed."""

    squares: tuple[Annotated[int, Field(ge=3)], Annotated[int, Field(ge=3)]]
    """Across and down."""
    square_mm: Annotated[float, Field(gt=0)]
    marker_mm: Annotated[float, Field(gt=0)]
    dictionary: str
    """A name of OpenCV's, as "DICT_6X6_250", or a file of its own (.yml) beside this one."""
    legacy_pattern: bool = False
    """Printed by OpenCV before 4.6, with an even number of rows: the corner at the top left is a marker."""


def read_board(path: str | Path) -> tuple[BoardFile, Any]:
    """A board, and the dictionary of its markers.

    Raises
    ------
    ConfigError
        A file is missing or wrong, or the board has a marker that does not fit into its square.
    """
    path = Path(path)
    board = parse(BoardFile, _opencv_keys(path) if path.suffix in OPENCV else read_toml(path), path)
    if board.marker_mm >= board.square_mm:
        raise ConfigError(
            f"{path}: marker_mm = {board.marker_mm:g} must be smaller than square_mm = {board.square_mm:g}"
        )
    try:
        own = Path(board.dictionary).suffix in OPENCV
        dictionary = _own_dictionary(path.parent / board.dictionary) if own else dictionary_of(board.dictionary)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    needed = board.squares[0] * board.squares[1] // 2
    if dictionary.bytesList.shape[0] < needed:
        raise ConfigError(
            f'{path}: squares = [{board.squares[0]}, {board.squares[1]}] needs {needed} markers, and "'
            f'{board.dictionary}" has {dictionary.bytesList.shape[0]}'
        )
    return board, dictionary


def _opencv_keys(path: Path) -> TomlTable:
    """The keys of a `BoardFile` from a file of OpenCV's FileStorage."""
    store = _opened(path)  # which its nodes do not keep alive
    root = store.root()
    if not root.getNode("nmarkers").empty():
        raise ConfigError(
            f"{path}: is a dictionary of markers, and not a board. Write a board.toml with squares = [across, down], "
            f'square_mm, marker_mm and dictionary = "{path.name}"'
        )
    out: TomlTable = {}
    for key in BoardFile.model_fields:
        node = root.getNode(key)
        if node.empty():
            continue
        if node.isSeq():
            out[key] = tuple(int(node.at(i).real()) for i in range(node.size()))
        elif node.isString():
            out[key] = node.string()
        else:
            out[key] = node.real() if key.endswith("_mm") else bool(node.real())
    return out


def _own_dictionary(path: Path) -> Any:
    import cv2

    dictionary = cv2.aruco.Dictionary()
    if not dictionary.readDictionary(_opened(path).root()):
        raise ConfigError(f"{path}: is no dictionary of OpenCV's (nmarkers, markersize, marker_0, ...)")
    return dictionary


def _opened(path: Path) -> Any:
    import cv2

    if not path.is_file():
        raise ConfigError(f"{path}: there is no such file")
    try:
        store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except cv2.error as error:
        raise ConfigError(f"{path}: is no YAML of OpenCV's: {error.err or error}") from None
    if not store.isOpened():
        raise ConfigError(f"{path}: is no YAML of OpenCV's")
    return store
