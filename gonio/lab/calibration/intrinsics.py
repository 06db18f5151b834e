"""Camera intrinsics from pictures of a ChArUco board: focal length, principal point, distortion, with covariance.

The lens is a pinhole with square pixels and the distortion of Brown and Conrady as OpenCV writes it: with x, y the
tangents of the direction of a point, r^2 = x^2 + y^2,

    x' = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)        column = f x' + c_x
    y' = y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y        row    = f y' + c_y

f, c_x, c_y in pixels, the middle of the first pixel at (0, 0). Corners are refined to parts of a pixel and fitted
all together; a corner that lies further than `FAR` standard deviations from the fit is left out, and counted.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError, GonioError
from gonio.lab.calibration.board import BoardFile
from gonio.lab.rig.fiducials import dictionary_of
from gonio.typing import Array, Figure, Floats, NDArray

Grey = NDArray[np.uint8]

NAMES = ("f", "c_x", "c_y", "k1", "k2", "p1", "p2")
FEWEST_IMAGES = 3
FEWEST_CORNERS = 6
"""Fewest corners of a picture: a homography's eight unknowns need four, and none would be left to tell an error."""
FAR = 4.0
MOST_REJECTED = 0.1
"""Largest part of all corners that may be left out. Where more are far off, it is not single corners that are wrong."""
ALIKE_DEG = 2.0
"""The normals of some two boards lie further apart than this: copies of one picture are none more."""
RATIO = 0.05
"""Of the marker's side to the square's, as the markers' own corners show it: half a pixel in ten."""
LOOSE = 0.1
"""A focal length with a larger relative uncertainty is none."""
LARGEST_RMS = 1.0
"""Largest rms that the fit leaves [px]. Ten times what corners scatter in sharp pictures: another board, or blur."""
ORIGINS = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_36h11",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """What pictures of a board say of the camera."""

    size: tuple[int, int]
    """Columns and rows of the pictures."""
    values: dict[str, float]
    """By `NAMES`; f, c_x, c_y in pixels."""
    covariance: Floats
    """In the order of `NAMES`."""
    rms_px: float
    """Distance between corner and fit, root mean square over the corners that were used."""
    corners: int
    rejected: int
    images: tuple[str, ...]
    rms_by_image_px: tuple[float, ...]
    poses: Floats
    """Shape (images, 6): rotation vector and translation [mm] from board to camera."""
    residuals_px: Floats
    """Shape (corners, 2): corner minus fit."""
    points_px: Floats
    """Shape (corners, 2)."""
    without_one: Floats
    """Standard uncertainties from leaving out one picture after the other (jackknife), in the order of `NAMES`."""


def _seen(
    files: Sequence[Path], board: BoardFile, dictionary: Any, size: tuple[int, int] | None
) -> tuple[list[tuple[Path, Floats, Floats, Floats]], tuple[int, int]]:
    """The pictures that show the board, with its corners on the board and in the picture; and their common size."""
    views, empty = [], []
    for file in files:
        grey = read_grey(file)
        here = (grey.shape[1], grey.shape[0])
        if size is not None and here != size:
            raise DataError(
                f"{file}: has {here[0]} x {here[1]} pixels, and {size[0]} x {size[1]} are needed (camera.width, "
                "camera.height of the rig file, and all pictures alike)"
            )
        size = here
        found = _corners(grey, board, dictionary, file)
        if found is None:
            empty.append(file)
        else:
            views.append((file, *found))
    if not files or size is None:
        raise DataError("there are no pictures")
    if not views:
        raise DataError(f"{files[0]}: {_why_no_board(read_grey(files[0]), board)}; nor has any other picture")
    if len(views) < FEWEST_IMAGES:
        without = f"; {', '.join(f.name for f in empty)} show none" if empty else ""
        raise DataError(
            f"{len(views)} pictures show the board ({FEWEST_CORNERS} corners or more), and {FEWEST_IMAGES} are needed"
            f"{without}"
        )
    return views, size


def calibrate(files: Sequence[Path], board: BoardFile, dictionary: Any, size: tuple[int, int] | None) -> Intrinsics:
    """Intrinsics from pictures.

    Parameters
    ----------
    files
        Pictures, at least `FEWEST_IMAGES` of which show the board.
    board, dictionary
        From `read_board`.
    size
        Columns and rows that they must have; None where they need only have one size.

    Raises
    ------
    DataError
        A file cannot be read, or has another size; too few show the board; the board is another one than stated; the
        poses are too much alike; too many corners are wrong.
    """
    views, size = _seen(files, board, dictionary, size)
    _require_ratio(views, board)
    fit = _Fit([v[1] for v in views], [v[2] for v in views], size)
    fit.robust()
    apart = _apart_deg(fit.poses)
    if apart < ALIKE_DEG:
        raise DataError(
            f"the boards of all pictures lie within {apart:.1f} deg of each other: focal length and distance cannot be "
            f"told apart. Tilt the board by 20 to 45 deg, to different sides ({ALIKE_DEG:g} deg is the least)"
        )
    rms = _rms(fit.left())
    if rms > LARGEST_RMS:
        raise DataError(
            f"corners lie {rms:.1f} px (rms) off a pinhole with distortion; {LARGEST_RMS:g} px is the most: is the "
            f"board flat, sharp, and one of {board.squares[0]} x {board.squares[1]} squares?"
        )
    total = sum(len(v[2]) for v in views)
    rejected = total - int(sum(map(np.count_nonzero, fit.used)))
    if rejected > MOST_REJECTED * total:
        raise DataError(
            f"{rejected} of {total} corners are far off the fit: the pictures are not of one sharp, flat board"
        )
    covariance = fit.covariance()
    if not np.isfinite(covariance).all() or covariance[0, 0] > (LOOSE * fit.x[0]) ** 2:
        raise DataError(
            "the pictures do not determine the focal length "
            f"({fit.x[0]:.0f} px, u = {math.sqrt(max(covariance[0, 0], 0.0)):.0f} px): the poses are too much alike"
        )
    jackknife = fit.jackknife()
    # a bent board, or blur, moves the corners of one picture together: then the pictures are what is independent
    wider = np.maximum(1.0, jackknife / np.sqrt(np.diag(covariance)))
    return Intrinsics(
        size=size,
        values=dict(zip(NAMES, map(float, fit.x[: len(NAMES)]), strict=True)),
        covariance=covariance * np.outer(wider, wider),
        rms_px=rms, corners=total - rejected, rejected=rejected,
        images=tuple(v[0].name for v in views), rms_by_image_px=tuple(fit.rms_by_image()),
        poses=fit.poses, residuals_px=fit.left(),
        points_px=np.concatenate([v[2][used] for v, used in zip(views, fit.used, strict=True)]),
        without_one=jackknife,
    )  # fmt: skip


def read_grey(file: Path) -> Grey:
    """A picture as 8 bits of grey; raw values are stretched to the brightest thousandth.

    Raises
    ------
    DataError
        The file cannot be read as a picture.
    """
    import cv2

    try:
        if file.suffix.lower() == ".dng":
            from gonio.lab.rig import dng

            picture: Array | None = np.asarray(dng.read_raw(file).mosaic)
        else:
            picture = cv2.imdecode(
                np.frombuffer(file.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
            )
    except (OSError, GonioError, cv2.error) as error:
        raise DataError(f"{file}: cannot be read as a picture: {getattr(error, 'strerror', None) or error}") from None
    if picture is None:
        raise DataError(f"{file}: cannot be read as a picture")
    return stretched(picture)


def stretched(picture: Array) -> Grey:
    """Grey values in 8 bits, as what finds markers wants them; those with 8 bits stay as they are."""
    if picture.dtype == np.uint8:
        return picture
    low, high = np.percentile(picture, (0.1, 99.9))
    scaled = (picture.astype(np.float32) - low) * (255.0 / max(high - low, 1.0))
    return np.asarray(np.clip(scaled, 0.0, 255.0).astype(np.uint8))


# ---- corners ----


def _corners(grey: Grey, board: BoardFile, dictionary: Any, file: Path) -> tuple[Floats, Floats, Floats] | None:
    """Corners on the board [mm] (n, 3), in the picture [px] (n, 2), and the ratio of marker and square that it shows;
    None where too few are seen."""
    import cv2

    made = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, dictionary)
    made.setLegacyPattern(board.legacy_pattern)
    markers, ids, _ = cv2.aruco.ArucoDetector(dictionary, cv2.aruco.DetectorParameters()).detectMarkers(grey)
    if ids is None or len(ids) < 2:
        return None
    ratio = _marker_ratio(made, board, [refine(grey, np.asarray(m), 2) for m in markers], ids, file)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(made).detectBoard(grey)
    if corners is None or len(corners) < FEWEST_CORNERS:
        return None
    pixels = corners.reshape(-1, 2).astype(np.float32)
    on_board = np.asarray(made.getChessboardCorners(), float).reshape(-1, 3)[np.ravel(numbers)]
    if np.linalg.matrix_rank(on_board[:, :2] - on_board[:, :2].mean(0), tol=1e-6) < 2:
        return None
    return on_board, refine(grey, pixels, _half_window(pixels, on_board, board.square_mm)), np.array([ratio])


def refine(grey: Grey, corners: Array, half: int) -> Floats:
    """Corners of black and white to parts of a pixel: where gradients meet in a window of 2 `half` + 1 pixels."""
    import cv2

    shaped = np.ascontiguousarray(corners.reshape(-1, 1, 2), np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-3)
    return np.asarray(cv2.cornerSubPix(grey, shaped, (half, half), (-1, -1), stop), float).reshape(-1, 2)


def _half_window(pixels: Array, on_board: Floats, square_mm: float) -> int:
    """Half the side [px] of the window around a corner: a fifth of the shortest square in view, without a neighbour."""
    apart = np.linalg.norm(on_board[:, None] - on_board[None], axis=-1)
    pairs = np.argwhere(np.triu(np.abs(apart - square_mm) < 1e-6 * square_mm))
    if not len(pairs):
        return 3
    shortest = min(float(np.linalg.norm(pixels[i] - pixels[j])) for i, j in pairs)
    return max(2, min(11, int(shortest / 5.0)))


def _marker_ratio(made: Any, board: BoardFile, markers: Any, ids: Any, file: Path) -> float:
    """Marker over square as seen: from the markers' centres, which only the squares move, and their own corners."""
    import cv2

    known = {int(i): np.asarray(c, float).reshape(4, 3)[:, :2] for i, c in
             zip(np.ravel(made.getIds()), made.getObjPoints(), strict=True)}  # fmt: skip
    seen = [(int(i), np.asarray(c, float).reshape(4, 2)) for i, c in zip(np.ravel(ids), markers, strict=True)]
    strange = [i for i, _ in seen if i not in known]
    mine = [(i, c) for i, c in seen if i in known]
    said = f"the board is not one of {board.squares[0]} x {board.squares[1]} squares with {board.dictionary}"
    if len(strange) > len(mine):
        raise DataError(f"{file}: shows markers {', '.join(map(str, strange[:5]))}, which it does not have: {said}")
    if len(mine) < 5:
        return math.nan
    centres = np.array([c.mean(0) for _, c in mine])
    ideal = np.array([known[i].mean(0) for i, _ in mine])
    homography, inside = cv2.findHomography(ideal, centres, cv2.RANSAC, 0.1 * _side(mine))
    if homography is None or np.count_nonzero(inside) < 0.7 * len(mine):
        raise DataError(f"{file}: its markers do not lie as they should: {said}")
    back = np.linalg.inv(homography)
    sides = []
    for (_, corners), good in zip(mine, np.ravel(inside), strict=True):
        if good:
            flat = cv2.perspectiveTransform(corners[None], back)[0]
            sides.append(float(np.mean(np.linalg.norm(flat - np.roll(flat, 1, axis=0), axis=1))))
    return float(np.median(sides)) / board.square_mm


