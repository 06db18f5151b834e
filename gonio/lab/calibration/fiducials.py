"""Printed markers around the holder's aperture: the sheet to print, and their corners in a frame.

Poses of the holder from single frames are biased by some hundredths of a degree, as the squares are small. So the
calibration fits corners themselves, those of all frames at once (`gonio.lab.calibration.geometry`).
"""

import io
from pathlib import Path
from typing import Any

import numpy as np

from gonio import canvas
from gonio.disk import put
from gonio.errors import ConfigError
from gonio.lab.calibration.intrinsics import refine, stretched
from gonio.lab.rig.description import Fiducials
from gonio.lab.rig.fiducials import RIM, cells, centres_mm, corners_mm, dictionary_of
from gonio.typing import Array, Floats, Ints, NDArray

SMALLEST_PX = 24.0
"""Side of a marker in the frame, at its shortest: below 3 pixels a cell the window of a corner holds its neighbours,
and corners lie up to 1.5 px off."""
FAR = 4.0
FEWEST = 8
"""Corners, of two markers, are too few: a plane has eight unknowns, and some must be left to tell errors."""
EDGE = (0.12, 0.88)
"""Which part of an edge is used: at its ends the other edges come in."""
EDGE_CELLS, EDGE_SAMPLES, PLATEAU = 0.7, 12, 3
"""How far across an edge brightness is read, in cells: the black border is one wide. Samples to each side, and how many
of them at the ends are surely black or white."""
MOST_ACROSS_PX = 5.0
PARALLEL = 0.2
"""Sine of the angle between two edges below which they do not meet well."""
DPI = 600
MARGIN_MM = 5.0


def print_sheet(marks: Fiducials, aperture_mm: float, file: Path) -> None:
    """Write the sheet of a holder's markers, to be printed at 100 %, cut along the thin circle and glued on.

    Parameters
    ----------
    marks
        From the rig file, `[holder.fiducials]`.
    aperture_mm
        Diameter of the hole in the middle.
    file
        Ends with .svg (in millimetres) or .png (600 pixels an inch).

    Raises
    ------
    ConfigError
        Another ending, or a dictionary without so many markers.
    DataError
        It cannot be written.
    """
    half = marks.ring_mm + (0.5 + RIM) * marks.marker_mm * 1.5 + MARGIN_MM
    suffix = file.suffix.lower()
    if suffix == ".svg":
        data = _svg(marks, aperture_mm, half).encode()
    elif suffix == ".png":
        data = _png(marks, aperture_mm, half)
    else:
        raise ConfigError(f"{file}: a sheet of markers is written as .svg or .png")
    put(file, data)


def _svg(marks: Fiducials, aperture_mm: float, half: float) -> str:
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * half:g}mm" height="{2 * half:g}mm" '
        f'viewBox="{-half:g} {-half:g} {2 * half:g} {2 * half:g}">',
        f'<rect x="{-half:g}" y="{-half:g}" width="{2 * half:g}" height="{2 * half:g}" fill="white"/>',
    ]
    pattern = cells(marks.dictionary, marks.first_id, marks.count)
    side = marks.marker_mm / pattern.shape[1]
    for (cx, cy), one in zip(centres_mm(marks), pattern, strict=True):
        left, top = cx - 0.5 * marks.marker_mm, -cy - 0.5 * marks.marker_mm  # an svg's y runs down
        out.append(f'<rect x="{left:.4f}" y="{top:.4f}" width="{marks.marker_mm:g}" height="{marks.marker_mm:g}"/>')
        out += [
            f'<rect x="{left + j * side:.4f}" y="{top + i * side:.4f}" width="{side:.4f}" height="{side:.4f}" '
            'fill="white"/>'
            for i, j in np.argwhere(one)
        ]
    ruler = half - 0.4 * MARGIN_MM
    out += [
        f'<circle r="{aperture_mm / 2:g}" fill="none" stroke="black" stroke-width="0.1"/>',
        f'<path d="M -10 {ruler:g} H 10" stroke="black" stroke-width="0.2"/>',
        f'<text x="0" y="{ruler - 0.5:g}" font-size="2.2" text-anchor="middle">20 mm - measure it: print at 100 % - '
        "the first marker lies on the sample's x axis (right)</text>",
        "</svg>",
    ]
    return "\n".join(out) + "\n"


