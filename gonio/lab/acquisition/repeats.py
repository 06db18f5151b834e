"""A camera that hands out an image again under a new header: frames that are alike, pixel by pixel, although noise
makes that impossible.
"""

import hashlib
import math
from array import array
from collections.abc import Iterable

import numpy as np

from gonio.errors import DataError
from gonio.lab.acquisition.exposure import SATURATED, full_scale_dn
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Frame
from gonio.lab.rig.dng import pixels_sha256, read_raw
from gonio.lab.rig.light_and_camera import Camera, deviation_dn
from gonio.typing import NDArray

IMPOSSIBLE = -50.0
"""Natural logarithm of a probability that no run has frames enough for: 1e11 frames have 1e22 pairs."""
SMALLEST_DN = 0.5
"""A pixel whose noise is smaller may well read the same twice."""
ROWS = 13
"""An odd number meets every colour, and no spot that is as high is missed."""
SHOWS_DN = 2.0
"""A change of a frame's mean level by more, which another exposure makes, is seen in it without any noise."""

REPEATED = "the camera handed out an image again under a new header"


def cannot_be_alike(camera: Camera, one: Frame, other: Frame) -> bool:
    """Whether two frames have the same pixels, and light that falls on a sensor does not do that.

    A camera has the noise that its description says. Where that is none, as on a simulated rig, two frames of a steady
    scene are alike; not so two of different exposures, unless they are black or full. A frame of one value throughout
    is never accused.
    """
    mosaic = one.mosaic
    if mosaic.shape != other.mosaic.shape or not np.array_equal(mosaic, other.mosaic) or mosaic.min() == mosaic.max():
        return False
    levels, counts = np.unique(mosaic, return_counts=True)
    signal = levels - one.black_level_dn
    open_ = (levels > 0) & (signal < SATURATED * full_scale_dn(camera, one))
    shorter, longer = sorted((one.exposure_s, other.exposure_s))
    change = (1.0 - shorter / longer) * float(np.sum(np.where(open_, signal, 0.0) * counts)) / mosaic.size
    if change > SHOWS_DN:
        return True
    noise_dn = deviation_dn(camera, signal * camera.electrons_per_dn, rounding=False)
    # two normal numbers of this spread, rounded, are equal with a probability of 1/(2 sqrt(pi) spread)
    rolls = open_ & (noise_dn > SMALLEST_DN)
    chances = np.where(rolls, -np.log(2.0 * math.sqrt(math.pi) * np.where(rolls, noise_dn, 1.0)), 0.0)
    return float(np.sum(np.minimum(chances, 0.0) * counts)) < IMPOSSIBLE


def some_rows_sha256(mosaic: NDArray[np.uint16]) -> str:
    """SHA-256 of every `ROWS`th row of pixels: enough to suspect that two frames are alike."""
    return hashlib.sha256(mosaic[::ROWS].tobytes()).hexdigest()


class FramePixels:
    """Which steps of a run have frames of the same pixels, in 24 bytes a frame."""

    def __init__(self, camera: Camera) -> None:
        self._noisy = camera.photon_noise or camera.read_noise_e > 0.0
        self._keys, self._steps, self._exposures_s = array("q"), array("q"), array("d")

    def add(self, pixels: str, step: int, exposure_s: float) -> None:
        """One more frame: a checksum of its pixels or of some, the number of its step, and its exposure [s]."""
        self._keys.append(int(pixels[:15], 16))
        self._steps.append(step)
        self._exposures_s.append(exposure_s)

    @property
    def suspects(self) -> set[int]:
        """Steps with a frame whose pixels equal another's; without noise, another's of a different exposure."""
        keys, steps = np.array(self._keys, dtype=np.int64), np.array(self._steps, dtype=np.int64)
        _, where, counts = np.unique(keys, return_inverse=True, return_counts=True)
        if not self._noisy:
            _, first = np.unique(np.stack([where, np.array(self._exposures_s)]), axis=1, return_index=True)
            counts = np.bincount(where[first], minlength=len(counts))
        return set(steps[counts[where] > 1].tolist())


def repeated(run: Run, steps: Iterable[StepRecord]) -> dict[int, list[str]]:
    """By step, which of their frames are the same picture as another one's although that cannot be, and as which.

    Frames that cannot be read are passed over: others say so.
    """
    first: dict[str, tuple[int, str]] = {}
    out: dict[int, list[str]] = {}
    for step in steps:
        for entry in step.frames:
            try:
                frame = read_raw(run.frame_path(entry.file))
            except DataError:
                continue
            number, name = first.setdefault(pixels_sha256(frame.mosaic), (step.step, entry.file))
            if name == entry.file:
                continue
            if cannot_be_alike(run.description.camera, read_raw(run.frame_path(name)), frame):
                out.setdefault(number, [f"frames/{name} is frames/{entry.file} again: {REPEATED}"])
                out.setdefault(step.step, []).append(f"frames/{entry.file} is frames/{name} again: {REPEATED}")
    return out