def _side(markers: list[tuple[int, Floats]]) -> float:
    return float(np.median([np.linalg.norm(c[0] - c[1]) for _, c in markers]))


def _require_ratio(views: list[tuple[Any, ...]], board: BoardFile) -> None:
    seen = [float(v[3][0]) for v in views if math.isfinite(v[3][0])]
    if not seen:
        return
    ratio, stated = float(np.median(seen)), board.marker_mm / board.square_mm
    if abs(ratio / stated - 1.0) > RATIO:
        raise DataError(
            f"marker_mm / square_mm = {stated:.3f} in the board's file, and the pictures show {ratio:.3f} "
            f"(marker_mm = {ratio * board.square_mm:.3g} with square_mm = {board.square_mm:g}): another board"
        )


def _why_no_board(grey: Grey, board: BoardFile) -> str:
    """What else is seen, where the board is not."""
    import cv2

    best, most = "", 0
    for name in ORIGINS:
        finder = cv2.aruco.ArucoDetector(dictionary_of(name), cv2.aruco.DetectorParameters())
        ids = finder.detectMarkers(grey)[1]
        if ids is not None and len(ids) > max(most, 3):
            best, most = name, len(ids)
    if best and best.rsplit("_", 1)[0] not in board.dictionary:
        return f"shows {most} markers of {best}, and none of {board.dictionary}: another board than stated"
    return f"shows no board of {board.squares[0]} x {board.squares[1]} squares with markers of {board.dictionary}"


