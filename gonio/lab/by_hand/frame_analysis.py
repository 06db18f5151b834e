"""What raw frames tell a person who aligns: focus, histogram, saturation, exposure, noise, and where the light lies.

Signals are linear, in DN above the black level. Places are columns and rows of the frame (fractional; pixel k reaches
from k - 1/2 to k + 1/2). Nothing of a device is in here.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gonio.lab.acquisition import exposure
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import Channel
from gonio.lab.rig.light_and_camera import Camera, deviation_dn, linear_dn
from gonio.lab.rig.regions import Roi
from gonio.typing import Array, Bools, NDArray

Floats32 = NDArray[np.float32]
Box = tuple[slice, slice]
"""Rows and columns."""

SEEN = 5.0
"""Standard deviations from which on a quantity counts as seen."""
STEADY = 0.2
"""Two frames of one scene differ by less than this in their mean, relative; beyond, something was changed."""
CORRELATED = 3.0
"""How many pixels share the noise of a Sobel gradient: the scatter of simulated frames needs 2.2 to 3."""
SOBEL = 0.375
"""What independent pixels of unit variance give: 2 (1 + 4 + 1) 2 / 64 for the two gradients in eighths."""
OF_PIXELS = 0.5
"""How well, relative, the rig file knows the square of its pixels' differences."""
FEW = 0.01
"""Saturated pixels of a region, beyond which its noise is not determined."""
USABLE = 0.5
"""Largest part of a region that may be saturated: with more it has no focus measure."""
WIDEST = 1024
"""The spot is looked for in a picture that is not wider than this; larger frames are averaged down."""
SMOOTH_PX = 1.0
"""Standard deviation of the smoothing before the search for a spot, in pixels of that picture."""
HALF = 0.5
"""The outline of a spot lies where the light has half of its height over the background."""
CONTRAST = 0.5
"""A spot is brighter than its surroundings by this share of its peak; otherwise the light fills the frame."""
SMALLEST = 6
"""Pixels of a spot, at least."""
OTHERS = 0.1
"""A second bright place is told of where it has this share of the spot's light."""
CORNERS = 96
"""Corners of the polygon that outlines a spot, at most, about."""
BINS = 64


def signal(camera: Camera, frame: Frame, pixels: Array | None = None) -> Floats32:
    """The linear signal above the black level [DN] of some pixels of a frame's mosaic; without them, of all."""
    values = frame.mosaic if pixels is None else pixels
    return np.asarray(linear_dn(camera, values), dtype=np.float32) - np.float32(frame.black_level_dn)


def saturated(camera: Camera, frame: Frame, pixels: Array | None = None) -> Bools:
    """Which pixels lie above `exposure.SATURATED` of full scale."""
    values = frame.mosaic if pixels is None else pixels
    top = frame.black_level_dn + exposure.SATURATED * exposure.full_scale_dn(camera, frame)
    return np.asarray(linear_dn(camera, values) >= top)