def _png(marks: Fiducials, aperture_mm: float, half: float) -> bytes:
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    inches = 2 * half / 25.4
    figure = Figure(figsize=(inches, inches))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    pattern = cells(marks.dictionary, marks.first_id, marks.count)
    for (cx, cy), one in zip(centres_mm(marks), pattern, strict=True):
        h = 0.5 * marks.marker_mm
        axes.imshow(one, cmap="gray", vmin=0, vmax=1, extent=(cx - h, cx + h, cy - h, cy + h), interpolation="nearest")
    axes.add_patch(Circle((0, 0), aperture_mm / 2, fill=False, lw=0.3))
    axes.plot([-10, 10], [0.4 * MARGIN_MM - half] * 2, "k-", lw=0.6)
    axes.text(0, 0.5 + 0.4 * MARGIN_MM - half, "20 mm", ha="center", va="bottom", fontsize=6)
    axes.set(xlim=(-half, half), ylim=(-half, half))
    axes.axis("off")
    drawn = io.BytesIO()
    canvas.save(figure, drawn, format="png", dpi=DPI)
    return drawn.getvalue()


def detect(frame: Array, marks: Fiducials) -> tuple[Ints, Floats]:
    """The corners of markers in a frame.

    Returns
    -------
    numbers
        Which of the corners of `corners_mm(marks).reshape(-1, 2)`, shape (n,).
    pixels
        Column and row of each, the middle of the first pixel at (0, 0), shape (n, 2).

    Notes
    -----
    Corners are where straight lines along the four edges of the black square meet. OpenCV's refinement of single
    corners is off by up to 0.2 px where one corner of a square stands alone and its edges lie oblique to the pixels;
    OpenCV only says where to look. Markers that look smaller than `SMALLEST_PX`, or stand at the edge of the frame, are
    left out.
    """
    import cv2

    grey, plain = stretched(frame), np.asarray(frame, np.float32)
    settings = cv2.aruco.DetectorParameters()
    settings.adaptiveThreshWinSizeMax = 53
    settings.minMarkerPerimeterRate = 0.02
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(marks.dictionary), settings).detectMarkers(grey)
    numbers: list[int] = []
    pixels: list[Floats] = []
    n = dictionary_of(marks.dictionary).markerSize + 2
    for number, corners in zip(np.ravel(ids) if ids is not None else (), found, strict=True):
        k = int(number) - marks.first_id
        square = np.asarray(corners, float).reshape(4, 2)
        shortest = float(np.linalg.norm(square - np.roll(square, 1, axis=0), axis=1).min())
        half = max(1, min(5, round(0.9 * shortest / n)))
        room = np.minimum(square.min(0), np.array(grey.shape[::-1]) - 1 - square.max(0)).min()
        if not 0 <= k < marks.count or shortest < SMALLEST_PX or room < half + 2:
            continue
        refined = _edges_meet(plain, _edges_meet(plain, refine(grey, square, half), n), n)
        if not np.abs(refined - square).max() <= 0.25 * shortest:
            continue
        numbers += range(4 * k, 4 * k + 4)
        pixels.append(refined)
    return np.array(numbers, np.intp), np.concatenate(pixels) if pixels else np.zeros((0, 2))