# ---- fit ----


class _Fit:
    """Intrinsics and the pose of every picture, fitted to all corners at once."""

    def __init__(self, on_board: list[Floats], pixels: list[Floats], size: tuple[int, int]) -> None:
        import cv2

        self.on_board, self.pixels = on_board, pixels
        self.used = [np.ones(len(p), bool) for p in pixels]
        start = np.array([[float(max(size)), 0, 0.5 * (size[0] - 1)], [0, float(max(size)), 0.5 * (size[1] - 1)],
                          [0, 0, 1]])  # fmt: skip
        flags = cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST
        flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_PRINCIPAL_POINT
        objects = [np.asarray(p, np.float32).reshape(-1, 1, 3) for p in on_board]
        seen = [np.asarray(p, np.float32).reshape(-1, 1, 2) for p in pixels]
        try:
            _, matrix, _, turns, shifts = cv2.calibrateCamera(objects, seen, size, start, np.zeros(5), flags=flags)
        except cv2.error as error:
            raise DataError(f"the corners fit no camera: {error.err or error}") from None
        poses = [np.concatenate([np.ravel(r), np.ravel(t)]) for r, t in zip(turns, shifts, strict=True)]
        self.x = np.concatenate([[matrix[0, 0], matrix[0, 2], matrix[1, 2], 0, 0, 0, 0], *poses])

    def _without(self, k: int) -> "_Fit":
        """A fit that starts from this one, without a picture."""
        rest = [i for i in range(len(self.pixels)) if i != k]
        one = object.__new__(_Fit)
        one.on_board, one.pixels, one.used = ([of[i] for i in rest] for of in (self.on_board, self.pixels, self.used))
        one.x = np.concatenate([self.x[: len(NAMES)], self.poses[rest].ravel()])
        return one

    @property
    def poses(self) -> Floats:
        """(images, 6)."""
        return self.x[len(NAMES) :].reshape(-1, 6)

    def robust(self) -> None:
        """Fit, leave out single corners that are far off, and again, until none is."""
        for _ in range(10):
            self.solve()
            off = [np.linalg.norm(r, axis=1) for r in self._all_left(self.x)]
            kept = np.concatenate([o[u] for o, u in zip(off, self.used, strict=True)])
            sigma = math.sqrt(float(np.median(kept**2)) / (2.0 * math.log(2.0)))  # of a Rayleigh distribution
            used = [o <= FAR * max(sigma, 1e-3) for o in off]
            if all(np.array_equal(a, b) for a, b in zip(used, self.used, strict=True)):
                return
            if any(np.count_nonzero(u) < FEWEST_CORNERS for u in used):
                return  # a whole picture is off: what is left tells it
            self.used = used

    def solve(self) -> None:
        from scipy.optimize import least_squares

        self.x = least_squares(self._residuals, self.x, self._jacobian, x_scale="jac", method="lm").x

    def _project(self, x: Floats, k: int) -> tuple[Floats, Floats]:
        import cv2

        f, c_x, c_y, k1, k2, p1, p2 = x[: len(NAMES)]
        pose = x[len(NAMES) + 6 * k : len(NAMES) + 6 * k + 6]
        matrix = np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1]])
        points, slopes = cv2.projectPoints(
            self.on_board[k].reshape(-1, 1, 3), pose[:3], pose[3:], matrix, np.array([k1, k2, p1, p2])
        )
        return np.asarray(points, float).reshape(-1, 2), np.asarray(slopes, float)

    def _all_left(self, x: Floats) -> list[Floats]:
        return [self.pixels[k] - self._project(x, k)[0] for k in range(len(self.pixels))]

    def _used_left(self, x: Floats) -> list[Floats]:
        return [r[u] for r, u in zip(self._all_left(x), self.used, strict=True)]

    def left(self) -> Floats:
        """Corner minus fit of all that are used (n, 2)."""
        return np.concatenate(self._used_left(self.x))

    def _residuals(self, x: Floats) -> Floats:
        return np.concatenate(self._used_left(x)).ravel()

    def _jacobian(self, x: Floats) -> Floats:
        rows = []
        for k, used in enumerate(self.used):
            slopes = self._project(x, k)[1].reshape(-1, 2, 14)[used].reshape(-1, 14)
            row = np.zeros((len(slopes), len(x)))
            row[:, 0] = slopes[:, 6] + slopes[:, 7]
            row[:, 1:7] = slopes[:, 8:14]
            first = len(NAMES) + 6 * k
            row[:, first : first + 6] = slopes[:, :6]
            rows.append(-row)
        return np.concatenate(rows)

    def rms_by_image(self) -> list[float]:
        """Root mean square of the distances [px], picture by picture."""
        return [_rms(left) for left in self._used_left(self.x)]

    def covariance(self) -> Floats:
        """Covariance of the intrinsics: the poses are taken along. The scatter is what the fit leaves."""
        jacobian, residuals = self._jacobian(self.x), self._residuals(self.x)
        scale = np.sqrt(np.sum(jacobian**2, axis=0))
        freedom = max(len(residuals) - len(self.x), 1)
        inverse = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale), rcond=1e-14) / np.outer(scale, scale)
        return np.asarray(inverse[: len(NAMES), : len(NAMES)] * float(residuals @ residuals) / freedom)

    def jackknife(self) -> Floats:
        """Standard uncertainties from leaving out each picture in turn."""
        count = len(self.pixels)
        if count <= FEWEST_IMAGES:
            return np.full(len(NAMES), 0.0)
        found = []
        for k in range(count):
            one = self._without(k)
            one.solve()
            found.append(one.x[: len(NAMES)])
        return np.asarray(np.sqrt((count - 1.0) * np.var(found, axis=0)))


def _rms(left: Floats) -> float:
    return math.sqrt(float(np.mean(np.sum(left**2, axis=1))))


def _apart_deg(poses: Floats) -> float:
    """The largest angle between the normals of two boards, as the camera sees them."""
    import cv2

    normals = np.array([cv2.Rodrigues(p[:3])[0][:, 2] for p in poses])
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))


def draw(found: Intrinsics) -> Figure:
    """What the fit leaves at every corner, a hundred times enlarged."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.add_subplot()
    (x, y), (dx, dy) = found.points_px.T, found.residuals_px.T
    axes.quiver(x, y, dx, dy, angles="xy", scale_units="xy", scale=0.01, width=0.003)
    axes.plot(x, y, ".", ms=3)
    axes.set(
        xlim=(0, found.size[0]), ylim=(found.size[1], 0), aspect="equal", xlabel="column [px]", ylabel="row [px]",
        title=f"corner - fit, times 100; rms {found.rms_px:.3f} px of {found.corners} corners",
    )  # fmt: skip
    return figure
