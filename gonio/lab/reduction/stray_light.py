"""Light that lens and sensor spread over the frame: estimated from the frame itself, and its derivatives.

A frame m = (1 + S) r of the scene r has S r = stray_light mean(r) + stray_halo G r, with G a Gaussian. So
r = m - S m + S S m - ...; two terms leave the cube of the fraction. Frames are binned before they are blurred: a halo
is smooth, and the memory stays that of a small picture. Each colour of a mosaic is a picture of its own.
"""

from dataclasses import dataclass

import numpy as np

from gonio.lab.rig.imaging import Channel
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Array, Floats, Ints

TO_HALO = 4.0
"""Bins in the halo's standard deviation, at least: a Gaussian is then blurred by its bins by less than 0.3 %."""


def planes(camera: Camera, values: Array, channel: Channel) -> Floats:
    """The pixels of a channel as one picture: the frame itself, or every second row and column of a mosaic."""
    if channel == "mono" or camera.pattern == "mono":
        return np.asarray(values)
    cells = [(k // 2, k % 2) for k, colour in enumerate(camera.pattern) if colour == channel]
    rows, cols = (size // 2 * 2 for size in values.shape)
    parts = [values[i:rows:2, j:cols:2] for i, j in cells]
    return np.asarray(parts[0] if len(parts) == 1 else np.mean(parts, axis=0))


def pitch(camera: Camera, channel: Channel) -> int:
    """Pixels of the frame in one of `planes`, along a row."""
    return 1 if channel == "mono" or camera.pattern == "mono" else 2


@dataclass(frozen=True)
class SpreadLight:
    """The light that one frame spreads."""

    uniform: float
    """Mean of the scene [DN]: what `stray_light` = 1 would add to each pixel."""
    halo: Floats | None
    """What `stray_halo` = 1 would add, in bins; None without a halo."""
    bin_px: tuple[float, float]
    """Height and width of a bin in pixels of the frame."""
    camera: Camera

    def at(self, rows: Ints, cols: Ints) -> tuple[Floats, Floats]:
        """What spread light adds at pixels [DN], and its derivatives by the two fractions, shape (2, n)."""
        by = np.zeros((2, rows.size))
        by[0] = self.uniform
        if self.halo is not None:
            from scipy.ndimage import map_coordinates

            where = [(x + 0.5) / size - 0.5 for x, size in zip((rows, cols), self.bin_px, strict=True)]
            by[1] = map_coordinates(self.halo, where, order=1, mode="nearest")
        return self.camera.stray_light * by[0] + self.camera.stray_halo * by[1], by


def spread(camera: Camera, values: Array, dark_dn: float, channel: Channel) -> SpreadLight:
    """What one frame spreads.

    Parameters
    ----------
    values
        The whole frame, linear [DN].
    dark_dn
        Mean dark signal of the channel at the frame's exposure [DN].
    """
    step, picture = pitch(camera, channel), planes(camera, values, channel)
    if not camera.stray_halo:
        mean = float(picture.mean(dtype=np.float64)) - dark_dn
        return SpreadLight(mean / (1.0 + camera.stray_light), None, (1.0, 1.0), camera)
    import cv2
    from scipy.ndimage import gaussian_filter

    size = max(1, int(camera.stray_halo_px / step / TO_HALO))
    rows, cols = (max(1, n // size) for n in picture.shape)
    small = cv2.resize(picture.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA).astype(float) - dark_dn
    bin_px = picture.shape[0] * step / rows, picture.shape[1] * step / cols
    sigma = [camera.stray_halo_px / px for px in bin_px]

    def stray(image: Floats) -> Floats:
        halo = gaussian_filter(image, sigma, mode="constant")
        return np.asarray(camera.stray_light * image.mean() + camera.stray_halo * halo)

    once = stray(small)
    scene = small - once + stray(once)
    return SpreadLight(float(scene.mean()), np.asarray(gaussian_filter(scene, sigma, mode="constant")), bin_px, camera)