def _edges_meet(frame: NDArray[np.float32], square: Floats, n: int) -> Floats:
    """The corners of a black square on white, `n` cells wide, from about where they are; NaN where edges are not seen.

    Across each edge brightness rises from black to white within a pixel or two. The area under the rise says where the
    edge is, however it lies to the pixels: a pixel's value is a mean over its area.
    """
    import cv2

    after = np.roll(square, -1, axis=0)
    along = after - square
    length = np.linalg.norm(along, axis=1)
    if not np.isfinite(length).all() or length.min() <= 0.0:
        return np.full((4, 2), np.nan)
    along = along / length[:, None]
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    if np.sum((square - square.mean(axis=0)) * outward) < 0.0:
        outward = -outward
    x, y = square.T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    places = np.linspace(*EDGE, max(int(length.max()), 8))
    lines = []
    for k in range(4):
        half = min(EDGE_CELLS * area / (length[k] * n), MOST_ACROSS_PX)  # of a cell, across the edge
        across = np.linspace(-half, half, 2 * EDGE_SAMPLES + 1)
        on_edge = square[k] + places[:, None] * (after[k] - square[k])
        at = (on_edge[:, None, :] + across[None, :, None] * outward[k]).astype(np.float32)
        rise = cv2.remap(frame, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        black, white = rise[:, :PLATEAU].mean(), rise[:, -PLATEAU:].mean()
        if white <= black:
            return np.full((4, 2), np.nan)
        share = np.trapezoid((rise - black) / (white - black), across, axis=1)
        edge = on_edge + (half - share)[:, None] * outward[k]
        middle = edge.mean(axis=0)
        lines.append((middle, np.linalg.svd(edge - middle)[2][0]))
    out = []
    for k in range(4):  # corner k: where the edge that ends there meets the one that begins
        (a, d), (b, e) = lines[k - 1], lines[k]
        turn = d[0] * e[1] - d[1] * e[0]
        if abs(turn) < PARALLEL:
            return np.full((4, 2), np.nan)
        out.append(a + d * ((b[0] - a[0]) * e[1] - (b[1] - a[1]) * e[0]) / turn)
    return np.array(out)


def consistent(marks: Fiducials, numbers: Ints, pixels: Floats) -> tuple[Ints, Floats, float]:
    """The corners that lie as on one plane, and how far they scatter about it [px]; none of less than three markers.

    Corners that a shadow, a reflection or a neighbour has moved are left out, `FAR` standard deviations off the rest.
    """
    import cv2

    nothing = numbers[:0], pixels[:0], 0.0
    flat = corners_mm(marks).reshape(-1, 2)
    for _ in range(5):
        if len(numbers) <= FEWEST:
            return nothing
        plane, _ = cv2.findHomography(flat[numbers], pixels, 0)
        if plane is None:
            return nothing
        off = np.linalg.norm(_off_plane(marks, plane, numbers, pixels), axis=1)
        good = off <= FAR * max(float(np.sqrt(np.median(off**2) / (2.0 * np.log(2.0)))), 0.02)
        if good.all():
            return numbers, pixels, float(np.sqrt(np.sum(off**2) / (2 * len(numbers) - 9)))
        numbers, pixels = numbers[good], pixels[good]
    return nothing


def _off_plane(marks: Fiducials, plane: Any, numbers: Ints, pixels: Floats) -> Floats:
    """Corners less their places on a plane, and less the mean shift outward from their markers that ink makes."""
    import cv2

    there = cv2.perspectiveTransform(corners_mm(marks).reshape(1, -1, 2), plane)[0]
    outward = (there.reshape(-1, 4, 2) - there.reshape(-1, 4, 2).mean(axis=1, keepdims=True)).reshape(-1, 2)[numbers]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    off = pixels - there[numbers]
    return np.asarray(off - np.mean(np.sum(off * outward, axis=1)) * outward)


def middle(marks: Fiducials, numbers: Ints, pixels: Floats) -> Floats:
    """Where the centre of the markers' circle is in the frame [px], from corners that are `consistent`."""
    import cv2

    plane, _ = cv2.findHomography(corners_mm(marks).reshape(-1, 2)[numbers], pixels, 0)
    return np.asarray(cv2.perspectiveTransform(np.zeros((1, 1, 2)), plane)[0, 0])


def on_plane(marks: Fiducials, numbers: Ints, pixels: Floats, size: tuple[int, int]) -> Floats:
    """How far from the centre each pixel looks at the markers' plane [mm], for a frame of `size` rows and columns."""
    import cv2

    plane, _ = cv2.findHomography(pixels, corners_mm(marks).reshape(-1, 2)[numbers], 0)
    rows, columns = np.indices(size)
    spots = cv2.perspectiveTransform(np.stack([columns, rows], axis=-1).reshape(1, -1, 2).astype(float), plane)[0]
    return np.asarray(np.hypot(*spots.T).reshape(size))
