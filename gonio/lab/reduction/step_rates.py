"""What a step's frames come to in a band: a rate, or why there is none."""

from dataclasses import dataclass, field

import numpy as np

from gonio.geometry import Directions
from gonio.lab.rig import Pose
from gonio.typing import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Merged:
    """What the frames of one step tell of a region, however they were merged."""

    rate: float
    """[e-/s]"""
    variance: float
    """Variance of all that is independent from step to step, the pixels' responsivities left out."""
    of_lamp: float
    """The part of it that the lamp makes from frame to frame: all pixels have it alike."""
    chi_square: float
    """Chi-square of the frames around their mean."""
    frames: int
    """How many are used."""
    frame_weights: Floats
    """How much each of these counts; their sum is 1."""
    shares: Floats | None = None
    """Change of the rate with each pixel's rate in each frame, shape (frames, pixels), until what the dark frames do to
    it is known; where frames are merged by pixels."""
    of_darks: Floats = field(default_factory=lambda: np.zeros(2))
    """Change of the rate for one standard deviation of the mean of the shorter and of the longer dark frames."""
    hits: int = 0
    """Pixels of single frames left out as hits of cosmic radiation; where frames are merged by pixels."""
    hot: int = 0
    """Pixels left out in all frames."""
    saturated: float = 0.0
    """The part of all pixels of all frames that was left out as too bright."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reduced:
    """The frames of one step and band, merged to a rate; where they look, and what that shares with other steps."""

    merged: Merged
    dark: Floats
    """Change of the rate for one standard deviation of the noise of the shorter and of the longer dark frames in each
    of the patterns that points share (`dark_signal.Patterns`), shape (2, n); zero for a visit to the reference."""
    time_s: float
    left_out: int
    """Frames that are not used, because a pixel of the region is nearly full."""
    pixels: int
    """How many the light falls on."""
    by_camera: Floats
    """Derivatives of the rate by `camera_parameters`."""
    hidden: float
    """What may be missing of the rate [e-/s], where noise is cut off at black; a standard uncertainty."""
    shared: int
    """How many of the pixels the first visit to the reference uses too."""
    by_pixels: Floats
    """Relative change of a value for one standard deviation of the responsivities, which stands for 1 here: of their
    mean over the pixels of the first visit, and in each of the patterns that points share; zero for a visit."""
    directions: Directions
    pose: Pose
    point: int | None
    """Row of the plan; None for a visit to the reference."""

    @property
    def rate(self) -> float:
        """[e-/s]"""
        return self.merged.rate

    @property
    def variance(self) -> float:
        """As of `Merged`."""
        return self.merged.variance


@dataclass(frozen=True, slots=True)
class Rejected:
    """A step that gives no rate in a band."""

    point: int | None
    """Row of the plan; None for a visit to the reference."""
    flag: str
    """Why."""
    left_out: int = 0
    """As in `Reduced`."""