def cells(pattern: str, image: NDArray[np.float32]) -> Floats32:
    """The mean of each cell of a mosaic, so that its colours are no structure; the image itself without a mosaic."""
    if pattern == "mono":
        return image
    height, width = (size // 2 * 2 for size in image.shape)
    cut = image[:height, :width]
    return np.asarray(0.25 * (cut[::2, ::2] + cut[1::2, ::2] + cut[::2, 1::2] + cut[1::2, 1::2]), np.float32)


# ---- focus and noise, from two frames of one scene ----


@dataclass(frozen=True, slots=True)
class Focus:
    """How sharp a region is."""

    value: float | None
    """Root mean square of the relative gradient, per pixel; None where no structure stands out of the noise."""
    u: float
    """Its standard uncertainty from noise; without a value, what structure could be hidden in the noise."""
    why: str = ""
    """Why there is no value."""


def focus(camera: Camera, first: Frame, second: Frame, box: Box) -> Focus | None:
    """The sharpness of a region in two frames of one scene; None where they do not show the same scene.

    It is Tenengrad (the squared Sobel gradient, averaged), made of the product of the gradients of two frames, so that
    noise, which is different in each, cancels in the mean instead of being taken for structure. Divided by the product
    of the means it is the same at all exposures that do not saturate. What the pixels' own differences make of an even
    light (`camera.prnu`, `camera.dsnu_e`) is taken off. Its root is shown.

    Parameters
    ----------
    camera
        Its pattern and full scale.
    first, second
        Frames of the same pose under the same light; their exposures may differ a little.
    box
        Rows and columns that are looked at.

    References
    ----------
    E. Krotkov, "Focusing", Int. J. Computer Vision 1, 223-237 (1987); the product of two frames is ours.
    """
    images, usable = [], np.ones(0, dtype=bool)
    rows, cols = _whole_cells(box[0], camera), _whole_cells(box[1], camera)
    for frame in (first, second):
        images.append(cells(frame.pattern, np.ascontiguousarray(signal(camera, frame, frame.mosaic[rows, cols]))))
        bad = cells(frame.pattern, saturated(camera, frame, frame.mosaic[rows, cols]).astype(np.float32)) > 0
        good = cv2.erode((~bad).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        usable = good if not usable.size else usable & good
    usable[[0, -1], :] = usable[:, [0, -1]] = False  # no gradient is known there
    count = int(np.count_nonzero(usable))
    if count < USABLE * usable.size:
        return Focus(None, math.nan, "saturated: shorten the exposure")
    means = [float(image[usable].mean()) for image in images]
    noise = float(np.std((images[0] - images[1])[usable])) / math.sqrt(2.0 * count)
    if min(means) < SEEN * noise or min(means) <= 0.0:
        return Focus(None, math.nan, "too dark: no light in the region")
    if abs(means[1] / means[0] * first.exposure_s / second.exposure_s - 1.0) > STEADY:
        return None
    slopes = [
        [cv2.Sobel(image / mean, cv2.CV_32F, *order, ksize=3, scale=0.125)[usable] for order in ((1, 0), (0, 1))]
        for image, mean in zip(images, means, strict=True)
    ]
    product = float(sum(np.mean(a * b) for a, b in zip(*slopes, strict=True)))
    between = 0.5 * float(sum(np.mean((a - b) ** 2) for a, b in zip(*slopes, strict=True)))
    # of a sum of two products (a + n)(a + n'): variance 2 a^2 s^2 + s^4 each, with s^2 half of `between`
    u_square = math.sqrt((max(product, 0.0) * between + 0.5 * between**2) * CORRELATED / count)
    of_pixels = _slope_of_pixels(camera, min(means))
    product -= of_pixels
    if product < max(SEEN * u_square, OF_PIXELS * of_pixels):
        hidden = math.sqrt(max(product, 0.0) + u_square)
        return Focus(None, hidden, "no structure stands out of the noise and the pixels' own differences")
    value = math.sqrt(product)
    return Focus(value, 0.5 * u_square / value)


def _slope_of_pixels(camera: Camera, mean_dn: float) -> float:
    """The squared relative gradient that differences between pixels make of an even light, by the rig file."""
    apart = camera.prnu**2 + (camera.dsnu_e / camera.electrons_per_dn / mean_dn) ** 2
    return SOBEL * apart / (1.0 if camera.pattern == "mono" else 4.0)  # pixels in a cell


def _whole_cells(span: slice, camera: Camera) -> slice:
    return span if camera.pattern == "mono" else slice(span.start // 2 * 2, (span.stop + 1) // 2 * 2)


def focus_box(camera: Camera, region: Roi | None) -> Box:
    """Where the focus is measured: the region with as much again around it, or the middle third of the frame."""
    if region is None:
        return slice(camera.height // 3, 2 * camera.height // 3), slice(camera.width // 3, 2 * camera.width // 3)
    return _grown(region.rows, camera.height), _grown(region.cols, camera.width)


def _grown(span: slice, size: int) -> slice:
    margin = max((span.stop - span.start) // 2, 8)
    return slice(max(span.start - margin, 0), min(span.stop + margin, size))


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of the pixels of a region in one frame."""

    dn: float
    """Standard deviation of a pixel from frame to frame [DN], at the region's mean signal."""
    expected_dn: float
    """The same by the rig file's numbers of the camera."""
    signal_dn: float
    """Mean signal above the black level [DN]."""
    u_rel: float | None
    """Relative standard uncertainty that noise leaves of the region's mean in one frame; None without a signal."""


def noise(camera: Camera, first: Frame, second: Frame, region: Roi) -> Noise | None:
    """The noise of a region, from the difference of two frames of one scene.

    None where they do not show one scene, or where the region is saturated, which hides the noise.
    """
    a, b = (np.asarray(signal(camera, frame, region.of(frame.mosaic)), dtype=float) for frame in (first, second))
    full = [np.mean(saturated(camera, frame, region.of(frame.mosaic))) for frame in (first, second)]
    if a.size < 2 or max(full) > FEW:
        return None
    means = a.mean() / first.exposure_s, b.mean() / second.exposure_s
    lit = means[1] * second.exposure_s > SEEN * np.std(a - b) / math.sqrt(2.0 * a.size)
    if lit and (means[0] <= 0 or abs(means[1] / means[0] - 1.0) > STEADY):
        return None
    scaled = a * (means[1] / means[0] * second.exposure_s / first.exposure_s) if lit else a
    deviation = float(np.std(scaled - b, ddof=1)) / math.sqrt(2.0)
    level = float(b.mean())
    expected = deviation_dn(camera, level * camera.electrons_per_dn, rounding=camera.quantised)
    u_rel = deviation / math.sqrt(a.size) / level if lit else None
    return Noise(deviation, float(expected), level, u_rel)


# ---- levels ----


def channels(camera: Camera) -> tuple[Channel, ...]:
    """The colours of the mosaic, or "mono"."""
    return ("mono",) if camera.pattern == "mono" else ("R", "G", "B")


@dataclass(frozen=True, slots=True)
class PixelLevels:
    """Levels of the pixels of one colour of a frame."""

    channel: Channel
    counts: tuple[int, ...]
    """Pixels by their value [DN], in `BINS` equal steps from 0 to just above the white level."""
    saturated: int
    """How many pixels are."""
    pixels: int


def levels(camera: Camera, frame: Frame) -> tuple[PixelLevels, ...]:
    """Histograms, and how many pixels are saturated, by colour."""
    height, width = (size // 2 * 2 for size in frame.mosaic.shape)
    out, white = [], int(frame.white_level_dn)
    steps = np.arange(white + 1) * BINS // (white + 1)
    for channel in channels(camera):
        parts = [frame.mosaic] if channel == "mono" else [
            frame.mosaic[k // 2 : height : 2, k % 2 : width : 2]
            for k, colour in enumerate(camera.pattern) if colour == channel
        ]  # fmt: skip
        counts, over, pixels = np.zeros(BINS, dtype=int), 0, sum(part.size for part in parts)
        for part in parts:
            by_value = np.bincount(np.minimum(part, steps.size - 1).ravel(), minlength=steps.size)
            counts += np.bincount(steps, weights=by_value, minlength=BINS).astype(int)
            over += int(np.count_nonzero(saturated(camera, frame, part)))
        out.append(PixelLevels(channel, tuple(int(n) for n in counts), over, pixels))
    return tuple(out)


@dataclass(frozen=True, slots=True)
class Advice:
    """How the exposure fits."""

    level: float
    """Of the brightest used pixel, as a fraction of full scale."""
    target: float
    """What it should be (`acquisition.exposure_target`)."""
    exposure_s: float
    """The exposure that leads there, within the camera's limits; where it cannot be told, a step toward it."""
    text: str
    """For people."""


FITS = 0.1
"""An exposure that is off by less than this, relative, is good."""
DARK = 0.005
"""A level below it says nothing about the exposure that is needed."""


def advice(description: RigDescription, frame: Frame, region: Roi | None) -> Advice:
    """What to do with the exposure, from the brightest pixel of the region (of the frame, where there is none)."""
    camera, target = description.camera, description.acquisition.exposure_target
    pixels = frame.mosaic if region is None else region.of(frame.mosaic)
    brightest = float(signal(camera, frame, pixels.max(keepdims=True)).item())
    level = brightest / exposure.full_scale_dn(camera, frame)
    shortest, longest = camera.exposure_limits_s
    if level >= exposure.SATURATED:
        if frame.exposure_s <= shortest * (1 + 1e-9):
            return Advice(level, target, shortest, "saturated at the shortest exposure: less light is needed")
        wanted = max(frame.exposure_s / exposure.SHORTER, shortest)
        return Advice(level, target, wanted, f"saturated: shorter by {frame.exposure_s / wanted:.2g}x or more")
    factor = target / level if level > DARK else exposure.STEP
    wanted = min(max(frame.exposure_s * factor, shortest), longest)
    reached = wanted / frame.exposure_s
    if abs(factor - 1.0) <= FITS:
        return Advice(level, target, wanted, "good")
    if factor > 1.0 and reached < 1.0 + FITS:
        return Advice(level, target, wanted, f"too dark at the longest exposure, {longest:g} s: more light is needed")
    if factor < 1.0 and reached > 1.0 - FITS:
        return Advice(level, target, wanted, "too bright at the shortest exposure: less light is needed")
    word, by = ("longer", reached) if factor > 1.0 else ("shorter", 1.0 / reached)
    more = " or more: hardly any light" if level <= DARK else ""
    limit = (
        "" if math.isclose(wanted, frame.exposure_s * factor, rel_tol=1e-6) else f", the camera's limit ({wanted:g} s)"
    )
    return Advice(level, target, wanted, f"{word} by {by:.2g}x{more}{limit}")


def noise_of_one(frame: Frame) -> float:
    """Standard deviation of a pixel's noise in one frame [DN], with what rounding adds at least."""
    size = 1 if frame.pattern == "mono" else 2
    planes = [frame.mosaic[row::size, column::size] for row in range(size) for column in range(size)]
    seen = max(_single_frame_noise(np.ascontiguousarray(plane, np.float32)) for plane in planes)
    return max(seen, 1.0 / math.sqrt(12.0))


def is_black(camera: Camera, frame: Frame) -> bool:
    """Whether no light stands out of a frame: neither over all of it, nor in a bright place of a thousandth of it."""
    light = signal(camera, frame)
    median, bright = (float(level) for level in np.percentile(light, (50.0, 99.9)))
    return median < DARK * exposure.full_scale_dn(camera, frame) and bright - median < SEEN * noise_of_one(frame)


# ---- where the light lies ----


@dataclass(frozen=True, slots=True)
class Spot:
    """A bright place with an edge: at half of its height over the background."""

    column: float
    row: float
    """Its centroid, weighted by the light above the level of the outline."""
    major_px: float
    minor_px: float
    """Full lengths of the axes of the ellipse that has the outline's second moments."""
    angle_deg: float
    """Of the major axis, from the columns toward growing rows, -90 to 90."""
    peak_dn: float
    background_dn: float
    cut: bool
    """It reaches the edge of the frame: its centre is that of what is seen."""
    saturated: bool
    """Pixels in it are saturated: its outline is too wide, and its centroid less sure."""
    others: int
    """Other bright places, with a tenth of its light or more."""
    outline: tuple[tuple[float, float], ...]
    """Columns and rows of its corners."""


def spot(camera: Camera, frame: Frame) -> tuple[Spot | None, str]:
    """The brightest spot of a frame, and what is to be said of it; None, and why, where there is none.

    The picture (cells of a mosaic averaged) is freed of single bright pixels by a median, and smoothed. Background is
    its 5th percentile. The spot is the place with the most light above half of the height of its peak.
    """
    image = cells(frame.pattern, signal(camera, frame))
    scale = 1.0 if frame.pattern == "mono" else 2.0
    shrink = math.ceil(image.shape[1] / WIDEST)
    if shrink > 1:
        height, width = (size // shrink * shrink for size in image.shape)
        image = cv2.resize(
            image[:height, :width], (width // shrink, height // shrink), interpolation=cv2.INTER_AREA
        ).astype(np.float32)
        scale *= shrink
    smooth = cv2.GaussianBlur(cv2.medianBlur(np.ascontiguousarray(image), 3), (0, 0), SMOOTH_PX)
    background, peak = float(np.percentile(smooth, 5.0)), float(smooth.max())
    height_dn, noise_dn = peak - background, _single_frame_noise(image)
    full_scale = exposure.full_scale_dn(camera, frame)
    # the median halves the noise at least, and a frame has some 1e5 chances for a peak; one DN may be a rounding
    if height_dn < max(SEEN * noise_dn, 1.0):
        if background > max(SEEN * noise_dn, 0.01 * full_scale):
            return None, "no spot: the light fills the frame evenly"
        return None, "no spot: no light stands out of the noise"
    if height_dn < CONTRAST * peak:
        return (
            None,
            f"no spot: the light fills the frame, {100 * max(background, 0.0) / peak:.0f} % of the peak at its darkest",
        )
    bright = (smooth > background + HALF * height_dn).astype(np.uint8)
    number, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=8)
    above = np.clip(smooth - background, 0.0, None)
    light = np.bincount(labels.ravel(), weights=above.ravel(), minlength=number)
    light[0] = 0.0
    largest = int(np.argmax(light))
    if stats[largest, cv2.CC_STAT_AREA] < SMALLEST:
        return None, "no spot: what is bright is smaller than a few pixels"
    left, top, width, height = (int(stats[largest, k]) for k in range(4))
    found = Spot(
        **_form(labels == largest, above - HALF * height_dn, scale), peak_dn=peak, background_dn=background,
        cut=left == 0 or top == 0 or left + width == image.shape[1] or top + height == image.shape[0],
        saturated=bool(peak >= exposure.SATURATED * full_scale),
        others=int(np.count_nonzero(light >= OTHERS * light[largest])) - 1,
    )  # fmt: skip
    return found, _said(found)


def _form(mine: Bools, above: NDArray[np.float32], scale: float) -> dict[str, Any]:
    """Place, axes and outline of a spot, whose pixels count by `above`: zero at the outline, so that none is halved."""

    def place(k: float) -> float:
        return float(scale * k + 0.5 * (scale - 1.0))

    rows, cols = np.nonzero(mine)
    weights = above[mine].astype(float)
    column, row = float(np.average(cols, weights=weights)), float(np.average(rows, weights=weights))
    spread = np.cov(np.stack([cols, rows]).astype(float), ddof=0) + np.eye(2) / 12.0
    values, vectors = np.linalg.eigh(spread)
    minor, major = (4.0 * math.sqrt(max(float(value), 0.0)) for value in values)
    angle = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    contours, _ = cv2.findContours(mine.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    edge = max(contours, key=len)[:, 0, :].astype(float)
    return {
        "column": place(column), "row": place(row), "major_px": scale * major, "minor_px": scale * minor,
        "angle_deg": (angle + 90.0) % 180.0 - 90.0,
        "outline": tuple((place(x), place(y)) for x, y in edge[:: math.ceil(len(edge) / CORNERS)]),
    }  # fmt: skip


def _said(found: Spot) -> str:
    said = []
    if found.cut:
        said.append("it reaches the edge of the frame: its centre is not known")
    if found.saturated:
        said.append("saturated: its outline is too wide")
    if found.others:
        said.append(f"{found.others} more bright place{'s' if found.others > 1 else ''}")
    return "; ".join(said)


def _single_frame_noise(image: Floats32) -> float:
    """Standard deviation of a pixel's noise [DN], from the median of a second difference that ignores smooth light.

    J. Immerkaer, "Fast noise variance estimation", Comput. Vis. Image Underst. 64, 300-302 (1996); with a median.
    """
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6.0
    return 1.4826 * float(np.median(np.abs(cv2.filter2D(image, cv2.CV_32F, kernel))))
